"""
Channels: noise, carrier offset, clock error, path loss.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "add_awgn",
    "apply_cfo",
    "apply_clock_error",
    "apply_taps",
    "free_space_path_loss_db",
    "friis_received_power_dbm",
    "log_distance_path_loss_db",
    "mean_power",
    "noise_variance_for_element_snr",
    "noise_variance_for_snr",
    "thermal_noise_dbm",
]

def add_awgn(
    iq: numpy.typing.NDArray[numpy.complex64],
    variance: typing.SupportsFloat | typing.SupportsIndex,
    *,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq plus circular white Gaussian noise.
    """

def apply_cfo(
    iq: numpy.typing.NDArray[numpy.complex64],
    cfo_hz: typing.SupportsFloat | typing.SupportsIndex,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    phase_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq with its carrier moved.
    """

def apply_clock_error(
    iq: numpy.typing.NDArray[numpy.complex64], clock_error_ppm: typing.SupportsFloat | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq as sampled from a transmitter whose clock is off.
    """

def apply_taps(
    iq: numpy.typing.NDArray[numpy.complex64],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    taps: collections.abc.Sequence[
        tuple[
            typing.SupportsFloat | typing.SupportsIndex,
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
        ]
    ],
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq over several paths.
    """

def free_space_path_loss_db(
    distance_m: typing.SupportsFloat | typing.SupportsIndex, frequency_hz: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Free-space path loss.
    """

def friis_received_power_dbm(
    *,
    transmit_power_dbm: typing.SupportsFloat | typing.SupportsIndex,
    transmit_gain_dbi: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    receive_gain_dbi: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
    frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Power received over free space.
    """

def log_distance_path_loss_db(
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
    *,
    exponent: typing.SupportsFloat | typing.SupportsIndex,
    reference_distance_m: typing.SupportsFloat | typing.SupportsIndex,
    reference_loss_db: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Log-distance path loss.
    """

def mean_power(iq: numpy.typing.NDArray[numpy.complex64]) -> float:
    """
    Mean of |x|^2.
    """

def noise_variance_for_element_snr(
    snr_db: typing.SupportsFloat | typing.SupportsIndex,
    *,
    element_power: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    transform_gain: typing.SupportsFloat | typing.SupportsIndex = 1.0,
) -> float:
    """
    Noise variance per sample for an SNR per resource element.
    """

def noise_variance_for_snr(
    signal_power: typing.SupportsFloat | typing.SupportsIndex, snr_db: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Noise variance per sample that stands snr_db below the signal.
    """

def thermal_noise_dbm(
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    noise_figure_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> float:
    """
    Thermal noise of a receiver.
    """
