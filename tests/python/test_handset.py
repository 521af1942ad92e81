"""HandsetLocator, HandsetWorld and NlosSchedule from Python; experiments nielsen-17 and nielsen-sgl."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from soopnav_cpp.experiments import nielsen_handset
from soopnav_cpp.experiments.registry import REGISTRY, perform
from soopnav_cpp.navigation import HandsetLocator, HandsetStatus, HandsetUse
from soopnav_cpp.simulation import HandsetWorld, NlosSchedule

VARIANCES = [1e-6, 1e-6, 1.3e-7]


@pytest.fixture(scope="module")
def world():
    return HandsetWorld.generate(2, duration_s=20.0, min_clear_share=0.2, epoch_offset_s=0.0)


def started(world, **options):
    options = {"particles": 300, "start_heading_rad": world.told_heading_rad, "seed": 3} | options
    return HandsetLocator(world.nodes_m, start_sigma_m=6.0, start_heading_sigma_rad=0.1, **options)


def run(locator, world, **changed):
    given = {"sigma_m": 1.0, "track_covariance": VARIANCES} | changed
    ranges = given.pop("ranges_m", world.ranges_m)
    increments = given.pop("increments", world.increments)
    return locator.run(world.frame_s, increments, world.epoch_s, ranges, **given)


@pytest.mark.parametrize("filter", ["control", "measurement"])
def test_a_run_is_its_steps(world, filter):
    whole = run(started(world, filter=filter, particles=50), world)
    one = started(world, filter=filter, particles=50)
    frame = 0
    for k, t in enumerate(world.epoch_s[:60]):
        while frame + 1 < len(world.frame_s) and world.frame_s[frame + 1] <= t:
            one.move(world.increments[frame], world.frame_s[frame + 1], track_covariance=VARIANCES)
            frame += 1
        report = one.update_ranges(world.ranges_m[k], 1.0, t)
        assert report.use is whole.use[k]
        found = one.estimate()
        np.testing.assert_array_equal(found.position_m, whole.position_m[k])
        np.testing.assert_array_equal(found.covariance_m2, whole.covariance_m2[k])
        np.testing.assert_array_equal(found.p_los, whole.p_los[k])
        assert found.status is whole.status[k]


def test_finds_the_handset_and_says_how_well(world):
    found = run(started(world), world)
    settled = world.epoch_s > 10.0
    assert found.error_m(world.position_m)[settled].max() < 1.5
    assert found.nees(world.position_m)[settled].mean() < 12.0
    assert np.mean((found.p_los < 0.5) == world.nlos.blocked) > 0.95
    assert found.status[0] is HandsetStatus.COASTING  # no step yet
    assert set(found.status[1:]) == {HandsetStatus.TRACKING}
    assert set(found.frame_use) == {HandsetUse.USED}
    assert "200 epochs of 6 links" in repr(found)


def test_motions_of_the_camera_are_read_by_their_names(world):
    one, two = started(world, particles=20), started(world, particles=20)
    foot = 1e-4 * np.eye(2)
    motion = SimpleNamespace(
        ok=True,
        increment=[0.02, 0.01, 0.005],
        track_covariance=np.diag(VARIANCES),
        foot_covariance_previous=foot,
        foot_covariance=foot,
    )
    for t in (0.05, 0.1):
        assert one.move(motion, t).use is HandsetUse.USED
        two.move(
            [0.02, 0.01, 0.005], t, track_covariance=VARIANCES, foot_covariance_previous=foot, foot_covariance=foot
        )
    np.testing.assert_array_equal(one.estimate().position_m, two.estimate().position_m)
    motion.ok = False
    before = one.estimate().covariance_m2[0, 0]
    assert one.move(motion, 0.5).use is HandsetUse.COASTED
    assert one.estimate().covariance_m2[0, 0] > before + 0.1


def test_dropped_frames_coast_and_links_may_be_silent(world):
    increments = world.increments.copy()
    increments[200:240] = np.nan  # two seconds without a camera
    ranges = world.ranges_m.copy()
    ranges[:, 4] = np.nan
    ranges[120:140] = np.nan
    found = run(started(world), world, increments=increments, ranges_m=ranges)
    assert found.frame_use[210] is HandsetUse.COASTED
    assert found.use[125] is HandsetUse.NOTHING_HEARD
    assert found.covariance_m2[119].trace() > 4.0 * found.covariance_m2[98].trace()
    assert np.isfinite(found.position_m).all()
    assert found.error_m(world.position_m)[160:].max() < 3.0


def test_an_epoch_without_a_time_uses_up_no_frames(world):
    times = world.epoch_s.copy()
    times[50] = np.nan
    found = started(world, particles=50).run(
        world.frame_s, world.increments, times, world.ranges_m, sigma_m=1.0, track_covariance=VARIANCES
    )
    assert found.use[50] is HandsetUse.NOT_FINITE
    assert set(found.use[:50]) | set(found.use[51:]) == {HandsetUse.USED}
    assert set(found.frame_use) == {HandsetUse.USED}
    assert found.error_m(world.position_m)[-1] < 1.5


def test_a_glitch_of_a_kilometre_coasts(world):
    increments = world.increments.copy()
    increments[100] = [1000.0, 0.0, 0.0]
    found = run(started(world), world, increments=increments)
    assert found.frame_use[100] is HandsetUse.TOO_FAST
    assert found.error_m(world.position_m)[-50:].max() < 1.5
    with pytest.raises(ValueError, match="max_speed_mps: -1"):
        started(world, max_speed_mps=-1.0)


def test_a_clock_unknown_by_a_second(world):
    found = run(started(world, clock_sigma_m=3e8), world)
    assert np.isfinite(found.position_m).all()
    assert found.error_m(world.position_m)[-50:].max() < 1.5
    assert (np.linalg.det(found.covariance_m2) > 0.0).all()


def test_particles_are_means_or_draws(world):
    one = started(world, particles=64)
    one.update_ranges(world.ranges_m[0], 1.0, 0.0)
    x, y, _, weight = one.particles()
    assert weight.sum() == pytest.approx(1.0)
    found = one.estimate()
    np.testing.assert_allclose([weight @ x, weight @ y], found.position_m, atol=1e-9)
    drawn = one.particles(draw=True)
    np.testing.assert_array_equal(drawn, one.particles(draw=True))
    assert np.hypot(*(drawn[:2] - [x, y])).mean() > 0.3
    assert "HandsetEstimate(coasting" in repr(one)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"particles": 0}, "particles: 0"),
        ({"particles": 1.5}, "particles: a number of another kind"),
        ({"kernel": 2.0}, "kernel: 2"),
        ({"mean_nlos_s": -1.0}, "mean_nlos_s: -1; a positive number expected"),
        ({"colour": 1.0}, "colour: no such option; known are particles"),
        ({"filter": "type 3"}, "filter = 'type 3'"),
        ({"clock": "atomic"}, "clock = 'atomic'"),
        ({"start_m": [1.0]}, "start_m: two numbers"),
        ({"room_m": [[0.0, 0.0, 1.0]]}, "room_m: two columns"),
        ({"walls_m": [[0.0, 0.0]]}, "walls_m: four columns"),
        ({"node_sigma_m": [1.0, 2.0]}, "node_sigma_m: 2"),
    ],
)
def test_options_are_refused_by_name(options, sentence):
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
        HandsetLocator([[10.0, 0.0]], **options)


def test_bad_nodes_and_shapes_are_refused(world):
    with pytest.raises(ValueError, match="nodes_m"):
        HandsetLocator(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="nodes_m"):
        HandsetLocator(np.full((3, 2), np.nan))
    locator = started(world, particles=5)
    with pytest.raises(ValueError, match="increments"):
        locator.run(world.frame_s, world.increments[1:], world.epoch_s, world.ranges_m, sigma_m=1.0)
    with pytest.raises(ValueError, match="ranges_m"):
        locator.run(world.frame_s, world.increments, world.epoch_s, world.ranges_m[:, 1:], sigma_m=1.0)
    with pytest.raises(ValueError, match="track_covariance"):
        locator.run(
            world.frame_s, world.increments, world.epoch_s, world.ranges_m, sigma_m=1.0, track_covariance=[1.0, 2.0]
        )
    fits = np.full(6, 30.0)
    for ranges, sigma, sentence in [
        ([1.0, 2.0], 1.0, "ranges_m: shape (6,) expected, got (2,)"),
        (fits, [1.0, 2.0], "sigma_m: shape (6,) expected, got (2,)"),
        (fits, np.ones((6, 1)), "sigma_m: shape (6,) expected, got (6, 1)"),
        (fits[None], 1.0, "ranges_m: shape (6,) expected, got (1, 6)"),
        (1j * fits, 1.0, "ranges_m: real numbers"),
    ]:
        with pytest.raises(ValueError, match=re.escape(sentence)):
            locator.update_ranges(ranges, sigma, 0.0)
    angles = np.zeros(6)
    with pytest.raises(ValueError, match="bearings_rad: shape"):
        locator.update_bearings(angles[1:], 0.1, 0.0)
    with pytest.raises(ValueError, match="sigma_rad: shape"):
        locator.update_bearings(angles, [0.1, 0.1], 0.0)
    with pytest.raises(ValueError, match="mirror_rad: shape"):
        locator.update_bearings(angles, 0.1, 0.0, mirror_rad=angles[1:])
    assert locator.update_ranges(fits, 1.0, np.nan).use is HandsetUse.NOT_FINITE
    with pytest.raises(ValueError, match="seed"):
        locator.reset(-1)


def test_worlds_and_schedules_repeat_and_refuse():
    a, b = HandsetWorld.generate(7, duration_s=5.0), HandsetWorld.generate(7, duration_s=5.0)
    np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
    assert not np.array_equal(a.ranges_m, HandsetWorld.generate(8, duration_s=5.0).ranges_m)
    assert a.increments.shape == (100, 3)
    assert a.nlos.blocked.shape == (50, 6)
    schedule = NlosSchedule.generate(300, 0.1, seed=4, links=4, max_blocked=1)
    assert schedule.guarded
    assert schedule.blocked.sum(axis=1).max() <= 1
    assert (schedule.excess_m[schedule.blocked] >= 4.0).all()
    assert (schedule.excess_m[~schedule.blocked] == 0.0).all()
    with pytest.raises(ValueError, match="no such option"):
        HandsetWorld.generate(1, rooms=2)
    with pytest.raises(ValueError, match="max_blocked"):
        NlosSchedule.generate(10, 0.1, max_blocked=9)
    with pytest.raises(ValueError, match="epochs"):
        NlosSchedule.generate(0, 0.1)
    far = NlosSchedule.generate(10, 0.1, excess_walk_m2ps=1e40)
    assert (far.excess_m <= 20.0).all()


def test_switches_are_told_from_their_absence():
    """The experiment's own yardstick: the truth finds all, its opposite none."""
    late = HandsetWorld.generate(1, duration_s=60.0)
    right = np.where(late.nlos.blocked, 0.0, 1.0)
    found, delay = nielsen_handset.switches(late, right)
    assert found.size > 5
    assert found.all()
    assert (delay == 0.0).all()
    assert not nielsen_handset.switches(late, 1.0 - right)[0].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nielsen-17", "nielsen-sgl"])
def test_claims_hold(name, tmp_path):
    [item] = REGISTRY.select([name])
    outcome = perform(item, seed=1, out=tmp_path)
    assert outcome.error is None, outcome.error
    assert [claim.claim for claim in outcome.claims if not claim.holds] == []


@pytest.mark.slow
def test_a_filter_without_booleans_does_not_pass(monkeypatch, tmp_path):
    honest = nielsen_handset.fused
    monkeypatch.setattr(nielsen_handset, "fused", lambda world, seed, **o: honest(world, seed, **(o | {"nlos": False})))
    [item] = REGISTRY.select(["nielsen-17"])
    outcome = perform(item, seed=1, out=tmp_path)
    assert outcome.error is None, outcome.error
    assert not all(claim.holds for claim in outcome.claims)
