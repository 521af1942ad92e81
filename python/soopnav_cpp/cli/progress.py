"""A progress bar that appears only when something takes longer than two seconds."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

__all__ = ["Steps", "progress"]


class Steps(Protocol):
    """What a running command reports."""

    def __call__(self, description: str, *, done: int | None = None, total: int | None = None) -> None: ...


@contextmanager
def progress(*, after_s: float = 2.0, console: Console | None = None) -> Iterator[Steps]:
    """Show what is being done on stderr, once `after_s` has passed and only on a terminal.

    Yields a function that says what is done now: ``step("searching")`` or ``step("timing", done=2, total=5)``.
    """
    where = console or Console(stderr=True)
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=where,
        transient=True,
    )
    task = bar.add_task("starting", total=None)
    timer = threading.Timer(after_s, bar.start)
    timer.daemon = True

    def step(description: str, *, done: int | None = None, total: int | None = None) -> None:
        bar.update(task, description=description, completed=done or 0, total=total)

    if where.is_terminal:
        timer.start()
    try:
        yield step
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()
        if bar.live.is_started:
            bar.stop()
