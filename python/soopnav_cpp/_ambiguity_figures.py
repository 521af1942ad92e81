"""Figures of the ambiguity function."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from soopnav_cpp._ambiguity import Surface
from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _save, _style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ambiguity"]


def ambiguity(
    surface: Surface,
    *,
    tdoa_s: float | None = None,
    fdoa_hz: float | None = None,
    title: str = "Cross-ambiguity",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the ambiguity function with both cuts through its peak.

    Parameters
    ----------
    surface : dsp.Surface
    tdoa_s, fdoa_hz : float, optional
        Where the cuts go and what they are labelled with; those of `surface.result` by default.
    title : str
    path : path-like, optional
        PNG to write.

    Returns
    -------
    matplotlib.figure.Figure
    """
    result = surface.result
    tdoa_s = result.tdoa_s if tdoa_s is None else tdoa_s
    fdoa_hz = result.fdoa_hz if fdoa_hz is None else fdoa_hz
    big = max(abs(surface.delays_s[0]), abs(surface.delays_s[-1]))
    scale, unit = (1e3, "ms") if big >= 1e-3 else (1e6, "µs")
    row = int(np.argmin(np.abs(surface.delays_s - tdoa_s)))
    column = int(np.argmin(np.abs(surface.doppler_hz - fdoa_hz)))
    figure = _figure(10.4, 4.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    _style(axes, title, "FDOA [Hz]", f"TDOA [{unit}]")
    axes.grid(False)
    image = axes.pcolormesh(
        surface.doppler_hz, scale * surface.delays_s, surface.power, shading="auto", cmap="viridis", rasterized=True
    )
    axes.axhline(scale * tdoa_s, color="white", linewidth=0.6, alpha=0.7)
    axes.axvline(fdoa_hz, color="white", linewidth=0.6, alpha=0.7)
    figure.colorbar(image, ax=axes, label="|C|² / (⟨a, a⟩⟨b, b⟩)")
    cuts = [figure.add_subplot(grid[i, 1]) for i in range(2)]
    _style(cuts[0], f"cut at FDOA {fdoa_hz:.2f} Hz", f"TDOA [{unit}]", "|C|²")
    cuts[0].plot(scale * surface.delays_s, surface.power[:, column], color=_COLOURS[0])
    _style(cuts[1], f"cut at TDOA {scale * tdoa_s:.4f} {unit}", "FDOA [Hz]", "|C|²")
    cuts[1].plot(surface.doppler_hz, surface.power[row], color=_COLOURS[0])
    for cut, at in zip(cuts, (scale * tdoa_s, fdoa_hz), strict=True):
        cut.axvline(at, color=_INK, linewidth=0.7, linestyle=":")
        cut.set_ylim(bottom=0.0)
    return _save(figure, path)
