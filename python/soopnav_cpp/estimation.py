"""Estimation: Kalman and particle filters, smoothers, bounds, and what an estimate is worth."""

from __future__ import annotations

import numpy.typing as npt

from soopnav_cpp._adaptive_noise import AdaptiveProcessNoise
from soopnav_cpp._bounds import (
    Crlb,
    PosteriorCrlb,
    coverage,
    coverage_bounds,
    crlb,
    crlb_map,
    marginal_information,
    mean_nees_bounds,
    nees,
    observability,
    posterior_crlb,
    rmse,
    sample_circular_error_m,
)
from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import Dop, ErrorEllipse
from soopnav_cpp._fixed_lag import FixedLagFilter, FixedLagRun
from soopnav_cpp._kalman import (
    ExtendedKalmanFilter,
    InformationFilter,
    IteratedKalmanFilter,
    KalmanReport,
    KalmanRun,
    SquareRootKalmanFilter,
    UnscentedKalmanFilter,
    UpdateStatus,
)
from soopnav_cpp._linear import LinearFilterResult, StepStatus, linear_filter, rts_smooth
from soopnav_cpp._multiple_model import InteractingMultipleModel, MultipleModelRun
from soopnav_cpp._particle import (
    AdaptiveCount,
    Gaussian,
    Measured,
    ParticleFilter,
    ParticleReport,
    ParticleRun,
    ParticleStatus,
    Samples,
    Uniform,
)
from soopnav_cpp._track import track_jacobian

__all__ = [
    "AdaptiveCount",
    "AdaptiveProcessNoise",
    "Crlb",
    "Dop",
    "ErrorEllipse",
    "ExtendedKalmanFilter",
    "FixedLagFilter",
    "FixedLagRun",
    "Gaussian",
    "InformationFilter",
    "InteractingMultipleModel",
    "IteratedKalmanFilter",
    "KalmanReport",
    "KalmanRun",
    "LinearFilterResult",
    "Measured",
    "MultipleModelRun",
    "ParticleFilter",
    "ParticleReport",
    "ParticleRun",
    "ParticleStatus",
    "PosteriorCrlb",
    "Samples",
    "SquareRootKalmanFilter",
    "StepStatus",
    "Uniform",
    "UnscentedKalmanFilter",
    "UpdateStatus",
    "circular_error_m",
    "coverage",
    "coverage_bounds",
    "crlb",
    "crlb_map",
    "error_ellipse",
    "linear_filter",
    "marginal_information",
    "mean_nees_bounds",
    "nees",
    "observability",
    "posterior_crlb",
    "rmse",
    "rts_smooth",
    "sample_circular_error_m",
    "track_jacobian",
]


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
