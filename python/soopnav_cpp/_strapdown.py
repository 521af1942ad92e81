"""Inertial navigation in three dimensions, aided by ranges that change."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import StrapdownRun
from soopnav_cpp.geometry import LocalAxes, LocalFrame
from soopnav_cpp.inertial import ImuNoise, ZeroVelocity

__all__ = ["StrapdownNavigator", "StrapdownRun", "StrapdownStart", "strapdown_errors"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class StrapdownStart:
    """What a `StrapdownNavigator` begins with.

    Attributes
    ----------
    quaternion : array_like, shape (4,)
        w, x, y, z, body to north-east-down of the origin.
    velocity_mps, position_m : array_like, shape (3,)
        North, east, down of the origin.
    covariance : array_like, shape (15, 15)
        Of the errors of attitude (rotation vector d about the body's axes, truth = q exp(d)), velocity, position, gyro
        bias, accelerometer bias, in this order. `deviations` makes a diagonal one.
    gyro_bias_radps, accelerometer_bias_mps2 : array_like, shape (3,)
    t_s : float
        When.
    """

    quaternion: npt.ArrayLike
    velocity_mps: npt.ArrayLike
    position_m: npt.ArrayLike
    covariance: npt.ArrayLike
    gyro_bias_radps: npt.ArrayLike = field(default_factory=lambda: np.zeros(3))
    accelerometer_bias_mps2: npt.ArrayLike = field(default_factory=lambda: np.zeros(3))
    t_s: float = 0.0

    @staticmethod
    def deviations(
        *,
        tilt_rad: float,
        heading_rad: float,
        velocity_mps: float,
        position_m: float,
        gyro_bias_radps: float,
        accelerometer_bias_mps2: float,
    ) -> _Array:
        """A diagonal covariance, shape (15, 15), from standard deviations; tilt about forward and right, heading about
        down of a body that is about level."""
        three = np.ones(3)
        sigma = np.concatenate(
            [
                [tilt_rad, tilt_rad, heading_rad],
                velocity_mps * three,
                position_m * three,
                gyro_bias_radps * three,
                accelerometer_bias_mps2 * three,
            ]
        )
        return np.diag(sigma**2)

    def off_by(self, error: npt.ArrayLike) -> StrapdownStart:
        """A start for which this one would be the truth after adding `error`, shape (15,): what a Monte-Carlo run with
        an initial error begins with."""
        moved = _navigation.strapdown_retract(self._numbers, -np.asarray(error, dtype=np.float64).reshape(1, -1))[0]
        return replace(
            self,
            quaternion=moved[:4],
            velocity_mps=moved[4:7],
            position_m=moved[7:10],
            gyro_bias_radps=moved[10:13],
            accelerometer_bias_mps2=moved[13:],
        )

    @property
    def _numbers(self) -> _Array:
        return _rows(
            self.quaternion, self.velocity_mps, self.position_m, self.gyro_bias_radps, self.accelerometer_bias_mps2
        )


def strapdown_errors(
    run: StrapdownRun,
    *,
    quaternion: npt.ArrayLike,
    velocity_mps: npt.ArrayLike,
    position_m: npt.ArrayLike,
    gyro_bias_radps: npt.ArrayLike,
    accelerometer_bias_mps2: npt.ArrayLike,
) -> _Array:
    """Errors of a run's records in the 15 states its covariances are of.

    Parameters
    ----------
    run : StrapdownRun
    quaternion : array_like, shape (r, 4)
        The truth, at the times of the records.
    velocity_mps, position_m, gyro_bias_radps, accelerometer_bias_mps2 : array_like, shape (r, 3) or (3,)

    Returns
    -------
    ndarray, shape (r, 15), float64
        Attitude (truth = q exp(d)), velocity, position, gyro bias, accelerometer bias: truth minus estimate.
    """
    estimates = _rows(
        run.quaternion, run.velocity_mps, run.position_m, run.gyro_bias_radps, run.accelerometer_bias_mps2
    )
    truths = _rows(quaternion, velocity_mps, position_m, gyro_bias_radps, accelerometer_bias_mps2)
    return _navigation.strapdown_local(estimates, truths)


def _rows(*parts: npt.ArrayLike) -> _Array:
    """Parts of states side by side; those of a single row repeat."""
    tables = [np.atleast_2d(np.asarray(part, dtype=np.float64)) for part in parts]
    count = max(len(table) for table in tables)
    return np.hstack([np.broadcast_to(table, (count, table.shape[1])) for table in tables])


class StrapdownNavigator:
    """Strapdown inertial navigation aided by the change of range to transmitters that stand still.

    An extended Kalman filter of 15 error states: attitude, velocity, position, gyro and accelerometer biases, in
    north-east-down of the origin. Immutable: a run leaves it as it is.

    Parameters
    ----------
    transmitters_m : array_like, shape (k, 3)
        Where they stand, along the axes of `frame`; ``np.empty((0, 3))`` for none.
    start : StrapdownStart
    frame : LocalFrame
        North-east-down or east-north-up; only its origin counts for what comes out, which is north-east-down.
    noise : ImuNoise
    period_s : float
        Time between samples.
    range_sigma_m : float
        Standard deviation of a range change.
    reference_m : array_like, shape (3,), optional
        Where the receiver was when the range changes were zero, along the axes of `frame`; `start`'s position without.
    ambiguity_m : float
        Range changes are known modulo this; the prediction says which multiple.
    gate_sigmas, gate_floor_m : float
        An innovation is refused when it exceeds both so many of its standard deviations and so many metres.
    gap_periods, gyro_range_radps, accelerometer_range_mps2 : float
        What samples are held against: see `soopnav_cpp.inertial.judge_samples`.
    gap_rate_sigma_radps, gap_acceleration_sigma_mps2 : float
        Unknown, constant rate and acceleration over time without usable samples, in each axis: what the covariance
        grows by.
    coning_samples : int
        Earlier samples used against coning and sculling, 0 ... 4.
    zero_velocity : ZeroVelocity, optional
        Tells rest; velocity is then taken as zero once for each window.
    zero_velocity_sigma_mps : float
        What "at rest" allows.
    hold_heading : bool
        At rest the mean rate is taken as gyro bias and Earth rate as well.
    zero_rate_sigma_radps : float
        What "at rest" allows of turning.

    Raises
    ------
    ValueError
        For shapes that do not fit, what is not finite, deviations that are not positive, a covariance that is none.
    """

    __slots__ = ("_navigator", "_transmitters")

    def __init__(
        self,
        transmitters_m: npt.ArrayLike,
        start: StrapdownStart,
        *,
        frame: LocalFrame,
        noise: ImuNoise,
        period_s: float,
        range_sigma_m: float = 1.0,
        reference_m: npt.ArrayLike | None = None,
        ambiguity_m: float = math.inf,
        gate_sigmas: float = math.inf,
        gate_floor_m: float = 0.0,
        gap_periods: float = 1.5,
        gyro_range_radps: float = math.inf,
        accelerometer_range_mps2: float = math.inf,
        gap_rate_sigma_radps: float = 0.2,
        gap_acceleration_sigma_mps2: float = 1.0,
        coning_samples: int = 4,
        zero_velocity: ZeroVelocity | None = None,
        zero_velocity_sigma_mps: float = 0.01,
        hold_heading: bool = False,
        zero_rate_sigma_radps: float = 1e-4,
    ) -> None:
        transmitters = np.asarray(transmitters_m, dtype=np.float64)
        reference = None if reference_m is None else np.asarray(reference_m, dtype=np.float64)
        if transmitters.ndim != 2 or transmitters.shape[1] != 3:
            raise ValueError(f"transmitters_m: expected shape (k, 3), got {transmitters.shape}")
        if frame.axes == LocalAxes.ENU:
            transmitters = _swapped(transmitters)
            reference = None if reference is None else _swapped(reference)
        self._transmitters = len(transmitters)
        self._navigator = _navigation.StrapdownNavigator(
            transmitters,
            origin=[frame.latitude_rad, frame.longitude_rad, frame.height_m],
            reference_m=start.position_m if reference is None else reference,
            start_s=start.t_s,
            quaternion=start.quaternion,
            velocity_mps=start.velocity_mps,
            position_m=start.position_m,
            gyro_bias_radps=start.gyro_bias_radps,
            accelerometer_bias_mps2=start.accelerometer_bias_mps2,
            covariance=np.asarray(start.covariance, dtype=np.float64),
            noise=noise._numbers,
            period_s=period_s,
            gap_periods=gap_periods,
            gyro_range_radps=gyro_range_radps,
            accelerometer_range_mps2=accelerometer_range_mps2,
            gap_rate_sigma_radps=gap_rate_sigma_radps,
            gap_acceleration_sigma_mps2=gap_acceleration_sigma_mps2,
            coning_samples=coning_samples,
            range_sigma_m=range_sigma_m,
            ambiguity_m=ambiguity_m,
            gate_sigmas=gate_sigmas,
            gate_floor_m=gate_floor_m,
            zero_velocity=None if zero_velocity is None else zero_velocity._numbers,
            zero_velocity_sigma_mps=zero_velocity_sigma_mps,
            hold_heading=hold_heading,
            zero_rate_sigma_radps=zero_rate_sigma_radps,
        )

    def run(
        self,
        t_s: npt.ArrayLike,
        delta_theta_b: npt.ArrayLike,
        delta_velocity_b: npt.ArrayLike,
        *,
        epochs_s: npt.ArrayLike | None = None,
        range_changes_m: npt.ArrayLike | None = None,
        record_every: int = 1,
        covariance: bool = False,
    ) -> StrapdownRun:
        """A whole run.

        Parameters
        ----------
        t_s : array_like, shape (n,)
            Time of the end of each sample.
        delta_theta_b, delta_velocity_b : array_like, shape (n, 3)
        epochs_s : array_like, shape (e,), optional
            Times of range changes, in order; between samples too. Without it, inertial navigation alone.
        range_changes_m : array_like, shape (e, k), optional
            Positive when receding; NaN where there is none, whose status is NON_FINITE.
        record_every : int
            Samples from one record to the next.
        covariance : bool
            Whether whole covariances are recorded; standard deviations always are.

        Returns
        -------
        StrapdownRun
            Records ``t_s``, ``position_m``, ``velocity_mps``, ``quaternion``, ``gyro_bias_radps``,
            ``accelerometer_bias_mps2``, ``sigma``, ``covariance``; for each epoch ``innovation_m``,
            ``innovation_sigma_m``, ``nis``, ``update_status``; for each sample ``imu_status``.

        Raises
        ------
        ValueError
            For shapes that do not fit. What the data hold gives statuses.
        """
        if (epochs_s is None) != (range_changes_m is None):
            raise ValueError("epochs_s, range_changes_m: both or none expected")
        epochs = np.empty(0) if epochs_s is None else np.asarray(epochs_s, dtype=np.float64)
        changes = np.empty((0, self._transmitters)) if range_changes_m is None else np.asarray(range_changes_m)
        if changes.shape != (len(epochs), self._transmitters):
            raise ValueError(
                f"range_changes_m: expected shape ({len(epochs)}, {self._transmitters}), got {changes.shape}"
            )
        theta, velocity = (np.asarray(a, dtype=np.float64) for a in (delta_theta_b, delta_velocity_b))
        for name, array in (("delta_theta_b", theta), ("delta_velocity_b", velocity)):
            if array.shape != (np.size(t_s), 3):
                raise ValueError(f"{name}: expected shape ({np.size(t_s)}, 3), got {array.shape}")
        return self._navigator.run(
            t_s,
            theta,
            velocity,
            epochs_s=epochs,
            range_changes_m=changes,
            record_every=record_every,
            covariance=covariance,
        )

    def __repr__(self) -> str:
        return f"StrapdownNavigator({self._transmitters} transmitters)"


def _swapped(enu: _Array) -> _Array:
    """East-north-up as north-east-down."""
    return np.stack([enu[..., 1], enu[..., 0], -enu[..., 2]], axis=-1)
