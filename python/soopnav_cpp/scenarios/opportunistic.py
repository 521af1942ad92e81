"""Scenarios of opportunistic navigation: ``system = "opportunistic"`` (pesyna), phases from the exact model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import Model
from soopnav_cpp.scenarios.base import Latitude, Longitude, Scenario, SystemRun
from soopnav_cpp.scenarios.registry import register

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.clock import TwoState

__all__ = ["Basestation", "Opportunistic", "OpportunisticScenario", "ReceiverSettings", "SatelliteSettings"]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
L1_HZ = 1575.42e6
_LIGHT_MPS = 299_792_458.0
_WEEK_S = 302_400.0


class ReceiverSettings(Model):
    """The receiver: where it stands, its oscillator, how often it observes.

    Attributes
    ----------
    latitude_deg, longitude_deg, height_m : float
    position_sigma_m : float
        How well each coordinate is known at the start; its error is drawn.
    oscillator : str
        "tcxo", "ocxo", or "other" with `h0` and `h_minus_2`; the filter is told the same.
    h0, h_minus_2 : float
        White frequency noise [s] and random walk of frequency [Hz] of "other".
    interval_s : float
        Between epochs.
    """

    latitude_deg: Latitude = 30.27
    longitude_deg: Longitude = -97.74
    height_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 180.0
    position_sigma_m: Annotated[float, Field(gt=0.0, le=1e5)] = 10.0
    oscillator: Literal["tcxo", "ocxo", "other"] = "tcxo"
    h0: NotNegative = 1e-20
    h_minus_2: NotNegative = 1e-22
    interval_s: Annotated[float, Field(ge=0.01, le=10.0)] = 0.1


class SatelliteSettings(Model):
    """GPS: a made-up constellation of thirty, the highest of those above the mask.

    Attributes
    ----------
    count : int
    mask_deg : float
    cn0_dbhz : float
    code_sigma_m : float
    """

    count: Annotated[int, Field(ge=0, le=16)] = 6
    mask_deg: Annotated[float, Field(ge=0.0, le=60.0)] = 15.0
    cn0_dbhz: Annotated[float, Field(ge=20.0, le=70.0)] = 45.0
    code_sigma_m: Positive = 1.0


class Basestation(Model):
    """A cellular transmitter with its own clock.

    Attributes
    ----------
    name : str
    position_m : list of three numbers
        East, north, up of the receiver's surveyed place.
    carrier_hz : float
    h0, h_minus_2 : float
        Of its clock.
    cn0_dbhz : float
    joins_s, leaves_s : float
        When it is heard; joins when stage 2 begins by default.
    """

    name: Annotated[str, Field(min_length=1, max_length=20)]
    position_m: Annotated[list[float], Field(min_length=3, max_length=3)]
    carrier_hz: Annotated[float, Field(ge=1e7, le=1e11)] = 883.98e6
    h0: NotNegative = 1e-23
    h_minus_2: NotNegative = 1e-25
    cn0_dbhz: Annotated[float, Field(ge=20.0, le=90.0)] = 55.0
    joins_s: NotNegative | None = None
    leaves_s: NotNegative | None = None


class OpportunisticScenario(Scenario):
    """GPS alone, GPS and basestations, basestations alone: one estimator through all three.

    Attributes
    ----------
    stage_2_s, stage_3_s : float
        When the basestations are added, and when GPS is lost.
    gps_returns_s : float, optional
        When it is back.
    characterization : str
        What the filter takes for the basestations' clock noise: "true"; "likelihood", fitted in stage 2 to the GPS
        clock less each phase and replaced when GPS is lost; "wrong", a hundred times too much for the first and a
        hundredth of it for the second.
    receiver, gps : table
    basestations : list of table
    """

    stage_2_s: NotNegative = 60.0
    stage_3_s: NotNegative = 300.0
    gps_returns_s: NotNegative | None = None
    characterization: Literal["true", "likelihood", "wrong"] = "likelihood"
    receiver: ReceiverSettings = ReceiverSettings()
    gps: SatelliteSettings = SatelliteSettings()
    basestations: Annotated[list[Basestation], Field(max_length=16)] = Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def _fits(self) -> OpportunisticScenario:
        if not self.stage_2_s < self.stage_3_s < self.duration_s:
            raise ValueError(
                f"stage_2_s, stage_3_s: 0 <= stage_2_s < stage_3_s < duration_s expected, got {self.stage_2_s:g}, "
                f"{self.stage_3_s:g}, {self.duration_s:g}"
            )
        if self.gps_returns_s is not None and self.gps_returns_s <= self.stage_3_s:
            raise ValueError(
                f"gps_returns_s: {self.gps_returns_s:g}: later than stage_3_s = {self.stage_3_s:g} expected"
            )
        names = [b.name for b in self.basestations]
        if len(set(names)) != len(names):
            raise ValueError("basestations: each name once expected")
        for b in self.basestations:
            if math.hypot(*b.position_m) < 10.0:
                raise ValueError(f"basestations: {b.name}: at least 10 m from the receiver expected")
            if b.joins_s is not None and b.leaves_s is not None and b.leaves_s <= b.joins_s:
                raise ValueError(f"basestations: {b.name}: leaves_s after joins_s expected")
        if self.duration_s / self.receiver.interval_s > 20_000:
            raise ValueError(f"duration_s: {self.duration_s / self.receiver.interval_s:.0f} epochs; at most 20000")
        return self


EXAMPLE = """\
# GPS for a minute, GPS and two cellular basestations for four, then the basestations alone (pesyna).
system = "opportunistic"
title = "A TCXO steered by two basestations after GPS is lost"
duration_s = 540.0
stage_2_s = 60.0
stage_3_s = 300.0
characterization = "likelihood"        # or "true", "wrong"

[receiver]
oscillator = "tcxo"
interval_s = 0.1

[gps]
count = 6

[[basestations]]
name = "steady"
position_m = [1200.0, 800.0, 30.0]
h0 = 3e-25
h_minus_2 = 3e-27

[[basestations]]
name = "other"
position_m = [-900.0, 1500.0, 20.0]
h0 = 1e-23
h_minus_2 = 1e-25
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpportunisticSystemRun(SystemRun):
    """A run with what its own figures need.

    Attributes
    ----------
    clock_error_s, clock_sigma_s : ndarray, shape (n,)
        Of the receiver's clock, filtered.
    smoothed_error_s : ndarray, shape (n,)
        Smoothed by stage: with GPS, and without it.
    clock_true_s : ndarray, shape (n,)
    stage : ndarray of int, shape (n,)
        1, 2 or 3.
    heard : dict of str to ndarray of bool, shape (n,)
    noise : dict of str to tuple
        Name: (true, taken) clock noise as TwoState.
    slips : int
    unobservable : tuple of str
        Directions that stage 3 leaves open.
    """

    clock_error_s: _Array
    clock_sigma_s: _Array
    smoothed_error_s: _Array
    clock_true_s: _Array
    stage: npt.NDArray[np.int64]
    heard: dict[str, npt.NDArray[np.bool_]]
    noise: dict[str, tuple[TwoState, TwoState]]
    slips: int
    unobservable: tuple[str, ...]


@register
class Opportunistic:
    """Draws clocks and phases and runs `navigation.OpportunisticNavigator` over them."""

    name = "opportunistic"
    title = "GPS, then cellular basestations, then basestations alone: the receiver's clock (pesyna)"
    scenario = OpportunisticScenario
    example = EXAMPLE

    def run(self, scenario: OpportunisticScenario, seed: int) -> OpportunisticSystemRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.scenarios import opportunistic_pipeline as pipeline

        return pipeline.run(scenario, seed)

    def figures(self, scenario: OpportunisticScenario, run: Any) -> dict[str, Figure]:
        """The clock through the stages, coherence and Allan deviations."""
        from soopnav_cpp.scenarios import opportunistic_figures as drawing

        return drawing.figures(scenario, run)

    def numbers(self, scenario: OpportunisticScenario, run: Any) -> dict[str, Any]:
        """What became of the clock without GPS."""
        from soopnav_cpp.scenarios import opportunistic_pipeline as pipeline

        return pipeline.numbers(scenario, run)
