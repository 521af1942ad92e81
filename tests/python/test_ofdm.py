"""OFDM symbols, the correlator and boundaries from Python, against NumPy."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soopnav_cpp import ofdm, simulation

GRID = ofdm.Numerology()


def double_sum(
    y: npt.NDArray[np.complex64], grid: ofdm.Numerology, symbols: int, oversampling: int = 1
) -> npt.NDArray[np.complex128]:
    """crosby (2.5), counted from 0."""
    M, N, v = (oversampling * n for n in (grid.symbol_samples, grid.subcarriers, grid.prefix))
    gamma = np.zeros(M, np.complex128)
    for m in range(M):
        index = M * np.arange(symbols)[:, None] + np.arange(m, m + v)
        gamma[m] = np.sum(y[index].astype(np.complex128) * y[index + N].conj())
    return gamma


@pytest.mark.crosscheck
@pytest.mark.parametrize(("constellation", "side"), [("qpsk", 2), ("16qam", 4), ("64qam", 8)])
def test_symbols_are_inverse_transforms_of_constellation_points_with_a_prefix(constellation: str, side: int) -> None:
    grid = ofdm.Numerology(48, 12, 1e6)
    x = ofdm.symbols(400, grid, constellation=constellation, seed=3).reshape(400, 60)
    np.testing.assert_array_equal(x[:, :12], x[:, 48:])
    points = np.fft.fft(x[:, 12:], axis=1) / np.sqrt(48)
    levels = np.arange(1 - side, side, 2) / np.sqrt(2 / 3 * (side**2 - 1))
    for part in (points.real, points.imag):
        nearest = np.abs(part[..., None] - levels).argmin(-1)
        np.testing.assert_allclose(part, levels[nearest], atol=1e-5)
        counts = np.bincount(nearest.ravel(), minlength=side)
        assert np.all(np.abs(counts - part.size / side) < 5 * np.sqrt(part.size / side))
    rebuilt = np.fft.ifft(points, axis=1) * np.sqrt(48)
    np.testing.assert_allclose(np.concatenate([rebuilt[:, -12:], rebuilt], axis=1), x, atol=1e-5)
    np.testing.assert_array_equal(x.ravel(), ofdm.symbols(400, grid, constellation=constellation, seed=3))
    assert not np.array_equal(x.ravel(), ofdm.symbols(400, grid, constellation=constellation, seed=3, stream=1))


@pytest.mark.crosscheck
@settings(max_examples=40, deadline=None)
@given(
    subcarriers=st.integers(2, 70),
    prefix=st.integers(1, 69),
    symbols=st.integers(1, 80),
    oversampling=st.integers(1, 3),
    seed=st.integers(0, 2**32),
)
def test_correlator_is_the_double_sum(
    subcarriers: int, prefix: int, symbols: int, oversampling: int, seed: int
) -> None:
    grid = ofdm.Numerology(subcarriers, 1 + prefix % (subcarriers - 1) if subcarriers > 2 else 1)
    random = np.random.default_rng(seed)
    count = (symbols + 1) * grid.symbol_samples * oversampling - 1
    y = (random.normal(size=count) + 1j * random.normal(size=count)).astype(np.complex64)
    expected = double_sum(y, grid, symbols, oversampling)
    found = ofdm.correlate(y, grid, symbols, oversampling=oversampling)
    assert found.dtype == np.complex128
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.law
@pytest.mark.parametrize("method", ["nearest_sample", "maximum_likelihood", "interpolated"])
def test_a_longer_path_is_a_later_boundary(method: str) -> None:
    estimator = ofdm.BoundaryEstimator(method=method)
    iq = ofdm.symbols(260, seed=1)
    for late in (0, 1, 40, 79):
        boundary = estimator.estimate(iq[80 - late :].copy())
        assert boundary.status == ofdm.BoundaryStatus.OK
        assert boundary.boundary_samples % 80 == pytest.approx(late, abs=0.01) or late == 0
        distance = (boundary.boundary_m - late * GRID.sample_m + 600) % GRID.ambiguity_m - 600
        assert distance == pytest.approx(0.0, abs=0.2)
    turned = (iq * np.exp(2j * np.pi * 30e3 / 20e6 * np.arange(len(iq)))).astype(np.complex64)
    assert estimator.estimate(turned).cfo_hz == pytest.approx(30e3, abs=2.0)


@pytest.mark.law
def test_link_moves_the_boundary_at_both_rates_and_in_both_ways() -> None:
    delay_m = np.linspace(0.0, 1190.0, 25)
    for movement in ("interpolate_and_shift", "fractional_delay"):
        for oversampling, tolerance_m in ((1, 12.0), (15, 3.0)):
            link = simulation.OfdmLink(GRID, 250, oversampling=oversampling, movement=movement)
            series = link.measure(delay_m, seed=1, folded=True, threads=2)
            error = (series.range_m - delay_m + 600) % GRID.ambiguity_m - 600
            assert np.abs(error).max() < tolerance_m
            assert series.folded is not None
            assert series.folded.shape == (25, 80 * oversampling)
            np.testing.assert_array_equal(series.range_m, link.measure(delay_m, seed=1).range_m)
            again = link.measure(delay_m[:1], seed=1, snr_db=-20.0)
            assert again.metric[0] < 0.3


@pytest.mark.law
def test_two_rays_are_told_apart() -> None:
    link = simulation.OfdmLink(GRID, 250, movement="fractional_delay")
    series = link.measure(
        np.full(20, 300.0),
        seed=4,
        reflection_extra_m=np.full(20, 400.0),
        reflection_gain=1.3 * np.exp(1j * np.arange(20)),
        folded=True,
    )
    assert np.median(np.abs(series.range_m - 300.0)) > 100.0
    timing = ofdm.TwoRayTiming()
    assert series.folded is not None
    rays = [timing.estimate(folded, 301.0, 2.0) for folded in series.folded]
    assert all(ray.two_rays and ray.status == ofdm.BoundaryStatus.OK for ray in rays)
    assert np.sqrt(np.mean([(ray.range_m - 300.0) ** 2 for ray in rays])) < 6.0
    assert np.mean([ray.strength for ray in rays]) == pytest.approx(1.3, abs=0.15)
    assert np.mean([ray.extra_m for ray in rays]) == pytest.approx(400.0, abs=6.0)


@pytest.mark.law
def test_threads_share_one_estimator() -> None:
    estimator = ofdm.BoundaryEstimator(method="interpolated")
    link = simulation.OfdmLink(GRID, 250)
    epochs = [link.iq(100.0 * k, seed=k) for k in range(8)]
    alone = [estimator.estimate(iq).boundary_m for iq in epochs]
    with ThreadPoolExecutor(4) as pool:
        together = [boundary.boundary_m for boundary in pool.map(estimator.estimate, epochs)]
    assert alone == together


@pytest.mark.unit
def test_what_is_wrong_is_a_sentence_or_a_status() -> None:
    with pytest.raises(ValueError, match=r"^subcarriers: 1; it must be 2 to 65536"):
        ofdm.Numerology(1, 1)
    with pytest.raises(ValueError, match=r"^prefix: 64; "):
        ofdm.Numerology(64, 64)
    with pytest.raises(ValueError, match=r'^method: "best"; it must be one of "nearest_sample", "magnitude", "m'):
        ofdm.BoundaryEstimator(method="best")
    with pytest.raises(ValueError, match=r"^snr_db: nan; it must lie between -60 and 100"):
        ofdm.BoundaryEstimator(snr_db=float("nan"))
    with pytest.raises(ValueError, match=r'^constellation: "bpsk"; '):
        ofdm.symbols(1, constellation="bpsk", seed=1)
    with pytest.raises(ValueError, match=r"^count: 0; "):
        ofdm.symbols(0, seed=1)
    with pytest.raises(ValueError, match=r'^movement: "walk"; '):
        simulation.OfdmLink(movement="walk")
    with pytest.raises(ValueError, match=r"^oversampling: 2; it must be 1 or 15"):
        simulation.OfdmLink(oversampling=2)
    with pytest.raises(ValueError, match=r"^iq: 100 samples are too few; 20 079 are needed"):
        ofdm.correlate(np.zeros(100, np.complex64))
    with pytest.raises(ValueError, match=r"^iq: "):
        ofdm.correlate(np.zeros(20080, np.complex128))  # type: ignore[arg-type]
    bad = ofdm.symbols(251, seed=1)
    bad[500] = np.nan
    with pytest.raises(ValueError, match=r"^iq: sample 500 is not finite"):
        ofdm.correlate(bad)
    estimator = ofdm.BoundaryEstimator()
    assert estimator.estimate(bad).status == ofdm.BoundaryStatus.NON_FINITE
    assert estimator.estimate(bad[:100]).status == ofdm.BoundaryStatus.TOO_SHORT
    assert estimator.estimate(np.zeros_like(bad)).status == ofdm.BoundaryStatus.NO_SIGNAL
    link = simulation.OfdmLink()
    with pytest.raises(ValueError, match=r"^delay_m: nan; "):
        link.iq(float("nan"), seed=1)
    with pytest.raises(ValueError, match=r"^snr_db: 200; "):
        link.measure([1.0], seed=1, snr_db=200.0)
    with pytest.raises(ValueError, match=r"^reflection_extra_m, reflection_gain: both or neither"):
        link.measure([1.0], seed=1, reflection_gain=[1.0])
    with pytest.raises(ValueError, match=r"^reflection_extra_m, reflection_gain: 2 and 1 elements; as many as delay_m"):
        link.measure([1.0], seed=1, reflection_extra_m=[1.0, 2.0], reflection_gain=[1.0])
    timing = ofdm.TwoRayTiming()
    assert timing.estimate(np.zeros(80), 0.0, 1.0).status == ofdm.BoundaryStatus.NO_SIGNAL
    assert timing.estimate(np.ones(79), 0.0, 1.0).status == ofdm.BoundaryStatus.TOO_SHORT
    assert timing.estimate(np.full(80, np.nan), 0.0, 1.0).status == ofdm.BoundaryStatus.NON_FINITE


@pytest.mark.unit
def test_values_read_well_and_pickle() -> None:
    grid = ofdm.Numerology(128, 32, 5e6)
    assert repr(grid) == "Numerology(subcarriers=128, prefix=32, sample_rate_hz=5e+06)"
    assert pickle.loads(pickle.dumps(grid)) == grid
    assert hash(grid) == hash(ofdm.Numerology(128, 32, 5e6))
    assert grid != GRID
    assert GRID.ambiguity_m == pytest.approx(1199.169832)
    assert GRID.symbol_s == pytest.approx(4e-6)
    fine = ofdm.BoundaryEstimator(oversampling=15)
    assert fine.offset_samples == -7.0
    assert fine.required_samples == 15 * 251 * 80 - 1
    assert repr(fine) == 'BoundaryEstimator(symbols=250, oversampling=15, method="nearest_sample")'
    estimator = ofdm.BoundaryEstimator()
    assert repr(estimator.estimate(ofdm.symbols(251, seed=1))).startswith("Boundary(0.000 +- 4.3")
    assert estimator.folded_differences().shape == (80,)
    assert ofdm.delay_crlb_m(0.0, 250, fraction=0.5) < ofdm.delay_crlb_m(0.0, 250) < ofdm.delay_crlb_m(-5.0, 250)
