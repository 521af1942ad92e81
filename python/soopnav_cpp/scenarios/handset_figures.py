"""Figures of ``handset`` runs: the room with walk, nodes and particles, errors, P(LOS), a frame, the animation."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation, plotting
from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _style, ellipse_points
from soopnav_cpp._extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from soopnav_cpp.scenarios.handset import HandsetRun, HandsetScenario

__all__ = ["animate", "errors_over_time", "figures", "room_map", "sight"]

Array = npt.NDArray[np.float64]
_MOST_PICTURES = 80  # of the animation
_ARM_M = 1.0  # that shows a heading


def _room(axes: Axes, size_m: float) -> None:
    half = 0.5 * size_m * np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
    axes.plot(half, np.roll(half, 1), color=_INK, linewidth=2.2)
    axes.set_aspect("equal")


def _nodes(axes: Axes, run: HandsetRun, *, edge_m: float) -> list[Any]:
    """Numbered circles near the border of the picture, in the directions of the nodes outside; a mark per node."""
    drawn = []
    for k, place in enumerate(run.nodes_m[:, :2]):
        edge = place / np.abs(place).max() * (edge_m - 0.06 * run.size_m)
        (mark,) = axes.plot(*edge, "o", color=_COLOURS[4], markersize=13)
        axes.text(
            float(edge[0]),
            float(edge[1]),
            str(k + 1),
            fontsize=8,
            ha="center",
            va="center",
            color="white",
            fontweight="bold",
        )
        drawn.append(mark)
    return drawn


def room_map(run: HandsetRun, *, alone: str = "LTE alone") -> Figure:
    """The room from above: the walk, the estimate, what LTE alone finds, and particles from time to time."""
    figure = _figure(6.8, 7.0)
    axes = figure.add_subplot()
    _room(axes, run.size_m)
    edge = 0.64 * run.size_m
    shown = run.clouds[:: max(1, len(run.clouds) // 6)]
    for i, (time, cloud) in enumerate(shown):
        axes.plot(cloud[:, 0], cloud[:, 1], ".", color=_COLOURS[3], markersize=1.6, alpha=0.35,
                  label="particles, now and then" if i == 0 else None)  # fmt: skip
        centre = cloud.mean(axis=0)
        if np.abs(centre).max() < 0.5 * run.size_m:
            axes.annotate(f"{time:.0f} s", centre, xytext=(9, -11), textcoords="offset points", fontsize=7.5,
                          color=_COLOURS[3])  # fmt: skip
    if alone in run.baselines:
        other = run.baselines[alone]
        axes.plot(other[:, 0], other[:, 1], color=_PALE, linewidth=0.9, zorder=0, label=alone)
    assert run.truth is not None
    truth = run.truth.position_m
    axes.plot(truth[:, 0], truth[:, 1], color=_INK, linewidth=3.0, alpha=0.3, label="truth")
    axes.plot(run.position_m[:, 0], run.position_m[:, 1], color=_COLOURS[0], linewidth=1.3, label="LTE and camera")
    axes.plot(*truth[0], "o", color=_COLOURS[2], markersize=6, label="start")
    _nodes(axes, run, edge_m=edge)
    axes.set_xlim(-edge, edge)
    axes.set_ylim(-edge, edge)
    _style(axes, "The walk; circles: where the base stations lie outside", "x [m]", "y [m]")
    figure.legend(fontsize=8, frameon=False, loc="outside lower center", ncols=5)
    return figure


def errors_over_time(scenario: HandsetScenario, run: HandsetRun, *, alone: str = "LTE alone") -> Figure:
    """Distance from the truth over time beside LTE alone, what is stated of it, and how many links are shut."""
    assert run.truth is not None
    figure = _figure(8.6, 5.2)
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    error = np.linalg.norm(run.position_m - run.truth.position_m, axis=1)
    stated = np.sqrt(np.trace(run.position_covariance_m2, axis1=1, axis2=2))
    if alone in run.baselines:
        other = np.linalg.norm(run.baselines[alone] - run.truth.position_m, axis=1)
        axes.semilogy(run.t_s, np.maximum(other, 1e-3), color=_COLOURS[7], linewidth=1.0, label=alone)
    axes.semilogy(run.t_s, np.maximum(error, 1e-3), color=_COLOURS[0], linewidth=1.3, label="LTE and camera")
    axes.semilogy(run.t_s, stated, "--", color=_COLOURS[1], linewidth=1.0, label="stated (root of the trace)")
    if scenario.metrics_start_s > 0.0:
        axes.axvline(scenario.metrics_start_s, color=_PALE, linewidth=1.0)
        low = axes.get_ylim()[0]
        axes.text(scenario.metrics_start_s, low, " metrics count from here", fontsize=7.5, va="bottom", color=_INK)
    axes.yaxis.set_major_formatter("{x:g}")
    _style(axes, "Distance from the truth", "", "error [m]")
    axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)
    below.step(run.t_s, (~run.los).sum(axis=1), where="mid", color=_COLOURS[4])
    below.set_ylim(-0.2, max(2.2, float((~run.los).sum(axis=1).max()) + 0.4))
    below.yaxis.set_major_locator(require("matplotlib.ticker", "plot", "drawing").MaxNLocator(integer=True))
    _style(below, "", "time [s]", "links shut")
    return figure


def sight(run: HandsetRun) -> Figure:
    """P(LOS) of each link against the truth, shaded where the link is shut."""
    links = run.los.shape[1]
    figure = _figure(8.6, 0.9 + 0.95 * links)
    panels = figure.subplots(links, 1, sharex=True, squeeze=False)[:, 0]
    for k, axes in enumerate(panels):
        axes.fill_between(run.t_s, 0.0, 1.0, where=~run.los[:, k], step="mid", color=_COLOURS[4], alpha=0.3,
                          linewidth=0.0, label="shut in truth")  # fmt: skip
        axes.plot(run.t_s, run.p_los[:, k], color=_COLOURS[0], linewidth=1.1, label="P(LOS) of the filter")
        axes.set_ylim(-0.06, 1.06)
        axes.set_yticks([0.0, 1.0])
        last = k == links - 1
        _style(axes, "Whether each link is in sight" if k == 0 else "", "time [s]" if last else "", f"link {k + 1}")
    figure.legend(
        *panels[-1].get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside upper right", ncols=2
    )
    return figure


def figures(scenario: HandsetScenario, run: HandsetRun) -> dict[str, Figure]:
    """All that there is to see, by caption."""
    found = {
        "The room with the walk, the particles and the base stations": room_map(run),
        "Error over time against LTE alone": errors_over_time(scenario, run),
        "P(LOS) of each link against the truth": sight(run),
    }
    if run.frame is not None:
        image = plotting.draw_tracks(run.frame.image, run.frame.tracks)
        figure = _figure(6.4, 6.4 * image.shape[0] / image.shape[1] + 0.3)
        axes = figure.add_subplot()
        axes.imshow(image)
        axes.set_axis_off()
        axes.set_title(f"Tracks at {run.frame.t_s:.2f} s", loc="left", fontsize=10.5, fontweight="bold", color=_INK)
        found["A frame with its tracks: green ones agree with the motion"] = figure
    return found


def animate(run: HandsetRun, path: Path, *, rate_hz: float = 10.0) -> Path:
    """Particles, estimate and truth over time, as a GIF.

    Parameters
    ----------
    run : HandsetRun
    path : Path
        ``.gif``.
    rate_hz : float
        Pictures per second.

    Returns
    -------
    Path
    """
    pillow = require("PIL.Image", "vision", "drawing an animation")
    assert run.truth is not None
    figure = _figure(5.0, 5.0)
    axes = figure.add_subplot()
    _room(axes, run.size_m)
    edge = 0.64 * run.size_m
    axes.set_xlim(-edge, edge)
    axes.set_ylim(-edge, edge)
    nodes = _nodes(axes, run, edge_m=edge)
    (dots,) = axes.plot([], [], ".", color=_COLOURS[3], markersize=2.0, alpha=0.5)
    (way,) = axes.plot([], [], color=_INK, linewidth=2.4, alpha=0.3)
    (found,) = axes.plot([], [], color=_COLOURS[0], linewidth=1.2)
    (ring,) = axes.plot([], [], color=_COLOURS[0], linewidth=0.9)
    (here,) = axes.plot([], [], "o", color=_COLOURS[1], markersize=5)
    (arm,) = axes.plot([], [], color=_COLOURS[1], linewidth=1.4)
    _style(axes, "", "x [m]", "y [m]")
    pictures = []
    clouds = run.clouds[:: max(1, math.ceil(len(run.clouds) / _MOST_PICTURES))]
    for time, cloud in clouds:
        k = int(np.argmin(np.abs(run.t_s - time)))
        dots.set_data(cloud[:, 0], cloud[:, 1])
        way.set_data(run.truth.position_m[: k + 1].T)
        found.set_data(run.position_m[: k + 1].T)
        part = 0.5 * (run.position_covariance_m2[k] + run.position_covariance_m2[k].T)
        if np.linalg.eigvalsh(part)[0] > 0.0:
            ring.set_data((run.position_m[k] + ellipse_points(estimation.error_ellipse(part, probability=0.95))).T)
        here.set_data(run.truth.position_m[k][:, None])
        if run.truth.heading_rad is not None:
            ahead = _ARM_M * np.array([math.cos(run.truth.heading_rad[k]), math.sin(run.truth.heading_rad[k])])
            arm.set_data(np.stack([run.truth.position_m[k], run.truth.position_m[k] + ahead]).T)
        for mark, p_los in zip(nodes, run.p_los[k], strict=True):
            mark.set_color(_COLOURS[2] if p_los >= 0.5 else _COLOURS[1])
        axes.set_title(f"{time:5.1f} s   green: in sight, red: shut, as the filter sees it", loc="left", fontsize=9,
                       color=_INK)  # fmt: skip
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=80, format="png")
        buffer.seek(0)
        pictures.append(pillow.open(buffer).convert("RGB").quantize(48))
    each_ms = round(1000.0 / rate_hz)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=each_ms, loop=0, optimize=True)
    return path
