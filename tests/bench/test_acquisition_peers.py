"""Searching ten milliseconds for a satellite's code, and Marcum's Q, against NumPy and SciPy."""

import numpy as np
import numpy.typing as npt
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy import fft, stats

import soopnav_cpp as sn

Iq = npt.NDArray[np.complex64]
RATE = 2.048e6
N = 2048
DOPPLERS = np.arange(-10, 11) * 500.0


@pytest.fixture(scope="module")
def iq() -> Iq:
    signal = sn.gps.SatelliteSignal(7, delay_s=300.0 / RATE, doppler_hz=1500.0, cn0_dbhz=42.0)
    return sn.gps.synthesize([signal], 10 * N, RATE, seed=1)


def search_scipy(iq: Iq) -> int:
    """Ten coherent sums of 1 ms, all of a Doppler in one transform; single precision."""
    code = sn.gps.ca_code(7).astype(np.float32)[np.arange(N) * 1023 // N]
    replica = np.conj(fft.fft(code)).astype(np.complex64)
    t = np.arange(len(iq)) / RATE
    best, where = 0.0, 0
    for doppler in DOPPLERS:
        wiped = (iq * np.exp(-2j * np.pi * doppler * t).astype(np.complex64)).reshape(-1, N)
        power = (np.abs(fft.ifft(fft.fft(wiped, axis=1) * replica, axis=1)) ** 2).sum(axis=0)
        if power.max() > best:
            best, where = float(power.max()), int(power.argmax())
    return where


@pytest.mark.benchmark(group="GPS search: 10 x 1 ms at 2.048 MHz, 21 Dopplers")
def test_acquirer(benchmark: BenchmarkFixture, iq: Iq) -> None:
    search = sn.gps.Acquirer(RATE, noncoherent=10)
    assert benchmark(search.search, iq, 7)[0].sample == 300


@pytest.mark.benchmark(group="GPS search: 10 x 1 ms at 2.048 MHz, 21 Dopplers")
def test_acquirer_scipy(benchmark: BenchmarkFixture, iq: Iq) -> None:
    assert benchmark(search_scipy, iq) == 300


@pytest.fixture(scope="module")
def arguments() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    rng = np.random.default_rng(1)
    return rng.uniform(0.0, 30.0, 2000), rng.uniform(0.0, 40.0, 2000)


@pytest.mark.benchmark(group="Marcum's Q of order 5, 2000 arguments")
def test_marcum_q(
    benchmark: BenchmarkFixture, arguments: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
) -> None:
    assert benchmark(sn.dsp.marcum_q, 5, *arguments).shape == (2000,)


@pytest.mark.benchmark(group="Marcum's Q of order 5, 2000 arguments")
def test_marcum_q_scipy(
    benchmark: BenchmarkFixture, arguments: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
) -> None:
    a, b = arguments
    assert benchmark(lambda: stats.ncx2.sf(b**2, 10, a**2)).shape == (2000,)
