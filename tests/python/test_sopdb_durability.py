"""The signal database under contributors while its process is killed: what was acknowledged is there, once."""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
import httpx
import postgresql
from sopdb_bodies import characterization, clock

from soopnav_cpp.sopdb.store import Store

# What `soopnav sopdb serve` does, without the command's own options.
SERVER = """
import sys
from soopnav_cpp.sopdb.server import listen, serve
from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
from soopnav_cpp.sopdb.store import Store
plenty = Rate(1e6, 1e6)
settings = ServiceSettings(reads=plenty, writes=plenty, addresses=plenty, failures=plenty)
with Store(sys.argv[1]) as store:
    serve(store, settings, at=listen(port=int(sys.argv[2])), log_level="info", ready=lambda url: print(url, flush=True))
print("ended", flush=True)
"""


class Service:
    """The service in a process of its own."""

    def __init__(self, url: str, folder: Path, port: int = 0) -> None:
        self.log = folder / "service.log"
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER, url, str(port)],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=environment,
            )
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        if not self.address:
            self.process.wait()
            raise RuntimeError(self.log.read_text())
        self.port = int(self.address.rsplit(":", 1)[1])

    def end(self, how: signal.Signals) -> str:
        """Send a signal; what the process still printed."""
        self.process.send_signal(how)
        printed, _ = self.process.communicate(timeout=60.0)
        return printed


@pytest.fixture
def services() -> Iterator[list[Service]]:
    started: list[Service] = []
    yield started
    for service in started:
        if service.process.poll() is None:
            service.end(signal.SIGKILL)


def _body(writer: int, k: int) -> dict[str, Any]:
    """One that no other writer sends: its offset says whose it is."""
    return characterization(f"tower {writer % 20}", clock=clock(3600.0 - k, bias_s=1e-6 + 1e-13 * (1000 * writer + k)))


async def _contribute(address: str, token: str, writer: int, count: int, acknowledged: dict[str, str]) -> None:
    """Contributions one after the other, each tried again with its key until it is acknowledged."""
    pause = random.Random(writer)
    headers = {"Authorization": f"Bearer {token}"}
    async with httpx.AsyncClient(base_url=address, headers=headers, timeout=60.0) as http:
        for k in range(count):
            key, body = f"{writer}-{k}", _body(writer, k)
            while True:
                try:
                    answer = await http.post("/v1/characterizations", json=body, headers={"Idempotency-Key": key})
                except httpx.TransportError:
                    await asyncio.sleep(0.02 + 0.1 * pause.random())
                    continue
                if answer.status_code == 201:
                    assert acknowledged.setdefault(key, answer.json()["id"]) == answer.json()["id"]
                    break
                assert answer.status_code == 503, answer.text
                await asyncio.sleep(float(answer.headers["retry-after"]))


def _run(url: str, folder: Path, services: list[Service], writers: int, each: int, kills: int) -> None:
    with Store(url) as store:
        tokens = [store.create_token(f"writer {w}", "contribute").text for w in range(writers)]
    services.append(Service(url, folder))
    port = services[0].port
    acknowledged: dict[str, str] = {}

    async def everything() -> None:
        tasks = [
            asyncio.create_task(_contribute(services[0].address, token, w, each, acknowledged))
            for w, token in enumerate(tokens)
        ]
        for kill in range(kills):
            while len(acknowledged) < writers * each * (kill + 1) / (kills + 1):
                assert not any(task.done() and task.exception() for task in tasks)
                await asyncio.sleep(0.002)
            before = len(acknowledged)
            services[-1].end(signal.SIGKILL)  # in the middle of it
            assert before < writers * each
            services.append(await asyncio.to_thread(Service, url, folder, port))
        await asyncio.gather(*tasks)

    asyncio.run(everything())
    httpx.get(
        f"{services[-1].address}/v1/sources?token={tokens[0]}",
        headers={"Authorization": f"Bearer {tokens[0]}"},
        timeout=60.0,
    )
    assert services[-1].end(signal.SIGTERM) == "ended\n"
    assert services[-1].process.returncode == 0
    log = services[-1].log.read_text()
    assert "Traceback" not in log
    assert "POST /v1/characterizations" in log
    assert tokens[0][:14] in log
    assert tokens[0][15:] not in log
    if url.startswith("sqlite"):  # closed in good order: the file is whole by itself
        assert not (folder / "signals.db-wal").exists()

    with Store(url) as store:
        rows = store.contributions(limit=10 * writers * each)
        # Exactly once: as many rows as keys, each acknowledged id with the body that was sent under its key.
        assert len(acknowledged) == writers * each
        offsets = {row["id"]: json.loads(row["body"])["clock"]["bias_s"] for row in rows}
        assert Counter(offsets.values()) == Counter(
            _body(w, k)["clock"]["bias_s"] for w in range(writers) for k in range(each)
        )
        for key, contribution in acknowledged.items():
            writer, _, k = key.partition("-")
            assert offsets[int(contribution)] == _body(int(writer), int(k))["clock"]["bias_s"]
        # A contribution, its verdict, its line of audit and its source came together.
        counts = store.counts()
        assert counts == {"sources": min(writers, 20), "contributions": writers * each}
        made = [line for line in store.audit(limit=100 * writers * each) if line["action"] == "contribute"]
        assert {line["target"] for line in made} == {f"contribution {one}" for one in offsets}
        assert len(made) == len(offsets)
        accepted = Counter(row["source_id"] for row in rows if row["status"] == "accepted")
        for source_id, row in store.source_rows(list(accepted)).items():
            assert json.loads(row.state)["contributions"] == accepted[source_id]


@pytest.mark.unit
def test_killed_amid_contributors(tmp_path: Path, services: list[Service]) -> None:
    _run(f"sqlite:///{tmp_path / 'signals.db'}", tmp_path, services, writers=12, each=4, kills=1)


@pytest.mark.slow
@pytest.mark.unit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_killed_amid_two_hundred_contributors(tmp_path: Path, services: list[Service], seed: int) -> None:
    _run(f"sqlite:///{tmp_path / 'signals.db'}", tmp_path, services, writers=200, each=4, kills=seed)


@pytest.mark.slow
@pytest.mark.unit
def test_killed_amid_contributors_on_postgresql(tmp_path: Path, services: list[Service]) -> None:
    _run(postgresql.shared().new_database(), tmp_path, services, writers=40, each=5, kills=2)
