"""The command ``egomotion``: its options and help."""

from __future__ import annotations

import json
import math
from pathlib import Path

import click

from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.numbers import Finite
from soopnav_cpp.cli.progress import progress

__all__ = ["egomotion"]

_MOST_TILT_DEG = 60.0


def _plane(_context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[float, float, float] | None:
    """A height, and perhaps two tilts, with commas between them."""
    if value is None:
        return None
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (1, 3) or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"{value}: HEIGHT or HEIGHT,TILT_X,TILT_Y expected", param=parameter)
    height, x, y = (*numbers, 0.0, 0.0)[:3]
    if not height > 0.0:
        raise click.BadParameter(f"{value}: a height above zero expected", param=parameter)
    if max(abs(x), abs(y)) > _MOST_TILT_DEG:
        raise click.BadParameter(f"{value}: tilts up to {_MOST_TILT_DEG:g}° expected", param=parameter)
    return height, x, y


_POSITIVE = Finite(min=0.0, min_open=True)


@click.command(short_help="Follow the ground in a video: where the camera went.")
@click.argument("video", type=click.Path(path_type=Path))
@click.option(
    "--camera", "camera_path", type=click.Path(path_type=Path), required=True, metavar="TOML", help="The camera."
)
@click.option("--depth", type=click.Path(path_type=Path), metavar="DIR", help="Depth of each frame.")
@click.option("--plane", callback=_plane, metavar="H[,AX,AY]", help="Height [m] and tilt [deg] in place of depth.")
@click.option("--height", "height_m", type=_POSITIVE, metavar="M", help="The same as --plane M,0,0.")
@click.option("--truth", type=click.Path(path_type=Path), metavar="FILE", help="Where the camera truly was.")
@click.option(
    "--start", "start_s", type=float, default=0.0, metavar="S", help="Time added to the video's.  [default: 0]"
)
@click.option("--rate", "rate_hz", type=_POSITIVE, metavar="HZ", help="Frames per second of a folder of pictures.")
@click.option("--every", type=click.IntRange(min=1), default=1, metavar="N", help="Use each N-th frame.  [default: 1]")
@click.option("--frames", type=click.IntRange(min=1), metavar="N", help="Stop after so many.")
@click.option("--features", type=click.IntRange(min=8, max=5000), metavar="N", help="Tracks at a time.  [default: 300]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the random hypotheses.")
@click.option("--tracks", type=click.Path(path_type=Path), metavar="FILE", help="A video (.mp4, .gif) of the tracks.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder of the report.  [default: NAME.egomotion]"
)
@sentences
def egomotion(
    video: Path,
    camera_path: Path,
    depth: Path | None,
    plane: tuple[float, float, float] | None,
    height_m: float | None,
    truth: Path | None,
    start_s: float,
    rate_hz: float | None,
    every: int,
    frames: int | None,
    features: int | None,
    seed: int,
    tracks: Path | None,
    as_json: bool,
    out: Path | None,
) -> None:
    """Find how a camera that looks at the ground moved, from VIDEO: a file or a folder of pictures.

    The camera is described in a file:

    \b
      model = "pinhole"                    # or radial_tangential, fisheye
      width = 640
      height = 480
      fx = 525.0                           # [px]
      fy = 525.0
      cx = 319.5                           # pixels are whole at their centres
      cy = 239.5
      distortion = []                      # k1, k2, p1, p2, k3; of a fisheye k1 ... k4
      [depth]                              # of a depth camera beside it
      offset_m = [0.025, 0.0, 0.0]
      plane_band_m = 0.01                  # see "Camera ego-motion"
      plane_max_tilt_deg = 60.0            # more is a wall

    The ground is one of: --depth, a folder with a file per frame (.npy or .npz of points (n, 3) or of a depth image,
    .pcd, .png of 16 bits in millimetres; the n-th file belongs to the n-th frame, unless names are times: 12.05.npy),
    --plane, or --height. Frames whose time stamp goes back or leaps ahead alone are left out. The truth is a TUM file,
    or a CSV with time_s, position_x_m, position_y_m, heading_rad; with it errors and their consistency (NEES) are told.

    Writes trajectory.tum and .csv, increments.csv (each with its covariance and status), walk.png, increments.png,
    frames with their tracks, metrics.json and report.html. Exit code 2 when no increment could be measured.
    """
    from soopnav_cpp.cli import egomotion as work

    given = [name for name, value in (("--depth", depth), ("--plane", plane), ("--height", height_m)) if value]
    if len(given) != 1:
        raise ValueError(f"{' and '.join(given) or 'no ground'}: one of --depth, --plane and --height expected")
    if not math.isfinite(start_s):
        raise ValueError(f"--start {start_s:g}: a finite number expected")
    if tracks is not None and tracks.suffix.lower() not in (".mp4", ".mkv", ".avi", ".gif"):
        raise ValueError(f"{tracks}: a name that ends in .mp4, .mkv, .avi or .gif expected")
    held = plane or ((height_m, 0.0, 0.0) if height_m else (None, 0.0, 0.0))
    with progress() as step:
        result = work.follow(
            video,
            camera_path,
            work.Ground(depth, *held),
            truth=truth,
            rate_hz=rate_hz,
            start_s=start_s,
            every=every,
            most=frames,
            features=features,
            seed=seed,
            tracks_path=tracks,
            step=step,
        )
        folder = out if out is not None else Path(f"{video.stem or video.resolve().name}.egomotion")
        step("writing the report")
        report = work.write_report(result, folder)
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
    else:
        work.print_result(result, stdout())
        click.echo(f"report: {report}")
    if not result.measured.any():
        raise click.exceptions.Exit(2)
