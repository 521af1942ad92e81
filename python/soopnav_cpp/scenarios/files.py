"""Recordings that stand in for simulated sensors: CSV with named columns, units in the names.

`read_imu`, `read_tdoa` and `read_truth` refuse what does not fit with ``FILE:LINE: COLUMN: RULE``, and name several
mistakes at once. Lines that begin with ``#`` and empty ones are passed over. With ``repair=True`` rows with numbers
that are not finite, and rows whose time does not rise, are left out instead and named in ``dropped``.

Units are read from the end of a column's name and converted:

==================  ==========================================
time                ``_s _ms _us _ns``
rate                ``_radps _dps _degps``
specific force      ``_mps2 _g _mg`` (g = 9.80665 m/s²)
position            ``_m _km``
velocity            ``_mps _kmph``
angle               ``_rad _deg``
time difference     ``_s _us _ns``, and ``_m`` (divided by c)
==================  ==========================================
"""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from soopnav_cpp.scenarios.base import Truth

__all__ = [
    "ImuData",
    "PlanarImuData",
    "RecordingError",
    "TdoaData",
    "TruthData",
    "read_imu",
    "read_tdoa",
    "read_truth",
]

Array = npt.NDArray[np.float64]
_C_MPS = 299_792_458.0
_G_MPS2 = 9.80665
_MOST_MISTAKES = 8
_DEGREE = math.pi / 180.0
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_RATE = {"radps": 1.0, "dps": _DEGREE, "degps": _DEGREE}
_FORCE = {"mps2": 1.0, "g": _G_MPS2, "mg": 1e-3 * _G_MPS2}
_LENGTH = {"m": 1.0, "km": 1e3}
_SPEED = {"mps": 1.0, "kmph": 1.0 / 3.6}
_ANGLE = {"rad": 1.0, "deg": _DEGREE}
_DIFFERENCE = {"s": 1.0, "us": 1e-6, "ns": 1e-9, "m": 1.0 / _C_MPS}
_Units = Mapping[str, float]


class RecordingError(ValueError):
    """A recording does not fit; the message has a line ``FILE:LINE: COLUMN: RULE`` for each mistake."""


@dataclass(frozen=True, eq=False)
class _Timed:
    """What has times. `dropped` are sentences about rows that a repair left out."""

    t_s: Array
    dropped: tuple[str, ...]

    def gaps(self, *, longer_than_s: float | None = None) -> list[tuple[float, float]]:
        """Where samples are missing: time of the last one before, and how long until the next.

        Parameters
        ----------
        longer_than_s : float, optional
            Without it, one and a half times the median step.
        """
        steps = np.diff(self.t_s)
        if not steps.size:
            return []
        limit = 1.5 * float(np.median(steps)) if longer_than_s is None else longer_than_s
        return [(float(self.t_s[k]), float(steps[k])) for k in np.flatnonzero(steps > limit)]


@dataclass(frozen=True, eq=False)
class PlanarImuData(_Timed):
    """Recording of an IMU in a plane.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    yaw_rate_radps : ndarray, shape (n,)
        From x towards y.
    specific_force_mps2 : ndarray, shape (n, 2)
        Along the body's x and y.
    """

    yaw_rate_radps: Array
    specific_force_mps2: Array


@dataclass(frozen=True, eq=False)
class ImuData(_Timed):
    """Recording of an IMU in space.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    w_ib_b_radps : ndarray, shape (n, 3)
        Angular rate in body axes.
    f_ib_b_mps2 : ndarray, shape (n, 3)
        Specific force in body axes.
    """

    w_ib_b_radps: Array
    f_ib_b_mps2: Array


@dataclass(frozen=True, eq=False)
class TdoaData(_Timed):
    """Recorded time differences of arrival.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    transmitters : tuple of str
        In the order of the columns, or in which they first appear.
    tdoa_s : ndarray, shape (n, m)
        NaN where nothing was measured.
    sigma_s : ndarray, shape (n, m), or None
        Standard deviations, where the file has them; NaN elsewhere.
    """

    transmitters: tuple[str, ...]
    tdoa_s: Array
    sigma_s: Array | None


@dataclass(frozen=True, eq=False)
class TruthData(_Timed):
    """Recorded truth, to compare with.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, d)
        d is 2, or 3 with a column for z.
    velocity_mps : ndarray, shape (n, d), or None
    heading_rad : ndarray, shape (n,), or None
        From x towards y.
    """

    position_m: Array
    velocity_mps: Array | None
    heading_rad: Array | None

    def at(self, t_s: npt.ArrayLike) -> Truth:
        """What was so at these times: linear between the recorded ones, headings the short way round.

        Parameters
        ----------
        t_s : array_like, shape (n,)

        Raises
        ------
        ValueError
            For a time outside the recording.
        """
        time = np.asarray(t_s, dtype=np.float64)
        outside = ~((time >= self.t_s[0]) & (time <= self.t_s[-1]))
        if outside.any():
            k = int(np.argmax(outside))
            span = f"{self.t_s[0]:g} … {self.t_s[-1]:g} s"
            raise ValueError(f"t_s[{k}] = {time[k]:g}: outside the recorded truth, {span}")

        def between(values: Array) -> Array:
            return np.column_stack([np.interp(time, self.t_s, column) for column in values.T])

        heading = None if self.heading_rad is None else np.interp(time, self.t_s, np.unwrap(self.heading_rad))
        velocity = None if self.velocity_mps is None else between(self.velocity_mps)
        return Truth(position_m=between(self.position_m), velocity_mps=velocity, heading_rad=heading)


# ---- tables


@dataclass(frozen=True)
class _Row:
    line: int
    cells: list[str]


class _Mistakes:
    """Collects what does not fit, up to a number that can be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sentences: list[str] = []
        self.count = 0

    def add(self, line: int, sentence: str) -> None:
        self.count += 1
        if self.count <= _MOST_MISTAKES:
            self.sentences.append(f"{self.path}:{line}: {sentence}")

    def refuse(self) -> None:
        if not self.count:
            return
        more = self.count - len(self.sentences)
        raise RecordingError("\n".join(self.sentences + ([f"{self.path}: {more} more mistakes"] if more else [])))


def _rows(path: Path) -> tuple[_Row, list[_Row]]:
    """The header and the rows below it, each with as many cells."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            found = [_Row(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not a text file; CSV expected") from error
    except csv.Error as error:
        raise RecordingError(f"{path}: not CSV: {error}") from error
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from error
    found = [row for row in found if any(row.cells) and not row.cells[0].startswith("#")]
    if not found:
        raise RecordingError(f"{path}: empty; a line with the names of the columns expected")
    header, rows = found[0], found[1:]
    if not rows:
        raise RecordingError(f"{path}:{header.line}: no rows below the names of the columns")
    mistakes = _Mistakes(path)
    for row in rows:
        if len(row.cells) != len(header.cells):
            mistakes.add(row.line, f"{len(header.cells)} cells expected, got {len(row.cells)}")
    mistakes.refuse()
    return header, rows


def _columns(
    path: Path, header: _Row, known: Mapping[str, _Units], required: Sequence[str]
) -> dict[str, tuple[int, float]]:
    """Where each quantity stands, and its factor to SI units."""
    found: dict[str, tuple[int, float]] = {}
    mistakes = _Mistakes(path)
    everything = [f"{quantity}_{unit}" for quantity, units in known.items() for unit in units]
    for index, name in enumerate(header.cells):
        quantity = next((q for q in known if name == q or name.startswith(f"{q}_")), None)
        unit = name[len(quantity) + 1 :] if quantity is not None else ""
        if quantity is not None and unit in known[quantity]:
            if quantity in found:
                other = header.cells[found[quantity][0]]
                mistakes.add(header.line, f"{name}: {'given twice' if name == other else f'given as {other} already'}")
            else:
                found[quantity] = (index, known[quantity][unit])
        elif quantity is not None and not unit:
            mistakes.add(header.line, f"{name}: a unit expected: {_either(f'{quantity}_{u}' for u in known[quantity])}")
        else:
            near = difflib.get_close_matches(name, everything, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}, each with its unit"
            mistakes.add(header.line, f"{name or 'a column without name'}: unknown column; {hint}")
    for quantity in required:
        if quantity not in found:
            mistakes.add(header.line, f"missing column {_either(f'{quantity}_{u}' for u in known[quantity])}")
    mistakes.refuse()
    return found


def _either(names: Iterable[str]) -> str:
    words = list(names)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _number(cell: str) -> float | None:
    """None for what is no number."""
    try:
        return float(cell)
    except ValueError:
        return None


def _complaint(name: str, cell: str, empty: bool) -> str:
    if _number(cell) is None:
        return f"{name}: a number{' or nothing' if empty else ''} expected, got {cell!r}"
    return f"{name}: {cell}: a finite number expected{'; leave the cell empty without one' if empty else ''}"


def _table(
    path: Path,
    header: _Row,
    rows: Sequence[_Row],
    columns: Mapping[str, tuple[int, float]],
    *,
    repair: bool,
    may_be_empty: Callable[[str], bool] = lambda _: False,
    may_repeat: bool = False,
) -> tuple[Array, dict[str, Array], list[_Row], tuple[str, ...]]:
    """Times, the other columns, the rows that were kept, and sentences about those that were not."""
    mistakes = _Mistakes(path)
    kept: list[list[float]] = []
    kept_rows: list[_Row] = []
    dropped: list[str] = []
    latest = -math.inf
    for row in rows:
        values: list[float] = []
        broken = ""
        for quantity, (index, factor) in columns.items():
            cell = row.cells[index]
            empty = may_be_empty(quantity)
            if empty and not cell:
                values.append(math.nan)
                continue
            value = _number(cell)
            if value is None or not math.isfinite(value * factor):
                broken = _complaint(header.cells[index], cell, empty)
                if value is None or not repair:  # a word is a mistake even where gaps are mended
                    mistakes.add(row.line, broken)
                break
            values.append(value * factor)
        if not broken and (values[0] < latest or (values[0] == latest and not may_repeat)):
            name = header.cells[columns["time"][0]]
            factor = columns["time"][1]
            broken = f"{name}: {row.cells[columns['time'][0]]} after {latest / factor:.12g}: time must rise"
            if not repair:
                mistakes.add(row.line, broken)
        if broken:
            dropped.append(f"{path.name}:{row.line}: {broken}; left out")
            continue
        latest = values[0]
        kept.append(values)
        kept_rows.append(row)
    mistakes.refuse()
    if not kept:
        raise RecordingError(f"{path}: no row can be used")
    table = np.array(kept, dtype=np.float64)
    named = {quantity: np.ascontiguousarray(table[:, k]) for k, quantity in enumerate(columns)}
    return named.pop("time"), named, kept_rows, tuple(dropped)


def _time_first(columns: Mapping[str, tuple[int, float]]) -> dict[str, tuple[int, float]]:
    return {"time": columns["time"], **columns}


# ---- readers

_PLANAR: dict[str, _Units] = {
    "time": _TIME,
    "yaw_rate": _RATE,
    "specific_force_x": _FORCE,
    "specific_force_y": _FORCE,
}
_SPATIAL: dict[str, _Units] = {
    "time": _TIME,
    **{f"gyro_{axis}": _RATE for axis in "xyz"},
    **{f"accel_{axis}": _FORCE for axis in "xyz"},
}


def read_imu(path: str | Path, *, repair: bool = False) -> PlanarImuData | ImuData:
    """Read the recording of an IMU.

    Parameters
    ----------
    path : path
        CSV with the columns ``time``, ``yaw_rate``, ``specific_force_x``, ``specific_force_y`` for a planar one, or
        ``time``, ``gyro_x`` ... ``gyro_z``, ``accel_x`` ... ``accel_z``, each with its unit at the end
        (``yaw_rate_dps``), in any order.
    repair : bool
        Leave rows out that cannot be used, instead of refusing the file.

    Returns
    -------
    PlanarImuData or ImuData
        By the columns.

    Raises
    ------
    RecordingError
        For missing, unknown and doubled columns, cells that are no finite numbers, and time that does not rise.
    """
    file = Path(path)
    header, rows = _rows(file)
    spatial = sum(name.startswith(("gyro_", "accel_")) for name in header.cells)
    known = _SPATIAL if 2 * spatial >= len(header.cells) - 1 else _PLANAR
    columns = _columns(file, header, known, list(known))
    time, values, _, dropped = _table(file, header, rows, _time_first(columns), repair=repair)
    if known is _PLANAR:
        force = np.column_stack([values["specific_force_x"], values["specific_force_y"]])
        return PlanarImuData(time, dropped, values["yaw_rate"], force)
    rate = np.column_stack([values[f"gyro_{axis}"] for axis in "xyz"])
    return ImuData(time, dropped, rate, np.column_stack([values[f"accel_{axis}"] for axis in "xyz"]))


def read_tdoa(path: str | Path, *, repair: bool = False) -> TdoaData:
    """Read recorded time differences of arrival.

    Parameters
    ----------
    path : path
        CSV in one of two forms. Wide: ``time``, and for each transmitter ``tdoa_NAME`` and perhaps ``sigma_NAME``; an
        empty cell where nothing was measured. Long, a row per measurement: ``time``, ``transmitter``, ``tdoa`` and
        perhaps ``sigma``; rows of one epoch have the same time. Units at the end of the names: ``tdoa_north_ns``.
    repair : bool
        As for `read_imu`.

    Returns
    -------
    TdoaData

    Raises
    ------
    RecordingError
        As for `read_imu`; for a standard deviation that is not positive; for a transmitter twice at one time.
    """
    file = Path(path)
    header, rows = _rows(file)
    if "transmitter" in header.cells:
        return _long_tdoa(file, header, rows, repair)
    names: dict[str, None] = {}
    known: dict[str, _Units] = {"time": _TIME}
    for cell in header.cells:
        kind, _, rest = cell.partition("_")
        name, _, unit = rest.rpartition("_")
        if kind in ("tdoa", "sigma") and name and unit in _DIFFERENCE:
            known |= {f"tdoa_{name}": _DIFFERENCE, f"sigma_{name}": _DIFFERENCE}
            names[name] = None
    # The longest name first: tdoa_a_b before tdoa_a.
    ordered = dict(sorted(known.items(), key=lambda item: -len(item[0])))
    needed = ["time", *(f"tdoa_{name}" for name in names)]
    if not names:
        raise RecordingError(f"{file}:{header.line}: no column tdoa_NAME_s, _us, _ns or _m, and none named transmitter")
    columns = _columns(file, header, ordered, needed)
    time, values, kept, dropped = _table(
        file, header, rows, _time_first(columns), repair=repair, may_be_empty=lambda quantity: quantity != "time"
    )
    tdoa = np.column_stack([values[f"tdoa_{name}"] for name in names])
    sigma = None
    if any(f"sigma_{name}" in values for name in names):
        nothing = np.full(len(time), np.nan)
        sigma = np.column_stack([values.get(f"sigma_{name}", nothing) for name in names])
        _positive(file, kept, sigma)
    return TdoaData(time, dropped, tuple(names), tdoa, sigma)


def _positive(path: Path, rows: Sequence[_Row], sigma: Array) -> None:
    mistakes = _Mistakes(path)
    for k in np.flatnonzero((sigma <= 0.0).any(axis=1)).tolist():
        mistakes.add(rows[k].line, "sigma: more than 0 expected")
    mistakes.refuse()


def _long_tdoa(path: Path, header: _Row, rows: Sequence[_Row], repair: bool) -> TdoaData:
    place = header.cells.index("transmitter")
    rest = _Row(header.line, [name for k, name in enumerate(header.cells) if k != place])
    bare = [_Row(row.line, [cell for k, cell in enumerate(row.cells) if k != place]) for row in rows]
    known: dict[str, _Units] = {"time": _TIME, "tdoa": _DIFFERENCE, "sigma": _DIFFERENCE}
    columns = _columns(path, rest, known, ["time", "tdoa"])
    time, values, kept, dropped = _table(path, rest, bare, _time_first(columns), repair=repair, may_repeat=True)
    who = {row.line: row.cells[place] for row in rows}
    names: dict[str, int] = {}
    epochs, at = np.unique(time, return_inverse=True)
    mistakes = _Mistakes(path)
    seen: dict[tuple[int, str], int] = {}
    for row, epoch in zip(kept, at, strict=True):
        name = who[row.line]
        if not name:
            mistakes.add(row.line, "transmitter: a name expected")
        names.setdefault(name, len(names))
        if (int(epoch), name) in seen:
            mistakes.add(row.line, f"transmitter: {name} at this time already on line {seen[int(epoch), name]}")
        seen.setdefault((int(epoch), name), row.line)
    mistakes.refuse()
    column = [names[who[row.line]] for row in kept]
    tdoa = np.full((len(epochs), len(names)), np.nan)
    tdoa[at, column] = values["tdoa"]
    sigma = None
    if "sigma" in values:
        _positive(path, kept, values["sigma"][:, None])
        sigma = np.full_like(tdoa, np.nan)
        sigma[at, column] = values["sigma"]
    return TdoaData(epochs, dropped, tuple(names), tdoa, sigma)


def read_truth(path: str | Path, *, repair: bool = False) -> TruthData:
    """Read a reference track.

    Parameters
    ----------
    path : path
        CSV with ``time``, ``position_x``, ``position_y``, and perhaps ``position_z``, ``velocity_x`` ...,
        ``heading``, with units at the end of the names.
    repair : bool
        As for `read_imu`.

    Returns
    -------
    TruthData

    Raises
    ------
    RecordingError
        As for `read_imu`; for a velocity without all of the position's axes.
    """
    file = Path(path)
    header, rows = _rows(file)
    known: dict[str, _Units] = {"time": _TIME}
    known |= dict.fromkeys((f"position_{axis}" for axis in "xyz"), _LENGTH)
    known |= dict.fromkeys((f"velocity_{axis}" for axis in "xyz"), _SPEED)
    known["heading"] = _ANGLE
    axes = "xyz" if any(name.startswith("position_z_") for name in header.cells) else "xy"
    needed = ["time", *(f"position_{axis}" for axis in axes)]
    moving = any(name.startswith("velocity_") for name in header.cells)
    if moving:
        needed += [f"velocity_{axis}" for axis in axes]
    columns = _columns(file, header, known, needed)
    time, values, _, dropped = _table(file, header, rows, _time_first(columns), repair=repair)
    position = np.column_stack([values[f"position_{axis}"] for axis in axes])
    velocity = np.column_stack([values[f"velocity_{axis}"] for axis in axes]) if moving else None
    return TruthData(time, dropped, position, velocity, values.get("heading"))
