"""Files of sampled orbits: NPZ, which is exact, and CSV."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._orbit_elements import utc

_COLUMNS = ("name", "time_s", "x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps")
_REFERENCE = "# reference: "


@dataclass(frozen=True)
class Ephemeris:
    """Sampled orbits by name, and the instant (UTC) that counts as their time 0."""

    orbits: dict[str, SampledOrbit]
    reference: datetime


def write_ephemeris(
    path: str | os.PathLike[str], orbits: Mapping[str, SampledOrbit], reference: datetime | str
) -> None:
    """Write sampled orbits to a file: ``.npz``, or ``.csv`` with a row for each sample.

    Parameters
    ----------
    path : path
    orbits : mapping of str to SampledOrbit
        A transmitter at rest has one row, its time 0.
    reference : datetime or str
        The instant (UTC) that counts as time 0.

    Raises
    ------
    ValueError
        For another suffix, no orbits, or a name that is empty or begins with ``#``.
    """
    file = Path(path)
    if file.suffix.lower() not in (".npz", ".csv"):
        raise ValueError(f"{file}: a name that ends in .npz or .csv expected")
    if not orbits:
        raise ValueError("orbits: at least one expected")
    for name in orbits:
        if not name.strip() or name != name.strip() or name.startswith("#"):
            raise ValueError(f"orbits: {name!r} is no name for a file")
    zero = utc(reference).isoformat()
    if file.suffix.lower() == ".npz":
        arrays: dict[str, Any] = {
            "reference": np.array(zero),
            "names": np.array(list(orbits)),
            "start_s": np.array([0.0 if o.is_fixed else o.start_s for o in orbits.values()]),
            "step_s": np.array([o.step_s for o in orbits.values()]),
            "count": np.array([len(o) for o in orbits.values()]),
            "position_e_m": np.concatenate([o.position_e_m for o in orbits.values()]),
            "velocity_e_mps": np.concatenate([o.velocity_e_mps for o in orbits.values()]),
        }
        with file.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        return
    with file.open("w", newline="", encoding="utf-8") as stream:
        stream.write(f"{_REFERENCE}{zero}\n")
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS)
        for name, orbit in orbits.items():
            times = [0.0] if orbit.is_fixed else orbit.start_s + orbit.step_s * np.arange(len(orbit))
            for t, p, v in zip(times, orbit.position_e_m, orbit.velocity_e_mps, strict=True):
                writer.writerow([name, *(repr(float(x)) for x in (t, *p, *v))])


def read_ephemeris(path: str | os.PathLike[str]) -> Ephemeris:
    """Read what `write_ephemeris` wrote.

    Raises
    ------
    ValueError
        Naming the file, and the row of a CSV: fields missing, numbers that are none or not finite, uneven steps.
    """
    file = Path(path)
    return _read_npz(file) if file.suffix.lower() == ".npz" else _read_csv(file)


def _read_npz(file: Path) -> Ephemeris:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            names = [str(n) for n in data["names"]]
            start, step, count = data["start_s"], data["step_s"], data["count"]
            position, velocity = data["position_e_m"], data["velocity_e_mps"]
            reference = utc(str(data["reference"]))
    except FileNotFoundError:
        raise
    except Exception as error:  # zip, header and field errors of NumPy are of many kinds
        raise ValueError(f"{file}: no ephemeris: {error}") from error
    shapes = {start.shape, step.shape, count.shape, (len(names),)}
    if len(shapes) != 1 or count.dtype.kind not in "iu" or np.any(count < 1) or position.shape != (count.sum(), 3):
        raise ValueError(f"{file}: the arrays' shapes do not fit each other")
    orbits, row = {}, 0
    for i, name in enumerate(names):
        rows = slice(row, row + int(count[i]))
        row = rows.stop
        try:
            orbits[name] = _orbit(float(start[i]), float(step[i]), position[rows], velocity[rows])
        except ValueError as error:
            raise ValueError(f"{file}: {name}: {error}") from error
    return Ephemeris(orbits, reference)


def _orbit(start_s: float, step_s: float, position: object, velocity: object) -> SampledOrbit:
    if step_s == 0.0:
        return SampledOrbit.fixed(np.asarray(position)[0])
    return SampledOrbit(start_s, step_s, np.asarray(position), np.asarray(velocity))


def _read_csv(file: Path) -> Ephemeris:
    rows: dict[str, list[list[float]]] = {}
    with file.open(newline="", encoding="utf-8", errors="replace") as stream:
        first = stream.readline().strip()
        if not first.startswith(_REFERENCE):
            raise ValueError(f"{file}:1: {_REFERENCE}TIME expected, got {first[:40]!r}")
        try:
            reference = utc(first.removeprefix(_REFERENCE))
        except ValueError as error:
            raise ValueError(f"{file}:1: {error}") from error
        reader = csv.reader(stream)
        if tuple(next(reader, ())) != _COLUMNS:
            raise ValueError(f"{file}:2: the columns {', '.join(_COLUMNS)} expected")
        for number, row in enumerate(reader, start=3):
            if not row:
                continue
            try:
                numbers = [float(x) for x in row[1:]]
            except ValueError:
                numbers = []
            if len(numbers) != len(_COLUMNS) - 1 or not all(map(math.isfinite, numbers)):
                raise ValueError(f"{file}:{number}: a name and seven finite numbers expected")
            rows.setdefault(row[0], []).append(numbers)
    if not rows:
        raise ValueError(f"{file}: no samples")
    orbits = {}
    for name, table in rows.items():
        data = np.array(table)
        times = data[:, 0]
        step_s = float((times[-1] - times[0]) / (len(times) - 1)) if len(times) > 1 else 0.0
        if len(times) > 1 and (
            step_s <= 0.0 or np.abs(times - times[0] - step_s * np.arange(len(times))).max() > 1e-6 * step_s
        ):
            raise ValueError(f"{file}: {name}: times at even steps expected")
        orbits[name] = _orbit(float(times[0]), step_s, data[:, 1:4], data[:, 4:7])
    return Ephemeris(orbits, reference)
