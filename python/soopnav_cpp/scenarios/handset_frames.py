"""The stage ``iq_and_frames`` of ``handset`` scenarios: samples of all cells and frames of the floor, and what is
measured in them. Two threads: a radio's and a camera's; the C++ underneath lets go of the interpreter.

Radio: at each epoch a millisecond that holds a frame's first subframe of every cell, through the paths of a room with
brick walls and windows, with the excess delay of links that are shut, the handset's clock and its carrier offset. The
first epochs are longer: the cells are searched in them, and only those that are found, or that the network's list of
neighbours names (``lte.neighbours``), are ranged. Camera: a frame and
the cloud of a depth sensor, of a textured floor.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import lte, plotting, simulation, vision
from soopnav_cpp.scenarios.handset import RATES_HZ, HandsetScenario
from soopnav_cpp.scenarios.handset_pipeline import FrameShown, Observed, Step, Walk, frames_kept

__all__ = ["camera_of", "cell_ids", "check", "observe", "room_of", "tell_cells"]

_Array = npt.NDArray[np.float64]
_C_MPS = 299_792_458.0
_LEAD_S = 25e-6  # of a snapshot before its subframe: clocks may be early
_SUBFRAME_S = 1e-3
_FRAME_S = 10e-3
_SEARCH_S = 20e-3  # of the first epochs, in which the cells are searched
_SEARCHES = 3  # at most, as long as cells are missing
_MOST_CFO_HZ = 500.0
_ANTENNA_M = 1.2  # height of the handset above the floor
_CARRIER_HZ = 2.0e9
_POWER, _DATA, _SCENE, _ROOM = range(10, 14)  # streams of a run's seed


def _seed(seed: int, *stream: int) -> int:
    return int(np.random.SeedSequence([seed, *stream]).generate_state(1, np.uint64)[0] >> np.uint64(1))


def camera_of(scenario: HandsetScenario) -> Any:
    """The camera that the scenario names, or a pinhole of 640 x 480."""
    if scenario.camera.file is not None:
        return vision.load_camera(scenario.camera.file).camera
    return vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


def check(scenario: HandsetScenario) -> None:
    """Refuse what cannot be run."""
    if not vision.available():
        raise ValueError("stage: iq_and_frames needs OpenCV, and this build of soopnav is without it")
    camera_of(scenario)


def cell_ids(count: int) -> list[int]:
    """Identities whose reference signals lie on different subcarriers, as far as six go."""
    return [30 + 7 * k for k in range(count)]


def room_of(scenario: HandsetScenario, seed: int) -> Any:
    """Brick walls with a window in the middle half of each side, corner at (0, 0)."""
    size = scenario.room.size_m
    windows = [(side, 0.25 * size, 0.75 * size) for side in ("south", "east", "north", "west")]
    return simulation.IndoorRoom.rectangle(
        size, size, windows=windows, carrier_hz=_CARRIER_HZ, order=2, seed=_seed(seed, _ROOM),
        antenna_height_m=_ANTENNA_M,
    )  # fmt: skip


def _taps(scenario: HandsetScenario, world: Walk, seed: int) -> list[list[list[tuple[float, complex]]]]:
    """Paths of every epoch and cell: delays from the node on, gains of unit power together."""
    places = np.column_stack([world.position_m, np.zeros(len(world.position_m))])
    if scenario.lte.multipath == "none":
        away = np.linalg.norm(places[:, None, :] - world.nodes_m[None], axis=2) / _C_MPS
        return [[[(float(delay), 1.0 + 0.0j)] for delay in row] for row in away]
    lift = np.array([0.5 * scenario.room.size_m, 0.5 * scenario.room.size_m, _ANTENNA_M])
    links = room_of(scenario, seed).links(world.nodes_m + lift, places + lift)
    count = len(world.nodes_m)
    return [[links.taps(k, i, normalise=True) for i in range(count)] for k in range(len(places))]


class _Air:
    """Samples that the handset's antenna hears at an epoch."""

    def __init__(self, scenario: HandsetScenario, world: Walk, seed: int) -> None:
        self.scenario, self.world, self.seed = scenario, world, seed
        self.rate_hz = RATES_HZ[scenario.lte.n_rb]
        self.ids = cell_ids(len(world.nodes_m))
        drawn = np.random.default_rng([seed, _POWER])
        self.power_db = -scenario.lte.spread_db * drawn.random(len(self.ids))
        self.power_db -= self.power_db.max()
        self.cfo_hz = float(drawn.uniform(-_MOST_CFO_HZ, _MOST_CFO_HZ))
        self.noise = lte.noise_variance_for_snr(scenario.lte.snr_db)
        self.taps = _taps(scenario, world, seed)

    def hear(self, k: int, duration_s: float) -> npt.NDArray[np.complex64]:
        """From `_LEAD_S` before a frame of the network begins."""
        late_m = self.world.clock_m[k] + self.world.excess_m[k]
        cells = [
            lte.CellParameters(
                cell_id=cell_id, n_rb=self.scenario.lte.n_rb, n_ports=self.scenario.lte.n_ports,
                delay_s=_LEAD_S + float(late_m[i]) / _C_MPS, power_db=float(self.power_db[i]), cfo_hz=self.cfo_hz,
                taps=self.taps[k][i], data_load=self.scenario.lte.load,
            )
            for i, cell_id in enumerate(self.ids)
        ]  # fmt: skip
        source = lte.Synthesizer(cells, self.rate_hz, noise_variance=self.noise, seed=_seed(self.seed, _DATA, k))
        return source.generate(round(duration_s * self.rate_hz))


def tell_cells(air: _Air) -> list[Any]:
    """What searches in the first epochs find, None for a cell that all of them miss.

    With ``lte.neighbours`` a cell that is missed is taken from the network's list instead, which has its identity,
    bandwidth and ports. Its frame begins with those of the cells found, for the network is synchronous and the nodes
    are tens of metres apart, well within the ranger's window; its carrier is off by the handset's oscillator, as
    theirs are.
    """
    found: dict[int, Any] = {}
    for k in range(min(_SEARCHES, len(air.world.epoch_s))):
        for one in lte.search(air.hear(k, _SEARCH_S), air.rate_hz, max_cfo_hz=2000.0):
            found.setdefault(one.cell_id, one)
        if set(air.ids) <= set(found):
            break
    told = [found.get(cell_id) for cell_id in air.ids]
    heard = [one for one in told if one is not None]
    if air.scenario.lte.neighbours and heard:
        start_s = float(np.median([_near_zero(one.frame_start_s) for one in heard])) % _FRAME_S
        cfo_hz = float(np.median([one.cfo_hz for one in heard]))
        blocks, ports = air.scenario.lte.n_rb, air.scenario.lte.n_ports
        for i, cell_id in enumerate(air.ids):
            if told[i] is None:
                told[i] = lte.Detection(
                    cell_id=cell_id, frame_start_s=start_s, cfo_hz=cfo_hz, n_rb=blocks, n_ports=ports
                )
    return told


def _radio(scenario: HandsetScenario, world: Walk, seed: int) -> tuple[_Array, _Array, list[str], dict[str, float]]:
    """Ranges and their deviations, what should be known, and what it took."""
    began = time.thread_time()
    air = _Air(scenario, world, seed)
    ranges = np.full(world.range_m.shape, np.nan)
    sigma = np.full(world.range_m.shape, np.nan)
    cells = tell_cells(air)
    heard = np.array([i for i, one in enumerate(cells) if one is not None], dtype=np.int64)
    missing = [str(air.ids[i]) for i, one in enumerate(cells) if one is None]
    notes = (
        [f"{_SEARCHES} searches of {1e3 * _SEARCH_S:g} ms did not find cell {', '.join(missing)}"] if missing else []
    )
    if not heard.size:
        raise ValueError(f"lte.snr_db: {scenario.lte.snr_db:g}: no cell was found in the first epoch")
    ranger = lte.SnapshotRanger(air.rate_hz, [cells[i] for i in heard], subframes=scenario.lte.subframes)
    snapshot_s = 6.0 * _LEAD_S + _SUBFRAME_S * scenario.lte.subframes
    guess = np.array([_near_zero(cells[i].frame_start_s) for i in heard])
    offsets = np.array([cells[i].cfo_hz for i in heard])
    acquired, made, measured = time.thread_time() - began, 0.0, 0.0
    for k in range(len(world.epoch_s)):
        start = time.thread_time()
        iq = air.hear(k, snapshot_s)
        middle = time.thread_time()
        seen = ranger.range(iq, guess, offsets)
        good = np.flatnonzero(np.asarray(seen.status) == 0)
        guess[good] = seen.toa_s[good]
        ranges[k, heard[good]] = _C_MPS * (seen.toa_s[good] - _LEAD_S)
        doubt = np.hypot(seen.sigma_s[good], seen.undetected_s[good])
        sigma[k, heard[good]] = np.hypot(_C_MPS * doubt, scenario.lte.sigma_m)
        made += middle - start
        measured += time.thread_time() - middle
    return ranges, sigma, notes, {"search": acquired, "iq synthesis": made, "ranging": measured}


def _near_zero(frame_start_s: float) -> float:
    """The frame that starts within half of one from the first sample."""
    return math.remainder(frame_start_s, _FRAME_S)


def _follow(
    scenario: HandsetScenario, world: Walk, seed: int
) -> tuple[list[Step], FrameShown | None, dict[str, float]]:
    """Steps of the camera, a frame to show, and what it took."""
    settings, camera = scenario.camera, camera_of(scenario)
    scene = simulation.GroundScene(seed=_seed(seed, _SCENE))
    ego = vision.EgoMotion(camera, seed=seed)
    tilt = (math.radians(settings.tilt_x_deg), math.radians(settings.tilt_y_deg))
    view: dict[str, Any] = {"height_m": settings.height_m, "tilt_rad": tilt}
    kept = frames_kept(scenario, len(world.frame_s), seed)
    steps: list[Step] = []
    shown: FrameShown | None = None
    made, followed = 0.0, 0.0
    for k in kept:
        start = time.thread_time()
        pose = world.pose[k]
        image = scene.render(camera, pose, **view, noise=settings.noise, frame=k)
        ground: dict[str, Any]
        if settings.depth_sigma_m > 0.0:
            ground = {
                "points": scene.depth_cloud(
                    camera, pose, **view, points=settings.depth_points, sigma_m=0.0,
                    sigma_per_m=settings.depth_sigma_m, frame=k,
                )
            }  # fmt: skip
        else:
            ground = {"plane": scene.true_plane(**view)}
        middle = time.thread_time()
        motion = ego.step(image, t_s=float(world.frame_s[k]), **ground)
        followed += time.thread_time() - middle
        made += middle - start
        if motion.dt_s > 0.0:
            steps.append(_step(motion, float(world.frame_s[k]), settings.inflation))
        if motion.ok and (shown is None or world.frame_s[k] <= 0.5 * scenario.duration_s):
            shown = FrameShown(float(world.frame_s[k]), image, plotting.FrameTracks.of(ego))
    return steps, shown, {"rendering": made, "ego-motion": followed}


def _step(motion: Any, t_s: float, inflation: float) -> Step:
    nothing = np.zeros((2, 2))
    if not motion.ok:
        return Step(t_s, None, np.zeros((3, 3)), nothing, nothing)
    return Step(
        t_s,
        np.asarray(motion.increment),
        inflation**2 * np.asarray(motion.track_covariance),
        np.asarray(motion.foot_covariance_previous),
        np.asarray(motion.foot_covariance),
    )


def observe(scenario: HandsetScenario, world: Walk, seed: int) -> Observed:
    """Ranges and steps from samples and frames."""
    began = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        camera = pool.submit(_follow, scenario, world, seed)
        ranges, sigma, notes, radio_s = pool.submit(_radio, scenario, world, seed).result()
        steps, shown, camera_s = camera.result()
    timings = {**radio_s, **camera_s, "wall": time.perf_counter() - began}
    return Observed(world.epoch_s, ranges, sigma, steps, shown, timings, notes)
