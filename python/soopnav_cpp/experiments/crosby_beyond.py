"""Beyond the paper: boundaries between samples, and timing that knows of a reflection."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from soopnav_cpp import ofdm, simulation
from soopnav_cpp.experiments.crosby_setup import (
    BLUE,
    GREEN,
    GREY,
    RED,
    TOWER,
    Track,
    between,
    coverage,
    distance_m,
    rms,
    scenario,
    solve,
)
from soopnav_cpp.experiments.crosby_tracks import draw_rms
from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, experiment
from soopnav_cpp.scenarios.ofdm_inertial import FilterSettings, OfdmInertialScenario
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import sense

FRACTIONAL = {"movement": "fractional_delay"}


def timed(seed: int) -> tuple[Track, Track, Track]:
    """One drive with true delays: between samples at 20 MHz, nearest sample at 20 MHz and at 300 MHz."""
    tracks = []
    for rate, boundary in ((1, "interpolated"), (1, "nearest_sample"), (15, "nearest_sample")):
        setup = scenario(rate, ofdm={**FRACTIONAL, "boundary": boundary})
        tracks.append(solve(setup, sense(setup, seed)))
    return tracks[0], tracks[1], tracks[2]


def cost_ratio() -> float:
    """CPU time of an interpolated boundary over that of a nearest sample, 250 symbols at 20 MHz: least of many."""
    iq = simulation.OfdmLink(ofdm.Numerology(), 250, movement="fractional_delay").iq(123.4, seed=1)
    best = {}
    for method in ("nearest_sample", "interpolated"):
        estimator = ofdm.BoundaryEstimator(ofdm.Numerology(), 250, method=method)
        estimator.estimate(iq)
        spent = []
        for _ in range(200):
            begin = time.process_time_ns()
            for _ in range(20):
                estimator.estimate(iq)
            spent.append(time.process_time_ns() - begin)
        best[method] = min(spent)
    return best["interpolated"] / best["nearest_sample"]


@experiment("crosby-x1", title="Boundaries between samples", source="beyond crosby: notes on (2.5)", runs=20)
def between_samples(lab: Lab) -> Iterator[Claim]:
    """20 MHz samples time better than 300 MHz ones to the nearest sample."""
    runs = lab.map(timed)
    curves = [rms([item[i] for item in runs]) for i in range(3)]
    tracks = [item[0] for item in runs]
    t = tracks[0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {
                "20 MHz, nearest sample": (curves[1], RED),
                "300 MHz, nearest sample": (curves[2], GREY),
                "20 MHz, between samples": (curves[0], BLUE),
            },
            f"True fractional delays, no noise: RMS over {lab.runs} runs",
        )
    lab.save(t_s=t, rms_interpolated_m=curves[0], rms_20_m=curves[1], rms_300_m=curves[2])
    level = [float(np.sqrt(np.mean(between(tracks, curve, 10.0, 120.0) ** 2))) for curve in curves]
    yield Claim(
        f"position RMS between samples at 20 MHz over that of the nearest sample at 300 MHz, {lab.runs} runs",
        level[0] / level[2],
        at_most(0.85),
    )
    yield Claim(
        "share of X and Y errors within 1σ: clean boundaries are better than the estimator says",
        coverage(tracks),
        band(0.65, 0.90),
    )
    yield Claim(
        "its cost over that of a boundary to the nearest sample, both with correlator and energies",
        cost_ratio(),
        at_most(2.0),
    )


BLOCKS_S = [(20.0, 50.0), (70.0, 100.0)]
VARIANTS = {
    "20 MHz, gate 45 m": (1, "nearest_sample", 45.0),
    "300 MHz, gate 3 m": (15, "nearest_sample", 3.0),
    "20 MHz between samples, gate 3 m": (1, "interpolated", 3.0),
    "20 MHz, aware of the reflection": (1, "two_ray", 15.0),
}


def blocked_setup(rate: int, boundary: str, gate_m: float) -> OfdmInertialScenario:
    """Half of the time every link is reflected, as strong as the line of sight or stronger."""
    tower = TOWER.model_copy(update={"strength": (1.0, 1.5), "blocks_s": BLOCKS_S})
    setup = scenario(rate, ofdm={**FRACTIONAL, "boundary": boundary}, reflector=tower)
    return setup.model_copy(update={"filter": FilterSettings(gate_m=gate_m)})


def blocked(seed: int) -> tuple[Track, ...]:
    """One drive, each way of timing."""
    out = []
    for rate, boundary, gate in VARIANTS.values():
        setup = blocked_setup(rate, boundary, gate)
        out.append(solve(setup, sense(setup, seed)))
    return tuple(out)


@experiment("crosby-x4", title="Timing that knows of a reflection", source="beyond crosby: section 4.4", runs=24)
def aware_of_reflections(lab: Lab) -> Iterator[Claim]:
    """Two blocks of 30 s in which every link has a reflection stronger than the line of sight."""
    runs = lab.map(blocked)
    curves = {name: rms([item[i] for item in runs]) for i, name in enumerate(VARIANTS)}
    t = runs[0][0].t_s
    with lab.figure() as figure:
        draw_rms(
            figure,
            t,
            {
                name: (curve, colour)
                for (name, curve), colour in zip(curves.items(), (RED, GREY, GREEN, BLUE), strict=True)
            },
            f"All links reflected from 20 to 50 s and 70 to 100 s: RMS over {lab.runs} runs",
        )
        for low, high in BLOCKS_S:
            figure.axes[0].axvspan(low, high, color="#22303c", alpha=0.06, linewidth=0.0)
    lab.save(t_s=t, rms_m=np.stack(list(curves.values())))
    level = [float(np.sqrt(np.mean(curve[t >= 10.0] ** 2))) for curve in curves.values()]
    lab.table(["variant", "rms_m"], list(zip(VARIANTS, level, strict=True)), part="rms")
    yield Claim(
        f"position RMS of multipath-aware timing over that of the best gated variant, {lab.runs} runs",
        level[3] / min(level[:3]),
        at_most(0.6),
    )
    yield Claim("share of X and Y errors within 1σ", coverage([item[3] for item in runs]), band(0.45, 0.85))
    yield Claim("its worst position error", max(float(distance_m(item[3]).max()) for item in runs), at_most(45.0, "m"))
