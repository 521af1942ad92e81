"""Where a GPS antenna is: single-point positions, epoch by epoch, with a figure.

python examples/gnss_point.py                                an antenna in a made-up sky
python examples/gnss_point.py OBSERVATIONS NAVIGATION        RINEX 3 files (needs soopnav[gnss])

Prints the mean position, its spread, and what became of the satellites; draws gnss_point.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import soopnav_cpp as sn


def made_up() -> tuple[sn.gnss.Observations, sn.gnss.Ephemerides, np.ndarray]:
    """Ten minutes of an antenna under thirty satellites, with multipath and a receiver clock that drifts."""
    sky = sn.gnss.walker_constellation(30, 6, 1, week=2200, toe_s=302_400.0)
    here = sn.geometry.geodetic_to_ecef(np.deg2rad(52.2), np.deg2rad(0.12), 60.0)
    seconds = 302_400.0 + np.arange(600.0)
    clock = sn.clock.TwoState.tcxo().simulate(1.0, len(seconds), seed=3)
    seen = sn.simulation.simulate_gnss(
        sky, here, seconds, seed=1, troposphere=True, multipath_sigma_m=0.5, clock_bias_m=clock.bias_m,
        clock_drift_mps=clock.drift * 299_792_458.0,
    )  # fmt: skip
    return seen.antennas[0], sky, here


def draw(errors_m: np.ndarray, elapsed_s: np.ndarray, fixes: sn.gnss.PointFixes, path: Path) -> None:
    """East and north beside a map, up and the stated standard deviation over time."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    left.plot(errors_m[:, 0], errors_m[:, 1], ".", ms=3, alpha=0.5)
    left.set_aspect("equal", adjustable="datalim")
    left.set(xlabel="east [m]", ylabel="north [m]", title="Positions")
    sigma = np.sqrt(fixes.covariance_enu_m2[:, 2, 2])
    right.plot(elapsed_s, errors_m[:, 2], lw=0.8, label="up")
    right.fill_between(elapsed_s, -sigma, sigma, alpha=0.2, label="±1σ stated")
    right.set(xlabel="time [s]", ylabel="up [m]", title="Height")
    right.legend(frameon=False)
    for axes in (left, right):
        axes.grid(True, lw=0.4, alpha=0.6)
    figure.savefig(path, dpi=150)


def main() -> None:
    if len(sys.argv) == 3:
        observed, orbits = sn.gnss.read_observations(sys.argv[1]), sn.gnss.read_navigation(sys.argv[2])
        reference = observed.approximate_position_ecef_m
    else:
        observed, orbits, reference = made_up()
    for problem in (*observed.problems, *orbits.problems):
        print(problem)
    fixes = sn.gnss.single_point(observed, orbits, sigma_m=0.6)
    print(fixes)
    if not fixes.converged.any():
        sys.exit(fixes.message())
    if not np.isfinite(reference).all():
        reference = fixes.position_m[fixes.converged].mean(axis=0)
    errors_m = fixes.errors_enu_m(reference)
    latitude, longitude, height = sn.geometry.ecef_to_geodetic(np.nanmean(fixes.position_m, axis=0))
    print(f"{np.rad2deg(latitude):.7f} N  {np.rad2deg(longitude):.7f} E  {height:.2f} m")
    rms = np.sqrt(np.nanmean(errors_m**2, axis=0))
    print(
        "rms about the reference [m]: "
        + "  ".join(f"{n} {r:.2f}" for n, r in zip(("east", "north", "up"), rms, strict=True))
    )
    print(f"velocity rms [m/s]: {np.sqrt(np.nanmean(np.sum(fixes.velocity_mps**2, axis=1))):.3f}")
    draw(errors_m, observed.elapsed_s, fixes, Path("gnss_point.png"))
    if len(sys.argv) == 1:
        assert fixes.converged.all()
        assert rms.max() < 3.0, rms


if __name__ == "__main__":
    main()
