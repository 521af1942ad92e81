"""Delay and Doppler between two recordings, in Python and at the command line."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
from click.testing import CliRunner

import soopnav_cpp as sn
from soopnav_cpp import dsp, io
from soopnav_cpp.cli import caf as work
from soopnav_cpp.cli.app import cli

pytestmark = pytest.mark.unit

Iq = npt.NDArray[np.complex64]
RATE = 125e3
VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "nav" / "crlb_stein.json"


def pair(
    tdoa_s: float = 6e-6,
    fdoa_hz: float = 800.0,
    *,
    rate: float = RATE,
    seed: int = 1,
    snr_db: float = 20.0,
    lead_s: float = 1e-3,
    center_hz: tuple[float, float] = (0.0, 0.0),
) -> tuple[Iq, Iq]:
    """A burst of 20.32 ms in two recordings tuned to offsets from it, each with its noise."""
    burst = sn.iridium.make_burst(sn.iridium.BurstKind.LONG, seed=seed, duration_s=20.32e-3)
    rng = np.random.default_rng(seed)
    n = round((20.32e-3 + 2.0 * lead_s) * rate)
    sides = []
    for delay, shift in ((tdoa_s, fdoa_hz - center_hz[0]), (0.0, -center_hz[1])):
        clean = burst.render(n, rate, delay_s=lead_s + delay, doppler_hz=shift)
        sigma = math.sqrt(0.5 * rate / 25e3 * 10.0 ** (-0.1 * snr_db))
        noise = sigma * rng.normal(size=(2, n))
        sides.append((clean + noise[0] + 1j * noise[1]).astype(np.complex64))
    return sides[0], sides[1]


def test_delay_and_doppler_with_their_signs():
    a, b = pair()
    found = dsp.cross_ambiguity(a, b, RATE, max_delay_s=20e-6, max_doppler_hz=40e3, bandwidth_hz=35e3)
    assert found.detected
    assert not found.identical
    assert abs(found.tdoa_s - 6e-6) < 5.0 * found.sigma_tdoa_s
    assert abs(found.fdoa_hz - 800.0) < 5.0 * found.sigma_fdoa_hz
    assert found.snr_a_db == pytest.approx(20.0, abs=2.0)
    np.testing.assert_allclose(np.diag(found.covariance), [found.sigma_tdoa_s**2, found.sigma_fdoa_hz**2])
    swapped = dsp.cross_ambiguity(b, a, RATE, bandwidth_hz=35e3)
    assert swapped.tdoa_s == pytest.approx(-found.tdoa_s, abs=0.3 * found.sigma_tdoa_s)
    assert swapped.fdoa_hz == pytest.approx(-found.fdoa_hz, abs=0.3 * found.sigma_fdoa_hz)
    assert "TDOA" in repr(found)
    assert "µs" in repr(found)
    with pytest.raises(ValueError, match="read-only"):
        found.covariance[0, 0] = 0.0


def test_agrees_with_a_plain_search_of_the_ambiguity_function():
    a, b = pair(3.1e-6, 212.0, snr_db=30.0)
    found = dsp.cross_ambiguity(a, b, RATE, bandwidth_hz=35e3, max_doppler_hz=500.0)
    n, t = len(a), np.arange(len(a)) / RATE
    up = 64  # lags of 125 ns, the spectrum being zero-padded
    best: tuple[float, float, float] = (0.0, 0.0, 0.0)
    for doppler in np.arange(204.0, 220.0, 0.5):
        cross = np.fft.fft(a * np.exp(-2j * np.pi * doppler * t)) * np.conj(np.fft.fft(b))
        cross[np.abs(np.fft.fftfreq(n, 1.0 / RATE)) > 18e3] = 0.0
        half = n // 2
        padded = np.concatenate([cross[:half], np.zeros((up - 1) * n), cross[half:]])
        lags = np.abs(np.fft.ifft(padded)[: 20 * up])
        k = int(np.argmax(lags))
        best = max(best, (float(lags[k]), k / (up * RATE), float(doppler)))
    assert found.tdoa_s == pytest.approx(best[1], abs=130e-9)
    assert found.fdoa_hz == pytest.approx(best[2], abs=0.6)


@pytest.mark.skipif(not VECTORS.exists(), reason="../shared is not there")
def test_stein_bound_of_the_shared_vectors():
    cases = json.loads(VECTORS.read_text())["cases"]
    assert len(cases) == 30
    for case in cases:
        bound = dsp.tdoa_fdoa_crlb(
            case["B"],
            case["T"],
            10.0 * math.log10(case["snr1"]),
            10.0 * math.log10(case["snr2"]),
            shape=case["shape"],
        )
        assert bound.sigma_tdoa_s == pytest.approx(case["sigma_tdoa_s"], rel=1e-6)
        assert bound.sigma_fdoa_hz == pytest.approx(case["sigma_fdoa_hz"], rel=1e-6)


def test_stochastic_bound_against_its_integral():
    g = 10.0**-0.5
    f = np.linspace(-17.5e3, 17.5e3, 200_001)
    x = np.clip((np.abs(f) - 7.5e3) / 10e3, 0.0, 1.0)
    s = 0.5 * (1.0 + np.cos(np.pi * x))
    information = 2.0 * 0.09 * np.trapezoid((2.0 * np.pi * f) ** 2 * g * g * s * s / (1.0 + 2.0 * g * s), f)
    bound = dsp.tdoa_fdoa_crlb(25e3, 0.09, -5.0, kind="stochastic")
    assert bound.sigma_tdoa_s == pytest.approx(information**-0.5, rel=1e-4)
    assert bound.sigma_tdoa_s > dsp.tdoa_fdoa_crlb(25e3, 0.09, -5.0).sigma_tdoa_s


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"max_delay_s": -1.0}, "max_delay_s"),
        ({"max_doppler_hz": math.nan}, "max_doppler_hz"),
        ({"bandwidth_hz": 1e9}, "bandwidth_hz"),
        ({"prefilter": "sharp"}, "prefilter"),
        ({"prefilter": "rrc"}, "symbol_rate_hz"),
        ({"false_alarm": 0.9}, "false_alarm"),
    ],
)
def test_bad_options_are_named(change, name):
    a, b = pair()
    with pytest.raises(ValueError, match=f"^{name}"):
        dsp.cross_ambiguity(a, b, RATE, **change)


def test_bad_recordings():
    a, b = pair()
    with pytest.raises(ValueError, match=r"^a: no samples"):
        dsp.cross_ambiguity(a[:0], b[:0], RATE)
    with pytest.raises(ValueError, match=r"^b: 100 samples, a has 200"):
        dsp.cross_ambiguity(a[:200], b[:100], RATE)
    with pytest.raises(ValueError, match=r"^b: expected complex64"):
        dsp.cross_ambiguity(a, b.astype(np.complex128), RATE)
    with pytest.raises(ValueError, match=r"^a: expected"):
        dsp.cross_ambiguity(a[None], b[None], RATE)
    with pytest.raises(ValueError, match=r"^kind"):
        dsp.tdoa_fdoa_crlb(25e3, 1.0, 0.0, kind="other")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^shape"):
        dsp.tdoa_fdoa_crlb(25e3, 1.0, 0.0, shape="other")  # type: ignore[arg-type]
    broken = a.copy()
    broken[7] = np.nan
    assert dsp.cross_ambiguity(broken, b, RATE).status == dsp.AmbiguityStatus.NOT_FINITE
    assert dsp.cross_ambiguity(np.zeros_like(a), b, RATE).status == dsp.AmbiguityStatus.NO_POWER
    assert dsp.cross_ambiguity(a[:40], b[:40], 1e6, max_delay_s=1e-6).status == dsp.AmbiguityStatus.TOO_SHORT
    assert dsp.cross_ambiguity(a, a, RATE).identical


def test_threads_share_a_plan():
    pairs = [pair(1e-6 * k, 30.0 * k, seed=k + 1) for k in range(8)]
    alone = [dsp.cross_ambiguity(a, b, RATE, bandwidth_hz=35e3) for a, b in pairs]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda ab: dsp.cross_ambiguity(*ab, RATE, bandwidth_hz=35e3), pairs))
    assert [r.tdoa_s for r in together] == [r.tdoa_s for r in alone]


def test_surface_is_largest_at_the_answer():
    a, b = pair()
    surface = dsp.ambiguity_surface(a, b, RATE, bandwidth_hz=35e3)
    i, k = np.unravel_index(int(np.argmax(surface.power)), surface.power.shape)
    assert surface.delays_s[i] == pytest.approx(6e-6, abs=2.5e-6)
    assert surface.doppler_hz[k] == pytest.approx(800.0, abs=4.0)
    assert surface.power.max() <= 1.0


# ---- soopnav caf


def write(path: Path, iq: Iq, rate: float = RATE, **kwargs: object) -> Path:
    return io.write_iq(path, iq, rate, **kwargs)  # type: ignore[arg-type]


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["caf", *map(str, arguments)])
    return result.exit_code, result.output


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, Path]:
    a, b = pair()
    kwargs = {"center_frequency_hz": 1626.27e6, "datetime_utc": "2014-08-27T10:00:00.000000Z"}
    return write(tmp_path / "car", a, **kwargs), write(tmp_path / "roof", b, **kwargs)


def test_caf_says_which_is_later_and_higher(recorded, tmp_path):
    a, b = recorded
    picture = tmp_path / "caf.png"
    code, said = run(a, b, "--plot", picture)
    assert code == 0, said
    assert "car.sigmf-meta is later than roof.sigmf-meta by 6" in said or "by 5" in said
    assert "car.sigmf-meta is higher than roof.sigmf-meta by 80" in said or "by 79" in said
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, said = run(b, a, "--json")
    answer = json.loads(said)
    assert answer["status"] == "ok"
    assert answer["tdoa_s"] == pytest.approx(-6e-6, abs=5.0 * answer["sigma_tdoa_s"])
    assert answer["fdoa_hz"] == pytest.approx(-800.0, abs=5.0 * answer["sigma_fdoa_hz"])


def test_caf_uses_starts_rates_and_centre_frequencies(tmp_path):
    # b is sampled twice as fast, starts 400.5 us earlier, and is tuned 3 kHz higher.
    burst = sn.iridium.make_burst(sn.iridium.BurstKind.LONG, seed=4, duration_s=20.32e-3)
    early = 400.5e-6
    a = burst.render(3000, RATE, delay_s=1e-3 + 6e-6, doppler_hz=800.0)
    b = burst.render(6200, 2.0 * RATE, delay_s=1e-3 + early, doppler_hz=-3000.0)
    rng = np.random.default_rng(4)
    a, b = ((x + 0.05 * (rng.normal(size=x.size) + 1j * rng.normal(size=x.size))).astype(np.complex64) for x in (a, b))
    first = write(tmp_path / "a", a, center_frequency_hz=1626e6, datetime_utc="2014-08-27T10:00:00.4000005Z")
    second = write(
        tmp_path / "b", b, 2.0 * RATE, center_frequency_hz=1626.003e6, datetime_utc="2014-08-27T10:00:00.3996Z"
    )
    code, said = run(first, second, "--json")
    assert code == 0, said
    answer = json.loads(said)
    assert answer["tdoa_s"] == pytest.approx(6e-6, abs=5.0 * answer["sigma_tdoa_s"])
    assert answer["fdoa_hz"] == pytest.approx(800.0, abs=5.0 * answer["sigma_fdoa_hz"])
    assert any("resampled" in note for note in answer["notes"])


@pytest.mark.parametrize("rate_b", [RATE, 2.0 * RATE])
def test_caf_takes_no_stretch_out_that_only_tuning_makes(tmp_path, rate_b):
    # A second of symbols, 100 kHz between the centres, 800 Hz of Doppler: 0.5 us of true stretch, 61 us of a false one.
    burst = sn.iridium.make_burst(sn.iridium.BurstKind.LONG, seed=4, duration_s=1.0)
    rng = np.random.default_rng(4)
    a, b = (
        (x + 0.3 * (rng.normal(size=x.size) + 1j * rng.normal(size=x.size))).astype(np.complex64)
        for x in (
            burst.render(round(1.01 * RATE), RATE, delay_s=2e-3 + 6e-6, doppler_hz=-49.2e3),
            burst.render(round(1.01 * rate_b), rate_b, delay_s=2e-3, doppler_hz=50e3),
        )
    )
    first = write(tmp_path / "a", a, center_frequency_hz=1626.1e6)
    second = write(tmp_path / "b", b, rate_b, center_frequency_hz=1626e6)
    for one, other, sign in ((first, second, 1.0), (second, first, -1.0)):
        found = work.answer(
            (one, other),
            max_delay_s=20e-6,
            max_doppler_hz=3e3,
            bandwidth_hz=0.0,
            start_s=0.0,
            duration_s=None,
            step=lambda *_, **__: None,
        )
        assert found.result.detected
        assert found.result.tdoa_rate == pytest.approx(-sign * 800.0 / 1626e6, abs=1e-9)
        assert found.fdoa_hz == pytest.approx(sign * 800.0, abs=0.05)
        assert found.tdoa_s == pytest.approx(sign * 6e-6, abs=1e-6)  # the burst itself was made without a stretch
        assert found.result.duration_s > 0.9
        assert any("was moved by" in note for note in found.notes)


def test_caf_shows_two_figures_of_a_small_sigma(recorded):
    paths = recorded
    found = work.answer(
        paths,
        max_delay_s=20e-6,
        max_doppler_hz=3e3,
        bandwidth_hz=0.0,
        start_s=0.0,
        duration_s=None,
        step=lambda *_, **__: None,
    )
    for sigma, shown in (
        (0.572, "± 0.572 Hz"),
        (0.0123, "± 0.012 Hz"),
        (2.04e-5, "± 0.000020 Hz"),
        (0.0, "± 0.000 Hz"),
    ):
        small = dataclasses.replace(found, result=dataclasses.replace(found.result, sigma_fdoa_hz=sigma))
        assert shown in "\n".join(work.sentences(small))


def test_caf_refuses_what_cannot_be_compared(recorded, tmp_path):
    a, _ = recorded
    iq = pair()[1]
    kwargs = {"center_frequency_hz": 1626.27e6}
    later = write(tmp_path / "later", iq, datetime_utc="2014-08-27T10:00:05Z", **kwargs)
    code, said = run(a, later)
    assert code == 2
    assert "do not overlap in time" in said
    assert "car.sigmf-meta ends" in said
    away = write(tmp_path / "away", iq, center_frequency_hz=1620e6, datetime_utc="2014-08-27T10:00:00Z")
    code, said = run(a, away)
    assert code == 2
    assert "bands do not overlap" in said
    empty = write(tmp_path / "empty", iq, datetime_utc="2014-08-27T10:00:00Z", **kwargs)
    empty.with_suffix(".sigmf-data").write_bytes(b"")
    code, said = run(empty, a)
    assert code == 2
    assert "empty.sigmf-data" in said
    undated = write(tmp_path / "undated", iq)
    code, said = run(a, undated)
    assert code == 0
    assert "start time is missing" in said
    assert "centre frequency is missing" in said
    odd = write(tmp_path / "odd", iq, datetime_utc="2014-08-27T10:00:00Z", **kwargs)
    odd.write_text(odd.read_text().replace("2014-08-27T10:00:00Z", "yesterday"))
    code, said = run(a, odd)
    assert code == 2
    assert "odd.sigmf-meta" in said
    assert run(a, a, "--start", "9")[0] == 2
    for option, value in (
        ("--duration", "0"), ("--max-doppler", "inf"), ("--max-delay", "nan"), ("--bandwidth", "inf"),
    ):  # fmt: skip
        code, said = run(a, a, option, value)
        assert (code, said.startswith(option)) == (2, True)
    assert "less than one sample" in run(a, a, "--duration", "1e-9")[1]
    assert run(a, a, "--plot", tmp_path / "x.jpg")[0] == 2


def test_caf_flags_identical_recordings_tones_and_noise(recorded, tmp_path):
    a, _ = recorded
    code, said = run(a, a)
    assert code == 0
    assert "same samples" in said
    assert json.loads(run(a, a, "--json")[1])["identical"] is True
    rng = np.random.default_rng(5)
    t = np.arange(4000) / RATE
    noise = [(rng.normal(size=4000) + 1j * rng.normal(size=4000)) * 0.1 for _ in range(2)]
    tones = [(np.exp(2j * np.pi * f * t) + n).astype(np.complex64) for f, n in zip((4e3, 4.2e3), noise, strict=True)]
    code, said = run(write(tmp_path / "t1", tones[0]), write(tmp_path / "t2", tones[1]))
    assert code == 0
    assert "share a tone" in said
    quiet = [write(tmp_path / f"n{i}", n.astype(np.complex64)) for i, n in enumerate(noise)]
    code, said = run(*quiet)
    assert code == 0
    assert "no common signal" in said


def test_band_limited_noise_is_measured_too():
    # Not symbols at all: a strip of noise that fills 60 kHz of 125.
    rng = np.random.default_rng(6)
    n, delay = 4096, 2.4e-6
    spectrum = (rng.normal(size=n) + 1j * rng.normal(size=n)) * (np.abs(np.fft.fftfreq(n, 1.0 / RATE)) < 30e3)
    turn = np.exp(-2j * np.pi * np.fft.fftfreq(n, 1.0 / RATE) * delay)
    window = scipy.signal.windows.tukey(n, 0.02)
    a, b = (
        (window * np.fft.ifft(x) + 1e-3 * (rng.normal(size=n) + 1j * rng.normal(size=n))).astype(np.complex64)
        for x in (spectrum * turn, spectrum)
    )
    found = dsp.cross_ambiguity(a, b, RATE, max_doppler_hz=1e3)
    assert found.detected
    assert found.tdoa_s == pytest.approx(delay, abs=max(5.0 * found.sigma_tdoa_s, 3e-8))
