"""Inertial navigation in three dimensions through the bindings."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp import geometry, inertial
from soopnav_cpp.estimation import UpdateStatus
from soopnav_cpp.experiments import crosby_strapdown
from soopnav_cpp.inertial import AlignmentStatus, Heading, ImuNoise, ImuStatus, ZeroVelocity
from soopnav_cpp.navigation import StrapdownNavigator, StrapdownStart, strapdown_errors
from soopnav_cpp.simulation import Oscillation, SpatialTrajectory

VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "nav"
FRAME = geometry.LocalFrame(math.radians(48.1), math.radians(11.6), 520.0, axes=geometry.LocalAxes.NED)
WAYPOINTS = np.array(
    [
        [0, 0, 0],
        [150, 20, -5],
        [230, 140, -12],
        [140, 260, 0],
        [-20, 240, 10],
        [-60, 80, 0],
        [80, -60, -20],
        [240, -120, -10],
        [400, 0, 0],
        [480, 160, -8],
        [380, 300, 0],
        [200, 420, 5],
        [-100, 420, 0],
    ]
)
TRANSMITTERS = crosby_strapdown.TRANSMITTERS_NED_M


def vector_file(name):
    path = VECTORS / name
    if not path.is_file():
        pytest.skip(f"the reference vectors ../shared/vectors/nav/{name} are not here")
    return path


def turn_between(a, b):
    """Angle between quaternions, shape (..., 4)."""
    dot = np.abs(np.sum(a * b, axis=-1))
    wedge = np.linalg.norm(a[..., None] * b[..., None, :] - b[..., None] * a[..., None, :], axis=(-2, -1)) / np.sqrt(2)
    return 2.0 * np.arctan2(wedge, dot)


@pytest.fixture(scope="module")
def path():
    return SpatialTrajectory.through(
        FRAME,
        WAYPOINTS,
        speed_mps=15.0,
        max_acceleration_mps2=4.0,
        roll=Oscillation(0.05, 0.7, 0.2),
        pitch=Oscillation(0.03, 1.1, 1.0),
    )


@pytest.fixture(scope="module")
def increments(path):
    return path.imu_increments(100.0, end_s=120.0)


def start_of(path, covariance=None, **change):
    motion = path.at(0.0)
    values = {
        "quaternion": motion.quaternion[0],
        "velocity_mps": motion.velocity_mps[0],
        "position_m": motion.position_m[0],
        "covariance": StrapdownStart.deviations(
            tilt_rad=2e-3,
            heading_rad=1e-2,
            velocity_mps=0.1,
            position_m=0.1,
            gyro_bias_radps=2.4e-5,
            accelerometer_bias_mps2=4.9e-3,
        )
        if covariance is None
        else covariance,
    }
    return StrapdownStart(**(values | change))


def navigator_of(path, start=None, **options):
    values = {"frame": FRAME, "noise": ImuNoise.industrial_mems(), "period_s": 0.01, "range_sigma_m": 0.5}
    return StrapdownNavigator(options.pop("transmitters", TRANSMITTERS), start or start_of(path), **(values | options))


def noisy(increments, seed=3):
    noise, rng = ImuNoise.industrial_mems(), np.random.default_rng(seed)
    theta, velocity = (np.array(a) for a in increments)
    theta += 0.1 * noise.gyro_density * rng.standard_normal(theta.shape) + 0.01 * 2e-5
    velocity += 0.1 * noise.accelerometer_density * rng.standard_normal(velocity.shape) + 0.01 * 3e-3
    return theta, velocity


def changes_of(path, epochs, sigma_m=0.5, seed=4):
    p = path.at(epochs).position_m
    ranges = np.linalg.norm(p[:, None] - TRANSMITTERS, axis=2)
    return (
        ranges
        - np.linalg.norm(path.at(0.0).position_m - TRANSMITTERS, axis=1)
        + sigma_m * np.random.default_rng(seed).standard_normal(ranges.shape)
    )


# --- Gravity and rates, against an independent program ---


@pytest.mark.crosscheck
def test_gravity_radii_and_earth_rate_equal_the_reference():
    table = json.loads(vector_file("gravity_earth_rate.json").read_text())
    rows = table["table"]
    latitude, height = (np.array([row[name] for row in rows]) for name in ("lat_deg", "h_m"))
    latitude = np.deg2rad(latitude)

    def column(name):
        return np.array([row[name] for row in rows])

    g = geometry.normal_gravity_ned(latitude, height)
    assert np.max(np.abs(np.linalg.norm(g, axis=1) - column("exact_norm"))) < 1e-11
    assert np.max(np.abs(g[:, 0] - column("exact_north"))) < 2e-12
    assert np.max(np.abs(-g[:, 2] - column("exact_up"))) < 1e-11
    assert np.max(np.abs(geometry.normal_gravity_surface(latitude) - column("somigliana_surface"))) < 1e-10
    assert np.max(np.abs(geometry.earth_rate_ned(latitude) - column("earth_rate_ned").reshape(-1, 3))) < 1e-20
    assert np.max(np.abs(geometry.meridian_radius(latitude) - column("R_M_meridian"))) < 1e-8
    assert np.max(np.abs(geometry.prime_vertical_radius(latitude) - column("R_N_prime_vertical"))) < 1e-8
    p_e = geometry.geodetic_to_ecef(latitude, 0.0, height)
    spin = table["constants"]["omega"] ** 2 * p_e * [1.0, 1.0, 0.0]
    j2 = geometry.j2_gravitation_ecef(p_e, table["constants"]["J2"]) + spin
    assert np.max(np.abs(np.linalg.norm(j2, axis=1) - column("J2_norm"))) < 1e-11
    turned = geometry.normal_gravity_ecef(p_e)
    assert np.max(np.abs(np.linalg.norm(turned, axis=1) - column("exact_norm"))) < 1e-11


@pytest.mark.unit
def test_shapes_of_gravity_functions_broadcast():
    assert geometry.normal_gravity_ned(0.5, [0.0, 10.0]).shape == (2, 3)
    assert geometry.normal_gravity_ned(0.5, 0.0).shape == (3,)
    assert geometry.earth_rate_ned([[0.1, 0.2]]).shape == (1, 2, 3)
    assert geometry.meridian_radius(0.3).shape == ()
    rate = geometry.transport_rate_ned(0.5, 100.0, [[0.0, 100.0, 0.0]])
    assert rate.shape == (1, 3)
    assert rate[0, 0] == pytest.approx(100.0 / (geometry.prime_vertical_radius(0.5) + 100.0))
    with pytest.raises(ValueError, match=r"v_n_mps: expected shape \(\.\.\., 3\)"):
        geometry.transport_rate_ned(0.5, 0.0, [1.0, 2.0])


# --- Coning, and the mechanisation ---


@pytest.mark.crosscheck
def test_coning_keeps_the_attitude_to_a_microradian():
    with np.load(vector_file("coning_1deg_10Hz.npz"), allow_pickle=False) as file:
        theta, truth = file["dtheta_rad"], file["q_b2ref_wxyz"]
    phi, _ = inertial.correct_increments(theta, np.zeros_like(theta))

    def attitudes(turns):
        q, out = truth[0], []
        for v in turns:
            half = 0.5 * np.linalg.norm(v)
            w, (x, y, z) = math.cos(half), 0.5 * np.sinc(half / np.pi) * v
            q = np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]]) @ q
            out.append(q)
        return np.array(out)

    assert np.max(turn_between(attitudes(phi), truth[1:])) < 1e-6
    assert np.max(turn_between(attitudes(theta), truth[1:])) > 1e-3  # without the correction


@pytest.mark.crosscheck
def test_a_minute_of_exact_increments_comes_back(path, increments):
    theta, velocity = (a[:6000] for a in increments)
    place, v, q = path.navigation_states([0.0, 60.0])
    run = inertial.integrate(
        theta, velocity, 0.01, place=place[0], velocity_mps=v[0], quaternion=q[0], record_every=6000
    )
    assert not run.status.any()
    off = geometry.geodetic_to_ecef(*run.place[0]) - geometry.geodetic_to_ecef(*place[1])
    assert np.linalg.norm(off) < 1e-3
    assert np.linalg.norm(run.velocity_mps[0] - v[1]) < 1e-4
    assert turn_between(run.quaternion[0], q[1]) < 1e-6
    assert repr(run) == "StrapdownSolution(1 records, 6000 steps, 0 refused)"


@pytest.mark.unit
def test_integration_names_what_it_refuses(path, increments):
    theta, velocity = (np.array(a[:10]) for a in increments)
    place, v, q = path.navigation_states(0.0)
    start = {"place": place[0], "velocity_mps": v[0], "quaternion": q[0]}
    theta[4, 1] = np.nan
    run = inertial.integrate(theta, velocity, 0.01, **start)
    assert list(run.status) == [0, 0, 0, 0, inertial.IntegrationStatus.NOT_FINITE, 0, 0, 0, 0, 0]
    assert np.array_equal(run.place[3], run.place[4])
    for change, words in (
        ({"quaternion": [2.0, 0.0, 0.0, 0.0]}, "start.q_n_b: 2; its norm must be 1"),
        ({"place": [2.0, 0.0, 0.0]}, "start.place.latitude_rad: 2"),
        ({"coning_samples": 7}, "previous: 7; 0 ... 4 earlier samples"),
        ({"place": [0.0, 0.0]}, "place: three numbers expected, got 2"),
    ):
        with pytest.raises(ValueError, match=words):
            inertial.integrate(theta, velocity, 0.01, **(start | change))
    with pytest.raises(ValueError, match="dt_s: not a positive finite number"):
        inertial.integrate(theta, velocity, 0.0, **start)
    with pytest.raises(ValueError, match="delta_velocity_b: 10 rows expected"):
        inertial.integrate(theta, velocity[:4], 0.01, **start)


@pytest.mark.law
@pytest.mark.parametrize("axes", [geometry.LocalAxes.NED, geometry.LocalAxes.ENU])
def test_a_path_is_what_its_derivatives_say(axes):
    frame = geometry.LocalFrame(0.5, 0.3, 100.0, axes=axes)
    swap = [1, 0, 2] if axes == geometry.LocalAxes.ENU else [0, 1, 2]
    sign = [1.0, 1.0, -1.0] if axes == geometry.LocalAxes.ENU else [1.0, 1.0, 1.0]
    path = SpatialTrajectory.through(
        frame, WAYPOINTS[:, swap] * sign, speed_mps=12.0, rest_s=10.0, roll=Oscillation(0.1, 0.5)
    )
    t, h = np.linspace(15.0, path.duration_s - 1.0, 200), 1e-4
    before, now, after = (path.at(t + d) for d in (-h, 0.0, h))
    assert np.max(np.abs((after.position_m - before.position_m) / (2 * h) - now.velocity_mps)) < 1e-6
    assert np.max(np.abs((after.velocity_mps - before.velocity_mps) / (2 * h) - now.acceleration_mps2)) < 1e-6
    assert path.greatest_acceleration_mps2 <= 3.0
    # Twice the vector part of q* q' is the body's rate.
    w, v = now.quaternion[:, :1], -now.quaternion[:, 1:]
    dq = (after.quaternion - before.quaternion) / (2 * h)
    rate = 2.0 * (w * dq[:, 1:] + v * dq[:, :1] + np.cross(v, dq[:, 1:]))
    assert np.max(np.abs(rate - now.rate_radps)) < 1e-6
    # At rest first, then at speed; the body's first axis along the way.
    assert np.linalg.norm(path.at(0.0).velocity_mps) < 1e-6
    late = path.at(0.5 * path.duration_s)
    assert np.linalg.norm(late.velocity_mps) == pytest.approx(12.0, rel=0.1)
    # The same path, seen from the moving frame: heights and speeds agree.
    place, speed, _ = path.navigation_states(t)
    back = np.stack(frame.position_to_geodetic(now.position_m), axis=-1)
    assert np.max(np.abs(place - back)) < 1e-8
    assert np.linalg.norm(speed, axis=1) == pytest.approx(np.linalg.norm(now.velocity_mps, axis=1), abs=1e-9)


@pytest.mark.unit
def test_impossible_paths_are_refused():
    for arguments, options, words in (
        (([[0, 0, 0]],), {"speed_mps": 1.0}, "waypoints: 1; at least two are needed"),
        (([[0, 0, 0], [0, 0, 0]],), {"speed_mps": 1.0}, "waypoints: 1; this one is where the one before it is"),
        (([[0, 0, 0], [9, 0, 0]],), {"speed_mps": -1.0}, "speed_mps: -1; it must be positive"),
        (([[0, 0, 0], [9, 0, np.nan]],), {"speed_mps": 1.0}, "waypoints: .*; they must be finite"),
        (([[0, 0], [9, 0]],), {"speed_mps": 1.0}, "waypoints_m: rows of 3 numbers expected, got 2"),
    ):
        with pytest.raises(ValueError, match=words):
            SpatialTrajectory.through(FRAME, *arguments, **options)
    with pytest.raises(ValueError, match="control_points: 5; at least six are needed"):
        SpatialTrajectory(FRAME, np.zeros((5, 3)), 1.0)
    still = SpatialTrajectory(FRAME, np.zeros((8, 3)), 2.0)
    assert still.duration_s == 6.0
    with pytest.raises(ValueError, match="end_s: 9; it must not lie before start_s nor behind the path's end"):
        still.imu_increments(100.0, end_s=9.0)


# --- Rest ---


@pytest.mark.unit
def test_a_body_at_rest_finds_its_attitude():
    still = SpatialTrajectory(FRAME, np.zeros((10, 3)), 12.0)
    theta, velocity = still.imu_increments(100.0)
    means = velocity.sum(axis=0) / still.duration_s, theta.sum(axis=0) / still.duration_s
    place = {"duration_s": still.duration_s, "latitude_rad": FRAME.latitude_rad, "height_m": 520.0}
    good = inertial.static_alignment(*means, **place, noise=ImuNoise(gyro_density=1e-8))
    assert good.status == AlignmentStatus.ALIGNED
    assert good.gyrocompass
    assert turn_between(good.quaternion, still.at(0.0).quaternion[0]) < 1e-8
    poor = ImuNoise.industrial_mems()
    assert inertial.static_alignment(*means, **place, noise=poor).status == AlignmentStatus.NO_HEADING
    given = inertial.static_alignment(*means, **place, noise=poor, heading=Heading(0.0, 0.01))
    assert not given.gyrocompass
    assert given.covariance[2, 2] == pytest.approx(1e-4, rel=1e-3)
    # A level body: the tilt about its first axis belongs to the accelerometer bias along its second.
    assert given.cross_accelerometer_bias[0, 1] == pytest.approx(poor.accelerometer_bias_sigma_mps2**2 / 9.81, rel=1e-2)
    assert repr(given) == "Alignment(aligned, heading by what was given, sigma 0.01 rad)"
    at_rest, statistic = ZeroVelocity(window=20).detect(theta[:100], velocity[:100], 0.01)
    assert list(at_rest) == [False] * 19 + [True] * 81
    assert np.isinf(statistic[:19]).all()
    with pytest.raises(ValueError, match="window: 1; 2"):
        ZeroVelocity(window=1).detect(theta, velocity, 0.01)


@pytest.mark.unit
def test_samples_are_judged():
    t = np.array([0.0, 0.01, 0.01, 0.005, 0.02, 0.12, 0.13, 0.14])
    gyro = np.zeros((8, 1))
    gyro[6], gyro[7] = 4.0, np.nan
    status, missing = inertial.judge_samples(t, gyro, np.zeros((8, 2)), period_s=0.01, gyro_range_radps=4.0)
    names = ["FIRST", "OK", "DUPLICATE", "REVERSED", "OK", "GAP", "SATURATED", "NOT_FINITE"]
    assert [ImuStatus(s).name for s in status] == names
    assert missing[5] == pytest.approx(0.09)
    with pytest.raises(ValueError, match="period_s: -1; it must be positive and finite"):
        inertial.judge_samples(t, gyro, np.zeros((8, 2)), period_s=-1.0)


# --- The navigator ---


@pytest.mark.unit
def test_all_transmitters_lost_for_a_minute(path, increments):
    theta, velocity = noisy(increments)
    t, epochs = 0.01 * np.arange(1, 12001), np.arange(1.0, 121.0)
    changes = changes_of(path, epochs)
    changes[30:90] = np.nan
    ranges = np.remainder(changes, 1199.0)
    navigator = navigator_of(path, ambiguity_m=1199.0, gate_sigmas=5.0, gate_floor_m=3.0)
    run = navigator.run(t, theta, velocity, epochs_s=epochs, range_changes_m=ranges, record_every=100, covariance=True)
    truth = path.at(epochs)
    error = run.position_m - truth.position_m
    share = np.linalg.norm(error, axis=1) / np.linalg.norm(run.sigma[:, 6:9], axis=1)
    assert np.max(share) < 3.5
    assert run.sigma[88, 6] > 5.0 * run.sigma[29, 6]  # honest: it grows
    assert np.max(np.abs(error[100:, :2])) < 2.0  # and recovers
    assert (run.update_status[30:90] == UpdateStatus.NON_FINITE).all()
    assert (run.update_status[90:] == UpdateStatus.ACCEPTED).all()
    assert np.isnan(run.innovation_m[40]).all()
    assert run.covariance.shape == (120, 15, 15)
    assert np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2)) == pytest.approx(np.array(run.sigma))
    errors = strapdown_errors(
        run,
        quaternion=truth.quaternion,
        velocity_mps=truth.velocity_mps,
        position_m=truth.position_m,
        gyro_bias_radps=[2e-5] * 3,
        accelerometer_bias_mps2=[3e-3] * 3,
    )
    assert errors[:, 6:9] == pytest.approx(-error)
    assert np.max(np.abs(errors[-1] / run.sigma[-1])) < 5.0
    # Run again: the navigator is as it was; without covariances there are none.
    again = navigator.run(t, theta, velocity, epochs_s=epochs, range_changes_m=ranges, record_every=100)
    assert np.array_equal(again.position_m, run.position_m)
    assert again.covariance is None
    assert repr(again) == "StrapdownRun(120 records, 120 epochs of 4 transmitters, 12000 samples)"
    with pytest.raises(ValueError, match="read-only"):
        again.position_m[0] = 0.0


@pytest.mark.unit
def test_twenty_seconds_without_usable_samples(path, increments):
    """Missing, not finite and saturated ones spread alike, and as far as the body may have moved."""
    t, epochs = 0.01 * np.arange(1, 12001), np.arange(1.0, 121.0)
    changes = changes_of(path, epochs)
    changes[30:50] = np.nan
    spread = []
    for what in ("missing", "not finite", "saturated", "every other one not finite"):
        theta, velocity = noisy(increments)
        keep = np.ones(12000, dtype=bool)
        if what == "missing":
            keep[3000:5000] = False
        elif what == "saturated":
            theta[3000:5000] = 5.0 * 0.01
        else:
            theta[3000 : 5000 : 2 if what.startswith("every") else 1] = np.nan
        navigator = navigator_of(path, gyro_range_radps=5.0, gap_rate_sigma_radps=0.4, gap_acceleration_sigma_mps2=3.0)
        run = navigator.run(
            t[keep], theta[keep], velocity[keep], epochs_s=epochs, range_changes_m=changes, record_every=1
        )
        at = int(np.searchsorted(run.t_s, 49.995))
        error = np.linalg.norm(run.position_m[at] - path.at(run.t_s[at]).position_m[0])
        spread.append(float(np.linalg.norm(run.sigma[at, 6:9])))
        assert error < 3.0 * spread[-1], what
        assert np.isfinite(run.sigma).all()
    assert spread[1] == pytest.approx(spread[0], rel=0.35)  # one step of 20 s, or 2000 of them
    assert spread[2] == pytest.approx(spread[1], rel=0.02)
    assert spread[3] > 0.2 * spread[1]


@pytest.mark.unit
def test_gaps_and_bad_samples_have_names_and_no_nan_comes_out(path, increments):
    theta, velocity = noisy(increments)
    t = 0.01 * np.arange(1, 12001)
    keep = np.ones(12000, dtype=bool)
    keep[3000:3200] = False
    theta[5000] = np.nan
    theta[6000, 2] = 0.1
    t[7000] = t[6000]
    epochs = np.arange(1.0, 121.0)
    run = navigator_of(path, gyro_range_radps=5.0, gap_rate_sigma_radps=0.4, gap_acceleration_sigma_mps2=3.0).run(
        t[keep],
        theta[keep],
        velocity[keep],
        epochs_s=epochs,
        range_changes_m=changes_of(path, epochs),
        record_every=100,
    )
    status = run.imu_status
    assert status[3000] == ImuStatus.GAP
    assert status[4800] == ImuStatus.NOT_FINITE
    assert status[5800] == ImuStatus.SATURATED
    assert status[6800] == ImuStatus.REVERSED
    assert np.isfinite(run.position_m).all()
    assert np.isfinite(run.sigma).all()
    truth = path.at(run.t_s).position_m
    share = np.linalg.norm(run.position_m - truth, axis=1) / np.linalg.norm(run.sigma[:, 6:9], axis=1)
    assert np.max(share) < 4.0
    assert run.sigma[30, 3] > 3.0 * run.sigma[29, 3]


@pytest.mark.unit
def test_east_north_up_transmitters_are_the_same(path, increments):
    t, epochs = 0.01 * np.arange(1, 3001), np.arange(1.0, 31.0)
    theta, velocity = (a[:3000] for a in noisy(increments))
    data = {"epochs_s": epochs, "range_changes_m": changes_of(path, epochs), "record_every": 100}
    enu = geometry.LocalFrame(FRAME.latitude_rad, FRAME.longitude_rad, FRAME.height_m)
    swapped = TRANSMITTERS[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    one = navigator_of(path).run(t, theta, velocity, **data)
    other = navigator_of(path, transmitters=swapped, frame=enu).run(t, theta, velocity, **data)
    assert np.array_equal(one.position_m, other.position_m)


@pytest.mark.unit
def test_a_start_off_by_an_error(path):
    exact = start_of(path)
    error = 1e-2 * np.arange(1.0, 16.0)
    off = exact.off_by(error)
    motion = path.at(0.0)
    assert off.position_m == pytest.approx(motion.position_m[0] - error[6:9])
    assert turn_between(np.asarray(off.quaternion), motion.quaternion[0]) == pytest.approx(np.linalg.norm(error[:3]))
    assert off.gyro_bias_radps == pytest.approx(-error[9:12])


@pytest.mark.unit
def test_set_ups_that_make_no_sense_are_refused(path):
    for options, words in (
        ({"range_sigma_m": 0.0}, "range_sigma_m: 0; it must be positive and finite"),
        ({"period_s": np.nan}, "period_s: nan; it must be positive and finite"),
        ({"ambiguity_m": -5.0}, "ambiguity_m: -5; it must be positive"),
        ({"noise": ImuNoise(gyro_density=-1.0)}, "gyro_density: -1; it must be finite and not negative"),
        ({"transmitters": [[0.0, 1.0]]}, r"transmitters_m: expected shape \(k, 3\), got \(1, 2\)"),
        ({"transmitters": []}, r"transmitters_m: expected shape \(k, 3\), got \(0,\)"),
        ({"transmitters": [[0.0, 1.0, np.inf]]}, "transmitters_m: inf; they must be finite"),
        ({"gap_rate_sigma_radps": -1.0}, "rate_sigma_radps: -1; it must be finite and not negative"),
        ({"zero_velocity": ZeroVelocity(threshold=0.0)}, "threshold: 0; it must be positive"),
        ({"start": start_of(path, covariance=-np.eye(15))}, "P0"),
        ({"start": start_of(path, covariance=np.eye(14))}, r"covariance: expected shape \(15, 15\), got \(14, 14\)"),
        ({"start": start_of(path, quaternion=[1.0, 1.0, 0.0, 0.0])}, "quaternion: .*; its norm must be 1"),
    ):
        with pytest.raises(ValueError, match=words):
            navigator_of(path, **options)
    navigator = navigator_of(path)
    zeros = np.zeros((5, 3))
    with pytest.raises(ValueError, match="both or none expected"):
        navigator.run(np.arange(5), zeros, zeros, epochs_s=[1.0])
    with pytest.raises(ValueError, match=r"range_changes_m: expected shape \(1, 4\), got \(1, 3\)"):
        navigator.run(np.arange(5), zeros, zeros, epochs_s=[1.0], range_changes_m=zeros[:1])
    with pytest.raises(ValueError, match=r"delta_theta_b: expected shape \(4, 3\), got \(5, 3\)"):
        navigator.run(np.arange(4), zeros, zeros)
    with pytest.raises(ValueError, match="record_every: 0; it must be at least 1"):
        navigator.run(np.arange(5), zeros, zeros, record_every=0)


@pytest.mark.consistency
def test_one_run_of_the_experiment(monkeypatch):
    monkeypatch.setattr(crosby_strapdown, "DURATION_S", 120)
    monkeypatch.setattr(crosby_strapdown, "NEES_S", (60, 120))
    run = crosby_strapdown.drive(11)
    assert run.refused == 0
    assert np.sqrt(np.mean(np.sum(run.error_m[60:, :2] ** 2, axis=1))) < 1.5
    assert np.all(run.nees < 51.0)  # 15 degrees of freedom, 1e-5
    assert np.all(run.nees > 1.6)
    again = crosby_strapdown.drive(11)
    assert np.array_equal(run.error_m, again.error_m)
