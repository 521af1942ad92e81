"""An end of the connection at work: accept or connect, reconnect, say what the role says, stop when all is done."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from soopnav_cpp.peer.link import Link
from soopnav_cpp.peer.messages import Bye, Heartbeat, Info, Message

__all__ = ["Address", "PeerRefusedError", "Role", "Session", "SessionOptions", "Traffic", "parse_address"]

_READ_BYTES = 1 << 16
_MOST_GREETING = 4  # connections at a time that have not shown the key
_BYES = 8
_OUT_BYTES = 1 << 18  # waiting to be sent, above which the role waits


class PeerRefusedError(ValueError):
    """The two ends do not fit: keys, versions, roles, rates, times. The message says which, in a sentence."""


class Role(Protocol):
    """What `Anchor` and `Target` are to a session. Nothing here raises for what the peer does: what it raises (a full
    disk, say) ends the session's `run`."""

    role: str
    snippet_rate_hz: float

    def info(self) -> Info: ...

    def attach(self, peer: Info) -> str:
        """A session has begun; not empty: why it cannot be, in a sentence."""
        ...

    def detach(self) -> None: ...

    def handle(self, message: Message, now: float) -> list[Message]: ...

    def step(self, now: float) -> list[Message] | None:
        """Do a piece of work; None: nothing to do for now."""
        ...

    def heartbeat(self) -> Heartbeat: ...

    @property
    def finished(self) -> bool:
        """Whether nothing more can come of a session."""
        ...


@dataclass(frozen=True)
class Address:
    """``host:port``, or a Unix socket's path.

    Attributes
    ----------
    host : str
    port : int
        0: any free one, for `listen`.
    path : Path or None
    """

    host: str = ""
    port: int = 0
    path: Path | None = None

    def __str__(self) -> str:
        if self.path is not None:
            return f"unix:{self.path}"
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


_TCP = re.compile(r"^(?:\[(?P<six>[^\]]+)\]|(?P<host>[^:\[\]]*)):(?P<port>\d{1,5})$")


def parse_address(text: str) -> Address:
    """``host:port``, ``[IPv6]:port``, ``:port`` (this machine), ``unix:PATH``.

    Raises
    ------
    ValueError
        For anything else.
    """
    if text.startswith("unix:"):
        path = text.removeprefix("unix:")
        if not path:
            raise ValueError(f"address {text!r}: unix:PATH expected")
        return Address(path=Path(path))
    match = _TCP.match(text)
    if match is None or int(match["port"]) > 65535:
        raise ValueError(f"address {text!r}: HOST:PORT, [IPv6]:PORT or unix:PATH expected")
    return Address(host=match["six"] or match["host"] or "localhost", port=int(match["port"]))


@dataclass(frozen=True)
class SessionOptions:
    """Times [s] of a session.

    Attributes
    ----------
    wait_s : float
        Without a peer, after which an end gives up.
    retry_s, heartbeat_s, silence_s : float
        As `Link`.
    first_backoff_s, most_backoff_s : float
        Between attempts to connect: doubled each time.
    """

    wait_s: float = 60.0
    retry_s: float = 0.5
    heartbeat_s: float = 1.0
    silence_s: float = 5.0
    first_backoff_s: float = 0.2
    most_backoff_s: float = 5.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not value > 0.0:
                raise ValueError(f"{name} = {value:g}: above zero expected")


@dataclass
class Traffic:
    """What a session saw.

    Attributes
    ----------
    sessions, attempts, lost : int
        Sessions that began; attempts to connect that failed; sessions that were lost.
    sent_bytes, received_bytes : int
    refused : Counter
        Frames, messages and connections, by reason; the reasons are a fixed set of names.
    """

    sessions: int = 0
    attempts: int = 0
    lost: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0
    refused: Counter[str] = field(default_factory=Counter)


class Session:
    """Runs a role over a socket until it is done.

    Parameters
    ----------
    role : Role
    key : bytes
        Shared.
    address : Address
    listen : bool
        Accept connections; otherwise connect, again and again.
    options : SessionOptions
    on_listening : callable, optional
        Told the address once it is there.
    clock : callable
        Monotonic seconds.

    Attributes
    ----------
    traffic : Traffic
    state : str
        ``waiting``, ``connected``, ``done``.
    """

    def __init__(
        self,
        role: Role,
        key: bytes,
        address: Address,
        *,
        listen: bool,
        options: SessionOptions | None = None,
        on_listening: Callable[[Address], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.traffic = Traffic()
        self.state = "waiting"
        self._role, self._key, self._address, self._listen = role, key, address, listen
        self._options = options or SessionOptions()
        self._on_listening, self._clock = on_listening, clock
        self._link: Link | None = None  # the open one
        self._alone_since = clock()
        self._greeting: dict[int, Link] = {}  # not open yet, the oldest first
        self._accepted_tasks: set[asyncio.Task[Any]] = set()
        self._wakes: dict[int, asyncio.Event] = {}  # of connections, by their link
        self._over = asyncio.Event()
        self._refusal = ""
        self._error: Exception | None = None  # of the role, in an accepted connection
        self._closing = 0  # good-byes said

    async def run(self) -> None:
        """Until both are done, or no peer has been there for `wait_s`.

        Raises
        ------
        PeerRefusedError
            When this end connects and the two do not fit, or when an open session finds that they do not.
        OSError
            For an address that cannot be listened at.
        Exception
            What the role raised.
        """
        self._alone_since = self._clock()
        server = await self._serve() if self._listen else None
        tasks: list[asyncio.Task[Any]] = [asyncio.create_task(self._work())]
        if server is None:
            tasks.append(asyncio.create_task(self._connect()))
        waiter: asyncio.Task[Any] = asyncio.create_task(self._over.wait())
        try:
            await asyncio.wait([waiter, *tasks], return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done() and not task.cancelled() and (error := task.exception()) is not None:
                    raise error
            if self._error is not None:
                raise self._error
        finally:
            if server is not None:
                server.close()
                if self._address.path is not None:
                    self._address.path.unlink(missing_ok=True)
            if self._link is not None:
                self._link.close()
            for link in list(self._greeting.values()):
                self._drop(link, "this end is done")
            for task in (waiter, *tasks):
                task.cancel()
            await asyncio.gather(waiter, *tasks, return_exceptions=True)
            if self._accepted_tasks:  # what was said last is still to be written
                await asyncio.wait(list(self._accepted_tasks), timeout=1.0)
                for accepted in list(self._accepted_tasks):
                    accepted.cancel()
                await asyncio.gather(*self._accepted_tasks, return_exceptions=True)
        self.state = "done"
        if self._refusal:
            raise PeerRefusedError(self._refusal)

    # ---- connections

    async def _serve(self) -> asyncio.Server:
        try:
            return await self._open_server()
        except OSError as error:
            if error.errno is None or error.filename is not None:
                raise
            reason = os.strerror(error.errno) if error.errno > 0 else error.strerror  # below zero: of name look-ups
            raise OSError(error.errno, reason, str(self._address)) from error

    async def _open_server(self) -> asyncio.Server:
        path = self._address.path
        if path is not None:
            _remove_dead(path)
            server = await asyncio.start_unix_server(self._accepted, path)
            path.chmod(0o600)
            address = self._address
        else:
            server = await asyncio.start_server(self._accepted, self._address.host, self._address.port)
            host, port = server.sockets[0].getsockname()[:2]
            address = Address(host=host, port=port)
        if self._on_listening is not None:
            self._on_listening(address)
        return server

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._greeting) >= _MOST_GREETING:
            self.traffic.refused["too many connections"] += 1
            silent = next((link for link in self._greeting.values() if not link.proved), None)
            if silent is None:
                writer.close()
                return
            self._drop(silent, "too many connections")
        task = asyncio.current_task()
        assert task is not None
        self._accepted_tasks.add(task)
        try:
            link = await self._talk(reader, writer)
            if link.refused_as:
                self.traffic.refused[link.refused_as] += 1
        except asyncio.CancelledError:
            pass
        except Exception as error:  # the role's: this end cannot go on
            self._error = self._error or error
            self._over.set()
        finally:
            self._accepted_tasks.discard(task)

    async def _connect(self) -> None:
        backoff_s = self._options.first_backoff_s
        while not self._over.is_set():
            try:
                if self._address.path is not None:
                    reader, writer = await asyncio.open_unix_connection(self._address.path)
                else:
                    reader, writer = await asyncio.open_connection(self._address.host, self._address.port)
            except OSError:
                self.traffic.attempts += 1
            else:
                link = await self._talk(reader, writer)
                if link.refusal:
                    raise PeerRefusedError(link.refusal)
                if link.opened:
                    backoff_s = self._options.first_backoff_s
                else:
                    self.traffic.attempts += 1
            await asyncio.sleep(backoff_s)
            backoff_s = min(2.0 * backoff_s, self._options.most_backoff_s)

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Link:
        """One connection from its beginning to its end."""
        options = self._options
        link = Link(
            self._role.role,
            self._key,
            self._role.info(),
            self._role.snippet_rate_hz,
            self.traffic.refused,
            heartbeat=self._role.heartbeat,
            now=self._clock(),
            retry_s=options.retry_s,
            heartbeat_s=options.heartbeat_s,
            silence_s=options.silence_s,
        )
        self._greeting[id(link)] = link
        wake = asyncio.Event()
        self._wakes[id(link)] = wake
        read = asyncio.create_task(reader.read(_READ_BYTES))
        woken = asyncio.create_task(_wait(wake))
        try:
            while not link.closed:
                link.tick(self._clock())
                await self._write(link, writer)
                await asyncio.wait(
                    [read, woken],
                    timeout=0.25 * min(options.retry_s, options.heartbeat_s),
                    return_when=asyncio.FIRST_COMPLETED,
                )
                if woken.done():
                    wake.clear()
                    woken = asyncio.create_task(_wait(wake))
                if not read.done():
                    continue
                try:
                    data = read.result()
                except OSError as error:
                    link.close(f"the connection broke: {error}")
                    break
                if not data:
                    link.close("the connection ended")
                    break
                read = asyncio.create_task(reader.read(_READ_BYTES))
                said = link.receive(data, self._clock())
                if link.state == "open" and self._greeting.pop(id(link), None) is not None:
                    self._begin(link)
                for message in said:
                    self._handle(link, message)
                if link is self._link:
                    await asyncio.sleep(0)
        finally:
            read.cancel()
            woken.cancel()
            del self._wakes[id(link)]
            self._greeting.pop(id(link), None)
            with contextlib.suppress(asyncio.CancelledError, asyncio.TimeoutError):
                await asyncio.wait_for(self._write(link, writer), 1.0)
            link.close()
            self._end(link)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError, asyncio.TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), 1.0)
            writer.transport.abort()  # a stalled peer would keep it open
        return link

    async def _write(self, link: Link, writer: asyncio.StreamWriter) -> None:
        data = link.outgoing()
        if data:
            self.traffic.sent_bytes += len(data)
            writer.write(data)
            await self._drain(link, writer)

    async def _drain(self, link: Link, writer: asyncio.StreamWriter) -> None:
        """Wait until the peer has taken what is written, as long as it takes anything."""
        left = writer.transport.get_write_buffer_size()
        while True:
            try:
                await asyncio.wait_for(writer.drain(), self._options.silence_s)
                return
            except asyncio.TimeoutError:
                before, left = left, writer.transport.get_write_buffer_size()
                if left >= before:
                    link.close("the peer is silent")
                    return
            except OSError as error:
                link.close(f"the connection broke: {error}")
                return

    def _drop(self, link: Link, why: str) -> None:
        """Close a connection, and let it notice at once."""
        self._greeting.pop(id(link), None)
        link.close(why)
        if (wake := self._wakes.get(id(link))) is not None:
            wake.set()

    def _begin(self, link: Link) -> None:
        assert link.peer is not None
        if self._link is not None:  # half-open: the peer is here again
            before, self._link = self._link, None
            self._drop(before, "a newer session began")
            self._role.detach()
            self.traffic.lost += 1
        refusal = self._role.attach(link.peer)
        if refusal:
            link.send(Bye(True, refusal), self._clock())
            self._refusal = refusal
            link.close(refusal)
            self._over.set()
            return
        self._link = link
        self.state = "connected"
        self.traffic.sessions += 1

    def _end(self, link: Link) -> None:
        self.traffic.received_bytes += link.received_bytes
        if link is self._link:
            self._link = None
            self._role.detach()
            self._alone_since = self._clock()
            self.state = "waiting"
            if self._closing:  # good-bye was said; the answer may have been lost
                self._over.set()
            if link.bye is None and not self._over.is_set():
                self.traffic.lost += 1

    def _handle(self, link: Link, message: Message) -> None:
        if link is not self._link or self._over.is_set():
            return
        now = self._clock()
        if isinstance(message, Bye):
            if message.final:
                if not self._closing and not self._role.finished and message.text != "done":
                    self._refusal = f"the peer ends the session: {message.text}"
                link.send(Bye(True, "done"), now)
                self._over.set()
            link.close()
            return
        self._say(link, self._role.handle(message, now))

    def _say(self, link: Link, said: Sequence[Message]) -> None:
        for message in said:
            link.send(message, self._clock())
        if said and (wake := self._wakes.get(id(link))) is not None:
            wake.set()

    # ---- work

    async def _work(self) -> None:
        """Let the role work, and notice the end."""
        good_bye = 0.0
        while not self._over.is_set():
            now = self._clock()
            link = self._link
            if self._role.finished and link is not None:
                if now >= good_bye:
                    good_bye = now + self._options.retry_s
                    self._say(link, [Bye(True, "done")])
                    self._closing += 1
                    if self._closing > _BYES:
                        self._over.set()
                await asyncio.sleep(0.02)
                continue
            if link is None and now - self._alone_since > self._options.wait_s:
                self._over.set()
                return
            if link is not None and link.waiting_bytes > _OUT_BYTES:
                await asyncio.sleep(0.02)
                continue
            said = self._role.step(now)
            if said is None:
                await asyncio.sleep(0.02)
                continue
            if link is not None and link is self._link:
                self._say(link, said)
            await asyncio.sleep(0)


async def _wait(event: asyncio.Event) -> None:
    await event.wait()


def _remove_dead(path: Path) -> None:
    """A socket that nobody listens at is in the way; one that is used is in use."""
    if not path.is_socket():
        if path.exists():
            raise FileExistsError(errno.EEXIST, "not a socket", str(path))
        return
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise OSError(errno.EADDRINUSE, "address already in use", str(path)) from error
        else:
            raise OSError(errno.EADDRINUSE, "address already in use", str(path))
