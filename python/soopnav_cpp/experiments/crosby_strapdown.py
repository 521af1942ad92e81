"""Three dimensions: strapdown navigation with gravity and Earth rotation, aided by four transmitters; crosby 5.2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp.estimation import mean_nees_bounds, nees
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.scenarios.ofdm_strapdown import OfdmStrapdownScenario
from soopnav_cpp.scenarios.ofdm_strapdown_pipeline import navigate, sense

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

DURATION_S = 600
TRANSMITTERS_NED_M = np.array(
    [[2900.0, 600.0, -30.0], [-700.0, 2950.0, -300.0], [-2800.0, -900.0, -120.0], [600.0, -3000.0, -210.0]]
)
RUNS = 24
NEES_S = tuple(range(60, DURATION_S + 1, 60))
SETTLED = slice(59, None)


def scenario() -> OfdmStrapdownScenario:
    """A car that roams for ten minutes among four transmitters 30 to 300 m above its start."""
    return OfdmStrapdownScenario.model_validate(
        {
            "system": "ofdm_strapdown",
            "duration_s": DURATION_S,
            "origin": {"latitude_deg": 48.1, "longitude_deg": 11.6, "height_m": 520.0},
            "imu": {"preset": "industrial"},
            "transmitters": [{"position_ned_m": at} for at in TRANSMITTERS_NED_M.tolist()],
            "ranging": {"sigma_m": 0.5},
            "output_rate_hz": 1.0,
        }
    )


@dataclass(frozen=True)
class Drive:
    """A run, once each second."""

    error_m: Array  # (600, 3) north, east, down, estimate minus truth
    sigma_m: Array
    alone_m: Array  # (600, 3) of inertial navigation alone
    nees: Array  # at NEES_S
    way_m: Array  # (600, 3)
    refused: int


def drive(seed: int) -> Drive:
    """One drive of ten minutes: simulate, navigate with and without transmitters, compare."""
    setup = scenario()
    sensed = sense(setup, seed)
    aided, alone = (navigate(setup, sensed, aided=yes) for yes in (True, False))
    way = sensed.path.at(aided.t_s).position_m
    at = np.array(NEES_S) - 1
    return Drive(
        aided.position_m - way,
        aided.sigma[:, 6:9].copy(),
        alone.position_m - way,
        nees(sensed.errors(aided)[at], np.asarray(aided.covariance)[at]),
        way,
        int(np.count_nonzero(aided.update_status)),
    )


def _band(axes: Axes, title: str, t_s: Array, error: Array, sigma: Array, label: str) -> None:
    axes.fill_between(t_s, -sigma, sigma, color="tab:blue", alpha=0.25, lw=0, label="±1 σ of the filter")
    axes.plot(t_s, error, color="tab:blue", lw=0.9, label="error")
    axes.axhline(0.0, color="0.6", lw=0.6)
    top = 3.5 * float(np.max(sigma[SETTLED]))
    axes.set_ylim(-top, top)
    style(axes, title, "", label)


@experiment(
    "crosby-x3",
    title="Three dimensions: strapdown navigation and four transmitters",
    runs=RUNS,
    source="crosby section 5.2 (future work)",
)
def strapdown(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(drive)
    error, alone = (np.array([getattr(run, name) for run in runs]) for name in ("error_m", "alone_m"))
    consistency = np.array([run.nees for run in runs])
    t_s = np.arange(1.0, DURATION_S + 1.0)
    horizontal = np.sqrt(np.mean(np.sum(error[:, :, :2] ** 2, axis=2), axis=0))  # over the runs
    vertical = np.sqrt(np.mean(error[:, :, 2] ** 2, axis=0))
    free = np.sqrt(np.mean(np.sum(alone[:, :, :2] ** 2, axis=2), axis=0))
    first = runs[0]
    with lab.figure(9.6, 6.4) as figure:
        left, right = figure.subplots(3, 2, width_ratios=(1.5, 1.0), squeeze=False).T
        for i, name in enumerate(("north", "east", "down")):
            _band(left[i], "" if i else "One run", t_s, first.error_m[:, i], first.sigma_m[:, i], f"{name} [m]")
        left[0].legend(loc="upper right", ncol=2, fontsize="small")
        left[2].set_xlabel("time [s]")
        right[0].plot(first.way_m[:, 1], first.way_m[:, 0], color="0.3", lw=0.8)
        north, east, _ = TRANSMITTERS_NED_M.T
        right[0].plot(east, north, "^", color="tab:red", ms=6)
        right[0].set_aspect("equal")
        style(right[0], "Way, transmitters", "east [m]", "north [m]")
        right[1].semilogy(t_s, free, color="tab:red", lw=1.2, label="INS alone, horizontal")
        right[1].semilogy(t_s, vertical, color="tab:green", lw=1.0, label="aided, vertical")
        right[1].semilogy(t_s, horizontal, color="tab:blue", lw=1.0, label="aided, horizontal")
        right[1].legend(loc="center right", fontsize="small")
        style(right[1], f"RMS over {len(runs)} runs", "time [s]", "error [m]")
        right[2].plot(NEES_S, consistency.mean(axis=0), "o-", color="tab:blue", ms=3)
        low, high = mean_nees_bounds(15, len(runs), failure_probability=0.01)
        right[2].axhspan(low, high, color="tab:blue", alpha=0.15, lw=0)
        style(right[2], "NEES of 15 states, and its 99 %", "time [s]", "mean")
        right[2].set_ylim(9.0, 21.0)
    lab.save(
        t_s=t_s,
        horizontal_rms_m=horizontal,
        vertical_rms_m=vertical,
        alone_rms_m=free,
        nees=consistency,
        nees_s=NEES_S,
        error_m=first.error_m,
        sigma_m=first.sigma_m,
        way_m=first.way_m,
    )
    yield Claim(
        "horizontal RMS from 60 to 600 s, pooled, in metres",
        float(np.sqrt(np.mean(horizontal[SETTLED] ** 2))),
        at_most(1.0),
    )
    yield Claim(
        "vertical RMS from 60 to 600 s, pooled, in metres",
        float(np.sqrt(np.mean(vertical[SETTLED] ** 2))),
        at_most(5.0),
    )
    yield Claim("inertial navigation alone: horizontal RMS at 600 s, in metres", float(free[-1]), at_least(500.0))
    total = np.hypot(horizontal, vertical)
    yield Claim(
        "it stays bounded: greatest RMS from 300 to 600 s against that from 60 to 300 s",
        float(np.max(total[299:]) / np.max(total[59:300])),
        at_most(2.0),
    )
    # Ten times, each outside with probability 5e-6: 5e-5 for them all.
    low, high = mean_nees_bounds(15, len(runs), failure_probability=5e-6)
    yield Claim(
        f"the filter is consistent: mean NEES of its 15 states at {NEES_S[0]}, {NEES_S[1]} … {NEES_S[-1]} s, "
        "whose own 99 % bounds the figure draws",
        consistency.mean(axis=0),
        band(low, high),
    )
    yield Claim(
        "no range change is refused: share of them",
        sum(r.refused for r in runs) / (4.0 * DURATION_S * RUNS),
        at_most(1e-4),
    )
