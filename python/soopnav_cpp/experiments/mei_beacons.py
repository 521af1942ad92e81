"""Beacons besides satellites for the mei experiments: FM stations around a target, and aircraft above it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp, geometry
from soopnav_cpp.experiments.mei_moving import axes_at
from soopnav_cpp.experiments.mei_setup import CANBERRA, LIGHT_MPS, SIGMAS_PAPER, TCXO, Setup, make_world
from soopnav_cpp.geometry import LocalFrame, SampledOrbit
from soopnav_cpp.navigation import CooperativeTracker, PairBursts, expected_pair
from soopnav_cpp.simulation import ClockTrack, PairLink, PairReceiver, fm_waveform

Array = npt.NDArray[np.float64]

FM_HZ, ADSB_HZ = 100e6, 1090e6
FM_SIGMAS = (0.5e-6, 0.5)
ADSB_SIGMAS = (0.1e-6, 20.0)
STEP_S, DURATION_S = 3.0, 300.0
START_SIGMA_M = 1000.0
FM_BURST_S, FM_SNR_DB, FM_RATE_HZ = 56e-3, -9.8, 250e3


@dataclass(frozen=True)
class Skies:
    """One start: satellites, stations and aircraft as they happen to be, and when the bursts come."""

    beacons: list[SampledOrbit]
    satellite: npt.NDArray[np.int64]  # of each slot
    t_s: Array
    anchor_e_m: Array
    target_e_m: Array
    height_m: float
    frame: LocalFrame
    stations_m: Array  # (3, 3) east, north, up of the target
    aircraft_m: Array  # (3, m, 3)


def skies(seed: int) -> Skies:
    """Canberra, a burst of one random satellite each three seconds, 10 km between the receivers; three stations of
    50 to 300 m at 15 to 50 km all around (120 ± 15 degrees apart), three aircraft at 9 to 11 km passing within 15."""
    setup = Setup(site=CANBERRA, interval_s=STEP_S, duration_s=DURATION_S, clock=TCXO)
    world = make_world(setup, seed)
    rng = np.random.default_rng([seed, 0x6D65_6921])
    target = np.asarray(world.target.at(0.0)[0], np.float64).ravel()
    latitude, longitude, height = (float(x) for x in geometry.ecef_to_geodetic(target))
    frame = LocalFrame(latitude, longitude, height)
    azimuth = rng.uniform(0.0, 2.0 * math.pi) + 2.0 * math.pi / 3.0 * (np.arange(3) + rng.uniform(-0.125, 0.125, 3))
    away = rng.uniform(15e3, 50e3, 3)
    stations = np.stack([away * np.sin(azimuth), away * np.cos(azimuth), rng.uniform(50.0, 300.0, 3)], axis=1)
    stations[:, 2] -= away**2 / (2.0 * 6.371e6)
    t = np.arange(-5.0, DURATION_S + 5.0, 1.0)
    courses = rng.uniform(0.0, 2.0 * math.pi) + 2.0 * math.pi / 3.0 * (np.arange(3) + rng.uniform(-0.25, 0.25, 3))
    aircraft = np.empty((3, len(t), 3))
    flying = []
    for i, heading in enumerate(courses):
        speed, side, middle = rng.uniform(200.0, 250.0), rng.uniform(-15e3, 15e3), rng.uniform(0.0, DURATION_S)
        along = speed * (t - middle)
        aircraft[i, :, 0] = along * math.sin(heading) + side * math.cos(heading)
        aircraft[i, :, 1] = along * math.cos(heading) - side * math.sin(heading)
        aircraft[i, :, 2] = rng.uniform(9e3, 11e3) - np.sum(aircraft[i, :, :2] ** 2, axis=1) / (2.0 * 6.371e6)
        position = frame.position_to_ecef(aircraft[i])
        flying.append(SampledOrbit(float(t[0]), 1.0, position, np.gradient(position, 1.0, axis=0)))
    beacons = [*world.beacons, *(SampledOrbit.fixed(frame.position_to_ecef(p)) for p in stations), *flying]
    arrival = world.truth.anchor.t_s
    return Skies(beacons, world.beacon, arrival, world.anchor_p_e, target, world.height_m, frame, stations, aircraft)


def bursts_with(sky: Skies, others: str) -> PairBursts:
    """The schedule without values: every third burst is of another beacon, "fm" or "aircraft" in turn; "" of none."""
    n = len(sky.t_s)
    beacon = sky.satellite.copy()
    carrier = np.full(n, 1626.25e6)
    sigmas = np.tile(SIGMAS_PAPER, (n, 1))
    if others:
        third = np.arange(2, n, 3)
        first = len(sky.beacons) - (6 if others == "fm" else 3)
        beacon[third] = first + np.arange(len(third)) % 3
        carrier[third] = FM_HZ if others == "fm" else ADSB_HZ
        sigmas[third] = FM_SIGMAS if others == "fm" else ADSB_SIGMAS
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = sigmas[:, 0] ** 2, sigmas[:, 1] ** 2
    return PairBursts(sky.t_s, beacon, np.zeros(n), np.zeros(n), covariance, carrier, sky.anchor_e_m)


@dataclass(frozen=True)
class Spread:
    """Of many runs from one start: horizontal errors at the end, what the trackers say, NEES of the plane."""

    error_m: Array  # (draws, 2)
    covariance_m2: Array  # (2, 2), the mean
    nees: float

    @property
    def rms_m(self) -> float:
        """Root of the mean squared horizontal error."""
        return float(np.sqrt(np.mean(np.sum(self.error_m**2, axis=1))))


def spreads(seed: int, draws: int) -> dict[str, Spread]:
    """From one start, runs with satellites alone, with FM stations, with aircraft; clocks and noise anew in each."""
    sky = skies(seed)
    rng = np.random.default_rng([seed, 0x6D65_6922])
    T = axes_at(sky.target_e_m)
    prior = np.zeros((8, 8))
    prior[:3, :3] = T.T @ np.diag([START_SIGMA_M**2, START_SIGMA_M**2, 10.0**2]) @ T
    prior[3:6, 3:6] = 1e-6 * np.eye(3)
    prior[6, 6], prior[7, 7] = 1000.0**2, 1.0
    n = len(sky.t_s)
    out = {}
    for others in ("", "fm", "aircraft"):
        schedule = bursts_with(sky, others)
        sigma = np.sqrt(schedule.covariance[:, [0, 1], [0, 1]])
        error, P = np.empty((draws, 2)), np.zeros((2, 2))
        nees = 0.0
        for k in range(draws):
            times = np.concatenate([[0.0], sky.t_s])
            clocks = [TCXO.simulate_at(times, seed=int(rng.integers(1 << 62)), stream=s) for s in (0, 1)]
            alpha0 = 300.0 * rng.uniform(-1.0, 1.0)
            theta = LIGHT_MPS * (clocks[0].bias_s - clocks[1].bias_s) + alpha0 * times
            alpha = LIGHT_MPS * (clocks[0].drift - clocks[1].drift) + alpha0
            truth = np.zeros((n, 8))
            truth[:, :3], truth[:, 6], truth[:, 7] = sky.target_e_m, theta[1:], alpha[1:]
            tdoa, fdoa = expected_pair(sky.beacons, schedule, truth)
            noise = sigma * rng.standard_normal((n, 2))
            heard = PairBursts(
                sky.t_s, schedule.beacon, tdoa + noise[:, 0], fdoa + noise[:, 1], schedule.covariance,
                schedule.carrier_hz, sky.anchor_e_m,
            )  # fmt: skip
            tracker = CooperativeTracker(sky.beacons, target_clock=TCXO, anchor_clock=TCXO, gate_probability=0.0,
                                         jump_after=0, iterations=3)  # fmt: skip
            off = np.linalg.cholesky(prior) @ rng.standard_normal(8)
            tracker.start_at(0.0, np.concatenate([sky.target_e_m, np.zeros(3), [theta[0], alpha[0]]]) + off, prior)
            tracker.run(heard)
            e = (T @ (tracker.mean[:3] - sky.target_e_m))[:2]
            cov = (T @ tracker.covariance[:3, :3] @ T.T)[:2, :2]
            error[k], P = e, P + cov / draws
            nees += float(e @ np.linalg.solve(cov, e)) / draws
        out[others or "satellites"] = Spread(error, P, nees)
    return out


def fm_errors(seed: int, trials: int) -> Array:
    """An FM station heard by two receivers with clocks of their own: errors [s, Hz] of what its waveform says."""
    frame = LocalFrame(*CANBERRA, 600.0)
    rng = np.random.default_rng([seed, 0x6D65_6923])
    out = np.empty((trials, 2))
    for k in range(trials):
        azimuth, away = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(15e3, 50e3)
        mast = SampledOrbit.fixed(frame.position_to_ecef([away * math.sin(azimuth), away * math.cos(azimuth), 100.0]))
        place = np.array([*rng.uniform(-5e3, 5e3, 2), 0.0])
        receivers = [
            PairReceiver(frame.position_to_ecef(at), ClockTrack.steady(*(rng.uniform(-1.0, 1.0, 2) * (1e-5, 1e-6))))
            for at in (place, np.zeros(3))
        ]
        link = PairLink(*receivers, sample_rate_hz=FM_RATE_HZ, center_hz=FM_HZ)
        heard = link.burst(
            fm_waveform(FM_BURST_S + 0.01, 2.0 * FM_RATE_HZ, seed=int(rng.integers(1 << 62))),
            mast,
            start_s=0.0,
            carrier_hz=FM_HZ,
            snr_db=FM_SNR_DB,
            snr_bandwidth_hz=200e3,
            target_start_s=5e-3,
            anchor_start_s=5e-3,
            samples=round(FM_BURST_S * FM_RATE_HZ),
            waveform_rate_hz=2.0 * FM_RATE_HZ,
            seed=int(rng.integers(1 << 62)),
        )
        # The search knows that clocks agree within 20 us and 2 ppm, and the receivers' distance.
        peak = dsp.cross_ambiguity(
            heard.target[0],
            heard.anchor[0],
            FM_RATE_HZ,
            max_delay_s=50e-6,
            max_doppler_hz=250.0,
            bandwidth_hz=200e3,
            center_a_hz=0.0,
            center_b_hz=0.0,
            carrier_hz=FM_HZ,
        )
        out[k] = peak.tdoa_s - heard.truth.tdoa_s[0], peak.fdoa_hz - heard.truth.fdoa_hz[0]
    return out
