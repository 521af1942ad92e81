"""What the particle filters of nielsen 3.3 are held against: exact posteriors and Kalman filters of the same models.

The linear models are exact: `soopnav_cpp.estimation.linear_filter` gives their posterior. Ranges in a room are not
linear; there the filter is linearised about the truth, so it is spared
the search that a filter in use begins with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp.experiments.nielsen_setups import Crossing, RoomBias, Smooth, Step, Still

__all__ = ["Moments", "crossing", "room_bias", "smooth", "step_response", "still"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """Posterior of a run, one row per step.

    Attributes
    ----------
    mean : ndarray, shape (steps, n)
    sigma : ndarray, shape (steps, n)
    """

    mean: Array
    sigma: Array


def _uniform(low_high: tuple[float, float]) -> tuple[float, float]:
    """Mean and variance of a uniform variable."""
    low, high = low_high
    return 0.5 * (low + high), (high - low) ** 2 / 12.0


def _kalman(F: Array, Q: Array, H: Array, R: Array, z: Array, x0: Array, P0: Array) -> Moments:
    run = estimation.linear_filter(F, Q, H, R, z, x0, P0)
    return Moments(np.asarray(run.x), np.sqrt(np.diagonal(np.asarray(run.P), axis1=1, axis2=2)))


def still(setup: Still, z: Array) -> Moments:
    """Exact posterior of PF1: the mean of k ranges, sigma / √k wide, cut off where the uniform prior ends.

    Mean and variance of a normal variable between two bounds; n = 1.
    """
    low, high = setup.prior_m
    mean, sigma = np.empty((len(z), 1)), np.empty((len(z), 1))
    for k in range(1, len(z) + 1):
        centre, width = float(np.mean(z[:k])), setup.sigma_z_m / math.sqrt(k)
        a, b = (low - centre) / width, (high - centre) / width
        inside = 0.5 * (math.erf(b / math.sqrt(2.0)) - math.erf(a / math.sqrt(2.0)))
        fa, fb = (math.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi) for t in (a, b))
        shift = (fa - fb) / inside
        mean[k - 1] = centre + width * shift
        sigma[k - 1] = width * math.sqrt(1.0 + (a * fa - b * fb) / inside - shift * shift)
    return Moments(mean, sigma)


def step_response(setup: Step, sigma_m: float, z: Array) -> Moments:
    """Kalman filter of PF2's random walk with `sigma_m` per step; n = 1. Its prior is that of PF2 but Gaussian."""
    mean, variance = _uniform(setup.prior_m)
    one = np.eye(1)
    return _kalman(one, sigma_m**2 * one, one, setup.sigma_z_m**2 * one, z[:, None], np.array([mean]), variance * one)


def room_bias(setup: RoomBias, z: Array) -> Moments:
    """Kalman filter of PF4 linearised about the truth; n = 3: x, y, b."""
    receiver = np.array(setup.receiver_m)
    away = receiver - setup.nodes_m
    ranges = np.linalg.norm(away, axis=1)
    H = np.column_stack([away / ranges[:, None], np.ones(len(ranges))])
    truth = np.array([*receiver, setup.bias_m])
    mean, variance = _uniform(setup.prior_m)
    error = _kalman(
        np.eye(3),
        np.diag(np.square(setup.sigma_step_m)),
        H,
        setup.sigma_z_m**2 * np.eye(len(ranges)),
        z - ranges - setup.bias_m,
        mean - truth,
        variance * np.eye(3),
    )
    return Moments(truth + error.mean, error.sigma)


def smooth(setup: Smooth, z: Array) -> Moments:
    """Kalman filter of Fig. 34, exact; n = 2: x, v."""
    drive = np.array([1.0, 1.0])  # the place moves by the new velocity
    return _kalman(
        np.array([[1.0, 1.0], [0.0, 1.0]]),
        setup.sigma_v_mps**2 * np.outer(drive, drive),
        np.array([[1.0, 0.0]]),
        setup.sigma_z_m**2 * np.eye(1),
        z[:, None],
        np.array(setup.x0),
        np.zeros((2, 2)),
    )


def crossing(setup: Crossing, z: Array, *, sigma_z_m: float | None = None) -> Moments:
    """Kalman filter of PF5 linearised about the truth; n = 5: x, y, vx, vy, b.

    `sigma_z_m` is what the filter assumes of the ranges, the listing's 0.6 m when left out.
    """
    sigma = setup.sigma_weight_m if sigma_z_m is None else sigma_z_m
    truth = setup.truth()
    away = truth[:, None, :2] - setup.nodes_m
    ranges = np.linalg.norm(away, axis=2)
    steps, nodes = ranges.shape
    H = np.zeros((steps, nodes, 5))
    H[:, :, :2] = away / ranges[:, :, None]
    H[:, :, 4] = 1.0
    F = np.eye(5)
    F[0, 2] = F[1, 3] = 1.0
    x_mean, x_variance = _uniform(setup.x_prior_m)
    start = np.array([x_mean, 0.5 * setup.depth_m, *setup.mean_v0_mps, 0.0])
    variances = [x_variance, setup.sigma_y0_m**2, setup.sigma_v0_mps**2, setup.sigma_v0_mps**2, 0.0]
    vx, vy = setup.velocity_mps
    before = np.array([0.0, 0.5 * setup.depth_m, vx, vy, setup.bias_m])  # the truth moves as the model does
    error = _kalman(
        F,
        np.diag([0.0, 0.0, setup.variance_v, setup.variance_v, setup.variance_b]),
        H,
        sigma**2 * np.eye(nodes),
        z - ranges - truth[:, 4:],
        start - before,
        np.diag(variances),
    )
    return Moments(truth + error.mean, error.sigma)
