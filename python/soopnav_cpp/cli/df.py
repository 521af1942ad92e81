"""``soopnav df``: from samples of an array of antennas to bearings over time."""

from __future__ import annotations

import datetime
import json
import math
import warnings as python_warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import array, io, plotting
from soopnav_cpp._extras import require
from soopnav_cpp.cli import text
from soopnav_cpp.cli.page import page, table
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.scenarios.places import against_own_north
from soopnav_cpp.scenarios.poses import Poses, covariances_from_ratio, read_poses
from soopnav_cpp.scenarios.writers import write_table

__all__ = ["METHODS", "Found", "as_json", "find", "print_result", "sentence", "write_report"]

Array = npt.NDArray[np.float64]
METHODS = ("music", "capon", "bartlett")
_BLOCK = 2500
_MOST_BLOCKS = 200_000
_MOST_ROWS = 12
_DEAD_DB = -50.0  # of a channel's power to the median of all: nothing is connected to it
_FREQUENCY_SHARE = 0.01  # by which a recording may be tuned beside the array's frequency without a word
_FREQUENCY_WRONG = 0.1  # and from where it is another array


#: Time, source, azimuth, elevation, covariance, SNR, status.
_Row = tuple[float, int, float, float, Array, float, str]
#: SNR, samples, row and number of sources of the block with the highest SNR.
_Best = tuple[float, npt.NDArray[np.complex64], int, int]


@dataclass(eq=False)
class Found:
    """Bearings of all blocks, a row per source and block.

    Attributes
    ----------
    captures : list of Path
    manifold : Manifold
    method : str
    sources : int or None
        None: counted in each block.
    block_samples : int
    sample_rate_hz : float
    t_s, azimuth_rad, elevation_rad, snr_db : ndarray, shape (n,)
        NaN where nothing was found.
    covariance_rad2 : ndarray, shape (n, 2, 2)
    source : ndarray of int, shape (n,)
        Strongest first, from 0, in each block.
    status : list of str
        ``ok``, or why there is no bearing.
    poses : Poses or None
        Of each row.
    spectrum : ndarray, shape (E, A), or None
        Of the block with the highest SNR, over `grid_azimuth_rad` and `grid_elevation_rad`.
    best : int
        The row it belongs to.
    warnings : list of str
    """

    captures: list[Path]
    manifold: Any
    method: str
    sources: int | None
    block_samples: int
    sample_rate_hz: float
    t_s: Array
    azimuth_rad: Array
    elevation_rad: Array
    covariance_rad2: Array
    snr_db: Array
    source: npt.NDArray[np.int64]
    status: list[str]
    poses: Poses | None = None
    spectrum: Array | None = None
    grid_azimuth_rad: Array = field(default_factory=lambda: np.zeros(0))
    grid_elevation_rad: Array = field(default_factory=lambda: np.zeros(0))
    best: int = -1
    warnings: list[str] = field(default_factory=list)

    @property
    def good(self) -> npt.NDArray[np.bool_]:
        """Rows with a bearing."""
        return np.array([word == "ok" for word in self.status], dtype=np.bool_)

    @property
    def compass_deg(self) -> Array:
        """True bearings, clockwise from north, 0 … 360; NaN where there is none."""
        if self.poses is None:
            return np.full(len(self.t_s), np.nan)
        bearing, _, _ = self.poses.to_level(self.azimuth_rad, self.elevation_rad, self.covariance_rad2)
        if self.poses.frame is not None:
            bearing = against_own_north(self.poses.frame, self.poses.position_m, bearing)
        return np.asarray((90.0 - np.degrees(bearing)) % 360.0)


def _start_s(metadata: io.Metadata, first: str | None, end_s: float) -> float:
    """When a capture begins, after the first one: by its own time, or when the one before ended."""
    if first is None or metadata.datetime_utc is None:
        return end_s
    times = [datetime.datetime.fromisoformat(value.replace("Z", "+00:00")) for value in (first, metadata.datetime_utc)]
    times = [t if t.tzinfo else t.replace(tzinfo=datetime.timezone.utc) for t in times]
    return (times[1] - times[0]).total_seconds()


def _check_capture(path: Path, iq: npt.NDArray[np.complex64], metadata: io.Metadata, geometry: Any) -> list[str]:
    """Sentences about a capture that can be used all the same; refuses one that cannot."""
    elements = len(geometry.positions_m)
    if len(iq) != elements:
        raise ValueError(
            f"{path}: {len(iq)} channel{'s' * (len(iq) != 1)}, but the array has {elements} elements; one channel per "
            "element expected"
        )
    warnings = []
    tuned = metadata.center_frequency_hz
    if tuned is not None:
        off = abs(tuned / geometry.frequency_hz - 1.0)
        if off > _FREQUENCY_WRONG:
            raise ValueError(
                f"{path}: tuned to {text.megahertz(tuned)}, but the array is described at "
                f"{text.megahertz(geometry.frequency_hz)}; another array?"
            )
        if off > _FREQUENCY_SHARE:
            warnings.append(
                f"{path.name}: tuned to {text.megahertz(tuned)}, the array is described at "
                f"{text.megahertz(geometry.frequency_hz)}: bearings are off by up to {100.0 * off:.1f} %"
            )
    broken = [m for m in range(elements) if not np.isfinite(iq[m].view(np.float32)).all()]
    if broken:
        warnings.append(f"{path.name}: channel {text.listing([str(m) for m in broken])} holds NaN or infinity")
    power = np.array([_power(row) for row in iq])
    usual = float(np.nanmedian(power)) if np.isfinite(power).any() else 0.0
    dead = [m for m in range(elements) if power[m] <= usual * 10.0 ** (_DEAD_DB / 10.0)]  # NaN is not dead but broken
    if dead:
        warnings.append(
            f"{path.name}: channel {text.listing([str(m) for m in dead])} is dead (nothing in it): its cable, its gain?"
        )
    return warnings


def _power(row: npt.NDArray[np.complex64]) -> float:
    """Of the samples of a channel that are numbers; NaN without any."""
    good = row[np.isfinite(row)]
    return float(np.mean(np.square(np.abs(good), dtype=np.float64))) if good.size else math.nan


def _own_calibration(array_path: Path) -> Path | None:
    """The file that the array's description names, beside it."""
    tomlkit = require("tomlkit", "cli", "reading an array's description")
    named = tomlkit.parse(array_path.read_text(encoding="utf-8")).unwrap().get("calibration")
    return None if named is None else array_path.parent / str(named)


def _array_warnings(geometry: Any) -> list[str]:
    """What the array itself cannot tell apart."""
    warnings = []
    if geometry.rank == 1:
        warnings.append(
            "the elements lie on a line: directions around that line are alike, and a bearing may be its mirror image"
        )
    elif geometry.rank == 2:
        warnings.append("the elements lie in a plane: what comes from below is seen as if it came from above")
    return warnings


def find(
    captures: Sequence[Path],
    array_path: Path,
    *,
    calibration: Path | None,
    block_samples: int | None,
    block_s: float | None,
    every_s: float | None,
    sources: int | None,
    method: str,
    poses: Path | None,
    start_s: float,
    elevation_min_deg: float,
    smooth: int,
    step: Steps,
) -> Found:
    """Read, calibrate, and find directions block by block.

    Raises
    ------
    ValueError
        For captures that do not belong to the array, and blocks that do not fit into them.
    """
    manifold = array.load_array(array_path)
    geometry = manifold.geometry
    elements = len(geometry.positions_m)
    if sources is not None and not 1 <= sources < elements:
        raise ValueError(f"--sources {sources}: 1 … {elements - 1} expected with {elements} elements")
    if smooth > 1 and sources != 1:
        raise ValueError(f"--smooth {smooth}: eigenvalues tell deviations of one source, --sources 1")
    if smooth % 2 == 0:
        raise ValueError(f"--smooth {smooth}: an odd number of blocks expected")
    correction = None
    calibration = calibration or _own_calibration(array_path)
    if calibration is not None:
        correction = array.Calibration.load(calibration)
        correction.check(geometry, where=str(calibration))  # carrier and rate are each recording's
    way = None if poses is None else read_poses(poses)
    with python_warnings.catch_warnings(record=True) as said:
        python_warnings.simplefilter("always", array.AmbiguityWarning)
        finder = array.DirectionFinder(manifold, n_sources=sources, method=method, elevation_min_deg=elevation_min_deg)
    rows: list[_Row] = []
    eigenvalues: list[Array] = []
    warnings = _array_warnings(geometry) + [str(one.message) for one in said]
    best: _Best | None = None
    first: str | None = None
    end_s, rate_hz, samples = 0.0, 0.0, block_samples or _BLOCK
    for number, path in enumerate(captures):
        step(f"reading {path.name}", done=number, total=len(captures))
        iq, metadata = io.read_iq_channels(path)
        if number == 0:
            first, rate_hz = metadata.datetime_utc, metadata.sample_rate_hz
            if block_s is not None:
                samples = round(block_s * rate_hz)
        elif metadata.sample_rate_hz != rate_hz:
            raise ValueError(
                f"{path}: {text.rate(metadata.sample_rate_hz)}, but {captures[0].name} has {text.rate(rate_hz)}; "
                "one sample rate expected"
            )
        warnings += _check_capture(path, iq, metadata, geometry)
        if correction is not None:
            tuned = metadata.center_frequency_hz
            correction.check(
                geometry,
                geometry.frequency_hz if tuned is None else tuned,
                metadata.sample_rate_hz,
                where=f"{calibration} for {path.name}",
            )
        if samples < 2 * elements:
            raise ValueError(f"--block-samples {samples}: at least {2 * elements} expected with {elements} elements")
        if iq.shape[1] < samples:
            raise ValueError(f"{path}: {iq.shape[1]} samples, fewer than one block of {samples}")
        begin_s = 0.0 if number == 0 else _start_s(metadata, first, end_s)
        end_s = begin_s + metadata.duration_s
        stride = samples if every_s is None else max(1, round(every_s * rate_hz))
        starts = np.arange(0, iq.shape[1] - samples + 1, stride)
        if len(starts) + len(rows) > _MOST_BLOCKS:
            raise ValueError(
                f"{len(starts) + len(rows)} blocks; at most {_MOST_BLOCKS} expected: longer ones (--block-s) or fewer "
                "(--every-s)"
            )
        if correction is not None:
            iq = correction.apply(iq)
        for begin in starts.tolist():
            block = np.ascontiguousarray(iq[:, begin : begin + samples])
            time_s = begin_s + (begin + 0.5 * samples) / rate_hz
            best = _block(rows, eigenvalues, block, time_s, finder, best)
    step("drawing")
    found = Found(
        captures=list(captures),
        manifold=manifold,
        method=method,
        sources=sources,
        block_samples=samples,
        sample_rate_hz=rate_hz,
        t_s=np.array([row[0] for row in rows]) + start_s,
        azimuth_rad=np.array([row[2] for row in rows]),
        elevation_rad=np.array([row[3] for row in rows]),
        covariance_rad2=np.array([row[4] for row in rows]).reshape(-1, 2, 2),
        snr_db=np.array([row[5] for row in rows]),
        source=np.array([row[1] for row in rows], dtype=np.int64),
        status=[row[6] for row in rows],
        warnings=list(dict.fromkeys(warnings)),
    )
    if smooth > 1:
        step("working out deviations")
        found.covariance_rad2 = _smoothed(found, np.array(eigenvalues), smooth)
    if way is not None:
        found.poses = way.at(found.t_s)
    if best is not None:
        _, loudest, found.best, count = best
        found.grid_azimuth_rad = finder.table.azimuth_rad
        found.grid_elevation_rad = finder.table.elevation_rad
        found.spectrum = finder.spectrum(array.covariance(loudest), count)
    return found


def _block(
    rows: list[_Row],
    eigenvalues: list[Array],
    block: npt.NDArray[np.complex64],
    time_s: float,
    finder: Any,
    best: _Best | None,
) -> _Best | None:
    """Append the block's bearings, or why there are none; returns the block with the highest SNR so far."""
    heard = finder.estimate(block)
    word = str(getattr(heard.status, "name", heard.status)).lower()
    count = len(heard.azimuth_rad)
    known = len(heard.eigenvalues) == len(block)
    eigenvalues.append(heard.eigenvalues if known else np.full(len(block), np.nan))
    if not count:
        rows.append((time_s, 0, math.nan, math.nan, np.full((2, 2), np.nan), math.nan, word))
        return best
    for k in range(count):
        power = float(heard.power[k]) / heard.noise if heard.noise > 0.0 else math.nan
        snr_db = 10.0 * math.log10(power) if power > 0.0 else math.nan
        azimuth, elevation = float(heard.azimuth_rad[k]), float(heard.elevation_rad[k])
        rows.append((time_s, k, azimuth, elevation, np.asarray(heard.covariance_rad2[k]), snr_db, word))
        if k == 0 and word == "ok" and not math.isnan(snr_db) and (best is None or snr_db > best[0]):
            best = (snr_db, block, len(rows) - 1, count)
    return best


def _smoothed(found: Found, eigenvalues: Array, blocks: int) -> Array:
    """Covariances from eigenvalues averaged over blocks and a Monte-Carlo of the array (carter 5.3), with one row per
    block: what a single block says of itself promises too much where the signal is weak."""
    table = array.SigmaMap.build(found.manifold, found.block_samples, seed=0)
    ratio = table.smooth(eigenvalues, epochs=blocks)
    covariance = covariances_from_ratio(table, ratio, found.elevation_rad)
    covariance[~found.good] = np.nan
    return covariance


# ---- what is said of it


def _spread(values: Array) -> str:
    """``41.2° ± 0.7°``: circular mean and standard deviation."""
    mean = np.angle(np.mean(np.exp(1j * values)))
    deviation = np.sqrt(np.mean(np.square(np.angle(np.exp(1j * (values - mean))))))
    return f"{text.plain(math.degrees(mean), 1)}° ± {math.degrees(deviation):.1f}°"


def sentence(found: Found) -> str:
    """The outcome in one sentence."""
    blocks = len(np.unique(found.t_s))
    good = found.good
    if not good.any():
        counts = _counts(found)
        why = ", ".join(f"{n} {word.replace('_', ' ')}" for word, n in counts.items())
        return f"no bearing in {blocks} block{'s' * (blocks != 1)}: {why}"
    first = good & (found.source == 0)
    sigma = np.sqrt(found.covariance_rad2[first, 0, 0])
    words = [f"{int(good.sum())} bearings in {blocks} block{'s' * (blocks != 1)} of {found.block_samples} samples"]
    if found.poses is None:
        median = _degrees(float(np.median(sigma)))
        words.append(f"strongest at azimuth {_spread(found.azimuth_rad[first])} (σ stated {median})")
    else:
        words.append(f"σ from {_degrees(float(sigma.min()))} to {_degrees(float(sigma.max()))}")
    words.append(f"SNR {text.plain(float(np.median(found.snr_db[first])), 1)} dB")
    return "; ".join(words)


def _degrees(angle_rad: float) -> str:
    """``0.39°``, ``1.0°``, ``12°``."""
    value = math.degrees(angle_rad)
    return f"{value:.{2 if value < 1.0 else 1 if value < 10.0 else 0}f}°" if math.isfinite(value) else "–"


def _counts(found: Found) -> dict[str, int]:
    counts: dict[str, int] = {}
    for word in found.status:
        counts[word] = counts.get(word, 0) + 1
    return counts


def _sigmas(found: Found) -> tuple[Array, Array]:
    with np.errstate(invalid="ignore"):
        return np.sqrt(found.covariance_rad2[:, 0, 0]), np.sqrt(found.covariance_rad2[:, 1, 1])


def _columns(found: Found) -> dict[str, list[str]]:
    """Every row as text by column; empty where there is nothing."""

    def numbers(values: Array, digits: int) -> list[str]:
        return [f"{v:.{digits}f}" if math.isfinite(v) else "" for v in values]

    sigma_azimuth, sigma_elevation = _sigmas(found)
    single = found.sources == 1
    columns = {
        "time_s": numbers(found.t_s, 6),
        "emitter": [("1" if single else "") for _ in found.t_s],
        "azimuth_deg": numbers(np.degrees(found.azimuth_rad), 4),
        "elevation_deg": numbers(np.degrees(found.elevation_rad), 4),
        "sigma_azimuth_deg": numbers(np.degrees(sigma_azimuth), 4),
        "sigma_elevation_deg": numbers(np.degrees(sigma_elevation), 4),
        "snr_db": numbers(found.snr_db, 2),
        "status": list(found.status),
    }
    poses = found.poses
    if poses is None:
        return columns
    if poses.frame is None:
        columns |= {f"{axis}_m": numbers(poses.position_m[:, k], 4) for k, axis in enumerate("xyz")}
    else:
        latitude, longitude, height = poses.frame.position_to_geodetic(poses.position_m)
        columns |= {
            "latitude_deg": numbers(np.degrees(latitude), 9),
            "longitude_deg": numbers(np.degrees(longitude), 9),
            "height_m": numbers(height, 3),
        }
    _, elevation, spread = poses.to_level(found.azimuth_rad, found.elevation_rad, found.covariance_rad2)
    with np.errstate(invalid="ignore"):
        sigma_bearing, sigma_level = np.sqrt(spread[:, 0, 0]), np.sqrt(spread[:, 1, 1])
    columns |= {
        "heading_deg": numbers(np.degrees(poses.heading_rad), 4),
        "bearing_deg": numbers(found.compass_deg, 4),
        "bearing_elevation_deg": numbers(np.degrees(elevation), 4),
        "sigma_bearing_deg": numbers(np.degrees(np.minimum(sigma_bearing, np.pi)), 4),
        "sigma_bearing_elevation_deg": numbers(np.degrees(np.minimum(sigma_level, np.pi)), 4),
    }
    return columns


def as_json(found: Found) -> dict[str, Any]:
    """The numbers of metrics.json and of ``--json``."""
    good = found.good
    first = good & (found.source == 0)
    geometry = found.manifold.geometry
    sigma_azimuth, sigma_elevation = _sigmas(found)

    def median(values: Array) -> float | None:
        picked = values[first][np.isfinite(values[first])]
        return float(np.median(picked)) if picked.size else None

    def mean_deg(values: Array) -> float | None:
        return math.degrees(float(np.angle(np.mean(np.exp(1j * values[first]))))) if first.any() else None

    return {
        "captures": [str(path) for path in found.captures],
        "array": {"name": geometry.name, "elements": len(geometry.positions_m), "frequency_hz": geometry.frequency_hz},
        "method": found.method,
        "sources": found.sources,
        "block_samples": found.block_samples,
        "blocks": len(np.unique(found.t_s)),
        "bearings": int(good.sum()),
        "status": _counts(found),
        "strongest": {
            "azimuth_deg": mean_deg(found.azimuth_rad),
            "elevation_deg": mean_deg(found.elevation_rad),
            "sigma_azimuth_deg": None if (s := median(sigma_azimuth)) is None else math.degrees(s),
            "sigma_elevation_deg": None if (s := median(sigma_elevation)) is None else math.degrees(s),
            "snr_db": median(found.snr_db),
        },
        "warnings": found.warnings,
    }


def _rows_shown(found: Found) -> list[int]:
    n = len(found.t_s)
    return list(range(n)) if n <= _MOST_ROWS else np.linspace(0, n - 1, _MOST_ROWS).round().astype(int).tolist()


def _cells(found: Found, k: int) -> list[str]:
    sigma_azimuth, sigma_elevation = (float(values[k]) for values in _sigmas(found))
    dash = "–"
    good = math.isfinite(found.azimuth_rad[k])
    cells = [
        f"{found.t_s[k]:.3f} s",
        str(found.source[k] + 1) if good else dash,
        f"{text.plain(math.degrees(found.azimuth_rad[k]), 2)}° ± {_degrees(sigma_azimuth)}" if good else dash,
        f"{text.plain(math.degrees(found.elevation_rad[k]), 2)}° ± {_degrees(sigma_elevation)}" if good else dash,
        f"{text.plain(float(found.snr_db[k]), 1)} dB" if math.isfinite(found.snr_db[k]) else dash,
    ]
    if found.poses is not None:
        bearing = found.compass_deg[k]
        cells.append(f"{bearing:.2f}°" if math.isfinite(bearing) else dash)
    return [*cells, found.status[k].replace("_", " ")]


def _head(found: Found) -> tuple[str, ...]:
    bearing = () if found.poses is None else ("bearing",)
    return ("time", "source", "azimuth", "elevation", "SNR", *bearing, "status")


def print_result(found: Found, console: Console) -> None:
    """The table a person reads, the warnings, and the outcome."""
    geometry = found.manifold.geometry
    name = geometry.name or "array"
    console.print(
        f"{name}: {len(geometry.positions_m)} elements at {text.megahertz(geometry.frequency_hz)}, "
        f"{found.method.upper() if found.method == 'music' else found.method.capitalize()}",
        highlight=False, soft_wrap=True, markup=False,
    )  # fmt: skip
    shown = Table(box=None, padding=(0, 1), header_style="bold")
    for column in _head(found):
        shown.add_column(column, justify="left" if column == "status" else "right", no_wrap=True)
    picked = _rows_shown(found)
    for k in picked:
        shown.add_row(*_cells(found, k))
    console.print(shown, highlight=False)
    if len(picked) < len(found.t_s):
        console.print(f"{len(picked)} of {len(found.t_s)} rows; all are in bearings.csv", highlight=False)
    for warning in found.warnings:
        console.print(f"warning: {warning}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"{sentence(found)}.", highlight=False, soft_wrap=True, markup=False)


def write_report(found: Found, folder: Path) -> Path:
    """Write bearings.csv, metrics.json, spectrum.png, azimuth.png and report.html; returns the last."""
    folder.mkdir(parents=True, exist_ok=True)
    columns = _columns(found)
    write_table(
        folder / "bearings.csv",
        list(columns),
        [[cells[k] for cells in columns.values()] for k in range(len(found.t_s))],
    )
    content = json.dumps(as_json(found), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "metrics.json").write_text(content + "\n", encoding="utf-8")
    title = found.captures[0].stem if len(found.captures) == 1 else f"{len(found.captures)} captures"
    pictures: list[tuple[str, Path]] = []
    good = found.good
    if good.any():
        sigma_azimuth, sigma_elevation = _sigmas(found)
        several = len(np.unique(found.t_s)) > 1
        if several:
            plotting.bearings_over_time(
                found.t_s[good],
                found.azimuth_rad[good],
                sigma_rad=sigma_azimuth[good],
                elevation_rad=found.elevation_rad[good],
                sigma_elevation_rad=sigma_elevation[good],
                snr_db=found.snr_db[good],
                source=found.source[good],
                title=f"{title}: bearings in array axes",
                path=folder / "azimuth.png",
            )
            pictures.append(
                (
                    "Azimuth (from the array's forward axis to its left), elevation and SNR per element over time, "
                    "with the standard deviation that is stated of each.",
                    folder / "azimuth.png",
                )
            )
    if found.spectrum is not None:
        rows = (found.t_s == found.t_s[found.best]) & np.isfinite(found.azimuth_rad)
        directions = np.column_stack([found.azimuth_rad[rows], found.elevation_rad[rows]])
        plane = len(found.grid_elevation_rad) > 1 and len(found.grid_azimuth_rad) > 1
        plotting.polar_spectrum(
            found.grid_azimuth_rad,
            found.spectrum if plane else found.spectrum.reshape(-1),
            elevation_rad=found.grid_elevation_rad if plane else None,
            bearings_rad=directions,
            title=f"{title}: spectrum at {found.t_s[found.best]:.3f} s",
            path=folder / "spectrum.png",
        )
        pictures.append(
            (
                f"Spatial spectrum ({found.method}) of the block with the highest SNR: forward is up, left is left, "
                "the zenith in the middle.",
                folder / "spectrum.png",
            )
        )
    rows = table(
        _head(found), [("" if found.status[k] == "ok" else "bad", _cells(found, k)) for k in _rows_shown(found)]
    )
    geometry = found.manifold.geometry
    said = sentence(found)
    report = folder / "report.html"
    report.write_text(
        page(
            f"Bearings from {title}",
            under=f"{geometry.name or 'array'}: {len(geometry.positions_m)} elements at "
            f"{text.megahertz(geometry.frequency_hz)}; {found.method}, blocks of {found.block_samples} samples",
            lead=f"{said[:1].upper()}{said[1:]}.",
            notes=found.warnings,
            tables=[("Bearings", rows)],
            pictures=pictures,
            foot="Azimuth counts from the array's axis 1 (forward) towards its axis 2 (left), elevation up from their "
            "plane; bearings are clockwise from true north. Every row is in bearings.csv.",
        ),
        encoding="utf-8",
    )
    return report
