"""Noise of basestations' clocks found on the fly (pesyna fig. 2): the bare iteration, and the likelihood instead."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import TwoState, iterate_noise, noise_likelihood
from soopnav_cpp.experiments.pesyna_setup import (
    EPOCHS,
    OTHER,
    STEADY,
    Pair,
    Record,
    characterize_sources,
    record,
)
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style

__all__ = ["Found", "find"]

Array = npt.NDArray[np.float64]

RUNS = 200
LONG = 6000  # epochs, 600 s
TAU_S = np.array([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
TURNS = 20
LOST = 0.95
READINGS = ("increments", "allan_fit")
BLUE, RED, GREY, GREEN = "#1b6ca8", "#d1495b", "#5c677d", "#2e933c"
NAMES = ("steadier", "other")


def scaled(pair: Pair, factor: float) -> Pair:
    """Both clocks with h0 and h-2 times `factor`."""
    first, second = (TwoState(factor * clock.h0, factor * clock.h_minus_2) for clock in pair)
    return first, second


@dataclass(frozen=True)
class Found:
    """One run.

    Attributes
    ----------
    ln_error : ndarray, shape (2, 2, 2)
        ln of h found over h: duration, basestation, (h0, h-2).
    crlb : ndarray, shape (2, 2, 2)
        Bound of its standard deviation.
    adev : ndarray, shape (2, 2)
        Greatest factor between Allan deviations found and true, 0.2 to 100 s: duration, basestation.
    apart : ndarray, shape (2, 2)
        Log-likelihood from x100 less that from /100.
    order : ndarray of bool, shape (2,)
        The steadier basestation was recognised at every averaging time.
    iterated : ndarray, shape (2, 2, turns + 1, 2, 2) or empty
        Fig. 2's iteration: reading, start, turn, basestation, (h0, h-2).
    """

    ln_error: Array
    crlb: Array
    adev: Array
    apart: Array
    order: npt.NDArray[np.bool_]
    iterated: Array


def pairs_of(clocks: Pair) -> Array:
    """Rows of (h0, h-2)."""
    return np.array([[clock.h0, clock.h_minus_2] for clock in clocks])


def iterated(found: Record, factor: float, reading: str) -> Array:
    """Fig. 2's iteration for both basestations, shape (turns + 1, 2, 2)."""
    sigma = math.hypot(found.gps_sigma_s, found.cdma_sigma_s)
    each = [
        iterate_noise(
            found.gps_s - found.cdma_s[:, i],
            found.dt_s,
            sigma,
            [scaled(found.sources, factor)[i]],
            analysis="allan_fit" if reading == "allan_fit" else "increments",
            iterations=TURNS,
        )[:, 0]
        for i in range(2)
    ]
    return np.stack(each, axis=1)


def find(seed: int, with_iteration: bool) -> Found:
    """Characterise both basestations from 240 s and from 600 s, each from x100 and /100."""
    ln_error, crlb, adev, apart = (np.empty((2, 2, 2)), np.empty((2, 2, 2)), np.empty((2, 2)), np.empty((2, 2)))
    order = np.empty(2, np.bool_)
    turns = np.empty(0)
    for i, n in enumerate((EPOCHS, LONG)):
        found = record(seed, n=n)
        high, low = (characterize_sources(found, start=scaled(found.sources, f)) for f in (100.0, 0.01))
        sigma = math.hypot(found.gps_sigma_s, found.cdma_sigma_s)
        deviations = []
        for j, truth in enumerate(found.sources):
            best = high[j].clocks[0]
            ln_error[i, j] = math.log(best.h0 / truth.h0), math.log(best.h_minus_2 / truth.h_minus_2)
            score = noise_likelihood(found.gps_s - found.cdma_s[:, j], found.dt_s, sigma, [truth])
            crlb[i, j] = np.sqrt(np.diag(np.linalg.inv(score.information)))
            deviations.append(best.allan_deviation(TAU_S))
            adev[i, j] = np.exp(np.abs(np.log(deviations[-1] / truth.allan_deviation(TAU_S))).max())
            apart[i, j] = high[j].log_likelihood - low[j].log_likelihood
        order[i] = bool(np.all(deviations[0] < deviations[1]))
        if i == 0 and with_iteration:
            turns = np.array([[iterated(found, f, reading) for f in (100.0, 0.01)] for reading in READINGS])
    return Found(ln_error, crlb, adev, apart, order, turns)


def draw(lab: Lab, runs: list[Found], turns: Array) -> None:
    """Where the iteration goes, Allan deviations of what was found, and errors of h against their bound."""
    with lab.figure(11.4, 3.9) as figure:
        left, middle, right = figure.subplots(1, 3)
        style(left, "Fig. 2 as printed", "turn", "found / true, the lesser of h₀ and h₋₂")
        truth = pairs_of((STEADY, OTHER))
        for r, (line, name) in enumerate((("-", "increments"), ("--", "Allan fit"))):
            for s, colour in enumerate((BLUE, RED)):
                for start in range(2):
                    values = np.median((turns[:, r, start, :, s] / truth[s]).min(axis=-1), axis=0)
                    label = f"{NAMES[s]}, {name}" if start == 0 else None
                    left.semilogy(
                        np.arange(TURNS + 1), np.maximum(values, 1e-7), line, color=colour, lw=1.3, label=label
                    )
        left.axhspan(0.5, 2.0, color=GREEN, alpha=0.25, lw=0)
        left.set_ylim(0.5e-7, 2e4)
        left.text(19.8, 0.12, "within ×2", fontsize=8, color=GREEN, ha="right")
        left.legend(fontsize=7, ncols=2, loc="upper right", title="median run, from ×100 and ÷100", title_fontsize=7)
        left.set_xticks((0, 5, 10, 15, 20))

        style(middle, "Allan deviation after 240 s", "averaging time [s]", "Allan deviation")
        for s, (clock, colour) in enumerate(zip((STEADY, OTHER), (BLUE, RED), strict=True)):
            grid = np.geomspace(0.2, 100.0, 60)
            factors = np.array([run.ln_error[0, s] for run in runs])
            curves = np.array(
                [
                    TwoState(clock.h0 * math.exp(a), clock.h_minus_2 * math.exp(b)).allan_deviation(grid)
                    for a, b in factors
                ]
            )
            low, high = np.quantile(curves, [0.025, 0.975], axis=0)
            middle.fill_between(grid, low, high, color=colour, alpha=0.25, lw=0)
            middle.loglog(
                grid, clock.allan_deviation(grid), color=colour, lw=1.6, label=f"{NAMES[s]}: truth, 95 % found"
            )
            for start, marker in ((0, ":"), (1, ":")):
                h0, walk = np.median(turns[:, 1, start, -1, s], axis=0)
                middle.loglog(
                    grid,
                    TwoState(h0, walk).allan_deviation(grid),
                    marker,
                    color=GREY,
                    label="after 20 turns of fig. 2, Allan fit" if s == 0 and start == 0 else None,
                )
        middle.set_ylim(1e-13, 2e-11)
        middle.legend(fontsize=7.5, loc="upper center")

        style(right, "Errors by likelihood, bound 1σ and 2σ", "h₀ found / h₀", "h₋₂ found / h₋₂")
        turn = np.linspace(0.0, 2.0 * math.pi, 121)
        for s, colour in enumerate((BLUE, RED)):
            points = np.exp([run.ln_error[0, s] for run in runs])
            right.loglog(points[:, 0], points[:, 1], ".", ms=3.5, color=colour, alpha=0.6, label=f"{NAMES[s]}, 240 s")
            found = record(lab.seeds[0])
            sigma = math.hypot(found.gps_sigma_s, found.cdma_sigma_s)
            score = noise_likelihood(
                found.gps_s - found.cdma_s[:, s], found.dt_s, sigma, [found.sources[s]]
            ).information
            root = np.linalg.cholesky(np.linalg.inv(score))
            for k in (1.0, 2.0):
                x, y = np.exp(k * root @ np.array([np.cos(turn), np.sin(turn)]))
                right.loglog(x, y, color=colour, lw=1.1)
        for value in (0.5, 2.0):
            right.axvline(value, color=GREEN, lw=0.9, ls="--")
            right.axhline(value, color=GREEN, lw=0.9, ls="--")
        right.set_xlim(0.3, 3.3)
        right.set_ylim(0.3, 3.3)
        for ticks in (right.set_xticks, right.set_yticks):
            ticks((), minor=True)
            ticks((0.5, 1.0, 2.0), ("0.5", "1", "2"))
        right.legend(fontsize=7.5, loc="upper right")


@experiment(
    "pesyna-2",
    title="On-the-fly characterisation of basestations' clocks",
    source="pesyna section IV-D, fig. 2",
    runs=RUNS,
)
def figure_2(lab: Lab) -> Iterator[Claim]:
    """Stage 2 of 240 s and 600 s with six satellites; both searches from x100 and /100."""
    first = lab.map(find, True, runs=RUNS // 2)
    rest = list(lab.workers.map(find, [(seed, False) for seed in lab.seeds[RUNS // 2 :]]))
    runs = [*first, *rest]
    turns = np.array([run.iterated for run in first])
    draw(lab, runs, turns)
    error = np.array([run.ln_error for run in runs])
    bound = np.array([run.crlb for run in runs])
    lab.save(
        ln_error=error,
        crlb=bound,
        allan_factor=[run.adev for run in runs],
        likelihood_apart=[run.apart for run in runs],
        iterated=turns,
    )
    truth = pairs_of((STEADY, OTHER))
    ends = np.abs(np.log(turns[..., -1, :, :] / truth))  # run, reading, start, basestation, (h0, h-2)
    inside = np.all(ends <= math.log(2.0), axis=-1)
    half = RUNS // 2
    yield Claim(
        f"fig. 2's iteration as printed collapses: share of {half} runs that end with both h of a basestation within "
        f"×2 after {TURNS} turns, steps' variances and Allan fits, from ×100 and ÷100",
        np.ravel(inside.mean(axis=0)),
        at_most(0.02),
    )
    yield Claim(
        "the same runs: share that lost one of the two noises, h₀ or h₋₂ below a hundredth of the truth",
        np.ravel(((turns[..., -1, :, :] / truth).min(axis=-1) < 0.01).mean(axis=0)),
        at_least(LOST),
    )
    good = np.all(np.abs(error) <= math.log(2.0), axis=(2, 3))
    yield Claim(
        f"by innovation likelihood: share of {RUNS} runs of 240 s with h₀ and h₋₂ of both basestations within ×2",
        float(good[:, 0].mean()),
        at_least(0.9),
    )
    yield Claim("the same with 600 s", float(good[:, 1].mean()), at_least(0.95))
    adev = np.array([run.adev for run in runs])
    yield Claim(
        "Allan deviations of 0.2 to 100 s found in 600 s: greatest factor from the truth, all runs, each basestation",
        adev[:, 1].max(axis=0),
        at_most(2.0),
    )
    yield Claim(
        "the same in 240 s, where the tail goes further (of 6000 records the worst is ×2.03, three in 10 000 beyond ×2 "
        "by a fit): share of runs within ×2",
        float(np.all(adev[:, 0] <= 2.0, axis=1).mean()),
        at_least(0.98),
    )
    yield Claim(
        "greatest difference of log-likelihood between the searches from ×100 and from ÷100",
        float(np.abs([run.apart for run in runs]).max()),
        at_most(0.1),
    )
    yield Claim(
        "spread of ln h over its CRLB, root mean square of the four h, 240 s and 600 s",
        np.sqrt(np.mean((error / bound) ** 2, axis=(0, 2, 3))),
        band(0.8, 1.25),
    )
    yield Claim(
        "share of runs that recognise the steadier basestation at every averaging time, 240 s and 600 s",
        np.mean([run.order for run in runs], axis=0),
        at_least(1.0),
    )
