"""Tables of the signal database, for SQLite and PostgreSQL.

Times are UTC, in microseconds since 1970 (`now_us`): integers compare alike in every database. Contributions and the
audit trail are only ever added to; triggers of the migrations see to that. What became of a contribution is a row of
`Verdict`, which may change.
"""

from __future__ import annotations

import time
from datetime import datetime, timedelta, timezone

from sqlalchemy import BigInteger, ForeignKey, Index, Integer, LargeBinary, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = [
    "Alias",
    "Audit",
    "Base",
    "Contribution",
    "Fused",
    "Idempotency",
    "Meta",
    "Source",
    "Token",
    "Verdict",
    "from_us",
    "now_us",
    "to_us",
]

#: SQLite numbers rows by itself only in a column of its own INTEGER type.
Key = BigInteger().with_variant(Integer, "sqlite")
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def now_us() -> int:
    """This computer's clock, microseconds since 1970."""
    return time.time_ns() // 1000


def to_us(when: datetime) -> int:
    """An aware time as microseconds since 1970."""
    return (when - _EPOCH) // timedelta(microseconds=1)


def from_us(when_us: int) -> datetime:
    """Microseconds since 1970 as an aware time."""
    return _EPOCH + timedelta(microseconds=when_us)


class Base(DeclarativeBase):
    """Base of the tables."""


class Meta(Base):
    """Numbers of the whole database: ``version`` counts the transactions that changed what is answered, ``removed`` is
    the version at which a source went for the last time."""

    __tablename__ = "meta"
    name: Mapped[str] = mapped_column(String(40), primary_key=True)
    value: Mapped[int] = mapped_column(BigInteger)


class Source(Base):
    """A transmitter: what it was called first, and its carrier then."""

    __tablename__ = "sources"
    id: Mapped[int] = mapped_column(Key, primary_key=True)
    kind: Mapped[str] = mapped_column(String(20))
    name: Mapped[str] = mapped_column(String(100))
    carrier_hz: Mapped[float]
    created_us: Mapped[int] = mapped_column(BigInteger)
    __table_args__ = (Index("ix_sources_kind_carrier", "kind", "carrier_hz"),)


class Alias(Base):
    """A name that a source goes by, folded (`matching.name_key`)."""

    __tablename__ = "aliases"
    source_id: Mapped[int] = mapped_column(ForeignKey("sources.id"), primary_key=True)
    name_key: Mapped[str] = mapped_column(String(400), primary_key=True)
    __table_args__ = (Index("ix_aliases_name_key", "name_key"),)


class Contribution(Base):
    """A characterisation as it was sent; never changed."""

    __tablename__ = "contributions"
    id: Mapped[int] = mapped_column(Key, primary_key=True)
    source_id: Mapped[int] = mapped_column(ForeignKey("sources.id"))
    received_us: Mapped[int] = mapped_column(BigInteger)
    token_id: Mapped[str | None] = mapped_column(String(40))
    body: Mapped[str] = mapped_column(Text)
    body_hash: Mapped[bytes] = mapped_column(LargeBinary(32))
    receiver: Mapped[str] = mapped_column(String(100))
    method: Mapped[str] = mapped_column(String(40))
    independent: Mapped[bool]
    duration_s: Mapped[float]
    time_us: Mapped[int] = mapped_column(BigInteger)
    bias_s: Mapped[float | None]
    drift: Mapped[float | None]
    x_m: Mapped[float | None]
    y_m: Mapped[float | None]
    z_m: Mapped[float | None]
    h0_s: Mapped[float | None]
    h_minus2_per_s: Mapped[float | None]
    __table_args__ = (
        Index("ix_contributions_source", "source_id", "time_us"),
        Index("ix_contributions_body_hash", "body_hash"),
    )


class Verdict(Base):
    """What became of a contribution: ``accepted``, ``quarantined`` or ``rejected``, why, and by rule or by whom."""

    __tablename__ = "verdicts"
    contribution_id: Mapped[int] = mapped_column(ForeignKey("contributions.id"), primary_key=True)
    status: Mapped[str] = mapped_column(String(20))
    reasons: Mapped[str] = mapped_column(Text)
    decided_by: Mapped[str] = mapped_column(String(40))
    decided_us: Mapped[int] = mapped_column(BigInteger)
    __table_args__ = (Index("ix_verdicts_status", "status", "contribution_id"),)


class Fused(Base):
    """What all accepted contributions of a source say together; written with them in one transaction.

    A source has a row when at least one of its contributions stands. The place is there for spatial queries.
    """

    __tablename__ = "fused"
    source_id: Mapped[int] = mapped_column(ForeignKey("sources.id"), primary_key=True)
    version: Mapped[int] = mapped_column(BigInteger)
    kind: Mapped[str] = mapped_column(String(20))
    carrier_hz: Mapped[float]
    latitude_deg: Mapped[float | None]
    longitude_deg: Mapped[float | None]
    state: Mapped[str] = mapped_column(Text)
    __table_args__ = (
        Index("ix_fused_place", "latitude_deg", "longitude_deg"),
        Index("ix_fused_kind", "kind", "source_id"),
        Index("ix_fused_version", "version"),
    )


class Token(Base):
    """A right to use the service. Of the secret only its SHA-256 is kept: with 256 random bits there is no guessing."""

    __tablename__ = "tokens"
    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    name: Mapped[str] = mapped_column(String(100))
    role: Mapped[str] = mapped_column(String(20))
    secret_hash: Mapped[bytes] = mapped_column(LargeBinary(32))
    created_us: Mapped[int] = mapped_column(BigInteger)
    created_by: Mapped[str] = mapped_column(String(40))
    expires_us: Mapped[int | None] = mapped_column(BigInteger)
    revoked_us: Mapped[int | None] = mapped_column(BigInteger)


class Audit(Base):
    """Who did what, when, and what came of it; never changed."""

    __tablename__ = "audit"
    id: Mapped[int] = mapped_column(Key, primary_key=True)
    at_us: Mapped[int] = mapped_column(BigInteger)
    actor: Mapped[str] = mapped_column(String(40))
    address: Mapped[str] = mapped_column(String(64))
    action: Mapped[str] = mapped_column(String(40))
    target: Mapped[str] = mapped_column(String(100))
    outcome: Mapped[str] = mapped_column(String(200))


class Idempotency(Base):
    """The contribution that a key of a token made, so that a retry does not make a second."""

    __tablename__ = "idempotency_keys"
    token_id: Mapped[str] = mapped_column(String(40), primary_key=True)
    key: Mapped[str] = mapped_column(String(200), primary_key=True)
    body_hash: Mapped[bytes] = mapped_column(LargeBinary(32))
    contribution_id: Mapped[int] = mapped_column(ForeignKey("contributions.id"))
    answer: Mapped[str] = mapped_column(Text)
    created_us: Mapped[int] = mapped_column(BigInteger)
    __table_args__ = (Index("ix_idempotency_created", "created_us"),)
