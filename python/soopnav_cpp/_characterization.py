"""Noise of clocks from phase records: innovation likelihood, multiple models, and the iteration that collapses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import clock as _clock

if TYPE_CHECKING:
    from soopnav_cpp.clock import TwoState

__all__ = [
    "Characterization",
    "ClockEstimates",
    "PhaseScore",
    "characterize",
    "error_allan_variance",
    "estimate_clocks",
    "iterate_noise",
    "noise_likelihood",
]

_Array = npt.NDArray[np.float64]
Clocks = Sequence["TwoState | Sequence[float]"]


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


def _pair(clock: TwoState | Sequence[float]) -> tuple[float, float]:
    from soopnav_cpp.clock import TwoState  # clock has this module's names

    h0, h_minus_2 = (clock.h0, clock.h_minus_2) if isinstance(clock, TwoState) else clock
    return float(h0), float(h_minus_2)


def _oscillator(pair: npt.ArrayLike) -> TwoState:
    from soopnav_cpp.clock import TwoState  # clock has this module's names

    h0, h_minus_2 = np.asarray(pair, np.float64)
    return TwoState(float(h0), float(h_minus_2))


def _real(name: str, values: npt.ArrayLike) -> _Array:
    if np.iscomplexobj(values):  # asarray would drop the imaginary part
        raise ValueError(f"{name}: real numbers expected, got complex ones")
    return np.asarray(values, np.float64)


def _mixing(mixing: npt.ArrayLike | None, channels: int) -> _Array:
    return np.eye(channels) if mixing is None else np.atleast_2d(_real("mixing", mixing))


def _covariance(phase_sigma_s: npt.ArrayLike, channels: int) -> _Array:
    sigma = _real("phase_sigma_s", phase_sigma_s)
    if sigma.ndim == 2:  # square of a full root would hide what was meant: a matrix is the covariance itself
        return sigma
    if not np.all((sigma >= 1e-40) & (sigma <= 1e20)):
        raise ValueError(
            f"phase_sigma_s = {phase_sigma_s!r}: positive and finite, 1e-40 ... 1e20 s, expected; "
            "white noise of a phase is known from C/N0 and is never zero"
        )
    return np.diag(np.broadcast_to(sigma, channels) ** 2)


def _records(phase_s: npt.ArrayLike, mixing: npt.ArrayLike | None) -> tuple[_Array, _Array]:
    phase = _real("phase_s", phase_s)
    if phase.ndim == 1:
        phase = phase[:, None]
    if phase.ndim != 2:
        raise ValueError(f"phase_s: (epochs,) or (epochs, records) expected, got {np.shape(phase_s)}")
    mixed = _mixing(mixing, phase.shape[1])
    if mixed.ndim != 2 or len(mixed) != phase.shape[1]:
        raise ValueError(f"mixing: ({phase.shape[1]}, clocks) expected, got {mixed.shape}")
    return np.ascontiguousarray(phase), mixed


@dataclass(frozen=True)
class PhaseScore:
    """Log-likelihood of clocks' noise in phase records and its derivatives by theta.

    theta is (ln h0, ln h-2) of each estimated clock in turn. Arrays are read-only.

    Attributes
    ----------
    log_likelihood : float
        Of the innovations, phases in seconds.
    score : ndarray, shape (p,)
        Its gradient, exact.
    information : ndarray, shape (p, p)
        Fisher's: the expectation under these clocks, whose inverse bounds the covariance of ln h (CRLB).
    mean_nis : float
        Of the innovations for each record; 1 when clocks and phase noise are right.
    """

    log_likelihood: float
    score: _Array
    information: _Array
    mean_nis: float


@dataclass(frozen=True, repr=False)
class Characterization:
    """Noise of clocks by maximum likelihood, how well it is known, and what the record does not tell.

    theta is (ln h0, ln h-2) of each estimated clock in turn, p = 2 per clock. Arrays are read-only.

    Attributes
    ----------
    clocks : tuple of TwoState
        All of the model; known ones as they were given.
    estimated : tuple of int
        Which were estimated.
    ln_covariance : ndarray, shape (p, p)
        Of theta: inverse of the Fisher information, held by a prior of a factor 1000 at one sigma.
    information : ndarray, shape (p, p)
        Fisher's at the estimate.
    identifiable : ndarray of bool, shape (p,)
        Known within a factor of two at one sigma, and alike in all `alternatives`.
    directions : ndarray, shape (p, p)
        Rows: combinations of theta, the least known first; `direction_sigma` is the standard deviation along each.
    direction_sigma : ndarray, shape (p,)
    alternatives : tuple of (tuple of TwoState, float)
        Other maxima whose log-likelihood (second) is within 3 of the greatest.
    log_likelihood : float
    mean_nis : float
        Of the innovations for each record.
    jump_at : int or None
        Epoch of an innovation that a right model has in one record of a million: a clock jumped or a cycle slipped,
        and the noise is that of the jump.
    converged : bool
    iterations : int
    epochs, skipped : int
        Of the record; those with a NaN.
    dt_s : float
    """

    clocks: tuple[TwoState, ...]
    estimated: tuple[int, ...]
    ln_covariance: _Array
    information: _Array
    identifiable: npt.NDArray[np.bool_]
    directions: _Array
    direction_sigma: _Array
    alternatives: tuple[tuple[tuple[TwoState, ...], float], ...]
    log_likelihood: float
    mean_nis: float
    jump_at: int | None
    converged: bool
    iterations: int
    epochs: int
    skipped: int
    dt_s: float

    @property
    def h0(self) -> _Array:
        """White frequency noise of the estimated clocks [s], shape (e,)."""
        return np.array([self.clocks[c].h0 for c in self.estimated])

    @property
    def h_minus_2(self) -> _Array:
        """Random walk of frequency of the estimated clocks [1/s], shape (e,)."""
        return np.array([self.clocks[c].h_minus_2 for c in self.estimated])

    @property
    def duration_s(self) -> float:
        """Of the record."""
        return (self.epochs - 1) * self.dt_s

    def covariance_of(self, which: int = 0) -> _Array:
        """Covariance of (ln h0, ln h-2) of one estimated clock, shape (2, 2)."""
        here = slice(2 * which, 2 * which + 2)
        return np.array(self.ln_covariance[here, here], np.float64)

    def allan_deviation(self, tau_s: npt.ArrayLike, which: int = 0) -> tuple[_Array, _Array]:
        """Allan deviation of one estimated clock and the factor it is known to at one sigma.

        Parameters
        ----------
        tau_s : float or array_like
            Positive.
        which : int
            Number among the estimated clocks.

        Returns
        -------
        deviation, factor : ndarray, of tau_s's shape
            The true one lies between deviation / factor and deviation * factor in about 68 % of records.
        """
        tau = np.asarray(tau_s, np.float64)
        clock = self.clocks[self.estimated[which]]
        white = clock.h0 / (2.0 * tau)
        walk = 2.0 * math.pi**2 / 3.0 * clock.h_minus_2 * tau
        share = np.stack([white, walk], axis=-1) / (white + walk)[..., None]
        variance = np.einsum("...i,ij,...j->...", share, self.covariance_of(which), share)
        return np.sqrt(white + walk), np.exp(0.5 * np.sqrt(variance))

    def noise_record(self, which: int = 0) -> dict[str, Any]:
        """The noise of one estimated clock as the signal database takes it: h0_s, h_minus2_per_s, ln_covariance."""
        clock = self.clocks[self.estimated[which]]
        return {
            "h0_s": clock.h0,
            "h_minus2_per_s": clock.h_minus_2,
            "ln_covariance": self.covariance_of(which).tolist(),
        }

    def quality_record(self, cn0_dbhz: float | None = None) -> dict[str, Any]:
        """The quality of this characterisation as the signal database takes it: duration_s, cn0_dbhz, nis."""
        return {"duration_s": self.duration_s, "cn0_dbhz": cn0_dbhz, "nis": self.mean_nis}

    @property
    def only_sum_known(self) -> bool:
        """Several clocks share noise that is known in sum (of h0, within a factor of two) and not one by one."""
        if len(self.estimated) < 2 or self.identifiable[0::2].any():
            return False
        share = np.zeros(len(self.ln_covariance))
        share[0::2] = self.h0 / self.h0.sum()
        sums = [sum(clocks[c].h0 for c in self.estimated) for clocks, _ in self.alternatives]
        alike = all(abs(math.log(other / self.h0.sum())) < 2.0 * math.log(2.0) for other in sums)
        return bool(math.sqrt(share @ self.ln_covariance @ share) <= math.log(2.0)) and alike

    @property
    def report(self) -> tuple[str, ...]:
        """What to know before this is used, one sentence each; empty when all is well."""
        said = []
        if self.jump_at is not None:
            said.append(
                f"the innovation at {self.jump_at * self.dt_s:g} s (epoch {self.jump_at}) is none of this noise: a "
                "clock jumped or a cycle slipped; cut the record there"
            )
        if not self.converged:
            said.append(f"the search did not converge in {self.iterations} iterations")
        if self.only_sum_known:
            names = " and ".join(str(c) for c in self.estimated)
            said.append(f"only the sum of the noise of clocks {names} is identifiable")
        for i, known in enumerate(self.identifiable):
            if known:
                continue
            name = f"{'h0' if i % 2 == 0 else 'h-2'} of clock {self.estimated[i // 2]}"
            factor = math.exp(min(math.sqrt(self.ln_covariance[i, i]), 50.0))
            how = f"its one-sigma factor is {factor:.3g}"
            if factor <= 2.0:
                how = "other noise fits the record as well"
            said.append(f"{name} is not identifiable in {self.duration_s:g} s: {how}")
        return tuple(said)

    def __repr__(self) -> str:
        parts = []
        for i, c in enumerate(self.estimated):
            sigma = np.sqrt(np.diag(self.covariance_of(i)))
            clock = self.clocks[c]
            parts.append(
                f"clock {c}: h0 = {clock.h0:.3g} s (x/÷ {math.exp(min(sigma[0], 50.0)):.2g}), "
                f"h-2 = {clock.h_minus_2:.3g} 1/s (x/÷ {math.exp(min(sigma[1], 50.0)):.2g})"
            )
        return f"Characterization({'; '.join(parts)}{'; see report' if self.report else ''})"


def _known(
    known: Sequence[TwoState | Sequence[float] | None] | None, clocks: int
) -> tuple[list[TwoState | Sequence[float] | None], list[int]]:
    given: list[TwoState | Sequence[float] | None] = [None] * clocks if known is None else list(known)
    if len(given) != clocks:
        raise ValueError(f"known: one for each of {clocks} clocks expected, None where estimated, got {len(given)}")
    return given, [c for c, clock in enumerate(given) if clock is None]


def characterize(
    phase_s: npt.ArrayLike,
    dt_s: float,
    phase_sigma_s: npt.ArrayLike,
    *,
    mixing: npt.ArrayLike | None = None,
    known: Sequence[TwoState | Sequence[float] | None] | None = None,
    start: Clocks | None = None,
) -> Characterization:
    """Noise of clocks by maximum likelihood of the innovations of phase records (cpp/doc/characterization.md).

    The usual use, a basestation's clock while satellites tell the receiver's: ``characterize(receiver_s - phase_s,
    dt_s, sigma_s)`` with both in seconds and the sigma of their difference.

    Parameters
    ----------
    phase_s : array_like, shape (n,) or (n, m)
        Up to three records of phase [s], a carrier phase in cycles over its frequency, every `dt_s`. An epoch with a
        NaN is skipped. Constants and steady drifts do not matter.
    dt_s : float
        Positive.
    phase_sigma_s : float or array_like, shape (m,) or (m, m)
        Standard deviations of the phases' white noise, known from C/N0, or its covariance [s²] where records
        share noise.
    mixing : array_like, shape (m, k), optional
        What each record sees of each of up to four clocks; the unit matrix by default. A source's phase is the
        receiver's clock less the source's: ``[[1, -1]]``.
    known : sequence of TwoState or None, length k, optional
        None for those to estimate, which all are by default.
    start : sequence of TwoState or (h0, h-2), length k, optional
        One start of the search, of which known clocks are passed over. By default several, so that other maxima are
        found when there are any.

    Returns
    -------
    Characterization

    Raises
    ------
    ValueError
        For a sigma outside 1e-40 ... 1e20 s, a step outside 1e-12 ... 1e12 s, phases that are complex, infinite or 1e60
        sigmas, fewer than 8 whole epochs, or shapes that do not fit.
    """
    phase, mixed = _records(phase_s, mixing)
    given, estimated = _known(known, mixed.shape[1])
    if start is not None and len(start) != len(given):
        raise ValueError(f"start: one for each of {len(given)} clocks expected, got {len(start)}")
    first = [(0.0, 0.0) if start is None else _pair(start[c]) for c in range(len(given))]
    table = [_pair(clock) if clock is not None else first[c] for c, clock in enumerate(given)]
    found = _clock.characterize(
        phase, dt_s, _covariance(phase_sigma_s, phase.shape[1]), mixed, table, estimated, start is None
    )

    def clocks_of(pairs: _Array) -> tuple[TwoState, ...]:
        return tuple(_oscillator(pair) for pair in pairs)

    return Characterization(
        clocks=clocks_of(found["clocks"]),
        estimated=tuple(estimated),
        ln_covariance=_read_only(found["ln_covariance"]),
        information=_read_only(found["information"]),
        identifiable=_read_only(np.array(found["identifiable"], np.bool_)),
        directions=_read_only(found["directions"]),
        direction_sigma=_read_only(found["direction_sigma"]),
        alternatives=tuple((clocks_of(pairs), value) for pairs, value in found["alternatives"]),
        log_likelihood=found["log_likelihood"],
        mean_nis=found["mean_nis"],
        jump_at=found["largest_at"] if found["jumped"] else None,
        converged=found["converged"],
        iterations=found["iterations"],
        epochs=len(phase),
        skipped=found["skipped"],
        dt_s=dt_s,
    )


def noise_likelihood(
    phase_s: npt.ArrayLike,
    dt_s: float,
    phase_sigma_s: npt.ArrayLike,
    clocks: Clocks,
    *,
    mixing: npt.ArrayLike | None = None,
    estimated: Sequence[int] | None = None,
) -> PhaseScore:
    """Log-likelihood of clocks in phase records, its gradient and Fisher's information.

    Parameters
    ----------
    phase_s, dt_s, phase_sigma_s, mixing
        As `characterize`.
    clocks : sequence of TwoState or (h0, h-2), length k
    estimated : sequence of int, optional
        By which clocks' ln h0 and ln h-2 to differentiate; all by default.
    """
    phase, mixed = _records(phase_s, mixing)
    which = list(range(len(clocks))) if estimated is None else list(estimated)
    value, score, information, nis, _, _ = _clock.phase_likelihood(
        phase, dt_s, _covariance(phase_sigma_s, phase.shape[1]), mixed, [_pair(c) for c in clocks], which
    )
    return PhaseScore(value, _read_only(score), _read_only(information), nis)


@dataclass(frozen=True)
class ClockEstimates:
    """Clocks along a record, each array of shape (n, k), read-only. NaN before the first whole epoch.

    Attributes
    ----------
    filtered_s, filtered_sigma_s : ndarray
        Time error from the phases so far, and its standard deviation.
    bias_s, sigma_s : ndarray
        Smoothed: from all phases.
    drift : ndarray
        Smoothed fractional frequency offset.
    """

    filtered_s: _Array
    filtered_sigma_s: _Array
    bias_s: _Array
    drift: _Array
    sigma_s: _Array

    def __len__(self) -> int:
        return len(self.bias_s)

    def __repr__(self) -> str:
        return f"ClockEstimates({len(self)} epochs of {self.bias_s.shape[1]} clocks)"


def estimate_clocks(
    phase_s: npt.ArrayLike,
    dt_s: float,
    phase_sigma_s: npt.ArrayLike,
    clocks: Clocks,
    *,
    mixing: npt.ArrayLike | None = None,
) -> ClockEstimates:
    """Clocks of known noise from phase records: Kalman filter and fixed-interval smoother.

    With the receiver's clock and sources' this is pesyna's estimator for a receiver that stands at a known place. With
    fewer records than clocks, common biases and drifts are unobservable: the first k - m clocks then start at zero bias
    and drift by definition, and estimates are right up to a straight line.

    Parameters
    ----------
    phase_s, dt_s, phase_sigma_s, mixing
        As `characterize`; no more records than clocks.
    clocks : sequence of TwoState or (h0, h-2), length k

    Raises
    ------
    ValueError
        As `characterize`, and where the records cannot tell the last m clocks apart.
    """
    phase, mixed = _records(phase_s, mixing)
    columns = _clock.estimate_clocks(
        phase, dt_s, _covariance(phase_sigma_s, phase.shape[1]), mixed, [_pair(c) for c in clocks]
    )
    return ClockEstimates(*(_read_only(column) for column in columns))


def error_allan_variance(
    epochs: int,
    dt_s: float,
    phase_sigma_s: npt.ArrayLike,
    clocks: Clocks,
    factors: Sequence[int],
    *,
    mixing: npt.ArrayLike | None = None,
    clock: int = 0,
) -> _Array:
    """Allan variance of the error of a smoothed clock, from the smoother's covariance with its lags.

    What a smoothed clock's own Allan variance lacks: both together are the model's in expectation.

    Parameters
    ----------
    epochs : int
        Length of the record, at least 3.
    dt_s, phase_sigma_s, clocks, mixing
        As `estimate_clocks`.
    factors : sequence of int
        Averaging times in steps, each less than half of `epochs`.
    clock : int
        Whose.

    Returns
    -------
    ndarray, shape (len(factors),)

    Raises
    ------
    ValueError
        As `estimate_clocks`, and for a factor that does not fit into the record.
    """
    mixed = _mixing(mixing, len(clocks))
    return _clock.error_allan_variance(
        dt_s, _covariance(phase_sigma_s, len(mixed)), mixed, [_pair(c) for c in clocks], clock, list(factors), epochs
    )


def iterate_noise(
    phase_s: npt.ArrayLike,
    dt_s: float,
    phase_sigma_s: npt.ArrayLike,
    start: Clocks,
    *,
    mixing: npt.ArrayLike | None = None,
    estimated: Sequence[int] | None = None,
    analysis: Literal["increments", "allan_fit"] = "allan_fit",
    iterations: int = 20,
) -> _Array:
    """The iteration of pesyna fig. 2 as printed: smooth, take the noise from the smoothed clocks, repeat.

    Kept to show that it collapses: smoothed clocks move less than clocks do, by the smoother's own error, so that noise
    near the phases' is lost at each turn. To characterise a clock use `characterize`.

    Parameters
    ----------
    phase_s, dt_s, phase_sigma_s, mixing
        As `estimate_clocks`.
    start : sequence of TwoState or (h0, h-2), length k
    estimated : sequence of int, optional
        All by default.
    analysis : {"increments", "allan_fit"}
        Variances of the smoothed states' own steps, or a fit to the Allan variance of the smoothed bias.
    iterations : int

    Returns
    -------
    ndarray, shape (iterations + 1, k, 2)
        (h0, h-2) before each turn and after the last; not let below 1e-12 of the start.

    Raises
    ------
    ValueError
        As `estimate_clocks`, and for fewer than 8 whole epochs.
    """
    if analysis not in ("increments", "allan_fit"):
        raise ValueError(f"analysis = {analysis!r}: 'increments' or 'allan_fit' expected")
    if iterations < 0:
        raise ValueError(f"iterations = {iterations} must not be negative")
    phase, mixed = _records(phase_s, mixing)
    return _clock.iterate_noise(
        phase,
        dt_s,
        _covariance(phase_sigma_s, phase.shape[1]),
        mixed,
        [_pair(c) for c in start],
        list(range(len(start))) if estimated is None else list(estimated),
        allan_fit=analysis == "allan_fit",
        iterations=iterations,
    )
