"""The command ``peer``: one of two receivers that find out together where the other one is."""

from __future__ import annotations

import asyncio
import errno
import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import click

from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.numbers import Finite

__all__ = ["peer"]

_EXAMPLE = """\
# Both ends on one machine: recordings are made, a key, and two receivers that talk over a socket.
soopnav synth pair examples/pair.toml pair
head -c 32 /dev/urandom | base64 > pair/key && chmod 600 pair/key
soopnav peer --role anchor --source pair/anchor.sigmf-meta --listen unix:pair/socket \\
  --key-file pair/key --orbits pair/satellites.csv --at 60.2,25.0,20 &
soopnav peer --role target --source pair/target.sigmf-meta --connect unix:pair/socket \\
  --key-file pair/key --orbits pair/satellites.csv --at 60.25,25.1,35 --height-sigma 10 --out pair/track
wait
"""
_CLOCKS = {"none": None, "ocxo": (8e-20, 4e-23), "tcxo": (2e-19, 2e-20)}
_OF_ONE_ROLE = {"anchor": ("bandwidth_bps", "bits"), "target": ("state",)}
_POSITIVE = Finite(min=0.0, min_open=True)


def _place(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[float, float, float] | None:
    """LAT,LON,H in degrees and metres."""
    del context
    if value is None:
        return None
    try:
        numbers = [float(part) for part in value.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and all(map(math.isfinite, numbers)) and abs(numbers[0]) <= 90.0 and abs(numbers[1]) <= 360.0:
        return numbers[0], numbers[1], numbers[2]
    raise click.BadParameter(f"{value}: LAT,LON,HEIGHT in degrees and metres expected", param=parameter)


@click.command(short_help="One of two receivers that find out together where the other one is.")
@click.option("--role", type=click.Choice(["anchor", "target"]), help="The anchor knows where it is.")
@click.option("--source", "what", metavar="REC", help="A recording, a FIFO, or - for samples on standard input.")
@click.option("--listen", metavar="ADDR", help="Wait for the peer at HOST:PORT, [IPv6]:PORT or unix:PATH.")
@click.option("--connect", metavar="ADDR", help="Connect to the peer.")
@click.option("--key-file", type=click.Path(path_type=Path), metavar="FILE", help="The shared key.")
@click.option("--orbits", "orbits_path", type=click.Path(path_type=Path), metavar="FILE", help="Where the beacons are.")
@click.option("--at", "at_deg", callback=_place, metavar="LAT,LON,H", help="The anchor; or about where the target is.")
@click.option("--within", "within_m", type=_POSITIVE, default=5e3, metavar="M", help="Sigma of that.  [default: 5000]")
@click.option(
    "--height-sigma", type=_POSITIVE, metavar="M", help="The target's height is known so well.  [default: not at all]"
)
@click.option(
    "--motion",
    type=click.Choice(["static", "nearly_constant_velocity"]),
    default="static",
    show_default=True,
    help="How the target moves.",
)
@click.option("--clock", type=click.Choice(list(_CLOCKS)), default="ocxo", show_default=True, help="Both oscillators.")
@click.option("--bandwidth", "bandwidth_bps", type=_POSITIVE, metavar="BIT/S", help="Of the anchor's snippets.")
@click.option("--bits", type=click.IntRange(0, 4), metavar="N", help="Of each component, in place of the best; 0: all.")
@click.option("--snippet-rate", "snippet_rate_hz", type=_POSITIVE, default=50e3, metavar="HZ", help="[default: 50e3]")
@click.option("--rate", "rate_hz", type=_POSITIVE, metavar="HZ", help="Sample rate of raw samples.")
@click.option("--format", "sample_format", metavar="FORMAT", help="Of raw samples: cu8, ci8, ci16, cf32.")
@click.option("--start", metavar="UTC", help="Time of the first sample, where the recording does not say it.")
@click.option("--frequency", "frequency_hz", type=_POSITIVE, metavar="HZ", help="What the receiver is tuned to.")
@click.option("--realtime", is_flag=True, help="Read a recording no faster than it was made.")
@click.option(
    "--state", type=click.Path(path_type=Path), metavar="FILE", help="Keep the target's track over a restart."
)
@click.option("--wait", "wait_s", type=_POSITIVE, default=60.0, metavar="S", help="For a peer.  [default: 60]")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="track.csv, track.png, metrics.json.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@click.option("--example", is_flag=True, help="Print how to run both ends on one machine, and do nothing.")
@sentences
def peer(**given: Any) -> None:
    """Find a receiver's place and clock together with another receiver, from bursts of satellites both hear.

    Both ends scan their samples for bursts. The anchor announces those whose satellite it can tell by channel and
    Doppler; the target asks for the ones it heard as well; the anchor hands them over in a few bits; the target
    measures delay and Doppler between its own samples and the anchor's, and tracks where it is and how far its clock is
    off the anchor's.

    The key is at least 16 bytes in a file, or in the environment variable SOOPNAV_PEER_KEY. Orbits: two-line elements
    (.tle, .txt), OMM (.xml, .json, .kvn), or an ephemeris file (.npz, .csv).

    \b
      soopnav peer --example
    """
    if given["example"]:
        click.echo(_EXAMPLE, nl=False)
        return
    for name in ("role", "what", "orbits_path", "at_deg"):
        if given[name] is None:
            option = {"what": "--source", "orbits_path": "--orbits", "at_deg": "--at"}.get(name, f"--{name}")
            raise ValueError(f"{option} is missing; soopnav peer --example shows how both ends are run")
    for role, names in _OF_ONE_ROLE.items():
        for name in names:
            if given["role"] != role and given[name] is not None:
                option = "--" + name.removesuffix("_bps")
                raise ValueError(f"{option}: of the {role} alone; this end is --role {given['role']}")
    if (given["listen"] is None) == (given["connect"] is None):
        raise ValueError("one of --listen and --connect expected")
    _run(**given)


def _run(**o: Any) -> None:
    from soopnav_cpp.clock import TwoState
    from soopnav_cpp.geometry import SampledOrbit, geodetic_to_ecef
    from soopnav_cpp.peer import report
    from soopnav_cpp.peer.beacons import read_beacons
    from soopnav_cpp.peer.frames import read_key
    from soopnav_cpp.peer.roles import Anchor, ExchangeOptions, Target
    from soopnav_cpp.peer.session import Session, SessionOptions, parse_address
    from soopnav_cpp.peer.sources import open_source
    from soopnav_cpp.peer.track import Track

    key = read_key(o["key_file"])
    address = parse_address(o["listen"] or o["connect"])
    source = open_source(
        o["what"],
        sample_rate_hz=o["rate_hz"],
        format=o["sample_format"],
        start=o["start"],
        center_frequency_hz=o["frequency_hz"],
        stdin=sys.stdin.buffer if o["what"] == "-" else None,
        realtime=o["realtime"],
    )
    reference = source.reference_unix_s
    beacons = read_beacons(o["orbits_path"], reference + source.start_s, reference + source.end_s)
    latitude_deg, longitude_deg, height_m = o["at_deg"]
    place_e = geodetic_to_ecef(math.radians(latitude_deg), math.radians(longitude_deg), height_m)
    options = ExchangeOptions(snippet_rate_hz=o["snippet_rate_hz"])
    end: Anchor | Target
    if o["role"] == "anchor":
        end = Anchor(
            source,
            beacons,
            SampledOrbit.fixed(place_e),
            bandwidth_bps=o["bandwidth_bps"] or math.inf,
            bits=o["bits"],
            options=options,
        )
    else:
        numbers = _CLOCKS[o["clock"]]
        clock = None if numbers is None else TwoState(*numbers)
        track = Track(
            beacons,
            place_e,
            within_m=o["within_m"],
            height_m=height_m,
            height_sigma_m=o["height_sigma"] or math.inf,
            state=o["state"],
            motion=o["motion"],
            target_clock=clock,
            anchor_clock=clock,
        )
        end = Target(source, beacons, track, options=options)
    if o["out"] is not None:  # found now, not after the run
        o["out"].mkdir(parents=True, exist_ok=True)
        if not os.access(o["out"], os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(o["out"]))
    quiet = o["as_json"]
    session = Session(
        end,
        key,
        address,
        listen=o["listen"] is not None,
        options=SessionOptions(wait_s=o["wait_s"]),
        on_listening=lambda where: None if quiet else click.echo(f"listening at {where}", err=True),
    )
    try:
        asyncio.run(_with_status(session, end, quiet or not sys.stderr.isatty()))
    except KeyboardInterrupt:
        click.echo("", err=True)
    else:
        if session.traffic.sessions == 0:
            refused = ", ".join(f"{name}: {n}" for name, n in sorted(session.traffic.refused.items()))
            raise ValueError(f"no peer at {address} within {o['wait_s']:g} s{refused and f' ({refused})'}")
    if isinstance(end, Target):
        end.track.write()
    result = report.write(end, session.traffic, o["out"]) if o["out"] else report.summary(end, session.traffic)
    if quiet:
        click.echo(json.dumps(result, indent=2, allow_nan=False))
    else:
        print_result(result)
        if o["out"]:
            click.echo(f"written: {o['out']}")


async def _with_status(session: Any, end: Any, silent: bool) -> None:
    """Run a session, and say once a second on one line how it goes."""
    task = asyncio.create_task(session.run())
    began = time.monotonic()
    try:
        while not task.done():
            await asyncio.wait([task], timeout=1.0)
            if not silent:
                click.echo(f"\r\x1b[K{_status(session, end, time.monotonic() - began)}", nl=False, err=True)
        await task
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        if not silent:
            click.echo("\r\x1b[K", nl=False, err=True)


def _status(session: Any, end: Any, elapsed_s: float) -> str:
    counts = end.counts
    heard_s = end.heard_to_s - end.source.start_s
    line = f"{elapsed_s:4.0f} s  {session.state:9}  heard {heard_s:.1f} s  {counts['scanned']} bursts"
    if end.role == "anchor":
        return f"{line}, {counts['announced']} announced, {counts['exchanged']} handed over"
    line += f", {counts['exchanged']} exchanged, {counts['used']} used"
    tracker = end.track.tracker
    if end.track.running:
        line += f"  ± {math.sqrt(max(0.0, float(tracker.covariance[:3, :3].trace()))):.0f} m"
    return line


def print_result(result: dict[str, Any]) -> None:
    """The table, and a target's estimate."""
    from rich.table import Table
    from rich.text import Text

    console = stdout()
    # Text: what a peer or a file is called is no markup.
    console.print(Text(f"{result['role']}: {result['source']}"), soft_wrap=True)
    table = Table()
    table.add_column("what")
    table.add_column("number", justify="right")
    for name, number in result["counts"].items():
        table.add_row(Text(name), str(number))
    for name, number in result["reasons"].items():
        table.add_row(Text(f"  {name}"), str(number))
    for name, number in result["refused"].items():
        table.add_row(Text(f"  refused: {name}"), str(number))
    for name in ("sessions", "sessions_lost", "sent_bytes", "received_bytes", "samples_not_finite"):
        if result[name] or name == "sessions":
            table.add_row(name.replace("_", " "), str(result[name]))
    console.print(table)
    if result["role"] != "target":
        return
    found = result["estimate"]
    if found is None:
        click.echo("no estimate: too few bursts were used")
        return
    click.echo(
        f"{found['utc']}  {found['latitude_deg']:.6f} {found['longitude_deg']:.6f}  height {found['height_m']:.1f} m  "
        f"± {found['sigma_east_m']:.1f} m east, {found['sigma_north_m']:.1f} m north, {found['sigma_up_m']:.1f} m up"
    )
    click.echo(
        f"clock against the anchor's: {1e6 * found['clock_offset_s']:+.3f} µs ± "
        f"{1e9 * found['sigma_clock_offset_s']:.0f} ns, {1e9 * found['clock_skew']:+.2f} ppb ± "
        f"{1e9 * found['sigma_clock_skew']:.2f} ppb"
    )
