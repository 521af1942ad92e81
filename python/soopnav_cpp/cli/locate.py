"""``soopnav locate``: from a capture and the positions of its cells to a position of the receiver."""

from __future__ import annotations

import base64
import dataclasses
import html
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console

from soopnav_cpp import estimation, geometry, lte, navigation, plotting
from soopnav_cpp.cli import scan as scanning
from soopnav_cpp.cli import text
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.navigation import FixStatus, NodeUse
from soopnav_cpp.scenarios import Node, NodesFile, load_nodes

__all__ = ["LocateError", "Located", "as_json", "locate", "print_result", "stem", "write_report"]

_SAME_PLACE_M = 1e-3
_LINE_SHARE = 1e-3  # of the widest spread: narrower than that is a line
_RECENTRINGS = 3  # of the tangent plane on the solution; each takes its curvature error down a thousandfold


class LocateError(ValueError):
    """The capture and the nodes give no position; the message says why."""


@dataclasses.dataclass(frozen=True)
class Heard:
    """A node of the file that the capture holds."""

    node: Node
    toa_s: float
    sigma_s: float

    @property
    def label(self) -> str:
        """``cell 301 (north)``."""
        return f"cell {self.node.cell_id}" + (f" ({self.node.name})" if self.node.name else "")


@dataclasses.dataclass(frozen=True)
class Located:
    """A position and all that led to it."""

    scan: scanning.Scan
    nodes_path: Path
    nodes: NodesFile
    heard: list[Heard]
    antennas_m: npt.NDArray[np.float64]  # of `heard`, in the fix's frame, shape (n, 3)
    fix: navigation.PositionFix
    frame: geometry.LocalFrame | None  # the fix's frame on the Earth, when known
    unlisted: list[int]  # cells found that the file does not list
    silent: list[int]  # cells listed that were not found

    @property
    def sigma_m(self) -> float:
        """Root of the summed variances of the coordinates estimated."""
        return math.sqrt(float(np.trace(self.fix.covariance_m2[: self.fix.dimensions, : self.fix.dimensions])))

    def degrees(self, position_m: npt.ArrayLike) -> tuple[float, float, float] | None:
        """Latitude, longitude and height of a position of the fix's frame."""
        if self.frame is None:
            return None
        latitude, longitude, height = self.frame.position_to_geodetic(position_m)
        return math.degrees(latitude), math.degrees(longitude), float(height)


def stem(capture: Path) -> str:
    """Name of a capture without its suffix."""
    return capture.stem if capture.suffix else capture.name


def locate(
    capture: Path,
    nodes_path: Path,
    *,
    rate_hz: float | None,
    sample_format: str | None,
    max_cfo_hz: float,
    step: Steps,
) -> Located:
    """Scan the capture and solve for position and clock.

    Raises
    ------
    LocateError
        When cells and nodes give no position, in a sentence.
    """
    nodes = load_nodes(nodes_path)
    scan = scanning.scan(capture, rate_hz=rate_hz, sample_format=sample_format, max_cfo_hz=max_cfo_hz, step=step)
    step("solving")
    middle_s = scan.metadata.duration_s / 2.0
    arrivals: dict[int, tuple[float, float]] = {}
    for cell in scan.cells:  # strongest first: of one identity heard twice, that one
        if cell.arrival is not None and cell.detection.cell_id not in arrivals:
            arrivals[cell.detection.cell_id] = lte.arrival_at(cell.arrival, middle_s)
    heard = [Heard(node, *arrivals[node.cell_id]) for node in nodes.nodes if node.cell_id in arrivals]
    unlisted = sorted(set(arrivals) - {node.cell_id for node in nodes.nodes})
    silent = [node.cell_id for node in nodes.nodes if node.cell_id not in arrivals]
    if not heard:
        found = text.listing([str(cell_id) for cell_id in unlisted]) if unlisted else "none"
        raise LocateError(f"{capture}: no cell of {nodes_path} was found in it; cells found: {found}")
    fix, frame, antennas = _solve(nodes, heard)
    located = Located(scan, nodes_path, nodes, heard, antennas, fix, frame, unlisted, silent)
    _refuse(located)
    return located


def _solve(
    nodes: NodesFile, heard: list[Heard]
) -> tuple[navigation.PositionFix, geometry.LocalFrame | None, npt.NDArray[np.float64]]:
    """The fix, its frame on the Earth, and the antennas in it."""
    height = nodes.receiver.height_m
    if not nodes.nodes[0].geodetic:
        antennas = np.array(
            [np.add(h.node.position_m or (0.0, 0.0, 0.0), (0.0, 0.0, h.node.antenna_height_m)) for h in heard]
        )
        origin = nodes.origin
        frame = None
        if origin is not None:
            frame = geometry.LocalFrame(
                math.radians(origin.latitude_deg), math.radians(origin.longitude_deg), origin.height_m
            )
        return _fix(heard, antennas, height), frame, antennas

    places = np.array(
        [
            (
                math.radians(h.node.latitude_deg or 0.0),
                math.radians(h.node.longitude_deg or 0.0),
                (h.node.height_m or 0.0) + h.node.antenna_height_m,
            )
            for h in heard
        ]
    )
    # A stated height is one above the ellipsoid, from which a tangent plane bends away: centre it on the solution.
    latitude, longitude = places[0, :2]
    base = places[0, 2] if height is None else height
    for attempt in range(_RECENTRINGS + 1):
        frame = geometry.LocalFrame(latitude, longitude, base)
        antennas = frame.position_from_geodetic(places[:, 0], places[:, 1], places[:, 2])
        fix = _fix(heard, antennas, None if height is None else 0.0)
        if attempt == _RECENTRINGS or not np.isfinite(fix.position_m).all():
            break
        latitude, longitude, _ = (float(value) for value in frame.position_to_geodetic(fix.position_m))
    return fix, frame, antennas


def _fix(heard: list[Heard], antennas: npt.NDArray[np.float64], height_m: float | None) -> navigation.PositionFix:
    return navigation.position_fix(
        antennas,
        [h.toa_s for h in heard],
        [h.sigma_s for h in heard],
        clock_offsets_s=[h.node.clock_offset_s for h in heard],
        node_sigmas_s=[h.node.sigma_s for h in heard],
        dimensions=3 if height_m is None else 2,
        height_m=height_m,
    )


def _refuse(located: Located) -> None:
    """Nothing when there is a position that stands; otherwise why not."""
    fix, nodes = located.fix, located.nodes
    dimensions = "three dimensions" if nodes.receiver.height_m is None else "two dimensions"
    hint = "; with [receiver] height_m three nodes are enough" if nodes.receiver.height_m is None else ""
    cells = text.listing([str(h.node.cell_id) for h in located.heard])
    reason = None
    # Spread of the antennas along their principal axes, widest first.
    spread_m = np.linalg.svd(located.antennas_m - located.antennas_m.mean(axis=0), compute_uv=False)
    undetermined = fix.status in (FixStatus.RANK_DEFICIENT, FixStatus.NOT_CONVERGED)
    if fix.status is FixStatus.TOO_FEW_NODES:
        unknowns = 4 if nodes.receiver.height_m is None else 3
        usable = sum(use in (NodeUse.USED, NodeUse.REJECTED) for use in fix.use)
        reason = (
            f"{usable} usable node{'s' * (usable != 1)} (cell {cells}), fewer than the {unknowns} unknowns of a "
            f"position in {dimensions} and the receiver's clock{hint}"
        )
    elif spread_m[0] < _SAME_PLACE_M:
        reason = f"the nodes (cells {cells}) stand in one place; nodes around the receiver are needed"
    elif undetermined and nodes.receiver.height_m is None and spread_m[1] < _LINE_SHARE * spread_m[0]:
        reason = (
            f"the nodes (cells {cells}) stand in one line, around which every position fits equally; "
            "nodes off that line are needed"
        )
    elif fix.nodes_in_line and nodes.receiver.height_m is not None:
        reason = (
            f"the nodes (cells {cells}) stand in one line, so that a position and its mirror image fit equally; "
            "a node off that line is needed"
        )
    elif fix.status is FixStatus.RANK_DEFICIENT:
        reason = f"the nodes (cells {cells}) do not determine {text.listing(fix.unobservable)}{hint}"
    elif fix.status is FixStatus.NOT_CONVERGED:
        reason = f"no position explains the arrivals of cells {cells}"
    if reason is None:
        return
    missing = f"; not found in the capture: {text.listing([str(c) for c in located.silent])}" if located.silent else ""
    unlisted = (
        f"; found but not in the nodes file: {text.listing([str(c) for c in located.unlisted])}"
        if located.unlisted
        else ""
    )
    raise LocateError(f"{located.nodes_path}: {reason}{missing}{unlisted}")


# ---- what is printed and written


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def _ellipse(located: Located) -> dict[str, float]:
    ellipse = estimation.error_ellipse(located.fix.covariance_m2[:2, :2])
    return {
        "semi_major_m": ellipse.semi_major_m,
        "semi_minor_m": ellipse.semi_minor_m,
        "azimuth_deg": math.degrees(math.pi / 2.0 - ellipse.angle_rad) % 180.0,
    }


def as_json(located: Located) -> dict[str, Any]:
    """Every number of the result: ``--json`` and metrics.json."""
    fix = located.fix
    degrees = located.degrees(fix.position_m)
    cells = []
    for index, heard in enumerate(located.heard):
        cells.append(
            {
                "cell_id": heard.node.cell_id,
                "name": heard.node.name,
                "toa_s": heard.toa_s,
                "toa_sigma_s": heard.sigma_s,
                "use": fix.use[index].name.lower(),
                "residual_m": _number(fix.residuals_m[index]),
                "gate_m": _number(fix.gates_m[index]),
            }
        )
    return {
        "capture": str(located.scan.metadata.path),
        "nodes": str(located.nodes_path),
        "status": fix.status.name.lower(),
        "message": fix.message,
        "dimensions": fix.dimensions,
        "frame": _frame_name(located),
        "position_m": [float(v) for v in fix.position_m],
        "covariance_m2": [[float(v) for v in row] for row in fix.covariance_m2],
        "sigma_m": located.sigma_m,
        "ellipse": _ellipse(located),
        "latitude_deg": degrees[0] if degrees else None,
        "longitude_deg": degrees[1] if degrees else None,
        "height_m": degrees[2] if degrees else None,
        "clock_bias_s": fix.clock_bias_s,
        "clock_sigma_s": fix.clock_sigma_s,
        "dop": {name: _number(getattr(fix.dop, name)) for name in ("gdop", "pdop", "hdop", "vdop", "tdop")},
        "chi_square": _number(fix.chi_square),
        "chi_square_limit": _number(fix.chi_square_limit),
        "degrees_of_freedom": fix.degrees_of_freedom,
        "alternatives_m": [[float(v) for v in row] for row in fix.alternatives_m],
        "cells": cells,
        "cells_not_in_nodes": located.unlisted,
        "nodes_not_found": located.silent,
    }


def _frame_name(located: Located) -> str:
    if located.nodes.nodes[0].geodetic:
        return "east, north, up about the position"
    return "east, north, up of the nodes file"


def place(located: Located, position_m: npt.ArrayLike) -> str:
    """``52.20511 N  0.12184 E`` or ``east 180.1 m  north −119.9 m``."""
    position = np.asarray(position_m, dtype=np.float64)
    sigma = located.sigma_m
    degrees = located.degrees(position)
    if degrees is not None:
        digits = 5 if sigma >= 1.0 else 6 if sigma >= 0.1 else 7
        latitude, longitude, height = degrees
        line = (
            f"{abs(latitude):.{digits}f} {'N' if latitude >= 0 else 'S'}  "
            f"{abs(longitude):.{digits}f} {'E' if longitude >= 0 else 'W'}"
        )
        return line if located.fix.dimensions == 2 else f"{line}  height {text.plain(height, 1)} m"
    digits = 1 if sigma >= 1.0 else 2
    line = f"east {text.plain(position[0], digits)} m  north {text.plain(position[1], digits)} m"
    return line if located.fix.dimensions == 2 else f"{line}  up {text.plain(position[2], digits)} m"


def summary(located: Located) -> list[str]:
    """The result in a few lines."""
    fix = located.fix
    lines = [
        f"{place(located, fix.position_m)}  ± {text.metres(located.sigma_m)} (1σ, {fix.dimensions}-D)   "
        f"clock {text.nanoseconds(fix.clock_bias_s)} ± {text.nanoseconds(fix.clock_sigma_s)}   "
        f"{int(fix.used.sum())} of {len(located.nodes.nodes)} nodes used"
    ]
    for index, heard in enumerate(located.heard):
        if fix.use[index] is NodeUse.REJECTED:
            lines.append(
                f"rejected: {heard.label} (residual {text.metres(abs(fix.residuals_m[index]))}, "
                f"gate {text.metres(fix.gates_m[index])})"
            )
        elif fix.use[index] is not NodeUse.USED:
            lines.append(f"left out: {heard.label} (time of arrival or its deviation is not usable)")
    if located.silent:
        lines.append(f"not found in the capture: cell {text.listing([str(c) for c in located.silent])}")
    if located.unlisted:
        lines.append(f"not in the nodes file: cell {text.listing([str(c) for c in located.unlisted])}")
    if fix.status is FixStatus.AMBIGUOUS:
        lines += [f"fits as well: {place(located, other)}" for other in fix.alternatives_m]
    elif fix.status is FixStatus.INCONSISTENT:
        lines.append(
            f"caution: the arrivals contradict each other (χ² {fix.chi_square:.3g}, limit {fix.chi_square_limit:.3g}) "
            "and the node at fault cannot be told"
        )
    return lines


def print_result(located: Located, console: Console) -> None:
    """What a person reads."""
    for line in summary(located):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _geojson(located: Located) -> dict[str, Any]:
    fix = located.fix

    def coordinates(position_m: npt.ArrayLike) -> list[float]:
        degrees = located.degrees(position_m)
        if degrees is None:
            return [float(v) for v in np.asarray(position_m)]
        return [degrees[1], degrees[0], degrees[2]]

    def point(position_m: npt.ArrayLike, **properties: object) -> dict[str, Any]:
        geometry_ = {"type": "Point", "coordinates": coordinates(position_m)}
        return {"type": "Feature", "geometry": geometry_, "properties": properties}

    features = [
        point(
            fix.position_m,
            kind="receiver",
            sigma_m=located.sigma_m,
            clock_bias_s=fix.clock_bias_s,
            clock_sigma_s=fix.clock_sigma_s,
        )
    ]
    for probability in (None, 0.95):
        ellipse = estimation.error_ellipse(fix.covariance_m2[:2, :2], probability=probability)
        ring = plotting.ellipse_points(ellipse) + fix.position_m[:2]
        corners = [coordinates([east, north, fix.position_m[2]]) for east, north in ring]
        corners[-1] = corners[0]
        features.append(
            {
                "type": "Feature",
                "geometry": {"type": "Polygon", "coordinates": [corners]},
                "properties": {"kind": "error ellipse", "probability": probability or 1.0 - math.exp(-0.5)},
            }
        )
    features += [point(other, kind="fits as well") for other in fix.alternatives_m]
    for heard, antenna, use in zip(located.heard, located.antennas_m, fix.use, strict=True):
        features.append(
            point(antenna, kind="node", cell_id=heard.node.cell_id, name=heard.node.name, use=use.name.lower())
        )
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if located.frame is None:
        # Not on the Earth: by prior arrangement, as RFC 7946 section 4 allows.
        collection["coordinate_frame"] = "east, north, up of the nodes file, metres"
    return collection


_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#22303c;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem} h2{font-size:1.1rem;margin-top:2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums} td,th{padding:.25rem .8rem;text-align:right}
th{border-bottom:1px solid #22303c} td:first-child,th:first-child{text-align:left}
tr:nth-child(even) td{background:#f3f6f8}
img{max-width:100%} .lead{font-size:1.1rem} .rejected td{color:#d1495b}
footer{margin-top:2rem;color:#5c677d;font-size:.85rem}
"""


def _table(columns: list[str], rows: list[tuple[str, list[str]]]) -> str:
    head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
    body = "".join(
        f'<tr class="{kind}">' + "".join(f"<td>{html.escape(c)}</td>" for c in cells) + "</tr>" for kind, cells in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _report(located: Located, picture: bytes) -> str:
    fix = located.fix
    nodes = []
    for index, heard in enumerate(located.heard):
        use = fix.use[index]
        nodes.append(
            (
                use.name.lower(),
                [
                    heard.label,
                    *(text.plain(v, 1) for v in located.antennas_m[index]),
                    text.milliseconds(heard.toa_s),
                    text.metres(heard.sigma_s * text.SPEED_OF_LIGHT_MPS),
                    text.plain(fix.residuals_m[index], 2) if math.isfinite(fix.residuals_m[index]) else "–",
                    text.plain(fix.gates_m[index], 2) if math.isfinite(fix.gates_m[index]) else "–",
                    use.name.lower().replace("_", " "),
                ],
            )
        )
    ellipse = _ellipse(located)
    facts = [
        ("", ["horizontal error ellipse (1σ)", f"{text.metres(ellipse['semi_major_m'])} × "
              f"{text.metres(ellipse['semi_minor_m'])}, long axis towards {ellipse['azimuth_deg']:.0f}°"]),
        ("", ["dilution of precision", "  ".join(
            f"{name.upper()} {getattr(fix.dop, name):.2f}"
            for name in ("gdop", "pdop", "hdop", "vdop", "tdop")
            if math.isfinite(getattr(fix.dop, name)))]),
        ("", ["receiver clock", f"{text.nanoseconds(fix.clock_bias_s)} ± {text.nanoseconds(fix.clock_sigma_s)}"]),
    ]  # fmt: skip
    if fix.degrees_of_freedom:
        facts.append(
            ("", ["agreement", f"χ² {fix.chi_square:.3g} on {fix.degrees_of_freedom} degrees of freedom, "
                  f"limit {fix.chi_square_limit:.3g}"])
        )  # fmt: skip
    columns = [
        "node", "east [m]", "north [m]", "up [m]", "time of arrival", "1σ", "residual [m]", "gate [m]", "use",
    ]  # fmt: skip
    image = base64.b64encode(picture).decode("ascii")
    lines = summary(located)
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(stem(located.scan.metadata.path))}: position</title><style>{_STYLE}</style></head><body>"
        f"<h1>{html.escape(located.scan.metadata.path.name)}</h1><p>{html.escape(scanning.header(located.scan.metadata))}</p>"
        f'<p class="lead">{html.escape(lines[0])}</p>'
        + "".join(f"<p>{html.escape(line)}</p>" for line in lines[1:])
        + f'<img alt="Map of the position among its nodes" src="data:image/png;base64,{image}">'
        + f"<h2>Nodes</h2>{_table(columns, nodes)}<h2>Quality</h2>{_table(['', ''], facts)}"
        + f"<footer>Positions of nodes: {html.escape(str(located.nodes_path))}; coordinates {_frame_name(located)}. "
        "Residuals are measured minus predicted.</footer></body></html>\n"
    )


def write_report(located: Located, folder: Path) -> Path:
    """Write report.html, map.png, fix.geojson and metrics.json; returns the first."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "map.png"
    plotting.position_map(
        located.fix,
        located.antennas_m,
        [heard.label for heard in located.heard],
        title=summary(located)[0].split("   ")[0],
        path=picture,
    )
    for name, content in (("metrics.json", as_json(located)), ("fix.geojson", _geojson(located))):
        (folder / name).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    report = folder / "report.html"
    report.write_text(_report(located, picture.read_bytes()), encoding="utf-8")
    return report
