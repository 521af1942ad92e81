"""Several targets that share an anchor, for the mei experiments: noise and clock of the anchor are in all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp, geometry, iridium
from soopnav_cpp.experiments.mei_moving import axes_at
from soopnav_cpp.experiments.mei_setup import HELSINKI, LIGHT_MPS, SIGMAS_BOUND, Setup, make_world
from soopnav_cpp.geometry import LocalFrame, SampledOrbit
from soopnav_cpp.navigation import CooperativeGroup, GroupRun, PairBursts, pair_noise_shares
from soopnav_cpp.simulation import ClockTrack, PairLink, PairReceiver

Array = npt.NDArray[np.float64]

TARGETS = 3
SNR_DB = 10.0
START_SIGMA = np.array([300.0, 300.0, 10.0, 1e-3, 1e-3, 1e-3, 3000.0, 3.0])
"""Position and velocity east, north, up, theta [m], alpha [m/s]."""


@dataclass(frozen=True)
class Party:
    """Bursts that an anchor and three targets heard, and the truth."""

    beacons: list[SampledOrbit]
    bursts: list[PairBursts]  # of each target against the anchor
    truth: Array  # (n, targets, 8)
    setup: Setup


def party(seed: int) -> Party:
    """Helsinki, a burst each second for 300 s, three targets at rest 10 km from the anchor at random azimuths, four
    oscillators; noise of each recording drawn once and used in every row it belongs to."""
    setup = Setup(site=HELSINKI)
    world = make_world(setup, seed)
    rng = np.random.default_rng([seed, 0x6D65_6931])
    n = len(world.start_s)
    anchor = world.link.anchor
    latitude, longitude = setup.site
    frame = LocalFrame(latitude, longitude, setup.height_m)
    t = world.truth.anchor.t_s
    middle = world.start_s + 0.5 * world.burst_s
    tdoa, fdoa = np.empty((2, n, TARGETS))
    truth = np.zeros((n, TARGETS, 8))
    anchor_bias, anchor_drift = anchor.clock.at(t)
    for k in range(TARGETS):
        azimuth = rng.uniform(0.0, 2.0 * math.pi)
        place = frame.position_to_geodetic(setup.separation_m * np.array([math.sin(azimuth), math.cos(azimuth), 0.0]))
        position = geometry.geodetic_to_ecef(float(place[0]), float(place[1]), setup.height_m)
        series = setup.clock.simulate_at(
            np.concatenate([[0.0], t]),
            seed=seed,
            stream=0x6D65_6930 + k,
            bias_s=float(rng.uniform(-setup.bias_s, setup.bias_s)),
            drift=float(rng.uniform(-setup.drift, setup.drift)),
        )
        clock = ClockTrack.of(series, steady_s=0.1)
        link = PairLink(PairReceiver(position, clock), anchor, sample_rate_hz=setup.sample_rate_hz)
        exact = link.truth(world.sky, middle, world.carrier_hz, world.beacon)
        tdoa[:, k], fdoa[:, k] = exact.tdoa_s, exact.fdoa_hz
        bias, drift = clock.at(t)
        truth[:, k, :3] = position
        truth[:, k, 6], truth[:, k, 7] = LIGHT_MPS * (bias - anchor_bias), LIGHT_MPS * (drift - anchor_drift)
    # Each recording's own noise, and that of each product of two (cpp/doc/cooperative_motion.md eq. 9).
    first, second, both = np.sqrt(pair_noise_shares(SNR_DB, SNR_DB))
    of_anchor, of_target, of_pair = (
        rng.standard_normal((n, 1, 2)),
        rng.standard_normal((n, TARGETS, 2)),
        rng.standard_normal((n, TARGETS, 2)),
    )
    noise = np.array(SIGMAS_BOUND) * (first * of_target - second * of_anchor + both * of_pair)
    bursts = [
        PairBursts(
            world.truth.anchor.reading_s,
            world.beacon,
            tdoa[:, k] + noise[:, k, 0],
            fdoa[:, k] + noise[:, k, 1],
            np.diag(np.square(SIGMAS_BOUND)),
            np.array(world.carrier_hz),
            world.anchor_p_e,
        )
        for k in range(TARGETS)
    ]
    return Party(world.beacons, bursts, truth, setup)


@dataclass(frozen=True)
class Errors:
    """At the end of a run: errors of positions along the ground, and NEES of all states and of their differences."""

    ground_m: Array  # (targets, 2)
    nees: float
    apart: float  # of x_2 - x_1, x_3 - x_1
    together: float  # of the mean of all


def errors_of(run: GroupRun, truth: Array) -> Errors:
    """Of the last burst."""
    count = truth.shape[1]
    e = (run.mean[-1] - truth[-1]).ravel()
    assert run.covariance is not None
    P = run.covariance[-1]
    ground = np.array([(axes_at(truth[-1, k, :3]) @ e[8 * k : 8 * k + 3])[:2] for k in range(count)])

    def of(D: npt.NDArray[Any]) -> float:
        x = D @ e
        return float(x @ np.linalg.solve(D @ P @ D.T, x))

    if count == 1:
        return Errors(ground, of(np.eye(8)), math.nan, math.nan)
    weights = np.zeros((count - 1, count))
    weights[:, 0], weights[:, 1:] = -1.0, np.eye(count - 1)
    apart, together = np.kron(weights, np.eye(8)), np.kron(np.full((1, count), 1.0 / count), np.eye(8))
    return Errors(ground, of(np.eye(8 * count)), of(apart), of(together))


def followed(seed: int) -> dict[str, Errors]:
    """A party followed together, together as if nothing were shared, and each target alone."""
    who = party(seed)
    rng = np.random.default_rng([seed, 0x6D65_6932])
    clock = who.setup.clock
    starts = []
    for k in range(TARGETS):
        T = np.eye(8)
        T[:3, :3] = T[3:6, 3:6] = axes_at(who.truth[0, k, :3]).T
        first = who.truth[0, k].copy()
        first[6] -= first[7] * float(who.bursts[0].t_s[0])  # back to t = 0, but for a second of a wandering clock
        starts.append((first + T @ (START_SIGMA * rng.standard_normal(8)), T @ np.diag(START_SIGMA**2) @ T.T))

    def run(which: list[int], shared: bool) -> Errors:
        group = CooperativeGroup(
            who.beacons,
            0.0,
            target_clock=clock,
            anchor_clock=clock,
            gate_probability=0.0,
            shared_anchor_noise=shared,
            shared_anchor_clock=shared,
        )
        for k in which:
            group.join(*starts[k])
        heard = [who.bursts[k] for k in which]
        found = group.run(heard, np.full((len(which), 2), SNR_DB), covariance=True)
        return errors_of(found, who.truth[:, which])

    every = list(range(TARGETS))
    out = {"together": run(every, True), "apart": run(every, False)}
    alone = [run([k], True) for k in every]
    out["alone"] = Errors(
        np.concatenate([one.ground_m for one in alone]), sum(one.nees for one in alone), math.nan, math.nan
    )
    return out


def shared_noise(seed: int, trials: int, snr_db: float) -> Array:
    """Three recordings of one burst, 90 ms, noise of each its own: TDOA and FDOA errors of both targets against the
    anchor and of one target against the other, by their cross-ambiguities; shape (trials, 3, 2)."""
    rate_hz, symbol_hz = 50e3, 25e3
    rng = np.random.default_rng([seed, 0x6D65_6933, round(10.0 * snr_db)])
    n = round(94e-3 * rate_hz)
    t = np.arange(n) / rate_hz - 2e-3
    level = math.sqrt(10.0 ** (0.1 * snr_db) * symbol_hz / rate_hz)
    out = np.empty((trials, 3, 2))
    for k in range(trials):
        burst = iridium.make_burst(iridium.BurstKind.LONG, int(rng.integers(1 << 62)))
        clean = level * np.asarray(burst.at(t))
        heard = [
            (clean + math.sqrt(0.5) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))).astype(np.complex64)
            for _ in range(3)
        ]
        for i, (a, b) in enumerate(((0, 2), (1, 2), (0, 1))):
            peak = dsp.cross_ambiguity(
                heard[a], heard[b], rate_hz, max_delay_s=30e-6, max_doppler_hz=10.0, symbol_rate_hz=symbol_hz
            )
            out[k, i] = peak.tdoa_s, peak.fdoa_hz
    return out
