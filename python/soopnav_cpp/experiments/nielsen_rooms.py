"""Particle filters in a room, nielsen 3.3.3 and 3.3.4: Figs. 26 … 33."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import measurement, process
from soopnav_cpp.estimation import Measured, ParticleFilter, Uniform
from soopnav_cpp.experiments import nielsen_references as references
from soopnav_cpp.experiments.nielsen_setups import ROOM, ROOM_BIAS
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    at_least,
    at_most,
    band,
    below,
    condition,
    experiment,
    near,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

BLUE, RED, GREY = "tab:blue", "tab:red", "0.55"
MANY = 5000
"""Particles where the listing's 500 leave it to chance whether a statement holds."""
SECTOR = math.radians(30.0)


def rms(error: Array) -> float:
    """Root of the mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(error))))


@dataclass(frozen=True)
class Search:
    """A run of PF3: the last cloud, resampled, and the mean at each step."""

    particles: Array
    mean: Array


Nodes = Sequence[tuple[float, float]]
BOX = ((0.0, ROOM.size_m), (0.0, ROOM.size_m))


def search(
    seed: int,
    nodes: Nodes,
    receiver: tuple[float, float],
    particles: int,
    steps: int,
    walls: bool,
    sigma_step_m: float = ROOM.sigma_step_m,
) -> Search:
    """PF3 for any nodes, resampled at every step."""
    ranges = np.linalg.norm(np.array(nodes) - np.array(receiver), axis=1)
    noise = np.random.default_rng(seed).standard_normal((steps, len(nodes)))
    cloud = ParticleFilter(particles, prior=Uniform(BOX), seed=seed, ess_threshold=1.0)
    if walls:
        cloud.constrain(inside=BOX)
    run = cloud.run(
        np.arange(1.0, steps + 1),
        process.RandomWalk(sigma_step_m**2),
        Measured([measurement.Range(node) for node in nodes], ranges + ROOM.sigma_z_m * noise, ROOM.sigma_z_m),
        start_s=0.0,
        covariance=False,
    )
    cloud.resample()
    return Search(cloud.particles, run.mean)


def inside(particles: Array) -> npt.NDArray[np.bool_]:
    """Which particles are in the room."""
    return np.asarray(np.all((particles >= 0.0) & (particles <= ROOM.size_m), axis=1))


def sectors(particles: Array, count: int) -> Array:
    """Share of the particles in each 30° sector about the origin, from the first axis on."""
    angle = np.arctan2(particles[:, 1], particles[:, 0]) % (2.0 * math.pi)
    return np.bincount((angle / SECTOR).astype(int), minlength=12)[:count] / len(particles)


def _outline(axes: Axes, nodes: Nodes, receiver: tuple[float, float] | None, *, arcs: bool = True) -> None:
    """The room, its nodes, the receiver and its distance to each node."""
    size = ROOM.size_m
    axes.plot([0, size, size, 0, 0], [0, 0, size, size, 0], color=GREY, lw=1.5)
    turn = np.linspace(0.0, 2.0 * math.pi, 300)
    for x, y in nodes:
        axes.plot(x, y, "^", color="black", ms=8)
        if receiver is not None and arcs:
            r = math.hypot(receiver[0] - x, receiver[1] - y)
            axes.plot(x + r * np.cos(turn), y + r * np.sin(turn), "--", color=BLUE, lw=0.8)
    if receiver is not None:
        axes.plot(*receiver, "+", color=RED, ms=12, mew=2)
    axes.set_aspect("equal")


def _cloud_figure(
    lab: Lab, particles: Array, nodes: Nodes, receiver: tuple[float, float], title: str, half: float | None
) -> None:
    with lab.figure(5.4, 5.4) as figure:
        axes = figure.add_subplot()
        style(axes, title, "x [m]", "y [m]")
        _outline(axes, nodes, receiver)
        axes.plot(particles[:, 0], particles[:, 1], ".", color="black", ms=2)
        low, high = (-half, half) if half is not None else (-1.0, ROOM.size_m + 1.0)
        axes.set_xlim(low, high)
        axes.set_ylim(low, high)


@experiment(
    "nielsen-26",
    title="One node: the particles before the search",
    runs=1,
    source="nielsen section 3.3.3, Fig. 26, listing PF3",
)
def figure_26(lab: Lab) -> Iterator[Claim]:
    cloud = ParticleFilter(ROOM.particles, prior=Uniform(BOX), seed=lab.seeds[0])
    x = cloud.particles
    _cloud_figure(lab, x, ROOM.one_node_m, ROOM.receiver_m, f"{ROOM.particles} particles before the search", 10.0)
    lab.save(particles=x)
    yield Claim("share of the particles inside the room", float(inside(x).mean()), near(1.0, within=1e-12))
    cells, _, _ = np.histogram2d(x[:, 0], x[:, 1], 5, np.array(BOX))
    expected = len(x) / cells.size
    yield Claim(
        "they are uniform: χ² of the counts in 25 cells, 24 degrees of freedom",
        float(np.sum((cells - expected) ** 2) / expected),
        band(4.7, 63.0),
    )


@experiment(
    "nielsen-27", title="One node, no walls: an annulus", runs=10, source="nielsen section 3.3.3, Fig. 27, listing PF3"
)
def figure_27(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(search, ROOM.one_node_m, ROOM.receiver_m, MANY, ROOM.steps, False)
    first = runs[0].particles
    _cloud_figure(
        lab,
        first[: ROOM.particles],
        ROOM.one_node_m,
        ROOM.receiver_m,
        f"{ROOM.particles} of {MANY} particles after {ROOM.steps} steps, no walls",
        10.0,
    )
    radius = np.array([np.linalg.norm(run.particles, axis=1) for run in runs])
    share = np.array([sectors(run.particles, 12) for run in runs])
    room = np.array([inside(run.particles).mean() for run in runs])
    spread = radius.std(axis=1)
    lab.save(particles=first, radius=radius, sectors=share, in_room=room)
    distance = math.hypot(*ROOM.receiver_m)
    yield Claim(
        "the direction is unknown: of twelve 30° sectors, those with particles, least over the runs",
        float(np.min(np.sum(share > 0.0, axis=1))),
        at_least(12.0),
    )
    yield Claim("most particles are outside the room: share inside, pooled", float(room.mean()), below(0.5))
    yield Claim("width of the annulus, radial σ, pooled", rms(spread), band(0.55, 0.70, "m"))
    yield Claim(
        "its radius is the receiver's distance, pooled", float(radius.mean()), near(distance, within=0.8, unit="m")
    )


@experiment(
    "nielsen-28",
    title="One node and walls: a quarter of the annulus",
    runs=10,
    source="nielsen section 3.3.3, Fig. 28, listing PF3",
)
def figure_28(lab: Lab) -> Iterator[Claim]:
    runs = lab.map(search, ROOM.one_node_m, ROOM.receiver_m, MANY, ROOM.steps, True)
    first = runs[0].particles
    _cloud_figure(
        lab,
        first[: ROOM.particles],
        ROOM.one_node_m,
        ROOM.receiver_m,
        f"{ROOM.particles} of {MANY} particles after {ROOM.steps} steps, with walls",
        10.0,
    )
    share = np.array([sectors(run.particles, 3) for run in runs])
    lab.save(particles=first, sectors=share)
    yield Claim(
        "share of the particles inside the room, least over the runs",
        min(float(inside(run.particles).mean()) for run in runs),
        near(1.0, within=1e-12),
    )
    yield Claim(
        "each 30° sector of the quadrant keeps particles: least share over the runs",
        float(share.min()),
        at_least(0.05),
    )


def _two_nodes(lab: Lab) -> tuple[list[Search], Array]:
    """Runs of forty steps, and the distance of their means from the receiver, shape (runs, 40)."""
    runs = lab.map(search, ROOM.two_nodes_m, ROOM.receiver_m, ROOM.particles, 4 * ROOM.two_nodes_steps, True)
    return runs, np.linalg.norm(np.array([run.mean for run in runs]) - np.array(ROOM.receiver_m), axis=2)


@experiment(
    "nielsen-29", title="Two nodes: the room, and convergence", runs=600, source="nielsen section 3.3.3, Fig. 29"
)
def figure_29(lab: Lab) -> Iterator[Claim]:
    _, error = _two_nodes(lab)
    pooled = np.sqrt(np.mean(error**2, axis=0))
    with lab.figure(8.4, 4.2) as figure:
        left, right = figure.subplots(1, 2)
        style(left, "Two nodes; distances as circles", "x [m]", "y [m]")
        _outline(left, ROOM.two_nodes_m, ROOM.receiver_m)
        left.set_xlim(-4.0, 14.0)
        left.set_ylim(-8.0, 11.0)
        style(right, f"Error of the mean, {lab.runs} runs", "k", "RMS [m]")
        right.plot(np.arange(1, len(pooled) + 1), pooled, color=BLUE)
        right.set_ylim(bottom=0.0)
    lab.save(rms_m=pooled)
    a, b = (math.hypot(ROOM.receiver_m[0] - x, ROOM.receiver_m[1] - y) for x, y in ROOM.two_nodes_m)
    (x0, y0), (x1, _) = ROOM.two_nodes_m
    along = 0.5 * (x1 - x0 + (a * a - b * b) / (x1 - x0))
    across = math.sqrt(a * a - along * along)
    crossings = np.array([[x0 + along, y0 + across], [x0 + along, y0 - across]])
    yield Claim(
        "the two circles cross once inside the room: crossings there", int(inside(crossings).sum()), near(1, within=0.5)
    )
    at = ROOM.two_nodes_steps
    yield Claim(
        "ten steps are enough: pooled RMS at step 10 against step 40",
        float(pooled[at - 1] / pooled[-1]),
        band(0.85, 1.15),
    )


@experiment(
    "nielsen-30",
    title="Two nodes and walls: the particles after ten steps",
    runs=600,
    source="nielsen section 3.3.3, Fig. 30 (pt_7.m is not printed)",
)
def figure_30(lab: Lab) -> Iterator[Claim]:
    at = ROOM.two_nodes_steps
    runs = lab.map(search, ROOM.two_nodes_m, ROOM.receiver_m, ROOM.particles, at, True)
    error = np.array([run.mean[-1] for run in runs]) - np.array(ROOM.receiver_m)
    first = runs[0].particles
    _cloud_figure(
        lab, first, ROOM.two_nodes_m, ROOM.receiver_m, f"{ROOM.particles} particles after {at} steps, two nodes", None
    )
    distance = np.linalg.norm(error, axis=1)
    lab.save(particles=first, error_m=error)
    yield Claim(f"position RMS at step {at}, pooled", rms(distance), at_most(0.85, "m"))
    yield Claim(f"and of the worst of {lab.runs} runs", float(distance.max()), at_most(3.0, "m"))
    yield Claim(
        "share of the particles inside the room, least over the runs",
        min(float(inside(run.particles).mean()) for run in runs),
        near(1.0, within=1e-12),
    )


@experiment(
    "nielsen-31",
    title="Four nodes: a tight cluster",
    runs=400,
    source="nielsen section 3.3.3, Fig. 31 (pt_8.m is not printed)",
)
def figure_31(lab: Lab) -> Iterator[Claim]:
    nodes = tuple((float(x), float(y)) for x, y in ROOM.four_nodes_m)
    at, receiver = ROOM.two_nodes_steps, ROOM.receiver_four_nodes_m
    steps = (ROOM.sigma_step_m, 0.1)
    runs = [lab.map(search, nodes, receiver, ROOM.particles, at, True, sigma) for sigma in steps]
    error = [np.array([run.mean[-1] for run in some]) - np.array(receiver) for some in runs]
    first = runs[0][0].particles
    _cloud_figure(lab, first, nodes, receiver, f"{ROOM.particles} particles after {at} steps, four nodes", None)
    lab.save(particles=first, error_m=error[0], error_slow_m=error[1], steps_m=steps)
    pooled = [rms(np.linalg.norm(e, axis=1)) for e in error]
    yield Claim(f"position RMS at step {at}, pooled, steps of {steps[0]} m", pooled[0], at_most(0.7, "m"))
    yield Claim(f"the same with steps of {steps[1]} m", pooled[1], at_most(0.45, "m"))


@dataclass(frozen=True)
class Biased:
    """A run of PF4: means of x, y, b, those of the Kalman filter, and the last cloud."""

    mean: Array
    kalman: Array
    particles: Array
    degenerate: int


def biased(seed: int) -> Biased:
    """PF4, resampled at every step."""
    setup = ROOM_BIAS
    z = setup.measurements(np.random.default_rng(seed))
    box = [setup.prior_m] * 3
    cloud = ParticleFilter(setup.particles, prior=Uniform(box), state="position_clock2", seed=seed, ess_threshold=1.0)
    room: Any = [(0.0, setup.size_m)] * 2 + [(-math.inf, math.inf)]
    cloud.constrain(inside=room)
    run = cloud.run(
        np.arange(1.0, setup.steps + 1),
        process.RandomWalk(np.square(setup.sigma_step_m)),
        Measured([measurement.Pseudorange(node) for node in setup.nodes_m], z, setup.sigma_z_m),
        start_s=0.0,
        covariance=False,
    )
    cloud.resample()
    return Biased(run.mean, references.room_bias(setup, z).mean, cloud.particles, int(np.count_nonzero(run.status)))


def _biased(lab: Lab) -> tuple[list[Biased], Array, Array]:
    """Runs, and errors of the particles' and the Kalman filter's means once settled, (runs, steps, 3)."""
    runs = lab.map(biased)
    truth = np.array([*ROOM_BIAS.receiver_m, ROOM_BIAS.bias_m])
    settled = slice(ROOM_BIAS.settled[0] - 1, ROOM_BIAS.settled[1])
    ours = np.array([run.mean[settled] for run in runs]) - truth
    kalman = np.array([run.kalman[settled] for run in runs]) - truth
    return runs, ours, kalman


def _each(error: Array) -> Array:
    """RMS length of the error of each run."""
    return np.asarray(np.sqrt(np.mean(np.sum(error**2, axis=2), axis=1)))


@experiment(
    "nielsen-32",
    title="Four nodes and an unknown clock bias: the means",
    runs=200,
    source="nielsen section 3.3.4, Fig. 32, listing PF4",
)
def figure_32(lab: Lab) -> Iterator[Claim]:
    runs, ours, kalman = _biased(lab)
    truth = (*ROOM_BIAS.receiver_m, ROOM_BIAS.bias_m)
    with lab.figure(6.4, 6.4) as figure:
        rows = figure.subplots(3, 1, sharex=True)
        k = np.arange(1, ROOM_BIAS.steps + 1)
        for i, (axes, name) in enumerate(zip(rows, "xyb", strict=True)):
            axes.plot(k, runs[0].mean[:, i], color=BLUE, lw=1.0, label="particles")
            axes.plot(k, runs[0].kalman[:, i], color=GREY, lw=1.0, label="Kalman about the truth")
            axes.axhline(truth[i], color=RED, ls="--", lw=1.0, label="truth")
            style(axes, "", "k" if i == 2 else "", f"{name} [m]")
        rows[0].legend(ncol=3, loc="upper right")
    lab.save(mean=runs[0].mean, kalman=runs[0].kalman, error_m=ours, kalman_error_m=kalman)
    position, bias = _each(ours[:, :, :2]), _each(ours[:, :, 2:])
    yield Claim(f"bias RMS of each run, steps 51 … 100: worst of {lab.runs}", float(bias.max()), at_most(0.45, "m"))
    yield Claim(
        "position and bias RMS, pooled, against the Kalman filter's",
        [rms(position) / rms(_each(kalman[:, :, :2])), rms(bias) / rms(_each(kalman[:, :, 2:]))],
        band(0.9, 1.1),
    )


@experiment(
    "nielsen-33",
    title="Four nodes and an unknown clock bias: the particles",
    runs=200,
    source="nielsen section 3.3.4, Fig. 33, listing PF4",
)
def figure_33(lab: Lab) -> Iterator[Claim]:
    runs, ours, _ = _biased(lab)
    nodes = tuple((float(x), float(y)) for x, y in ROOM_BIAS.nodes_m)
    first = runs[0].particles
    with lab.figure(5.4, 5.4) as figure:
        axes = figure.add_subplot()
        style(axes, f"{ROOM_BIAS.particles} particles after {ROOM_BIAS.steps} steps", "x [m]", "y [m]")
        _outline(axes, nodes, ROOM_BIAS.receiver_m)
        axes.plot(first[:, 0], first[:, 1], ".", color="black", ms=2)
        axes.set_xlim(-1.0, ROOM.size_m + 1.0)
        axes.set_ylim(-1.0, ROOM.size_m + 1.0)
    lab.save(particles=first, error_m=ours)
    position = _each(ours[:, :, :2])
    truth = np.array(ROOM_BIAS.receiver_m)
    early = np.array([np.linalg.norm(run.mean[:, :2] - truth, axis=1).min() for run in runs])
    yield Claim(
        f"position RMS of each run, steps 51 … 100: worst of {lab.runs}", float(position.max()), at_most(0.6, "m")
    )
    yield Claim("within a metre of the receiver at some step: worst run", float(early.max()), at_most(1.0, "m"))
    yield Claim(
        "steps at which every weight vanished, all runs",
        sum(run.degenerate for run in runs),
        condition("none", lambda m: m[0] == 0.0),
    )
