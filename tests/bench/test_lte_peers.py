"""The LTE receiver beside the same sums written with NumPy and SciPy, in one run.

pytest-benchmark groups each pair; the ratio of a group is the figure that docs/benchmarks.md gives.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import pytest
import scipy.fft
import scipy.optimize
from pytest_benchmark.fixture import BenchmarkFixture

import soopnav_cpp as sn

Iq = npt.NDArray[np.complex64]


@pytest.fixture(scope="module")
def capture() -> Iq:
    cell = sn.lte.CellParameters(cell_id=277, n_rb=6, n_ports=2, delay_s=1.234e-3, cfo_hz=35.2e3, start_sfn=74)
    return sn.lte.synthesize(cell, 1.92e6, 153_600, snr_db=10.0, seed=1)


def pss_bank_scipy(iq: Iq, max_cfo_hz: float, spacing_hz: float) -> tuple[int, int, int]:
    """Three PSS at a bank of carrier offsets, one forward transform per half-frame, powers summed: the first stage."""
    size, half_frame = 10_240, 9_600
    offsets = np.arange(-int(max_cfo_hz / spacing_hz), int(max_cfo_hz / spacing_hz) + 1)
    shifts = np.rint(offsets * spacing_hz * size / 1.92e6).astype(int)
    references = []
    for root in range(3):
        bins = np.zeros(128, np.complex64)
        bins[-31:], bins[1:32] = sn.lte.pss(root)[:31], sn.lte.pss(root)[31:]
        references.append(np.conj(scipy.fft.fft(scipy.fft.ifft(bins), size)).astype(np.complex64))
    power = np.zeros((len(shifts), 3, half_frame), np.float32)
    for start in range(0, len(iq) - size + 1, half_frame):
        spectrum = scipy.fft.fft(iq[start : start + size])
        for i, shift in enumerate(shifts):
            moved = np.roll(spectrum, -shift)
            for root, reference in enumerate(references):
                correlation = scipy.fft.ifft(moved * reference)[:half_frame]
                power[i, root] += correlation.real**2 + correlation.imag**2
    best = np.unravel_index(int(np.argmax(power)), power.shape)
    return int(best[0]), int(best[1]), int(best[2])


@pytest.mark.benchmark(group="search of 80 ms at 1.92 Msps, carrier within 150 kHz")
def test_wide_search(benchmark: BenchmarkFixture, capture: Iq) -> None:
    searcher = sn.lte.Searcher(1.92e6, max_cfo_hz=150e3)
    (cell,) = benchmark(searcher.search, capture)
    assert (cell.cell_id, cell.sfn) == (277, 74)


@pytest.mark.benchmark(group="search of 80 ms at 1.92 Msps, carrier within 150 kHz")
def test_wide_search_scipy_pss_only(benchmark: BenchmarkFixture, capture: Iq) -> None:
    _, root, lag = benchmark.pedantic(pss_bank_scipy, args=(capture, 150e3, 7.5e3), rounds=3)
    assert root == 277 % 3
    assert abs(lag - round((1.234e-3 * 1.92e6 + 832) % 9600)) <= 1


@pytest.fixture(scope="module")
def half_frame() -> Iq:
    cell = sn.lte.CellParameters(cell_id=277, n_rb=6, n_ports=2, delay_s=1.234e-3, cfo_hz=3e3)
    return sn.lte.synthesize(cell, 1.92e6, 10_240, snr_db=10.0, seed=1)


def sss_ranking_numpy(iq: Iq, lag: int, n_id_2: int, cfo_hz: float, table: npt.NDArray[np.float32]) -> int:
    """All SSS of one N_ID_2 coherently against the PSS, in the FDD position with the normal prefix alone."""
    turned = iq[lag - 137 : lag + 128] * np.exp(-2j * np.pi * cfo_hz / 1.92e6 * np.arange(265))
    spectra = [scipy.fft.fft(turned[at : at + 128]) for at in (0, 137)]
    sss, pss = (np.concatenate([s[-31:], s[1:32]]) for s in spectra)
    channel = np.convolve(pss * np.conj(sn.lte.pss(n_id_2)), np.ones(9) / 9, mode="same")
    return int(np.argmax(table @ (sss * channel.conj()).real))


@pytest.mark.benchmark(group="one half-frame: three PSS within 7.5 kHz, then SSS")
def test_half_frame(benchmark: BenchmarkFixture, half_frame: Iq) -> None:
    searcher = sn.lte.Searcher(1.92e6, max_cfo_hz=7.5e3, decode_mib=False, max_cells=1)
    (cell,) = benchmark(searcher.search, half_frame)  # goes on to the reference signals, estimates and cancellation
    assert cell.cell_id == 277


@pytest.mark.benchmark(group="one half-frame: three PSS within 7.5 kHz, then SSS")
def test_half_frame_scipy(benchmark: BenchmarkFixture, half_frame: Iq) -> None:
    ids = [(n, s) for n in range(1, 504, 3) for s in (0, 5)]
    table = np.array([sn.lte.sss(cell, subframe) for cell, subframe in ids])

    def run() -> int:
        _, root, lag = pss_bank_scipy(half_frame, 7.5e3, 5.0625e3)
        return ids[sss_ranking_numpy(half_frame, lag, root, 3e3, table)][0]

    assert benchmark(run) == 277


def subframe_toa_numpy(iq: Iq, cell_id: int) -> float:
    """CRS estimate of both ports and maximum-likelihood delay of a 100-block subframe at 30.72 Msps."""
    channel = np.zeros((2, 400), np.complex128)
    for slot in range(2):
        for symbol, start in ((0, 160), (4, 160 + 4 * 2048 + 4 * 144)):
            at = slot * 15_360 + start + 614
            spectrum = scipy.fft.fft(iq[at : at + 2048]) / np.sqrt(2048)
            for port in range(2):
                values, subcarriers = sn.lte.crs(cell_id, slot, symbol, port=port, n_rb=100)
                centred = subcarriers - 600
                received = spectrum[np.where(centred < 0, centred, centred + 1)]
                channel[port, subcarriers // 3] += received * values.conj() / 2
    centred = 3 * np.arange(400) + cell_id % 3 - 600
    frequencies = np.where(centred < 0, centred, centred + 1)
    power = np.sum(np.abs(scipy.fft.ifft(channel, 2048, axis=1)) ** 2, axis=0)
    peak = int(np.argmax(power))
    tau = (peak if peak < 1024 else peak - 2048) / 2048 / 45e3
    omega = 2 * np.pi * 15e3 * frequencies
    for _ in range(5):  # Newton on the sum of both ports' powers
        s0 = channel * np.exp(1j * omega * tau)
        a, b, c = s0.sum(1), (s0 * omega).sum(1), (s0 * omega**2).sum(1)
        slope = np.sum(2 * (a.conj() * 1j * b).real)
        curvature = np.sum(2 * (np.abs(b) ** 2 - (a.conj() * c).real))
        tau -= slope / curvature
    return 614 / 30.72e6 + tau


@pytest.fixture(scope="module")
def subframe() -> Iq:
    cell = sn.lte.CellParameters(cell_id=277, n_rb=100, n_ports=2, delay_s=614 / 30.72e6 + 0.3e-6)
    return sn.lte.synthesize(cell, 30.72e6, 33_792, snr_db=10.0, seed=1)


@pytest.mark.benchmark(group="CRS and delay of one 100-RB subframe at 30.72 Msps")
def test_subframe_toa(benchmark: BenchmarkFixture, subframe: Iq) -> None:
    detection = sn.lte.Detection(cell_id=277, frame_start_s=614 / 30.72e6, n_rb=100, n_ports=2)
    estimator = sn.lte.SubframeToaEstimator(30.72e6, detection)
    toa = benchmark(estimator.estimate, subframe, 0, 614 / 30.72e6)
    assert toa.toa_s == pytest.approx(614 / 30.72e6 + 0.3e-6, abs=1e-9)


@pytest.mark.benchmark(group="CRS and delay of one 100-RB subframe at 30.72 Msps")
def test_subframe_toa_numpy(benchmark: BenchmarkFixture, subframe: Iq) -> None:
    toa_s = benchmark(subframe_toa_numpy, subframe, 277)
    assert toa_s == pytest.approx(614 / 30.72e6 + 0.3e-6, abs=1e-9)


@pytest.fixture(scope="module")
def searchers() -> list[sn.lte.Searcher]:
    return [sn.lte.Searcher(1.92e6, max_cfo_hz=150e3) for _ in range(2)]


@pytest.mark.benchmark(group="two searches of 80 ms")
def test_two_searches_in_turn(benchmark: BenchmarkFixture, capture: Iq, searchers: list[sn.lte.Searcher]) -> None:
    found = benchmark(lambda: [searcher.search(capture) for searcher in searchers])
    assert all(len(cells) == 1 for cells in found)


@pytest.mark.benchmark(group="two searches of 80 ms")
def test_two_searches_in_two_threads(
    benchmark: BenchmarkFixture, capture: Iq, searchers: list[sn.lte.Searcher]
) -> None:
    with ThreadPoolExecutor(2) as pool:
        found = benchmark(lambda: list(pool.map(lambda searcher: searcher.search(capture), searchers)))
    assert all(len(cells) == 1 for cells in found)


def resample_often(iq: Iq) -> int:
    return sum(len(sn.dsp.resample(iq, 30.72e6, 1.92e6)) for _ in range(400))


@pytest.mark.benchmark(group="two times 400 resamplings of a subframe")
def test_two_resamplings_in_turn(benchmark: BenchmarkFixture, subframe: Iq) -> None:
    benchmark(lambda: [resample_often(subframe) for _ in range(2)])


@pytest.mark.benchmark(group="two times 400 resamplings of a subframe")
def test_two_resamplings_in_two_threads(benchmark: BenchmarkFixture, subframe: Iq) -> None:
    with ThreadPoolExecutor(2) as pool:
        benchmark(lambda: list(pool.map(lambda _: resample_often(subframe), range(2))))


@pytest.fixture(scope="module")
def close_paths() -> tuple[Iq, npt.NDArray[np.int64]]:
    centred = 3 * np.arange(400) + 1 - 600
    f = np.where(centred < 0, centred, centred + 1)
    rng = np.random.default_rng(1)
    gains = np.array([[1.0, 1j], [0.8j, -0.8]])
    clean = np.einsum("lp,lf->pf", gains, np.exp(-2j * np.pi * 15e3 * np.outer([0.0, 28e-9], f)))
    noise = rng.normal(scale=0.1, size=(2, 2, f.size))
    return (clean + noise[0] + 1j * noise[1]).astype(np.complex64), f


def two_paths_scipy(channel: Iq, f: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """The same least squares with the amplitudes projected out, by SciPy from the pair grid's best."""
    data = channel.T.astype(np.complex128)

    def residual(delays_ns: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        steering = np.exp(-2j * np.pi * 15e-6 * np.outer(f, delays_ns))
        left = data - steering @ np.linalg.lstsq(steering, data, rcond=None)[0]
        return np.concatenate([left.real.ravel(), left.imag.ravel()])

    grid = np.arange(-60.0, 60.0, 7.0)
    pairs = [np.array([a, b]) for i, a in enumerate(grid) for b in grid[i + 2 :]]
    start = min(pairs, key=lambda pair: float(np.sum(residual(pair) ** 2)))
    return np.sort(scipy.optimize.least_squares(residual, start).x) * 1e-9


@pytest.mark.benchmark(group="two paths half a cell apart, 400 elements, two ports")
def test_resolve_paths(benchmark: BenchmarkFixture, close_paths: tuple[Iq, npt.NDArray[np.int64]]) -> None:
    resolver = sn.lte.PathResolver()
    paths = benchmark(resolver.resolve, *close_paths, 0.02)
    assert len(paths) == 2
    assert abs(paths.toa_s) < 2e-9


@pytest.mark.benchmark(group="two paths half a cell apart, 400 elements, two ports")
def test_resolve_paths_scipy(benchmark: BenchmarkFixture, close_paths: tuple[Iq, npt.NDArray[np.int64]]) -> None:
    delays = benchmark.pedantic(two_paths_scipy, args=close_paths, rounds=3)
    assert abs(delays[0]) < 2e-9
