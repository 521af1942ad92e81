"""The ``soopnav`` command. `main` is its entry point; the command line itself is in `soopnav_cpp.cli.app`."""

from __future__ import annotations

import sys

from soopnav_cpp._extras import MissingExtraError, require

__all__ = ["main"]


def main() -> None:
    """Run the command line; says which extra to install when what it needs is missing."""
    try:
        for module in ("click", "rich", "pydantic", "tomlkit"):
            require(module, "cli", "the soopnav command")
    except MissingExtraError as error:
        sys.exit(str(error))
    from soopnav_cpp.cli.app import cli

    cli(prog_name="soopnav")
