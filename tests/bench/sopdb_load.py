"""Load on the signal database: wrk reads from `soopnav sopdb`'s service, then from a plain one beside it.

    python tests/bench/sopdb_load.py [--sources 1000] [--seconds 10] [--database URL] [--json]

Two loads on each: about 300 requests a second, and as many as it takes. The plain service is what FastAPI and
SQLAlchemy give when nothing is prepared: the same database, the same fusion's states brought up to date for each
request, the objects of the mapper, FastAPI's own encoding, no tokens and no limits. Needs wrk (Debian package wrk).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "python" / "support"))

CONNECTIONS = 32
DELAY_MS = 104.0  # 32 connections / 104 ms: about 300 a second
BAR_MS = 50.0


def seed(url: str, count: int) -> str:
    """Fill a database; a token that may read."""
    import numpy as np
    from sopdb_server import body

    from soopnav_cpp.sopdb.contributing import Contributor
    from soopnav_cpp.sopdb.records import Characterization
    from soopnav_cpp.sopdb.store import Store

    rng = np.random.default_rng(1)
    with Store(url) as store:
        futures = []
        for i in range(count):
            for receiver in range(1 + i % 3):
                one = body(f"cell {i}", carrier_hz=860e6 + 30e3 * (i % 800), age_s=3600.0 * (1 + receiver),
                           place_deg=(60.0 + rng.random(), 24.0 + 2.0 * rng.random()))  # fmt: skip
                who = Contributor(f"receiver-{receiver}")
                futures.append(store.contribute(Characterization.model_validate(one), who))
            if len(futures) > 500:
                for future in futures:
                    future.result()
                futures.clear()
        for future in futures:
            future.result()
        return store.create_token("load", "read").text


def ours(url: str, port: int) -> None:
    """The service as `soopnav sopdb serve` runs it, its limits out of the way of a single client's load."""
    from soopnav_cpp.sopdb import server
    from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
    from soopnav_cpp.sopdb.store import Store

    free = Rate(1e6, 1e6)
    with Store(url) as store:
        settings = ServiceSettings(reads=free, addresses=free)
        server.serve(store, settings, at=server.listen(port=port), log_level="warning")


def plain(url: str) -> Any:
    """FastAPI and SQLAlchemy with nothing prepared."""
    import fastapi
    from sqlalchemy import select
    from sqlalchemy.orm import Session

    from soopnav_cpp.sopdb import database, spatial
    from soopnav_cpp.sopdb.fusion import SourceState
    from soopnav_cpp.sopdb.records import utc
    from soopnav_cpp.sopdb.schema import Fused, Source

    engine = database.open_engine(url)
    app = fastapi.FastAPI()

    def answered(source: Source, fused: Fused, at: datetime) -> dict[str, Any]:
        state = SourceState.from_json(json.loads(fused.state)["state"])
        named = {"id": str(source.id), "kind": source.kind, "name": source.name, "carrier_hz": source.carrier_hz}
        return named | state.moved(max(at, state.at)).answer()

    @app.get("/v1/sources")
    def sources(near: str | None = None, radius_m: float = 0.0, limit: int = 50) -> dict[str, Any]:
        query = select(Source, Fused).join(Fused, Fused.source_id == Source.id).order_by(Source.id)
        if near is not None:
            latitude, longitude = map(float, near.split(","))
            query = query.where(spatial.within(spatial.around(latitude, longitude, radius_m)))
        now = datetime.now(timezone.utc)
        with Session(engine) as session:
            return {"sources": [answered(*row, now) for row in session.execute(query.limit(limit)).all()]}

    @app.get("/v1/sources/{source_id}")
    def one(source_id: int, at: str | None = None) -> dict[str, Any]:
        with Session(engine) as session:
            source, fused = session.get_one(Source, source_id), session.get_one(Fused, source_id)
            return answered(source, fused, datetime.now(timezone.utc) if at is None else utc(at))

    return app


def serve(which: str, url: str, port: int) -> None:
    if which == "ours":
        ours(url, port)
        return
    import uvicorn

    uvicorn.run(plain(url), host="127.0.0.1", port=port, log_level="warning", access_log=False)


@contextmanager
def running(which: str, url: str, token: str) -> Iterator[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, __file__, "--serve", which, "--database", url, "--port", str(port)]
    process = subprocess.Popen(command, env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
    try:
        base = f"http://127.0.0.1:{port}"
        request = urllib.request.Request(f"{base}/v1/sources?limit=1", headers={"Authorization": f"Bearer {token}"})
        for _ in range(300):
            try:
                with urllib.request.urlopen(request, timeout=5.0):
                    break
            except OSError:
                if process.poll() is not None:
                    raise SystemExit(f"the service {which} ended with {process.returncode}") from None
                time.sleep(0.1)
        yield base
    finally:
        process.terminate()
        process.wait(timeout=30)


def load(base: str, ids: Path, token: str, seconds: float, delay_ms: float) -> dict[str, Any]:
    command = ["wrk", "-t", "1", "-c", str(CONNECTIONS), "-d", f"{seconds:g}s", "--timeout", "10s",
               "-s", str(HERE / "sopdb_load.lua"), base, "--", str(ids), f"{delay_ms:g}", token, "7"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    found["per_s"] = found["requests"] / found["seconds"]
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sources", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--database", metavar="URL", help="an empty one; SQLite in a temporary folder without it")
    parser.add_argument("--json", action="store_true", help="a line for each row, and nothing else")
    parser.add_argument("--serve", choices=["ours", "plain"], help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve(given.serve, given.database, given.port)
        return 0
    if shutil.which("wrk") is None:
        print("wrk is not installed (Debian: apt install wrk)", file=sys.stderr)
        return 2
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        url = given.database or f"sqlite:///{folder}/load.sqlite"
        token = seed(url, given.sources)
        ids = Path(folder, "ids")
        ids.write_text("".join(f"{k + 1}\n" for k in range(given.sources)))
        for which in ("ours", "plain"):
            with running(which, url, token) as base:
                load(base, ids, token, 2.0, DELAY_MS)  # what is made at the first request is not the load's
                for name, delay_ms in (("300/s", DELAY_MS), ("saturated", 0.0)):
                    rows.append({"service": which, "load": name} | load(base, ids, token, given.seconds, delay_ms))
    for row in rows:
        if given.json:
            print(json.dumps(row))
        else:
            print(
                "{service:6} {load:10} {per_s:7.0f} requests/s   p50 {p50_ms:7.2f} ms   p90 {p90_ms:7.2f} ms   "
                "p99 {p99_ms:7.2f} ms   max {max_ms:7.1f} ms   refused {refused}   errors {errors}".format(**row)
            )
    bad = [row for row in rows if row["service"] == "ours" and (row["refused"] or row["errors"])]
    slow = rows[0]["p99_ms"] >= BAR_MS
    if bad or slow:
        print("refused or failed requests" if bad else f"p99 above {BAR_MS:g} ms at 300/s", file=sys.stderr)
    return 1 if bad or slow else 0


if __name__ == "__main__":
    sys.exit(main())
