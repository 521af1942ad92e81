"""What all figures share: canvas, colours, axes."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._extras import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#1b6ca8", "#d1495b", "#2e933c", "#8f5db7", "#e08e1b", "#00798c", "#7a5c45", "#5c677d")
_INK, _PALE = "#22303c", "#c5ced6"


def _figure(width_in: float, height_in: float) -> Figure:
    figure_module = require("matplotlib.figure", "plot", "drawing")
    agg = require("matplotlib.backends.backend_agg", "plot", "drawing")
    figure = figure_module.Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    agg.FigureCanvasAgg(figure)
    return figure  # type: ignore[no-any-return]


def _style(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=10.5, fontweight="bold", color=_INK)
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8, colors=_INK)
    axes.grid(True, color=_PALE, linewidth=0.5, alpha=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _save(figure: Figure, path: str | os.PathLike[str] | None) -> Figure:
    if path is not None:
        figure.savefig(os.fspath(path), dpi=150)
    return figure


def ellipse_points(ellipse: estimation.ErrorEllipse) -> npt.NDArray[np.float64]:
    """The curve about the origin, shape (n, 2)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    major, minor = ellipse.semi_major_m * np.cos(turn), ellipse.semi_minor_m * np.sin(turn)
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    return np.stack([c * major - s * minor, s * major + c * minor], axis=1)
