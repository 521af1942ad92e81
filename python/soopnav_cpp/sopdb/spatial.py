"""Places on the Earth: distances, and boxes of latitude and longitude that an index can look up.

The distance of two places is that of the straight line between their feet on the WGS-84 ellipsoid: exact, and in the
same order as the way over the surface (which is longer by 1 part in 1000 at 1000 km).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import ColumnElement, and_, or_, true

from soopnav_cpp import geometry
from soopnav_cpp.sopdb.schema import Fused

__all__ = ["Box", "around", "column", "distances_m", "place", "within"]

_LEAST_RADIUS_M = 6.335e6  # of curvature, along the meridian at the equator
_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """Between two parallels, from a western meridian eastwards to another: over the date line when west > east."""

    south_deg: float
    north_deg: float
    west_deg: float
    east_deg: float


def place(p_e_m: Sequence[float]) -> tuple[float, float]:
    """Latitude and longitude of an ECEF position, degrees; longitude in [-180, 180]."""
    latitude, longitude, _ = geometry.ecef_to_geodetic(np.array(p_e_m))
    return math.degrees(float(latitude)), math.degrees(float(longitude))


def distances_m(latitude_deg: float, longitude_deg: float, latitudes_deg: _Array, longitudes_deg: _Array) -> _Array:
    """Straight-line distances from a place to others, all on the ellipsoid."""
    latitudes = np.radians(np.append(latitudes_deg, latitude_deg))
    longitudes = np.radians(np.append(longitudes_deg, longitude_deg))
    feet = geometry.geodetic_to_ecef(latitudes, longitudes, np.zeros(latitudes.size))
    return np.asarray(np.linalg.norm(feet[:-1] - feet[-1], axis=1))


def around(latitude_deg: float, longitude_deg: float, radius_m: float) -> Box:
    """A box that holds every place within a distance; at a pole, and for far ones, the whole circle of longitudes."""
    half = radius_m / (2.0 * _LEAST_RADIUS_M)
    if half >= 1.0:
        return Box(-90.0, 90.0, -180.0, 180.0)
    angle_deg = math.degrees(2.0 * math.asin(half)) * 1.01 + 1e-9  # geodetic for geocentric latitudes: 0.7 % at most
    south, north = latitude_deg - angle_deg, latitude_deg + angle_deg
    if south <= -90.0 or north >= 90.0:
        return Box(max(south, -90.0), min(north, 90.0), -180.0, 180.0)
    sine = math.sin(math.radians(angle_deg)) / math.cos(math.radians(latitude_deg))
    if sine >= 1.0 or angle_deg >= 90.0:
        return Box(south, north, -180.0, 180.0)
    wide_deg = math.degrees(math.asin(sine)) + 1e-9
    west, east = longitude_deg - wide_deg, longitude_deg + wide_deg
    return Box(south, north, west + 360.0 if west < -180.0 else west, east - 360.0 if east > 180.0 else east)


def within(box: Box) -> ColumnElement[bool]:
    """Condition on `Fused`: its place lies in the box, borders included; false without a place."""
    latitude = Fused.latitude_deg.between(box.south_deg, box.north_deg)
    if box.west_deg <= box.east_deg:
        longitude: ColumnElement[bool] = Fused.longitude_deg.between(box.west_deg, box.east_deg)
        # -180 and 180 are one meridian.
        if box.west_deg == -180.0:
            longitude = or_(longitude, Fused.longitude_deg == 180.0)
        if box.east_deg == 180.0:
            longitude = or_(longitude, Fused.longitude_deg == -180.0)
    else:
        longitude = or_(Fused.longitude_deg >= box.west_deg, Fused.longitude_deg <= box.east_deg)
    if box.south_deg == -90.0 or box.north_deg == 90.0:
        pole = or_(
            and_(true() if box.south_deg == -90.0 else ~true(), Fused.latitude_deg == -90.0),
            and_(true() if box.north_deg == 90.0 else ~true(), Fused.latitude_deg == 90.0),
        )
        longitude = or_(longitude, pole)
    return and_(latitude, longitude)


def column(rows: Sequence[Any], index: int) -> _Array:
    """One column of rows as numbers."""
    return np.array([row[index] for row in rows], dtype=np.float64)
