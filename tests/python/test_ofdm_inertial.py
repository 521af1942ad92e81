"""The planar navigator: inertial prediction, OFDM boundaries, clocks, several receivers, bad data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.estimation import UpdateStatus
from soopnav_cpp.navigation import OfdmInertialNavigator, PlanarStart, RangeChanges

Array = npt.NDArray[np.float64]

TRANSMITTERS = np.array([[1000.0, 1500.0], [-2000.0, 1000.0], [500.0, -2000.0]])
RING = np.vstack([TRANSMITTERS, [[2200.0, -300.0], [-900.0, -1900.0]]])
PERIOD_S = 0.02
AMBIGUITY_M = 1199.169832
SIGMA_M = 4.33


@dataclass(frozen=True)
class Imu:
    t_s: Array
    yaw_rate_radps: Array
    specific_force_b_mps2: Array


@dataclass(frozen=True)
class Path:
    """A drive whose samples are held over their interval: the truth follows from them exactly."""

    t_s: Array
    yaw: Array
    force: Array
    heading: Array  # with the start: one more
    velocity: Array
    position: Array

    def state(self) -> Array:
        return np.column_stack([self.heading, self.velocity, self.position])

    def imu(self, rng: np.random.Generator | None, gyro: float = 0.1, accelerometer: float = 0.1) -> Imu:
        if rng is None:
            return Imu(self.t_s, self.yaw, self.force)
        return Imu(
            self.t_s,
            self.yaw + gyro * rng.standard_normal(self.yaw.shape),
            self.force + accelerometer * rng.standard_normal(self.force.shape),
        )

    def change(self, sources: Array, every: int = 50) -> tuple[Array, Array]:
        p = self.position[every::every]
        far = np.linalg.norm(p[:, None] - sources, axis=2) - np.linalg.norm(self.position[0] - sources, axis=1)
        return self.t_s[every - 1 :: every], far


def drive(seconds: float = 60.0, start: tuple[float, float] = (0.0, 0.0), turn: float = 0.05) -> Path:
    n = round(seconds / PERIOD_S)
    t = PERIOD_S * np.arange(1.0, n + 1)
    yaw = turn + 0.1 * np.sin(2 * np.pi * t / 40.0)
    speed_rate = np.where(t < 10.0, 0.8, 0.0)
    speed = np.cumsum(speed_rate) * PERIOD_S
    force = np.column_stack([speed_rate, speed * yaw])
    x = np.array([0.0, 0.0, 0.0, *start])
    states = [x]
    for k in range(n):
        c, s = np.cos(x[0]), np.sin(x[0])
        a = np.array([c * force[k, 0] - s * force[k, 1], s * force[k, 0] + c * force[k, 1]])
        p = x[3:] + PERIOD_S * x[1:3] + 0.5 * PERIOD_S**2 * a
        x = np.concatenate([[x[0] + PERIOD_S * yaw[k]], x[1:3] + PERIOD_S * a, p])
        states.append(x)
    full = np.array(states)
    return Path(t, yaw, force, full[:, 0], full[:, 1:3], full[:, 3:])


def errors(run_state: Array, truth: Array) -> Array:
    error = run_state - truth
    error[..., 0] = (error[..., 0] + np.pi) % (2 * np.pi) - np.pi
    return error


def test_exact_samples_come_back_to_the_truth() -> None:
    path = drive(120.0)
    run = OfdmInertialNavigator(TRANSMITTERS).run(path.imu(None))
    assert run.status == UpdateStatus.ACCEPTED
    np.testing.assert_allclose(errors(run.state, path.state()), 0.0, atol=1e-9)
    assert run.t_s[0] == 0.0
    assert run.imu.used == len(path.t_s)
    assert run.imu.gaps == run.imu.not_after == 0


def test_equals_the_filter_of_the_same_models() -> None:
    """Prediction and updates against `ExtendedKalmanFilter` with the mechanisation and range differences."""
    path = drive(20.0)
    rng = np.random.default_rng(3)
    imu = path.imu(rng)
    t, z = path.change(TRANSMITTERS)
    z = z + SIGMA_M * rng.standard_normal(z.shape)
    start = PlanarStart(heading_sigma_rad=0.1, velocity_sigma_mps=0.5, position_sigma_m=2.0)
    run = OfdmInertialNavigator(TRANSMITTERS, start).run(imu, RangeChanges(t, z, SIGMA_M))
    P0 = np.diag([0.1, 0.5, 0.5, 2.0, 2.0]) ** 2
    ekf = estimation.ExtendedKalmanFilter("planar_inertial", np.zeros(5), P0)
    ins = process.PlanarMechanization(gyro_sigma_radps=0.1, accelerometer_sigma_mps2=0.1)
    models = [measurement.RangeDifference(q, reference_m=[0.0, 0.0]) for q in TRANSMITTERS]
    nis = []
    for k in range(len(path.t_s)):
        ekf.predict(ins, PERIOD_S, input=[imu.yaw_rate_radps[k], *imu.specific_force_b_mps2[k]])
        if k % 50 == 49:
            nis.append(
                [ekf.update(m, [value], [[SIGMA_M**2]]).nis for m, value in zip(models, z[k // 50], strict=True)]
            )
    np.testing.assert_allclose(run.state[-1], ekf.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.covariance[-1], ekf.P, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(run.links.nis[:, 0], nis, rtol=1e-6)


def test_steps_and_runs_are_the_same() -> None:
    path = drive(5.0)
    imu = path.imu(np.random.default_rng(4))
    t, z = path.change(TRANSMITTERS)
    make = OfdmInertialNavigator(TRANSMITTERS, ambiguity_m=AMBIGUITY_M)
    run = make.run(imu, RangeChanges(t, z, SIGMA_M))
    for k in range(len(path.t_s)):
        step = path.t_s[k] - (path.t_s[k - 1] if k else 0.0)
        assert make.predict(imu.yaw_rate_radps[k], imu.specific_force_b_mps2[k], step) == UpdateStatus.ACCEPTED
        if k % 50 == 49:
            report = make.update(z[k // 50], SIGMA_M)
            np.testing.assert_allclose(report.nis[0], run.links.nis[k // 50, 0], rtol=1e-9)
    np.testing.assert_allclose(make.state, run.state[-1], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(make.covariance, run.covariance[-1], rtol=1e-9, atol=1e-15)


def test_boundaries_are_unwrapped_by_prediction() -> None:
    path = drive(60.0)
    t, z = path.change(TRANSMITTERS)
    nav = OfdmInertialNavigator(TRANSMITTERS, ambiguity_m=AMBIGUITY_M)
    plain = nav.run(path.imu(None), RangeChanges(t, z, SIGMA_M))
    wrapped = nav.run(path.imu(None), RangeChanges(t, z % AMBIGUITY_M - 7 * AMBIGUITY_M, SIGMA_M))
    np.testing.assert_allclose(wrapped.state, plain.state, atol=1e-9)
    assert np.abs(wrapped.links.innovation_m).max() < 1e-6


def monte_carlo(runs: int, seed: int, literal: bool = False) -> tuple[Array, Array, Array]:
    """NEES of all five states at the epochs, NIS, and whether x and y lie inside one sigma."""
    path = drive(60.0)
    t, z = path.change(TRANSMITTERS)
    start_sigma = np.array([0.05, 0.3, 0.3, 1.0, 1.0])
    nees, nis, inside = [], [], []
    for index in range(runs):
        rng = np.random.default_rng([seed, index])
        off = start_sigma * rng.standard_normal(5)
        start = PlanarStart(off[0], (off[1], off[2]), (off[3], off[4]), 0.05, 0.3, 1.0)
        # The reference point of every difference is where the receiver believes to start.
        change = z + np.linalg.norm(TRANSMITTERS, axis=1) - np.linalg.norm(off[3:] - TRANSMITTERS, axis=1)
        noisy = RangeChanges(t, change + SIGMA_M * rng.standard_normal(z.shape), SIGMA_M)
        nav = OfdmInertialNavigator(
            TRANSMITTERS, start, gyro_sigma_radps=0.02, literal_transition=literal, ambiguity_m=AMBIGUITY_M
        )
        run = nav.run(path.imu(rng, gyro=0.02), noisy, record_every=50)
        error = errors(run.state, path.state()[::50])[1:]
        P = run.covariance[1:]
        nees.append(np.einsum("ti,ti->t", error, np.linalg.solve(P, error[..., None])[..., 0]))
        nis.append(run.links.nis[:, 0])
        sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        inside.append(np.abs(error[:, 3:]) < sigma[:, 3:])
    return np.array(nees), np.array(nis), np.array(inside)


def test_consistency() -> None:
    """NEES at the end and NIS of all updates inside chi-square bounds of 1e-4; the literal transition is outside."""
    nees, nis, inside = monte_carlo(100, 11)
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 5 * 100) / 100
    assert low < nees[:, -1].mean() < high
    assert low < nees[:, 20].mean() < high
    low, high = chi2.ppf([5e-5, 1 - 5e-5], nis.size) / nis.size
    assert low < nis.mean() < high
    assert 0.6 < inside.mean() < 0.75
    literal, _, covered = monte_carlo(30, 12, literal=True)
    assert literal[:, -1].mean() > chi2.ppf(1 - 1e-4, 5 * 30) / 30
    assert covered.mean() < inside.mean() - 0.05


def clock_walk(rng: np.random.Generator, psd: tuple[float, float], n: int, k: int) -> Array:
    white, walk = psd
    Q = np.array([[white + walk / 3, walk / 2], [walk / 2, walk]])
    noise = rng.standard_normal((n, k, 2)) @ np.linalg.cholesky(Q).T
    x = np.zeros((k, 2))
    out = np.empty((n, k))
    for i in range(n):
        x = x @ np.array([[1.0, 0.0], [1.0, 1.0]]) + noise[i]
        out[i] = x[:, 0]
    return out


def test_transmitter_clocks_as_states_of_three_receivers() -> None:
    """Three receivers far apart separate their motion from the clocks; NEES of all 25 states is right."""
    psd = (0.036, 0.141)
    starts = [(-500.0, -300.0), (500.0, -300.0), (0.0, 600.0)]
    paths = [drive(40.0, start, turn) for start, turn in zip(starts, (0.05, 0.03, -0.04), strict=True)]
    nees = []
    for index in range(40):
        rng = np.random.default_rng([21, index])
        clock = clock_walk(rng, psd, 40, len(RING))
        changes = []
        for path in paths:
            t, z = path.change(RING)
            changes.append(RangeChanges(t, z - clock + SIGMA_M * rng.standard_normal(z.shape), SIGMA_M))
        nav = OfdmInertialNavigator(
            RING, [PlanarStart(position_m=start) for start in starts], gyro_sigma_radps=0.02, clock=psd,
            ambiguity_m=AMBIGUITY_M,
        )  # fmt: skip
        run = nav.run([p.imu(rng, gyro=0.02) for p in paths], changes, record_every=50)
        truth = np.concatenate([p.state()[-1] for p in paths])
        error = np.concatenate([errors(run.state[-1, :5], truth[:5]), run.state[-1, 5:15] - truth[5:]])
        bias = run.clock_bias_m[-1] - clock[-1]
        kept = [*range(15), *(nav.clock_at(k) for k in range(len(RING)))]
        error = np.concatenate([error, bias])
        for heading in (5, 10):
            error[heading] = (error[heading] + np.pi) % (2 * np.pi) - np.pi
        nees.append(error @ np.linalg.solve(run.covariance[-1][np.ix_(kept, kept)], error))
        np.testing.assert_array_equal(run.receiver(2).position_m[-1], run.state[-1, 13:15])
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 20 * 40) / 40
    assert low < np.mean(nees) < high


def test_reference_receiver_doubles_the_variance_and_takes_the_clocks_out() -> None:
    path = drive(30.0)
    rng = np.random.default_rng(31)
    t, z = path.change(TRANSMITTERS)
    clock = clock_walk(rng, (0.036, 0.141), 30, 3)
    imu = path.imu(rng)
    mobile, still = SIGMA_M * rng.standard_normal((2, *z.shape))
    nav = OfdmInertialNavigator(TRANSMITTERS, reference_receiver=True, ambiguity_m=AMBIGUITY_M)
    run = nav.run(imu, RangeChanges(t, z - clock + mobile, SIGMA_M), reference=RangeChanges(t, still - clock, SIGMA_M))
    plain = OfdmInertialNavigator(TRANSMITTERS, ambiguity_m=AMBIGUITY_M)
    same = plain.run(imu, RangeChanges(t, z + mobile - still, np.sqrt(2.0) * SIGMA_M))
    np.testing.assert_allclose(run.state, same.state, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(run.covariance, same.covariance, rtol=1e-7, atol=1e-12)
    assert (run.reference_status == UpdateStatus.ACCEPTED).all()


def test_two_receivers_share_the_error_of_their_reference() -> None:
    """Against a joint update with the full R of two differences to one reference."""
    nav = OfdmInertialNavigator(
        TRANSMITTERS[:1],
        [PlanarStart(position_m=p, position_sigma_m=3.0) for p in ((0.0, 0.0), (300.0, 100.0))],
        reference_receiver=True,
    )
    P, names = nav.covariance, nav.state_names
    report = nav.update([[3.0], [-2.0]], 2.0, reference=[0.5])
    assert (report.status == UpdateStatus.ACCEPTED).all()
    assert nav.state_names == names
    H = np.zeros((2, 10))
    for i, (place, at) in enumerate((((0.0, 0.0), 3), ((300.0, 100.0), 8))):
        d = np.array(place) - TRANSMITTERS[0]
        H[i, at : at + 2] = d / np.linalg.norm(d)
    R = 4.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    np.testing.assert_allclose(nav.covariance, P - K @ H @ P, atol=1e-6)
    x = np.zeros(10)
    x[8:] = 300.0, 100.0
    np.testing.assert_allclose(nav.state, x + K @ (np.array([3.0, -2.0]) - 0.5), atol=1e-3)


def test_reference_missing_makes_that_transmitter_unusable_once() -> None:
    nav = OfdmInertialNavigator(TRANSMITTERS, reference_receiver=True)
    nav.predict(0.0, [0.0, 0.0], 1.0)
    before = nav.covariance
    report = nav.update(np.zeros(3), SIGMA_M, reference=[np.nan, np.nan, np.nan])
    assert (report.status == UpdateStatus.NON_FINITE).all()
    np.testing.assert_array_equal(nav.covariance, before)
    report = nav.update(np.zeros(3), SIGMA_M, reference=[np.nan, 0.0, 0.0])
    assert list(report.status[0] == UpdateStatus.ACCEPTED) == [False, True, True]


def test_multipath_bias_states_are_consistent() -> None:
    """Slow biases of 10 m on every link: as states the filter is right, without them it is overconfident."""
    path = drive(60.0)
    t, z = path.change(TRANSMITTERS)
    nees = {True: [], False: []}  # type: dict[bool, list[float]]
    decay = np.exp(-1.0 / 20.0)
    for index in range(40):
        rng = np.random.default_rng([41, index])
        bias = np.empty_like(z)
        present = 10.0 * rng.standard_normal(3)
        for i in range(len(t)):
            present = decay * present + 10.0 * np.sqrt(1 - decay**2) * rng.standard_normal(3)
            bias[i] = present
        changes = RangeChanges(t, z + bias + rng.standard_normal(z.shape), 1.0)
        imu = path.imu(rng, gyro=0.02)
        for aware in (True, False):
            nav = OfdmInertialNavigator(
                TRANSMITTERS, gyro_sigma_radps=0.02, multipath=(10.0, 20.0) if aware else None, ambiguity_m=AMBIGUITY_M
            )
            run = nav.run(imu, changes, record_every=50)
            e = errors(run.state[-1, :5], path.state()[-1])
            nees[aware].append(float(e @ np.linalg.solve(run.covariance[-1, :5, :5], e)))
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 5 * 40) / 40
    assert low < np.mean(nees[True]) < high
    assert np.mean(nees[False]) > 3 * high


def test_all_transmitters_lost_for_a_minute() -> None:
    """Coasts, its covariance honest, is not locked out by a gate of 45 m, and recovers."""
    path = drive(150.0)
    t, z = path.change(TRANSMITTERS)
    worst = []
    ends = []
    for index in range(30):
        rng = np.random.default_rng([51, index])
        lost = z + SIGMA_M * rng.standard_normal(z.shape)
        lost[(t > 40.0) & (t <= 100.0)] = np.nan
        nav = OfdmInertialNavigator(TRANSMITTERS, ambiguity_m=AMBIGUITY_M, gate_m=45.0, gate_sigmas=4.0)
        run = nav.run(path.imu(rng), RangeChanges(t, lost, SIGMA_M), record_every=50)
        absent = run.links.status[:, 0] == UpdateStatus.ABSENT
        assert absent[(t > 40.0) & (t <= 100.0)].all()
        e = errors(run.state, path.state()[::50])
        at = int(np.flatnonzero(run.t_s == 100.0)[0])
        worst.append(e[at] @ np.linalg.solve(run.covariance[at], e[at]))
        ends.append(np.linalg.norm(e[-1, 3:]))
    assert chi2.ppf(5e-5, 150) / 30 < np.mean(worst) < 1.25 * chi2.ppf(1 - 5e-5, 150) / 30  # not quite linear by then
    assert np.median(ends) < 6.0
    assert max(ends) < 40.0


def test_gaps_duplicates_and_reversals_of_the_sensors() -> None:
    path = drive(30.0)
    t, z = path.change(TRANSMITTERS)
    imu = path.imu(None)
    keep = (imu.t_s <= 12.0) | (imu.t_s > 13.5)
    order = np.flatnonzero(keep)
    order = np.insert(order, [100, 200], [order[99], order[150]])  # twice the same, and one from before
    broken = Imu(imu.t_s[order], imu.yaw_rate_radps[order], imu.specific_force_b_mps2[order])
    nav = OfdmInertialNavigator(TRANSMITTERS, ambiguity_m=AMBIGUITY_M)
    run = nav.run(broken, RangeChanges(t, z, SIGMA_M))
    assert (run.imu.not_after, run.imu.gaps) == (2, 1)
    assert run.imu.gap_s == pytest.approx(1.5)
    assert (np.diff(run.t_s) > 0.0).all()
    whole = nav.run(imu, RangeChanges(t, z, SIGMA_M))
    at = float(broken.t_s[np.flatnonzero(broken.t_s > 13.0)[0]])
    sigma = np.sqrt(run.position_covariance_m2[run.t_s == at][0].trace())
    assert sigma > 1.2 * np.sqrt(whole.position_covariance_m2[np.isclose(whole.t_s, at)][0].trace())
    e = errors(run.state, np.array([np.interp(run.t_s, np.r_[0.0, path.t_s], c) for c in path.state().T]).T)
    nees = np.einsum("ti,ti->t", e, np.linalg.solve(run.covariance[:] + 1e-12 * np.eye(5), e[..., None])[..., 0])
    assert nees.max() < chi2.ppf(1 - 1e-6, 5)
    assert np.linalg.norm(e[-1, 3:]) < 15.0


def test_samples_that_are_not_finite_or_saturated() -> None:
    path = drive(20.0)
    imu = path.imu(None)
    yaw, force = imu.yaw_rate_radps.copy(), imu.specific_force_b_mps2.copy()
    yaw[300:310] = np.nan
    force[400, 1] = np.inf
    yaw[500:520] = 5.0  # at the end of its range
    nav = OfdmInertialNavigator(TRANSMITTERS, yaw_rate_range_radps=5.0)
    run = nav.run(replace(imu, yaw_rate_radps=yaw, specific_force_b_mps2=force))
    assert np.isfinite(run.state).all()
    assert np.isfinite(run.covariance).all()
    assert (run.imu.not_finite, run.imu.saturated, run.imu.gaps) == (11, 20, 0)
    clean = nav.run(imu)
    assert run.covariance[-1, 0, 0] > clean.covariance[-1, 0, 0]
    assert nav.predict(np.nan, [0.0, 0.0], 0.02) == UpdateStatus.ACCEPTED
    assert nav.predict(0.0, [0.0, 0.0], -0.02) == UpdateStatus.TIME_NOT_ADVANCING
    assert nav.predict(0.0, [0.0, 0.0], np.nan) == UpdateStatus.TIME_NOT_ADVANCING


def test_silent_samples_spread_as_one_silence() -> None:
    """A second without samples, in one step, in fifty, or flickering: the same spread of heading and velocity."""

    def sigma(steps: list[tuple[bool, float]]) -> Array:
        nav = OfdmInertialNavigator(TRANSMITTERS, gyro_sigma_radps=0.0, accelerometer_sigma_mps2=0.0)
        for silent, dt in steps:
            if silent:
                nav.coast(dt)
            else:
                nav.predict(0.0, [0.0, 0.0], dt)
        return np.sqrt(np.diagonal(nav.covariance)[:3])

    whole = sigma([(True, 1.0)])
    np.testing.assert_allclose(whole, [0.5, 2.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(sigma([(True, 0.02)] * 50), whole, rtol=1e-6)
    np.testing.assert_allclose(sigma([(True, 0.02), (False, 0.02)] * 50), whole, rtol=1e-6)
    apart = sigma([*[(True, 0.5)], *[(False, 0.1)] * 25, (True, 0.5)])  # two episodes: variances add
    np.testing.assert_allclose(apart, whole / np.sqrt(2.0), rtol=1e-6)


@pytest.mark.parametrize("what", ["missing", "not finite", "saturated"])
def test_twenty_seconds_without_sensors(what: str) -> None:
    """The covariance keeps up with a drive that nobody measures, whatever it is that is wrong with the samples."""
    path = drive(60.0)
    t, z = path.change(TRANSMITTERS)
    hidden = (path.t_s > 20.0) & (path.t_s <= 40.0)
    nees = []
    for index in range(30):
        rng = np.random.default_rng([61, index])
        imu = path.imu(rng, gyro=0.02)
        heard = z + SIGMA_M * rng.standard_normal(z.shape)
        heard[(t > 20.0) & (t <= 40.0)] = np.nan
        yaw = imu.yaw_rate_radps.copy()
        if what == "missing":
            imu = Imu(*(column[~hidden] for column in (imu.t_s, imu.yaw_rate_radps, imu.specific_force_b_mps2)))
        else:
            yaw[hidden] = np.nan if what == "not finite" else 2.0
            imu = replace(imu, yaw_rate_radps=yaw)
        nav = OfdmInertialNavigator(
            TRANSMITTERS, gyro_sigma_radps=0.02, ambiguity_m=AMBIGUITY_M, yaw_rate_range_radps=2.0,
            unmodelled=(2.0, 2.0),
        )  # fmt: skip
        run = nav.run(imu, RangeChanges(t, heard, SIGMA_M))
        at = int(np.searchsorted(run.t_s, 39.99))
        truth = np.array([np.interp(run.t_s[at], np.r_[0.0, path.t_s], column) for column in path.position.T])
        e, P = run.position_m[at] - truth, run.position_covariance_m2[at]
        nees.append(e @ np.linalg.solve(P, e))
        assert run.imu.gaps == (what == "missing")
    assert np.mean(nees) < chi2.ppf(1 - 1e-4, 60) / 30


def test_a_time_stamp_far_ahead_is_passed_over() -> None:
    path = drive(10.0)
    imu = path.imu(None)
    t = imu.t_s.copy()
    t[200] = 1.7e9
    run = OfdmInertialNavigator(TRANSMITTERS).run(replace(imu, t_s=t))
    assert run.imu.not_after == 1
    assert run.t_s[-1] == path.t_s[-1]
    np.testing.assert_allclose(run.position_m[-1], path.position[-1], atol=0.2)  # one sample is missing there


def test_a_sample_too_large_for_the_state_is_coasted_over() -> None:
    path = drive(5.0)
    imu = path.imu(None)
    force = imu.specific_force_b_mps2.copy()
    force[100] = 1e200
    run = OfdmInertialNavigator(TRANSMITTERS).run(replace(imu, specific_force_b_mps2=force))
    assert run.status == UpdateStatus.ACCEPTED
    assert np.isfinite(run.state).all()
    assert np.isfinite(run.covariance).all()


def test_timing_with_the_filter_in_the_loop() -> None:
    """A callable that answers what was measured is the run on the measurements; its expectation is the model's."""
    path = drive(20.0)
    t, z = path.change(RING)
    rng = np.random.default_rng(71)
    clock = clock_walk(rng, (0.036, 0.141), 20, len(RING))
    z = z - clock + SIGMA_M * rng.standard_normal(z.shape)
    z[7, 2] = np.nan
    imu = path.imu(rng)
    nav = OfdmInertialNavigator(RING, clock=(0.036, 0.141), ambiguity_m=AMBIGUITY_M)
    asked = []

    def timing(epoch: int, receiver: int, transmitter: int, expected_m: float, sigma_m: float) -> tuple[float, float]:
        asked.append((epoch, receiver, transmitter, z[epoch, transmitter] - expected_m, sigma_m))
        return float(z[epoch, transmitter]), SIGMA_M

    plain = nav.run(imu, RangeChanges(t, z, SIGMA_M))
    looped = nav.run(imu, timing=timing, epoch_t_s=t)
    np.testing.assert_array_equal(looped.state, plain.state)
    np.testing.assert_array_equal(looped.links.status, plain.links.status)
    first = np.array([row for row in asked if row[2] == 0])
    np.testing.assert_allclose(first[:, 3], plain.links.innovation_m[:, 0, 0], atol=1e-9)
    np.testing.assert_allclose(first[:, 4] ** 2 + SIGMA_M**2, plain.links.variance_m2[:, 0, 0], rtol=1e-9)

    def raises(*_: float) -> tuple[float, float]:
        raise RuntimeError("no timing today")

    with pytest.raises(RuntimeError, match="no timing today"):
        nav.run(imu, timing=raises, epoch_t_s=t)
    with pytest.raises(ValueError, match="tdoa, timing: one of them expected"):
        nav.run(imu, RangeChanges(t, z, SIGMA_M), timing=timing, epoch_t_s=t)


def test_refused_boundaries_leave_the_state() -> None:
    nav = OfdmInertialNavigator(np.vstack([TRANSMITTERS, [[0.0, 0.0]]]), PlanarStart(position_sigma_m=1.0))
    x, P = nav.state, nav.covariance
    assert (nav.update(np.ones(4), -1.0).status == UpdateStatus.NOT_POSITIVE_DEFINITE).all()
    report = nav.update([np.nan, np.inf, 1.0, 1.0], [1.0, 1.0, 0.0, 1.0])
    assert [UpdateStatus(s).name for s in report.status[0]] == [
        "ABSENT",
        "NON_FINITE",
        "NOT_POSITIVE_DEFINITE",
        "UNDEFINED",  # the transmitter at the receiver
    ]
    np.testing.assert_array_equal(nav.state, x)
    np.testing.assert_array_equal(nav.covariance, P)
    gated = OfdmInertialNavigator(TRANSMITTERS, PlanarStart(position_sigma_m=1.0), gate_m=45.0)
    assert gated.update([46.0, 44.0, np.nan], 1.0).status.tolist()[0][:2] == [UpdateStatus.GATED, UpdateStatus.ACCEPTED]
    wide = OfdmInertialNavigator(TRANSMITTERS, PlanarStart(position_sigma_m=20.0), gate_m=45.0)
    assert wide.update([46.0, np.nan, np.nan], 1.0).status[0, 0] == UpdateStatus.ACCEPTED
    strict = OfdmInertialNavigator(TRANSMITTERS, PlanarStart(position_sigma_m=1.0), gate_probability=1e-3)
    assert strict.update([6.0, 1.0, np.nan], 1.0).status.tolist()[0][:2] == [UpdateStatus.GATED, UpdateStatus.ACCEPTED]


def test_epochs_before_the_start_and_after_the_end() -> None:
    path = drive(5.0)
    t = np.array([-1.0, 0.0, 4.995, 5.7])
    z = np.zeros((4, 3))
    z[2:] = np.nan
    z[3] = path.change(TRANSMITTERS)[1][-1]
    run = OfdmInertialNavigator(TRANSMITTERS).run(path.imu(None), RangeChanges(t, z, SIGMA_M))
    assert [UpdateStatus(s).name for s in run.links.status[:, 0, 0]] == ["TOO_LATE", "ACCEPTED", "ABSENT", "ACCEPTED"]
    assert run.t_s[-1] == 5.7


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"transmitters_m": [[1.0, 2.0, 3.0]]}, "transmitters_m: rows of two numbers"),
        ({"transmitters_m": [[1.0, np.nan]]}, r"transmitters_m\[0\]\[1\] = nan: a finite number expected"),
        ({"start": []}, "starts: 1 ... 16 receivers expected, got 0"),
        (
            {"start": PlanarStart(heading_sigma_rad=-1.0)},
            r"starts\[0\].heading_sigma_rad = -1.0+: a standard deviation",
        ),
        ({"gyro_sigma_radps": np.nan}, "imu.gyro_sigma_radps = -?nan: a standard deviation"),
        ({"ambiguity_m": 0.0}, "ambiguity_m = 0.0+: a positive number expected"),
        ({"gate_m": -3.0}, "gate.residual = -3.0+: a positive number expected"),
        ({"gate_probability": 2.0}, "gate_probability: 2.0 is not between 0 and 1"),
        ({"clock": "quartz"}, "clock: expected a clock or its two power densities"),
        ({"clock": (-1.0, 0.0)}, "transmitter_clock.white_frequency_m2ps = -1.0+"),
        ({"multipath": (1.0, 0.0)}, "multipath.time_constant_s = 0.0+: a positive number"),
    ],
)
def test_impossible_setups(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OfdmInertialNavigator(**{"transmitters_m": TRANSMITTERS, **arguments})  # type: ignore[arg-type]


def test_runs_that_do_not_fit() -> None:
    path = drive(1.0)
    nav = OfdmInertialNavigator(TRANSMITTERS)
    imu = path.imu(None)
    with pytest.raises(ValueError, match=r"tdoa.range_change_m: expected shape \(1, 3\), got \(1, 2\)"):
        nav.run(imu, RangeChanges(np.array([1.0]), np.zeros((1, 2))))
    with pytest.raises(ValueError, match=r"imu.yaw_rate_radps: expected shape \(50,\), got \(49,\)"):
        nav.run(replace(imu, yaw_rate_radps=imu.yaw_rate_radps[1:]))
    with pytest.raises(ValueError, match=r"epoch_t_s\[1\] = 1.0+: finite times that do not fall"):
        nav.run(imu, RangeChanges(np.array([2.0, 1.0]), np.zeros((2, 3))))
    with pytest.raises(ValueError, match="imu: one for each of 1 receivers expected, got 2"):
        nav.run([imu, imu])
    with pytest.raises(ValueError, match="reference_range_change_m: the navigator was made for a reference"):
        OfdmInertialNavigator(TRANSMITTERS, reference_receiver=True).run(
            imu, RangeChanges(np.array([1.0]), np.zeros((1, 3)))
        )
    with pytest.raises(ValueError, match="record_every: at least 1 expected"):
        nav.run(imu, record_every=0)
    with pytest.raises(ValueError, match="receiver: 1 is not among 1"):
        nav.run(imu).receiver(1)


def test_no_transmitters_and_no_samples() -> None:
    nav = OfdmInertialNavigator(np.empty((0, 2)))
    path = drive(1.0)
    assert nav.run(path.imu(None)).links.status.shape == (0, 1, 0)
    empty = nav.run(Imu(np.empty(0), np.empty(0), np.empty((0, 2))))
    assert empty.t_s.tolist() == [0.0]
