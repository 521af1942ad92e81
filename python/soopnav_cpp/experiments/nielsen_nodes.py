"""nielsen phase II: nodes that nobody synchronised, at places that nobody knows, found from a walk."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp.estimation import ErrorEllipse, error_ellipse
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, condition, experiment, style
from soopnav_cpp.navigation import NodeMap, NodeMapStatus, locate_nodes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Floats = npt.NDArray[np.float64]

EPOCHS, DURATION_S, SIGMA_M = 240, 60.0, 1.0
SPAN_M, DISTANCE_M = 24.0, 18.0
CLOCK_M_PER_SQRT_S = 0.2
CAMERA_M_PER_SQRT_S = 1e-3 * math.sqrt(20.0)  # 0.2 mm per 20 mm step, stated as 1 mm, at 20 frames a second
HEADING_RAD_PER_SQRT_S = math.radians(0.02) * math.sqrt(20.0)


def walk(span_m: float, *, straight: bool = False) -> tuple[_Floats, _Floats]:
    """Times and places of a Lissajous walk, or of a straight one."""
    t = np.arange(EPOCHS) * DURATION_S / EPOCHS
    turn = 2.0 * math.pi * t / DURATION_S
    if straight:
        return t, np.column_stack([np.linspace(-0.5, 0.5, EPOCHS) * span_m, np.zeros(EPOCHS)])
    return t, 0.5 * span_m * np.column_stack([np.sin(2.0 * turn), np.sin(3.0 * turn + 0.5)])


def camera(places: _Floats, t: _Floats, rng: np.random.Generator) -> _Floats:
    """The walk as a camera's odometry has it, drifting in place and heading from its start."""
    root = np.sqrt(np.diff(t))
    heading = np.concatenate([[0.0], np.cumsum(HEADING_RAD_PER_SQRT_S * root * rng.normal(size=len(root)))])[:-1]
    step = np.diff(places, axis=0) - CAMERA_M_PER_SQRT_S * root[:, None] * rng.normal(size=(len(root), 2))
    c, s = np.cos(heading), np.sin(heading)
    seen = np.column_stack([c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]])
    return np.vstack([places[:1], places[0] + np.cumsum(seen, axis=0)])


def found(
    seed: int, clock: str, count: int, span_m: float, distance_m: float, straight: bool = False
) -> tuple[NodeMap, _Floats, _Floats]:
    """A walk among nodes; what was found, the nodes and the measured track."""
    rng = np.random.default_rng(seed)
    t, places = walk(span_m, straight=straight)
    azimuth = 2.0 * math.pi * (np.arange(count) + rng.uniform()) / count + rng.uniform(-0.3, 0.3, count)
    if straight:  # none in line with the walk
        azimuth = np.array([0.9, 2.1, -0.8, -2.3])[:count] + rng.uniform(-0.2, 0.2, count)
    nodes = distance_m * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    drift = np.cumsum(CLOCK_M_PER_SQRT_S * math.sqrt(DURATION_S / EPOCHS) * rng.normal(size=EPOCHS))
    receiver = 500.0 + (drift if clock == "random_walk" else 1000.0 * rng.normal(size=EPOCHS))
    ranges = np.linalg.norm(places[:, None] - nodes, axis=2) + receiver[:, None] + rng.uniform(-1000.0, 1000.0, count)
    track = camera(places, t, rng)
    result = locate_nodes(
        track,
        ranges + SIGMA_M * rng.normal(size=ranges.shape),
        SIGMA_M,
        t_s=t,
        clock=clock,
        clock_m_per_sqrt_s=CLOCK_M_PER_SQRT_S,
        track_m_per_sqrt_s=CAMERA_M_PER_SQRT_S,
        heading_rad_per_sqrt_s=HEADING_RAD_PER_SQRT_S,
        seed=seed % 2**32,
    )
    return result, nodes, track


def one_walk(
    seed: int, clock: str, count: int, span_m: float, distance_m: float
) -> tuple[float, float, float, float, float]:
    """Mean square error, its stated value, NEES, cost per degree of freedom; whether it ended well, and unique."""
    result, nodes, _ = found(seed, clock, count, span_m, distance_m)
    square = float(np.mean(np.sum((result.position_m - nodes) ** 2, axis=1)))
    good = result.status is NodeMapStatus.OK and not result.mirrored.any()
    stated = float(np.mean(result.sigma_m() ** 2))
    return square, stated, result.nees(nodes), result.cost / result.degrees_of_freedom, float(good)


def one_straight(seed: int) -> tuple[float, float, float]:
    """Share of nodes named as mirrored; of nodes within 4 sigma by one of the answers; and of honest words."""
    result, nodes, _ = found(seed, "random_walk", 4, SPAN_M, DISTANCE_M, True)
    answers = np.stack([result.position_m, np.where(result.mirrored[:, None], result.mirror_m, result.position_m)])
    near = np.linalg.norm(answers - nodes, axis=2).min(axis=0) < 4.0 * result.sigma_m()
    words = any("side" in text for text in result.ambiguities)
    return float(result.mirrored.mean()), float(near.mean()), float(words)


def one_world(seed: int) -> float:
    """Largest change of what was found when everyone's time moves by 200 m: nothing but the clock may know."""
    rng = np.random.default_rng(seed)
    t, places = walk(SPAN_M)
    nodes = rng.uniform(-18.0, 18.0, (4, 2))
    ranges = np.linalg.norm(places[:, None] - nodes, axis=2) + SIGMA_M * rng.normal(size=(EPOCHS, 4))
    here, there = (locate_nodes(places, ranges + shift, SIGMA_M, t_s=t) for shift in (0.0, 200.0))
    moved = np.abs(there.position_m - here.position_m).max() + np.abs(there.offset_m - here.offset_m).max()
    return float(moved + np.abs(there.clock_m - here.clock_m - 200.0).max())


def _ellipse(axes: Axes, centre: _Floats, covariance: _Floats, colour: str) -> None:
    ellipse: ErrorEllipse = error_ellipse(covariance, probability=0.95)
    turn = np.linspace(0.0, 2.0 * math.pi, 90)
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    x, y = ellipse.semi_major_m * np.cos(turn), ellipse.semi_minor_m * np.sin(turn)
    axes.plot(centre[0] + c * x - s * y, centre[1] + s * x + c * y, color=colour, linewidth=1.1)


def _map(axes: Axes, seed: int, *, straight: bool) -> None:
    result, nodes, track = found(seed, "random_walk", 4, SPAN_M, DISTANCE_M, straight)
    style(axes, "A straight walk: both sides" if straight else "Four nodes from a walk", "x [m]", "y [m]")
    axes.plot(track[:, 0], track[:, 1], color="#8a949c", linewidth=1.0, label="walk, by camera")
    axes.plot(nodes[:, 0], nodes[:, 1], "^", color="#22303c", markersize=8, label="nodes")
    axes.plot(
        result.position_m[:, 0], result.position_m[:, 1], "+", color="#1b6ca8", ms=11, mew=1.8, label="found, 95 %"
    )
    for node, centre in enumerate(result.position_m):
        covariance = result.covariance_m2[2 * node : 2 * node + 2, 2 * node : 2 * node + 2]
        _ellipse(axes, centre, covariance, "#1b6ca8")
        if result.mirrored[node]:
            flip = np.diag([1.0, -1.0])
            _ellipse(axes, result.mirror_m[node], flip @ covariance @ flip, "#d1495b")
    if result.mirrored.any():
        mirror = result.mirror_m[result.mirrored]
        axes.plot(mirror[:, 0], mirror[:, 1], "x", color="#d1495b", ms=8, mew=1.8, label="the other solution")
    axes.set_aspect("equal")
    axes.set_xlim(-30, 30)
    axes.set_ylim(-29, 37)
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center")


@experiment(
    "nielsen-x2",
    title="Unsynchronised nodes at unknown places",
    source="nielsen section 4 and phase II; walk of 24 m among nodes 18 m away",
    runs=60,
)
def nodes(lab: Lab) -> Iterator[Claim]:
    """Ranges of 1 m, 240 epochs, a camera that drifts in place and heading; a clock of 0.2 m/√s, or a free one.

    The walk reaches two thirds of the nodes' distance from its middle: 24 m across, nodes 18 m away.
    """
    cases = {
        "four nodes, clock a random walk": ("random_walk", 4),
        "four nodes, free clock": ("free", 4),
        "three nodes, free clock": ("free", 3),
        "six nodes, clock a random walk": ("random_walk", 6),
    }
    for label, (clock, count) in cases.items():
        square, stated, nees, cost, good = np.array(lab.map(one_walk, clock, count, SPAN_M, DISTANCE_M)).T
        yield Claim(f"{label}: RMS of the nodes' places [m]", float(np.sqrt(square.mean())), at_most(1.5))
        dof = 2 * count * lab.runs
        width = 5.0 * math.sqrt(2.0 / dof) + 0.05  # curvature of the ranges adds some per cent
        yield Claim(f"{label}: NEES per degree of freedom", nees.sum() / dof, band(1.0 - width, 1.0 + width + 0.1))
        yield Claim(f"{label}: cost per degree of freedom", cost.mean(), band(0.97, 1.03))
        yield Claim(f"{label}: found, and found unique", good.mean(), at_least(0.9))
        lab.save(part=f"{clock}_{count}", rms_m=np.sqrt(square), stated_m=np.sqrt(stated), nees=nees)
    flags, near, words = np.array(lab.map(one_straight)).T
    yield Claim("straight walk: nodes whose side is said to be unknown", flags.mean(), at_least(0.95))
    yield Claim("straight walk: nodes within 4 sigma of one of the two answers", near.mean(), at_least(0.9))
    yield Claim("straight walk: runs that name the ambiguity", words.mean(), at_least(0.98))
    shift = max(lab.map(one_world, runs=5))
    yield Claim(
        "a time common to all moves the clock and nothing else [m]", shift, condition("< 0.01", lambda m: m[0] < 0.01)
    )
    ratio = np.array([0.35, 0.5, 0.67, 1.0, 1.33, 2.0])
    spread = np.array([lab.map(one_walk, "random_walk", 4, r * DISTANCE_M, DISTANCE_M, runs=24) for r in ratio])
    rms, bound = np.sqrt(spread[:, :, 0].mean(axis=1)), np.sqrt(np.median(spread[:, :, 1], axis=1))
    yield Claim("RMS with a walk twice as wide as the nodes are away [m]", float(rms[-1]), at_most(0.5))
    yield Claim(
        "a walk only two thirds of their distance across is too small for 1.5 m: stated, median [m]",
        float(bound[2]),
        condition("1.5 … 6", lambda m: 1.5 <= m[0] <= 6.0),
    )
    yield Claim("stated with a third of the distance over that with twice", float(bound[0] / bound[-1]), at_least(5.0))
    with lab.figure(12.4, 4.6) as figure:
        _map(figure.add_subplot(1, 3, 1), lab.seeds[0], straight=False)
        _map(figure.add_subplot(1, 3, 2), lab.seeds[1], straight=True)
        axes = figure.add_subplot(1, 3, 3)
        style(axes, "The walk must be wide enough", "width of the walk over nodes' distance", "RMS [m]")
        axes.loglog(ratio, rms, "o-", color="#1b6ca8", label="found, 24 walks each")
        axes.loglog(ratio, bound, "s:", color="#8a949c", label="stated, median")
        axes.axhline(1.5, color="#d1495b", linewidth=0.9, linestyle=(0, (4, 3)), label="1.5 m")
        axes.set_xticks([0.35, 0.67, 1.0, 2.0], ["0.35", "0.67", "1", "2"])
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=8)
    lab.save(span_ratio=ratio, span_rms_m=rms, span_stated_m=bound)
