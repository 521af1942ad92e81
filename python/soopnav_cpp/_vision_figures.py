"""Figures of a camera's ego-motion: tracks on frames, increments, the walk."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _save, _style, ellipse_points
from soopnav_cpp._extras import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FrameTracks", "draw_tracks", "ground_track", "increments", "save_picture"]

Array = npt.NDArray[np.float64]
Path = str | os.PathLike[str]
_AGREE, _APART = (60, 220, 90), (240, 70, 70)
_MOST_ELLIPSES = 12
_LABEL_PX = 15  # height of the letters in a frame


@dataclass(frozen=True, eq=False)
class FrameTracks:
    """Tracks between the previous frame and this one.

    Attributes
    ----------
    previous_px, present_px : ndarray, shape (n, 2)
    agree : ndarray of bool, shape (n,)
        Whether the motion is fitted with them.
    """

    previous_px: Array
    present_px: Array
    agree: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, ego: Any) -> FrameTracks:
        """Those of the last step of an `EgoMotion`; corners found on this frame are left out."""
        tracks, agree = ego.tracks, np.asarray(ego.inliers, dtype=np.bool_)
        old = tracks.age > 0
        return cls(tracks.pixel_previous[old], tracks.pixel[old], agree[old])


def draw_tracks(
    image: npt.NDArray[np.uint8], tracks: FrameTracks, *, label: str = "", width: int | None = None
) -> npt.NDArray[np.uint8]:
    """A frame with the tracks that led to it: a line from where each came from, a dot where it is.

    Parameters
    ----------
    image : ndarray, shape (h, w), uint8
    tracks : FrameTracks
    label : str
        Written into the lower left corner.
    width : int, optional
        Wider frames are made smaller.

    Returns
    -------
    ndarray, shape (h', w', 3), uint8
        RGB, sides even. Tracks that agree are green, others red.
    """
    pillow = require("PIL.Image", "vision", "drawing on frames")
    drawing = require("PIL.ImageDraw", "vision", "drawing on frames")
    fonts = require("PIL.ImageFont", "vision", "drawing on frames")
    grey = np.asarray(image)
    scale = 1.0 if width is None else min(1.0, width / grey.shape[1])
    size = (2 * round(0.5 * scale * grey.shape[1]), 2 * round(0.5 * scale * grey.shape[0]))
    picture = pillow.fromarray(grey).resize(size).convert("RGB")
    pen = drawing.Draw(picture)
    for agree in (False, True):
        colour = _AGREE if agree else _APART
        chosen = tracks.agree == agree
        for (u0, v0), (u, v) in zip(scale * tracks.previous_px[chosen], scale * tracks.present_px[chosen], strict=True):
            pen.line([(u0, v0), (u, v)], fill=colour, width=1)
            pen.ellipse([u - 2.2, v - 2.2, u + 2.2, v + 2.2], fill=colour)
    if label:
        font = fonts.load_default(_LABEL_PX)
        _, _, right, bottom = pen.textbbox((0, 0), label, font=font)
        pen.rectangle([0, size[1] - bottom - 6, right + 10, size[1]], fill=(20, 24, 30))
        pen.text((5, size[1] - bottom - 3), label, fill=(240, 240, 240), font=font)
    return np.asarray(picture, dtype=np.uint8)


def save_picture(image: npt.NDArray[np.uint8], path: Path) -> None:
    """Write pixels, shape (h, w) or (h, w, 3), as the file's ending says."""
    require("PIL.Image", "vision", "writing pictures").fromarray(image).save(os.fspath(path))


def ground_track(walk: Any, *, truth: npt.ArrayLike | None = None, path: Path | None = None) -> Figure:
    """Where the camera went, seen from above.

    Parameters
    ----------
    walk : has pose (n, 3) and covariance (n, 3, 3)
    truth : array_like, shape (n, 3) or (n, 2), optional
    path : path, optional

    Returns
    -------
    Figure
    """
    figure = _figure(6.4, 5.6)
    axes = figure.add_subplot()
    pose, covariance = walk.pose, walk.covariance
    if truth is not None:
        right = np.asarray(truth, dtype=np.float64)
        axes.plot(right[:, 0], right[:, 1], color=_INK, linewidth=2.6, alpha=0.35, label="truth")
    axes.plot(pose[:, 0], pose[:, 1], color=_COLOURS[0], linewidth=1.3, label="from the camera")
    axes.plot(*pose[0, :2], "o", color=_COLOURS[2], markersize=6, label="start")
    axes.plot(*pose[-1, :2], "s", color=_COLOURS[1], markersize=5.5, label="end")
    span = float(np.ptp(pose[:, :2], axis=0).max()) or 1.0
    for k in np.unique(np.linspace(1, len(pose) - 1, _MOST_ELLIPSES).round().astype(int)) if len(pose) > 1 else ():
        part = 0.5 * (covariance[k, :2, :2] + covariance[k, :2, :2].T)
        if np.linalg.eigvalsh(part)[0] > (1e-4 * span) ** 2:
            ring = pose[k, :2] + ellipse_points(estimation.error_ellipse(part, probability=0.95))
            axes.plot(ring[:, 0], ring[:, 1], color=_COLOURS[0], linewidth=0.7, alpha=0.6)
    axes.set_aspect("equal", adjustable="datalim")
    _style(axes, "The walk, with 95 % ellipses where they can be seen", "x [m]", "y [m]")
    axes.legend(fontsize=8, frameon=False)
    return _save(figure, path)


def increments(
    t_s: npt.ArrayLike, motions: Sequence[Any], *, errors: npt.ArrayLike | None = None, path: Path | None = None
) -> Figure:
    """Increments over time with 3σ, or their errors where these are known; below, how many tracks agree.

    Parameters
    ----------
    t_s : array_like, shape (n,)
    motions : sequence of PlanarMotion
    errors : array_like, shape (n, 3), optional
        NaN where there is none.
    path : path, optional

    Returns
    -------
    Figure
    """
    time = np.asarray(t_s, dtype=np.float64)
    good = np.array([motion.ok for motion in motions], dtype=np.bool_)
    values = np.array([motion.increment for motion in motions], dtype=np.float64).reshape(-1, 3)
    sigma = np.sqrt(np.maximum(np.array([np.diagonal(motion.covariance) for motion in motions]).reshape(-1, 3), 0.0))
    values[~good], sigma[~good] = np.nan, np.nan
    shown = values if errors is None else np.asarray(errors, dtype=np.float64)
    figure = _figure(8.6, 7.2)
    panels = figure.subplots(4, 1, sharex=True)
    units = ((1e3, "right [mm]"), (1e3, "up [mm]"), (math.degrees(1.0), "turn [deg]"))
    for i, (axes, (scale, name)) in enumerate(zip(panels, units, strict=False)):
        middle = 0.0 if errors is not None else scale * shown[:, i]
        axes.fill_between(
            time, middle - 3.0 * scale * sigma[:, i], middle + 3.0 * scale * sigma[:, i],
            color=_COLOURS[0], alpha=0.22, linewidth=0.0, label="3σ stated",
        )  # fmt: skip
        axes.plot(time, scale * shown[:, i], color=_COLOURS[1 if errors is not None else 0], linewidth=0.9)
        what = "Errors of the increments" if errors is not None else "Increments, in axes of the previous body"
        _style(axes, what if i == 0 else "", "", name)
        if i == 0:
            axes.legend(fontsize=8, frameon=False, loc="upper right")
    used = np.array([motion.used for motion in motions])
    inliers = np.array([motion.inliers for motion in motions])
    axes = panels[3]
    axes.fill_between(time, used, color=_PALE, step="mid", label="on the ground")
    axes.plot(time, inliers, color=_COLOURS[2], linewidth=1.0, label="agree with the motion")
    if not good[1:].all():
        axes.plot(time[1:][~good[1:]], np.zeros(int((~good[1:]).sum())), "x", color=_COLOURS[1], label="no increment")
    axes.set_ylim(bottom=-0.04 * max(1, int(used.max(initial=1))))
    _style(axes, "", "time [s]", "tracks")
    axes.legend(fontsize=8, framealpha=0.9, edgecolor="none", loc="lower right", ncols=3)
    return _save(figure, path)
