"""Late measurements from Python: the bits of those in order, runs against steps, refusals, state kept."""

import copy
import pickle

import numpy as np
import pytest

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.estimation import FixedLagFilter, UpdateStatus

KINDS = [
    estimation.ExtendedKalmanFilter,
    estimation.IteratedKalmanFilter,
    estimation.UnscentedKalmanFilter,
    estimation.SquareRootKalmanFilter,
    estimation.InformationFilter,
]
every_kind = pytest.mark.parametrize("kind", KINDS)

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
X0, P0 = [30.0, 60.0, 2.0, -1.0], np.diag([4.0, 4.0, 1.0, 1.0])
MOTION = process.NearlyConstantVelocity(0.1)
FIX = measurement.Position(2)


def events(count, seed=0):
    """Of a drive: (model, z, R, time), two rows at even places and four at odd ones, one an outlier; eighths of a
    second, so that differences of times are exact."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        time = 0.125 * (3 * k + 1)
        at = np.array(X0[:2]) + time * np.array(X0[2:])
        if k % 2 == 0:
            out.append((FIX, at + rng.standard_normal(2), [[1.0, 0.3], [0.3, 1.0]], time))
        else:
            far = np.linalg.norm(at - NODES, axis=1) + rng.standard_normal(4) + (80.0 if k == 7 else 0.0)
            out.append(([measurement.Range(q) for q in NODES], far, 2.0, time))
    return out


def lagged(kind=estimation.ExtendedKalmanFilter, capacity=40, **options):
    return FixedLagFilter(kind("position_velocity2", X0, P0), MOTION, capacity=capacity, **options)


# --- Laws ---


@pytest.mark.law
@every_kind
def test_late_is_in_order_to_the_bit(kind):
    all_events = events(30)
    plain, now = kind("position_velocity2", X0, P0), 0.0
    for model, z, R, time in all_events:
        assert plain.predict(MOTION, time - now) == UpdateStatus.ACCEPTED
        now = time
        plain.update(model, z, R, gate_nis=30.0)
    in_order = lagged(kind, 12)
    statuses = [in_order.update(*event, gate_nis=30.0).status for event in all_events]
    assert statuses.count(UpdateStatus.GATED) == 1
    # By up to eight places too late.
    rng = np.random.default_rng(5)
    order = np.argsort(np.arange(30) + rng.uniform(0.0, 8.0, 30), kind="stable")
    assert np.any(np.diff(order) < -3)
    late = lagged(kind, 12)
    for k in order:
        assert late.update(*all_events[k], gate_nis=30.0).status in (UpdateStatus.ACCEPTED, UpdateStatus.GATED)
    for lag in (in_order, late):
        np.testing.assert_array_equal(lag.x, plain.x)
        np.testing.assert_array_equal(lag.P, plain.P)
        assert (lag.time_s, lag.size) == (now, 12)
    assert late.oldest_time_s == in_order.oldest_time_s
    assert pickle.dumps(late) == pickle.dumps(in_order)
    assert type(late.filter) is kind
    np.testing.assert_array_equal(late.filter.x, plain.x)


@pytest.mark.law
def test_any_order_within_the_capacity_is_the_same():
    all_events, rng = events(12), np.random.default_rng(2)
    results = set()
    for _ in range(20):
        lag = lagged(capacity=12)
        for k in rng.permutation(12):
            lag.update(*all_events[k], gate_nis=30.0)
        results.add(lag.x.tobytes() + lag.P.tobytes())
    assert len(results) == 1


@pytest.mark.law
@every_kind
def test_a_run_has_the_bits_of_its_steps(kind):
    all_events, rng = events(40), np.random.default_rng(7)
    fixes, ranges = all_events[::2], all_events[1::2]
    delays = rng.uniform(0.0, 2.0, (2, 20))
    groups = []
    for group, delay in zip((fixes, ranges), delays, strict=True):
        times = np.array([event[3] for event in group])
        groups.append((group[0][0], np.array([event[1] for event in group]), group[0][2], times, times + delay))
    groups.append((measurement.Range(NODES[2]), np.array([70.0, 60.0]), 4.0, np.array([1.0, 5.0])))  # not late
    runner, stepper = lagged(kind, 9), lagged(kind, 9)
    run = runner.run(groups, gate_nis=30.0)
    assert np.all(np.diff(run.arrival_s) >= 0.0)
    assert len(run.status) == 42
    for k in range(42):
        group = groups[run.group[k]]
        row = run.row[k]
        assert run.measured_s[k] == group[3][row]
        assert run.arrival_s[k] == group[-1][row]
        report = stepper.update(group[0], group[1][row], group[2], run.measured_s[k], gate_nis=30.0)
        assert report.status == run.status[k]
        np.testing.assert_array_equal(report.nis, run.nis[k])
        assert run.time_s[k] == stepper.time_s
        np.testing.assert_array_equal(run.x[k], stepper.x)
        np.testing.assert_array_equal(run.P[k], stepper.P)
    assert pickle.dumps(runner) == pickle.dumps(stepper)
    assert np.any(run.time_s > run.measured_s)  # some came late
    short = lagged(kind, 9).run(groups, gate_nis=30.0, history=False)
    np.testing.assert_array_equal(short.x, run.x[-1:])
    np.testing.assert_array_equal(short.status, run.status)


@pytest.mark.law
def test_late_measurements_are_worth_having():
    # The same measurements, dropped when late: P is larger.
    all_events = events(20)
    late, dropped = lagged(), lagged()
    for k in (0, 2, 4, 6, 8, 10, 1, 3, 5, 9):
        late.update(*all_events[k])
        if k % 2 == 0:
            dropped.update(*all_events[k])
    assert np.all(np.diagonal(late.P) < np.diagonal(dropped.P))


@pytest.mark.law
def test_inputs_hold_until_the_next():
    ins = process.PlanarMechanization(gyro_sigma_radps=0.01, accelerometer_sigma_mps2=0.1)
    start = estimation.ExtendedKalmanFilter("planar_inertial", np.zeros(5), 0.1)
    inputs = np.column_stack([0.125 * np.arange(7), 1.0 + np.arange(7), np.full(7, 0.25)])
    fixes = np.column_stack([np.arange(1.0, 7.0), 0.125 * np.arange(1.0, 7.0)])
    in_order, late = (FixedLagFilter(start, ins, capacity=20, input=inputs[0]) for _ in range(2))
    for k in range(1, 7):
        assert in_order.advance(float(k), input=inputs[k]) == UpdateStatus.ACCEPTED
        assert in_order.update(FIX, fixes[k - 1], 1.0, k + 0.5).accepted
    for k in range(1, 7):  # all measurements first, the inputs late among them
        assert late.update(FIX, fixes[k - 1], 1.0, k + 0.5).accepted
    for k in range(1, 7):
        assert late.advance(float(k), input=inputs[k]) == UpdateStatus.ACCEPTED
    ran = FixedLagFilter(start, ins, capacity=20, input=inputs[0])
    when = np.arange(1.5, 7.5)
    run = ran.run([(FIX, fixes, 1.0, when, when + 3.25)], inputs=inputs[1:], input_time_s=np.arange(1.0, 7.0))
    assert list(run.group[:5]) == [-1, -1, -1, -1, 0]
    assert np.isnan(run.nis[0])
    plain = start.copy()
    for k in range(7):
        if k > 0:
            plain.predict(ins, 0.5, input=inputs[k])
            plain.update(FIX, fixes[k - 1], 1.0)
        if k < 6:
            plain.predict(ins, 0.5 if k > 0 else 1.0, input=inputs[k])
    for lag in (in_order, late, ran):
        np.testing.assert_array_equal(lag.x, plain.x)
        np.testing.assert_array_equal(lag.P, plain.P)
    assert late.advance(6.0, input=inputs[0]) == UpdateStatus.TIME_NOT_ADVANCING
    assert late.advance(6.25, input=inputs[0]) == UpdateStatus.ACCEPTED  # before a measurement


@pytest.mark.law
@every_kind
def test_smoothed_is_that_of_a_whole_run(kind):
    times = 0.5 * np.arange(1, 21)
    z = np.array(X0[:2]) + np.outer(times, X0[2:]) + np.random.default_rng(1).standard_normal((20, 2))
    lag = lagged(kind)
    for k in [*range(1, 20, 2), *range(0, 20, 2)]:
        assert lag.update(FIX, z[k], 1.0, times[k]).accepted
    whole = kind("position_velocity2", X0, P0).run(times, MOTION, [(FIX, z, 1.0)], start_s=0.0, smooth=True)
    time_s, x, P = lag.smooth()
    np.testing.assert_array_equal(time_s, times)
    np.testing.assert_allclose(x, whole.x_smooth, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(P, whole.P_smooth, rtol=1e-9, atol=1e-9)
    assert not x.flags.writeable
    np.testing.assert_array_equal(lag.x, whole.x[-1])  # smoothing leaves the filter as it was


# --- Refusals ---


@pytest.mark.unit
def test_refused_measurements_change_nothing():
    lag = lagged(capacity=4)
    for event in events(8):
        lag.update(*event)
    oldest = lag.oldest_time_s
    assert oldest == 0.125 * (3 * 3 + 1)
    before = pickle.dumps(lag)
    for z, R, time, status in (
        ([30.0, 60.0], 1.0, oldest - 0.125, UpdateStatus.TOO_LATE),
        ([np.nan, 60.0], 1.0, oldest + 0.5, UpdateStatus.NON_FINITE),
        ([30.0, 60.0], np.nan, oldest + 0.5, UpdateStatus.NON_FINITE),
        ([30.0, 60.0], 0.0, oldest + 0.5, UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([30.0, 60.0], [[1.0, 2.0], [2.0, 1.0]], oldest + 0.5, UpdateStatus.NOT_POSITIVE_DEFINITE),
        ([30.0, 60.0], 1.0, np.nan, UpdateStatus.NON_FINITE),
        ([30.0, 60.0], 1.0, np.inf, UpdateStatus.NON_FINITE),
    ):
        report = lag.update(FIX, z, R, time)
        assert report.status == status
        assert np.isnan(report.nis)
        assert report.innovation.shape == (2,)
    assert lag.advance(lag.time_s) == UpdateStatus.TIME_NOT_ADVANCING
    assert lag.advance(lag.time_s - 1.0) == UpdateStatus.TIME_NOT_ADVANCING
    assert lag.advance(np.nan) == UpdateStatus.NON_FINITE
    assert pickle.dumps(lag) == before
    # The oldest time itself is not too late.
    assert lag.update(FIX, [35.0, 58.0], 1.0, oldest).accepted
    assert lag.advance(9.0) == UpdateStatus.ACCEPTED
    assert lag.time_s == 9.0


@pytest.mark.unit
def test_a_run_reports_what_is_too_late():
    lag = lagged(capacity=2)
    times = np.array([1.0, 2.0, 3.0, 4.0, 1.5])
    z = np.array(X0[:2]) + np.outer(times, X0[2:])
    run = lag.run([(FIX, z, 1.0, times, np.array([1.0, 2.0, 3.0, 4.0, 5.0]))])
    assert run.status[-1] == UpdateStatus.TOO_LATE
    assert np.isnan(run.nis[-1])
    np.testing.assert_array_equal(run.x[-1], run.x[-2])
    assert repr(run) == "FixedLagRun(5 arrivals, 4 components, 4 accepted, 1 too late)"
    for name in ("x", "P", "nis", "status", "time_s", "group"):
        assert not getattr(run, name).flags.writeable


@pytest.mark.unit
def test_refused_measurements_are_judged_anew():
    far, sure = np.array([60.0, 60.0]), np.array([58.0, 60.0])
    late, in_order = lagged(), lagged()
    assert late.update(FIX, far, 1.0, 1.0, gate_nis=12.0).status == UpdateStatus.GATED
    assert late.time_s == 1.0
    np.testing.assert_allclose(late.x[:2], [32.0, 59.0])
    assert late.update(FIX, sure, 1e-4, 0.5).accepted
    in_order.update(FIX, sure, 1e-4, 0.5)
    assert in_order.update(FIX, far, 1.0, 1.0, gate_nis=12.0).accepted
    np.testing.assert_array_equal(late.x, in_order.x)


@pytest.mark.unit
def test_an_input_that_is_no_number_changes_nothing():
    ins = process.PlanarMechanization()
    lag = FixedLagFilter(estimation.ExtendedKalmanFilter("planar_inertial", np.zeros(5), 1.0), ins)
    before = pickle.dumps(lag)
    assert lag.advance(1.0, input=[0.0, np.nan, 0.0]) == UpdateStatus.NON_FINITE
    assert pickle.dumps(lag) == before
    inputs = np.array([[0.0, 1.0, 0.0], [0.0, np.inf, 0.0]])
    run = lag.run([(FIX, np.zeros((1, 2)), 1.0, np.array([3.0]))], inputs=inputs, input_time_s=[1.0, 2.0])
    assert list(run.status) == [UpdateStatus.ACCEPTED, UpdateStatus.NON_FINITE, UpdateStatus.ACCEPTED]


@pytest.mark.unit
def test_bad_arguments_are_named():
    kf, times, z = estimation.ExtendedKalmanFilter("position_velocity2", X0, P0), np.arange(1.0, 4.0), np.ones((3, 2))
    for options, match in (
        ({"capacity": 0}, "capacity: 0, at least one"),
        ({"start_s": np.nan}, "start_s: not finite"),
        ({"input": [1.0, 2.0, 3.0]}, "input: NearlyConstantVelocity expects 0"),
    ):
        with pytest.raises(ValueError, match=match):
            FixedLagFilter(kf, MOTION, **options)
    with pytest.raises(TypeError, match="filter: expected a Kalman filter, got list"):
        FixedLagFilter(X0, MOTION)
    with pytest.raises(TypeError, match="process: expected a process model, got str"):
        FixedLagFilter(kf, "slowly")
    with pytest.raises(ValueError, match="CoordinatedTurn moves a turn rate"):
        FixedLagFilter(kf, process.CoordinatedTurn(1.0, 1.0))
    ins = estimation.ExtendedKalmanFilter("planar_inertial", np.zeros(5), 1.0)
    with pytest.raises(ValueError, match="input: not finite"):
        FixedLagFilter(ins, process.PlanarMechanization(), input=[np.nan, 0.0, 0.0])
    lag = lagged()
    lag.update(FIX, [30.0, 60.0], 1.0, 1.0)
    before = pickle.dumps(lag)
    with pytest.raises(ValueError, match="z: expected 2 numbers"):
        lag.update(FIX, [1.0], 1.0, 1.0)
    with pytest.raises(ValueError, match="R: expected"):
        lag.update(FIX, [1.0, 2.0], np.eye(3), 1.0)
    with pytest.raises(ValueError, match="Pseudorange reads"):
        lag.update(measurement.Pseudorange(NODES[0]), 1.0, 1.0, 2.0)
    with pytest.raises(TypeError, match="model: a callable"):
        lag.update(lambda x: (x[:1], np.eye(1, 4)), 1.0, 1.0, 2.0)
    with pytest.raises(ValueError, match="gate_nis: expected a positive"):
        lag.update(FIX, [1.0, 2.0], 1.0, 2.0, gate_nis=0.0)
    with pytest.raises(ValueError, match="input: NearlyConstantVelocity expects 0"):
        lag.advance(5.0, input=[1.0, 2.0, 3.0])
    for groups, match in (
        ([(FIX, z, 1.0)], r"measurements\[0\]: expected \(model, z, R, time_s\)"),
        ([(FIX, z[:2], 1.0, times)], r"measurements\[0\]: z: expected shape \(3, 2\)"),
        ([(FIX, z, np.ones((2, 2, 2)), times)], r"measurements\[0\]: R: expected 3 matrices"),
        ([(FIX, z, 1.0, times[:, None])], r"measurements\[0\]: time_s: expected shape \(T,\)"),
        ([(FIX, z, 1.0, [1.0, np.nan, 2.0])], r"measurements\[0\]: time_s\[1\] is not finite"),
        ([(FIX, z, 1.0, times, times[:2])], r"measurements\[0\]: arrival_s: expected shape \(3,\)"),
        ([(FIX, z, 1.0, times, times[::-1])], r"measurements\[0\]: arrival_s\[2\]: before the time"),
        ([(FIX, z, 1.0, times), (measurement.Pseudorange(NODES[0]), z[:, 0], 1.0, times)], "Pseudorange reads"),
    ):
        with pytest.raises(ValueError, match=match):
            lag.run(groups)
    with pytest.raises(ValueError, match="inputs: go with input_time_s"):
        lag.run([], inputs=np.zeros((1, 3)))
    with pytest.raises(ValueError, match="inputs: NearlyConstantVelocity has none"):
        lag.run([], inputs=np.zeros((1, 3)), input_time_s=[1.0])
    assert pickle.dumps(lag) == before


# --- State kept ---


@pytest.mark.law
@every_kind
def test_pickles_and_copies_go_on_alike(kind):
    all_events = events(24)
    kf = kind("position_velocity2", X0, P0)
    kf.set_covariance_floor([0.3, 0.3, 0.05, 0.05])
    lag = FixedLagFilter(kf, MOTION, capacity=7)
    for k in (0, 2, 1, 4, 3, 6, 5, 7, 9, 8, 11, 12):
        lag.update(*all_events[k], gate_nis=30.0)
    assert lag.advance(5.0) == UpdateStatus.ACCEPTED
    others = [pickle.loads(pickle.dumps(lag)), copy.copy(lag), copy.deepcopy(lag), lag.copy()]
    at = lag.x
    rest = (10, 15, 14, 18, 17, 16, 23)
    for k in rest:
        lag.update(*all_events[k])
    for other in others:
        np.testing.assert_array_equal(other.x, at)
        statuses = [other.update(*all_events[k]).status for k in rest]
        assert statuses[0] != UpdateStatus.TOO_LATE
        np.testing.assert_array_equal(other.x, lag.x)
        np.testing.assert_array_equal(other.P, lag.P)
        assert (other.time_s, other.oldest_time_s, other.size) == (lag.time_s, lag.oldest_time_s, 7)
        assert other.filter.covariance_floor_counts == lag.filter.covariance_floor_counts
        assert repr(other) == repr(lag)


@pytest.mark.unit
def test_what_is_kept_reads_well():
    lag = FixedLagFilter(estimation.ExtendedKalmanFilter("position2", [1.0, 2.0], 0.25), process.RandomWalk(1.0))
    assert lag.process == process.RandomWalk(1.0)
    assert (lag.size, lag.capacity, lag.time_s) == (0, 100, 0.0)
    assert repr(lag) == (
        "FixedLagFilter(ExtendedKalmanFilter(position2: x 1 ± 0.5, y 2 ± 0.5) at 0 s, 0 of 100 events since 0 s)"
    )
    assert not lag.x.flags.writeable
