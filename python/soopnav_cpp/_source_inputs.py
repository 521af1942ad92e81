"""What every way of finding a source takes: words, numbers, bearings with where they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.navigation import SourceMotion

__all__ = ["MOTIONS", "Observed", "floats", "named", "observed"]

_Array = npt.NDArray[np.float64]
MOTIONS = {"static": SourceMotion.STATIC, "constant_velocity": SourceMotion.CONSTANT_VELOCITY}


def named(name: str, value: str, table: dict[str, Any]) -> Any:
    if value not in table:
        raise ValueError(f"{name} = {value!r}: one of {', '.join(map(repr, table))} expected")
    return table[value]


@dataclass(frozen=True)
class Observed:
    """Arguments in the shapes that the engine takes."""

    times_s: _Array  # (n,)
    positions: _Array  # (n, d)
    bearings: _Array  # (..., n, d - 1)
    sigmas: _Array  # (..., n, d - 1)
    position_covariance: _Array  # (n, d, d), or empty
    heading_sigma_rad: _Array  # (n,)

    @property
    def arguments(self) -> tuple[_Array, _Array, _Array, _Array, _Array, _Array]:
        return (
            self.times_s,
            self.positions,
            self.bearings,
            self.sigmas,
            self.position_covariance,
            self.heading_sigma_rad,
        )


def floats(name: str, value: npt.ArrayLike) -> _Array:
    if np.iscomplexobj(value):
        raise ValueError(f"{name}: real numbers expected, got complex ones")
    try:
        return np.asarray(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: numbers expected ({error})") from None


def observed(
    positions: npt.ArrayLike,
    bearings: npt.ArrayLike | None,
    sigmas: npt.ArrayLike,
    *,
    times: npt.ArrayLike | None = None,
    position_covariance: npt.ArrayLike | None = None,
    heading_sigma_rad: npt.ArrayLike = 0.0,
    dimensions: int | None = None,
    runs: int | None = None,
) -> Observed:
    """Broadcasts and checks shapes; `runs`: bearings carry a first axis of so many runs."""
    p = floats("positions", positions)
    if p.ndim != 2 or p.shape[1] not in (2, 3):
        raise ValueError(f"positions: expected shape (n, 2) or (n, 3), got {p.shape}")
    n = p.shape[0]
    lead = () if runs is None else (runs,)
    z = np.zeros((n, (dimensions or p.shape[1]) - 1)) if bearings is None else floats("bearings", bearings)
    if z.shape == (*lead, n):
        z = z[..., None]
    if z.shape[:-1] != (*lead, n) or z.shape[-1] not in (1, 2):
        shape = ", ".join(map(str, (*lead, n)))
        raise ValueError(f"bearings: expected shape ({shape},) or ({shape}, 2), got {z.shape}")
    d = z.shape[-1] + 1
    if dimensions is not None and dimensions != d:
        what = "azimuths" if dimensions == 2 else "azimuth and elevation"
        raise ValueError(f"bearings: {what} expected in {dimensions} dimensions, got shape {z.shape}")
    if p.shape[1] < d:
        raise ValueError(f"positions: azimuth and elevation need three coordinates, got shape {p.shape}")
    p = np.ascontiguousarray(p[:, :d])
    s = floats("sigmas", sigmas)
    if s.ndim and (s.shape[-1] != d - 1 or s.shape == (n,)):
        s = s[..., None]
    try:
        s = np.ascontiguousarray(np.broadcast_to(s, z.shape))
    except ValueError:
        raise ValueError(f"sigmas: shape {np.shape(sigmas)} does not fit bearings of shape {z.shape}") from None
    t = np.arange(n, dtype=np.float64) if times is None else floats("times", times)
    if t.shape != (n,):
        raise ValueError(f"times: expected shape ({n},), got {t.shape}")
    if position_covariance is None:
        c = np.empty((0, d, d))
    else:
        c = floats("position_covariance", position_covariance)
        if c.shape[-2:] in ((2, 2), (3, 3)) and c.shape[-1] > d:
            c = c[..., :d, :d]
        if c.shape not in ((d, d), (n, d, d)):
            raise ValueError(f"position_covariance: expected shape ({d}, {d}) or ({n}, {d}, {d}), got {c.shape}")
        c = np.ascontiguousarray(np.broadcast_to(c, (n, d, d)))
    h = floats("heading_sigma_rad", heading_sigma_rad)
    if h.shape not in ((), (n,)):
        raise ValueError(f"heading_sigma_rad: expected a number or shape ({n},), got {h.shape}")
    return Observed(t, p, z, s, c, np.ascontiguousarray(np.broadcast_to(h, (n,))))
