"""Acquisition of GPS L1 C/A: searches by FFT, and long coherent searches with what is already known."""

from __future__ import annotations

import enum
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import gps as _gps

__all__ = [
    "Acquirer",
    "Acquisition",
    "AcquisitionStatus",
    "AidedCorrelator",
    "acquire",
    "cell_loss",
    "search_frequencies",
]

_Array = npt.NDArray[np.float64]
_Iq = npt.NDArray[np.complex64]


class AcquisitionStatus(enum.Enum):
    """How a search ended."""

    FOUND = 0
    """The statistic passes the threshold."""
    NOT_FOUND = 1
    """It does not: the rest is that of the highest cell all the same."""
    TOO_FEW_SAMPLES = 2
    """Nothing was searched."""
    NOT_FINITE = 3
    """A sample is not finite or beyond 1e15, all are zero, or the statistic overflows: nothing is known."""


@dataclass(frozen=True)
class Acquisition:
    """The highest cell of a search for one satellite.

    Attributes
    ----------
    prn : int
    status : AcquisitionStatus
    delay_s : float
        When a code begins, after the first sample, 0 … 1 ms; between samples by a parabola.
    doppler_hz : float
        Positive when approaching; between bins by a parabola.
    cn0_dbhz : float
        Of the highest cell, its losses between cells not given back; at least 0.
    statistic : float
        Sum of the coherent sums' powers over the noise's; mean `noncoherent` in noise.
    bin, sample : int
        The cell: row and column of `Acquirer.surface`.
    """

    prn: int
    status: AcquisitionStatus
    delay_s: float
    doppler_hz: float
    cn0_dbhz: float
    statistic: float
    bin: int
    sample: int

    @property
    def found(self) -> bool:
        """Whether the statistic passes the threshold."""
        return self.status is AcquisitionStatus.FOUND

    def __bool__(self) -> bool:
        return self.found

    def __repr__(self) -> str:
        if self.status in (AcquisitionStatus.TOO_FEW_SAMPLES, AcquisitionStatus.NOT_FINITE):
            return f"Acquisition(PRN {self.prn}: {self.status.name})"
        where = f"{self.delay_s * 1e6:.2f} µs, {self.doppler_hz:+.0f} Hz, {self.cn0_dbhz:.1f} dB-Hz"
        return f"Acquisition(PRN {self.prn}: {where if self.found else 'not found'})"


class Acquirer:
    """Searches samples for satellites: all delays by FFT, Doppler by Doppler.

    Coherent sums are folded to one code and correlated on a circle; where the Doppler moves the code during long
    searches the sums are moved back before their powers are added. In white noise of known variance a cell's statistic
    is of the gamma law of shape `noncoherent`, exactly. The threshold is that of as many independent cells: half-spaced
    Dopplers and oversampled delays are correlated, so the search's false alarm is at most what was asked.

    Parameters
    ----------
    sample_rate_hz : float
        A whole number of kilohertz, 1.023 to 100 MHz. 2.048 and 4.096 MHz have fast transforms.
    intermediate_hz : float
        Where the carrier without Doppler lies in the samples.
    coherent_ms : int
        Of one coherent sum, 1 … 20; beyond 1 data bits may cut into it.
    noncoherent : int
        Coherent sums whose powers are added.
    doppler_hz : (float, float)
        Lowest and highest.
    doppler_step_hz : float
        0: half of the inverse of a coherent sum.
    false_alarm_probability : float
        Of a whole search for one satellite in noise, at most.
    noise_variance : float
        Of a sample, E|w|²; 0: the samples' mean power, in which the signals count as noise.

    Raises
    ------
    ValueError
        Naming the parameter that breaks its rule.
    """

    def __init__(
        self,
        sample_rate_hz: float,
        *,
        intermediate_hz: float = 0.0,
        coherent_ms: int = 1,
        noncoherent: int = 1,
        doppler_hz: tuple[float, float] = (-5000.0, 5000.0),
        doppler_step_hz: float = 0.0,
        false_alarm_probability: float = 1e-3,
        noise_variance: float = 0.0,
    ) -> None:
        low, high = doppler_hz
        self._core = _gps.Acquirer(
            sample_rate_hz=sample_rate_hz,
            intermediate_hz=intermediate_hz,
            coherent_ms=coherent_ms,
            noncoherent=noncoherent,
            min_doppler_hz=low,
            max_doppler_hz=high,
            doppler_step_hz=doppler_step_hz,
            false_alarm_probability=false_alarm_probability,
            noise_variance=noise_variance,
        )
        self.sample_rate_hz = sample_rate_hz
        self.coherent_ms = coherent_ms
        self.noncoherent = noncoherent

    @property
    def samples(self) -> int:
        """That a search takes."""
        return self._core.samples

    @property
    def cells(self) -> int:
        """Delays times Dopplers."""
        return self._core.cells

    @property
    def threshold(self) -> float:
        """Of the statistic."""
        return self._core.threshold

    @property
    def cell_false_alarm(self) -> float:
        """Probability that noise passes the threshold in one cell."""
        return self._core.cell_false_alarm

    @property
    def doppler_hz(self) -> _Array:
        """Of the rows of `surface`."""
        return np.array([self._core.doppler_hz(i) for i in range(self._core.dopplers)])

    @property
    def delay_s(self) -> _Array:
        """Of the columns of `surface`."""
        return np.arange(self._core.delays) / self.sample_rate_hz

    def search(self, iq: _Iq, prns: int | Iterable[int]) -> list[Acquisition]:
        """Search the first `samples` samples for each satellite, in the order given.

        Raises
        ------
        ValueError
            For a PRN without code or samples that are not complex64. Too few samples or some that are not finite give
            a status.
        """
        wanted = [operator.index(prn) for prn in (prns if isinstance(prns, Iterable) else [prns])]
        return [Acquisition(row[0], AcquisitionStatus(row[1]), *row[2:]) for row in self._core.search(iq, wanted)]

    @property
    def surface(self) -> npt.NDArray[np.float32]:
        """Statistics of the last search, shape (Dopplers, delays); a copy."""
        return self._core.surface()

    def __repr__(self) -> str:
        return (
            f"Acquirer({self.noncoherent} × {self.coherent_ms} ms, {self._core.dopplers} Dopplers, "
            f"threshold {self.threshold:.1f})"
        )


def acquire(
    iq: _Iq,
    sample_rate_hz: float,
    prns: int | Iterable[int] = range(1, 33),
    *,
    intermediate_hz: float = 0.0,
    coherent_ms: int = 1,
    noncoherent: int = 1,
    doppler_hz: tuple[float, float] = (-5000.0, 5000.0),
    doppler_step_hz: float = 0.0,
    false_alarm_probability: float = 1e-3,
    noise_variance: float = 0.0,
) -> list[Acquisition]:
    """Search samples for GPS satellites; the first ``coherent_ms * noncoherent`` milliseconds are used.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    sample_rate_hz : float
    prns : int or iterable of int
    intermediate_hz, coherent_ms, noncoherent, doppler_hz, doppler_step_hz, false_alarm_probability, noise_variance
        As `Acquirer`, which is worth making oneself for many searches.

    Returns
    -------
    list of Acquisition
        One for each satellite, in the order given; true where found.
    """
    low, high = doppler_hz
    acquirer = Acquirer(
        sample_rate_hz,
        intermediate_hz=intermediate_hz,
        coherent_ms=coherent_ms,
        noncoherent=noncoherent,
        doppler_hz=(low, high),
        doppler_step_hz=doppler_step_hz,
        false_alarm_probability=false_alarm_probability,
        noise_variance=noise_variance,
    )
    return acquirer.search(iq, prns)


def cell_loss(delay_error_chips: float, doppler_error_hz: float, coherent_s: float) -> float:
    """Share of a signal's power that a cell keeps which is off by a delay and a Doppler: (1 - |chips|)² sinc²(Hz T).

    Parameters
    ----------
    delay_error_chips, doppler_error_hz, coherent_s : float
    """
    return _gps.cell_loss(delay_error_chips, doppler_error_hz, coherent_s)


class AidedCorrelator:
    """Correlates a weak satellite with what is predicted of it, block after block (pesyna section V-D).

    The samples are looked at once; frequencies are searched in the sums afterwards, by `search_frequencies`.

    Parameters
    ----------
    prn : int
    sample_rate_hz : float
        At least the chip rate.
    intermediate_hz : float
    block_s : float
        Of one sum, rounded to whole samples, at most 1.
    max_blocks : int
    half_chips : int
        Code delays searched: -half_chips … half_chips, half a chip apart.
    bits : sequence of int
        Known data, +1 or -1, 20 ms each from transmission time 0 on, repeated; empty: all +1.

    Raises
    ------
    ValueError
        Naming the parameter that breaks its rule.
    """

    def __init__(
        self,
        prn: int,
        *,
        sample_rate_hz: float,
        intermediate_hz: float = 0.0,
        block_s: float = 0.1,
        max_blocks: int = 1000,
        half_chips: int = 2,
        bits: Sequence[int] = (),
    ) -> None:
        self._core = _gps.AidedCorrelator(
            prn,
            sample_rate_hz=sample_rate_hz,
            intermediate_hz=intermediate_hz,
            block_s=block_s,
            max_blocks=max_blocks,
            half_chips=half_chips,
            bits=list(bits),
        )

    @property
    def block_samples(self) -> int:
        """That a push takes."""
        return self._core.block_samples

    @property
    def block_s(self) -> float:
        """As rounded."""
        return self._core.block_s

    @property
    def delay_chips(self) -> _Array:
        """Of the columns of `sums`, later than predicted."""
        return np.array([self._core.delay_chips(i) for i in range(self._core.codes)])

    def push(
        self,
        iq: _Iq,
        *,
        transmit_time_s: float,
        carrier_phase_cycles: float,
        doppler_hz: float,
        doppler_rate_hzps: float = 0.0,
    ) -> bool:
        """Take the next block, with what is predicted for its first sample.

        Parameters
        ----------
        iq : ndarray, shape (block_samples,), complex64
        transmit_time_s : float
            At which the signal left; bit 0 leaves from 0 on.
        carrier_phase_cycles : float
            Grows with range and with the receiver's clock.
        doppler_hz, doppler_rate_hzps : float
            Minus the phase's rate, and its rate.

        Returns
        -------
        bool
            False, and nothing taken, for another number of samples, numbers that are not finite, or when full.
        """
        return self._core.push(
            iq,
            transmit_time_s=transmit_time_s,
            carrier_phase_cycles=carrier_phase_cycles,
            doppler_hz=doppler_hz,
            doppler_rate_hzps=doppler_rate_hzps,
        )

    @property
    def sums(self) -> npt.NDArray[np.complex128]:
        """So far, shape (blocks, codes); noise of variance 1 a sample leaves `block_samples` in each. A copy."""
        return self._core.sums()

    def __repr__(self) -> str:
        return f"AidedCorrelator({self._core.blocks} blocks of {self.block_s:g} s)"


def search_frequencies(
    sums: npt.ArrayLike,
    block_s: float,
    frequencies_hz: npt.ArrayLike,
    *,
    variance: float = 1.0,
    coherent_blocks: int | None = None,
) -> _Array:
    """Statistics Σ |Σ y exp(-j 2π f t)|² / σ² of sums at frequencies: a long search's second half.

    Parameters
    ----------
    sums : array_like, shape (blocks, codes), complex
    block_s : float
    frequencies_hz : array_like, shape (f,)
        Evenly spaced.
    variance : float
        Of a block's noise.
    coherent_blocks : int, optional
        Blocks of one coherent sum; powers of several are added, what is left over is not used. All by default.

    Returns
    -------
    ndarray, shape (codes, f)
        In noise each is of the gamma law of shape blocks // coherent_blocks.

    Raises
    ------
    ValueError
        For frequencies that are not evenly spaced, numbers that are not finite, or no whole coherent sum.
    """
    y = np.asarray(sums, np.complex128)
    grid = np.asarray(frequencies_hz, np.float64)
    if y.ndim != 2:
        raise ValueError(f"sums: shape (blocks, codes) expected, got {y.shape}")
    if grid.ndim != 1 or not len(grid):
        raise ValueError(f"frequencies_hz: shape (f,) expected, got {grid.shape}")
    step = float(grid[-1] - grid[0]) / (len(grid) - 1) if len(grid) > 1 else 0.0
    if not np.allclose(grid, grid[0] + step * np.arange(len(grid)), rtol=0.0, atol=1e-6 * abs(step) + 1e-15):
        raise ValueError("frequencies_hz: evenly spaced numbers expected")
    return _gps.search_frequencies(
        y,
        block_s=block_s,
        variance=variance,
        first_hz=float(grid[0]),
        step_hz=step,
        count=len(grid),
        coherent_blocks=len(y) if coherent_blocks is None else coherent_blocks,
    )
