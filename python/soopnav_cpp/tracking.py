"""Code and carrier tracking of spread signals: loops, what theory says of them, observables.

Signs: carrier phases in cycles and delays in seconds grow with range; Dopplers are positive when approaching. A fast
receiver clock lengthens delays and lowers carriers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import cdma as _cdma_signals
from soopnav_cpp import gps as _gps_signals
from soopnav_cpp._core import tracking as _tracking

__all__ = [
    "Epochs",
    "LoopVariance",
    "PhaseNoise",
    "Signal",
    "Tracker",
    "code_sigma_s",
    "design_loop",
    "loop_variance",
    "phase_sigma_cycles",
    "track",
    "window_sigma_cycles",
]

_Array = npt.NDArray[np.float64]
_Iq = npt.NDArray[np.complex64]


@dataclass(frozen=True)
class Signal:
    """A spread signal as a tracker has to know it.

    Attributes
    ----------
    chips : ndarray of complex64, shape (n,)
        One code period, of unit power on average.
    chip_rate_hz, carrier_hz : float
        The carrier at least the chip rate.
    symbol_s : float
        Of the data's signs, a whole number of code periods; 0: none, a pilot.
    code_slope : float
        Fall of the correlation per chip beside its peak, 1 for rectangular chips.
    """

    chips: _Iq
    chip_rate_hz: float
    carrier_hz: float
    symbol_s: float = 0.0
    code_slope: float = 1.0

    @classmethod
    def gps_l1(cls, prn: int) -> Signal:
        """GPS L1 C/A: 1023 chips, data bits of 20 ms."""
        chips = _gps_signals.ca_code(prn).astype(np.complex64)
        return cls(chips, _gps_signals.CHIP_RATE_HZ, _gps_signals.CARRIER_HZ, 20e-3)

    @classmethod
    def cdma_pilot(cls, pn_offset: int = 0, *, carrier_hz: float = _cdma_signals.CARRIER_HZ) -> Signal:
        """A cdma2000 pilot."""
        return cls(_cdma_signals.pilot_code(pn_offset), _cdma_signals.CHIP_RATE_HZ, carrier_hz)


@dataclass(frozen=True)
class Epochs:
    """Observables, one entry for each window; shape (n,) each.

    Attributes
    ----------
    t_s : ndarray
        Middle of the window by the receiver's clock, from the first sample on.
    carrier_phase_cycles, carrier_phase_sigma_cycles : ndarray
        Of the window alone, so white from epoch to epoch; σ is thermal. With data modulo half a cycle.
    delay_s, delay_sigma_s : ndarray
        Of the code.
    doppler_hz, doppler_sigma_hz : ndarray
    cn0_hz, cn0_sigma_hz : ndarray
        Of the window, unbiased: in noise alone negative half of the time.
    cn0_dbhz : ndarray
        Smoothed over a second, at least 0.
    loop_t_s, loop_phase_cycles : ndarray
        The loop's own phase after the last integration, and its time.
    phase_lock : ndarray
        Mean cosine of (twice, with data) the remaining phase.
    prompt : ndarray of complex128
        Mean prompt, data wiped, in units of a sample's noise.
    arc : ndarray of int64
        Phases of one arc have one ambiguity.
    bad_samples : ndarray of int64
        Not finite: left out.
    state : ndarray of int64
        0 pulling in, 1 tracking, 2 coasting without a signal.
    phase_locked, code_locked : ndarray of bool
    """

    t_s: _Array
    carrier_phase_cycles: _Array
    carrier_phase_sigma_cycles: _Array
    delay_s: _Array
    delay_sigma_s: _Array
    doppler_hz: _Array
    doppler_sigma_hz: _Array
    cn0_hz: _Array
    cn0_sigma_hz: _Array
    cn0_dbhz: _Array
    loop_t_s: _Array
    loop_phase_cycles: _Array
    phase_lock: _Array
    prompt: npt.NDArray[np.complex128]
    arc: npt.NDArray[np.int64]
    bad_samples: npt.NDArray[np.int64]
    state: npt.NDArray[np.int64]
    phase_locked: npt.NDArray[np.bool_]
    code_locked: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        locked = int(self.phase_locked.sum())
        return f"Epochs({len(self)} epochs, {locked} phase-locked, {len(set(self.arc[self.phase_locked]))} arcs)"


def _epochs(rows: _Array) -> Epochs:
    columns = [np.ascontiguousarray(column) for column in rows.T]
    flags = columns[18].astype(np.int64)
    names = [field.name for field in fields(Epochs)][:13]
    numbers: dict[str, Any] = dict(zip(names, columns[:13], strict=True))
    return Epochs(
        **numbers,
        prompt=columns[13] + 1j * columns[14],
        arc=columns[15].astype(np.int64),
        bad_samples=columns[16].astype(np.int64),
        state=columns[17].astype(np.int64),
        phase_locked=(flags & 1) != 0,
        code_locked=(flags & 2) != 0,
    )


class Tracker:
    """Tracks one signal through a stream of samples; blocks of any sizes give the same bits.

    Parameters
    ----------
    signal : Signal
    sample_rate_hz : float
        At least the chip rate.
    intermediate_hz : float
        Where the carrier without Doppler lies in the samples.
    delay_s, doppler_hz : float
        Start: when the code begins (with `symbol_known` a symbol), and the carrier's shift.
    integration_s : float
        Coherent, when settled; with data it divides a symbol.
    pll_bandwidth_hz, pll_order : float, int
        Noise bandwidth of the discrete loop, exactly; order 2 or 3.
    dll_bandwidth_hz, early_late_chips : float
        Of the carrier-aided code loop; between early and late.
    epoch_s : float
        Of one observable, at least two integrations.
    pull_in_s, pull_in_integration_s, pull_in_bandwidth_hz, fll_bandwidth_hz : float
        Start and after a loss: for how long, integration (0: a code period with data, else 5 ms at most), bandwidths
        of phase and frequency loops. 0 s: settled at once.
    symbol_known : bool
        `delay_s` says when a symbol begins: no search for its edge.
    loss_s : float
        Without a signal for so long: pulling in starts again.

    Raises
    ------
    ValueError
        Naming the option that breaks its rule.
    """

    def __init__(
        self,
        signal: Signal,
        sample_rate_hz: float,
        *,
        intermediate_hz: float = 0.0,
        delay_s: float = 0.0,
        doppler_hz: float = 0.0,
        integration_s: float = 20e-3,
        pll_bandwidth_hz: float = 10.0,
        pll_order: int = 2,
        dll_bandwidth_hz: float = 0.5,
        early_late_chips: float = 0.5,
        epoch_s: float = 0.1,
        pull_in_s: float = 1.0,
        pull_in_integration_s: float = 0.0,
        pull_in_bandwidth_hz: float = 20.0,
        fll_bandwidth_hz: float = 8.0,
        symbol_known: bool = False,
        loss_s: float = 2.0,
    ) -> None:
        self._tracker = _tracking.Tracker(
            np.ascontiguousarray(signal.chips, dtype=np.complex64),
            chip_rate_hz=signal.chip_rate_hz,
            carrier_hz=signal.carrier_hz,
            symbol_s=signal.symbol_s,
            code_slope=signal.code_slope,
            sample_rate_hz=sample_rate_hz,
            intermediate_hz=intermediate_hz,
            delay_s=delay_s,
            doppler_hz=doppler_hz,
            integration_s=integration_s,
            pll_bandwidth_hz=pll_bandwidth_hz,
            pll_order=pll_order,
            dll_bandwidth_hz=dll_bandwidth_hz,
            early_late_chips=early_late_chips,
            epoch_s=epoch_s,
            pull_in_s=pull_in_s,
            pull_in_integration_s=pull_in_integration_s,
            pull_in_bandwidth_hz=pull_in_bandwidth_hz,
            fll_bandwidth_hz=fll_bandwidth_hz,
            symbol_known=symbol_known,
            loss_s=loss_s,
        )

    @property
    def samples(self) -> int:
        """Taken so far."""
        return self._tracker.samples

    def push(self, iq: _Iq) -> Epochs:
        """Takes samples (any number, ``complex64``); returns the epochs that they complete."""
        return _epochs(self._tracker.push(iq))


def track(
    iq: _Iq,
    signal: Signal,
    sample_rate_hz: float,
    *,
    intermediate_hz: float = 0.0,
    delay_s: float = 0.0,
    doppler_hz: float = 0.0,
    integration_s: float = 20e-3,
    pll_bandwidth_hz: float = 10.0,
    pll_order: int = 2,
    dll_bandwidth_hz: float = 0.5,
    early_late_chips: float = 0.5,
    epoch_s: float = 0.1,
    pull_in_s: float = 1.0,
    pull_in_integration_s: float = 0.0,
    pull_in_bandwidth_hz: float = 20.0,
    fll_bandwidth_hz: float = 8.0,
    symbol_known: bool = False,
    loss_s: float = 2.0,
) -> Epochs:
    """Tracks one signal through all of `iq`; parameters as `Tracker`."""
    tracker = Tracker(
        signal,
        sample_rate_hz,
        intermediate_hz=intermediate_hz,
        delay_s=delay_s,
        doppler_hz=doppler_hz,
        integration_s=integration_s,
        pll_bandwidth_hz=pll_bandwidth_hz,
        pll_order=pll_order,
        dll_bandwidth_hz=dll_bandwidth_hz,
        early_late_chips=early_late_chips,
        epoch_s=epoch_s,
        pull_in_s=pull_in_s,
        pull_in_integration_s=pull_in_integration_s,
        pull_in_bandwidth_hz=pull_in_bandwidth_hz,
        fll_bandwidth_hz=fll_bandwidth_hz,
        symbol_known=symbol_known,
        loss_s=loss_s,
    )
    return tracker.push(iq)


@dataclass(frozen=True)
class PhaseNoise:
    """An oscillator as it shakes a phase: densities of the random walks [cycles²/s], [cycles²/s³]."""

    white_frequency_cycles2ps: float = 0.0
    frequency_walk_cycles2ps3: float = 0.0

    @classmethod
    def from_allan(cls, h0: float, h_minus_2: float, carrier_hz: float) -> PhaseNoise:
        """carrier² h0 / 2 and 2π² carrier² h-2."""
        return cls(*_tracking.phase_noise(h0, h_minus_2, carrier_hz))


@dataclass(frozen=True)
class LoopVariance:
    """Variances of a settled loop's phase [cycles²] and rate [Hz²], from noise and from the oscillator."""

    thermal_phase: float
    oscillator_phase: float
    thermal_rate: float
    oscillator_rate: float


def design_loop(order: int, bandwidth_hz: float, interval_s: float) -> tuple[float, float, float]:
    """Gains of phase, rate and rate of rate of the loop whose noise bandwidth is exactly this, updated so often."""
    gains = _tracking.design_loop(order, bandwidth_hz, interval_s)
    return gains[0], gains[1], gains[2]


def loop_variance(
    order: int, bandwidth_hz: float, interval_s: float, *, mean_variance: float, oscillator: PhaseNoise | None = None
) -> LoopVariance:
    """Errors of a settled loop when each interval's mean phase has the variance `mean_variance` [cycles²].

    Exact for the discrete loop (cpp/doc/cdma_tracking.md).
    """
    noise = oscillator or PhaseNoise()
    return LoopVariance(
        *_tracking.loop_variance(
            order,
            bandwidth_hz,
            interval_s,
            mean_variance=mean_variance,
            white=noise.white_frequency_cycles2ps,
            walk=noise.frequency_walk_cycles2ps3,
        )
    )


def phase_sigma_cycles(cn0_dbhz: float, interval_s: float, *, costas_integration_s: float | None = None) -> float:
    """Thermal σ of a phase measured over an interval; with the squaring loss of Costas integrations where given."""
    cn0 = 10.0 ** (cn0_dbhz / 10.0)
    if costas_integration_s is None:
        return math.sqrt(_tracking.phase_variance(cn0, interval_s))
    return math.sqrt(_tracking.costas_phase_variance(cn0, interval_s, costas_integration_s))


def window_sigma_cycles(oscillator: PhaseNoise, window_s: float) -> float:
    """σ of the mean of an oscillator's phase over a window against its phase amid the window."""
    return math.sqrt(
        _tracking.window_variance(oscillator.white_frequency_cycles2ps, oscillator.frequency_walk_cycles2ps3, window_s)
    )


def code_sigma_s(
    cn0_dbhz: float, interval_s: float, *, integration_s: float, spacing_chips: float, chip_rate_hz: float
) -> float:
    """Thermal σ of the code's delay, early-late times prompt [s]."""
    cn0 = 10.0 ** (cn0_dbhz / 10.0)
    return math.sqrt(_tracking.code_variance(cn0, interval_s, integration_s, spacing_chips)) / chip_rate_hz
