"""Fusion of characterisations: against dense least squares, under any correlation, over simulated clocks; judgement."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

from soopnav_cpp._core import navigation as core
from soopnav_cpp.clock import TwoState
from soopnav_cpp.sopdb import fusion
from soopnav_cpp.sopdb.fusion import Entry, Estimate, SourceState, fuse, judge
from soopnav_cpp.sopdb.records import Characterization

Array = npt.NDArray[np.float64]
NOON = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
CLOCK = TwoState.ocxo()
CLOCK_P = np.array([[1e-18, 3e-22], [3e-22, 1e-22]])
LN_P = np.diag([0.02, 0.2])
P_E = np.array([6378137.0, 1e3, 2e3])


def body(
    bias_s: float = 1e-7,
    drift: float = 1e-10,
    *,
    at: datetime = NOON,
    covariance: Array = CLOCK_P,
    ln_h: tuple[float, float] = (0.0, 0.0),
    offset_m: float = 0.0,
    independent: bool = True,
    **other: Any,
) -> Characterization:
    return Characterization.model_validate(
        {
            "source": {"kind": "cdma", "name": "PN 168", "carrier_hz": 881.52e6},
            "position": {"p_e_m": (P_E + np.array([offset_m, 0, 0])).tolist(), "covariance_m2": np.eye(3).tolist()},
            "clock": {"epoch": at.isoformat(), "bias_s": bias_s, "drift": drift, "covariance": covariance.tolist()},
            "noise": {
                "h0_s": CLOCK.h0 * np.exp(ln_h[0]),
                "h_minus2_per_s": CLOCK.h_minus_2 * np.exp(ln_h[1]),
                "ln_covariance": LN_P.tolist(),
            },
            "provenance": {"receiver": "r", "software": "s", "method": "manual", "independent": independent},
            "quality": {"duration_s": 240.0, "cn0_dbhz": 55.0, "nis": 1.0},
        }
        | other
    )


def entry(name: str, characterization: Characterization, *, contributor: str | None = None) -> Entry:
    at = NOON if characterization.clock is None else characterization.clock.epoch
    return Entry(name, contributor or name, at, characterization)


def process(dt_s: float) -> Array:
    s_f, s_g = 0.5 * CLOCK.h0, 2 * np.pi**2 * CLOCK.h_minus_2
    return np.array([[s_f * dt_s + s_g * dt_s**3 / 3, s_g * dt_s**2 / 2], [s_g * dt_s**2 / 2, s_g * dt_s]])


def dense(t_s: Array, value: Array, covariance: Array, at_s: float) -> tuple[Array, Array]:
    """The state at `at_s` by generalised least squares on the states at all times, their noise between them as rows."""
    times = np.unique(np.append(t_s, at_s))
    n = len(times)
    rows, targets, weights = [], [], []
    scale = np.diag([1e9, 1e11])  # nanoseconds and hundredths of 1e-9: numbers of order one
    for t, z, P in zip(t_s, value, covariance, strict=True):
        H = np.zeros((2, 2 * n))
        H[:, 2 * np.searchsorted(times, t) :][:, :2] = np.eye(2)
        rows.append(H)
        targets.append(scale @ z)
        weights.append(np.linalg.inv(scale @ P @ scale))
    for i in range(n - 1):
        dt = times[i + 1] - times[i]
        Phi = scale @ np.array([[1.0, dt], [0.0, 1.0]]) @ np.linalg.inv(scale)
        H = np.zeros((2, 2 * n))
        H[:, 2 * i : 2 * i + 2] = -Phi
        H[:, 2 * i + 2 : 2 * i + 4] = np.eye(2)
        rows.append(H)
        targets.append(np.zeros(2))
        weights.append(np.linalg.inv(scale @ process(dt) @ scale))
    information = sum(H.T @ W @ H for H, W in zip(rows, weights, strict=True))
    right = sum(H.T @ W @ z for H, W, z in zip(rows, weights, targets, strict=True))
    P = np.linalg.inv(information)
    k = 2 * np.searchsorted(times, at_s)
    down = np.linalg.inv(scale)
    return down @ (P @ right)[k : k + 2], down @ P[k : k + 2, k : k + 2] @ down


@pytest.mark.parametrize("at_s", [-500.0, 0.0, 130.0, 600.0, 5000.0])
def test_clocks_fuse_as_dense_least_squares_has_it(at_s: float) -> None:
    rng = np.random.default_rng(3)
    t_s = np.array([0.0, 100.0, 100.0, 300.0, 600.0])
    value = rng.normal(size=(5, 2)) * [1e-9, 1e-11]
    covariance = np.array([CLOCK_P * k for k in (1.0, 3.0, 0.5, 2.0, 1.0)])
    got, P = core.sop_fuse_clocks(t_s, value, covariance, [True] * 5, h0=CLOCK.h0, h_minus_2=CLOCK.h_minus_2, at_s=at_s)
    expected, expected_P = dense(t_s, value, covariance, at_s)
    sigma = np.sqrt(np.diag(expected_P))
    np.testing.assert_allclose((got - expected) / sigma, 0.0, atol=1e-6)
    np.testing.assert_allclose(P / np.outer(sigma, sigma), expected_P / np.outer(sigma, sigma), atol=1e-6)


@pytest.mark.parametrize("size", [2, 3])
def test_constants_fuse_as_the_information_form_has_it(size: int) -> None:
    rng = np.random.default_rng(size)
    roots = rng.normal(size=(4, size, size))
    covariance = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(size)
    value = rng.normal(size=(4, size))
    got, P = core.sop_fuse_constants([0.0, 1, 2, 3], value, covariance, [True] * 4, variance_per_s=0.0, at_s=9.0)
    information = np.linalg.inv(covariance)
    expected = np.linalg.inv(information.sum(0))
    np.testing.assert_allclose(P, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(got, expected @ np.einsum("nij,nj->i", information, value), rtol=1e-7, atol=1e-9)


def test_intersection_is_never_better_than_the_truth_under_any_correlation() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        n = int(rng.choice([2, 3]))
        root = rng.normal(size=(2 * n, int(rng.choice([n, 2 * n]))))  # of rank n: fully correlated
        joint = root @ root.T + 1e-9 * np.eye(2 * n)
        A, B, C = joint[:n, :n], joint[n:, n:], joint[:n, n:]
        value, P, weight = core.sop_intersect(np.zeros(n), A, np.ones(n), B)
        K = np.linalg.solve(A / max(weight, 1e-300) + B / max(1 - weight, 1e-300), A / max(weight, 1e-300)).T
        K = np.zeros((n, n)) if weight == 1.0 else np.eye(n) if weight == 0.0 else K
        np.testing.assert_allclose(value, K @ np.ones(n), atol=1e-6)
        rest = np.eye(n) - K
        true = rest @ A @ rest.T + K @ B @ K.T + rest @ C @ K.T + K @ C.T @ rest.T
        assert np.linalg.eigvalsh(P - true)[0] >= -1e-7 * np.trace(P)
        dets = [
            np.linalg.det(np.linalg.inv(w * np.linalg.inv(A) + (1 - w) * np.linalg.inv(B))) for w in (0.1, 0.5, 0.9)
        ]
        assert np.linalg.det(P) <= min(dets) * (1 + 1e-6)


def test_a_repeated_answer_adds_nothing_unless_it_is_independent() -> None:
    first = entry("a", body())
    echo = [entry(f"e{i}", body(independent=False)) for i in range(5)]
    alone, echoed = fuse([first], NOON).clock, fuse([first, *echo], NOON).clock
    repeated = fuse([first, *(entry(f"i{i}", body()) for i in range(5))], NOON).clock
    assert alone is not None
    assert echoed is not None
    assert repeated is not None
    np.testing.assert_allclose(echoed.covariance, alone.covariance, rtol=1e-6)
    np.testing.assert_allclose(repeated.covariance * 6, alone.covariance, rtol=1e-6)


def test_the_order_of_arrival_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    entries = [
        entry(str(i), body(1e-7 + 1e-9 * rng.normal(), at=NOON - timedelta(minutes=7 * i), independent=i % 3 != 0))
        for i in range(9)
    ]
    expected = fuse(entries, NOON).to_json()
    for _ in range(3):
        rng.shuffle(entries)  # type: ignore[arg-type]
        assert fuse(entries, NOON).to_json() == expected


def test_a_state_survives_json_and_moves_only_forwards() -> None:
    state = fuse([entry("a", body())], NOON)
    assert SourceState.from_json(state.to_json()).to_json() == state.to_json()
    later = state.moved(NOON + timedelta(days=30))
    assert state.position is not None
    assert later.position is not None
    assert np.trace(later.position.covariance) > np.trace(state.position.covariance)
    assert later.answer()["position"]["sigma_m"] > 0.0
    assert later.noise is not None
    assert later.noise.covariance[0, 0] == pytest.approx(0.02 + 30 / 365.25, rel=1e-6)
    with pytest.raises(ValueError, match="must not be before"):
        later.moved(NOON)
    empty = fuse([], NOON)
    assert empty.answer() == {"position": None, "clock": None, "noise": None}
    assert SourceState.from_json(empty.to_json()) == empty


def test_an_answer_is_consistent_hours_ahead() -> None:
    """NEES of the asked clock over true clocks, contributions of uncertain h: its mean is 2."""
    rng = np.random.default_rng(11)
    runs = 400
    root, ln_root = np.linalg.cholesky(CLOCK_P), np.sqrt(np.diag(LN_P))
    for hours in (1.0, 6.0):
        nees = []
        for _ in range(runs):
            t_s = np.array([0.0, 600.0, 1800.0, 1800.0 + 3600.0 * hours])
            states = np.zeros((4, 2))
            for k in range(3):
                dt = t_s[k + 1] - t_s[k]
                noise = np.linalg.cholesky(process(dt)) @ rng.normal(size=2)
                states[k + 1] = np.array([[1, dt], [0, 1]]) @ states[k] + noise
            entries = []
            for k in range(3):
                z = states[k] + root @ rng.normal(size=2)
                ln = ln_root * rng.normal(size=2)
                told = body(float(z[0]), float(z[1]), at=NOON + timedelta(seconds=t_s[k]), ln_h=(ln[0], ln[1]))
                entries.append(entry(str(k), told))
            clock = fuse(entries, NOON + timedelta(seconds=t_s[3])).clock
            assert clock is not None
            error = clock.value - states[3]
            nees.append(error @ np.linalg.solve(clock.covariance, error))
        # E[h] is the exact mean of the growth, so that the mean is 2 but for the spread of ln h (heavier tails).
        low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], 2 * runs) / runs
        assert 0.85 * low < np.mean(nees) < 1.15 * high


def honest(rng: np.random.Generator, name: str, *, at: datetime = NOON) -> Entry:
    z = np.array([1e-7, 1e-10]) + np.linalg.cholesky(CLOCK_P) @ rng.normal(size=2)
    ln = np.sqrt(np.diag(LN_P)) * rng.normal(size=2)
    return entry(name, body(float(z[0]), float(z[1]), at=at, ln_h=(ln[0], ln[1]), offset_m=float(rng.normal())))


def test_the_honest_are_quarantined_as_rarely_as_the_gate_says() -> None:
    rng = np.random.default_rng(7)
    refused = 0
    for trial in range(600):
        others = [honest(rng, str(i)) for i in range(trial % 3 + 1)]
        refused += judge(honest(rng, "new"), others).status == "quarantined"
    assert refused <= stats.binom.ppf(1 - 1e-4, 600, 1e-4)  # GATE: 1e-4 each


@pytest.mark.parametrize(
    ("lie", "part"),
    [
        ({"bias_s": 1.2e-7}, "clock"),
        ({"drift": 3e-10}, "clock"),
        ({"offset_m": 40.0}, "position"),
        ({"ln_h": (5.0, 0.0)}, "noise"),
    ],
)
def test_lies_are_quarantined_and_named(lie: dict[str, Any], part: str) -> None:
    rng = np.random.default_rng(8)
    for _ in range(50):
        found = judge(entry("liar", body(**lie)), [honest(rng, str(i)) for i in range(3)])
        assert found.status == "quarantined"
        assert found.reasons[0].startswith(part)


def test_a_first_liar_does_not_lock_out_the_honest() -> None:
    rng = np.random.default_rng(9)
    liar = entry("liar", body(3e-7))
    first = judge(honest(rng, "a"), [liar])
    assert first.status == "quarantined"  # one word against another
    second = judge(honest(rng, "b"), [liar], [honest(rng, "a")])
    assert second.status == "accepted"
    assert list(second.quarantined) == ["liar"]
    assert second.reinstated == ("a",)
    assert "2 later contributors agree" in second.quarantined["liar"][0]


def test_one_voice_is_one_voice() -> None:
    rng = np.random.default_rng(10)
    lies = [entry(f"lie{i}", body(3e-7), contributor="liar") for i in range(20)]
    truth = [honest(rng, "a"), honest(rng, "b")]
    assert judge(lies[0], truth, lies[1:]).status == "quarantined"
    echoes = [entry(f"echo{i}", body(3e-7, independent=False)) for i in range(5)]
    assert judge(echoes[0], truth, echoes[1:]).status == "quarantined"  # not independent: no vote
    two = [entry("x", body(3e-7)), entry("y", body(3e-7))]
    assert judge(two[0], truth, two[1:]).status == "quarantined"  # a tie changes nothing
    three = [*two, entry("z", body(3e-7))]
    assert judge(three[0], truth, three[1:]).status == "accepted"  # a majority does


def test_one_contributor_cannot_carry_a_source_away() -> None:
    """In steps that each agree with the one before, and more of them than are fused."""
    rng = np.random.default_rng(13)
    five = [honest(rng, f"honest{i}") for i in range(5)]
    accepted, refused = list(five), []
    for k in range(50):
        step = body(offset_m=0.25 * k, clock=None, noise=None)
        new = Entry(f"step{k:02d}", "one", NOON + timedelta(seconds=float(k)), step)
        found = judge(new, accepted, refused[-5:])
        assert found.quarantined == {}
        (accepted if found.status == "accepted" else refused).append(new)
    assert fusion.MOST_OF_ONE < len(accepted) - len(five) < 30
    said = fuse(accepted, NOON).position
    assert said is not None
    assert np.linalg.norm(said.value - P_E) < 5.0
    counted = fusion.counting(accepted)
    assert [one.contributor for one in counted].count("one") == fusion.MOST_OF_ONE
    assert {one.id for one in five} < {one.id for one in counted}
    wide = body(offset_m=6.0, clock=None, noise=None)  # as far as a pair may be apart, too far for all five
    assert judge(Entry("wide", "one", NOON, wide), five[:1]).status == "accepted"
    assert judge(Entry("wide", "one", NOON, wide), five).status == "quarantined"
    # The honest overturn even what little there is.
    late = [honest(rng, f"late{i}") for i in range(2)]
    first = judge(late[0], accepted, refused)
    assert first.status == "accepted" or judge(late[1], accepted, [*refused, late[0]]).status == "accepted"


def test_everybody_counts_before_anybody_twice() -> None:
    rng = np.random.default_rng(14)
    of_one = [entry(f"n{k}", body(at=NOON + timedelta(seconds=k)), contributor="one") for k in range(20)]
    many = [honest(rng, f"m{k:02d}", at=NOON - timedelta(seconds=100.0 - k)) for k in range(62)]
    counted = fusion.counting([*of_one, *many])
    assert len(counted) == fusion.MOST_FUSED
    assert {one.id for one in many} < {one.id for one in counted}
    assert [one.id for one in counted if one.contributor == "one"] == ["n18", "n19"]
    assert counted == sorted(counted, key=lambda one: one.time)


def test_old_voices_fade() -> None:
    """A clock that was set anew: the first to say so after a month is believed."""
    rng = np.random.default_rng(12)
    old = [honest(rng, str(i), at=NOON - timedelta(days=40)) for i in range(3)]
    moved = entry("new", body(offset_m=500.0))
    assert judge(moved, old).status == "accepted"
    assert judge(moved, [honest(rng, "recent", at=NOON - timedelta(days=20)), *old]).status == "quarantined"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"bias_s": 2.0}, "offset of 2 s"),
        ({"drift": 2e-4}, "drift of 0.0002"),
        ({"covariance": np.diag([1e-18, 1e-28])}, "a drift to 1e-14"),
        ({"covariance": np.diag([1e-34, 1e-22])}, "an offset to 1e-17"),
        ({"ln_h": (25.0, 0.0)}, "h0 of"),
        ({"ln_h": (0.0, 30.0)}, "h-2 of"),
        ({"position": {"p_e_m": [6.37e6, 0, 0], "covariance_m2": np.eye(3).tolist()}}, "m inside the Earth"),
        ({"position": {"p_e_m": [6.5e6, 0, 0], "covariance_m2": np.eye(3).tolist()}}, "m above the Earth"),
        ({"source": {"kind": "gps", "name": "G05", "carrier_hz": 1575.42e6}}, "a satellite has an orbit"),
        ({"quality": {"duration_s": 240.0, "nis": 9.0}}, "innovations are 9"),
        (
            {"noise": {"h0_s": 1e-23, "h_minus2_per_s": 1e-25, "ln_covariance": [[0.02, 0], [0, 1e-4]]}},
            "ln h-2 to 0.01; 240 s allow",
        ),
        (
            {"noise": {"h0_s": 1e-23, "h_minus2_per_s": 1e-25, "ln_covariance": [[1e-7, 0], [0, 0.2]]}},
            "ln h0 to 0.00032",
        ),
    ],
)
def test_impossible_claims_are_quarantined_by_themselves(change: dict[str, Any], sentence: str) -> None:
    liar = entry("liar", body(**change))
    assert any(sentence in reason for reason in fusion.impossible(liar.body)), fusion.impossible(liar.body)
    assert judge(liar, []).status == "quarantined"
    assert fusion.impossible(body()) == ()


def test_stability_has_a_band_that_holds_the_truth() -> None:
    rng = np.random.default_rng(13)
    tau = np.geomspace(0.1, 1000, 9)
    inside = np.zeros(len(tau))
    for _ in range(400):
        ln = np.log([CLOCK.h0, CLOCK.h_minus_2]) + np.sqrt(np.diag(LN_P)) * rng.normal(size=2)
        curve = fusion.stability(Estimate(ln, LN_P), tau)
        truth = CLOCK.allan_deviation(tau)
        inside += (curve["lower"] < truth) & (truth < curve["upper"])
    assert np.all(inside / 400 > 0.88)  # 95 % to first order
    assert np.all(inside[[0, -1]] / 400 < 0.99)


def test_quality_grades() -> None:
    rng = np.random.default_rng(14)
    three = [honest(rng, str(i)) for i in range(3)]
    graded = [
        fusion.answer_quality(entries, NOON + timedelta(days=days))["grade"]
        for entries, days in ((three, 0.5), (three, 2), (three[:1], 0.1), (three, 20), (three, 40), ([], 0))
    ]
    assert graded == ["A", "B", "C", "C", "D", "D"]
