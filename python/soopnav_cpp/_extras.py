"""Optional dependencies: imported where they are used, with a sentence when one is missing."""

from __future__ import annotations

import importlib
from typing import Any


class MissingExtraError(ImportError):
    """An optional dependency is not installed."""


def require(module: str, extra: str, purpose: str) -> Any:
    """Import `module`, or say which extra brings it.

    Parameters
    ----------
    module : str
        Name to import, such as ``"matplotlib.figure"``.
    extra : str
        Extra of the package ``soopnav`` that installs it.
    purpose : str
        What needs it, the start of the sentence: ``"reading SigMF"``.

    Raises
    ------
    MissingExtraError
        When the module cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise MissingExtraError(f"{purpose} needs {name}: pip install soopnav[{extra}]") from error
