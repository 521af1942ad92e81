"""The command line: options, help, and how a refusal ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec

import click

from soopnav_cpp import __version__, io
from soopnav_cpp.cli import calibrate as _calibrate
from soopnav_cpp.cli import camera, finding
from soopnav_cpp.cli import gnss as _gnss
from soopnav_cpp.cli import passes as _passes
from soopnav_cpp.cli import peer as _peer
from soopnav_cpp.cli import sopdb as _sopdb
from soopnav_cpp.cli.ending import sentences as _sentences
from soopnav_cpp.cli.ending import stdout as _stdout
from soopnav_cpp.cli.progress import progress

__all__ = ["cli"]

_P = ParamSpec("_P")


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
      soopnav scan sky.sigmf-meta --signal iridium
      soopnav locate city.sigmf-meta --nodes nodes.toml
      soopnav synth lte city.toml city.sigmf-meta
      soopnav observe room.toml --out room.png
      soopnav df drive.sigmf-meta --array roof.toml --poses drive.csv
      soopnav locate-emitter bearings.csv
      soopnav passes iridium.tle --at 60.2,25.0 --start 2014-08-27T06:00:00Z
      soopnav gnss station.21O station.21P --plot station.png
      soopnav egomotion walk.mp4 --camera phone.toml --height 1.1
      soopnav peer --role anchor --source city.sigmf-meta --listen 0.0.0.0:7000 --orbits sky.tle --at 60.2,25.0,20
      soopnav caf roof.sigmf-meta car.sigmf-meta --plot caf.png
      soopnav sopdb show --near 60.2,25.0
      soopnav run crossing.toml --runs 100
      soopnav reproduce 'nielsen-*' --out figures
      soopnav bench rts
    """


@cli.command()
@click.argument("capture", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw what was found.")
@click.option(
    "--signal",
    type=click.Choice(["lte", "iridium"]),
    default="lte",
    show_default=True,
    help="What to look for.",
)
@_capture_options
@_sentences
def scan(
    capture: Path,
    as_json: bool,
    plot: Path | None,
    signal: str,
    rate_hz: float | None,
    sample_format: str | None,
    max_cfo_hz: float,
) -> None:
    """Find the LTE cells in CAPTURE, or Iridium's bursts.

    Prints a row per cell, strongest first: identity, duplex mode, cyclic prefix, bandwidth in resource blocks, antenna
    ports, system frame number, carrier offset, sampling-clock error, SNR per reference element, and when the first path
    of its first radio frame arrives, counted from the first sample.

    With --signal iridium a row per burst, by time: start, length (with > when the recording cut it), carrier and its
    standard deviation, bandwidth of 90 % of the power, SNR in 25 kHz, the channels it may belong to with the Doppler it
    then has. Tones and signals that do not end are listed as such.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    if signal == "iridium":
        _scan_bursts(capture, as_json=as_json, plot=plot, rate_hz=rate_hz, sample_format=sample_format)
        return
    from soopnav_cpp.cli import scan as work

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


def _scan_bursts(
    capture: Path, *, as_json: bool, plot: Path | None, rate_hz: float | None, sample_format: str | None
) -> None:
    from soopnav_cpp.cli import scan_bursts as work
    from soopnav_cpp.cli.scan import header

    with progress() as step:
        result = work.scan(capture, rate_hz=rate_hz, sample_format=sample_format, step=step)
        if plot is not None:
            from soopnav_cpp import plotting

            step(f"drawing {plot.name}")
            plotting.burst_spectrogram(
                result.iq,
                result.metadata.sample_rate_hz,
                result.signals,
                center_frequency_hz=result.metadata.center_frequency_hz or 0.0,
                title=header(result.metadata),
                path=plot,
            )
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
        return
    work.print_table(result, _stdout())
    if plot is not None:
        click.echo(f"plot: {plot}")


@cli.command(short_help="Delay and Doppler between the recordings A and B.")
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("--max-delay", "max_delay_s", type=float, default=1e-3, metavar="S", help="[default: 1e-3]")
@click.option("--max-doppler", "max_doppler_hz", type=float, default=40e3, metavar="HZ", help="[default: 40e3]")
@click.option(
    "--bandwidth", "bandwidth_hz", type=float, default=0.0, metavar="HZ", help="Of the signal.  [default: found]"
)
@click.option("--start", "start_s", type=float, default=0.0, metavar="S", help="From the first instant both have.")
@click.option("--duration", "duration_s", type=float, metavar="S", help="[default: all that both have]")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw the surface with both cuts.")
@_sentences
def caf(
    a: Path,
    b: Path,
    max_delay_s: float,
    max_doppler_hz: float,
    bandwidth_hz: float,
    start_s: float,
    duration_s: float | None,
    as_json: bool,
    plot: Path | None,
) -> None:
    """Say which of the recordings A and B hears a common signal later and which higher, and by how much.

    Start times (core:datetime) and centre frequencies of the recordings count: the answer is about the signal on the
    air. Recordings of different rates are brought to the lower one.
    """
    from soopnav_cpp.cli import caf as work

    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    with progress() as step:
        found = work.answer(
            (a, b),
            max_delay_s=max_delay_s,
            max_doppler_hz=max_doppler_hz,
            bandwidth_hz=bandwidth_hz,
            start_s=start_s,
            duration_s=duration_s,
            step=step,
        )
        if plot is not None and found.result.detected:
            step(f"drawing {plot.name}")
            work.draw(found, plot)
    if as_json:
        click.echo(json.dumps(work.as_json(found), indent=2, allow_nan=False))
        return
    for line in work.sentences(found):
        click.echo(line)
    if plot is not None and found.result.detected:
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


@synth.command("pair")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.argument("out_dir", type=click.Path(path_type=Path))
@_sentences
def synth_pair(scenario: Path, out_dir: Path) -> None:
    """Make what two receivers record of the same satellites, each by its own clock.

    Writes OUT_DIR/target.sigmf-meta and anchor.sigmf-meta, whose start times are what each clock showed,
    satellites.csv (orbits that both know) and truth.json.

    \b
      [capture]
      start = 2014-08-27T12:00:00Z         # UTC, by each receiver's clock
      duration_s = 4.0
      sample_rate_hz = 1e6
      center_frequency_hz = 1626.1e6
      format = "ci8"                       # cf32, ci16, ci8
      [anchor]
      latitude_deg = 60.2
      longitude_deg = 25.0
      [target]
      latitude_deg = 60.27
      longitude_deg = 25.11
      velocity_mps = [0.0, 0.0, 0.0]       # east, north, up
      clock = {bias_s = 4e-4, drift_ppm = 0.3, h0 = 8e-20, h_minus_2 = 4e-23}
      [satellites]
      tle = "iridium.tle"                  # without it, 66 are made up
      snr_db = 20.0                        # overhead, in 25 kHz
      ring_alerts_per_s = 2.0              # of each satellite
      duplex_per_s = 3.0
      [[tones]]
      frequency_hz = 1626.02e6
      heard_by = "target"                  # anchor, both
    """
    from soopnav_cpp.cli import synth_pair as work

    with progress() as step:
        files = work.synthesize_pair(scenario, out_dir, step=step)
    for name, path in files.items():
        click.echo(f"{name}: {path}")


@cli.command(short_help="What measurements along a track can tell.")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--out", type=click.Path(path_type=Path), metavar="PNG", help="The map.  [default: SCENARIO.png]")
@_sentences
def observe(scenario: Path, as_json: bool, out: Path | None) -> None:
    """Say what nodes can tell about a track, in any geometry, before anything is built.

    Prints the rank of the measurements, the standard deviation of every unknown, and the directions that cannot be
    seen; draws the deviation over the starts of the track.

    \b
      [measurement]
      kind = "pseudorange"                 # range, pseudorange, range_difference, bearing (sigma_deg)
      sigma_m = 1.0
      [[nodes]]
      name = "A"
      position_m = [0.0, 0.0]              # two coordinates throughout, or three
      [track]
      start_m = [1.0, 1.5]                 # or positions_m = [[...], ...]
      step_m = 0.1
      direction_deg = 0.0
      count = 20
      [unknown]
      offset = ["x"]                       # displacement of the whole track
      step = []                            # error of every step's length
      heading = false                      # turn of the track about its start
      bias = "separate"                    # known, common, separate; drift likewise, per second
      [map]
      low_m = [0.0, 0.0]
      high_m = [2.0, 4.0]
      points = [41, 81]
    """
    from soopnav_cpp.cli import observe as work

    picture = out if out is not None else Path(f"{scenario.stem}.png")
    if picture.suffix.lower() != ".png":
        raise ValueError(f"{picture}: a name that ends in .png expected")
    with progress() as step:
        step("working out the map")
        result = work.observe(scenario)
        step(f"drawing {picture.name}")
        work.draw(result, picture)
    if as_json:
        click.echo(json.dumps(work.as_json(result), indent=2, allow_nan=False))
        return
    work.print_result(result, _stdout())
    click.echo(f"map: {picture}")


cli.add_command(finding.df)
cli.add_command(finding.locate_emitter)
cli.add_command(camera.egomotion)
cli.add_command(_peer.peer)
cli.add_command(_sopdb.sopdb)


@cli.command(short_help="Run a scenario: trajectory, metrics, figures, report.")
@click.argument("scenario", type=click.Path(path_type=Path), required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder of everything that is written.  [default: SCENARIO.run]",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="In place of the scenario's seed.")
@click.option("--runs", type=click.IntRange(min=1), metavar="N", help="In place of the scenario's number of runs.")
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes to spread runs over.  [default: one per processor]",
)
@click.option("--only", type=click.IntRange(min=1), metavar="K", help="Run number K of the Monte-Carlo alone.")
@click.option("--list", "only_list", is_flag=True, help="Name the systems and run none.")
@click.option("--schema", metavar="SYSTEM", help="Print every key of a system's scenarios and run none.")
@click.option("--example", metavar="SYSTEM", help="Print a scenario to start from and run none.")
@_sentences
def run(
    scenario: Path | None,
    out: Path | None,
    seed: int | None,
    runs: int | None,
    jobs: int | None,
    only: int | None,
    only_list: bool,
    schema: str | None,
    example: str | None,
) -> None:
    """Run the system that SCENARIO (TOML) names through what it describes.

    Writes trajectory.tum, .csv, .geojson and, where the scenario has a place on the Earth, .nmea; states.npz,
    metrics.json, runs.csv, figures, and report.html, which holds them all and stands alone.

    With --runs it is a Monte-Carlo: run 1 leaves its trajectory, all of them their metrics. Results depend on the seed
    alone, not on --jobs. Exit code 1 when a run failed.

    \b
      soopnav run --list
      soopnav run --example SYSTEM > mine.toml
      soopnav run mine.toml --runs 100 --jobs 4
    """
    from soopnav_cpp.cli import run as work
    from soopnav_cpp.cli.reproduce import available_jobs

    if only_list:
        work.print_list(_stdout())
        return
    if schema is not None or example is not None:
        click.echo(work.schema(schema) if schema is not None else work.example(example or ""), nl=False)
        return
    if scenario is None:
        raise click.UsageError("Missing argument 'SCENARIO'; --list, --schema and --example need none.")
    with progress() as step:
        done = work.run(scenario, out, seed=seed, runs=runs, jobs=jobs or available_jobs(), only=only, step=step)
    if done.sentence:
        click.echo(done.sentence)
    if done.report is not None:
        click.echo(f"report: {done.report}")
    if done.failed:
        raise click.exceptions.Exit(1)


@cli.command(short_help="Run the papers' experiments and check their claims.")
@click.argument("ids", nargs=-1, metavar="[ID]...")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Names the random numbers.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("reproduced"),
    metavar="DIR",
    help="Folder of figures, data and claims.json.  [default: reproduced]",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes to spread runs over.  [default: one per processor]",
)
@click.option("--list", "only_list", is_flag=True, help="Name the experiments and run none.")
@_sentences
def reproduce(ids: tuple[str, ...], seed: int, out: Path, jobs: int | None, only_list: bool) -> None:
    """Run the experiments that each ID names, all without any, and check what the papers claim.

    An ID may be a glob: 'nielsen-*'. Each experiment writes its figure (ID.png), its data (ID.npz or ID.csv) and a row
    per claim into claims.json; the results depend on the seed alone, not on --jobs. Ends with a table of the claims,
    and with exit code 1 when one does not hold. An experiment whose recording is not here is skipped and named; that is
    exit code 1 only when it was asked for by its whole name, or nothing else ran.
    """
    from soopnav_cpp.cli import reproduce as work

    chosen = work.select(ids)
    if only_list:
        work.print_list(chosen, _stdout())
        return
    with progress() as step:
        outcomes = work.reproduce(
            chosen, seed=seed, out=out, jobs=jobs or work.available_jobs(), step=step, failed=work.report_error
        )
    work.print_table(outcomes, _stdout())
    click.echo(f"figures, data and claims.json: {out}")
    skipped = [outcome.experiment.id for outcome in outcomes if outcome.skipped]
    wanted = any(name in ids for name in skipped) or len(skipped) == len(outcomes)
    if wanted or not all(outcome.holds for outcome in outcomes):
        raise click.exceptions.Exit(1)


@cli.command(short_help="Measure speed beside named peers.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON lines, a row each, and nothing else.")
@click.option("--runs", type=int, default=7, show_default=True, help="Turns of each side.")
@click.option("--list", "only_list", is_flag=True, help="Name the cases and measure none.")
@_sentences
def bench(names: tuple[str, ...], as_json: bool, runs: int, only_list: bool) -> None:
    """Time the cases that each NAME begins or matches as a glob, all without any, each beside its peers.

    Both sides take turns in one run and on one thread; the times are medians, and the ratio is how many times as long
    the peer takes. Their answers are compared: exit code 1 when one differs. A peer that is not installed (pip install
    soopnav[bench]) or cannot run is named, with null for its time. One that needs other versions than are installed
    gets an environment of its own in the user's cache, which is made when it is first needed.

    With --json a row is a line: {"name", "ours_s", "peer", "peer_s", "ratio", "n"}, n the number of turns.
    """
    from soopnav_cpp.cli import bench as work

    cases = work.choose(names)
    if runs < work.LEAST_RUNS:
        raise ValueError(f"--runs {runs}: at least {work.LEAST_RUNS} expected")
    if only_list:
        for case in cases:
            click.echo(f"{case.name}  {case.title}; beside {', '.join(peer.name for peer in case.peers)}")
        return
    if not work.has_one_thread():
        arguments = [*(["--json"] if as_json else []), "--runs", str(runs), "--", *names]
        raise click.exceptions.Exit(work.again_with_one_thread(arguments))
    rows = []
    for case, row in work.bench(cases, runs=runs, step=work.tell):
        rows.append(row)
        if as_json:
            click.echo(json.dumps(row.as_json(), allow_nan=False))
        complaint = work.complaint(case, row)
        if complaint:
            click.echo(complaint, err=True)
    if not as_json:
        work.print_table(rows, _stdout())
    if not all(row.agrees for row in rows):
        raise click.exceptions.Exit(1)


cli.add_command(_calibrate.command)
cli.add_command(_gnss.command)
cli.add_command(_passes.passes)
