"""What search and time of arrival say to bad samples and bad arguments."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn

pytestmark = pytest.mark.unit

RATE = 1.92e6
FAST = {"max_cfo_hz": 2e3}


def capture(duration_s=0.02, rate_hz=RATE, **cell):
    cell = {"cell_id": 137, "n_ports": 1, "delay_s": 3.21e-3} | cell
    return sn.lte.synthesize(sn.lte.CellParameters(**cell), rate_hz, round(duration_s * rate_hz), snr_db=20.0, seed=3)


def refusal(call, *args, **kwargs):
    with pytest.raises(ValueError) as caught:
        call(*args, **kwargs)
    return str(caught.value)


@pytest.mark.parametrize(
    ("samples", "sentence"),
    [
        (0, "iq: 0 samples (0 ms) are too few; one half-frame and a symbol (5.2 ms) are needed"),
        (1, "iq: 1 sample (0.000521 ms) is too few; one half-frame and a symbol (5.2 ms) are needed"),
        (4800, "iq: 4 800 samples (2.5 ms) are too few; one half-frame and a symbol (5.2 ms) are needed"),
    ],
)
def test_too_short(samples, sentence):
    assert refusal(sn.lte.search, np.ones(samples, np.complex64), RATE) == sentence


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("part", [1.0, 1j])
def test_not_finite(bad, part):
    iq = capture()
    iq.view(np.float32)[2 * 12_345 + (part == 1j)] = bad
    assert refusal(sn.lte.search, iq, RATE, **FAST) == "iq: sample 12 345 is not finite"
    cell = sn.lte.Detection(cell_id=137, frame_start_s=3.21e-3)
    assert refusal(sn.lte.time_of_arrival, iq, RATE, cell) == "iq: sample 12 345 is not finite"


def test_time_of_arrival_of_too_little():
    cell = sn.lte.Detection(cell_id=137, frame_start_s=3.21e-3)
    message = refusal(sn.lte.time_of_arrival, np.ones(100, np.complex64), RATE, cell)
    assert message.startswith("iq: 100 samples (0.0521 ms) are too few; ")
    assert refusal(sn.lte.time_of_arrival, np.ones(0, np.complex64), RATE, cell).startswith("iq: 0 samples (0 ms)")


def test_time_of_arrival_of_a_cell_that_is_not_there():
    noise = sn.simulation.add_awgn(np.zeros(38_400, np.complex64), 1.0, seed=5)
    cell = sn.lte.Detection(cell_id=137, frame_start_s=3.21e-3)
    with pytest.raises(sn.lte.CellLostError, match="the reference signals of cell 137 are not in these samples"):
        sn.lte.time_of_arrival(noise, RATE, cell)
    assert issubclass(sn.lte.CellLostError, ValueError)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"sample_rate_hz": 0.0}, "sample_rate_hz"),
        ({"sample_rate_hz": -RATE}, "sample_rate_hz"),
        ({"sample_rate_hz": math.nan}, "sample_rate_hz"),
        ({"sample_rate_hz": math.inf}, "sample_rate_hz"),
        ({"sample_rate_hz": 1e9}, "sample_rate_hz"),
        ({"max_cfo_hz": -1.0}, "max_cfo_hz"),
        ({"max_cfo_hz": 1e6}, "max_cfo_hz"),
        ({"max_cfo_hz": math.nan}, "max_cfo_hz"),
        ({"max_cells": 0}, "max_cells"),
        ({"max_cells": 65}, "max_cells"),
    ],
)
def test_arguments_of_search_out_of_range(arguments, name):
    options = {"sample_rate_hz": RATE} | arguments
    assert refusal(sn.lte.search, capture(), **options).startswith(name)
    if name != "max_cells":
        assert refusal(sn.lte.Searcher, **options).startswith(name)


def test_window_of_a_stream_out_of_range():
    for window_s in (0.0, 5.0, math.nan):
        assert refusal(sn.lte.Searcher, RATE, window_s=window_s).startswith("window_s")


@pytest.mark.parametrize("rate_hz", [0.0, -RATE, math.nan, 1e9])
def test_rate_of_time_of_arrival_out_of_range(rate_hz):
    cell = sn.lte.Detection(cell_id=137, frame_start_s=3.21e-3)
    assert refusal(sn.lte.time_of_arrival, capture(), rate_hz, cell).startswith("sample_rate_hz")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"cell_id": 504}, "cell_id: 504 is outside 0 ... 503"),
        ({"cell_id": -1}, "cell_id: -1 is outside 0 ... 503"),
        ({"frame_start_s": 0.01}, "frame_start_s: 0.01 is outside 0 ... 0.01"),
        ({"frame_start_s": math.nan}, "frame_start_s: nan is outside 0 ... 0.01"),
        ({"cfo_hz": math.inf}, "cfo_hz: a finite number is needed"),
        ({"clock_error_ppm": math.nan}, "clock_error_ppm: a finite number is needed"),
        ({"n_rb": 7}, "n_rb: 7 is none of 6, 15, 25, 50, 75, 100"),
        ({"n_ports": 3}, "n_ports: 3 is none of 1, 2, 4"),
        ({"sfn": 1024}, "sfn: 1024 is outside 0 ... 1023"),
    ],
)
def test_a_detection_made_by_hand(arguments, sentence):
    options = {"cell_id": 1, "frame_start_s": 0.0} | arguments
    assert refusal(sn.lte.Detection, **options) == sentence


def test_sequences_out_of_range():
    lte = sn.lte
    assert refusal(lte.pss, 3) == "n_id_2: 3 is outside 0 ... 2"
    assert refusal(lte.sss, 504, 0) == "cell_id: 504 is outside 0 ... 503"
    assert refusal(lte.sss, 0, 1) == "subframe: 1 is none of 0, 5"
    crs = {"port": 0, "n_rb": 6}
    assert refusal(lte.crs, 0, 20, 0, **crs) == "slot: 20 is outside 0 ... 19"
    assert refusal(lte.crs, 0, 0, 7, **crs) == "symbol: 7 is outside 0 ... 6"
    assert refusal(lte.crs, 0, 0, 1, **crs) == "symbol: symbol 1 carries no reference signals of port 0"
    assert refusal(lte.crs, 0, 0, 0, port=4, n_rb=6) == "port: 4 is outside 0 ... 3"
    assert refusal(lte.crs, 0, 0, 0, port=0, n_rb=111) == "n_rb: 111 is outside 6 ... 110"


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"cells": {"cell_id": 504}}, "cell_id"),
        ({"cells": {"n_rb": 7}}, "n_rb"),
        ({"cells": {"n_ports": 3}}, "n_ports"),
        ({"cells": {"delay_s": math.nan}}, "delay_s"),
        ({"sample_rate_hz": 1.0}, "sample_rate_hz"),
        ({"noise_variance": -1.0}, "noise_variance"),
        ({"n_samples": -1}, "n_samples: -1 is below zero"),
        ({"snr_db": 3.0, "noise_variance": 1.0}, "noise_variance: snr_db is given too"),
    ],
)
def test_arguments_of_synthesis_out_of_range(arguments, name):
    options = {"sample_rate_hz": RATE, "n_samples": 10} | arguments
    cell = {"cell_id": 1} | options.pop("cells", {})
    with pytest.raises(ValueError, match=f"{name}"):
        sn.lte.synthesize(sn.lte.CellParameters(**cell), **options)


SILENT = {
    "all zero": lambda n: np.zeros(n, np.complex64),
    "a constant": lambda n: np.full(n, 0.5 - 0.25j, np.complex64),
    "one sample of many": lambda n: np.eye(1, n, n // 2, dtype=np.complex64)[0],
    "clipped noise": lambda n: (
        np.clip(np.random.default_rng(1).normal(size=2 * n) * 9, -1, 1).astype(np.float32).view(np.complex64)
    ),
    "full scale": lambda n: np.sign(np.random.default_rng(2).normal(size=2 * n)).astype(np.float32).view(np.complex64),
    "a tone": lambda n: np.exp(2j * np.pi * 0.1 * np.arange(n)).astype(np.complex64),
    "smallest floats": lambda n: np.full(n, 1e-45 + 1e-45j, np.complex64),
    "largest floats": lambda n: (
        (np.random.default_rng(3).normal(size=2 * n) * 1e37).astype(np.float32).view(np.complex64)
    ),
}


@pytest.mark.parametrize("case", SILENT)
def test_no_cell_is_no_error(case):
    assert sn.lte.search(SILENT[case](38_400), RATE, **FAST) == []


@pytest.mark.parametrize("level", [1e-5, 0.2, 1e5])
def test_level_does_not_matter(level):
    iq = (capture() * np.float32(level)).astype(np.complex64)
    assert [c.cell_id for c in sn.lte.search(iq, RATE, **FAST)] == [137]


def test_clipped_samples_are_still_found():
    iq = capture(0.04)
    parts = iq.view(np.float32)
    np.clip(parts, -0.3 * parts.std(), 0.3 * parts.std(), out=parts)
    assert [c.cell_id for c in sn.lte.search(iq, RATE, **FAST)] == [137]


def test_a_constant_beside_a_cell():
    iq = capture(0.04)
    iq += np.complex64(3.0 * np.abs(iq).std())
    assert [c.cell_id for c in sn.lte.search(iq, RATE, **FAST)] == [137]


@pytest.mark.parametrize("wrong_rate_hz", [1.6e6, 2.0e6, 3.84e6, 5e6])
def test_a_wrong_rate_locks_to_nothing(wrong_rate_hz):
    assert sn.lte.search(capture(0.08), wrong_rate_hz, max_cfo_hz=20e3) == []


@pytest.mark.fuzz
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    samples=st.integers(9_984, 24_000),
    burst=st.floats(0.0, 1.0),
    offset=st.complex_numbers(max_magnitude=10, allow_nan=False),
    bits=st.sampled_from([0, 1, 3, 8]),
)
def test_noise_of_any_shape_holds_no_cell(seed, samples, burst, offset, bits):
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(samples, 2)) @ [1, 1j]
    noise[: int(burst * samples)] *= 30.0
    noise += offset
    if bits:
        step = 2.0 ** (3 - bits)
        noise = step * (np.round(noise.real / step) + 1j * np.round(noise.imag / step))
    assert sn.lte.search(noise.astype(np.complex64), RATE, max_cfo_hz=1e3) == []


def test_stream_counts_what_is_not_finite_as_zero():
    iq = capture(0.1)
    iq[1000:1010] = math.nan
    searcher = sn.lte.Searcher(RATE, window_s=0.08, **FAST)
    found = [cell for block in np.split(iq, 20) for cell in searcher.push(np.ascontiguousarray(block))]
    assert [c.cell_id for c in found] == [137]
