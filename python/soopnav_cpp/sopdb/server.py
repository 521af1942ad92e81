"""Runs the service by uvicorn, on a port or on a Unix socket, until it is told to end."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import errno
import ipaddress
import logging
import os
import signal
import socket
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import uvicorn
import uvicorn.config
from uvicorn.protocols.http.h11_impl import H11Protocol

from soopnav_cpp.sopdb.auth import HideTokens
from soopnav_cpp.sopdb.service import create_app
from soopnav_cpp.sopdb.settings import ServiceSettings
from soopnav_cpp.sopdb.store import Store

__all__ = ["listen", "serve"]

_CONNECTIONS = 1000
_HEADER_BYTES = 32_768
_HEADER_S = 10.0


def listen(
    host: str = "127.0.0.1", port: int = 8765, *, unix: str | Path | None = None, unix_mode: int = 0o660
) -> socket.socket:
    """A socket that listens, and is inherited by nobody.

    Parameters
    ----------
    host : str
    port : int
        0: any that is free.
    unix : path, optional
        A Unix socket in place of both. What an earlier server left there is removed, unless it still listens.
    unix_mode : int
        Who may connect to it: everybody who may write to it, by default the owner and the group.

    Raises
    ------
    ValueError
        For a port that cannot be, a path that is something else than a socket, and a mode that is none.
    OSError
        When the address is in use, or not this machine's.
    """
    if unix is not None:
        return _listen_unix(Path(unix), unix_mode)
    if not 0 <= port <= 65535:
        raise ValueError(f"port is {port}; it must be in [0, 65535]")
    try:
        family = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    except ValueError:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    # With the protocol named, asyncio switches off the waiting for more to send: it would cost 40 ms an answer.
    found = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host, port))
    except BaseException:
        found.close()
        raise
    return found


def _listen_unix(path: Path, mode: int) -> socket.socket:
    if not 0 <= mode <= 0o777:
        raise ValueError(f"unix_mode is {mode:o}; it must be in [0, 777], octal")
    if path.exists():
        if not stat.S_ISSOCK(path.stat().st_mode):
            raise ValueError(f"unix is {path}, which is a file; a new path expected")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
            other.settimeout(1.0)
            try:
                other.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()  # nobody listens
            else:
                raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE), str(path))
    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        found.bind(str(path))
        path.chmod(mode)  # nobody connects before it listens
    except BaseException:
        found.close()
        raise
    return found


def _inode(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


class _Impatient(H11Protocol):
    """Closes a connection whose request, once it may begin, has not all of its head after `_HEADER_S`.

    Half a request would otherwise hold its connection for ever, and a thousand of them the service.
    """

    _waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        self._rest()
        super().connection_lost(exc)

    def _watch(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._rest()
        elif self._waiting is None:
            self._waiting = self.loop.call_later(_HEADER_S, self.transport.close)

    def _rest(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None


def serve(
    store: Store,
    settings: ServiceSettings | None = None,
    *,
    at: socket.socket | None = None,
    proxies: str | None = None,
    log_level: str = "info",
    ready: Callable[[str], Any] | None = None,
) -> None:
    """Answer requests until SIGINT or SIGTERM; then finish those that are being answered, and return.

    Parameters
    ----------
    store : Store
        Stays the caller's to close, after this.
    settings : ServiceSettings, optional
    at : socket, optional
        Of `listen`; without it ``127.0.0.1:8765``.
    proxies : str, optional
        Addresses of proxies whose ``X-Forwarded-For`` is believed, with commas between; for a Unix socket, ``*``.
    log_level : str
        Of uvicorn: ``"critical"`` to ``"debug"``.
    ready : callable, optional
        Called with the URL, once requests are taken.
    """
    sock = at or listen()
    address = sock.getsockname()
    own = _inode(Path(address)) if isinstance(address, str) and address else None
    if isinstance(address, (str, bytes)):
        url = f"unix:{os.fsdecode(address)}"
    else:
        url = f"http://{f'[{address[0]}]' if ':' in address[0] else address[0]}:{address[1]}"

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            if self.started and ready is not None:
                ready(url)

    config = uvicorn.Config(
        create_app(store, settings),
        loop="asyncio",
        http=_Impatient,
        lifespan="off",
        log_level=log_level,
        log_config=_logging(),
        proxy_headers=proxies is not None,
        forwarded_allow_ips=proxies,
        server_header=False,
        limit_concurrency=_CONNECTIONS,
        h11_max_incomplete_event_size=_HEADER_BYTES,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=10,
    )
    interval_s = sys.getswitchinterval()
    try:
        # Reads wait for the interpreter while a write computes: a tenth of the usual turn.
        sys.setswitchinterval(0.1 * interval_s)
        with _signals_that_return():
            Server(config).run(sockets=[sock])
    finally:
        sys.setswitchinterval(interval_s)
        sock.close()
        if own is not None and own == _inode(Path(address)):  # another server may have taken the path since
            Path(address).unlink(missing_ok=True)


@contextlib.contextmanager
def _signals_that_return() -> Iterator[None]:
    """Uvicorn raises the signal that ended it once more; so that the caller can close its store, nothing follows."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {one: signal.signal(one, lambda *_: None) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _logging() -> dict[str, Any]:
    """Uvicorn's logging with times and without secrets, on the standard error."""
    found: dict[str, Any] = copy.deepcopy(uvicorn.config.LOGGING_CONFIG)
    for formatter in found["formatters"].values():
        formatter["fmt"] = "%(asctime)s " + formatter["fmt"]
        formatter["use_colors"] = False
    found["filters"] = {"tokens": {"()": HideTokens}}
    for handler in found["handlers"].values():
        handler["filters"] = ["tokens"]
        handler["stream"] = "ext://sys.stderr"
    found["loggers"]["soopnav.sopdb"] = {"handlers": ["default"], "level": logging.INFO, "propagate": False}
    return found
