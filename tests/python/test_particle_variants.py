"""Particle filters that look ahead, spread copies, follow the spread with their number, or keep the clock exact."""

import pickle

import numpy as np
import pytest

from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import (
    AdaptiveCount,
    ExtendedKalmanFilter,
    Gaussian,
    Measured,
    ParticleFilter,
    ParticleStatus,
    Samples,
    Uniform,
)

SOURCES = np.array([[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]])
MODELS = [measurement.Pseudorange(q) for q in SOURCES]
CLOCKED = "position_velocity_clock2"
MOTION = process.NearlyConstantVelocity(0.05, clock=(0.04, 0.0025))
X0 = np.array([400.0, 600.0, 1.0, -0.5, 30.0, 0.1])
P0 = np.diag([25.0, 25.0, 0.25, 0.25, 400.0, 0.25])
SIGMA = 2.0


def drive(seed, steps=15):
    """A receiver with a clock that drifts: truth by its own arithmetic, and pseudoranges."""
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(X0, P0)
    z = np.empty((steps, 4))
    for k in range(steps):
        a = rng.normal(size=(2, 2)) * np.sqrt(0.05)
        x[:2] += x[2:4] + 0.5 * a[0] + a[1] / np.sqrt(12.0)
        x[2:4] += a[0]
        w = rng.normal(size=3)
        x[4] += x[5] + 0.5 * 0.05 * w[0] + 0.05 / np.sqrt(12.0) * w[1] + 0.2 * w[2]
        x[5] += 0.05 * w[0]
        z[k] = np.linalg.norm(SOURCES - x[:2], axis=1) + x[4] + rng.normal(size=4) * SIGMA
    return np.arange(1.0, steps + 1.0), z, x


def cloud(count=500, seed=1, **options):
    return ParticleFilter(count, prior=Gaussian(X0, P0), state=CLOCKED, seed=seed, **options)


def everything(pf):
    return pickle.dumps((pf.particles, pf.weights, pf.covariance, pf.log_likelihood, pf.count))


def test_marginalized_clock_is_the_kalman_filter_where_nothing_is_sampled():
    times, z, _ = drive(3)
    certain = np.diag([0.0, 0.0, 0.0, 0.0, 400.0, 0.25])
    motion = process.NearlyConstantVelocity(0.0, clock=(0.04, 0.0025))
    pf = ParticleFilter(
        20, prior=Gaussian(X0, certain), state=CLOCKED, marginalized_clock=True, resampling="multinomial"
    )
    ekf = ExtendedKalmanFilter(CLOCKED, X0, certain)
    run = pf.run(times, motion, Measured(MODELS, z, SIGMA), start_s=0.0)
    exact = ekf.run(times, motion, [(MODELS, z, np.eye(4) * SIGMA**2)], start_s=0.0)
    assert np.all(run.status == ParticleStatus.ACCEPTED)
    np.testing.assert_allclose(run.mean, exact.x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.covariance, exact.P, rtol=0, atol=1e-8)


@pytest.mark.consistency
def test_marginalized_clock_needs_fewer_particles():
    """Against the EKF, which is all but exact here; and its NEES, which a filter of few particles must earn."""
    runs, n = 120, 6
    exactly = sampled = nees = 0.0
    for k in range(runs):
        times, z, truth = drive(1000 + k)
        exact = ExtendedKalmanFilter(CLOCKED, X0, P0).run(
            times, MOTION, [(MODELS, z, np.eye(4) * SIGMA**2)], start_s=0.0
        )
        for marginalized in (True, False):
            pf = cloud(4000, seed=k, marginalized_clock=marginalized, ess_threshold=0.7)
            run = pf.run(times, MOTION, Measured(MODELS, z, SIGMA), start_s=0.0, covariance=False)
            error = run.mean[-1] - exact.x[-1]
            square = error @ np.linalg.solve(exact.P[-1], error) / runs
            if marginalized:
                exactly += square
                e = pf.mean - truth
                nees += e @ np.linalg.solve(pf.covariance, e)
            else:
                sampled += square
    assert exactly < 0.1 * sampled
    # Chi-square of 720 degrees of freedom within 3.9 sigma; a finite cloud adds some hundredths.
    spread = 3.9 * np.sqrt(2.0 * runs * n)
    assert runs * n - spread < nees < (runs * n + spread) * 1.08


def test_marginalized_clock_goes_on_after_pickling_and_updates_alone():
    times, z, _ = drive(5)
    pf = cloud(marginalized_clock=True)
    pf.run(times[:5], MOTION, Measured(MODELS, z[:5], SIGMA), start_s=0.0)
    twin = pickle.loads(pickle.dumps(pf))
    for one in (pf, twin):
        assert one.step(MODELS, z[5], SIGMA, process=MOTION, dt_s=1.0).accepted
        assert one.update(MODELS[:2], z[5][:2], SIGMA).accepted
        assert one.predict(MOTION, 1.0).accepted
    assert everything(pf) == everything(twin)


def test_marginalized_clock_refusals():
    with pytest.raises(ValueError, match="no clock"):
        ParticleFilter(10, prior=Gaussian([0, 0], np.eye(2)), marginalized_clock=True)
    correlated = P0.copy()
    correlated[0, 4] = correlated[4, 0] = 1.0
    with pytest.raises(ValueError, match=r"P0\[0, 4\] correlates the clock"):
        ParticleFilter(10, prior=Gaussian(X0, correlated), state=CLOCKED, marginalized_clock=True)
    for prior in (Uniform(X0 - 1, X0 + 1), Samples(np.tile(X0, (10, 1)))):
        with pytest.raises(ValueError, match="Gaussian expected with marginalized_clock"):
            ParticleFilter(10, prior=prior, state=CLOCKED, marginalized_clock=True)
    pf = cloud(50, marginalized_clock=True)
    before = everything(pf)
    with pytest.raises(ValueError, match="process model expected with marginalized_clock"):
        pf.predict(lambda x, w: x)
    with pytest.raises(ValueError, match="outlier_probability: not with marginalized_clock"):
        pf.update(MODELS[0], 600.0, 1.0, outlier_probability=0.1, outlier_density=1e-3)
    z = np.linalg.norm(SOURCES - X0[:2], axis=1) + 30.0
    assert pf.update(MODELS, np.where(np.arange(4) == 2, np.nan, z), SIGMA).status == ParticleStatus.NON_FINITE
    assert pf.update(MODELS, z, [1, 1, 0, 1]).status == ParticleStatus.NOT_POSITIVE_DEFINITE
    assert pf.update(MODELS * 5, np.tile(z, 5), SIGMA).status == ParticleStatus.TOO_MANY_ROWS
    assert pf.step(MODELS, z * np.nan, SIGMA, process=MOTION, dt_s=1.0).status == ParticleStatus.NON_FINITE
    assert pf.predict(MOTION, 0.0).status == ParticleStatus.TIME_NOT_ADVANCING
    assert pf.update(MODELS, z + 1e200, SIGMA).status == ParticleStatus.DEGENERATE
    assert everything(pf) == before


@pytest.mark.parametrize(
    "options",
    [
        {"auxiliary": True},
        {"auxiliary": True, "regularisation": 1.0},
        {"regularisation": 0.5},
        {"adaptive": AdaptiveCount([1.0, 1.0, 0.5, 0.5, 1.0, 0.2], least=30)},
        {"marginalized_clock": True, "regularisation": 1.0, "adaptive": AdaptiveCount([1.0, 1.0, 0.5, 0.5, 0, 0])},
        {"marginalized_clock": True, "auxiliary": True},
    ],
)
def test_variants_follow_and_threads_do_not_show(options):
    times, z, truth = drive(8)
    pf = cloud(20_000, ess_threshold=0.8, **options)
    run = pf.run(times, MOTION, Measured(MODELS, z, SIGMA), start_s=0.0)
    assert np.all(run.status == ParticleStatus.ACCEPTED)
    error = pf.mean - truth
    assert np.all(np.abs(error) < 5.0 * np.sqrt(np.diag(pf.covariance)))
    assert np.all(np.linalg.eigvalsh(run.covariance) > 0.0)
    assert run.count[-1] == pf.count == len(pf.particles) == len(pf.weights)
    again = cloud(20_000, ess_threshold=0.8, threads=3, **options)
    again.run(times, MOTION, Measured(MODELS, z, SIGMA), start_s=0.0)
    assert everything(again) == everything(pf)
    twin = pickle.loads(pickle.dumps(pf))
    assert everything(twin) == everything(pf)
    for one in (pf, twin):
        one.step(MODELS, z[-1], SIGMA, process=MOTION, dt_s=1.0)
    assert everything(twin) == everything(pf)


def test_adaptive_count_falls_and_rises():
    room = [(0.0, 100.0), (0.0, 100.0)]
    corners = [measurement.Range(q) for q in ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0))]
    here = np.array([30.0, 60.0])
    z = [np.hypot(*(here - q)) for q in ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0))]
    walk = process.RandomWalk(0.01)
    pf = ParticleFilter(
        20_000, prior=Uniform(room), seed=4, adaptive=AdaptiveCount([1.0, 1.0], least=100, divergence=0.05)
    )
    for _ in range(5):
        assert pf.step(corners, z, 1.0, process=walk, dt_s=1.0).accepted
    assert 100 <= pf.count < 1000
    assert np.linalg.norm(pf.mean - here) < 1.0
    settled = pf.count
    assert pf.predict(process.RandomWalk(100.0), 1.0).accepted
    pf.resample()
    assert pf.count > 2 * settled
    # A motion of one's own gets as many particles as there will be.
    report = pf.predict(lambda x, w: x + 0.1 * w)
    assert report.accepted
    assert pf.particles.shape == (pf.count, 2)


def test_regularisation_parts_the_copies_for_a_motion_of_ones_own():
    pf = ParticleFilter(1000, prior=Gaussian([0.0], [[1.0]]), seed=2, regularisation=1.0, ess_threshold=1.0)
    plain = ParticleFilter(1000, prior=Gaussian([0.0], [[1.0]]), seed=2, ess_threshold=1.0)
    for one in (pf, plain):
        for _ in range(10):
            one.reweight(-0.5 * (one.particles[:, 0] - 0.5) ** 2 / 0.25)
            one.predict(lambda x, w: x)
    assert len(np.unique(pf.particles)) == 1000
    assert len(np.unique(plain.particles)) < 300


RESAMPLED_FIRST = [{"regularisation": 1.0}, {"adaptive": AdaptiveCount([0.2, 0.2])}]


def lopsided(options):
    """A cloud whose next step begins by resampling."""
    pf = ParticleFilter(400, prior=Gaussian([0.0, 0.0], np.eye(2)), seed=2, ess_threshold=1.0, **options)
    pf.reweight(-2.0 * pf.particles[:, 0] ** 2)
    return pf


def all_saved(pf):
    return [np.asarray(value).tobytes() for value in pf.save().values()]


@pytest.mark.unit
@pytest.mark.parametrize("options", RESAMPLED_FIRST, ids=["spread", "adaptive"])
def test_what_fails_after_resampling_leaves_the_filter_as_it_was(options):
    pf = lopsided(options)
    before = all_saved(pf)
    calls = [
        (lambda: pf.step(lambda x: 1 / 0), ZeroDivisionError),
        (lambda: pf.step(lambda x: [0.0]), ValueError),
        (lambda: pf.step(lambda x: 1 / 0, process=lambda x, w: x), ZeroDivisionError),
        (lambda: pf.predict(lambda x, w: 1 / 0), ZeroDivisionError),
        (lambda: pf.predict(lambda x, w: x[:3]), ValueError),
        (lambda: pf.predict(lambda x, w: x, noise=-1), ValueError),
    ]
    for call, error in calls:
        with pytest.raises(error):
            call()
        assert all_saved(pf) == before
    report = pf.step(measurement.Range([3.0, 0.0]), np.nan, 1.0, process=lambda x, w: x)
    assert report.status == ParticleStatus.NON_FINITE
    assert report.ess == pf.ess < 400
    assert not report.resampled
    assert all_saved(pf) == before


@pytest.mark.unit
@pytest.mark.parametrize("options", [{}, *RESAMPLED_FIRST], ids=["plain", "spread", "adaptive"])
def test_a_step_of_ones_own_says_that_it_resampled(options):
    for call in (
        lambda pf: pf.step(lambda x: -(x[:, 1] ** 2)),
        lambda pf: pf.predict(lambda x, w: x + 0.1 * w),
        lambda pf: pf.step(lambda x: -(x[:, 1] ** 2), process=lambda x, w: x + 0.1 * w),
    ):
        pf = lopsided(options)
        assert call(pf).resampled
        pf.resample()
        assert not call(pf).resampled  # equal weights


@pytest.mark.unit
def test_what_no_filter_saved_is_not_restored():
    prior = Gaussian([0.0, 0.0, 0.0], np.diag([1.0, 1.0, 9.0]))
    pf = ParticleFilter(50, prior=prior, state="position_clock2", marginalized_clock=True)
    before = all_saved(pf)
    bad = [
        ("log_likelihood", np.nan, r"saved\['log_likelihood'\]: nan"),
        ("steps", np.array(-1), r"saved\['steps'\]: -1"),
        ("restarts", np.array(0.5), r"saved\['restarts'\]: an integer expected"),
        ("log_weights", np.zeros(49), r"saved\['log_weights'\]: shape \(49,\)"),
        ("clock_covariance", np.array([np.nan]), r"saved\['clock_covariance'\]"),
        ("clock_covariance", np.array([-1.0]), r"saved\['clock_covariance'\]"),
        ("clock_covariance", np.ones(3), r"saved\['clock_covariance'\]"),
        ("clock_covariance", np.ones(4), "clock_covariance: wrong size"),
    ]
    for name, value, message in bad:
        with pytest.raises(ValueError, match=message):
            pf.restore(pf.save() | {name: value})
        assert all_saved(pf) == before


def test_set_up_is_checked():
    prior = Gaussian([0.0, 0.0], np.eye(2))
    bad = [
        ({"regularisation": -1.0}, "regularisation"),
        ({"regularisation": np.nan}, "regularisation"),
        ({"adaptive": AdaptiveCount([1.0])}, "bin_sizes has 1 numbers; the state has 2"),
        ({"adaptive": AdaptiveCount([])}, "adaptive.bin_sizes"),
        ({"adaptive": AdaptiveCount([1.0, -1.0])}, r"adaptive.bin_sizes\[1\]"),
        ({"adaptive": AdaptiveCount([0.0, 0.0])}, "at least one must be positive"),
        ({"adaptive": AdaptiveCount([1.0, 1.0], least=0)}, "adaptive.least"),
        ({"adaptive": AdaptiveCount([1.0, 1.0], least=101)}, "adaptive.least"),
        ({"adaptive": AdaptiveCount([1.0, 1.0], divergence=0.0)}, "adaptive.divergence"),
        ({"adaptive": AdaptiveCount([1.0, 1.0], probability=1.0)}, "adaptive.probability"),
        ({"adaptive": AdaptiveCount([1.0, 1.0]), "auxiliary": True}, "not together with auxiliary"),
    ]
    for options, message in bad:
        with pytest.raises(ValueError, match=message):
            ParticleFilter(100, prior=prior, **options)
    pf = ParticleFilter(100, prior=prior, auxiliary=True)
    with pytest.raises(ValueError, match="process model expected with auxiliary"):
        pf.predict(lambda x, w: x)
