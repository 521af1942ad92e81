"""Inertial navigation: what an inertial unit's samples are worth, strapdown mechanisation, alignment, rest.

Increments are rate [rad] and specific force [m/s], integrated over each sample along the body's axes (forward, right,
down), shape ``(n, 3)``. Quaternions are ``w, x, y, z`` and map the body's axes to those of the frame they are named
with. Angles are radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import inertial as _inertial
from soopnav_cpp._core.inertial import Alignment, AlignmentStatus, ImuStatus, IntegrationStatus

__all__ = [
    "Alignment",
    "AlignmentStatus",
    "Heading",
    "ImuNoise",
    "ImuStatus",
    "IntegrationStatus",
    "StrapdownSolution",
    "ZeroVelocity",
    "correct_increments",
    "integrate",
    "judge_samples",
    "static_alignment",
]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ImuNoise:
    """Random errors of an inertial unit, the same in each axis.

    Attributes
    ----------
    gyro_density : float
        White noise of the rates [rad/s/√Hz]; 1 °/√h is 2.909e-4.
    accelerometer_density : float
        White noise of the specific forces [m/s²/√Hz]; 1 µg/√Hz is 9.807e-6.
    gyro_bias_sigma_radps, accelerometer_bias_sigma_mps2 : float
        Standard deviation of the constant part of the biases when it is switched on.
    gyro_bias_walk, accelerometer_bias_walk : float
        Random walk of the biases [rad/s/√s] and [m/s²/√s].
    gyro_bias_time_s, accelerometer_bias_time_s : float
        Their correlation times; infinite: a random walk.
    """

    gyro_density: float = 0.0
    accelerometer_density: float = 0.0
    gyro_bias_sigma_radps: float = 0.0
    accelerometer_bias_sigma_mps2: float = 0.0
    gyro_bias_walk: float = 0.0
    accelerometer_bias_walk: float = 0.0
    gyro_bias_time_s: float = math.inf
    accelerometer_bias_time_s: float = math.inf

    @classmethod
    def industrial_mems(cls) -> ImuNoise:
        """60 µg/√Hz, 0.15 °/√h, biases of 0.5 mg and 5 °/h."""
        g = 9.80665
        return cls(
            gyro_density=math.radians(0.15) / 60.0,
            accelerometer_density=60e-6 * g,
            gyro_bias_sigma_radps=math.radians(5.0) / 3600.0,
            accelerometer_bias_sigma_mps2=0.5e-3 * g,
        )

    @property
    def _numbers(self) -> tuple[float, float, float, float, float, float]:
        return (
            self.gyro_density,
            self.accelerometer_density,
            self.gyro_bias_walk,
            self.accelerometer_bias_walk,
            self.gyro_bias_time_s,
            self.accelerometer_bias_time_s,
        )


@dataclass(frozen=True, kw_only=True)
class ZeroVelocity:
    """How rest is told from motion: force is gravity in one direction and the rate zero, over a window (SHOE).

    Attributes
    ----------
    window : int
        Samples that are looked at together.
    accelerometer_sigma_mps2, gyro_sigma_radps : float
        Standard deviations of a sample's mean force and rate at rest, vibration and bias included.
    threshold : float
        Rest below it; the statistic's mean is 6 at rest when the deviations are right.
    gravity_mps2 : float
    """

    window: int = 50
    accelerometer_sigma_mps2: float = 0.02
    gyro_sigma_radps: float = 0.005
    threshold: float = 12.0
    gravity_mps2: float = 9.80665

    def detect(
        self, delta_theta_b: npt.ArrayLike, delta_velocity_b: npt.ArrayLike, dt_s: float
    ) -> tuple[npt.NDArray[np.bool_], _Array]:
        """Where a recording is at rest.

        Parameters
        ----------
        delta_theta_b, delta_velocity_b : array_like, shape (n, 3)
        dt_s : float

        Returns
        -------
        at_rest : ndarray, shape (n,), bool
            Whether the window that ends with a sample is at rest; not before the first window is full.
        statistic : ndarray, shape (n,), float64
            Infinite before the first window is full.
        """
        return _inertial.zero_velocity(
            np.asarray(delta_theta_b, dtype=np.float64),
            np.asarray(delta_velocity_b, dtype=np.float64),
            dt_s,
            window=self.window,
            accelerometer_sigma_mps2=self.accelerometer_sigma_mps2,
            gyro_sigma_radps=self.gyro_sigma_radps,
            threshold=self.threshold,
            gravity_mps2=self.gravity_mps2,
        )

    @property
    def _numbers(self) -> tuple[float, float, float, float, float]:
        return (
            float(self.window),
            self.accelerometer_sigma_mps2,
            self.gyro_sigma_radps,
            self.threshold,
            self.gravity_mps2,
        )


@dataclass(frozen=True)
class Heading:
    """A heading from elsewhere: of the body's first axis, clockwise from true north, with its standard deviation."""

    heading_rad: float
    sigma_rad: float


@dataclass(frozen=True, eq=False, repr=False)
class StrapdownSolution:
    """Where inertial navigation alone led.

    Attributes
    ----------
    place : ndarray, shape (r, 3), float64
        Latitude, longitude [rad], height [m].
    velocity_mps : ndarray, shape (r, 3), float64
        North, east, down.
    quaternion : ndarray, shape (r, 4), float64
        Body to north-east-down at the place.
    status : ndarray, shape (n,), uint8
        `IntegrationStatus` of each step; a step that was not integrated left the state as it was.
    """

    place: _Array
    velocity_mps: _Array
    quaternion: _Array
    status: npt.NDArray[np.uint8]

    def __repr__(self) -> str:
        refused = int(np.count_nonzero(self.status))
        return f"StrapdownSolution({len(self.place)} records, {len(self.status)} steps, {refused} refused)"


def correct_increments(
    delta_theta_b: npt.ArrayLike, delta_velocity_b: npt.ArrayLike, *, previous: int = 4
) -> tuple[_Array, _Array]:
    """Coning and sculling of a whole recording.

    Parameters
    ----------
    delta_theta_b, delta_velocity_b : array_like, shape (n, 3)
        Samples of equal length.
    previous : int
        Earlier samples used for each, 0 ... 4; the first samples use later ones.

    Returns
    -------
    delta_theta_b, delta_velocity_b : ndarray, shape (n, 3), float64
        Rotation vectors of the steps, and velocity increments that lack only the turn at the step's mean rate.
    """
    return _inertial.correct_increments(
        np.asarray(delta_theta_b, dtype=np.float64), np.asarray(delta_velocity_b, dtype=np.float64), previous=previous
    )


def integrate(
    delta_theta_b: npt.ArrayLike,
    delta_velocity_b: npt.ArrayLike,
    dt_s: float,
    *,
    place: npt.ArrayLike,
    velocity_mps: npt.ArrayLike,
    quaternion: npt.ArrayLike,
    coning_samples: int = 4,
    whole_recording: bool = True,
    record_every: int = 1,
) -> StrapdownSolution:
    """Strapdown mechanisation in the moving local level frame, with gravity, Earth rate and transport rate.

    Parameters
    ----------
    delta_theta_b, delta_velocity_b : array_like, shape (n, 3)
    dt_s : float
        Of each sample.
    place : array_like, shape (3,)
        Latitude, longitude [rad], height [m] at the start.
    velocity_mps : array_like, shape (3,)
        North, east, down.
    quaternion : array_like, shape (4,)
        Body to north-east-down.
    coning_samples : int
        Earlier samples used against coning and sculling, 0 ... 4.
    whole_recording : bool
        The first samples may use later ones, as a recording allows; otherwise each uses earlier ones only.
    record_every : int
        Samples from one record to the next.

    Returns
    -------
    StrapdownSolution

    Raises
    ------
    ValueError
        For shapes that do not fit and a start that is not finite or no rotation. Samples that are not finite are no
        error but a status.
    """
    return StrapdownSolution(
        *_inertial.integrate(
            np.asarray(delta_theta_b, dtype=np.float64),
            np.asarray(delta_velocity_b, dtype=np.float64),
            dt_s,
            place=place,
            velocity_mps=velocity_mps,
            quaternion=quaternion,
            coning_samples=coning_samples,
            whole_recording=whole_recording,
            record_every=record_every,
        )
    )


def judge_samples(
    t_s: npt.ArrayLike,
    gyro_radps: npt.ArrayLike,
    accelerometer_mps2: npt.ArrayLike,
    *,
    period_s: float,
    gap_periods: float = 1.5,
    duplicate_periods: float = 0.01,
    gyro_range_radps: float = math.inf,
    accelerometer_range_mps2: float = math.inf,
) -> tuple[npt.NDArray[np.uint8], _Array]:
    """What samples are worth, by their times and numbers; planar units as well.

    Parameters
    ----------
    t_s : array_like, shape (n,)
        Time of the end of each sample.
    gyro_radps, accelerometer_mps2 : array_like, shape (n, any)
    period_s : float
        Time between samples.
    gap_periods, duplicate_periods : float
        Samples are missing when one comes more than so many periods after the last; it is the last one again when it
        comes nearer than so many.
    gyro_range_radps, accelerometer_range_mps2 : float
        A sample is saturated when any axis reaches them.

    Returns
    -------
    status : ndarray, shape (n,), uint8
        `ImuStatus`.
    missing_s : ndarray, shape (n,), float64
        Time before the sample's own period of which nothing is known.
    """
    return _inertial.judge_samples(
        t_s,
        np.asarray(gyro_radps, dtype=np.float64),
        np.asarray(accelerometer_mps2, dtype=np.float64),
        period_s=period_s,
        gap_periods=gap_periods,
        duplicate_periods=duplicate_periods,
        gyro_range_radps=gyro_range_radps,
        accelerometer_range_mps2=accelerometer_range_mps2,
    )


def static_alignment(
    mean_force_b_mps2: npt.ArrayLike,
    mean_rate_b_radps: npt.ArrayLike,
    *,
    duration_s: float,
    latitude_rad: float,
    height_m: float,
    noise: ImuNoise,
    heading: Heading | None = None,
    max_heading_sigma_rad: float = math.radians(5.0),
) -> Alignment:
    """Attitude of a body at rest: level from the specific force, heading from the gyros when they are good enough.

    Parameters
    ----------
    mean_force_b_mps2, mean_rate_b_radps : array_like, shape (3,)
        Means over `duration_s`.
    duration_s, latitude_rad, height_m : float
    noise : ImuNoise
        Its densities and bias deviations say what the attitude is worth.
    heading : Heading, optional
        Used where it is surer than the gyros'.
    max_heading_sigma_rad : float
        A heading of the gyros less sure than this is not used.

    Returns
    -------
    Alignment
        ``status``, ``quaternion``, ``covariance``, ``cross_gyro_bias``, ``cross_accelerometer_bias``, ``gyrocompass``,
        ``heading_sigma_rad``.

    Raises
    ------
    ValueError
        For a duration that is not positive, and what is not finite in the place and noise. Motion, or no heading, is no
        error but a ``status``.
    """
    return _inertial.static_alignment(
        mean_force_b_mps2,
        mean_rate_b_radps,
        duration_s=duration_s,
        latitude_rad=latitude_rad,
        height_m=height_m,
        gyro_bias_sigma_radps=noise.gyro_bias_sigma_radps,
        accelerometer_bias_sigma_mps2=noise.accelerometer_bias_sigma_mps2,
        gyro_density=noise.gyro_density,
        accelerometer_density=noise.accelerometer_density,
        max_heading_sigma_rad=max_heading_sigma_rad,
        heading_rad=None if heading is None else heading.heading_rad,
        heading_sigma_rad=0.0 if heading is None else heading.sigma_rad,
    )
