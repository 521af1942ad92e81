"""A robot's odometry and real radio ranges: filters follow its ground truth, and their NIS says which model is right.

Of the ranges a straight line over the true distance leaves 0.54 m of noise, white and as good as normal: they are 7 %
too long whatever the beacon, with offsets of centimetres, and there are no outliers (none is 2 m off the line). So the
right model has one scale as a state; biases alone cannot follow the distance. R is what was measured, neither inflated
nor are the ranges thinned. The filters are those of examples/uwb_plaza.py.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import soopnav_cpp as sn

pytest.importorskip("scipy.io")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT.parent / "shared" / "captures" / "uwb_plaza"

pytestmark = [
    pytest.mark.offair,
    pytest.mark.crosscheck,
    pytest.mark.skipif(not (FOLDER / "Plaza1_.mat").exists(), reason="the recording in ../shared is not there"),
]


def load_example():
    spec = importlib.util.spec_from_file_location("uwb_plaza_example", ROOT / "examples" / "uwb_plaza.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


plaza = load_example()


@functools.cache
def drive():
    return plaza.recorded(FOLDER)


@functools.cache
def best():
    return plaza.estimating(drive(), plaza.SCALE_AND_BIASES)


@functools.cache
def with_biases():
    return plaza.estimating(drive(), plaza.BIASES)


def off_the_line_m():
    """Ranges less a straight line over the true distance."""
    far = np.linalg.norm(drive().truth_m - drive().beacons_m[drive().beacon], axis=1)
    return drive().range_m - np.polyval(np.polyfit(far, drive().range_m, 1), far)


def test_the_recording_is_read():
    d = drive()
    assert len(d.time_s) == 3526
    assert np.all(np.diff(d.time_s) > 0.0)
    assert np.array_equal(np.unique(d.beacon), range(4))
    off = off_the_line_m()
    assert off.std() == pytest.approx(plaza.RANGE_SIGMA_M, abs=0.005)
    assert np.abs(off).max() < 2.0
    for beacon in range(4):
        own = off[d.beacon == beacon]
        assert abs(np.corrcoef(own[1:], own[:-1])[0, 1]) < 4.0 / np.sqrt(len(own))
    length = np.abs(d.odometry[:, 0]).sum()
    assert length == pytest.approx(np.linalg.norm(np.diff(d.truth_m, axis=0), axis=1).sum(), rel=0.1)


def test_rows_out_of_order_are_refused_by_name():
    """As the file has them, the times of the ranges go back twice."""
    rows = np.loadtxt(FOLDER / "Plaza1_TD.txt")
    back = int(np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)[0]) + 1
    ekf = sn.estimation.ExtendedKalmanFilter("pose2", drive().start, plaza.START_SIGMA**2)
    wheels = sn.process.PlanarOdometry(np.zeros((3, 3)), diffusion_psd=1e-4)
    with pytest.raises(ValueError, match=rf"time_s\[{back}\]: time must rise"):
        ekf.run(rows[:, 0], wheels, inputs=np.zeros((len(rows), 3)))


def test_a_start_that_is_wrong_is_found():
    """From the true start the wheels alone end 4 m away; that the start was 0.1 rad off they never notice."""
    d = drive()
    wrong = dataclasses.replace(d, start=np.add(d.start, [0.5, -0.5, 0.1]))
    wheels = sn.process.PlanarOdometry(np.zeros((3, 3)), diffusion_psd=1e-4)

    def wheels_alone_rmse_m(start):
        ekf = sn.estimation.ExtendedKalmanFilter("pose2", start, plaza.START_SIGMA**2)
        run = ekf.run(d.time_s, wheels, inputs=d.odometry, start_s=d.start_s)
        return np.hypot(*sn.estimation.rmse(run.x[:, :2] - d.truth_m))

    assert 1.5 < wheels_alone_rmse_m(d.start) < 2.5
    assert wheels_alone_rmse_m(wrong.start) > 3.0
    assert plaza.estimating(wrong, plaza.SCALE_AND_BIASES).rmse_m(d) < 0.45


def test_a_filter_that_trusts_the_ranges_says_that_its_model_is_wrong():
    track = plaza.trusting(drive())
    assert track.taken.all()
    assert 2.5 < track.rmse_m(drive()) < 4.0
    assert track.nis.mean() > 10.0
    assert np.median(track.nis) > 5.0  # 0.45 where the model is right
    # A variance that covers the errors takes part of it away, and the accuracy does not come back.
    honest = plaza.trusting(drive(), sigma_m=2.0)
    assert 1.2 < honest.nis.mean() < 1.8
    assert 2.4 < honest.rmse_m(drive()) < 3.5


def test_biases_as_states():
    track = with_biases()
    assert track.rmse_m(drive()) < 1.3
    assert 1.0 < track.nis.mean() < 1.3  # biases that wander after the distance explain the ranges, not the place
    nees = sn.estimation.nees(track.x[:, :2] - drive().truth_m, track.P[:, :2, :2])
    assert nees.mean() > 3.5  # 2 where the model is right
    assert (~track.taken).mean() < 0.015


def test_a_scale_and_biases_as_states():
    track = best()
    assert track.rmse_m(drive()) < 0.4
    assert track.x[-1, 3] == pytest.approx(0.0695, abs=0.006)  # what a line through ranges over true distances has
    # The mean NIS of 3526 white innovations leaves these bounds once in 10 000.
    low, high = sn.estimation.mean_nees_bounds(1.0, len(track.nis))
    assert high - low < 0.2
    assert low < track.nis.mean() < high
    assert 0.035 < np.mean(track.nis > 3.84) < 0.065  # 5 %, 4 deviations of a share either way
    # White: correlations with the next ones vary by 0.017.
    for lag in (1, 2, 3, 4, 8):
        assert abs(np.corrcoef(track.innovation[lag:], track.innovation[:-lag])[0, 1]) < 0.07
    nees = sn.estimation.nees(track.x[:, :2] - drive().truth_m, track.P[:, :2, :2])
    assert 1.5 < nees.mean() < 3.0  # 2; errors of one run, correlated over minutes
    assert 0.02 < np.mean(nees > 5.99) < 0.1  # 5 %


def test_few_are_gated_and_they_are_the_worst():
    gated = ~best().taken
    assert 0 < np.count_nonzero(gated) < 0.01 * len(gated)
    off = np.abs(off_the_line_m())
    assert off[gated].mean() > 2.5 * off.mean()


@pytest.mark.parametrize("seed", [0, 1])
def test_wild_ranges_are_gated(seed):
    rng = np.random.default_rng(seed)
    d = drive()
    wild = rng.random(len(d.range_m)) < 0.05
    late = d.range_m + np.where(wild, rng.uniform(5.0, 40.0, len(wild)), 0.0)
    d = dataclasses.replace(d, range_m=late)
    track = plaza.estimating(d, plaza.SCALE_AND_BIASES)
    assert np.count_nonzero(wild) > 100
    assert (~track.taken[wild]).mean() > 0.98
    assert (~track.taken[~wild]).mean() < 0.01
    assert track.rmse_m(d) < 0.4
    assert plaza.estimating(d, plaza.SCALE_AND_BIASES, gate=None).rmse_m(d) > 1.5


@pytest.mark.parametrize(
    ("sigma_m", "low", "high"), [(0.54 / np.sqrt(2.0), 1.2, np.inf), (0.54 * np.sqrt(2.0), 0.0, 0.8)]
)
def test_the_nis_tells_a_wrong_noise(sigma_m, low, high, monkeypatch):
    monkeypatch.setattr(plaza, "RANGE_SIGMA_M", sigma_m)
    track = plaza.estimating(drive(), plaza.SCALE_AND_BIASES)
    assert low < track.nis.mean() < high


def test_particles():
    """The same three, for any seed: 3.2 … 3.5 m, 1.0 … 1.3 m and 0.30 … 0.32 m were seen in five."""
    d = drive()
    trusting = plaza.trusting(d, particles=2000)
    biased = plaza.estimating_particles(d, plaza.BIASES)
    scaled = plaza.estimating_particles(d, plaza.SCALE_AND_BIASES)
    assert all(track.taken.all() for track in (trusting, biased, scaled))
    assert 2.5 < trusting.rmse_m(d) < 4.5
    assert biased.rmse_m(d) < 1.8
    assert scaled.rmse_m(d) < 0.42
    assert scaled.x[-1, 3] == pytest.approx(0.0695, abs=0.006)
    apart = np.linalg.norm(scaled.x[:, :2] - best().x[:, :2], axis=1)
    assert np.median(apart) < 0.25


def test_each_state_is_worth_it():
    rmse = [track.rmse_m(drive()) for track in (plaza.trusting(drive()), with_biases(), best())]
    assert rmse[0] > 2.0 * rmse[1] > 4.0 * rmse[2]
