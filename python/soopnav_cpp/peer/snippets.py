"""Snippets in few bits: decimation, an optimal uniform quantiser, and how many bits a link can pay for.

A component of a burst at the receiver's output, signal and noise, is nearly Gaussian. The uniform quantiser of b bits
with the least squared error (Max 1960, Table II) has steps of `STEPS` [b] standard deviations and leaves the fraction
`DISTORTIONS` [b] of the power as error. Such a quantiser's output is its input times 1 - D plus what is uncorrelated
with the input, of power D (1 - D) (Bussgang; outputs are taken as centroids nearly are). Referred to the input it adds
noise of D / (1 - D) of the power of signal and noise together, spread over the sample rate:

    1 / snr_q = 1 / snr + D / (1 - D) (B / f_s + 1 / snr)        (1)

with ``snr`` the signal's to the noise's power in the band B. Phase-shift keying above the noise has no tails like a
Gaussian's: each snippet's step is fitted for the least squared error of its own components, up to 40 % below the
Gaussian's, and is sent with it; (1) is then an upper bound. The cross-ambiguity measures the SNR of both snippets from
what they are, so the covariance of its delay and Doppler has the noise of (1) in it.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

__all__ = [
    "DISTORTIONS",
    "STEPS",
    "TokenBucket",
    "bits_for",
    "choose_bits",
    "dequantise",
    "effective_snr_db",
    "quantise",
    "snippet_bytes",
]

#: Step of the optimal uniform quantiser of a unit Gaussian, by bits.
STEPS = {1: 1.5958, 2: 0.9957, 3: 0.5860, 4: 0.3352}
#: Its squared error.
DISTORTIONS = {1: 0.3634, 2: 0.1188, 3: 0.03744, 4: 0.01154}

_LIMITS_DB = ((8.0, 2), (15.0, 3))  # up to this SNR so many bits lose at most 1 dB; 4 beyond
_FACTORS = np.linspace(0.6, 1.2, 25)  # of the step
_MESSAGE_BYTES = 160  # of a snippet's frame besides its samples, at most


def bits_for(snr_db: float) -> int:
    """Bits of a component that lose at most 1 dB of TDOA and of FDOA: 2 up to 8 dB, 3 up to 15 dB, 4 beyond (to 20 dB).

    At 10 dB, 2 bits lose about 1.1 dB of TDOA and 0.3 dB of FDOA.
    """
    for limit_db, bits in _LIMITS_DB:
        if snr_db <= limit_db:
            return bits
    return 4


def effective_snr_db(snr_db: float, bits: int, *, bandwidth_hz: float = 25e3, sample_rate_hz: float = 50e3) -> float:
    """SNR of a snippet after quantisation, by (1).

    Parameters
    ----------
    snr_db : float
        In `bandwidth_hz`, before.
    bits : int
        0: not quantised.
    bandwidth_hz, sample_rate_hz : float
    """
    if bits == 0:
        return snr_db
    noise = 10.0 ** (-0.1 * snr_db)
    d = _known(bits, DISTORTIONS)
    return -10.0 * math.log10(noise + d / (1.0 - d) * (bandwidth_hz / sample_rate_hz + noise))


def _known(bits: int, table: dict[int, float]) -> float:
    if bits not in table:
        raise ValueError(f"bits = {bits}: 1 ... 4 expected")
    return table[bits]


def snippet_bytes(count: int, bits: int) -> int:
    """Bytes of the frame that carries `count` samples, at most."""
    return _MESSAGE_BYTES + (8 * count if bits == 0 else (2 * bits * count + 7) // 8)


def quantise(iq: npt.NDArray[np.complex64], bits: int, *, burst: slice | None = None) -> tuple[float, bytes]:
    """Quantise a snippet.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        n >= 1, finite.
    bits : int
        Of each component, 1 ... 4; 0 keeps the samples as they are.
    burst : slice, optional
        Where the burst is: the quantiser is scaled for it, not for the noise around it.

    Returns
    -------
    scale : float
        Step over `STEPS`: near the root mean square of a component in the burst. `bits` = 0: that.
    data : bytes
        Components in turn, I first; each `bits` bits, most significant first, without gaps; little-endian complex64
        for `bits` = 0.

    Raises
    ------
    ValueError
        For an empty snippet, samples that are not finite, other bits.
    """
    if iq.ndim != 1 or iq.size == 0:
        raise ValueError(f"iq has shape {iq.shape}: one dimension and at least one sample expected")
    parts = np.ascontiguousarray(iq, dtype=np.complex64).view(np.float32)
    if not np.isfinite(parts).all():
        raise ValueError("iq has samples that are not finite")
    inner = parts if burst is None else np.ascontiguousarray(iq[burst]).view(np.float32)
    if inner.size == 0:
        raise ValueError(f"burst = {burst}: samples of the snippet expected")
    scale = float(np.float32(np.sqrt(np.mean(np.square(inner, dtype=np.float64)))))
    if bits == 0:
        return scale, parts.astype("<f4").tobytes()
    _known(bits, STEPS)
    if scale > 0.0:
        scale = float(np.float32(scale * _fit(inner / np.float32(scale), bits)))
    step = STEPS[bits] * (scale if scale > 0.0 else 1.0)
    half = 1 << (bits - 1)
    levels = np.clip(np.floor(parts / step) + half, 0, 2 * half - 1).astype(np.uint8)
    planes = (levels[:, None] >> np.arange(bits - 1, -1, -1, dtype=np.uint8)) & 1
    return scale, np.packbits(planes.reshape(-1)).tobytes()


def _fit(parts: npt.NDArray[np.float32], bits: int) -> float:
    """By what to widen or narrow the Gaussian's step for the least squared error of these components, of unit power."""
    half = 1 << (bits - 1)
    errors = []
    for factor in _FACTORS:
        step = np.float32(STEPS[bits] * factor)
        levels = np.clip(np.floor(parts / step), -half, half - 1) + np.float32(0.5)
        errors.append(float(np.mean(np.square(parts - levels * step))))
    return float(_FACTORS[int(np.argmin(errors))])


def dequantise(data: bytes, count: int, bits: int, scale: float) -> npt.NDArray[np.complex64]:
    """Samples of `quantise`.

    Parameters
    ----------
    data : bytes
    count : int
        Complex samples.
    bits : int
    scale : float

    Returns
    -------
    ndarray, shape (count,), complex64
        Middles of the quantiser's steps. For `bits` = 0 samples that are not finite are possible.

    Raises
    ------
    ValueError
        For too few bytes, other bits, a scale that is not finite or below zero.
    """
    if not (math.isfinite(scale) and scale >= 0.0):
        raise ValueError(f"scale = {scale}: a finite number not below zero expected")
    need = 8 * count if bits == 0 else (2 * bits * count + 7) // 8
    if count < 1 or len(data) != need:
        raise ValueError(f"{len(data)} bytes for {count} samples of {bits} bits: {need} expected")
    if bits == 0:
        return np.frombuffer(data, dtype="<c8").astype(np.complex64)
    step = _known(bits, STEPS) * scale
    planes = np.unpackbits(np.frombuffer(data, np.uint8), count=2 * bits * count).reshape(-1, bits)
    levels = planes @ (1 << np.arange(bits - 1, -1, -1))
    middle = (levels - (1 << (bits - 1)) + 0.5) * step
    return middle.astype(np.float32).view(np.complex64)


class TokenBucket:
    """What may be sent: `rate_bps` bits a second, saved up for `depth_s` seconds at most.

    Time is the recording's, so that what is sent does not depend on how fast a file is read.

    Parameters
    ----------
    rate_bps : float
        Above zero; infinity: no limit.
    depth_s : float
    """

    def __init__(self, rate_bps: float, *, depth_s: float = 4.0) -> None:
        if not rate_bps > 0.0:
            raise ValueError(f"bandwidth = {rate_bps:g} bit/s: a number above zero expected")
        if not (math.isfinite(depth_s) and depth_s > 0.0):
            raise ValueError(f"depth_s = {depth_s:g}: a finite number above zero expected")
        self._rate = rate_bps
        self._depth = rate_bps * depth_s
        self._bits = self._depth
        self._at_s: float | None = None

    def advance(self, t_s: float) -> None:
        """Earn what the time up to `t_s` is worth; time does not run backwards."""
        if self._at_s is None or t_s > self._at_s:
            if self._at_s is not None:
                self._bits = min(self._depth, self._bits + self._rate * (t_s - self._at_s))
            self._at_s = t_s

    def has(self, n_bytes: int) -> bool:
        """Whether `n_bytes` can be paid for."""
        return 8.0 * n_bytes <= self._bits

    def pay(self, n_bytes: int) -> None:
        """Spend; what `has` refuses must not be paid."""
        self._bits -= 8.0 * n_bytes


def choose_bits(snr_db: float, count: int, bucket: TokenBucket) -> int | None:
    """Bits that `bits_for` asks for, or as many as can be paid for; None when one bit is too dear."""
    for bits in range(bits_for(snr_db), 0, -1):
        if bucket.has(snippet_bytes(count, bits)):
            return bits
    return None
