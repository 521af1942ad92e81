"""Set-up that crosby's experiments share: three transmitters, a water tower, a cheap inertial sensor, 120 s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.navigation import OfdmInertialRun
from soopnav_cpp.scenarios.ofdm_inertial import (
    FilterSettings,
    OfdmInertialScenario,
    OfdmSettings,
    ReflectorSettings,
    TransmitterSettings,
)
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import Sensed, navigate, numerology, sense

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "MHZ",
    "RATES",
    "RED",
    "TOWER",
    "Track",
    "between",
    "boundary_errors",
    "coverage",
    "distance_m",
    "drive",
    "rms",
    "scenario",
    "solve",
]

Array = npt.NDArray[np.float64]

TRANSMITTERS_M = ((1000.0, 1500.0), (-2000.0, 1000.0), (500.0, -2000.0))
TOWER = ReflectorSettings(position_m=(0.0, 1000.0))
DURATION_S = 120.0
RATES = (1, 15)  # samples of the receiver per sample of the transmitter
MHZ = {1: "20 MHz", 15: "300 MHz"}
ROWS_HZ = 10.0
BLUE, RED, GREEN, GREY = "#1b6ca8", "#d1495b", "#3a7d44", "#8a949c"


def scenario(rate: int = 1, *, transmitters: int = 3, **changes: Any) -> OfdmInertialScenario:
    """The paper's simulation at one sampling rate; ``ofdm`` and ``filter`` take dictionaries of their keys."""
    ofdm = OfdmSettings(oversampling=rate, **changes.pop("ofdm", {}))  # type: ignore[arg-type]
    settings = FilterSettings(**changes.pop("filter", {}))
    return OfdmInertialScenario(
        system="ofdm_inertial",
        duration_s=DURATION_S,
        transmitters=[TransmitterSettings(position_m=at) for at in TRANSMITTERS_M[:transmitters]],
        ofdm=ofdm,
        filter=settings,
        output_rate_hz=ROWS_HZ,
        **changes,
    )


@dataclass(frozen=True)
class Track:
    """Errors of one run, estimate less truth, with what the filter thought of them; 10 rows a second from t = 0."""

    t_s: Array
    error_m: Array  # (n, 2)
    sigma_m: Array  # (n, 2)
    radial_m: Array  # error along the line to the first transmitter
    rejected: Array  # (E, K), of 0 and 1
    innovation_m: Array  # (E, K)


def solve(setup: OfdmInertialScenario, sensed: Sensed, *, aided: bool = True) -> Track:
    """Navigate, and compare with the truth."""
    run = navigate(setup, sensed, aided=aided)
    return compare(setup, sensed, run)


def compare(setup: OfdmInertialScenario, sensed: Sensed, run: OfdmInertialRun, receiver: int = 0) -> Track:
    """The errors of one receiver of a run."""
    truth = sensed.truth_at(run.t_s)
    assert truth is not None
    run = run.receiver(receiver)
    error = run.position_m - truth[receiver][:, 3:5]
    line = truth[receiver][:, 3:5] - setup.transmitters_m[0]
    line /= np.linalg.norm(line, axis=1)[:, None]
    links = run.links
    none = np.empty((0, len(setup.transmitters)))
    return Track(
        run.t_s,
        error,
        np.sqrt(np.diagonal(run.position_covariance_m2, axis1=1, axis2=2)),
        np.asarray(np.sum(error * line, axis=1)),
        links.rejected[:, receiver].astype(np.float64) if len(links.status) else none,
        links.innovation_m[:, receiver] if len(links.status) else none,
    )


def boundary_errors(setup: OfdmInertialScenario, sensed: Sensed) -> Array:
    """Of each boundary, within half a symbol's length; shape (E, K)."""
    changes = sensed.tdoa[0]
    truth, start = sensed.truth_at(changes.t_s), sensed.truth_at(np.zeros(1))
    assert truth is not None
    assert start is not None
    sources = setup.transmitters_m
    far = np.linalg.norm(truth[0][:, None, 3:5] - sources, axis=2) - np.linalg.norm(start[0][0, 3:5] - sources, axis=1)
    ambiguity = numerology(setup).ambiguity_m
    return np.asarray((changes.range_change_m - far + 0.5 * ambiguity) % ambiguity - 0.5 * ambiguity)


def drive(seed: int, setup: OfdmInertialScenario, alone: bool = False) -> Track:
    """One run from its seed: simulate, navigate, compare."""
    return solve(setup, sense(setup, seed), aided=not alone)


def distance_m(track: Track) -> Array:
    """Length of the error at each row."""
    return np.asarray(np.linalg.norm(track.error_m, axis=1))


def rms(tracks: list[Track]) -> Array:
    """RMS of the distance over the runs at each row (crosby 4.1)."""
    return np.asarray(np.sqrt(np.mean([distance_m(track) ** 2 for track in tracks], axis=0)))


def coverage(tracks: list[Track]) -> float:
    """Share of x and y errors within the filter's one sigma, from 1 s on."""
    inside = [np.abs(track.error_m) < track.sigma_m for track in tracks]
    return float(np.mean([item[track.t_s >= 1.0] for item, track in zip(inside, tracks, strict=True)]))


def between(tracks: list[Track], values: Array, low_s: float, high_s: float) -> Array:
    """The values at the rows from `low_s` to `high_s`."""
    t = tracks[0].t_s
    return np.asarray(values[..., (t >= low_s - 1e-6) & (t <= high_s + 1e-6)])
