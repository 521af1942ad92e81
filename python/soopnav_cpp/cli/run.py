"""``soopnav run``: a scenario, its runs, and what they leave in a folder."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from soopnav_cpp import scenarios
from soopnav_cpp._extras import require
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.scenarios import report
from soopnav_cpp.scenarios.execution import Outcome, execute
from soopnav_cpp.scenarios.schema import describe

__all__ = ["Done", "example", "print_list", "run", "schema"]


@dataclass(frozen=True)
class Done:
    """What a command ends with.

    Attributes
    ----------
    sentence : str
    report : pathlib.Path or None
        None when every run failed.
    failed : list of Outcome
    """

    sentence: str
    report: Path | None
    failed: list[Outcome]


def _tell(outcome: Outcome) -> None:
    """A run that failed, on stderr: its seed and its traceback."""
    click.echo(f"{outcome}\n{outcome.details}", err=True)


def run(
    path: Path,
    out: Path | None,
    *,
    seed: int | None,
    runs: int | None,
    jobs: int,
    only: int | None,
    step: Steps,
) -> Done:
    """Run the scenario into `out`, ``STEM.run`` without one.

    Raises
    ------
    ConfigError
        For a scenario that does not fit.
    """
    system, scenario = scenarios.load(path, seed=seed, runs=runs)
    require("matplotlib.figure", "plot", "drawing")
    if only is not None and only > scenario.runs:
        raise ValueError(f"--only {only}: the scenario has {scenario.runs} run{'s' * (scenario.runs != 1)}")
    check = getattr(system, "check", None)
    if check is not None:
        check(scenario)
    folder = out if out is not None else Path(f"{path.stem}.run")
    folder.mkdir(parents=True, exist_ok=True)  # what cannot be written is to be known before the runs
    outcomes = execute(system, scenario, jobs=jobs, only=only, step=step, failed=_tell)
    failed = [outcome for outcome in outcomes if outcome.error]
    results = report.results_of(path, system, scenario, outcomes)
    if results is None:
        with contextlib.suppress(OSError):  # there was something in it before
            folder.rmdir()
        return Done(f"{path.name}: all {len(outcomes)} runs failed" if len(outcomes) > 1 else "", None, failed)
    step("writing the report")
    written = report.write(results, folder)
    return Done(f"{results.title}: {report.verdict(results)}", written, failed)


def print_list(console: Console) -> None:
    """A row per system."""
    systems = scenarios.SYSTEMS.all()
    if not systems:
        console.print("no system is installed")
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("system", no_wrap=True)
    table.add_column("what it is")
    for system in systems:
        table.add_row(Text(system.name), Text(str(getattr(system, "title", "") or "–")))
    console.print(table)


def schema(name: str) -> str:
    """Every key of a system's scenarios, as TOML with comments."""
    return describe(scenarios.SYSTEMS.get(name).scenario, name)


def example(name: str) -> str:
    """A scenario to start from."""
    system = scenarios.SYSTEMS.get(name)
    text = getattr(system, "example", None)
    if not text:
        raise ValueError(f"{name} has no example; soopnav run --schema {name} prints its keys")
    return str(text)
