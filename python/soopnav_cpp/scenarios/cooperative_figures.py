"""Figures of ``cooperative`` runs: clock and position found over time, the measurements' errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.scenarios.cooperative import CooperativeScenario, PairRun

__all__ = ["clock_and_position", "figures", "measurement_errors"]


def clock_and_position(run: PairRun) -> Figure:
    """Clock offset and skew against the truth, and the horizontal error with what is stated of it (mei 17-18)."""
    assert run.truth is not None
    assert run.state is not None
    assert run.covariance is not None
    assert run.truth.state is not None
    figure = _figure(8.6, 7.2)
    panels = figure.subplots(3, 1, sharex=True)
    for axes, index, scale, label in (
        (panels[0], 6, 1e9 / 299_792_458.0, "offset error [ns]"),
        (panels[1], 7, 1e9 / 299_792_458.0, "skew error [1e-9]"),
    ):
        error = scale * (run.state[:, index] - run.truth.state[:, index])
        sigma = scale * np.sqrt(run.covariance[:, index, index])
        axes.fill_between(run.t_s, -2.0 * sigma, 2.0 * sigma, color=_COLOURS[0], alpha=0.18, linewidth=0.0,
                          label="2 sigma as stated")  # fmt: skip
        axes.plot(run.t_s, error, color=_COLOURS[0], linewidth=1.1, label="estimate less truth")
        axes.axhline(0.0, color=_INK, linewidth=0.8)
        _style(axes, "Target's clock against the anchor's" if index == 6 else "", "", label)
    panels[0].legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
    error = np.linalg.norm((run.position_m - run.truth.position_m)[:, :2], axis=1)
    stated = np.sqrt(np.trace(run.position_covariance_m2[:, :2, :2], axis1=1, axis2=2))
    panels[2].semilogy(run.t_s, np.maximum(error, 1e-2), color=_COLOURS[1], linewidth=1.2, label="horizontal error")
    panels[2].semilogy(run.t_s, stated, "--", color=_INK, linewidth=1.0, label="stated (root of the trace)")
    for formatter in (panels[2].yaxis.set_major_formatter, panels[2].yaxis.set_minor_formatter):
        formatter("{x:g}")
    panels[2].tick_params(axis="y", which="both", labelsize=8)
    _style(panels[2], "Target's position", "time [s]", "error [m]")
    panels[2].legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
    return figure


def measurement_errors(run: PairRun) -> Figure:
    """Errors of TDOA and FDOA over their stated sigma, beside the normal law (mei slide 14)."""
    campaign = run.campaign
    figure = _figure(8.6, 3.4)
    panels = figure.subplots(1, 2)
    sigma = np.sqrt(np.diagonal(campaign.covariance, axis1=1, axis2=2))
    for axes, error, stated, unit, title in (
        (panels[0], 1e6 * campaign.tdoa_error_s, 1e6 * sigma[:, 0], "µs", "TDOA"),
        (panels[1], campaign.fdoa_error_hz, sigma[:, 1], "Hz", "FDOA"),
    ):
        spread = float(np.median(stated))
        edges = np.linspace(-4.0 * spread, 4.0 * spread, 33)
        axes.hist(
            error, edges, color=_COLOURS[0], alpha=0.75, label=f"{len(error)} bursts, rms {np.std(error):.3g} {unit}"
        )
        x = np.linspace(edges[0], edges[-1], 200)
        density = np.mean(
            np.exp(-0.5 * (x / stated[:, None]) ** 2) / (stated[:, None] * math.sqrt(2.0 * math.pi)), axis=0
        )
        axes.plot(x, len(error) * (edges[1] - edges[0]) * density, color=_INK, linewidth=1.4,
                  label=f"as stated, sigma {spread:.3g} {unit}")  # fmt: skip
        axes.set_ylim(0.0, 1.35 * axes.get_ylim()[1])
        _style(axes, f"{title}: measured less true", f"error [{unit}]", "bursts")
        axes.legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def figures(scenario: CooperativeScenario, run: PairRun) -> dict[str, Figure]:
    """Both."""
    del scenario
    return {"clock_and_position": clock_and_position(run), "measurements": measurement_errors(run)}
