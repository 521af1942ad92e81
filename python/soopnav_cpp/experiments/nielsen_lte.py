"""The LTE downlink of nielsen 2.3: signals of every cell, search among several eNodeBs, channels and arrivals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import lte
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, condition, experiment, style

Array = npt.NDArray[np.float64]

SPEED_OF_LIGHT_MPS = 299_792_458.0
BANDWIDTHS_RB = (6, 15, 25, 50, 75, 100)
RATES_HZ = {6: 1.92e6, 15: 3.84e6, 25: 7.68e6, 50: 15.36e6, 75: 30.72e6, 100: 30.72e6}
POWERS_DB = (0.0, -8.0, -14.0)
RATE_HZ = 19.2e6
DURATION_S = 0.16
SIGNAL_RUNS = 12  # of 504 cells, a share each


def symbol_start(cp: lte.CyclicPrefix, symbol: int, size: int) -> int:
    """First sample of the useful part of a symbol of its slot (TS 36.211 6.12), by hand."""
    unit = size // 128
    if cp == lte.CyclicPrefix.EXTENDED:
        return symbol * 160 * unit + 32 * unit
    return (10 + symbol * 137) * unit


def subcarriers(iq: npt.NDArray[np.complex64], start: int, size: int, n_rb: int) -> npt.NDArray[np.complex128]:
    """Subcarriers of one symbol, lowest first, the carrier left out."""
    spectrum = np.fft.fft(iq[start : start + size].astype(np.complex128)) / np.sqrt(size)
    half = 6 * n_rb
    return np.concatenate([spectrum[-half:], spectrum[1 : half + 1]])


def signals_run(seed: int, first: int, step: int) -> Array:
    """Cells `first`, `first` + `step` ... synthesised, demodulated by NumPy: the largest differences of elements.

    Columns: identity, resource blocks, ports, extended prefix, TDD, difference of PSS, of SSS, of CRS.
    """
    rows = []
    for cell_id in range(first, 504, step):
        kind = cell_id + seed % 1000
        n_rb, n_ports = BANDWIDTHS_RB[kind % 6], (1, 2, 4)[kind // 6 % 3]
        cp = (lte.CyclicPrefix.NORMAL, lte.CyclicPrefix.EXTENDED)[kind // 18 % 2]
        duplex = (lte.Duplex.FDD, lte.Duplex.TDD)[kind // 36 % 2]
        size = round(RATES_HZ[n_rb] / 15e3)
        slot = 960 * size // 128
        rng = np.random.default_rng([seed, cell_id])
        gains = [complex(g) for g in np.exp(2j * np.pi * rng.uniform(size=4))]
        cell = lte.CellParameters(
            cell_id=cell_id, n_rb=n_rb, n_ports=n_ports, cp=cp, duplex=duplex, port_gain=gains, data_load=0.5
        )
        iq = lte.synthesize(cell, RATES_HZ[n_rb], 4 * slot, seed=cell_id)
        last = 6 if cp == lte.CyclicPrefix.NORMAL else 5
        sync = [(0, last), (0, last - 1)] if duplex == lte.Duplex.FDD else [(2, 2), (1, last)]
        errors = []
        wanted = (lte.pss(cell_id % 3), lte.sss(cell_id, 0))
        for (at, symbol), values in zip(sync, wanted, strict=True):
            got = subcarriers(iq, at * slot + symbol_start(cp, symbol, size), size, n_rb)
            middle = got[6 * n_rb - 31 : 6 * n_rb + 31]
            errors.append(np.abs(middle - gains[0] * values).max())
        worst = 0.0
        for at in range(2):
            for port in range(n_ports):
                for symbol in (0, last - 2) if port < 2 else (1,):
                    values, where = lte.crs(cell_id, at, symbol, port=port, n_rb=n_rb, cp=cp)
                    got = subcarriers(iq, at * slot + symbol_start(cp, symbol, size), size, n_rb)
                    worst = max(worst, float(np.abs(got[where] - gains[port] * values).max()))
        extended, tdd = cp == lte.CyclicPrefix.EXTENDED, duplex == lte.Duplex.TDD
        rows.append([cell_id, n_rb, n_ports, extended, tdd, *errors, worst])
    return np.array(rows, dtype=np.float64)


def several_run(seed: int) -> Array:
    """Three eNodeBs at 0, -8 and -14 dB with delays, phases and offset at random.

    Columns: cells found, false cells, TDOA error of the second and the third against the first [m], carrier error [Hz].
    """
    rng = np.random.default_rng(seed)
    sectors = rng.permutation(3)
    ids = [int(3 * group + sector) for group, sector in zip(rng.choice(168, 3, replace=False), sectors, strict=True)]
    offset = float(rng.uniform(-2e3, 2e3))
    base = rng.uniform(0.0, 9e-3)
    delays = base + rng.uniform(0.0, 2e-6, 3)
    cells = [
        lte.CellParameters(
            cell_id=cell_id,
            n_rb=100,
            n_ports=2,
            delay_s=float(delay),
            power_db=power,
            cfo_hz=offset,
            port_gain=[complex(g) for g in np.exp(2j * np.pi * rng.uniform(size=2))],
            start_sfn=int(rng.integers(1024)),
            data_load=0.5,
        )
        for cell_id, delay, power in zip(ids, delays, POWERS_DB, strict=True)
    ]
    iq = lte.synthesize(cells, RATE_HZ, int(DURATION_S * RATE_HZ), snr_db=25.0, seed=int(rng.integers(1 << 31)))
    found = {cell.cell_id: cell for cell in lte.search(iq, RATE_HZ, max_cfo_hz=5e3)}
    count, false = sum(i in found for i in ids), sum(i not in ids for i in found)
    if count < 3:
        return np.array([count, false, np.nan, np.nan, np.nan])
    arrivals = [lte.arrival_at(lte.time_of_arrival(iq, RATE_HZ, found[i]), 0.5 * DURATION_S)[0] for i in ids]
    errors = [
        ((arrivals[i] - arrivals[0] - (delays[i] - delays[0]) + 5e-3) % 10e-3 - 5e-3) * SPEED_OF_LIGHT_MPS
        for i in (1, 2)
    ]
    return np.array([count, false, *errors, found[ids[0]].cfo_hz - offset])


def channel_run(seed: int) -> Array:
    """A first path below a later one: error of first path, strongest, delays [m] and powers [dB] of all three."""
    rng = np.random.default_rng(seed)
    delays = np.cumsum([0.0, rng.uniform(80e-9, 200e-9), rng.uniform(80e-9, 300e-9)])
    powers = np.array([-4.4, 0.0, -7.0])
    gains = 10.0 ** (powers / 20.0) * np.exp(2j * np.pi * rng.uniform(size=3))
    start = rng.uniform(0.0, 9e-3)
    cell = lte.CellParameters(
        cell_id=int(rng.integers(504)),
        n_rb=100,
        n_ports=2,
        delay_s=float(start),
        cfo_hz=float(rng.uniform(-1e3, 1e3)),
        port_gain=[complex(g) for g in np.exp(2j * np.pi * rng.uniform(size=2))],
        taps=[(float(d), complex(g)) for d, g in zip(delays, gains, strict=True)],
    )
    iq = lte.synthesize(cell, RATE_HZ, int(40e-3 * RATE_HZ), snr_db=20.0, seed=int(rng.integers(1 << 31)))
    found = lte.search(iq, RATE_HZ, max_cfo_hz=5e3)
    toa = lte.time_of_arrival(iq, RATE_HZ, found[0])
    error = ((lte.arrival_at(toa)[0] - start + 5e-3) % 10e-3 - 5e-3) * SPEED_OF_LIGHT_MPS
    delay_error = power_error = np.inf
    if len(toa.paths) == 3:
        delay_error = max(abs(p.delay_s - d) for p, d in zip(toa.paths, delays, strict=True)) * SPEED_OF_LIGHT_MPS
        power_error = max(abs(p.power_db - q) for p, q in zip(toa.paths, powers, strict=True))
    known = found[0].cell_id == cell.cell_id and found[0].n_rb == 100 and found[0].n_ports == 2
    strongest = error + delays[1] * SPEED_OF_LIGHT_MPS
    return np.array([error, strongest, delay_error, power_error, known])


@experiment("nielsen-lte", title="The LTE downlink: signals, cells, arrivals", source="nielsen section 2.3", runs=12)
def downlink(lab: Lab) -> Iterator[Claim]:
    """Every cell's signals by an independent demodulation, three eNodeBs at once, a channel of three paths."""
    base = int(lab.rng("kinds").integers(1000))
    signals = np.concatenate([signals_run(base, first, SIGNAL_RUNS) for first in range(SIGNAL_RUNS)])
    signals = signals[np.argsort(signals[:, 0])]
    kinds = len(np.unique(signals[:, 1:5], axis=0))
    yield Claim(
        "cells synthesised and demodulated", len(np.unique(signals[:, 0])), condition("504", lambda m: m == (504.0,))
    )
    yield Claim(
        "combinations of bandwidth, ports, cyclic prefix and duplex mode among them, of 72",
        kinds,
        condition("72", lambda m: m == (72.0,)),
    )
    yield Claim(
        "largest difference of a PSS, SSS or CRS element (of magnitude 1)", signals[:, 5:].max(0), at_most(1e-3)
    )

    several = np.array(lab.map(several_run))
    yield Claim(
        "share of captures in which all of 0, -8 and -14 dB are found", np.mean(several[:, 0] == 3), at_least(0.95)
    )
    yield Claim("false cells", several[:, 1].sum(), at_most(0))
    second, third = np.sqrt(np.nanmean(np.square(several[:, 2:4]), axis=0))
    yield Claim(
        "TDOA of the cell at -8 dB, half of the blocks carrying data, 160 ms: RMS", second, at_most(0.05, unit="m")
    )
    yield Claim("TDOA of the cell at -14 dB: RMS", third, at_most(0.25, unit="m"))
    yield Claim("the same, largest error", np.nanmax(np.abs(several[:, 3])), at_most(0.5, unit="m"))
    yield Claim(
        "carrier offset of the strongest, largest error", np.nanmax(np.abs(several[:, 4])), at_most(2.0, unit="Hz")
    )

    channel = np.array(lab.map(channel_run))
    yield Claim("cell, bandwidth and ports right in multipath", channel[:, 4].mean(), at_least(1.0))
    yield Claim(
        "first path 4.4 dB below the strongest, largest error", np.abs(channel[:, 0]).max(), at_most(2.0, unit="m")
    )
    yield Claim(
        "delays of all three paths, median of the largest error", np.median(channel[:, 2]), at_most(0.5, unit="m")
    )
    yield Claim("their powers, median of the largest error", np.median(channel[:, 3]), at_most(0.5, unit="dB"))

    with lab.figure(10.6, 3.9) as figure:
        axes = figure.add_subplot(1, 3, 1)
        style(axes, "Elements against TS 36.211", "cell identity", "largest difference")
        for column, label, colour in ((5, "PSS", "#1b6ca8"), (6, "SSS", "#e3a018"), (7, "CRS", "#2a9d5c")):
            axes.semilogy(signals[:, 0], np.maximum(signals[:, column], 1e-9), ".", ms=3, color=colour, label=label)
        axes.legend(frameon=False, fontsize=8.5, loc="upper right")
        axes.set_ylim(1e-7, 1e-2)
        axes = figure.add_subplot(1, 3, 2)
        style(axes, "Three eNodeBs in one capture", "run", "TDOA error [m]")
        runs = np.arange(1, len(several) + 1)
        for column, label, colour in ((2, "-8 dB", "#1b6ca8"), (3, "-14 dB", "#d1495b")):
            axes.plot(runs, several[:, column], "o", ms=4, color=colour, label=label)
        axes.axhspan(-0.05, 0.05, color="#1b6ca8", alpha=0.12, lw=0)
        for bar in (-0.5, 0.5):
            axes.axhline(bar, color="#d1495b", lw=0.8, ls=(0, (4, 3)))
        axes.legend(frameon=False, fontsize=8.5, loc="upper right", ncols=2)
        axes.set_ylim(-0.75, 0.75)
        axes = figure.add_subplot(1, 3, 3)
        style(axes, "First path at -4.4 dB", "run", "|error| [m]")
        axes.semilogy(runs, np.abs(channel[:, 0]), "o", ms=4, color="#2a9d5c", label="first path")
        axes.semilogy(runs, np.abs(channel[:, 1]), "s", ms=4, color="#8a949c", label="strongest path")
        axes.axhline(2.0, color="#22303c", lw=0.8, ls=(0, (4, 3)))
        axes.legend(frameon=False, fontsize=8.5, loc="center right")
    lab.save(signals=signals, several=several, channel=channel)
