"""GPS L1 C/A: codes, signals, acquisition, and what tracking loops make of them.

Samples are ``complex64``; random parts are named by a seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import gps as _gps
from soopnav_cpp._gps_acquisition import (
    Acquirer,
    Acquisition,
    AcquisitionStatus,
    AidedCorrelator,
    acquire,
    cell_loss,
    search_frequencies,
)

__all__ = [
    "CARRIER_HZ",
    "CHIP_RATE_HZ",
    "CODE_LENGTH",
    "Acquirer",
    "Acquisition",
    "AcquisitionStatus",
    "AidedCorrelator",
    "SatelliteSignal",
    "acquire",
    "ca_code",
    "cell_loss",
    "code_sigma_m",
    "phase_sigma_m",
    "phase_sigma_rad",
    "search_frequencies",
    "synthesize",
]

_Array = npt.NDArray[np.float64]

CARRIER_HZ = 1575.42e6
"""L1 [Hz]."""
CHIP_RATE_HZ = 1.023e6
"""Chips a second."""
CODE_LENGTH = 1023
"""Chips of a code, 1 ms."""


def ca_code(prn: int) -> npt.NDArray[np.int8]:
    """The C/A code of a satellite (IS-GPS-200 section 3.3.2.3).

    Parameters
    ----------
    prn : int
        1 … 37.

    Returns
    -------
    ndarray of int8, shape (1023,)
        +1 for a logical 0, -1 for a logical 1, in the order of transmission.

    Raises
    ------
    ValueError
        For another number.
    """
    return _gps.ca_code(prn)


@dataclass(frozen=True)
class SatelliteSignal:
    """One satellite's L1 C/A signal at an antenna.

    Attributes
    ----------
    prn : int
    delay_s : float
        When the code of data bit 0 begins, after the first sample; any sign.
    doppler_hz : float
        Positive when approaching; the code runs faster by as much.
    phase_cycles : float
        Of the carrier at the first sample.
    cn0_dbhz : float
        Carrier to noise density against noise of variance 1 a sample.
    bits : sequence of int
        +1 or -1, 20 ms each, repeated; empty: all +1.
    """

    prn: int
    delay_s: float = 0.0
    doppler_hz: float = 0.0
    phase_cycles: float = 0.0
    cn0_dbhz: float = 45.0
    bits: Sequence[int] = ()


def synthesize(
    signals: Sequence[SatelliteSignal],
    samples: int,
    sample_rate_hz: float,
    *,
    intermediate_hz: float = 0.0,
    first: int = 0,
    seed: int | None = None,
    stream: int = 0,
) -> npt.NDArray[np.complex64]:
    """The sum of satellites' signals: code, data, carrier, Doppler (carter section 2.2); chips are rectangular.

    Parameters
    ----------
    signals : sequence of SatelliteSignal
    samples : int
    sample_rate_hz : float
        Any.
    intermediate_hz : float
        Where the carrier without Doppler lies in the samples.
    first : int
        Number of the first sample: blocks join without a seam.
    seed, stream : int, optional
        Noise of variance 1 a sample, named by these; without a seed none.

    Returns
    -------
    ndarray of complex64, shape (samples,)
        A satellite's amplitude is sqrt(10^(C/N0 / 10) / sample_rate_hz).

    Raises
    ------
    ValueError
        For a satellite without code, numbers out of range and bits other than +1 and -1.
    """
    rows = np.array([[s.prn, s.delay_s, s.doppler_hz, s.phase_cycles, s.cn0_dbhz] for s in signals], dtype=np.float64)
    return _gps.synthesize(
        rows.reshape(-1, 5),
        [[int(bit) for bit in s.bits] for s in signals],
        samples,
        sample_rate_hz=sample_rate_hz,
        intermediate_hz=intermediate_hz,
        first=first,
        seed=seed,
        stream=stream,
    )


def phase_sigma_rad(
    cn0_dbhz: npt.ArrayLike,
    *,
    bandwidth_hz: float = 15.0,
    power_fraction: float = 1.0,
    oscillator_rad: float = 0.0,
    dynamics_rad: float = 0.0,
    integration_s: float = math.inf,
) -> _Array:
    """Standard deviation of a carrier loop's phase (carter eq. 2.23 and 2.24; the print calls the variance σ).

    σ² = B_l / (γ C/N0) · (1 + 1 / (2 T γ C/N0)) + oscillator² + dynamics²; the paper leaves the squaring loss out,
    as an infinite T does.

    Parameters
    ----------
    cn0_dbhz : array_like
    bandwidth_hz : float
        B_l.
    power_fraction : float
        γ, share of the signal's power in the component tracked.
    oscillator_rad, dynamics_rad : float
        Phase noise of the oscillator; change of phase during a loop update.
    integration_s : float
        T.

    Returns
    -------
    ndarray, shape of `cn0_dbhz`
    """
    return _gps.phase_sigma_rad(
        np.asarray(cn0_dbhz, dtype=np.float64),
        bandwidth_hz=bandwidth_hz,
        power_fraction=power_fraction,
        oscillator_rad=oscillator_rad,
        dynamics_rad=dynamics_rad,
        integration_s=integration_s,
    )


def phase_sigma_m(
    cn0_dbhz: npt.ArrayLike,
    *,
    bandwidth_hz: float = 15.0,
    power_fraction: float = 1.0,
    oscillator_rad: float = 0.0,
    dynamics_rad: float = 0.0,
    integration_s: float = math.inf,
    carrier_hz: float = CARRIER_HZ,
) -> _Array:
    """`phase_sigma_rad` as a length, times λ / 2π [m]."""
    sigma = phase_sigma_rad(
        cn0_dbhz,
        bandwidth_hz=bandwidth_hz,
        power_fraction=power_fraction,
        oscillator_rad=oscillator_rad,
        dynamics_rad=dynamics_rad,
        integration_s=integration_s,
    )
    return np.asarray(sigma * (299_792_458.0 / (2.0 * math.pi * carrier_hz)))


def code_sigma_m(
    cn0_dbhz: npt.ArrayLike,
    *,
    bandwidth_hz: float = 0.5,
    early_late_chips: float = 0.5,
    integration_s: float = 20e-3,
) -> _Array:
    """Standard deviation of a code loop's pseudorange, early-minus-late power in wide bandwidth [m].

    σ² = (B d / (2 C/N0)) (1 + 2 / ((2 - d) T C/N0)) chips² (Kaplan and Hegarty, Understanding GPS, 2nd ed., eq. 5.14
    simplified for unlimited bandwidth).

    Parameters
    ----------
    cn0_dbhz : array_like
    bandwidth_hz : float
        B.
    early_late_chips : float
        d, between early and late.
    integration_s : float
        T.

    Returns
    -------
    ndarray, shape of `cn0_dbhz`
    """
    return _gps.code_sigma_m(
        np.asarray(cn0_dbhz, dtype=np.float64),
        bandwidth_hz=bandwidth_hz,
        early_late_chips=early_late_chips,
        integration_s=integration_s,
    )
