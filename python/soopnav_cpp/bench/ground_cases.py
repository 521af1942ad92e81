"""Planes of the ground from 30 000 points: our side, held against NumPy and scikit-learn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from soopnav_cpp._core.vision import Camera, PlaneFitter
from soopnav_cpp._ground_scene import GroundScene
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["GROUND_CASES"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]


def _cloud(outliers: float) -> Data:
    scene = GroundScene(seed=1, texture_size=64)
    camera = Camera(640, 480, 575.0, 575.0, 319.5, 239.5)
    points = scene.depth_cloud(camera, (0.3, 0.2, 0.5), 1.0, (0.08, -0.12), outlier_share=outliers)
    return cast(Data, {"points": points})


def _clean() -> Data:
    return _cloud(0.0)


def _dirty() -> Data:
    return _cloud(0.3)


def _fit(method: str) -> Callable[[Data], Timed]:
    def prepare(data: Data) -> Timed:
        fitter = PlaneFitter(method=method)

        def run() -> Any:
            return fitter.fit(data["points"])

        def answer(plane: Any) -> list[float]:
            return [*(float(value) for value in plane.normal_c), float(plane.distance_m)]

        return run, answer

    return prepare


GROUND_CASES: tuple[Case, ...] = (
    Case(
        name="ground/plane-ransac-30000",
        title="plane of 30 000 points, 30 % of them outliers, with a robust method",
        data=_dirty,
        ours=_fit("ransac"),
        peers=(
            Peer("numpy", "ground_peers", "ransac"),
            Peer("scikit-learn", "ground_peers", "scikit_learn", ("scikit-learn>=1.3", "numpy")),
        ),
        tolerance=5e-3,
    ),
    Case(
        name="ground/plane-svd-30000",
        title="plane of 30 000 clean points by the SVD of [x y z 1]; ours states its covariance as well",
        data=_clean,
        ours=_fit("svd"),
        peers=(Peer("numpy", "ground_peers", "svd"),),
        tolerance=1e-4,
    ),
)
