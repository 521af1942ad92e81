"""The four steps as two processes (mei slide 6): what they find, what few bits cost, what a bad connection costs."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import soopnav_cpp
from soopnav_cpp import dsp, geometry, iridium
from soopnav_cpp.experiments import mei_peer_setup, mei_setup
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, experiment, style
from soopnav_cpp.peer import beacons, local, messages, proxy, report, roles, snippets, sources, track
from soopnav_cpp.peer.session import Address, Traffic

Array = npt.NDArray[np.float64]

POINTS = ((10.0, 2), (15.0, 3), (20.0, 4))  # SNR [dB] up to which so many bits are taken
BITS = {0.0: (0, 2), 10.0: (0, 1, 2), 15.0: (0, 2, 3), 20.0: (0, 4)}  # tried at each SNR
TRIALS = 90  # of each run and point
BURST_S = 90e-3
RATE_HZ = 50e3
GUARD_S = 1.5e-3
DURATION_S = 60.0
BLUE, RED, GREEN, AMBER = "#1b6ca8", "#d1495b", "#2e933c", "#e08e1b"


def trials(seed: int) -> dict[str, Array]:
    """Errors and stated sigmas of bursts whose anchor's side has few bits, by ``SNR/bits``, all in the same noise.

    Rows: trials; columns: error and sigma of the TDOA [s], of the FDOA [Hz].
    """
    rng = np.random.default_rng(seed)
    out: dict[str, list[tuple[float, ...]]] = {}
    count = 250 * math.ceil((BURST_S + 2.0 * GUARD_S) * RATE_HZ / 250)
    inner = slice(round(GUARD_S * RATE_HZ), round((GUARD_S + BURST_S) * RATE_HZ))
    for number in range(TRIALS):
        wave = iridium.make_burst(iridium.BurstKind.LONG, seed, stream=number, duration_s=BURST_S)
        delay_s = rng.uniform(-20e-6, 20e-6)
        clean_b = wave.render(count, RATE_HZ, delay_s=GUARD_S)
        doppler_hz = float(rng.uniform(-400.0, 400.0))
        clean_a = wave.render(count, RATE_HZ, delay_s=GUARD_S + delay_s, doppler_hz=doppler_hz)
        noise = rng.standard_normal((2, count, 2)).view(np.complex128)[..., 0] / math.sqrt(2.0)
        for db, tried in BITS.items():
            amplitude = math.sqrt(25e3 / RATE_HZ) * 10.0 ** (0.05 * db)
            a = (amplitude * clean_a + noise[0]).astype(np.complex64)
            b = (amplitude * clean_b + noise[1]).astype(np.complex64)
            for bits in tried:
                scale, data = snippets.quantise(b, bits, burst=inner, band=35e3 / RATE_HZ)
                peak = dsp.cross_ambiguity(
                    a,
                    snippets.dequantise(data, count, bits, scale),
                    RATE_HZ,
                    max_delay_s=0.8 * GUARD_S,
                    max_doppler_hz=9e3,
                    symbol_rate_hz=25e3,
                )
                errors = (peak.tdoa_s - delay_s, peak.sigma_tdoa_s, peak.fdoa_hz - doppler_hz, peak.sigma_fdoa_hz)
                out.setdefault(f"{db:g}/{bits}", []).append(errors if peak.detected else (math.nan,) * 4)
    return {name: np.array(rows) for name, rows in out.items()}


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _loss_db(pooled: dict[str, Array], db: float, bits: int) -> list[float]:
    """Of TDOA and FDOA, against full precision."""
    few, full = pooled[f"{db:g}/{bits}"], pooled[f"{db:g}/0"]
    return [20.0 * math.log10(_rms(few[:, k]) / _rms(full[:, k])) for k in (0, 2)]


# ---- two processes


def _command(role: str, world: mei_peer_setup.PeerWorld, folder: Path, more: Sequence[str]) -> list[str]:
    at = world.anchor_at if role == "anchor" else world.guess_at
    return [
        sys.executable, "-c", "from soopnav_cpp.cli import main; main()", "peer", "--role", role,
        "--source", str(world.anchor if role == "anchor" else world.target), "--key-file", str(folder / "key"),
        "--orbits", str(world.ephemeris), f"--at={at}", "--height-sigma", "10", "--json", *more,
    ]  # fmt: skip


def _start(command: list[str]) -> subprocess.Popen[str]:
    paths = [str(Path(soopnav_cpp.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def _result(process: subprocess.Popen[str]) -> dict[str, Any]:
    try:
        out, error = process.communicate(timeout=150.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise RuntimeError("a peer did not end within 150 s") from None
    if process.returncode != 0:
        raise RuntimeError(f"a peer ended with {process.returncode}: {error.strip()[-400:]}")
    found: dict[str, Any] = json.loads(out)
    return found


def two_processes(world: mei_peer_setup.PeerWorld, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Anchor and target on a Unix socket; what both say at the end."""
    where = f"unix:{folder / 'socket'}"
    anchor = _start(_command("anchor", world, folder, ["--listen", where]))
    target = _start(_command("target", world, folder, ["--connect", where, "--out", str(folder / "out")]))
    return _result(target), _result(anchor)


def bad_connection(
    world: mei_peer_setup.PeerWorld, folder: Path, seed: int, *, kill: str, after: int
) -> tuple[dict[str, Any], dict[str, Any], proxy.Faults]:
    """The same through a connection that loses 20 %, damages 5 % and delays 5 % of all frames; `kill` is killed (the
    system's SIGKILL) once `after` snippets have come through, and started again."""
    socket = folder / f"socket_{kill}"
    faults = proxy.Faults(seed, lost=0.20, damaged=0.05, delayed=0.05)
    snippet = threading.Semaphore(0)

    def count(kind: int) -> None:
        if kind == int(messages.Kind.SNIPPET):
            snippet.release()

    state = folder / f"state_{kill}.json"
    with proxy.BadConnection(Address(path=socket), faults, on_frame=count) as between:
        commands = {
            "anchor": _command("anchor", world, folder, ["--listen", f"unix:{socket}", "--wait", "20"]),
            "target": _command(
                "target", world, folder, ["--connect", str(between.address), "--wait", "20", "--state", str(state)]
            ),
        }
        running = {role: _start(command) for role, command in commands.items()}
        for _ in range(after):
            if not snippet.acquire(timeout=60.0):
                break
        running[kill].kill()
        running[kill].communicate()
        time.sleep(0.2)
        running[kill] = _start(commands[kill])
        target = _result(running["target"])
        anchor = _result(running["anchor"])
    return target, anchor, faults


def one_process(world: mei_peer_setup.PeerWorld) -> roles.Target:
    """The same two state machines in one process, without a connection."""

    def place(text: str) -> Array:
        latitude, longitude, height = (float(x) for x in text.split(","))
        return np.asarray(geometry.geodetic_to_ecef(math.radians(latitude), math.radians(longitude), height))

    recordings = {"anchor": sources.Recording(world.anchor), "target": sources.Recording(world.target)}
    known = {
        role: beacons.read_beacons(world.ephemeris, r.reference_unix_s + r.start_s, r.reference_unix_s + r.end_s)
        for role, r in recordings.items()
    }
    where = track.Track(
        known["target"],
        place(world.guess_at),
        height_m=float(world.guess_at.split(",")[2]),
        height_sigma_m=10.0,
        target_clock=mei_setup.OCXO,
        anchor_clock=mei_setup.OCXO,
    )
    antenna = geometry.SampledOrbit.fixed(place(world.anchor_at))
    target = roles.Target(recordings["target"], known["target"], where)
    local.run_together(roles.Anchor(recordings["anchor"], known["anchor"], antenna), target)
    return target


def _off(found: dict[str, Any], truth: Sequence[float]) -> tuple[float, float, float]:
    """Error, its squared norm in the stated covariance, and the stated sigma, of a target's position."""
    if found["estimate"] is None:
        return math.nan, math.nan, math.nan
    error = np.array(found["estimate"]["position_e_m"]) - np.array(truth)
    P = np.array(found["estimate"]["position_covariance_m2"])
    return float(np.linalg.norm(error)), float(error @ np.linalg.solve(P, error)), float(math.sqrt(np.trace(P)))


def _came_to(found: dict[str, Any]) -> float:
    """When a target's last update was, from 0 for the beginning of its recording to 1."""
    if found["estimate"] is None:
        return math.nan
    begin, end = (sources.instant(text, "utc") for text in (mei_peer_setup.START, found["estimate"]["utc"]))
    return (end[0] - begin[0] + end[1] - begin[1]) / DURATION_S


@experiment(
    "mei-x1",
    title="Two receivers as two processes: bits, losses, restarts",
    source="mei slide 6 (navigation scheme), beyond it",
    runs=12,
)
def two_receivers(lab: Lab) -> Iterator[Claim]:
    lab.step("few bits")
    parts = lab.map(trials)
    pooled = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lab.step("recordings")
        seed = int(lab.rng("world").integers(1 << 31))
        world = mei_peer_setup.record(seed, folder, duration_s=DURATION_S)
        (folder / "key").write_text("a key that two receivers share\n")
        lab.step("two processes")
        target, anchor = two_processes(world, folder)
        lab.step("one process")
        together = one_process(world)
        alone = report.summary(together, Traffic())
        bad = {}
        for kill in ("anchor", "target"):
            lab.step(f"a bad connection, the {kill} killed")
            bad[kill] = bad_connection(world, folder, seed, kill=kill, after=5)
    _draw(lab, pooled, together, world)
    lab.table(
        ["run", "used", "error_m", "sigma_m", "sessions", "missing", "damaged"],
        [
            [
                label,
                found["counts"].get("used", 0),
                *(_off(found, world.truth_e_m)[k] for k in (0, 2)),
                found["sessions"],
                found["refused"].get("missing", 0),
                found["refused"].get("damaged", 0),
            ]
            for label, found in (
                ("two processes", target),
                ("one process", alone),
                *((f"bad connection, {kill} killed", run[0]) for kill, run in bad.items()),
            )
        ],
    )
    lab.save(part="", **{f"errors_{key.replace('/', '_')}": value for key, value in pooled.items()})

    losses = [loss for db, bits in POINTS for loss in _loss_db(pooled, db, bits)]
    yield Claim(
        "2 bits of the anchor's snippet at 10 dB, 3 bits at 15 dB and 4 bits at 20 dB lose at most 1 dB each, TDOA and "
        f"FDOA; {TRIALS * lab.runs} bursts of 90 ms, 50 ksps, the target's side not quantised",
        losses,
        at_most(1.0, "dB"),
    )
    used = [pooled[f"{db:g}/{bits}"] for db, bits in POINTS]
    yield Claim(
        "the noise of quantisation is in the stated covariance: rms of error over sigma, TDOA and FDOA at these three",
        [_rms(rows[:, k] / rows[:, k + 1]) for rows in used for k in (0, 2)],
        band(0.67, 1.5),
    )
    _, nees, _ = _off(target, world.truth_e_m)
    yield Claim(
        "two processes on a socket scan, agree, exchange and track: share of the bursts sent that were used",
        target["counts"].get("used", 0) / world.bursts,
        at_least(0.3),
    )
    yield Claim("the target's position error squared, in its stated covariance (3 states)", nees, at_most(28.0))
    same = np.array(target["estimate"]["position_e_m"]) - np.array(alone["estimate"]["position_e_m"])
    clock_m = 299_792_458.0 * (target["estimate"]["clock_offset_s"] - alone["estimate"]["clock_offset_s"])
    yield Claim(
        "two processes end with what one process ends with: position and clock, difference",
        [float(np.linalg.norm(same)), abs(clock_m)],
        at_most(1e-6, "m"),
    )
    yield Claim("at 9 dB, one burst a second: bits a second from the anchor", 8.0 * anchor["sent_bytes"] / DURATION_S,
                at_most(20e3, "bit/s"))  # fmt: skip
    text = "20 % of messages lost, 5 % damaged, 5 % late"
    counted = dict.fromkeys(("missing", "damaged", "garbage"), 0.0)
    for kill, (found, other, faults) in bad.items():
        for name in counted:
            counted[name] += found["refused"].get(name, 0) + other["refused"].get(name, 0)
        lab.step(f"{kill} killed: {dict(faults.counts)}")
        _, nees, _ = _off(found, world.truth_e_m)
        with_kill = f"{text}, {kill} killed and restarted"
        yield Claim(f"{with_kill}: the track is kept: error squared in the stated covariance", nees, at_most(28.0))
        yield Claim(f"{with_kill}: share of the recording when the last update came", _came_to(found), at_least(0.6))
        if kill == "target":
            yield Claim(f"{with_kill}: bursts used since, which the kept state knew nothing of",
                        float(found["counts"].get("used", 0)), at_least(1.0))  # fmt: skip
        seen = float(max(found["sessions"], other["sessions"]))
        yield Claim(f"{with_kill}: sessions that the surviving end saw", seen, at_least(2.0))
    yield Claim(
        f"{text}: messages counted as missing, and as damaged, in both runs",
        [counted["missing"], counted["damaged"] + counted["garbage"]],
        above(0.0),
    )


def _draw(lab: Lab, pooled: dict[str, Array], target: roles.Target, world: mei_peer_setup.PeerWorld) -> None:
    with lab.figure(10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        style(left, "What few bits of the anchor's snippet cost", "SNR of both [dB]", "rms TDOA error [ns]")
        for bits, colour, label in ((0, "0.3", "full precision"), (2, BLUE, "2 bits")):
            at = [db for db in BITS if f"{db:g}/{bits}" in pooled]
            left.semilogy(
                at, [1e9 * _rms(pooled[f"{db:g}/{bits}"][:, 0]) for db in at], ".-", color=colour, label=label
            )
        for (db, bits), colour in zip(((10.0, 1), *POINTS[1:]), (AMBER, GREEN, RED), strict=True):
            value = 1e9 * _rms(pooled[f"{db:g}/{bits}"][:, 0])
            left.semilogy([db], [value], "s", color=colour, markersize=6, label=f"{bits} bit{'s' * (bits > 1)}")
        left.legend(fontsize=8, frameon=False)
        h = target.track.history
        t = np.array([m.t_s for m in h.measured]) - h.measured[0].t_s
        error = np.linalg.norm(np.array(h.mean)[:, :3] - np.array(world.truth_e_m), axis=1)
        sigma = np.sqrt(np.trace(np.array(h.covariance)[:, :3, :3], axis1=1, axis2=2))
        style(right, "Position of the target, two processes", "time [s]", "metres")
        right.semilogy(t, error, color=BLUE, label="error")
        right.semilogy(t, sigma, "--", color="0.45", label="stated sigma")
        right.legend(fontsize=8, frameon=False)
