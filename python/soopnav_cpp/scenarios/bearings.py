"""Bearings in files and on a map: what ``soopnav df`` writes and ``soopnav locate-emitter`` reads. Poses: `poses`.

Angles in files are what people write down: ``bearing_deg`` and ``heading_deg`` are counted clockwise from true north,
elevations up from the horizon. ``azimuth_deg`` is an angle of the array itself, from its axis 1 (forward) towards its
axis 2 (left). In memory a bearing is counted from east (x) towards north (y), in radians, as everywhere in soopnav.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

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
from soopnav_cpp.scenarios.places import against_own_north, check_places, frame_at, place_columns, turned
from soopnav_cpp.scenarios.poses import Poses, attitude, covariances_from_ratio, read_poses, rotations
from soopnav_cpp.scenarios.writers import write_table

__all__ = [
    "BEARING_COLUMNS",
    "BearingsData",
    "Poses",
    "against_own_north",
    "attitude",
    "covariances_from_ratio",
    "read_bearings",
    "read_poses",
    "rotations",
    "write_bearings",
]

Array = npt.NDArray[np.float64]
_DECIBEL = {"db": 1.0, "dbm": 1.0}
_USED = ("", "ok", "accepted")

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
    where, on_earth = place_columns(file, header, columns)
    right, right_on_earth = place_columns(file, header, columns, prefix="truth_")
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
        frame = frame_at(values["latitude"], values["longitude"], height)
        position = frame.position_from_geodetic(values["latitude"], values["longitude"], height)
        places = np.column_stack([values["latitude"], values["longitude"], height])
        bearing = turned(frame, places, bearing)
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
    check_places(path, rows, values)
    check_places(path, rows, values, "truth_")
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
