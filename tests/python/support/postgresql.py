"""A PostgreSQL server of its own for tests: from Debian's package, in a temporary folder, on a Unix socket only."""

from __future__ import annotations

import atexit
import contextlib
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

__all__ = ["Server", "running", "shared"]


class Server:
    """A server that runs; `new_database` gives URLs of empty databases."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made = 0

    def new_database(self, like: str | None = None) -> str:
        """The URL of a database with nothing in it, or with what another one of this server has (that nobody uses)."""
        import psycopg

        self._made += 1
        name = f"signals{self._made}"
        template = "template0" if like is None else like.removeprefix("postgresql://tests@/").partition("?")[0]
        with psycopg.connect(f"postgresql://tests@/postgres?host={self._folder}", autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY file_copy")
        return f"postgresql://tests@/{name}?host={self._folder}"


def _binaries() -> Path | None:
    found = shutil.which("initdb")
    if found is not None:
        return Path(found).resolve().parent
    versions = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: path.parts[-3].zfill(4))
    return versions[-1].parent if versions else None


@contextlib.contextmanager
def running() -> Iterator[Server]:
    """A server, stopped at the end. Skips the test, with a reason, where there is none to be had.

    PostgreSQL refuses to run as root, so root runs it as the user ``postgres`` of the package.
    """
    pytest.importorskip("psycopg", reason="psycopg is not installed")
    binaries = _binaries()
    if binaries is None:
        pytest.skip("PostgreSQL is not installed (Debian: postgresql)")
    user: str | None = None
    folder = Path(tempfile.mkdtemp(prefix="soopnav-pg-", dir="/tmp"))  # the path of a socket must be short
    try:
        if os.geteuid() == 0:
            try:
                owner = pwd.getpwnam("postgres")
            except KeyError:
                pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
            user = "postgres"
            os.chown(folder, owner.pw_uid, owner.pw_gid)
            folder.chmod(0o755)
        data = folder / "data"
        start = [str(binaries / "initdb"), "-D", str(data), "-A", "trust", "-U", "tests", "-E", "UTF8", "--no-sync"]
        made = subprocess.run([*start, "--locale=C"], user=user, cwd=folder, capture_output=True, text=True)
        if made.returncode != 0:
            pytest.skip(f"initdb does not work here: {made.stderr.strip().splitlines()[-1:]}")
        options = ["-c", "listen_addresses=", "-c", "fsync=off", "-c", "max_connections=60", "-k", str(folder)]
        with (folder / "log").open("wb") as log:
            server = subprocess.Popen(
                [str(binaries / "postgres"), "-D", str(data), *options], user=user, cwd=folder, stdout=log, stderr=log
            )
        try:
            _wait(binaries, folder, server)
            yield Server(folder)
        finally:
            server.send_signal(signal.SIGINT)  # a fast end: it disconnects who is still there
            try:
                server.wait(20.0)
            except subprocess.TimeoutExpired:
                server.kill()
                server.wait()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


_SHARED: list[Server] = []


def shared() -> Server:
    """The one server of this run of tests, started when it is first asked for and stopped at the end of the process."""
    if not _SHARED:
        stack = contextlib.ExitStack()
        _SHARED.append(stack.enter_context(running()))
        atexit.register(stack.close)
    return _SHARED[0]


def _wait(binaries: Path, folder: Path, server: subprocess.Popen[bytes]) -> None:
    ready = [str(binaries / "pg_isready"), "-q", "-h", str(folder)]
    for _ in range(600):
        if subprocess.run(ready).returncode == 0:
            return
        if server.poll() is not None:
            break
        time.sleep(0.05)
    raise RuntimeError(f"PostgreSQL did not start: {(folder / 'log').read_text(errors='replace')[-2000:]}")
