"""Figures of ``source_localization`` runs: bearings on the map and over the distance, positions by method."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import navigation, plotting
from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _style
from soopnav_cpp.scenarios.emitters import has_position

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.scenarios.source_localization import EmitterRun, SourceLocalizationScenario
    from soopnav_cpp.scenarios.source_localization_pipeline import Heard

__all__ = ["figures", "over_distance", "share_of_bins"]

Array = npt.NDArray[np.float64]
_BINS = 8


def share_of_bins(range_m: Array, error_rad: Array, sigma_rad: Array, bins: int = _BINS) -> Array:
    """Bearings in bins of distance, as many in each: middle distance, RMS error, RMS of what was stated, (b, 3)."""
    order = np.argsort(range_m)
    rows = []
    for part in np.array_split(order, min(bins, len(order))):
        if len(part):
            rows.append(
                [
                    float(np.median(range_m[part])),
                    float(np.sqrt(np.mean(np.square(error_rad[part])))),
                    float(np.sqrt(np.mean(np.square(sigma_rad[part])))),
                ]
            )
    return np.array(rows)


def over_distance(heard: Heard) -> Figure:
    """Errors of bearings over the distance of the emitter, with what is stated of them (carter fig. 5.13)."""
    data = heard.data
    figure = _figure(8.6, 4.4)
    axes = figure.add_subplot()
    away = np.maximum(np.abs(np.degrees(heard.error_rad)), 1e-3)
    axes.semilogy(heard.range_m, away, ".", color=_COLOURS[7], markersize=3.5, alpha=0.6, label="errors")
    stated2 = np.square(data.sigma_rad)
    if data.heading_sigma_rad is not None:
        stated2 = stated2 + np.square(data.heading_sigma_rad)
    if data.position_sigma_m is not None:
        stated2 = stated2 + np.square(data.position_sigma_m / np.maximum(heard.range_m, 1.0))
    rows = share_of_bins(heard.range_m, heard.error_rad, np.sqrt(stated2))
    axes.semilogy(rows[:, 0], np.degrees(rows[:, 1]), "o-", color=_COLOURS[1], label="RMS error")
    axes.semilogy(rows[:, 0], np.degrees(rows[:, 2]), "s--", color=_COLOURS[0], markersize=4.5, label="RMS stated")
    for distance, error, stated in rows:
        axes.annotate(
            f"{error / stated:.2f}", (distance, math.degrees(max(error, stated))), xytext=(0, 7), ha="center",
            textcoords="offset points", fontsize=8, color=_INK,
        )  # fmt: skip
    axes.set_ylim(bottom=max(0.02, float(np.percentile(away, 2))))
    axes.yaxis.set_major_formatter("{x:g}")
    _style(
        axes, "Bearings over the distance; numbers: RMS error / stated", "distance of the emitter [m]", "bearing [deg]"
    )
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def _histories(emitter: Any) -> tuple[Array, dict[str, Array], Array]:
    """Times of the main method, distances from the truth by method, and what the main one states."""
    main = emitter.histories[emitter.method]
    right = np.column_stack([np.interp(main.t_s, emitter.data.t_s, column) for column in emitter.data.truth_m.T])
    curves = {}
    for method in (emitter.method, *(name for name in emitter.histories if name != emitter.method)):
        history = emitter.histories[method]
        full = np.full(len(main.t_s), np.nan)
        common, ours, theirs = np.intersect1d(main.t_s, history.t_s, return_indices=True)
        if len(common):
            full[ours] = np.linalg.norm(history.position_m[theirs, :2] - right[ours, :2], axis=1)
        curves[method] = full
    stated = np.sqrt(np.trace(main.covariance_m2[:, :2, :2], axis1=1, axis2=2))
    return main.t_s, curves, stated


def _bound(emitter: Any, time: Array) -> Array:
    """Root of the trace of the Cramér-Rao bound at these times, from what is stated of the bearings."""
    data = emitter.data
    bound = navigation.source_crlb(
        data.position_m[:, :2], emitter.truth_m[:2], data.sigma_rad, times=data.t_s,
        heading_sigma_rad=0.0 if data.heading_sigma_rad is None else data.heading_sigma_rad,
        position_covariance=None
        if data.position_sigma_m is None
        else np.square(data.position_sigma_m)[:, None, None] * np.eye(2),
    )  # fmt: skip
    total = np.trace(bound, axis1=1, axis2=2)
    last = np.searchsorted(data.t_s, time + 1e-9) - 1
    return np.where(np.isfinite(total[last]) & (total[last] > 0.0), np.sqrt(np.abs(total[last])), np.nan)


def figures(scenario: SourceLocalizationScenario, run: EmitterRun) -> dict[str, Figure]:
    """All that there is to see, by caption."""
    heard, data = run.heard, run.heard.data
    found: dict[str, Figure] = {}
    several = len(run.located) > 1
    if several:
        of = {one.name: one.fix for one in run.located if one.found}
        fixes = {name: of.get(name) for name in scenario.emitter_names}  # in the order that `heard.nearest` counts
    else:
        fixes = {name: fix for name, fix in run.located[0].fixes.items() if has_position(fix)}
    moving = any(any(item.velocity_mps) for item in scenario.emitters)
    places = heard.emitters_m if moving else heard.emitters_m[-1:]
    found["Bearings on the map with the positions found"] = plotting.bearings_map(
        data.position_m,
        data.bearing_rad,
        sigmas_rad=data.sigma_rad,
        fixes=fixes,
        source=heard.nearest if several else None,
        truth_m=places[:, 0] if not several else None,
    )
    found["Errors of bearings over the distance, and what was stated of them"] = over_distance(heard)
    for one in run.located:
        name = f" of {one.name}" if several else ""
        if one.method in one.histories and one.data.truth_m is not None:
            time, curves, stated = _histories(one)
            found[f"Distance{name} from the truth over time, by method"] = plotting.source_errors(
                time, curves, sigma_m=stated, bound_m=None if scenario.locator.moving else _bound(one, time)
            )
        if one.surface is not None:
            found[f"Likelihood of places{name} from all bearings"] = plotting.likelihood(
                *one.surface, fix={one.method: one.fix}, truth_m=one.truth_m
            )
        if one.cloud is not None:
            found[f"Particles{name} at the end"] = plotting.particles(
                *one.cloud, fix={"particle": one.fixes["particle"]}, truth_m=one.truth_m
            )
    found["Spatial spectrum of the epoch with the highest SNR, in array axes"] = plotting.polar_spectrum(
        heard.grid_azimuth_rad,
        heard.spectrum,
        elevation_rad=heard.grid_elevation_rad,
        bearings_rad=heard.found_rad,
    )
    return found
