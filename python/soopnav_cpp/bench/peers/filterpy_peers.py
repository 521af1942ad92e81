"""FilterPy: the RTS smoother and the extended Kalman filter."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import Any

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def rts(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`KalmanFilter.rts_smoother` of a filtered run."""
    n, m = len(data["F"]), 4
    kf = KalmanFilter(dim_x=n, dim_z=m)
    kf.F, kf.Q = data["F"], data["Q"]
    x, P = data["x"], data["P"]

    def run() -> tuple[Array, Array]:
        smoothed = kf.rts_smoother(x, P)
        return smoothed[0], smoothed[1]

    def answer(smoothed: tuple[Array, Array]) -> list[float]:
        return [*smoothed[0][0], *np.diagonal(smoothed[1][0])]

    return run, answer


class _PlanarIns(ExtendedKalmanFilter):  # type: ignore[misc]
    """Predicts by the mechanisation; FilterPy asks for an override where the transition is not linear."""

    dt: float = 0.0
    x: Any

    def predict_x(self, u: Any = 0) -> None:
        theta, vx, vy, x, y = self.x
        c, s = cos(theta), sin(theta)
        ax, ay = c * u[1] - s * u[2], s * u[1] + c * u[2]
        dt = self.dt
        self.F[1, 0], self.F[2, 0] = -ay * dt, ax * dt
        self.x = np.array([theta + u[0] * dt, vx + ax * dt, vy + ay * dt, x + vx * dt, y + vy * dt])


def ekf_planar_ins(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`ExtendedKalmanFilter`: `predict` for each input, `update` for each row of range differences."""
    transmitters, start = data["transmitters"], np.linalg.norm(data["p0"] - data["transmitters"], axis=1)
    every = len(data["u"]) // len(data["z"])
    inputs, heard = data["u"].tolist(), data["z"]

    def hx(state: Array) -> Array:
        away = state[3:] - transmitters
        return np.asarray(start - np.sqrt((away * away).sum(axis=1)), np.float64)

    def jacobian(state: Array) -> Array:
        away = state[3:] - transmitters
        H = np.zeros((3, 5))
        H[:, 3:] = -away / np.sqrt((away * away).sum(axis=1))[:, None]
        return H

    def run() -> _PlanarIns:
        ekf = _PlanarIns(dim_x=5, dim_z=3)
        ekf.dt = float(data["dt"])
        ekf.x, ekf.P, ekf.Q, ekf.R = data["x0"].copy(), data["P0"].copy(), data["Q"], data["R"]
        ekf.F = np.eye(5)
        ekf.F[3, 1] = ekf.F[4, 2] = ekf.dt
        for k, u in enumerate(inputs):
            ekf.predict(u)
            if (k + 1) % every == 0:
                ekf.update(heard[k // every], jacobian, hx)
        return ekf

    def answer(ekf: _PlanarIns) -> list[float]:
        return [*ekf.x, *np.diagonal(ekf.P)]

    return run, answer
