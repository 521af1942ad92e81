"""The univariate growth model through Python callables, against its exact posterior from a grid filter."""

from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp.estimation import Gaussian, ParticleFilter

VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "filters"

pytestmark = [pytest.mark.crosscheck, pytest.mark.consistency]

# x0 ~ N(0, 10), x = x/2 + 25 x / (1 + x²) + 8 cos(1.2 k) + N(0, 10), y = x²/20 + N(0, 1), k = 1 ... 100


@pytest.fixture(scope="module")
def truth():
    path = VECTORS / "ungm_grid_truth.npz"
    if not path.exists():
        pytest.skip("the reference vectors ../shared/vectors/filters/ungm_grid_truth.npz are not here")
    return np.load(path)


def run(truth, count, seed, steps=100, **options):
    """Means of the particles and the log-likelihood less the exact one."""
    cloud = ParticleFilter(count, prior=Gaussian([0.0], [[10.0]]), state=["x"], seed=seed, **options)
    mean = np.empty(steps)
    for k in range(1, steps + 1):
        y, push = truth["y"][k - 1], 8.0 * np.cos(1.2 * k)

        def moved(x, w, push=push):
            return 0.5 * x + 25.0 * x / (1.0 + x * x) + push + np.sqrt(10.0) * w

        def log_likelihood(x, y=y):
            return -0.5 * (y - x[:, 0] ** 2 / 20.0) ** 2 - 0.5 * np.log(2.0 * np.pi)

        assert cloud.step(log_likelihood, process=moved).accepted
        mean[k - 1] = cloud.mean[0]
    return mean, cloud.log_likelihood - truth["loglik_inc"][:steps].sum()


def errors(truth, count, runs, **options):
    """Errors of the mean, one row per run."""
    return np.array([run(truth, count, 1000 * count + s, **options)[0] for s in range(runs)]) - truth["post_mean"]


def off_by_standard_errors(error):
    """RMS over time of the runs' mean error, in units of its own standard error: about 1 without bias."""
    standard = error.std(axis=0, ddof=1) / np.sqrt(len(error))
    return np.sqrt(np.mean(error.mean(axis=0) ** 2) / np.mean(standard**2))


COUNTS = {500: 40, 5000: 30, 50_000: 10}


@pytest.fixture(scope="module")
def by_count(truth):
    return {count: errors(truth, count, runs) for count, runs in COUNTS.items()}


@pytest.mark.parametrize("count", COUNTS)
def test_posterior_mean_is_exact_within_its_monte_carlo_error(by_count, count):
    assert off_by_standard_errors(by_count[count]) < 2.5


def test_listing_resampling_is_not(truth):
    """The check can fail: the nearest entry of the cumulative sum mixes in particles that the weights spoke against."""
    assert off_by_standard_errors(errors(truth, 5000, 30, resampling="nearest")) > 2.5


def test_error_falls_with_the_root_of_the_count(by_count):
    # The median over time and runs: a few ambiguous times carry most of the mean square.
    size = [np.median(np.sqrt(np.mean(error**2, axis=0))) for error in by_count.values()]
    slope = np.polyfit(np.log(list(by_count)), np.log(size), 1)[0]
    assert -0.58 < slope < -0.42


def test_likelihood_is_not_biased(truth):
    """Its estimate, not its logarithm, has the exact one as its mean."""
    ratio = np.exp([run(truth, 2000, 7000 + s, steps=20)[1] for s in range(200)])
    assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std(ddof=1) / np.sqrt(len(ratio))
