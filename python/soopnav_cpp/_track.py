"""Jacobians of walks whose shape is known but for a few parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import estimation as _estimation

__all__ = ["track_jacobian"]

Array = npt.NDArray[np.float64]
Axis = Literal["x", "y", "z"]
Extent = Literal["known", "common", "separate"]


def track_jacobian(
    kind: Literal["range", "azimuth"],
    nodes_m: npt.ArrayLike,
    positions_m: npt.ArrayLike,
    *,
    offset: Sequence[Axis] = (),
    step: Sequence[Axis] = (),
    heading: bool = False,
    bias: Extent = "known",
    drift: Extent = "known",
    steps_taken: npt.ArrayLike | None = None,
    times_s: npt.ArrayLike | None = None,
    start_m: npt.ArrayLike | None = None,
    node_names: Sequence[str] | None = None,
) -> tuple[Array, tuple[str, ...]]:
    """Jacobian of what nodes measure along a track whose shape is known but for a few parameters (nielsen 3.4.2).

    Parameters
    ----------
    kind : str
        ``"range"`` [m] (a pseudorange with an unknown bias), or ``"azimuth"`` [rad].
    nodes_m : array_like, shape (L, 2) or (L, 3)
    positions_m : array_like, shape (..., N, 2) or (..., N, 3)
        The track, or many of them.
    offset : sequence of str
        Axes along which the whole track may be displaced [m].
    step : sequence of str
        Axes along which every step may be longer by the same length [m]: after i steps the position has moved by i of
        them.
    heading : bool
        Whether the track may be turned about `start_m`, from x towards y [rad].
    bias : str
        Of the measurements: ``"known"``, ``"common"`` to all nodes, or ``"separate"`` [unit of the measurement].
    drift : str
        Likewise, its rate [unit per second].
    steps_taken : array_like, shape (N,), optional
        Steps before each position; 1 ... N without.
    times_s : array_like, shape (N,), optional
        Needed for a drift.
    start_m : array_like, shape (..., 2) or (..., 3), optional
        Of each track; its first position without.
    node_names : sequence of str, optional
        For the names of separate biases; 1 ... L without.

    Returns
    -------
    H : ndarray, shape (..., N * L, n)
        Rows ordered by position, then node; NaN where the receiver stands on a node.
    names : tuple of str
        Of the n parameters: ``"offset x"``, ``"step x"``, ``"heading"``, ``"bias A"``, ``"drift A"``.

    Raises
    ------
    ValueError
        For shapes that do not fit, an axis that is not there, and no parameter at all.
    """
    nodes, positions = np.asarray(nodes_m, dtype=np.float64), np.asarray(positions_m, dtype=np.float64)
    if nodes.ndim != 2 or nodes.shape[1] not in (2, 3) or not len(nodes):
        raise ValueError(f"nodes_m: expected shape (L, 2) or (L, 3), got {nodes.shape}")
    axes = nodes.shape[1]
    if positions.ndim < 2 or positions.shape[-1] != axes or not positions.size:
        raise ValueError(f"positions_m: expected shape (..., N, {axes}) as the nodes have, got {positions.shape}")
    known_axes = ("x", "y", "z")[:axes]
    for name, chosen in (("offset", offset), ("step", step)):
        for axis in chosen:
            if axis not in known_axes:
                raise ValueError(f"{name}: no axis {axis!r}; there are {', '.join(known_axes)}")
    labels = tuple(str(i + 1) for i in range(len(nodes))) if node_names is None else tuple(node_names)
    if len(labels) != len(nodes):
        raise ValueError(f"node_names: {len(labels)} for {len(nodes)} nodes")
    tracks, count = positions.shape[:-2], positions.shape[-2]

    def padded(points: Array) -> Array:
        return points if axes == 3 else np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)

    flat = np.ascontiguousarray(padded(positions)).reshape(-1, 3)
    gradient = _estimation.position_jacobian(kind, padded(nodes), flat).reshape(*tracks, count, len(nodes), 3)
    taken = np.arange(1.0, count + 1.0) if steps_taken is None else np.asarray(steps_taken, dtype=np.float64)
    if taken.shape != (count,):
        raise ValueError(f"steps_taken: expected shape ({count},), got {taken.shape}")
    columns: list[Array] = [gradient[..., known_axes.index(axis)] for axis in offset]
    names = [f"offset {axis}" for axis in offset]
    columns += [gradient[..., known_axes.index(axis)] * taken[:, None] for axis in step]
    names += [f"step {axis}" for axis in step]
    if heading:
        origin = positions[..., 0, :] if start_m is None else np.asarray(start_m, dtype=np.float64)
        arm = positions - origin[..., None, :]
        columns.append(gradient[..., 1] * arm[..., :, None, 0] - gradient[..., 0] * arm[..., :, None, 1])
        names.append("heading")
    ones = np.where(np.isfinite(gradient[..., 0]), 1.0, np.nan)
    for name, extent in (("bias", bias), ("drift", drift)):
        if extent == "known":
            continue
        growth = ones
        if name == "drift":
            times = np.asarray(times_s if times_s is not None else (), dtype=np.float64)
            if times.shape != (count,):
                raise ValueError(f"times_s: needed for a drift, with shape ({count},), got {times.shape}")
            growth = ones * times[:, None]
        if extent == "common":
            columns.append(growth)
            names.append(name)
        else:
            columns += [growth * (np.arange(len(nodes)) == j) for j in range(len(nodes))]
            names += [f"{name} {label}" for label in labels]
    if not columns:
        raise ValueError("offset, step, heading, bias, drift: at least one unknown expected")
    return np.stack(columns, axis=-1).reshape(*tracks, count * len(nodes), len(columns)), tuple(names)
