"""NumPy's transforms for the search and SciPy's least squares for the rest: bearings from phases along a path."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]
_ANGLES = 36
_LINES = 128
_STARTS = 6


def joint(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Products against the first node, transformed over time on a grid of both bearings; then variable projection."""
    y, path, time_s = data["phasors"], data["path"], data["time"]
    wave = 2.0 * np.pi / float(data["wavelength"])
    nodes = y.shape[1]
    t = time_s - time_s.mean()
    grid = 2.0 * np.pi * np.arange(_ANGLES) / _ANGLES
    step_s = float(time_s[1] - time_s[0])
    lines = 2.0 * np.pi * np.fft.fftfreq(_LINES, step_s)

    def settled(x: Array) -> tuple[Array, Any]:
        theta = x[:nodes]
        omega, phi = np.zeros(nodes), np.zeros(nodes)
        omega[1:], phi[1:] = x[nodes : 2 * nodes - 1], x[2 * nodes - 1 :]
        eta = phi + np.outer(t, omega) + wave * path @ np.stack((np.cos(theta), np.sin(theta)))
        turned = y * np.exp(-1j * eta)
        turned = turned * np.exp(-1j * np.angle(turned.sum(axis=1)))[:, None]
        return turned.real.mean(axis=0), turned

    def residuals(x: Array) -> Array:
        amplitude, turned = settled(x)
        off = (turned - amplitude).ravel()
        return np.concatenate((off.real, off.imag))

    def run() -> Array:
        steering = np.exp(-1j * wave * path @ np.stack((np.cos(grid), np.sin(grid))))  # n, angles
        score, picks = np.zeros(_ANGLES), []
        for i in range(1, nodes):
            product = y[:, i] * y[:, 0].conj() / np.abs(y[:, 0])
            series = product[:, None, None] * steering[:, None, :] * steering[:, :, None].conj()  # n, first, other
            power = np.abs(np.fft.fft(series, _LINES, axis=0))
            best = power.reshape(_LINES, _ANGLES, _ANGLES).transpose(1, 0, 2).reshape(_ANGLES, -1)
            top = best.argmax(axis=1)
            score += best.max(axis=1) ** 2
            picks.append((lines[top // _ANGLES], grid[top % _ANGLES]))
        answer, cost = np.zeros(nodes), np.inf
        for a in np.argsort(-score)[:_STARTS]:
            theta = np.array([grid[a], *(pick[1][a] for pick in picks)])
            omega = np.array([pick[0][a] for pick in picks])
            omega = (omega + np.pi / step_s) % (2.0 * np.pi / step_s) - np.pi / step_s
            _, turned = settled(np.concatenate((theta, omega, np.zeros(nodes - 1))))
            phi = np.angle(np.sum(turned[:, 1:] * turned[:, :1].conj(), axis=0))
            found = least_squares(residuals, np.concatenate((theta, omega, phi)), xtol=1e-10, ftol=1e-10)
            if found.cost < cost:
                answer, cost = found.x[:nodes], float(found.cost)
        return np.asarray((answer + np.pi) % (2.0 * np.pi) - np.pi)

    return run, lambda found: [float(v) for v in found]
