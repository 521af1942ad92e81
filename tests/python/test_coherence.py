"""Coherence of phases, what it is worth, and the detection laws."""

import math

import numpy as np
import pytest
from scipy import stats

import soopnav_cpp as sn
from soopnav_cpp.clock import (
    TwoState,
    coherence,
    coherence_time,
    expected_coherence,
    mean_squared_coherence,
    predetection_snr_db,
    required_cn0_dbhz,
)

L1_HZ = 1575.42e6
NAN, INF = np.nan, np.inf


def direct(phase, samples):
    return np.array([abs(np.exp(2j * np.pi * phase[i : i + samples]).mean()) for i in range(len(phase) - samples + 1)])


@pytest.mark.law
def test_coherence_is_equation_15():
    rng = np.random.default_rng(1)
    phase = 1e4 + np.cumsum(rng.normal(0.0, 0.05, 300))
    np.testing.assert_allclose(coherence(phase, 0.1, 2.0, detrend=False), direct(phase, 20), atol=1e-12)
    line = np.polynomial.Polynomial.fit(np.arange(300), phase, 1)(np.arange(300))
    np.testing.assert_allclose(coherence(phase, 0.1, 2.0), direct(phase - line, 20), atol=1e-9)
    # A constant frequency and a constant phase are taken out of the record, not of the window.
    moved = phase + 7.3 + 0.31 * np.arange(300)
    np.testing.assert_allclose(coherence(moved, 0.1, 2.0), coherence(phase, 0.1, 2.0), atol=1e-9)
    assert coherence(np.zeros(5), 1.0, 5.0).tolist() == [1.0]
    assert len(coherence(np.zeros(5), 1.0, 6.0)) == 0
    half = np.array([0.0, 0.5] * 10)
    np.testing.assert_allclose(coherence(half, 1.0, 2.0, detrend=False), 0.0, atol=1e-15)


@pytest.mark.unit
def test_gaps_are_left_out():
    phase = np.cumsum(np.random.default_rng(2).normal(0.0, 0.02, 200))
    phase[70] = NAN
    each = coherence(phase, 1.0, 10.0)
    assert np.isnan(each[61:71]).all()
    assert np.isfinite(each[:61]).all()
    assert np.isfinite(each[71:]).all()
    got = mean_squared_coherence(phase, 1.0, [10.0, 150.0])
    assert got.tau_s.tolist() == [10.0]  # no whole window of 150
    assert got.count.tolist() == [181]
    np.testing.assert_allclose(got.mean_squared[0], np.nanmean(each**2))
    np.testing.assert_allclose(got.least[0], np.nanmin(each**2))
    assert got.at(10.0) == got.mean_squared[0]
    with pytest.raises(ValueError, match="none of the times"):
        got.at(11.0)


@pytest.mark.unit
def test_refusals():
    with pytest.raises(ValueError, match="infinite"):
        mean_squared_coherence([0.0, INF], 1.0)
    with pytest.raises(ValueError, match="dt_s"):
        mean_squared_coherence([0.0, 1.0], 0.0)
    with pytest.raises(ValueError, match="dt_s"):
        coherence([0.0, 1.0], NAN, 1.0)
    with pytest.raises(ValueError, match="multiple"):
        coherence([0.0, 1.0], 1.0, 1.5)
    with pytest.raises(ValueError, match="confidence"):
        mean_squared_coherence([0.0, 1.0], 1.0, confidence=1.0)
    with pytest.raises(ValueError, match="shape"):
        mean_squared_coherence(np.zeros((2, 2, 2)), 1.0)
    with pytest.raises(ValueError, match=r"tau_s\[1\]"):
        coherence_time([1.0, 1.0], [1.0, 0.9])
    with pytest.raises(ValueError, match="mean_squared"):
        coherence_time([1.0, 2.0], [1.0, NAN])
    with pytest.raises(ValueError, match="mean_squared"):
        required_cn0_dbhz(100.0, 0.0)
    with pytest.raises(ValueError, match="tau_s"):
        required_cn0_dbhz(0.0, 1.0)
    with pytest.raises(ValueError, match="h0"):
        expected_coherence(-1.0, 0.0, 1.0, carrier_hz=L1_HZ)
    with pytest.raises(ValueError, match="carrier_hz"):
        expected_coherence(1e-20, 0.0, 1.0, carrier_hz=0.0)


@pytest.mark.crosscheck
def test_expected_of_white_frequency_noise_has_a_closed_form():
    tau = np.logspace(-3, 4, 29)
    h0 = 3e-23
    a = np.pi**2 * L1_HZ**2 * h0 * tau
    closed = 2.0 * (a + np.expm1(-a)) / a**2
    np.testing.assert_allclose(expected_coherence(h0, 0.0, tau, carrier_hz=L1_HZ)[10:], closed[10:], rtol=1e-7)
    # The integral, asked of a walk too small to matter.
    np.testing.assert_allclose(
        expected_coherence(h0, 1e-45, tau, carrier_hz=L1_HZ),
        expected_coherence(h0, 0.0, tau, carrier_hz=L1_HZ),
        rtol=1e-8,
    )


@pytest.mark.crosscheck
def test_expected_is_the_double_integral():
    h0, h2, tau, sigma = 2e-22, 1e-24, 15.0, 1e-11
    k = 2.0 * np.pi**2 * L1_HZ**2
    t = (np.arange(1500) + 0.5) * tau / 1500
    early = np.minimum(t[:, None], t[None, :])
    s = np.abs(t[:, None] - t[None, :])
    variance = 0.5 * h0 * s + 2 * np.pi**2 * h2 * (s**3 / 3 + s**2 * early) + sigma**2 * s**2
    got = expected_coherence(h0, h2, tau, carrier_hz=L1_HZ, drift_sigma=sigma)
    np.testing.assert_allclose(got, np.exp(-k * variance).mean(), rtol=2e-4)


@pytest.mark.consistency
def test_expected_against_clocks():
    clock = TwoState(1e-22, 1e-24)
    c2 = [
        coherence(L1_HZ * clock.simulate(0.05, 400, seed=7, stream=i).bias_s, 0.05, 20.0, detrend=False)[0] ** 2
        for i in range(500)
    ]
    expected = float(expected_coherence(clock.h0, clock.h_minus_2, 20.0, carrier_hz=L1_HZ))
    assert abs(np.mean(c2) - expected) < 4.5 * np.std(c2) / math.sqrt(500)
    assert expected < 0.75  # and a clock without its walk is well outside
    assert float(expected_coherence(clock.h0, 0.0, 20.0, carrier_hz=L1_HZ)) > expected + 0.2


@pytest.mark.consistency
@pytest.mark.parametrize("h", [(1e-24, 1e-26), (1e-20, 1e-22)])
def test_band_of_an_ensemble_covers(h):
    """Ensembles of 12 records: the 95 % band holds the expectation in most of 60 of them, at short and long times."""
    clock = TwoState(*h)
    taus = [1.0, 10.0, 40.0]
    records = np.array([L1_HZ * clock.simulate(0.2, 500, seed=11, stream=i).bias_s for i in range(720)])
    truth = mean_squared_coherence(records, 0.2, taus).mean_squared
    inside = np.zeros(3)
    for i in range(0, 720, 12):
        got = mean_squared_coherence(records[i : i + 12], 0.2, taus)
        inside += (got.lower <= truth) & (truth <= got.upper)
        assert (got.lower <= got.mean_squared).all()
        assert (got.mean_squared <= got.upper).all()
    # 60 at 0.9 and better leave 44 with probability 1e-4; half as wide a band has 0.67 and less.
    assert (inside >= 44).all()


@pytest.mark.unit
def test_coherence_time():
    assert coherence_time([1.0, 2.0, 4.0], [0.9, 0.6, 0.2]) == (2.5, False)
    assert coherence_time([1.0, 2.0], [0.9, 0.6]) == (2.0, True)
    assert coherence_time([1.0, 2.0], [0.4, 0.6]) == (1.0, False)
    got = mean_squared_coherence(np.zeros(50), 0.1)
    assert got.time().beyond
    assert got.time().tau_s == pytest.approx(5.0, rel=0.25)


@pytest.mark.unit
def test_sensitivity_is_equation_16():
    assert required_cn0_dbhz(100.0, 0.8) == pytest.approx(-8.03, abs=0.01)  # pesyna section V-D
    assert predetection_snr_db(required_cn0_dbhz(7.0, 0.3, 12.0), 7.0, 0.3) == pytest.approx(12.0)


@pytest.mark.crosscheck
def test_marcum_q_against_scipy():
    rng = np.random.default_rng(3)
    m = rng.integers(1, 60, 3000)
    a, b = rng.uniform(0.0, 30.0, 3000), rng.uniform(0.0, 40.0, 3000)
    upper, lower = stats.ncx2.sf(b**2, 2 * m, a**2), stats.ncx2.cdf(b**2, 2 * m, a**2)
    seen = upper > 1e-250
    np.testing.assert_allclose(sn.dsp.marcum_q(m, a, b)[seen], upper[seen], rtol=1e-10)
    seen = lower > 1e-40  # below, scipy's own tail is cut off
    np.testing.assert_allclose(sn.dsp.marcum_q(m, a, b, complement=True)[seen], lower[seen], rtol=1e-9)
    np.testing.assert_allclose(sn.dsp.marcum_q(m, a, b) + sn.dsp.marcum_q(m, a, b, complement=True), 1.0, rtol=1e-14)


@pytest.mark.crosscheck
def test_marcum_q_lower_tail_by_its_series():
    m, a, b = 34, 21.852869, 3.730055
    x, y = b * b / 2, a * a / 2
    terms = [
        math.exp(k * math.log(y) - y - math.lgamma(k + 1) + j * math.log(x) - x - math.lgamma(j + 1))
        for k in range(400)
        for j in range(m + k, m + k + 80)
    ]
    assert sn.dsp.marcum_q(m, a, b, complement=True) == pytest.approx(math.fsum(terms), rel=1e-11)


@pytest.mark.law
def test_marcum_q_far_arguments_and_order():
    # Far from the origin it is the normal law, and the step of the order is a positive term.
    assert sn.dsp.marcum_q(1, 2e4, 2e4) == pytest.approx(0.5, abs=2e-5)
    q = sn.dsp.marcum_q(np.arange(1, 50), 3.0, 7.0)
    assert (np.diff(q) > 0).all()
    assert sn.dsp.marcum_q(3, 0.0, 2.0) == pytest.approx(stats.gamma.sf(2.0, 3))
    assert np.isnan(sn.dsp.marcum_q(0, 1.0, 1.0))
    assert np.isnan(sn.dsp.marcum_q(1, [NAN, -1.0, 1e6], 1.0)).all()
    assert sn.dsp.marcum_q(2, 1.0, np.ones((2, 3))).shape == (2, 3)
    with pytest.raises(ValueError, match="whole"):
        sn.dsp.marcum_q(1.5, 1.0, 1.0)


@pytest.mark.crosscheck
def test_thresholds():
    for m in (1, 7, 200):
        for p in (0.3, 1e-3, 1e-12):
            assert sn.dsp.detection_threshold(m, p) == pytest.approx(stats.gamma.isf(p, m), rel=1e-10)
            assert sn.dsp.false_alarm_probability(m, sn.dsp.detection_threshold(m, p)) == pytest.approx(p, rel=1e-9)
    assert sn.dsp.cell_false_alarm(0.01, 105) == pytest.approx(1 - 0.99 ** (1 / 105))
    assert sn.dsp.detection_probability(1, 0.0, 3.0) == pytest.approx(math.exp(-3.0))
    for call in (
        lambda: sn.dsp.detection_threshold(0, 0.1),
        lambda: sn.dsp.detection_threshold(1, 0.0),
        lambda: sn.dsp.false_alarm_probability(1, -1.0),
        lambda: sn.dsp.detection_probability(1, NAN, 1.0),
        lambda: sn.dsp.cell_false_alarm(1.0, 10),
    ):
        with pytest.raises(ValueError, match="expected"):
            call()


@pytest.mark.consistency
def test_correlated_cells_alarm_no_more_often():
    """Four times oversampled spectra: of all searches no more than asked find something (Royen's inequality)."""
    rng = np.random.default_rng(5)
    noise = (rng.normal(size=(4000, 16)) + 1j * rng.normal(size=(4000, 16))) / math.sqrt(2.0)
    spectrum = np.fft.fft(noise, 64, axis=1) / 4.0
    total = 0.2
    level = sn.dsp.detection_threshold(1, sn.dsp.cell_false_alarm(total, 64))
    share = float((np.abs(spectrum) ** 2 > level).any(axis=1).mean())
    assert share < total
    independent = sn.dsp.detection_threshold(1, sn.dsp.cell_false_alarm(total, 16))
    found = float((np.abs(spectrum[:, ::4]) ** 2 > independent).any(axis=1).mean())
    assert found == pytest.approx(total, abs=4.0 * math.sqrt(total * (1 - total) / 4000))


def test_no_run_is_refused_by_its_shape():
    with pytest.raises(ValueError, match=r"phase_cycles: at least one run expected, got shape \(0, 5\)"):
        mean_squared_coherence(np.zeros((0, 5)), 0.1)
