"""Connections to the signal database, and its schema brought up to date.

SQLite in a file, in write-ahead mode and with every commit on the disk before it is acknowledged; PostgreSQL by URL.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import alembic.command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError

from soopnav_cpp._extras import require

__all__ = ["DatabaseUnavailableError", "downgrade", "head", "lock_for_writing", "migrate", "open_engine", "revision"]

_LOCK = 0x50534442  # of PostgreSQL's advisory locks: writers of one database go one after the other
_WAIT_S = 10.0


class DatabaseUnavailableError(RuntimeError):
    """The database does not answer, or is at a revision that this program cannot use."""


def _parsed(url: str) -> URL:
    if "://" not in url:
        url = f"sqlite:///{url}"
    try:
        parsed = make_url(url)
    except ArgumentError:
        raise ValueError("url is not a database's; sqlite:///FILE or postgresql://USER@HOST/NAME expected") from None
    backend = parsed.get_backend_name()
    if backend == "sqlite":
        if not parsed.database or parsed.database == ":memory:" or parsed.query:
            raise ValueError(f"url is {url}; SQLite needs a file, sqlite:///FILE, and no options")
        return parsed.set(drivername="sqlite+pysqlite")
    if backend == "postgresql":
        return parsed.set(drivername="postgresql+psycopg")
    raise ValueError(f"url is of {backend}; sqlite or postgresql expected")


def _prepare_sqlite(connection: Any, record: Any) -> None:
    del record
    connection.isolation_level = None  # transactions begin where `_begin` says
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.execute(f"PRAGMA busy_timeout = {int(_WAIT_S * 1000)}")
    cursor.close()


def _begin(connection: Connection) -> None:
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def open_engine(url: str) -> Engine:
    """An engine for a file of SQLite or a database of PostgreSQL.

    Parameters
    ----------
    url : str
        ``sqlite:///FILE``, a path alone, or ``postgresql://USER:PASSWORD@HOST/NAME``.

    Raises
    ------
    ValueError
        For the URL of something else.
    MissingExtraError
        Without the driver of PostgreSQL.
    """
    parsed = _parsed(url)
    if parsed.get_backend_name() == "sqlite":
        engine = create_engine(parsed)
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin)
        return engine
    require("psycopg", "postgresql", "a signal database on PostgreSQL")
    return create_engine(
        parsed,
        pool_pre_ping=True,
        pool_size=8,
        connect_args={"connect_timeout": int(_WAIT_S), "options": "-c timezone=UTC"},
    )


def lock_for_writing(connection: Connection) -> None:
    """Wait for other writers, of this process and of others; until the end of the transaction."""
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")


def _configuration(connection: Connection | None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


@functools.cache
def head() -> str:
    """The newest revision of the schema, which this program works with."""
    found = ScriptDirectory.from_config(_configuration(None)).get_current_head()
    assert found is not None
    return found


def revision(engine: Engine) -> str | None:
    """The revision that a database is at; None for an empty one.

    Raises
    ------
    DatabaseUnavailableError
        When it does not answer.
    """
    try:
        with engine.connect() as connection:
            return MigrationContext.configure(connection).get_current_revision()
    except DBAPIError as error:
        raise DatabaseUnavailableError(f"{_shown(engine)} does not answer: {_first_line(error)}") from error


def migrate(engine: Engine) -> None:
    """Bring the schema to `head`, in one transaction; two at once wait for each other.

    Raises
    ------
    DatabaseUnavailableError
        When it does not answer, or is at a revision of a newer program.
    """
    found = revision(engine)
    if found == head():
        return
    known = {script.revision for script in ScriptDirectory.from_config(_configuration(None)).walk_revisions()}
    if found is not None and found not in known:
        raise DatabaseUnavailableError(f"{_shown(engine)} is at revision {found}, which a newer soopnav made")
    _run(engine, "upgrade", "head")


def downgrade(engine: Engine, target: str) -> None:
    """Take the schema back to a revision, ``"base"`` for none; what only newer ones hold is lost."""
    _run(engine, "downgrade", target)


def _run(engine: Engine, direction: str, target: str) -> None:
    try:
        with engine.execution_options(writes=True).begin() as connection:
            lock_for_writing(connection)
            getattr(alembic.command, direction)(_configuration(connection), target)
    except DBAPIError as error:
        raise DatabaseUnavailableError(f"{_shown(engine)} cannot be migrated: {_first_line(error)}") from error


def _shown(engine: Engine) -> str:
    return f"the database {engine.url.render_as_string(hide_password=True)}"


def _first_line(error: DBAPIError) -> str:
    return str(error.orig).strip().splitlines()[0] if str(error.orig).strip() else type(error.orig).__name__
