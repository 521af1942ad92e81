"""How a command ends: where it prints, and how a refusal is said."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import IO, Any, ParamSpec

import click
from rich.console import Console

from soopnav_cpp._extras import MissingExtraError

__all__ = ["sentences", "stdout"]

_P = ParamSpec("_P")


_LEAST_WIDTH = 110  # of a table: a narrow terminal wraps its lines, and a pipe has no width


def stdout() -> Console:
    """Where results are printed."""
    console = Console()
    return console if console.width >= _LEAST_WIDTH else Console(width=_LEAST_WIDTH)


class _Refusal(click.ClickException):
    """Bad input: the sentence alone on stderr, exit code 2."""

    exit_code = 2

    def show(self, file: IO[Any] | None = None) -> None:
        click.echo(self.message, err=file is None, file=file)


def sentences(command: Callable[_P, None]) -> Callable[_P, None]:
    """Refused input ends the command with its sentence and exit code 2, without a traceback."""

    @functools.wraps(command)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except (ValueError, MissingExtraError) as error:
            raise _Refusal(str(error)) from error
        except MemoryError as error:
            raise _Refusal("the capture does not fit in memory") from error
        except OSError as error:
            path = "" if error.filename is None else f"{error.filename}: "
            raise _Refusal(f"{path}{error.strerror.lower()}" if error.strerror else str(error)) from error

    return run
