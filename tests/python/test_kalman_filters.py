"""Kalman filters from Python: references, whole runs against steps, users' models, refusals, state kept."""

import copy
import json
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.estimation import UpdateStatus

VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "filters"

KINDS = [
    estimation.ExtendedKalmanFilter,
    estimation.IteratedKalmanFilter,
    estimation.UnscentedKalmanFilter,
    estimation.SquareRootKalmanFilter,
    estimation.InformationFilter,
]
LINEARISED = [kind for kind in KINDS if kind is not estimation.UnscentedKalmanFilter]
every_kind = pytest.mark.parametrize("kind", KINDS)

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
X0, P0 = [30.0, 60.0, 1.0, -0.5], np.diag([4.0, 4.0, 1.0, 1.0])
MOTION = process.NearlyConstantVelocity(0.1)


def vectors(name):
    path = VECTORS / name
    if not path.exists():
        pytest.skip(f"the reference vectors ../shared/vectors/filters/{name} are not here")
    return path


def drive(steps, seed=0, state=X0):
    """A drive among four nodes: times and ranges to them, one metre of noise."""
    rng = np.random.default_rng(seed)
    x = np.array(state, float)
    z = np.empty((steps, 4))
    for k in range(steps):
        x[:2] += 0.5 * x[2:4]
        x[2:4] += 0.2 * rng.standard_normal(2)
        z[k] = np.linalg.norm(x[:2] - NODES, axis=1) + rng.standard_normal(4)
    return 0.5 * np.arange(1, steps + 1), z


# --- References ---


def planar_ins_run(data, **options):
    steps = len(data["U"])
    every = steps // len(data["Z"])
    dt = float(data["dt"])
    kf = estimation.ExtendedKalmanFilter("planar_inertial", data["x0"], data["P0"])
    ins = process.PlanarMechanization(integration="euler", diffusion_psd=np.diag(data["Q"]) / dt)
    z = np.full((steps, 3), np.nan)
    z[every - 1 :: every] = -data["Z"]  # there: how much nearer than at the start
    models = [measurement.RangeDifference(q, data["p0"]) for q in data["TX"]]
    heard = ~np.isnan(z[:, 0])
    run = kf.run(
        dt * np.arange(1, steps + 1), ins, [(models, z, data["R"], heard)], inputs=data["U"], start_s=0.0, **options
    )
    return kf, run


@pytest.mark.crosscheck
def test_planar_ins_in_one_call_is_the_reference():
    with np.load(vectors("ekf_range_difference.npz")) as file:
        data = dict(file)
    kf, run = planar_ins_run(data)
    for who in ("numpy", "filterpy", "stonesoup", "gtsam"):
        # The times are sums, so steps differ from dt in their last bits.
        tolerance = 1e-8 if who != "gtsam" else 1e-7
        np.testing.assert_allclose(run.x[-1], data[f"x_{who}"], rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(run.P[-1], data[f"P_{who}"], rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(kf.x, run.x[-1])
    assert np.count_nonzero(run.status == UpdateStatus.ACCEPTED) == 120
    assert np.count_nonzero(run.status == UpdateStatus.ABSENT) == 5880
    short_kf, short = planar_ins_run(data, history=False)
    np.testing.assert_array_equal(short.x, run.x[-1:])
    np.testing.assert_array_equal(short.P, run.P[-1:])
    assert short.x_pred is None
    assert short_kf.state == "planar_inertial"


@pytest.mark.crosscheck
@every_kind
def test_linear_run_and_smoother_are_the_reference(kind):
    data = {
        name: np.array(value) for name, value in json.loads(vectors("kf_rts_filterpy_4state.json").read_text()).items()
    }
    order = [0, 2, 1, 3]  # there x vx y vy
    kf = kind("position_velocity", data["x0"][order].astype(float), data["P0"])
    run = kf.run(
        np.arange(1.0, 51.0), MOTION, [(measurement.Position(2), data["z"], data["R"])], start_s=0.0, smooth=True
    )
    grid = np.ix_(range(50), order, order)
    np.testing.assert_allclose(run.x, data["x_filt"][:, order], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.P, data["P_filt"][grid], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.nis[:, 0], data["nis"], rtol=1e-8)
    np.testing.assert_allclose(run.log_likelihood, float(data["sum_loglik"]), rtol=1e-9)
    np.testing.assert_allclose(run.x_smooth, data["x_smooth"][:, order], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(run.P_smooth, data["P_smooth"][grid], rtol=1e-8, atol=1e-8)


@pytest.mark.crosscheck
def test_extended_filter_is_that_of_numpy():
    times, z = drive(40)
    R = np.eye(4) + 0.5
    kf = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0)
    run = kf.run(times, MOTION, [([measurement.Range(q) for q in NODES], z, R)], start_s=0.0)
    x, P = np.array(X0), P0.copy()
    for k, measured in enumerate(z):
        x, F, Q = MOTION.propagate("position_velocity2", x, 0.5)
        P = F @ P @ F.T + Q
        away = x[:2] - NODES
        far = np.linalg.norm(away, axis=1)
        H = np.hstack([away / far[:, None], np.zeros((4, 2))])
        S = H @ P @ H.T + R
        K = np.linalg.solve(S, H @ P).T
        y = measured - far
        x, P = x + K @ y, (np.eye(4) - K @ H) @ P @ (np.eye(4) - K @ H).T + K @ R @ K.T
        np.testing.assert_allclose(run.x[k], x, rtol=1e-10)
        np.testing.assert_allclose(run.P[k], P, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(run.nis[k, 0], y @ np.linalg.solve(S, y), rtol=1e-9)


@pytest.mark.crosscheck
def test_unscented_filter_is_that_of_numpy():
    options = {"alpha": 0.7, "beta": 2.0, "kappa": 1.0}
    n, q = 3, NODES[1]
    mean, P = np.array([30.0, 60.0, 5.0]), np.diag([25.0, 16.0, 9.0]) + 2.0
    kf = estimation.UnscentedKalmanFilter("position_clock", mean, P, **options)
    spread = 0.7**2 * (n + 1.0)
    root = np.linalg.cholesky(P) * np.sqrt(spread)
    points = np.vstack([mean, mean + root.T, mean - root.T])
    weights = np.full(2 * n + 1, 0.5 / spread)
    weights[0] = 1.0 - n / spread
    h = np.linalg.norm(points[:, :2] - q, axis=1) + points[:, 2]
    z_mean = weights @ h
    weights[0] += 1.0 - 0.7**2 + 2.0
    S = weights @ (h - z_mean) ** 2 + 4.0
    K = (weights * (h - z_mean)) @ (points - mean) / S
    report = kf.update(measurement.Pseudorange(q), 100.0, 4.0)
    assert report.innovation[0] == pytest.approx(100.0 - z_mean, rel=1e-12)
    assert report.covariance[0, 0] == pytest.approx(S, rel=1e-12)
    np.testing.assert_allclose(kf.x, mean + K * (100.0 - z_mean), rtol=1e-11)
    np.testing.assert_allclose(kf.P, P - S * np.outer(K, K), rtol=1e-10, atol=1e-10)


# --- Whole runs and steps ---


@pytest.mark.law
@every_kind
def test_a_run_has_the_bits_of_its_steps(kind):
    times, z = drive(30)
    mask = np.arange(30) % 3 != 0
    models = [measurement.Range(q) for q in NODES]
    bearing = measurement.Azimuth(NODES[0])
    angle = np.full(30, -2.0)
    runner, kf = (kind("position_velocity2", X0, P0) for _ in range(2))
    run = runner.run(
        times,
        MOTION,
        [(models, z, 2.0, mask), (bearing, angle, 0.01)],
        start_s=0.0,
        gate_nis=30.0,
        smooth=True,
    )
    last, total = 0.0, 0.0
    for k, time in enumerate(times):
        assert kf.predict(MOTION, time - last) == UpdateStatus.ACCEPTED
        last = time
        np.testing.assert_array_equal(kf.x, run.x_pred[k])
        np.testing.assert_array_equal(kf.P, run.P_pred[k])
        if mask[k]:
            report = kf.update(models, z[k], 2.0, gate_nis=30.0)
            assert report.nis == run.nis[k, 0]
            assert report.status == run.status[k, 0]
            total += report.log_likelihood if report.accepted else 0.0
        else:
            assert np.isnan(run.nis[k, 0])
            assert run.status[k, 0] == UpdateStatus.ABSENT
        report = kf.update(bearing, angle[k], 0.01, gate_nis=30.0)
        assert report.status == run.status[k, 1]
        total += report.log_likelihood if report.accepted else 0.0
        np.testing.assert_array_equal(kf.x, run.x[k])
        np.testing.assert_array_equal(kf.P, run.P[k])
    assert run.log_likelihood == pytest.approx(total, rel=1e-12)
    np.testing.assert_array_equal(runner.x, kf.x)
    np.testing.assert_array_equal(run.x_smooth[-1], run.x[-1])
    smoother = np.trace(run.P_smooth, axis1=1, axis2=2) - np.trace(run.P, axis1=1, axis2=2)
    assert smoother[:-1].max() < 0.0


@pytest.mark.law
def test_a_driven_run_has_the_bits_of_its_steps():
    rng = np.random.default_rng(3)
    steps = 200
    inputs = rng.standard_normal((steps, 3)) * [0.1, 0.5, 0.5] + [0.3, 0.0, 0.0]
    times = np.cumsum(rng.uniform(0.01, 0.03, steps))
    ins = process.PlanarMechanization(gyro_sigma_radps=0.01, accelerometer_sigma_mps2=0.1, diffusion_psd=1e-4)
    x0, p0 = [3.1, 5.0, 0.0, 10.0, 10.0], np.diag([0.01, 1.0, 1.0, 4.0, 4.0])
    z = np.full((steps, 2), np.nan)
    z[::20] = 60.0 + rng.standard_normal((10, 2))
    models = [measurement.Range(q) for q in NODES[1:3]]
    runner, kf = (estimation.ExtendedKalmanFilter("planar_inertial", x0, p0) for _ in range(2))
    run = runner.run(times, ins, [(models, z, 4.0, ~np.isnan(z[:, 0]))], inputs=inputs)
    for k in range(steps):
        if k > 0:
            assert kf.predict(ins, times[k] - times[k - 1], input=inputs[k]) == UpdateStatus.ACCEPTED
        if not np.isnan(z[k, 0]):
            assert kf.update(models, z[k], 4.0).accepted
        np.testing.assert_array_equal(kf.x, run.x[k])
        np.testing.assert_array_equal(kf.P, run.P[k])
    assert np.all(run.x[:, 0] < np.pi)
    assert np.any(np.abs(np.diff(run.x[:, 0])) > 6.0)  # the heading went round


@pytest.mark.law
def test_kinds_agree_where_they_must():
    times, z = drive(25)
    runs = [
        kind("position_velocity", X0, P0).run(times, MOTION, [([measurement.Range(q) for q in NODES], z, 1.0)])
        for kind in LINEARISED
    ]
    one_step = estimation.IteratedKalmanFilter("position_velocity", X0, P0, max_iterations=1).run(
        times, MOTION, [([measurement.Range(q) for q in NODES], z, 1.0)]
    )
    np.testing.assert_allclose(one_step.x, runs[0].x, rtol=1e-9)
    for run in (runs[2], runs[3]):
        np.testing.assert_allclose(run.x, runs[0].x, rtol=1e-9)
        np.testing.assert_allclose(run.P, runs[0].P, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(runs[1].x, runs[0].x, atol=0.2)  # iterated: near, not equal
    assert np.abs(runs[1].x - runs[0].x).max() > 1e-6


@pytest.mark.unit
def test_covariances_of_each_step():
    times, z = drive(6)
    Rs = np.stack([(1.0 + k) * np.eye(4) for k in range(6)])
    models = [measurement.Range(q) for q in NODES]
    run = estimation.ExtendedKalmanFilter("position_velocity", X0, P0).run(times, MOTION, [(models, z, Rs)])
    kf = estimation.ExtendedKalmanFilter("position_velocity", X0, P0)
    for k in range(6):
        if k > 0:
            kf.predict(MOTION, times[k] - times[k - 1])
        kf.update(models, z[k], Rs[k])
        np.testing.assert_array_equal(kf.x, run.x[k])


@pytest.mark.unit
def test_runs_of_two_threads_are_those_of_one():
    times, z = drive(300)
    groups = [([measurement.Range(q) for q in NODES], z, 1.0)]

    def work(results, index):
        results[index] = estimation.ExtendedKalmanFilter("position_velocity", X0, P0).run(times, MOTION, groups).x

    results = [None, None]
    threads = [threading.Thread(target=work, args=(results, i)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    np.testing.assert_array_equal(results[0], results[1])


# --- Users' models ---


def range_model(x):
    away = x[:2] - NODES
    far = np.linalg.norm(away, axis=1)
    return far, np.hstack([away / far[:, None], np.zeros((4, len(x) - 2))])


def range_model_vectorised(X):
    return np.linalg.norm(X[:, None, :2] - NODES, axis=2)


@pytest.mark.law
@every_kind
def test_callables_are_the_built_in_models(kind):
    _, z = drive(15)
    builtin, own, custom = kind("position_velocity", X0, P0), kind("position_velocity", X0, P0), kind("custom", X0, P0)
    _, F, Q = MOTION.propagate("position_velocity2", X0, 0.5)
    unscented = kind is estimation.UnscentedKalmanFilter
    move = (lambda X, dt: X @ F.T) if unscented else (lambda x, dt: (F @ x, F))
    look = range_model_vectorised if unscented else range_model
    models = [measurement.Range(q) for q in NODES]
    for k in range(15):
        assert builtin.predict(MOTION, 0.5) == UpdateStatus.ACCEPTED
        expected = builtin.update(models, z[k], 1.0)
        for kf in (own, custom):
            assert kf.predict(move, 0.5, Q=Q) == UpdateStatus.ACCEPTED
            report = kf.update(look, z[k], 1.0)
            assert report.nis == pytest.approx(expected.nis, rel=1e-8)
            np.testing.assert_allclose(kf.x, builtin.x, rtol=1e-9)
            np.testing.assert_allclose(kf.P, builtin.P, rtol=1e-8, atol=1e-11)
    assert custom.component_names == ("x[0]", "x[1]", "x[2]", "x[3]")


@pytest.mark.unit
@pytest.mark.parametrize("n", range(1, 9))
@every_kind
def test_custom_states_of_any_size(kind, n):
    rng = np.random.default_rng(n)
    F = np.eye(n) + 0.1 * rng.standard_normal((n, n))
    H = rng.standard_normal((2, n))
    Q, R, x0 = 0.1 * np.eye(n), np.diag([1.0, 2.0]), rng.standard_normal(n)
    z = rng.standard_normal((5, 2))
    kf = kind("custom", x0, np.eye(n))
    expected = estimation.linear_filter(F, Q, H, R, z, x0, np.eye(n))
    unscented = kind is estimation.UnscentedKalmanFilter
    shapes = []

    def move(x, dt):
        shapes.append(x.shape)
        return x @ F.T if unscented else (F @ x, F)

    for k in range(5):
        kf.predict(move, 1.0, Q=Q)
        kf.update((lambda X: X @ H.T) if unscented else (lambda x: (H @ x, H)), z[k], R)
        np.testing.assert_allclose(kf.x, expected.x[k], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(kf.P, expected.P[k], rtol=1e-8, atol=1e-10)
    assert shapes == [(2 * n + 1, n) if unscented else (n,)] * 5


@pytest.mark.unit
@every_kind
def test_a_callable_that_fails_changes_nothing(kind):
    kf = kind("custom", [1.0, 2.0], np.eye(2))
    unscented = kind is estimation.UnscentedKalmanFilter
    before = pickle.dumps(kf)

    def fail(*_):
        raise LookupError("no such map tile")

    with pytest.raises(LookupError, match="map tile"):
        kf.update(fail, [1.0], 1.0)
    with pytest.raises(LookupError, match="map tile"):
        kf.predict(fail, 1.0, Q=1.0)
    bad_h = (lambda X: X[:, :2]) if unscented else (lambda x: (x, np.eye(2)))
    with pytest.raises(ValueError, match="h: expected shape"):
        kf.update(bad_h, [1.0], 1.0)
    bad_x = (lambda X, dt: X[:3]) if unscented else (lambda x, dt: (x[:1], np.eye(2)))
    with pytest.raises(ValueError, match="x_next: expected shape"):
        kf.predict(bad_x, 1.0, Q=1.0)
    with pytest.raises(ValueError, match=r"x_next: expected numbers|pair"):
        kf.predict(lambda x, dt: "far" if unscented else ("far", np.eye(2)), 1.0, Q=1.0)
    if not unscented:
        with pytest.raises(ValueError, match="pair"):
            kf.update(lambda x: x[:1], [1.0], 1.0)
        with pytest.raises(ValueError, match=r"H: expected shape \(1, 2\)"):
            kf.update(lambda x: (x[:1], np.eye(2)), [1.0], 1.0)
        with pytest.raises(ValueError, match=r"F: expected shape \(2, 2\)"):
            kf.predict(lambda x, dt: (x, np.eye(3)), 1.0, Q=1.0)
    nan = (lambda X: X[:, :1] * np.nan) if unscented else (lambda x: (x[:1] * np.nan, np.ones((1, 2))))
    assert kf.update(nan, [1.0], 1.0).status == UpdateStatus.NON_FINITE
    nan = (lambda X, dt: X * np.nan) if unscented else (lambda x, dt: (x * np.nan, np.eye(2)))
    assert kf.predict(nan, 1.0, Q=1.0) == UpdateStatus.NON_FINITE
    with pytest.raises(ValueError, match="Q: a callable needs"):
        kf.predict(nan, 1.0)
    with pytest.raises(ValueError, match="Q"):
        kf.predict(nan, 1.0, Q=-1.0)
    with pytest.raises(ValueError, match="Q: expected"):
        kf.predict(nan, 1.0, Q=np.eye(3))
    assert kf.predict(nan, -1.0, Q=1.0) == UpdateStatus.TIME_NOT_ADVANCING
    assert pickle.dumps(kf) == before


@pytest.mark.unit
@every_kind
def test_rows_of_a_callable_can_be_angles(kind):
    kf = kind("custom", [3.1], [[0.1]])
    look = (lambda X: X) if kind is estimation.UnscentedKalmanFilter else (lambda x: (x, np.eye(1)))
    report = copy.copy(kf).update(look, -3.1, 0.1, angle_rows=[0])
    assert report.innovation[0] == pytest.approx(2 * np.pi - 6.2)
    assert copy.copy(kf).update(look, -3.1, 0.1).innovation[0] == pytest.approx(-6.2)
    with pytest.raises(ValueError, match="angle_rows: no row 1"):
        kf.update(look, -3.1, 0.1, angle_rows=[1])


# --- Refusals ---


@pytest.mark.unit
@every_kind
@pytest.mark.parametrize(
    ("z", "R", "status"),
    [
        (np.nan, 1.0, UpdateStatus.NON_FINITE),
        (np.inf, 1.0, UpdateStatus.NON_FINITE),
        (50.0, np.nan, UpdateStatus.NON_FINITE),
        (50.0, 0.0, UpdateStatus.NOT_POSITIVE_DEFINITE),
        (50.0, -1.0, UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([50.0, 50.0], [[1.0, 2.0], [2.0, 1.0]], UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([50.0, 50.0], [[1.0, 0.5], [0.1, 1.0]], UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([50.0, np.nan], 1.0, UpdateStatus.NON_FINITE),
        ([50.0] * 3, [1.0, 0.0, 1.0], UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([50.0] * 4, [1.0, 1.0, np.nan, 1.0], UpdateStatus.NON_FINITE),
    ],
)
def test_refused_measurements_change_nothing(kind, z, R, status):
    kf = kind("position_velocity2", X0, P0)
    before = pickle.dumps(kf)
    models = [measurement.Range(q) for q in NODES[: np.size(z)]]
    report = kf.update(models, z, R)
    assert report.status == status
    assert not report.accepted
    assert pickle.dumps(kf) == before


@pytest.mark.unit
@every_kind
def test_gates(kind):
    kf = kind("position_velocity2", X0, P0)
    before = pickle.dumps(kf)
    model, far = measurement.Range(NODES[0]), np.hypot(30.0, 60.0)
    report = kf.update(model, far + 20.0, 1.0, gate_nis=9.0)
    assert report.status == UpdateStatus.GATED
    assert report.nis > 9.0
    assert "gated" in repr(report)
    assert kf.update(model, far + 5.0, 1.0, gate_residual=3.0).status == UpdateStatus.GATED
    assert pickle.dumps(kf) == before
    # Two of its own standard deviations, about 2.2 m each.
    assert kf.update(model, far + 4.0, 1.0, gate_residual=3.0, gate_residual_sigmas=3.0).accepted
    for name in ("gate_nis", "gate_residual", "gate_residual_sigmas"):
        with pytest.raises(ValueError, match=f"{name}: expected a positive"):
            kf.update(model, far, 1.0, **{name: np.nan})


@pytest.mark.unit
@pytest.mark.parametrize("kind", LINEARISED)
def test_on_top_of_the_source(kind):
    kf = kind("position_velocity2", [*NODES[1], 0.0, 0.0], P0)
    assert kf.update(measurement.Range(NODES[1]), 1.0, 1.0).status == UpdateStatus.UNDEFINED


@pytest.mark.unit
@every_kind
@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_time_must_advance(kind, dt):
    kf = kind("position_velocity2", X0, P0)
    before = pickle.dumps(kf)
    assert kf.predict(MOTION, dt) == UpdateStatus.TIME_NOT_ADVANCING
    assert pickle.dumps(kf) == before


@pytest.mark.unit
@every_kind
def test_a_nan_input_moves_nothing(kind):
    kf = kind("planar_inertial", np.zeros(5), 1e-8)
    before = pickle.dumps(kf)
    ins = process.PlanarMechanization()
    assert kf.predict(ins, 1.0, input=[0.0, np.nan, 0.0]) == UpdateStatus.NON_FINITE
    assert pickle.dumps(kf) == before
    inputs = np.array([[0.0, 1.0, 0.0], [0.0, np.nan, 0.0], [0.0, 1.0, 0.0]])
    run = kf.run([1.0, 2.0, 3.0], ins, [(measurement.Position(2), np.zeros((3, 2)), 1.0)], inputs=inputs)
    assert list(run.predict_status) == [UpdateStatus.ACCEPTED, UpdateStatus.NON_FINITE, UpdateStatus.ACCEPTED]
    assert list(run.status[:, 0]) == list(run.predict_status)
    np.testing.assert_array_equal(run.x[1], run.x[0])
    # The next step spans from the last time that was reached.
    np.testing.assert_allclose(run.x_pred[2, 1], run.x[0, 1] + 2.0 * 1.0, rtol=1e-6)
    assert "1 steps not predicted" in repr(run)


@pytest.mark.unit
@every_kind
def test_bad_starts_are_named(kind):
    with pytest.raises(ValueError, match=r"no .velocity2.; there are position1, .*custom"):
        kind("velocity2", X0, P0)
    with pytest.raises(ValueError, match="4 numbers, but state 'position2' has 2"):
        kind("position2", X0, P0)
    with pytest.raises(ValueError, match="9 numbers; a custom state has 1 to 8"):
        kind("custom", np.zeros(9), np.eye(9))
    with pytest.raises(ValueError, match="x0"):
        kind("position2", [np.nan, 0.0], np.eye(2))
    for bad in ([[1.0, 0.5], [0.1, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]], [1.0, -1.0]):
        with pytest.raises(ValueError, match="P0"):
            kind("position2", [0.0, 0.0], bad)
    with pytest.raises(ValueError, match=r"P0: expected .*2 variances or shape \(2, 2\), got shape \(3, 3\)"):
        kind("position2", [0.0, 0.0], np.eye(3))


@pytest.mark.unit
@every_kind
def test_bad_arguments_are_named(kind):
    kf = kind("position_velocity2", X0, P0)
    before = pickle.dumps(kf)
    model, times, z = measurement.Range(NODES[0]), np.arange(3.0), np.full((3, 1), 60.0)
    with pytest.raises(ValueError, match="z: expected 1 numbers"):
        kf.update(model, [1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="R: expected"):
        kf.update(model, 1.0, np.eye(2))
    with pytest.raises(TypeError, match="model: expected"):
        kf.update("Range", 1.0, 1.0)
    with pytest.raises(TypeError, match="in the list"):
        kf.update([model, "Range"], [1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="model: the list is empty"):
        kf.update([], [], 1.0)
    with pytest.raises(ValueError, match="17 rows at once"):
        kf.update([model] * 17, np.zeros(17), 1.0)
    with pytest.raises(ValueError, match="Pseudorange reads"):
        kf.update(measurement.Pseudorange(NODES[0]), 1.0, 1.0)
    with pytest.raises(ValueError, match="angle_rows: go with a callable"):
        kf.update(model, 1.0, 1.0, angle_rows=[0])
    with pytest.raises(TypeError, match="process: expected"):
        kf.predict("slowly", 1.0)
    with pytest.raises(ValueError, match="Q: goes with a callable"):
        kf.predict(MOTION, 1.0, Q=1.0)
    with pytest.raises(ValueError, match="input: NearlyConstantVelocity expects 0"):
        kf.predict(MOTION, 1.0, input=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"time_s\[2\]: time must rise"):
        kf.run([0.0, 1.0, 1.0], MOTION)
    with pytest.raises(ValueError, match=r"time_s\[1\] is not finite"):
        kf.run([0.0, np.nan, 1.0], MOTION)
    with pytest.raises(ValueError, match="time_s: empty"):
        kf.run([], MOTION)
    with pytest.raises(ValueError, match=r"start_s: .* is not before time_s\[0\]"):
        kf.run(times, MOTION, start_s=0.0)
    with pytest.raises(ValueError, match=r"measurements\[0\]: z: expected shape \(3, 1\)"):
        kf.run(times, MOTION, [(model, z[:2], 1.0)])
    with pytest.raises(ValueError, match=r"measurements\[0\]: R"):
        kf.run(times, MOTION, [(model, z, np.ones((2, 1, 1)))])
    with pytest.raises(ValueError, match=r"measurements\[0\]: mask: expected bool"):
        kf.run(times, MOTION, [(model, z, 1.0, [1, 0, 1])])
    with pytest.raises(ValueError, match=r"measurements\[0\]: mask: expected shape \(3,\)"):
        kf.run(times, MOTION, [(model, z, 1.0, [True, False])])
    with pytest.raises(ValueError, match=r"measurements\[0\]: expected \(model, z, R\)"):
        kf.run(times, MOTION, [(model, z)])
    with pytest.raises(ValueError, match="inputs: NearlyConstantVelocity has none"):
        kf.run(times, MOTION, inputs=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="CoordinatedTurn moves a turn rate"):
        kf.run(times, process.CoordinatedTurn(1.0, 1.0))
    ins = kind("planar_inertial", np.zeros(5), np.eye(5))
    with pytest.raises(ValueError, match=r"inputs: PlanarMechanization expects shape \(3, 3\)"):
        ins.run(times, process.PlanarMechanization(), inputs=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="variance: expected 4 numbers"):
        kf.set_covariance_floor([1.0])
    with pytest.raises(ValueError, match=r"floor|variance"):
        kf.set_covariance_floor([1.0, -1.0, 0.0, 0.0])
    assert pickle.dumps(kf) == before


@pytest.mark.unit
def test_bad_options_are_named():
    with pytest.raises(ValueError, match="max_iterations"):
        estimation.IteratedKalmanFilter("position2", [0, 0], 1.0, max_iterations=0)
    with pytest.raises(ValueError, match="tolerance"):
        estimation.IteratedKalmanFilter("position2", [0, 0], 1.0, tolerance=0.0)
    with pytest.raises(ValueError, match="alpha"):
        estimation.UnscentedKalmanFilter("position2", [0, 0], 1.0, alpha=-1.0)
    with pytest.raises(ValueError, match="kappa"):
        estimation.UnscentedKalmanFilter("position2", [0, 0], 1.0, kappa=-2.0)
    with pytest.raises(ValueError, match="P0: give it or information"):
        estimation.InformationFilter("position2", [0, 0])
    with pytest.raises(ValueError, match="P0"):
        estimation.InformationFilter("position2", [0, 0], 0.0)


@pytest.mark.unit
def test_an_information_filter_starts_from_nothing():
    kf = estimation.InformationFilter("position2", [20.0, 30.0], information=0.0)
    assert np.all(np.isinf(np.diagonal(kf.P)))
    for _ in range(6):  # the point of linearisation settles
        kf = estimation.InformationFilter("position2", kf.x, information=0.0)
        ranges = np.linalg.norm(NODES - [40.0, 45.0], axis=1)
        assert kf.update([measurement.Range(q) for q in NODES], ranges, 1.0).accepted
    np.testing.assert_allclose(kf.x, [40.0, 45.0], atol=1e-8)
    assert np.all(np.isfinite(kf.P))


# --- State kept ---


@pytest.mark.law
@every_kind
def test_pickles_and_copies_go_on_alike(kind):
    times, z = drive(20)
    kf = kind("position_velocity2", X0, P0)
    kf.set_covariance_floor([0.3, 0.3, 0.05, 0.05])
    kf.run(times[:10], MOTION, [(measurement.Range(NODES[0]), z[:10, 0], 1.0)])
    others = [
        pickle.loads(pickle.dumps(kf)),
        copy.copy(kf),
        copy.deepcopy(kf),
        kf.copy(),
    ]
    saved, at = kf.__getstate__(), kf.x
    for other in others:
        np.testing.assert_array_equal(other.x, kf.x)
        np.testing.assert_array_equal(other.P, kf.P)
        assert other.covariance_floor_counts == kf.covariance_floor_counts
    kf.run(times[10:], MOTION, [(measurement.Range(NODES[1]), z[10:, 1], 1.0)], start_s=times[9])
    for other in others:
        np.testing.assert_array_equal(other.x, at)
        other.run(times[10:], MOTION, [(measurement.Range(NODES[1]), z[10:, 1], 1.0)], start_s=times[9])
        np.testing.assert_array_equal(other.x, kf.x)
        np.testing.assert_array_equal(other.P, kf.P)
        assert other.covariance_floor_counts == kf.covariance_floor_counts
        assert repr(other) == repr(kf)
    kf.__setstate__(saved)
    np.testing.assert_array_equal(kf.x, at)


@pytest.mark.unit
@every_kind
def test_floors_hold_and_count(kind):
    kf = kind("position2", [30.0, 60.0], 1.0)
    kf.set_covariance_floor([0.5, 0.0])
    assert kf.covariance_floor_counts == (0, 0)
    for _ in range(5):
        kf.update(measurement.Position(2), [30.0, 60.0], 0.1)
    np.testing.assert_allclose(kf.P[0, 0], 0.5, rtol=1e-9)
    assert kf.P[1, 1] < 0.05
    assert kf.covariance_floor_counts == (5, 0)


@pytest.mark.unit
def test_arrays_are_read_only_and_reprs_read_well():
    kf = estimation.ExtendedKalmanFilter("pose", [1.0, 2.0, 4.0], 0.25)
    assert kf.state == "pose2"
    assert kf.component_names == ("x", "y", "heading")
    assert kf.x[2] == pytest.approx(4.0 - 2 * np.pi)
    assert repr(kf) == "ExtendedKalmanFilter(pose2: x 1 ± 0.5, y 2 ± 0.5, heading -2.283 ± 0.5)"
    report = kf.update(measurement.Position(2), [1.5, 2.0], 0.75)
    assert repr(report) == "KalmanReport(accepted, innovation [0.5, 0], nis 0.25 (expected 2))"
    expected = -0.5 * (0.25 + 2 * np.log(2 * np.pi))
    assert report.log_likelihood == pytest.approx(expected)
    run = kf.run([0.0, 1.0], process.RandomWalk(0.1), [(measurement.Position(2), np.ones((2, 2)), 1.0)])
    assert repr(run).startswith("KalmanRun(2 steps, 3 components, 2 accepted, log-likelihood ")
    for array in (kf.x, kf.P, report.innovation, report.covariance, run.x, run.P, run.nis, run.status):
        assert not array.flags.writeable
