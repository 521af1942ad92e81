"""Carrier phase of a CDMA pilot and of GPS from samples: its noise against theory, thermal and oscillator."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import cdma, gps, tracking
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style

_Array = npt.NDArray[np.float64]

LEVELS_DBHZ = (25.0, 30.0, 35.0, 40.0, 45.0, 50.0)
BANDWIDTHS_HZ = {25.0: 5.0, 30.0: 8.0}
"""Of the carrier loop at a C/N0; 10 Hz elsewhere."""
OSCILLATORS = {"OCXO": (1e-23, 1e-25), "TCXO": (1e-20, 1e-22)}
"""h0 [s] and h-2 [Hz] of the receiver's oscillator."""
WEAKEST_DBHZ = {("gps", "TCXO"): 30.0}
"""Where a Costas loop on a TCXO would begin to slip, the row begins."""
RECORDS = {("gps", 25.0): 16, ("cdma", 25.0): 10}
"""Records of a signal and C/N0, six elsewhere: σ of one record wanders by 0.5 dB, at 25 dB-Hz about 0.2 off theory."""
RATE_HZ = 1.5e6
STEP = 300  # samples over which an oscillator's phase stands
SETTLE_EPOCHS = 20
SECONDS = 20
INTEGRATION_S = 20e-3
EPOCH_S = 0.1
DOPPLER_HZ = 31.0
CARRIERS_HZ = {"cdma": cdma.CARRIER_HZ, "gps": gps.CARRIER_HZ}


def bandwidth_hz(cn0_dbhz: float) -> float:
    """Of the carrier loop at a C/N0."""
    return BANDWIDTHS_HZ.get(cn0_dbhz, 10.0)


def cases(kind: str) -> list[tuple[str, float]]:
    """Oscillator and C/N0 of every point of a signal."""
    return [
        (name, level) for name in OSCILLATORS for level in LEVELS_DBHZ if level >= WEAKEST_DBHZ.get((kind, name), 0.0)
    ]


def oscillator_phase(seed: int, carrier_hz: float, h0: float, h_minus_2: float, count: int) -> _Array:
    """Phase [cycles] of a two-state clock at the begin of every step, negative: a fast clock sees carriers lower."""
    noise = tracking.PhaseNoise.from_allan(h0, h_minus_2, carrier_hz)
    dt = STEP / RATE_HZ
    rng = np.random.default_rng(seed)
    rate = np.cumsum(rng.normal(0.0, math.sqrt(noise.frequency_walk_cycles2ps3 * dt), count))
    steps = rate * dt + rng.normal(0.0, math.sqrt(noise.white_frequency_cycles2ps * dt), count)
    return np.asarray(-np.cumsum(steps), dtype=np.float64)


def samples_of(kind: str, cn0_dbhz: float, seed: int, second: int) -> npt.NDArray[np.complex64]:
    """One second of the signal in noise."""
    count = int(RATE_HZ)
    first = second * count
    if kind == "cdma":
        pilot = cdma.PilotSignal(7, delay_s=1.7e-3, doppler_hz=DOPPLER_HZ, cn0_dbhz=cn0_dbhz)
        return cdma.synthesize([pilot], count, RATE_HZ, first=first, seed=seed)
    bits = np.random.default_rng(seed).choice([-1, 1], 997).tolist()
    satellite = gps.SatelliteSignal(7, delay_s=1.7e-3, doppler_hz=DOPPLER_HZ, cn0_dbhz=cn0_dbhz, bits=bits)
    return gps.synthesize([satellite], count, RATE_HZ, first=first, seed=seed)


def run(seed: int, kind: str, cn0_dbhz: float) -> dict[str, _Array]:
    """One record: for each oscillator errors of the observable and of the loop [cycles], and the C/N0.

    Columns of each array: observable, loop, C/N0 over its truth, locked, σ of the C/N0 so.
    """
    signal = tracking.Signal.cdma_pilot(7) if kind == "cdma" else tracking.Signal.gps_l1(7)
    names = [name for name, level in cases(kind) if level == cn0_dbhz]
    per_second = int(RATE_HZ) // STEP
    phases, trackers, parts = {}, {}, {}
    for k, name in enumerate(names):
        h0, h_minus_2 = OSCILLATORS[name]
        phases[name] = oscillator_phase(seed + k + 1, CARRIERS_HZ[kind], h0, h_minus_2, per_second * SECONDS)
        trackers[name] = tracking.Tracker(
            signal,
            RATE_HZ,
            delay_s=1.7e-3,
            doppler_hz=DOPPLER_HZ,
            integration_s=INTEGRATION_S,
            pll_bandwidth_hz=bandwidth_hz(cn0_dbhz),
            epoch_s=EPOCH_S,
            pull_in_s=0.0,
            symbol_known=True,
        )
        parts[name] = [trackers[name].push(np.empty(0, np.complex64))]
    for second in range(SECONDS):
        iq = samples_of(kind, cn0_dbhz, seed, second).reshape(per_second, STEP)
        for name in names:
            turn = phases[name][second * per_second : (second + 1) * per_second]
            phasor = np.exp(2j * np.pi * turn).astype(np.complex64)
            parts[name].append(trackers[name].push((iq * phasor[:, None]).ravel()))
    out = {}
    for name in names:

        def joined(field: str, parts: list[tracking.Epochs] = parts[name]) -> _Array:
            return np.concatenate([np.asarray(getattr(part, field), dtype=np.float64) for part in parts])

        def truth(t: _Array, phase: _Array = phases[name]) -> _Array:
            step = np.minimum((t * RATE_HZ / STEP).astype(int), len(phase) - 1)
            return np.asarray(-(DOPPLER_HZ * t + phase[step]), dtype=np.float64)

        observable = joined("carrier_phase_cycles") - truth(joined("t_s"))
        loop = joined("loop_phase_cycles") - truth(joined("loop_t_s") - 0.5 / RATE_HZ)
        level = joined("cn0_hz") * 10.0 ** (-cn0_dbhz / 10.0)
        sigma = joined("cn0_sigma_hz") * 10.0 ** (-cn0_dbhz / 10.0)
        table = np.column_stack([observable, loop, level, joined("phase_locked"), sigma])[SETTLE_EPOCHS:]
        table[:, :2] -= table[:, :2].mean(axis=0)  # the ambiguity
        out[name] = table
    return out


def theory(kind: str, oscillator: str, cn0_dbhz: float) -> tuple[float, float]:
    """σ of the observable and of the loop's phase [cycles]."""
    noise = tracking.PhaseNoise.from_allan(*OSCILLATORS[oscillator], CARRIERS_HZ[kind])
    wander = tracking.window_sigma_cycles(noise, EPOCH_S)
    window, loop = 0.0, 0.0
    for _ in range(4):
        # A replica off by a phase of variance s² leaves exp(-s²) of the prompt's power.
        left_dbhz = cn0_dbhz - 10.0 / math.log(10.0) * (2.0 * math.pi * loop) ** 2
        window = math.hypot(tracking.phase_sigma_cycles(left_dbhz, EPOCH_S), wander)
        # Both arctangents lose as Costas' does: the variance of a phase in noise is 1/(2 rho) (1 + 1/(2 rho)).
        mean = tracking.phase_sigma_cycles(left_dbhz, INTEGRATION_S, costas_integration_s=INTEGRATION_S)
        variance = tracking.loop_variance(
            2, bandwidth_hz(cn0_dbhz), INTEGRATION_S, mean_variance=mean**2, oscillator=noise
        )
        loop = math.sqrt(variance.thermal_phase + variance.oscillator_phase)
    return window, loop


@experiment(
    "pesyna-tracking",
    title="Carrier phase of a CDMA pilot and of GPS from samples reaches theory",
    source="pesyna sections III-B and V; issue: tracking bar",
    runs=16,
)
def pesyna_tracking(lab: Lab) -> Iterator[Claim]:
    """Six records of 20 s or more for every signal and C/N0, on two oscillators; pooled over the records."""
    measured: dict[str, list[float]] = {}
    ratios: dict[str, list[float]] = {"observable": [], "loop": []}
    bias: list[float] = []
    spread: list[float] = []
    locked: list[float] = []
    with lab.figure() as figure:
        figure.set_size_inches(10.0, 4.2)
        axes = figure.subplots(1, 2, sharey=True)
        for axis, kind, title in zip(axes, ("cdma", "gps"), ("CDMA pilot", "GPS L1 C/A"), strict=True):
            pooled: dict[tuple[str, float], list[_Array]] = {}
            for level in LEVELS_DBHZ:
                for record in lab.map(run, kind, level, runs=RECORDS.get((kind, level), 6)):
                    for name, table in record.items():
                        pooled.setdefault((name, level), []).append(table)
            for colour, name in zip(("C0", "C1"), OSCILLATORS, strict=True):
                levels = [level for other, level in cases(kind) if other == name]
                sigma = []
                for level in levels:
                    table = np.concatenate(pooled[name, level])
                    spans = len(pooled[name, level])
                    expected = theory(kind, name, level)
                    freedom = (len(table) - spans) / len(table)
                    both = np.sqrt((table[:, :2] ** 2).mean(axis=0) / freedom)
                    sigma.append(both)
                    ratios["observable"].append(20.0 * math.log10(both[0] / expected[0]))
                    ratios["loop"].append(20.0 * math.log10(both[1] / expected[1]))
                    bias.append(10.0 * math.log10(table[:, 2].mean()))
                    spread.append(float(table[:, 2].std() / table[:, 4].mean()))
                    locked.append(float(table[:, 3].mean()))
                points = np.array(sigma)
                wanted = np.array([theory(kind, name, level) for level in levels])
                axis.semilogy(levels, wanted[:, 0], "-", color=colour, label=f"{name}: epoch, theory")
                axis.semilogy(levels, points[:, 0], "o", color=colour, label=f"{name}: epoch, measured")
                axis.semilogy(levels, wanted[:, 1], "--", color=colour, label=f"{name}: loop, theory")
                axis.semilogy(levels, points[:, 1], "s", color=colour, mfc="none", label=f"{name}: loop, measured")
                measured[f"{kind}_{name}"] = [*points.ravel()]
            style(axis, title, "C/N0 [dB-Hz]", "σ of the carrier phase [cycles]" if kind == "cdma" else "")
        axes[1].legend(fontsize=8)
    saved: dict[str, Any] = {key: np.array(value) for key, value in measured.items()}
    lab.save(levels_dbhz=np.array(LEVELS_DBHZ), **saved)
    yield Claim(
        "observable of 0.1 s: σ over theory, thermal and oscillator, CDMA then GPS, OCXO then TCXO [dB]",
        ratios["observable"],
        band(-1.0, 1.0),
    )
    yield Claim(
        "phase of the loop (5, 8, 10 Hz; 20 ms): σ over theory of the discrete loop [dB]",
        ratios["loop"],
        band(-1.0, 1.0),
    )
    yield Claim("mean of the estimated C/N0 over the truth, largest [dB]", max(abs(b) for b in bias), at_most(0.3))
    yield Claim("spread of the C/N0 of 0.1 s over the σ it states", spread, band(0.8, 1.45))
    yield Claim("share of epochs with phase lock, smallest", min(locked), at_least(0.99))
