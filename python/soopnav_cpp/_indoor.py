"""Propagation in and into rooms: image paths, diffuse tail, walls, and how far ranges are off behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp._core.simulation import LinkStatus, Material
from soopnav_cpp._source_inputs import floats

__all__ = ["IndoorLinks", "IndoorRoom", "LinkStatus", "Material", "RoomWall", "excess_delays", "slab_response"]

_Floats = npt.NDArray[np.float64]
_MATERIALS = {material.name.lower(): material for material in Material}
_SIDES = ("south", "east", "north", "west")
_STATUSES = {int(status.value): status for status in LinkStatus}


def _material(name: str, value: str | Material) -> Material:
    if isinstance(value, Material):
        return value
    if value not in _MATERIALS:
        raise ValueError(f"{name}: {value!r}; one of {', '.join(_MATERIALS)} expected")
    return _MATERIALS[value]


def _places(name: str, value: npt.ArrayLike, height_m: float) -> _Floats:
    places: _Floats = np.atleast_2d(floats(name, value))
    if places.ndim != 2 or places.shape[1] not in (2, 3):
        raise ValueError(f"{name}: shape (n, 2) or (n, 3) expected, got {places.shape}")
    if places.shape[1] == 2:
        places = np.column_stack([places, np.full(len(places), height_m)])
    return np.ascontiguousarray(places)


@dataclass(frozen=True)
class RoomWall:
    """A vertical wall on a straight line of the floor plan.

    Attributes
    ----------
    from_m, to_m : tuple of two floats
    material : str or Material
        "concrete", "brick", "plaster", "wood", "glass" or "metal" (ITU-R P.2040-2, table 3).
    thickness_m : float
    """

    from_m: tuple[float, float]
    to_m: tuple[float, float]
    material: str | Material = "concrete"
    thickness_m: float = 0.2

    def _tuple(self) -> tuple[float, float, float, float, Material, float]:
        material = _material("material", self.material)
        try:
            (ax, ay), (bx, by) = self.from_m, self.to_m
            return float(ax), float(ay), float(bx), float(by), material, float(self.thickness_m)
        except (TypeError, ValueError):
            raise ValueError(f"wall: two places of two numbers expected, got {self.from_m}, {self.to_m}") from None

    def with_opening(
        self, start_m: float, stop_m: float, material: str | Material = "glass", thickness_m: float = 0.006
    ) -> list[RoomWall]:
        """The wall with a piece of another material (a window) from `start_m` to `stop_m` along it: 1 to 3 walls."""
        pieces = _simulation.with_opening(self._tuple(), start_m, stop_m, _material("material", material), thickness_m)
        return [RoomWall((ax, ay), (bx, by), made, thick) for ax, ay, bx, by, made, thick in pieces]


@dataclass(frozen=True)
class IndoorLinks:
    """What n places hear of L nodes.

    Attributes
    ----------
    status_code : ndarray of int64, shape (n, L)
        Values of `LinkStatus`.
    line_of_sight : ndarray of bool, shape (n, L)
        Walls take at most ``los_loss_db`` from the direct path.
    distance_m : ndarray, shape (n, L)
        Straight.
    wall_loss_db : ndarray, shape (n, L)
        Of the direct path, through walls; infinite through metal.
    power_db : ndarray, shape (n, L)
        Sum of |gain|² over the taps; -inf without taps.
    excess_delay_s : ndarray, shape (n, L)
        Of the first detectable path over the straight line in free space, 0 or more.
    paths : ndarray of int64, shape (n, L)
        How many taps are direct or reflected paths; the rest are the diffuse tail.
    start : ndarray of int64, shape (n L + 1,)
        Taps of link (i, j) are ``start[i L + j] : start[i L + j + 1]`` of the next two.
    delay_s : ndarray, shape (t,)
        Geometric, plus what walls add; rising within a link.
    gain : ndarray, shape (t,), complex128
        Amplitude at the carrier, its phase -2π f delay included.
    """

    status_code: npt.NDArray[np.int64]
    line_of_sight: npt.NDArray[np.bool_]
    distance_m: _Floats
    wall_loss_db: _Floats
    power_db: _Floats
    excess_delay_s: _Floats
    paths: npt.NDArray[np.int64]
    start: npt.NDArray[np.int64]
    delay_s: _Floats
    gain: npt.NDArray[np.complex128]

    def status(self, place: int = 0, node: int = 0) -> LinkStatus:
        """How one link came out."""
        return _STATUSES[int(self.status_code[place, node])]

    def _slice(self, place: int, node: int) -> slice:
        n, links = self.status_code.shape
        if not (-n <= place < n and -links <= node < links):
            raise IndexError(f"link ({place}, {node}) of {n} places and {links} nodes")
        at = (place % n) * links + node % links
        return slice(int(self.start[at]), int(self.start[at + 1]))

    def taps(
        self, place: int = 0, node: int = 0, *, delay_offset_s: float = 0.0, normalise: bool = False
    ) -> list[tuple[float, complex]]:
        """(delay_s, gain) pairs, as `apply_taps`, `lte.CellParameters` and `ChannelSounder` take them.

        Parameters
        ----------
        place, node : int
        delay_offset_s : float
            Added to each delay.
        normalise : bool
            Gains scaled to unit power in all: the path loss then is the business of a cell's ``power_db``.
        """
        part = self._slice(place, node)
        gain = self.gain[part]
        if normalise and len(gain):
            gain = gain / np.linalg.norm(gain)
        return [(float(d) + delay_offset_s, complex(g)) for d, g in zip(self.delay_s[part], gain, strict=True)]

    def response(self, frequencies_hz: npt.ArrayLike, place: int = 0, node: int = 0) -> npt.NDArray[np.complex128]:
        """Channel at frequencies relative to the carrier, shape (f,), complex128: sum of gain·exp(-j 2π f delay)."""
        part = self._slice(place, node)
        f = np.asarray(frequencies_hz, dtype=np.float64).reshape(-1)
        return np.asarray(np.exp(-2j * np.pi * np.outer(f, self.delay_s[part])) @ self.gain[part])

    def __repr__(self) -> str:
        n, links = self.status_code.shape
        share = float(self.line_of_sight.mean()) if self.line_of_sight.size else 0.0
        return f"IndoorLinks({n} places x {links} nodes, {100 * share:.0f} % in sight, {len(self.delay_s)} taps)"


class IndoorRoom:
    """Propagation in and into a room by the image method, with a diffuse tail.

    Model: h = Σ λ/(4π s) ΠR ΠT exp(-j 2π f s/c) over paths with up to `order` reflections, walls being slabs of their
    material (ITU-R P.2040-2), E vertical; no diffraction. The tail decays exponentially after the first path; each of
    its taps is a complex normal field over the places with correlation J0(2π d/λ): it is the same again at the same
    place, nearly the same within λ/10, and independent from 0.38 λ on. It depends on `seed` and the node's position.

    Parameters
    ----------
    walls : sequence of RoomWall
        At most 64; outer and inner ones alike. `rectangle` and `polygon` make the outer ones.
    carrier_hz : float
        Of the taps' phases and the walls' losses.
    order : int, 0 to 3
    height_m : float
        Of walls and ceiling; what lies above passes over.
    floor_and_ceiling : bool
        They reflect once per path, inside the walls' bounding box. Paths may then bounce `order` times off walls too.
    floor_material, floor_thickness_m
    path_range_db : float
        Weaker paths than the strongest by more are left out.
    detect_range_db : float
        The first detectable path is at most so much weaker than the strongest.
    los_loss_db : float
        In sight: walls take no more from the direct path. One window pane is below 3 dB, a brick wall above.
    tail_db : float
        Mean power of the tail over that of the paths; -inf for none.
    tail_decay_s, tail_spacing_s : float
        Of the tail's power profile: time to fall by e, mean time between taps.
    tail_taps : int, 0 to 64
    seed : int
        Of the tail.
    antenna_height_m : float
        z of nodes and places that are given by two coordinates.

    Raises
    ------
    ValueError
        For what is out of range, naming it. Bad places are no error: see `IndoorLinks.status_code`.
    """

    def __init__(
        self,
        walls: Sequence[RoomWall],
        *,
        carrier_hz: float = 2.0e9,
        order: int = 2,
        height_m: float = 3.0,
        floor_and_ceiling: bool = True,
        floor_material: str | Material = "concrete",
        floor_thickness_m: float = 0.3,
        path_range_db: float = 40.0,
        detect_range_db: float = 20.0,
        los_loss_db: float = 3.0,
        tail_db: float = -10.0,
        tail_decay_s: float = 30e-9,
        tail_spacing_s: float = 10e-9,
        tail_taps: int = 16,
        seed: int = 0,
        antenna_height_m: float = 1.2,
    ) -> None:
        self.walls = tuple(walls)
        if not np.isfinite(antenna_height_m):
            raise ValueError(f"antenna_height_m: {antenna_height_m}; it must be finite")
        if seed < 0:
            raise ValueError(f"seed: {seed}; it must not be negative")
        self.carrier_hz = float(carrier_hz)
        self.antenna_height_m = float(antenna_height_m)
        self._core = _simulation.IndoorRoom(
            [wall._tuple() for wall in self.walls],
            carrier_hz=carrier_hz,
            order=order,
            height_m=height_m,
            floor_and_ceiling=floor_and_ceiling,
            floor_material=_material("floor_material", floor_material),
            floor_thickness_m=floor_thickness_m,
            path_range_db=path_range_db,
            detect_range_db=detect_range_db,
            los_loss_db=los_loss_db,
            tail_db=tail_db,
            tail_decay_s=tail_decay_s,
            tail_spacing_s=tail_spacing_s,
            tail_taps=tail_taps,
            seed=seed,
        )

    @classmethod
    def rectangle(
        cls,
        width_m: float,
        depth_m: float,
        *,
        material: str | Material = "brick",
        thickness_m: float = 0.25,
        windows: Sequence[tuple[str, float, float]] = (),
        inner: Sequence[RoomWall] = (),
        **options: Any,
    ) -> IndoorRoom:
        """A rectangle with a corner at (0, 0).

        Parameters
        ----------
        width_m, depth_m : float
            Along x and y.
        material, thickness_m
            Of the outer walls.
        windows : sequence of (side, from, to)
            Panes of glass: side "south" (y = 0), "east", "north" or "west" and the span of x or y along it, in metres.
        inner : sequence of RoomWall
        **options
            As the constructor's.
        """
        if not (width_m > 0.0 and depth_m > 0.0 and np.isfinite([width_m, depth_m]).all()):
            raise ValueError(f"width_m, depth_m: {width_m}, {depth_m}; they must be positive")
        corners = [(0.0, 0.0), (width_m, 0.0), (width_m, depth_m), (0.0, depth_m)]
        sides: dict[str, list[RoomWall]] = {
            side: [RoomWall(corners[i], corners[(i + 1) % 4], material, thickness_m)] for i, side in enumerate(_SIDES)
        }
        for side, low, high in sorted(windows, key=lambda window: (window[0], window[1])):
            if side not in sides:
                raise ValueError(f"windows: side {side!r}; one of {', '.join(_SIDES)} expected")
            total = width_m if side in ("south", "north") else depth_m
            if not 0.0 <= low < high <= total:
                raise ValueError(f"windows: {side} from {low} to {high}; 0 <= from < to <= {total} expected")
            start, stop = (low, high) if side in ("south", "east") else (total - high, total - low)
            sides[side] = _cut(sides[side], start, stop)
        return cls([*(wall for walls in sides.values() for wall in walls), *inner], **options)

    @classmethod
    def polygon(
        cls,
        corners_m: npt.ArrayLike,
        *,
        material: str | Material = "brick",
        thickness_m: float = 0.25,
        inner: Sequence[RoomWall] = (),
        **options: Any,
    ) -> IndoorRoom:
        """Outer walls from corner to corner of shape (n, 2), closed by one from the last to the first."""
        corners = np.asarray(corners_m, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise ValueError(f"corners_m: shape (n, 2) with n >= 3 expected, got {corners.shape}")
        ends = [(float(x), float(y)) for x, y in corners]
        outer = [RoomWall(a, ends[(i + 1) % len(ends)], material, thickness_m) for i, a in enumerate(ends)]
        return cls([*outer, *inner], **options)

    def links(self, nodes_m: npt.ArrayLike, places_m: npt.ArrayLike) -> IndoorLinks:
        """Channels from each node to each place.

        Parameters
        ----------
        nodes_m : array_like, shape (L, 2) or (L, 3)
            Inside or outside, finite.
        places_m : array_like, shape (n, 2) or (n, 3)

        Returns
        -------
        IndoorLinks
            A place that is not finite, within 0.1 m of the node, or shielded has a status and no taps.

        Raises
        ------
        ValueError
            For shapes that do not fit and nodes that are not finite.
        """
        nodes = _places("nodes_m", nodes_m, self.antenna_height_m)
        bad = np.flatnonzero(~np.isfinite(nodes).all(axis=1))
        if bad.size:
            raise ValueError(f"nodes_m: node {bad[0]} is not finite ({nodes[bad[0]]})")
        status, sight, *rest = self._core.links(nodes, _places("places_m", places_m, self.antenna_height_m))
        return IndoorLinks(status, sight.astype(bool), *rest)

    def link(self, node_m: npt.ArrayLike, place_m: npt.ArrayLike) -> IndoorLinks:
        """Channel from one node to one place; its taps are ``link(...).taps()``."""
        return self.links(node_m, place_m)

    def wall_loss_db(self, nodes_m: npt.ArrayLike, places_m: npt.ArrayLike) -> _Floats:
        """What walls take from the straight paths [dB], shape (n, L): a map of sight and shadow; NaN if not finite."""
        return self._core.wall_loss_db(
            _places("nodes_m", nodes_m, self.antenna_height_m), _places("places_m", places_m, self.antenna_height_m)
        )

    def __repr__(self) -> str:
        return f"IndoorRoom({len(self.walls)} walls, {self.carrier_hz / 1e9:.3g} GHz)"


def _cut(walls: list[RoomWall], start_m: float, stop_m: float) -> list[RoomWall]:
    """`walls`, which follow each other, with a pane from `start_m` to `stop_m` along them."""
    out: list[RoomWall] = []
    at = 0.0
    for wall in walls:
        length = float(np.hypot(wall.to_m[0] - wall.from_m[0], wall.to_m[1] - wall.from_m[1]))
        low, high = max(start_m, at), min(stop_m, at + length)
        if high - low > 1e-9:
            out.extend(wall.with_opening(low - at, min(high - at, length)))
        else:
            out.append(replace(wall))
        at += length
    return out


def excess_delays(
    line_of_sight: npt.ArrayLike,
    dt_s: float,
    *,
    bias_m: tuple[float, float] = (4.0, 20.0),
    wander_m_per_sqrt_s: float = 0.158,
    floor_m: float = 0.0,
    seed: int,
) -> _Floats:
    """How much too long the ranges of links are: nothing in sight, else a bias and its wander.

    Parameters
    ----------
    line_of_sight : array_like of bool, shape (n, L)
    dt_s : float
        Between rows.
    bias_m : (low, high)
        Uniform at the moment the sight shuts.
    wander_m_per_sqrt_s : float
        Then a random walk; the default is 0.05 m per 0.1 s sample.
    floor_m : float
        The walk is reflected here.
    seed : int
        A link's draws depend neither on other links nor on earlier flags.

    Returns
    -------
    ndarray, shape (n, L)
        In metres.
    """
    flags = np.asarray(line_of_sight)
    if flags.ndim != 2 or not (flags.dtype == np.bool_ or np.isin(flags, (0, 1)).all()):
        raise ValueError(f"line_of_sight: booleans of shape (n, L) expected, got {flags.dtype} {flags.shape}")
    low, high = bias_m
    return _simulation.excess_delays(
        flags.astype(np.uint8),
        dt_s,
        low_m=low,
        high_m=high,
        wander_m_per_sqrt_s=wander_m_per_sqrt_s,
        floor_m=floor_m,
        seed=seed,
    )


def slab_response(
    material: str | Material,
    thickness_m: float,
    cos_incidence: float = 1.0,
    *,
    frequency_hz: float = 2.0e9,
    parallel: bool = False,
) -> tuple[complex, complex, float]:
    """Reflection, transmission and extra delay [s] of a slab in air (ITU-R P.2040-2, single layer).

    Parameters
    ----------
    material : str or Material
    thickness_m : float
    cos_incidence : float
        Of the angle from the normal, in (0, 1].
    frequency_hz : float
    parallel : bool
        E in the plane of incidence; otherwise across it, as of a vertical antenna at a wall.
    """
    return _simulation.slab_response(
        _material("material", material), thickness_m, cos_incidence, frequency_hz, parallel
    )
