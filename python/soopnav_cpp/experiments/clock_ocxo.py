"""Oscillators of two states: simulated, analysed, and found again from their records."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import Deviations, TwoState, allan_deviation, fit
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style

Array = npt.NDArray[np.float64]

SAMPLES = 100_000
INTERVAL = 0.95
PRESETS = ("tcxo", "ocxo", "csac", "gps", "basestation", "crosby")
COLOURS = ("tab:red", "tab:blue", "tab:purple", "tab:green", "tab:brown", "0.35")


def preset(name: str) -> TwoState:
    """A named oscillator."""
    clock: TwoState = getattr(TwoState, name)()
    return clock


def record(seed: int, name: str) -> Array:
    """Phase of a named oscillator at its crossover [s]."""
    clock = preset(name)
    return clock.simulate(clock.crossover_s, SAMPLES, seed=seed).bias_s


def fitted(seed: int) -> Array:
    """Estimate and stated standard deviation over the true coefficient, shape (presets, 2 coefficients, 2)."""
    rows = []
    for number, name in enumerate(PRESETS):
        clock = preset(name)
        got = fit(record(seed + number, name), clock.crossover_s)
        rows.append(
            [
                [got.h0 / clock.h0, got.sigma_h0 / clock.h0],
                [got.h_minus_2 / clock.h_minus_2, got.sigma_h_minus_2 / clock.h_minus_2],
            ]
        )
    return np.array(rows)


def deviations(seed: int, name: str) -> Deviations:
    """Overlapping Allan deviation of a named oscillator's record."""
    return allan_deviation(record(seed, name), preset(name).crossover_s, confidence=INTERVAL)


def covered(seed: int) -> float:
    """Share of the averaging times whose interval holds the model's deviation, over all presets."""
    inside = []
    for number, name in enumerate(PRESETS):
        got = deviations(seed + number, name)
        model = preset(name).allan_deviation(got.tau_s)
        inside.append((got.lower < model) & (model < got.upper))
    return float(np.mean(np.concatenate(inside)))


@experiment(
    "clock-ocxo",
    title="Oscillators by their records: Allan deviation and fitted coefficients",
    source="two-state clocks, Brown and Hwang section 9.3; NIST SP 1065",
    runs=10,
)
def oscillators(lab: Lab) -> Iterator[Claim]:
    """Every named oscillator, sampled where both of its noises show."""
    found = np.array(lab.map(fitted))  # (runs, presets, coefficients, estimate and sigma)
    share = float(np.mean(lab.map(covered)))
    with lab.figure(9.0, 4.6) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        curves: dict[str, npt.ArrayLike] = {}
        for name, colour in zip(PRESETS, COLOURS, strict=True):
            got = deviations(lab.seeds[0], name)
            curves[name] = np.column_stack([got.tau_s, got.deviation, got.lower, got.upper])
            off = np.vstack([got.deviation - got.lower, got.upper - got.deviation])
            left.errorbar(got.tau_s, got.deviation, off, fmt="o", ms=2.5, lw=0.8, color=colour, label=name)
            left.plot(got.tau_s, preset(name).allan_deviation(got.tau_s), color=colour, lw=0.8)
        left.set_xscale("log")
        left.set_yscale("log")
        left.legend(fontsize=8, frameon=False)
        style(left, "One record of each; lines: model", "averaging time [s]", "Allan deviation")
        for at in range(len(PRESETS)):
            for which, (mark, colour) in enumerate((("o", "tab:blue"), ("s", "tab:red"))):
                label = ("$h_0$", "$h_{-2}$")[which] if at == 0 else None
                place = np.full(len(found), at + (which - 0.5) * 0.3)
                right.plot(place, found[:, at, which, 0], mark, ms=3, color=colour, alpha=0.5, label=label)
        right.axhline(1.0, color="0.5", lw=0.8)
        right.set_xticks(range(len(PRESETS)), PRESETS, rotation=35)
        right.legend(fontsize=8, frameon=False)
        style(right, "Fitted over true", "", "ratio")
    lab.save(ratio=found[..., 0], sigma=found[..., 1])
    lab.save(part="deviations", **curves)
    error = np.abs(found[..., 0] - 1.0)
    for which, name in enumerate(("h0", "h-2")):
        yield Claim(
            f"{name} found from {SAMPLES} samples: worst relative error of {found.shape[0]} runs of each oscillator",
            float(error[:, :, which].max()),
            at_most(0.1),
        )
    # 120 squares, pairs of them correlated by a half: as good as 96, which leave this band once in 1e5.
    yield Claim(
        "mean square of the errors over the fit's own standard deviations",
        float(np.mean(((found[..., 0] - 1.0) / found[..., 1]) ** 2)),
        band(0.5, 1.75),
    )
    yield Claim(
        f"share of {INTERVAL:.0%} intervals of the Allan deviation that hold the model's, all averaging times",
        share,
        at_least(0.85),
    )
