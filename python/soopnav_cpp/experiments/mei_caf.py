"""Delay and Doppler of bursts nobody knows, against their bounds: mei-caf."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp
from soopnav_cpp.experiments.mei_setup import Setup, World, make_world
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.simulation import PairSnippets

Array = npt.NDArray[np.float64]
Prefilter = Literal["ml", "rrc", "box", "none"]

HIGH_DB = (0.0, 5.0, 10.0, 15.0, 20.0)
LOW_DB = (-8.0, -5.0)
SNR_DB = (*LOW_DB, *HIGH_DB)
NOTES_NS = (587.0, 280.0, 147.0, 81.0, 45.0)
BURST_S, SYMBOLS_HZ, OCCUPIED_HZ, RATE_HZ = 90e-3, 25e3, 35e3, 125e3
PAPER_S, PAPER_DB = 32.5e-3, -5.4
OTHERS: tuple[Prefilter, ...] = ("rrc", "box", "none")
BURSTS = 150  # per run and SNR
SHOWN = 60  # of them measured with the other prefilters as well
NORMAL = 3.72  # standard deviations that a normal variable leaves with probability 1e-4


def received(seed: int, snr_db: float, burst_s: float, count: int) -> tuple[World, PairSnippets]:
    """Bursts of random satellites at both receivers; each opens its window when its prediction says so, to a sample."""
    setup = Setup(duration_s=float(count + 8), burst_s=burst_s, snr_db=snr_db, sample_rate_hz=RATE_HZ)
    world = make_world(setup, seed)
    snippets = world.link.bursts(
        world.sky,
        world.beacon[:count],
        start_s=world.start_s[:count],
        carrier_hz=world.carrier_hz,
        duration_s=burst_s,
        snr_db=snr_db,
        guard_s=0.5e-3,
        seed=seed,
        stream=0x6D65_69CA,
    )
    return world, snippets


def measure(world: World, snippets: PairSnippets, prefilter: Prefilter, count: int, narrow: Array | None) -> Array:
    """Errors [s, Hz], reported sigmas [s, Hz] and post-correlation SNR of each burst; NaN where none was detected."""
    out = np.full((count, 5), np.nan)
    truth = snippets.truth
    for i in range(min(count, len(snippets))):
        peak = dsp.cross_ambiguity(
            snippets.target[i],
            snippets.anchor[i],
            snippets.sample_rate_hz,
            max_delay_s=20e-6,
            max_doppler_hz=40e3 if narrow is None else 250.0,
            doppler_center_hz=0.0 if narrow is None else float(narrow[i]),
            bandwidth_hz=OCCUPIED_HZ,
            symbol_rate_hz=SYMBOLS_HZ if prefilter == "rrc" else 0.0,
            prefilter=prefilter,
            carrier_hz=world.carrier_hz,
        )
        if not peak.detected:
            continue
        start_s = snippets.target_start_s[i] - snippets.anchor_start_s[i]
        # The truth is that of the burst's middle; the measurement holds for its epoch, where the delay has moved on.
        late_s = snippets.anchor_start_s[i] + peak.epoch_s - truth.anchor.reading_s[i]
        tdoa_s = start_s + peak.tdoa_s - peak.tdoa_rate * late_s
        out[i] = (
            tdoa_s - truth.tdoa_s[i],
            peak.fdoa_hz - truth.fdoa_hz[i],
            peak.sigma_tdoa_s,
            peak.sigma_fdoa_hz,
            peak.snr_db,
        )
    return out


def trials(seed: int) -> tuple[Array, Array, Array]:
    """Of one run: (SNRs, bursts, 5) by likelihood, (SNRs, others, shown, 5), and the paper's bursts (bursts, 5)."""
    main = np.full((len(SNR_DB), BURSTS, 5), np.nan)
    other = np.full((len(SNR_DB), len(OTHERS), SHOWN, 5), np.nan)
    for s, snr_db in enumerate(SNR_DB):
        world, snippets = received(seed + s, snr_db, BURST_S, BURSTS)
        main[s] = measure(world, snippets, "ml", BURSTS, None)
        for k, prefilter in enumerate(OTHERS):
            other[s, k] = measure(world, snippets, prefilter, SHOWN, None)
    world, snippets = received(seed + len(SNR_DB), PAPER_DB, PAPER_S, BURSTS)
    predicted = 50.0 * np.round(snippets.truth.fdoa_hz / 50.0)  # a track knows the Doppler to some tens of hertz
    return main, other, measure(world, snippets, "ml", BURSTS, predicted)


def rms(values: Array) -> Array:
    """Over the last axis, leaving out what was not detected."""
    return np.asarray(np.sqrt(np.nanmean(np.square(values), axis=-1)), np.float64)


def widened(limit: float, count: int) -> float:
    """A limit on the ratio of an RMS error over `count` bursts to what it is held against."""
    return limit * (1.0 + NORMAL / math.sqrt(2.0 * count))


@experiment(
    "mei-caf", title="Delay and Doppler of unknown bursts at their bound", source="mei slides 9-11; Stein 1981", runs=8
)
def caf(lab: Lab) -> Iterator[Claim]:
    """Bursts through two channels and two clocks, measured by their cross-ambiguity, from the threshold to 20 dB."""
    results = lab.map(trials)
    main = np.concatenate([r[0] for r in results], axis=1)
    other = np.concatenate([r[1] for r in results], axis=2)
    paper = np.concatenate([r[2] for r in results], axis=0)
    n = main.shape[1]
    stein = [dsp.tdoa_fdoa_crlb(SYMBOLS_HZ, BURST_S, s) for s in SNR_DB]
    stochastic = [dsp.tdoa_fdoa_crlb(SYMBOLS_HZ, BURST_S, s, kind="stochastic") for s in SNR_DB]
    by_stein = np.array([(b.sigma_tdoa_s, b.sigma_fdoa_hz) for b in stein]).T
    by_stochastic = np.array([(b.sigma_tdoa_s, b.sigma_fdoa_hz) for b in stochastic]).T
    error = np.stack([rms(main[:, :, 0]), rms(main[:, :, 1])])
    sigma = np.stack([rms(main[:, :, 2]), rms(main[:, :, 3])])
    found = np.mean(np.isfinite(main[:, :, 0]), axis=1)
    others = np.stack([rms(other[..., 0]), rms(other[..., 1])])  # (2, SNRs, others)
    shown = np.concatenate([r[0][:, :SHOWN] for r in results], axis=1)  # the bursts that the others had
    same = np.stack([rms(shown[:, :, 0]), rms(shown[:, :, 1])])
    _figure(lab, error, sigma, by_stein, by_stochastic, others)
    _surface(lab)
    lab.save(
        snr_db=np.array(SNR_DB),
        error=error,
        sigma=sigma,
        stein=by_stein,
        stochastic=by_stochastic,
        found=found,
        others=others,
        errors=main,
        paper=paper,
    )
    lab.table(
        ["snr_db", "tdoa_ns", "over_stein", "over_stochastic", "fdoa_mhz", "over_stein", "over_stochastic", "found"],
        [
            [
                SNR_DB[s],
                1e9 * error[0, s],
                error[0, s] / by_stein[0, s],
                error[0, s] / by_stochastic[0, s],
                1e3 * error[1, s],
                error[1, s] / by_stein[1, s],
                error[1, s] / by_stochastic[1, s],
                found[s],
            ]
            for s in range(len(SNR_DB))
        ],
    )
    high = slice(len(LOW_DB), None)
    limit = widened(1.12, n)
    over = error / by_stein
    words = f"(1.12, and {NORMAL} of the ratio's own errors over {n} bursts)"
    yield Claim(
        f"TDOA error over Stein's bound at 0, 5, 10, 15 and 20 dB, bursts of 90 ms and unknown waveform {words}",
        over[0, high],
        at_most(limit),
    )
    yield Claim(f"FDOA error over Stein's bound at 0 ... 20 dB {words}", over[1, high], at_most(limit))
    low = widened(1.15, int(n * found[0]))
    yield Claim(
        f"TDOA and FDOA error over the stochastic bound at -8 and -5 dB (1.15, and {NORMAL} of the ratio's own errors)",
        (error / by_stochastic)[:, : len(LOW_DB)].ravel(),
        at_most(low),
    )
    spread = NORMAL / math.sqrt(2.0 * n)
    yield Claim(
        "TDOA errors over those of the prototype: 587, 280, 147, 81, 45 ns",
        1e9 * error[0, high] / NOTES_NS,
        band(0.9 * (1.0 - spread), 1.05 * (1.0 + spread)),
    )
    yield Claim(
        "reported sigmas over the errors, TDOA then FDOA, -8 ... 20 dB",
        (sigma / error).ravel(),
        band(1.0 / 1.5, 1.5),
    )
    yield Claim("share of bursts detected at -8 dB, of 40 kHz x 20 us searched to either side", found[0], at_least(0.9))
    yield Claim("share of bursts detected from -5 dB on", found[1:], at_least(0.99))
    plain = others[0] / same[0][:, None]
    yield Claim(
        "TDOA error of a plain root-raised-cosine prefilter over the likelihood's, same bursts, mean of 10 ... 20 dB",
        np.mean(plain[-3:, OTHERS.index("rrc")]),
        band(1.02, 1.15),
    )
    yield Claim(
        "the same with no prefilter but the decimator's, at 0 dB",
        plain[len(LOW_DB), OTHERS.index("none")],
        at_least(1.1),
    )
    heard = np.isfinite(paper[:, 0])
    widths = np.array([1e6 * rms(paper[:, 0]), rms(paper[:, 1])])
    yield Claim(
        "the paper's bursts, 32.5 ms at -5.4 dB, Doppler predicted to 250 Hz: errors over 2.73 µs and 2.19 Hz; "
        f"{np.mean(heard):.3f} of them detected",
        widths / np.array([2.73, 2.19]),
        band(0.85, 1.2),
    )


def _figure(lab: Lab, error: Array, sigma: Array, stein: Array, stochastic: Array, others: Array) -> None:
    names = {"rrc": "root raised cosine", "box": "box", "none": "none"}
    colours = ("#e08e1b", "#8f5db7", "#d1495b")
    with lab.figure(10.4, 7.6) as figure:
        for axis, (name, unit, scale) in enumerate((("TDOA", "ns", 1e9), ("FDOA", "mHz", 1e3))):
            above = figure.add_subplot(2, 2, axis + 1)
            style(above, f"{name} of 90 ms bursts", "", f"error, RMS [{unit}]")
            above.set_yscale("log")
            ticks = (50, 100, 200, 500, 1000, 2000) if axis == 0 else (20, 50, 100, 200, 500)
            above.set_yticks(ticks, [str(tick) for tick in ticks])
            above.minorticks_off()
            below = figure.add_subplot(2, 2, axis + 3)
            style(below, "over Stein's bound", "SNR of both in 25 kHz [dB]", "ratio")
            for axes, unity in ((above, np.full(len(SNR_DB), 1.0 / scale)), (below, stein[axis])):
                axes.plot(SNR_DB, stein[axis] / unity, color="#22303c", label="Stein's bound")
                axes.plot(SNR_DB, stochastic[axis] / unity, color="#22303c", linestyle="--", label="stochastic bound")
                if axes is below:
                    for k, (prefilter, colour) in enumerate(zip(OTHERS, colours, strict=True)):
                        label = f"prefilter: {names[prefilter]}"
                        axes.plot(SNR_DB, others[axis, :, k] / unity, "x", color=colour, markersize=5, label=label)
                axes.plot(
                    SNR_DB, error[axis] / unity, "o", color="#1b6ca8", markersize=6, label="prefilter: likelihood"
                )
                axes.plot(SNR_DB, sigma[axis] / unity, "_", color="#2e933c", markersize=14, label="reported sigma")
            below.set_ylim(0.8, 2.0)
            if axis == 0:
                below.legend(fontsize=8, frameon=False)


def _surface(lab: Lab) -> None:
    world, snippets = received(int(lab.rng("surface").integers(2**31)), 5.0, BURST_S, 1)
    a, b = snippets.target[0], snippets.anchor[0]
    surface = dsp.ambiguity_surface(
        a, b, snippets.sample_rate_hz, bandwidth_hz=OCCUPIED_HZ, carrier_hz=world.carrier_hz
    )
    with lab.figure(6.4, 4.8, part="surface") as figure:
        axes = figure.add_subplot()
        x = surface.doppler_hz - surface.result.fdoa_hz
        y = 1e6 * (surface.delays_s - surface.result.tdoa_s)
        style(axes, "Cross-ambiguity of one burst at 5 dB", "Doppler from the peak [Hz]", "delay from the peak [µs]")
        axes.grid(False)
        image = axes.pcolormesh(x, y, surface.power, shading="auto", cmap="viridis", rasterized=True)
        figure.colorbar(image, ax=axes, label="|C|² / (⟨a, a⟩⟨b, b⟩)")
