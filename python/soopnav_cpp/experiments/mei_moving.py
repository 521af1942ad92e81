"""Targets that drive, for the mei experiments: a course with its inertial unit, starts, and runs of the trackers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry
from soopnav_cpp.experiments.mei_setup import Campaign, Setup, World, drawn, drive, make_world, measured
from soopnav_cpp.geometry import LocalFrame, SampledOrbit
from soopnav_cpp.inertial import ImuNoise
from soopnav_cpp.navigation import (
    CooperativeRun,
    CooperativeTracker,
    InertialTracker,
    InertialUnit,
    ManoeuvringTracker,
    PairBursts,
)
from soopnav_cpp.simulation import SpatialTrajectory

__all__ = [
    "CONSUMER",
    "INDUSTRIAL",
    "Course",
    "Grade",
    "Track",
    "bursts_of",
    "course",
    "ground_errors",
    "moving_campaign",
    "start_of",
    "tracks",
]

Array = npt.NDArray[np.float64]

KNOT_S = 0.5
LEAD_S = 1.0
IMU_RATE_HZ = 100.0
START_SIGMA = np.array([30.0, 30.0, 10.0, 1.0, 1.0, 0.1, 300.0, 0.1])
"""What is known at the start: position and velocity east, north, up, theta [m], alpha [m/s]: what five minutes at rest
leave (mei-static), and a glance at the speedometer."""


@dataclass(frozen=True)
class Grade:
    """An inertial unit by its standard deviations at the start and its white noises."""

    accelerometer_bias_mps2: float
    accelerometer_density: float
    heading_rad: float
    gyro_bias_radps: float
    gyro_density: float
    tilt_rad: float


INDUSTRIAL = Grade(0.02, 1e-3, math.radians(1.0), math.radians(5.0) / 3600.0, math.radians(0.15) / 60.0, 2e-3)
CONSUMER = Grade(0.1, 3e-3, math.radians(3.0), math.radians(50.0) / 3600.0, math.radians(0.6) / 60.0, 1e-2)


@dataclass(frozen=True)
class Course:
    """A drive as a smooth path, which an inertial unit can be carried along: times of the path are `LEAD_S` later."""

    path: SpatialTrajectory
    orbit: SampledOrbit

    @property
    def frame(self) -> LocalFrame:
        """East, north, up of the start."""
        return self.path.frame

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Position and velocity in ECEF."""
        motion = self.path.at(t_s + LEAD_S)
        return self.frame.position_to_ecef(motion.position_m), motion.velocity_mps @ _axes_of(self.frame)


def course(seed: int, setup: Setup) -> Course:
    """A drive of `mei_setup.drive` through a spline of degree 5, knots each half second: turns and braking at up to
    3 m/s² set in within a second."""
    latitude, longitude = setup.site
    rng = np.random.default_rng([seed, 0x6D65_6911])
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    place = LocalFrame(latitude, longitude, setup.height_m).position_to_geodetic(
        setup.separation_m * np.array([math.sin(azimuth), math.cos(azimuth), 0.0])
    )
    length_s = setup.duration_s + 8.0
    raw = drive(seed, (float(place[0]), float(place[1]), setup.height_m), length_s)
    every = round(KNOT_S / float(raw.t_s[1] - raw.t_s[0]))
    path = SpatialTrajectory(raw.frame, raw.position_l_m[::every], KNOT_S)
    # The path begins 2.5 knots into its control points, and those a second early.
    step_s = 0.05
    t = np.arange(0.0, min(path.duration_s, setup.duration_s + 3.0), step_s)
    motion = path.at(t)
    return Course(
        path,
        SampledOrbit(
            -LEAD_S,
            step_s,
            raw.frame.position_to_ecef(motion.position_m),
            motion.velocity_mps @ _axes_of(raw.frame),
        ),
    )


def moving_campaign(
    setup: Setup, seed: int, mode: Literal["iq", "drawn"], sigmas: tuple[float, float]
) -> tuple[Course, Campaign]:
    """A course and what the tracker is told of it."""
    way = course(seed, setup)
    world = make_world(replace(setup, motion=way.orbit), seed)
    return way, measured(world) if mode == "iq" else drawn(world, sigmas)


def bursts_of(campaign: Campaign) -> PairBursts:
    """A campaign as the trackers take it."""
    return PairBursts(
        t_s=campaign.t_s,
        beacon=campaign.beacon,
        tdoa_s=campaign.tdoa_s,
        fdoa_hz=campaign.fdoa_hz,
        covariance=campaign.covariance,
        carrier_hz=np.array(campaign.world.carrier_hz),
        anchor_position_e_m=campaign.world.anchor_p_e,
    )


def _axes_of(frame: LocalFrame) -> Array:
    """East, north, up in ECEF, one row each."""
    return np.asarray(frame.position_to_ecef(np.eye(3)) - frame.position_to_ecef(np.zeros(3)), np.float64)


def axes_at(p_e: Array) -> Array:
    """Rotation from ECEF to east, north, up at a position."""
    latitude, longitude, _ = geometry.ecef_to_geodetic(p_e)
    return _axes_of(LocalFrame(float(latitude), float(longitude), 0.0))


def start_of(way: Course, world: World, seed: int) -> tuple[Array, Array]:
    """A start of the trackers at t = 0, off by `START_SIGMA`: mean and covariance."""
    p, v = way.at(np.zeros(1))
    target, anchor = world.link.target.clock.at(0.0), world.link.anchor.clock.at(0.0)
    light = 299_792_458.0
    clocks = [light * (float(target[0]) - float(anchor[0])), light * (float(target[1]) - float(anchor[1]))]
    truth = np.concatenate([p[0], v[0], clocks])
    T = np.eye(8)
    T[:3, :3] = T[3:6, 3:6] = axes_at(p[0]).T
    error = START_SIGMA * np.random.default_rng([seed, 0x6D65_6912]).standard_normal(8)
    return truth + T @ error, T @ np.diag(START_SIGMA**2) @ T.T


def inertial_of(way: Course, grade: Grade, duration_s: float, seed: int) -> tuple[InertialUnit, Array, Array, Array]:
    """A unit that begins wrong, and its samples: times, increments of angle and velocity."""
    rng = np.random.default_rng([seed, 0x6D65_6913])
    theta, velocity = way.path.imu_increments(IMU_RATE_HZ, start_s=LEAD_S, end_s=LEAD_S + duration_s)
    n, dt = len(theta), 1.0 / IMU_RATE_HZ
    theta = theta + dt * grade.gyro_bias_radps * rng.standard_normal(3)
    theta += grade.gyro_density * math.sqrt(dt) * rng.standard_normal((n, 3))
    velocity = velocity + dt * grade.accelerometer_bias_mps2 * rng.standard_normal(3)
    velocity += grade.accelerometer_density * math.sqrt(dt) * rng.standard_normal((n, 3))
    _, _, quaternion = way.path.navigation_states(np.array([LEAD_S]))
    about = np.array([grade.tilt_rad, grade.tilt_rad, grade.heading_rad]) * rng.standard_normal(3)
    unit = InertialUnit(
        noise=ImuNoise(gyro_density=grade.gyro_density, accelerometer_density=grade.accelerometer_density),
        period_s=dt,
        quaternion=_turned(about, quaternion[0]),
        tilt_sigma_rad=grade.tilt_rad,
        heading_sigma_rad=grade.heading_rad,
        gyro_bias_sigma_radps=grade.gyro_bias_radps,
        accelerometer_bias_sigma_mps2=grade.accelerometer_bias_mps2,
    )
    return unit, np.asarray(dt * (1.0 + np.arange(n)), np.float64), theta, velocity


def _turned(about_rad: Array, q: Array) -> Array:
    """A quaternion after a small rotation about the axes it leads to."""
    angle = float(np.linalg.norm(about_rad))
    w, (x, y, z) = math.cos(0.5 * angle), math.sin(0.5 * angle) * about_rad / angle
    a, b, c, d = q
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )


@dataclass(frozen=True)
class Track:
    """What a tracker made of a drive, at its bursts."""

    t_s: Array
    error_m: Array  # (n, 2) east, north
    covariance_m2: Array  # (n, 2, 2) of them
    nees: Array  # of horizontal position and velocity: 4 where the filter is right
    modes: Array = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def distance_m(self) -> Array:
        """Horizontal error, shape (n,)."""
        return np.asarray(np.linalg.norm(self.error_m, axis=1))


def ground_errors(t_s: Array, mean: Array, covariance: Array, truth: tuple[Array, Array]) -> Track:
    """Errors of position and velocity along the ground, and their NEES."""
    n = len(t_s)
    T = np.zeros((n, 4, 6))
    axes = axes_at(truth[0][0])[:2]
    T[:, :2, :3] = T[:, 2:, 3:] = axes
    error = np.concatenate([mean[:, :3] - truth[0], mean[:, 3:6] - truth[1]], axis=1)
    local = (T @ error[..., None])[..., 0]
    P = T @ covariance[:, :6, :6] @ np.swapaxes(T, 1, 2)
    nees = np.sum(local * np.linalg.solve(P, local[..., None])[..., 0], axis=1)
    return Track(t_s, local[:, :2], P[:, :2, :2], nees)


def tracks(
    way: Course, campaign: Campaign, seed: int, *, grades: dict[str, Grade] | None = None, modes: bool = False
) -> dict[str, Track]:
    """Four trackers and more on the same bursts: "static", "straight" (constant velocity, 0.01 m²/s³), "two motions",
    and one for each inertial unit. Nothing is gated: each has to live with what it gets."""
    world = campaign.world
    bursts = bursts_of(campaign)
    mean, P = start_of(way, world, seed)
    options: dict[str, Any] = {
        "target_clock": world.setup.clock,
        "anchor_clock": world.setup.clock,
        "gate_probability": 0.0,
        "jump_after": 0,
        "height_m": world.height_m,
        "height_sigma_m": world.setup.height_sigma_m,
    }
    stands = P.copy()
    stands[3:6] = stands[:, 3:6] = 0.0
    stands[3:6, 3:6] = 1e-6 * np.eye(3)
    still = mean.copy()
    still[3:6] = 0.0
    truth = world.position_e_m[campaign.row], world.velocity_e_mps[campaign.row]
    static = CooperativeTracker(world.beacons, motion="static", **options)
    straight = CooperativeTracker(
        world.beacons, motion="nearly_constant_velocity", acceleration_psd_m2ps3=0.01, **options
    )
    two = ManoeuvringTracker(world.beacons, **options)
    out: dict[str, Track] = {}

    def keep(name: str, run: CooperativeRun, probabilities: Array | None = None) -> None:
        track = ground_errors(campaign.t_s, run.mean, run.covariance, truth)
        out[name] = track if probabilities is None else replace(track, modes=probabilities)

    static.start_at(0.0, still, stands)
    keep("static", static.run(bursts))
    straight.start_at(0.0, mean, P)
    keep("straight", straight.run(bursts))
    two.start_at(0.0, mean, P)
    if modes:
        parts, probabilities = [], []
        for i in range(len(bursts)):
            parts.append(two.run(bursts[i : i + 1]))
            probabilities.append(two.mode_probabilities)
        mean_of, P_of = (np.concatenate([getattr(p, k) for p in parts]) for k in ("mean", "covariance"))
        out["two motions"] = replace(
            ground_errors(campaign.t_s, mean_of, P_of, truth), modes=np.array(probabilities, np.float64)
        )
    else:
        keep("two motions", two.run(bursts))
    for name, grade in (grades or {}).items():
        unit, t_s, theta, velocity = inertial_of(way, grade, world.setup.duration_s + 1.0, seed)
        tracker = InertialTracker(world.beacons, unit=unit, **options)
        tracker.start_at(0.0, mean, P)
        tracker.add_imu(t_s, theta, velocity)
        keep(name, tracker.run(bursts))
    return out
