"""The package `particles`: a bootstrap filter of a state-space model with a transition of its own."""

# Names and signatures are the package's.
# ruff: noqa: ARG002, N802

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import particles
from particles import distributions
from particles import state_space_models as ssm

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def bootstrap(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`particles.SMC` on `Bootstrap`, systematic resampling each step, the mean collected each step."""
    count, dt = int(data["particles"]), float(data["dt"])
    sigma_a, sigma_b, sigma_z = (float(data[name]) for name in ("sigma_a", "sigma_b", "sigma_z"))
    nodes, measured = data["nodes"], data["z"]
    rng = np.random.default_rng(5)
    x0, sigma0 = data["x0"], data["sigma0"]

    def moved(state: Array) -> Array:
        draw = rng.standard_normal((3, len(state)))
        ax, ay = sigma_a * draw[0], sigma_a * draw[1]
        new = np.empty_like(state)
        new[:, 0] = state[:, 0] + dt * state[:, 2] + 0.5 * dt * dt * ax
        new[:, 1] = state[:, 1] + dt * state[:, 3] + 0.5 * dt * dt * ay
        new[:, 2] = state[:, 2] + dt * ax
        new[:, 3] = state[:, 3] + dt * ay
        new[:, 4] = state[:, 4] + sigma_b * draw[2]
        return new

    class Motion(distributions.ProbDist):  # type: ignore[misc]
        """Three normals drive five states, which no distribution of the package does."""

        dim = 5

        def __init__(self, before: Array) -> None:
            self.before = before

        def rvs(self, size: int | None = None) -> Array:
            return moved(self.before)

    class Prior(distributions.ProbDist):  # type: ignore[misc]
        dim = 5

        def rvs(self, size: int | None = None) -> Array:
            return moved(x0 + sigma0 * rng.standard_normal((size or 1, 5)))

    class Ranges(ssm.StateSpaceModel):  # type: ignore[misc]
        def PX0(self) -> Any:
            return Prior()

        def PX(self, t: int, xp: Array) -> Any:
            return Motion(xp)

        def PY(self, t: int, xp: Array, x: Array) -> Any:
            places = (np.hypot(x[:, 0] - qx, x[:, 1] - qy) + x[:, 4] for qx, qy in nodes)
            return distributions.IndepProd(*(distributions.Normal(loc=place, scale=sigma_z) for place in places))

    def run() -> Any:
        model = ssm.Bootstrap(ssm=Ranges(), data=measured)
        smc = particles.SMC(
            fk=model, N=count, resampling="systematic", ESSrmin=1.0, collect=[particles.collectors.Moments()]
        )
        smc.run()
        return smc

    def answer(smc: Any) -> list[float]:
        return [float(value) for value in smc.summaries.moments[-1]["mean"]]

    return run, answer
