"""Recording channels with a pulse or a stepped tone, keeping the records, and making LTE channels of them."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation

__all__ = ["ChannelSounder", "EmulatedChannels", "SoundingRecord", "ToneSweep", "subcarrier_hz", "turntable"]

_Floats = npt.NDArray[np.float64]
_Complex = npt.NDArray[np.complex128]
_Taps = Sequence[tuple[float, complex]]
_FORMAT = "soopnav channel sounding"
_VERSION = 1
_UNITS = {"line_hz": "Hz", "lines": "1", "calibration": "1", "time_s": "s", "places_m": "m", "carrier_hz": "Hz"}
_RESOURCE_BLOCKS = (6, 15, 25, 50, 75, 100)


def subcarrier_hz(n_rb: int) -> _Floats:
    """Frequencies of an LTE downlink's subcarriers against its carrier, shape (12 n_rb,); zero is left out."""
    if n_rb not in _RESOURCE_BLOCKS:
        raise ValueError(f"n_rb: {n_rb}; one of {', '.join(map(str, _RESOURCE_BLOCKS))} expected")
    k = np.arange(-6 * n_rb, 6 * n_rb)
    return np.asarray(15e3 * (k + (k >= 0)), dtype=np.float64)


def turntable(
    radius_m: float,
    n: int,
    *,
    centre_m: npt.ArrayLike = (0.0, 0.0),
    start_rad: float = 0.0,
    turn_rad: float = 2 * np.pi,
) -> _Floats:
    """Places of an antenna on a turntable's rim, shape (n, 2): `n` equal steps of `turn_rad` / n, counter-clockwise."""
    if not (radius_m > 0.0 and np.isfinite(radius_m)):
        raise ValueError(f"radius_m: {radius_m}; it must be positive")
    if n < 1:
        raise ValueError(f"n: {n}; at least 1 expected")
    angle = start_rad + turn_rad * np.arange(n) / n
    return np.asarray(np.asarray(centre_m) + radius_m * np.column_stack([np.cos(angle), np.sin(angle)]))


@dataclass(frozen=True)
class EmulatedChannels:
    """Channels of one bandwidth, made of a record.

    Attributes
    ----------
    bandwidth_hz : float
    delays_s : ndarray, shape (d,)
        Of the taps, some half of what the bandwidth resolves apart.
    gain : ndarray, shape (n, L, d), complex128
        Of the taps; NaN where a record is not finite.
    nulls_hz : ndarray
        Lines of the record where the pulse has (nearly) no power. They were not divided by.
    covered : bool
        Usable lines reach both ends of the band. If not, the channel beyond them is a guess: see `sigma`.
    """

    bandwidth_hz: float
    delays_s: _Floats
    gain: _Complex
    nulls_hz: _Floats
    covered: bool
    _emulator: _simulation.ChannelEmulator

    def response(self, frequencies_hz: npt.ArrayLike) -> _Complex:
        """Channel at frequencies against the carrier, shape (n, L, f), complex128."""
        f = np.asarray(frequencies_hz, dtype=np.float64).reshape(-1)
        return np.asarray(self.gain @ np.exp(-2j * np.pi * np.outer(self.delays_s, f)))

    def sigma(self, frequencies_hz: npt.ArrayLike) -> _Floats:
        """1-sigma error over the channel's mean amplitude, shape (f,); near 1 where the record knows nothing."""
        return self._emulator.sigma(np.asarray(frequencies_hz, dtype=np.float64).reshape(-1))

    def taps(self, place: int = 0, port: int = 0, *, delay_offset_s: float = 0.0) -> list[tuple[float, complex]]:
        """(delay_s, gain) pairs as `apply_taps` and `lte.CellParameters` take them: the record replayed."""
        gain = self.gain[place, port]
        if not np.isfinite(gain).all():
            raise ValueError(f"taps: the record of place {place}, port {port} is not finite")
        return [(float(d) + delay_offset_s, complex(g)) for d, g in zip(self.delays_s, gain, strict=True)]

    def __repr__(self) -> str:
        n, ports, taps = self.gain.shape
        edge = "" if self.covered else ", beyond the usable lines"
        return f"EmulatedChannels({n} places x {ports} ports, {self.bandwidth_hz / 1e6:g} MHz, {taps} taps{edge})"


@dataclass(frozen=True)
class SoundingRecord:
    """Lines of a pulse, as received over channels.

    Attributes
    ----------
    line_hz : ndarray, shape (m,)
        Against the carrier, rising.
    lines : ndarray, shape (n, L, m), complex128
        Of n places and L ports.
    calibration : ndarray, shape (m,), complex128
        The same over a cable of gain 1 and no delay.
    line_noise_variance : float
        E|noise|² of each line.
    time_s : ndarray, shape (n, L)
        When the averages began.
    clipped : ndarray of int64, shape (n, L)
        Samples beyond the converter's scale.
    places_m : ndarray, shape (n, 2) or (n, 3), or None
    carrier_hz : float
    """

    line_hz: _Floats
    lines: _Complex
    calibration: _Complex
    line_noise_variance: float
    time_s: _Floats
    clipped: npt.NDArray[np.int64]
    places_m: _Floats | None
    carrier_hz: float

    def gain(self) -> _Complex:
        """Lines over the calibration, shape (n, L, m): the plain division, NaN where the pulse is below -35 dB."""
        size = np.abs(self.calibration)
        good = size >= size.max() * 10.0 ** (-35.0 / 20.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(good, self.lines / self.calibration, np.nan)

    def emulate(
        self,
        bandwidth_hz: float = 18e6,
        *,
        delay_window_s: tuple[float, float] = (-100e-9, 1.4e-6),
        null_db: float = -35.0,
    ) -> EmulatedChannels:
        """The channels as a system of `bandwidth_hz` sees them.

        Taps in the window are fitted to the lines in the band and a little beyond, each line weighted by the pulse's
        power in it: a division by the pulse's spectrum that stays finite at its nulls. 20 MHz of LTE occupy 18 MHz.

        Parameters
        ----------
        bandwidth_hz : float
            1 MHz to 20 MHz are nielsen's.
        delay_window_s : (low, high)
            Where paths may lie.
        null_db : float
            Weaker lines of the pulse are named in ``nulls_hz`` and not used.
        """
        if not (np.isfinite(bandwidth_hz) and bandwidth_hz > 0.0):
            raise ValueError(f"bandwidth_hz: {bandwidth_hz}; a positive number expected")
        if not np.isfinite(delay_window_s).all():
            raise ValueError(f"delay_window_s: {delay_window_s}; finite numbers expected")
        if not np.isfinite(null_db):
            raise ValueError(f"null_db: {null_db}; a finite number expected")
        # What is not finite is no channel, and says nothing of the mean gain.
        flat = self.lines.reshape(-1, self.lines.shape[-1])
        good = np.isfinite(flat).all(axis=1)
        near = np.abs(self.line_hz) <= 0.5 * bandwidth_hz
        reference = float(np.sum(np.abs(self.calibration[near]) ** 2))
        if not reference > 0.0:
            raise ValueError(f"bandwidth_hz: {bandwidth_hz}; the calibration has no power in this band")
        received = float(np.mean(np.sum(np.abs(flat[good][:, near]) ** 2, axis=1))) if good.any() else 0.0
        power = max((received - self.line_noise_variance * int(near.sum())) / reference, 1e-300)
        strongest = float(np.abs(self.calibration).max()) ** 2
        emulator = _simulation.ChannelEmulator(
            self.line_hz,
            self.calibration,
            bandwidth_hz=bandwidth_hz,
            delay_low_s=delay_window_s[0],
            delay_high_s=delay_window_s[1],
            null_db=null_db,
            noise_to_signal=float(np.clip(self.line_noise_variance / (power * strongest), 1e-12, 1e3)),
        )
        delays = emulator.delays_s
        gain = emulator.taps(np.ascontiguousarray(flat)).reshape(*self.lines.shape[:2], len(delays))
        return EmulatedChannels(bandwidth_hz, delays, gain, emulator.nulls_hz, emulator.covered, emulator)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file: arrays, units, version, and a checksum over names, shapes and bytes."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "line_hz": self.line_hz,
            "lines": self.lines,
            "calibration": self.calibration,
            "line_noise_variance": np.array(self.line_noise_variance),
            "time_s": self.time_s,
            "clipped": self.clipped,
            "carrier_hz": np.array(self.carrier_hz),
        }
        if self.places_m is not None:
            arrays["places_m"] = self.places_m
        head = {"format": _FORMAT, "version": _VERSION, "units": _UNITS, "checksum": _checksum(arrays)}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, header=np.array(json.dumps(head)), **cast("dict[str, Any]", arrays))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SoundingRecord:
        """Read what `save` wrote, or measured records in the same form.

        Raises
        ------
        ValueError
            Naming the file and the field that is missing, of the wrong shape or not what the checksum says.
        """
        arrays = _read(Path(path))

        def refuse(field: str, rule: str) -> ValueError:
            return ValueError(f"{path}: {field}: {rule}")

        def real(field: str, *shape: int) -> _Floats:
            value = arrays[field]
            if value.dtype.kind not in "fiu" or value.shape != shape:
                raise refuse(field, f"numbers of shape {shape} expected, got {value.dtype} {value.shape}")
            out: _Floats = np.asarray(value, dtype=np.float64)
            if not np.isfinite(out).all():
                raise refuse(field, "not all numbers are finite")
            return out

        line_hz = real("line_hz", *arrays["line_hz"].shape[:1])
        if len(line_hz) < 3 or not (np.diff(line_hz) > 0.0).all():
            raise refuse("line_hz", "at least three rising frequencies expected")
        lines, calibration = arrays["lines"], arrays["calibration"]
        if lines.ndim != 3 or lines.shape[2] != len(line_hz) or lines.dtype != np.complex128:
            raise refuse("lines", f"complex128 (n, L, {len(line_hz)}) expected, got {lines.dtype} {lines.shape}")
        if calibration.shape != line_hz.shape or calibration.dtype != np.complex128:
            raise refuse("calibration", f"complex128 ({len(line_hz)},) expected, got {calibration.shape}")
        if not np.isfinite(calibration).all():
            raise refuse("calibration", "not all numbers are finite")
        places = None
        if "places_m" in arrays:
            if arrays["places_m"].ndim != 2 or arrays["places_m"].shape[1] not in (2, 3):
                raise refuse("places_m", f"shape (n, 2) or (n, 3) expected, got {arrays['places_m'].shape}")
            places = real("places_m", lines.shape[0], arrays["places_m"].shape[1])
        variance = float(real("line_noise_variance"))
        if variance < 0.0:
            raise refuse("line_noise_variance", f"{variance}; it must be 0 or more")
        return cls(
            line_hz,
            lines,
            calibration,
            variance,
            real("time_s", *lines.shape[:2]),
            real("clipped", *lines.shape[:2]).astype(np.int64),
            places,
            float(real("carrier_hz")),
        )

    def __repr__(self) -> str:
        n, ports, m = self.lines.shape
        step = float(np.diff(self.line_hz).mean()) / 1e3
        return f"SoundingRecord({n} places x {ports} ports, {m} lines every {step:g} kHz)"


def _checksum(arrays: dict[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        value = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {value.dtype.str} {value.shape}".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def _read(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Arrays of a sounding file whose header and checksum hold."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except (zipfile.BadZipFile, ValueError, EOFError, KeyError, OSError, AttributeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{path}: an NPZ file of arrays expected ({error})") from None
    try:
        head = json.loads(str(arrays.pop("header")))
        kind, version, checksum = head["format"], head["version"], head["checksum"]
        units = head["units"]
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: header: format, version, units and checksum expected") from None
    if kind != _FORMAT:
        raise ValueError(f"{path}: header: format {kind!r}; {_FORMAT!r} expected")
    if version != _VERSION:
        raise ValueError(f"{path}: header: version {version!r}; {_VERSION} expected")
    if units != _UNITS:
        raise ValueError(f"{path}: header: units {units}; {_UNITS} expected")
    for name in ("line_hz", "lines", "calibration", "line_noise_variance", "time_s", "clipped", "carrier_hz"):
        if name not in arrays:
            raise ValueError(f"{path}: {name}: missing")
    if _checksum(arrays) != checksum:
        raise ValueError(f"{path}: checksum: the arrays are not those that were written")
    return arrays


@dataclass(frozen=True)
class ToneSweep:
    """Channel gains by a stepped tone.

    Attributes
    ----------
    frequencies_hz : ndarray, shape (f,)
    gain : ndarray, shape (n, L, f), complex128
        Each frequency under a phase of its own, the same at all places and ports, unless `phase_known`.
    phase_known : bool
        A reference channel was measured under each lock.
    """

    frequencies_hz: _Floats
    gain: _Complex
    phase_known: bool

    @property
    def magnitude(self) -> _Floats:
        """What a sweep tells in any case, shape (n, L, f)."""
        return np.abs(self.gain)

    def __repr__(self) -> str:
        n, ports, f = self.gain.shape
        kind = "with phases" if self.phase_known else "magnitudes only"
        return f"ToneSweep({n} places x {ports} ports, {f} tones, {kind})"


class ChannelSounder:
    """A pulse transmitter with switched ports and the receiver that records its lines (nielsen section 5).

    Model: the pulse repeats every `period_s`, so the channel is sampled at lines 1/period apart. The receiver takes it
    at an intermediate frequency with a real 14-bit converter, adds `averages` periods up and transforms. Ports are
    switched one after the other; what the guard leaves of the port before, and the others at the isolation, is in the
    record. Pulse and carrier keep their phase: all slots share one, which the calibration over a cable takes out.

    Parameters
    ----------
    pulse_s, rise_s, period_s : float
        100 ns every 10 µs give lines every 100 kHz; the text also says 0.1 ms and 10 kHz. Nulls at multiples of
        1 / pulse.
    sample_rate_hz, if_hz, filter_hz : float
        Real samples; carrier of the pulse at the converter; -3 dB bandwidth of the filter before it.
    averages, calibration_averages : int
    snr_db : float
        Strongest line over the noise in a line, in one period, for a channel of `reference_gain`.
    reference_gain : float
        Channel amplitude that the receiver's gain is set for.
    adc_bits : int
        0 for no converter.
    headroom : float
        Converter's scale over the pulse's peak at the reference gain.
    guard_s, switch_time_s, isolation_db : float
        Wait after switching; time in which the port before fades by e; isolation of ports in the end.
    phase_noise_rad : float
        Of the synthesizers, from period to period.
    shared_reference : bool
        One oscillator serves both ends. If not, their phases drift apart by `clock_rad_per_sqrt_s`: averaging then
        destroys the record.
    clock_rad_per_sqrt_s : float
    carrier_hz : float
        Kept in the record.
    seed : int

    Raises
    ------
    ValueError
        For what is out of range, naming it.
    """

    def __init__(
        self,
        *,
        pulse_s: float = 100e-9,
        rise_s: float = 0.0,
        period_s: float = 10e-6,
        sample_rate_hz: float = 100e6,
        if_hz: float = 20e6,
        filter_hz: float = 24e6,
        averages: int = 1000,
        calibration_averages: int = 16000,
        snr_db: float = 40.0,
        reference_gain: float = 1.0,
        adc_bits: int = 14,
        headroom: float = 4.0,
        guard_s: float = 1e-3,
        switch_time_s: float = 50e-6,
        isolation_db: float = 80.0,
        phase_noise_rad: float = 0.005,
        shared_reference: bool = True,
        clock_rad_per_sqrt_s: float = 7.5,
        carrier_hz: float = 2.45e9,
        seed: int = 0,
    ) -> None:
        if not (carrier_hz > 0.0 and np.isfinite(carrier_hz)):
            raise ValueError(f"carrier_hz: {carrier_hz}; it must be positive")
        if seed < 0:
            raise ValueError(f"seed: {seed}; it must not be negative")
        self.carrier_hz = float(carrier_hz)
        self.averages = averages
        self.seed = seed
        self._core = _simulation.ChannelSounder(
            pulse_s=pulse_s,
            rise_s=rise_s,
            period_s=period_s,
            sample_rate_hz=sample_rate_hz,
            if_hz=if_hz,
            filter_hz=filter_hz,
            averages=averages,
            calibration_averages=calibration_averages,
            snr_db=snr_db,
            reference_gain=reference_gain,
            adc_bits=adc_bits,
            headroom=headroom,
            guard_s=guard_s,
            switch_time_s=switch_time_s,
            isolation_db=isolation_db,
            phase_noise_rad=phase_noise_rad,
            shared_reference=shared_reference,
            clock_rad_per_sqrt_s=clock_rad_per_sqrt_s,
            seed=seed,
        )

    @property
    def line_hz(self) -> _Floats:
        """Frequencies of the lines against the carrier, shape (m,)."""
        return self._core.line_hz

    @property
    def lines(self) -> _Complex:
        """Amplitudes of pulse and filter at the lines without noise, shape (m,)."""
        return self._core.lines

    @property
    def slot_s(self) -> float:
        """Guard and averages: how long a port is on."""
        return self._core.slot_s

    def record(
        self,
        channels: Sequence[Sequence[_Taps]],
        *,
        places_m: npt.ArrayLike | None = None,
        first_slot: int = 0,
    ) -> SoundingRecord:
        """Record channels, place after place, port after port.

        Parameters
        ----------
        channels : sequence of n sequences of L lists of (delay_s, gain)
            Of each place, the taps from each port; all places with as many ports. The receiver stands still meanwhile:
            the turntable moves between places.
        places_m : array_like, shape (n, 2) or (n, 3), optional
            Kept in the record.
        first_slot : int
            Of the session; slots of different numbers have independent noise.

        Returns
        -------
        SoundingRecord
            A channel that is not finite gives lines of NaN.
        """
        if first_slot < 0:
            raise ValueError(f"first_slot: {first_slot}; it must not be negative")
        places = None
        if places_m is not None:
            places = np.asarray(places_m, dtype=np.float64)
            if places.ndim != 2 or len(places) != len(channels) or places.shape[1] not in (2, 3):
                raise ValueError(f"places_m: shape ({len(channels)}, 2) or (.., 3) expected, got {places.shape}")
        rows = [[[(float(d), complex(g)) for d, g in taps] for taps in row] for row in channels]
        if not rows or not rows[0]:
            raise ValueError("channels: at least one place and one port expected")
        calibration, _ = self._core.calibrate()
        lines, time_s, clipped, finite = self._core.record(rows, first_slot)
        lines[finite == 0] = np.nan
        return SoundingRecord(
            self.line_hz,
            lines,
            calibration,
            self._core.line_noise_variance(self.averages),
            time_s,
            clipped,
            places,
            self.carrier_hz,
        )

    @staticmethod
    def sweep(
        channels: Sequence[Sequence[_Taps]],
        frequencies_hz: npt.ArrayLike,
        *,
        averages: int = 64,
        snr_db: float = 40.0,
        reference_gain: float = 1.0,
        adc_bits: int = 14,
        headroom: float = 4.0,
        reference_channel: bool = False,
        seed: int = 0,
    ) -> ToneSweep:
        """Step a tone through frequencies; at each, measure every place and port.

        Both synthesizers lose their phase whenever they retune, so a frequency's phase is unknown; under one lock it
        stays from place to place, which is what a synthetic array needs. A `reference_channel`, a cable measured
        under the same lock, makes phases comparable.

        Parameters
        ----------
        channels : as of `record`
        frequencies_hz : array_like, shape (f,)
            Against the carrier.
        averages : int
            Samples per tone, place and port.
        snr_db : float
            Of a sample at the `reference_gain`.
        """
        f = np.asarray(frequencies_hz, dtype=np.float64).reshape(-1)
        ports = len(channels[0]) if len(channels) else 0
        if not ports or any(len(row) != ports for row in channels) or not len(f):
            raise ValueError("channels, frequencies_hz: at least one of each, and as many ports at every place")
        truth = np.empty((len(channels) * ports, len(f)), dtype=np.complex128)
        for i, taps in enumerate(taps for row in channels for taps in row):
            delay = np.array([d for d, _ in taps], dtype=np.float64)
            gain = np.array([g for _, g in taps], dtype=np.complex128)
            with np.errstate(invalid="ignore"):
                truth[i] = np.exp(-2j * np.pi * np.outer(f, delay)) @ gain
        measured = _simulation.step_sweep(
            truth,
            averages=averages,
            snr_db=snr_db,
            reference_gain=reference_gain,
            adc_bits=adc_bits,
            headroom=headroom,
            reference_channel=reference_channel,
            seed=seed,
        )
        measured[~np.isfinite(truth)] = np.nan
        return ToneSweep(f, measured.reshape(len(channels), ports, len(f)), reference_channel)

    def __repr__(self) -> str:
        f = self.line_hz
        return f"ChannelSounder({len(f)} lines every {(f[1] - f[0]) / 1e3:g} kHz, {self.averages} averages)"
