"""How long a phase stays coherent, and what that is worth to a receiver (pesyna eqs. 13 to 16)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import clock as _clock

__all__ = [
    "Coherence",
    "CoherenceTime",
    "coherence",
    "coherence_time",
    "expected_coherence",
    "mean_squared_coherence",
    "predetection_snr_db",
    "required_cn0_dbhz",
]

_Array = npt.NDArray[np.float64]


def _samples(tau_s: float, dt_s: float, name: str) -> int:
    if not (dt_s > 0.0 and math.isfinite(dt_s)):
        raise ValueError(f"dt_s = {dt_s} must be positive and finite")
    factor = tau_s / dt_s
    if not (math.isfinite(factor) and round(factor) >= 1 and abs(factor - round(factor)) <= 1e-6 * factor):
        raise ValueError(f"{name} = {tau_s}: a positive multiple of dt_s = {dt_s} expected")
    return round(factor)


class CoherenceTime(NamedTuple):
    """When a mean-squared coherence falls below a level.

    Attributes
    ----------
    tau_s : float
        The time; the longest one looked at when it does not fall.
    beyond : bool
        It does not: the coherence time lies beyond the record.
    """

    tau_s: float
    beyond: bool


@dataclass(frozen=True)
class Coherence:
    """Mean-squared coherence ⟨C²(τ)⟩, one number for each integration time; arrays of shape (n,), read-only.

    Attributes
    ----------
    tau_s, mean_squared : ndarray
        Over overlapping windows of every record.
    lower, upper : ndarray
        Band of the expectation: the smaller of C² and 1 - C² taken for chi-square of `effective` degrees of freedom,
        from the scatter of the records' means (eight records or more) or the scatter within each. A frequency that
        wanders more slowly than one record lasts escapes that record's band.
    least : ndarray
        C² of the worst window.
    effective : ndarray
        Degrees of freedom; never more than windows that do not overlap.
    count : ndarray of int64
        Windows averaged.
    """

    tau_s: _Array
    mean_squared: _Array
    lower: _Array
    upper: _Array
    least: _Array
    effective: _Array
    count: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.tau_s)

    def at(self, tau_s: float) -> float:
        """⟨C²⟩ at one of `tau_s`; ValueError for another."""
        near = np.flatnonzero(np.isclose(self.tau_s, tau_s, rtol=1e-6))
        if not len(near):
            raise ValueError(f"tau_s = {tau_s} is none of the times")
        return float(self.mean_squared[near[0]])

    def time(self, level: float = 0.5) -> CoherenceTime:
        """The first time below `level`, as `coherence_time`."""
        return coherence_time(self.tau_s, self.mean_squared, level)

    def __repr__(self) -> str:
        if not len(self):
            return "Coherence(none)"
        return f"Coherence({len(self)} times to {self.tau_s[-1]:g} s, {self.mean_squared[-1]:.3g} there)"


def coherence(phase_cycles: npt.ArrayLike, dt_s: float, tau_s: float, *, detrend: bool = True) -> _Array:
    """Coherence |mean of exp(j 2π φ)| of every window of a record (pesyna eq. 15).

    Parameters
    ----------
    phase_cycles : array_like, shape (n,)
        Phase [cycles] every `dt_s`, such as f_c times a clock's error in seconds (pesyna eq. 14). NaN is a gap.
    dt_s, tau_s : float
        The window is a multiple of `dt_s`.
    detrend : bool
        Take a straight line out of the whole record first, once.

    Returns
    -------
    ndarray, shape (n - tau_s / dt_s + 1,)
        C, 0 … 1, by the window's first phase; NaN where it holds a gap; empty for a record shorter than `tau_s`.

    Raises
    ------
    ValueError
        For infinite phases or a `tau_s` that is no multiple.
    """
    phase = np.asarray(phase_cycles, np.float64)
    return _clock.coherences(_clock.remove_trend(phase) if detrend else phase, _samples(tau_s, dt_s, "tau_s"))


def mean_squared_coherence(
    phase_cycles: npt.ArrayLike,
    dt_s: float,
    tau_s: npt.ArrayLike | None = None,
    *,
    detrend: bool = True,
    confidence: float = 0.95,
) -> Coherence:
    """Mean-squared coherence ⟨C²(τ)⟩ of one record or an ensemble, over overlapping windows (pesyna fig. 11).

    Parameters
    ----------
    phase_cycles : array_like, shape (n,) or (runs, n)
        Phase [cycles] every `dt_s`; NaN is a gap, and windows that hold one are left out.
    dt_s : float
    tau_s : float or array_like, optional
        Multiples of `dt_s`; some ten a decade by default. Those longer than the record are left out.
    detrend : bool
        Take a straight line out of each record, once; never out of a window.
    confidence : float
        Of the band.

    Returns
    -------
    Coherence

    Raises
    ------
    ValueError
        For infinite phases, no run, times that are no multiples, or a confidence outside (0, 1).
    """
    phase = np.asarray(phase_cycles, np.float64)
    if phase.ndim not in (1, 2):
        raise ValueError(f"phase_cycles: shape (n,) or (runs, n) expected, got {phase.shape}")
    runs, length = (1, len(phase)) if phase.ndim == 1 else phase.shape
    if not runs:
        raise ValueError(f"phase_cycles: at least one run expected, got shape {phase.shape}")
    if tau_s is None:
        samples = _clock.coherence_samples(length, 10)
    else:
        samples = [_samples(float(tau), dt_s, "tau_s") for tau in np.atleast_1d(np.asarray(tau_s, np.float64))]
    columns = _clock.mean_squared_coherence(phase.ravel(), runs, dt_s, samples, confidence=confidence, detrend=detrend)
    for column in columns:
        column.flags.writeable = False
    return Coherence(*columns)


def coherence_time(tau_s: npt.ArrayLike, mean_squared: npt.ArrayLike, level: float = 0.5) -> CoherenceTime:
    """The first time at which ⟨C²(τ)⟩ is below `level`, between two by a straight line (pesyna section V-D: 0.5).

    Parameters
    ----------
    tau_s, mean_squared : array_like, shape (n,)
        Times rise.
    level : float
        Between 0 and 1.

    Returns
    -------
    CoherenceTime
    """
    tau, beyond = _clock.coherence_time(np.asarray(tau_s, np.float64), np.asarray(mean_squared, np.float64), level)
    return CoherenceTime(tau, beyond)


def expected_coherence(
    h0: float, h_minus_2: float, tau_s: npt.ArrayLike, *, carrier_hz: float, drift_sigma: float = 0.0
) -> _Array:
    """⟨C²(τ)⟩ expected of a two-state clock whose drift is known at the start of each window; nothing else removed.

    White frequency noise alone has a closed form, 2 (aτ - 1 + exp(-aτ)) / (aτ)² with a = π² f² h0.

    Parameters
    ----------
    h0, h_minus_2 : float
        Of the clock [s], [Hz].
    tau_s : float or array_like
        Positive.
    carrier_hz : float
    drift_sigma : float
        How well the drift is known, dimensionless; 0: exactly.

    Returns
    -------
    ndarray, of tau_s's shape
    """
    tau = np.asarray(tau_s, np.float64)
    return np.reshape(_clock.expected_coherence(h0, h_minus_2, carrier_hz, tau.ravel(), drift_sigma), tau.shape)


def predetection_snr_db(cn0_dbhz: float, tau_s: float, mean_squared: float = 1.0) -> float:
    """SNR after coherent integration, ⟨C²⟩ τ C/N0 in decibels (pesyna eq. 16).

    Parameters
    ----------
    cn0_dbhz, tau_s : float
    mean_squared : float
        ⟨C²(τ)⟩, in (0, 1].
    """
    return _clock.predetection_snr_db(cn0_dbhz, tau_s, mean_squared)


def required_cn0_dbhz(tau_s: float, mean_squared: float = 1.0, snr_db: float = 11.0) -> float:
    """The C/N0 that gives an SNR after coherent integration (pesyna eq. 16: 100 s, 0.8 and 11 dB need -8 dB-Hz).

    Parameters
    ----------
    tau_s : float
    mean_squared : float
        ⟨C²(τ)⟩, in (0, 1].
    snr_db : float
        Wanted. 11 dB is enough for a few cells only: `dsp.detection_probability` tells.
    """
    return _clock.required_cn0_dbhz(tau_s, mean_squared, snr_db)
