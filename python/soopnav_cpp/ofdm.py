"""OFDM as a signal of opportunity: symbols, the cyclic-prefix correlator, blind symbol boundaries, two-ray timing.

A receiver that knows the numerology and nothing else finds where symbols start, because each begins with a copy of its
end; how that moves is how the range moves. Boundaries are known modulo a symbol, `Numerology.ambiguity_m`.

>>> import soopnav_cpp as sn
>>> link = sn.simulation.OfdmLink(movement="fractional_delay")
>>> estimator = sn.ofdm.BoundaryEstimator(method="interpolated")
>>> boundary = estimator.estimate(link.iq(321.0, seed=1))
>>> abs(boundary.boundary_m - 321.0) < 2.0
True
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import ofdm as _ofdm
from soopnav_cpp._core.ofdm import (
    Boundary,
    BoundaryEstimator,
    BoundaryStatus,
    Numerology,
    TwoRayBoundary,
    TwoRayTiming,
)

__all__ = [
    "Boundary",
    "BoundaryEstimator",
    "BoundaryStatus",
    "Numerology",
    "TwoRayBoundary",
    "TwoRayTiming",
    "correlate",
    "delay_crlb_m",
    "symbols",
]


def symbols(
    count: int,
    numerology: Numerology | None = None,
    *,
    constellation: str = "qpsk",
    seed: int,
    stream: int = 0,
) -> npt.NDArray[np.complex64]:
    """Make a string of OFDM symbols with data drawn at random, each with its cyclic prefix.

    Parameters
    ----------
    count : int
        At least 1.
    numerology : Numerology, optional
        64 subcarriers, 16 samples of prefix, 20 MHz without one.
    constellation : {"qpsk", "16qam", "64qam"}
        Of mean power 1.
    seed, stream : int
        Name the data; streams of one seed are independent.

    Returns
    -------
    ndarray, shape (count * M,), complex64
        Mean power 1.
    """
    return _ofdm.symbols(count, numerology or Numerology(), constellation=constellation, seed=seed, stream=stream)


def correlate(
    iq: npt.NDArray[np.complex64],
    numerology: Numerology | None = None,
    symbols: int = 250,
    *,
    oversampling: int = 1,
) -> npt.NDArray[np.complex128]:
    """Cyclic-prefix correlator over many symbols, crosby (2.5), counted from 0.

    ``gamma[m] = sum_k sum_{i=m}^{m+v-1} y[M k + i] conj(y[M k + i + N])``: the real part is largest where a symbol
    starts; a carrier offset f turns it by ``-2 pi f N / sample_rate_hz``.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        At least ``(symbols + 1) * M - 1`` samples.
    numerology : Numerology, optional
    symbols : int
        K.
    oversampling : int
        Multiplies M, N, v and the rate of the samples.

    Returns
    -------
    ndarray, shape (M * oversampling,), complex128

    Raises
    ------
    ValueError
        For too few samples or one that is not finite.
    """
    return _ofdm.correlate(iq, numerology or Numerology(), symbols, oversampling=oversampling)


def delay_crlb_m(
    snr_db: float, symbols: int, numerology: Numerology | None = None, *, fraction: float | None = None
) -> float:
    """Bound of a range's standard deviation from the folded pairs y(i), y(i + N) [m].

    Fisher information of the delay when the pairs are independent complex Gaussians with the correlation of a
    band-limited stream at a fractional delay.

    Parameters
    ----------
    snr_db : float
        Per sample, -60 ... 100.
    symbols : int
        K, at least 1.
    numerology : Numerology, optional
    fraction : float, optional
        Of the delay, in samples. Without one the information is averaged over all fractions.

    Returns
    -------
    float
    """
    return _ofdm.delay_crlb_m(snr_db, symbols, numerology or Numerology(), fraction=fraction)
