"""Targets that move, several targets, and other beacons, through the bindings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from soopnav_cpp import geometry
from soopnav_cpp.experiments import mei_beacons, mei_moving, mei_targets
from soopnav_cpp.experiments.mei_setup import OCXO, SIGMAS_BOUND, SIGMAS_PAPER, Setup
from soopnav_cpp.inertial import ImuNoise, ImuStatus
from soopnav_cpp.navigation import (
    CooperativeGroup,
    CooperativeTracker,
    GroupStatus,
    InertialTracker,
    InertialUnit,
    ManoeuvringTracker,
    PairBursts,
    TwoMotions,
    pair_noise_shares,
    shared_anchor_correlation,
)
from soopnav_cpp.simulation import fm_waveform

OPTIONS = {"target_clock": OCXO, "anchor_clock": OCXO, "gate_probability": 0.0}


@pytest.fixture(scope="module")
def drive():
    """A drive of 150 s, its bursts each second, and a start."""
    way, campaign = mei_moving.moving_campaign(Setup(duration_s=150.0), 5, "drawn", SIGMAS_PAPER)
    return way, campaign, mei_moving.bursts_of(campaign), mei_moving.start_of(way, campaign.world, 5)


@pytest.fixture(scope="module")
def guests():
    return mei_targets.party(3)


def rms(way, campaign, states, after_s=30.0):
    error = states.position_e_m - campaign.world.position_e_m[campaign.row]
    return float(np.sqrt(np.mean(np.sum(error[states.t_s > after_s] ** 2, axis=1))))


@pytest.mark.consistency
def test_two_motions_and_a_unit_hold_a_drive_that_a_static_model_loses(drive):
    way, campaign, _, _ = drive
    found = mei_moving.tracks(way, campaign, 5, grades={"unit": mei_moving.INDUSTRIAL}, modes=True)
    late = found["static"].t_s > 30.0
    worst = {name: float(np.sqrt(np.mean(t.distance_m[late] ** 2))) for name, t in found.items()}
    assert worst["two motions"] < 200.0
    assert worst["static"] > 5.0 * worst["two motions"]
    assert worst["unit"] < 200.0
    modes = found["two motions"].modes
    assert np.allclose(modes.sum(axis=1), 1.0, atol=1e-12)
    assert modes[:, 1].max() > 0.8
    assert modes[:, 1].min() < 0.2
    assert np.mean(found["two motions"].nees[late]) < 12.0
    assert np.mean(found["static"].nees[late]) > 400.0


@pytest.mark.unit
def test_smoothed_drives_are_nearer(drive):
    way, campaign, bursts, start = drive
    two = ManoeuvringTracker(campaign.world.beacons, smoother_capacity=400, **OPTIONS)
    two.start_at(0.0, *start)
    filtered = two.run(bursts)
    smoothed = two.smooth()
    assert smoothed.complete
    after = np.searchsorted(smoothed.t_s, filtered.t_s[0])
    kept = replace(filtered, mean=smoothed.mean[after:], t_s=smoothed.t_s[after:])
    assert np.array_equal(kept.t_s, filtered.t_s)
    assert rms(way, campaign, kept) < 0.9 * rms(way, campaign, filtered)
    assert "two motions" in repr(two)

    unit, t_s, theta, velocity = mei_moving.inertial_of(way, mei_moving.INDUSTRIAL, 151.0, 5)
    with_unit = InertialTracker(campaign.world.beacons, unit=unit, smoother_capacity=400, **OPTIONS)
    with_unit.start_at(0.0, *start)
    with_unit.add_imu(t_s, theta, velocity)
    filtered = with_unit.run(bursts)
    full = with_unit.smooth_inertial()
    assert full.full_covariance.shape == (len(bursts) + 1, 17, 17)
    assert np.allclose(np.linalg.norm(full.quaternion, axis=1), 1.0, atol=1e-12)
    kept = replace(filtered, mean=full.mean[1:], t_s=full.t_s[1:])
    assert rms(way, campaign, kept) < 0.9 * rms(way, campaign, filtered)
    now = with_unit.inertial
    assert np.array_equal(now.mean[0], filtered.mean[-1])
    assert np.linalg.norm(now.accelerometer_bias_mps2) < 0.2
    small = InertialTracker(campaign.world.beacons, unit=unit, smoother_capacity=5, **OPTIONS)
    small.start_at(0.0, *start)
    small.run(bursts)
    with pytest.raises(ValueError, match="smoother_capacity"):
        small.smooth()


@pytest.mark.unit
def test_samples_are_judged_and_gaps_are_known(drive):
    way, campaign, bursts, start = drive
    unit, t_s, theta, velocity = mei_moving.inertial_of(way, mei_moving.INDUSTRIAL, 30.0, 5)

    def ends(t, a, b):
        tracker = InertialTracker(campaign.world.beacons, unit=replace(unit, accelerometer_range_mps2=60.0), **OPTIONS)
        tracker.start_at(0.0, *start)
        status = tracker.add_imu(t, a, b)
        tracker.run(bursts[:20])
        return tracker, status

    whole, status = ends(t_s, theta, velocity)
    assert set(status) == {ImuStatus.OK}
    spoiled = velocity.copy()
    spoiled[800:900] = np.nan
    spoiled[900:950] = 2.0
    broken, status = ends(t_s, theta, spoiled)
    assert status[850] == ImuStatus.NOT_FINITE
    assert status[920] == ImuStatus.SATURATED
    assert np.isfinite(broken.mean).all()
    keep = np.r_[0:800, 950:3000]
    missing, status = ends(t_s[keep], theta[keep], velocity[keep])
    assert status[800] == ImuStatus.GAP
    assert np.allclose(missing.mean[:3], broken.mean[:3], atol=1e-3)
    assert np.trace(missing.covariance[3:6, 3:6]) > np.trace(whole.covariance[3:6, 3:6])
    assert whole.add_imu([1.0], np.zeros((1, 3)), np.zeros((1, 3))) == [ImuStatus.REVERSED]
    with pytest.raises(ValueError, match="three numbers"):
        whole.add_imu(t_s, theta[:-1], velocity)
    with pytest.raises(ValueError, match="norm"):
        InertialTracker(campaign.world.beacons, unit=replace(unit, quaternion=[1.0, 1.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="tilt_sigma_rad"):
        InertialTracker(campaign.world.beacons, unit=replace(unit, tilt_sigma_rad=0.0))
    with pytest.raises(ValueError, match="calm_psd"):
        ManoeuvringTracker(campaign.world.beacons, motions=TwoMotions(calm_psd_m2ps3=-1.0))
    with pytest.raises(ValueError, match="no such option"):
        ManoeuvringTracker(campaign.world.beacons, motion_of="cars")
    assert InertialUnit(noise=ImuNoise(), period_s=0.01, quaternion=[1, 0, 0, 0]).waiting_samples == 65536


@pytest.mark.unit
def test_shares_of_noise():
    assert shared_anchor_correlation(0.0, 0.0, 0.0) == pytest.approx(1.0 / 3.0, abs=1e-15)
    assert shared_anchor_correlation(10.0, 10.0, 10.0) == pytest.approx(10.0 / 21.0, abs=1e-15)
    assert shared_anchor_correlation(3.0, 7.0, 300.0) == pytest.approx(0.0, abs=1e-12)
    assert sum(pair_noise_shares(-3.0, 8.0)) == pytest.approx(1.0, abs=1e-15)
    assert pair_noise_shares(-3.0, 8.0)[0] > pair_noise_shares(-3.0, 8.0)[1]
    assert all(math.isnan(share) for share in pair_noise_shares(math.nan, 0.0))


def start_of(guests, k):
    T = np.eye(8)
    T[:3, :3] = T[3:6, 3:6] = mei_moving.axes_at(guests.truth[0, k, :3]).T
    sigma = mei_targets.START_SIGMA
    return guests.truth[0, k] - [0, 0, 0, 0, 0, 0, guests.truth[0, k, 7], 0], T @ np.diag(sigma**2) @ T.T


def group_of(guests, **options):
    group = CooperativeGroup(guests.beacons, 0.0, target_clock=OCXO, anchor_clock=OCXO, gate_probability=0.0, **options)
    for k in range(len(guests.bursts)):
        assert group.join(*start_of(guests, k)) == k
    return group


@pytest.mark.crosscheck
def test_a_target_in_a_group_is_a_target_alone(guests):
    group = CooperativeGroup(guests.beacons, 0.0, target_clock=OCXO, anchor_clock=OCXO, gate_probability=0.0)
    group.join(*start_of(guests, 0))
    found = group.run(guests.bursts[:1], [[10.0, 10.0]], covariance=True)
    alone = CooperativeTracker(guests.beacons, **OPTIONS, jump_after=0)
    alone.start_at(0.0, *start_of(guests, 0))
    run = alone.run(guests.bursts[0])
    assert np.abs(found.mean[-1, 0] - run.mean[-1]).max() < 1e-4
    assert np.allclose(found.covariance[-1], run.covariance[-1], rtol=1e-5, atol=1e-12)


@pytest.mark.unit
def test_groups_take_rows_between_targets_and_judge_them(guests):
    few = [one[:40] for one in guests.bursts]
    group = group_of(guests)
    between = PairBursts(
        few[0].t_s, few[0].beacon, few[0].tdoa_s - few[1].tdoa_s, few[0].fdoa_hz - few[1].fdoa_hz, few[0].covariance,
        few[0].carrier_hz, few[0].anchor_position_e_m,
    )  # fmt: skip
    pairs = [(0, -1), (1, -1), (2, -1), (0, 1), (5, -1), (0, 0)]
    broken = replace(few[2], tdoa_s=np.where(np.arange(40) < 10, np.nan, few[2].tdoa_s))
    run = group.run(
        [few[0], few[1], broken, between, few[0], few[0]], np.full((6, 2), 10.0), pairs=pairs, covariance=True
    )
    assert (
        run.status[0]
        == [GroupStatus.ACCEPTED] * 2
        + [GroupStatus.NON_FINITE, GroupStatus.ACCEPTED]
        + [GroupStatus.UNKNOWN_TARGET] * 2
    )
    assert run.status[20][2] == GroupStatus.ACCEPTED
    assert np.isfinite(run.mean).all()
    assert run.nees(guests.truth[:40]).shape == (40,)
    assert group.leave(1)
    assert not group.leave(1)
    assert group.targets == (0, 2)
    assert group.mean.shape == (2, 8)
    later = [guests.bursts[0][40:50], guests.bursts[2][40:50]]
    assert group.run(later, np.full((2, 2), 10.0)).covariance is None
    late = group.run(later, np.full((2, 2), 10.0))
    assert late.status[0] == [GroupStatus.TIME_NOT_ADVANCING] * 2
    assert late.status[-1] == [GroupStatus.ACCEPTED] * 2  # at the state's own time: heard twice
    assert group.join(*start_of(guests, 1)) == 3
    assert "3 targets" in repr(group)
    with pytest.raises(ValueError, match="join"):
        group.join(np.full(8, np.nan), np.eye(8))
    with pytest.raises(ValueError, match="bursts: one for each"):
        group.run(later, np.full((2, 2), 10.0))
    with pytest.raises(ValueError, match="snr_db"):
        group.run(later, [10.0], pairs=[(0, -1), (2, -1)])
    with pytest.raises(ValueError, match="max_targets"):
        CooperativeGroup(guests.beacons, 0.0, max_targets=100)
    with pytest.raises(ValueError, match="covariance"):
        late.nees(guests.truth[:10, :2])


@pytest.mark.consistency
def test_what_targets_share_shows_in_their_differences():
    found = [mei_targets.followed(seed) for seed in range(8)]
    right = np.mean([one["together"].apart for one in found]) / 16.0
    wrong = np.mean([one["apart"].apart for one in found]) / 16.0
    # Mean of 8 chi-squares of 16 over its dimension: deviation 0.125.
    assert 0.5 < right < 1.5
    assert wrong < 0.8 * right
    together = np.mean([one["apart"].together for one in found])
    assert together > 1.2 * np.mean([one["together"].together for one in found])


@pytest.mark.consistency
def test_fm_stations_and_aircraft_hold_a_target_that_satellites_leave_loose():
    found = mei_beacons.spreads(4, 12)
    assert found["fm"].rms_m < 90.0
    assert found["aircraft"].rms_m < found["fm"].rms_m
    assert found["satellites"].rms_m > found["fm"].rms_m


@pytest.mark.unit
def test_fm_is_what_a_station_sends():
    iq = fm_waveform(0.2, 500e3, seed=7)
    assert iq.shape == (100_000,)
    assert iq.dtype == np.complex64
    assert np.allclose(np.abs(iq), 1.0, atol=1e-6)
    deviation = np.diff(np.unwrap(np.angle(iq.astype(np.complex128)))) * 500e3 / (2.0 * math.pi)
    assert np.abs(deviation).max() < 75e3 * 1.001
    assert 15e3 < deviation.std() < 30e3
    power = np.abs(np.fft.fft(iq)) ** 2
    outside = np.abs(np.fft.fftfreq(len(iq), 1.0 / 500e3)) > 90e3
    assert power[outside].sum() < 0.01 * power.sum()  # Carson's rule
    assert np.array_equal(iq, fm_waveform(0.2, 500e3, seed=7))
    assert not np.array_equal(iq, fm_waveform(0.2, 500e3, seed=8))
    for bad in ({"duration_s": 0.0}, {"sample_rate_hz": math.nan}, {"deviation_hz": -1.0}, {"duration_s": 1e-9}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            fm_waveform(**({"duration_s": 0.1, "sample_rate_hz": 500e3, "seed": 0} | bad))
    with pytest.raises(ValueError, match="twice"):
        fm_waveform(0.1, 20e3, seed=0)


@pytest.mark.unit
def test_courses_are_smooth_and_their_units_exact(drive):
    way, campaign, _, _ = drive
    t = np.linspace(0.0, 150.0, 3001)
    p, v = way.at(t)
    assert np.abs(np.diff(p, axis=0) / 0.05 - 0.5 * (v[1:] + v[:-1])).max() < 0.01
    speed = np.linalg.norm(v, axis=1)
    assert speed.max() < 15.5
    at = campaign.world.target.at(t[:10])
    assert np.abs(at[0] - p[:10]).max() < 1e-6
    acceleration = np.linalg.norm(np.diff(v, axis=0) / 0.05, axis=1)
    assert 2.5 < acceleration.max() < 4.0
    height = geometry.ecef_to_geodetic(p)[2]
    assert np.ptp(height) < 0.1
    assert SIGMAS_BOUND[0] < SIGMAS_PAPER[0]
