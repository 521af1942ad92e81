"""Attitude from carrier-phase differences between antennas."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import gnss as _gnss
from soopnav_cpp._core.gnss import AttitudeStatus

__all__ = [
    "AttitudeFilter",
    "AttitudeFixes",
    "AttitudeRun",
    "AttitudeStatus",
    "HeadingError",
    "acquire_attitude",
    "arrival_angle",
    "arrival_angle_sigma",
    "attitude_fix",
    "heading_error",
    "heading_error_density",
    "resolve_cycles",
]

_Array = npt.NDArray[np.float64]
_L1_M = 299_792_458.0 / 1575.42e6


def arrival_angle(path_difference_m: npt.ArrayLike, baseline_m: float) -> _Array:
    """Angle between a baseline and the direction to a source, acos(path / baseline) (carter eq. 3.17) [rad].

    Parameters
    ----------
    path_difference_m : array_like
        How much shorter the way to the baseline's end is than that to its start; clipped at the baseline.
    baseline_m : float
        Positive.

    Returns
    -------
    ndarray, same shape
        0 … π; NaN for what is not finite.
    """
    if not baseline_m > 0.0:
        raise ValueError(f"baseline_m = {baseline_m} must be positive")
    path = np.asarray(path_difference_m, dtype=np.float64)
    return _gnss.arrival_angle(path.ravel(), baseline_m).reshape(path.shape)


def arrival_angle_sigma(angle_rad: npt.ArrayLike, baseline_m: float, path_sigma_m: float) -> _Array:
    """First-order deviation of `arrival_angle`, σ / (B sin θ) [rad]: infinite along the baseline, where it is wrong.

    It holds within 10 % where B (1 - \\|cos θ\\|) ≥ 3 σ and σ ≤ B/4.
    """
    if not baseline_m > 0.0:
        raise ValueError(f"baseline_m = {baseline_m} must be positive")
    if not path_sigma_m >= 0.0:
        raise ValueError(f"path_sigma_m = {path_sigma_m} must be at least 0")
    angle = np.asarray(angle_rad, dtype=np.float64)
    return _gnss.arrival_angle_sigma(angle.ravel(), baseline_m, path_sigma_m).reshape(angle.shape)


@dataclass(frozen=True)
class AttitudeFixes:
    """Attitudes, a row for each epoch (a single epoch: without that axis). NaN where there is none.

    Attributes
    ----------
    status : ndarray of uint8, shape (n,)
        Values of `AttitudeStatus`.
    quaternion : ndarray, shape (n, 4)
        w, x, y, z: body to reference.
    euler_rad : ndarray, shape (n, 3)
        Yaw, pitch, roll.
    covariance_rad2 : ndarray, shape (n, 3, 3)
        Of the rotation vector d about the body's axes, truth = q exp(d).
    euler_covariance_rad2 : ndarray, shape (n, 3, 3)
        Of yaw, pitch, roll; NaN at pitch ±90°.
    chi_square : ndarray, shape (n,)
    degrees_of_freedom, iterations : ndarray of int64, shape (n,)
    unobservable : ndarray, shape (n, 3)
        With status UNOBSERVABLE: the body axis about which the turn is free.
    ratio : ndarray, shape (n,)
        Of `acquire_attitude`: second-best χ² over the best.
    """

    status: npt.NDArray[np.uint8]
    quaternion: _Array
    euler_rad: _Array
    covariance_rad2: _Array
    euler_covariance_rad2: _Array
    chi_square: _Array
    degrees_of_freedom: npt.NDArray[np.int64]
    iterations: npt.NDArray[np.int64]
    unobservable: _Array
    ratio: _Array

    def __repr__(self) -> str:
        if self.status.ndim == 0:
            name = AttitudeStatus(int(self.status)).name.lower().replace("_", " ")
            yaw, pitch, roll = np.rad2deg(self.euler_rad)
            return f"AttitudeFixes({name}, yaw {yaw:.2f}°, pitch {pitch:.2f}°, roll {roll:.2f}°)"
        return f"AttitudeFixes({len(self.status)} epochs, {np.count_nonzero(self.status == 0)} solved)"


def _fixes(columns: tuple[_Array, ...], single: bool) -> AttitudeFixes:
    c = [column[0] for column in columns] if single else list(columns)
    return AttitudeFixes(
        status=np.asarray(c[0]).astype(np.uint8),
        chi_square=c[1],
        degrees_of_freedom=np.asarray(c[2]).astype(np.int64),
        iterations=np.asarray(c[3]).astype(np.int64),
        ratio=c[4],
        quaternion=c[5],
        euler_rad=c[6],
        covariance_rad2=c[7],
        euler_covariance_rad2=c[8],
        unobservable=c[9],
    )


def _epochs(name: str, values: npt.ArrayLike) -> tuple[_Array, bool]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim not in (2, 3):
        raise ValueError(f"{name}: shape (k, m) or (n, k, m) expected, got {array.shape}")
    return (array, False) if array.ndim == 3 else (array[None], True)


def attitude_fix(
    path_differences_m: npt.ArrayLike,
    baselines_m: npt.ArrayLike,
    directions: npt.ArrayLike,
    sigma_m: float = 0.005,
    *,
    start: npt.ArrayLike | None = None,
    common_clock: bool = True,
    shared_reference: bool = False,
) -> AttitudeFixes:
    """Attitude from path differences between antennas, epoch by epoch, by non-linear least squares.

    Model (carter eq. 3.19): path = b · (Tᵀ u) + noise: how much nearer antenna i is to a satellite than antenna 0,
    which is -λ times the difference of carrier phases that grow with range, integers known. The minimum is that of the
    paper's Euler angles (3.19 to 3.21), found on the rotation vector, which has no gimbal lock.

    Parameters
    ----------
    path_differences_m : array_like, shape (k, m) or (n, k, m)
        k baselines, m satellites; NaN where there is nothing.
    baselines_m : array_like, shape (k, 3)
        From antenna 0 to antenna i in body axes; 1 … 8.
    directions : array_like, shape (m, 3) or (n, m, 3)
        Unit vectors to the satellites in the reference (north-east-down or east-north-up).
    sigma_m : float
        Of each path difference.
    start : array_like, shape (4,), optional
        Quaternion to start from. Without it a closed form: vectors by least squares, then Wahba's problem.
    common_clock : bool
        All antennas on one oscillator; otherwise each baseline has a clock term of its own.
    shared_reference : bool
        Baselines share the noise of antenna 0; the paper takes them as independent.

    Returns
    -------
    AttitudeFixes
        With a leading axis of epochs if the input has one.

    Raises
    ------
    ValueError
        For shapes that differ and parameters out of range. Too few satellites, satellites in one plane and parallel
        baselines are no error but a ``status``.
    """
    model = _gnss.AttitudeModel(baselines_m, sigma_m, common_clock, shared_reference)
    path, single = _epochs("path_differences_m", path_differences_m)
    return _fixes(_gnss.attitude_fixes(model, directions, path, start, 0.0, 1.0), single)


def acquire_attitude(
    phase_cycles: npt.ArrayLike,
    baselines_m: npt.ArrayLike,
    directions: npt.ArrayLike,
    sigma_m: float = 0.005,
    *,
    wavelength_m: float = _L1_M,
    min_ratio: float = 3.0,
) -> AttitudeFixes:
    """Attitude without a start from phase differences known up to whole cycles, baselines up to 3 wavelengths.

    The first baseline is searched over the sphere and the turn about it over the circle, integers rounded at each
    point, the best refined. Common clock; two baselines that are not parallel.

    Parameters
    ----------
    phase_cycles : array_like, shape (k, m) or (n, k, m)
        Antenna i minus antenna 0, growing with range, any whole cycles.
    baselines_m, directions, sigma_m
        As in `attitude_fix`.
    wavelength_m : float
    min_ratio : float
        Second-best over best χ² below which the status is AMBIGUOUS.

    Returns
    -------
    AttitudeFixes
    """
    if not wavelength_m > 0.0:
        raise ValueError(f"wavelength_m = {wavelength_m} must be positive")
    model = _gnss.AttitudeModel(baselines_m, sigma_m, True, False)
    phase, single = _epochs("phase_cycles", phase_cycles)
    return _fixes(_gnss.attitude_fixes(model, directions, phase, None, wavelength_m, min_ratio), single)


def resolve_cycles(
    phase_cycles: npt.ArrayLike,
    baselines_m: npt.ArrayLike,
    directions: npt.ArrayLike,
    quaternion: npt.ArrayLike,
    *,
    common_clock: bool = True,
    wavelength_m: float = _L1_M,
) -> tuple[_Array, float]:
    """Path differences from phase differences known up to whole cycles, about a predicted attitude.

    Beyond half a wavelength the integers cannot be dropped as carter's (2.26) does: at 0.9 wavelengths more than a
    third of the differences exceed half a cycle.

    Parameters
    ----------
    phase_cycles : array_like, shape (k, m)
        Antenna i minus antenna 0, growing with range.
    baselines_m, directions
        As in `attitude_fix`.
    quaternion : array_like, shape (4,)
        The prediction.
    common_clock : bool
    wavelength_m : float

    Returns
    -------
    path_differences_m : ndarray, shape (k, m)
    farthest_cycles : float
        Greatest distance from the prediction: near 1/2 the integers are not to be trusted.
    """
    if not wavelength_m > 0.0:
        raise ValueError(f"wavelength_m = {wavelength_m} must be positive")
    model = _gnss.AttitudeModel(baselines_m, 1.0, common_clock, False)
    phase = np.asarray(phase_cycles, dtype=np.float64)
    if phase.ndim != 2:
        raise ValueError(f"phase_cycles: shape (k, m) expected, got {phase.shape}")
    return _gnss.resolve_cycles(model, quaternion, directions, phase[None], wavelength_m)


@dataclass(frozen=True)
class AttitudeRun:
    """What an `AttitudeFilter` estimated, a row for each epoch.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    status : ndarray of uint8, shape (n,)
        Values of `AttitudeStatus`; other than SOLVED: no update.
    quaternion : ndarray, shape (n, 4)
    euler_rad : ndarray, shape (n, 3)
        Yaw, pitch, roll.
    covariance_rad2 : ndarray, shape (n, 3, 3)
        Of the rotation vector about the body's axes, or with ``parameters="euler"`` of yaw, pitch, roll.
    nis : ndarray, shape (n,)
        Normalised innovation squared.
    rows : ndarray of int64, shape (n,)
        Its degrees of freedom.
    farthest_cycles : ndarray, shape (n,)
        Where integers were resolved: greatest distance of a phase from the prediction.
    """

    t_s: _Array
    status: npt.NDArray[np.uint8]
    quaternion: _Array
    euler_rad: _Array
    covariance_rad2: _Array
    nis: _Array
    rows: npt.NDArray[np.int64]
    farthest_cycles: _Array

    def __repr__(self) -> str:
        return f"AttitudeRun({len(self.t_s)} epochs, {np.count_nonzero(self.status == 0)} updated)"


class AttitudeFilter:
    """Extended Kalman filter of an attitude (carter eq. 3.22 to 3.26, the predicted P in the last).

    A random walk, turned by measured rates when there are any. Whole runs go through the compiled engine in one call.

    Parameters
    ----------
    baselines_m : array_like, shape (k, 3)
        From antenna 0 to antenna i in body axes.
    start : array_like, shape (4,)
        Quaternion w, x, y, z, body to reference.
    covariance_rad2 : array_like, shape (3, 3)
        Of the start: of the rotation vector about the body's axes, or of yaw, pitch, roll.
    parameters : {"quaternion", "euler"}
        The quaternion works at any attitude; Euler angles, as the paper's, refuse updates within 1.1° of pitch ±90°.
    sigma_m : float
        Of each path difference.
    rate_noise_rad_rts : float
        Random walk of each angle, rad/√s.
    common_clock, shared_reference : bool
        As in `attitude_fix`.
    false_alarm_probability : float
        With which a good epoch is refused; 0: no gate.

    Raises
    ------
    ValueError
        For parameters out of range.
    """

    def __init__(
        self,
        baselines_m: npt.ArrayLike,
        start: npt.ArrayLike,
        covariance_rad2: npt.ArrayLike,
        *,
        parameters: Literal["quaternion", "euler"] = "quaternion",
        sigma_m: float = 0.005,
        rate_noise_rad_rts: float = 5e-3,
        common_clock: bool = True,
        shared_reference: bool = False,
        false_alarm_probability: float = 0.0,
    ) -> None:
        if parameters not in ("quaternion", "euler"):
            raise ValueError(f"parameters: expected one of 'quaternion', 'euler', got {parameters!r}")
        self._model = _gnss.AttitudeModel(baselines_m, sigma_m, common_clock, shared_reference)
        self._count = len(np.asarray(baselines_m))
        self._euler = parameters == "euler"
        self._rate_noise = rate_noise_rad_rts
        self._false_alarm = false_alarm_probability
        self._t_s: float | None = None
        self._q: _Array = np.array(start, dtype=np.float64)
        self._P: _Array = np.array(covariance_rad2, dtype=np.float64)
        self._engine(np.empty(0), np.empty((0, self._count, 0)), np.empty((0, 3)), None, 0.0)  # checks

    def _engine(
        self, steps: _Array, path: _Array, directions: npt.ArrayLike, rates: npt.ArrayLike | None, wavelength_m: float
    ) -> tuple[_Array, ...]:
        return _gnss.attitude_run(
            self._model,
            self._euler,
            self._rate_noise,
            self._false_alarm,
            self._q,
            self._P,
            steps,
            directions,
            path,
            rates,
            wavelength_m,
        )

    @property
    def quaternion(self) -> _Array:
        """The present attitude, shape (4,)."""
        return np.array(self._q)

    @property
    def covariance_rad2(self) -> _Array:
        """Its covariance, shape (3, 3)."""
        return np.array(self._P)

    def run(
        self,
        t_s: npt.ArrayLike,
        path_differences_m: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        rates_radps: npt.ArrayLike | None = None,
        wavelength_m: float | None = None,
    ) -> AttitudeRun:
        """Filter epochs in the order of their times; the state goes on from the last call.

        Parameters
        ----------
        t_s : array_like, shape (n,)
            Not falling. Before the first epoch ever nothing is predicted.
        path_differences_m : array_like, shape (n, k, m)
            With `wavelength_m`: phase differences in cycles instead, known up to whole cycles, which are resolved
            about each prediction.
        directions : array_like, shape (m, 3) or (n, m, 3)
        rates_radps : array_like, shape (n, 3), optional
            Mean rate of the body against the reference up to each epoch, body axes.
        wavelength_m : float, optional

        Returns
        -------
        AttitudeRun

        Raises
        ------
        ValueError
            For shapes that differ and times that fall. Epochs that cannot be used have a ``status``.
        """
        t = np.asarray(t_s, dtype=np.float64)
        if t.ndim != 1 or not np.isfinite(t).all() or (np.diff(t) < 0.0).any():
            raise ValueError("t_s: finite times that do not fall expected, shape (n,)")
        if len(t) and self._t_s is not None and t[0] < self._t_s:
            raise ValueError(f"t_s[0] = {t[0]}: not before the last epoch, {self._t_s}, expected")
        if wavelength_m is not None and not wavelength_m > 0.0:
            raise ValueError(f"wavelength_m = {wavelength_m} must be positive")
        steps = np.diff(t, prepend=t[:1] if self._t_s is None else self._t_s)
        path = np.asarray(path_differences_m, dtype=np.float64)
        c = self._engine(steps, path, directions, rates_radps, wavelength_m or 0.0)
        if len(t):
            self._t_s, self._q, self._P = float(t[-1]), c[4][-1].copy(), c[6][-1].copy()
        return AttitudeRun(
            t_s=t,
            status=c[0].astype(np.uint8),
            nis=c[1],
            rows=c[2].astype(np.int64),
            farthest_cycles=c[3],
            quaternion=c[4],
            euler_rad=c[5],
            covariance_rad2=c[6],
        )

    def step(
        self,
        t_s: float,
        path_differences_m: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        rate_radps: npt.ArrayLike | None = None,
        wavelength_m: float | None = None,
    ) -> AttitudeRun:
        """`run` with one epoch: `path_differences_m` of shape (k, m)."""
        rates = None if rate_radps is None else np.asarray(rate_radps, dtype=np.float64)[None]
        path = np.asarray(path_differences_m, dtype=np.float64)[None]
        return self.run([t_s], path, directions, rates_radps=rates, wavelength_m=wavelength_m)


class HeadingError(NamedTuple):
    """Error of the heading that is the direction between two positions.

    Attributes
    ----------
    linear_sigma_rad : float
        √2 σ / baseline: what holds for long baselines.
    rms_rad : float
        Exact.
    inversion_probability : float
        That the error exceeds 90°.
    """

    linear_sigma_rad: float
    rms_rad: float
    inversion_probability: float


def heading_error(baseline_m: float, position_sigma_m: float) -> HeadingError:
    """Error of a heading between two antennas whose positions are uncertain (carter section 3.3).

    Parameters
    ----------
    baseline_m : float
        At least 0, in the plane.
    position_sigma_m : float
        Of each coordinate of each position, independent normal errors.

    Raises
    ------
    ValueError
        For a baseline that is negative or a sigma that is not positive, and for either when not finite.
    """
    if not 0.0 <= baseline_m < np.inf:
        raise ValueError(f"baseline_m = {baseline_m} must be a number of at least 0")
    if not 0.0 < position_sigma_m < np.inf:
        raise ValueError(f"position_sigma_m = {position_sigma_m} must be a positive number")
    return HeadingError(*_gnss.heading_error(baseline_m, position_sigma_m))


def heading_error_density(error_rad: npt.ArrayLike, baseline_m: float, position_sigma_m: float) -> _Array:
    """Probability density of that error at `error_rad` in [-π, π] [1/rad]."""
    heading_error(baseline_m, position_sigma_m)
    error = np.asarray(error_rad, dtype=np.float64)
    kappa = float(baseline_m) / (math.sqrt(2.0) * float(position_sigma_m))
    if not kappa < np.inf:
        raise ValueError(f"baseline_m / position_sigma_m = {kappa}: too large")
    return _gnss.heading_error_density(error.ravel(), kappa).reshape(error.shape)
