"""Stone Soup: a bootstrap filter of its predictor, updater and systematic resampler."""

# Names and signatures are the package's.
# ruff: noqa: ARG002

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import numpy.typing as npt
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

Data = dict[str, npt.NDArray[Any]]
Array = npt.NDArray[np.float64]


def bootstrap(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`ParticlePredictor` and `ParticleUpdater` for each step, the mean after the last resampling."""
    count, dt = int(data["particles"]), float(data["dt"])
    sigma_a, sigma_b, sigma_z = (float(data[name]) for name in ("sigma_a", "sigma_b", "sigma_z"))
    nodes = data["nodes"]
    F = np.eye(5)
    F[0, 2] = F[1, 3] = dt
    half = 0.5 * dt * dt
    drive = np.array([[half, 0, 0], [0, half, 0], [dt, 0, 0], [0, dt, 0], [0, 0, 1.0]]) * [sigma_a, sigma_a, sigma_b]

    class Ranges(NonLinearGaussianMeasurement):  # type: ignore[misc]
        """Four ranges, each with the clock."""

        @property
        def ndim_meas(self) -> int:
            return len(nodes)

        def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
            x = np.asarray(state.state_vector)
            places = np.stack([np.hypot(x[0] - qx, x[1] - qy) + x[4] for qx, qy in nodes])
            return places.view(StateVectors)

    measure = Ranges(ndim_state=5, mapping=(0, 1, 4), noise_covar=sigma_z**2 * np.eye(len(nodes)))
    motion = LinearGaussianTimeInvariantTransitionModel(transition_matrix=F, covariance_matrix=drive @ drive.T)
    start = datetime(2000, 1, 1)

    def run() -> Any:
        rng = np.random.default_rng(5)
        predictor, updater = ParticlePredictor(motion), ParticleUpdater(measure, SystematicResampler())
        drawn = data["x0"][:, None] + data["sigma0"][:, None] * rng.standard_normal((5, count))
        cloud = ParticleState(StateVectors(drawn), weight=np.full(count, 1.0 / count), timestamp=start)
        for k, z in enumerate(data["z"]):
            now = start + timedelta(seconds=dt * (k + 1))
            predicted = predictor.predict(cloud, timestamp=now)
            seen = Detection(StateVector(z), timestamp=now, measurement_model=measure)
            cloud = updater.update(SingleHypothesis(predicted, seen))
        return cloud

    def answer(cloud: Any) -> list[float]:
        return [float(value) for value in np.asarray(cloud.mean).ravel()]

    return run, answer
