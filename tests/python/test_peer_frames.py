"""Frames, keys and messages between two receivers: what arrives is taken once and in order, or refused and counted."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soopnav_cpp.peer import frames, messages
from soopnav_cpp.peer.frames import FrameDecoder, Receiver, Sender, SessionKeys, encode
from soopnav_cpp.peer.messages import MalformedError, pack, unpack

msgpack = pytest.importorskip("msgpack")

KEY = b"k" * 32

EXAMPLES = [
    messages.Hello("anchor", b"n" * 16, 50e3),
    messages.Proof(b"p" * 32),
    messages.Refuse("no"),
    messages.Info(1_409_097_600, 0.25, 60.0, 10.0, 250e3, 1626.2e6),
    messages.Heartbeat(12.5, True, 3),
    messages.Announce(
        (
            messages.Detection(4, 1.25, 0.0325, 1626.27e6, 31e3, 9.5, "IRIDIUM 7"),
            messages.Detection(5, 1.35, 0.0083, 1620.1e6, 30e3, -1.0, ""),
        )
    ),
    messages.Propose(4, "IRIDIUM 7"),
    messages.Decline(4, "budget"),
    messages.Snippet(4, "IRIDIUM 7", 1.2, 1626.27e6, 5, 3, 0.1, bytes(4), 9.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)),
    messages.Bye(True, "done"),
]


def decoded(decoder: FrameDecoder, data: bytes, piece: int = 1 << 20) -> list[frames.Frame]:
    return [frame for at in range(0, len(data), piece) for frame in decoder.push(data[at : at + piece])]


@pytest.mark.law
@pytest.mark.parametrize("message", EXAMPLES, ids=lambda m: type(m).__name__)
def test_messages_come_back_as_they_were(message: messages.Message) -> None:
    kind, body = pack(message)
    assert unpack(kind, body) == message
    assert {int(m.KIND) for m in EXAMPLES} == {int(k) for k in messages.Kind}


@pytest.mark.unit
@pytest.mark.parametrize("message", EXAMPLES, ids=lambda m: type(m).__name__)
def test_messages_with_a_wrong_field_are_malformed(message: messages.Message) -> None:
    kind, body = pack(message)
    fields = msgpack.unpackb(body)
    for at in range(len(fields)):
        for wrong in (math.nan, {}, None, -(2**60), 2**63, "x" * 201, b"", [[]], [1.0, math.inf, 0.0]):
            with pytest.raises(MalformedError):
                unpack(kind, msgpack.packb([*fields[:at], wrong, *fields[at + 1 :]]))
    for other in (fields[:-1], [*fields, 0], dict(enumerate(fields)), 5):
        with pytest.raises(MalformedError):
            unpack(kind, msgpack.packb(other))
    with pytest.raises(MalformedError):
        unpack(99, body)


@pytest.mark.unit
def test_text_of_the_peer_cannot_move_the_cursor() -> None:
    read = unpack(*pack(messages.Refuse("\x1b[2Jgo\naway")))
    assert isinstance(read, messages.Refuse)
    assert read.text == "?[2Jgo?away"


@pytest.mark.law
@pytest.mark.parametrize("piece", [3, 17, 1000])
def test_frames_come_back_in_any_pieces(piece: int) -> None:
    bodies = [b"", b"a", bytes(range(256)), b"\xd3SNP" * 9, bytes(frames.MAX_BODY)]
    stream = b"".join(encode(k, k, body, KEY) for k, body in enumerate(bodies))
    decoder = FrameDecoder()
    assert [frame.body for frame in decoded(decoder, stream, piece)] == bodies
    assert not decoder.refused
    assert len(decoder) == 0


@pytest.mark.law
def test_any_damaged_byte_costs_its_frame_alone() -> None:
    three = [encode(7, k, b"body %d" % k, KEY) for k in range(3)]
    for at in range(len(three[1])):
        for flip in (0x01, 0x80, 0xFF):
            bad = bytearray(three[1])
            bad[at] ^= flip
            decoder = FrameDecoder()
            got = decoded(decoder, three[0] + bytes(bad) + three[2])
            assert [frame.sequence for frame in got] == [0, 2], (at, flip)
            assert sum(decoder.refused.values()) >= 1


@pytest.mark.law
@pytest.mark.parametrize("cut", range(1, 40))
def test_a_frame_that_ends_early_costs_no_other(cut: int) -> None:
    first, second = encode(1, 0, b"x" * 30, KEY), encode(1, 1, b"y" * 30, KEY)
    decoder = FrameDecoder()
    got = decoded(decoder, first[: len(first) - cut] + second + encode(1, 2, b"", KEY) * 2)
    assert 1 in [frame.sequence for frame in got]


@pytest.mark.unit
def test_foreign_versions_and_lengths_beyond_the_bound_are_counted() -> None:
    import struct
    import zlib

    def head(version: int, length: int) -> bytes:
        fixed = struct.pack(">BBHI", version, 1, length, 0)
        return b"\xd3SNP" + fixed + struct.pack(">H", zlib.crc32(fixed) & 0xFFFF)

    decoder = FrameDecoder()
    good = encode(1, 0, b"ok")
    got = decoded(decoder, head(2, 5) + b"abcde" + head(1, 65_000) + good)
    assert [frame.body for frame in got] == [b"ok"]
    assert decoder.refused["version"] == 1
    assert decoder.refused["oversized"] == 1
    assert decoder.foreign_version == 2
    with pytest.raises(ValueError, match="60001 bytes"):
        encode(1, 0, bytes(frames.MAX_BODY + 1))
    with pytest.raises(ValueError, match="sequence"):
        encode(1, 1 << 32, b"")


@pytest.mark.fuzz
@settings(max_examples=50, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=300), st.integers(0, 9), st.just(b"\xd3SNP\x01")), max_size=12))
def test_arbitrary_bytes_raise_nothing_and_memory_is_bounded(parts: list[bytes | int]) -> None:
    decoder, refused = FrameDecoder(), Counter[str]()
    receiver = Receiver(KEY, refused)
    for part in parts:
        data = part if isinstance(part, bytes) else encode(*((k := pack(EXAMPLES[part]))[0], part, k[1]), KEY)
        for frame in decoder.push(data):
            receiver.accept(frame)
            try:
                unpack(frame.kind, frame.body)
            except MalformedError:
                refused["malformed"] += 1
        assert len(decoder) <= frames.MAX_BODY + frames.OVERHEAD


@pytest.mark.fuzz
@settings(max_examples=150, deadline=None)
@given(st.integers(0, 255), st.binary(max_size=200))
def test_arbitrary_bodies_are_malformed_or_messages(kind: int, body: bytes) -> None:
    try:
        message = unpack(kind, body)
    except MalformedError:
        return
    assert unpack(*pack(message)) == message


_json = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=9),
              st.binary(max_size=9)),
    lambda inner: st.lists(inner, max_size=4), max_leaves=20,
)  # fmt: skip


@pytest.mark.fuzz
@settings(max_examples=60, deadline=None)
@given(st.sampled_from(EXAMPLES), st.data())
def test_arbitrary_fields_are_malformed_or_messages(example: messages.Message, data: st.DataObject) -> None:
    kind, body = pack(example)
    fields = msgpack.unpackb(body)
    fields[data.draw(st.integers(0, len(fields) - 1))] = data.draw(_json)
    try:
        message = unpack(kind, msgpack.packb(fields))
    except MalformedError:
        return
    for value in dataclasses.asdict(message).values():
        assert not isinstance(value, float) or math.isfinite(value)


def keys(a: bytes = b"A", b: bytes = b"B", shared: bytes = KEY) -> SessionKeys:
    return SessionKeys.derive(shared, {"anchor": a, "target": b})


@pytest.mark.law
def test_each_session_direction_and_purpose_has_its_own_key() -> None:
    one, again, other, stranger = keys(), keys(), keys(b"A2"), keys(shared=b"z" * 32)
    assert one == again
    everything = [key for k in (one, other, stranger) for group in (k.proof, k.message) for key in group.values()]
    assert len(set(everything)) == 12
    assert one.proves("anchor", again.proof_of("anchor"))
    assert not one.proves("target", one.proof_of("anchor"))  # reflected
    assert not one.proves("anchor", other.proof_of("anchor"))  # of another session
    assert not one.proves("anchor", stranger.proof_of("anchor"))  # another key
    assert not one.proves("anchor", b"")
    # What hellos say cannot be moved from one to the other.
    assert keys(b"A", b"BC").transcript != keys(b"AB", b"C").transcript
    assert KEY.decode() not in repr(one)


@pytest.mark.unit
def test_receiver_refuses_what_is_not_the_peers_or_was_here() -> None:
    k, refused = keys(), Counter[str]()
    sender, receiver = Sender(k.message["anchor"]), Receiver(k.message["anchor"], refused)
    sent = [next(FrameDecoder().push(sender.frame(5, b"%d" % i))) for i in range(7)]
    assert receiver.accept(sent[0])
    assert not receiver.accept(sent[0])
    assert refused == {"replayed": 1}
    assert receiver.accept(sent[3])  # 1 and 2 are missing
    assert refused["missing"] == 2
    assert not receiver.accept(sent[2])  # overtaken
    assert not receiver.accept(sent[2])  # and again
    assert (refused["late"], refused["replayed"]) == (1, 2)
    own = next(FrameDecoder().push(Sender(k.message["target"]).frame(5, b"reflected")))
    older = next(FrameDecoder().push(Sender(keys(b"old").message["anchor"]).frame(5, b"")))
    bare = next(FrameDecoder().push(encode(5, 9, b"no tag")))
    assert [receiver.accept(f) for f in (own, older, bare)] == [False] * 3
    assert refused["forged"] == 3
    assert receiver.accept(sent[4])  # forgeries moved nothing
    assert not receiver.accept(dataclasses.replace(sent[6], signed=sent[6].signed + b"!"))
    assert receiver.accept(sent[6])
    far = Sender(k.message["anchor"])
    far._next = 50_000
    assert receiver.accept(next(FrameDecoder().push(far.frame(5, b""))))
    assert not receiver.accept(sent[5])  # too long ago to know
    assert refused["replayed"] == 3
    assert refused["missing"] == 3 + 50_000 - 7


@pytest.mark.unit
def test_a_session_ends_before_its_numbers_repeat() -> None:
    sender = Sender(KEY)
    sender._next = (1 << 32) - 1
    sender.frame(1, b"")
    with pytest.raises(OverflowError):
        sender.frame(1, b"")


@pytest.mark.unit
def test_keys_come_from_a_file_or_the_environment(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOOPNAV_PEER_KEY", raising=False)
    with pytest.raises(ValueError, match="--key-file"):
        frames.read_key()
    monkeypatch.setenv("SOOPNAV_PEER_KEY", "0123456789abcdef ")
    assert frames.read_key() == b"0123456789abcdef"
    path = tmp_path / "key"
    path.write_bytes(b"  short secret\n")
    with pytest.raises(ValueError, match="a key of 12 bytes; at least 16") as refusal:
        frames.read_key(path)
    assert "secret" not in str(refusal.value)
    path.write_bytes(b"a secret of twenty-four..\n")
    assert frames.read_key(path) == b"a secret of twenty-four.."
