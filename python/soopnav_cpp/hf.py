"""Time differences of arrival from narrow-band receivers with GNSS time tags, such as the KiwiSDR.

>>> import soopnav_cpp as sn
>>> a, b = (sn.io.read_kiwi(name) for name in ("a_iq.wav", "b_iq.wav"))  # doctest: +SKIP
>>> sn.hf.envelope_tdoa(a, b)  # doctest: +SKIP
EnvelopeTdoa(430.6 ± 0.8 µs over 28.9 s)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp
from soopnav_cpp._kiwi import KiwiRecording

__all__ = ["EnvelopeTdoa", "carrier_envelope", "envelope_tdoa"]

_WEEK_S = 604_800.0
_PHASE_BLOCK_S = 0.25  # of carrier, whose phase is taken together
_LEAST_OVERLAP_S = 2.0
_FADE_S = 0.5
_MARGIN_S = 0.05  # of recording that the filters need on either side


@dataclass(frozen=True, eq=False)
class EnvelopeTdoa:
    """Time difference of arrival of a modulated carrier.

    Attributes
    ----------
    tdoa_s : float
        Arrival at `a` minus arrival at `b`: positive when later at `a`.
    sigma_s : float
        Its standard deviation by the noise of the recordings: the larger of what the coherence and what the scatter of
        the seconds says. Biases of a station (antenna, filters, propagation) are not in it.
    coherence_sigma_s, scatter_sigma_s : float
        The two.
    parts_s : ndarray
        The difference of each second of the overlap.
    overlap_s : float
        Time that both recordings cover.
    coherence : float
        Of the two envelopes, 0 … 1.
    """

    tdoa_s: float
    sigma_s: float
    coherence_sigma_s: float
    scatter_sigma_s: float
    parts_s: npt.NDArray[np.float64]
    overlap_s: float
    coherence: float

    def __repr__(self) -> str:
        return f"EnvelopeTdoa({self.tdoa_s * 1e6:.1f} ± {self.sigma_s * 1e6:.1f} µs over {self.overlap_s:.1f} s)"


def _positive(name: str, value: float, least: float, most: float) -> float:
    if not least <= value <= most:
        raise ValueError(f"{name} = {value:g} must be in {least:g} … {most:g}")
    return float(value)


def carrier_envelope(
    recording: KiwiRecording, start_s: float, duration_s: float, *, bandwidth_hz: float = 400.0, rate_hz: float = 2000.0
) -> npt.NDArray[np.complex64]:
    """What modulates a carrier: the recording relative to its carrier, less the carrier itself.

    The samples are brought to a grid of GPS time; the carrier, the strongest there is, is followed by its phase (a
    straight line through quarter-second means), turned to zero and scaled to one; its mean is subtracted. Amplitude
    modulation is then in the real part, phase modulation in the imaginary one. Both carry the delay: on DCF77 the
    complex envelope is right to 8 µs, its amplitude alone to 17 µs, its phase alone to 23 µs.

    Parameters
    ----------
    recording : KiwiRecording
    start_s : float
        First sample's GPS time of the week, within the recording.
    duration_s : float
    bandwidth_hz : float
        Kept to either side of the carrier, below 0.4 `rate_hz`.
    rate_hz : float
        Of the result, at most the recording's.

    Returns
    -------
    ndarray, shape (n,), complex64
        Carrier amplitude 1, mean 0.

    Raises
    ------
    ValueError
        When the recording does not cover the time, or holds no carrier.
    """
    _positive("rate_hz", rate_hz, 100.0, recording.sample_rate_hz)
    _positive("bandwidth_hz", bandwidth_hz, 1.0, 0.4 * rate_hz)
    first = (start_s - recording.start_s + 0.5 * _WEEK_S) % _WEEK_S - 0.5 * _WEEK_S
    if not (first >= 0.0 and duration_s > 0.0 and first + duration_s <= recording.duration_s):
        raise ValueError(
            f"start_s = {start_s:.6f}, duration_s = {duration_s:.6f}: the recording {recording.path.name} covers "
            f"{recording.start_s:.6f} … {recording.start_s + recording.duration_s:.6f}"
        )
    # A whole sample ahead, the rest by a delay; then the rate.
    ahead = first * recording.sample_rate_hz
    margin = round(_MARGIN_S * recording.sample_rate_hz)
    whole = max(int(ahead) - margin, 0)
    last = min(int(ahead + duration_s * recording.sample_rate_hz) + margin, recording.iq.size)
    shifted = dsp.delay(np.ascontiguousarray(recording.iq[whole:last]), -(ahead - whole) % 1.0)
    skip = int(ahead) - whole + (1 if ahead % 1.0 > 0.0 else 0)
    count = int(duration_s * rate_hz)
    # Of the shifted samples number `skip` lies at start_s. The resampler starts at a sample of the grid before it, so
    # that its filter has what it needs.
    lead = int(skip * rate_hz / recording.sample_rate_hz)
    back = lead * recording.sample_rate_hz / rate_hz
    if back < skip:
        shifted = dsp.delay(shifted, -(skip - back))
    y = dsp.resample(shifted, recording.sample_rate_hz, rate_hz, stopband=1.0)[lead : lead + count]
    block = max(round(_PHASE_BLOCK_S * rate_hz), 1)
    means = y[: y.size // block * block].reshape(-1, block).mean(axis=1)
    if means.size == 0 or not np.all(np.abs(means) > 0.0):
        raise ValueError(f"{recording.path}: no carrier")
    middle = (np.arange(means.size) + 0.5) * block - 0.5
    phase = np.unwrap(np.angle(means))
    slope, offset = np.polyfit(middle, phase, 1) if means.size > 1 else (0.0, float(phase[0]))
    turned = y * np.exp(-1j * (slope * np.arange(y.size) + offset))
    carrier = float(np.mean(turned).real)
    if not carrier > 0.1 * float(np.sqrt(np.mean(np.abs(y) ** 2))):
        raise ValueError(f"{recording.path}: no steady carrier; its phase does not follow a line")
    spectrum = np.fft.fft(turned / carrier)
    spectrum[np.abs(np.fft.fftfreq(y.size, 1.0 / rate_hz)) > bandwidth_hz] = 0.0
    spectrum[0] = 0.0
    return np.ascontiguousarray(np.fft.ifft(spectrum), dtype=np.complex64)


def _residual_delays(
    x: npt.NDArray[np.complex64], y: npt.NDArray[np.complex64], rate_hz: float, parts: int
) -> npt.NDArray[np.float64]:
    """Delays left between aligned envelopes, of each part: x ~ c (y - delay dy/dt), c and delay by least squares."""
    slope = np.fft.ifft(np.fft.fft(y) * 2j * np.pi * np.fft.fftfreq(y.size, 1.0 / rate_hz))
    size = y.size // parts
    delays = np.empty(parts)
    for i in range(parts):
        part = slice(i * size, (i + 1) * size)
        basis = np.stack([y[part].astype(np.complex128), slope[part]], axis=1)
        gain, change = np.linalg.solve(basis.conj().T @ basis, basis.conj().T @ x[part])
        delays[i] = -(change / gain).real
    return delays


def _peak(x: npt.NDArray[np.complex64], y: npt.NDArray[np.complex64], rate_hz: float, delay_s: float) -> float:
    """Where the cross-correlation is highest, from nearby, in double precision.

    The modulation is slow: a microsecond beside its peak, the correlation has fallen by less than single precision has
    digits for. Newton's steps on |sum X conj(Y) exp(j w delay)|^2.
    """
    w = 2.0 * np.pi * np.fft.fftfreq(x.size, 1.0 / rate_hz)
    cross = np.fft.fft(x.astype(np.complex128)) * np.conj(np.fft.fft(y.astype(np.complex128)))
    start = delay_s
    for _ in range(6):
        turned = cross * np.exp(1j * w * delay_s)
        s0, s1, s2 = turned.sum(), (1j * w * turned).sum(), (-(w**2) * turned).sum()
        bend = abs(s1) ** 2 + (np.conj(s0) * s2).real
        if not bend < 0.0:
            break
        delay_s -= float((np.conj(s0) * s1).real / bend)
    return delay_s if abs(delay_s - start) < 0.1e-3 else start


def envelope_tdoa(
    a: KiwiRecording,
    b: KiwiRecording,
    *,
    bandwidth_hz: float = 400.0,
    max_delay_s: float = 3e-3,
) -> EnvelopeTdoa:
    """Time difference of arrival of a carrier's modulation between two receivers, over all the time both recorded.

    The complex envelopes (`carrier_envelope`) are cross-correlated with `soopnav_cpp.dsp.cross_ambiguity`; as the peak
    is very flat, its top is then found in double precision. Ground waves travel at the speed of light over the air's
    refractive index (1.000338), along the great circle.

    Parameters
    ----------
    a, b : KiwiRecording
    bandwidth_hz : float
        Kept to either side of the carrier.
    max_delay_s : float
        Searched to either side of zero.

    Returns
    -------
    EnvelopeTdoa

    Raises
    ------
    ValueError
        When the recordings have less than 2 s in common, are the same, or hold no common modulation.
    """
    apart = (b.start_s - a.start_s + 0.5 * _WEEK_S) % _WEEK_S - 0.5 * _WEEK_S
    # A tenth of a second at either end is left to the filters.
    begin = max(0.0, apart) + 2.0 * _MARGIN_S
    end = min(a.duration_s, apart + b.duration_s) - 2.0 * _MARGIN_S
    overlap = end - begin
    if not overlap >= _LEAST_OVERLAP_S:
        raise ValueError(
            f"{a.path.name} and {b.path.name} have {max(overlap, 0.0):.2f} s in common; "
            f"{_LEAST_OVERLAP_S:g} s are needed"
        )
    rate_hz = min(max(5.0 * bandwidth_hz, 1000.0), a.sample_rate_hz, b.sample_rate_hz)
    start = (a.start_s + begin) % _WEEK_S
    x, y = (carrier_envelope(r, start, overlap, bandwidth_hz=bandwidth_hz, rate_hz=rate_hz) for r in (a, b))

    # Faded in and out: a mark that only one of the recordings still holds would pull the peak.
    fade = np.ones(x.size, dtype=np.float32)
    edge = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(_FADE_S * rate_hz)) + 0.5) / round(_FADE_S * rate_hz))
    fade[: edge.size] = edge
    fade[-edge.size :] = edge[::-1]
    whole = dsp.cross_ambiguity(
        x * fade,
        y * fade,
        rate_hz,
        max_delay_s=max_delay_s,
        max_doppler_hz=0.2,
        bandwidth_hz=2.0 * bandwidth_hz,
        center_a_hz=0.0,
        center_b_hz=0.0,
        prefilter="box",
        reject_tones=False,
    )
    if not whole.detected:
        raise ValueError(f"{a.path.name}, {b.path.name}: {whole.status.text}")
    tdoa_s = _peak(x * fade, y * fade, rate_hz, whole.tdoa_s)
    each = tdoa_s + _residual_delays(dsp.delay(x, -tdoa_s * rate_hz), y, rate_hz, max(int(overlap), 2))
    # By the median absolute deviation: a part with a disturbance of its own does not decide.
    scatter = 1.4826 * float(np.median(np.abs(each - np.median(each)))) / math.sqrt(each.size)
    each.setflags(write=False)
    return EnvelopeTdoa(
        tdoa_s,
        max(whole.sigma_tdoa_s, scatter),
        whole.sigma_tdoa_s,
        scatter,
        each,
        overlap,
        whole.coherence,
    )
