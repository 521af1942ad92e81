"""KiwiSDR recordings and the time differences of arrival of what they hold."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "captures" / "hf_tdoa" / "2020"
TRANSMITTER = (50.0152, 9.0112)
RECEIVERS = {"HB9ODP": (46.499351, 8.798828), "JO51xl": (51.466044, 11.977189), "pa0rdt": (51.5005, 3.60069)}
GROUND_WAVE_MPS = 299_792_458.0 / 1.000338


def geodesic_m(start: tuple[float, float], end: tuple[float, float]) -> float:
    """Length on the ellipsoid: the normal section's chord, each small step of it projected to the surface."""
    places = [sn.geometry.geodetic_to_ecef(np.radians(p[0]), np.radians(p[1]), 0.0) for p in (start, end)]
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    chord = places[0] * (1.0 - share) + places[1] * share
    latitude, longitude, _ = sn.geometry.ecef_to_geodetic(chord)
    surface = sn.geometry.geodetic_to_ecef(latitude, longitude, np.zeros(len(share)))
    return float(np.linalg.norm(np.diff(surface, axis=0), axis=1).sum())


def test_geodesic_of_the_test() -> None:
    # A degree along the equator and one along the meridian from it (WGS 84).
    assert geodesic_m((0.0, 0.0), (0.0, 1.0)) == pytest.approx(111_319.49, abs=0.02)
    assert geodesic_m((0.0, 0.0), (1.0, 0.0)) == pytest.approx(110_574.39, abs=0.02)


@pytest.mark.offair
@pytest.mark.crosscheck
@pytest.mark.skipif(not FOLDER.exists(), reason="the captures in ../shared are not there")
def test_time_transmitter_from_three_receivers() -> None:
    recordings = {name: sn.io.read_kiwi(next(FOLDER.glob(f"*_{name}_iq.wav"))) for name in RECEIVERS}
    for name, recording in recordings.items():
        assert recording.sample_rate_hz == pytest.approx(12_001.06, abs=0.05)
        assert recording.residual_s < 0.1e-6
        # A zero tag each, and one that is three hours old.
        assert recording.refused_tags == (2 if name == "HB9ODP" else 1)
        assert 29.0 < recording.duration_s < 31.0
    results = {}
    names = list(RECEIVERS)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        result = sn.hf.envelope_tdoa(recordings[names[a]], recordings[names[b]])
        truth_s = (
            geodesic_m(TRANSMITTER, RECEIVERS[names[a]]) - geodesic_m(TRANSMITTER, RECEIVERS[names[b]])
        ) / GROUND_WAVE_MPS
        assert abs(result.tdoa_s - truth_s) < 12e-6
        assert 0.1e-6 < result.sigma_s < 2e-6
        assert result.coherence > 0.95
        results[a, b] = result.tdoa_s
    assert abs(results[0, 1] + results[1, 2] - results[0, 2]) < 3e-6


def carrier(
    distance_m: float, start_s: float, rate_hz: float, seconds: float, seed: int, noise: float = 0.003
) -> npt.NDArray[np.complex64]:
    """A carrier with second marks and random phase modulation, as a receiver this far away hears it."""
    chips = np.random.default_rng(1).choice([-1.0, 1.0], 12_000)
    sent = start_s + np.arange(int(seconds * rate_hz)) / rate_hz - distance_m / GROUND_WAVE_MPS - 370_000.0
    marks = np.interp(sent % 1.0, [0.0, 0.003, 0.1, 0.103, 1.0], [1.0, 0.15, 0.15, 1.0, 1.0])
    phase = 0.2 * np.interp((sent + 1.0) * 645.0, np.arange(chips.size), chips) + seed
    white = np.random.default_rng(100 + seed).standard_normal((2, sent.size))
    return np.asarray(0.3 * marks * np.exp(1j * phase) + noise * (white[0] + 1j * white[1]), dtype=np.complex64)


def written(path: Path, distance_m: float, start_s: float, rate_hz: float, seed: int, **others: float) -> Path:
    iq = carrier(distance_m, start_s, rate_hz, others.get("seconds", 8.0), seed)
    rng = np.random.default_rng(seed)
    errors = 6e-8 * rng.standard_normal(iq.size // 512)
    sn.io.write_kiwi(path, iq, sample_rate_hz=rate_hz, start_s=start_s, tag_errors_s=errors)
    return path


def test_tags_give_rate_and_start(tmp_path: Path) -> None:
    rate_hz, start_s, blocks = 12_001.07, 604_795.25, 300  # across the end of a week
    iq = np.asarray(0.5 * np.exp(1j * np.arange(512 * blocks + 100)), dtype=np.complex64)
    errors = 6e-8 * np.random.default_rng(1).standard_normal(blocks)
    errors[[5, 17, 200]] = [-3.0, 11_616.0, 3e-5]  # stale, from another hour, a little off
    sn.io.write_kiwi(tmp_path / "r.wav", iq, sample_rate_hz=rate_hz, start_s=start_s, tag_errors_s=errors)
    recording = sn.io.read_kiwi(tmp_path / "r.wav")
    assert recording.iq.dtype == np.complex64
    assert recording.iq.size == 512 * blocks
    np.testing.assert_allclose(recording.iq, iq[: 512 * blocks], atol=1.01 / 32768.0)
    assert recording.tags == blocks
    assert recording.refused_tags == 4
    # 296 tags of 60 ns: the line's start is right to 7 ns, its rate to 4e-10.
    assert recording.start_s == pytest.approx(start_s, abs=60e-9)
    assert recording.sample_rate_hz == pytest.approx(rate_hz, rel=4e-9)
    assert 40e-9 < recording.residual_s < 80e-9
    assert "4 of 300 tags refused" in repr(recording)


def test_tdoa_of_simulated_recordings(tmp_path: Path) -> None:
    near = sn.io.read_kiwi(written(tmp_path / "a.wav", 250e3, 370_000.0, 12_001.05, 1))
    far = sn.io.read_kiwi(written(tmp_path / "b.wav", 400e3, 370_000.4, 12_000.4, 2))
    truth_s = -150e3 / GROUND_WAVE_MPS
    result = sn.hf.envelope_tdoa(near, far)
    assert abs(result.tdoa_s - truth_s) < 5.0 * result.sigma_s
    assert result.sigma_s < 1e-6
    assert result.overlap_s == pytest.approx(7.4, abs=0.2)
    swapped = sn.hf.envelope_tdoa(far, near)
    assert swapped.tdoa_s == pytest.approx(-result.tdoa_s, abs=0.05e-6)
    # Whatever the band, as long as it holds the modulation.
    for bandwidth_hz in (200.0, 800.0):
        other = sn.hf.envelope_tdoa(near, far, bandwidth_hz=bandwidth_hz)
        assert abs(other.tdoa_s - truth_s) < 5.0 * other.sigma_s
    assert "µs over" in repr(result)


def test_envelope_lies_on_the_grid_of_gps_time(tmp_path: Path) -> None:
    # A slow amplitude modulation: its phase says when the samples were taken.
    rate_hz, start_s = 12_001.3, 100.123456
    t = start_s + np.arange(60_000) / rate_hz
    iq = np.asarray(0.4 * (1.0 + 0.5 * np.cos(2 * np.pi * 50.0 * t)) * np.exp(1j * (2.0 + 3.0 * t)), dtype=np.complex64)
    sn.io.write_kiwi(tmp_path / "r.wav", iq, sample_rate_hz=rate_hz, start_s=start_s)
    recording = sn.io.read_kiwi(tmp_path / "r.wav")
    for first_s in (100.5, 100.71234567):
        envelope = sn.hf.carrier_envelope(recording, first_s, 4.0, rate_hz=2000.0)
        assert envelope.shape == (8000,)
        wanted = 0.5 * np.cos(2 * np.pi * 50.0 * (first_s + np.arange(8000) / 2000.0))
        middle = slice(500, -500)
        np.testing.assert_allclose(envelope[middle], wanted[middle], atol=3e-3)
        spin = np.vdot(np.exp(2j * np.pi * 50.0 * np.arange(8000) / 2000.0), envelope)
        late_s = (np.angle(np.exp(2j * np.pi * 50.0 * first_s)) - np.angle(spin)) / (2 * np.pi * 50.0)
        assert abs((late_s + 0.01) % 0.02 - 0.01) < 0.3e-6


def test_refusals_of_the_tdoa(tmp_path: Path) -> None:
    a = sn.io.read_kiwi(written(tmp_path / "a.wav", 250e3, 370_000.0, 12_001.05, 1, seconds=4.0))
    later = sn.io.read_kiwi(written(tmp_path / "b.wav", 250e3, 370_003.0, 12_001.05, 2, seconds=4.0))
    with pytest.raises(ValueError, match=r"a\.wav and b\.wav have 0\.\d+ s in common; 2 s are needed"):
        sn.hf.envelope_tdoa(a, later)
    with pytest.raises(ValueError, match="identical"):
        sn.hf.envelope_tdoa(a, a)
    with pytest.raises(ValueError, match=r"start_s = 1\.0.*covers 370000\.0"):
        sn.hf.carrier_envelope(a, 1.0, 1.0)
    with pytest.raises(ValueError, match="bandwidth_hz = 900 must be in 1 … 800"):
        sn.hf.carrier_envelope(a, 370_001.0, 1.0, bandwidth_hz=900.0)
    white = np.random.default_rng(1).standard_normal((2, 48_000)) / 8.0
    sn.io.write_kiwi(
        tmp_path / "n.wav", (white[0] + 1j * white[1]).astype(np.complex64), sample_rate_hz=12e3, start_s=1.0
    )
    noise = sn.io.read_kiwi(tmp_path / "n.wav")
    with pytest.raises(ValueError, match="no steady carrier"):
        sn.hf.carrier_envelope(noise, 1.5, 2.0)


def wav(*chunks: tuple[bytes, bytes]) -> bytes:
    body = b"WAVE" + b"".join(
        name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2) for name, data in chunks
    )
    return b"RIFF" + struct.pack("<I", len(body)) + body


FMT = (b"fmt ", struct.pack("<HHIIHH", 1, 2, 12_000, 48_000, 4, 16))
DATA = (b"data", bytes(2048))


def tag(seconds: int, nanoseconds: int = 0) -> tuple[bytes, bytes]:
    return b"kiwi", struct.pack("<BBII", 0, 0, seconds, nanoseconds)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "no RIFF/WAVE header"),
        (b"RIFF1234AVI LIST", "no RIFF/WAVE header"),
        (wav(FMT, DATA)[:-5], r"chunk 'data' at byte 36 has 2048 bytes, 2043 are left; truncated\?"),
        (wav((b"fmt ", b"12")), "chunk 'fmt ' of 2 bytes; at least 16 expected"),
        (wav((b"fmt ", struct.pack("<HHIIHH", 1, 1, 12_000, 24_000, 2, 16)), DATA), "1 channels of 16 bits"),
        (wav((b"fmt ", struct.pack("<HHIIHH", 3, 2, 12_000, 0, 8, 32)), DATA), "format 3"),
        (wav((b"fmt ", struct.pack("<HHIIHH", 1, 2, 0, 0, 4, 16)), DATA), "sampling rate of 0"),
        (wav(DATA), "chunk 'data' before 'fmt '"),
        (wav(FMT), "no samples"),
        (wav(FMT, (b"data", b"123")), "3 bytes of samples at byte 44; a multiple of 4 expected"),
        (wav(FMT, (b"kiwi", b"123"), DATA), "chunk 'kiwi' at byte 36 has 3 bytes; 10 expected"),
        (wav(FMT, DATA, DATA), "0 usable GNSS time tags of 0; at least 3 are needed"),
        (wav(FMT, tag(0), DATA, tag(5), DATA, tag(700_000), DATA, tag(5, 2_000_000_000), DATA), "1 usable .* of 4"),
        (wav(FMT, *(c for s in (1, 50, 300, 1000, 5000) for c in (tag(s), DATA))), "no line fits .* of 5 agree"),
        (wav(FMT, *(c for _ in range(5) for c in (tag(7), DATA))), "no line fits"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "bad.wav"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=says) as refusal:
        sn.io.read_kiwi(path)
    assert str(path) in str(refusal.value)


def test_damaged_files_never_break_the_reader(tmp_path: Path) -> None:
    path = tmp_path / "damaged.wav"
    good = bytearray((written(path, 250e3, 370_000.0, 12_001.0, 1, seconds=1.0)).read_bytes())
    rng = np.random.default_rng(3)
    for _ in range(60):
        damaged = bytearray(good[: int(rng.integers(1, len(good)))] if rng.random() < 0.5 else good)
        for place in rng.integers(0, min(len(damaged), 9000), 4):
            damaged[place] = int(rng.integers(256))
        path.write_bytes(damaged)
        try:
            recording = sn.io.read_kiwi(path)
        except ValueError as error:
            assert str(path) in str(error)
        else:
            assert math.isfinite(recording.sample_rate_hz)
            assert math.isfinite(recording.start_s)


def test_writer_refuses() -> None:
    with pytest.raises(ValueError, match="iq: expected complex64"):
        sn.io.write_kiwi("x.wav", np.zeros(600), sample_rate_hz=12e3, start_s=0.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="sample_rate_hz = 0"):
        sn.io.write_kiwi("x.wav", np.zeros(600, np.complex64), sample_rate_hz=0.0, start_s=0.0)
    with pytest.raises(ValueError, match="tag_errors_s"):
        sn.io.write_kiwi("x.wav", np.zeros(600, np.complex64), sample_rate_hz=12e3, start_s=0.0, tag_errors_s=math.nan)
