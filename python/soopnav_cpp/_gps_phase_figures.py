"""The figure of a standing antenna by GPS phase: residuals, broadcast errors, clock."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soopnav_cpp import clock
from soopnav_cpp._drawing import _figure, _save, _style
from soopnav_cpp._gps_phase import PhaseUse, StaticPhaseFix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["static_phase"]

_LIGHT_MPS = 299_792_458.0


def static_phase(fix: StaticPhaseFix, *, title: str = "", path: str | Path | None = None) -> Figure:
    """Phase residuals over time, what each satellite's broadcast is off by, and the receiver's clock.

    Parameters
    ----------
    fix : StaticPhaseFix
        Solved.
    title : str
    path : str or Path, optional
        Where to save it.

    Raises
    ------
    ValueError
        For one that is not solved.
    """
    if not fix.ok:
        raise ValueError(f"fix: {fix.message()}")
    figure = _figure(9.6, 6.4)
    (top, errors), (offset, allan) = figure.subplots(2, 2)
    used = np.flatnonzero((fix.use == PhaseUse.USED).any(axis=0))
    residual = 100.0 * fix.phase_residual_m
    for j in used:
        top.plot(fix.t_s, residual[:, j], lw=0.7, label=fix.satellites[j])
    bound = 1.1 * float(np.nanmax(np.abs(residual)))
    top.set_ylim(-bound, 1.5 * bound)
    top.legend(fontsize=6, ncols=6, frameon=False, loc="upper center")
    _style(top, f"Phase residuals, {100.0 * fix.phase_rms_m:.1f} cm rms", "time [s]", "residual [cm]")
    place = np.arange(len(used))
    errors.errorbar(place, fix.range_error_m[used], fix.range_error_sigma_m[used], fmt="o", ms=4, capsize=2)
    errors.axhline(0.0, color="0.5", lw=0.8)
    errors.set_xticks(place, [fix.satellites[j] for j in used], rotation=60, fontsize=8)
    _style(errors, "Error of each satellite's broadcast", "", "range [m], ±1σ")
    seen = np.isfinite(fix.clock_m)
    seconds = fix.clock_m[seen] / _LIGHT_MPS
    slope, start = np.polyfit(fix.t_s[seen], seconds, 1)
    offset.plot(fix.t_s[seen], 1e9 * (seconds - start - slope * fix.t_s[seen]), lw=0.9)
    _style(offset, f"Receiver's clock less {1e6 * start:.3f} µs and {1e6 * slope:+.4f} ppm", "time [s]", "clock [ns]")
    if seen.all() and len(seconds) > 8:
        step = float(np.median(np.diff(fix.t_s)))
        found = clock.allan_deviation(seconds, step, confidence=0.95)
        allan.fill_between(found.tau_s, found.lower, found.upper, alpha=0.2, lw=0.0)
        allan.plot(found.tau_s, found.deviation, "o-", ms=3)
        allan.set_xscale("log")
        allan.set_yscale("log")
    else:
        allan.text(0.5, 0.5, "epochs are missing", ha="center", va="center", transform=allan.transAxes)
    _style(allan, "Its Allan deviation, 95 %", "averaging time [s]", "deviation")
    if title:
        figure.suptitle(title)
    if path is not None:
        _save(figure, Path(path))
    return figure
