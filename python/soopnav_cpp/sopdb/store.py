"""What the service keeps: sources, contributions, tokens, audit trail; in SQLite or PostgreSQL.

A write is done by one thread (`writer.Writer`) and its future is set when it is committed and on the disk. Reads have
connections of their own and wait for no writer.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import Executable, delete, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from soopnav_cpp.sopdb import contributing, spatial
from soopnav_cpp.sopdb import database as _database
from soopnav_cpp.sopdb.auth import ROLES, Grant, NewToken, new_token
from soopnav_cpp.sopdb.contributing import Contributor, Entries, Outcome
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.fusion import Entry
from soopnav_cpp.sopdb.matching import name_key
from soopnav_cpp.sopdb.records import Characterization
from soopnav_cpp.sopdb.schema import (
    Alias,
    Audit,
    Contribution,
    Fused,
    Idempotency,
    Meta,
    Source,
    Token,
    Verdict,
    now_us,
)
from soopnav_cpp.sopdb.spatial import Box
from soopnav_cpp.sopdb.writer import Writer

__all__ = ["OPERATOR", "FusedRow", "Search", "Store", "body_hash"]

#: Who works on the database itself, without a token.
OPERATOR = Contributor("<operator>")
_MOST_ID = 2**63 - 1
_PRUNE_S = 3600.0  # between looks for answers kept long enough
_T = TypeVar("_T")


class FusedRow(NamedTuple):
    """A source as it is answered."""

    id: int
    kind: str
    name: str
    carrier_hz: float
    version: int
    state: str


class Search(NamedTuple):
    """Which sources are asked for.

    Attributes
    ----------
    kind : str or None
    near_deg : (float, float) or None
        Latitude and longitude; with `radius_m`, and the nearest first.
    radius_m : float
        Straight-line distance between the places on the ellipsoid.
    box : Box or None
    name : str or None
        Part of a name that the source goes by, whatever its case.
    """

    kind: str | None = None
    near_deg: tuple[float, float] | None = None
    radius_m: float = 0.0
    box: Box | None = None
    name: str | None = None


def body_hash(body: Characterization) -> bytes:
    """SHA-256 of a characterisation in canonical JSON: the same whatever the order of its keys or blanks."""
    text = json.dumps(body.to_json(), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).digest()


class Store:
    """An open signal database.

    Parameters
    ----------
    url : str
        ``sqlite:///FILE``, a path alone, or ``postgresql://USER@HOST/NAME``.
    migrate : bool
        Bring the schema up to date first. Otherwise a database at another revision is refused.
    idempotency_s : float
        How long answers are kept for retries (`keep_keys`).

    Raises
    ------
    ValueError
        For a URL of something else.
    DatabaseUnavailableError
        When it does not answer, or its schema is not this program's.
    """

    def __init__(self, url: str, *, migrate: bool = True, idempotency_s: float = 7.0 * 86400.0) -> None:
        self.engine = _database.open_engine(url)
        try:
            if migrate:
                _database.migrate(self.engine)
            found = _database.revision(self.engine)
            if found != _database.head():
                raise DatabaseUnavailableError(
                    f"the database is at revision {found or 'none'} of its schema, this program works with "
                    f"{_database.head()}: migrate it first"
                )
        except BaseException:
            self.engine.dispose()
            raise
        self.sqlite = self.engine.dialect.name == "sqlite"
        self._entries = Entries()  # of the writer's thread
        self._read_entries = Entries()
        self._reading = threading.Lock()
        self._writer = Writer(self.engine, undone=self._entries.clear)
        self._watch: sqlite3.Connection | None = None
        if self.sqlite:
            self._watch = sqlite3.connect(str(self.engine.url.database), isolation_level=None, check_same_thread=False)
        self._kept_s = idempotency_s
        self._prune_at_s = 0.0
        self._write(self._prune)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Store({self.engine.url.render_as_string(hide_password=True)!r})"

    def close(self) -> None:
        """Do what waits to be written, and close every connection."""
        self._writer.close()
        if self._watch is not None:
            self._watch.close()
            self._watch = None
        self.engine.dispose()

    @property
    def commits(self) -> int:
        """Transactions written so far."""
        return self._writer.commits

    # Writes

    def _write(self, job: Callable[[Session], _T]) -> _T:
        return self._writer.submit(job).result()

    def contribute(self, body: Characterization, who: Contributor, *, key: str | None = None) -> Future[Outcome]:
        """Take in a contribution; the future is set when it is on the disk.

        Its exceptions: `contributing.ConflictError`, `matching.AmbiguousError`, `DatabaseUnavailableError`.

        Raises
        ------
        BusyError
            When too many writes wait.
        """
        digest = body_hash(body)

        def job(session: Session) -> Outcome:
            self._prune(session)
            return contributing.take(session, body, who, key, digest, self._entries)

        return self._writer.submit(job)

    def keep_keys(self, seconds: float) -> None:
        """Keep the answers to keys of contributions this long from now on, and up to an hour longer."""
        self._kept_s = seconds

    def _prune(self, session: Session) -> None:
        if time.monotonic() >= self._prune_at_s:
            before_us = now_us() - int(self._kept_s * 1e6)
            session.execute(delete(Idempotency).where(Idempotency.created_us < before_us))
            self._prune_at_s = time.monotonic() + _PRUNE_S

    def decide(self, contribution_id: int, status: str, who: Contributor) -> Future[Outcome | None]:
        """Accept or reject a contribution whatever the rules said; None when there is none of that id.

        Parameters
        ----------
        contribution_id : int
        status : str
            ``"accepted"`` or ``"rejected"``.
        who : Contributor
        """
        if status not in ("accepted", "rejected"):
            raise ValueError(f"status is {status!r}; accepted or rejected expected")
        return self._writer.submit(
            lambda session: contributing.decide(session, contribution_id, status, who, self._entries)
        )

    def create_token(
        self, name: str, role: str, *, expires_us: int | None = None, who: Contributor = OPERATOR
    ) -> NewToken:
        """Make a token. Its text is in what is returned and nowhere else.

        Parameters
        ----------
        name : str
            Whose it is, 1 to 100 characters.
        role : str
            ``"read"``, ``"contribute"`` or ``"admin"``.
        expires_us : int, optional
            Microseconds since 1970; without it, never.

        Raises
        ------
        ValueError
            For another role, an empty name or an end that has passed.
        """
        if role not in ROLES:
            raise ValueError(f"role is {role!r}; {', '.join(ROLES[:-1])} or {ROLES[-1]} expected")
        if not 1 <= len(name.strip()) <= 100 or not name.isprintable():
            raise ValueError("name must have 1 to 100 printable characters")
        if expires_us is not None and expires_us <= now_us():
            raise ValueError("expires must lie in the future")
        made = new_token()

        def job(session: Session) -> None:
            session.add(
                Token(
                    id=made.id,
                    name=name.strip(),
                    role=role,
                    secret_hash=made.secret_hash,
                    created_us=now_us(),
                    created_by=who.token_id,
                    expires_us=expires_us,
                )
            )
            contributing.note(session, who, "create token", made.id, f"role {role}")
            contributing.bump(session)

        self._write(job)
        return made

    def revoke_token(self, token_id: str, who: Contributor = OPERATOR) -> bool:
        """End a token at once; false when there is none of that id, or it has ended before."""

        def job(session: Session) -> bool:
            row = session.get(Token, token_id)
            if row is None or row.revoked_us is not None:
                return False
            row.revoked_us = now_us()
            contributing.note(session, who, "revoke token", token_id, "revoked")
            contributing.bump(session)
            return True

        return self._write(job)

    def note(self, who: Contributor, action: str, target: str, outcome: str) -> Future[None]:
        """A line in the audit trail."""
        return self._writer.submit(lambda session: contributing.note(session, who, action, target, outcome))

    # Reads

    def _read(self, query: Executable) -> Sequence[Any]:
        try:
            with self.engine.connect() as connection:
                return connection.execute(query).all()
        except SQLAlchemyError as error:
            raise DatabaseUnavailableError("the database does not answer") from error

    def changed(self) -> int:
        """A number that is another one after every write, of whatever process."""
        if self._watch is not None:
            try:
                return int(self._watch.execute("PRAGMA data_version").fetchone()[0])
            except sqlite3.Error as error:
                raise DatabaseUnavailableError("the database does not answer") from error
        return self.version()

    def version(self) -> int:
        """How many transactions have changed what is answered."""
        return int(self._read(select(Meta.value).where(Meta.name == "version"))[0][0])

    def changes(self, after: int) -> tuple[list[int], bool]:
        """Sources fused after a version, and whether one has gone since."""
        changed = [row[0] for row in self._read(select(Fused.source_id).where(Fused.version > after))]
        removed = self._read(select(Meta.value).where(Meta.name == "removed", Meta.value > after))
        return changed, bool(removed)

    def source_rows(self, ids: Sequence[int]) -> dict[int, FusedRow]:
        """What is answered about sources, by id; those without an accepted contribution are left out."""
        columns = select(Source.id, Source.kind, Source.name, Source.carrier_hz, Fused.version, Fused.state)
        joined = columns.join(Fused, Fused.source_id == Source.id)
        out: dict[int, FusedRow] = {}
        for start in range(0, len(ids), 500):
            rows = self._read(joined.where(Source.id.in_(ids[start : start + 500])))
            out.update((row[0], FusedRow(*row)) for row in rows)
        return out

    def find(
        self, search: Search, after: tuple[float, int] | None, limit: int
    ) -> tuple[list[int], tuple[float, int] | None]:
        """Ids of a page of sources, and where the next one begins.

        By id; with `Search.near_deg` by distance, then id. A source that comes in between pages shifts nothing.
        """
        query = select(Fused.source_id, Fused.latitude_deg, Fused.longitude_deg)
        if search.kind is not None:
            query = query.where(Fused.kind == search.kind)
        if search.box is not None:
            query = query.where(spatial.within(search.box))
        if search.name:
            named = select(Alias.source_id).where(Alias.name_key.contains(name_key(search.name), autoescape=True))
            query = query.where(Fused.source_id.in_(named))
        if search.near_deg is None:
            if after is not None:
                query = query.where(Fused.source_id > after[1])
            rows = self._read(query.order_by(Fused.source_id).limit(limit + 1))
            ids = [row[0] for row in rows[:limit]]
            return ids, ((0.0, ids[-1]) if len(rows) > limit else None)
        rows = self._read(query.where(spatial.within(spatial.around(*search.near_deg, search.radius_m))))
        if not rows:
            return [], None
        table = spatial.distances_m(*search.near_deg, spatial.column(rows, 1), spatial.column(rows, 2))
        found = sorted((float(d), int(row[0])) for d, row in zip(table, rows, strict=True) if d <= search.radius_m)
        if after is not None:
            found = [one for one in found if one > after]
        return [one[1] for one in found[:limit]], (found[limit - 1] if len(found) > limit else None)

    def accepted(self, source_id: int) -> list[Entry]:
        """The accepted contributions of a source that count (`fusion.counting`)."""
        try:
            with self._reading, self.engine.connect() as connection, Session(connection) as session:
                return contributing.entries_of(session, source_id, "accepted", self._read_entries)
        except SQLAlchemyError as error:
            raise DatabaseUnavailableError("the database does not answer") from error

    def source_exists(self, source_id: int) -> bool:
        """Whether a source has any contribution at all."""
        return bool(self._read(select(Source.id).where(Source.id == source_id)))

    def contributions(
        self, *, source_id: int | None = None, status: str | None = None, before: int = _MOST_ID, limit: int = 50
    ) -> list[dict[str, Any]]:
        """Contributions with what became of them, the newest first."""
        query = (
            select(
                Contribution.id,
                Contribution.source_id,
                Contribution.received_us,
                Contribution.token_id,
                Contribution.body,
                Verdict.status,
                Verdict.reasons,
                Verdict.decided_by,
            )
            .join(Verdict, Verdict.contribution_id == Contribution.id)
            .where(Contribution.id < before)
            .order_by(Contribution.id.desc())
            .limit(limit)
        )
        if source_id is not None:
            query = query.where(Contribution.source_id == source_id)
        if status is not None:
            query = query.where(Verdict.status == status)
        return [dict(row._mapping) for row in self._read(query)]

    def audit(self, *, before: int = _MOST_ID, limit: int = 50) -> list[dict[str, Any]]:
        """Lines of the audit trail, the newest first."""
        columns = (Audit.id, Audit.at_us, Audit.actor, Audit.address, Audit.action, Audit.target, Audit.outcome)
        rows = self._read(select(*columns).where(Audit.id < before).order_by(Audit.id.desc()).limit(limit))
        return [dict(row._mapping) for row in rows]

    def tokens(self) -> list[dict[str, Any]]:
        """Every token, without its secret's hash."""
        columns = (
            Token.id, Token.name, Token.role, Token.created_us, Token.created_by, Token.expires_us, Token.revoked_us
        )  # fmt: skip
        return [dict(row._mapping) for row in self._read(select(*columns).order_by(Token.created_us, Token.id))]

    def grant(self, token_id: str) -> Grant | None:
        """What a token allows, unless it was revoked; its end and its secret are for the caller to check."""
        columns = (Token.id, Token.name, Token.role, Token.expires_us, Token.secret_hash)
        rows = self._read(select(*columns).where(Token.id == token_id, Token.revoked_us.is_(None)))
        return Grant(*rows[0]) if rows else None

    def counts(self) -> dict[str, int]:
        """How many sources are answered, and how many contributions have come."""
        sources, contributions = self._read(
            select(
                select(func.count()).select_from(Fused).scalar_subquery(),
                select(func.count()).select_from(Contribution).scalar_subquery(),
            )
        )[0]
        return {"sources": sources, "contributions": contributions}

    def backup(self, path: str | Path) -> None:
        """Copy the whole database into a new file, while it is in use (SQLite only).

        Raises
        ------
        ValueError
            For PostgreSQL, which has pg_dump, and for a file that exists.
        """
        if not self.sqlite:
            raise ValueError("backup copies SQLite files; for PostgreSQL use pg_dump")
        path = Path(path)
        if path.exists():
            raise ValueError(f"{path} exists; a new file expected")
        source, target = sqlite3.connect(str(self.engine.url.database)), sqlite3.connect(path)
        try:
            source.backup(target, pages=256, sleep=0.001)
        finally:
            source.close()
            target.close()
