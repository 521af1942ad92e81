"""One continuous carrier phase of bursts that begin with random fractions of a cycle: the face of the engine's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import BurstStatus
from soopnav_cpp.clock import TwoState

__all__ = ["BurstStatus", "PhaseStitcher", "StitchedPhase", "stitch_phase"]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_IRIDIUM_HZ = 1626.270833e6
_REFUSED = [int(s) for s in (BurstStatus.NOT_FINITE, BurstStatus.NOT_LATER, BurstStatus.OUTLIER)]


def _positive(name: str, values: npt.ArrayLike) -> None:
    given = np.asarray(values, np.float64)
    wrong = np.flatnonzero(given <= 0.0)  # NaN goes with a burst that has no number and is refused by itself
    if wrong.size:
        raise ValueError(f"{name}[{wrong[0]}] = {given.flat[wrong[0]]}: a positive number expected")


@dataclass(frozen=True)
class StitchedPhase:
    """Bursts whose integers were decided, in order of time.

    Attributes
    ----------
    burst : ndarray of int64, shape (m,)
        Which burst, counted from the first one ever given.
    t_s : ndarray, shape (m,)
    phase_cycles : ndarray, shape (m,)
        With the random fraction taken out; within an arc it is continuous and is range over wavelength plus clocks plus
        one constant (pesyna eq. 6 without η).
    sigma_cycles : ndarray, shape (m,)
        The measurement's, and in a float step the spread over the hypotheses.
    integer, step : ndarray of int64, shape (m,)
        n of ``measured - n / M``, 0 at the start; and its change since the burst before.
    posterior : ndarray, shape (m,)
        Probability of `step`.
    fixed : ndarray of bool, shape (m,)
        Whether it reached the asked probability.
    arc : ndarray of int64, shape (m,)
        Phases of one arc share their constant; each float step begins another.
    status : ndarray of uint8, shape (n,)
        `BurstStatus` of every burst that the call was given, also of those it refused.
    """

    burst: npt.NDArray[np.int64]
    t_s: _Array
    phase_cycles: _Array
    sigma_cycles: _Array
    integer: npt.NDArray[np.int64]
    step: npt.NDArray[np.int64]
    posterior: _Array
    fixed: npt.NDArray[np.bool_]
    arc: npt.NDArray[np.int64]
    status: npt.NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        arcs = len(np.unique(self.arc))
        float_steps = np.count_nonzero(~self.fixed)
        refused = np.count_nonzero(np.isin(self.status, _REFUSED))
        left_out = f", {refused} bursts refused" if refused else ""
        return f"StitchedPhase({len(self)} bursts in {arcs} arcs, {float_steps} steps left float{left_out})"


def _stitched(rows: _Array) -> StitchedPhase:
    whole = [np.ascontiguousarray(rows[:, k]).astype(np.int64) for k in (0, 4, 5, 8)]
    real = [np.ascontiguousarray(rows[:, k]) for k in (1, 2, 3, 6)]
    return StitchedPhase(
        burst=whole[0],
        t_s=real[0],
        phase_cycles=real[1],
        sigma_cycles=real[2],
        integer=whole[1],
        step=whole[2],
        posterior=real[3],
        fixed=rows[:, 7] != 0.0,
        arc=whole[3],
    )


class PhaseStitcher:
    """Stitches the phases of bursts, Iridium's by default, into one (pesyna eq. 6; ``cpp/doc/phase_stitching.md``).

    All integers that the prediction leaves possible are followed, each with a Kalman filter of phase, frequency and its
    rate; the frequencies that look alike from burst to burst are 1 / (M gap) apart, and the frequency within the bursts
    tells them apart after a while.

    Parameters
    ----------
    carrier_hz : float
    clock : TwoState
        What runs between the bursts: the satellite's oscillator plus what aiding leaves of the receiver's.
    fractions : int
        M: a burst begins with a random multiple of 1/M cycle.
    frequency_sigma_hz, rate_sigma_hzps : float
        How well the prediction knows frequency and its slope.
    rate_walk_hz2ps3 : float
        Power density with which the error of the slope wanders.
    decision_bursts : int
        Bursts after which an integer is decided.
    posterior : float
        Least probability of a step that is called fixed.
    hypotheses : int
        Most that are kept.
    gate_sigma : float
    outliers : int
        After so many bursts in a row that fit no hypothesis all begins anew.

    Raises
    ------
    ValueError
        For an option out of range.
    """

    def __init__(
        self,
        *,
        carrier_hz: float = _IRIDIUM_HZ,
        clock: TwoState | None = None,
        fractions: int = 4,
        frequency_sigma_hz: float = 5.0,
        rate_sigma_hzps: float = 0.3,
        rate_walk_hz2ps3: float = 0.0,
        decision_bursts: int = 60,
        posterior: float = 0.999,
        hypotheses: int = 128,
        gate_sigma: float = 6.0,
        outliers: int = 5,
    ) -> None:
        if not (np.isfinite(carrier_hz) and carrier_hz > 0.0):
            raise ValueError(f"carrier_hz = {carrier_hz}: a positive number expected")
        oscillator = TwoState.ocxo() if clock is None else clock
        self._engine = _navigation.PhaseStitcher(
            fractions=fractions,
            wavelength_m=_LIGHT_MPS / carrier_hz,
            white_frequency_m2ps=oscillator.h0 / 2.0 * _LIGHT_MPS**2,
            frequency_walk_m2ps3=2.0 * np.pi**2 * oscillator.h_minus_2 * _LIGHT_MPS**2,
            frequency_sigma_hz=frequency_sigma_hz,
            rate_sigma_hzps=rate_sigma_hzps,
            rate_walk_hz2ps3=rate_walk_hz2ps3,
            decision_bursts=decision_bursts,
            posterior=posterior,
            hypotheses=hypotheses,
            gate_sigma=gate_sigma,
            outliers=outliers,
        )

    def push(
        self,
        t_s: npt.ArrayLike,
        phase_cycles: npt.ArrayLike,
        sigma_cycles: npt.ArrayLike,
        frequency_hz: npt.ArrayLike | None = None,
        frequency_sigma_hz: npt.ArrayLike | None = None,
        *,
        predicted_cycles: npt.ArrayLike = 0.0,
        predicted_rate_cyclesps: npt.ArrayLike = 0.0,
    ) -> tuple[npt.NDArray[np.uint8], StitchedPhase]:
        """Takes bursts, one or many, in order of time.

        Parameters
        ----------
        t_s : array_like, shape (n,) or ()
            Middles of the bursts; the others broadcast to it.
        phase_cycles, sigma_cycles : array_like
            Carrier phase in the middle, growing with range, and its standard deviation. NaN: refused, nothing changes.
        frequency_hz, frequency_sigma_hz : array_like, optional
            Rate of the phase within the burst (minus the Doppler shift); NaN: none.
        predicted_cycles, predicted_rate_cyclesps : array_like
            What orbit, place and the aided clock say of the phase, and its time derivative.

        Returns
        -------
        status : ndarray of uint8, shape (n,)
            Values of `BurstStatus`.
        decided : StitchedPhase
            What these bursts decided; the last ``decision_bursts`` may still wait.
        """
        n = np.size(t_s)
        columns = [t_s, phase_cycles, sigma_cycles]
        columns += [np.nan if c is None else c for c in (frequency_hz, frequency_sigma_hz)]
        columns += [predicted_cycles, predicted_rate_cyclesps]
        rows = np.empty((n, 7))
        names = ("t_s", "phase_cycles", "sigma_cycles", "frequency_hz", "frequency_sigma_hz", "predicted_cycles",
                 "predicted_rate_cyclesps")  # fmt: skip
        for k, (name, column) in enumerate(zip(names, columns, strict=True)):
            given = np.asarray(column, dtype=np.float64)
            if given.shape not in ((), (1,), (n,)):
                raise ValueError(f"{name}: shape ({n},) expected, got {given.shape}")
            rows[:, k] = given
        status, decided = self._engine.push(rows)
        return status, replace(_stitched(decided), status=status)

    def finish(self, *, early: bool = False) -> StitchedPhase:
        """Decides all that still wait and begins anew; `early` lets the posterior alone decide before the time."""
        return _stitched(self._engine.finish(early))

    @property
    def hypotheses(self) -> int:
        """Followed now."""
        return int(self._engine.hypotheses)

    @property
    def waiting(self) -> int:
        """Bursts that are not decided yet."""
        return int(self._engine.waiting)

    @property
    def posterior(self) -> float:
        """Probability of the likeliest hypothesis; 0 at first."""
        return float(self._engine.posterior)

    @property
    def frequency_error_hz(self) -> float:
        """What the likeliest hypothesis says the predicted rate is off by; NaN at first."""
        return float(self._engine.frequency_error_hz)

    @property
    def frequency_error_sigma_hz(self) -> float:
        """Its standard deviation."""
        return float(self._engine.frequency_error_sigma_hz)

    def __repr__(self) -> str:
        return f"PhaseStitcher({self.waiting} bursts waiting, {self.hypotheses} hypotheses)"


def stitch_phase(
    t_s: npt.ArrayLike,
    phase_cycles: npt.ArrayLike,
    sigma_cycles: npt.ArrayLike,
    frequency_hz: npt.ArrayLike | None = None,
    frequency_sigma_hz: npt.ArrayLike | None = None,
    *,
    predicted_cycles: npt.ArrayLike = 0.0,
    predicted_rate_cyclesps: npt.ArrayLike = 0.0,
    carrier_hz: float = _IRIDIUM_HZ,
    clock: TwoState | None = None,
    fractions: int = 4,
    frequency_sigma_hz_prior: float = 5.0,
    rate_sigma_hzps: float = 0.3,
    decision_bursts: int = 60,
    posterior: float = 0.999,
) -> StitchedPhase:
    """All bursts of one pass at once; see `PhaseStitcher` and its `push`.

    What became of each burst is in the result's `status`.

    Raises
    ------
    ValueError
        As `PhaseStitcher` and `push`, and for a standard deviation that is not positive.
    """
    _positive("sigma_cycles", sigma_cycles)
    if frequency_sigma_hz is not None:
        _positive("frequency_sigma_hz", frequency_sigma_hz)
    stitcher = PhaseStitcher(
        carrier_hz=carrier_hz,
        clock=clock,
        fractions=fractions,
        frequency_sigma_hz=frequency_sigma_hz_prior,
        rate_sigma_hzps=rate_sigma_hzps,
        decision_bursts=decision_bursts,
        posterior=posterior,
    )
    _, first = stitcher.push(
        t_s,
        phase_cycles,
        sigma_cycles,
        frequency_hz,
        frequency_sigma_hz,
        predicted_cycles=predicted_cycles,
        predicted_rate_cyclesps=predicted_rate_cyclesps,
    )
    rest = stitcher.finish()
    joined = {
        name: np.concatenate([getattr(first, name), getattr(rest, name)]) for name in StitchedPhase.__dataclass_fields__
    }
    return StitchedPhase(**joined)
