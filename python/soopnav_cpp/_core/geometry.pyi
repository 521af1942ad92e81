"""
Earth, local frames and directions.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "LocalAxes",
    "LocalFrame",
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
    "transport_rate_ned",
]

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

def earth_rate_ned(latitudes: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude [rad] to rows of the Earth's rate along north, east, down [rad/s].
    """

def ecef_to_geodetic(p_e: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of ECEF position [m] to rows of latitude, longitude [rad], height [m]; NaN where none is.
    """

def geodetic_to_ecef(places: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude, longitude [rad], height [m] to rows of ECEF position [m].
    """

def j2_gravitation_ecef(
    p_e: numpy.typing.ArrayLike, j2: typing.SupportsFloat | typing.SupportsIndex = 0.001082629821
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of ECEF position [m] to rows of gravitation by point mass and J2 [m/s2].
    """

def meridian_radius(latitude_rad: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Radius of curvature in the meridian [m].
    """

def normal_gravity_ecef(p_e: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of ECEF position [m] to rows of normal gravity [m/s2].
    """

def normal_gravity_ned(places: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude [rad], height [m] to rows of normal gravity along north, east, down [m/s2].
    """

def normal_gravity_surface(latitude_rad: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Somigliana's normal gravity on the ellipsoid [m/s2].
    """

def prime_vertical_radius(latitude_rad: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Radius of curvature in the prime vertical [m].
    """

def transport_rate_ned(motions: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude [rad], height [m], velocity north, east, down [m/s] to rows of the frame's rate [rad/s].
    """
