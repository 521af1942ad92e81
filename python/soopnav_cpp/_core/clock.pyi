"""
Oscillators, their deviations, fits to records.
"""

from __future__ import annotations
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "crossover_s",
    "deviations",
    "fit",
    "from_noise",
    "model_deviation",
    "noise",
    "prediction_variance_m2",
    "preset",
    "simulate",
]

def crossover_s(
    h0: typing.SupportsFloat | typing.SupportsIndex, h_minus_2: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Step at which both noises add the same variance rate.
    """

def deviations(
    data: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    kind: str,
    taus: typing.Any,
    frequency: bool,
    confidence: typing.SupportsFloat | typing.SupportsIndex,
    noise: str | None,
) -> tuple:
    """
    (tau_s, deviation, lower, upper, dof, count, alpha) of a record.
    """

def fit(
    phase_s: numpy.typing.ArrayLike, dt_s: typing.SupportsFloat | typing.SupportsIndex, *, phase_noise: bool
) -> tuple[float, float, float, float, float, float, float]:
    """
    (h0, h_minus_2, sigma_h0, sigma_h_minus_2, correlation, phase_noise_s, log_likelihood).
    """

def from_noise(
    white_frequency_m2ps: typing.SupportsFloat | typing.SupportsIndex,
    frequency_walk_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (h0, h_minus_2, 0) of power densities.
    """

def model_deviation(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    tau_s: numpy.typing.ArrayLike,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Allan deviation of the two-state model.
    """

def noise(
    h0: typing.SupportsFloat | typing.SupportsIndex, h_minus_2: typing.SupportsFloat | typing.SupportsIndex
) -> tuple[float, float]:
    """
    Power densities (S_f, S_g) in metres.
    """

def prediction_variance_m2(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    tau_s: typing.SupportsFloat | typing.SupportsIndex,
    covariance: numpy.typing.ArrayLike | None = None,
) -> float:
    """
    Variance of the bias tau_s ahead.
    """

def preset(name: str) -> tuple:
    """
    A named oscillator: (h0, h_minus_2, h_minus_1).
    """

def simulate(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    t_s: numpy.typing.ArrayLike,
    *,
    bias_s: typing.SupportsFloat | typing.SupportsIndex,
    drift: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex,
) -> tuple:
    """
    Bias in metres and dimensionless drift at times.
    """
