"""Frames: how messages of two receivers lie in a stream of bytes, and how they are known to be the peer's.

A frame is

=========  =====  ==========================================================================
field      bytes  what
=========  =====  ==========================================================================
marker     4      ``D3 53 4E 50``: where to go on after damage
version    1      of this protocol; the fields up to `check` stay where they are in all versions
kind       1      of the message
length     2      of the body, at most `MAX_BODY` bytes
sequence   4      counts the messages of one direction of one session, from 0
check      2      low half of the CRC-32 of the ten bytes before it without the marker
body       n      MessagePack
tag        12     first 12 bytes of HMAC-SHA256 over version ... body, zero before the session has keys
crc        4      CRC-32 of version ... tag
=========  =====  ==========================================================================

all big-endian. `check` makes a damaged length known before it is believed, so a reader never waits for bytes that do
not come: it looks for the next marker instead, and the connection lives on. What is refused is counted by its reason
and never raises.

Keys: both ends say hello with a random number of 16 bytes; from the shared key and the two hellos come four keys, a
proof and a message key for each direction. Whoever does not know the key can neither pass the proof nor make, change,
repeat or reflect a message, of this session or another one. Nothing is encrypted.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "MAX_BODY",
    "OVERHEAD",
    "VERSION",
    "Frame",
    "FrameDecoder",
    "Receiver",
    "Sender",
    "SessionKeys",
    "encode",
    "read_key",
]

VERSION = 1
MAX_BODY = 60_000  # bytes
_MARKER = b"\xd3SNP"
_FIXED = struct.Struct(">BBHI")  # version, kind, length, sequence
_CHECK = struct.Struct(">H")
_CRC = struct.Struct(">I")
_TAG_BYTES = 12
_HEAD_BYTES = len(_MARKER) + _FIXED.size + _CHECK.size
OVERHEAD = _HEAD_BYTES + _TAG_BYTES + _CRC.size  # bytes of a frame besides its body
_LAST_SEQUENCE = 0xFFFF_FFFF
_WINDOW = 1024  # sequence numbers behind the newest whose arrival is remembered
_LEAST_KEY_BYTES = 16


@dataclass(frozen=True)
class Frame:
    """A frame that arrived whole.

    Attributes
    ----------
    kind : int
    sequence : int
    body : bytes
    tag : bytes
        Not checked yet.
    signed : bytes
        What the tag is over.
    """

    kind: int
    sequence: int
    body: bytes
    tag: bytes
    signed: bytes


def encode(kind: int, sequence: int, body: bytes, key: bytes | None = None) -> bytes:
    """A frame's bytes.

    Parameters
    ----------
    kind : int
        0 ... 255.
    sequence : int
        0 ... 2**32 - 1.
    body : bytes
        At most `MAX_BODY`.
    key : bytes, optional
        Of the direction; without one the tag is zero.
    """
    if len(body) > MAX_BODY:
        raise ValueError(f"body of {len(body)} bytes: at most {MAX_BODY} expected")
    if not 0 <= sequence <= _LAST_SEQUENCE:
        raise ValueError(f"sequence = {sequence}: 0 ... {_LAST_SEQUENCE} expected")
    fixed = _FIXED.pack(VERSION, kind, len(body), sequence)
    signed = fixed + _CHECK.pack(zlib.crc32(fixed) & 0xFFFF) + body
    tag = bytes(_TAG_BYTES) if key is None else _tag(key, signed)
    return _MARKER + signed + tag + _CRC.pack(zlib.crc32(signed + tag))


def _tag(key: bytes, signed: bytes) -> bytes:
    return hmac.new(key, signed, hashlib.sha256).digest()[:_TAG_BYTES]


class FrameDecoder:
    """Frames out of bytes that arrive in any pieces.

    Nothing that arrives raises. It holds back at most one frame: `MAX_BODY` + `OVERHEAD` bytes.

    Parameters
    ----------
    refused : Counter, optional
        Where refusals are counted: ``damaged`` (a check or the CRC is wrong; bytes up to the next marker are passed
        over), ``oversized``, ``version``, and ``garbage`` (bytes passed over between frames).

    Attributes
    ----------
    refused : Counter
    foreign_version : int or None
        Of the last whole header of another version.
    """

    def __init__(self, refused: Counter[str] | None = None) -> None:
        self.refused: Counter[str] = Counter() if refused is None else refused
        self.foreign_version: int | None = None
        self._bytes = bytearray()

    def __len__(self) -> int:
        """Bytes held back."""
        return len(self._bytes)

    def push(self, data: bytes) -> Iterator[Frame]:
        """Take bytes; yield the frames that are whole now. All must be taken before the next `push`."""
        step = MAX_BODY + OVERHEAD
        for start in range(0, len(data), step):
            self._bytes += data[start : start + step]
            while (frame := self._next()) is not None:
                yield frame

    def _next(self) -> Frame | None:
        held = self._bytes
        while True:
            self._to_marker()
            if len(held) < _HEAD_BYTES:
                return None
            version, kind, length, sequence = _FIXED.unpack_from(held, len(_MARKER))
            fixed_end = len(_MARKER) + _FIXED.size
            (check,) = _CHECK.unpack_from(held, fixed_end)
            if zlib.crc32(held[len(_MARKER) : fixed_end]) & 0xFFFF != check:
                self._refuse("damaged", 1)
                continue
            if version != VERSION:
                self.foreign_version = version
                self._refuse("version", _HEAD_BYTES)
                continue
            if length > MAX_BODY:
                self._refuse("oversized", _HEAD_BYTES)
                continue
            total = OVERHEAD + length
            if len(held) < total:
                return None
            signed_end = _HEAD_BYTES + length
            (crc,) = _CRC.unpack_from(held, total - _CRC.size)
            if zlib.crc32(held[len(_MARKER) : total - _CRC.size]) != crc:
                self._refuse("damaged", 1)
                continue
            frame = Frame(
                kind,
                sequence,
                bytes(held[_HEAD_BYTES:signed_end]),
                bytes(held[signed_end : signed_end + _TAG_BYTES]),
                bytes(held[len(_MARKER) : signed_end]),
            )
            del held[:total]
            return frame

    def _refuse(self, reason: str, n_bytes: int) -> None:
        self.refused[reason] += 1
        del self._bytes[:n_bytes]
        self._to_marker(counted=False)

    def _to_marker(self, *, counted: bool = True) -> None:
        """Drop what stands before the next marker, or before what may become one."""
        held = self._bytes
        at = held.find(_MARKER)
        if at < 0:
            keep = next((n for n in (3, 2, 1) if held.endswith(_MARKER[:n])), 0)
            at = len(held) - keep
        if at > 0:
            if counted:
                self.refused["garbage"] += 1
            del held[:at]


@dataclass(frozen=True)
class SessionKeys:
    """Keys of one session, by the role that sends: HMAC-SHA256 of the shared key over what both ends said in hello.

    Attributes
    ----------
    proof, message : dict of str to bytes
        By the role of the sender.
    transcript : bytes
        SHA-256 of the two hellos.
    """

    proof: dict[str, bytes]
    message: dict[str, bytes]
    transcript: bytes

    @classmethod
    def derive(cls, shared: bytes, hello: dict[str, bytes]) -> SessionKeys:
        """From the shared key and the hellos' bodies by role; both contain a fresh random number."""
        roles = sorted(hello)
        digest = hashlib.sha256()
        for role in roles:
            digest.update(role.encode() + b"\0" + len(hello[role]).to_bytes(4, "big") + hello[role])
        transcript = digest.digest()
        root = hmac.new(shared, b"soopnav peer %d root" % VERSION + transcript, hashlib.sha256).digest()

        def key(purpose: str, role: str) -> bytes:
            return hmac.new(root, f"{purpose} of {role}".encode(), hashlib.sha256).digest()

        return cls({r: key("proof", r) for r in roles}, {r: key("messages", r) for r in roles}, transcript)

    def proof_of(self, role: str) -> bytes:
        """What `role` sends to show that it knows the key."""
        return hmac.new(self.proof[role], self.transcript, hashlib.sha256).digest()

    def proves(self, role: str, proof: bytes) -> bool:
        """Whether `proof` is that of `role`, in constant time."""
        return hmac.compare_digest(self.proof_of(role), proof)

    def __repr__(self) -> str:
        return "SessionKeys(...)"


class Sender:
    """Numbers and signs what one end sends in a session."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._next = 0

    def frame(self, kind: int, body: bytes) -> bytes:
        """The next frame. After 2**32 frames: OverflowError, and a new session is due."""
        if self._next > _LAST_SEQUENCE:
            raise OverflowError("a session has no more sequence numbers")
        data = encode(kind, self._next, body, self._key)
        self._next += 1
        return data


class Receiver:
    """Takes only what the peer sent in this session, once, and in order.

    Counted: ``forged`` (the tag is wrong), ``replayed`` (this number was here before, or may have been),
    ``late`` (it was overtaken), and ``missing`` (numbers passed over; one that comes late has been counted there too).
    """

    def __init__(self, key: bytes, refused: Counter[str]) -> None:
        self._key = key
        self._refused = refused
        self._newest = -1
        self._seen = 0  # bit k: newest - k has arrived

    def accept(self, frame: Frame) -> bool:
        """Whether `frame` is to be read."""
        if not hmac.compare_digest(_tag(self._key, frame.signed), frame.tag):
            self._refused["forged"] += 1
            return False
        ahead = frame.sequence - self._newest
        if ahead <= 0:
            seen = -ahead >= _WINDOW or bool(self._seen >> -ahead & 1)
            self._refused["replayed" if seen else "late"] += 1
            if not seen:
                self._seen |= 1 << -ahead
            return False
        if ahead > 1:
            self._refused["missing"] += ahead - 1
        self._seen = ((self._seen << min(ahead, _WINDOW)) | 1) & ((1 << _WINDOW) - 1)
        self._newest = frame.sequence
        return True


def read_key(path: str | os.PathLike[str] | None = None, *, variable: str = "SOOPNAV_PEER_KEY") -> bytes:
    """The shared key: the bytes of a file without white space around them, or an environment variable's.

    Raises
    ------
    ValueError
        For neither, for both empty, for fewer than 16 bytes. The message never holds the key.
    """
    if path is not None:
        key, where = Path(path).read_bytes().strip(), str(path)
    elif variable in os.environ:
        key, where = os.environ[variable].strip().encode(), variable
    else:
        raise ValueError(f"no key: --key-file, or the environment variable {variable}, with at least 16 bytes expected")
    if len(key) < _LEAST_KEY_BYTES:
        raise ValueError(f"{where}: a key of {len(key)} bytes; at least {_LEAST_KEY_BYTES} expected")
    return key
