"""Recordings of two receivers for mei-x1: a world of the mei rows on two long recordings, each by its own clock."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soopnav_cpp import geometry, io, iridium, orbits, simulation
from soopnav_cpp.experiments import mei_setup

__all__ = ["CENTER_HZ", "RATE_HZ", "START", "PeerWorld", "record"]

RATE_HZ = 150e3
CENTER_HZ = 1626.270e6
START = "2014-08-27T06:00:00Z"
BURST_S = 32.48e-3  # whole symbols
PEAK = 0.9


@dataclass(frozen=True)
class PeerWorld:
    """Files of a world, and what is true.

    Attributes
    ----------
    anchor, target, ephemeris : Path
    anchor_at, guess_at : str
        ``LAT,LON,H`` for ``--at``: where the anchor is, and where the target may be.
    height_m : float
        Of the target, as known.
    truth_e_m : list of float
        The target's position.
    bursts : int
        That both recordings hold.
    """

    anchor: Path
    target: Path
    ephemeris: Path
    anchor_at: str
    guess_at: str
    height_m: float
    truth_e_m: list[float]
    bursts: int


def _degrees(p_e: np.ndarray) -> str:
    latitude, longitude, height = (float(x) for x in np.ravel(geometry.ecef_to_geodetic(p_e)))
    return f"{math.degrees(latitude):.9f},{math.degrees(longitude):.9f},{height:.4f}"


def record(
    seed: int, folder: Path, *, duration_s: float = 50.0, snr_db: float = 9.0, off_m: float = 3e3, format: str = "ci8"
) -> PeerWorld:
    """Send a burst a second from a satellite in view through both receivers' paths and clocks into two recordings.

    Parameters
    ----------
    seed : int
    folder : Path
        Of the files.
    duration_s : float
    snr_db : float
        In 25 kHz, at both.
    off_m : float
        By how much the target's start is off, in a direction of chance.
    format : str
        Of the samples.
    """
    setup = mei_setup.Setup(duration_s=duration_s, burst_s=BURST_S, snr_db=snr_db, sample_rate_hz=RATE_HZ)
    world = mei_setup.make_world(setup, seed)
    size = math.ceil((duration_s + 1.0) * RATE_HZ)
    amplitude = math.sqrt(25e3 / RATE_HZ) * 10.0 ** (snr_db / 20.0)  # noise of unit variance
    files = {}
    folder.mkdir(parents=True, exist_ok=True)
    waves = [
        iridium.make_burst(iridium.BurstKind.LONG, seed, stream=i, duration_s=BURST_S) for i in range(len(world.beacon))
    ]
    for stream, (role, receiver) in enumerate((("anchor", world.link.anchor), ("target", world.link.target))):
        samples = simulation.add_awgn(np.zeros(size, np.complex64), 1.0, seed=seed, stream=0x7831 + stream)
        for i, wave in enumerate(waves):
            first = max(0, int((world.truth.anchor.reading_s[i] - 0.1) * RATE_HZ))
            receiver.receive(
                wave,
                world.sky[world.beacon[i]],
                samples[first : first + round(0.2 * RATE_HZ)],
                start_s=float(world.start_s[i]),
                carrier_hz=world.carrier_hz,
                recording_start_s=0.0,
                sample_rate_hz=RATE_HZ,
                center_hz=CENTER_HZ,
                first_sample=first,
                amplitude=amplitude,
                phase_rad=0.1 * i,
            )
        samples *= np.float32(PEAK / float(np.abs(samples.view(np.float32)).max()))
        files[role] = io.write_iq(
            folder / role, samples, RATE_HZ, format=format, center_frequency_hz=CENTER_HZ, datetime_utc=START
        )
    names = {f"W{i:02d}": orbit for i, orbit in enumerate(world.beacons)}
    ephemeris = folder / "satellites.npz"
    orbits.write_ephemeris(ephemeris, names, START)
    truth = np.asarray(world.target.at(0.0)[0], np.float64).reshape(3)
    latitude, longitude, _ = (float(x) for x in np.ravel(geometry.ecef_to_geodetic(truth)))
    angle = float(np.random.default_rng([seed, 0x7830]).uniform(0.0, 2.0 * math.pi))
    frame = geometry.LocalFrame(latitude, longitude, world.height_m)
    guess = frame.position_to_ecef(off_m * np.array([math.sin(angle), math.cos(angle), 0.0]))
    guess_at = _degrees(np.asarray(guess)).rsplit(",", 1)[0] + f",{world.height_m:.4f}"
    made = PeerWorld(
        files["anchor"], files["target"], ephemeris, _degrees(world.anchor_p_e), guess_at, world.height_m,
        truth.tolist(), len(waves),
    )  # fmt: skip
    (folder / "truth.json").write_text(json.dumps({"target_e_m": truth.tolist(), "bursts": len(waves)}) + "\n")
    return made
