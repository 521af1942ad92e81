"""The command line: options, help, and how a refusal ends."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, ParamSpec

import click
from rich.console import Console

from soopnav_cpp import __version__, io
from soopnav_cpp._extras import MissingExtraError
from soopnav_cpp.cli.progress import progress

__all__ = ["cli"]

_P = ParamSpec("_P")


_LEAST_WIDTH = 110  # of a table: a narrow terminal wraps its lines, and a pipe has no width


def _stdout() -> Console:
    console = Console()
    return console if console.width >= _LEAST_WIDTH else Console(width=_LEAST_WIDTH)


class _Refusal(click.ClickException):
    """Bad input: the sentence alone on stderr, exit code 2."""

    exit_code = 2

    def show(self, file: IO[Any] | None = None) -> None:
        click.echo(self.message, err=file is None, file=file)


def _sentences(command: Callable[_P, None]) -> Callable[_P, None]:
    """Refused input ends the command with its sentence and exit code 2, without a traceback."""

    @functools.wraps(command)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except (ValueError, MissingExtraError) as error:
            raise _Refusal(str(error)) from error
        except MemoryError as error:
            raise _Refusal("the capture does not fit in memory") from error
        except OSError as error:
            path = "" if error.filename is None else f"{error.filename}: "
            raise _Refusal(f"{path}{error.strerror.lower()}" if error.strerror else str(error)) from error

    return run


def _capture_options(command: Callable[_P, None]) -> Callable[_P, None]:
    options = (
        click.option("--rate", "rate_hz", type=float, metavar="HZ", help="Sample rate of a raw file."),
        click.option(
            "--format",
            "sample_format",
            metavar="FORMAT",
            help=f"Samples of a raw file: {', '.join(io.RAW_FORMATS)}.",
        ),
        click.option(
            "--max-cfo",
            "max_cfo_hz",
            type=float,
            metavar="HZ",
            default=150e3,
            help="Carrier offsets searched, to either side.  [default: 150e3]",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="soopnav")
def cli() -> None:
    """Position and time from signals that were not made for it.

    A CAPTURE is a SigMF recording (the .sigmf-meta or .sigmf-data file) or a raw file of interleaved I and Q; a raw one
    needs --rate and --format.

    \b
      soopnav scan city.sigmf-meta
      soopnav scan city.cu8 --rate 1.92e6 --plot city.png
      soopnav locate city.sigmf-meta --nodes nodes.toml
      soopnav synth lte city.toml city.sigmf-meta
    """


@cli.command()
@click.argument("capture", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw what was found.")
@_capture_options
@_sentences
def scan(
    capture: Path,
    as_json: bool,
    plot: Path | None,
    rate_hz: float | None,
    sample_format: str | None,
    max_cfo_hz: float,
) -> None:
    """Find the LTE cells in CAPTURE.

    Prints a row per cell, strongest first: identity, duplex mode, cyclic prefix, bandwidth in resource blocks, antenna
    ports, system frame number, carrier offset, sampling-clock error, SNR per reference element, and when the first path
    of its first radio frame arrives, counted from the first sample.
    """
    from soopnav_cpp.cli import scan as work

    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    with progress() as step:
        result = work.scan(capture, rate_hz=rate_hz, sample_format=sample_format, max_cfo_hz=max_cfo_hz, step=step)
        if plot is not None:
            from soopnav_cpp import plotting

            step(f"drawing {plot.name}")
            plotting.scan(
                result.iq,
                result.metadata.sample_rate_hz,
                [cell.detection for cell in result.cells],
                [cell.arrival for cell in result.cells],
                center_frequency_hz=result.metadata.center_frequency_hz,
                title=work.header(result.metadata),
                path=plot,
            )
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
        return
    work.print_table(result, _stdout())
    if plot is not None:
        click.echo(f"plot: {plot}")


@cli.command(short_help="Find where CAPTURE was recorded.")
@click.argument("capture", type=click.Path(path_type=Path))
@click.option("--nodes", type=click.Path(path_type=Path), required=True, metavar="TOML", help="Where the cells stand.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder of the report.  [default: NAME.locate]",
)
@_capture_options
@_sentences
def locate(
    capture: Path,
    nodes: Path,
    as_json: bool,
    out: Path | None,
    rate_hz: float | None,
    sample_format: str | None,
    max_cfo_hz: float,
) -> None:
    """Find where CAPTURE was recorded, from cells whose positions are known.

    The nodes file lists them; the receiver's clock need not be known:

    \b
      [receiver]
      height_m = 1.5                       # a position in two dimensions at this height
      [[nodes]]
      cell_id = 301
      position_m = [150.0, 620.0, 0.0]     # or latitude_deg, longitude_deg, height_m
      antenna_height_m = 35.0              # added to the height
      clock_offset_s = 0.0                 # how late the node transmits
      sigma_s = 5e-9                       # standard deviation of its clock

    Writes report.html, map.png, fix.geojson and metrics.json.
    """
    from soopnav_cpp.cli import locate as work

    with progress() as step:
        result = work.locate(
            capture, nodes, rate_hz=rate_hz, sample_format=sample_format, max_cfo_hz=max_cfo_hz, step=step
        )
        folder = out if out is not None else Path(f"{work.stem(capture)}.locate")
        step("writing the report")
        report = work.write_report(result, folder)
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
        return
    work.print_result(result, _stdout())
    click.echo(f"report: {report}")


@cli.group()
def synth() -> None:
    """Make captures."""


@synth.command("lte")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@_sentences
def synth_lte(scenario: Path, out: Path) -> None:
    """Make the capture that SCENARIO (TOML) describes: OUT.sigmf-meta and its data file.

    \b
      [capture]
      sample_rate_hz = 19.2e6
      duration_s = 0.06
      snr_db = 20.0                        # per reference element of a cell at 0 dB
      seed = 7
      format = "ci8"                       # cf32, ci16, ci8, cu8
      [receiver]
      position_m = [180.0, -120.0, 1.5]    # east, north, up
      clock_bias_s = 3.2e-3
      [[cells]]
      cell_id = 301
      n_rb = 100
      n_ports = 2
      position_m = [150.0, 620.0, 35.0]
      taps = [{delay_s = 0.0, power_db = 0.0}, {delay_s = 310e-9, power_db = -6.0}]
    """
    from soopnav_cpp.cli import synth as work

    with progress() as step:
        written, n_samples = work.synthesize(scenario, out, step=step)
    click.echo(f"{written}: {n_samples} samples")
