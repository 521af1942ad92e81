"""Answers about sources as the bytes that are sent, kept until something changes.

Every answer kept belongs to one version of the database and is dropped with it, so an answer is never older than the
last acknowledged write; sources are kept until they change. Without an asked time the answer is that of the running
second.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np

from soopnav_cpp.sopdb.auth import Grant
from soopnav_cpp.sopdb.fusion import SourceState, fuse, stability
from soopnav_cpp.sopdb.rendering import Rendered, zulu
from soopnav_cpp.sopdb.schema import from_us
from soopnav_cpp.sopdb.snapshot import encode, timeless
from soopnav_cpp.sopdb.store import Search, Store

__all__ = ["Answer", "Answers", "Bodies"]

_SECOND_US = 1_000_000
_MINUTE_US = 60 * _SECOND_US
_MOST_SOURCES = 20_000
_MOST_BYTES = 64 * 2**20
_OVERHEAD = 1_000  # of an entry beside its body: key, ETag, objects
_TAU_S = np.logspace(-1.0, 4.0, 51)


class Answer(NamedTuple):
    """Bytes to send and their ETag: strong for an asked time, otherwise weak and new every minute."""

    body: bytes
    etag: str


class Bodies:
    """Answers to be sent again, the oldest dropped beyond a number of bytes. Used by several threads at once.

    Parameters
    ----------
    most_bytes : int
        Of all bodies together. One answer that is longer is not kept.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most = most_bytes
        self._lock = threading.Lock()
        self._answers: dict[Any, Answer] = {}  # in the order they came
        self.size = 0

    def get(self, key: Any) -> Answer | None:
        """The answer; None where none is kept."""
        return self._answers.get(key)

    def keep(self, key: Any, answer: Answer) -> None:
        """Keep an answer; what came first goes first."""
        length = _length(answer)
        if length > self._most:
            return
        with self._lock:
            if key in self._answers:
                self.size -= _length(self._answers.pop(key))
            self._answers[key] = answer
            self.size += length
            while self.size > self._most:
                self.size -= _length(self._answers.pop(next(iter(self._answers))))


def _length(answer: Answer) -> int:
    return _OVERHEAD + len(answer.body)


class _Kept:
    """What belongs to one version of the database. Written by several threads at once, each item in one step."""

    def __init__(self, changed: int, version: int) -> None:
        self.changed = changed
        self.version = version
        self.bodies = Bodies()
        self.grants: dict[str, Grant | None] = {}


def _keep(table: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    if len(table) >= most:
        table.clear()
    table[key] = value


def _digest(*parts: bytes) -> str:
    digest = hashlib.blake2b(digest_size=12)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


class Answers:
    """Answers from a store.

    Parameters
    ----------
    store : Store
    fresh_s : float
        Another process's writes are looked for this often; 0: at every request.
    """

    def __init__(self, store: Store, fresh_s: float = 0.0) -> None:
        self._store = store
        self._fresh_s = fresh_s
        self._looked_s = -1.0
        self._commits = -1
        self._kept = _Kept(-1, -1)
        # With each source the version it was looked up at, which counts as long as the source has not changed since.
        self._sources_kept: dict[int, tuple[int, Rendered]] = {}
        self._changed_at: dict[int, int] = {}

    def refresh(self) -> int:
        """Drop what another version of the database said; the version now."""
        now_s, commits = time.monotonic(), self._store.commits
        if self._fresh_s and commits == self._commits and now_s - self._looked_s < self._fresh_s:
            return self._kept.version
        changed = self._store.changed()
        kept = self._kept
        if changed != kept.changed:
            version = self._store.version()
            if version == kept.version:
                kept.changed = changed
            else:
                if kept.version >= 0:
                    changes, removed = self._store.changes(kept.version)
                    self._changed_at.update(dict.fromkeys(changes, version))
                    if removed:
                        self._sources_kept = {}
                self._kept = _Kept(changed, version)
        self._looked_s, self._commits = now_s, commits
        return self._kept.version

    def grant(self, token_id: str) -> Grant | None:
        """What a token allows; None for one that is not there or was revoked."""
        grants = self._kept.grants
        if token_id in grants:
            return grants[token_id]
        found = self._store.grant(token_id)
        if found is not None:  # unknown ones are not kept: anybody can make them up
            _keep(grants, token_id, found, _MOST_SOURCES)
        return found

    def _sources(self, ids: Sequence[int]) -> list[Rendered]:
        version, kept, changed_at = self._kept.version, self._sources_kept, self._changed_at
        found: dict[int, Rendered] = {}
        for one in ids:
            entry = kept.get(one)
            if entry is not None and entry[0] >= changed_at.get(one, 0):
                found[one] = entry[1]
        rows = self._store.source_rows([one for one in ids if one not in found]) if len(found) < len(ids) else {}
        for one, row in rows.items():
            said = json.loads(row.state)
            state = SourceState.from_json(said["state"])
            found[one] = Rendered(row, state, int(said["contributions"]), int(said["voices"]))
            _keep(kept, one, (version, found[one]), _MOST_SOURCES)
        return [found[one] for one in ids if one in found]

    def _source(self, source: Rendered, at: datetime, text: str) -> str:
        if at >= source.state.at:
            return source.at(at, text)
        return source.of(fuse(self._store.accepted(source.row.id), at))

    def _times(self, at: datetime | None) -> tuple[datetime, bytes]:
        """The time of an answer, and what of the time its weak ETag depends on."""
        if at is not None:
            return at, b""
        now_us = time.time_ns() // 1000
        return from_us(now_us // _SECOND_US * _SECOND_US), str(now_us // _MINUTE_US).encode()

    def _answer(self, text: str, sources: Sequence[Rendered], asked: datetime | None, more: bytes) -> Answer:
        body = text.encode()
        if asked is not None:
            return Answer(body, f'"{_digest(body)}"')
        said = b",".join(b"%d:%d" % (one.row.id, one.row.version) for one in sources)
        return Answer(body, f'W/"{_digest(said, more)}"')

    def source(self, source_id: int, at: datetime | None = None) -> Answer | None:
        """One source at a time; None when nothing that stands is known about it."""
        when, minute = self._times(at)
        bodies, key = self._kept.bodies, (source_id, when, at is None)
        answer = bodies.get(key)
        if answer is None:
            found = self._sources([source_id])
            if not found:
                return None
            answer = self._answer(self._source(found[0], when, zulu(when)), found, at, minute)
            bodies.keep(key, answer)
        return answer

    def page(
        self, search: Search, after: tuple[float, int] | None, limit: int, at: datetime | None, cursor: Any
    ) -> Answer:
        """A page of sources at a time; `cursor` makes the text of where the next one begins."""
        when, minute = self._times(at)
        bodies, key = self._kept.bodies, (search, after, limit, when, at is None)
        answer = bodies.get(key)
        if answer is None:
            ids, beyond = self._store.find(search, after, limit)
            sources = self._sources(ids)
            more = None if beyond is None else cursor(beyond)
            text = zulu(when)
            listed = ",".join([self._source(one, when, text) for one in sources])
            said = f'{{"at":"{text}","sources":[{listed}],"next_cursor":{json.dumps(more)}}}'
            answer = self._answer(said, sources, at, minute + b"|" + (more or "").encode())
            bodies.keep(key, answer)
        return answer

    def stability(self, source_id: int, at: datetime | None = None) -> Answer | None:
        """The Allan deviation of a source's clock with its band; None when nothing is known about its noise."""
        when, minute = self._times(at)
        found = self._sources([source_id])
        if not found:
            return None
        state = found[0].state
        state = state.moved(when) if when >= state.at else fuse(self._store.accepted(source_id), when)
        noise = state.noise
        if noise is None:
            return None
        curve = stability(noise, _TAU_S)
        value = {"id": str(source_id), "at": zulu(when), "confidence": 0.95, **curve}
        return self._answer(json.dumps(value), found, at, minute + b"|stability")

    def snapshot(self) -> Answer:
        """Every source in the form of `snapshot`, each at the time of its newest contribution, graded now.

        The ETag is that of the sources: making the same again, later, does not change it.
        """
        bodies = self._kept.bodies
        answer = bodies.get("snapshot")
        if answer is None:
            sources: list[dict[str, Any]] = []
            created = datetime.now(timezone.utc)
            after: tuple[float, int] | None = None
            while True:
                ids, after = self._store.find(Search(), after, 500)
                for one in self._sources(ids):
                    said = json.loads(self._source(one, one.state.at, zulu(one.state.at)))
                    sources.append(said | json.loads(f"{{{one.quality(created)}}}"))
                if after is None:
                    break
            body = encode(sources, created)
            answer = Answer(body, f'"{_digest(timeless(body))}"')
            bodies.keep("snapshot", answer)
        return answer
