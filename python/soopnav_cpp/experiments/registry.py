"""How an experiment is written down, found and run: the engine of ``soopnav reproduce``.

An experiment is a function in a module of this package; the decorator is all that registers it, and every module here
is found without being listed anywhere. It receives a `Lab`, draws its figure, saves its data, and yields its claims::

    from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, experiment

    def settle(seed: int, sigma_m: float) -> float:      # one run; at module level, for it may run in another process
        z = np.random.default_rng(seed).normal(0.0, sigma_m, 40)
        return float(z.mean())

    @experiment("paper-7", title="The mean settles", source="paper section 2.1, Fig. 7", runs=200)
    def figure_7(lab: Lab) -> Iterator[Claim]:
        means = np.array(lab.map(settle, 1.0))           # one result per run, in the order of the runs
        with lab.figure() as figure:                     # written as paper-7.png
            axes = figure.add_subplot()
            style(axes, "Means of 40", "mean [m]", "runs")
            axes.hist(means)
        lab.save(means=means)                            # paper-7.npz; lab.table(...) writes paper-7.csv
        yield Claim("spread of the mean is sigma / sqrt(40)", means.std() * np.sqrt(40), band(0.81, 1.2))

The rules that keep a claim honest:

- All randomness comes from the seed of the run, or from ``lab.rng("name")`` for what is drawn once. Both depend on the
  user's seed and the experiment's id alone, so results depend neither on the order of experiments nor on the number of
  processes.
- ``measured`` is what the run gave, never rounded; ``holds`` is computed from it by the `Condition`. A number that is
  not finite, or no number at all, never holds.
- A condition is met for any seed: a right implementation fails it with probability 1e-4 at most. Pool more runs or
  widen the band by its own Monte-Carlo error.
- Every experiment writes a figure and a data file.
- One that reads a recording names its folder: ``needs="gnss_static"``. Where it is not, in the folder that the
  environment variable SOOPNAV_RECORDINGS names or in ``shared/captures`` beside the checkout, the experiment is skipped
  and says so.
"""

from __future__ import annotations

import csv
import fnmatch
import hashlib
import json
import math
import multiprocessing
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp import plotting
from soopnav_cpp.experiments.conditions import (
    Condition,
    above,
    at_least,
    at_most,
    band,
    below,
    condition,
    falling,
    matching,
    near,
    rising,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "REGISTRY",
    "Claim",
    "Condition",
    "Experiment",
    "Lab",
    "Outcome",
    "Registry",
    "Workers",
    "above",
    "at_least",
    "at_most",
    "band",
    "below",
    "condition",
    "derive_seed",
    "experiment",
    "falling",
    "matching",
    "near",
    "perform",
    "recording",
    "rising",
    "style",
    "write_claims",
]

_T = TypeVar("_T")
_ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9.]+)+")


def derive_seed(seed: int, *names: str | int) -> int:
    """Seed of one named draw: 63 bits of a hash, so that neither order nor neighbours matter.

    Parameters
    ----------
    seed : int
        The user's.
    *names : str or int
        What the draw is, outermost first: the experiment's id, then the number of the run.
    """
    text = json.dumps([seed, *names]).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big") >> 1


@dataclass(frozen=True)
class Claim:
    """A statement, the numbers that were measured, and the condition they have to meet.

    Attributes
    ----------
    claim : str
        The statement, one sentence.
    measured : float or sequence of float
        What the runs gave; NumPy scalars and arrays are taken as well.
    required : Condition
    source : str
        Where it stands; empty: where the experiment stands.
    """

    claim: str
    measured: float | Sequence[float] | npt.NDArray[np.generic]
    required: Condition
    source: str = ""

    @property
    def numbers(self) -> tuple[float, ...]:
        """`measured` as a tuple."""
        return tuple(float(value) for value in np.ravel(np.asarray(self.measured, dtype=np.float64)))

    @property
    def holds(self) -> bool:
        """Whether the measured numbers meet the condition."""
        return self.required.holds(self.numbers)

    def as_row(self, experiment: Experiment, seed: int) -> dict[str, Any]:
        """The claim's row in ``claims.json``. What is not a finite number is null."""
        numbers: list[float | None] = [value if math.isfinite(value) else None for value in self.numbers]
        return {
            "id": experiment.id,
            "claim": self.claim,
            "source": self.source or experiment.source,
            "measured": numbers[0] if np.ndim(self.measured) == 0 else numbers,
            "required": self.required.words,
            "holds": self.holds,
            "seed": seed,
            "runs": experiment.runs,
        }


class Step(Protocol):
    """Told how far a run has come."""

    def __call__(self, description: str, *, done: int | None = None, total: int | None = None) -> None: ...


def _silent(description: str, *, done: int | None = None, total: int | None = None) -> None:
    """Nobody looks on."""


class Workers:
    """The processes that runs are spread over; none are started while one is enough.

    Parameters
    ----------
    jobs : int
        At least 1. With 1 everything runs in this process.
    """

    def __init__(self, jobs: int = 1) -> None:
        if jobs < 1:
            raise ValueError(f"jobs = {jobs}: at least 1 expected")
        self.jobs = jobs
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def map(
        self, function: Callable[..., _T], calls: Sequence[tuple[Any, ...]], *, chunk: int | None = None
    ) -> Iterator[_T]:
        """``function(*call)`` for each call, in their order; `chunk` of them are sent at a time."""
        if self.jobs == 1 or len(calls) < 2:
            yield from (function(*call) for call in calls)
            return
        if self._pool is None:  # spawned, for a fork of a process with threads is not safe
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.jobs, mp_context=context)
        chunk = max(1, len(calls) // (4 * self.jobs)) if chunk is None else chunk
        try:
            yield from self._pool.map(function, *zip(*calls, strict=True), chunksize=chunk)
        except BrokenProcessPool:  # a process died; the next experiment gets new ones
            self._pool = None
            raise


@dataclass
class Lab:
    """What an experiment works with: its seeds, its processes, and the folder for its figure and data.

    Attributes
    ----------
    experiment : Experiment
    seed : int
        The user's.
    out : pathlib.Path
        The folder, which exists.
    """

    experiment: Experiment
    seed: int
    out: Path
    workers: Workers = field(default_factory=Workers)
    step: Step = _silent
    figures: list[Path] = field(default_factory=list)
    data: list[Path] = field(default_factory=list)

    @property
    def runs(self) -> int:
        """Number of Monte-Carlo runs."""
        return self.experiment.runs

    @property
    def seeds(self) -> tuple[int, ...]:
        """One seed per run."""
        return tuple(derive_seed(self.seed, self.experiment.id, run) for run in range(self.runs))

    def rng(self, name: str) -> np.random.Generator:
        """Generator of what is drawn once for the whole experiment, named so that draws do not shift each other."""
        return np.random.default_rng(derive_seed(self.seed, self.experiment.id, name))

    def map(self, function: Callable[..., _T], *arguments: Any, runs: int | None = None) -> list[_T]:
        """``function(seed, *arguments)`` for each run.

        Parameters
        ----------
        function : callable
            At module level, and what it returns can be pickled: it may run in another process.
        *arguments
            The same for every run.
        runs : int, optional
            Only the first so many: for what needs fewer than the experiment's.

        Returns
        -------
        list
            One result per run, in the order of the runs, whatever the number of processes.
        """
        if runs is not None and not 0 < runs <= self.runs:
            raise ValueError(f"runs = {runs}: 1 ... {self.runs} expected")
        calls = [(seed, *arguments) for seed in self.seeds[:runs]]
        results = []
        for result in self.workers.map(function, calls):
            results.append(result)
            self.step(f"run {len(results)} of {len(calls)}", done=len(results), total=len(calls))
        return results

    def recording(self) -> Path:
        """The folder of the recording that the experiment needs."""
        found = recording(self.experiment.needs)
        if found is None:
            raise FileNotFoundError(self.experiment.lacks)
        return found

    def _file(self, part: str, suffix: str) -> Path:
        return self.out / f"{self.experiment.id}{'_' if part else ''}{part}{suffix}"

    @contextmanager
    def figure(self, width_in: float = 7.2, height_in: float = 4.8, *, part: str = "") -> Iterator[Figure]:
        """A figure that is written when the block ends: ``ID.png``, or ``ID_part.png``."""
        figure = plotting._figure(width_in, height_in)
        yield figure
        path = self._file(part, ".png")
        plotting._save(figure, path)
        self.figures.append(path)

    def save(self, *, part: str = "", **arrays: npt.ArrayLike) -> Path:
        """Write arrays, by name, to ``ID.npz`` or ``ID_part.npz``."""
        path = self._file(part, ".npz")
        np.savez_compressed(path, **cast("dict[str, Any]", {name: np.asarray(value) for name, value in arrays.items()}))
        self.data.append(path)
        return path

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[float | str]], *, part: str = "") -> Path:
        """Write rows under named columns to ``ID.csv`` or ``ID_part.csv``."""
        path = self._file(part, ".csv")
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
        self.data.append(path)
        return path


Body = Callable[[Lab], Iterable[Claim]]


@dataclass(frozen=True)
class Experiment:
    """A registered experiment.

    Attributes
    ----------
    id : str
        ``paper-figure``, such as ``nielsen-18`` or ``crosby-4.10``.
    title : str
    source : str
        Paper, section and figure.
    runs : int
        Monte-Carlo runs that its claims are conditioned on.
    body : callable
    needs : str
        Folder of a recording it reads; empty: none.
    """

    id: str
    title: str
    source: str
    runs: int
    body: Body
    needs: str = ""

    @property
    def lacks(self) -> str:
        """Why it cannot run here; empty when it can."""
        if not self.needs or recording(self.needs) is not None:
            return ""
        return (
            f"needs the recording {self.needs!r}: name the folder that holds it in SOOPNAV_RECORDINGS, or put it "
            "into shared/captures beside the checkout"
        )


def recording(name: str) -> Path | None:
    """The folder of a recording, in that of SOOPNAV_RECORDINGS or ``shared/captures`` beside the checkout; or None."""
    given = os.environ.get("SOOPNAV_RECORDINGS")
    base = Path(given) if given else Path(__file__).resolve().parents[3].parent / "shared" / "captures"
    folder = base / name
    return folder if folder.is_dir() else None


def _in_reading_order(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts 4.2 before 4.10, and numbers before words."""
    parts = re.findall(r"\d+|[^\d]+", name)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)


class Registry:
    """Experiments by id."""

    def __init__(self) -> None:
        self._experiments: dict[str, Experiment] = {}

    def experiment(self, id: str, *, title: str, source: str, runs: int = 1, needs: str = "") -> Callable[[Body], Body]:
        """Decorator that registers a function as an experiment.

        Parameters
        ----------
        id : str
            Lower case, ``paper-figure``; new.
        title, source : str
        runs : int
            At least 1.
        needs : str
            Folder of a recording it reads: skipped where that is not.
        """
        if not _ID.fullmatch(id):
            raise ValueError(f"id = {id!r}: paper-figure in lower case expected")
        if runs < 1:
            raise ValueError(f"{id}: runs = {runs}: at least 1 expected")
        if not title or not source:
            raise ValueError(f"{id}: a title and a source expected")

        def register(body: Body) -> Body:
            if id in self._experiments:
                raise ValueError(f"{id}: already registered")
            self._experiments[id] = Experiment(id, title, source, runs, body, needs)
            return body

        return register

    def all(self) -> list[Experiment]:
        """Every experiment, in the order of their ids; 4.2 comes before 4.10."""
        return sorted(self._experiments.values(), key=lambda item: _in_reading_order(item.id))

    def select(self, patterns: Sequence[str] = ()) -> list[Experiment]:
        """The experiments whose id is one of `patterns` or matches one as a glob; all without patterns.

        Raises
        ------
        ValueError
            For a pattern that nothing matches.
        """
        everything = self.all()
        for pattern in patterns:
            if not any(fnmatch.fnmatchcase(item.id, pattern) for item in everything):
                raise ValueError(f"no experiment {pattern!r}; soopnav reproduce --list names them")
        return [item for item in everything if not patterns or any(fnmatch.fnmatchcase(item.id, p) for p in patterns)]


REGISTRY = Registry()
experiment = REGISTRY.experiment


@dataclass(frozen=True)
class Outcome:
    """What an experiment left.

    Attributes
    ----------
    experiment : Experiment
    claims : tuple of Claim
    error : Exception or None
        That ended it; the claims then end with one that does not hold.
    skipped : str
        Why it did not run; empty: it ran.
    """

    experiment: Experiment
    claims: tuple[Claim, ...]
    error: Exception | None = None
    skipped: str = ""

    @property
    def holds(self) -> bool:
        """Whether every claim holds."""
        return all(claim.holds for claim in self.claims)


def perform(item: Experiment, *, seed: int, out: Path, workers: Workers | None = None, step: Step = _silent) -> Outcome:
    """Run one experiment into the folder `out`.

    An exception does not pass: it becomes a claim that does not hold, so that the experiments after it still run. One
    that lacks its recording is skipped.
    """
    if item.lacks:
        return Outcome(item, (), skipped=item.lacks)
    lab = Lab(item, seed, out, workers or Workers(), step)
    claims: list[Claim] = []
    try:
        claims.extend(item.body(lab))
        for kind, made in (("claim", claims), ("figure", lab.figures), ("data file", lab.data)):
            if not made:
                raise RuntimeError(f"{item.id} left no {kind}")
    except Exception as error:
        claims.append(Claim(f"the experiment ends ({type(error).__name__}: {error})", (), condition("no error", bool)))
        return Outcome(item, tuple(claims), error)
    return Outcome(item, tuple(claims))


def write_claims(outcomes: Iterable[Outcome], *, seed: int, out: Path) -> Path:
    """Write ``claims.json``, a list with a row per claim; an older file is replaced as a whole or not at all."""
    rows = [claim.as_row(outcome.experiment, seed) for outcome in outcomes for claim in outcome.claims]
    path, draft = out / "claims.json", out / "claims.json.part"
    draft.write_text(json.dumps(rows, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    return draft.replace(path)


def style(axes: Axes, title: str, x: str, y: str) -> None:
    """Title, axis labels and grid as all figures have them."""
    plotting._style(axes, title, x, y)
