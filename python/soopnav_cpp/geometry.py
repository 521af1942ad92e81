"""The Earth (WGS-84), local frames and directions, for single places and whole arrays of them.

Angles are radians, positions metres. Frames: ``e`` ECEF, ``enu`` and ``ned`` local. Arguments broadcast as NumPy's do;
a place that has no answer (a point near the Earth's centre) gives NaN.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core.geometry import LocalAxes, SampledOrbit
from soopnav_cpp._orbit_paths import PathGradients, SignalPaths, signal_path

__all__ = [
    "LocalAxes",
    "LocalFrame",
    "PathGradients",
    "SampledOrbit",
    "SignalPaths",
    "direction_enu",
    "earth_rate_ned",
    "ecef_to_geodetic",
    "geodetic_to_ecef",
    "j2_gravitation_ecef",
    "meridian_radius",
    "normal_gravity_ecef",
    "normal_gravity_ned",
    "normal_gravity_surface",
    "prime_vertical_radius",
    "signal_path",
    "transport_rate_ned",
]

_Array = npt.NDArray[np.float64]


def _places(
    latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike, height_m: npt.ArrayLike
) -> tuple[_Array, tuple[int, ...]]:
    latitude, longitude, height = np.broadcast_arrays(latitude_rad, longitude_rad, height_m)
    table = np.stack([latitude, longitude, height], axis=-1, dtype=np.float64)
    return table.reshape(-1, 3), latitude.shape


def _vectors(name: str, values: npt.ArrayLike) -> tuple[_Array, tuple[int, ...]]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {array.shape}")
    return array.reshape(-1, 3), array.shape[:-1]


def geodetic_to_ecef(latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike, height_m: npt.ArrayLike) -> _Array:
    """ECEF position of geodetic places (NGA.STND.0036_1.0.0_WGS84, equations 4-14).

    Parameters
    ----------
    latitude_rad, longitude_rad, height_m : array_like, shape (...)
        Height above the ellipsoid.

    Returns
    -------
    ndarray, shape (..., 3), float64
        Metres.
    """
    table, shape = _places(latitude_rad, longitude_rad, height_m)
    return _geometry.geodetic_to_ecef(table).reshape(*shape, 3)


def ecef_to_geodetic(p_e: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
    """Geodetic place of ECEF positions; `geodetic_to_ecef` gives them back within nanometres.

    Parameters
    ----------
    p_e : array_like, shape (..., 3)
        Metres.

    Returns
    -------
    latitude_rad, longitude_rad, height_m : ndarray, shape (...), float64
        NaN nearer than 1000 km to the Earth's centre.
    """
    table, shape = _vectors("p_e", p_e)
    places = _geometry.ecef_to_geodetic(table)
    return places[:, 0].reshape(shape), places[:, 1].reshape(shape), places[:, 2].reshape(shape)


def direction_enu(from_enu_m: npt.ArrayLike, to_enu_m: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
    """Where targets are seen from observers, both east-north-up about one origin.

    Parameters
    ----------
    from_enu_m, to_enu_m : array_like, shape (..., 3)
        Metres; they broadcast.

    Returns
    -------
    azimuth_rad, elevation_rad, range_m : ndarray, shape (...), float64
        Azimuth from north towards east, 0 ... 2 pi. NaN where the two coincide.
    """
    start, start_shape = _vectors("from_enu_m", from_enu_m)
    end, end_shape = _vectors("to_enu_m", to_enu_m)
    shape = np.broadcast_shapes(start_shape, end_shape)
    seen = _geometry.direction_enu(
        np.broadcast_to(start.reshape(*start_shape, 3), (*shape, 3)).reshape(-1, 3),
        np.broadcast_to(end.reshape(*end_shape, 3), (*shape, 3)).reshape(-1, 3),
    )
    return seen[:, 0].reshape(shape), seen[:, 1].reshape(shape), seen[:, 2].reshape(shape)


def normal_gravity_ned(latitude_rad: npt.ArrayLike, height_m: npt.ArrayLike) -> _Array:
    """Normal gravity of the ellipsoid, exact in closed form, along north, east and down [m/s²].

    Parameters
    ----------
    latitude_rad, height_m : array_like, shape (...)

    Returns
    -------
    ndarray, shape (..., 3), float64
        Down is positive; north is not zero above the ellipsoid, for the plumb line bends.
    """
    latitude, height = np.broadcast_arrays(latitude_rad, height_m)
    table = np.stack([latitude, height], axis=-1, dtype=np.float64).reshape(-1, 2)
    return _geometry.normal_gravity_ned(table).reshape(*latitude.shape, 3)


def normal_gravity_ecef(p_e: npt.ArrayLike) -> _Array:
    """Normal gravity, gravitation and centrifugal, at ECEF positions of shape (..., 3) [m/s²], ECEF."""
    table, shape = _vectors("p_e", p_e)
    return _geometry.normal_gravity_ecef(table).reshape(*shape, 3)


def j2_gravitation_ecef(p_e: npt.ArrayLike, j2: float = 1.082629821e-3) -> _Array:
    """Gravitation of a point mass with J2 at ECEF positions of shape (..., 3) [m/s²], without the centrifugal part."""
    table, shape = _vectors("p_e", p_e)
    return _geometry.j2_gravitation_ecef(table, j2).reshape(*shape, 3)


def normal_gravity_surface(latitude_rad: npt.ArrayLike) -> _Array:
    """Somigliana's normal gravity on the ellipsoid [m/s²], for latitudes of any shape."""
    latitude = np.asarray(latitude_rad, dtype=np.float64)
    return _geometry.normal_gravity_surface(latitude.reshape(-1)).reshape(latitude.shape)


def meridian_radius(latitude_rad: npt.ArrayLike) -> _Array:
    """Radius of curvature in the meridian, M [m], for latitudes of any shape."""
    latitude = np.asarray(latitude_rad, dtype=np.float64)
    return _geometry.meridian_radius(latitude.reshape(-1)).reshape(latitude.shape)


def prime_vertical_radius(latitude_rad: npt.ArrayLike) -> _Array:
    """Radius of curvature in the prime vertical, N [m], for latitudes of any shape."""
    latitude = np.asarray(latitude_rad, dtype=np.float64)
    return _geometry.prime_vertical_radius(latitude.reshape(-1)).reshape(latitude.shape)


def earth_rate_ned(latitude_rad: npt.ArrayLike) -> _Array:
    """The Earth's rate along north, east and down [rad/s], shape (..., 3), at latitudes of shape (...)."""
    latitude = np.asarray(latitude_rad, dtype=np.float64)
    return _geometry.earth_rate_ned(latitude.reshape(-1, 1)).reshape(*latitude.shape, 3)


def transport_rate_ned(latitude_rad: npt.ArrayLike, height_m: npt.ArrayLike, v_n_mps: npt.ArrayLike) -> _Array:
    """Rate of the moving north-east-down frame relative to the Earth [rad/s], shape (..., 3).

    Parameters
    ----------
    latitude_rad, height_m : array_like, shape (...)
    v_n_mps : array_like, shape (..., 3)
        North, east, down.
    """
    velocity, shape = _vectors("v_n_mps", v_n_mps)
    rows = [np.broadcast_to(np.asarray(a, dtype=np.float64), shape).reshape(-1, 1) for a in (latitude_rad, height_m)]
    return _geometry.transport_rate_ned(np.hstack([*rows, velocity])).reshape(*shape, 3)


def _local_frame(latitude_rad: float, longitude_rad: float, height_m: float, axes: str) -> LocalFrame:
    """A frame as it was pickled."""
    return LocalFrame(latitude_rad, longitude_rad, height_m, axes=LocalAxes[axes])


class LocalFrame:
    """A Cartesian frame fixed to the Earth in one place: the ellipsoid's tangent plane there. Immutable.

    Parameters
    ----------
    latitude_rad, longitude_rad, height_m : float
        Origin.
    axes : LocalAxes
        ``LocalAxes.ENU`` (east, north, up) or ``LocalAxes.NED`` (north, east, down).
    """

    __slots__ = ("_frame",)

    def __init__(
        self, latitude_rad: float, longitude_rad: float, height_m: float, *, axes: LocalAxes = LocalAxes.ENU
    ) -> None:
        self._frame = _geometry.LocalFrame(latitude_rad, longitude_rad, height_m, axes=axes)

    def __reduce__(self) -> tuple[Callable[..., LocalFrame], tuple[float, float, float, str]]:
        return _local_frame, (self.latitude_rad, self.longitude_rad, self.height_m, self.axes.name)

    @property
    def latitude_rad(self) -> float:
        """Of the origin."""
        return self._frame.latitude_rad

    @property
    def longitude_rad(self) -> float:
        """Of the origin."""
        return self._frame.longitude_rad

    @property
    def height_m(self) -> float:
        """Of the origin, above the ellipsoid."""
        return self._frame.height_m

    @property
    def axes(self) -> LocalAxes:
        """East-north-up or north-east-down."""
        return self._frame.axes

    def position_from_ecef(self, p_e: npt.ArrayLike) -> _Array:
        """ECEF positions, shape (..., 3), in this frame."""
        table, shape = _vectors("p_e", p_e)
        return self._frame.position_from_ecef(table).reshape(*shape, 3)

    def position_to_ecef(self, p_l: npt.ArrayLike) -> _Array:
        """Positions of this frame, shape (..., 3), in ECEF."""
        table, shape = _vectors("p_l", p_l)
        return self._frame.position_to_ecef(table).reshape(*shape, 3)

    def position_from_geodetic(
        self, latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike, height_m: npt.ArrayLike
    ) -> _Array:
        """Geodetic places in this frame, shape (..., 3)."""
        table, shape = _places(latitude_rad, longitude_rad, height_m)
        return self._frame.position_from_geodetic(table).reshape(*shape, 3)

    def position_to_geodetic(self, p_l: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
        """Positions of this frame, shape (..., 3), as latitude_rad, longitude_rad, height_m of shape (...)."""
        table, shape = _vectors("p_l", p_l)
        places = self._frame.position_to_geodetic(table)
        return places[:, 0].reshape(shape), places[:, 1].reshape(shape), places[:, 2].reshape(shape)

    def direction_to(self, p_e: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
        """Where ECEF positions, shape (..., 3), are seen from the origin: azimuth_rad, elevation_rad, range_m."""
        table, shape = _vectors("p_e", p_e)
        seen = self._frame.direction_to(table)
        return seen[:, 0].reshape(shape), seen[:, 1].reshape(shape), seen[:, 2].reshape(shape)

    def __repr__(self) -> str:
        return repr(self._frame)
