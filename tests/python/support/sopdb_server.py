"""A signal database in a thread of the test: its URL, its store, tokens of every role, sources by the hundred."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

import soopnav_cpp as sn


def body(
    name: str,
    kind: str = "cdma",
    *,
    carrier_hz: float = 881.52e6,
    place_deg: tuple[float, float] | None = (60.17, 24.94),
    receiver: str = "roof",
    age_s: float = 60.0,
    bias_s: float = 1.2e-6,
    noise: tuple[float, float] | None = (1e-23, 1e-25),
    clock: bool = True,
    independent: bool = True,
    at: datetime | None = None,
) -> dict[str, Any]:
    """A characterisation that the service believes."""
    position = None
    if place_deg is not None:
        latitude, longitude = np.radians(place_deg)
        p_e_m = sn.geometry.geodetic_to_ecef(latitude, longitude, 35.0)
        position = {"p_e_m": np.asarray(p_e_m).tolist(), "covariance_m2": np.diag([25.0, 16.0, 64.0]).tolist()}
    epoch = (at or datetime.now(timezone.utc)) - timedelta(seconds=age_s)
    return {
        "source": {"kind": kind, "name": name, "carrier_hz": carrier_hz},
        "position": position,
        "clock": {
            "epoch": epoch.isoformat().replace("+00:00", "Z"),
            "bias_s": bias_s,
            "drift": 2e-11,
            "covariance": [[4e-16, 0.0], [0.0, 1e-22]],
        }
        if clock
        else None,
        "noise": None
        if noise is None
        else {"h0_s": noise[0], "h_minus2_per_s": noise[1], "ln_covariance": [[0.09, 0.01], [0.01, 0.16]]},
        "provenance": {
            "receiver": receiver,
            "software": "soopnav",
            "method": "innovation_likelihood",
            "independent": independent,
        },
        "quality": {"duration_s": 240.0, "cn0_dbhz": 55.0, "nis": 1.02},
    }


@dataclass
class Running:
    """A service that answers."""

    url: str
    store: Any
    tokens: dict[str, str]


@contextlib.contextmanager
def serving(app: Any) -> Iterator[str]:
    """An ASGI application at a free port of this machine, in a thread; its URL."""
    import uvicorn

    from soopnav_cpp.sopdb.server import listen

    with listen(port=0) as listener:
        listener.listen(256)
        config = uvicorn.Config(app, log_level="warning", lifespan="on", access_log=False, timeout_graceful_shutdown=2)
        server = uvicorn.Server(config)
        server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        end = time.monotonic() + 20.0
        while not server.started:
            if time.monotonic() > end or not thread.is_alive():
                raise RuntimeError("the service did not start")
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join(timeout=20.0)


@contextlib.contextmanager
def database(folder: Path, url: str | None = None, **settings: Any) -> Iterator[Running]:
    """A service on a fresh SQLite file below `folder`, or on the database of `url`."""
    from soopnav_cpp.sopdb.service import create_app
    from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
    from soopnav_cpp.sopdb.store import Store

    free = Rate(1e6, 1e6)
    chosen = {"reads": free, "writes": free, "addresses": free, "failures": free} | settings
    with Store(url or f"sqlite:///{folder / 'sopdb.sqlite'}") as store:
        tokens = {role: store.create_token(f"test {role}", role).text for role in ("read", "contribute", "admin")}
        with serving(create_app(store, ServiceSettings(**chosen))) as address:
            yield Running(address, store, tokens)
