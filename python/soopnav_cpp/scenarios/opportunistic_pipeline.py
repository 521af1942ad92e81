"""What a scenario of opportunistic navigation runs: clocks drawn, phases made, one navigator through all stages."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry, gnss
from soopnav_cpp.clock import TwoState, allan_deviation, characterize, coherence_time, mean_squared_coherence
from soopnav_cpp.navigation import OpportunisticNavigator
from soopnav_cpp.scenarios.base import Truth

if TYPE_CHECKING:
    from soopnav_cpp.scenarios.opportunistic import OpportunisticScenario, OpportunisticSystemRun

__all__ = ["L1_HZ", "clock_deviation", "numbers", "run", "stage_3_cycles"]

_Array = npt.NDArray[np.float64]
L1_HZ = 1575.42e6
_LIGHT_MPS = 299_792_458.0
_WEEK = 2200
_NOON_S = 302_400.0
_GUESS = TwoState(1e-22, 1e-24)  # of a basestation before it is characterised


@dataclass(frozen=True)
class _Signal:
    """One column of the observables."""

    name: str
    kind: str
    carrier_hz: float
    heard: npt.NDArray[np.bool_]
    phase_cycles: _Array
    sigma_cycles: float
    code_m: _Array
    code_sigma_m: float
    positions_e_m: _Array  # (n, 3)
    noise: TwoState | None = None  # of its clock; None: exact


@dataclass(frozen=True)
class _World:
    t_s: _Array
    place_e_m: _Array
    axes: _Array  # rows: east, north, up
    clock: TwoState
    clock_s: _Array
    drift: _Array
    signals: tuple[_Signal, ...]


def _phase_sigma_cycles(cn0_dbhz: float, dt_s: float) -> float:
    return math.sqrt(1.0 / (2.0 * 10.0 ** (cn0_dbhz / 10.0) * dt_s)) / (2.0 * math.pi)


def _oscillator(scenario: OpportunisticScenario) -> TwoState:
    receiver = scenario.receiver
    if receiver.oscillator == "other":
        return TwoState(receiver.h0, receiver.h_minus_2)
    return TwoState.tcxo() if receiver.oscillator == "tcxo" else TwoState.ocxo()


def _made(scenario: OpportunisticScenario, seed: int) -> _World:
    """Clocks and phases, drawn from the seed."""
    receiver, dt = scenario.receiver, scenario.receiver.interval_s
    n = math.floor(scenario.duration_s / dt + 1e-9)
    t = dt * np.arange(n)
    rng = np.random.default_rng([seed, 0x6F70_706F])
    frame = geometry.LocalFrame(
        math.radians(receiver.latitude_deg), math.radians(receiver.longitude_deg), receiver.height_m
    )
    place = np.asarray(frame.position_to_ecef(np.zeros(3)), np.float64)
    axes = np.asarray(frame.position_to_ecef(np.eye(3)) - place, np.float64)
    clock = _oscillator(scenario)
    own = clock.simulate(dt, n, seed=seed, stream=0)
    true_s = t - own.bias_s
    signals = []
    if scenario.gps.count:
        sky = gnss.walker_constellation(30, 6, 1, week=_WEEK, toe_s=_NOON_S)
        prn = np.array(sky.prns)
        seen = gnss.sights(sky, prn, _NOON_S + true_s, _WEEK, place)
        least = np.nanmin(seen.elevation_rad, axis=0)
        up = [int(j) for j in np.argsort(-least) if least[j] > math.radians(scenario.gps.mask_deg)]
        back = math.inf if scenario.gps_returns_s is None else scenario.gps_returns_s
        sigma = _phase_sigma_cycles(scenario.gps.cn0_dbhz, dt)
        for j in up[: scenario.gps.count]:
            ranges = seen.range_m[:, j] + _LIGHT_MPS * own.bias_s
            signals.append(
                _Signal(
                    name=f"G{prn[j]:02d}",
                    kind="gps",
                    carrier_hz=L1_HZ,
                    heard=(t < scenario.stage_3_s) | (t >= back),
                    phase_cycles=ranges * L1_HZ / _LIGHT_MPS + rng.uniform(-1e5, 1e5) + rng.normal(0.0, sigma, n),
                    sigma_cycles=sigma,
                    code_m=ranges + rng.normal(0.0, scenario.gps.code_sigma_m, n),
                    code_sigma_m=scenario.gps.code_sigma_m,
                    positions_e_m=np.ascontiguousarray(seen.position_m[:, j]),
                )
            )
    for i, tower in enumerate(scenario.basestations):
        noise = TwoState(tower.h0, tower.h_minus_2)
        theirs = noise.simulate(dt, n, seed=seed, stream=1 + i).bias_s
        where = np.asarray(frame.position_to_ecef(np.array(tower.position_m)), np.float64)
        path_s = float(np.linalg.norm(where - place)) / _LIGHT_MPS
        sigma = _phase_sigma_cycles(tower.cn0_dbhz, dt)
        joins = scenario.stage_2_s if tower.joins_s is None else tower.joins_s
        leaves = math.inf if tower.leaves_s is None else tower.leaves_s
        signals.append(
            _Signal(
                name=tower.name,
                kind="cdma",
                carrier_hz=tower.carrier_hz,
                heard=(t >= joins) & (t < leaves),
                phase_cycles=tower.carrier_hz * (path_s + own.bias_s - theirs)
                + rng.uniform(-1e5, 1e5)
                + rng.normal(0.0, sigma, n),
                sigma_cycles=sigma,
                code_m=np.full(n, np.nan),
                code_sigma_m=1.0,
                positions_e_m=np.broadcast_to(where, (n, 3)),
                noise=noise,
            )
        )
    return _World(np.asarray(t, np.float64), place, axes, clock, own.bias_s, own.drift, tuple(signals))


@dataclass(frozen=True)
class _Pass:
    clock_s: _Array
    clock_sigma_s: _Array
    position_e_m: _Array
    covariance_m2: _Array
    smoothed_s: _Array
    slips: int
    unobservable: tuple[str, ...]


def _filtered(
    scenario: OpportunisticScenario, world: _World, start_e_m: _Array, noises: dict[str, TwoState], *, until: int
) -> _Pass:
    """The navigator through the first `until` epochs; sources join when they are heard and leave when they are not."""
    navigator = OpportunisticNavigator(
        start_e_m,
        clock=world.clock,
        position_sigma_m=scenario.receiver.position_sigma_m,
        clock_bias_sigma_s=1e-5,
        clock_drift_sigma=1e-8,
        max_sources=max(1, len(world.signals)),
    )
    heard = (
        np.stack([s.heard[:until] for s in world.signals], axis=1) if world.signals else np.zeros((until, 0), np.bool_)
    )
    changes = np.flatnonzero((heard[1:] != heard[:-1]).any(axis=1)) + 1
    edges = [0, *(int(c) for c in changes), until]
    navigator.start_recording(until)
    present: dict[int, int] = {}
    bias, sigma = np.empty(until), np.empty(until)
    position, covariance = np.empty((until, 3)), np.empty((until, 3, 3))
    slips = 0
    unobservable: tuple[str, ...] = ()
    for first, last in itertools.pairwise(edges):
        rows = slice(first, last)
        for j, signal in enumerate(world.signals):
            if heard[first, j] and j not in present:
                guess = signal.phase_cycles[first]
                options: dict[str, Any] = {}
                if signal.noise is not None:
                    options = {
                        "position_e_m": signal.positions_e_m[0],
                        "clock": noises[signal.name],
                        "clock_bias_sigma_s": 1e-6,
                        "clock_drift_sigma": 1e-10,
                    }
                present[j] = navigator.add_source(
                    signal.name,
                    signal.kind,
                    carrier_hz=signal.carrier_hz,
                    ambiguity_cycles=float(guess if signal.noise is not None else 0.0),
                    ambiguity_sigma_cycles=3e5,
                    **options,
                )
            elif not heard[first, j] and j in present:
                navigator.remove_source(present.pop(j))
        columns = sorted(present)
        used = [world.signals[j] for j in columns]
        m = last - first
        phase = np.stack([s.phase_cycles[rows] for s in used], axis=1) if used else np.zeros((m, 0))
        done = navigator.run(
            world.t_s[rows],
            phase,
            np.array([s.sigma_cycles for s in used]),
            pseudorange_m=np.stack([s.code_m[rows] for s in used], axis=1) if used else np.zeros((m, 0)),
            pseudorange_sigma_m=np.array([s.code_sigma_m for s in used]),
            source_position_e_m=np.stack([s.positions_e_m[rows] for s in used], axis=1) if used else None,
            sources=[present[j] for j in columns],
            record=True,
            covariance=True,
        )
        bias[rows], sigma[rows] = done.clock_bias_s, done.clock_bias_sigma_s
        position[rows] = done.position_e_m
        at = [done.column(f"position {axis}") for axis in "xyz"]
        if done.covariance is not None:
            covariance[rows] = done.covariance[:, at][:, :, at]
        slips += done.slips
        if used and all(s.noise is not None for s in used):
            unobservable = navigator.unobservable(32)
    smoothed = navigator.smooth().clock_bias_s
    return _Pass(bias, sigma, position, covariance, smoothed, slips, unobservable)


def _characterised(scenario: OpportunisticScenario, world: _World, start_e_m: _Array) -> dict[str, TwoState]:
    """Noise of the basestations as stage 2 has it: the satellites' clock less each phase, by innovation likelihood."""
    dt = scenario.receiver.interval_s
    until = min(math.ceil(scenario.stage_3_s / dt - 1e-9), len(world.t_s))
    towers = [s for s in world.signals if s.noise is not None]
    sky = [s for s in world.signals if s.noise is None]
    found = {s.name: _GUESS for s in towers}
    if not sky:
        return found
    place = _filtered(scenario, world, start_e_m, found, until=until).position_e_m[-1]
    # The mean over the satellites of phase less range, in seconds: the receiver's clock and a constant.
    by_sky = np.mean(
        [
            s.phase_cycles[:until] / s.carrier_hz - np.linalg.norm(s.positions_e_m[:until] - place, axis=1) / _LIGHT_MPS
            for s in sky
        ],
        axis=0,
    )
    sky_sigma = sky[0].sigma_cycles / L1_HZ / math.sqrt(len(sky))
    for tower in towers:
        both = np.where(tower.heard[:until], by_sky - tower.phase_cycles[:until] / tower.carrier_hz, np.nan)
        seen = np.flatnonzero(np.isfinite(both))
        if len(seen) < 100:
            continue
        sigma = math.hypot(sky_sigma, tower.sigma_cycles / tower.carrier_hz)
        found[tower.name] = characterize(both[seen[0] : seen[-1] + 1], dt, sigma).clocks[0]
    return found


def _taken(scenario: OpportunisticScenario, world: _World, start_e_m: _Array) -> dict[str, TwoState]:
    true = {s.name: s.noise for s in world.signals if s.noise is not None}
    if scenario.characterization == "true":
        return true
    if scenario.characterization == "wrong":
        factors = (100.0, 0.01)
        return {
            name: TwoState(noise.h0 * factors[i % 2], noise.h_minus_2 * factors[i % 2])
            for i, (name, noise) in enumerate(true.items())
        }
    return _characterised(scenario, world, start_e_m)


def run(scenario: OpportunisticScenario, seed: int) -> OpportunisticSystemRun:
    """One run: all randomness comes from the seed."""
    from soopnav_cpp.scenarios.opportunistic import OpportunisticSystemRun

    world = _made(scenario, seed)
    rng = np.random.default_rng([seed, 0x7374_6172])
    start = world.place_e_m + rng.normal(0.0, scenario.receiver.position_sigma_m, 3)
    noises = _taken(scenario, world, start)
    done = _filtered(scenario, world, start, noises, until=len(world.t_s))
    t = world.t_s
    stage = np.where(t < scenario.stage_2_s, 1, np.where(t < scenario.stage_3_s, 2, 3))
    if scenario.gps_returns_s is not None:
        stage[t >= scenario.gps_returns_s] = 2
    notes = []
    got = sum(s.kind == "gps" for s in world.signals)
    if got < scenario.gps.count:
        notes.append(
            f"{got} of {scenario.gps.count} satellites stand above {scenario.gps.mask_deg:g} degrees throughout"
        )
    silent = ~np.any([s.heard for s in world.signals], axis=0) if world.signals else np.ones(len(t), np.bool_)
    if silent.any():
        notes.append(f"nothing is heard for {scenario.receiver.interval_s * silent.sum():.1f} s: the navigator coasts")
    if done.unobservable:
        notes.append("without GPS these are not observable: " + "; ".join(done.unobservable[:4]))
    error = (done.position_e_m - world.place_e_m) @ world.axes.T
    return OpportunisticSystemRun(
        t_s=t,
        position_m=error,
        position_covariance_m2=world.axes @ done.covariance_m2 @ world.axes.T,
        state_names=("x_m", "y_m", "z_m", "clock_bias_m"),
        state=np.column_stack([error, _LIGHT_MPS * done.clock_s]),
        covariance=_with_clock(world.axes @ done.covariance_m2 @ world.axes.T, _LIGHT_MPS * done.clock_sigma_s),
        truth=Truth(
            position_m=np.zeros_like(error),
            state=np.column_stack([np.zeros_like(error), _LIGHT_MPS * world.clock_s]),
        ),
        sources={t.name: np.array(t.position_m) for t in scenario.basestations},
        notes=tuple(notes),
        origin_lla_deg=(
            scenario.receiver.latitude_deg,
            scenario.receiver.longitude_deg,
            scenario.receiver.height_m,
        ),
        clock_error_s=done.clock_s - world.clock_s,
        clock_sigma_s=done.clock_sigma_s,
        smoothed_error_s=done.smoothed_s - world.clock_s,
        clock_true_s=world.clock_s,
        stage=stage.astype(np.int64),
        heard={s.name: s.heard for s in world.signals},
        noise={s.name: (s.noise, noises[s.name]) for s in world.signals if s.noise is not None},
        slips=done.slips,
        unobservable=done.unobservable,
    )


def _with_clock(position: _Array, clock_sigma_m: _Array) -> _Array:
    """Block covariance of position and clock; what correlates them is left out."""
    out = np.zeros((len(clock_sigma_m), 4, 4))
    out[:, :3, :3] = position
    out[:, 3, 3] = clock_sigma_m**2
    return out


def stage_3_cycles(run: Any) -> _Array:
    """The smoothed clock's error while there is no GPS, a straight line taken out [L1 cycles]."""
    error = L1_HZ * run.smoothed_error_s[run.stage == 3]
    at = np.linspace(-1.0, 1.0, len(error))
    return np.asarray(error - np.polyval(np.polyfit(at, error, 1), at), np.float64)


def numbers(scenario: OpportunisticScenario, run: Any) -> dict[str, Any]:
    """Of the clock without GPS, and of the characterisation."""
    cycles = stage_3_cycles(run)
    dt = scenario.receiver.interval_s
    found: dict[str, Any] = {
        "gps_clock_rms_s": float(np.sqrt(np.mean(run.smoothed_error_s[run.stage == 2] ** 2))),
        "worst_phase_without_gps_cycles": float(np.abs(cycles).max()),
        "clock_drift_without_gps_s": float(np.ptp(run.clock_error_s[run.stage == 3])),
        "slips": run.slips,
        "unobservable": list(run.unobservable),
    }
    if len(cycles) >= 20:
        curve = mean_squared_coherence(cycles, dt)
        found["coherence_time_s"], found["coherent_all_along"] = coherence_time(curve.tau_s, curve.mean_squared)
    for name, (true, taken) in run.noise.items():
        found[f"{name}_h0_over_true"] = taken.h0 / true.h0 if true.h0 > 0.0 else None
        found[f"{name}_h_minus_2_over_true"] = taken.h_minus_2 / true.h_minus_2 if true.h_minus_2 > 0.0 else None
    return found


def clock_deviation(run: Any, dt_s: float) -> tuple[_Array, _Array]:
    """Averaging times and Allan deviation of the smoothed receiver's clock."""
    found = allan_deviation(run.smoothed_error_s + run.clock_true_s, dt_s)
    return found.tau_s, found.deviation
