"""`soopnav sopdb` as a person meets it: against the real service on a port, without a network, and its refusals."""

from __future__ import annotations

import copy
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

for _module in ("httpx", "fastapi", "uvicorn", "sqlalchemy", "alembic"):
    pytest.importorskip(_module)

sys.path.insert(0, str(Path(__file__).parent / "support"))
from sopdb_bodies import tower  # noqa: E402

from soopnav_cpp.cli.app import cli  # noqa: E402
from soopnav_cpp.experiments import pesyna_database  # noqa: E402
from soopnav_cpp.sopdb.client import Client, ServiceError  # noqa: E402

BODY = tower("2026-01-01T12:00:00Z")
AT = "2026-01-01T13:00:00Z"
NOWHERE = "http://127.0.0.1:9"


def run(*arguments: str, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, ["sopdb", *arguments])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result


@pytest.fixture(autouse=True)
def _at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SOOPNAV_SOPDB_URL", "SOOPNAV_SOPDB_TOKEN", "SOOPNAV_SOPDB_DB"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    with pesyna_database.service(tmp_path_factory.mktemp("db")) as found:
        yield found


def write(name: str, value: Any) -> str:
    Path(name).write_text(json.dumps(value), encoding="utf-8")
    return name


def test_push_show_pull_and_show_without_a_network(server: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    url, token = server
    monkeypatch.setenv("SOOPNAV_SOPDB_URL", url)
    monkeypatch.setenv("SOOPNAV_SOPDB_TOKEN", token)
    lie = copy.deepcopy(BODY)
    lie["clock"]["bias_s"] = 1e-3
    files = [write("tower.json", BODY), write("lie.json", [lie])]
    said = run("push", files[0]).output
    found = re.search(r"tower.json: cdma PN 168: accepted as contribution (\d+) to source (\d+)", said)
    assert found
    source = found[2]
    again = run("push", files[0]).output
    assert again == said  # the same record
    held = run("push", files[1], code=1).output
    assert "quarantined" in held
    assert "standard deviations from what others say" in held

    table = run("show", "--at", AT).output
    assert "PN 168" in table
    assert "881.520" in table
    assert "−260 ns" in table  # 100 ns less an hour of 1e-10
    detail = run("show", source, "--at", AT).output
    for text in ("place", "clock ahead", "drift", "Allan deviation  ", "within a factor", "1 contribution,", "grade"):
        assert text in detail
    online = json.loads(run("show", source, "--at", AT, "--json").output)
    assert [one["id"] for one in json.loads(run("show", "--near", "0,0", "--radius", "1000", "--json").output)] == [
        source
    ]
    assert run("show", "--near", "50,0", "--radius", "1000").output == "no sources\n"
    assert "not known" in run("show", "999999", code=2).output

    assert "signals.sopcat: 1 source of 20" in run("pull").output
    assert "as it was" in run("pull").output
    offline = json.loads(run("show", source, "--at", AT, "--json", "--snapshot", "signals.sopcat").output)
    assert offline["clock"]["bias_s"] == pytest.approx(online["clock"]["bias_s"], rel=1e-9)
    assert offline["clock"]["covariance"][0] == pytest.approx(online["clock"]["covariance"][0], rel=1e-6)
    fallen = run("show", "--at", AT, "--server", NOWHERE)
    assert "does not answer; this is signals.sopcat" in fallen.stderr
    assert "PN 168" in fallen.stdout
    assert "has no source x" in run("show", "x", "--snapshot", "signals.sopcat", code=2).output
    Path("signals.sopcat").write_bytes(b"SOPCAT")
    assert "signals.sopcat: snapshot: a header" in run("show", "--snapshot", "signals.sopcat", code=2).output


def test_refusals_are_sentences(server: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("soopnav_cpp.sopdb.client.time.sleep", lambda s: None)
    url, token = server
    good = write("tower.json", BODY)
    assert "asks for a token" in run("push", good, "--server", url, code=2).output
    forged = token[:-4] + "AAAA"
    said = run("push", good, "--server", url, "--token", forged, code=2).output
    assert "the token was refused" in said
    assert forged not in said
    assert "does not answer" in run("push", good, "--server", NOWHERE, code=2).output
    assert "without https anybody" in run("push", good, "--server", "http://sop.test", "--token", "x", code=2).output
    assert "does not answer" in run("show", "--server", NOWHERE, code=2).output
    assert "--at noon: a time of ISO 8601" in run("show", "--at", "noon", code=2).output
    assert "--radius" in run("show", "--near", "1,2", "--radius", "-1", code=2).output
    assert "LAT,LON in degrees" in run("show", "--near", "north", code=2).output
    assert "must be https" in run("pull", "--server", "elsewhere", code=2).output


def test_files_are_checked_before_anything_is_sent() -> None:
    bad = copy.deepcopy(BODY)
    bad["clock"]["drift"] = 5
    bad["noise"]["ln_covariance"] = [[1, 2], [2, 1]]
    name = write("bad.json", [BODY, bad])
    for arguments in (("push", name, "--server", NOWHERE), ("push", "--check", name)):
        said = run(*arguments, code=2).output
        assert "bad.json[1]: clock.drift: Input should be less than or equal to 0.01" in said
        assert "bad.json[1]: noise.ln_covariance: must be positive semi-definite" in said
    assert run("push", "--check", write("good.json", [BODY, BODY])).output == "2 characterisations: nothing wrong\n"
    Path("text.json").write_text("{\n no")
    assert "text.json:2: JSON expected" in run("push", "--check", "text.json", code=2).output
    Path("bytes.json").write_bytes(b"\xff\xfe")
    assert "bytes.json: text of UTF-8" in run("push", "--check", "bytes.json", code=2).output
    assert "at least one" in run("push", "--check", write("none.json", []), code=2).output
    assert "nested so deep" in run("push", "--check", write_text("deep.json", "[" * 100000), code=2).output
    assert "absent.json: no such file" in run("push", "--check", "absent.json", code=2).output


def write_text(name: str, text: str) -> str:
    Path(name).write_text(text)
    return name


def test_tokens_are_made_listed_and_ended() -> None:
    db = ("--db", "sqlite:///signals.sqlite3")
    made = run("token", "create", "Ålice", "--role", "contribute", "--days", "30", *db)
    token = made.stdout.strip()
    assert re.fullmatch(r"sop_[a-z2-7]{10}_\S{43}", token)
    assert re.search(r"for Ålice, role contribute, id \w+, until 20\d\d", made.stderr)
    run("token", "create", "root", "--role", "admin", *db)
    listed = run("token", "list", *db).output
    assert "Ålice" in listed
    assert "admin" in listed
    assert token.split("_", 2)[2] not in listed
    token_id = token.split("_")[1]
    assert run("token", "revoke", token_id, *db).output == f"{token_id}: ended\n"
    assert "ended 20" in run("token", "list", *db).output
    assert "no token" in run("token", "revoke", token_id, *db, code=2).output
    assert "printable" in run("token", "create", "a\nb", "--role", "read", *db, code=2).output
    assert "Missing option '--role'" in run("token", "create", "x", *db, code=2).output
    assert "sqlite or postgresql expected" in run("token", "list", "--db", "mysql://x/y", code=2).output

    assert re.search(r"copy.sqlite3: \d+\.\d MB", run("backup", "copy.sqlite3", *db).output)
    assert "Ålice" in run("token", "list", "--db", "sqlite:///copy.sqlite3").output
    assert "copy.sqlite3 exists" in run("backup", "copy.sqlite3", *db, code=2).output


def test_a_database_that_is_not_there_is_not_made() -> None:
    for arguments in (["backup", "out.db"], ["token", "list"], ["token", "revoke", "aaaaaaaaaa"]):
        for url in ("sqlite:///absent.db", "absent.db"):
            assert "absent.db: no such database" in run(*arguments, "--db", url, code=2).output
    assert list(Path().iterdir()) == []


def test_hostile_names_do_not_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    from soopnav_cpp.cli import sopdb

    source: dict[str, Any] = dict.fromkeys(("position", "clock", "noise"))
    quality = {"contributions": 1, "age_s": None, "grade": "D"}
    source |= {"id": "1", "kind": "fm", "name": "a\x1b[2J\x9bm\u00e9", "carrier_hz": 1e8, "quality": quality}
    sopdb._print_source(source)
    sopdb._print_table([source])
    out = capsys.readouterr().out
    assert "a\\u001b[2J\\u009bm\u00e9, 100" in out
    assert "\x1b[2J" not in out
    assert "\x9b" not in out


@pytest.mark.slow  # the commands of the page start, ask and end the same service
def test_serve_answers_until_it_is_told_to_end() -> None:
    command = [sys.executable, "-c", "from soopnav_cpp.cli import main; main()", "sopdb", "serve", "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines: list[str] = []
        try:
            for line in process.stderr:
                lines.append(line)
                if line.startswith("answering at "):
                    break
            assert lines[0].startswith("no tokens yet")
            assert lines[-1].startswith("answering at http://127.0.0.1:"), lines
            with Client(lines[-1].split()[-1]) as client:
                assert client.health()["status"] == "ok"
                with pytest.raises(ServiceError, match="asks for a token"):
                    list(client.sources())
        finally:
            process.send_signal(signal.SIGTERM)
            process.stderr.read()
            code = process.wait()
    assert code in (0, -signal.SIGTERM)
    assert Path("sopdb.sqlite3").exists()


def test_serve_says_what_it_cannot_do() -> None:
    assert "sqlite or postgresql expected" in run("serve", "--db", "mysql://x/y", code=2).output
    assert "an octal mode expected" in run("serve", "--unix", "x", "--unix-mode", "9", code=2).output
    assert "cannot assign" in run("serve", "--host", "203.0.113.1", "--port", "0", code=2).output
    assert "a new path expected" in run("serve", "--unix", write_text("file", ""), code=2).output
