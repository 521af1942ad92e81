"""Planar trajectories, inertial units along them, and what a filter makes of both."""

import pickle

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.simulation import ImuErrorModel, PlanarTrajectory, SensorErrorModel

TOWN = [[0.0, 0.0], [100.0, 0.0], [130.0, 60.0], [60.0, 120.0], [60.0, 200.0]]
NAN = np.nan


@pytest.fixture(scope="module")
def turn():
    return PlanarTrajectory.continuous_turn()


def dead_reckoning(trajectory, imu):
    """Positions that the planar mechanisation makes of the readings, from the true start."""
    start = [trajectory.heading_rad[0], *trajectory.velocity_mps[0], *trajectory.position_m[0]]
    ekf = sn.estimation.ExtendedKalmanFilter("planar_inertial", start, 1e-9 * np.eye(5))
    return ekf.run(imu.t_s, sn.process.PlanarMechanization(), inputs=imu.inputs, start_s=0.0).x


@pytest.mark.unit
def test_arrays(turn):
    assert len(turn) == 120_001
    assert turn.duration_s == 120.0
    assert turn.rate_hz == 1000.0
    for name, shape in (
        ("t_s", ()),
        ("heading_rad", ()),
        ("velocity_mps", (2,)),
        ("position_m", (2,)),
        ("yaw_rate_radps", ()),
        ("specific_force_b_mps2", (2,)),
    ):
        array = getattr(turn, name)
        assert array.shape == (120_001, *shape)
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    kept = PlanarTrajectory.continuous_turn(duration_s=11.0).position_m
    assert np.isfinite(kept).all()  # outlives the trajectory
    assert repr(turn) == "PlanarTrajectory(120 s at 1000 Hz, 920.0 m long)"


@pytest.mark.crosscheck
def test_continuous_turn_by_scipy(turn):
    integrate = pytest.importorskip("scipy.integrate")

    def velocity(t, _):
        u = min(1.0, t / 10.0)
        speed = 8.0 * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        heading = 0.035 * t + 0.1 * 40.0 / (2.0 * np.pi) * (1.0 - np.cos(2.0 * np.pi * t / 40.0))
        return speed * np.array([np.cos(heading), np.sin(heading)])

    done = integrate.solve_ivp(
        velocity, (0.0, 120.0), [0.0, 0.0], t_eval=[30.0, 77.7, 120.0], rtol=1e-11, atol=1e-9, max_step=0.5
    )
    np.testing.assert_allclose(turn.at([30.0, 77.7, 120.0]).position_m, done.y.T, atol=1e-6)
    # Ranges to transmitters change by no more than the distance from the start.
    assert np.linalg.norm(turn.position_m, axis=1).max() < 500.0


@pytest.mark.unit
def test_at(turn):
    one = turn.at(60.0)
    assert one.position_m.shape == (2,)
    assert one.heading_rad == turn.heading_rad[60_000]
    some = turn.at([0.0, 60.0, 60.0005])
    assert some.velocity_mps.shape == (3, 2)
    assert np.array_equal(some.position_m[1], one.position_m)
    with pytest.raises(ValueError, match=r"t_s\[1\] = 120.5"):
        turn.at([0.0, 120.5])
    with pytest.raises(ValueError, match=r"t_s\[0\]"):
        turn.at(NAN)


@pytest.mark.law
def test_means_bring_the_ins_back(turn):
    for trajectory in (turn, PlanarTrajectory.through(TOWN, 12.0, 1.5)):
        clean = trajectory.imu(gyro_sigma_radps=0.0, accelerometer_sigma_mps2=0.0, seed=0)
        x = dead_reckoning(trajectory, clean)
        truth = trajectory.at(clean.t_s)
        assert np.abs(x[:, 3:] - truth.position_m).max() < 0.005
        np.testing.assert_allclose(x[:, 1:3], truth.velocity_mps, atol=1e-9)
    # A mean of the interval is not its beginning.
    left = turn.imu(gyro_sigma_radps=0.0, accelerometer_sigma_mps2=0.0, sampling="left", seed=0)
    off = np.linalg.norm(dead_reckoning(turn, left)[:, 3:] - turn.at(left.t_s).position_m, axis=1)
    assert 0.05 < off.max() < 2.0


@pytest.mark.unit
def test_readings(turn):
    imu = turn.imu(seed=5)
    assert len(imu) == 6000
    assert imu.t_s[[0, -1]].tolist() == [0.02, 120.0]
    assert imu.specific_force_b_mps2.shape == (6000, 2)
    assert imu.inputs.shape == (6000, 3)
    assert not imu.saturated.any()
    again = turn.imu(seed=5)
    assert np.array_equal(imu.inputs, again.inputs)
    assert not np.array_equal(imu.inputs, turn.imu(seed=5, stream=1).inputs)
    # The defaults are crosby's.
    assert np.array_equal(imu.inputs, turn.imu(seed=5, errors=ImuErrorModel.crosby()).inputs)
    clean = turn.imu(gyro_sigma_radps=0.0, accelerometer_sigma_mps2=0.0, seed=5)
    # 6000 variances of 1.8 % each: five deviations.
    np.testing.assert_allclose(np.var(imu.inputs - clean.inputs, axis=0), 0.01, rtol=0.092)
    limited = turn.imu(errors=ImuErrorModel(SensorErrorModel(saturation=0.1)), seed=1)
    assert limited.saturated.any()
    assert np.abs(limited.yaw_rate_radps).max() == 0.1
    assert "6000 readings at 50 Hz" in repr(imu)


@pytest.mark.consistency
def test_white_noise_by_its_allan_deviation(turn):
    """A gyro's angle random walk is read off its Allan deviation, as for a clock."""
    density = 0.01
    noisy = PlanarTrajectory.from_profiles(np.zeros(2), np.zeros((2, 2)), 1e-3).imu(
        errors=ImuErrorModel(SensorErrorModel(white_density=density)), seed=3
    )
    assert len(noisy) == 50_000
    got = sn.clock.allan_deviation(
        noisy.yaw_rate_radps,
        0.02,
        taus=[0.02, 0.2, 2.0],
        frequency=True,
        confidence=0.9999,
        noise="white_frequency",
    )
    model = density / np.sqrt(got.tau_s)
    assert np.all((got.lower < model) & (model < got.upper))
    assert np.all(got.upper / got.lower < 1.5)


@pytest.mark.unit
def test_errors_in_space():
    rng = np.random.default_rng(1)
    w, f = rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    same_w, same_f, saturated = ImuErrorModel().apply(w, f, 100.0, seed=1)
    assert np.array_equal(same_w, w)
    assert np.array_equal(same_f, f)
    assert not saturated.any()
    model = ImuErrorModel.industrial()
    biased, _, _ = model.apply(np.zeros((20_000, 3)), np.zeros((20_000, 3)), 100.0, seed=2)
    sigma = model.gyro.white_density * 10.0
    np.testing.assert_allclose(biased.std(axis=0), sigma, rtol=0.025)  # five deviations of 0.5 %
    assert np.abs(biased.mean(axis=0)).max() < 5.0 * (model.gyro.turn_on_sigma + sigma / np.sqrt(20_000))
    flat_w, flat_f, _ = model.apply(np.zeros((4, 1)), np.zeros((4, 2)), 100.0, seed=2)
    assert (flat_w.shape, flat_f.shape) == ((4, 1), (4, 2))
    with pytest.raises(ValueError, match="row 1"):
        model.apply([[0.0] * 3, [NAN] * 3], np.zeros((2, 3)), 100.0, seed=1)
    with pytest.raises(ValueError, match="2 rows expected, got 3"):
        model.apply(np.zeros((2, 3)), np.zeros((3, 3)), 100.0, seed=1)
    with pytest.raises(ValueError, match="shapes"):
        model.apply(np.zeros((2, 2)), np.zeros((2, 3)), 100.0, seed=1)
    with pytest.raises(ValueError, match="rate_hz = 0"):
        model.apply(w, f, 0.0, seed=1)


@pytest.mark.unit
def test_error_models():
    model = ImuErrorModel(SensorErrorModel(sample_sigma=0.1, markov_sigma=0.2, markov_time_s=30.0))
    assert model == pickle.loads(pickle.dumps(model))
    assert hash(model) == hash(pickle.loads(pickle.dumps(model)))
    assert model != ImuErrorModel.crosby()
    assert repr(model) == (
        "ImuErrorModel(gyro=SensorErrorModel(sample_sigma=0.1, markov_sigma=0.2, markov_time_s=30), "
        "accelerometer=SensorErrorModel())"
    )
    for bad, message in (
        ({"sample_sigma": -1.0}, "SensorErrorModel.sample_sigma = -1"),
        ({"scale_sigma": NAN}, "scale_sigma"),
        ({"markov_sigma": 1.0}, "markov_time_s"),
        ({"saturation": 0.0}, "saturation"),
    ):
        with pytest.raises(ValueError, match=message):
            SensorErrorModel(**bad)


@pytest.mark.law
def test_profiles_are_cumulative_trapezoids(turn):
    rate, force = turn.yaw_rate_radps[::20], turn.specific_force_b_mps2[::20]
    got = PlanarTrajectory.from_profiles(rate, force, 50.0, heading_rad=0.2, velocity_mps=[1.0, 2.0])

    def cumulative(values, start):
        steps = 0.5 * (values[1:] + values[:-1]) / 50.0
        return np.concatenate([[start], start + np.cumsum(steps, axis=0)])

    heading = cumulative(rate, 0.2)
    c, s = np.cos(heading), np.sin(heading)
    acceleration = np.column_stack([c * force[:, 0] - s * force[:, 1], s * force[:, 0] + c * force[:, 1]])
    velocity = cumulative(acceleration, np.array([1.0, 2.0]))
    position = cumulative(velocity, np.zeros(2))
    np.testing.assert_allclose(got.heading_rad, heading, atol=1e-11)
    np.testing.assert_allclose(got.velocity_mps, velocity, atol=1e-10)
    np.testing.assert_allclose(got.position_m, position, atol=1e-8)


@pytest.mark.law
def test_a_drive_keeps_its_limits():
    drive = PlanarTrajectory.through(TOWN, 12.0, 0.8, max_lateral_acceleration_mps2=1.5)
    speed = np.linalg.norm(drive.velocity_mps, axis=1)
    assert speed[0] == 0.0
    assert speed[-1] < 1e-9
    assert 5.0 < speed.max() < 12.01
    assert np.abs(drive.specific_force_b_mps2[:, 0]).max() <= 1.01 * 0.8
    assert np.abs(drive.specific_force_b_mps2[:, 1]).max() <= 1.01 * 1.5
    for point in TOWN:
        assert np.linalg.norm(drive.position_m - point, axis=1).min() < 0.01
    jerk = np.abs(np.diff(drive.specific_force_b_mps2[:, 0])) * 1000.0
    assert jerk.max() < 2.0 * 0.8 * 1.05


@pytest.mark.unit
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: PlanarTrajectory.continuous_turn(ramp_s=200.0), "ramp_s = 200"),
        (lambda: PlanarTrajectory.continuous_turn(rate_hz=0.0), "rate_hz = 0"),
        (lambda: PlanarTrajectory.continuous_turn(position_m=[1.0]), r"position_m: expected shape \(2,\), got \(1,\)"),
        (lambda: PlanarTrajectory.through([[0.0, 0.0]]), "waypoints_m: at least 2"),
        (lambda: PlanarTrajectory.through([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), r"waypoints_m: expected shape \(n, 2\)"),
        (lambda: PlanarTrajectory.through([[0.0, 0.0], [0.0, 0.0]]), r"waypoints_m\[1\]"),
        (lambda: PlanarTrajectory.through(TOWN, -1.0), "speed_mps = -1"),
        (lambda: PlanarTrajectory.from_profiles([0.0], [[0.0, 0.0]]), "at least 2 samples"),
        (lambda: PlanarTrajectory.from_profiles([0.0, NAN], np.zeros((2, 2))), r"yaw_rate_radps\[1\]"),
        (lambda: PlanarTrajectory.from_profiles([0.0, 0.0], np.zeros((3, 2))), "2 samples expected, got 3"),
        (lambda: PlanarTrajectory.through(TOWN).imu(-1.0, seed=0), "rate_hz = -1"),
        (lambda: PlanarTrajectory.through(TOWN).imu(sampling="right", seed=0), "sampling: expected 'mean'"),
        (lambda: PlanarTrajectory.through(TOWN).imu(gyro_sigma_radps=-1.0, seed=0), "sample_sigma = -1"),
    ],
)
def test_what_is_no_motion(call, message):
    with pytest.raises(ValueError, match=message):
        call()
