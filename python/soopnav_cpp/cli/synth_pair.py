"""``soopnav synth pair``: what two receivers record of the same satellites, each by its own clock."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry, io, iridium, orbits
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.clock import TwoState
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.scenarios.pair import PairScenario, PairSite, load_pair_scenario
from soopnav_cpp.simulation import ClockTrack, PairLink, PairReceiver

__all__ = ["Transmission", "schedule", "synthesize_pair"]

_NOISE_HZ = 25e3
_DOWNLINK_S = iridium.FRAME_S - 4.0 * 8.28e-3 - 3 * 0.3e-3  # of the first downlink slot in a frame
_SLOT_S = 8.28e-3 + 0.3e-3
_TONE_RATE_HZ = 1e3


@dataclass(frozen=True)
class Transmission:
    """A burst that a satellite sends."""

    satellite: str
    kind: iridium.BurstKind
    channel: int
    start_s: float
    duration_s: float
    stream: int


def _trajectory(site: PairSite, duration_s: float) -> SampledOrbit:
    latitude, longitude = math.radians(site.latitude_deg), math.radians(site.longitude_deg)
    here = geometry.geodetic_to_ecef(latitude, longitude, site.height_m)
    if not any(site.velocity_mps):
        return SampledOrbit.fixed(here)
    frame = geometry.LocalFrame(latitude, longitude, site.height_m)
    velocity = frame.position_to_ecef(np.asarray(site.velocity_mps)) - here
    times = np.array([-10.0, duration_s + 10.0])
    return SampledOrbit(-10.0, duration_s + 20.0, here + times[:, None] * velocity, np.tile(velocity, (2, 1)))


def _receiver(scenario: PairScenario, site: PairSite, stream: int) -> PairReceiver:
    duration_s, clock = scenario.capture.duration_s, site.clock
    times = np.arange(-2.0, duration_s + 3.0)
    # `bias_s` and `drift_ppm` are those at time 0, the clock runs from two seconds before.
    series = TwoState(clock.h0, clock.h_minus_2).simulate_at(
        times, seed=scenario.capture.seed, stream=stream, bias_s=clock.bias_s, drift=1e-6 * clock.drift_ppm
    )
    bias = series.bias_s - (series.bias_s[2] - clock.bias_s)
    drift = series.drift - (series.drift[2] - 1e-6 * clock.drift_ppm)
    bias = bias - (times - 0.0) * (series.drift[2] - 1e-6 * clock.drift_ppm)
    return PairReceiver(_trajectory(site, duration_s), ClockTrack(times, bias, drift))


def _satellites(scenario: PairScenario) -> dict[str, SampledOrbit]:
    capture, given = scenario.capture, scenario.satellites.tle
    if given is None:
        made = orbits.iridium_walker(capture.duration_s + 20.0, start_s=-10.0, gmst_rad=orbits.gmst(capture.start))
        return {f"W{i // 11 + 1}{i % 11 + 1:02d}": orbit for i, orbit in enumerate(made)}
    return {
        satellite.name: satellite.sampled(capture.start, capture.duration_s) for satellite in orbits.read_orbits(given)
    }


def _in_band(scenario: PairScenario, channel: int) -> bool:
    off = abs(iridium.channel_frequency_hz(channel) - scenario.capture.center_frequency_hz)
    return off + iridium.MAX_DOPPLER_HZ + 20e3 <= 0.5 * scenario.capture.sample_rate_hz


def schedule(scenario: PairScenario, names: list[str]) -> list[Transmission]:
    """The bursts of some satellites in the recorded band, by the frames of each; the same for the same seed."""
    capture, load = scenario.capture, scenario.satellites
    rng = np.random.default_rng([capture.seed, 0x7061_6972])
    duplex = [channel for channel in range(1, 241) if _in_band(scenario, channel)]
    ring = _in_band(scenario, 247)
    if not (ring and load.ring_alerts_per_s > 0.0) and not (duplex and load.duplex_per_s > 0.0):
        raise ValueError(
            "capture: no channel with bursts lies in the recorded band; ring alerts are at 1626.270833 MHz, duplex "
            "channels below 1626 MHz"
        )
    sent: list[Transmission] = []
    frames = np.arange(math.floor(capture.duration_s / iridium.FRAME_S) + 2) - 1
    for name in names:
        offset = rng.uniform(0.0, iridium.FRAME_S)
        channel = int(rng.choice(duplex)) if duplex else 0
        alerts = rng.uniform(size=len(frames)) < load.ring_alerts_per_s * iridium.FRAME_S
        slots = rng.uniform(size=(len(frames), 4)) < load.duplex_per_s * iridium.FRAME_S / 4.0
        lengths = rng.integers(144, 509, size=len(frames)) / iridium.SYMBOL_RATE_HZ
        for i, frame in enumerate(frames):
            begin = offset + float(frame) * iridium.FRAME_S
            if ring and alerts[i]:
                kind = iridium.BurstKind.RING_ALERT
                sent.append(Transmission(name, kind, 247, begin, float(lengths[i]), len(sent)))
            for slot in range(4):
                if duplex and slots[i, slot]:
                    start = begin + _DOWNLINK_S + slot * _SLOT_S
                    sent.append(Transmission(name, iridium.BurstKind.DUPLEX, channel, start, 8.28e-3, len(sent)))
    return sorted(sent, key=lambda one: one.start_s)


def _position(receiver: PairReceiver, t_s: float) -> npt.NDArray[np.float64]:
    return np.asarray(receiver.antenna.at(t_s)[0], np.float64).reshape(3)


def synthesize_pair(scenario_path: Path, out: Path, *, step: Steps) -> dict[str, Path]:
    """Write both captures, the satellites' ephemeris and what is true; returns the files by name."""
    scenario = load_pair_scenario(scenario_path)
    capture = scenario.capture
    step("placing satellites")
    receivers = {"target": _receiver(scenario, scenario.target, 11), "anchor": _receiver(scenario, scenario.anchor, 12)}
    link = PairLink(receivers["target"], receivers["anchor"], sample_rate_hz=capture.sample_rate_hz)
    sky = _satellites(scenario)
    middle = 0.5 * capture.duration_s
    mask = math.radians(scenario.satellites.mask_deg)
    all_orbits = list(sky.values())
    up = np.ones(len(sky), bool)
    for receiver in receivers.values():
        up &= orbits.elevations(all_orbits, middle, _position(receiver, middle))[1] > mask
    heard = {name: orbit for name, orbit, seen in zip(sky, all_orbits, up, strict=True) if seen}
    if not heard:
        raise ValueError(
            f"{scenario_path}: no satellite stands above {scenario.satellites.mask_deg:g}° at both receivers"
        )
    sent = [
        (one, iridium.make_burst(one.kind, capture.seed, stream=one.stream, duration_s=one.duration_s))
        for one in schedule(scenario, list(heard))
    ]
    out.mkdir(parents=True, exist_ok=True)
    files: dict[str, Path] = {}
    size = round(capture.duration_s * capture.sample_rate_hz)
    for stream, (role, receiver) in enumerate(receivers.items()):
        samples = np.zeros(size, np.complex64)
        samples = _with_tones(scenario, receiver, role, samples)
        for number, (one, burst) in enumerate(sent):
            step(f"recording the {role}", done=number, total=len(sent))
            orbit = heard[one.satellite]
            range_m = float(np.linalg.norm(np.asarray(orbit.at(one.start_s)[0]) - _position(receiver, middle)))
            _receive(
                scenario,
                receiver,
                samples,
                burst,
                orbit,
                one.start_s,
                iridium.channel_frequency_hz(one.channel),
                scenario.satellites.snr_db + 20.0 * math.log10(780e3 / range_m),
            )
        samples += _noise(scenario, size, stream)
        peak = float(np.abs(samples.view(np.float32)).max())
        samples *= np.float32(capture.peak / peak)
        step(f"writing {role}.sigmf-meta")
        files[role] = io.write_iq(
            out / role,
            samples,
            capture.sample_rate_hz,
            format=capture.format,
            center_frequency_hz=capture.center_frequency_hz,
            datetime_utc=orbits.utc(capture.start).strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
            description=f"{role} of a pair, by its own clock",
        )
    files["ephemeris"] = out / "satellites.csv"
    orbits.write_ephemeris(files["ephemeris"], heard, capture.start)
    files["truth"] = out / "truth.json"
    bursts = [_burst_truth(link, heard, one, burst) for one, burst in sent]
    recorded = [row for row in bursts if 0.0 <= row["anchor_reading_s"] < capture.duration_s]
    truth = {
        "start": orbits.utc(capture.start).isoformat(),
        "signs": "tdoa: target's reading less anchor's; fdoa: target's frequency less anchor's",
        "target": _site_truth(receivers["target"]),
        "anchor": _site_truth(receivers["anchor"]),
        "bursts": recorded,
    }
    files["truth"].write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return files


def _receive(
    scenario: PairScenario,
    receiver: PairReceiver,
    samples: npt.NDArray[np.complex64],
    waveform: Any,
    source: SampledOrbit,
    start_s: float,
    carrier_hz: float,
    snr_db: float,
    waveform_rate_hz: float = 0.0,
) -> None:
    capture = scenario.capture
    receiver.receive(
        waveform,
        source,
        samples,
        start_s=start_s,
        carrier_hz=carrier_hz,
        recording_start_s=0.0,
        sample_rate_hz=capture.sample_rate_hz,
        center_hz=capture.center_frequency_hz,
        # Noise has unit variance per sample.
        amplitude=math.sqrt(_NOISE_HZ / capture.sample_rate_hz) * 10.0 ** (snr_db / 20.0),
        waveform_rate_hz=waveform_rate_hz,
    )


def _with_tones(
    scenario: PairScenario, receiver: PairReceiver, role: str, samples: npt.NDArray[np.complex64]
) -> npt.NDArray[np.complex64]:
    mast = SampledOrbit.fixed(_position(receiver, 0.0) * (1.0 + 50.0 / 6.4e6))
    for tone in scenario.tones:
        if tone.heard_by in (role, "both"):
            long = np.ones(math.ceil((scenario.capture.duration_s + 4.0) * _TONE_RATE_HZ), np.complex64)
            _receive(scenario, receiver, samples, long, mast, -2.0, tone.frequency_hz, tone.snr_db, _TONE_RATE_HZ)
    return samples


def _noise(scenario: PairScenario, size: int, stream: int) -> npt.NDArray[np.complex64]:
    from soopnav_cpp import simulation

    return simulation.add_awgn(np.zeros(size, np.complex64), 1.0, seed=scenario.capture.seed, stream=21 + stream)


def _site_truth(receiver: PairReceiver) -> dict[str, Any]:
    position, velocity = (np.asarray(x, np.float64).reshape(3) for x in receiver.antenna.at(0.0))
    bias, drift = receiver.clock.at(0.0)
    return {
        "position_e_m": position.tolist(),
        "velocity_e_mps": velocity.tolist(),
        "clock_bias_s": float(bias),
        "clock_drift": float(drift),
    }


def _burst_truth(
    link: PairLink, heard: dict[str, SampledOrbit], one: Transmission, burst: iridium.Burst
) -> dict[str, Any]:
    carrier_hz = iridium.channel_frequency_hz(one.channel)
    truth = link.truth(heard[one.satellite], one.start_s + 0.5 * burst.duration_s, carrier_hz)
    return {
        "satellite": one.satellite,
        "kind": one.kind.name.lower(),
        "channel": one.channel,
        "carrier_hz": carrier_hz,
        "duration_s": burst.duration_s,
        "anchor_reading_s": float(truth.anchor.reading_s[0]),
        "target_reading_s": float(truth.target.reading_s[0]),
        "anchor_frequency_hz": float(truth.anchor.frequency_hz[0]),
        "target_frequency_hz": float(truth.target.frequency_hz[0]),
        "tdoa_s": float(truth.tdoa_s[0]),
        "fdoa_hz": float(truth.fdoa_hz[0]),
        "theta_m": float(truth.theta_m[0]),
        "alpha_mps": float(truth.alpha_mps[0]),
    }
