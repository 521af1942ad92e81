"""A handset with a camera among radio nodes: our side, held against NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import navigation, simulation
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["HANDSET_CASES"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]


def _walk() -> Data:
    world = simulation.HandsetWorld.generate(1, duration_s=15.0, min_clear_share=0.2, epoch_offset_s=0.0)
    return cast(
        Data,
        {
            "nodes": world.nodes_m,
            "heading": np.array(world.told_heading_rad),
            "frame_s": world.frame_s,
            "increments": world.increments,
            "variances": np.array([1e-6, 1e-6, 1.22e-7]),
            "epoch_s": world.epoch_s,
            "ranges": world.ranges_m,
            "particles": np.array(2000),
        },
    )


def _locator(data: Data) -> Timed:
    locator = navigation.HandsetLocator(
        data["nodes"],
        particles=int(data["particles"]),
        start_sigma_m=6.0,
        start_heading_rad=float(data["heading"]),
        start_heading_sigma_rad=0.1,
    )

    def run() -> Any:
        locator.reset(5)
        return locator.run(
            data["frame_s"],
            data["increments"],
            data["epoch_s"],
            data["ranges"],
            sigma_m=1.0,
            track_covariance=data["variances"],
        )

    def answer(result: Any) -> list[float]:
        return [float(value) for value in result.position_m[-1]]

    return run, answer


HANDSET_CASES: tuple[Case, ...] = (
    Case(
        name="handset/2000x6",
        title="2000 particles, 6 links, 150 epochs and 300 frames; ours with an estimate after each epoch",
        data=_walk,
        ours=_locator,
        peers=(Peer("numpy", "handset_peers", "locator"),),
        tolerance=0.5,
    ),
)
