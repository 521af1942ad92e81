"""Tracking a second of a pilot, and searching for it, against the obvious way to do it in NumPy."""

import numpy as np
import numpy.typing as npt
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import soopnav_cpp as sn

Iq = npt.NDArray[np.complex64]
RATE = 2.4576e6


@pytest.fixture(scope="module")
def second() -> Iq:
    return sn.cdma.synthesize([sn.cdma.PilotSignal(0, delay_s=1e-3, cn0_dbhz=45.0)], int(RATE), RATE, seed=1)


def correlate_numpy(iq: Iq) -> list[npt.NDArray[np.complex128]]:
    """Early, prompt and late sums of every 20 ms; no loops."""
    code = sn.cdma.pilot_code(0).conj()
    n = int(20e-3 * RATE)
    out = []
    for k in range(len(iq) // n):
        t = (np.arange(n) + k * n) / RATE
        wiped = iq[k * n : (k + 1) * n] * np.exp(-2j * np.pi * 1.0 * t)
        chips = (t - 1e-3) * sn.cdma.CHIP_RATE_HZ
        out.append(np.array([wiped @ code[np.floor(chips + d).astype(int) % 32768] for d in (0.25, 0.0, -0.25)]))
    return out


@pytest.mark.benchmark(group="one second of a CDMA pilot at 2.4576 MHz")
def test_tracker(benchmark: BenchmarkFixture, second: Iq) -> None:
    epochs = benchmark(lambda: sn.tracking.track(second, sn.tracking.Signal.cdma_pilot(), RATE, delay_s=1e-3))
    assert len(epochs) == 10


@pytest.mark.benchmark(group="one second of a CDMA pilot at 2.4576 MHz")
def test_tracker_numpy(benchmark: BenchmarkFixture, second: Iq) -> None:
    assert len(benchmark(correlate_numpy, second)) == 50


def search_numpy(iq: Iq) -> int:
    """One block, 5 ms, 21 Dopplers."""
    n, period = int(5e-3 * RATE), 65536
    replica = np.fft.fft(np.tile(np.repeat(sn.cdma.pilot_code(0), 2), 2))
    t = np.arange(n) / RATE
    best, where = 0.0, 0
    for doppler in np.arange(-10, 11) * 100.0:
        spectrum = np.fft.fft(iq[:n] * np.exp(-2j * np.pi * doppler * t), 2 * period)
        power = np.abs(np.fft.ifft(spectrum.conj() * replica)[:period]) ** 2
        if power.max() > best:
            best, where = float(power.max()), int(power.argmax())
    return where


@pytest.mark.benchmark(group="pilot search: 5 ms, +-1 kHz, all offsets")
def test_search(benchmark: BenchmarkFixture, second: Iq) -> None:
    searcher = sn.cdma.PilotSearcher(RATE, max_doppler_hz=1000.0, noncoherent=1)
    assert len(benchmark(searcher.search, second)) == 1


@pytest.mark.benchmark(group="pilot search: 5 ms, +-1 kHz, all offsets")
def test_search_numpy(benchmark: BenchmarkFixture, second: Iq) -> None:
    assert benchmark(search_numpy, second) == pytest.approx(65536 - 2458, abs=3)
