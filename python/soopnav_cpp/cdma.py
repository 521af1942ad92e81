"""cdma2000 (spreading rate 1) and IS-95 forward link: pilot codes, signals, acquisition.

Samples are ``complex64``; random parts are named by a seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import cdma as _cdma

__all__ = [
    "CARRIER_HZ",
    "CHIP_RATE_HZ",
    "CODE_LENGTH",
    "CODE_PERIOD_S",
    "Acquisition",
    "PilotGenerator",
    "PilotSearcher",
    "PilotSignal",
    "acquire",
    "baseband_filter",
    "offset_candidates",
    "pilot_code",
    "synthesize",
]

_Iq = npt.NDArray[np.complex64]

CARRIER_HZ = 1931.25e6
"""Carrier taken where none is given, PCS channel 25 [Hz]."""
CHIP_RATE_HZ = 1.2288e6
"""Chips a second."""
CODE_LENGTH = 32768
"""Chips of a pilot code."""
CODE_PERIOD_S = 80e-3 / 3.0
"""Of a whole code [s]: 75 in two seconds."""


def pilot_code(pn_offset: int = 0) -> _Iq:
    """One period of a base station's pilot (3GPP2 C.S0002 section 3.1.3.1.13): short PN codes, Walsh code 0.

    Parameters
    ----------
    pn_offset : int
        0 … 511; offset k is offset 0 later by 64 k chips.

    Returns
    -------
    ndarray of complex64, shape (32768,)
        (i - j q) / √2, +1 for a logical 0: the baseband of the standard's I cos ωt + Q sin ωt. Chip 0 of offset 0 is
        the one after the fifteen zeros; it leaves on every even second of system time.

    Raises
    ------
    ValueError
        For another offset.
    """
    return _cdma.pilot_code(pn_offset)


def baseband_filter() -> npt.NDArray[np.float64]:
    """The 48 taps, four a chip, of the base station's filter (C.S0002 table 3.1.3.1.11-1)."""
    return _cdma.baseband_filter()


@dataclass(frozen=True)
class PilotSignal:
    """One base station's signal at an antenna.

    Attributes
    ----------
    pn_offset : int
        0 … 511.
    delay_s : float
        When chip 0 of offset 0 would begin, after the first sample; any sign.
    doppler_hz : float
        Positive when approaching; the code runs faster by as much.
    phase_cycles : float
        Of the carrier at the first sample.
    cn0_dbhz : float
        The pilot's carrier to noise density against noise of variance 1 a sample.
    channels : sequence of (int, float)
        Other code channels: Walsh code 1 … 63 and power against the pilot [dB]; random QPSK symbols.
    """

    pn_offset: int = 0
    delay_s: float = 0.0
    doppler_hz: float = 0.0
    phase_cycles: float = 0.0
    cn0_dbhz: float = 45.0
    channels: Sequence[tuple[int, float]] = ()


class PilotGenerator:
    """Makes the sum of base stations' signals, block after block without a seam.

    Parameters
    ----------
    signals : sequence of PilotSignal
    sample_rate_hz : float
        Any.
    intermediate_hz : float
        Where the carrier without Doppler lies in the samples.
    carrier_hz : float
        Which Doppler moves the code by.
    filtered : bool
        Chips through the base station's filter; otherwise rectangular.
    data_seed : int
        Of the other channels' symbols.
    """

    def __init__(
        self,
        signals: Sequence[PilotSignal],
        sample_rate_hz: float,
        *,
        intermediate_hz: float = 0.0,
        carrier_hz: float = CARRIER_HZ,
        filtered: bool = False,
        data_seed: int = 1,
    ) -> None:
        self._rows = np.array(
            [[s.pn_offset, s.delay_s, s.doppler_hz, s.phase_cycles, s.cn0_dbhz] for s in signals], dtype=np.float64
        ).reshape(-1, 5)
        self._channels = [[(int(k), float(p)) for k, p in s.channels] for s in signals]
        self._rate, self._if, self._carrier = sample_rate_hz, intermediate_hz, carrier_hz
        self._filtered, self._data_seed = filtered, data_seed
        self.render(0)

    def render(self, samples: int, *, first: int = 0, seed: int | None = None, stream: int = 0) -> _Iq:
        """Samples `first` … of the stream, with noise of variance 1 where a seed names it; shape (samples,)."""
        return _cdma.synthesize(
            self._rows,
            self._channels,
            samples,
            sample_rate_hz=self._rate,
            intermediate_hz=self._if,
            carrier_hz=self._carrier,
            filtered=self._filtered,
            data_seed=self._data_seed,
            first=first,
            seed=seed,
            stream=stream,
        )


def synthesize(
    signals: Sequence[PilotSignal],
    samples: int,
    sample_rate_hz: float,
    *,
    intermediate_hz: float = 0.0,
    carrier_hz: float = CARRIER_HZ,
    filtered: bool = False,
    data_seed: int = 1,
    first: int = 0,
    seed: int | None = None,
    stream: int = 0,
) -> _Iq:
    """The sum of base stations' signals; parameters as `PilotGenerator` and its `render`.

    Returns
    -------
    ndarray of complex64, shape (samples,)
        A pilot's amplitude is sqrt(10^(C/N0 / 10) / sample_rate_hz).

    Raises
    ------
    ValueError
        For offsets and Walsh codes that do not exist and numbers out of range.
    """
    generator = PilotGenerator(
        signals,
        sample_rate_hz,
        intermediate_hz=intermediate_hz,
        carrier_hz=carrier_hz,
        filtered=filtered,
        data_seed=data_seed,
    )
    return generator.render(samples, first=first, seed=seed, stream=stream)


def offset_candidates(
    delay_s: float, *, start_s: float = 0.0, start_error_s: float = 0.0, max_travel_s: float = 50e-6
) -> list[int]:
    """Offsets that explain a delay when the first sample lies `start_s` ± `start_error_s` after a multiple of the code
    period of system time and the signal travelled at most `max_travel_s`; ascending."""
    return _cdma.offset_candidates(delay_s, start_s=start_s, start_error_s=start_error_s, max_travel_s=max_travel_s)


@dataclass(frozen=True)
class Acquisition:
    """A pilot that was found.

    Attributes
    ----------
    delay_s, sigma_delay_s : float
        Of chip 0 of offset 0 after the first sample, modulo 26.67 ms.
    doppler_hz, sigma_doppler_hz : float
        Positive when approaching.
    cn0_dbhz, sigma_cn0_db : float
        Of the pilot against all else in the band.
    statistic : float
        Sum of normalised powers, of mean ``noncoherent`` in noise.
    pn_offset, excess_s : int, float
        Whole offsets in the delay, and what is left: a name only where the first sample lies on a multiple of the code
        period of system time (`offset_candidates`).
    """

    delay_s: float
    sigma_delay_s: float
    doppler_hz: float
    sigma_doppler_hz: float
    cn0_dbhz: float
    sigma_cn0_db: float
    statistic: float
    pn_offset: int
    excess_s: float


class PilotSearcher:
    """Searches samples for pilots of all offsets at once, by transforms (cpp/doc/cdma_tracking.md).

    Parameters
    ----------
    sample_rate_hz : float
        At least 1.2288 MHz.
    intermediate_hz, carrier_hz : float
        The carrier at least 100 MHz.
    max_doppler_hz : float
        Dopplers within ± this are searched.
    coherent_s : float
        Of one correlation, up to one code period.
    noncoherent : int
        Correlations whose powers are added.
    false_alarm_probability : float
        Of a whole search in noise, at most; a cell's is exact.
    max_pilots : int
    """

    def __init__(
        self,
        sample_rate_hz: float,
        *,
        intermediate_hz: float = 0.0,
        carrier_hz: float = CARRIER_HZ,
        max_doppler_hz: float = 2000.0,
        coherent_s: float = 5e-3,
        noncoherent: int = 4,
        false_alarm_probability: float = 1e-3,
        max_pilots: int = 8,
    ) -> None:
        self._searcher = _cdma.PilotSearcher(
            sample_rate_hz=sample_rate_hz,
            intermediate_hz=intermediate_hz,
            carrier_hz=carrier_hz,
            max_doppler_hz=max_doppler_hz,
            coherent_s=coherent_s,
            noncoherent=noncoherent,
            false_alarm_probability=false_alarm_probability,
            max_pilots=max_pilots,
        )

    @property
    def samples(self) -> int:
        """That a search takes."""
        return self._searcher.samples

    @property
    def cells(self) -> int:
        """Delays (half chips) times Dopplers."""
        return self._searcher.cells

    @property
    def threshold(self) -> float:
        """Of the statistic."""
        return self._searcher.threshold

    def search(self, iq: _Iq) -> list[Acquisition]:
        """Pilots in the first `samples` samples, strongest first; none where samples are too few or not finite."""
        return [
            Acquisition(a, b, c, d, e, f, g, int(offset), excess)
            for a, b, c, d, e, f, g, offset, excess in self._searcher.search(iq).tolist()
        ]


def acquire(
    iq: _Iq,
    sample_rate_hz: float,
    *,
    intermediate_hz: float = 0.0,
    carrier_hz: float = CARRIER_HZ,
    max_doppler_hz: float = 2000.0,
    coherent_s: float = 5e-3,
    noncoherent: int = 4,
    false_alarm_probability: float = 1e-3,
    max_pilots: int = 8,
) -> list[Acquisition]:
    """Pilots in the beginning of `iq`, strongest first; parameters as `PilotSearcher`.

    Raises
    ------
    ValueError
        For options out of range, fewer samples than a search takes, and samples that are not finite.
    """
    searcher = PilotSearcher(
        sample_rate_hz,
        intermediate_hz=intermediate_hz,
        carrier_hz=carrier_hz,
        max_doppler_hz=max_doppler_hz,
        coherent_s=coherent_s,
        noncoherent=noncoherent,
        false_alarm_probability=false_alarm_probability,
        max_pilots=max_pilots,
    )
    if len(iq) < searcher.samples:
        raise ValueError(f"iq: {searcher.samples} samples expected at least, got {len(iq)}")
    if not np.isfinite(iq[: searcher.samples]).all():
        raise ValueError("iq: finite samples expected")
    return searcher.search(iq)
