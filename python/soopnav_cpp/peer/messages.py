"""What two receivers say to each other, and how it becomes bytes and back.

A message is a dataclass; its body is the MessagePack array of its fields in their order. `unpack` takes nothing on
trust: number and types of the fields, finite numbers, ranges, lengths.

Times are seconds since `Info.reference_unix_s` of the end that sends them, read off its own clock.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from soopnav_cpp._extras import require
from soopnav_cpp.peer.frames import MAX_BODY

__all__ = [
    "MOST_ANNOUNCED",
    "ROLES",
    "Announce",
    "Bye",
    "Decline",
    "Detection",
    "Heartbeat",
    "Hello",
    "Info",
    "Kind",
    "MalformedError",
    "Message",
    "Proof",
    "Propose",
    "Refuse",
    "Snippet",
    "pack",
    "unpack",
]

ROLES = ("anchor", "target")
MOST_ANNOUNCED = 64  # detections in one message
_MOST_TEXT = 200  # characters
_MOST_TIME_S = 1e10
_MOST_HZ = 1e12
_MOST_ID = 2**53


class MalformedError(ValueError):
    """A body that is not what its kind says."""


class Kind(IntEnum):
    """First three and `REFUSE`: before the session has keys."""

    HELLO = 1
    PROOF = 2
    REFUSE = 3
    INFO = 4
    HEARTBEAT = 5
    ANNOUNCE = 6
    PROPOSE = 7
    DECLINE = 8
    SNIPPET = 9
    BYE = 10


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise MalformedError("a number expected")
    number = float(value)
    if not (math.isfinite(number) and low <= number <= high):
        raise MalformedError("a finite number in its range expected")
    return number


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise MalformedError("a whole number in its range expected")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise MalformedError("a short text expected")
    return "".join(c if c.isprintable() else "?" for c in value)


def _bytes(value: Any, low: int, high: int) -> bytes:
    if not isinstance(value, bytes) or not low <= len(value) <= high:
        raise MalformedError("bytes of another length expected")
    return value


def _list(value: Any, most: int) -> list[Any]:
    if not isinstance(value, list) or len(value) > most:
        raise MalformedError("a list that is not longer expected")
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise MalformedError("true or false expected")
    return value


def _vector(value: Any, limit: float) -> tuple[float, float, float]:
    x, y, z = (_number(v, -limit, limit) for v in _fields(value, 3))
    return x, y, z


def _fields(value: Any, count: int) -> list[Any]:
    if not isinstance(value, list) or len(value) != count:
        raise MalformedError(f"{count} fields expected")
    return value


@dataclass(frozen=True)
class Hello:
    """Who speaks. Not signed; what it says goes into the session's keys.

    Attributes
    ----------
    role : str
    nonce : bytes
        16 random ones, new for every connection.
    snippet_rate_hz : float
        Samples per second of what is exchanged; both ends must have the same.
    """

    KIND: ClassVar[Kind] = Kind.HELLO
    role: str
    nonce: bytes
    snippet_rate_hz: float

    @classmethod
    def read(cls, f: list[Any]) -> Hello:
        if f[0] not in ROLES:
            raise MalformedError("a role expected")
        return cls(f[0], _bytes(f[1], 16, 16), _number(f[2], 1.0, _MOST_HZ))


@dataclass(frozen=True)
class Proof:
    """That the sender knows the shared key: HMAC over both hellos."""

    KIND: ClassVar[Kind] = Kind.PROOF
    proof: bytes

    @classmethod
    def read(cls, f: list[Any]) -> Proof:
        return cls(_bytes(f[0], 32, 32))


@dataclass(frozen=True)
class Refuse:
    """Why no session begins. Not signed: whoever can write into the connection could cut it as well."""

    KIND: ClassVar[Kind] = Kind.REFUSE
    text: str

    @classmethod
    def read(cls, f: list[Any]) -> Refuse:
        return cls(_text(f[0]))


@dataclass(frozen=True)
class Info:
    """What the sender listens to, and from where on it wants to hear.

    Attributes
    ----------
    reference_unix_s : int
        Instant that the sender's times count from, seconds since 1970 (UTC without leap seconds).
    start_s, end_s : float
        What the sender can hear; a live source has no end: `end_s` is the largest number.
    resume_s : float
        The sender needs nothing before.
    sample_rate_hz, center_frequency_hz : float
        Of the recording.
    answers : bool
        The sender has the receiver's.
    """

    KIND: ClassVar[Kind] = Kind.INFO
    reference_unix_s: int
    start_s: float
    end_s: float
    resume_s: float
    sample_rate_hz: float
    center_frequency_hz: float
    answers: bool = False

    @classmethod
    def read(cls, f: list[Any]) -> Info:
        start, end, resume = (_number(v, -_MOST_TIME_S, _MOST_TIME_S) for v in f[1:4])
        reference = _whole(f[0], -(2**40), 2**40)
        rate, center = _number(f[4], 1.0, _MOST_HZ), _number(f[5], 0.0, _MOST_HZ)
        return cls(reference, start, end, resume, rate, center, _flag(f[6]))


@dataclass(frozen=True)
class Heartbeat:
    """That the sender lives, how far it has listened, and whether it has come to the end of its recording.

    `proposals` says of a target how many it has made, of an anchor what the target's last heartbeat said: all of those
    were answered before, or were lost on the way.
    """

    KIND: ClassVar[Kind] = Kind.HEARTBEAT
    heard_to_s: float
    done: bool
    proposals: int

    @classmethod
    def read(cls, f: list[Any]) -> Heartbeat:
        return cls(_number(f[0], -_MOST_TIME_S, _MOST_TIME_S), _flag(f[1]), _whole(f[2], 0, _MOST_ID))


@dataclass(frozen=True)
class Detection:
    """A burst that the anchor heard.

    Attributes
    ----------
    id : int
        Counts the anchor's bursts since it started.
    start_s, duration_s, frequency_hz, bandwidth_hz, snr_db : float
        On the air: `frequency_hz` is a radio frequency by the anchor's oscillator; SNR in the burst's own band.
    beacon : str
        Name by the anchor's ephemeris.
    """

    id: int
    start_s: float
    duration_s: float
    frequency_hz: float
    bandwidth_hz: float
    snr_db: float
    beacon: str

    @classmethod
    def read(cls, f: list[Any]) -> Detection:
        return cls(
            _whole(f[0], 0, _MOST_ID),
            _number(f[1], -_MOST_TIME_S, _MOST_TIME_S),
            _number(f[2], 0.0, 60.0),
            _number(f[3], 0.0, _MOST_HZ),
            _number(f[4], 0.0, _MOST_HZ),
            _number(f[5], -200.0, 200.0),
            _text(f[6]),
        )


@dataclass(frozen=True)
class Announce:
    """Bursts that the anchor heard and can tell the beacons of."""

    KIND: ClassVar[Kind] = Kind.ANNOUNCE
    bursts: tuple[Detection, ...]

    @classmethod
    def read(cls, f: list[Any]) -> Announce:
        return cls(tuple(Detection.read(_fields(item, 7)) for item in _list(f[0], MOST_ANNOUNCED)))


@dataclass(frozen=True)
class Propose:
    """The target heard burst `id` as well, takes it for the same beacon's, and asks for it."""

    KIND: ClassVar[Kind] = Kind.PROPOSE
    id: int
    beacon: str

    @classmethod
    def read(cls, f: list[Any]) -> Propose:
        return cls(_whole(f[0], 0, _MOST_ID), _text(f[1]))


@dataclass(frozen=True)
class Decline:
    """No snippet of burst `id`, and why."""

    KIND: ClassVar[Kind] = Kind.DECLINE
    id: int
    reason: str

    @classmethod
    def read(cls, f: list[Any]) -> Decline:
        return cls(_whole(f[0], 0, _MOST_ID), _text(f[1]))


@dataclass(frozen=True)
class Snippet:
    """Burst `id` as the anchor received it, and where the anchor was.

    Attributes
    ----------
    id : int
    beacon : str
    start_s : float
        Of the first sample, by the anchor's clock.
    mix_hz : float
        Radio frequency that lies at 0 Hz.
    count : int
        Complex samples.
    bits : int
        Of each component: 1 ... 4; 0 is complex64 as it is.
    scale : float
        Root mean square of a component before it was quantised.
    data : bytes
    snr_db : float
        In the burst's band, before quantisation.
    position_e_m, velocity_e_mps : tuple of float
        Of the anchor's antenna then, ECEF.
    """

    KIND: ClassVar[Kind] = Kind.SNIPPET
    id: int
    beacon: str
    start_s: float
    mix_hz: float
    count: int
    bits: int
    scale: float
    data: bytes
    snr_db: float
    position_e_m: tuple[float, float, float]
    velocity_e_mps: tuple[float, float, float]

    @classmethod
    def read(cls, f: list[Any]) -> Snippet:
        count, bits = _whole(f[4], 1, 4 * MAX_BODY), _whole(f[5], 0, 4)
        n_bytes = 8 * count if bits == 0 else (2 * bits * count + 7) // 8
        return cls(
            _whole(f[0], 0, _MOST_ID),
            _text(f[1]),
            _number(f[2], -_MOST_TIME_S, _MOST_TIME_S),
            _number(f[3], 0.0, _MOST_HZ),
            count,
            bits,
            _number(f[6], 0.0, 1e15),
            _bytes(f[7], n_bytes, n_bytes),
            _number(f[8], -200.0, 200.0),
            _vector(f[9], 1e9),
            _vector(f[10], 1e6),
        )


@dataclass(frozen=True)
class Bye:
    """The sender ends the session: `final` when it needs no other one, and what for."""

    KIND: ClassVar[Kind] = Kind.BYE
    final: bool
    text: str

    @classmethod
    def read(cls, f: list[Any]) -> Bye:
        return cls(_flag(f[0]), _text(f[1]))


Message = Hello | Proof | Refuse | Info | Heartbeat | Announce | Propose | Decline | Snippet | Bye
_TYPES: dict[int, Any] = {
    int(t.KIND): t for t in (Hello, Proof, Refuse, Info, Heartbeat, Announce, Propose, Decline, Snippet, Bye)
}
_COUNTS = {kind: len(dataclasses.fields(t)) for kind, t in _TYPES.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Detection):
        return [_plain(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


def pack(message: Message) -> tuple[int, bytes]:
    """Kind and body."""
    msgpack = require("msgpack", "peer", "talking to another receiver")
    fields = [_plain(getattr(message, field.name)) for field in dataclasses.fields(message)]
    return int(message.KIND), msgpack.packb(fields, use_bin_type=True)


def unpack(kind: int, body: bytes) -> Message:
    """The message of a kind and a body.

    Raises
    ------
    MalformedError
        For an unknown kind and for anything that `pack` would not have made.
    """
    msgpack = require("msgpack", "peer", "talking to another receiver")
    made = _TYPES.get(kind)
    if made is None:
        raise MalformedError(f"kind {kind} is unknown")
    try:
        fields = msgpack.unpackb(
            body,
            raw=False,
            use_list=True,
            max_str_len=4 * _MOST_TEXT,
            max_bin_len=MAX_BODY,
            max_array_len=MOST_ANNOUNCED,
            max_map_len=0,
            max_ext_len=0,
        )
    except (ValueError, TypeError, OverflowError, struct.error, RecursionError, msgpack.UnpackException) as error:
        raise MalformedError("not MessagePack of a message") from error
    try:
        return made.read(_fields(fields, _COUNTS[kind]))  # type: ignore[no-any-return]
    except OverflowError as error:  # a whole number that no float holds
        raise MalformedError("a number in its range expected") from error
