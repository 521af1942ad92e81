"""Where a receiver is, from the Dopplers of satellites that pass over it.

python examples/doppler_fix.py               ten minutes of a made-up Iridium sky
python examples/doppler_fix.py DOPPLERS.csv  recorded: time, satellite, Doppler [Hz], ECEF position (3) [m] and velocity
                                             (3) [m/s]; latitude, longitude and height in columns 11 to 13 of row 1

Prints the position with its ellipse and whether the satellites' own frequency errors belong into the model; draws
doppler_fix.png. Gaussian models only: recorded sets are often cut around the truth, and another loss may find the cut.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import soopnav_cpp as sn

CARRIER_HZ = 1626.270833e6


def made_up() -> tuple[tuple[np.ndarray, ...], float, np.ndarray]:
    """Dopplers with 5 Hz of noise, 2 Hz of error of each satellite and 300 Hz of the receiver."""
    here = sn.geometry.geodetic_to_ecef(np.radians(47.4), np.radians(8.5), 450.0)
    random = np.random.default_rng(4)
    t = np.arange(0.0, 600.0, 10.0)
    rows = []
    for k, orbit in enumerate(sn.orbits.iridium_walker(600.0)):
        up = t[sn.orbits.elevations([orbit], t, here)[1][0] > np.radians(10.0)]
        doppler = -CARRIER_HZ * sn.geometry.signal_path(orbit, up, here).delay_rate
        doppler += 300.0 + 2.0 * random.standard_normal() + 5.0 * random.standard_normal(len(up))
        rows.append(np.column_stack([up, np.full(len(up), k), doppler, *orbit.at(up)]))
    d = np.concatenate(rows)
    return (d[:, 0], d[:, 1].astype(int), d[:, 2], d[:, 3:6], d[:, 6:9]), 450.0, here


def recorded(path: Path) -> tuple[tuple[np.ndarray, ...], float, np.ndarray]:
    """A table whose first row also holds the receiver's latitude, longitude and height."""
    lines = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()[1:]]
    d = np.array([[float(x) for x in line[:9]] for line in lines])
    latitude, longitude, height = (float(x) for x in lines[0][10:13])
    here = sn.geometry.geodetic_to_ecef(np.radians(latitude), np.radians(longitude), height)
    return (d[:, 0], d[:, 1].astype(int), d[:, 2], d[:, 3:6], d[:, 6:9]), height, here


def draw(rows: tuple[np.ndarray, ...], fix: sn.navigation.DopplerFix, here: np.ndarray, path: Path) -> None:
    """Residuals by satellite, and the place with its 99 % ellipse."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for satellite in fix.satellites:
        of = rows[1] == satellite
        left.plot(rows[0][of], fix.residuals_hz[of], ".", ms=4, label=str(satellite))
    left.set(xlabel="time [s]", ylabel="measured minus fitted [Hz]", title="Residuals")
    left.legend(
        title="satellite", fontsize=7, title_fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5)
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    root = np.linalg.cholesky(fix.covariance_enu_m2[:2, :2])
    for gate, share, style in ((2.30, "68 %", "-"), (9.21, "99 %", "--")):
        curve = np.sqrt(gate) * root @ np.stack([np.cos(turn), np.sin(turn)])
        right.plot(*curve, style, color="#1b6ca8", lw=1.2, label=share)
    error = fix.error_enu_m(here)
    right.plot(0.0, 0.0, "o", color="#1b6ca8", label="found")
    right.plot(-error[0], -error[1], "k+", ms=10, mew=1.5, label="true")
    right.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="east [m]", ylabel="north [m]", title="Place")
    right.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4)
    for axes in (left, right):
        axes.grid(True, lw=0.4, alpha=0.6)
    figure.savefig(path, dpi=150)


def main() -> None:
    rows, height_m, here = recorded(Path(sys.argv[1])) if len(sys.argv) == 2 else made_up()
    fix = sn.navigation.doppler_fix(
        *rows,
        sigma_hz=1.0,
        estimate_sigma=True,
        height_m=height_m,
        satellite_bias_sigma_hz=2.0,
        frequency_drift_sigma_hz_per_s=np.inf,
    )
    print(fix)
    error_m = float(np.hypot(*fix.error_enu_m(here)[:2]))
    distance = fix.mahalanobis_2d(here)
    print(f"{error_m:.0f} m off; squared distance in its ellipse {distance:.1f} (99 %: 9.2)")
    print(
        f"constants of the satellites lower chi-square by {fix.bias_chi_square:.1f} on {fix.bias_degrees_of_freedom} "
        f"degrees: p = {fix.bias_probability:.1e}"
    )
    draw(rows, fix, here, Path("doppler_fix.png"))
    assert fix.status is sn.navigation.DopplerStatus.CONVERGED
    assert distance < 18.4  # once in 10 000 times


if __name__ == "__main__":
    main()
