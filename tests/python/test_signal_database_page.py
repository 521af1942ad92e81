"""docs/signal_database.md: every command runs and prints what it says, its tables are those of the code."""

# ruff: noqa: E402

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))

for _module in ("sqlalchemy", "alembic", "fastapi", "uvicorn", "httpx"):
    pytest.importorskip(_module)

import httpx
import postgresql
from click.testing import CliRunner
from sopdb_server import body
from sopdb_server import serving as running

from soopnav_cpp.cli.app import cli
from soopnav_cpp.sopdb.service import create_app
from soopnav_cpp.sopdb.settings import ServiceSettings
from soopnav_cpp.sopdb.store import Store

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/signal_database.md").read_text(encoding="utf-8")
URL = "postgresql://sopdb@db.example/signals"

pytestmark = pytest.mark.example


def blocks(language: str, text: str = PAGE) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def section(title: str) -> str:
    (found,) = re.findall(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def commands(title: str) -> list[tuple[str, str]]:
    """Each command of a section with the output that the page shows for it."""
    out: list[tuple[str, str]] = []
    for block in blocks("console", section(title)):
        for line in block.splitlines():
            if line.startswith("$ "):
                out.append((line[2:], ""))
            else:
                out[-1] = (out[-1][0], out[-1][1] + line + "\n")
    return out


@contextmanager
def serving(command: str, folder: Path) -> Iterator[str]:
    """`soopnav sopdb serve ...` as a process, at a free port unless at a socket; where it answers."""
    words = shlex.split(command)[1:] + ([] if "--unix" in command else ["--port", "0"])
    program = "import sys; from soopnav_cpp.cli import main; sys.exit(main())"
    process = subprocess.Popen([sys.executable, "-c", program, *words], cwd=folder, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("answering at "):
                yield line.removeprefix("answering at ").strip()
                break
        else:
            raise AssertionError(f"{command} ended with {process.wait()}")
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
    assert process.returncode in (0, -signal.SIGTERM)


def run(command: str, said: str = "", code: int = 0) -> str:
    """A soopnav command in this process; `> FILE` at its end is the shell's."""
    words = shlex.split(os.path.expandvars(command))
    assert words[0] == "soopnav", command
    into = None
    if ">" in words:
        words, into = words[: words.index(">")], words[-1]
    result = CliRunner().invoke(cli, words[1:])
    assert result.exit_code == code, f"{command}: {result.output}"
    assert said in result.output
    if into is not None:
        Path(into).write_text(result.stdout, encoding="utf-8")
    return result.output


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("SOOPNAV_SOPDB_URL", "SOOPNAV_SOPDB_TOKEN", "SOOPNAV_SOPDB_DB"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("json", section("Five minutes"))
    (tmp_path / "tower.json").write_text(example, encoding="utf-8")
    return tmp_path


def test_every_command_is_run_by_a_test_here() -> None:
    known = {
        "Five minutes": 10,
        "Who may do what": 4,
        "What is believed": 2,
        "Over a network": 1,
        "Backup and restore": 3,
        "Moving to PostgreSQL": 3,
        "Without a network": 2,
    }
    assert {title: len(commands(title)) for title in known} == known
    assert sum(known.values()) == len(re.findall(r"^\$ ", PAGE, re.MULTILINE))
    extras = re.findall(r"pip install 'soopnav\[([\w,]+)\]'", PAGE)
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert [name for name in ",".join(extras).split(",") if f"\n{name} = [" not in project] == []


def test_five_minutes_then_without_a_network(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, (create, _), (serve, answering), (export, _), *rest = commands("Five minutes")
    run(create)
    assert export == "export SOOPNAV_SOPDB_TOKEN=$(cat token)"
    monkeypatch.setenv("SOOPNAV_SOPDB_TOKEN", (folder / "token").read_text().strip())
    assert answering.strip() == "answering at http://127.0.0.1:8765"
    with serving(serve, folder) as url:
        monkeypatch.setenv("SOOPNAV_SOPDB_URL", url)
        shown = [run(command, said) for command, said in rest]
        assert "Signal database" in httpx.get(url).text
        # What is said of hostile words is said as the page promises.
        refused = httpx.post(f"{url}/v1/characterizations", json={"source": 1}, headers={
            "Authorization": f"Bearer {os.environ['SOOPNAV_SOPDB_TOKEN']}"})  # fmt: skip
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["field"].startswith("source")
    assert "PN 168" in shown[2]
    assert "881.52" in shown[3]
    assert "2026-03-01T18:00:00" in shown[4]
    fallback = run("soopnav sopdb show")
    assert "does not answer" in fallback
    (pull, _), (show, _) = commands("Without a network")
    assert pull.split()[1:3] == ["sopdb", "pull"]
    assert "PN 168" in run(show)
    (snippet,) = blocks("python", section("Without a network"))
    names: list[Any] = []
    exec(compile(snippet, "docs/signal_database.md", "exec"), {"print": lambda *words: names.append(words)})
    assert [words[0] for words in names] == ["PN 168"]


def test_tokens_quarantine_and_backup(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (read, _), (admin, _), (listing, _), (revoke, _) = commands("Who may do what")
    made = run(read)
    monkeypatch.setenv("ADMIN", run(admin).strip().splitlines()[-1])
    assert "phone" in run(listing)
    run(revoke.replace("ID", made.strip().splitlines()[-1].split("_")[1]), "ended")
    with Store("sopdb.sqlite3") as store, running(create_app(store)) as url:
        monkeypatch.setenv("SERVER", url)
        monkeypatch.setenv("SOOPNAV_SOPDB_URL", url)
        monkeypatch.setenv("SOOPNAV_SOPDB_TOKEN", os.environ["ADMIN"])
        for k, bias_s in enumerate((1e-7, 0.5)):
            (folder / f"{k}.json").write_text(json.dumps(body("T", bias_s=bias_s)), encoding="utf-8")
            run(f"soopnav sopdb push {k}.json", code=k)
        answers = []
        for command, _ in commands("What is believed"):
            words = shlex.split(os.path.expandvars(command))
            assert words[:2] == ["curl", "-H"]
            name, _, value = words[2].partition(": ")
            answers.append(httpx.request("POST" if "-X" in words else "GET", words[-1], headers={name: value}).json())
        assert [one["id"] for one in answers[0]["contributions"]] == ["2"]
        assert answers[1]["status"] == "accepted"
        (backup, _), *_ = commands("Backup and restore")
        run(backup)
    out = backup.split()[-1]
    with Store(f"sqlite:///{folder / out}") as store:
        assert store.counts() == {"sources": 1, "contributions": 2}
        assert len(store.tokens()) == 2


@pytest.mark.slow
def test_behind_a_proxy(folder: Path) -> None:
    ((serve, _),) = commands("Over a network")
    here = serve.replace("/var/lib/sopdb", str(folder)).replace("/run/sopdb", str(folder))
    assert here.count(str(folder)) == 2
    with serving(here, folder) as where:
        assert where == f"unix:{folder}/sopdb.sock"
        with httpx.Client(transport=httpx.HTTPTransport(uds=f"{folder}/sopdb.sock"), base_url="http://x") as client:
            answer = client.get("/health", headers={"X-Forwarded-For": "203.0.113.9"})
            assert answer.json()["status"] == "ok"
            assert "strict-transport-security" in answer.headers
            assert client.get("/v1/sources").status_code == 401


@pytest.mark.slow
def test_moving_to_postgresql(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, (copy, _), (serve, _) = commands("Moving to PostgreSQL")
    _, *dumps = commands("Backup and restore")
    token = run("soopnav sopdb token create roof --role contribute").strip().splitlines()[-1]
    server = postgresql.shared()
    url = server.new_database()
    assert URL in copy
    assert URL in serve
    assert "tokens         1" in run(copy.replace(URL, url))
    with serving(serve.replace(URL, url), folder) as where:
        answer = httpx.post(
            f"{where}/v1/characterizations", json=body("T"), headers={"Authorization": f"Bearer {token}"}
        )
        assert answer.json()["status"] == "accepted"
    if shutil.which("pg_dump") is None or shutil.which("pg_restore") is None:
        pytest.skip("pg_dump and pg_restore are not installed")
    monkeypatch.setenv("POSTGRESQL", url)
    monkeypatch.setenv("OTHER", server.new_database())
    for command, _ in dumps:
        subprocess.run(shlex.split(os.path.expandvars(command)), check=True)
    with Store(os.environ["OTHER"]) as store:
        assert store.counts() == {"sources": 1, "contributions": 1}


def test_the_interface_is_that_of_the_service(tmp_path: Path) -> None:
    rows = re.findall(r"^\| `([A-Z]+) (/[^`]*)` \| .*? \| (\w*) ?\|$", section("The interface"), re.MULTILINE)
    with Store(f"sqlite:///{tmp_path}/x.db") as store:
        app = create_app(store, ServiceSettings())
        described = {(method.upper(), path) for path, one in app.openapi()["paths"].items() for method in one}
        assert {(method, path) for method, path, _ in rows} == described
        (parameters,) = re.findall(r"a page of sources: (.*?) \|", section("The interface"))
        names = {one["name"] for one in app.openapi()["paths"]["/v1/sources"]["get"]["parameters"]}
        assert set(re.findall(r"`([a-z_]+)", parameters)) == names
        tokens = {role: store.create_token(role, role).text for role in ("read", "contribute", "admin")}
        with running(app) as url, httpx.Client(base_url=url) as client:
            for method, path, role in rows:
                for index, (held, token) in enumerate(tokens.items()):
                    answer = client.request(
                        method, path.replace("{id}", "7"), headers={"Authorization": f"Bearer {token}"}
                    )
                    allowed = role == "" or index >= list(tokens).index(role)
                    assert (answer.status_code != 403) is allowed, (method, path, held)
                assert client.request(method, path.replace("{id}", "7")).status_code == (401 if role else 200)


def test_limits_are_those_of_the_settings() -> None:
    settings = ServiceSettings()
    table = section("Over a network")
    for name, rate in (("reads of a token", settings.reads), ("everything from one address", settings.addresses)):
        assert re.search(rf"^\| {name}.*\| {rate.per_s:g} a second, {rate.burst:g} at once", table, re.MULTILINE)
    assert f"{settings.writes.per_s:g} a second, {settings.writes.burst:g} at once" in table
    assert f"1 in {1 / settings.failures.per_s:g} seconds, {settings.failures.burst:g} at once" in table
    size = f"{settings.max_body_bytes:,}".replace(",", " ")
    assert f"{size} bytes, {settings.max_depth} levels of nesting, {settings.body_timeout_s:g} s" in table
    assert "within a week" in section("When things fail")
    assert settings.idempotency_s == 7 * 86400.0


def test_links_exist() -> None:
    links = [link for link in re.findall(r"\]\(([^)#:]+)\)", PAGE) if link != "opportunistic_navigation.md"]
    assert len(links) >= 2
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []
    for name in ("cpp/doc/signal_database.md", "examples/catalog.cpp"):
        assert name in PAGE
        assert (ROOT / name).exists()
