"""Where a receiver's samples come from: a recording, or samples that are arriving. Both look the same.

Times are readings of the receiver's own clock: seconds since `reference_unix_s`, a whole second of UTC. Samples that
are not finite become zero and are counted; a gap between the segments of a recording begins a new stretch.
"""

from __future__ import annotations

import math
import os
import queue
import stat
import threading
import time
from collections import deque
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
import numpy.typing as npt

from soopnav_cpp.peer.layout import raw_layout, recording_layout

__all__ = ["FAR_FUTURE_S", "Block", "LiveSource", "Recording", "Source", "instant", "iso", "open_source"]

Iq = npt.NDArray[np.complex64]
FAR_FUTURE_S = 1e10  # end of a source that has none
_LEAST_BLOCK_S = 0.01
_MOST_ARRIVED = 64  # blocks that wait to be read


def instant(text: str, where: str) -> tuple[int, float]:
    """Whole seconds since 1970 and the rest of an ISO 8601 time in UTC, to all its digits.

    Raises
    ------
    ValueError
        For anything else; `where` begins the sentence.
    """
    refusal = ValueError(f"{where}: {text!r}; a UTC time such as 2014-08-27T12:00:00.25Z expected")
    plain = text.strip().removesuffix("Z").removesuffix("+00:00")
    whole, dot, fraction = plain.partition(".")
    if dot and not (fraction.isascii() and fraction.isdigit()):
        raise refusal
    try:
        at = datetime.fromisoformat(whole)
    except ValueError:
        raise refusal from None
    if at.tzinfo is not None:
        raise refusal
    return round(at.replace(tzinfo=timezone.utc).timestamp()), float(f"0.{fraction or 0}")


def iso(reference_unix_s: int, t_s: float) -> str:
    """``2014-08-27T12:00:00.250Z``; ``open`` for a time that never comes."""
    if t_s >= FAR_FUTURE_S:
        return "open"
    milliseconds = round(1e3 * t_s)
    try:
        at = datetime.fromtimestamp(reference_unix_s + milliseconds // 1000, timezone.utc)
    except (ValueError, OverflowError, OSError):  # no year that a calendar has
        return f"{reference_unix_s + t_s:g} s"
    return f"{at:%Y-%m-%dT%H:%M:%S}.{milliseconds % 1000:03d}Z"


@dataclass(frozen=True)
class Block:
    """Samples that follow each other.

    Attributes
    ----------
    iq : ndarray, shape (n,), complex64
        Finite.
    start_s : float
        Reading of the clock at the first sample.
    continues : bool
        No gap lies between it and the block before.
    """

    iq: Iq
    start_s: float
    continues: bool


class Source(Protocol):
    """What `Recording` and `LiveSource` are.

    Attributes
    ----------
    name : str
    sample_rate_hz, center_frequency_hz : float
    reference_unix_s : int
    start_s, end_s : float
        Of what can be read; `FAR_FUTURE_S` when there is no end.
    not_finite : int
        Samples set to zero so far.
    """

    name: str
    sample_rate_hz: float
    center_frequency_hz: float
    reference_unix_s: int
    start_s: float
    end_s: float
    not_finite: int

    @property
    def live(self) -> bool:
        """Whether samples come when they come."""
        ...

    @property
    def ready(self) -> bool:
        """Whether `block` need not wait."""
        ...

    def block(self) -> Block | None:
        """The next samples; None at the end. Waits for samples of a live source."""
        ...

    def seek(self, t_s: float) -> None:
        """Go on from `t_s`; a live source cannot, and goes on as before."""
        ...

    def cut(self, start_s: float, count: int) -> tuple[float, Iq] | None:
        """`count` samples from the one nearest to `start_s`, with its time; None when not all are there (any more)."""
        ...


def _check_block(block_s: float) -> None:
    if not (math.isfinite(block_s) and block_s >= _LEAST_BLOCK_S):
        raise ValueError(f"block_s = {block_s:g}: at least {_LEAST_BLOCK_S:g} s expected")


def _finite(iq: Iq) -> tuple[Iq, int]:
    """Samples with zeros for what is not finite, and how many."""
    parts = iq.view(np.float32)
    if np.isfinite(parts.sum(dtype=np.float64)):
        return iq, 0
    bad = ~np.isfinite(iq)
    return np.where(bad, np.complex64(0), iq), int(np.count_nonzero(bad))


@dataclass(frozen=True)
class _Segment:
    first: int  # sample
    end: int
    offset: int  # byte of the first sample
    start_s: float


class Recording:
    """A SigMF recording, or a raw file, read in blocks through a memory map.

    Parameters
    ----------
    path : path
        The ``.sigmf-meta`` or ``.sigmf-data`` file or their stem; or a raw file with `sample_rate_hz` and `start`.
    sample_rate_hz : float, optional
    format : str, optional
        Of a raw file, one of `soopnav_cpp.io.RAW_FORMATS`.
    start : str, optional
        UTC of the first sample, in place of ``core:datetime``.
    center_frequency_hz : float, optional
        In place of ``core:frequency``.
    block_s : float
        Length of a block.
    realtime : bool
        A block is `ready` no sooner than it would be on the air, counted from the first block.

    Raises
    ------
    ValueError
        For an empty or truncated file, one without a time or a frequency, and what `io.read_iq` refuses.
    """

    live = False

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        sample_rate_hz: float | None = None,
        format: str | None = None,
        start: str | None = None,
        center_frequency_hz: float | None = None,
        block_s: float = 0.25,
        realtime: bool = False,
    ) -> None:
        _check_block(block_s)
        given = Path(path)
        self.name = str(given)
        self.not_finite = 0
        layout = recording_layout(given, sample_rate_hz=sample_rate_hz, format=format)
        self.sample_rate_hz = layout.sample_rate_hz
        when = start if start is not None else layout.parts[0].when
        if when is None:
            raise ValueError(f"{self.name}: no core:datetime; the UTC time of the first sample is needed (--start)")
        frequency = center_frequency_hz if center_frequency_hz is not None else layout.center_frequency_hz
        if frequency is None:
            raise ValueError(f"{self.name}: no core:frequency; the frequency it is tuned to is needed (--frequency)")
        self.center_frequency_hz = frequency
        self.reference_unix_s, _ = instant(when, f"{self.name}: core:datetime")
        self._layout = layout
        self._segments = self._timed(when)
        self.start_s = self._segments[0].start_s
        last = self._segments[-1]
        self.end_s = last.start_s + (last.end - last.first) / self.sample_rate_hz
        self._map = np.memmap(layout.data, dtype=np.uint8, mode="r")
        self._block = max(1, round(block_s * self.sample_rate_hz))
        self._segment, self._sample, self._continues = 0, self._segments[0].first, False
        self._realtime = realtime
        self._began: tuple[float, float] | None = None  # what time it was at which time of the recording

    def _timed(self, first_when: str) -> list[_Segment]:
        segments: list[_Segment] = []
        for part in self._layout.parts:
            when = part.when if segments else first_when
            ends_s = -math.inf
            if segments:
                before = segments[-1]
                ends_s = before.start_s + (part.first - before.first) / self.sample_rate_hz
            if when is None:
                start_s = ends_s
            else:
                unix, fraction = instant(when, f"{self.name}: core:datetime")
                start_s = (unix - self.reference_unix_s) + fraction
            if start_s < ends_s - 1.0 / self.sample_rate_hz:
                raise ValueError(
                    f"{self.name}: the segment at sample {part.first} begins before the one before it ends"
                )
            segments.append(_Segment(part.first, part.end, part.offset, start_s))
        return segments

    def _samples(self, segment: _Segment, first: int, count: int) -> Iq:
        size = self._layout.sample_bytes
        at = segment.offset + (first - segment.first) * size
        iq, bad = _finite(self._layout.decode(self._map[at : at + count * size]))
        self.not_finite += bad
        return iq

    @property
    def ready(self) -> bool:
        """Always, unless in real time."""
        if not self._realtime or self._segment >= len(self._segments):
            return True
        segment = self._segments[self._segment]
        t_s = segment.start_s + (self._sample - segment.first) / self.sample_rate_hz
        now = time.monotonic()
        if self._began is None or t_s < self._began[1]:
            self._began = (now, t_s)
        return now - self._began[0] >= t_s - self._began[1] + self._block / self.sample_rate_hz

    def block(self) -> Block | None:
        """The next `block_s` seconds, fewer at the end of a segment."""
        while self._segment < len(self._segments) and self._sample >= self._segments[self._segment].end:
            self._segment += 1
            self._continues = False
            if self._segment < len(self._segments):
                self._sample = self._segments[self._segment].first
        if self._segment >= len(self._segments):
            return None
        segment = self._segments[self._segment]
        count = min(self._block, segment.end - self._sample)
        block = Block(
            self._samples(segment, self._sample, count),
            segment.start_s + (self._sample - segment.first) / self.sample_rate_hz,
            self._continues,
        )
        self._sample += count
        self._continues = True
        return block

    def seek(self, t_s: float) -> None:
        """Go on from the sample at or after `t_s`; from the end when `t_s` lies behind it."""
        self._continues = False
        for number, segment in enumerate(self._segments):
            ahead = math.ceil((t_s - segment.start_s) * self.sample_rate_hz - 1e-6)
            if segment.first + ahead < segment.end:
                self._segment, self._sample = number, segment.first + max(ahead, 0)
                return
        self._segment, self._sample = len(self._segments), self._segments[-1].end

    def cut(self, start_s: float, count: int) -> tuple[float, Iq] | None:
        """Any samples of one segment."""
        for segment in self._segments:
            ahead = round((start_s - segment.start_s) * self.sample_rate_hz)
            if ahead >= 0 and segment.first + ahead + count <= segment.end:
                at = segment.first + ahead
                return segment.start_s + ahead / self.sample_rate_hz, self._samples(segment, at, count)
        return None


class LiveSource:
    """Raw samples from standard input, a FIFO, or any binary stream; the last `keep_s` seconds can be cut.

    Parameters
    ----------
    stream : binary file
        Blocking.
    name : str
    sample_rate_hz, center_frequency_hz : float
    format : str
        One of `soopnav_cpp.io.RAW_FORMATS`.
    start : str
        UTC of the first sample, by the receiver's clock.
    block_s, keep_s : float
    """

    live = True

    def __init__(
        self,
        stream: BinaryIO,
        *,
        name: str,
        sample_rate_hz: float,
        center_frequency_hz: float,
        format: str,
        start: str,
        block_s: float = 0.25,
        keep_s: float = 20.0,
    ) -> None:
        _check_block(block_s)
        if not (math.isfinite(keep_s) and keep_s >= block_s):
            raise ValueError(f"keep_s = {keep_s:g}: at least block_s = {block_s:g} expected")
        self.name = name
        self.not_finite = 0
        self._layout = raw_layout(name, sample_rate_hz=sample_rate_hz, format=format)
        self.sample_rate_hz = self._layout.sample_rate_hz
        self.center_frequency_hz = center_frequency_hz
        self.reference_unix_s, self.start_s = instant(start, "start")
        self.end_s = FAR_FUTURE_S
        self._stream = stream
        self._count = max(1, round(block_s * self.sample_rate_hz))
        self._kept: deque[tuple[int, Iq]] = deque(maxlen=max(1, math.ceil(keep_s / block_s)))
        self._read = 0
        self._arrived: queue.Queue[bytes] = queue.Queue(maxsize=_MOST_ARRIVED)
        self._ended = False
        threading.Thread(target=self._listen, name="samples", daemon=True).start()

    def _listen(self) -> None:
        want = self._count * self._layout.sample_bytes
        while True:
            missing, parts = want, []
            try:
                while missing > 0 and (data := self._stream.read(missing)):
                    parts.append(data)
                    missing -= len(data)
            except (OSError, ValueError):  # the other end went, or the stream was closed
                missing = want
            self._arrived.put(b"".join(parts))  # waits, and with it whoever writes
            if missing > 0:
                self._arrived.put(b"")
                return

    @property
    def ready(self) -> bool:
        """Whether a block has arrived."""
        return self._ended or not self._arrived.empty()

    def block(self) -> Block | None:
        """The next `block_s` seconds, fewer at the end of the stream; part of a sample there is dropped."""
        data = b"" if self._ended else self._arrived.get()
        size = self._layout.sample_bytes
        raw = np.frombuffer(data, np.uint8)[: len(data) // size * size]
        if raw.size == 0:
            self._ended = True
            return None
        iq, bad = _finite(self._layout.decode(raw))
        self.not_finite += bad
        block = Block(iq, self.start_s + self._read / self.sample_rate_hz, self._read > 0)
        self._kept.append((self._read, iq))
        self._read += iq.size
        return block

    def seek(self, t_s: float) -> None:
        """Samples that come cannot be waited for twice: nothing happens."""

    def cut(self, start_s: float, count: int) -> tuple[float, Iq] | None:
        """Samples that are still kept."""
        first = round((start_s - self.start_s) * self.sample_rate_hz)
        if not self._kept or first < self._kept[0][0] or first + count > self._read:
            return None
        parts = [
            iq[max(first - at, 0) : first + count - at]
            for at, iq in self._kept
            if at < first + count and at + iq.size > first
        ]
        return self.start_s + first / self.sample_rate_hz, np.concatenate(parts)


def open_source(
    what: str,
    *,
    sample_rate_hz: float | None = None,
    format: str | None = None,
    start: str | None = None,
    center_frequency_hz: float | None = None,
    stdin: BinaryIO | None = None,
    realtime: bool = False,
) -> Source:
    """A recording by its path; samples that arrive from a FIFO by its path, or from standard input by ``-``.

    Raises
    ------
    ValueError
        As `Recording`; for a live source without rate, format, start and frequency.
    FileNotFoundError
    """
    fifo = what != "-" and Path(what).exists() and stat.S_ISFIFO(Path(what).stat().st_mode)
    if what != "-" and not fifo:
        return Recording(
            what,
            sample_rate_hz=sample_rate_hz,
            format=format,
            start=start,
            center_frequency_hz=center_frequency_hz,
            realtime=realtime,
        )
    if sample_rate_hz is None or format is None or start is None or center_frequency_hz is None:
        raise ValueError(f"{what}: samples that arrive need --rate, --format, --start and --frequency")
    if what == "-" and stdin is None:
        raise ValueError("-: standard input is not there")
    stream = stdin if what == "-" and stdin is not None else Path(what).open("rb")  # noqa: SIM115  (lives on)
    return LiveSource(
        stream, name=what, sample_rate_hz=sample_rate_hz, center_frequency_hz=center_frequency_hz, format=format,
        start=start,
    )  # fmt: skip
