"""NumPy and SciPy: the band found in each spectrum, decimation, few lags by FFT, a refined peak; no sigma, no tones.

Everything is vectorised and in single precision where SciPy keeps it; transforms run in one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.signal

Data = dict[str, npt.NDArray[Any]]
LAGS = np.arange(-2, 3)


def cross_ambiguity(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Few lags x FFT at the decimated rate, then Newton steps on the sums over blocks, delays by phase ramps."""
    a, b = data["a"], data["b"]
    rate, width = float(data["rate_hz"]), float(data["bandwidth_hz"])
    factor = int(rate / (1.7 * width))
    size = 1 << int(np.ceil(np.log2(12.0 * rate / width)))
    window = np.hanning(size).astype(np.float32)
    taps = scipy.signal.firwin(12 * factor + 1, 1.1 / factor, window=("kaiser", 5.0)).astype(np.float32)
    n = len(a) // factor
    low = rate / factor
    length = scipy.fft.next_fast_len(3 * n // 2)
    frequencies = scipy.fft.fftfreq(n, 1.0 / low).astype(np.float32)
    box = np.abs(frequencies) < 0.45 * width
    t = np.arange(n) / low
    t -= t.mean()

    def center(x: npt.NDArray[np.complex64]) -> float:
        segments = x[: len(x) // size * size].reshape(-1, size)
        step = max(1, len(segments) // 16)
        power = np.mean(np.abs(scipy.fft.fft(segments[::step] * window, axis=1)) ** 2, axis=0)
        power = scipy.fft.fftshift(power) - np.median(power)
        bins = round(0.8 * width / rate * size)
        at = int(np.argmax(np.convolve(power, np.ones(bins), "valid")))
        band = np.arange(max(0, at - 3), min(size, at + bins + 3))
        weight = np.maximum(power[band], 0.0)
        return float((np.sum(band * weight) / np.sum(weight) - size // 2) * rate / size)

    def down(x: npt.NDArray[np.complex64], at: float) -> npt.NDArray[np.complex64]:
        mixed = x * np.exp((-2j * np.pi * at / rate) * np.arange(len(x))).astype(np.complex64)
        y = scipy.signal.upfirdn(taps, mixed, 1, factor)
        first = len(taps) // 2 // factor
        return np.asarray(y[first : first + n], np.complex64)

    def run() -> tuple[float, float]:
        at_a, at_b = center(a), center(b)
        spectra = scipy.fft.fft(np.stack([down(a, at_a), down(b, at_b)]), axis=1) * box
        x, y = scipy.fft.ifft(spectra, axis=1)
        products = np.stack([np.roll(x, -lag) for lag in LAGS]) * np.conj(y)
        cells = np.abs(scipy.fft.fft(products, length, axis=1))
        lag, k = np.unravel_index(int(np.argmax(cells)), cells.shape)
        delay = float(LAGS[lag]) / low
        doppler = (k if k < length // 2 else k - length) * low / length
        # The gradient and curvature of |C|^2 from three delays by three Dopplers about the estimate.
        for _ in range(3):
            steps = np.array([-1e-6, 0.0, 1e-6])
            ramps = np.exp(2j * np.pi * np.outer(delay + steps, frequencies)).astype(np.complex64)
            shifted = scipy.fft.ifft(spectra[0] * ramps, axis=1) * np.conj(y)
            turns = np.exp(-2j * np.pi * np.outer(doppler + np.array([-1.0, 0.0, 1.0]), t)).astype(np.complex64)
            p = np.abs(shifted @ turns.T) ** 2
            gradient = np.array([p[2, 1] - p[0, 1], p[1, 2] - p[1, 0]]) / 2.0
            cross = (p[2, 2] - p[2, 0] - p[0, 2] + p[0, 0]) / 4.0
            hessian = np.array([[p[2, 1] - 2.0 * p[1, 1] + p[0, 1], cross], [cross, p[1, 2] - 2.0 * p[1, 1] + p[1, 0]]])
            move = -np.linalg.solve(hessian, gradient)
            delay += 1e-6 * float(np.clip(move[0], -8.0, 8.0))
            doppler += float(np.clip(move[1], -4.0, 4.0))
        return delay, doppler + at_a - at_b

    return run, lambda found: [1e6 * found[0], found[1]]
