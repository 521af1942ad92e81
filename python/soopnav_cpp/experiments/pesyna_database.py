"""The shared database (pesyna section II-B): a second receiver that downloads what the first found out.

The first receiver characterises both basestations' clocks (stage 2) and contributes noise, offset and drift to the
real service, over a socket. A second one asks for them, leaves stage 2 out, and integrates by stage 3 alone.
"""

from __future__ import annotations

import math
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._extras import require
from soopnav_cpp.clock import TwoState, mean_squared_coherence
from soopnav_cpp.estimation import linear_filter
from soopnav_cpp.experiments import pesyna_setup as setup
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, band, below, experiment, style

Array = npt.NDArray[np.float64]
Sources = tuple[TwoState, TwoState]

NAMES = ("steadier", "other")
CARRIER_HZ = 881.52e6
WINDOW_S = 100.0
AGES_S = (60.0, 600.0, 3600.0, 6 * 3600.0)  # of the answers whose clock is compared with the true one
EPOCH = datetime(2020, 1, 1, tzinfo=timezone.utc)
LIGHT_MPS = 299_792_458.0
BLUE, RED, GREEN, AMBER = "#1b6ca8", "#d1495b", "#2e933c", "#e08e1b"


def coherence(phase_cycles: Array) -> float:
    """Mean-squared coherence over windows of `WINDOW_S`, overlapping (pesyna (15))."""
    return float(mean_squared_coherence(phase_cycles, setup.DT_S, WINDOW_S).mean_squared[0])


class First(NamedTuple):
    """What the first receiver of a run found out.

    Attributes
    ----------
    noise : list of Characterization
        Of each basestation.
    clocks : list of (value, covariance)
        Offset [s] and drift of each, at the end of its record.
    truth : ndarray, shape (2 basestations, 1 + ages, 2)
        True offset and drift then, and later.
    coherence : float
        Of its own stage 3.
    """

    noise: list[Any]
    clocks: list[tuple[Array, Array]]
    truth: Array
    coherence: float


def first(seed: int) -> First:
    """Stage 2 of the first receiver, and its own stage 3."""
    found = setup.record(seed)
    noise = list(setup.characterize_sources(found))
    own = (noise[0].clocks[0], noise[1].clocks[0])
    error = setup.aided_clock_error(seed, characterization=own)
    sigma_m = LIGHT_MPS * math.hypot(found.gps_sigma_s, found.cdma_sigma_s)
    dt_s = found.dt_s
    clocks = []
    for i, source in enumerate(own):
        s_f, s_g = source.noise
        F = np.array([[1.0, dt_s], [0.0, 1.0]])
        Q = np.array([[s_f * dt_s + s_g * dt_s**3 / 3, s_g * dt_s**2 / 2], [s_g * dt_s**2 / 2, s_g * dt_s]])
        z = LIGHT_MPS * (found.gps_s - found.cdma_s[:, i])
        run = linear_filter(F, Q, [[1.0, 0.0]], sigma_m**2, z[1:], [z[0], 0.0], np.diag([sigma_m**2, 30.0**2]))
        clocks.append((run.x[-1] / LIGHT_MPS, run.P[-1] / LIGHT_MPS**2))
    end_s = (setup.EPOCHS - 1) * dt_s
    times = np.concatenate([found.t_s, end_s + np.array(AGES_S)])
    truth = []
    for i, source in enumerate(found.sources):
        series = source.simulate_at(times, seed=seed, stream=1 + i)
        truth.append(np.column_stack([series.bias_s, series.drift])[setup.EPOCHS - 1 :])
    return First(noise, clocks, np.array(truth), coherence(error))


def second(seed: int, downloaded: dict[int, tuple[Sources, Sources]]) -> list[float]:
    """Coherence of second receivers that take downloaded noise.

    Parameters
    ----------
    seed : int
        Of the first receiver's run.
    downloaded : dict
        By seed, what the first receiver of that run contributed, and what that of another run did.

    Returns
    -------
    list
        At another epoch; at the first's epoch, with what another run's receiver contributed before; at another epoch
        with the two basestations' noise swapped.
    """
    sources, earlier = downloaded[seed]
    elsewhere, beside = seed ^ 0x5EC0, seed ^ 0xBE51
    return [
        coherence(setup.aided_clock_error(elsewhere, characterization=sources)),
        coherence(setup.aided_clock_error(beside, characterization=earlier, source_seed=seed)),
        coherence(setup.aided_clock_error(elsewhere, characterization=(sources[1], sources[0]))),
    ]


@contextmanager
def service(folder: Path) -> Iterator[tuple[str, str]]:
    """A service on a database of its own, at a port of the loopback: its URL and a token that may contribute."""
    uvicorn = require("uvicorn", "sopdb", "the signal database's service")
    require("fastapi", "sopdb", "the signal database's service")
    require("sqlalchemy", "sopdb", "the signal database")
    from soopnav_cpp.sopdb.server import listen
    from soopnav_cpp.sopdb.service import create_app
    from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
    from soopnav_cpp.sopdb.store import Store

    plenty = Rate(1e5, 1e5)
    settings = ServiceSettings(reads=plenty, writes=plenty, addresses=plenty, page_size=500)
    socket = listen("127.0.0.1", 0)
    port = socket.getsockname()[1]
    with Store(f"sqlite:///{folder / 'signals.sqlite3'}") as store:
        token = store.create_token("receivers", "contribute").text
        config = uvicorn.Config(create_app(store, settings), log_level="error", lifespan="off")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [socket]}, daemon=True)
        thread.start()
        try:
            while not server.started and thread.is_alive():
                time.sleep(0.01)
            yield f"http://127.0.0.1:{port}", token
        finally:
            server.should_exit = True
            thread.join(20.0)
            socket.close()


def normalised(clock: Any, truth: Array) -> float:
    """NEES of an answered clock."""
    down = 1.0 / np.sqrt(np.diag(clock["covariance"]))
    error = down * (np.array([clock["bias_s"], clock["drift"]]) - truth)
    return float(error @ np.linalg.solve(np.array(clock["covariance"]) * np.outer(down, down), error))


def exchange(found: list[First]) -> tuple[list[Sources], Array, int]:
    """Contribute every run's characterisations, then ask for them.

    Returns
    -------
    noise : list of pair of TwoState
        As downloaded.
    nees : ndarray, shape (runs, 2, ages)
        Of the clocks that the service answers for each age.
    accepted : int
    """
    from soopnav_cpp.sopdb.client import Client
    from soopnav_cpp.sopdb.describe import describe

    accepted = 0
    noise: list[Sources] = []
    nees = np.empty((len(found), 2, len(AGES_S)))
    with tempfile.TemporaryDirectory() as folder, service(Path(folder)) as (url, token):
        with Client(url, token=token) as client:
            for run, one in enumerate(found):
                for i in range(2):
                    receipt = client.push(
                        describe(
                            "cdma",
                            f"{NAMES[i]} {run}",
                            CARRIER_HZ,
                            receiver="first",
                            noise=one.noise[i],
                            epoch=EPOCH,
                            clock=one.clocks[i],
                            cn0_dbhz=setup.CDMA_DBHZ,
                        )
                    )
                    accepted += receipt.status == "accepted"
        with Client(url, token=token) as client:  # the second receivers'
            for k, age_s in enumerate(AGES_S):
                answers = {answer["name"]: answer for answer in client.sources(at=EPOCH + timedelta(seconds=age_s))}
                for run, one in enumerate(found):
                    for i, name in enumerate(NAMES):
                        nees[run, i, k] = normalised(answers[f"{name} {run}"]["clock"], one.truth[i, 1 + k])
            for run in range(len(found)):
                steadier, other = (answers[f"{name} {run}"]["noise"] for name in NAMES)
                noise.append(
                    (
                        TwoState(steadier["h0_s"], steadier["h_minus2_per_s"]),
                        TwoState(other["h0_s"], other["h_minus2_per_s"]),
                    )
                )
    return noise, nees, accepted


@experiment(
    "pesyna-db",
    title="The shared database: a second receiver downloads and leaves stage 2 out",
    source="pesyna section II-B",
    runs=200,
)
def database(lab: Lab) -> Iterator[Claim]:
    """First receivers characterise, second ones use what the service answers."""
    found = lab.map(first)
    noise, nees, accepted = exchange(found)
    earlier = noise[-1:] + noise[:-1]
    table = dict(zip(lab.seeds, zip(noise, earlier, strict=True), strict=True))
    others = np.array(lab.map(second, table))
    own = np.array([one.coherence for one in found])
    elsewhere, beside, swapped = others.T
    within = np.abs(beside / own - 1.0) <= 0.1

    with lab.figure(10.8, 4.0) as figure:
        left, middle, right = figure.subplots(1, 3)
        bins = np.linspace(0.0, 1.0, 41)
        curves = (("own stage 2", own, BLUE), ("downloaded", elsewhere, GREEN), ("swapped", swapped, RED))
        for _, values, colour in curves:
            left.hist(values, bins, histtype="step", lw=1.4, color=colour)
            left.axvline(values.mean(), 0.0, 0.68, color=colour, ls=":", lw=1.0)
        top = left.get_ylim()[1] * 1.12
        left.set_ylim(0.0, top)
        for k, (name, values, colour) in enumerate(curves):
            left.text(0.03, top * (0.93 - 0.075 * k), f"{name}: mean {values.mean():.3f}", color=colour, fontsize=8)
        style(left, "CDMA-only clock", f"C²({WINDOW_S:g} s)", "runs")
        middle.plot(own, beside, "o", ms=2.5, color=BLUE, alpha=0.6)
        low = min(own.min(), beside.min()) - 0.02
        line = np.array([low, 1.0])
        middle.plot(line, line, color="0.4", lw=0.8)
        middle.fill_between(line, 0.9 * line, 1.1 * line, color="0.9", zorder=0)
        middle.set(xlim=(low, 1.0), ylim=(low, 1.0))
        style(middle, "Same epoch, two receivers", "C² of the first, own stage 2", "C² of the second, downloaded")
        spread = 4.0 * nees.std(axis=(0, 1)) / math.sqrt(nees.shape[0] * nees.shape[1])
        right.axhline(2.0, color="0.4", lw=0.8)
        right.errorbar(AGES_S, nees.mean(axis=(0, 1)), spread, fmt="o", ms=4, lw=1.2, color=AMBER)
        right.set(xscale="log", ylim=(0.0, 4.0))
        style(right, "Clock answered later", "age of the answer [s]", "mean NEES, 2 expected")
    lab.save(own=own, elsewhere=elsewhere, beside=beside, swapped=swapped, nees=nees, ages_s=AGES_S)

    yield Claim(
        f"contributions accepted, of {2 * len(found)}: an honest receiver is not quarantined",
        accepted / (2 * len(found)),
        at_least(0.99),
    )
    yield Claim(
        f"mean C²({WINDOW_S:g} s) at another epoch, downloaded over own stage 2 ({lab.runs} runs each)",
        float(elsewhere.mean() / own.mean()),
        band(0.9, 1.1),
    )
    yield Claim(
        "pairs at the same epoch whose C² is within 10 % of the first's",
        float(within.mean()),
        at_least(0.95),
    )
    yield Claim("mean C² with the two characterisations swapped", float(swapped.mean()), below(0.6))
    yield Claim(
        f"mean NEES of the clocks answered {', '.join(f'{age:g}' for age in AGES_S)} s later (2 expected)",
        [float(value) for value in nees.mean(axis=(0, 1))],
        band(1.2, 2.9),
    )
    stale = np.array([one.truth[:, 1 + AGES_S.index(3600.0)] - one.truth[:, 0] for one in found])
    claimed = np.array([[P for _, P in one.clocks] for one in found])
    drift = stale[..., 1] ** 2 / claimed[..., 1, 1]
    yield Claim(
        "the drift after an hour against the covariance as contributed, not grown: its mean normalised square",
        float(drift.mean()),
        at_least(10.0),
    )
