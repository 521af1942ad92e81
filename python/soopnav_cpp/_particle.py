"""Particle filters: clouds of weighted states, for any likelihood and any noise."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import ParticleCloud, ParticlePrior, ParticleReport, ParticleStatus, Resampling
from soopnav_cpp._core.measurement import Measurement
from soopnav_cpp._core.process import Process

__all__ = [
    "Gaussian",
    "Measured",
    "ParticleFilter",
    "ParticleReport",
    "ParticleRun",
    "ParticleStatus",
    "Samples",
    "Uniform",
]

_Array: TypeAlias = npt.NDArray[np.float64]
Likelihood: TypeAlias = Callable[[_Array], npt.ArrayLike]
"""Log-likelihoods (N,) of particles (N, n)."""
Transition: TypeAlias = Callable[[_Array, _Array], npt.ArrayLike]
"""Next particles (N, n) from particles (N, n) and standard normals (N, k)."""
_Observation: TypeAlias = tuple[list[Measurement], _Array, _Array | None, _Array | None, float, float]


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
    resampled : ndarray of bool, shape (T,)
        Whether the step began by resampling.
    """

    mean: _Array
    covariance: _Array | None
    ess: _Array
    step_log_likelihood: _Array
    status: npt.NDArray[np.uint8]
    resampled: npt.NDArray[np.bool_]

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


def _vector(value: npt.ArrayLike, name: str) -> _Array:
    array = np.atleast_1d(np.asarray(value, np.float64))
    if array.ndim != 1:
        raise ValueError(f"{name}: expected one axis, got shape {array.shape}")
    return array


def _models(model: Measurement | Sequence[Measurement], name: str) -> list[Measurement]:
    models = list(model) if isinstance(model, (list, tuple)) else [cast(Measurement, model)]
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


def _variances(sigma: npt.ArrayLike) -> _Array:
    values = np.asarray(sigma, np.float64)
    return values * np.abs(values)  # a negative sigma is refused as a negative variance


def _one_noise(sigma: npt.ArrayLike | None, R: npt.ArrayLike | None, name: str) -> None:
    if (sigma is None) == (R is None):
        raise ValueError(f"{name}sigma, R: one of them expected, got {'none' if sigma is None else 'both'}")


def _observation(
    model: Measurement | Sequence[Measurement],
    z: npt.ArrayLike,
    sigma: npt.ArrayLike | None,
    R: npt.ArrayLike | None,
    probability: float,
    density: float,
) -> _Observation:
    models = _models(model, "model")
    m = sum(item.rows for item in models)
    values = _vector(z, "z")
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


def _series(measured: Measured, steps: int, name: str) -> tuple[Any, ...]:
    models = _models(measured.model, f"{name}.model")
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


def _measured(group: Measured | tuple[Any, ...], name: str) -> Measured:
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


_RESAMPLING = {scheme.name.lower(): scheme for scheme in Resampling}


@dataclass(frozen=True)
class _Settings:
    """What a filter was made with."""

    count: int
    prior: Prior
    state: str | tuple[str, ...] | None
    seed: int
    threads: int
    resampling: str
    ess_threshold: float
    precision: str
    recovery: str
    walls: _Array | None = None
    inside: _Array | None = None


def _integer(value: Any, name: str, low: int, high: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name}: an integer expected, got {type(value).__name__}") from None
    if not low <= number <= high:
        raise ValueError(f"{name}: {number} is not in {low} … {high}")
    return number


def _one_of(value: str, name: str, choices: Sequence[str]) -> str:
    if value not in choices:
        raise ValueError(f"{name}: {value!r} is none of {', '.join(map(repr, choices))}")
    return value


def _core_prior(prior: Prior) -> tuple[ParticlePrior, int]:
    """The engine's prior, and the number of components."""
    if isinstance(prior, Gaussian):
        x0 = _vector(prior.x0, "prior.x0")
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
            low, high = _vector(prior.low, "prior.low"), _vector(prior.high, "prior.high")
            if low.shape != high.shape:
                raise ValueError(f"prior.high: shape {high.shape}, expected that of low, {low.shape}")
        return _estimation.uniform_prior(low, high), len(low)
    if isinstance(prior, Samples):
        particles = np.asarray(prior.particles, np.float64)
        if particles.ndim != 2 or particles.size == 0:
            raise ValueError(f"prior.particles: shape {particles.shape}, expected (N, n), not empty")
        return _estimation.sample_prior(particles), particles.shape[1]
    raise ValueError(f"prior: Gaussian, Uniform or Samples expected, got {type(prior).__name__}")


class ParticleFilter:
    """Sequential importance resampling: a cloud of weighted states.

    Built-in models run in the compiled engine; models of your own are functions of all particles at once. The result
    is a function of the seed and the calls alone: the same bits for any number of threads. Calls release the
    interpreter's lock; one filter does one call at a time.

    When no particle explains a measurement (every weight vanishes), the report says ``DEGENERATE`` and `recovery` says
    what happens: ``"keep"`` leaves the moved particles weighted as before the measurement, ``"restart"`` draws them
    anew from the prior. Nothing becomes NaN. A measurement that is refused (NaN, a covariance that is not positive
    definite) changes nothing.

    Parameters
    ----------
    count : int
        N, particles.
    prior : Gaussian, Uniform or Samples
    state : str or sequence of str, optional
        What the components are: ``"position2"``, ``"position_velocity_bias2"``, … as for the Kalman filters; or names
        of plain components, 1 to 8 of them, for models of your own. Left out: a position for 1 to 3 components, plain
        ones for more.
    seed : int
    threads : int
        The caller's included; 1 … 256. Does not change a bit of the result.
    resampling : {"systematic", "stratified", "residual", "multinomial", "nearest"}
        The last is wrong, and there to show the difference (nearest entry of the cumulative sum).
    ess_threshold : float
        Steps begin by resampling when the effective sample size is below this share of N: 1 always, 0 never.
    precision : {"double", "float"}
        ``"float"`` takes half the memory, for states of 2 and 5 components.
    recovery : {"keep", "restart"}

    Examples
    --------
    >>> import numpy as np, soopnav_cpp as sn
    >>> room = [(0.0, 10.0), (0.0, 10.0)]
    >>> pf = sn.estimation.ParticleFilter(5000, prior=sn.estimation.Uniform(room), seed=1)
    >>> corners = [sn.measurement.Range(q) for q in ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0))]
    >>> report = pf.step(corners, [5.0, 8.06, 9.22], 0.3)
    >>> bool(np.all(np.abs(pf.mean - (3.0, 4.0)) < 0.5))
    True
    """

    def __init__(
        self,
        count: int,
        *,
        prior: Prior,
        state: str | Sequence[str] | None = None,
        seed: int = 0,
        threads: int = 1,
        resampling: str = "systematic",
        ess_threshold: float = 0.5,
        precision: str = "double",
        recovery: str = "keep",
    ) -> None:
        names = tuple(state) if state is not None and not isinstance(state, str) else state
        self._settings = _Settings(
            _integer(count, "count", 1, 2**31 - 1),
            prior,
            names,
            _integer(seed, "seed", 0, 2**64 - 1),
            _integer(threads, "threads", 1, 256),
            _one_of(resampling, "resampling", tuple(_RESAMPLING)),
            float(ess_threshold),
            _one_of(precision, "precision", ("double", "float")),
            _one_of(recovery, "recovery", ("keep", "restart")),
        )
        self._cloud = self._make()

    def _make(self) -> ParticleCloud:
        s = self._settings
        prior, size = _core_prior(s.prior)
        names = list(s.state) if isinstance(s.state, tuple) else None
        if names is not None and len(names) != size:
            raise ValueError(f"state: {len(names)} names; the prior has {size} components")
        guess = f"position{size}" if names is None and size <= 3 else "custom"
        state = s.state if isinstance(s.state, str) else guess
        return ParticleCloud(
            prior,
            state=state,
            size=size,
            names=names,
            count=s.count,
            seed=s.seed,
            threads=s.threads,
            resampling=_RESAMPLING[s.resampling],
            ess_threshold=s.ess_threshold,
            single=s.precision == "float",
            restart=s.recovery == "restart",
            portable=False,
        )

    # -- reading

    @property
    def count(self) -> int:
        """N, particles."""
        return self._settings.count

    @property
    def state(self) -> str:
        """Name of the state: ``"position2"``, …; ``"custom"`` for plain components."""
        return str(self._cloud.state)

    @property
    def component_names(self) -> list[str]:
        """What the n components are called."""
        return list(self._cloud.component_names)

    @property
    def mean(self) -> _Array:
        """Weighted mean, shape (n,); of a heading, the direction of the mean direction."""
        return self._cloud.mean

    @property
    def covariance(self) -> _Array:
        """Weighted covariance about the mean, shape (n, n)."""
        return self._cloud.covariance

    @property
    def ess(self) -> float:
        """Effective sample size, 1 … N."""
        return float(self._cloud.ess)

    @property
    def log_likelihood(self) -> float:
        """Sum over all accepted measurements of the estimated logarithm of their density given those before."""
        return float(self._cloud.log_likelihood)

    @property
    def particles(self) -> _Array:
        """The particles, shape (N, n): a copy. They count by their `weights`."""
        return self._cloud.particles

    @property
    def weights(self) -> _Array:
        """Normalised weights, shape (N,): a copy."""
        return self._cloud.weights

    @property
    def storage_bytes(self) -> int:
        """Memory of the engine that grows with the number of particles."""
        return int(self._cloud.storage_bytes)

    def histogram(
        self, component: int | str, bins: int = 50, range: tuple[float, float] | None = None
    ) -> tuple[_Array, _Array]:
        """Marginal distribution of one component.

        Parameters
        ----------
        component : int or str
            Its number or name.
        bins : int
        range : (float, float), optional
            Without it, from the least to the greatest particle.

        Returns
        -------
        weights : ndarray, shape (bins,)
            The weight in each bin.
        edges : ndarray, shape (bins + 1,)
        """
        names = self.component_names
        if isinstance(component, str):
            if component not in names:
                raise ValueError(f"component: {component!r} is none of {', '.join(map(repr, names))}")
            component = names.index(component)
        index = _integer(component, "component", 0, len(names) - 1)
        count = _integer(bins, "bins", 1, 10**7)
        if range is not None:
            low, high = map(float, range)
        else:
            x = self.particles[:, index]
            low, high = float(x.min()), float(x.max())
            margin = 0.5 if low == high else 1e-9 * (high - low)
            low, high = low - margin, high + margin
        if not (low < high and np.isfinite(high - low)):
            raise ValueError(f"range: ({low}, {high}); two finite numbers, the greater one second, expected")
        return self._cloud.histogram(index, low, high, count), np.linspace(low, high, count + 1)

    def __repr__(self) -> str:
        s = self._settings
        parts = [f"{s.count} particles", self.state, f"ess {self.ess:.4g}", f"seed {s.seed}"]
        return f"ParticleFilter({', '.join(parts)})"

    # -- stepping

    def predict(
        self,
        process: Any,
        dt_s: float = 1.0,
        input: npt.ArrayLike | None = None,
        *,
        noise: int | None = None,
    ) -> ParticleReport:
        """Move the particles; resamples first when the effective sample size asks for it.

        Parameters
        ----------
        process : process model, or callable
            A callable gets all particles (N, n) and standard normals (N, `noise`), and returns the next particles
            (N, n). Those that are not finite stay where they were and lose their weight.
        dt_s : float
            Not read for a callable.
        input : array_like, optional
            What the process is driven with.
        noise : int, optional
            Normals per particle for a callable; n when left out.
        """
        return self._move(process, dt_s, input, noise, [])

    def update(
        self,
        model: Measurement | Sequence[Measurement],
        z: npt.ArrayLike,
        sigma: npt.ArrayLike | None = None,
        *,
        R: npt.ArrayLike | None = None,
        outlier_probability: float = 0.0,
        outlier_density: float = 0.0,
    ) -> ParticleReport:
        """Weigh the particles by a measurement; they are neither moved nor resampled.

        Parameters
        ----------
        model : measurement model, or a sequence of them
        z : array_like, shape (m,), or float
            The rows of the models one behind the other.
        sigma : array_like, shape (m,), or float
            Standard deviations of independent rows.
        R : array_like, shape (m, m)
            Covariance, in place of `sigma`; at most 16 rows.
        outlier_probability, outlier_density : float
            Each measurement is an outlier with this probability, and then has this density (1 over the product of the
            units of its rows) wherever it falls; so a wild value rules no particle out.

        Raises
        ------
        ValueError
            For shapes that do not fit and models that the state lacks something for. Numbers that do not fit are
            reported, not raised.
        """
        observation = _observation(model, z, sigma, R, outlier_probability, outlier_density)
        return self._cloud.update([observation])

    def step(
        self,
        likelihood: Any,
        z: npt.ArrayLike | None = None,
        sigma: npt.ArrayLike | None = None,
        *,
        R: npt.ArrayLike | None = None,
        process: Any = None,
        dt_s: float = 1.0,
        input: npt.ArrayLike | None = None,
        noise: int | None = None,
        outlier_probability: float = 0.0,
        outlier_density: float = 0.0,
    ) -> ParticleReport:
        """One step of the filter: resample when that is due, move, weigh.

        Parameters
        ----------
        likelihood : measurement model, a sequence of them, or callable
            A callable gets all particles (N, n) and returns their log-likelihoods (N,); NaN counts as impossible. Its
            exceptions pass on, the filter as it was.
        z, sigma, R, outlier_probability, outlier_density
            As for `update`; not with a callable.
        process, dt_s, input, noise
            As for `predict`. Without a process nothing moves.
        """
        if not callable(likelihood):
            if z is None:
                raise ValueError("z: expected with a measurement model")
            observation = _observation(likelihood, z, sigma, R, outlier_probability, outlier_density)
            if process is None:
                return self._cloud.step(cast(Any, None), None, 0.0, [observation])
            return self._move(process, dt_s, input, noise, [observation])
        if z is not None or sigma is not None or R is not None:
            raise ValueError("z, sigma, R: not with a likelihood of your own")
        if process is None:
            x = self._cloud.next_particles()
            return self._weigh(likelihood(x), may_resample=True)
        before = self._cloud.save()
        moved = self._move(process, dt_s, input, noise, [])
        if not moved.accepted:
            return moved
        try:
            report = self._weigh(likelihood(self.particles), may_resample=False)
        except BaseException:
            self._cloud.restore(*before)
            raise
        return _estimation.joined_report(report, moved.resampled)

    def reweight(self, log_likelihood: npt.ArrayLike) -> ParticleReport:
        """Add log-likelihoods that were computed outside, one for each of `particles`.

        Parameters
        ----------
        log_likelihood : array_like, shape (N,)
            Up to a constant; -inf and NaN rule a particle out.
        """
        return self._weigh(log_likelihood, may_resample=False)

    def constrain(self, *, walls: npt.ArrayLike | None = None, inside: npt.ArrayLike | None = None) -> ParticleReport:
        """Set what no particle may do, for every step from now on, in place of what was set before.

        For a rule of your own, `reweight` with -inf where it is broken.

        Parameters
        ----------
        walls : array_like, shape (W, 2, 2), optional
            Ends of walls in the plane of the first two axes [m]: particles whose step crosses or touches one lose
            their weight.
        inside : array_like, shape (n, 2), optional
            Bounds of each component, infinite ones for none: particles outside lose their weight, at once and after
            each step.

        Returns
        -------
        ParticleReport
            Of applying `inside` at once; ``DEGENERATE`` when no particle is inside.
        """
        ends = None if walls is None else np.asarray(walls, np.float64)
        if ends is not None and (ends.ndim != 3 or ends.shape[1:] != (2, 2)):
            raise ValueError(f"walls: shape {ends.shape}, expected (W, 2, 2)")
        box = None if inside is None else np.asarray(inside, np.float64)
        n = len(self.component_names)
        if box is not None and box.shape != (n, 2):
            raise ValueError(f"inside: shape {box.shape}, expected ({n}, 2)")
        report = self._cloud.constrain(ends, box)
        self._settings = replace(self._settings, walls=ends, inside=box)
        return report

    def resample(self) -> None:
        """Resample now, whatever the effective sample size; weights are equal afterwards."""
        self._cloud.resample()

    def _weigh(self, log_likelihood: npt.ArrayLike, *, may_resample: bool) -> ParticleReport:
        values = np.asarray(log_likelihood, np.float64)
        if values.shape != (self.count,):
            raise ValueError(f"log_likelihood: shape {values.shape}, expected ({self.count},)")
        return self._cloud.reweight(values, may_resample)

    def _move(
        self,
        process: Any,
        dt_s: float,
        input: npt.ArrayLike | None,
        noise: int | None,
        observations: list[_Observation],
    ) -> ParticleReport:
        if callable(process):
            if input is not None:
                raise ValueError("input: not with a process of your own")
            x = self._cloud.next_particles()
            k = x.shape[1] if noise is None else _integer(noise, "noise", 0, 64)
            moved = np.asarray(process(x, self._cloud.next_noise(k)), np.float64)
            if moved.shape != x.shape:
                raise ValueError(f"process: returned shape {moved.shape}, expected {x.shape}")
            return self._cloud.step_to(moved, observations)
        if not isinstance(process, Process):
            raise ValueError(f"process: a process model or a callable expected, got {type(process).__name__}")
        driven = None if input is None else _vector(input, "input")
        return self._cloud.step(process, driven, float(dt_s), observations)

    # -- whole runs

    def run(
        self,
        time_s: npt.ArrayLike,
        process: Any = None,
        measurements: Measured | Sequence[Measured | tuple[Any, ...]] = (),
        *,
        start_s: float | None = None,
        inputs: npt.ArrayLike | None = None,
        covariance: bool = True,
    ) -> ParticleRun:
        """A step at each time, in one call.

        Parameters
        ----------
        time_s : array_like, shape (T,)
            Rising.
        process : process model, optional
            Without one nothing moves. The step to each time lasts since the one before.
        measurements : Measured, or a sequence of them
            A tuple (model, z, R) or (model, z, R, mask), as the Kalman filters take them, will do as well; there `R` of
            no or one axis are variances.
        start_s : float, optional
            Time of the particles as they are; without it they are those of the first time, and first weighed there.
        inputs : array_like, shape (T, k), optional
            What the process is driven with: row i carries the particles to time i.
        covariance : bool
            Whether to return covariances, which take time.

        Raises
        ------
        ValueError
            Naming the argument, for shapes that do not fit, times that do not rise and models that do not fit the
            state; the filter is then as it was.
        """
        times = _vector(time_s, "time_s")
        if callable(process):
            raise ValueError("process: a process model expected; a callable is for predict and step")
        if process is not None and not isinstance(process, Process):
            raise ValueError(f"process: a process model expected, got {type(process).__name__}")
        given = [measurements] if isinstance(measurements, Measured) else measurements
        groups = [_measured(group, f"measurements[{index}]") for index, group in enumerate(given)]
        series = [_series(group, len(times), f"measurements[{index}]") for index, group in enumerate(groups)]
        size = 0 if process is None else process.input_size
        driven = None if inputs is None else np.asarray(inputs, np.float64)
        if size or driven is not None:
            shape = None if driven is None else driven.shape
            if shape != (len(times), size):
                raise ValueError(f"inputs: shape {shape}, expected ({len(times)}, {size})")
        mean, P, ess, log_likelihood, status, resampled = self._cloud.run(
            times, start_s, cast(Any, process), driven, series, covariance
        )
        return ParticleRun(mean, P, ess, log_likelihood, status, resampled.astype(np.bool_))

    # -- keeping

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """All that changes, as arrays: for ``numpy.savez`` and `restore`."""
        particles, log_weights, log_likelihood, steps, restarts = self._cloud.save()
        return {
            "particles": particles,
            "log_weights": log_weights,
            "log_likelihood": np.array(log_likelihood),
            "steps": np.array(steps, np.uint64),
            "restarts": np.array(restarts, np.uint64),
        }

    def restore(self, saved: Mapping[str, npt.NDArray[Any]]) -> None:
        """Take over what another filter of the same settings gave from `save`; it goes on with the same bits."""
        missing = [
            name for name in ("particles", "log_weights", "log_likelihood", "steps", "restarts") if name not in saved
        ]
        if missing:
            raise ValueError(f"saved: no {', '.join(missing)}")
        n = len(self.component_names)
        if np.shape(saved["particles"]) != (self.count, n):
            raise ValueError(f"saved['particles']: shape {np.shape(saved['particles'])}, expected ({self.count}, {n})")
        self._cloud.restore(
            saved["particles"],
            saved["log_weights"],
            float(saved["log_likelihood"]),
            int(saved["steps"]),
            int(saved["restarts"]),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {"settings": self._settings, "saved": self.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._settings = state["settings"]
        self._cloud = self._make()
        if self._settings.walls is not None or self._settings.inside is not None:
            self._cloud.constrain(self._settings.walls, self._settings.inside)
        self.restore(state["saved"])
