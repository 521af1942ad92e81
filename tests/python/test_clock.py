"""Clocks from Python: oscillators, simulation, deviations against published ones, fits."""

import importlib.util
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.clock import TwoState, allan_deviation, fit

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
VECTORS = SHARED / "vectors" / "nav" / "allan_nbs14.json"
CLOCKS = SHARED / "captures" / "clocks"

PRESETS = ("tcxo", "ocxo", "csac", "gps", "basestation", "crosby")
KINDS = {
    "adev": "allan",
    "oadev": "overlapping",
    "mdev": "modified",
    "tdev": "time",
    "hdev": "hadamard",
    "ohdev": "overlapping_hadamard",
}
NAN, INF = np.nan, np.inf

there = pytest.mark.skipif(not VECTORS.exists(), reason="the published deviations in ../shared are not there")
recorded = pytest.mark.skipif(not CLOCKS.exists(), reason="the records in ../shared are not there")


def nbs14():
    n, out = 1234567890, []
    for _ in range(1000):
        out.append(n / 2147483647)
        n = 16807 * n % 2147483647
    return np.array(out)


@there
@pytest.mark.crosscheck
@pytest.mark.parametrize("short", KINDS)
def test_published_deviations(short):
    """SP 1065 prints seven digits; the allantools column has them all."""
    table = json.loads(VECTORS.read_text())
    got = allan_deviation(nbs14(), 1.0, kind=KINDS[short], taus=table["taus"], frequency=True)
    np.testing.assert_allclose(got.deviation, table["published"][short], rtol=1e-6)
    np.testing.assert_allclose(got.deviation, table["allantools"][short], rtol=1e-11)
    ten = table["ten_point"]
    small = allan_deviation(ten["freq"], 1.0, kind=KINDS[short], taus=ten["taus"], frequency=True)
    np.testing.assert_allclose(small.deviation, ten[short], rtol=5e-7)
    if short == "oadev":
        octave = allan_deviation(nbs14(), 1.0, frequency=True)
        np.testing.assert_allclose(octave.deviation, table["oadev_octave"]["dev"], rtol=1e-11)
        assert octave.count.tolist() == table["oadev_octave"]["n"]


@recorded
@pytest.mark.offair
@pytest.mark.crosscheck
def test_stable32_of_an_oscillator():
    """Every averaging time of the OCXO's record; Stable32 prints five digits."""
    rows = np.loadtxt(CLOCKS / "stable32_oadev_alltau.txt", comments="#")
    frequency = np.loadtxt(CLOCKS / "ocxo_frequency.txt") / 10e6 - 1.0
    got = allan_deviation(frequency, 1.0, taus=rows[:, 1], frequency=True)
    np.testing.assert_array_equal(got.count, rows[:, 2])
    np.testing.assert_allclose(got.deviation, rows[:, 5], rtol=5.1e-5)
    assert len(got) == 273


@recorded
@pytest.mark.offair
@pytest.mark.crosscheck
def test_phase_file_is_the_suite_of_sp1065():
    """PHASE.DAT are the phases of the thousand frequencies, less their mean: the same deviations."""
    phase = np.loadtxt(CLOCKS / "PHASE.DAT")
    for kind in KINDS.values():
        by_phase = allan_deviation(phase, 1.0, kind=kind)
        by_frequency = allan_deviation(nbs14(), 1.0, kind=kind, frequency=True)
        np.testing.assert_allclose(by_phase.deviation, by_frequency.deviation, rtol=1e-8)


@pytest.mark.law
def test_deviations_by_numpy():
    x = np.cumsum(np.random.default_rng(2).standard_normal(300))
    m = 5
    second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
    got = allan_deviation(x, 2.0, taus=[10.0])
    assert got.deviation[0] == pytest.approx(np.sqrt(np.mean(second**2) / 2.0) / 10.0, rel=1e-12)
    assert got.count[0] == len(second)
    assert got.lower[0] < got.deviation[0] < got.upper[0]
    assert 1.0 < got.dof[0] < len(second)
    wide = allan_deviation(x, 2.0, taus=[10.0], confidence=0.99)
    assert wide.lower[0] < got.lower[0] < got.upper[0] < wide.upper[0]
    assert allan_deviation(x, 2.0, taus="decade").tau_s.tolist() == [2.0, 4.0, 8.0, 20.0, 40.0, 80.0, 200.0]
    assert len(allan_deviation(x, 2.0, taus="all")) == 149
    assert len(allan_deviation(x, 2.0, taus=[1000.0])) == 0
    named = allan_deviation(x, 2.0, taus=[10.0], noise="flicker_frequency")
    assert named.alpha[0] == -1
    assert named.deviation[0] == got.deviation[0]
    assert "overlapping" in repr(got)


@pytest.mark.unit
def test_gaps():
    x = np.cumsum(np.random.default_rng(3).standard_normal(1000))
    x[[10, 400, 401]] = NAN
    got = allan_deviation(x, 1.0)
    assert np.isfinite(got.deviation).all()
    assert got.count[0] == 1000 - 2 - 3 - 4
    y = np.random.default_rng(4).standard_normal(1000)
    y[500] = NAN
    assert allan_deviation(y, 1.0, frequency=True).count[0] == 499 + 498
    assert len(allan_deviation([NAN] * 10, 1.0)) == 0


@pytest.mark.unit
@pytest.mark.parametrize(
    ("data", "dt_s", "options", "message"),
    [
        (np.zeros(10), 0.0, {}, "dt_s = 0"),
        (np.zeros(10), NAN, {}, "dt_s"),
        ([0.0, INF, 0.0], 1.0, {}, r"phase_s\[1\] is infinite"),
        ([0.0, INF, 0.0], 1.0, {"frequency": True}, r"frequency\[1\] is infinite"),
        (np.zeros((2, 3)), 1.0, {}, "data"),
        (np.zeros(10), 1.0, {"kind": "total"}, "kind: expected one of 'overlapping'|kind: expected one of"),
        (np.zeros(10), 1.0, {"taus": "fifth"}, "taus: expected one of"),
        (np.zeros(10), 2.0, {"taus": [2.0, 3.0]}, r"taus\[1\] = 3"),
        (np.zeros(10), 2.0, {"taus": [0.0]}, r"taus\[0\] = 0"),
        (np.zeros(10), 2.0, {"taus": [NAN]}, r"taus\[0\]"),
        (np.zeros(10), 1.0, {"noise": "brown"}, "noise: expected one of"),
        (np.zeros(10), 1.0, {"confidence": 0.0}, "confidence = 0"),
    ],
)
def test_what_is_no_record(data, dt_s, options, message):
    with pytest.raises(ValueError, match=message):
        allan_deviation(data, dt_s, **options)


@pytest.mark.unit
def test_oscillators():
    tcxo = TwoState.tcxo()
    assert (tcxo.h0, tcxo.h_minus_2) == (1e-20, 1e-22)
    assert TwoState.crosby().noise == pytest.approx((0.036, 0.141))
    back = TwoState.from_noise(*tcxo.noise)
    assert (back.h0 / 1e-20, back.h_minus_2 / 1e-22) == pytest.approx((1.0, 1.0))
    assert pickle.loads(pickle.dumps(tcxo)) == tcxo
    assert TwoState.gps().h_minus_1 > 0.0
    tau = np.array([[0.1, 1.0], [10.0, 100.0]])
    expected = np.sqrt(1e-20 / (2.0 * tau) + 2.0 * np.pi**2 / 3.0 * 1e-22 * tau)
    np.testing.assert_allclose(tcxo.allan_deviation(tau), expected, rtol=1e-12)
    ahead = 3.0 * tcxo.noise.white_frequency_m2ps + 9.0 * tcxo.noise.frequency_walk_m2ps3
    assert tcxo.prediction_variance_m2(3.0) / ahead == pytest.approx(1.0)
    assert tcxo.prediction_variance_m2(2.0, [[1.0, 0.5], [0.5, 4.0]]) == pytest.approx(
        1.0 + 2.0 + 16.0 + tcxo.prediction_variance_m2(2.0)
    )
    for bad in ({"h0": -1.0, "h_minus_2": 0.0}, {"h0": 0.0, "h_minus_2": NAN}):
        with pytest.raises(ValueError, match="must be finite and >= 0"):
            TwoState(**bad)
    with pytest.raises(ValueError, match="h_minus_1 = -1"):
        TwoState(0.0, 0.0, -1.0)
    with pytest.raises(ValueError, match="covariance"):
        tcxo.prediction_variance_m2(1.0, [[1.0, 2.0, 3.0]])


@pytest.mark.unit
def test_filters_take_a_clock():
    clock = TwoState.ocxo()
    model = sn.process.NearlyConstantVelocity(0.5, clock=clock)
    assert model == sn.process.NearlyConstantVelocity(0.5, clock=tuple(clock.noise))
    _, F, Q = model.propagate("position_velocity_clock2", [0.0] * 5 + [2.0], 3.0)
    assert F[4, 5] == 3.0
    assert Q[4, 4] / clock.prediction_variance_m2(3.0) == pytest.approx(1.0)


@pytest.mark.unit
def test_simulation():
    clock = TwoState.tcxo()
    run = clock.simulate(1e-1, 2400, seed=3)
    assert len(run) == 2400
    assert run.t_s[-1] == pytest.approx(239.9)
    assert run.bias_m[0] == run.drift[0] == 0.0
    np.testing.assert_allclose(run.bias_s, run.bias_m / 299792458.0, rtol=1e-15)
    assert not run.bias_m.flags.writeable
    again = clock.simulate(1e-1, 2400, seed=3)
    assert np.array_equal(run.bias_m, again.bias_m)
    assert not np.array_equal(run.bias_m, clock.simulate(1e-1, 2400, seed=3, stream=1).bias_m)
    # A start moves the whole along a line.
    moved = clock.simulate(1e-1, 2400, seed=3, bias_s=1e-6, drift=1e-7)
    np.testing.assert_allclose(moved.bias_s - run.bias_s, 1e-6 + 1e-7 * run.t_s, rtol=1e-6)
    at = clock.simulate_at([0.0, 0.5, 0.5, 60.0], seed=1)
    assert at.bias_m[1] == at.bias_m[2]
    assert repr(run).startswith("ClockSeries(2400 times to 239.9 s")
    assert len(clock.simulate(1.0, 0, seed=1)) == 0
    with pytest.raises(ValueError, match=r"time_s\[2\] = 1"):
        clock.simulate_at([0.0, 2.0, 1.0], seed=1)
    with pytest.raises(ValueError, match="dt_s = -1"):
        clock.simulate(-1.0, 5, seed=1)
    with pytest.raises(ValueError, match="count = -2"):
        clock.simulate(1.0, -2, seed=1)
    with pytest.raises(ValueError, match="bias_m must be finite"):
        clock.simulate(1.0, 5, seed=1, bias_s=NAN)


@pytest.mark.consistency
@pytest.mark.parametrize("name", PRESETS)
def test_coefficients_come_back(name):
    """Within 10 %, which is 14 and 10 deviations; and within 5 of those that the fit states."""
    clock = getattr(TwoState, name)()
    run = clock.simulate(clock.crossover_s, 100_000, seed=21, bias_s=1e-3, drift=1e-9)
    got = fit(run.bias_s, clock.crossover_s)
    assert 0.9 < got.h0 / clock.h0 < 1.1
    assert 0.9 < got.h_minus_2 / clock.h_minus_2 < 1.1
    assert abs(got.h0 - clock.h0) < 5.0 * got.sigma_h0 < 0.1 * clock.h0
    assert abs(got.h_minus_2 - clock.h_minus_2) < 5.0 * got.sigma_h_minus_2 < 0.1 * clock.h_minus_2
    assert -1.0 < got.correlation < 1.0
    assert "h0 = " in repr(got)


@pytest.mark.unit
def test_fits_that_cannot_be():
    with pytest.raises(ValueError, match="straight line"):
        fit(np.arange(20.0), 1.0)
    with pytest.raises(ValueError, match="at least 8 phases expected, got 3"):
        fit([0.0, 1.0, 0.0, NAN], 1.0)
    with pytest.raises(ValueError, match="dt_s"):
        fit(np.random.default_rng(1).standard_normal(20), 0.0)


def load_example():
    spec = importlib.util.spec_from_file_location("allan_example", ROOT / "examples" / "allan.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@recorded
@pytest.mark.offair
@pytest.mark.example
def test_example_on_the_oscillator(tmp_path, capsys):
    example = load_example()
    got, clock = example.analyse(CLOCKS / "ocxo_frequency.txt", 1.0, nominal_hz=10e6, figure=tmp_path / "ocxo.png")
    assert (tmp_path / "ocxo.png").stat().st_size > 10_000
    # Stable32: 7.6106e-11 at 1 s; the oscillator's floor is some 5e-12.
    assert got.deviation[0] / 7.6106e-11 == pytest.approx(1.0, rel=1e-4)
    assert 4.5e-12 < got.deviation.min() < 5.5e-12
    # The counter's noise is phase noise, sigma_y = √3 sigma_x / tau: 76e-12 / √3.
    assert clock.phase_noise_s * np.sqrt(3.0) / 7.61e-11 == pytest.approx(1.0, rel=0.03)
    printed = capsys.readouterr().out
    assert "phase noise 4.4" in printed
    assert "flicker, h-1 = 1.8e-23" in printed


@pytest.mark.unit
def test_example_says_what_is_wrong(tmp_path):
    example = load_example()
    bad = tmp_path / "bad.txt"
    bad.write_text("# a record\n1.0\ntwo\n")
    with pytest.raises(ValueError, match=r"bad\.txt:3: a number expected, got 'two'"):
        example.read(bad)
