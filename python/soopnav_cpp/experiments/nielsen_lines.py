"""Particle filters on a line, nielsen 3.3.2 and 3.3.5: Figs. 18 … 24 and 34."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import Measured, ParticleFilter, Samples, Uniform
from soopnav_cpp.experiments import nielsen_references as references
from soopnav_cpp.experiments.nielsen_setups import SMOOTH, STEP, STILL
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    at_least,
    at_most,
    band,
    below,
    experiment,
    falling,
    near,
    rising,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

BLUE, RED, GREY = "tab:blue", "tab:red", "0.55"


def rms(error: Array) -> float:
    """Root of the mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(error))))


# -- PF1: a place that does not move


@dataclass(frozen=True)
class Still:
    """A run of PF1 up to a step."""

    before: Array  # particles before the step, resampled
    after: Array  # and after its measurement, resampled
    weights: Array  # of the step
    spread: float  # of the weighted particles
    error: float  # of their mean, against the exact one
    exact: float  # the exact posterior's spread


def still(seed: int, step: int, resampling: str = "systematic") -> Still:
    """PF1 with a resampling at every step."""
    z = STILL.measurements(np.random.default_rng(seed))
    exact = references.still(STILL, z[:step])
    cloud = ParticleFilter(
        STILL.particles,
        prior=Uniform([STILL.prior_m[0]], [STILL.prior_m[1]]),
        seed=seed,
        resampling=resampling,
        ess_threshold=1.0,
    )
    model = measurement.Position(1)
    for k in range(step):
        if k > 0:
            cloud.resample()
        before = cloud.particles[:, 0]
        cloud.update(model, z[k], STILL.sigma_z_m)
    weights = cloud.weights
    mean, spread = float(cloud.mean[0]), float(np.sqrt(cloud.covariance[0, 0]))
    cloud.resample()
    return Still(
        before, cloud.particles[:, 0], weights, spread, mean - float(exact.mean[-1, 0]), float(exact.sigma[-1, 0])
    )


def _histogram(axes: Axes, x: Array, label: str) -> None:
    axes.hist(x, np.linspace(-8.0, 8.0, 101).tolist(), color=BLUE)
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)


def _still_figure(lab: Lab, step: int) -> Iterator[Claim]:
    runs = lab.map(still, step)
    first = runs[0]
    spread = np.array([run.spread for run in runs])
    drawn = np.array([run.after.std() for run in runs])
    error = np.array([run.error for run in runs])
    with lab.figure(6.4, 6.4) as figure:
        rows = figure.subplots(3, 1, sharex=True)
        style(rows[0], f"Particles at step {step}, one run of {STILL.particles}", "", "")
        _histogram(rows[0], first.before, f"before, $x_{{{step - 1}}}$")
        _histogram(rows[1], first.before, "moved, $x_u$")
        _histogram(rows[2], first.after, f"resampled, $x_{{{step}}}$")
        x = np.linspace(-8.0, 8.0, 400)
        density = np.exp(-0.5 * ((x - (first.after.mean())) / first.exact) ** 2) / (first.exact * np.sqrt(2.0 * np.pi))
        rows[2].plot(x, density * STILL.particles * 0.16, color=RED, lw=1.0, label="exact spread")
        rows[2].legend(loc="upper right")
        rows[2].set_xlabel("x [m]")
    lab.save(before=first.before, after=first.after, weights=first.weights, spread=spread, drawn=drawn, error=error)
    wanted = STILL.sigma_z_m / np.sqrt(step)
    yield Claim(
        f"the particles' spread after {step} measurements, pooled, is 1/√{step} = {wanted:.4f} m within 10 %",
        rms(spread) / wanted,
        band(0.9, 1.1),
    )
    yield Claim("resampling keeps it: spread of the resampled particles, pooled", rms(drawn) / wanted, band(0.9, 1.1))
    yield Claim("their mean is the exact posterior's: difference, RMS over the runs", rms(error), at_most(0.1, "m"))
    yield Claim("and not biased: mean difference", float(error.mean()), near(0.0, within=0.03, unit="m"))


@experiment(
    "nielsen-18",
    title="Still receiver: particles before and after the first range",
    runs=200,
    source="nielsen section 3.3.2, Fig. 18, listing PF1",
)
def figure_18(lab: Lab) -> Iterator[Claim]:
    yield from _still_figure(lab, STILL.figures[0])
    nearest = [run.after.std() for run in lab.map(still, STILL.figures[0], "nearest", runs=50)]
    yield Claim(
        "the listing's own resampling (nearest entry of the cumulative sum) is wrong: particles twice as far apart",
        rms(np.array(nearest)),
        at_least(1.8, "m"),
        "nielsen Annex A, listing PF1",
    )


@experiment(
    "nielsen-19",
    title="Still receiver: particles before and after the second range",
    runs=200,
    source="nielsen section 3.3.2, Fig. 19, listing PF1",
)
def figure_19(lab: Lab) -> Iterator[Claim]:
    yield from _still_figure(lab, STILL.figures[1])


@experiment(
    "nielsen-20",
    title="Still receiver: particles before and after the twentieth range",
    runs=400,
    source="nielsen section 3.3.2, Fig. 20, listing PF1",
)
def figure_20(lab: Lab) -> Iterator[Claim]:
    yield from _still_figure(lab, STILL.figures[2])


@experiment(
    "nielsen-21",
    title="Still receiver: loss of diversity",
    runs=100,
    source="nielsen section 3.3.2, Fig. 21, listing PF1",
)
def figure_21(lab: Lab) -> Iterator[Claim]:
    steps = (1, STILL.steps)
    weights, low, distinct, ess = {}, {}, {}, {}
    for step in steps:
        runs = lab.map(still, step)
        weights[step] = np.sort(runs[0].weights)
        low[step] = np.array([np.mean(run.weights < 0.01 * run.weights.max()) for run in runs])
        distinct[step] = np.array([len(np.unique(run.after)) for run in runs]) / STILL.particles
        ess[step] = np.array([1.0 / np.sum(run.weights**2) for run in runs]) / STILL.particles
    with lab.figure(7.2, 3.6) as figure:
        left, right = figure.subplots(1, 2)
        for step, colour in zip(steps, (BLUE, RED), strict=True):
            left.plot(weights[step] / weights[step].max(), color=colour, label=f"k = {step}")
            right.hist(distinct[step], np.linspace(0.0, 1.0, 51), color=colour, alpha=0.7, label=f"k = {step}")
        style(left, "Sorted weights of one run", "particle", "weight / largest")
        style(right, "Distinct particles after resampling", "share of all", "runs")
        left.legend()
        right.legend()
    lab.save(
        weights_first=weights[1],
        weights_last=weights[STILL.steps],
        low_first=low[1],
        low_last=low[STILL.steps],
        distinct_first=distinct[1],
        distinct_last=distinct[STILL.steps],
        ess_first=ess[1],
        ess_last=ess[STILL.steps],
    )
    yield Claim(
        "share of weights below 1 % of the largest at k = 1, pooled: there the weights lose diversity",
        float(low[1].mean()),
        band(0.3, 0.5),
    )
    yield Claim("and at k = 20: hardly any", float(low[STILL.steps].mean()), below(0.05))
    yield Claim(
        "without noise of the motion resampling leaves few: share of distinct particles at k = 20, pooled",
        float(distinct[STILL.steps].mean()),
        below(0.2),
    )


# -- PF2: response to a step


@dataclass(frozen=True)
class Response:
    """A run of PF2."""

    mean: Array
    spread: Array
    kalman_mean: Array
    kalman_spread: Array
    weights: Array
    particles: Array


def response(seed: int, sigma_m: float) -> Response:
    """PF2 with `sigma_m` of walk per step, resampled at every step."""
    z = STEP.measurements(np.random.default_rng(seed))
    cloud = ParticleFilter(
        STEP.particles, prior=Uniform([STEP.prior_m[0]], [STEP.prior_m[1]]), seed=seed, ess_threshold=1.0
    )
    run = cloud.run(
        np.arange(1.0, STEP.steps + 1),
        process.RandomWalk(sigma_m**2),
        Measured(measurement.Position(1), z, STEP.sigma_z_m),
        start_s=0.0,
    )
    assert run.covariance is not None
    exact = references.step_response(STEP, sigma_m, z)
    return Response(
        run.mean[:, 0],
        np.sqrt(run.covariance[:, 0, 0]),
        exact.mean[:, 0],
        exact.sigma[:, 0],
        cloud.weights,
        cloud.particles[:, 0],
    )


def _lag(mean: Array, truth: Array) -> float:
    """Steps by which the last crossing of half the height comes after the truth's."""
    half = 0.5 * STEP.height_m
    return float(np.flatnonzero(mean < half)[-1] - np.flatnonzero(truth < half)[-1])


def _step_figure(lab: Lab, number: int) -> Iterator[Claim]:
    truth, sigmas = STEP.truth(), STEP.sigmas_m
    transition = slice(STEP.transition[0] - 1, STEP.transition[1])
    settled = slice(STEP.steps - 600, STEP.steps)
    runs = {sigma: lab.map(response, sigma) for sigma in sigmas}
    first = runs[sigmas[number]][0]
    with lab.figure(7.2, 5.4) as figure:
        panels = figure.subplots(2, 2)
        k = np.arange(1, STEP.steps + 1)
        panels[0, 0].plot(k, first.mean, color=BLUE, lw=1.0, label="particles")
        panels[0, 0].plot(k, first.kalman_mean, color=GREY, lw=1.0, label="Kalman")
        panels[0, 0].plot(k, truth, "--", color=RED, label="truth")
        panels[0, 0].legend()
        panels[0, 1].plot(k, first.spread, color=BLUE, lw=1.0)
        panels[0, 1].plot(k, first.kalman_spread, color=GREY, lw=1.0)
        panels[1, 0].plot(np.sort(first.weights) * STEP.particles, color=BLUE)
        panels[1, 1].plot(np.sort(first.particles), color=BLUE)
        for axes, x, y in zip(
            panels.ravel(),
            ("k", "k", "particle", "particle"),
            ("mean of x [m]", "spread of x [m]", "weight × M", "x [m]"),
            strict=True,
        ):
            style(axes, "", x, y)
        figure.suptitle(f"Response with σ = {sigmas[number]} m per step")
    pooled = [rms(np.array([run.mean - truth for run in runs[sigma]])[:, transition]) for sigma in sigmas]
    late = [rms(np.array([run.mean - truth for run in runs[sigma]])[:, settled]) for sigma in sigmas]
    lag = [_lag(np.mean([run.mean for run in runs[sigma]], axis=0), truth) for sigma in sigmas]
    spread = [float(np.mean([run.spread[settled] for run in runs[sigma]])) for sigma in sigmas]
    kalman = [float(np.mean([run.kalman_spread[settled] for run in runs[sigma]])) for sigma in sigmas]
    lab.save(
        mean=first.mean,
        spread=first.spread,
        kalman_mean=first.kalman_mean,
        kalman_spread=first.kalman_spread,
        truth=truth,
        sigmas_m=sigmas,
        transition_rms_m=pooled,
        settled_rms_m=late,
        lag_steps=lag,
        spread_m=spread,
        kalman_spread_m=kalman,
    )
    words = ", ".join(str(sigma) for sigma in sigmas)
    if number == 0:
        yield Claim(
            f"σ = {sigmas[0]} is sluggish: RMS over the transition, against that of σ = {sigmas[1]}",
            pooled[0] / pooled[1],
            at_least(2.5),
        )
        yield Claim(f"lag of the mean response behind the truth for σ = {words}", lag, falling(1.3))
    if number == 1:
        yield Claim(f"RMS over the transition, pooled, for σ = {words}", pooled, falling())
        yield Claim(
            "the particles spread as the Kalman filter's variance says: ratio", spread[1] / kalman[1], band(0.95, 1.05)
        )
    if number == 2:
        yield Claim(f"each is noisier: spread for σ = {words}", spread, rising())
        yield Claim(f"RMS once settled for σ = {sigmas[1]}, {sigmas[2]}", late[1:], rising(1.2))
        yield Claim(
            "the particles spread as the Kalman filter's variance says: ratio", spread[2] / kalman[2], band(0.95, 1.05)
        )


@experiment(
    "nielsen-22", title="Response to a step, σ = 0.005", runs=40, source="nielsen section 3.3.2, Fig. 22, listing PF2"
)
def figure_22(lab: Lab) -> Iterator[Claim]:
    yield from _step_figure(lab, 0)


@experiment(
    "nielsen-23", title="Response to a step, σ = 0.02", runs=40, source="nielsen section 3.3.2, Fig. 23, listing PF2"
)
def figure_23(lab: Lab) -> Iterator[Claim]:
    yield from _step_figure(lab, 1)


@experiment(
    "nielsen-24", title="Response to a step, σ = 0.06", runs=40, source="nielsen section 3.3.2, Fig. 24, listing PF2"
)
def figure_24(lab: Lab) -> Iterator[Claim]:
    yield from _step_figure(lab, 2)


# -- Fig. 34: place and velocity


@dataclass(frozen=True)
class Smooth:
    """A run of Fig. 34, shapes (steps, 2): place and velocity."""

    mean: Array
    kalman: Array


def velocity_first(x: Array, w: Array) -> Array:
    """The velocity walks, then the place moves by the new one."""
    v = x[:, 1] + SMOOTH.sigma_v_mps * w[:, 0]
    return np.stack([x[:, 0] + v, v], axis=1)


def smooth(seed: int, particles: int, steps: int) -> Smooth:
    """Fig. 34 with a process and a likelihood of our own, functions of all particles."""
    z = SMOOTH.measurements(np.random.default_rng(seed))[:steps]
    start = np.tile(np.array(SMOOTH.x0), (particles, 1))
    cloud = ParticleFilter(particles, prior=Samples(start), state="position_velocity1", seed=seed, ess_threshold=1.0)
    model = measurement.Position(1)
    mean = np.empty((steps, 2))
    for k in range(steps):
        cloud.step(model, z[k], SMOOTH.sigma_z_m, process=velocity_first, noise=1)
        mean[k] = cloud.mean
    return Smooth(mean, references.smooth(SMOOTH, z).mean)


@experiment(
    "nielsen-34", title="Place and velocity of a still receiver", runs=20, source="nielsen section 3.3.5, Fig. 34"
)
def figure_34(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(smooth, SMOOTH.particles, SMOOTH.steps)
    first = runs[0]
    counts = (50, SMOOTH.particles, 4000)
    some = {count: lab.map(smooth, count, 300, runs=10) for count in counts}
    mean, kalman = np.array([run.mean for run in runs]), np.array([run.kalman for run in runs])
    off = [rms(np.array([run.mean[:, 0] - run.kalman[:, 0] for run in some[count]])) for count in counts]
    with lab.figure(7.2, 5.4) as figure:
        rows = figure.subplots(2, 1, sharex=True)
        for axes, i, unit in zip(rows, (0, 1), ("x [m]", "$v_x$ [m/s]"), strict=True):
            axes.plot(first.mean[:, i], color=BLUE, lw=0.8, label=f"{SMOOTH.particles} particles")
            axes.plot(first.kalman[:, i], color=RED, lw=0.8, alpha=0.7, label="Kalman")
            style(axes, "Mean of the particles, receiver at rest at 0" if i == 0 else "", "k" if i else "", unit)
        rows[0].legend()
    lab.save(mean=first.mean, kalman=first.kalman, particles=counts, rms_off_kalman_m=off)
    ratios = [rms(mean[:, :, i]) / rms(kalman[:, :, i]) for i in (0, 1)]
    yield Claim(
        f"RMS of place and velocity with M = {SMOOTH.particles}, against the Kalman filter's", ratios, band(0.95, 1.05)
    )
    yield Claim(
        f"difference to the Kalman filter's place falls with M = {', '.join(map(str, counts))}", off, falling(1.5)
    )
