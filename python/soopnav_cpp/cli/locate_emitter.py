"""``soopnav locate-emitter``: from bearings to the places of the emitters."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import estimation, plotting
from soopnav_cpp.cli import text
from soopnav_cpp.cli.page import page, table
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios import emitters as work
from soopnav_cpp.scenarios.bearings import BearingsData, read_bearings, write_bearings
from soopnav_cpp.scenarios.emitter_files import MapItem, write_emitter_geojson, write_emitter_kml
from soopnav_cpp.scenarios.emitters import Emitter, has_position, status_word

__all__ = ["Result", "as_json", "locate", "print_result", "sentences", "write_report"]

Array = npt.NDArray[np.float64]
_LONGEST_WORD = 40  # of an emitter's name in a file name


@dataclass(eq=False)
class Result:
    """Emitters that were looked for.

    Attributes
    ----------
    path : Path
        Bearings or scenario.
    title : str
    data : BearingsData
        All bearings.
    emitters : list of Emitter
    unassigned : int
        Bearings that belong to no emitter.
    dimensions : int
    notes : list of str
    """

    path: Path
    title: str
    data: BearingsData
    emitters: list[Emitter]
    unassigned: int
    dimensions: int
    notes: list[str] = field(default_factory=list)

    @property
    def found(self) -> bool:
        """Whether every emitter has a position."""
        return all(emitter.found for emitter in self.emitters)


def _methods(method: str | None, moving: bool) -> tuple[str, ...]:
    known = work.MOVING_METHODS if moving else work.METHODS
    if method is None:
        return ("ml",)
    if method == "all":
        return known
    if method not in work.METHODS:
        raise ValueError(f"--method {method}: one of {', '.join(work.METHODS)} or all expected")
    if method not in known:
        raise ValueError(f"--method {method} finds emitters that stand still; with --moving: {', '.join(known)}")
    return (method,)


def _placed(data: BearingsData, origin: tuple[float, ...] | None) -> BearingsData:
    """Local metres put on the Earth."""
    if origin is None:
        return data
    if data.frame is not None:
        raise ValueError("--origin is for bearings in local metres; these have latitudes and longitudes")
    latitude, longitude, height = (*origin, 0.0)[:3]
    if not abs(latitude) <= 90.0 or not -180.0 <= longitude <= 360.0:
        raise ValueError(f"--origin {latitude:g},{longitude:g}: a latitude and a longitude in degrees expected")
    frame = LocalFrame(math.radians(latitude), math.radians(longitude), height)
    return dataclasses.replace(data, frame=frame)


def locate(
    path: Path,
    *,
    method: str | None,
    dimensions: int | None,
    moving: bool,
    associate: bool,
    sigma_deg: float | None,
    origin: tuple[float, ...] | None,
    repair: bool,
    seed: int | None,
    step: Steps,
) -> Result:
    """Read bearings, or run the scenario that makes them, and locate what they point at.

    Raises
    ------
    ValueError
        For a file that does not fit, in a sentence per mistake, and for options that a scenario has no use for.
    """
    if path.suffix.lower() == ".toml":
        given = {
            "dimensions": dimensions is not None,
            "moving": moving,
            "associate": associate,
            "sigma": sigma_deg is not None,
            "origin": origin is not None,
            "repair": repair,
        }
        _refuse_with_scenario(path, [name for name, there in given.items() if there])
        return _of_scenario(path, method=method, seed=seed, step=step)
    methods = _methods(method, moving)
    dimensions = dimensions or 2
    step(f"reading {path.name}")
    sigma_rad = None if sigma_deg is None else math.radians(sigma_deg)
    data = _placed(read_bearings(path, sigma_rad=sigma_rad, repair=repair), origin)
    if dimensions == 3 and data.elevation_rad is None:
        raise ValueError(f"{path}: no elevations; --dimensions 3 needs a column bearing_elevation_deg or elevation_deg")
    return _solved(
        path,
        f"What {path.name} points at",
        data,
        methods,
        dimensions=dimensions,
        moving=moving,
        groups=work.separate(data, force=associate, moving=moving),
        seed=1 if seed is None else seed,
        step=step,
    )


_SAID_BY_SCENARIO = {"dimensions": "locator.dimensions", "moving": "locator.moving", "origin": "origin"}


def _refuse_with_scenario(path: Path, given: Sequence[str]) -> None:
    """Options that are for files of bearings."""
    for name in given:
        instead = f"; {_SAID_BY_SCENARIO[name]} in the scenario says it" if name in _SAID_BY_SCENARIO else ""
        raise ValueError(f"--{name} is for files of bearings, and {path.name} is a scenario{instead}")


def _of_scenario(path: Path, *, method: str | None, seed: int | None, step: Steps) -> Result:
    from soopnav_cpp import scenarios
    from soopnav_cpp.scenarios import source_localization_pipeline as pipeline
    from soopnav_cpp.scenarios.execution import seed_of_run
    from soopnav_cpp.scenarios.source_localization import SourceLocalization, SourceLocalizationScenario

    system, scenario = scenarios.load(path, seed=seed)
    if not isinstance(system, SourceLocalization) or not isinstance(scenario, SourceLocalizationScenario):
        raise ValueError(f'{path}: system = "{system.name}": source_localization expected')
    step("listening")
    first = seed_of_run(scenario, 1)  # what soopnav run begins with
    heard = pipeline.hear(scenario, first)
    settings = scenario.locator
    methods = settings.methods if method is None else _methods(method, settings.moving)
    return _solved(
        path,
        scenario.title or path.stem,
        heard.data,
        methods,
        dimensions=settings.dimensions,
        moving=settings.moving,
        groups=pipeline.groups(scenario, heard),
        seed=first,
        step=step,
        notes=list(heard.notes),
    )


def _solved(
    path: Path,
    title: str,
    data: BearingsData,
    methods: Sequence[str],
    *,
    dimensions: int,
    moving: bool,
    groups: tuple[dict[str, BearingsData], int],
    seed: int,
    step: Steps,
    notes: Sequence[str] = (),
) -> Result:
    parts, unassigned = groups
    if not parts:
        raise ValueError(f"{path}: no emitter can be told from these {len(data)} bearings")
    found = []
    for number, (name, part) in enumerate(parts.items()):
        step(f"locating {name}", done=number, total=len(parts))
        found.append(work.solve(name, part, methods, dimensions=dimensions, moving=moving, seed=seed))
    return Result(path, title, data, found, unassigned, dimensions, [*notes, *data.dropped])


# ---- words


def place(data: BearingsData, position_m: npt.ArrayLike, sigma_m: float, dimensions: int) -> str:
    """``52.20512 N  0.12184 E`` or ``east 180.1 m  north −119.9 m``."""
    position = np.asarray(position_m, dtype=np.float64)
    degrees = data.degrees(position)
    if degrees is not None:
        digits = 5 if sigma_m >= 1.0 else 6 if sigma_m >= 0.1 else 7
        latitude, longitude, height = degrees
        line = (
            f"{abs(latitude):.{digits}f} {'N' if latitude >= 0 else 'S'}  "
            f"{abs(longitude):.{digits}f} {'E' if longitude >= 0 else 'W'}"
        )
        return line if dimensions == 2 else f"{line}  height {text.plain(height, 1)} m"
    digits = 1 if sigma_m >= 1.0 else 2
    line = f"east {text.plain(position[0], digits)} m  north {text.plain(position[1], digits)} m"
    return line if dimensions == 2 else f"{line}  up {text.plain(position[2], digits)} m"


def _length(length_m: float) -> str:
    """As `text.metres`, kilometres from ten on."""
    return text.metres(length_m) if length_m < 1e4 else f"{length_m / 1e3:.0f} km"


def _ellipse(fix: Any) -> dict[str, float] | None:
    """Of 95 % probability."""
    matrix = np.asarray(fix.covariance_m2, dtype=np.float64)[:2, :2]
    matrix = 0.5 * (matrix + matrix.T)
    if not np.isfinite(matrix).all() or not np.linalg.eigvalsh(matrix)[0] > 0.0:
        return None
    ellipse = estimation.error_ellipse(matrix, probability=0.95)
    return {
        "semi_major_m": ellipse.semi_major_m,
        "semi_minor_m": ellipse.semi_minor_m,
        "azimuth_deg": (90.0 - math.degrees(ellipse.angle_rad)) % 180.0,
    }


def _line_of(emitter: Emitter) -> tuple[Array, float, float] | None:
    """Point, bearing and its deviation of the line that an emitter lies on."""
    line = getattr(emitter.fix, "line", None)
    if line is None:
        return None
    direction = np.asarray(line.direction, dtype=np.float64)
    return (
        np.asarray(line.point_m, dtype=np.float64),
        math.atan2(float(direction[1]), float(direction[0])),
        float(line.sigma_rad),
    )


def _sigma(fix: Any) -> float:
    matrix = np.asarray(fix.covariance_m2, dtype=np.float64)
    return math.sqrt(max(0.0, float(np.trace(matrix)))) if np.isfinite(matrix).all() else math.nan


def describe(result: Result, emitter: Emitter) -> str:
    """One emitter in a sentence."""
    fix, n = emitter.fix, len(emitter.data)
    if not emitter.found:
        line = _line_of(emitter)
        if line is not None:
            compass = (90.0 - math.degrees(line[1])) % 360.0
            return (
                f"{emitter.name}: no position: {n} bearings give a line alone, at {compass:.1f}° ± "
                f"{math.degrees(line[2]):.2g}° from {place(result.data, line[0][:2], 10.0, 2)}; bearings from "
                "elsewhere are needed"
            )
        return f"{emitter.name}: no position: {str(fix.message).rstrip('.')}"
    ellipse = _ellipse(fix)
    words = f"{emitter.name}: {place(result.data, fix.position_m, _sigma(fix), result.dimensions)}"
    if ellipse is not None:
        words += (
            f"  95 % within {_length(ellipse['semi_major_m'])} × {_length(ellipse['semi_minor_m'])} "
            f"(long axis {ellipse['azimuth_deg']:.0f}°)"
        )
    if math.isfinite(fix.cep_m):
        words += f"  CEP {_length(fix.cep_m)}"
    words += f"  from {n} bearings by {emitter.method}"
    error = emitter.error_m(emitter.method)
    if error is not None:
        words += f"; {_length(error)} from the truth"
    if status_word(fix) != "converged":
        words += f"; caution: {str(fix.message).rstrip('.')}"
    return words


def sentences(result: Result) -> list[str]:
    """The outcome, a sentence per emitter."""
    lines = [describe(result, emitter) for emitter in result.emitters]
    if result.unassigned:
        lines.append(f"{result.unassigned} bearings belong to no emitter")
    return lines


_HEAD = ("emitter", "method", "position", "95 % ellipse", "CEP", "status")


def _row(result: Result, emitter: Emitter, method: str) -> list[str]:
    fix = emitter.fixes[method]
    good = has_position(fix)
    ellipse = _ellipse(fix) if good else None
    dash = "–"
    cells = [
        emitter.name,
        method,
        place(result.data, fix.position_m, _sigma(fix), result.dimensions) if good else dash,
        dash
        if ellipse is None
        else f"{_length(ellipse['semi_major_m'])} × {_length(ellipse['semi_minor_m'])}, {ellipse['azimuth_deg']:.0f}°",
        _length(fix.cep_m) if good and math.isfinite(fix.cep_m) else dash,
        status_word(fix).replace("_", " "),
    ]
    if result.data.truth_m is not None:
        error = emitter.error_m(method)
        cells.append(dash if error is None else _length(error))
    return cells


def _head(result: Result) -> tuple[str, ...]:
    return (*_HEAD, "error") if result.data.truth_m is not None else _HEAD


def print_result(result: Result, console: Console) -> None:
    """The table of methods, then a sentence per emitter."""
    shown = Table(box=None, padding=(0, 1), header_style="bold")
    for name in _head(result):
        shown.add_column(name, justify="right" if name in ("CEP", "error") else "left", no_wrap=True)
    for emitter in result.emitters:
        for method in emitter.fixes:
            shown.add_row(*_row(result, emitter, method))
    console.print(shown, highlight=False)
    for note in result.notes:
        console.print(f"note: {note}", highlight=False, soft_wrap=True, markup=False)
    for line in sentences(result):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _fix_json(result: Result, emitter: Emitter, method: str) -> dict[str, Any]:
    fix = emitter.fixes[method]
    good = has_position(fix)
    degrees = result.data.degrees(fix.position_m) if good else None
    found: dict[str, Any] = {
        "status": status_word(fix),
        "position_m": [float(v) for v in np.asarray(fix.position_m)] if good else None,
        "latitude_deg": None if degrees is None else degrees[0],
        "longitude_deg": None if degrees is None else degrees[1],
        "height_m": None if degrees is None or result.dimensions == 2 else degrees[2],
        "covariance_m2": np.asarray(fix.covariance_m2).tolist()
        if good and np.isfinite(np.asarray(fix.covariance_m2)).all()
        else None,
        "ellipse_95": _ellipse(fix) if good else None,
        "cep_m": float(fix.cep_m) if good and math.isfinite(fix.cep_m) else None,
        "error_m": emitter.error_m(method),
        "message": str(fix.message),
    }
    velocity = np.asarray(getattr(fix, "velocity_mps", math.nan), dtype=np.float64)
    if velocity.ndim == 1 and np.isfinite(velocity).all():
        found["velocity_mps"] = velocity.tolist()
    return found


def as_json(result: Result) -> dict[str, Any]:
    """The numbers of metrics.json and of ``--json``."""
    emitters = []
    for emitter in result.emitters:
        line = _line_of(emitter) if not emitter.found else None
        emitters.append(
            {
                "name": emitter.name,
                "bearings": len(emitter.data),
                "method": emitter.method,
                "found": emitter.found,
                "line": None
                if line is None
                else {
                    "point_m": line[0][:2].tolist(),
                    "bearing_deg": (90.0 - math.degrees(line[1])) % 360.0,
                    "sigma_deg": math.degrees(line[2]),
                },
                "methods": {name: _fix_json(result, emitter, name) for name in emitter.fixes},
            }
        )
    return {
        "source": str(result.path),
        "dimensions": result.dimensions,
        "bearings": len(result.data),
        "unassigned": result.unassigned,
        "emitters": emitters,
        "notes": result.notes,
    }


# ---- files


def _map_items(result: Result) -> list[MapItem]:
    items = []
    for emitter in result.emitters:
        line = None if emitter.found else _line_of(emitter)
        fix = emitter.fix
        velocity = np.asarray(getattr(fix, "velocity_mps", math.nan), dtype=np.float64)
        history = emitter.histories.get(emitter.method)
        moving = velocity.ndim == 1 and np.isfinite(velocity).all()
        items.append(
            MapItem(
                emitter.name,
                emitter.method,
                emitter.data,
                position_m=fix.position_m if emitter.found else None,
                covariance_m2=fix.covariance_m2 if emitter.found else None,
                cep_m=fix.cep_m if emitter.found else math.nan,
                line=None if line is None else (line[0], line[1]),
                track_m=history.position_m if moving and history is not None else None,
            )
        )
    return items


def _slug(emitter: Emitter, result: Result, name: str) -> str:
    """File name of a figure of one emitter."""
    if len(result.emitters) == 1:
        return f"{name}.png"
    number = 1 + result.emitters.index(emitter)  # names that differ may look alike once spelled for a file
    word = "".join(c if c.isalnum() else "_" for c in emitter.name.lower())[:_LONGEST_WORD]
    return f"{name}_{number}_{word}.png"


def figures(result: Result, folder: Path) -> list[tuple[str, Path]]:
    """Draw what there is; captions and files."""
    drawn: list[tuple[str, Path]] = []
    data = result.data
    many = len(result.emitters) > 1
    who = np.full(len(data), -1, np.int64) if many or result.unassigned else np.zeros(len(data), np.int64)
    if many or result.unassigned:
        for number, emitter in enumerate(result.emitters):
            mine = set(zip(emitter.data.t_s.tolist(), emitter.data.bearing_rad.tolist(), strict=True))
            rows = [pair in mine for pair in zip(data.t_s.tolist(), data.bearing_rad.tolist(), strict=True)]
            who[np.array(rows)] = number
    fixes: dict[str, Any] = {}
    for emitter in result.emitters:
        if many:
            fixes[emitter.name] = emitter.fix if emitter.found else None  # a place in the order, for its colour
        else:
            fixes = {name: fix for name, fix in emitter.fixes.items() if has_position(fix)}
    lines = [line for emitter in result.emitters if not emitter.found and (line := _line_of(emitter)) is not None]
    truths = None if many else data.truth_m
    plotting.bearings_map(
        data.position_m,
        data.bearing_rad,
        sigmas_rad=data.sigma_rad,
        fixes=fixes,
        source=who,
        truth_m=truths,
        line=(lines[0][0], lines[0][1]) if lines else None,
        title=result.title,
        path=folder / "map.png",
    )
    drawn.append(
        ("Bearings from where they were taken, and the positions found with their 95 % ellipses.", folder / "map.png")
    )
    for emitter in result.emitters:
        name = f"{emitter.name}: " if many else ""
        if emitter.surface is not None:
            x, y, surface = emitter.surface
            file = folder / _slug(emitter, result, "likelihood")
            fix = {emitter.method: emitter.fix} if emitter.found else None
            plotting.likelihood(
                x, y, surface, fix=fix, truth_m=emitter.truth_m, positions_m=emitter.data.position_m,
                title=f"{name}how likely each place is", path=file,
            )  # fmt: skip
            drawn.append((f"{name}How likely each place is from the bearings alone; lines at 1, 2 and 3 σ.", file))
        if emitter.cloud is not None:
            file = folder / _slug(emitter, result, "particles")
            particle = emitter.fixes.get("particle")
            plotting.particles(
                *emitter.cloud, fix={"particle": particle} if particle is not None else None, truth_m=emitter.truth_m,
                title=f"{name}particles at the last bearing", path=file,
            )  # fmt: skip
            drawn.append((f"{name}Particles at the last bearing.", file))
        drawn += _error_figure(result, emitter, folder, name)
    return drawn


def _error_figure(result: Result, emitter: Emitter, folder: Path, name: str) -> list[tuple[str, Path]]:
    """Distance from the truth over time by method, or without a truth what is stated of it."""
    if not emitter.histories:
        return []
    main = emitter.histories.get(emitter.method) or next(iter(emitter.histories.values()))
    if len(main.t_s) < 2:
        return []
    curves = {}
    for method, history in emitter.histories.items():
        if emitter.data.truth_m is None:
            values = np.sqrt(np.trace(history.covariance_m2[:, :2, :2], axis1=1, axis2=2))
        else:
            right = np.column_stack([np.interp(history.t_s, emitter.data.t_s, c) for c in emitter.data.truth_m.T[:2]])
            values = np.linalg.norm(history.position_m[:, :2] - right, axis=1)
        full = np.full(len(main.t_s), np.nan)
        at = np.searchsorted(main.t_s, history.t_s)
        at = np.clip(at, 0, len(main.t_s) - 1)
        same = np.abs(main.t_s[at] - history.t_s) < 1e-9
        full[at[same]] = values[same]
        curves[method] = full
    sigma = np.sqrt(np.trace(main.covariance_m2[:, :2, :2], axis1=1, axis2=2))
    file = folder / _slug(emitter, result, "errors")
    stated = emitter.data.truth_m is None
    plotting.source_errors(main.t_s, curves, sigma_m=sigma, stated=stated, path=file)
    what = "Distance from the truth" if emitter.data.truth_m is not None else "Stated standard deviation"
    return [(f"{name}{what} over time by method, and the deviation that {emitter.method} states.", file)]


def write_report(result: Result, folder: Path) -> Path:
    """Write emitter.geojson, emitter.kml (on the Earth), bearings.csv, metrics.json, figures and report.html."""
    folder.mkdir(parents=True, exist_ok=True)
    items = _map_items(result)
    write_emitter_geojson(items, result.data, folder / "emitter.geojson")
    if result.data.frame is not None:
        write_emitter_kml(items, result.data, folder / "emitter.kml")
    else:
        (folder / "emitter.kml").unlink(missing_ok=True)  # of an earlier run
    if result.path.resolve() != (folder / "bearings.csv").resolve():
        write_bearings(result.data, folder / "bearings.csv")
    content = json.dumps(as_json(result), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "metrics.json").write_text(content + "\n", encoding="utf-8")
    pictures = figures(result, folder)
    rows = [
        ("" if has_position(emitter.fixes[method]) else "bad", _row(result, emitter, method))
        for emitter in result.emitters
        for method in emitter.fixes
    ]
    lines = sentences(result)
    frame = "local metres" if result.data.frame is None else "latitude and longitude (WGS-84)"
    report = folder / "report.html"
    report.write_text(
        page(
            result.title,
            under=f"{result.path.name}: {len(result.data)} bearings from {result.data.t_s[0]:g} to "
            f"{result.data.t_s[-1]:g} s",
            lead=f"{lines[0][:1].upper()}{lines[0][1:]}.",
            notes=[*(f"{line}." for line in lines[1:]), *result.notes],
            tables=[("Methods", table(_head(result), rows))],
            pictures=pictures,
            foot=f"Positions in {frame}; bearings are clockwise from true north.",
        ),
        encoding="utf-8",
    )
    return report
