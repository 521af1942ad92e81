"""
OFDM: symbols, cyclic-prefix correlator, blind symbol boundaries.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Boundary",
    "BoundaryEstimator",
    "BoundaryStatus",
    "Numerology",
    "TwoRayBoundary",
    "TwoRayTiming",
    "correlate",
    "delay_crlb_m",
    "symbols",
]

class Numerology:
    """
    The grid of an OFDM signal: N subcarriers, all with data, and a prefix of v samples. Read-only.
    """
    def __eq__(self, arg0: Numerology) -> bool: ...
    def __getstate__(self) -> tuple[int, int, float]: ...
    def __hash__(self) -> int: ...
    def __init__(
        self,
        subcarriers: typing.SupportsInt | typing.SupportsIndex = 64,
        prefix: typing.SupportsInt | typing.SupportsIndex = 16,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex = 20000000.0,
    ) -> None:
        """
        Raises ValueError unless subcarriers is 2 ... 65536, prefix 1 ... subcarriers - 1, and the rate positive.
        """
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def ambiguity_m(self) -> float:
        """
        c symbol_s: ranges are known modulo this.
        """
    @property
    def prefix(self) -> int:
        """
        v, samples of the cyclic prefix.
        """
    @property
    def sample_m(self) -> float:
        """
        c / sample_rate_hz.
        """
    @property
    def sample_rate_hz(self) -> float:
        """
        Critical: the subcarriers fill it.
        """
    @property
    def subcarriers(self) -> int:
        """
        N.
        """
    @property
    def symbol_s(self) -> float:
        """
        Duration of a symbol.
        """
    @property
    def symbol_samples(self) -> int:
        """
        M = N + v.
        """

class BoundaryStatus(enum.IntEnum):
    """
    What became of one epoch's samples.
    """

    NON_FINITE = ...
    NO_BOUNDARY = ...
    NO_SIGNAL = ...
    OK = ...
    TOO_SHORT = ...
    def __format__(self, format_spec): ...

class Boundary:
    """
    Where symbols start in an epoch's samples. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def boundary_m(self) -> float:
        """
        Offset taken out, in 0 ... ambiguity; grows with the path.
        """
    @property
    def boundary_samples(self) -> float:
        """
        In 0 ... M, the receiver's own samples.
        """
    @property
    def cfo_hz(self) -> float:
        """
        Carrier offset, positive when the signal lies above.
        """
    @property
    def metric(self) -> float:
        """
        |gamma| / Phi: 1 without noise, SNR / (1 + SNR) on average.
        """
    @property
    def sigma_m(self) -> float:
        """
        Its standard deviation.
        """
    @property
    def sigma_samples(self) -> float:
        """
        Its standard deviation.
        """
    @property
    def snr_db(self) -> float:
        """
        Per sample.
        """
    @property
    def status(self) -> BoundaryStatus:
        """
        Anything but OK leaves every number zero.
        """

class BoundaryEstimator:
    """
    Blind estimator of the symbol boundary, with its tables kept.
    """
    def __init__(
        self,
        numerology: Numerology = ...,
        symbols: typing.SupportsInt | typing.SupportsIndex = 250,
        *,
        oversampling: typing.SupportsInt | typing.SupportsIndex = 1,
        method: str = "nearest_sample",
        snr_db: typing.SupportsFloat | typing.SupportsIndex | None = None,
    ) -> None:
        """
        method: "nearest_sample" (argmax of Re gamma), "magnitude" (of |gamma|), "maximum_likelihood" (with the energy term) or
        "interpolated" (between samples; critical sampling, at most 256 samples per symbol). snr_db, per sample,
        when it is known; otherwise it is estimated. Raises ValueError for what cannot be.
        """
    def __repr__(self) -> str: ...
    def estimate(self, iq: numpy.typing.NDArray[numpy.complex64]) -> Boundary:
        """
        The boundary in the first required_samples of iq: complex64, shape (n,).
        """
    def folded_differences(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the last estimate: sum over the symbols of |y(i) - y(i + N)|^2 over the mean power, shape (M,).
        """
    @property
    def offset_samples(self) -> float:
        """
        Where the method finds a signal of delay 0; boundary_m has it taken out.
        """
    @property
    def required_samples(self) -> int: ...

class TwoRayBoundary:
    """
    Line of sight beside one reflection. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def extra_m(self) -> float:
        """
        What the reflected path is longer by, in 0 ... ambiguity.
        """
    @property
    def likelihood_ratio(self) -> float:
        """
        Of two rays over one, a discounted log.
        """
    @property
    def range_m(self) -> float:
        """
        Line of sight, near the prediction, not wrapped.
        """
    @property
    def sigma_m(self) -> float:
        """
        Its standard deviation.
        """
    @property
    def status(self) -> BoundaryStatus: ...
    @property
    def strength(self) -> float:
        """
        Amplitude of the reflection over the line of sight's.
        """
    @property
    def two_rays(self) -> bool:
        """
        Whether a second ray is wanted.
        """

class TwoRayTiming:
    """
    Times of two rays from an epoch's folded differences.
    """
    def __init__(
        self,
        numerology: Numerology = ...,
        symbols: typing.SupportsInt | typing.SupportsIndex = 250,
        *,
        reach_samples: typing.SupportsFloat | typing.SupportsIndex = 3.0,
        snr_db: typing.SupportsFloat | typing.SupportsIndex = 30.0,
        sigma_floor_m: typing.SupportsFloat | typing.SupportsIndex = 1.5,
    ) -> None:
        """
        reach_samples: the line of sight lies so close to its prediction. snr_db: per sample. sigma_floor_m: of
        two rays. Raises ValueError for what cannot be.
        """
    def estimate(
        self,
        folded: numpy.typing.ArrayLike,
        predicted_m: typing.SupportsFloat | typing.SupportsIndex,
        sigma_m: typing.SupportsFloat | typing.SupportsIndex,
    ) -> TwoRayBoundary:
        """
        folded: shape (M,), as of BoundaryEstimator.folded_differences; predicted_m and sigma_m of the line of sight.
        """

def correlate(
    iq: numpy.typing.NDArray[numpy.complex64],
    numerology: Numerology = ...,
    symbols: typing.SupportsInt | typing.SupportsIndex = 250,
    *,
    oversampling: typing.SupportsInt | typing.SupportsIndex = 1,
) -> numpy.typing.NDArray[numpy.complex128]:
    """
    Cyclic-prefix correlator over many symbols.
    """

def delay_crlb_m(
    snr_db: typing.SupportsFloat | typing.SupportsIndex,
    symbols: typing.SupportsInt | typing.SupportsIndex,
    numerology: Numerology = ...,
    *,
    fraction: typing.SupportsFloat | typing.SupportsIndex | None = None,
) -> float:
    """
    Bound of a delay's standard deviation from the folded pairs.
    """

def symbols(
    count: typing.SupportsInt | typing.SupportsIndex,
    numerology: Numerology = ...,
    *,
    constellation: str = "qpsk",
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    A string of OFDM symbols.
    """
