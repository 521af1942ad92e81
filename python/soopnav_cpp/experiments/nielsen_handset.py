"""A handset with a camera among LTE nodes: nielsen 2.2.4 (NLOS as a Boolean) and 4.2.3 (the whole filter, both types).

Walks, ranges and camera steps come from `simulation.HandsetWorld`; in one variant ranges are first paths resolved out
of multipath channels at the CRS's subcarriers, and steps are estimated from feature tracks on the floor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.lte import CellLostError, PathResolver
from soopnav_cpp.navigation import HandsetLocator, HandsetRun, position_fix
from soopnav_cpp.simulation import GroundScene, HandsetWorld, foot_tracks
from soopnav_cpp.vision import Camera, RigidMotionEstimator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[np.float64]

BLUE, RED, GREEN, GREY = "#1b6ca8", "#d1495b", "#2e933c", "#5c677d"
LIGHT_MPS = 299_792_458.0
SETTLED_S = 20.0
FOUND_M = 1.0
LOST_M = 1.0
SIGMA_M = 1.0
STEP_SIGMA_M = 1e-3  # what the filter is told; the camera's own is 0.2 mm, and what it does not model is larger
TURN_SIGMA = np.radians(0.02)
MULTIPATH = {"range_sigma_m": 0.0, "duration_s": 32.0, "range_rate_hz": 5.0}  # short, for its channels take time
MULTIPATH_SIGMA_M = 2.0  # of such ranges: half are right to 0.1 m, but all together scatter by 1.5 m
LOST_HEADING_RUNS = 10


def locator(world: HandsetWorld, seed: int, **options: Any) -> HandsetLocator:
    """Start: anywhere in the room, heading known to ten degrees."""
    return HandsetLocator(
        world.nodes_m,
        start_sigma_m=6.0,
        start_heading_rad=world.told_heading_rad,
        seed=seed,
        **({"start_heading_sigma_rad": np.radians(6.0)} | options),
    )


def fused(world: HandsetWorld, seed: int, *, sigma_m: float = SIGMA_M, **options: Any) -> HandsetRun:
    """Radio and camera."""
    return locator(world, seed, **options).run(
        world.frame_s,
        world.increments,
        world.epoch_s,
        world.ranges_m,
        sigma_m=sigma_m,
        track_covariance=[STEP_SIGMA_M**2, STEP_SIGMA_M**2, TURN_SIGMA**2],
    )


def alone(world: HandsetWorld, *, sigma_m: float = SIGMA_M) -> HandsetRun:
    """LTE only: one extended Kalman filter with one clock."""
    ekf = HandsetLocator.lte_alone(world.nodes_m, start_sigma_m=6.0, acceleration_psd_m2ps3=0.1)
    return ekf.run([], np.zeros((0, 3)), world.epoch_s, world.ranges_m, sigma_m=sigma_m)


def without_camera(world: HandsetWorld, seed: int) -> HandsetRun:
    """LTE only, with a Boolean for each link: type 2 that is never given a step."""
    two = locator(world, seed, filter="measurement", particles=500)
    return two.run([], np.zeros((0, 3)), world.epoch_s, world.ranges_m, sigma_m=SIGMA_M)


def snapshot_error_m(world: HandsetWorld, every: int = 5) -> Array:
    """LTE only, each epoch for itself, by least squares."""
    found = [
        position_fix(
            world.nodes_m,
            1e-3 + ranges / LIGHT_MPS,
            np.full(len(ranges), SIGMA_M / LIGHT_MPS),
            dimensions=2,
            height_m=0.0,
            near_m=[0.0, 0.0, 0.0],
            reject_outliers=False,
        ).position_m[:2]
        for ranges in world.ranges_m[::every]
    ]
    return np.asarray(np.linalg.norm(np.array(found) - world.position_m[::every], axis=-1))


def rms(error: Array) -> float:
    """Root of the mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(error))))


# -- The Boolean


@dataclass(frozen=True)
class Switches:
    """How a run found the switches between with and without line of sight."""

    found: Array  # of each switch: whether, within `FOUND_M` of way
    delay_m: Array  # way until it was, NaN where it was not
    right: float  # share of links and epochs
    error_m: Array
    single_m: Array  # of the filter with one bias for all links
    gated_m: Array  # of that filter with a floor for outliers
    settled: npt.NDArray[np.bool_]


def switches(world: HandsetWorld, p_los: Array) -> tuple[Array, Array]:
    """Whether each switch after `SETTLED_S` was found within a metre of way, and after how much way.

    One that is undone within that metre counts as found only if it was found before; the last metre's are left out.
    """
    walked = np.interp(world.epoch_s, world.frame_s, world.walked_m)
    decided, truth = p_los < 0.5, world.nlos.blocked
    found, delay = [], []
    for before, link in np.argwhere(truth[1:] != truth[:-1]):
        k = before + 1
        if world.epoch_s[k] < SETTLED_S or walked[-1] < walked[k] + FOUND_M:
            continue
        stop = int(np.searchsorted(walked, walked[k] + FOUND_M, side="right"))
        lasts = np.flatnonzero(truth[k:stop, link] != truth[k, link])
        until = k + int(lasts[0]) if lasts.size else stop
        hits = np.flatnonzero(decided[k:until, link] == truth[k, link])
        found.append(float(hits.size > 0))
        delay.append(walked[k + hits[0]] - walked[k] if hits.size else np.nan)
    return np.array(found), np.array(delay)


def boolean_run(seed: int) -> Switches:
    """One walk with the Booleans and with a single bias for all links."""
    world = HandsetWorld.generate(seed)
    with_it = fused(world, seed)
    single = fused(world, seed, nlos=False, outlier_probability=0.0)
    gated = fused(world, seed, nlos=False)
    settled = world.epoch_s >= SETTLED_S
    found, delay = switches(world, with_it.p_los)
    right = float(np.mean((with_it.p_los < 0.5)[settled] == world.nlos.blocked[settled]))
    truth = world.position_m
    return Switches(found, delay, right, with_it.error_m(truth), single.error_m(truth), gated.error_m(truth), settled)


@experiment("nielsen-17", title="LOS or not, a Boolean per link", source="nielsen section 2.2.4, Fig. 17", runs=20)
def booleans(lab: Lab) -> Iterator[Claim]:
    """Excess delays of 4 to 20 sigma; at least three links (here four of six) have line of sight."""
    runs = lab.map(boolean_run)
    settled = runs[0].settled
    found = np.concatenate([run.found for run in runs])
    delay = np.concatenate([run.delay_m for run in runs])
    error = np.array([run.error_m for run in runs])
    single = np.array([run.single_m for run in runs])
    gated = np.array([run.gated_m for run in runs])
    world = HandsetWorld.generate(lab.seed)
    shown = fused(world, lab.seed)

    with lab.figure(9.0, 6.4) as figure:
        grid = figure.add_gridspec(2, 2, height_ratios=(1.35, 1.0))
        axes = figure.add_subplot(grid[0, :])
        _draw_links(axes, world, shown)
        axes = figure.add_subplot(grid[1, 0])
        style(axes, "Way until a switch is found", "way [m]", "switches")
        axes.hist(delay[np.isfinite(delay)], bins=[FOUND_M * k / 40 for k in range(41)], color=BLUE, log=True)
        axes = figure.add_subplot(grid[1, 1])
        style(axes, "Position, all runs", "time [s]", "rms error [m]")
        t = world.epoch_s
        axes.semilogy(t, np.sqrt(np.mean(single**2, axis=0)), color=RED, label="one bias for all links")
        axes.semilogy(t, np.sqrt(np.mean(gated**2, axis=0)), color=GREY, label="the same with a floor for outliers")
        axes.semilogy(t, np.sqrt(np.mean(error**2, axis=0)), color=BLUE, label="a Boolean for each")
        axes.set_ylim(0.03, 40.0)
        axes.legend(fontsize=8, frameon=False, loc="upper right")
    lab.save(found=found, delay_m=np.nan_to_num(delay, nan=-1.0), error_m=error, single_m=single, gated_m=gated)
    yield Claim(f"share of {len(found)} switches found within a metre of way", float(found.mean()), at_least(0.85))
    yield Claim("share of links and epochs told rightly", float(np.mean([run.right for run in runs])), at_least(0.95))
    yield Claim(
        "rms position with the Booleans over that with a single bias",
        rms(error[:, settled]) / rms(single[:, settled]),
        at_most(0.25),
    )


def _draw_links(axes: Axes, world: HandsetWorld, run: HandsetRun) -> None:
    """Truth as bands, the filter's probability as a line in each."""
    style(axes, "Probability of line of sight (line) and its absence in truth (bands)", "time [s]", "link")
    links = run.p_los.shape[1]
    for link in range(links):
        low = links - 1 - link
        axes.fill_between(
            run.t_s, low + 0.1, low + 0.9, where=world.nlos.blocked[:, link], color=RED, alpha=0.3, linewidth=0.0
        )
        axes.plot(run.t_s, low + 0.1 + 0.8 * run.p_los[:, link], color=BLUE, linewidth=0.9)
    axes.set_yticks(np.arange(links) + 0.5, [str(links - k) for k in range(links)])
    axes.set_xlim(0.0, run.t_s[-1])
    axes.set_ylim(0.0, links)
    axes.grid(False)


# -- The whole filter


@dataclass(frozen=True)
class Walk:
    """Errors of one walk at the epochs."""

    control_m: Array
    measurement_m: Array
    alone_m: Array
    snapshot_m: Array
    no_camera_m: Array  # type 2 without steps
    nees: Array  # of type 1
    harder_m: Array  # type 1, three of six without line of sight
    harder_alone_m: Array


def whole_run(seed: int) -> Walk:
    """Both types and what they are compared with."""
    world = HandsetWorld.generate(seed)
    truth = world.position_m
    one, two = fused(world, seed), fused(world, seed, filter="measurement", particles=500)
    harder = HandsetWorld.generate(seed, max_blocked=3)
    return Walk(
        one.error_m(truth),
        two.error_m(truth),
        alone(world).error_m(truth),
        snapshot_error_m(world),
        without_camera(world, seed).error_m(truth),
        one.nees(truth),
        fused(harder, seed).error_m(harder.position_m),
        alone(harder).error_m(harder.position_m),
    )


def comb() -> Array:
    """Subcarriers of the CRS of a port, both shifts of its symbols, 100 RB, in units of 15 kHz from the carrier."""
    k = np.arange(-600, 600)
    k = k[k % 3 == 0]
    return np.asarray(np.where(k >= 0, k + 1, k), dtype=np.float64)


def through_multipath(world: HandsetWorld, seed: int, snr_db: float = 15.0) -> HandsetWorld:
    """The same walk with ranges measured as first paths of channels at the reference signals' subcarriers.

    Each link has its first path, as late as the world says, and up to four echoes, from 5 m behind it on and 3 dB
    stronger than it to 15 dB weaker. They wander by 0.3 m at an epoch (so that phases are new each time) and overtake
    each other. Noise per subcarrier as `snr_db` says. The resolver is not told how many paths there are.
    """
    rng = np.random.default_rng([seed, 1])
    frequencies = comb()
    resolver = PathResolver()
    epochs, links = world.ranges_m.shape
    metres = np.linalg.norm(world.nodes_m[None, :, :2] - world.position_m[:, None], axis=-1)
    metres = metres + world.clock_m[:, None] + world.nlos.excess_m
    echoes = [int(count) for count in rng.integers(0, 5, (links,))]
    echo_m = [rng.uniform(5.0, 60.0, count) for count in echoes]
    gain = [10.0 ** (rng.uniform(-15.0, 3.0, count) / 20.0) for count in echoes]
    sigma = 10.0 ** (-snr_db / 20.0)
    ranges = np.full((epochs, links), np.nan)
    for k in range(epochs):
        for link in range(links):
            echo_m[link] = 5.0 + np.abs(echo_m[link] + 0.3 * rng.standard_normal(echoes[link]) - 5.0)
            delays = np.concatenate([[0.0], echo_m[link]]) / LIGHT_MPS
            gains = np.concatenate([[1.0], gain[link]]) * np.exp(2j * np.pi * rng.random(len(delays)))
            channel = np.exp(-2j * np.pi * 15e3 * np.outer(frequencies, delays)) @ gains
            noise = rng.standard_normal((len(frequencies), 2)) @ [1.0, 1.0j]
            channel = (channel + sigma / np.sqrt(2.0) * noise).astype(np.complex64)
            try:
                toa_s = resolver.resolve(channel, frequencies, sigma**2).toa_s
            except CellLostError:
                continue
            ranges[k, link] = metres[k, link] + toa_s * LIGHT_MPS
    return replace(world, ranges_m=ranges)


def through_tracks(world: HandsetWorld, seed: int) -> HandsetWorld:
    """The same walk with steps estimated from tracks on the floor, 60 per frame of which a tenth went astray."""
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    estimator = RigidMotionEstimator(seed=seed)
    plane = GroundScene.true_plane(1.0, (0.0, 0.0))
    increments = np.empty_like(world.increments)
    for k in range(len(increments)):
        pixels = foot_tracks(
            camera,
            tuple(world.pose[k]),
            tuple(world.pose[k + 1]),
            tracks=60,
            outlier_share=0.1,
            seed=(seed + 7919 * k) % 2**32,
        )
        increments[k] = estimator.estimate(camera, *pixels, plane, plane).increment
    return replace(world, increments=increments)


@dataclass(frozen=True)
class Multipath:
    """Errors of one walk whose ranges and steps are estimated."""

    control_m: Array
    measurement_m: Array
    alone_m: Array
    ranging_m: Array


def multipath_run(seed: int) -> Multipath:
    """Ranges out of channels, steps out of tracks; both types and LTE alone."""
    clean = HandsetWorld.generate(seed, **MULTIPATH)
    world = through_multipath(clean, seed)
    seen = through_tracks(world, seed)
    truth = world.position_m
    return Multipath(
        fused(seen, seed, sigma_m=MULTIPATH_SIGMA_M).error_m(truth),
        fused(seen, seed, sigma_m=MULTIPATH_SIGMA_M, filter="measurement", particles=500).error_m(truth),
        alone(world, sigma_m=MULTIPATH_SIGMA_M).error_m(truth),
        world.ranges_m - clean.ranges_m,
    )


def lost_heading_run(seed: int) -> Array:
    """Errors of type 1 when nothing is said of the heading at the start."""
    world = HandsetWorld.generate(seed)
    return fused(world, seed, start_heading_sigma_rad=np.pi).error_m(world.position_m)


@experiment("nielsen-sgl", title="A room walk: LTE, camera and both filters", source="nielsen section 4.2.3", runs=20)
def room_walk(lab: Lab) -> Iterator[Claim]:
    """Six nodes 25 to 60 m off, at most two of them without line of sight at a time, 60 s; errors after 20 s."""
    runs = lab.map(whole_run)
    multipath = lab.map(multipath_run)
    turned = np.array(lab.map(lost_heading_run, runs=LOST_HEADING_RUNS))
    world = HandsetWorld.generate(lab.seed)
    settled = world.epoch_s >= SETTLED_S

    def all_runs(name: str) -> Array:
        return np.array([getattr(run, name) for run in runs])

    control, measurement, lte = all_runs("control_m"), all_runs("measurement_m"), all_runs("alone_m")
    harder, harder_lte = all_runs("harder_m"), all_runs("harder_alone_m")
    snapshot, nees = all_runs("snapshot_m"), all_runs("nees")
    each = np.sqrt(np.mean(control[:, settled] ** 2, axis=1))
    blind = all_runs("no_camera_m")
    through, through_two, through_alone, ranging = (
        np.array([getattr(run, name) for run in multipath])
        for name in ("control_m", "measurement_m", "alone_m", "ranging_m")
    )
    late = HandsetWorld.generate(lab.seed, **MULTIPATH).epoch_s >= SETTLED_S

    _draw_walk(lab, world)
    with lab.figure(7.6, 4.4, part="errors") as figure:
        axes = figure.add_subplot()
        style(axes, f"Position over {len(runs)} walks", "time [s]", "rms error [m]")
        t = world.epoch_s
        for errors, time_s, color, label in (
            (snapshot, t[::5], GREY, "LTE alone, each epoch by least squares"),
            (lte, t, RED, "LTE alone, Kalman filter"),
            (blind, t, "#6f4e9c", "LTE alone, a Boolean for each link"),
            (harder, t, GREEN, "LTE and camera, type 1, up to three of six blocked"),
            (measurement, t, "#e09f3e", "LTE and camera, type 2"),
            (control, t, BLUE, "LTE and camera, type 1"),
        ):
            axes.semilogy(time_s, np.sqrt(np.mean(errors**2, axis=0)), color=color, linewidth=1.4, label=label)
        axes.set_ylim(0.03, 100.0)
        axes.legend(fontsize=8, loc="upper right", ncols=2, framealpha=0.9)
    lab.save(
        control_m=control,
        measurement_m=measurement,
        lte_alone_m=lte,
        snapshot_m=snapshot,
        no_camera_m=blind,
        three_blocked_m=harder,
        nees=nees,
        multipath_m=through,
        multipath_measurement_m=through_two,
        multipath_lte_alone_m=through_alone,
        heading_unknown_m=turned,
        multipath_ranging_m=np.nan_to_num(ranging, nan=0.0),
    )
    yield Claim("pooled rms of position, type 1", rms(control[:, settled]), at_most(0.6, "m"))
    yield Claim("pooled rms of position, type 2", rms(measurement[:, settled]), at_most(0.6, "m"))
    yield Claim(
        "rms of LTE alone over that of type 1, of type 2",
        [rms(lte[:, settled]) / rms(kind[:, settled]) for kind in (control, measurement)],
        at_least(15.0),
    )
    yield Claim(
        "rms with the Booleans and without the camera over that of type 1, of type 2",
        [rms(blind[:, settled]) / rms(kind[:, settled]) for kind in (control, measurement)],
        at_least(2.0),
    )
    yield Claim("median of the runs' rms, type 1", float(np.median(each)), at_most(0.2, "m"))
    yield Claim(f"share of runs lost (rms above {LOST_M:g} m), type 1", float(np.mean(each > LOST_M)), at_most(0.05))
    yield Claim("mean NEES of position, two dimensions, type 1", float(nees[:, settled].mean()), band(0.4, 4.0))
    yield Claim("pooled rms with up to three of six blocked, type 1", rms(harder[:, settled]), at_most(0.6, "m"))
    yield Claim(
        "rms of LTE alone over it, up to three of six blocked",
        rms(harder_lte[:, settled]) / rms(harder[:, settled]),
        at_least(5.0),
    )
    yield Claim("pooled rms with the heading unknown at the start", rms(turned[:, settled]), at_most(0.6, "m"))
    both = [rms(kind[:, late]) for kind in (through, through_two)]
    yield Claim(
        f"pooled rms of types 1 and 2 with ranges out of multipath, steps out of tracks, {len(through)} runs",
        both,
        at_most(0.6, "m"),
    )
    yield Claim(
        "rms of LTE alone over those of types 1 and 2, multipath",
        [rms(through_alone[:, late]) / kind for kind in both],
        at_least(5.0),
    )


def _draw_walk(lab: Lab, world: HandsetWorld) -> None:
    """The walk, its estimate, and the particles at four times."""
    one = locator(world, lab.seed)
    pending, shown = [0.2, 1.0, 4.0, 15.0], []
    path, frame = [], 0
    covariance = [STEP_SIGMA_M**2, STEP_SIGMA_M**2, TURN_SIGMA**2]
    for k, t in enumerate(world.epoch_s):
        while frame + 1 < len(world.frame_s) and world.frame_s[frame + 1] <= t:
            one.move(world.increments[frame], world.frame_s[frame + 1], track_covariance=covariance)
            frame += 1
        one.update_ranges(world.ranges_m[k], SIGMA_M, t)
        path.append(one.estimate().position_m)
        if pending and t >= pending[0]:
            pending.pop(0)
            shown.append((one.particles(draw=True), world.position_m[k], t))
    found = np.array(path)
    with lab.figure(10.4, 5.2) as figure:
        grid = figure.add_gridspec(2, 4, width_ratios=(1.15, 1.15, 1.0, 1.0))
        axes = figure.add_subplot(grid[:, :2])
        style(axes, "Walk among six nodes", "x [m]", "y [m]")
        lte = alone(world).position_m
        axes.plot(lte[:, 0], lte[:, 1], color=RED, linewidth=0.7, alpha=0.7, label="LTE alone")
        axes.plot(world.pose[:, 0], world.pose[:, 1], color="black", linewidth=3.0, label="truth")
        axes.plot(found[:, 0], found[:, 1], color="#8ecae6", linewidth=1.0, label="LTE and camera")
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(fontsize=8, loc="upper right", framealpha=0.9)
        inset = axes.inset_axes((0.02, 0.02, 0.3, 0.3))
        inset.plot(world.nodes_m[:, 0], world.nodes_m[:, 1], "^", color=GREEN, markersize=5)
        inset.plot(world.pose[:, 0], world.pose[:, 1], color="black", linewidth=1.0)
        inset.set_aspect("equal", adjustable="datalim")
        inset.set_title("nodes, 25 to 60 m", fontsize=7)
        inset.set_xticks([])
        inset.set_yticks([])
        for place, ((x, y, _, _), truth, t) in enumerate(shown):
            axes = figure.add_subplot(grid[place // 2, 2 + place % 2])
            style(axes, f"Particles after {t:.1f} s", "", "")
            axes.plot(x, y, ".", color=BLUE, markersize=1.2, alpha=0.4)
            axes.plot(*truth, "+", color="black", markersize=12, markeredgewidth=1.6)
            half = max(1.0, 1.2 * float(np.percentile(np.hypot(x - truth[0], y - truth[1]), 98.0)))
            axes.set_xlim(truth[0] - half, truth[0] + half)
            axes.set_ylim(truth[1] - half, truth[1] + half)
            axes.set_aspect("equal")
