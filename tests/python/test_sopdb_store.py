"""The signal database's store, on SQLite and on PostgreSQL alike: identity, fusion, retries, tokens, migrations."""

from __future__ import annotations

import json
import shutil
import sqlite3
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
import postgresql
import sqlalchemy
from sopdb_bodies import characterization, clock, noise, position
from sqlalchemy.orm import Session

from soopnav_cpp.sopdb import database, fusion, matching, records, schema
from soopnav_cpp.sopdb.contributing import ConflictError, Contributor
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.fusion import SourceState
from soopnav_cpp.sopdb.records import Characterization
from soopnav_cpp.sopdb.spatial import Box
from soopnav_cpp.sopdb.store import OPERATOR, Search, Store
from soopnav_cpp.sopdb.writer import BusyError, Writer

ANN, BOB, CID = (Contributor(name) for name in ("ann", "bob", "cid"))


@pytest.fixture
def server() -> postgresql.Server:
    return postgresql.shared()


@pytest.fixture(scope="module")
def templates(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Any], str]:
    """Makes databases of this revision by copying, which is faster than migrating each."""
    made: dict[str, str] = {}

    def template(kind: str, server: Any) -> str:
        if kind not in made:
            file = tmp_path_factory.mktemp("template") / "signals.db"
            made[kind] = str(file) if kind == "sqlite" else server.new_database()
            Store(made[kind]).close()
        return made[kind]

    return template


@pytest.fixture(params=["sqlite", "postgresql"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def url(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if kind == "sqlite":
        return f"sqlite:///{tmp_path / 'signals.db'}"
    return request.getfixturevalue("server").new_database()


@pytest.fixture
def store(kind: str, request: pytest.FixtureRequest, tmp_path: Path, templates: Any) -> Iterator[Store]:
    server = request.getfixturevalue("server") if kind == "postgresql" else None
    like = templates(kind, server)
    url = server.new_database(like) if server is not None else shutil.copy(like, tmp_path / "signals.db")
    with Store(str(url)) as found:
        yield found


@pytest.fixture
def lite(tmp_path: Path, templates: Any) -> Iterator[Store]:
    with Store(str(shutil.copy(templates("sqlite", None), tmp_path / "signals.db"))) as found:
        yield found


def give(store: Store, body: dict[str, Any], who: Contributor = ANN, key: str | None = None) -> dict[str, Any]:
    return store.contribute(Characterization.model_validate(body), who, key=key).result(30.0).answer


def place_of(store: Store, source_id: str) -> np.ndarray:
    row = store.source_rows([int(source_id)])[int(source_id)]
    state = SourceState.from_json(json.loads(row.state)["state"])
    assert state.position is not None
    return state.position.value


@pytest.mark.unit
def test_a_contribution_becomes_a_source(store: Store) -> None:
    answer = give(store, characterization())
    assert answer == {"id": "1", "status": "accepted", "reasons": [], "source_id": "1"}
    row = store.source_rows([1])[1]
    assert (row.kind, row.name, row.carrier_hz) == ("cdma", "PN 12", 881.52e6)
    assert store.counts() == {"sources": 1, "contributions": 1}
    kept = store.contributions(source_id=1)[0]
    assert kept["token_id"] == "ann"
    assert Characterization.model_validate_json(kept["body"]).source.name == "PN 12"
    assert [line["action"] for line in store.audit()] == ["contribute"]


@pytest.mark.unit
def test_contributions_and_audit_cannot_be_changed(store: Store) -> None:
    give(store, characterization())
    for table in ("contributions", "audit"):
        for statement in (f"UPDATE {table} SET id = 7", f"DELETE FROM {table}"):
            with pytest.raises(sqlalchemy.exc.DBAPIError, match="only added to"), store.engine.begin() as connection:
                connection.exec_driver_sql(statement)


@pytest.mark.law
def test_a_key_makes_one_contribution(store: Store) -> None:
    body = characterization()
    first = give(store, body, key="k1")
    assert give(store, body, key="k1") == first
    assert give(store, dict(reversed(body.items())), key="k1") == first  # the order of names is not the body
    with pytest.raises(ConflictError, match="Idempotency-Key"):
        give(store, characterization("other"), key="k1")
    assert give(store, characterization("other"), BOB, key="k1")["id"] != first["id"]  # a key is its token's own
    assert store.counts()["contributions"] == 2


@pytest.mark.unit
def test_the_same_numbers_count_once(store: Store) -> None:
    body = characterization()
    first = give(store, body)
    again = give(store, body, BOB)
    assert again["status"] == "quarantined"
    assert "the same numbers as contribution 1" in again["reasons"][0]
    assert again["source_id"] == first["source_id"]


@pytest.mark.unit
def test_two_first_contributions_at_once_make_one_source(store: Store) -> None:
    futures: list[Future[Any]] = []
    gate = threading.Barrier(8)

    def send(k: int) -> None:
        body = Characterization.model_validate(characterization(clock=clock(60.0 + k)))
        gate.wait()
        futures.append(store.contribute(body, Contributor(f"t{k}")))

    threads = [threading.Thread(target=send, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {future.result(30.0).answer["source_id"] for future in futures} == {"1"}
    assert store.commits < 2 + 8  # some of them shared a commit: opening the store was the first


@pytest.mark.law
def test_fusion_is_that_of_the_accepted(store: Store) -> None:
    for k, who in enumerate((ANN, BOB, CID)):
        give(store, characterization(position=position(60.17 + 1e-5 * k), clock=clock(100.0 - k)), who)
    before = place_of(store, "1")
    liar = give(store, characterization(position=position(60.20)), Contributor("liar"))
    assert liar["status"] == "quarantined"
    assert np.array_equal(place_of(store, "1"), before)
    outcome = store.decide(int(liar["id"]), "accepted", OPERATOR).result(30.0)
    assert outcome is not None
    assert outcome.answer["status"] == "accepted"
    assert np.linalg.norm(place_of(store, "1") - before) > 100.0
    store.decide(int(liar["id"]), "rejected", OPERATOR).result(30.0)
    assert np.allclose(place_of(store, "1"), before, atol=1e-6)
    assert store.decide(99, "accepted", OPERATOR).result(30.0) is None
    with pytest.raises(ValueError, match="status is 'believed'"):
        store.decide(1, "believed", OPERATOR)


@pytest.mark.unit
def test_a_first_liar_is_outvoted(store: Store) -> None:
    assert give(store, characterization(position=position(60.20)), Contributor("liar"))["status"] == "accepted"
    assert give(store, characterization(clock=clock(59.0)), ANN)["status"] == "quarantined"
    assert give(store, characterization(clock=clock(58.0)), BOB)["status"] == "accepted"
    status = {one["id"]: one["status"] for one in store.contributions()}
    assert status == {1: "quarantined", 2: "accepted", 3: "accepted"}


@pytest.mark.law
def test_one_token_does_not_push_the_others_out(store: Store) -> None:
    for k, who in enumerate((ANN, BOB)):
        give(store, characterization(clock=clock(1000.0 + k)), who)
    many = [characterization(clock=clock(900.0 - k)) for k in range(12)]
    waiting = [store.contribute(Characterization.model_validate(one), CID) for one in many]
    assert {one.result(30.0).answer["status"] for one in waiting} == {"accepted"}
    found = store.accepted(1)
    assert [entry.contributor for entry in found] == ["bob", "ann"] + ["cid"] * fusion.MOST_OF_ONE
    assert [entry.id for entry in found[2:]] == [str(k) for k in range(7, 15)]
    assert found == fusion.counting(found)


@pytest.mark.unit
def test_rejecting_everything_takes_the_source_away(store: Store) -> None:
    give(store, characterization())
    version = store.version()
    store.decide(1, "rejected", OPERATOR).result(30.0)
    assert store.version() > version
    assert store.source_rows([1]) == {}
    assert store.find(Search(), None, 10) == ([], None)
    assert store.source_exists(1)
    assert give(store, characterization(clock=clock(50.0)), BOB)["source_id"] == "1"


@pytest.mark.unit
@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ({}, {"name": "  pn   12 "}, True),
        ({}, {"name": "PN 13"}, False),  # another code of the same tower
        ({}, {"carrier_hz": 881.52e6 * (1 + 4e-6)}, True),
        ({}, {"carrier_hz": 881.52e6 * (1 + 6e-6)}, False),
        ({}, {"kind": "lte"}, False),
        ({}, {"position": position(48.2, 16.4)}, False),  # the same code in another city
        ({}, {"position": None}, True),
        ({"kind": "fm", "name": "Radio 1"}, {"kind": "fm", "name": "YLE", "position": position(60.1702)}, True),
        ({"kind": "fm", "name": "Radio 1"}, {"kind": "fm", "name": "YLE", "position": position(60.18)}, False),
        ({"kind": "fm", "name": "Radio 1"}, {"kind": "fm", "name": "YLE", "position": None}, False),
        ({"kind": "gps", "name": "G01", "position": None}, {"kind": "gps", "name": "G02", "position": None}, False),
    ],
)
def test_identity(lite: Store, first: dict[str, Any], second: dict[str, Any], same: bool) -> None:
    one = give(lite, characterization(**first))
    two = give(lite, characterization(**({"clock": clock(55.0)} | second)), BOB)
    assert (one["source_id"] == two["source_id"]) is same


@pytest.mark.unit
def test_a_name_at_several_places_needs_a_position(lite: Store) -> None:
    give(lite, characterization())
    give(lite, characterization(position=position(48.2, 16.4), clock=clock(55.0)), BOB)
    with pytest.raises(matching.AmbiguousError, match="position needed"):
        give(lite, characterization(position=None, clock=clock(50.0)), CID)
    there = characterization(position=position(48.2, 16.4), clock=clock(45.0))
    assert give(lite, there, CID)["source_id"] == "2"
    assert lite.counts() == {"sources": 2, "contributions": 3}


@pytest.mark.unit
def test_the_audit_trail_takes_what_does_not_print(store: Store) -> None:
    store.note(ANN, "refused", "DELETE /v1/tokens/\0aaa", "403: \x1b[2Jé").result(30.0)
    line = store.audit()[0]
    assert (line["target"], line["outcome"]) == ("DELETE /v1/tokens/\\x00aaa", "403: \\x1b[2Jé")


@pytest.mark.unit
def test_a_second_name_is_remembered(lite: Store) -> None:
    give(lite, characterization("Radio 1", "fm"))
    assert give(lite, characterization("YLE", "fm", clock=clock(55.0)), BOB)["source_id"] == "1"
    assert give(lite, characterization("yle", "fm", clock=clock(50.0), position=None), CID)["source_id"] == "1"


@pytest.mark.unit
def test_names_are_data(store: Store) -> None:
    give(store, characterization("plain"))
    for name in ("'; DROP TABLE sources; --", '"', "%", "_", "\\", "Robert'); --", "\U0001f4e1" * 100):
        _name_is_data(store, name)


def _name_is_data(store: Store, name: str) -> None:
    answer = give(store, characterization(name, clock=clock(50.0)), key=name[:1])
    assert store.source_rows([int(answer["source_id"])])[int(answer["source_id"])].name == name
    assert give(store, characterization(name, clock=clock(40.0)), BOB)["source_id"] == answer["source_id"] != "1"


PLACES = {
    "pole": (90.0, 0.0),
    "south pole": (-89.99, 120.0),
    "date line west": (10.0, 179.99),
    "date line east": (10.0, -179.99),
    "Helsinki": (60.17, 24.94),
    "Tallinn": (59.44, 24.75),
}


@pytest.fixture
def atlas(store: Store) -> Store:
    for name, (latitude, longitude) in PLACES.items():
        give(store, characterization(name, position=position(latitude, longitude)))
    give(store, characterization("nowhere", position=None))
    return store


def names(store: Store, search: Search) -> list[str]:
    ids, more = store.find(search, None, 100)
    assert more is None
    rows = store.source_rows(ids)
    return [rows[one].name for one in ids]


@pytest.mark.unit
def test_spatial_searches(atlas: Store) -> None:
    assert names(atlas, Search(near_deg=(60.17, 24.94), radius_m=100e3)) == ["Helsinki", "Tallinn"]
    assert names(atlas, Search(near_deg=(59.44, 24.75), radius_m=100e3)) == ["Tallinn", "Helsinki"]
    assert names(atlas, Search(near_deg=(59.44, 24.75), radius_m=10e3)) == ["Tallinn"]
    assert names(atlas, Search(near_deg=(10.0, 180.0), radius_m=5e3)) == ["date line west", "date line east"]
    assert names(atlas, Search(near_deg=(89.0, -120.0), radius_m=200e3)) == ["pole"]
    assert names(atlas, Search(near_deg=(0.0, 0.0), radius_m=2e7)) != []
    assert len(names(atlas, Search(near_deg=(0.0, 0.0), radius_m=2e7))) == len(PLACES)
    assert names(atlas, Search(box=Box(0.0, 20.0, 179.0, -179.0))) == ["date line west", "date line east"]
    assert names(atlas, Search(box=Box(0.0, 20.0, -180.0, 180.0))) == ["date line west", "date line east"]
    assert names(atlas, Search(box=Box(50.0, 90.0, 20.0, 30.0))) == ["pole", "Helsinki", "Tallinn"]
    assert names(atlas, Search(box=Box(-90.0, -80.0, 0.0, 10.0))) == []
    assert names(atlas, Search(kind="gps")) == []
    assert len(names(atlas, Search(kind="cdma"))) == len(PLACES) + 1


@pytest.mark.law
def test_pages_neither_lose_nor_repeat_while_sources_come(store: Store) -> None:
    for k in range(9):
        give(store, characterization(f"s{k}", position=position(60.0 + 0.01 * (k * 5 % 9), 25.0)))
    for search in (Search(), Search(kind="cdma"), Search(near_deg=(60.0, 25.0), radius_m=50e3)):
        seen: list[int] = []
        after: tuple[float, int] | None = None
        for step in range(5):
            ids, after = store.find(search, after, 2)
            seen += ids
            give(store, characterization(f"late {search} {step}"[-100:], position=position(60.0, 25.0)))
            if after is None:
                break
        early = [one for one in seen if one <= 9]
        assert sorted(early) == list(range(1, 10)) or len(seen) == 10
        assert len(set(seen)) == len(seen)


@pytest.mark.unit
def test_tokens(store: Store) -> None:
    made = store.create_token("roof", "contribute")
    assert made.text.startswith(f"sop_{made.id}_")
    assert made.text not in repr(made)
    grant = store.grant(made.id)
    assert grant is not None
    assert (grant.role, grant.name, grant.expires_us) == ("contribute", "roof", None)
    with store.engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT * FROM tokens").all()
    secret = made.text.rsplit("_", 1)[1] if made.text.count("_") == 2 else made.text[15:]
    assert secret not in repr(rows)
    assert store.revoke_token(made.id)
    assert not store.revoke_token(made.id)
    assert not store.revoke_token("nobody")
    assert store.grant(made.id) is None
    assert store.tokens()[0]["revoked_us"] is not None
    assert "secret_hash" not in store.tokens()[0]
    assert [line["action"] for line in store.audit()] == ["revoke token", "create token"]
    for name, role, expires in (("", "read", None), ("a\nb", "read", None), ("a", "root", None), ("a", "read", 5)):
        with pytest.raises(ValueError, match=r"must|expected"):
            store.create_token(name, role, expires_us=expires)


@pytest.mark.unit
def test_migrations_go_up_and_down(url: str) -> None:
    engine = database.open_engine(url)
    assert database.revision(engine) is None
    with pytest.raises(DatabaseUnavailableError, match="revision none"):
        Store(url, migrate=False)
    database.migrate(engine)
    database.migrate(engine)
    assert database.revision(engine) == database.head()
    with Store(url, migrate=False) as store:
        give(store, characterization())
    database.downgrade(engine, "0001")
    with engine.execution_options(writes=True).begin() as connection:
        connection.exec_driver_sql("UPDATE audit SET outcome = 'changed'")  # not refused any more
    database.migrate(engine)
    with Store(url, migrate=False) as store:
        assert store.counts() == {"sources": 1, "contributions": 1}
    database.downgrade(engine, "base")
    assert set(sqlalchemy.inspect(engine).get_table_names()) <= {"alembic_version"}
    database.migrate(engine)
    with engine.execution_options(writes=True).begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(DatabaseUnavailableError, match="newer soopnav"):
        Store(url)
    engine.dispose()


@pytest.mark.law
def test_migrations_make_the_tables_of_the_schema(url: str) -> None:
    from alembic.autogenerate import compare_metadata
    from alembic.runtime.migration import MigrationContext

    engine = database.open_engine(url)
    database.migrate(engine)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), schema.Base.metadata) == []
    engine.dispose()


@pytest.mark.unit
def test_an_acknowledged_write_is_on_the_disk(lite: Store) -> None:
    with lite.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1


@pytest.mark.unit
def test_other_processes_writes_are_seen(url: str) -> None:
    with Store(url) as one, Store(url) as other:
        before = one.changed()
        give(other, characterization())
        assert one.changed() != before
        assert one.version() == other.version()
        assert give(one, characterization(clock=clock(50.0)), BOB)["source_id"] == "1"


@pytest.mark.unit
def test_a_failed_write_takes_no_other_with_it(lite: Store) -> None:
    gate = threading.Event()
    writer = Writer(lite.engine)

    def wait(session: Session) -> str:
        assert gate.wait(30.0)
        return "waited"

    def note(session: Session) -> str:
        session.add(schema.Audit(at_us=1, actor="a", address="", action="x", target="", outcome=""))
        return "noted"

    def own_fault(session: Session) -> str:
        session.add(schema.Audit(at_us=2, actor="b", address="", action="x", target="", outcome=""))
        session.flush()
        raise KeyError("mine")

    def broken(session: Session) -> str:
        session.execute(sqlalchemy.text("INSERT INTO meta VALUES ('version', 1)"))  # it has one
        return "never"

    first = writer.submit(wait)
    rest = [writer.submit(job) for job in (note, own_fault, broken, note)]
    gate.set()
    assert first.result(30.0) == "waited"
    assert rest[0].result(30.0) == rest[3].result(30.0) == "noted"
    with pytest.raises(KeyError, match="mine"):
        rest[1].result(30.0)
    with pytest.raises(DatabaseUnavailableError, match="did not take"):
        rest[2].result(30.0)
    writer.close()
    assert [line["actor"] for line in lite.audit()] == ["a", "a"]
    with pytest.raises(BusyError, match="closed"):
        writer.submit(note)


@pytest.mark.unit
def test_a_write_taken_back_leaves_no_numbers(lite: Store) -> None:
    """The row's id is given again, to the contribution of somebody else about something else."""

    def full(connection: sqlalchemy.Connection) -> None:
        raise sqlalchemy.exc.OperationalError("COMMIT", {}, sqlite3.OperationalError("database or disk is full"))

    sqlalchemy.event.listen(lite.engine, "commit", full)
    with pytest.raises(DatabaseUnavailableError):
        give(lite, characterization("lost", position=position(-30.0, 150.0)), ANN)
    sqlalchemy.event.remove(lite.engine, "commit", full)
    kept = characterization("kept", position=position(60.0, 24.0))
    assert give(lite, kept, BOB)["id"] == "1"
    assert np.allclose(place_of(lite, "1"), kept["position"]["p_e_m"], atol=1e-6)


@pytest.mark.unit
def test_a_job_taken_back_is_told(lite: Store) -> None:
    told: list[str] = []
    writer = Writer(lite.engine, undone=lambda: told.append("undone"))

    def own_fault(session: Session) -> None:
        raise KeyError("mine")

    writer.submit(lambda session: None).result(30.0)
    assert told == []
    with pytest.raises(KeyError):
        writer.submit(own_fault).result(30.0)
    writer.close()
    assert told == ["undone"]


@pytest.mark.unit
def test_a_locked_database_is_waited_for_once_a_batch(lite: Store) -> None:
    gate, begun, tries = threading.Event(), threading.Event(), []
    writer = Writer(lite.engine)

    def wait(session: Session) -> bool:
        begun.set()
        return gate.wait(30.0)

    first = writer.submit(wait)
    assert begun.wait(30.0)  # its own transaction has begun

    def begin(connection: sqlalchemy.Connection) -> None:
        tries.append(1)
        raise sqlalchemy.exc.OperationalError("BEGIN", {}, sqlite3.OperationalError("database is locked"))

    rest = [writer.submit(lambda session: "never") for _ in range(5)]
    sqlalchemy.event.listen(lite.engine, "begin", begin)
    gate.set()
    assert first.result(30.0)
    for one in rest:
        with pytest.raises(DatabaseUnavailableError, match="did not take"):
            one.result(30.0)
    sqlalchemy.event.remove(lite.engine, "begin", begin)
    writer.close()
    assert len(tries) == 1


@pytest.mark.unit
def test_reads_that_fail_say_that_the_database_does_not_answer(lite: Store) -> None:
    give(lite, characterization())
    assert lite._watch is not None
    lite._watch.close()
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        lite.changed()
    with lite.engine.execution_options(writes=True).begin() as connection:
        connection.execute(sqlalchemy.text("DROP TABLE verdicts"))
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        lite.accepted(1)


@pytest.mark.unit
def test_a_clock_that_went_back_makes_nothing_unreadable(lite: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    give(lite, characterization(clock=clock(-20.0)))
    monkeypatch.setattr(records, "MAX_SKEW_S", -3600.0)  # as if this computer's clock were an hour behind
    with pytest.raises(ValueError, match="in the future expected"):
        Characterization.model_validate(characterization())
    lite._entries.clear()
    assert len(lite.accepted(1)) == 1
    assert give(lite, characterization(clock=clock(7200.0)), BOB)["source_id"] == "1"


@pytest.mark.unit
def test_a_full_queue_refuses(lite: Store) -> None:
    gate = threading.Event()
    writer = Writer(lite.engine, waiting=2)
    held = writer.submit(lambda session: gate.wait(30.0))
    while not held.running():
        threading.Event().wait(0.001)
    for _ in range(2):
        writer.submit(lambda session: None)
    with pytest.raises(BusyError, match="too many"):
        writer.submit(lambda session: None)
    gate.set()
    writer.close()
    assert held.result(1.0)


@pytest.mark.unit
def test_backup_is_a_database(lite: Store, tmp_path: Path) -> None:
    give(lite, characterization())
    lite.backup(tmp_path / "copy.db")
    with Store(str(tmp_path / "copy.db")) as copy:
        assert copy.counts() == lite.counts()
    with pytest.raises(ValueError, match="exists"):
        lite.backup(tmp_path / "copy.db")


@pytest.mark.unit
def test_satellites_have_no_place(lite: Store) -> None:
    answer = give(lite, characterization("G01", "gps", carrier_hz=1575.42e6, position=None, noise=noise()))
    assert answer["status"] == "accepted"
    assert names(lite, Search(near_deg=(0.0, 0.0), radius_m=2e7)) == []
    assert names(lite, Search()) == ["G01"]
