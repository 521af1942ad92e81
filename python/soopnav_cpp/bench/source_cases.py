"""Finding a source from bearings: our side, held against NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import navigation
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["SOURCE_CASES"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]


def _drive() -> Data:
    """500 bearings past an emitter at the origin, a degree of noise near it and ten far away."""
    s = np.linspace(0.0, 1.0, 500)
    places = np.stack(
        [-1000.0 + 1150.0 * np.minimum(2.0 * s, 1.0), -150.0 + 1150.0 * np.maximum(2.0 * s - 1.0, 0.0)], 1
    )
    sigmas = np.radians(1.0 + 9.0 * np.linalg.norm(places, axis=1) / 1000.0)
    noise = np.random.default_rng(1).standard_normal(500)
    azimuths = np.arctan2(-places[:, 1], -places[:, 0]) + sigmas * noise
    return cast(Data, {"places": places, "azimuths": azimuths, "sigmas": sigmas})


def _surface_data() -> Data:
    return _drive() | cast(Data, {"side": np.array(200), "limits": np.array([-1000.0, 1000.0, -900.0, 1100.0])})


def _surface(data: Data) -> Timed:
    side, limits = int(data["side"]), [float(v) for v in data["limits"]]

    def run() -> Any:
        return navigation.likelihood_surface(
            data["places"],
            data["azimuths"],
            data["sigmas"],
            (limits[0], limits[1]),
            (limits[2], limits[3]),
            shape=(side, side),
            outlier_probability=0.0,
        )

    def answer(result: Any) -> list[float]:
        x, y, total = result
        best = int(np.argmax(total))
        return [float(x[best % side]), float(y[best // side]), float(total.max()), float(total[0, 0])]

    return run, answer


def _particle_data() -> Data:
    return _drive() | cast(
        Data,
        {
            "particles": np.array(10_000),
            "outlier": np.array(0.02),
            "start": np.array([300.0, 200.0]),
            "start_sigma": np.array(500.0),
        },
    )


def _particles(data: Data) -> Timed:
    times = np.arange(500.0)
    locator = navigation.SourceLocator(
        "particle",
        start_m=data["start"],
        start_sigma_m=float(data["start_sigma"]),
        particles=int(data["particles"]),
        outlier_probability=float(data["outlier"]),
        seed=5,
    )

    def run() -> Any:
        return locator.run_many(
            times, data["places"], data["azimuths"][None], data["sigmas"], starts_m=data["start"][None], seeds=[5]
        )

    def answer(result: Any) -> list[float]:
        return [float(value) for value in result.position_m[0, -1]]

    return run, answer


SOURCE_CASES: tuple[Case, ...] = (
    Case(
        name="source/likelihood-200x200",
        title="log-likelihood of a source on 200 x 200 points, 500 bearings",
        data=_surface_data,
        ours=_surface,
        peers=(Peer("numpy", "source_peers", "surface"),),
        tolerance=1e-6,
    ),
    Case(
        name="source/particles-1e4",
        title="10 000 particles, 500 bearings, resampled and regularised below half of them",
        data=_particle_data,
        ours=_particles,
        peers=(Peer("numpy", "source_peers", "particles"),),
        tolerance=0.5,
    ),
)
