"""
Inertial navigation: increments, mechanisation, alignment, rest.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Alignment",
    "AlignmentStatus",
    "ImuStatus",
    "IntegrationStatus",
    "correct_increments",
    "integrate",
    "judge_samples",
    "static_alignment",
    "zero_velocity",
]

class ImuStatus(enum.IntEnum):
    """
    What a sample of an inertial unit is worth.
    """

    DUPLICATE = ...
    FAR_AHEAD = ...
    FIRST = ...
    GAP = ...
    NOT_FINITE = ...
    OK = ...
    REVERSED = ...
    SATURATED = ...
    def __format__(self, format_spec): ...

class IntegrationStatus(enum.IntEnum):
    """
    What became of a step.
    """

    INTEGRATED = ...
    NEAR_POLE = ...
    NOT_FINITE = ...
    TIME_NOT_ADVANCING = ...
    def __format__(self, format_spec): ...

class AlignmentStatus(enum.IntEnum):
    """
    How an alignment ended.
    """

    ALIGNED = ...
    NEAR_POLE = ...
    NOT_AT_REST = ...
    NOT_FINITE = ...
    NO_HEADING = ...
    def __format__(self, format_spec): ...

class Alignment:
    """
    Attitude of a body at rest, with what it is worth. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the rotation vector d about the body's axes with truth = q exp(d) [rad2]; shape (3, 3).
        """
    @property
    def cross_accelerometer_bias(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Covariance of d and the accelerometer biases; shape (3, 3).
        """
    @property
    def cross_gyro_bias(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Covariance of d and the gyro biases; shape (3, 3).
        """
    @property
    def gyrocompass(self) -> bool:
        """
        Whether the heading is the gyros' own.
        """
    @property
    def heading_sigma_rad(self) -> float:
        """
        Standard deviation of the heading.
        """
    @property
    def quaternion(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        w, x, y, z, body to north-east-down; shape (4,).
        """
    @property
    def status(self) -> AlignmentStatus:
        """
        How it ended; the rest counts when it is ALIGNED.
        """

def correct_increments(
    delta_theta_b: numpy.typing.ArrayLike,
    delta_velocity_b: numpy.typing.ArrayLike,
    *,
    previous: typing.SupportsInt | typing.SupportsIndex = 4,
) -> tuple:
    """
    Coning and sculling of a whole recording: corrected (delta_theta_b, delta_velocity_b).
    """

def integrate(
    delta_theta_b: numpy.typing.ArrayLike,
    delta_velocity_b: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    place: numpy.typing.ArrayLike,
    velocity_mps: numpy.typing.ArrayLike,
    quaternion: numpy.typing.ArrayLike,
    coning_samples: typing.SupportsInt | typing.SupportsIndex = 4,
    whole_recording: bool = True,
    record_every: typing.SupportsInt | typing.SupportsIndex = 1,
) -> tuple:
    """
    Strapdown in the moving local level frame: (places, velocities, quaternions, status).
    """

def judge_samples(
    t_s: numpy.typing.ArrayLike,
    gyro_radps: numpy.typing.ArrayLike,
    accelerometer_mps2: numpy.typing.ArrayLike,
    *,
    period_s: typing.SupportsFloat | typing.SupportsIndex,
    gap_periods: typing.SupportsFloat | typing.SupportsIndex = 1.5,
    duplicate_periods: typing.SupportsFloat | typing.SupportsIndex = 0.01,
    gyro_range_radps: typing.SupportsFloat | typing.SupportsIndex = ...,
    accelerometer_range_mps2: typing.SupportsFloat | typing.SupportsIndex = ...,
) -> tuple:
    """
    What samples are worth: (status, missing_s).
    """

def static_alignment(
    mean_force_b_mps2: numpy.typing.ArrayLike,
    mean_rate_b_radps: numpy.typing.ArrayLike,
    *,
    duration_s: typing.SupportsFloat | typing.SupportsIndex,
    latitude_rad: typing.SupportsFloat | typing.SupportsIndex,
    height_m: typing.SupportsFloat | typing.SupportsIndex,
    gyro_bias_sigma_radps: typing.SupportsFloat | typing.SupportsIndex,
    accelerometer_bias_sigma_mps2: typing.SupportsFloat | typing.SupportsIndex,
    gyro_density: typing.SupportsFloat | typing.SupportsIndex,
    accelerometer_density: typing.SupportsFloat | typing.SupportsIndex,
    max_heading_sigma_rad: typing.SupportsFloat | typing.SupportsIndex,
    heading_rad: typing.SupportsFloat | typing.SupportsIndex | None = None,
    heading_sigma_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> Alignment:
    """
    Attitude of a body at rest.
    """

def zero_velocity(
    delta_theta_b: numpy.typing.ArrayLike,
    delta_velocity_b: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    window: typing.SupportsInt | typing.SupportsIndex,
    accelerometer_sigma_mps2: typing.SupportsFloat | typing.SupportsIndex,
    gyro_sigma_radps: typing.SupportsFloat | typing.SupportsIndex,
    threshold: typing.SupportsFloat | typing.SupportsIndex,
    gravity_mps2: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    Where a body is at rest: (at_rest, statistic).
    """
