"""Mean elements of satellites from files, and their orbits by SGP4."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._extras import require

_DAY_S = 86400.0
_J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)
_J2000_DAY = 2451545.0
_REASONS = {
    1: "the mean eccentricity left 0 ... 1",
    2: "the mean motion fell below zero",
    3: "the perturbed eccentricity left 0 ... 1",
    4: "the semilatus rectum fell below zero",
    6: "the satellite has decayed",
}
_OMM_FIELDS = (
    "OBJECT_NAME",
    "OBJECT_ID",
    "NORAD_CAT_ID",
    "EPOCH",
    "MEAN_MOTION",
    "ECCENTRICITY",
    "INCLINATION",
    "RA_OF_ASC_NODE",
    "ARG_OF_PERICENTER",
    "MEAN_ANOMALY",
    "BSTAR",
)
_OMM_DEFAULTS = {
    "CLASSIFICATION_TYPE": "U",
    "EPHEMERIS_TYPE": "0",
    "ELEMENT_SET_NO": "0",
    "REV_AT_EPOCH": "0",
    "MEAN_MOTION_DOT": "0",
    "MEAN_MOTION_DDOT": "0",
}
_OMM_TEXT = ("OBJECT_NAME", "OBJECT_ID", "EPOCH", "CLASSIFICATION_TYPE")


def utc(when: datetime | str) -> datetime:
    """An instant as a datetime in UTC; text is ISO 8601, and without a zone it is UTC.

    Raises
    ------
    ValueError
        When the text is no time.
    """
    if isinstance(when, str):
        text = when.strip()
        try:
            when = datetime.fromisoformat(text[:-1] + "+00:00" if text.endswith(("Z", "z")) else text)
        except ValueError:
            raise ValueError(f"{text!r}: a time such as 2014-08-27T06:00:00Z expected") from None
    if when.tzinfo is None:
        return when.replace(tzinfo=timezone.utc)
    return when.astimezone(timezone.utc)


@dataclass(frozen=True)
class Satellite:
    """A satellite's mean elements, and where they say it is. Made by `read_tle` and `read_omm`.

    Attributes
    ----------
    name : str
    number : int
        In the catalogue.
    epoch : datetime
        Of the elements, UTC.
    source : tuple of str, or dict
        Two lines, or the fields of an orbit mean-elements message.
    """

    name: str
    number: int
    epoch: datetime
    source: tuple[str, str] | dict[str, str] = field(repr=False)

    def age_s(self, when: datetime | str) -> float:
        """How old the elements are at an instant; negative before their epoch."""
        return (utc(when) - self.epoch).total_seconds()

    def is_stale(self, when: datetime | str, *, limit_days: float = 7.0) -> bool:
        """Whether the elements are further from their epoch than a limit."""
        return abs(self.age_s(when)) > limit_days * _DAY_S

    def _record(self) -> Any:
        api = require("sgp4.api", "orbits", "satellites from elements")
        if isinstance(self.source, tuple):
            return api.Satrec.twoline2rv(*self.source)
        omm = require("sgp4.omm", "orbits", "satellites from elements")
        record = api.Satrec()
        omm.initialize(record, self.source)
        return record

    def teme(self, julian_day: float, fraction: Any) -> tuple[Any, Any]:
        """Positions [m] and velocities [m/s] in SGP4's own frame at Julian dates ``julian_day + fraction``.

        Parameters
        ----------
        julian_day : float
        fraction : array_like, shape (n,)

        Returns
        -------
        position_m, velocity_mps : ndarray, shape (n, 3)

        Raises
        ------
        ValueError
            When SGP4 has no answer, as for a decayed satellite.
        """
        days = np.asarray(fraction, dtype=np.float64)
        if days.ndim != 1 or not (np.isfinite(days).all() and math.isfinite(julian_day)):
            raise ValueError(f"julian_day, fraction: finite numbers of shape (n,) expected, got {days.shape}")
        error, position_km, velocity_kmps = self._record().sgp4_array(np.full(days.shape, julian_day), days)
        if np.any(error):
            first = int(np.flatnonzero(error)[0])
            when = _J2000 + timedelta(days=julian_day - _J2000_DAY + float(days[first]))
            reason = _REASONS.get(int(error[first]), f"SGP4 error {int(error[first])}")
            raise ValueError(f"{self.name} ({self.number}): no position at {when:%Y-%m-%dT%H:%M:%SZ}: {reason}")
        return 1e3 * position_km, 1e3 * velocity_kmps

    def sampled(
        self,
        start: datetime | str,
        duration_s: float,
        step_s: float = 10.0,
        *,
        reference: datetime | str | None = None,
        max_age_days: float = 30.0,
        ut1_minus_utc_s: float = 0.0,
    ) -> SampledOrbit:
        """The orbit as ECEF samples, from one step before a span to one step after it.

        Parameters
        ----------
        start : datetime or str
            UTC.
        duration_s, step_s : float
        reference : datetime or str, optional
            The instant that counts as time 0, `start` if none is given.
        max_age_days : float
            Elements further from their epoch are refused.
        ut1_minus_utc_s : float
            Within 0.9 s; left out it moves all satellites east or west by up to 470 m.

        Returns
        -------
        SampledOrbit

        Raises
        ------
        ValueError
            For a span or step that is none, elements too old, and a satellite that has decayed.
        """
        if not (math.isfinite(duration_s) and duration_s > 0.0):
            raise ValueError(f"duration_s: {duration_s}, a positive number expected")
        if not (math.isfinite(step_s) and step_s > 0.0):
            raise ValueError(f"step_s: {step_s}, a positive number expected")
        if not abs(ut1_minus_utc_s) <= 0.9:
            raise ValueError(f"ut1_minus_utc_s: {ut1_minus_utc_s}, at most 0.9 s to either side expected")
        begin = utc(start)
        age_days = max(abs(self.age_s(begin)), abs(self.age_s(begin) + duration_s)) / _DAY_S
        if not age_days <= max_age_days:
            raise ValueError(
                f"{self.name} ({self.number}): elements of {self.epoch:%Y-%m-%d} are {age_days:.1f} days off, "
                f"at most {max_age_days:g} allowed"
            )
        zero = begin if reference is None else utc(reference)
        offset = begin - _J2000
        day = _J2000_DAY + offset.days
        within_s = offset.seconds + offset.microseconds * 1e-6
        count = math.ceil(duration_s / step_s * (1.0 - 1e-12)) + 3
        seconds = within_s + step_s * np.arange(-1, count - 1)
        position_m, velocity_mps = self.teme(day, seconds / _DAY_S)
        p_e, v_e = _geometry.teme_to_ecef(day, (seconds + ut1_minus_utc_s) / _DAY_S, position_m, velocity_mps)
        return SampledOrbit((begin - zero).total_seconds() - step_s, step_s, p_e, v_e)


def _tle_checksum(line: str) -> int:
    return sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10


def read_tle(path: str | os.PathLike[str]) -> list[Satellite]:
    """Satellites of a file of two-line elements, with or without a line of the name before each pair.

    Raises
    ------
    ValueError
        Naming file and line: a line that is not 69 characters of its kind, a checksum that is wrong, lines of two
        satellites, a line without its other, numbers that are none. Also for a file without any.
    """
    api = require("sgp4.api", "orbits", "reading elements")
    file = Path(path)
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    found: list[Satellite] = []
    name, first = "", ""

    def refuse(number: int, sentence: str) -> ValueError:
        return ValueError(f"{file}:{number}: {sentence}")

    def checked(number: int, line: str) -> str:
        if len(line) != 69 or not line.isascii():
            raise refuse(number, f"69 characters of an element line expected, got {len(line)}")
        if not line[68].isdigit() or int(line[68]) != _tle_checksum(line):
            raise refuse(number, f"checksum {line[68]!r} is not {_tle_checksum(line)}")
        return line

    for number, raw in enumerate(lines, start=1):
        line = raw.rstrip()
        if not line.strip():
            continue
        if line.startswith("1 "):
            if first:
                raise refuse(number, "line 2 of the satellite before expected")
            first = checked(number, line)
        elif line.startswith("2 "):
            if not first:
                raise refuse(number, "line 1 before it expected")
            second = checked(number, line)
            if first[2:7] != second[2:7]:
                raise refuse(number, f"satellite {second[2:7].strip()}, but line 1 is of {first[2:7].strip()}")
            try:
                record = api.Satrec.twoline2rv(first, second)
                epoch = _epoch(record.jdsatepoch, record.jdsatepochF)
            except (ValueError, OverflowError) as error:
                raise refuse(number, f"numbers expected in their columns: {error}") from error
            if record.error:
                raise refuse(number, _REASONS.get(record.error, f"SGP4 error {record.error}"))
            found.append(Satellite(name or first[2:7].strip(), int(record.satnum), epoch, (first, second)))
            name, first = "", ""
        elif first:
            raise refuse(number, "line 2 of the satellite before expected")
        else:
            name = line.removeprefix("0 ").strip()
    if first:
        raise refuse(len(lines), "line 2 of the last satellite is missing")
    if not found:
        raise ValueError(f"{file}: no two-line elements")
    return found


def _epoch(day: float, fraction: float) -> datetime:
    if not math.isfinite(day + fraction):
        raise ValueError("the epoch is not finite")
    return _J2000 + timedelta(days=day - _J2000_DAY) + timedelta(days=fraction)


def read_omm(path: str | os.PathLike[str]) -> list[Satellite]:
    """Satellites of orbit mean-elements messages (CCSDS 502.0): XML, JSON, CSV or key = value, told by the content.

    Raises
    ------
    ValueError
        Naming the file and the message: a field that is missing or no number, no message at all.
    """
    omm = require("sgp4.omm", "orbits", "reading elements")
    file = Path(path)
    text = file.read_text(encoding="utf-8", errors="replace")
    start = text.lstrip("\ufeff \t\r\n")
    messages: list[dict[str, Any]]
    try:
        if start.startswith("<"):
            from io import StringIO

            messages = [dict(m) for m in omm.parse_xml(StringIO(start))]
        elif start.startswith(("[", "{")):
            data = json.loads(start)
            messages = data if isinstance(data, list) else [data]
        elif "=" in start.partition("\n")[0]:
            messages = _key_values(start)
        else:
            messages = [dict(m) for m in omm.parse_csv(start.splitlines())]
    except (ValueError, SyntaxError, AttributeError, TypeError) as error:
        raise ValueError(f"{file}: no orbit mean-elements message can be read: {error}") from error
    if not messages:
        raise ValueError(f"{file}: no orbit mean-elements message")
    return [_satellite(file, index, message) for index, message in enumerate(messages, start=1)]


def _key_values(text: str) -> list[dict[str, Any]]:
    messages: list[dict[str, Any]] = []
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        key, value = key.strip(), value.split("[")[0].strip()
        if not equals or key == "COMMENT":
            continue
        if key == "CCSDS_OMM_VERS" or (key == "OBJECT_NAME" and messages and key in messages[-1]) or not messages:
            messages.append({})
        messages[-1][key] = value
    return messages


def _satellite(file: Path, index: int, message: Any) -> Satellite:
    where = f"{file}: message {index}"
    if not isinstance(message, dict):
        raise ValueError(f"{where}: fields with names expected")
    fields = dict(_OMM_DEFAULTS)
    fields.update({str(k): str(v).strip() for k, v in message.items() if v is not None})
    for name in _OMM_FIELDS:
        if not fields.get(name):
            raise ValueError(f"{where}: {name} is missing")
    for name in (*_OMM_FIELDS, *_OMM_DEFAULTS):
        if name in _OMM_TEXT:
            continue
        try:
            good = math.isfinite(float(fields[name]))
        except ValueError:
            good = False
        if not good:
            raise ValueError(f"{where}: {name} is {fields[name]!r}, a number expected")
    try:
        epoch = utc(fields["EPOCH"])
        fields["EPOCH"] = f"{epoch:%Y-%m-%dT%H:%M:%S.%f}"
        satellite = Satellite(fields["OBJECT_NAME"], int(float(fields["NORAD_CAT_ID"])), epoch, fields)
        error = satellite._record().error
    except ValueError as bad:
        raise ValueError(f"{where}: {bad}") from bad
    if error:
        raise ValueError(f"{where}: {_REASONS.get(error, f'SGP4 error {error}')}")
    return satellite
