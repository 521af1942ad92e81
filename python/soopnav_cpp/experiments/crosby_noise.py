"""Error against SNR: crosby fig. 4.7."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from soopnav_cpp.experiments.crosby_setup import (
    BLUE,
    MHZ,
    RATES,
    RED,
    Array,
    boundary_errors,
    distance_m,
    scenario,
    solve,
)
from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, experiment, style
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import sense

SNR_DB = {
    1: (-40.0, -30.0, -25.0, -20.0, -17.5, -16.0, -15.0, -14.0, -13.0, -12.0, -11.0, -10.0, -7.5, -5.0, 0.0, 5.0, 10.0),
    15: (-40.0, -30.0, -25.0, -22.5, -20.0, -19.0, -18.0, -17.0, -16.0, -15.0, -12.5, -10.0, -5.0, 0.0, 5.0, 10.0),
}
WRONG_M = 45.0
RUNS = {1: 6, 15: 2}
ABOVE_DB = (0.0, 10.0)
RUNS_ABOVE = {1: 40, 15: 10}
SECONDS = 60.0  # driven at each SNR


def errors(seed: int, rate: int, snrs_db: tuple[float, ...]) -> Array:
    """Mean position error from 10 s on and the share of boundaries off by more than 45 m, for each SNR: (SNRs, 2)."""
    rows = []
    for snr_db in snrs_db:
        setup = scenario(rate, ofdm={"snr_db": snr_db}).model_copy(update={"duration_s": SECONDS})
        sensed = sense(setup, seed)
        track = solve(setup, sensed)
        rows.append(
            (
                float(distance_m(track)[track.t_s >= 10.0].mean()),
                float(np.mean(np.abs(boundary_errors(setup, sensed)) > WRONG_M)),
            )
        )
    return np.array(rows)


def break_db(snr_db: tuple[float, ...], wrong: Array) -> float:
    """Highest SNR with more than a tenth of the boundaries wrong, between the grid's points by interpolation."""
    over = np.flatnonzero(wrong > 0.1)
    if not len(over) or over[-1] + 1 >= len(snr_db):
        return float("nan")
    i = int(over[-1])
    part = (wrong[i] - 0.1) / (wrong[i] - wrong[i + 1])
    return float(snr_db[i] + part * (snr_db[i + 1] - snr_db[i]))


@experiment("crosby-4.7", title="Error against SNR", source="crosby section 4.3, Fig. 4.7", runs=40)
def figure_4_7(lab: Lab) -> Iterator[Claim]:
    """SNR per sample, at the rate the receiver runs at."""
    runs = {rate: np.mean(lab.map(errors, rate, SNR_DB[rate], runs=RUNS[rate]), axis=0) for rate in RATES}
    above = {rate: np.mean(lab.map(errors, rate, ABOVE_DB, runs=RUNS_ABOVE[rate]), axis=0)[:, 0] for rate in RATES}
    with lab.figure(10.4, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        style(left, "Mean position error", "SNR [dB]", "error [m]")
        style(right, f"Boundaries off by more than {WRONG_M:g} m", "SNR [dB]", "share")
        for rate, colour in zip(RATES, (RED, BLUE), strict=True):
            left.semilogy(SNR_DB[rate], runs[rate][:, 0], color=colour, marker="o", ms=3.5, label=MHZ[rate])
            right.plot(SNR_DB[rate], runs[rate][:, 1], color=colour, marker="o", ms=3.5, label=MHZ[rate])
        right.axhline(0.1, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        for axes in (left, right):
            axes.legend(frameon=False, fontsize=9)
    lab.table(
        ["rate", "snr_db", "mean_error_m", "wrong_share"],
        [(MHZ[rate], snr, *row) for rate in RATES for snr, row in zip(SNR_DB[rate], runs[rate].tolist(), strict=True)],
    )
    lab.save(
        snr_20_db=SNR_DB[1], snr_300_db=SNR_DB[15], error_20_m=runs[1][:, 0], error_300_m=runs[15][:, 0],
        wrong_20=runs[1][:, 1], wrong_300=runs[15][:, 1],
    )  # fmt: skip
    for rate, limit in zip(RATES, (1.25, 2.0), strict=True):
        yield Claim(
            f"{MHZ[rate]}: flat above 0 dB: error at 0 dB over that at +10 dB, {RUNS_ABOVE[rate]} runs",
            above[rate][0] / above[rate][1],
            at_most(limit),
        )
    breaks = [break_db(SNR_DB[rate], runs[rate][:, 1]) for rate in RATES]
    yield Claim("20 MHz: highest SNR with more than 10 % of the boundaries wrong", breaks[0], band(-15.0, -11.0, "dB"))
    yield Claim("300 MHz breaks at no higher SNR: difference of the two", breaks[1] - breaks[0], at_most(0.0, "dB"))
