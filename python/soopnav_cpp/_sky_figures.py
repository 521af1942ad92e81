"""Figures of the sky: where satellites pass, how high, and what they do to a carrier."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import orbits as _orbits
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _save, _style
from soopnav_cpp._extras import require
from soopnav_cpp._orbit_paths import signal_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["passes"]

Array = npt.NDArray[np.float64]
_STEPS = 900


def passes(
    orbits: Sequence[SampledOrbit],
    p_e: npt.ArrayLike,
    start_s: float,
    end_s: float,
    *,
    names: Sequence[str] | None = None,
    mask_rad: float = 0.0,
    carrier_hz: float = 1626.270833e6,
    reference: datetime | str | None = None,
    title: str = "",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the passes of satellites over a place: the sky, elevation and Doppler over time.

    Parameters
    ----------
    orbits : sequence of SampledOrbit
        Each must cover the span, and the light time before it.
    p_e : array_like, shape (3,)
        ECEF [m].
    start_s, end_s : float
    names : sequence of str, optional
        One for each orbit; their numbers without.
    mask_rad : float
        Only what stands above it is drawn.
    carrier_hz : float
    reference : datetime or str, optional
        The instant (UTC) of time 0; the axes of time then show the time of day.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For names of another number than the orbits, and as `orbits.passes`.
    """
    labels = [str(i) for i in range(len(orbits))] if names is None else [str(n) for n in names]
    if len(labels) != len(orbits):
        raise ValueError(f"names: {len(orbits)} expected, one for each orbit, got {len(labels)}")
    found = _orbits.passes(orbits, p_e, start_s, end_s, mask_rad=mask_rad, carrier_hz=carrier_hz)
    figure = _figure(11.5, 5.6)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.25))
    sky = figure.add_subplot(grid[:, 0], projection="polar")
    heights, dopplers = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    dates: Any = None if reference is None else require("matplotlib.dates", "plot", "drawing")
    zero_day = 0.0 if reference is None else float(dates.date2num(_orbits.utc(reference)))
    scale = 1.0 if end_s - start_s <= 300.0 else 60.0
    clock = "UTC" if dates is not None else ("time [s]" if scale == 1.0 else "time [min]")

    def axis_of(t_s: Array) -> Array:
        return zero_day + t_s / 86400.0 if dates is not None else t_s / scale

    _prepare_sky(sky, mask_rad)
    _style(heights, "Elevation", "", "elevation [deg]")
    _style(dopplers, f"Doppler at {carrier_hz / 1e6:.6g} MHz", clock, "Doppler [kHz]")
    if not found:
        heights.text(0.5, 0.5, "no pass", ha="center", va="center", color=_INK, transform=heights.transAxes)
    beside: list[tuple[float, float]] = []
    above: list[tuple[float, float]] = []
    order = {index: k for k, index in enumerate(dict.fromkeys(one.index for one in found))}
    for one in found:
        colour = _COLOURS[order[one.index] % len(_COLOURS)]
        times = np.linspace(one.rise_s, one.set_s, max(2, int(_STEPS * (one.set_s - one.rise_s) / (end_s - start_s))))
        azimuth, elevation, _ = (row[0] for row in _orbits.elevations([orbits[one.index]], times, p_e))
        doppler_khz = -1e-3 * carrier_hz * signal_path(orbits[one.index], times, p_e).delay_rate
        axis = axis_of(times)
        sky.plot(azimuth, 90.0 - np.degrees(elevation), color=colour, linewidth=1.6)
        _arrow(sky, azimuth, 90.0 - np.degrees(elevation), colour)
        heights.plot(axis, np.degrees(elevation), color=colour, linewidth=1.4)
        dopplers.plot(axis, doppler_khz, color=colour, linewidth=1.4)
        top = int(np.argmax(elevation))
        share = (times[top] - start_s) / (end_s - start_s)
        height = float(np.degrees(elevation[top]))
        if 0.02 < share < 0.98 and _is_free(beside, (9.0 * share, height / 9.0), 0.75):
            heights.annotate(
                labels[one.index],
                (axis[top], height),
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color=colour,
            )
        radius = 90.0 - height
        there = radius * float(np.sin(azimuth[top])), radius * float(np.cos(azimuth[top]))
        if _is_free(above, (there[0] / 10.0, there[1] / 5.0), 1.6):
            sky.annotate(
                labels[one.index],
                (float(azimuth[top]), radius),
                ha="center",
                va="center",
                fontsize=7,
                color=colour,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
            )
    for axes in (heights, dopplers):
        axes.set_xlim(*axis_of(np.array([start_s, end_s])))
        if dates is not None:
            locator = dates.AutoDateLocator(maxticks=8)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    heights.set_ylim(np.degrees(mask_rad), 95.0)
    heights.tick_params(labelbottom=False)
    dopplers.axhline(0.0, color=_PALE, linewidth=1.0, zorder=0)
    return _save(figure, path)


def _prepare_sky(axes: Axes, mask_rad: float) -> None:
    """North up, east to the right as on a map, the zenith in the middle."""
    axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
    axes.set_theta_direction(-1)  # type: ignore[attr-defined]
    axes.set_ylim(0.0, 90.0)
    axes.set_yticks([30.0, 60.0, 90.0], ["60°", "30°", "0°"], fontsize=7, color=_INK)
    axes.set_xticks(np.radians([0.0, 90.0, 180.0, 270.0]), ["N", "E", "S", "W"], fontsize=9, color=_INK)
    axes.grid(True, color=_PALE, linewidth=0.6)
    axes.set_rlabel_position(225.0)  # type: ignore[attr-defined]
    axes.set_title("Sky", loc="left", fontsize=10.5, fontweight="bold", color=_INK, pad=2.0, y=0.97)
    if mask_rad > 0.0:
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        axes.plot(turn, np.full(181, 90.0 - np.degrees(mask_rad)), color=_INK, linewidth=0.8, linestyle=":")


def _is_free(taken: list[tuple[float, float]], place: tuple[float, float], distance: float) -> bool:
    """Whether a name has room, which is then taken: a name that has none is left out, its colour remains."""
    if any(np.hypot(place[0] - x, place[1] - y) < distance for x, y in taken):
        return False
    taken.append(place)
    return True


def _arrow(axes: Axes, azimuth: Array, radius: Array, colour: str) -> None:
    """Which way the satellite goes, near the end of its pass."""
    if len(azimuth) < 3:
        return
    axes.annotate(
        "",
        (azimuth[-1], radius[-1]),
        xytext=(azimuth[-2], radius[-2]),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0.0, "shrinkB": 0.0},
    )
