"""What a write does within its transaction: a contribution taken in, judged and fused; a decision of an administrator.

All of it happens in one transaction that no other writer overlaps (`writer.Writer`), so two first contributions of one
source make one source, and what is answered never lags behind what was acknowledged.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Executable, Subquery, bindparam, func, select, text, update
from sqlalchemy.orm import Session

from soopnav_cpp.sopdb import spatial
from soopnav_cpp.sopdb.fusion import MOST_FUSED, MOST_OF_ONE, Entry, fuse, judge
from soopnav_cpp.sopdb.matching import BY_PLACE, CARRIER_TOLERANCE, NEAR_M, Known, match, name_key
from soopnav_cpp.sopdb.records import STORED, Characterization
from soopnav_cpp.sopdb.schema import (
    Alias,
    Audit,
    Contribution,
    Fused,
    Idempotency,
    Meta,
    Source,
    Verdict,
    from_us,
    now_us,
    to_us,
)

__all__ = ["ConflictError", "Contributor", "Entries", "Outcome", "bump", "decide", "note", "take"]


# Statements of every contribution, built once: building costs more than running them.
_BUMP = text("UPDATE meta SET value = value + 1 WHERE name = 'version' RETURNING value")
_RANK = func.row_number().over(
    partition_by=Contribution.token_id, order_by=(Contribution.time_us.desc(), Contribution.id.desc())
)
_OF_STATUS = (
    select(Contribution.id, _RANK.label("rank"))
    .join(Verdict, Verdict.contribution_id == Contribution.id)
    .where(Contribution.source_id == bindparam("source_id"), Verdict.status == bindparam("status"))
)


def _counting(ranked: Subquery) -> Executable:
    """Rows of those that `fusion.counting` would choose."""
    return (
        select(
            Contribution.id, Contribution.token_id, Contribution.received_us, Contribution.body, Contribution.body_hash
        )
        .join(ranked, ranked.c.id == Contribution.id)
        .where(ranked.c.rank <= MOST_OF_ONE)
        .order_by(ranked.c.rank, Contribution.time_us.desc(), Contribution.id.desc())
        .limit(MOST_FUSED)
    )


_ENTRIES = _counting(_OF_STATUS.subquery())
_ENTRIES_BY_RULE = _counting(_OF_STATUS.where(Verdict.decided_by == "rule").subquery())
_OF_SIGNAL = (
    select(Source.id, Fused.state)
    .join(Fused, Fused.source_id == Source.id, isouter=True)
    .where(Source.kind == bindparam("kind"), Source.carrier_hz.between(bindparam("low"), bindparam("high")))
)
_NAMED = _OF_SIGNAL.join(Alias, Alias.source_id == Source.id).where(Alias.name_key == bindparam("name_key"))
_ALIAS = select(Alias.source_id).where(
    Alias.source_id == bindparam("source_id"), Alias.name_key == bindparam("name_key")
)
_TWIN = (
    select(Contribution.id)
    .where(Contribution.body_hash == bindparam("body_hash"), Contribution.source_id == bindparam("source_id"))
    .order_by(Contribution.id)
    .limit(1)
)
_COUNTS = (
    select(func.count(), func.count(Contribution.token_id.distinct()))
    .select_from(Contribution)
    .join(Verdict, Verdict.contribution_id == Contribution.id)
    .where(Contribution.source_id == bindparam("source_id"), Verdict.status == "accepted")
)


class ConflictError(ValueError):
    """An idempotency key that came with another body before."""


@dataclass(frozen=True)
class Contributor:
    """Who asks for a write: token, or another name in angle brackets, and network address."""

    token_id: str
    address: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a contribution; `repeated` when an idempotency key brought an old answer back."""

    answer: dict[str, Any]
    repeated: bool = False


class Entries:
    """Parsed contributions, those used last; they never change, so they are never stale. For one thread."""

    def __init__(self, most: int = 8192) -> None:
        self._most = most
        self._known: OrderedDict[int, tuple[tuple[Any, ...], Entry]] = OrderedDict()

    def clear(self) -> None:
        """Forget all: of a transaction taken back, the ids are given to others."""
        self._known.clear()

    def of(self, row: Any) -> Entry:
        """The entry of a row with ``id``, ``token_id``, ``received_us``, ``body`` and ``body_hash``."""
        identity = (row.token_id, row.received_us, bytes(row.body_hash))
        found = self._known.get(row.id)
        if found is None or found[0] != identity:
            body = Characterization.model_validate_json(row.body, context=STORED)
            found = identity, Entry(str(row.id), row.token_id or "", from_us(row.received_us), body)
            self._known[row.id] = found
            if len(self._known) > self._most:
                self._known.popitem(last=False)
        self._known.move_to_end(row.id)
        return found[1]


def entries_of(session: Session, source_id: int, status: str, known: Entries, *, by_rule: bool = False) -> list[Entry]:
    """Contributions of a source that have a status and count (`fusion.counting`), oldest first; those that the rules
    judged, if asked."""
    rows = session.execute(_ENTRIES_BY_RULE if by_rule else _ENTRIES, {"source_id": source_id, "status": status})
    return sorted((known.of(row) for row in rows), key=lambda entry: (entry.time, int(entry.id)))


def bump(session: Session) -> int:
    """The next version of what is answered."""
    return int(session.execute(_BUMP).scalar_one())


def _printable(said: str) -> str:
    """Text that every database takes and every terminal shows as it is."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in said)


def note(session: Session, who: Contributor, action: str, target: str, outcome: str) -> None:
    """A line of the audit trail, what does not print in it written as in Python."""
    session.add(
        Audit(
            at_us=now_us(),
            actor=_printable(who.token_id)[:40],
            address=_printable(who.address)[:64],
            action=_printable(action)[:40],
            target=_printable(target)[:100],
            outcome=_printable(outcome)[:200],
        )
    )


def _candidates(session: Session, body: Characterization) -> list[Known]:
    source, position = body.source, body.position
    signal = {
        "kind": source.kind,
        "low": source.carrier_hz * (1.0 - CARRIER_TOLERANCE),
        "high": source.carrier_hz * (1.0 + CARRIER_TOLERANCE),
    }
    rows = session.execute(_NAMED, signal | {"name_key": name_key(source.name)})
    found = {row.id: (True, row.state) for row in rows}
    if position is not None and source.kind in BY_PLACE:
        latitude, longitude = spatial.place(position.p_e_m)
        near = _OF_SIGNAL.where(spatial.within(spatial.around(latitude, longitude, 2.0 * NEAR_M)))
        for row in session.execute(near, signal):
            found.setdefault(row.id, (False, row.state))
    known = []
    for source_id, (same_name, state) in sorted(found.items()):
        place = None if state is None else json.loads(state)["state"]["position"]
        known.append(
            Known(
                source_id,
                same_name,
                None if place is None else np.array(place["value"]),
                None if place is None else np.array(place["covariance"]),
            )
        )
    return known


def _source_of(session: Session, body: Characterization, at_us: int) -> int:
    position = body.position
    found = match(
        body.source.kind,
        None if position is None else np.array(position.p_e_m),
        None if position is None else np.array(position.covariance_m2),
        _candidates(session, body),
    )
    if found is None:
        row = Source(kind=body.source.kind, name=body.source.name, carrier_hz=body.source.carrier_hz, created_us=at_us)
        session.add(row)
        session.flush()
        found = row.id
    alias = {"source_id": found, "name_key": name_key(body.source.name)}
    if session.execute(_ALIAS, alias).first() is None:
        session.add(Alias(**alias))
    return found


def _set(session: Session, ids: Iterable[int], status: str, reasons: Sequence[str], by: str) -> None:
    values = {"status": status, "reasons": json.dumps(list(reasons)), "decided_by": by, "decided_us": now_us()}
    for contribution_id in ids:
        session.execute(update(Verdict).where(Verdict.contribution_id == contribution_id).values(**values))


def _by_rule(session: Session, ids: Iterable[str]) -> list[int]:
    """Those of `ids` that an administrator has not decided about."""
    wanted = [int(one) for one in ids]
    if not wanted:
        return []
    query = select(Verdict.contribution_id).where(Verdict.contribution_id.in_(wanted), Verdict.decided_by == "rule")
    return list(session.scalars(query))


def fuse_again(session: Session, source_id: int, known: Entries) -> None:
    """Fuse a source again, and count up the version."""
    version = bump(session)
    accepted = entries_of(session, source_id, "accepted", known)
    row = session.get(Fused, source_id)
    if not accepted:
        if row is not None:
            session.delete(row)
            session.merge(Meta(name="removed", value=version))
            session.flush()
        return
    state = fuse(accepted, max(entry.time for entry in accepted))
    count, voices = session.execute(_COUNTS, {"source_id": source_id}).one()
    source = session.get_one(Source, source_id)
    if row is None:
        row = Fused(source_id=source_id, kind=source.kind, carrier_hz=source.carrier_hz)
        session.add(row)
    row.version = version
    row.state = json.dumps({"state": state.to_json(), "contributions": count, "voices": max(voices, 1)})
    row.latitude_deg = row.longitude_deg = None
    if state.position is not None:
        row.latitude_deg, row.longitude_deg = spatial.place(state.position.value.tolist())
    session.flush()


def take(
    session: Session, body: Characterization, who: Contributor, key: str | None, body_hash: bytes, known: Entries
) -> Outcome:
    """Take in a contribution.

    Parameters
    ----------
    session : Session
        Within a transaction that no other writer overlaps.
    body : Characterization
    who : Contributor
    key : str or None
        A key of this contributor that has come before gives the answer that it got then.
    body_hash : bytes
        SHA-256 of the body in canonical form.
    known : Entries

    Raises
    ------
    ConflictError
        For a key that came with another body.
    AmbiguousError
        For a name that sources at several places go by, without a position.
    """
    if key is not None:
        before = session.get(Idempotency, (who.token_id, key))
        if before is not None:
            if before.body_hash != body_hash:
                raise ConflictError("Idempotency-Key: came with another body before; a new key for each body expected")
            return Outcome(json.loads(before.answer), repeated=True)
    at_us = now_us()
    source_id = _source_of(session, body, at_us)
    twin = session.scalar(_TWIN, {"body_hash": body_hash, "source_id": source_id})
    kept = json.dumps(body.to_json(), ensure_ascii=False, separators=(",", ":"))
    at = from_us(at_us)
    row = Contribution(
        source_id=source_id,
        received_us=at_us,
        token_id=who.token_id,
        body=kept,
        body_hash=body_hash,
        receiver=body.provenance.receiver,
        method=body.provenance.method,
        independent=body.provenance.independent,
        duration_s=body.quality.duration_s,
        time_us=at_us if body.clock is None else to_us(body.clock.epoch),
        bias_s=None if body.clock is None else body.clock.bias_s,
        drift=None if body.clock is None else body.clock.drift,
        x_m=None if body.position is None else body.position.p_e_m[0],
        y_m=None if body.position is None else body.position.p_e_m[1],
        z_m=None if body.position is None else body.position.p_e_m[2],
        h0_s=None if body.noise is None else body.noise.h0_s,
        h_minus2_per_s=None if body.noise is None else body.noise.h_minus2_per_s,
    )
    session.add(row)
    session.flush()
    by, status = "rule", "quarantined"
    reasons: tuple[str, ...] = ()
    if twin is not None:
        by, reasons = "twin", (f"the same numbers as contribution {twin}; they count once",)
    else:
        accepted = entries_of(session, source_id, "accepted", known)
        quarantined = entries_of(session, source_id, "quarantined", known, by_rule=True)
        verdict = judge(Entry(str(row.id), who.token_id, at, body), accepted, quarantined)
        status, reasons = verdict.status, verdict.reasons
        for other, why in verdict.quarantined.items():
            _set(session, _by_rule(session, [other]), "quarantined", why, "rule")
        _set(session, _by_rule(session, verdict.reinstated), "accepted", (), "rule")
    session.add(
        Verdict(
            contribution_id=row.id, status=status, reasons=json.dumps(list(reasons)), decided_by=by, decided_us=at_us
        )
    )
    session.flush()
    if status == "accepted":
        fuse_again(session, source_id, known)
    answer = {"id": str(row.id), "status": status, "reasons": list(reasons), "source_id": str(source_id)}
    note(session, who, "contribute", f"contribution {row.id}", f"{status}, source {source_id}")
    if key is not None:
        session.add(
            Idempotency(
                token_id=who.token_id,
                key=key,
                body_hash=body_hash,
                contribution_id=row.id,
                answer=json.dumps(answer),
                created_us=at_us,
            )
        )
    session.flush()
    return Outcome(answer)


def decide(session: Session, contribution_id: int, status: str, who: Contributor, known: Entries) -> Outcome | None:
    """An administrator's word about a contribution, ``"accepted"`` or ``"rejected"``; None when there is none such."""
    row = session.get(Contribution, contribution_id)
    if row is None:
        return None
    _set(session, [contribution_id], status, ["released by an administrator"] * (status == "accepted"), who.token_id)
    fuse_again(session, row.source_id, known)
    note(session, who, "release" if status == "accepted" else "reject", f"contribution {contribution_id}", status)
    reasons = [] if status == "accepted" else ["rejected by an administrator"]
    return Outcome({"id": str(contribution_id), "status": status, "reasons": reasons, "source_id": str(row.source_id)})
