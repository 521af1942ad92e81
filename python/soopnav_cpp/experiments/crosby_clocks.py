"""Transmitter clocks: alone, with a reference receiver, and estimated by several mobile ones (crosby 4.5, 5.2)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from soopnav_cpp.experiments.crosby_setup import (
    BLUE,
    DURATION_S,
    GREEN,
    GREY,
    MHZ,
    RATES,
    RED,
    ROWS_HZ,
    Track,
    between,
    compare,
    coverage,
    rms,
    scenario,
    solve,
)
from soopnav_cpp.experiments.crosby_tracks import draw_rms
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, experiment
from soopnav_cpp.scenarios.ofdm_inertial import (
    ClockSettings,
    FilterSettings,
    OfdmInertialScenario,
    ReceiverSettings,
    ReferenceSettings,
    TrajectorySettings,
    TransmitterSettings,
)
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import navigate, sense

RUNS = 40
CLOCKS = ClockSettings(white_frequency_m2ps=0.036, frequency_walk_m2ps3=0.141)


def with_clocks(seed: int, reference: bool) -> tuple[Track, ...]:
    """One drive at each rate with wandering clocks; each without; inertial navigation alone."""
    tracks: list[Track] = []
    for rate in RATES:
        used = ReferenceSettings() if reference else None
        setup = scenario(rate, transmitter_clocks=CLOCKS, reference_receiver=used)
        sensed = sense(setup, seed)
        plain = scenario(rate)
        tracks += [solve(setup, sensed), solve(plain, sense(plain, seed))]
    return (*tracks, solve(setup, sensed, aided=False))


@experiment("crosby-4.14", title="Clock errors", source="crosby section 4.5, Fig. 4.14", runs=RUNS)
def figure_4_14(lab: Lab) -> Iterator[Claim]:
    """Unaided clocks drift away with the position."""
    runs = lab.map(with_clocks, False)
    curves = [rms([item[i] for item in runs]) for i in (0, 2, 4)]
    t = runs[0][0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {"INS alone": (curves[2], GREY), MHZ[1]: (curves[0], RED), MHZ[15]: (curves[1], BLUE)},
            f"Wandering transmitter clocks: RMS over {lab.runs} runs",
        )
    lab.save(t_s=t, rms_20_m=curves[0], rms_300_m=curves[1], rms_ins_m=curves[2])
    for rate, curve in zip(RATES, curves, strict=False):
        yield Claim(
            f"{MHZ[rate]}: RMS at 120 s over that of INS alone, {lab.runs} runs", curve[-1] / curves[2][-1], above(1.0)
        )


@experiment(
    "crosby-4.15", title="Clock errors with a reference receiver", source="crosby section 4.5, Fig. 4.15", runs=3 * RUNS
)
def figure_4_15(lab: Lab) -> Iterator[Claim]:
    """A receiver that stands still takes the clocks out, at the price of its own noise."""
    runs = lab.map(with_clocks, True)
    lost = lab.map(with_clocks, False, runs=10)
    curves = [rms([item[i] for item in runs]) for i in range(5)]
    tracks = [item[0] for item in runs]
    t = tracks[0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {"INS alone": (curves[4], GREY), MHZ[1]: (curves[0], RED), MHZ[15]: (curves[2], BLUE)},
            f"With a reference receiver: RMS over {lab.runs} runs",
        )
    lab.save(t_s=t, rms_20_m=curves[0], rms_300_m=curves[2], plain_20_m=curves[1], plain_300_m=curves[3])
    for i, rate, limit in ((0, 1, 1.8), (2, 15, 1.5)):
        ratio = np.sqrt(np.mean(between(tracks, curves[i], 10.0, 120.0) ** 2))
        ratio /= np.sqrt(np.mean(between(tracks, curves[i + 1], 10.0, 120.0) ** 2))
        yield Claim(f"{MHZ[rate]}: RMS over that with perfect clocks, 10 … 120 s", float(ratio), at_most(limit))
        without = rms([item[i] for item in lost])[-1]
        yield Claim(
            f"{MHZ[rate]}: RMS at 120 s without the reference over that with it",
            without / curves[i][-1],
            at_least(20.0),
        )


RING = tuple((2200.0 * float(np.cos(a)), 2200.0 * float(np.sin(a))) for a in 0.3 + 2.0 * np.pi * np.arange(5) / 5.0)


def mobiles(apart_m: float) -> OfdmInertialScenario:
    """Three receivers on the corners of a triangle inside a ring of five transmitters; no reference receiver."""
    corners = (
        apart_m / np.sqrt(3.0) * np.array([[np.cos(a), np.sin(a)] for a in np.pi / 2 + 2 * np.pi * np.arange(3) / 3])
    )
    turns = ((0.035, 40.0), (-0.030, 47.0), (0.045, 34.0))
    return OfdmInertialScenario(
        system="ofdm_inertial",
        duration_s=DURATION_S,
        output_rate_hz=ROWS_HZ,
        receivers=[
            ReceiverSettings(
                position_m=(float(at[0]), float(at[1])),
                heading_deg=120.0 * i,
                trajectory=TrajectorySettings(turn_rate_radps=turn, turn_period_s=period),
            )
            for i, (at, (turn, period)) in enumerate(zip(corners, turns, strict=True))
        ],
        transmitters=[TransmitterSettings(position_m=at) for at in RING],
        transmitter_clocks=CLOCKS,
        filter=FilterSettings(clock_states=True),
    )


def together(seed: int, apart_m: float) -> tuple[Track, ...]:
    """The three receivers' errors, and the first one's with perfect clocks."""
    setup = mobiles(apart_m)
    sensed = sense(setup, seed)
    run = navigate(setup, sensed)
    tracks = tuple(compare(setup, sensed, run, receiver) for receiver in range(3))
    plain = setup.model_copy(update={"transmitter_clocks": None, "filter": FilterSettings()})
    perfect = sense(plain, seed)
    alone = navigate(plain, perfect)
    return (*tracks, *(compare(plain, perfect, alone, receiver) for receiver in range(3)))


@experiment(
    "crosby-x2",
    title="Mobile receivers estimate the clocks together",
    source="crosby section 5.2, future work",
    runs=30,
)
def without_reference(lab: Lab) -> Iterator[Claim]:
    """Three mobile receivers and five transmitters need no reference receiver when they are far enough apart."""
    far, near = lab.map(together, 1000.0), lab.map(together, 300.0)
    base = lab.map(_base)
    pooled = {
        name: rms([track for item in runs for track in item[first : first + 3]])
        for name, runs, first in (("far", far, 0), ("near", near, 0), ("perfect", far, 3))
    }
    paper = rms(base)
    t = base[0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {
                "300 m apart": (pooled["near"], RED),
                "1000 m apart": (pooled["far"], BLUE),
                "perfect clocks, same five transmitters": (pooled["perfect"], GREEN),
                "perfect clocks, three transmitters (4.5)": (paper, GREY),
            },
            f"Three mobile receivers without a reference, 20 MHz: RMS over {lab.runs} runs",
        )
    lab.save(
        t_s=t, rms_far_m=pooled["far"], rms_near_m=pooled["near"], rms_perfect_m=pooled["perfect"], rms_paper_m=paper
    )
    level = {
        name: float(np.sqrt(np.mean(between(base, v, 10.0, 120.0) ** 2)))
        for name, v in {**pooled, "paper": paper}.items()
    }
    yield Claim(
        "1000 m apart: pooled RMS over that of 4.5 at the same rate, 10 … 120 s",
        level["far"] / level["paper"],
        at_most(2.0),
    )
    yield Claim(
        "share of X and Y errors within 1σ, all receivers",
        coverage([x for item in far for x in item[:3]]),
        band(0.55, 0.80),
    )
    yield Claim("300 m apart it is worse: RMS over that of 1000 m", level["near"] / level["far"], above(1.0))


def _base(seed: int) -> Track:
    setup = scenario(1)
    return solve(setup, sense(setup, seed))
