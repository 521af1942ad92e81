"""Candidate noises of clocks, weighted by the likelihood of their innovations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._characterization import Characterization, _covariance, _mixing, _oscillator, _pair, _read_only, _real
from soopnav_cpp._core import clock as _clock

if TYPE_CHECKING:
    from soopnav_cpp.clock import TwoState

__all__ = ["NoiseBank"]

_Array = npt.NDArray[np.float64]


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
        """The next epochs' phases [s], shape (m,) or (n, m): how many were whole. Others are predicted across:
        a phase that is not finite or 1e60 sigmas."""
        return int(self._core.push(_real("phase_s", phase_s)))

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
