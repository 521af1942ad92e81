"""What is measured: our side of each case, and the peers it is held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import array, clock, estimation, measurement, process
from soopnav_cpp.bench import systems
from soopnav_cpp.bench.ambiguity_cases import AMBIGUITY_CASES
from soopnav_cpp.bench.aperture_cases import APERTURE_CASES
from soopnav_cpp.bench.ground_cases import GROUND_CASES
from soopnav_cpp.bench.handset_cases import HANDSET_CASES
from soopnav_cpp.bench.harness import Case, Data, Peer, Prepare
from soopnav_cpp.bench.iridium_cases import IRIDIUM_CASES
from soopnav_cpp.bench.source_cases import SOURCE_CASES
from soopnav_cpp.bench.vision_cases import VISION_CASES

__all__ = ["CASES", "ekf_planar_ins", "particle_bootstrap"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]


def _rts_data() -> Data:
    system = systems.fourteen_states()
    return cast(Data, system | systems.run_kalman(system, systems.simulate(system, 2400, seed=1)))


def _rts(data: Data) -> Timed:
    F, x_pred, P_pred, x, P = (data[name] for name in ("F", "x_pred", "P_pred", "x", "P"))

    def run() -> Any:
        return estimation.rts_smooth(F, x_pred, P_pred, x, P)

    def answer(smoothed: Any) -> list[float]:
        return [*smoothed[0][0], *np.diagonal(smoothed[1][0])]

    return run, answer


RTS = Case(
    name="rts/14x2400",
    title="RTS smoother of a filtered run, 14 states, 2400 steps",
    data=_rts_data,
    ours=_rts,
    peers=(Peer("filterpy", "filterpy_peers", "rts"),),
    tolerance=1e-9,
)


def _planar_ins(data: Data) -> Timed:
    steps, dt = len(data["u"]), float(data["dt"])
    every = steps // len(data["z"])
    z = np.full((steps, 3), np.nan)
    z[every - 1 :: every] = -data["z"]  # there: how much nearer than at the start
    heard = np.isfinite(z[:, 0])
    times = dt * np.arange(1, steps + 1)
    ins = process.PlanarMechanization(integration="euler", diffusion_psd=np.diagonal(data["Q"]) / dt)
    models = [measurement.RangeDifference(q, data["p0"]) for q in data["transmitters"]]

    def run() -> Any:
        ekf = estimation.ExtendedKalmanFilter("planar_inertial", data["x0"], data["P0"])
        return ekf.run(times, ins, [(models, z, data["R"], heard)], inputs=data["u"], start_s=0.0, history=False)

    def answer(result: Any) -> list[float]:
        return [*result.x[-1], *np.diagonal(result.P[-1])]

    return run, answer


def ekf_planar_ins(ours: Prepare) -> Case:
    """The EKF of `systems.planar_ins`; its answer is the last state and the diagonal of its covariance."""
    return Case(
        name="ekf/planar-ins",
        title="planar INS, 6000 predicts, 120 updates with three range differences",
        data=lambda: cast(Data, systems.planar_ins()),
        ours=ours,
        peers=(Peer("filterpy", "filterpy_peers", "ekf_planar_ins"),),
        tolerance=1e-8,
    )


def particle_bootstrap(ours: Prepare, *, single: bool = False) -> Case:
    """Ten steps of the bootstrap filter of `systems.range_cloud`; its answer is the last mean, before resampling.

    Two right filters differ by the noise of a hundred thousand particles, about 0.01 in each state.

    Parameters
    ----------
    ours : callable
    single : bool
        Ours in single precision; NumPy as well, in a row beside the one with doubles.
    """
    return Case(
        name="particle/bootstrap-1e5-float" if single else "particle/bootstrap-1e5",
        title="100 000 particles, 5 states, 10 steps of 4 ranges, systematic resampling at each",
        data=lambda: cast(Data, systems.range_cloud(100_000, 10)),
        ours=ours,
        peers=(
            Peer("numpy", "numpy_peers", "bootstrap"),
            *((Peer("numpy-float", "numpy_peers", "bootstrap_float"),) if single else ()),
            Peer("particles", "particles_peers", "bootstrap", requirements=("particles==0.4", "numpy<2")),
            Peer("pfilter", "pfilter_peers", "bootstrap"),
            Peer("stonesoup", "stonesoup_peers", "bootstrap"),
        ),
        tolerance=0.08,
    )


def _bootstrap(precision: str) -> Prepare:
    """Our bootstrap filter: built, and run in one call."""

    def prepare(data: Data) -> Timed:
        count, dt, sigma_b = int(data["particles"]), float(data["dt"]), float(data["sigma_b"])
        motion = process.PiecewiseConstantAcceleration(
            float(data["sigma_a"]), diffusion_psd=[0.0, 0.0, 0.0, 0.0, sigma_b**2 / dt]
        )
        models = [measurement.Pseudorange(node) for node in data["nodes"]]
        measured = estimation.Measured(models, data["z"], float(data["sigma_z"]))
        prior = estimation.Gaussian(data["x0"], np.diag(np.square(data["sigma0"])))
        times = dt * np.arange(1.0, len(data["z"]) + 1)

        def run() -> Any:
            cloud = estimation.ParticleFilter(
                count, prior=prior, state="position_velocity_bias2", seed=5, ess_threshold=1.0, precision=precision
            )
            return cloud.run(times, motion, measured, start_s=0.0, covariance=False)

        def answer(result: Any) -> list[float]:
            return [float(value) for value in result.mean[-1]]

        return run, answer

    return prepare


def _clock_data() -> Data:
    run = clock.TwoState.tcxo().simulate(1.0, 1_000_000, seed=1)
    taus = np.unique(np.round(np.geomspace(1.0, 3e5, 20)))
    return cast(Data, {"phase_s": np.array(run.bias_s), "dt_s": np.array(1.0), "taus": taus})


def _allan(data: Data) -> Timed:
    phase_s, dt_s, taus = data["phase_s"], float(data["dt_s"]), data["taus"]

    def run() -> Any:
        return clock.allan_deviation(phase_s, dt_s, taus=taus)

    def answer(result: Any) -> list[float]:
        return [float(value) for value in result.deviation]

    return run, answer


ALLAN = Case(
    name="clock/allan-1e6",
    title="overlapping Allan deviation, a million phases, 20 averaging times; ours with intervals",
    data=_clock_data,
    ours=_allan,
    peers=(Peer("allantools", "allantools_peers", "overlapping", requirements=("allantools==2024.6",)),),
    tolerance=1e-9,
)


def _directions_data() -> Data:
    geometry = array.ArrayGeometry.planar(2, 2, 0.2)
    rng = np.random.default_rng(1)
    azimuth, elevation = np.deg2rad(np.arange(0.0, 360.0)), np.deg2rad(np.arange(0.0, 91.0))
    manifold = array.Manifold(geometry)
    truth = manifold.steering(np.deg2rad(40.0), np.deg2rad(50.0))
    noise = rng.standard_normal((5, 20 * 2500, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0)
    iq = (np.sqrt(10.0) * truth * noise[4] + noise[:4]).astype(np.complex64)
    return {
        "iq": iq,
        "block": np.array(2500),
        "azimuth": azimuth,
        "elevation": elevation,
        "positions_wavelengths": geometry.positions_m / geometry.wavelength_m,
        "steering": manifold.steering(azimuth[None, :], elevation[:, None]),
    }


def _directions(data: Data) -> Timed:
    geometry = array.ArrayGeometry.planar(2, 2, 0.2)
    finder = array.DirectionFinder(geometry)
    iq, block = np.ascontiguousarray(data["iq"], dtype=np.complex64), int(data["block"])

    def run() -> Any:
        return finder.track(iq, block)

    def answer(found: Any) -> list[float]:
        return [*found.azimuth_rad[:, 0].tolist(), *found.elevation_rad[:, 0].tolist()]

    return run, answer


MUSIC = Case(
    name="array/music-360x91",
    title="MUSIC, 4 elements, 20 blocks of 2500 snapshots, 360 x 91 directions; ours refined, with covariance",
    data=_directions_data,
    ours=_directions,
    peers=(
        Peer("numpy", "array_peers", "music"),
        Peer("pyroomacoustics", "pyroomacoustics_peers", "music", requirements=("pyroomacoustics==0.10.1",)),
    ),
    tolerance=0.02,
)

CASES: tuple[Case, ...] = (
    RTS,
    ekf_planar_ins(_planar_ins),
    particle_bootstrap(_bootstrap("double")),
    particle_bootstrap(_bootstrap("float"), single=True),
    ALLAN,
    *SOURCE_CASES,
    *HANDSET_CASES,
    *GROUND_CASES,
    *APERTURE_CASES,
    *VISION_CASES,
    *IRIDIUM_CASES,
    *AMBIGUITY_CASES,
    MUSIC,
)
