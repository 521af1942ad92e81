"""What every scenario says, and what every system hands back.

Frames: positions are local metres. Their axes are x and y (and z, up); where the frame has a geodetic origin, x is east
and y north, or, with ``axes = "ned"``, x is north, y east and z down. Planar headings are counted from x towards y.
Errors are estimate minus truth, angles the short way round.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from soopnav_cpp.config import Model
from soopnav_cpp.estimation import UpdateStatus

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Latitude",
    "Longitude",
    "Origin",
    "Scenario",
    "System",
    "SystemRun",
    "Truth",
    "Updates",
    "figures_of",
    "files_of",
    "numbers_of",
]

Array = npt.NDArray[np.float64]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=360.0)]


class Origin(Model):
    """Where local metres lie on the Earth (WGS-84, height above the ellipsoid)."""

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_m: float = 0.0


class Scenario(Model):
    """What stands at the head of every scenario; a system's own model adds its keys.

    Attributes
    ----------
    system : str
        Which system goes through it.
    title : str
        Headline of the report.
    duration_s : float
        How long it lasts.
    runs : int
        Monte-Carlo runs; ``--runs`` overrides it.
    seed : int
        Names the random numbers of all runs; ``--seed`` overrides it.
    metrics_start_s : float
        Errors count from this time on, so that a start that is known exactly, or not at all, need not count.
    origin : table, optional
        Places the local frame on the Earth (latitude_deg, longitude_deg, height_m): NMEA and a GeoJSON for maps need
        it.
    start_utc : date and time, optional
        When time 0 is, for NMEA; without it midnight of 1 January 2000.
    """

    system: str
    title: str = ""
    duration_s: Annotated[float, Field(gt=0.0, le=1e6)]
    runs: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    metrics_start_s: Annotated[float, Field(ge=0.0)] = 0.0
    origin: Origin | None = None
    start_utc: datetime.datetime | None = None

    @pydantic.model_validator(mode="after")
    def _something_counts(self) -> Scenario:
        if self.metrics_start_s >= self.duration_s:
            raise ValueError(
                f"metrics_start_s: {self.metrics_start_s:g} leaves nothing of {self.duration_s:g} s (duration_s)"
            )
        return self


def _set(item: Any, name: str, value: object) -> None:
    object.__setattr__(item, name, value)


def _array(item: Any, name: str, shape: tuple[int | None, ...], *, finite: bool = True) -> None:
    """Make the attribute a float64 array of this shape (None: any length), or say what does not fit."""
    value = getattr(item, name)
    if value is None:
        return
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != len(shape) or any(s not in (None, n) for s, n in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("n" if s is None else str(s) for s in shape)
        raise ValueError(f"{name}: expected shape ({wanted}), got {array.shape}")
    if finite and not np.isfinite(array).all():
        place = ", ".join(str(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{place}]: a finite number expected")
    _set(item, name, array)


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What was so, at the times of the run.

    Attributes
    ----------
    position_m : ndarray, shape (n, d)
    velocity_mps : ndarray, shape (n, d), or None
    heading_rad : ndarray, shape (n,), or None
    quaternion_wxyz : ndarray, shape (n, 4), or None
    state : ndarray, shape (n, k), or None
        In the order of the run's `state_names`. The error of the state is ``state - truth.state``; components whose
        name ends in ``_rad`` go the short way round. A system whose state has no such difference (a quaternion) gives
        the error itself as its `state`, and zeros here.
    """

    position_m: Array
    velocity_mps: Array | None = None
    heading_rad: Array | None = None
    quaternion_wxyz: Array | None = None
    state: Array | None = None

    def __post_init__(self) -> None:
        _array(self, "position_m", (None, None))
        n, d = self.position_m.shape
        _array(self, "velocity_mps", (n, d))
        _array(self, "heading_rad", (n,))
        _array(self, "quaternion_wxyz", (n, 4))
        _array(self, "state", (n, None))


@dataclass(frozen=True, kw_only=True, eq=False)
class Updates:
    """Every scalar measurement that was offered to the filter, whatever became of it.

    Attributes
    ----------
    t_s : ndarray, shape (m,)
    source : ndarray of int, shape (m,)
        Whose it was: an index, into `source_names` where there are any.
    innovation : ndarray, shape (m,)
        Measured minus predicted; NaN where nothing was measured.
    variance : ndarray, shape (m,)
        That the filter expected of it.
    status : ndarray, shape (m,)
        `UpdateStatus`, its numbers, or words; kept as words in lower case (``"accepted"``, ``"gated"``).
    gate : ndarray, shape (m,), or None
        Largest innovation that would have passed.
    source_names : tuple of str
        Without any they are counted from 1.
    unit : str
        Of the innovations.
    """

    t_s: Array
    source: npt.NDArray[np.int64]
    innovation: Array
    variance: Array
    status: npt.NDArray[np.str_]
    gate: Array | None = None
    source_names: tuple[str, ...] = ()
    unit: str = "m"

    def __post_init__(self) -> None:
        _array(self, "t_s", (None,))
        m = len(self.t_s)
        for name in ("innovation", "variance", "gate"):
            _array(self, name, (m,), finite=False)
        source = np.asarray(self.source)
        if source.shape != (m,) or not (source.size == 0 or np.issubdtype(source.dtype, np.integer)):
            raise ValueError(f"source: expected {m} integers, got {source.dtype} of shape {source.shape}")
        if m and source.min() < 0:
            raise ValueError(f"source: {source.min()}: no negative index expected")
        names = tuple(self.source_names) or tuple(f"source {i + 1}" for i in range(int(source.max(initial=-1)) + 1))
        if m and source.max() >= len(names):
            raise ValueError(f"source: {source.max()} among {len(names)} source_names")
        words = [_status_word(value) for value in self.status]
        if len(words) != m:
            raise ValueError(f"status: expected {m}, got {len(words)}")
        _set(self, "source", source.astype(np.int64))
        _set(self, "source_names", names)
        _set(self, "status", np.array(words, dtype=np.str_))

    @property
    def nis(self) -> Array:
        """Normalised innovation squared, shape (m,); NaN where there is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            nis = np.square(self.innovation) / self.variance
        return np.where(np.isfinite(nis) & (self.variance > 0.0), nis, np.nan)

    @property
    def accepted(self) -> npt.NDArray[np.bool_]:
        """Which went into the filter, shape (m,)."""
        return np.asarray(self.status == "accepted")

    @property
    def offered(self) -> npt.NDArray[np.bool_]:
        """Which were measured at all, shape (m,)."""
        return np.asarray(self.status != "absent")


def _status_word(value: object) -> str:
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        value = UpdateStatus(int(value))
    word = getattr(value, "name", value)
    if not isinstance(word, str) or not word:
        raise ValueError(f"status: {value!r}: an UpdateStatus or a word expected")
    return word.lower()


@dataclass(frozen=True, kw_only=True, eq=False)
class SystemRun:
    """What one run of a system gave. Checked when it is made: shapes fit, time rises, the estimate is finite.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, d)
        d is 2 or 3.
    position_covariance_m2 : ndarray, shape (n, d, d)
    velocity_mps : ndarray, shape (n, d), or None
    heading_rad : ndarray, shape (n,), or None
    quaternion_wxyz : ndarray, shape (n, 4), or None
        Turns body vectors into the local frame.
    state_names : tuple of str
        With units: ``"x_m"``, ``"heading_rad"``, ``"clock_bias_m"``.
    state, covariance : ndarray, shapes (n, k) and (n, k, k)
    truth : Truth or None
    updates : Updates or None
    baselines : dict of str to ndarray, shape (n, d)
        Positions that others would have found, such as "INS alone".
    sources : dict of str to ndarray, shape (d,)
        Transmitters and reflectors, for the map.
    notes : tuple of str
        Sentences about what the user should know: "IMU gap of 1.2 s at 34.0 s, bridged".
    origin_lla_deg : tuple or None
        Latitude, longitude [deg] and height [m] of the local frame's origin; None: that of the scenario, if it has one.
    axes : str
        ``"enu"`` or ``"ned"``.
    """

    t_s: Array
    position_m: Array
    position_covariance_m2: Array
    velocity_mps: Array | None = None
    heading_rad: Array | None = None
    quaternion_wxyz: Array | None = None
    state_names: tuple[str, ...] = ()
    state: Array | None = None
    covariance: Array | None = None
    truth: Truth | None = None
    updates: Updates | None = None
    baselines: Mapping[str, Array] = field(default_factory=dict)
    sources: Mapping[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    origin_lla_deg: tuple[float, float, float] | None = None
    axes: Literal["enu", "ned"] = "enu"

    def __post_init__(self) -> None:
        _array(self, "t_s", (None,))
        n = len(self.t_s)
        if n == 0:
            raise ValueError("t_s: at least one time expected")
        if np.any(np.diff(self.t_s) <= 0.0):
            k = int(np.argmax(np.diff(self.t_s) <= 0.0)) + 1
            raise ValueError(f"t_s[{k}] = {self.t_s[k]:g} after {self.t_s[k - 1]:g}: time must rise")
        _array(self, "position_m", (n, None))
        d = self.position_m.shape[1]
        if d not in (2, 3):
            raise ValueError(f"position_m: two or three components expected, got {d}")
        _array(self, "position_covariance_m2", (n, d, d))
        _array(self, "velocity_mps", (n, d))
        _array(self, "heading_rad", (n,))
        _array(self, "quaternion_wxyz", (n, 4))
        k = len(self.state_names)
        _array(self, "state", (n, k))
        _array(self, "covariance", (n, k, k))
        if self.truth is not None:
            if self.truth.position_m.shape != (n, d):
                raise ValueError(f"truth.position_m: expected shape ({n}, {d}), got {self.truth.position_m.shape}")
            if self.truth.state is not None and self.truth.state.shape != (n, k):
                raise ValueError(f"truth.state: expected shape ({n}, {k}), got {self.truth.state.shape}")
        for name, shape in (("baselines", (n, d)), ("sources", (d,))):
            items = {key: np.asarray(value, np.float64) for key, value in getattr(self, name).items()}
            for key, value in items.items():
                if value.shape != shape:
                    raise ValueError(f"{name}[{key!r}]: expected shape {shape}, got {value.shape}")
            _set(self, name, items)
        if self.axes not in ("enu", "ned"):
            raise ValueError(f"axes: {self.axes!r}: enu or ned expected")

    def __repr__(self) -> str:
        parts = [f"{len(self.t_s)} epochs", f"{self.t_s[0]:g} … {self.t_s[-1]:g} s", f"{self.position_m.shape[1]}-D"]
        given = [f.name for f in fields(self) if f.name in ("truth", "updates", "baselines") and getattr(self, f.name)]
        return f"SystemRun({', '.join(parts)}{', with ' if given else ''}{', '.join(given)})"


class System(Protocol):
    """A system that scenarios can be written for: an instance of a class at module level, so that it can be pickled.

    It may also have ``title`` (a line for ``--list``), ``example`` (a scenario to start from, as TOML text),
    ``figures(scenario, run)``, which returns further figures by name, ``files(scenario, run, folder)``, which writes
    further files and returns those that the report shows (GIF or PNG) by caption, and ``numbers(scenario, run)``, which
    returns further numbers for metrics.json, of the run whose files are written.
    """

    @property
    def name(self) -> str:
        """What stands at ``system =``."""

    @property
    def scenario(self) -> type[Scenario]:
        """The model of its scenarios."""

    def run(self, scenario: Any, seed: int) -> SystemRun:
        """One run. All randomness comes from the seed: the same seed gives the same bits."""


def figures_of(system: System, scenario: Scenario, run: SystemRun) -> dict[str, Figure]:
    """Figures that the system itself draws, by name; most draw none."""
    draw = getattr(system, "figures", None)
    return {} if draw is None else dict(draw(scenario, run))


def files_of(system: System, scenario: Scenario, run: SystemRun, folder: Path) -> dict[str, Path]:
    """Files that the system itself writes and the report is to show, by caption; most write none."""
    write = getattr(system, "files", None)
    return {} if write is None else dict(write(scenario, run, folder))


def numbers_of(system: System, scenario: Scenario, run: SystemRun) -> dict[str, Any]:
    """What the system itself says of the run in metrics.json; most say nothing."""
    say = getattr(system, "numbers", None)
    return {} if say is None else dict(say(scenario, run))
