"""Paths in three dimensions that are known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp.geometry import LocalFrame

__all__ = ["Oscillation", "SpatialMotion", "SpatialTrajectory"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Oscillation:
    """A sine of an angle: ``amplitude_rad * sin(2 pi frequency_hz t + phase_rad)``."""

    amplitude_rad: float = 0.0
    frequency_hz: float = 0.0
    phase_rad: float = 0.0

    @property
    def _numbers(self) -> tuple[float, float, float]:
        return (self.amplitude_rad, self.frequency_hz, self.phase_rad)


@dataclass(frozen=True, eq=False, repr=False)
class SpatialMotion:
    """Motion at some times, along the axes of the path's frame.

    Attributes
    ----------
    position_m, velocity_mps, acceleration_mps2 : ndarray, shape (n, 3), float64
    quaternion : ndarray, shape (n, 4), float64
        w, x, y, z, body (forward, right, down) to the frame.
    rate_radps : ndarray, shape (n, 3), float64
        Of the body relative to the frame, along the body's axes.
    """

    position_m: _Array
    velocity_mps: _Array
    acceleration_mps2: _Array
    quaternion: _Array
    rate_radps: _Array

    def __repr__(self) -> str:
        return f"SpatialMotion({len(self.position_m)} times)"


class SpatialTrajectory:
    """A smooth path in three dimensions: a B-spline of degree 5, so that position, velocity, acceleration, attitude and
    what an inertial unit measures are known exactly at any time. Immutable.

    The body's first axis follows the path; yaw is clockwise from north whatever the frame's axes.

    Parameters
    ----------
    frame : LocalFrame
    control_points_m : array_like, shape (n, 3)
        At least six, along the frame's axes; the path lasts ``(n - 5) * knot_s``.
    knot_s : float
        Time between control points.
    roll, pitch : Oscillation
    """

    __slots__ = ("_path", "frame")

    def __init__(
        self,
        frame: LocalFrame,
        control_points_m: npt.ArrayLike,
        knot_s: float,
        *,
        roll: Oscillation = Oscillation(),
        pitch: Oscillation = Oscillation(),
    ) -> None:
        self.frame = frame
        self._path = _simulation.SpatialTrajectory(
            frame._frame, control_points_m, knot_s, roll=roll._numbers, pitch=pitch._numbers
        )

    @classmethod
    def through(
        cls,
        frame: LocalFrame,
        waypoints_m: npt.ArrayLike,
        *,
        speed_mps: float,
        max_acceleration_mps2: float = 3.0,
        rest_s: float | None = None,
        roll: Oscillation = Oscillation(),
        pitch: Oscillation = Oscillation(),
    ) -> SpatialTrajectory:
        """Along straight lines between waypoints at a constant speed; corners are rounded, inside the waypoints.

        Parameters
        ----------
        frame : LocalFrame
        waypoints_m : array_like, shape (n, 3)
            At least two, along the frame's axes.
        speed_mps, max_acceleration_mps2 : float
        rest_s : float, optional
            At rest so long before it sets off; without it, at speed from the beginning.
        roll, pitch : Oscillation

        Raises
        ------
        ValueError
            For equal waypoints in a row, numbers that are not positive, and corners too close for the acceleration.
        """
        path = cls.__new__(cls)
        path.frame = frame
        path._path = _simulation.SpatialTrajectory.through(
            frame._frame,
            waypoints_m,
            speed_mps=speed_mps,
            max_acceleration_mps2=max_acceleration_mps2,
            rest_s=rest_s,
            roll=roll._numbers,
            pitch=pitch._numbers,
        )
        return path

    @property
    def duration_s(self) -> float:
        """How long the path lasts."""
        return self._path.duration_s

    @property
    def knot_s(self) -> float:
        """Time between control points."""
        return self._path.knot_s

    @property
    def greatest_acceleration_mps2(self) -> float:
        """Greatest acceleration at 16 times between any two knots."""
        return self._path.greatest_acceleration_mps2

    def at(self, t_s: npt.ArrayLike) -> SpatialMotion:
        """The motion at times, shape (n,), between 0 and `duration_s`."""
        return SpatialMotion(*self._path.at(np.atleast_1d(np.asarray(t_s, dtype=np.float64))))

    def navigation_states(self, t_s: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
        """The motion at times, shape (n,), as the moving north-east-down frame has it.

        Returns
        -------
        place : ndarray, shape (n, 3), float64
            Latitude, longitude [rad], height [m].
        velocity_mps : ndarray, shape (n, 3), float64
        quaternion : ndarray, shape (n, 4), float64
            Body to north-east-down at the place.
        """
        return self._path.navigation_states(np.atleast_1d(np.asarray(t_s, dtype=np.float64)))

    def imu_increments(
        self, rate_hz: float, *, start_s: float = 0.0, end_s: float | None = None
    ) -> tuple[_Array, _Array]:
        """What a perfect inertial unit integrates: rate and specific force with gravity, Earth rate and Coriolis.

        Parameters
        ----------
        rate_hz : float
        start_s, end_s : float
            The whole path without them.

        Returns
        -------
        delta_theta_b, delta_velocity_b : ndarray, shape (n, 3), float64
            One row for each ``1 / rate_hz``, exact to rounding.
        """
        return self._path.imu_increments(rate_hz, start_s, self.duration_s if end_s is None else end_s)

    def __repr__(self) -> str:
        return f"SpatialTrajectory({self.duration_s:g} s, knots each {self.knot_s:.3g} s)"
