"""NumPy alone: where an emitter is, from bearings. Written in place, for new arrays of this size cost page faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]
TURN = 2.0 * np.pi


def _error(x: Array, y: Array, place: Array, azimuth: float, dx: Array, out: Array) -> None:
    """Wrapped azimuth residuals into `out`."""
    np.subtract(x, place[0], out=dx)
    np.subtract(y, place[1], out=out)
    np.arctan2(out, dx, out=out)
    out -= azimuth
    np.multiply(out, 1.0 / TURN, out=dx)
    np.rint(dx, out=dx)
    dx *= TURN
    out -= dx


def surface(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Normal log-likelihood of every point of a grid, one bearing after the other."""
    places, azimuths, sigmas = data["places"], data["azimuths"], data["sigmas"]
    side = int(data["side"])
    limits = data["limits"]
    axis_x = np.linspace(limits[0], limits[1], side)
    axis_y = np.linspace(limits[2], limits[3], side)
    constant = -float(np.sum(np.log(np.sqrt(TURN) * sigmas)))

    def run() -> Array:
        x = np.tile(axis_x, (side, 1))
        y = np.repeat(axis_y, side).reshape(side, side)
        total, dx, error = np.full((side, side), constant), np.empty((side, side)), np.empty((side, side))
        for place, azimuth, sigma in zip(places, azimuths, sigmas, strict=True):
            _error(x, y, place, azimuth, dx, error)
            error *= error
            error *= 0.5 / (sigma * sigma)
            total -= error
        return total

    def answer(total: Array) -> list[float]:
        best = int(np.argmax(total))
        return [float(axis_x[best % side]), float(axis_y[best // side]), float(total.max()), float(total[0, 0])]

    return run, answer


def particles(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Weights with an outlier floor, systematic resampling below half, a kernel of the cloud's covariance."""
    places, azimuths, sigmas = data["places"], data["azimuths"], data["sigmas"]
    count, outlier = int(data["particles"]), float(data["outlier"])
    start, start_sigma = data["start"], float(data["start_sigma"])
    index = np.arange(count)
    bandwidth = float(count) ** (-1.0 / 6.0)
    keep = np.sqrt(1.0 - bandwidth * bandwidth)

    def run() -> Array:
        rng = np.random.default_rng(5)
        cloud = start[:, None] + start_sigma * rng.standard_normal((2, count))
        weights = np.full(count, 1.0 / count)
        dx, error = np.empty(count), np.empty(count)
        for place, azimuth, sigma in zip(places, azimuths, sigmas, strict=True):
            _error(cloud[0], cloud[1], place, azimuth, dx, error)
            error *= error
            error *= -0.5 / (sigma * sigma)
            np.exp(error, out=error)
            error += outlier / TURN / ((1.0 - outlier) / (np.sqrt(TURN) * sigma))
            weights *= error
            weights /= weights.sum()
            if 0.5 * count * float(weights @ weights) > 1.0:
                mean = cloud @ weights
                centred = cloud - mean[:, None]
                factor = np.linalg.cholesky((centred * weights) @ centred.T)
                edges = np.cumsum(weights)
                edges *= count / edges[-1]
                upto = np.ceil(edges - rng.random()).astype(np.int64)
                upto[-1] = count
                chosen = np.repeat(index, np.diff(upto, prepend=0))
                cloud = keep * cloud[:, chosen] + (1.0 - keep) * mean[:, None]
                cloud += bandwidth * (factor @ rng.standard_normal((2, count)))
                weights.fill(1.0 / count)
        return np.asarray(cloud @ weights)

    def answer(mean: Array) -> list[float]:
        return [float(value) for value in mean]

    return run, answer
