"""Bounds and consistency: what data can tell at best, and whether a filter's errors are what it says they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation

__all__ = [
    "Crlb",
    "PosteriorCrlb",
    "coverage",
    "coverage_bounds",
    "crlb",
    "crlb_map",
    "marginal_information",
    "mean_nees_bounds",
    "nees",
    "observability",
    "posterior_crlb",
    "rmse",
    "sample_circular_error_m",
]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Crlb:
    """Least covariance of an unbiased estimate, and what no estimate can know. Read-only.

    Attributes
    ----------
    names : tuple of str
        Of the n parameters.
    rank : int
        Directions that the data determine.
    information : ndarray, shape (n, n)
        Fisher information: the inverse of `covariance` at full rank.
    covariance : ndarray, shape (n, n)
        The bound. Below full rank the variance of a parameter with a part in an unobservable direction is infinite and
        its covariances are NaN; the others are finite.
    sigma : ndarray, shape (n,)
        Roots of the diagonal of `covariance`.
    singular_values : ndarray, shape (n,)
        Of the whitened Jacobian with columns of length one, largest first: what the rank is read from.
    unobservable : tuple of str
        The directions that the data leave free, in words: ``"b"``, or ``"0.71 x - 0.71 b"`` for a combination. With
        parameters of different units the weights are per unit of each.
    unobservable_basis : ndarray, shape (n, n - rank)
        The same as orthonormal columns.
    """

    names: tuple[str, ...]
    rank: int
    information: Array
    covariance: Array
    sigma: Array
    singular_values: Array
    unobservable: tuple[str, ...]
    unobservable_basis: Array

    def sigma_of(self, *names: str) -> float:
        """Root of the summed variances of the named parameters; of those of a position, its distance error.

        From a `crlb` with ``R = 1`` this is a dilution of precision: PDOP of the position, GDOP of everything.

        Raises
        ------
        ValueError
            For no name, or one that is not a parameter's.
        """
        if not names:
            raise ValueError(f"names: at least one of {', '.join(self.names)} expected")
        for name in names:
            if name not in self.names:
                raise ValueError(f"names: no parameter {name!r}; there are {', '.join(self.names)}")
        return math.sqrt(sum(float(self.sigma[self.names.index(name)]) ** 2 for name in names))

    def __repr__(self) -> str:
        deviations = ", ".join(f"{name} {sigma:.4g}" for name, sigma in zip(self.names, self.sigma, strict=True))
        free = f"; cannot see: {', '.join(self.unobservable)}" if self.unobservable else ""
        return f"Crlb(rank {self.rank} of {len(self.names)}; sigma: {deviations}{free})"


@dataclass(frozen=True, eq=False)
class PosteriorCrlb:
    """Least covariance with which any filter can know the state of each step. Read-only.

    Attributes
    ----------
    P : ndarray, shape (T, n, n)
        With the measurements up to and including each step.
    P_pred : ndarray, shape (T, n, n)
        Before those of the step itself.
    """

    P: Array
    P_pred: Array

    @property
    def sigma(self) -> Array:
        """Standard deviations after each step, shape (T, n)."""
        return np.asarray(np.sqrt(np.diagonal(self.P, axis1=1, axis2=2)))

    def __repr__(self) -> str:
        last = ", ".join(f"{value:.4g}" for value in self.sigma[-1])
        return f"PosteriorCrlb({len(self.P)} steps; sigma at the end: {last})"


def _matrix(value: npt.ArrayLike, name: str, columns: int | None = None) -> Array:
    matrix = np.asarray(value, dtype=np.float64)
    if matrix.ndim != 2 or (columns is not None and matrix.shape[1] != columns):
        wanted = "(rows, columns)" if columns is None else f"(rows, {columns})"
        raise ValueError(f"{name}: expected numbers with shape {wanted}, got {matrix.shape}")
    return matrix


def _noise(R: npt.ArrayLike, rows: int) -> Array:
    """A variance, variances or a covariance as the engine takes them."""
    noise = np.asarray(R, dtype=np.float64)
    if noise.ndim == 0:
        return noise.reshape(1, 1)
    if noise.ndim == 1 and len(noise) == rows:
        return np.diag(noise) if rows == 1 else noise[:, None]
    if noise.ndim != 2:
        raise ValueError(
            f"R: shape {noise.shape}; a number, ({rows},) or ({rows}, {rows}) expected for {rows} rows of H"
        )
    return noise


def _names(names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"x{i}" for i in range(count))
    if len(names) != count or len(set(names)) != count:
        raise ValueError(f"names: {count} different ones expected, one for each column of H, got {list(names)}")
    return tuple(names)


def crlb(
    H: npt.ArrayLike,
    R: npt.ArrayLike,
    *,
    prior_information: npt.ArrayLike | None = None,
    names: Sequence[str] | None = None,
    tolerance: float = _estimation.RANK_TOLERANCE,
) -> Crlb:
    """Cramér-Rao bound of the parameters x of ``z = h(x) + noise``.

    Parameters
    ----------
    H : array_like, shape (m, n)
        Jacobian of h at the truth, in units of z per unit of x.
    R : array_like, scalar, shape (m,), (m, m) or (b, b)
        Covariance of the noise: one variance for all rows, one for each, the full matrix, or a block of it that repeats
        for each b rows. Units of z squared.
    prior_information : array_like, shape (n, n), optional
        Inverse of a prior covariance, zero where nothing is known.
    names : sequence of str, optional
        Of the n parameters; x0, x1, ... without.
    tolerance : float
        Singular values of the whitened Jacobian, its columns scaled to length one, below this fraction of the largest
        count as zero.

    Returns
    -------
    Crlb

    Raises
    ------
    ValueError
        For shapes that do not fit, numbers that are not finite, and an R that is not symmetric and positive definite.
    """
    jacobian = _matrix(H, "H")
    labels = _names(names, jacobian.shape[1])
    noise = _noise(R, jacobian.shape[0])
    rank, information, covariance, sigma, singular_values, basis, free = _estimation.crlb(
        jacobian, noise, prior_information, list(labels), tolerance
    )
    return Crlb(labels, rank, information, covariance, sigma, singular_values, tuple(free), basis)


def crlb_map(
    H: npt.ArrayLike, R: npt.ArrayLike, *, tolerance: float = _estimation.RANK_TOLERANCE
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Standard deviations of the same parameters in many geometries.

    Parameters
    ----------
    H : array_like, shape (..., m, n)
        A Jacobian for each geometry.
    R : array_like, scalar, shape (m,), (m, m) or (b, b)
        Covariance of the noise, the same in all, as for `crlb`.
    tolerance : float
        As for `crlb`.

    Returns
    -------
    sigma : ndarray, shape (..., n)
        Infinite where a parameter cannot be told from others; NaN where the Jacobian is not finite.
    rank : ndarray, shape (...)
        0 where the Jacobian is not finite.

    Raises
    ------
    ValueError
        As for `crlb`.
    """
    jacobians = np.asarray(H, dtype=np.float64)
    if jacobians.ndim < 2 or jacobians.size == 0:
        raise ValueError(f"H: expected numbers with shape (..., m, n), got {jacobians.shape}")
    m, n = jacobians.shape[-2:]
    count = jacobians.size // (m * n)
    sigma, rank = _estimation.crlb_series(jacobians.reshape(-1, n), count, _noise(R, m), tolerance)
    return sigma.reshape(*jacobians.shape[:-2], n), rank.reshape(jacobians.shape[:-2])


def observability(
    H: npt.ArrayLike,
    F: npt.ArrayLike | None = None,
    *,
    R: npt.ArrayLike = 1.0,
    steps: int | None = None,
    names: Sequence[str] | None = None,
    tolerance: float = _estimation.RANK_TOLERANCE,
) -> Crlb:
    """What a sequence of measurements says about the state at its start, the transitions being known and noiseless.

    Stacks ``H_0, H_1 F_0, H_2 F_1 F_0, ...`` and reads rank, free directions and bound from it.

    Parameters
    ----------
    H : array_like, shape (m, n) or (T, m, n)
        Jacobian of the measurements of each time, one for all or one for each.
    F : array_like, shape (n, n) or (T - 1, n, n), optional
        Transition from each time to the next; a longer series is read as far as needed. The identity without.
    R : array_like, scalar, shape (m,) or (m, m)
        Covariance of the noise of one time.
    steps : int, optional
        T, needed when neither H nor F varies; n is enough to see all that can be seen.
    names, tolerance
        As for `crlb`.

    Returns
    -------
    Crlb
        Of the state at the start.

    Raises
    ------
    ValueError
        As for `crlb`, and when the number of steps is not known or does not fit.
    """
    jacobian = np.asarray(H, dtype=np.float64)
    if jacobian.ndim not in (2, 3):
        raise ValueError(f"H: expected shape (m, n) or (T, m, n), got {jacobian.shape}")
    rows, n = jacobian.shape[-2:]
    transition = np.eye(n) if F is None else np.asarray(F, dtype=np.float64)
    if transition.ndim not in (2, 3) or transition.shape[-2:] != (n, n):
        raise ValueError(f"F: expected shape ({n}, {n}) or (T - 1, {n}, {n}), got {transition.shape}")
    varying = len(jacobian) if jacobian.ndim == 3 else len(transition) + 1 if transition.ndim == 3 else None
    count = steps if steps is not None else varying
    if count is None:
        raise ValueError("steps: needed when neither H nor F varies")
    if count < 1 or (jacobian.ndim == 3 and len(jacobian) != count):
        raise ValueError(f"steps: {count} do not fit the {len(jacobian)} matrices of H")
    if transition.ndim == 3 and len(transition) < count - 1:
        raise ValueError(f"F: {len(transition)} matrices; at least {count - 1} expected between {count} times")
    if transition.ndim == 3 and count == 1:
        transition = np.eye(n)
    stack = _estimation.observability_matrix(transition.reshape(-1, n), jacobian.reshape(-1, n), rows, count)
    noise = _noise(R, rows)
    if noise.shape == (rows, 1):
        noise = np.tile(noise, (count, 1))
    return crlb(stack, noise, names=names, tolerance=tolerance)


def posterior_crlb(
    F: npt.ArrayLike,
    Q: npt.ArrayLike,
    H: npt.ArrayLike,
    R: npt.ArrayLike,
    P0: npt.ArrayLike,
    *,
    steps: int | None = None,
) -> PosteriorCrlb:
    """Posterior Cramér-Rao bound of a filter, step by step (Tichavský, Muravchik and Nehorai 1998).

    For a linear system it is the Kalman filter's covariance. For a nonlinear one, F and H are Jacobians at the *true*
    states: of one trajectory (T, ...), or of S trajectories (T, S, ...), over which the information is averaged; the
    average is the bound itself.

    Parameters
    ----------
    F : array_like, shape (n, n), (T, n, n) or (T, S, n, n)
        Transition into each step.
    Q : array_like, shape (n, n) or (T, n, n)
        Covariance of the process noise; may be singular for one trajectory, positive definite for several.
    H : array_like, shape (m, n), (T, m, n) or (T, S, m, n)
        Jacobian of each step's measurements.
    R : array_like, scalar, shape (m, m) or (T, m, m)
        Covariance of their noise.
    P0 : array_like, shape (n, n)
        Covariance of the state before the first step, which begins with a prediction.
    steps : int, optional
        T, needed when nothing varies.

    Returns
    -------
    PosteriorCrlb

    Raises
    ------
    ValueError
        For shapes that do not fit, matrices that are no covariances, numbers that are not finite, and a step that
        leaves the covariance singular.
    """
    start = _matrix(P0, "P0")
    n = len(start)
    if start.shape != (n, n):
        raise ValueError(f"P0: a square matrix expected, got shape {start.shape}")
    jacobian = np.asarray(H, dtype=np.float64)
    if jacobian.ndim not in (2, 3, 4) or jacobian.shape[-1] != n:
        raise ValueError(f"H: expected shape (m, {n}), (T, m, {n}) or (T, S, m, {n}), got {jacobian.shape}")
    m = jacobian.shape[-2]
    noise = np.asarray(R, dtype=np.float64)
    if noise.ndim == 0:
        noise = float(noise) * np.eye(m)
    parts = {
        "F": (np.asarray(F, dtype=np.float64), (n, n), 4),
        "Q": (np.asarray(Q, dtype=np.float64), (n, n), 3),
        "H": (jacobian, (m, n), 4),
        "R": (noise, (m, m), 3),
    }
    count, samples = steps, 1
    for name, (array, shape, most) in parts.items():
        if not 2 <= array.ndim <= most or array.shape[-2:] != shape:
            raise ValueError(f"{name}: expected matrices of shape {shape}, got an array of shape {array.shape}")
        if array.ndim > 2:
            count = len(array) if count is None else count
            if len(array) != count:
                raise ValueError(f"{name}: {len(array)} steps; {count} expected")
        if array.ndim == 4:
            if samples not in (1, array.shape[1]):
                raise ValueError(f"{name}: {array.shape[1]} trajectories; {samples} expected")
            samples = array.shape[1]
    if count is None:
        raise ValueError("steps: needed when no matrix varies")
    if count < 1 or samples < 1:
        raise ValueError(f"steps: {count} steps of {samples} trajectories; at least 1 expected")
    tables = {}
    for name, (array, shape, _) in parts.items():
        table = array
        if name in ("F", "H") and samples > 1:
            if table.ndim == 3:
                table = table[:, None]
            table = np.broadcast_to(table, (*table.shape[:-3], samples, *shape))
        tables[name] = np.ascontiguousarray(table).reshape(-1, shape[1])
    P, P_pred = _estimation.posterior_crlb(tables["F"], tables["Q"], tables["H"], tables["R"], start, count, samples, m)
    return PosteriorCrlb(P, P_pred)


def marginal_information(information: npt.ArrayLike, kept: Sequence[int]) -> Array:
    """Information about some parameters when the others are unknown as well: the Schur complement.

    Parameters
    ----------
    information : array_like, shape (n, n)
        Of all parameters; symmetric and positive semidefinite.
    kept : sequence of int
        Indices of the parameters wanted, each once.

    Returns
    -------
    ndarray, shape (len(kept), len(kept))

    Raises
    ------
    ValueError
        For a matrix that is no information, and indices that do not fit.
    """
    return _estimation.marginal_information(information, [int(index) for index in kept])


def _covariances(errors: Array, P: npt.ArrayLike) -> Array:
    count, n = errors.shape
    covariance = np.asarray(P, dtype=np.float64)
    if covariance.shape == (n, n):
        covariance = np.broadcast_to(covariance, (count, n, n))
    if covariance.shape != (count, n, n):
        raise ValueError(f"P: expected shape ({count}, {n}, {n}) or ({n}, {n}), got {covariance.shape}")
    return covariance.reshape(-1, n)


def nees(errors: npt.ArrayLike, P: npt.ArrayLike) -> Array:
    """Normalised estimation error squared, eᵀ P⁻¹ e, of each row. Of innovations and their covariances: NIS.

    Parameters
    ----------
    errors : array_like, shape (T, n)
        Estimates minus truth, angles the short way round.
    P : array_like, shape (T, n, n) or (n, n)
        The covariances that the filter stated.

    Returns
    -------
    ndarray, shape (T,)
        NaN where a number is not finite or P not positive definite.

    Raises
    ------
    ValueError
        For shapes that do not fit.
    """
    rows = _matrix(errors, "errors")
    return _estimation.nees_series(rows, _covariances(rows, P))


def mean_nees_bounds(dof: float, runs: int, *, failure_probability: float = 1e-4) -> tuple[float, float]:
    """Between which the mean of `runs` independent NEES (or NIS) values of a consistent filter lies.

    Parameters
    ----------
    dof : float
        Degrees of freedom of each value: components of the error.
    runs : int
        Independent values; those of one run at many times are not.
    failure_probability : float
        That a consistent filter leaves the bounds, half on each side.

    Raises
    ------
    ValueError
        For numbers out of range.
    """
    return _estimation.mean_nees_bounds(dof, runs, failure_probability)


def coverage(errors: npt.ArrayLike, P: npt.ArrayLike, *, probability: float) -> float:
    """Share of the errors inside the region that the stated covariance gives `probability`.

    Parameters
    ----------
    errors : array_like, shape (T, n)
    P : array_like, shape (T, n, n) or (n, n)
    probability : float
        Between 0 and 1; 0.683 of one component means one standard deviation.

    Raises
    ------
    ValueError
        For shapes that do not fit and a probability out of range.
    """
    rows = _matrix(errors, "errors")
    return _estimation.coverage(rows, _covariances(rows, P), probability)


def coverage_bounds(probability: float, runs: int, *, failure_probability: float = 1e-4) -> tuple[float, float]:
    """Between which, inclusive, the share of `runs` independent trials lies that succeed with `probability` each.

    Parameters
    ----------
    probability : float
    runs : int
    failure_probability : float
        That the share leaves the bounds, at most half on each side: from the binomial distribution itself.

    Raises
    ------
    ValueError
        For numbers out of range.
    """
    return _estimation.coverage_bounds(probability, runs, failure_probability)


def rmse(errors: npt.ArrayLike) -> Array:
    """Root mean square of each component.

    Parameters
    ----------
    errors : array_like, shape (T, n)

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    ValueError
        Without a row or a column.
    """
    return _estimation.rmse(_matrix(errors, "errors"))


def sample_circular_error_m(errors_m: npt.ArrayLike, *, probability: float = 0.5) -> float:
    """Radius of the circle that holds `probability` of the errors themselves: circular error probable for 0.5.

    `circular_error_m` is its counterpart from a covariance.

    Parameters
    ----------
    errors_m : array_like, shape (T, 2)
    probability : float

    Raises
    ------
    ValueError
        For shapes that do not fit and a probability out of range.
    """
    return _estimation.sample_circular_error_m(_matrix(errors_m, "errors_m", 2), probability)
