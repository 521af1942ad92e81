"""Systems by name.

A system is registered when its module is imported::

    from soopnav_cpp.scenarios import Scenario, SystemRun, register

    class BuoyScenario(Scenario):
        sigma_m: float

    @register
    class Buoy:
        name = "buoy"
        title = "a buoy ranged from the shore"
        scenario = BuoyScenario

        def run(self, scenario: BuoyScenario, seed: int) -> SystemRun: ...

Modules of this package are found without being listed anywhere; those of another package by its entry point in the
group ``soopnav.systems``.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.metadata
import pkgutil
import re
from pathlib import Path
from typing import Any, TypeVar

import pydantic

from soopnav_cpp.config import load_toml
from soopnav_cpp.scenarios.base import Scenario, System

__all__ = ["SYSTEMS", "Systems", "load", "register"]

_T = TypeVar("_T")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_ENTRY_POINTS = "soopnav.systems"


class Systems:
    """Systems by name; those of this package and of entry points are found when they are first asked for."""

    def __init__(self, *, discover: bool = False) -> None:
        self._systems: dict[str, System] = {}
        self._undiscovered = discover

    def add(self, system: System) -> System:
        """Take a system in.

        Raises
        ------
        ValueError
            For a name that is taken or not lower case, and for one without a scenario model.
        """
        name = getattr(system, "name", None)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ValueError(f"{system!r}: name: a name in lower case, digits and _ expected, got {name!r}")
        model = getattr(system, "scenario", None)
        if not (isinstance(model, type) and issubclass(model, Scenario)):
            raise ValueError(f"{name}: scenario: a subclass of Scenario expected, got {model!r}")
        if name in self._systems and type(self._systems[name]) is not type(system):
            raise ValueError(f"{name}: already registered")
        self._systems[name] = system
        return system

    def all(self) -> list[System]:
        """Every system, by name."""
        if self._undiscovered:
            package = importlib.import_module("soopnav_cpp.scenarios")
            for module in pkgutil.iter_modules(package.__path__):
                importlib.import_module(f"{package.__name__}.{module.name}")
            for entry in importlib.metadata.entry_points(group=_ENTRY_POINTS):
                try:
                    entry.load()
                except Exception as error:
                    raise ValueError(f"system {entry.name} ({entry.value}) cannot be imported: {error}") from error
            self._undiscovered = False
        return [self._systems[name] for name in sorted(self._systems)]

    def get(self, name: str) -> System:
        """The system of this name.

        Raises
        ------
        ValueError
            When there is none; the sentence has names that are near.
        """
        names = [system.name for system in self.all()]
        if name not in names:
            near = difflib.get_close_matches(name, names, n=2, cutoff=0.5)
            hint = f"; did you mean {' or '.join(near)}?" if near else f"; there are {', '.join(names) or 'none'}"
            raise ValueError(f"unknown system {name!r}{hint}")
        return self._systems[name]


SYSTEMS = Systems(discover=True)


def register(system: _T) -> _T:
    """Register a system, or as a decorator the class of one that is made without arguments; returns its argument."""
    made: Any = system() if isinstance(system, type) else system
    SYSTEMS.add(made)
    return system


class _Head(pydantic.BaseModel):
    """Only the name of the system."""

    model_config = pydantic.ConfigDict(extra="ignore", strict=True, hide_input_in_errors=True)
    system: str

    @pydantic.field_validator("system")
    @classmethod
    def _known(cls, name: str) -> str:
        SYSTEMS.get(name)
        return name


def load(path: str | Path, *, seed: int | None = None, runs: int | None = None) -> tuple[System, Scenario]:
    """Read a scenario, and find the system that it is for.

    Parameters
    ----------
    path : path
        A TOML file; relative files in it count from its folder.
    seed, runs : int, optional
        In place of the scenario's.

    Returns
    -------
    system : System
    scenario : Scenario
        Of the system's own model.

    Raises
    ------
    ConfigError
        ``FILE:LINE: KEY: RULE`` for each mistake.
    ValueError
        For a seed or a number of runs out of range.
    """
    file = Path(path)
    system = SYSTEMS.get(load_toml(file, _Head).system)
    scenario = load_toml(file, system.scenario)
    changes = {}
    if seed is not None:
        if not 0 <= seed < 2**63:
            raise ValueError(f"seed = {seed}: 0 ... 2^63 - 1 expected")
        changes["seed"] = seed
    if runs is not None:
        if runs < 1:
            raise ValueError(f"runs = {runs}: at least 1 expected")
        changes["runs"] = runs
    return system, scenario.model_copy(update=changes)
