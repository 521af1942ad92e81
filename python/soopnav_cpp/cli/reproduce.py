"""``soopnav reproduce``: the papers' experiments, their claims and the table at the end."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from soopnav_cpp import experiments
from soopnav_cpp._extras import require
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.cli.text import MINUS
from soopnav_cpp.experiments.registry import Experiment, Outcome, Workers, perform, write_claims

__all__ = ["available_jobs", "print_list", "print_table", "report_error", "reproduce", "select"]

_MOST_NUMBERS = 6  # of a list, in the table


def available_jobs() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def select(patterns: Sequence[str]) -> list[Experiment]:
    """The experiments that `patterns` name, all without any."""
    return experiments.load().select(patterns)


def reproduce(
    chosen: Sequence[Experiment],
    *,
    seed: int,
    out: Path,
    jobs: int,
    step: Steps,
    failed: Callable[[Experiment, Exception], None],
) -> list[Outcome]:
    """Run `chosen` into the folder `out`; ``claims.json`` grows with each of them.

    `failed` is told at once of an experiment that ended with an exception; the others run all the same.
    """
    require("matplotlib.figure", "plot", "drawing")
    out.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    resolution = 1000  # parts of an experiment on the bar
    with Workers(jobs) as workers:
        for index, item in enumerate(chosen):
            place = f"{item.id} ({index + 1} of {len(chosen)})"

            def tell(
                description: str,
                *,
                done: int | None = None,
                total: int | None = None,
                place: str = place,
                at: int = index,
            ) -> None:
                part = resolution * (done or 0) // total if total else 0
                step(f"{place}: {description}", done=resolution * at + part, total=resolution * len(chosen))

            tell(item.title)
            outcomes.append(perform(item, seed=seed, out=out, workers=workers, step=tell))
            error = outcomes[-1].error
            if error is not None:
                failed(item, error)
            write_claims(outcomes, seed=seed, out=out)
    return outcomes


def report_error(item: Experiment, error: Exception) -> None:
    """The traceback of an experiment that ended with an exception, on stderr."""
    click.echo(f"{item.id}:\n{''.join(traceback.format_exception(error))}", err=True)


def _measured(numbers: Sequence[float]) -> str:
    if not numbers:
        return "–"
    shown = [f"{value:.4g}".replace("-", MINUS) for value in numbers[:_MOST_NUMBERS]]
    return ", ".join(shown) + (f", … ({len(numbers)})" if len(numbers) > _MOST_NUMBERS else "")


def print_table(outcomes: Sequence[Outcome], console: Console) -> None:
    """A row per claim, and how many hold."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("id", "claim", "measured", "required", "holds"):
        table.add_column(name, no_wrap=name in ("id", "holds"), overflow="fold")
    claims = [(outcome.experiment, claim) for outcome in outcomes for claim in outcome.claims]
    for item, claim in claims:
        holds = claim.holds
        table.add_row(
            Text(item.id),
            Text(claim.claim),
            Text(_measured(claim.numbers)),
            Text(claim.required.words),
            Text("yes" if holds else "NO"),
            style=None if holds else "bold red",
        )
    console.print(table)
    held = sum(claim.holds for _, claim in claims)
    console.print(f"{held} of {len(claims)} claims hold", highlight=False)
    for outcome in outcomes:
        if outcome.skipped:
            console.print(f"{outcome.experiment.id} skipped: {outcome.skipped}", highlight=False, soft_wrap=True)


def print_list(chosen: Sequence[Experiment], console: Console) -> None:
    """A row per experiment: id, runs, title and source."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("id", "runs", "title", "source"):
        table.add_column(name, no_wrap=name in ("id", "runs"), justify="right" if name == "runs" else "left")
    for item in chosen:
        table.add_row(*(Text(cell) for cell in (item.id, str(item.runs), item.title, item.source)))
    console.print(table)
