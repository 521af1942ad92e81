"""Figures of emitters: bearings on a map, errors over time, likelihood surfaces, particle clouds.

Bearings are counted from x (east) towards y (north); arguments are radians and metres.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._bearing_figures import _TRUTH, _vector
from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _save, _style, ellipse_points
from soopnav_cpp._extras import require
from soopnav_cpp._run_figures import _legend, _title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["bearings_map", "likelihood", "particles", "source_errors"]

Array = npt.NDArray[np.float64]
Path = str | os.PathLike[str]
_MOST_RAYS = 90
_MOST_FIXES = 9
_NOBODY = "#8a949c"  # of bearings that belong to no emitter


def _plane(name: str, values: npt.ArrayLike) -> Array:
    """The first two columns of positions of two or three components."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ValueError(f"{name}: expected shape (n, 2) or (n, 3), got {array.shape}")
    return array[:, :2]


def _name(fixes: Any) -> dict[str, Any]:
    return dict(fixes) if isinstance(fixes, Mapping) else ({} if fixes is None else {"emitter": fixes})


def _place(item: Any) -> Array | None:
    """Position of a fix, two components; None where it has none."""
    position = np.asarray(getattr(item, "position_m", item), dtype=np.float64)
    return position[:2] if position.ndim == 1 and position.size >= 2 and np.isfinite(position[:2]).all() else None


def _spread(item: Any) -> Array | None:
    covariance = getattr(item, "covariance_m2", None)
    if covariance is None:
        return None
    matrix = np.asarray(covariance, dtype=np.float64)[:2, :2]
    matrix = 0.5 * (matrix + matrix.T)
    return matrix if np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0.0 else None


def _draw_fix(axes: Axes, item: Any, colour: str, name: str, *, filled: bool = True) -> None:
    place, spread = _place(item), _spread(item)
    if place is None:
        return
    axes.plot([place[0]], [place[1]], "*", color=colour, markersize=13.0, markeredgecolor="white", zorder=6, label=name)
    if spread is not None:
        ring = ellipse_points(estimation.error_ellipse(spread, probability=0.95)) + place
        if filled:
            axes.fill(ring[:, 0], ring[:, 1], color=colour, alpha=0.18, linewidth=0, zorder=4)
        axes.plot(ring[:, 0], ring[:, 1], color=colour, linewidth=1.0, zorder=5)


def _draw_truth(axes: Axes, truth_m: npt.ArrayLike | None) -> Array | None:
    if truth_m is None:
        return None
    right = np.atleast_2d(np.asarray(truth_m, dtype=np.float64))[:, :2]
    if len(right) > 1 and np.ptp(right, axis=0).max() > 0.0:
        axes.plot(right[:, 0], right[:, 1], color=_TRUTH, linewidth=1.0, zorder=5)
    axes.plot(
        [right[-1, 0]], [right[-1, 1]], "x", color=_TRUTH, markersize=9, markeredgewidth=1.8, zorder=7, label="truth"
    )
    return right


def bearings_map(
    positions_m: npt.ArrayLike,
    bearings_rad: npt.ArrayLike,
    *,
    sigmas_rad: npt.ArrayLike | None = None,
    fixes: Any = None,
    source: npt.ArrayLike | None = None,
    truth_m: npt.ArrayLike | None = None,
    line: tuple[npt.ArrayLike, float] | None = None,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw bearings from where they were taken, the positions found from them with 95 % ellipses, and an enlarged map.

    Parameters
    ----------
    positions_m : array_like, shape (n, 2) or (n, 3)
        The platform: east, north.
    bearings_rad : array_like, shape (n,)
        From east towards north.
    sigmas_rad : array_like, shape (n,), optional
        Bearings that say more are drawn darker, and those of more than 30° as a dot alone.
    fixes : SourceFix or alike, or mapping of str to such, optional
        With ``position_m`` and ``covariance_m2``; a bare position will do.
    source : array_like of int, shape (n,), optional
        Whose bearing it is, as an index into `fixes`: it has the colour of that position, which may be None; grey where
        it is -1, of nobody.
    truth_m : array_like, shape (d,) or (m, d), optional
        Where the emitter is, or how it moved.
    line : (point, bearing) of shape (2,) and radians, optional
        Drawn in place of a position, where bearings give a line alone.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    places = _plane("positions_m", positions_m)
    bearing = _vector("bearings_rad", bearings_rad)
    if len(bearing) != len(places):
        raise ValueError(f"bearings_rad: expected {len(places)} values, got {len(bearing)}")
    sigma = np.full(len(bearing), 0.05) if sigmas_rad is None else np.broadcast_to(
        np.asarray(sigmas_rad, dtype=np.float64), bearing.shape)  # fmt: skip
    who = np.zeros(len(bearing), np.int64) if source is None else np.asarray(source, dtype=np.int64)
    if len(who) != len(places):
        raise ValueError(f"source: expected {len(places)} values, got {len(who)}")
    shift = 0 if source is None else 1  # of rays; without owners they have a colour of their own
    numbers = {name: k for k, name in enumerate(_name(fixes))}
    named = {name: item for name, item in list(_name(fixes).items())[:_MOST_FIXES] if _place(item) is not None}
    points = [_place(item) for item in named.values()]
    targets = np.array([p for p in points if p is not None]).reshape(-1, 2)
    right = None if truth_m is None else np.atleast_2d(np.asarray(truth_m, dtype=np.float64))[:, :2]
    everything = np.vstack([places, targets, *([] if right is None else [right])])
    middle, reach = _extent(everything)
    for item in named.values():  # with their ellipses, unless those are larger than all the rest
        spread, place = _spread(item), _place(item)
        if spread is not None and place is not None and 4.9 * math.sqrt(float(np.linalg.eigvalsh(spread)[-1])) < reach:
            reaches = 2.45 * np.sqrt(np.diagonal(spread))
            everything = np.vstack([everything, place - reaches, place + reaches])
    middle, reach = _extent(everything)
    if line is not None:
        reach = max(reach, 1000.0)
    near = _near(targets, named, right, reach)
    figure = _figure(11.4 if near else 8.6, 6.4)
    _title(figure, title)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.65, 1.0)) if near else figure.add_gridspec(1, 1)
    for which in range(2 if near else 1):
        axes = figure.add_subplot(grid[0, which])
        _style(axes, "" if which == 0 else "Enlarged", "east [m]", "north [m]")
        axes.set_aspect("equal", adjustable="box")
        _rays(axes, places, bearing, sigma, [_colour(int(k) + shift, int(k)) for k in who], targets, 2.0 * reach)
        axes.plot(places[:, 0], places[:, 1], "-", color=_INK, linewidth=1.3, zorder=3, label="platform")
        axes.plot(places[:, 0], places[:, 1], ".", color=_INK, markersize=2.5, zorder=3)
        if which == 0:
            axes.plot([places[0, 0]], [places[0, 1]], "o", color=_INK, markersize=6, zorder=4, label="start")
        for name, item in named.items():
            k = numbers[name]
            _draw_fix(axes, item, _colour(k + 1, k), name, filled=k == 0 or k in who)
        if line is not None:
            point, angle = np.asarray(line[0], dtype=np.float64)[:2], float(line[1])
            arm = 2.0 * reach * np.array([math.cos(angle), math.sin(angle)])
            axes.plot(
                *np.stack([point, point + arm], axis=1), color=_COLOURS[1], linewidth=2.0, label="the line it is on"
            )
        _draw_truth(axes, truth_m)
        if which == 0:
            half_x, half_y = np.maximum(0.5 * np.ptp(everything, axis=0), 0.3 * reach) + 0.08 * reach
            if line is not None:
                half_x = half_y = 0.6 * reach
            axes.set_xlim(middle[0] - half_x, middle[0] + half_x)
            axes.set_ylim(middle[1] - half_y, middle[1] + half_y)
            _legend(axes)
        elif near:
            centre, half = near
            axes.set_xlim(centre[0] - half, centre[0] + half)
            axes.set_ylim(centre[1] - half, centre[1] + half)
    return _save(figure, path)


def _extent(points: Array) -> tuple[Array, float]:
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), max(10.0, float((high - low).max()))


def _near(targets: Array, named: Mapping[str, Any], right: Array | None, reach: float) -> tuple[Array, float] | None:
    """Centre and half width of an enlarged map, where ellipses are too small for the large one."""
    if not len(targets):
        return None
    spreads = [s for s in (_spread(item) for item in named.values()) if s is not None]
    sizes = [2.45 * math.sqrt(float(np.linalg.eigvalsh(s)[-1])) for s in spreads]
    size = float(np.median(sizes)) if sizes else 0.0
    centre = np.median(targets, axis=0)
    around = targets if right is None else np.vstack([targets, right[-1:]])
    away = np.linalg.norm(around - centre, axis=1)
    close = away[away < max(30.0 * size, 1.0)]
    half = 1.35 * max(float(close.max(initial=0.0)) + size, 1e-6)
    return (centre, half) if 0.0 < half < 0.2 * reach and len(close) else None


def _rays(
    axes: Axes, places: Array, bearing: Array, sigma: Array, colour: list[str], targets: Array, length: float
) -> None:
    """A share of the bearings as lines, darker where they are better."""
    pick = np.unique(np.linspace(0, len(bearing) - 1, min(_MOST_RAYS, len(bearing))).round().astype(int))
    drawn = pick[np.isfinite(bearing[pick]) & (sigma[pick] < math.radians(30.0))]
    if not drawn.size:
        return
    best = float(sigma[drawn].min())
    ends = np.full(len(bearing), length)
    if len(targets):
        ends = 1.25 * np.linalg.norm(places[:, None] - targets, axis=2).max(axis=1)
    collections = require("matplotlib.collections", "plot", "drawing")
    arms = ends[drawn, None] * np.column_stack([np.cos(bearing[drawn]), np.sin(bearing[drawn])])
    colours = [(*_rgb(colour[k]), 0.1 + 0.4 * min(1.0, best / float(sigma[k]))) for k in drawn]
    rays = np.stack([places[drawn], places[drawn] + arms], axis=1)
    axes.add_collection(collections.LineCollection(rays, colors=colours, linewidths=0.7, zorder=1), autolim=False)


def _colour(at: int, owner: int) -> str:
    """Of a position and of its bearings; grey without an owner."""
    return _NOBODY if owner < 0 else _COLOURS[at % len(_COLOURS)]


def _rgb(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return red, green, blue


def source_errors(
    t_s: npt.ArrayLike,
    errors_m: Mapping[str, npt.ArrayLike],
    *,
    sigma_m: npt.ArrayLike | None = None,
    bound_m: npt.ArrayLike | None = None,
    stated: bool = False,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw how far positions are from the truth over time, a curve for each method, on a logarithmic scale.

    Parameters
    ----------
    t_s : array_like, shape (n,)
    errors_m : mapping of str to array_like, shape (n,)
        Distances; NaN where a method had no position.
    sigma_m : array_like, shape (n,), optional
        What the first method states: root of the sum of its variances.
    bound_m : array_like, shape (n,), optional
        What no unbiased method can better.
    stated : bool
        The curves are standard deviations, for want of a truth.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    time = _vector("t_s", t_s)
    figure = _figure(9.0, 4.4)
    _title(figure, title)
    axes = figure.add_subplot()
    lowest, highest = math.inf, 0.0
    for k, (name, values) in enumerate(errors_m.items()):
        curve = _vector(name, values)
        if curve.size != time.size:
            raise ValueError(f"{name}: expected {time.size} values, got {curve.size}")
        shown = np.where(curve > 0.0, curve, np.nan)
        style = {"linewidth": 1.8, "zorder": 4} if k == 0 else {"linewidth": 1.0, "alpha": 0.85}
        axes.plot(time, shown, color=_COLOURS[(k + 1) % len(_COLOURS)], label=name, **style)  # type: ignore[arg-type]
        lowest, highest = min(lowest, np.nanmin(shown, initial=math.inf)), max(highest, np.nanmax(shown, initial=0.0))
    if sigma_m is not None and not stated:
        axes.plot(
            time, _vector("sigma_m", sigma_m), color=_INK, linewidth=1.0, linestyle=(0, (1, 1.5)), label="1σ stated"
        )
    if bound_m is not None:
        axes.plot(time, _vector("bound_m", bound_m), color=_INK, linewidth=1.1, label="Cramér–Rao bound")
    if 0.0 < lowest < math.inf:
        axes.set_yscale("log")
        axes.set_ylim(0.7 * max(lowest, 1e-3), 1.5 * highest)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.tick_params(axis="y", which="minor", labelleft=False)
    _style(axes, "", "time [s]", "1σ stated [m]" if stated else "distance from the truth [m]")
    axes.margins(x=0.01)
    _legend(axes, "upper right", 2)
    return _save(figure, path)


def likelihood(
    x_m: npt.ArrayLike,
    y_m: npt.ArrayLike,
    log_likelihood: npt.ArrayLike,
    *,
    fix: Any = None,
    truth_m: npt.ArrayLike | None = None,
    positions_m: npt.ArrayLike | None = None,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw where an emitter may be: the logarithm of the likelihood below its largest value, with regions of 39, 86 and
    99 % (1, 2 and 3 σ of a Gaussian in two dimensions).

    Parameters
    ----------
    x_m : array_like, shape (X,)
    y_m : array_like, shape (Y,)
    log_likelihood : array_like, shape (Y, X)
        Natural logarithm, of any offset; −∞ is allowed, NaN is not.
    fix, truth_m, positions_m : optional
        As in `bearings_map`.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    x, y = _vector("x_m", x_m), _vector("y_m", y_m)
    surface = np.asarray(log_likelihood, dtype=np.float64)
    if surface.shape != (y.size, x.size):
        raise ValueError(f"log_likelihood: expected shape ({y.size}, {x.size}), got {surface.shape}")
    if np.isnan(surface).any() or not np.isfinite(surface.max()):
        raise ValueError("log_likelihood: numbers expected, at least one of them finite")
    below = surface - surface.max()
    figure = _figure(7.8, 6.4)
    _title(figure, title)
    axes = figure.add_subplot()
    _style(axes, "", "east [m]", "north [m]")
    axes.set_aspect("equal", adjustable="box")
    shown = np.sqrt(2.0 * np.minimum(-below, 32.0))  # in σ of a Gaussian: 0 ... 8
    image = axes.pcolormesh(x, y, shown, cmap="magma_r", shading="nearest", vmin=0.0, vmax=8.0, rasterized=True)
    bar = figure.colorbar(image, ax=axes, shrink=0.85)
    bar.set_label("σ away from the best: √(2 (max ln L − ln L))", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    if x.size > 1 and y.size > 1:
        axes.contour(x, y, shown, levels=[1.0, 2.0, 3.0], colors="white", linewidths=0.9)
    if positions_m is not None:
        places = _plane("positions_m", positions_m)
        axes.plot(places[:, 0], places[:, 1], color=_INK, linewidth=1.2, label="platform")
    for k, (name, item) in enumerate(_name(fix).items()):
        _draw_fix(axes, item, _COLOURS[(k + 2) % len(_COLOURS)], name)
    _draw_truth(axes, truth_m)
    axes.set_xlim(float(x.min()), float(x.max()))
    axes.set_ylim(float(y.min()), float(y.max()))
    if axes.get_legend_handles_labels()[0]:
        _legend(axes)
    return _save(figure, path)


def particles(
    particles_m: npt.ArrayLike,
    weights: npt.ArrayLike | None = None,
    *,
    fix: Any = None,
    truth_m: npt.ArrayLike | None = None,
    positions_m: npt.ArrayLike | None = None,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw a cloud of particles, darker where they weigh more.

    Parameters
    ----------
    particles_m : array_like, shape (N, 2) or (N, 3)
    weights : array_like, shape (N,), optional
        Not negative, of any sum.
    fix, truth_m, positions_m : optional
        As in `bearings_map`.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    cloud = _plane("particles_m", particles_m)
    weight = np.ones(len(cloud)) if weights is None else _vector("weights", weights)
    if len(weight) != len(cloud):
        raise ValueError(f"weights: expected {len(cloud)} values, got {len(weight)}")
    if not len(cloud) or not (np.isfinite(weight).all() and weight.min() >= 0.0 and weight.sum() > 0.0):
        raise ValueError("weights: finite numbers of 0 or more expected, not all of them 0")
    figure = _figure(7.4, 6.4)
    _title(figure, title)
    axes = figure.add_subplot()
    share = weight / weight.max()
    effective = float(weight.sum() ** 2 / np.square(weight).sum())
    name = f"{len(cloud)} particles, effective {effective:.0f}"
    _style(axes, name, "east [m]", "north [m]")
    axes.set_aspect("equal", adjustable="box")
    colour = np.zeros((len(cloud), 4))
    colour[:, :3] = _rgb(_COLOURS[0])
    colour[:, 3] = 0.05 + 0.5 * share
    axes.scatter(cloud[:, 0], cloud[:, 1], s=6.0, c=colour, linewidths=0, rasterized=True)
    if positions_m is not None:
        places = _plane("positions_m", positions_m)
        axes.plot(places[:, 0], places[:, 1], color=_INK, linewidth=1.2, label="platform")
    for k, (label, item) in enumerate(_name(fix).items()):
        _draw_fix(axes, item, _COLOURS[(k + 1) % len(_COLOURS)], label)
    _draw_truth(axes, truth_m)
    centre = np.average(cloud, axis=0, weights=weight)
    half = max(1e-3, 5.0 * float(np.sqrt(np.average((cloud - centre) ** 2, axis=0, weights=weight)).max()))
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    if axes.get_legend_handles_labels()[0]:
        _legend(axes)
    return _save(figure, path)
