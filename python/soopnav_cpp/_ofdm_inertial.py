"""Inertial navigation in a plane, aided by OFDM block boundaries (crosby)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.estimation import UpdateStatus

__all__ = [
    "ImuCounts",
    "LinkReport",
    "OfdmInertialNavigator",
    "OfdmInertialRun",
    "PlanarImu",
    "PlanarStart",
    "RangeChanges",
]

_Array = npt.NDArray[np.float64]
Timing = Callable[[int, int, int, float, float], tuple[float, float]]
REFERENCE = -1


@dataclass(frozen=True)
class PlanarStart:
    """What is known of a receiver when a run starts; zero spreads mean known.

    Attributes
    ----------
    heading_rad : float
        From the first axis towards the second.
    velocity_mps, position_m : tuple of two float
    heading_sigma_rad, velocity_sigma_mps, position_sigma_m : float
        Standard deviations (of each component).
    """

    heading_rad: float = 0.0
    velocity_mps: tuple[float, float] = (0.0, 0.0)
    position_m: tuple[float, float] = (0.0, 0.0)
    heading_sigma_rad: float = 0.0
    velocity_sigma_mps: float = 0.0
    position_sigma_m: float = 0.0


class PlanarImu(Protocol):
    """Samples of a planar inertial measurement unit, each measured over the interval that ends at its time."""

    @property
    def t_s(self) -> _Array:
        """Times, shape (N,)."""

    @property
    def yaw_rate_radps(self) -> _Array:
        """Shape (N,)."""

    @property
    def specific_force_b_mps2(self) -> _Array:
        """Forward and left, shape (N, 2)."""


@dataclass(frozen=True)
class RangeChanges:
    """Block boundaries of K transmitters at E epochs, as how much farther than at the start each transmitter is.

    Attributes
    ----------
    t_s : ndarray, shape (E,)
    range_change_m : ndarray, shape (E, K)
        Modulo the length of a symbol; NaN where there was none. c times crosby's TDOA (2.6), minus its ΔR (3.5).
    sigma_m : float or ndarray, shape (E, K)
    """

    t_s: _Array
    range_change_m: _Array
    sigma_m: float | _Array = field(default=1.0)


@dataclass(frozen=True)
class ImuCounts:
    """What became of the inertial samples: `used`; `not_after` the one before (or of no finite time), passed over;
    `not_finite`, coasted over; `saturated`, used with the noise of unmodelled motion; `gaps`, bridged, `gap_s` long in
    all."""

    used: int
    not_after: int
    not_finite: int
    saturated: int
    gaps: int
    gap_s: float


@dataclass(frozen=True, repr=False, eq=False)
class LinkReport:
    """What became of boundaries: arrays of one shape.

    Attributes
    ----------
    status : ndarray of uint8
        An `UpdateStatus` each; ABSENT where there was no boundary.
    innovation_m, variance_m2, nis : ndarray
        NaN where there is none.
    """

    status: npt.NDArray[np.uint8]
    innovation_m: _Array
    variance_m2: _Array
    nis: _Array

    @property
    def rejected(self) -> npt.NDArray[np.bool_]:
        """Present, and not accepted."""
        return np.isin(self.status, [UpdateStatus.ACCEPTED, UpdateStatus.ABSENT], invert=True)

    def __repr__(self) -> str:
        present = int(np.count_nonzero(self.status != UpdateStatus.ABSENT))
        return f"LinkReport({present} boundaries, {int(np.count_nonzero(self.rejected))} rejected)"


@dataclass(frozen=True, repr=False, eq=False)
class OfdmInertialRun:
    """History of a run: T rows, n states, R receivers, K transmitters, E epochs. Arrays are those of the first
    receiver unless they say otherwise; `receiver(i)` gives another's.

    Attributes
    ----------
    t_s : ndarray, shape (T,)
        The start, the samples recorded, the last sample.
    state, covariance : ndarray, shapes (T, n) and (T, n, n)
        Heading, velocity, position of each receiver; then clocks and biases.
    state_names : tuple of str
    links : LinkReport
        Of shape (E, R, K).
    epoch_t_s : ndarray, shape (E,)
    imu : ImuCounts
    status : UpdateStatus
        ACCEPTED, or why the run ended early.
    """

    t_s: _Array
    state: _Array
    covariance: _Array
    state_names: tuple[str, ...]
    epoch_t_s: _Array
    links: LinkReport
    reference_status: npt.NDArray[np.uint8]
    imu: ImuCounts
    status: UpdateStatus
    first: int = 0
    firsts: tuple[int, ...] = (0,)
    clocks: tuple[int, ...] = ()

    def receiver(self, index: int) -> OfdmInertialRun:
        """The same run, its `heading_rad`, `velocity_mps`, `position_m` and their covariance of receiver `index`."""
        if not 0 <= index < len(self.firsts):
            raise ValueError(f"receiver: {index} is not among {len(self.firsts)}")
        return OfdmInertialRun(**{**self.__dict__, "first": self.firsts[index]})

    @property
    def heading_rad(self) -> _Array:
        """Shape (T,)."""
        return self.state[:, self.first]

    @property
    def velocity_mps(self) -> _Array:
        """Shape (T, 2)."""
        return self.state[:, self.first + 1 : self.first + 3]

    @property
    def position_m(self) -> _Array:
        """Shape (T, 2)."""
        return self.state[:, self.first + 3 : self.first + 5]

    @property
    def position_covariance_m2(self) -> _Array:
        """Shape (T, 2, 2)."""
        i = slice(self.first + 3, self.first + 5)
        return self.covariance[:, i, i]

    @property
    def clock_bias_m(self) -> _Array:
        """Of the transmitters, where they are states; shape (T, K) or (T, 0)."""
        return self.state[:, list(self.clocks)]

    def __repr__(self) -> str:
        return (
            f"OfdmInertialRun({len(self.t_s)} rows, {self.state.shape[1]} states, {len(self.epoch_t_s)} epochs, "
            f"{int(np.count_nonzero(self.links.rejected))} boundaries rejected)"
        )


def _as_starts(start: PlanarStart | Sequence[PlanarStart]) -> tuple[PlanarStart, ...]:
    return (start,) if isinstance(start, PlanarStart) else tuple(start)


class OfdmInertialNavigator:
    """Inertial navigation aided by the block boundaries of OFDM transmitters.

    Heading, velocity and position of each receiver; where asked for, clocks of the transmitters and a multipath bias of
    each link; an extended Kalman filter over all of them. Innovations wrap by prediction, modulo the symbol's length.

    Parameters
    ----------
    transmitters_m : array_like, shape (K, 2)
    start : PlanarStart or sequence of PlanarStart
        One for each receiver.
    gyro_sigma_radps, accelerometer_sigma_mps2 : float
        White noise of one sample.
    ambiguity_m : float, optional
        Length of a symbol (`ofdm.Numerology.ambiguity_m`). None: boundaries have no ambiguity.
    gate_m : float, optional
        Residual monitor (crosby 4.4): innovations beyond it are refused ...
    gate_sigmas : float
        ... unless they are within so many of their own standard deviations, so that coasting does not lock it out.
    gate_probability : float, optional
        A chi-square gate beside it: the probability of refusing a good boundary.
    clock : object, optional
        Wander of the transmitters' clocks, which are then states: anything with ``noise.white_frequency_m2ps`` and
        ``noise.frequency_walk_m2ps3`` (`clock.TwoState`), or the pair itself.
    clock_drift_sigma_mps : float
        Spread of their drift at the start.
    multipath : (float, float), optional
        Standard deviation [m] and time constant [s] of a bias of each link (first-order Gauss-Markov).
    reference_receiver : bool
        Each epoch also has boundaries of a receiver that stands still, and differences to them are used (crosby 3.14).
    literal_transition : bool
        crosby's constant Φ, which leaves ∂v/∂θ out. Overconfident; to show it.
    unmodelled : (float, float)
        Acceleration [m/s²] and yaw rate [rad/s] that a receiver may have while its sensors say nothing.
    yaw_rate_range_radps, specific_force_range_mps2 : float, optional
        Where the sensors saturate.

    Raises
    ------
    ValueError
        For what is not finite, negative or too many; the message names it.
    """

    def __init__(
        self,
        transmitters_m: npt.ArrayLike,
        start: PlanarStart | Sequence[PlanarStart] = PlanarStart(),
        *,
        gyro_sigma_radps: float = 0.1,
        accelerometer_sigma_mps2: float = 0.1,
        ambiguity_m: float | None = None,
        gate_m: float | None = None,
        gate_sigmas: float = 3.0,
        gate_probability: float | None = None,
        clock: Any = None,
        clock_drift_sigma_mps: float = 0.0,
        multipath: tuple[float, float] | None = None,
        reference_receiver: bool = False,
        literal_transition: bool = False,
        unmodelled: tuple[float, float] = (2.0, 0.5),
        yaw_rate_range_radps: float | None = None,
        specific_force_range_mps2: float | None = None,
    ) -> None:
        if gate_probability is not None and not 0.0 < gate_probability < 1.0:
            raise ValueError(f"gate_probability: {gate_probability} is not between 0 and 1")
        starts = _as_starts(start)
        rows = [
            (
                s.heading_rad,
                *s.velocity_mps,
                *s.position_m,
                s.heading_sigma_rad,
                s.velocity_sigma_mps,
                s.position_sigma_m,
            )
            for s in starts
        ]
        self._receivers = len(starts)
        self._core = _navigation.OfdmInertialNavigator(
            np.reshape(np.asarray(transmitters_m, dtype=np.float64), (-1, 2))
            if np.size(transmitters_m) == 0
            else transmitters_m,
            np.reshape(np.asarray(rows, dtype=np.float64), (-1, 8)),
            gyro_sigma_radps=gyro_sigma_radps,
            accelerometer_sigma_mps2=accelerometer_sigma_mps2,
            ambiguity_m=math.inf if ambiguity_m is None else ambiguity_m,
            gate_m=math.inf if gate_m is None else gate_m,
            gate_sigmas=gate_sigmas,
            gate_probability=gate_probability,
            clock_psd=_clock_psd(clock),
            clock_drift_sigma_mps=clock_drift_sigma_mps,
            multipath=multipath,
            reference_receiver=reference_receiver,
            literal_transition=literal_transition,
            unmodelled=unmodelled,
            yaw_rate_range_radps=math.inf if yaw_rate_range_radps is None else yaw_rate_range_radps,
            specific_force_range_mps2=math.inf if specific_force_range_mps2 is None else specific_force_range_mps2,
        )
        self._transmitters = (
            int(np.shape(np.atleast_2d(np.asarray(transmitters_m)))[0]) if np.size(transmitters_m) else 0
        )

    @property
    def state_names(self) -> tuple[str, ...]:
        """What the states are."""
        return tuple(self._core.names)

    @property
    def state(self) -> _Array:
        """Present states, shape (n,), a copy."""
        return self._core.state

    @property
    def covariance(self) -> _Array:
        """Of the states, shape (n, n), a copy."""
        return self._core.covariance

    def receiver_at(self, receiver: int) -> int:
        """Index of a receiver's heading in `state`; velocity and position follow."""
        return self._core.receiver_at(receiver)

    def clock_at(self, transmitter: int) -> int:
        """Index of a transmitter's clock bias in `state` (its drift follows), or -1."""
        return self._core.clock_at(transmitter)

    def multipath_at(self, receiver: int, transmitter: int) -> int:
        """Index of a link's multipath bias in `state`, or -1."""
        return self._core.multipath_at(receiver, transmitter)

    def predict(
        self, yaw_rate_radps: float, specific_force_b_mps2: npt.ArrayLike, dt_s: float, *, receiver: int = 0
    ) -> UpdateStatus:
        """Carry a receiver through one sample. One that is not finite is coasted over."""
        force = np.asarray(specific_force_b_mps2, dtype=np.float64)
        if force.shape != (2,):
            raise ValueError(f"specific_force_b_mps2: expected shape (2,), got {force.shape}")
        return UpdateStatus(self._core.predict(receiver, yaw_rate_radps, float(force[0]), float(force[1]), dt_s))

    def coast(self, dt_s: float, *, receiver: int = 0) -> UpdateStatus:
        """Carry a receiver on without a sample."""
        return UpdateStatus(self._core.coast(receiver, dt_s))

    def predict_links(self, dt_s: float) -> UpdateStatus:
        """Carry clocks and multipath biases."""
        return UpdateStatus(self._core.predict_links(dt_s))

    def update(
        self, range_change_m: npt.ArrayLike, sigma_m: npt.ArrayLike, *, reference: npt.ArrayLike | None = None
    ) -> LinkReport:
        """Take the boundaries of one epoch.

        Parameters
        ----------
        range_change_m : array_like, shape (R, K), or (K,) for one receiver
            NaN where there is none.
        sigma_m : array_like
            Broadcast to it, and to `reference`.
        reference : array_like, shape (K,), optional
            Of the receiver that stands still.

        Returns
        -------
        LinkReport
            Of shape (R, K).
        """
        shape = (self._receivers, self._transmitters)
        z = np.asarray(range_change_m, dtype=np.float64)
        if z.shape not in (shape, shape[1:] if shape[0] == 1 else shape):
            raise ValueError(f"range_change_m: expected shape {shape}, got {z.shape}")
        z = z.reshape(shape)
        sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), shape)
        receiver = np.repeat(np.arange(shape[0]), shape[1])
        transmitter = np.tile(np.arange(shape[1]), shape[0])
        values, sigmas = z.ravel(), np.ascontiguousarray(sigma).ravel()
        extra = 0
        if reference is not None:
            still = np.asarray(reference, dtype=np.float64)
            if still.shape != (shape[1],):
                raise ValueError(f"reference: expected shape {(shape[1],)}, got {still.shape}")
            extra = shape[1]
            receiver = np.concatenate([np.full(extra, REFERENCE), receiver])
            transmitter = np.concatenate([np.arange(extra), transmitter])
            values = np.concatenate([still, values])
            sigmas = np.concatenate([sigma[0], sigmas])
        out = self._core.update(receiver.tolist(), transmitter.tolist(), values, sigmas)
        return _links({key: value[extra:].reshape(shape) for key, value in out.items()}, z)

    def run(
        self,
        imu: PlanarImu | Sequence[PlanarImu],
        tdoa: RangeChanges | Sequence[RangeChanges] | None = None,
        *,
        reference: RangeChanges | None = None,
        start_s: float = 0.0,
        imu_period_s: float | None = None,
        record_every: int = 1,
        max_gap_s: float = 600.0,
        timing: Timing | None = None,
        epoch_t_s: npt.ArrayLike | None = None,
    ) -> OfdmInertialRun:
        """A whole run from the present state, in one call; the navigator itself stays as it is.

        Parameters
        ----------
        imu : PlanarImu or sequence of PlanarImu
            One for each receiver, at common times.
        tdoa : RangeChanges or sequence of RangeChanges, optional
            One for each receiver, at common times. Without: inertial navigation alone.
        reference : RangeChanges, optional
            Of the receiver that stands still.
        start_s : float
            Time of the present state.
        imu_period_s : float, optional
            By default the median of the steps. Steps above 1.5 periods are gaps, which are coasted over.
        record_every : int
            Samples between the rows of the history.
        max_gap_s : float
            A sample farther ahead than this has a wrong time, and is passed over.
        timing : callable, optional
            In place of `tdoa`, timing with the filter in the loop: gets ``(epoch, receiver, transmitter,
            range_change_m, sigma_m)``, the last two what the filter expects of that boundary, and returns the measured
            ``(range_change_m, sigma_m)``, a NaN for none.
        epoch_t_s : array_like, shape (E,), optional
            When `timing` is asked.

        Returns
        -------
        OfdmInertialRun

        Raises
        ------
        ValueError
            For shapes and times that do not fit each other.
        """
        units = _each(imu, self._receivers, "imu")
        imu_t = np.ascontiguousarray(units[0].t_s, dtype=np.float64)
        yaw, force = _stack_imu(units, imu_t)
        if timing is not None and tdoa is not None:
            raise ValueError("tdoa, timing: one of them expected")
        if (timing is None) != (epoch_t_s is None):
            raise ValueError("timing, epoch_t_s: both or none expected")
        changes = [] if tdoa is None else _each(tdoa, self._receivers, "tdoa")
        epochs = changes[0].t_s if changes else np.empty(0) if epoch_t_s is None else epoch_t_s
        epoch_t = np.ascontiguousarray(epochs, dtype=np.float64)
        shape = (len(epoch_t), self._transmitters)
        z = np.empty((shape[0] if timing is None else 0, self._receivers, shape[1]))
        sigma = np.empty_like(z)
        for index, change in enumerate(changes):
            z[:, index], sigma[:, index] = _epochs(change, epoch_t, shape, "tdoa")
        still = still_sigma = np.empty((0, 0))
        if reference is not None:
            still, still_sigma = _epochs(reference, epoch_t, shape, "reference")
        out = self._core.run(
            start_s,
            imu_t,
            yaw,
            force,
            0.0 if imu_period_s is None else imu_period_s,
            epoch_t,
            z,
            sigma,
            still,
            still_sigma,
            record_every,
            max_gap_s,
            timing,
        )
        return OfdmInertialRun(
            t_s=_frozen(out["t_s"]),
            state=_frozen(out["state"]),
            covariance=_frozen(out["covariance"]),
            state_names=self.state_names,
            epoch_t_s=_frozen(epoch_t.copy()),
            links=_links(out, out["range_change_m"]),
            reference_status=_frozen(out["reference_status"]),
            imu=ImuCounts(*(out[f"imu_{name}"] for name in ImuCounts.__dataclass_fields__)),
            status=UpdateStatus(out["run_status"]),
            firsts=tuple(self.receiver_at(i) for i in range(self._receivers)),
            clocks=tuple(i for i in map(self.clock_at, range(self._transmitters)) if i >= 0),
        )


def _clock_psd(clock: Any) -> tuple[float, float] | None:
    if clock is None:
        return None
    noise = getattr(clock, "noise", clock)
    if hasattr(noise, "white_frequency_m2ps"):
        return float(noise.white_frequency_m2ps), float(noise.frequency_walk_m2ps3)
    try:
        white, walk = noise
        return float(white), float(walk)
    except (TypeError, ValueError):
        raise ValueError(f"clock: expected a clock or its two power densities, got {clock!r}") from None


def _each(one_or_more: Any, count: int, name: str) -> list[Any]:
    several = list(one_or_more) if isinstance(one_or_more, (list, tuple)) else [one_or_more]
    if len(several) != count:
        raise ValueError(f"{name}: one for each of {count} receivers expected, got {len(several)}")
    return several


def _stack_imu(units: Sequence[PlanarImu], t_s: _Array) -> tuple[_Array, _Array]:
    n = len(t_s)
    yaw, force = np.empty((len(units), n)), np.empty((len(units), n, 2))
    for index, unit in enumerate(units):
        name = f"imu[{index}]" if len(units) > 1 else "imu"
        if not np.array_equal(np.asarray(unit.t_s, dtype=np.float64), t_s, equal_nan=True):
            raise ValueError(f"{name}.t_s: not the times of imu[0]; receivers of one run share them")
        for into, value, field_name in (
            (yaw[index], unit.yaw_rate_radps, "yaw_rate_radps"),
            (force[index], unit.specific_force_b_mps2, "specific_force_b_mps2"),
        ):
            numbers = np.asarray(value, dtype=np.float64)
            if numbers.shape != into.shape:
                raise ValueError(f"{name}.{field_name}: expected shape {into.shape}, got {numbers.shape}")
            into[...] = numbers
    return yaw, force


def _epochs(change: RangeChanges, t_s: _Array, shape: tuple[int, int], name: str) -> tuple[_Array, _Array]:
    if not np.array_equal(np.asarray(change.t_s, dtype=np.float64), t_s):
        raise ValueError(f"{name}.t_s: receivers of one run share their epochs")
    z = np.asarray(change.range_change_m, dtype=np.float64)
    if z.shape != shape:
        raise ValueError(f"{name}.range_change_m: expected shape {shape}, got {z.shape}")
    sigma = np.asarray(change.sigma_m, dtype=np.float64)
    if sigma.shape not in ((), shape):
        raise ValueError(f"{name}.sigma_m: expected one number or shape {shape}, got {sigma.shape}")
    return np.ascontiguousarray(z), np.ascontiguousarray(np.broadcast_to(sigma, shape))


def _links(out: dict[str, Any], z: _Array) -> LinkReport:
    status = cast("npt.NDArray[np.uint8]", out["status"])
    status[np.isnan(z)] = int(UpdateStatus.ABSENT)
    return LinkReport(_frozen(status), _frozen(out["innovation_m"]), _frozen(out["variance_m2"]), _frozen(out["nis"]))


def _frozen(array: Any) -> Any:
    array.setflags(write=False)
    return array
