"""What happens to a signal between transmitter and file: noise, carrier offset, clock error, multipath, path loss;
whole OFDM links; arrays of antennas and their front ends; GNSS observables; trajectories, planar and in three
dimensions, and what an inertial unit says along them.

Samples are ``complex64``, C-contiguous; a new array comes back. Random parts are named by a seed: the same one gives
the same samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from soopnav_cpp._aperture_simulation import ApertureSnapshots, aperture_snapshots, drift_path
from soopnav_cpp._array_link import ArrayLink, FrontEnd, down_convert, far_field_limit_m
from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp._core.simulation import BoundarySeries, ImuErrorModel, OfdmLink, SensorErrorModel
from soopnav_cpp._fm import fm_waveform
from soopnav_cpp._gnss_simulation import GnssObservables, simulate_gnss
from soopnav_cpp._ground_scene import GroundObject, GroundScene, foot_tracks
from soopnav_cpp._handset_world import HandsetWorld, NlosSchedule
from soopnav_cpp._indoor import IndoorLinks, IndoorRoom, LinkStatus, Material, RoomWall, excess_delays, slab_response
from soopnav_cpp._opportunity_link import LinkBand, LinkSource, OpportunityLink
from soopnav_cpp._pair_link import ClockTrack, PairArrivals, PairLink, PairReceiver, PairSnippets, PairTruth
from soopnav_cpp._sounding import ChannelSounder, EmulatedChannels, SoundingRecord, ToneSweep, subcarrier_hz, turntable
from soopnav_cpp._spatial_trajectory import Oscillation, SpatialMotion, SpatialTrajectory
from soopnav_cpp._trajectory import PlanarImuSeries, PlanarMotion, PlanarTrajectory

__all__ = [
    "ApertureSnapshots",
    "ArrayLink",
    "BoundarySeries",
    "ChannelSounder",
    "ClockTrack",
    "EmulatedChannels",
    "FrontEnd",
    "GnssObservables",
    "GroundObject",
    "GroundScene",
    "HandsetWorld",
    "ImuErrorModel",
    "IndoorLinks",
    "IndoorRoom",
    "LinkBand",
    "LinkSource",
    "LinkStatus",
    "Material",
    "NlosSchedule",
    "OfdmLink",
    "OpportunityLink",
    "Oscillation",
    "PairArrivals",
    "PairLink",
    "PairReceiver",
    "PairSnippets",
    "PairTruth",
    "PlanarImuSeries",
    "PlanarMotion",
    "PlanarTrajectory",
    "RoomWall",
    "SensorErrorModel",
    "SoundingRecord",
    "SpatialMotion",
    "SpatialTrajectory",
    "ToneSweep",
    "add_awgn",
    "aperture_snapshots",
    "apply_cfo",
    "apply_clock_error",
    "apply_taps",
    "down_convert",
    "drift_path",
    "excess_delays",
    "far_field_limit_m",
    "fm_waveform",
    "foot_tracks",
    "free_space_path_loss_db",
    "friis_received_power_dbm",
    "log_distance_path_loss_db",
    "mean_power",
    "noise_variance_for_element_snr",
    "noise_variance_for_snr",
    "ricean_reflections",
    "simulate_gnss",
    "slab_response",
    "subcarrier_hz",
    "thermal_noise_dbm",
    "turntable",
]

_Iq = npt.NDArray[np.complex64]


def add_awgn(iq: _Iq, variance: float, *, seed: int, stream: int = 0) -> _Iq:
    """Add circular white Gaussian noise.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    variance : float
        Of a complex sample, E|noise|².
    seed, stream : int
        Name the noise; streams of one seed are independent.

    Returns
    -------
    ndarray, shape (n,), complex64
    """
    return _simulation.add_awgn(iq, variance, seed=seed, stream=stream)


def apply_cfo(iq: _Iq, cfo_hz: float, sample_rate_hz: float, *, phase_rad: float = 0.0) -> _Iq:
    """Move the carrier: positive moves the spectrum up.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    cfo_hz, sample_rate_hz : float
    phase_rad : float
        At the first sample.

    Returns
    -------
    ndarray, shape (n,), complex64
    """
    return _simulation.apply_cfo(iq, cfo_hz, sample_rate_hz, phase_rad=phase_rad)


def apply_clock_error(iq: _Iq, clock_error_ppm: float) -> _Iq:
    """Sample a transmitter whose clock is off; the carrier is not moved.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    clock_error_ppm : float
        Positive when the transmitter's clock runs fast relative to the receiver's: its frames are short in samples.

    Returns
    -------
    ndarray, shape (m,), complex64
        One sample for every time before the input's end.
    """
    return _simulation.apply_clock_error(iq, clock_error_ppm)


def apply_taps(iq: _Iq, sample_rate_hz: float, taps: Sequence[tuple[float, complex]]) -> _Iq:
    """Sum of several paths.

    Parameters
    ----------
    iq : ndarray, shape (n,), complex64
    sample_rate_hz : float
    taps : sequence of (delay_s, gain)
        Delays may be any fraction of a sample; gains are complex amplitudes at baseband.

    Returns
    -------
    ndarray, shape (n,), complex64
        Zero outside the capture.
    """
    return _simulation.apply_taps(iq, sample_rate_hz, list(taps))


def mean_power(iq: _Iq) -> float:
    """Mean of ``|iq|²``; 0 for no samples."""
    return _simulation.mean_power(iq)


def noise_variance_for_snr(signal_power: float, snr_db: float) -> float:
    """Noise variance per sample that stands `snr_db` below a signal of `signal_power` per sample."""
    return _simulation.noise_variance_for_snr(signal_power, snr_db)


def noise_variance_for_element_snr(snr_db: float, *, element_power: float = 1.0, transform_gain: float = 1.0) -> float:
    """Noise variance per sample that gives `snr_db` in each OFDM resource element.

    Parameters
    ----------
    snr_db : float
    element_power : float
        Behind the transform.
    transform_gain : float
        1 for a unitary transform of N points, N for an unscaled one, 1/N for one divided by N.
    """
    return _simulation.noise_variance_for_element_snr(
        snr_db, element_power=element_power, transform_gain=transform_gain
    )


def free_space_path_loss_db(distance_m: float, frequency_hz: float) -> float:
    """Free-space path loss (ITU-R P.525-4, equation 4)."""
    return _simulation.free_space_path_loss_db(distance_m, frequency_hz)


def log_distance_path_loss_db(
    distance_m: float, *, exponent: float, reference_distance_m: float, reference_loss_db: float
) -> float:
    """Log-distance path loss: the loss at a reference distance, and 10·exponent dB per decade beyond."""
    return _simulation.log_distance_path_loss_db(
        distance_m,
        exponent=exponent,
        reference_distance_m=reference_distance_m,
        reference_loss_db=reference_loss_db,
    )


def friis_received_power_dbm(
    *,
    transmit_power_dbm: float,
    distance_m: float,
    frequency_hz: float,
    transmit_gain_dbi: float = 0.0,
    receive_gain_dbi: float = 0.0,
) -> float:
    """Power received over free space (Friis)."""
    return _simulation.friis_received_power_dbm(
        transmit_power_dbm=transmit_power_dbm,
        transmit_gain_dbi=transmit_gain_dbi,
        receive_gain_dbi=receive_gain_dbi,
        distance_m=distance_m,
        frequency_hz=frequency_hz,
    )


def thermal_noise_dbm(bandwidth_hz: float, noise_figure_db: float = 0.0) -> float:
    """Thermal noise of a receiver at 290 K: -173.98 dBm in 1 Hz."""
    return _simulation.thermal_noise_dbm(bandwidth_hz, noise_figure_db)


def ricean_reflections(
    receivers_m: npt.ArrayLike,
    transmitter_m: npt.ArrayLike,
    reflector_m: npt.ArrayLike,
    *,
    mean: float = 0.33,
    variance: float = 0.0625,
    seed: int,
    stream: int = 0,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.complex128]]:
    """Second rays by way of something that reflects with Ricean strength, each time anew (crosby 3.13).

    Parameters
    ----------
    receivers_m : array_like, shape (n, 2) or (n, 3)
    transmitter_m, reflector_m : array_like, shape (2,) or (3,)
    mean, variance : float
        The gain's real part is normal about `mean`, its imaginary part about 0, both of `variance`.
    seed, stream : int
        Name the strengths; streams of one seed are independent.

    Returns
    -------
    extra_m : ndarray, shape (n,)
        How much longer the way by the reflector is.
    gain : ndarray, shape (n,), complex128
        Relative to the line of sight. What `OfdmLink.measure` takes.
    """
    return _simulation.ricean_reflections(
        receivers_m, transmitter_m, reflector_m, mean=mean, variance=variance, seed=seed, stream=stream
    )
