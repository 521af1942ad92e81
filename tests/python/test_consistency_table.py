"""Every filter on every measurement model: errors and innovations are as large as the filter says.

Truth and measurements come from formulas of this file, the prior and all noise are those the filter is told. NEES: of
the last step, over independent runs. NIS: over all steps, as innovations of a right filter are independent; of particle
filters that of the last step, from the cloud before it is weighed. Both are chi-square, and the chance that right
filters leave any of the bounds of the table is 1e-4.

Linearisation is valid in every case: a prior standard deviation s at a distance d bends a range by s²/2d, here at most
a hundredth of the range's noise; angles are uncertain by s/d and headings by 0.02 rad, so that the second order is
below a thirtieth of the noise. Where a case has other numbers, a comment says so.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from soopnav_cpp import estimation, measurement, process

stats = pytest.importorskip("scipy.stats")
pytestmark = pytest.mark.consistency

Array = npt.NDArray[np.float64]

C = 299_792_458.0
TIMES = np.array([0.5, 1.2, 1.6, 2.4, 2.9])  # from 0; uneven, so that noise of the wrong step is seen
RUNS, PARTICLE_RUNS = 500, 200

KALMAN = {
    "ekf": estimation.ExtendedKalmanFilter,
    "iekf": estimation.IteratedKalmanFilter,
    "ukf": estimation.UnscentedKalmanFilter,
    "srkf": estimation.SquareRootKalmanFilter,
    "information": estimation.InformationFilter,
}
# Variants of the particle filter; where each serves is a choice of its user, consistent they must be anywhere.
PARTICLES: dict[str, dict[str, Any]] = {
    "particles": {},
    "particles, looking ahead": {"auxiliary": True},
    "particles, spread copies": {"regularisation": 1.0},
    "particles, adaptive count": {"adaptive": True},
}


# ---- how the truth moves: (generator, states (N, n), step, input) -> states


Move = Callable[[np.random.Generator, Array, float, Array], Array]


def walks(psd: npt.ArrayLike) -> Move:
    return lambda rng, x, dt, u: x + np.sqrt(np.asarray(psd) * dt) * rng.standard_normal(x.shape)


def _driven(rng, x, at, rate, dt, low, high):
    """x[at] is the integral of x[rate]; white noise of density `low` on it and `high` on its rate."""
    Q = [[low * dt + high * dt**3 / 3, high * dt**2 / 2], [high * dt**2 / 2, high * dt]]
    noise = rng.multivariate_normal([0.0, 0.0], Q, len(x))
    x[:, at] += dt * x[:, rate] + noise[:, 0]
    x[:, rate] += noise[:, 1]


def cruises(dim: int, psd: float, clock: tuple[float, float] | None = None, bias_psd: float = 0.0) -> Move:
    def move(rng, x, dt, u):
        x = x.copy()
        for axis in range(dim):
            _driven(rng, x, axis, dim + axis, dt, 0.0, psd)
        if clock is not None:
            _driven(rng, x, 2 * dim, 2 * dim + 1, dt, *clock)
        if bias_psd > 0.0:
            x[:, 2 * dim] += np.sqrt(bias_psd * dt) * rng.standard_normal(len(x))
        return x

    return move


def jerks(sigma: float) -> Move:
    """In a plane, with an acceleration that is constant during each step."""

    def move(rng, x, dt, u):
        a = sigma * rng.standard_normal((len(x), 2))
        return np.hstack([x[:, :2] + dt * x[:, 2:] + dt**2 / 2 * a, x[:, 2:] + dt * a])

    return move


def turns(psd: float, rate_psd: float) -> Move:
    """The stochastic differential equation of a coordinated turn, in 50 small steps."""

    def move(rng, x, dt, u):
        x, h = x.copy(), dt / 50
        for _ in range(50):
            w = rng.standard_normal((len(x), 3)) * np.sqrt(h)
            angle = h * x[:, 4]
            vx = np.cos(angle) * x[:, 2] - np.sin(angle) * x[:, 3] + np.sqrt(psd) * w[:, 0]
            vy = np.sin(angle) * x[:, 2] + np.cos(angle) * x[:, 3] + np.sqrt(psd) * w[:, 1]
            x[:, 0] += h / 2 * (x[:, 2] + vx)
            x[:, 1] += h / 2 * (x[:, 3] + vy)
            x[:, 2], x[:, 3] = vx, vy
            x[:, 4] += np.sqrt(rate_psd) * w[:, 2]
        return x

    return move


def rolls(covariance: Array) -> Move:
    def move(rng, x, dt, u):
        du = u + rng.multivariate_normal(np.zeros(3), covariance, len(x))
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        return x + np.column_stack([c * du[:, 0] - s * du[:, 1], s * du[:, 0] + c * du[:, 1], du[:, 2]])

    return move


def flies(gyro: float, accelerometer: float) -> Move:
    def move(rng, x, dt, u):
        felt = u + rng.standard_normal((len(x), 3)) * [gyro, accelerometer, accelerometer]
        c, s = np.cos(x[:, 0]), np.sin(x[:, 0])
        a = np.column_stack([c * felt[:, 1] - s * felt[:, 2], s * felt[:, 1] + c * felt[:, 2]])
        v, p = x[:, 1:3], x[:, 3:5]
        return np.hstack([x[:, :1] + dt * felt[:, :1], v + dt * a, p + dt * v + dt**2 / 2 * a])

    return move


# ---- what is measured: functions of states (N, n)


def far(p: Array, q: npt.ArrayLike) -> Array:
    return np.sqrt(np.sum((p - np.asarray(q)) ** 2, axis=1))


def receding(p: Array, v: Array, q: npt.ArrayLike, vq: npt.ArrayLike = 0.0) -> Array:
    return np.sum((p - np.asarray(q)) * (v - np.asarray(vq)), axis=1) / far(p, q)


def rows(*columns: Array) -> Array:
    return np.column_stack(columns)


def wrap(angle: Array) -> Array:
    return np.arctan2(np.sin(angle), np.cos(angle))


def east_of_north(p: Array, q: npt.ArrayLike) -> Array:
    return np.arctan2(q[0] - p[:, 0], q[1] - p[:, 1])


def above(p: Array, q: npt.ArrayLike) -> Array:
    return np.arctan2(q[2] - p[:, 2], np.hypot(q[0] - p[:, 0], q[1] - p[:, 1]))


# ---- cases


@dataclass(frozen=True)
class Case:
    name: str
    state: str
    x0: list[float]
    sigma0: list[float]  # of the prior
    move: Move
    process: process.Process
    models: list[measurement.Measurement]
    h: Callable[[Array], Array]
    R: Array
    input: list[float] = field(default_factory=list)  # the same at each step
    heading: int | None = None  # component of the state that is an angle
    angles: list[int] = field(default_factory=list)  # rows that are

    @property
    def inputs(self) -> Array | None:
        return np.tile(self.input, (len(TIMES), 1)) if self.input else None


def full(sigma: float, m: int) -> Array:
    """Of m differences with one reference."""
    return sigma**2 * (np.eye(m) + np.ones((m, m))) / 2


PLANE = np.array([[900.0, 100.0], [-300.0, 800.0], [-400.0, -700.0], [600.0, -800.0]])
SPACE = np.array([[900.0, 100.0, 300.0], [-300.0, 800.0, 100.0], [-400.0, -700.0, 500.0], [600.0, -800.0, -600.0]])
REF2, REF3 = np.array([100.0, -350.0]), np.array([100.0, -350.0, 80.0])
V2, V3 = np.array([15.0, -20.0]), np.array([15.0, -20.0, 5.0])  # of sources that move
VREF2, VREF3 = np.array([-5.0, 10.0]), np.array([-5.0, 10.0, 2.0])
GHZ = 1e9
PER_MPS = GHZ / C  # Hz for each m/s

P2, P3 = [10.0, -20.0], [10.0, -20.0, 5.0]
PV2, PV3 = [*P2, 4.0, 3.0], [*P3, 4.0, 3.0, -1.0]
S2, S3 = [2.0, 2.0], [2.0, 2.0, 2.0]
SV2, SV3 = [*S2, 0.5, 0.5], [*S3, 0.5, 0.5, 0.5]
CLOCK = (0.5, 0.05)
ODOMETRY = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.001], [0.0, 0.001, 4e-4]])
INS = process.PlanarMechanization(gyro_sigma_radps=0.02, accelerometer_sigma_mps2=0.5)

walk2 = {"move": walks([1.0, 0.5]), "process": process.RandomWalk([1.0, 0.5])}
walk3 = {"move": walks([1.0, 0.5, 0.3]), "process": process.RandomWalk([1.0, 0.5, 0.3])}
walk2c = {"move": walks([1.0, 0.5, 2.0]), "process": process.RandomWalk([1.0, 0.5, 2.0])}
walk3c = {"move": walks([1.0, 0.5, 0.3, 2.0]), "process": process.RandomWalk([1.0, 0.5, 0.3, 2.0])}
cruise2 = {"move": cruises(2, 0.5), "process": process.NearlyConstantVelocity(0.5)}
cruise3 = {"move": cruises(3, 0.5), "process": process.NearlyConstantVelocity(0.5)}
cruise2c = {"move": cruises(2, 0.5, CLOCK), "process": process.NearlyConstantVelocity(0.5, clock=CLOCK)}
cruise3c = {"move": cruises(3, 0.5, CLOCK), "process": process.NearlyConstantVelocity(0.5, clock=CLOCK)}
roll = {"move": rolls(ODOMETRY), "process": process.PlanarOdometry(ODOMETRY), "input": [1.5, 0.2, 0.3], "heading": 2}
at2 = {"x0": P2, "sigma0": S2, "state": "position2", **walk2}
at3 = {"x0": P3, "sigma0": S3, "state": "position3", **walk3}
moving2 = {"x0": PV2, "sigma0": SV2, "state": "position_velocity2", **cruise2}
moving3 = {"x0": PV3, "sigma0": SV3, "state": "position_velocity3", **cruise3}
timed2 = {"x0": [*P2, 30.0], "sigma0": [*S2, 3.0], "state": "position_clock2", **walk2c}
timed3 = {"x0": [*P3, 30.0], "sigma0": [*S3, 3.0], "state": "position_clock3", **walk3c}
drifting2 = {"x0": [*PV2, 30.0, 2.0], "sigma0": [*SV2, 3.0, 0.5], "state": "position_velocity_clock2", **cruise2c}
drifting3 = {"x0": [*PV3, 30.0, 2.0], "sigma0": [*SV3, 3.0, 0.5], "state": "position_velocity_clock3", **cruise3c}
posed = {"x0": [*P2, 3.1], "sigma0": [*S2, 0.02], "state": "pose2", **roll}  # the heading goes round


def cases() -> list[Case]:
    m = measurement
    spread2 = np.array([[1.0, 0.4], [0.4, 2.0]])
    return [
        # Linear: no regime to state.
        Case("position fix 1-D", x0=[3.0], sigma0=[2.0], state="position1", move=walks(0.7), R=1.5 * np.eye(1),
             process=process.RandomWalk(0.7), models=[m.Position(1)], h=lambda x: x),
        Case("position fix 1-D, moving", x0=[3.0, 1.0], sigma0=[2.0, 0.5], state="position_velocity1", R=np.eye(1),
             move=cruises(1, 0.4), process=process.NearlyConstantVelocity(0.4), models=[m.Position(1)],
             h=lambda x: x[:, :1]),
        Case("position fix 2-D", **moving2, models=[m.Position(2)], h=lambda x: x[:, :2], R=spread2),
        Case("position fix 3-D", **at3, models=[m.Position(3)], h=lambda x: x, R=full(1.5, 3)),
        # Ranges: 2 m at 700 m and more, against 1 m.
        Case("range 2-D", **at2, models=[m.Range(q) for q in PLANE[:2]], R=np.eye(2),
             h=lambda x: rows(far(x, PLANE[0]), far(x, PLANE[1]))),
        Case("range 3-D", **moving3, models=[m.Range(q) for q in SPACE[:3]], R=np.diag([1.0, 2.0, 1.5]),
             h=lambda x: rows(*(far(x[:, :3], q) for q in SPACE[:3]))),
        Case("range, coordinated turn", state="coordinated_turn", x0=[*PV2, 0.3], sigma0=[*SV2, 0.02],
             move=turns(0.3, 1e-4), process=process.CoordinatedTurn(0.3, 1e-4), R=np.eye(2),
             models=[m.Range(q) for q in PLANE[:2]], h=lambda x: rows(*(far(x[:, :2], q) for q in PLANE[:2]))),
        Case("range, jerks", **{**moving2, "move": jerks(1.0), "process": process.PiecewiseConstantAcceleration(1.0)},
             models=[m.Range(q) for q in PLANE[1:3]], R=np.eye(2),
             h=lambda x: rows(*(far(x[:, :2], q) for q in PLANE[1:3]))),
        Case("pseudorange 2-D", **timed2, models=[m.Pseudorange(q, source_clock_m=7.0) for q in PLANE[:3]],
             h=lambda x: rows(*(far(x[:, :2], q) + x[:, 2] - 7.0 for q in PLANE[:3])), R=2.0 * np.eye(3)),
        Case("pseudorange 3-D", **drifting3, models=[m.Pseudorange(q) for q in SPACE], R=2.0 * np.eye(4),
             h=lambda x: rows(*(far(x[:, :3], q) + x[:, 6] for q in SPACE))),
        Case("pseudorange, bias only", state="position_velocity_bias2", x0=[*PV2, 30.0], sigma0=[*SV2, 3.0],
             move=cruises(2, 0.5, bias_psd=0.6), models=[m.Pseudorange(q) for q in PLANE[:3]], R=2.0 * np.eye(3),
             process=process.NearlyConstantVelocity(0.5, diffusion_psd=[0.0, 0.0, 0.0, 0.0, 0.6]),
             h=lambda x: rows(*(far(x[:, :2], q) + x[:, 4] for q in PLANE[:3]))),
        # Headings of 0.02 rad and a force of 2 m/s² over 4 s: a bend of 0.3 mm/s², below a hundredth of the noise.
        Case("range difference 2-D", state="planar_inertial", x0=[3.1, 4.0, 3.0, *P2], sigma0=[0.02, 0.5, 0.5, *S2],
             move=flies(0.02, 0.5), process=INS, input=[0.2, 1.5, -1.0], heading=0, R=np.eye(3),
             models=[m.RangeDifference(q, REF2) for q in PLANE[:3]],
             h=lambda x: rows(*(far(x[:, 3:], q) - far(REF2[None], q)[0] for q in PLANE[:3]))),
        Case("range difference 3-D", **at3, models=[m.RangeDifference(q, REF3) for q in SPACE[:2]], R=np.eye(2),
             h=lambda x: rows(*(far(x, q) - far(REF3[None], q)[0] for q in SPACE[:2]))),
        Case("TDOA 2-D", **moving2, R=full(1.5, 2),
             models=[m.Tdoa(q, REF2, receiver_clock_m=4.0, reference_clock_m=9.0) for q in PLANE[:2]],
             h=lambda x: rows(*(far(x[:, :2], q) + 4.0 - far(REF2[None], q)[0] - 9.0 for q in PLANE[:2]))),
        Case("TDOA 3-D", **timed3, R=full(1.5, 4),
             models=[m.Tdoa(q, REF3, receiver_clock_m=None, reference_clock_m=9.0) for q in SPACE],
             h=lambda x: rows(*(far(x[:, :3], q) + x[:, 3] - far(REF3[None], q)[0] - 9.0 for q in SPACE))),
        # Velocities of 5 m/s across 700 m: positions of 2 m turn the line of sight by 3 mrad, second order 1e-5 of it.
        Case("range rate 2-D", **moving2, R=0.1 * np.eye(2),
             models=[m.RangeRate(q, source_drift_mps=0.7, receiver_drift_mps=0.2) for q in PLANE[:2]],
             h=lambda x: rows(*(receding(x[:, :2], x[:, 2:], q) + 0.2 - 0.7 for q in PLANE[:2]))),
        Case("range rate 3-D", **drifting3, R=0.1 * np.eye(3),
             models=[m.RangeRate(q, source_velocity_mps=V3) for q in SPACE[:3]],
             h=lambda x: rows(*(receding(x[:, :3], x[:, 3:6], q, V3) + x[:, 7] for q in SPACE[:3]))),
        Case("Doppler 2-D", **drifting2, R=np.eye(2), models=[m.Doppler(q, GHZ) for q in PLANE[:2]],
             h=lambda x: rows(*(-PER_MPS * (receding(x[:, :2], x[:, 2:4], q) + x[:, 5]) for q in PLANE[:2]))),
        Case("Doppler 3-D", **moving3, R=np.eye(3),
             models=[m.Doppler(q, GHZ, source_velocity_mps=V3, source_drift_mps=0.7, receiver_drift_mps=0.0)
                     for q in SPACE[:3]],
             h=lambda x: rows(*(-PER_MPS * (receding(x[:, :3], x[:, 3:], q, V3) - 0.7) for q in SPACE[:3]))),
        Case("FDOA 2-D", **moving2, R=full(1.0, 2),
             models=[m.Fdoa(q, REF2, GHZ, source_velocity_mps=V2, reference_velocity_mps=VREF2, receiver_drift_mps=0.3)
                     for q in PLANE[:2]],
             h=lambda x: rows(*(-PER_MPS * (receding(x[:, :2], x[:, 2:], q, V2) + 0.3
                                            - receding(REF2[None], VREF2, q, V2)[0]) for q in PLANE[:2]))),
        Case("FDOA 3-D", **drifting3, R=full(1.0, 3),
             models=[m.Fdoa(q, REF3, GHZ, source_velocity_mps=V3, reference_velocity_mps=VREF3,
                            receiver_drift_mps=None, reference_drift_mps=0.4) for q in SPACE[:3]],
             h=lambda x: rows(*(-PER_MPS * (receding(x[:, :3], x[:, 3:6], q, V3) + x[:, 7]
                                            - receding(REF3[None], VREF3, q, V3)[0] - 0.4) for q in SPACE[:3]))),
        # Angles: 2 m at 700 m are 3 mrad, second order 1e-5 rad against 2 mrad. The second source lies near +-pi.
        Case("azimuth 2-D", **at2, R=4e-6 * np.eye(2), angles=[0, 1],
             models=[m.Azimuth(q, heading_rad=0.4) for q in ([300.0, 700.0], [-800.0, -370.0])],
             h=lambda x: rows(*(np.arctan2(q[1] - x[:, 1], q[0] - x[:, 0]) - 0.4
                                for q in ([300.0, 700.0], [-800.0, -370.0])))),
        Case("azimuth 2-D, heading of the state", **posed, R=1e-4 * np.eye(2), angles=[0, 1],
             models=[m.Azimuth(q, heading_rad=None) for q in PLANE[:2] / 10],
             h=lambda x: rows(*(np.arctan2(q[1] - x[:, 1], q[0] - x[:, 0]) - x[:, 2] for q in PLANE[:2] / 10))),
        Case("azimuth 3-D", **at3, R=4e-6 * np.eye(2), angles=[0, 1], models=[m.Azimuth(q) for q in SPACE[1:3]],
             h=lambda x: rows(*(east_of_north(x, q) for q in SPACE[1:3]))),
        # The state is the emitter and the place of the receiver known: the way back, half a turn on.
        Case("azimuth to an emitter 2-D", **at2, R=4e-6 * np.eye(2), angles=[0, 1],
             models=[m.Azimuth(q, heading_rad=np.pi) for q in PLANE[1:3]],
             h=lambda x: rows(*(np.arctan2(x[:, 1] - q[1], x[:, 0] - q[0]) for q in PLANE[1:3]))),
        Case("azimuth to an emitter 3-D", **moving3, R=4e-6 * np.eye(2), angles=[0, 1],
             models=[m.Azimuth(q, heading_rad=np.pi) for q in SPACE[1:3]],
             h=lambda x: rows(*(np.arctan2(x[:, 0] - q[0], x[:, 1] - q[1]) for q in SPACE[1:3]))),
        Case("elevation", **at3, R=4e-6 * np.eye(3), models=[m.Elevation(q) for q in SPACE[:3]],
             h=lambda x: rows(*(above(x, q) for q in SPACE[:3]))),
        Case("azimuth and elevation", **moving3, R=np.diag([4e-6, 9e-6, 4e-6, 4e-6]), angles=[0, 2],
             models=[m.AzimuthElevation(q, heading_rad=0.7) for q in SPACE[:2]],
             h=lambda x: rows(east_of_north(x, SPACE[0]) - 0.7, above(x, SPACE[0]),
                              east_of_north(x, SPACE[1]) - 0.7, above(x, SPACE[1]))),
        # Decibels: 2 m at 70 m are 0.25 dB, second order 4 mdB against 0.2 dB.
        Case("received power 2-D", **at2, R=0.04 * np.eye(2),
             models=[m.ReceivedPower(q, -20.0, exponent=3.0) for q in PLANE[:2] / 10],
             h=lambda x: rows(*(-20.0 - 30.0 * np.log10(far(x, q)) for q in PLANE[:2] / 10))),
        Case("received power 3-D", **moving3, R=0.04 * np.eye(3),
             models=[m.ReceivedPower(q, -20.0, exponent=2.5, reference_distance_m=3.0) for q in SPACE[:3] / 8],
             h=lambda x: rows(*(-20.0 - 25.0 * np.log10(far(x[:, :3], q) / 3.0) for q in SPACE[:3] / 8))),
        # Phases whose ambiguity is known, of a carrier long enough for particles to stay diverse.
        Case("carrier phase 2-D", **timed2, R=0.25 * np.eye(3),
             models=[m.CarrierPhase(q, 3.0, ambiguity_cycles=-12.0, source_clock_m=6.0) for q in PLANE[:3]],
             h=lambda x: rows(*((far(x[:, :2], q) + x[:, 2] - 6.0) / 3.0 - 12.0 for q in PLANE[:3]))),
        Case("carrier phase 3-D", **drifting3, R=0.25 * np.eye(4),
             models=[m.CarrierPhase(q, 3.0, ambiguity_cycles=float(k)) for k, q in enumerate(SPACE)],
             h=lambda x: rows(*((far(x[:, :3], q) + x[:, 6]) / 3.0 + k for k, q in enumerate(SPACE)))),
        # Headings of 0.02 rad that a step of 1.5 m turns into 3 cm: second order 0.3 mm against 0.1 m and more.
        Case("planar increment", **posed, R=np.diag([0.5, 0.5, 4e-4]), angles=[2],
             models=[m.PlanarIncrement([8.0, -22.0], 2.9)],
             h=lambda x: rows(np.cos(2.9) * (x[:, 0] - 8.0) + np.sin(2.9) * (x[:, 1] + 22.0),
                              -np.sin(2.9) * (x[:, 0] - 8.0) + np.cos(2.9) * (x[:, 1] + 22.0), x[:, 2] - 2.9)),
    ]  # fmt: skip


CASES = {case.name: case for case in cases()}
# Variants on the smaller states, where they take no time.
TABLE = [
    (which, name)
    for which in (*KALMAN, *PARTICLES)
    for name, case in CASES.items()
    if which in KALMAN or which == "particles" or len(case.x0) <= 3
]
CELLS = 2 * len(TABLE)
FAILURE = 1e-4 / CELLS  # of one cell, half on each side

# A cloud of N particles has a mean that is wrong by c/N of the variance it states, and c grows fast with the number of
# states and with what each measurement tells. So particles get measurements of five times the variance, and N by the
# number of states; what is left was measured against a Kalman filter of the same runs (it fell as 1/N): at most 0.05.
PARTICLE_NOISE = 5.0
PARTICLE_EXCESS = 0.05


def particles(case: Case) -> int:
    return {1: 2000, 2: 2000, 3: 4000, 4: 4000, 5: 6000, 6: 6000, 8: 20_000}[len(case.x0)]


# ---- the runs


def squares(e: Array, P: Array) -> Array:
    return np.einsum("ni,ni->n", e, np.linalg.solve(P, e[..., None])[..., 0])


@functools.cache
def simulated(name: str, scale: float, runs: int) -> tuple[Array, Array]:
    """Truth at the last time (N, n), and measurements (N, T, m)."""
    case = CASES[name]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    x = np.array(case.x0) + rng.standard_normal((runs, len(case.x0))) * case.sigma0
    noise = rng.multivariate_normal(np.zeros(len(case.R)), scale * case.R, (runs, len(TIMES)))
    z = np.empty(noise.shape)
    for k, dt in enumerate(np.diff(TIMES, prepend=0.0)):
        x = case.move(rng, x, dt, np.array(case.input))
        z[:, k] = case.h(x) + noise[:, k]
    z[..., case.angles] = wrap(z[..., case.angles])
    return x, z


def kalman_runs(make: Any, case: Case, R: Array, moves: process.Process, z: Array) -> tuple[Array, Array, Array]:
    x, P, nis = [], [], []
    for values in z:
        kf = make(case.state, case.x0, np.square(case.sigma0))
        run = kf.run(TIMES, moves, [(case.models, values, R)], inputs=case.inputs, start_s=0.0, history=False)
        assert np.all(run.status == estimation.UpdateStatus.ACCEPTED)
        x.append(kf.x)
        P.append(kf.P)
        nis.append(run.nis.sum())
    return np.array(x), np.array(P), np.array(nis)


def particle_runs(which: str, case: Case, R: Array, moves: process.Process, z: Array) -> tuple[Array, Array, Array]:
    x, P, nis = [], [], []
    options = dict(PARTICLES[which])
    if "adaptive" in options:  # bins far finer than the cloud, so that nearly all particles stay
        sizes = np.array(case.sigma0) / 4.0
        options["adaptive"] = estimation.AdaptiveCount(sizes, least=particles(case) // 2, divergence=0.02)
    prior = estimation.Gaussian(case.x0, np.diag(np.square(case.sigma0)))
    before = None if case.inputs is None else case.inputs[:-1]
    last_s = float(TIMES[-1] - TIMES[-2])
    for seed, values in enumerate(z):
        pf = estimation.ParticleFilter(particles(case), prior=prior, state=case.state, seed=seed, **options)
        measured = estimation.Measured(case.models, values[:-1], R=R)
        run = pf.run(TIMES[:-1], moves, measured, inputs=before, start_s=0.0, covariance=False)
        assert np.all(run.status == estimation.ParticleStatus.ACCEPTED)
        assert pf.predict(moves, last_s, case.input or None).accepted
        off = values[-1] - case.h(pf.particles)
        off[:, case.angles] = wrap(off[:, case.angles])
        innovation = pf.weights @ off
        off -= innovation
        nis.append(squares(innovation[None], (pf.weights[:, None] * off).T @ off + R)[0])
        assert pf.update(case.models, values[-1], R=R).accepted
        x.append(pf.mean)
        P.append(pf.covariance)
    return np.array(x), np.array(P), np.array(nis)


def outside(which: str, case: Case, *, told: float = 1.0, moves: process.Process | None = None) -> list[str]:
    """The statistics that leave their bounds, of a filter that is told so many times the noise there is."""
    moves = case.process if moves is None else moves
    if which in PARTICLES:
        truth, z = simulated(case.name, PARTICLE_NOISE, PARTICLE_RUNS)
        x, P, nis = particle_runs(which, case, told * PARTICLE_NOISE * case.R, moves, z)
        innovations, excess = len(z) * len(case.R), PARTICLE_EXCESS
    else:
        truth, z = simulated(case.name, 1.0, RUNS)
        x, P, nis = kalman_runs(KALMAN[which], case, told * case.R, moves, z)
        innovations, excess = z.size, 0.0
    error = x - truth
    if case.heading is not None:
        error[:, case.heading] = wrap(error[:, case.heading])
    found = []
    for name, values, dof, above_one in (
        ("NEES", squares(error, P), error.size, excess),
        ("NIS", nis, innovations, 0.0),
    ):
        low, high = stats.chi2.ppf(FAILURE / 2, dof), (1.0 + above_one) * stats.chi2.isf(FAILURE / 2, dof)
        if not low < values.sum() < high:
            found.append(f"{name} {values.sum() / dof:.3f}, not in {low / dof:.3f} … {high / dof:.3f}")
    return found


@pytest.mark.parametrize(("which", "name"), TABLE)
def test_errors_and_innovations_are_as_large_as_stated(which, name):
    assert outside(which, CASES[name]) == []


# ---- the table sees filters that are wrong


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("which", KALMAN)
def test_half_the_noise_is_noticed(which, name):
    assert any(found.startswith("NIS") for found in outside(which, CASES[name], told=0.5))


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("which", KALMAN)
def test_twice_the_noise_is_noticed(which, name):
    assert any(found.startswith("NIS") for found in outside(which, CASES[name], told=2.0))


@pytest.mark.parametrize("name", ["range 2-D", "position fix 3-D", "TDOA 3-D", "planar increment"])
@pytest.mark.parametrize("told", [0.5, 2.0])
def test_particles_notice_wrong_noise(name, told):
    assert outside("particles", CASES[name], told=told)


STILL = {
    "position fix 1-D": process.RandomWalk(1e-6),
    "position fix 2-D": process.NearlyConstantVelocity(1e-6),
    "range 2-D": process.RandomWalk(1e-6),
    "pseudorange 2-D": process.RandomWalk(1e-6),
    "azimuth 2-D, heading of the state": process.PlanarOdometry(1e-6 * np.eye(3)),
}


@pytest.mark.parametrize("name", STILL)
@pytest.mark.parametrize("which", KALMAN)
def test_missing_process_noise_is_noticed(which, name):
    assert outside(which, CASES[name], moves=STILL[name])
