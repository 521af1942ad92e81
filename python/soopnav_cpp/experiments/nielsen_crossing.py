"""A receiver crosses a room of four nodes, nielsen 3.3.6: Figs. 35 … 38."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import Measured, ParticleFilter, Samples
from soopnav_cpp.experiments import nielsen_references as references
from soopnav_cpp.experiments.nielsen_setups import CROSSING
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    at_least,
    band,
    condition,
    experiment,
    falling,
    near,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

BLUE, RED, GREY = "tab:blue", "tab:red", "0.55"
FEW = 50
LOST_M = 0.5
SETTLED = slice(CROSSING.settled[0] - 1, CROSSING.settled[1])
STATES = ("x [m]", "y [m]", "$v_x$ [m/s]", "$v_y$ [m/s]", "b [m]")


def rms(error: Array) -> float:
    """Root of the mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(error))))


@dataclass(frozen=True)
class Crossing:
    """A run of PF5."""

    mean: Array  # (steps, 5)
    kalman: Array
    kalman_sigma: Array
    particles: Array  # the last cloud before resampling, (M, 5), and its weights
    weights: Array
    vanished: int  # steps at which every weight did

    @property
    def error_m(self) -> float:
        """RMS distance of the mean from the receiver once settled."""
        off = (self.mean - CROSSING.truth())[SETTLED, :2]
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def prior(seed: int, particles: int) -> Array:
    """Particles as the listing draws them, shape (M, 5)."""
    rng = np.random.default_rng([seed, 1])
    x = np.empty((particles, 5))
    x[:, 0] = rng.uniform(*CROSSING.x_prior_m, particles)
    x[:, 1] = 0.5 * CROSSING.depth_m + CROSSING.sigma_y0_m * rng.standard_normal(particles)
    x[:, 2:4] = CROSSING.mean_v0_mps + CROSSING.sigma_v0_mps * rng.standard_normal((particles, 2))
    x[:, 4] = 0.0
    return x


def crossing(seed: int, particles: int, keep: bool = True) -> Crossing:
    """PF5, resampled at every step; without `keep` the cloud itself is left out of what is returned."""
    setup = CROSSING
    z = setup.measurements(np.random.default_rng(seed))
    cloud = ParticleFilter(
        particles, prior=Samples(prior(seed, particles)), state="position_velocity_bias2", seed=seed, ess_threshold=1.0
    )
    free = (-math.inf, math.inf)
    room: Any = [(0.0, setup.width_m), (0.0, setup.depth_m), free, free, free]
    cloud.constrain(inside=room)
    run = cloud.run(
        np.arange(1.0, setup.steps + 1),
        process.NearlyConstantVelocity(
            0.0, diffusion_psd=[0.0, 0.0, setup.variance_v, setup.variance_v, setup.variance_b]
        ),
        Measured([measurement.Pseudorange(node) for node in setup.nodes_m], z, setup.sigma_weight_m),
        start_s=0.0,
        covariance=False,
    )
    exact = references.crossing(setup, z)
    none = np.empty((0, 5))
    return Crossing(
        run.mean,
        exact.mean,
        exact.sigma,
        cloud.particles if keep else none,
        cloud.weights if keep else none[:, 0],
        int(np.count_nonzero(run.status)),
    )


def _outline(axes: Axes) -> None:
    """The room, its nodes and the way through it."""
    w, d = CROSSING.width_m, CROSSING.depth_m
    axes.plot([0, w, w, 0, 0], [0, 0, d, d, 0], color=GREY, lw=1.5)
    axes.plot(CROSSING.nodes_m[:, 0], CROSSING.nodes_m[:, 1], "^", color="black", ms=8)
    truth = CROSSING.truth()
    axes.plot(truth[:, 0], truth[:, 1], color=RED, lw=2.0, label="truth")
    axes.set_xlim(-0.3, w + 0.3)
    axes.set_ylim(-0.3, d + 0.3)
    axes.set_aspect("equal")


@experiment(
    "nielsen-35",
    title="Four nodes, a moving receiver: enough particles",
    runs=100,
    source="nielsen section 3.3.6, Fig. 35, listing PF5",
)
def figure_35(lab: Lab) -> Iterator[Claim]:
    runs = {count: lab.map(crossing, count, False) for count in (FEW, CROSSING.particles)}
    error = {count: np.array([run.error_m for run in some]) for count, some in runs.items()}
    with lab.figure(8.4, 4.0) as figure:
        left, right = figure.subplots(1, 2)
        _outline(left)
        many = runs[CROSSING.particles][0].mean
        left.plot(many[:, 0], many[:, 1], color=BLUE, lw=1.0, label=f"{CROSSING.particles} particles")
        left.legend(loc="upper right")
        style(left, "Room, nodes and way", "x [m]", "y [m]")
        for (count, values), colour in zip(error.items(), (RED, BLUE), strict=True):
            right.plot(np.sort(values), np.arange(1, len(values) + 1) / len(values), color=colour, label=f"M = {count}")
        right.axvline(LOST_M, color=GREY, ls="--", lw=1.0)
        right.set_xscale("log")
        right.legend(loc="lower right")
        style(right, "Runs below an error", "position RMS, steps 51 … 100 [m]", "share of runs")
    lab.save(mean=many, error_few_m=error[FEW], error_m=error[CROSSING.particles])
    lost = {count: float(np.mean(values > LOST_M)) for count, values in error.items()}
    yield Claim(f"share of runs that are lost (> {LOST_M} m) with M = {FEW}", lost[FEW], at_least(0.05))
    yield Claim(
        f"and with M = {CROSSING.particles}", lost[CROSSING.particles], condition("none", lambda m: m[0] == 0.0)
    )


@experiment(
    "nielsen-36",
    title="Four nodes, a moving receiver: the means",
    runs=100,
    source="nielsen section 3.3.6, Fig. 36, listing PF5",
)
def figure_36(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(crossing, CROSSING.particles, False)
    truth = CROSSING.truth()
    with lab.figure(6.4, 8.0) as figure:
        rows = figure.subplots(5, 1, sharex=True)
        k = np.arange(1, CROSSING.steps + 1)
        for i, (axes, name) in enumerate(zip(rows, STATES, strict=True)):
            axes.plot(k, runs[0].mean[:, i], color=BLUE, lw=1.0, label="particles")
            axes.plot(k, runs[0].kalman[:, i], color=GREY, lw=1.0, label="Kalman about the truth")
            axes.plot(k, truth[:, i], "--", color=RED, lw=1.0, label="truth")
            style(axes, "", "k" if i == 4 else "", name)
        rows[0].legend(ncol=3)
    counts = (200, CROSSING.particles, 5000)
    others = {count: lab.map(crossing, count, False, runs=40) for count in (counts[0], counts[2])}
    some = {counts[0]: others[counts[0]], counts[1]: runs[:40], counts[2]: others[counts[2]]}
    # Lost runs say nothing of a difference: the median over the runs.
    off = [float(np.median([rms((run.mean - run.kalman)[SETTLED, :2]) for run in some[count]])) for count in counts]
    ours, kalman = (
        np.array([getattr(run, name) for run in runs])[:, SETTLED] - truth[SETTLED] for name in ("mean", "kalman")
    )
    lab.save(
        mean=runs[0].mean, kalman=runs[0].kalman, error=ours, kalman_error=kalman, particles=counts, off_kalman_m=off
    )
    yield Claim(
        f"position RMS with M = {CROSSING.particles}, pooled, against the Kalman filter's",
        rms(ours[:, :, :2]) / rms(kalman[:, :, :2]),
        band(0.85, 1.15),
    )
    yield Claim(
        f"median difference to the Kalman filter's position falls with M = {', '.join(map(str, counts))}",
        off,
        falling(1.2),
    )


def _marginal(run: Crossing) -> tuple[float, float]:
    """Share of the weight within two of the Kalman filter's σ of its mean, in x and y together; trace ratio."""
    off = (run.particles[:, :2] - run.kalman[-1, :2]) / run.kalman_sigma[-1, :2]
    within = float(run.weights @ (np.sum(off**2, axis=1) <= 4.0))
    mean = run.weights @ run.particles[:, :2]
    spread = run.weights @ np.square(run.particles[:, :2] - mean)
    return within, float(spread.sum() / np.sum(run.kalman_sigma[-1, :2] ** 2))


@experiment(
    "nielsen-37",
    title="Four nodes, a moving receiver: the particles",
    runs=100,
    source="nielsen section 3.3.6, Fig. 37, listing PF5",
)
def figure_37(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(crossing, CROSSING.particles)
    x = runs[0].particles
    with lab.figure(6.4, 5.4) as figure:
        axes = figure.add_subplot()
        _outline(axes)
        axes.plot(x[:, 0], x[:, 1], ".", color=BLUE, ms=2)
        style(axes, f"{CROSSING.particles} particles at step {CROSSING.steps}", "x [m]", "y [m]")
    inside = [
        float(
            run.weights
            @ np.all(
                (run.particles[:, :2] >= 0.0) & (run.particles[:, :2] <= (CROSSING.width_m, CROSSING.depth_m)), axis=1
            )
        )
        for run in runs
    ]
    marginal = np.array([_marginal(run) for run in runs])
    lab.save(particles=x, weights=runs[0].weights, variance_ratio=marginal[:, 1], inside=inside)
    yield Claim("weight of the particles inside the room, least over the runs", min(inside), near(1.0, within=1e-9))
    yield Claim(
        "variance of x and y among the particles, pooled, against the Kalman filter's",
        float(marginal[:, 1].mean()),
        band(0.92, 1.08),
    )


@experiment(
    "nielsen-38",
    title="Four nodes, a moving receiver: the particles' weights",
    runs=100,
    source="nielsen section 3.3.6, Fig. 38, listing PF5",
)
def figure_38(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(crossing, CROSSING.particles)
    first = runs[0]
    x, w = first.particles, first.weights * CROSSING.particles
    with lab.figure(6.4, 5.4) as figure:
        axes: Any = figure.add_subplot(projection="3d")
        axes.scatter(x[:, 0], x[:, 1], w, s=3, c=w, cmap="viridis")
        axes.set_title(f"Weights at step {CROSSING.steps}")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.set_zlabel("weight × M")
    within = np.array([_marginal(run)[0] for run in runs])
    lab.save(particles=x, weights=first.weights, within_two_sigma=within)
    expected = 1.0 - math.exp(-2.0)
    yield Claim(
        "the weighted particles are the posterior: weight within 2 σ of the Kalman filter, pooled",
        float(within.mean()),
        band(expected - 0.05, expected + 0.05),
    )
    top = [float(np.linalg.norm(run.particles[np.argmax(run.weights), :2] - run.mean[-1, :2])) for run in runs]
    yield Claim(
        "the weights peak where the particles are: median distance of the heaviest one from the mean",
        float(np.median(top)),
        band(0.0, 0.35, "m"),
    )
