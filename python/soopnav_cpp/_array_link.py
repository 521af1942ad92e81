"""What an array of antennas hears of radio emitters: powers, samples, sample covariances; and its front end."""

from __future__ import annotations

import importlib
import warnings
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation

__all__ = ["ArrayLink", "FrontEnd", "down_convert", "far_field_limit_m"]

_Floats = npt.NDArray[np.float64]
_Samples = npt.NDArray[np.complex64]
_Matrix = npt.NDArray[np.complex128]


_MOST_DB = 300.0  # samples are of single precision


class Steers(Protocol):
    """What `ArrayLink` needs of an array: `soopnav_cpp.array.Manifold` and anything like it."""

    def steering(self, azimuth_rad: Any, elevation_rad: Any) -> npt.NDArray[np.complex128]:
        """Columns of shape (elements, n) for n directions."""


def far_field_limit_m(aperture_m: float, frequency_hz: float) -> float:
    """Distance beyond which waves are flat across an aperture: the largest of 1.6 λ, 2 D²/λ and 5 D (carter 4.1-4.3).

    (4.1) and (4.3) read "much greater": a few times this is safe.
    """
    return _simulation.far_field_limit_m(aperture_m, frequency_hz)


def down_convert(
    radio: npt.ArrayLike, sample_rate_hz: float, lo_hz: float, *, decimation: int, lo_phase_rad: float = 0.0
) -> _Samples:
    """Mix a real radio-frequency signal to baseband and decimate it (carter 2.5-2.7).

    Parameters
    ----------
    radio : array_like, shape (n,)
        Real samples; a signal A cos(2π f t + φ) comes out as A exp(j (2π (f - lo_hz) t + φ)).
    sample_rate_hz, lo_hz : float
        Below half the rate the oscillator's frequency.
    decimation : int, 2 to 1024
        Output rate = sample_rate_hz / decimation; 0.8 of its band is kept.
    lo_phase_rad : float

    Returns
    -------
    ndarray, shape (ceil(n / decimation),), complex64
    """
    return _simulation.down_convert(radio, sample_rate_hz, lo_hz, decimation=decimation, lo_phase_rad=lo_phase_rad)


def _per_channel(value: npt.ArrayLike, channels: int, dtype: type) -> list[Any]:
    numbers: npt.NDArray[Any] = np.asarray(value, dtype)
    return list(np.broadcast_to(numbers, (channels,)) if numbers.ndim == 0 else numbers)


class FrontEnd:
    """Receivers in a row: attenuator, phase shifter, gain, thermal noise, quadrature mixer, converter (carter 5.1-5.2).

    Each sample x of a channel, in root milliwatts at the antenna, becomes ``y = gain·exp(-j·phase)·x + noise`` and then
    ``I' = Re y + Re dc``, ``Q' = g·(Im y·cos φ + Re y·sin φ) + Im dc``, g being `iq_gain_db` as an amplitude and φ
    `iq_phase_rad`; full scale is 1.0. Numbers per channel may be given once for all.

    Parameters
    ----------
    channels : int
    gain : complex, or (channels,)
        Of cable, amplifier and filter.
    phase_delay_rad : float, or (channels,)
        Wanted of the phase shifters: positive is later.
    iq_gain_db, iq_phase_rad : float, or (channels,)
        Gain of Q over I; by how much Q leads its right angle to I, at most 1 rad.
    dc : complex, or (channels,)
        Offsets of I and Q.
    sample_rate_hz, noise_figure_db : float
        The noise floor k·T0·B·F (carter 2.4).
    attenuation_db, attenuator_step_db : float
        Whole steps attenuate; the rest worsens the SNR by added noise (carter 5.1).
    phase_step_rad : float
        Of the phase shifters; 0 for any phase.
    adc_bits : int
        2 to 24 per part, 0 for no converter.
    full_scale_dbm : float, optional
        Power of the tone that reaches 1.0; without it 40 dB above the noise floor.

    Raises
    ------
    ValueError
        For a value out of its range, naming it.
    """

    def __init__(
        self,
        channels: int,
        *,
        gain: npt.ArrayLike = 1.0,
        phase_delay_rad: npt.ArrayLike = 0.0,
        iq_gain_db: npt.ArrayLike = 0.0,
        iq_phase_rad: npt.ArrayLike = 0.0,
        dc: npt.ArrayLike = 0.0,
        sample_rate_hz: float = 20e6,
        noise_figure_db: float = 6.0,
        attenuation_db: float = 0.0,
        attenuator_step_db: float = 1.0,
        phase_step_rad: float = 0.0,
        adc_bits: int = 0,
        full_scale_dbm: float | None = None,
    ) -> None:
        if channels < 1:
            raise ValueError(f"channels: {channels}; at least one is needed")
        self._core = _simulation.FrontEnd(
            channels,
            sample_rate_hz=sample_rate_hz,
            noise_figure_db=noise_figure_db,
            gain=_per_channel(gain, channels, complex),
            phase_delay_rad=_per_channel(phase_delay_rad, channels, float),
            iq_gain_db=_per_channel(iq_gain_db, channels, float),
            iq_phase_rad=_per_channel(iq_phase_rad, channels, float),
            dc=_per_channel(dc, channels, complex),
            attenuation_db=attenuation_db,
            attenuator_step_db=attenuator_step_db,
            phase_step_rad=phase_step_rad,
            adc_bits=adc_bits,
            full_scale_dbm=full_scale_dbm,
        )

    @property
    def channels(self) -> int:
        """Number of receivers."""
        return self._core.channels

    @property
    def noise_floor_dbm(self) -> float:
        """k·T0·B·F, before the noise that stands for the attenuator's rest."""
        return self._core.noise_floor_dbm

    @property
    def full_scale_dbm(self) -> float:
        """Power of the tone that reaches 1.0."""
        return self._core.full_scale_dbm

    @property
    def attenuation_db(self) -> tuple[float, float]:
        """What the attenuator's steps reach, and what is left to noise."""
        return self._core.stepped_attenuation_db, self._core.rest_attenuation_db

    @property
    def phase_delay_rad(self) -> _Floats:
        """What the phase shifters are set to, shape (channels,): the nearest steps."""
        return np.array([self._core.phase_delay_rad(m) for m in range(self.channels)])

    def apply(self, iq: _Samples, seed: int, stream: int = 0) -> _Samples:
        """Samples behind the front end.

        Parameters
        ----------
        iq : ndarray, shape (channels, n), complex64
            In root milliwatts: the mean of ``|iq|²`` is the power at the antenna.
        seed, stream : int
            Name the noise.

        Returns
        -------
        ndarray, shape (channels, n), complex64
            Full scale at 1.0.
        """
        return self.apply_counting(iq, seed, stream)[0]

    def apply_counting(self, iq: _Samples, seed: int, stream: int = 0) -> tuple[_Samples, int]:
        """As `apply`, and how many real and imaginary parts the converter clipped."""
        iq = np.asarray(iq)
        if iq.ndim != 2 or iq.shape[0] != self.channels:
            raise ValueError(f"iq: shape {iq.shape}; ({self.channels}, n), a row per channel, is expected")
        flat, clipped = self._core.apply(iq.reshape(-1), seed=seed, stream=stream)
        return flat.reshape(iq.shape), clipped

    def _apply_blocks(self, blocks: _Samples, seed: int, stream: int) -> _Samples:
        """Blocks (epochs, channels, n), each with noise of its own."""
        if blocks.shape[1] != self.channels:
            raise ValueError(f"front_end: {self.channels} channels for {blocks.shape[1]} elements; as many expected")
        if not len(blocks):
            return blocks
        return self._core.apply_blocks(blocks.reshape(-1), len(blocks), seed=seed, stream=stream).reshape(blocks.shape)

    def __repr__(self) -> str:
        return f"FrontEnd({self.channels} channels, noise floor {self.noise_floor_dbm:.1f} dBm)"


class ArrayLink:
    """From an emitter to the samples, or sample covariances, of an array (carter 5.1, figs. 5.4 and 5.8).

    Power: P_r = P_t + gains - splitter - delay system - free-space loss - excess; SNR is P_r over k·T0·B·F, for one
    element of unit steering and the whole band of the front end. Waves are plane and, unless `wideband`, narrow-band.

    Parameters
    ----------
    manifold : Manifold or ArrayGeometry
        Of `soopnav_cpp.array`; anything with ``steering(azimuth, elevation) -> (elements, n)`` serves.
    frequency_hz : float, optional
        Carrier; the array's, or GPS L1 where it says none.
    sample_rate_hz, noise_figure_db, transmit_power_dbm, transmit_gain_dbi, receive_gain_dbi : float
    splitter_loss_db, delay_system_loss_db, excess_loss_db : float
        Losses besides free space.
    waveform : {"noise", "tone"}
        Circular Gaussian, white over `bandwidth_ratio` of the band about 0 Hz; or a tone of random phase at `tone_hz`.
    bandwidth_ratio : float, above 0 and at most 1
        The power is the same whatever it is.
    tone_hz : float
    wideband : bool
        Delay the envelope too, element by element. Needs an array that says its positions.

    Raises
    ------
    ValueError
        For a value out of its range, naming it.
    """

    def __init__(
        self,
        manifold: Any,
        *,
        frequency_hz: float | None = None,
        sample_rate_hz: float = 20e6,
        noise_figure_db: float = 6.0,
        transmit_power_dbm: float = 10.0,
        transmit_gain_dbi: float = 0.0,
        receive_gain_dbi: float = 0.0,
        splitter_loss_db: float = 0.0,
        delay_system_loss_db: float = 0.0,
        excess_loss_db: float = 0.0,
        waveform: str = "noise",
        bandwidth_ratio: float = 1.0,
        tone_hz: float = 0.0,
        wideband: bool = False,
    ) -> None:
        geometry = getattr(manifold, "geometry", manifold)
        self.manifold: Steers = manifold if hasattr(manifold, "steering") else _ideal(manifold)
        self.sample_rate_hz = float(sample_rate_hz)
        self.waveform = waveform
        self.bandwidth_ratio = float(bandwidth_ratio)
        self.tone_hz = float(tone_hz)
        self._positions_m = np.asarray(geometry.positions_m, float) if hasattr(geometry, "positions_m") else None
        if wideband and self._positions_m is None:
            raise ValueError("wideband: True, but the array does not say its positions_m")
        self.wideband = wideband
        carrier = getattr(geometry, "frequency_hz", 1575.42e6) if frequency_hz is None else frequency_hz
        self.frequency_hz = float(carrier)
        self._budget = _simulation.LinkBudget(
            frequency_hz=self.frequency_hz,
            sample_rate_hz=sample_rate_hz,
            noise_figure_db=noise_figure_db,
            transmit_power_dbm=transmit_power_dbm,
            transmit_gain_dbi=transmit_gain_dbi,
            receive_gain_dbi=receive_gain_dbi,
            splitter_loss_db=splitter_loss_db,
            delay_system_loss_db=delay_system_loss_db,
            excess_loss_db=excess_loss_db,
        )
        # Refuses now what the first block would refuse.
        _simulation.array_samples(
            np.zeros((0, 1, 1, 2)),
            np.zeros((0, 1)),
            samples=1,
            sample_rate_hz=self.sample_rate_hz,
            waveform=waveform,
            bandwidth_ratio=self.bandwidth_ratio,
            tone_hz=self.tone_hz,
            seed=0,
        )

    # ---- Powers

    @property
    def noise_floor_dbm(self) -> float:
        """k·T0·B·F (carter 2.4)."""
        return self._budget.noise_floor_dbm

    def received_power_dbm(self, distance_m: npt.ArrayLike) -> Any:
        """Power at an element of unit steering (carter 5.1); a float for a number, otherwise an array of the shape."""
        distance = np.asarray(distance_m, float)
        power = self._budget.received_power_dbm(distance.reshape(-1)).reshape(distance.shape)
        return float(power) if distance.ndim == 0 else power

    def snr_db(self, distance_m: npt.ArrayLike) -> Any:
        """Signal over noise of one element over the whole band; as `received_power_dbm`."""
        return self.received_power_dbm(distance_m) - self.noise_floor_dbm

    # ---- Geometry

    def directions(
        self, positions_m: npt.ArrayLike, emitter_m: npt.ArrayLike, rotation: npt.ArrayLike | None = None
    ) -> tuple[_Floats, _Floats, _Floats]:
        """Where the array sees an emitter (figs. 5.4 and 5.8).

        Parameters
        ----------
        positions_m : array_like, shape (n, 3)
            Of the array, local metres.
        emitter_m : array_like, shape (3,) or (n, 3)
        rotation : array_like, shape (3, 3) or (n, 3, 3), optional
            Columns are the array's axes in local ones: local = rotation @ array. Without it the axes agree.

        Returns
        -------
        azimuth_rad, elevation_rad, distance_m : ndarray, shape (n,)
            In array axes. A warning says when an emitter is nearer than the far field.
        """
        positions = np.atleast_2d(np.asarray(positions_m, float))
        offset = np.asarray(emitter_m, float) - positions
        if positions.shape[1] != 3 or offset.shape != positions.shape:
            raise ValueError(
                f"positions_m, emitter_m: shapes {np.shape(positions_m)} and {np.shape(emitter_m)}; rows of three "
                "numbers, and one emitter or as many, are expected"
            )
        distance = np.sqrt(np.sum(offset**2, axis=1))
        if not (distance > 0.0).all():
            raise ValueError(f"positions_m: row {int(np.argmin(distance > 0.0))} is not finite, or lies on the emitter")
        if rotation is not None:
            if not np.isfinite(np.asarray(rotation, float)).all():
                raise ValueError("rotation: not finite; matrices of finite numbers are expected")
            offset = np.einsum("...ij,...i->...j", np.asarray(rotation, float), offset)
        if self._positions_m is not None:
            spread = self._positions_m[:, None, :] - self._positions_m[None, :, :]
            limit = far_field_limit_m(float(np.sqrt((spread**2).sum(-1)).max()), self.frequency_hz)
            if distance.min() < limit:
                warnings.warn(
                    f"emitter_m: {distance.min():.3g} m from the array, nearer than its far field of {limit:.3g} m; "
                    "plane waves do not hold there",
                    stacklevel=2,
                )
        azimuth = np.arctan2(offset[:, 1], offset[:, 0])
        elevation = np.arcsin(np.clip(offset[:, 2] / distance, -1.0, 1.0))
        return azimuth, elevation, distance

    # ---- Samples

    def _steering(self, azimuth: _Floats, elevation: _Floats) -> _Matrix:
        """Shape (epochs, waves, elements) of azimuth (epochs, waves)."""
        columns = np.asarray(self.manifold.steering(azimuth.reshape(-1), elevation.reshape(-1)), np.complex128)
        return np.ascontiguousarray(columns.T).reshape(*azimuth.shape, columns.shape[0])

    def _parts(self, azimuth: _Floats, elevation: _Floats) -> _Floats:
        """Steering as real and imaginary parts, shape (epochs, waves, elements, 2)."""
        steering = self._steering(azimuth, elevation)
        return np.stack([steering.real, steering.imag], axis=-1)

    def _delays(self, azimuth: _Floats, elevation: _Floats) -> _Floats | None:
        if not self.wideband or self._positions_m is None:
            return None
        cos = np.cos(elevation)
        towards = np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)], axis=-1)
        ahead_m: _Floats = towards[..., : self._positions_m.shape[1]] @ self._positions_m.T
        return -ahead_m / 299792458.0

    def blocks(
        self,
        azimuth_rad: npt.ArrayLike,
        elevation_rad: npt.ArrayLike,
        *,
        snr_db: npt.ArrayLike | None = None,
        power_dbm: npt.ArrayLike | None = None,
        n_samples: int = 2500,
        seed: int,
        stream: int = 0,
        front_end: FrontEnd | None = None,
    ) -> _Samples:
        """Samples of many epochs.

        Parameters
        ----------
        azimuth_rad, elevation_rad : array_like, shape (epochs,) or (epochs, waves)
            In array axes; several waves of an epoch are independent.
        snr_db : array_like, the same shape or one number
            Noise has unit power per element then. -inf is silence.
        power_dbm : array_like, the same shape or one number
            In place of snr_db, for a `front_end`, which adds the noise.
        n_samples : int
            Per epoch.
        seed, stream : int
            Same numbers, same samples. Epochs do not depend on each other.
        front_end : FrontEnd, optional

        Returns
        -------
        ndarray, shape (epochs, elements, n_samples), complex64
        """
        azimuth, elevation = _rows(azimuth_rad, "azimuth_rad"), _rows(elevation_rad, "elevation_rad")
        if azimuth.shape != elevation.shape:
            raise ValueError(
                f"azimuth_rad, elevation_rad: shapes {azimuth.shape} and {elevation.shape}; they must agree"
            )
        if (snr_db is None) == (power_dbm is None):
            raise ValueError("snr_db, power_dbm: one of them, and one only, is needed")
        if (front_end is None) != (power_dbm is None):
            raise ValueError("front_end: goes with power_dbm, as snr_db says the noise already")
        level = _like(
            snr_db if power_dbm is None else power_dbm, azimuth, "snr_db" if power_dbm is None else "power_dbm"
        )
        delays = self._delays(azimuth, elevation)
        samples = _simulation.array_samples(
            self._parts(azimuth, elevation),
            10.0 ** (level / 20.0),
            samples=n_samples,
            sample_rate_hz=self.sample_rate_hz,
            waveform=self.waveform,
            bandwidth_ratio=self.bandwidth_ratio,
            tone_hz=self.tone_hz,
            noise_variance=1.0 if front_end is None else 0.0,
            delay_s=delays,
            seed=seed,
            stream=stream,
        )
        if front_end is None:
            return samples
        # Another seed than that of the blocks above, and an epoch's noise is its stream's own.
        return front_end._apply_blocks(samples, seed ^ 0x5F3759DF, stream)

    def iq(
        self,
        azimuth_rad: npt.ArrayLike,
        elevation_rad: npt.ArrayLike,
        *,
        snr_db: npt.ArrayLike | None = None,
        power_dbm: npt.ArrayLike | None = None,
        n_samples: int = 2500,
        seed: int,
        stream: int = 0,
        front_end: FrontEnd | None = None,
    ) -> _Samples:
        """One block, shape (elements, n_samples): a number per direction, or (waves,) for several; else as `blocks`."""
        azimuth = np.atleast_1d(np.asarray(azimuth_rad, float))[None]
        elevation = np.atleast_1d(np.asarray(elevation_rad, float))[None]

        def one_row(level: npt.ArrayLike | None) -> npt.ArrayLike | None:
            return None if level is None else np.atleast_2d(np.asarray(level, float))

        blocks = self.blocks(
            azimuth,
            elevation,
            snr_db=one_row(snr_db),
            power_dbm=one_row(power_dbm),
            n_samples=n_samples,
            seed=seed,
            stream=stream,
            front_end=front_end,
        )
        block: _Samples = blocks[0]
        return block

    def observe(
        self,
        positions_m: npt.ArrayLike,
        emitter_m: npt.ArrayLike,
        *,
        rotation: npt.ArrayLike | None = None,
        n_samples: int = 2500,
        seed: int,
        stream: int = 0,
        front_end: FrontEnd | None = None,
    ) -> _Samples:
        """Poses to samples: `directions`, then `blocks` with the power of each distance."""
        azimuth, elevation, distance = self.directions(positions_m, emitter_m, rotation)
        if front_end is None:
            return self.blocks(
                azimuth, elevation, snr_db=self.snr_db(distance), n_samples=n_samples, seed=seed, stream=stream
            )
        power = self.received_power_dbm(distance)
        return self.blocks(
            azimuth, elevation, power_dbm=power, n_samples=n_samples, seed=seed, stream=stream, front_end=front_end
        )

    def covariances(
        self,
        snr_db: npt.ArrayLike,
        azimuth_rad: npt.ArrayLike,
        elevation_rad: npt.ArrayLike,
        n_snapshots: int = 2500,
        seed: int = 0,
        stream: int = 0,
    ) -> _Matrix:
        """Sample covariances from their exact law, without samples: white Gaussian waves in unit noise.

        n_snapshots·S has a complex Wishart law of n_snapshots degrees of freedom about R = I + Σ SNR·a·aᴴ. Some 2 µs
        each for four elements, whatever n_snapshots is.

        Parameters
        ----------
        snr_db : array_like, the shape of azimuth_rad or one number
        azimuth_rad, elevation_rad : array_like, shape (epochs,) or (epochs, waves)
        n_snapshots, seed, stream : int

        Returns
        -------
        ndarray, shape (epochs, elements, elements), complex128
        """
        azimuth, elevation = _rows(azimuth_rad, "azimuth_rad"), _rows(elevation_rad, "elevation_rad")
        if azimuth.shape != elevation.shape:
            raise ValueError(
                f"azimuth_rad, elevation_rad: shapes {azimuth.shape} and {elevation.shape}; they must agree"
            )
        return _simulation.sample_covariances(
            self._parts(azimuth, elevation),
            10.0 ** (_like(snr_db, azimuth, "snr_db") / 20.0),
            snapshots=n_snapshots,
            seed=seed,
            stream=stream,
        )

    def __repr__(self) -> str:
        return (
            f"ArrayLink({self.frequency_hz / 1e6:g} MHz, noise floor {self.noise_floor_dbm:.1f} dBm, {self.waveform})"
        )


def _ideal(geometry: Any) -> Steers:
    ideal: Steers = importlib.import_module("soopnav_cpp.array").Manifold(geometry)  # which imports this package
    return ideal


def _rows(values: npt.ArrayLike, name: str) -> _Floats:
    array = np.asarray(values, float)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise ValueError(f"{name}: shape {array.shape}; (epochs,) or (epochs, waves) is expected")
    return array


def _like(values: npt.ArrayLike | None, rows: _Floats, name: str) -> _Floats:
    array = np.asarray(values, float)
    if not (array <= _MOST_DB).all():
        raise ValueError(
            f"{name}: {array[~(array <= _MOST_DB)].flat[0]}; at most {_MOST_DB:g} dB, or -inf, is expected"
        )
    if array.ndim == 1 and rows.shape[1] == 1:
        array = array[:, None]
    try:
        return np.ascontiguousarray(np.broadcast_to(array, rows.shape))
    except ValueError:
        raise ValueError(f"{name}: shape {array.shape}; one number, or the shape of azimuth_rad, is expected") from None
