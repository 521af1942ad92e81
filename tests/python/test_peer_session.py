"""Sessions of two receivers: they find each other, survive what a bad connection does, and refuse what does not fit."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from soopnav_cpp.peer import frames, messages
from soopnav_cpp.peer.link import Link
from soopnav_cpp.peer.messages import Decline, Heartbeat, Hello, Info, Message, Propose, Refuse, Snippet
from soopnav_cpp.peer.proxy import BadConnection, Faults
from soopnav_cpp.peer.session import Address, PeerRefusedError, Session, SessionOptions, parse_address

pytest.importorskip("msgpack")

KEY = b"0123456789abcdef"
INFO = Info(1_409_097_600, 0.0, 60.0, 0.0, 250e3, 1626e6)
FAST = SessionOptions(
    wait_s=5.0, retry_s=0.03, heartbeat_s=0.05, silence_s=0.4, first_backoff_s=0.02, most_backoff_s=0.1
)


class Chatter:
    """Says its numbers one by one until all are answered; answers those of the other."""

    snippet_rate_hz = 50e3

    def __init__(self, role: str, numbers: int, *, refusal: str = "") -> None:
        self.role = role
        self.left = list(range(numbers))
        self.heard: list[int] = []
        self.attached = self.detached = 0
        self.said_at = 0.0
        self.refusal = refusal

    def info(self) -> Info:
        return INFO

    def attach(self, peer: Info) -> str:
        assert replace(peer, answers=False) == INFO
        self.attached += 1
        return self.refusal

    def detach(self) -> None:
        self.detached += 1

    def handle(self, message: Message, now: float) -> list[Message]:
        if isinstance(message, Propose):
            self.heard.append(message.id)
            return [Decline(message.id, "heard")]
        if isinstance(message, Decline) and message.id in self.left:
            self.left.remove(message.id)
        return []

    def step(self, now: float) -> list[Message] | None:
        if not self.left or self.attached == self.detached or now - self.said_at < 0.01:
            return None
        self.said_at = now
        return [Propose(self.left[0], "x")]

    def heartbeat(self) -> Heartbeat:
        return Heartbeat(0.0, not self.left, 0)

    @property
    def finished(self) -> bool:
        return self.role == "target" and not self.left


async def both(
    anchor: Chatter,
    target: Chatter,
    *,
    address: Address | None = None,
    faults: Faults | None = None,
    keys: tuple[bytes, bytes] = (KEY, KEY),
    options: SessionOptions = FAST,
) -> tuple[Session, Session]:
    there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
    listening = Session(
        anchor, keys[0], address or Address("127.0.0.1", 0), listen=True, options=options, on_listening=there.set_result
    )
    first = asyncio.create_task(listening.run())
    inner = await there
    try:
        if faults is None:
            connecting = Session(target, keys[1], inner, listen=False, options=options)
            await connecting.run()
        else:
            with BadConnection(inner, faults) as proxy:
                connecting = Session(target, keys[1], proxy.address, listen=False, options=options)
                await connecting.run()
        await first
    finally:
        first.cancel()
    return listening, connecting


@pytest.mark.unit
@pytest.mark.parametrize("kind", ["tcp", "six", "unix"])
def test_two_ends_talk_until_both_are_done(kind: str, tmp_path: Path) -> None:
    address = {"tcp": Address("127.0.0.1", 0), "six": Address("::1", 0), "unix": Address(path=tmp_path / "s")}[kind]
    anchor, target = Chatter("anchor", 5), Chatter("target", 9)
    listening, connecting = asyncio.run(both(anchor, target, address=address))
    assert target.left == []
    assert anchor.heard[-1] == 8
    assert anchor.attached == target.attached == anchor.detached == target.detached == 1
    for session in (listening, connecting):
        assert (session.traffic.sessions, session.traffic.lost, session.traffic.refused) == (1, 0, {})
        assert session.state == "done"
    assert listening.traffic.sent_bytes == connecting.traffic.received_bytes
    assert not (tmp_path / "s").exists()


@pytest.mark.law
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4))])
def test_lost_damaged_repeated_and_overtaken_messages_are_counted_and_survived(seed: int) -> None:
    faults = Faults(seed, lost=0.20, damaged=0.10, repeated=0.05, delayed=0.05)
    anchor, target = Chatter("anchor", 20), Chatter("target", 20)
    listening, connecting = asyncio.run(both(anchor, target, faults=faults))
    assert target.left == []
    refused = listening.traffic.refused + connecting.traffic.refused
    assert refused["missing"] > 5
    assert refused["damaged"] > 1
    assert refused["replayed"] + refused["late"] >= 1
    assert set(refused) <= {
        "missing", "damaged", "replayed", "late", "garbage", "forged", "unexpected", "version", "oversized",
    }  # fmt: skip


@pytest.mark.unit
def test_a_connection_that_breaks_is_made_again() -> None:
    async def run() -> tuple[Session, Session]:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(
            anchor, KEY, Address("127.0.0.1", 0), listen=True, options=FAST, on_listening=there.set_result
        )
        first = asyncio.create_task(listening.run())
        with BadConnection(await there, lambda frame, _: [frame]) as proxy:
            connecting = Session(target, KEY, proxy.address, listen=False, options=FAST)
            second = asyncio.create_task(connecting.run())
            while len(target.left) > 10:
                await asyncio.sleep(0.01)
            proxy.cut()
            await second
            await first
        return listening, connecting

    anchor, target = Chatter("anchor", 0), Chatter("target", 20)
    listening, connecting = asyncio.run(run())
    assert target.left == []
    assert connecting.traffic.sessions == 2
    assert connecting.traffic.lost == 1
    assert target.attached == target.detached == 2
    assert listening.traffic.sessions == 2


@pytest.mark.unit
def test_a_peer_that_falls_silent_is_lost() -> None:
    passing = True

    async def run() -> None:
        nonlocal passing
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(anchor, KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                            on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        with BadConnection(await there, lambda frame, _: [frame] if passing else []) as proxy:
            connecting = Session(target, KEY, proxy.address, listen=False, options=FAST)
            second = asyncio.create_task(connecting.run())
            while len(target.left) > 5:
                await asyncio.sleep(0.01)
            passing = False
            while not connecting.traffic.lost:
                await asyncio.sleep(0.01)
            passing = True
            await asyncio.gather(first, second)

    anchor, target = Chatter("anchor", 0), Chatter("target", 10)
    asyncio.run(run())
    assert target.left == []


@pytest.mark.unit
def test_ends_that_do_not_fit_are_refused_in_a_sentence() -> None:
    def refusal(anchor: Chatter, target: Chatter, **more: object) -> str:
        with pytest.raises(PeerRefusedError) as caught:
            asyncio.run(both(anchor, target, options=replace(FAST, wait_s=0.1), **more))
        return str(caught.value)

    good = ("anchor", 1), ("target", 1)
    assert "keys of the two ends differ" in refusal(Chatter(*good[0]), Chatter(*good[1]), keys=(KEY, KEY[::-1]))
    assert "both ends are targets; one of them needs --role anchor" in refusal(Chatter("target", 1), Chatter(*good[1]))
    other = Chatter(*good[1])
    other.snippet_rate_hz = 40e3
    assert "40000 Hz by the target and of 50000 Hz by the anchor" in refusal(Chatter(*good[0]), other)
    assert "recordings do not overlap" in refusal(
        Chatter("anchor", 1, refusal="the recordings do not overlap"), Chatter(*good[1])
    )


@pytest.mark.unit
def test_a_stranger_does_not_end_a_listener() -> None:
    async def run() -> Session:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(anchor, KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                            on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        address = await there
        with pytest.raises(PeerRefusedError):
            await Session(Chatter("target", 1), b"another key of it", address, listen=False, options=FAST).run()
        _, writer = await asyncio.open_connection(address.host, address.port)
        writer.write(random.Random(1).randbytes(100_000))
        target = Chatter("target", 3)
        await Session(target, KEY, address, listen=False, options=FAST).run()
        writer.close()
        await first
        assert target.left == []
        return listening

    anchor = Chatter("anchor", 0)
    traffic = asyncio.run(run()).traffic
    assert traffic.sessions == 1
    assert sum(n for reason, n in traffic.refused.items() if "keys" in reason) == 1
    assert traffic.refused["garbage"] >= 1


class Here(Chatter):
    """Speaks while a peer is there, as the roles do, until both have heard each other."""

    here = False

    def attach(self, peer: Info) -> str:
        self.here = True
        return super().attach(peer)

    def detach(self) -> None:
        self.here = False
        super().detach()

    def step(self, now: float) -> list[Message] | None:
        return super().step(now) if self.here else None

    @property
    def finished(self) -> bool:
        return super().finished and 4 in self.heard


@pytest.mark.unit
def test_a_new_session_takes_the_place_of_a_half_open_one() -> None:
    async def run() -> Session:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(anchor, KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                            on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        address = await there
        once = replace(FAST, first_backoff_s=60.0)
        old = asyncio.create_task(Session(Here("target", 1000), KEY, address, listen=False, options=once).run())
        while not listening.traffic.sessions:
            await asyncio.sleep(0.01)
        await asyncio.wait_for(Session(target, KEY, address, listen=False, options=FAST).run(), 4.0)
        await first
        old.cancel()
        await asyncio.gather(old, return_exceptions=True)
        return listening

    anchor, target = Here("anchor", 5), Here("target", 5)
    traffic = asyncio.run(run()).traffic
    assert target.left == anchor.left == []
    assert (traffic.sessions, traffic.lost) == (2, 1)
    assert anchor.attached == anchor.detached == 2


@pytest.mark.unit
@pytest.mark.parametrize("role", ["anchor", "target"])
def test_an_error_of_the_role_ends_the_session(role: str) -> None:
    class Full(Chatter):
        def handle(self, message: Message, now: float) -> list[Message]:
            raise OSError("no space left on device")

    roles = {name: (Full if name == role else Chatter)(name, 3) for name in ("anchor", "target")}

    async def run() -> None:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        ends = {"anchor": Session(roles["anchor"], KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                                  on_listening=there.set_result)}  # fmt: skip
        first = asyncio.create_task(ends["anchor"].run())
        ends["target"] = Session(roles["target"], KEY, await there, listen=False, options=FAST)
        second = asyncio.create_task(ends["target"].run())
        with pytest.raises(OSError, match="no space"):
            await asyncio.wait_for(first if role == "anchor" else second, 3.0)
        for task in (first, second):
            task.cancel()
        await asyncio.gather(first, second, return_exceptions=True)

    asyncio.run(run())
    assert roles[role].attached == roles[role].detached == 1


@pytest.mark.unit
def test_a_peer_that_takes_nothing_is_noticed(tmp_path: Path) -> None:
    """It goes on saying that it lives, and does not read."""

    class Flood(Chatter):
        def step(self, now: float) -> list[Message] | None:
            if self.attached == self.detached:
                return None
            return [Snippet(1, "x", 0.0, 0.0, 6000, 0, 1.0, bytes(48_000), 0.0, (0.0,) * 3, (0.0,) * 3)]

    async def run() -> None:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(anchor, KEY, Address(path=tmp_path / "s"), listen=True,
                            options=replace(FAST, silence_s=0.2), on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        await there
        reader, writer = await asyncio.open_unix_connection(tmp_path / "s")
        end = link("target")
        while end.state != "open":
            writer.write(end.outgoing())
            end.receive(await reader.read(1000), 0.0)
        for _ in range(150):
            end.send(Heartbeat(0.0, False, 0), 0.0)
            writer.write(end.outgoing())
            await asyncio.sleep(0.02)
            if anchor.detached:
                break
        noticed = anchor.detached
        first.cancel()
        writer.transport.abort()
        await asyncio.gather(first, return_exceptions=True)
        assert noticed == anchor.attached == 1

    anchor = Flood("anchor", 1)
    asyncio.run(run())


@pytest.mark.unit
def test_silent_connections_do_not_lock_the_peer_out() -> None:
    async def run() -> Session:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(Chatter("anchor", 0), KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                            on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        address = await there
        silent = [await asyncio.open_connection(address.host, address.port) for _ in range(6)]
        await asyncio.wait_for(Session(target, KEY, address, listen=False, options=FAST).run(), 2.0)
        await first
        for _, writer in silent:
            writer.close()
        return listening

    target = Chatter("target", 3)
    traffic = asyncio.run(run()).traffic
    assert target.left == []
    assert traffic.refused["too many connections"] >= 1
    end = link("anchor")
    end.tick(4.0)
    assert end.closed
    assert "proof" in end.lost


@pytest.mark.unit
def test_refusals_are_counted_by_fixed_names() -> None:
    """Whatever a stranger says: neither memory nor the table is his."""

    async def run() -> Session:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        listening = Session(Chatter("anchor", 0), KEY, Address("127.0.0.1", 0), listen=True, options=FAST,
                            on_listening=there.set_result)  # fmt: skip
        first = asyncio.create_task(listening.run())
        address = await there
        for text in ("[/bold]", "another"):
            reader, writer = await asyncio.open_connection(address.host, address.port)
            kind, body = messages.pack(Refuse(text))
            writer.write(frames.encode(kind, 0, body))
            await reader.read()
            writer.close()
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        return listening

    assert asyncio.run(run()).traffic.refused == {"refused by the peer": 2}


@pytest.mark.unit
def test_addresses_in_use_are_errors(tmp_path: Path) -> None:
    async def run(address: Address) -> None:
        there: asyncio.Future[Address] = asyncio.get_running_loop().create_future()
        one = Session(Chatter("anchor", 0), KEY, address, listen=True, options=FAST, on_listening=there.set_result)
        first = asyncio.create_task(one.run())
        taken = await there
        with pytest.raises(OSError, match="in use"):
            await Session(Chatter("anchor", 0), KEY, taken, listen=True, options=FAST).run()
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)

    asyncio.run(run(Address("127.0.0.1", 0)))
    asyncio.run(run(Address(path=tmp_path / "socket")))
    (tmp_path / "file").write_text("precious")
    session = Session(Chatter("anchor", 0), KEY, Address(path=tmp_path / "file"), listen=True, options=FAST)
    with pytest.raises(FileExistsError):
        asyncio.run(session.run())
    assert (tmp_path / "file").read_text() == "precious"
    nowhere = tmp_path / "nowhere" / "s"
    with pytest.raises(FileNotFoundError, match=str(nowhere)):
        asyncio.run(Session(Chatter("anchor", 0), KEY, Address(path=nowhere), listen=True, options=FAST).run())


@pytest.mark.unit
def test_an_end_without_a_peer_gives_up() -> None:
    options = replace(FAST, wait_s=0.2)
    session = Session(Chatter("target", 1), KEY, Address("127.0.0.1", 9), listen=False, options=options)
    asyncio.run(session.run())
    assert session.traffic.sessions == 0
    assert session.traffic.attempts >= 1


@pytest.mark.unit
def test_faults_add_up_to_one_at_most() -> None:
    for shares in ({"lost": -0.1}, {"lost": 0.6, "damaged": 0.6}):
        with pytest.raises(ValueError, match="probabilities"):
            Faults(1, **shares)
    faults = Faults(1, lost=0.5)
    assert sum(len(faults(b"x", True)) for _ in range(1000)) == faults.counts["passed"] < 600


@pytest.mark.unit
def test_addresses_are_read() -> None:
    assert parse_address("here:80") == Address("here", 80)
    assert parse_address(":80") == Address("localhost", 80)
    assert parse_address("[::1]:80") == Address("::1", 80)
    assert parse_address("unix:/run/x") == Address(path=Path("/run/x"))
    for text in ("here", "here:", "here:70000", "::1:80", "unix:", "here:80:81", "http://here"):
        with pytest.raises(ValueError, match="expected"):
            parse_address(text)
    assert [str(parse_address(t)) for t in ("a:1", "[::1]:2", "unix:/x")] == ["a:1", "[::1]:2", "unix:/x"]
    with pytest.raises(ValueError, match="wait_s"):
        SessionOptions(wait_s=0.0)


def link(role: str, key: bytes = KEY, **more: object) -> Link:
    return Link(role, key, INFO, 50e3, Counter(), heartbeat=lambda: Heartbeat(0.0, False, 0),
                now=0.0, **more)  # fmt: skip


@pytest.mark.unit
def test_old_sessions_cannot_be_played_again() -> None:
    anchor, target = link("anchor"), link("target")
    recorded = b""
    for _ in range(4):
        data = anchor.outgoing()
        recorded += data
        target.receive(data, 0.0)
        anchor.receive(target.outgoing(), 0.0)
    assert anchor.state == target.state == "open"
    anchor.send(Decline(1, "x"), 0.0)
    recorded += anchor.outgoing()
    again = link("target")
    assert again.receive(recorded, 0.0) == []
    assert again.state == "closed"
    assert "keys" in again.refusal  # the proof is of another session
    own = link("target")  # and its own words, turned around
    reflected = own.outgoing()
    own.receive(reflected, 0.0)
    assert "both ends are targets" in own.refusal


@pytest.mark.unit
def test_another_version_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    anchor = link("anchor")
    monkeypatch.setattr(frames, "VERSION", 2)
    foreign = frames.encode(1, 0, messages.pack(Hello("target", bytes(16), 50e3))[1])
    monkeypatch.undo()
    assert anchor.receive(foreign, 0.0) == []
    assert anchor.refusal == "the peer speaks version 2 of the protocol, this one version 1"


@pytest.mark.unit
def test_messages_before_the_keys_are_refused() -> None:
    anchor = link("anchor")
    early = frames.encode(*messages.pack(Propose(1, "x"))[:1], 0, messages.pack(Propose(1, "x"))[1], KEY)
    assert anchor.receive(early, 0.0) == []
    assert anchor._refused == {"unexpected": 1}
    assert anchor.state == "greeting"
    anchor.tick(21.0)
    assert anchor.closed
