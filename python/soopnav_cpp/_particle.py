"""Particle filters: clouds of weighted states, for any likelihood and any noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import ParticleCloud, ParticleReport, ParticleStatus, Resampling
from soopnav_cpp._core.measurement import Measurement
from soopnav_cpp._core.process import Process
from soopnav_cpp._particle_data import (
    AdaptiveCount,
    Array,
    Gaussian,
    Measured,
    Observation,
    ParticleRun,
    Prior,
    Samples,
    Uniform,
    check_saved,
    core_adaptive,
    core_prior,
    integer,
    measured_of,
    observation_of,
    one_of,
    series_of,
    vector,
)

__all__ = [
    "AdaptiveCount",
    "Gaussian",
    "Measured",
    "ParticleFilter",
    "ParticleReport",
    "ParticleRun",
    "ParticleStatus",
    "Samples",
    "Uniform",
]

Likelihood: TypeAlias = Callable[[Array], npt.ArrayLike]
"""Log-likelihoods (N,) of particles (N, n)."""
Transition: TypeAlias = Callable[[Array, Array], npt.ArrayLike]
"""Next particles (N, n) from particles (N, n) and standard normals (N, k)."""


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
    auxiliary: bool = False
    regularisation: float = 0.0
    adaptive: AdaptiveCount | None = None
    marginalized_clock: bool = False
    walls: Array | None = None
    inside: Array | None = None


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
    auxiliary : bool
        Look at the measurement before resampling (Pitt and Shephard): for measurements much sharper than the cloud and
        process noise no wider than they are. For process models, not callables.
    regularisation : float
        Width of the kernel that copies are spread with after resampling, 0 … 2; 1 is best for a normal density. Mean
        and covariance are kept. For process noise too small to part the copies.
    adaptive : AdaptiveCount, optional
        Let the number of particles follow their spread; `count` is then the most, and the first. Not with `auxiliary`.
    marginalized_clock : bool
        Rao-Blackwellised: clock bias and drift have a Kalman filter for each particle instead of being sampled, so the
        rest needs far fewer particles. For Gaussian priors whose clock is not correlated with the rest, process models
        and measurements without outliers, at most 16 rows at a time; `particles` then holds the clock's means.

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
        auxiliary: bool = False,
        regularisation: float = 0.0,
        adaptive: AdaptiveCount | None = None,
        marginalized_clock: bool = False,
    ) -> None:
        names = tuple(state) if state is not None and not isinstance(state, str) else state
        self._settings = _Settings(
            integer(count, "count", 1, 2**31 - 1),
            prior,
            names,
            integer(seed, "seed", 0, 2**64 - 1),
            integer(threads, "threads", 1, 256),
            one_of(resampling, "resampling", tuple(_RESAMPLING)),
            float(ess_threshold),
            one_of(precision, "precision", ("double", "float")),
            one_of(recovery, "recovery", ("keep", "restart")),
            bool(auxiliary),
            float(regularisation),
            adaptive,
            bool(marginalized_clock),
        )
        self._cloud = self._make()

    def _make(self) -> ParticleCloud:
        s = self._settings
        prior, size = core_prior(s.prior)
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
            auxiliary=s.auxiliary,
            regularisation=s.regularisation,
            adaptive=core_adaptive(s.adaptive),
            marginalized_clock=s.marginalized_clock,
        )

    # -- reading

    @property
    def count(self) -> int:
        """N, particles there are; the number asked for, unless it is adaptive."""
        return int(self._cloud.count)

    @property
    def state(self) -> str:
        """Name of the state: ``"position2"``, …; ``"custom"`` for plain components."""
        return str(self._cloud.state)

    @property
    def component_names(self) -> list[str]:
        """What the n components are called."""
        return list(self._cloud.component_names)

    @property
    def mean(self) -> Array:
        """Weighted mean, shape (n,); of a heading, the direction of the mean direction."""
        return self._cloud.mean

    @property
    def covariance(self) -> Array:
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
    def particles(self) -> Array:
        """The particles, shape (N, n): a copy. They count by their `weights`."""
        return self._cloud.particles

    @property
    def weights(self) -> Array:
        """Normalised weights, shape (N,): a copy."""
        return self._cloud.weights

    @property
    def storage_bytes(self) -> int:
        """Memory of the engine that grows with the number of particles."""
        return int(self._cloud.storage_bytes)

    def histogram(
        self, component: int | str, bins: int = 50, range: tuple[float, float] | None = None
    ) -> tuple[Array, Array]:
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
        index = integer(component, "component", 0, len(names) - 1)
        count = integer(bins, "bins", 1, 10**7)
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
        parts = [f"{self.count} particles", self.state, f"ess {self.ess:.4g}", f"seed {s.seed}"]
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
        observation = observation_of(model, z, sigma, R, outlier_probability, outlier_density)
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
            observation = observation_of(likelihood, z, sigma, R, outlier_probability, outlier_density)
            if process is None:
                return self._cloud.step(None, None, 0.0, [observation])
            return self._move(process, dt_s, input, noise, [observation])
        if z is not None or sigma is not None or R is not None:
            raise ValueError("z, sigma, R: not with a likelihood of your own")
        if process is None:
            return self._resampled_first(lambda x: self._weigh(likelihood(x), may_resample=True))
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
            their weight. The ends of a wall differ.
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
        for index, (a, b) in enumerate(() if ends is None else ends):
            if np.array_equal(a, b):
                raise ValueError(f"walls[{index}]: both ends are {a.tolist()}; they must differ")
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

    def _resampled_first(
        self, call: Callable[[Array], ParticleReport], observations: Sequence[Observation] = ()
    ) -> ParticleReport:
        """`call` with the particles as a step begins with them; the filter as it was when that raises or refuses."""
        s = self._settings
        if s.regularisation == 0.0 and s.adaptive is None:
            return call(self._cloud.next_particles())  # looked at before they are resampled
        before = self._cloud.save()
        alike = self.ess == self.count
        try:
            x = self._cloud.next_particles()
            resampled = not alike and self.ess == self.count
            report = call(x)
        except BaseException:
            self._cloud.restore(*before)
            raise
        if report.status not in (ParticleStatus.ACCEPTED, ParticleStatus.DEGENERATE):
            self._cloud.restore(*before)
            return self._cloud.update(list(observations))  # refused again, with the effective sample size that stays
        return _estimation.joined_report(report, resampled)

    def _move(
        self,
        process: Any,
        dt_s: float,
        input: npt.ArrayLike | None,
        noise: int | None,
        observations: list[Observation],
    ) -> ParticleReport:
        if callable(process):
            if input is not None:
                raise ValueError("input: not with a process of your own")

            def step_to(x: Array) -> ParticleReport:
                k = x.shape[1] if noise is None else integer(noise, "noise", 0, 64)
                moved = np.asarray(process(x, self._cloud.next_noise(k)), np.float64)
                if moved.shape != x.shape:
                    raise ValueError(f"process: returned shape {moved.shape}, expected {x.shape}")
                return self._cloud.step_to(moved, observations)

            return self._resampled_first(step_to, observations)
        if not isinstance(process, Process):
            raise ValueError(f"process: a process model or a callable expected, got {type(process).__name__}")
        driven = None if input is None else vector(input, "input")
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
        times = vector(time_s, "time_s")
        if callable(process):
            raise ValueError("process: a process model expected; a callable is for predict and step")
        if process is not None and not isinstance(process, Process):
            raise ValueError(f"process: a process model expected, got {type(process).__name__}")
        given = [measurements] if isinstance(measurements, Measured) else measurements
        groups = [measured_of(group, f"measurements[{index}]") for index, group in enumerate(given)]
        series = [series_of(group, len(times), f"measurements[{index}]") for index, group in enumerate(groups)]
        size = 0 if process is None else process.input_size
        driven = None if inputs is None else np.asarray(inputs, np.float64)
        if size or driven is not None:
            shape = None if driven is None else driven.shape
            if shape != (len(times), size):
                raise ValueError(f"inputs: shape {shape}, expected ({len(times)}, {size})")
        mean, P, ess, log_likelihood, status, resampled, count = self._cloud.run(
            times, start_s, process, driven, series, covariance
        )
        return ParticleRun(mean, P, ess, log_likelihood, status, resampled.astype(np.bool_), count)

    # -- keeping

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """All that changes, as arrays: for ``numpy.savez`` and `restore`."""
        particles, log_weights, log_likelihood, steps, restarts, clock_covariance = self._cloud.save()
        return {
            "particles": particles,
            "log_weights": log_weights,
            "log_likelihood": np.array(log_likelihood),
            "steps": np.array(steps, np.uint64),
            "restarts": np.array(restarts, np.uint64),
            "clock_covariance": clock_covariance,
        }

    def restore(self, saved: Mapping[str, npt.NDArray[Any]]) -> None:
        """Take over what another filter of the same settings gave from `save`; it goes on with the same bits."""
        most = self._settings.count
        check_saved(saved, len(self.component_names), 1 if self._settings.adaptive else most, most)
        self._cloud.restore(
            saved["particles"],
            saved["log_weights"],
            float(saved["log_likelihood"]),
            int(saved["steps"]),
            int(saved["restarts"]),
            saved["clock_covariance"],
        )

    def __getstate__(self) -> dict[str, Any]:
        return {"settings": self._settings, "saved": self.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._settings = state["settings"]
        self._cloud = self._make()
        if self._settings.walls is not None or self._settings.inside is not None:
            self._cloud.constrain(self._settings.walls, self._settings.inside)
        self.restore(state["saved"])
