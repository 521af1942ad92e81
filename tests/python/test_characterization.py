"""Noise of clocks from phase records: likelihood, bank, smoother, and what a record does not tell."""

import math

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.clock import (
    NoiseBank,
    TwoState,
    characterize,
    error_allan_variance,
    estimate_clocks,
    iterate_noise,
    noise_likelihood,
)
from soopnav_cpp.experiments.pesyna_setup import (
    FROM_BASESTATIONS,
    L1_HZ,
    OTHER,
    STEADY,
    aided_clock_error,
    characterize_sources,
    detrended,
    phase_sigma_cycles,
    record,
    stage_1,
    stage_2,
)

DT, SIGMA = 0.1, 5e-13
NAN, INF = np.nan, np.inf


def phases(clock, n, seed, sigma=SIGMA):
    return clock.simulate(DT, n, seed=seed).bias_s + np.random.default_rng(seed).normal(0.0, sigma, n)


def dense_log_likelihood(y, covariance, mixing, clocks):
    """Density of second differences, which know neither constants nor drifts; their map has determinant one."""
    n, _m = y.shape
    h = np.array([[clock.h0, clock.h_minus_2] for clock in clocks])
    white = mixing @ np.diag(h[:, 0] / 2.0) @ mixing.T
    walk = mixing @ np.diag(2.0 * np.pi**2 * h[:, 1]) @ mixing.T
    lags = (
        2.0 * white * DT + 2.0 / 3.0 * walk * DT**3 + 6.0 * covariance,
        -white * DT + walk * DT**3 / 6.0 - 4.0 * covariance,
        covariance,
    )
    size = n - 2
    S = sum(
        np.kron(np.eye(size, k=k) + (np.eye(size, k=-k) if k else 0.0), lag / SIGMA**2) for k, lag in enumerate(lags)
    )
    d = (y[2:] - 2.0 * y[1:-1] + y[:-2]).ravel() / SIGMA
    log_det = np.linalg.slogdet(S)[1]
    return -0.5 * (d @ np.linalg.solve(S, d) + log_det + len(d) * math.log(2.0 * math.pi)) - len(d) * math.log(SIGMA)


@pytest.mark.crosscheck
def test_likelihood_is_that_of_the_whole_gaussian():
    mixing = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])
    clocks = [TwoState.ocxo(), STEADY, TwoState(3e-24, 2e-25)]
    covariance = SIGMA**2 * np.array([[1.0, 0.3], [0.3, 2.0]])
    rng = np.random.default_rng(5)
    b = np.stack([clock.simulate(DT, 80, seed=5, stream=i).bias_s for i, clock in enumerate(clocks)], axis=1)
    y = b @ mixing.T + rng.normal(size=(80, 2)) @ np.linalg.cholesky(covariance).T + [1e-9, -2e-9]
    got = noise_likelihood(y, DT, covariance, clocks, mixing=mixing)
    assert got.log_likelihood == pytest.approx(dense_log_likelihood(y, covariance, mixing, clocks), abs=1e-4)
    assert got.score.shape == (6,)


@pytest.mark.consistency
def test_information_is_the_covariance_of_the_score():
    """600 scores: a variance is known to 5.8 %, four times that is allowed; the dense trace formula to rounding."""
    clock, n = OTHER, 60
    scores = np.array([noise_likelihood(phases(clock, n, seed), DT, SIGMA, [clock]).score for seed in range(600)])
    information = noise_likelihood(phases(clock, n, 0), DT, SIGMA, [clock]).information
    np.testing.assert_allclose(scores.var(axis=0), np.diag(information), rtol=0.25)
    assert np.all(np.abs(scores.mean(axis=0)) < 4.5 * np.sqrt(np.diag(information) / 600.0))
    size = n - 2
    band = [np.eye(size, k=k) + (np.eye(size, k=-k) if k else 0.0) for k in range(3)]
    white = 0.5 * clock.h0 * DT * (2.0 * band[0] - band[1])
    walk = 2.0 * np.pi**2 * clock.h_minus_2 * DT**3 * (2.0 / 3.0 * band[0] + band[1] / 6.0)
    S = white + walk + SIGMA**2 * (6.0 * band[0] - 4.0 * band[1] + band[2])
    parts = [np.linalg.solve(S, part) for part in (white, walk)]
    expected = [[0.5 * np.trace(a @ b) for b in parts] for a in parts]
    np.testing.assert_allclose(information, expected, rtol=1e-6)


@pytest.mark.consistency
def test_both_starts_find_a_basestation():
    """Errors of ln h in their own standard deviations: 40 of a chi-square of 2 for each, mean 2 and 4.5 sigmas."""
    nees = []
    for seed in range(40):
        z = phases(STEADY, 2400, seed)
        found = [characterize(z, DT, SIGMA, start=[(f * STEADY.h0, f * STEADY.h_minus_2)]) for f in (100.0, 0.01)] + [
            characterize(z, DT, SIGMA)
        ]
        assert max(f.log_likelihood for f in found) - min(f.log_likelihood for f in found) < 0.01
        assert all(f.converged and f.jump_at is None and f.report == () for f in found)
        error = np.log([found[0].h0[0] / STEADY.h0, found[0].h_minus_2[0] / STEADY.h_minus_2])
        nees.append(error @ np.linalg.solve(found[0].covariance_of(), error))
    assert 0.9 < np.mean(nees) < 3.9


def test_what_the_database_gets():
    found = characterize(phases(OTHER, 2400, 7), DT, SIGMA)
    noise, quality = found.noise_record(), found.quality_record(55.0)
    assert noise["h0_s"] == found.h0[0]
    assert noise["h_minus2_per_s"] == found.h_minus_2[0]
    np.testing.assert_array_equal(noise["ln_covariance"], found.ln_covariance)
    assert quality == {"duration_s": pytest.approx(239.9), "cn0_dbhz": 55.0, "nis": found.mean_nis}
    assert found.mean_nis == pytest.approx(1.0, abs=0.15)
    deviation, factor = found.allan_deviation([0.2, 1.0, 100.0])
    np.testing.assert_allclose(deviation, found.clocks[0].allan_deviation([0.2, 1.0, 100.0]))
    assert np.all((factor > 1.0) & (factor < 1.3))
    assert "h0 = " in repr(found)


def test_gaps_are_skipped():
    z = phases(OTHER, 2400, 9)
    whole = characterize(z, DT, SIGMA)
    z[np.random.default_rng(1).random(2400) < 0.2] = NAN
    z[600:800] = NAN
    found = characterize(z, DT, SIGMA)
    assert found.skipped == np.isnan(z).sum()
    assert found.converged
    np.testing.assert_allclose(np.log(found.h0 / whole.h0), 0.0, atol=0.4)


def test_a_jump_is_reported_with_its_epoch():
    z = phases(STEADY, 2400, 11)
    z[1500:] += 0.5 / L1_HZ
    found = characterize(z, DT, SIGMA)
    assert found.jump_at == 1500
    assert "150 s (epoch 1500)" in found.report[0]
    assert "see report" in repr(found)


def test_what_a_short_record_does_not_tell_is_said():
    found = characterize(phases(TwoState(2.6e-22, 4e-26), 600, 13), DT, SIGMA)
    assert found.identifiable.tolist() == [True, False]
    assert "h-2 of clock 0 is not identifiable in 59.9 s" in found.report[0]
    assert found.direction_sigma[0] > found.direction_sigma[1]


def test_only_the_sum_without_satellites():
    tcxo, ocxo = (
        characterize(r.cdma_s, r.dt_s, r.cdma_sigma_s, mixing=FROM_BASESTATIONS, known=[r.receiver, None, None])
        for r in (record(17, "tcxo"), record(17, "ocxo"))
    )
    assert tcxo.only_sum_known
    assert "only the sum of the noise of clocks 1 and 2 is identifiable" in tcxo.report
    assert tcxo.h0.sum() == pytest.approx(STEADY.h0 + OTHER.h0, rel=0.5)
    assert not ocxo.only_sum_known
    assert ocxo.h0[1] > 3.0 * ocxo.h0[0]
    assert tcxo.clocks[0].h0 == TwoState.tcxo().h0


def test_bank_learns_epoch_by_epoch():
    r = record(19, "ocxo")
    likely = characterize(r.cdma_s, r.dt_s, r.cdma_sigma_s, mixing=FROM_BASESTATIONS, known=[r.receiver, None, None])
    bank = NoiseBank.around(likely, r.cdma_sigma_s, mixing=FROM_BASESTATIONS, totals=3, splits=5)
    assert bank.candidates.shape == (225, 3, 2)
    np.testing.assert_allclose(bank.weights, 1.0 / 225.0)
    assert bank.probability_steadier(1, 2) == pytest.approx(0.5)
    assert bank.push(r.cdma_s[:50]) == 50
    assert bank.push(np.full((3, 2), NAN)) == 0
    assert bank.push(r.cdma_s[53]) == 1
    assert bank.push(r.cdma_s[54:]) == len(r.cdma_s) - 54
    assert bank.weights.sum() == pytest.approx(1.0)
    assert bank.probability_steadier(1, 2) > 0.99
    low, high = bank.interval(2, "h0")
    assert low < bank.mean()[2].h0 < high
    assert bank.interval(2, "h0", 0.5)[1] < high
    assert bank.mean()[0].h0 == pytest.approx(r.receiver.h0)
    gaps = r.cdma_s.copy()
    gaps[50:53] = NAN
    best = bank.weights.argmax()
    clocks = [TwoState(*pair) for pair in bank.candidates[best]]
    expected = noise_likelihood(gaps, r.dt_s, r.cdma_sigma_s, clocks, mixing=FROM_BASESTATIONS).log_likelihood
    assert bank.log_likelihoods[best] == pytest.approx(expected, abs=1e-4)


@pytest.mark.crosscheck
def test_smoother_against_the_general_one():
    """The same model through estimation.rts_smooth, prior wide: stage 2, three clocks, all observed."""
    r = record(23, "ocxo", n=150)
    z = L1_HZ * np.column_stack([r.gps_s, r.cdma_s])
    q = np.zeros((6, 6))
    for i, clock in enumerate((r.receiver, *r.sources)):
        f, g = 0.5 * clock.h0 * L1_HZ**2, 2.0 * np.pi**2 * clock.h_minus_2 * L1_HZ**2
        q[i, i], q[i, 3 + i] = f * DT + g * DT**3 / 3.0, g * DT**2 / 2.0
        q[3 + i, i], q[3 + i, 3 + i] = g * DT**2 / 2.0, g * DT
    H = np.hstack([[[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [1.0, 0.0, -1.0]], np.zeros((3, 3))])
    F = np.eye(6) + DT * np.eye(6, k=3)
    R = L1_HZ**2 * np.diag([r.gps_sigma_s, r.cdma_sigma_s, r.cdma_sigma_s]) ** 2
    x, P = np.zeros(6), np.diag([1.0] * 3 + [1.0] * 3)
    means, covariances, predicted = [], [], []
    for k, measured in enumerate(z):
        if k:
            x, P = F @ x, F @ P @ F.T + q
        predicted.append((x, P))
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x, P = x + K @ (measured - H @ x), (np.eye(6) - K @ H) @ P @ (np.eye(6) - K @ H).T + K @ R @ K.T
        means.append(x)
        covariances.append(P)
    smooth, spread = [x], [P]
    for k in range(len(z) - 2, -1, -1):
        G = np.linalg.solve(predicted[k + 1][1], F @ covariances[k]).T
        x = means[k] + G @ (x - predicted[k + 1][0])
        P = covariances[k] + G @ (P - predicted[k + 1][1]) @ G.T
        smooth.insert(0, x)
        spread.insert(0, P)
    got = stage_2(r, r.sources)
    np.testing.assert_allclose(L1_HZ * got.bias_s, np.array(smooth)[:, :3], atol=2e-5)
    np.testing.assert_allclose(L1_HZ * got.drift, np.array(smooth)[:, 3:], atol=2e-4)
    np.testing.assert_allclose(L1_HZ * got.sigma_s, np.sqrt(np.diagonal(spread, axis1=1, axis2=2))[:, :3], rtol=0.01)
    np.testing.assert_allclose(L1_HZ * got.filtered_s[5:], np.array(means)[5:, :3], atol=1e-4)


@pytest.mark.consistency
def test_the_smoothers_error_has_the_allan_variance_it_says():
    """60 records; at 20 steps the mean of so many is known to about 3 %, 12 % is allowed."""
    clock, n, factors = TwoState.ocxo(), 600, [2, 10, 20]
    taus = [DT * m for m in factors]
    seen = []
    for seed in range(60):
        error = (
            estimate_clocks(phases(clock, n, seed), DT, SIGMA, [clock]).bias_s[:, 0]
            - clock.simulate(DT, n, seed=seed).bias_s
        )
        seen.append(sn.clock.allan_deviation(error, DT, taus=taus).deviation ** 2)
    stated = error_allan_variance(n, DT, SIGMA, [clock], factors)
    np.testing.assert_allclose(np.mean(seen, axis=0) / stated, 1.0, atol=0.12)


def test_iteration_collapses_and_keeps_its_history():
    z = phases(STEADY, 2400, 29)
    for analysis in ("increments", "allan_fit"):
        turns = iterate_noise(z, DT, SIGMA, [(100 * STEADY.h0, 100 * STEADY.h_minus_2)], analysis=analysis)
        assert turns.shape == (21, 1, 2)
        assert turns[0, 0, 0] == 100 * STEADY.h0
        assert (turns[-1, 0] / [STEADY.h0, STEADY.h_minus_2]).min() < 0.1


def test_the_demonstrations_world():
    assert phase_sigma_cycles(45.0) == pytest.approx(2.0e-3, rel=0.01)
    assert phase_sigma_cycles(55.0) == pytest.approx(6.3e-4, rel=0.01)
    same = record(31, "tcxo", n=200)
    other = record(32, "ocxo", n=200, source_seed=31)
    np.testing.assert_array_equal(same.sources_s, other.sources_s)
    assert not np.array_equal(same.receiver_s, other.receiver_s)
    np.testing.assert_array_equal(same.receiver_s, record(31, "tcxo", n=200).receiver_s)
    line = 3.0 + 0.2 * np.arange(50)
    np.testing.assert_allclose(detrended(line), 0.0, atol=1e-12)
    error = aided_clock_error(31, "tcxo", characterization="true")
    assert error.shape == (2400,)
    assert 1e-3 < np.abs(error).max() < 1.0
    own = aided_clock_error(31, "tcxo", against="stage_1")
    assert np.abs(own - error).max() < 0.2
    first, second = characterize_sources(record(31))
    assert first.clocks[0].h0 < second.clocks[0].h0
    truth = record(31)
    assert np.abs(L1_HZ * detrended(stage_1(truth).bias_s[:, 0] - truth.receiver_s)).max() < 0.01


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"phase_sigma_s": 0.0}, "never zero"),
        ({"phase_sigma_s": -1.0}, "positive and finite"),
        ({"phase_sigma_s": NAN}, "positive and finite"),
        ({"phase_sigma_s": [[1.0, 2.0], [2.0, 1.0]], "phase_s": np.zeros((20, 2))}, "positive definite"),
        ({"dt_s": 0.0}, "dt_s"),
        ({"phase_s": np.zeros(7)}, "at least 8"),
        ({"phase_s": np.full(100, NAN)}, "at least 8"),
        ({"phase_s": np.array([0.0, INF] + [0.0] * 20)}, "infinite"),
        ({"phase_s": np.array([0.0, 0.0, 0.0, 1e160] + [0.0] * 20)}, r"phase_s\[3\] = 1e\+160"),
        ({"phase_s": np.array([0.0, 0.0, 0.0, 1e300] + [0.0] * 20)}, r"phase_s\[3\] = 1e\+300"),
        ({"phase_s": np.zeros(100) + 1j}, "phase_s: real"),
        ({"mixing": [[1j]]}, "mixing: real"),
        ({"dt_s": 1e-200}, "dt_s = 1e-200"),
        ({"dt_s": 1e200}, "dt_s = 1e\\+200"),
        ({"phase_sigma_s": 1e-200}, "phase_sigma_s = 1e-200"),
        ({"phase_sigma_s": 1e200}, "phase_sigma_s = 1e\\+200"),
        ({"phase_sigma_s": [[1e-200]]}, "phase noise: variance 1e-200"),
        ({"phase_s": np.zeros((4, 4, 4))}, "phase_s"),
        ({"mixing": [[1.0], [1.0]]}, "mixing"),
        ({"mixing": [[0.0]]}, "sees no clock"),
        ({"known": [None, None]}, "known: one for each of 1"),
        ({"known": [TwoState.ocxo()]}, "at least one clock"),
        ({"start": [STEADY, STEADY]}, "start: one for each of 1"),
        ({"start": [(-1.0, 1.0)]}, "h0"),
    ],
)
def test_refusals(arguments, words):
    given = {"phase_s": phases(OTHER, 100, 1), "dt_s": DT, "phase_sigma_s": SIGMA} | arguments
    with pytest.raises(ValueError, match=words):
        characterize(given.pop("phase_s"), given.pop("dt_s"), given.pop("phase_sigma_s"), **given)


def test_other_refusals():
    z = phases(OTHER, 100, 1)
    with pytest.raises(ValueError, match="candidates: shape"):
        NoiseBank([[1.0, 2.0]], DT, SIGMA)
    with pytest.raises(ValueError, match="prior"):
        NoiseBank([[[1e-23, 1e-25]]], DT, SIGMA, prior=[-1.0])
    with pytest.raises(ValueError, match="ln_width"):
        NoiseBank([[[1e-23, 1e-25]]], DT, SIGMA, ln_width=[[[-1.0, 0.0]]])
    bank = NoiseBank([[[1e-23, 1e-25]]], DT, SIGMA)
    with pytest.raises(ValueError, match="parameter"):
        bank.interval(0, "h1")
    with pytest.raises(ValueError, match="probability"):
        bank.interval(0, "h0", 1.0)
    with pytest.raises(ValueError, match="analysis"):
        iterate_noise(z, DT, SIGMA, [OTHER], analysis="em")
    with pytest.raises(ValueError, match="iterations"):
        iterate_noise(z, DT, SIGMA, [OTHER], iterations=-1)
    with pytest.raises(ValueError, match="no more than clocks"):
        estimate_clocks(np.zeros((20, 2)), DT, SIGMA, [OTHER], mixing=[[1.0], [1.0]])
    with pytest.raises(ValueError, match="clock = 1 of 1"):
        error_allan_variance(100, DT, SIGMA, [OTHER], [1], clock=1)
    with pytest.raises(ValueError, match="factors: 20 steps"):
        error_allan_variance(10, DT, SIGMA, [OTHER], [20])
    with pytest.raises(ValueError, match="factors: 5 steps"):
        error_allan_variance(10, DT, SIGMA, [OTHER], [1, 5])
    with pytest.raises(ValueError, match="at least 8 whole epochs expected, got 3"):
        iterate_noise(z[:3], DT, SIGMA, [OTHER])
    huge = np.where(np.arange(100) == 3, 1e300, z)
    with pytest.raises(ValueError, match=r"phase_s\[3\] = 1e\+300"):
        estimate_clocks(huge, DT, SIGMA, [OTHER])
    with pytest.raises(ValueError, match="phase_s: real"):
        bank.push(z + 0j)


def test_a_huge_phase_is_left_out_of_a_bank():
    candidates = [[(3e-25, 3e-27)], [(1e-23, 1e-25)]]
    bank, clean = (NoiseBank(candidates, DT, SIGMA) for _ in range(2))
    z = phases(OTHER, 100, 1)
    assert bank.push(np.where(np.arange(100) % 30 == 0, 1e200, z)) == 96
    clean.push(np.where(np.arange(100) % 30 == 0, np.nan, z))
    np.testing.assert_array_equal(bank.weights, clean.weights)
    assert bank.weights.sum() == pytest.approx(1.0)


def test_phases_up_to_the_bound_are_worked_with():
    z = phases(OTHER, 100, 1)
    z[50] = 1e45
    found = characterize(z, DT, SIGMA)
    assert np.isfinite(found.log_likelihood)
    assert np.isfinite(found.ln_covariance).all()
    assert np.isfinite(estimate_clocks(z, DT, SIGMA, [OTHER]).bias_s).all()
