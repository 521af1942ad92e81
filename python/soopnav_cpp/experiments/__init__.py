"""The papers' experiments, as ``soopnav reproduce`` runs them.

`soopnav_cpp.experiments.registry` says how one is written. `load` brings all of them.
"""

from __future__ import annotations

import importlib
import pkgutil

from soopnav_cpp.experiments.registry import REGISTRY, Registry

__all__ = ["load"]


def load() -> Registry:
    """Import every module of this package, which registers its experiments; returns the registry."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return REGISTRY
