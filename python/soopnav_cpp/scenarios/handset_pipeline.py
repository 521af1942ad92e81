"""The chain of a ``handset`` scenario, a function for each stage.

`walk` (where the handset was, what its links and its clock did), `observe` (ranges and steps: drawn, or by
`handset_frames` from samples and frames), `locate` (the particle filter, and LTE alone), `to_run` (what reports are
made of). The same `Observed` may be located as often as one likes.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import navigation, simulation
from soopnav_cpp.scenarios.base import Truth
from soopnav_cpp.scenarios.handset import HandsetRun, HandsetScenario

__all__ = [
    "ALONE",
    "FrameShown",
    "Located",
    "Observed",
    "Walk",
    "check",
    "locate",
    "numbers",
    "observe",
    "to_run",
    "walk",
]

_Array = npt.NDArray[np.float64]
ALONE = "LTE alone"
_CLOUD_HZ = 2.0  # particles are kept so often
_CLOUD = 300  # and so many
_C_MPS = 299_792_458.0
_BLOCK_HZ = 180e3  # a resource block
_MULTIPATH_SHARE = 0.02  # of the length that a bandwidth resolves
_EPOCH_OFFSET_S = 0.02  # of radio epochs after frames
_STREAM_START, _STREAM_DROPPED = range(2)  # of a run's seed


@dataclass(frozen=True, eq=False)
class Walk:
    """What was so.

    Attributes
    ----------
    frame_s : ndarray, shape (f,)
    pose : ndarray, shape (f, 3)
        x, y [m], heading [rad] at the frames.
    epoch_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, 2)
    heading_rad : ndarray, shape (n,)
        At the radio's epochs.
    nodes_m : ndarray, shape (L, 3)
    los : ndarray of bool, shape (n, L)
    excess_m, range_m : ndarray, shape (n, L)
    clock_m : ndarray, shape (n,)
    increment : ndarray, shape (f - 1, 3)
        With the errors of the stage observables.
    told_heading_rad : float
        What the filter is told of the heading at the start.
    guarded : bool
        Whether every link is open as long as it should be.
    """

    frame_s: _Array
    pose: _Array
    epoch_s: _Array
    position_m: _Array
    heading_rad: _Array
    nodes_m: _Array
    los: npt.NDArray[np.bool_]
    excess_m: _Array
    range_m: _Array
    clock_m: _Array
    increment: _Array
    told_heading_rad: float
    guarded: bool


@dataclass(frozen=True, eq=False)
class FrameShown:
    """A frame with its tracks."""

    t_s: float
    image: npt.NDArray[np.uint8]
    tracks: Any


@dataclass(frozen=True, eq=False)
class Step:
    """A step of the camera as the locator takes it; `increment` None where none could be measured."""

    t_s: float
    increment: _Array | None
    track_covariance: _Array
    foot_covariance_previous: _Array
    foot_covariance: _Array


@dataclass(eq=False)
class Observed:
    """Ranges and steps.

    Attributes
    ----------
    epoch_s : ndarray, shape (n,)
        By the radio's clock.
    range_m, sigma_m : ndarray, shape (n, L)
        NaN where a node was not heard.
    steps : list of Step
    frame : FrameShown or None
    timings_s : dict of str to float
    notes : list of str
    """

    epoch_s: _Array
    range_m: _Array
    sigma_m: _Array
    steps: list[Step]
    frame: FrameShown | None = None
    timings_s: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(eq=False)
class Located:
    """What the filters say after each epoch."""

    position_m: _Array
    covariance_m2: _Array
    heading_rad: _Array
    clock_m: _Array
    p_los: _Array
    alone_m: _Array
    clouds: list[tuple[float, _Array]]
    statuses: Counter[str]
    filter_s: float


def check(scenario: HandsetScenario) -> None:
    """Refuse what cannot be run, before it is run."""
    if scenario.stage == "iq_and_frames":
        from soopnav_cpp.scenarios import handset_frames

        handset_frames.check(scenario)


def walk(scenario: HandsetScenario, seed: int) -> Walk:
    """Where the handset went, what its links and its clock did."""
    room, nlos, camera = scenario.room, scenario.nlos, scenario.camera
    world = simulation.HandsetWorld.generate(
        seed,
        links=scenario.node_count,
        max_blocked=nlos.most,
        min_clear_share=nlos.least_los_share,
        mean_los_s=nlos.mean_los_s,
        mean_nlos_s=nlos.mean_nlos_s,
        excess_min_m=nlos.excess_m[0],
        excess_max_m=nlos.excess_m[1],
        excess_walk_m2ps=nlos.wander_m_per_sqrt_s**2,
        duration_s=scenario.duration_s,
        room_m=room.size_m,
        min_node_m=scenario.nodes.distance_m[0],
        max_node_m=scenario.nodes.distance_m[1],
        min_speed_mps=room.speed_mps[0],
        max_speed_mps=room.speed_mps[1],
        range_rate_hz=scenario.lte.rate_hz,
        range_sigma_m=scenario.lte.sigma_m,
        clock_walk_m2ps=scenario.clock.walk_m_per_sqrt_s**2,
        clock_sigma_m=scenario.clock.start_sigma_m,
        frame_rate_hz=camera.rate_hz,
        step_sigma_m=1e-3 * camera.sigma_mm,
        turn_sigma_rad=math.radians(camera.turn_sigma_deg),
        heading_error_rad=math.radians(min(180.0, scenario.filter.heading_sigma_deg)),
        epoch_offset_s=_EPOCH_OFFSET_S,
    )
    nodes, ranges = world.nodes_m, world.ranges_m
    position, pose = world.position_m, world.pose
    if scenario.nodes.positions_m:  # the same walk, clock, excess and noise
        given = np.column_stack([np.array(scenario.nodes.positions_m), nodes[:, 2]])
        ranges = ranges + _distances(position, given) - _distances(position, nodes)
        nodes = given
    heading = np.interp(world.epoch_s, world.frame_s, np.unwrap(pose[:, 2]))
    return Walk(
        frame_s=world.frame_s,
        pose=pose,
        epoch_s=world.epoch_s,
        position_m=position,
        heading_rad=heading,
        nodes_m=nodes,
        los=~world.nlos.blocked,
        excess_m=world.nlos.excess_m,
        range_m=ranges,
        clock_m=world.clock_m,
        increment=world.increments,
        told_heading_rad=world.told_heading_rad,
        guarded=world.nlos.guarded,
    )


def _distances(position_m: _Array, nodes_m: _Array) -> _Array:
    """From the handset, at height 0, to the nodes, shape (n, L)."""
    flat = position_m[:, None, :] - nodes_m[None, :, :2]
    return np.asarray(np.sqrt(np.sum(flat**2, axis=2) + nodes_m[None, :, 2] ** 2))


def observe(scenario: HandsetScenario, world: Walk, seed: int) -> Observed:
    """Ranges and steps, of the stage that the scenario asks for."""
    if scenario.stage == "iq_and_frames":
        from soopnav_cpp.scenarios import handset_frames

        observed = handset_frames.observe(scenario, world, seed)
    else:
        observed = _drawn(scenario, world, seed)
    observed.epoch_s = observed.epoch_s + scenario.lte.time_offset_s
    return observed


def _drawn(scenario: HandsetScenario, world: Walk, seed: int) -> Observed:
    """Ranges and steps with errors that are drawn; steps over dropped frames are joined."""
    camera = scenario.camera
    kept = frames_kept(scenario, len(world.frame_s), seed)
    sigma = 1e-3 * camera.sigma_mm * camera.inflation
    noise = np.diag([sigma**2, sigma**2, math.radians(camera.turn_sigma_deg) ** 2])
    nothing = np.zeros((2, 2))
    steps = []
    for before, after in itertools.pairwise(kept):
        step, covariance = np.zeros(3), np.zeros((3, 3))
        for k in range(before, after):
            c, s = math.cos(step[2]), math.sin(step[2])
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            moved = turn @ world.increment[k]
            by_turn = np.eye(3)
            by_turn[:2, 2] = -moved[1], moved[0]
            covariance = by_turn @ covariance @ by_turn.T + turn @ noise @ turn.T
            step = step + moved
        steps.append(Step(float(world.frame_s[after]), step, covariance, nothing, nothing))
    return Observed(world.epoch_s, world.range_m, np.full(world.range_m.shape, scenario.lte.sigma_m), steps)


def frames_kept(scenario: HandsetScenario, count: int, seed: int) -> list[int]:
    """Frames that are not dropped; the first one never is."""
    share = scenario.camera.dropped_share
    if share <= 0.0:
        return list(range(count))
    drawn = np.random.default_rng([seed, _STREAM_DROPPED]).random(count)
    return [k for k in range(count) if k == 0 or drawn[k] >= share]


def multipath_of(scenario: HandsetScenario) -> dict[str, Any]:
    """What the filter is told of range errors that stay for metres; nothing where ranges are drawn without them.

    A first path that is not told apart from the ones behind it is drawn towards them by a share of the length that the
    bandwidth resolves. Most of it turns with the carrier's phase and is new at each epoch (``lte.sigma_m``); what is
    left goes with the delays themselves, which change over the size of the room. The share of 2 % is that of ranges
    from `lte.SnapshotRanger` in the rooms of `handset_frames.room_of`.
    """
    radio = scenario.lte
    if scenario.stage != "iq_and_frames":
        return {}
    sigma = radio.multipath_sigma_m
    if sigma is None:
        sigma = 0.0 if radio.multipath == "none" else _MULTIPATH_SHARE * _C_MPS / (_BLOCK_HZ * radio.n_rb)
    length = radio.multipath_length_m
    if length is None:
        length = 0.5 * scenario.room.size_m
    return {"multipath_sigma_m": sigma, "multipath_length_m": length}


def _locators(scenario: HandsetScenario, world: Walk, seed: int) -> tuple[Any, Any]:
    """The particle filter, and the Kalman filter that has ranges alone."""
    nlos, half = scenario.nlos, 0.5 * scenario.room.size_m
    start = world.pose[0, :2] + scenario.filter.start_sigma_m * np.random.default_rng(
        [seed, _STREAM_START]
    ).standard_normal(2)
    start = np.clip(start, -0.98 * half, 0.98 * half)
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    common: dict[str, Any] = {
        "start_m": start,
        "start_sigma_m": scenario.filter.start_sigma_m,
        "clock_sigma_m": scenario.clock.start_sigma_m,
        "clock_walk_m2ps": scenario.clock.walk_m_per_sqrt_s**2,
    }
    locator = navigation.HandsetLocator(
        world.nodes_m,
        filter=scenario.filter.type,
        particles=scenario.filter.particles,
        seed=seed,
        start_heading_rad=world.told_heading_rad,
        start_heading_sigma_rad=math.radians(scenario.filter.heading_sigma_deg) / math.sqrt(3.0),
        nlos=nlos.known,
        mean_los_s=nlos.mean_los_s,
        mean_nlos_s=nlos.mean_nlos_s,
        excess_min_m=nlos.excess_m[0],
        excess_max_m=nlos.excess_m[1],
        excess_walk_m2ps=nlos.wander_m_per_sqrt_s**2,
        room_m=corners if scenario.room.walls else None,
        **multipath_of(scenario),
        **common,
    )
    alone = navigation.HandsetLocator.lte_alone(world.nodes_m, **common)
    return locator, alone


def _word(status: Any) -> str:
    return str(getattr(status, "name", status)).lower()


def locate(scenario: HandsetScenario, world: Walk, observed: Observed, seed: int) -> Located:
    """Steps and ranges in the order of their times through the filter, ranges through the one without a camera.

    Raises
    ------
    ValueError
        When the camera's and the radio's times have nothing to do with each other.
    """
    _overlap(observed)
    locator, alone = _locators(scenario, world, seed)
    n, links = observed.range_m.shape
    found = Located(
        np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan), np.full(n, np.nan), np.full(n, np.nan),
        np.full((n, links), np.nan), np.full((n, 2), np.nan), [], Counter(), 0.0,
    )  # fmt: skip
    began = time.thread_time()
    steps = iter(observed.steps)
    step = next(steps, None)
    every = max(1, round(scenario.lte.rate_hz / _CLOUD_HZ))
    for k in range(n):
        now = float(observed.epoch_s[k])
        while step is not None and step.t_s <= now:
            if step.increment is None:
                report = locator.coast(step.t_s)
            else:
                report = locator.move(
                    step.increment, step.t_s, track_covariance=step.track_covariance,
                    foot_covariance_previous=step.foot_covariance_previous, foot_covariance=step.foot_covariance,
                )  # fmt: skip
            found.statuses[f"camera: {_word(report.use)}"] += 1
            step = next(steps, None)
        report = locator.update_ranges(observed.range_m[k], observed.sigma_m[k], now)
        found.statuses[f"radio: {_word(report.use)}"] += 1
        alone.update_ranges(observed.range_m[k], observed.sigma_m[k], now)
        estimate = locator.estimate()
        found.position_m[k], found.covariance_m2[k] = estimate.position_m, estimate.covariance_m2
        found.heading_rad[k], found.clock_m[k] = estimate.heading_rad, estimate.clock_m
        found.p_los[k] = estimate.p_los
        found.alone_m[k] = alone.estimate().position_m
        if k % every == 0 or k == n - 1:
            cloud = locator.particles(draw=True)
            stride = max(1, cloud.shape[1] // _CLOUD)
            found.clouds.append((float(world.epoch_s[k]), cloud[:2, ::stride].T.copy()))
    found.filter_s = time.thread_time() - began
    _agree(observed, found.statuses)
    return found


def _overlap(observed: Observed) -> None:
    """Refuse ranges and steps of different times: less than half of the shorter recording has both."""
    if not observed.steps:
        return
    radio = float(observed.epoch_s[0]), float(observed.epoch_s[-1])
    camera = observed.steps[0].t_s, observed.steps[-1].t_s
    both = min(radio[1], camera[1]) - max(radio[0], camera[0])
    if both < 0.5 * min(radio[1] - radio[0], camera[1] - camera[0]):
        raise ValueError(
            f"times that disagree: the radio's are {radio[0]:g} … {radio[1]:g} s, the camera's {camera[0]:g} … "
            f"{camera[1]:g} s; one clock for both expected (lte.time_offset_s)"
        )


def _agree(observed: Observed, statuses: Counter[str]) -> None:
    """Say what was not used."""
    n, frames = len(observed.epoch_s), len(observed.steps)
    apart = statuses["radio: clocks_disagree"] + statuses["camera: clocks_disagree"]
    late = statuses["radio: out_of_order"] + statuses["camera: out_of_order"]
    if apart + late:
        observed.notes.append(f"{apart + late} of {n + frames} observations not used: times that disagree")
    coasted = statuses["camera: coasted"]
    if coasted:
        observed.notes.append(f"{coasted} of {frames} frames without a step of the camera: coasted")
    recovered = statuses["radio: recovered"]
    if recovered:
        observed.notes.append(f"the filter was spread out again {recovered} times: most links fitted no more")


def to_run(scenario: HandsetScenario, world: Walk, observed: Observed, located: Located) -> HandsetRun:
    """What reports are made of."""
    notes = list(observed.notes)
    if not world.guarded:
        notes.append(f"a link is open for less than {100.0 * scenario.nlos.least_los_share:.0f} % of the time")
    settled = world.epoch_s >= scenario.metrics_start_s
    right = ((located.p_los > 0.5) == world.los)[settled]
    notes.append(f"sight of the links judged right {100.0 * float(np.mean(right)):.0f} % of the time")
    return HandsetRun(
        t_s=world.epoch_s,
        position_m=located.position_m,
        position_covariance_m2=located.covariance_m2,
        heading_rad=np.unwrap(located.heading_rad),
        truth=Truth(position_m=world.position_m, heading_rad=world.heading_rad),
        baselines={ALONE: located.alone_m},
        sources={f"node {k + 1}": place[:2] for k, place in enumerate(world.nodes_m)},
        notes=tuple(notes),
        nodes_m=world.nodes_m[:, :2],
        los=world.los,
        p_los=located.p_los,
        clouds=located.clouds,
        frame=observed.frame,
        timings_s={**observed.timings_s, "filter": located.filter_s},
        size_m=scenario.room.size_m,
    )


def numbers(scenario: HandsetScenario, run: HandsetRun) -> dict[str, Any]:
    """What the stages took, and how sight was judged, for metrics.json.

    Seconds of a processor but for ``wall``, the time that samples and frames took on the clock, both threads together.
    """
    settled = run.t_s >= scenario.metrics_start_s
    taken = {name: round(value, 3) for name, value in run.timings_s.items()}
    return {
        "stage": scenario.stage,
        "sight_judged_right": float(np.mean(((run.p_los > 0.5) == run.los)[settled])),
        "seconds_taken": taken,
        "times_real_time": round(scenario.duration_s / max(taken.get("wall", 0.0) + taken["filter"], 1e-9), 2),
    }
