"""Moving a signal database: SQLite to PostgreSQL and back, backup and restore, and that both answer alike."""

# ruff: noqa: E402

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))

for _module in ("sqlalchemy", "alembic", "fastapi", "uvicorn", "httpx"):
    pytest.importorskip(_module)

import httpx
import postgresql
from click.testing import CliRunner
from sopdb_server import Running, body, database

from soopnav_cpp.cli.app import cli
from soopnav_cpp.sopdb import copying
from soopnav_cpp.sopdb import database as engines
from soopnav_cpp.sopdb.contributing import Contributor
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.records import Characterization
from soopnav_cpp.sopdb.store import Store

pytestmark = pytest.mark.law

LATER = (datetime.now(timezone.utc) + timedelta(days=2)).strftime("%Y-%m-%dT%H:%M:%SZ")
EPOCH = datetime.now(timezone.utc)
HTTP = httpx.Client(verify=False)  # certificates are read once, not for each request


@pytest.fixture(scope="module", autouse=True)
def _closed() -> Iterator[None]:
    yield
    HTTP.close()


@pytest.fixture
def server() -> postgresql.Server:
    return postgresql.shared()


def ask(running: Running, path: str, role: str = "admin", **parameters: Any) -> Any:
    answer = HTTP.get(
        running.url + path, params=parameters, headers={"Authorization": f"Bearer {running.tokens[role]}"}
    )
    assert answer.status_code == 200, answer.text
    return answer.json()


def send(running: Running, one: Any, key: str | None = None, token: str | None = None) -> httpx.Response:
    headers = {"Authorization": f"Bearer {token or running.tokens['contribute']}"}
    if key is not None:
        headers["Idempotency-Key"] = key
    return HTTP.post(f"{running.url}/v1/characterizations", json=one, headers=headers)


def bodies() -> list[dict[str, Any]]:
    """Sources of several kinds, a second voice, a liar, one without a place, hostile and long names."""
    return [
        body("Tower 1", at=EPOCH),
        body("Tower 1", at=EPOCH, receiver="car", age_s=30.0, bias_s=1.2e-6 + 1e-9),
        body("Tower 1", at=EPOCH, receiver="liar", age_s=20.0, bias_s=0.3),
        body("PRN 7", "gps", carrier_hz=1575.42e6, place_deg=None, at=EPOCH),
        body("'; DROP TABLE sources; -- \u00e9\U0001f4e1", "fm", carrier_hz=98e6, place_deg=(-33.9, 179.999), at=EPOCH),
        body("n" * 100, "lte", carrier_hz=1.8e9, place_deg=(89.999, 12.0), at=EPOCH, noise=None),
    ]


def everything(running: Running) -> dict[str, Any]:
    """All that readers and administrators are told, but for what names this service's own start."""
    found: dict[str, Any] = {"sources": ask(running, "/v1/sources", at=LATER, limit=500)}
    for source in found["sources"]["sources"]:
        path = f"/v1/sources/{source['id']}"
        found[path] = ask(running, path, at=LATER)
        found[path + "c"] = ask(running, f"{path}/contributions")
        if source["noise"]:
            found[path + "s"] = ask(running, f"{path}/stability", at=LATER)
    found["all"] = ask(running, "/v1/characterizations", limit=500)
    found["near"] = ask(running, "/v1/sources", near="-33.9,-179.999", radius_m=1000, at=LATER)
    found["box"] = ask(running, "/v1/sources", bbox="-180,-90,180,90", at=LATER)
    found["name"] = ask(running, "/v1/sources", name="drop table", at=LATER)
    for odd, status in (("\0", 422), ("a\nb", 422), ("%", 200), ("_\\/'", 200), ("\u00e9\U0001f6f0", 200)):
        answer = HTTP.get(
            f"{running.url}/v1/sources",
            params={"name": odd},
            headers={"Authorization": f"Bearer {running.tokens['read']}"},
        )
        assert answer.status_code == status, odd
        assert status == 422 or answer.json()["sources"] == []
    return found


def test_both_databases_answer_alike(server: postgresql.Server, tmp_path: Path) -> None:
    def told(url: str | None) -> Any:
        with database(tmp_path, url) as running:
            receipts = [send(running, one).json() for one in bodies()]
            # Who contributed is a token of its own in each, when it came the computer's clock.
            return receipts, without(everything(running), "contributor", "received")

    on_sqlite, on_postgresql = told(None), told(server.new_database())
    assert on_sqlite[0] == on_postgresql[0]
    assert [one["status"] for one in on_sqlite[0]] == ["accepted"] * 2 + ["quarantined"] + ["accepted"] * 3
    assert on_sqlite[1] == on_postgresql[1]
    assert [one["name"][:3] for one in on_sqlite[1]["near"]["sources"]] == ["'; "]
    assert [one["name"][:3] for one in on_sqlite[1]["name"]["sources"]] == ["'; "]
    assert len(on_sqlite[1]["box"]["sources"]) == 3


def without(value: Any, *names: str) -> Any:
    if isinstance(value, dict):
        return {key: without(inner, *names) for key, inner in value.items() if key not in names}
    return [without(inner, *names) for inner in value] if isinstance(value, list) else value


def test_copied_to_postgresql_and_back_nothing_is_lost(server: postgresql.Server, tmp_path: Path) -> None:
    source, between, target = f"sqlite:///{tmp_path / 'a.db'}", server.new_database(), f"sqlite:///{tmp_path / 'b.db'}"
    with database(tmp_path, source) as running:
        for one in bodies():
            send(running, one)
        retried = body("Tower 9", carrier_hz=870e6, at=EPOCH)
        receipt = send(running, retried, key="once").json()
        revoked = running.store.create_token("left", "admin")
        running.store.revoke_token(revoked.id)
        before = everything(running)
        trail = ask(running, "/v1/audit", limit=500)["entries"]
        tokens = running.tokens
        first = CliRunner().invoke(cli, ["sopdb", "copy", "--from", source, "--to", between])
        assert first.exit_code == 0, first.output
        assert "contributions  7" in first.output
    counts = copying.copy(between, target)
    assert counts["contributions"] == 7
    assert counts["tokens"] == 4
    for url in (between, target):
        with database(tmp_path, url) as running:
            running.tokens.update(tokens)  # the old ones hold
            assert everything(running) == before
            assert ask(running, "/v1/audit", limit=500)["entries"][-len(trail) :] == trail
            assert send(running, retried, token=revoked.text).status_code == 401
            again = send(running, retried, key="once")
            assert again.json() == receipt
            assert again.headers["Idempotency-Replayed"] == "true"
            # The next ids follow those that were copied.
            fresh = send(running, body("Tower 10", carrier_hz=871e6, at=EPOCH)).json()
            assert (fresh["id"], fresh["status"]) == ("8", "accepted")
            assert fresh["source_id"] not in [one["id"] for one in before["sources"]["sources"]]


def test_copies_that_are_refused(tmp_path: Path) -> None:
    there, used, empty = (f"sqlite:///{tmp_path / name}" for name in ("there.db", "used.db", "empty.db"))
    for url in (there, used):
        with Store(url) as store:
            store.create_token("a", "read")
    with pytest.raises(ValueError, match="is in use: it holds"):
        copying.copy(there, used)
    with pytest.raises(ValueError, match="the source itself"):
        copying.copy(there, there)
    with pytest.raises(ValueError, match="revision none"):
        copying.copy(f"sqlite:///{tmp_path / 'absent.db'}", empty)
    assert not (tmp_path / "absent.db").exists()
    assert not (tmp_path / "empty.db").exists()
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        copying.copy(there, f"postgresql://nobody@/none?host={tmp_path}")
    engine = engines.open_engine(used)
    engines.downgrade(engine, "0001")
    engine.dispose()
    with pytest.raises(ValueError, match="revision 0001"):
        copying.copy(used, empty)
    for arguments in (["--from", there, "--to", there], ["--from", there, "--to", "mysql://x/y"]):
        result = CliRunner().invoke(cli, ["sopdb", "copy", *arguments])
        assert result.exit_code == 2
        assert "Traceback" not in result.output
        assert "expected" in result.output


def test_a_copy_that_fails_leaves_an_empty_target(
    server: postgresql.Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = f"sqlite:///{tmp_path / 'a.db'}"
    with Store(source) as store:
        for k in range(3):
            store.contribute(Characterization.model_validate(body(f"T{k}", carrier_hz=1e8 + 1e6 * k)), Contributor("a"))
    for target in (server.new_database(), f"sqlite:///{tmp_path / 'b.db'}"):

        def fail(table: str, count: int) -> None:
            if table == "verdicts":
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            copying.copy(source, target, progress=fail)
        assert copying.copy(source, target)["verdicts"] == 3


def test_a_backup_while_it_is_written_to_is_whole(tmp_path: Path) -> None:
    """Every contribution acknowledged before the backup began is in it; it opens, and is consistent."""
    url, out = f"sqlite:///{tmp_path / 'live.db'}", tmp_path / "backup.db"
    stop = threading.Event()
    acknowledged: list[str] = []
    with Store(url) as store:

        def write() -> None:
            k = 0
            while not stop.is_set():
                one = body(f"T{k}", carrier_hz=1e8 + 1e6 * k)
                outcome = store.contribute(Characterization.model_validate(one), Contributor("a")).result()
                acknowledged.append(outcome.answer["id"])
                k += 1

        writing = threading.Thread(target=write)
        writing.start()
        while len(acknowledged) < 10:
            stop.wait(0.005)
        before = list(acknowledged)
        result = CliRunner().invoke(cli, ["sopdb", "backup", str(out), "--db", url])
        stop.set()
        writing.join()
        assert result.exit_code == 0, result.output
        again = CliRunner().invoke(cli, ["sopdb", "backup", str(out), "--db", url])
        assert again.exit_code == 2
        assert "exists" in again.output
    with sqlite3.connect(out) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
        ids = {str(row[0]) for row in connection.execute("SELECT id FROM contributions")}
        judged = {str(row[0]) for row in connection.execute("SELECT contribution_id FROM verdicts")}
    connection.close()
    assert set(before) <= ids == judged
    with database(tmp_path, f"sqlite:///{out}") as running:
        assert len(ask(running, "/v1/characterizations", limit=500)["contributions"]) == len(ids)
        assert send(running, body("After", carrier_hz=5e8)).status_code == 201


@pytest.mark.slow  # the default run restores by the commands of the page
def test_pg_dump_restores(server: postgresql.Server, tmp_path: Path) -> None:
    """The way to back up PostgreSQL that the page gives."""
    if shutil.which("pg_dump") is None or shutil.which("pg_restore") is None:
        pytest.skip("pg_dump and pg_restore are not installed")
    url, restored = server.new_database(), server.new_database()
    with database(tmp_path, url) as running:
        for one in bodies():
            send(running, one)
        before, tokens = everything(running), running.tokens
    subprocess.run(["pg_dump", "--format=custom", f"--file={tmp_path / 'out.dump'}", url], check=True)
    subprocess.run(["pg_restore", "--no-owner", f"--dbname={restored}", str(tmp_path / "out.dump")], check=True)
    with database(tmp_path, restored) as running:
        running.tokens.update(tokens)
        assert everything(running) == before
        assert send(running, body("After", carrier_hz=5e8)).status_code == 201
