"""
Code and carrier tracking loops of spread signals.
"""

from __future__ import annotations
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Tracker",
    "code_variance",
    "costas_phase_variance",
    "design_loop",
    "loop_variance",
    "phase_noise",
    "phase_variance",
    "window_variance",
]

class Tracker:
    """
    Tracks one signal.
    """
    def __init__(
        self,
        chips: numpy.typing.NDArray[numpy.complex64],
        *,
        chip_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        symbol_s: typing.SupportsFloat | typing.SupportsIndex,
        code_slope: typing.SupportsFloat | typing.SupportsIndex,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
        delay_s: typing.SupportsFloat | typing.SupportsIndex,
        doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        integration_s: typing.SupportsFloat | typing.SupportsIndex,
        pll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        pll_order: typing.SupportsInt | typing.SupportsIndex,
        dll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        early_late_chips: typing.SupportsFloat | typing.SupportsIndex,
        epoch_s: typing.SupportsFloat | typing.SupportsIndex,
        pull_in_s: typing.SupportsFloat | typing.SupportsIndex,
        pull_in_integration_s: typing.SupportsFloat | typing.SupportsIndex,
        pull_in_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        fll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        symbol_known: bool,
        loss_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def push(self, iq: numpy.typing.NDArray[numpy.complex64]) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows of the epochs that are complete.
        """
    @property
    def samples(self) -> int: ...
    @property
    def state(self) -> int: ...

def code_variance(
    cn0_hz: typing.SupportsFloat | typing.SupportsIndex,
    interval_s: typing.SupportsFloat | typing.SupportsIndex,
    integration_s: typing.SupportsFloat | typing.SupportsIndex,
    spacing_chips: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Thermal code noise.
    """

def costas_phase_variance(
    cn0_hz: typing.SupportsFloat | typing.SupportsIndex,
    interval_s: typing.SupportsFloat | typing.SupportsIndex,
    integration_s: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    The same with data wiped by themselves.
    """

def design_loop(
    order: typing.SupportsInt | typing.SupportsIndex,
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    interval_s: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[list[float], "FixedSize(3)"]:
    """
    Gains of a loop.
    """

def loop_variance(
    order: typing.SupportsInt | typing.SupportsIndex,
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    interval_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    mean_variance: typing.SupportsFloat | typing.SupportsIndex,
    white: typing.SupportsFloat | typing.SupportsIndex,
    walk: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[list[float], "FixedSize(4)"]:
    """
    Variances of a settled loop.
    """

def phase_noise(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    Densities of an oscillator's phase.
    """

def phase_variance(
    cn0_hz: typing.SupportsFloat | typing.SupportsIndex, interval_s: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Thermal phase noise.
    """

def window_variance(
    white: typing.SupportsFloat | typing.SupportsIndex,
    walk: typing.SupportsFloat | typing.SupportsIndex,
    window_s: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Mean of a window against its middle.
    """
