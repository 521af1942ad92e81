"""The database in a file: what ``GET /v1/snapshot`` answers, to work from without a network.

Fixed records, little-endian, with a checksum (cpp/doc/signal_database.md); the engine reads and writes them
(``soopnav/navigation/sop_catalog.hpp``), here they become the sources that the service answers.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry
from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp.clock import ClockNoise
from soopnav_cpp.sopdb.fusion import Estimate, SourceState
from soopnav_cpp.sopdb.grading import aged
from soopnav_cpp.sopdb.records import AnsweredSource

__all__ = ["SUFFIX", "Catalog", "Prior", "encode", "read", "timeless", "write"]

SUFFIX = ".sopcat"
_ORIGIN = datetime(1970, 1, 1, tzinfo=timezone.utc)
_MICROSECOND = timedelta(microseconds=1)
_LIGHT_MPS = 299_792_458.0
_HEADER_BYTES, _RECORD_BYTES, _GRADE_AT, _CREATED_AT = 40, 624, 442, 24  # cpp/doc/signal_database.md


def _microseconds(at: datetime) -> int:
    return (at - _ORIGIN) // _MICROSECOND


def _time(microseconds: int) -> datetime:
    return _ORIGIN + timedelta(microseconds=microseconds)


@dataclass(frozen=True)
class Prior:
    """What a navigator may suppose about a source: metres and metres per second, as filters have clocks.

    Attributes
    ----------
    carrier_hz : float
    position : Estimate or None
        ECEF [m].
    clock : Estimate or None
        c times offset [m] and drift [m/s].
    noise : ClockNoise
        Mean of the uncertain coefficients; a TCXO's when none are known.
    noise_known : bool
    """

    carrier_hz: float
    position: Estimate | None
    clock: Estimate | None
    noise: ClockNoise
    noise_known: bool

    def as_source(self) -> dict[str, Any]:
        """Arguments of `soopnav_cpp.navigation.OpportunisticNavigator.add_source`, by name.

        ``navigator.add_source("tower", "cdma", **prior.as_source())``: position and clock are estimated from here on,
        each where the catalogue has it; a clock without offset starts from the navigator's own prior.
        """
        out: dict[str, Any] = {"carrier_hz": self.carrier_hz, "clock": self.noise}
        if self.position is not None:
            out |= {"position_e_m": self.position.value, "position_sigma_m": self.position.covariance}
        if self.clock is not None:
            bias_s, drift = (self.clock.value / _LIGHT_MPS).tolist()
            out |= {
                "clock_bias_s": bias_s,
                "clock_drift": drift,
                "clock_covariance": self.clock.covariance / _LIGHT_MPS**2,
            }
        return out


def _record(source: Mapping[str, Any]) -> dict[str, Any]:
    answered = AnsweredSource.model_validate(source)
    quality, clock, position, noise = answered.quality, answered.clock, answered.position, answered.noise
    newest = quality.newest if quality.newest is not None else _ORIGIN
    return {
        "id": answered.id,
        "name": answered.name,
        "kind": answered.kind,
        "carrier_hz": answered.carrier_hz,
        "contributions": quality.contributions,
        "newest_us": _microseconds(newest),
        "at_us": _microseconds(newest if clock is None else clock.epoch),
        "grade": quality.grade,
        "position": None if position is None else (position.p_e_m, position.covariance_m2),
        "clock": None if clock is None else ((clock.bias_s, clock.drift), clock.covariance),
        "noise": None if noise is None else ((np.log(noise.h0_s), np.log(noise.h_minus2_per_s)), noise.ln_covariance),
    }


def encode(sources: Iterable[Mapping[str, Any]], created: datetime) -> bytes:
    """The snapshot of answered sources.

    Parameters
    ----------
    sources : iterable of mapping
        As the service answers them (`AnsweredSource`), each at any time of its own.
    created : datetime

    Raises
    ------
    ValueError
        For a source that cannot be answered so, or an id twice.
    """
    return _navigation.sop_write_snapshot([_record(source) for source in sources], _microseconds(created))


def timeless(data: bytes) -> bytes:
    """A snapshot without what changes while no source does: when it was made, the checksum, and grades, which fall."""
    out = bytearray(data)
    out[_CREATED_AT:_HEADER_BYTES] = bytes(_HEADER_BYTES - _CREATED_AT)
    grades = slice(_HEADER_BYTES + _GRADE_AT, None, _RECORD_BYTES)
    out[grades] = bytes(len(out[grades]))
    return bytes(out)


def _at(state: SourceState, at: datetime) -> SourceState:
    """The state at any time: before its own as far back as `SourceState.moved` goes forth, like C++'s ``prior``."""
    if at >= state.at:
        return state.moved(at)
    try:
        later = state.at + (state.at - at)
    except OverflowError:
        raise ValueError(f"at = {at.isoformat()}: a time nearer to {state.at.isoformat()} expected") from None
    found = SourceState(state.at, state.position, _mirrored(state.clock), state.noise).moved(later)
    return SourceState(at, found.position, _mirrored(found.clock), found.noise)


def _mirrored(clock: Estimate | None) -> Estimate | None:
    """A clock in a time that runs backwards: the drift's sign turns."""
    if clock is None:
        return None
    sign = np.array([1.0, -1.0])
    return Estimate(sign * clock.value, np.outer(sign, sign) * clock.covariance)


class Catalog:
    """Sources of a snapshot.

    Parameters
    ----------
    data : bytes
        As `encode` gives them.

    Raises
    ------
    ValueError
        For anything else: another file, a newer version, cut off, damaged.
    """

    def __init__(self, data: bytes) -> None:
        self._core = _navigation.SopCatalog(data)

    def __len__(self) -> int:
        return len(self._core)

    def __iter__(self) -> Iterator[str]:
        """Ids, in their order."""
        return iter(self._core.ids())

    def __contains__(self, source_id: object) -> bool:
        return source_id in self._core.ids()

    def __repr__(self) -> str:
        return f"Catalog({len(self)} sources of {self.created.isoformat(timespec='seconds')})"

    @property
    def created(self) -> datetime:
        """When the snapshot was made."""
        return _time(self._core.created_us)

    def source(self, source_id: str, at: datetime | None = None) -> dict[str, Any]:
        """A source as the service would answer it, brought to `at` (without it as the snapshot has it).

        At a time before the snapshot's state of it the clock is run back, and every covariance grows all the same. The
        grade falls with age, as the service's does, and is never better than when the snapshot was made.

        Raises
        ------
        ValueError
            For an id that is not there.
        """
        found = self._core.source(source_id)
        parts = {
            name: None if found[name] is None else Estimate(*found[name]) for name in ("position", "clock", "noise")
        }
        state = SourceState(_time(found["at_us"]), **parts)
        if at is not None:
            state = _at(state, at)
        newest = _time(found["newest_us"])
        age_s = max(0.0, ((at or self.created) - newest).total_seconds())
        return {
            "id": found["id"],
            "kind": found["kind"],
            "name": found["name"],
            "carrier_hz": found["carrier_hz"],
            **state.answer(),
            "quality": {
                "contributions": found["contributions"],
                "newest": newest.isoformat().replace("+00:00", "Z"),
                "age_s": age_s,
                "grade": aged(found["grade"], age_s),
            },
        }

    def sources(
        self,
        at: datetime | None = None,
        *,
        kind: str | None = None,
        near: tuple[float, float] | None = None,
        radius_m: float | None = None,
    ) -> list[dict[str, Any]]:
        """Every source, or those of a kind, as `source` gives them; about a place the nearest first.

        Parameters
        ----------
        at : datetime, optional
        kind : str, optional
        near : (latitude, longitude) in degrees, optional
            Together with `radius_m`; at height 0.
        radius_m : float, optional
        """
        ids: Iterable[str] = self
        if near is not None and radius_m is not None:
            ids = self.near(geometry.geodetic_to_ecef(np.radians(near[0]), np.radians(near[1]), 0.0), radius_m)
        every = (self.source(source_id, at) for source_id in ids)
        return [source for source in every if kind is None or source["kind"] == kind]

    def near(self, p_e_m: npt.ArrayLike, radius_m: float) -> list[str]:
        """Ids of the sources within a distance of an ECEF position, nearest first."""
        return self._core.near(p_e_m, radius_m)

    def prior(self, source_id: str, at: datetime) -> Prior:
        """What a navigator starts the source with at a time.

        Raises
        ------
        ValueError
            For an id that is not there.
        """
        found = self._core.prior(source_id, _microseconds(at))
        return Prior(
            found["carrier_hz"],
            None if found["position"] is None else Estimate(*found["position"]),
            None if found["clock"] is None else Estimate(*found["clock"]),
            ClockNoise(*found["noise"]),
            found["has_noise"],
        )


def read(path: str | os.PathLike[str]) -> Catalog:
    """The catalogue of a file.

    Raises
    ------
    ValueError
        Naming the file, when it is not a snapshot.
    OSError
        When it cannot be read.
    """
    data = Path(path).read_bytes()
    try:
        return Catalog(data)
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: {error}") from error


def write(path: str | os.PathLike[str], data: bytes) -> Catalog:
    """Write a snapshot in place of a file, whole or not at all, and give its catalogue.

    Raises
    ------
    ValueError
        When the bytes are no snapshot; the file is then as it was.
    OSError
        When it cannot be written.
    """
    catalog = Catalog(data)
    target = Path(path)
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return catalog
