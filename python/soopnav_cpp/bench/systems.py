"""The systems that the benchmarks run, as arrays: every side of a case gets the same ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["fourteen_states", "planar_ins", "range_cloud", "run_kalman", "simulate"]

Array = npt.NDArray[np.float64]


def fourteen_states() -> dict[str, Array]:
    """A linear system of 14 states and 4 measurements that punishes a careless covariance update.

    Three axes of position, velocity and decaying acceleration at 10 Hz, a bias each, and a clock of bias and drift.
    Measured are position + bias + clock of each axis, and a difference of two positions + clock.

    Returns
    -------
    dict
        F (14, 14), Q (14, 14), H (4, 14), R (4, 4), x0 (14,), P0 (14, 14); the last two before the first predict.
    """
    dt, jerk = 0.1, 0.3
    axis = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 0.98]])
    drive = jerk * np.array([0.5 * dt * dt, dt, 1.0])
    F, Q = np.eye(14), 1e-9 * np.eye(14)
    for first in (0, 3, 6):
        block = slice(first, first + 3)
        F[block, block] = axis
        Q[block, block] += np.outer(drive, drive)
    F[12, 13] = dt
    Q[range(9, 14), range(9, 14)] += [1e-4, 1e-4, 1e-4, 1e-3, 1e-5]
    H = np.zeros((4, 14))
    for row in range(3):
        H[row, [3 * row, 9 + row, 12]] = 1.0
    H[3, [0, 3, 12]] = 1.0, -1.0, 1.0
    return {
        "F": F,
        "Q": Q,
        "H": H,
        "R": np.diag([4.0, 4.0, 4.0, 9.0]),
        "x0": np.zeros(14),
        "P0": 25.0 * np.eye(14),
    }


def simulate(system: dict[str, Array], steps: int, seed: int) -> Array:
    """Measurements of a linear system that starts at a draw of its prior; shape (steps, m)."""
    rng = np.random.default_rng(seed)
    F, H = system["F"], system["H"]
    root_q, root_r, root_p = (np.linalg.cholesky(system[name]) for name in ("Q", "R", "P0"))
    x = system["x0"] + root_p @ rng.standard_normal(len(F))
    z = np.empty((steps, len(H)))
    for k in range(steps):
        x = F @ x + root_q @ rng.standard_normal(len(F))
        z[k] = H @ x + root_r @ rng.standard_normal(len(H))
    return z


def run_kalman(system: dict[str, Array], z: Array) -> dict[str, Array]:
    """Kalman filter in Joseph's form, by NumPy: what a smoother is given.

    Returns
    -------
    dict
        x_pred and x (steps, n), P_pred and P (steps, n, n).
    """
    F, Q, H, R = (system[name] for name in ("F", "Q", "H", "R"))
    n = len(F)
    x, P = system["x0"], system["P0"]
    shapes: dict[str, tuple[int, ...]] = {"x_pred": (n,), "P_pred": (n, n), "x": (n,), "P": (n, n)}
    run = {name: np.empty((len(z), *shape)) for name, shape in shapes.items()}
    for k, measured in enumerate(z):
        x, P = F @ x, F @ P @ F.T + Q
        run["x_pred"][k], run["P_pred"][k] = x, P
        S = H @ P @ H.T + R
        K = np.linalg.solve(S, H @ P).T
        x = x + K @ (measured - H @ x)
        A = np.eye(n) - K @ H
        P = A @ P @ A.T + K @ R @ K.T
        P = 0.5 * (P + P.T)
        run["x"][k], run["P"][k] = x, P
    return run


def planar_ins(seed: int = 1) -> dict[str, Array]:
    """A planar INS with range differences: 6000 steps of 20 ms, three transmitters heard each second.

    State [theta vx vy x y]; theta += w dt, v += C(theta) f dt, p += v dt with the v before; what is heard is how much
    nearer each transmitter is than at the start, ``z = |p0 − q| − |p − q|``.

    Returns
    -------
    dict
        u (6000, 3) of turn rate and specific force; z (120, 3), one row after every 50 steps; dt ();
        transmitters (3, 2); p0 (2,); Q (5, 5) per step; R (3, 3); x0 (5,); P0 (5, 5).
    """
    rng = np.random.default_rng(seed)
    dt, steps, every = 0.02, 6000, 50
    t = dt * np.arange(steps)
    u = np.stack([0.05 * np.sin(0.11 * t), 0.2 * np.cos(0.07 * t), 0.12 * np.sin(0.05 * t)], axis=1)
    transmitters = np.array([[3000.0, 1000.0], [-2000.0, 4000.0], [500.0, -3500.0]])
    theta, v, p = 0.1, np.array([9.0, 1.0]), np.zeros(2)
    z = []
    for k in range(steps):
        c, s = np.cos(theta), np.sin(theta)
        force = np.array([c * u[k, 1] - s * u[k, 2], s * u[k, 1] + c * u[k, 2]])
        p = p + v * dt
        v = v + force * dt
        theta += u[k, 0] * dt
        if (k + 1) % every == 0:
            z.append(np.linalg.norm(transmitters, axis=1) - np.linalg.norm(p - transmitters, axis=1))
    u += np.array([0.03, 0.1, 0.1]) * rng.standard_normal(u.shape)
    heard = np.array(z) + 5.0 * rng.standard_normal((steps // every, 3))
    return {
        "u": u,
        "z": heard,
        "dt": np.array(dt),
        "transmitters": transmitters,
        "p0": np.zeros(2),
        "Q": np.diag([1e-6, 1e-3, 1e-3, 1e-6, 1e-6]),
        "R": 25.0 * np.eye(3),
        "x0": np.array([0.1, 9.0, 1.0, 0.0, 0.0]),
        "P0": np.diag([0.0025, 1.0, 1.0, 0.01, 0.01]),
    }


def range_cloud(particles: int, steps: int, seed: int = 1) -> dict[str, Array]:
    """A receiver with an unknown clock among four nodes, for a bootstrap filter.

    State [x y vx vy b]. Each step draws an acceleration per axis, constant over the step, and a step of the clock:
    ``p += v dt + a dt²/2``, ``v += a dt``, ``b += w``. What is measured are the four ranges, each with b.

    Returns
    -------
    dict
        z (steps, 4); nodes (4, 2); dt (); sigma_a, sigma_b, sigma_z (): per step; x0 (5,) and sigma0 (5,): a Gaussian
        prior before the first step; particles (): how many.
    """
    rng = np.random.default_rng(seed)
    dt, sigma_a, sigma_b, sigma_z = 1.0, 0.5, 0.3, 1.0
    nodes = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
    x0, sigma0 = np.array([30.0, 60.0, 1.0, -0.5, 5.0]), np.array([1.0, 1.0, 0.5, 0.5, 1.0])
    state = x0 + sigma0 * rng.standard_normal(5)
    z = np.empty((steps, 4))
    for k in range(steps):
        a, w = sigma_a * rng.standard_normal(2), sigma_b * rng.standard_normal()
        state = state + np.array([*(state[2:4] * dt + 0.5 * a * dt * dt), *(a * dt), w])
        z[k] = np.linalg.norm(state[:2] - nodes, axis=1) + state[4] + sigma_z * rng.standard_normal(4)
    scalars = {"dt": dt, "sigma_a": sigma_a, "sigma_b": sigma_b, "sigma_z": sigma_z, "particles": float(particles)}
    return {"z": z, "nodes": nodes, "x0": x0, "sigma0": sigma0} | {k: np.array(v) for k, v in scalars.items()}
