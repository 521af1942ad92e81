"""
Satellite navigation: orbits, positions, attitude.
"""

from __future__ import annotations
import numpy
import numpy.typing
import typing

__all__: list[str] = ["EphemerisTable", "satellite_states", "sights", "walker_constellation"]

class EphemerisTable:
    """
    Broadcast orbits, ready to be looked up.
    """
    def __init__(self, ephemerides: numpy.typing.ArrayLike) -> None: ...
    def __len__(self) -> int: ...
    def prns(self) -> list[int]:
        """
        The satellites' numbers, ascending.
        """
    def rows(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        All numbers, sorted.
        """

def satellite_states(
    table: EphemerisTable,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    max_age_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (position, velocity, clock_s, clock_rate).
    """

def sights(
    table: EphemerisTable,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    receiver_position_m: numpy.typing.ArrayLike,
    receiver_velocity_mps: numpy.typing.ArrayLike,
    max_age_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (position, velocity, direction, range, range rate, azimuth, elevation, clock_s, clock_rate).
    """

def walker_constellation(
    satellites: typing.SupportsInt | typing.SupportsIndex,
    planes: typing.SupportsInt | typing.SupportsIndex,
    phasing: typing.SupportsInt | typing.SupportsIndex,
    inclination_rad: typing.SupportsFloat | typing.SupportsIndex,
    radius_m: typing.SupportsFloat | typing.SupportsIndex,
    week: typing.SupportsInt | typing.SupportsIndex,
    toe_s: typing.SupportsFloat | typing.SupportsIndex,
    first_node_rad: typing.SupportsFloat | typing.SupportsIndex,
    fit_interval_s: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Ephemerides of a Walker constellation.
    """
