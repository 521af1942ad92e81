"""Interacting multiple models from Python: NumPy's own, whole runs against steps, calibration, refusals, state kept."""

import copy
import pickle

import numpy as np
import pytest

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.estimation import UpdateStatus

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
X0, P0 = [30.0, 60.0, 2.0, -1.0], np.diag([4.0, 4.0, 1.0, 1.0])
CALM, HARD = process.NearlyConstantVelocity(0.01), process.NearlyConstantVelocity([2.0, 4.0])
CHAIN = np.array([[0.95, 0.05], [0.1, 0.9]])


def imm(processes=(CALM, HARD), transition=CHAIN, **options):
    return estimation.InteractingMultipleModel("position_velocity2", X0, P0, processes, transition, **options)


def fixes(steps, seed=0):
    """A drive with a swerve in its middle: times that are not even, and fixes of one metre."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.3, 0.8, steps)
    x, v = np.array(X0[:2]), np.array(X0[2:])
    z = np.empty((steps, 2))
    for k in range(steps):
        if steps // 3 < k < steps // 2:
            v = v + dt[k] * np.array([3.0, -4.0])
        x = x + dt[k] * v
        z[k] = x + rng.standard_normal(2)
    return np.cumsum(dt), z


# --- References ---


def density(y, S):
    return np.exp(-0.5 * y @ np.linalg.solve(S, y)) / np.sqrt(np.linalg.det(2.0 * np.pi * S))


def motion(psd, dt):
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    Q = np.zeros((4, 4))
    for axis, q in enumerate(psd):
        Q[np.ix_([axis, axis + 2], [axis, axis + 2])] = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F, Q


def numpy_imm(times, z, R, heard, psds, chain, mu):
    """Blom and Bar-Shalom's cycle on a linear system with fixes, likelihoods as they stand."""
    modes, H, last, total = len(mu), np.eye(2, 4), 0.0, 0.0
    x, P = np.tile(X0, (modes, 1)), np.tile(P0, (modes, 1, 1))
    out = {"x": [], "P": [], "probabilities": [], "predicted_probabilities": [], "nis": []}
    for time, fix, there in zip(times, z, heard, strict=True):
        ahead = mu @ chain
        weights = chain * mu[:, None] / ahead
        mixed = weights.T @ x
        apart = x[None] - mixed[:, None]
        spread = np.einsum("ij,jia,jib->jab", weights, apart, apart) + np.einsum("ij,iab->jab", weights, P)
        y, S = np.empty((modes, 2)), np.empty((modes, 2, 2))
        for j, psd in enumerate(psds):
            F, Q = motion(psd, time - last)
            x[j], P[j] = F @ mixed[j], F @ spread[j] @ F.T + Q
            y[j], S[j] = fix - H @ x[j], H @ P[j] @ H.T + R
        mu, last = ahead, time
        out["predicted_probabilities"].append(mu)
        nis = np.nan
        if there:
            mean = mu @ y
            both = sum(m * (s + np.outer(e - mean, e - mean)) for m, s, e in zip(mu, S, y, strict=True))
            nis = mean @ np.linalg.solve(both, mean)
            likelihood = np.array([density(e, s) for e, s in zip(y, S, strict=True)])
            total += np.log(mu @ likelihood)
            mu = mu * likelihood / (mu @ likelihood)
            for j in range(modes):
                K = np.linalg.solve(S[j], H @ P[j]).T
                x[j], P[j] = x[j] + K @ y[j], P[j] - K @ S[j] @ K.T
        mean = mu @ x
        out["x"].append(mean)
        out["P"].append(sum(m * (p + np.outer(e - mean, e - mean)) for m, p, e in zip(mu, P, x, strict=True)))
        out["probabilities"].append(mu)
        out["nis"].append(nis)
    return {name: np.array(values) for name, values in out.items()}, total


@pytest.mark.crosscheck
@pytest.mark.parametrize("modes", [2, 3])
def test_a_run_is_that_of_numpy(modes):
    times, z = fixes(80)
    R = np.array([[1.0, 0.4], [0.4, 1.5]])
    heard = np.arange(80) % 5 != 3
    psds = np.array([[0.01, 0.01], [2.0, 4.0], [9.0, 0.5]])[:modes]
    chain = np.array([[0.9, 0.07, 0.03], [0.1, 0.85, 0.05], [0.2, 0.0, 0.8]])[:modes, :modes]
    chain = chain / chain.sum(axis=1, keepdims=True)
    mu = np.array([0.6, 0.3, 0.1])[:modes] / np.sum([0.6, 0.3, 0.1][:modes])
    expected, total = numpy_imm(times, z, R, heard, psds, chain, mu)
    estimator = imm([process.NearlyConstantVelocity(psd) for psd in psds], chain, probabilities=mu)
    run = estimator.run(times, [(measurement.Position(2), z, R, heard)], start_s=0.0)
    for name, values in expected.items():
        np.testing.assert_allclose(np.squeeze(getattr(run, name)), values, rtol=1e-9, atol=1e-9, err_msg=name)
    assert run.log_likelihood == pytest.approx(total, rel=1e-10)
    assert run.probabilities[:, 0].min() < 0.1  # the swerve was noticed
    np.testing.assert_allclose(estimator.probabilities @ estimator.mode_x, estimator.x, rtol=1e-12)
    np.testing.assert_array_equal(estimator.x, run.x[-1])


# --- Laws ---


@pytest.mark.law
@pytest.mark.parametrize("modes", range(1, 7))
def test_equal_modes_are_one_filter(modes):
    times, z = fixes(30)
    ranges = np.linalg.norm(z[:, None] - NODES[:2], axis=2)
    groups = [([measurement.Range(q) for q in NODES[:2]], ranges, 1.0)]
    chain = np.full((modes, modes), 1.0 / modes)
    run = imm([CALM] * modes, chain).run(times, groups, start_s=0.0, gate_nis=25.0)
    one = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0).run(
        times, CALM, groups, start_s=0.0, gate_nis=25.0
    )
    np.testing.assert_allclose(run.x, one.x, rtol=1e-10)
    np.testing.assert_allclose(run.P, one.P, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.nis, one.nis, rtol=1e-8)
    assert run.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-10)
    np.testing.assert_allclose(run.probabilities, 1.0 / modes, rtol=1e-12)


@pytest.mark.law
def test_a_run_has_the_bits_of_its_steps():
    times, z = fixes(40)
    mask = np.arange(40) % 3 != 0
    models = [measurement.Range(q) for q in NODES]
    ranges = np.linalg.norm(z[:, None] - NODES, axis=2)
    angle = np.where(np.arange(40) == 20, 1.0, np.arctan2(-z[:, 1], -z[:, 0]))  # one is an outlier
    bearing = measurement.Azimuth([0.0, 0.0])
    x0, p0 = [*X0, 0.0], np.diag([4.0, 4.0, 1.0, 1.0, 0.01])
    straight = process.NearlyConstantVelocity(1.0, diffusion_psd=[0.0, 0.0, 0.0, 0.0, 1e-4])
    turn = process.CoordinatedTurn(1.0, 0.5)
    runner, stepper = (
        estimation.InteractingMultipleModel("coordinated_turn", x0, p0, [straight, turn], CHAIN) for _ in range(2)
    )
    groups = [(models, ranges, 2.0, mask), (bearing, angle, 0.01)]
    run = runner.run(times, groups, start_s=0.0, gate_nis=30.0)
    last, total = 0.0, 0.0
    for k, time in enumerate(times):
        assert stepper.predict(time - last) == UpdateStatus.ACCEPTED
        last = time
        np.testing.assert_array_equal(stepper.probabilities, run.predicted_probabilities[k])
        for g, (model, value, noise) in enumerate([(models, ranges[k], 2.0), (bearing, angle[k], 0.01)]):
            if g == 0 and not mask[k]:
                assert np.isnan(run.nis[k, 0])
                assert run.status[k, 0] == UpdateStatus.ABSENT
                continue
            report = stepper.update(model, value, noise, gate_nis=30.0)
            assert report.status == run.status[k, g]
            assert report.nis == run.nis[k, g]
            assert report.accepted == np.isfinite(report.log_likelihood)
            total += report.log_likelihood if report.accepted else 0.0
        np.testing.assert_array_equal(stepper.x, run.x[k])
        np.testing.assert_array_equal(stepper.P, run.P[k])
        np.testing.assert_array_equal(stepper.probabilities, run.probabilities[k])
    assert run.log_likelihood == pytest.approx(total, rel=1e-12)
    assert pickle.dumps(runner) == pickle.dumps(stepper)
    assert 0 < np.count_nonzero(run.status == UpdateStatus.GATED) < 5
    short = estimation.InteractingMultipleModel("coordinated_turn", x0, p0, [straight, turn], CHAIN).run(
        times, groups, start_s=0.0, gate_nis=30.0, history=False
    )
    np.testing.assert_array_equal(short.x, run.x[-1:])
    np.testing.assert_array_equal(short.probabilities, run.probabilities)


@pytest.mark.law
def test_modes_on_either_side_of_the_seam():
    # The world turned by half a circle: headings near pi instead of near zero, all else alike.
    walks = [process.RandomWalk([0.01, 0.01, q]) for q in (1e-3, 1.0)]
    rng = np.random.default_rng(4)
    seen = 0.3 * np.cumsum(rng.standard_normal(25)) / 5.0
    runs = []
    for turn in (0.0, np.pi):
        sign = np.cos(turn)
        estimator = estimation.InteractingMultipleModel(
            "pose2", [0.0, 0.0, turn], np.diag([0.1, 0.1, 0.3]), walks, CHAIN
        )
        model = measurement.Azimuth([sign * 50.0, 0.0], heading_rad=None)
        runs.append(estimator.run(np.arange(25.0), [(model, seen, 0.01)]))
    plain, turned = runs
    assert np.any(turned.x[:, 2] > 3.0)
    assert np.any(turned.x[:, 2] < -3.0)
    np.testing.assert_allclose(np.sin(turned.x[:, 2]), -np.sin(plain.x[:, 2]), atol=1e-9)
    np.testing.assert_allclose(turned.x[:, :2], -plain.x[:, :2], atol=1e-9)
    flip = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(turned.P, plain.P * np.outer(flip, flip), rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(turned.probabilities, plain.probabilities, rtol=1e-8)


@pytest.mark.law
def test_a_callable_is_the_built_in_model():
    z = fixes(20)[1]
    models = [measurement.Range(q) for q in NODES]
    ranges = np.linalg.norm(z[:, None] - NODES, axis=2)

    def look(x):
        away = x[:2] - NODES
        far = np.linalg.norm(away, axis=1)
        return far, np.hstack([away / far[:, None], np.zeros((4, 2))])

    builtin, own = imm(), imm()
    for k in range(20):
        for estimator, model in ((builtin, models), (own, look)):
            estimator.predict(0.5)
            assert estimator.update(model, ranges[k], 1.0).accepted
        np.testing.assert_allclose(own.x, builtin.x, rtol=1e-10)
        np.testing.assert_allclose(own.probabilities, builtin.probabilities, rtol=1e-8, atol=1e-14)
    before = pickle.dumps(own)
    with pytest.raises(ZeroDivisionError):
        own.update(lambda x: 1 / 0, 1.0, 1.0)
    assert pickle.dumps(own) == before


@pytest.mark.law
def test_driven_modes_take_the_same_input():
    ins = [process.PlanarMechanization(accelerometer_sigma_mps2=sigma) for sigma in (0.01, 1.0)]
    start = ([0.0, 3.0, 0.0, 0.0, 0.0], np.diag([0.01, 1.0, 1.0, 1.0, 1.0]))
    estimator, stepper = (estimation.InteractingMultipleModel("planar_inertial", *start, ins, CHAIN) for _ in range(2))
    inputs = np.tile([0.1, 0.5, 0.0], (30, 1))
    inputs[7, 1] = np.nan
    times = 0.1 * np.arange(1, 31)
    z = np.column_stack([3.0 * times, np.zeros(30)])
    run = estimator.run(times, [(measurement.Position(2), z, 1.0)], inputs=inputs, start_s=0.0)
    assert list(np.flatnonzero(run.predict_status)) == [7]
    assert run.status[7, 0] == run.predict_status[7] == UpdateStatus.NON_FINITE
    np.testing.assert_array_equal(run.x[7], run.x[6])
    assert "1 steps not predicted" in repr(run)
    last = 0.0
    for k, time in enumerate(times):
        if stepper.predict(time - last, input=inputs[k]) == UpdateStatus.ACCEPTED:
            last = time
            stepper.update(measurement.Position(2), z[k], 1.0)
    np.testing.assert_array_equal(stepper.x, estimator.x)
    with pytest.raises(ValueError, match="input: PlanarMechanization expects 3 numbers, got 0"):
        estimator.predict(0.1)
    with pytest.raises(ValueError, match=r"inputs: PlanarMechanization expects shape \(2, 3\)"):
        estimator.run([9.0, 9.1])


# --- Statistics ---


def calibration(stated_R, seed):
    """Of 1000 drives, each by one of two motions that never changes: deviation of the sum of the posterior
    probabilities of the second from how often it was true, in its own standard deviations."""
    rng = np.random.default_rng(seed)
    psds, dt, steps = (0.3, 1.0), 0.5, 40
    off, variance = 0.0, 0.0
    for _ in range(1000):
        true = int(rng.random() < 0.4)
        F, Q = motion([psds[true]] * 2, dt)
        L = np.linalg.cholesky(Q)
        x = np.array(X0) + np.sqrt(np.diag(P0)) * rng.standard_normal(4)
        z = np.empty((steps, 2))
        for k in range(steps):
            x = F @ x + L @ rng.standard_normal(4)
            z[k] = x[:2] + rng.standard_normal(2)
        estimator = imm([process.NearlyConstantVelocity(psd) for psd in psds], np.eye(2), probabilities=[0.6, 0.4])
        times = dt * np.arange(1, steps + 1)
        run = estimator.run(times, [(measurement.Position(2), z, stated_R)], start_s=0.0, history=False)
        p = run.probabilities[-1, 1]
        off += true - p
        variance += p * (1.0 - p)
    return off / np.sqrt(variance)


@pytest.mark.consistency
def test_probabilities_are_calibrated():
    # A chain that never switches on a linear system: the posterior is exact, and whether the second motion was true is
    # a coin of that probability. 4.5 standard deviations of a sum of 1000 bounded terms: probability below 1e-4.
    assert abs(calibration(1.0, 11)) < 4.5
    assert abs(calibration(2.0, 11)) > 4.5  # and a wrong noise is seen


@pytest.mark.consistency
def test_beats_either_model_on_a_manoeuvre():
    rng = np.random.default_rng(101)
    calm, hard = process.NearlyConstantVelocity(1e-3), process.NearlyConstantVelocity(10.0)
    chain = [[0.98, 0.02], [0.05, 0.95]]
    rate = np.where((np.arange(150) >= 60) & (np.arange(150) < 80), 0.2, 0.0)
    velocity = 20.0 * np.exp(1j * np.cumsum(rate))
    track = np.cumsum(0.5 * (velocity + np.concatenate([[20.0], velocity[:-1]])))
    truth = np.column_stack([track.real, track.imag])
    square, in_turn, in_cruise = np.zeros(3), 0.0, 0.0
    for _ in range(40):
        z = truth + 10.0 * rng.standard_normal((150, 2))
        p0 = np.diag([100.0, 100.0, 1.0, 1.0])
        x0 = np.array([0.0, 0.0, 20.0, 0.0]) + np.sqrt(np.diag(p0)) * rng.standard_normal(4)
        state = ("position_velocity2", x0, p0)
        groups, times = [(measurement.Position(2), z, 100.0)], np.arange(1.0, 151.0)
        estimator = estimation.InteractingMultipleModel(*state, [calm, hard], chain, probabilities=[0.9, 0.1])
        run = estimator.run(times, groups, start_s=0.0)
        alone = [estimation.ExtendedKalmanFilter(*state).run(times, one, groups, start_s=0.0) for one in (calm, hard)]
        for i, each in enumerate([run, *alone]):
            square[i] += np.mean(np.sum((each.x[:, :2] - truth) ** 2, axis=1))
        in_turn += run.probabilities[68:80, 1].mean() / 40
        in_cruise += run.probabilities[20:60, 1].mean() / 40
    rmse = np.sqrt(square / 40)
    assert rmse[0] < 0.9 * rmse[2]
    assert rmse[0] < 0.5 * rmse[1]
    assert in_turn > 0.75
    assert in_cruise < 0.2


# --- Refusals ---


@pytest.mark.unit
@pytest.mark.parametrize(
    ("z", "R", "status"),
    [
        ([np.nan, 60.0], 1.0, UpdateStatus.NON_FINITE),
        ([30.0, np.inf], 1.0, UpdateStatus.NON_FINITE),
        ([30.0, 60.0], np.nan, UpdateStatus.NON_FINITE),
        ([30.0, 60.0], 0.0, UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([30.0, 60.0], [1.0, -1.0], UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([30.0, 60.0], [[1.0, 0.5], [0.1, 1.0]], UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([300.0, 60.0], 1.0, UpdateStatus.GATED),
    ],
)
def test_refused_measurements_change_nothing(z, R, status):
    estimator = imm()
    assert estimator.predict(1.0) == UpdateStatus.ACCEPTED
    before = pickle.dumps(estimator)
    report = estimator.update(measurement.Position(2), z, R, gate_nis=30.0)
    assert report.status == status
    assert np.isnan(report.log_likelihood)
    assert pickle.dumps(estimator) == before


@pytest.mark.unit
def test_steps_that_are_none_change_nothing():
    estimator = imm()
    estimator.predict(1.0)
    before = pickle.dumps(estimator)
    for dt in (0.0, -1.0, np.nan, np.inf):
        assert estimator.predict(dt) == UpdateStatus.TIME_NOT_ADVANCING
    assert estimator.predict(1e300) == UpdateStatus.NON_FINITE
    on_top = imm()
    assert on_top.update(measurement.Range(X0[:2]), 1.0, 1.0).status == UpdateStatus.UNDEFINED
    assert pickle.dumps(estimator) == before
    # Too far for any mode's density to be a number: decided by logarithms all the same.
    assert estimator.update(measurement.Position(2), [5e3, 60.0], 1.0).accepted
    assert estimator.probabilities.sum() == pytest.approx(1.0, rel=1e-12)
    assert estimator.probabilities[1] > 0.999


@pytest.mark.unit
def test_bad_chains_are_named():
    for chain, match in (
        ([[0.9, 0.2], [0.1, 0.9]], "transition, row 0: sums to 1.1"),
        ([[0.9, 0.1], [0.1, 0.8]], "transition, row 1: sums to 0.9"),
        ([[1.5, -0.5], [0.1, 0.9]], r"transition\(0, 0\): 1.5"),
        ([[0.9, 0.1], [np.nan, 0.9]], r"transition\(1, 0\): nan"),
        (np.eye(3), r"transition: expected shape \(2, 2\)"),
        ([1.0, 0.0], r"transition: expected shape \(2, 2\)"),
    ):
        with pytest.raises(ValueError, match=match):
            imm(transition=chain)
    for probabilities, match in (
        ([0.5, 0.6], "probabilities: sums to 1.1"),
        ([-0.5, 1.5], r"probabilities\[0\]: -0.5"),
        ([np.nan, 1.0], r"probabilities\[0\]: nan"),
        ([1.0], r"probabilities: expected shape \(2,\)"),
    ):
        with pytest.raises(ValueError, match=match):
            imm(probabilities=probabilities)
    with pytest.raises(ValueError, match="processes: 0, expected 1 to 6"):
        imm([], np.zeros((0, 0)))
    with pytest.raises(ValueError, match="processes: 7, expected 1 to 6"):
        imm([CALM] * 7, np.eye(7))
    with pytest.raises(TypeError, match=r"processes\[1\]: expected a process model, got str"):
        imm([CALM, "fast"])
    with pytest.raises(ValueError, match="CoordinatedTurn moves a turn rate"):
        imm([CALM, process.CoordinatedTurn(1.0, 1.0)])
    with pytest.raises(ValueError, match="x0"):
        estimation.InteractingMultipleModel("position2", [np.nan, 0.0], 1.0, [process.RandomWalk(1.0)], [[1.0]])
    with pytest.raises(ValueError, match="P0: expected"):
        estimation.InteractingMultipleModel("position2", [0.0, 0.0], np.eye(3), [process.RandomWalk(1.0)], [[1.0]])


@pytest.mark.unit
def test_bad_arguments_are_named():
    estimator = imm()
    before = pickle.dumps(estimator)
    model, times, z = measurement.Range(NODES[0]), np.arange(3.0), np.full(3, 60.0)
    with pytest.raises(ValueError, match="z: expected 1 numbers"):
        estimator.update(model, [1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="R: expected"):
        estimator.update(model, 1.0, np.eye(2))
    with pytest.raises(ValueError, match="Pseudorange reads"):
        estimator.update(measurement.Pseudorange(NODES[0]), 1.0, 1.0)
    with pytest.raises(ValueError, match="gate_nis: expected a positive"):
        estimator.update(model, 1.0, 1.0, gate_nis=-1.0)
    with pytest.raises(ValueError, match="input: NearlyConstantVelocity expects 0"):
        estimator.predict(1.0, input=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"time_s\[2\]: time must rise"):
        estimator.run([0.0, 1.0, 0.5])
    with pytest.raises(ValueError, match=r"time_s\[1\] is not finite"):
        estimator.run([0.0, np.nan, 1.0])
    with pytest.raises(ValueError, match=r"start_s: .* is not before time_s\[0\]"):
        estimator.run(times, start_s=0.0)
    with pytest.raises(ValueError, match=r"measurements\[0\]: z: expected shape \(3, 1\)"):
        estimator.run(times, [(model, z[:2], 1.0)])
    with pytest.raises(ValueError, match=r"measurements\[1\]: mask: expected bool"):
        estimator.run(times, [(model, z, 1.0), (model, z, 1.0, [1, 0, 1])])
    with pytest.raises(ValueError, match=r"measurements\[0\]: expected \(model, z, R\)"):
        estimator.run(times, [(model, z)])
    with pytest.raises(ValueError, match="Pseudorange reads"):
        estimator.run(times, [(measurement.Pseudorange(NODES[0]), z, 1.0)])
    with pytest.raises(ValueError, match="variance: expected 4 numbers"):
        estimator.set_covariance_floor([1.0])
    assert pickle.dumps(estimator) == before


# --- State kept ---


@pytest.mark.law
def test_pickles_and_copies_go_on_alike():
    times, z = fixes(30)
    estimator = imm(probabilities=[0.9, 0.1])
    fresh = pickle.loads(pickle.dumps(estimator))
    np.testing.assert_array_equal(estimator.P, P0)
    np.testing.assert_array_equal(fresh.P, P0)
    estimator.set_covariance_floor([0.8, 0.3, 0.05, 0.05])
    estimator.run(times[:15], [(measurement.Position(2), z[:15], 1.0)])
    assert sum(map(sum, estimator.covariance_floor_counts)) > 0
    others = [pickle.loads(pickle.dumps(estimator)), copy.copy(estimator), copy.deepcopy(estimator), estimator.copy()]
    saved, at = estimator.__getstate__(), estimator.x
    for other in others:
        for name in ("x", "P", "probabilities", "mode_x", "mode_P", "transition"):
            np.testing.assert_array_equal(getattr(other, name), getattr(estimator, name), err_msg=name)
        assert other.covariance_floor_counts == estimator.covariance_floor_counts
        assert other.processes == estimator.processes
    group = [(measurement.Position(2), z[15:], 1.0)]
    estimator.run(times[15:], group, start_s=times[14])
    for other in others:
        np.testing.assert_array_equal(other.x, at)
        other.run(times[15:], group, start_s=times[14])
        np.testing.assert_array_equal(other.x, estimator.x)
        np.testing.assert_array_equal(other.P, estimator.P)
        assert other.covariance_floor_counts == estimator.covariance_floor_counts
        assert repr(other) == repr(estimator)
    estimator.__setstate__(saved)
    np.testing.assert_array_equal(estimator.x, at)


@pytest.mark.unit
def test_arrays_are_read_only_and_reprs_read_well():
    estimator = imm(probabilities=[0.25, 0.75])
    assert estimator.state == "position_velocity2"
    assert estimator.component_names == ("x", "y", "x velocity", "y velocity")
    assert repr(estimator) == (
        "InteractingMultipleModel(position_velocity2: x 30 ± 2, y 60 ± 2, x velocity 2 ± 1, y velocity -1 ± 1; "
        "NearlyConstantVelocity 0.250, NearlyConstantVelocity 0.750)"
    )
    run = estimator.run([0.0, 1.0], [(measurement.Position(2), np.full((2, 2), 40.0), 100.0)])
    assert repr(run).startswith("MultipleModelRun(2 steps, 2 modes, 4 components, 2 accepted, log-likelihood ")
    for owner in (estimator, run):
        for name in ("x", "P", "probabilities"):
            assert not getattr(owner, name).flags.writeable
