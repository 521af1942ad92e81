"""The cyclic-prefix correlator over 250 symbols against the obvious way to do it in NumPy."""

import numpy as np
import numpy.typing as npt
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import soopnav_cpp as sn

Iq = npt.NDArray[np.complex64]


@pytest.fixture(scope="module", params=[1, 15], ids=["20 MHz", "300 MHz"])
def epoch(request: pytest.FixtureRequest) -> tuple[int, Iq]:
    return request.param, sn.simulation.OfdmLink(oversampling=request.param).iq(123.0, seed=1)


def correlate_numpy(iq: Iq, oversampling: int) -> npt.NDArray[np.complex64]:
    """All products at once, folded, and a cumulative sum for the window."""
    period, lag, window = 80 * oversampling, 64 * oversampling, 16 * oversampling
    products = iq[:-lag] * iq[lag:].conj()
    folded = products[: 250 * period].reshape(250, period).sum(0)
    extra = folded[:window] - products[:window] + products[250 * period : 250 * period + window]
    total = np.concatenate([[0], np.cumsum(np.concatenate([folded, extra]))])
    return (total[window:] - total[:-window])[:period]


@pytest.mark.benchmark(group="boundary from 250 OFDM symbols")
def test_estimator(benchmark: BenchmarkFixture, epoch: tuple[int, Iq]) -> None:
    estimator = sn.ofdm.BoundaryEstimator(oversampling=epoch[0])
    boundary = benchmark(estimator.estimate, epoch[1])
    assert boundary.boundary_m == pytest.approx(123.0, abs=10.0)


@pytest.mark.benchmark(group="boundary from 250 OFDM symbols")
def test_numpy(benchmark: BenchmarkFixture, epoch: tuple[int, Iq]) -> None:
    oversampling, iq = epoch
    top = benchmark(lambda: int(np.argmax(correlate_numpy(iq, oversampling).real)))
    assert top * 14.99 / oversampling == pytest.approx(123.0, abs=10.0)
