"""Scenarios: TOML files that say what a system goes through, and what comes out of it.

`load` reads one with the system it names; `soopnav_cpp.scenarios.execution` runs it, `metrics` measures, `writers` and
`report` write. A system is a class with a scenario model and a ``run``; `registry` says how one is added. What
``soopnav locate`` and ``soopnav synth`` read is in `lte`, recordings that stand in for simulated sensors in `files`.
"""

from soopnav_cpp.config import ConfigError, InputFile
from soopnav_cpp.scenarios.base import Origin, Scenario, System, SystemRun, Truth, Updates
from soopnav_cpp.scenarios.lte import (
    CaptureSettings,
    LteScenario,
    Node,
    NodesFile,
    Receiver,
    ScenarioCell,
    ScenarioReceiver,
    Tap,
    load_lte_scenario,
    load_nodes,
)
from soopnav_cpp.scenarios.registry import SYSTEMS, load, register

__all__ = [
    "SYSTEMS",
    "CaptureSettings",
    "ConfigError",
    "InputFile",
    "LteScenario",
    "Node",
    "NodesFile",
    "Origin",
    "Receiver",
    "Scenario",
    "ScenarioCell",
    "ScenarioReceiver",
    "System",
    "SystemRun",
    "Tap",
    "Truth",
    "Updates",
    "load",
    "load_lte_scenario",
    "load_nodes",
    "register",
]
