"""Where a handset is indoors: ranges with and without line of sight, and the steps of its camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import (
    HandsetClock,
    HandsetEstimate,
    HandsetFilter,
    HandsetReport,
    HandsetStatus,
    HandsetUse,
)
from soopnav_cpp._source_inputs import floats, named

__all__ = [
    "HandsetEstimate",
    "HandsetLocator",
    "HandsetReport",
    "HandsetRun",
    "HandsetStatus",
    "HandsetUse",
]

_Array = npt.NDArray[np.float64]
_FILTERS = {"control": HandsetFilter.CONTROL, "measurement": HandsetFilter.MEASUREMENT}
_CLOCKS = {"common": HandsetClock.COMMON, "separate": HandsetClock.SEPARATE}
_STATUSES = {int(status.value): status for status in HandsetStatus}
_USES = {int(use.value): use for use in HandsetUse}
_NONE: list[float] = []


@runtime_checkable
class _Motion(Protocol):
    """What is read of `vision.PlanarMotion`."""

    @property
    def ok(self) -> bool: ...
    @property
    def increment(self) -> npt.ArrayLike: ...
    @property
    def track_covariance(self) -> npt.ArrayLike: ...
    @property
    def foot_covariance_previous(self) -> npt.ArrayLike: ...
    @property
    def foot_covariance(self) -> npt.ArrayLike: ...


@dataclass(frozen=True)
class HandsetRun:
    """Estimates after every epoch of the radio, n of them, of L links.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, 2)
    covariance_m2 : ndarray, shape (n, 2, 2)
    heading_rad, heading_sigma_rad : ndarray, shape (n,)
    clock_m, clock_sigma_m : ndarray, shape (n,)
    p_los : ndarray, shape (n, L)
        Probability that a link has no excess delay.
    excess_m : ndarray, shape (n, L)
        Its mean where it has; NaN where no particle says so.
    ess, mode_share, log_evidence : ndarray, shape (n,)
    status_code, use_code : ndarray of int64, shape (n,)
        Values of `HandsetStatus` and `HandsetUse`; `status` and `use` give the members.
    frame_use_code : ndarray of int64, shape (frames - 1,)
        Of the camera's steps.
    """

    t_s: _Array
    position_m: _Array
    covariance_m2: _Array
    heading_rad: _Array
    heading_sigma_rad: _Array
    clock_m: _Array
    clock_sigma_m: _Array
    p_los: _Array
    excess_m: _Array
    ess: _Array
    mode_share: _Array
    log_evidence: _Array
    status_code: npt.NDArray[np.int64]
    use_code: npt.NDArray[np.int64]
    frame_use_code: npt.NDArray[np.int64]

    @property
    def status(self) -> list[HandsetStatus]:
        """What each estimate rests on."""
        return [_STATUSES[int(code)] for code in self.status_code]

    @property
    def use(self) -> list[HandsetUse]:
        """What became of each epoch."""
        return [_USES[int(code)] for code in self.use_code]

    @property
    def frame_use(self) -> list[HandsetUse]:
        """What became of each step of the camera."""
        return [_USES[int(code)] for code in self.frame_use_code]

    def error_m(self, truth_m: npt.ArrayLike) -> _Array:
        """Distance from the truth, shape (n,): `truth_m` has shape (n, 2)."""
        return np.asarray(np.linalg.norm(self.position_m - np.asarray(truth_m, dtype=np.float64), axis=-1))

    def nees(self, truth_m: npt.ArrayLike) -> _Array:
        """Squared error in the stated covariance, shape (n,); 2 on average where that is right."""
        error = self.position_m - np.asarray(truth_m, dtype=np.float64)
        return np.asarray(np.sum(error * np.linalg.solve(self.covariance_m2, error[..., None])[..., 0], axis=-1))

    def __repr__(self) -> str:
        return f"HandsetRun({len(self.t_s)} epochs of {self.p_los.shape[1]} links)"


def _square(name: str, value: npt.ArrayLike | None, n: int) -> _Array:
    """An (n, n) array, from the same, from variances (n,) or from one number."""
    if value is None:
        return np.zeros((n, n))
    array = floats(name, value)
    if array.ndim == 0:
        return np.asarray(float(array) * np.eye(n))
    return np.diag(array) if array.shape == (n,) else array


def _each_link(name: str, value: npt.ArrayLike, links: int) -> _Array:
    array = floats(name, value)
    if array.shape != (links,):
        raise ValueError(f"{name}: shape ({links},) expected, got {array.shape}")
    return array


def _all_links(name: str, value: npt.ArrayLike, links: int) -> _Array:
    """The same, or one number for all."""
    array = floats(name, value)
    return np.full(links, float(array)) if array.ndim == 0 else _each_link(name, array, links)


class HandsetLocator:
    """Ranges, bearings and steps of a camera in, a position out (nielsen 4.2.3).

    Model: the range to node l is ``|p - q_l| + b + s_l e_l`` plus noise: b the clock's bias in metres, s_l a Boolean
    that switches as a Markov chain, e_l the excess delay without line of sight. The camera's step {dx, dy, da_z}, in
    the axes of the previous body, moves the foot point below the camera; what the fitted plane is off shifts the foot
    point of its frame only and does not add up. Each particle draws the Booleans given the range and carries a joint
    Gaussian of pose, clock, excess delays, offsets and unknown places (Rao-Blackwellised).

    Frame: planar, right-handed, z up, metres; heading a_z from x towards y; a body's first axis is the image's right,
    its second the image's up.

    Parameters
    ----------
    nodes_m : array_like, shape (L, 2) or (L, 3)
        Antennas, at most 12; two columns put them at the handset's height.
    filter : {"control", "measurement"}
        Type 1: steps move the particles. Type 2: they are measurements of a walk of nearly constant velocity.
    clock : {"common", "separate"}
        One receiver bias, or one for each node.
    height_m : float
        Of the handset's antenna.
    start_m : array_like, shape (2,)
    node_sigma_m : array_like, shape (L,), optional
        Above zero: the node's place is estimated from `nodes_m` on, with this 1-sigma of each coordinate.
    room_m : array_like, shape (n, 2), optional
        Polygon that is not left.
    walls_m : array_like, shape (n, 4), optional
        x0, y0, x1, y1 of walls that are not walked through.
    **options
        ``particles`` (2000), ``seed`` (0), ``ess_threshold`` (0.5); the start: ``start_sigma_m`` (10),
        ``start_heading_rad`` (0), ``start_heading_sigma_rad`` (3.2; pi or more: unknown); ``kernel`` (0.35),
        ``kernel_m`` (2), ``kernel_rad`` (0.12): each particle's own share of the start's spread and its limits; the
        clock: ``clock_start_m`` (0), ``clock_sigma_m`` (1000), ``clock_walk_m2ps`` (0.04),
        ``clock_frequency_walk_m2ps3`` (0), ``clock_drift_sigma_mps`` (0); nodes: ``node_offset_sigma_m`` (0),
        ``node_offset_walk_m2ps`` (0); links: ``nlos`` (True), ``mean_los_s`` (10), ``mean_nlos_s`` (5),
        ``excess_min_m`` (4), ``excess_max_m`` (20), ``excess_walk_m2ps`` (0.025), ``multipath_sigma_m`` (0; above
        zero: an error of each range that changes as the handset walks), ``multipath_length_m`` (1; walked until its
        correlation is 1/e), ``outlier_probability`` (1e-3), ``outlier_span_m`` (200), ``recover_after`` (10 epochs);
        motion: ``acceleration_psd_m2ps3`` (0.5),
        ``start_speed_sigma_mps`` (1), ``turn_psd_rad2ps`` (0.5), ``coast_psd_m2ps`` (0.5), ``coast_turn_psd_rad2ps``
        (0.1), ``coast_after_s`` (0.25), ``max_speed_mps`` (100; no step is faster), ``max_disagreement_s`` (2).

    Raises
    ------
    ValueError
        For an option that is unknown or out of range. Bad observations are no error: see `HandsetReport.use`.
    """

    def __init__(
        self,
        nodes_m: npt.ArrayLike,
        *,
        filter: str = "control",
        clock: str = "common",
        height_m: float = 0.0,
        start_m: npt.ArrayLike = (0.0, 0.0),
        node_sigma_m: npt.ArrayLike | None = None,
        room_m: npt.ArrayLike | None = None,
        walls_m: npt.ArrayLike | None = None,
        **options: float,
    ) -> None:
        self._make(nodes_m, filter, clock, height_m, start_m, node_sigma_m, room_m, walls_m, False, options)

    def _make(
        self,
        nodes_m: npt.ArrayLike,
        filter: str,
        clock: str,
        height_m: float,
        start_m: npt.ArrayLike,
        node_sigma_m: npt.ArrayLike | None,
        room_m: npt.ArrayLike | None,
        walls_m: npt.ArrayLike | None,
        alone: bool,
        options: dict[str, Any],
    ) -> None:
        self.nodes_m = floats("nodes_m", nodes_m)
        self._core = _navigation.HandsetLocator(
            self.nodes_m,
            named("filter", filter, _FILTERS),
            named("clock", clock, _CLOCKS),
            float(height_m),
            floats("start_m", start_m),
            _NONE if node_sigma_m is None else floats("node_sigma_m", node_sigma_m),
            _NONE if room_m is None else floats("room_m", room_m),
            _NONE if walls_m is None else floats("walls_m", walls_m),
            alone,
            **options,
        )

    @classmethod
    def lte_alone(
        cls,
        nodes_m: npt.ArrayLike,
        *,
        clock: str = "common",
        height_m: float = 0.0,
        start_m: npt.ArrayLike = (0.0, 0.0),
        **options: float,
    ) -> HandsetLocator:
        """What it is compared with: one extended Kalman filter of nearly constant velocity, one clock, no Booleans."""
        made = cls.__new__(cls)
        made._make(nodes_m, "measurement", clock, height_m, start_m, None, None, None, True, options)
        return made

    @property
    def links(self) -> int:
        """Number of nodes."""
        return len(self.nodes_m)

    @property
    def dimension(self) -> int:
        """How many numbers each particle's Gaussian has."""
        return self._core.dimension

    def move(
        self,
        motion: _Motion | npt.ArrayLike,
        t_s: float,
        *,
        track_covariance: npt.ArrayLike | None = None,
        foot_covariance_previous: npt.ArrayLike | None = None,
        foot_covariance: npt.ArrayLike | None = None,
    ) -> HandsetReport:
        """One step of the camera, which ends at `t_s`.

        Parameters
        ----------
        motion : PlanarMotion or array_like, shape (3,)
            Of `vision.EgoMotion` (one that is not ``ok`` coasts), or dx, dy [m] in the axes of the previous body and
            da_z [rad].
        t_s : float
        track_covariance : array_like, shape (3, 3) or (3,), optional
            Of numbers: what is independent from step to step, as a covariance or variances.
        foot_covariance_previous, foot_covariance : float or array_like, shape (2, 2) or (2,), optional
            Of the foot points that the planes of both frames give, each in its own body's axes.

        Returns
        -------
        HandsetReport
        """
        if isinstance(motion, _Motion):
            if not motion.ok:
                return self.coast(t_s)
            return self._core.move(
                t_s,
                floats("increment", motion.increment),
                floats("track_covariance", motion.track_covariance),
                floats("foot_covariance_previous", motion.foot_covariance_previous),
                floats("foot_covariance", motion.foot_covariance),
            )
        return self._core.move(
            t_s,
            floats("increment", motion),
            _square("track_covariance", track_covariance, 3),
            _square("foot_covariance_previous", foot_covariance_previous, 2),
            _square("foot_covariance", foot_covariance, 2),
        )

    def coast(self, t_s: float) -> HandsetReport:
        """A frame at `t_s` without a step: the pose becomes less certain."""
        return self._core.coast(t_s)

    def update_ranges(self, ranges_m: npt.ArrayLike, sigma_m: npt.ArrayLike, t_s: float) -> HandsetReport:
        """Ranges to all nodes at `t_s`.

        Parameters
        ----------
        ranges_m : array_like, shape (L,)
            NaN: not heard.
        sigma_m : float or array_like, shape (L,)
        t_s : float

        Returns
        -------
        HandsetReport

        Raises
        ------
        ValueError
            For shapes that do not fit.
        """
        return self._core.update_ranges(
            _each_link("ranges_m", ranges_m, self.links), _all_links("sigma_m", sigma_m, self.links), t_s
        )

    def update_bearings(
        self,
        bearings_rad: npt.ArrayLike,
        sigma_rad: npt.ArrayLike,
        t_s: float,
        *,
        of_body: bool = True,
        mirror_rad: npt.ArrayLike | None = None,
    ) -> HandsetReport:
        """Bearings to the nodes at `t_s`, as a synthetic array gives them.

        Parameters
        ----------
        bearings_rad : array_like, shape (L,)
            From the body's first axis, or from the frame's x, towards y. NaN: none.
        sigma_rad : float or array_like, shape (L,)
        t_s : float
        of_body : bool
            Which of the two.
        mirror_rad : array_like, shape (L,), optional
            Second answers of a straight array, as likely as the first.

        Returns
        -------
        HandsetReport

        Raises
        ------
        ValueError
            For shapes that do not fit.
        """
        return self._core.update_bearings(
            _each_link("bearings_rad", bearings_rad, self.links),
            _all_links("sigma_rad", sigma_rad, self.links),
            t_s,
            of_body,
            _NONE if mirror_rad is None else _each_link("mirror_rad", mirror_rad, self.links),
        )

    def estimate(self) -> HandsetEstimate:
        """Where the handset is, as of all observations so far."""
        return self._core.estimate()

    def particles(self, *, draw: bool = False) -> _Array:
        """Rows x, y, heading and weight; shape (4, particles).

        With `draw` a place is drawn from each particle's Gaussian, for plots; otherwise it is that Gaussian's mean.
        """
        return self._core.particles(draw)

    def run(
        self,
        frame_s: npt.ArrayLike,
        increments: npt.ArrayLike,
        epoch_s: npt.ArrayLike,
        ranges_m: npt.ArrayLike,
        *,
        sigma_m: npt.ArrayLike,
        track_covariance: npt.ArrayLike | None = None,
        foot_covariance: npt.ArrayLike | None = None,
    ) -> HandsetRun:
        """All steps and ranges of a recording in the order of their times, and an estimate after each epoch.

        Parameters
        ----------
        frame_s : array_like, shape (f,)
            Empty: no camera.
        increments : array_like, shape (f - 1, 3)
            NaN: no step known.
        epoch_s : array_like, shape (n,)
        ranges_m : array_like, shape (n, L)
            NaN: not heard.
        sigma_m : float or array_like, shape (L,) or (n, L)
        track_covariance : array_like, shape (3,), (3, 3) or (f - 1, 3, 3), optional
        foot_covariance : array_like, shape (2,), (2, 2) or (f, 2, 2), optional

        Returns
        -------
        HandsetRun
        """
        epochs = floats("epoch_s", epoch_s)
        ranges = floats("ranges_m", ranges_m)
        sigma = floats("sigma_m", sigma_m)
        if sigma.ndim == 0:
            sigma = np.full(self.links, float(sigma))
        numbers, p_los, excess, codes, frame_use = self._core.run(
            floats("frame_s", frame_s),
            floats("increments", increments),
            _square("track_covariance", track_covariance, 3),
            _square("foot_covariance", foot_covariance, 2),
            epochs,
            ranges,
            sigma,
        )
        columns = [np.ascontiguousarray(numbers[:, k]) for k in range(6, 13)]
        heading, heading_sigma, clock, clock_sigma, ess, mode_share, evidence = columns
        return HandsetRun(
            t_s=epochs,
            position_m=np.ascontiguousarray(numbers[:, :2]),
            covariance_m2=np.ascontiguousarray(numbers[:, 2:6]).reshape(-1, 2, 2),
            heading_rad=heading,
            heading_sigma_rad=heading_sigma,
            clock_m=clock,
            clock_sigma_m=clock_sigma,
            p_los=p_los,
            excess_m=excess,
            ess=ess,
            mode_share=mode_share,
            log_evidence=evidence,
            status_code=np.ascontiguousarray(codes[:, 0]),
            use_code=np.ascontiguousarray(codes[:, 1]),
            frame_use_code=frame_use,
        )

    def reset(self, seed: int = 0) -> None:
        """As new, with another seed."""
        if seed < 0:
            raise ValueError(f"seed = {seed}: a number that is not negative expected")
        self._core.reset(seed)

    def __repr__(self) -> str:
        return f"HandsetLocator({self.links} nodes, {self._core.estimate()!r})"
