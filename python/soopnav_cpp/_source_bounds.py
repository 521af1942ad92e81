"""How well a source can be found: bound over time, likelihood surface, circular error."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import SourceMotion
from soopnav_cpp._source_inputs import MOTIONS, floats, named, observed

__all__ = ["cep", "likelihood_surface", "source_crlb"]

_Array = npt.NDArray[np.float64]


def source_crlb(
    positions: npt.ArrayLike,
    emitter: npt.ArrayLike,
    sigmas: npt.ArrayLike,
    *,
    times: npt.ArrayLike | None = None,
    motion: str = "static",
    velocity: npt.ArrayLike | None = None,
    acceleration_psd: float = 0.0,
    heading_bias_sigma_rad: float = 0.0,
    start_sigma_m: float = 0.0,
    start_speed_sigma_mps: float = 0.0,
    position_covariance: npt.ArrayLike | None = None,
    heading_sigma_rad: npt.ArrayLike = 0.0,
) -> _Array:
    """Least covariance of any unbiased estimate of a source after each bearing (Cramér-Rao, posterior when it moves).

    Parameters
    ----------
    positions : array_like, shape (n, 2) or (n, 3)
    emitter : array_like, shape (d,)
        True position at the first bearing; two numbers: azimuths, three: azimuths and elevations.
    sigmas : float or array_like, shape (n,) or (n, d - 1)
    times : array_like, shape (n,), optional
    motion : {"static", "constant_velocity"}
    velocity : array_like, shape (d,), optional
        True velocity of a moving source at the start.
    acceleration_psd : float
        White acceleration of a moving source in m²/s³.
    heading_bias_sigma_rad : float
        Of an unknown constant in all azimuths; 0: there is none.
    start_sigma_m, start_speed_sigma_mps : float
        Prior knowledge; 0: none.

    Returns
    -------
    ndarray, shape (n, d, d), or (n, 2 d, 2 d) with the velocity
        Infinite on the diagonal where nothing is determined yet. Bearings that a locator leaves out (a sigma or a
        platform's variance that is not right) tell nothing.
    """
    at = floats("emitter", emitter)
    if at.shape not in ((2,), (3,)):
        raise ValueError(f"emitter: expected shape (2,) or (3,), got {at.shape}")
    seen = observed(
        positions,
        None,
        sigmas,
        times=times,
        position_covariance=position_covariance,
        heading_sigma_rad=heading_sigma_rad,
        dimensions=at.size,
    )
    moving = named("motion", motion, MOTIONS) is SourceMotion.CONSTANT_VELOCITY
    return _navigation.source_crlb(
        seen.times_s,
        seen.positions,
        seen.sigmas,
        seen.position_covariance,
        seen.heading_sigma_rad,
        at,
        np.zeros(at.size) if velocity is None else floats("velocity", velocity),
        moving,
        acceleration_psd,
        heading_bias_sigma_rad,
        start_sigma_m,
        start_speed_sigma_mps,
    )


def likelihood_surface(
    positions: npt.ArrayLike,
    bearings: npt.ArrayLike,
    sigmas: npt.ArrayLike,
    x: tuple[float, float],
    y: tuple[float, float],
    *,
    shape: tuple[int, int] = (200, 200),
    outlier_probability: float = 0.02,
    position_covariance: npt.ArrayLike | None = None,
    heading_sigma_rad: npt.ArrayLike = 0.0,
) -> tuple[_Array, _Array, _Array]:
    """Log-likelihood of a source at each point of a grid, from azimuths (carter 5.14, fig. 5.24).

    Parameters
    ----------
    positions : array_like, shape (n, 2)
    bearings : array_like, shape (n,)
    sigmas : float or array_like, shape (n,)
    x, y : tuple of two floats
        First and last column and row in metres.
    shape : tuple of two ints
        Rows (along y) and columns (along x).
    outlier_probability : float
        Of a bearing from anywhere, in [0, 1).

    Returns
    -------
    x_m : ndarray, shape (columns,)
    y_m : ndarray, shape (rows,)
    log_likelihood : ndarray, shape (rows, columns)
        Bearings that are not finite or have no positive sigma are left out.
    """
    seen = observed(
        positions,
        bearings,
        sigmas,
        position_covariance=position_covariance,
        heading_sigma_rad=heading_sigma_rad,
        dimensions=2,
    )
    rows, columns = shape
    if not (isinstance(rows, (int, np.integer)) and isinstance(columns, (int, np.integer)) and min(shape) >= 2):
        raise ValueError(f"shape = {tuple(shape)}: two whole numbers, each at least 2, expected")
    surface = _navigation.likelihood_surface(
        *seen.arguments, (float(x[0]), float(x[1])), (float(y[0]), float(y[1])), columns, rows, outlier_probability
    )
    return np.linspace(*x, columns), np.linspace(*y, rows), surface


def cep(covariance_m2: npt.ArrayLike, probability: float = 0.5) -> float:
    """Radius of the circle that holds a centred normal error with `probability`, exactly.

    Parameters
    ----------
    covariance_m2 : array_like, shape (2, 2) or larger
        The first two coordinates are read.
    probability : float
        In (0, 1).

    Returns
    -------
    float
        In metres.
    """
    covariance = floats("covariance_m2", covariance_m2)
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1] or covariance.shape[0] < 2:
        raise ValueError(f"covariance_m2: expected shape (2, 2), got {covariance.shape}")
    return _estimation.circular_error_m(np.ascontiguousarray(covariance[:2, :2]), probability=probability)
