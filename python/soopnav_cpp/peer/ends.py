"""What anchor and target have in common: their options, what they tell of themselves, the anchor's skew from bursts."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp.peer.beacons import Beacons, Candidate
from soopnav_cpp.peer.messages import Heartbeat, Info
from soopnav_cpp.peer.scan import Heard, Scanner, decimation
from soopnav_cpp.peer.sources import FAR_FUTURE_S, Source, iso

__all__ = ["End", "ExchangeOptions", "OwnSkew"]

_LEAST_SIGMA_HZ = 5.0
_SKEWS_AGREE = 1e-7
_LEAST_VOTES = 5
_SKEW_WIDTH = 2e-7
_LEAST_RATE_HZ = 25e3  # of snippets: the symbols of a channel


@dataclass(frozen=True)
class ExchangeOptions:
    """What both ends are told.

    Attributes
    ----------
    snippet_rate_hz : float
    guard_s : float
        Of a snippet, before and after its burst.
    clock_s : float
        The two clocks differ by no more.
    skew : float
        Largest of either clock.
    lead_s : float
        Of a recording, by which one end may be ahead of the other.
    answer_s : float
        By a stopwatch: without any message of the peer, proposals without an answer are given up. Longer than a session
        bears silence, so that the end of a session comes first.
    """

    snippet_rate_hz: float = 50e3
    guard_s: float = 1.5e-3
    clock_s: float = 5e-3
    skew: float = 2e-6
    lead_s: float = 60.0
    answer_s: float = 30.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value:g}: a finite number above zero expected")
        if self.snippet_rate_hz < _LEAST_RATE_HZ:
            raise ValueError(
                f"snippet_rate_hz = {self.snippet_rate_hz:g} (--snippet-rate): at least {_LEAST_RATE_HZ:g} Hz expected"
            )


class End:
    """What the two have in common."""

    role = ""

    def __init__(self, source: Source, beacons: Beacons, options: ExchangeOptions) -> None:
        decimation(source, options.snippet_rate_hz)
        self.counts: Counter[str] = Counter()
        self.snippet_rate_hz = options.snippet_rate_hz
        self.source, self.beacons, self.options = source, beacons, options
        self.peer: Info | None = None
        self._scanner = Scanner(source, self.counts)
        self._to_orbits_s = source.reference_unix_s - beacons.reference_unix_s
        self._peer_heard_s = -math.inf  # by one's own reference

    def _info(self, resume_s: float) -> Info:
        s = self.source
        return Info(
            s.reference_unix_s, s.start_s, s.end_s, resume_s, s.sample_rate_hz, s.center_frequency_hz
        )  # fmt: skip

    def attach(self, peer: Info) -> str:
        """A session begins; not empty: why there can be none."""
        shift = peer.reference_unix_s - self.source.reference_unix_s
        start, end = peer.start_s + shift, peer.end_s + shift
        if start >= self.source.end_s or end <= self.source.start_s:
            mine = (self.source.reference_unix_s, self.source.start_s, self.source.end_s)
            theirs = (peer.reference_unix_s, peer.start_s, peer.end_s)
            anchor, target = (mine, theirs) if self.role == "anchor" else (theirs, mine)
            return (
                f"the recordings do not overlap: the anchor's is {iso(*anchor[:2])} to {iso(anchor[0], anchor[2])}, "
                f"the target's {iso(*target[:2])} to {iso(target[0], target[2])}"
            )
        self.peer = peer
        self._shift_s = float(shift)
        self._peer_heard_s = start
        return ""

    def detach(self) -> None:
        """The session is over."""
        self.peer = None

    @property
    def heard_to_s(self) -> float:
        """How far the source has been scanned, since its reference."""
        return min(self._scanner.heard_to_s, self.source.end_s)

    def _may_scan(self) -> bool:
        if self.source.live:
            return True
        return self.peer is not None and self._scanner.heard_to_s <= self._peer_heard_s + self.options.lead_s

    def _take_heartbeat(self, message: Heartbeat) -> None:
        self._peer_heard_s = FAR_FUTURE_S if message.done else message.heard_to_s + self._shift_s

    def _candidates(self, heard: Heard, p_e: npt.NDArray[np.float64], within_m: float) -> list[Candidate]:
        return self.beacons.candidates(
            heard.start_s + 0.5 * heard.duration_s + self._to_orbits_s,
            heard.frequency_hz,
            p_e,
            skew=self.options.skew,
            sigma_hz=max(heard.sigma_hz, _LEAST_SIGMA_HZ),
            within_m=within_m,
        )


class OwnSkew:
    """What bursts say of the anchor's clock, though each may be of several beacons.

    Every candidate of a burst is a skew. The true one is among those of all bursts; a wrong one is not among those of
    the other satellite's. So the skew is known once most of the last bursts share one and no other.
    """

    def __init__(self) -> None:
        self._said: deque[list[float]] = deque(maxlen=40)
        self.known: float | None = None

    def take(self, candidates: list[Candidate]) -> None:
        """Learn from a burst."""
        if not candidates:
            return
        self._said.append([-c.residual_hz / c.carrier_hz for c in candidates])
        best, votes = self._most(None)
        _, others = self._most(best)
        clear = votes >= max(_LEAST_VOTES, 0.8 * len(self._said)) and others <= 0.6 * votes
        self.known = best if clear else None

    def _most(self, but: float | None) -> tuple[float, int]:
        """The skew that most bursts share, and how many; of those that are not near `but`."""
        found = (0.0, 0)
        for start in (skew for burst in self._said for skew in burst):
            if but is not None and abs(start - but) < 2.0 * _SKEWS_AGREE:
                continue
            near = [[s for s in burst if start <= s <= start + _SKEWS_AGREE] for burst in self._said]
            votes = sum(1 for burst in near if burst)
            if votes > found[1]:
                inside = [s for burst in near for s in burst]
                found = (sum(inside) / len(inside), votes)
        return found

    def agree(self, candidates: list[Candidate]) -> list[Candidate]:
        """Those that fit the skew, once it is known."""
        if self.known is None:
            return candidates
        return [c for c in candidates if abs(c.residual_hz / c.carrier_hz + self.known) <= _SKEW_WIDTH]
