"""The package `pfilter`: a bootstrap filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from pfilter import ParticleFilter

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def bootstrap(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`ParticleFilter.update` for each step, systematic resampling each step.

    The package's own resampling is a loop over particles in Python; it takes a function instead, and gets one of NumPy.
    """
    count, dt = int(data["particles"]), float(data["dt"])
    sigma_a, sigma_b, sigma_z = (float(data[name]) for name in ("sigma_a", "sigma_b", "sigma_z"))
    nodes, measured = data["nodes"], data["z"]
    F = np.eye(5)
    F[0, 2] = F[1, 3] = dt
    half, index = 0.5 * dt * dt, np.arange(count)
    drive = np.array([[half, 0, 0], [0, half, 0], [dt, 0, 0], [0, dt, 0], [0, 0, 1.0]]) * [sigma_a, sigma_a, sigma_b]

    def run() -> Any:
        rng = np.random.default_rng(5)

        def observe(states: Array) -> Array:
            places = [np.hypot(states[:, 0] - qx, states[:, 1] - qy) + states[:, 4] for qx, qy in nodes]
            return np.stack(places, axis=1)

        def weigh(expected: Array, observed: Array) -> Array:
            d = (expected - observed) / sigma_z
            return np.asarray(np.exp(-0.5 * (d * d).sum(axis=1)), np.float64)

        def resample(weights: Array) -> npt.NDArray[np.int64]:
            edges = np.ceil(np.cumsum(weights) * count - rng.random()).clip(0, count).astype(np.int64)
            edges[-1] = count
            return np.repeat(index, np.diff(edges, prepend=0))

        cloud = ParticleFilter(
            prior_fn=lambda n: data["x0"] + data["sigma0"] * rng.standard_normal((n, 5)),
            dynamics_fn=lambda states: states @ F.T,
            noise_fn=lambda states: states + rng.standard_normal((count, 3)) @ drive.T,
            observe_fn=observe,
            weight_fn=weigh,
            resample_fn=resample,
            n_particles=count,
            n_eff_threshold=1.0,
        )
        for z in measured:
            cloud.update(z)
        return cloud

    def answer(cloud: Any) -> list[float]:
        return [float(value) for value in cloud.mean_state]

    return run, answer
