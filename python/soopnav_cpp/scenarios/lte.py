"""What ``soopnav locate`` and ``soopnav synth`` read: nodes files and captures to be made, TOML checked by pydantic."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import pydantic
from pydantic import Field

from soopnav_cpp.config import ConfigError, Model, Vector3, load_toml
from soopnav_cpp.scenarios.base import Latitude, Longitude, Origin

__all__ = [
    "CaptureSettings",
    "ConfigError",
    "LteScenario",
    "Node",
    "NodesFile",
    "Origin",
    "Receiver",
    "ScenarioCell",
    "ScenarioReceiver",
    "Tap",
    "load_lte_scenario",
    "load_nodes",
]

CellId = Annotated[int, Field(ge=0, le=503)]
Bandwidth = Literal[6, 15, 25, 50, 75, 100]


class Node(Model):
    """A transmitter whose position is known: in local metres, or geodetic.

    Attributes
    ----------
    cell_id : int
    name : str or None
        For the report.
    position_m : three floats, optional
        East, north, up.
    latitude_deg, longitude_deg : float, optional
    height_m : float
        Above the ellipsoid, with latitude and longitude.
    antenna_height_m : float
        Added to the height of the position.
    clock_offset_s : float
        How late the node transmits.
    sigma_s : float
        Standard deviation of its clock, added to that of the measurement.
    """

    cell_id: CellId
    name: str | None = None
    position_m: Vector3 | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    height_m: float | None = None
    antenna_height_m: float = 0.0
    clock_offset_s: Annotated[float, Field(gt=-0.01, lt=0.01)] = 0.0
    sigma_s: Annotated[float, Field(ge=0.0, lt=0.01)] = 0.0

    @property
    def geodetic(self) -> bool:
        """Whether the position is latitude and longitude."""
        return self.position_m is None

    @pydantic.model_validator(mode="after")
    def _one_position(self) -> Node:
        degrees = self.latitude_deg is not None, self.longitude_deg is not None
        if self.position_m is not None:
            if any(degrees) or self.height_m is not None:
                raise ValueError("position_m or latitude_deg, longitude_deg and height_m, not both")
        elif not all(degrees):
            raise ValueError("a position is needed: position_m = [east, north, up], or latitude_deg and longitude_deg")
        return self


class Receiver(Model):
    """What is known about the receiver.

    Attributes
    ----------
    height_m : float, optional
        Its height, in the frame of the nodes: the position is solved in two dimensions at this height. Without it, in
        three.
    """

    height_m: float | None = None


class NodesFile(Model):
    """``[[nodes]]``, and optionally ``[receiver]`` and ``[origin]``."""

    nodes: Annotated[list[Node], Field(min_length=1)]
    receiver: Receiver = Receiver()
    origin: Origin | None = None

    @pydantic.field_validator("nodes")
    @classmethod
    def _fit_together(cls, nodes: list[Node]) -> list[Node]:
        seen: dict[int, int] = {}
        for index, node in enumerate(nodes):
            if node.cell_id in seen:
                raise ValueError(f"cell_id {node.cell_id} is given twice (nodes[{seen[node.cell_id]}], nodes[{index}])")
            seen[node.cell_id] = index
        if len({node.geodetic for node in nodes}) > 1:
            raise ValueError("all positions in local metres or all geodetic, not both")
        return nodes

    @pydantic.model_validator(mode="after")
    def _origin_of_local_metres(self) -> NodesFile:
        if self.origin is not None and self.nodes[0].geodetic:
            raise ValueError("[origin] is for positions in local metres")
        return self


class CaptureSettings(Model):
    """``[capture]`` of a scenario.

    Attributes
    ----------
    sample_rate_hz, duration_s : float
    snr_db : float, optional
        Per reference element of a cell at ``power_db = 0``; without it there is no noise.
    seed : int
        Of noise and data.
    format : {"cf32", "ci16", "ci8", "cu8"}
    peak : float
        The largest I or Q of the file, 1.0 being full scale.
    center_frequency_hz : float, optional
        Radio frequency; needed for ``clock_error_ppm``.
    """

    sample_rate_hz: Annotated[float, Field(ge=1.4e6, le=100e6)]
    duration_s: Annotated[float, Field(gt=0.0, le=10.0)]
    snr_db: Annotated[float, Field(ge=-60.0, le=120.0)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    format: Literal["cf32", "ci16", "ci8", "cu8"] = "cf32"
    peak: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    center_frequency_hz: Annotated[float, Field(gt=0.0)] | None = None
    description: str | None = None


class ScenarioReceiver(Model):
    """``[receiver]`` of a scenario.

    Attributes
    ----------
    position_m : three floats
        East, north, up.
    clock_bias_s : float
        How late the receiver's clock makes every arrival.
    cfo_hz : float
        Carrier offset that the receiver's tuning adds to every cell.
    clock_error_ppm : float
        How much faster the transmitters' clocks run than the receiver's one crystal: frames get short in samples, and
        carriers move by this times ``center_frequency_hz``.
    """

    position_m: Vector3
    clock_bias_s: Annotated[float, Field(gt=-0.01, lt=0.01)] = 0.0
    cfo_hz: Annotated[float, Field(ge=-250e3, le=250e3)] = 0.0
    clock_error_ppm: Annotated[float, Field(ge=-200.0, le=200.0)] = 0.0


class Tap(Model):
    """A propagation path beside the direct one (or, with ``delay_s = 0``, instead of it)."""

    delay_s: Annotated[float, Field(ge=0.0, le=1e-3)]
    power_db: Annotated[float, Field(ge=-200.0, le=60.0)]
    phase_rad: float = 0.0

    @property
    def gain(self) -> complex:
        """Complex amplitude."""
        amplitude = 10.0 ** (self.power_db / 20.0)
        return complex(amplitude * math.cos(self.phase_rad), amplitude * math.sin(self.phase_rad))


class ScenarioCell(Model):
    """One of ``[[cells]]`` of a scenario.

    Attributes
    ----------
    cell_id : int
    position_m : three floats
        Of its antenna: east, north, up.
    n_rb, n_ports : int
    cp : {"normal", "extended"}
    duplex : {"FDD", "TDD"}
    tdd_configuration, special_subframe_configuration : int
        Uplink-downlink and special-subframe configuration (TS 36.211 tables 4.2-2, 4.2-1), for TDD.
    start_sfn : int
        Frame number of the frame that starts at time 0 of the cell's clock.
    clock_offset_s : float
        How late it transmits.
    power_db : float
        At the receiver.
    cfo_hz : float
    phase_rad : float
        Of the carrier at the capture's first sample.
    taps : list of Tap
        All paths, delays after the line of sight; without any, one path at 0.
    """

    cell_id: CellId
    position_m: Vector3
    n_rb: Bandwidth = 50
    n_ports: Literal[1, 2, 4] = 1
    cp: Literal["normal", "extended"] = "normal"
    duplex: Literal["FDD", "TDD"] = "FDD"
    tdd_configuration: Annotated[int, Field(ge=0, le=6)] = 0
    special_subframe_configuration: Annotated[int, Field(ge=0, le=9)] = 7
    start_sfn: Annotated[int, Field(ge=0, le=1023)] = 0
    clock_offset_s: Annotated[float, Field(gt=-0.01, lt=0.01)] = 0.0
    power_db: Annotated[float, Field(ge=-200.0, le=60.0)] = 0.0
    cfo_hz: Annotated[float, Field(ge=-250e3, le=250e3)] = 0.0
    phase_rad: float = 0.0
    taps: list[Tap] = Field(default_factory=list)


class LteScenario(Model):
    """``[capture]``, ``[receiver]`` and ``[[cells]]``: a capture to be made."""

    capture: CaptureSettings
    receiver: ScenarioReceiver
    cells: Annotated[list[ScenarioCell], Field(min_length=1)]

    @pydantic.model_validator(mode="after")
    def _carrier_known(self) -> LteScenario:
        if self.receiver.clock_error_ppm and self.capture.center_frequency_hz is None:
            raise ValueError("receiver.clock_error_ppm needs capture.center_frequency_hz")
        return self


def load_nodes(path: Path) -> NodesFile:
    """Read a nodes file; `ConfigError` says what does not fit, and on which line."""
    return load_toml(path, NodesFile)


def load_lte_scenario(path: Path) -> LteScenario:
    """Read a scenario of ``soopnav synth lte``; `ConfigError` says what does not fit, and on which line."""
    return load_toml(path, LteScenario)
