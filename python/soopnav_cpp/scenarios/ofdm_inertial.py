"""Scenarios of planar inertial navigation on OFDM signals: ``system = "ofdm_inertial"`` (crosby)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import InputFile, Model
from soopnav_cpp.estimation import UpdateStatus
from soopnav_cpp.navigation import OfdmInertialRun
from soopnav_cpp.scenarios.base import Scenario, SystemRun, Truth, Updates
from soopnav_cpp.scenarios.registry import register

__all__ = [
    "ClockSettings",
    "FilterSettings",
    "ImuSettings",
    "OfdmInertial",
    "OfdmInertialScenario",
    "OfdmSettings",
    "ReceiverSettings",
    "RecordedSettings",
    "ReferenceSettings",
    "ReflectorSettings",
    "TrajectorySettings",
    "TransmitterSettings",
]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
_MOST_EPOCHS = 100_000
_MOST_SAMPLES = 20_000_000
_MOST_SYMBOLS = 65_536  # of an epoch, one more being sent
_MOST_IQ = 1 << 24
_MOST_PROFILE = 256  # samples of a symbol that the estimators between samples know profiles of


def _two_numbers(value: object) -> object:
    if isinstance(value, list) and len(value) == 2 and all(isinstance(v, (int, float)) for v in value):
        return (float(value[0]), float(value[1]))
    if isinstance(value, tuple):
        return value
    raise ValueError("a list of two numbers expected")


Vector2 = Annotated[tuple[float, float], pydantic.BeforeValidator(_two_numbers)]


class ImuSettings(Model):
    """The inertial sensors, and what a simulation makes of them.

    Attributes
    ----------
    rate_hz : float
        Samples per second.
    gyro_sigma_radps, accelerometer_sigma_mps2 : float
        White noise of each sample; the filter is told the same.
    gyro_bias_radps, accelerometer_bias_mps2 : float
        Standard deviation of a constant bias, drawn for each run; the filter does not know of it.
    yaw_rate_range_radps, specific_force_range_mps2 : float
        Where they saturate.
    """

    rate_hz: Annotated[float, Field(gt=0.0, le=10_000.0)] = 50.0
    gyro_sigma_radps: NotNegative = 0.1
    accelerometer_sigma_mps2: NotNegative = 0.1
    gyro_bias_radps: NotNegative = 0.0
    accelerometer_bias_mps2: NotNegative = 0.0
    yaw_rate_range_radps: Positive | None = None
    specific_force_range_mps2: Positive | None = None


class TrajectorySettings(Model):
    """How a receiver moves: from rest into a turn that never settles, or through waypoints.

    Attributes
    ----------
    kind : str
        "continuous_turn": speed by a quintic ramp, heading rate turn_rate + turn_amplitude sin(2 pi t / turn_period).
        "waypoints": from rest at the start through the waypoints, with bounded accelerations.
    speed_mps : float
        That is reached.
    ramp_s : float
        Until it is.
    turn_rate_radps, turn_amplitude_radps, turn_period_s : float
        Of the turn.
    waypoints_m : list
        Behind the receiver's own position.
    acceleration_mps2, lateral_acceleration_mps2 : float
        Bounds between waypoints.
    """

    kind: Literal["continuous_turn", "waypoints"] = "continuous_turn"
    speed_mps: Positive = 8.0
    ramp_s: Positive = 10.0
    turn_rate_radps: float = 0.035
    turn_amplitude_radps: float = 0.10
    turn_period_s: Positive = 40.0
    waypoints_m: list[Vector2] = Field(default_factory=list)
    acceleration_mps2: Positive = 1.0
    lateral_acceleration_mps2: Positive = 2.0

    @pydantic.model_validator(mode="after")
    def _has_waypoints(self) -> TrajectorySettings:
        if (self.kind == "waypoints") != bool(self.waypoints_m):
            raise ValueError('kind = "waypoints" and waypoints_m go together')
        return self


class ReceiverSettings(Model):
    """A receiver that moves. It knows its start.

    Attributes
    ----------
    position_m : list of two numbers
        At the start.
    heading_deg : float
        At the start, from the first axis towards the second. A drive through waypoints sets out along its way.
    velocity_mps : list of two numbers
        At the start of a recording; a simulated drive begins at rest.
    imu, trajectory : table
    """

    position_m: Vector2 = (0.0, 0.0)
    heading_deg: float = 0.0
    velocity_mps: Vector2 = (0.0, 0.0)
    imu: ImuSettings = ImuSettings()
    trajectory: TrajectorySettings = TrajectorySettings()


class TransmitterSettings(Model):
    """A transmitter at a known place.

    Attributes
    ----------
    position_m : list of two numbers
    name : str
        For the report; without one they are counted.
    """

    position_m: Vector2
    name: str = ""


class OfdmSettings(Model):
    """The signals, and how their block boundaries are measured.

    Attributes
    ----------
    bandwidth_hz : float
        Sampling rate of the transmitters.
    subcarriers, prefix : int
        Samples of a symbol and of its cyclic prefix.
    constellation : str
    symbols : int
        Averaged over in each epoch.
    oversampling : int
        The receiver's sampling rate over the transmitters': 15 makes 20 MHz to 300 MHz.
    movement : str
        "interpolate_and_shift": whole steps of a fifteenth of a sample, as crosby simulates it; "fractional_delay":
        true delays.
    boundary : str
        "nearest_sample" (crosby 2.4), "magnitude" (for any carrier offset), "maximum_likelihood" (van de Beek),
        "interpolated" (between samples), "two_ray" (between samples, aware of one reflection, with the filter's
        prediction).
    snr_db : float
        Per sample at the receiver's own rate; without it there is no noise.
    update_interval_s : float
        Between epochs.
    range_sigma_m : float
        Standard deviation of a boundary that the filter is told; without it, what the estimator says.
    """

    bandwidth_hz: Annotated[float, Field(ge=1e3, le=1e9)] = 20e6
    subcarriers: Annotated[int, Field(ge=2, le=8192)] = 64
    prefix: Annotated[int, Field(ge=1, le=8192)] = 16
    constellation: Literal["qpsk", "16qam", "64qam"] = "qpsk"
    symbols: Annotated[int, Field(ge=1, le=_MOST_SYMBOLS - 1)] = 250
    oversampling: Literal[1, 15] = 1
    movement: Literal["interpolate_and_shift", "fractional_delay"] = "interpolate_and_shift"
    boundary: Literal["nearest_sample", "magnitude", "maximum_likelihood", "interpolated", "two_ray"] = "nearest_sample"
    snr_db: Annotated[float, Field(ge=-60.0, le=100.0)] | None = None
    update_interval_s: Positive = 1.0
    range_sigma_m: Positive | None = None

    @pydantic.model_validator(mode="after")
    def _fits(self) -> OfdmSettings:
        if self.boundary in ("interpolated", "two_ray") and self.oversampling != 1:
            raise ValueError(f'boundary = "{self.boundary}" works at oversampling = 1')
        if self.boundary in ("interpolated", "two_ray") and self.movement != "fractional_delay":
            raise ValueError(f'boundary = "{self.boundary}" expects true delays: movement = "fractional_delay"')
        period = self.subcarriers + self.prefix
        if self.boundary in ("interpolated", "two_ray") and period > _MOST_PROFILE:
            raise ValueError(f'boundary = "{self.boundary}": at most {_MOST_PROFILE} samples per symbol, got {period}')
        if (self.symbols + 1) * period * self.oversampling > _MOST_IQ:
            raise ValueError(f"symbols: more than {_MOST_IQ} samples in an epoch")
        if self.prefix >= self.subcarriers:
            raise ValueError(f"prefix: {self.prefix} must be shorter than the {self.subcarriers} samples of a symbol")
        return self


class ReflectorSettings(Model):
    """Something that reflects every transmitter's signal to every receiver, each time anew.

    Attributes
    ----------
    position_m : list of two numbers
    mean, variance : float
        Ricean strength relative to the line of sight: a normal of this mean and a second one of mean 0, both of this
        variance, as real and imaginary part (crosby 3.13).
    strength : list of two numbers
        In place of them: uniform between the two, of any phase.
    blocks_s : list of pairs
        Reflects between these times only; without them always.
    """

    position_m: Vector2
    mean: float = 0.33
    variance: NotNegative = 0.0625
    strength: Vector2 | None = None
    blocks_s: list[Vector2] = Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def _fits(self) -> ReflectorSettings:
        if self.strength is not None and not 0.0 <= self.strength[0] <= self.strength[1]:
            raise ValueError("strength: two numbers that rise, none negative, expected")
        for low, high in self.blocks_s:
            if not low < high:
                raise ValueError(f"blocks_s: [{low:g}, {high:g}] does not rise")
        return self


class ClockSettings(Model):
    """Clocks of the transmitters, which start in step and wander, each on its own.

    Attributes
    ----------
    white_frequency_m2ps : float
        Power density of the bias' random walk, times c^2 [(m/s)^2/Hz].
    frequency_walk_m2ps3 : float
        Of the drift's [(m/s^2)^2/Hz].
    """

    white_frequency_m2ps: NotNegative = 0.036
    frequency_walk_m2ps3: NotNegative = 0.141


class ReferenceSettings(Model):
    """A receiver that stands still, and tells its boundaries.

    Attributes
    ----------
    used : bool
    """

    used: bool = True


class FilterSettings(Model):
    """The filter.

    Attributes
    ----------
    gate_m : float
        Boundaries whose innovation lies beyond it are refused ...
    gate_sigmas : float
        ... unless it lies within so many of its own standard deviations.
    gate_probability : float
        Beside it a chi-square gate that refuses a good boundary with this probability.
    clock_states : bool
        The transmitters' clocks are estimated.
    multipath_sigma_m, multipath_time_constant_s : float
        A bias of each link is estimated, of this spread and correlation time.
    prediction_sigma_m : float
        Least spread of the prediction that two-ray timing starts from.
    literal_transition : bool
        crosby's constant transition, which is overconfident.
    """

    gate_m: Positive | None = None
    gate_sigmas: NotNegative = 4.0
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    clock_states: bool = False
    multipath_sigma_m: Positive | None = None
    multipath_time_constant_s: Positive = 10.0
    prediction_sigma_m: Positive = 1.0
    literal_transition: bool = False


class RecordedSettings(Model):
    """Recordings in place of simulated sensors; what is missing is simulated.

    Attributes
    ----------
    imu : file
        CSV: time_s, yaw_rate_radps, specific_force_x_mps2, specific_force_y_mps2 (other units by the name's end).
    tdoa : file
        CSV: time_s and a column tdoa_NAME_m (or _s, _ns) for each transmitter, its name or its number from 1: later
        than at the start is positive.
    truth : file
        CSV: time_s, position_x_m, position_y_m, and perhaps velocity and heading.
    repair : bool
        Leave rows out that cannot be used, instead of refusing the file.
    """

    imu: InputFile | None = None
    tdoa: InputFile | None = None
    truth: InputFile | None = None
    repair: bool = False


class OfdmInertialScenario(Scenario):
    """One or more receivers with inertial sensors among OFDM transmitters.

    Attributes
    ----------
    receiver : table
        The one receiver; ``receivers`` in its place for several.
    receivers : list of tables
        The report is of the first.
    transmitters : list of tables
    ofdm, reflector, transmitter_clocks, reference_receiver, filter, recorded : table
    output_rate_hz : float
        Rows per second of what is written.
    """

    receiver: ReceiverSettings | None = None
    receivers: list[ReceiverSettings] = Field(default_factory=list, max_length=16)
    transmitters: Annotated[list[TransmitterSettings], Field(min_length=1, max_length=64)]
    ofdm: OfdmSettings = OfdmSettings()
    reflector: ReflectorSettings | None = None
    transmitter_clocks: ClockSettings | None = None
    reference_receiver: ReferenceSettings | None = None
    filter: FilterSettings = FilterSettings()
    recorded: RecordedSettings = RecordedSettings()
    output_rate_hz: Positive = 10.0

    @pydantic.model_validator(mode="after")
    def _fits(self) -> OfdmInertialScenario:
        if self.receiver is not None and self.receivers:
            raise ValueError("receiver and receivers exclude each other")
        if any(item.imu != self.all_receivers[0].imu for item in self.all_receivers):
            raise ValueError("receivers: all have the same imu; the filter has one set of its numbers")
        if self.duration_s / self.ofdm.update_interval_s > _MOST_EPOCHS:
            raise ValueError(f"ofdm.update_interval_s: more than {_MOST_EPOCHS} epochs in duration_s")
        if self.duration_s * self.all_receivers[0].imu.rate_hz > _MOST_SAMPLES:
            raise ValueError(f"imu.rate_hz: more than {_MOST_SAMPLES} samples in duration_s")
        if self.receiver is not None and self.receiver.velocity_mps != (0.0, 0.0) and not self.recorded.imu:
            raise ValueError("receiver.velocity_mps: a simulated drive begins at rest")
        if self.duration_s < self.ofdm.update_interval_s:
            raise ValueError(f"duration_s: shorter than ofdm.update_interval_s = {self.ofdm.update_interval_s:g}")
        if (self.recorded.imu or self.recorded.tdoa) and len(self.all_receivers) > 1:
            raise ValueError("recorded: recordings are of one receiver")
        if self.recorded.tdoa and self.ofdm.boundary == "two_ray":
            raise ValueError('recorded.tdoa: boundary = "two_ray" needs the signal itself')
        if self.recorded.imu and not self.recorded.tdoa:
            raise ValueError("recorded.imu: needs recorded.tdoa, for nobody knows where such a receiver was")
        if self.filter.clock_states and self.transmitter_clocks is None:
            raise ValueError("filter.clock_states: needs transmitter_clocks, which says how they wander")
        return self

    @property
    def all_receivers(self) -> list[ReceiverSettings]:
        """The receivers, however they were written."""
        return self.receivers or [self.receiver or ReceiverSettings()]

    @property
    def transmitters_m(self) -> _Array:
        """Positions, shape (K, 2)."""
        return np.array([item.position_m for item in self.transmitters])

    @property
    def transmitter_names(self) -> tuple[str, ...]:
        """Names, or numbers from 1."""
        return tuple(item.name or f"transmitter {i + 1}" for i, item in enumerate(self.transmitters))


EXAMPLE = """\
# Three OFDM transmitters aid a cheap inertial sensor (crosby fig. 4.1).
system = "ofdm_inertial"
title = "Three transmitters, 20 MHz"
duration_s = 120.0

[receiver.imu]
rate_hz = 50.0
accelerometer_sigma_mps2 = 0.1
gyro_sigma_radps = 0.1

[[transmitters]]
position_m = [1000.0, 1500.0]
[[transmitters]]
position_m = [-2000.0, 1000.0]
[[transmitters]]
position_m = [500.0, -2000.0]

[ofdm]
bandwidth_hz = 20e6
symbols = 250
boundary = "nearest_sample"
"""


@register
class OfdmInertial:
    """Simulates or reads the sensors, navigates, and says what came of it."""

    name = "ofdm_inertial"
    title = "planar inertial navigation on the block boundaries of OFDM transmitters (crosby)"
    scenario = OfdmInertialScenario
    example = EXAMPLE

    def check(self, scenario: OfdmInertialScenario) -> None:
        """Read what a scenario names, once and before any run."""
        from soopnav_cpp.scenarios import ofdm_inertial_pipeline as pipeline

        if scenario.recorded.tdoa is not None:
            pipeline.sense(scenario, scenario.seed)

    def run(self, scenario: OfdmInertialScenario, seed: int) -> SystemRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.scenarios import ofdm_inertial_pipeline as pipeline

        sensed = pipeline.sense(scenario, seed)
        run = pipeline.navigate(scenario, sensed)
        alone = pipeline.navigate(scenario, sensed, aided=False)
        return to_system_run(scenario, sensed, run, alone)


def to_system_run(
    scenario: OfdmInertialScenario, sensed: Any, run: OfdmInertialRun, alone: OfdmInertialRun
) -> SystemRun:
    """What the reports are made of: the first receiver's trajectory, all receivers' states."""
    count = len(run.firsts)
    kept = [first + i for first in run.firsts for i in range(5)]
    words = ("heading_rad", "velocity_x_mps", "velocity_y_mps", "x_m", "y_m")
    names = tuple(word if count == 1 else f"receiver_{r + 1}_{word}" for r in range(count) for word in words)
    truth = sensed.truth_at(run.t_s)
    links = run.links
    epochs, receivers, transmitters = links.status.shape
    gate = scenario.filter.gate_m
    sources = {f"{name}": at for name, at in zip(scenario.transmitter_names, scenario.transmitters_m, strict=True)}
    if scenario.reflector is not None:
        sources["reflector"] = np.array(scenario.reflector.position_m)
    link_names = tuple(
        name if receivers == 1 else f"receiver {r + 1}, {name}"
        for r in range(receivers)
        for name in scenario.transmitter_names
    )
    return SystemRun(
        t_s=run.t_s,
        position_m=run.position_m,
        position_covariance_m2=run.position_covariance_m2,
        velocity_mps=run.velocity_mps,
        heading_rad=run.heading_rad,
        state_names=names,
        state=run.state[:, kept],
        covariance=run.covariance[np.ix_(range(len(run.t_s)), kept, kept)],
        truth=None if truth is None else _truth(truth),
        updates=Updates(
            t_s=np.repeat(run.epoch_t_s, receivers * transmitters),
            source=np.tile(np.arange(receivers * transmitters), epochs),
            innovation=links.innovation_m.ravel(),
            variance=links.variance_m2.ravel(),
            status=np.array([UpdateStatus(int(code)).name for code in links.status.ravel()], dtype=np.str_),
            gate=None
            if gate is None
            else np.maximum(gate, scenario.filter.gate_sigmas * np.sqrt(links.variance_m2.ravel())),
            source_names=link_names,
        ),
        baselines={"INS alone": alone.position_m},
        sources=sources,
        notes=tuple(sensed.notes) + _imu_notes(run),
    )


def _known(columns: _Array) -> _Array | None:
    return columns if np.isfinite(columns).all() else None


def _truth(states: list[_Array]) -> Truth:
    """From heading, velocity, position of each receiver; NaN where a recording does not say."""
    return Truth(
        position_m=states[0][:, 3:5],
        velocity_mps=_known(states[0][:, 1:3]),
        heading_rad=_known(states[0][:, 0]),
        state=_known(np.concatenate(states, axis=1)),
    )


def _imu_notes(run: OfdmInertialRun) -> tuple[str, ...]:
    imu, notes = run.imu, []
    if imu.gaps:
        gaps = "a gap" if imu.gaps == 1 else f"{imu.gaps} gaps"
        notes.append(f"IMU: {gaps} of {imu.gap_s:.3g} s in all, coasted over")
    if imu.not_after:
        notes.append(f"IMU: {imu.not_after} samples not after the one before them, passed over")
    if imu.not_finite:
        notes.append(f"IMU: {imu.not_finite} samples not finite, coasted over")
    if imu.saturated:
        notes.append(f"IMU: {imu.saturated} samples saturated, used with the noise of unmodelled motion")
    if run.status != UpdateStatus.ACCEPTED:
        why = run.status.name.lower().replace("_", " ")
        notes.append(f"the run ended at {run.t_s[-1]:.2f} s: a prediction was refused ({why})")
    lost = int(np.count_nonzero(run.links.rejected))
    if lost:
        notes.append(f"{lost} of {run.links.status.size} boundaries rejected")
    return tuple(notes)
