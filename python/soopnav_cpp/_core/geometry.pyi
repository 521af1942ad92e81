"""
Earth, local frames and directions.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "LocalAxes",
    "LocalFrame",
    "SampledOrbit",
    "WalkerConstellation",
    "direction_enu",
    "earth_rate_ned",
    "ecef_to_geodetic",
    "geodetic_to_ecef",
    "gmst82",
    "j2_gravitation_ecef",
    "look_at",
    "meridian_radius",
    "normal_gravity_ecef",
    "normal_gravity_ned",
    "normal_gravity_surface",
    "prime_vertical_radius",
    "signal_path",
    "teme_to_ecef",
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

class SampledOrbit:
    """
    Where a transmitter is over time: ECEF samples at even steps, joined by cubic Hermite polynomials.

    Immutable. Times are seconds from a reference of the caller's choice, within days of it.

    Parameters
    ----------
    start_s, step_s : float
        Sample i is of start_s + i step_s.
    position_e_m, velocity_e_mps : array_like, shape (n, 3)
        ECEF; the velocity relative to the turning Earth. At least two rows.

    Raises
    ------
    ValueError
        For shapes that differ, a step that is not positive, numbers that are not finite.
    """
    @staticmethod
    def fixed(position_e_m: numpy.typing.ArrayLike) -> SampledOrbit:
        """
        A transmitter at rest on the Earth, known at any time.
        """
    def __getstate__(
        self,
    ) -> tuple[float, float, numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]: ...
    def __init__(
        self,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        step_s: typing.SupportsFloat | typing.SupportsIndex,
        position_e_m: numpy.typing.ArrayLike,
        velocity_e_mps: numpy.typing.ArrayLike,
    ) -> None: ...
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def _at(
        self, t_s: numpy.typing.ArrayLike
    ) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]: ...
    def at(self, t_s: typing.Any) -> tuple[typing.Any, typing.Any]:
        """
        Positions [m] and velocities [m/s] at times of any shape (...): two arrays (..., 3), NaN outside the samples.
        """
    @property
    def end_s(self) -> float:
        """
        Time of the last sample; infinity at rest.
        """
    @property
    def is_fixed(self) -> bool:
        """
        At rest on the Earth.
        """
    @property
    def position_e_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Samples, shape (n, 3).
        """
    @property
    def start_s(self) -> float:
        """
        Time of the first sample; minus infinity at rest.
        """
    @property
    def step_s(self) -> float:
        """
        From one sample to the next; 0 at rest.
        """
    @property
    def velocity_e_mps(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Samples, shape (n, 3).
        """

class WalkerConstellation:
    """
    Circular orbits in evenly spaced planes.
    """
    @staticmethod
    def delta(
        total: typing.SupportsInt | typing.SupportsIndex,
        planes: typing.SupportsInt | typing.SupportsIndex,
        phasing: typing.SupportsInt | typing.SupportsIndex,
        inclination_rad: typing.SupportsFloat | typing.SupportsIndex,
        altitude_m: typing.SupportsFloat | typing.SupportsIndex,
    ) -> WalkerConstellation: ...
    @staticmethod
    def iridium() -> WalkerConstellation: ...
    @staticmethod
    def star(
        total: typing.SupportsInt | typing.SupportsIndex,
        planes: typing.SupportsInt | typing.SupportsIndex,
        phasing: typing.SupportsInt | typing.SupportsIndex,
        inclination_rad: typing.SupportsFloat | typing.SupportsIndex,
        altitude_m: typing.SupportsFloat | typing.SupportsIndex,
    ) -> WalkerConstellation: ...
    def sampled(
        self,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        duration_s: typing.SupportsFloat | typing.SupportsIndex,
        step_s: typing.SupportsFloat | typing.SupportsIndex,
        gmst_rad: typing.SupportsFloat | typing.SupportsIndex,
        first_node_rad: typing.SupportsFloat | typing.SupportsIndex,
        first_phase_rad: typing.SupportsFloat | typing.SupportsIndex,
    ) -> list[SampledOrbit]:
        """
        A sampled orbit for each satellite, a step longer at both ends.
        """

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

def gmst82(
    jd_ut1: typing.SupportsFloat | typing.SupportsIndex, fraction: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Greenwich mean sidereal time (IAU 1982) [rad] at a Julian date of UT1 in two parts.
    """

def j2_gravitation_ecef(
    p_e: numpy.typing.ArrayLike, j2: typing.SupportsFloat | typing.SupportsIndex = 0.001082629821
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of ECEF position [m] to rows of gravitation by point mass and J2 [m/s2].
    """

def look_at(
    orbits: collections.abc.Sequence[SampledOrbit], t_s: numpy.typing.ArrayLike, p_e: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Azimuth, elevation [rad], range [m] of each orbit at each time, shape (orbits, times, 3); NaN outside samples.
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

def signal_path(
    orbit: SampledOrbit,
    t_s: numpy.typing.ArrayLike,
    p_e: numpy.typing.ArrayLike,
    v_e: numpy.typing.ArrayLike,
    ahead_s: numpy.typing.ArrayLike,
    gradient: bool,
) -> tuple[
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
]:
    """
    Rows of delay, rate, range; source position; source velocity; direction; derivatives. NaN where there is no path.
    """

def teme_to_ecef(
    jd_ut1: typing.SupportsFloat | typing.SupportsIndex,
    fraction: numpy.typing.ArrayLike,
    position_m: numpy.typing.ArrayLike,
    velocity_mps: numpy.typing.ArrayLike,
) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
    """
    Rows of SGP4's frame in ECEF; Julian dates jd_ut1 + fraction. Polar motion is left out.
    """

def transport_rate_ned(motions: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Rows of latitude [rad], height [m], velocity north, east, down [m/s] to rows of the frame's rate [rad/s].
    """
