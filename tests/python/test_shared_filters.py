"""Filters used by two threads at once, reports kept and copied, and inputs that no filter may take in."""

import copy
import pickle
import threading

import numpy as np
import pytest

from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import (
    AdaptiveProcessNoise,
    ExtendedKalmanFilter,
    FixedLagFilter,
    Gaussian,
    InformationFilter,
    InteractingMultipleModel,
    IteratedKalmanFilter,
    ParticleFilter,
    ParticleStatus,
    SquareRootKalmanFilter,
    UnscentedKalmanFilter,
    UpdateStatus,
    error_ellipse,
)

KINDS = (
    ExtendedKalmanFilter,
    IteratedKalmanFilter,
    UnscentedKalmanFilter,
    SquareRootKalmanFilter,
    InformationFilter,
)
START = ("position_velocity2", [0.0, 0.0, 1.0, 0.0], np.diag([25.0, 25.0, 1.0, 1.0]))
MOTION = process.NearlyConstantVelocity(0.1)
FIX = measurement.Position(2)
STEPS = 3000
TIME_S = np.arange(1.0, STEPS + 1.0)
FIXES = np.random.default_rng(4).normal(0.0, 1.0, (STEPS, 2)) + TIME_S[:, None] * [1.0, 0.0]


def together(call, times=6):
    """`call` from two threads at once, again and again; what either raised is raised here."""
    failures = []

    def work():
        try:
            call()
        except Exception as error:
            failures.append(error)

    for _ in range(times):
        threads = [threading.Thread(target=work) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    if failures:
        raise failures[0]


def is_covariance(P):
    return np.all(np.isfinite(P)) and np.allclose(P, P.T) and np.all(np.linalg.eigvalsh(P) > 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_two_threads_on_one_filter(kind):
    alone = kind(*START)
    alone.run(TIME_S, MOTION, [(FIX, FIXES, 1.0)], start_s=0.0)
    shared, noise = kind(*START), AdaptiveProcessNoise()
    settled = alone.P
    together(lambda: shared.run(TIME_S, MOTION, [(FIX, FIXES, 1.0)], start_s=0.0))
    assert is_covariance(shared.P)
    np.testing.assert_allclose(shared.P, settled, rtol=1e-9)  # after so many steps it forgot how it began
    together(lambda: shared.run(TIME_S, MOTION, [(FIX, FIXES, 1.0)], start_s=0.0, adaptive_noise=noise), times=2)
    assert is_covariance(shared.P)


def test_two_threads_on_one_multiple_model():
    imm = InteractingMultipleModel(*START, [MOTION, process.NearlyConstantVelocity(10.0)], [[0.9, 0.1], [0.1, 0.9]])
    together(lambda: imm.run(TIME_S, [(FIX, FIXES, 1.0)], start_s=0.0))
    assert is_covariance(imm.P)
    assert imm.probabilities.sum() == pytest.approx(1.0)


def test_two_threads_on_one_fixed_lag_filter():
    late = FixedLagFilter(ExtendedKalmanFilter(*START), MOTION, capacity=20)
    together(lambda: late.run([(FIX, FIXES, 1.0, TIME_S, TIME_S)]))
    assert is_covariance(late.P)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_reports_can_be_kept(duplicate):
    ekf = ExtendedKalmanFilter(*START)
    report = ekf.update(FIX, [1.0, -2.0], np.diag([1.0, 4.0]))
    again = duplicate(report)
    assert (again.status, again.nis, again.log_likelihood) == (report.status, report.nis, report.log_likelihood)
    np.testing.assert_array_equal(again.innovation, report.innovation)
    np.testing.assert_array_equal(again.covariance, report.covariance)
    assert repr(again) == repr(report)
    cloud = ParticleFilter(100, prior=Gaussian([0.0, 0.0], np.eye(2)))
    report = cloud.update(FIX, [0.1, 0.2], 1.0)
    assert repr(duplicate(report)) == repr(report)
    assert duplicate(report).accepted
    ellipse = error_ellipse(np.diag([4.0, 1.0]))
    assert repr(duplicate(ellipse)) == repr(ellipse)


@pytest.mark.parametrize("kind", KINDS)
def test_a_direction_to_where_one_stands(kind):
    kf = kind("position2", [3.0, 4.0], np.eye(2))
    before = pickle.dumps((kf.x, kf.P))
    report = kf.update(measurement.Azimuth([3.0, 4.0]), 0.3, 0.01)
    assert report.status == UpdateStatus.UNDEFINED
    assert pickle.dumps((kf.x, kf.P)) == before


def test_adaptive_noise_learns_nothing_from_an_impossible_covariance():
    noise = AdaptiveProcessNoise()
    ekf = ExtendedKalmanFilter("position2", [0.0, 0.0], np.eye(2))
    report = ekf.update(FIX, [0.5, 0.5], 1.0)
    for R in (-1.0, 0.0, np.nan, [[1.0, 0.5], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]]):
        assert not noise.observe(report, R)
        assert noise.multiplier == 1.0
    assert noise.observe(report, 1.0)


def test_a_step_beyond_all_numbers():
    x0, P0 = np.zeros(6), np.eye(6)
    pf = ParticleFilter(50, prior=Gaussian(x0, P0), state="position_velocity_clock2", marginalized_clock=True)
    before = pickle.dumps((pf.particles, pf.covariance))
    motion = process.NearlyConstantVelocity(0.0, clock=(1.0, 1.0))
    assert pf.predict(motion, 1e150).status == ParticleStatus.NON_FINITE
    assert pickle.dumps((pf.particles, pf.covariance)) == before
