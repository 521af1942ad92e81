"""Step one: bursts in a source's samples as they come, and pieces of them at the rate of snippets."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp
from soopnav_cpp.iridium import BurstDetector, SignalClass
from soopnav_cpp.peer.sources import FAR_FUTURE_S, Source

__all__ = ["Heard", "Scanner", "cut_snippet", "decimation"]

_REPORTED_S = 0.1  # after a burst's end, by which it has been reported
_EDGE = 128  # samples of a snippet lost to the decimating filter, at either end


@dataclass(frozen=True)
class Heard:
    """A burst in one's own recording; times by one's own clock, since the source's reference."""

    start_s: float
    duration_s: float
    frequency_hz: float
    sigma_hz: float
    bandwidth_hz: float
    snr_db: float


class Scanner:
    """Bursts of a source in the order of their starts.

    What is found depends neither on when it is asked for nor on what is done with it.

    Parameters
    ----------
    source : Source
    max_burst_s : float
    counts : Counter
        ``scanned`` bursts, and what was no burst: ``tone``, ``continuous``, ``cut off``.

    Attributes
    ----------
    heard_to_s : float
        All bursts that start before have been returned.
    done : bool
        The source has ended.
    """

    def __init__(self, source: Source, counts: Counter[str], *, max_burst_s: float = 0.1) -> None:
        self._source, self._counts, self._max_burst_s = source, counts, max_burst_s
        self._detector: BurstDetector | None = None
        self._began_s = source.start_s
        self._found: list[Heard] = []
        self.heard_to_s = source.start_s
        self.done = False
        self._fresh()

    def _fresh(self) -> None:
        self._detector = BurstDetector(
            self._source.sample_rate_hz,
            center_frequency_hz=self._source.center_frequency_hz,
            max_burst_s=self._max_burst_s,
        )

    def seek(self, t_s: float) -> None:
        """Go on from `t_s`; a live source goes on as before."""
        if self._source.live:
            return
        self._source.seek(t_s)
        self._found.clear()
        self._fresh()
        self.heard_to_s = max(t_s, self._source.start_s)
        self.done = False

    def step(self) -> list[Heard] | None:
        """Bursts that are known after another block; None when there is no block (yet)."""
        if self.done or not self._source.ready:
            return None
        assert self._detector is not None
        block = self._source.block()
        if block is None:
            self._take(self._detector.flush())
            self.done = True
            self.heard_to_s = FAR_FUTURE_S
        else:
            if not block.continues:
                self._take(self._detector.flush())
                self._fresh()
                self._began_s = block.start_s
            self._take(self._detector.push(block.iq))
            end_s = block.start_s + block.iq.size / self._source.sample_rate_hz
            self.heard_to_s = max(self.heard_to_s, end_s - self._max_burst_s - _REPORTED_S)
        self._found.sort(key=lambda heard: (heard.start_s, heard.frequency_hz))
        known = sum(heard.start_s < self.heard_to_s for heard in self._found)
        out, self._found = self._found[:known], self._found[known:]
        return out

    def _take(self, signals: object) -> None:
        for signal in signals:  # type: ignore[attr-defined]
            if signal.kind is not SignalClass.BURST:
                self._counts[signal.kind.name.lower()] += 1
            elif signal.cut_start or signal.cut_end:
                self._counts["cut off"] += 1
            else:
                self._counts["scanned"] += 1
                self._found.append(
                    Heard(
                        self._began_s + signal.start_s,
                        signal.duration_s,
                        signal.frequency_hz,
                        signal.frequency_sigma_hz,
                        signal.bandwidth_hz,
                        signal.snr_db,
                    )
                )


def decimation(source: Source, snippet_rate_hz: float) -> int:
    """Samples of the source for one of a snippet.

    Raises
    ------
    ValueError
        When that is no whole number.
    """
    ratio = source.sample_rate_hz / snippet_rate_hz
    if not (math.isfinite(ratio) and ratio >= 1.0 and abs(ratio - round(ratio)) < 1e-9 * ratio):
        raise ValueError(
            f"{source.name}: {source.sample_rate_hz:g} samples a second are no multiple of the snippets' "
            f"{snippet_rate_hz:g} (--snippet-rate)"
        )
    return round(ratio)


def cut_snippet(
    source: Source, start_s: float, count: int, mix_hz: float, snippet_rate_hz: float
) -> tuple[float, npt.NDArray[np.complex64]] | None:
    """`count` samples at the snippets' rate, with `mix_hz` at 0 Hz, from about `start_s` on.

    Returns
    -------
    (start_s, iq), or None
        Time of the first sample; None when the source has not all of them.
    """
    ratio = decimation(source, snippet_rate_hz)
    edge = _EDGE if ratio > 1 else 0
    piece = source.cut(start_s - edge / snippet_rate_hz, (count + 2 * edge) * ratio)
    if piece is None:
        return None
    first_s, iq = piece
    turns = np.arange(iq.size) * ((mix_hz - source.center_frequency_hz) / source.sample_rate_hz)
    mixed = (iq * np.exp(-2j * np.pi * (turns - np.floor(turns)))).astype(np.complex64)
    if ratio > 1:
        mixed = dsp.resample(mixed, source.sample_rate_hz, snippet_rate_hz)[edge : edge + count]
    return first_s + edge / snippet_rate_hz, np.ascontiguousarray(mixed)
