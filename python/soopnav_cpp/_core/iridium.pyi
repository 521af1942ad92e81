"""
Iridium: channels, bursts, their detection.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Burst",
    "BurstDetector",
    "BurstDirection",
    "BurstKind",
    "ChannelUse",
    "DetectedBurst",
    "SignalClass",
    "channel_candidates",
    "channel_frequency_hz",
    "channel_use",
    "matched_filter",
    "pulse",
]

class ChannelUse(enum.Enum):
    """
    What a channel is for.
    """

    DUPLEX = ...
    GUARD = ...
    MESSAGING = ...
    RING_ALERT = ...

class BurstKind(enum.Enum):
    """
    What a burst is made of.
    """

    DUPLEX = ...
    LONG = ...
    RING_ALERT = ...
    SIMPLEX = ...

class BurstDirection(enum.Enum):
    """
    Downlink or uplink: preamble and word.
    """

    DOWNLINK = ...
    UPLINK = ...

class Burst:
    """
    A burst as a function of continuous time.
    """
    @staticmethod
    def make(
        kind: BurstKind,
        seed: typing.SupportsInt | typing.SupportsIndex,
        *,
        stream: typing.SupportsInt | typing.SupportsIndex,
        duration_s: typing.SupportsFloat | typing.SupportsIndex,
        direction: BurstDirection,
    ) -> Burst:
        """
        A burst of a kind with random payload.
        """
    def __init__(self, symbols: numpy.typing.NDArray[numpy.complex64]) -> None:
        """
        A burst of given symbols.
        """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    def at(self, t_s: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.complex64]:
        """
        complex64, shape of t_s: the envelope at these times, seconds after the burst's start.
        """
    def evaluate(
        self,
        t0_s: typing.SupportsFloat | typing.SupportsIndex,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
        samples: typing.SupportsInt | typing.SupportsIndex,
        quadratic_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> numpy.typing.NDArray[numpy.complex64]:
        """
        complex64 (samples,): the envelope at t0_s + dt_s n + quadratic_s n^2, n = 0 ... samples - 1.
        """
    def render(
        self,
        samples: typing.SupportsInt | typing.SupportsIndex,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        delay_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        delay_rate: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        delay_acceleration: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        doppler_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        doppler_rate_hz_per_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        phase_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        amplitude: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    ) -> numpy.typing.NDArray[numpy.complex64]:
        """
        complex64 (samples,): what a receiver samples: amplitude * s(t - delay(t)) * exp(j phase(t)), t = n /
        sample_rate_hz, delay(t) = delay_s + delay_rate t + delay_acceleration t^2 / 2 (positive: later, stretched),
        phase(t) = phase_rad + 2 pi (doppler_hz t + doppler_rate_hz_per_s t^2 / 2).
        """
    @property
    def duration_s(self) -> float:
        """
        Symbols times 40 us.
        """
    @property
    def payload_start(self) -> int:
        """
        Symbol with which the payload begins.
        """
    @property
    def quadrants(self) -> numpy.typing.NDArray[numpy.uint8]:
        """
        uint8 (n,): q of the symbols exp(j (pi/4 + q pi/2)); empty for a burst of given symbols.
        """
    @property
    def symbols(self) -> numpy.typing.NDArray[numpy.complex64]:
        """
        complex64 (n,): the symbols.
        """

class SignalClass(enum.Enum):
    """
    What was found in the spectrum.
    """

    BURST = ...
    CONTINUOUS = ...
    TONE = ...

class DetectedBurst:
    """
    A signal found in a recording; times from its first sample.
    """
    def __repr__(self) -> str: ...
    @property
    def bandwidth_hz(self) -> float:
        """
        Of the middle 90 % of the power.
        """
    @property
    def cut_end(self) -> bool:
        """
        It was there when the recording ended, or it got too long.
        """
    @property
    def cut_start(self) -> bool:
        """
        It was there when the recording began.
        """
    @property
    def duration_s(self) -> float: ...
    @property
    def fine_frequency(self) -> bool:
        """
        The carrier comes from the symbols, not from the spectrum's centre of gravity.
        """
    @property
    def frequency_hz(self) -> float:
        """
        Of the carrier, the centre frequency added.
        """
    @property
    def frequency_sigma_hz(self) -> float:
        """
        Its standard deviation.
        """
    @property
    def kind(self) -> SignalClass: ...
    @property
    def snr_db(self) -> float:
        """
        Power over the noise's in 25 kHz.
        """
    @property
    def start_s(self) -> float: ...

class BurstDetector:
    """
    Finds bursts in a wide band as the samples come.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        center_frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        false_alarms_per_s: typing.SupportsFloat | typing.SupportsIndex = 0.001,
        max_burst_s: typing.SupportsFloat | typing.SupportsIndex = 0.1,
    ) -> None: ...
    def flush(self) -> list[DetectedBurst]:
        """
        Ends the stream: the signals still open.
        """
    def push(self, iq: numpy.typing.NDArray[numpy.complex64]) -> list[DetectedBurst]:
        """
        The signals that ended in these samples, in the order of their ends.
        """
    @property
    def dropped(self) -> int:
        """
        Signals that found no place in a report.
        """
    @property
    def rejected_samples(self) -> int:
        """
        Samples that were not finite and counted as zero.
        """
    @property
    def samples(self) -> int:
        """
        Of the stream so far.
        """
    @property
    def threshold(self) -> float:
        """
        Of the mean power over noise; 0 while the noise is learnt.
        """

def channel_candidates(
    received_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    max_doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
) -> list:
    """
    Tuples (channel, its centre, Doppler) of the channels near a carrier, nearest first.
    """

def channel_frequency_hz(channel: typing.SupportsInt | typing.SupportsIndex) -> float:
    """
    Centre of a channel.
    """

def channel_use(channel: typing.SupportsInt | typing.SupportsIndex) -> ChannelUse:
    """
    What a channel is for.
    """

def matched_filter(
    iq: numpy.typing.NDArray[numpy.complex64],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    start_s: typing.SupportsFloat | typing.SupportsIndex,
    frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
    symbols: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Symbols by the matched filter.
    """

def pulse(t_symbols: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    The pulse g at times in symbols.
    """
