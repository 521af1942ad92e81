"""NumPy alone: a bootstrap filter, vectorised over particles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def bootstrap(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """An array per state, systematic resampling each step, the mean before resampling each step."""
    return _bootstrap(data, np.float64)


def bootstrap_float(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """The same in single precision, but for the sum of the weights."""
    return _bootstrap(data, np.float32)


def _bootstrap(data: Data, kind: type[np.floating[Any]]) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    count, dt = int(data["particles"]), float(data["dt"])
    sigma_a, sigma_b, sigma_z = (kind(float(data[name])) for name in ("sigma_a", "sigma_b", "sigma_z"))
    nodes, measured = data["nodes"].astype(kind), data["z"].astype(kind)
    half, step = kind(0.5 * dt * dt), kind(dt)
    scale = kind(-0.5) / (sigma_z * sigma_z)
    index = np.arange(count)

    def run() -> Array:
        rng = np.random.default_rng(5)
        noise = rng.standard_normal((5, count), dtype=kind)
        states = data["x0"].astype(kind)[:, None] + data["sigma0"].astype(kind)[:, None] * noise
        other = np.empty_like(states)  # everything is written in place: new arrays of this size cost page faults
        draw, work, logs = np.empty((3, count), kind), np.empty(count, kind), np.empty(count, kind)
        edges, upto, copies = np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64)
        means = np.empty((len(measured), 5))
        for k, z in enumerate(measured):
            rng.standard_normal(out=draw, dtype=kind)
            draw[:2] *= sigma_a
            draw[2] *= sigma_b
            for place, speed, push in ((0, 2, draw[0]), (1, 3, draw[1])):
                np.multiply(states[speed], step, out=work)
                states[place] += work
                np.multiply(push, half, out=work)
                states[place] += work
                push *= step
                states[speed] += push
            states[4] += draw[2]
            logs.fill(0.0)
            x, y, b = states[0], states[1], states[4]
            d, e = work, draw[0]
            for (qx, qy), range_m in zip(nodes, z, strict=True):
                np.subtract(x, qx, out=d)
                np.subtract(y, qy, out=e)
                d *= d
                e *= e
                d += e
                np.sqrt(d, out=d)
                d += b
                d -= range_m
                d *= d
                logs += d
            logs *= scale
            logs -= logs.max()
            weights = np.exp(logs, out=logs)
            means[k] = states @ weights / weights.sum(dtype=np.float64)
            # Systematic: particle i gets the points (j + u) / count that fall into its share of the sum.
            np.cumsum(weights, out=edges)
            edges *= count / edges[-1]
            edges -= rng.random()
            np.ceil(edges, out=edges)
            np.copyto(upto, edges, casting="unsafe")
            upto[-1] = count
            copies[0] = upto[0]
            np.subtract(upto[1:], upto[:-1], out=copies[1:])
            chosen = np.repeat(index, copies)
            for before, after in zip(states, other, strict=True):
                np.take(before, chosen, out=after, mode="clip")
            states, other = other, states
        return means

    def answer(means: Array) -> list[float]:
        return [float(value) for value in means[-1]]

    return run, answer
