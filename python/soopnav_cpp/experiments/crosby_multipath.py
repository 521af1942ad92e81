"""A water tower reflects, and residual monitoring: crosby figs. 4.8 … 4.13."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from soopnav_cpp.experiments.crosby_setup import (
    MHZ,
    TOWER,
    Array,
    Track,
    boundary_errors,
    distance_m,
    scenario,
    solve,
)
from soopnav_cpp.experiments.crosby_tracks import draw_errors
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, below, experiment
from soopnav_cpp.scenarios.ofdm_inertial import FilterSettings
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import sense

RUNS = 40
# At 20 MHz delays are true ones: the short filter of "interpolate and shift" takes up to a sixth of the power of a
# path half a sample off, and would decide between two paths of equal strength. At 300 MHz every path lies on a sample.
MOVEMENT = {1: {"movement": "fractional_delay"}, 15: {"movement": "interpolate_and_shift"}}
STEP_M = {1: 299_792_458.0 / 20e6, 15: 299_792_458.0 / 300e6}
GATE_PROBABILITY = 1e-3
GATES_M = {1: 45.0, 15: 3.0}
WRONG_M = 45.0


@dataclass(frozen=True)
class Reflected:
    """One run among reflections at one rate."""

    track: Track  # all boundaries taken, with the paper's R: the square of a step over 12
    gated: Track  # by the paper's threshold
    guarded: Track  # by it and a chi-square gate
    clean: Track  # without the tower
    strength: Array  # (E, K)
    boundary_error_m: Array  # (E, K)


def reflected(seed: int, rate: int) -> Reflected:
    """One drive past the tower, one with the gate, and one without the tower."""
    setup = scenario(rate, reflector=TOWER, ofdm=MOVEMENT[rate])
    sensed = sense(setup, seed)
    assert sensed.reflection_gain is not None
    paper = replace(sensed, tdoa=[replace(sensed.tdoa[0], sigma_m=STEP_M[rate] / math.sqrt(12.0))])
    plain = scenario(rate, ofdm=MOVEMENT[rate])

    def behind(gate: FilterSettings) -> Track:
        return solve(setup.model_copy(update={"filter": gate}), sensed)

    return Reflected(
        solve(setup, paper),
        behind(FilterSettings(gate_m=GATES_M[rate])),
        behind(FilterSettings(gate_m=GATES_M[rate], gate_probability=GATE_PROBABILITY)),
        solve(plain, sense(plain, seed)),
        np.abs(sensed.reflection_gain[0]),
        boundary_errors(setup, sensed),
    )


def wrong_and_strong(runs: list[Reflected]) -> tuple[float, int]:
    """Of the boundaries off by more than 45 m, the share whose reflection is above 0.95 of the line of sight."""
    wrong = np.concatenate([np.abs(run.boundary_error_m).ravel() > WRONG_M for run in runs])
    strong = np.concatenate([run.strength.ravel() > 0.95 for run in runs])
    count = int(np.count_nonzero(wrong))
    return (float(np.mean(strong[wrong])) if count else float("nan")), count


def events(run: Reflected) -> list[int]:
    """Epochs at which a boundary is wrong, with none in the ten before and the twenty after."""
    hit = np.flatnonzero((np.abs(run.boundary_error_m) > WRONG_M).any(axis=1))
    return [
        int(e)
        for i, e in enumerate(hit)
        if (i == 0 or e - hit[i - 1] > 10) and (i + 1 == len(hit) or hit[i + 1] - e > 20) and 15 <= e < 95
    ]


def jump_m(run: Reflected, epoch: int) -> float:
    """How far an epoch throws the position off within a second, before the next epoch: a wrong boundary also turns the
    velocity."""
    t, e = run.track.t_s, run.track.error_m
    at = float(epoch + 1)
    before = int(np.searchsorted(t, at - 0.05)) - 1
    during = (t >= at - 1e-6) & (t < at + 0.95)
    return float(np.linalg.norm(e[during] - e[before], axis=1).max())


def half_s(run: Reflected, epoch: int) -> float:
    """Time until the error stays below half of what the event made of it; NaN if it never grew by 5 m."""
    t, d = run.track.t_s, distance_m(run.track)
    at = float(epoch + 1)
    window = (t >= at - 1e-6) & (t <= at + 20.0)
    peak = float(d[(t >= at - 1e-6) & (t <= at + 1.0)].max())
    above_half = np.flatnonzero(d[window] > 0.5 * peak)
    if jump_m(run, epoch) < 5.0:
        return float("nan")
    return float(t[window][above_half[-1]] - at) if len(above_half) else 0.0


def _draw(lab: Lab, run: Reflected, rate: int, zoom: bool, track: Track | None = None) -> None:
    gates = f"gate of {GATES_M[rate]:g} m" + (" and chi-square" if track is run.guarded else "")
    what = "with a reflecting tower" if track is None else gates
    shown = run.track if track is None else track
    with lab.figure(7.2, 5.6) as figure:
        draw_errors(
            figure,
            shown,
            f"Three transmitters, {MHZ[rate]}, {what}",
            6.0 * float(shown.sigma_m.max()) if zoom else None,
        )
    lab.save(
        t_s=shown.t_s, error_m=shown.error_m, sigma_m=shown.sigma_m, strength=run.strength,
        boundary_error_m=run.boundary_error_m, rejected=shown.rejected,
    )  # fmt: skip


def _most_hit(runs: list[Reflected]) -> Reflected:
    return max(runs, key=lambda run: float(distance_m(run.track).max()))


def _in_any(lab: Lab, rate: int) -> Iterator[Claim]:
    runs = lab.map(reflected, rate)
    share, count = wrong_and_strong(runs)
    yield Claim(
        f"{MHZ[rate]}: of {count} boundaries off by more than 45 m in {lab.runs} runs, share whose reflection is above "
        "0.95 of the line of sight: 0.95 or more, less 3.8 of the count's own deviations",
        share,
        at_least(0.95 - 3.8 * math.sqrt(0.95 * 0.05 / max(count, 1))),
    )
    weak = np.concatenate([np.abs(run.boundary_error_m)[run.strength < 0.9] > WRONG_M for run in runs])
    yield Claim("share of boundaries off by more than 45 m where it is below 0.9", float(weak.mean()), below(0.01))
    _draw(lab, _most_hit(runs), rate, False)
    worst = [max(float(distance_m(item).max()) for item in tracks) for tracks in
             ([run.track for run in runs], [run.clean for run in runs])]  # fmt: skip
    yield Claim("worst position error over that without the tower", worst[0] / worst[1], above(4.0))


@experiment("crosby-4.8", title="Reflections at 20 MHz", source="crosby section 4.4, Fig. 4.8", runs=RUNS)
def figure_4_8(lab: Lab) -> Iterator[Claim]:
    """Errors jump when a reflection outweighs the line of sight."""
    yield from _in_any(lab, 1)


@experiment("crosby-4.9", title="Reflections at 300 MHz", source="crosby section 4.4, Fig. 4.9", runs=RUNS)
def figure_4_9(lab: Lab) -> Iterator[Claim]:
    """The same, oversampled."""
    yield from _in_any(lab, 15)


def _between_events(runs: list[Reflected]) -> float:
    """RMS error before a run's first wrong boundary over that of the same drives without the tower."""
    hit, clean = [], []
    for run in runs:
        wrong = np.flatnonzero((np.abs(run.boundary_error_m) > WRONG_M).any(axis=1))
        until = float(wrong[0]) + 0.95 if len(wrong) else float(run.track.t_s[-1])
        rows = (run.track.t_s >= 5.0) & (run.track.t_s < until)
        hit.append(distance_m(run.track)[rows])
        clean.append(distance_m(run.clean)[rows])
    return float(np.sqrt(np.mean(np.concatenate(hit) ** 2) / np.mean(np.concatenate(clean) ** 2)))


@experiment("crosby-4.10", title="Reflections at 20 MHz, zoomed", source="crosby section 4.4, Fig. 4.10", runs=RUNS)
def figure_4_10(lab: Lab) -> Iterator[Claim]:
    """Until one outweighs the line of sight, the system works as without."""
    runs = lab.map(reflected, 1)
    _draw(lab, _most_hit(runs), 1, True)
    yield Claim(
        "RMS error until the first wrong boundary, over that of the same drives without the tower",
        _between_events(runs),
        at_most(1.5),
    )


def pair(seed: int) -> tuple[Reflected, Reflected]:
    """The same drive and reflections at both rates."""
    return reflected(seed, 1), reflected(seed, 15)


@experiment(
    "crosby-4.11", title="Reflections at 300 MHz, zoomed", source="crosby section 4.4, Fig. 4.11", runs=2 * RUNS
)
def figure_4_11(lab: Lab) -> Iterator[Claim]:
    """Larger jumps at 300 MHz, and half of one gone sooner."""
    runs = lab.map(pair)
    _draw(lab, _most_hit([item[1] for item in runs]), 15, True)
    both = [(item, e) for item in runs for e in sorted(set(events(item[0])) & set(events(item[1])))]
    jumps = np.array([[jump_m(run, e) for run in item] for item, e in both])
    halves = np.array([[half_s(run, e) for run in item] for item, e in both])
    halves = halves[np.isfinite(halves).all(axis=1)]
    lab.table(["jump_20_m", "jump_300_m"], jumps.tolist(), part="jumps")
    lab.table(["half_20_s", "half_300_s"], halves.tolist(), part="halves")
    yield Claim(
        f"jump at 300 MHz over that at 20 MHz with the paper's R, median of {len(jumps)} events of {lab.runs} runs",
        float(np.median(jumps[:, 1] / jumps[:, 0])),
        at_least(2.0),
    )
    yield Claim(
        "median time until half of it is gone, at 20 MHz and at 300 MHz: sooner at 300 MHz, their ratio",
        float(np.median(halves[:, 0]) / np.median(halves[:, 1])),
        above(1.0),
    )


def _gating(lab: Lab, rate: int, limit: float) -> Iterator[Claim]:
    runs = lab.map(reflected, rate)
    names = ("track", "gated", "guarded", "clean")
    ends = {name: [float(distance_m(getattr(run, name)).max()) for run in runs] for name in names}
    worst = {name: max(values) for name, values in ends.items()}
    lab.table(names, zip(*ends.values(), strict=True), part="worst")
    # At 20 MHz 45 m are ten standard deviations, and boundaries between two paths pass; at 300 MHz 3 m are seven, and
    # weak reflections smear every boundary by more than its sigma says, which a chi-square gate takes for outliers.
    name = "guarded" if rate == 1 else "gated"
    gates = f"{GATES_M[rate]:g} m" + (f" and by chi-square at {GATE_PROBABILITY:g}" if rate == 1 else "")
    hit = _most_hit(runs)
    _draw(lab, hit, rate, False, getattr(hit, name))
    yield Claim(
        f"worst error with residuals gated above {gates}, over the worst without the tower, {lab.runs} runs",
        worst[name] / worst["clean"],
        at_most(limit),
    )
    if rate == 1:
        yield Claim(
            "the same with 45 m alone: boundaries between two paths pass it",
            worst["gated"] / worst["clean"],
            at_most(3.5),
        )
    yield Claim(
        f"with {GATES_M[rate]:g} m alone, median over the runs of the worst error of each: the same ratio",
        np.median(ends["gated"]) / np.median(ends["clean"]),
        at_most(limit),
    )
    if rate != 1:
        yield Claim("worst error with the gate over the worst without one", worst[name] / worst["track"], at_most(0.05))
    rejects = np.mean([getattr(run, name).rejected.mean() for run in runs])
    yield Claim("share of the boundaries that are refused: the filter is not locked out", float(rejects), below(0.1))


@experiment("crosby-4.12", title="Residual monitoring at 20 MHz", source="crosby section 4.4, Fig. 4.12", runs=RUNS)
def figure_4_12(lab: Lab) -> Iterator[Claim]:
    """A gate of 45 m."""
    yield from _gating(lab, 1, 2.0)


@experiment("crosby-4.13", title="Residual monitoring at 300 MHz", source="crosby section 4.4, Fig. 4.13", runs=RUNS)
def figure_4_13(lab: Lab) -> Iterator[Claim]:
    """A gate of 3 m."""
    yield from _gating(lab, 15, 4.0)
