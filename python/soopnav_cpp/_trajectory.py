"""Planar trajectories and the inertial units that ride along: the face of what `simulation` shows of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp._core.simulation import ImuErrorModel, SensorErrorModel

_Array = npt.NDArray[np.float64]


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


def _pair(value: npt.ArrayLike, name: str) -> tuple[float, float]:
    numbers = np.asarray(value, np.float64)
    if numbers.shape != (2,):
        raise ValueError(f"{name}: expected shape (2,), got {numbers.shape}")
    return float(numbers[0]), float(numbers[1])


@dataclass(frozen=True)
class PlanarMotion:
    """A planar trajectory at chosen times: arrays with a row for each, or without that axis for a single time."""

    t_s: _Array
    heading_rad: _Array
    velocity_mps: _Array
    position_m: _Array
    yaw_rate_radps: _Array
    specific_force_b_mps2: _Array


@dataclass(frozen=True)
class PlanarImuSeries:
    """Readings of a simulated planar inertial unit; arrays are read-only.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Ends of the intervals.
    yaw_rate_radps : ndarray, shape (n,)
    specific_force_b_mps2 : ndarray, shape (n, 2)
        Forward, to the left.
    saturated : ndarray of bool, shape (n,)
    rate_hz : float
    """

    t_s: _Array
    yaw_rate_radps: _Array
    specific_force_b_mps2: _Array
    saturated: npt.NDArray[np.bool_]
    rate_hz: float

    @property
    def inputs(self) -> _Array:
        """Rows ``[yaw rate, forward, left]``, shape (n, 3): what `process.PlanarMechanization` takes."""
        return np.column_stack([self.yaw_rate_radps, self.specific_force_b_mps2])

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        return f"PlanarImuSeries({len(self)} readings at {self.rate_hz:g} Hz)"


class PlanarTrajectory:
    """A planar trajectory: truth for simulations.

    Headings count from the plane's first axis towards the second and are not wrapped; the body's axes are forward and
    to the left. Made by `continuous_turn`, `through` or `from_profiles`. Attributes are read-only arrays on the grid of
    `rate_hz`; `at` interpolates by Hermite's polynomials, which at 1000 Hz is the motion to rounding.
    """

    def __init__(self, core: _simulation.PlanarTrajectory) -> None:
        self._core = core

    @classmethod
    def continuous_turn(
        cls,
        *,
        duration_s: float = 120.0,
        speed_mps: float = 8.0,
        ramp_s: float = 10.0,
        turn_rate_radps: float = 0.035,
        turn_amplitude_radps: float = 0.10,
        turn_period_s: float = 40.0,
        heading_rad: float = 0.0,
        position_m: npt.ArrayLike = (0.0, 0.0),
        rate_hz: float = 1000.0,
    ) -> PlanarTrajectory:
        """From rest into a turn that never settles.

        The speed follows a quintic ramp, the heading rate is
        ``turn_rate_radps + turn_amplitude_radps * sin(2 pi t / turn_period_s)``.
        """
        return cls(
            _simulation.PlanarTrajectory.continuous_turn(
                duration_s=duration_s,
                speed_mps=speed_mps,
                ramp_s=ramp_s,
                turn_rate_radps=turn_rate_radps,
                turn_amplitude_radps=turn_amplitude_radps,
                turn_period_s=turn_period_s,
                heading_rad=heading_rad,
                position_m=_pair(position_m, "position_m"),
                rate_hz=rate_hz,
            )
        )

    @classmethod
    def through(
        cls,
        waypoints_m: npt.ArrayLike,
        speed_mps: float = 8.0,
        max_acceleration_mps2: float = 1.0,
        *,
        max_lateral_acceleration_mps2: float = 2.0,
        smoothing_s: float = 1.0,
        rate_hz: float = 1000.0,
    ) -> PlanarTrajectory:
        """From rest at the first waypoint to rest at the last, along a smooth way, as fast as the limits allow.

        Parameters
        ----------
        waypoints_m : array_like, shape (n, 2)
            At least two, each over 1 mm from the one before it. The way is the natural cubic spline through them.
        speed_mps, max_acceleration_mps2, max_lateral_acceleration_mps2 : float
            Positive.
        smoothing_s : float
            The speed is a mean over so long, which bounds the jerk along the way.
        rate_hz : float
        """
        return cls(
            _simulation.PlanarTrajectory.through(
                waypoints_m,
                speed_mps=speed_mps,
                acceleration_mps2=max_acceleration_mps2,
                lateral_acceleration_mps2=max_lateral_acceleration_mps2,
                smoothing_s=smoothing_s,
                rate_hz=rate_hz,
            )
        )

    @classmethod
    def from_profiles(
        cls,
        yaw_rate_radps: npt.ArrayLike,
        specific_force_b_mps2: npt.ArrayLike,
        rate_hz: float = 1000.0,
        *,
        heading_rad: float = 0.0,
        velocity_mps: npt.ArrayLike = (0.0, 0.0),
        position_m: npt.ArrayLike = (0.0, 0.0),
    ) -> PlanarTrajectory:
        """Body-frame profiles, integrated by the trapezoid rule: heading, then velocity, then position.

        Parameters
        ----------
        yaw_rate_radps : array_like, shape (n,)
        specific_force_b_mps2 : array_like, shape (n, 2)
        rate_hz : float
        heading_rad : float
        velocity_mps, position_m : array_like, shape (2,)
            At the start.
        """
        return cls(
            _simulation.PlanarTrajectory.from_profiles(
                yaw_rate_radps,
                specific_force_b_mps2,
                rate_hz,
                heading_rad=heading_rad,
                velocity_mps=_pair(velocity_mps, "velocity_mps"),
                position_m=_pair(position_m, "position_m"),
            )
        )

    @property
    def t_s(self) -> _Array:
        """Times, shape (n,)."""
        return self._core.t_s

    @property
    def heading_rad(self) -> _Array:
        """Headings, shape (n,)."""
        return self._core.heading_rad

    @property
    def velocity_mps(self) -> _Array:
        """Velocities in the plane's axes, shape (n, 2)."""
        return self._core.velocity_mps

    @property
    def position_m(self) -> _Array:
        """Positions, shape (n, 2)."""
        return self._core.position_m

    @property
    def yaw_rate_radps(self) -> _Array:
        """Heading rates, shape (n,)."""
        return self._core.yaw_rate_radps

    @property
    def specific_force_b_mps2(self) -> _Array:
        """Accelerations in the body's axes, shape (n, 2)."""
        return self._core.specific_force_b_mps2

    @property
    def rate_hz(self) -> float:
        """Of the grid."""
        return self._core.rate_hz

    @property
    def duration_s(self) -> float:
        """Last time; the first is 0."""
        return self._core.duration_s

    def at(self, t_s: npt.ArrayLike) -> PlanarMotion:
        """The motion at times of one's own.

        Parameters
        ----------
        t_s : float or array_like, shape (k,)
            In 0 ... `duration_s`; others raise ValueError.

        Returns
        -------
        PlanarMotion
        """
        times = np.array(t_s, np.float64)
        columns = self._core.at(np.atleast_1d(times))
        return PlanarMotion(times, *(column[0] if times.ndim == 0 else _read_only(column) for column in columns))

    def imu(
        self,
        rate_hz: float = 50.0,
        *,
        gyro_sigma_radps: float = 0.1,
        accelerometer_sigma_mps2: float = 0.1,
        errors: ImuErrorModel | None = None,
        sampling: Literal["mean", "centre", "left"] = "mean",
        seed: int,
        stream: int = 0,
    ) -> PlanarImuSeries:
        """What an inertial unit says on the way.

        Parameters
        ----------
        rate_hz : float
        gyro_sigma_radps, accelerometer_sigma_mps2 : float
            White errors of each sample (crosby's by default), when no `errors` are given.
        errors : ImuErrorModel, optional
            In place of both sigmas.
        sampling : {"mean", "centre", "left"}
            "mean": the exact increments of heading and velocity over each interval, in the axes at its beginning, as
            an integrating unit gives after its sculling correction. "centre", "left": values there.
        seed, stream : int
            Name the errors; streams of one seed are independent.

        Returns
        -------
        PlanarImuSeries
            As many readings as whole intervals fit.
        """
        if errors is None:
            errors = ImuErrorModel(
                SensorErrorModel(sample_sigma=gyro_sigma_radps), SensorErrorModel(sample_sigma=accelerometer_sigma_mps2)
            )
        t_s, rate, force, saturated = self._core.imu(
            rate_hz, errors=errors, sampling=sampling, seed=seed, stream=stream
        )
        return PlanarImuSeries(
            _read_only(t_s), _read_only(rate), _read_only(force), _read_only(saturated.astype(np.bool_)), rate_hz
        )

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        way = float(np.sum(np.linalg.norm(np.diff(self.position_m, axis=0), axis=1)))
        return f"PlanarTrajectory({self.duration_s:g} s at {self.rate_hz:g} Hz, {way:.1f} m long)"
