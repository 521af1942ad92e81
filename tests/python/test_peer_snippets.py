"""Snippets in few bits, what a link can pay for, and samples from recordings and streams."""

from __future__ import annotations

import io as bytes_io
import json
import math
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soopnav_cpp import dsp, io, iridium
from soopnav_cpp.peer import snippets
from soopnav_cpp.peer.scan import Scanner, cut_snippet, decimation
from soopnav_cpp.peer.snippets import TokenBucket, bits_for, choose_bits, dequantise, effective_snr_db, quantise
from soopnav_cpp.peer.sources import FAR_FUTURE_S, LiveSource, Recording, instant, iso, open_source


def noise(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)).astype(np.complex64)


@pytest.mark.crosscheck
@pytest.mark.parametrize("bits", [1, 2, 3, 4])
def test_the_quantiser_is_the_best_uniform_one(bits: int) -> None:
    iq = noise(200_000)
    scale, data = quantise(iq, bits)
    assert len(data) == math.ceil(2 * bits * iq.size / 8)
    error = (dequantise(data, iq.size, bits, scale) - iq).view(np.float32)
    assert np.mean(error**2) == pytest.approx(snippets.DISTORTIONS[bits], rel=0.02)
    # The table is that of the best step: quadrature over the Gaussian, another step does worse.
    x = np.linspace(-8.0, 8.0, 400_001)
    density = np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi) * (x[1] - x[0])

    def distortion(step: float) -> float:
        half = 1 << (bits - 1)
        return float(np.sum(density * (x - (np.clip(np.floor(x / step), -half, half - 1) + 0.5) * step) ** 2))

    best = snippets.STEPS[bits]
    assert distortion(best) == pytest.approx(snippets.DISTORTIONS[bits], rel=2e-3)
    assert distortion(best) < min(distortion(0.97 * best), distortion(1.03 * best))


@pytest.mark.law
@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(1, 4), st.floats(1e-12, 1e12), st.integers(0, 99))
def test_what_is_quantised_twice_stays(count: int, bits: int, size: float, seed: int) -> None:
    iq = (noise(count, seed) * np.float32(size)).astype(np.complex64)
    scale, data = quantise(iq, bits)
    out = dequantise(data, count, bits, scale)
    assert out.dtype == np.complex64
    step = snippets.STEPS[bits] * scale
    inside = np.abs(iq.view(np.float32)) < 0.99 * step * 2 ** (bits - 1)
    assert np.all(np.abs(out.view(np.float32) - iq.view(np.float32))[inside] <= 0.5001 * step)
    assert np.array_equal(np.sign(out.view(np.float32)), np.where(iq.view(np.float32) < 0, -1, 1))


@pytest.mark.unit
def test_snippets_that_cannot_be_are_refused() -> None:
    iq = noise(10)
    scale, data = quantise(iq, 0)
    assert np.array_equal(dequantise(data, 10, 0, scale), iq)
    for bad, match in ((iq[:0], "at least one sample"), (iq.reshape(2, 5), "one dimension")):
        with pytest.raises(ValueError, match=match):
            quantise(bad, 2)
    with pytest.raises(ValueError, match="not finite"):
        quantise(np.array([1, math.nan], np.complex64), 2)
    with pytest.raises(ValueError, match="bits = 5"):
        quantise(iq, 5)
    with pytest.raises(ValueError, match="samples of the snippet"):
        quantise(iq, 2, burst=slice(20, 30))
    for count, bits, size in ((10, 2, 4), (9, 0, 80), (0, 2, 0)):
        with pytest.raises(ValueError, match="expected"):
            dequantise(bytes(size), count, bits, 1.0)
    with pytest.raises(ValueError, match="scale"):
        dequantise(bytes(5), 10, 2, math.nan)
    scale, data = quantise(np.zeros(8, np.complex64), 3)
    assert scale == 0.0
    assert not dequantise(data, 8, 3, scale).any()


def received(number: int, snr_db: float, delay_s: float = 0.0, duration_s: float = 0.09) -> tuple[np.ndarray, slice]:
    """A burst as a snippet has it, and where it is in it."""
    count = 250 * math.ceil((duration_s + 3e-3) * 200)
    wave = iridium.make_burst(iridium.BurstKind.LONG, 3, stream=number, duration_s=duration_s)
    clean = math.sqrt(0.5) * 10.0 ** (0.05 * snr_db) * wave.render(count, 50e3, delay_s=1.5e-3 + delay_s)
    heard = clean + noise(count, 1000 + 2 * number + (delay_s != 0.0)) / math.sqrt(2.0)
    return heard.astype(np.complex64), slice(75, 75 + round(50e3 * duration_s))


@pytest.mark.consistency
@pytest.mark.parametrize(("snr_db", "bits"), [(10.0, 2), (15.0, 3), (20.0, 4)])
def test_few_bits_lose_less_than_a_decibel_and_the_covariance_knows(snr_db: float, bits: int) -> None:
    """What quantisation adds to the delay's error, against that error: paired, so that 40 bursts tell 0.1 dB."""
    added, full, normal = [], [], []
    for number in range(40):
        delay = float(np.random.default_rng(number).uniform(-2e-5, 2e-5))
        a, _ = received(number, snr_db, delay)
        b, burst = received(number, snr_db)
        found = []
        for count in (0, bits):
            scale, data = quantise(b, count, burst=burst, band=0.7)
            few = dequantise(data, b.size, count, scale)
            peak = dsp.cross_ambiguity(a, few, 50e3, max_delay_s=1e-3, max_doppler_hz=1e3, symbol_rate_hz=25e3)
            assert peak.detected
            found.append(peak.tdoa_s - delay)
        full.append(peak.sigma_tdoa_s)
        added.append(found[1] - found[0])
        normal.append(found[1] / peak.sigma_tdoa_s)
    loss = 10.0 * np.log10(1.0 + np.mean(np.square(added)) / np.mean(np.square(full)))
    assert loss < 0.6  # 0.47, 0.25, 0.36; 2 bits lose 0.72 with the levels that are nearest
    assert 0.67 < np.sqrt(np.mean(np.square(normal))) < 1.5


def in_band(few: np.ndarray, iq: np.ndarray, burst: slice) -> tuple[float, float]:
    """Density of what differs from a multiple of `iq`, in +-15 kHz and beyond +-19 kHz, over that of `iq`."""
    exact, other = (np.fft.fft(x[burst].astype(np.complex128)) for x in (iq, few))
    f = np.abs(np.fft.fftfreq(exact.size, 1.0 / 50e3))
    inside = f < 15e3
    gain = np.vdot(exact[inside], other[inside]) / np.vdot(exact[inside], exact[inside])
    power = np.abs(other / gain - exact) ** 2 / np.mean(np.abs(exact) ** 2)
    return float(np.mean(power[inside])), float(np.mean(power[f > 19e3]))


@pytest.mark.consistency
@pytest.mark.parametrize("bits", [1, 2, 3, 4])
def test_the_noise_of_quantisation_leaves_the_band_as_stated(bits: int) -> None:
    for snr_db in (-5.0, 0.0, 10.0, 20.0):
        iq, burst = received(1, snr_db)
        shaped, plain = (
            in_band(dequantise(data, iq.size, bits, scale), iq, burst)
            for scale, data in (quantise(iq, bits, burst=burst, band=band) for band in (0.7, 0.0))
        )
        assert shaped[0] < (0.95 if bits == 1 else 0.85) * plain[0]
        assert shaped[1] > plain[1]
        stated = 10.0 ** (-0.1 * effective_snr_db(snr_db, bits)) - 10.0 ** (-0.1 * snr_db)
        assert 1 / 1.5 < stated / (shaped[0] * (0.5 + 10.0 ** (-0.1 * snr_db))) < 1.5


@pytest.mark.law
def test_noise_that_is_moved_delays_nothing() -> None:
    """The same burst turned round in time is as late: within what the noise of quantisation explains."""
    iq, burst = received(2, 10.0)
    turned = np.ascontiguousarray(iq[::-1].conj())
    back = slice(iq.size - burst.stop, iq.size - burst.start)
    late = []
    for samples, inside in ((iq, burst), (turned, back)):
        scale, data = quantise(samples, 2, burst=inside, band=0.7)
        few = dequantise(data, iq.size, 2, scale)
        spectra = np.fft.fft(few[inside]) * np.fft.fft(samples[inside]).conj()
        f = np.fft.fftfreq(spectra.size, 1.0 / 50e3)
        use = np.abs(f) < 15e3
        late.append(float(np.sum(f[use] * np.angle(spectra[use]) * np.abs(spectra[use]))
                          / np.sum(f[use] ** 2 * np.abs(spectra[use])) / (2.0 * math.pi)))  # fmt: skip
    assert max(map(abs, late)) < 200e-9
    for few in (iq[:1], iq[:5]):
        scale, data = quantise(few, 2, band=0.7)
        assert dequantise(data, few.size, 2, scale).shape == few.shape
    for band in (-0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="band"):
            quantise(iq, 2, band=band)


@pytest.mark.unit
def test_bits_follow_snr_and_bandwidth() -> None:
    assert [bits_for(db) for db in (-5.0, 10.0, 10.1, 15.0, 15.1, 30.0)] == [2, 2, 3, 3, 4, 4]
    assert effective_snr_db(10.0, 0) == 10.0
    with pytest.raises(ValueError, match="bits = 5"):
        effective_snr_db(10.0, 5)
    assert effective_snr_db(10.0, 1) < effective_snr_db(10.0, 2) < effective_snr_db(10.0, 4) < 10.0
    free = TokenBucket(math.inf)
    free.advance(0.0)
    assert choose_bits(20.0, 2000, free) == 4
    tight = TokenBucket(10e3, depth_s=1.0)
    sent = [0.0] * 3
    for t in np.arange(0.0, 60.0, 1.0):
        tight.advance(float(t))
        bits = choose_bits(20.0, 2000, tight)
        if bits is not None:
            tight.pay(snippets.snippet_bytes(2000, bits))
            sent.append(8.0 * snippets.snippet_bytes(2000, bits))
    assert 0.8 * 60 * 10e3 < sum(sent) <= 61 * 10e3
    for rate in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="bandwidth"):
            TokenBucket(rate)
    with pytest.raises(ValueError, match="depth_s"):
        TokenBucket(1.0, depth_s=math.inf)


# ---- sources

START = "2014-08-27T06:00:00.25Z"


def recording(folder: Path, iq: np.ndarray, name: str = "x", **more: object) -> Path:
    keep = {"format": "cf32", "center_frequency_hz": 1626e6, "datetime_utc": START} | more
    return io.write_iq(folder / name, iq, 100e3, **keep)


@pytest.mark.unit
def test_times_keep_all_their_digits() -> None:
    assert instant("2014-08-27T06:00:00.123456789012Z", "x") == (1409119200, 0.123456789012)
    assert instant("2014-08-27T06:00:00", "x") == (1409119200, 0.0)
    assert iso(1409119200, 0.25) == "2014-08-27T06:00:00.250Z"
    assert iso(0, FAR_FUTURE_S) == "open"
    for text in ("yesterday", "2014-08-27T06:00:00+02:00", "2014-08-27T06:00:00.1x", ""):
        with pytest.raises(ValueError, match="UTC time"):
            instant(text, "x")


@pytest.mark.law
def test_a_recording_and_a_stream_are_the_same(tmp_path: Path) -> None:
    iq = noise(123_456)
    iq[777] = complex(math.nan, math.inf)
    clean = iq.copy()
    clean[777] = 0
    path = recording(tmp_path, iq)
    stream = bytes_io.BytesIO(iq.tobytes() + b"abc")
    live = LiveSource(stream, name="-", sample_rate_hz=100e3, center_frequency_hz=1626e6, format="cf32", start=START)
    for source in (Recording(path), live):
        assert (source.reference_unix_s, source.start_s) == (1409119200, 0.25)
        blocks = []
        while (block := source.block()) is not None:
            assert block.start_s == pytest.approx(0.25 + sum(map(len, blocks)) / 100e3, abs=1e-12)
            assert block.continues == bool(blocks)
            blocks.append(block.iq)
        assert np.array_equal(np.concatenate(blocks), clean)
        assert source.not_finite == 1
        start, piece = source.cut(0.25 + 0.5000049, 1000)
        assert start == pytest.approx(0.75, abs=1e-12)
        assert np.array_equal(piece, clean[50_000:51_000])
        assert source.cut(0.2, 1000) is None
        assert source.cut(0.25 + 1.23, 1000) is None
        assert source.block() is None
    live.seek(0.5)
    assert live.block() is None


@pytest.mark.unit
def test_a_stream_forgets_and_a_recording_seeks(tmp_path: Path) -> None:
    iq = noise(300_000)
    live = LiveSource(
        bytes_io.BytesIO(iq.tobytes()), name="-", sample_rate_hz=100e3, center_frequency_hz=1626e6, format="cf32",
        start=START, keep_s=0.5,
    )  # fmt: skip
    while live.block() is not None:
        pass
    assert live.cut(0.25 + 1.0, 100) is None
    assert live.cut(0.25 + 2.6, 100) is not None
    source = Recording(recording(tmp_path, iq))
    source.seek(0.25 + 1.000003)
    block = source.block()
    assert np.array_equal(block.iq[:10], iq[100_001:100_011])
    assert not block.continues
    source.seek(-5.0)
    assert source.block().start_s == 0.25
    source.seek(99.0)
    assert source.block() is None


@pytest.mark.unit
def test_a_gap_in_a_recording_begins_anew(tmp_path: Path) -> None:
    iq = noise(60_000)
    path = recording(tmp_path, iq)
    meta = json.loads(path.read_text())
    meta["captures"].append(
        {"core:sample_start": 40_000, "core:frequency": 1626e6, "core:datetime": "2014-08-27T06:00:05Z"}
    )
    path.write_text(json.dumps(meta))
    source = Recording(path)
    assert source.end_s == pytest.approx(5.2)
    starts = []
    while (block := source.block()) is not None:
        starts.append((round(block.start_s, 6), block.continues, block.iq.size))
    assert starts == [(0.25, False, 25_000), (0.5, True, 15_000), (5.0, False, 20_000)]
    assert source.cut(0.6, 10_000) is None  # across the gap
    assert np.array_equal(source.cut(5.1, 100)[1], iq[50_000:50_100])
    source.seek(2.0)
    assert source.block().start_s == 5.0
    meta["captures"][1]["core:datetime"] = "2014-08-27T06:00:00.5Z"
    path.write_text(json.dumps(meta))
    with pytest.raises(ValueError, match="begins before"):
        Recording(path)


@pytest.mark.unit
def test_sources_that_cannot_be_are_refused(tmp_path: Path) -> None:
    path = recording(tmp_path, noise(100))
    data = path.with_suffix(".sigmf-data")
    good = data.read_bytes()
    for content, match in ((b"", "empty"), (good[:-3], "not a whole number")):
        data.write_bytes(content)
        with pytest.raises(ValueError, match=match):
            Recording(path)
    data.write_bytes(good)
    meta = json.loads(path.read_text())
    for key, match in (("core:datetime", "--start"), ("core:frequency", "--frequency")):
        changed = json.loads(path.read_text())
        del changed["captures"][0][key]
        path.write_text(json.dumps(changed))
        with pytest.raises(ValueError, match=match):
            Recording(path)
        path.write_text(json.dumps(meta))
    with pytest.raises(FileNotFoundError):
        open_source(str(tmp_path / "nothing"))
    with pytest.raises(ValueError, match="--rate"):
        open_source("-")
    with pytest.raises(ValueError, match="block_s"):
        Recording(path, block_s=0.0)
    raw = tmp_path / "x.cf32"
    raw.write_bytes(good)
    source = open_source(str(raw), sample_rate_hz=100e3, start=START, center_frequency_hz=1e9)
    assert source.block().iq.size == 100
    with pytest.raises(ValueError, match="no multiple"):
        decimation(source, 30e3)
    with pytest.raises(ValueError, match="no multiple"):
        decimation(source, 200e3)


@pytest.mark.unit
def test_a_fifo_is_a_live_source(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    iq = noise(30_000)
    writer = threading.Thread(target=lambda: fifo.write_bytes(iq.tobytes()))
    writer.start()
    source = open_source(str(fifo), sample_rate_hz=100e3, format="cf32", start=START, center_frequency_hz=1e9)
    assert source.live
    got = [source.block().iq, source.block().iq]
    assert np.array_equal(np.concatenate(got), iq)
    writer.join()
    assert source.block() is None
    source._stream.close()


@pytest.mark.law
def test_snippets_are_the_same_wherever_they_are_cut(tmp_path: Path) -> None:
    """A tone at the mixing frequency is constant; times are those of the samples."""
    t = np.arange(100_000) / 100e3
    iq = (0.5 * np.exp(2j * np.pi * 20e3 * t)).astype(np.complex64)
    source = Recording(recording(tmp_path, iq))
    start, piece = cut_snippet(source, 0.25 + 0.3, 500, 1626.02e6, 50e3)
    assert start == pytest.approx(0.55, abs=1e-9)
    assert np.allclose(piece, piece[0], atol=1e-3)
    assert np.allclose(np.abs(piece), 0.5, atol=1e-3)
    assert cut_snippet(source, 0.2501, 500, 1626.02e6, 50e3) is None  # the filter needs what is before
    assert cut_snippet(source, 1.249, 500, 1626.02e6, 50e3) is None


@pytest.mark.law
def test_bursts_do_not_depend_on_where_blocks_end(tmp_path: Path) -> None:
    from collections import Counter

    iq = 0.3 * noise(150_000)
    for k in range(8):
        wave = iridium.make_burst(iridium.BurstKind.DUPLEX, 7, stream=k)
        iq[12_000 + 15_000 * k :][:3000] += wave.render(3000, 100e3, delay_s=5e-3, doppler_hz=4e3 * k - 14e3)
    path = recording(tmp_path, iq)
    seen = []
    for block_s in (0.05, 0.25, 10.0):
        scanner = Scanner(Recording(path, block_s=block_s), Counter())
        heard: list[object] = []
        while not scanner.done:
            before = scanner.heard_to_s
            found = scanner.step()
            assert all(before - 1e-9 <= h.start_s < scanner.heard_to_s for h in found)
            heard += found
        seen.append(heard)
    assert len(seen[0]) == 8
    assert seen[0] == seen[1] == seen[2]
