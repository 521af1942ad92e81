"""
GPS L1 C/A: codes, signals, tracking noise.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Acquirer",
    "AidedCorrelator",
    "ca_code",
    "cell_loss",
    "code_sigma_m",
    "phase_sigma_rad",
    "search_frequencies",
    "synthesize",
]

class Acquirer:
    """
    Searches samples for satellites' codes.
    """
    def __init__(
        self,
        *,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
        coherent_ms: typing.SupportsInt | typing.SupportsIndex,
        noncoherent: typing.SupportsInt | typing.SupportsIndex,
        min_doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        max_doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        doppler_step_hz: typing.SupportsFloat | typing.SupportsIndex,
        false_alarm_probability: typing.SupportsFloat | typing.SupportsIndex,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def doppler_hz(self, bin: typing.SupportsInt | typing.SupportsIndex) -> float:
        """
        Of a row of the surface.
        """
    def search(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        prns: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    ) -> list:
        """
        Rows of (prn, status, delay_s, doppler_hz, ...).
        """
    def surface(self) -> numpy.typing.NDArray[numpy.float32]:
        """
        Statistics of the last search, a row for each Doppler.
        """
    @property
    def cell_false_alarm(self) -> float: ...
    @property
    def cells(self) -> int: ...
    @property
    def delays(self) -> int: ...
    @property
    def dopplers(self) -> int: ...
    @property
    def samples(self) -> int: ...
    @property
    def threshold(self) -> float: ...

class AidedCorrelator:
    """
    Correlates a weak satellite with what is predicted of it.
    """
    def __init__(
        self,
        prn: typing.SupportsInt | typing.SupportsIndex,
        *,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
        block_s: typing.SupportsFloat | typing.SupportsIndex,
        max_blocks: typing.SupportsInt | typing.SupportsIndex,
        half_chips: typing.SupportsInt | typing.SupportsIndex,
        bits: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    ) -> None: ...
    def delay_chips(self, code: typing.SupportsInt | typing.SupportsIndex) -> float:
        """
        Of a column of the sums.
        """
    def push(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        *,
        transmit_time_s: typing.SupportsFloat | typing.SupportsIndex,
        carrier_phase_cycles: typing.SupportsFloat | typing.SupportsIndex,
        doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        doppler_rate_hzps: typing.SupportsFloat | typing.SupportsIndex,
    ) -> bool:
        """
        Takes a block; False when refused.
        """
    def sums(self) -> numpy.typing.NDArray[numpy.complex128]:
        """
        Sums so far, (blocks, codes).
        """
    @property
    def block_s(self) -> float: ...
    @property
    def block_samples(self) -> int: ...
    @property
    def blocks(self) -> int: ...
    @property
    def codes(self) -> int: ...

def ca_code(prn: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.int8]:
    """
    Chips of a C/A code, +1 and -1.
    """

def cell_loss(
    delay_error_chips: typing.SupportsFloat | typing.SupportsIndex,
    doppler_error_hz: typing.SupportsFloat | typing.SupportsIndex,
    coherent_s: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Share of a signal's power in a cell that is off.
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

def search_frequencies(
    sums: typing.Annotated[numpy.typing.ArrayLike, numpy.complex128],
    *,
    block_s: typing.SupportsFloat | typing.SupportsIndex,
    variance: typing.SupportsFloat | typing.SupportsIndex,
    first_hz: typing.SupportsFloat | typing.SupportsIndex,
    step_hz: typing.SupportsFloat | typing.SupportsIndex,
    count: typing.SupportsInt | typing.SupportsIndex,
    coherent_blocks: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Statistics (codes, frequencies) of sums (blocks, codes).
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
