"""Positions from one-way Dopplers of satellites: the face of the engine's batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import DopplerStatus, DopplerUse

_Array = npt.NDArray[np.float64]
_IRIDIUM_HZ = 1626.270833e6


@dataclass(frozen=True)
class DopplerFix:
    """A place from Dopplers, what it is worth, and what became of each row. NaN where there is no value.

    Attributes
    ----------
    status : DopplerStatus
    position_e_m : ndarray, shape (3,)
        ECEF.
    latitude_rad, longitude_rad, height_m : float
    covariance_enu_m2 : ndarray, shape (3, 3)
        East, north, up, all biases and drifts marginalised; zero for a known height.
    sigma_2d_m : float
        sqrt(east² + north²) of it.
    frequency_bias_hz, frequency_bias_sigma_hz : float
        What the receiver adds to every Doppler, at `reference_s`.
    frequency_drift_hz_per_s, frequency_drift_sigma_hz_per_s : float
        0 without such a state.
    reference_s : float
        Mean time of the rows used.
    sigma_scale : float
        What `estimate_sigma` multiplied the standard deviations by.
    chi_square : float
        Of residuals and priors.
    degrees_of_freedom : int
        Of it.
    satellites : ndarray of int64, shape (k,)
    satellite_rows : ndarray of int64, shape (k,)
        How many rows each has.
    satellite_bias_hz, satellite_bias_sigma_hz, along_track_m, along_track_sigma_m : ndarray, shape (k,)
        0 without such states; along_track_m is how far ahead of its ephemeris a satellite is.
    residuals_hz : ndarray, shape (n,)
        Measured minus fitted.
    use : ndarray of uint8, shape (n,)
        Values of `DopplerUse`.
    alternatives_e_m : ndarray, shape (m, 3)
        Other places that fit.
    alternatives_excess : ndarray, shape (m,)
        Their chi-square over that of the best.
    bias_chi_square, bias_probability : float
        By how much free biases of the satellites lower the chi-square of the residuals, and the probability of as much
        if there were none.
    bias_degrees_of_freedom : int
        Satellites less one.
    iterations : int
    """

    status: DopplerStatus
    position_e_m: _Array
    latitude_rad: float
    longitude_rad: float
    height_m: float
    covariance_enu_m2: _Array
    sigma_2d_m: float
    frequency_bias_hz: float
    frequency_bias_sigma_hz: float
    frequency_drift_hz_per_s: float
    frequency_drift_sigma_hz_per_s: float
    reference_s: float
    sigma_scale: float
    chi_square: float
    degrees_of_freedom: int
    satellites: npt.NDArray[np.int64]
    satellite_rows: npt.NDArray[np.int64]
    satellite_bias_hz: _Array
    satellite_bias_sigma_hz: _Array
    along_track_m: _Array
    along_track_sigma_m: _Array
    residuals_hz: _Array
    use: npt.NDArray[np.uint8]
    alternatives_e_m: _Array
    alternatives_excess: _Array
    bias_chi_square: float
    bias_degrees_of_freedom: int
    bias_probability: float
    iterations: int

    @property
    def used(self) -> npt.NDArray[np.bool_]:
        """Which rows took part, shape (n,)."""
        return np.asarray(self.use == int(DopplerUse.USED))

    def error_enu_m(self, true_position_e_m: npt.ArrayLike) -> _Array:
        """Position minus a truth (ECEF), along east, north, up of the position found; shape (3,)."""
        from soopnav_cpp import geometry

        truth = np.asarray(true_position_e_m, dtype=np.float64)
        if truth.shape != (3,):
            raise ValueError(f"true_position_e_m: shape (3,) expected, got {truth.shape}")
        frame = geometry.LocalFrame(self.latitude_rad, self.longitude_rad, self.height_m)
        return np.asarray(-frame.position_from_ecef(truth))

    def mahalanobis_2d(self, true_position_e_m: npt.ArrayLike) -> float:
        """Squared distance of a truth in the horizontal ellipse: chi-square of two degrees (99 %: 9.21)."""
        error = self.error_enu_m(true_position_e_m)[:2]
        return float(error @ np.linalg.solve(self.covariance_enu_m2[:2, :2], error))

    def __repr__(self) -> str:
        status = self.status.name.lower().replace("_", " ")
        if not np.isfinite(self.position_e_m).all():
            return f"DopplerFix({status}, {np.count_nonzero(self.used)} of {len(self.use)} rows usable)"
        return (
            f"DopplerFix({status}: {np.degrees(self.latitude_rad):.6f}, {np.degrees(self.longitude_rad):.6f} deg, "
            f"{self.height_m:.0f} m, sigma_2d {self.sigma_2d_m:.0f} m, {np.count_nonzero(self.used)} rows of "
            f"{len(self.satellites)} satellites)"
        )


def doppler_fix(
    t_s: npt.ArrayLike,
    satellite: npt.ArrayLike,
    doppler_hz: npt.ArrayLike,
    satellite_position_e_m: npt.ArrayLike,
    satellite_velocity_e_mps: npt.ArrayLike,
    *,
    sigma_hz: npt.ArrayLike = 5.0,
    estimate_sigma: bool = False,
    carrier_hz: float = _IRIDIUM_HZ,
    state_of: Literal["reception", "sending"] = "reception",
    height_m: float | None = None,
    height_sigma_m: float = 0.0,
    frequency_bias_sigma_hz: float = np.inf,
    frequency_drift_sigma_hz_per_s: float = 0.0,
    satellite_bias_sigma_hz: float = 0.0,
    along_track_sigma_m: npt.ArrayLike = 0.0,
    age_s: npt.ArrayLike = 0.0,
    max_age_s: float = np.inf,
    velocity_e_mps: npt.ArrayLike = (0.0, 0.0, 0.0),
    start_e_m: npt.ArrayLike | None = None,
    search: bool = True,
    mask_rad: float = 0.0,
    ambiguity_gate: float = 16.0,
    max_iterations: int = 60,
) -> DopplerFix:
    """Position of a receiver from one-way Dopplers of several satellites, in one batch of any start.

    Weighted least squares with Gaussian priors on height, receiver frequency, a constant of each satellite and its
    error along its orbit (cpp/doc/doppler_fix.md). Gaussian models only, and nothing is rejected: published sets are
    often cut to small residuals at the truth, and a norm that weighs large residuals more than their square, or a loss
    that is tuned on them, then finds the cut, not the place.

    Parameters
    ----------
    t_s : array_like, shape (n,)
        Times of reception.
    satellite : array_like of int, shape (n,)
        Numbers that name the satellites.
    doppler_hz : array_like, shape (n,)
        Received minus nominal frequency, positive when approaching. Rows with a NaN are left out.
    satellite_position_e_m, satellite_velocity_e_mps : array_like, shape (n, 3)
        ECEF; the velocity relative to the turning Earth.
    sigma_hz : array_like, shape () or (n,)
        Standard deviation of each Doppler.
    estimate_sigma : bool
        Scale all of them by one factor to unit variance of the fit.
    carrier_hz : float
        Nominal; the default is Iridium's ring alert.
    state_of : {"reception", "sending"}
        What instant the satellites' states are of: of `t_s`, light time then being solved here, or of the sending as
        `geometry.signal_path` gives it.
    height_m, height_sigma_m : float
        Over the ellipsoid; with a sigma of 0 it is known. Without it three coordinates are estimated.
    frequency_bias_sigma_hz, frequency_drift_sigma_hz_per_s : float
        Priors of the receiver's frequency error and drift; infinity is free, a drift of 0 is none.
    satellite_bias_sigma_hz : float
        Prior of a constant of each satellite; 0 is none.
    along_track_sigma_m : array_like, shape () or (n,)
        Standard deviation of each satellite's orbit along its way (`orbits.AlongTrackError`); 0 is no such state.
    age_s, max_age_s : array_like, float
        Age of the elements; rows with older ones are left out as `DopplerUse.STALE`.
    velocity_e_mps : array_like, shape (3,)
        The receiver's, known.
    start_e_m : array_like, shape (3,), optional
        A start beside the grid.
    search : bool
        Start from a grid over all places that see the satellites.
    mask_rad : float
        Least elevation in that grid, less 3 degrees.
    ambiguity_gate : float
        Another minimum with at most this much more chi-square is reported.
    max_iterations : int

    Returns
    -------
    DopplerFix
        Fewer than four rows or one satellite are no error but a ``status``.

    Raises
    ------
    ValueError
        For lengths that differ and options out of range.
    """
    times = np.asarray(t_s, dtype=np.float64)
    if times.ndim != 1:
        raise ValueError(f"t_s: shape (n,) expected, got {times.shape}")
    if state_of not in ("reception", "sending"):
        raise ValueError(f"state_of: {state_of!r}, 'reception' or 'sending' expected")
    n = len(times)
    names = np.asarray(satellite)
    if names.shape != (n,) or names.dtype.kind not in "iu":
        raise ValueError(f"satellite: whole numbers of shape {(n,)} expected, got {names.dtype} {names.shape}")
    if n and not (np.abs(names) < 2**31).all():
        raise ValueError("satellite: numbers below 2**31 expected")

    def column(name: str, values: npt.ArrayLike, *, one: bool) -> _Array:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (n,) and not (one and array.shape == ()):
            raise ValueError(f"{name}: shape {(n,)} expected, got {array.shape}")
        return np.broadcast_to(array, (n,))

    def vectors(name: str, values: npt.ArrayLike) -> _Array:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (n, 3):
            raise ValueError(f"{name}: shape {(n, 3)} expected, got {array.shape}")
        return array

    table = np.column_stack(
        [
            times,
            names,
            column("doppler_hz", doppler_hz, one=False),
            column("sigma_hz", sigma_hz, one=True),
            vectors("satellite_position_e_m", satellite_position_e_m),
            vectors("satellite_velocity_e_mps", satellite_velocity_e_mps),
            column("along_track_sigma_m", along_track_sigma_m, one=True),
            column("age_s", age_s, one=True),
        ]
    )
    out = _navigation.doppler_fix(
        np.ascontiguousarray(table, dtype=np.float64),
        estimate_sigma=estimate_sigma,
        carrier_hz=float(carrier_hz),
        at_sending=state_of == "sending",
        height_m=None if height_m is None else float(height_m),
        height_sigma_m=float(height_sigma_m),
        frequency_bias_sigma_hz=float(frequency_bias_sigma_hz),
        frequency_drift_sigma_hz_per_s=float(frequency_drift_sigma_hz_per_s),
        satellite_bias_sigma_hz=float(satellite_bias_sigma_hz),
        max_age_s=float(max_age_s),
        velocity_e_mps=velocity_e_mps,
        start_e_m=start_e_m,
        search=search,
        mask_rad=float(mask_rad),
        ambiguity_gate=float(ambiguity_gate),
        max_iterations=max_iterations,
    )
    found = out.pop("satellites")
    for array in out.values():
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return DopplerFix(
        **out,
        satellites=found[:, 0].astype(np.int64),
        satellite_rows=found[:, 1].astype(np.int64),
        satellite_bias_hz=found[:, 2],
        satellite_bias_sigma_hz=found[:, 3],
        along_track_m=found[:, 4],
        along_track_sigma_m=found[:, 5],
    )
