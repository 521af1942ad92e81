"""Late measurements: a Kalman filter that goes back and does again what came after them."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation
from soopnav_cpp._core.estimation import KalmanReport, UpdateStatus
from soopnav_cpp._core.process import Process
from soopnav_cpp._kalman import KINDS, Models, _describe_run, _freeze, _KalmanFilter

__all__ = ["FixedLagFilter", "FixedLagRun"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False, eq=False)
class FixedLagRun:
    """A run of E arrivals, in the order in which they came in. The arrays are read-only.

    Attributes
    ----------
    arrival_s : ndarray, shape (E,)
        When each came in, rising.
    measured_s : ndarray, shape (E,)
        The time it is of.
    group, row : ndarray of int64, shape (E,)
        Which of the measurements it is: of which group, -1 for an input, and which row of it.
    time_s : ndarray, shape (E,)
        The time of the estimate after it: that of the newest event.
    x, P : ndarray, shapes (E, n) and (E, n, n)
        The estimate after it; without a history of the last arrival alone, E = 1.
    nis : ndarray, shape (E,)
        Normalised innovation squared where the measurement belongs; NaN for inputs and what was refused before.
    status : ndarray of uint8, shape (E,)
        An `UpdateStatus`; TOO_LATE for what is older than all that is kept.
    """

    arrival_s: _Array
    measured_s: _Array
    group: npt.NDArray[np.int64]
    row: npt.NDArray[np.int64]
    time_s: _Array
    x: _Array
    P: _Array
    nis: _Array
    status: npt.NDArray[np.uint8]

    def __repr__(self) -> str:
        parts = [f"{len(self.status)} arrivals", f"{self.x.shape[1]} components", *_describe_run(self.status)]
        return f"FixedLagRun({', '.join(parts)})"


class FixedLagFilter:
    """A Kalman filter with late measurements: one that comes in after younger ones is put where it belongs, and what
    came after it is done again (cpp/doc/kalman_filter.md, 10).

    The filter at any time is that of the events in order of their times, those of one time in order of arrival, to the
    bit the same as if they had come in so. A measurement that the filter refuses (gated, undefined) is an event
    nevertheless, and is judged anew when an older one comes in; one refused for itself (NaN, R not positive definite,
    too late) changes nothing.

    Parameters
    ----------
    filter : ExtendedKalmanFilter or another kind
        Is copied.
    process : Process
        Moves the state between events.
    start_s : float
        Time of the filter's state.
    capacity : int
        Events kept (measurements and inputs), at least 1. A late event costs a prediction and an update for each event
        after it.
    input : array_like, shape (3,), optional
        For a process that is driven: in force until the first input comes; zero without.

    Raises
    ------
    ValueError
        For a state that has not what the process moves, and numbers that break their rule.
    """

    _core: _estimation.FixedLagFilter

    def __init__(
        self,
        filter: _KalmanFilter,
        process: Process,
        *,
        start_s: float = 0.0,
        capacity: int = 100,
        input: npt.ArrayLike | None = None,
    ) -> None:
        if not isinstance(filter, _KalmanFilter):
            raise TypeError(f"filter: expected a Kalman filter, got {type(filter).__name__}")
        if not isinstance(process, Process):
            raise TypeError(f"process: expected a process model, got {type(process).__name__}")
        try:
            events = operator.index(capacity)
        except TypeError:
            raise ValueError(f"capacity: {capacity!r}; a whole number expected") from None
        self._core = _estimation.FixedLagFilter(filter._core, process, start_s, events, input)

    @property
    def filter(self) -> _KalmanFilter:
        """The filter after all events, a copy."""
        kind = KINDS[self._core.kind]
        copied = kind.__new__(kind)
        copied._core = self._core.filter
        return copied

    @property
    def process(self) -> Process:
        """Moves the state between events."""
        return self._core.process

    @property
    def x(self) -> _Array:
        """State after all events, shape (n,). Read-only, a copy."""
        return self._core.x

    @property
    def P(self) -> _Array:
        """Its covariance, shape (n, n). Read-only, a copy."""
        return self._core.P

    @property
    def time_s(self) -> float:
        """When `x` is."""
        return self._core.time_s

    @property
    def oldest_time_s(self) -> float:
        """What is older is too late."""
        return self._core.oldest_time_s

    @property
    def size(self) -> int:
        """Events kept."""
        return self._core.size

    @property
    def capacity(self) -> int:
        """Events kept at most."""
        return self._core.capacity

    def advance(self, time_s: float, *, input: npt.ArrayLike | None = None) -> UpdateStatus:
        """Move the state in time, under the input in force.

        Parameters
        ----------
        time_s : float
            After all events; with an input after all inputs, so that an input may be late among measurements.
        input : array_like, shape (3,), optional
            In force from `time_s` to the next input.

        Returns
        -------
        UpdateStatus
            TIME_NOT_ADVANCING, TOO_LATE, NON_FINITE: nothing changed.

        Raises
        ------
        ValueError
            For an input that does not fit the process.
        """
        return self._core.advance(time_s, input)

    def update(
        self,
        model: Models,
        z: npt.ArrayLike,
        R: npt.ArrayLike,
        time_s: float,
        *,
        gate_nis: float | None = None,
        gate_residual: float | None = None,
        gate_residual_sigmas: float | None = None,
    ) -> KalmanReport:
        """Take a measurement of `time_s` in, late or not.

        Parameters
        ----------
        model, z, R, gate_nis, gate_residual, gate_residual_sigmas
            As for `ExtendedKalmanFilter.update`, but no callable.
        time_s : float

        Returns
        -------
        KalmanReport
            Of the measurement where it belongs, before younger ones were taken in again. TOO_LATE, NON_FINITE,
            NOT_POSITIVE_DEFINITE: nothing changed. GATED, UNDEFINED: the state has moved to `time_s` and it is kept.

        Raises
        ------
        ValueError
            For shapes that do not fit, and a state that has not what the model reads. The filter is as it was.
        """
        return self._core.update(
            model,
            z,
            R,
            time_s,
            gate_nis=gate_nis,
            gate_residual=gate_residual,
            gate_residual_sigmas=gate_residual_sigmas,
        )

    def run(
        self,
        measurements: Sequence[tuple[Any, ...]],
        *,
        inputs: npt.ArrayLike | None = None,
        input_time_s: npt.ArrayLike | None = None,
        gate_nis: float | None = None,
        gate_residual: float | None = None,
        gate_residual_sigmas: float | None = None,
        history: bool = True,
    ) -> FixedLagRun:
        """A whole run in one call: everything is taken in in order of its arrival; the same bits as step by step.

        Of one arrival time inputs come first, then measurements in the order of their groups and rows.

        Parameters
        ----------
        measurements : sequence of (model, z, R, time_s) or (model, z, R, time_s, arrival_s)
            `model` as for `update`; `z` of shape (T, m), or (T,) for m = 1; `R` as for `update`, or of shape (T, m, m);
            `time_s` of shape (T,), in any order; `arrival_s` of shape (T,), never before `time_s`, which it is without.
            Each group has a T of its own.
        inputs : array_like, shape (U, 3), optional
            For a process that is driven.
        input_time_s : array_like, shape (U,), optional
            From when each input holds, which is when it comes in.
        gate_nis, gate_residual, gate_residual_sigmas : float, optional
            As for `ExtendedKalmanFilter.update`.
        history : bool
            Keep x and P after every arrival; otherwise after the last.

        Returns
        -------
        FixedLagRun

        Raises
        ------
        ValueError
            Naming the argument, and the index of a time that is not finite. The filter is as it was.
        """
        groups = []
        for index, entry in enumerate(measurements):
            if not isinstance(entry, tuple) or len(entry) not in (4, 5):
                raise ValueError(
                    f"measurements[{index}]: expected (model, z, R, time_s) or (model, z, R, time_s, arrival_s)"
                )
            groups.append(entry if len(entry) == 5 else (*entry, entry[3]))
        out = self._core.run(
            groups,
            inputs=inputs,
            input_time_s=input_time_s,
            gate_nis=gate_nis,
            gate_residual=gate_residual,
            gate_residual_sigmas=gate_residual_sigmas,
            history=history,
        )
        if not history:
            out["x"], out["P"] = self.x[np.newaxis].copy(), self.P[np.newaxis].copy()
        return FixedLagRun(**_freeze(out))

    def smooth(self) -> tuple[_Array, _Array, _Array]:
        """Smooth over the events kept (Rauch-Tung-Striebel).

        Returns
        -------
        time_s : ndarray, shape (size,)
            Of the state after each event, in order.
        x, P : ndarray, shapes (size, n) and (size, n, n)
            Given all events; the first are the output of a fixed-lag smoother.

        Raises
        ------
        ValueError
            When a covariance among them is not finite.
        """
        time_s, x, P = self._core.smooth()
        return time_s, x, P

    def copy(self) -> FixedLagFilter:
        """An independent filter that goes on alike."""
        other = type(self).__new__(type(self))
        other._core = self._core.clone()
        return other

    def __copy__(self) -> FixedLagFilter:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> FixedLagFilter:
        return self.copy()

    def __getstate__(self) -> _estimation.FixedLagFilter:
        return self._core.clone()

    def __setstate__(self, saved: _estimation.FixedLagFilter) -> None:
        self._core = saved.clone()

    def __repr__(self) -> str:
        kept = f"{self.size} of {self.capacity} events since {self.oldest_time_s:.6g} s"
        return f"FixedLagFilter({self.filter!r} at {self.time_s:.6g} s, {kept})"
