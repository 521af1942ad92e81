"""Calibration of an array's receivers from a tone: image, phases and amplitudes, kept in a file (carter 5.2)."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import array as _array

__all__ = ["CALIBRATION_VERSION", "Calibration", "CalibrationError", "array_id", "calibrate"]

_Floats = npt.NDArray[np.float64]
_Complex = npt.NDArray[np.complex128]
_Samples = npt.NDArray[np.complex64]

#: Of the files that `Calibration.save` writes; others are refused.
CALIBRATION_VERSION = 1
_FORMAT = "soopnav-calibration"
_NUMBERS = ("iq_gain", "iq_phase_rad", "tone_snr_db", "residual_rms", "image_sigma", "phase_sigma_rad")
_STATUS = _array.CalibrationStatus


class CalibrationError(ValueError):
    """A calibration cannot be made, read or used; the message says which channel or file, and why."""


def _positions(geometry: Any) -> _Floats:
    """Elements [m] of an array's geometry, its manifold, or the numbers themselves; always three columns."""
    inner = getattr(geometry, "geometry", geometry)
    positions = np.asarray(getattr(inner, "positions_m", inner), dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] not in (2, 3) or not np.isfinite(positions).all():
        raise CalibrationError(
            f"geometry: positions of shape {positions.shape}; a row of two or three metres per element is expected"
        )
    return np.pad(positions, ((0, 0), (0, 3 - positions.shape[1])))


def array_id(geometry: Any) -> str:
    """Sixteen hexadecimal digits that stand for the elements' places, to the micrometre, and their order.

    Parameters
    ----------
    geometry : ArrayGeometry, Manifold, or array_like of shape (M, 2) or (M, 3)
        Positions in metres.
    """
    micrometres = np.rint(_positions(geometry) * 1e6).astype("<i8") + 0
    return hashlib.sha256(micrometres.tobytes()).hexdigest()[:16]


@dataclasses.dataclass(frozen=True, repr=False)
class Calibration:
    """What is wrong with each channel of an array, and the array it belongs to.

    A channel makes of the true samples x first ``z = channel·x`` and then ``I' = Re z + Re dc``,
    ``Q' = iq_gain·(Im z·cos φ + Re z·sin φ) + Im dc`` with φ = `iq_phase_rad`; `apply` undoes it.

    Attributes
    ----------
    iq_gain, iq_phase_rad : ndarray, shape (M,)
        Amplitude of Q over I, and by how much Q leads its right angle to I.
    dc : ndarray, shape (M,), complex128
        Offsets, in units of the samples.
    channel : ndarray, shape (M,), complex128
        Amplitude and phase relative to the reference channel, which has 1.
    frequency_hz, sample_rate_hz, tone_hz : float
        Carrier and rate the channels were calibrated at; the tone as found.
    array_name, array_id : str
        The array's name, and `array_id` of its elements.
    tone_snr_db, residual_rms, image_sigma, phase_sigma_rad : ndarray, shape (M,)
        Of the tone over what the fit left, per sample; what it left; standard deviations of the image (an amplitude
        ratio) and of the phase of `channel`.
    version : int
    """

    iq_gain: _Floats
    iq_phase_rad: _Floats
    dc: _Complex
    channel: _Complex
    frequency_hz: float
    sample_rate_hz: float
    tone_hz: float
    array_name: str
    array_id: str
    tone_snr_db: _Floats
    residual_rms: _Floats
    image_sigma: _Floats
    phase_sigma_rad: _Floats
    version: int = CALIBRATION_VERSION

    @property
    def n_channels(self) -> int:
        """Channels, M."""
        return len(self.iq_gain)

    @property
    def image_db(self) -> _Floats:
        """Image over signal of the channels as they are, shape (M,)."""
        imbalance = self.iq_gain * np.exp(-1j * self.iq_phase_rad)
        with np.errstate(divide="ignore"):
            return np.asarray(20.0 * np.log10(np.abs((1.0 - imbalance) / (1.0 + imbalance))), dtype=np.float64)

    def apply(self, iq: _Samples) -> _Samples:
        """Samples as channels without fault would have taken them.

        Parameters
        ----------
        iq : ndarray, shape (M, n), complex64
            NaN stays NaN.

        Returns
        -------
        ndarray, shape (M, n), complex64
        """
        iq = np.asarray(iq)
        if iq.ndim != 2 or iq.shape[0] != self.n_channels:
            raise CalibrationError(
                f"iq: shape {iq.shape}; ({self.n_channels}, n), a row per calibrated channel, is expected"
            )
        flat = _array.apply_correction(
            iq.reshape(-1), self.iq_gain.tolist(), self.iq_phase_rad.tolist(), self.dc.tolist(), self.channel.tolist()
        )
        return flat.reshape(iq.shape)

    def check(
        self,
        geometry: Any = None,
        frequency_hz: float | None = None,
        sample_rate_hz: float | None = None,
        *,
        frequency_tolerance_hz: float = 1e3,
        where: str = "calibration",
    ) -> None:
        """Raise `CalibrationError` where array, carrier or sampling rate are others; what is None is not looked at."""
        if geometry is not None and array_id(geometry) != self.array_id:
            name = getattr(getattr(geometry, "geometry", geometry), "name", "") or "another"
            raise CalibrationError(
                f"{where}: made for array {self.array_name or 'without a name'!r} ({self.n_channels} elements, id "
                f"{self.array_id}), not for {name!r} ({len(_positions(geometry))} elements, id {array_id(geometry)})"
            )
        if frequency_hz is not None and not abs(frequency_hz - self.frequency_hz) <= frequency_tolerance_hz:
            raise CalibrationError(
                f"{where}: made at {self.frequency_hz / 1e6:.6f} MHz, not at {frequency_hz / 1e6:.6f} MHz"
            )
        if sample_rate_hz is not None and not abs(sample_rate_hz / self.sample_rate_hz - 1.0) <= 1e-6:
            raise CalibrationError(
                f"{where}: made at {self.sample_rate_hz:g} samples per second, not at {sample_rate_hz:g}"
            )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the calibration as JSON; returns the path."""
        channels = []
        for m in range(self.n_channels):
            channel: dict[str, Any] = {name: float(getattr(self, name)[m]) for name in _NUMBERS}
            channel |= {name: [getattr(self, name)[m].real, getattr(self, name)[m].imag] for name in ("dc", "channel")}
            channels.append(channel)
        document = {
            "format": _FORMAT,
            "version": self.version,
            "array": {"name": self.array_name, "id": self.array_id},
            "frequency_hz": self.frequency_hz,
            "sample_rate_hz": self.sample_rate_hz,
            "tone_hz": self.tone_hz,
            "channels": channels,
        }
        target = Path(path)
        target.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
        return target

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        geometry: Any = None,
        frequency_hz: float | None = None,
        sample_rate_hz: float | None = None,
        frequency_tolerance_hz: float = 1e3,
    ) -> Calibration:
        """Read a calibration, and refuse one that was made for something else.

        Parameters
        ----------
        path : path
            As `save` wrote it.
        geometry : ArrayGeometry, Manifold or array_like of shape (M, 2|3), optional
            The array in use. Its carrier counts as `frequency_hz` unless that is given.
        frequency_hz, sample_rate_hz : float, optional
            In use.
        frequency_tolerance_hz : float

        Raises
        ------
        CalibrationError
            (a ``ValueError``) for a file that is no calibration, of another version, for another array, carrier or
            rate, or with numbers that cannot be undone; it names both sides.
        FileNotFoundError
        """
        given = Path(path)
        if not given.is_file():
            raise FileNotFoundError(f"{given}: no such file")
        try:
            document = json.loads(given.read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise CalibrationError(f"{given}: not JSON ({error}); a calibration expected") from error
        if not isinstance(document, dict) or document.get("format") != _FORMAT:
            raise CalibrationError(f"{given}: not a calibration; 'format' must be {_FORMAT!r}")
        if document.get("version") != CALIBRATION_VERSION:
            raise CalibrationError(
                f"{given}: version {document.get('version')!r}; version {CALIBRATION_VERSION} is read. Calibrate anew"
            )
        out = _parsed(document, given)
        if frequency_hz is None and geometry is not None:
            frequency_hz = getattr(getattr(geometry, "geometry", geometry), "frequency_hz", None)
        out.check(
            geometry,
            frequency_hz,
            sample_rate_hz,
            frequency_tolerance_hz=frequency_tolerance_hz,
            where=str(given),
        )
        return out

    def __repr__(self) -> str:
        return (
            f"Calibration({self.n_channels} channels of {self.array_name or 'an array'!r} at "
            f"{self.frequency_hz / 1e6:g} MHz, image {self.image_db.max():.1f} dB at worst before)"
        )


def _number(value: object, place: str, *, positive: bool = False) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise CalibrationError(f"{place} is {value!r}; a finite number expected")
    if positive and value <= 0.0:
        raise CalibrationError(f"{place} is {value!r}; it must be above zero")
    return float(value)


def _pair(value: object, place: str) -> complex:
    if not isinstance(value, list) or len(value) != 2:
        raise CalibrationError(f"{place} is {value!r}; real and imaginary part expected")
    return complex(_number(value[0], place), _number(value[1], place))


def _parsed(document: dict[str, Any], path: Path) -> Calibration:
    described, channels = document.get("array"), document.get("channels")
    if not isinstance(described, dict) or not all(isinstance(described.get(key), str) for key in ("name", "id")):
        raise CalibrationError(f"{path}: array must say its name and id")
    if not isinstance(channels, list) or not channels or not all(isinstance(row, dict) for row in channels):
        raise CalibrationError(f"{path}: channels must be a list with an object per channel")
    rows: dict[str, list[Any]] = {name: [] for name in (*_NUMBERS, "dc", "channel")}
    for m, row in enumerate(channels):
        place = f"{path}: channels[{m}]"
        for name in _NUMBERS:
            rows[name].append(_number(row.get(name), f"{place}.{name}", positive=name == "iq_gain"))
        for name in ("dc", "channel"):
            rows[name].append(_pair(row.get(name), f"{place}.{name}"))
        if not abs(rows["iq_phase_rad"][-1]) < 1.4:
            raise CalibrationError(f"{place}.iq_phase_rad is {rows['iq_phase_rad'][-1]:g}; it must be within 1.4")
        if rows["channel"][-1] == 0.0:
            raise CalibrationError(f"{place}.channel is 0; a channel without gain cannot be corrected")
    numbers: dict[str, Any] = {name: np.array(values) for name, values in rows.items()}
    return Calibration(
        **numbers,
        frequency_hz=_number(document.get("frequency_hz"), f"{path}: frequency_hz", positive=True),
        sample_rate_hz=_number(document.get("sample_rate_hz"), f"{path}: sample_rate_hz", positive=True),
        tone_hz=_number(document.get("tone_hz"), f"{path}: tone_hz"),
        array_name=described["name"],
        array_id=described["id"],
    )


def calibrate(
    iq: _Samples,
    sample_rate_hz: float,
    tone_hz: float,
    geometry: Any,
    *,
    frequency_hz: float | None = None,
    reference: int = 0,
    tolerance_hz: float = 0.0,
) -> Calibration:
    """Find what each channel does to a tone that reaches all of them with the same phase (carter 5.2).

    Least squares of an ellipse per channel, with one frequency for all: image, offset, amplitude and phase. From 10⁴
    samples at 30 dB the image of another tone is below -50 dB, and phases are right to 0.2°.

    Parameters
    ----------
    iq : ndarray, shape (M, n), complex64
        Of a tone on a cable to every receiver, or from a source at the zenith of a level array.
    sample_rate_hz : float
    tone_hz : float
        Baseband frequency of the tone, off 0 Hz. It is searched for around here.
    geometry : ArrayGeometry, Manifold or array_like of shape (M, 2|3)
        The array, for the file: elements [m].
    frequency_hz : float, optional
        Carrier; the geometry's by default.
    reference : int
        The channel whose amplitude and phase stay.
    tolerance_hz : float
        How far the tone may be off; 0 for four turns per capture.

    Returns
    -------
    Calibration

    Raises
    ------
    CalibrationError
        (a ``ValueError``) for too few samples, a channel that is not finite, dead, saturated, or without the tone: it
        names the channel and what was found.
    """
    positions = _positions(geometry)
    iq = np.asarray(iq)
    if iq.ndim != 2 or iq.shape[0] != len(positions):
        raise CalibrationError(
            f"iq: shape {iq.shape}; ({len(positions)}, n), a row per element of the array, is expected"
        )
    inner = getattr(geometry, "geometry", geometry)
    carrier = getattr(inner, "frequency_hz", None) if frequency_hz is None else frequency_hz
    if carrier is None:
        raise CalibrationError("frequency_hz: positions alone do not say the carrier; give it")
    if not (math.isfinite(carrier) and carrier > 0.0):
        raise CalibrationError(f"frequency_hz: {carrier}; a positive finite frequency is expected")
    report = _array.calibrate(
        iq.reshape(-1), iq.shape[0], sample_rate_hz, tone_hz, reference=reference, tolerance_hz=tolerance_hz
    )
    if report.status != _STATUS.OK:
        raise CalibrationError(_sentence(report, iq, sample_rate_hz, tone_hz))
    return Calibration(
        iq_gain=report.iq_gain,
        iq_phase_rad=report.iq_phase_rad,
        dc=report.dc,
        channel=report.gain,
        frequency_hz=float(carrier),
        sample_rate_hz=float(sample_rate_hz),
        tone_hz=report.tone_hz,
        array_name=str(getattr(inner, "name", "")),
        array_id=array_id(positions),
        tone_snr_db=report.tone_snr_db,
        residual_rms=report.residual_rms,
        image_sigma=report.image_sigma,
        phase_sigma_rad=report.phase_sigma_rad,
    )


def _sentence(report: _array.CalibrationReport, iq: _Samples, sample_rate_hz: float, tone_hz: float) -> str:
    status, value, tone = report.status, report.value, f"the tone at {tone_hz:g} Hz"
    start = f"iq: channel {report.channel}"
    if status == _STATUS.TOO_FEW_SAMPLES:
        distance = min(abs(tone_hz), 0.5 * sample_rate_hz - abs(tone_hz))
        return (
            f"iq: {iq.shape[1]} samples hold {distance / sample_rate_hz * iq.shape[1]:.1f} turns of {tone}, or of its "
            "distance to half the sampling rate; 64 samples and 4 turns at least are needed"
        )
    if status == _STATUS.NON_FINITE:
        return f"{start}, sample {int(value)} is not finite"
    if status == _STATUS.DEAD_CHANNEL:
        level = f"{value:.0f} dB below the strongest" if math.isfinite(value) else "it never changes"
        return f"{start} is dead: {level}"
    if status == _STATUS.WEAK_TONE:
        return (
            f"{start}: {tone} stands {value:.1f} dB over the rest of the channel; 10 dB at least are needed. Is it "
            "there, and is tone_hz right?"
        )
    if status == _STATUS.SATURATED:
        return (
            f"{start} is saturated: {100.0 * value:.0f} % of its samples lie at the ends of its range, and the tone "
            "reaches beyond; attenuate it"
        )
    return (
        f"{start}: the image of {tone} is {value:.1f} dB, nearly as strong as itself; are the samples complex, and has "
        "tone_hz the right sign?"
    )
