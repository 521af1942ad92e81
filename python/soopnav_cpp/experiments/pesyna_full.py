"""The three stages of pesyna's demonstration through the whole navigator: position, clocks and ambiguities together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry, orbits
from soopnav_cpp.experiments.pesyna_setup import (
    CDMA_DBHZ,
    GPS_DBHZ,
    L1_HZ,
    SATELLITES,
    Pair,
    Record,
    phase_sigma_cycles,
)
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.navigation import OpportunisticNavigator, OpportunisticRun, OpportunisticSmoothed

__all__ = ["Stage", "navigate"]

Array = npt.NDArray[np.float64]

LIGHT_MPS = 299_792_458.0
COLD_M = 100.0  # stage 1's start, each axis
WARM_M = 0.5  # stage 2's; more than this bends ranges to masts by more than their phases' noise
BIAS_SIGMA_S = 1e-7
DRIFT_SIGMA = 1e-8
START_S = 100.0


@cache
def place() -> Array:
    """Downtown Austin, Texas."""
    return np.asarray(geometry.geodetic_to_ecef(math.radians(30.27), math.radians(-97.74), 150.0), np.float64)


@cache
def basestations() -> tuple[Array, Array]:
    """Two masts 4.1 and 5.8 km away."""
    first = geometry.geodetic_to_ecef(math.radians(30.303), math.radians(-97.721), 200.0)
    second = geometry.geodetic_to_ecef(math.radians(30.222), math.radians(-97.763), 190.0)
    return np.asarray(first, np.float64), np.asarray(second, np.float64)


@cache
def satellites() -> tuple[SampledOrbit, ...]:
    """The six highest of a 24/6/2 constellation at GPS height."""
    everything = orbits.walker(
        24, 6, 2, inclination_rad=math.radians(55.0), altitude_m=20_180e3, duration_s=800.0, first_node_rad=0.3
    )
    highest, _ = orbits.visible(everything, START_S, place(), math.radians(10.0))
    return tuple(everything[int(i)] for i in highest[:SATELLITES])


@cache
def ranges_m(n: int, dt_s: float) -> tuple[Array, Array]:
    """From the satellites, shape (n, 6), light time solved, and from the basestations, shape (2,)."""
    t = START_S + dt_s * np.arange(n)
    sky = [LIGHT_MPS * geometry.signal_path(orbit, t, place()).delay_s for orbit in satellites()]
    return np.stack(sky, axis=1), np.array([np.linalg.norm(place() - mast) for mast in basestations()])


@dataclass(frozen=True)
class Stage:
    """One stage of one record.

    Attributes
    ----------
    run : OpportunisticRun
        Forward.
    smoothed : OpportunisticSmoothed
        Over all of it.
    """

    run: OpportunisticRun
    smoothed: OpportunisticSmoothed

    @property
    def filtered_s(self) -> Array:
        """The receiver's clock, forward [s], shape (n,)."""
        return self.run.clock_bias_s

    @property
    def bias_s(self) -> Array:
        """The receiver's clock, smoothed [s], shape (n,)."""
        return self.smoothed.clock_bias_s


def navigate(found: Record, stage: Literal[1, 2, 3], sources: Pair, seed: int, *, gains: bool = False) -> Stage:
    """Run a stage of `found`, every ambiguity open.

    Parameters
    ----------
    found : Record
    stage : {1, 2, 3}
        1: satellites, from a position known to 100 m. 2: satellites and basestations, from 0.5 m. 3: basestations, at a
        known place.
    sources : pair of TwoState
        Noise of the basestations' clocks as the estimator takes it.
    seed : int
        Of the start's error and the ambiguities.
    gains : bool
        Keep the smoother's gains, for covariances between epochs.
    """
    n = len(found.receiver_s)
    rng = np.random.default_rng([seed, 0x6675_6C6C])
    sigma_m = COLD_M if stage == 1 else WARM_M
    off = rng.normal(0.0, sigma_m, 3)
    ambiguities = np.round(rng.uniform(-500.0, 500.0, SATELLITES + 2))
    sky, ground = ranges_m(n, found.dt_s)
    # The record's clocks run through zero; constants and drifts of clocks are what ambiguities and priors take up.
    navigator = OpportunisticNavigator(
        place() if stage == 3 else place() + off,
        position_sigma_m=sigma_m,
        clock=found.receiver,
        clock_bias_sigma_s=BIAS_SIGMA_S,
        clock_drift_sigma=DRIFT_SIGMA,
        motion="known" if stage == 3 else "static",
        time_tags="system",
    )
    phases, sigmas = [], []
    if stage != 3:
        for i, orbit in enumerate(satellites()):
            navigator.add_source(f"G{i + 1}", "gps", carrier_hz=L1_HZ, orbit=orbit, ambiguity_sigma_cycles=1e3)
            phases.append(L1_HZ * (sky[:, i] / LIGHT_MPS + found.satellites_s[:, i]) + ambiguities[i])
            sigmas.append(phase_sigma_cycles(GPS_DBHZ, found.dt_s))
    if stage != 1:
        for i, (mast, clock) in enumerate(zip(basestations(), sources, strict=True)):
            navigator.add_source(
                f"C{i + 1}",
                "cdma",
                carrier_hz=L1_HZ,
                position_e_m=mast,
                clock=clock,
                clock_bias_sigma_s=BIAS_SIGMA_S,
                clock_drift_sigma=DRIFT_SIGMA,
                ambiguity_sigma_cycles=1e3,
            )
            phases.append(L1_HZ * (ground[i] / LIGHT_MPS + found.cdma_s[:, i]) + ambiguities[SATELLITES + i])
            sigmas.append(phase_sigma_cycles(CDMA_DBHZ, found.dt_s))
    t = START_S + found.dt_s * np.arange(n)
    run = navigator.run(t, np.stack(phases, axis=1), np.array(sigmas), record=True)
    return Stage(run, navigator.smooth(gains=gains))
