"""Snippets in few bits: decimation, an optimal uniform quantiser, and how many bits a link can pay for.

A component of a burst at the receiver's output, signal and noise, is nearly Gaussian. The uniform quantiser of b bits
with the least squared error (Max 1960, Table II) has steps of `STEPS` [b] standard deviations and leaves the fraction
`DISTORTIONS` [b] of the power as error. Phase-shift keying above the noise has no tails like a Gaussian's: each
snippet's step is fitted for the least squared error of its own components, up to 40 % below the Gaussian's, and is sent
with it.

A burst of 25 ksym/s fills 35 of the 50 kHz of a snippet, and noise of quantisation beyond costs nothing. So the levels
q_n are not those nearest to the samples x_n: they minimise the error in the band,

    sum_nm (x_n - q_n) r_(n-m) (x_m - q_m),   r the autocorrelation of a filter that passes the band      (1)

(noise shaping; Gerzon and Craven 1989). Each sample in turn takes the level nearest to x_n + sum_(k != 0) r_k e_(n-k),
e = x - q, r_0 = 1, which never raises (1); samples further apart than r is long do not see each other, so that each
ninth is done at once. r is even: unlike a causal feedback of errors this delays no frequency. In the band the noise
falls by 2.4 dB with 2 bits. Relative to the power of signal and noise, it has the density

    Q = w Q_signal + (1 - w) Q_noise,    w = snr / (snr + f_s / B)                                         (2)

with ``snr`` the signal's to the noise's power in the band B, w the share of the signal in the power, and `IN_BAND` [b]
the two densities, measured. Referred to the input (Bussgang) the snippet has

    1 / snr_q = 1 / snr + Q (B / f_s + 1 / snr).                                                           (3)

The cross-ambiguity measures the SNR of both snippets from what they are, so the covariance of its delay and Doppler has
the noise of (3) in it.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

__all__ = [
    "DISTORTIONS",
    "IN_BAND",
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

#: Density of the noise in the band, of signal and of noise, over that of what is quantised: (2).
IN_BAND = {1: (0.21, 0.36), 2: (0.036, 0.075), 3: (0.008, 0.0205), 4: (0.002, 0.0063)}

_LIMITS_DB = ((10.0, 2), (15.0, 3))  # up to this SNR so many bits lose at most 1 dB; 4 beyond
_TAPS = 8  # of r, to either side
_SWEEPS = 3
_OUTSIDE = 0.03  # of (1)'s weight: the noise beyond the band stays within reason
_FACTORS = np.linspace(0.6, 1.2, 25)  # of the step
_MESSAGE_BYTES = 160  # of a snippet's frame besides its samples, at most


def bits_for(snr_db: float) -> int:
    """Bits that lose at most 1 dB of TDOA and of FDOA: 2 up to 10 dB, 3 up to 15 dB, 4 beyond (to 20 dB)."""
    for limit_db, bits in _LIMITS_DB:
        if snr_db <= limit_db:
            return bits
    return 4


def effective_snr_db(snr_db: float, bits: int, *, bandwidth_hz: float = 25e3, sample_rate_hz: float = 50e3) -> float:
    """SNR of a snippet after quantisation with the noise moved out of its band, by (2) and (3).

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
    if bits not in IN_BAND:
        raise ValueError(f"bits = {bits}: 1 ... 4 expected")
    noise = 10.0 ** (-0.1 * snr_db)
    of_signal, of_noise = IN_BAND[bits]
    share = 1.0 / (1.0 + noise * sample_rate_hz / bandwidth_hz)
    density = share * of_signal + (1.0 - share) * of_noise
    return -10.0 * math.log10(noise + density * (bandwidth_hz / sample_rate_hz + noise))


def _known(bits: int, table: dict[int, float]) -> float:
    if bits not in table:
        raise ValueError(f"bits = {bits}: 1 ... 4 expected")
    return table[bits]


def snippet_bytes(count: int, bits: int) -> int:
    """Bytes of the frame that carries `count` samples, at most."""
    return _MESSAGE_BYTES + (8 * count if bits == 0 else (2 * bits * count + 7) // 8)


def quantise(
    iq: npt.NDArray[np.complex64], bits: int, *, burst: slice | None = None, band: float = 0.0
) -> tuple[float, bytes]:
    """Quantise a snippet.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
        n >= 1, finite.
    bits : int
        Of each component, 1 ... 4; 0 keeps the samples as they are.
    burst : slice, optional
        Where the burst is: the quantiser is scaled for it, not for the noise around it.
    band : float
        Of the signal about 0 Hz, over the sample rate: the noise is moved out of it by (1), in about 3 ms for 4750
        samples. 0, and above 0.9, where there is no room: every sample takes its nearest level.

    Returns
    -------
    scale : float
        Step over `STEPS`: near the root mean square of a component in the burst, or below. `bits` = 0: that.
    data : bytes
        Components in turn, I first; each `bits` bits, most significant first, without gaps; little-endian complex64
        for `bits` = 0.

    Raises
    ------
    ValueError
        For an empty snippet, samples that are not finite, other bits, a band that is no share.
    """
    if not 0.0 <= band <= 1.0:
        raise ValueError(f"band = {band:g}: 0 ... 1 expected")
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
    if 0.0 < band <= 0.9 and scale > 0.0:
        chosen, step = _shaped(parts.astype(np.float64).reshape(-1, 2).T, step, half, burst or slice(None), band)
        scale = float(np.float32(step / STEPS[bits]))
        levels = (chosen.T.reshape(-1) + half).astype(np.uint8)
    else:
        levels = np.clip(np.floor(parts / step) + half, 0, 2 * half - 1).astype(np.uint8)
    planes = (levels[:, None] >> np.arange(bits - 1, -1, -1, dtype=np.uint8)) & 1
    return scale, np.packbits(planes.reshape(-1)).tobytes()


@functools.cache
def _weight(band: float) -> tuple[float, ...]:
    """r_1 ... r_`_TAPS` of (1)."""
    f = np.fft.fftfreq(1024)
    r = np.fft.ifft(np.where(np.abs(f) <= 0.5 * band, 1.0, _OUTSIDE)).real
    k = np.arange(1, _TAPS + 1)
    return tuple((r[k] / r[0] * (0.5 + 0.5 * np.cos(np.pi * k / (_TAPS + 1)))).tolist())


def _shaped(
    x: npt.NDArray[np.float64], step: float, half: int, burst: slice, band: float
) -> tuple[npt.NDArray[np.float64], float]:
    """Lower edges of the levels that minimise (1), in steps, and the step that fits them best.

    No product of matrices: those may depend on the number of threads in their last bit.
    """
    n, stride, r = x.shape[1], _TAPS + 1, _weight(band)

    def others(of: npt.NDArray[np.float64], first: int, every: int) -> npt.NDArray[np.float64]:
        """Sum over r_k, k != 0; `of` has `_TAPS` more at either end."""
        at = _TAPS + first
        total = np.zeros_like(of[:, at : _TAPS + n : every])
        for k, weight in enumerate(r, start=1):
            total += weight * (of[:, at - k : _TAPS + n - k : every] + of[:, at + k : _TAPS + n + k : every])
        return total

    edges = np.clip(np.floor(x / step), -half, half - 1)
    error, level = np.zeros((2, n + 2 * _TAPS)), np.zeros((2, n + 2 * _TAPS))
    inside = slice(_TAPS, _TAPS + n)
    for _ in range(_SWEEPS):
        error[:, inside] = x - step * (edges + 0.5)
        for first in range(min(stride, n)):
            wanted = x[:, first::stride] + others(error, first, stride)
            edges[:, first::stride] = np.clip(np.floor(wanted / step), -half, half - 1)
            error[:, inside][:, first::stride] = x[:, first::stride] - step * (edges[:, first::stride] + 0.5)
        level[:, inside] = edges + 0.5
        seen = (level[:, inside] + others(level, 0, 1))[:, burst]
        best = float(np.sum(x[:, burst] * seen)) / float(np.sum(level[:, inside][:, burst] * seen))
        if math.isfinite(best) and 0.5 * step < best < 2.0 * step:
            step = best
    return edges, step


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
