"""Anchor and target as state machines: messages and samples in, messages and a track out. No sockets here.

The target asks for bursts in the order of their starts at the anchor and tracks them in the order of their epochs, and
nothing that it decides depends on how fast messages or samples come: a proposal is given up when the order of messages
says that it or its answer was lost, not when a time has passed, and what depends on the track is decided at the answer.
So two processes end with what one process ends with.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.peer.beacons import Beacons, Candidate
from soopnav_cpp.peer.ends import End, ExchangeOptions, OwnSkew
from soopnav_cpp.peer.frames import MAX_BODY
from soopnav_cpp.peer.messages import (
    MOST_ANNOUNCED,
    Announce,
    Decline,
    Detection,
    Heartbeat,
    Info,
    Message,
    Propose,
    Snippet,
)
from soopnav_cpp.peer.scan import Heard, cut_snippet
from soopnav_cpp.peer.snippets import TokenBucket, choose_bits, dequantise, quantise, snippet_bytes
from soopnav_cpp.peer.sources import FAR_FUTURE_S, Source
from soopnav_cpp.peer.track import Measured, Track

__all__ = ["Anchor", "ExchangeOptions", "Target"]

_KEPT_BURSTS = 4096
_KEPT_LIVE_S = 15.0
_ROUND = 250  # samples: snippets come in few lengths
_BURST_HZ = 35e3  # 25 ksym/s, roll-off 0.4
_MATCH_S = 1.5e-3  # by which two detectors may differ
_HELD_S = 5.0  # bursts wait so long for the anchor's skew to be known
_LONG_BURST_S = 0.1
_DECLINES = ("not kept", "another beacon", "not recorded", "bandwidth", "no power", "too long")


class Anchor(End):
    """Scans, announces the bursts whose beacons it can tell, and hands over those that are asked for.

    Parameters
    ----------
    source : Source
    beacons : Beacons
    antenna : geometry.SampledOrbit
        Where it is, by the beacons' reference.
    bandwidth_bps : float
        Of the snippets; infinity: no limit.
    bits : int, optional
        Of each component, for all snippets; 0: as they are. Left out: by SNR and bandwidth.
    options : ExchangeOptions
    """

    role = "anchor"

    def __init__(
        self,
        source: Source,
        beacons: Beacons,
        antenna: SampledOrbit,
        *,
        bandwidth_bps: float = math.inf,
        bits: int | None = None,
        options: ExchangeOptions | None = None,
    ) -> None:
        super().__init__(source, beacons, options or ExchangeOptions())
        if bits is not None and bits not in range(5):
            raise ValueError(f"bits = {bits}: 0 ... 4 expected")
        count = math.ceil(self.snippet_rate_hz * (_LONG_BURST_S + 2.0 * self.options.guard_s))
        size = snippet_bytes(count, 4 if bits is None else bits)
        if size > MAX_BODY:
            raise ValueError(
                f"snippet_rate_hz = {self.snippet_rate_hz:g} (--snippet-rate), bits = "
                f"{'up to 4' if bits is None else bits} (--bits; 0: all): a burst of {_LONG_BURST_S:g} s has {size} "
                f"bytes, at most {MAX_BODY} fit into a message; a lower rate or fewer bits expected"
            )
        self._antenna, self._bits = antenna, bits
        self._bucket = TokenBucket(bandwidth_bps)
        self._next = 0
        self._told = 0  # proposals of the target before its last heartbeat
        self._skew = OwnSkew()
        self._held: deque[tuple[Heard, list[Candidate]]] = deque(maxlen=_KEPT_BURSTS)
        self._kept: dict[int, tuple[Heard, str]] = {}
        self._unsaid: deque[Detection] = deque(maxlen=_KEPT_BURSTS)

    def info(self) -> Info:
        """For the next session."""
        return self._info(self.source.start_s)

    def attach(self, peer: Info) -> str:
        """As `_End`; a recording is read again from where the target needs it."""
        refusal = super().attach(peer)
        self._told = 0
        if not refusal and not self.source.live:
            self._unsaid.clear()
            self._held.clear()
            self._scanner.seek(peer.resume_s + self._shift_s)
        return refusal

    def heartbeat(self) -> Heartbeat:
        """That it lives, how far it has come, and that all is answered that came before the target's last heartbeat."""
        return Heartbeat(self.heard_to_s, self._scanner.done and not self._unsaid and not self._held, self._told)

    @property
    def finished(self) -> bool:
        """Never by itself: the target says when."""
        return False

    def step(self, now: float) -> list[Message] | None:
        """Scan a block; announce what was found."""
        del now
        was_done = self._scanner.done
        heard = self._scanner.step() if self._may_scan() else None
        for burst in heard or ():
            self._consider(burst)
        while self._held and (
            self._skew.known is not None
            or self._scanner.done
            or self._held[0][0].start_s < self._scanner.heard_to_s - _HELD_S
        ):
            self._place(*self._held.popleft())
        said: list[Message] = []
        if self.peer is not None:
            while self._unsaid:
                bursts = tuple(self._unsaid.popleft() for _ in range(min(len(self._unsaid), MOST_ANNOUNCED)))
                said.append(Announce(bursts))
        elif self.source.live:
            while self._unsaid and self._unsaid[0].start_s < self.heard_to_s - _KEPT_LIVE_S:
                self._unsaid.popleft()
                self.counts["nobody there"] += 1
        if self._scanner.done and not was_done:
            said.append(self.heartbeat())
        return said if heard is not None or said else None

    def _consider(self, heard: Heard) -> None:
        at = self._state(heard.start_s)
        if at is None:
            self.counts["own position unknown"] += 1
            return
        candidates = self._candidates(heard, at[0], 0.0)
        self._skew.take(candidates)
        self._held.append((heard, candidates))

    def _place(self, heard: Heard, candidates: list[Candidate]) -> None:
        candidates = self._skew.agree(candidates)
        if len(candidates) != 1:
            self.counts["no beacon" if not candidates else "beacon ambiguous"] += 1
            return
        number, self._next = self._next, self._next + 1
        name = candidates[0].name
        self._kept[number] = (heard, name)
        while len(self._kept) > _KEPT_BURSTS:
            del self._kept[next(iter(self._kept))]
        self.counts["announced"] += 1
        self._unsaid.append(
            Detection(
                number, heard.start_s, heard.duration_s, heard.frequency_hz, heard.bandwidth_hz, heard.snr_db, name
            )
        )

    def _state(self, t_s: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None:
        position, velocity = self._antenna.at(t_s + self._to_orbits_s)
        p, v = np.asarray(position, np.float64).reshape(3), np.asarray(velocity, np.float64).reshape(3)
        return (p, v) if np.isfinite(p).all() and np.isfinite(v).all() else None

    def handle(self, message: Message, now: float) -> list[Message]:
        """Answer a proposal."""
        del now
        if isinstance(message, Heartbeat):
            self._take_heartbeat(message)
            self._told = message.proposals
        elif isinstance(message, Propose):
            self.counts["proposed"] += 1
            answer = self._answer(message)
            if isinstance(answer, Decline):
                self.counts[f"declined: {answer.reason}"] += 1
            else:
                self.counts["exchanged"] += 1
            return [answer]
        else:
            self.counts["unexpected message"] += 1
        return []

    def _answer(self, asked: Propose) -> Snippet | Decline:
        if asked.id not in self._kept:
            return Decline(asked.id, "not kept")
        heard, name = self._kept[asked.id]
        if name != asked.beacon:
            return Decline(asked.id, "another beacon")
        rate, guard_s = self.snippet_rate_hz, self.options.guard_s
        count = _ROUND * math.ceil((heard.duration_s + 2.0 * guard_s) * rate / _ROUND)
        mix_hz = float(round(heard.frequency_hz))
        cut = cut_snippet(self.source, heard.start_s - guard_s, count, mix_hz, rate)
        state = self._state(heard.start_s)
        if cut is None or state is None:
            return Decline(asked.id, "not recorded")
        start_s, iq = cut
        self._bucket.advance(heard.start_s)
        bits = choose_bits(heard.snr_db, count, self._bucket) if self._bits is None else self._bits
        if bits is None or not self._bucket.has(snippet_bytes(count, bits)):
            return Decline(asked.id, "bandwidth")
        if snippet_bytes(count, bits) > MAX_BODY:
            return Decline(asked.id, "too long")
        inner = slice(round(guard_s * rate), max(round((guard_s + heard.duration_s) * rate), round(guard_s * rate) + 1))
        index = self.beacons.index(name)
        satellite = index is not None and not self.beacons.orbits[index].is_fixed
        scale, data = quantise(iq, bits, burst=inner, band=min(1.0, _BURST_HZ / rate) if satellite else 0.0)
        if not scale > 0.0:
            return Decline(asked.id, "no power")
        self._bucket.pay(snippet_bytes(count, bits))
        self.counts[f"bits: {bits}" if bits else "bits: all"] += 1
        p, v = (tuple(map(float, part)) for part in state)
        return Snippet(asked.id, name, start_s, mix_hz, count, bits, scale, data, heard.snr_db, p, v)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Asked:
    heard: Heard
    theirs: Detection  # times by one's own reference
    said_at: float
    number: int  # counts proposals


class Target(End):
    """Scans, asks for the bursts that both heard, measures them against its own, and tracks.

    Parameters
    ----------
    source : Source
    beacons : Beacons
    track : Track
    options : ExchangeOptions
    """

    role = "target"

    def __init__(
        self, source: Source, beacons: Beacons, track: Track, *, options: ExchangeOptions | None = None
    ) -> None:
        super().__init__(source, beacons, options or ExchangeOptions())
        self.track = track
        self._mine: deque[Heard] = deque()
        self._queue: deque[Detection] = deque()
        self._asked: dict[int, _Asked] = {}  # in their order
        self._proposals = 0
        self._heard_at = -math.inf  # by the stopwatch: the peer's last message
        self._measured: list[Measured] = []  # not yet tracked
        self._settled: deque[tuple[float, float]] = deque(maxlen=256)  # start, frequency at the anchor
        self._settled_to_s = self.source.start_s
        self._not_before_s = -math.inf  # middles of bursts
        if math.isfinite(track.resume_unix_s):
            self._not_before_s = track.resume_unix_s - source.reference_unix_s + 1e-3
            self._settled_to_s = max(self._settled_to_s, self._not_before_s)
            self._scanner.seek(self._settled_to_s - self.options.clock_s - 0.2)

    def info(self) -> Info:
        """For the next session: nothing is needed that is settled."""
        return self._info(max(self._settled_to_s - self.options.clock_s - 0.2, self.source.start_s - 1.0))

    def attach(self, peer: Info) -> str:
        """As `_End`; what had been asked for will be announced again, by a recording."""
        refusal = super().attach(peer)
        if not refusal:
            self._drop()
        return refusal

    def detach(self) -> None:
        """The session is over; the track stays."""
        super().detach()
        self._drop()

    def _drop(self) -> None:
        self.counts["asked in vain"] += len(self._asked)
        self._asked.clear()
        self._queue.clear()
        self._follow(math.inf)

    def heartbeat(self) -> Heartbeat:
        """That it lives, how far it has come, and how much it has asked for."""
        return Heartbeat(self.heard_to_s, self._scanner.done, self._proposals)

    @property
    def finished(self) -> bool:
        """Both have come to their ends, and every proposal to its own."""
        return self._quiet and not self._measured

    @property
    def _quiet(self) -> bool:
        quiet = self._scanner.done and not self._queue and not self._asked
        return quiet and self.peer is not None and self._peer_heard_s >= FAR_FUTURE_S

    def step(self, now: float) -> list[Message] | None:
        """Scan a block; ask for what was announced and heard."""
        was_done = self._scanner.done
        heard = self._scanner.step() if self._may_scan() else None
        if heard:
            self._mine.extend(heard)
        self._give_up(lambda asked: now - max(asked.said_at, self._heard_at) > self.options.answer_s)
        said = self._ask(now)
        if self._quiet:
            self._follow(math.inf)
        if self._scanner.done and not was_done:
            said.append(self.heartbeat())
        return said if heard is not None or said else None

    def _give_up(self, on: Callable[[_Asked], bool]) -> None:
        for number in [n for n, asked in self._asked.items() if on(asked)]:
            self._settle(self._asked.pop(number).theirs)
            self.counts["no answer"] += 1

    def _answered(self, number: int) -> _Asked | None:
        """What was asked. Answers come in order: what was asked before and has none will have none."""
        asked = self._asked.pop(number, None)
        if asked is not None:
            before = asked.number
            self._give_up(lambda other: other.number < before)
            self._settle(asked.theirs)
        return asked

    def handle(self, message: Message, now: float) -> list[Message]:
        """Take what the anchor says."""
        self._heard_at = now
        if isinstance(message, Heartbeat):
            self._take_heartbeat(message)
            told = message.proposals
            self._give_up(lambda asked: asked.number < told)
        elif isinstance(message, Announce):
            self.counts["announced"] += len(message.bursts)
            if len(self._queue) + len(message.bursts) > _KEPT_BURSTS:
                self.counts["too many announced"] += len(message.bursts)
            else:
                self._queue.extend(message.bursts)
            return self._ask(now)
        elif isinstance(message, Decline):
            if self._answered(message.id) is None:
                self.counts["answer to nothing"] += 1
            else:
                reason = message.reason if message.reason in _DECLINES else "another reason"  # names are the peer's
                self.counts[f"declined: {reason}"] += 1
        elif isinstance(message, Snippet):
            asked = self._answered(message.id)
            if asked is None or message.beacon != asked.theirs.beacon:
                self.counts["answer to nothing"] += 1
            else:
                self.counts["exchanged"] += 1
                self._measure(message, asked)
        else:
            self.counts["unexpected message"] += 1
        return []

    def _settle(self, burst: Detection) -> None:
        self._settled.append((burst.start_s, burst.frequency_hz))
        self._settled_to_s = max(self._settled_to_s, burst.start_s)
        self._follow(burst.start_s)
        while self._mine and self._mine[0].start_s < self._settled_to_s - 1.0:
            self._mine.popleft()

    def _follow(self, to_s: float) -> None:
        """Track what was measured before `to_s`: no burst that starts later has its middle there, however short."""
        self._measured.sort(key=lambda m: m.t_s)
        while self._measured and self._measured[0].t_s - self._to_orbits_s <= to_s:
            self.counts[self.track.add(self._measured.pop(0))] += 1

    def _ask(self, now: float) -> list[Message]:
        said: list[Message] = []
        reach_s = self.options.clock_s + _MATCH_S
        while self._queue and self.peer is not None:
            theirs = self._queue[0]
            start_s = theirs.start_s + self._shift_s
            if start_s + reach_s >= self._scanner.heard_to_s:
                break
            self._queue.popleft()
            theirs = _moved(theirs, self._shift_s)
            reason, heard = self._agree(theirs, reach_s)
            if heard is None:
                self.counts[reason] += 1
                self._settle_quietly(theirs)
                continue
            self.counts["proposed"] += 1
            self._asked[theirs.id] = _Asked(heard, theirs, now, self._proposals)
            self._proposals += 1
            said.append(Propose(theirs.id, theirs.beacon))
        return said

    def _settle_quietly(self, theirs: Detection) -> None:
        if not self._asked:
            self._settled_to_s = max(self._settled_to_s, theirs.start_s)

    def _agree(self, theirs: Detection, reach_s: float) -> tuple[str, Heard | None]:
        if theirs.start_s + 0.5 * theirs.duration_s <= self._not_before_s:
            return "known already", None
        if any(abs(t - theirs.start_s) < 5e-3 and abs(f - theirs.frequency_hz) < 2e3 for t, f in self._settled):
            return "known already", None
        if theirs.start_s < self._settled_to_s - 1.0:
            return "too late", None
        reach_hz = 4.0 * self.options.skew * theirs.frequency_hz + 2e3
        near = [
            heard
            for heard in self._mine
            if abs(heard.start_s - theirs.start_s) <= reach_s
            and abs(heard.frequency_hz - theirs.frequency_hz) <= reach_hz
        ]
        if not near:
            return "not heard here", None
        heard = min(
            near, key=lambda h: abs(h.start_s - theirs.start_s) + 1e-6 * abs(h.frequency_hz - theirs.frequency_hz)
        )
        if self.beacons.index(theirs.beacon) is None:
            return "beacon unknown here", None
        return "", heard

    def _beacon(self, asked: _Asked) -> Candidate | None:
        """As which the target hears a burst, if it can be the anchor's: where the track is, or where it may begin."""
        where, within_m = self._whereabouts(asked.heard.start_s + self._to_orbits_s)
        for candidate in self._candidates(asked.heard, where, within_m):
            if candidate.name == asked.theirs.beacon:
                return candidate
        return None

    def _whereabouts(self, t_s: float) -> tuple[npt.NDArray[np.float64], float]:
        """The target's place, and by how much it can be off: three sigma, and where it has gone since."""
        track = self.track
        if not track.running:
            return track.guess_e_m, 3.0 * track.within_m
        mean, variance = track.tracker.mean, np.diag(track.tracker.covariance)
        speed = float(np.linalg.norm(mean[3:6])) + 3.0 * math.sqrt(max(float(np.sum(variance[3:6])), 0.0))
        sigma = math.sqrt(max(float(np.sum(variance[:3])), 0.0))
        return np.array(mean[:3]), 3.0 * sigma + speed * abs(t_s - track.tracker.t_s)

    def _measure(self, snippet: Snippet, asked: _Asked) -> None:
        rate, heard = self.snippet_rate_hz, asked.heard
        least = 4.0 * self.options.guard_s * rate
        most = (asked.theirs.duration_s + 2.0 * self.options.guard_s) * rate + 2.0 * _ROUND
        if not least <= snippet.count <= most or abs(snippet.mix_hz - asked.theirs.frequency_hz) > 1e3:
            self.counts["snippet of another burst"] += 1
            return
        at_anchor_s = snippet.start_s + self._shift_s
        if abs(at_anchor_s - asked.theirs.start_s) > 2.0 * self.options.guard_s + asked.theirs.duration_s:
            self.counts["snippet of another burst"] += 1
            return
        beacon = self._beacon(asked)
        if beacon is None:
            self.counts["beacon disagrees"] += 1
            return
        cut = cut_snippet(self.source, heard.start_s - self.options.guard_s, snippet.count, snippet.mix_hz, rate)
        if cut is None:
            self.counts["not recorded here"] += 1
            return
        try:
            theirs = dequantise(snippet.data, snippet.count, snippet.bits, snippet.scale)
        except ValueError:
            self.counts["snippet unreadable"] += 1
            return
        start_s, mine = cut
        satellite = not self.beacons.orbits[beacon.index].is_fixed
        peak = dsp.cross_ambiguity(
            mine,
            theirs,
            rate,
            max_delay_s=0.8 * self.options.guard_s,
            max_doppler_hz=1e3 * math.ceil((4.0 * self.options.skew * snippet.mix_hz + 2e3) / 1e3),
            symbol_rate_hz=25e3 if satellite else 0.0,
            carrier_hz=beacon.carrier_hz,
        )
        if not peak.detected:
            self.counts[f"not measured: {peak.status.text}"] += 1
            return
        self.counts["measured"] += 1
        self._measured.append(
            Measured(
                t_s=at_anchor_s + self._to_orbits_s + peak.epoch_s,
                beacon=beacon.index,
                tdoa_s=(start_s - at_anchor_s) + peak.tdoa_s,
                fdoa_hz=peak.fdoa_hz,
                covariance=peak.covariance,
                carrier_hz=beacon.carrier_hz,
                anchor_position_e_m=np.array(snippet.position_e_m),
                anchor_velocity_e_mps=np.array(snippet.velocity_e_mps),
                bits=snippet.bits,
                snr_db=peak.snr_b_db,
            )
        )


def _moved(burst: Detection, shift_s: float) -> Detection:
    return Detection(
        burst.id,
        burst.start_s + shift_s,
        burst.duration_s,
        burst.frequency_hz,
        burst.bandwidth_hz,
        burst.snr_db,
        burst.beacon,
    )
