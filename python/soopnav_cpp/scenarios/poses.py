"""Where a platform was and how it stood: poses in files, and directions of its array made bearings."""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    _rows,
    _table,
    _Units,
)
from soopnav_cpp.scenarios.places import DIRECTION_M, check_places, frame_at, place_columns, turned

__all__ = ["Poses", "attitude", "covariances_from_ratio", "read_poses", "rotations"]

Array = npt.NDArray[np.float64]
_LEAST_COSINE = 0.05  # of an elevation: beyond it an azimuth means nothing anyway
_KNOWN_ELEVATION_RAD = 0.15  # a deviation at which half of an elevation counts


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
        corners = np.vstack([np.zeros(3), DIRECTION_M * np.eye(3)])
        moved = frame.position_from_ecef(self.frame.position_to_ecef(corners))
        axes = ((moved[1:] - moved[0]) / DIRECTION_M).T
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
    where, on_earth = place_columns(file, header, columns)
    if not where:
        raise RecordingError(
            f"{file}:{header.line}: no position: x_m and y_m expected, or latitude_deg and longitude_deg"
        )
    ordered = {"time": columns["time"], **columns}
    time, values, kept, _ = _table(file, header, rows, ordered, repair=False)
    check_places(file, kept, values)
    nothing = np.zeros(len(time))
    turn = attitude(values["heading"], values.get("pitch", nothing), values.get("roll", nothing))
    if not on_earth:
        return Poses(time, np.column_stack([values["x"], values["y"], values.get("z", nothing)]), turn)
    height = values.get("height", nothing)
    frame = frame_at(values["latitude"], values["longitude"], height)
    places = np.column_stack([values["latitude"], values["longitude"], height])
    # Against the axes of the frame: a heading turns by as much as the meridians do.
    math_heading = 0.5 * np.pi - values["heading"]
    against = 0.5 * np.pi - turned(frame, places, math_heading)
    turn = attitude(against, values.get("pitch", nothing), values.get("roll", nothing))
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
