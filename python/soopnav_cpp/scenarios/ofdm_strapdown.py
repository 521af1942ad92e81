"""Scenarios of strapdown navigation in three dimensions: ``system = "ofdm_strapdown"`` (crosby section 5.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import Model, Vector3
from soopnav_cpp.estimation import UpdateStatus
from soopnav_cpp.inertial import ImuNoise, ImuStatus
from soopnav_cpp.ofdm import Numerology
from soopnav_cpp.scenarios.base import Origin, Scenario, SystemRun, Truth, Updates
from soopnav_cpp.scenarios.registry import register
from soopnav_cpp.simulation import ImuErrorModel

__all__ = [
    "OfdmStrapdown",
    "OfdmStrapdownScenario",
    "RangingSettings",
    "SpatialTransmitterSettings",
    "StartSettings",
    "StrapdownFilterSettings",
    "StrapdownImuSettings",
    "WaySettings",
]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


def _rising_pair(value: object) -> object:
    if not isinstance(value, (list, tuple)) or len(value) != 2 or not all(type(v) in (int, float) for v in value):
        raise ValueError("a list of two numbers expected")
    low, high = float(value[0]), float(value[1])
    if not low < high:
        raise ValueError(f"[{low:g}, {high:g}] does not rise")
    return (low, high)


#: From and to.
Span = Annotated[tuple[float, float], pydantic.BeforeValidator(_rising_pair)]


class StrapdownImuSettings(Model):
    """The inertial sensors, the same in each axis, and what a simulation makes of them. The filter is told the same.

    Attributes
    ----------
    preset : str
        "consumer": 200 µg/√Hz, 0.6 °/√h, biases of 5 mg and 50 °/h; "industrial": 60 µg/√Hz, 0.15 °/√h, 0.5 mg and
        5 °/h; "tactical": 30 µg/√Hz, 0.05 °/√h, 0.3 mg and 1 °/h. The keys below replace single numbers of it.
    rate_hz : float
        Samples per second.
    gyro_density_radps_per_rthz, accelerometer_density_mps2_per_rthz : float
        White noise.
    gyro_bias_sigma_radps, accelerometer_bias_sigma_mps2 : float
        Standard deviation of the biases at the start.
    gyro_bias_walk_radps_per_rts, accelerometer_bias_walk_mps2_per_rts : float
        By how much the biases walk.
    gaps_s : list of pairs
        Samples between these times are lost.
    """

    preset: Literal["consumer", "industrial", "tactical"] = "industrial"
    rate_hz: Annotated[float, Field(ge=1.0, le=10_000.0)] = 100.0
    gyro_density_radps_per_rthz: NotNegative | None = None
    accelerometer_density_mps2_per_rthz: NotNegative | None = None
    gyro_bias_sigma_radps: NotNegative | None = None
    accelerometer_bias_sigma_mps2: NotNegative | None = None
    gyro_bias_walk_radps_per_rts: NotNegative = 0.0
    accelerometer_bias_walk_mps2_per_rts: NotNegative = 0.0
    gaps_s: list[Span] = Field(default_factory=list)

    @property
    def noise(self) -> ImuNoise:
        """Preset and keys together."""
        grade: ImuErrorModel = getattr(ImuErrorModel, self.preset)()
        noise = ImuNoise(
            gyro_density=grade.gyro.white_density,
            accelerometer_density=grade.accelerometer.white_density,
            gyro_bias_sigma_radps=grade.gyro.turn_on_sigma,
            accelerometer_bias_sigma_mps2=grade.accelerometer.turn_on_sigma,
            gyro_bias_walk=self.gyro_bias_walk_radps_per_rts,
            accelerometer_bias_walk=self.accelerometer_bias_walk_mps2_per_rts,
        )
        own = {
            "gyro_density": self.gyro_density_radps_per_rthz,
            "accelerometer_density": self.accelerometer_density_mps2_per_rthz,
            "gyro_bias_sigma_radps": self.gyro_bias_sigma_radps,
            "accelerometer_bias_sigma_mps2": self.accelerometer_bias_sigma_mps2,
        }
        return replace(noise, **{name: value for name, value in own.items() if value is not None})


class StartSettings(Model):
    """How well the receiver knows its start: standard deviations, drawn from for each run.

    Attributes
    ----------
    tilt_sigma_deg : float
        About the body's forward and right axes.
    heading_sigma_deg : float
    velocity_sigma_mps, position_sigma_m : float
        Of each component.
    """

    tilt_sigma_deg: Positive = 0.1
    heading_sigma_deg: Positive = 0.5
    velocity_sigma_mps: Positive = 0.1
    position_sigma_m: Positive = 0.1


class WaySettings(Model):
    """How the receiver moves: a smooth path of constant speed along straight legs with rounded corners.

    Attributes
    ----------
    kind : str
        "roaming": legs drawn at random for each run, from the origin on, within a circle. "waypoints": through
        waypoints_ned_m.
    speed_mps : float
    acceleration_mps2 : float
        In the corners at most.
    radius_m : float
        Of the circle.
    leg_m : list of two numbers
        Lengths of legs, between them.
    climb_m, height_m : float
        Up or down by as much as climb_m in a leg, and never further than height_m from the start's height.
    waypoints_ned_m : list
        North, east, down, the first one is the start.
    roll_amplitude_rad, roll_frequency_hz, pitch_amplitude_rad, pitch_frequency_hz : float
        The body rolls and pitches by a sine; phases are drawn for each run.
    """

    kind: Literal["roaming", "waypoints"] = "roaming"
    speed_mps: Positive = 15.0
    acceleration_mps2: Positive = 3.0
    radius_m: Positive = 900.0
    leg_m: Span = (150.0, 400.0)
    climb_m: NotNegative = 8.0
    height_m: NotNegative = 20.0
    waypoints_ned_m: list[Vector3] = Field(default_factory=list)
    roll_amplitude_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 0.02
    roll_frequency_hz: NotNegative = 0.8
    pitch_amplitude_rad: Annotated[float, Field(ge=0.0, le=0.5)] = 0.015
    pitch_frequency_hz: NotNegative = 1.1

    @pydantic.model_validator(mode="after")
    def _fits(self) -> WaySettings:
        if (self.kind == "waypoints") != bool(self.waypoints_ned_m):
            raise ValueError('kind = "waypoints" and waypoints_ned_m go together')
        if self.kind == "waypoints":
            return self
        shortest = 2.0 * self.speed_mps**2 / self.acceleration_mps2
        if self.leg_m[0] < shortest:
            raise ValueError(
                f"leg_m: legs of {self.leg_m[0]:g} m leave no room for corners; at least 2 speed_mps² / "
                f"acceleration_mps2 = {shortest:g} m expected"
            )
        if self.leg_m[1] > 0.5 * self.radius_m:
            raise ValueError(f"leg_m: {self.leg_m[1]:g}: at most half of radius_m = {self.radius_m:g} expected")
        return self


class SpatialTransmitterSettings(Model):
    """A transmitter at a known place.

    Attributes
    ----------
    position_ned_m : list of three numbers
        North, east, down of the origin: what stands high has a negative last one.
    name : str
        For the report; without one they are counted.
    """

    position_ned_m: Vector3
    name: str = ""


class RangingSettings(Model):
    """How range changes are measured, and what of them is known.

    Attributes
    ----------
    sigma_m : float
        Standard deviation of one.
    update_interval_s : float
        Between epochs.
    bandwidth_hz, subcarriers, prefix
        Of the signal: range changes are known modulo the length of its symbol.
    outages_s : list of pairs
        Between these times no transmitter is heard.
    """

    sigma_m: Positive = 0.5
    update_interval_s: Positive = 1.0
    bandwidth_hz: Annotated[float, Field(ge=1e3, le=1e9)] = 20e6
    subcarriers: Annotated[int, Field(ge=2, le=8192)] = 64
    prefix: Annotated[int, Field(ge=1, le=8192)] = 16
    outages_s: list[Span] = Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def _fits(self) -> RangingSettings:
        if self.prefix >= self.subcarriers:
            raise ValueError(f"prefix: {self.prefix}: fewer than the {self.subcarriers} samples of a symbol expected")
        return self

    @property
    def ambiguity_m(self) -> float:
        """Length of a symbol."""
        return float(Numerology(self.subcarriers, self.prefix, self.bandwidth_hz).ambiguity_m)


class StrapdownFilterSettings(Model):
    """The filter.

    Attributes
    ----------
    gate_m : float
        Range changes whose innovation lies beyond it are refused ...
    gate_sigmas : float
        ... unless it lies within so many of its own standard deviations.
    """

    gate_m: Positive | None = 3.0
    gate_sigmas: Positive = 6.0


class OfdmStrapdownScenario(Scenario):
    """A receiver with an inertial unit in three dimensions among transmitters of OFDM signals.

    Attributes
    ----------
    origin : table
        Of north, east, down: the inertial unit feels the gravity and the rotation of this place.
    imu, start, trajectory, ranging, filter : table
    transmitters : list of tables
    output_rate_hz : float
        Rows per second of what is written.
    """

    origin: Origin
    imu: StrapdownImuSettings = StrapdownImuSettings()
    start: StartSettings = StartSettings()
    trajectory: WaySettings = WaySettings()
    transmitters: Annotated[list[SpatialTransmitterSettings], Field(min_length=1, max_length=64)]
    ranging: RangingSettings = RangingSettings()
    filter: StrapdownFilterSettings = StrapdownFilterSettings()
    output_rate_hz: Positive = 1.0

    @pydantic.model_validator(mode="after")
    def _fits(self) -> OfdmStrapdownScenario:
        if self.duration_s < self.ranging.update_interval_s:
            raise ValueError(f"duration_s: shorter than ranging.update_interval_s = {self.ranging.update_interval_s:g}")
        if self.output_rate_hz > self.imu.rate_hz:
            raise ValueError(f"output_rate_hz: more than imu.rate_hz = {self.imu.rate_hz:g}")
        return self

    @property
    def transmitters_ned_m(self) -> _Array:
        """Positions, shape (K, 3)."""
        return np.array([item.position_ned_m for item in self.transmitters])

    @property
    def transmitter_names(self) -> tuple[str, ...]:
        """Names, or numbers from 1."""
        return tuple(item.name or f"transmitter {i + 1}" for i, item in enumerate(self.transmitters))


EXAMPLE = """\
# Four transmitters hold an industrial inertial unit for five minutes, in three dimensions (crosby section 5.2).
system = "ofdm_strapdown"
title = "Three dimensions, four transmitters"
duration_s = 300.0

[origin]
latitude_deg = 48.1
longitude_deg = 11.6
height_m = 520.0

[imu]
preset = "industrial"

[[transmitters]]
position_ned_m = [2900.0, 600.0, -30.0]
[[transmitters]]
position_ned_m = [-700.0, 2950.0, -300.0]
[[transmitters]]
position_ned_m = [-2800.0, -900.0, -120.0]
[[transmitters]]
position_ned_m = [600.0, -3000.0, -210.0]

[ranging]
sigma_m = 0.5
"""

STATE_NAMES = tuple(
    f"{what}{axis}_{unit}"
    for what, axes, unit in (
        ("attitude_", ("forward", "right", "down"), "rad"),
        ("velocity_", ("north", "east", "down"), "mps"),
        ("", ("north", "east", "down"), "m"),
        ("gyro_bias_", ("forward", "right", "down"), "radps"),
        ("accelerometer_bias_", ("forward", "right", "down"), "mps2"),
    )
    for axis in axes
)


@register
class OfdmStrapdown:
    """Simulates the sensors, navigates, and says what came of it."""

    name = "ofdm_strapdown"
    title = "strapdown navigation in three dimensions, aided by OFDM transmitters (crosby section 5.2)"
    scenario = OfdmStrapdownScenario
    example = EXAMPLE

    def run(self, scenario: OfdmStrapdownScenario, seed: int) -> SystemRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.scenarios import ofdm_strapdown_pipeline as pipeline

        sensed = pipeline.sense(scenario, seed)
        run = pipeline.navigate(scenario, sensed)
        alone = pipeline.navigate(scenario, sensed, aided=False)
        return to_system_run(scenario, sensed, run, alone)


def to_system_run(scenario: OfdmStrapdownScenario, sensed: Any, run: Any, alone: Any) -> SystemRun:
    """What the reports are made of. The state is the error itself, estimate minus truth, in the 15 states of which the
    covariance is: attitudes have no difference."""
    truth = sensed.path.at(run.t_s)
    error = -sensed.errors(run)
    epochs, transmitters = run.update_status.shape
    variance = np.square(run.innovation_sigma_m.ravel())
    settings, covariance = scenario.filter, np.asarray(run.covariance)
    status = np.where(np.isnan(sensed.range_changes_m), UpdateStatus.ABSENT, run.update_status)
    sources = dict(zip(scenario.transmitter_names, scenario.transmitters_ned_m, strict=True))
    return SystemRun(
        t_s=run.t_s,
        position_m=run.position_m,
        position_covariance_m2=covariance[:, 6:9, 6:9],
        velocity_mps=run.velocity_mps,
        quaternion_wxyz=run.quaternion,
        state_names=STATE_NAMES,
        state=error,
        covariance=covariance,
        truth=Truth(
            position_m=truth.position_m,
            velocity_mps=truth.velocity_mps,
            quaternion_wxyz=truth.quaternion,
            state=np.zeros_like(error),
        ),
        updates=Updates(
            t_s=np.repeat(sensed.epochs_s, transmitters),
            source=np.tile(np.arange(transmitters), epochs),
            innovation=run.innovation_m.ravel(),
            variance=variance,
            status=np.array([UpdateStatus(int(code)).name for code in status.ravel()], dtype=np.str_),
            gate=None
            if settings.gate_m is None
            else np.fmax(settings.gate_m, settings.gate_sigmas * np.sqrt(variance)),
            source_names=scenario.transmitter_names,
        ),
        baselines={"INS alone": alone.position_m},
        sources=sources,
        notes=_notes(scenario, run.imu_status, status),
        axes="ned",
    )


def _notes(scenario: OfdmStrapdownScenario, imu: npt.NDArray[np.uint8], updates: npt.NDArray[Any]) -> tuple[str, ...]:
    notes = []
    for low, high in scenario.ranging.outages_s:
        notes.append(f"no transmitter heard from {low:g} to {high:g} s")
    gaps = int(np.count_nonzero(imu == int(ImuStatus.GAP)))
    if gaps:
        notes.append(f"IMU: {'a gap' if gaps == 1 else f'{gaps} gaps'}, coasted over")
    refused = int(np.count_nonzero(np.isin(updates, [UpdateStatus.ACCEPTED, UpdateStatus.ABSENT], invert=True)))
    if refused:
        notes.append(f"{refused} of {updates.size} range changes rejected")
    return tuple(notes)
