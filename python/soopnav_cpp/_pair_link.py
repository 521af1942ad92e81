"""Transmissions through two channels into two receivers whose clocks are their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core import iridium as _iridium
from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp.clock import ClockSeries

__all__ = ["ClockTrack", "PairArrivals", "PairLink", "PairReceiver", "PairSnippets", "PairTruth"]

_Floats = npt.NDArray[np.float64]
_Iq = npt.NDArray[np.complex64]
_LIGHT_MPS = 299_792_458.0


class ClockTrack:
    """A receiver's clock over system time: what it is off, and how fast that grows.

    Bias is the reading minus system time; drift is its rate: a fast clock (drift > 0) stamps later, and as one
    reference drives sample clock and local oscillator, it sees carriers lower by f·drift. Between instants the bias is
    a cubic Hermite polynomial, before the first and after the last it runs at the drift there.

    Parameters
    ----------
    t_s : array_like, shape (n,)
        Rising. Put one where a burst arrives: the frequency seen there is then the state's drift.
    bias_s, drift : array_like, shape (n,)
        Drift is dimensionless, below 1e-3.

    Raises
    ------
    ValueError
        For no instant, other lengths, instants that do not rise, numbers that are not finite or too large a drift.
    """

    def __init__(self, t_s: npt.ArrayLike, bias_s: npt.ArrayLike, drift: npt.ArrayLike) -> None:
        self._core = _simulation.ClockTrack(t_s, bias_s, drift)

    @classmethod
    def steady(cls, bias_s: float = 0.0, drift: float = 0.0, epoch_s: float = 0.0) -> ClockTrack:
        """bias = bias_s + drift·(t - epoch_s)."""
        return cls([epoch_s], [bias_s], [drift])

    @classmethod
    def of(cls, series: ClockSeries, steady_s: float = 0.0) -> ClockTrack:
        """A clock that `clock.TwoState.simulate` or `simulate_at` ran.

        Parameters
        ----------
        series : clock.ClockSeries
        steady_s : float
            For so long about each instant the clock runs at the drift it has there, and bends between: put an instant
            where each burst arrives, and the frequency seen throughout the burst is the state's drift. Shorter than the
            steps. A two-state clock's white frequency noise then shows in the biases from burst to burst and not as
            phase noise within one, where it would be that of an oscillator's short-term spectrum, which two states do
            not describe.

        Raises
        ------
        ValueError
            When steps are not longer than `steady_s`.
        """
        if not steady_s > 0.0:
            return cls(series.t_s, series.bias_s, series.drift)
        half = 0.5 * steady_s * np.array([-1.0, 1.0])
        times = (series.t_s[:, None] + half).ravel()
        return cls(times, (series.bias_s[:, None] + series.drift[:, None] * half).ravel(), np.repeat(series.drift, 2))

    def at(self, t_s: npt.ArrayLike) -> tuple[_Floats, _Floats]:
        """Bias [s] and drift at system times, each of t_s's shape."""
        times = np.asarray(t_s, np.float64)
        bias, drift = self._core.at(times.ravel())
        return bias.reshape(times.shape), drift.reshape(times.shape)

    def time_of(self, reading_s: npt.ArrayLike) -> _Floats:
        """System times at which the clock shows readings."""
        readings = np.asarray(reading_s, np.float64)
        return self._core.time_of(readings.ravel()).reshape(readings.shape)

    def __repr__(self) -> str:
        t = self._core.t_s
        bias, drift = self.at(t[:1])
        until = f" to {t[-1]:g}" if len(t) > 1 else ""
        return f"ClockTrack({bias[0]:+.3g} s, {drift[0]:+.3g} at {t[0]:g}{until} s)"


class PairReceiver:
    """One of two receivers.

    Parameters
    ----------
    antenna : geometry.SampledOrbit or array_like, shape (3,)
        Where its antenna is over system time; a point is at rest, ECEF [m].
    clock : ClockTrack, optional
        By default it shows system time.
    taps : sequence of (delay_s, gain), optional
        Echoes: each repeats the path, later by delay_s, with a complex gain at baseband. By default delay 0, gain 1.

    Raises
    ------
    ValueError
        For a tap that is not finite.
    """

    def __init__(
        self,
        antenna: _geometry.SampledOrbit | npt.ArrayLike,
        clock: ClockTrack | None = None,
        *,
        taps: Sequence[tuple[float, complex]] = (),
    ) -> None:
        if not isinstance(antenna, _geometry.SampledOrbit):
            antenna = _geometry.SampledOrbit.fixed(np.asarray(antenna, np.float64))
        self.antenna = antenna
        self.clock = clock if clock is not None else ClockTrack.steady()
        self._core = _simulation.PairReceiver(
            antenna, self.clock._core, [float(t) for t, _ in taps], [complex(g) for _, g in taps]
        )

    def receive(
        self,
        waveform: Any,
        beacon: _geometry.SampledOrbit,
        samples: _Iq,
        *,
        start_s: float,
        carrier_hz: float,
        recording_start_s: float,
        sample_rate_hz: float,
        center_hz: float,
        first_sample: int = 0,
        amplitude: float = 1.0,
        phase_rad: float = 0.0,
        waveform_rate_hz: float = 0.0,
    ) -> None:
        """Add what it hears of a transmission to samples of a recording, in place.

        Sample n was taken when its clock showed recording_start_s + (first_sample + n)/sample_rate_hz. A transmission
        that does not meet the samples adds nothing.

        Parameters
        ----------
        waveform : iridium.Burst or ndarray of complex64
            An array needs `waveform_rate_hz`.
        beacon : geometry.SampledOrbit
        samples : ndarray, shape (n,), complex64
        start_s : float
            System time at which the waveform's time 0 leaves the beacon.
        carrier_hz, center_hz : float
        first_sample : int
        amplitude, phase_rad : float

        Raises
        ------
        ValueError
            When an instant outside the samples of the beacon or the antenna is needed.
        """
        self._core.receive(
            _envelope(waveform, waveform_rate_hz),
            beacon,
            start_s=start_s,
            carrier_hz=carrier_hz,
            amplitude=amplitude,
            phase_rad=phase_rad,
            grid_start_s=recording_start_s,
            sample_rate_hz=sample_rate_hz,
            center_hz=center_hz,
            first_sample=first_sample,
            samples=samples,
        )

    def __repr__(self) -> str:
        return f"PairReceiver({self.antenna!r}, {self.clock!r})"


class PairArrivals(NamedTuple):
    """Wavefronts at one receiver, shape (n,) each.

    Attributes
    ----------
    t_s : ndarray
        System time.
    reading_s : ndarray
        Of its clock.
    frequency_hz : ndarray
        Of the carrier as its clock counts it: f·(1 - delay_rate)/(1 + drift).
    delay_s, delay_rate : ndarray
        Of the path; the rate by the receiver's system time.
    bias_s, drift : ndarray
        Of its clock.
    """

    t_s: _Floats
    reading_s: _Floats
    frequency_hz: _Floats
    delay_s: _Floats
    delay_rate: _Floats
    bias_s: _Floats
    drift: _Floats


@dataclass(frozen=True)
class PairTruth:
    """What two recordings of the same wavefronts say of each other without noise; arrays of shape (n,).

    Attributes
    ----------
    tdoa_s : ndarray
        Reading of the target minus reading of the anchor: positive when the target is later.
    fdoa_hz : ndarray
        Frequency at the target minus frequency at the anchor: positive when higher.
    target, anchor : PairArrivals
    """

    tdoa_s: _Floats
    fdoa_hz: _Floats
    target: PairArrivals
    anchor: PairArrivals

    @property
    def theta_m(self) -> _Floats:
        """c·(target's bias - anchor's bias), each at its own arrival [m]."""
        return _LIGHT_MPS * (self.target.bias_s - self.anchor.bias_s)

    @property
    def alpha_mps(self) -> _Floats:
        """c·(target's drift - anchor's drift) [m/s]."""
        return _LIGHT_MPS * (self.target.drift - self.anchor.drift)

    def __len__(self) -> int:
        return len(self.tdoa_s)

    def __repr__(self) -> str:
        if len(self) == 1:
            return f"PairTruth(tdoa {self.tdoa_s[0]:+.9e} s, fdoa {self.fdoa_hz[0]:+.6f} Hz)"
        return f"PairTruth({len(self)} wavefronts)"


@dataclass(frozen=True)
class PairSnippets:
    """Two recordings of each of n bursts.

    Sample k of row i of the target was taken when the target's clock showed target_start_s[i] + k/sample_rate_hz; the
    same for the anchor. So with dt the delay of the target's row against the anchor's (`dsp.cross_ambiguity`), the TDOA
    is target_start_s - anchor_start_s + dt.

    Attributes
    ----------
    target, anchor : ndarray, shape (n, samples), complex64
    target_start_s, anchor_start_s : ndarray, shape (n,)
    center_hz : ndarray, shape (n,)
        What both receivers were tuned to.
    sample_rate_hz : float
    truth : PairTruth
        Of the bursts' middles.
    """

    target: _Iq
    anchor: _Iq
    target_start_s: _Floats
    anchor_start_s: _Floats
    center_hz: _Floats
    sample_rate_hz: float
    truth: PairTruth

    def __len__(self) -> int:
        return len(self.target_start_s)

    def __repr__(self) -> str:
        return f"PairSnippets({len(self)} bursts, {self.target.shape[1]} samples at {self.sample_rate_hz:g} Hz)"


class PairLink:
    """Target and anchor hear one transmitter after the other.

    Every sample is s(t - D(t)) exp(j 2π((f_tx - f_lo)·r - f_tx·(b + D))) (cpp/doc/pair_link.md eq. 3): r the receiver's
    own reading, t the system time at which its clock shows r, b the clock's bias then, D the delay with light time and
    Earth rotation (`geometry.signal_path`). Nothing is approximated but s itself (below -80 dB).

    Parameters
    ----------
    target, anchor : PairReceiver
    sample_rate_hz : float
    center_hz : float, optional
        What both local oscillators are tuned to, by each one's own clock. Without it, to what the anchor hears as the
        burst begins, rounded to whole kilohertz: what an ephemeris tells it. There is no filter before the samples:
        what lies outside the sampled band folds into it.
    """

    def __init__(
        self,
        target: PairReceiver,
        anchor: PairReceiver,
        *,
        sample_rate_hz: float = 50e3,
        center_hz: float | None = None,
    ) -> None:
        self.target, self.anchor = target, anchor
        self.sample_rate_hz = float(sample_rate_hz)
        self.center_hz = None if center_hz is None else float(center_hz)
        self._core = _simulation.PairLink(target._core, anchor._core, self.sample_rate_hz, self.center_hz or 0.0)

    def truth(
        self,
        beacons: _geometry.SampledOrbit | Sequence[_geometry.SampledOrbit],
        sent_s: npt.ArrayLike,
        carrier_hz: npt.ArrayLike,
        beacon: npt.ArrayLike = 0,
    ) -> PairTruth:
        """TDOA and FDOA of wavefronts that beacons sent; for a burst take its middle.

        Parameters
        ----------
        beacons : SampledOrbit or sequence of them
        sent_s : array_like, shape (n,)
            System time at the beacon.
        carrier_hz : float or array_like, shape (n,)
        beacon : int or array_like of int, shape (n,)
            Which of `beacons`.

        Returns
        -------
        PairTruth
            2 µs each.
        """
        sent = np.atleast_1d(np.asarray(sent_s, np.float64))
        table = self._core.truth(_several(beacons), _like(beacon, sent), sent, _like(carrier_hz, sent))
        columns = [_read_only(np.ascontiguousarray(table[:, i])) for i in range(table.shape[1])]
        return PairTruth(columns[0], columns[1], PairArrivals(*columns[2:9]), PairArrivals(*columns[9:16]))

    def sent_s(
        self,
        beacons: _geometry.SampledOrbit | Sequence[_geometry.SampledOrbit],
        anchor_reading_s: npt.ArrayLike,
        beacon: npt.ArrayLike = 0,
    ) -> _Floats:
        """System times at which what the anchor hears when its clock shows `anchor_reading_s` was sent."""
        reading = np.atleast_1d(np.asarray(anchor_reading_s, np.float64))
        return self._core.sent_s(_several(beacons), _like(beacon, reading), reading)

    def burst(
        self,
        waveform: Any,
        beacon: _geometry.SampledOrbit,
        *,
        start_s: float,
        carrier_hz: float,
        snr_db: float = math.inf,
        anchor_snr_db: float | None = None,
        snr_bandwidth_hz: float = 25e3,
        guard_s: float = 2e-3,
        target_start_s: float | None = None,
        anchor_start_s: float | None = None,
        samples: int | None = None,
        phase_rad: float = 0.0,
        waveform_rate_hz: float = 0.0,
        seed: int = 0,
        stream: int = 0,
    ) -> PairSnippets:
        """One burst in a snippet of each receiver.

        Parameters
        ----------
        waveform : iridium.Burst or ndarray of complex64
            Of unit mean power. An array needs `waveform_rate_hz`.
        beacon : geometry.SampledOrbit
        start_s : float
            System time at which the waveform's time 0 leaves the beacon.
        carrier_hz : float
        snr_db, anchor_snr_db : float
            Of the waveform's power over the noise in `snr_bandwidth_hz`; the anchor's is the target's by default. The
            noise has unit variance per sample; infinity (both) is no noise, and amplitude 1.
        guard_s : float
            Noise before and after the burst where starts and samples are not given.
        target_start_s, anchor_start_s : float, optional
            Readings of each one's own clock at its first sample. By default `guard_s` before the burst, on a whole
            sample of that clock.
        samples : int, optional
            Of either snippet.
        seed, stream : int
            Name the noise.

        Returns
        -------
        PairSnippets
            One row; about 0.3 ms for 90 ms at 50 ksps.

        Raises
        ------
        ValueError
            When an instant outside the samples of the beacon or an antenna is needed, or a number is out of its range.
        """
        duration_s = _duration(waveform, waveform_rate_hz)
        edge = self.truth(beacon, start_s, carrier_hz)
        truth = self.truth(beacon, start_s + 0.5 * duration_s, carrier_hz)
        begins = self._starts(edge, guard_s, target_start_s, anchor_start_s)
        center = self._center(edge)
        if samples is None:
            samples = math.ceil((duration_s + 2.0 * guard_s) * self.sample_rate_hz)
        levels = _levels((snr_db, snr_db if anchor_snr_db is None else anchor_snr_db), snr_bandwidth_hz)
        (at_target, at_anchor), noise = levels
        gain = math.sqrt(1.0 / self.sample_rate_hz) if noise else 1.0
        target, anchor = self._core.render(
            _envelope(waveform, waveform_rate_hz),
            beacon,
            start_s=start_s,
            carrier_hz=carrier_hz,
            phase_rad=phase_rad,
            target_amplitude=gain * at_target,
            anchor_amplitude=gain * at_anchor,
            target_start_s=float(begins[0][0]),
            target_samples=samples,
            anchor_start_s=float(begins[1][0]),
            anchor_samples=samples,
            center_hz=float(center[0]),
            noise_variance=noise,
            seed=seed,
            stream=stream,
        )
        return PairSnippets(target[None], anchor[None], *begins, center, self.sample_rate_hz, truth)

    def bursts(
        self,
        beacons: _geometry.SampledOrbit | Sequence[_geometry.SampledOrbit],
        beacon: npt.ArrayLike = 0,
        *,
        start_s: npt.ArrayLike,
        carrier_hz: npt.ArrayLike,
        duration_s: float = 32.5e-3,
        snr_db: npt.ArrayLike = math.inf,
        anchor_snr_db: npt.ArrayLike | None = None,
        snr_bandwidth_hz: float = 25e3,
        guard_s: float = 2e-3,
        target_start_s: npt.ArrayLike | None = None,
        anchor_start_s: npt.ArrayLike | None = None,
        samples: int | None = None,
        seed: int = 0,
        stream: int = 0,
    ) -> PairSnippets:
        """Bursts of random symbols (`iridium.BurstKind.LONG`), each in its own snippets, symbols and noise.

        A loop in the engine; parameters are those of `burst`, of shape (n,) where each burst has its own.

        Parameters
        ----------
        beacons : SampledOrbit or sequence of them
        beacon : int or array_like of int, shape (n,)
        start_s : array_like, shape (n,)
        duration_s : float
            Rounded to whole symbols of 40 µs.

        Returns
        -------
        PairSnippets
            n rows. Burst i is the same whatever the others are.
        """
        start = np.atleast_1d(np.asarray(start_s, np.float64))
        duration_s = math.floor(duration_s * 25e3 + 0.5) / 25e3 if math.isfinite(duration_s) else duration_s
        orbits, index, carrier = _several(beacons), _like(beacon, start), _like(carrier_hz, start)
        edge = self.truth(orbits, start, carrier, index)
        truth = self.truth(orbits, start + 0.5 * duration_s, carrier, index)
        begins = self._starts(edge, guard_s, target_start_s, anchor_start_s)
        center = self._center(edge)
        if samples is None:
            samples = math.ceil((duration_s + 2.0 * guard_s) * self.sample_rate_hz)
        levels = (_like(snr_db, start), _like(snr_db if anchor_snr_db is None else anchor_snr_db, start))
        (at_target, at_anchor), noise = _levels(levels, snr_bandwidth_hz)
        gain = math.sqrt(1.0 / self.sample_rate_hz) if noise else 1.0
        target, anchor = self._core.bursts(
            duration_s,
            orbits,
            beacon=index,
            start_s=start,
            carrier_hz=carrier,
            target_start_s=begins[0],
            anchor_start_s=begins[1],
            samples=samples,
            target_amplitude=_like(gain * at_target, start),
            anchor_amplitude=_like(gain * at_anchor, start),
            center_hz=center,
            noise_variance=noise,
            seed=seed,
            stream=stream,
        )
        return PairSnippets(target, anchor, *begins, center, self.sample_rate_hz, truth)

    def _starts(
        self, edge: PairTruth, guard_s: float, target: npt.ArrayLike | None, anchor: npt.ArrayLike | None
    ) -> tuple[_Floats, _Floats]:
        rate = self.sample_rate_hz

        def of(given: npt.ArrayLike | None, arrivals: PairArrivals) -> _Floats:
            if given is not None:
                return _read_only(np.array(_like(given, edge.tdoa_s)))
            return _read_only(np.floor((arrivals.reading_s - guard_s) * rate) / rate)

        return of(target, edge.target), of(anchor, edge.anchor)

    def _center(self, edge: PairTruth) -> _Floats:
        if self.center_hz is not None:
            return _read_only(np.full(len(edge), self.center_hz))
        return _read_only(1e3 * np.round(edge.anchor.frequency_hz / 1e3))

    def __repr__(self) -> str:
        tuned = "each burst" if self.center_hz is None else f"{self.center_hz / 1e6:.6f} MHz"
        return f"PairLink({self.sample_rate_hz:g} Hz about {tuned})"


def _read_only(array: _Floats) -> _Floats:
    array.flags.writeable = False
    return array


def _several(beacons: _geometry.SampledOrbit | Sequence[_geometry.SampledOrbit]) -> list[_geometry.SampledOrbit]:
    return [beacons] if isinstance(beacons, _geometry.SampledOrbit) else list(beacons)


def _like(values: npt.ArrayLike, rows: _Floats) -> _Floats:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(values, np.float64), rows.shape))


def _envelope(waveform: Any, rate_hz: float) -> Any:
    if isinstance(waveform, _iridium.Burst):
        return waveform
    return _simulation.SampledEnvelope(waveform, rate_hz)


def _duration(waveform: Any, rate_hz: float) -> float:
    if isinstance(waveform, _iridium.Burst):
        return float(waveform.duration_s)
    return len(waveform) / rate_hz if rate_hz > 0.0 else 0.0


def _levels(snr_db: tuple[Any, Any], bandwidth_hz: float) -> tuple[tuple[Any, Any], float]:
    """Amplitudes, to be multiplied by rate^-1/2 where there is noise, and the noise's variance per sample."""
    target, anchor = (np.asarray(x, np.float64) for x in snr_db)
    if not (bandwidth_hz > 0.0 and math.isfinite(bandwidth_hz)):
        raise ValueError(f"snr_bandwidth_hz = {bandwidth_hz} must be positive and finite")
    none = np.isposinf(target).all() and np.isposinf(anchor).all()
    if none:
        return (1.0, 1.0), 0.0
    for name, level in (("snr_db", target), ("anchor_snr_db", anchor)):
        if not (level <= 300.0).all():
            raise ValueError(
                f"{name}: {level[~(level <= 300.0)].flat[0]}; at most 300 dB, or infinity for all, expected"
            )
    scale = math.sqrt(bandwidth_hz)
    return (scale * 10.0 ** (target / 20.0), scale * 10.0 ** (anchor / 20.0)), 1.0
