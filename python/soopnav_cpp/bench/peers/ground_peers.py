"""Planes from point clouds by NumPy alone and by scikit-learn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Prepared = tuple[Callable[[], Any], Callable[[Any], list[float]]]
BAND_M = 0.006  # three sigma of the sensor at one metre
HYPOTHESES = 40  # for 99.99 % with 30 % outliers 23 would do; noise makes some of them useless


def _oriented(coefficients: npt.NDArray[Any]) -> list[float]:
    normal = coefficients[:3] / np.linalg.norm(coefficients[:3])
    distance = -float(coefficients[3] / np.linalg.norm(coefficients[:3]))
    sign = 1.0 if normal[2] > 0.0 else -1.0
    return [*(float(sign * value) for value in normal), sign * distance]


def svd(data: Data) -> Prepared:
    """Right singular vector of [x y z 1], nielsen 4.1."""
    points = data["points"]

    def run() -> Any:
        Q = np.column_stack([points, np.ones(len(points), dtype=points.dtype)]).astype(np.float64)
        return np.linalg.svd(Q, full_matrices=False)[2][3]

    return run, _oriented


def ransac(data: Data) -> Prepared:
    """All hypotheses at once on all points, then a refit to the band of the best."""
    points = data["points"]

    def run() -> Any:
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
        return np.append(normal, -normal @ kept.mean(axis=0))

    return run, _oriented


def scikit_learn(data: Data) -> Prepared:
    """RANSACRegressor of z over x and y."""
    from sklearn.linear_model import LinearRegression, RANSACRegressor

    points = data["points"].astype(np.float64)

    def run() -> Any:
        model = RANSACRegressor(LinearRegression(), residual_threshold=BAND_M, max_trials=HYPOTHESES, random_state=1)
        model.fit(points[:, :2], points[:, 2])
        slope = model.estimator_.coef_
        return np.array([-slope[0], -slope[1], 1.0, -float(model.estimator_.intercept_)])

    return run, _oriented
