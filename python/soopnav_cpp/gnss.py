"""Satellite navigation: broadcast orbits, RINEX files, positions from pseudoranges.

Positions and velocities are ECEF (WGS 84). A time is a GPS week (counted from 1980-01-06, without rollover) and a
second of it. `read_observations` and `read_navigation` need the extra ``gnss``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp import _gnss_point
from soopnav_cpp._core import gnss as _gnss
from soopnav_cpp._core.gnss import PointStatus, SatelliteUse
from soopnav_cpp._gnss_attitude import (
    AttitudeFilter,
    AttitudeFixes,
    AttitudeRun,
    AttitudeStatus,
    HeadingError,
    acquire_attitude,
    arrival_angle,
    arrival_angle_sigma,
    attitude_fix,
    heading_error,
    heading_error_density,
    resolve_cycles,
)
from soopnav_cpp._gnss_baseline import (
    BaselineRun,
    BaselineStatus,
    ReceiverDifferences,
    baseline_fix,
    lambda_ils,
    receiver_differences,
    solve_baseline,
    success_rate,
)
from soopnav_cpp._gnss_data import (
    L1_HZ,
    L1_M,
    Ephemerides,
    Observations,
    read_navigation,
    read_observations,
    walker_constellation,
)
from soopnav_cpp._gnss_point import PointFixes
from soopnav_cpp._gps_phase import L2_HZ, PhaseUse, StaticPhaseFix, StaticPhaseStatus, ionosphere_free, static_phase

__all__ = [
    "L1_HZ",
    "L1_M",
    "L2_HZ",
    "AttitudeFilter",
    "AttitudeFixes",
    "AttitudeRun",
    "AttitudeStatus",
    "BaselineRun",
    "BaselineStatus",
    "Ephemerides",
    "HeadingError",
    "Observations",
    "PhaseUse",
    "PointFixes",
    "PointStatus",
    "ReceiverDifferences",
    "SatelliteStates",
    "SatelliteUse",
    "Sights",
    "StaticPhaseFix",
    "StaticPhaseStatus",
    "acquire_attitude",
    "arrival_angle",
    "arrival_angle_sigma",
    "attitude_fix",
    "baseline_fix",
    "cycle_slips",
    "heading_error",
    "heading_error_density",
    "ionosphere_free",
    "lambda_ils",
    "read_navigation",
    "read_observations",
    "receiver_differences",
    "resolve_cycles",
    "satellite_state",
    "sights",
    "single_point",
    "solve_baseline",
    "static_phase",
    "success_rate",
    "walker_constellation",
]

_Array = npt.NDArray[np.float64]


class SatelliteStates(NamedTuple):
    """Satellites and their clocks; NaN where there was no ephemeris in time.

    Attributes
    ----------
    position_m : ndarray, shape (..., 3)
        ECEF of that instant.
    velocity_mps : ndarray, shape (..., 3)
        Relative to the rotating Earth.
    clock_s : ndarray, shape (...)
        What the clock is ahead of GPS time for a user of L1 C/A, relativity and group delay included.
    clock_rate : ndarray, shape (...)
    """

    position_m: _Array
    velocity_mps: _Array
    clock_s: _Array
    clock_rate: _Array


def satellite_state(
    ephemerides: Ephemerides,
    prn: npt.ArrayLike,
    time_of_week_s: npt.ArrayLike,
    week: npt.ArrayLike | None = None,
    *,
    max_age_s: float = 0.0,
) -> SatelliteStates:
    """Orbit and clock of satellites at GPS times (IS-GPS-200 table 20-IV).

    Of each satellite the message nearest in time is taken.

    Parameters
    ----------
    ephemerides : Ephemerides
    prn, time_of_week_s, week : array_like
        Satellites and times; broadcast against each other. Without `week` that of the first message.
    max_age_s : float
        How far from its reference time a message is used; 0: half its fit interval.

    Returns
    -------
    SatelliteStates
        In the broadcast shape.
    """
    if week is None:
        week = int(ephemerides.records["week"][0]) if len(ephemerides) else 0
    prns, seconds, weeks = np.broadcast_arrays(
        np.asarray(prn, dtype=np.float64), np.asarray(time_of_week_s, np.float64), np.asarray(week, np.float64)
    )
    position, velocity, clock, rate = _gnss.satellite_states(
        ephemerides._table, prns.ravel(), weeks.ravel(), seconds.ravel(), max_age_s
    )
    shape = prns.shape
    return SatelliteStates(
        position.reshape(*shape, 3), velocity.reshape(*shape, 3), clock.reshape(shape), rate.reshape(shape)
    )


class Sights(NamedTuple):
    """Satellites as a receiver sees them, rows epochs, columns satellites; NaN without ephemeris in time.

    Attributes
    ----------
    position_m, velocity_mps : ndarray, shape (n, s, 3)
        At the transmission, in the ECEF axes of the reception (the Earth's turn during the flight taken out).
    direction : ndarray, shape (n, s, 3)
        Unit vector from receiver to satellite, ECEF.
    range_m : ndarray, shape (n, s)
        Geometric range, c times the flight time.
    range_rate_mps : ndarray, shape (n, s)
        Positive when receding.
    azimuth_rad, elevation_rad : ndarray, shape (n, s)
        Azimuth from north towards east.
    clock_s, clock_rate : ndarray, shape (n, s)
        Of the satellite, as in `SatelliteStates`.
    """

    position_m: _Array
    velocity_mps: _Array
    direction: _Array
    range_m: _Array
    range_rate_mps: _Array
    azimuth_rad: _Array
    elevation_rad: _Array
    clock_s: _Array
    clock_rate: _Array


def sights(
    ephemerides: Ephemerides,
    prn: npt.ArrayLike,
    time_of_week_s: npt.ArrayLike,
    week: npt.ArrayLike,
    receiver_position_m: npt.ArrayLike,
    receiver_velocity_mps: npt.ArrayLike = (0.0, 0.0, 0.0),
    *,
    max_age_s: float = 0.0,
) -> Sights:
    """What a receiver at a known place receives of each satellite at each GPS time, flight time and Sagnac included.

    Parameters
    ----------
    ephemerides : Ephemerides
    prn : array_like, shape (s,)
    time_of_week_s : array_like, shape (n,)
        True GPS times of reception; week as well, or one for all.
    week : array_like, shape (n,) or ()
    receiver_position_m, receiver_velocity_mps : array_like, shape (3,)
        ECEF.
    max_age_s : float
        As in `satellite_state`.

    Raises
    ------
    ValueError
        For a position that is none near the Earth.
    """
    seconds, weeks = np.broadcast_arrays(
        np.atleast_1d(np.asarray(time_of_week_s, np.float64)), np.asarray(week, np.float64)
    )
    return Sights(
        *_gnss.sights(
            ephemerides._table,
            np.atleast_1d(np.asarray(prn, dtype=np.float64)),
            weeks,
            seconds,
            receiver_position_m,
            receiver_velocity_mps,
            max_age_s,
        )
    )


def cycle_slips(
    observations: Observations,
    *,
    threshold_cycles: float = 0.7,
    code_threshold_m: float = 15.0,
    max_gap_s: float = 5.0,
    wavelength_m: float = L1_M,
) -> npt.NDArray[np.bool_]:
    """Where the count of carrier cycles is not the one of the epoch before.

    A slip is said where the receiver says it (bit 0 of the loss-of-lock indicator), after a gap, where code minus
    carrier jumps, and where the phase leaves the parabola through the three epochs before it. The last is taken against
    the median of all satellites, so that a step of the receiver's clock is none. At 1 Hz and standing still one
    cycle shows; a receiver in motion needs a larger threshold.

    Parameters
    ----------
    observations : Observations
    threshold_cycles : float
        Of the third difference of phases.
    code_threshold_m : float
        Of the change of code minus carrier between epochs.
    max_gap_s : float
        Longest time between two epochs of an unbroken phase.
    wavelength_m : float

    Returns
    -------
    ndarray of bool, shape (n, s)
        True at the first epoch of each new count. The first phase of a satellite is no slip.
    """
    for name, value in (
        ("threshold_cycles", threshold_cycles),
        ("code_threshold_m", code_threshold_m),
        ("max_gap_s", max_gap_s),
        ("wavelength_m", wavelength_m),
    ):
        if not value > 0.0:
            raise ValueError(f"{name} = {value} must be positive")
    phase, code = observations.phase_cycles, observations.code_m
    elapsed = observations.elapsed_s
    n, s = phase.shape
    slips = np.zeros((n, s), dtype=np.bool_)
    before = np.full((3, s), np.nan)  # phases of the unbroken epochs before, the latest first
    times = np.full((3, s), np.nan)
    last_difference = np.full(s, np.nan)  # code minus carrier
    for k in range(n):
        seen = np.isfinite(phase[k])
        known = seen & np.isfinite(before[0])
        difference = code[k] - wavelength_m * phase[k]
        # The parabola through three points, at this time (Lagrange).
        t0, t1, t2 = (elapsed[k] - times[i] for i in range(3))
        with np.errstate(invalid="ignore", divide="ignore"):
            predicted = (
                before[0] * (t1 * t2) / ((t1 - t0) * (t2 - t0))
                + before[1] * (t0 * t2) / ((t0 - t1) * (t2 - t1))
                + before[2] * (t0 * t1) / ((t0 - t2) * (t1 - t2))
            )
        off = phase[k] - predicted
        usable = np.isfinite(off)
        if np.count_nonzero(usable) >= 3:
            off = off - np.median(off[usable])
        broken = (observations.lli[k] & 1).astype(np.bool_)
        with np.errstate(invalid="ignore"):
            broken |= (elapsed[k] - times[0]) > max_gap_s
            broken |= np.abs(difference - last_difference) > code_threshold_m
            broken |= np.abs(off) > threshold_cycles
        slips[k] = known & broken
        before[:, slips[k]] = np.nan
        times[:, slips[k]] = np.nan
        before[1:, seen], before[0, seen] = before[:-1, seen], phase[k, seen]
        times[1:, seen], times[0, seen] = times[:-1, seen], elapsed[k]
        last_difference = np.where(seen, difference, last_difference)
    return slips


def single_point(
    observations: Observations,
    ephemerides: Ephemerides,
    *,
    sigmas_m: npt.ArrayLike | None = None,
    elevation_mask_rad: float = np.deg2rad(10.0),
    sigma_m: float = 1.0,
    sigma_rate_mps: float = 0.05,
    weight_by_elevation: bool = True,
    ionosphere: bool = True,
    troposphere: bool = True,
    relative_humidity: float = 0.7,
    reject_outliers: bool = True,
    false_alarm_probability: float = 1e-4,
    max_age_s: float = 0.0,
    max_iterations: int = 10,
    wavelength_m: float = L1_M,
) -> PointFixes:
    """Position and clock of each epoch from pseudoranges, velocity from Dopplers, by iterated weighted least squares.

    The model is carter eq. 2.11 and 2.12 with the broadcast orbits and clocks, the Earth's turn during the flight,
    the broadcast ionosphere (when there are coefficients) and Saastamoinen's troposphere; the solution (2.16) with
    the normal equations (HᵀWH)⁻¹HᵀW that the print has wrong. No start is needed. Satellites of other systems
    than GPS are left out.

    Parameters
    ----------
    observations : Observations
    ephemerides : Ephemerides
    sigmas_m : array_like, shape (n, s) or (s,) or (), optional
        Standard deviations of the pseudoranges; without it `sigma_m` by elevation. NaN likewise.
    elevation_mask_rad : float
        Satellites below are not used.
    sigma_m, sigma_rate_mps : float
        Standard deviation of a pseudorange and of a range rate from the zenith.
    weight_by_elevation : bool
        1 / sin(elevation) times that lower down.
    ionosphere, troposphere : bool
    relative_humidity : float
    reject_outliers : bool
        Leave out, one after the other, what contradicts the rest.
    false_alarm_probability : float
        Of the test for contradiction.
    max_age_s : float
        Of ephemerides; 0: half their fit interval.
    max_iterations : int
        Of the corrections.
    wavelength_m : float
        Turns Dopplers into range rates.

    Returns
    -------
    PointFixes
        Too few satellites, or satellites in a plane, are no error but a ``status``.

    Raises
    ------
    ValueError
        For an option out of range, shapes that do not fit and more than 64 satellites.
    """
    options = _gnss.PointOptions(
        elevation_mask_rad=elevation_mask_rad,
        sigma_m=sigma_m,
        sigma_rate_mps=sigma_rate_mps,
        weight_by_elevation=weight_by_elevation,
        ionosphere=ionosphere,
        troposphere=troposphere,
        relative_humidity=relative_humidity,
        reject_outliers=reject_outliers,
        false_alarm_probability=false_alarm_probability,
        max_age_s=max_age_s,
        max_iterations=max_iterations,
    )
    shape = observations.code_m.shape
    sigmas = np.full(shape, np.nan)
    if sigmas_m is not None:
        given = np.asarray(sigmas_m, dtype=np.float64)
        try:
            sigmas = np.ascontiguousarray(np.broadcast_to(given, shape))
        except ValueError:
            raise ValueError(f"sigmas_m: shape {shape} expected, got {given.shape}") from None
    columns = (
        observations.prn.astype(np.float64),
        observations.week.astype(np.float64),
        observations.time_of_week_s,
        observations.code_m,
        -wavelength_m * observations.doppler_hz,
        sigmas,
    )
    return _gnss_point.solve(ephemerides._table, ephemerides.klobuchar, options, columns)
