"""Delay and Doppler between two recordings of one unknown signal."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import dsp as _dsp
from soopnav_cpp._core.dsp import AmbiguityStatus

__all__ = [
    "AmbiguityStatus",
    "CrossAmbiguityResult",
    "Surface",
    "TdoaFdoaBound",
    "ambiguity_surface",
    "cross_ambiguity",
    "tdoa_fdoa_crlb",
]

Prefilter = Literal["none", "box", "rrc", "ml"]
Shape = Literal["flat", "rrc"]
_Iq = npt.NDArray[np.complex64]
_Array = npt.NDArray[np.float64]

_PREFILTERS = {
    "none": _dsp.AmbiguityPrefilter.NONE,
    "box": _dsp.AmbiguityPrefilter.BOX,
    "rrc": _dsp.AmbiguityPrefilter.RRC,
    "ml": _dsp.AmbiguityPrefilter.ML,
}


def _seconds(value: float) -> str:
    """``-1.234 µs``: a short time with a fitting unit."""
    size = abs(value)
    for scale, unit in ((1e-6, "ns"), (1e-3, "µs"), (1.0, "ms")):
        if size < scale:
            return f"{value / scale * 1e3:.4g} {unit}"
    return f"{value:.4g} s"


@dataclass(frozen=True)
class CrossAmbiguityResult:
    """Delay and Doppler of recording `a` against recording `b`.

    Attributes
    ----------
    status : AmbiguityStatus
        ``OK``, or why there is no measurement.
    tdoa_s : float
        Arrival in `a` minus arrival in `b`: positive when `a` is later. Both recordings start at the same instant.
    fdoa_hz : float
        Frequency in `a` minus frequency in `b`: positive when `a` is higher.
    sigma_tdoa_s, sigma_fdoa_hz : float
        Standard deviations from the coherence measured; infinite unless the status is ``OK``.
    covariance : ndarray, shape (2, 2)
        Of ``[tdoa_s, fdoa_hz]``, s² and Hz².
    tdoa_rate, sigma_tdoa_rate : float
        Change of the delay [s/s] that was taken out, and its spread when it was estimated (else infinite).
    phase_rad : float
        Of `a` against `b` at `epoch_s`.
    epoch_s : float
        Instant in `b`, from its first sample, that delay and Doppler hold for: the middle of the burst.
    start_s, duration_s : float
        The burst in `b`, from its first sample.
    center_a_hz, center_b_hz, bandwidth_hz : float
        The signal's band in either recording, relative to its centre frequency; the FDOA is that of the frequency
        `center_b_hz`.
    snr_db, threshold_db : float
        Post-correlation: the peak's power over that of noise beside it, and what it must exceed.
    snr_a_db, snr_b_db : float
        Signal over noise of either recording within the signal's equivalent bandwidth.
    coherence : float
        ``|<a, b>| / sqrt(<a, a> <b, b>)`` at the peak, prefiltered.
    tones : int
        Steady lines that were subtracted from the two recordings.
    """

    status: AmbiguityStatus
    tdoa_s: float
    fdoa_hz: float
    sigma_tdoa_s: float
    sigma_fdoa_hz: float
    covariance: _Array
    tdoa_rate: float
    sigma_tdoa_rate: float
    phase_rad: float
    epoch_s: float
    start_s: float
    duration_s: float
    center_a_hz: float
    center_b_hz: float
    bandwidth_hz: float
    snr_db: float
    threshold_db: float
    snr_a_db: float
    snr_b_db: float
    coherence: float
    tones: int

    @property
    def detected(self) -> bool:
        """Whether delay and Doppler are a measurement."""
        return bool(self.status == AmbiguityStatus.OK)

    @property
    def identical(self) -> bool:
        """Whether the recordings hold the same samples: a delay of zero that says nothing."""
        return bool(self.status == AmbiguityStatus.IDENTICAL)

    def __repr__(self) -> str:
        if not self.detected:
            return f"CrossAmbiguityResult({self.status.text}, SNR {self.snr_db:.1f} of {self.threshold_db:.1f} dB)"
        return (
            f"CrossAmbiguityResult(TDOA {_seconds(self.tdoa_s)} ± {_seconds(self.sigma_tdoa_s)}, "
            f"FDOA {self.fdoa_hz:.6g} ± {self.sigma_fdoa_hz:.2g} Hz, SNR {self.snr_db:.1f} dB)"
        )


def _result(peak: _dsp.AmbiguityPeak) -> CrossAmbiguityResult:
    s_t, s_f = peak.sigma_tdoa_s, peak.sigma_fdoa_hz
    cross = peak.correlation * s_t * s_f if math.isfinite(s_t) and math.isfinite(s_f) else 0.0
    covariance = np.array([[s_t**2, cross], [cross, s_f**2]])
    covariance.setflags(write=False)
    return CrossAmbiguityResult(
        peak.status,
        peak.tdoa_s,
        peak.fdoa_hz,
        s_t,
        s_f,
        covariance,
        peak.tdoa_rate,
        peak.sigma_tdoa_rate,
        peak.phase_rad,
        peak.epoch_s,
        peak.start_s,
        peak.duration_s,
        peak.center_a_hz,
        peak.center_b_hz,
        peak.bandwidth_hz,
        peak.snr_db,
        peak.threshold_db,
        peak.snr_a_db,
        peak.snr_b_db,
        peak.coherence,
        peak.tones,
    )


# Plans cost far more than a measurement. `lru_cache` hands threads the same object, which takes a lock while it works.
@functools.lru_cache(maxsize=16)
def _meter(
    sample_rate_hz: float,
    max_samples: int,
    max_delay_s: float,
    max_doppler_hz: float,
    delay_center_s: float,
    doppler_center_hz: float,
    bandwidth_hz: float,
    center_a_hz: float | None,
    center_b_hz: float | None,
    symbol_rate_hz: float,
    rolloff: float,
    prefilter: str,
    false_alarm: float,
    carrier_hz: float,
    tdoa_rate: float,
    estimate_rate: bool,
    max_tdoa_rate: float,
    reject_tones: bool,
) -> _dsp.CrossAmbiguity:
    if prefilter not in _PREFILTERS:
        raise ValueError(f'prefilter: one of "none", "box", "rrc", "ml" required, got "{prefilter}"')
    return _dsp.CrossAmbiguity(
        sample_rate_hz=sample_rate_hz,
        max_samples=max_samples,
        max_delay_s=max_delay_s,
        max_doppler_hz=max_doppler_hz,
        delay_center_s=delay_center_s,
        doppler_center_hz=doppler_center_hz,
        bandwidth_hz=bandwidth_hz,
        center_a_hz=math.nan if center_a_hz is None else center_a_hz,
        center_b_hz=math.nan if center_b_hz is None else center_b_hz,
        symbol_rate_hz=symbol_rate_hz,
        rolloff=rolloff,
        prefilter=_PREFILTERS[prefilter],
        false_alarm=false_alarm,
        carrier_hz=carrier_hz,
        tdoa_rate=tdoa_rate,
        estimate_rate=estimate_rate,
        max_tdoa_rate=max_tdoa_rate,
        reject_tones=reject_tones,
    )


def _check_lengths(a: _Iq, b: _Iq) -> int:
    for name, iq in (("a", a), ("b", b)):
        if not isinstance(iq, np.ndarray) or iq.ndim != 1:
            raise ValueError(f"{name}: expected complex64 (N,), got {type(iq).__name__} {np.shape(iq)}")
        if iq.size == 0:
            raise ValueError(f"{name}: no samples")
    if a.size != b.size:
        raise ValueError(f"b: {b.size} samples, a has {a.size}: both must cover the same time")
    return int(a.size)


def cross_ambiguity(
    a: _Iq,
    b: _Iq,
    sample_rate_hz: float,
    *,
    max_delay_s: float = 20e-6,
    max_doppler_hz: float = 40e3,
    delay_center_s: float = 0.0,
    doppler_center_hz: float = 0.0,
    bandwidth_hz: float = 0.0,
    center_a_hz: float | None = None,
    center_b_hz: float | None = None,
    symbol_rate_hz: float = 0.0,
    rolloff: float = 0.4,
    prefilter: Prefilter = "ml",
    false_alarm: float = 1e-3,
    carrier_hz: float = 0.0,
    tdoa_rate: float = 0.0,
    estimate_rate: bool = False,
    max_tdoa_rate: float = 5e-6,
    reject_tones: bool = True,
) -> CrossAmbiguityResult:
    """Measure delay and Doppler between two recordings of one unknown signal (Stein 1981; mei slides 9-11).

    Each side's band is found and mixed to zero, steady lines are subtracted, the burst is cut out, the ambiguity
    function is searched and its peak refined off the grid with the prefilter that maximum likelihood asks for. The
    derivations are in ``cpp/doc/ambiguity.md``. Plans are kept between calls with the same options and length; a call
    of 90 ms at 250 ksps takes less than a millisecond.

    Parameters
    ----------
    a, b : ndarray, shape (n,), complex64
        Recordings that start at the same instant, each by its own clock.
    sample_rate_hz : float
        Of both.
    max_delay_s, max_doppler_hz : float
        Searched to either side of `delay_center_s` and `doppler_center_hz`. Narrow searches have lower thresholds.
    bandwidth_hz : float
        Occupied two-sided bandwidth of the signal; 0: found from the spectra, or from `symbol_rate_hz`.
    center_a_hz, center_b_hz : float, optional
        Where the signal lies in each recording, relative to its centre; found from the spectra when not given.
    symbol_rate_hz, rolloff : float
        Root-raised-cosine symbols, when they are known; else the spectrum's shape is estimated.
    prefilter : {"ml", "rrc", "box", "none"}
        ``"ml"``: ``H / sqrt(1 + (g1 + g2) H²)`` on each side; the others are for comparison.
    false_alarm : float
        Probability that noise alone is called a signal.
    carrier_hz : float
        When given, one oscillator and one motion make delay and Doppler: the stretch ``-fdoa / carrier_hz`` is
        resampled out.
    tdoa_rate : float
        Known change of the delay [s/s], taken out besides.
    estimate_rate, max_tdoa_rate
        Estimate the change of the delay as a third unknown, within `max_tdoa_rate` of `tdoa_rate`.
    reject_tones : bool

    Returns
    -------
    CrossAmbiguityResult
        With a status other than ``OK`` when there is nothing to measure: no common signal, a tone (steady or keyed),
        a wide band that does not stand out and would take minutes to search (state `bandwidth_hz`), identical
        recordings, samples that are not finite or all zero, recordings too short.

    Raises
    ------
    ValueError
        For an option outside its range, or recordings that are empty, not complex64 or not equally long.
    """
    n = _check_lengths(a, b)
    meter = _meter(
        float(sample_rate_hz),
        max(n, 64),
        float(max_delay_s),
        float(max_doppler_hz),
        float(delay_center_s),
        float(doppler_center_hz),
        float(bandwidth_hz),
        center_a_hz,
        center_b_hz,
        float(symbol_rate_hz),
        float(rolloff),
        prefilter,
        float(false_alarm),
        float(carrier_hz),
        float(tdoa_rate),
        bool(estimate_rate),
        float(max_tdoa_rate),
        bool(reject_tones),
    )
    return _result(meter.measure(a, b))


@dataclass(frozen=True, eq=False)
class Surface:
    """The ambiguity function over a grid.

    Attributes
    ----------
    delays_s : ndarray, shape (m,)
    doppler_hz : ndarray, shape (k,)
    power : ndarray, shape (m, k)
        ``|C|² / (<a, a> <b, b>)`` with the coarse prefilter, between 0 and 1.
    result : CrossAmbiguityResult
    """

    delays_s: _Array
    doppler_hz: _Array
    power: _Array
    result: CrossAmbiguityResult


def ambiguity_surface(
    a: _Iq,
    b: _Iq,
    sample_rate_hz: float,
    *,
    delays_s: npt.ArrayLike | None = None,
    doppler_hz: npt.ArrayLike | None = None,
    max_delay_s: float = 20e-6,
    max_doppler_hz: float = 40e3,
    bandwidth_hz: float = 0.0,
    carrier_hz: float = 0.0,
    delay_center_s: float = 0.0,
    doppler_center_hz: float = 0.0,
) -> Surface:
    """Draw the ambiguity function around its peak.

    Parameters
    ----------
    a, b, sample_rate_hz, max_delay_s, max_doppler_hz, bandwidth_hz, carrier_hz, delay_center_s, doppler_center_hz
        As `cross_ambiguity`, which is run first.
    delays_s, doppler_hz : array_like, optional
        The grid. By default 81 × 121 cells over six resolution cells to either side of the peak.

    Returns
    -------
    Surface
        All zero when there was nothing to measure.
    """
    n = _check_lengths(a, b)
    meter = _meter(
        float(sample_rate_hz),
        max(n, 64),
        float(max_delay_s),
        float(max_doppler_hz),
        float(delay_center_s),
        float(doppler_center_hz),
        float(bandwidth_hz),
        None,
        None,
        0.0,
        0.4,
        "ml",
        1e-3,
        float(carrier_hz),
        0.0,
        False,
        5e-6,
        True,
    )
    result = _result(meter.measure(a, b))
    if delays_s is None:
        reach = 3.0 / max(result.bandwidth_hz, sample_rate_hz / n)
        delays_s = result.tdoa_s + np.linspace(-reach, reach, 81)
    if doppler_hz is None:
        reach = 4.0 / max(result.duration_s, 1.0 / sample_rate_hz)
        doppler_hz = result.fdoa_hz + np.linspace(-reach, reach, 121)
    delays = np.ascontiguousarray(delays_s, dtype=np.float64)
    doppler = np.ascontiguousarray(doppler_hz, dtype=np.float64)
    peak, power = meter.surface(a, b, delays, doppler)
    return Surface(delays, doppler, power, _result(peak))


@dataclass(frozen=True)
class TdoaFdoaBound:
    """Least standard deviations of TDOA and FDOA.

    Attributes
    ----------
    sigma_tdoa_s, sigma_fdoa_hz : float
    """

    sigma_tdoa_s: float
    sigma_fdoa_hz: float


def tdoa_fdoa_crlb(
    bandwidth_hz: float,
    duration_s: float,
    snr_a_db: float,
    snr_b_db: float | None = None,
    *,
    shape: Shape = "rrc",
    rolloff: float = 0.4,
    kind: Literal["stein", "stochastic"] = "stein",
) -> TdoaFdoaBound:
    """Bound of TDOA and FDOA of a burst of constant envelope.

    Parameters
    ----------
    bandwidth_hz : float
        Noise bandwidth that the SNRs refer to: the symbol rate of ``"rrc"``, the whole band of ``"flat"``.
    duration_s : float
    snr_a_db, snr_b_db : float
        Signal over noise of the two recordings; the same when only one is given.
    shape : {"rrc", "flat"}
        Spectrum of root-raised-cosine symbols of this `rolloff`, or flat.
    kind : {"stein", "stochastic"}
        Stein 1981 with the ``1 / (g1 g2)`` term, or the bound for a Gaussian signal that nobody knows, which is what
        can be reached at low SNR.

    Returns
    -------
    TdoaFdoaBound
    """
    bound = {"stein": _dsp.stein_bound, "stochastic": _dsp.stochastic_bound}.get(kind)
    if bound is None:
        raise ValueError(f'kind: "stein" or "stochastic" required, got "{kind}"')
    snr_a, snr_b = (10.0 ** (db / 10.0) for db in (snr_a_db, snr_a_db if snr_b_db is None else snr_b_db))
    return TdoaFdoaBound(*bound(bandwidth_hz, duration_s, snr_a, snr_b, shape, rolloff))
