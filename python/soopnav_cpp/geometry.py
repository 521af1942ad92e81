"""The Earth (WGS-84), local frames and directions, for single places and whole arrays of them.

Angles are radians, positions metres. Frames: ``e`` ECEF, ``enu`` and ``ned`` local. Arguments broadcast as NumPy's do;
a place that has no answer (a point near the Earth's centre) gives NaN.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core.geometry import LocalAxes

__all__ = ["LocalAxes", "LocalFrame", "direction_enu", "ecef_to_geodetic", "geodetic_to_ecef"]

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
