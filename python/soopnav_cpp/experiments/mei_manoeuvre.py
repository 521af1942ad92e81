"""A target that drives, turns and stops: the wrong dynamics, two modes of motion, an inertial unit (mei)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.estimation import error_ellipse
from soopnav_cpp.experiments.mei_moving import CONSUMER, INDUSTRIAL, Grade, Track, moving_campaign, tracks
from soopnav_cpp.experiments.mei_setup import SIGMAS_BOUND, SIGMAS_PAPER, Setup
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, below, experiment, style
from soopnav_cpp.plotting import ellipse_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

RUNS = 24
SETTLED_S = 60.0
"""Errors are counted from here on: the last 240 s."""
COLOURS = {
    "static": "tab:red",
    "straight": "tab:orange",
    "two motions": "tab:blue",
    "industrial unit": "tab:green",
    "consumer unit": "tab:olive",
}
UNITS = {"industrial unit": INDUSTRIAL, "consumer unit": CONSUMER}


@dataclass(frozen=True)
class Outcome:
    """Of each tracker, last 240 s: mean squared horizontal error, its greatest, mean NEES of four states, of place."""

    square: dict[str, float]
    worst: dict[str, float]
    nees: dict[str, float]
    place_nees: dict[str, float]
    bursts: int


def outcome(seed: int, interval_s: float, sigmas: tuple[float, float] | None, units: tuple[str, ...]) -> Outcome:
    """One drive; without sigmas its bursts are made, received and measured."""
    setup = Setup(interval_s=interval_s)
    way, campaign = moving_campaign(setup, seed, "iq" if sigmas is None else "drawn", sigmas or SIGMAS_PAPER)
    found = tracks(way, campaign, seed, grades={name: UNITS[name] for name in units})
    square, worst, nees, place = {}, {}, {}, {}
    for name, track in found.items():
        late = track.t_s > SETTLED_S
        square[name] = float(np.mean(track.distance_m[late] ** 2))
        worst[name] = float(np.max(track.distance_m[late]))
        nees[name] = float(np.mean(track.nees[late]))
        error = track.error_m[late]
        place[name] = float(np.mean(error * np.linalg.solve(track.covariance_m2[late], error[..., None])[..., 0]) * 2.0)
    return Outcome(square, worst, nees, place, len(campaign))


def rms(runs: list[Outcome], name: str) -> float:
    """Over all runs."""
    return float(np.sqrt(np.mean([run.square[name] for run in runs])))


def mean_nees(runs: list[Outcome], name: str) -> float:
    """Over all runs."""
    return float(np.mean([run.nees[name] for run in runs]))


@dataclass(frozen=True)
class Example:
    """One drive to look at."""

    t_s: Array
    way_m: Array  # (m, 2) east, north
    drive_m: Array  # (n, 2) at the bursts
    tracks: dict[str, Track]


def example(seed: int, interval_s: float, grades: dict[str, Grade]) -> Example:
    """A drive with its modes."""
    way, campaign = moving_campaign(Setup(interval_s=interval_s), seed, "drawn", SIGMAS_PAPER)
    found = tracks(way, campaign, seed, grades=grades, modes=True)
    t = np.arange(0.0, 300.0, 0.5)
    frame = way.frame
    at_bursts = frame.position_from_ecef(campaign.world.position_e_m[campaign.row])
    return Example(t, frame.position_from_ecef(way.at(t)[0])[:, :2], at_bursts[:, :2], found)


def _map(axes: Axes, shown: Example, names: tuple[str, ...], title: str, every: int) -> None:
    axes.plot(*(shown.way_m / 1e3).T, color="0.35", lw=2.2, label="truth", zorder=1)
    for name in names:
        track = shown.tracks[name]
        at = shown.drive_m + track.error_m
        axes.plot(*(at / 1e3).T, ".-", color=COLOURS[name], lw=0.8, ms=2.5, label=name, zorder=2)
        for k in range(every // 2, len(at), every):
            ellipse = error_ellipse(track.covariance_m2[k], probability=0.95)
            points = (at[k] + ellipse_points(ellipse)) / 1e3
            axes.plot(*points.T, color=COLOURS[name], lw=0.7, alpha=0.7)
    low, high = shown.way_m.min(axis=0) / 1e3, shown.way_m.max(axis=0) / 1e3
    half = 0.5 * float(np.max(high - low)) + 0.4
    centre = 0.5 * (low + high)
    axes.set_xlim(centre[0] - 1.4 * half, centre[0] + 1.4 * half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_aspect("equal")
    axes.legend(loc="best", fontsize="x-small")
    style(axes, title, "east [km]", "north [km]")


def _errors(axes: Axes, shown: Example, names: tuple[str, ...], title: str) -> None:
    for name in names:
        track = shown.tracks[name]
        axes.semilogy(track.t_s, track.distance_m, color=COLOURS[name], lw=1.0, label=name)
        sigma = np.sqrt(np.trace(track.covariance_m2, axis1=1, axis2=2))
        axes.semilogy(track.t_s, sigma, color=COLOURS[name], lw=0.8, ls=":")
    axes.set_ylim(3.0, 2e4)
    axes.legend(loc="upper left", fontsize="x-small", ncol=2)
    style(axes, title, "time [s]", "horizontal error [m]")


@experiment(
    "mei-manoeuvre",
    title="Tracking a target that drives, turns and stops",
    runs=RUNS,
    source="mei slides 'Tracking manoeuvring receiver' and 'Future Work'",
)
def manoeuvre(lab: Lab) -> Iterator[Claim]:
    both = ("industrial unit", "consumer unit")
    iq = lab.map(outcome, 1.0, None, ())
    drawn = {
        (name, interval): lab.map(outcome, interval, sigmas, both if interval == 10.0 else both[:1])
        for name, sigmas, intervals in (("paper", SIGMAS_PAPER, (1.0, 5.0, 10.0)), ("bound", SIGMAS_BOUND, (1.0, 10.0)))
        for interval in intervals
    }
    fast = example(lab.seeds[0], 1.0, {})
    slow = example(lab.seeds[0], 10.0, {"industrial unit": INDUSTRIAL})
    with lab.figure(11.0, 9.4) as figure:
        rows = figure.subplots(3, 2, height_ratios=(1.5, 1.0, 0.8))
        _map(rows[0, 0], fast, ("static", "two motions"), "One burst per second, 95 % ellipses", 30)
        _map(rows[0, 1], slow, ("two motions", "industrial unit"), "One burst per ten seconds", 7)
        _errors(rows[1, 0], fast, ("static", "straight", "two motions"), "Errors; dotted: what the filter says")
        _errors(rows[1, 1], slow, ("static", "two motions", "industrial unit"), "Errors; dotted: what the filter says")
        modes = fast.tracks["two motions"]
        rows[2, 0].plot(modes.t_s, modes.modes[:, 1], color="tab:blue", lw=1.0)
        rows[2, 0].set_ylim(0.0, 1.25)
        speed = np.linalg.norm(np.gradient(fast.way_m, fast.t_s, axis=0), axis=1)
        turning = np.linalg.norm(np.gradient(np.gradient(fast.way_m, fast.t_s, axis=0), fast.t_s, axis=0), axis=1)
        rows[2, 0].fill_between(
            fast.t_s, 0.0, 1.0, where=turning > 1.0, color="tab:orange", alpha=0.25, lw=0, label="accelerates"
        )
        rows[2, 0].fill_between(fast.t_s, 0.0, 1.0, where=speed < 0.5, color="0.5", alpha=0.25, lw=0, label="stands")
        rows[2, 0].legend(loc="upper right", fontsize="x-small", framealpha=0.9)
        style(rows[2, 0], "Probability that it manoeuvres", "time [s]", "")
        intervals = (1.0, 5.0, 10.0)
        for name in ("static", "straight", "two motions", "industrial unit"):
            line = [rms(drawn["paper", i], name) for i in intervals]
            rows[2, 1].loglog(intervals, line, "o-", color=COLOURS[name], ms=3, label=name)
        rows[2, 1].set_xticks(intervals, ["1", "5", "10"])
        rows[2, 1].minorticks_off()
        rows[2, 1].set_ylim(20.0, 1.2e4)
        rows[2, 1].legend(loc="upper left", fontsize="x-small", ncol=2)
        style(rows[2, 1], f"RMS over {len(iq)} drives", "seconds between bursts", "error [m]")
    table: list[list[float | str]] = [
        [f"{name} {interval:g} s", tracker, rms(runs, tracker), mean_nees(runs, tracker)]
        for (name, interval), runs in [(("iq", 1.0), iq), *drawn.items()]
        for tracker in runs[0].square
    ]
    lab.table(["bursts", "tracker", "rms_m", "nees_of_4"], table)
    errors: dict[str, Any] = {f"error_{k.replace(' ', '_')}_m": v.error_m for k, v in fast.tracks.items()}
    lab.save(
        t_s=fast.t_s,
        way_m=fast.way_m,
        mode_t_s=modes.t_s,
        manoeuvring=modes.modes[:, 1],
        **errors,
    )
    yield Claim(
        "bursts made, sent through two channels and two clocks and measured by their cross-ambiguity, one per second: "
        "a static model loses the drive, horizontal RMS of the last 240 s in metres",
        rms(iq, "static"),
        above(500.0),
    )
    yield Claim(
        "… and does not notice: mean NEES of its horizontal position, over its dimension of two",
        float(np.mean([run.place_nees["static"] for run in iq])) / 2.0,
        above(100.0),
    )
    yield Claim("… two modes of motion hold it: RMS in metres", rms(iq, "two motions"), below(200.0))
    yield Claim("… static over two modes, RMS", rms(iq, "static") / rms(iq, "two motions"), at_least(5.0))
    yield Claim(
        "… their NEES of the four states stays near 4: mean over the runs", mean_nees(iq, "two motions"), at_most(8.0)
    )
    for name, text in (("paper", "the paper's sigmas"), ("bound", "sigmas of the bound")):
        runs = drawn[name, 10.0]
        yield Claim(
            f"one burst per 10 s, drawn from the exact model with {text}: RMS of two modes over that with an "
            "industrial unit (0.02 m/s², 1e-3 m/s/√s, heading 1°), same bursts",
            rms(runs, "two motions") / rms(runs, "industrial unit"),
            at_least(3.0),
        )
        yield Claim(
            f"… and over that with a consumer unit (0.1 m/s², 3e-3 m/s/√s, heading 3°), {text}",
            rms(runs, "two motions") / rms(runs, "consumer unit"),
            at_least(2.0),
        )
        yield Claim(
            f"… which both stay consistent: mean NEES of their four states, {text}",
            [mean_nees(runs, unit) for unit in both],
            at_most(8.0),
        )
    yield Claim(
        "drawn bursts, the paper's sigmas, 1, 5, 10 s between them: RMS with the industrial unit in metres",
        [rms(drawn["paper", interval], "industrial unit") for interval in (1.0, 5.0, 10.0)],
        below(200.0),
    )
    yield Claim(
        "drawn and measured bursts tell the same: RMS of two modes, one burst per second, drawn over measured",
        rms(drawn["paper", 1.0], "two motions") / rms(iq, "two motions"),
        band(0.5, 2.0),
    )
