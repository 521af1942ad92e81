"""A camera's increments from images: our side, held against the same steps through OpenCV's Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import simulation, vision
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["VISION_CASES"]

_FRAMES = 12
_STEP = (0.02, 0.004, 0.004)
_TILT = (0.08, -0.06)


def _frames() -> Data:
    scene = simulation.GroundScene(seed=2, texture_size=1024, texel_m=0.002)
    eye = vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    images = [scene.render(eye, tuple(k * np.array(_STEP)), 1.0, _TILT, noise=2.0, frame=k) for k in range(_FRAMES)]
    plane = scene.true_plane(1.0, _TILT)
    return cast(
        Data,
        {
            "images": np.stack(images),
            "camera": np.array([525.0, 525.0, 319.5, 239.5]),
            "normal_c": np.array(plane.normal_c),
            "distance_m": np.array(plane.distance_m),
        },
    )


def _ours(data: Data) -> tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]:
    height, width = data["images"][0].shape
    eye = vision.Camera(width, height, *(float(value) for value in data["camera"]))
    plane = vision.GroundPlane.known(data["normal_c"], float(data["distance_m"]))

    def run() -> Any:
        ego = vision.EgoMotion(eye)
        return [ego.step(image, plane=plane, t_s=0.05 * k).increment for k, image in enumerate(data["images"])]

    return run, lambda increments: [float(value) for value in np.sum(increments, axis=0)]


def _frames_and_depth() -> Data:
    scene = simulation.GroundScene(seed=2, texture_size=1024, texel_m=0.002)
    eye = vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    images, clouds = [], []
    for k in range(_FRAMES):
        pose, tilt = tuple(k * np.array(_STEP)), (_TILT[0] + 0.01 * np.sin(k), _TILT[1] + 0.01 * np.cos(k))
        images.append(scene.render(eye, pose, 1.0, tilt, noise=2.0, frame=k))
        clouds.append(scene.depth_cloud(eye, pose, 1.0, tilt, points=30_000, frame=k))
    return cast(
        Data,
        {
            "images": np.stack(images),
            "points": np.stack(clouds),
            "camera": np.array([525.0, 525.0, 319.5, 239.5]),
        },
    )


def _ours_with_depth(data: Data) -> tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]:
    height, width = data["images"][0].shape
    eye = vision.Camera(width, height, *(float(value) for value in data["camera"]))

    def run() -> Any:
        ego = vision.EgoMotion(eye)
        frames = enumerate(zip(data["images"], data["points"], strict=True))
        return [ego.step(image, points=points, t_s=0.05 * k).increment for k, (image, points) in frames]

    return run, lambda increments: [float(value) for value in np.sum(increments, axis=0)]


VISION_CASES: tuple[Case, ...] = (
    Case(
        name="vision/ego-motion-640x480",
        title="a camera over a known plane, 11 increments of 640 x 480 frames, 300 corners, forwards and backwards",
        data=_frames,
        ours=_ours,
        peers=(Peer("opencv", "vision_peers", "ego_motion", ("opencv-python-headless>=4.6", "numpy")),),
        tolerance=1e-3,
    ),
    Case(
        name="vision/ego-motion-depth-640x480",
        title="the same with a tilt that wobbles, the plane of each frame found in 30 000 points first",
        data=_frames_and_depth,
        ours=_ours_with_depth,
        peers=(Peer("opencv", "vision_peers", "ego_motion_depth", ("opencv-python-headless>=4.6", "numpy")),),
        tolerance=5e-3,
    ),
)
