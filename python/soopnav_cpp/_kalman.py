"""Kalman filters of any kind: stepwise, or a whole run in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from soopnav_cpp._adaptive_noise import AdaptiveProcessNoise
from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import KalmanReport, UpdateStatus
from soopnav_cpp._core.measurement import Measurement
from soopnav_cpp._core.process import Process

__all__ = [
    "ExtendedKalmanFilter",
    "InformationFilter",
    "IteratedKalmanFilter",
    "KalmanReport",
    "KalmanRun",
    "SquareRootKalmanFilter",
    "UnscentedKalmanFilter",
    "UpdateStatus",
]

_Array = npt.NDArray[np.float64]
_Self = TypeVar("_Self", bound="_KalmanFilter")

Models = Measurement | Sequence[Measurement]
"""A model, or several whose errors are correlated: their rows lie one behind the other."""


@dataclass(frozen=True, repr=False, eq=False)
class KalmanRun:
    """A filtered run of T steps, n components and g groups of measurements. The arrays are read-only.

    Attributes
    ----------
    x_pred, P_pred : ndarray, shapes (T, n) and (T, n, n)
        Before the updates of each step. None without a history.
    x, P : ndarray, shapes (T, n) and (T, n, n)
        After them; without a history of the last step alone, T = 1.
    nis : ndarray, shape (T, g)
        Normalised innovation squared; NaN where there was no measurement.
    status : ndarray of uint8, shape (T, g)
        An `UpdateStatus` for each measurement, ABSENT where there was none.
    predict_status : ndarray of uint8, shape (T,)
        ACCEPTED, or why the state stayed where it was: measurements of that step are then refused with the same, and
        the next step starts from the last time that was reached.
    log_likelihood : float
        Sum over the accepted measurements.
    x_smooth, P_smooth : ndarray, shapes (T, n) and (T, n, n)
        Given all measurements; None unless asked for.
    noise_multiplier : ndarray, shape (T,)
        Estimated factor on the process noise after each step; None without an `AdaptiveProcessNoise`.
    """

    x_pred: _Array | None
    P_pred: _Array | None
    x: _Array
    P: _Array
    nis: _Array
    status: npt.NDArray[np.uint8]
    predict_status: npt.NDArray[np.uint8]
    log_likelihood: float
    x_smooth: _Array | None
    P_smooth: _Array | None
    noise_multiplier: _Array | None = None

    def __repr__(self) -> str:
        parts = [f"{len(self.status)} steps", f"{self.x.shape[1]} components"]
        parts += _describe_run(self.status, self.predict_status)
        return f"KalmanRun({', '.join(parts)}, log-likelihood {self.log_likelihood:.6g})"


def _describe_run(status: npt.NDArray[np.uint8], predict_status: npt.NDArray[np.uint8] | None = None) -> list[str]:
    """How many measurements had which status, and how many steps were not made."""
    parts = []
    for value in UpdateStatus:
        count = int(np.count_nonzero(status == value))
        if count and value != UpdateStatus.ABSENT:
            parts.append(f"{count} {value.name.lower().replace('_', ' ')}")
    stuck = 0 if predict_status is None else int(np.count_nonzero(predict_status))
    return [*parts, f"{stuck} steps not predicted"] if stuck else parts


def _freeze(out: dict[str, Any]) -> dict[str, Any]:
    """The results of a run, arrays read-only."""
    for value in out.values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return out


def _flags(mask: npt.ArrayLike | None, name: str) -> npt.NDArray[np.uint8] | None:
    if mask is None:
        return None
    flags = np.asarray(mask)
    if flags.dtype != np.bool_:
        raise ValueError(f"{name}: expected bool, got {flags.dtype}")
    return np.ascontiguousarray(flags).view(np.uint8)


def _to_groups(measurements: Sequence[tuple[Any, ...]]) -> list[tuple[Any, Any, Any, Any]]:
    """Groups of measurements, each with a mask or None."""
    groups = []
    for index, entry in enumerate(measurements):
        name = f"measurements[{index}]"
        if not isinstance(entry, tuple) or len(entry) not in (3, 4):
            raise ValueError(f"{name}: expected (model, z, R) or (model, z, R, mask)")
        mask = _flags(entry[3], f"{name}: mask") if len(entry) == 4 else None
        groups.append((entry[0], entry[1], entry[2], mask))
    return groups


class _KalmanFilter:
    """What all kinds share."""

    _kind: ClassVar[str] = ""
    _core: _estimation.KalmanFilter

    def __init__(self, state: str, x0: npt.ArrayLike, P0: npt.ArrayLike) -> None:
        self._core = _estimation.KalmanFilter(self._kind, state, x0, P0)

    @property
    def state(self) -> str:
        """Name of the state."""
        return self._core.state

    @property
    def component_names(self) -> tuple[str, ...]:
        """What the components are called."""
        return tuple(self._core.component_names)

    @property
    def x(self) -> _Array:
        """Present state, shape (n,). Read-only, a copy."""
        return self._core.x

    @property
    def P(self) -> _Array:
        """Its covariance, shape (n, n). Read-only, a copy."""
        return self._core.P

    @property
    def covariance_floor_counts(self) -> tuple[int, ...]:
        """How often each variance was raised to its floor."""
        return tuple(self._core.covariance_floor_counts)

    def set_covariance_floor(self, variance: npt.ArrayLike) -> None:
        """Least variances that the filter may come to believe; resets the counters.

        Parameters
        ----------
        variance : array_like, shape (n,)
            Not negative; 0 for no floor.
        """
        self._core.set_covariance_floor(variance)

    def predict(
        self,
        process: Process | Callable[..., Any],
        dt_s: float,
        *,
        input: npt.ArrayLike | None = None,
        Q: npt.ArrayLike | None = None,
    ) -> UpdateStatus:
        """Move the state in time.

        Parameters
        ----------
        process : Process or callable
            A callable gets ``(x, dt_s)`` and returns ``(x_next, F)`` of shapes (n,) and (n, n). For an
            `UnscentedKalmanFilter` it gets all sigma points, shape (2 n + 1, n), and returns their images.
        dt_s : float
        input : array_like, shape (3,), optional
            For processes that are driven.
        Q : number or array_like, shape (n,) or (n, n), optional
            With a callable: covariance of its additive noise.

        Returns
        -------
        UpdateStatus
            All but ACCEPTED left the filter as it was: TIME_NOT_ADVANCING for a step that is not positive,
            NON_FINITE for NaN in the input or the result.

        Raises
        ------
        ValueError
            For shapes that do not fit, and a state that has not what the process moves.
        """
        return self._core.predict(process, dt_s, input, Q)

    def update(
        self,
        model: Models | Callable[..., Any],
        z: npt.ArrayLike,
        R: npt.ArrayLike,
        *,
        gate_nis: float | None = None,
        gate_residual: float | None = None,
        gate_residual_sigmas: float | None = None,
        angle_rows: Sequence[int] = (),
    ) -> KalmanReport:
        """Take a measurement in.

        Parameters
        ----------
        model : Measurement, list of Measurement, or callable
            Several models are one measurement with one R. A callable gets x and returns ``(h, H)`` of shapes (m,) and
            (m, n). For an `UnscentedKalmanFilter` it gets all sigma points, shape (2 n + 1, n), and returns their
            values, shape (2 n + 1, m).
        z : float or array_like, shape (m,)
            m is at most 16.
        R : number or array_like, shape (m,) or (m, m)
            Variance, variances or covariance.
        gate_nis : float, optional
            Refuse when the normalised innovation squared is larger.
        gate_residual : float, optional
            Refuse when a component of the innovation is larger ...
        gate_residual_sigmas : float, optional
            ... and larger than so many of its standard deviations.
        angle_rows : sequence of int
            Rows of a callable whose residuals go the short way round.

        Returns
        -------
        KalmanReport
            With `status`, `accepted`, `innovation`, `covariance`, `nis`, `log_likelihood`. All but ACCEPTED left the
            filter as it was: NON_FINITE for NaN, NOT_POSITIVE_DEFINITE for R, GATED, UNDEFINED where the model is.

        Raises
        ------
        ValueError
            For shapes that do not fit, and a state that has not what the model reads. An exception of a callable
            passes on. The filter is as it was.
        """
        return self._core.update(
            model,
            z,
            R,
            gate_nis=gate_nis,
            gate_residual=gate_residual,
            gate_residual_sigmas=gate_residual_sigmas,
            angle_rows=list(angle_rows),
        )

    def run(
        self,
        time_s: npt.ArrayLike,
        process: Process,
        measurements: Sequence[tuple[Any, ...]] = (),
        *,
        inputs: npt.ArrayLike | None = None,
        start_s: float | None = None,
        gate_nis: float | None = None,
        gate_residual: float | None = None,
        gate_residual_sigmas: float | None = None,
        smooth: bool = False,
        history: bool = True,
        adaptive_noise: AdaptiveProcessNoise | None = None,
    ) -> KalmanRun:
        """Filter a whole run in one call; the same bits as step by step. The filter ends where the run does.

        Parameters
        ----------
        time_s : array_like, shape (T,)
            Rising. The filter's state is that of ``time_s[0]``, or of `start_s`.
        process : Process
        measurements : sequence of (model, z, R) or (model, z, R, mask)
            Taken in in this order at each step. `model` as for `update`, but no callable; `z` of shape (T, m), or (T,)
            for m = 1; `R` as for `update`, or of shape (T, m, m); `mask` of bool, shape (T,), false where there is no
            measurement. Without a mask NaN is refused, with a status.
        inputs : array_like, shape (T, 3), optional
            For processes that are driven: the input at k carries the state from time k-1 to k.
        start_s : float, optional
            Time of the filter's state, before ``time_s[0]``.
        gate_nis, gate_residual, gate_residual_sigmas : float, optional
            As for `update`.
        smooth : bool
            Smooth as well (Rauch-Tung-Striebel).
        history : bool
            Keep x and P of every step; otherwise of the last.
        adaptive_noise : AdaptiveProcessNoise, optional
            Scales the noise of `process` from step to step and learns from every innovation; ends where the run does.

        Returns
        -------
        KalmanRun

        Raises
        ------
        ValueError
            Naming the argument, and the index where time does not rise. The filter is as it was.
        """
        if adaptive_noise is not None and not isinstance(adaptive_noise, AdaptiveProcessNoise):
            raise TypeError(f"adaptive_noise: expected AdaptiveProcessNoise, got {type(adaptive_noise).__name__}")
        out = self._core.run(
            np.asarray(time_s, np.float64),
            process,
            _to_groups(measurements),
            inputs=inputs,
            start_s=start_s,
            gate_nis=gate_nis,
            gate_residual=gate_residual,
            gate_residual_sigmas=gate_residual_sigmas,
            smooth=smooth,
            history=history,
            adaptive_noise=None if adaptive_noise is None else adaptive_noise._core,
        )
        if not history:
            out["x"], out["P"] = self.x[np.newaxis].copy(), self.P[np.newaxis].copy()
        _freeze(out)
        return KalmanRun(
            x_pred=out.get("x_pred"),
            P_pred=out.get("P_pred"),
            x=out["x"],
            P=out["P"],
            nis=out["nis"],
            status=out["status"],
            predict_status=out["predict_status"],
            log_likelihood=out["log_likelihood"],
            x_smooth=out.get("x_smooth"),
            P_smooth=out.get("P_smooth"),
            noise_multiplier=out.get("noise_multiplier"),
        )

    def copy(self: _Self) -> _Self:
        """An independent filter that goes on alike."""
        other = type(self).__new__(type(self))
        other._core = self._core.clone()
        return other

    def __copy__(self: _Self) -> _Self:
        return self.copy()

    def __deepcopy__(self: _Self, memo: dict[int, Any]) -> _Self:
        return self.copy()

    def __getstate__(self) -> _estimation.KalmanFilter:
        return self._core.clone()

    def __setstate__(self, saved: _estimation.KalmanFilter) -> None:
        self._core = saved.clone()

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{name} {value:.4g} ± {sigma:.2g}"
            for name, value, sigma in zip(self.component_names, self.x, np.sqrt(np.diagonal(self.P)), strict=True)
        )
        return f"{type(self).__name__}({self.state}: {parts})"


class ExtendedKalmanFilter(_KalmanFilter):
    """Extended Kalman filter: linearised at the present state, Joseph's covariance update.

    Parameters
    ----------
    state : str
        "position", "position_velocity", "position_clock", "position_velocity_clock" with the number of dimensions
        behind ("position2"; it may be left out where the length of `x0` tells), "position_velocity_bias2"
        [x y vx vy b], "planar_inertial" [heading vx vy x y], "pose2" [x y heading], "coordinated_turn"
        [x y vx vy turn_rate], or "custom": 1 to 8 plain numbers, for models that are callables.
    x0 : array_like, shape (n,)
    P0 : number or array_like, shape (n,) or (n, n)
        Its variance, variances or covariance.

    Raises
    ------
    ValueError
        For an unknown state, and an `x0` or `P0` that is not finite, not symmetric or not positive semi-definite.
    """

    _kind = "extended"


class IteratedKalmanFilter(_KalmanFilter):
    """Iterated extended Kalman filter: each update is the maximum of the posterior, by Gauss-Newton steps.

    Parameters
    ----------
    state, x0, P0
        As for `ExtendedKalmanFilter`.
    max_iterations : int
        Steps of an update, at least 1.
    tolerance : float
        An update has converged when no component moves more than this many prior standard deviations.
    """

    _kind = "iterated"

    def __init__(
        self,
        state: str,
        x0: npt.ArrayLike,
        P0: npt.ArrayLike,
        *,
        max_iterations: int = 10,
        tolerance: float = 1e-6,
    ) -> None:
        self._core = _estimation.KalmanFilter(self._kind, state, x0, P0, [float(max_iterations), tolerance])


class UnscentedKalmanFilter(_KalmanFilter):
    """Unscented Kalman filter: models are evaluated at sigma points, never differentiated.

    Parameters
    ----------
    state, x0, P0
        As for `ExtendedKalmanFilter`.
    alpha, beta, kappa : float
        Spread of the points and weight of the middle one; the default is the spherical cubature rule.
        ``alpha**2 * (n + kappa)`` must be positive.
    """

    _kind = "unscented"

    def __init__(
        self,
        state: str,
        x0: npt.ArrayLike,
        P0: npt.ArrayLike,
        *,
        alpha: float = 1.0,
        beta: float = 0.0,
        kappa: float = 0.0,
    ) -> None:
        self._core = _estimation.KalmanFilter(self._kind, state, x0, P0, [alpha, beta, kappa])


class SquareRootKalmanFilter(_KalmanFilter):
    """Extended Kalman filter that carries a triangular root of its covariance: for badly conditioned systems.

    Parameters
    ----------
    state, x0, P0
        As for `ExtendedKalmanFilter`.
    """

    _kind = "square_root"


class InformationFilter(_KalmanFilter):
    """Extended Kalman filter that carries the inverse of its covariance, so that it may start without a prior.

    A component that nothing has determined has an infinite variance in `P`.

    Parameters
    ----------
    state, x0
        As for `ExtendedKalmanFilter`. In directions without information `x0` is the point of linearisation.
    P0 : number or array_like, shape (n,) or (n, n), optional
        Positive definite.
    information : number or array_like, shape (n,) or (n, n), optional
        Instead of `P0`: its inverse, positive semi-definite; 0.0 for no prior.
    """

    _kind = "information"

    def __init__(
        self,
        state: str,
        x0: npt.ArrayLike,
        P0: npt.ArrayLike | None = None,
        *,
        information: npt.ArrayLike | None = None,
    ) -> None:
        if (P0 is None) == (information is None):
            raise ValueError("P0: give it or information, one of the two")
        matrix = information if P0 is None else P0
        assert matrix is not None
        self._core = _estimation.KalmanFilter(self._kind, state, x0, matrix, [], P0 is None)


KINDS: dict[str, type[_KalmanFilter]] = {
    kind._kind: kind
    for kind in (
        ExtendedKalmanFilter,
        InformationFilter,
        IteratedKalmanFilter,
        SquareRootKalmanFilter,
        UnscentedKalmanFilter,
    )
}
"""The kinds by the engine's names."""
