"""Adaptive process noise from Python: NumPy's own, runs against steps, convergence, refusals, state kept."""

import copy
import pickle

import numpy as np
import pytest

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.estimation import AdaptiveProcessNoise, UpdateStatus

KINDS = [
    estimation.ExtendedKalmanFilter,
    estimation.IteratedKalmanFilter,
    estimation.UnscentedKalmanFilter,
    estimation.SquareRootKalmanFilter,
    estimation.InformationFilter,
]
X0, P0 = [0.0, 0.0, 1.0, 1.0], np.eye(4)
FIX = measurement.Position(2)


def motion(psd, dt=1.0):
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    Q = np.zeros((4, 4))
    for axis in range(2):
        Q[np.ix_([axis, axis + 2], [axis, axis + 2])] = psd * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F, Q


def drive(steps, rng, psd=1.0, sigma=2.0):
    """Fixes each second of a vehicle that starts as the filter believes."""
    Q = motion(psd)[1]
    w = rng.standard_normal((steps, 4)) @ np.linalg.cholesky(Q).T
    x = np.array(X0) + rng.standard_normal(4)
    v = x[2:] + np.cumsum(w[:, 2:], axis=0)
    before = np.vstack([x[2:], v[:-1]])
    p = x[:2] + np.cumsum(before + w[:, :2], axis=0)
    return np.arange(1.0, steps + 1.0), p + sigma * rng.standard_normal((steps, 2))


# --- References ---


@pytest.mark.crosscheck
def test_a_run_is_that_of_numpy():
    times, z = drive(200, np.random.default_rng(3), psd=5.0)
    R, memory, information, log = np.array([[4.0, 1.0], [1.0, 5.0]]), 60.0, 5.0, 0.0
    noise = AdaptiveProcessNoise(memory=memory)
    kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
    run = kf.run(times, process.NearlyConstantVelocity(1.0), [(FIX, z, R)], start_s=0.0, adaptive_noise=noise)
    x, P, H = np.array(X0), P0.copy(), np.eye(2, 4)
    F, Q = motion(1.0)
    for k in range(200):
        x, P = F @ x, F @ P @ F.T + np.exp(log) * Q
        y, S = z[k] - H @ x, H @ P @ H.T + R
        T = np.linalg.solve(S, S - R)  # eqs. 30 to 33 of cpp/doc/kalman_filter.md
        score = 0.5 * (y @ T @ np.linalg.solve(S, y) - np.trace(T))
        information = np.exp(-1.0 / memory) * information + 0.5 * np.trace(T @ T)
        log = log + np.clip(score / information, -0.7, 0.7)
        K = np.linalg.solve(S, H @ P).T
        x, P = x + K @ y, P - K @ S @ K.T
        np.testing.assert_allclose(run.noise_multiplier[k], np.exp(log), rtol=1e-9)
        np.testing.assert_allclose(run.x[k], x, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(run.P[k], P, rtol=1e-8, atol=1e-9)
    assert noise.multiplier == run.noise_multiplier[-1]
    assert noise.information == pytest.approx(information, rel=1e-9)


# --- Laws ---


@pytest.mark.law
@pytest.mark.parametrize(
    ("state", "x", "model", "u"),
    [
        ("position2", [1.0, 2.0], process.RandomWalk([0.5, 0.2]), None),
        ("position_velocity2", [1.0, 2.0, 3.0, 4.0], process.NearlyConstantVelocity([0.3, 0.7]), None),
        (
            "position_velocity_clock2",
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            process.NearlyConstantVelocity(0.3, clock=(0.1, 0.2), diffusion_psd=0.01),
            None,
        ),
        ("position_velocity2", [1.0, 2.0, 3.0, 4.0], process.PiecewiseConstantAcceleration([0.3, 0.7]), None),
        ("coordinated_turn", [1.0, 2.0, 3.0, 4.0, 0.2], process.CoordinatedTurn(0.3, 0.02), None),
        (
            "planar_inertial",
            [0.3, 1.0, 2.0, 3.0, 4.0],
            process.PlanarMechanization(gyro_sigma_radps=0.01, accelerometer_sigma_mps2=0.2, diffusion_psd=0.1),
            [0.1, 1.0, 0.3],
        ),
        (
            "pose2",
            [1.0, 2.0, 0.3],
            process.PlanarOdometry(np.diag([0.01, 0.02, 0.03]), diffusion_psd=0.1),
            [0.5, 0.1, 0.2],
        ),
    ],
)
def test_scaled_noise_is_all_that_changes(state, x, model, u):
    before = repr(model)
    next_x, F, Q = model.propagate(state, x, 0.7, u)
    scaled = AdaptiveProcessNoise(initial=7.0).scaled(model)
    scaled_x, scaled_F, scaled_Q = scaled.propagate(state, x, 0.7, u)
    np.testing.assert_array_equal(scaled_x, next_x)
    np.testing.assert_array_equal(scaled_F, F)
    np.testing.assert_allclose(scaled_Q, 7.0 * Q, rtol=1e-13)
    assert np.trace(Q) > 0.0
    assert scaled.kind == model.kind
    assert repr(model) == before


@pytest.mark.law
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_has_the_bits_of_its_steps(kind):
    times, z = drive(60, np.random.default_rng(1), psd=4.0)
    z[40] += 300.0
    z[51, 0] = np.nan
    heard = np.arange(60) % 4 != 2
    stated = process.NearlyConstantVelocity(0.5)
    runner, kf = (kind("position_velocity2", X0, P0) for _ in range(2))
    run_noise, noise = AdaptiveProcessNoise(memory=100.0), AdaptiveProcessNoise(memory=100.0)
    run = runner.run(
        times, stated, [(FIX, z, 4.0, heard)], start_s=0.0, gate_nis=40.0, smooth=True, adaptive_noise=run_noise
    )
    seen = set()
    for k in range(60):
        assert kf.predict(noise.scaled(stated), 1.0) == UpdateStatus.ACCEPTED
        if heard[k]:
            report = kf.update(FIX, z[k], 4.0, gate_nis=40.0)
            before = noise.multiplier
            learnt = report.status in (UpdateStatus.ACCEPTED, UpdateStatus.GATED)
            assert noise.observe(report, 4.0) == learnt
            assert learnt or noise.multiplier == before
            seen.add(report.status)
        assert run.noise_multiplier[k] == noise.multiplier
        np.testing.assert_array_equal(run.x[k], kf.x)
        np.testing.assert_array_equal(run.P[k], kf.P)
    assert seen == {UpdateStatus.ACCEPTED, UpdateStatus.GATED, UpdateStatus.NON_FINITE}
    assert run_noise.information == noise.information
    np.testing.assert_array_equal(run.x_smooth[-1], run.x[-1])
    assert not run.noise_multiplier.flags.writeable
    plain = kind("position_velocity2", X0, P0).run(times, stated, [(FIX, z, 4.0, heard)], start_s=0.0)
    assert plain.noise_multiplier is None


@pytest.mark.law
def test_a_driven_run_has_the_bits_of_its_steps():
    # The planar mechanisation has a loop of its own.
    rng = np.random.default_rng(8)
    inputs = rng.standard_normal((80, 3)) * [0.1, 0.5, 0.5]
    ins = process.PlanarMechanization(gyro_sigma_radps=0.01, accelerometer_sigma_mps2=0.05)
    z = rng.standard_normal((80, 2))
    runner, kf = (estimation.ExtendedKalmanFilter("planar_inertial", np.zeros(5), 0.5) for _ in range(2))
    run_noise, noise = AdaptiveProcessNoise(), AdaptiveProcessNoise()
    times = 0.25 * np.arange(80)
    run = runner.run(times, ins, [(FIX, z, 1.0)], inputs=inputs, adaptive_noise=run_noise)
    for k in range(80):
        if k > 0:
            kf.predict(noise.scaled(ins), 0.25, input=inputs[k])
        noise.observe(kf.update(FIX, z[k], 1.0), 1.0)
        assert run.noise_multiplier[k] == noise.multiplier
    np.testing.assert_array_equal(run.x[-1], kf.x)
    assert noise.multiplier != 1.0


# --- Statistics ---


def learn(factor, seed, sigma=2.0, runs=25, steps=4000):
    """Logarithms of the multipliers learnt over their right value, and the mean NIS after that."""
    stated = process.NearlyConstantVelocity(1.0 / factor)
    off, nis = np.empty(runs), np.empty(runs)
    for i, rng in enumerate(np.random.default_rng(seed).spawn(runs)):
        times, z = drive(steps + 400, rng, sigma=sigma)
        kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
        noise = AdaptiveProcessNoise(memory=400.0)
        kf.run(times[:steps], stated, [(FIX, z[:steps], 4.0)], start_s=0.0, history=False, adaptive_noise=noise)
        off[i] = np.log(noise.multiplier / factor)
        rest = kf.run(times[steps:], noise.scaled(stated), [(FIX, z[steps:], 4.0)], start_s=times[steps - 1])
        nis[i] = np.mean(rest.nis)
    return off, nis.mean()


@pytest.mark.consistency
@pytest.mark.parametrize("factor", [10.0, 0.1, 1.0])
def test_finds_noise_that_is_ten_times_off(factor):
    # Measured over 300 runs: one scatters by 0.09 about a mean within 0.03 of zero. Bounds at 4.5 deviations of the
    # mean of 25, at six of one, and at 4.5 of the mean NIS.
    off, nis = learn(factor, 211)
    assert abs(off.mean()) < 0.03 + 4.5 * 0.09 / 5.0
    assert np.abs(off).max() < 0.03 + 6.0 * 0.09
    assert abs(nis - 2.0) < 0.02 + 4.5 * np.sqrt(4.0 / (25 * 400))


@pytest.mark.consistency
def test_a_wrong_measurement_noise_is_answered_by_a_wrong_multiplier():
    off, _ = learn(1.0, 211, sigma=2.0 * np.sqrt(2.0))
    assert abs(off.mean()) > 1.0  # the bounds above are far below what this does


# --- Refusals and state kept ---


@pytest.mark.unit
def test_options_that_break_their_rule_are_named():
    for options, match in (
        ({"lower": 0.0}, "lower: 0"),
        ({"upper": 1e-5}, "upper: "),
        ({"initial": 1e9}, "initial: "),
        ({"initial": np.nan}, "initial: nan"),
        ({"memory": 0.5}, "memory: 0.5"),
        ({"memory": np.inf}, "memory: inf"),
        ({"prior_information": 0.0}, "prior_information: 0"),
    ):
        with pytest.raises(ValueError, match=match):
            AdaptiveProcessNoise(**options)


@pytest.mark.unit
def test_bad_arguments_are_named_and_change_nothing():
    kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
    noise, stated = AdaptiveProcessNoise(initial=2.0), process.NearlyConstantVelocity(1.0)
    report = kf.copy().update(FIX, [1.0, 1.0], 1.0)
    before = pickle.dumps((kf, noise))
    assert not noise.observe(kf.copy().update(FIX, [np.nan, 1.0], 1.0), 1.0)
    assert not noise.observe(report, np.nan)
    with pytest.raises(ValueError, match="R: expected"):
        noise.observe(report, np.eye(3))
    with pytest.raises(TypeError, match="adaptive_noise: expected AdaptiveProcessNoise, got float"):
        kf.run([0.0], stated, adaptive_noise=2.0)
    with pytest.raises(ValueError, match=r"measurements\[0\]: z"):
        kf.run([0.0], stated, [(FIX, np.zeros((2, 2)), 1.0)], adaptive_noise=noise)
    with pytest.raises(ValueError, match="CoordinatedTurn moves a turn rate"):
        kf.run([0.0, 1.0], process.CoordinatedTurn(1.0, 1.0), [(FIX, np.ones((2, 2)), 1.0)], adaptive_noise=noise)
    # A run that fails at its end, when much was learnt already.
    blind = estimation.InformationFilter("position_velocity2", X0, information=0.0)
    times, z = drive(20, np.random.default_rng(1))
    again = noise.copy()
    blind.copy().run(times, stated, [(FIX, z, 4.0)], adaptive_noise=again)
    assert again.multiplier != noise.multiplier
    with pytest.raises(ValueError, match="smooth: "):
        blind.run(times, stated, [(FIX, z, 4.0)], smooth=True, adaptive_noise=noise)
    assert pickle.dumps((kf, noise)) == before


@pytest.mark.unit
def test_the_multiplier_keeps_its_bounds():
    kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
    noise = AdaptiveProcessNoise(lower=0.5, upper=3.0)
    for _ in range(6):
        assert noise.observe(kf.update(FIX, [1e4, 1e4], 1.0, gate_nis=9.0), 1.0)
    assert noise.multiplier == pytest.approx(3.0, rel=1e-12)
    for _ in range(200):
        kf.predict(noise.scaled(process.NearlyConstantVelocity(10.0)), 1.0)
        noise.observe(kf.update(FIX, kf.x[:2], 1.0), 1.0)
    assert noise.multiplier == pytest.approx(0.5, rel=1e-12)


@pytest.mark.law
def test_pickles_and_copies_go_on_alike():
    times, z = drive(60, np.random.default_rng(2), psd=9.0)
    stated = process.NearlyConstantVelocity(1.0)
    kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
    noise = AdaptiveProcessNoise(initial=0.7, lower=0.1, upper=50.0, memory=80.0, prior_information=2.0)
    kf.run(times[:30], stated, [(FIX, z[:30], 4.0)], adaptive_noise=noise)
    others = [pickle.loads(pickle.dumps(noise)), copy.copy(noise), copy.deepcopy(noise), noise.copy()]
    kept, start = noise.multiplier, kf.copy()
    run = kf.run(times[30:], stated, [(FIX, z[30:], 4.0)], start_s=times[29], adaptive_noise=noise)
    for other in others:
        assert other.multiplier == kept
        again = start.copy().run(times[30:], stated, [(FIX, z[30:], 4.0)], start_s=times[29], adaptive_noise=other)
        np.testing.assert_array_equal(again.noise_multiplier, run.noise_multiplier)
        assert (other.multiplier, other.information) == (noise.multiplier, noise.information)
    assert repr(AdaptiveProcessNoise()) == "AdaptiveProcessNoise(multiplier 1, information 5)"
