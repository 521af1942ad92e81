"""Places in files of bearings and poses: local metres or the Earth, and what north means where."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios.files import RecordingError, _Mistakes, _Row

__all__ = ["DIRECTION_M", "against_own_north", "check_places", "frame_at", "place_columns", "turned"]

Array = npt.NDArray[np.float64]
DIRECTION_M = 1000.0  #: length of the arm that turns a bearing into the map's axes
_MOST_HEIGHT_M = 1e6
_MOST_LENGTH_M = 1e8  # beyond it nothing of an ellipse in metres is left


def frame_at(latitude_rad: Array, longitude_rad: Array, height_m: Array) -> LocalFrame:
    return LocalFrame(float(latitude_rad[0]), float(longitude_rad[0]), float(height_m[0]))


def turned(frame: LocalFrame, places: Array, bearing_rad: Array) -> Array:
    """Bearings against each place's own north and east, in the axes of `frame`: meridians are not parallel."""
    found = np.empty_like(bearing_rad)
    for k, (latitude, longitude, height) in enumerate(places):
        here = LocalFrame(latitude, longitude, height)
        arm = DIRECTION_M * np.array([math.cos(bearing_rad[k]), math.sin(bearing_rad[k]), 0.0])
        ends = frame.position_from_ecef(here.position_to_ecef(np.array([[0.0, 0.0, 0.0], arm])))
        found[k] = math.atan2(ends[1, 1] - ends[0, 1], ends[1, 0] - ends[0, 0])
    return found


def against_own_north(frame: LocalFrame, position_m: Array, bearing_rad: Array) -> Array:
    """Bearings in the axes of `frame` against each place's own east and north, as files have them."""
    places = np.column_stack(frame.position_to_geodetic(position_m))
    return 2.0 * bearing_rad - turned(frame, places, bearing_rad)


def place_columns(
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


def check_places(path: Path, rows: Sequence[_Row], values: Mapping[str, Array], prefix: str = "") -> None:
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
