"""Positions of emitters for maps: GeoJSON (RFC 7946) and KML 2.2."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._drawing import ellipse_points
from soopnav_cpp.scenarios.bearings import BearingsData

__all__ = ["LINE_M", "MapItem", "geojson", "write_emitter_geojson", "write_emitter_kml"]

Array = npt.NDArray[np.float64]
_KML = "http://www.opengis.net/kml/2.2"
_MOST_BEARINGS = 60
#: Length of a line on which an emitter is known to lie, when nothing says how far.
LINE_M = 5000.0


class MapItem:
    """An emitter as maps show it.

    Parameters
    ----------
    name, method : str
    data : BearingsData
        Its bearings.
    position_m : array_like, shape (2,) or (3,), or None
        None where there is no position.
    covariance_m2 : array_like, shape (d, d), or None
    cep_m : float
    line : (point, bearing), or None
        Local metres, radians from east towards north: where the emitter lies on a line.
    track_m : array_like, shape (m, d), or None
        Of an emitter that moves.
    """

    def __init__(
        self,
        name: str,
        method: str,
        data: BearingsData,
        *,
        position_m: npt.ArrayLike | None = None,
        covariance_m2: npt.ArrayLike | None = None,
        cep_m: float = math.nan,
        line: tuple[npt.ArrayLike, float] | None = None,
        track_m: npt.ArrayLike | None = None,
    ) -> None:
        self.name, self.method, self.data, self.cep_m = name, method, data, float(cep_m)
        self.position_m = None if position_m is None else _in_space(position_m)
        self.covariance_m2 = None if covariance_m2 is None else np.asarray(covariance_m2, dtype=np.float64)
        self.track_m = None if track_m is None else np.array([_in_space(p) for p in np.asarray(track_m, np.float64)])
        self.line = None
        if line is not None:
            start = _in_space(line[0])
            end = start + LINE_M * np.array([math.cos(line[1]), math.sin(line[1]), 0.0])
            self.line = np.stack([start, end])

    def ellipse(self, probability: float) -> Array | None:
        """Ring of the horizontal error ellipse, closed and counter-clockwise, shape (n, 3); None without one."""
        if self.position_m is None or self.covariance_m2 is None:
            return None
        matrix = 0.5 * (self.covariance_m2 + self.covariance_m2.T)[:2, :2]
        if not (np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0.0):
            return None
        ring = ellipse_points(estimation.error_ellipse(matrix, probability=probability))[::3]
        full = np.tile(self.position_m, (len(ring), 1))
        full[:, :2] += ring
        full[-1] = full[0]
        return full

    def rays(self) -> list[Array]:
        """Some of the bearings as lines, to a little beyond the position."""
        data = self.data
        pick = np.unique(np.linspace(0, len(data) - 1, min(_MOST_BEARINGS, len(data))).round().astype(int))
        found = []
        for k in pick:
            start = data.position_m[k]
            length = LINE_M if self.position_m is None else 1.2 * float(np.linalg.norm(self.position_m[:2] - start[:2]))
            arm = max(length, 1.0) * np.array([math.cos(data.bearing_rad[k]), math.sin(data.bearing_rad[k]), 0.0])
            found.append(np.stack([start, start + arm]))
        return found


def _in_space(position_m: npt.ArrayLike) -> Array:
    given = np.asarray(position_m, dtype=np.float64).reshape(-1)
    place = np.zeros(3)
    place[: given.size] = given
    return place


def _coordinates(data: BearingsData, points_m: Array) -> list[list[float]]:
    """Longitude, latitude, height; local metres without a place on the Earth."""
    if data.frame is None:
        return [[round(float(v), 4) for v in point] for point in points_m]
    latitude, longitude, height = data.frame.position_to_geodetic(points_m)
    return [
        [round(math.degrees(x), 9), round(math.degrees(y), 9), round(float(z), 4)]
        for x, y, z in zip(longitude, latitude, height, strict=True)
    ]


def geojson(items: Sequence[MapItem], data: BearingsData) -> dict[str, Any]:
    """A FeatureCollection: emitters, 1σ and 95 % ellipses, the platform's path, bearings, truth.

    Without a place on the Earth coordinates are local metres, and the collection says so in ``coordinate_frame`` (by
    prior arrangement, RFC 7946 section 4).
    """
    features: list[dict[str, Any]] = []

    def add(kind: str, geometry: str, coordinates: Any, **properties: object) -> None:
        features.append(
            {
                "type": "Feature",
                "geometry": {"type": geometry, "coordinates": coordinates},
                "properties": {"kind": kind, **properties},
            }
        )

    for item in items:
        who = {"name": item.name, "method": item.method}
        if item.position_m is not None:
            add("emitter", "Point", _coordinates(data, item.position_m[None])[0], **who, cep_m=_number(item.cep_m))
        for probability in (1.0 - math.exp(-0.5), 0.95):
            ring = item.ellipse(probability)
            if ring is not None:
                add("error ellipse", "Polygon", [_coordinates(data, ring)], **who, probability=probability)
        if item.line is not None:
            add("line", "LineString", _coordinates(data, item.line), **who)
        if item.track_m is not None and len(item.track_m) > 1:
            add("emitter's track", "LineString", _coordinates(data, item.track_m), **who)
        for ray in item.rays():
            add("bearing", "LineString", _coordinates(data, ray), **who)
    path = _coordinates(data, data.position_m)
    add("platform", "LineString", path if len(path) > 1 else path * 2)
    if data.truth_m is not None:
        add("truth", "Point", _coordinates(data, data.truth_m[-1:])[0])
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if data.frame is None:
        collection["coordinate_frame"] = "local east, north, up in metres: positions have no place on the Earth"
    return collection


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_emitter_geojson(items: Sequence[MapItem], data: BearingsData, path: str | Path) -> None:
    """Write `geojson`."""
    Path(path).write_text(json.dumps(geojson(items, data), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_emitter_kml(items: Sequence[MapItem], data: BearingsData, path: str | Path) -> None:
    """Write the same as KML, for globes: heights are left to the ground.

    Raises
    ------
    ValueError
        For bearings that have no place on the Earth.
    """
    if data.frame is None:
        raise ValueError("KML needs a place on the Earth: latitude_deg and longitude_deg, or an origin")
    ElementTree.register_namespace("", _KML)
    root = ElementTree.Element(f"{{{_KML}}}kml")
    document = _child(root, "Document")
    _child(document, "name", "Emitters")
    for name, colour, width in (("fix", "ff5b49d1", 3), ("bearing", "60a86c1b", 1), ("path", "ff3c3022", 3)):
        style = _child(document, "Style", id=name)
        line = _child(style, "LineStyle")
        _child(line, "color", colour)
        _child(line, "width", str(width))
        fill = _child(style, "PolyStyle")
        _child(fill, "color", f"40{colour[2:]}")
    for item in items:
        folder = _child(document, "Folder")
        _child(folder, "name", item.name)
        if item.position_m is not None:
            words = f"{item.method}" + (f", CEP {item.cep_m:.2f} m" if math.isfinite(item.cep_m) else "")
            place = _placemark(folder, item.name, "fix", words)
            _child(_child(place, "Point"), "coordinates", _kml_points(data, item.position_m[None]))
        ring = item.ellipse(0.95)
        if ring is not None:
            polygon = _child(_placemark(folder, f"{item.name}: 95 % ellipse", "fix"), "Polygon")
            boundary = _child(_child(polygon, "outerBoundaryIs"), "LinearRing")
            _child(boundary, "coordinates", _kml_points(data, ring))
        for name, points in (("line it lies on", item.line), ("track", item.track_m)):
            if points is not None and len(points) > 1:
                _line(folder, f"{item.name}: {name}", "fix", _kml_points(data, points))
        rays = _child(folder, "Folder")
        _child(rays, "name", "bearings")
        for ray in item.rays():
            _line(rays, "bearing", "bearing", _kml_points(data, ray))
    _line(document, "platform", "path", _kml_points(data, data.position_m))
    if data.truth_m is not None:
        _child(
            _child(_placemark(document, "truth", "path"), "Point"), "coordinates", _kml_points(data, data.truth_m[-1:])
        )
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _child(parent: ElementTree.Element, tag: str, text: str = "", **attributes: str) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, f"{{{_KML}}}{tag}", attributes)
    if text:
        element.text = text
    return element


def _placemark(parent: ElementTree.Element, name: str, style: str, description: str = "") -> ElementTree.Element:
    place = _child(parent, "Placemark")
    _child(place, "name", name)
    if description:
        _child(place, "description", description)
    _child(place, "styleUrl", f"#{style}")
    return place


def _line(parent: ElementTree.Element, name: str, style: str, coordinates: str) -> None:
    line = _child(_placemark(parent, name, style), "LineString")
    _child(line, "tessellate", "1")
    _child(line, "coordinates", coordinates)


def _kml_points(data: BearingsData, points_m: Array) -> str:
    """``longitude,latitude`` separated by blanks; without heights a point lies on the ground."""
    return " ".join(f"{x:.9f},{y:.9f}" for x, y, _ in _coordinates(data, points_m))
