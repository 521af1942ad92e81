"""A case and its peers: turns, medians, rows."""

from __future__ import annotations

import fnmatch
import gc
import importlib
import json
import math
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp.bench import environments, worker
from soopnav_cpp.bench.environments import UnavailableError

__all__ = [
    "LEAST_RUNS",
    "Case",
    "Contender",
    "Data",
    "InProcess",
    "Peer",
    "Prepare",
    "Row",
    "UnavailableError",
    "measure",
    "select",
]

LEAST_RUNS = 7
_PEERS = "soopnav_cpp.bench.peers"

Data = dict[str, npt.NDArray[Any]]
Prepare = Callable[[Data], tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]]
"""Given the case's data: what is timed, and what makes a few comparable numbers of its result, which is not timed."""


class Contender(Protocol):
    """One side of a case, ready to run."""

    def answer(self) -> list[float]:
        """Run once, untimed; what the result comes to."""

    def time(self) -> float:
        """Run once; how long it took, seconds."""


class InProcess:
    """A contender in this interpreter."""

    def __init__(self, prepare: Prepare, data: Data) -> None:
        self._run, self._answer = prepare(data)

    def answer(self) -> list[float]:
        """Run once, untimed."""
        return [float(value) for value in self._answer(self._run())]

    def time(self) -> float:
        """Run once, without the garbage collector."""
        gc.collect()
        enabled = gc.isenabled()
        gc.disable()
        try:
            start = time.perf_counter()
            self._run()
            return time.perf_counter() - start
        finally:
            if enabled:
                gc.enable()


class _Isolated(AbstractContextManager["_Isolated"]):
    """A contender in the interpreter of another environment."""

    def __init__(self, python: Path, module: Path, function: str, data: Data) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="soopnav-bench-")
        arrays = Path(self._folder.name) / "data.npz"
        np.savez(arrays, **cast("dict[str, Any]", data))
        self._process = subprocess.Popen(
            [str(part) for part in (python, "-I", "-u", worker.__file__, module, function, arrays)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        try:
            self._read()
        except UnavailableError:
            self.__exit__(None, None, None)
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise UnavailableError(f"its process ended with code {self._process.wait()}")
        said: dict[str, Any] = json.loads(line)
        if "error" in said:
            raise UnavailableError(str(said["error"]))
        return said

    def _ask(self, command: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": command}) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise UnavailableError(f"its process is gone: {error}") from error
        return self._read()

    def answer(self) -> list[float]:
        return [float(value) for value in self._ask("answer")["answer"]]

    def time(self) -> float:
        return float(self._ask("time")["s"])


@dataclass(frozen=True)
class Peer:
    """Whom a case is held against.

    Attributes
    ----------
    name : str
    module : str
        In `soopnav_cpp.bench.peers`.
    function : str
        There, a `Prepare`.
    requirements : tuple of str
        Not empty: the peer runs in an environment of its own that has these.
    """

    name: str
    module: str
    function: str
    requirements: tuple[str, ...] = ()

    def start(self, data: Data) -> AbstractContextManager[Contender]:
        """Make it ready.

        Raises
        ------
        UnavailableError
            When its package is missing, or does not work with what is installed.
        """
        if self.requirements:
            python = environments.environment(self.requirements)
            folder = Path(importlib.import_module(_PEERS).__path__[0])
            return _Isolated(python, folder / f"{self.module}.py", self.function, data)
        try:
            prepare: Prepare = getattr(importlib.import_module(f"{_PEERS}.{self.module}"), self.function)
            return nullcontext(InProcess(prepare, data))
        except ImportError as error:
            missing = error.name or self.module
            raise UnavailableError(f"{missing.split('.')[0]} is not installed: pip install soopnav[bench]") from error
        except Exception as error:  # it is there, and fails with the versions around it
            raise UnavailableError(f"{type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class Case:
    """What is measured.

    Attributes
    ----------
    name : str
        ``family/size``.
    title : str
        What one timed run does.
    data : callable
        Makes the arrays that every side gets.
    ours : callable
        A `Prepare`.
    peers : tuple of Peer
    tolerance : float
        How far a peer's answer may be off ours, relative to the greater of 1 and ours.
    """

    name: str
    title: str
    data: Callable[[], Data]
    ours: Prepare
    peers: tuple[Peer, ...]
    tolerance: float


@dataclass(frozen=True)
class Row:
    """A case beside one peer.

    Attributes
    ----------
    name : str
        Of the case.
    ours_s : float
        Median.
    peer : str
    peer_s : float or None
        Median; None when the peer could not run.
    n : int
        Turns.
    reason : str
        Why the peer could not run; empty when it did.
    difference : float
        Of the answers, relative to the greater of 1 and ours; NaN without a peer.
    agrees : bool
        Whether that is within the case's tolerance; true without a peer.
    """

    name: str
    ours_s: float
    peer: str
    peer_s: float | None
    n: int
    reason: str = ""
    difference: float = math.nan
    agrees: bool = True

    @property
    def ratio(self) -> float | None:
        """How many times as long the peer takes; None without it."""
        return None if self.peer_s is None else self.peer_s / self.ours_s

    def as_json(self) -> dict[str, Any]:
        """The row as ``soopnav bench --json`` prints it."""
        return {
            "name": self.name,
            "ours_s": self.ours_s,
            "peer": self.peer,
            "peer_s": self.peer_s,
            "ratio": self.ratio,
            "n": self.n,
        }


Step = Callable[[str], None]


@dataclass
class _Turns:
    """Times of both sides, which run turn by turn."""

    ours: list[float] = field(default_factory=list)
    peer: list[float] = field(default_factory=list)

    def take(self, ours: Contender, peer: Contender | None, runs: int) -> None:
        for _ in range(runs):
            self.ours.append(ours.time())
            if peer is not None:
                self.peer.append(peer.time())


def _difference(ours: Sequence[float], peer: Sequence[float]) -> float:
    a, b = np.asarray(ours, dtype=np.float64), np.asarray(peer, dtype=np.float64)
    if a.shape != b.shape:
        return math.inf
    worst = np.max(np.abs(a - b) / np.maximum(1.0, np.abs(a)), initial=0.0)
    return float(worst) if np.isfinite(worst) else math.inf


def measure(case: Case, *, runs: int = LEAST_RUNS, step: Step = lambda _: None) -> Iterator[Row]:
    """Time a case beside each of its peers; a row as soon as it is known.

    Both sides run once untimed, which warms caches and gives the answers that are compared; then they take turns.

    Parameters
    ----------
    case : Case
    runs : int
        Turns, at least 7.
    step : callable
        Told what is being done.
    """
    if runs < LEAST_RUNS:
        raise ValueError(f"runs = {runs}: at least {LEAST_RUNS} expected")
    data = case.data()
    ours = InProcess(case.ours, data)
    expected = ours.answer()
    for peer in case.peers:
        step(f"{case.name}: {peer.name}")
        turns = _Turns()
        try:
            with peer.start(data) as other:
                difference = _difference(expected, _guarded(other.answer))
                turns.take(ours, other, runs)
        except UnavailableError as error:
            turns = _Turns()
            turns.take(ours, None, runs)
            yield Row(case.name, statistics.median(turns.ours), peer.name, None, runs, str(error))
            continue
        yield Row(
            case.name,
            statistics.median(turns.ours),
            peer.name,
            statistics.median(turns.peer),
            runs,
            difference=difference,
            agrees=difference <= case.tolerance,
        )


def _guarded(answer: Callable[[], list[float]]) -> list[float]:
    """A peer's first run: what it raises makes it unavailable, by name."""
    try:
        return answer()
    except UnavailableError:
        raise
    except Exception as error:
        raise UnavailableError(f"{type(error).__name__}: {error}") from error


def select(cases: Sequence[Case], names: Sequence[str] = ()) -> list[Case]:
    """The cases whose name begins with one of `names` or matches one as a glob; all without names.

    Raises
    ------
    ValueError
        For a name that no case has.
    """

    def matches(case: Case, name: str) -> bool:
        return case.name.startswith(name) or fnmatch.fnmatchcase(case.name, name)

    for name in names:
        if not any(matches(case, name) for case in cases):
            known = ", ".join(case.name for case in cases)
            raise ValueError(f"no case {name!r}; there are {known}")
    return [case for case in cases if not names or any(matches(case, name) for name in names)]
