"""LTE results as Python sees them: streams, instants, representations."""

import inspect

import numpy as np
import pytest

import soopnav_cpp as sn

pytestmark = pytest.mark.unit

RATE = 1.92e6
C = 299_792_458.0


def cell(**changes):
    return sn.lte.CellParameters(**({"cell_id": 301, "n_ports": 2, "delay_s": 4.2e-3, "start_sfn": 77} | changes))


@pytest.fixture(scope="module")
def iq():
    return sn.lte.synthesize(cell(), RATE, 153_600, snr_db=20.0, seed=2)


def test_a_capture_from_end_to_end(iq):
    (found,) = sn.lte.search(iq, RATE, max_cfo_hz=5e3)
    assert (found.cell_id, found.n_rb, found.n_ports, found.sfn) == (301, 6, 2, 77)
    assert (found.cp, found.duplex) == (sn.lte.CyclicPrefix.NORMAL, sn.lte.Duplex.FDD)
    assert found.frame_start_s == pytest.approx(4.2e-3, abs=0.5 / RATE)
    toa = sn.lte.time_of_arrival(iq, RATE, found)
    assert len(toa) == toa.toa_s.size == toa.sigma_s.size == toa.frame_index.size >= 7
    assert np.abs(toa.toa_s - 4.2e-3).max() < 5 * toa.sigma_s.max()
    assert toa.paths[0].delay_s == 0.0
    assert toa.impulse_response.dtype == np.float32
    assert toa.snr_db == pytest.approx(20.0, abs=1.5)


def test_without_the_broadcast_channel(iq):
    (found,) = sn.lte.search(iq, RATE, max_cfo_hz=5e3, decode_mib=False)
    assert (found.n_rb, found.n_ports, found.sfn) == (None, None, None)
    assert "n_rb=None" in repr(found)
    assert sn.lte.time_of_arrival(iq, RATE, found).toa_s[0] == pytest.approx(4.2e-3, abs=30 / C)


def test_a_detection_made_by_hand_is_timed(iq):
    known = sn.lte.Detection(cell_id=301, frame_start_s=4.2e-3, n_rb=6, n_ports=2)
    toa = sn.lte.time_of_arrival(iq, RATE, known)
    assert sn.lte.arrival_at(toa)[0] == pytest.approx(4.2e-3, abs=5 / C)


def test_a_stream_in_blocks_equals_the_window(iq):
    searcher = sn.lte.Searcher(RATE, window_s=0.04, max_cfo_hz=5e3)
    found = [list(searcher.push(np.ascontiguousarray(block))) for block in np.array_split(iq, 16)]
    # 80 ms: two windows, completed by blocks 8 and 16.
    assert [len(cells) for cells in found] == [0] * 7 + [1] + [0] * 7 + [1]
    (whole,) = sn.lte.Searcher(RATE, max_cfo_hz=5e3).search(iq[: round(0.04 * RATE)])
    assert repr(found[7][0]) == repr(whole)
    assert found[15][0].sfn == 77 + 4
    assert repr(searcher) == "Searcher(sample_rate_hz=1.92e+06, max_cfo_hz=5000, window_s=0.04)"


@pytest.mark.law
def test_an_instant_of_a_drifting_clock():
    drift_ppm = 20.0
    iq = sn.lte.synthesize(cell(clock_error_ppm=drift_ppm), RATE, 153_600, snr_db=25.0, seed=2)
    (found,) = sn.lte.search(iq, RATE, max_cfo_hz=5e3)
    toa = sn.lte.time_of_arrival(iq, RATE, found)
    assert toa.clock_error_ppm == pytest.approx(drift_ppm, abs=0.2)
    # The frame that starts at time t starts (t - 4.2 ms) * 20e-6 early: by the middle of the capture 0.7 us.
    for time_s in (4.2e-3, 0.04, 0.08):
        value, sigma = sn.lte.arrival_at(toa, time_s)
        assert abs(value - (4.2e-3 - (time_s - 4.2e-3) * drift_ppm * 1e-6)) < 5 * sigma
        assert sigma < 3 / C
    early, late = sn.lte.arrival_at(toa, 0.04)[1], sn.lte.arrival_at(toa, 0.5)[1]
    assert late > 3 * early  # a line is known best where the frames are


def test_an_instant_across_the_end_of_a_frame():
    # Frames start at 9.99993 ms and, with a slow clock, a little later each: beyond 10 ms they count from 0.
    iq = sn.lte.synthesize(cell(delay_s=9.99993e-3, clock_error_ppm=-5.0), RATE, 153_600, snr_db=25.0, seed=2)
    (found,) = sn.lte.search(iq, RATE, max_cfo_hz=5e3)
    toa = sn.lte.time_of_arrival(iq, RATE, found)
    value, sigma = sn.lte.arrival_at(toa, 0.06)
    expected = (9.99993e-3 + (0.06 - 9.99993e-3) * 5e-6) % 10e-3
    assert abs((value - expected + 5e-3) % 10e-3 - 5e-3) < 5 * sigma
    assert 0.0 <= value < 10e-3


def test_representations(iq):
    (found,) = sn.lte.search(iq, RATE, max_cfo_hz=5e3)
    assert repr(found).startswith(
        "Detection(cell_id=301, FDD, normal CP, n_rb=6, n_ports=2, sfn=77, frame_start_s=0.0042"
    )
    toa = sn.lte.time_of_arrival(iq, RATE, found)
    assert repr(toa).startswith(f"TimeOfArrival({len(toa)} frames, toa_s[0]=0.0042")
    assert repr(toa.paths[0]) == "Path(delay_s=0.000e+00, power_db=0.0)"
    assert repr(cell()) == (
        "CellParameters(cell_id=301, n_rb=6, n_ports=2, FDD, normal CP, delay_s=0.0042, power_db=0, cfo_hz=0, 1 taps)"
    )


@pytest.mark.law
def test_synthesis_in_blocks_is_synthesis_at_once():
    whole = sn.lte.synthesize(cell(), RATE, 10_000, noise_variance=0.1, seed=9)
    source = sn.lte.Synthesizer([cell()], RATE, noise_variance=0.1, seed=9)
    parts = [source.generate(n) for n in (1, 4000, 5999)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert source.position == 10_000
    source.seek(4001)
    np.testing.assert_array_equal(source.generate(5999), parts[2])
    np.testing.assert_array_equal(sn.lte.synthesize([cell()], RATE, 10_000, noise_variance=0.1, seed=9), whole)
    variance = sn.lte.noise_variance_for_snr(10.0)
    np.testing.assert_array_equal(
        sn.lte.synthesize(cell(), RATE, 100, snr_db=10.0), sn.lte.synthesize(cell(), RATE, 100, noise_variance=variance)
    )


def test_a_resource_grid():
    grid = sn.lte.resource_grid(cell(n_rb=15), 5, 0)
    assert grid.shape == (2, 14, 180)
    assert grid.dtype == np.complex64
    values, subcarriers = sn.lte.crs(301, 0, 0, port=1, n_rb=15)
    np.testing.assert_allclose(grid[1, 0, subcarriers], values, atol=1e-6)


def test_the_face_has_the_engine_s_defaults():
    """What a function of the face leaves out is what the engine would take: no second set of numbers."""
    cells = sn.lte.search(np.zeros(38_400, np.complex64), RATE)
    assert cells == []
    options = inspect.signature(sn.lte.search).parameters
    searcher = sn.lte.Searcher(RATE)
    assert options["max_cfo_hz"].default == searcher.max_cfo_hz


def test_enumerations():
    assert sn.lte.CyclicPrefix["EXTENDED"] is sn.lte.CyclicPrefix.EXTENDED
    assert [d.name for d in sn.lte.Duplex] == ["FDD", "TDD"]
