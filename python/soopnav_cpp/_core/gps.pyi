"""
GPS L1 C/A: codes, signals, tracking noise.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = ["ca_code", "code_sigma_m", "phase_sigma_rad", "synthesize"]

def ca_code(prn: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.int8]:
    """
    Chips of a C/A code, +1 and -1.
    """

def code_sigma_m(
    cn0_dbhz: numpy.typing.ArrayLike,
    *,
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    early_late_chips: typing.SupportsFloat | typing.SupportsIndex,
    integration_s: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Noise of a code loop.
    """

def phase_sigma_rad(
    cn0_dbhz: numpy.typing.ArrayLike,
    *,
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    power_fraction: typing.SupportsFloat | typing.SupportsIndex,
    oscillator_rad: typing.SupportsFloat | typing.SupportsIndex,
    dynamics_rad: typing.SupportsFloat | typing.SupportsIndex,
    integration_s: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Phase noise of a carrier loop.
    """

def synthesize(
    signals: numpy.typing.ArrayLike,
    bits: collections.abc.Sequence[collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]],
    samples: typing.SupportsInt | typing.SupportsIndex,
    *,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
    first: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex | None,
    stream: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    The sum of satellites' signals.
    """
