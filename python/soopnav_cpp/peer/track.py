"""Step four: the target's track, from where it may be to where it is; kept in a file over a restart."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp.navigation import CooperativeRun, CooperativeTracker, PairBursts, PairStartStatus
from soopnav_cpp.peer.beacons import Beacons

__all__ = ["Measured", "Track"]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_FORMAT = "soopnav peer state 1"
_EKF_WITHIN_M = 10e3  # further off a batch starts the track
_RADIUS_M = (6e6, 1e8)  # of a place in a state that is read
_MOST_MPS = 1e5  # its speed
_MOST_CLOCK_S, _MOST_SKEW = 10.0, 1e-2
_PATIENCE = 4  # batches, after which a start is taken although another place fits as well


@dataclass(frozen=True)
class Measured:
    """A burst that both heard; fields as `navigation.PairBursts`, and how it was exchanged."""

    t_s: float
    beacon: int
    tdoa_s: float
    fdoa_hz: float
    covariance: _Array
    carrier_hz: float
    anchor_position_e_m: _Array
    anchor_velocity_e_mps: _Array
    bits: int
    snr_db: float


def _bursts(rows: list[Measured]) -> PairBursts:
    return PairBursts(
        t_s=np.array([m.t_s for m in rows]),
        beacon=np.array([m.beacon for m in rows], np.int64),
        tdoa_s=np.array([m.tdoa_s for m in rows]),
        fdoa_hz=np.array([m.fdoa_hz for m in rows]),
        covariance=np.array([m.covariance for m in rows]),
        carrier_hz=np.array([m.carrier_hz for m in rows]),
        anchor_position_e_m=np.array([m.anchor_position_e_m for m in rows]),
        anchor_velocity_e_mps=np.array([m.anchor_velocity_e_mps for m in rows]),
    )


def _beside(file: Path) -> Path:
    return file.with_name(file.name + ".new")


def _check_mean(mean: _Array) -> None:
    """Refuse what no receiver near the Earth can have; NaN as well."""
    radius_m, speed_mps = float(np.hypot.reduce(mean[:3])), float(np.hypot.reduce(mean[3:6]))
    if not _RADIUS_M[0] <= radius_m <= _RADIUS_M[1]:
        raise ValueError(f"a place {radius_m:g} m from the Earth's centre")
    if not speed_mps <= _MOST_MPS:
        raise ValueError(f"a speed of {speed_mps:g} m/s")
    offset_s, skew = (float(x) / _LIGHT_MPS for x in mean[6:])
    if not (abs(offset_s) <= _MOST_CLOCK_S and abs(skew) <= _MOST_SKEW):
        raise ValueError(f"a clock {offset_s:g} s off with a skew of {skew:g}")


@dataclass
class History:
    """What came of each measurement, in their order."""

    measured: list[Measured] = field(default_factory=list)
    use: list[str] = field(default_factory=list)
    mean: list[_Array] = field(default_factory=list)
    covariance: list[_Array] = field(default_factory=list)
    innovation: list[_Array] = field(default_factory=list)
    innovation_sigma: list[_Array] = field(default_factory=list)


class Track:
    """Where the target is.

    Parameters
    ----------
    beacons : Beacons
    guess_e_m : ndarray, shape (3,)
        Where it may be, ECEF.
    within_m : float
        Standard deviation of that, each axis. Up to 10 km the filter starts there; further off a batch of bursts
        starts it.
    clock_s, skew : float
        Bounds of the difference of the two clocks: the start's standard deviations are half of them.
    height_sigma_m : float
        Of the guess's height above the ellipsoid; infinite: not known.
    height_m : float
    batch : int
        Bursts of the batch.
    state : path, optional
        Where the track is kept; one that is there is gone on with.
    **options
        For `navigation.CooperativeTracker`: clocks, motion. The errors of orbits are those of the elements' age
        (`Beacons.orbit_error`) unless told otherwise.

    Attributes
    ----------
    tracker : navigation.CooperativeTracker
    history : History
    running : bool
        There is a track.
    resume_unix_s : float
        Of the state that was read; NaN without one.

    Raises
    ------
    ValueError
        For options out of range, a state that cannot be read, and one that cannot be kept where `state` says.
    """

    def __init__(
        self,
        beacons: Beacons,
        guess_e_m: npt.ArrayLike,
        *,
        within_m: float = 5e3,
        clock_s: float = 5e-3,
        skew: float = 4e-6,
        height_m: float = 0.0,
        height_sigma_m: float = math.inf,
        batch: int = 40,
        state: str | os.PathLike[str] | None = None,
        **options: Any,
    ) -> None:
        self.guess_e_m = np.asarray(guess_e_m, np.float64)
        if self.guess_e_m.shape != (3,) or not np.isfinite(self.guess_e_m).all():
            raise ValueError(f"guess_e_m = {self.guess_e_m}: three finite numbers expected")
        if not (math.isfinite(within_m) and within_m > 0.0):
            raise ValueError(f"within_m = {within_m:g}: a finite number above zero expected")
        if batch < 10:
            raise ValueError(f"batch = {batch}: at least 10 expected")
        self.within_m = float(within_m)
        self.history = History()
        self.resume_unix_s = math.nan
        self.running = False
        self._beacons, self._batch, self._first_batch = beacons, batch, batch
        self._clock_s, self._skew = clock_s, skew
        self._waiting: list[Measured] = []
        self._file = None if state is None else Path(state)
        self.tracker = CooperativeTracker(
            beacons.orbits,
            height_m=height_m,
            height_sigma_m=height_sigma_m,
            beacon_epoch_s=beacons.epoch_s,
            **{**beacons.orbit_error(), **options},
        )
        if self._file is not None:
            self._prepare(self._file)

    def add(self, measured: Measured) -> str:
        """Take a measurement; what became of it, in a word or two: ``used``, ``waiting``, ``refused: ...``."""
        h = self.history
        h.measured.append(measured)
        use, run = self._take(measured)
        h.use.append(use)
        h.mean.append(self.tracker.mean.copy() if self.running else np.full(8, math.nan))
        h.covariance.append(self.tracker.covariance.copy() if self.running else np.full((8, 8), math.nan))
        has = run is not None
        h.innovation.append(run.innovation[-1].copy() if has and run is not None else np.full(2, math.nan))
        sigma = np.full(2, math.nan)
        if run is not None:
            sigma = np.sqrt(np.maximum(np.diag(run.innovation_covariance[-1]), 0.0))
        h.innovation_sigma.append(sigma)
        if use == "used" and self._file is not None:
            self.write()
        return use

    def _take(self, measured: Measured) -> tuple[str, CooperativeRun | None]:
        if not self.running:
            if self.within_m > _EKF_WITHIN_M:
                self._waiting.append(measured)
                if len(self._waiting) < self._batch:
                    return "waiting", None
                found = self.tracker.start(
                    _bursts(self._waiting),
                    guess_e_m=self.guess_e_m,
                    search_radius_m=4.0 * self.within_m,
                    alpha_sigma_mps=_LIGHT_MPS * self._skew,
                )
                late = found.status == PairStartStatus.AMBIGUOUS and len(self._waiting) >= _PATIENCE * self._first_batch
                if found.status == PairStartStatus.FOUND or late:
                    self._waiting.clear()
                    self.running = True
                    return "used", None
                self._batch += max(1, self._batch // 4)
                return "waiting", None
            mean = np.concatenate([self.guess_e_m, np.zeros(5)])
            static = self.tracker.motion == "static"
            sigma = [self.within_m] * 3 + [1e-3 if static else 30.0] * 3
            sigma += [0.5 * _LIGHT_MPS * self._clock_s, 0.5 * _LIGHT_MPS * self._skew]
            self.tracker.start_at(measured.t_s - 1e-3, mean, np.diag(np.square(sigma)))
            self.running = True
        run = self.tracker.update(_bursts([measured]))
        if bool(run.accepted[-1]):
            return "used", run
        return f"refused: {run.use[-1].name.lower().replace('_', ' ')}", run

    def write(self) -> None:
        """Keep the track in its file: written beside it first, so that a file is always whole."""
        if self._file is None or not self.running:
            return
        content = {
            "format": _FORMAT,
            "reference_unix_s": self._beacons.reference_unix_s,
            "t_s": self.tracker.t_s,
            "mean": self.tracker.mean.tolist(),
            "covariance": self.tracker.covariance.tolist(),
        }
        beside = _beside(self._file)
        try:
            beside.write_text(json.dumps(content), encoding="utf-8")
            beside.replace(self._file)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._file)) from error

    def _prepare(self, file: Path) -> None:
        """Read a state that is there, and see whether one can be written: not first after a long wait for a burst."""
        try:
            if file.exists():
                self._read(file)
                self.write()
            else:
                _beside(file).touch()
                _beside(file).unlink()
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ValueError(f"{file} (--state): the track cannot be kept there: {reason}") from error

    def _read(self, file: Path) -> None:
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            if content["format"] != _FORMAT:
                raise ValueError(f"format {content['format']!r}")
            t_unix = float(content["reference_unix_s"]) + float(content["t_s"])
            mean = np.array(content["mean"], np.float64)
            covariance = np.array(content["covariance"], np.float64)
            if mean.shape != (8,) or covariance.shape != (8, 8) or not math.isfinite(t_unix):
                raise ValueError("its shapes")
            _check_mean(mean)
            t_s = float(content["t_s"]) + (float(content["reference_unix_s"]) - self._beacons.reference_unix_s)
            self.tracker.start_at(t_s, mean, covariance)
            self.running = True
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"{file}: not a state of a target that was kept: {error}") from error
        self.resume_unix_s = t_unix
