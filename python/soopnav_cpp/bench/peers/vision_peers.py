"""OpenCV's Python: corners, optical flow there and back, a motion by RANSAC, as its tutorials put them together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def ego_motion(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """The steps of the engine, one thread: 300 corners kept and refilled, a window of 21 pixels, four pyramid levels.

    Images are smoothed and freed of their local mean alike. Pixels meet the ground in NumPy; a similarity by
    `estimateAffinePartial2D`, in place of the rigid motion, is turned into {dx, dy, da_z}.
    """
    import cv2

    cv2.setNumThreads(1)
    lucas_kanade: Any = cv2.calcOpticalFlowPyrLK  # None for a start is right, its stubs say otherwise
    fx, fy, cx, cy = (float(value) for value in data["camera"])
    n, d = data["normal_c"], float(data["distance_m"])
    first = np.array([1.0, 0.0, 0.0]) - n[0] * n
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(first, n)])
    flow: Any = {
        "winSize": (21, 21),
        "maxLevel": 3,
        "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.003),
    }

    def ground(pixels: Array) -> Array:
        rays = np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))])
        points: Array = (rays * (d / (rays @ n))[:, None]) @ axes.T
        return points

    def prepared(image: Any) -> Any:
        smooth = cv2.GaussianBlur(image, (0, 0), 0.8)
        return cv2.addWeighted(smooth, 1.0, cv2.blur(smooth, (43, 43)), -1.0, 128.0)

    def refill(image: Any, points: Any) -> Any:
        mask = np.full(image.shape, 255, np.uint8)
        mask[:12] = mask[-12:] = 0
        mask[:, :12] = mask[:, -12:] = 0
        for u, v in points.reshape(-1, 2):
            cv2.circle(mask, (round(float(u)), round(float(v))), 8, 0, -1)
        new = cv2.goodFeaturesToTrack(image, 300 - len(points), 0.02, 8, mask=mask, blockSize=5)
        return points if new is None else np.concatenate([points, new])

    def step(before: Any, now: Any, points: Any) -> tuple[Array, Any]:
        there, seen, _ = lucas_kanade(before, now, points, None, **flow)
        back, again, _ = lucas_kanade(now, before, there, None, **flow)
        good = (seen.ravel() > 0) & (again.ravel() > 0) & (np.abs(back - points).max(axis=(1, 2)) < 0.5)
        a, b = ground(points[good].reshape(-1, 2)), ground(there[good].reshape(-1, 2))
        M, _ = cv2.estimateAffinePartial2D(b, a, ransacReprojThreshold=d / fx)
        return np.array([M[0, 2], M[1, 2], np.arctan2(M[1, 0], M[0, 0])]), there[good]

    def run() -> list[Array]:
        before = prepared(data["images"][0])
        points = refill(before, np.empty((0, 1, 2), np.float32))
        increments = [np.zeros(3)]
        for image in data["images"][1:]:
            now = prepared(image)
            increment, points = step(before, now, points)
            if len(points) < 240:
                points = refill(now, points)
            increments.append(increment)
            before = now
        return increments

    return run, lambda increments: [float(value) for value in np.sum(increments, axis=0)]
