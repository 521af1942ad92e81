"""Integer ambiguities and baselines from code and carrier phase of two receivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import gnss as _gnss
from soopnav_cpp._core.gnss import BaselineStatus

if TYPE_CHECKING:
    from soopnav_cpp.gnss import Ephemerides, Observations

__all__ = [
    "BaselineRun",
    "BaselineStatus",
    "ReceiverDifferences",
    "baseline_fix",
    "lambda_ils",
    "receiver_differences",
    "solve_baseline",
    "success_rate",
]

_Array = npt.NDArray[np.float64]
_L1_M = 299_792_458.0 / 1575.42e6
_WEEK_S = 604_800.0


def lambda_ils(
    a: npt.ArrayLike, Q: npt.ArrayLike, n_candidates: int = 2
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """The integer vectors nearest to a float estimate in the metric of its covariance, by LAMBDA.

    Minimises (a - z)ᵀ Q⁻¹ (a - z) over integer z: Q is decorrelated by a unimodular transformation (LᵀDL, integer Gauss
    steps, swaps), then searched depth first within an ellipsoid that shrinks to the worst candidate kept.

    Parameters
    ----------
    a : array_like, shape (n,)
        Float ambiguities in cycles, at most 2⁵² each; n up to 48.
    Q : array_like, shape (n, n)
        Their covariance in cycles², symmetric positive definite.
    n_candidates : int
        How many, 1 … 10 000.

    Returns
    -------
    fixed : ndarray of int64, shape (n_candidates, n)
        The nearest first.
    squared_norms : ndarray, shape (n_candidates,)
        Ascending. The ratio test divides the second by the first.

    Raises
    ------
    ValueError
        For shapes that differ, numbers that are not finite or beyond 2⁵² cycles, a `Q` that is not symmetric positive
        definite, and one so uncertain that the search was given up after 20 million steps.
    """
    return _gnss.lambda_ils(a, Q, n_candidates)


def success_rate(Q: npt.ArrayLike) -> float:
    """Probability that integer bootstrapping of a float estimate with covariance `Q` [cycles²] is right.

    Π (2Φ(1/(2σ)) - 1) over the conditional deviations after decorrelation: a lower bound for `lambda_ils`.

    Raises
    ------
    ValueError
        As `lambda_ils`.
    """
    return _gnss.success_rate(Q)


@dataclass(frozen=True)
class BaselineRun:
    """Baselines from base to rover, one row for each epoch (`baseline_fix`: no such axis). NaN where there is nothing.

    Attributes
    ----------
    status : ndarray of uint8, shape (n,)
        Values of `BaselineStatus`.
    fixed : ndarray of bool, shape (n,)
        The integers passed the ratio test and leave residuals of the size stated, or are those of earlier epochs.
    baseline_enu_m : ndarray, shape (n, 3)
        East, north, up: of the best integers when fixed, of the code otherwise.
    covariance_m2 : ndarray, shape (n, 3, 3)
        As if the integers were certain when fixed; singular along the baseline when its length is given.
    heading_rad, heading_sigma_rad : ndarray, shape (n,)
        From north towards east, 0 … 2π.
    pitch_rad, pitch_sigma_rad : ndarray, shape (n,)
        Above the horizon.
    ratio : ndarray, shape (n,)
        Second-best over best objective.
    best_enu_m, float_enu_m : ndarray, shape (n, 3)
        Of the best integers whatever the ratio; of the code alone.
    success_rate : ndarray, shape (n,)
        Bound for the best integers, the length left aside.
    satellites : ndarray of int64, shape (n,)
        How many were used.
    integers : ndarray, shape (n, s)
        Of the best candidate, minus that of the highest satellite.
    residuals_m : ndarray, shape (n, s)
        Phase minus model at `best_enu_m`.
    slips : ndarray of bool, shape (n, s)
        With ``track``: satellites whose integer was lost.
    """

    status: npt.NDArray[np.uint8]
    fixed: npt.NDArray[np.bool_]
    baseline_enu_m: _Array
    covariance_m2: _Array
    heading_rad: _Array
    heading_sigma_rad: _Array
    pitch_rad: _Array
    pitch_sigma_rad: _Array
    ratio: _Array
    best_enu_m: _Array
    float_enu_m: _Array
    success_rate: _Array
    satellites: npt.NDArray[np.int64]
    integers: _Array
    residuals_m: _Array
    slips: npt.NDArray[np.bool_]

    def __repr__(self) -> str:
        if self.status.ndim == 0:
            state = BaselineStatus(int(self.status)).name.lower().replace("_", " ")
            return f"BaselineRun({state}, heading {np.rad2deg(self.heading_rad):.3f}°, ratio {self.ratio:.1f})"
        return f"BaselineRun({len(self.status)} epochs, {np.count_nonzero(self.fixed)} fixed)"


def _run(
    options: _gnss.BaselineOptions, track: bool, directions: _Array, code: _Array, phase: _Array, lost: _Array
) -> BaselineRun:
    c = _gnss.baselines(options, track, directions, code, phase, lost)
    status = c[0].astype(np.uint8)
    return BaselineRun(
        status=status,
        fixed=np.isin(status, (BaselineStatus.FIXED, BaselineStatus.TRACKED)),
        heading_rad=c[1],
        heading_sigma_rad=c[2],
        pitch_rad=c[3],
        pitch_sigma_rad=c[4],
        ratio=c[5],
        success_rate=c[6],
        satellites=c[7].astype(np.int64),
        baseline_enu_m=c[8],
        best_enu_m=c[9],
        float_enu_m=c[10],
        covariance_m2=c[11],
        integers=c[12],
        residuals_m=c[13],
        slips=c[14] != 0.0,
    )


def baseline_fix(
    directions_enu: npt.ArrayLike,
    code_m: npt.ArrayLike,
    phase_cycles: npt.ArrayLike,
    *,
    lost_lock: npt.ArrayLike | None = None,
    length_m: float | None = None,
    mask_deg: float = 15.0,
    ratio: float = 3.0,
    phase_sigma_m: float = 0.003,
    code_phase_ratio: float = 100.0,
    search: Literal["sphere", "candidates"] = "sphere",
    candidates: int = 100,
    max_pitch_deg: float = 90.0,
    max_satellites: int | None = None,
    track: bool = False,
    wavelength_m: float = _L1_M,
) -> BaselineRun:
    """The baseline between two antennas from single-epoch code and carrier phase of one signal.

    Double differences, weighted by elevation (variance of a single difference: phase_sigma² (1 + 1/sin² elevation)),
    integers by LAMBDA. With a known length the objective is the smallest that any baseline of that length reaches;
    its optimum is searched over the whole sphere, for it is often not among LAMBDA's first candidates. A fix needs the
    ratio and an objective within what right integers reach in 99.9 % of epochs (χ²); random phases of 8 satellites
    still pass in some 3 % with a length of 1 m.

    Parameters
    ----------
    directions_enu : array_like, shape (s, 3) or (n, s, 3)
        Unit vectors to the satellites, east, north, up. At most 48 satellites; NaN where one is not seen.
    code_m, phase_cycles : array_like, shape (s,) or (n, s)
        Rover minus base, left out beyond ±1e12; phases grow with range. `receiver_differences` makes them from two
        receivers' readings.
    lost_lock : array_like of bool, same shape, optional
        Either receiver flagged a cycle slip; matters with `track`.
    length_m : float, optional
        Known distance of the antennas; at most 10 m for the sphere.
    mask_deg : float
        Elevation below which a satellite is left out.
    ratio : float
        Second-best over best objective that a fix needs.
    phase_sigma_m, code_phase_ratio : float
        Deviation of one receiver's phase at the zenith, and how much worse the code is.
    search : {"sphere", "candidates"}
        With a length: all directions, or only LAMBDA's best `candidates`, weighed again.
    max_pitch_deg : float
        With the sphere: what the pitch is known not to exceed.
    max_satellites : int, optional
        Only so many, the highest ones.
    track : bool
        Carry the integers from epoch to epoch, with cycle slips found and repaired, instead of solving each anew.
    wavelength_m : float

    Returns
    -------
    BaselineRun
        With a leading axis of epochs if the input has one.

    Raises
    ------
    ValueError
        For an option out of range or shapes that differ. Too few satellites, or such that do not determine a
        position, are no error but a ``status``.
    """
    options = _gnss.BaselineOptions(
        wavelength_m=wavelength_m,
        phase_sigma_m=phase_sigma_m,
        code_phase_ratio=code_phase_ratio,
        mask_rad=float(np.deg2rad(mask_deg)),
        ratio=ratio,
        length_m=length_m,
        search=search,
        candidates=candidates,
        max_pitch_rad=float(min(np.deg2rad(max_pitch_deg), 0.5 * np.pi)),
        max_satellites=0 if max_satellites is None else max_satellites,
    )
    code = np.asarray(code_m, dtype=np.float64)
    directions, phase = np.asarray(directions_enu, np.float64), np.asarray(phase_cycles, np.float64)
    lost = np.zeros(code.shape) if lost_lock is None else np.asarray(lost_lock, np.float64)
    if code.ndim == 2:
        return _run(options, track, directions, code, phase, lost)
    if code.ndim != 1:
        raise ValueError(f"code_m: shape (s,) or (n, s) expected, got {code.shape}")
    one = _run(options, track, directions[None], code[None], phase[None], lost[None])
    return BaselineRun(**{name: getattr(one, name)[0] for name in BaselineRun.__dataclass_fields__})


@dataclass(frozen=True)
class ReceiverDifferences:
    """Rover minus base, one row for each common epoch and one column for each GPS satellite; NaN where one lacks.

    Attributes
    ----------
    elapsed_s : ndarray, shape (n,)
        Time of the epochs since the base's first.
    satellites : tuple of str, length s
    directions_enu : ndarray, shape (n, s, 3)
        Unit vectors from the base to the satellites.
    code_m, phase_cycles : ndarray, shape (n, s)
        What the satellites' motion between the two receivers' instants adds is taken off.
    lost_lock : ndarray of bool, shape (n, s)
        Bit 0 of either loss-of-lock indicator.
    """

    elapsed_s: _Array
    satellites: tuple[str, ...]
    directions_enu: _Array
    code_m: _Array
    phase_cycles: _Array
    lost_lock: npt.NDArray[np.bool_]


def receiver_differences(
    rover_obs: Observations,
    base_obs: Observations,
    ephemerides: Ephemerides,
    base_position: npt.ArrayLike,
    *,
    max_offset_s: float = 0.01,
    wavelength_m: float = _L1_M,
) -> ReceiverDifferences:
    """Single differences of two receivers' readings of the same GPS signal.

    The receivers' clocks differ, so they read a satellite at two instants; what its motion adds (up to 0.8 m for each
    millisecond) is computed from its orbit and taken off.

    Parameters
    ----------
    rover_obs, base_obs : Observations
        Of `read_observations`.
    ephemerides : Ephemerides
    base_position : array_like, shape (3,)
        ECEF, to some metres.
    max_offset_s : float
        Greatest difference of two epochs' time tags that belong together.

    Raises
    ------
    ValueError
        When the two have no epoch or no GPS satellite in common, or for a position that is none.
    """
    if not 0.0 <= max_offset_s < np.inf:
        raise ValueError(f"max_offset_s = {max_offset_s} must be a number of at least 0")
    common = sorted(set(rover_obs.satellites) & set(base_obs.satellites))
    common = [name for name in common if name.startswith("G")]
    if not common:
        raise ValueError("rover_obs, base_obs: no GPS satellite in common")
    week = int(base_obs.week[0]) if len(base_obs) else 0
    times = [(o.week - week) * _WEEK_S + o.time_of_week_s for o in (base_obs, rover_obs)]
    nearest = np.array([int(np.argmin(np.abs(times[1] - t))) for t in times[0]] if len(rover_obs) else [], dtype=int)
    close = np.abs(times[1][nearest] - times[0][: len(nearest)]) <= max_offset_s
    rows = (np.flatnonzero(close), nearest[close])
    if not len(rows[0]):
        raise ValueError(f"rover_obs, base_obs: no epoch in common (within {max_offset_s} s)")
    columns = [[o.satellites.index(name) for name in common] for o in (base_obs, rover_obs)]

    def both(field: str) -> npt.NDArray[np.float64]:
        parts = [
            getattr(o, field)[np.ix_(row, column)]
            for o, row, column in zip((base_obs, rover_obs), rows, columns, strict=True)
        ]
        return np.asarray(np.stack(parts), dtype=np.float64)

    directions, code, phase = _gnss.receiver_differences(
        ephemerides._table,
        base_position,
        wavelength_m,
        np.array([int(name[1:]) for name in common], dtype=np.float64),
        np.full(len(rows[0]), week, dtype=np.float64),
        np.stack([t[row] for t, row in zip(times, rows, strict=True)], axis=1),
        both("code_m"),
        both("phase_cycles"),
    )
    return ReceiverDifferences(
        elapsed_s=times[0][rows[0]] - times[0][0],
        satellites=tuple(common),
        directions_enu=directions,
        code_m=code,
        phase_cycles=phase,
        lost_lock=np.asarray(np.any(both("lli").astype(np.int64) & 1, axis=0)),
    )


def solve_baseline(
    rover_obs: Observations,
    base_obs: Observations,
    ephemerides: Ephemerides,
    base_position: npt.ArrayLike | None = None,
    *,
    length_m: float | None = None,
    mask_deg: float = 15.0,
    ratio: float = 3.0,
    phase_sigma_m: float = 0.003,
    code_phase_ratio: float = 100.0,
    search: Literal["sphere", "candidates"] = "sphere",
    candidates: int = 100,
    max_pitch_deg: float = 90.0,
    max_satellites: int | None = None,
    track: bool = False,
) -> BaselineRun:
    """The baseline between two receivers' antennas at each common epoch: a GNSS compass from two RINEX files.

    `receiver_differences`, then `baseline_fix`; GPS L1.

    Parameters
    ----------
    rover_obs, base_obs : Observations
    ephemerides : Ephemerides
    base_position : array_like, shape (3,), optional
        ECEF, to some metres. Without it the base file's own approximate position.
    length_m, mask_deg, ratio, phase_sigma_m, code_phase_ratio, search, candidates, max_pitch_deg, max_satellites, track
        As in `baseline_fix`.

    Returns
    -------
    BaselineRun
        A row for each epoch that both have, a column for each satellite that both have.

    Raises
    ------
    ValueError
        As `baseline_fix` and `receiver_differences`; without a position of the base.
    """
    place = base_obs.approximate_position_ecef_m if base_position is None else np.asarray(base_position, np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError("base_position: three finite ECEF coordinates expected (the base file states none)")
    d = receiver_differences(rover_obs, base_obs, ephemerides, place)
    return baseline_fix(
        d.directions_enu,
        d.code_m,
        d.phase_cycles,
        lost_lock=d.lost_lock,
        length_m=length_m,
        mask_deg=mask_deg,
        ratio=ratio,
        phase_sigma_m=phase_sigma_m,
        code_phase_ratio=code_phase_ratio,
        search=search,
        candidates=candidates,
        max_pitch_deg=max_pitch_deg,
        max_satellites=max_satellites,
        track=track,
    )
