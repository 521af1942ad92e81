"""Calibration: what it recovers, what its file refuses, and which channel a refusal names."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import soopnav_cpp as sn
from soopnav_cpp import array, plotting
from soopnav_cpp.cli.app import cli
from soopnav_cpp.experiments import carter_calibration

pytestmark = pytest.mark.unit

RATE, TONE, OTHER = 20e6, 1.013e6, -3.317e6
ARRAY_TOML = 'name = "roof"\nfrequency_hz = 1575.42e6\nkind = "planar"\nnx = 2\nny = 2\nspacing_wavelengths = 0.2\n'


def geometry(spacing=0.2, frequency_hz=1575.42e6):
    return array.ArrayGeometry.planar(2, 2, spacing, frequency_hz=frequency_hz)


def tone(frequency_hz, n=10_000, amplitude=0.4):
    return np.tile((amplitude * np.exp(2j * np.pi * frequency_hz / RATE * np.arange(n))).astype(np.complex64), (4, 1))


def spoilt(x, seed=1, snr_db=math.inf, phases=(0.0, 1.0, -2.5, 3.0)):
    """2 dB and 10 degrees, written without the library: I' = I, Q' = g (Q cos + I sin)."""
    rng = np.random.default_rng(seed)
    noise = 10 ** (-snr_db / 20) * np.sqrt(np.mean(np.abs(x) ** 2) / 2)
    x = x * np.exp(1j * np.array(phases))[:, None]
    x = x + noise * (rng.standard_normal(x.shape) + 1j * rng.standard_normal(x.shape))
    phi = math.radians(10)
    q = 10**0.1 * (x.imag * math.cos(phi) + x.real * math.sin(phi))
    return (x.real + 0.03 + 1j * (q - 0.01)).astype(np.complex64)


def image_db(samples, frequency_hz):
    line = np.exp(2j * np.pi * frequency_hz / RATE * np.arange(samples.shape[1]))
    design = np.stack([line, line.conj(), np.ones(len(line))], axis=1)
    a, b, _ = np.linalg.lstsq(design, samples.T.astype(complex), rcond=None)[0]
    return 20 * np.log10(np.abs(b / a)), np.degrees(np.angle(a / a[0]))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_another_tone_has_no_image_and_equal_phases(seed):
    found = array.calibrate(spoilt(tone(TONE), seed, 30.0), RATE, TONE, geometry())
    assert np.all(np.abs(found.image_db + 16.82) < 0.2)
    after, phase = image_db(found.apply(spoilt(tone(OTHER))), OTHER)
    assert after.max() < -50.0
    assert np.abs(phase).max() < 0.2
    before, _ = image_db(spoilt(tone(OTHER)), OTHER)
    assert before.min() > -17.5


def test_calibrated_array_points_to_the_zenith():
    found = array.calibrate(spoilt(tone(TONE), 4, 30.0), RATE, TONE, geometry())
    finder = array.DirectionFinder(geometry())
    heard = spoilt(tone(OTHER), 5, 30.0)
    assert np.degrees(finder.estimate(found.apply(heard)).elevation_rad[0]) > 89.0
    assert np.degrees(finder.estimate(heard).elevation_rad[0]) < 80.0


def test_agrees_with_the_front_end_of_the_simulation():
    front_end = sn.simulation.FrontEnd(
        4, gain=[1.0, 0.8j, -1.2, 1.0], iq_gain_db=2.0, iq_phase_rad=[0.1, -0.1, 0.0, 0.2], dc=0.02 - 0.01j
    )
    milliwatts = 10 ** ((front_end.full_scale_dbm - 6.0) / 20)
    found = array.calibrate(front_end.apply(tone(TONE, amplitude=milliwatts), seed=1), RATE, TONE, geometry())
    np.testing.assert_allclose(20 * np.log10(found.iq_gain), 2.0, atol=0.02)
    np.testing.assert_allclose(found.iq_phase_rad, [0.1, -0.1, 0.0, 0.2], atol=2e-3)
    np.testing.assert_allclose(found.channel, [1.0, 0.8j, -1.2, 1.0], atol=5e-3)
    np.testing.assert_allclose(found.dc, 0.02 - 0.01j, atol=2e-3)


def test_reference_channel_is_a_choice():
    heard = spoilt(tone(TONE), 1, 30.0)
    first = array.calibrate(heard, RATE, TONE, geometry())
    third = array.calibrate(heard, RATE, TONE, geometry(), reference=2)
    np.testing.assert_allclose(third.channel, first.channel / first.channel[2], rtol=1e-12)


def test_nan_stays_nan():
    found = array.calibrate(spoilt(tone(TONE), 1, 30.0), RATE, TONE, geometry())
    x = tone(OTHER, 20)
    x[1, 3] = np.nan
    assert np.argwhere(np.isnan(found.apply(x))).tolist() == [[1, 3]]
    with pytest.raises(ValueError, match=r"iq: shape \(3, 20\); \(4, n\)"):
        found.apply(x[:3])


def bad_channel(change, channel=2):
    heard = spoilt(tone(TONE), 1, 30.0)
    heard[channel] = change(heard[channel])
    return heard


def clipped(row):
    return (np.clip(row.real, -0.3, 0.3) + 1j * np.clip(row.imag, -0.3, 0.3)).astype(np.complex64)


REFUSED = {
    "nan": (
        lambda: bad_channel(lambda row: np.where(np.arange(len(row)) == 7, np.nan, row)),
        "channel 2, sample 7 is not",
    ),
    "dead": (lambda: bad_channel(lambda row: 0 * row), "channel 2 is dead: it never changes"),
    "far too weak": (lambda: bad_channel(lambda row: 1e-5 * row), "channel 2 is dead: 1.. dB below the strongest"),
    "no tone": (
        lambda: bad_channel(lambda row: spoilt(tone(OTHER), 1, 30.0)[2]),
        r"channel 2: the tone .* 10 dB at least",
    ),
    "saturated": (lambda: bad_channel(clipped), "channel 2 is saturated: .* of its samples lie at the ends"),
    "real": (lambda: bad_channel(lambda row: row.real), "channel 2: the image of the tone .* complex"),
    "short": (lambda: spoilt(tone(TONE, 70), 1, 30.0), "70 samples hold 3.5 turns of the tone at 1.013e.06 Hz"),
    "channels": (lambda: tone(TONE)[:3], r"iq: shape \(3, 10000\); \(4, n\)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_name_the_channel(case):
    make, sentence = REFUSED[case]
    with pytest.raises(array.CalibrationError, match=sentence):
        array.calibrate(make(), RATE, TONE, geometry())


@pytest.mark.parametrize(
    ("tone_hz", "sentence"), [(0.0, "a point and no ellipse"), (11e6, "below half"), (math.nan, "tone")]
)
def test_tones_that_cannot_be(tone_hz, sentence):
    with pytest.raises(ValueError, match=sentence):
        array.calibrate(tone(TONE), RATE, tone_hz, geometry())


# ---- The file


@pytest.fixture
def saved(tmp_path):
    found = array.calibrate(spoilt(tone(TONE), 1, 30.0), RATE, TONE, geometry())
    return found, found.save(tmp_path / "cal.json")


def test_file_brings_back_the_same_numbers(saved):
    found, path = saved
    back = array.Calibration.load(path, geometry=geometry(), frequency_hz=1575.42e6, sample_rate_hz=RATE)
    for name in ("iq_gain", "iq_phase_rad", "dc", "channel", "tone_snr_db", "image_sigma", "phase_sigma_rad"):
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))
    assert (back.array_id, back.frequency_hz, back.tone_hz) == (found.array_id, found.frequency_hz, found.tone_hz)


@pytest.mark.parametrize(
    ("use", "sentence"),
    [
        (
            {"geometry": geometry(0.3)},
            r"made for array .* \(4 elements, id [0-9a-f]{16}\), not for .* \(4 elements, id",
        ),
        ({"geometry": array.ArrayGeometry.ula(3)}, r"not for .* \(3 elements"),
        ({"geometry": geometry(), "frequency_hz": 1227.6e6}, "made at 1575.420000 MHz, not at 1227.600000 MHz"),
        ({"frequency_hz": 1575.43e6}, "made at 1575.420000 MHz, not at 1575.430000 MHz"),
        ({"sample_rate_hz": 10e6}, "made at 2e.07 samples per second, not at 1e.07"),
    ],
)
def test_file_is_refused_for_something_else(saved, use, sentence):
    with pytest.raises(array.CalibrationError, match=f"cal.json: .*{sentence}"):
        array.Calibration.load(saved[1], **use)


def test_another_carrier_of_the_same_elements_is_refused(saved):
    here = geometry()
    other = array.ArrayGeometry(here.positions_m, 1600e6)
    assert array.array_id(other) == array.array_id(here)
    with pytest.raises(array.CalibrationError, match=r"not at 1600\.000000 MHz"):
        array.Calibration.load(saved[1], geometry=other)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: d.update(version=2), "version 2; version 1 is read"),
        (lambda d: d.update(format="other"), "not a calibration"),
        (lambda d: d.update(channels=[]), "channels must be a list"),
        (lambda d: d["channels"][1].pop("iq_gain"), r"channels\[1\].iq_gain is None; a finite number"),
        (lambda d: d["channels"][1].update(iq_gain=-1.0), r"channels\[1\].iq_gain is -1.0; it must be above zero"),
        (lambda d: d["channels"][3].update(channel=[0.0, 0.0]), r"channels\[3\].channel is 0"),
        (lambda d: d["channels"][3].update(dc=[0.0]), r"channels\[3\].dc is \[0.0\]; real and imaginary"),
        (lambda d: d["channels"][0].update(iq_phase_rad=1.5), r"channels\[0\].iq_phase_rad is 1.5"),
        (lambda d: d["array"].pop("id"), "array must say its name and id"),
        (lambda d: d.update(sample_rate_hz=0), "sample_rate_hz is 0; it must be above zero"),
    ],
)
def test_file_that_is_wrong(saved, change, sentence):
    path = saved[1]
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(array.CalibrationError, match=sentence):
        array.Calibration.load(path)


def test_file_that_is_no_json(tmp_path):
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(array.CalibrationError, match=r"x\.json: not JSON"):
        array.Calibration.load(tmp_path / "x.json")
    with pytest.raises(FileNotFoundError):
        array.Calibration.load(tmp_path / "none.json")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_text_is_read_or_refused(saved, data):
    text = saved[1].read_text()
    first = data.draw(st.integers(0, len(text)))
    last = data.draw(st.integers(first, min(len(text), first + 30)))
    torn = saved[1].with_name("torn.json")
    torn.write_text(text[:first] + data.draw(st.text(max_size=6)) + text[last:], encoding="utf-8", errors="replace")
    try:
        found = array.Calibration.load(torn)
    except array.CalibrationError as error:
        assert "torn.json" in str(error)
    else:
        assert np.isfinite(found.channel).all()
        assert np.all(found.iq_gain > 0)


@settings(max_examples=40, deadline=None)
@given(
    iq=hnp.arrays(np.complex64, st.tuples(st.just(4), st.integers(0, 200))),
    tone_hz=st.floats(-1.0, 1.0).map(lambda x: x * RATE),
)
def test_any_samples_are_fitted_or_refused(iq, tone_hz):
    try:
        found = array.calibrate(iq, RATE, tone_hz, geometry())
    except ValueError as error:
        assert str(error)
    else:
        assert np.isfinite(found.channel).all()
        assert np.all(found.iq_gain > 0)


# ---- The command


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture
def recorded(tmp_path):
    (tmp_path / "roof.toml").write_text(ARRAY_TOML)
    capture = sn.io.write_iq_channels(
        tmp_path / "tone", spoilt(tone(TONE, 20_000), 1, 30.0), RATE, center_frequency_hz=1575.42e6
    )
    return capture, tmp_path / "roof.toml", tmp_path / "cal.json"


def test_command_writes_prints_and_draws(recorded, tmp_path):
    capture, roof, out = recorded
    picture = tmp_path / "cal.png"
    shown = run("calibrate", capture, "--tone", TONE, "--array", roof, "--out", out, "--plot", picture).stdout
    assert f"calibration: {out}" in shown
    assert "second half by the first: image −" in shown
    assert picture.stat().st_size > 10_000
    made = array.Calibration.load(out, geometry=array.load_array(roof), sample_rate_hz=RATE)
    assert made.array_name == "roof"
    assert image_db(made.apply(spoilt(tone(OTHER))), OTHER)[0].max() < -50.0


def test_command_as_json(recorded):
    capture, roof, out = recorded
    printed = json.loads(
        run(
            "calibrate", capture, "--tone", "1.01e6", "--array", roof, "--out", out, "--json", "--tolerance", "5e3"
        ).stdout
    )
    assert printed["tone_hz"] == pytest.approx(TONE, abs=1.0)
    assert max(row["image_after_db"] for row in printed["channels"]) < -50.0
    assert printed["channels"][0]["image_before_db"] == pytest.approx(-16.8, abs=0.2)


def test_command_refuses_what_does_not_fit(recorded, tmp_path):
    capture, roof, out = recorded
    said = run("calibrate", capture, "--tone", "3e6", "--array", roof, "--out", out, code=2).stderr
    assert said.startswith(f"{capture}: channel 0: the tone at 3e+06 Hz stands")
    assert not out.exists()
    other = tmp_path / "other.toml"
    other.write_text(ARRAY_TOML.replace("1575.42e6", "1227.6e6"))
    said = run("calibrate", capture, "--tone", TONE, "--array", other, code=2).stderr
    assert "tuned to 1575.42 MHz; the array of" in said
    other.write_text(ARRAY_TOML.replace("ny = 2", "ny = 3"))
    said = run("calibrate", capture, "--tone", TONE, "--array", other, code=2).stderr
    assert "4 channels; the array of" in said
    assert "out: a name" not in said
    assert (
        "ends in .json" in run("calibrate", capture, "--tone", TONE, "--array", roof, "--out", "x.txt", code=2).stderr
    )


def test_figure_has_its_panels():
    heard = spoilt(tone(TONE), 1, 30.0)
    figure = plotting.calibration(heard, array.calibrate(heard, RATE, TONE, geometry()), title="roof")
    assert len(figure.axes) == 4


# ---- Sigma map


@pytest.fixture(scope="module")
def table():
    return array.SigmaMap.build(geometry(), 500, snr_db=np.arange(-20.0, 21.0, 4.0), trials=200, seed=3)


def test_map_knows_both_ends(table):
    # Nothing left: uniform azimuth, pi / sqrt(3); ratio 1 + 4 SNR where the signal is strong (carter 4.11).
    assert table.azimuth_rms_rad[0] == pytest.approx(math.pi / math.sqrt(3), rel=0.35)
    np.testing.assert_allclose(table.ratio[-3:] - 1.0, 4.0 * 10.0 ** (table.snr_db[-3:] / 10), rtol=0.05)
    assert np.all(np.diff(table.sigma(np.geomspace(1.05, 1e4, 60))) <= 1e-12)
    assert table.sigma(4e4) == pytest.approx(table.sigma(1e4) / 2.0, rel=1e-3)
    assert math.isnan(table.sigma(math.nan))


def test_map_predicts_the_errors_of_bearings(table):
    link = sn.simulation.ArrayLink(geometry())
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(-3, 3, 1500), rng.uniform(0.02, 0.35, 1500)
    for snr_db in (-6.0, 6.0):
        found = array.DirectionFinder(geometry()).run(link.covariances(snr_db, azimuth, elevation, 500, seed=7), 500)
        off = np.angle(np.exp(1j * (found.azimuth_rad[:, 0] - azimuth)))
        predicted = table.sigma(table.smooth(found.eigenvalues))
        assert np.sqrt(np.mean(off**2)) / np.sqrt(np.mean(predicted**2)) == pytest.approx(1.0, abs=0.25)


def test_map_smooths_eigenvalues(table):
    values = np.array([[4.0, 1.0, 1.0], [2.0, 1.0, 1.0], [math.nan, 1.0, 1.0], [9.0, 3.0, 1.0]])
    np.testing.assert_allclose(table.smooth(values, epochs=3), [3.0, 3.0, 11.0 / 3.0, 4.5])
    np.testing.assert_allclose(table.smooth(values, epochs=1)[[0, 1, 3]], [4.0, 2.0, 4.5])
    assert math.isnan(table.smooth(values, epochs=1)[2])
    with pytest.raises(ValueError, match="epochs: 4; it must be odd"):
        table.smooth(values, epochs=4)
    with pytest.raises(ValueError, match=r"eigenvalues: shape \(3,\)"):
        table.smooth(values[0])


def test_map_is_kept_in_a_file(table, tmp_path):
    back = array.SigmaMap.load(table.save(tmp_path / "map.json"))
    np.testing.assert_array_equal(back.ratio, table.ratio)
    assert back.n_snapshots == 500
    (tmp_path / "bad.json").write_text("[]")
    with pytest.raises(ValueError, match=r"bad\.json: not a sigma map"):
        array.SigmaMap.load(tmp_path / "bad.json")
    document = json.loads((tmp_path / "map.json").read_text())
    document["ratio"] = document["ratio"][1:]
    (tmp_path / "map.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match="lists of one length"):
        array.SigmaMap.load(tmp_path / "map.json")


def test_map_refusals():
    with pytest.raises(ValueError, match="trials: 5; at least 10"):
        array.SigmaMap.build(geometry(), 500, trials=5, seed=1)
    with pytest.raises(ValueError, match="snapshots: 0; it must be at least 1"):
        array.SigmaMap.build(geometry(), 0, seed=1)
    with pytest.raises(ValueError, match="elevation_low_rad"):
        array.SigmaMap.build(geometry(), 10, elevation_rad=(0.5, 0.1), seed=1)


# ---- The page


def test_page_runs_as_it_stands(capsys):
    page = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    exec(compile("\n".join(blocks), "docs/calibration.md", "exec"), {})
    said = capsys.readouterr().out
    assert "-95.0 dBm, -1.6 dB at 150 m, -18.0 dB at 1 km" in said
    zenith = re.search(r"([\d.]+) degrees: the zenith", said)
    assert zenith is not None
    assert float(zenith[1]) > 89.0
    rms, predicted = map(float, re.findall(r"rms ([\d.]+), predicted ([\d.]+)", said)[0])
    assert 0.6 < rms / predicted < 1.6
    for name in re.findall(r"\]\(((?:images/|\.\./)[^)]+)\)", page):
        assert (Path(__file__).parents[2] / "docs" / name).exists()


@pytest.mark.parametrize("carrier", [math.nan, math.inf, 0.0, -1.0])
def test_a_carrier_that_cannot_be(carrier):
    with pytest.raises(array.CalibrationError, match=r"frequency_hz: .*positive finite"):
        array.calibrate(spoilt(tone(TONE)), RATE, TONE, geometry(), frequency_hz=carrier)


def test_lists_are_not_samples():
    with pytest.raises(ValueError, match=r"iq: .*complex64"):
        array.calibrate(tone(TONE, n=100).tolist(), RATE, TONE, geometry())


def test_the_capture_that_judges_a_calibration_has_noise_of_its_own():
    first, second = (carter_calibration.recorded(1, TONE, stream) for stream in (0, 1))
    phase = 2 * np.pi * TONE / RATE * np.arange(first.shape[1])
    design = np.stack([np.exp(1j * phase), np.exp(-1j * phase), np.ones(len(phase))], axis=1)
    rest = [x.T - design @ np.linalg.lstsq(design, x.T.astype(complex), rcond=None)[0] for x in (first, second)]
    assert abs(np.vdot(*rest)) < 0.05 * np.linalg.norm(rest[0]) * np.linalg.norm(rest[1])
