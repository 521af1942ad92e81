"""A cart at nearly constant velocity, ranged from known places: the system that the tests of the runner use.

A module of its own, for it has to be imported in other processes as well.
"""

from __future__ import annotations

import multiprocessing
import os
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from soopnav_cpp import estimation, measurement, process
from soopnav_cpp.config import InputFile, Model, Vector3
from soopnav_cpp.scenarios import Scenario, SystemRun, Truth, Updates


class Anchor(Model):
    """A place that ranges.

    Attributes
    ----------
    name : str
    position_m : three floats
        East, north, up; the height is not used.
    """

    name: str
    position_m: Vector3


class CartScenario(Scenario):
    """Keys of the cart.

    Attributes
    ----------
    sigma_m : float
        Standard deviation of a range.
    stated_sigma_m : float, optional
        What the filter believes instead.
    outlier_share : float
        Share of ranges that are 60 m too long.
    rate_hz : float
    fail_run_seeds : list of int
        Seeds that fail.
    die_run_seeds : list of int
        Seeds that end the process they run in, when it is not the first.
    truth : bool
        Whether it is known.
    recording : file, optional
    """

    sigma_m: Annotated[float, Field(gt=0.0)]
    stated_sigma_m: Annotated[float, Field(gt=0.0)] | None = None
    outlier_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    rate_hz: Annotated[float, Field(gt=0.0)] = 4.0
    fail_run_seeds: list[int] = Field(default_factory=list)
    die_run_seeds: list[int] = Field(default_factory=list)
    truth: bool = True
    recording: InputFile | None = None
    anchors: Annotated[list[Anchor], Field(min_length=2)]


class Cart:
    name = "cart"
    title = "a cart ranged from known places"
    scenario = CartScenario
    example = """\
system = "cart"
title = "A cart among three anchors"
duration_s = 60.0
sigma_m = 2.0
[[anchors]]
name = "A"
position_m = [120.0, 0.0, 0.0]
[[anchors]]
name = "B"
position_m = [-80.0, 150.0, 0.0]
[[anchors]]
name = "C"
position_m = [0.0, -140.0, 0.0]
"""

    def run(self, scenario: CartScenario, seed: int) -> SystemRun:
        if seed in scenario.fail_run_seeds:
            raise RuntimeError("the cart broke down")
        if seed in scenario.die_run_seeds and multiprocessing.parent_process() is not None:
            os._exit(3)
        rng = np.random.default_rng(seed)
        dt, psd = 1.0 / scenario.rate_hz, 0.05
        n = round(scenario.duration_s * scenario.rate_hz)
        t = dt * np.arange(1, n + 1)
        F = np.array([[1.0, dt], [0.0, 1.0]])
        L = np.linalg.cholesky(psd * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
        P0 = np.diag([9.0, 9.0, 1.0, 1.0])
        x0 = np.array([5.0, -3.0, 1.0, 0.5])
        x = np.empty((n, 2, 2))  # step, axis, position and velocity
        now = (x0 + rng.normal(size=4) * np.sqrt(np.diag(P0))).reshape(2, 2).T
        for k in range(n):
            now = now @ F.T + rng.normal(size=(2, 2)) @ L.T
            x[k] = now
        places = np.array([anchor.position_m[:2] for anchor in scenario.anchors])
        z = np.linalg.norm(x[:, None, :, 0] - places, axis=2) + scenario.sigma_m * rng.normal(size=(n, len(places)))
        z += 60.0 * (rng.random(z.shape) < scenario.outlier_share)
        ekf = estimation.ExtendedKalmanFilter("position_velocity2", x0, P0)
        drift = process.NearlyConstantVelocity(psd)
        models = [measurement.Range(place) for place in places]
        variance = (scenario.stated_sigma_m or scenario.sigma_m) ** 2
        state, covariance, rows = np.empty((n, 4)), np.empty((n, 4, 4)), []
        for k in range(n):
            ekf.predict(drift, dt)
            for i, model in enumerate(models):
                report = ekf.update(model, z[k, i], variance, gate_nis=16.0)
                S = float(report.covariance[0, 0])
                rows.append((t[k], i, report.innovation[0], S, report.status, 4.0 * np.sqrt(S)))
            state[k], covariance[k] = ekf.x, ekf.P
        when, source, innovation, S, status, gate = zip(*rows, strict=True)
        right = np.concatenate([x[:, :, 0], x[:, :, 1]], axis=1)
        known: dict[str, Any] = {}
        if scenario.truth:
            known["truth"] = Truth(position_m=right[:, :2], velocity_mps=right[:, 2:], state=right)
        return SystemRun(
            t_s=t,
            position_m=state[:, :2],
            position_covariance_m2=covariance[:, :2, :2],
            velocity_mps=state[:, 2:],
            state_names=("x_m", "y_m", "vx_mps", "vy_mps"),
            state=state,
            covariance=covariance,
            updates=Updates(
                t_s=when, source=np.array(source), innovation=innovation, variance=S, status=status, gate=gate,
                source_names=tuple(anchor.name for anchor in scenario.anchors),
            ),
            baselines={"dead reckoning": x0[:2] + t[:, None] * x0[2:]},
            sources={anchor.name: anchor.position_m[:2] for anchor in scenario.anchors},
            notes=("Ranges are made up",),
            **known,
        )  # fmt: skip
