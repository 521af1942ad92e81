"""Files that a run leaves for other programs: TUM, CSV, GeoJSON, NMEA 0183 and NPZ."""

from __future__ import annotations

import csv
import datetime
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._drawing import ellipse_points
from soopnav_cpp.geometry import LocalAxes, LocalFrame
from soopnav_cpp.scenarios.base import SystemRun
from soopnav_cpp.scenarios.metrics import heading_of

__all__ = ["nmea_checksum", "write_csv", "write_geojson", "write_nmea", "write_states", "write_table", "write_tum"]

Array = npt.NDArray[np.float64]
_KNOT_MPS = 1852.0 / 3600.0
_MOST_ELLIPSES = 60
_START_UTC = datetime.datetime(2000, 1, 1)


def _frame(run: SystemRun) -> LocalFrame | None:
    if run.origin_lla_deg is None:
        return None
    latitude, longitude, height = run.origin_lla_deg
    axes = LocalAxes.NED if run.axes == "ned" else LocalAxes.ENU
    return LocalFrame(math.radians(latitude), math.radians(longitude), height, axes=axes)


def _in_space(position_m: Array) -> Array:
    """Three components; a plane lies at height 0 of the local frame."""
    return np.pad(position_m, ((0, 0), (0, 3 - position_m.shape[1])))


def _degrees(frame: LocalFrame, position_m: Array) -> tuple[Array, Array, Array]:
    latitude, longitude, height = frame.position_to_geodetic(_in_space(np.atleast_2d(position_m)))
    return np.degrees(latitude), np.degrees(longitude), height


def _quaternion_xyzw(run: SystemRun) -> Array:
    """Attitude as TUM has it; a planar heading turns about the third axis, and without any there is no turn."""
    if run.quaternion_wxyz is not None:
        return run.quaternion_wxyz[:, [1, 2, 3, 0]]
    turn = np.zeros((len(run.t_s), 4))
    half = 0.5 * run.heading_rad if run.heading_rad is not None else np.zeros(len(run.t_s))
    turn[:, 2], turn[:, 3] = np.sin(half), np.cos(half)
    return turn


def write_tum(run: SystemRun, path: Path) -> None:
    """``time x y z qx qy qz qw`` per line, local metres, as trajectory tools (evo, rpg) read it."""
    table = np.column_stack([run.t_s, _in_space(run.position_m), _quaternion_xyzw(run)])
    np.savetxt(path, table, fmt=["%.9f", "%.6f", "%.6f", "%.6f", "%.9f", "%.9f", "%.9f", "%.9f"])


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Rows under named columns."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def write_csv(run: SystemRun, path: Path) -> None:
    """A row per epoch: estimate, standard deviations, and truth and place on the Earth where they are known."""
    axes = "xyz"[: run.position_m.shape[1]]
    columns: dict[str, Array] = {"time_s": run.t_s}
    columns |= {f"position_{a}_m": run.position_m[:, i] for i, a in enumerate(axes)}
    deviation = np.sqrt(np.maximum(np.diagonal(run.position_covariance_m2, axis1=1, axis2=2), 0.0))
    columns |= {f"sigma_{a}_m": deviation[:, i] for i, a in enumerate(axes)}
    if run.velocity_mps is not None:
        columns |= {f"velocity_{a}_mps": run.velocity_mps[:, i] for i, a in enumerate(axes)}
    if run.heading_rad is not None:
        columns["heading_rad"] = run.heading_rad
    if run.quaternion_wxyz is not None:
        columns |= {f"quaternion_{c}": run.quaternion_wxyz[:, i] for i, c in enumerate("wxyz")}
    frame = _frame(run)
    if frame is not None:
        columns["latitude_deg"], columns["longitude_deg"], columns["height_m"] = _degrees(frame, run.position_m)
    if run.truth is not None:
        columns |= {f"truth_{a}_m": run.truth.position_m[:, i] for i, a in enumerate(axes)}
    formats = dict.fromkeys(columns, "{:.9f}") | {"latitude_deg": "{:.10f}", "longitude_deg": "{:.10f}"}
    rows = zip(*([formats[name].format(v) for v in value] for name, value in columns.items()), strict=True)
    write_table(path, list(columns), list(rows))


def write_geojson(run: SystemRun, path: Path) -> None:
    """Track, truth, baselines, 95 % ellipses and sources (RFC 7946: longitude, latitude, height).

    Without an origin there is no place on the Earth: coordinates are then local metres, and the collection says so in
    ``coordinate_frame`` (by prior arrangement, as section 4 of the RFC allows).
    """
    frame = _frame(run)

    def places(position_m: Array) -> list[list[float]]:
        if frame is None:
            return [[round(float(v), 4) for v in row] for row in np.atleast_2d(position_m)]
        latitude, longitude, height = _degrees(frame, position_m)
        return [
            [round(float(x), 9), round(float(y), 9), round(float(z), 4)]
            for x, y, z in zip(longitude, latitude, height, strict=True)
        ]

    def feature(kind: str, geometry: str, coordinates: Any, **properties: object) -> dict[str, Any]:
        return {
            "type": "Feature",
            "geometry": {"type": geometry, "coordinates": coordinates},
            "properties": {"kind": kind, **properties},
        }

    def line(kind: str, position_m: Array, **properties: object) -> dict[str, Any]:
        points = places(position_m)
        return feature(kind, "LineString", points if len(points) > 1 else points * 2, **properties)

    features = [line("estimate", run.position_m, start_s=float(run.t_s[0]), end_s=float(run.t_s[-1]))]
    if run.truth is not None:
        features.append(line("truth", run.truth.position_m))
    features += [line("baseline", position, name=name) for name, position in run.baselines.items()]
    picks = np.unique(np.linspace(0, len(run.t_s) - 1, _MOST_ELLIPSES).round().astype(int))
    for k in picks:
        matrix = 0.5 * (run.position_covariance_m2[k] + run.position_covariance_m2[k].T)[:2, :2]
        if not np.linalg.eigvalsh(matrix)[0] > 0.0:
            continue
        curve = np.tile(run.position_m[k], (46, 1))
        curve[:, :2] += ellipse_points(estimation.error_ellipse(matrix, probability=0.95))[::4]
        ring = places(curve)
        ring[-1] = ring[0]
        # RFC 7946 wants the outside of a polygon counter-clockwise as seen on the map.
        features.append(
            feature(
                "error ellipse",
                "Polygon",
                [ring[::-1] if frame is not None and run.axes == "ned" else ring],
                time_s=float(run.t_s[k]),
                probability=0.95,
            )
        )
    for name, place in run.sources.items():
        features.append(feature("source", "Point", places(place)[0], name=name))
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if frame is None:
        collection["coordinate_frame"] = "local, metres: the scenario has no origin"
    path.write_text(json.dumps(collection, allow_nan=False) + "\n", encoding="utf-8")


def nmea_checksum(body: str) -> str:
    """Exclusive or of the characters between ``$`` and ``*``, two hexadecimal digits."""
    value = 0
    for byte in body.encode("ascii"):
        value ^= byte
    return f"{value:02X}"


def _sentence(*fields: str) -> str:
    body = ",".join(fields)
    return f"${body}*{nmea_checksum(body)}\r\n"


def _angle(degrees: float, digits: int, sides: str) -> tuple[str, str]:
    """``5212.306600,N``: whole degrees, then minutes, rounded together so that 60 minutes never stand there."""
    units = round(abs(degrees) * 60 * 10**6)
    whole, rest = divmod(units, 60 * 10**6)
    return f"{whole:0{digits}d}{rest // 10**6:02d}.{rest % 10**6:06d}", sides[degrees < 0.0]


def _per_second(t_s: Array) -> Iterator[int]:
    """The first epoch of each second."""
    last = None
    for k, time in enumerate(t_s):
        second = math.floor(time + 1e-6)
        if second != last:
            yield k
            last = second


def write_nmea(run: SystemRun, path: Path, *, start_utc: datetime.datetime | None = None) -> None:
    """GGA, RMC and GST of the first epoch of each second, from an integrated navigation system (talker ``IN``).

    GGA gives fix quality 8 and RMC mode S (simulated) where the run has a truth, 6 and E (estimated) where it has none.
    The height is that above the ellipsoid, with a geoid separation of 0. GST has the filter's standard deviations.

    Parameters
    ----------
    run : SystemRun
    path : path
    start_utc : datetime, optional
        When time 0 is; without it midnight of 1 January 2000. One without a time zone is taken as UTC.

    Raises
    ------
    ValueError
        For a run whose local frame has no origin on the Earth.
    """
    frame = _frame(run)
    if frame is None:
        raise ValueError("NMEA needs a place on the Earth: add [origin] with latitude_deg and longitude_deg")
    start = start_utc or _START_UTC
    if start.tzinfo is not None:
        start = start.astimezone(datetime.timezone.utc).replace(tzinfo=None)
    latitude, longitude, height = _degrees(frame, run.position_m)
    used = 0 if run.updates is None else len(np.unique(run.updates.source[run.updates.accepted]))
    quality, mode = ("6", "E") if run.truth is None else ("8", "S")
    swap = [1, 0] if run.axes == "ned" else [0, 1]  # east, north
    lines = []
    for k in _per_second(run.t_s):
        when = start + datetime.timedelta(seconds=round(float(run.t_s[k]), 2))
        clock, date = f"{when:%H%M%S}.{when.microsecond // 10_000:02d}", f"{when:%d%m%y}"
        place = (*_angle(float(latitude[k]), 2, "NS"), *_angle(float(longitude[k]), 3, "EW"))
        above = (f"{height[k]:.3f}", "M", "0.0", "M")
        lines.append(_sentence("INGGA", clock, *place, quality, f"{min(used, 99):02d}", "", *above, "", ""))
        speed = course = ""
        if run.velocity_mps is not None:
            east, north = run.velocity_mps[k][swap]
            speed = f"{math.hypot(east, north) / _KNOT_MPS:.3f}"
            course = f"{round(math.degrees(math.atan2(east, north)) % 360.0, 2) % 360.0:.2f}"
        lines.append(_sentence("INRMC", clock, "A", *place, speed, course, date, "", "", mode))
        matrix = run.position_covariance_m2[k][np.ix_(swap, swap)]
        lines.append(_sentence("INGST", clock, *_deviations(matrix, run.position_covariance_m2[k])))
    path.write_text("".join(lines), encoding="ascii", newline="")


def _deviations(horizontal_m2: Array, covariance_m2: Array) -> list[str]:
    """Fields of GST: range RMS (none), semi-axes and direction of the ellipse, σ north, east and up."""
    values, vectors = np.linalg.eigh(0.5 * (horizontal_m2 + horizontal_m2.T))
    minor, major = np.sqrt(np.maximum(values, 0.0))
    azimuth = math.degrees(math.atan2(vectors[0, 1], vectors[1, 1])) % 180.0
    east, north = np.sqrt(np.maximum(np.diagonal(horizontal_m2), 0.0))
    up = f"{math.sqrt(max(covariance_m2[2, 2], 0.0)):.3f}" if len(covariance_m2) > 2 else ""
    return ["", f"{major:.3f}", f"{minor:.3f}", f"{azimuth:.1f}", f"{north:.3f}", f"{east:.3f}", up]


def write_states(run: SystemRun, path: Path) -> None:
    """Every array of the run by name; truths begin with ``truth_``, measurements with ``update_``."""
    arrays: dict[str, Any] = {
        "t_s": run.t_s,
        "position_m": run.position_m,
        "position_covariance_m2": run.position_covariance_m2,
        "velocity_mps": run.velocity_mps,
        "heading_rad": heading_of(run),
        "quaternion_wxyz": run.quaternion_wxyz,
        "state_names": np.array(run.state_names, dtype=np.str_),
        "state": run.state,
        "covariance": run.covariance,
        "source_names": np.array(list(run.sources), dtype=np.str_),
        "source_position_m": np.array(list(run.sources.values())) if run.sources else None,
    }
    if run.truth is not None:
        for name in ("position_m", "velocity_mps", "quaternion_wxyz", "state"):
            arrays[f"truth_{name}"] = getattr(run.truth, name)
        arrays["truth_heading_rad"] = heading_of(run.truth)
    if run.updates is not None:
        for name in ("t_s", "source", "innovation", "variance", "nis", "status", "gate"):
            arrays[f"update_{name}"] = getattr(run.updates, name)
        arrays["update_source_names"] = np.array(run.updates.source_names, dtype=np.str_)
    arrays |= {f"baseline_{name}_m".replace(" ", "_"): position for name, position in run.baselines.items()}
    kept = {name: value for name, value in arrays.items() if value is not None}
    np.savez_compressed(path, **kept)
