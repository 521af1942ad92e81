"""A GNSS compass: heading and pitch of the line between two antennas, epoch by epoch, and a figure.

python examples/gnss_compass.py                                      two simulated antennas on a turning platform
python examples/gnss_compass.py ROVER.obs BASE.obs BASE.nav          two RINEX 3 files and broadcast orbits
python examples/gnss_compass.py ROVER.obs BASE.obs BASE.nav 0.990    the antennas are known to be 0.990 m apart

The heading is that of the way from the base's antenna to the rover's, from north towards east. Every epoch stands for
itself: its code and carrier phase, integers by LAMBDA or over the sphere of the known length, and the ratio test.
Reading files needs the extra gnss. Prints a summary, and draws gnss_compass.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from soopnav_cpp import geometry, gnss, simulation


def report(run: gnss.BaselineRun, elapsed_s: np.ndarray, title: str, figure: Path | None) -> None:
    """What a run found, printed and drawn."""
    fixed = run.fixed
    print(f"{title}: {len(fixed)} epochs, {run.satellites.mean():.1f} satellites, {fixed.mean():.1%} fixed")
    if fixed.any():
        sigma = np.rad2deg(np.median(run.heading_sigma_rad[fixed])), np.rad2deg(np.median(run.pitch_sigma_rad[fixed]))
        print(f"heading ± {sigma[0]:.2f}°, pitch ± {sigma[1]:.2f}° as stated, median")
        length = np.linalg.norm(run.baseline_enu_m[fixed], axis=1)
        print(f"length {length.mean():.4f} m, spread {1e3 * length.std():.1f} mm")
    if figure is not None:
        draw(run, elapsed_s, title, figure)


def draw(run: gnss.BaselineRun, elapsed_s: np.ndarray, title: str, path: Path) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("no figure: matplotlib is not installed")
        return
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True, height_ratios=(2.0, 2.0, 1.0))
    for axes, name, value, sigma in (
        (panels[0], "heading", run.heading_rad, run.heading_sigma_rad),
        (panels[1], "pitch", run.pitch_rad, run.pitch_sigma_rad),
    ):
        degrees, band = np.rad2deg(np.where(run.fixed, value, np.nan)), np.rad2deg(sigma)
        axes.fill_between(elapsed_s, degrees - band, degrees + band, color="#1b6ca8", alpha=0.2, lw=0, label="± 1σ")
        axes.plot(elapsed_s, degrees, ".", color="#1b6ca8", ms=3.5, label="fixed")
        axes.set_ylabel(f"{name} [deg]")
    panels[0].legend(frameon=False, fontsize=9, ncol=2)
    panels[2].semilogy(elapsed_s, run.ratio, ".", color="#2e933c", ms=3.5)
    panels[2].axhline(3.0, color="#22303c", lw=0.8, ls=(0, (4, 3)))
    panels[2].set_ylabel("ratio")
    panels[2].set_xlabel("time [s]")
    panels[0].set_title(title, loc="left", fontsize=10.5, fontweight="bold")
    for axes in panels:
        axes.grid(True, linewidth=0.3, alpha=0.6)
    figure.savefig(path, dpi=120)


def analyse(rover: Path, base: Path, navigation: Path, length_m: float | None = None, figure: Path | None = None):
    """Heading over two RINEX files."""
    orbits = gnss.read_navigation(navigation)
    rover_obs, base_obs = gnss.read_observations(rover), gnss.read_observations(base)
    run = gnss.solve_baseline(rover_obs, base_obs, orbits, length_m=length_m)
    seconds = gnss.receiver_differences(rover_obs, base_obs, orbits, base_obs.approximate_position_ecef_m).elapsed_s
    report(run, seconds, f"{rover.name} - {base.name}", figure)
    return run


def simulated():
    """Two antennas 1 m apart on a platform that turns by 3 degrees each second; heading errors in degrees."""
    t_s = np.arange(120.0)
    heading = np.deg2rad(40.0 + 3.0 * t_s)
    enu = np.stack([np.sin(heading), np.cos(heading), np.zeros_like(heading)], axis=1)
    place = geometry.LocalFrame(0.613, 2.391, 105.0)
    antennas = np.stack([place.position_to_ecef(np.zeros_like(enu)), place.position_to_ecef(enu)])
    sky = gnss.walker_constellation(30, 6, 1, week=2320, toe_s=116_400.0)
    seen = simulation.simulate_gnss(sky, antennas, 116_400.0 + t_s, seed=1, code_sigma_m=0.15, phase_sigma_m=0.002)
    base, rover = seen.antennas
    run = gnss.solve_baseline(rover, base, sky, length_m=1.0)
    report(run, t_s, "Two simulated antennas", Path("gnss_compass.png"))
    off = np.rad2deg((run.heading_rad - heading + np.pi) % (2.0 * np.pi) - np.pi)
    return off[run.fixed], run


def main() -> None:
    if len(sys.argv) > 1:
        if len(sys.argv) not in (4, 5):
            raise SystemExit(__doc__)
        length_m = float(sys.argv[4]) if len(sys.argv) == 5 else None
        analyse(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), length_m, Path("gnss_compass.png"))
        return
    error_deg, run = simulated()
    print(f"heading error {np.sqrt(np.mean(error_deg**2)):.3f}° rms")
    assert run.fixed.mean() > 0.95
    assert np.abs(error_deg).max() < 1.5


if __name__ == "__main__":
    main()
