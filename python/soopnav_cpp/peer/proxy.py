"""A bad connection for trials: a proxy between two ends that loses, damages, repeats and delays whole frames."""

from __future__ import annotations

import asyncio
import contextlib
import random
import threading
from collections import Counter
from collections.abc import Callable

from soopnav_cpp.peer.frames import OVERHEAD, FrameDecoder
from soopnav_cpp.peer.session import Address

__all__ = ["BadConnection", "Faults"]

_LENGTH = slice(6, 8)
_KIND = 5
_HEAD = 14


class Faults:
    """What befalls each frame, by chance from a seed.

    Parameters
    ----------
    seed : int
    lost, damaged, repeated, delayed : float
        Probabilities. Damaged: one bit is changed. Delayed: it comes after the next one.

    Attributes
    ----------
    counts : Counter
    """

    def __init__(
        self, seed: int, *, lost: float = 0.0, damaged: float = 0.0, repeated: float = 0.0, delayed: float = 0.0
    ) -> None:
        limits = {"lost": lost, "damaged": damaged, "repeated": repeated, "delayed": delayed}
        if min(limits.values()) < 0.0 or sum(limits.values()) > 1.0:
            raise ValueError(f"lost ... delayed = {limits}: probabilities that add up to 1 at most expected")
        self.counts: Counter[str] = Counter()
        self._limits = limits
        self._draw = random.Random(seed)
        self._held: dict[bool, bytes] = {}  # by the direction

    def __call__(self, frame: bytes, to_listener: bool) -> list[bytes]:
        """The frames that come out in place of one."""
        fate, chance = "passed", self._draw.random()
        for name, share in self._limits.items():
            if chance < share:
                fate = name
                break
            chance -= share
        self.counts[fate] += 1
        held = self._held.pop(to_listener, None)
        behind = [] if held is None else [held]
        if fate == "lost":
            return behind
        if fate == "damaged":
            at, bit = self._draw.randrange(len(frame)), self._draw.randrange(8)
            return [frame[:at] + bytes([frame[at] ^ (1 << bit)]) + frame[at + 1 :], *behind]
        if fate == "repeated":
            return [frame, frame, *behind]
        if fate == "delayed":
            self._held[to_listener] = frame
            return behind
        return [frame, *behind]


def _whole(frame: bytes) -> bool:
    return any(True for _ in FrameDecoder().push(frame))


class BadConnection:
    """Accepts connections on this machine and passes what it hears on to `inner`, but for what `faults` does to it.

    It runs in a thread of its own between ``with`` and its end.

    Parameters
    ----------
    inner : Address
        Where the listening end is.
    faults : callable
        ``faults(frame, to_listener)``: frames that come out in place of one, as `Faults`.
    on_frame : callable, optional
        ``on_frame(kind)``, told of each frame that comes out whole to the connecting end: of none that was lost or
        damaged, of a delayed one when it comes, of a repeated one twice.

    Attributes
    ----------
    address : Address
        Where to connect.
    """

    def __init__(
        self,
        inner: Address,
        faults: Callable[[bytes, bool], list[bytes]],
        *,
        on_frame: Callable[[int], None] | None = None,
    ) -> None:
        self.address = Address()
        self._inner, self._faults, self._on_frame = inner, faults, on_frame
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._stop = asyncio.Event()
        self._writers: set[asyncio.StreamWriter] = set()
        self._thread = threading.Thread(target=self._run, name="bad connection", daemon=True)

    def __enter__(self) -> BadConnection:
        self._thread.start()
        self._ready.wait(10.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10.0)

    def cut(self) -> None:
        """Break all connections."""

        def close() -> None:
            for writer in list(self._writers):
                writer.close()

        self._loop.call_soon_threadsafe(close)

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._accepted, "127.0.0.1", 0)
        self.address = Address("127.0.0.1", server.sockets[0].getsockname()[1])
        self._ready.set()
        await self._stop.wait()
        server.close()
        for writer in list(self._writers):
            writer.close()
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if self._inner.path is not None:
                far_reader, far_writer = await asyncio.open_unix_connection(self._inner.path)
            else:
                far_reader, far_writer = await asyncio.open_connection(self._inner.host, self._inner.port)
        except OSError:
            writer.close()
            return
        ends = (writer, far_writer)
        self._writers.update(ends)
        try:
            await asyncio.gather(self._pump(reader, far_writer, True), self._pump(far_reader, writer, False))
        except asyncio.CancelledError:
            pass
        finally:
            self._writers.difference_update(ends)
            for end in ends:
                end.close()
                with contextlib.suppress(OSError, asyncio.CancelledError):
                    await end.wait_closed()

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, to_listener: bool) -> None:
        held = bytearray()
        with contextlib.suppress(OSError):
            while data := await reader.read(1 << 16):
                held += data
                while len(held) >= _HEAD and len(held) >= (size := OVERHEAD + int.from_bytes(held[_LENGTH], "big")):
                    frame = bytes(held[:size])
                    del held[:size]
                    for out in self._faults(frame, to_listener):
                        writer.write(out)
                        if self._on_frame is not None and not to_listener and _whole(out):
                            self._on_frame(out[_KIND])
                await writer.drain()
        writer.close()
