"""Iridium bursts, their detection, the scan of a recording."""

from __future__ import annotations

import json
import math
import threading
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp.cli.app import cli

ir = sn.iridium
Iq = npt.NDArray[np.complex64]


def noise(n: int, seed: int, power: float = 1.0) -> Iq:
    parts = np.random.default_rng(seed).standard_normal((2, n)) * np.sqrt(power / 2.0)
    return np.asarray(parts[0] + 1j * parts[1], dtype=np.complex64)


def amplitude(snr_db: float, rate_hz: float) -> float:
    """Of a signal with this SNR in 25 kHz, beside noise of power 1 a sample."""
    return float(np.sqrt(10.0 ** (snr_db / 10.0) * 25e3 / rate_hz))


def test_channels() -> None:
    assert ir.channel_frequency_hz(247) == pytest.approx(1626.270833e6, abs=1.0)
    assert ir.channel_frequency_hz(247) == ir.RING_ALERT_HZ
    assert ir.channel_use(247) is ir.ChannelUse.RING_ALERT
    near = ir.channel_candidates(1626.3e6)
    assert [c.channel for c in near] == [248, 247]
    assert near[1].doppler_hz == pytest.approx(29_167, abs=1.0)
    assert ir.channel_candidates(1.5e9) == []
    with pytest.raises(ValueError, match=r"channel = 253 must be in 1 \.\.\. 252"):
        ir.channel_frequency_hz(253)


def test_pulse_is_the_textbooks_root_raised_cosine() -> None:
    # By its spectrum: the root of a raised cosine, transformed numerically, but for the ends that are faded out.
    t = np.linspace(-9.5, 9.5, 77)
    f = np.linspace(0.0, 0.7, 70_001)
    spectrum = np.sqrt(np.where(f < 0.3, 1.0, 0.5 * (1.0 + np.cos(np.pi * (f - 0.3) / 0.4))))
    exact = np.trapezoid(2.0 * spectrum * np.cos(2.0 * np.pi * f * t[:, None]), f, axis=1)
    np.testing.assert_allclose(ir.pulse(t), exact, atol=1e-6)


def test_burst_spectrum_is_the_pulses() -> None:
    burst = ir.make_burst(ir.BurstKind.LONG, seed=3, duration_s=2.0)
    iq = burst.evaluate(0.0, 1e-5, 200_000)
    f, density = scipy.signal.welch(iq, 100e3, nperseg=1000, return_onesided=False)
    inside, outside = np.abs(f) < 7e3, np.abs(f) > 18.5e3
    assert 10 * np.log10(density[inside].mean() * 25e3) == pytest.approx(0.0, abs=0.3)
    assert 10 * np.log10(density[outside].max() * 25e3) < -47.0


def test_bursts_from_python() -> None:
    burst = ir.make_burst(ir.BurstKind.DUPLEX, seed=1)
    assert len(burst) == 207
    assert burst.duration_s == pytest.approx(8.28e-3)
    assert burst.payload_start == 28
    assert repr(burst) == "<Burst: 207 symbols, 8.2800 ms>"
    np.testing.assert_allclose(burst.symbols, np.exp(1j * (np.pi / 4 + np.pi / 2 * burst.quadrants)), atol=1e-6)
    again = ir.Burst(burst.symbols)
    t = np.linspace(-1e-3, 9e-3, 501)
    np.testing.assert_array_equal(again.at(t), burst.at(t))
    assert again.quadrants.size == 0
    assert burst.at(t.reshape(3, 167)).shape == (3, 167)
    np.testing.assert_allclose(
        burst.evaluate(1e-3, 1e-6, 50, 1e-9),
        burst.at(1e-3 + 1e-6 * np.arange(50) + 1e-9 * np.arange(50) ** 2),
        atol=1e-6,
    )
    iq = burst.render(5000, 250e3, delay_s=2e-3, doppler_hz=30e3, phase_rad=0.4)
    symbols = ir.matched_filter(iq, 250e3, 207, start_s=2e-3, frequency_hz=30e3)
    np.testing.assert_allclose(symbols * np.exp(-0.4j), burst.symbols, atol=0.02)
    other = ir.make_burst(ir.BurstKind.DUPLEX, seed=1, stream=1)
    assert not np.array_equal(other.quadrants, burst.quadrants)
    with pytest.raises(ValueError, match=r"duration_s = 0\.02 must be 0 or within"):
        ir.make_burst(ir.BurstKind.DUPLEX, seed=1, duration_s=0.02)
    with pytest.raises(ValueError, match="symbols"):
        ir.Burst(np.zeros(3))  # type: ignore[arg-type]


def scene() -> tuple[Iq, list[tuple[float, float, float]]]:
    """0.4 s at 1 Msps; start, frequency and SNR of its bursts; a tone besides."""
    rate_hz = 1e6
    iq = noise(400_000, 1)
    truth = [(0.08, -200e3, 12.0), (0.0805, -158.3e3, 9.0), (0.2, 111e3, 15.0), (0.31, 300e3, 10.0)]
    for i, (start_s, frequency_hz, snr_db) in enumerate(truth):
        kind = ir.BurstKind.RING_ALERT if i == 2 else ir.BurstKind.DUPLEX
        iq += ir.make_burst(kind, seed=i).render(
            iq.size, rate_hz, delay_s=start_s, doppler_hz=frequency_hz, amplitude=amplitude(snr_db, rate_hz)
        )
    tone = np.exp(2j * np.pi * 0.4 * np.arange(30_000)) * amplitude(15.0, rate_hz)
    iq[100_000:130_000] += tone.astype(np.complex64)
    return iq, truth


def test_detection() -> None:
    iq, truth = scene()
    found = ir.detect_bursts(iq, 1e6, center_frequency_hz=1.62e9)
    assert len(found) == len(truth)
    for burst, (start_s, frequency_hz, snr_db) in zip(found, truth, strict=True):
        assert burst.start_s == pytest.approx(start_s, abs=0.15e-3)
        assert burst.frequency_hz - 1.62e9 == pytest.approx(frequency_hz, abs=20.0)
        assert burst.snr_db == pytest.approx(snr_db, abs=1.5)
        assert not burst.cut_start
        assert not burst.cut_end
    everything = ir.detect_bursts(iq, 1e6, all_signals=True)
    assert sorted(s.kind.name for s in everything) == ["BURST"] * 4 + ["TONE"]
    tone = next(s for s in everything if s.kind is ir.SignalClass.TONE)
    assert tone.frequency_hz == pytest.approx(400e3, abs=5.0)
    assert "tone at 100.0" in repr(tone)


def test_detector_on_a_stream() -> None:
    iq, truth = scene()
    detector = ir.BurstDetector(1e6)
    found = [signal for piece in np.array_split(iq, 11) for signal in detector.push(np.ascontiguousarray(piece))]
    assert detector.samples == iq.size
    assert detector.threshold > 1.0
    found += detector.flush()
    assert detector.samples == 0
    assert detector.dropped == 0
    assert sum(s.kind is ir.SignalClass.BURST for s in found) == len(truth)
    assert detector.push(np.full(10, np.nan, np.complex64)) == []
    assert detector.rejected_samples == 10


def test_detectors_run_beside_each_other() -> None:
    iq, truth = scene()
    counts: list[int] = []
    threads = [threading.Thread(target=lambda: counts.append(len(ir.detect_bursts(iq, 1e6)))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counts == [len(truth)] * 3


def test_bad_input() -> None:
    for iq in (np.zeros(0, np.complex64), np.zeros(100_000, np.complex64), np.full(100_000, np.nan, np.complex64)):
        assert ir.detect_bursts(iq, 1e6, all_signals=True) == []
    with pytest.raises(ValueError, match="iq: expected complex64"):
        ir.detect_bursts(np.zeros(1000), 1e6)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="iq"):
        ir.detect_bursts(np.zeros((1, 1000), np.complex64), 1e6)
    with pytest.raises(ValueError, match=r"sample_rate_hz = 1000 must be in 50e3 \.\.\. 100e6"):
        ir.detect_bursts(np.zeros(1000, np.complex64), 1e3)
    with pytest.raises(ValueError, match="false_alarms_per_s = 0 must be"):
        ir.detect_bursts(np.zeros(1000, np.complex64), 1e6, false_alarms_per_s=0.0)


@pytest.mark.fuzz
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 30_000),
    rate_hz=st.floats(50e3, 3e6),
    scale=st.floats(1e-25, 1e25),
    bad=st.lists(st.tuples(st.integers(0, 29_999), st.sampled_from([np.nan, np.inf, -np.inf, 3e38])), max_size=5),
)
def test_any_samples_are_taken(seed: int, n: int, rate_hz: float, scale: float, bad: list[tuple[int, float]]) -> None:
    iq = (noise(n, seed) * np.float32(scale)).astype(np.complex64)
    for place, value in bad:
        if place < n:
            iq[place] = value
    for signal in ir.detect_bursts(iq, rate_hz, false_alarms_per_s=100.0, all_signals=True):
        numbers = (signal.start_s, signal.duration_s, signal.frequency_hz, signal.frequency_sigma_hz)
        assert all(math.isfinite(v) for v in (*numbers, signal.bandwidth_hz, signal.snr_db))
        assert 0.0 <= signal.start_s <= signal.start_s + signal.duration_s <= n / rate_hz + 1e-9
        assert abs(signal.frequency_hz) < 0.5 * rate_hz + 25e3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    iq, _ = scene()
    path = tmp_path_factory.mktemp("scan") / "sky.sigmf-meta"
    sn.io.write_iq(path, np.asarray(iq / 50.0, dtype=np.complex64), 1e6, center_frequency_hz=1626.1e6)
    return path


def test_scan_prints_a_table_and_draws(recording: Path, tmp_path: Path) -> None:
    plot = tmp_path / "sky.png"
    result = CliRunner().invoke(cli, ["scan", str(recording), "--signal", "iridium", "--plot", str(plot)])
    assert result.exit_code == 0, result.output
    assert "4 bursts, 1 other signal" in result.output
    assert "tone" in result.output
    assert "1626.2110" in result.output  # of the ring alert's length, and the channels that it may be on
    assert "246 −18.2, 245 +23.5" in result.output
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_scan_as_json(recording: Path) -> None:
    result = CliRunner().invoke(cli, ["scan", str(recording), "--signal", "iridium", "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.output)
    assert report["center_frequency_hz"] == 1626.1e6
    assert [s["kind"] for s in report["signals"]].count("burst") == 4
    first = report["signals"][0]
    assert first["start_s"] == pytest.approx(0.08, abs=0.15e-3)
    assert {"channel", "frequency_hz", "doppler_hz"} == set(first["channels"][0])


def test_scan_of_nothing_and_of_what_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "quiet.sigmf-meta"
    sn.io.write_iq(path, noise(100_000, 2, 1e-3), 1e6)
    result = CliRunner().invoke(cli, ["scan", str(path), "--signal", "iridium", "--plot", str(tmp_path / "q.png")])
    assert result.exit_code == 0, result.output
    assert "no bursts" in result.output
    slow = tmp_path / "slow.sigmf-meta"
    sn.io.write_iq(slow, noise(1000, 2), 1e3)
    result = CliRunner().invoke(cli, ["scan", str(slow), "--signal", "iridium"])
    assert result.exit_code != 0
    assert "sample_rate_hz = 1000 must be in 50e3 ... 100e6" in result.output
