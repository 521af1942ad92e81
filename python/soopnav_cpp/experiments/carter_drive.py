"""Bearings of an emitter along a drive: carter figs. 5.9-5.13."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import array
from soopnav_cpp.experiments.carter_calibration import TONE_HZ, geometry, receivers, recorded
from soopnav_cpp.experiments.registry import Claim, Lab, above, band, below, experiment, style
from soopnav_cpp.scenarios.emitter_drive import EXCESS_LOSS_DB, DriveBearings, EmitterDrive, emitter_drive, measure
from soopnav_cpp.simulation import ArrayLink

Array = npt.NDArray[np.float64]

BLUE, RED, GREEN, GREY = "#1b6ca8", "#d1495b", "#2e933c", "#5c677d"
SAMPLES = 2500
CHAIN_RUNS = 20
NEAR_M, FAR_M = 170.0, 1100.0
BINS_M = np.array([150.0, NEAR_M, 250.0, 400.0, 550.0, 700.0, 850.0, 1000.0, FAR_M, 1211.0])


@functools.cache
def scene() -> tuple[EmitterDrive, ArrayLink, array.DirectionFinder]:
    """The drive, the paper's array and power, and MUSIC."""
    link = ArrayLink(geometry(), transmit_power_dbm=10.0, noise_figure_db=6.0, excess_loss_db=EXCESS_LOSS_DB)
    return emitter_drive(), link, array.DirectionFinder(geometry())


def sigma_map(seed: int) -> array.SigmaMap:
    """Error against eigenvalue ratio of the same array, at the drive's elevations."""
    drive = scene()[0]
    low, high = float(drive.elevation_rad.min()), float(drive.elevation_rad.max())
    return array.SigmaMap.build(scene()[1].manifold, SAMPLES, trials=600, elevation_rad=(low, high), seed=seed)


def run(seed: int) -> DriveBearings:
    """One drive on generated samples."""
    drive, link, finder = scene()
    return measure(drive, link, finder, n_samples=SAMPLES, seed=seed)


def received(seed: int) -> tuple[Array, Array]:
    """Azimuth errors of one drive through receivers with faults: calibrated with a tone beforehand, and as they are."""
    drive, link, finder = scene()
    front_end = receivers(seed)
    calibration = array.calibrate(recorded(seed, TONE_HZ), link.sample_rate_hz, TONE_HZ, geometry())
    with_it, without = (
        measure(drive, link, finder, n_samples=SAMPLES, seed=seed, front_end=front_end, calibration=made).errors(drive)[
            0
        ]
        for made in (calibration, None)
    )
    return with_it, without


def rms_deg(errors: Array) -> float:
    """Of errors in radians, those that are not finite left out."""
    return float(np.degrees(np.sqrt(np.nanmean(errors**2))))


@experiment("carter-5.9", title="Bearings along a drive", source="carter section 5.3, Figs. 5.9-5.13", runs=120)
def bearings(lab: Lab) -> Iterator[Claim]:
    """240 epochs past an emitter of 10 dBm, 30 m up; free space alone would leave no bearing useless."""
    drive, link, _ = scene()
    table = sigma_map(int(lab.rng("map").integers(2**62)))
    runs = lab.map(run)
    errors = np.array([one.errors(drive)[0] for one in runs])
    ratio = np.array([table.smooth(one.eigenvalues) for one in runs])
    sigma = np.asarray(table.sigma(ratio))
    single = np.asarray(table.sigma([table.smooth(one.eigenvalues, epochs=1) for one in runs]))
    chain = np.array(lab.map(received, runs=CHAIN_RUNS))
    near = drive.distance_m <= NEAR_M
    where = np.digitize(drive.distance_m, BINS_M) - 1
    bins = range(len(BINS_M) - 1)
    measured = np.array([rms_deg(errors[:, where == k]) for k in bins])
    predicted = np.array([rms_deg(sigma[:, where == k]) for k in bins])
    predicted_single = np.array([rms_deg(single[:, where == k]) for k in bins])
    share = measured / predicted

    _draw_drive(lab, drive, runs[0])
    _draw_errors(lab, drive, link, errors, ratio, measured, predicted, predicted_single)
    lab.save(
        distance_m=drive.distance_m,
        snr_db=link.snr_db(drive.distance_m),
        azimuth_error_rad=errors,
        ratio=ratio,
        sigma_rad=sigma,
        bins_m=BINS_M,
        measured_deg=measured,
        predicted_deg=predicted,
        receivers_error_rad=chain,
    )
    yield Claim(
        f"rms of azimuth within {NEAR_M:g} m",
        rms_deg(errors[:, near]),
        below(1.5, "°"),
        "Fig. 5.12",
    )
    yield Claim(
        f"rms of azimuth beyond {FAR_M:g} m",
        rms_deg(errors[:, drive.distance_m >= FAR_M]),
        above(30.0, "°"),
        "Fig. 5.12",
    )
    yield Claim(
        f"rms over the rms that the eigenvalues of 11 epochs predict, in {len(share)} bins of range",
        share,
        band(0.67, 1.5),
        "Fig. 5.13",
    )
    yield Claim(
        f"rms within {NEAR_M:g} m through receivers with faults, calibrated with a tone",
        rms_deg(chain[:, 0][:, near]),
        below(1.5, "°"),
        "Fig. 5.8",
    )
    yield Claim(
        f"rms within {NEAR_M:g} m through the same receivers, not calibrated",
        rms_deg(chain[:, 1][:, near]),
        above(30.0, "°"),
        "Fig. 5.8",
    )


def _draw_drive(lab: Lab, drive: EmitterDrive, one: DriveBearings) -> None:
    """Figs. 5.9-5.11: where, how it stood, and what was measured."""
    with lab.figure(10.4, 7.4) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15))
        axes = figure.add_subplot(grid[0, 0])
        style(axes, "Path", "east [m]", "north [m]")
        axes.plot(drive.positions_m[:, 0], drive.positions_m[:, 1], color=BLUE, linewidth=1.5)
        axes.plot(*drive.emitter_m[:2], "*", color=RED, markersize=13, markeredgecolor="white")
        for k in range(0, len(drive.t_s), 12):
            far = 0.8 * drive.distance_m[k]
            towards = np.array([np.cos(one.azimuth_rad[k]), np.sin(one.azimuth_rad[k])])
            line = drive.positions_m[k, :2] + np.outer([0.0, far], towards)
            axes.plot(line[:, 0], line[:, 1], color=GREY, linewidth=0.5, alpha=0.8)
        axes.set_aspect("equal", adjustable="datalim")
        axes = figure.add_subplot(grid[1, 0])
        style(axes, "Pose", "time [s]", "heading from east [°], range [10 m]")
        axes.plot(drive.t_s, np.degrees(drive.heading_rad), color=BLUE, label="heading")
        axes.plot(drive.t_s, drive.distance_m / 10.0, color=GREEN, label="range / 10 m")
        axes.legend(fontsize=8, frameon=False)
        for row, (name, found, truth, limits) in enumerate(
            (
                ("Azimuth", one.azimuth_rad, drive.azimuth_rad, (-185.0, 185.0)),
                ("Elevation", one.elevation_rad, drive.elevation_rad, (-2.0, 92.0)),
            )
        ):
            axes = figure.add_subplot(grid[row, 1])
            style(axes, f"{name} in the local frame", "time [s]", f"{name.lower()} [°]")
            axes.plot(drive.t_s, np.degrees(found), ".", color=RED, markersize=3.5, label="MUSIC")
            right = np.degrees(truth)
            right[1:][np.abs(np.diff(right)) > 180.0] = np.nan  # no line across the turn's end
            axes.plot(drive.t_s, right, color="black", linewidth=1.0, label="truth")
            axes.set_ylim(*limits)
            axes.legend(fontsize=8, loc="upper center", ncols=2)


def _draw_errors(
    lab: Lab,
    drive: EmitterDrive,
    link: ArrayLink,
    errors: Array,
    ratio: Array,
    measured: Array,
    predicted: Array,
    predicted_single: Array,
) -> None:
    """Figs. 5.12 and 5.13: errors over range, eigenvalues, and errors beside what they promise."""
    order = np.argsort(drive.distance_m)
    range_m = drive.distance_m[order]
    with lab.figure(10.8, 3.9, part="errors") as figure:
        axes = figure.add_subplot(1, 3, 1)
        style(axes, "Error of azimuth", "range [m]", "error [°]")
        axes.plot(drive.distance_m, np.degrees(errors[:12]).T, ".", color=GREY, markersize=2.0, alpha=0.7)
        rms = np.degrees(np.sqrt(np.nanmean(errors**2, axis=0)))
        axes.plot(range_m, rms[order], color=RED, linewidth=1.3, label="rms of all runs")
        axes.plot(range_m, -rms[order], color=RED, linewidth=1.3)
        axes.legend(fontsize=8, frameon=False, loc="upper left")
        axes = figure.add_subplot(1, 3, 2)
        style(axes, "Eigenvalues and SNR", "range [m]", "[dB]")
        axes.plot(
            range_m, 10.0 * np.log10(ratio.mean(axis=0)[order]), color=BLUE, label="largest over the others, 11 epochs"
        )
        axes.plot(range_m, link.snr_db(range_m), color=GREEN, label="SNR of an element")
        axes.legend(fontsize=8, frameon=False)
        axes = figure.add_subplot(1, 3, 3)
        style(axes, "Measured and predicted", "range [m]", "rms of azimuth [°]")
        middle = 0.5 * (BINS_M[1:] + BINS_M[:-1])
        axes.semilogy(middle, measured, "o-", color=RED, markersize=4, label="measured")
        axes.semilogy(middle, predicted, "s--", color=BLUE, markersize=4, label="from 11 epochs' eigenvalues")
        axes.semilogy(middle, predicted_single, "^:", color=GREY, markersize=4, label="from one epoch's")
        axes.legend(fontsize=8, frameon=False, loc="lower right")
