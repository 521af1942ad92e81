"""Bursts in a wide band by SciPy: a spectrogram, its medians, a sliding mean, what lies together above a threshold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Prepared = tuple[Callable[[], Any], Callable[[Any], list[float]]]


def scan(data: Data) -> Prepared:
    """Spectra of 1 ms every 0.5 ms, cells of 25 kHz and 6 ms, the threshold of the other side."""
    from scipy import ndimage, signal

    iq, rate_hz = data["iq"], float(data["rate_hz"])
    size = round(rate_hz * 1e-3)
    spectrogram = signal.ShortTimeFFT(
        np.hanning(size + 1)[:-1].astype(np.float32), size // 2, rate_hz, fft_mode="centered"
    )

    def run() -> Any:
        power = spectrogram.spectrogram(iq, p0=1, p1=(iq.size - size) // (size // 2) + 1)
        # The median of a bin over time, smoothed over 50 kHz, is the noise.
        noise = ndimage.uniform_filter1d(np.median(power, axis=1), 51) / np.log(2.0)
        cells = ndimage.uniform_filter((power / noise[:, None]).astype(np.float32), (25, 12))
        regions, count = ndimage.label(cells > 1.65)
        found = []
        for rows, columns in ndimage.find_objects(regions, count):
            weight = np.maximum(cells[rows, columns] - 1.0, 0.0)
            centre = rows.start + np.average(np.arange(weight.shape[0]), weights=weight.sum(axis=1))
            inside = np.flatnonzero(weight.max(axis=0) > 0.5 * weight.max())
            found.append(((columns.start + inside[0]) * 0.5e-3, (centre - size // 2) * rate_hz / size))
        return found

    def answer(found: Any) -> list[float]:
        rows = sorted((float(start_s), float(frequency_hz) / 1e6) for start_s, frequency_hz in found)
        return [float(len(rows)), *(value for row in rows for value in row)]

    return run, answer
