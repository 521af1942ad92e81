"""The command ``gnss``: where a standing antenna is, by GPS code and carrier phase in RINEX files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from soopnav_cpp import geometry
from soopnav_cpp import gnss as satellites
from soopnav_cpp.cli import text
from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.numbers import Finite
from soopnav_cpp.cli.progress import progress

__all__ = ["as_json", "command"]

_SECOND = ("2W", "2L", "2X", "2C")
_LIGHT_MPS = 299_792_458.0


@click.command("gnss", short_help="Where a standing antenna is, by GPS phase in RINEX files.")
@click.argument("observations", type=click.Path(path_type=Path), metavar="OBS")
@click.argument("navigation", type=click.Path(path_type=Path), metavar="NAV")
@click.option(
    "--mask", "mask_deg", type=Finite(0.0, 80.0), default=15.0, metavar="DEG", help="Least elevation.  [default: 15]"
)
@click.option(
    "--every", "interval_s", type=Finite(min=0.0, min_open=True), metavar="S", help="Only epochs so far apart."
)
@click.option("--l1", "single", is_flag=True, help="L1 alone, with the broadcast ionosphere.")
@click.option("--json", "as_text", is_flag=True, help="Print JSON and nothing else.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw residuals, errors and the clock.")
@sentences
def command(
    observations: Path,
    navigation: Path,
    mask_deg: float,
    interval_s: float | None,
    single: bool,
    as_text: bool,
    plot: Path | None,
) -> None:
    """Find the position of a standing antenna and its receiver's clock from GPS code and carrier phase.

    OBS and NAV are RINEX 3 files of observations and of navigation messages, read through georinex (pip install
    soopnav[gnss]). L1 and L2 are combined so that the ionosphere drops out; without L2, or with --l1, the broadcast
    ionosphere is taken off. Prints the position with its standard deviation, which counts the errors of the broadcast
    orbits and clocks (they do not average out), a row per satellite, and the receiver's clock.

    \b
      soopnav gnss station.21O station.21P --plot station.png
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    with progress() as step:
        step(f"reading {navigation.name}")
        orbits = satellites.read_navigation(navigation)
        step(f"reading {observations.name}")
        first = satellites.read_observations(observations, interval_s=interval_s)
        second = None
        if not single:
            step(f"reading the second frequency of {observations.name}")
            second = _second(observations, interval_s)
        step("position")
        epochs = max(2, min(30, len(first) // 4))
        fix = satellites.static_phase(
            first, orbits, second, elevation_mask_rad=math.radians(mask_deg), min_arc_epochs=epochs,
            max_gap_s=max(5.0, 2.5 * (interval_s or 0.0)),
        )  # fmt: skip
        if plot is not None and fix.ok:
            from soopnav_cpp import plotting

            step(f"drawing {plot.name}")
            plotting.static_phase(fix, title=observations.name, path=plot)
    problems = (*first.problems, *orbits.problems)
    if not fix.ok:
        raise ValueError(f"{observations}: {fix.message()}" + (f" ({problems[0]})" if problems else ""))
    if as_text:
        click.echo(json.dumps(as_json(fix, first, problems), indent=2, allow_nan=False))
        return
    _print(fix, first, problems, stdout())
    if plot is not None:
        click.echo(f"plot: {plot}")


def _second(path: Path, interval_s: float | None) -> satellites.Observations | None:
    """The second frequency in the first code the file has; None without any."""
    header = path.read_text(encoding="ascii", errors="replace").split("END OF HEADER")[0]
    for code in _SECOND:
        if f"C{code}" in header and f"L{code}" in header:
            try:
                return satellites.read_observations(path, codes={"G": code}, interval_s=interval_s)
            except ValueError:
                continue
    return None


def _clock(fix: satellites.StaticPhaseFix) -> tuple[float, float]:
    """Offset at the start [s] and drift of the receiver's clock by a straight line."""
    seen = np.isfinite(fix.clock_m)
    if np.count_nonzero(seen) < 2:
        return float(np.nanmean(fix.clock_m)) / _LIGHT_MPS, 0.0
    drift, start = np.polyfit(fix.t_s[seen], fix.clock_m[seen] / _LIGHT_MPS, 1)
    return float(start), float(drift)


def _rows(fix: satellites.StaticPhaseFix) -> list[tuple[str, float, int, float, float, float]]:
    """Name, mean elevation [rad], phases used, their rms [m], error of the broadcast and its sigma [m]."""
    rows = []
    rms = fix.satellite_phase_rms_m()
    for j, name in enumerate(fix.satellites):
        used = fix.use[:, j] == satellites.PhaseUse.USED
        if used.any():
            rows.append(
                (
                    name,
                    float(np.mean(fix.elevation_rad[used, j])),
                    int(used.sum()),
                    float(rms[j]),
                    float(fix.range_error_m[j]),
                    float(fix.range_error_sigma_m[j]),
                )
            )
    return rows


def as_json(
    fix: satellites.StaticPhaseFix, observed: satellites.Observations, problems: tuple[str, ...]
) -> dict[str, Any]:
    """The position, the clock and the satellites, in degrees, metres and seconds."""
    latitude, longitude, height = (float(x) for x in geometry.ecef_to_geodetic(fix.position_m))
    start, drift = _clock(fix)
    header = observed.approximate_position_ecef_m
    return {
        "position_e_m": fix.position_m.tolist(),
        "covariance_m2": fix.covariance_m2.tolist(),
        "latitude_deg": math.degrees(latitude),
        "longitude_deg": math.degrees(longitude),
        "height_m": height,
        "sigma_m": fix.sigma_m,
        "from_header_m": float(np.linalg.norm(fix.position_m - header)) if np.isfinite(header).all() else None,
        "epochs": len(fix.t_s),
        "phases": fix.phases,
        "phase_rms_m": fix.phase_rms_m,
        "code_rms_m": fix.code_rms_m,
        "arcs": fix.arcs,
        "slips": fix.slips,
        "rejected": fix.rejected,
        "zenith_delay_correction_m": fix.zenith_m,
        "clock_s": start,
        "clock_drift": drift,
        "satellites": [
            {
                "name": name,
                "elevation_deg": math.degrees(elevation),
                "phases": count,
                "phase_rms_m": rms,
                "broadcast_error_m": error,
                "broadcast_error_sigma_m": sigma,
            }
            for name, elevation, count, rms, error, sigma in _rows(fix)
        ],
        "problems": list(problems),
    }


def _print(
    fix: satellites.StaticPhaseFix, observed: satellites.Observations, problems: tuple[str, ...], console: Console
) -> None:
    latitude, longitude, height = (float(x) for x in geometry.ecef_to_geodetic(fix.position_m))
    sigma = np.sqrt(np.diag(fix.covariance_enu_m2))
    console.print(
        f"{abs(math.degrees(latitude)):.7f} {'N' if latitude >= 0.0 else 'S'}  "
        f"{abs(math.degrees(longitude)):.7f} {'E' if longitude >= 0.0 else 'W'}  {text.plain(height, 2)} m",
        highlight=False,
    )
    console.print(
        f"± {sigma[0]:.2f} m east, {sigma[1]:.2f} m north, {sigma[2]:.2f} m up (1σ, broadcast errors counted)",
        highlight=False,
    )
    header = observed.approximate_position_ecef_m
    if np.isfinite(header).all():
        away = float(np.linalg.norm(fix.position_m - header))
        console.print(f"{text.metres(away)} from the position in the file's header", highlight=False)
    start, drift = _clock(fix)
    console.print(
        f"receiver's clock {text.signed(1e6 * start, 3)} µs at the first epoch, {text.signed(1e6 * drift, 5)} ppm; "
        f"phase residuals {100.0 * fix.phase_rms_m:.1f} cm rms, {fix.slips} slips, {fix.rejected} rejected",
        highlight=False,
    )
    table = Table(box=None, pad_edge=False)
    for name in ("satellite", "elevation", "phases", "residual", "broadcast off by"):
        table.add_column(escape(name), justify="left" if name == "satellite" else "right")
    for name, elevation, count, rms, error, error_sigma in _rows(fix):
        table.add_row(
            name,
            f"{math.degrees(elevation):.0f}°",
            str(count),
            f"{100.0 * rms:.1f} cm",
            f"{text.signed(error, 1)} ± {error_sigma:.1f} m",
        )
    console.print(table)
    used = {row[0] for row in _rows(fix)}
    words = {
        satellites.PhaseUse.PARTIAL: "without the second frequency",
        satellites.PhaseUse.NO_EPHEMERIS: "without orbit",
        satellites.PhaseUse.UNHEALTHY: "unhealthy",
        satellites.PhaseUse.LOW: "too low",
        satellites.PhaseUse.SHORT_ARC: "broken phase",
    }
    left: dict[str, list[str]] = {}
    for j, name in enumerate(fix.satellites):
        counts = np.bincount(fix.use[:, j], minlength=9)
        counts[satellites.PhaseUse.MISSING] = 0
        if name not in used and counts.any():
            left.setdefault(words.get(satellites.PhaseUse(int(counts.argmax())), "rejected"), []).append(name)
    for why, names in left.items():
        console.print(f"not used, {why}: {', '.join(names)}", highlight=False)
    for problem in problems[:5]:
        console.print(escape(problem), highlight=False)
    if len(problems) > 5:
        console.print(f"... and {len(problems) - 5} more problems in the files", highlight=False)
