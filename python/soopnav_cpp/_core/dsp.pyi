"""
Transforms, correlation, delays and resampling.
"""

from __future__ import annotations
import numpy
import numpy.typing
import typing

__all__: list[str] = ["convolve", "correlate", "delay", "fft_library", "resample"]

def convolve(
    iq: numpy.typing.NDArray[numpy.complex64], kernel: numpy.typing.NDArray[numpy.complex64]
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    The whole convolution.
    """

def correlate(
    iq: numpy.typing.NDArray[numpy.complex64], kernel: numpy.typing.NDArray[numpy.complex64]
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Correlation where the kernel lies wholly inside iq.
    """

def delay(
    iq: numpy.typing.NDArray[numpy.complex64],
    delay_samples: typing.SupportsFloat | typing.SupportsIndex,
    *,
    passband: typing.SupportsFloat | typing.SupportsIndex = 0.8,
    attenuation_db: typing.SupportsFloat | typing.SupportsIndex = 80.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Delay by any number of samples.
    """

def fft_library() -> str:
    """
    Library behind the transforms: "fftw" or "eigen".
    """

def resample(
    iq: numpy.typing.NDArray[numpy.complex64],
    in_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    out_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    passband: typing.SupportsFloat | typing.SupportsIndex = 0.8,
    stopband: typing.SupportsFloat | typing.SupportsIndex = 1.2,
    attenuation_db: typing.SupportsFloat | typing.SupportsIndex = 80.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    A capture at another rate.
    """
