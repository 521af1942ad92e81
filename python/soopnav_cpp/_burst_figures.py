"""Spectrograms with the signals that were found in them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp._drawing import _INK, _figure, _save, _style
from soopnav_cpp.iridium import DetectedBurst, SignalClass

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS = 1400  # of the picture at most
_ROWS = 700
_BIN_HZ = 1e3
_LABELS = 24  # more boxes than these are left without words
_EDGES = {SignalClass.BURST: "#ffffff", SignalClass.TONE: "#ff5d73", SignalClass.CONTINUOUS: "#ffb454"}
_NAMES = {SignalClass.BURST: "burst", SignalClass.TONE: "tone", SignalClass.CONTINUOUS: "continuous"}


def _spectrogram(
    iq: npt.NDArray[np.complex64], sample_rate_hz: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], float]:
    """Power in dB over its median, rows of frequency and columns of time; the frequencies; the seconds of a column."""
    size = max(64, 2 * round(0.5 * sample_rate_hz / _BIN_HZ))
    if iq.size < size:
        iq = np.concatenate([iq, np.zeros(size - iq.size, np.complex64)])
    spectra = max(1, (iq.size - size) // (size // 2) + 1)
    pool = math.ceil(spectra / _COLUMNS)  # the strongest of so many: short bursts stay in sight
    fold = math.ceil(size / _ROWS)
    window = np.hanning(size + 1)[:-1].astype(np.float32)
    columns = []
    for first in range(0, spectra - pool + 1, pool):
        starts = (first + np.arange(pool)) * (size // 2)
        blocks = iq[starts[:, None] + np.arange(size)] * window
        power = np.square(np.abs(np.fft.fftshift(np.fft.fft(blocks, axis=1), axes=1))).max(axis=0)
        columns.append(power[: size // fold * fold].reshape(-1, fold).max(axis=1))
    picture = np.stack(columns, axis=1).astype(np.float64)
    frequencies = np.fft.fftshift(np.fft.fftfreq(size, 1.0 / sample_rate_hz))[: size // fold * fold]
    middle = float(np.median(picture)) or 1.0
    level = 10.0 * np.log10(np.maximum(picture / middle, 1e-6))
    return level, frequencies.reshape(-1, fold).mean(axis=1), pool * (size // 2) / sample_rate_hz


def burst_spectrogram(
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    signals: Sequence[DetectedBurst],
    *,
    center_frequency_hz: float = 0.0,
    title: str = "",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a recording's spectrogram with the signals found in it boxed: bursts white, tones red, others orange.

    A box holds a signal's time and, for bursts, the 35 kHz that they occupy; a burst's SNR stands beside it when there
    are not too many. Each point of the picture shows the strongest of the spectra that it stands for, in dB over the
    picture's median.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    sample_rate_hz : float
    signals : sequence of DetectedBurst
        From `soopnav_cpp.iridium.detect_bursts` with the same centre frequency; may be empty.
    center_frequency_hz : float
        Radio frequency at 0 Hz of the samples; 0: the axis shows baseband.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure
    """
    level, frequencies, column_s = _spectrogram(iq, sample_rate_hz)
    figure = _figure(11.0, 6.2)
    axes = figure.add_subplot()
    unit_hz = 1e6 if center_frequency_hz else 1e3
    offset = (frequencies + center_frequency_hz) / unit_hz
    half = 0.5 * (offset[1] - offset[0])
    duration_ms = 1e3 * max(iq.size / sample_rate_hz, column_s)
    low, high = -3.0, float(np.clip(np.percentile(level, 99.9), 12.0, 45.0))
    image = axes.imshow(
        level,
        origin="lower",
        aspect="auto",
        interpolation="nearest",
        cmap="viridis",
        vmin=low,
        vmax=high,
        extent=(0.0, 1e3 * column_s * level.shape[1], offset[0] - half, offset[-1] + half),
    )
    for signal in signals:
        width_hz = 35e3 if signal.kind is SignalClass.BURST else max(signal.bandwidth_hz, 4e3)
        left, right = 1e3 * signal.start_s, 1e3 * (signal.start_s + signal.duration_s)
        bottom, top = (signal.frequency_hz - 0.5 * width_hz) / unit_hz, (signal.frequency_hz + 0.5 * width_hz) / unit_hz
        colour = _EDGES[signal.kind]
        style = ":" if signal.cut_start or signal.cut_end else "-"
        axes.plot(
            [left, right, right, left, left], [bottom, bottom, top, top, bottom], style, color=colour, linewidth=1.1
        )
        if len(signals) <= _LABELS:
            words = f"{signal.snr_db:.0f} dB" if signal.kind is SignalClass.BURST else _NAMES[signal.kind]
            late = right > 0.9 * duration_ms
            axes.annotate(
                words,
                (left if late else right, 0.5 * (bottom + top)),
                xytext=(-3 if late else 3, 0),
                textcoords="offset points",
                ha="right" if late else "left",
                va="center",
                fontsize=8,
                color=colour,
            )
    axes.set_facecolor(image.cmap(0.0))
    axes.set_xlim(0.0, duration_ms)
    axes.set_ylim(offset[0] - half, offset[-1] + half)
    axes.ticklabel_format(axis="y", useOffset=False)
    _style(axes, title, "time [ms]", "frequency [MHz]" if center_frequency_hz else "frequency in baseband [kHz]")
    axes.grid(False)
    bar = figure.colorbar(image, ax=axes, pad=0.01)
    bar.set_label("dB over the median", fontsize=9, color=_INK)
    bar.ax.tick_params(labelsize=8, colors=_INK)
    return _save(figure, path)
