"""Two receivers, one of them lost: where the target is and how far its clock is off, from bursts both heard (mei)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._core.navigation import PairStart, PairStartStatus, PairUse
from soopnav_cpp._source_inputs import floats, named

__all__ = [
    "CooperativeRun",
    "CooperativeTracker",
    "PairBursts",
    "PairStart",
    "PairStartStatus",
    "PairUse",
    "SmoothedRun",
    "expected_pair",
    "start_pair",
]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_USES = {int(use.value): use for use in PairUse}
_FORMS = {"joseph": False, "information": True}
_MOTIONS = {"static": True, "nearly_constant_velocity": False}


@dataclass(frozen=True)
class PairBursts:
    """Bursts that two receivers heard, n of them: what the cross-ambiguity of each pair of snippets says.

    Signs: target minus anchor. `tdoa_s` is positive when the target is later by its clock, `fdoa_hz` when the target's
    recording has the higher frequency; a target clock that runs fast stamps later and sees carriers lower.

    Parameters
    ----------
    t_s : array_like, shape (n,)
        Arrival at the anchor by its clock, seconds of the system time that the beacons' orbits have.
    beacon : array_like of int, shape (n,)
        Which of the tracker's beacons.
    tdoa_s, fdoa_hz : array_like, shape (n,)
    covariance : array_like, shape (n, 2, 2) or (2, 2)
        Of TDOA [s] and FDOA [Hz].
    carrier_hz : array_like, shape (n,) or ()
        As sent.
    anchor_position_e_m, anchor_velocity_e_mps : array_like, shape (n, 3) or (3,)
        The anchor at `t_s`, ECEF.

    Raises
    ------
    ValueError
        For shapes that do not fit. Numbers that are not finite are for the tracker to refuse.
    """

    t_s: _Array
    beacon: npt.NDArray[np.int64]
    tdoa_s: _Array
    fdoa_hz: _Array
    covariance: _Array
    carrier_hz: _Array
    anchor_position_e_m: _Array
    anchor_velocity_e_mps: _Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        t = floats("t_s", self.t_s)
        if t.ndim != 1:
            raise ValueError(f"t_s: one dimension expected, got shape {t.shape}")
        shapes: dict[str, tuple[int, ...]] = {
            "t_s": (),
            "tdoa_s": (),
            "fdoa_hz": (),
            "covariance": (2, 2),
            "carrier_hz": (),
            "anchor_position_e_m": (3,),
            "anchor_velocity_e_mps": (3,),
        }
        for name, tail in shapes.items():
            given = floats(name, getattr(self, name))
            if given.shape not in (tail, (len(t), *tail)) or (name in ("tdoa_s", "fdoa_hz") and not given.ndim):
                raise ValueError(f"{name}: shape {(len(t), *tail)} expected, got {given.shape}")
            object.__setattr__(self, name, np.broadcast_to(given, (len(t), *tail)))
        beacon = np.asarray(self.beacon)
        if beacon.shape != t.shape or not np.issubdtype(beacon.dtype, np.integer):
            raise ValueError(f"beacon: whole numbers of shape {t.shape} expected, got {beacon.dtype} {beacon.shape}")
        object.__setattr__(self, "beacon", beacon.astype(np.int64))

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, which: Any) -> PairBursts:
        """Some of them: a slice, a mask or an array of numbers."""
        if np.ndim(np.empty(len(self))[which]) != 1:
            raise ValueError("which: a slice, a mask or an array of numbers expected")
        return PairBursts(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def __repr__(self) -> str:
        if not len(self):
            return "PairBursts(none)"
        span = self.t_s[-1] - self.t_s[0]
        return f"PairBursts({len(self)} of {len(np.unique(self.beacon))} beacons in {span:.1f} s)"

    def rows(self) -> _Array:
        """What the engine takes, shape (n, 15)."""
        flat = self.covariance.reshape(-1, 4)
        columns = (self.t_s, self.tdoa_s, self.fdoa_hz, flat, self.carrier_hz)
        return np.column_stack([*columns, self.anchor_position_e_m, self.anchor_velocity_e_mps, self.beacon])


def _enu_axes(p: _Array) -> _Array:
    """Rotations from ECEF to east, north, up at positions (..., 3): up is the ellipsoid's normal to 1e-5 rad."""
    up = p * np.array([1.0, 1.0, 1.0 / (1.0 - 6.69437999014e-3)])
    up = up / np.linalg.norm(up, axis=-1, keepdims=True)
    east = np.stack([-up[..., 1], up[..., 0], np.zeros(up.shape[:-1])], axis=-1)
    east = east / np.linalg.norm(east, axis=-1, keepdims=True)
    return np.stack([east, np.cross(up, east), up], axis=-2)


@dataclass(frozen=True)
class _States:
    """Estimates along time: what a run and its smoothed version share."""

    t_s: _Array
    mean: _Array
    covariance: _Array

    @property
    def position_e_m(self) -> _Array:
        """ECEF, shape (n, 3)."""
        return self.mean[:, :3]

    @property
    def velocity_e_mps(self) -> _Array:
        """ECEF, shape (n, 3)."""
        return self.mean[:, 3:6]

    @property
    def clock_offset_s(self) -> _Array:
        """Target's clock less the anchor's (theta / c), shape (n,)."""
        return np.asarray(self.mean[:, 6] / _LIGHT_MPS)

    @property
    def clock_skew(self) -> _Array:
        """Rate of `clock_offset_s` (alpha / c), shape (n,)."""
        return np.asarray(self.mean[:, 7] / _LIGHT_MPS)

    @property
    def horizontal_sigma_m(self) -> _Array:
        """Square root of the sum of the horizontal variances, shape (n,)."""
        axes = _enu_axes(self.position_e_m)
        local = axes @ self.covariance[:, :3, :3] @ np.swapaxes(axes, -1, -2)
        return np.asarray(np.sqrt(local[:, 0, 0] + local[:, 1, 1]))

    def error_enu_m(self, truth_e_m: npt.ArrayLike) -> _Array:
        """Errors east, north, up of the position; `truth_e_m` of shape (3,) or (n, 3). Shape (n, 3)."""
        truth = np.broadcast_to(np.asarray(truth_e_m, dtype=np.float64), self.position_e_m.shape)
        return np.asarray((_enu_axes(truth) @ (self.position_e_m - truth)[..., None])[..., 0])

    def nees(self, truth: npt.ArrayLike, states: Sequence[int] = range(8)) -> _Array:
        """Squared error of some states in the stated covariance, shape (n,); as many on average where that is right.

        `truth` has all eight columns of `mean`, shape (n, 8) or (8,).
        """
        pick = list(states)
        error = (self.mean - np.asarray(truth, dtype=np.float64))[:, pick]
        P = self.covariance[:, pick][:, :, pick]
        return np.asarray(np.sum(error * np.linalg.solve(P, error[..., None])[..., 0], axis=-1))


@dataclass(frozen=True)
class CooperativeRun(_States):
    """Estimates after every burst, n of them; NaN before the start.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Of the bursts.
    mean : ndarray, shape (n, 8)
        Position, velocity (ECEF) [m, m/s], theta = c (b_target - b_anchor) [m], alpha, its rate [m/s].
    covariance : ndarray, shape (n, 8, 8)
    innovation : ndarray, shape (n, 2)
        c TDOA [m] and range rate [m/s] less what was expected.
    innovation_covariance : ndarray, shape (n, 2, 2)
    nis : ndarray, shape (n,)
    use_code : ndarray of int64, shape (n,)
        Values of `PairUse`; `use` gives the members.
    """

    innovation: _Array
    innovation_covariance: _Array
    nis: _Array
    use_code: npt.NDArray[np.int64]

    @property
    def use(self) -> list[PairUse]:
        """What became of each burst."""
        return [_USES[int(code)] for code in self.use_code]

    @property
    def accepted(self) -> npt.NDArray[np.bool_]:
        """Which bursts changed the estimate, shape (n,)."""
        good = [int(u.value) for u in (PairUse.ACCEPTED, PairUse.CLOCK_JUMP, PairUse.FREQUENCY_JUMP)]
        return np.isin(self.use_code, good)

    def __repr__(self) -> str:
        taken = int(np.count_nonzero(self.accepted))
        if not taken or not np.isfinite(self.mean[-1]).all():
            return f"CooperativeRun({taken} of {len(self.t_s)} bursts)"
        return f"CooperativeRun({taken} of {len(self.t_s)} bursts, ends ±{self.horizontal_sigma_m[-1]:.3g} m)"


@dataclass(frozen=True)
class SmoothedRun(_States):
    """Estimates given all bursts of a run: `t_s` (n,), `mean` (n, 8), `covariance` (n, 8, 8)."""

    complete: bool

    def __repr__(self) -> str:
        return f"SmoothedRun({len(self.t_s)} steps{'' if self.complete else ', not to the end'})"


def _noise(name: str, clock: object) -> tuple[float, float]:
    """(S_f, S_g) of a `clock.TwoState`, of a pair of numbers, or of none."""
    if clock is None:
        return (0.0, 0.0)
    pair = floats(name, clock)  # type: ignore[arg-type]
    if pair.shape != (2,):
        raise ValueError(f"{name}: a clock.TwoState or two power densities expected, got shape {pair.shape}")
    return (float(pair[0]), float(pair[1]))


def _search(options: Mapping[str, Any]) -> dict[str, Any]:
    given = {("guess_p_e" if key == "guess_e_m" else key): value for key, value in options.items()}
    if given.get("guess_p_e") is None:
        given.pop("guess_p_e", None)
    else:
        given["guess_p_e"] = floats("guess_e_m", given["guess_p_e"]).tolist()
    return given


class CooperativeTracker:
    """Position, velocity and clock of a target from bursts that an anchor heard as well.

    State: position and velocity in ECEF, theta = c (b_target - b_anchor) [m] and its rate alpha [m/s], a clock's bias b
    being its reading less system time. Model: mei (1a), (1b) with each receiver's own epoch, light time, the Earth's
    turn, and the skew counted once (cpp/doc/cooperative.md).

    Parameters
    ----------
    beacons : sequence of geometry.SampledOrbit
        Satellites, aircraft or masts; bursts name them by their number.
    target_clock, anchor_clock : clock.TwoState or (S_f, S_g), optional
        How the clocks wander; none: not at all.
    motion : {"static", "nearly_constant_velocity"}
        A target that stands (its velocity known within `velocity_sigma_mps`, 1 mm/s unless said), or one with white
        acceleration of `acceleration_psd_m2ps3` (1 unless said) and a velocity within 30 m/s at a batch start.
    acceleration_psd_m2ps3, velocity_sigma_mps : float, optional
    form : {"joseph", "information"}
        Two engines with the same answers.
    height_m, height_sigma_m : float, optional
        Height above the ellipsoid known within so much. Its error stays what it is, so it is not learnt twice: it only
        keeps the vertical variance from exceeding its own.
    road_e_m : array_like, shape (k, 3), optional
        Polyline (ECEF) the target keeps to, within `road_sigma_m` (10) across.
    beacon_epoch_s : array_like, shape (beacons,), optional
        When the elements of each were of date, for the age of its along-track error.
    **options
        ``iterations`` (1: linearisations of each update), ``gate_probability`` (1e-6: of a good burst to be refused; 0:
        no gate), ``mask_rad`` (0: least elevation of satellites at both receivers), ``anchor_drift_mps`` (0: c times
        the anchor's own skew where known), ``orbit_sigma_m`` (0: orbits are exact) and ``orbit_sigma_mps`` (0; its
        growth with age), ``along_track_states`` (0: that error is noise, wide enough; k: it is estimated for k
        satellites at a time, the better way), ``forget_after_s`` (900), ``jump_after`` (3: refused bursts that agree on
        another clock; 0: never), ``smoother_capacity`` (0: steps kept for `smooth`).

    Raises
    ------
    ValueError
        For an option that is unknown or out of range. Bad bursts are no error: see `CooperativeRun.use` and `counts`.
    """

    def __init__(
        self,
        beacons: Sequence[SampledOrbit],
        *,
        target_clock: object = None,
        anchor_clock: object = None,
        motion: str = "static",
        acceleration_psd_m2ps3: float | None = None,
        velocity_sigma_mps: float | None = None,
        form: str = "joseph",
        height_m: float = 0.0,
        height_sigma_m: float = float("inf"),
        road_e_m: npt.ArrayLike | None = None,
        beacon_epoch_s: npt.ArrayLike | None = None,
        **options: float,
    ) -> None:
        static = named("motion", motion, _MOTIONS)
        if static and acceleration_psd_m2ps3:
            raise ValueError(f"acceleration_psd_m2ps3 = {acceleration_psd_m2ps3}: none expected of a static target")
        given: dict[str, Any] = dict(options)
        given["target_clock"] = _noise("target_clock", target_clock)
        given["anchor_clock"] = _noise("anchor_clock", anchor_clock)
        given["acceleration_psd_m2ps3"] = (
            0.0 if static else 1.0 if acceleration_psd_m2ps3 is None else float(acceleration_psd_m2ps3)
        )
        given["velocity_sigma_mps"] = (
            (1e-3 if static else 30.0) if velocity_sigma_mps is None else float(velocity_sigma_mps)
        )
        given["information_form"] = named("form", form, _FORMS)
        given["height_m"], given["height_sigma_m"] = float(height_m), float(height_sigma_m)
        if road_e_m is not None:
            road = floats("road_e_m", road_e_m)
            if road.ndim != 2 or road.shape[1] != 3:
                raise ValueError(f"road_e_m: shape (k, 3) expected, got {road.shape}")
            given["road_p_e"] = road.tolist()
        self.beacons = tuple(beacons)
        self.motion = motion
        epochs = np.empty(0) if beacon_epoch_s is None else floats("beacon_epoch_s", beacon_epoch_s)
        self._core = self._make(list(self.beacons), epochs, given)

    def _make(self, beacons: list[SampledOrbit], epochs: _Array, given: dict[str, Any]) -> Any:
        return _navigation.CooperativeTracker(beacons, epochs, given)

    def start(self, bursts: PairBursts, **search: Any) -> PairStart:
        """Start from bursts alone, and stand at the last of them: they are used up.

        Parameters
        ----------
        bursts : PairBursts
            In order of time; 90 s of them and more.
        **search
            ``guess_e_m`` (the anchor: middle of the search), ``search_radius_m`` (3e6; 0: from the guess alone),
            ``cell_m`` (2e5: of the grid), ``candidates`` (8), ``min_bursts`` (10), ``ambiguous_chi_square`` (12),
            ``alpha_sigma_mps`` (3e3), ``max_sigma_m`` (3e3: of the place, beyond which it is vague).

        Returns
        -------
        PairStart
            ``status``, ``mean``, ``covariance``, ``t_s``, ``chi_square``, ``degrees_of_freedom``, ``alternatives``,
            ``used``. The tracker is started where a place fits, the best of several included, and else stays as it
            was: with few satellites gather more bursts until ``ok``. Bursts of the start are not taken again.
        """
        return self._core.start(bursts.rows(), _search(search))  # type: ignore[no-any-return]

    def start_at(self, t_s: float, mean: npt.ArrayLike, covariance: npt.ArrayLike) -> None:
        """Start from a known mean (8,) and covariance (8, 8): position, velocity (ECEF), theta, alpha [m, m/s]."""
        self._core.start_at(float(t_s), floats("mean", mean), floats("covariance", covariance))

    def run(self, bursts: PairBursts) -> CooperativeRun:
        """Take all of them in, one after the other; the estimates after each."""
        return CooperativeRun(np.array(bursts.t_s), *self._core.run(bursts.rows()))

    def update(self, bursts: PairBursts) -> CooperativeRun:
        """The same for one burst, or a few: what `run` does."""
        return self.run(bursts)

    def coast(self, t_s: float) -> bool:
        """Move on without a burst; False when `t_s` is not after the present time."""
        return bool(self._core.coast(float(t_s)))

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return bool(self._core.started)

    @property
    def t_s(self) -> float:
        """Time of the estimate; NaN before the start."""
        return float(self._core.estimate()[0])

    @property
    def mean(self) -> _Array:
        """Position, velocity (ECEF), theta, alpha; shape (8,)."""
        return np.asarray(self._core.estimate()[1])

    @property
    def covariance(self) -> _Array:
        """Of `mean`, shape (8, 8)."""
        return np.asarray(self._core.estimate()[2])

    @property
    def silent_s(self) -> float:
        """Seconds since a burst was last accepted."""
        return float(self._core.estimate()[3])

    @property
    def counts(self) -> dict[PairUse, int]:
        """How often each `PairUse` occurred, those that did."""
        return {_USES[i]: int(n) for i, n in enumerate(self._core.counts) if n}

    def along_track(self, beacon: int) -> tuple[float, float] | None:
        """Along-track error of a beacon and its deviation [m]; None when it is not estimated now."""
        found = self._core.along_track(int(beacon))
        return None if found is None else (float(found[0]), float(found[1]))

    def smooth(self) -> SmoothedRun:
        """Estimates of all steps since the start given all of them (Rauch, Tung and Striebel).

        Raises
        ------
        ValueError
            Without ``smoother_capacity``, or when a number overflows.
        """
        status, t_s, mean, covariance = self._core.smooth()
        if not len(t_s):
            raise ValueError(f"smooth: no steps are kept ({status}); smoother_capacity expected before the start")
        if len(mean) != len(t_s):
            raise ValueError(f"smooth: {status}")
        return SmoothedRun(t_s, mean, covariance, status == "done")

    def __repr__(self) -> str:
        name = f"CooperativeTracker({len(self.beacons)} beacons, {self.motion}"
        if not self.started:
            return name + ", not started)"
        sigma = float(np.sqrt(np.trace(self.covariance[:3, :3])))
        return f"{name}, t = {self.t_s:.1f} s, ±{sigma:.3g} m)"


def start_pair(
    beacons: Sequence[SampledOrbit],
    bursts: PairBursts,
    *,
    target_clock: object = None,
    anchor_clock: object = None,
    **search: Any,
) -> PairStart:
    """A target's place and clock from bursts alone: coarse grid, then a batch over all bursts.

    As `CooperativeTracker.start`, whose options it takes, and besides ``height_m`` (0), ``height_sigma_m`` (10;
    infinite: not known), ``velocity_sigma_mps`` (1e-3), ``acceleration_psd_m2ps3`` (0), ``mask_rad`` (0),
    ``anchor_drift_mps`` (0) and ``orbit_sigma_m`` (one number for each beacon).

    Raises
    ------
    ValueError
        For options out of range. Bursts that do not determine a place are no error but a ``status``.
    """
    total = np.add(_noise("target_clock", target_clock), _noise("anchor_clock", anchor_clock))
    options = _search(search) | {"clock_noise": (float(total[0]), float(total[1]))}
    return _navigation.start_pair(list(beacons), bursts.rows(), options)


def expected_pair(
    beacons: Sequence[SampledOrbit],
    bursts: PairBursts,
    mean: npt.ArrayLike,
    *,
    along_track_m: npt.ArrayLike = 0.0,
    anchor_drift_mps: float = 0.0,
) -> tuple[_Array, _Array]:
    """TDOA [s] and FDOA [Hz] that the model expects of each burst; NaN outside the ephemeris.

    Parameters
    ----------
    beacons : sequence of geometry.SampledOrbit
    bursts : PairBursts
        Their times, beacons, carriers and the anchor's place are read.
    mean : array_like, shape (8,) or (n, 8)
        The target at the arrival at the anchor: position, velocity (ECEF), theta, alpha [m, m/s].
    along_track_m : array_like, shape () or (n,)
        How far ahead the beacon is along its orbit.
    anchor_drift_mps : float
        c times the anchor's own skew.
    """
    n = len(bursts)
    means = np.ascontiguousarray(np.broadcast_to(floats("mean", mean), (n, 8)))
    along = np.broadcast_to(floats("along_track_m", along_track_m), (n,))
    out = np.full((n, 2), np.nan)
    rows = bursts.rows()
    for number in np.unique(bursts.beacon):
        which = bursts.beacon == number
        if 0 <= number < len(beacons):
            out[which] = _navigation.pair_geometry(
                beacons[number], rows[which], means[which], np.array(along[which]), anchor_drift_mps
            )
    return out[:, 0], out[:, 1]
