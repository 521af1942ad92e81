"""Whole runs of linear Gaussian systems: Kalman filter and Rauch-Tung-Striebel smoother."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import StepStatus

__all__ = ["LinearFilterResult", "StepStatus", "linear_filter", "rts_smooth"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False, eq=False)
class LinearFilterResult:
    """A filtered run of T steps, n states and m measured components. The arrays are read-only.

    Attributes
    ----------
    x_pred, P_pred : ndarray, shapes (T, n) and (T, n, n)
        State and covariance before the update of each step.
    x, P : ndarray, shapes (T, n) and (T, n, n)
        After it. Covariances are symmetric to the bit.
    nis : ndarray, shape (T,)
        Normalised innovation squared, over the components that were there; NaN without any.
    log_likelihood : float
        Of the whole run; NaN if a step was refused.
    innovation : ndarray, shape (T, m)
        ``z - H x_pred``; NaN where a component was missing.
    S : ndarray, shape (T, m, m)
        Covariance of the innovation; NaN likewise.
    step_log_likelihood : ndarray, shape (T,)
        Logarithm of the density of each measurement given those before; 0 without one.
    status : ndarray of uint8, shape (T,)
        A `StepStatus` for each step: ``result.status == StepStatus.UPDATED``.
    """

    x_pred: _Array
    P_pred: _Array
    x: _Array
    P: _Array
    nis: _Array
    log_likelihood: float
    innovation: _Array
    S: _Array
    step_log_likelihood: _Array
    status: npt.NDArray[np.uint8]

    def __repr__(self) -> str:
        steps, n = self.x.shape
        counts = [(int(np.count_nonzero(self.status == s)), s.name.lower().replace("_", " ")) for s in StepStatus]
        parts = [f"{steps} steps", f"{n} states", f"{self.innovation.shape[1]} measured"]
        parts += [f"{count} {name}" for count, name in counts if count]
        if np.any(self.status == StepStatus.UPDATED):
            expected = np.count_nonzero(~np.isnan(self.innovation), axis=1)[self.status == StepStatus.UPDATED].mean()
            parts.append(f"mean NIS {np.nanmean(self.nis):.3g} (expected {expected:.3g})")
        return f"LinearFilterResult({', '.join(parts)}, log-likelihood {self.log_likelihood:.6g})"


def _matrix(value: npt.ArrayLike) -> npt.ArrayLike:
    """A number stands for a matrix of one element."""
    return np.reshape(value, (1, 1)) if np.ndim(value) == 0 else value


def linear_filter(
    F: npt.ArrayLike,
    Q: npt.ArrayLike,
    H: npt.ArrayLike,
    R: npt.ArrayLike,
    z: npt.ArrayLike,
    x0: npt.ArrayLike,
    P0: npt.ArrayLike,
    *,
    B: npt.ArrayLike | None = None,
    u: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
) -> LinearFilterResult:
    """Kalman filter over a whole run of a linear Gaussian system.

    ``x[k] = F x[k-1] + B u[k] + w``, ``z[k] = H x[k] + v`` with ``w ~ N(0, Q)`` and ``v ~ N(0, R)``. Each matrix is one
    for all steps, or one for each step along a first axis of length T. Joseph's covariance update in its rank form.

    Parameters
    ----------
    F, Q : array_like, shape (n, n) or (T, n, n)
        Transition into step k, and covariance of its noise (positive semi-definite).
    H : array_like, shape (m, n) or (T, m, n)
    R : array_like, shape (m, m) or (T, m, m)
        Positive definite. For n = 1 or m = 1 a number will do for a matrix.
    z : array_like, shape (T, m), or (T,) for m = 1
    x0, P0 : array_like, shapes (n,) and (n, n)
        Before the first prediction.
    B : array_like, shape (n, p) or (T, n, p), optional
    u : array_like, shape (T, p), or (T,) for p = 1, optional
        Known inputs.
    mask : array_like of bool, shape (T, m) or (T,), optional
        False where a component of `z` (or the whole of it) is missing; what stands there is not read. Without a mask
        every number must be finite.

    Returns
    -------
    LinearFilterResult

    Raises
    ------
    ValueError
        Naming the parameter: for shapes that do not fit, numbers that are not finite, a covariance that is not
        symmetric or not positive (semi-)definite.
    """
    H = _matrix(H)
    z = np.asarray(z, np.float64)
    if z.ndim == 1 and np.ndim(H) >= 2 and np.shape(H)[-2] == 1:
        z = z[:, np.newaxis]
    if B is not None:
        B = _matrix(B)
    if u is not None and np.ndim(u) == 1:
        u = np.asarray(u, np.float64)[:, np.newaxis]
    present: npt.NDArray[np.uint8] | None = None
    if mask is not None:
        flags = np.asarray(mask)
        if flags.dtype != np.bool_:
            raise ValueError(f"mask: expected bool, got {flags.dtype}")
        if flags.ndim == 1 and z.ndim == 2 and len(flags) == len(z):
            flags = np.repeat(flags[:, np.newaxis], z.shape[1], axis=1)
        if flags.shape != z.shape:
            raise ValueError(f"mask: shape {flags.shape}, expected {z.shape} or {z.shape[:1]}")
        present = np.ascontiguousarray(flags).view(np.uint8)
    x_pred, P_pred, x, P, innovation, S, nis, step_log_likelihood, status, log_likelihood = _estimation.linear_filter(
        _matrix(F), _matrix(Q), H, _matrix(R), z, np.atleast_1d(x0), _matrix(P0), B=B, u=u, mask=present
    )
    return LinearFilterResult(x_pred, P_pred, x, P, nis, log_likelihood, innovation, S, step_log_likelihood, status)


def rts_smooth(
    F: npt.ArrayLike, x_pred: npt.ArrayLike, P_pred: npt.ArrayLike, x: npt.ArrayLike, P: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Rauch-Tung-Striebel smoother over what `linear_filter` (or any other Kalman filter) returned.

    Parameters
    ----------
    F : array_like, shape (n, n) or (T, n, n)
        Transition into each step, as for `linear_filter`; the first of T is not used.
    x_pred, P_pred : array_like, shapes (T, n) and (T, n, n)
        State and covariance before the update of each step.
    x, P : array_like, shapes (T, n) and (T, n, n)
        After it.

    Returns
    -------
    x, P : ndarray, shapes (T, n) and (T, n, n)
        Given all measurements. The last step is the filter's; covariances are symmetric to the bit. A component that
        the filter knew exactly (no variance) is left as it was.

    Raises
    ------
    ValueError
        Naming the parameter: for shapes that do not fit, numbers that are not finite, a covariance that is not
        symmetric.
    """
    x_smooth, P_smooth = _estimation.rts_smooth(_matrix(F), x_pred, P_pred, x, P)
    return x_smooth, P_smooth
