"""``soopnav df``: bearings from captures of an array, the warnings, and the refusals."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner, Result

from soopnav_cpp import array, io, plotting, simulation
from soopnav_cpp.scenarios.bearings import read_bearings

pytest.importorskip("matplotlib")
pytest.importorskip("sigmf")

from soopnav_cpp.cli import locate_emitter
from soopnav_cpp.cli.app import cli

RATE_HZ = 1e6
FREQUENCY_HZ = 1575.42e6
ARRAY = """\
name = "roof"
frequency_hz = 1575.42e6
kind = "planar"
nx = 2
ny = 2
spacing_wavelengths = 0.4
"""


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture
def roof(tmp_path: Path) -> Path:
    path = tmp_path / "roof.toml"
    path.write_text(ARRAY, encoding="utf-8")
    return path


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without figures, which take most of the time."""
    monkeypatch.setattr(locate_emitter, "figures", lambda _result, _folder: [])
    for name in ("polar_spectrum", "bearings_over_time"):
        monkeypatch.setattr(plotting, name, lambda *_, path, **__: Path(path).write_bytes(b"\x89PNG"))


def samples(
    roof: Path,
    azimuth_deg: Any = 40.0,
    elevation_deg: Any = 20.0,
    *,
    snr_db: float = 10.0,
    n: int = 10_000,
    seed: int = 1,
    edit: Any = None,
) -> npt.NDArray[np.complex64]:
    link = simulation.ArrayLink(array.load_array(roof), sample_rate_hz=RATE_HZ)
    iq = link.iq(np.radians(azimuth_deg), np.radians(elevation_deg), snr_db=snr_db, n_samples=n, seed=seed)
    if edit is not None:
        edit(iq)
    return iq


def capture(folder: Path, name: str, iq: npt.NDArray[np.complex64], **more: Any) -> Path:
    more.setdefault("center_frequency_hz", FREQUENCY_HZ)
    return io.write_iq_channels(folder / name, iq, RATE_HZ, **more)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "bearings.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_bearings_of_a_capture(tmp_path: Path, roof: Path) -> None:
    """Four blocks, each within five of its own standard deviations; every file is there."""
    path = capture(tmp_path, "x", samples(roof))
    out = tmp_path / "out"
    shown = run("df", path, "--array", roof, "--out", out).stdout
    found = rows(out)
    assert list(found[0]) == [
        "time_s", "emitter", "azimuth_deg", "elevation_deg", "sigma_azimuth_deg", "sigma_elevation_deg", "snr_db",
        "status",
    ]  # fmt: skip
    assert [float(row["time_s"]) for row in found] == pytest.approx([1.25e-3, 3.75e-3, 6.25e-3, 8.75e-3])
    for row in found:
        assert row["status"] == "ok"
        assert row["emitter"] == "1"
        for name, right in (("azimuth", 40.0), ("elevation", 20.0)):
            sigma = float(row[f"sigma_{name}_deg"])
            assert 0.01 < sigma < 3.0
            assert float(row[f"{name}_deg"]) == pytest.approx(right, abs=5.0 * sigma)
        assert float(row["snr_db"]) == pytest.approx(10.0, abs=1.0)
    assert "roof: 4 elements at 1575.42 MHz, MUSIC" in shown
    assert "4 bearings in 4 blocks of 2500 samples" in shown
    assert "what comes from below is seen as if it came from above" in shown
    metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["bearings"] == 4
    assert metrics["strongest"]["azimuth_deg"] == pytest.approx(40.0, abs=1.5)
    for name in ("spectrum.png", "azimuth.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    report = (out / "report.html").read_text(encoding="utf-8")
    assert report.count("data:image/png;base64,") == 2
    assert "4 bearings in 4 blocks" in report


@pytest.mark.usefixtures("plain")
def test_poses_make_true_bearings_that_are_located(tmp_path: Path, roof: Path) -> None:
    """The whole way: captures of a drive and its poses to a position, with the array's azimuth left of a heading."""
    emitter = np.array([300.0, 400.0, 40.0])
    places = np.array([[0.0, 0.0], [150.0, 0.0], [300.0, 0.0], [450.0, 0.0]])
    link = simulation.ArrayLink(array.load_array(roof), sample_rate_hz=RATE_HZ)
    heading = np.radians([90.0, 70.0, 45.0, 0.0])
    lines = ["time_s,x_m,y_m,heading_deg"]
    captures = []
    for k, (x, y) in enumerate(places):
        forward = np.array([math.sin(heading[k]), math.cos(heading[k]), 0.0])
        left = np.array([-forward[1], forward[0], 0.0])
        turn = np.column_stack([forward, left, [0.0, 0.0, 1.0]])
        azimuth, elevation, _ = link.directions([[x, y, 0.0]], emitter, turn)
        iq = link.iq(azimuth[0], elevation[0], snr_db=15.0, n_samples=2500, seed=k)
        captures.append(capture(tmp_path, f"stop{k}", iq, datetime_utc=f"2026-01-01T00:00:{10 * k:02d}Z"))
        lines.append(f"{10 * k},{x},{y},{math.degrees(heading[k])}")
        lines.append(f"{10 * k + 1},{x},{y},{math.degrees(heading[k])}")
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(lines) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    run("df", *captures, "--array", roof, "--poses", poses, "--out", out)
    found = rows(out)
    assert [round(float(row["time_s"])) for row in found] == [0, 10, 20, 30]
    for row, (x, y) in zip(found, places, strict=True):
        right = math.degrees(math.atan2(emitter[0] - x, emitter[1] - y)) % 360.0
        assert float(row["bearing_deg"]) == pytest.approx(right, abs=5.0 * float(row["sigma_bearing_deg"]))
    data = read_bearings(out / "bearings.csv")
    assert len(data) == 4
    located = run("locate-emitter", out / "bearings.csv", "--out", tmp_path / "fix").stdout
    assert "emitter 1: east" in located
    metrics = json.loads((tmp_path / "fix" / "metrics.json").read_text(encoding="utf-8"))
    fix = metrics["emitters"][0]["methods"]["ml"]
    off = np.array(fix["position_m"][:2]) - emitter[:2]
    assert off @ np.linalg.solve(np.array(fix["covariance_m2"])[:2, :2], off) < 25.0


@pytest.mark.usefixtures("plain")
def test_poses_on_the_earth(tmp_path: Path, roof: Path) -> None:
    """Latitudes and longitudes go through, and the bearings are against the north of their own place."""
    path = capture(tmp_path, "x", samples(roof, snr_db=20.0, n=5000))
    poses = tmp_path / "poses.csv"
    poses.write_text("time_s,latitude_deg,longitude_deg,heading_deg\n0,60,10,100\n0.004,60,12,100\n", encoding="utf-8")
    run("df", path, "--array", roof, "--poses", poses, "--out", tmp_path / "out")
    for row, longitude in zip(rows(tmp_path / "out"), (10.625, 11.875), strict=True):
        assert float(row["longitude_deg"]) == pytest.approx(longitude, abs=2e-3)
        assert float(row["latitude_deg"]) == pytest.approx(60.0, abs=0.02)
        # 40° to the left of a heading of 100°; between two poses the way is straight, and so north turns.
        assert float(row["bearing_deg"]) == pytest.approx(60.0, abs=2.0 + 5.0 * float(row["sigma_bearing_deg"]))
    data = read_bearings(tmp_path / "out" / "bearings.csv")
    assert data.frame is not None
    assert "emitter.kml" not in {p.name for p in (tmp_path / "out").iterdir()}


@pytest.mark.usefixtures("plain")
def test_blocks_and_several_captures(tmp_path: Path, roof: Path) -> None:
    """Without a datetime captures follow each other; --every-s leaves samples out; --json prints JSON alone."""
    paths = [capture(tmp_path, name, samples(roof, seed=k)) for k, name in enumerate("ab")]
    out = tmp_path / "out"
    shown = run("df", *paths, "--array", roof, "--block-s", 1e-3, "--every-s", 4e-3, "--json", "--out", out)
    assert json.loads(shown.stdout)["blocks"] == 6
    times = [float(row["time_s"]) for row in rows(out)]
    assert times == pytest.approx([0.5e-3, 4.5e-3, 8.5e-3, 10.5e-3, 14.5e-3, 18.5e-3])
    run("df", paths[0], "--array", roof, "--block-s", 1e-3, "--block-samples", 1000, "--out", out, code=2)


@pytest.mark.usefixtures("plain")
def test_deviations_of_a_weak_signal(tmp_path: Path, roof: Path) -> None:
    """At −18 dB a block's own eigenvalues promise too much; averaged over eleven they do not."""
    iq = samples(roof, 40.0, 10.0, snr_db=-18.0, n=160 * 500, seed=3)
    path = capture(tmp_path, "weak", iq)
    spread: dict[int, float] = {}
    for smooth in (1, 11):
        out = tmp_path / f"out{smooth}"
        run("df", path, "--array", roof, "--block-samples", 500, "--smooth", smooth, "--out", out)
        found = rows(out)
        off = np.array([(float(row["azimuth_deg"]) - 40.0 + 180.0) % 360.0 - 180.0 for row in found])
        sigma = np.array([float(row["sigma_azimuth_deg"]) for row in found])
        assert len(off) == 160
        spread[smooth] = float(np.sqrt(np.mean(off**2)) / np.median(sigma))
    assert spread[1] > 4.0 * spread[11]
    assert 0.7 < spread[11] < 1.4
    for arguments, sentence in (
        (["--smooth", 4], "--smooth 4: an odd number of blocks expected"),
        (["--smooth", 5, "--sources", 2], "--smooth 5: eigenvalues tell deviations of one source"),
    ):
        result = run("df", path, "--array", roof, *arguments, "--out", tmp_path / "o", code=2)
        assert sentence in result.stderr


@pytest.mark.usefixtures("plain")
def test_noise_has_no_direction(tmp_path: Path, roof: Path) -> None:
    iq = samples(roof, snr_db=-60.0, n=5000)
    path = capture(tmp_path, "noise", iq)
    result = run("df", path, "--array", roof, "--sources", "auto", "--out", tmp_path / "out", code=2)
    assert "no bearing in 2 blocks: 2 no source" in result.stdout


@pytest.mark.usefixtures("plain")
def test_two_sources(tmp_path: Path, roof: Path) -> None:
    """Two directions in each block, whether their number is given or counted."""
    iq = samples(roof, [40.0, -100.0], [30.0, 30.0], snr_db=20.0, n=5000)
    path = capture(tmp_path, "two", iq)
    for sources in ("2", "auto"):
        out = tmp_path / f"out{sources}"
        run("df", path, "--array", roof, "--sources", sources, "--out", out)
        found = sorted(float(row["azimuth_deg"]) for row in rows(out))
        assert found == pytest.approx([-100.0, -100.0, 40.0, 40.0], abs=3.0)
        assert all(row["emitter"] == "" for row in rows(out))
    run("df", path, "--array", roof, "--sources", "4", "--out", tmp_path / "o", code=2)
    result = run("df", path, "--array", roof, "--sources", "many", "--out", tmp_path / "o", code=2)
    assert "--sources many: a number or auto expected" in result.stderr


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize("method", ["capon", "bartlett"])
def test_other_methods(tmp_path: Path, roof: Path, method: str) -> None:
    path = capture(tmp_path, "x", samples(roof, snr_db=20.0, n=2500))
    run("df", path, "--array", roof, "--method", method, "--out", tmp_path / "out")
    (row,) = rows(tmp_path / "out")
    assert float(row["azimuth_deg"]) == pytest.approx(40.0, abs=3.0)
    assert "azimuth.png" not in {p.name for p in (tmp_path / "out").iterdir()}  # one block is no course of time


@pytest.mark.usefixtures("plain")
def test_a_calibration_is_applied(tmp_path: Path, roof: Path) -> None:
    """Phases of the receivers spoil the bearing; with their calibration it is right; another array's is refused."""
    manifold = array.load_array(roof)
    phases = np.exp(1j * np.array([0.0, 2.0, -1.0, 0.7]))[:, None]

    def turn(iq: npt.NDArray[np.complex64]) -> None:
        iq *= phases.astype(np.complex64)

    path = capture(tmp_path, "x", samples(roof, snr_db=20.0, n=2500, edit=turn))
    noise = np.random.default_rng(1).standard_normal((2, 4, 20_000))
    tone = 30.0 * np.exp(2j * np.pi * 0.0625 * np.arange(20_000)) + noise[0] + 1j * noise[1]
    calibration = array.calibrate((tone * phases).astype(np.complex64), RATE_HZ, 0.0625 * RATE_HZ, manifold.geometry)
    calibration.save(tmp_path / "cal.json")
    run("df", path, "--array", roof, "--out", tmp_path / "without")
    run("df", path, "--array", roof, "--calibration", tmp_path / "cal.json", "--out", tmp_path / "with")
    (spoilt,), (good,) = rows(tmp_path / "without"), rows(tmp_path / "with")
    assert float(good["azimuth_deg"]) == pytest.approx(40.0, abs=2.0)
    assert abs(float(spoilt["azimuth_deg"]) - 40.0) > 10.0
    other = tmp_path / "other.toml"
    other.write_text(ARRAY.replace("0.4", "0.3"), encoding="utf-8")
    result = run("df", path, "--array", other, "--calibration", tmp_path / "cal.json", "--out", tmp_path / "o", code=2)
    assert "cal" in result.stderr


@pytest.mark.usefixtures("plain")
def test_channels_that_are_dead_or_broken(tmp_path: Path, roof: Path) -> None:
    def dead(iq: npt.NDArray[np.complex64]) -> None:
        iq[2] = 0.0

    def broken(iq: npt.NDArray[np.complex64]) -> None:
        iq[1, 3000] = np.nan

    path = capture(tmp_path, "dead", samples(roof, edit=dead))
    result = run("df", path, "--array", roof, "--out", tmp_path / "a", code=2)
    assert "channel 2 is dead" in result.stdout
    assert "no bearing in 4 blocks: 4 dead channel" in result.stdout
    assert (tmp_path / "a" / "report.html").exists()
    path = capture(tmp_path, "nan", samples(roof, edit=broken))
    result = run("df", path, "--array", roof, "--out", tmp_path / "b")
    assert "channel 1 holds NaN" in result.stdout
    assert "is dead" not in result.stdout
    status = [row["status"] for row in rows(tmp_path / "b")]
    assert status == ["ok", "non_finite", "ok", "ok"]
    assert rows(tmp_path / "b")[1]["azimuth_deg"] == ""
    assert len(read_bearings_of(tmp_path / "b")) == 3


@pytest.mark.usefixtures("plain")
def test_a_channel_of_nan_alone_makes_no_other_dead(tmp_path: Path, roof: Path) -> None:
    def broken(iq: npt.NDArray[np.complex64]) -> None:
        iq[0] = np.nan
        iq[3] = 0.0

    path = capture(tmp_path, "x", samples(roof, n=2500, edit=broken))
    shown = run("df", path, "--array", roof, "--out", tmp_path / "o", code=2).stdout
    assert "channel 0 holds NaN" in shown
    assert "channel 3 is dead" in shown


@pytest.mark.usefixtures("plain")
def test_a_calibration_of_another_recording(tmp_path: Path, roof: Path) -> None:
    """Its carrier and its sampling rate are the recording's, not those of the array's description."""
    geometry = array.load_array(roof).geometry
    tone = np.tile(30.0 * np.exp(2j * np.pi * 0.0625 * np.arange(20_000)), (4, 1))
    tone = (tone + np.random.default_rng(1).standard_normal(tone.shape)).astype(np.complex64)
    iq = samples(roof, n=2500)
    near_hz = FREQUENCY_HZ + 1e6
    for rate_hz, frequency_hz, sentence in (
        (RATE_HZ, near_hz, "made at 1576.420000 MHz, not at 1575.420000 MHz"),
        (2e6, FREQUENCY_HZ, "made at 2e+06 samples per second, not at 1e+06"),
    ):
        path = capture(tmp_path, "here", iq)
        made = array.calibrate(tone, rate_hz, 0.0625 * rate_hz, geometry, frequency_hz=frequency_hz)
        made.save(tmp_path / "cal.json")
        arguments = ["df", path, "--array", roof, "--calibration", tmp_path / "cal.json", "--out", tmp_path / "o"]
        assert f"cal.json for {path.name}: {sentence}" in run(*arguments, code=2).stderr
    # Both recordings are tuned beside what the array is described at: they belong together.
    path = capture(tmp_path, "near", iq, center_frequency_hz=near_hz)
    heard = capture(tmp_path, "tone", tone, center_frequency_hz=near_hz)
    run("calibrate", heard, "--tone", 0.0625 * RATE_HZ, "--array", roof, "--out", tmp_path / "own.json")
    run("df", path, "--array", roof, "--calibration", tmp_path / "own.json", "--out", tmp_path / "o")


@pytest.mark.parametrize("option", ["--start", "--block-s", "--every-s", "--lowest-elevation"])
def test_numbers_that_are_none(tmp_path: Path, roof: Path, option: str) -> None:
    result = run("df", "x.sigmf-meta", "--array", roof, option, "nan", "--out", tmp_path / "o", code=2)
    assert f"'{option}': nan: a finite number expected" in result.stderr


def read_bearings_of(folder: Path) -> list[dict[str, str]]:
    return [row for row in rows(folder) if row["status"] == "ok"]


@pytest.mark.usefixtures("plain")
def test_captures_of_another_array(tmp_path: Path, roof: Path) -> None:
    iq = samples(roof)
    path = capture(tmp_path, "three", iq[:3])
    result = run("df", path, "--array", roof, "--out", tmp_path / "o", code=2)
    assert "3 channels, but the array has 4 elements" in result.stderr
    path = capture(tmp_path, "band", iq, center_frequency_hz=1176.45e6)
    result = run("df", path, "--array", roof, "--out", tmp_path / "o", code=2)
    assert "tuned to 1176.45 MHz, but the array is described at 1575.42 MHz; another array?" in result.stderr
    path = capture(tmp_path, "near", iq, center_frequency_hz=1605e6)
    assert "bearings are off by up to 1.9 %" in run("df", path, "--array", roof, "--out", tmp_path / "o").stdout
    path = capture(tmp_path, "short", iq[:, :1000])
    result = run("df", path, "--array", roof, "--out", tmp_path / "o", code=2)
    assert "1000 samples, fewer than one block of 2500" in result.stderr
    good = capture(tmp_path, "good", iq)
    fast = io.write_iq_channels(tmp_path / "fast", iq, 2e6, center_frequency_hz=FREQUENCY_HZ)
    result = run("df", good, fast, "--array", roof, "--out", tmp_path / "o", code=2)
    assert "one sample rate expected" in result.stderr
    assert not (tmp_path / "o" / "bearings.csv").exists() or "near" not in result.stderr


@pytest.mark.usefixtures("plain")
def test_what_an_array_cannot_tell(tmp_path: Path) -> None:
    """A line has its cone, a wide plane its doubles: both are said."""
    for text, sentence in (
        ('kind = "ula"\nn = 4\nspacing_wavelengths = 0.5\n', "the elements lie on a line"),
        ('kind = "planar"\nnx = 2\nny = 2\nspacing_wavelengths = 1.2\n', "leave directions ambiguous"),
    ):
        path = tmp_path / "array.toml"
        path.write_text(f"frequency_hz = 1575.42e6\n{text}", encoding="utf-8")
        out = tmp_path / "out"
        taken = capture(tmp_path, "x", samples(path, 40.0, 0.0, n=2500))
        assert sentence in run("df", taken, "--array", path, "--out", out).stdout


@pytest.mark.usefixtures("plain")
def test_poses_that_do_not_reach(tmp_path: Path, roof: Path) -> None:
    poses = tmp_path / "poses.csv"
    poses.write_text("time_s,x_m,y_m,heading_deg\n100,0,0,0\n200,1,1,0\n", encoding="utf-8")
    path = capture(tmp_path, "x", samples(roof, n=2500))
    result = run("df", path, "--array", roof, "--poses", poses, "--out", tmp_path / "o", code=2)
    assert "no pose at 0.00125 s: the poses cover 100 … 200 s" in result.stderr
    run("df", path, "--array", roof, "--poses", poses, "--start", 100, "--out", tmp_path / "o")
    assert float(rows(tmp_path / "o")[0]["time_s"]) == pytest.approx(100.00125)
