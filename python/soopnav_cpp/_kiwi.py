"""Recordings of KiwiSDR receivers: WAV files with GNSS time tags."""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = ["KiwiRecording", "read_kiwi", "write_kiwi"]

_MOST_BYTES = 1 << 31
_LEAST_TAGS = 3
_RATE_TOLERANCE = 1e-3  # of the nominal rate
_LEAST_RESIDUAL_S = 1e-6  # a tag this near the line is never refused
_WEEK_S = 604_800.0


@dataclass(frozen=True, eq=False)
class KiwiRecording:
    """A recording with the time of its samples.

    Attributes
    ----------
    path : Path
    iq : ndarray, shape (n,), complex64
        Full scale 1.0.
    sample_rate_hz : float
        From the tags.
    start_s : float
        GPS time of the week of sample 0: sample n was taken at ``start_s + n / sample_rate_hz``.
    nominal_rate_hz : float
        As the file's header says.
    residual_s : float
        Root mean square of the tags kept about their line.
    tags, refused_tags : int
        In the file; of them not kept: zero, no time of a week, or away from the line.
    """

    path: Path
    iq: npt.NDArray[np.complex64]
    sample_rate_hz: float
    start_s: float
    nominal_rate_hz: float
    residual_s: float
    tags: int
    refused_tags: int

    @property
    def duration_s(self) -> float:
        """Samples over rate."""
        return self.iq.size / self.sample_rate_hz

    def __repr__(self) -> str:
        return (
            f"KiwiRecording({self.path.name}: {self.duration_s:.2f} s at {self.sample_rate_hz:.3f} Hz from GPS second "
            f"{self.start_s:.6f}, {self.refused_tags} of {self.tags} tags refused, "
            f"the others within {self.residual_s * 1e6:.2f} µs)"
        )


def _chunks(content: bytes, path: Path) -> list[tuple[bytes, int, int]]:
    """Name, start and size of the chunks of a RIFF file."""
    if len(content) < 12 or content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        raise ValueError(f"{path}: no RIFF/WAVE header; a KiwiSDR recording (WAV) expected")
    found = []
    at = 12
    while at + 8 <= len(content):
        name, size = content[at : at + 4], int.from_bytes(content[at + 4 : at + 8], "little")
        if at + 8 + size > len(content):
            left = len(content) - at - 8
            raise ValueError(
                f"{path}: chunk {name.decode('latin-1')!r} at byte {at} has {size} bytes, {left} are left; truncated?"
            )
        found.append((name, at + 8, size))
        at += 8 + size + size % 2
    return found


def _line(
    sample: npt.NDArray[np.float64], time_s: npt.NDArray[np.float64], nominal_rate_hz: float
) -> tuple[float, float, npt.NDArray[np.bool_]]:
    """Rate, time of sample 0 and which tags belong: medians first, then least squares on what lies near the line."""
    # A stale tag is wrong by seconds: the commonest time of sample 0 by the nominal rate (it drifts by tens of
    # microseconds a second) tells the right ones, whatever the others say.
    guess = time_s - sample / nominal_rate_hz
    spread_s = 1e-4 + _RATE_TOLERANCE * float(np.ptp(sample)) / nominal_rate_hz
    ordered = np.sort(guess)
    count = np.searchsorted(ordered, ordered + spread_s, side="right") - np.arange(ordered.size)
    low = ordered[int(np.argmax(count))]
    kept = (guess >= low) & (guess <= low + spread_s)
    if np.count_nonzero(kept) < _LEAST_TAGS:
        return math.nan, math.nan, kept
    # Medians of slopes and offsets (Theil and Sen, over pairs half the record apart), robust within that.
    n, t = sample[kept], time_s[kept] - low
    half = max(n.size // 2, 1)
    period = float(np.median((t[half:] - t[:-half]) / (n[half:] - n[:-half])))
    offset = float(np.median(t - period * n))
    within = np.abs(time_s - low - offset - period * sample)
    limit = max(_LEAST_RESIDUAL_S, 6.0 * 1.4826 * float(np.median(within[kept])))
    kept &= within <= limit
    if np.count_nonzero(kept) < _LEAST_TAGS:
        return math.nan, math.nan, kept
    n, t = sample[kept], time_s[kept] - low
    middle = n.mean()
    period = float(np.dot(n - middle, t) / np.dot(n - middle, n - middle))
    return 1.0 / period, low + float(t.mean()) - period * float(middle), kept


def read_kiwi(path: str | os.PathLike[str]) -> KiwiRecording:
    """Read a KiwiSDR recording: 16-bit I and Q in a WAV file, a chunk ``kiwi`` with a GNSS time before each block.

    A tag says when the first sample of the block behind it was taken, in seconds and nanoseconds of the GPS week. The
    first is zero as a rule, others may be stale: those that belong to one line, sample number against time, are found
    by the commonest time of sample 0, medians and then least squares; the line gives sampling rate and start.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    KiwiRecording

    Raises
    ------
    ValueError
        Naming the file: not a WAV file, truncated, not 16-bit I and Q, no samples, no tags, tags that no line fits or
        that put the rate more than 0.1 % off its nominal value.
    OSError
        When the file cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path}: {path.stat().st_size} bytes; at most {_MOST_BYTES} are read")
    content = path.read_bytes()
    nominal_rate_hz = 0.0
    blocks: list[npt.NDArray[np.int16]] = []
    tag_sample, tag_time = [], []
    samples = 0
    zero = 0
    for name, at, size in _chunks(content, path):
        if name == b"fmt ":
            if size < 16:
                raise ValueError(f"{path}: chunk 'fmt ' of {size} bytes; at least 16 expected")
            code, channels, rate, _, _, bits = struct.unpack_from("<HHIIHH", content, at)
            if (code, channels, bits) != (1, 2, 16):
                raise ValueError(
                    f"{path}: format {code} with {channels} channels of {bits} bits; I and Q of 16 bits (PCM) expected"
                )
            if rate == 0:
                raise ValueError(f"{path}: a sampling rate of 0")
            nominal_rate_hz = float(rate)
        elif name == b"kiwi":
            if size < 10:
                raise ValueError(f"{path}: chunk 'kiwi' at byte {at - 8} has {size} bytes; 10 expected")
            seconds, nanoseconds = struct.unpack_from("<II", content, at + 2)
            if (seconds == 0 and nanoseconds == 0) or seconds >= _WEEK_S or nanoseconds >= 1_000_000_000:
                zero += 1
                continue
            tag_sample.append(samples)
            tag_time.append(seconds + 1e-9 * nanoseconds)
        elif name == b"data":
            if nominal_rate_hz == 0.0:
                raise ValueError(f"{path}: chunk 'data' before 'fmt '")
            if size % 4:
                raise ValueError(f"{path}: {size} bytes of samples at byte {at}; a multiple of 4 expected")
            blocks.append(np.frombuffer(content, dtype="<i2", count=size // 2, offset=at))
            samples += size // 4
    if samples == 0:
        raise ValueError(f"{path}: no samples")
    tags = len(tag_time) + zero
    if len(tag_time) < _LEAST_TAGS:
        raise ValueError(f"{path}: {len(tag_time)} usable GNSS time tags of {tags}; at least {_LEAST_TAGS} are needed")
    time_s = np.array(tag_time)
    time_s[time_s < time_s.max() - 0.5 * _WEEK_S] += _WEEK_S  # across the end of a week
    rate_hz, start_s, kept = _line(np.array(tag_sample, dtype=np.float64), time_s, nominal_rate_hz)
    good = int(np.count_nonzero(kept))
    if not math.isfinite(rate_hz) or 2 * good < len(tag_time) or abs(rate_hz / nominal_rate_hz - 1.0) > _RATE_TOLERANCE:
        raise ValueError(f"{path}: no line fits the GNSS time tags ({good} of {tags} agree)")
    residual = (time_s - start_s - np.array(tag_sample) / rate_hz)[kept]
    iq = np.concatenate(blocks).astype(np.float32)
    iq *= np.float32(1.0 / 32768.0)
    return KiwiRecording(
        path,
        iq.view(np.complex64),
        rate_hz,
        start_s % _WEEK_S,
        nominal_rate_hz,
        float(np.sqrt(np.mean(residual**2))),
        tags,
        tags - good,
    )


def write_kiwi(
    path: str | os.PathLike[str],
    iq: npt.NDArray[np.complex64],
    *,
    sample_rate_hz: float,
    start_s: float,
    nominal_rate_hz: int = 12_001,
    tag_errors_s: npt.ArrayLike = 0.0,
) -> None:
    """Write a recording as a KiwiSDR does: for simulations and tests.

    Parameters
    ----------
    path : path-like
    iq : ndarray, shape (n,), complex64
        Full scale 1.0; rounded to 16 bits and clipped. Whole blocks of 512 samples are written, what is left is not.
    sample_rate_hz, start_s : float
        What the tags say: block k begins at ``start_s + 512 k / sample_rate_hz``, GPS time of the week.
    nominal_rate_hz : int
        What the header says.
    tag_errors_s : array_like
        Added to the tags, one number or one for each block. The first block's tag is zero, as the receivers write it.

    Raises
    ------
    ValueError
        For samples that are not one dimension of complex64, fewer than 512 of them, numbers not finite.
    """
    if not (isinstance(iq, np.ndarray) and iq.dtype == np.complex64 and iq.ndim == 1 and iq.size >= 512):
        raise ValueError(f"iq: expected complex64 (n,), n >= 512, got {getattr(iq, 'dtype', type(iq))} {np.shape(iq)}")
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0 and math.isfinite(start_s)):
        raise ValueError(f"sample_rate_hz = {sample_rate_hz:g}, start_s = {start_s:g}: finite, a rate above 0 expected")
    blocks = iq.size // 512
    times = start_s + 512.0 * np.arange(blocks) / sample_rate_hz + np.broadcast_to(tag_errors_s, (blocks,))
    if not np.all(np.isfinite(times)):
        raise ValueError("tag_errors_s: finite numbers expected")
    parts = np.ascontiguousarray(iq[: 512 * blocks]).view(np.float32).astype(np.float64)
    levels = np.clip(np.rint(32768.0 * parts), -32768, 32767).astype("<i2").reshape(blocks, 1024)
    out = bytearray(b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 2, nominal_rate_hz, 4 * nominal_rate_hz, 4, 16))
    for k in range(blocks):
        nanoseconds = 0 if k == 0 else round((times[k] % _WEEK_S) * 1e9)
        out += b"kiwi" + struct.pack("<IBBII", 10, 0, 0, *divmod(nanoseconds, 1_000_000_000))
        out += b"data" + struct.pack("<I", 2048) + levels[k].tobytes()
    Path(path).write_bytes(b"RIFF" + struct.pack("<I", len(out)) + bytes(out))
