"""Figures of navigation runs: errors in their bands, tracks, RMS over time, consistency, innovations.

A run is anything with ``t_s``, ``position_m`` and ``position_covariance_m2``, such as a `SystemRun` of
`soopnav_cpp.scenarios`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _save, _style, ellipse_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["consistency", "errors", "innovations", "rms", "state_errors", "trajectory"]

Array = npt.NDArray[np.float64]
Path = str | os.PathLike[str]
_AXIS = ("x", "y", "z")
_NED = ("north", "east", "down")
_BAD = _COLOURS[1]
_MOST_ELLIPSES = 14
_MOST_SOURCES = 8
_MOST_STATES = 16
_BINS = 60
_DASHED = (0, (4, 2))


def _numbers(item: Any, *names: str) -> Array | None:
    """The first of these attributes that there is."""
    for name in names:
        value = getattr(item, name, None)
        if value is not None:
            return np.asarray(value, dtype=np.float64)
    return None


def _times(run: Any) -> Array:
    found = _numbers(run, "t_s", "time_s")
    if found is None:
        raise ValueError("run: times expected in run.t_s")
    return found


def _position(run: Any) -> Array:
    found = _numbers(run, "position_m")
    if found is None:
        raise ValueError("run: positions expected in run.position_m")
    return found


def _covariance(run: Any, dim: int) -> Array:
    found = _numbers(run, "position_covariance_m2", "covariance", "P")
    if found is None:
        raise ValueError("run: covariances expected in run.position_covariance_m2")
    return found[:, :dim, :dim]


def _truth(run: Any, truth: Any, *, needed: bool) -> Array | None:
    given = getattr(run, "truth", None) if truth is None else truth
    if given is None:
        if needed:
            raise ValueError("truth: needed, for the run has none")
        return None
    if callable(getattr(given, "at", None)):  # a trajectory, or a track, knows any time
        given = given.at(_times(run))
    right = _numbers(given, "position_m")
    right = np.asarray(given, dtype=np.float64) if right is None else right
    if right.shape != _position(run).shape:
        raise ValueError(f"truth: expected shape {_position(run).shape}, got {right.shape}")
    return right


def _is_ned(run: Any) -> bool:
    return getattr(run, "axes", "enu") == "ned"


def _east_north(run: Any) -> SimpleNamespace:
    """What a map shows of a run in north-east-down: east to the right, north up."""
    turned = [1, 0]
    return SimpleNamespace(
        position_m=_position(run)[:, turned],
        position_covariance_m2=_covariance(run, 2)[:, turned][:, :, turned],
        baselines={name: np.asarray(other)[:, turned] for name, other in getattr(run, "baselines", {}).items()},
        sources={name: np.asarray(place)[turned] for name, place in getattr(run, "sources", {}).items()},
    )


def _title(figure: Figure, title: str) -> None:
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)


def _legend(axes: Axes, place: Literal["best", "upper right"] = "best", columns: int = 1) -> None:
    axes.legend(fontsize=8, frameon=True, framealpha=0.85, edgecolor="none", loc=place, ncols=columns)


def errors(run: Any, truth: Any = None, *, title: str = "", path: Path | None = None) -> Figure:
    """Draw each axis' position error over time within the filter's ±1σ band, as crosby's figures 4.1 to 4.4.

    Parameters
    ----------
    run : SystemRun, OfdmInertialRun or alike
    truth : Truth, trajectory or array_like of shape (n, d), optional
        In place of ``run.truth``. What has a method ``at``, as `simulation.PlanarTrajectory`, is asked for the times of
        the run.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        Without a truth, and for shapes that do not fit.
    """
    time, position = _times(run), _position(run)
    right = _truth(run, truth, needed=True)
    assert right is not None  # needed
    dim = position.shape[1]
    error = position - right
    sigma = np.sqrt(np.maximum(np.diagonal(_covariance(run, dim), axis1=1, axis2=2), 0.0))
    figure = _figure(9.0, 1.0 + 2.1 * dim)
    _title(figure, title)
    first = None
    for k in range(dim):
        axes = figure.add_subplot(dim, 1, k + 1, sharex=first)
        first = first or axes
        _band(axes, time, error[:, k], sigma[:, k])
        inside = np.mean(np.abs(error[:, k]) <= sigma[:, k])
        axis = _NED[k] if _is_ned(run) else _AXIS[k]
        name = f"{axis}: RMS {np.sqrt(np.mean(error[:, k] ** 2)):.3g} m, {100 * inside:.1f} % inside"
        _style(axes, name, "time [s]" if k == dim - 1 else "", f"{axis} error [m]")
        axes.tick_params(labelbottom=k == dim - 1)
        if k == 0:
            _legend(axes, "upper right", 2)
    return _save(figure, path)


def state_errors(run: Any, *, title: str = "", path: Path | None = None) -> Figure:
    """Draw the error of each component of the state over time within the filter's ±1σ band; angles in degrees.

    Parameters
    ----------
    run : SystemRun or alike
        With state, covariance, state_names and truth.state. Components after the sixteenth are left out.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        Without a truth of the state.
    """
    right = _numbers(getattr(run, "truth", None), "state")
    state, covariance = _numbers(run, "state"), _numbers(run, "covariance")
    if right is None or state is None or covariance is None:
        raise ValueError("run: state, covariance and truth.state needed")
    time, names = _times(run), run.state_names[:_MOST_STATES]
    columns = 1 if len(names) < 3 else 2
    rows = math.ceil(len(names) / columns)
    figure = _figure(9.0 if columns == 1 else 12.0, 0.8 + 1.75 * rows)
    _title(figure, title)
    first = None
    for k, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, k + 1, sharex=first)
        first = first or axes
        what, _, unit = name.rpartition("_")
        error, sigma = state[:, k] - right[:, k], np.sqrt(np.maximum(covariance[:, k, k], 0.0))
        if unit == "rad":
            error, sigma, unit = np.degrees((error + np.pi) % (2.0 * np.pi) - np.pi), np.degrees(sigma), "deg"
        _band(axes, time, error, sigma)
        inside = 100.0 * np.mean(np.abs(error) <= sigma)
        last = k >= len(names) - columns
        title_ = f"{(what or name).replace('_', ' ')}: RMS {np.sqrt(np.mean(error**2)):.3g}, {inside:.0f} % inside"
        _style(axes, title_, "time [s]" if last else "", f"[{unit.replace('ps', '/s').replace('/s2', '/s²')}]")
        axes.tick_params(labelbottom=last)
        if k == 0:
            _legend(axes, "upper right", 2)
    return _save(figure, path)


def _band(axes: Axes, time: Array, error: Array, sigma: Array) -> None:
    """An error in its ±1σ band."""
    axes.fill_between(time, -sigma, sigma, color=_COLOURS[0], alpha=0.15, linewidth=0, label="±1σ stated")
    for sign in (-1.0, 1.0):
        axes.plot(time, sign * sigma, color=_COLOURS[0], linewidth=0.8, alpha=0.7)
    axes.plot(time, error, color=_BAD, linewidth=1.0, label="error")
    axes.axhline(0.0, color=_INK, linewidth=0.6)
    axes.margins(x=0.0)


def _extent(points: Array) -> tuple[Array, float]:
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), max(1.0, float((high - low).max()))


def _magnification(reach_m: float, semi_major_m: float) -> float:
    """1, 2, 5, 10 ...: so that ellipses can be seen, a fortieth of the map at most."""
    if not semi_major_m > 0.0:
        return 1.0
    wanted = reach_m / 40.0 / semi_major_m
    if wanted < 2.0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= wanted)


def _draw_track(axes: Axes, run: Any, right: Array | None, *, near: bool) -> None:
    position = _position(run)[:, :2]
    covariance = _covariance(run, 2)
    for index, (name, other) in enumerate(getattr(run, "baselines", {}).items()):
        colour = _COLOURS[(4 + index) % len(_COLOURS)]
        axes.plot(other[:, 0], other[:, 1], linestyle=_DASHED, color=colour, linewidth=1.0, label=name)
    if right is not None:
        stands = bool(np.ptp(right[:, :2], axis=0).max() < 1e-3 * max(1.0, np.ptp(position, axis=0).max()))
        look: dict[str, Any] = {"marker": "+", "markersize": 16, "markeredgewidth": 2.0} if stands else {}
        axes.plot(right[:, 0], right[:, 1], color=_INK, linewidth=1.0, label="truth", **look)
    axes.plot(position[:, 0], position[:, 1], color=_COLOURS[0], linewidth=1.4, label="estimate")
    axes.plot([position[0, 0]], [position[0, 1]], "o", color=_COLOURS[2], markersize=6, label="start", zorder=4)
    if not near:
        return
    picks = np.unique(np.linspace(0, len(position) - 1, _MOST_ELLIPSES + 1).round().astype(int)[1:])
    shapes = []
    for k in picks:
        matrix = 0.5 * (covariance[k] + covariance[k].T)
        if np.linalg.eigvalsh(matrix)[0] > 0.0:
            shapes.append((k, estimation.error_ellipse(matrix, probability=0.95)))
    if not shapes:
        return
    typical = float(np.median([shape.semi_major_m for _, shape in shapes]))
    if typical > _extent(position)[1]:  # wider than the track: the last says it all
        shapes = shapes[-1:]
    scale = _magnification(_extent(position)[1], typical)
    label = "95 % ellipse" + (f", {scale:g} × enlarged" if scale > 1.0 else "")
    for k, shape in shapes:
        curve = position[k] + scale * ellipse_points(shape)
        axes.fill(curve[:, 0], curve[:, 1], color=_COLOURS[3], alpha=0.25, linewidth=0, label=label, zorder=1)
        axes.plot(curve[:, 0], curve[:, 1], color=_COLOURS[3], linewidth=0.7, zorder=2)
        label = "_"


def _view(axes: Axes, points: Array, pad: float, shape: float) -> None:
    """Show these points, as far beyond them as the panel (its width over its height) reaches."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = pad * max(1.0, float((high - low).max()))
    axes.autoscale(False)
    centre, half = 0.5 * (low + high), 0.5 * (high - low) + margin
    half = np.maximum(half, half[::-1] * np.array([shape, 1.0 / shape]))
    axes.set_xlim(centre[0] - half[0], centre[0] + half[0])
    axes.set_ylim(centre[1] - half[1], centre[1] + half[1])
    axes.set_aspect("equal", adjustable="box")


def trajectory(run: Any, truth: Any = None, *, title: str = "", path: Path | None = None) -> Figure:
    """Draw the track with its 95 % ellipses, the truth, baselines and sources; two maps when sources are far.

    Parameters
    ----------
    run : SystemRun or alike
        ``baselines`` and ``sources`` are drawn where it has them.
    truth : Truth, trajectory or array_like of shape (n, d), optional
        North is up in the map of a run in north-east-down.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    right = _truth(run, truth, needed=False)
    ned = _is_ned(run)
    placed = getattr(run, "origin_lla_deg", None) is not None
    if ned:
        run, right = _east_north(run), None if right is None else right[:, [1, 0]]
    position = _position(run)
    sources = {name: np.asarray(place)[:2] for name, place in getattr(run, "sources", {}).items()}
    labels = ("y (east) [m]", "x (north) [m]") if ned else ("x (east) [m]", "y (north) [m]")
    labels = labels if placed or ned else ("x [m]", "y [m]")
    tracks = [position[:, :2]] if right is None else [position[:, :2], right[:, :2]]
    centre, reach = _extent(np.vstack(tracks))
    for other in getattr(run, "baselines", {}).values():  # one that runs away does not shrink the rest
        tracks.append(np.clip(np.asarray(other)[:, :2], centre - 0.9 * reach, centre + 0.9 * reach))
    last = _covariance(run, 2)[-1]
    spread = 2.5 * np.sqrt(np.maximum(np.diagonal(last), 0.0))  # half a 95 % ellipse; inf where there is none to show
    if 0.5 * reach < spread.max() < math.inf:
        tracks.append(position[-1, :2] + np.array([-spread, spread]))
    near = np.vstack(tracks)
    everything = np.vstack([near, *(place[None] for place in sources.values())])
    both = bool(sources) and _extent(everything)[1] > 1.6 * _extent(near)[1]
    width_in, height_in = (12.4 if both else 8.4), 6.6
    shape = width_in / (2.0 if both else 1.0) / height_in
    figure = _figure(width_in, height_in)
    _title(figure, title)
    axes = figure.add_subplot(1, 2 if both else 1, 1)
    _style(axes, "Track", *labels)
    _draw_track(axes, run, right, near=True)
    _view(axes, near if both else everything, 0.10, shape)
    _legend(axes)
    if sources:
        if both:
            axes = figure.add_subplot(1, 2, 2)
            _style(axes, "Among its sources", *labels)
            _draw_track(axes, run, right, near=False)
            _view(axes, everything, 0.12, shape)
        for name, place in sources.items():
            axes.plot(*place, "^", color=_COLOURS[5], markersize=11, markeredgecolor="white", zorder=3)
            axes.annotate(
                name, tuple(place), xytext=(0, 9), textcoords="offset points", ha="center", fontsize=8.5, color=_INK
            )
    return _save(figure, path)


def rms(
    t_s: npt.ArrayLike,
    curves: Mapping[str, npt.ArrayLike],
    *,
    sigma_m: npt.ArrayLike | None = None,
    runs: int = 1,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw RMS position errors over time, as crosby's figures 4.5 and 4.6; logarithmic when curves are far apart.

    Parameters
    ----------
    t_s : array_like, shape (n,)
    curves : dict of str to array_like, shape (n,)
        By name, metres; the first is the system's own.
    sigma_m : array_like, shape (n,), optional
        What the filter stated.
    runs : int
        How many the RMS is over.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    time = np.asarray(t_s, dtype=np.float64)
    figure = _figure(9.0, 4.4)
    _title(figure, title)
    axes = figure.add_subplot()
    colours = (_COLOURS[0], *_COLOURS[4:], *_COLOURS[1:4])
    values = [np.asarray(curve, dtype=np.float64) for curve in curves.values()]
    for index, (name, value) in enumerate(zip(curves, values, strict=True)):
        style = "-" if index == 0 else _DASHED
        axes.plot(time, value, linestyle=style, color=colours[index % len(colours)], linewidth=1.3, label=name)
    if sigma_m is not None:
        stated = np.asarray(sigma_m, dtype=np.float64)
        axes.plot(time, stated, color=_COLOURS[0], linewidth=0.9, linestyle=(0, (1, 1.5)), label="stated by the filter")
    peaks = [float(value.max()) for value in values if value.size]
    if len(peaks) > 1 and max(peaks) > 15.0 * max(min(peaks), 1e-12):
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.02 * min(peaks))  # a start that is known exactly is no decade of interest
    else:
        axes.set_ylim(bottom=0.0)
    axes.margins(x=0.0)
    over = f"RMS position error over {runs} runs" if runs > 1 else "Position error"
    _style(axes, over, "time [s]", "error [m]")
    _legend(axes)
    return _save(figure, path)


def _binned(time: Array, nis: Array) -> tuple[Array, Array, Array, Array]:
    """Edges of time bins, and in each the mean of the NIS and its 95 % bounds; NaN in empty ones."""
    edges = np.linspace(time.min(), time.max(), min(_BINS, max(1, len(np.unique(time)))) + 1)
    places = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(places, minlength=len(edges) - 1)
    sums = np.bincount(places, weights=nis, minlength=len(edges) - 1)
    known = {int(c): estimation.mean_nees_bounds(1, int(c), failure_probability=0.05) for c in set(counts) if c}
    bounds = np.array([known.get(int(c), (np.nan, np.nan)) for c in counts])
    with np.errstate(invalid="ignore", divide="ignore"):
        return edges, sums / counts, bounds[:, 0], bounds[:, 1]


def consistency(
    nees: tuple[npt.ArrayLike, npt.ArrayLike, int] | None = None,
    nis: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    *,
    runs: int = 1,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw whether covariances deserve belief: NEES and NIS over time with the 95 % bounds of a consistent filter.

    Parameters
    ----------
    nees : (t_s, mean NEES over the runs, degrees of freedom), optional
    nis : (t_s, NIS), optional
        Of single scalar measurements, of all runs; drawn as means of time bins.
    runs : int
        Behind each mean of the NEES.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    parts = int(nees is not None) + int(nis is not None)
    if parts == 0:
        raise ValueError("nees, nis: at least one expected")
    figure = _figure(9.0, 0.8 + 2.7 * parts)
    _title(figure, title)
    at = 1
    if nees is not None:
        time, value, dof = np.asarray(nees[0], np.float64), np.asarray(nees[1], np.float64), nees[2]
        low, high = estimation.mean_nees_bounds(dof, runs, failure_probability=0.05)
        axes = figure.add_subplot(parts, 1, at)
        at += 1
        axes.axhspan(low, high, color=_COLOURS[2], alpha=0.13, linewidth=0, label="95 % bounds")
        axes.axhline(dof, color=_COLOURS[2], linewidth=0.9, label=f"expected: {dof}")
        axes.plot(time, value, color=_COLOURS[0], linewidth=1.0, label="NEES")
        _limit(axes, value, high)
        axes.margins(x=0.0)
        known = value[np.isfinite(value)]
        inside = np.mean((known >= low) & (known <= high)) if known.size else 0.0
        over = f"mean of {runs} runs" if runs > 1 else "one run"
        _style(axes, f"NEES of the position, {over}: {100 * inside:.0f} % inside", "time [s]", "NEES")
        _legend(axes, "upper right", 3)
    if nis is not None:
        time, value = np.asarray(nis[0], np.float64), np.asarray(nis[1], np.float64)
        axes = figure.add_subplot(parts, 1, at)
        if value.size:
            edges, mean, low_, high_ = _binned(time, value)
            axes.stairs(high_, edges, baseline=low_, fill=True, color=_COLOURS[2], alpha=0.13, label="95 % bounds")
            axes.axhline(1.0, color=_COLOURS[2], linewidth=0.9, label="expected: 1")
            axes.stairs(mean, edges, baseline=None, color=_COLOURS[0], linewidth=1.1, label="NIS")
            _limit(axes, mean, float(np.nanmax(high_)))
            axes.margins(x=0.0)
            _legend(axes, "upper right", 3)
        _style(axes, f"NIS of {value.size} accepted measurements, means of time bins", "time [s]", "NIS")
    return _save(figure, path)


def _limit(axes: Axes, values: Array, bound: float) -> None:
    """From zero; logarithmic when values are far outside the bounds."""
    finite = values[np.isfinite(values)]
    top = float(finite.max()) if finite.size else bound
    if top > 12.0 * bound:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, 1.25 * max(top, bound))


def _reach(accepted: Array, sigma: Array, gate: Array | None) -> float:
    """How far a panel of innovations goes: what went in, three standard deviations, and the gate but for its start."""
    sizes = [np.abs(accepted), 3.0 * sigma[np.isfinite(sigma)][-1:]]
    if gate is not None and np.isfinite(gate).any():
        sizes.append(1.2 * np.percentile(gate[np.isfinite(gate)], [90.0]))
    return max(1e-9, float(np.max(np.concatenate(sizes), initial=0.0)))


def innovations(updates: Any, *, title: str = "", path: Path | None = None) -> Figure:
    """Draw every source's innovations with what the filter expected, its gates, and what was refused.

    Parameters
    ----------
    updates : Updates or alike
        At least with t_s, source, innovation, variance, status and source_names.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    used = [i for i in range(len(updates.source_names)) if np.any(updates.source == i)][:_MOST_SOURCES]
    columns = 1 if len(used) <= 3 else 2
    rows = max(1, math.ceil(len(used) / columns))
    figure = _figure(9.0 if columns == 1 else 12.0, 0.8 + 2.3 * rows)
    _title(figure, title)
    unit = getattr(updates, "unit", "m")
    if not used:
        axes = figure.add_subplot()
        axes.text(0.5, 0.5, "no measurement", ha="center", va="center", color=_INK, transform=axes.transAxes)
        _style(axes, "Innovations", "time [s]", f"innovation [{unit}]")
    first = None
    for place, source in enumerate(used):
        axes = figure.add_subplot(rows, columns, place + 1, sharex=first)
        first = first or axes
        mine = (updates.source == source) & np.isfinite(updates.innovation) & (updates.status != "absent")
        time, value, status = updates.t_s[mine], updates.innovation[mine], updates.status[mine]
        sigma = np.sqrt(np.maximum(updates.variance[mine], 0.0))
        gate = None if updates.gate is None else updates.gate[mine]
        reach = _reach(value[status == "accepted"], sigma, gate)
        axes.fill_between(time, -sigma, sigma, color=_COLOURS[0], alpha=0.15, linewidth=0, label="±1σ expected")
        if gate is not None:
            for sign in (-1.0, 1.0):
                name = "gate" if sign > 0.0 else "_"
                axes.plot(time, sign * gate, color=_INK, linewidth=0.8, linestyle=_DASHED, label=name)
        good = status == "accepted"
        axes.plot(time[good], value[good], ".", color=_COLOURS[0], markersize=3.5, label="accepted")
        bad = ~good & (np.abs(value) <= reach)
        if np.any(bad):
            axes.plot(time[bad], value[bad], "x", color=_BAD, markersize=6, label="refused")
        name = "refused, further out"
        for sign, mark in ((1.0, "^"), (-1.0, "v")):
            out = ~good & (sign * value > reach)
            if np.any(out):
                axes.plot(time[out], np.full(out.sum(), sign * reach), mark, color=_BAD, markersize=5, label=name)
                name = "_"
        axes.axhline(0.0, color=_PALE, linewidth=0.6, zorder=0)
        axes.set_ylim(-1.08 * reach, (1.45 if place == 0 else 1.08) * reach)  # room for the legend
        name = f"{updates.source_names[source]}: {value.size} measured, {int((~good).sum())} refused"
        _style(axes, name, "time [s]" if place >= len(used) - columns else "", f"innovation [{unit}]")
        if place == 0:
            _legend(axes, "upper right", 5)
    return _save(figure, path)
