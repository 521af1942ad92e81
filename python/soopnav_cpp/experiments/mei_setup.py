"""What the mei experiments have in common: two receivers, 66 satellites, two clocks, bursts, and their measurements.

One burst per interval comes from one satellite at random of those above the mask at both receivers. Mode "iq" makes
each burst, sends it through two paths and two clocks into two recordings (`simulation.PairLink`) and measures those by
their cross-ambiguity; mode "drawn" takes the same exact truth and adds Gaussian noise of stated sigmas. Everything
follows from the seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp, geometry, iridium, orbits
from soopnav_cpp.clock import TwoState
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.simulation import ClockTrack, PairLink, PairReceiver, PairTruth

__all__ = [
    "CANBERRA",
    "HELSINKI",
    "OCXO",
    "SIGMAS_BOUND",
    "SIGMAS_PAPER",
    "TCXO",
    "Campaign",
    "Drive",
    "Setup",
    "World",
    "campaign",
    "drawn",
    "drive",
    "make_world",
    "measured",
]

Array = npt.NDArray[np.float64]
LIGHT_MPS = 299_792_458.0

HELSINKI = (math.radians(60.2), math.radians(25.0))
"""Latitude and longitude [rad]; 2.6 satellites in view on average."""
CANBERRA = (math.radians(-35.28), math.radians(149.13))
"""The paper's town; 1.7 satellites in view on average."""
OCXO = TwoState(8e-20, 4e-23)
"""Of either receiver."""
TCXO = TwoState(2e-19, 2e-20)
SIGMAS_PAPER = (2.73e-6, 2.19)
"""TDOA [s] and FDOA [Hz] between the paper's receivers A and B."""
SIGMAS_BOUND = (148e-9, 45e-3)
"""What Stein's bound gives for 90 ms at 10 dB."""


@dataclass(frozen=True)
class Setup:
    """A campaign before its seed.

    Attributes
    ----------
    site : (latitude_rad, longitude_rad)
        Of the anchor.
    height_m : float
        Of both above the ellipsoid; the target's differs by up to 50 m.
    separation_m : float
        Of the target at the start, at a random azimuth.
    duration_s, interval_s, jitter : float
        One burst per interval, moved by up to `jitter` intervals either way.
    mask_rad : float
    clock : clock.TwoState
        Of both receivers, independent.
    bias_s, drift : float
        Theta / c at time 0 is uniform within +-bias_s, alpha / c within +-drift; so are the anchor's own.
    skew : float or None
        Alpha / c at time 0 as it is, in place of a draw.
    height_sigma_m : float
        Of what is known about the target's height: one draw for all of the campaign.
    motion : "static", "drive" or SampledOrbit
        The target's; an orbit of its antenna over system time takes the place of site and separation.
    burst_s, snr_db, sample_rate_hz : float
        Mode "iq": bursts of random symbols, SNR of both in 25 kHz.
    along_track_m : float
        Standard deviation of how far each satellite really is ahead of the orbit that is known.
    """

    site: tuple[float, float] = HELSINKI
    height_m: float = 20.0
    separation_m: float = 10e3
    duration_s: float = 300.0
    interval_s: float = 1.0
    jitter: float = 0.3
    mask_rad: float = math.radians(8.0)
    clock: TwoState = OCXO
    bias_s: float = 1e-3
    drift: float = 1e-6
    skew: float | None = None
    height_sigma_m: float = 10.0
    motion: Literal["static", "drive"] | SampledOrbit = "static"
    burst_s: float = 32.5e-3
    snr_db: float = -5.4
    sample_rate_hz: float = 50e3
    along_track_m: float = 0.0


@dataclass(frozen=True)
class Drive:
    """A drive over the ellipsoid in the axes east, north, up of its start; rows of `t_s`."""

    t_s: Array
    position_l_m: Array
    velocity_l_mps: Array
    acceleration_l_mps2: Array
    heading_rad: Array
    frame: geometry.LocalFrame = field(repr=False)

    def orbit(self) -> SampledOrbit:
        """Its antenna over system time."""
        origin = self.frame.position_to_ecef(np.zeros(3))
        axes = self.frame.position_to_ecef(np.eye(3)) - origin
        return SampledOrbit(
            float(self.t_s[0]),
            float(self.t_s[1] - self.t_s[0]),
            self.frame.position_to_ecef(self.position_l_m),
            self.velocity_l_mps @ axes,
        )


@dataclass(frozen=True)
class World:
    """A campaign's truth.

    Attributes
    ----------
    setup : Setup
    beacons : list of SampledOrbit
        Orbits as they are known, of the satellites that a burst may come from; `sky` has them as they are.
    sky : list of SampledOrbit
    beacon : ndarray of int64, shape (n,)
    start_s : ndarray, shape (n,)
        When bursts leave their satellites, system time.
    link : simulation.PairLink
    carrier_hz : float
    anchor_p_e : ndarray, shape (3,)
    target : SampledOrbit
    truth : simulation.PairTruth
        Of the bursts' middles.
    position_e_m, velocity_e_mps : ndarray, shape (n, 3)
        Of the target when the bursts' middles reach the anchor.
    theta_m, alpha_mps : ndarray, shape (n,)
        Of the clocks, at the same instants.
    height_m : float
        What is known of the target's height above the ellipsoid at the start, its error drawn.
    drive : Drive or None
    seed : int
    """

    setup: Setup
    beacons: list[SampledOrbit]
    sky: list[SampledOrbit]
    beacon: npt.NDArray[np.int64]
    start_s: Array
    link: PairLink
    carrier_hz: float
    anchor_p_e: Array
    target: SampledOrbit
    truth: PairTruth
    position_e_m: Array
    velocity_e_mps: Array
    theta_m: Array
    alpha_mps: Array
    height_m: float
    drive: Drive | None
    seed: int

    @property
    def burst_s(self) -> float:
        """Length of a burst: whole symbols."""
        return math.floor(self.setup.burst_s * 25e3 + 0.5) / 25e3


@dataclass(frozen=True)
class Campaign:
    """What the tracker is told, one row per measured burst, and the world it came from.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Arrival at the anchor by the anchor's clock.
    beacon : ndarray of int64, shape (n,)
        Into `world.beacons`.
    tdoa_s, fdoa_hz : ndarray, shape (n,)
    covariance : ndarray, shape (n, 2, 2)
        Of both [s, Hz].
    row : ndarray of int64, shape (n,)
        Of the world's arrays: bursts that were not detected are left out.
    snr_db : ndarray, shape (n,)
        Post-correlation; NaN when drawn.
    world : World
    """

    t_s: Array
    beacon: npt.NDArray[np.int64]
    tdoa_s: Array
    fdoa_hz: Array
    covariance: Array
    row: npt.NDArray[np.int64]
    snr_db: Array
    world: World = field(repr=False)

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def tdoa_error_s(self) -> Array:
        """Measured less true."""
        return self.tdoa_s - self.world.truth.tdoa_s[self.row]

    @property
    def fdoa_error_hz(self) -> Array:
        """Measured less true."""
        return self.fdoa_hz - self.world.truth.fdoa_hz[self.row]


def drive(
    seed: int,
    start: tuple[float, float, float],
    duration_s: float,
    *,
    speed_mps: float = 15.0,
    acceleration_mps2: float = 3.0,
    step_s: float = 0.05,
) -> Drive:
    """A drive through streets: straights of 10 to 30 s, right-angled turns at full speed, every fourth corner a stop.

    Parameters
    ----------
    seed : int
    start : (latitude_rad, longitude_rad, height_m)
    duration_s : float
        Rows from -1 s, at rest in motion along the first street, to a second after the end.
    speed_mps, acceleration_mps2 : float
        Turns and braking both use the acceleration.
    step_s : float
    """
    rng = np.random.default_rng([seed, 0x6D65_6901])
    t: Array = -1.0 + step_s * np.arange(math.ceil((duration_s + 2.0) / step_s) + 1, dtype=np.float64)
    # Each leg: (until, along-track acceleration, turn rate).
    along, turn = np.zeros(len(t)), np.zeros(len(t))
    at, corner = -1.0, 0
    while at < t[-1]:
        at += rng.uniform(10.0, 30.0)
        corner += 1
        if corner % 4 == 0:
            brake, stand = speed_mps / acceleration_mps2, rng.uniform(5.0, 20.0)
            along[(t >= at) & (t < at + brake)] = -acceleration_mps2
            along[(t >= at + brake + stand) & (t < at + 2.0 * brake + stand)] = acceleration_mps2
            at += 2.0 * brake + stand
        else:
            rate = acceleration_mps2 / speed_mps
            turn[(t >= at) & (t < at + 0.5 * math.pi / rate)] = rng.choice([-1.0, 1.0]) * rate
            at += 0.5 * math.pi / rate
    speed = speed_mps + step_s * np.concatenate([[0.0], np.cumsum(along)[:-1]])
    speed = np.clip(speed, 0.0, speed_mps)
    heading = rng.uniform(-math.pi, math.pi) + step_s * np.concatenate([[0.0], np.cumsum(turn)[:-1]])
    ahead = np.stack([np.sin(heading), np.cos(heading)], axis=1)
    right = np.stack([np.cos(heading), -np.sin(heading)], axis=1)
    velocity = np.zeros((len(t), 3))
    velocity[:, :2] = speed[:, None] * ahead
    acceleration = np.zeros((len(t), 3))
    acceleration[:, :2] = along[:, None] * ahead + (speed * turn)[:, None] * right
    position = np.zeros((len(t), 3))
    position[1:] = np.cumsum(0.5 * step_s * (velocity[1:] + velocity[:-1]), axis=0)
    position -= position[round(1.0 / step_s)]
    # On the ellipsoid: 1 m below the plane at 3.6 km, and its slope in the velocity.
    level = 1.0 / 6.371e6
    position[:, 2] = -0.5 * level * np.sum(position[:, :2] ** 2, axis=1)
    velocity[:, 2] = -level * np.sum(position[:, :2] * velocity[:, :2], axis=1)
    return Drive(t, position, velocity, acceleration, heading, geometry.LocalFrame(*start))


def make_world(setup: Setup, seed: int) -> World:
    """The truth of a campaign: geometry, satellites, clocks and bursts."""
    rng = np.random.default_rng([seed, 0x6D65_6900])
    latitude, longitude = setup.site
    anchor = geometry.geodetic_to_ecef(latitude, longitude, setup.height_m)
    azimuth, height = rng.uniform(0.0, 2.0 * math.pi), setup.height_m + rng.uniform(-50.0, 50.0)
    place = geometry.LocalFrame(latitude, longitude, setup.height_m).position_to_geodetic(
        setup.separation_m * np.array([math.sin(azimuth), math.cos(azimuth), 0.0])
    )
    course: Drive | None = None
    if isinstance(setup.motion, SampledOrbit):
        target = setup.motion
    elif setup.motion == "drive":
        course = drive(seed, (float(place[0]), float(place[1]), height), setup.duration_s)
        target = course.orbit()
    else:
        target = SampledOrbit.fixed(geometry.geodetic_to_ecef(float(place[0]), float(place[1]), height))
    at_start = np.asarray(target.at(0.0)[0], np.float64).ravel()
    true_height = float(geometry.ecef_to_geodetic(at_start)[2])
    known_height = true_height + setup.height_sigma_m * rng.standard_normal()

    names = ("gmst_rad", "first_node_rad", "first_phase_rad")
    angles = {name: float(angle) for name, angle in zip(names, rng.uniform(0.0, 2.0 * math.pi, 3), strict=True)}
    sky = orbits.iridium_walker(setup.duration_s, **angles)
    # Bursts: by the instant when their middle reaches the anchor.
    slots = np.arange(math.floor(setup.duration_s / setup.interval_s))
    t = setup.interval_s * (slots + 0.5 + rng.uniform(-setup.jitter, setup.jitter, len(slots)))
    up = orbits.elevations(sky, t, anchor)[1] > setup.mask_rad
    up &= orbits.elevations(sky, t, at_start)[1] > setup.mask_rad
    lot = np.where(up, rng.uniform(size=up.shape), -1.0)
    heard = np.max(lot, axis=0) >= 0.0
    t, chosen = t[heard], np.argmax(lot, axis=0)[heard]
    kept, beacon = np.unique(chosen, return_inverse=True)
    sky = [sky[int(i)] for i in kept]
    known = sky
    if setup.along_track_m > 0.0:
        known = [_ahead(orbit, setup.along_track_m * rng.standard_normal()) for orbit in sky]

    bias, drift = rng.uniform(-setup.bias_s, setup.bias_s, 2), rng.uniform(-setup.drift, setup.drift, 2)
    if setup.skew is not None:
        drift[0] = setup.skew
    tracks = []
    for stream, (b, d) in enumerate(((bias[0] + bias[1], drift[0] + drift[1]), (bias[1], drift[1]))):
        series = setup.clock.simulate_at(
            np.concatenate([[0.0], t]), seed=seed, stream=0x6D65_6900 + stream, bias_s=float(b), drift=float(d)
        )
        tracks.append(ClockTrack.of(series, steady_s=min(0.1, 0.3 * setup.interval_s)))
    link = PairLink(
        PairReceiver(target, tracks[0]), PairReceiver(anchor, tracks[1]), sample_rate_hz=setup.sample_rate_hz
    )
    carrier_hz = iridium.RING_ALERT_HZ
    middle = link.sent_s(sky, t + tracks[1].at(t)[0], beacon)
    truth = link.truth(sky, middle, carrier_hz, beacon)
    position, velocity = target.at(t)
    (target_bias, target_drift), (anchor_bias, anchor_drift) = (track.at(t) for track in tracks)
    half = 0.5 * math.floor(setup.burst_s * 25e3 + 0.5) / 25e3
    return World(
        setup=setup,
        beacons=known,
        sky=sky,
        beacon=beacon.astype(np.int64).reshape(-1),
        start_s=middle - half,
        link=link,
        carrier_hz=carrier_hz,
        anchor_p_e=anchor,
        target=target,
        truth=truth,
        position_e_m=np.broadcast_to(position, (len(t), 3)),
        velocity_e_mps=np.broadcast_to(velocity, (len(t), 3)),
        theta_m=LIGHT_MPS * (target_bias - anchor_bias),
        alpha_mps=LIGHT_MPS * (target_drift - anchor_drift),
        height_m=known_height,
        drive=course,
        seed=seed,
    )


def _ahead(orbit: SampledOrbit, along_m: float) -> SampledOrbit:
    """An orbit whose real satellite is `along_m` ahead of it."""
    p, v = orbit.position_e_m, orbit.velocity_e_mps
    late_s = along_m / float(np.linalg.norm(v[0]))
    turn = np.array([0.0, 0.0, 7.2921151467e-5])
    # Back along the orbit in space: v is relative to the turning Earth.
    inertial = v + np.cross(turn, p)
    radius = np.linalg.norm(p, axis=1, keepdims=True)
    gravity = -3.986004418e14 * p / radius**3
    moved = p - late_s * inertial + 0.5 * late_s**2 * gravity
    inertial = inertial - late_s * gravity
    return SampledOrbit(orbit.start_s, orbit.step_s, moved, inertial - np.cross(turn, moved))


def drawn(world: World, sigmas: tuple[float, float]) -> Campaign:
    """Measurements from the exact model with independent Gaussian noise of sigmas [s, Hz]."""
    rng = np.random.default_rng([world.seed, 0x6D65_6902])
    n = len(world.start_s)
    noise = rng.standard_normal((n, 2)) * sigmas
    return Campaign(
        t_s=world.truth.anchor.reading_s,
        beacon=world.beacon,
        tdoa_s=world.truth.tdoa_s + noise[:, 0],
        fdoa_hz=world.truth.fdoa_hz + noise[:, 1],
        covariance=np.broadcast_to(np.diag(np.square(sigmas)), (n, 2, 2)).copy(),
        row=np.arange(n),
        snr_db=np.full(n, np.nan),
        world=world,
    )


def measured(world: World) -> Campaign:
    """Measurements by cross-ambiguity from the bursts' own samples.

    Both receivers open their windows when their own clock shows the same reading, up to half a millisecond early of
    what the schedule says at the anchor. Nothing of the truth is used. What the search knows: theta is within +-bias_s
    at time 0, alpha within +-drift, the receivers less than twice the separation apart, the burst's length and its 25
    ksym/s. It begins wide, and once three of five delays in a row agree follows their median with a narrower window
    (from which it falls back after five bursts without one). Each is measured with both snippets cut to its slot.
    """
    setup = world.setup
    rate = setup.sample_rate_hz
    far_s = 2.0 * setup.separation_m / LIGHT_MPS
    reach_s = setup.bias_s + setup.drift * setup.duration_s + far_s
    # Between bursts delays change by the geometry, which is another for each satellite, and by the skew.
    near_s = 2.0 * far_s + 10.0 * setup.drift * setup.interval_s + 20e-6
    reach_hz = world.carrier_hz * (setup.drift + 2.0 * setup.separation_m / 780e3 * 7.6e3 / LIGHT_MPS)
    guard_s = reach_s + near_s + 1e-3
    rng = np.random.default_rng([world.seed, 0x6D65_6903])
    opens = world.truth.anchor.reading_s - 0.5 * world.burst_s - guard_s - rng.uniform(0.0, 5e-4, len(world.start_s))
    opens = np.floor(opens * rate) / rate
    snippets = world.link.bursts(
        world.sky,
        world.beacon,
        start_s=world.start_s,
        carrier_hz=world.carrier_hz,
        duration_s=setup.burst_s,
        snr_db=setup.snr_db,
        target_start_s=opens,
        anchor_start_s=opens,
        samples=math.ceil((world.burst_s + 2.0 * guard_s + 5e-4) * rate),
        seed=world.seed,
        stream=0x6D65_6904,
    )
    begin = math.floor(guard_s * rate)
    slot = math.ceil((world.burst_s + 5e-4) * rate) + 1

    def search(i: int, shift: int, within_s: float, extra: int) -> dsp.CrossAmbiguityResult:
        """The burst in the slot and `extra` samples around it, the target's window moved by `shift` samples."""
        low, high = begin - extra, begin + slot + extra
        return dsp.cross_ambiguity(
            snippets.target[i, low + shift : high + shift],
            snippets.anchor[i, low:high],
            rate,
            max_delay_s=within_s,
            max_doppler_hz=reach_hz,
            symbol_rate_hz=25e3,
            rolloff=0.4,
            carrier_hz=world.carrier_hz,
        )

    rows, values, covariances, snr, epochs = [], [], [], [], []
    recent: list[float] = []
    missed = 0
    for i in range(len(snippets)):
        centre = float(np.median(recent[-5:])) if len(recent) >= 5 else math.inf
        following = missed < 5 and sum(abs(delay - centre) < near_s for delay in recent[-5:]) >= 3
        if following:
            shift = round(centre * rate)
        else:
            found = search(i, 0, reach_s, math.ceil(reach_s * rate))
            if not found.detected:
                continue
            shift = round(found.tdoa_s * rate)
        peak = search(i, shift, near_s, 0)
        if not peak.detected:
            missed += 1
            continue
        missed = 0
        delay = peak.tdoa_s + shift / rate
        recent.append(delay)
        rows.append(i)
        values.append((delay, peak.fdoa_hz))
        covariances.append(peak.covariance)
        snr.append(peak.snr_db)
        epochs.append(begin / rate + peak.epoch_s)
    row = np.array(rows, np.int64)
    value = np.array(values, np.float64).reshape(-1, 2)
    return Campaign(
        t_s=opens[row] + np.array(epochs, np.float64),
        beacon=world.beacon[row],
        tdoa_s=value[:, 0],
        fdoa_hz=value[:, 1],
        covariance=np.array(covariances, np.float64).reshape(-1, 2, 2),
        row=row,
        snr_db=np.array(snr, np.float64),
        world=world,
    )


def campaign(
    setup: Setup,
    seed: int,
    *,
    mode: Literal["iq", "drawn"] = "iq",
    sigmas: tuple[float, float] = SIGMAS_PAPER,
    **changes: object,
) -> Campaign:
    """A world and its measurements; `changes` are of the set-up.

    Parameters
    ----------
    setup : Setup
    seed : int
    mode : {"iq", "drawn"}
    sigmas : (sigma_tdoa_s, sigma_fdoa_hz)
        Of mode "drawn".
    """
    if mode not in ("iq", "drawn"):
        raise ValueError(f"mode: {mode!r}; 'iq' or 'drawn' expected")
    world = make_world(replace(setup, **changes), seed)  # type: ignore[arg-type]
    return measured(world) if mode == "iq" else drawn(world, sigmas)
