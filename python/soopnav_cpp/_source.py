"""Where a source is, from bearings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import (
    BearingUse,
    SourceFix,
    SourceLine,
    SourceMethod,
    SourceStatus,
)
from soopnav_cpp._source_inputs import MOTIONS, floats, named, observed

__all__ = [
    "BearingUse",
    "SourceFix",
    "SourceLine",
    "SourceLocator",
    "SourceMethod",
    "SourceRun",
    "SourceStatus",
    "locate_source",
]

_Array = npt.NDArray[np.float64]
_METHODS = {
    "centroid": SourceMethod.CENTROID,
    "incenter": SourceMethod.INCENTER,
    "linear": SourceMethod.LINEAR,
    "stansfield": SourceMethod.STANSFIELD,
    "least_squares": SourceMethod.LEAST_SQUARES,
    "ml": SourceMethod.ML,
    "ekf": SourceMethod.EKF,
    "ekf_bank": SourceMethod.EKF_BANK,
    "particle": SourceMethod.PARTICLE,
}
_STATUSES = {int(status.value): status for status in SourceStatus}
_USES = {int(use.value): use for use in BearingUse}


@dataclass(frozen=True)
class SourceRun:
    """Fixes over time; NaN where there is none yet. Of many runs every array has a first axis of runs.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, d)
    covariance_m2 : ndarray, shape (n, d, d)
    velocity_mps, velocity_covariance : ndarray, shapes (n, d) and (n, d, d)
        Of a moving source.
    cep_m, heading_bias_rad, heading_bias_sigma_rad : ndarray, shape (n,)
    status_code, use_code : ndarray of int64, shape (n,)
        Values of `SourceStatus` and `BearingUse`; `status` and `use` give the members.
    """

    t_s: _Array
    position_m: _Array
    covariance_m2: _Array
    velocity_mps: _Array
    velocity_covariance: _Array
    cep_m: _Array
    heading_bias_rad: _Array
    heading_bias_sigma_rad: _Array
    status_code: npt.NDArray[np.int64]
    use_code: npt.NDArray[np.int64]

    @property
    def status(self) -> list[SourceStatus]:
        """How each fix ended, in the order of a flattened `status_code`."""
        return [_STATUSES[int(code)] for code in self.status_code.ravel()]

    @property
    def use(self) -> list[BearingUse]:
        """What became of each bearing."""
        return [_USES[int(code)] for code in self.use_code.ravel()]

    def error_m(self, emitter: npt.ArrayLike) -> _Array:
        """Distance from the truth, shape (n,): `emitter` has shape (d,), or (n, d) when it moves."""
        return np.asarray(np.linalg.norm(self.position_m - np.asarray(emitter, dtype=np.float64), axis=-1))

    def nees(self, emitter: npt.ArrayLike) -> _Array:
        """Squared error in the stated covariance, shape (n,); NaN where a covariance is singular."""
        error = self.position_m - np.asarray(emitter, dtype=np.float64)
        good = np.asarray(np.isfinite(error).all(-1) & np.isfinite(self.covariance_m2).all((-2, -1)))
        covariance = np.where(good[..., None, None], self.covariance_m2, np.eye(error.shape[-1]))
        good &= np.linalg.det(covariance) > 0.0
        covariance = np.where(good[..., None, None], covariance, np.eye(error.shape[-1]))
        value = np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)
        return np.where(good, value, np.nan)

    def __repr__(self) -> str:
        return f"SourceRun({' x '.join(map(str, self.status_code.shape))} fixes in {self.position_m.shape[-1]}-D)"


def _run(t_s: _Array, arrays: tuple[Any, ...]) -> SourceRun:
    position, covariance, velocity, velocity_covariance, scalars, status, use = arrays
    return SourceRun(
        t_s,
        position,
        covariance,
        velocity,
        velocity_covariance,
        np.ascontiguousarray(scalars[..., 0]),
        np.ascontiguousarray(scalars[..., 1]),
        np.ascontiguousarray(scalars[..., 2]),
        status,
        use,
    )


class SourceLocator:
    """Bearings in, a position out; one at a time, or a whole run in one call (carter 5.4).

    Model: azimuth = atan2(dy, dx) + heading bias, counted from x towards y, elevation = atan2(dz, hypot(dx, dy)) up,
    for the vector d from the platform to the source. Errors are normal, of variance sigma² + heading sigma² + what the
    platform's position covariance leaves across the line of sight.

    Parameters
    ----------
    method : str
        "centroid", "incenter" (running means over triangles of bearings), "linear" (carter 5.8 as printed: unweighted,
        biased), "stansfield" (the same weighted by 1 / (r² sigma²)), "least_squares", "ml" (wrapped normal with an
        outlier floor), "ekf" (one filter: it diverges in a few per cent of starts), "ekf_bank" (filters at several
        ranges) or "particle".
    dimensions : {2, 3}
        Azimuths, or azimuths and elevations.
    motion : {"static", "constant_velocity"}
        The latter for "least_squares", "ml", "ekf" and "ekf_bank".
    start_m : array_like, shape (d,), optional
        A first guess for "ekf", "particle", "least_squares" and the search region of "ml" (3 sigma about it); the bank
        needs none.
    **options
        ``start_sigma_m`` (1000), ``start_speed_sigma_mps`` (10), ``acceleration_psd`` (0) in m²/s³, ``min_range_m``
        (30), ``max_range_m`` (3000), ``outlier_probability`` (0.02), ``heading_bias_sigma_rad`` (0: none estimated),
        ``min_crossing_rad`` (10 degrees), ``triple_spacing`` (10), ``grid_size`` (64), ``max_iterations`` (50),
        ``particles`` (10 000), ``ess_threshold`` (0.5), ``seed`` (0), ``filters`` (10), ``bank_sigma_rad`` (10
        degrees: the bank starts at the first bearing whose angles are as good), ``bank_azimuths`` (0; else so many
        directions at the first bearing), ``max_bearings`` (4096), ``false_alarm_probability`` (1e-4).

    Raises
    ------
    ValueError
        For an option that is unknown or out of range. Bad bearings are no error: they are left out, see
        ``SourceFix.last`` and ``SourceFix.status``.
    """

    _OPTIONS = frozenset(
        {
            "start_sigma_m",
            "start_speed_sigma_mps",
            "acceleration_psd",
            "min_range_m",
            "max_range_m",
            "outlier_probability",
            "heading_bias_sigma_rad",
            "min_crossing_rad",
            "triple_spacing",
            "grid_size",
            "max_iterations",
            "particles",
            "ess_threshold",
            "seed",
            "filters",
            "bank_sigma_rad",
            "bank_azimuths",
            "max_bearings",
            "false_alarm_probability",
        }
    )

    def __init__(
        self,
        method: str = "ml",
        *,
        dimensions: int = 2,
        motion: str = "static",
        start_m: npt.ArrayLike | None = None,
        **options: float,
    ) -> None:
        unknown = sorted(set(options) - self._OPTIONS)
        if unknown:
            raise ValueError(f"{unknown[0]}: no such option; known are {', '.join(sorted(self._OPTIONS))}")
        self.method = method
        self.dimensions = dimensions
        self.motion = motion
        try:
            self._core = _navigation.SourceLocator(
                named("method", method, _METHODS), dimensions, named("motion", motion, MOTIONS), start_m, **options
            )
        except (RuntimeError, TypeError):
            raise ValueError(f"options: a number of the wrong kind among {options}") from None
        self._seed = int(options.get("seed", 0))
        self._start = None if start_m is None else floats("start_m", start_m)
        self._steps = 0

    def step(
        self,
        t_s: float,
        position: npt.ArrayLike,
        bearing: npt.ArrayLike,
        sigma: npt.ArrayLike,
        *,
        position_covariance: npt.ArrayLike | None = None,
        heading_sigma_rad: float = 0.0,
    ) -> SourceFix:
        """One bearing.

        Parameters
        ----------
        t_s : float
        position : array_like, shape (d,)
        bearing : float or array_like, shape (2,)
            Azimuth, or azimuth and elevation.
        sigma : float or array_like, shape (2,)
        position_covariance : array_like, shape (d, d), optional
            Of the platform's position.
        heading_sigma_rad : float
            Of the platform's heading.

        Returns
        -------
        SourceFix
        """
        z = floats("bearing", bearing).reshape(1, -1)
        s = floats("sigma", sigma).reshape(-1)
        if not s.size:
            raise ValueError("sigma: a number expected, got none")
        seen = observed(
            floats("position", position).reshape(1, -1),
            z,
            s if s.size > 1 else s[0],
            times=[t_s],
            position_covariance=position_covariance,
            heading_sigma_rad=heading_sigma_rad,
            dimensions=self.dimensions,
        )
        fix = self._core.step(*seen.arguments, True)
        assert fix is not None
        return fix

    def run(
        self,
        times: npt.ArrayLike,
        positions: npt.ArrayLike,
        bearings: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        *,
        position_covariance: npt.ArrayLike | None = None,
        heading_sigma_rad: npt.ArrayLike = 0.0,
    ) -> SourceRun:
        """A fix after every bearing, going on from where the locator stands.

        Parameters
        ----------
        times : array_like, shape (n,)
        positions : array_like, shape (n, d)
        bearings : array_like, shape (n,) or (n, 2)
        sigmas : float or array_like, shape (n,) or (n, 2)
        position_covariance : array_like, shape (d, d) or (n, d, d), optional
        heading_sigma_rad : float or array_like, shape (n,)

        Returns
        -------
        SourceRun
        """
        seen = observed(
            positions,
            bearings,
            sigmas,
            times=times,
            position_covariance=position_covariance,
            heading_sigma_rad=heading_sigma_rad,
            dimensions=self.dimensions,
        )
        return _run(seen.times_s, self._core.run(*seen.arguments))

    def run_many(
        self,
        times: npt.ArrayLike,
        positions: npt.ArrayLike,
        bearings: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        *,
        starts_m: npt.ArrayLike | None = None,
        seeds: Sequence[int] | None = None,
        epochs: Sequence[int] | None = None,
        position_covariance: npt.ArrayLike | None = None,
        heading_sigma_rad: npt.ArrayLike = 0.0,
    ) -> SourceRun:
        """Many runs over one path, each from new: Monte Carlo in one call.

        Parameters
        ----------
        times : array_like, shape (n,)
        positions : array_like, shape (n, d)
        bearings : array_like, shape (runs, n) or (runs, n, 2)
        sigmas : float or array_like, shape (n,), (runs, n), or with a last axis of 2
        starts_m : array_like, shape (runs, d), optional
            Otherwise every run has the locator's own start, if any.
        seeds : sequence of int, optional
            One for each run, not negative; otherwise the locator's own plus the number of the run.
        epochs : sequence of int, optional
            Where a fix is made, ascending; otherwise only at the last.

        Returns
        -------
        SourceRun
            Arrays with axes (runs, epochs, ...).
        """
        runs = len(np.asarray(bearings))
        seen = observed(
            positions,
            bearings,
            sigmas,
            times=times,
            position_covariance=position_covariance,
            heading_sigma_rad=heading_sigma_rad,
            dimensions=self.dimensions,
            runs=runs,
        )
        n = len(seen.times_s)
        chosen = [n - 1] if epochs is None else [int(k) for k in epochs]
        if any(not 0 <= k < n for k in chosen) or any(b <= a for a, b in itertools.pairwise(chosen)):
            raise ValueError(f"epochs: ascending indices below {n} expected, got {list(chosen)}")
        own = np.empty((0, self.dimensions)) if self._start is None else np.tile(self._start, (runs, 1))
        starts = own if starts_m is None else floats("starts_m", starts_m)
        if starts_m is not None and starts.shape != (runs, self.dimensions):
            raise ValueError(f"starts_m: expected shape ({runs}, {self.dimensions}), got {starts.shape}")
        drawn = [self._seed + run for run in range(runs)] if seeds is None else [int(seed) for seed in seeds]
        if len(drawn) != runs:
            raise ValueError(f"seeds: {runs} expected, got {len(drawn)}")
        if any(not 0 <= seed < 2**64 for seed in drawn):
            raise ValueError(f"seeds: numbers from 0 to 2^64 - 1 expected, got {drawn}")
        return _run(seen.times_s[chosen], self._core.run_many(*seen.arguments, starts, drawn, chosen))

    def reset(self, start_m: npt.ArrayLike | None = None, *, seed: int | None = None) -> None:
        """As new, from another start; without one from the bearings."""
        start = None if start_m is None else floats("start_m", start_m)
        if start is not None and start.shape != (self.dimensions,):
            raise ValueError(f"start_m: expected shape ({self.dimensions},), got {start.shape}")
        if start is not None and not np.isfinite(start).all():
            raise ValueError(f"start_m: finite numbers expected, got {start.tolist()}")
        drawn = self._seed if seed is None else int(seed)
        if not 0 <= drawn < 2**64:
            raise ValueError(f"seed = {drawn}: 0 to 2^64 - 1 expected")
        self._core.reset(start, drawn)
        self._start, self._seed = start, drawn

    @property
    def particles_m(self) -> _Array:
        """Places of the particles, shape (particles, d); empty for other methods."""
        return self._core.particles()

    @property
    def particle_weights(self) -> _Array:
        """Their weights, which sum to one after a fix."""
        return self._core.weights()

    @property
    def members(self) -> tuple[_Array, _Array]:
        """Positions (k, d) and weights (k,) of the bank's filters; empty before it starts and for other methods."""
        at, weights = self._core.members()
        return at, weights

    def __repr__(self) -> str:
        return f"SourceLocator({self.method!r}, dimensions={self.dimensions}, motion={self.motion!r})"


def locate_source(
    positions: npt.ArrayLike,
    bearings: npt.ArrayLike,
    sigmas: npt.ArrayLike,
    method: str = "ml",
    *,
    times: npt.ArrayLike | None = None,
    position_covariance: npt.ArrayLike | None = None,
    heading_sigma_rad: npt.ArrayLike = 0.0,
    motion: str = "static",
    start_m: npt.ArrayLike | None = None,
    seed: int = 0,
    **options: float,
) -> SourceFix:
    """Where a source is, from all bearings at once.

    Parameters
    ----------
    positions : array_like, shape (n, 2) or (n, 3)
        Of the platform, local planar metres: x east, y north, z up.
    bearings : array_like, shape (n,) or (n, 2)
        Azimuths from x towards y in radians; or azimuth and elevation, for three dimensions.
    sigmas : float or array_like, shape (n,) or (n, 2)
        Standard deviations in radians.
    method : str
        See `SourceLocator`.
    times : array_like, shape (n,), optional
        Of a moving source's bearings; otherwise 0, 1, 2, ...
    position_covariance : array_like, shape (d, d) or (n, d, d), optional
        Of `positions`.
    heading_sigma_rad : float or array_like, shape (n,)
        Of the platform's heading, independent from bearing to bearing; a constant error is estimated with
        ``heading_bias_sigma_rad``.
    motion : {"static", "constant_velocity"}
    start_m : array_like, shape (d,), optional
    seed : int
        Of the particle filter.
    **options
        See `SourceLocator`. Without ``max_range_m`` sources are looked for to 20 times the path's extent, and to 100
        times ``min_range_m`` where one is given; without
        ``bank_azimuths`` the bank starts all round when no bearing is good enough.

    Returns
    -------
    SourceFix
        ``status``, ``position_m``, ``covariance_m2``, ``cep_m``, ``unobservable`` with the ``line`` on which the source
        then lies; ``message`` says it in a sentence.

    Raises
    ------
    ValueError
        For shapes that do not fit and options out of range. Bearings that are not finite or have no positive sigma are
        left out; too few, parallel or contradictory ones give a ``status``.
    """
    seen = observed(
        positions,
        bearings,
        sigmas,
        times=times,
        position_covariance=position_covariance,
        heading_sigma_rad=heading_sigma_rad,
    )
    finite = seen.positions[np.isfinite(seen.positions).all(axis=1)]
    with np.errstate(over="ignore"):
        extent = float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 0.0
    if not np.isfinite(extent):
        raise ValueError("positions: they lie too far apart for their distance to be a number")
    if "max_range_m" not in options and extent > 0.0:
        options["max_range_m"] = max(20.0 * extent, 100.0 * options.get("min_range_m", 0.0))
    options.setdefault("min_range_m", 0.01 * options.get("max_range_m", 3000.0))
    if method == "ekf_bank" and "bank_azimuths" not in options:
        worst = seen.sigmas.max(axis=1)
        best = float(np.min(worst, initial=np.inf, where=worst > 0.0))
        options["bank_azimuths"] = 0 if best < options.get("bank_sigma_rad", float(np.radians(10.0))) else 12
    options.setdefault("max_bearings", max(4096, len(seen.times_s)))
    locator = SourceLocator(
        method, dimensions=seen.positions.shape[1], motion=motion, start_m=start_m, seed=seed, **options
    )
    fix = locator._core.step(*seen.arguments, True)
    assert fix is not None
    return fix
