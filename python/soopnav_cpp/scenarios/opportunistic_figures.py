"""Figures of a run of opportunistic navigation: the clock through the stages, coherence, Allan deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from soopnav_cpp._drawing import _COLOURS, _INK, _figure, _style
from soopnav_cpp.clock import mean_squared_coherence
from soopnav_cpp.scenarios.opportunistic_pipeline import L1_HZ, clock_deviation, stage_3_cycles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from soopnav_cpp.scenarios.opportunistic import OpportunisticScenario, OpportunisticSystemRun

__all__ = ["clock", "coherence", "figures", "stability"]


def clock(scenario: OpportunisticScenario, run: OpportunisticSystemRun) -> Figure:
    """Error of the receiver's clock through the stages, and which signals were heard (pesyna figs. 8 to 10)."""
    figure = _figure(8.6, 5.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
    smooth = 1e9 * run.smoothed_error_s
    top.plot(run.t_s, 1e9 * run.clock_error_s, color=_COLOURS[7], lw=0.7, label="filtered")
    top.plot(run.t_s, smooth, color=_COLOURS[0], lw=1.3, label="smoothed")
    sigma = 1e9 * run.clock_sigma_s
    top.plot(run.t_s, sigma, "--", color=_INK, lw=0.8, label="±1σ, filtered")
    top.plot(run.t_s, -sigma, "--", color=_INK, lw=0.8)
    settled = run.t_s >= min(10.0, 0.1 * scenario.duration_s)
    bound = 1.3 * float(max(np.abs(smooth[settled]).max(), sigma[settled].max()))
    top.set_ylim(-bound, bound)
    edges = [0.0, scenario.stage_2_s, scenario.stage_3_s]
    for k, (edge, words) in enumerate(zip(edges, ("GPS", "GPS and basestations", "basestations"), strict=True)):
        end = [*edges, scenario.gps_returns_s or scenario.duration_s][k + 1]
        if k:
            top.axvline(edge, color="0.6", lw=0.8)
            bottom.axvline(edge, color="0.6", lw=0.8)
        top.text(0.5 * (edge + end), 0.92 * bound, words, ha="center", va="top", fontsize=8, color=_INK)
    top.legend(fontsize=8, frameon=False, loc="lower left", ncols=3)
    _style(top, "The receiver's clock", "", "error [ns]")
    names = list(run.heard)
    for row, name in enumerate(names):
        heard = np.where(run.heard[name], float(row), np.nan)
        bottom.plot(run.t_s, heard, lw=3.0, color=_COLOURS[2] if name in run.noise else _COLOURS[0])
    bottom.set_yticks(range(len(names)), names, fontsize=7)
    bottom.set_ylim(-0.7, len(names) - 0.3)
    _style(bottom, "Heard", "time [s]", "")
    bottom.tick_params(axis="y", labelsize=6)
    return figure


def coherence(scenario: OpportunisticScenario, run: OpportunisticSystemRun) -> Figure:
    """Phase that a correlator at L1 is left with while there is no GPS, its mean-squared coherence (pesyna fig. 11)."""
    dt = scenario.receiver.interval_s
    cycles = stage_3_cycles(run)
    own = L1_HZ * run.clock_true_s[run.stage == 3]
    at = np.linspace(-1.0, 1.0, len(own))
    own = own - np.polyval(np.polyfit(at, own, 1), at)
    figure = _figure(8.6, 3.4)
    left, right = figure.subplots(1, 2)
    left.plot(run.t_s[run.stage == 3], cycles, color=_COLOURS[0], lw=1.1)
    for level in (-0.5, 0.5):
        left.axhline(level, color=_COLOURS[1], lw=0.8, ls="--")
    reach = max(0.6, 1.1 * float(np.abs(cycles).max()))
    left.set_ylim(-reach, reach)
    _style(left, "Without GPS, straight line taken out", "time [s]", "clock error [L1 cycles]")
    for phase, colour, label in ((cycles, _COLOURS[0], "aided by basestations"), (own, _COLOURS[7], "the clock alone")):
        curve = mean_squared_coherence(phase, dt)
        right.fill_between(curve.tau_s, curve.lower, curve.upper, color=colour, alpha=0.2, lw=0.0)
        right.plot(curve.tau_s, curve.mean_squared, color=colour, lw=1.3, label=label)
    right.axhline(0.5, color=_COLOURS[1], lw=0.8, ls="--")
    right.set_xscale("log")
    right.set_ylim(0.0, 1.03)
    right.legend(fontsize=8, frameon=False, loc="lower left")
    _style(right, "Mean-squared coherence at L1", "integration time [s]", "$\\langle C^2 \\rangle$")
    return figure


def stability(scenario: OpportunisticScenario, run: OpportunisticSystemRun) -> Figure:
    """Allan deviations: the receiver's clock as estimated, and each basestation as it is and as it was taken."""
    figure = _figure(7.2, 4.2)
    axes = figure.add_subplot()
    tau, deviation = clock_deviation(run, scenario.receiver.interval_s)
    axes.plot(tau, deviation, "o-", ms=3, color=_INK, lw=1.0, label="receiver, smoothed")
    times = np.geomspace(scenario.receiver.interval_s, 0.5 * scenario.duration_s, 60)
    for colour, (name, (true, taken)) in zip(_COLOURS * 3, run.noise.items(), strict=False):
        axes.plot(times, true.allan_deviation(times), "--", color=colour, lw=1.0, label=f"{name}, true")
        axes.plot(times, taken.allan_deviation(times), color=colour, lw=1.5, label=f"{name}, taken")
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.3)
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper center")
    _style(axes, "Clocks", "averaging time [s]", "Allan deviation")
    return figure


def figures(scenario: OpportunisticScenario, run: OpportunisticSystemRun) -> dict[str, Figure]:
    """All three; those that need a stage without GPS only where there is one."""
    found = {"clock": clock(scenario, run), "stability": stability(scenario, run)}
    if np.count_nonzero(run.stage == 3) >= 20:
        found["coherence"] = coherence(scenario, run)
    return found
