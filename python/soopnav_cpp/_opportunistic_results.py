"""What an opportunistic navigator answers: reports, runs, smoothed runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.navigation import ObservableUse

__all__ = ["OpportunisticReport", "OpportunisticRun", "OpportunisticSmoothed", "OpportunisticSourceState"]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0


@dataclass(frozen=True)
class OpportunisticReport:
    """What a step did.

    Attributes
    ----------
    status : str
        "accepted"; or why nothing changed: "time not advancing", "not finite".
    uses : tuple of ObservableUse
        What became of each observation, in their order.
    innovations, sigmas, w : ndarray
        Of each: z - h at the prediction and its standard deviation [cycles or m], and the residual against all others,
        standard normal when all is well. NaN where there is none.
    accepted, rejected, slips, source_jumps : int
    receiver_jump : bool
    nis : float
        Of the `dof` observables tested together, after the remedies.
    dof : int
    """

    status: str
    uses: tuple[ObservableUse, ...]
    innovations: _Array
    sigmas: _Array
    w: _Array
    accepted: int
    rejected: int
    slips: int
    source_jumps: int
    receiver_jump: bool
    nis: float
    dof: int

    @property
    def coasted(self) -> bool:
        """Nothing was used: the state was only predicted."""
        return self.accepted == 0


@dataclass(frozen=True)
class OpportunisticSourceState:
    """What is known of a source that is present. What is not estimated has its known value and zero covariance.

    Attributes
    ----------
    name : str
    kind : str
    suspended : bool
        Not listened to: it contradicted its model too often.
    slip_rate : float
        Share of recent epochs in which it did, 0 ... 1.
    slips, jumps : int
        Ambiguities and clocks opened again since it joined.
    clock_bias_s, clock_drift : float
        Source minus system time, and its rate.
    clock_covariance : ndarray, shape (2, 2)
        Of bias [s] and drift.
    ambiguity_cycles, ambiguity_sigma_cycles : float
    position_e_m : ndarray, shape (3,)
        NaN for a source on an orbit.
    position_covariance_m2 : ndarray, shape (3, 3)
    """

    name: str
    kind: str
    suspended: bool
    slip_rate: float
    slips: int
    jumps: int
    clock_bias_s: float
    clock_drift: float
    clock_covariance: _Array
    ambiguity_cycles: float
    ambiguity_sigma_cycles: float
    position_e_m: _Array
    position_covariance_m2: _Array


class _Components:
    """Names of a state's components, and series of them in the units of the interface."""

    def __init__(self, names: Sequence[str], mean: _Array, sigma: _Array) -> None:
        self.names = tuple(names)
        self.mean = mean
        self.sigma = sigma
        self._at = {name: i for i, name in enumerate(self.names)}

    def column(self, name: str) -> int:
        """Number of a component. ValueError for a name that none has."""
        if name not in self._at:
            raise ValueError(f"name = {name!r}: one of {', '.join(map(repr, self.names))} expected")
        return self._at[name]

    def _columns(self, prefix: str, quantity: str) -> list[int]:
        return [self.column(f"{prefix}{quantity} {axis}") for axis in "xyz"]

    @property
    def position_e_m(self) -> _Array:
        """Receiver, ECEF, shape (n, 3). ValueError when it is not estimated."""
        return self.mean[:, self._columns("", "position")]

    @property
    def velocity_e_mps(self) -> _Array:
        """Receiver, ECEF, shape (n, 3). ValueError when it is not estimated."""
        return self.mean[:, self._columns("", "velocity")]

    @property
    def clock_bias_s(self) -> _Array:
        """Receiver minus system time, shape (n,)."""
        return self.mean[:, self.column("clock bias")] / _LIGHT_MPS

    @property
    def clock_bias_sigma_s(self) -> _Array:
        """Its standard deviation, shape (n,)."""
        return self.sigma[:, self.column("clock bias")] / _LIGHT_MPS

    @property
    def clock_drift(self) -> _Array:
        """Its rate, dimensionless, shape (n,)."""
        return self.mean[:, self.column("clock drift")] / _LIGHT_MPS

    @property
    def clock_drift_sigma(self) -> _Array:
        """Its standard deviation, shape (n,)."""
        return self.sigma[:, self.column("clock drift")] / _LIGHT_MPS

    def source_clock_bias_s(self, name: str) -> _Array:
        """Estimated clock of a source minus system time, shape (n,); NaN where it was not present."""
        return self.mean[:, self.column(f"{name} clock bias")] / _LIGHT_MPS

    def source_clock_drift(self, name: str) -> _Array:
        """Its rate, shape (n,)."""
        return self.mean[:, self.column(f"{name} clock drift")] / _LIGHT_MPS

    def ambiguity_cycles(self, name: str) -> _Array:
        """Ambiguity of a source, shape (n,)."""
        return self.mean[:, self.column(f"{name} ambiguity")]

    def source_position_e_m(self, name: str) -> _Array:
        """Estimated position of a source, shape (n, 3)."""
        return self.mean[:, self._columns(f"{name} ", "position")]


class OpportunisticRun(_Components):
    """What `OpportunisticNavigator.run` did: the filter's estimates and what became of each observable.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    names : tuple of str
        Components of `mean` and `sigma`: "position x" ..., "clock drift", "clock bias", "<source> clock bias",
        "<source> ambiguity" ... in metres, m/s and cycles.
    mean, sigma : ndarray, shape (n, dim)
        After each epoch's update.
    covariance : ndarray, shape (n, dim, dim), or None
    phase_use, pseudorange_use : ndarray of uint8, shape (n, s)
        `ObservableUse` by value.
    phase_innovation_cycles, pseudorange_innovation_m : ndarray, shape (n, s)
    nis, dof : ndarray, shape (n,)
    receiver_jump : ndarray of bool, shape (n,)
    status : ndarray of uint8, shape (n,)
        0 where the epoch was processed.
    """

    def __init__(self, t_s: _Array, names: Sequence[str], result: Mapping[str, Any]) -> None:
        super().__init__(names, result["mean"], result["sigma"])
        self.t_s = t_s
        self.covariance: _Array | None = result["covariance"]
        self.phase_use: npt.NDArray[np.uint8] = result["phase_use"]
        self.pseudorange_use: npt.NDArray[np.uint8] = result["pseudorange_use"]
        self.phase_innovation_cycles: _Array = result["phase_innovation_cycles"]
        self.pseudorange_innovation_m: _Array = result["pseudorange_innovation_m"]
        self.nis: _Array = result["nis"]
        self.dof: npt.NDArray[np.int32] = result["dof"]
        self.receiver_jump: npt.NDArray[np.bool_] = result["receiver_jump"]
        self.status: npt.NDArray[np.uint8] = result["status"]

    @property
    def slips(self) -> int:
        """Ambiguities opened again, all sources."""
        return int(np.sum(self.phase_use == ObservableUse.SLIP.value))

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        return f"OpportunisticRun({len(self)} epochs, {len(self.names)} components, {self.slips} slips)"


class OpportunisticSmoothed(_Components):
    """A recorded run given all its observables: `mean` and `sigma` (n, components), NaN where one was not present.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    names : tuple of str
        All components that were ever present.
    sources : tuple of int
        The source that each belongs to; -1: the receiver.
    """

    def __init__(self, smoother: Any) -> None:
        super().__init__(smoother.names, smoother.mean(), smoother.sigma())
        self._smoother = smoother
        self.t_s: _Array = smoother.t_s()
        self.sources: tuple[int, ...] = tuple(smoother.sources)

    def covariance(self, *names: str) -> _Array:
        """Covariance of some components, shape (n, k, k), in metres, m/s and cycles."""
        return self._smoother.covariance([self.column(name) for name in names])  # type: ignore[no-any-return]

    @property
    def clock_covariance(self) -> _Array:
        """Of the receiver's clock bias [s] and drift, shape (n, 2, 2)."""
        return self.covariance("clock bias", "clock drift") / _LIGHT_MPS**2

    @property
    def position_covariance_m2(self) -> _Array:
        """Of the receiver's position, shape (n, 3, 3)."""
        return self.covariance(*(f"position {axis}" for axis in "xyz"))

    def lag_covariance(self, name: str, max_lag: int) -> _Array:
        """cov(e_k, e_k+m) of a component's errors, m = 0 ... max_lag epochs, shape (n, max_lag + 1), NaN past the end.

        The smoother's gains make it, G_k ... G_k+m-1 P_k+m; needs ``smooth(gains=True)``. Squares of metres, m/s or
        cycles. O(n max_lag dim²).
        """
        return self._smoother.lag_covariance(self.column(name), max_lag)  # type: ignore[no-any-return]

    def clock_lag_covariance_s2(self, max_lag: int) -> _Array:
        """The same of the receiver's clock bias [s²]."""
        return self.lag_covariance("clock bias", max_lag) / _LIGHT_MPS**2

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        return f"OpportunisticSmoothed({len(self)} epochs, {len(self.names)} components)"
