"""
cdma2000 and IS-95: pilot codes, signals, acquisition.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = ["PilotSearcher", "baseband_filter", "offset_candidates", "pilot_code", "synthesize"]

class PilotSearcher:
    """
    Search for pilots of all offsets.
    """
    def __init__(
        self,
        *,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        max_doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        coherent_s: typing.SupportsFloat | typing.SupportsIndex,
        noncoherent: typing.SupportsInt | typing.SupportsIndex,
        false_alarm_probability: typing.SupportsFloat | typing.SupportsIndex,
        max_pilots: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def search(self, iq: numpy.typing.NDArray[numpy.complex64]) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows of what was found.
        """
    @property
    def cell_false_alarm(self) -> float: ...
    @property
    def cells(self) -> int: ...
    @property
    def samples(self) -> int: ...
    @property
    def threshold(self) -> float: ...

def baseband_filter() -> numpy.typing.NDArray[numpy.float64]:
    """
    Taps of the base station's filter.
    """

def offset_candidates(
    delay_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    start_s: typing.SupportsFloat | typing.SupportsIndex,
    start_error_s: typing.SupportsFloat | typing.SupportsIndex,
    max_travel_s: typing.SupportsFloat | typing.SupportsIndex,
) -> list[int]:
    """
    Offsets that explain a delay.
    """

def pilot_code(pn_offset: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.complex64]:
    """
    One period of a pilot.
    """

def synthesize(
    signals: numpy.typing.ArrayLike,
    channels: collections.abc.Sequence[
        collections.abc.Sequence[
            tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex]
        ]
    ],
    samples: typing.SupportsInt | typing.SupportsIndex,
    *,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    intermediate_hz: typing.SupportsFloat | typing.SupportsIndex,
    carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
    filtered: bool,
    data_seed: typing.SupportsInt | typing.SupportsIndex,
    first: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex | None,
    stream: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    The sum of pilots.
    """
