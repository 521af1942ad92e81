"""
Earth, local frames and directions.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = ["LocalAxes", "LocalFrame", "direction_enu", "ecef_to_geodetic", "geodetic_to_ecef"]

class LocalAxes(enum.Enum):
    """
    Axes of a local frame.
    """

    ENU = ...
    NED = ...

class LocalFrame:
    """
    A Cartesian frame fixed to the Earth in one place. Immutable.
    """
    def __init__(
        self,
        latitude_rad: typing.SupportsFloat | typing.SupportsIndex,
        longitude_rad: typing.SupportsFloat | typing.SupportsIndex,
        height_m: typing.SupportsFloat | typing.SupportsIndex,
        *,
        axes: LocalAxes = ...,
    ) -> None: ...
    def __repr__(self) -> str: ...
    def direction_to(self, p_e: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    def position_from_ecef(self, p_e: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    def position_from_geodetic(self, places: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    def position_to_ecef(self, p_l: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    def position_to_geodetic(self, p_l: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def axes(self) -> LocalAxes: ...
    @property
    def height_m(self) -> float: ...
    @property
    def latitude_rad(self) -> float: ...
    @property
    def longitude_rad(self) -> float: ...

def direction_enu(
    from_enu_m: numpy.typing.ArrayLike, to_enu_m: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of azimuth, elevation [rad], range [m]; NaN where they coincide.
    """

def ecef_to_geodetic(p_e: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of ECEF position [m] to rows of latitude, longitude [rad], height [m]; NaN where none is.
    """

def geodetic_to_ecef(places: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude, longitude [rad], height [m] to rows of ECEF position [m].
    """
