"""Clocks: oscillators of two states, simulation, Allan deviations, fits to records, coherence.

A clock is `TwoState`: by the coefficients h0 and h-2 of its fractional-frequency noise. Filters take it as it is,
``process.NearlyConstantVelocity(0.1, clock=TwoState.tcxo())``. Biases are in seconds here, positive when the clock is
ahead, and in metres (c times that) in filters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._characterization import (
    Characterization,
    ClockEstimates,
    PhaseScore,
    characterize,
    error_allan_variance,
    estimate_clocks,
    iterate_noise,
    noise_likelihood,
)
from soopnav_cpp._coherence import (
    Coherence,
    CoherenceTime,
    coherence,
    coherence_time,
    expected_coherence,
    mean_squared_coherence,
    predetection_snr_db,
    required_cn0_dbhz,
)
from soopnav_cpp._core import clock as _clock
from soopnav_cpp._noise_bank import NoiseBank

__all__ = [
    "Characterization",
    "ClockEstimates",
    "ClockNoise",
    "ClockSeries",
    "Coherence",
    "CoherenceTime",
    "Deviations",
    "FittedClock",
    "NoiseBank",
    "PhaseScore",
    "TwoState",
    "allan_deviation",
    "characterize",
    "coherence",
    "coherence_time",
    "error_allan_variance",
    "estimate_clocks",
    "expected_coherence",
    "fit",
    "iterate_noise",
    "mean_squared_coherence",
    "noise_likelihood",
    "predetection_snr_db",
    "required_cn0_dbhz",
]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0

Kind = Literal["overlapping", "allan", "modified", "time", "hadamard", "overlapping_hadamard"]
Noise = Literal["white_phase", "flicker_phase", "white_frequency", "flicker_frequency", "random_walk_frequency"]


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


class ClockNoise(NamedTuple):
    """Power densities of a two-state clock, times c² so that clocks are in metres.

    Attributes
    ----------
    white_frequency_m2ps : float
        S_f, of the bias' random walk [m²/s].
    frequency_walk_m2ps3 : float
        S_g, of the drift's random walk [m²/s³].
    """

    white_frequency_m2ps: float
    frequency_walk_m2ps3: float


@dataclass(frozen=True)
class ClockSeries:
    """A clock along time; arrays are read-only.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    bias_m : ndarray, shape (n,)
        c times the time error, positive when the clock is ahead.
    drift : ndarray, shape (n,)
        Fractional frequency offset, dimensionless.
    """

    t_s: _Array
    bias_m: _Array
    drift: _Array

    @property
    def bias_s(self) -> _Array:
        """Time error, shape (n,)."""
        return _read_only(self.bias_m / _LIGHT_MPS)

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        if not len(self):
            return "ClockSeries(empty)"
        return f"ClockSeries({len(self)} times to {self.t_s[-1]:g} s, ends {self.bias_m[-1] / _LIGHT_MPS:+.3g} s off)"


@dataclass(frozen=True)
class TwoState:
    """An oscillator: fractional-frequency noise S_y(f) = h0 + h-1/f + h-2/f².

    Parameters
    ----------
    h0 : float
        White frequency noise [s], not negative.
    h_minus_2 : float
        Random walk of frequency [Hz], not negative.
    h_minus_1 : float
        Flicker of frequency: reported, not modelled, for no finite number of states has it.

    Raises
    ------
    ValueError
        For a coefficient that is negative or not finite.
    """

    h0: float
    h_minus_2: float
    h_minus_1: float = 0.0

    def __post_init__(self) -> None:
        _clock.noise(self.h0, self.h_minus_2)
        if not (self.h_minus_1 >= 0.0 and math.isfinite(self.h_minus_1)):
            raise ValueError(f"h_minus_1 = {self.h_minus_1} must be finite and >= 0")

    @classmethod
    def _preset(cls, name: str) -> TwoState:
        return TwoState(*_clock.preset(name))

    @classmethod
    def tcxo(cls) -> TwoState:
        """Temperature-compensated crystal of a receiver: 1e-20, 1e-22 (pesyna)."""
        return cls._preset("tcxo")

    @classmethod
    def ocxo(cls) -> TwoState:
        """Oven-controlled crystal of a receiver: 1e-23, 1e-25 (pesyna; better than most on sale)."""
        return cls._preset("ocxo")

    @classmethod
    def csac(cls) -> TwoState:
        """Chip-scale atomic clock: Allan deviation 3e-10/√τ, a data sheet's limit, and a random walk of 1e-11 a day."""
        return cls._preset("csac")

    @classmethod
    def gps(cls) -> TwoState:
        """Rubidium of a GPS satellite: 3e-12/√τ and a flicker floor of 5e-14 (Block IIR), reached after a day."""
        return cls._preset("gps")

    @classmethod
    def basestation(cls) -> TwoState:
        """The steadier of two cellular basestations: 3e-25, 3e-27 (pesyna)."""
        return cls._preset("basestation")

    @classmethod
    def crosby(cls) -> TwoState:
        """The transmitters' clock of crosby fig. 3.4: S_f = 0.036 (m/s)²/Hz, S_g = 0.141 (m/s²)²/Hz."""
        return cls._preset("crosby")

    @classmethod
    def from_noise(cls, white_frequency_m2ps: float, frequency_walk_m2ps3: float) -> TwoState:
        """The clock with these power densities: the inverse of `noise`."""
        return TwoState(*_clock.from_noise(white_frequency_m2ps, frequency_walk_m2ps3))

    @property
    def noise(self) -> ClockNoise:
        """Power densities (S_f, S_g) in metres: what filters take as `clock`."""
        return ClockNoise(*_clock.noise(self.h0, self.h_minus_2))

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.noise, dtype)

    @property
    def crossover_s(self) -> float:
        """Step at which both noises add the same variance rate: a record of about it shows both. May be infinite."""
        return _clock.crossover_s(self.h0, self.h_minus_2)

    def allan_deviation(self, tau_s: npt.ArrayLike) -> _Array:
        """Allan deviation of the model, √(h0/(2τ) + 2π²h-2 τ/3).

        Parameters
        ----------
        tau_s : float or array_like
            Positive.

        Returns
        -------
        ndarray, of tau_s's shape
        """
        tau = np.asarray(tau_s, np.float64)
        return np.reshape(_clock.model_deviation(self.h0, self.h_minus_2, tau.ravel()), tau.shape)

    def prediction_variance_m2(self, tau_s: float, covariance: npt.ArrayLike | None = None) -> float:
        """Variance of the bias `tau_s` ahead [m²].

        Parameters
        ----------
        tau_s : float
            Not negative.
        covariance : array_like, shape (2, 2), optional
            Of bias [m] and drift [m/s] now; zero by default.
        """
        return _clock.prediction_variance_m2(self.h0, self.h_minus_2, tau_s, covariance)

    def simulate(
        self, dt_s: float, count: int, *, seed: int, stream: int = 0, bias_s: float = 0.0, drift: float = 0.0
    ) -> ClockSeries:
        """Run the clock; exact for any step.

        Parameters
        ----------
        dt_s : float
            Positive.
        count : int
            Times, the first of which is 0.
        seed, stream : int
            Name the noise; streams of one seed are independent.
        bias_s, drift : float
            At the start.

        Returns
        -------
        ClockSeries
        """
        if not (dt_s > 0.0 and math.isfinite(dt_s)):
            raise ValueError(f"dt_s = {dt_s} must be positive and finite")
        if count < 0:
            raise ValueError(f"count = {count} must not be negative")
        return self.simulate_at(dt_s * np.arange(count), seed=seed, stream=stream, bias_s=bias_s, drift=drift)

    def simulate_at(
        self, t_s: npt.ArrayLike, *, seed: int, stream: int = 0, bias_s: float = 0.0, drift: float = 0.0
    ) -> ClockSeries:
        """Run the clock along times of one's own, which do not fall; otherwise as `simulate`.

        Parameters
        ----------
        t_s : array_like, shape (n,)
            `bias_s` and `drift` are those at the first.
        """
        times = np.array(t_s, np.float64)
        bias_m, rate = _clock.simulate(
            self.h0, self.h_minus_2, times, bias_s=bias_s, drift=drift, seed=seed, stream=stream
        )
        return ClockSeries(_read_only(times), _read_only(bias_m), _read_only(rate))


@dataclass(frozen=True)
class FittedClock(TwoState):
    """A clock that fits a record.

    A coefficient that the record does not show is 0, and its sigma the value up to which the record would hardly
    object (a log-likelihood lower by 1/2). A sigma is infinite where a few phases do not bound it.

    Attributes
    ----------
    sigma_h0, sigma_h_minus_2 : float
        Standard deviations [s], [Hz].
    correlation : float
        Of the errors of log h0 and log h-2.
    phase_noise_s : float
        Standard deviation of the readings' white noise; 0 unless asked for.
    log_likelihood : float
    """

    sigma_h0: float = 0.0
    sigma_h_minus_2: float = 0.0
    correlation: float = 0.0
    phase_noise_s: float = 0.0
    log_likelihood: float = 0.0

    def __repr__(self) -> str:
        noise = f", phase noise {self.phase_noise_s:.3g} s" if self.phase_noise_s else ""
        return (
            f"FittedClock(h0 = {self.h0:.3g} ± {self.sigma_h0:.2g} s, "
            f"h-2 = {self.h_minus_2:.3g} ± {self.sigma_h_minus_2:.2g} Hz{noise})"
        )


@dataclass(frozen=True)
class Deviations:
    """Deviations of a record, one for each averaging time; arrays of shape (n,), read-only.

    Attributes
    ----------
    tau_s, deviation : ndarray
        The deviation is dimensionless; in seconds for the time deviation.
    lower, upper : ndarray
        Confidence interval.
    dof : ndarray
        Equivalent degrees of freedom.
    count : ndarray of int64
        Terms averaged.
    alpha : ndarray of int32
        Power law that the interval supposes, S_y ~ f^alpha: 2 white phase ... -2 random walk of frequency.
    kind : str
    """

    tau_s: _Array
    deviation: _Array
    lower: _Array
    upper: _Array
    dof: _Array
    count: npt.NDArray[np.int64]
    alpha: npt.NDArray[np.int32]
    kind: str

    def __len__(self) -> int:
        return len(self.tau_s)

    def __repr__(self) -> str:
        if not len(self):
            return f"Deviations({self.kind}, none)"
        first, last = f"{self.tau_s[0]:g}", f"{self.tau_s[-1]:g}"
        return f"Deviations({self.kind}, {len(self)} from {first} to {last} s, {self.deviation[0]:.3g} at {first} s)"


def allan_deviation(
    data: npt.ArrayLike,
    dt_s: float,
    *,
    kind: Kind = "overlapping",
    taus: Literal["octave", "decade", "all"] | npt.ArrayLike = "octave",
    frequency: bool = False,
    confidence: float = 0.683,
    noise: Noise | None = None,
) -> Deviations:
    """Deviations of a clock from a record (NIST SP 1065).

    Parameters
    ----------
    data : array_like, shape (n,)
        Phase: the clock's time error [s] every `dt_s`; or fractional frequency, means over `dt_s`. NaN is a gap.
    dt_s : float
        Positive.
    kind : {"overlapping", "allan", "modified", "time", "hadamard", "overlapping_hadamard"}
    taus : {"octave", "decade", "all"} or array_like
        Averaging times; multiples of `dt_s`. Those too long for the record are left out.
    frequency : bool
        Whether `data` is frequency.
    confidence : float
        Of the interval, between 0 and 1.
    noise : str, optional
        Power law that the interval supposes: "white_phase", "flicker_phase", "white_frequency", "flicker_frequency" or
        "random_walk_frequency". Found for each averaging time when not given.

    Returns
    -------
    Deviations

    Raises
    ------
    ValueError
        For infinite data, averaging times that are no multiples, or an unknown name.
    """
    *columns, count, alpha = _clock.deviations(
        np.asarray(data, np.float64),
        dt_s,
        kind=kind,
        taus=taus,
        frequency=frequency,
        confidence=confidence,
        noise=noise,
    )
    tau_s, deviation, lower, upper, dof = (_read_only(column) for column in columns)
    return Deviations(tau_s, deviation, lower, upper, dof, _read_only(count), _read_only(alpha), kind)


def fit(phase_s: npt.ArrayLike, dt_s: float, *, phase_noise: bool = False) -> FittedClock:
    """Fit a two-state clock to a record of phase by maximum likelihood.

    Parameters
    ----------
    phase_s : array_like, shape (n,)
        The clock's time error every `dt_s`; at least 8 numbers. NaN is a gap.
    dt_s : float
        Positive. Both coefficients show when it is near the clock's `crossover_s`, or below by less than √n.
    phase_noise : bool
        Estimate white noise of the readings as well. Real records have it.

    Returns
    -------
    FittedClock

    Raises
    ------
    ValueError
        For infinite phases, too few, or phases on a straight line.
    """
    h0, h_minus_2, sigma_h0, sigma_h_minus_2, correlation, sigma_s, likelihood = _clock.fit(
        np.asarray(phase_s, np.float64), dt_s, phase_noise=phase_noise
    )
    return FittedClock(h0, h_minus_2, 0.0, sigma_h0, sigma_h_minus_2, correlation, sigma_s, likelihood)
