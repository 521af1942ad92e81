"""Nodes at unknown places, each with a time of its own, found from a walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import ClockMotion, NodeMapStatus
from soopnav_cpp._source_inputs import floats

__all__ = ["NodeMap", "NodeMapStatus", "NodeStart", "locate_nodes", "start_node"]

_Floats = npt.NDArray[np.float64]
_CLOCKS = {motion.name.lower(): motion for motion in ClockMotion}


@dataclass(frozen=True)
class NodeMap:
    """Nodes found from a walk, in the walk's own frame: its first place and first heading are the measured track's.

    Attributes
    ----------
    status : NodeMapStatus
        OK, TOO_FEW, UNDETERMINED, NOT_CONVERGED or POOR_FIT (residuals beyond the noise at a probability of 1e-6:
        ranges out of sight, or a wrong sigma or drift).
    position_m : ndarray, shape (L, 2)
        NaN for a node heard at fewer than 4 epochs.
    covariance_m2 : ndarray, shape (2 L, 2 L)
        Of all positions together.
    offset_m, offset_sigma_m : ndarray, shape (L,)
        Each node's time as length, against the first that was heard.
    mirrored : ndarray of bool, shape (L,)
        The node may as well be at `mirror_m`.
    mirror_m : ndarray, shape (L, 2)
        NaN unless mirrored.
    clock_m : ndarray, shape (n,)
        The receiver's at each epoch, against the first node's.
    track_m : ndarray, shape (n, 2)
        Corrected for its drift.
    heading_rad : ndarray, shape (n,)
        By which the track's axes have turned since its start.
    cost : float
        Sum of squared residuals over their sigmas; chi-square with `degrees_of_freedom`.
    degrees_of_freedom, observations, undetermined, iterations, starts : int
        `undetermined` directions of the unknowns that the ranges say nothing of.
    ambiguities : tuple of str
        What the walk cannot tell, in words; the common time is always among them.
    """

    status: NodeMapStatus
    position_m: _Floats
    covariance_m2: _Floats
    offset_m: _Floats
    offset_sigma_m: _Floats
    mirrored: npt.NDArray[np.bool_]
    mirror_m: _Floats
    clock_m: _Floats
    track_m: _Floats
    heading_rad: _Floats
    cost: float
    degrees_of_freedom: int
    observations: int
    undetermined: int
    iterations: int
    starts: int
    ambiguities: tuple[str, ...]

    def sigma_m(self) -> _Floats:
        """1-sigma of each node's position, root of the trace, shape (L,)."""
        diagonal = np.diagonal(self.covariance_m2).reshape(-1, 2)
        return np.asarray(np.sqrt(diagonal.sum(axis=1)))

    def nees(self, truth_m: npt.ArrayLike) -> float:
        """Squared error of all heard nodes in the stated covariance; chi-square with two degrees for each."""
        error = (self.position_m - np.asarray(truth_m, dtype=np.float64)).ravel()
        heard = np.isfinite(error)
        covariance = self.covariance_m2[np.ix_(heard, heard)]
        return float(error[heard] @ np.linalg.solve(covariance, error[heard])) if heard.any() else float("nan")

    def __repr__(self) -> str:
        heard = int(np.isfinite(self.position_m).all(axis=1).sum())
        sigma = self.sigma_m()
        spread = f", sigma {np.nanmedian(sigma):.2g} m" if np.isfinite(sigma).any() else ""
        return f"NodeMap({self.status.name}: {heard} of {len(self.position_m)} nodes{spread})"


@dataclass(frozen=True)
class NodeStart:
    """Where a filter may start a new node.

    Attributes
    ----------
    ok : bool
    position_m, mirror_m : ndarray, shape (2,)
        The best solution, and the best on the walk's other side; NaN where that side has none.
    offset_m, mirror_offset_m : float
        Node's time and receiver's clock together.
    cost, mirror_cost : float
        Sums of squares over sigma². Close to each other: the side is not known. Infinite without a mirror.
    covariance : ndarray, shape (3, 3)
        Of position and offset.
    """

    ok: bool
    position_m: _Floats
    mirror_m: _Floats
    offset_m: float
    mirror_offset_m: float
    cost: float
    mirror_cost: float
    covariance: _Floats


def _table(name: str, value: npt.ArrayLike, columns: tuple[int, ...] | None) -> _Floats:
    table: _Floats = floats(name, value)
    if table.ndim != 2 or (columns is not None and table.shape[1] not in columns):
        shapes = "(n, L)" if columns is None else " or ".join(f"(n, {c})" for c in columns)
        raise ValueError(f"{name}: shape {shapes} expected, got {table.shape}")
    return table


def locate_nodes(
    track_m: npt.ArrayLike,
    ranges_m: npt.ArrayLike,
    sigma_m: npt.ArrayLike,
    *,
    t_s: npt.ArrayLike | None = None,
    clock: str = "random_walk",
    clock_m_per_sqrt_s: float = 0.2,
    track_m_per_sqrt_s: float = 0.0,
    heading_rad_per_sqrt_s: float = 0.0,
    heights_m: npt.ArrayLike = 0.0,
    max_distance_m: float = 150.0,
    starts: int = 16,
    max_iterations: int = 200,
    ambiguity_cost: float = 13.8,
    seed: int = 0,
) -> NodeMap:
    """Find nodes at unknown places, each with a time of its own, from ranges along a walk (doc/node_mapping.md).

    Model: range = |place - node| + clock(t) + offset(node) + noise. The walk comes from a camera or an IMU and drifts;
    its place and heading errors are random walks that are estimated too. Nothing about the world is needed: positions
    are in the walk's own frame.

    What no walk tells is one time common to clock and nodes, and where the frame lies in the world. A straight walk
    does not tell a node's side: both solutions are given. `ambiguities` says which of it applies. A walk should reach
    two thirds of the nodes' distance from its middle, or more: from a small one, distance and offset are nearly the
    same unknown, and the covariance says so.

    Parameters
    ----------
    track_m : array_like, shape (n, 2) or (n, 3)
        Places of the receiver as odometry has them; a third column is the height.
    ranges_m : array_like, shape (n, L)
        Pseudoranges; NaN where a node was not heard.
    sigma_m : float or array_like, shape (n, L)
    t_s : array_like, shape (n,), optional
        Rising; without it the epochs are 0.1 s apart.
    clock : {"random_walk", "free"}
        The receiver's, against the nodes', whose clocks agree in rate. "free" needs three nodes.
    clock_m_per_sqrt_s, track_m_per_sqrt_s, heading_rad_per_sqrt_s : float
        Of the random walks; 0 for a track without drift.
    heights_m : float or array_like, shape (L,)
        Of the nodes, in the frame of the track's height. Known, not estimated.
    max_distance_m : float
        Of a node from the walk's middle: where to look.
    starts : int
        At most; the search ends when the residuals are as small as the noise.
    max_iterations : int
    ambiguity_cost : float
        A second solution is named if its cost is less above the best (13.8: odds of 1 in 1000).
    seed : int
        Of the later starts.

    Returns
    -------
    NodeMap

    Raises
    ------
    ValueError
        For shapes that do not fit, a track that is not finite, sigmas that are not positive, options out of range.
    """
    track = _table("track_m", track_m, (2, 3))
    ranges = _table("ranges_m", ranges_m, None)
    if len(track) != len(ranges):
        raise ValueError(f"ranges_m: {len(track)} rows expected, one for each place of the track, got {len(ranges)}")
    n, links = ranges.shape
    if clock not in _CLOCKS:
        raise ValueError(f"clock: {clock!r}; one of {', '.join(_CLOCKS)} expected")
    times = 0.1 * np.arange(n) if t_s is None else floats("t_s", t_s).reshape(-1)
    sigma = floats("sigma_m", sigma_m)
    if sigma.shape not in ((), ranges.shape):
        raise ValueError(f"sigma_m: one number or shape {ranges.shape} expected, got {sigma.shape}")
    heights = floats("heights_m", heights_m)
    if heights.shape not in ((), (links,)):
        raise ValueError(f"heights_m: one number or shape ({links},) expected, got {heights.shape}")
    if seed < 0:
        raise ValueError(f"seed: {seed}; it must not be negative")
    height = track[:, 2] if track.shape[1] == 3 else np.zeros(n)
    result = _navigation.locate_nodes(
        times,
        np.column_stack([track[:, :2], height]),
        ranges,
        np.ascontiguousarray(sigma.reshape(-1)),
        np.broadcast_to(heights, (links,)).copy(),
        clock=_CLOCKS[clock],
        clock_m_per_sqrt_s=clock_m_per_sqrt_s,
        track_m_per_sqrt_s=track_m_per_sqrt_s,
        heading_rad_per_sqrt_s=heading_rad_per_sqrt_s,
        max_distance_m=max_distance_m,
        starts=starts,
        max_iterations=max_iterations,
        ambiguity_cost=ambiguity_cost,
        seed=seed,
    )
    status, position, covariance, offset, offset_sigma, mirrored, mirror, bias, corrected, heading, *rest = result
    cost, freedom, observations, undetermined, iterations, tried = rest
    sided = np.asarray(mirrored, dtype=bool)
    words = ["one time common to the receiver's clock and all nodes", "where the walk's frame lies in the world"]
    if sided.any():
        which = ", ".join(str(i) for i in np.flatnonzero(sided))
        words.append(f"the side of the walk on which node {which} lies: mirror_m holds the other solution")
    if undetermined:
        words.append(
            f"{undetermined} further directions of positions and offsets: the walk is too small or too straight"
        )
    if status is NodeMapStatus.TOO_FEW:
        words.append("everything: fewer ranges than unknowns, or a free clock with fewer than three nodes")
    return NodeMap(
        status,
        position,
        covariance,
        offset,
        offset_sigma,
        sided,
        mirror,
        bias,
        corrected,
        heading,
        cost,
        freedom,
        observations,
        undetermined,
        iterations,
        tried,
        tuple(words),
    )


def start_node(
    track_m: npt.ArrayLike,
    ranges_m: npt.ArrayLike,
    sigma_m: float,
    *,
    max_distance_m: float = 150.0,
    height_m: float = 0.0,
) -> NodeStart:
    """One node from a walk that is taken as exact, its offset constant: what a filter starts a new node from.

    Parameters
    ----------
    track_m : array_like, shape (n, 2)
    ranges_m : array_like, shape (n,)
        The receiver's clock taken off, or nearly constant; NaN where the node was not heard.
    sigma_m : float
    max_distance_m : float
        Of the node from the walk's middle.
    height_m : float
        Of the node over the places.

    Returns
    -------
    NodeStart
        Not ok with fewer than 4 ranges, or with none of its answers within reach.
    """
    track = _table("track_m", track_m, (2,))
    if not (sigma_m > 0.0 and np.isfinite(sigma_m)):
        raise ValueError(f"sigma_m: {sigma_m}; it must be finite and positive")
    if not (max_distance_m > 0.0 and np.isfinite(max_distance_m)):
        raise ValueError(f"max_distance_m: {max_distance_m}; it must be finite and positive")
    ok, places, offset, mirror_offset, cost, mirror_cost, covariance = _navigation.start_node(
        track, np.asarray(ranges_m, dtype=np.float64).reshape(-1), sigma_m, max_distance_m, height_m
    )
    return NodeStart(ok, places[0], places[1], offset, mirror_offset, cost, mirror_cost, covariance)
