"""Broadcast FM as a waveform: what a station sends, without what it says."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

__all__ = ["fm_waveform"]


def fm_waveform(
    duration_s: float,
    sample_rate_hz: float,
    *,
    seed: int,
    deviation_hz: float = 75e3,
    audio_bandwidth_hz: float = 15e3,
    crest: float = 3.0,
) -> npt.NDArray[np.complex64]:
    """The complex envelope of a frequency-modulated station: ``exp(j 2 pi integral of the deviation)``, unit power.

    The programme is Gaussian noise from 50 Hz to the audio bandwidth, falling by 3 dB per octave as music does before
    its emphasis; its deviation is `deviation_hz` at `crest` times its root mean square, and limited there.

    Parameters
    ----------
    duration_s, sample_rate_hz : float
        The rate should exceed twice (deviation_hz + audio_bandwidth_hz) (Carson's rule), or the edges fold.
    seed : int
        Names the programme.
    deviation_hz, audio_bandwidth_hz, crest : float

    Returns
    -------
    ndarray, shape (n,), complex64
        ``n = round(duration_s * sample_rate_hz)``.

    Raises
    ------
    ValueError
        For numbers that are not positive and finite, a duration below one sample, or a rate below twice the audio's.
    """
    for name, value in (
        ("duration_s", duration_s),
        ("sample_rate_hz", sample_rate_hz),
        ("deviation_hz", deviation_hz),
        ("audio_bandwidth_hz", audio_bandwidth_hz),
        ("crest", crest),
    ):
        if not (value > 0.0 and math.isfinite(value)):
            raise ValueError(f"{name} = {value}: it must be positive and finite")
    n = round(duration_s * sample_rate_hz)
    if n < 1:
        raise ValueError(f"duration_s = {duration_s}: at least one sample at {sample_rate_hz:g} Hz expected")
    if sample_rate_hz < 2.0 * audio_bandwidth_hz:
        raise ValueError(f"sample_rate_hz = {sample_rate_hz}: at least twice audio_bandwidth_hz expected")
    # Twice as long as asked for, so that the programme does not close on itself, and long enough for its lowest tones.
    length = 1 << math.ceil(math.log2(max(2.0 * n, 0.2 * sample_rate_hz)))
    rng = np.random.default_rng([seed, 0x464D])
    frequency = np.fft.rfftfreq(length, 1.0 / sample_rate_hz)
    heard = (frequency >= 50.0) & (frequency <= audio_bandwidth_hz)
    spectrum = np.zeros(len(frequency), np.complex128)
    count = int(np.count_nonzero(heard))
    spectrum[heard] = (rng.standard_normal(count) + 1j * rng.standard_normal(count)) / np.sqrt(frequency[heard])
    programme = np.fft.irfft(spectrum, length)
    level = np.clip(programme[:n] / (crest * float(np.sqrt(np.mean(programme**2)))), -1.0, 1.0)
    phase = 2.0 * math.pi * deviation_hz / sample_rate_hz * np.cumsum(level)
    return np.asarray(np.exp(1j * phase), np.complex64)
