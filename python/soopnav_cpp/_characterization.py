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
    "NoiseBank",
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


def _mixing(mixing: npt.ArrayLike | None, channels: int) -> _Array:
    return np.eye(channels) if mixing is None else np.atleast_2d(np.asarray(mixing, np.float64))


def _covariance(phase_sigma_s: npt.ArrayLike, channels: int) -> _Array:
    sigma = np.asarray(phase_sigma_s, np.float64)
    if sigma.ndim == 2:  # square of a full root would hide what was meant: a matrix is the covariance itself
        return sigma
    if not (np.all(sigma > 0.0) and np.all(np.isfinite(sigma))):
        raise ValueError(
            f"phase_sigma_s = {phase_sigma_s!r}: positive and finite expected; "
            "white noise of a phase is known from C/N0 and is never zero"
        )
    return np.diag(np.broadcast_to(sigma, channels) ** 2)


def _records(phase_s: npt.ArrayLike, mixing: npt.ArrayLike | None) -> tuple[_Array, _Array]:
    phase = np.asarray(phase_s, np.float64)
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
        For a sigma that is not positive, infinite phases, fewer than 8 whole epochs, or shapes that do not fit.
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
        Averaging times in steps.
    clock : int
        Whose.

    Returns
    -------
    ndarray, shape (len(factors),)
        NaN for a factor that does not fit into the record.
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


class NoiseBank:
    """Candidate noises of clocks, weighted epoch by epoch by the likelihood of their innovations (multiple models).

    A static bank in the sense of Li and Bar-Shalom (1994), pesyna's ref. [9]: it serves while records run, and where
    the record does not tell the clocks apart its weights say so.

    Parameters
    ----------
    candidates : array_like, shape (c, k, 2)
        (h0, h-2) of each clock in each candidate; `around` makes them.
    dt_s, phase_sigma_s, mixing
        As `characterize`.
    prior : array_like, shape (c,), optional
        Relative weights; equal ones by default.
    ln_width : array_like, shape (c, k, 2), optional
        How much of ln h each candidate stands for: what `interval` spreads its weight over. Nothing by default.

    Raises
    ------
    ValueError
        For no candidate, coefficients below zero, or priors that are no weights.
    """

    def __init__(
        self,
        candidates: npt.ArrayLike,
        dt_s: float,
        phase_sigma_s: npt.ArrayLike,
        *,
        mixing: npt.ArrayLike | None = None,
        prior: npt.ArrayLike | None = None,
        ln_width: npt.ArrayLike | None = None,
    ) -> None:
        table = np.array(candidates, np.float64)
        if table.ndim != 3 or table.shape[2] != 2:
            raise ValueError(f"candidates: shape (candidates, clocks, 2) expected, got {table.shape}")
        mixed = _mixing(mixing, table.shape[1])
        if mixed.shape[1] != table.shape[1]:
            raise ValueError(f"candidates: {mixed.shape[1]} clocks each expected, got {table.shape[1]}")
        width = np.zeros_like(table) if ln_width is None else np.array(ln_width, np.float64)
        if width.shape != table.shape or not np.all(width >= 0.0):
            raise ValueError(f"ln_width: shape {table.shape} and no number below 0 expected, got shape {width.shape}")
        self._candidates = _read_only(table)
        self._ln_width = width
        self._core = _clock.NoiseBank(
            dt_s,
            _covariance(phase_sigma_s, len(mixed)),
            mixed,
            table.reshape(-1, 2),
            [] if prior is None else np.asarray(prior, np.float64),
        )

    @classmethod
    def around(
        cls,
        found: Characterization,
        phase_sigma_s: npt.ArrayLike,
        *,
        mixing: npt.ArrayLike | None = None,
        sigmas: float = 3.0,
        totals: int = 5,
        split_span: float = 300.0,
        splits: int = 9,
    ) -> NoiseBank:
        """A bank about a maximum of the likelihood: totals of the noise near it, any split among two clocks.

        A plain grid in each clock's noise collapses onto its nearest node along what the record tells well, the total;
        so that is spaced by its own standard deviation, and the split, which the record may not tell, is wide
        (cpp/doc/characterization.md).

        Parameters
        ----------
        found : Characterization
            Of one or two estimated clocks.
        phase_sigma_s, mixing
            As `characterize`.
        sigmas : float
            Totals of h0 and of h-2 go this many standard deviations up and down, `totals` of each.
        split_span : float
            Ratios of the two clocks' noise go from 1/split_span to split_span, `splits` for h0 and as many for h-2.
        """
        if not 1 <= len(found.estimated) <= 2:
            raise ValueError(f"found: one or two estimated clocks expected, got {len(found.estimated)}")
        if not (sigmas > 0.0 and split_span > 1.0 and totals > 1 and splits > 1):
            raise ValueError("sigmas above 0, split_span above 1, totals and splits above 1 expected")
        white, walk = found.h0.sum(), found.h_minus_2.sum()
        spread = []
        for i, share in enumerate((found.h0 / white, found.h_minus_2 / walk)):
            along = np.zeros(len(found.ln_covariance))
            along[i::2] = share
            spread.append(min(max(math.sqrt(along @ found.ln_covariance @ along), 0.02), 1.0))
        steps = np.linspace(-sigmas, sigmas, totals)
        total = np.stack([white * np.exp(spread[0] * steps), walk * np.exp(spread[1] * steps)])
        ratio = np.exp(np.linspace(-1.0, 1.0, splits) * math.log(split_span))
        if len(found.estimated) == 1:
            ratio = np.zeros(1)
        apart = 2.0 * math.log(split_span) / (splits - 1)
        # Indices of the totals of h0 and h-2, and of the splits of h0 and h-2.
        index = np.stack(np.meshgrid(*map(np.arange, (totals, totals, len(ratio), len(ratio))), indexing="ij"), axis=-1)
        index = index.reshape(-1, 4)
        table = np.tile([_pair(clock) for clock in found.clocks], (len(index), 1, 1)).astype(np.float64)
        width = np.zeros_like(table)
        for p in range(2):
            whole, split = total[p, index[:, p]], ratio[index[:, 2 + p]]
            step = spread[p] * (steps[1] - steps[0])
            first = found.estimated[0]
            table[:, first, p] = whole / (1.0 + split)
            width[:, first, p] = step + apart * split / (1.0 + split)
            if len(found.estimated) == 2:
                second = found.estimated[1]
                table[:, second, p] = whole * split / (1.0 + split)
                width[:, second, p] = step + apart / (1.0 + split)
        return cls(table, found.dt_s, phase_sigma_s, mixing=mixing, ln_width=width)

    @property
    def candidates(self) -> _Array:
        """Shape (c, k, 2), read-only."""
        return self._candidates

    @property
    def innovations(self) -> int:
        """Whole epochs so far, less the two that start the filters."""
        return int(self._core.innovations)

    @property
    def weights(self) -> _Array:
        """Posterior probability of each candidate, shape (c,)."""
        return self._core.weights

    @property
    def log_likelihoods(self) -> _Array:
        """Of each candidate, without its prior, shape (c,)."""
        return self._core.log_likelihoods

    def push(self, phase_s: npt.ArrayLike) -> int:
        """The next epochs' phases [s], shape (m,) or (n, m): how many were whole. Others are predicted across."""
        return int(self._core.push(np.asarray(phase_s, np.float64)))

    def mean(self) -> tuple[TwoState, ...]:
        """Posterior mean of each clock's h0 and h-2: what a filter's Q takes."""
        return tuple(_oscillator(pair) for pair in np.einsum("c,ckp->kp", self.weights, self._candidates))

    def interval(self, clock: int, parameter: Literal["h0", "h-2"], probability: float = 0.95) -> tuple[float, float]:
        """Credible interval of one coefficient, of equal tails; a candidate's weight is spread over its `ln_width`.

        Parameters
        ----------
        clock : int
        parameter : {"h0", "h-2"}
        probability : float
            Between 0 and 1.
        """
        if parameter not in ("h0", "h-2"):
            raise ValueError(f"parameter = {parameter!r}: 'h0' or 'h-2' expected")
        if not 0.0 < probability < 1.0:
            raise ValueError(f"probability = {probability}: between 0 and 1 expected")
        column = 0 if parameter == "h0" else 1
        values = np.log(np.maximum(self._candidates[:, clock, column], 1e-300))
        width = np.maximum(self._ln_width[:, clock, column], 1e-9)
        weights = self.weights

        def quantile(share: float) -> float:
            low, high = float((values - width).min()), float((values + width).max())
            for _ in range(60):
                middle = 0.5 * (low + high)
                below = weights @ np.clip((middle - values) / width + 0.5, 0.0, 1.0)
                low, high = (middle, high) if below < share else (low, middle)
            return math.exp(0.5 * (low + high))

        return quantile(0.5 - 0.5 * probability), quantile(0.5 + 0.5 * probability)

    def probability_steadier(self, clock: int, other: int, tau_s: float = 1.0) -> float:
        """Posterior probability that `clock` has the smaller Allan deviation at `tau_s`; ties count half."""
        variance = self._candidates[..., 0] / (2.0 * tau_s) + 2.0 * math.pi**2 / 3.0 * self._candidates[..., 1] * tau_s
        less = variance[:, clock] < variance[:, other] * (1.0 - 1e-12)
        tie = ~less & (variance[:, clock] <= variance[:, other] * (1.0 + 1e-12))
        return float(self.weights @ (less + 0.5 * tie))

    def __repr__(self) -> str:
        weights = self.weights
        best = weights.argmax()
        return (
            f"NoiseBank({len(weights)} candidates, {self.innovations} innovations, greatest weight {weights[best]:.2g})"
        )
