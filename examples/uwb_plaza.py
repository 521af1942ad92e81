"""Where a robot drove, from its wheels and ranges to four radio beacons, and what it costs to trust the ranges.

The ranges are some per cent too long. Filters that take them as they are follow the robot badly, and their innovations
say so: the mean NIS should be 1. Filters that estimate the errors as well follow closely.

python examples/uwb_plaza.py               a drive made up like the recorded one
python examples/uwb_plaza.py FOLDER        the recording: FOLDER holds Plaza1_DR.txt, Plaza1_TD.txt, Plaza1_.mat

Prints the errors of six filters, and draws three of their tracks: uwb_plaza.png. Reading the recording needs SciPy.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import soopnav_cpp as sn

START_SIGMA = np.array([0.5, 0.5, 0.1])  # m, m, rad
DISTANCE_ERROR = 0.05  # of each increment, along; half of it across
TURN_PSD = 1e-4  # rad²/s
RANGE_SIGMA_M = 0.54
SCALE_PSD = 1e-8  # 1/s
GATE = 9.0  # of the squared innovation over its variance: 0.3 % of good ranges are beyond
WILD = 1e-3  # a range that no model explains, in the eyes of the particles: probability times density, per deviation


@dataclass(frozen=True)
class Drive:
    """T ranges, and the way from one to the next."""

    time_s: np.ndarray  # (T,), rising
    start_s: float
    start: np.ndarray  # (3,), pose x y heading
    odometry: np.ndarray  # (T, 3), increments [forward m, left m, turn rad] since the range before
    beacon: np.ndarray  # (T,), row in beacons_m
    range_m: np.ndarray  # (T,)
    beacons_m: np.ndarray  # (4, 2)
    truth_m: np.ndarray  # (T, 2)

    def steps(self):
        """Increment, duration, beacon and range of each step."""
        return zip(self.odometry, np.diff(self.time_s, prepend=self.start_s), self.beacon, self.range_m, strict=True)


@dataclass(frozen=True)
class Track:
    x: np.ndarray  # (T, n), pose first
    P: np.ndarray  # (T, n, n)
    nis: np.ndarray  # (T,), NaN for particles
    taken: np.ndarray  # (T,), not refused
    innovation: np.ndarray | None = None  # (T,), over its standard deviation

    def rmse_m(self, drive: Drive) -> float:
        return float(np.hypot(*sn.estimation.rmse(self.x[:, :2] - drive.truth_m)))


def increments(time_s: np.ndarray, pose: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Ways between the times `at_s`, the first since time_s[0], in the axes of the robot at their beginning."""
    p = np.column_stack([np.interp([time_s[0], *at_s], time_s, column) for column in pose.T])
    d, c, s = np.diff(p, axis=0), np.cos(p[:-1, 2]), np.sin(p[:-1, 2])
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]])


def dead_reckoned(distance_m: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Poses from increments along arcs; one more, that of the origin, first."""
    heading = np.concatenate([[0.0], np.cumsum(turn_rad)])
    way = distance_m[:, None] * np.column_stack(
        [np.cos(heading[:-1] + turn_rad / 2), np.sin(heading[:-1] + turn_rad / 2)]
    )
    return np.column_stack([np.vstack([np.zeros(2), np.cumsum(way, axis=0)]), heading])


def recorded(folder: Path) -> Drive:
    """The recording of the plaza.

    Its ranges are not all in the order of their times (rows go back 64 s and 50 s once each), so they are sorted. Of
    two with one time the second is left out.
    """
    from scipy.io import loadmat

    dr, td = np.loadtxt(folder / "Plaza1_DR.txt"), np.loadtxt(folder / "Plaza1_TD.txt")
    more = loadmat(folder / "Plaza1_.mat")
    truth, beacons = more["GT"], more["TL"]  # time x y heading; id x y
    td = td[np.unique(td[:, 0], return_index=True)[1]]
    pose = dead_reckoned(dr[:, 1], dr[:, 2])
    return Drive(
        time_s=td[:, 0],
        start_s=truth[0, 0],
        start=truth[0, 1:4],
        odometry=increments(truth[:, 0], pose, td[:, 0]),
        beacon=np.array([list(beacons[:, 0]).index(i) for i in td[:, 2]]),
        range_m=td[:, 3],
        beacons_m=beacons[:, 1:],
        truth_m=np.column_stack([np.interp(td[:, 0], truth[:, 0], truth[:, i]) for i in (1, 2)]),
    )


def made_up(seed: int = 1) -> Drive:
    """Ten minutes of loops among the beacons; ranges 7 % too long, with biases and noise, and one in fifty wild."""
    rng = np.random.default_rng(seed)
    steps, dt = 6000, 0.1
    time_s = dt * np.arange(steps + 1)
    place = 20.0 * np.column_stack([np.sin(time_s / 19.0), np.sin(time_s / 13.0)])
    way = np.diff(place, axis=0)
    heading = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    turn = np.diff(heading, append=heading[-1])
    felt = dead_reckoned(
        np.linalg.norm(way, axis=1) * (1.0 + 0.1 * rng.standard_normal(steps)),
        turn + np.sqrt(TURN_PSD * dt) * rng.standard_normal(steps),
    )
    beacons = np.array([[-25.0, -15.0], [25.0, -20.0], [30.0, 25.0], [-20.0, 30.0]])
    at = np.arange(5, steps, 5)
    beacon = np.arange(len(at)) % 4
    bias = 0.1 * rng.standard_normal(4)
    true = np.linalg.norm(place[at] - beacons[beacon], axis=1)
    z = 1.07 * true + bias[beacon] + RANGE_SIGMA_M * rng.standard_normal(len(at))
    wild = rng.random(len(at)) < 0.02
    z[wild] += rng.uniform(5.0, 40.0, np.count_nonzero(wild))
    return Drive(
        time_s=time_s[at],
        start_s=0.0,
        start=np.array([*place[0], heading[0]]),
        odometry=increments(time_s, felt, time_s[at]),
        beacon=beacon,
        range_m=z,
        beacons_m=beacons,
        truth_m=place[at],
    )


# ---- filters


@dataclass(frozen=True)
class Errors:
    """Errors of the ranges as states behind the pose: z = (1 + scale) |p - q| + bias; without any, the pose alone.

    One nearly constant scale that all beacons share, and a bias for each that forgets slowly (Gauss-Markov).
    """

    scale_sigma: float = 0.0
    bias_sigma_m: float = 0.0
    bias_memory_s: float = 1.0

    @property
    def scales(self) -> int:
        return int(self.scale_sigma > 0.0)

    @property
    def biases(self) -> int:
        return 4 * int(self.bias_sigma_m > 0.0)

    @property
    def size(self) -> int:
        return 3 + self.scales + self.biases

    @property
    def sigma0(self) -> np.ndarray:
        return np.array([*START_SIGMA, *[self.scale_sigma] * self.scales, *[self.bias_sigma_m] * self.biases])

    def memory(self, dt_s: float) -> np.ndarray:
        """What is left of each error after a step."""
        return np.array([1.0] * self.scales + [np.exp(-dt_s / self.bias_memory_s)] * self.biases)

    def noise(self, step: np.ndarray, dt_s: float) -> np.ndarray:
        """Standard deviations of what a step adds: to the increment, then to the errors."""
        bias = self.bias_sigma_m * np.sqrt(-np.expm1(-2.0 * dt_s / self.bias_memory_s))
        return np.array([*motion_noise(step, dt_s), *[np.sqrt(SCALE_PSD * dt_s)] * self.scales, *[bias] * self.biases])

    def moved(self, x: np.ndarray, step: np.ndarray, dt_s: float) -> np.ndarray:
        """States (..., n) after an increment (..., 3)."""
        c, s = np.cos(x[..., 2]), np.sin(x[..., 2])
        forward, left, turn = step[..., 0], step[..., 1], step[..., 2]
        pose = [x[..., 0] + c * forward - s * left, x[..., 1] + s * forward + c * left, x[..., 2] + turn]
        return np.concatenate([np.stack(pose, axis=-1), x[..., 3:] * self.memory(dt_s)], axis=-1)

    def ranges(self, x: np.ndarray, q: np.ndarray, beacon: int) -> np.ndarray:
        """Ranges (...) that states (..., n) lead to."""
        stretch = 1.0 + x[..., 3] if self.scales else 1.0
        bias = x[..., 3 + self.scales + beacon] if self.biases else 0.0
        return stretch * np.hypot(x[..., 0] - q[0], x[..., 1] - q[1]) + bias


BIASES = Errors(bias_sigma_m=2.0, bias_memory_s=1000.0)
SCALE_AND_BIASES = Errors(scale_sigma=0.1, bias_sigma_m=0.1, bias_memory_s=1000.0)


def motion_noise(step: np.ndarray, dt_s: float) -> np.ndarray:
    """Standard deviations of an increment: forward, left, turn."""
    way = np.hypot(step[0], step[1])
    return np.array([DISTANCE_ERROR * way + 1e-3, 0.5 * DISTANCE_ERROR * way + 1e-3, np.sqrt(TURN_PSD * dt_s)])


def trusting(drive: Drive, *, particles: int = 0, sigma_m: float = RANGE_SIGMA_M, seed: int = 1) -> Track:
    """The pose alone, in one call with models that the library has; an extended Kalman filter without particles."""
    dt_s = np.diff(drive.time_s, prepend=drive.start_s)
    each = [motion_noise(step, dt) ** 2 / dt for step, dt in zip(drive.odometry, dt_s, strict=True)]
    along = np.median(each, axis=0)[0]  # m²/s, at the usual speed
    wheels = sn.process.PlanarOdometry(np.zeros((3, 3)), diffusion_psd=[along, along, TURN_PSD])
    ranges = [
        (sn.measurement.Range(q), drive.range_m, sigma_m**2, drive.beacon == index)
        for index, q in enumerate(drive.beacons_m)
    ]
    options = {"inputs": drive.odometry, "start_s": drive.start_s}
    if particles:
        prior = sn.estimation.Gaussian(drive.start, np.diag(START_SIGMA**2))
        pf = sn.estimation.ParticleFilter(particles, prior=prior, state="pose2", seed=seed)
        run = pf.run(drive.time_s, wheels, ranges, **options)
        accepted = run.status == sn.estimation.ParticleStatus.ACCEPTED
        return Track(run.mean, run.covariance, np.full(len(dt_s), np.nan), accepted)
    ekf = sn.estimation.ExtendedKalmanFilter("pose2", drive.start, START_SIGMA**2)
    run = ekf.run(drive.time_s, wheels, ranges, **options)
    own = np.arange(len(dt_s)), drive.beacon
    return Track(run.x, run.P, run.nis[own], run.status[own] == sn.estimation.UpdateStatus.ACCEPTED)


def estimating(drive: Drive, errors: Errors, *, gate: float | None = GATE) -> Track:
    """The pose and the errors of the ranges, by an extended Kalman filter with models of one's own, step by step."""
    x0 = np.concatenate([drive.start, np.zeros(errors.size - 3)])
    ekf = sn.estimation.ExtendedKalmanFilter("custom", x0, errors.sigma0**2)
    out = []
    for step, dt_s, beacon, z in drive.steps():
        q = drive.beacons_m[beacon]

        def move(x, dt_s, step=step):
            after = errors.moved(x, step, dt_s)
            F = np.diag([1.0, 1.0, 1.0, *errors.memory(dt_s)])
            F[0, 2], F[1, 2] = x[1] - after[1], after[0] - x[0]
            return after, F

        def look(x, q=q, beacon=beacon):
            away = x[:2] - q
            far = np.hypot(*away)
            H = np.zeros((1, errors.size))
            H[0, :2] = (1.0 + x[3] if errors.scales else 1.0) * away / far
            if errors.scales:
                H[0, 3] = far
            if errors.biases:
                H[0, 3 + errors.scales + beacon] = 1.0
            return errors.ranges(x, q, beacon)[None], H

        c, s = np.cos(ekf.x[2]), np.sin(ekf.x[2])
        G = np.diag(errors.noise(step, dt_s))
        G[:2, :2] = [[c, -s], [s, c]] @ G[:2, :2]
        ekf.predict(move, dt_s, Q=G @ G.T)
        report = ekf.update(look, z, RANGE_SIGMA_M**2, gate_nis=gate)
        out.append(
            (ekf.x, ekf.P, report.nis, report.accepted, float(report.innovation[0] / report.covariance[0, 0] ** 0.5))
        )
    return Track(*(np.array(column) for column in zip(*out, strict=True)))


def estimating_particles(drive: Drive, errors: Errors, *, particles: int = 2000, seed: int = 1) -> Track:
    """The same by a particle filter, with functions of all particles."""
    prior = sn.estimation.Gaussian([*drive.start, *[0.0] * (errors.size - 3)], np.diag(errors.sigma0**2))
    names = [f"x{i}" for i in range(errors.size)]
    pf = sn.estimation.ParticleFilter(particles, prior=prior, state=names, seed=seed)
    out = []
    for step, dt_s, beacon, z in drive.steps():
        q, deviations = drive.beacons_m[beacon], errors.noise(step, dt_s)

        def move(x, w, step=step, dt_s=dt_s, deviations=deviations):
            w = w * deviations
            after = errors.moved(x, step + w[:, :3], dt_s)
            after[:, 3:] += w[:, 3:]
            return after

        def likelihood(x, z=z, q=q, beacon=beacon):
            off = (z - errors.ranges(x, q, beacon)) / RANGE_SIGMA_M
            return np.log(np.exp(-0.5 * off**2) + WILD)

        report = pf.step(likelihood, process=move)
        out.append((pf.mean, pf.covariance, np.nan, report.accepted))
    return Track(*(np.array(column) for column in zip(*out, strict=True)))


# ---- the comparison


def draw(drive: Drive, tracks: dict[str, Track], path: Path) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("no figure: matplotlib is not installed")
        return
    figure = Figure(figsize=(4.4 * len(tracks), 5.6), layout="constrained")
    every = figure.subplots(1, len(tracks), sharex=True, sharey=True)
    for axes, (name, track) in zip(every, tracks.items(), strict=True):
        axes.plot(*drive.truth_m.T, color="#22303c", linewidth=0.8, label="truth")
        axes.plot(*track.x[:, :2].T, color="#d1495b", linewidth=0.8, label="estimate")
        axes.plot(*drive.beacons_m.T, "^", color="#1b6ca8", label="beacons")
        axes.set_title(f"{name}: {track.rmse_m(drive):.2f} m RMSE", fontsize=10)
        axes.set_xlabel("x [m]")
        axes.set_aspect("equal")
        axes.grid(True, linewidth=0.4, alpha=0.6)
    every[0].set_ylabel("y [m]")
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=120)


def main() -> None:
    drive = recorded(Path(sys.argv[1])) if len(sys.argv) > 1 else made_up()
    tracks = {
        "EKF, ranges as they are": trusting(drive),
        "EKF, a bias for each beacon": estimating(drive, BIASES),
        "EKF, one scale and biases": estimating(drive, SCALE_AND_BIASES),
        "particles, ranges as they are": trusting(drive, particles=2000),
        "particles, a bias for each beacon": estimating_particles(drive, BIASES),
        "particles, one scale and biases": estimating_particles(drive, SCALE_AND_BIASES),
    }
    print(f"{len(drive.time_s)} ranges in {drive.time_s[-1] - drive.start_s:.0f} s")
    print(f"{'':34s}{'RMSE [m]':>9s}{'NIS':>7s}{'gated':>8s}")
    for name, track in tracks.items():
        nis = "" if np.isnan(track.nis).all() else f"{track.nis[track.taken].mean():7.2f}{1 - track.taken.mean():8.2%}"
        print(f"{name:34s}{track.rmse_m(drive):9.2f}{nis}")
    draw(drive, {name: track for name, track in tracks.items() if "EKF" in name}, Path("uwb_plaza.png"))
    best, trustful = tracks["EKF, one scale and biases"], tracks["EKF, ranges as they are"]
    assert best.rmse_m(drive) < 1.0 < trustful.rmse_m(drive)
    assert 0.7 < best.nis[best.taken].mean() < 1.3


if __name__ == "__main__":
    main()
