"""GPS acquisition by trials against theory: detection and false alarm of searches for a satellite's code."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp.dsp import detection_threshold, marcum_q
from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, below, experiment, near, style
from soopnav_cpp.gps import Acquirer, SatelliteSignal, cell_loss, synthesize

Array = npt.NDArray[np.float64]

RATE_HZ = 2.048e6
PRN = 12  # whose code has no side lobe a chip away
INTERMEDIATE_HZ = 250e3  # and no Doppler: a code that moves would not stay on a cell
RUNS = 20
TRIALS = 150
FALSE_ALARMS = (1e-1, 1e-2, 1e-3)
SEARCH_FALSE_ALARM = 0.2
NOISE_TRIALS = 60
SIGMAS = 4.4  # two-sided 1e-5: many numbers to a claim


class Setting(NamedTuple):
    """A search and the signal it is for."""

    cn0_dbhz: float
    coherent_ms: int
    noncoherent: int
    samples_off: float  # of the delay, from the cell
    steps_off: float  # of the Doppler

    @property
    def step_hz(self) -> float:
        """Between Dopplers."""
        return 500.0 / self.coherent_ms

    @property
    def energy(self) -> float:
        """Of the signal over noise, T C/N0 over all coherent sums."""
        return float(10.0 ** (self.cn0_dbhz / 10.0)) * 1e-3 * self.coherent_ms * self.noncoherent

    @property
    def kept(self) -> float:
        """What a cell that far off keeps of it, by the triangle and the sinc."""
        chips = self.samples_off * 1.023e6 / RATE_HZ
        return cell_loss(chips, self.steps_off * self.step_hz, 1e-3 * self.coherent_ms)

    @property
    def name(self) -> str:
        """For the legend."""
        off = ", between cells" if self.samples_off or self.steps_off else ""
        return f"{self.cn0_dbhz:g} dB-Hz, {self.noncoherent} × {self.coherent_ms} ms{off}"


SETTINGS = (
    Setting(38.0, 1, 1, 0.0, 0.0),
    Setting(32.0, 1, 10, 0.0, 0.0),
    Setting(26.0, 10, 3, 0.0, 0.0),
    Setting(29.0, 10, 3, 0.5, 0.5),
)
COLOURS = ("tab:blue", "tab:green", "tab:red", "tab:purple")


def acquirer(setting: Setting) -> Acquirer:
    """Three Dopplers around zero; noise of variance 1 is known."""
    step = setting.step_hz
    return Acquirer(
        RATE_HZ,
        coherent_ms=setting.coherent_ms,
        noncoherent=setting.noncoherent,
        intermediate_hz=INTERMEDIATE_HZ,
        doppler_hz=(-step, step),
        doppler_step_hz=step,
        false_alarm_probability=SEARCH_FALSE_ALARM,
        noise_variance=1.0,
    )


def signal_at(setting: Setting, sample: int, phase_cycles: float = 0.0) -> SatelliteSignal:
    """The signal that far off the cell of no Doppler and a delay of `sample`."""
    return SatelliteSignal(
        PRN,
        delay_s=(sample + setting.samples_off) / RATE_HZ,
        doppler_hz=setting.steps_off * setting.step_hz,
        phase_cycles=phase_cycles,
        cn0_dbhz=setting.cn0_dbhz,
    )


def clean_energy(setting: Setting) -> float:
    """The cell's statistic without noise: between samples a triangle is right to a few per cent only."""
    search = acquirer(setting)
    iq = synthesize([signal_at(setting, 500)], search.samples, RATE_HZ, intermediate_hz=INTERMEDIATE_HZ)
    search.search(iq, PRN)
    return float(search.surface[1, 500])


def trials(seed: int) -> tuple[Array, Array]:
    """Statistics of the signal's cell with and without the signal; and shares of searches of noise that found it.

    Returns
    -------
    cells : ndarray, shape (settings, trials, 2)
        With the signal; without, another cell of the same search.
    false : ndarray, shape (settings, noise trials)
    """
    rng = np.random.default_rng(seed)
    cells = np.empty((len(SETTINGS), TRIALS, 2))
    false = np.empty((len(SETTINGS), NOISE_TRIALS))
    for i, setting in enumerate(SETTINGS):
        search = acquirer(setting)
        for j in range(TRIALS):
            sample = int(rng.integers(10, 2038))
            signal = signal_at(setting, sample, rng.random())
            iq = synthesize(
                [signal], search.samples, RATE_HZ, intermediate_hz=INTERMEDIATE_HZ, seed=int(rng.integers(2**62))
            )
            search.search(iq, PRN)
            cells[i, j, 0] = search.surface[1, sample]
            iq = synthesize([], search.samples, RATE_HZ, intermediate_hz=INTERMEDIATE_HZ, seed=int(rng.integers(2**62)))
            noise = search.search(iq, PRN)[0]
            cells[i, j, 1] = search.surface[1, sample]
            if j < NOISE_TRIALS:
                false[i, j] = noise.found
    return cells, false


@experiment(
    "pesyna-acquisition",
    title="Acquisition of GPS: detection and false alarm against Marcum's Q",
    source="pesyna section V-D; Kaplan and Hegarty section 5.1",
    runs=RUNS,
)
def acquisition(lab: Lab) -> Iterator[Claim]:
    """Receiver operating curves of four searches."""
    runs = lab.map(trials)
    cells = np.concatenate([run[0] for run in runs], axis=1)  # (settings, trials, 2)
    false = np.concatenate([run[1] for run in runs], axis=1).mean(axis=1)
    count = cells.shape[1]
    off = np.empty((len(SETTINGS), len(FALSE_ALARMS)))
    alarms = np.empty((len(SETTINGS), len(FALSE_ALARMS)))
    detected = np.empty_like(off)
    expected = np.empty_like(off)
    energy = np.array([clean_energy(setting) for setting in SETTINGS])
    kept = energy / np.array([setting.energy * setting.kept for setting in SETTINGS])
    curve = np.logspace(-5.0, 0.0, 61)
    with lab.figure(10.4, 4.6) as figure:
        left, right = figure.subplots(1, 2)
        style(left, f"Receiver operating curves, {count} trials each", "false alarm of a cell", "detection")
        style(right, "Tails of the statistic in noise", "statistic less its mean, over √M", "share of cells above")
        for i, (setting, colour) in enumerate(zip(SETTINGS, COLOURS, strict=True)):
            m, amplitude = setting.noncoherent, math.sqrt(2.0 * energy[i])
            levels = np.array([detection_threshold(m, p) for p in FALSE_ALARMS])
            expected[i] = marcum_q(m, amplitude, np.sqrt(2.0 * levels))
            detected[i] = [(cells[i, :, 0] > level).mean() for level in levels]
            shares = np.array([(cells[i, :, 1] > level).mean() for level in levels])
            off[i] = (detected[i] - expected[i]) / np.sqrt(expected[i] * (1.0 - expected[i]) / count)
            nominal = np.array(FALSE_ALARMS)
            alarms[i] = (shares - nominal) / np.sqrt(nominal * (1.0 - nominal) / count)
            law = [marcum_q(m, amplitude, math.sqrt(2.0 * detection_threshold(m, p))) for p in curve]
            left.semilogx(curve, law, color=colour, lw=1.1)
            every = np.logspace(-3.0, -0.3, 10)
            found = [(cells[i, :, 0] > detection_threshold(m, p)).mean() for p in every]
            left.semilogx(every, found, "o", ms=4, color=colour, label=setting.name)
            ordered = np.sort(cells[i, :, 1])[::-1]
            right.semilogy((ordered - m) / math.sqrt(m), np.arange(1, count + 1) / count, color=colour, lw=1.1)
            shapes = np.array([detection_threshold(m, p) for p in np.logspace(-4, -0.1, 40)])
            right.semilogy((shapes - m) / math.sqrt(m), np.logspace(-4, -0.1, 40), color="0.3", ls=":", lw=1.0)
        left.legend(fontsize=8, loc="lower right")
        right.text(0.97, 0.95, "dotted: gamma law", transform=right.transAxes, ha="right", va="top", fontsize=8)
        right.set_ylim(1e-4, 1.0)
    lab.save(energy=energy, statistics=cells, detected=detected, expected=expected, search_false_alarms=false)
    yield Claim(
        "detection of the signal's cell is Marcum's Q of its energy at false alarms of 0.1, 0.01 and 0.001, on and "
        f"between cells, in four searches of {count} trials: worst difference in standard deviations",
        float(np.abs(off).max()),
        below(SIGMAS),
    )
    yield Claim(
        "the same of false alarms, the gamma law",
        # The rarest one is too rare for a normal band.
        float(np.abs(alarms[:, :2]).max()),
        below(SIGMAS),
    )
    yield Claim(
        "the energy that a cell keeps over (1 - |chips|)² sinc²(Hz T) of the signal's, on cells and amid four of them",
        kept,
        near(1.0, within=0.06),
    )
    tail = 4.1 * math.sqrt(SEARCH_FALSE_ALARM * (1.0 - SEARCH_FALSE_ALARM) / (RUNS * NOISE_TRIALS))
    yield Claim(
        "whole searches of noise find something no more often than asked, 0.2, though cells are correlated",
        float(false.max()),
        at_most(SEARCH_FALSE_ALARM + tail),
    )
    yield Claim("and not much more seldom", float(false.min()), band(0.4 * SEARCH_FALSE_ALARM, 1.0))
