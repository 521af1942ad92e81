"""Figures of results, drawn with matplotlib on its Agg canvas: no window, no global state.

Each function returns the figure, and writes it as well when it is given a path.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp, estimation, lte, simulation
from soopnav_cpp._ambiguity_figures import ambiguity
from soopnav_cpp._bearing_figures import bearings_over_time, polar_spectrum
from soopnav_cpp._burst_figures import burst_spectrogram
from soopnav_cpp._calibration_figures import calibration
from soopnav_cpp._drawing import _COLOURS, _INK, ellipse_points
from soopnav_cpp._drawing import _figure as _figure
from soopnav_cpp._drawing import _save as _save
from soopnav_cpp._drawing import _style as _style
from soopnav_cpp._gps_phase_figures import static_phase
from soopnav_cpp._run_figures import consistency, errors, innovations, rms, state_errors, trajectory
from soopnav_cpp._sky_figures import passes
from soopnav_cpp._source_figures import bearings_map, likelihood, particles, source_errors
from soopnav_cpp._vision_figures import FrameTracks, draw_tracks, ground_track, increments, save_picture
from soopnav_cpp.navigation import PositionFix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "FrameTracks",
    "ambiguity",
    "bearings_map",
    "bearings_over_time",
    "burst_spectrogram",
    "calibration",
    "consistency",
    "draw_tracks",
    "ellipse_points",
    "errors",
    "ground_track",
    "increments",
    "innovations",
    "likelihood",
    "particles",
    "passes",
    "polar_spectrum",
    "position_map",
    "rms",
    "save_picture",
    "scan",
    "source_errors",
    "state_errors",
    "static_phase",
    "trajectory",
]

_BASE_RATE_HZ = 1.92e6
_HALF_FRAME = 9600  # samples at the base rate
_MOST_HALF_FRAMES = 16
_MOST_RESPONSES = 5


# ---- scan


def scan(
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    detections: Sequence[lte.Detection],
    arrivals: Sequence[lte.TimeOfArrival | None],
    *,
    center_frequency_hz: float | None = None,
    title: str = "",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw what a search found: correlation over time, spectrum, impulse responses with their first paths.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    sample_rate_hz : float
    detections : sequence of Detection
        May be empty.
    arrivals : sequence of TimeOfArrival or None
        One for each detection; None where there is none.
    center_frequency_hz : float, optional
        Labels the spectrum with radio frequencies.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = [(d, a) for d, a in zip(detections, arrivals, strict=True) if a is not None][:_MOST_RESPONSES]
    figure = _figure(11.0, 7.6)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.0, 1.25))
    _draw_correlation(figure.add_subplot(grid[0, :]), iq, sample_rate_hz, detections)
    _draw_spectrum(figure.add_subplot(grid[1, 0]), iq, sample_rate_hz, detections, center_frequency_hz)
    rows = grid[1, 1].subgridspec(max(1, len(shown)), 1, hspace=0.05)
    if not shown:
        axes = figure.add_subplot(rows[0])
        axes.text(0.5, 0.5, "no cell", ha="center", va="center", color=_INK, transform=axes.transAxes)
        _style(axes, "Impulse responses", "delay after the first path [µs]", "power [dB]")
        axes.grid(False)
        axes.set_xticks([])
        axes.set_yticks([])
    span = max((p.delay_s for _, a in shown for p in a.paths), default=0.0) * 1e6
    for row, (detection, arrival) in enumerate(shown):
        axes = figure.add_subplot(rows[row])
        last = row == len(shown) - 1
        _style(
            axes,
            "Impulse responses" if row == 0 else "",
            "delay after the first path [µs]" if last else "",
            "power [dB]" if row == len(shown) // 2 else "",
        )
        _draw_response(axes, detection, arrival, _colour(detections, detection))
        axes.set_xlim(-1.5, max(4.0, 1.3 * span))
        axes.set_ylim(-42.0, 4.0 + 5.0 * len(shown))  # room for the line of text
        axes.set_yticks([-40, -20, 0])
        axes.tick_params(labelbottom=last)
    return _save(figure, path)


def _colour(detections: Sequence[lte.Detection], detection: lte.Detection) -> str:
    index = next(i for i, d in enumerate(detections) if d is detection)
    return _COLOURS[index % len(_COLOURS)]


def _pss_offset_samples(detection: lte.Detection) -> int:
    """From the start of a half-frame to its PSS behind the cyclic prefix, at the base rate (TS 36.211 6.11.1.2)."""
    normal = detection.cp is lte.CyclicPrefix.NORMAL
    if detection.duplex is lte.Duplex.FDD:
        return 832
    return 1920 + (138 + 137 + 9 if normal else 2 * 160 + 32)


def _pss_correlation(base: npt.NDArray[np.complex64]) -> npt.NDArray[np.float64]:
    """Share of the power that each of the three PSS explains, mean over half-frames; shape (3, one half-frame)."""
    power = np.concatenate([[0.0], np.cumsum(np.square(np.abs(base), dtype=np.float64))])
    power = np.maximum(power[128:] - power[:-128], 1e-30 + 1e-9 * power[-1] / base.size)
    found = []
    for n_id_2 in range(3):
        spectrum = np.zeros(128, np.complex64)
        spectrum[1:32], spectrum[-31:] = lte.pss(n_id_2)[31:], lte.pss(n_id_2)[:31]
        replica = np.fft.ifft(spectrum)
        replica /= np.linalg.norm(replica)
        share = np.square(np.abs(dsp.correlate(base, replica.astype(np.complex64)))) / power
        folds = min(_MOST_HALF_FRAMES, max(1, share.size // _HALF_FRAME))
        whole = np.zeros(folds * _HALF_FRAME)
        whole[: min(whole.size, share.size)] = share[: whole.size]
        found.append(whole.reshape(folds, _HALF_FRAME).mean(axis=0))
    return np.array(found)


def _draw_correlation(
    axes: Axes, iq: npt.NDArray[np.complex64], sample_rate_hz: float, detections: Sequence[lte.Detection]
) -> None:
    length = math.ceil((_MOST_HALF_FRAMES + 1) * 5e-3 * sample_rate_hz)
    base = np.ascontiguousarray(iq[:length])
    if detections:  # so that the band around the carrier is what is kept
        base = simulation.apply_cfo(base, -detections[0].cfo_hz, sample_rate_hz)
    if sample_rate_hz != _BASE_RATE_HZ:
        base = dsp.resample(base, sample_rate_hz, _BASE_RATE_HZ)
    shares = _pss_correlation(base)
    times_ms = np.arange(_HALF_FRAME) / _BASE_RATE_HZ * 1e3
    for n_id_2, (share, shade) in enumerate(zip(shares, ("#5b7083", "#7fa8c9", "#c9a27f"), strict=True)):
        axes.plot(times_ms, share, linewidth=0.7, color=shade, label=f"N_ID_2 = {n_id_2}")
    top = float(shares.max())
    marks = []
    for index, detection in enumerate(detections):
        start = round(detection.frame_start_s * _BASE_RATE_HZ) + _pss_offset_samples(detection)
        near = (start + np.arange(-4, 5)) % _HALF_FRAME
        height = float(shares[detection.cell_id % 3][near].max())
        marks.append((float(times_ms[start % _HALF_FRAME]), height, f"cell {detection.cell_id}", index))
    below: list[tuple[float, float]] = []  # labels so far: time, height
    for x, height, label, index in sorted(marks, key=lambda mark: mark[1]):
        colour = _COLOURS[index % len(_COLOURS)]
        axes.plot([x], [height], "o", color=colour, markersize=5, markeredgecolor="white", zorder=3)
        # Labels of cells at nearly one time stand above each other.
        y = max([height] + [old + 0.075 * top for when, old in below if abs(when - x) < 0.3])
        below.append((x, y))
        axes.annotate(
            label, (x, y), xytext=(7, -2), textcoords="offset points", fontsize=8.5, color=colour, fontweight="bold",
            zorder=4, bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
        )  # fmt: skip
    axes.set_xlim(0.0, 5.0)
    highest = max([top] + [y for _, y in below])
    axes.set_ylim(0.0, 1.18 * highest if highest > 0.0 else 1.0)
    axes.legend(loc="upper right", fontsize=8, frameon=False, ncols=3)
    folds = min(_MOST_HALF_FRAMES, max(1, base.size // _HALF_FRAME))
    _style(
        axes,
        f"PSS correlation (mean of {folds} half-frames)",
        "time from the capture's first sample, modulo 5 ms [ms]",
        "share of power",
    )


def _draw_spectrum(
    axes: Axes,
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    detections: Sequence[lte.Detection],
    center_frequency_hz: float | None,
) -> None:
    points = 1024
    count = min(2000, iq.size // points)
    starts = np.linspace(0, iq.size - points, count).astype(np.int64)
    window = np.hanning(points).astype(np.float32)
    blocks = iq[starts[:, None] + np.arange(points)] * window
    density = np.square(np.abs(np.fft.fftshift(np.fft.fft(blocks, axis=1), axes=1))).mean(axis=0)
    density /= np.square(window).sum() * sample_rate_hz
    origin = 0.0 if center_frequency_hz is None else center_frequency_hz
    frequencies = (origin + np.fft.fftshift(np.fft.fftfreq(points, 1.0 / sample_rate_hz))) / 1e6
    level = 10.0 * np.log10(np.maximum(density, 1e-30))
    axes.plot(frequencies, level, linewidth=0.9, color=_INK)
    low, high = float(np.percentile(level, 1)), float(level.max())
    bands: dict[tuple[int, float], list[int]] = {}
    for detection in detections:
        if detection.n_rb is not None:
            bands.setdefault((detection.n_rb, round(detection.cfo_hz, -3)), []).append(detection.cell_id)
    for index, ((n_rb, offset), _cells) in enumerate(bands.items()):
        centre, half = (origin + offset) / 1e6, n_rb * 0.18 / 2.0
        left, right = max(centre - half, frequencies[0]), min(centre + half, frequencies[-1])
        axes.axvspan(left, right, color=_COLOURS[index % len(_COLOURS)], alpha=0.10, linewidth=0)
        axes.text((left + right) / 2.0, high + 4.0, f"{n_rb} RB", ha="center", va="center", fontsize=8, color=_INK)
    axes.set_xlim(frequencies[0], frequencies[-1])
    axes.set_ylim(low - 3.0, high + 8.0)
    label = "frequency in baseband [MHz]" if center_frequency_hz is None else "frequency [MHz]"
    axes.ticklabel_format(axis="x", useOffset=False)
    _style(axes, "Spectrum", label, "density [dB full scale / Hz]")


def _draw_response(axes: Axes, detection: lte.Detection, arrival: lte.TimeOfArrival, colour: str) -> None:
    magnitude = np.asarray(arrival.impulse_response, dtype=np.float64)
    if magnitude.size and magnitude.max() > 0.0:
        delays_us = 1e6 * (
            arrival.impulse_response_start_s + arrival.impulse_response_step_s * np.arange(magnitude.size)
        )
        level = 20.0 * np.log10(np.maximum(magnitude / magnitude.max(), 1e-6))
        axes.fill_between(delays_us, level, -60.0, color=colour, alpha=0.18, linewidth=0)
        axes.plot(delays_us, level, color=colour, linewidth=1.1)
    axes.axvline(0.0, color=_INK, linewidth=0.8, linestyle=(0, (4, 3)))
    for index, resolved in enumerate(arrival.paths):
        axes.plot(
            [1e6 * resolved.delay_s],
            [resolved.power_db],
            "o" if index == 0 else "D",
            color=colour,
            markeredgecolor="white",
            markersize=7 if index == 0 else 5,
            zorder=3,
        )
    toa_s, sigma_s = lte.arrival_at(arrival)
    axes.text(
        0.99,
        0.97,
        f"cell {detection.cell_id}   first path {1e3 * toa_s:.6f} ms ± {sigma_s * 299_792_458.0:.2g} m",
        ha="right",
        va="top",
        fontsize=8.5,
        color=colour,
        fontweight="bold",
        transform=axes.transAxes,
    )


# ---- position


def position_map(
    fix: PositionFix,
    nodes_enu_m: npt.ArrayLike,
    labels: Sequence[str],
    *,
    title: str = "",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a position among its nodes, its error ellipse, and what each node's arrival has left over.

    Parameters
    ----------
    fix : PositionFix
        With a position.
    nodes_enu_m : array_like, shape (n, 3)
        In the order in which they were given to the fix.
    labels : sequence of str
        A name for each.
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure
    """
    nodes = np.asarray(nodes_enu_m, dtype=np.float64).reshape(-1, 3)
    here = fix.position_m
    figure = _figure(10.4, 6.6)
    grid = figure.add_gridspec(2, 2, width_ratios=(3.2, 1.0), height_ratios=(1.15, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    _style(axes, title, "east [m]", "north [m]")
    axes.set_aspect("equal", adjustable="datalim")
    used = fix.used
    everything = np.vstack([nodes[:, :2], here[None, :2], fix.alternatives_m[:, :2]])
    low, high = everything.min(axis=0), everything.max(axis=0)
    for node, label, taken in zip(nodes, labels, used, strict=True):
        colour = _COLOURS[0] if taken else _COLOURS[1]
        axes.plot([here[0], node[0]], [here[1], node[1]], color=colour, linewidth=0.8, alpha=0.35, zorder=1)
        axes.plot(
            [node[0]], [node[1]], "^", markersize=11, color=colour if taken else "white",
            markeredgecolor="white" if taken else colour, markeredgewidth=1.0 if taken else 1.8, zorder=3,
        )  # fmt: skip
        axes.annotate(
            (label if taken else f"{label} (rejected)").replace(" (", "\n("),
            (node[0], node[1]),
            xytext=(10, 0) if node[0] > here[0] else (-10, 0),
            ha="left" if node[0] > here[0] else "right",
            va="center",
            textcoords="offset points",
            fontsize=9,
            color=colour,
        )
    for other in fix.alternatives_m:
        axes.plot([other[0]], [other[1]], "x", color=_COLOURS[4], markersize=9, zorder=3)
        axes.annotate("fits as well", (other[0], other[1]), xytext=(8, -12), textcoords="offset points", fontsize=9)
    axes.plot([here[0]], [here[1]], "*", color=_COLOURS[2], markersize=17, markeredgecolor="white", zorder=4)
    axes.annotate(
        "receiver", (here[0], here[1]), xytext=(0, -20), textcoords="offset points", fontsize=9.5, fontweight="bold",
        color=_COLOURS[2], ha="center",
    )  # fmt: skip
    # Unseen corners that leave room around it all, and around a receiver among nodes that are near.
    margin = max(10.0, 0.15 * float((high - low).max())) * np.array([2.2, 1.0])
    axes.plot(*np.stack([low - margin, high + margin], axis=1), linestyle="none")
    axes.margins(0.0)
    _draw_ellipse(figure.add_subplot(grid[0, 1]), axes, fix)
    _draw_residuals(figure.add_subplot(grid[1, 1]), fix, labels)
    return _save(figure, path)


def _draw_ellipse(inset: Axes, axes: Axes, fix: PositionFix) -> None:
    """The error alone in `inset`, and true to scale on the map."""
    covariance = fix.covariance_m2[:2, :2]
    _style(inset, "Error", "east [m]", "north [m]")
    inset.set_aspect("equal", adjustable="datalim")
    if not np.isfinite(covariance).all():
        return
    curves = (
        (estimation.error_ellipse(covariance, probability=0.95), "95 %", 0.15),
        (estimation.error_ellipse(covariance), "1σ", 0.35),
    )
    for ellipse, name, alpha in curves:
        points = ellipse_points(ellipse)
        inset.fill(points[:, 0], points[:, 1], color=_COLOURS[2], alpha=alpha, linewidth=0, label=name)
        inset.plot(points[:, 0], points[:, 1], color=_COLOURS[2], linewidth=1.0)
        axes.plot(fix.position_m[0] + points[:, 0], fix.position_m[1] + points[:, 1], color=_COLOURS[2], linewidth=0.8)
    inset.plot([0.0], [0.0], "*", color=_COLOURS[2], markersize=10, markeredgecolor="white")
    inset.margins(0.15)
    inset.legend(fontsize=7.5, loc="upper right", frameon=False)


def _draw_residuals(axes: Axes, fix: PositionFix, labels: Sequence[str]) -> None:
    """A bar for each node, and the gate within which it has to lie."""
    rows = np.arange(len(labels))
    residuals, gates = fix.residuals_m, fix.gates_m
    colours = [_COLOURS[0] if taken else _COLOURS[1] for taken in fix.used]
    axes.barh(rows, np.nan_to_num(residuals), height=0.55, color=colours)
    for sign in (-1.0, 1.0):
        axes.plot(sign * gates, rows, "|", color=_INK, markersize=11)
    axes.axvline(0.0, color=_INK, linewidth=0.8)
    axes.set_xscale("symlog", linthresh=1.0)
    reach = np.nanmax(np.concatenate([[1.0], np.abs(residuals), gates]))
    axes.set_xlim(-2.0 * reach, 2.0 * reach)
    ticks = [t for t in (-1000.0, -10.0, -1.0, 0.0, 1.0, 10.0, 1000.0) if abs(t) <= 2.0 * reach]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.set_yticks(rows, [label.split(" (")[0] for label in labels])
    axes.invert_yaxis()
    _style(axes, "Residuals ( | gate )", "measured − predicted [m]", "")
