"""RINEX 3 into plain arrays. The parser is georinex; what it would stumble over is taken out, and said."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._extras import require

_Array = npt.NDArray[np.float64]
_WEEK_S = 604_800
_GPS_ORIGIN = np.datetime64("1980-01-06T00:00:00", "ns")
_LABEL = slice(60, 80)
_NAME = re.compile(r"[A-Z][ 0-9][0-9]")


@dataclass
class _File:
    """A file's text, cut into header and records.

    Attributes
    ----------
    path : Path
    header : str
        Up to and with the line END OF HEADER.
    records : list of str
        Epochs or messages, each with its line feed.
    problems : list of str
    """

    path: Path
    header: str
    records: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def text(self) -> io.StringIO:
        return io.StringIO(self.header + "".join(self.records))


def _open(path: str | Path, kind: str) -> tuple[_File, list[str]]:
    path = Path(path)
    text = path.read_text(encoding="ascii", errors="replace").replace("\ufffd", "?")
    lines = text.splitlines(keepends=True)
    label = lines[0][_LABEL].strip() if lines else ""
    if label != "RINEX VERSION / TYPE":
        raise ValueError(f"{path}:1: 'RINEX VERSION / TYPE' expected in columns 61 to 80, got {label!r}")
    version, file_type = lines[0][:9].strip(), lines[0][20:21].upper()
    if not version.startswith("3."):
        raise ValueError(f"{path}:1: version 3 expected, got {version!r}")
    if file_type != kind[0].upper():
        raise ValueError(f"{path}:1: a file of {kind} ('{kind[0].upper()}') expected, got type {file_type!r}")
    end = next((i for i, line in enumerate(lines) if line[_LABEL].strip() == "END OF HEADER"), None)
    if end is None:
        raise ValueError(f"{path}: ends within the header (line {len(lines)}): 'END OF HEADER' expected")
    return _File(path, "".join(lines[: end + 1])), lines[end + 1 :]


def _epoch_seconds(line: str) -> float:
    """GPS time of an epoch's line, as georinex will read it; ValueError when it is no time."""
    fields = (line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], line[19:21])
    year, month, day, hour, minute, second = (int(part) for part in fields)
    whole = datetime(year, month, day, hour, minute, second, tzinfo=timezone.utc)
    return (whole - datetime(1980, 1, 6, tzinfo=timezone.utc)).total_seconds() + float(line[19:29]) % 1.0


def _observation_epochs(path: str | Path, interval_s: float | None) -> _File:
    """The file with whole epochs of measurements only, every `interval_s` when given."""
    file, lines = _open(path, "observations")
    first = file.header.count("\n") + 1
    due: float | None = None
    i = 0
    while i < len(lines):
        line, where = lines[i], f"{file.path}:{first + i}"
        if not line.startswith(">"):
            if line.strip():
                file.problems.append(f"{where}: an epoch ('>') expected; line skipped")
            i += 1
            continue
        try:
            t = _epoch_seconds(line)
            flag, count = int(line[31]), int(line[33:35])
            if not line[32:35].strip().isdecimal() or int(line[32:35]) != count:
                raise ValueError
        except (ValueError, IndexError):
            file.problems.append(f"{where}: the epoch line cannot be read; epoch left out")
            i += 1
            continue
        record = lines[i : i + 1 + count]
        i += 1 + count
        if len(record) < 1 + count or not record[-1].endswith("\n") or any(r.startswith(">") for r in record[1:]):
            got = next((k for k, r in enumerate(record[1:]) if r.startswith(">")), len(record) - 1)
            file.problems.append(f"{where}: epoch cut short ({count} satellites stated, {got} lines); left out")
            if got < len(record) - 1:
                i -= count - got
            continue
        if flag > 1:
            file.problems.append(f"{where}: event flag {flag}; its {count} lines are left out")
            continue
        if flag == 1:
            file.problems.append(f"{where}: power failure since the epoch before")
        names = [r[:3] for r in record[1:]]
        if len(set(names)) != len(names) or not all(_NAME.match(name) for name in names):
            file.problems.append(f"{where}: satellites that are none or come twice; epoch left out")
            continue
        if interval_s is not None:
            if due is not None and t < due - 1e-3:
                continue
            due = t + interval_s if due is None else due + interval_s * (1 + np.floor((t - due) / interval_s + 1e-6))
        file.records.append("".join(record))
    return file


def _parsed(file: _File, function: Any, **options: Any) -> Any:
    """What georinex makes of a file; whatever it stumbles over becomes a ValueError that names the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return function(file.text(), **options)
        except Exception as error:
            raise ValueError(f"{file.path}: georinex cannot read it ({type(error).__name__}: {error})") from error


def _week_and_second(times: npt.NDArray[Any]) -> tuple[npt.NDArray[np.int64], _Array]:
    since = (times.astype("datetime64[ns]") - _GPS_ORIGIN).astype(np.int64)
    week = since // (_WEEK_S * 10**9)
    return week, (since - week * (_WEEK_S * 10**9)) / 1e9


@dataclass
class ObservationArrays:
    """What a file of observations holds: see `soopnav_cpp.gnss.Observations`."""

    week: npt.NDArray[np.int64]
    time_of_week_s: _Array
    satellites: tuple[str, ...]
    columns: dict[str, _Array]
    position: _Array
    problems: tuple[str, ...]


def read_observations(
    path: str | Path, systems: str, codes: dict[str, str], interval_s: float | None
) -> ObservationArrays:
    """Arrays of a file of observations; `codes` maps a system to the code of its signal, such as ``"1C"``."""
    georinex = require("georinex", "gnss", "reading RINEX")
    file = _observation_epochs(path, interval_s)
    stated = {
        line[0] for line in file.header.splitlines() if line[_LABEL].strip() == "SYS / # / OBS TYPES" and line[0] != " "
    }
    position = np.full(3, np.nan)
    parts: list[tuple[dict[str, Any], npt.NDArray[Any], list[str]]] = []
    for system in systems:
        if system not in stated:
            have = "".join(sorted(stated)) or "none"
            raise ValueError(f"systems: {system!r} is not in {file.path}, which has {have!r}")
        code = codes[system]
        kinds = [f"{letter}{code}" for letter in "CLDS"]
        if not file.records:
            continue
        data = _parsed(file, georinex.rinexobs, use={system}, meas=kinds, useindicators=True)
        if "position" in data.attrs:
            position = np.array(data.attrs["position"], dtype=np.float64)
        names = [str(name) for name in data.sv.values] if "sv" in data.coords else []
        columns = {}
        for key in [*kinds, f"L{code}lli"]:
            if key in data:
                columns[key[0] if key in kinds else "lli"] = np.asarray(data[key].values, dtype=np.float64)
        if names and "C" not in columns:
            raise ValueError(f"{file.path}: system {system} has no code measurement C{code}")
        if names:
            parts.append((columns, data.time.values, names))
    if not parts:
        file.problems.append(f"{file.path}: no measurement of {systems}")
        empty = np.empty((0, 0))
        columns = dict.fromkeys(("C", "L", "D", "S", "lli"), empty)
        return ObservationArrays(np.empty(0, np.int64), np.empty(0), (), columns, position, tuple(file.problems))
    times = np.unique(np.concatenate([part[1] for part in parts]))
    satellites = tuple(name for part in parts for name in part[2])
    joined = {key: np.full((len(times), len(satellites)), np.nan) for key in ("C", "L", "D", "S", "lli")}
    first = 0
    for columns, part_times, names in parts:
        rows = np.searchsorted(times, part_times)
        for key, values in columns.items():
            joined[key][rows[:, np.newaxis], np.arange(first, first + len(names))] = values
        first += len(names)
    order = np.argsort(satellites)
    week, second = _week_and_second(times)
    return ObservationArrays(
        week,
        second,
        tuple(satellites[i] for i in order),
        {key: np.ascontiguousarray(values[:, order]) for key, values in joined.items()},
        position,
        tuple(file.problems),
    )


# georinex' name of each field of a record, and ours.
_FIELDS = {
    "Toe": "toe_s",
    "SVclockBias": "af0_s",
    "SVclockDrift": "af1",
    "SVclockDriftRate": "af2_ps",
    "TGD": "tgd_s",
    "sqrtA": "sqrt_a",
    "Eccentricity": "eccentricity",
    "M0": "m0_rad",
    "DeltaN": "delta_n_radps",
    "omega": "omega_rad",
    "Omega0": "omega0_rad",
    "OmegaDot": "omega_dot_radps",
    "Io": "i0_rad",
    "IDOT": "i_dot_radps",
    "Cuc": "cuc_rad",
    "Cus": "cus_rad",
    "Crc": "crc_m",
    "Crs": "crs_m",
    "Cic": "cic_rad",
    "Cis": "cis_rad",
    "GPSWeek": "week",
    "health": "health",
    "IODE": "iode",
}
_MESSAGE_LINES = 8
_SAME_REFERENCE_S = 120.0


def _satellite_and_time(line: str) -> tuple[str, np.datetime64] | None:
    """What a message's first line names, as georinex will read it; None when it is no GPS satellite and time."""
    if not _NAME.match(line) or not 0 < int(line[1:3]) < 100:
        return None
    fields = (line[4:8], line[9:11], line[12:14], line[15:17], line[18:20], line[21:23])
    try:
        year, month, day, hour, minute, second = (int(part) for part in fields)
        time = datetime(year, month, day, hour, minute, second)
    except ValueError:
        return None
    return line[:3].replace(" ", "0"), np.datetime64(time.isoformat(), "s")


def read_navigation(path: str | Path) -> tuple[list[dict[str, float]], _Array | None, tuple[str, ...]]:
    """(one dict of fields for each GPS message, eight Klobuchar coefficients or None, problems)."""
    georinex = require("georinex", "gnss", "reading RINEX")
    file, lines = _open(path, "navigation messages")
    first = file.header.count("\n") + 1
    starts = [i for i, line in enumerate(lines) if line[:1].strip()]
    for k, i in enumerate(starts):
        if not lines[i].startswith("G"):
            continue
        end = starts[k + 1] if k + 1 < len(starts) else len(lines)
        message = lines[i:end]
        whole = len([line for line in message if line.strip()]) == _MESSAGE_LINES and message[-1].endswith("\n")
        if _satellite_and_time(lines[i]) is None:
            file.problems.append(f"{file.path}:{first + i}: no satellite and time; message left out")
        elif whole and all(len(line.rstrip()) >= 79 for line in message[1:7]):
            file.records.append("".join(message[:_MESSAGE_LINES]))
        else:
            file.problems.append(
                f"{file.path}:{first + i}: message of {lines[i][:3]} cut short ({len(message)} of {_MESSAGE_LINES} "
                "lines or some incomplete); left out"
            )
    if not file.records:
        file.problems.append(f"{file.path}: no message of GPS")
        return [], _klobuchar(file.header), tuple(file.problems)
    data = _parsed(file, georinex.rinexnav, use={"G"})
    lacking = [name for name in (*_FIELDS, "FitIntvl") if name not in data]
    if lacking:
        raise ValueError(f"{file.path}: georinex finds no {lacking[0]} in its messages")
    columns = {ours: np.asarray(data[theirs].values, dtype=np.float64) for theirs, ours in _FIELDS.items()}
    fit_h = np.asarray(data["FitIntvl"].values, dtype=np.float64)
    weeks, seconds = _week_and_second(data.time.values)
    sent_s = np.asarray(data["TransTime"].values, dtype=np.float64) if "TransTime" in data else None
    messages: list[dict[str, float]] = []
    sent: list[float] = []
    found: set[tuple[str, np.datetime64]] = set()
    for i, j in zip(*np.nonzero(np.isfinite(columns["sqrt_a"])), strict=True):
        values = {name: float(column[i, j]) for name, column in columns.items()}
        if not all(np.isfinite(v) for v in values.values()):
            continue
        found.add((str(data.sv.values[j])[:3], np.datetime64(data.time.values[i], "s")))
        values["prn"] = float(str(data.sv.values[j])[1:3])
        values["toc_s"] = seconds[i] + float(weeks[i] - values["week"]) * _WEEK_S
        values["fit_interval_s"] = 3600.0 * (fit_h[i, j] if fit_h[i, j] >= 4.0 else 4.0)
        messages.append(values)
        sent.append(float(sent_s[i, j]) if sent_s is not None else np.nan)
    messages = _not_superseded(messages, sent)
    for record in file.records:
        if (named := _satellite_and_time(record)) not in found and named is not None:
            file.problems.append(f"{file.path}: the message of {named[0]} at {named[1]} cannot be read; left out")
    return messages, _klobuchar(file.header), tuple(file.problems)


def _not_superseded(messages: list[dict[str, float]], sent_s: list[float]) -> list[dict[str, float]]:
    """Without those that an upload replaced: same satellite, reference times seconds apart, sent earlier.

    After an upload a satellite sends a reference time some seconds before the full hour; by reference time alone the
    old message would be taken as often as the new one, and its clock may be metres off.
    """
    kept = []
    for a, one in enumerate(messages):
        newer = any(
            other["prn"] == one["prn"]
            and 0.0 < abs(other["toe_s"] - one["toe_s"] + (other["week"] - one["week"]) * _WEEK_S) < _SAME_REFERENCE_S
            and 0.0 < sent_s[b] - sent_s[a] < 86_400.0
            for b, other in enumerate(messages)
        )
        if not newer:
            kept.append(one)
    return kept


def _klobuchar(header: str) -> _Array | None:
    """The eight coefficients of the header lines GPSA and GPSB."""
    found: dict[str, list[float]] = {}
    for line in header.splitlines():
        if line[_LABEL].strip() == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            try:
                found[line[:4]] = [float(line[5 + 12 * k : 17 + 12 * k].replace("D", "E")) for k in range(4)]
            except ValueError:
                return None
    return np.array(found["GPSA"] + found["GPSB"]) if len(found) == 2 else None
