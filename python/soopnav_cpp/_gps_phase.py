"""A standing antenna by code and carrier phase, and the observables a navigator takes: the face of the engine's."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry
from soopnav_cpp._core import gnss as _gnss
from soopnav_cpp._core.gnss import PhaseUse, StaticPhaseStatus
from soopnav_cpp._gnss_data import Ephemerides, Observations

__all__ = ["L2_HZ", "PhaseUse", "StaticPhaseFix", "StaticPhaseStatus", "ionosphere_free", "static_phase"]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_L1_HZ = 1575.42e6

L2_HZ = 1227.6e6
"""Carrier of L2 [Hz]."""


def ionosphere_free(
    first_m: npt.ArrayLike, second_m: npt.ArrayLike, *, f1_hz: float = _L1_HZ, f2_hz: float = L2_HZ
) -> _Array:
    """(f1² first − f2² second) / (f1² − f2²): free of the ionosphere to first order, with 3.0 times the noise.

    Parameters
    ----------
    first_m, second_m : array_like
        Ranges, or phases in metres.
    """
    if not (f1_hz > 0.0 and f2_hz > 0.0 and f1_hz != f2_hz):
        raise ValueError(f"f1_hz = {f1_hz}, f2_hz = {f2_hz}: two different positive numbers expected")
    a, b = f1_hz**2, f2_hz**2
    out: _Array = (a * np.asarray(first_m, np.float64) - b * np.asarray(second_m, np.float64)) / (a - b)
    return out


@dataclass(frozen=True)
class StaticPhaseFix:
    """A position from code and carrier phase, its covariance, and what a navigator needs of each measurement.

    Rows are epochs, columns satellites; NaN where there is nothing.

    Attributes
    ----------
    status : StaticPhaseStatus
    position_m : ndarray, shape (3,)
        ECEF.
    covariance_m2 : ndarray, shape (3, 3)
        With the errors of the broadcast, which do not average out.
    formal_m2 : ndarray, shape (3, 3)
        As if the broadcast were exact: centimetres, and wrong.
    zenith_m, zenith_sigma_m : float
        Delay of the troposphere beyond Saastamoinen's.
    phase_rms_m, code_rms_m : float
        Of the residuals.
    phases, codes, rejected, arcs, slips : int
        Measurements used, thrown out; stretches of unbroken phase and breaks between them.
    clock_m, clock_sigma_m : ndarray, shape (n,)
        c · (receiver clock − GPS time), of each epoch by itself.
    range_error_m, range_error_sigma_m, range_error_rate_mps : ndarray, shape (s,)
        What each satellite's broadcast is off by, in the middle of the recording.
    phase_residual_m, code_residual_m : ndarray, shape (n, s)
        Measured minus fitted.
    elevation_rad, azimuth_rad : ndarray, shape (n, s)
    use : ndarray of uint8, shape (n, s)
        Values of `PhaseUse`.
    arc : ndarray of int32, shape (n, s)
        Number of the unbroken stretch; -1 without.
    phase_m, code_m : ndarray, shape (n, s)
        What was used: ionosphere-free, or of L1.
    phase_correction_m, code_correction_m : ndarray, shape (n, s)
        Troposphere, wind-up and (L1) ionosphere, to be added to the model.
    satellite_clock_m : ndarray, shape (n, s)
        c · satellite clock of the same combination.
    satellite_e_m : ndarray, shape (n, s, 3)
        At transmission, in the ECEF axes of the reception.
    satellites : tuple of str
    t_s : ndarray, shape (n,)
        Seconds since the first epoch, by the receiver's clock.
    """

    status: StaticPhaseStatus
    position_m: _Array
    covariance_m2: _Array
    formal_m2: _Array
    zenith_m: float
    zenith_sigma_m: float
    phase_rms_m: float
    code_rms_m: float
    phases: int
    codes: int
    rejected: int
    arcs: int
    slips: int
    clock_m: _Array
    clock_sigma_m: _Array
    range_error_m: _Array
    range_error_sigma_m: _Array
    range_error_rate_mps: _Array
    phase_residual_m: _Array
    code_residual_m: _Array
    elevation_rad: _Array
    azimuth_rad: _Array
    use: npt.NDArray[np.uint8]
    arc: npt.NDArray[np.int32]
    phase_m: _Array
    code_m: _Array
    phase_correction_m: _Array
    code_correction_m: _Array
    satellite_clock_m: _Array
    satellite_e_m: _Array
    satellites: tuple[str, ...] = field(default=())
    t_s: _Array = field(default_factory=lambda: np.empty(0))

    @property
    def ok(self) -> bool:
        """Whether there is a position."""
        return bool(self.status == StaticPhaseStatus.SOLVED)

    @property
    def sigma_m(self) -> float:
        """Root of the covariance's trace."""
        return float(np.sqrt(np.trace(self.covariance_m2)))

    @property
    def covariance_enu_m2(self) -> _Array:
        """Covariance by east, north and up, shape (3, 3)."""
        latitude, longitude, height = geometry.ecef_to_geodetic(self.position_m)
        frame = geometry.LocalFrame(float(latitude), float(longitude), float(height))
        axes = frame.position_to_ecef(np.eye(3)) - frame.position_to_ecef(np.zeros(3))
        out: _Array = axes @ self.covariance_m2 @ axes.T
        return out

    def satellite_phase_rms_m(self) -> _Array:
        """Root mean square of each satellite's phase residuals, shape (s,); NaN without."""
        squares = np.where(np.isfinite(self.phase_residual_m), self.phase_residual_m, 0.0) ** 2
        counts = np.isfinite(self.phase_residual_m).sum(axis=0)
        out: _Array = np.sqrt(squares.sum(axis=0) / np.where(counts > 0, counts, np.nan))
        return out

    def message(self) -> str:
        """One sentence: what it is, or why there is none."""
        if self.ok:
            return (
                f"position within {self.sigma_m:.2f} m (1 sigma, 3-D) from {self.phases} phases in {self.arcs} arcs; "
                f"phase residuals {100.0 * self.phase_rms_m:.1f} cm rms"
            )
        reasons = {
            StaticPhaseStatus.TOO_FEW_SATELLITES: "no epoch has four satellites with code and phase above the mask",
            StaticPhaseStatus.TOO_SHORT: "no satellite's phase holds long enough without a break",
            StaticPhaseStatus.RANK_DEFICIENT: "the satellites leave a direction open",
            StaticPhaseStatus.TOO_MANY_ARCS: "the phases break all the time",
        }
        return f"no position: {reasons[self.status]}"

    def __repr__(self) -> str:
        return f"StaticPhaseFix({self.message()})"


def static_phase(
    first: Observations,
    ephemerides: Ephemerides,
    second: Observations | None = None,
    *,
    elevation_mask_rad: float = np.deg2rad(15.0),
    code_sigma_m: float = 1.0,
    phase_sigma_m: float = 0.01,
    phase_correlation_s: float = 100.0,
    range_error_sigma_m: float | None = None,
    range_error_rate_mps: float | None = None,
    zenith_sigma_m: float = 0.1,
    relative_humidity: float = 0.7,
    max_gap_s: float = 5.0,
    slip_m: float = 0.08,
    min_arc_epochs: int = 30,
    wind_up: bool = True,
    max_age_s: float = 0.0,
) -> StaticPhaseFix:
    """Where a standing antenna is, by GPS code and carrier phase of all epochs together (pesyna eq. 4).

    Orbits and clocks of the broadcast with relativity and the Earth's turn, Saastamoinen's troposphere with an
    estimated zenith residual, phase wind-up, a clock for each epoch, a constant for each unbroken stretch of phase, and
    an error of each satellite's broadcast that hardly changes while the recording lasts: the covariance is honest for
    it. See ``cpp/doc/gps_phase.md``.

    Parameters
    ----------
    first : Observations
        L1 C/A.
    ephemerides : Ephemerides
    second : Observations, optional
        The second frequency, L2, of the same file (``codes={"G": "2W"}``): the ionosphere drops out. Without it the
        broadcast ionosphere is taken off.
    elevation_mask_rad : float
    code_sigma_m, phase_sigma_m : float
        White noise of the combination used, from the zenith; over sin(elevation) lower down.
    phase_correlation_s : float
        How long phase errors last (multipath, weather); without it curvatures of a centimetre move the position by
        metres.
    range_error_sigma_m, range_error_rate_mps : float, optional
        Of each satellite's error and its rate: 1 m and 1.5e-4 m/s with two frequencies; 3 m and 1e-3 m/s with one, for
        the ionosphere.
    zenith_sigma_m : float
        Of the zenith delay; 0: not estimated.
    relative_humidity : float
    max_gap_s, slip_m : float
        Longest gap, largest change against the other satellites' of an unbroken phase.
    min_arc_epochs : int
        Shorter stretches are not used.
    wind_up : bool
    max_age_s : float
        Of ephemerides; 0: half their fit interval.

    Returns
    -------
    StaticPhaseFix
        What data cannot give is a ``status``.

    Raises
    ------
    ValueError
        For an option out of range, no GPS satellite, or a second frequency of other epochs.
    """
    dual = second is not None
    columns = [i for i, name in enumerate(first.satellites) if name.startswith("G")]
    names = tuple(first.satellites[i] for i in columns)
    shape = (len(first), len(names))
    other_code, other_phase = np.full(shape, np.nan), np.full(shape, np.nan)
    lost = np.asarray(first.lli[:, columns] & 1, dtype=np.float64)
    if second is not None:
        rows = {(int(w), round(t * 1e6)): i for i, (w, t) in
                enumerate(zip(second.week, second.time_of_week_s, strict=True))}  # fmt: skip
        at = [rows.get((int(w), round(t * 1e6)), -1) for w, t in zip(first.week, first.time_of_week_s, strict=True)]
        both = np.flatnonzero(np.array(at, dtype=np.int64) >= 0)
        if len(first) and not len(both):
            raise ValueError("second: no epoch in common with the first frequency")
        where = np.array(at, dtype=np.int64)[both]
        for j, name in enumerate(names):
            if name in second.satellites:
                column = second.satellites.index(name)
                other_code[both, j] = second.code_m[where, column]
                other_phase[both, j] = second.phase_cycles[where, column]
                lost[both, j] = np.maximum(lost[both, j], second.lli[where, column] & 1)
    if range_error_sigma_m is None:
        range_error_sigma_m = 1.0 if dual else 3.0
    if range_error_rate_mps is None:
        range_error_rate_mps = 1.5e-4 if dual else 1e-3
    options = _gnss.StaticPhaseOptions(
        dual=dual,
        elevation_mask_rad=elevation_mask_rad,
        code_sigma_m=code_sigma_m,
        phase_sigma_m=phase_sigma_m,
        phase_correlation_s=phase_correlation_s,
        range_error_sigma_m=range_error_sigma_m,
        range_error_rate_mps=range_error_rate_mps,
        zenith_sigma_m=zenith_sigma_m,
        relative_humidity=relative_humidity,
        max_gap_s=max_gap_s,
        slip_m=slip_m,
        min_arc_epochs=min_arc_epochs,
        wind_up=wind_up,
        max_age_s=max_age_s,
    )
    found = _gnss.static_phase(
        ephemerides._table,
        ephemerides.klobuchar,
        options,
        first.prn[columns].astype(np.float64),
        first.week.astype(np.float64),
        first.time_of_week_s,
        np.ascontiguousarray(first.code_m[:, columns]),
        other_code,
        np.ascontiguousarray(first.phase_cycles[:, columns]),
        other_phase,
        lost,
    )
    return StaticPhaseFix(**found, satellites=names, t_s=first.elapsed_s)
