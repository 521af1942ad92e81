"""Basestations' clocks with no satellite to tell: the iteration believes its start, multiple models say what fits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import NoiseBank, TwoState, characterize, iterate_noise, mean_squared_coherence
from soopnav_cpp.experiments.pesyna_setup import (
    DT_S,
    EPOCHS,
    FROM_BASESTATIONS,
    L1_HZ,
    OTHER,
    RECEIVERS,
    STEADY,
    Pair,
    Receiver,
    Record,
    record,
    stage_3,
)
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, experiment, style

__all__ = ["Weak", "weak"]

Array = npt.NDArray[np.float64]

RUNS = 48
ITERATED = 24
TURNS = 20
BLOCK = 40  # epochs between looks at the weights
MIDDLE = TwoState(math.sqrt(STEADY.h0 * OTHER.h0), math.sqrt(STEADY.h_minus_2 * OTHER.h_minus_2))
STARTS: dict[str, Pair] = {"equal": (MIDDLE, MIDDLE), "swapped": (OTHER, STEADY)}
BLUE, RED, GREY, GREEN = "#1b6ca8", "#d1495b", "#5c677d", "#2e933c"


@dataclass(frozen=True)
class Weak:
    """One run without satellites.

    Attributes
    ----------
    covered : ndarray of bool, shape (4,)
        The 95 % intervals of h0 and h-2 of both basestations hold the truth.
    right_order : ndarray, shape (blocks,)
        Posterior probability of the right order along the record.
    only_sum : bool
        The characterisation says that only the sum is identifiable.
    coherence : ndarray, shape (4,)
        C² over 100 s with the true noise, the posterior mean, and the iteration from equal and swapped starts, NaN when
        not run.
    iterated : ndarray, shape (2, 2, 2)
        Where the iteration ends, start, basestation, (h0, h-2), over the truth; NaN when not run.
    """

    covered: npt.NDArray[np.bool_]
    right_order: Array
    only_sum: bool
    coherence: Array
    iterated: Array


def coherence_at_100_s(found: Record, sources: Pair) -> float:
    """Of stage 3's error against the true clock, detrended once."""
    error = stage_3(found, sources).bias_s[:, 0] - found.receiver_s
    return float(mean_squared_coherence(L1_HZ * error, DT_S, 100.0).mean_squared[0])


def weak(seed: int, receiver: Receiver, with_iteration: bool) -> Weak:
    """Two basestations alone; the receiver's own noise is known."""
    found = record(seed, receiver)
    truth = np.array([[clock.h0, clock.h_minus_2] for clock in found.sources])
    sigma = found.cdma_sigma_s
    likely = characterize(found.cdma_s, DT_S, sigma, mixing=FROM_BASESTATIONS, known=[found.receiver, None, None])
    bank = NoiseBank.around(likely, sigma, mixing=FROM_BASESTATIONS)
    order = []
    for first in range(0, EPOCHS, BLOCK):
        bank.push(found.cdma_s[first : first + BLOCK])
        order.append(bank.probability_steadier(1, 2))
    covered = []
    for basestation in range(2):
        for column in range(2):
            low, high = bank.interval(1 + basestation, "h0" if column == 0 else "h-2")
            covered.append(low <= truth[basestation, column] <= high)
    _, first_mean, second_mean = bank.mean()
    coherences = [coherence_at_100_s(found, found.sources), coherence_at_100_s(found, (first_mean, second_mean))]
    ends = np.full((2, 2, 2), math.nan)
    for i, start in enumerate(STARTS.values()):
        if not with_iteration:
            coherences.append(math.nan)
            continue
        turns = iterate_noise(
            found.cdma_s,
            DT_S,
            sigma,
            [found.receiver, *start],
            mixing=FROM_BASESTATIONS,
            estimated=[1, 2],
            iterations=TURNS,
        )
        ends[i] = turns[-1, 1:] / truth
        one, two = (TwoState(float(h0), float(walk)) for h0, walk in turns[-1, 1:])
        coherences.append(coherence_at_100_s(found, (one, two)))
    return Weak(np.array(covered), np.array(order), likely.only_sum_known, np.array(coherences), ends)


def draw(lab: Lab, runs: dict[Receiver, list[Weak]]) -> None:
    """Where the iteration ends, what the weights say along the record, and what either does to coherence."""
    with lab.figure(11.4, 3.9) as figure:
        left, middle, right = figure.subplots(1, 3)
        style(
            left,
            f"Fig. 2's iteration after {TURNS} turns",
            "steadier basestation: h₀ found / h₀",
            "other: h₀ found / h₀",
        )
        for (name, group), colour in zip(runs.items(), (RED, BLUE), strict=True):
            for i, (start, marker) in enumerate(zip(STARTS, ("o", "s"), strict=True)):
                ends = np.array([run.iterated[i, :, 0] for run in group[:ITERATED]])
                left.loglog(
                    *np.maximum(ends, 1e-14).T,
                    marker,
                    color=colour,
                    ms=7 if name == "tcxo" else 4,
                    mfc="none" if name == "tcxo" else colour,
                    label=f"{name.upper()}, {start} start",
                )
        left.axhspan(0.5, 2.0, color=GREEN, alpha=0.2, lw=0)
        left.axvspan(0.5, 2.0, color=GREEN, alpha=0.2, lw=0)
        left.plot(1.0, 1.0, "*", color=GREEN, ms=11, label="truth")
        left.set_xlim(1e-15, 1e3)
        left.set_ylim(1e-15, 1e3)
        left.legend(fontsize=7.5, loc=(0.26, 0.27))
        style(middle, "Multiple models", "time [s]", "probability of the right order")
        t = DT_S * BLOCK * np.arange(1, EPOCHS // BLOCK + 1)
        for (name, group), colour in zip(runs.items(), (RED, BLUE), strict=True):
            for k, run in enumerate(group[:12]):
                middle.plot(t, run.right_order, color=colour, lw=0.9, alpha=0.7, label=name.upper() if k == 0 else None)
        middle.set_ylim(0.0, 1.03)
        middle.legend(fontsize=8, loc="lower right", title="receiver", title_fontsize=8)
        style(right, "Mean C²(100 s), CDMA only", "", "")
        names = ("true noise", "multiple models", "iteration, equal start", "iteration, swapped start")
        for k, ((name, group), colour) in enumerate(zip(runs.items(), (RED, BLUE), strict=True)):
            mean = np.nanmean([run.coherence for run in group], axis=0)
            at = np.arange(4) + 0.4 * k
            right.barh(at, mean, height=0.36, color=colour, alpha=0.85, label=name.upper())
            for y, value in zip(at, mean, strict=True):
                right.text(value - 0.01, y, f"{value:.2f}", va="center", ha="right", fontsize=7.5, color="white")
        right.set_yticks(np.arange(4) + 0.2, names)
        right.invert_yaxis()
        right.set_xlim(0.0, 1.0)
        right.axvline(0.5, color=GREY, lw=0.8, ls="--")
        right.legend(fontsize=8, loc="lower right")


@experiment(
    "pesyna-x2",
    title="Characterisation where observability is weak: multiple models",
    source="pesyna section IV-D, ref. [9]; beyond the paper",
    runs=RUNS,
)
def beyond_2(lab: Lab) -> Iterator[Claim]:
    """Two basestations and no satellite for 240 s."""
    runs: dict[Receiver, list[Weak]] = {}
    for name in RECEIVERS:
        first = lab.map(weak, name, True, runs=ITERATED)
        runs[name] = [*first, *lab.workers.map(weak, [(seed, name, False) for seed in lab.seeds[ITERATED:]])]
    draw(lab, runs)
    columns = ("covered", "right_order", "only_sum", "coherence", "iterated")
    kept: dict[str, Any] = {
        f"{name}_{column}": [getattr(run, column) for run in group]
        for name, group in runs.items()
        for column in columns
    }
    lab.save(**kept)
    for name, group in runs.items():
        title = name.upper()
        ends = np.abs(np.log([run.iterated for run in group[:ITERATED]]))
        mean = np.nanmean([run.coherence for run in group], axis=0)
        yield Claim(
            f"{title}: share of {ITERATED} runs in which fig. 2's iteration ends with an h more than 100 times off, "
            "equal and swapped starts",
            np.mean(ends.max(axis=(2, 3)) > math.log(100.0), axis=0),
            at_least(0.9),
        )
        yield Claim(
            f"{title}: multiple models: share of {RUNS} runs whose 95 % interval holds the truth, h₀ and h₋₂ of each",
            np.mean([run.covered for run in group], axis=0),
            at_least(0.75),
        )
        yield Claim(
            f"{title}: share of runs that believe the wrong order at more than 0.9",
            float(np.mean([run.right_order[-1] < 0.1 for run in group])),
            at_most(0.1),
        )
        said = float(np.mean([run.only_sum for run in group]))
        if name == "ocxo":
            yield Claim(
                "OCXO: C²(100 s) with the posterior mean of the noise over that with the true noise, means",
                mean[1] / mean[0],
                at_least(0.9),
            )
            yield Claim("OCXO: share of runs said to show the sum of the noise only", said, at_most(0.05))
        else:
            yield Claim(
                "TCXO: C²(100 s) with the posterior mean, less that of the iteration from swapped clocks, means",
                mean[1] - mean[3],
                above(0.0),
            )
            yield Claim(
                "TCXO: share of runs whose characterisation says that only the sum of the basestations' noise is "
                "identifiable",
                said,
                at_least(0.85),
            )
