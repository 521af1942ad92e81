"""A progress bar that appears only when something takes longer than two seconds."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

__all__ = ["Steps", "progress"]


class Steps(Protocol):
    """What a running command reports."""

    def __call__(self, description: str, *, done: int | None = None, total: int | None = None) -> None: ...


class _TimeLeft(ProgressColumn):
    """``3:20 left``, from the mean pace so far; nothing as long as there is none."""

    def render(self, task: Task) -> Text:
        if not task.total or not task.completed or task.elapsed is None:
            return Text("")
        left_s = round(task.elapsed / task.completed * (task.total - task.completed))
        hours, minutes = divmod(left_s // 60, 60)
        clock = f"{hours}:{minutes:02d}:{left_s % 60:02d}" if hours else f"{minutes}:{left_s % 60:02d}"
        return Text(f"{clock} left")


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
        _TimeLeft(),
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
