"""Scenarios of two receivers: ``system = "cooperative"`` (mei), from measurements or from the bursts' own samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import Model
from soopnav_cpp.scenarios.base import Latitude, Longitude, Scenario, SystemRun, Truth, Updates
from soopnav_cpp.scenarios.registry import register

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.experiments.mei_setup import Campaign, Setup

__all__ = ["BurstSettings", "ClockSettings", "Cooperative", "CooperativeScenario", "PairRun", "TrackerSettings"]

_Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
_START_SIGMA = np.array([30.0, 30.0, 10.0, 1.0, 1.0, 0.1, 300.0, 0.1])  # east, north, up; theta, alpha
_STATES = ("x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps", "theta_m", "alpha_mps")


class PairSettings(Model):
    """Where the two are, and how the target moves.

    Attributes
    ----------
    latitude_deg, longitude_deg, height_m : float
        Of the anchor, which stands still and knows where it is.
    separation_m : float
        Of the target at the start, at an azimuth that is drawn.
    motion : str
        "static", or "drive": 15 m/s, turns at 3 m/s², stops.
    height_sigma_m : float
        Of what is known of the target's height; its error is drawn.
    """

    latitude_deg: Latitude = 60.2
    longitude_deg: Longitude = 25.0
    height_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 20.0
    separation_m: Annotated[float, Field(ge=10.0, le=1e6)] = 10e3
    motion: Literal["static", "drive"] = "static"
    height_sigma_m: Positive = 10.0


class BurstSettings(Model):
    """What both hear.

    Attributes
    ----------
    interval_s : float
        One burst of one satellite in each, moved by up to 0.3 of it.
    mask_deg : float
        Of the satellites at both.
    duration_s, snr_db : float
        Stage "iq": random symbols of 25 ksym/s, SNR in 25 kHz.
    sigma_tdoa_s, sigma_fdoa_hz : float
        Stage "drawn".
    """

    interval_s: Annotated[float, Field(ge=0.25, le=60.0)] = 1.0
    mask_deg: Annotated[float, Field(ge=0.0, le=60.0)] = 8.0
    duration_s: Annotated[float, Field(ge=5e-3, le=0.09)] = 32.5e-3
    snr_db: Annotated[float, Field(ge=-12.0, le=40.0)] = -5.4
    sigma_tdoa_s: Positive = 2.73e-6
    sigma_fdoa_hz: Positive = 2.19


class ClockSettings(Model):
    """Both oscillators, and how far off they may be.

    Attributes
    ----------
    h0, h_minus_2 : float
        White frequency noise [s], random walk of frequency [Hz]; the tracker is told the same.
    bias_s, drift_ppm : float
        Of the target against the anchor at the start, drawn uniformly to either side.
    """

    h0: NotNegative = 8e-20
    h_minus_2: NotNegative = 4e-23
    bias_s: Annotated[float, Field(ge=0.0, le=5e-3)] = 1e-3
    drift_ppm: Annotated[float, Field(ge=0.0, le=5.0)] = 1.0


class TrackerSettings(Model):
    """`navigation.CooperativeTracker`.

    Attributes
    ----------
    motion : str
        "static", "nearly_constant_velocity", or "imm": now calm, now manoeuvring.
    start : str
        "batch": from the first bursts alone; "known": place, velocity and clock as five minutes at rest leave them,
        30 m, 1 m/s, 300 m and 0.1 m/s off, drawn.
    start_bursts : int
        Of the batch.
    start_off_m : float
        How far from the target the batch's search begins, in a direction that is drawn.
    """

    motion: Literal["static", "nearly_constant_velocity", "imm"] = "static"
    start: Literal["batch", "known"] = "batch"
    start_bursts: Annotated[int, Field(ge=10, le=2000)] = 90
    start_off_m: Annotated[float, Field(ge=0.0, le=500e3)] = 50e3


class CooperativeScenario(Scenario):
    """An anchor and a target hear the same satellites; the target's place and clock are found.

    Attributes
    ----------
    stage : str
        "iq": each burst is made, sent through two paths and clocks, and measured by cross-ambiguity; "drawn":
        measurements from the exact model with stated noise.
    pair, bursts, clock, tracker : table
    """

    stage: Literal["iq", "drawn"] = "iq"
    pair: PairSettings = PairSettings()
    bursts: BurstSettings = BurstSettings()
    clock: ClockSettings = ClockSettings()
    tracker: TrackerSettings = TrackerSettings()

    @pydantic.model_validator(mode="after")
    def _fits(self) -> CooperativeScenario:
        count = math.floor(self.duration_s / self.bursts.interval_s)
        if self.tracker.start == "batch" and count < self.tracker.start_bursts + 2:
            raise ValueError(
                f"duration_s: {count} bursts; more than tracker.start_bursts = {self.tracker.start_bursts} expected"
            )
        if count > 20_000:
            raise ValueError(f"duration_s: {count} bursts; at most 20000")
        return self


EXAMPLE = """\
# A receiver 10 km from another, both hear Iridium and nothing else: where it is and how far its clock is off (mei).
system = "cooperative"
title = "A static receiver found by a burst a second"
duration_s = 300.0
metrics_start_s = 240.0
stage = "iq"                           # or "drawn"

[pair]
latitude_deg = 60.2
longitude_deg = 25.0
separation_m = 10e3

[tracker]
motion = "static"
start_bursts = 90
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class PairRun(SystemRun):
    """A run with what its own figures need.

    Attributes
    ----------
    campaign : Campaign
        The bursts and the world they came from.
    nees : ndarray, shape (n,)
        Of position, theta and alpha together: 5 of them stand still where the target does, 8 count otherwise.
    dimension : int
        Of `nees`.
    start_error_m : float
        Horizontal.
    start_status : str
        How the batch start ended; "known" without one.
    """

    campaign: Campaign
    nees: _Array
    dimension: int
    start_error_m: float
    start_status: str = "known"


def setup_of(scenario: CooperativeScenario) -> Setup:
    """The experiments' set-up that the scenario describes."""
    from soopnav_cpp.clock import TwoState
    from soopnav_cpp.experiments import mei_setup

    pair, bursts, clock = scenario.pair, scenario.bursts, scenario.clock
    return mei_setup.Setup(
        site=(math.radians(pair.latitude_deg), math.radians(pair.longitude_deg)),
        height_m=pair.height_m,
        separation_m=pair.separation_m,
        duration_s=scenario.duration_s,
        interval_s=bursts.interval_s,
        mask_rad=math.radians(bursts.mask_deg),
        clock=TwoState(clock.h0, clock.h_minus_2),
        bias_s=clock.bias_s,
        drift=1e-6 * clock.drift_ppm,
        height_sigma_m=pair.height_sigma_m,
        motion=pair.motion,
        burst_s=bursts.duration_s,
        snr_db=bursts.snr_db,
    )


@register
class Cooperative:
    """Makes bursts of Iridium at two receivers and locates one of them by the other."""

    name = "cooperative"
    title = "two receivers and Iridium: where the second one is and how far its clock is off (mei)"
    scenario = CooperativeScenario
    example = EXAMPLE

    def run(self, scenario: CooperativeScenario, seed: int) -> PairRun:
        """One run: all randomness comes from the seed."""
        from soopnav_cpp.experiments import mei_setup

        campaign = mei_setup.campaign(
            setup_of(scenario),
            seed,
            mode=scenario.stage,
            sigmas=(scenario.bursts.sigma_tdoa_s, scenario.bursts.sigma_fdoa_hz),
        )
        return _track(scenario, campaign, seed)

    def figures(self, scenario: CooperativeScenario, run: Any) -> dict[str, Figure]:
        """Clock and position as the paper draws them, and the measurements' errors."""
        from soopnav_cpp.scenarios import cooperative_figures as drawing

        return drawing.figures(scenario, run)

    def numbers(self, scenario: CooperativeScenario, run: Any) -> dict[str, Any]:
        """How many bursts were measured, how well, and what the start was worth."""
        campaign = run.campaign
        sigma = np.sqrt(np.diagonal(campaign.covariance, axis1=1, axis2=2))
        counted = run.nees[run.t_s >= scenario.metrics_start_s]
        return {
            "bursts": len(campaign.world.start_s),
            "measured": len(campaign),
            "satellites": len(campaign.world.beacons),
            "tdoa_rms_s": float(np.sqrt(np.mean(campaign.tdoa_error_s**2))),
            "fdoa_rms_hz": float(np.sqrt(np.mean(campaign.fdoa_error_hz**2))),
            "tdoa_sigma_s": float(np.median(sigma[:, 0])),
            "fdoa_sigma_hz": float(np.median(sigma[:, 1])),
            "start_error_m": run.start_error_m,
            "start_status": run.start_status,
            "mean_nees_over_dimension": float(np.mean(counted)) / run.dimension if len(counted) else None,
        }


def _track(scenario: CooperativeScenario, campaign: Campaign, seed: int) -> PairRun:
    from soopnav_cpp import geometry, navigation
    from soopnav_cpp.clock import TwoState

    world, settings = campaign.world, scenario.tracker
    clock = TwoState(scenario.clock.h0, scenario.clock.h_minus_2)
    bursts = navigation.PairBursts(
        t_s=campaign.t_s,
        beacon=campaign.beacon,
        tdoa_s=campaign.tdoa_s,
        fdoa_hz=campaign.fdoa_hz,
        covariance=campaign.covariance,
        carrier_hz=np.full(len(campaign), world.carrier_hz),
        anchor_position_e_m=world.anchor_p_e,
    )
    count = settings.start_bursts if settings.start == "batch" else 0
    if len(bursts) < count + 2:
        raise ValueError(f"{len(bursts)} bursts were measured; more than {count} are needed")
    frame = geometry.LocalFrame(
        math.radians(scenario.pair.latitude_deg), math.radians(scenario.pair.longitude_deg), scenario.pair.height_m
    )
    origin = frame.position_to_ecef(np.zeros(3))
    axes = frame.position_to_ecef(np.eye(3)) - origin  # rows: east, north, up in ECEF
    rng = np.random.default_rng([seed, 0x6D65_6910])
    turn = np.zeros((8, 8))
    turn[:3, :3] = turn[3:6, 3:6] = axes
    turn[6:, 6:] = np.eye(2)

    def started(motion: str) -> navigation.CooperativeTracker:
        options: dict[str, Any] = {
            "target_clock": clock,
            "anchor_clock": clock,
            "height_m": world.height_m,
            "height_sigma_m": scenario.pair.height_sigma_m,
        }
        if motion == "imm":
            return navigation.ManoeuvringTracker(world.beacons, **options)
        return navigation.CooperativeTracker(world.beacons, motion=motion, **options)

    tracker, baselines = started(settings.motion), {}
    start_status, notes = "known", []
    if settings.start == "batch":
        away = rng.uniform(0.0, 2.0 * math.pi)
        guess = world.position_e_m[0] + settings.start_off_m * (math.sin(away) * axes[0] + math.cos(away) * axes[1])
        start = tracker.start(bursts[:count], guess_e_m=guess)
        if not tracker.started:
            raise ValueError(f"the batch of {count} bursts gave no start: {start.status}")
        start_status = start.status.name.lower().replace("_", " ")
        if not start.ok:
            notes.append(f"the batch start is {start_status}: other places that fit as well: {len(start.alternatives)}")
        begun = np.asarray(start.mean)[:3] - world.position_e_m[campaign.row[count - 1]]
        track = tracker.run(bursts[count:])
    else:
        at_zero = [np.asarray(x, np.float64).reshape(3) for x in world.target.at(0.0)]
        true_start = np.concatenate([*at_zero, [world.theta_m[0], world.alpha_mps[0]]])
        true_start[6] -= world.alpha_mps[0] * campaign.t_s[0]
        error = turn.T @ (_START_SIGMA * rng.standard_normal(8))
        covariance_start = turn.T @ np.diag(_START_SIGMA**2) @ turn
        begun = error[:3]
        tracker.start_at(0.0, true_start + error, covariance_start)
        track = tracker.run(bursts)
        if settings.motion != "static":
            still = started("static")
            mean = true_start + error
            mean[3:6] = 0.0
            covariance_start[3:6, :] = covariance_start[:, 3:6] = 0.0
            covariance_start[3:6, 3:6] = 1e-6 * np.eye(3)
            still.start_at(0.0, mean, covariance_start)
            baselines["taken to stand still"] = (still.run(bursts).position_e_m - origin) @ axes.T

    row = campaign.row[count:]
    state = track.mean @ turn.T
    state[:, :3] -= axes @ origin
    true = np.column_stack(
        [world.position_e_m[row], world.velocity_e_mps[row], world.theta_m[row], world.alpha_mps[row]]
    )
    truth = true @ turn.T
    truth[:, :3] -= axes @ origin
    covariance = turn @ track.covariance @ turn.T
    states = [0, 1, 2, 6, 7] if settings.motion == "static" else list(range(8))
    if len(campaign) < len(world.start_s):
        notes.append(f"{len(world.start_s) - len(campaign)} of {len(world.start_s)} bursts were not detected")
    return PairRun(
        t_s=track.t_s,
        position_m=state[:, :3],
        position_covariance_m2=covariance[:, :3, :3],
        velocity_mps=state[:, 3:6],
        state_names=_STATES,
        state=state,
        covariance=covariance,
        truth=Truth(position_m=truth[:, :3], velocity_mps=truth[:, 3:6], state=truth),
        updates=Updates(
            t_s=track.t_s,
            source=campaign.beacon[count:],
            innovation=track.innovation[:, 0],
            variance=track.innovation_covariance[:, 0, 0],
            status=np.array([use.name for use in track.use]),
            source_names=tuple(f"satellite {i + 1}" for i in range(len(world.beacons))),
        ),
        baselines=baselines,
        sources={"anchor": np.zeros(3)},
        notes=tuple(notes),
        origin_lla_deg=(scenario.pair.latitude_deg, scenario.pair.longitude_deg, scenario.pair.height_m),
        campaign=campaign,
        nees=track.nees(true, states),
        dimension=len(states),
        start_error_m=float(np.hypot(*(axes[:2] @ begun))),
        start_status=start_status,
    )
