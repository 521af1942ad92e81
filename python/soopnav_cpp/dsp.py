"""Sampled signals: correlation, delays, resampling, and delay and Doppler between two recordings.

Samples are ``complex64``, C-contiguous and never copied on the way in.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._ambiguity import (
    AmbiguityStatus,
    CrossAmbiguityResult,
    Surface,
    TdoaFdoaBound,
    ambiguity_surface,
    cross_ambiguity,
    tdoa_fdoa_crlb,
)
from soopnav_cpp._core import dsp as _dsp
from soopnav_cpp._detection import (
    cell_false_alarm,
    detection_probability,
    detection_threshold,
    false_alarm_probability,
    marcum_q,
)

__all__ = [
    "AmbiguityStatus",
    "CrossAmbiguityResult",
    "Surface",
    "TdoaFdoaBound",
    "ambiguity_surface",
    "cell_false_alarm",
    "convolve",
    "correlate",
    "cross_ambiguity",
    "delay",
    "detection_probability",
    "detection_threshold",
    "false_alarm_probability",
    "fft_library",
    "marcum_q",
    "resample",
    "tdoa_fdoa_crlb",
]

_Iq = npt.NDArray[np.complex64]


def correlate(iq: _Iq, kernel: _Iq) -> _Iq:
    """Correlate a capture with a known signal, by overlap-save.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    kernel : ndarray, shape (k,), complex64
        1 <= k <= n.

    Returns
    -------
    ndarray, shape (n - k + 1,), complex64
        ``sum_j conj(kernel[j]) * iq[i + j]``: peaks where `iq` holds `kernel` starting at sample ``i``.
    """
    return _dsp.correlate(iq, kernel)


def convolve(iq: _Iq, kernel: _Iq) -> _Iq:
    """Convolve a capture with a filter, by overlap-save.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    kernel : ndarray, shape (k,), complex64

    Returns
    -------
    ndarray, shape (n + k - 1,), complex64
        The whole convolution; empty for an empty capture.
    """
    return _dsp.convolve(iq, kernel)


def delay(iq: _Iq, delay_samples: float, *, passband: float = 0.8, attenuation_db: float = 80.0) -> _Iq:
    """Delay a capture by any real number of samples.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    delay_samples : float
        Negative: earlier.
    passband : float
        Fraction of half the sample rate that is kept exact.
    attenuation_db : float
        Error inside it, dB below the signal, 20 ... 110.

    Returns
    -------
    ndarray, shape (n,), complex64
        ``y[i] = x(i - delay_samples)``, x being zero outside the capture.
    """
    return _dsp.delay(iq, delay_samples, passband=passband, attenuation_db=attenuation_db)


def resample(
    iq: _Iq,
    in_rate_hz: float,
    out_rate_hz: float,
    *,
    passband: float = 0.8,
    stopband: float = 1.2,
    attenuation_db: float = 80.0,
) -> _Iq:
    """Bring a capture to another sample rate, without delay: output m lies at input time ``m * in_rate / out_rate``.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    in_rate_hz, out_rate_hz : float
        Their ratio may be any number.
    passband, stopband : float
        Fractions of half the lower rate: kept exact up to the first, suppressed from the second on.
    attenuation_db : float
        Error in the one and rest in the other, dB below a tone, 20 ... 110.

    Returns
    -------
    ndarray, shape (ceil(n * out_rate / in_rate),), complex64
    """
    return _dsp.resample(
        iq, in_rate_hz, out_rate_hz, passband=passband, stopband=stopband, attenuation_db=attenuation_db
    )


def fft_library() -> str:
    """Library behind the transforms: ``"fftw"`` or ``"eigen"``."""
    return _dsp.fft_library()
