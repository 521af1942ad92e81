"""Errors of single runs against the filter's sigma, and their RMS over runs: crosby figs. 4.1 … 4.6."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from soopnav_cpp.experiments.crosby_setup import (
    BLUE,
    GREY,
    MHZ,
    RATES,
    RED,
    Array,
    Track,
    between,
    coverage,
    distance_m,
    rms,
    scenario,
    solve,
)
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, below, experiment, style
from soopnav_cpp.scenarios.ofdm_inertial import FilterSettings
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import sense

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LITERAL = FilterSettings(literal_transition=True)
ALL, ONE = 24, 200


def run(seed: int, rate: int, transmitters: int, literal: bool = False) -> tuple[Track, ...]:
    """One drive: the filter, and on the same sensors with the constant transition where it is asked for."""
    setup = scenario(rate, transmitters=transmitters)
    sensed = sense(setup, seed)
    tracks = (solve(setup, sensed),)
    return (*tracks, solve(setup.model_copy(update={"filter": LITERAL}), sensed)) if literal else tracks


def both_rates(seed: int, transmitters: int) -> tuple[Track, ...]:
    """One drive at both rates with the same inertial sensor, and that sensor alone."""
    tracks = []
    for rate in RATES:
        setup = scenario(rate, transmitters=transmitters)
        sensed = sense(setup, seed)
        tracks.append(solve(setup, sensed))
    return (*tracks, solve(setup, sensed, aided=False))


def draw_errors(figure: Figure, track: Track, title: str, limit_m: float | None = None) -> None:
    """X and Y errors with ± one sigma, one above the other, as the paper draws them."""
    axes = figure.subplots(2, 1, sharex=True)
    for axis, name, pane in zip(range(2), "XY", axes, strict=True):
        style(pane, title if axis == 0 else "", "t [s]" if axis else "", f"{name} error [m]")
        pane.plot(track.t_s, track.error_m[:, axis], color=BLUE, linewidth=1.0, label="error")
        pane.plot(track.t_s, track.sigma_m[:, axis], color=RED, linewidth=0.9, label="± 1σ of the filter")
        pane.plot(track.t_s, -track.sigma_m[:, axis], color=RED, linewidth=0.9)
        if limit_m is not None:
            pane.set_ylim(-limit_m, limit_m)
        pane.legend(frameon=False, fontsize=8.5, loc="upper left", ncols=2)


def _figure(lab: Lab, rate: int, transmitters: int, runs: list[tuple[Track, ...]]) -> list[Track]:
    tracks = [item[0] for item in runs]
    plural = "s" if transmitters > 1 else ""
    with lab.figure(7.2, 5.6) as figure:
        draw_errors(figure, tracks[0], f"{transmitters} transmitter{plural}, {MHZ[rate]}")
    lab.save(
        t_s=tracks[0].t_s,
        error_m=tracks[0].error_m,
        sigma_m=tracks[0].sigma_m,
        rms_m=rms(tracks),
        coverage=[coverage([track]) for track in tracks],
    )
    return tracks


def _pooled_rms(tracks: list[Track]) -> float:
    return float(np.sqrt(np.mean(between(tracks, rms(tracks), 10.0, 120.0) ** 2)))


def _three(lab: Lab, rate: int) -> Iterator[Claim]:
    runs = lab.map(run, rate, 3, True)
    tracks = _figure(lab, rate, 3, runs)
    yield Claim(
        f"share of X and Y errors within 1σ, {lab.runs} runs pooled: about two thirds",
        coverage(tracks),
        band(0.55, 0.80),
    )
    yield Claim(
        "the same with the constant Φ as printed, which leaves ∂v/∂θ out: overconfident",
        coverage([item[1] for item in runs]),
        below(0.50),
    )
    fewer = lab.map(run, rate, 1, runs=12)
    yield Claim(
        "position RMS of one transmitter over that of three, 10 … 120 s",
        _pooled_rms([item[0] for item in fewer]) / _pooled_rms(tracks),
        at_least(3.0),
    )
    if rate != 1:
        slow = lab.map(run, 1, 3, runs=12)
        yield Claim(
            "position RMS at 20 MHz over that at 300 MHz, 10 … 120 s",
            _pooled_rms([item[0] for item in slow]) / _pooled_rms(tracks),
            at_least(3.0),
        )


def _single(lab: Lab, rate: int) -> Iterator[Claim]:
    tracks = _figure(lab, rate, 1, lab.map(run, rate, 1))
    yield Claim(f"share of X and Y errors within 1σ, {lab.runs} runs pooled", coverage(tracks), band(0.55, 0.85))


@experiment(
    "crosby-4.1", title="Three transmitters, 20 MHz: errors and 1σ", source="crosby section 4.1, Fig. 4.1", runs=ALL
)
def figure_4_1(lab: Lab) -> Iterator[Claim]:
    """Three transmitters at 20 MHz."""
    yield from _three(lab, 1)


@experiment(
    "crosby-4.2", title="Three transmitters, 300 MHz: errors and 1σ", source="crosby section 4.1, Fig. 4.2", runs=ALL
)
def figure_4_2(lab: Lab) -> Iterator[Claim]:
    """Three transmitters at 300 MHz."""
    yield from _three(lab, 15)


@experiment(
    "crosby-4.3", title="One transmitter, 20 MHz: errors and 1σ", source="crosby section 4.1, Fig. 4.3", runs=ONE
)
def figure_4_3(lab: Lab) -> Iterator[Claim]:
    """One transmitter at 20 MHz."""
    yield from _single(lab, 1)


@experiment(
    "crosby-4.4", title="One transmitter, 300 MHz: errors and 1σ", source="crosby section 4.1, Fig. 4.4", runs=ONE
)
def figure_4_4(lab: Lab) -> Iterator[Claim]:
    """One transmitter at 300 MHz."""
    yield from _single(lab, 15)


def draw_rms(figure: Figure, t_s: Array, curves: dict[str, tuple[Array, str]], title: str) -> None:
    """RMS of the position error against time, logarithmic."""
    axes = figure.add_subplot()
    style(axes, title, "t [s]", "RMS position error [m]")
    for label, (values, colour) in curves.items():
        axes.semilogy(t_s[1:], values[1:], color=colour, label=label, linewidth=1.3)
    axes.set_ylim(bottom=0.03)
    axes.legend(frameon=False, fontsize=9)


@experiment(
    "crosby-4.5",
    title="RMS error of three transmitters against INS alone",
    source="crosby section 4.2, Fig. 4.5",
    runs=40,
)
def figure_4_5(lab: Lab) -> Iterator[Claim]:
    """Three transmitters bound the error."""
    runs = lab.map(both_rates, 3)
    curves = [rms([item[i] for item in runs]) for i in range(3)]
    ten = [rms([item[i] for item in runs[:10]]) for i in range(3)]
    t = runs[0][0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {"INS alone": (ten[2], GREY), MHZ[1]: (ten[0], RED), MHZ[15]: (ten[1], BLUE)},
            "Three transmitters: RMS over 10 runs",
        )
    lab.save(t_s=t, rms_20_m=curves[0], rms_300_m=curves[1], rms_ins_m=curves[2])
    tracks = [item[0] for item in runs]
    at = {s: int(np.argmin(np.abs(t - s))) for s in (60, 120)}
    yield Claim(
        f"INS alone grows: RMS at 120 s over that at 60 s, {lab.runs} runs",
        curves[2][at[120]] / curves[2][at[60]],
        at_least(2.0),
    )
    for rate, curve in zip(RATES, curves, strict=False):
        early = between(tracks, curve, 10.0, 60.0).max()
        late = between(tracks, curve, 60.0, 120.0).max()
        yield Claim(
            f"{MHZ[rate]}: bounded: largest RMS of the last 60 s over that of 10 … 60 s", late / early, at_most(2.0)
        )
        yield Claim(f"{MHZ[rate]}: INS alone ends so many times above it", curves[2][at[120]] / late, at_least(10.0))


@experiment(
    "crosby-4.6", title="RMS error of one transmitter against INS alone", source="crosby section 4.2, Fig. 4.6", runs=60
)
def figure_4_6(lab: Lab) -> Iterator[Claim]:
    """One transmitter bounds what lies along its line only."""
    runs = lab.map(both_rates, 1)
    curves = [rms([item[i] for item in runs]) for i in range(3)]
    t = runs[0][0].t_s
    radial = [np.sqrt(np.mean([item[i].radial_m ** 2 for item in runs], axis=0)) for i in range(2)]
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {
                "INS alone": (curves[2], GREY),
                MHZ[1]: (curves[0], RED),
                MHZ[15]: (curves[1], BLUE),
                f"{MHZ[1]}, along the line of sight": (radial[0], "#eb9aa4"),
                f"{MHZ[15]}, along the line of sight": (radial[1], "#8fb9d9"),
            },
            f"One transmitter: RMS over {lab.runs} runs",
        )
    lab.save(
        t_s=t,
        rms_20_m=curves[0],
        rms_300_m=curves[1],
        rms_ins_m=curves[2],
        radial_20_m=radial[0],
        radial_300_m=radial[1],
    )
    tracks = [item[0] for item in runs]
    for i, (rate, limit) in enumerate(zip(RATES, (0.75, 0.5), strict=True)):
        early, late = between(tracks, radial[i], 10.0, 60.0).max(), between(tracks, radial[i], 60.0, 120.0).max()
        yield Claim(
            f"{MHZ[rate]}: the component along the line of sight is bounded: largest of the last 60 s over 10 … 60 s",
            late / early,
            at_most(2.0),
        )
        whole = between(tracks, curves[i], 60.0, 120.0).max() / between(tracks, curves[i], 10.0, 60.0).max()
        yield Claim(
            f"{MHZ[rate]}: the position is not: the same ratio of it (“bounded” is true of the line of sight)",
            whole,
            above(1.3),
        )
        yield Claim(f"{MHZ[rate]}: RMS at 120 s over that of INS alone", curves[i][-1] / curves[2][-1], at_most(limit))
    ends = np.array([[distance_m(item[i])[-1] for i in range(3)] for item in runs])
    lab.table(["end_20_m", "end_300_m", "end_ins_m"], ends.tolist())
