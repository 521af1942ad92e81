"""A signal too weak for any unaided receiver, found by integrating 100 s coherently: pesyna eq. 16, section V-D."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import coherence, required_cn0_dbhz
from soopnav_cpp.dsp import cell_false_alarm, detection_threshold, marcum_q
from soopnav_cpp.experiments.pesyna_setup import DT_S, EPOCHS, L1_HZ, aided_clock_error, record, stage_3
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, near, style
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.gps import CHIP_RATE_HZ, AidedCorrelator, search_frequencies
from soopnav_cpp.simulation import LinkBand, LinkSource, OpportunityLink

Array = npt.NDArray[np.float64]

INTEGRATION_S = 100.0
BLOCKS = round(INTEGRATION_S / DT_S)
FREQUENCIES_HZ = np.linspace(-0.05, 0.05, 21)  # steps of 0.005 Hz
HALF_CHIPS = np.arange(-2, 3)  # one chip to either side
CELLS = len(FREQUENCIES_HZ) * len(HALF_CHIPS)
FALSE_ALARM = 0.01  # of a whole search
WEAK_DBHZ = -8.0
LEVELS_DBHZ = (-14.0, -12.0, -10.0, WEAK_DBHZ, -6.0, -4.0)
SPLITS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # blocks of one coherent sum
RUNS = 250
NOISES = 12  # for each run's clocks
BAND_SIGMAS = 3.9  # two-sided 1e-4

DEMO_DBHZ = -5.0
DEMO_RATE_HZ = 1.024e6
DEMO_OFFSET_HZ = 0.02
DEMO_HALF_CHIPS = 1

# Half a chip apart, correlations share half of their noise; the triangle of rectangular chips.
SHAPE = np.maximum(0.0, 1.0 - 0.5 * np.abs(HALF_CHIPS[:, None] - HALF_CHIPS[None, :]))
FACTOR = np.linalg.cholesky(SHAPE)


def threshold(sums: int) -> float:
    """Of a search over all cells with so many coherent sums."""
    return detection_threshold(sums, cell_false_alarm(FALSE_ALARM, CELLS))


def noise(rng: np.random.Generator) -> npt.NDArray[np.complex128]:
    """Sums over 0.1 s of noise alone at the five code delays, variance 1, shape (blocks, codes)."""
    parts = rng.normal(0.0, math.sqrt(0.5), (2, BLOCKS, len(HALF_CHIPS)))
    return np.asarray((parts[0] + 1j * parts[1]) @ FACTOR.T, np.complex128)


def highest(sums: npt.NDArray[np.complex128], coherent_blocks: int) -> float:
    """The search's largest statistic."""
    return float(search_frequencies(sums, DT_S, FREQUENCIES_HZ, coherent_blocks=coherent_blocks).max())


def trials(seed: int) -> tuple[Array, Array, Array, Array, float, float]:
    """One receiver's clocks, searched through several noises.

    Returns
    -------
    found : ndarray, shape (levels, noises, 2)
        Aided: whether the true cell passes the threshold, whether any does.
    expected : ndarray, shape (levels,)
        Probability that the true cell does: Marcum's Q with this run's own C² in it.
    unaided : ndarray, shape (splits, noises)
        Whether any cell passes without the aid at -8 dB-Hz.
    false : ndarray, shape (noises,)
        Whether noise alone passes.
    kept : float
        C² of the aided clock at the true cell: over the 100 s, at a frequency up to half a step off.
    squared : float
        C² of it at no frequency, no line taken out of the 100 s.
    """
    rng = np.random.default_rng(seed)
    first = int(rng.integers(0, EPOCHS - BLOCKS + 1))
    window = slice(first, first + BLOCKS)
    aided = aided_clock_error(seed, "tcxo")[window]
    clock = record(seed, "tcxo").receiver_s
    line = np.polynomial.Polynomial.fit(np.arange(len(clock)), clock, 1)
    alone = L1_HZ * (clock - line(np.arange(len(clock))))[window]
    t = DT_S * (np.arange(BLOCKS) + 0.5)
    offset_hz = rng.uniform(-0.0475, 0.0475)
    code = int(rng.integers(len(HALF_CHIPS)))
    cell = int(np.argmin(np.abs(FREQUENCIES_HZ - offset_hz)))
    # The phase grows with the clock's error, the sum turns the other way.
    with_aid = np.exp(-2j * np.pi * (aided - offset_hz * t))
    without = np.exp(-2j * np.pi * (alone - offset_hz * t))
    kept = abs(np.mean(with_aid * np.exp(-2j * np.pi * FREQUENCIES_HZ[cell] * t))) ** 2
    level = threshold(1)
    found = np.empty((len(LEVELS_DBHZ), NOISES, 2))
    unaided = np.empty((len(SPLITS), NOISES))
    false = np.empty(NOISES)
    for j in range(NOISES):
        w = noise(rng)
        false[j] = highest(w, BLOCKS) > level
        for i, cn0 in enumerate(LEVELS_DBHZ):
            amplitude = math.sqrt(DT_S * 10.0 ** (cn0 / 10.0))
            y = w + amplitude * with_aid[:, None] * SHAPE[code]
            surface = search_frequencies(y, DT_S, FREQUENCIES_HZ)
            found[i, j] = surface[code, cell] > level, surface.max() > level
            if cn0 == WEAK_DBHZ:
                bare = w + amplitude * without[:, None] * SHAPE[code]
                for k, split in enumerate(SPLITS):
                    unaided[k, j] = highest(bare, split) > threshold(BLOCKS // split)
    snr = INTEGRATION_S * 10.0 ** (np.array(LEVELS_DBHZ) / 10.0) * kept
    expected = marcum_q(1, np.sqrt(2.0 * snr), math.sqrt(2.0 * level))
    squared = float(coherence(aided, DT_S, INTEGRATION_S, detrend=False)[0] ** 2)
    return found, expected, unaided, false, float(kept), squared


def satellite(duration_s: float) -> tuple[SampledOrbit, Array]:
    """A satellite on a circle of a GPS orbit's radius, and a receiver on the equator that sees it high."""
    radius, turn, earth = 26_560e3, 1.4585e-4, 7.292115e-5
    t = np.arange(-10.0, duration_s + 20.0, 10.0)
    slope = math.radians(55.0)
    angle = turn * t + 0.3
    inertial = radius * np.stack([np.cos(angle), np.cos(slope) * np.sin(angle), np.sin(slope) * np.sin(angle)])
    moving = radius * turn * np.stack([-np.sin(angle), np.cos(slope) * np.cos(angle), np.sin(slope) * np.cos(angle)])
    c, s = np.cos(earth * t), np.sin(earth * t)
    p = np.stack([c * inertial[0] + s * inertial[1], -s * inertial[0] + c * inertial[1], inertial[2]], axis=1)
    v = np.stack([c * moving[0] + s * moving[1], -s * moving[0] + c * moving[1], moving[2]], axis=1)
    v -= np.stack([-earth * p[:, 1], earth * p[:, 0], np.zeros(len(t))], axis=1)
    return SampledOrbit(-10.0, 10.0, p, v), np.array([6_378_137.0, 0.0, 0.0])


def demonstration(seed: int) -> Array:
    """Surfaces of one search in samples, aided and not, shape (2, codes, frequencies).

    102 million samples of a satellite 100 s long, data bits known, the receiver's clock straight between tenths of a
    second.
    """
    found = record(seed, "tcxo")
    estimate = stage_3(found, found.sources).bias_s[:, 0]
    nodes = BLOCKS + 2
    bits = np.where(np.random.default_rng(seed).random(500) < 0.5, -1, 1).tolist()
    orbit, position = satellite(INTEGRATION_S)
    link = OpportunityLink(
        [LinkBand(L1_HZ, DEMO_RATE_HZ)],
        [LinkSource.gps(7, 0, orbit, cn0_dbhz=DEMO_DBHZ, bits=bits)],
        position_e_m=position,
        duration_s=INTEGRATION_S,
        clock_bias_s=found.receiver_s[:nodes],
        step_s=DT_S,
        seed=seed,
    )
    steps = np.arange(len(estimate))
    left = found.receiver_s - estimate
    line = np.polynomial.Polynomial.fit(steps, left, 1)(steps)  # what the search is for: its frequency and delay
    clock = np.polynomial.Polynomial.fit(steps, found.receiver_s, 1)(steps)
    of_clock = ((estimate + line)[:nodes], clock[:nodes])
    correlators = [
        AidedCorrelator(7, sample_rate_hz=DEMO_RATE_HZ, block_s=DT_S, max_blocks=BLOCKS, bits=bits) for _ in of_clock
    ]
    known = link.delay_s(0) - found.receiver_s[:nodes]  # range and the satellite's clock
    samples = correlators[0].block_samples
    for block in range(BLOCKS):
        iq = link.render(0, block * samples, samples)
        for correlator, bias in zip(correlators, of_clock, strict=True):
            delay = known + bias
            t = block * DT_S
            doppler = -L1_HZ * (delay[block + 1] - delay[block]) / DT_S
            if not correlator.push(
                iq,
                transmit_time_s=t - delay[block] + 0.5 * DEMO_HALF_CHIPS / CHIP_RATE_HZ,
                carrier_phase_cycles=L1_HZ * delay[block] + DEMO_OFFSET_HZ * t,
                doppler_hz=doppler - DEMO_OFFSET_HZ,
            ):
                raise RuntimeError(f"block {block} was refused")
    surfaces = [search_frequencies(c.sums, DT_S, FREQUENCIES_HZ, variance=float(samples)) for c in correlators]
    return np.array(surfaces)


@experiment(
    "pesyna-16",
    title="A GPS signal of -8 dB-Hz, found in 100 s with the clock that basestations give",
    source="pesyna eq. 16, section V-D",
    runs=RUNS,
)
def weak_signal(lab: Lab) -> Iterator[Claim]:
    """Assisted search of 105 cells with the aided clock, and without."""
    runs = lab.map(trials)
    found = np.array([run[0] for run in runs])  # (runs, levels, noises, 2)
    expected = np.array([run[1] for run in runs])
    unaided = np.array([run[2] for run in runs]).mean(axis=(0, 2))
    false = np.array([run[3] for run in runs])
    kept, squared = (np.array([run[i] for run in runs]) for i in (4, 5))
    surfaces = demonstration(lab.seeds[0])
    weak = LEVELS_DBHZ.index(WEAK_DBHZ)
    share = found.mean(axis=(0, 2))
    spread = np.sqrt((expected * (1.0 - expected)).sum(axis=0) / NOISES) / len(expected)
    mean = expected.mean(axis=0)
    fine = np.linspace(LEVELS_DBHZ[0], LEVELS_DBHZ[-1], 61)
    level = threshold(1)

    def law(c2: Array) -> Array:
        snr = INTEGRATION_S * 10.0 ** (fine[:, None] / 10.0) * c2
        return np.asarray(marcum_q(1, np.sqrt(2.0 * snr), math.sqrt(2.0 * level)).mean(axis=1), np.float64)

    with lab.figure(10.4, 7.2) as figure:
        upper, lower = figure.subplots(2, 2)
        names = ("clock from basestations", "TCXO alone")
        for axes, surface, name in zip(upper, surfaces, names, strict=True):
            style(axes, f"Samples, {DEMO_DBHZ:g} dB-Hz, {name}", "frequency [Hz]", "|sum|² over noise")
            for half, row in zip(HALF_CHIPS, surface, strict=True):
                axes.plot(FREQUENCIES_HZ, row, marker="o", ms=2.5, lw=1.0, label=f"{half / 2:+g} chip")
            axes.axhline(level, color="0.4", ls="--", lw=1.0)
            axes.text(-0.05, level, "threshold ", va="bottom", ha="left", fontsize=8, color="0.3")
            axes.set_ylim(0.0, 1.1 * surfaces.max())
        upper[0].legend(fontsize=8, title="code", title_fontsize=8)
        axes = lower[0]
        style(axes, f"Detection, {found.shape[0] * NOISES} trials", "C/N0 [dB-Hz]", "probability")
        axes.plot(fine, law(np.ones(1)), color="0.6", lw=1.0, label="Marcum Q, C² = 1")
        axes.plot(fine, law(kept), color="tab:blue", lw=1.2, label="Marcum Q over the runs' C² there")
        axes.errorbar(
            LEVELS_DBHZ,
            share[:, 0],
            BAND_SIGMAS * spread,
            fmt="o",
            ms=4,
            capsize=3,
            color="tab:blue",
            label="true cell",
        )
        axes.plot(LEVELS_DBHZ, share[:, 1], "x", color="tab:green", label="any cell")
        axes.axvline(WEAK_DBHZ, color="0.7", lw=0.8)
        axes.legend(fontsize=8, loc="upper left")
        axes = lower[1]
        style(axes, f"Without the aid, {WEAK_DBHZ:g} dB-Hz", "coherent sum [s]", "probability of detection")
        axes.semilogx(DT_S * np.array(SPLITS), unaided, "o-", color="tab:red", label="TCXO alone")
        axes.axhline(share[weak, 1], color="tab:green", ls="--", lw=1.0, label="with the aid, 100 s")
        axes.set_ylim(0.0, 1.0)
        axes.legend(fontsize=8, loc="center right")
    lab.save(
        cn0_dbhz=np.array(LEVELS_DBHZ),
        detected=share,
        expected=mean,
        squared_coherence=squared,
        kept=kept,
        split_s=DT_S * np.array(SPLITS),
        unaided=unaided,
        false_alarms=false,
        surfaces=surfaces,
    )
    count = false.size
    yield Claim(
        "coherence 0.8 over 100 s and 11 dB need a C/N0 of -8 dB-Hz",
        required_cn0_dbhz(INTEGRATION_S, 0.8, 11.0),
        near(WEAK_DBHZ, within=0.05, unit="dB-Hz"),
    )
    margin = BAND_SIGMAS * float(spread[weak])
    yield Claim(
        f"at -8 dB-Hz the true cell of an assisted search (105 cells, 1 % false alarm, data known, code on a cell) "
        f"passes as often as Marcum's Q says with each run's C² ({found.shape[0]} clocks × {NOISES} noises; 1e-4 band)",
        float(share[weak, 0]),
        band(float(mean[weak]) - margin, float(mean[weak]) + margin),
    )
    yield Claim("the search detects at -8 dB-Hz", float(share[weak, 1]), at_least(0.7))
    yield Claim(
        f"false alarms of the search in noise, {count} trials: 1 % or less",
        float(false.mean()),
        at_most(FALSE_ALARM + 3.72 * math.sqrt(FALSE_ALARM / count)),
    )
    yield Claim(
        "without the aid the TCXO's receiver does not detect it, whatever the split into coherent sums",
        float(unaided.max()),
        at_most(0.15),
    )
