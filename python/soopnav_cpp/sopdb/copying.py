"""A signal database copied into another: from SQLite to PostgreSQL, or back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Connection, Engine, Table, func, insert, inspect, select, text
from sqlalchemy.exc import DBAPIError

from soopnav_cpp.sopdb import database
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.schema import Base

__all__ = ["copy"]

_ROWS = 500


def copy(source: str, target: str, *, progress: Callable[[str, int], None] | None = None) -> dict[str, int]:
    """Copy everything of one database into another that is empty: sources, contributions, tokens, audit trail.

    Read in one transaction, so it is the state of one moment although the service may be running; written in one, so
    after a failure the target is empty as before. Ids, times and hashes stay what they are: tokens go on being valid,
    retries go on being recognised. What is contributed to the source afterwards is not in the target.

    Parameters
    ----------
    source, target : str
        ``sqlite:///FILE`` or ``postgresql://USER@HOST/NAME``.
    progress : callable, optional
        Called with the name of a table and how many of its rows have been copied, after each 500.

    Returns
    -------
    dict of str to int
        Rows by table.

    Raises
    ------
    ValueError
        When the target holds anything, or both are the same; when the source is at another revision of the schema.
    DatabaseUnavailableError
        When one of them does not answer, or does not take the rows.
    """
    old, new = database.open_engine(source), database.open_engine(target)
    try:
        if old.url == new.url:
            raise ValueError(f"target is {_shown(new)}, the source itself; another database expected")
        found = None if _missing(old) else database.revision(old)
        if found != database.head():
            raise ValueError(
                f"source {_shown(old)} is at revision {found or 'none'} of the schema, {database.head()} expected: "
                "serve it once with this program, which brings it up to date"
            )
        _refuse_used(new)
        database.migrate(new)
        try:
            return _copy(old, new, progress)
        except DBAPIError as error:
            raise DatabaseUnavailableError(f"{_shown(new)} did not take the copy: {str(error.orig).strip()}") from error
    finally:
        old.dispose()
        new.dispose()


def _copy(old: Engine, new: Engine, progress: Callable[[str, int], None] | None) -> dict[str, int]:
    options = {} if old.dialect.name == "sqlite" else {"isolation_level": "REPEATABLE READ"}
    counts: dict[str, int] = {}
    with (
        old.connect().execution_options(**options) as reading,
        new.execution_options(writes=True).begin() as writing,
    ):
        database.lock_for_writing(writing)
        for table in Base.metadata.sorted_tables:
            # A migration leaves rows of its own (the version); the source's take their place.
            if table.name == "meta":
                writing.execute(table.delete())
            elif _rows(writing, table):
                raise ValueError(f"target {_shown(new)} has been written to meanwhile; an empty database expected")
            counts[table.name] = _copy_table(reading, writing, table, progress)
            _continue_ids(writing, table)
    return counts


def _copy_table(
    reading: Connection, writing: Connection, table: Table, progress: Callable[[str, int], None] | None
) -> int:
    count = 0
    rows = reading.execution_options(yield_per=_ROWS).execute(select(table).order_by(*table.primary_key.columns))
    for batch in rows.mappings().partitions():
        writing.execute(insert(table), [dict(row) for row in batch])
        count += len(batch)
        if progress is not None:
            progress(table.name, count)
    return count


def _continue_ids(writing: Connection, table: Table) -> None:
    """PostgreSQL counts ids apart from the rows: the next one must come after those that were copied."""
    column = table.autoincrement_column
    if writing.dialect.name != "postgresql" or column is None:
        return
    named = {"table": table.name, "column": column.name}
    sequence = writing.execute(text("SELECT pg_get_serial_sequence(:table, :column)"), named).scalar_one()
    if sequence is not None:
        last = writing.execute(select(func.max(column))).scalar_one()
        setting = {"sequence": sequence, "last": last or 1, "called": last is not None}
        writing.execute(text("SELECT setval(:sequence, :last, :called)"), setting)


def _missing(engine: Engine) -> bool:
    """Whether a file is not there: opening it would make it."""
    path = engine.url.database
    if engine.dialect.name != "sqlite" or path is None:
        return False
    return not Path(path).is_file()


def _refuse_used(engine: Engine) -> None:
    if _missing(engine) or database.revision(engine) is None:
        return
    with engine.connect() as connection:
        there = set(inspect(connection).get_table_names())
        for table in Base.metadata.sorted_tables:
            if table.name != "meta" and table.name in there and _rows(connection, table):
                raise ValueError(
                    f"target {_shown(engine)} is in use: it holds {table.name}; an empty database expected"
                )


def _rows(connection: Connection, table: Table) -> int:
    return int(connection.execute(select(func.count()).select_from(table)).scalar_one())


def _shown(engine: Engine) -> str:
    return engine.url.set(drivername=engine.url.get_backend_name()).render_as_string(hide_password=True)
