"""The two halves of an ``ofdm_inertial`` scenario: what the sensors say, and what the navigator makes of it.

`sense` simulates (trajectories, inertial sensors, clocks, every epoch's IQ and its boundary) or reads recordings;
`navigate` runs the filter, as often as one likes on the same `Sensed`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp import ofdm, simulation
from soopnav_cpp.navigation import OfdmInertialNavigator, OfdmInertialRun, PlanarStart, RangeChanges
from soopnav_cpp.scenarios.files import ImuData, TruthData, read_imu, read_tdoa, read_truth
from soopnav_cpp.scenarios.ofdm_inertial import OfdmInertialScenario, OfdmSettings, ReceiverSettings

__all__ = ["Sensed", "navigate", "numerology", "range_changes", "sense", "starts", "trajectory_of"]

_Array = npt.NDArray[np.float64]
_Complex = npt.NDArray[np.complex128]

_C_MPS = 299_792_458.0
_SHIFTS = 15  # steps of a sample that "interpolate_and_shift" knows
# Streams of a run's seed.
_IMU, _CLOCK, _LINK, _REFERENCE, _REFLECTION, _BIAS = range(6)
_STREAMS = 1 << 12


@dataclass(frozen=True, eq=False)
class _Imu:
    t_s: _Array
    yaw_rate_radps: _Array
    specific_force_b_mps2: _Array


@dataclass(frozen=True, eq=False)
class Sensed:
    """What R receivers sensed: E epochs, K transmitters.

    Attributes
    ----------
    imu : sequence
        Of each receiver.
    tdoa : sequence of RangeChanges
        Of each receiver.
    reference : RangeChanges or None
    folded : ndarray, shape (R, E, K, M), or None
        Folded differences, for timing with the filter in the loop.
    reflection_gain : ndarray of complex, shape (R, E, K), or None
        Of the reflections, relative to the line of sight.
    clock_bias_m : ndarray, shape (E, K), or None
        Of the transmitters.
    trajectories : sequence or None
    recorded_truth : TruthData or None
    notes : tuple of str
    """

    imu: Sequence[Any]
    tdoa: Sequence[RangeChanges]
    reference: RangeChanges | None = None
    folded: _Array | None = None
    reflection_gain: _Complex | None = None
    clock_bias_m: _Array | None = None
    trajectories: Sequence[Any] | None = None
    recorded_truth: TruthData | None = None
    notes: tuple[str, ...] = ()

    def truth_at(self, t_s: _Array) -> list[_Array] | None:
        """Heading, velocity and position of each receiver, shapes (n, 5)."""
        if self.trajectories is not None:
            return [_states(trajectory, t_s) for trajectory in self.trajectories]
        if self.recorded_truth is None:
            return None
        truth, n = self.recorded_truth.at(t_s), len(t_s)
        heading = np.full(n, np.nan) if truth.heading_rad is None else truth.heading_rad
        velocity = np.full((n, 2), np.nan) if truth.velocity_mps is None else truth.velocity_mps[:, :2]
        return [np.column_stack([heading, velocity, truth.position_m[:, :2]])]


def _states(trajectory: Any, t_s: _Array) -> _Array:
    motion = trajectory.at(np.clip(t_s, 0.0, trajectory.duration_s))
    return np.column_stack([motion.heading_rad, motion.velocity_mps, motion.position_m])


def _stream(kind: int, index: int = 0) -> int:
    return kind * _STREAMS + index


def trajectory_of(receiver: ReceiverSettings, duration_s: float) -> Any:
    """The way a receiver takes, at 1000 Hz."""
    way = receiver.trajectory
    if way.kind == "continuous_turn":
        return simulation.PlanarTrajectory.continuous_turn(
            duration_s=duration_s,
            speed_mps=way.speed_mps,
            ramp_s=min(way.ramp_s, duration_s),
            turn_rate_radps=way.turn_rate_radps,
            turn_amplitude_radps=way.turn_amplitude_radps,
            turn_period_s=way.turn_period_s,
            heading_rad=math.radians(receiver.heading_deg),
            position_m=receiver.position_m,
        )
    trajectory = simulation.PlanarTrajectory.through(
        [receiver.position_m, *way.waypoints_m],
        speed_mps=way.speed_mps,
        max_acceleration_mps2=way.acceleration_mps2,
        max_lateral_acceleration_mps2=way.lateral_acceleration_mps2,
    )
    if trajectory.duration_s < duration_s:
        raise ValueError(
            f"trajectory: the way through waypoints_m takes {trajectory.duration_s:.1f} s, and duration_s is "
            f"{duration_s:g}; add waypoints, or shorten it"
        )
    return trajectory


def numerology(scenario: OfdmInertialScenario) -> ofdm.Numerology:
    """Of the scenario's signals."""
    signal = scenario.ofdm
    return ofdm.Numerology(signal.subcarriers, signal.prefix, signal.bandwidth_hz)


def starts(scenario: OfdmInertialScenario, sensed: Sensed) -> list[PlanarStart]:
    """What the receivers know when they set out."""
    if sensed.trajectories is None:
        receiver = scenario.all_receivers[0]
        return [PlanarStart(math.radians(receiver.heading_deg), receiver.velocity_mps, receiver.position_m)]
    out = []
    for trajectory in sensed.trajectories:
        s = _states(trajectory, np.zeros(1))[0]
        out.append(PlanarStart(float(s[0]), (float(s[1]), float(s[2])), (float(s[3]), float(s[4]))))
    return out


def _inertial(receiver: ReceiverSettings, index: int, trajectory: Any, duration_s: float, seed: int) -> Any:
    unit = receiver.imu
    series = trajectory.imu(
        unit.rate_hz,
        gyro_sigma_radps=unit.gyro_sigma_radps,
        accelerometer_sigma_mps2=unit.accelerometer_sigma_mps2,
        seed=seed,
        stream=_stream(_IMU, index),
    )
    within = series.t_s <= duration_s + 1e-9
    bias = np.random.default_rng([seed, _BIAS, index]).standard_normal(3)
    yaw = series.yaw_rate_radps[within] + unit.gyro_bias_radps * bias[0]
    force = series.specific_force_b_mps2[within] + unit.accelerometer_bias_mps2 * bias[1:]
    if unit.yaw_rate_range_radps is not None:
        yaw = np.clip(yaw, -unit.yaw_rate_range_radps, unit.yaw_rate_range_radps)
    if unit.specific_force_range_mps2 is not None:
        force = np.clip(force, -unit.specific_force_range_mps2, unit.specific_force_range_mps2)
    return _Imu(series.t_s[within], yaw, force)


def _clock_bias_m(scenario: OfdmInertialScenario, t_s: _Array, seed: int) -> _Array | None:
    """Of each transmitter at the epochs, shape (E, K)."""
    settings = scenario.transmitter_clocks
    if settings is None:
        return None
    from soopnav_cpp import clock

    model = clock.TwoState.from_noise(settings.white_frequency_m2ps, settings.frequency_walk_m2ps3)
    columns = [
        model.simulate_at(np.concatenate([[0.0], t_s]), seed=seed, stream=_stream(_CLOCK, k)).bias_m[1:]
        for k in range(len(scenario.transmitters))
    ]
    return np.column_stack(columns)


def _reflections(
    scenario: OfdmInertialScenario, t_s: _Array, position_m: _Array, receiver: int, seed: int
) -> tuple[_Array, _Complex] | None:
    """Extra path and complex gain for each epoch and transmitter, shapes (E, K)."""
    settings = scenario.reflector
    if settings is None:
        return None
    columns = [
        simulation.ricean_reflections(
            position_m,
            source,
            settings.position_m,
            mean=settings.mean,
            variance=settings.variance,
            seed=seed,
            stream=_stream(_REFLECTION, 64 * receiver + k),
        )
        for k, source in enumerate(scenario.transmitters_m)
    ]
    extra = np.column_stack([column[0] for column in columns])
    gain = np.column_stack([column[1] for column in columns])
    if settings.strength is not None:
        rng = np.random.default_rng([seed, _REFLECTION, receiver])
        phase = rng.uniform(0.0, 2.0 * math.pi, extra.shape)
        gain = rng.uniform(*settings.strength, extra.shape) * np.exp(1j * phase)
    if settings.blocks_s:
        inside = np.any([(t_s > low) & (t_s <= high) for low, high in settings.blocks_s], axis=0)
        gain = np.where(inside[:, None], gain, 0.0)
    return extra, gain


def _link(scenario: OfdmInertialScenario) -> Any:
    signal = scenario.ofdm
    return simulation.OfdmLink(
        numerology(scenario),
        signal.symbols,
        oversampling=signal.oversampling,
        movement=signal.movement,
        constellation=signal.constellation,
    )


def range_changes(
    scenario: OfdmInertialScenario,
    t_s: _Array,
    delay_m: _Array,
    seed: int,
    kind: int,
    index: int,
    reflections: tuple[_Array, _Complex] | None = None,
) -> tuple[RangeChanges, _Array | None]:
    """The boundaries of one receiver from the IQ of every epoch and transmitter, and the folded differences."""
    signal = scenario.ofdm
    link = _link(scenario)
    two_ray = signal.boundary == "two_ray"
    values, sigmas, folded = np.empty_like(delay_m), np.empty_like(delay_m), []
    for k in range(delay_m.shape[1]):
        series = link.measure(
            np.ascontiguousarray(delay_m[:, k]),
            method="interpolated" if two_ray else signal.boundary,
            seed=seed,
            stream=_stream(kind, 64 * index + k),
            snr_db=signal.snr_db,
            reflection_extra_m=None if reflections is None else np.ascontiguousarray(reflections[0][:, k]),
            reflection_gain=None if reflections is None else np.ascontiguousarray(reflections[1][:, k]),
            folded=two_ray,
        )
        values[:, k], sigmas[:, k] = series.range_m + _shift_m(signal), series.sigma_m
        if two_ray:
            folded.append(series.folded)
    if signal.range_sigma_m is not None:
        sigmas[:] = signal.range_sigma_m
    return RangeChanges(t_s, values, sigmas), np.stack(folded, axis=1) if two_ray else None


def _shift_m(signal: OfdmSettings) -> float:
    """Half of the whole steps by which "interpolate_and_shift" moves the signal: on average it falls short by that."""
    if signal.movement != "interpolate_and_shift":
        return 0.0
    return 0.5 * _C_MPS / (_SHIFTS * signal.bandwidth_hz)


def sense(scenario: OfdmInertialScenario, seed: int) -> Sensed:
    """Everything the navigator gets, simulated or read.

    Parameters
    ----------
    scenario : OfdmInertialScenario
    seed : int
        Of the run.
    """
    recorded = scenario.recorded
    if recorded.tdoa is not None:
        return _recorded(scenario, seed)
    interval = scenario.ofdm.update_interval_s
    t_s = interval * np.arange(1.0, math.floor(scenario.duration_s / interval + 1e-9) + 1.0)
    receivers = scenario.all_receivers
    trajectories = [trajectory_of(receiver, scenario.duration_s) for receiver in receivers]
    clock = _clock_bias_m(scenario, t_s, seed)
    imu, tdoa, folded, gains = [], [], [], []
    for index, (receiver, trajectory) in enumerate(zip(receivers, trajectories, strict=True)):
        imu.append(_inertial(receiver, index, trajectory, scenario.duration_s, seed))
        position = _states(trajectory, t_s)[:, 3:5]
        delay = _range_change(scenario, position, _states(trajectory, np.zeros(1))[0, 3:5])
        reflections = _reflections(scenario, t_s, position, index, seed)
        if clock is not None:
            delay = delay - clock
        changes, pairs = range_changes(scenario, t_s, delay, seed, _LINK, index, reflections)
        tdoa.append(changes)
        folded.append(pairs)
        gains.append(None if reflections is None else reflections[1])
    reference = None
    if scenario.reference_receiver is not None and scenario.reference_receiver.used:
        still = np.zeros((len(t_s), len(scenario.transmitters))) if clock is None else -clock
        plain = scenario.model_copy(update={"ofdm": _plain(scenario)})
        reference = range_changes(plain, t_s, still, seed, _REFERENCE, 0)[0]
    return Sensed(
        imu,
        tdoa,
        reference,
        None if folded[0] is None else np.stack(cast("list[_Array]", folded)),
        None if gains[0] is None else np.stack(cast("list[_Complex]", gains)),
        clock,
        trajectories,
    )


def _plain(scenario: OfdmInertialScenario) -> Any:
    signal = scenario.ofdm
    return signal.model_copy(update={"boundary": "interpolated"}) if signal.boundary == "two_ray" else signal


def _range_change(scenario: OfdmInertialScenario, position_m: _Array, start_m: _Array) -> _Array:
    sources = scenario.transmitters_m
    far = np.linalg.norm(position_m[:, None] - sources, axis=2)
    return np.asarray(far - np.linalg.norm(start_m - sources, axis=1))


def _recorded(scenario: OfdmInertialScenario, seed: int) -> Sensed:
    recorded = scenario.recorded
    assert recorded.tdoa is not None
    tdoa = read_tdoa(recorded.tdoa, repair=recorded.repair)
    order = _columns_of(scenario, tdoa.transmitters)
    c = _C_MPS
    values = np.full((len(tdoa.t_s), len(order)), np.nan)
    sigma = np.full_like(values, scenario.ofdm.range_sigma_m or _default_sigma_m(scenario))
    for k, column in enumerate(order):
        if column is None:
            continue
        values[:, k] = c * tdoa.tdoa_s[:, column]
        if tdoa.sigma_s is not None and scenario.ofdm.range_sigma_m is None:
            given = c * tdoa.sigma_s[:, column]
            sigma[:, k] = np.where(np.isnan(given), sigma[:, k], given)
    within = tdoa.t_s <= scenario.duration_s
    changes = RangeChanges(tdoa.t_s[within], values[within], sigma[within])
    notes = tuple(f"{recorded.tdoa.name}: {sentence}" for sentence in tdoa.dropped)
    truth = None
    if recorded.truth is not None:
        track = read_truth(recorded.truth, repair=recorded.repair)
        if track.t_s[0] > 0.0 or track.t_s[-1] < scenario.duration_s:
            raise ValueError(
                f"{recorded.truth}: {track.t_s[0]:g} … {track.t_s[-1]:g} s: 0 … duration_s = {scenario.duration_s:g} s "
                "expected"
            )
        truth = track
        notes += tuple(f"{recorded.truth.name}: {sentence}" for sentence in track.dropped)
    if recorded.imu is None:
        trajectory = trajectory_of(scenario.all_receivers[0], scenario.duration_s)
        imu = _inertial(scenario.all_receivers[0], 0, trajectory, scenario.duration_s, seed)
        return Sensed([imu], [changes], trajectories=None if truth else [trajectory], recorded_truth=truth, notes=notes)
    data = read_imu(recorded.imu, repair=recorded.repair)
    if isinstance(data, ImuData):
        raise ValueError(f"{recorded.imu}: the recording of a planar sensor expected (yaw_rate, specific_force_x, _y)")
    notes += tuple(f"{recorded.imu.name}: {sentence}" for sentence in data.dropped)
    keep = (data.t_s > 0.0) & (data.t_s <= scenario.duration_s + 1e-9)
    unit = _Imu(data.t_s[keep], data.yaw_rate_radps[keep], data.specific_force_mps2[keep])
    return Sensed([unit], [changes], recorded_truth=truth, notes=notes)


def _columns_of(scenario: OfdmInertialScenario, found: Sequence[str]) -> list[int | None]:
    """Which column belongs to each transmitter of the scenario: by its name, or its number from 1."""
    order: list[int | None] = []
    for k, item in enumerate(scenario.transmitters):
        names = [name for name in (item.name, str(k + 1)) if name in found]
        order.append(found.index(names[0]) if names else None)
    unknown = [name for i, name in enumerate(found) if i not in order]
    if unknown:
        raise ValueError(
            f"{scenario.recorded.tdoa}: {', '.join(unknown)}: no such transmitter; there are "
            f"{', '.join(scenario.transmitter_names)} (or their numbers from 1)"
        )
    return order


def _default_sigma_m(scenario: OfdmInertialScenario) -> float:
    """Of a boundary to the nearest sample."""
    signal = scenario.ofdm
    return _C_MPS / (signal.bandwidth_hz * signal.oversampling) / math.sqrt(12.0)


def _navigator(scenario: OfdmInertialScenario, sensed: Sensed, aided: bool) -> OfdmInertialNavigator:
    settings, unit = scenario.filter, scenario.all_receivers[0].imu
    clocks = scenario.transmitter_clocks if settings.clock_states else None
    multipath = None
    if settings.multipath_sigma_m is not None:
        multipath = (settings.multipath_sigma_m, settings.multipath_time_constant_s)
    recorded = scenario.recorded.tdoa is not None
    return OfdmInertialNavigator(
        scenario.transmitters_m,
        starts(scenario, sensed),
        gyro_sigma_radps=unit.gyro_sigma_radps,
        accelerometer_sigma_mps2=unit.accelerometer_sigma_mps2,
        ambiguity_m=None if recorded else numerology(scenario).ambiguity_m,
        gate_m=settings.gate_m,
        gate_sigmas=settings.gate_sigmas,
        gate_probability=settings.gate_probability,
        clock=None if clocks is None else (clocks.white_frequency_m2ps, clocks.frequency_walk_m2ps3),
        multipath=multipath,
        reference_receiver=aided and sensed.reference is not None,
        literal_transition=settings.literal_transition,
        yaw_rate_range_radps=unit.yaw_rate_range_radps,
        specific_force_range_mps2=unit.specific_force_range_mps2,
    )


def navigate(
    scenario: OfdmInertialScenario, sensed: Sensed, *, aided: bool = True, record_every: int | None = None
) -> OfdmInertialRun:
    """Run the filter over what was sensed.

    Parameters
    ----------
    scenario : OfdmInertialScenario
    sensed : Sensed
    aided : bool
        False: inertial navigation alone.
    record_every : int, optional
        Samples between rows; without it `output_rate_hz` decides.
    """
    navigator = _navigator(scenario, sensed, aided)
    if record_every is None:
        record_every = max(1, round(scenario.all_receivers[0].imu.rate_hz / scenario.output_rate_hz))
    imu = list(sensed.imu)
    if not aided:
        return navigator.run(imu, record_every=record_every)
    if sensed.folded is not None:
        return _with_two_rays(scenario, sensed, navigator, record_every)
    return navigator.run(imu, list(sensed.tdoa), reference=sensed.reference, record_every=record_every)


def _with_two_rays(
    scenario: OfdmInertialScenario, sensed: Sensed, navigator: OfdmInertialNavigator, record_every: int
) -> OfdmInertialRun:
    """The timing of each epoch starts from where the filter expects the boundary."""
    assert sensed.folded is not None
    folded, estimator = sensed.folded, ofdm.TwoRayTiming(numerology(scenario), scenario.ofdm.symbols)
    least = scenario.filter.prediction_sigma_m

    def timing(epoch: int, receiver: int, transmitter: int, expected_m: float, sigma_m: float) -> tuple[float, float]:
        found = estimator.estimate(folded[receiver, epoch, transmitter], expected_m, max(sigma_m, least))
        return (found.range_m, found.sigma_m) if found.status == ofdm.BoundaryStatus.OK else (math.nan, 1.0)

    return navigator.run(
        list(sensed.imu), reference=sensed.reference, record_every=record_every, timing=timing,
        epoch_t_s=sensed.tdoa[0].t_s,
    )  # fmt: skip
