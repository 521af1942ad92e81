"""The two halves of an ``ofdm_strapdown`` scenario: `sense` makes path, inertial increments, errors and range changes;
`navigate` runs the filter, as often as one likes on the same `Sensed`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp.geometry import LocalAxes, LocalFrame
from soopnav_cpp.navigation import StrapdownNavigator, StrapdownRun, StrapdownStart, strapdown_errors
from soopnav_cpp.scenarios.ofdm_strapdown import OfdmStrapdownScenario, WaySettings
from soopnav_cpp.simulation import Oscillation, SpatialTrajectory

__all__ = ["Sensed", "frame_of", "navigate", "sense"]

_Array = npt.NDArray[np.float64]

# Streams of a run's seed.
_WAY, _START, _GYRO, _ACCELEROMETER, _RANGES = range(5)
_TRIES = 50  # turns that are drawn before a leg leads back to the middle
_ROUNDED = 1.065  # how much longer legs are than the path that cuts their corners


@dataclass(frozen=True, eq=False)
class Sensed:
    """What a receiver sensed: n samples, E epochs, K transmitters.

    Attributes
    ----------
    path : SpatialTrajectory
        The truth.
    t_s : ndarray, shape (n,)
        Of the ends of samples.
    delta_theta_b, delta_velocity_b : ndarray, shape (n, 3)
        Increments.
    gyro_bias_radps, accelerometer_bias_mps2 : ndarray, shape (n, 3)
        The truth, at `t_s`.
    epochs_s : ndarray, shape (E,)
    range_changes_m : ndarray, shape (E, K)
        Modulo the length of a symbol; NaN where nothing was heard.
    start : StrapdownStart
        What the receiver believes, with its errors drawn.
    """

    path: SpatialTrajectory
    t_s: _Array
    delta_theta_b: _Array
    delta_velocity_b: _Array
    gyro_bias_radps: _Array
    accelerometer_bias_mps2: _Array
    epochs_s: _Array
    range_changes_m: _Array
    start: StrapdownStart

    def errors(self, run: StrapdownRun) -> _Array:
        """Of a run's records in the 15 states its covariances are of, truth minus estimate; shape (r, 15)."""
        truth = self.path.at(run.t_s)
        at = np.clip(np.searchsorted(self.t_s, run.t_s - 1e-9), 0, len(self.t_s) - 1)
        return strapdown_errors(
            run,
            quaternion=truth.quaternion,
            velocity_mps=truth.velocity_mps,
            position_m=truth.position_m,
            gyro_bias_radps=self.gyro_bias_radps[at],
            accelerometer_bias_mps2=self.accelerometer_bias_mps2[at],
        )


def frame_of(scenario: OfdmStrapdownScenario) -> LocalFrame:
    """North, east, down at the scenario's origin."""
    origin = scenario.origin
    return LocalFrame(
        math.radians(origin.latitude_deg), math.radians(origin.longitude_deg), origin.height_m, axes=LocalAxes.NED
    )


def _random(seed: int, kind: int) -> np.random.Generator:
    return np.random.default_rng([seed, kind])


def _roam(way: WaySettings, length_m: float, rng: np.random.Generator) -> _Array:
    """Legs from the origin on, inside the circle, that are `length_m` long in all."""
    at, heading, length = np.zeros(3), rng.uniform(-math.pi, math.pi), 0.0
    points = [at]
    while length < length_m:
        leg = rng.uniform(*way.leg_m)
        for turn in rng.uniform(-1.4, 1.4, _TRIES):
            step = leg * np.array([math.cos(heading + turn), math.sin(heading + turn), 0.0])
            if math.hypot(*(at + step)[:2]) < way.radius_m:
                heading += turn
                break
        else:  # outwards whatever the turn: back to the middle
            heading = math.atan2(-at[1], -at[0])
            step = leg * np.array([math.cos(heading), math.sin(heading), 0.0])
        down = float(np.clip(at[2] + rng.uniform(-way.climb_m, way.climb_m), -way.height_m, way.height_m))
        at = np.array([at[0] + step[0], at[1] + step[1], down])
        points.append(at)
        length += leg
    return np.array(points)


def _path(scenario: OfdmStrapdownScenario, seed: int) -> SpatialTrajectory:
    way, rng = scenario.trajectory, _random(seed, _WAY)
    phase = rng.uniform(0.0, 2.0 * math.pi, 2)
    enough = _ROUNDED * way.speed_mps * scenario.duration_s
    points = np.array(way.waypoints_ned_m) if way.waypoints_ned_m else _roam(way, enough, rng)
    path = SpatialTrajectory.through(
        frame_of(scenario),
        points,
        speed_mps=way.speed_mps,
        max_acceleration_mps2=way.acceleration_mps2,
        roll=Oscillation(way.roll_amplitude_rad, way.roll_frequency_hz, phase[0]),
        pitch=Oscillation(way.pitch_amplitude_rad, way.pitch_frequency_hz, phase[1]),
    )
    if path.duration_s < scenario.duration_s:
        raise ValueError(
            f"trajectory: the way takes {path.duration_s:.1f} s, and duration_s is {scenario.duration_s:g}; "
            "add waypoints, or shorten it"
        )
    return path


def _with_errors(
    exact: _Array, period_s: float, density: float, bias: _Array, walk: float, rng: np.random.Generator
) -> tuple[_Array, _Array]:
    """Increments with white noise and a walking bias, and that bias."""
    noise, steps = rng.standard_normal((2, *exact.shape))
    drift = bias + walk * math.sqrt(period_s) * np.cumsum(steps, axis=0)
    return exact + period_s * drift + math.sqrt(period_s) * density * noise, drift


def _between(t_s: _Array, spans: list[tuple[float, float]]) -> npt.NDArray[np.bool_]:
    inside = np.zeros(len(t_s), dtype=np.bool_)
    for low, high in spans:
        inside |= (t_s > low) & (t_s <= high)
    return inside


def sense(scenario: OfdmStrapdownScenario, seed: int) -> Sensed:
    """Everything the navigator gets, simulated.

    Parameters
    ----------
    scenario : OfdmStrapdownScenario
    seed : int
        Of the run.

    Raises
    ------
    ValueError
        For a way that is too short, or whose corners are too close for its speed.
    """
    unit, noise, path = scenario.imu, scenario.imu.noise, _path(scenario, seed)
    period_s = 1.0 / unit.rate_hz
    begin = path.at(0.0)
    covariance = StrapdownStart.deviations(
        tilt_rad=math.radians(scenario.start.tilt_sigma_deg),
        heading_rad=math.radians(scenario.start.heading_sigma_deg),
        velocity_mps=scenario.start.velocity_sigma_mps,
        position_m=scenario.start.position_sigma_m,
        gyro_bias_radps=noise.gyro_bias_sigma_radps,
        accelerometer_bias_mps2=noise.accelerometer_bias_sigma_mps2,
    )
    error = np.sqrt(np.diag(covariance)) * _random(seed, _START).standard_normal(15)
    exact = StrapdownStart(
        quaternion=begin.quaternion[0],
        velocity_mps=begin.velocity_mps[0],
        position_m=begin.position_m[0],
        covariance=covariance,
        gyro_bias_radps=error[9:12],
        accelerometer_bias_mps2=error[12:],
    )
    theta, velocity = path.imu_increments(unit.rate_hz, end_s=scenario.duration_s)
    theta, gyro_bias = _with_errors(
        theta, period_s, noise.gyro_density, error[9:12], noise.gyro_bias_walk, _random(seed, _GYRO)
    )
    velocity, accelerometer_bias = _with_errors(
        velocity,
        period_s,
        noise.accelerometer_density,
        error[12:],
        noise.accelerometer_bias_walk,
        _random(seed, _ACCELEROMETER),
    )
    t_s = period_s * np.arange(1.0, len(theta) + 1.0)
    kept = ~_between(t_s, unit.gaps_s)
    epochs, changes = _range_changes(scenario, path, seed)
    return Sensed(
        path,
        t_s[kept],
        theta[kept],
        velocity[kept],
        gyro_bias[kept],
        accelerometer_bias[kept],
        epochs,
        changes,
        exact.off_by(error),
    )


def _range_changes(scenario: OfdmStrapdownScenario, path: SpatialTrajectory, seed: int) -> tuple[_Array, _Array]:
    """Epochs, and how much farther than at the start each transmitter is, modulo a symbol."""
    ranging, sources = scenario.ranging, scenario.transmitters_ned_m
    interval = ranging.update_interval_s
    t_s = interval * np.arange(1.0, math.floor(scenario.duration_s / interval + 1e-9) + 1.0)
    here, begin = (path.at(t).position_m for t in (t_s, 0.0))
    change = np.linalg.norm(here[:, None] - sources, axis=2) - np.linalg.norm(begin[0] - sources, axis=1)
    change += ranging.sigma_m * _random(seed, _RANGES).standard_normal(change.shape)
    change = np.remainder(change, ranging.ambiguity_m)  # what a signal that repeats tells
    change[_between(t_s, ranging.outages_s)] = np.nan
    return t_s, change


def navigate(
    scenario: OfdmStrapdownScenario, sensed: Sensed, *, aided: bool = True, record_every: int | None = None
) -> StrapdownRun:
    """Run the filter over what was sensed.

    Parameters
    ----------
    scenario : OfdmStrapdownScenario
    sensed : Sensed
    aided : bool
        False: inertial navigation alone.
    record_every : int, optional
        Samples between records; without it `output_rate_hz` decides.

    Returns
    -------
    StrapdownRun
        With covariances where it is aided.
    """
    unit, ranging, gate = scenario.imu, scenario.ranging, scenario.filter
    navigator = StrapdownNavigator(
        scenario.transmitters_ned_m,
        sensed.start,
        frame=frame_of(scenario),
        noise=unit.noise,
        period_s=1.0 / unit.rate_hz,
        range_sigma_m=ranging.sigma_m,
        reference_m=sensed.path.at(0.0).position_m[0],
        ambiguity_m=ranging.ambiguity_m,
        gate_sigmas=math.inf if gate.gate_m is None else gate.gate_sigmas,
        gate_floor_m=gate.gate_m or 0.0,
    )
    if record_every is None:
        record_every = max(1, round(unit.rate_hz / scenario.output_rate_hz))
    samples = (sensed.t_s, sensed.delta_theta_b, sensed.delta_velocity_b)
    if not aided:
        return navigator.run(*samples, record_every=record_every)
    return navigator.run(
        *samples,
        epochs_s=sensed.epochs_s,
        range_changes_m=sensed.range_changes_m,
        record_every=record_every,
        covariance=True,
    )
