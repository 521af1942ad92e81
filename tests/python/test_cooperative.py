"""CooperativeTracker, batch starts and the experiments mei-static and mei-model."""

from dataclasses import replace

import numpy as np
import pytest

from soopnav_cpp.clock import TwoState
from soopnav_cpp.experiments import mei_model, mei_static
from soopnav_cpp.experiments.mei_setup import OCXO, SIGMAS_BOUND, SIGMAS_PAPER, Setup, campaign
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.navigation import (
    CooperativeTracker,
    PairBursts,
    PairStartStatus,
    PairUse,
    expected_pair,
    start_pair,
)


@pytest.fixture(scope="module")
def found():
    return campaign(Setup(), 7, mode="drawn", sigmas=SIGMAS_PAPER)


@pytest.fixture(scope="module")
def bursts(found):
    return mei_static.bursts_of(found)


@pytest.fixture(scope="module")
def truth(found):
    return mei_static.truth_of(found)


def begun(found, **options):
    tracker = mei_static.tracker_of(found, **options)
    bursts = mei_static.bursts_of(found)
    assert tracker.start(bursts[bursts.t_s < 90.0]).ok
    return tracker, bursts[bursts.t_s >= 90.0]


def test_the_model_expects_what_the_exact_world_says(found, bursts, truth):
    tdoa, fdoa = expected_pair(found.world.beacons, bursts, truth)
    # The tracker takes the anchor's reading for system time: up to 1 ms, 7.5 m of a satellite's way.
    np.testing.assert_allclose(tdoa, found.world.truth.tdoa_s, atol=1.0 / 3e8)
    np.testing.assert_allclose(fdoa, found.world.truth.fdoa_hz, atol=5e-3)
    later = expected_pair(found.world.beacons, bursts, truth + 300.0 * np.eye(8)[6])[0]
    np.testing.assert_allclose(later - tdoa, 300.0 / 299_792_458.0, rtol=1e-6)
    fast = expected_pair(found.world.beacons, bursts, truth + 3.0 * np.eye(8)[7])[1]
    np.testing.assert_array_less(fast, fdoa)  # a fast clock sees carriers lower


def test_starts_from_nowhere_and_tracks(found, truth):
    tracker = mei_static.tracker_of(found)
    bursts = mei_static.bursts_of(found)
    assert not tracker.started
    assert "not started" in repr(tracker)
    assert np.isnan(tracker.mean).all()
    start = tracker.start(bursts[bursts.t_s < 90.0])
    assert start.status is PairStartStatus.FOUND
    assert start.used.all()
    assert "found, 90 of 90" in repr(start)
    assert start.alternatives.shape == (0, 8)
    run = tracker.run(bursts[bursts.t_s >= 90.0])
    assert run.accepted.all()
    assert set(run.use) == {PairUse.ACCEPTED}
    assert tracker.counts == {PairUse.ACCEPTED: 210}
    error = np.linalg.norm(run.error_enu_m(truth[0, :3])[-1])
    assert error < 6.0 * run.horizontal_sigma_m[-1] + 60.0
    assert run.nees(truth[90:], mei_static.SEEN)[-1] < 40.0
    np.testing.assert_allclose(run.clock_offset_s[-1], truth[-1, 6] / 299_792_458.0, atol=2e-6)
    np.testing.assert_allclose(run.clock_skew[-1], truth[-1, 7] / 299_792_458.0, atol=2e-8)
    assert "210 of 210 bursts" in repr(run)
    np.testing.assert_array_equal(tracker.mean, run.mean[-1])
    np.testing.assert_array_equal(tracker.covariance, run.covariance[-1])
    assert tracker.silent_s == 0.0


def test_one_by_one_is_the_whole_run_and_both_forms_agree(found):
    whole, rest = begun(found)
    run = whole.run(rest)
    single, _ = begun(found)
    for k in range(len(rest)):
        single.update(rest[k : k + 1])
    np.testing.assert_array_equal(single.mean, run.mean[-1])
    other, _ = begun(found, form="information")
    again = other.run(rest)
    sigma = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2))
    assert np.max(np.abs(again.mean - run.mean)[:, :3] / sigma[:, :3]) < 1e-6


def test_start_pair_needs_no_tracker(found, bursts, truth):
    world = found.world
    start = start_pair(
        world.beacons, bursts[:100], target_clock=OCXO, anchor_clock=OCXO, height_m=world.height_m, candidates=4
    )
    assert start.ok
    assert np.linalg.norm(start.mean[:3] - truth[0, :3]) < 2e3
    near = start_pair(
        world.beacons,
        bursts[:100],
        target_clock=OCXO,
        anchor_clock=OCXO,
        height_m=world.height_m,
        guess_e_m=truth[0, :3] + [3e4, 0.0, 0.0],
        search_radius_m=0.0,
    )
    assert near.cells == 0
    np.testing.assert_allclose(near.mean[:3], start.mean[:3], atol=1.0)
    assert start_pair(world.beacons, bursts[:3]).status is PairStartStatus.TOO_FEW


def test_bad_bursts_are_counted_and_change_nothing(found, bursts):
    tracker, rest = begun(found)
    before = tracker.mean
    good = rest[:1]
    for field, value, use in (
        ("tdoa_s", np.nan, PairUse.NOT_FINITE),
        ("fdoa_hz", np.inf, PairUse.NOT_FINITE),
        ("carrier_hz", -1.0, PairUse.NOT_FINITE),
        ("t_s", 1e6, PairUse.OUTSIDE_EPHEMERIS),
        ("t_s", 0.0, PairUse.NOT_ADVANCING),
        ("covariance", np.zeros((2, 2)), PairUse.BAD_COVARIANCE),
    ):
        changed = np.array([value]) if np.ndim(value) == 0 else value
        assert tracker.run(replace(good, **{field: changed})).use == [use], field
        np.testing.assert_array_equal(tracker.mean, before)
    assert tracker.run(replace(good, beacon=np.array([999]))).use == [PairUse.UNKNOWN_BEACON]
    assert tracker.run(good).use == [PairUse.ACCEPTED]
    assert sum(tracker.counts.values()) == 8
    unstarted = mei_static.tracker_of(found)
    run = unstarted.run(good)
    assert run.use == [PairUse.NOT_STARTED]
    assert np.isnan(run.mean).all()
    assert "0 of 1" in repr(run)


def test_silence_widens_and_a_jump_is_reopened(found, truth):
    tracker, rest = begun(found)
    sigma = np.sqrt(tracker.covariance[7, 7])
    assert tracker.coast(200.0)
    assert tracker.silent_s > 100.0
    assert np.sqrt(tracker.covariance[7, 7]) > sigma
    assert not tracker.coast(150.0)
    late = rest[rest.t_s > 200.0]
    jumped = replace(late, tdoa_s=late.tdoa_s + 3e-4)
    run = tracker.run(jumped)
    assert tracker.counts[PairUse.CLOCK_JUMP] == 1
    assert tracker.counts[PairUse.GATED] == 2
    np.testing.assert_allclose(run.clock_offset_s[-1], truth[-1, 6] / 299_792_458.0 + 3e-4, atol=4e-6)
    assert np.linalg.norm(run.error_enu_m(truth[0, :3])[-1]) < 400.0


def test_smoothing(found, truth):
    tracker, rest = begun(found, smoother_capacity=300)
    run = tracker.run(rest)
    smoothed = tracker.smooth()
    assert smoothed.complete
    assert len(smoothed.t_s) == len(rest) + 1
    np.testing.assert_array_equal(smoothed.mean[-1], run.mean[-1])
    # The target stands: every step knows its place as well as the last.
    np.testing.assert_allclose(smoothed.position_e_m, np.broadcast_to(run.position_e_m[-1], (211, 3)), atol=2.0)
    middle = len(rest) // 2
    assert smoothed.covariance[middle, 7, 7] < run.covariance[middle, 7, 7]
    assert "211 steps" in repr(smoothed)
    with pytest.raises(ValueError, match="smoother_capacity"):
        begun(found)[0].smooth()


def test_bursts_of_the_start_are_used_up():
    """A campaign that the start takes whole ends with its mean and covariance; its last burst is not taken again."""
    setup = Setup(duration_s=85.0)
    end = mei_static.locate(7, setup, "drawn", SIGMAS_PAPER)
    found = campaign(setup, 7, mode="drawn", sigmas=SIGMAS_PAPER)
    tracker, start, rest = mei_static.begin(found, 7, mei_static.GUESS_M)
    assert start.ok
    assert len(rest) == 0
    assert end.nees == end.start_nees
    assert np.isnan(end.error_m[:-1]).all()
    again = tracker.run(mei_static.bursts_of(found)[-1:])
    assert again.use == [PairUse.NOT_ADVANCING]
    one = mei_static.truth_of(found)[0, :3]
    assert end.error_m[-1] == pytest.approx(np.linalg.norm(again.error_enu_m(one)[-1, :2]))
    assert end.sigma_m[-1] == pytest.approx(again.horizontal_sigma_m[-1])


def test_along_track_states():
    setup = Setup(separation_m=2e5, along_track_m=1500.0, duration_s=200.0)
    found = campaign(setup, 5, mode="drawn", sigmas=SIGMAS_BOUND)
    bursts, truth = mei_static.bursts_of(found), mei_static.truth_of(found)
    ends = {}
    for states in (0, 6):
        tracker = mei_static.tracker_of(found, orbit_sigma_m=1500.0, along_track_states=states)
        start = truth[0].copy()
        start[0] += 500.0
        tracker.start_at(bursts.t_s[0], start, np.diag(np.array([1e3] * 3 + [1e-3] * 3 + [1e4, 10.0]) ** 2))
        run = tracker.run(bursts[1:])
        ends[states] = run
        held = tracker.along_track(int(bursts.beacon[-1]))
        assert (held is None) == (states == 0)
    assert ends[6].nees(truth[1:], mei_static.SEEN)[-1] < 45.0
    assert np.linalg.norm(ends[6].error_enu_m(truth[0, :3])[-1]) < 400.0


def test_set_up_is_refused_by_name(found, bursts):
    beacons = found.world.beacons
    for options, words in (
        ({"motion": "imm!"}, "motion"),
        ({"form": "square_root"}, "form"),
        ({"target_clock": 3.0}, "target_clock"),
        ({"target_clock": (-1.0, 0.0)}, "target_clock.white"),
        ({"acceleration_psd_m2ps3": 1.0}, "acceleration_psd"),
        ({"iterations": 0}, "iterations"),
        ({"iterations": "many"}, "iterations"),
        ({"no_such": 1.0}, "no_such"),
        ({"height_sigma_m": -1.0}, "height_sigma_m"),
        ({"road_e_m": [1.0, 2.0, 3.0]}, "road_e_m"),
        ({"beacon_epoch_s": [0.0]}, "epoch_s"),
        ({"smoother_capacity": 5, "along_track_states": 2, "orbit_sigma_m": 1.0}, "smoother_capacity"),
    ):
        with pytest.raises(ValueError, match=words):
            CooperativeTracker(beacons, **options)
    with pytest.raises(ValueError, match="beacons"):
        CooperativeTracker([])
    with pytest.raises(ValueError, match="beacons: number 0"):
        CooperativeTracker(["ISS"])
    tracker = CooperativeTracker(beacons, target_clock=TwoState.ocxo(), motion="nearly_constant_velocity")
    with pytest.raises(ValueError, match="mean"):
        tracker.start_at(0.0, np.zeros(7), np.eye(8))
    with pytest.raises(ValueError, match="covariance"):
        tracker.start_at(0.0, np.zeros(8), np.zeros((8, 8)))
    with pytest.raises(ValueError, match="cell_m"):
        tracker.start(bursts, cell_m=-1.0)
    with pytest.raises(ValueError, match="no such option"):
        tracker.start(bursts, cells=3)
    with pytest.raises(ValueError, match="guess"):
        tracker.start(bursts, guess_e_m=[0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="tdoa_s: shape"):
        replace(bursts, tdoa_s=np.zeros(3))
    with pytest.raises(ValueError, match="beacon: whole numbers"):
        replace(bursts, beacon=np.zeros(len(bursts)))
    with pytest.raises(ValueError, match="which"):
        bursts[0]
    assert len(bursts[bursts.t_s < 10.0]) == 10
    assert "beacons in" in repr(bursts)
    assert repr(bursts[:0]) == "PairBursts(none)"


def test_a_mast_is_a_beacon_without_a_horizon(found, bursts, truth):
    masts = [
        SampledOrbit.fixed(found.world.anchor_p_e + d)
        for d in ([2e4, 0, 0], [0, 3e4, 0], [0, 0, 2.5e4], [-1e4, 2e4, 0])
    ]
    n = 120
    which = np.arange(n) % 4
    shape = PairBursts(
        bursts.t_s[:n],
        which,
        bursts.tdoa_s[:n],
        bursts.fdoa_hz[:n],
        np.diag([1e-14, 0.25]),
        100e6,
        found.world.anchor_p_e,
    )
    tdoa, fdoa = expected_pair(masts, shape, truth[:n])
    rng = np.random.default_rng(3)
    heard = replace(shape, tdoa_s=tdoa + 1e-7 * rng.standard_normal(n), fdoa_hz=fdoa + 0.5 * rng.standard_normal(n))
    tracker = CooperativeTracker(
        masts, target_clock=OCXO, anchor_clock=OCXO, height_m=found.world.height_m, height_sigma_m=10.0
    )
    start = tracker.start(heard, search_radius_m=6e4, cell_m=1e4)
    assert start.ok
    assert np.linalg.norm(start.mean[:3] - truth[0, :3]) < 60.0


def test_wander_is_that_of_the_simulated_clock():
    t = np.array([3.0, 40.0, 100.0])
    theta, both, alpha = mei_model.wander(OCXO, t)
    series = [[OCXO.simulate_at(np.append(0.0, t), seed=9, stream=2 * i + j) for j in (0, 1)] for i in range(2000)]
    light = mei_model.LIGHT_MPS
    b = np.array([(a.bias_m - c.bias_m)[1:] for a, c in series])
    d = light * np.array([(a.drift - c.drift)[1:] for a, c in series])
    scale = np.sqrt(np.outer(np.diag(theta), np.diag(alpha)))
    np.testing.assert_allclose(
        b.T @ b / len(b) / np.sqrt(np.outer(np.diag(theta), np.diag(theta))),
        theta / np.sqrt(np.outer(np.diag(theta), np.diag(theta))),
        atol=0.14,
    )
    np.testing.assert_allclose(b.T @ d / len(b) / scale, both / scale, atol=0.12)
    np.testing.assert_allclose(d.T @ d / len(b) / np.diag(alpha)[:, None], alpha / np.diag(alpha)[:, None], atol=0.6)


def test_both_skews_are_one():
    short = Setup(duration_s=120.0, skew=0.5e-6)
    both = mei_model.skews(2, short, "drawn", SIGMAS_BOUND)
    assert both.offset == pytest.approx(0.5e-6, rel=0.05)
    assert abs(both.slope - both.offset) < 6.0 * both.sigma
    assert 0.0 < both.sigma < 5e-9


def test_an_example_from_iq():
    got = mei_static.locate(11, Setup(duration_s=150.0), "iq", SIGMAS_PAPER, True)
    assert got.error_m.shape == got.sigma_m.shape == (len(mei_static.GRID_S) + 1,)
    assert got.error_m[-1] < 400.0
    assert got.nees < 45.0
    assert got.lost < 0.1
    assert np.sqrt(np.mean(got.scatter**2)) == pytest.approx(1.0, abs=0.35)
