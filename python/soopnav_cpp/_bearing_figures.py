"""Figures of directions: spatial spectra round the array, and bearings over time.

Azimuths are those of an array, from its forward axis towards its left; arguments are radians, what is drawn is degrees.
"""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _save, _style
from soopnav_cpp._run_figures import _title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["bearings_over_time", "polar_spectrum"]

Array = npt.NDArray[np.float64]
Path = str | os.PathLike[str]
_FLOOR_DB = -30.0
_MOST_SIGMA_DEG = 60.0  # whose bar is drawn
_TRUTH = "#111111"


def _vector(name: str, values: npt.ArrayLike) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"{name}: expected shape (n,), got {array.shape}")
    return array


def polar_spectrum(
    azimuth_rad: npt.ArrayLike,
    spectrum: npt.ArrayLike,
    *,
    elevation_rad: npt.ArrayLike | None = None,
    bearings_rad: npt.ArrayLike | None = None,
    floor_db: float = _FLOOR_DB,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw a spatial spectrum around the array: forward is up, left is left.

    Parameters
    ----------
    azimuth_rad : array_like, shape (A,)
    spectrum : array_like, shape (A,) or (E, A)
        Power; drawn in decibels below its largest value. With elevations it is a map of the sky as seen from below,
        the zenith in the middle; without them a curve, with its mirror image (dashed) where azimuths do
        not go all round.
    elevation_rad : array_like, shape (E,), optional
        Rows of `spectrum`.
    bearings_rad : array_like, shape (K,) or (K, 2), optional
        Directions that were found: azimuths, or azimuths and elevations.
    floor_db : float
        What is further below the largest value is drawn there.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For shapes that do not fit, and a spectrum without a value above zero.
    """
    azimuth = _vector("azimuth_rad", azimuth_rad)
    power = np.asarray(spectrum, dtype=np.float64)
    elevation = None if elevation_rad is None else _vector("elevation_rad", elevation_rad)
    wanted = azimuth.shape if elevation is None else (elevation.size, azimuth.size)
    if power.shape != wanted:
        raise ValueError(f"spectrum: expected shape {wanted}, got {power.shape}")
    if not floor_db < 0.0:
        raise ValueError(f"floor_db = {floor_db:g}: less than 0 expected")
    top = float(np.nanmax(power, initial=0.0))
    if not (top > 0.0 and math.isfinite(top)):
        raise ValueError(f"spectrum: a largest value above 0 expected, got {top:g}")
    level = 10.0 * np.log10(np.maximum(np.nan_to_num(power) / top, 10.0 ** (floor_db / 10.0)))
    found = np.zeros((0, 2))
    if bearings_rad is not None:
        given = np.asarray(bearings_rad, dtype=np.float64)
        given = given[:, None] if given.ndim == 1 else given
        if given.ndim != 2 or given.shape[1] not in (1, 2):
            raise ValueError(f"bearings_rad: expected shape (K,) or (K, 2), got {given.shape}")
        found = np.column_stack([given[:, 0], given[:, 1] if given.shape[1] == 2 else np.zeros(len(given))])
    figure = _figure(6.6, 6.6)
    _title(figure, title)
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    order = np.argsort(azimuth)
    step = float(np.median(np.diff(azimuth[order]))) if azimuth.size > 1 else 2.0 * np.pi
    whole = azimuth[order[0]] + 2.0 * np.pi - azimuth[order[-1]] < 1.5 * step  # the grid goes all round
    if whole:
        order = np.append(order, order[0])
    closed = azimuth[order] + np.append(np.zeros(order.size - 1), 2.0 * np.pi if whole else 0.0)
    if elevation is None:
        curve = level[order]
        axes.plot(closed, curve, color=_COLOURS[0], linewidth=1.4)
        if whole:
            axes.fill(closed, curve, color=_COLOURS[0], alpha=0.12)
        else:  # of a line of elements: the other side looks the same
            axes.plot(-closed, curve, color=_COLOURS[0], linewidth=1.0, linestyle=(0, (2, 2)))
        axes.set_rlim(floor_db, 2.0)
        axes.set_rticks([floor_db * k / 3.0 for k in (2, 1, 0)])
        axes.set_rlabel_position(22.5)
        for azimuth_k in found[:, 0]:
            axes.plot([azimuth_k, azimuth_k], [floor_db, 2.0], color=_COLOURS[1], linewidth=1.2, linestyle=(0, (4, 2)))
        note = "decibels below the highest"
    else:
        rows = np.argsort(elevation)
        sheet = level[:, order][rows]
        image = axes.pcolormesh(
            closed, 90.0 - np.degrees(elevation[rows]), sheet, cmap="viridis", shading="gouraud", rasterized=True
        )
        outer = 90.0 - math.degrees(float(elevation.min()))
        axes.set_rlim(0.0, outer)
        ticks = [r for r in (30.0, 60.0, 90.0) if r <= outer]
        axes.set_rticks(ticks, [f"{90.0 - r:.0f}°" for r in ticks])
        axes.set_rlabel_position(22.5)
        axes.tick_params(axis="y", colors="white")
        bar = figure.colorbar(image, ax=axes, shrink=0.62, pad=0.09)
        bar.set_label("decibels below the highest", fontsize=9)
        bar.ax.tick_params(labelsize=8)
        bar.outline.set_visible(False)
        axes.scatter(
            found[:, 0],
            90.0 - np.degrees(found[:, 1]),
            s=130,
            facecolors="none",
            edgecolors=_COLOURS[1],
            linewidths=2.0,
        )
        note = "rings: elevation"
    degrees = np.arange(0, 360, 45)
    names = ["forward", "45°", "left", "135°", "back", "−135°", "right", "−45°"]
    axes.set_thetagrids(degrees, names)
    axes.tick_params(axis="x", labelsize=9, colors=_INK)
    axes.tick_params(axis="y", labelsize=8)
    axes.grid(True, color=_PALE, linewidth=0.5, alpha=0.7)
    if len(found):
        words = [f"{math.degrees(a):+.1f}°".replace("-", "−") for a in found[:, 0]]
        if elevation is not None:
            words = [f"{a} / {math.degrees(e):.1f}°" for a, e in zip(words, found[:, 1], strict=True)]
        note += f"; found at {', '.join(words)}"
    figure.text(0.01, 0.012, note, fontsize=8.5, color=_INK, ha="left")
    return _save(figure, path)


def bearings_over_time(
    t_s: npt.ArrayLike,
    azimuth_rad: npt.ArrayLike,
    *,
    sigma_rad: npt.ArrayLike | None = None,
    elevation_rad: npt.ArrayLike | None = None,
    sigma_elevation_rad: npt.ArrayLike | None = None,
    snr_db: npt.ArrayLike | None = None,
    source: npt.ArrayLike | None = None,
    truth_rad: npt.ArrayLike | None = None,
    title: str = "",
    path: Path | None = None,
) -> Figure:
    """Draw bearings over time with what is said of their errors; elevations and the SNR below, where they are given.

    Parameters
    ----------
    t_s, azimuth_rad : array_like, shape (n,)
        NaN where there is none.
    sigma_rad, elevation_rad, sigma_elevation_rad, snr_db, truth_rad : array_like, shape (n,), optional
    source : array_like of int, shape (n,), optional
        Whose bearing it is: colours them.
    title : str
    path : path, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    time, azimuth = _vector("t_s", t_s), _vector("azimuth_rad", azimuth_rad)
    if azimuth.size != time.size:
        raise ValueError(f"azimuth_rad: expected {time.size} values, got {azimuth.size}")
    who = np.zeros(time.size, np.int64) if source is None else np.asarray(source, dtype=np.int64)
    sigma_deg = None if sigma_rad is None else np.degrees(_vector("sigma_rad", sigma_rad))
    right_deg = None if truth_rad is None else np.degrees(_vector("truth_rad", truth_rad))
    rows: list[tuple[str, Array, Array | None, Array | None]] = [
        ("azimuth [deg]", np.degrees(azimuth), sigma_deg, right_deg)
    ]
    if elevation_rad is not None:
        sigma = None if sigma_elevation_rad is None else np.degrees(_vector("sigma_elevation_rad", sigma_elevation_rad))
        rows.append(("elevation [deg]", np.degrees(_vector("elevation_rad", elevation_rad)), sigma, None))
    if snr_db is not None:
        rows.append(("SNR [dB]", _vector("snr_db", snr_db), None, None))
    figure = _figure(9.0, 1.2 + 2.2 * len(rows))
    _title(figure, title)
    first = None
    for k, (name, value, sigma, right) in enumerate(rows):
        axes = figure.add_subplot(len(rows), 1, k + 1, sharex=first)
        first = first or axes
        for number in np.unique(who):
            mine = who == number
            colour = _COLOURS[int(number) % len(_COLOURS)]
            if sigma is not None:
                known = mine & (sigma < _MOST_SIGMA_DEG)
                axes.errorbar(
                    time[known], value[known], yerr=sigma[known], fmt="none", ecolor=colour, elinewidth=0.8, alpha=0.35
                )
            axes.plot(time[mine], value[mine], "o", color=colour, markersize=2.6)
        if right is not None:
            axes.plot(time, _without_jumps(right), color=_TRUTH, linewidth=0.9, label="truth")
            axes.legend(fontsize=8, frameon=False, loc="upper right")
        _style(axes, "", "time [s]" if k == len(rows) - 1 else "", name)
        axes.tick_params(labelbottom=k == len(rows) - 1)
        axes.margins(x=0.01)
        if k == 0:
            low, high = np.nanmin(value, initial=180.0), np.nanmax(value, initial=-180.0)
            if high - low > 300.0:
                axes.set_ylim(-185.0, 185.0)
                axes.set_yticks(range(-180, 181, 90))
    return _save(figure, path)


def _without_jumps(degrees: Array) -> Array:
    """With NaN where a line would cross from one end of the circle to the other."""
    found = np.array(degrees, dtype=np.float64)
    found[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return found
