"""OpenCV's Python: corners, optical flow there and back, a motion by RANSAC, as its tutorials put them together.

Where the ground is not known, NumPy finds its plane first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]
Prepared = tuple[Callable[[], Any], Callable[[Any], list[float]]]
Plane = tuple[Array, float]  # unit normal into the ground, distance [m]
BAND_M = 0.006  # three sigma of the sensor at one metre
HYPOTHESES = 40


def ego_motion(data: Data) -> Prepared:
    """Increments over a known plane."""
    known = np.asarray(data["normal_c"], np.float64), float(data["distance_m"])
    return _followed(data, lambda _: known)


def ego_motion_depth(data: Data) -> Prepared:
    """Increments over the plane that each frame's depth shows: hypotheses all at once, then refits to the band."""

    def plane(k: int) -> Plane:
        points = data["points"][k]
        rng = np.random.default_rng(1)
        corners = points[rng.integers(0, len(points), (HYPOTHESES, 3))]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        distances = np.einsum("ij,ij->i", normals, corners[:, 0])
        inside = np.abs(points @ normals.T - distances) < BAND_M
        kept = points[inside[:, np.argmax(inside.sum(axis=0))]].astype(np.float64)
        for _ in range(3):
            middle = kept.mean(axis=0)
            normal = np.linalg.eigh((kept - middle).T @ (kept - middle))[1][:, 0]
            kept = points[np.abs((points - middle) @ normal) < BAND_M].astype(np.float64)
        normal = normal if normal[2] > 0.0 else -normal
        return normal, float(normal @ kept.mean(axis=0))

    return _followed(data, plane)


def _followed(data: Data, plane_of: Callable[[int], Plane]) -> Prepared:
    """The steps of the engine, one thread: 300 corners kept and refilled, a window of 21 pixels, four pyramid levels.

    Images are smoothed and freed of their local mean alike. Pixels meet the ground in NumPy; a similarity by
    `estimateAffinePartial2D`, in place of the rigid motion, is turned into {dx, dy, da_z}.
    """
    import cv2

    cv2.setNumThreads(1)
    lucas_kanade: Any = cv2.calcOpticalFlowPyrLK  # its types know no None for a start, its manual does
    fx, fy, cx, cy = (float(value) for value in data["camera"])
    flow: Any = {
        "winSize": (21, 21),
        "maxLevel": 3,
        "criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.003),
    }

    def ground(pixels: Array, plane: Plane) -> Array:
        n, d = plane
        first = np.array([1.0, 0.0, 0.0]) - n[0] * n
        first /= np.linalg.norm(first)
        axes = np.stack([first, np.cross(first, n)])
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

    def step(before: Any, now: Any, points: Any, planes: tuple[Plane, Plane]) -> tuple[Array, Any]:
        there, seen, _ = lucas_kanade(before, now, points, None, **flow)
        back, again, _ = lucas_kanade(now, before, there, None, **flow)
        good = (seen.ravel() > 0) & (again.ravel() > 0) & (np.abs(back - points).max(axis=(1, 2)) < 0.5)
        a, b = ground(points[good].reshape(-1, 2), planes[0]), ground(there[good].reshape(-1, 2), planes[1])
        M, _ = cv2.estimateAffinePartial2D(b, a, ransacReprojThreshold=planes[1][1] / fx)
        return np.array([M[0, 2], M[1, 2], np.arctan2(M[1, 0], M[0, 0])]), there[good]

    def run() -> list[Array]:
        before, plane = prepared(data["images"][0]), plane_of(0)
        points = refill(before, np.empty((0, 1, 2), np.float32))
        increments = [np.zeros(3)]
        for k, image in enumerate(data["images"][1:], 1):
            now, next_plane = prepared(image), plane_of(k)
            increment, points = step(before, now, points, (plane, next_plane))
            if len(points) < 240:
                points = refill(now, points)
            increments.append(increment)
            before, plane = now, next_plane
        return increments

    return run, lambda increments: [float(value) for value in np.sum(increments, axis=0)]
