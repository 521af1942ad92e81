"""Iridium's L band: channels, bursts as functions of time, bursts found in recordings.

>>> import soopnav_cpp as sn
>>> burst = sn.iridium.make_burst(sn.iridium.BurstKind.DUPLEX, seed=1)
>>> iq = burst.render(30_000, 2e6, delay_s=4e-3, doppler_hz=250e3)
>>> iq.dtype, round(burst.duration_s * 1e3, 2)
(dtype('complex64'), 8.28)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import iridium as _iridium
from soopnav_cpp._core.iridium import (
    Burst,
    BurstDetector,
    BurstDirection,
    BurstKind,
    ChannelUse,
    DetectedBurst,
    SignalClass,
)

__all__ = [
    "CHANNELS",
    "CHANNEL_SPACING_HZ",
    "FRAME_S",
    "MAX_DOPPLER_HZ",
    "RING_ALERT_HZ",
    "ROLL_OFF",
    "SYMBOL_RATE_HZ",
    "Burst",
    "BurstDetector",
    "BurstDirection",
    "BurstKind",
    "ChannelCandidate",
    "ChannelUse",
    "DetectedBurst",
    "SignalClass",
    "channel_candidates",
    "channel_frequency_hz",
    "channel_use",
    "detect_bursts",
    "make_burst",
    "matched_filter",
    "pulse",
]

CHANNELS = 252
"""Channels: 1 … 240 duplex, 241 … 252 simplex."""
CHANNEL_SPACING_HZ = 1e6 / 24.0
"""Between channels [Hz], 41 666.7."""
FRAME_S = 90e-3
"""A TDMA frame [s]: a simplex slot of 20.32 ms, four uplink and four downlink slots of 8.28 ms, and guards."""
MAX_DOPPLER_HZ = 38e3
"""Doppler of a satellite at 780 km seen from the ground, rounded up [Hz]."""
RING_ALERT_HZ = 1616e6 + 246.5 * CHANNEL_SPACING_HZ
"""The ring alert's channel, 247 [Hz]."""
ROLL_OFF = 0.4
"""Of the root-raised-cosine pulse."""
SYMBOL_RATE_HZ = 25e3
"""Symbols a second."""


def channel_frequency_hz(channel: int) -> float:
    """Centre of a channel [Hz]: 1616 MHz + (channel - 1/2) / 24 MHz.

    Parameters
    ----------
    channel : int
        1 … 240 duplex, eight to a sub-band; 241 … 252 simplex, 247 the ring alert.

    Raises
    ------
    ValueError
        For another number.
    """
    return _iridium.channel_frequency_hz(channel)


def channel_use(channel: int) -> ChannelUse:
    """What a channel is for: duplex traffic, the ring alert, messaging, or kept free.

    Raises
    ------
    ValueError
        For a number outside 1 … 252.
    """
    return _iridium.channel_use(channel)


@dataclass(frozen=True)
class ChannelCandidate:
    """A channel that a received carrier may belong to.

    Attributes
    ----------
    channel : int
    frequency_hz : float
        Its centre.
    doppler_hz : float
        Received minus centre: positive when the satellite approaches.
    """

    channel: int
    frequency_hz: float
    doppler_hz: float


def channel_candidates(received_hz: float, *, max_doppler_hz: float = MAX_DOPPLER_HZ) -> list[ChannelCandidate]:
    """The channels whose centre lies within the Doppler of a received carrier, nearest first.

    One or two with the satellites' Doppler, none outside the band: the carrier alone does not say which.

    Parameters
    ----------
    received_hz : float
        Radio frequency. Not finite: none.
    max_doppler_hz : float
    """
    return [ChannelCandidate(*row) for row in _iridium.channel_candidates(received_hz, max_doppler_hz=max_doppler_hz)]


def make_burst(
    kind: BurstKind,
    seed: int,
    *,
    stream: int = 0,
    duration_s: float = 0.0,
    direction: BurstDirection = BurstDirection.DOWNLINK,
) -> Burst:
    """A burst of unit power with random payload: 25 000 symbols a second, DQPSK, root-raised cosine 0.4.

    Ring-alert and simplex bursts: 64 symbols preamble, 12 of the unique word, payload, 5.76 … 20.32 ms. Duplex: 16, 12,
    payload, 5.88 … 8.28 ms. The downlink's preamble is bare carrier, the uplink's changes sign with every symbol.
    `BurstKind.LONG`, for simulation: payload only, up to 10 s.

    Parameters
    ----------
    kind : BurstKind
    seed, stream : int
        Name the payload's bits.
    duration_s : float
        0: the longest of the kind (`LONG`: 90 ms); otherwise rounded to whole symbols.
    direction : BurstDirection

    Returns
    -------
    Burst
        A function of continuous time, 0 … ``duration_s``; `Burst.evaluate`, `Burst.at` and `Burst.render` sample it.

    Raises
    ------
    ValueError
        For a duration that the kind does not have.
    """
    return Burst.make(kind, seed, stream=stream, duration_s=duration_s, direction=direction)


def pulse(t_symbols: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The pulse g at times in symbols: root-raised cosine 0.4 of mean power one, cut at 12, faded over the last two."""
    return _iridium.pulse(np.asarray(t_symbols, dtype=np.float64))


def matched_filter(
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    symbols: int,
    *,
    start_s: float = 0.0,
    frequency_hz: float = 0.0,
) -> npt.NDArray[np.complex64]:
    """Symbols of a burst, by the matched filter.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    sample_rate_hz : float
        35e3 or more.
    symbols : int
    start_s : float
        When the burst starts, after the first sample.
    frequency_hz : float
        Its carrier in the samples; the phase of exp(j 2π f t), t from the first sample, is taken out, no more.

    Returns
    -------
    ndarray, shape (symbols,), complex64
        Symbol k at `start_s` + (k + 1/2) · 40 µs; right to -45 dB without noise.

    Raises
    ------
    ValueError
        For a rate too low, and numbers that are not finite.
    """
    return _iridium.matched_filter(iq, sample_rate_hz, start_s=start_s, frequency_hz=frequency_hz, symbols=symbols)


def detect_bursts(
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    *,
    center_frequency_hz: float = 0.0,
    false_alarms_per_s: float = 1e-3,
    max_burst_s: float = 0.1,
    all_signals: bool = False,
) -> list[DetectedBurst]:
    """Scan a recording for bursts (doc/iridium.md).

    Cells of 25 kHz and 6 ms are tested against the noise around them at a constant false-alarm rate; what stands out is
    cut to its begin and end, and its carrier taken from its symbols. An 8.28 ms burst is found from about -2 dB; at 10
    dB it begins within 0.1 ms and its carrier is right to a few hertz. Neighbouring channels are told apart.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        C-contiguous. Not copied. The GIL is released. Fewer than 5 ms hold nothing. Samples that are not finite count
        as zero.
    sample_rate_hz : float
        50e3 … 100e6.
    center_frequency_hz : float
        Radio frequency at 0 Hz of the samples; added to the frequencies found.
    false_alarms_per_s : float
        Reports from noise alone, at most.
    max_burst_s : float
        What is longer is no burst, 0.02 … 1.
    all_signals : bool
        Also what is no burst: tones, and signals that do not end. See ``DetectedBurst.kind``.

    Returns
    -------
    list of DetectedBurst
        By time: ``kind``, ``start_s``, ``duration_s``, ``frequency_hz``, ``frequency_sigma_hz``, ``bandwidth_hz`` (of
        the middle 90 % of the power), ``snr_db`` (in 25 kHz), ``cut_start``, ``cut_end``, ``fine_frequency``.

    Raises
    ------
    ValueError
        For another dtype or shape and options out of range.

    See Also
    --------
    BurstDetector : the same on a stream.
    channel_candidates : the channels a carrier may belong to, and its Doppler there.
    """
    detector = BurstDetector(
        sample_rate_hz,
        center_frequency_hz=center_frequency_hz,
        false_alarms_per_s=false_alarms_per_s,
        max_burst_s=max_burst_s,
    )
    found = detector.push(iq) + detector.flush()
    kept = [signal for signal in found if all_signals or signal.kind is SignalClass.BURST]
    return sorted(kept, key=lambda signal: (signal.start_s, signal.frequency_hz))
