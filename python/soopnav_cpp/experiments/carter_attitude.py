"""Attitude from carrier-phase differences (carter chapter 3), and the heading between two noisy positions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp import gnss
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, experiment, near, style

__all__ = ["Manoeuvre", "baseline_errors", "filter_errors", "manoeuvre", "sky"]

Array = npt.NDArray[np.float64]

LIGHT_MPS = 299_792_458.0
L1_M = LIGHT_MPS / 1575.42e6

# Figures 3.5 and 3.6.
BASELINES_M = np.array([0.05, 0.1, 0.2, 0.5, 1.0])
SIGMAS_M = np.array([0.001, 0.005, 0.010, 0.020, 0.050])
ANGLES_DEG = np.concatenate([[1.0, 2.0], np.arange(3.0, 178.0, 2.0), [178.0, 179.0]])
DRAWS = 3000

# Figures 3.7 to 3.10.
RATE_HZ = 10.0
TURN_DEG, TURN_RATE_DPS, HOLD_S = 40.0, 10.0, 10.0
SETTLED_S = 3.0
CN0_DBHZ, LOOP_HZ = 42.0, 15.0


def thermal_sigma_m() -> float:
    """Of a path difference: two antennas, each with the loop's thermal noise B_l / (C/N0) rad² (carter eq. 2.24)."""
    phase_rad = math.sqrt(LOOP_HZ / 10.0 ** (CN0_DBHZ / 10.0))
    return math.sqrt(2.0) * phase_rad * L1_M / (2.0 * math.pi)


VARIANTS = {"thermal": (thermal_sigma_m(), math.radians(0.3)), "20 mm": (0.020, math.radians(1.0))}


def sky(rng: np.random.Generator, satellites: int = 8) -> Array:
    """Unit vectors to satellites 15 to 75 degrees high, all round, north-east-down, shape (satellites, 3)."""
    azimuth = 2.0 * np.pi * (np.arange(satellites) + rng.uniform(-0.4, 0.4, satellites)) / satellites
    elevation = np.deg2rad(rng.permutation(np.linspace(15.0, 75.0, satellites)))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)], axis=1)


def rotation(euler_rad: Array) -> Array:
    """Matrices body to reference of (..., 3) yaw, pitch, roll."""
    cy, cp, cr = np.moveaxis(np.cos(euler_rad), -1, 0)
    sy, sp, sr = np.moveaxis(np.sin(euler_rad), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


class Manoeuvre(NamedTuple):
    """One axis after the other turns by 40 degrees and back.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    euler_rad : ndarray, shape (n, 3)
    turning : ndarray of bool, shape (n,)
    still : ndarray of bool, shape (n,)
        More than 3 s after a turn (and after the start).
    """

    t_s: Array
    euler_rad: Array
    turning: npt.NDArray[np.bool_]
    still: npt.NDArray[np.bool_]


def manoeuvre() -> Manoeuvre:
    """Figures 3.7 to 3.10: yaw, pitch, roll, 10 Hz."""
    turn_s = TURN_DEG / TURN_RATE_DPS
    knots = [0.0]
    values = [np.zeros(3)]
    stretches: list[tuple[float, float]] = []
    for axis in range(3):
        for goal in (TURN_DEG, 0.0):
            knots.append(knots[-1] + HOLD_S)
            values.append(values[-1])
            stretches.append((knots[-1], knots[-1] + turn_s))
            knots.append(knots[-1] + turn_s)
            after = values[-1].copy()
            after[axis] = goal
            values.append(after)
    knots.append(knots[-1] + HOLD_S)
    values.append(values[-1])
    t = np.arange(round(knots[-1] * RATE_HZ)) / RATE_HZ
    euler = np.stack([np.interp(t, knots, np.array(values)[:, axis]) for axis in range(3)], axis=1)
    turning = np.any([(t > start) & (t <= stop) for start, stop in stretches], axis=0)
    waiting = np.any([(t > start) & (t <= stop + SETTLED_S) for start, stop in stretches], axis=0) | (t <= SETTLED_S)
    return Manoeuvre(t, np.deg2rad(euler), turning, ~waiting)


def antennas(length_cycles: float = 0.9) -> Array:
    """Baselines on the body's x and y, shape (2, 3)."""
    return length_cycles * L1_M * np.eye(3)[:2]


def wrapped(angle_rad: Array) -> Array:
    """The short way round."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


class FilterErrors(NamedTuple):
    """Errors of one run in degrees, shape (n, 3): least squares, filter on Euler angles, filter on the quaternion.

    ``wrong`` counts path differences whose integer the tracking filter had wrong; ``beyond`` is the share of
    differences longer than half a cycle, under 40 skies.
    """

    least_squares: Array
    euler: Array
    quaternion: Array
    tracked: Array
    wrong: int
    beyond: float


def filter_errors(seed: int, sigma_m: float, walk_rad_rts: float) -> FilterErrors:
    """One run of figures 3.7 to 3.10."""
    rng = np.random.default_rng(seed)
    way, u, b = manoeuvre(), sky(rng), antennas()
    T = rotation(way.euler_rad)
    true_path = np.einsum("nij,kj,mi->nkm", T, b, u)
    path = true_path + sigma_m * rng.standard_normal(true_path.shape)
    start = np.array([1.0, 0.0, 0.0, 0.0])
    P0 = math.radians(1.0) ** 2 * np.eye(3)

    def run(parameters: str, data: Array, wavelength_m: float | None = None) -> Array:
        made = gnss.AttitudeFilter(
            b,
            start,
            P0,
            parameters="euler" if parameters == "euler" else "quaternion",
            sigma_m=sigma_m,
            rate_noise_rad_rts=walk_rad_rts,
        )
        return made.run(way.t_s, data, u, wavelength_m=wavelength_m).euler_rad

    def error(euler_rad: Array) -> Array:
        return np.rad2deg(wrapped(euler_rad - way.euler_rad))

    skies = np.concatenate([sky(rng) for _ in range(40)])
    longer = np.abs(np.einsum("nij,kj,mi->nkm", T[::10], b, skies)) > 0.5 * L1_M
    cycles = -path / L1_M
    tracked = run("euler", cycles - np.round(cycles), L1_M)
    predicted = np.einsum("nij,kj,mi->nkm", rotation(np.vstack([[0.0, 0.0, 0.0], tracked[:-1]])), b, u)
    resolved = np.round(cycles + predicted / L1_M)
    return FilterErrors(
        least_squares=error(gnss.attitude_fix(path, b, u, sigma_m).euler_rad),
        euler=error(run("euler", path)),
        quaternion=error(run("quaternion", path)),
        tracked=error(tracked),
        wrong=int(np.count_nonzero(resolved)),
        beyond=float(np.mean(longer)),
    )


def rms(error: Array) -> float:
    """Over everything."""
    return float(np.sqrt(np.mean(np.square(error))))


def angle_errors(seed: int) -> Array:
    """Sums of squared angle errors [rad²], shape (baselines, sigmas, angles): figures 3.5 and 3.6."""
    noise = np.random.default_rng(seed).standard_normal(DRAWS)
    angles = np.deg2rad(ANGLES_DEG)
    out = np.empty((len(BASELINES_M), len(SIGMAS_M), len(angles)))
    for i, baseline in enumerate(BASELINES_M):
        for j, sigma in enumerate(SIGMAS_M):
            measured = gnss.arrival_angle(baseline * np.cos(angles)[:, None] + sigma * noise, float(baseline))
            out[i, j] = np.sum((measured - angles[:, None]) ** 2, axis=1)
    return out


@experiment(
    "carter-3.5", title="Angle of arrival of one baseline", source="carter section 3.2, Figs. 3.5 and 3.6", runs=10
)
def figure_3_5(lab: Lab) -> Iterator[Claim]:
    """The error of acos(ΔL/B) against σ / (B sin θ), and where that fails."""
    error = np.sqrt(np.sum(lab.map(angle_errors), axis=0) / (DRAWS * lab.runs))
    angles = np.deg2rad(ANGLES_DEG)
    linear = np.array([[gnss.arrival_angle_sigma(angles, b, s) for s in SIGMAS_M] for b in BASELINES_M])
    ratio = error / linear
    B, S, A = BASELINES_M[:, None, None], SIGMAS_M[None, :, None], angles[None, None, :]
    valid = (B * (1.0 - np.abs(np.cos(A))) >= 3.0 * S) & (S / B <= 0.25)
    ends = np.broadcast_to((ANGLES_DEG <= 2.0) | (ANGLES_DEG >= 178.0), ratio.shape) & (S >= 0.005)
    broadside = error[:, :, np.argmin(np.abs(ANGLES_DEG - 91.0))]
    with lab.figure(10.6, 4.6) as figure:
        left, right = figure.subplots(1, 2)
        colours = ("#1b6ca8", "#2a9d8f", "#e09f3e", "#d1495b")
        for colour, baseline in zip(colours, (0.1, 0.2, 0.5, 1.0), strict=True):
            i = int(np.argmin(np.abs(BASELINES_M - baseline)))
            for sigma, line in ((0.001, "-"), (0.020, "--")):
                j = int(np.argmin(np.abs(SIGMAS_M - sigma)))
                label = f"B = {baseline:g} m" if line == "-" else None
                left.semilogy(ANGLES_DEG, np.rad2deg(error[i, j]), line, color=colour, lw=1.3, label=label)
        left.plot([], [], "-", color="0.3", label="σ = 1 mm")
        left.plot([], [], "--", color="0.3", label="σ = 20 mm")
        left.legend(frameon=False, fontsize=8.5, ncol=2, loc="upper center")
        left.set_ylim(0.04, 200.0)
        style(left, "Fig. 3.5: error over angle", "angle from the baseline [deg]", "rms error [deg]")
        for colour, i in zip(("#7b5ea7", *colours), range(len(BASELINES_M)), strict=True):
            right.plot(ANGLES_DEG, ratio[i, -1], color=colour, lw=1.3, label=f"B = {BASELINES_M[i]:g} m")
            right.plot(ANGLES_DEG[valid[i, -1]], ratio[i, -1][valid[i, -1]], color=colour, lw=4.0, alpha=0.35)
        right.axhline(1.0, color="#22303c", lw=0.8, ls=(0, (4, 3)))
        right.set_ylim(0.0, 1.4)
        right.legend(frameon=False, fontsize=8.5, loc="lower center")
        style(
            right,
            "σ = 50 mm: error over σ / (B sin θ)",
            "angle from the baseline [deg]",
            "ratio (wide: where it holds)",
        )
    lab.save(
        baselines_m=BASELINES_M,
        sigmas_m=SIGMAS_M,
        angles_deg=ANGLES_DEG,
        rms_error_rad=error,
        linear_rad=linear,
        valid=valid,
    )
    yield Claim(
        f"rms over σ / (B sin θ) where B(1-|cos θ|) ≥ 3σ and σ ≤ B/4, least and greatest of {np.count_nonzero(valid)}",
        [ratio[valid].min(), ratio[valid].max()],
        band(0.9, 1.1),
    )
    yield Claim(
        "within 2° of the baseline the formula is off by more than 30 % for σ ≥ 5 mm: least |ratio - 1|",
        np.abs(ratio[ends] - 1.0).min(),
        above(0.3),
    )
    yield Claim(
        "the error there against that across the baseline, least for σ ≤ B/4",
        (error[:, :, [0, 1, -2, -1]] / broadside[:, :, None])[np.broadcast_to(S / B <= 0.25, (5, 5, 4))].min(),
        above(1.0),
    )
    at_90 = error[:, 0, int(np.argmin(np.abs(ANGLES_DEG - 91.0)))] * BASELINES_M
    yield Claim(
        "across the baseline the error is as 1/B: B times rms at 1 mm, greatest over least",
        at_90.max() / at_90.min(),
        at_most(1.05),
    )


def _draw_run(lab: Lab, run: FilterErrors) -> None:
    way = manoeuvre()
    with lab.figure(10.6, 7.0) as figure:
        grid = figure.subplots(3, 2, sharex=True)
        for axis, name in enumerate(("yaw", "pitch", "roll")):
            for column, (error, title) in enumerate(
                ((run.least_squares, "Least squares (figs. 3.7, 3.8)"), (run.euler, "EKF (figs. 3.9, 3.10)"))
            ):
                axes = grid[axis, column]
                axes.plot(way.t_s, np.rad2deg(way.euler_rad[:, axis]) + error[:, axis], color="#1b6ca8", lw=0.7)
                axes.plot(way.t_s, np.rad2deg(way.euler_rad[:, axis]), color="#22303c", lw=0.9, ls=(0, (4, 3)))
                below = axes.twinx()
                below.plot(way.t_s, error[:, axis], color="#d1495b", lw=0.5)
                below.set_ylim(-16.0, 60.0)
                below.set_yticks([-10, 0, 10])
                below.tick_params(labelsize=7, colors="#d1495b")
                axes.set_ylim(-75.0, 55.0)
                axes.set_yticks([0, 20, 40])
                style(axes, title if axis == 0 else "", "time [s]" if axis == 2 else "", f"{name} [deg]")


@experiment(
    "carter-3.7",
    title="Attitude by least squares and by an EKF",
    source="carter section 3.2, Figs. 3.7 to 3.10",
    runs=60,
)
def figure_3_7(lab: Lab) -> Iterator[Claim]:
    """Eight satellites, antennas 0.9 λ apart, one axis at a time by 40° at 10°/s, random-walk filter."""
    way = manoeuvre()
    numbers: dict[str, float] = {}
    claims: list[Claim] = []
    for name, (sigma, walk) in VARIANTS.items():
        runs = lab.map(filter_errors, sigma, walk)
        still = {
            kind: rms(np.array([getattr(run, kind)[way.still] for run in runs]))
            for kind in ("least_squares", "euler", "quaternion", "tracked")
        }
        turning = {
            kind: rms(np.array([getattr(run, kind)[way.turning] for run in runs]))
            for kind in ("least_squares", "euler")
        }
        for label, values in (("still", still), ("turning", turning)):
            numbers |= {f"{name}, {label}, {kind}": value for kind, value in values.items()}
        source = f"σ_L = {1e3 * sigma:.1f} mm, q = {math.degrees(walk):.1f}°/√s"
        if name == "thermal":
            claims += [
                Claim(
                    f"{source} (C/N0 42 dB-Hz, loop 15 Hz): not turning, EKF over least squares",
                    still["euler"] / still["least_squares"],
                    at_most(0.6),
                ),
                Claim("both rms below 0.3°", [still["least_squares"], still["euler"]], at_most(0.3)),
                Claim(
                    "turning, EKF over least squares: it lags",
                    turning["euler"] / turning["least_squares"],
                    at_least(2.0),
                ),
                Claim(
                    "share of differences beyond half a cycle, which (2.26) without integers has wrong",
                    float(np.mean([run.beyond for run in runs])),
                    at_least(1.0 / 3.0),
                ),
                Claim(
                    "integers tracked from a known start: wrong ones in all epochs of all runs",
                    float(sum(run.wrong for run in runs)),
                    at_most(0.0),
                ),
                Claim(
                    "the filter on the quaternion against that on Euler angles, still",
                    still["quaternion"] / still["euler"],
                    band(0.9, 1.1),
                ),
            ]
        else:
            _draw_run(lab, runs[0])
            claims += [
                Claim(
                    f"{source}: not turning, the EKF is better by, in degrees (the paper's 'couple of degrees')",
                    still["least_squares"] - still["euler"],
                    at_least(2.0),
                ),
                Claim(
                    "turning, EKF over least squares",
                    turning["euler"] / turning["least_squares"],
                    at_least(1.1),
                ),
            ]
    lab.save(t_s=way.t_s, euler_rad=way.euler_rad, turning=way.turning, still=way.still)
    lab.table(("what", "rms_deg"), numbers.items(), part="rms")
    yield from claims


LENGTHS_CYCLES = np.geomspace(0.5, 20.0, 12)
NOISES_M = (thermal_sigma_m(), 0.005)


def baseline_errors(seed: int, draws: int = 100) -> Array:
    """Mean squared rotation errors [rad²], shape (noises, lengths), integers known: figure 3.11."""
    rng = np.random.default_rng(seed)
    out = np.empty((len(NOISES_M), len(LENGTHS_CYCLES)))
    for i, sigma in enumerate(NOISES_M):
        for j, length in enumerate(LENGTHS_CYCLES):
            b, u = antennas(float(length)), sky(rng)
            euler = rng.uniform(-1.0, 1.0, 3)
            T = rotation(euler)
            path = np.einsum("ij,kj,mi->km", T, b, u)
            noisy = path + sigma * rng.standard_normal((draws, *path.shape))
            fixes = gnss.attitude_fix(noisy, b, u, sigma)
            # Angle of the rotation between estimate and truth, from the trace.
            trace = np.einsum("nij,ij->n", rotation(fixes.euler_rad), T)
            out[i, j] = np.mean(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)) ** 2)
    return out


@experiment("carter-3.11", title="Attitude error over the baseline", source="carter section 3.2, Fig. 3.11", runs=60)
def figure_3_11(lab: Lab) -> Iterator[Claim]:
    """As 1 / B, integers known."""
    error = np.sqrt(np.mean(lab.map(baseline_errors), axis=0))
    logs = np.log(LENGTHS_CYCLES)
    slopes = np.array([np.polyfit(logs, np.log(row), 1)[0] for row in error])
    with lab.figure(7.2, 4.8) as figure:
        axes = figure.add_subplot()
        for row, sigma, slope, colour in zip(error, NOISES_M, slopes, ("#1b6ca8", "#d1495b"), strict=True):
            axes.loglog(LENGTHS_CYCLES, np.rad2deg(row), "o", color=colour, ms=4.5)
            fit = np.exp(np.mean(np.log(row) + logs)) / LENGTHS_CYCLES
            label = f"σ$_L$ = {1e3 * sigma:.1f} mm: slope {slope:.3f}"
            axes.loglog(LENGTHS_CYCLES, np.rad2deg(fit), color=colour, lw=1.0, label=label)
        axes.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        axes.minorticks_off()
        axes.legend(frameon=False)
        style(axes, "Attitude of eight satellites, two antennas", "baseline [λ]", "rms rotation error [deg]")
    lab.save(lengths_cycles=LENGTHS_CYCLES, sigmas_m=np.array(NOISES_M), rms_error_rad=error, slopes=slopes)
    yield Claim("slope of log error over log baseline, 0.5 to 20 λ, σ_L 1.3 and 5 mm", slopes, near(-1.0, within=0.03))
    flat = error * LENGTHS_CYCLES
    yield Claim(
        "error times baseline: farthest from its mean, relative",
        float(np.max(np.abs(flat / flat.mean(axis=1, keepdims=True) - 1.0))),
        at_most(0.15),
    )


KAPPAS = np.geomspace(0.1, 100.0, 13)
HEADING_DRAWS = 4000


def heading_errors(seed: int) -> Array:
    """Mean squared heading error [rad²] and share beyond 90°, shape (2, kappas): figures 3.12 to 3.14."""
    rng = np.random.default_rng(seed)
    off = np.array([rng.normal(size=(HEADING_DRAWS, 2)) - rng.normal(size=(HEADING_DRAWS, 2)) for _ in KAPPAS])
    along = math.sqrt(2.0) * KAPPAS[:, None] + off[:, :, 0]
    error = np.arctan2(off[:, :, 1], along)
    return np.array([np.mean(error**2, axis=1), np.mean(np.abs(error) > 0.5 * np.pi, axis=1)])


def _draw_positions(lab: Lab, drawn: list[tuple[str, float]], rms_rad: Array, closed: Array) -> None:
    rng = lab.rng("vectors")
    with lab.figure(10.6, 4.4) as figure:
        for column, (title, baseline) in enumerate(drawn):
            axes = figure.add_subplot(1, 3, column + 1)
            ends = rng.normal(size=(100, 2, 2)) + np.array([[0.0, 0.0], [0.0, baseline]])
            for (x0, y0), (x1, y1) in sorted(ends.tolist(), key=lambda end: end[1][1] < end[0][1]):
                if y1 < y0:
                    axes.plot([x0, x1], [y0, y1], color="#d1495b", lw=1.2)
                else:
                    axes.plot([x0, x1], [y0, y1], color="#1b6ca8", lw=0.5, alpha=0.5)
            turn = np.linspace(0.0, 2.0 * np.pi, 100)
            for y in (0.0, baseline):
                axes.plot(3.0 * np.cos(turn), y + 3.0 * np.sin(turn), color="0.4", lw=0.9)
            axes.annotate(
                "", (0.0, baseline), (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": "#22303c", "lw": 1.6}
            )
            axes.set_aspect("equal")
            axes.set_xlim(-7.0, 7.0)
            axes.set_ylim(-4.5, 16.5)
            style(axes, title, "x [σ]", "y [σ]")
        axes = figure.add_subplot(1, 3, 3)
        axes.loglog(KAPPAS * math.sqrt(2.0), np.rad2deg(rms_rad), "o", color="#d1495b", ms=4.5, label="drawn")
        axes.loglog(KAPPAS * math.sqrt(2.0), np.rad2deg(closed), color="#1b6ca8", lw=1.2, label="closed form")
        axes.loglog(
            KAPPAS * math.sqrt(2.0), np.rad2deg(1.0 / KAPPAS), color="#22303c", lw=0.9, ls=(0, (4, 3)), label="√2 σ / B"
        )
        axes.set_ylim(0.4, 300.0)
        axes.legend(frameon=False, fontsize=8.5)
        style(axes, "Heading error", "baseline [σ]", "rms [deg]")


@experiment(
    "carter-3.12",
    title="Heading between two noisy positions",
    source="carter section 3.3, Figs. 3.12 to 3.14",
    runs=25,
)
def figure_3_12(lab: Lab) -> Iterator[Claim]:
    """Proportional to σ / B while the baseline is long; the vector inverts when the circles overlap."""
    drawn = np.mean(lab.map(heading_errors), axis=0)
    exact = [gnss.heading_error(float(kappa) * math.sqrt(2.0), 1.0) for kappa in KAPPAS]
    closed = np.array([e.rms_rad for e in exact])
    inversion = np.array([e.inversion_probability for e in exact])
    n = HEADING_DRAWS * lab.runs
    rms_rad = np.sqrt(drawn[0])
    _draw_positions(
        lab, [("Long baseline (fig. 3.13)", 12.0), ("Short: red inverted (fig. 3.14)", 2.0)], rms_rad, closed
    )
    lab.save(kappa=KAPPAS, rms_error_rad=rms_rad, closed_form_rad=closed, inverted=drawn[1], inversion=inversion)
    yield Claim("rms drawn over the closed form, all baselines", rms_rad / closed, band(0.97, 1.03))
    spread = np.sqrt(inversion * (1.0 - inversion) / n)
    seen = inversion * n > 50.0
    yield Claim(
        "share of inverted vectors against Φ(-B/(√2σ)): greatest difference in its own deviations",
        float(np.max(np.abs(drawn[1] - inversion)[seen] / spread[seen])),
        at_most(4.8),
    )
    long = KAPPAS > 5.0
    yield Claim(
        "√2σ/B is right for baselines beyond 7σ: closed form over it",
        closed[long] * KAPPAS[long],
        band(1.0, 1.05),
    )
    yield Claim(
        "and wrong at a baseline of 2σ, where the 3σ circles overlap: share of inverted vectors",
        gnss.heading_error(2.0, 1.0).inversion_probability,
        above(0.05),
    )
    yield Claim(
        "without a baseline the heading is anything: rms π/√3",
        gnss.heading_error(0.0, 1.0).rms_rad,
        near(math.pi / math.sqrt(3.0), within=1e-9),
    )
