"""What an estimate is worth: dilution of precision, error ellipses, circular errors."""

from __future__ import annotations

import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import Dop, ErrorEllipse

__all__ = ["Dop", "ErrorEllipse", "circular_error_m", "error_ellipse"]


def error_ellipse(covariance_m2: npt.ArrayLike, *, probability: float | None = None) -> ErrorEllipse:
    """Ellipse of a two-dimensional Gaussian error.

    Parameters
    ----------
    covariance_m2 : array_like, shape (2, 2)
    probability : float, optional
        That the error lies inside; without it the 1-sigma ellipse, which holds it with 0.393.

    Raises
    ------
    ValueError
        For a matrix that is no covariance, or a probability outside 0 ... 1.
    """
    return _estimation.error_ellipse(covariance_m2, probability=probability)


def circular_error_m(covariance_m2: npt.ArrayLike, *, probability: float = 0.5) -> float:
    """Radius of the circle that holds a two-dimensional Gaussian error: circular error probable for 0.5. Exact.

    Parameters
    ----------
    covariance_m2 : array_like, shape (2, 2)
    probability : float

    Raises
    ------
    ValueError
        For a matrix that is no covariance, or a probability outside 0 ... 1.
    """
    return _estimation.circular_error_m(covariance_m2, probability=probability)
