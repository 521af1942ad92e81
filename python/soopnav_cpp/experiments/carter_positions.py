"""Positions from pseudoranges: carter chapter 2."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry, gnss
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.simulation import simulate_gnss

Array = npt.NDArray[np.float64]

WEEK, TOE_S = 2200, 345_600.0
EPOCHS = 60
PLACES = 12
SIGMA_M = 1.5
MASK = np.deg2rad(10.0)
BLUE, RED, GREEN, GREY, INK = "#1b6ca8", "#d1495b", "#2e933c", "#5c677d", "#22303c"


class Day(NamedTuple):
    """One run: places, epochs, components east, north, up and clock."""

    exact_m: Array  # (places, epochs, 4), without noise
    errors_m: Array  # the same with noise
    sigma_m: Array  # the standard deviations the solution states
    dop: Array  # (places, epochs, 4): east, north, up, clock
    used: Array  # (places, epochs)
    iterations: int
    lost: int  # epochs without a converged position


def constellation() -> gnss.Ephemerides:
    """Thirty satellites whose clocks run, on slightly elliptic orbits."""
    circles = gnss.walker_constellation(30, 6, 1, week=WEEK, toe_s=TOE_S).records
    messages = [dict(zip(circles.dtype.names or (), row, strict=True)) for row in circles.tolist()]
    for message in messages:
        prn = message["prn"]
        message.update(eccentricity=0.001 * (prn % 15), omega_rad=0.4 * prn, af0_s=2e-5 * (prn - 15), af1=1e-12 * prn)
    return gnss.Ephemerides(messages)


def day(seed: int) -> Day:
    """Receivers at random places and heights, each for a day of epochs with a clock bias of its own."""
    random = np.random.default_rng(seed)
    sky = constellation()
    seconds = TOE_S + np.linspace(-40_000.0, 40_000.0, EPOCHS)
    out: list[tuple[Array, ...]] = []
    iterations, lost = 0, 0
    for place in range(PLACES):
        latitude, longitude = np.arcsin(random.uniform(-0.95, 0.95)), random.uniform(-np.pi, np.pi)
        here = geometry.geodetic_to_ecef(latitude, longitude, random.uniform(0.0, 3000.0))
        bias_m = random.uniform(-3e5, 3e5)
        row: list[Array] = []
        for noise in (False, True):
            seen = simulate_gnss(
                sky, here, seconds, WEEK, seed=seed, stream=place, noise=noise, code_sigma_m=SIGMA_M,
                clock_bias_m=bias_m, elevation_mask_rad=MASK, integers=False,
            )  # fmt: skip
            fixes = gnss.single_point(
                seen.antennas[0], sky, sigma_m=SIGMA_M, weight_by_elevation=False, ionosphere=False,
                troposphere=False, reject_outliers=False, elevation_mask_rad=-np.pi / 2,
            )  # fmt: skip
            row.append(np.column_stack([fixes.errors_enu_m(here), fixes.clock_bias_m - bias_m]))
            iterations = max(iterations, int(fixes.iterations.max()))
            lost += int(np.sum(fixes.status >= gnss.PointStatus.TOO_FEW_SATELLITES))
        level = np.sqrt(np.diagonal(fixes.covariance_enu_m2, axis1=1, axis2=2))
        sigma = np.column_stack([level, fixes.clock_sigma_m])
        dop = np.column_stack([level / SIGMA_M, fixes.tdop])
        out.append((row[0], row[1], sigma, dop, fixes.used.sum(axis=1).astype(np.float64)))
    exact, errors, sigmas, dops, used = (np.array(values) for values in zip(*out, strict=True))
    return Day(exact, errors, sigmas, dops, used, iterations, lost)


def first_sky(seed: int) -> tuple[Array, Array]:
    """Azimuth and elevation of all satellites in view of the run's first place, over the epochs."""
    random = np.random.default_rng(seed)
    latitude, longitude = np.arcsin(random.uniform(-0.95, 0.95)), random.uniform(-np.pi, np.pi)
    here = geometry.geodetic_to_ecef(latitude, longitude, 0.0)
    sky = constellation()
    seconds = TOE_S + np.linspace(0.0, 7200.0, 121)
    seen = simulate_gnss(sky, here, seconds, WEEK, seed=seed, elevation_mask_rad=0.0, noise=False)
    return seen.azimuth_rad[0], seen.elevation_rad[0]


@experiment(
    "carter-2",
    title="Positions from pseudoranges and their dilution of precision",
    source="carter section 2.4, eq. 2.12-2.20",
    runs=8,
)
def positions(lab: Lab) -> Iterator[Claim]:
    """A synthetic constellation with clocks, flight time and the Earth's turn; no atmosphere."""
    days = lab.map(day)
    exact = np.concatenate([d.exact_m.reshape(-1, 4) for d in days])
    errors = np.concatenate([d.errors_m.reshape(-1, 4) for d in days])
    sigmas = np.concatenate([d.sigma_m.reshape(-1, 4) for d in days])
    dops = np.concatenate([d.dop.reshape(-1, 4) for d in days])
    used = np.concatenate([d.used.ravel() for d in days])
    lost = sum(d.lost for d in days)
    pdop = np.sqrt(np.sum(dops[:, :3] ** 2, axis=1))
    length = np.linalg.norm(errors[:, :3], axis=1)
    usual = pdop < 20.0

    # Bins of equally many epochs: rms against the mean square of DOP times sigma.
    order = np.argsort(pdop[usual])
    bins = [(pdop[usual][part], length[usual][part]) for part in np.array_split(order, 8)]
    predicted = np.array([SIGMA_M * np.sqrt(np.mean(p**2)) for p, _ in bins])
    measured = np.array([np.sqrt(np.mean(e**2)) for _, e in bins])

    with lab.figure(10.8, 4.2) as figure:
        disk: Any = figure.add_subplot(1, 3, 1, projection="polar")
        scatter, histogram = figure.add_subplot(1, 3, 2), figure.add_subplot(1, 3, 3)
        azimuth, elevation = first_sky(lab.seeds[0])
        disk.set_theta_zero_location("N")
        disk.set_theta_direction(-1)
        for i in range(azimuth.shape[1]):
            seen = np.isfinite(azimuth[:, i])
            if not seen.any():
                continue
            disk.plot(azimuth[:, i], 90.0 - np.rad2deg(elevation[:, i]), color=BLUE, linewidth=1.0)
            last = int(np.flatnonzero(seen)[-1])
            at = (azimuth[last, i], 90.0 - np.rad2deg(elevation[last, i]))
            disk.plot(*at, "o", color=BLUE, ms=4, clip_on=False)
            disk.annotate(f"G{i + 1:02d}", at, xytext=(4, 3), textcoords="offset points", fontsize=7, color=GREY)
        disk.set_ylim(0.0, 90.0)
        disk.set_yticks([0.0, 30.0, 60.0, 90.0], ["", "60°", "30°", ""], fontsize=7)
        disk.set_xticks(np.deg2rad([0.0, 90.0, 180.0, 270.0]), ["N", "E", "S", "W"], fontsize=8)
        disk.grid(True, color="#c5ced6", linewidth=0.5)
        disk.set_title("Two hours of sky", loc="left", fontsize=10.5, fontweight="bold", color=INK)
        style(scatter, "Error against dilution", "PDOP", "position error [m]")
        scatter.loglog(pdop[usual], length[usual], ".", color=GREY, ms=2, alpha=0.35, label="one epoch")
        centre = predicted / SIGMA_M
        scatter.loglog(centre, measured, "o", color=RED, ms=5, label="rms of an eighth")
        scatter.loglog(centre, predicted, color=BLUE, linewidth=1.2, label=f"PDOP · {SIGMA_M:g} m")
        scatter.set_xticks([], minor=True)
        scatter.set_xticks([1.5, 2.0, 3.0, 5.0, 10.0, 20.0], ["1.5", "2", "3", "5", "10", "20"])
        scatter.set_ylim(0.05, 200.0)
        scatter.legend(frameon=False, fontsize=8, loc="upper left")
        style(histogram, "Without noise", "error [m]", "epochs")
        spread = np.maximum(np.linalg.norm(exact[:, :3], axis=1), 1e-10)
        histogram.hist(spread, bins=np.logspace(-10, -2, 49).tolist(), color=GREEN)
        histogram.set_xscale("log")
        histogram.axvline(1e-3, color=RED, linewidth=1.0, linestyle=(0, (4, 3)))
        histogram.annotate("1 mm", (1e-3, 0.93), xycoords=("data", "axes fraction"), xytext=(-3, 0),
                         textcoords="offset points", fontsize=8, color=RED, ha="right")  # fmt: skip
    lab.save(
        exact_m=exact, errors_m=errors, sigmas_m=sigmas, dop=dops, used=used, predicted_m=predicted, rms_m=measured
    )

    n = len(errors)
    yield Claim(f"share of {2 * n} epochs with a position", 1.0 - lost / (2.0 * n), at_least(1.0))
    yield Claim("worst error without noise, position and clock", float(np.abs(exact).max()), at_most(1e-3, "m"))
    # Each component over DOP times sigma is standard normal, the epochs independent: 4.9 standard deviations.
    normalized = errors / sigmas
    width = np.ceil(4.9e3 * np.sqrt(2.0 / n)) / 1e3
    shift = np.ceil(4.5e3 / np.sqrt(n)) / 1e3
    for i, name in enumerate(("east", "north", "up", "clock")):
        yield Claim(
            f"{name}: mean square error over (DOP σ)², {n} epochs",
            float(np.mean(normalized[:, i] ** 2)),
            band(1.0 - width, 1.0 + width),
        )
        yield Claim(
            f"{name}: mean error over DOP σ",
            float(np.mean(normalized[:, i])),
            band(-shift, shift),
        )
    # The square of an epoch's length spreads by at most sqrt(2) of its mean.
    slack = max(5.2 * np.sqrt(2.0 * np.sum(p**4)) / np.sum(p**2) / 2.0 for p, _ in bins)
    yield Claim(
        "rms position error over PDOP σ in each eighth of the epochs by PDOP: least and most",
        (float((measured / predicted).min()), float((measured / predicted).max())),
        band(1.0 - np.ceil(1e3 * slack) / 1e3, 1.0 + np.ceil(1e3 * slack) / 1e3),
    )
