"""Scenarios of a handset indoors: ``system = "handset"`` (nielsen 4.2.3), from observables or from IQ and frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import InputFile, Model
from soopnav_cpp.scenarios.base import Scenario, SystemRun
from soopnav_cpp.scenarios.registry import register
from soopnav_cpp.scenarios.source_localization import Vector2

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "CameraSettings",
    "ClockSettings",
    "FilterSettings",
    "Handset",
    "HandsetRun",
    "HandsetScenario",
    "LteSettings",
    "NlosSettings",
    "NodeSettings",
    "RoomSettings",
]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
_MOST_NODES = 12
#: Resource blocks and the sample rate that holds them, as base stations have them.
RATES_HZ = {6: 1.92e6, 15: 3.84e6, 25: 7.68e6, 50: 15.36e6, 75: 23.04e6, 100: 30.72e6}


class RoomSettings(Model):
    """A square room about (0, 0), and how the handset is carried through it.

    Attributes
    ----------
    size_m : float
        Side of the room.
    speed_mps : list of two numbers
        Slowest and fastest.
    walls : bool
        The filter knows the walls.
    """

    size_m: Annotated[float, Field(gt=6.0, le=200.0)] = 20.0
    speed_mps: Vector2 = (0.4, 1.0)
    walls: bool = True

    @pydantic.model_validator(mode="after")
    def _fits(self) -> RoomSettings:
        low, high = self.speed_mps
        if not 0.0 < low <= high <= 5.0:
            raise ValueError(f"speed_mps: [{low:g}, {high:g}]: two speeds above 0, at most 5, the slower one first")
        return self


class NodeSettings(Model):
    """Base stations outside of the room.

    Attributes
    ----------
    positions_m : list
        x and y of each; without them `count` are drawn for each run.
    count : int
        Drawn all round the room.
    distance_m : list of two numbers
        Nearest and farthest, from the middle of the room.
    """

    positions_m: list[Vector2] = Field(default_factory=list)
    count: Annotated[int, Field(ge=3, le=_MOST_NODES)] = 6
    distance_m: Vector2 = (25.0, 60.0)

    @pydantic.model_validator(mode="after")
    def _fits(self) -> NodeSettings:
        low, high = self.distance_m
        if not 0.0 < low <= high:
            raise ValueError(f"distance_m: [{low:g}, {high:g}]: two distances, the nearer one first, expected")
        if self.positions_m and not 3 <= len(self.positions_m) <= _MOST_NODES:
            raise ValueError(f"positions_m: 3 … {_MOST_NODES} nodes expected, got {len(self.positions_m)}")
        return self


class LteSettings(Model):
    """The radio.

    Attributes
    ----------
    rate_hz : float
        Epochs per second.
    sigma_m : float
        Of a range, in the stage observables; in the other stage what the filter adds to the deviation that is measured,
        for paths that could not be told apart and whose phases are others at the next epoch.
    multipath_sigma_m : float, optional
        In the stage iq_and_frames: of what such paths add to a range for metres on end, as the filter is told
        (`HandsetLocator`, ``multipath_sigma_m``). Without it 2 % of the length that the bandwidth can tell apart,
        c / (n_rb 180 kHz), where there is multipath.
    multipath_length_m : float, optional
        Walked until that is another. Without it half of the room's side.
    n_rb : int
        Resource blocks of each cell, in the stage iq_and_frames.
    n_ports : int
        Antenna ports of each cell.
    snr_db : float
        Per reference element of the strongest cell.
    spread_db : float
        The other cells arrive at up to so much less.
    load : float
        Share of the resource elements for data that each cell sends: noise to the other cells' reference signals.
    subframes : int
        That are averaged at each epoch.
    neighbours : bool
        Cells that the search misses are taken from the network's list of neighbours.
    multipath : str
        "room": image paths and diffuse tail of a room with brick walls and windows; "none": one path per cell.
    time_offset_s : float
        By which the radio's time stamps are ahead of the camera's.
    """

    rate_hz: Annotated[float, Field(ge=0.5, le=50.0)] = 10.0
    sigma_m: Positive = 1.0
    multipath_sigma_m: NotNegative | None = None
    multipath_length_m: Positive | None = None
    n_rb: Literal[6, 15, 25, 50, 75, 100] = 100
    n_ports: Literal[1, 2] = 2
    snr_db: Annotated[float, Field(ge=-10.0, le=40.0)] = 20.0
    spread_db: Annotated[float, Field(ge=0.0, le=20.0)] = 6.0
    load: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    subframes: Annotated[int, Field(ge=1, le=10)] = 1
    neighbours: bool = False
    multipath: Literal["room", "none"] = "room"
    time_offset_s: float = 0.0


class CameraSettings(Model):
    """The camera that looks at the floor.

    Attributes
    ----------
    rate_hz : float
        Frames per second.
    sigma_mm : float
        Of each coordinate of a step of 20 mm, in the stage observables; it grows with the root of the step.
    turn_sigma_deg : float
        Of the turn between two frames, in the stage observables.
    inflation : float
        The filter is told deviations of the steps that are larger by this factor.
    file : file name
        A camera as soopnav egomotion reads it; without one a pinhole of 640 x 480, 525 px.
    height_m : float
        Above the floor.
    tilt_x_deg, tilt_y_deg : float
        Of the camera.
    depth_sigma_m : float
        Noise of a depth sensor at 1 m that the plane is fitted from; 0: the plane is known.
    depth_points : int
        That the depth sensor gives per frame.
    noise : float
        Of the pixels, in grey levels.
    dropped_share : float
        Of frames that are lost, at random.
    """

    rate_hz: Annotated[float, Field(ge=1.0, le=120.0)] = 20.0
    sigma_mm: Positive = 0.2
    turn_sigma_deg: Positive = 0.02
    inflation: Annotated[float, Field(ge=1.0, le=100.0)] = 5.0
    file: InputFile | None = None
    height_m: Annotated[float, Field(ge=0.2, le=10.0)] = 1.1
    tilt_x_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 6.0
    tilt_y_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = -4.0
    depth_sigma_m: NotNegative = 0.003
    depth_points: Annotated[int, Field(ge=100, le=300_000)] = 10_000
    noise: NotNegative = 2.0
    dropped_share: Annotated[float, Field(ge=0.0, le=0.9)] = 0.0


class ClockSettings(Model):
    """The handset's oscillator.

    Attributes
    ----------
    walk_m_per_sqrt_s : float
        Random walk of its time, times the speed of light.
    start_sigma_m : float
        Of its time at the start.
    """

    walk_m_per_sqrt_s: NotNegative = 0.2
    start_sigma_m: Positive = 1000.0


class NlosSettings(Model):
    """Links whose direct path is shut: they switch as a Markov chain, and are longer by an excess that wanders.

    Attributes
    ----------
    most : int
        Links that are shut at a time.
    least_los_share : float
        Of the time that each link is open.
    mean_los_s, mean_nlos_s : float
        Mean times in either state.
    excess_m : list of two numbers
        Uniform when a link shuts.
    wander_m_per_sqrt_s : float
        Of the excess while it is shut.
    known : bool
        The filter has a Boolean per link; otherwise every range counts as direct.
    """

    most: Annotated[int, Field(ge=0, le=_MOST_NODES)] = 2
    least_los_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.4
    mean_los_s: Positive = 10.0
    mean_nlos_s: Positive = 5.0
    excess_m: Vector2 = (4.0, 20.0)
    wander_m_per_sqrt_s: NotNegative = 0.158
    known: bool = True

    @pydantic.model_validator(mode="after")
    def _fits(self) -> NlosSettings:
        low, high = self.excess_m
        if not 0.0 <= low < high:
            raise ValueError(f"excess_m: [{low:g}, {high:g}]: two lengths, the shorter one first, expected")
        return self


class FilterSettings(Model):
    """The particle filter.

    Attributes
    ----------
    type : str
        "control": the camera's steps move the particles (nielsen's type 1); "measurement": they are measured (type 2).
    particles : int
        Particles.
    start_sigma_m : float
        Of the start, which is drawn with it.
    heading_sigma_deg : float
        Of the heading at the start, which is drawn within it.
    """

    type: Literal["control", "measurement"] = "control"
    particles: Annotated[int, Field(ge=50, le=100_000)] = 2000
    start_sigma_m: Positive = 5.0
    heading_sigma_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 10.0


class HandsetScenario(Scenario):
    """A handset is carried through a room: LTE from outside, a camera that looks at the floor.

    Attributes
    ----------
    stage : str
        "observables": ranges and steps are drawn with their errors; "iq_and_frames": samples of all cells are made
        and ranged, frames are rendered and followed.
    room, nodes, lte, camera, clock, nlos, filter : table
    """

    stage: Literal["observables", "iq_and_frames"] = "observables"
    room: RoomSettings = RoomSettings()
    nodes: NodeSettings = NodeSettings()
    lte: LteSettings = LteSettings()
    camera: CameraSettings = CameraSettings()
    clock: ClockSettings = ClockSettings()
    nlos: NlosSettings = NlosSettings()
    filter: FilterSettings = FilterSettings()

    @pydantic.model_validator(mode="after")
    def _fits(self) -> HandsetScenario:
        if self.lte.rate_hz > self.camera.rate_hz:
            raise ValueError(f"lte.rate_hz: {self.lte.rate_hz:g}: at most camera.rate_hz = {self.camera.rate_hz:g}")
        if self.duration_s * self.camera.rate_hz > 200_000.0:
            raise ValueError(f"camera.rate_hz: more than 200000 frames in {self.duration_s:g} s")
        if self.duration_s * self.lte.rate_hz < 2.0:
            raise ValueError(f"duration_s: fewer than 2 epochs at lte.rate_hz = {self.lte.rate_hz:g}")
        if self.nlos.most > self.node_count - 3:
            raise ValueError(
                f"nlos.most: {self.nlos.most}: at least 3 of the {self.node_count} links have to stay open"
            )
        return self

    @property
    def node_count(self) -> int:
        """Base stations."""
        return len(self.nodes.positions_m) or self.nodes.count


EXAMPLE = """\
# A walk of a minute through a room: six base stations outside, a camera that looks at the floor (nielsen 4.2.3).
system = "handset"
title = "A walk through a room with LTE and a camera"
duration_s = 60.0
metrics_start_s = 20.0

[nlos]
most = 2                               # links that are shut at a time

[filter]
type = "control"
particles = 2000
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandsetRun(SystemRun):
    """A run with what its own figures need.

    Attributes
    ----------
    nodes_m : ndarray, shape (L, 2)
    los : ndarray of bool, shape (n, L)
        Which links truly were open at the epochs.
    p_los : ndarray, shape (n, L)
        What the filter says.
    clouds : list of (time, ndarray, shape (k, 2))
        Particles from time to time.
    frame : FrameShown or None
        A frame with its tracks, in the stage iq_and_frames.
    timings_s : dict of str to float
        What the stages took, in seconds of a processor.
    size_m : float
        Of the room.
    """

    nodes_m: _Array
    los: npt.NDArray[np.bool_]
    p_los: _Array
    clouds: list[tuple[float, _Array]]
    frame: Any = None
    timings_s: dict[str, float] = field(default_factory=dict)
    size_m: float = 20.0


@register
class Handset:
    """Makes ranges and steps, or samples and frames, and locates the handset by them."""

    name = "handset"
    title = "a handset indoors: LTE ranges that are shut at times, and a camera that looks at the floor (nielsen 4.2.3)"
    scenario = HandsetScenario
    example = EXAMPLE

    def check(self, scenario: HandsetScenario) -> None:
        """Refuse what cannot be run, before it is run."""
        from soopnav_cpp.scenarios import handset_pipeline as pipeline

        pipeline.check(scenario)

    def run(self, scenario: HandsetScenario, seed: int) -> HandsetRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.scenarios import handset_pipeline as pipeline

        world = pipeline.walk(scenario, seed)
        observed = pipeline.observe(scenario, world, seed)
        return pipeline.to_run(scenario, world, observed, pipeline.locate(scenario, world, observed, seed))

    def figures(self, scenario: HandsetScenario, run: Any) -> dict[str, Figure]:
        """The room with walk, nodes and particles; errors over time; P(LOS) against the truth; a frame with tracks."""
        from soopnav_cpp.scenarios import handset_figures as drawing

        return drawing.figures(scenario, run)

    def files(self, scenario: HandsetScenario, run: Any, folder: Path) -> dict[str, Path]:
        """The animation of the particles."""
        from soopnav_cpp.scenarios import handset_figures as drawing

        del scenario
        return {"Particles over time": drawing.animate(run, folder / "particles.gif")}

    def numbers(self, scenario: HandsetScenario, run: Any) -> dict[str, Any]:
        """What the stages took (of this computer, different each time) and how sight was judged."""
        from soopnav_cpp.scenarios import handset_pipeline as pipeline

        return pipeline.numbers(scenario, run)
