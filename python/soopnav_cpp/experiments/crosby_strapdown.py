"""Three dimensions: strapdown navigation with gravity and Earth rotation, aided by four transmitters; crosby 5.2."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp.estimation import mean_nees_bounds, nees
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.geometry import LocalAxes, LocalFrame
from soopnav_cpp.inertial import ImuNoise
from soopnav_cpp.navigation import StrapdownNavigator, StrapdownStart, strapdown_errors
from soopnav_cpp.simulation import Oscillation, SpatialTrajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

DURATION_S = 600
RATE_HZ = 100
SPEED_MPS = 15.0
RANGE_SIGMA_M = 0.5
AMBIGUITY_M = 1199.169832  # one symbol of 80 samples at 20 MHz, times the speed of light
TRANSMITTERS_NED_M = np.array(
    [[2900.0, 600.0, -30.0], [-700.0, 2950.0, -300.0], [-2800.0, -900.0, -120.0], [600.0, -3000.0, -210.0]]
)
NOISE = ImuNoise.industrial_mems()
RUNS = 24
NEES_S = tuple(range(60, DURATION_S + 1, 60))
SETTLED = slice(59, None)


def home() -> LocalFrame:
    """North, east, down at the receiver's start."""
    return LocalFrame(math.radians(48.1), math.radians(11.6), 520.0, axes=LocalAxes.NED)


def waypoints(rng: np.random.Generator) -> Array:
    """A way of 9.6 km in legs of 150 to 400 m within 900 m of the start, up and down by as much as 8 m in a leg."""
    at, heading, length = np.zeros(3), rng.uniform(-math.pi, math.pi), 0.0
    points = [at]
    while length < 1.065 * SPEED_MPS * DURATION_S:
        leg = rng.uniform(150.0, 400.0)
        for turn in rng.uniform(-1.4, 1.4, 50):
            step = leg * np.array([math.cos(heading + turn), math.sin(heading + turn), 0.0])
            if math.hypot(*(at + step)[:2]) < 900.0:
                heading += turn
                break
        else:  # outwards whatever the turn: back to the middle
            heading = math.atan2(-at[1], -at[0])
            step = leg * np.array([math.cos(heading), math.sin(heading), 0.0])
        down = float(np.clip(at[2] + rng.uniform(-8.0, 8.0), -20.0, 20.0))
        at = np.array([at[0] + step[0], at[1] + step[1], down])
        points.append(at)
        length += leg
    return np.array(points)


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
    """One drive of ten minutes: path, increments, their errors, the start's errors, ranges, filter."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * math.pi, 2)
    path = SpatialTrajectory.through(
        home(),
        waypoints(rng),
        speed_mps=SPEED_MPS,
        roll=Oscillation(0.02, 0.8, phase[0]),
        pitch=Oscillation(0.015, 1.1, phase[1]),
    )
    start, epochs = path.at(0.0), np.arange(1.0, DURATION_S + 1.0)
    truth = path.at(epochs)
    covariance = StrapdownStart.deviations(
        tilt_rad=math.radians(0.1),
        heading_rad=math.radians(0.5),
        velocity_mps=0.1,
        position_m=0.1,
        gyro_bias_radps=NOISE.gyro_bias_sigma_radps,
        accelerometer_bias_mps2=NOISE.accelerometer_bias_sigma_mps2,
    )
    error = np.sqrt(np.diag(covariance)) * rng.standard_normal(15)
    gyro_bias, accelerometer_bias = error[9:12], error[12:]
    exact = StrapdownStart(
        quaternion=start.quaternion[0],
        velocity_mps=start.velocity_mps[0],
        position_m=start.position_m[0],
        covariance=covariance,
        gyro_bias_radps=gyro_bias,
        accelerometer_bias_mps2=accelerometer_bias,
    )
    navigator = StrapdownNavigator(
        TRANSMITTERS_NED_M,
        exact.off_by(error),
        frame=home(),
        noise=NOISE,
        period_s=1.0 / RATE_HZ,
        range_sigma_m=RANGE_SIGMA_M,
        reference_m=start.position_m[0],
        ambiguity_m=AMBIGUITY_M,
        gate_sigmas=6.0,
        gate_floor_m=3.0,
    )
    theta, velocity = path.imu_increments(RATE_HZ, end_s=DURATION_S)
    step, root = 1.0 / RATE_HZ, math.sqrt(1.0 / RATE_HZ)
    theta += step * gyro_bias + root * NOISE.gyro_density * rng.standard_normal(theta.shape)
    velocity += step * accelerometer_bias + root * NOISE.accelerometer_density * rng.standard_normal(velocity.shape)

    def ranges(p: Array) -> Array:
        return np.asarray(np.linalg.norm(p[:, None] - TRANSMITTERS_NED_M, axis=2))

    change = ranges(truth.position_m) - ranges(start.position_m)
    change += RANGE_SIGMA_M * rng.standard_normal(change.shape)
    change = np.remainder(change, AMBIGUITY_M)  # what a signal that repeats tells
    t_s = step * np.arange(1, len(theta) + 1)
    aided = navigator.run(
        t_s, theta, velocity, epochs_s=epochs, range_changes_m=change, record_every=RATE_HZ, covariance=True
    )
    alone = navigator.run(t_s, theta, velocity, record_every=RATE_HZ)
    errors = strapdown_errors(
        aided,
        quaternion=truth.quaternion,
        velocity_mps=truth.velocity_mps,
        position_m=truth.position_m,
        gyro_bias_radps=gyro_bias,
        accelerometer_bias_mps2=accelerometer_bias,
    )
    at = np.array(NEES_S) - 1
    return Drive(
        aided.position_m - truth.position_m,
        aided.sigma[:, 6:9].copy(),
        alone.position_m - truth.position_m,
        nees(errors[at], np.asarray(aided.covariance)[at]),
        truth.position_m,
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
        right[0].plot(TRANSMITTERS_NED_M[:, 1], TRANSMITTERS_NED_M[:, 0], "^", color="tab:red", ms=6)
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
