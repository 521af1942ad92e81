"""``soopnav sopdb``: the shared database of signals, both ends."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, ParamSpec

import click
from rich.table import Table

from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.text import MINUS

__all__ = ["sopdb"]

_P = ParamSpec("_P")
_KINDS = ("cdma", "gps", "iridium", "lte", "ofdm", "fm", "other")
_SERVER = "http://127.0.0.1:8765"
_SNAPSHOT = "signals.sopcat"


def _server_options(command: Callable[_P, None]) -> Callable[_P, None]:
    options = (
        click.option(
            "--server", envvar="SOOPNAV_SOPDB_URL", default=_SERVER, metavar="URL", help=f"[default: {_SERVER}]"
        ),
        click.option(
            "--token",
            envvar="SOOPNAV_SOPDB_TOKEN",
            metavar="TOKEN",
            help="Better in the environment variable SOOPNAV_SOPDB_TOKEN: options can be seen by others.",
        ),
        click.option("--insecure", is_flag=True, help="Send the token over plain HTTP to another machine."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def _database_option(command: Callable[_P, None]) -> Callable[_P, None]:
    return click.option(
        "--db",
        envvar="SOOPNAV_SOPDB_DB",
        default="sqlite:///sopdb.sqlite3",
        metavar="URL",
        help="sqlite:///FILE or postgresql://USER@HOST/NAME.  [default: sqlite:///sopdb.sqlite3]",
    )(command)


def _degrees(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[float, float] | None:
    """``60.2,25.0``."""
    del context, parameter
    if value is None:
        return None
    try:
        latitude, longitude = (float(part) for part in value.split(","))
    except ValueError:
        latitude = longitude = math.nan
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
        raise click.BadParameter(f"{value}: LAT,LON in degrees expected, such as 60.2,25.0")
    return latitude, longitude


def _mode(context: click.Context, parameter: click.Parameter, value: str) -> int:
    """``660``."""
    del context, parameter
    if not (1 <= len(value) <= 4 and set(value) <= set("01234567") and int(value, 8) <= 0o777):
        raise click.BadParameter(f"{value}: an octal mode expected, such as 660")
    return int(value, 8)


def _open(db: str, *, there: bool = False) -> Any:
    """The database; with `there` one that is there already: a mistyped name must not make an empty one."""
    from soopnav_cpp._extras import require

    require("sqlalchemy", "sopdb", "the signal database")
    require("alembic", "sopdb", "the signal database")
    from soopnav_cpp.sopdb.database import DatabaseUnavailableError
    from soopnav_cpp.sopdb.store import Store

    if there and (db.startswith("sqlite:///") or "://" not in db):
        file = Path(db.removeprefix("sqlite:///"))
        if not file.exists():
            raise ValueError(f"{file}: no such database")
    try:
        return Store(db)
    except DatabaseUnavailableError as error:
        raise ValueError(str(error)) from error


def _client(server: str, token: str | None, insecure: bool, snapshot: Path | None = None, **options: Any) -> Any:
    from soopnav_cpp.sopdb.client import Client

    return Client(server, token=token, insecure=insecure, snapshot=snapshot, **options)


@click.group(short_help="The shared database of signals.")
def sopdb() -> None:
    """Keep, ask and feed a database of signals of opportunity: where each stands and how its clock runs.

    \b
      soopnav sopdb token create ALICE --role contribute      on the server: prints the token, once
      soopnav sopdb serve                                     on the server
      soopnav sopdb push tower.json                           with SOOPNAV_SOPDB_TOKEN set
      soopnav sopdb pull                                      signals.sopcat, to work from without a network
      soopnav sopdb show
    """


@sopdb.command(short_help="Answer requests, and show the web page.")
@_database_option
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option("--port", type=click.IntRange(0, 65535), default=8765, show_default=True, help="0: any that is free.")
@click.option("--unix", type=click.Path(path_type=Path), metavar="PATH", help="A Unix socket in place of both.")
@click.option(
    "--unix-mode",
    callback=_mode,
    default="660",
    show_default=True,
    metavar="OCTAL",
    help="Who may connect to it: by default its owner and its group.",
)
@click.option("--public-read", is_flag=True, help="Anybody may read; writing needs a token all the same.")
@click.option("--https", is_flag=True, help="A proxy in front speaks HTTPS: browsers are told to insist on it.")
@click.option("--proxies", metavar="ADDRESSES", help="Of proxies that are believed who asks, with commas between.")
@sentences
def serve(
    db: str,
    host: str,
    port: int,
    unix: Path | None,
    unix_mode: int,
    public_read: bool,
    https: bool,
    proxies: str | None,
) -> None:
    """Answer requests until interrupted.

    The database is made, or brought up to date, when it is opened. The web page is at the same address. Over a network
    a proxy that speaks HTTPS belongs in front, for tokens must not be read on the way.
    """
    from soopnav_cpp._extras import require

    require("uvicorn", "sopdb", "the signal database's service")
    require("fastapi", "sopdb", "the signal database's service")
    require("sqlalchemy", "sopdb", "the signal database's service")
    from soopnav_cpp.sopdb import server
    from soopnav_cpp.sopdb.settings import ServiceSettings

    with _open(db) as store:
        if not any(token["revoked_us"] is None for token in store.tokens()):
            click.echo("no tokens yet: nobody can write; soopnav sopdb token create NAME --role contribute", err=True)
        if not https and unix is None and host not in ("127.0.0.1", "::1", "localhost"):
            click.echo("without HTTPS anybody on the way can read tokens: put a proxy in front", err=True)
        server.serve(
            store,
            ServiceSettings(public_read=public_read, https=https),
            at=server.listen(host, port, unix=unix, unix_mode=unix_mode),
            proxies=proxies,
            log_level="warning",
            ready=lambda url: click.echo(f"answering at {url}", err=True),
        )


@sopdb.command(short_help="Download everything, to work without a network.")
@click.argument("out", type=click.Path(path_type=Path), default=Path(_SNAPSHOT))
@_server_options
@sentences
def pull(out: Path, server: str, token: str | None, insecure: bool) -> None:
    """Download every source into OUT (signals.sopcat), to work from without a network.

    Nothing is downloaded when nothing has changed. C++ reads the file as well: navigation::SopCatalog.
    """
    with _client(server, token, insecure) as client:
        catalog, changed = client.pull(out)
    when = catalog.created.isoformat(sep=" ", timespec="seconds").replace("+00:00", " UTC")
    click.echo(f"{out}: {_many(len(catalog), 'source')} of {when}{'' if changed else ', as it was'}")


def _bodies(path: Path) -> list[Any]:
    """The characterisations of a file, checked; sentences that name the file."""
    import pydantic

    from soopnav_cpp.sopdb.records import Characterization

    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: text of UTF-8 expected") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}:{error.lineno}: JSON expected: {error.msg}") from None
    except RecursionError:
        raise ValueError(f"{path}: JSON expected that is not nested so deep") from None
    bodies = value if isinstance(value, list) else [value]
    if not bodies:
        raise ValueError(f"{path}: at least one characterisation expected")
    out = []
    for index, body in enumerate(bodies):
        where = f"{path}[{index}]" if isinstance(value, list) else str(path)
        try:
            out.append(Characterization.model_validate(body))
        except pydantic.ValidationError as error:
            lines = [f"{where}: {_rule(detail)}" for detail in error.errors()]
            raise ValueError("\n".join(lines)) from None
    return out


def _rule(detail: Any) -> str:
    name = ".".join(str(part) for part in detail["loc"])
    message = detail["msg"].removeprefix("Value error, ")
    return f"{name}: {message}" if name else message


@sopdb.command(short_help="Contribute characterisations.")
@click.argument("files", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="FILE...")
@click.option("--check", is_flag=True, help="Check the files and send nothing.")
@_server_options
@sentences
def push(files: tuple[Path, ...], check: bool, server: str, token: str | None, insecure: bool) -> None:
    """Contribute the characterisations of each FILE (JSON: one, or a list).

    All are checked before the first is sent. Sent again, the same one makes no second record. Exit code 1 when one was
    put in quarantine: it is kept, and not used until others agree or an administrator releases it.
    """
    every = [(path, body) for path in files for body in _bodies(path)]
    if check:
        click.echo(f"{_many(len(every), 'characterisation')}: nothing wrong")
        return
    held = 0
    with _client(server, token, insecure) as client:
        for path, body in every:
            receipt = client.push(body)
            said = f"{path}: {body.source.kind} {body.source.name}: {receipt.status}"
            click.echo(f"{said} as contribution {receipt.id} to source {receipt.source_id}")
            for reason in receipt.reasons:
                click.echo(f"  {reason}")
            held += receipt.status != "accepted"
    if held:
        raise click.exceptions.Exit(1)


@sopdb.command(short_help="What is known of the sources, or of one.")
@click.argument("source_id", metavar="[ID]", required=False)
@click.option("--at", metavar="UTC", help="Bring clocks to this time, such as 2026-03-01T12:00:00Z.  [default: now]")
@click.option("--kind", type=click.Choice(_KINDS), help="Sources of this kind.")
@click.option("--near", callback=_degrees, metavar="LAT,LON", help="Sources about a place.")
@click.option("--radius", "radius_m", type=float, default=20e3, metavar="M", help="Of --near.  [default: 20e3]")
@click.option(
    "--snapshot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=f"Ask this file and no server. Without it {_SNAPSHOT}, where it exists, answers for a server that does not.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
@_server_options
@sentences
def show(
    source_id: str | None,
    at: str | None,
    kind: str | None,
    near: tuple[float, float] | None,
    radius_m: float,
    snapshot: Path | None,
    as_json: bool,
    server: str,
    token: str | None,
    insecure: bool,
) -> None:
    """List what is known of the sources, or say everything about the one with ID."""
    from soopnav_cpp.sopdb.records import utc
    from soopnav_cpp.sopdb.snapshot import read

    if not (radius_m > 0.0 and math.isfinite(radius_m)):
        raise ValueError(f"--radius {radius_m:g}: a positive number expected")
    try:
        when = datetime.now(timezone.utc) if at is None else utc(at)
    except ValueError as error:
        raise ValueError(f"--at {at}: {error}") from None
    catalog = None if snapshot is None else read(snapshot)
    asked = None if at is None else when
    within_m = None if near is None else radius_m
    if catalog is not None:
        if source_id is not None and source_id not in catalog:
            raise ValueError(f"{snapshot} has no source {source_id}")
        if source_id is not None:
            found = [catalog.source(source_id, when)]
        else:
            found = catalog.sources(when, kind=kind, near=near, radius_m=within_m)
    else:
        fallback = Path(_SNAPSHOT)
        with _client(server, token, insecure, fallback if fallback.exists() else None, retries=1) as client:
            if source_id is not None:
                found = [client.source(source_id, at=asked)]
            else:
                found = list(client.sources(at=asked, kind=kind, near=near, radius_m=within_m))
            catalog = client.offline
        if catalog is not None:
            click.echo(f"{server} does not answer; this is {fallback}, {_ago(when - catalog.created)} old", err=True)
            found = [catalog.source(source["id"], when) for source in found]  # clocks brought to now
    if as_json:
        click.echo(json.dumps(found[0] if source_id else found, indent=2, ensure_ascii=False, allow_nan=False))
    elif source_id is not None:
        _print_source(found[0])
    else:
        _print_table(found)


@sopdb.group(short_help="Who may read, contribute and administer.")
def token() -> None:
    """Who may read, contribute and administer. Works on the database itself, where it is."""


@token.command("create", short_help="Make a token and print it.")
@click.argument("name")
@click.option(
    "--role", type=click.Choice(["read", "contribute", "admin"]), required=True, help="Each may what those before may."
)
@click.option("--days", type=click.FloatRange(min=0.0, min_open=True), metavar="N", help="Until when.  [default: ever]")
@_database_option
@sentences
def token_create(name: str, role: str, days: float | None, db: str) -> None:
    """Make a token for NAME and print it, alone on a line. It is not kept and cannot be shown again."""
    if days is not None and not days <= 36500.0:
        raise ValueError(f"--days {days:g}: at most 36500 expected")
    end = None if days is None else datetime.now(timezone.utc) + timedelta(days=days)
    with _open(db) as store:
        made = store.create_token(name, role, expires_us=None if end is None else int(end.timestamp() * 1e6))
    until = "" if end is None else f", until {end:%Y-%m-%d %H:%M} UTC"
    click.echo(f"for {name}, role {role}, id {made.id}{until}", err=True)
    click.echo(made.text)


@token.command("list", short_help="List the tokens, without their secrets.")
@_database_option
@sentences
def token_list(db: str) -> None:
    """List the tokens, without their secrets."""
    with _open(db, there=True) as store:
        rows = store.tokens()
    table = Table(box=None, pad_edge=False)
    for column in ("id", "name", "role", "made", "until", ""):
        table.add_column(column, no_wrap=True)
    for row in rows:
        table.add_row(row["id"], row["name"], row["role"], _day(row["created_us"]), _day(row["expires_us"]), _end(row))
    stdout().print(table if rows else "no tokens", markup=False)


@token.command("revoke", short_help="End a token at once.")
@click.argument("token_id", metavar="ID")
@_database_option
@sentences
def token_revoke(token_id: str, db: str) -> None:
    """End the token with ID at once."""
    with _open(db, there=True) as store:
        if not store.revoke_token(token_id):
            raise ValueError(f"no token {token_id} that has not ended; soopnav sopdb token list names them")
    click.echo(f"{token_id}: ended")


@sopdb.command(short_help="Copy the database while it is in use.")
@click.argument("out", type=click.Path(path_type=Path))
@_database_option
@sentences
def backup(out: Path, db: str) -> None:
    """Copy the whole database into the new file OUT while it is in use (SQLite; for PostgreSQL there is pg_dump)."""
    with _open(db, there=True) as store:
        store.backup(out)
    click.echo(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


@sopdb.command("copy")
@click.option("--from", "source", required=True, metavar="URL", help="The database that there is.")
@click.option("--to", "target", required=True, metavar="URL", help="An empty one, or a file that is not there yet.")
@sentences
def copy_database(source: str, target: str) -> None:
    """Copy a whole database into an empty one: from SQLite to PostgreSQL, or back.

    \b
      soopnav sopdb copy --from sqlite:///sopdb.sqlite3 --to postgresql://sopdb@db.example/signals

    Ids, tokens and the audit trail stay what they are. The service may run meanwhile, but what it takes in after the
    start of the copy is not in it: stop it first when moving.
    """
    from soopnav_cpp._extras import require

    require("sqlalchemy", "sopdb", "the signal database")
    require("alembic", "sopdb", "the signal database")
    from soopnav_cpp.sopdb.copying import copy
    from soopnav_cpp.sopdb.database import DatabaseUnavailableError

    try:
        counts = copy(source, target)
    except DatabaseUnavailableError as error:
        raise ValueError(str(error)) from error
    for name in ("sources", "contributions", "tokens", "audit"):
        click.echo(f"{name:<13}  {counts[name]}")


def _shown(text: str) -> str:
    """Text of another's for a terminal: what would steer it is written out."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _day(us: int | None) -> str:
    return "" if us is None else f"{datetime.fromtimestamp(us / 1e6, tz=timezone.utc):%Y-%m-%d %H:%M}"


def _end(row: Any) -> str:
    if row["revoked_us"] is not None:
        return f"ended {_day(row['revoked_us'])}"
    expires = row["expires_us"]
    return "expired" if expires is not None and expires <= datetime.now(timezone.utc).timestamp() * 1e6 else ""


def _ago(age: timedelta) -> str:
    seconds = max(0.0, age.total_seconds())
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.0f} s"


def _scaled(value: float, unit: str = "s") -> str:
    """``−3.2 ns``: three digits with a prefix."""
    if value == 0.0:
        return f"0 {unit}"
    prefixes = {0: "", -3: "m", -6: "µ", -9: "n", -12: "p", -15: "f"}
    power = min(0, max(-15, 3 * math.floor(math.log10(abs(value) * (1 + 1e-9)) / 3)))
    return f"{value / 10.0**power:.3g} {prefixes[power]}{unit}".replace("-", MINUS)


def _power(value: float) -> str:
    return f"{value:.2g}".replace("e-0", "e-").replace("-", MINUS)


def _clock_text(clock: Any) -> tuple[str, str]:
    if clock is None:
        return "", ""
    bias = f"{_scaled(clock['bias_s'])} ± {_scaled(math.sqrt(clock['covariance'][0][0]))}"
    return bias, f"{_power(clock['drift'])} ± {_power(math.sqrt(clock['covariance'][1][1]))}"


def _place_text(position: Any) -> str:
    if position is None:
        return ""
    place = f"{position['latitude_deg']:.5f}, {position['longitude_deg']:.5f}".replace("-", MINUS)
    return f"{place} ± {position['sigma_m']:.3g} m"


def _print_table(sources: Sequence[Any]) -> None:
    if not sources:
        click.echo("no sources")
        return
    table = Table(box=None, pad_edge=False)
    for column, justify in (
        ("id", "left"), ("kind", "left"), ("name", "left"), ("MHz", "right"), ("place", "left"),
        ("clock ahead", "right"), ("from", "right"), ("age", "right"), ("grade", "center"),
    ):  # fmt: skip
        named = column == "name"
        table.add_column(column, justify=justify, no_wrap=not named, min_width=12 if named else None)  # type: ignore[arg-type]
    for source in sources:
        quality = source["quality"]
        age = "" if quality["age_s"] is None else _ago(timedelta(seconds=quality["age_s"]))
        table.add_row(
            source["id"],
            source["kind"],
            _shown(source["name"]),
            f"{source['carrier_hz'] / 1e6:.3f}",
            _place_text(source["position"]),
            _clock_text(source["clock"])[0],
            str(quality["contributions"]),
            age,
            quality["grade"],
        )
    stdout().print(table, markup=False)


def _print_source(source: Any) -> None:
    position, clock, noise, quality = (source[name] for name in ("position", "clock", "noise", "quality"))
    rows = [
        ("source", f"{source['id']}: {source['kind']} {_shown(source['name'])}, {source['carrier_hz'] / 1e6:.6f} MHz"),
        ("place", f"{_place_text(position)}, height {position['height_m']:.1f} m" if position else "not known"),
    ]
    if clock is None:
        rows.append(("clock", "not known"))
    else:
        bias, drift = _clock_text(clock)
        rows += [("clock ahead", f"{bias} at {clock['epoch']}"), ("drift", drift)]
    if noise is None:
        rows.append(("noise", "not known; a TCXO's is supposed" if clock else "not known"))
    else:
        for k, (name, value, unit) in enumerate((("h0", noise["h0_s"], "s"), ("h-2", noise["h_minus2_per_s"], "Hz"))):
            factor = math.exp(math.sqrt(noise["ln_covariance"][k][k]))
            rows.append((name.replace("-", MINUS), f"{_power(value)} {unit}, within a factor {factor:.3g}"))
        from soopnav_cpp.clock import TwoState

        deviations = TwoState(noise["h0_s"], noise["h_minus2_per_s"]).allan_deviation([1.0, 100.0])
        rows.append(("Allan deviation", f"{_power(deviations[0])} at 1 s, {_power(deviations[1])} at 100 s"))
    age = "" if quality["age_s"] is None else f", the newest {_ago(timedelta(seconds=quality['age_s']))} old"
    rows.append(("from", f"{_many(quality['contributions'], 'contribution')}{age}; grade {quality['grade']}"))
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        click.echo(f"{name:<{width}}  {text}")
