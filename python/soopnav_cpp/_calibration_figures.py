"""The figure of a calibration: ellipses and carriers, before and after (carter figs. 5.5 and 5.6)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _save, _style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Samples = npt.NDArray[np.complex64]

_DOTS = 1500  # of a channel
_TURNS = 2.0  # of the tone


def calibration(
    iq: _Samples,
    found: Any,
    *,
    title: str = "",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw what a calibration does: I and Q of each channel, and the tone over time, before and after.

    Parameters
    ----------
    iq : ndarray, shape (M, n), complex64
        Of the tone, as recorded.
    found : soopnav_cpp.array.Calibration
    title : str
    path : path, optional
        Written as well, in the format of its suffix.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(10.4, 8.2)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
    draw_calibration(figure, iq, found)
    return _save(figure, path)


def draw_calibration(figure: Figure, iq: _Samples, found: Any) -> None:
    """The four panels of `calibration`."""
    corrected = found.apply(iq)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0))
    reach = 1.08 * max(float(np.abs(part.view(np.float32)).max()) for part in (iq, corrected))
    for column, (samples, word) in enumerate(((iq, "before"), (corrected, "after"))):
        _draw_circles(figure.add_subplot(grid[0, column]), samples, f"I and Q {word}", reach)
        _draw_carriers(figure.add_subplot(grid[1, column]), samples, found, f"Real part {word}", reach)
    figure.axes[0].legend(fontsize=8, frameon=False, loc="center", markerscale=4.0, handletextpad=0.1)


def _draw_circles(axes: Axes, samples: _Samples, title: str, reach: float) -> None:
    _style(axes, title, "I", "Q")
    step = max(1, samples.shape[1] // _DOTS)
    for m, row in enumerate(samples):
        dots = row[::step]
        axes.plot(
            dots.real,
            dots.imag,
            ".",
            color=_COLOURS[m % len(_COLOURS)],
            markersize=2.0,
            alpha=0.6,
            label=f"channel {m}",
        )
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")


def _draw_carriers(axes: Axes, samples: _Samples, found: Any, title: str, reach: float) -> None:
    _style(axes, title, "time [µs]", "I")
    count = int(np.clip(_TURNS * found.sample_rate_hz / abs(found.tone_hz), 16, samples.shape[1]))
    time_us = 1e6 * np.arange(count) / found.sample_rate_hz
    for m, row in enumerate(samples):
        axes.plot(time_us, row[:count].real, color=_COLOURS[m % len(_COLOURS)], linewidth=1.1)
    axes.set_ylim(-reach, reach)
    axes.margins(x=0.0)
