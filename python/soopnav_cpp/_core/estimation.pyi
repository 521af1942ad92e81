"""
What an estimate is worth: dilution of precision, ellipses.
"""

from __future__ import annotations
import numpy.typing
import typing

__all__: list[str] = ["Dop", "ErrorEllipse", "circular_error_m", "error_ellipse"]

class Dop:
    """
    Dilution of precision, from geometry alone; NaN where one does not apply. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def gdop(self) -> float:
        """
        Position and clock bias.
        """
    @property
    def hdop(self) -> float:
        """
        Horizontal position.
        """
    @property
    def pdop(self) -> float:
        """
        Position.
        """
    @property
    def tdop(self) -> float:
        """
        Speed of light times clock bias.
        """
    @property
    def vdop(self) -> float:
        """
        Vertical position.
        """

class ErrorEllipse:
    """
    Curve of constant density of a two-dimensional error. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def angle_rad(self) -> float:
        """
        Of the long axis, from the first axis towards the second.
        """
    @property
    def semi_major_m(self) -> float:
        """
        Half the long axis.
        """
    @property
    def semi_minor_m(self) -> float:
        """
        Half the short axis.
        """

def circular_error_m(
    covariance_m2: numpy.typing.ArrayLike, *, probability: typing.SupportsFloat | typing.SupportsIndex = 0.5
) -> float:
    """
    Radius of the circle that holds the error with a probability.
    """

def error_ellipse(
    covariance_m2: numpy.typing.ArrayLike, *, probability: typing.SupportsFloat | typing.SupportsIndex | None = None
) -> ErrorEllipse:
    """
    Ellipse that holds the error with a probability; without one the 1-sigma ellipse.
    """
