"""The opportunistic navigator from Python: faults told apart, batches, smoothing against a solution in one piece."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import soopnav_cpp as sn
from soopnav_cpp.clock import ClockNoise, TwoState
from soopnav_cpp.navigation import ObservableUse, OpportunisticNavigator

Array = npt.NDArray[np.float64]

LIGHT_MPS = 299_792_458.0
PLACE = np.array([-740289.9, -5457071.7, 3207245.6])
CARRIER_HZ = 1.9e9
PER_METRE = CARRIER_HZ / LIGHT_MPS
PHASE_SIGMA = 2e-3


def masts(count: int) -> Array:
    """Around the place, 4 to 9 km away."""
    angle = 2.4 * np.arange(count)
    way = np.stack([np.cos(angle), np.sin(angle), np.sin(1.7 * angle)], axis=1)
    return np.asarray(PLACE + way * (4000.0 + 600.0 * np.arange(count)[:, None]), np.float64)


def receiver(motion: str = "static", form: str = "square_root", **options: Any) -> OpportunisticNavigator:
    return OpportunisticNavigator(
        PLACE,
        position_sigma_m=1.0,
        clock=TwoState.ocxo(),
        clock_bias_sigma_s=1e-7,
        clock_drift_sigma=1e-9,
        motion=motion,  # type: ignore[arg-type]
        form=form,  # type: ignore[arg-type]
        time_tags="system",
        **options,
    )


def with_masts(count: int = 6, **options: Any) -> OpportunisticNavigator:
    """Masts whose clocks are known: GPS-like."""
    nav = receiver(**options)
    for k, place in enumerate(masts(count)):
        nav.add_source(f"S{k}", "cdma", carrier_hz=CARRIER_HZ, position_e_m=place, ambiguity_sigma_cycles=100.0)
    return nav


def heard(nav: OpportunisticNavigator, epochs: int, seed: int = 1) -> tuple[Array, Array, Array]:
    """Times, phases and pseudoranges of the navigator's own state, with noise."""
    rng = np.random.default_rng(seed)
    t = np.asarray(0.1 * np.arange(epochs), np.float64)
    phase, code = (
        np.array([nav.expected(0.0, {"source": k, "kind": kind})[0] for k in nav.sources])  # type: ignore[index]
        for kind in ("phase", "pseudorange")
    )
    shape = (epochs, len(nav.sources))
    return t, phase + PHASE_SIGMA * rng.normal(size=shape), code + rng.normal(size=shape)


def go(nav: OpportunisticNavigator, t: Array, phase: Array, code: Array, **options: Any) -> Any:
    return nav.run(t, phase, PHASE_SIGMA, pseudorange_m=code, pseudorange_sigma_m=1.0, **options)


def test_a_quiet_run_uses_everything_and_says_how_well() -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 100)
    run = go(nav, t, phase, code, covariance=True)
    assert np.all(run.phase_use == ObservableUse.ACCEPTED)
    assert np.all(run.pseudorange_use == ObservableUse.ACCEPTED)
    assert not run.receiver_jump.any()
    assert run.slips == 0
    assert np.all(np.abs(run.position_e_m[-1] - PLACE) < 6.0 * run.sigma[-1, :3])
    assert run.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2)), run.sigma, rtol=1e-9)
    np.testing.assert_array_equal(run.covariance[-1], nav.covariance)
    # The sum of 99 epochs of 12 innovations is chi-square; 1e-6 on either side.
    low, high = sn.estimation.mean_nees_bounds(float(run.dof.sum()), 1, failure_probability=2e-6)
    assert low < run.nis.sum() < high
    assert "100 epochs" in repr(run)
    assert "S3" in repr(nav)


def test_missing_and_meaningless_observables_are_counted_and_change_nothing() -> None:
    nav, twin = with_masts(), with_masts()
    t, phase, code = heard(nav, 40)
    holes = phase.copy()
    holes[10:20, 2] = np.nan
    run = go(nav, t, holes, code)
    assert np.count_nonzero(run.phase_use == ObservableUse.MISSING) == 10
    assert np.all(np.isfinite(run.mean))
    infinite = phase.copy()
    infinite[10:20, 2] = np.inf
    other = go(twin, t, infinite, code)
    assert np.count_nonzero(other.phase_use == ObservableUse.NON_FINITE) == 10
    np.testing.assert_array_equal(other.mean, run.mean)


def test_cycle_slips_every_second_are_survived() -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 300)
    rng = np.random.default_rng(3)
    expected = np.zeros(phase.shape, bool)
    for k in range(10, 300, 10):
        source = int(rng.integers(6))
        phase[k:, source] += float(rng.choice([-1, 1])) * int(rng.integers(1, 2000))
        expected[k, source] = True
    run = go(nav, t, phase, code)
    np.testing.assert_array_equal(run.phase_use == ObservableUse.SLIP, expected)
    assert np.all(run.pseudorange_use == ObservableUse.ACCEPTED)
    assert not run.receiver_jump.any()
    assert np.all(np.abs(run.position_e_m[-1] - PLACE) < 6.0 * run.sigma[-1, :3])
    assert not any(nav.source(k).suspended for k in nav.sources)
    assert sum(nav.source(k).slips for k in nav.sources) == 29


def test_a_slip_of_every_phase_at_once_is_survived() -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 60)
    phase[30:] += np.array([3.0, -7.0, 11.0, 2.0, -5.0, 1.0])
    run = go(nav, t, phase, code)
    assert np.count_nonzero(run.phase_use[30] == ObservableUse.SLIP) >= 5
    assert np.all(run.phase_use[31:] == ObservableUse.ACCEPTED)
    assert np.all(np.abs(run.position_e_m[-1] - PLACE) < 6.0 * run.sigma[-1, :3])


def test_a_source_is_present_once() -> None:
    nav = with_masts(2)
    with pytest.raises(ValueError, match="a source of this name is present"):
        nav.add_source("S1", "cdma", carrier_hz=CARRIER_HZ, position_e_m=PLACE + 1000.0)
    assert nav.remove_source(nav.find_source("S1"))  # type: ignore[arg-type]
    again = nav.add_source("S1", "cdma", carrier_hz=CARRIER_HZ, position_e_m=PLACE + 1000.0)
    assert again == 2
    assert nav.sources == (0, 2)
    with pytest.raises(ValueError, match="not present"):
        nav.source(1)


@pytest.mark.parametrize("form", ["square_root", "joseph"])
def test_a_source_that_moves_is_suspended_and_the_others_stay_right(form: str) -> None:
    nav = with_masts(form=form)
    t, phase, code = heard(nav, 200)
    walked = 8.0 * np.maximum(t - 5.0, 0.0)  # m/s, declared to stand
    phase[:, 4] += walked * PER_METRE
    code[:, 4] += walked
    run = go(nav, t, phase, code)
    assert nav.source(4).suspended
    assert np.all(run.phase_use[150:, 4] == ObservableUse.SUSPENDED)
    assert not any(nav.source(k).suspended for k in (0, 1, 2, 3, 5))
    assert np.all(run.phase_use[:, [0, 1, 2, 3, 5]] == ObservableUse.ACCEPTED)
    assert np.max(np.abs(run.position_e_m[-1] - PLACE)) < 1.0
    assert nav.readmit(4)
    assert not nav.source(4).suspended
    assert not nav.readmit(4)


def test_a_receiver_clock_that_jumps_is_told_from_slips() -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 120)
    phase[60:] += 1e-3 * LIGHT_MPS * PER_METRE
    code[60:] += 1e-3 * LIGHT_MPS
    run = go(nav, t, phase, code)
    np.testing.assert_array_equal(np.flatnonzero(run.receiver_jump), [60])
    assert run.slips == 0
    assert run.clock_bias_s[-1] == pytest.approx(1e-3, abs=6.0 * run.clock_bias_sigma_s[-1])
    assert np.all(np.abs(run.position_e_m[-1] - PLACE) < 6.0 * run.sigma[-1, :3])


def test_a_source_clock_that_jumps_is_its_own() -> None:
    nav = with_masts()
    source = nav.add_source(
        "B",
        "cdma",
        carrier_hz=CARRIER_HZ,
        position_e_m=PLACE + 5000.0,
        clock=TwoState.basestation(),
        clock_bias_sigma_s=1e-7,
        ambiguity_sigma_cycles=100.0,
    )
    t, phase, code = heard(nav, 120)
    phase[60:, 6] -= 300.0 * PER_METRE
    code[60:, 6] -= 300.0
    run = go(nav, t, phase, code)
    state = nav.source(source)
    assert (state.jumps, state.slips, state.suspended) == (1, 0, False)
    assert not run.receiver_jump.any()
    assert np.all(run.phase_use == ObservableUse.ACCEPTED)
    sigma = np.sqrt(state.clock_covariance[0, 0])
    assert state.clock_bias_s == pytest.approx(300.0 / LIGHT_MPS, abs=6.0 * sigma)


def test_an_outlier_is_left_out() -> None:
    nav, twin = with_masts(), with_masts()
    t, phase, code = heard(nav, 50)
    spoilt, holed = code.copy(), code.copy()
    spoilt[30, 1] += 60.0
    holed[30, 1] = np.nan
    run = go(nav, t, phase, spoilt)
    assert run.pseudorange_use[30, 1] == ObservableUse.GATED
    assert np.count_nonzero(run.pseudorange_use == ObservableUse.GATED) == 1
    np.testing.assert_allclose(run.mean, go(twin, t, phase, holed).mean, rtol=0.0, atol=1e-6)


def test_without_sources_it_coasts_and_says_what_is_not_observed() -> None:
    nav = with_masts(6)
    t, phase, code = heard(nav, 50)
    go(nav, t, phase, code)
    assert nav.unobservable() == ()
    before = nav.clock_covariance[0, 0]
    report = nav.step(20.0, [])
    assert report.coasted
    assert report.status == "accepted"
    assert nav.clock_covariance[0, 0] > before
    # One phase and nothing else: the clock is not told from the constant, nor any coordinate.
    lone = receiver("known")
    only = lone.add_source("A", "cdma", carrier_hz=CARRIER_HZ, position_e_m=masts(1)[0])
    for k in range(5):
        lone.step(0.1 * k, [{"source": only, "kind": "phase", "value": 0.0, "sigma": 0.01}])
    assert lone.unobservable() == ("0.71 clock bias - 0.71 A ambiguity",)
    fresh = receiver("known")
    assert set(fresh.unobservable()) == {"clock bias", "clock drift"}


def test_pitfall_1_only_the_sum_of_clock_and_constant_is_observed() -> None:
    nav = with_masts(6)
    extra = nav.add_source(
        "B", "cdma", carrier_hz=CARRIER_HZ, position_e_m=PLACE + 4000.0, clock=TwoState.basestation()
    )
    t, phase, code = heard(nav, 40)
    code[:, 6] = np.nan
    go(nav, t, phase, code)
    assert nav.unobservable() == ("0.71 B clock bias + 0.71 B ambiguity",)
    assert nav.source(extra).kind == "cdma"


def test_bad_arguments_are_named() -> None:
    nav = with_masts(2)
    with pytest.raises(ValueError, match="motion"):
        receiver("flying")
    with pytest.raises(ValueError, match="clock"):
        OpportunisticNavigator(PLACE, clock=(1.0, 2.0, 3.0))
    with pytest.raises(ValueError, match="position_e_m"):
        OpportunisticNavigator(PLACE[:2], clock=TwoState.ocxo())
    with pytest.raises(ValueError, match="phase_cycles: shape"):
        nav.run([0.0], np.zeros((1, 3)), 0.1)
    with pytest.raises(ValueError, match="phase_sigma_cycles: expected"):
        nav.run([0.0], np.zeros((1, 2)))
    with pytest.raises(ValueError, match="at least one"):
        nav.run([0.0])
    with pytest.raises(ValueError, match="is not present"):
        nav.run([0.0], np.zeros((1, 1)), 0.1, sources=[9])
    with pytest.raises(ValueError, match=r"observations\[0\]: missing sigma"):
        nav.step(0.0, [{"source": 0, "kind": "phase", "value": 0.0}])
    with pytest.raises(ValueError, match=r"observations\[0\]: unknown colour"):
        nav.step(0.0, [{"source": 0, "kind": "phase", "value": 0.0, "sigma": 1.0, "colour": 3}])
    with pytest.raises(ValueError, match="nothing was recorded"):
        nav.smooth()
    run = nav.run([0.0], np.zeros((1, 2)), 0.1, pseudorange_m=np.full((1, 2), np.nan), pseudorange_sigma_m=1.0)
    with pytest.raises(ValueError, match="velocity"):
        _ = run.velocity_e_mps


class Piece:
    """A linear run in one piece: every state of every epoch, its prior, its noise and its observables."""

    def __init__(self, noise: dict[str, ClockNoise], dt_s: float) -> None:
        self.noise, self.dt_s = noise, dt_s
        self.at: dict[tuple[str, int], int] = {}
        self.rows: list[tuple[dict[int, float], float]] = []

    def index(self, name: str, epoch: int) -> int:
        return self.at.setdefault((name, epoch), len(self.at))

    def row(self, terms: dict[tuple[str, int], float], value: float, sigma: float) -> None:
        self.rows.append(({self.index(*key): c / sigma for key, c in terms.items()}, value / sigma))

    def clock(self, name: str, epoch: int) -> None:
        """Leads the clock of `name` from an epoch to the next."""
        white, walk = self.noise[name]
        dt = self.dt_s
        Q = np.array([[walk * dt, walk * dt**2 / 2.0], [walk * dt**2 / 2.0, white * dt + walk * dt**3 / 3.0]])
        L = np.linalg.inv(np.linalg.cholesky(Q))
        drift = {(f"{name} drift", epoch + 1): 1.0, (f"{name} drift", epoch): -1.0}
        bias = {
            (f"{name} bias", epoch + 1): 1.0,
            (f"{name} bias", epoch): -1.0,
            (f"{name} drift", epoch): -dt,
        }
        self.row({k: L[0, 0] * c for k, c in drift.items()}, 0.0, 1.0)
        both = {k: L[1, 0] * c for k, c in drift.items()}
        for k, c in bias.items():
            both[k] = both.get(k, 0.0) + L[1, 1] * c
        self.row(both, 0.0, 1.0)

    def solve(self) -> tuple[Array, Array]:
        A = np.zeros((len(self.rows), len(self.at)))
        b = np.zeros(len(self.rows))
        for i, (terms, value) in enumerate(self.rows):
            for j, c in terms.items():
                A[i, j] += c
            b[i] = value
        Q, R = np.linalg.qr(A)
        inverse = np.linalg.inv(R)
        return inverse @ (Q.T @ b), inverse @ inverse.T


@pytest.mark.parametrize("form", ["square_root", "joseph"])
def test_smoothing_over_joins_and_leaves_is_the_solution_in_one_piece(form: str) -> None:
    """Receiver and two sources with clocks of metres: A leaves after epoch 5, B joins before epoch 3."""
    rng = np.random.default_rng(11)
    epochs, dt = 9, 1.0
    own, other = ClockNoise(0.5, 0.2), ClockNoise(0.3, 0.1)
    places = masts(3)
    nav = OpportunisticNavigator(
        PLACE,
        clock=own,
        clock_bias_sigma_s=10.0 / LIGHT_MPS,
        clock_drift_sigma=2.0 / LIGHT_MPS,
        motion="known",
        form=form,  # type: ignore[arg-type]
        time_tags="system",
    )
    nav.start_recording(epochs)
    piece = Piece({"r": own, "A": other, "B": other}, dt)
    piece.row({("r bias", 0): 1.0}, 0.0, 10.0)
    piece.row({("r drift", 0): 1.0}, 0.0, 2.0)
    ids: dict[str, int] = {}

    def join(name: str, place: Array, epoch: int) -> None:
        ids[name] = nav.add_source(
            name,
            "cdma",
            carrier_hz=CARRIER_HZ,
            position_e_m=place,
            clock=None if name == "G" else other,
            clock_bias_sigma_s=5.0 / LIGHT_MPS,
            clock_drift_sigma=1.0 / LIGHT_MPS,
            ambiguity_sigma_cycles=20.0,
        )
        piece.row({(f"{name} gamma", 0): 1.0}, 0.0, 20.0)
        if name != "G":
            piece.row({(f"{name} bias", epoch): 1.0}, 0.0, 5.0)
            piece.row({(f"{name} drift", epoch): 1.0}, 0.0, 1.0)

    join("G", places[0], 0)
    join("A", places[1], 0)
    since, until = {"G": 0, "A": 0, "B": 2}, {"G": epochs, "A": 6, "B": epochs}
    for k in range(epochs):
        if k == 3:
            join("B", places[2], 2)
        if k == 6:
            nav.remove_source(ids["A"])
        if k > 0:
            for name in piece.noise:
                if name == "r" or since[name] <= k - 1 < until[name] - 1:
                    piece.clock(name, k - 1)
        given = []
        for name, source in ids.items():
            if not since[name] <= k < until[name] or (name == "B" and k < 3):
                continue
            for kind, sigma, _scale in (("phase", 0.5, PER_METRE), ("pseudorange", 3.0, 1.0)):
                found = nav.expected(k * dt, {"source": source, "kind": kind})
                assert found is not None
                value = found[0] + 2.0 * sigma * rng.normal()
                given.append({"source": source, "kind": kind, "value": value, "sigma": sigma})
                # The same row by the components' names.
                row = dict(zip(nav.component_names, found[1], strict=True))
                terms = {("r bias", k): row["clock bias"]}
                if name != "G":
                    terms[(f"{name} bias", k)] = row[f"{name} clock bias"]
                    terms[(f"{name} drift", k)] = row[f"{name} clock drift"]
                if kind == "phase":
                    terms[(f"{name} gamma", 0)] = 1.0
                constant = found[0] - float(found[1] @ nav.mean)
                piece.row(terms, value - constant, sigma)
        assert nav.step(k * dt, given).accepted == len(given)
    smoothed = nav.smooth(gains=True)
    x, P = piece.solve()
    assert len(smoothed) == epochs
    assert smoothed.sources[:2] == (-1, -1)

    def check(series: str, name: str, first: int, last: int, constant: bool = False) -> None:
        column = smoothed.column(series)
        for k in range(epochs):
            if not first <= k < last:
                assert np.isnan(smoothed.mean[k, column])
                continue
            i = piece.at[(name, 0 if constant else k)]
            assert smoothed.mean[k, column] == pytest.approx(x[i], abs=2e-6)
            assert smoothed.sigma[k, column] == pytest.approx(np.sqrt(P[i, i]), rel=1e-6)

    check("clock bias", "r bias", 0, epochs)
    check("clock drift", "r drift", 0, epochs)
    check("A clock bias", "A bias", 0, 6)
    check("B clock bias", "B bias", 3, epochs)
    check("B clock drift", "B drift", 3, epochs)
    check("A ambiguity", "A gamma", 0, 6, constant=True)
    check("G ambiguity", "G gamma", 0, epochs, constant=True)
    lags = smoothed.lag_covariance("clock bias", 4)
    for k in range(epochs):
        for m in range(5):
            if k + m >= epochs:
                assert np.isnan(lags[k, m])
                continue
            i, j = piece.at[("r bias", k)], piece.at[("r bias", k + m)]
            assert lags[k, m] == pytest.approx(P[i, j], rel=1e-5, abs=1e-9)
    np.testing.assert_allclose(lags[:, 0], smoothed.clock_covariance[:, 0, 0] * LIGHT_MPS**2, rtol=1e-9)
    with pytest.raises(ValueError, match="gains"):
        nav.smooth().lag_covariance("clock bias", 1)
    with pytest.raises(ValueError, match="one of"):
        smoothed.column("colour")


def test_smoothing_takes_a_slip_for_what_it_is() -> None:
    nav = with_masts()
    nav.start_recording(60)
    t, phase, code = heard(nav, 60)
    phase[30:, 2] += 25.0
    go(nav, t, phase, code)
    smoothed = nav.smooth()
    gamma = smoothed.ambiguity_cycles("S2")
    step = float(np.mean(gamma[31:]) - np.mean(gamma[:29]))
    assert step == pytest.approx(25.0, abs=0.05)
    assert np.max(np.abs(smoothed.position_e_m - PLACE)) < 6.0 * np.max(smoothed.sigma[:, :3])
    assert np.all(smoothed.sigma[1:-1, :3] <= smoothed.sigma[-1, :3] * (1.0 + 1e-9))


def test_the_same_run_gives_the_same_bits_and_steps_make_a_batch() -> None:
    nav, twin, stepped = with_masts(), with_masts(), with_masts()
    t, phase, code = heard(nav, 30)
    run = go(nav, t, phase, code)
    np.testing.assert_array_equal(run.mean, go(twin, t, phase, code).mean)
    for k in range(30):
        rows: list[dict[str, Any]] = [
            {"source": s, "kind": "phase", "value": phase[k, s], "sigma": PHASE_SIGMA} for s in range(6)
        ]
        rows += [{"source": s, "kind": "pseudorange", "value": code[k, s], "sigma": 1.0} for s in range(6)]
        report = stepped.step(float(t[k]), rows)
        assert report.uses == (ObservableUse.ACCEPTED,) * 12
    np.testing.assert_array_equal(stepped.mean, run.mean[-1])
    assert np.all(np.isfinite(report.w))
    assert report.dof == 12


def test_the_announced_is_opened_and_noise_is_replaced() -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 40)
    go(nav, t[:20], phase[:20], code[:20])
    known = nav.source(3).ambiguity_sigma_cycles
    assert nav.open_ambiguity(3, 50.0)
    assert not nav.open_ambiguity(99, 50.0)
    assert not nav.open_ambiguity(3, np.nan)
    nav.step(2.0, [])
    assert nav.source(3).ambiguity_sigma_cycles == pytest.approx(50.0, rel=1e-3)
    assert known < 5.0
    before = nav.clock_covariance[0, 0]
    assert nav.open_clock(None, 1e-6)
    assert not nav.open_clock(0, 1e-6)
    nav.step(2.1, [])
    assert nav.clock_covariance[0, 0] == pytest.approx(before + 1e-12, rel=0.05)
    assert nav.set_clock_noise(None, TwoState.tcxo())
    assert not nav.set_clock_noise(None, (-1.0, 0.0))
    nav.step(12.1, [])
    assert nav.clock_covariance[0, 0] > before + 1e-12


def stage_errors(seed: int, sky: list[sn.geometry.SampledOrbit]) -> tuple[float, float, float]:
    """NEES of all, of the position and of the clock bias: six satellites and two masts, 17 states of pesyna's stages.

    Every truth is drawn from the prior that the navigator is given.
    """
    rng = np.random.default_rng(seed)
    t = np.asarray(0.5 * np.arange(40), np.float64)
    place = PLACE + 3.0 * rng.normal(size=3)
    start = np.array([3000.0, 30.0]) * rng.normal(size=2) / LIGHT_MPS
    own = TwoState.tcxo().simulate_at(t, seed=seed, stream=1, bias_s=float(start[0]), drift=float(start[1]))
    nav = OpportunisticNavigator(
        PLACE,
        position_sigma_m=3.0,
        clock=TwoState.tcxo(),
        clock_bias_sigma_s=3000.0 / LIGHT_MPS,
        clock_drift_sigma=30.0 / LIGHT_MPS,
        max_sources=8,
        fault_probability=1e-10,
    )
    truth = [*place, own.drift[-1] * LIGHT_MPS, own.bias_m[-1]]
    phase, code = [], []
    for k in range(8):
        gamma = 100.0 * rng.normal()
        known: dict[str, Any] = {"carrier_hz": 1575.42e6 if k < 6 else CARRIER_HZ, "ambiguity_sigma_cycles": 100.0}
        bias, drift = np.zeros(len(t)), np.zeros(len(t))
        if k < 6:
            orbit = sky[k]
            known |= {"orbit": orbit}
        else:
            mast = masts(8)[k]
            orbit = sn.geometry.SampledOrbit.fixed(mast)
            offset = np.array([1e-6, 1e-10]) * rng.normal(size=2)
            run = TwoState.ocxo().simulate_at(
                t, seed=seed, stream=10 + k, bias_s=float(offset[0]), drift=float(offset[1])
            )
            bias, drift = run.bias_m, run.drift * LIGHT_MPS
            known |= {"position_e_m": mast, "clock": TwoState.ocxo()}
            known |= {"clock_bias_sigma_s": 1e-6, "clock_drift_sigma": 1e-10}
            truth += [drift[-1], bias[-1]]
        truth.append(gamma)
        path = sn.geometry.signal_path(orbit, t - own.bias_m / LIGHT_MPS, np.tile(place, (len(t), 1)))
        metres = path.range_m + own.bias_m - bias + drift * (own.bias_m / LIGHT_MPS + path.delay_s)
        phase.append(metres * known["carrier_hz"] / LIGHT_MPS + gamma + PHASE_SIGMA * rng.normal(size=len(t)))
        code.append(metres + rng.normal(size=len(t)))
        nav.add_source(f"S{k}", "any", **known)
    found = go(nav, t, np.transpose(phase), np.transpose(code))
    assert found.slips == 0
    P, error = nav.covariance, nav.mean - np.array(truth)
    assert len(P) == 17

    def nees(part: slice) -> float:
        scale = 1.0 / np.sqrt(np.diag(P)[part])
        return float(
            (scale * error[part]) @ np.linalg.solve(scale[:, None] * P[part, part] * scale, scale * error[part])
        )

    return nees(slice(None)), nees(slice(0, 3)), nees(slice(4, 5))


def test_seventeen_states_of_a_stage_are_as_good_as_they_say() -> None:
    walker = sn.orbits.walker(
        24, 6, 2, inclination_rad=np.radians(55.0), altitude_m=20_200e3, start_s=-30.0, duration_s=90.0
    )
    elevation = sn.orbits.elevations(walker, np.array([0.0]), PLACE)[1][:, 0]
    sky = [walker[i] for i in np.argsort(-elevation)[:6]]
    runs = 40
    errors = np.array([stage_errors(seed, sky) for seed in range(runs)]).mean(axis=0)
    for name, value, dim in zip(("all", "position", "clock"), errors, (17, 3, 1), strict=True):
        low, high = sn.estimation.mean_nees_bounds(dim, runs, failure_probability=1e-4)
        assert low < value < high, name


@pytest.mark.parametrize("offset", [1e5, -1e9])
def test_a_first_phase_far_beyond_its_prior_moves_nothing_else(offset: float) -> None:
    nav = with_masts()
    t, phase, code = heard(nav, 40)
    run = go(nav, t[:-1], phase[:-1], code[:-1])
    before, sigma = nav.mean, np.sqrt(np.diag(nav.covariance))
    place = masts(7)[6]
    late = nav.add_source("late", "cdma", carrier_hz=CARRIER_HZ, position_e_m=place, ambiguity_sigma_cycles=100.0)
    expected = nav.expected(t[-1], {"source": late, "kind": "phase"})
    assert expected is not None
    report = nav.step(t[-1], [{"source": late, "kind": "phase", "value": expected[0] + offset, "sigma": PHASE_SIGMA}])
    assert run.slips == 0
    assert report.slips == 1
    assert report.uses == (ObservableUse.SLIP,)
    assert np.max(np.abs(nav.mean[: len(before)] - before)[:3] / sigma[:3]) < 1e-3
    assert nav.source(late).ambiguity_cycles == pytest.approx(offset, abs=10.0)
