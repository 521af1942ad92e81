"""Beyond the paper: the likelihood against its bound, and filters that do not diverge."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from soopnav_cpp.estimation import coverage
from soopnav_cpp.experiments.carter_bearings import build_map, far_starts, hear, observed_sigma, path
from soopnav_cpp.experiments.carter_locators import COLOURS, INK, locate, rmse
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.navigation import source_crlb

RUNS = 1000
EPOCHS_SHOWN = tuple(range(99, 240, 20))


@experiment(
    "carter-x2",
    title="The likelihood at its bound, a bank of filters that does not diverge",
    source="beyond carter section 5.5 (range parameterisation is its future work)",
    runs=RUNS,
)
def beyond_locators(lab: Lab) -> Iterator[Claim]:
    """Bearings by MUSIC; the bound with the rms error of those bearings at each epoch."""
    drive = path()
    emitter = drive.emitter_m[:2]
    sigma_map = build_map(int(lab.rng("map").integers(2**62)))
    heard = lab.map(hear, sigma_map, 1)
    azimuth = np.concatenate([item[0] for item in heard])
    sigma = np.concatenate([item[1] for item in heard])
    bound = source_crlb(drive.positions_m[:, :2], emitter, observed_sigma(azimuth), times=drive.t_s)
    bound_m = np.sqrt(np.trace(bound, axis1=1, axis2=2))
    starts = far_starts(lab.rng("starts"), lab.runs)

    runs = {name: locate(name, azimuth, sigma, starts, None) for name in ("ml", "ekf_bank", "ekf")}
    final = {name: run.error_m(emitter)[:, 0] for name, run in runs.items()}
    nees = {name: run.nees(emitter)[:, 0] for name, run in runs.items()}
    diverged = {name: (final[name] > 10.0 * bound_m[-1]) & (nees[name] > 27.6) for name in runs}
    part = slice(0, 200)
    along = {
        name: locate(name, azimuth[part], sigma[part], starts[part], list(EPOCHS_SHOWN)).error_m(emitter)
        for name in ("ml", "ekf_bank")
    }
    inside = coverage(
        runs["ekf_bank"].position_m[:, 0] - emitter, runs["ekf_bank"].covariance_m2[:, 0], probability=0.9
    )

    with lab.figure(10.4, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        style(left, "RMSE along the drive, over the CRLB", "time [s]", "ratio")
        seconds = drive.t_s[list(EPOCHS_SHOWN)]
        for name, label, colour in (("ml", "likelihood", COLOURS[4]), ("ekf_bank", "bank of filters", COLOURS[2])):
            ratio = np.sqrt(np.mean(along[name] ** 2, axis=0)) / bound_m[list(EPOCHS_SHOWN)]
            left.plot(seconds, ratio, color=colour, marker="o", ms=3.5, label=label)
        left.axhline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        left.set_ylim(0.0, None)
        left.legend(frameon=False, fontsize=9)
        style(right, f"Final errors of {lab.runs} drives", "position error [m]", "share below")
        for name, label, colour in (
            ("ml", "likelihood", COLOURS[4]),
            ("ekf_bank", "bank of filters", COLOURS[2]),
            ("ekf", "one filter", COLOURS[3]),
        ):
            right.semilogx(np.sort(final[name]), (np.arange(lab.runs) + 0.5) / lab.runs, color=colour, label=label)
        right.legend(frameon=False, fontsize=9)
    arrays: dict[str, Any] = {f"final_{name}": values for name, values in final.items()}
    lab.save(crlb_m=bound_m, **arrays)

    yield Claim(
        f"RMSE of the likelihood over {lab.runs} drives, over the CRLB of bearings with their own rms error",
        rmse(final["ml"]) / bound_m[-1],
        band(0.9, 1.1),
    )
    yield Claim(f"divergences of the bank of filters in {lab.runs} drives", int(diverged["ekf_bank"].sum()), at_most(0))
    yield Claim(
        "share of the drives in which the paper's filter diverges", float(np.mean(diverged["ekf"])), at_least(0.01)
    )
    yield Claim("RMSE of the bank over the CRLB", rmse(final["ekf_bank"]) / bound_m[-1], band(0.9, 1.15))
    yield Claim("share of the bank's errors inside its 90 % ellipse", inside, band(0.8, 0.97))
