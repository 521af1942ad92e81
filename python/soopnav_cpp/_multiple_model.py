"""Interacting multiple models: a Kalman filter for each of several motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import KalmanReport, UpdateStatus
from soopnav_cpp._core.process import Process
from soopnav_cpp._kalman import Models, _describe_run, _freeze, _to_groups

__all__ = ["InteractingMultipleModel", "MultipleModelRun"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False, eq=False)
class MultipleModelRun:
    """A run of T steps, n components, M modes and g groups of measurements. The arrays are read-only.

    Attributes
    ----------
    x, P : ndarray, shapes (T, n) and (T, n, n)
        Mean and covariance of the mixture after each step; without a history of the last step alone, T = 1.
    predicted_probabilities, probabilities : ndarray, shape (T, M)
        Of the modes, before and after the updates of each step; rows sum to one.
    nis : ndarray, shape (T, g)
        Normalised innovation squared of the mixture as predicted; NaN where there was no measurement.
    status : ndarray of uint8, shape (T, g)
        An `UpdateStatus` for each measurement, ABSENT where there was none.
    predict_status : ndarray of uint8, shape (T,)
        ACCEPTED, or why the state stayed where it was, as for `KalmanRun`.
    log_likelihood : float
        Of the mixture, sum over the accepted measurements.
    """

    x: _Array
    P: _Array
    predicted_probabilities: _Array
    probabilities: _Array
    nis: _Array
    status: npt.NDArray[np.uint8]
    predict_status: npt.NDArray[np.uint8]
    log_likelihood: float

    def __repr__(self) -> str:
        parts = [f"{len(self.status)} steps", f"{self.probabilities.shape[1]} modes", f"{self.x.shape[1]} components"]
        parts += _describe_run(self.status, self.predict_status)
        return f"MultipleModelRun({', '.join(parts)}, log-likelihood {self.log_likelihood:.6g})"


class InteractingMultipleModel:
    """Interacting multiple model estimator: an extended Kalman filter per process model, among which a Markov chain
    switches (Blom and Bar-Shalom 1988; cpp/doc/multiple_model.md).

    Each prediction first mixes the modes' estimates by the chain, then moves each by its own process; each update
    weighs the modes by the likelihood of their innovation. An observation or step that any mode refuses is refused.

    Parameters
    ----------
    state, x0, P0
        As for `ExtendedKalmanFilter`; all modes start there.
    processes : sequence of Process
        One for each mode, 1 to 6; driven ones take the same input.
    transition : array_like, shape (M, M)
        ``transition[i, j]``: probability that mode i is followed by mode j. The chain makes one step per prediction,
        however long. Rows sum to one.
    probabilities : array_like, shape (M,), optional
        Of the modes at the start; all alike without.

    Raises
    ------
    ValueError
        Naming what is no probability, the row of `transition` that does not sum to one, a process that does not fit
        the state.
    """

    _core: _estimation.InteractingMultipleModel

    def __init__(
        self,
        state: str,
        x0: npt.ArrayLike,
        P0: npt.ArrayLike,
        processes: Sequence[Process],
        transition: npt.ArrayLike,
        *,
        probabilities: npt.ArrayLike | None = None,
    ) -> None:
        modes = list(processes)
        for index, process in enumerate(modes):
            if not isinstance(process, Process):
                raise TypeError(f"processes[{index}]: expected a process model, got {type(process).__name__}")
        start = np.full(len(modes), 1.0 / max(len(modes), 1)) if probabilities is None else probabilities
        self._core = _estimation.InteractingMultipleModel(state, x0, P0, modes, transition, start)

    @property
    def state(self) -> str:
        """Name of the state."""
        return self._core.state

    @property
    def component_names(self) -> tuple[str, ...]:
        """What the components are called."""
        return tuple(self._core.component_names)

    @property
    def processes(self) -> tuple[Process, ...]:
        """One for each mode."""
        return tuple(self._core.processes)

    @property
    def transition(self) -> _Array:
        """Probabilities of the chain, shape (M, M). Read-only."""
        return self._core.transition

    @property
    def x(self) -> _Array:
        """Mean of the mixture, shape (n,). Read-only, a copy."""
        return self._core.x

    @property
    def P(self) -> _Array:
        """Covariance of the mixture, shape (n, n): the modes' own and their spread. Read-only, a copy."""
        return self._core.P

    @property
    def probabilities(self) -> _Array:
        """Of the modes, shape (M,). Read-only, a copy."""
        return self._core.probabilities

    @property
    def mode_x(self) -> _Array:
        """Estimates of the modes, shape (M, n). Read-only, a copy."""
        return self._core.mode_x

    @property
    def mode_P(self) -> _Array:
        """Their covariances, shape (M, n, n). Read-only, a copy."""
        return self._core.mode_P

    @property
    def covariance_floor_counts(self) -> tuple[tuple[int, ...], ...]:
        """For each mode, how often each variance was raised to its floor."""
        return tuple(self._core.covariance_floor_counts)

    def set_covariance_floor(self, variance: npt.ArrayLike) -> None:
        """Least variances that the modes may come to believe; resets the counters.

        Parameters
        ----------
        variance : array_like, shape (n,)
            Not negative; 0 for no floor.
        """
        self._core.set_covariance_floor(variance)

    def predict(self, dt_s: float, *, input: npt.ArrayLike | None = None) -> UpdateStatus:
        """Mix the modes and move each by its process: one step of the chain.

        Parameters
        ----------
        dt_s : float
        input : array_like, shape (3,), optional
            For processes that are driven.

        Returns
        -------
        UpdateStatus
            All but ACCEPTED left the estimator as it was: TIME_NOT_ADVANCING for a step that is not positive,
            NON_FINITE for NaN in the input or the result.

        Raises
        ------
        ValueError
            For an input that does not fit.
        """
        return self._core.predict(dt_s, input)

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
        model, z, R, gate_nis, gate_residual, gate_residual_sigmas, angle_rows
            As for `ExtendedKalmanFilter.update`. The gate sees the mixture as predicted.

        Returns
        -------
        KalmanReport
            Innovation, covariance and NIS are those of the mixture; `log_likelihood` is that of its density, NaN unless
            accepted. All but ACCEPTED left the estimator as it was.

        Raises
        ------
        ValueError
            For shapes that do not fit, and a state that has not what the model reads. An exception of a callable
            passes on. The estimator is as it was.
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
        measurements: Sequence[tuple[Any, ...]] = (),
        *,
        inputs: npt.ArrayLike | None = None,
        start_s: float | None = None,
        gate_nis: float | None = None,
        gate_residual: float | None = None,
        gate_residual_sigmas: float | None = None,
        history: bool = True,
    ) -> MultipleModelRun:
        """A whole run in one call; the same bits as step by step. The estimator ends where the run does.

        Parameters
        ----------
        time_s : array_like, shape (T,)
            Rising. The estimator's state is that of ``time_s[0]``, or of `start_s`.
        measurements, inputs, start_s, gate_nis, gate_residual, gate_residual_sigmas, history
            As for `ExtendedKalmanFilter.run`.

        Returns
        -------
        MultipleModelRun

        Raises
        ------
        ValueError
            Naming the argument, and the index where time does not rise. The estimator is as it was.
        """
        out = self._core.run(
            np.asarray(time_s, np.float64),
            _to_groups(measurements),
            inputs=inputs,
            start_s=start_s,
            gate_nis=gate_nis,
            gate_residual=gate_residual,
            gate_residual_sigmas=gate_residual_sigmas,
            history=history,
        )
        if not history:
            out["x"], out["P"] = self.x[np.newaxis].copy(), self.P[np.newaxis].copy()
        return MultipleModelRun(**_freeze(out))

    def copy(self) -> InteractingMultipleModel:
        """An independent estimator that goes on alike."""
        other = type(self).__new__(type(self))
        other._core = self._core.clone()
        return other

    def __copy__(self) -> InteractingMultipleModel:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> InteractingMultipleModel:
        return self.copy()

    def __getstate__(self) -> _estimation.InteractingMultipleModel:
        return self._core.clone()

    def __setstate__(self, saved: _estimation.InteractingMultipleModel) -> None:
        self._core = saved.clone()

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{name} {value:.4g} ± {sigma:.2g}"
            for name, value, sigma in zip(self.component_names, self.x, np.sqrt(np.diagonal(self.P)), strict=True)
        )
        modes = ", ".join(
            f"{process.kind} {probability:.3f}"
            for process, probability in zip(self.processes, self.probabilities, strict=True)
        )
        return f"InteractingMultipleModel({self.state}: {parts}; {modes})"
