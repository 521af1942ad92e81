"""Blind symbol boundaries of crosby (2.4) and (2.5) against the Fisher information of a fractional delay."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import ofdm, simulation
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, condition, experiment, style

__all__ = ["boundary_errors_m", "double_sum"]

Array = npt.NDArray[np.float64]

SNR_DB = tuple(float(snr_db) for snr_db in range(-20, 31, 5))
SYMBOLS = (25, 80, 250)
EPOCHS = 40  # of one run, at each SNR, number of symbols and method
WRONG_M = 45.0  # an error beyond three samples is another top, not noise about the right one
WRONG_SHARE = 0.01  # more of them than this make the threshold region
METHODS = ("interpolated", "half-way", "nearest_sample")
GRID = ofdm.Numerology()


def double_sum(iq: npt.NDArray[np.complex64], symbols: int) -> npt.NDArray[np.complex128]:
    """The correlator (2.5) as printed, counted from 0."""
    y = iq.astype(np.complex128)
    M, N, v = GRID.symbol_samples, GRID.subcarriers, GRID.prefix
    gamma = np.zeros(M, np.complex128)
    for m in range(M):
        for k in range(symbols):
            window = slice(M * k + m, M * k + m + v)
            gamma[m] += np.vdot(y[window.start + N : window.stop + N], y[window])
    return gamma


def boundary_errors_m(seed: int) -> Array:
    """Errors of one run [m]: shape (methods, symbols, SNR, epochs), wrapped to half the ambiguity.

    Delays are anywhere in the ambiguity, but for the method ``half-way``: interpolated, at delays of whole samples and
    a half, where the bound is regular at any SNR.
    """
    random = np.random.default_rng(seed)
    out = np.empty((len(METHODS), len(SYMBOLS), len(SNR_DB), EPOCHS))
    for b, symbols in enumerate(SYMBOLS):
        link = simulation.OfdmLink(GRID, symbols, movement="fractional_delay")
        for a, method in enumerate(METHODS):
            for c, snr_db in enumerate(SNR_DB):
                if method == "half-way":
                    delay_m = (random.integers(GRID.symbol_samples, size=EPOCHS) + 0.5) * GRID.sample_m
                else:
                    delay_m = random.uniform(0.0, GRID.ambiguity_m, EPOCHS)
                series = link.measure(
                    delay_m,
                    method="interpolated" if method == "half-way" else method,
                    seed=seed,
                    stream=(a * len(SYMBOLS) + b) * len(SNR_DB) + c,
                    snr_db=snr_db,
                )
                error = series.range_m - delay_m
                out[a, b, c] = error - GRID.ambiguity_m * np.round(error / GRID.ambiguity_m)
    return out


def _figure(lab: Lab, rms: Array, wrong: Array, bound: Array, bound_half: Array) -> None:
    with lab.figure(9.6, 5.0) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, method, limits in ((left, 0, bound), (right, 1, bound_half)):
            for b, symbols in enumerate(SYMBOLS):
                color = f"C{b}"
                apart = wrong[method, b] > WRONG_SHARE
                axes.plot(SNR_DB, limits[b], "--", color=color, linewidth=1.0)
                axes.plot(SNR_DB, rms[method, b], "-", color=color, linewidth=0.8, alpha=0.5)
                axes.plot(
                    np.array(SNR_DB)[~apart], rms[method, b][~apart], "o", color=color, label=f"{symbols} symbols"
                )
                axes.plot(np.array(SNR_DB)[apart], rms[method, b][apart], "o", color=color, markerfacecolor="white")
            axes.set_yscale("log")
            axes.set_ylim(8e-3, 9e2)
        left.plot(SNR_DB, rms[2, -1], "k:", label="nearest sample, 250 symbols")
        style(left, "Interpolated, delays anywhere", "SNR per sample [dB]", "rms range error [m]")
        style(right, "Interpolated, delays half-way between samples", "SNR per sample [dB]", "")
        right.plot([], [], "k--", label="Fisher information")
        right.plot([], [], "ko", markerfacecolor="white", label=f"> {WRONG_SHARE:.0%} wrong tops")
        for axes in (left, right):
            axes.legend(fontsize=8)


@experiment(
    "crosby-2.5",
    title="Blind boundaries against SNR, symbols and the Fisher information",
    source="crosby section 2.3, (2.4) and (2.5)",
    runs=8,
)
def boundary(lab: Lab) -> Iterator[Claim]:
    """Rms of the boundary over SNR and number of symbols, the threshold region apart."""
    symbols = SYMBOLS[-1]
    iq = simulation.OfdmLink(GRID, symbols).iq(123.0, seed=int(lab.rng("iq").integers(2**62)), snr_db=0.0)
    printed = double_sum(iq, symbols)
    folded = ofdm.correlate(iq, GRID, symbols)
    yield Claim(
        "the folded correlator against the double sum of (2.5), over its largest value",
        np.abs(folded - printed).max() / np.abs(printed).max(),
        at_most(1e-5),
    )

    errors = np.concatenate(lab.map(boundary_errors_m), axis=-1)
    rms = np.sqrt(np.mean(np.square(errors), axis=-1))
    wrong = np.mean(np.abs(errors) > WRONG_M, axis=-1)
    bound = np.array([[ofdm.delay_crlb_m(snr_db, k, GRID) for snr_db in SNR_DB] for k in SYMBOLS])
    half = np.array([[ofdm.delay_crlb_m(snr_db, k, GRID, fraction=0.5) for snr_db in SNR_DB] for k in SYMBOLS])
    _figure(lab, rms, wrong, bound, half)
    lab.save(
        snr_db=SNR_DB,
        symbols=SYMBOLS,
        methods=np.array(METHODS),
        rms_m=rms,
        wrong=wrong,
        bound_m=bound,
        bound_half_m=half,
    )

    at = {snr_db: i for i, snr_db in enumerate(SNR_DB)}
    yield Claim(
        "rms over the bound, delays anywhere, all SNR and numbers of symbols: never below 1",
        (rms[0] / bound).min(),
        above(1.0),
    )
    yield Claim(
        "rms over the bound half-way between samples, 250 symbols, 0 … 10 dB: near 1",
        rms[1, -1, at[0.0] : at[10.0] + 1] / half[-1, at[0.0] : at[10.0] + 1],
        band(0.8, 2.0),
    )
    yield Claim(
        "rms half-way between samples at 10 dB, 25 over 250 symbols: √10 (at 5 dB 25 symbols are near their threshold)",
        rms[1, 0, at[10.0]] / rms[1, -1, at[10.0]],
        band(2.2, 4.6),
    )
    yield Claim(
        "threshold: share of errors > 45 m with 250 symbols at −15 dB, and with 25 at −10 dB",
        (wrong[0, -1, at[-15.0]], wrong[0, 0, at[-10.0]]),
        at_least(0.1),
    )
    yield Claim(
        "above it: the same with 250 symbols at −5 dB, and with 25 at 0 dB",
        (wrong[0, -1, at[-5.0]], wrong[0, 0, at[0.0]]),
        at_most(0.02),
    )
    yield Claim(
        "nearest sample, 250 symbols, 0 … 30 dB: a sample / √12 = 4.33 m",
        rms[2, -1, at[0.0] :],
        band(3.8, 4.9, "m"),
    )
    yield Claim("interpolated, 250 symbols, 30 dB", rms[0, -1, at[30.0]], at_most(0.6, "m"))
    yield Claim(
        "interpolated below the nearest sample, 250 symbols, 0 … 30 dB",
        rms[0, -1, at[0.0] :] / rms[2, -1, at[0.0] :],
        condition("each < 0.75", lambda m: all(value < 0.75 for value in m)),
    )
