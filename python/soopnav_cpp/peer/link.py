"""One connection of two receivers: hello, proof, what each listens to, then messages. No input or output of its own.

States: ``greeting`` (hello said), ``proving`` (both hellos are there, so are the keys), ``informing`` (the peer has
proved that it knows the key), ``open`` (both know what the other listens to, and this end knows that they do),
``closed``. Until it is open, what was said is said again every `retry_s`, and an `Info` that does not answer one's own
is answered. So the beginning of a session survives lost messages.
"""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Callable

from soopnav_cpp.peer import messages
from soopnav_cpp.peer.frames import VERSION, FrameDecoder, Receiver, Sender, SessionKeys, encode
from soopnav_cpp.peer.messages import Bye, Heartbeat, Hello, Info, Kind, MalformedError, Message, Proof, Refuse

__all__ = ["GREETING_S", "PROOF_S", "Link"]

GREETING_S = 20.0  # in which a session must be open
PROOF_S = 3.0  # in which the peer must have shown that it knows the key
_CLEAR = (Kind.HELLO, Kind.PROOF, Kind.REFUSE)


class Link:
    """The protocol of one connection.

    Parameters
    ----------
    role : {"anchor", "target"}
    key : bytes
        Shared.
    info : Info
    snippet_rate_hz : float
    refused : Counter
        Where refusals are counted: those of the frames, ``malformed`` and ``unexpected``.
    heartbeat : callable
        What to say when nothing else is to be said.
    retry_s, heartbeat_s, silence_s : float
        Between repeated greetings; between heartbeats; without a valid message, after which the peer counts as lost.
    random : callable
        ``random(n)``: n random bytes.

    Attributes
    ----------
    state : str
    peer : Info or None
        What the peer listens to, once the session is open.
    refusal : str
        Why there can be no session, in a sentence; empty when there can.
    refused_as : str
        The same as one of a fixed set of names, to be counted: ``keys differ``, ``same role``, ``snippet rates
        differ``, ``another version``, ``refused by the peer``; empty when there can be a session.
    lost : str
        Why the connection is given up; another one may do.
    bye : Bye or None
        With which the peer ended the session.
    sent_bytes, received_bytes : int
    """

    def __init__(
        self,
        role: str,
        key: bytes,
        info: Info,
        snippet_rate_hz: float,
        refused: Counter[str],
        *,
        heartbeat: Callable[[], Heartbeat],
        now: float,
        retry_s: float = 0.5,
        heartbeat_s: float = 1.0,
        silence_s: float = 5.0,
        random: Callable[[int], bytes] = os.urandom,
    ) -> None:
        self.role = role
        self._was_open = self._proved = False
        self.state = "greeting"
        self.peer: Info | None = None
        self.refusal = ""
        self.refused_as = ""
        self.lost = ""
        self.bye: Bye | None = None
        self.sent_bytes = 0
        self.received_bytes = 0
        self._key, self._info, self._refused, self._heartbeat = key, info, refused, heartbeat
        self._retry_s, self._heartbeat_s, self._silence_s = retry_s, heartbeat_s, silence_s
        self._decoder = FrameDecoder(refused)
        self._out = bytearray()
        self._hello = messages.pack(Hello(role, random(16), snippet_rate_hz))[1]
        self._rate_hz = snippet_rate_hz
        self._keys: SessionKeys | None = None
        self._peer_hello = b""
        self._peer_role = ""
        self._sender: Sender | None = None
        self._receiver: Receiver | None = None
        self._began = self._heard = self._said = self._greeted = now
        self._clear(Kind.HELLO, self._hello)

    @property
    def closed(self) -> bool:
        """Whether nothing more comes of this connection."""
        return self.state == "closed"

    @property
    def proved(self) -> bool:
        """Whether the peer has shown that it knows the key."""
        return self._proved

    @property
    def opened(self) -> bool:
        """Whether there was a session, be it over."""
        return self._was_open

    @property
    def waiting_bytes(self) -> int:
        """Said, and not handed out yet."""
        return len(self._out)

    def outgoing(self) -> bytes:
        """Bytes to be written; they are handed out once."""
        data = bytes(self._out)
        self._out.clear()
        self.sent_bytes += len(data)
        return data

    def send(self, message: Message, now: float) -> None:
        """Say something in an open session; otherwise it is dropped."""
        if self.state == "open":
            self._signed(message, now)

    def close(self, why: str = "") -> None:
        """No more of this connection."""
        self.state = "closed"
        self.lost = self.lost or why

    def receive(self, data: bytes, now: float) -> list[Message]:
        """Take bytes; the messages for the role, in an open session."""
        self.received_bytes += len(data)
        taken: list[Message] = []
        for frame in self._decoder.push(data):
            if self.closed:
                continue
            if frame.kind not in _CLEAR and (self._receiver is None or self.state == "proving"):
                self._refused["unexpected"] += 1
                continue
            if frame.kind not in _CLEAR and self._receiver is not None and not self._receiver.accept(frame):
                continue
            try:
                message = messages.unpack(frame.kind, frame.body)
            except MalformedError:
                self._refused["malformed"] += 1
                continue
            self._take(message, frame.body, now, taken)
        if self.state == "greeting" and self._decoder.foreign_version is not None:
            other = self._decoder.foreign_version
            self._refuse(
                "another version", f"the peer speaks version {other} of the protocol, this one version {VERSION}"
            )
        return taken

    def tick(self, now: float) -> None:
        """Repeat what may have been lost, say that one lives, and notice that the peer does not."""
        if self.closed:
            return
        if self.state != "open":
            if now - self._began > GREETING_S:
                self.close(f"no session within {GREETING_S:g} s")
            elif not self._proved and now - self._began > PROOF_S:
                self.close(f"no proof of the key within {PROOF_S:g} s")
            elif now - self._greeted >= self._retry_s:
                self._greet_again(now)
        elif now - self._heard > self._silence_s:
            self.close("the peer is silent")
        elif now - self._said >= self._heartbeat_s:
            self._signed(self._heartbeat(), now)

    def _take(self, message: Message, body: bytes, now: float, taken: list[Message]) -> None:
        if isinstance(message, Hello):
            self._take_hello(message, body)
        elif isinstance(message, Refuse):
            if self.state == "open":
                self._refused["unexpected"] += 1  # not signed
            else:
                self.refusal, self.refused_as = f"the peer refuses: {message.text}", "refused by the peer"
                self.close()
        elif isinstance(message, Proof):
            self._take_proof(message, now)
        else:
            self._heard = now
            if isinstance(message, Info):
                self._take_info(message, now)
            elif self.peer is None:
                self._refused["unexpected"] += 1
            else:
                self._open()  # the peer would not speak without knowing this end's info
                if isinstance(message, Bye):
                    self.bye = message
                taken.append(message)

    def _take_info(self, info: Info, now: float) -> None:
        """A session is open once this end has the peer's info and knows that the peer has its own."""
        self.peer = self.peer or info
        if self.state == "informing" and info.answers:
            self._open()
            self._inform(now)
        elif not info.answers:
            self._inform(now)

    def _open(self) -> None:
        self.state = "open"
        self._was_open = True

    def _take_hello(self, hello: Hello, body: bytes) -> None:
        if self._keys is not None:
            if body != self._peer_hello:
                self._refused["unexpected"] += 1
            return
        if hello.role == self.role:
            self._refuse("same role", f"both ends are {self.role}s; one of them needs --role {_other(self.role)}")
        elif hello.snippet_rate_hz != self._rate_hz:
            self._refuse(
                "snippet rates differ",
                f"snippets of {self._rate_hz:g} Hz by the {self.role} and of {hello.snippet_rate_hz:g} Hz by the "
                f"{hello.role}; the same --snippet-rate is needed",
            )
        else:
            self._peer_hello, self._peer_role = body, hello.role
            self._keys = SessionKeys.derive(self._key, {self.role: self._hello, hello.role: body})
            self._sender = Sender(self._keys.message[self.role])
            self._receiver = Receiver(self._keys.message[hello.role], self._refused)
            self.state = "proving"
            self._clear(Kind.HELLO, self._hello)  # the peer may have come after the first
            self._prove()

    def _take_proof(self, proof: Proof, now: float) -> None:
        if self._keys is None:
            self._refused["unexpected"] += 1
        elif self.state == "proving":
            if self._keys.proves(self._peer_role, proof.proof):
                self.state, self._proved = "informing", True
                self._inform(now)
            else:
                self._refuse("keys differ", "the keys of the two ends differ")

    def _greet_again(self, now: float) -> None:
        self._greeted = now
        self._clear(Kind.HELLO, self._hello)
        if self._keys is not None:
            self._prove()
        if self.state == "informing":
            self._inform(now)

    def _inform(self, now: float) -> None:
        self._signed(dataclasses.replace(self._info, answers=self.peer is not None), now)

    def _prove(self) -> None:
        if self._keys is not None:
            self._clear(Kind.PROOF, messages.pack(Proof(self._keys.proof_of(self.role)))[1])

    def _refuse(self, name: str, text: str) -> None:
        self.refused_as, self.refusal = name, text
        self._clear(Kind.REFUSE, messages.pack(Refuse(text))[1])
        self.close()

    def _clear(self, kind: Kind, body: bytes) -> None:
        self._out += encode(int(kind), 0, body)

    def _signed(self, message: Message, now: float) -> None:
        if self._sender is None:
            return
        try:
            self._out += self._sender.frame(*messages.pack(message))
        except OverflowError:
            self.close("the session has no more sequence numbers")
        self._said = now


def _other(role: str) -> str:
    return "target" if role == "anchor" else "anchor"
