"""
Transforms, correlation, delays and resampling.
"""

from __future__ import annotations
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "AmbiguityPeak",
    "AmbiguityPrefilter",
    "AmbiguityStatus",
    "CrossAmbiguity",
    "convolve",
    "correlate",
    "delay",
    "fft_library",
    "resample",
    "stein_bound",
    "stochastic_bound",
]

class AmbiguityStatus:
    """
    What came of a pair of recordings.

    Members:

      OK

      NOT_DETECTED

      TONE

      IDENTICAL

      TOO_SHORT

      TOO_LONG

      LENGTH_MISMATCH

      NOT_FINITE

      NO_POWER
    """

    IDENTICAL: typing.ClassVar[AmbiguityStatus]
    LENGTH_MISMATCH: typing.ClassVar[AmbiguityStatus]
    NOT_DETECTED: typing.ClassVar[AmbiguityStatus]
    NOT_FINITE: typing.ClassVar[AmbiguityStatus]
    NO_POWER: typing.ClassVar[AmbiguityStatus]
    OK: typing.ClassVar[AmbiguityStatus]
    TONE: typing.ClassVar[AmbiguityStatus]
    TOO_LONG: typing.ClassVar[AmbiguityStatus]
    TOO_SHORT: typing.ClassVar[AmbiguityStatus]
    __members__: typing.ClassVar[dict[str, AmbiguityStatus]]
    @typing.overload
    def __eq__(self, other: AmbiguityStatus) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: AmbiguityStatus) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def text(self) -> str: ...
    @property
    def value(self) -> int: ...

class AmbiguityPrefilter:
    """
    How the recordings are filtered before they are multiplied.

    Members:

      NONE

      BOX

      RRC

      ML
    """

    BOX: typing.ClassVar[AmbiguityPrefilter]
    ML: typing.ClassVar[AmbiguityPrefilter]
    NONE: typing.ClassVar[AmbiguityPrefilter]
    RRC: typing.ClassVar[AmbiguityPrefilter]
    __members__: typing.ClassVar[dict[str, AmbiguityPrefilter]]
    @typing.overload
    def __eq__(self, other: AmbiguityPrefilter) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: AmbiguityPrefilter) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class AmbiguityPeak:
    """
    Delay and Doppler between two recordings.
    """
    @property
    def bandwidth_hz(self) -> float: ...
    @property
    def center_a_hz(self) -> float: ...
    @property
    def center_b_hz(self) -> float: ...
    @property
    def coherence(self) -> float: ...
    @property
    def correlation(self) -> float: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def epoch_s(self) -> float: ...
    @property
    def fdoa_hz(self) -> float: ...
    @property
    def phase_rad(self) -> float: ...
    @property
    def sigma_fdoa_hz(self) -> float: ...
    @property
    def sigma_tdoa_rate(self) -> float: ...
    @property
    def sigma_tdoa_s(self) -> float: ...
    @property
    def snr_a_db(self) -> float: ...
    @property
    def snr_b_db(self) -> float: ...
    @property
    def snr_db(self) -> float: ...
    @property
    def start_s(self) -> float: ...
    @property
    def status(self) -> AmbiguityStatus: ...
    @property
    def tdoa_rate(self) -> float: ...
    @property
    def tdoa_s(self) -> float: ...
    @property
    def threshold_db(self) -> float: ...
    @property
    def tones(self) -> int: ...

class CrossAmbiguity:
    """
    Cross-ambiguity of pairs of recordings, plans made once.
    """
    def __init__(
        self,
        *,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        max_samples: typing.SupportsInt | typing.SupportsIndex,
        max_delay_s: typing.SupportsFloat | typing.SupportsIndex,
        max_doppler_hz: typing.SupportsFloat | typing.SupportsIndex,
        delay_center_s: typing.SupportsFloat | typing.SupportsIndex,
        doppler_center_hz: typing.SupportsFloat | typing.SupportsIndex,
        bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        center_a_hz: typing.SupportsFloat | typing.SupportsIndex,
        center_b_hz: typing.SupportsFloat | typing.SupportsIndex,
        symbol_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        rolloff: typing.SupportsFloat | typing.SupportsIndex,
        prefilter: AmbiguityPrefilter,
        false_alarm: typing.SupportsFloat | typing.SupportsIndex,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        tdoa_rate: typing.SupportsFloat | typing.SupportsIndex,
        estimate_rate: bool,
        max_tdoa_rate: typing.SupportsFloat | typing.SupportsIndex,
        reject_tones: bool,
    ) -> None: ...
    def measure(
        self, a: numpy.typing.NDArray[numpy.complex64], b: numpy.typing.NDArray[numpy.complex64]
    ) -> AmbiguityPeak:
        """
        Delay and Doppler of a against b.
        """
    def surface(
        self,
        a: numpy.typing.NDArray[numpy.complex64],
        b: numpy.typing.NDArray[numpy.complex64],
        delays_s: numpy.typing.ArrayLike,
        doppler_hz: numpy.typing.ArrayLike,
    ) -> tuple:
        """
        The same, and |C|^2 over a grid.
        """
    @property
    def min_samples(self) -> int: ...

def convolve(
    iq: numpy.typing.NDArray[numpy.complex64], kernel: numpy.typing.NDArray[numpy.complex64]
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    The whole convolution.
    """

def correlate(
    iq: numpy.typing.NDArray[numpy.complex64], kernel: numpy.typing.NDArray[numpy.complex64]
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Correlation where the kernel lies wholly inside iq.
    """

def delay(
    iq: numpy.typing.NDArray[numpy.complex64],
    delay_samples: typing.SupportsFloat | typing.SupportsIndex,
    *,
    passband: typing.SupportsFloat | typing.SupportsIndex = 0.8,
    attenuation_db: typing.SupportsFloat | typing.SupportsIndex = 80.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Delay by any number of samples.
    """

def fft_library() -> str:
    """
    Library behind the transforms: "fftw" or "eigen".
    """

def resample(
    iq: numpy.typing.NDArray[numpy.complex64],
    in_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    out_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    passband: typing.SupportsFloat | typing.SupportsIndex = 0.8,
    stopband: typing.SupportsFloat | typing.SupportsIndex = 1.2,
    attenuation_db: typing.SupportsFloat | typing.SupportsIndex = 80.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    A capture at another rate.
    """

def stein_bound(
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    duration_s: typing.SupportsFloat | typing.SupportsIndex,
    snr_a: typing.SupportsFloat | typing.SupportsIndex,
    snr_b: typing.SupportsFloat | typing.SupportsIndex,
    shape: str,
    rolloff: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    Stein's bound of TDOA and FDOA.
    """

def stochastic_bound(
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    duration_s: typing.SupportsFloat | typing.SupportsIndex,
    snr_a: typing.SupportsFloat | typing.SupportsIndex,
    snr_b: typing.SupportsFloat | typing.SupportsIndex,
    shape: str,
    rolloff: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    The bound for an unknown Gaussian signal.
    """
