"""``soopnav observe``: what measurements along a track can tell, before anything is built.

The analysis of nielsen 3.4 for any geometry.

The scenario names the nodes, the track, what is measured, and what is not known. Out come the rank, the standard
deviation of every unknown, the directions that cannot be seen, and a map of the deviation over the starts of the track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field
from rich.console import Console

from soopnav_cpp import estimation, plotting
from soopnav_cpp._extras import require
from soopnav_cpp.cli import text
from soopnav_cpp.config import ConfigError, Model, load_toml

__all__ = ["ObserveScenario", "Observed", "as_json", "draw", "observe", "print_result"]

Array = npt.NDArray[np.float64]
_MOST_POINTS = 250_000
_DEFAULT_POINTS = 61


def _coordinates(value: object) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) not in (2, 3):
        raise ValueError("a list of two or three numbers expected")
    if any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in value):
        raise ValueError("a list of two or three numbers expected")
    return tuple(float(item) for item in value)


def _pair(value: object) -> tuple[int, int]:
    if not isinstance(value, list) or len(value) != 2 or any(type(item) is not int for item in value):
        raise ValueError("a list of two whole numbers expected")
    return (value[0], value[1])


#: Two or three finite numbers; all points of a scenario have as many.
Point = Annotated[tuple[float, ...], pydantic.BeforeValidator(_coordinates)]
Positive = Annotated[float, Field(gt=0.0)]
Axis = Literal["x", "y", "z"]
Extent = Literal["known", "common", "separate"]


class ObserveNode(Model):
    """A node whose position is known."""

    name: str | None = None
    position_m: Point


class Measurement(Model):
    """What every node gives at every position.

    Attributes
    ----------
    kind : str
        A range; a pseudorange, which has a bias; the difference of ranges to that of the first node, independent errors
        of `sigma_m` in each range; or a bearing in the plane of x and y.
    sigma_m : float
        Of a range.
    sigma_deg : float
        Of a bearing.
    """

    kind: Literal["range", "pseudorange", "range_difference", "bearing"]
    sigma_m: Positive | None = None
    sigma_deg: Positive | None = None

    @pydantic.model_validator(mode="after")
    def _one_sigma(self) -> Measurement:
        wanted, other = ("sigma_deg", "sigma_m") if self.kind == "bearing" else ("sigma_m", "sigma_deg")
        if getattr(self, wanted) is None or getattr(self, other) is not None:
            raise ValueError(f"a {self.kind.replace('_', ' ')} has {wanted}, and not {other}")
        return self


class Track(Model):
    """Where the measurements are taken: `count` positions, the first one step behind the start, or a list of them.

    Attributes
    ----------
    start_m : point
    step_m : float
        Length of a step; zero: all in one place.
    direction_deg : float
        From x towards y.
    climb_deg : float
        From the plane of x and y towards z.
    count : int
    positions_m : list of points
        Instead of the five above.
    interval_s : float
        Between two positions.
    """

    start_m: Point | None = None
    step_m: Annotated[float, Field(ge=0.0)] | None = None
    direction_deg: float = 0.0
    climb_deg: float = 0.0
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None
    positions_m: Annotated[list[Point], Field(min_length=1, max_length=10_000)] | None = None
    interval_s: Positive = 1.0

    @pydantic.model_validator(mode="after")
    def _one_form(self) -> Track:
        regular = (self.start_m, self.step_m, self.count)
        if self.positions_m is None and any(value is None for value in regular):
            raise ValueError("start_m, step_m and count needed, or positions_m")
        if self.positions_m is not None and any(value is not None for value in regular):
            raise ValueError("either positions_m, or start_m, step_m and count")
        return self


class Unknown(Model):
    """What is not known.

    Attributes
    ----------
    offset : list of axes
        One displacement of the whole track.
    step : list of axes
        One error of the length of every step; it grows with the steps taken.
    heading : bool
        A turn of the track about its start.
    bias, drift : str
        Of the measurements: known, common to all nodes, or separate for each.
    """

    offset: list[Axis] = Field(default_factory=list)
    step: list[Axis] = Field(default_factory=list)
    heading: bool = False
    bias: Extent = "known"
    drift: Extent = "known"

    @pydantic.model_validator(mode="after")
    def _something(self) -> Unknown:
        if not (self.offset or self.step or self.heading or self.bias != "known" or self.drift != "known"):
            raise ValueError("nothing is unknown; offset, step, heading, bias or drift expected")
        for name in ("offset", "step"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name}: each axis once")
        return self


class Map(Model):
    """Starts of the track over which the standard deviation is drawn.

    Attributes
    ----------
    low_m, high_m : two floats
        Corners in x and y; without them what the nodes and the track span.
    points : two integers
        Along x and y.
    state : list of str
        Whose variances are summed, by the names that the table prints; without it the offsets, or the first unknown.
    """

    low_m: Point | None = None
    high_m: Point | None = None
    points: Annotated[tuple[int, int], pydantic.BeforeValidator(_pair)] = (_DEFAULT_POINTS, _DEFAULT_POINTS)
    state: Annotated[list[str], Field(min_length=1)] | None = None

    @pydantic.model_validator(mode="after")
    def _an_area(self) -> Map:
        if (self.low_m is None) != (self.high_m is None):
            raise ValueError("low_m and high_m together")
        if self.low_m is not None and self.high_m is not None:
            if len(self.low_m) != 2 or len(self.high_m) != 2:
                raise ValueError("low_m and high_m are two numbers each, x and y")
            if not all(low < high for low, high in zip(self.low_m, self.high_m, strict=True)):
                raise ValueError("low_m below high_m in both axes expected")
        if min(self.points) < 2 or self.points[0] * self.points[1] > _MOST_POINTS:
            raise ValueError(f"points: at least 2 along each axis and at most {_MOST_POINTS} in all expected")
        return self


class ObserveScenario(Model):
    """The file of ``soopnav observe``."""

    measurement: Measurement
    nodes: Annotated[list[ObserveNode], Field(min_length=1, max_length=1000)]
    track: Track
    unknown: Unknown
    map: Map = Map()

    @pydantic.model_validator(mode="after")
    def _fits(self) -> ObserveScenario:
        axes = len(self.nodes[0].position_m)
        points = [node.position_m for node in self.nodes] + list(self.track.positions_m or [])
        points += [self.track.start_m] if self.track.start_m is not None else []
        if any(len(point) != axes for point in points):
            raise ValueError("nodes and track: all points have two coordinates, or all have three")
        if axes == 2 and ("z" in (*self.unknown.offset, *self.unknown.step) or self.track.climb_deg != 0.0):
            raise ValueError("z and climb_deg need points of three coordinates")
        names = self.node_names
        if len(set(names)) != len(names):
            raise ValueError("nodes: each name once")
        kind, unknown = self.measurement.kind, self.unknown
        biased = unknown.bias != "known" or unknown.drift != "known"
        if kind == "range" and biased:
            raise ValueError("unknown: a range has no bias and no drift; a pseudorange has")
        if kind == "range_difference":
            if len(names) < 2:
                raise ValueError("nodes: a range difference needs two")
            if biased:
                raise ValueError("unknown: a range difference has no common bias, and separate ones belong to ranges")
        return self

    @property
    def node_names(self) -> tuple[str, ...]:
        """The names given, or numbers from 1."""
        return tuple(node.name or str(index + 1) for index, node in enumerate(self.nodes))


@dataclass(frozen=True, eq=False)
class Observed:
    """What a scenario can tell.

    Attributes
    ----------
    bound : Crlb
        On the track of the scenario; angles in radians.
    x_m, y_m : ndarray, shape (columns,) and (rows,)
        Starts of the map.
    sigma : ndarray, shape (rows, columns)
        Of `state` there: infinite where it cannot be told from other unknowns, NaN on top of a node. Angles in degrees.
    state : tuple of str
        Whose variances `sigma` sums.
    """

    path: Path
    scenario: ObserveScenario
    positions_m: Array
    bound: estimation.Crlb
    x_m: Array
    y_m: Array
    sigma: Array
    state: tuple[str, ...]


def _track(track: Track) -> tuple[Array, Array, Array]:
    """Positions (N, axes), the start, and the steps taken before each position."""
    if track.positions_m is not None:
        positions = np.array(track.positions_m)
        return positions, positions[0], np.arange(len(positions), dtype=np.float64)
    if track.start_m is None or track.step_m is None or track.count is None:
        raise ValueError("track: start_m, step_m and count needed, or positions_m")
    start = np.array(track.start_m)
    along, climb = math.radians(track.direction_deg), math.radians(track.climb_deg)
    towards = np.array(
        [math.cos(along) * math.cos(climb), math.sin(along) * math.cos(climb), math.sin(climb)][: len(start)]
    )
    taken = np.arange(1.0, track.count + 1.0)
    return start + taken[:, None] * track.step_m * towards, start, taken


def _rows(
    scenario: ObserveScenario, positions: Array, start: Array, taken: Array
) -> tuple[Array, tuple[str, ...], Array]:
    """Jacobian (..., rows, n) of one track or many, names of the unknowns, and R of one position."""
    nodes = np.array([node.position_m for node in scenario.nodes])
    unknown, measurement = scenario.unknown, scenario.measurement
    H, names = estimation.track_jacobian(
        "azimuth" if measurement.kind == "bearing" else "range",
        nodes,
        positions,
        offset=unknown.offset,
        step=unknown.step,
        heading=unknown.heading,
        bias=unknown.bias,
        drift=unknown.drift,
        steps_taken=taken,
        times_s=scenario.track.interval_s * np.arange(len(taken)),
        start_m=start,
        node_names=scenario.node_names,
    )
    sigma = math.radians(measurement.sigma_deg or 0.0) if measurement.kind == "bearing" else measurement.sigma_m or 0.0
    if measurement.kind != "range_difference":
        return H, names, np.array([[sigma**2]])
    by_node = H.reshape(*H.shape[:-2], len(taken), len(nodes), len(names))
    differences = by_node[..., 1:, :] - by_node[..., :1, :]
    block = sigma**2 * (np.eye(len(nodes) - 1) + 1.0)  # the first node's error is in every difference
    return differences.reshape(*H.shape[:-2], -1, len(names)), names, block


def _is_angle(scenario: ObserveScenario, name: str) -> bool:
    return name == "heading" or (scenario.measurement.kind == "bearing" and name.split()[0] in ("bias", "drift"))


def _unit(scenario: ObserveScenario, name: str) -> str:
    return ("deg" if _is_angle(scenario, name) else "m") + ("/s" if name.split()[0] == "drift" else "")


def _scale(scenario: ObserveScenario, name: str) -> float:
    """From the engine's radians to the command line's degrees."""
    return 180.0 / math.pi if _is_angle(scenario, name) else 1.0


def observe(path: Path) -> Observed:
    """Read the scenario and work it out.

    Raises
    ------
    ConfigError
        For a file that does not fit; a sentence for each mistake.
    ValueError
        For a track that leads over a node.
    """
    scenario = load_toml(path, ObserveScenario)
    positions, start, taken = _track(scenario.track)
    H, names, R = _rows(scenario, positions, start, taken)
    if not np.isfinite(H).all():
        raise ValueError(f"{path}: the track leads over a node, where the measurement has no direction")
    bound = estimation.crlb(H, R, names=names)

    area = scenario.map
    offsets = tuple(name for name in names if name.startswith("offset"))
    state = tuple(area.state) if area.state is not None else offsets or names[:1]
    for name in state:
        if name not in names:
            raise ConfigError(f"{path}: map.state: no unknown {name!r}; there are {', '.join(names)}")
    if len({_unit(scenario, name) for name in state}) > 1:
        raise ConfigError(f"{path}: map.state: {text.listing(list(state))} have different units")
    spread = np.vstack([positions, start[None], [node.position_m for node in scenario.nodes]])[:, :2]
    low, high = spread.min(axis=0), spread.max(axis=0)
    if area.low_m is not None and area.high_m is not None:
        low, high = np.array(area.low_m), np.array(area.high_m)
    else:
        margin = 0.1 * max(float((high - low).max()), 1.0)
        low, high = low - margin, high + margin
    x, y = (np.linspace(low[i], high[i], area.points[i]) for i in range(2))
    sigma = np.empty((len(y), len(x)))
    columns = [names.index(name) for name in state]
    for row, y_m in enumerate(y):  # a line at a time bounds the memory
        starts = np.tile(start, (len(x), 1))
        starts[:, 0], starts[:, 1] = x, y_m
        lines, _, _ = _rows(scenario, positions + (starts - start)[:, None, :], starts, taken)
        deviations, _ = estimation.crlb_map(lines, R)
        sigma[row] = _scale(scenario, state[0]) * np.sqrt(np.square(deviations[:, columns]).sum(axis=1))
    return Observed(path, scenario, positions, bound, x, y, sigma, state)


def _number(value: float) -> float | None:
    """JSON has no NaN and no infinity."""
    return float(value) if math.isfinite(value) else None


def as_json(result: Observed) -> dict[str, Any]:
    """Every number of the result; null for what cannot be told."""
    bound, scenario = result.bound, result.scenario
    finite = result.sigma[np.isfinite(result.sigma)]
    return {
        "scenario": str(result.path),
        "rank": bound.rank,
        "unknowns": len(bound.names),
        "sigma": {
            name: _number(float(sigma) * _scale(scenario, name))
            for name, sigma in zip(bound.names, bound.sigma, strict=True)
        },
        "units": {name: _unit(scenario, name) for name in bound.names},
        "unobservable": list(bound.unobservable),
        "singular_values": [_number(float(value)) for value in bound.singular_values],
        "map": {
            "state": list(result.state),
            "x_m": [float(value) for value in result.x_m],
            "y_m": [float(value) for value in result.y_m],
            "sigma_min": _number(float(finite.min())) if finite.size else None,
            "sigma_max": _number(float(finite.max())) if finite.size else None,
            "blank": int(result.sigma.size - finite.size),
        },
    }


def _header(result: Observed) -> str:
    scenario, count = result.scenario, len(result.positions_m)
    measurement, nodes = scenario.measurement, len(scenario.nodes)
    deviation = f"{measurement.sigma_deg:g}°" if measurement.kind == "bearing" else f"{measurement.sigma_m:g} m"
    per_position = nodes - 1 if measurement.kind == "range_difference" else nodes
    kind = measurement.kind.replace("_", " ")
    return (
        f"{nodes} node{'s' * (nodes != 1)}, {count} position{'s' * (count != 1)}, {count * per_position} "
        f"{kind}{'s' * (count * per_position != 1)} of σ {deviation}"
    )


def print_result(result: Observed, console: Console) -> None:
    """What a person reads."""
    bound, scenario = result.bound, result.scenario
    lines = [f"{result.path.name}  {_header(result)}", f"rank {bound.rank} of {len(bound.names)}"]
    width = max(len(name) for name in bound.names)
    for name, sigma in zip(bound.names, bound.sigma, strict=True):
        value = f"σ {sigma * _scale(scenario, name):.4g} {_unit(scenario, name)}"
        lines.append(f"  {name:<{width}}  {value if math.isfinite(sigma) else 'cannot be told'}")
    if bound.unobservable:
        lines.append("cannot be seen: " + "; ".join(bound.unobservable))
    finite = result.sigma[np.isfinite(result.sigma)]
    what = " and ".join(result.state)
    unit = _unit(scenario, result.state[0])
    if finite.size:
        blank = result.sigma.size - finite.size
        lines.append(
            f"map of {what}: σ {finite.min():.4g} … {finite.max():.4g} {unit} over {result.sigma.size} starts"
            + (f", {blank} of them blank" if blank else "")
        )
    else:
        lines.append(f"map of {what}: cannot be told from any start")
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def draw(result: Observed, path: Path) -> None:
    """Write the map: σ by colour, nodes, and the track as the scenario has it. Grey: cannot be told."""
    colours = require("matplotlib.colors", "plot", "drawing")
    figure = plotting._figure(7.6, 6.4)
    axes = figure.add_subplot()
    what, unit = " and ".join(result.state), _unit(result.scenario, result.state[0])
    plotting._style(axes, f"σ of {what} by the start of the track", "x [m]", "y [m]")
    axes.grid(False)
    x, y = result.x_m, result.y_m
    axes.fill([x[0], x[-1], x[-1], x[0]], [y[0], y[0], y[-1], y[-1]], color="#d5dade", linewidth=0, zorder=0)
    axes.set_aspect("equal", adjustable="box")
    shown = np.ma.masked_invalid(result.sigma)
    if shown.count():
        low, high = float(shown.min()), float(shown.max())
        # Ten times between the ends are more than a linear scale shows.
        norm = colours.LogNorm(low, high) if high > 10.0 * low else colours.Normalize(low, max(high, low * (1 + 1e-9)))
        mesh = axes.pcolormesh(result.x_m, result.y_m, shown, shading="nearest", norm=norm, cmap="viridis_r")
        bar = figure.colorbar(mesh, ax=axes, shrink=0.85)
        bar.set_label(f"σ [{unit}]", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    for node, name in zip(result.scenario.nodes, result.scenario.node_names, strict=True):
        place = (node.position_m[0], node.position_m[1])
        axes.plot(*place, "^", color="white", markeredgecolor="#22303c", markersize=11, zorder=4)
        axes.annotate(
            name,
            place,
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            fontsize=9,
            zorder=4,
            annotation_clip=True,
        )
    track = result.positions_m
    axes.plot(track[:, 0], track[:, 1], ".-", color="#d1495b", linewidth=1.2, markersize=4, zorder=3)
    axes.annotate(
        "track", (track[-1, 0], track[-1, 1]), xytext=(0, 6), textcoords="offset points", fontsize=8.5, color="#d1495b"
    )
    # The map, the track, and the nodes that are not far from both.
    points = np.vstack([track[:, :2], np.column_stack([result.x_m[[0, -1]], result.y_m[[0, -1]]])])
    low_m, high_m = points.min(axis=0), points.max(axis=0)
    reach = float((high_m - low_m).max())
    places = np.array([node.position_m[:2] for node in result.scenario.nodes])
    near = places[((places >= low_m - reach) & (places <= high_m + reach)).all(axis=1)]
    low_m, high_m = np.vstack([low_m, near]).min(axis=0), np.vstack([high_m, near]).max(axis=0)
    pad = 0.06 * float((high_m - low_m).max())
    axes.set_xlim(low_m[0] - pad, high_m[0] + pad)
    axes.set_ylim(low_m[1] - pad, high_m[1] + pad)
    if not shown.count():
        axes.text(0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1]), "cannot be told", ha="center", va="bottom", fontsize=10)
    rank = f"rank {result.bound.rank} of {len(result.bound.names)} on the track drawn"
    figure.supxlabel(f"{_header(result)}; {rank}", fontsize=8.5)
    plotting._save(figure, path)
