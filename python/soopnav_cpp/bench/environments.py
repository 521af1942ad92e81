"""A virtual environment of its own for a peer that pins other versions than ours, made on demand and kept."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

__all__ = ["UnavailableError", "cache_folder", "environment"]

_TIMEOUT_S = 900.0


class UnavailableError(Exception):
    """A peer cannot run here; the message says why."""


def cache_folder() -> Path:
    """Where this platform keeps a user's caches, ``soopnav/bench`` below it."""
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "soopnav" / "bench"


def _interpreter(folder: Path) -> Path:
    return folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def _run(command: Sequence[str | Path], what: str) -> None:
    try:
        done = subprocess.run(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnavailableError(f"{what}: {error}") from error
    if done.returncode != 0:
        lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
        errors = [line for line in lines if line.lower().startswith("error")] or lines or ["no message"]
        raise UnavailableError(f"{what}: {errors[-1]}")


def environment(requirements: Sequence[str]) -> Path:
    """The interpreter of an environment with `requirements`; the first call makes it, which takes a minute or so.

    Parameters
    ----------
    requirements : sequence of str
        As pip reads them; wheels only.

    Raises
    ------
    UnavailableError
        When it cannot be made: no network, no wheel for this Python.
    """
    name = requirements[0].split("=")[0].split("<")[0].split(">")[0]
    text = "\n".join([sys.version, *requirements])
    folder = cache_folder() / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    if _interpreter(folder).exists():
        return _interpreter(folder)
    what = f"no environment for {name}"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=folder.parent))
    except OSError as error:
        raise UnavailableError(f"{what}: {error}") from error
    try:
        _run([sys.executable, "-m", "venv", draft], what)
        pip: list[str | Path] = [
            _interpreter(draft),
            "-m",
            "pip",
            "--disable-pip-version-check",
            "--quiet",
            "--no-input",
        ]
        _run([*pip, "install", "--only-binary=:all:", *requirements], what)
        try:
            draft.replace(folder)  # whole or not at all
        except OSError as error:
            if not _interpreter(folder).exists():  # or else another process was faster
                raise UnavailableError(f"{what}: {error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return _interpreter(folder)
