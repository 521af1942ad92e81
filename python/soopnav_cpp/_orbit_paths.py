"""Ways of signals from moving transmitters, for whole arrays of times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core.geometry import SampledOrbit

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PathGradients:
    """Derivatives of signal paths; shapes as the times', vectors with a last axis of three.

    Attributes
    ----------
    delay_p : ndarray, shape (..., 3)
        d delay / d p_e [s/m].
    rate_p, rate_v : ndarray, shape (..., 3)
        d delay_rate / d p_e [1/m] and d v_e [s/m].
    delay_ahead, rate_ahead : ndarray, shape (...)
        d delay / d ahead_s [s/s] and d delay_rate / d ahead_s [1/s].
    """

    delay_p: _Array
    rate_p: _Array
    rate_v: _Array
    delay_ahead: _Array
    rate_ahead: _Array


@dataclass(frozen=True)
class SignalPaths:
    """Ways of signals, one for each time of reception; NaN where there is none. Shapes are the times'.

    Attributes
    ----------
    delay_s : ndarray, shape (...)
        Reception minus sending.
    delay_rate : ndarray, shape (...)
        d delay / d time of reception [s/s], positive when receding: a carrier f is heard as f (1 - delay_rate).
    range_m : ndarray, shape (...)
    source_position_e_m, source_velocity_e_mps : ndarray, shape (..., 3)
        Of the transmitter when it sent, in the ECEF axes of the instant of reception.
    direction_e : ndarray, shape (..., 3)
        Unit vectors from the receiver to that position.
    gradient : PathGradients or None
        When asked for.
    """

    delay_s: _Array
    delay_rate: _Array
    range_m: _Array
    source_position_e_m: _Array
    source_velocity_e_mps: _Array
    direction_e: _Array
    gradient: PathGradients | None = None

    def __repr__(self) -> str:
        good = int(np.count_nonzero(np.isfinite(self.delay_s)))
        return f"SignalPaths({self.delay_s.shape}, {good} known)"


def signal_path(
    orbit: SampledOrbit,
    t_s: npt.ArrayLike,
    position_e_m: npt.ArrayLike,
    velocity_e_mps: npt.ArrayLike = (0.0, 0.0, 0.0),
    *,
    ahead_s: npt.ArrayLike = 0.0,
    gradient: bool = False,
) -> SignalPaths:
    """Delay and delay rate of what a receiver hears from a transmitter; light time and the Earth's turn are solved.

    Solved to below a nanometre; the rate is the exact derivative (cpp/doc/orbits.md). No relativity, no atmosphere.

    Parameters
    ----------
    orbit : SampledOrbit
    t_s : array_like, shape (...)
        Times of reception, of the orbit's reference.
    position_e_m, velocity_e_mps : array_like, shape (3,) or (..., 3)
        The receiver, ECEF.
    ahead_s : array_like
        The transmitter runs so much ahead of its samples along its orbit in space. Left out for one at rest.
    gradient : bool
        Derivatives as well.

    Returns
    -------
    SignalPaths
        NaN where the instant of sending lies outside the samples, or an argument is not finite.

    Raises
    ------
    ValueError
        For shapes that do not fit.
    """
    times = np.asarray(t_s, dtype=np.float64)
    shape = times.shape

    def vectors(name: str, values: npt.ArrayLike) -> _Array:
        array = np.asarray(values, dtype=np.float64)
        try:
            return np.broadcast_to(array, (*shape, 3)).reshape(-1, 3)
        except ValueError:
            raise ValueError(f"{name}: shape (3,) or {(*shape, 3)} expected, got {array.shape}") from None

    p, v = vectors("position_e_m", position_e_m), vectors("velocity_e_mps", velocity_e_mps)
    ahead = np.asarray(ahead_s, dtype=np.float64)
    if ahead.shape not in ((), shape):
        raise ValueError(f"ahead_s: a number or shape {shape} expected, got {ahead.shape}")
    numbers, source_p, source_v, direction, d = _geometry.signal_path(
        orbit, times.reshape(-1), p, v, np.broadcast_to(ahead, shape).reshape(-1), gradient
    )
    derivatives = None
    if gradient:
        derivatives = PathGradients(
            d[:, 0:3].reshape(*shape, 3),
            d[:, 3:6].reshape(*shape, 3),
            d[:, 6:9].reshape(*shape, 3),
            d[:, 9].reshape(shape),
            d[:, 10].reshape(shape),
        )
    return SignalPaths(
        numbers[:, 0].reshape(shape),
        numbers[:, 1].reshape(shape),
        numbers[:, 2].reshape(shape),
        source_p.reshape(*shape, 3),
        source_v.reshape(*shape, 3),
        direction.reshape(*shape, 3),
        derivatives,
    )
