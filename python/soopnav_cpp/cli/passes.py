"""The command ``passes``: which satellites pass over a place, and when."""

from __future__ import annotations

import json
import math
from datetime import datetime
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from soopnav_cpp import geometry, orbits
from soopnav_cpp.cli import text
from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.numbers import Finite
from soopnav_cpp.cli.progress import progress

__all__ = ["as_json", "passes"]


def _place(_context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, float, float]:
    """Degrees and metres with commas between them."""
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"{value}: LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,HEIGHT expected", param=parameter)
    if not (abs(numbers[0]) <= 90.0 and abs(numbers[1]) <= 360.0):
        raise click.BadParameter(f"{value}: a latitude of at most 90 degrees expected first", param=parameter)
    return numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0


@click.command(short_help="Which satellites pass over a place.")
@click.argument("elements", type=click.Path(path_type=Path), metavar="TLE|OMM")
@click.option("--at", "place", callback=_place, required=True, metavar="LAT,LON[,H]", help="Degrees, metres.")
@click.option("--start", required=True, metavar="ISO", help="UTC, such as 2014-08-27T06:00:00Z.")
@click.option(
    "--duration",
    "duration_min",
    type=Finite(min=0.0, min_open=True, max=10080.0),
    default=60.0,
    metavar="MIN",
    help="Minutes, at most a week.  [default: 60]",
)
@click.option(
    "--mask", "mask_deg", type=Finite(-10.0, 89.0), default=8.0, metavar="DEG", help="Least elevation.  [default: 8]"
)
@click.option(
    "--carrier",
    "carrier_hz",
    type=Finite(min=0.0, min_open=True),
    default=1626.270833e6,
    metavar="HZ",
    help="Of the Dopplers.  [default: 1626.270833e6, Iridium's ring alert]",
)
@click.option("--json", "as_text", is_flag=True, help="Print JSON and nothing else.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw sky, elevations and Dopplers.")
@sentences
def passes(
    elements: Path,
    place: tuple[float, float, float],
    start: str,
    duration_min: float,
    mask_deg: float,
    carrier_hz: float,
    as_text: bool,
    plot: Path | None,
) -> None:
    """List the passes of satellites over a place, from their orbital elements.

    Elements are two-line elements (.tle, .3le, .txt) or orbit mean-elements messages (XML, JSON, CSV, key = value).
    Prints a row per pass: when it rises above the mask, stands highest and sets, where, how far, and the Doppler of the
    carrier at rise, highest and set. A pass cut by the span is marked with an asterisk.

    \b
      soopnav passes iridium.tle --at 60.2,25.0 --start 2014-08-27T06:00:00Z --duration 30 --plot sky.png
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    with progress() as step:
        begin = orbits.utc(start)
        step("orbits")
        satellites = orbits.read_orbits(elements)
        sampled = [s.sampled(begin, 60.0 * duration_min) for s in satellites]
        p_e = geometry.geodetic_to_ecef(math.radians(place[0]), math.radians(place[1]), place[2])
        step("passes")
        mask_rad = math.radians(mask_deg)
        found = orbits.passes(sampled, p_e, 0.0, 60.0 * duration_min, mask_rad=mask_rad, carrier_hz=carrier_hz)
        if plot is not None:
            from soopnav_cpp import plotting

            step(f"drawing {plot.name}")
            plotting.passes(
                sampled,
                p_e,
                0.0,
                60.0 * duration_min,
                names=[s.name for s in satellites],
                mask_rad=mask_rad,
                carrier_hz=carrier_hz,
                reference=begin,
                title=f"{elements.name} over {place[0]:g}, {place[1]:g}, from {begin:%Y-%m-%d %H:%M} UTC",
                path=plot,
            )
    if as_text:
        click.echo(json.dumps(as_json(satellites, found, begin), indent=2, allow_nan=False))
        return
    _print(satellites, found, begin, stdout())
    if plot is not None:
        click.echo(f"plot: {plot}")


def as_json(satellites: list[orbits.Satellite], found: list[orbits.Pass], begin: datetime) -> dict[str, Any]:
    """The passes, in degrees, metres and hertz."""
    rows = []
    for one in found:
        satellite = satellites[one.index]
        rows.append(
            {
                "satellite": satellite.name,
                "number": satellite.number,
                "age_days": satellite.age_s(begin) / 86400.0,
                "rise": orbits.time_text(begin, one.rise_s),
                "highest": orbits.time_text(begin, one.highest_s),
                "set": orbits.time_text(begin, one.set_s),
                "rise_azimuth_deg": math.degrees(one.rise_azimuth_rad),
                "highest_azimuth_deg": math.degrees(one.highest_azimuth_rad),
                "set_azimuth_deg": math.degrees(one.set_azimuth_rad),
                "highest_elevation_deg": math.degrees(one.highest_elevation_rad),
                "range_m": one.range_m,
                "doppler_hz": list(one.doppler_hz),
                "complete": one.complete,
            }
        )
    return {"satellites": len(satellites), "start": orbits.time_text(begin, 0.0), "passes": rows}


def _print(satellites: list[orbits.Satellite], found: list[orbits.Pass], begin: datetime, console: Console) -> None:
    if not found:
        console.print(f"no pass of {len(satellites)} satellites")
        return
    table = Table(box=None, pad_edge=False)
    for name in ("satellite", "rise (UTC)", "highest", "set", "azimuth", "elevation", "range", "Doppler [kHz]"):
        table.add_column(escape(name), justify="left" if name == "satellite" else "right")
    for one in found:
        times = [orbits.time_text(begin, t) for t in (one.rise_s, one.highest_s, one.set_s)]
        azimuths = [f"{math.degrees(a):03.0f}" for a in (one.rise_azimuth_rad, one.highest_azimuth_rad)]
        azimuths.append(f"{math.degrees(one.set_azimuth_rad):03.0f}")
        table.add_row(
            escape(satellites[one.index].name) + ("" if one.complete else " *"),
            times[0][5:19].replace("T", " "),
            times[1][11:19],
            times[2][11:19],
            " ".join(azimuths),
            f"{math.degrees(one.highest_elevation_rad):.1f}°",
            f"{one.range_m / 1e3:.0f} km",
            " ".join(text.signed(f / 1e3, 2) for f in one.doppler_hz),
        )
    console.print(table)
    oldest = max(abs(satellites[one.index].age_s(begin)) for one in found) / 86400.0
    sigma = float(orbits.AlongTrackError().sigma_m(86400.0 * oldest))
    console.print(
        f"{len(found)} passes of {len(np.unique([one.index for one in found]))} satellites out of {len(satellites)}; "
        f"elements up to {oldest:.1f} days off, about {text.metres(sigma)} along the orbit"
    )
