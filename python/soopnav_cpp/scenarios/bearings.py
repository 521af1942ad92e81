"""Bearings and poses in files, and bearings on a map: what ``soopnav df`` writes and ``soopnav locate-emitter`` reads.

Angles in files are what people write down: ``bearing_deg`` and ``heading_deg`` are counted clockwise from true north,
elevations up from the horizon. ``azimuth_deg`` is an angle of the array itself, from its axis 1 (forward) towards its
axis 2 (left). In memory a bearing is counted from east (x) towards north (y), in radians, as everywhere in soopnav.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios.files import (
    _ANGLE,
    _LENGTH,
    _TIME,
    RecordingError,
    _columns,
    _Mistakes,
    _Row,
    _rows,
    _table,
    _Units,
)
from soopnav_cpp.scenarios.writers import write_table

__all__ = [
    "BEARING_COLUMNS",
    "BearingsData",
    "Poses",
    "against_own_north",
    "read_bearings",
    "read_poses",
    "write_bearings",
]

Array = npt.NDArray[np.float64]
_DECIBEL = {"db": 1.0, "dbm": 1.0}
_USED = ("", "ok", "accepted")
_LEAST_COSINE = 0.05  # of an elevation: beyond it an azimuth means nothing anyway
_KNOWN_ELEVATION_RAD = 0.15  # a deviation at which half of an elevation counts
_MOST_HEIGHT_M = 1e6
_MOST_LENGTH_M = 1e8  # beyond it nothing of an ellipse in metres is left
_DIRECTION_M = 1000.0  # length of the arm that turns a bearing into the map's axes

#: Meaning of each column of a file of bearings, with its units.
BEARING_COLUMNS: dict[str, str] = {
    "time": "when; may be left out, and rows are then counted",
    "x, y, z": "where the platform was: east, north, up of any origin; z may be left out",
    "latitude, longitude, height": "the same on the Earth (WGS-84), in place of x, y, z",
    "bearing": "to the emitter, clockwise from true north",
    "bearing_elevation": "to the emitter, up from the horizon",
    "azimuth, heading": "in place of a bearing: from the array's forward axis to its left, and where that axis pointed",
    "elevation": "the same as bearing_elevation for an array that was level",
    "sigma": "standard deviation of the bearing (and of the elevation); sigma_bearing and sigma_azimuth likewise",
    "sigma_elevation": "standard deviation of the elevation",
    "sigma_position, sigma_heading": "of the platform's own position (each axis) and heading",
    "emitter": "whose bearing it is: any name; without this column bearings are sorted by where they point",
    "truth_x, truth_y, truth_z": "where the emitter was, to compare with; or truth_latitude, ...",
    "snr, power, status": "for the reader; a row whose status is a word other than ok is left out",
}

_KNOWN: dict[str, _Units] = {
    "time": _TIME,
    "latitude": _ANGLE,
    "longitude": _ANGLE,
    "height": _LENGTH,
    "heading": _ANGLE,
    "bearing_elevation": _ANGLE,
    "bearing": _ANGLE,
    "azimuth": _ANGLE,
    "elevation": _ANGLE,
    "sigma_bearing_elevation": _ANGLE,
    "sigma_bearing": _ANGLE,
    "sigma_azimuth": _ANGLE,
    "sigma_elevation": _ANGLE,
    "sigma_position": _LENGTH,
    "sigma_heading": _ANGLE,
    "sigma": _ANGLE,
    "snr": _DECIBEL,
    "power": _DECIBEL,
    "truth_x": _LENGTH,
    "truth_y": _LENGTH,
    "truth_z": _LENGTH,
    "truth_latitude": _ANGLE,
    "truth_longitude": _ANGLE,
    "truth_height": _LENGTH,
    "x": _LENGTH,
    "y": _LENGTH,
    "z": _LENGTH,
}


@dataclass(frozen=True, eq=False)
class BearingsData:
    """Bearings with the places that they were taken from, in time order.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, 3)
        The platform: local east, north, up.
    bearing_rad : ndarray, shape (n,)
        From x (east) towards y (north).
    elevation_rad : ndarray, shape (n,), or None
        Up from the horizon.
    sigma_rad : ndarray, shape (n,)
        Standard deviation of the bearing.
    sigma_elevation_rad : ndarray, shape (n,), or None
    emitter : ndarray of str, shape (n,), or None
        Whose bearing it is; None when nothing says so.
    position_sigma_m, heading_sigma_rad : ndarray, shape (n,), or None
        Of the platform's own pose.
    snr_db : ndarray, shape (n,), or None
    truth_m : ndarray, shape (n, 3), or None
        Where the emitter was.
    frame : LocalFrame or None
        Of the local metres on the Earth, where that is known.
    dropped : tuple of str
        Sentences about rows that were left out.
    """

    t_s: Array
    position_m: Array
    bearing_rad: Array
    sigma_rad: Array
    elevation_rad: Array | None = None
    sigma_elevation_rad: Array | None = None
    emitter: npt.NDArray[np.str_] | None = None
    position_sigma_m: Array | None = None
    heading_sigma_rad: Array | None = None
    snr_db: Array | None = None
    truth_m: Array | None = None
    frame: LocalFrame | None = None
    dropped: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        what = "bearings" if self.elevation_rad is None else "bearings with elevations"
        return f"BearingsData({len(self)} {what}, {self.t_s[0]:g} … {self.t_s[-1]:g} s)"

    @property
    def compass_deg(self) -> Array:
        """Bearings as they stand in files: degrees clockwise from north, 0 … 360."""
        return np.asarray((90.0 - np.degrees(self.bearing_rad)) % 360.0)

    def degrees(self, position_m: npt.ArrayLike) -> tuple[float, float, float] | None:
        """Latitude, longitude and height of local metres; None where they are nowhere on the Earth."""
        if self.frame is None:
            return None
        place = np.zeros(3)
        given = np.asarray(position_m, dtype=np.float64)
        place[: given.size] = given
        latitude, longitude, height = self.frame.position_to_geodetic(place)
        return math.degrees(float(latitude)), math.degrees(float(longitude)), float(height)

    def of(self, rows: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> BearingsData:
        """Only these rows."""
        picked = {
            name: value[rows]
            for name in (
                "t_s", "position_m", "bearing_rad", "sigma_rad", "elevation_rad", "sigma_elevation_rad", "emitter",
                "position_sigma_m", "heading_sigma_rad", "snr_db", "truth_m",
            )
            if (value := getattr(self, name)) is not None
        }  # fmt: skip
        return replace(self, **picked)


def _text_columns(
    header: _Row, rows: Sequence[_Row], names: Sequence[str]
) -> tuple[_Row, list[_Row], dict[str, dict[int, str]]]:
    """Header and rows without the columns of words, and those by name and line."""
    places = {name: header.cells.index(name) for name in names if name in header.cells}
    kept = [k for k in range(len(header.cells)) if k not in places.values()]

    def bare(row: _Row) -> _Row:
        return _Row(row.line, [row.cells[k] for k in kept])

    words = {name: {row.line: row.cells[place] for row in rows} for name, place in places.items()}
    return bare(header), [bare(row) for row in rows], words


def _in_time(header: _Row, rows: list[_Row]) -> tuple[_Row, list[_Row]]:
    """Rows in the order of their times (those with none that is a number where they are); a count without times."""
    at = next((k for k, name in enumerate(header.cells) if name == "time" or name.startswith("time_")), None)
    if at is None:
        counted = [_Row(row.line, [*row.cells, str(k)]) for k, row in enumerate(rows)]
        return _Row(header.line, [*header.cells, "time_s"]), counted

    def when(row: _Row) -> float:
        try:
            value = float(row.cells[at])
        except ValueError:
            return -math.inf
        return value if math.isfinite(value) else -math.inf

    return header, sorted(rows, key=when)


def _frame_at(latitude_rad: Array, longitude_rad: Array, height_m: Array) -> LocalFrame:
    return LocalFrame(float(latitude_rad[0]), float(longitude_rad[0]), float(height_m[0]))


def _turned(frame: LocalFrame, places: Array, bearing_rad: Array) -> Array:
    """Bearings against each place's own north and east, in the axes of `frame`: meridians are not parallel."""
    turned = np.empty_like(bearing_rad)
    for k, (latitude, longitude, height) in enumerate(places):
        here = LocalFrame(latitude, longitude, height)
        arm = _DIRECTION_M * np.array([math.cos(bearing_rad[k]), math.sin(bearing_rad[k]), 0.0])
        ends = frame.position_from_ecef(here.position_to_ecef(np.array([[0.0, 0.0, 0.0], arm])))
        turned[k] = math.atan2(ends[1, 1] - ends[0, 1], ends[1, 0] - ends[0, 0])
    return turned


def against_own_north(frame: LocalFrame, position_m: Array, bearing_rad: Array) -> Array:
    """Bearings in the axes of `frame` against each place's own east and north, as files have them."""
    places = np.column_stack(frame.position_to_geodetic(position_m))
    return 2.0 * bearing_rad - _turned(frame, places, bearing_rad)


def _places(
    path: Path, header: _Row, columns: Mapping[str, object], *, prefix: str = ""
) -> tuple[tuple[str, ...], bool]:
    """Names of the columns that say where, and whether they are on the Earth."""
    local, earth = (f"{prefix}x", f"{prefix}y"), (f"{prefix}latitude", f"{prefix}longitude")
    has = [sum(name in columns for name in names) for names in (local, earth)]
    if has[0] and has[1]:
        raise RecordingError(
            f"{path}:{header.line}: {prefix}x_m and {prefix}latitude_deg: one kind of position expected"
        )
    for names, found, unit in ((local, has[0], "m"), (earth, has[1], "deg")):
        if found == 1:
            missing = next(name for name in names if name not in columns)
            raise RecordingError(f"{path}:{header.line}: missing column {missing}_{unit}")
    third = f"{prefix}height" if has[1] else f"{prefix}z"
    if not any(has):
        return (), False
    return (*(earth if has[1] else local), *((third,) if third in columns else ())), bool(has[1])


def _check_places(path: Path, rows: Sequence[_Row], values: Mapping[str, Array], prefix: str = "") -> None:
    mistakes = _Mistakes(path)
    for name, limit in ((f"{prefix}latitude", 90.0), (f"{prefix}longitude", 360.0)):
        if name in values:
            for k in np.flatnonzero(np.abs(values[name]) > math.radians(limit) + 1e-12).tolist():
                mistakes.add(rows[k].line, f"{name}: {math.degrees(values[name][k]):g}: at most {limit:g}° expected")
    for name, limit in ((f"{prefix}height", _MOST_HEIGHT_M), *((f"{prefix}{axis}", _MOST_LENGTH_M) for axis in "xyz")):
        value = values.get(name, np.zeros(0))
        for k in np.flatnonzero(np.abs(value) > limit).tolist():
            mistakes.add(rows[k].line, f"{name}: {value[k]:g}: at most {limit / 1e3:g} km expected")
    mistakes.refuse()


def read_bearings(path: str | Path, *, sigma_rad: float | None = None, repair: bool = False) -> BearingsData:
    """Read bearings from CSV, as ``soopnav df`` writes them or as one writes them by hand.

    Parameters
    ----------
    path : path
        Columns as in `BEARING_COLUMNS`, with units at the ends of the names, in any order: at least a position, a
        bearing (or azimuth and heading) and a standard deviation.
    sigma_rad : float, optional
        Standard deviation of bearings, for a file that has none.
    repair : bool
        Leave rows out that cannot be used, instead of refusing the file.

    Returns
    -------
    BearingsData
        With latitudes the local frame's origin is the first row's place.

    Raises
    ------
    RecordingError
        ``FILE:LINE: COLUMN: RULE`` for missing, unknown and doubled columns, cells that are no finite numbers,
        deviations that are not positive, elevations and places out of range.
    """
    file = Path(path)
    header, rows = _rows(file)
    header, rows, words = _text_columns(header, rows, ("emitter", "status"))
    dropped: list[str] = []
    status = words.get("status", {})
    refused = [row for row in rows if status.get(row.line, "").lower() not in _USED]
    if refused:
        counts: dict[str, int] = {}
        for row in refused:
            counts[status[row.line].lower()] = counts.get(status[row.line].lower(), 0) + 1
        dropped += [
            f"{n} row{'s' * (n != 1)} with status {word.replace('_', ' ')} left out" for word, n in counts.items()
        ]
        rows = [row for row in rows if status.get(row.line, "").lower() in _USED]
        if not rows:
            raise RecordingError(f"{file}: no row with status ok; nothing to locate an emitter from")
    header, rows = _in_time(header, rows)
    columns = _columns(file, header, _KNOWN, [])
    where, on_earth = _places(file, header, columns)
    right, right_on_earth = _places(file, header, columns, prefix="truth_")
    _needed(file, header, columns, where, sigma_rad)
    if right and right_on_earth != on_earth:
        raise RecordingError(f"{file}:{header.line}: truth and position: the same kind of coordinates expected")
    ordered = {"time": columns["time"], **columns}
    time, values, kept, repaired = _table(
        file, header, rows, ordered, repair=repair, may_repeat=True, may_be_empty=lambda name: name in ("snr", "power")
    )
    dropped += repaired
    _check(file, kept, values)

    def column(*names: str) -> Array | None:
        return next((values[name] for name in names if name in values), None)

    if "bearing" in values:
        bearing = 0.5 * np.pi - values["bearing"]
    else:
        bearing = 0.5 * np.pi - values["heading"] + values["azimuth"]
    frame = None
    if on_earth:
        height = values.get("height", np.zeros(len(time)))
        frame = _frame_at(values["latitude"], values["longitude"], height)
        position = frame.position_from_geodetic(values["latitude"], values["longitude"], height)
        places = np.column_stack([values["latitude"], values["longitude"], height])
        bearing = _turned(frame, places, bearing)
    else:
        position = np.column_stack([values["x"], values["y"], values.get("z", np.zeros(len(time)))])
    truth = None
    if right:
        third = values.get(right[2]) if len(right) == 3 else np.zeros(len(time))
        assert third is not None  # a column that was found
        truth = np.column_stack([values[right[0]], values[right[1]], third])
        if frame is not None:
            truth = frame.position_from_geodetic(truth[:, 0], truth[:, 1], third)
    sigma = column("sigma_bearing", "sigma", "sigma_azimuth")
    elevation = column("bearing_elevation", "elevation")
    sigma_elevation = None
    if elevation is not None:
        sigma_elevation = column("sigma_bearing_elevation", "sigma_elevation", "sigma", "sigma_bearing")
        if sigma_elevation is None:  # of both, then
            sigma_elevation = np.full(len(time), sigma_rad) if sigma is None else sigma
    emitter = None
    if "emitter" in words:
        emitter = np.array([words["emitter"][row.line] for row in kept], dtype=np.str_)
        if not emitter.astype(bool).any():
            emitter = None
    return BearingsData(
        t_s=time,
        position_m=position,
        bearing_rad=np.asarray(np.arctan2(np.sin(bearing), np.cos(bearing))),
        sigma_rad=np.full(len(time), sigma_rad) if sigma is None else sigma,
        elevation_rad=elevation,
        sigma_elevation_rad=sigma_elevation,
        emitter=emitter,
        position_sigma_m=column("sigma_position"),
        heading_sigma_rad=column("sigma_heading"),
        snr_db=column("snr"),
        truth_m=truth,
        frame=frame,
        dropped=tuple(dropped),
    )


def _needed(
    path: Path, header: _Row, columns: Mapping[str, object], where: Sequence[str], sigma_rad: float | None
) -> None:
    mistakes = _Mistakes(path)
    if not where:
        mistakes.add(header.line, "no position: x_m and y_m expected, or latitude_deg and longitude_deg")
    if "bearing" not in columns and "azimuth" not in columns:
        mistakes.add(
            header.line, "no bearing: bearing_deg (clockwise from north) expected, or azimuth_deg and heading_deg"
        )
    elif "bearing" not in columns and "heading" not in columns:
        mistakes.add(
            header.line,
            "azimuth_deg is an angle of the array: heading_deg (clockwise from north) expected with it, or bearing_deg",
        )
    if sigma_rad is None and not any(name in columns for name in ("sigma", "sigma_bearing", "sigma_azimuth")):
        mistakes.add(header.line, "no standard deviation: sigma_deg expected (or --sigma for all rows)")
    if sigma_rad is not None and not sigma_rad > 0.0:
        raise ValueError(f"sigma_rad = {sigma_rad:g}: more than 0 expected")
    mistakes.refuse()


def _check(path: Path, rows: Sequence[_Row], values: Mapping[str, Array]) -> None:
    _check_places(path, rows, values)
    _check_places(path, rows, values, "truth_")
    mistakes = _Mistakes(path)
    for name, value in values.items():
        if name.startswith("sigma") and name not in ("sigma_position", "sigma_heading"):
            bad, rule = ~(value > 0.0), "more than 0 expected"
        elif name.startswith("sigma"):
            bad, rule = value < 0.0, "0 or more expected"
        elif name in ("elevation", "bearing_elevation"):
            bad, rule = np.abs(value) > 0.5 * np.pi + 1e-12, "between −90° and 90° expected"
        else:
            continue
        shown = value if name == "sigma_position" else np.degrees(value)
        for k in np.flatnonzero(bad).tolist():
            mistakes.add(rows[k].line, f"{name}: {shown[k]:g}: {rule}")
    mistakes.refuse()


# ---- poses


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the platform was and how it stood.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, 3)
        Local east, north, up.
    quaternion_wxyz : ndarray, shape (n, 4)
        Turns array vectors (forward, left, up) into east, north, up.
    frame : LocalFrame or None
        Of the local metres on the Earth, where that is known.
    """

    t_s: Array
    position_m: Array
    quaternion_wxyz: Array
    frame: LocalFrame | None = None

    @property
    def heading_rad(self) -> Array:
        """Of the forward axis, clockwise from north, shape (n,), 0 … 2π."""
        forward = rotations(self.quaternion_wxyz)[:, :, 0]
        return np.asarray(np.arctan2(forward[:, 0], forward[:, 1]) % (2.0 * np.pi))

    def at(self, t_s: npt.ArrayLike) -> Poses:
        """Poses at other times: linear between those that are there, turns by the shorter way.

        Raises
        ------
        ValueError
            For a time outside.
        """
        time = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        outside = ~((time >= self.t_s[0] - 1e-9) & (time <= self.t_s[-1] + 1e-9))
        if outside.any():
            k = int(np.argmax(outside))
            span = f"{self.t_s[0]:g} … {self.t_s[-1]:g} s"
            raise ValueError(f"no pose at {time[k]:g} s: the poses cover {span}")
        position = np.column_stack([np.interp(time, self.t_s, column) for column in self.position_m.T])
        if len(self.t_s) == 1:
            return Poses(time, position, np.tile(self.quaternion_wxyz, (len(time), 1)), self.frame)
        low = np.clip(np.searchsorted(self.t_s, time, side="right") - 1, 0, len(self.t_s) - 2)
        share = np.clip((time - self.t_s[low]) / (self.t_s[low + 1] - self.t_s[low]), 0.0, 1.0)[:, None]
        before, after = self.quaternion_wxyz[low], self.quaternion_wxyz[low + 1]
        cosine = np.sum(before * after, axis=1, keepdims=True)
        after = np.where(cosine < 0.0, -after, after)
        angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
        near = angle < 1e-6
        sine = np.where(near, 1.0, np.sin(angle))
        first = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
        second = np.where(near, share, np.sin(share * angle) / sine)
        turn = first * before + second * after
        return Poses(time, position, turn / np.linalg.norm(turn, axis=1, keepdims=True), self.frame)

    def seen_from(self, frame: LocalFrame) -> Poses:
        """The same in the axes of another frame, east, north, up.

        Raises
        ------
        ValueError
            For poses that are nowhere on the Earth.
        """
        if self.frame is None:
            raise ValueError("poses in local metres have no place on the Earth")
        corners = np.vstack([np.zeros(3), _DIRECTION_M * np.eye(3)])
        moved = frame.position_from_ecef(self.frame.position_to_ecef(corners))
        axes = ((moved[1:] - moved[0]) / _DIRECTION_M).T
        w = 0.5 * math.sqrt(max(1.0 + float(np.trace(axes)), 1e-12))  # places on one side of the Earth
        x, y, z = (float(axes[i, j] - axes[j, i]) / (4.0 * w) for i, j in ((2, 1), (0, 2), (1, 0)))
        a, b, c, d = self.quaternion_wxyz.T
        turn = np.column_stack(
            [
                w * a - x * b - y * c - z * d,
                w * b + x * a + y * d - z * c,
                w * c - x * d + y * a + z * b,
                w * d + x * c - y * b + z * a,
            ]
        )
        position = frame.position_from_ecef(self.frame.position_to_ecef(self.position_m))
        return Poses(self.t_s, position, turn / np.linalg.norm(turn, axis=1, keepdims=True), frame)

    def to_level(self, azimuth_rad: Array, elevation_rad: Array, covariance_rad2: Array) -> tuple[Array, Array, Array]:
        """Directions of the array, one per pose, as bearings (from east towards north), elevations and covariances.

        The covariance, shape (n, 2, 2) of azimuth and elevation, is turned with them; at the zenith, where a bearing
        means nothing, its variance is that of an angle that may be anything (π²/3).
        """
        turn = rotations(self.quaternion_wxyz)
        ca, sa, ce, se = np.cos(azimuth_rad), np.sin(azimuth_rad), np.cos(elevation_rad), np.sin(elevation_rad)
        u = np.einsum("nij,nj->ni", turn, np.column_stack([ce * ca, ce * sa, se]))
        by_azimuth = np.einsum("nij,nj->ni", turn, np.column_stack([-ce * sa, ce * ca, np.zeros_like(ca)]))
        by_elevation = np.einsum("nij,nj->ni", turn, np.column_stack([-se * ca, -se * sa, ce]))
        level2 = u[:, 0] ** 2 + u[:, 1] ** 2
        steep = level2 < 1e-12
        safe = np.where(steep, 1.0, level2)
        jacobian = np.empty((len(u), 2, 2))
        for column, d in enumerate((by_azimuth, by_elevation)):
            jacobian[:, 0, column] = (u[:, 0] * d[:, 1] - u[:, 1] * d[:, 0]) / safe
            jacobian[:, 1, column] = d[:, 2] / np.sqrt(safe)
        covariance = jacobian @ covariance_rad2 @ np.swapaxes(jacobian, 1, 2)
        covariance[steep] = np.diag([np.pi**2 / 3.0, 0.0]) + np.zeros((int(steep.sum()), 2, 2))
        covariance[steep, 1, 1] = np.trace(covariance_rad2[steep], axis1=1, axis2=2)
        return np.arctan2(u[:, 1], u[:, 0]), np.arcsin(np.clip(u[:, 2], -1.0, 1.0)), covariance


def covariances_from_ratio(table: Any, ratio: Array, elevation_rad: Array) -> Array:
    """Of azimuth and elevation, shape (n, 2, 2), from the ratios of eigenvalues and a map of the array (carter 5.3).

    The map is one of low emitters. Higher up the same angle across the line of sight is more of an azimuth, by one over
    the cosine of the elevation, which counts as far as it is known.
    """
    covariance = np.zeros((len(ratio), 2, 2))
    for k, of in enumerate(("azimuth", "elevation")):
        covariance[:, k, k] = np.square(np.asarray(table.sigma(ratio, of=of), dtype=np.float64))
    known = elevation_rad / (1.0 + covariance[:, 1, 1] / _KNOWN_ELEVATION_RAD**2)
    covariance[:, 0, 0] /= np.square(np.maximum(np.cos(known), _LEAST_COSINE))
    return covariance


def rotations(quaternion_wxyz: Array) -> Array:
    """Matrices of unit quaternions, shape (n, 3, 3)."""
    w, x, y, z = np.asarray(quaternion_wxyz, dtype=np.float64).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=-2,
    )


def attitude(heading_rad: Array, pitch_rad: Array, roll_rad: Array) -> Array:
    """Unit quaternions (n, 4) that turn forward, left, up into east, north, up.

    Heading is clockwise from north, pitch positive nose up, roll positive right side down, turned in this order.
    """
    yaw, nose = 0.5 * (0.5 * np.pi - heading_rad), -0.5 * pitch_rad
    half = 0.5 * roll_rad
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(nose), np.sin(nose), np.cos(half), np.sin(half)
    return np.column_stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


_POSE: dict[str, _Units] = {
    "time": _TIME,
    "latitude": _ANGLE,
    "longitude": _ANGLE,
    "height": _LENGTH,
    "heading": _ANGLE,
    "pitch": _ANGLE,
    "roll": _ANGLE,
    "x": _LENGTH,
    "y": _LENGTH,
    "z": _LENGTH,
}


def read_poses(path: str | Path) -> Poses:
    """Read where the platform was and how it stood.

    Parameters
    ----------
    path : path
        CSV with ``time``, ``x``, ``y`` (and ``z``) or ``latitude``, ``longitude`` (and ``height``), ``heading``
        (clockwise from north), perhaps ``pitch`` (nose up) and ``roll`` (right side down), with units at the ends of
        the names; or TUM (``.tum``): ``time x y z qx qy qz qw``, the quaternion turns array vectors (forward, left, up)
        into local east, north, up.

    Returns
    -------
    Poses

    Raises
    ------
    RecordingError
        As for `read_bearings`; for a quaternion that is not one.
    """
    file = Path(path)
    if file.suffix.lower() == ".tum":
        return _read_tum(file)
    header, rows = _rows(file)
    columns = _columns(file, header, _POSE, ["time", "heading"])
    where, on_earth = _places(file, header, columns)
    if not where:
        raise RecordingError(
            f"{file}:{header.line}: no position: x_m and y_m expected, or latitude_deg and longitude_deg"
        )
    ordered = {"time": columns["time"], **columns}
    time, values, kept, _ = _table(file, header, rows, ordered, repair=False)
    _check_places(file, kept, values)
    nothing = np.zeros(len(time))
    turn = attitude(values["heading"], values.get("pitch", nothing), values.get("roll", nothing))
    if not on_earth:
        return Poses(time, np.column_stack([values["x"], values["y"], values.get("z", nothing)]), turn)
    height = values.get("height", nothing)
    frame = _frame_at(values["latitude"], values["longitude"], height)
    places = np.column_stack([values["latitude"], values["longitude"], height])
    # Against the axes of the frame: a heading turns by as much as the meridians do.
    math_heading = 0.5 * np.pi - values["heading"]
    turned = 0.5 * np.pi - _turned(frame, places, math_heading)
    turn = attitude(turned, values.get("pitch", nothing), values.get("roll", nothing))
    return Poses(time, frame.position_from_geodetic(values["latitude"], values["longitude"], height), turn, frame)


def _read_tum(path: Path) -> Poses:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file; TUM expected") from error
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from error
    mistakes = _Mistakes(path)
    table: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = line.split()
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != 8 or not all(math.isfinite(value) for value in row):
            mistakes.add(number, "eight finite numbers expected: time x y z qx qy qz qw")
        elif not 0.9 < math.hypot(*row[4:]) < 1.1:
            mistakes.add(number, f"qx qy qz qw: a length of {math.hypot(*row[4:]):g}; a unit quaternion expected")
        elif table and not row[0] > table[-1][0]:
            mistakes.add(number, f"time: {row[0]:g} after {table[-1][0]:g}: time must rise")
        else:
            table.append(row)
    mistakes.refuse()
    if not table:
        raise RecordingError(f"{path}: empty; lines of time x y z qx qy qz qw expected")
    values = np.array(table)
    turn = values[:, [7, 4, 5, 6]]
    return Poses(values[:, 0], values[:, 1:4], turn / np.linalg.norm(turn, axis=1, keepdims=True))


# ---- writing


def write_bearings(data: BearingsData, path: str | Path) -> None:
    """Write bearings as `read_bearings` reads them: degrees and metres, a row each."""
    n = len(data)
    columns: dict[str, list[str]] = {"time_s": [f"{t:.6f}" for t in data.t_s]}
    if data.emitter is not None:
        columns["emitter"] = [str(name) for name in data.emitter]
    if data.frame is None:
        columns |= {f"{axis}_m": [f"{v:.4f}" for v in data.position_m[:, k]] for k, axis in enumerate("xyz")}
    else:
        places = data.frame.position_to_geodetic(data.position_m)
        columns |= {
            "latitude_deg": [f"{math.degrees(v):.9f}" for v in places[0]],
            "longitude_deg": [f"{math.degrees(v):.9f}" for v in places[1]],
            "height_m": [f"{v:.4f}" for v in places[2]],
        }
    bearing = data.compass_deg
    if data.frame is not None:
        bearing = (90.0 - np.degrees(against_own_north(data.frame, data.position_m, data.bearing_rad))) % 360.0
    columns["bearing_deg"] = [f"{v:.6f}" for v in bearing]
    angles = {
        "bearing_elevation_deg": data.elevation_rad,
        "sigma_bearing_deg": data.sigma_rad,
        "sigma_bearing_elevation_deg": data.sigma_elevation_rad,
        "sigma_heading_deg": data.heading_sigma_rad,
    }
    columns |= {name: [f"{math.degrees(v):.6f}" for v in value] for name, value in angles.items() if value is not None}
    if data.position_sigma_m is not None:
        columns["sigma_position_m"] = [f"{v:.4f}" for v in data.position_sigma_m]
    if data.snr_db is not None:
        columns["snr_db"] = [f"{v:.2f}" if math.isfinite(v) else "" for v in data.snr_db]
    if data.truth_m is not None:
        if data.frame is None:
            columns |= {f"truth_{axis}_m": [f"{v:.4f}" for v in data.truth_m[:, k]] for k, axis in enumerate("xyz")}
        else:
            latitude, longitude, height = data.frame.position_to_geodetic(data.truth_m)
            columns |= {
                "truth_latitude_deg": [f"{math.degrees(v):.9f}" for v in latitude],
                "truth_longitude_deg": [f"{math.degrees(v):.9f}" for v in longitude],
                "truth_height_m": [f"{v:.4f}" for v in height],
            }
    write_table(Path(path), list(columns), [[column[k] for column in columns.values()] for k in range(n)])
