"""Scenarios of finding a radio source: ``system = "source_localization"`` (carter figs. 5.4 and 5.8 in software)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import InputFile, Model, Vector3
from soopnav_cpp.scenarios.base import Scenario, SystemRun
from soopnav_cpp.scenarios.registry import register

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.scenarios.emitters import Emitter
    from soopnav_cpp.scenarios.source_localization_pipeline import Heard

__all__ = [
    "ArraySettings",
    "EmitterRun",
    "EmitterSettings",
    "FinderSettings",
    "FrontEndSettings",
    "LinkSettings",
    "LocatorSettings",
    "PlatformSettings",
    "SourceLocalization",
    "SourceLocalizationScenario",
]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Method = Literal["ml", "stansfield", "least_squares", "ekf_bank", "particle", "ekf", "centroid", "incenter", "linear"]


def _two_numbers(value: object) -> tuple[float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 2 or not all(type(v) in (int, float) for v in value):
        raise ValueError("a list of two numbers expected")
    return (float(value[0]), float(value[1]))


Vector2 = Annotated[tuple[float, float], pydantic.BeforeValidator(_two_numbers)]


class ArraySettings(Model):
    """The antennas. The array lies in the platform's floor: axis 1 forward, axis 2 left, axis 3 up.

    Attributes
    ----------
    file : file name
        A description as soopnav df reads it, in place of the keys below.
    kind : str
        "planar": nx by ny elements; "uca": elements on a circle.
    nx, ny : int
        Elements of a planar array, forward and to the left.
    spacing_wavelengths : float
        Of a planar array.
    elements : int
        On a circle.
    radius_wavelengths : float
        Of the circle.
    frequency_hz : float
        That the array is for, and the carrier of the emitters.
    gain_error_db, phase_error_deg : float
        Standard deviations of errors of each antenna that are drawn for each run and that the direction finder does
        not know of; a calibration of the receivers does not see them.
    """

    file: InputFile | None = None
    kind: Literal["planar", "uca"] = "planar"
    nx: Annotated[int, Field(ge=1, le=32)] = 2
    ny: Annotated[int, Field(ge=1, le=32)] = 2
    spacing_wavelengths: Positive = 0.2
    elements: Annotated[int, Field(ge=3, le=64)] = 5
    radius_wavelengths: Positive = 0.4
    frequency_hz: Annotated[float, Field(ge=1e6, le=1e12)] = 1575.42e6
    gain_error_db: NotNegative = 0.0
    phase_error_deg: NotNegative = 0.0


class PlatformSettings(Model):
    """How the array moves.

    Attributes
    ----------
    poses : file name
        A recording in place of the keys below: CSV (time_s, x_m, y_m, z_m or latitude_deg, longitude_deg, height_m;
        heading_deg, pitch_deg, roll_deg) or TUM. Latitudes are put into the metres of the scenario's origin; without
        one the first pose is the origin.
    waypoints_m : list
        East and north of points that straight legs join; the platform covers them at one speed in duration_s.
    corner_radius_m : float
        Legs are joined by arcs of this radius (where both legs are long enough).
    height_m : float
        Of the array.
    position_sigma_m, heading_sigma_deg : float
        Error of each coordinate and of the heading that the platform states at an epoch; the locators are told.
    """

    poses: InputFile | None = None
    waypoints_m: list[Vector2] = Field(default_factory=list)
    corner_radius_m: NotNegative = 0.0
    height_m: float = 0.0
    position_sigma_m: NotNegative = 0.0
    heading_sigma_deg: NotNegative = 0.0

    @pydantic.model_validator(mode="after")
    def _one_way(self) -> PlatformSettings:
        if (self.poses is None) == (not self.waypoints_m):
            raise ValueError("poses or waypoints_m expected, and not both")
        if self.waypoints_m and len(self.waypoints_m) < 2:
            raise ValueError("waypoints_m: at least 2 needed, got 1")
        for k, (a, b) in enumerate(zip(self.waypoints_m[:-1], self.waypoints_m[1:], strict=True)):
            if not math.dist(a, b) > 0.0:
                raise ValueError(f"waypoints_m[{k + 1}]: the same as the one before")
        return self


class EmitterSettings(Model):
    """A transmitter to be found.

    Attributes
    ----------
    position_m : list of three numbers
        East, north, up, at time 0.
    velocity_mps : list of three numbers
        Constant.
    power_dbm : float
        Transmitted, over an isotropic antenna.
    name : str
        For the report; without one they are counted.
    """

    position_m: Vector3
    velocity_mps: Vector3 = (0.0, 0.0, 0.0)
    power_dbm: float = 10.0
    name: str = ""


class LinkSettings(Model):
    """From the emitter's antenna to samples (carter 2.4 and 5.1).

    Attributes
    ----------
    sample_rate_hz : float
        Of the front end, and the width of its noise.
    samples : int
        Per epoch.
    bandwidth_ratio : float
        Of the signal to the front end.
    noise_figure_db : float
        Of the receivers.
    excess_loss_db : float
        Beyond free space: polarisation, bodies, attenuators.
    """

    sample_rate_hz: Annotated[float, Field(ge=1e3, le=1e10)] = 20e6
    samples: Annotated[int, Field(ge=16, le=10_000_000)] = 2500
    bandwidth_ratio: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    noise_figure_db: NotNegative = 6.0
    excess_loss_db: NotNegative = 0.0


class FrontEndSettings(Model):
    """What receivers do to the samples, drawn for each run, and whether a calibration takes it away (carter 5.2).

    Attributes
    ----------
    iq_gain_db, iq_phase_deg : float
        Standard deviations of each channel's imbalance of I and Q.
    random_phases : bool
        Each channel has a phase of its own.
    adc_bits : int
        Of the converters; 0: none.
    calibrate : bool
        A tone goes into all channels before the drive, and what it shows is taken away.
    tone_snr_db : float
        Of that tone, per sample.
    """

    iq_gain_db: NotNegative = 0.0
    iq_phase_deg: NotNegative = 0.0
    random_phases: bool = False
    adc_bits: Annotated[int, Field(ge=0, le=24)] = 0
    calibrate: bool = True
    tone_snr_db: Annotated[float, Field(ge=0.0, le=80.0)] = 40.0

    @pydantic.model_validator(mode="after")
    def _signed(self) -> FrontEndSettings:
        if self.adc_bits == 1:
            raise ValueError("adc_bits: 1: 0 or at least 2 expected")
        return self

    @property
    def ideal(self) -> bool:
        """Whether there is nothing that it does."""
        return not (self.iq_gain_db or self.iq_phase_deg or self.random_phases or self.adc_bits)


class FinderSettings(Model):
    """The direction finder.

    Attributes
    ----------
    rate_hz : float
        Bearings per second.
    azimuth_step_deg, elevation_step_deg : float
        Of the grid, before refinement.
    smooth_epochs : int
        Epochs, an odd number, over which eigenvalues are averaged before they say how good a bearing is.
    sigma : str
        "map": a Monte-Carlo of the array says which error belongs to which ratio of eigenvalues (carter 5.3); "theory":
        the asymptotic covariance of MUSIC.
    worst_sigma_deg : float
        Bearings that are said to be worse are not used.
    """

    rate_hz: Positive = 1.0
    azimuth_step_deg: Annotated[float, Field(gt=0.0, le=10.0)] = 2.0
    elevation_step_deg: Annotated[float, Field(gt=0.0, le=10.0)] = 3.0
    smooth_epochs: Annotated[int, Field(ge=1, le=1001)] = 11
    sigma: Literal["map", "theory"] = "map"
    worst_sigma_deg: Positive = 60.0

    @pydantic.model_validator(mode="after")
    def _odd(self) -> FinderSettings:
        if self.smooth_epochs % 2 == 0:
            raise ValueError(f"smooth_epochs: {self.smooth_epochs}: an odd number expected")
        return self


class LocatorSettings(Model):
    """The methods that turn bearings into a position.

    Attributes
    ----------
    method : str
        Whose positions the trajectory and the metrics are of.
    others : list
        Methods to compare with.
    dimensions : int
        2: bearings; 3: bearings and elevations.
    moving : bool
        The emitter may move at a constant velocity (ml, least_squares, ekf_bank and ekf only).
    """

    method: Method = "ml"
    others: list[Method] = Field(default_factory=list)
    dimensions: Literal[2, 3] = 2
    moving: bool = False

    @pydantic.model_validator(mode="after")
    def _fits(self) -> LocatorSettings:
        still = {"stansfield", "particle", "centroid", "incenter", "linear"} & {self.method, *self.others}
        if self.moving and still:
            raise ValueError(f"moving: {', '.join(sorted(still))} finds emitters that stand still")
        return self

    @property
    def methods(self) -> tuple[str, ...]:
        """All, the main one first."""
        return (self.method, *(name for name in self.others if name != self.method))


class SourceLocalizationScenario(Scenario):
    """A vehicle with an array of antennas drives past transmitters and finds where they are.

    Attributes
    ----------
    array, platform, link, front_end, finder, locator : table
    emitters : list of tables
        The first one is what the trajectory and the metrics are about. Several are told apart by their directions.
    """

    array: ArraySettings = ArraySettings()
    platform: PlatformSettings
    emitters: Annotated[list[EmitterSettings], Field(min_length=1, max_length=4)]
    link: LinkSettings = LinkSettings()
    front_end: FrontEndSettings = FrontEndSettings()
    finder: FinderSettings = FinderSettings()
    locator: LocatorSettings = LocatorSettings()

    @pydantic.model_validator(mode="after")
    def _fits(self) -> SourceLocalizationScenario:
        if self.duration_s * self.finder.rate_hz < 2.0:
            raise ValueError(f"duration_s: fewer than 3 bearings at finder.rate_hz = {self.finder.rate_hz:g}")
        if self.duration_s * self.finder.rate_hz > 20_000.0:
            raise ValueError(f"finder.rate_hz: more than 20000 bearings in {self.duration_s:g} s")
        if self.array.file is None:
            elements = self.array.nx * self.array.ny if self.array.kind == "planar" else self.array.elements
            if elements <= len(self.emitters):
                raise ValueError(f"array: {elements} elements cannot tell {len(self.emitters)} emitters apart")
        return self

    @property
    def emitter_names(self) -> tuple[str, ...]:
        """Names, or numbers from 1."""
        if len(self.emitters) == 1 and not self.emitters[0].name:
            return ("emitter",)
        return tuple(item.name or f"emitter {i + 1}" for i, item in enumerate(self.emitters))


EXAMPLE = """\
# A drive past a transmitter of 10 mW: four antennas, bearings by MUSIC, a position by maximum likelihood (carter 5).
system = "source_localization"
title = "A transmitter found on a drive past it"
duration_s = 240.0
metrics_start_s = 120.0

[platform]
waypoints_m = [[-1200.0, -150.0], [150.0, -150.0], [150.0, 1200.0]]
corner_radius_m = 150.0

[[emitters]]
position_m = [0.0, 0.0, 30.0]

[link]
excess_loss_db = 26.6

[locator]
others = ["particle", "stansfield"]
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class EmitterRun(SystemRun):
    """A run with what its own figures need.

    Attributes
    ----------
    heard : Heard
    located : list of Emitter
        Those that were found, in the scenario's order.
    """

    heard: Heard
    located: list[Emitter]


@register
class SourceLocalization:
    """Makes samples from poses, bearings from samples, positions from bearings."""

    name = "source_localization"
    title = "a radio source found from a moving array of antennas (carter chapters 4 and 5)"
    scenario = SourceLocalizationScenario
    example = EXAMPLE

    def check(self, scenario: SourceLocalizationScenario) -> None:
        """Refuse what cannot be run, before it is run."""
        from soopnav_cpp.scenarios import source_localization_pipeline as pipeline

        pipeline.path_of(scenario)
        elements = len(pipeline.manifold_of(scenario).geometry.positions_m)
        if elements <= len(scenario.emitters):
            raise ValueError(f"array: {elements} elements cannot tell {len(scenario.emitters)} emitters apart")

    def run(self, scenario: SourceLocalizationScenario, seed: int) -> EmitterRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.scenarios import source_localization_pipeline as pipeline

        heard = pipeline.hear(scenario, seed)
        located = pipeline.locate(scenario, heard, seed)
        return pipeline.to_run(scenario, heard, located)

    def figures(self, scenario: SourceLocalizationScenario, run: Any) -> dict[str, Figure]:
        """The map of bearings, what is said of them over the distance, positions by method, surfaces and clouds."""
        from soopnav_cpp.scenarios import source_localization_figures as drawing

        return drawing.figures(scenario, run)
