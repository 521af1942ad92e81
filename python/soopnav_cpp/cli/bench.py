"""``soopnav bench``: speed beside named peers."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from soopnav_cpp.bench.cases import CASES
from soopnav_cpp.bench.harness import LEAST_RUNS, Case, Row, measure, select

__all__ = [
    "LEAST_RUNS",
    "ONE_THREAD",
    "again_with_one_thread",
    "bench",
    "choose",
    "complaint",
    "has_one_thread",
    "print_table",
    "tell",
]

_VARIABLES = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "BLIS")
ONE_THREAD: Mapping[str, str] = {f"{name}_NUM_THREADS": "1" for name in _VARIABLES} | {"VECLIB_MAXIMUM_THREADS": "1"}
"""What keeps the libraries under NumPy and its kin to one thread, set before they are loaded."""


def has_one_thread() -> bool:
    """Whether this process was started with `ONE_THREAD`."""
    return all(os.environ.get(name) == value for name, value in ONE_THREAD.items())


def again_with_one_thread(arguments: Sequence[str]) -> int:
    """Run ``soopnav bench`` with `arguments` in a process that has `ONE_THREAD`; its exit code."""
    program = "from soopnav_cpp.cli import main; main()"
    command = [sys.executable, "-c", program, "bench", *arguments]
    return subprocess.run(command, env=os.environ | ONE_THREAD, check=False).returncode


def choose(names: Sequence[str]) -> list[Case]:
    """The cases that `names` begin or match as globs, all without any."""
    return select(CASES, names)


def tell(what: str) -> None:
    """What is measured now, on a terminal: a line, for a bar that moves would take time from what is measured."""
    if sys.stderr.isatty():
        click.echo(what, err=True)


def bench(cases: Sequence[Case], *, runs: int, step: Callable[[str], None]) -> Iterator[tuple[Case, Row]]:
    """A row per case and peer, as each is known."""
    for case in cases:
        for row in measure(case, runs=runs, step=step):
            yield case, row


def complaint(case: Case, row: Row) -> str:
    """What stderr is told about a row; empty when there is nothing to say."""
    if row.peer_s is None:
        return f"{row.name}: {row.peer} could not run: {row.reason}"
    if not row.agrees:
        return f"{row.name}: {row.peer} answers {row.difference:.2g} off, {case.tolerance:.2g} is allowed"
    return ""


def _time(time_s: float | None) -> str:
    if time_s is None:
        return "–"
    for scale, unit in ((1.0, "s"), (1e3, "ms")):
        if time_s * scale >= 1.0:
            return f"{time_s * scale:.3g} {unit}"
    return f"{time_s * 1e6:.3g} µs"


def print_table(rows: Sequence[Row], console: Console) -> None:
    """A row per case and peer."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("case", "soopnav", "peer", "its time", "ratio", "runs"):
        table.add_column(name, justify="left" if name in ("case", "peer") else "right", no_wrap=True)
    table.add_column("", overflow="fold")
    for row in rows:
        note = row.reason or ("" if row.agrees else "another answer")
        ratio = "–" if row.ratio is None else f"{row.ratio:.3g}"
        cells = (row.name, _time(row.ours_s), row.peer, _time(row.peer_s), ratio, str(row.n), note)
        table.add_row(*(Text(cell) for cell in cells), style=None if row.agrees else "bold red")
    console.print(table)
