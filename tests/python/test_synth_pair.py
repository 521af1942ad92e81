"""``soopnav synth pair``: two recordings whose bursts lie where the truth file says, by each receiver's clock."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import soopnav_cpp as sn
from soopnav_cpp.cli.app import cli
from soopnav_cpp.orbits import read_ephemeris

EXAMPLE = Path(__file__).parents[2] / "examples" / "pair.toml"
SHORT = EXAMPLE.read_text().replace("duration_s = 12.0", "duration_s = 0.8").replace("snr_db = 20.0 ", "snr_db = 40.0 ")


def run(*arguments: object, code: int = 0) -> Any:
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    (folder / "pair.toml").write_text(SHORT)
    lines = run("synth", "pair", folder / "pair.toml", folder / "out").stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["target", "anchor", "ephemeris", "truth"]
    return folder / "out"


def test_files_say_whose_clock(made: Path) -> None:
    for role in ("target", "anchor"):
        iq, meta = sn.io.read_iq(made / f"{role}.sigmf-meta")
        assert (meta.sample_rate_hz, meta.center_frequency_hz, meta.format) == (1e6, 1626.1e6, "ci8")
        assert len(iq) == 800_000
        stored = json.loads((made / f"{role}.sigmf-meta").read_text())
        assert stored["captures"][0]["core:datetime"] == "2014-08-27T13:55:00.000000Z"
    truth = json.loads((made / "truth.json").read_text())
    known = read_ephemeris(made / "satellites.csv")
    assert {burst["satellite"] for burst in truth["bursts"]} <= set(known.orbits)
    assert truth["target"]["clock_bias_s"] == pytest.approx(4.1e-4, rel=1e-12)
    assert truth["anchor"]["clock_drift"] == pytest.approx(2e-7, rel=1e-9)


def test_bursts_are_where_the_truth_says(made: Path) -> None:
    """Energy in 35 kHz about the stated frequency, in time about the stated middle: high inside, low before."""
    truth = json.loads((made / "truth.json").read_text())
    inside = 0
    for role in ("target", "anchor"):
        iq, _ = sn.io.read_iq(made / f"{role}.sigmf-meta")
        for burst in truth["bursts"]:
            middle, half = burst[f"{role}_reading_s"], 0.5 * burst["duration_s"]
            begin, end = round((middle - half) * 1e6), round((middle + half) * 1e6)
            if begin < 6000 or end > len(iq):
                continue
            turn = np.exp(-2j * np.pi * (burst[f"{role}_frequency_hz"] - 1626.1e6) * np.arange(begin - 6000, end) / 1e6)
            band = np.convolve(iq[begin - 6000 : end] * turn, np.hamming(60) / 32.0, "valid")
            power = np.abs(band) ** 2
            edge = power[4700:7300]  # 1.3 ms either side of the start
            found = int(np.argmax(np.cumsum(edge[::-1])[::-1] < 0.995 * edge.sum())) - 1300 + 30
            if np.mean(power[:4000]) < 0.05 * np.mean(power[6500:]):  # nobody else just before on this channel
                inside += 1
                assert abs(found) < 120, (role, burst, found)
    assert inside >= 6


def test_two_recordings_agree_with_the_truth(made: Path) -> None:
    """The correlation of a burst in both recordings peaks at its TDOA."""
    truth = json.loads((made / "truth.json").read_text())
    recordings = {role: sn.io.read_iq(made / f"{role}.sigmf-meta")[0] for role in ("target", "anchor")}
    checked = 0
    for burst in truth["bursts"]:
        half = 0.5 * burst["duration_s"] + 2e-3
        begin = round((burst["anchor_reading_s"] - half) * 1e6)
        size = round(2.0 * half * 1e6)
        if burst["kind"] != "ring_alert" or begin < 0 or begin + size > 800_000:
            continue
        n = np.arange(size) / 1e6
        rows = {}
        for role in recordings:
            turned = recordings[role][begin : begin + size] * np.exp(
                -2j * np.pi * (burst[f"{role}_frequency_hz"] - 1626.1e6) * n
            )
            spectrum = np.fft.fft(turned, 2 * size)
            spectrum[np.abs(np.fft.fftfreq(2 * size, 1e-6)) > 20e3] = 0.0
            rows[role] = spectrum
        product = np.abs(np.fft.ifft(rows["target"] * rows["anchor"].conj()))
        lags = np.fft.fftfreq(2 * size, 1.0 / (2 * size))
        k = int(np.argmax(product))
        left, top, right = (product[(k + i) % len(product)] for i in (-1, 0, 1))
        lag = lags[k] + 0.5 * (left - right) / (left - 2.0 * top + right)
        # A hundredth of a symbol; the bound at these SNRs is some 50 ns.
        assert lag * 1e-6 == pytest.approx(burst["tdoa_s"], abs=4e-7)
        checked += 1
    assert checked >= 2


def test_tones_are_heard_by_whom_it_says(made: Path) -> None:
    level = {}
    for role in ("target", "anchor"):
        iq, _ = sn.io.read_iq(made / f"{role}.sigmf-meta")
        spectrum = np.abs(np.fft.fft(iq * np.hanning(len(iq)))) ** 2
        frequency = np.fft.fftfreq(len(iq), 1e-6)
        near = spectrum[np.abs(frequency + 80e3) < 1e3]
        level[role] = near.max() / np.median(near)
    assert level["target"] > 1e4
    assert level["anchor"] < 100.0
    # The tone is at 1626.02 MHz less the target's drift: 569 Hz higher for a slow clock.
    iq, _ = sn.io.read_iq(made / "target.sigmf-meta")
    spectrum = np.abs(np.fft.fft(iq * np.hanning(len(iq))))
    at = np.fft.fftfreq(len(iq), 1e-6)[np.argmax(np.where(np.abs(frequency + 80e3) < 1e3, spectrum, 0.0))]
    assert at == pytest.approx(-80e3 + 0.35e-6 * 1626.02e6, abs=2.0)


def test_tles_and_moving_targets(tmp_path: Path) -> None:
    tle = tmp_path / "one.tle"
    tle.write_text(
        "IRIDIUM TEST\n"
        "1 24793U 97020B   14239.50000000  .00000000  00000-0  00000-0 0  9990\n"
        "2 24793  86.4000   0.0000 0002000  90.0000  60.0000 14.34200000    09\n"
    )
    lines = tle.read_text().splitlines()
    digits = [line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10) for line in lines[1:]]
    tle.write_text("\n".join([lines[0], *digits]) + "\n")
    text = SHORT.replace("duration_s = 0.8", "duration_s = 0.1")
    text = text.replace("[satellites]\n", f'[satellites]\ntle = "{tle.name}"\n')
    text = text.replace("height_m = 35.0\n", "height_m = 35.0\nvelocity_mps = [100.0, 0.0, 0.0]\n")
    (tmp_path / "pair.toml").write_text(text)
    refused = run("synth", "pair", tmp_path / "pair.toml", tmp_path / "out", code=2).stderr
    assert "no satellite stands above 8° at both receivers" in refused
    place = sn.orbits.read_tle(tle)[0].sampled("2014-08-27T13:55:00", 1.0)
    latitude, longitude, _ = (float(x) for x in sn.geometry.ecef_to_geodetic(np.asarray(place.at(0.0)[0]).ravel()))
    for old, new in (
        ("60.2\n", latitude),
        ("60.27\n", latitude + 0.001),
        ("25.0\n", longitude),
        ("25.11\n", longitude),
    ):
        text = text.replace(f" {old}", f" {math.degrees(new)}\n")
    (tmp_path / "pair.toml").write_text(text)
    run("synth", "pair", tmp_path / "pair.toml", tmp_path / "out")
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert {burst["satellite"] for burst in truth["bursts"]} <= {"IRIDIUM TEST"}
    assert np.linalg.norm(truth["target"]["velocity_e_mps"]) == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sample_rate_hz = 1e6", "sample_rate_hz = 1e4", "capture.sample_rate_hz"),
        ("duration_s = 0.8", "duration_s = 90.0", "9e+07 samples; at most 5e+07"),
        ("center_frequency_hz = 1626.1e6", "center_frequency_hz = 1628e6", "tones[0].frequency_hz"),
        ("drift_ppm = 0.2", "drift_ppm = 200.0", "anchor.clock.drift_ppm"),
        ('heard_by = "target"', 'heard_by = "nobody"', "tones[0].heard_by"),
    ],
)
def test_refuses(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "pair.toml").write_text(SHORT.replace(old, new))
    assert message in run("synth", "pair", tmp_path / "pair.toml", tmp_path / "out", code=2).stderr
    assert not (tmp_path / "out").exists()


def test_a_band_without_channels_is_refused(tmp_path: Path) -> None:
    text = SHORT.split("[[tones]]")[0].replace("center_frequency_hz = 1626.1e6", "center_frequency_hz = 1628e6")
    (tmp_path / "pair.toml").write_text(text)
    message = run("synth", "pair", tmp_path / "pair.toml", tmp_path / "out", code=2).stderr
    assert "no channel with bursts lies in the recorded band" in message
