"""From bearings to emitters: every method on the same bearings, what each says, and how it got there over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import navigation
from soopnav_cpp.scenarios.bearings import BearingsData

__all__ = [
    "METHODS",
    "MOVING_METHODS",
    "Emitter",
    "History",
    "associate",
    "has_position",
    "separate",
    "solve",
    "status_word",
]

Array = npt.NDArray[np.float64]

#: In the order of tables: what is the best first.
METHODS = ("ml", "stansfield", "least_squares", "ekf_bank", "particle", "ekf", "centroid", "incenter", "linear")
#: Those that know emitters that move.
MOVING_METHODS = ("ml", "least_squares", "ekf_bank", "ekf")
_MOST_EPOCHS = 400  # of a history: more bearings than that are taken in groups
_FILTERS = ("ekf", "ekf_bank", "particle", "linear", "centroid", "incenter")  # whose steps cost the same however many
_BANK_SIGMA_RAD = math.radians(10.0)  # of a bearing that starts a bank
_ANYWHERE_M = 1e7  # a deviation that says nothing
_SURFACE = 121  # points along a side
_WITH_POSITION = ("converged", "inconsistent", "not_converged")


@dataclass(frozen=True, eq=False)
class History:
    """A method's positions over time, at the epochs that had one.

    Attributes
    ----------
    t_s : ndarray, shape (m,)
    position_m : ndarray, shape (m, d)
    covariance_m2 : ndarray, shape (m, d, d)
    """

    t_s: Array
    position_m: Array
    covariance_m2: Array


@dataclass(eq=False)
class Emitter:
    """An emitter and what was found out about it.

    Attributes
    ----------
    name : str
    data : BearingsData
        Its bearings.
    method : str
        Whose fix counts.
    fixes : dict of str to SourceFix
        By method.
    histories : dict of str to History
    surface : (x_m, y_m, log_likelihood), or None
    cloud : (particles_m, weights), or None
    """

    name: str
    data: BearingsData
    method: str
    fixes: dict[str, Any] = field(default_factory=dict)
    histories: dict[str, History] = field(default_factory=dict)
    surface: tuple[Array, Array, Array] | None = None
    cloud: tuple[Array, Array] | None = None

    @property
    def fix(self) -> Any:
        """That of the method that counts."""
        return self.fixes[self.method]

    @property
    def found(self) -> bool:
        """Whether there is a position."""
        return has_position(self.fix)

    @property
    def truth_m(self) -> Array | None:
        """Where it was at its last bearing."""
        return None if self.data.truth_m is None else self.data.truth_m[-1]

    def error_m(self, method: str) -> float | None:
        """Horizontal distance of a method's position from the truth; None without either."""
        fix, right = self.fixes[method], self.truth_m
        if right is None or not has_position(fix):
            return None
        return float(np.linalg.norm(np.asarray(fix.position_m)[:2] - right[:2]))


def status_word_of(status: Any) -> str:
    """In lower case."""
    return str(status.name).lower()


def status_word(fix: Any) -> str:
    """How a fix ended, in lower case."""
    return status_word_of(fix.status)


def has_position(fix: Any) -> bool:
    """Whether a fix is a position to rely on as far as its ellipse says, and its ellipse says anything."""
    if status_word(fix) not in _WITH_POSITION or not np.isfinite(np.asarray(fix.position_m, np.float64)).all():
        return False
    total = float(np.trace(np.asarray(fix.covariance_m2, np.float64)))
    return not total > _ANYWHERE_M**2  # NaN: a method that states none


def _angles(data: BearingsData, dimensions: int) -> tuple[Array, Array]:
    """Bearings and deviations as the locators take them."""
    if dimensions == 2:
        return data.bearing_rad, data.sigma_rad
    if data.elevation_rad is None or data.sigma_elevation_rad is None:
        raise ValueError("three dimensions need elevations: a column elevation_deg or bearing_elevation_deg")
    return (
        np.column_stack([data.bearing_rad, data.elevation_rad]),
        np.column_stack([data.sigma_rad, data.sigma_elevation_rad]),
    )


def _pose(data: BearingsData, dimensions: int) -> dict[str, Any]:
    """What is known of the platform's own errors, as keywords of the locators."""
    known: dict[str, Any] = {}
    if data.position_sigma_m is not None:
        known["position_covariance"] = np.square(data.position_sigma_m)[:, None, None] * np.eye(dimensions)
    if data.heading_sigma_rad is not None:
        known["heading_sigma_rad"] = data.heading_sigma_rad
    return known


def separate(data: BearingsData, *, force: bool = False, moving: bool = False) -> tuple[dict[str, BearingsData], int]:
    """Bearings by emitter, and how many belong to none.

    The column ``emitter`` says whose a bearing is. Without it there is one emitter, unless bearings share a time (or
    with `force`): then they are given to emitters by where they point (`navigation.SourceTracks`).
    """
    if data.emitter is not None:
        names = list(dict.fromkeys(name for name in data.emitter.tolist() if name))
        parts = {f"emitter {name}" if name.isdecimal() else name: data.of(data.emitter == name) for name in names}
        return parts, int(np.sum(data.emitter == ""))
    if not force and len(np.unique(data.t_s)) == len(data):
        return {"emitter": data}, 0
    label = associate(data, moving=moving)
    kept = [int(k) for k in np.unique(label[label >= 0])]
    order = sorted(kept, key=lambda k: -int(np.sum(label == k)))
    return (
        {f"emitter {i + 1}": data.of(label == k) for i, k in enumerate(order)},
        int(np.sum(label < 0)),
    )


def associate(data: BearingsData, *, moving: bool = False) -> npt.NDArray[np.int64]:
    """Which emitter each bearing is of, shape (n,), counted from 0; -1 for none.

    Bearings of one time are shared out among tracks (`navigation.SourceTracks`), which look as far as `solve` does and
    know the platform's own errors; those that were confirmed count. Bearings that no track took at its time, for it had
    not begun, go to the one emitter that they point at in the end: within three standard deviations, and beyond six of
    every other.

    Parameters
    ----------
    data : BearingsData
    moving : bool
        Emitters may move at a constant velocity.
    """
    options = _options(data, "ekf_bank") | {"bank_azimuths": 0, "bank_sigma_rad": _start_sigma_rad(data)}
    del options["max_bearings"]  # of methods that keep them
    tracks = navigation.SourceTracks(motion="constant_velocity" if moving else "static", **options)
    pose = _pose(data, 2)
    owner = np.full(len(data), -1, dtype=np.int64)
    last: dict[int, tuple[float, Any]] = {}
    confirmed: dict[int, int] = {}
    first = np.unique(data.t_s, return_index=True)[1]
    for begin, end in zip(first, [*first[1:], len(data)], strict=True):
        rows, t_s = np.arange(begin, end), float(data.t_s[begin])
        current = tracks.step(
            t_s, data.position_m[begin, :2], data.bearing_rad[rows], data.sigma_rad[rows],
            **{name: value[begin] for name, value in pose.items()},
        )  # fmt: skip
        for track in current:
            if track.bearing >= 0:
                owner[rows[track.bearing]] = track.id
            last[track.id] = (t_s, track.fix)
            if track.state.name == "CONFIRMED":
                confirmed[track.id] = track.hits
    order = sorted(confirmed, key=lambda one: -confirmed[one])
    label = np.full(len(data), -1, dtype=np.int64)
    for number, one in enumerate(order):
        label[owner == one] = number
    if order:
        way = np.stack([_course(*last[one], data.t_s) for one in order], axis=1) - data.position_m[:, None, :2]
        off = np.angle(np.exp(1j * (data.bearing_rad[:, None] - np.arctan2(way[..., 1], way[..., 0]))))
        off = np.abs(np.nan_to_num(off, nan=np.pi)) / data.sigma_rad[:, None]
        nearest = np.argmin(off, axis=1)
        least = off[np.arange(len(off)), nearest]
        off[np.arange(len(off)), nearest] = np.inf
        clear = (label < 0) & (least < 3.0) & (off.min(axis=1) > 6.0)
        label[clear] = nearest[clear]
    return label


def _start_sigma_rad(data: BearingsData) -> float:
    """Of a bearing that starts a track: the better half do where all are coarse."""
    return max(_BANK_SIGMA_RAD, 1.001 * float(np.median(_whole_sigma_rad(data))))


def _whole_sigma_rad(data: BearingsData) -> Array:
    """Of bearings with the platform's heading, as a bank sees them before it starts."""
    return data.sigma_rad if data.heading_sigma_rad is None else np.hypot(data.sigma_rad, data.heading_sigma_rad)


def _course(at_s: float, fix: Any, t_s: Array) -> Array:
    """Where a track's emitter was at other times, shape (n, 2)."""
    place, velocity = (np.asarray(v, dtype=np.float64)[:2] for v in (fix.position_m, fix.velocity_mps))
    return np.asarray(place + np.nan_to_num(velocity) * (t_s[:, None] - at_s))


def solve(
    name: str,
    data: BearingsData,
    methods: Sequence[str],
    *,
    dimensions: int = 2,
    moving: bool = False,
    seed: int = 1,
    history: bool = True,
    extras: bool = True,
) -> Emitter:
    """Locate one emitter by each method.

    Parameters
    ----------
    name : str
    data : BearingsData
        Its bearings alone.
    methods : sequence of str
        Of `METHODS`; the first one counts.
    dimensions : {2, 3}
    moving : bool
        It may move at a constant velocity; `MOVING_METHODS` only.
    seed : int
        Of the particles.
    history : bool
        Positions over time as well.
    extras : bool
        A likelihood surface and, of the particle filter, its cloud.

    Returns
    -------
    Emitter

    Raises
    ------
    ValueError
        For three dimensions without elevations.
    """
    emitter = Emitter(name, data, methods[0])
    angles, sigmas = _angles(data, dimensions)
    position = data.position_m[:, :dimensions]
    pose = _pose(data, dimensions)
    motion = "constant_velocity" if moving else "static"
    for method in methods:
        options = _options(data, method)
        if not history or (len(data) > _MOST_EPOCHS and method not in _FILTERS):
            emitter.fixes[method] = navigation.locate_source(
                position, angles, sigmas, method, times=data.t_s, motion=motion, seed=seed, **options, **pose
            )
            continue
        locator = navigation.SourceLocator(method, dimensions=dimensions, motion=motion, seed=seed, **options)
        before = slice(0, len(data) - 1)
        run = locator.run(
            data.t_s[before], position[before], angles[before], sigmas[before],
            **{name: value[before] for name, value in pose.items()},
        )  # fmt: skip
        fix = locator.step(
            float(data.t_s[-1]), position[-1], angles[-1], sigmas[-1],
            **{name: value[-1] for name, value in pose.items()},
        )  # fmt: skip
        emitter.fixes[method] = fix
        kept = _history(data.t_s, run, fix)
        if kept is not None:
            emitter.histories[method] = kept
        if method == "particle" and extras:
            emitter.cloud = (locator.particles_m, locator.particle_weights)
    if extras and dimensions == 2 and not moving and emitter.found:
        emitter.surface = _surface(emitter)
    return emitter


def _options(data: BearingsData, method: str) -> dict[str, Any]:
    """How far emitters are looked for: twenty times as far as the platform went; a bank looks all round when no bearing
    is good enough to start it."""
    extent = float(np.linalg.norm(np.ptp(data.position_m[:, :2], axis=0)))
    far = 20.0 * extent if extent > 0.0 else 3000.0
    options: dict[str, Any] = {"max_range_m": far, "min_range_m": 0.01 * far, "max_bearings": max(4096, len(data))}
    if method == "ekf_bank":
        options["bank_azimuths"] = 0 if float(_whole_sigma_rad(data).min()) < _BANK_SIGMA_RAD else 12
    return options


def _history(t_s: Array, run: Any, last: Any) -> History | None:
    """The epochs that have a position, of bearings at one time the last: those of a run, and the fix after it.

    Of a run that converges, only the epochs that did: a point that explains no bearings has no deviation to show.
    """
    words = [*(status_word_of(status) for status in run.status), status_word(last)]
    position = np.vstack([run.position_m, last.position_m])
    covariance = np.concatenate([run.covariance_m2, np.asarray(last.covariance_m2)[None]])
    shown = _WITH_POSITION[:1] if _WITH_POSITION[0] in words else _WITH_POSITION
    good = np.array([word in shown for word in words])
    good[-1] = words[-1] in _WITH_POSITION
    good &= np.isfinite(position).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    good &= np.append(np.diff(t_s) > 0.0, True)
    return History(t_s[good], position[good], covariance[good]) if good.any() else None


def _surface(emitter: Emitter) -> tuple[Array, Array, Array] | None:
    """The likelihood about the position, as far as four times its larger deviation."""
    covariance = np.asarray(emitter.fix.covariance_m2, dtype=np.float64)[:2, :2]
    if not np.isfinite(covariance).all():
        return None
    reach = 5.0 * math.sqrt(float(np.linalg.eigvalsh(0.5 * (covariance + covariance.T))[-1]))
    if not reach > 0.0:
        return None
    data = emitter.data
    centre = np.asarray(emitter.fix.position_m, dtype=np.float64)[:2]
    x, y = ((float(centre[k] - reach), float(centre[k] + reach)) for k in range(2))
    return navigation.likelihood_surface(
        data.position_m[:, :2], data.bearing_rad, data.sigma_rad, x, y, shape=(_SURFACE, _SURFACE), **_pose(data, 2)
    )
