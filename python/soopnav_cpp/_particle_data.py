"""What particle filters are given and what they return; shapes are checked here."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import ParticlePrior, ParticleStatus
from soopnav_cpp._core.measurement import Measurement

__all__ = ["AdaptiveCount", "Gaussian", "Measured", "ParticleRun", "Prior", "Samples", "Uniform"]

Array: TypeAlias = npt.NDArray[np.float64]
Observation: TypeAlias = tuple[list[Measurement], Array, Array | None, Array | None, float, float]


@dataclass(frozen=True)
class Gaussian:
    """Particles drawn from a normal distribution.

    Attributes
    ----------
    x0 : array_like, shape (n,)
    P0 : array_like, shape (n, n)
        Positive semi-definite: components without variance start where `x0` says.
    """

    x0: npt.ArrayLike
    P0: npt.ArrayLike


@dataclass(frozen=True)
class Uniform:
    """Particles drawn uniformly from a box.

    Attributes
    ----------
    low : array_like, shape (n,), or (n, 2)
        Lower bounds; or both bounds of each component, without `high`.
    high : array_like, shape (n,), optional
    """

    low: npt.ArrayLike
    high: npt.ArrayLike | None = None


@dataclass(frozen=True)
class Samples:
    """Particles as they are, of equal weight.

    Attributes
    ----------
    particles : array_like, shape (N, n)
    """

    particles: npt.ArrayLike


Prior: TypeAlias = Gaussian | Uniform | Samples


@dataclass(frozen=True)
class AdaptiveCount:
    """A number of particles that follows the spread of the cloud (Fox 2003).

    Resampling draws as many particles as keep the Kullback-Leibler divergence between the cloud and what it stands
    for, over the bins that it occupies, below a bound.

    Attributes
    ----------
    bin_sizes : array_like, shape (n,)
        Size of a bin along each component, in its unit; 0 for components that do not count.
    least : int
        Particles there always are.
    divergence : float
        The bound [nat] ...
    probability : float
        ... that is kept with this probability, above 0.5.
    """

    bin_sizes: npt.ArrayLike
    least: int = 50
    divergence: float = 0.05
    probability: float = 0.99


@dataclass(frozen=True)
class Measured:
    """Measurements over time, for `ParticleFilter.run`: m rows at each of T times.

    Attributes
    ----------
    model : measurement model, or a sequence of them
        Their rows stand one behind the other in `z`.
    z : array_like, shape (T, m), or (T,) for m = 1
    sigma : array_like, optional
        Standard deviations of independent rows: a number, (m,) or (T, m).
    R : array_like, shape (m, m) or (T, m, m), optional
        Covariance, in place of `sigma`; at most 16 rows.
    mask : array_like of bool, shape (T,), optional
        False where there is no measurement; what stands there is not read.
    outlier_probability, outlier_density : float
        See `ParticleFilter.update`.
    """

    model: Measurement | Sequence[Measurement]
    z: npt.ArrayLike
    sigma: npt.ArrayLike | None = None
    R: npt.ArrayLike | None = None
    mask: npt.ArrayLike | None = None
    outlier_probability: float = 0.0
    outlier_density: float = 0.0


@dataclass(frozen=True, repr=False, eq=False)
class ParticleRun:
    """What a particle filter estimated over T times.

    Attributes
    ----------
    mean : ndarray, shape (T, n)
        Weighted mean after each step, before any resampling.
    covariance : ndarray, shape (T, n, n), or None
        Of the cloud; None when it was not asked for.
    ess : ndarray, shape (T,)
        Effective sample size, 1 … N.
    step_log_likelihood : ndarray, shape (T,)
        Estimate of the logarithm of the density of each measurement given those before; -inf where every weight
        vanished, NaN where the measurement was refused.
    status : ndarray of uint8, shape (T,)
        A `ParticleStatus` for each time.
    count : ndarray of uint64, shape (T,)
        Particles after each step: all the same unless the count is adaptive.
    resampled : ndarray of bool, shape (T,)
        Whether the step began by resampling.
    """

    mean: Array
    covariance: Array | None
    ess: Array
    step_log_likelihood: Array
    status: npt.NDArray[np.uint8]
    resampled: npt.NDArray[np.bool_]
    count: npt.NDArray[np.uint64]

    @property
    def log_likelihood(self) -> float:
        """Of the whole run."""
        return float(self.step_log_likelihood.sum())

    def __repr__(self) -> str:
        steps, n = self.mean.shape
        counts = [(int(np.count_nonzero(self.status == s)), s.name.lower().replace("_", " ")) for s in ParticleStatus]
        parts = [f"{steps} steps", f"{n} states"] + [f"{count} {name}" for count, name in counts if count]
        if steps:
            parts += [f"ess {self.ess.min():.4g} … {self.ess.max():.4g}", f"{int(self.resampled.sum())} resampled"]
        return f"ParticleRun({', '.join(parts)}, log-likelihood {self.log_likelihood:.6g})"


def vector(value: npt.ArrayLike, name: str) -> Array:
    array = np.atleast_1d(np.asarray(value, np.float64))
    if array.ndim != 1:
        raise ValueError(f"{name}: expected one axis, got shape {array.shape}")
    return array


def integer(value: Any, name: str, low: int, high: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name}: an integer expected, got {type(value).__name__}") from None
    if not low <= number <= high:
        raise ValueError(f"{name}: {number} is not in {low} … {high}")
    return number


def one_of(value: str, name: str, choices: Sequence[str]) -> str:
    if value not in choices:
        raise ValueError(f"{name}: {value!r} is none of {', '.join(map(repr, choices))}")
    return value


def core_adaptive(adaptive: AdaptiveCount | None) -> _estimation.AdaptiveCount:
    if adaptive is None:
        return _estimation.AdaptiveCount([], 1, 1.0, 0.99)
    sizes = vector(adaptive.bin_sizes, "adaptive.bin_sizes")
    if len(sizes) == 0:
        raise ValueError("adaptive.bin_sizes: one number for each component expected, got none")
    least = integer(adaptive.least, "adaptive.least", 1, 2**31 - 1)
    return _estimation.AdaptiveCount(sizes, least, float(adaptive.divergence), float(adaptive.probability))


def models_of(model: Measurement | Sequence[Measurement], name: str) -> list[Measurement]:
    models = list(model) if isinstance(model, Sequence) else [model]
    if not models:
        raise ValueError(f"{name}: no measurement model")
    for item in models:
        if not isinstance(item, Measurement):
            raise ValueError(f"{name}: a measurement model expected, got {type(item).__name__}")
    return models


def _outliers(probability: float, density: float, full: bool, name: str) -> tuple[float, float]:
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"{name}outlier_probability: {probability} is not in 0 … 1")
    if probability > 0.0 and not (density > 0.0 and np.isfinite(density)):
        raise ValueError(f"{name}outlier_density: {density}; a positive number expected with outlier_probability")
    if probability > 0.0 and full:
        raise ValueError(f"{name}outlier_probability: only with sigma, not with R")
    return float(probability), float(density)


def _variances(sigma: npt.ArrayLike) -> Array:
    values = np.asarray(sigma, np.float64)
    return values * np.abs(values)  # a negative sigma is refused as a negative variance


def _one_noise(sigma: npt.ArrayLike | None, R: npt.ArrayLike | None, name: str) -> None:
    if (sigma is None) == (R is None):
        raise ValueError(f"{name}sigma, R: one of them expected, got {'none' if sigma is None else 'both'}")


def observation_of(
    model: Measurement | Sequence[Measurement],
    z: npt.ArrayLike,
    sigma: npt.ArrayLike | None,
    R: npt.ArrayLike | None,
    probability: float,
    density: float,
) -> Observation:
    models = models_of(model, "model")
    m = sum(item.rows for item in models)
    values = vector(z, "z")
    if len(values) != m:
        raise ValueError(f"z: {len(values)} numbers; the model has {m} rows")
    _one_noise(sigma, R, "")
    chance, floor = _outliers(probability, density, R is not None, "")
    if sigma is not None:
        variances = _variances(sigma)
        if variances.shape not in ((), (m,)):
            raise ValueError(f"sigma: shape {variances.shape}, expected a number or ({m},)")
        return models, values, np.broadcast_to(variances, (m,)).copy(), None, chance, floor
    covariance = np.asarray(R, np.float64)
    if covariance.ndim == 0 and m == 1:
        covariance = covariance.reshape(1, 1)
    if covariance.shape != (m, m):
        raise ValueError(f"R: shape {covariance.shape}, expected ({m}, {m})")
    return models, values, None, covariance, chance, floor


def series_of(measured: Measured, steps: int, name: str) -> tuple[Any, ...]:
    models = models_of(measured.model, f"{name}.model")
    m = sum(item.rows for item in models)
    z = np.asarray(measured.z, np.float64)
    if z.ndim == 1 and m == 1:
        z = z[:, np.newaxis]
    if z.shape != (steps, m):
        raise ValueError(f"{name}.z: shape {z.shape}, expected ({steps}, {m})")
    _one_noise(measured.sigma, measured.R, f"{name}.")
    chance, floor = _outliers(
        measured.outlier_probability, measured.outlier_density, measured.R is not None, f"{name}."
    )
    mask: npt.NDArray[np.uint8] | None = None
    if measured.mask is not None:
        flags = np.asarray(measured.mask)
        if flags.dtype != np.bool_ or flags.shape != (steps,):
            raise ValueError(f"{name}.mask: expected bool ({steps},), got {flags.dtype} {flags.shape}")
        mask = flags.astype(np.uint8)
    if measured.sigma is not None:
        variances = _variances(measured.sigma)
        if variances.shape not in ((), (m,), (steps, m)):
            raise ValueError(f"{name}.sigma: shape {variances.shape}, expected a number, ({m},) or ({steps}, {m})")
        each = variances.ndim == 2
        variances = variances if each else np.broadcast_to(variances, (m,)).copy()
        return models, z, variances, None, each, mask, chance, floor
    covariance = np.asarray(measured.R, np.float64)
    if covariance.ndim == 0 and m == 1:
        covariance = covariance.reshape(1, 1)
    if covariance.shape not in ((m, m), (steps, m, m)):
        raise ValueError(f"{name}.R: shape {covariance.shape}, expected ({m}, {m}) or ({steps}, {m}, {m})")
    return models, z, None, covariance, covariance.ndim == 3, mask, chance, floor


def measured_of(group: Measured | tuple[Any, ...], name: str) -> Measured:
    if isinstance(group, Measured):
        return group
    if not isinstance(group, tuple) or len(group) not in (3, 4):
        raise ValueError(f"{name}: Measured, (model, z, R) or (model, z, R, mask) expected, got {type(group).__name__}")
    model, z, R = group[:3]
    mask = group[3] if len(group) == 4 else None
    if np.ndim(R) > 1:
        return Measured(model, z, R=R, mask=mask)
    variances = np.asarray(R, np.float64)
    return Measured(model, z, sigma=np.copysign(np.sqrt(np.abs(variances)), variances), mask=mask)


def check_saved(saved: Mapping[str, npt.NDArray[Any]], n: int, least: int, most: int) -> None:
    """Refuse what no filter of n components and `least` to `most` particles can have saved."""
    wanted = ("particles", "log_weights", "log_likelihood", "steps", "restarts", "clock_covariance")
    missing = [name for name in wanted if name not in saved]
    if missing:
        raise ValueError(f"saved: no {', '.join(missing)}")
    count = max(least, min(most, np.size(saved["log_weights"])))
    for name, shape in (("particles", (count, n)), ("log_weights", (count,))):
        if np.shape(saved[name]) != shape:
            raise ValueError(f"saved['{name}']: shape {np.shape(saved[name])}, expected {shape}")
    if not np.isfinite(saved["log_likelihood"]):
        raise ValueError(f"saved['log_likelihood']: {float(saved['log_likelihood'])}, a finite number expected")
    for name in ("steps", "restarts"):
        integer(np.asarray(saved[name]).item(), f"saved['{name}']", 0, 2**64 - 1)
    clock = np.asarray(saved["clock_covariance"], np.float64)
    size = round(np.sqrt(clock.size))
    P = clock.reshape(size, size) if size * size == clock.size else np.full((1, 1), np.nan)
    scale = np.abs(P).max(initial=0.0)
    sound = bool(np.isfinite(scale)) and np.allclose(P, P.T, rtol=0.0, atol=1e-9 * scale)
    if not (sound and np.linalg.eigvalsh(P).min(initial=0.0) >= -1e-9 * scale):
        raise ValueError("saved['clock_covariance']: finite, symmetric and positive semi-definite expected")


def core_prior(prior: Prior) -> tuple[ParticlePrior, int]:
    """The engine's prior, and the number of components."""
    if isinstance(prior, Gaussian):
        x0 = vector(prior.x0, "prior.x0")
        P0 = np.asarray(prior.P0, np.float64)
        P0 = P0.reshape(1, 1) if P0.ndim == 0 else P0
        if P0.shape != (len(x0), len(x0)):
            raise ValueError(f"prior.P0: shape {P0.shape}, expected ({len(x0)}, {len(x0)})")
        return _estimation.gaussian_prior(x0, P0), len(x0)
    if isinstance(prior, Uniform):
        if prior.high is None:
            box = np.asarray(prior.low, np.float64)
            if box.ndim != 2 or box.shape[1] != 2:
                raise ValueError(f"prior.low: shape {box.shape}; (n, 2) expected without high")
            low, high = box[:, 0], box[:, 1]
        else:
            low, high = vector(prior.low, "prior.low"), vector(prior.high, "prior.high")
            if low.shape != high.shape:
                raise ValueError(f"prior.high: shape {high.shape}, expected that of low, {low.shape}")
        return _estimation.uniform_prior(low, high), len(low)
    if isinstance(prior, Samples):
        particles = np.asarray(prior.particles, np.float64)
        if particles.ndim != 2 or particles.size == 0:
            raise ValueError(f"prior.particles: shape {particles.shape}, expected (N, n), not empty")
        return _estimation.sample_prior(particles), particles.shape[1]
    raise ValueError(f"prior: Gaussian, Uniform or Samples expected, got {type(prior).__name__}")
