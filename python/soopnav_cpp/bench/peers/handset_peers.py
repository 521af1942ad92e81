"""NumPy alone: a handset among radio nodes with a camera, one joint Gaussian per particle, all particles at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]
EXCESS_MEAN_M, EXCESS_VARIANCE_M2 = 12.0, 16.0**2 / 12.0
OUTLIER, OUTLIER_SPAN_M = 1e-3, 200.0
MEAN_LOS_S, MEAN_NLOS_S = 10.0, 5.0
X, Y, HEADING, CLOCK, EXCESS = 0, 1, 2, 3, 4


def _density(v: Array, s: Array) -> Array:
    return np.asarray(np.exp(-0.5 * v * v / s) / np.sqrt(2.0 * np.pi * s))


class _Cloud:
    def __init__(self, data: Data) -> None:
        self.rng = np.random.default_rng(5)
        count, links = int(data["particles"]), data["nodes"].shape[0]
        self.nodes, self.dt = data["nodes"], float(data["epoch_s"][1] - data["epoch_s"][0])
        size = EXCESS + links
        self.mean = np.zeros((count, size))
        self.cov = np.zeros((count, size, size))
        own, own_a = min(0.35 * 6.0, 2.0), min(0.035, 0.12)
        self.mean[:, :2] = np.sqrt(36.0 - own**2) * self.rng.standard_normal((count, 2))
        self.mean[:, HEADING] = data["heading"] + np.sqrt(0.01 - own_a**2) * self.rng.standard_normal(count)
        self.mean[:, EXCESS:] = EXCESS_MEAN_M
        each = [own**2, own**2, own_a**2, 1e6, *[EXCESS_VARIANCE_M2] * links]
        self.cov[:] = np.diag(each)
        self.blocked = self.rng.random((count, links)) < MEAN_NLOS_S / (MEAN_LOS_S + MEAN_NLOS_S)
        self.weight = np.full(count, 1.0 / count)

    def move(self, step: Array, variances: Array) -> None:
        c, s = np.cos(self.mean[:, HEADING]), np.sin(self.mean[:, HEADING])
        gx, gy = c * step[0] - s * step[1], s * step[0] + c * step[1]
        self.mean[:, X] += gx
        self.mean[:, Y] += gy
        self.mean[:, HEADING] += step[2]
        for row, by in ((X, -gy), (Y, gx)):
            self.cov[:, row, :] += by[:, None] * self.cov[:, HEADING, :]
            self.cov[:, :, row] += by[:, None] * self.cov[:, :, HEADING]
        for row in range(3):
            self.cov[:, row, row] += variances[row]

    def weigh(self, ranges: Array, first: bool) -> None:
        count, links = self.blocked.shape
        dt = 0.0 if first else self.dt
        kept = np.exp(-dt * (1.0 / MEAN_LOS_S + 1.0 / MEAN_NLOS_S))
        stationary = MEAN_NLOS_S / (MEAN_LOS_S + MEAN_NLOS_S)
        self.cov[:, CLOCK, CLOCK] += 0.04 * dt
        diagonal = np.arange(EXCESS, EXCESS + links)
        self.cov[:, diagonal, diagonal] += 0.025 * dt
        for link in range(links):
            e = EXCESS + link
            dx, dy = self.mean[:, X] - self.nodes[link, 0], self.mean[:, Y] - self.nodes[link, 1]
            far = np.sqrt(dx * dx + dy * dy)
            ux, uy = dx / far, dy / far
            ph = self.cov[:, :, X] * ux[:, None] + self.cov[:, :, Y] * uy[:, None] + self.cov[:, :, CLOCK]
            s0 = ph[:, X] * ux + ph[:, Y] * uy + ph[:, CLOCK] + 1.0
            v0 = ranges[link] - far - self.mean[:, CLOCK]
            s1, v1 = s0 + 2.0 * ph[:, e] + self.cov[:, e, e], v0 - self.mean[:, e]
            late = np.where(self.blocked[:, link], stationary + (1.0 - stationary) * kept, stationary * (1.0 - kept))
            clear_part = (1.0 - OUTLIER) * (1.0 - late) * _density(v0, s0)
            late_part = (1.0 - OUTLIER) * late * _density(v1, s1)
            floor = OUTLIER / OUTLIER_SPAN_M
            total = clear_part + late_part + floor
            self.weight *= total
            drawn = self.rng.random(count) * total
            either = clear_part + late_part
            used = drawn < either
            now = (drawn >= clear_part) & (used | (drawn < either + floor * late))
            ph += np.where(now & used, 1.0, 0.0)[:, None] * self.cov[:, :, e]
            over = np.where(used, 1.0 / np.where(now, s1, s0), 0.0)
            self.mean += ph * (np.where(now, v1, v0) * over)[:, None]
            self.cov -= (ph * over[:, None])[:, :, None] * ph[:, None, :]
            clear = ~now
            self.cov[clear, e, :] = 0.0
            self.cov[clear, :, e] = 0.0
            self.cov[clear, e, e] = EXCESS_VARIANCE_M2
            self.mean[clear, e] = EXCESS_MEAN_M
            self.blocked[:, link] = now
        self.weight /= self.weight.sum()
        if 1.0 / np.sum(self.weight**2) < 0.5 * count:
            places = (np.arange(count) + self.rng.random()) / count
            index = np.minimum(np.searchsorted(np.cumsum(self.weight), places), count - 1)
            self.mean, self.cov, self.blocked = self.mean[index], self.cov[index], self.blocked[index]
            self.weight = np.full(count, 1.0 / count)


def locator(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """All frames and epochs of a walk in the order of their times."""

    def run() -> Array:
        cloud, frame = _Cloud(data), 0
        for epoch, t in enumerate(data["epoch_s"]):
            while frame + 1 < len(data["frame_s"]) and data["frame_s"][frame + 1] <= t:
                cloud.move(data["increments"][frame], data["variances"])
                frame += 1
            cloud.weigh(data["ranges"][epoch], epoch == 0)
        return np.asarray(cloud.weight @ cloud.mean[:, :2])

    return run, lambda position: [float(value) for value in position]
