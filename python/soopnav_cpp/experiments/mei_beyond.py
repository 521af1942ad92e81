"""Several targets, FM stations and aircraft: what mei leaves for the future."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.estimation import error_ellipse
from soopnav_cpp.experiments import mei_beacons
from soopnav_cpp.experiments.mei_beacons import Spread, fm_errors, skies, spreads
from soopnav_cpp.experiments.mei_targets import TARGETS, Errors, followed, shared_noise
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, below, condition, experiment, style
from soopnav_cpp.navigation import shared_anchor_correlation
from soopnav_cpp.plotting import ellipse_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

PARTIES = 100
STARTS = 32
DRAWS = 200
FM_CHUNKS, FM_TRIALS = 8, 50
SNRS_DB = (0.0, 10.0, 20.0)
NOISE_CHUNKS, NOISE_TRIALS = 8, 75
KINDS = ("satellites", "fm", "aircraft")
LABELS = {"satellites": "satellites", "fm": "and FM stations", "aircraft": "and aircraft"}
COLOURS = {"satellites": "tab:red", "fm": "tab:blue", "aircraft": "tab:green"}


def _correlations(errors: Array) -> tuple[float, float]:
    """Of both targets' TDOA errors, and of their FDOA errors."""
    first, second = errors[:, 0], errors[:, 1]
    return (
        float(np.corrcoef(first[:, 0], second[:, 0])[0, 1]),
        float(np.corrcoef(first[:, 1], second[:, 1])[0, 1]),
    )


def _ground(parties: list[dict[str, Errors]], how: str) -> Array:
    return np.array([one[how].ground_m for one in parties])


def _rms(error: Array, axis: tuple[int, ...] | int) -> Array:
    """Root mean square of horizontal errors (..., 2)."""
    return np.asarray(np.sqrt(np.mean(np.sum(error**2, axis=-1), axis=axis)))


def _nees(parties: list[dict[str, Errors]], how: str) -> tuple[float, float, float]:
    """Mean NEES over its dimension: of all states, of their differences, of their mean."""
    found = [one[how] for one in parties]
    return (
        float(np.mean([e.nees for e in found])) / (8 * TARGETS),
        float(np.mean([e.apart for e in found])) / (8 * (TARGETS - 1)),
        float(np.mean([e.together for e in found])) / 8,
    )


def _draw_scatter(axes: Axes, errors: Array, snr_db: float) -> None:
    ns = 1e9 * errors[:, :2, 0]
    axes.plot(ns[:, 0], ns[:, 1], ".", color="tab:blue", ms=2.5)
    points = ellipse_points(error_ellipse(np.cov(ns.T), probability=0.95))
    axes.plot(*points.T, color="tab:red", lw=1.2, label="95 %")
    axes.set_aspect("equal")
    axes.legend(loc="upper left", fontsize="x-small")
    style(axes, f"TDOA errors, one burst, {snr_db:g} dB", "target 1 [ns]", "target 2 [ns]")


def _draw_map(axes: Axes, seed: int) -> None:
    sky = skies(seed)
    for k, flight in enumerate(sky.aircraft_m):
        axes.plot(*(flight[:, :2] / 1e3).T, color="tab:green", lw=1.2, label="aircraft, 300 s" if k == 0 else None)
        axes.plot(*(flight[-1, :2] / 1e3), ">", color="tab:green", ms=4)
    axes.plot(*(sky.stations_m[:, :2] / 1e3).T, "^", color="tab:blue", ms=7, label="FM station")
    anchor = sky.frame.position_from_ecef(sky.anchor_e_m)[:2] / 1e3
    axes.plot(*anchor, "s", color="0.2", ms=5, label="anchor")
    axes.plot(0.0, 0.0, "o", color="tab:red", ms=5, label="target")
    axes.set_xlim(-60.0, 60.0)
    axes.set_ylim(-60.0, 60.0)
    axes.set_aspect("equal")
    axes.legend(loc="upper right", fontsize="x-small", framealpha=0.9)
    style(axes, "One start", "east [km]", "north [km]")


def _draw_ellipses(axes: Axes, spread: dict[str, Spread]) -> None:
    for kind in KINDS:
        shown = spread[kind]
        axes.plot(*shown.error_m[:100].T, ".", color=COLOURS[kind], ms=2.5, alpha=0.6)
        points = ellipse_points(error_ellipse(shown.covariance_m2, probability=0.95))
        axes.plot(*points.T, color=COLOURS[kind], lw=1.3, label=LABELS[kind])
    reach = max(3.2 * spread["fm"].rms_m, 1.9 * spread["satellites"].rms_m)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.legend(loc="upper right", fontsize="x-small", framealpha=0.9)
    style(axes, "Errors there, and 95 % of the tracker's", "east [m]", "north [m]")


@experiment(
    "mei-x2",
    title="Several targets with one anchor; FM stations and aircraft as beacons",
    runs=PARTIES,
    source="mei slide 'Future Work'",
)
def beyond(lab: Lab) -> Iterator[Claim]:
    parties = lab.map(followed)
    chunks = {snr: lab.map(shared_noise, NOISE_TRIALS, snr, runs=NOISE_CHUNKS) for snr in SNRS_DB}
    noise = {snr: np.concatenate(parts) for snr, parts in chunks.items()}
    starts = lab.map(spreads, DRAWS, runs=STARTS)
    fm = np.concatenate(lab.map(fm_errors, FM_TRIALS, runs=FM_CHUNKS))

    measured = np.array([_correlations(noise[snr]) for snr in SNRS_DB])
    expected = np.array([shared_anchor_correlation(snr, snr, snr) for snr in SNRS_DB])
    with_shared, without = _nees(parties, "together"), _nees(parties, "apart")
    rms = {kind: np.array([start[kind].rms_m for start in starts]) for kind in KINDS}
    worst = {kind: float(rms[kind].max()) for kind in KINDS}

    with lab.figure(11.0, 3.7, part="targets") as figure:
        axes = figure.subplots(1, 3)
        _draw_scatter(axes[0], noise[10.0], 10.0)
        snr = np.linspace(-5.0, 25.0, 61)
        axes[1].plot(snr, [shared_anchor_correlation(s, s, s) for s in snr], color="0.3", lw=1.2, label="γ / (2γ + 1)")
        axes[1].plot(SNRS_DB, measured[:, 0], "o", color="tab:blue", ms=5, label="TDOA")
        axes[1].plot(SNRS_DB, measured[:, 1], "x", color="tab:red", ms=6, label="FDOA")
        axes[1].set_ylim(0.0, 0.7)
        axes[1].legend(loc="lower right", fontsize="small")
        style(axes[1], "Correlation through the anchor's noise", "SNR in the band [dB]", "")
        at = np.arange(3)
        axes[2].bar(at - 0.2, with_shared, 0.38, color="tab:blue", label="anchor's noise and clock shared")
        axes[2].bar(at + 0.2, without, 0.38, color="tab:red", label="rows taken as independent")
        axes[2].axhline(1.0, color="0.3", lw=0.8)
        axes[2].set_ylim(0.0, 2.3)
        axes[2].set_xticks(at, ["all states", "differences", "mean"])
        axes[2].legend(loc="upper left", fontsize="x-small")
        style(axes[2], f"NEES over its dimension, {len(parties)} runs", "", "")
    with lab.figure(11.0, 7.6, part="beacons") as figure:
        axes = figure.subplots(2, 2)
        shown = int(np.argsort(rms["satellites"])[STARTS // 2])
        _draw_map(axes[0, 0], lab.seeds[shown])
        _draw_ellipses(axes[0, 1], starts[shown])
        order = np.argsort(rms["satellites"])
        for kind in KINDS:
            axes[1, 0].semilogy(rms[kind][order], "o-", color=COLOURS[kind], ms=3, lw=1.0, label=LABELS[kind])
        axes[1, 0].axhline(60.0, color="0.4", lw=0.8, ls="--")
        axes[1, 0].legend(loc="upper left", fontsize="small")
        style(axes[1, 0], f"RMS error of {STARTS} starts", "start, by its satellites", "horizontal [m]")
        axes[1, 1].plot(1e6 * fm[:, 0], fm[:, 1], ".", color="tab:blue", ms=3)
        points = ellipse_points(error_ellipse(np.diag([0.5**2, 0.5**2]), probability=0.95))
        axes[1, 1].plot(*points.T, color="tab:red", lw=1.2, label="95 % of 0.5 µs and 0.5 Hz")
        axes[1, 1].set_aspect("equal", adjustable="datalim")
        axes[1, 1].legend(loc="upper left", fontsize="small")
        length_ms, snr_db = 1e3 * mei_beacons.FM_BURST_S, mei_beacons.FM_SNR_DB
        style(axes[1, 1], f"FM, {length_ms:g} ms at {snr_db:g} dB: errors", "TDOA [µs]", "FDOA [Hz]")
    by_kind: dict[str, Any] = {f"rms_{kind}_m": rms[kind] for kind in KINDS}
    lab.save(
        snr_db=SNRS_DB,
        correlation=measured,
        expected=expected,
        fm_errors=fm,
        **by_kind,
    )

    # A correlation of n trials has deviation (1 - r²) / sqrt(n); both noise and its formula's flat spectrum: 0.04.
    room = 4.5 * float(np.max(1.0 - expected**2)) / math.sqrt(NOISE_CHUNKS * NOISE_TRIALS) + 0.04
    yield Claim(
        "two targets' TDOAs of one burst by cross-ambiguity, 0, 10, 20 dB: correlation through the anchor's noise, "
        "less γ/(2γ + 1)",
        measured[:, 0] - expected,
        band(-room, room),
    )
    yield Claim("… and of their FDOAs", measured[:, 1] - expected, band(-room, room))
    together, alone = _ground(parties, "together"), _ground(parties, "alone")
    yield Claim(
        "three targets followed together (bursts drawn, 10 dB, sigmas of the bound): RMS of each over its RMS alone",
        _rms(together, 0) / _rms(alone, 0),
        at_most(1.1),
    )
    apart = together[:, 1:] - together[:, :1]
    yield Claim(
        "error of the vector from one target to another over that of a single position: anchor's errors cancel",
        float(_rms(apart, (0, 1))) / float(_rms(together, (0, 1))),
        below(math.sqrt(2.0)),
    )
    # Mean NEES over its dimension has deviation sqrt(2 / (dimension * parties)): 4.5 of them.
    widths = [4.5 * math.sqrt(2.0 / (d * len(parties))) for d in (8 * TARGETS, 8 * (TARGETS - 1), 8)]
    for name, value, width in zip(
        ("all 24 states", "the differences of the targets' states", "their mean"), with_shared, widths, strict=True
    ):
        yield Claim(
            f"with the anchor's shared noise and clock the joint covariance is right: NEES of {name} over its "
            "dimension",
            value,
            band(1.0 - width, 1.0 + width),
        )
    yield Claim(
        "with rows and clocks taken as independent it is not: NEES of differences too small, of the mean too large "
        "(over all 24 states both wrongs cancel: the trace does not see what lies beside the diagonal blocks)",
        [without[1], without[2]],
        condition(
            f"< {1.0 - widths[1]:.3g} and > {1.0 + widths[2]:.3g}",
            lambda m: m[0] < 1.0 - widths[1] and m[1] > 1.0 + widths[2],
        ),
    )
    yield Claim(
        f"TCXO target in Canberra, {STARTS} starts of {DRAWS} runs, drawn bursts each 3 s: worst start's RMS with "
        "satellites alone over that with every third burst from three FM stations (0.5 µs, 0.5 Hz)",
        worst["satellites"] / worst["fm"],
        at_least(5.0),
    )
    yield Claim("… the worst start with FM stations, in metres", worst["fm"], below(60.0))
    yield Claim(
        "… the worst start with three aircraft instead (0.1 µs, 20 Hz), in metres", worst["aircraft"], below(60.0)
    )
    yield Claim(
        "… every tracker says so: NEES of the horizontal position over the starts, satellites, FM, aircraft",
        [float(np.mean([start[kind].nees for start in starts])) for kind in KINDS],
        band(1.6, 2.6),
    )
    length_ms, snr_db = 1e3 * mei_beacons.FM_BURST_S, mei_beacons.FM_SNR_DB
    yield Claim(
        f"FM waveform through two channels and clocks, {length_ms:g} ms at {snr_db:g} dB in 200 kHz, by "
        "cross-ambiguity: RMS error of TDOA [µs] and FDOA [Hz]",
        np.sqrt(np.mean(fm**2, axis=0)) * np.array([1e6, 1.0]),
        band(0.4, 0.6),
    )
