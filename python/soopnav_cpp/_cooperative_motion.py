"""Targets that move: cooperative trackers with two modes of motion or an inertial unit, and several targets at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._cooperative import CooperativeTracker, PairBursts, SmoothedRun, _noise, _States
from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._core.inertial import ImuStatus
from soopnav_cpp._core.navigation import GroupStatus
from soopnav_cpp._source_inputs import floats
from soopnav_cpp.inertial import ImuNoise

__all__ = [
    "CooperativeGroup",
    "GroupRun",
    "GroupStatus",
    "InertialPairRun",
    "InertialTracker",
    "InertialUnit",
    "ManoeuvringTracker",
    "TwoMotions",
    "pair_noise_shares",
    "shared_anchor_correlation",
]

_Array = npt.NDArray[np.float64]
_IMU = {int(status.value): status for status in ImuStatus}
_GROUP = {int(status.value): status for status in GroupStatus}


@dataclass(frozen=True, kw_only=True)
class TwoMotions:
    """How a target moves: calm (at rest or straight on) or manoeuvring, by a Markov chain in continuous time.

    Attributes
    ----------
    calm_psd_m2ps3, manoeuvre_psd_m2ps3 : float
        White horizontal acceleration of both modes [m²/s³]; 9 is 3 m/s² for a second or so.
    calm_vertical_psd_m2ps3, manoeuvre_vertical_psd_m2ps3 : float
        And upwards.
    mean_calm_s, mean_manoeuvre_s : float
        How long it stays in either on average.
    calm_probability : float
        At the start.
    """

    calm_psd_m2ps3: float = 0.01
    manoeuvre_psd_m2ps3: float = 9.0
    calm_vertical_psd_m2ps3: float = 1e-4
    manoeuvre_vertical_psd_m2ps3: float = 0.01
    mean_calm_s: float = 20.0
    mean_manoeuvre_s: float = 10.0
    calm_probability: float = 0.5

    @property
    def _numbers(self) -> _Array:
        return np.array(
            [
                self.calm_psd_m2ps3,
                self.manoeuvre_psd_m2ps3,
                self.calm_vertical_psd_m2ps3,
                self.manoeuvre_vertical_psd_m2ps3,
                self.mean_calm_s,
                self.mean_manoeuvre_s,
                self.calm_probability,
            ],
            dtype=np.float64,
        )


class ManoeuvringTracker(CooperativeTracker):
    """A `CooperativeTracker` for a target that drives, turns and stops: an interacting multiple model of two motions.

    Its smoother takes the mixture of the modes for one Gaussian.

    Parameters
    ----------
    beacons : sequence of geometry.SampledOrbit
    motions : TwoMotions
    **options
        As for `CooperativeTracker`; ``motion``, ``form`` and ``iterations`` have no meaning here.
    """

    def __init__(self, beacons: Sequence[SampledOrbit], *, motions: TwoMotions | None = None, **options: Any) -> None:
        self._motions = TwoMotions() if motions is None else motions
        super().__init__(beacons, motion="nearly_constant_velocity", **options)
        self.motion = "two motions"

    def _make(self, beacons: list[SampledOrbit], epochs: _Array, given: dict[str, Any]) -> Any:
        return _navigation.manoeuvring_tracker(beacons, epochs, given, self._motions._numbers)

    @property
    def mode_probabilities(self) -> tuple[float, float]:
        """Of being calm and of manoeuvring, now."""
        calm, manoeuvring = _navigation.tracker_modes(self._core)
        return float(calm), float(manoeuvring)


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialUnit:
    """An inertial unit on a target and what is known of it at the start.

    Attributes
    ----------
    noise : inertial.ImuNoise
        White parts and bias walks.
    period_s : float
        Time between samples.
    quaternion : array_like, shape (4,)
        w, x, y, z: body to north-east-down at the start's position.
    tilt_sigma_rad, heading_sigma_rad : float
        Of it, about north and east, and about down.
    gyro_bias_sigma_radps, accelerometer_bias_sigma_mps2 : float
        Of biases taken as zero at the start, each axis.
    gap_periods, gyro_range_radps, accelerometer_range_mps2 : float
        What samples are held against: see `inertial.judge_samples`.
    gap_rate_sigma_radps, gap_acceleration_sigma_mps2 : float
        Unknown, constant rate and acceleration over time without usable samples.
    coning_samples : int
        Earlier samples used against coning and sculling, 0 ... 4.
    waiting_samples : int
        Room for samples later than the last burst.
    """

    noise: ImuNoise
    period_s: float
    quaternion: npt.ArrayLike
    tilt_sigma_rad: float = 0.01
    heading_sigma_rad: float = 0.02
    gyro_bias_sigma_radps: float = 1e-4
    accelerometer_bias_sigma_mps2: float = 0.02
    gap_periods: float = 1.5
    gyro_range_radps: float = math.inf
    accelerometer_range_mps2: float = math.inf
    gap_rate_sigma_radps: float = 0.2
    gap_acceleration_sigma_mps2: float = 1.0
    coning_samples: int = 4
    waiting_samples: int = 65536


@dataclass(frozen=True, eq=False, repr=False)
class InertialPairRun(_States):
    """Everything an `InertialTracker` estimates, n times.

    Attributes
    ----------
    t_s, mean, covariance : ndarray
        As of a `SmoothedRun`: position, velocity, theta and alpha.
    quaternion : ndarray, shape (n, 4)
        w, x, y, z: body to ECEF.
    gyro_bias_radps, accelerometer_bias_mps2 : ndarray, shape (n, 3)
    full_covariance : ndarray, shape (n, 17, 17)
        Of `mean`, attitude (a rotation about the body's axes, truth = q exp(d)), gyro and accelerometer biases.
    """

    quaternion: _Array
    gyro_bias_radps: _Array
    accelerometer_bias_mps2: _Array
    full_covariance: _Array

    @classmethod
    def _of(cls, parts: tuple[_Array, ...]) -> InertialPairRun:
        t_s, mean, quaternion, gyro, force, full = parts
        return cls(t_s, mean, np.ascontiguousarray(full[:, :8, :8]), quaternion, gyro, force, full)

    def __repr__(self) -> str:
        return f"InertialPairRun({len(self.t_s)} times)"


class InertialTracker(CooperativeTracker):
    """A `CooperativeTracker` for a target with an inertial unit: strapdown navigation in ECEF aided by bursts, an
    extended Kalman filter of 17 error states.

    Give the unit's samples by `add_imu` before the bursts that fall into them, all of a recording at once if there is
    room. Time no sample speaks for is coasted at constant velocity.

    Parameters
    ----------
    beacons : sequence of geometry.SampledOrbit
    unit : InertialUnit
    smoother_capacity : int
        Bursts that `smooth` can go back over.
    **options
        As for `CooperativeTracker`; ``motion``, ``form`` and ``iterations`` have no meaning here.
    """

    def __init__(
        self, beacons: Sequence[SampledOrbit], *, unit: InertialUnit, smoother_capacity: int = 0, **options: Any
    ) -> None:
        self._unit = unit
        self._smoother_capacity = smoother_capacity
        super().__init__(beacons, motion="nearly_constant_velocity", **options)
        self.motion = "inertial unit"

    def _make(self, beacons: list[SampledOrbit], epochs: _Array, given: dict[str, Any]) -> Any:
        u = self._unit
        return _navigation.inertial_tracker(
            beacons,
            epochs,
            given,
            noise=u.noise._numbers,
            quaternion=floats("quaternion", u.quaternion),
            start=[u.tilt_sigma_rad, u.heading_sigma_rad, u.gyro_bias_sigma_radps, u.accelerometer_bias_sigma_mps2],
            limits=[
                u.period_s,
                u.gap_periods,
                u.gyro_range_radps,
                u.accelerometer_range_mps2,
                u.gap_rate_sigma_radps,
                u.gap_acceleration_sigma_mps2,
            ],
            coning_samples=u.coning_samples,
            waiting_samples=u.waiting_samples,
            smoother_steps=self._smoother_capacity,
        )

    def add_imu(
        self, t_s: npt.ArrayLike, delta_theta_b: npt.ArrayLike, delta_velocity_b: npt.ArrayLike
    ) -> list[ImuStatus]:
        """Take samples in; they wait until bursts reach them.

        Parameters
        ----------
        t_s : array_like, shape (n,)
            Ends of the increments.
        delta_theta_b, delta_velocity_b : array_like, shape (n, 3)
            Integrals of rate [rad] and specific force [m/s] along the body's axes.

        Returns
        -------
        list of ImuStatus
            What each was worth; bad ones are no error.
        """
        theta, velocity = floats("delta_theta_b", delta_theta_b), floats("delta_velocity_b", delta_velocity_b)
        codes = _navigation.tracker_add_imu(self._core, np.atleast_1d(floats("t_s", t_s)), theta, velocity)
        return [_IMU[int(code)] for code in codes]

    @property
    def inertial(self) -> InertialPairRun:
        """The present estimate of all states, one row."""
        return InertialPairRun._of(_navigation.tracker_inertial(self._core))

    def smooth(self) -> SmoothedRun:
        """As `CooperativeTracker.smooth`, over all 17 states."""
        full = self.smooth_inertial()
        return SmoothedRun(full.t_s, full.mean, full.covariance, True)

    def smooth_inertial(self) -> InertialPairRun:
        """All states at all steps since the start given all of them (Rauch, Tung and Striebel); for the end of a run.

        Raises
        ------
        ValueError
            When `smoother_capacity` was too small, or a number overflows.
        """
        parts = _navigation.tracker_inertial_smooth(self._core)
        if not len(parts[0]):
            raise ValueError(f"smoother_capacity: {self._smoother_capacity} is too small for this run")
        return InertialPairRun._of(parts)


def pair_noise_shares(first_snr_db: float, second_snr_db: float) -> tuple[float, float, float]:
    """Shares of the variance of a TDOA or FDOA that come from the noise of the first recording alone, of the second
    alone, and of the product of both (Stein 1981, term by term; cpp/doc/cooperative_motion.md eq. 9).

    Parameters
    ----------
    first_snr_db, second_snr_db : float
        In the signal's band.
    """
    a, b, both = _navigation.pair_noise_shares(10.0 ** (0.1 * first_snr_db), 10.0 ** (0.1 * second_snr_db))
    return float(a), float(b), float(both)


def shared_anchor_correlation(first_snr_db: float, second_snr_db: float, anchor_snr_db: float) -> float:
    """Correlation of the errors of two targets' TDOAs, and of their FDOAs, of one burst against one anchor.

    Parameters
    ----------
    first_snr_db, second_snr_db, anchor_snr_db : float
        Of the three recordings, in the signal's band.
    """
    of_first = pair_noise_shares(first_snr_db, anchor_snr_db)[1]
    of_second = pair_noise_shares(second_snr_db, anchor_snr_db)[1]
    return math.sqrt(of_first * of_second)


@dataclass(frozen=True, eq=False, repr=False)
class GroupRun:
    """Estimates of several targets after every burst, n of them.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    targets : tuple of int
        Their names.
    mean : ndarray, shape (n, targets, 8)
        Position, velocity (ECEF), theta, alpha of each.
    covariance : ndarray, shape (n, 8 targets, 8 targets), or None
        Of all of them together.
    status_code : ndarray, shape (n, rows)
        Values of `GroupStatus`.
    """

    t_s: _Array
    targets: tuple[int, ...]
    mean: _Array
    covariance: _Array | None
    status_code: npt.NDArray[np.uint8]

    @property
    def status(self) -> list[list[GroupStatus]]:
        """What became of each row of each burst."""
        return [[_GROUP[int(code)] for code in row] for row in self.status_code]

    def nees(self, truth: npt.ArrayLike) -> _Array:
        """Squared error of all states of all targets in the stated joint covariance, shape (n,); `truth` as `mean`."""
        if self.covariance is None:
            raise ValueError("covariance: none was asked for")
        error = (self.mean - np.asarray(truth, dtype=np.float64)).reshape(len(self.t_s), -1)
        return np.asarray(np.sum(error * np.linalg.solve(self.covariance, error[..., None])[..., 0], axis=-1))

    def __repr__(self) -> str:
        return f"GroupRun({len(self.t_s)} bursts, {len(self.targets)} targets)"


class CooperativeGroup:
    """Several targets and one anchor: positions, velocities and clocks of all of them together.

    The anchor's recording is in all rows of a burst and its clock in every theta: their errors are correlated, and are
    taken so (cpp/doc/cooperative_motion.md eq. 8 to 13).

    Parameters
    ----------
    beacons : sequence of geometry.SampledOrbit
    start_s : float
        When.
    target_clock, anchor_clock : clock.TwoState or (S_f, S_g), optional
        How each target's clock and the anchor's wander; none: not at all.
    horizontal_psd_m2ps3, vertical_psd_m2ps3 : float
        White acceleration of the targets.
    gate_probability : float
        Of a good row to be refused; 0: no gate.
    max_targets : int
        Up to 64.
    shared_anchor_noise, shared_anchor_clock : bool
        False: rows, or clocks, are taken for independent ones. For comparison: the covariance is then wrong.
    """

    def __init__(
        self,
        beacons: Sequence[SampledOrbit],
        start_s: float,
        *,
        target_clock: object = None,
        anchor_clock: object = None,
        horizontal_psd_m2ps3: float = 0.0,
        vertical_psd_m2ps3: float = 0.0,
        gate_probability: float = 1e-4,
        max_targets: int = 8,
        shared_anchor_noise: bool = True,
        shared_anchor_clock: bool = True,
    ) -> None:
        self.beacons = tuple(beacons)
        self._core = _navigation.CooperativeGroup(
            list(self.beacons),
            float(start_s),
            anchor_clock=_noise("anchor_clock", anchor_clock),
            target_clock=_noise("target_clock", target_clock),
            horizontal_psd_m2ps3=float(horizontal_psd_m2ps3),
            vertical_psd_m2ps3=float(vertical_psd_m2ps3),
            gate_probability=float(gate_probability),
            max_targets=int(max_targets),
            shared_anchor_noise=bool(shared_anchor_noise),
            shared_anchor_clock=bool(shared_anchor_clock),
        )

    def join(self, mean: npt.ArrayLike, covariance: npt.ArrayLike) -> int:
        """Let a target join now: position, velocity, theta, alpha (8,) and their covariance (8, 8). Its name.

        Raises
        ------
        ValueError
            When there is no room, a number is not finite, or the covariance is none.
        """
        name = int(self._core.join(floats("mean", mean), floats("covariance", covariance)))
        if name < 0:
            raise ValueError("join: no room for another target, or mean and covariance are none")
        return name

    def leave(self, target: int) -> bool:
        """Let it leave; what it taught the others stays. False when it is not here."""
        return bool(self._core.leave(int(target)))

    def run(
        self,
        bursts: Sequence[PairBursts],
        snr_db: npt.ArrayLike,
        *,
        pairs: Sequence[tuple[int, int]] | None = None,
        covariance: bool = False,
    ) -> GroupRun:
        """Take the rows of many bursts in.

        Parameters
        ----------
        bursts : sequence of PairBursts
            One for each pair of receivers, all of the same bursts: times, beacons, carriers and the anchor's place are
            read from the first. NaN for what was not heard.
        snr_db : array_like, shape (pairs, 2) or (n, pairs, 2)
            Of the target's recording and the reference's, in the signal's band.
        pairs : sequence of (target, reference), optional
            Names; reference -1 is the anchor. Without it, each target in the order of joining against the anchor.
        covariance : bool
            Whether joint covariances are kept.

        Raises
        ------
        ValueError
            For shapes that do not fit. Bad rows are no error: see `GroupRun.status`.
        """
        who = [(name, -1) for name in self._core.targets] if pairs is None else [(int(a), int(b)) for a, b in pairs]
        if len(bursts) != len(who) or not who:
            raise ValueError(f"bursts: one for each of {len(who)} pairs expected, got {len(bursts)}")
        first, n = bursts[0], len(bursts[0])
        if any(len(one) != n for one in bursts):
            raise ValueError("bursts: all of the same length expected")
        ratio = floats("snr_db", snr_db)
        if ratio.shape not in ((len(who), 2), (n, len(who), 2)):
            raise ValueError(f"snr_db: shape {(n, len(who), 2)} expected, got {ratio.shape}")
        heads = np.column_stack([first.t_s, first.beacon, first.carrier_hz, first.anchor_position_e_m,
                                 first.anchor_velocity_e_mps])  # fmt: skip
        rows = np.empty((n, len(who), 8))
        for i, one in enumerate(bursts):
            rows[:, i, 0], rows[:, i, 1] = one.tdoa_s, one.fdoa_hz
            rows[:, i, 2:6] = one.covariance.reshape(n, 4)
        rows[:, :, 6:] = 10.0 ** (0.1 * ratio)
        names = tuple(int(name) for name in self._core.targets)
        mean, P, status = self._core.run(heads, rows, who, covariance)
        shape = (n, len(names), 8)
        return GroupRun(np.array(first.t_s), names, mean.reshape(shape), P if covariance else None, status)

    @property
    def t_s(self) -> float:
        """Time of the state."""
        return float(self._core.time_s)

    @property
    def targets(self) -> tuple[int, ...]:
        """Names of those here, in the order of joining."""
        return tuple(int(name) for name in self._core.targets)

    @property
    def mean(self) -> _Array:
        """Position, velocity (ECEF), theta, alpha of each; shape (targets, 8)."""
        return np.asarray(self._core.mean).reshape(-1, 8)

    @property
    def covariance(self) -> _Array:
        """Of all of them together, shape (8 targets, 8 targets)."""
        return np.asarray(self._core.covariance)

    def __repr__(self) -> str:
        return f"CooperativeGroup({len(self.targets)} targets, {len(self.beacons)} beacons, t = {self.t_s:.1f} s)"
