"""The commands ``df`` and ``locate-emitter``: their options and help."""

from __future__ import annotations

import json
import math
from pathlib import Path

import click

from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.numbers import Finite
from soopnav_cpp.cli.progress import progress

__all__ = ["df", "locate_emitter"]


@click.command(short_help="Find directions with an array of antennas.")
@click.argument("captures", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="CAPTURE...")
@click.option(
    "--array", "array_path", type=click.Path(path_type=Path), required=True, metavar="TOML", help="The array."
)
@click.option("--calibration", type=click.Path(path_type=Path), metavar="JSON", help="Of soopnav calibrate.")
@click.option("--poses", type=click.Path(path_type=Path), metavar="CSV", help="Where the array was and how it stood.")
@click.option(
    "--start", "start_s", type=Finite(), default=0.0, metavar="S", help="Time of the first sample.  [default: 0]"
)
@click.option("--block-samples", type=click.IntRange(min=2), metavar="N", help="Of a bearing.  [default: 2500]")
@click.option("--block-s", type=Finite(min=0.0, min_open=True), metavar="S", help="The same as a time.")
@click.option(
    "--every-s",
    type=Finite(min=0.0, min_open=True),
    metavar="S",
    help="From one block to the next.  [default: without gaps]",
)
@click.option("--sources", default="1", metavar="N", help="Emitters at a time, or auto: counted.  [default: 1]")
@click.option(
    "--method", type=click.Choice(["music", "capon", "bartlett"]), default="music", show_default=True, help="Spectrum."
)
@click.option(
    "--lowest-elevation",
    "elevation_min_deg",
    type=Finite(-90.0, 89.0),
    default=0.0,
    metavar="DEG",
    help="Looked for.  [default: 0]",
)
@click.option(
    "--smooth",
    type=click.IntRange(min=1),
    default=1,
    metavar="BLOCKS",
    help="Deviations from eigenvalues averaged over so many blocks, an odd number.  [default: 1, of each block's own]",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder of the report.  [default: NAME.df]")
@sentences
def df(
    captures: tuple[Path, ...],
    array_path: Path,
    calibration: Path | None,
    poses: Path | None,
    start_s: float,
    block_samples: int | None,
    block_s: float | None,
    every_s: float | None,
    sources: str,
    method: str,
    elevation_min_deg: float,
    smooth: int,
    as_json: bool,
    out: Path | None,
) -> None:
    """Find the directions that the signals in each CAPTURE come from.

    A CAPTURE is a SigMF recording with a channel for each antenna (core:num_channels). Several count as one drive: by
    their core:datetime, or one after the other. The array is described in a file:

    \b
      name = "roof"
      frequency_hz = 1575.42e6
      kind = "elements"                    # or ula, uca, planar
      elements_m = [[0.10, 0.0, 0.0], [0.0, 0.10, 0.0], [-0.10, 0.0, 0.0], [0.0, -0.10, 0.0]]

    Axis 1 of the elements points forward, axis 2 left, axis 3 up. Poses are a CSV with time_s, x_m, y_m (z_m) or
    latitude_deg, longitude_deg (height_m), heading_deg clockwise from north (pitch_deg, roll_deg), or a TUM file; with
    them the bearings are also true ones, and soopnav locate-emitter takes them.

    Writes bearings.csv (time_s, emitter, azimuth_deg and elevation_deg in array axes, their sigma_..._deg, snr_db,
    status; with poses x_m, y_m, z_m or latitude_deg ..., heading_deg, bearing_deg and bearing_elevation_deg with their
    sigma_..._deg), spectrum.png, azimuth.png, metrics.json and report.html. Exit code 2 when there is no bearing at
    all.
    """
    from soopnav_cpp.cli import df as work

    if block_samples is not None and block_s is not None:
        raise ValueError("--block-samples and --block-s: one of them expected")
    if sources != "auto" and not sources.isdecimal():
        raise ValueError(f"--sources {sources}: a number or auto expected")
    with progress() as step:
        found = work.find(
            captures,
            array_path,
            calibration=calibration,
            block_samples=block_samples,
            block_s=block_s,
            every_s=every_s,
            sources=None if sources == "auto" else int(sources),
            method=method,
            poses=poses,
            start_s=start_s,
            elevation_min_deg=elevation_min_deg,
            smooth=smooth,
            step=step,
        )
        folder = out if out is not None else Path(f"{captures[0].stem}.df")
        step("writing the report")
        report = work.write_report(found, folder)
    if as_json:
        click.echo(json.dumps(work.as_json(found), indent=2, allow_nan=False))
    else:
        work.print_result(found, stdout())
        click.echo(f"report: {report}")
    if not found.good.any():
        raise click.exceptions.Exit(2)


def _numbers(_context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[float, ...] | None:
    """Two or three numbers with commas between them."""
    if value is None:
        return None
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"{value}: LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,HEIGHT expected", param=parameter)
    return numbers


@click.command("locate-emitter", short_help="Find where emitters are, from bearings.")
@click.argument("source", type=click.Path(path_type=Path), metavar="BEARINGS.csv|SCENARIO.toml")
@click.option(
    "--method",
    metavar="METHOD",
    help="ml, stansfield, least_squares, ekf_bank, particle, ekf, centroid, incenter, linear, or all.  [default: ml, "
    "or the scenario's]",
)
@click.option("--dimensions", type=click.Choice(["2", "3"]), help="3 takes elevations.  [default: 2]")
@click.option("--moving", is_flag=True, help="Emitters may move at a constant velocity.")
@click.option("--associate", is_flag=True, help="Sort bearings by emitter although no two share a time.")
@click.option(
    "--sigma",
    "sigma_deg",
    type=Finite(min=0.0, min_open=True),
    metavar="DEG",
    help="Standard deviation of bearings, for a file without.",
)
@click.option("--origin", callback=_numbers, metavar="LAT,LON[,H]", help="Puts x_m, y_m on the Earth.")
@click.option("--repair", is_flag=True, help="Leave rows out that cannot be used.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Of particles, and in place of the scenario's.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder of the report.  [default: NAME.emitter]"
)
@sentences
def locate_emitter(
    source: Path,
    method: str | None,
    dimensions: str | None,
    moving: bool,
    associate: bool,
    sigma_deg: float | None,
    origin: tuple[float, ...] | None,
    repair: bool,
    seed: int | None,
    as_json: bool,
    out: Path | None,
) -> None:
    """Find where emitters are, from bearings that were taken in several places.

    BEARINGS.csv is what soopnav df writes, or made by hand: a row per bearing, with units at the ends of the names.

    \b
      x_m,y_m,bearing_deg,sigma_deg        # east and north of anywhere; clockwise from true north
      0,0,41.0,2
      400,0,352.5,2

    In place of x_m, y_m (z_m) latitude_deg, longitude_deg (height_m); in place of bearing_deg azimuth_deg of an array
    (from forward to left) and heading_deg. Further columns: time_s, bearing_elevation_deg, sigma_elevation_deg,
    sigma_position_m and sigma_heading_deg of the platform, emitter (whose bearing it is; without it bearings of one
    time are sorted by where they point), status, and truth_x_m, truth_y_m (truth_z_m) to compare with.

    SCENARIO.toml is a scenario of soopnav run with system = "source_localization"; it takes --method and --seed, the
    other options are for files of bearings.

    Prints a row per emitter and method. Writes map.png, likelihood.png, particles.png, errors.png, emitter.geojson,
    emitter.kml (with a place on the Earth), bearings.csv, metrics.json and report.html. Where bearings do not tell a
    position, all from one place or parallel, it says so, draws the line that they give, and ends with exit code 2.
    """
    from soopnav_cpp.cli import locate_emitter as work

    with progress() as step:
        result = work.locate(
            source,
            method=method,
            dimensions=None if dimensions is None else int(dimensions),
            moving=moving,
            associate=associate,
            sigma_deg=sigma_deg,
            origin=origin,
            repair=repair,
            seed=seed,
            step=step,
        )
        folder = out if out is not None else Path(f"{source.stem}.emitter")
        step("writing the report")
        report = work.write_report(result, folder)
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
    else:
        work.print_result(result, stdout())
        click.echo(f"report: {report}")
    if not result.found:
        raise click.exceptions.Exit(2)
