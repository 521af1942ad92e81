"""How the service listens: whose socket it takes, who may connect, and how long half a request may last."""

# ruff: noqa: E402

from __future__ import annotations

import asyncio
import socket
import stat
from pathlib import Path
from typing import Any

import pytest

for _module in ("sqlalchemy", "alembic", "fastapi", "uvicorn"):
    pytest.importorskip(_module)

import uvicorn
from uvicorn.server import ServerState

from soopnav_cpp.sopdb import server
from soopnav_cpp.sopdb.store import Store

pytestmark = pytest.mark.unit


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)  # the path of a socket must be short
    return Path("sopdb.sock")


def test_a_unix_socket_is_for_the_group(path: Path) -> None:
    with server.listen(unix=path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    with server.listen(unix=path, unix_mode=0o600):  # nobody listens at the one that was left
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(ValueError, match="unix_mode is 1000; it must be"):
        server.listen(unix=path, unix_mode=0o1000)


def test_a_socket_that_is_listened_at_is_left(path: Path) -> None:
    with server.listen(unix=path) as running:
        running.listen()
        with pytest.raises(OSError, match="in use"):
            server.listen(unix=path)
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))


@pytest.mark.parametrize("taken", [False, True])
def test_only_its_own_socket_is_removed(path: Path, monkeypatch: pytest.MonkeyPatch, taken: bool) -> None:
    def run(self: Any, sockets: list[socket.socket]) -> None:
        if taken:
            path.rename("old")
            server.listen(unix=path).close()

    monkeypatch.setattr(uvicorn.Server, "run", run)
    with Store("x.db") as store:
        server.serve(store, at=server.listen(unix=path))
    assert path.exists() is taken


async def _slowly(config: uvicorn.Config, parts: list[bytes], wait_s: float) -> bytes:
    """What answers a request that comes in parts; to the end of the connection."""
    loop = asyncio.get_running_loop()
    if not config.loaded:
        config.load()
    make: Any = config.http_protocol_class
    state = ServerState()
    made = await loop.create_server(lambda: make(config=config, server_state=state, app_state={}), "127.0.0.1", 0)
    async with made:
        reader, writer = await asyncio.open_connection(*made.sockets[0].getsockname())
        for part in parts:
            writer.write(part)
            await asyncio.sleep(wait_s)
        try:
            return await asyncio.wait_for(reader.read(), 3.0)
        except ConnectionResetError:
            return b""
        finally:
            writer.close()


def test_half_a_request_ends_its_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configs: list[uvicorn.Config] = []
    monkeypatch.setattr(uvicorn.Server, "run", lambda self, sockets: configs.append(self.config))
    monkeypatch.setattr(server, "_HEADER_S", 0.1)
    with Store(str(tmp_path / "x.db")) as store:
        server.serve(store, at=server.listen(port=0))
        (config,) = configs
        whole = b"GET /health HTTP/1.1\r\nHost: x\r\n"
        assert asyncio.run(_slowly(config, [], 0.0)) == b""
        assert asyncio.run(_slowly(config, [whole], 0.0)) == b""
        assert asyncio.run(_slowly(config, [b"G", b"E", b"T", b" "], 0.04)) == b""  # bytes now and then do not help
        told = asyncio.run(_slowly(config, [whole + b"\r\n", whole], 0.05))  # nor does a request before
        assert told.startswith(b"HTTP/1.1 200")
        assert told.count(b"HTTP/1.1") == 1
        told = asyncio.run(_slowly(config, [whole, b"Connection: close\r\n\r\n"], 0.02))
        assert told.startswith(b"HTTP/1.1 200")
