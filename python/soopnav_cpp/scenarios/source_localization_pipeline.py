"""The chain of a ``source_localization`` scenario, a function for each stage.

`path_of` (poses), `hear` (samples, directions, bearings with their deviations), `groups` and `locate` (positions),
`to_run` (what reports are made of). The same `Heard` may be located as often as one likes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import array
from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios import emitters as solving
from soopnav_cpp.scenarios.base import Truth, Updates
from soopnav_cpp.scenarios.bearings import BearingsData
from soopnav_cpp.scenarios.emitters import Emitter
from soopnav_cpp.scenarios.poses import Poses, attitude, covariances_from_ratio, read_poses, rotations
from soopnav_cpp.scenarios.source_localization import EmitterRun, PlatformSettings, SourceLocalizationScenario
from soopnav_cpp.simulation import ArrayLink, FrontEnd

__all__ = ["Heard", "emitters_at", "groups", "hear", "locate", "manifold_of", "path_of", "route", "to_run"]

_Array = npt.NDArray[np.float64]

# Streams of a run's seed.
_FAULTS, _POSE, _MAP = range(3)
_TONE_STREAM = 1 << 40  # of the front end, beyond those of epochs
_TONE_SHARE = 0.0625  # of the calibration's tone to the sample rate
_TONE_SAMPLES = 16_384
_HEADROOM_DB = 6.0  # of the converters above that tone
_CHUNK = 64  # epochs whose samples are held at a time
_MAP_TRIALS = 400
_CACHE: dict[tuple[Any, ...], Any] = {}  # deviations by eigenvalue ratio: the same for all runs of a scenario


def route(waypoints_m: _Array, radius_m: float, share: _Array) -> tuple[_Array, _Array]:
    """Places along legs that arcs join, at shares of their length, and the directions of travel (east towards north).

    Parameters
    ----------
    waypoints_m : ndarray, shape (w, 2)
    radius_m : float
        Of the arcs; smaller ones where a leg is too short for it.
    share : ndarray, shape (n,)
        0 ... 1.
    """
    points = np.asarray(waypoints_m, dtype=np.float64)
    legs = np.diff(points, axis=0)
    length = np.linalg.norm(legs, axis=1)
    along = np.arctan2(legs[:, 1], legs[:, 0])
    turn = np.angle(np.exp(1j * np.diff(along)))
    # How much of both legs each corner takes: no more than half of the shorter one (all of it at an end).
    room = np.minimum(length[:-1] * np.where(np.arange(len(turn)) == 0, 1.0, 0.5),
                      length[1:] * np.where(np.arange(len(turn)) == len(turn) - 1, 1.0, 0.5))  # fmt: skip
    half = np.tan(np.minimum(0.5 * np.abs(turn), 0.499 * np.pi))
    cut = np.minimum(radius_m * half, room)
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.where(half > 1e-12, cut / half, 0.0)
    pieces: list[tuple[float, _Array, float, float]] = []  # length, start, direction, curvature
    at = points[0]
    for k in range(len(legs)):
        straight = length[k] - (cut[k - 1] if k else 0.0) - (cut[k] if k < len(turn) else 0.0)
        pieces.append((max(straight, 0.0), at, float(along[k]), 0.0))
        at = at + max(straight, 0.0) * np.array([math.cos(along[k]), math.sin(along[k])])
        if k < len(turn):
            if radius[k] > 0.0:
                pieces.append(
                    (float(radius[k] * abs(turn[k])), at, float(along[k]), math.copysign(1.0 / radius[k], turn[k]))
                )
            at = points[k + 1] + cut[k] * np.array([math.cos(along[k + 1]), math.sin(along[k + 1])])
    ends = np.cumsum([piece[0] for piece in pieces])
    distance = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0) * ends[-1]
    which = np.minimum(np.searchsorted(ends, distance, side="left"), len(pieces) - 1)
    place, direction = np.empty((len(distance), 2)), np.empty(len(distance))
    for k, (reach, start, angle, curvature) in enumerate(pieces):
        mine = which == k
        s = distance[mine] - (ends[k] - reach)
        direction[mine] = angle + curvature * s
        if curvature == 0.0:
            place[mine] = start + s[:, None] * np.array([math.cos(angle), math.sin(angle)])
        else:
            end = angle + curvature * s
            arc = np.column_stack([np.sin(end) - math.sin(angle), math.cos(angle) - np.cos(end)]) / curvature
            place[mine] = start + arc
    return place, direction


def frame_of(scenario: SourceLocalizationScenario) -> LocalFrame | None:
    """Where the scenario's metres lie on the Earth."""
    origin = scenario.origin
    if origin is None:
        return None
    return LocalFrame(math.radians(origin.latitude_deg), math.radians(origin.longitude_deg), origin.height_m)


def path_of(scenario: SourceLocalizationScenario) -> Poses:
    """The platform's true poses at the epochs of bearings.

    Raises
    ------
    ValueError
        For a recording that does not cover the scenario.
    """
    platform: PlatformSettings = scenario.platform
    count = math.floor(scenario.duration_s * scenario.finder.rate_hz + 1e-9) + 1
    t_s = np.arange(count) / scenario.finder.rate_hz
    if platform.poses is not None:
        recorded = read_poses(platform.poses)
        if recorded.t_s[0] > 0.0 or recorded.t_s[-1] < t_s[-1] - 1e-9:
            raise ValueError(
                f"{platform.poses}: poses from {recorded.t_s[0]:g} to {recorded.t_s[-1]:g} s; duration_s = "
                f"{scenario.duration_s:g} needs 0 … {t_s[-1]:g} s"
            )
        frame = frame_of(scenario)
        if recorded.frame is not None and frame is not None:
            recorded = recorded.seen_from(frame)
        return recorded.at(t_s)
    place, direction = route(np.array(platform.waypoints_m), platform.corner_radius_m, t_s / t_s[-1])
    nothing = np.zeros(count)
    position = np.column_stack([place, np.full(count, platform.height_m)])
    return Poses(t_s, position, attitude(0.5 * np.pi - direction, nothing, nothing))


@dataclass(frozen=True, eq=False)
class Heard:
    """Bearings of one run, and what is known of each.

    Attributes
    ----------
    data : BearingsData
        Bearings that are used, with the platform's stated poses; with one emitter also the truth.
    poses : Poses
        The truth, at every epoch.
    emitters_m : ndarray, shape (E, K, 3)
        Where the emitters were at the epochs.
    nearest : ndarray of int, shape (n,)
        The emitter whose true direction is the nearest to each bearing, by its index.
    range_m, error_rad : ndarray, shape (n,)
        That emitter's true distance, and bearing minus truth, the short way round.
    spectrum : ndarray, shape (L, A)
        Of the epoch with the highest SNR over `grid_elevation_rad` and `grid_azimuth_rad`, in array axes.
    found_rad : ndarray, shape (K, 2)
        Azimuths and elevations found in it.
    notes : tuple of str
    """

    data: BearingsData
    poses: Poses
    emitters_m: _Array
    nearest: npt.NDArray[np.int64]
    range_m: _Array
    error_rad: _Array
    spectrum: _Array
    grid_azimuth_rad: _Array
    grid_elevation_rad: _Array
    found_rad: _Array
    notes: tuple[str, ...]


def emitters_at(scenario: SourceLocalizationScenario, t_s: _Array) -> _Array:
    """Positions of all emitters, shape (E, K, 3)."""
    start = np.array([item.position_m for item in scenario.emitters])
    speed = np.array([item.velocity_mps for item in scenario.emitters])
    return np.asarray(start + speed * t_s[:, None, None])


def manifold_of(scenario: SourceLocalizationScenario) -> Any:
    """The array as the direction finder knows it."""
    settings = scenario.array
    if settings.file is not None:
        return array.load_array(settings.file)
    if settings.kind == "planar":
        geometry = array.ArrayGeometry.planar(
            settings.nx, settings.ny, settings.spacing_wavelengths, frequency_hz=settings.frequency_hz
        )
    else:
        geometry = array.ArrayGeometry.uca(
            settings.elements, settings.radius_wavelengths, frequency_hz=settings.frequency_hz
        )
    return array.Manifold(geometry)


def _random(seed: int, kind: int) -> np.random.Generator:
    return np.random.default_rng([seed, kind])


@dataclass(frozen=True, eq=False)
class _Receivers:
    """Front end and what was found out about it."""

    front_end: FrontEnd | None
    calibration: Any | None


def _receivers(scenario: SourceLocalizationScenario, geometry: Any, noise_floor_dbm: float, seed: int) -> _Receivers:
    """Faults drawn for this run; with a calibration, a tone goes through them first."""
    settings, link = scenario.front_end, scenario.link
    if settings.ideal:
        return _Receivers(None, None)
    rng, elements = _random(seed, _FAULTS), len(geometry.positions_m)
    front_end = FrontEnd(
        elements,
        sample_rate_hz=link.sample_rate_hz,
        noise_figure_db=link.noise_figure_db,
        phase_delay_rad=rng.uniform(-np.pi, np.pi, elements) * float(settings.random_phases),
        iq_gain_db=settings.iq_gain_db * rng.standard_normal(elements),
        iq_phase_rad=np.radians(settings.iq_phase_deg) * rng.standard_normal(elements),
        adc_bits=settings.adc_bits,
        full_scale_dbm=noise_floor_dbm + settings.tone_snr_db + _HEADROOM_DB,
    )
    if not settings.calibrate:
        return _Receivers(front_end, None)
    tone_hz = _TONE_SHARE * link.sample_rate_hz
    level = 10.0 ** ((front_end.noise_floor_dbm + settings.tone_snr_db) / 20.0)
    turn = np.exp(2j * np.pi * _TONE_SHARE * np.arange(_TONE_SAMPLES))
    tone = np.tile((level * turn).astype(np.complex64), (elements, 1))
    heard = front_end.apply(tone, seed, _TONE_STREAM)
    return _Receivers(front_end, array.calibrate(heard, link.sample_rate_hz, tone_hz, geometry))


def hear(scenario: SourceLocalizationScenario, seed: int) -> Heard:
    """Samples of every epoch, directions, bearings with deviations. All randomness comes from the seed."""
    poses = path_of(scenario)
    emitters = emitters_at(scenario, poses.t_s)
    manifold = manifold_of(scenario)
    settings, n, count = scenario.link, len(poses.t_s), len(scenario.emitters)
    real = manifold
    if scenario.array.gain_error_db or scenario.array.phase_error_deg:
        real = manifold.with_random_errors(
            scenario.array.gain_error_db, math.radians(scenario.array.phase_error_deg), seed
        )
    link = ArrayLink(
        real,
        sample_rate_hz=settings.sample_rate_hz,
        noise_figure_db=settings.noise_figure_db,
        excess_loss_db=settings.excess_loss_db,
        transmit_power_dbm=0.0,
        bandwidth_ratio=settings.bandwidth_ratio,
    )
    turn = rotations(poses.quaternion_wxyz)
    seen = [link.directions(poses.position_m, emitters[:, k], turn) for k in range(count)]
    azimuth, elevation, distance = (np.column_stack([one[i] for one in seen]) for i in range(3))
    power = link.received_power_dbm(distance) + np.array([item.power_dbm for item in scenario.emitters])
    receivers = _receivers(scenario, manifold.geometry, link.noise_floor_dbm, seed)
    finder = array.DirectionFinder(
        manifold,
        n_sources=count,
        azimuth_step_deg=scenario.finder.azimuth_step_deg,
        elevation_step_deg=scenario.finder.elevation_step_deg,
    )
    rows = _Rows(len(manifold.geometry.positions_m), finder)
    for chunk, begin in enumerate(range(0, n, _CHUNK)):
        part = slice(begin, min(begin + _CHUNK, n))
        level: dict[str, Any] = (
            {"snr_db": power[part] - link.noise_floor_dbm}
            if receivers.front_end is None
            else {"power_dbm": power[part], "front_end": receivers.front_end}
        )
        blocks = link.blocks(
            azimuth[part], elevation[part], n_samples=settings.samples, seed=seed, stream=chunk * _CHUNK, **level
        )
        for offset, block in enumerate(blocks):
            rows.take(begin + offset, block if receivers.calibration is None else receivers.calibration.apply(block))
    return _heard(scenario, seed, poses, emitters, manifold, rows)


class _Rows:
    """What the direction finder said, epoch by epoch."""

    def __init__(self, elements: int, finder: Any) -> None:
        self.finder = finder
        self.elements = elements
        self.epoch: list[int] = []
        self.azimuth: list[float] = []
        self.elevation: list[float] = []
        self.covariance: list[_Array] = []
        self.snr_db: list[float] = []
        self.eigenvalues: list[_Array] = []
        self.best: tuple[float, npt.NDArray[np.complex64], int, _Array] | None = None
        self.empty = 0

    def take(self, epoch: int, block: npt.NDArray[np.complex64]) -> None:
        """Directions of one block."""
        found = self.finder.estimate(block)
        count = len(found.azimuth_rad)
        values = np.asarray(found.eigenvalues, dtype=np.float64)
        self.eigenvalues.append(values if len(values) == self.elements else np.full(self.elements, np.nan))
        if not count:
            self.empty += 1
            return
        for k in range(count):
            self.epoch.append(epoch)
            self.azimuth.append(float(found.azimuth_rad[k]))
            self.elevation.append(float(found.elevation_rad[k]))
            self.covariance.append(np.asarray(found.covariance_rad2[k]))
            self.snr_db.append(10.0 * math.log10(max(float(found.power[k]) / found.noise, 1e-9)))
        if self.best is None or self.snr_db[-count] > self.best[0]:
            directions = np.column_stack([found.azimuth_rad, found.elevation_rad])
            self.best = (self.snr_db[-count], np.array(block), count, directions)


def _sigma_map(scenario: SourceLocalizationScenario, manifold: Any) -> Any:
    """Deviation by eigenvalue ratio of this array, made once for all runs."""
    key = (scenario.array.model_dump_json(), scenario.link.samples)
    if key not in _CACHE:
        _CACHE.clear()
        _CACHE[key] = array.SigmaMap.build(manifold, scenario.link.samples, trials=_MAP_TRIALS, seed=_MAP)
    return _CACHE[key]


def _covariances(scenario: SourceLocalizationScenario, manifold: Any, rows: _Rows) -> _Array:
    """Of azimuth and elevation of each bearing: carter section 5.3, or MUSIC's own theory."""
    theory = np.array(rows.covariance)
    if scenario.finder.sigma == "theory" or len(scenario.emitters) > 1:
        return theory
    table = _sigma_map(scenario, manifold)
    ratio = table.smooth(np.array(rows.eigenvalues), epochs=scenario.finder.smooth_epochs)
    return covariances_from_ratio(table, ratio[rows.epoch], np.array(rows.elevation))


def _heard(
    scenario: SourceLocalizationScenario,
    seed: int,
    poses: Poses,
    emitters: _Array,
    manifold: Any,
    rows: _Rows,
) -> Heard:
    """Directions made bearings with what the platform states of its own pose."""
    if rows.best is None:
        raise ValueError("no epoch has a direction")
    epoch = np.array(rows.epoch, dtype=np.int64)
    covariance = _covariances(scenario, manifold, rows)
    platform, rng = scenario.platform, _random(seed, _POSE)
    n = len(poses.t_s)
    position = poses.position_m + platform.position_sigma_m * rng.standard_normal((n, 3)) * np.array([1.0, 1.0, 0.0])
    heading_error = math.radians(platform.heading_sigma_deg) * rng.standard_normal(n)
    here = Poses(poses.t_s[epoch], poses.position_m[epoch], poses.quaternion_wxyz[epoch], poses.frame)
    bearing, elevation, spread = here.to_level(np.array(rows.azimuth), np.array(rows.elevation), covariance)
    bearing = np.angle(np.exp(1j * (bearing - heading_error[epoch])))  # a heading clockwise takes bearings along
    to = emitters[epoch] - here.position_m[:, None]
    right = np.arctan2(to[:, :, 1], to[:, :, 0])
    off = np.angle(np.exp(1j * (bearing[:, None] - right)))
    nearest = np.argmin(np.abs(off), axis=1)
    pick = np.arange(len(epoch))
    sigma = np.sqrt(spread[:, 0, 0])
    good = np.isfinite(sigma) & (sigma > 0.0) & (sigma <= math.radians(scenario.finder.worst_sigma_deg))
    if not good.any():
        raise ValueError(f"no bearing is better than finder.worst_sigma_deg = {scenario.finder.worst_sigma_deg:g}")
    one = len(scenario.emitters) == 1

    def stated(value: float) -> _Array | None:
        return np.full(int(good.sum()), value) if value > 0.0 else None

    frame = frame_of(scenario) if poses.frame is None else poses.frame
    data = BearingsData(
        t_s=here.t_s[good],
        position_m=position[epoch][good],
        bearing_rad=bearing[good],
        sigma_rad=sigma[good],
        elevation_rad=elevation[good],
        sigma_elevation_rad=np.maximum(np.sqrt(spread[:, 1, 1]), 1e-6)[good],
        position_sigma_m=stated(platform.position_sigma_m),
        heading_sigma_rad=stated(math.radians(platform.heading_sigma_deg)),
        snr_db=np.array(rows.snr_db)[good],
        truth_m=emitters[epoch, 0][good] if one else None,
        frame=frame,
    )
    notes = []
    if rows.empty:
        notes.append(f"{rows.empty} of {n} epochs without a direction")
    if not good.all():
        notes.append(
            f"{int((~good).sum())} of {len(good)} bearings are worse than {scenario.finder.worst_sigma_deg:g}° and not "
            "used"
        )
    _, block, count, directions = rows.best
    table = rows.finder.table
    return Heard(
        data=data,
        poses=poses,
        emitters_m=emitters,
        nearest=nearest[good],
        range_m=np.linalg.norm(to[pick, nearest], axis=1)[good],
        error_rad=off[pick, nearest][good],
        spectrum=rows.finder.spectrum(array.covariance(block), count),
        grid_azimuth_rad=table.azimuth_rad,
        grid_elevation_rad=table.elevation_rad,
        found_rad=directions,
        notes=tuple(notes),
    )


def groups(scenario: SourceLocalizationScenario, heard: Heard) -> tuple[dict[str, BearingsData], int]:
    """Bearings by emitter under the scenario's names and in its order, and how many belong to none.

    Several emitters are told apart by where the bearings point (`navigation.SourceTracks`); a track has the name of the
    emitter that most of its bearings are of.
    """
    names = scenario.emitter_names
    if len(names) == 1:
        return {names[0]: heard.data}, 0
    label = solving.associate(heard.data, moving=scenario.locator.moving)
    found: dict[int, npt.NDArray[np.bool_]] = {}
    for track in sorted(np.unique(label[label >= 0]).tolist(), key=lambda k: -int(np.sum(label == k))):
        mine = label == track
        who = int(np.bincount(heard.nearest[mine]).argmax())
        if who not in found:
            found[who] = mine
    parts: dict[str, BearingsData] = {}
    for who in sorted(found):
        part = heard.data.of(found[who])
        epoch = np.searchsorted(heard.poses.t_s, part.t_s - 1e-9)
        parts[names[who]] = replace(part, truth_m=heard.emitters_m[epoch, who])
    return parts, len(label) - sum(int(mine.sum()) for mine in found.values())


def locate(scenario: SourceLocalizationScenario, heard: Heard, seed: int) -> list[Emitter]:
    """Every emitter by every method, in the scenario's order."""
    settings = scenario.locator
    parts, _ = groups(scenario, heard)
    return [
        solving.solve(name, part, settings.methods, dimensions=settings.dimensions, moving=settings.moving, seed=seed)
        for name, part in parts.items()
    ]


def to_run(scenario: SourceLocalizationScenario, heard: Heard, located: list[Emitter]) -> EmitterRun:
    """What reports are made of: positions of the first emitter, from the time that every method has one.

    Raises
    ------
    ValueError
        When it was never found.
    """
    name = scenario.emitter_names[0]
    emitter = next((one for one in located if one.name == name), None)
    main = None if emitter is None else emitter.histories.get(emitter.method)
    if emitter is None or main is None:
        raise ValueError(f"{name}: not found" + ("" if emitter is None else f": {emitter.fix.message}"))
    data, d = emitter.data, main.position_m.shape[1]
    others = {method: h for method, h in emitter.histories.items() if method != emitter.method}
    t_s = main.t_s
    for other in others.values():
        t_s = np.intersect1d(t_s, other.t_s)
    if not len(t_s):
        raise ValueError(f"{name}: no time at which every method has a position")
    at = np.searchsorted(main.t_s, t_s)
    position, covariance = main.position_m[at], main.covariance_m2[at]
    assert data.truth_m is not None  # of a simulation
    right = np.column_stack([np.interp(t_s, data.t_s, column) for column in data.truth_m.T[:d]])
    notes = [f"positions and ellipses over time are those of {emitter.method} for {name}", *heard.notes]
    missing = [one for one in scenario.emitter_names if one not in {each.name for each in located}]
    if missing:
        notes.append(f"not found: {', '.join(missing)}")
    for each in located:
        if each.found:
            error = each.error_m(each.method)
            notes.append(f"{each.name}: found {error:.2f} m from where it was (CEP {each.fix.cep_m:.2f} m)")
    return EmitterRun(
        t_s=t_s,
        position_m=position,
        position_covariance_m2=covariance,
        truth=Truth(position_m=right),
        updates=_updates(data, t_s, position, covariance),
        baselines={method: h.position_m[np.searchsorted(h.t_s, t_s)] for method, h in others.items()},
        sources={
            other: heard.emitters_m[-1, k, :d] for k, other in enumerate(scenario.emitter_names) if other != name
        },
        notes=tuple(notes),
        origin_lla_deg=None if data.frame is None else (
            math.degrees(data.frame.latitude_rad), math.degrees(data.frame.longitude_rad), data.frame.height_m),
        heard=heard,
        located=located,
    )  # fmt: skip


def _updates(data: BearingsData, t_s: _Array, position: _Array, covariance: _Array) -> Updates | None:
    """Each bearing against the position before it: what a filter would call its innovation, in degrees."""
    before = np.searchsorted(t_s, data.t_s - 1e-9) - 1
    mine = before >= 0
    if not mine.any():
        return None
    k = before[mine]
    way = position[k, :2] - data.position_m[mine, :2]
    innovation = np.angle(np.exp(1j * (data.bearing_rad[mine] - np.arctan2(way[:, 1], way[:, 0]))))
    range2 = np.maximum(np.sum(way**2, axis=1), 1.0)
    across = np.column_stack([-way[:, 1], way[:, 0]]) / range2[:, None]
    variance = np.square(data.sigma_rad[mine]) + np.einsum("ni,nij,nj->n", across, covariance[k][:, :2, :2], across)
    if data.heading_sigma_rad is not None:
        variance += np.square(data.heading_sigma_rad[mine])
    if data.position_sigma_m is not None:
        variance += np.square(data.position_sigma_m[mine]) / range2
    to_degrees = math.degrees(1.0)
    return Updates(
        t_s=data.t_s[mine],
        source=np.zeros(int(mine.sum()), np.int64),
        innovation=innovation * to_degrees,
        variance=variance * to_degrees**2,
        status=np.full(int(mine.sum()), "accepted"),
        source_names=("bearings",),
        unit="deg",
    )
