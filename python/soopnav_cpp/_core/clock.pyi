"""
Oscillators, their deviations, fits to records.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "NoiseBank",
    "cell_false_alarm",
    "characterize",
    "coherence_samples",
    "coherence_time",
    "coherences",
    "crossover_s",
    "detection_probability",
    "detection_threshold",
    "deviations",
    "error_allan_variance",
    "estimate_clocks",
    "expected_coherence",
    "false_alarm_probability",
    "fit",
    "from_noise",
    "iterate_noise",
    "marcum_q",
    "mean_squared_coherence",
    "model_deviation",
    "noise",
    "phase_likelihood",
    "predetection_snr_db",
    "prediction_variance_m2",
    "preset",
    "remove_trend",
    "required_cn0_dbhz",
    "simulate",
]

class NoiseBank:
    """
    Candidate noises weighted by the likelihood of their innovations.
    """
    def __init__(
        self,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
        phase_covariance_s2: numpy.typing.ArrayLike,
        mixing: numpy.typing.ArrayLike,
        candidates: numpy.typing.ArrayLike,
        prior: numpy.typing.ArrayLike,
    ) -> None: ...
    def push(self, phase_s: numpy.typing.ArrayLike) -> int:
        """
        Epochs, one or more; how many of them were whole.
        """
    @property
    def innovations(self) -> int:
        """
        Whole epochs so far, less two.
        """
    @property
    def log_likelihoods(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of each candidate, without its prior.
        """
    @property
    def weights(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Posterior probability of each candidate.
        """

def cell_false_alarm(
    total: typing.SupportsFloat | typing.SupportsIndex, cells: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    One cell's share of a search's false alarm.
    """

def characterize(
    phase_s: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    phase_covariance_s2: numpy.typing.ArrayLike,
    mixing: numpy.typing.ArrayLike,
    clocks: numpy.typing.ArrayLike,
    estimated: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    search: bool,
) -> dict:
    """
    Noise of clocks by maximum likelihood, by name.
    """

def coherence_samples(
    phases: typing.SupportsInt | typing.SupportsIndex, per_decade: typing.SupportsInt | typing.SupportsIndex
) -> list[int]:
    """
    Numbers of samples, so many a decade.
    """

def coherence_time(
    tau_s: numpy.typing.ArrayLike,
    mean_squared: numpy.typing.ArrayLike,
    level: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, bool]:
    """
    (tau_s, beyond).
    """

def coherences(
    phase_cycles: numpy.typing.ArrayLike, samples: typing.SupportsInt | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Coherence of every window of so many phases.
    """

def crossover_s(
    h0: typing.SupportsFloat | typing.SupportsIndex, h_minus_2: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Step at which both noises add the same variance rate.
    """

def detection_probability(
    sums: typing.SupportsInt | typing.SupportsIndex,
    snr: typing.SupportsFloat | typing.SupportsIndex,
    threshold: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Of a signal's cell.
    """

def detection_threshold(
    sums: typing.SupportsInt | typing.SupportsIndex, probability: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Of one cell's false alarm.
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

def error_allan_variance(
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    phase_covariance_s2: numpy.typing.ArrayLike,
    mixing: numpy.typing.ArrayLike,
    clocks: numpy.typing.ArrayLike,
    clock: typing.SupportsInt | typing.SupportsIndex,
    factors: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    epochs: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Allan variance of a smoothed clock's error at averaging times of `factors` steps.
    """

def estimate_clocks(
    phase_s: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    phase_covariance_s2: numpy.typing.ArrayLike,
    mixing: numpy.typing.ArrayLike,
    clocks: numpy.typing.ArrayLike,
) -> tuple:
    """
    (filtered_s, filtered_sigma_s, bias_s, drift, sigma_s), each (epochs, clocks).
    """

def expected_coherence(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
    tau_s: numpy.typing.ArrayLike,
    drift_sigma: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Mean-squared coherence expected of a two-state clock.
    """

def false_alarm_probability(
    sums: typing.SupportsInt | typing.SupportsIndex, threshold: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Of one cell of noise.
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

def iterate_noise(
    phase_s: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    phase_covariance_s2: numpy.typing.ArrayLike,
    mixing: numpy.typing.ArrayLike,
    clocks: numpy.typing.ArrayLike,
    estimated: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    *,
    allan_fit: bool,
    iterations: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    History of pesyna fig. 2's iteration, (iterations + 1, clocks, 2).
    """

def marcum_q(
    m: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    a: numpy.typing.ArrayLike,
    b: numpy.typing.ArrayLike,
    complement: bool,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Generalised Marcum Q, element by element.
    """

def mean_squared_coherence(
    phase_cycles: numpy.typing.ArrayLike,
    runs: typing.SupportsInt | typing.SupportsIndex,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    samples: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    *,
    confidence: typing.SupportsFloat | typing.SupportsIndex,
    detrend: bool,
) -> tuple:
    """
    (tau_s, mean_squared, lower, upper, least, effective, count).
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

def phase_likelihood(
    phase_s: numpy.typing.ArrayLike,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    phase_covariance_s2: numpy.typing.ArrayLike,
    mixing: numpy.typing.ArrayLike,
    clocks: numpy.typing.ArrayLike,
    estimated: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
) -> tuple:
    """
    (log_likelihood, score, information, mean_nis, largest_nis, largest_at) of clocks in phase records.
    """

def predetection_snr_db(
    cn0_dbhz: typing.SupportsFloat | typing.SupportsIndex,
    tau_s: typing.SupportsFloat | typing.SupportsIndex,
    mean_squared: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    SNR after coherent integration.
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

def remove_trend(phase_cycles: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    A record without its line of least squares.
    """

def required_cn0_dbhz(
    tau_s: typing.SupportsFloat | typing.SupportsIndex,
    mean_squared: typing.SupportsFloat | typing.SupportsIndex,
    snr_db: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    The C/N0 that gives an SNR.
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
