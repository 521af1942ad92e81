"""Positions from pseudoranges: the face of the engine's single-point solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry as _geometry
from soopnav_cpp._core import gnss as _gnss
from soopnav_cpp._core.gnss import PointStatus, SatelliteUse

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PointFixes:
    """Positions, one row for each epoch; NaN where there is none. Arrays are read-only.

    Attributes
    ----------
    status : ndarray of uint8, shape (n,)
        Values of `PointStatus`.
    position_m : ndarray, shape (n, 3)
        ECEF.
    covariance_m2, covariance_enu_m2 : ndarray, shape (n, 3, 3)
        Of it, from the stated standard deviations: ECEF, and east, north, up.
    clock_bias_m, clock_sigma_m : ndarray, shape (n,)
        c times what the receiver's clock is ahead of GPS time.
    gdop, pdop, hdop, vdop, tdop : ndarray, shape (n,)
        Dilutions of precision of the satellites used.
    chi_square : ndarray, shape (n,)
    degrees_of_freedom, iterations : ndarray of int64, shape (n,)
    velocity_mps : ndarray, shape (n, 3)
        ECEF; NaN with fewer than four range rates.
    velocity_covariance : ndarray, shape (n, 3, 3)
    clock_drift_mps : ndarray, shape (n,)
    unobservable : ndarray, shape (n, 4, 4)
        Rows: orthonormal directions (x, y, z, clock) that the satellites leave open; the rest NaN.
    use : ndarray of uint8, shape (n, s)
        Values of `SatelliteUse`, in the order of the observations.
    residuals_m, azimuth_rad, elevation_rad : ndarray, shape (n, s)
        Measured minus predicted; azimuth from north towards east.
    """

    status: npt.NDArray[np.uint8]
    position_m: _Array
    covariance_m2: _Array
    covariance_enu_m2: _Array
    clock_bias_m: _Array
    clock_sigma_m: _Array
    gdop: _Array
    pdop: _Array
    hdop: _Array
    vdop: _Array
    tdop: _Array
    chi_square: _Array
    degrees_of_freedom: npt.NDArray[np.int64]
    iterations: npt.NDArray[np.int64]
    velocity_mps: _Array
    velocity_covariance: _Array
    clock_drift_mps: _Array
    unobservable: _Array
    use: npt.NDArray[np.uint8]
    residuals_m: _Array
    azimuth_rad: _Array
    elevation_rad: _Array

    def __len__(self) -> int:
        return len(self.status)

    def __repr__(self) -> str:
        good = self.converged
        if not good.any():
            return f"PointFixes({len(self)} epochs, none converged: {self.message()})"
        return (
            f"PointFixes({len(self)} epochs, {np.count_nonzero(good)} converged, "
            f"{np.mean(self.used[good].sum(axis=1)):.1f} satellites, PDOP {np.mean(self.pdop[good]):.2f})"
        )

    @property
    def converged(self) -> npt.NDArray[np.bool_]:
        """Which epochs have a position that its measurements agree with, shape (n,)."""
        return np.asarray(self.status == PointStatus.CONVERGED)

    @property
    def used(self) -> npt.NDArray[np.bool_]:
        """Which satellites took part, shape (n, s)."""
        return np.asarray(self.use == SatelliteUse.USED)

    def errors_enu_m(self, reference_position_m: npt.ArrayLike) -> _Array:
        """Position minus a reference, in the level frame there: east, north, up, shape (n, 3).

        Parameters
        ----------
        reference_position_m : array_like, shape (3,)
            ECEF.
        """
        reference = np.asarray(reference_position_m, dtype=np.float64)
        if reference.shape != (3,) or not np.isfinite(reference).all():
            raise ValueError(f"reference_position_m: three finite numbers expected, got shape {reference.shape}")
        latitude, longitude, height = (float(x) for x in _geometry.ecef_to_geodetic(reference))
        return _geometry.LocalFrame(latitude, longitude, height).position_from_ecef(self.position_m)

    def message(self, epoch: int = 0) -> str:
        """One sentence about an epoch: how it ended and what became of its satellites."""
        if not len(self):
            return "no epoch"
        status = PointStatus(int(self.status[epoch])).name.lower().replace("_", " ")
        use = self.use[epoch]
        parts = [f"{status}: {np.count_nonzero(use == SatelliteUse.USED)} of {len(use)} satellites used"]
        for what, words in (
            (SatelliteUse.NOT_FINITE, "without a number"),
            (SatelliteUse.NO_EPHEMERIS, "without ephemeris"),
            (SatelliteUse.STALE, "with a stale ephemeris"),
            (SatelliteUse.UNHEALTHY, "unhealthy"),
            (SatelliteUse.LOW, "below the mask"),
            (SatelliteUse.REJECTED, "rejected"),
        ):
            if np.any(use == what):
                parts.append(f"{np.count_nonzero(use == what)} {words}")
        return ", ".join(parts)


def solve(table: Any, klobuchar: _Array | None, options: Any, columns: tuple[Any, ...]) -> PointFixes:
    """The engine's columns as `PointFixes`."""
    out = list(_gnss.single_points(table, klobuchar, options, *columns))
    dop = out[6]
    out[6:7] = [np.ascontiguousarray(dop[:, i]) for i in range(5)]
    for array in out:
        array.flags.writeable = False
    return PointFixes(*out)
