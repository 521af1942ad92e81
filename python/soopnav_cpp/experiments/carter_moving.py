"""Beyond the paper: an emitter that moves, and one in three dimensions, at their bounds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.experiments.carter_bearings import Array, path
from soopnav_cpp.experiments.carter_locators import COLOURS, INK
from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, experiment, style
from soopnav_cpp.navigation import SourceLocator, SourceRun, source_crlb

RUNS = 400
VELOCITY_MPS = (0.6, -0.4)
# Rms error of an azimuth by MUSIC against range, as carter-5.9 has it: degrees at metres.
RANGE_M = (150.0, 300.0, 550.0, 850.0, 1250.0)
SIGMA_DEG = (0.93, 2.4, 7.0, 22.0, 55.0)
SHOWN = tuple(range(119, 240, 20))  # the last is the drive's end
MIDWAY = 119  # epoch at which the moving emitter is where the other one always is


def bearing_sigma(distance_m: npt.ArrayLike) -> Array:
    """Deviation of an azimuth at a distance."""
    return np.asarray(np.radians(np.interp(np.asarray(distance_m), RANGE_M, SIGMA_DEG)))


def rms_ratio(run: SourceRun, truth: Array, bound: Array) -> Array:
    """RMSE over the bound at each epoch of a batch."""
    error = run.error_m(truth)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)) / np.sqrt(np.trace(bound, axis1=1, axis2=2)))


@experiment(
    "carter-x3.1",
    title="A moving emitter, and one in space",
    source="beyond carter section 5.5 (its motion model 5.9 and angles 5.7)",
    runs=RUNS,
)
def beyond_static(lab: Lab) -> Iterator[Claim]:
    """Normal bearing errors that grow with range as those of the drive do."""
    drive = path()
    t_s, chosen = drive.t_s, list(SHOWN)
    truth = drive.emitter_m[:2] + np.outer(t_s - t_s[MIDWAY], VELOCITY_MPS)
    offset = truth - drive.positions_m[:, :2]
    sigma = bearing_sigma(np.linalg.norm(offset, axis=1))
    azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + sigma * lab.rng("azimuth").standard_normal((lab.runs, len(t_s)))
    bound = source_crlb(
        drive.positions_m[:, :2], truth[0], sigma, times=t_s, motion="constant_velocity", velocity=VELOCITY_MPS
    )
    moving: dict[str, SourceRun] = {}
    for name in ("ml", "ekf_bank"):
        locator = SourceLocator(name, motion="constant_velocity", start_speed_sigma_mps=3.0)
        moving[name] = locator.run_many(t_s, drive.positions_m[:, :2], azimuth, sigma, epochs=chosen)
    moving_ratio = {name: rms_ratio(run, truth[chosen], bound[chosen, :2, :2]) for name, run in moving.items()}
    velocity_rms = {
        name: np.linalg.norm(run.velocity_mps[:, -1] - VELOCITY_MPS, axis=1) for name, run in moving.items()
    }
    velocity_bound = np.sqrt(np.trace(bound[-1, 2:, 2:]))

    level = np.linalg.norm(drive.positions_m[:, :2] - drive.emitter_m[:2], axis=1)
    sigmas = np.stack([bearing_sigma(level), np.minimum(5.0 * bearing_sigma(level), 0.6)], axis=1)
    angles = np.stack([drive.azimuth_rad, drive.elevation_rad], axis=1)
    angles = angles + sigmas * lab.rng("angles").standard_normal((lab.runs, len(t_s), 2))
    bound3 = source_crlb(drive.positions_m, drive.emitter_m, sigmas, times=t_s)
    space = {
        name: SourceLocator(name, dimensions=3).run_many(t_s, drive.positions_m, angles, sigmas, epochs=chosen)
        for name in ("ml", "ekf_bank")
    }
    space_ratio = {name: rms_ratio(run, drive.emitter_m, bound3[chosen]) for name, run in space.items()}

    with lab.figure(10.4, 4.4) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        titles = (f"Moving emitter, {np.hypot(*VELOCITY_MPS):.2f} m/s", "Emitter in space")
        for axes, title, ratios in zip(panels, titles, (moving_ratio, space_ratio), strict=True):
            style(axes, title, "time [s]", "")
            for ratio, label, colour in zip(
                ratios.values(), ("likelihood", "bank of filters"), (COLOURS[4], COLOURS[2]), strict=True
            ):
                axes.plot(t_s[chosen], ratio, color=colour, marker="o", ms=3.5, label=label)
            axes.axhline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
            axes.set_ylim(0.0, 3.0)
            axes.legend(frameon=False, fontsize=9)
        panels[0].set_ylabel("RMSE over CRLB")
    arrays: dict[str, Any] = {f"moving_{name}": ratio for name, ratio in moving_ratio.items()}
    arrays |= {f"space_{name}": ratio for name, ratio in space_ratio.items()}
    lab.save(
        t_s=t_s[chosen],
        crlb_moving_m=np.sqrt(np.trace(bound[chosen, :2, :2], axis1=1, axis2=2)),
        crlb_space_m=np.sqrt(np.trace(bound3[chosen], axis1=1, axis2=2)),
        **arrays,
    )

    # An rms over 400 runs of two components, of which one may lead, is right to 3 %.
    for name, words, high in (("ml", "the likelihood", 1.18), ("ekf_bank", "the bank of filters", 1.3)):
        yield Claim(
            f"moving emitter, end of the drive: RMSE of {words} over the CRLB", moving_ratio[name][-1], band(0.85, high)
        )
        yield Claim(
            f"moving emitter: rms velocity error of {words} over the CRLB",
            float(np.sqrt(np.mean(velocity_rms[name] ** 2)) / velocity_bound),
            band(0.85, high),
        )
        yield Claim(
            f"in space, end of the drive: RMSE of {words} over the CRLB", space_ratio[name][-1], band(0.85, 1.18)
        )
    # As in carter-x2: the NEES alone exceeds its quantile of 1e-6 once in 2500 batches of 400.
    last = moving["ekf_bank"]
    far = last.error_m(truth[chosen])[:, -1] > 10.0 * np.sqrt(np.trace(bound[chosen[-1], :2, :2]))
    diverged = far & (last.nees(truth[chosen])[:, -1] > 27.6)
    yield Claim(
        "divergences of the bank with a moving emitter (10 CRLB and NEES above 27.6)", int(np.sum(diverged)), at_most(0)
    )
