"""Phasors that a handset sees along its path."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp.clock import TwoState

__all__ = ["ApertureSnapshots", "aperture_snapshots", "drift_path"]

_Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ApertureSnapshots:
    """Phasors along a path, and the truth behind them.

    Attributes
    ----------
    phasors : ndarray, shape (n, L), complex128
        Noise of variance 1.
    path_m : ndarray, shape (n, 2)
        As dead reckoning reports it.
    true_path_m : ndarray, shape (n, 2)
    time_s, phase_rad : ndarray, shape (n,)
        The receiver's phase, not wrapped.
    """

    phasors: npt.NDArray[np.complex128]
    path_m: _Floats
    true_path_m: _Floats
    time_s: _Floats
    phase_rad: _Floats


def drift_path(path_m: npt.ArrayLike, sigma_m_per_sqrt_step: float, *, seed: int) -> _Floats:
    """A path, shape (n, 2), as dead reckoning reports it: each step off by a normal error per axis, the start right."""
    return _simulation.drift_path(path_m, sigma_m_per_sqrt_step, seed)


def aperture_snapshots(
    path_m: npt.ArrayLike,
    bearing_rad: npt.ArrayLike,
    wavelength_m: npt.ArrayLike = 0.15,
    *,
    snr_db: npt.ArrayLike = 10.0,
    k_factor_db: npt.ArrayLike = np.inf,
    frequency_hz: npt.ArrayLike = 0.0,
    time_s: npt.ArrayLike | None = None,
    clock: TwoState | None = None,
    phase_rad: npt.ArrayLike | None = None,
    path_sigma_m_per_sqrt_step: float = 0.0,
    waves: int = 24,
    seed: int,
) -> ApertureSnapshots:
    """What a handset hears of nodes along a path.

    Parameters
    ----------
    path_m : array_like, shape (n, 2)
        The true one.
    bearing_rad : array_like, shape (L,)
        Of the direct waves.
    wavelength_m, snr_db, k_factor_db, frequency_hz : float or array_like, shape (L,)
        SNR of one phasor, all of the signal counted. K factor: infinity is line of sight, -infinity Rayleigh; the
        diffuse part is a sum of `waves` plane waves (Clarke), so it fades with the place.
    time_s : array_like, shape (n,), optional
        Without them snapshots are 40 ms apart.
    clock : TwoState, optional
        Of the receiver: its phase is that of its time at the first node's carrier.
    phase_rad : array_like, shape (n,), optional
        The receiver's phase instead.
    path_sigma_m_per_sqrt_step : float
        Of the path that is reported.
    seed : int

    Raises
    ------
    ValueError
        For values that are neither one nor one per node, and what C++ refuses, by name.
    """
    path = np.asarray(path_m, dtype=np.float64)
    times = np.asarray(0.04 * np.arange(len(path)) if time_s is None else time_s, dtype=np.float64)
    bearing = np.atleast_1d(np.asarray(bearing_rad, dtype=np.float64))

    def of_nodes(name: str, value: npt.ArrayLike) -> _Floats:
        values = np.asarray(value, dtype=np.float64)
        if values.shape not in ((), (1,), bearing.shape):
            raise ValueError(f"{name}: shape {values.shape}; one number, or {len(bearing)}, one per node, expected")
        return np.ascontiguousarray(np.broadcast_to(values, bearing.shape))

    wavelength = of_nodes("wavelength_m", wavelength_m)
    if clock is not None and phase_rad is not None:
        raise ValueError("clock, phase_rad: only one of them says the receiver's phase")
    phase: _Floats = np.zeros(len(times)) if phase_rad is None else np.asarray(phase_rad, dtype=np.float64)
    if clock is not None:
        bias_m = clock.simulate_at(times - times[0], seed=seed).bias_m
        phase = np.asarray(-2.0 * np.pi / wavelength[0] * (bias_m - bias_m[0]), dtype=np.float64)
    k_factor = np.minimum(10.0 ** (of_nodes("k_factor_db", k_factor_db) / 10.0), 1e300)
    phasors = _simulation.render_aperture(
        bearing,
        wavelength,
        10.0 ** (of_nodes("snr_db", snr_db) / 10.0),
        k_factor,
        of_nodes("frequency_hz", frequency_hz),
        path,
        times,
        phase,
        waves,
        seed,
    )
    reported = drift_path(path, path_sigma_m_per_sqrt_step, seed=seed ^ 0x5A17)
    return ApertureSnapshots(phasors, reported, path, times, phase)
