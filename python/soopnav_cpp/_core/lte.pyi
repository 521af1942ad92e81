"""
LTE downlink: sequences, synthesis, cell search, time of arrival.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "CellLostError",
    "CellParameters",
    "CrsLoop",
    "CyclicPrefix",
    "Detection",
    "Duplex",
    "LoopStatus",
    "MeasurementStream",
    "OrderRule",
    "Path",
    "PathResolver",
    "PeakWindow",
    "ResolveStatus",
    "ResolvedPaths",
    "ResolverOptions",
    "Searcher",
    "Snapshot",
    "SnapshotRanger",
    "SubframePathResolver",
    "SubframeToa",
    "SubframeToaEstimator",
    "SubspaceMethod",
    "SyncPorts",
    "Synthesizer",
    "TimeOfArrival",
    "crs",
    "noise_variance_for_snr",
    "pss",
    "resource_grid",
    "search",
    "sss",
    "synthesize",
    "time_of_arrival",
]

class CellLostError(ValueError):
    """
    The reference signals of the cell asked for are not in the samples.
    """

class CyclicPrefix(enum.Enum):
    """
    Cyclic prefix of the downlink (TS 36.211 6.12).
    """

    EXTENDED = ...
    NORMAL = ...

class Duplex(enum.Enum):
    """
    Frame structure: type 1 (FDD) or type 2 (TDD), TS 36.211 4.
    """

    FDD = ...
    TDD = ...

class Detection:
    """
    A cell found in a capture. Times run from the capture's first sample; cfo_hz is where the carrier lies in the
    baseband spectrum; clock_error_ppm is how much faster the cell's clock runs than the receiver's. Read-only.
    """
    def __init__(
        self,
        *,
        cell_id: typing.SupportsInt | typing.SupportsIndex,
        frame_start_s: typing.SupportsFloat | typing.SupportsIndex,
        cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        n_rb: typing.SupportsInt | typing.SupportsIndex | None = None,
        n_ports: typing.SupportsInt | typing.SupportsIndex | None = None,
        sfn: typing.SupportsInt | typing.SupportsIndex | None = None,
        cp: CyclicPrefix = ...,
        duplex: Duplex = ...,
        clock_error_ppm: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        snr_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> None:
        """
        A cell that is known already. Raises ValueError for a value outside its range.
        """
    def __repr__(self) -> str: ...
    @property
    def cell_id(self) -> int:
        """
        Physical-layer cell identity, 0 ... 503.
        """
    @property
    def cfo_hz(self) -> float:
        """
        Carrier-frequency offset.
        """
    @property
    def cfo_sigma_hz(self) -> float:
        """
        Standard deviation of cfo_hz.
        """
    @property
    def clock_error_ppm(self) -> float:
        """
        Sampling-clock error, parts per million.
        """
    @property
    def clock_error_sigma_ppm(self) -> float:
        """
        Standard deviation of clock_error_ppm.
        """
    @property
    def cp(self) -> CyclicPrefix:
        """
        Cyclic prefix.
        """
    @property
    def crs_statistic(self) -> float:
        """
        Evidence of the confirming reference-signal test, in units of its mean in noise.
        """
    @property
    def duplex(self) -> Duplex:
        """
        Frame structure.
        """
    @property
    def frame_start_s(self) -> float:
        """
        Start (cyclic prefix included) of the first radio frame, 0 ... 10 ms.
        """
    @property
    def n_ports(self) -> int | None:
        """
        Antenna ports 1, 2 or 4; None when no MIB was decoded.
        """
    @property
    def n_rb(self) -> int | None:
        """
        Bandwidth in resource blocks; None when no MIB was decoded.
        """
    @property
    def power_db(self) -> float:
        """
        Of a reference element, mean over ports; 0 dB is magnitude 1 in a unitary transform.
        """
    @property
    def sfn(self) -> int | None:
        """
        System frame number at frame_start_s; None when no MIB was decoded.
        """
    @property
    def snr_db(self) -> float:
        """
        Per reference element, mean over ports, over the central six resource blocks.
        """

class Path:
    """
    One resolved propagation path. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def delay_s(self) -> float:
        """
        Delay after the first path.
        """
    @property
    def power_db(self) -> float:
        """
        Power relative to the strongest path.
        """

class TimeOfArrival:
    """
    Times of arrival of one cell, a value per radio frame. Read-only.
    """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    @property
    def cfo_hz(self) -> float:
        """
        Carrier-frequency offset, refined over the capture.
        """
    @property
    def clock_error_ppm(self) -> float:
        """
        Sampling-clock error of the frames' delays.
        """
    @property
    def frame_index(self) -> numpy.typing.NDArray[numpy.int32]:
        """
        Frames after the one that starts at Detection.frame_start_s; shape (frames,), int32.
        """
    @property
    def impulse_response(self) -> numpy.typing.NDArray[numpy.float32]:
        """
        Magnitude over delay, all ports; shape (n,), float32.
        """
    @property
    def impulse_response_start_s(self) -> float:
        """
        Delay of impulse_response[0] after the first path.
        """
    @property
    def impulse_response_step_s(self) -> float:
        """
        Spacing of impulse_response.
        """
    @property
    def noise_variance(self) -> float:
        """
        Of one resource element.
        """
    @property
    def paths(self) -> list[Path]:
        """
        Resolved paths, the first one first.
        """
    @property
    def sigma_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Standard deviation of each, what the frames share included; shape (frames,).
        """
    @property
    def snr_db(self) -> float:
        """
        Per reference element, mean over ports.
        """
    @property
    def toa_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        First path: start of frame i minus i * 10 ms, from the capture's first sample; shape (frames,).
        """

class Searcher:
    """
    Cell search with its plans and buffers kept; also for streams.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        max_cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 150000.0,
        window_s: typing.SupportsFloat | typing.SupportsIndex = 0.08,
        decode_mib: bool = True,
        max_cells: typing.SupportsInt | typing.SupportsIndex = 16,
    ) -> None: ...
    def __repr__(self) -> str: ...
    def push(self, block: numpy.typing.NDArray[numpy.complex64]) -> list[Detection]:
        """
        Adds a block of a stream; cells of the windows it completed, times from the window's first sample.
        Samples that are not finite count as zero.
        """
    def search(self, iq: numpy.typing.NDArray[numpy.complex64]) -> list[Detection]:
        """
        Searches a whole capture; cells strongest first.
        """
    @property
    def max_cfo_hz(self) -> float: ...
    @property
    def sample_rate_hz(self) -> float: ...
    @property
    def window_s(self) -> float: ...

class SubframeToa:
    """
    Delay of one subframe. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def noise_variance(self) -> float:
        """
        Of one resource element.
        """
    @property
    def residual_cfo_hz(self) -> float:
        """
        Carrier offset left beside the one given.
        """
    @property
    def sigma_s(self) -> float:
        """
        Standard deviation.
        """
    @property
    def snr_db(self) -> float:
        """
        Per reference element, mean over ports.
        """
    @property
    def toa_s(self) -> float:
        """
        Start of the subframe, from the samples' first one.
        """

class SubframeToaEstimator:
    """
    Maximum-likelihood delay from the reference signals of one subframe at a time: phase free per port, one path.
    """
    def __init__(self, sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex, detection: Detection) -> None: ...
    def estimate(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        subframe: typing.SupportsInt | typing.SupportsIndex,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        *,
        cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> SubframeToa | None:
        """
        Delay of the subframe that begins near start_s in iq; None when the samples do not hold it.
        """

class SyncPorts(enum.Enum):
    """
    Antenna ports that send PSS and SSS.
    """

    ALL = ...
    FIRST = ...

class CellParameters:
    """
    One eNodeB as it reaches the receiver. Read-only.
    """
    def __init__(
        self,
        *,
        cell_id: typing.SupportsInt | typing.SupportsIndex,
        n_rb: typing.SupportsInt | typing.SupportsIndex = 6,
        n_ports: typing.SupportsInt | typing.SupportsIndex = 1,
        cp: CyclicPrefix = ...,
        duplex: Duplex = ...,
        tdd_configuration: typing.SupportsInt | typing.SupportsIndex = 1,
        special_subframe_configuration: typing.SupportsInt | typing.SupportsIndex = 7,
        start_sfn: typing.SupportsInt | typing.SupportsIndex = 0,
        delay_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        power_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        clock_error_ppm: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        carrier_phase_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        port_gain: collections.abc.Sequence[
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex
        ]
        | None = None,
        taps: collections.abc.Sequence[
            tuple[
                typing.SupportsFloat | typing.SupportsIndex,
                complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
            ]
        ] = [(0.0, (1 + 0j))],
        sync_ports: SyncPorts = ...,
        crs_boost_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        sync_boost_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        data_load: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    ) -> None: ...
    def __repr__(self) -> str: ...
    @property
    def cell_id(self) -> int:
        """
        0 ... 503.
        """
    @property
    def cfo_hz(self) -> float:
        """
        Where the carrier lies in the baseband spectrum.
        """
    @property
    def clock_error_ppm(self) -> float:
        """
        The cell's clock over the receiver's.
        """
    @property
    def cp(self) -> CyclicPrefix:
        """
        Cyclic prefix.
        """
    @property
    def delay_s(self) -> float:
        """
        Capture time at which that frame starts.
        """
    @property
    def duplex(self) -> Duplex:
        """
        Frame structure.
        """
    @property
    def n_ports(self) -> int:
        """
        Antenna ports: 1, 2 or 4.
        """
    @property
    def n_rb(self) -> int:
        """
        Bandwidth: 6, 15, 25, 50, 75 or 100 resource blocks.
        """
    @property
    def power_db(self) -> float:
        """
        Power of all elements.
        """
    @property
    def start_sfn(self) -> int:
        """
        Frame number of the frame that starts at delay_s.
        """

class Synthesizer:
    """
    Samples of several cells and noise, block by block.
    """
    def __init__(
        self,
        cells: collections.abc.Sequence[CellParameters],
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        seed: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> None: ...
    def generate(self, n_samples: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.complex64]:
        """
        The next samples, complex64.
        """
    def seek(self, sample: typing.SupportsInt | typing.SupportsIndex) -> None:
        """
        Sets position; negative ones lie before time 0.
        """
    @property
    def position(self) -> int:
        """
        Sample that generate begins with.
        """

class OrderRule(enum.Enum):
    """
    How the number of paths is found.
    """

    AIC = ...
    FIXED = ...
    MDL = ...

class SubspaceMethod(enum.Enum):
    """
    Subspace that starts the fits.
    """

    ESPRIT = ...
    MATRIX_PENCIL = ...

class PeakWindow(enum.Enum):
    """
    Window over frequency of the first-peak rule.
    """

    HANN = ...
    RECTANGULAR = ...

class ResolveStatus(enum.IntEnum):
    """
    Why a cell has no paths.
    """

    LOST = ...
    NON_FINITE = ...
    OK = ...
    TOO_SHORT = ...
    def __format__(self, format_spec): ...

class ResolvedPaths:
    """
    Paths told apart in a channel, ascending delay. Read-only.
    """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    @property
    def covariance_s2(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of delays_s; shape (paths, paths).
        """
    @property
    def delays_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (paths,).
        """
    @property
    def first(self) -> int:
        """
        Index of the path that counts as the first.
        """
    @property
    def first_peak_s(self) -> float:
        """
        First local maximum of the impulse response over the threshold.
        """
    @property
    def first_peak_sigma_s(self) -> float:
        """
        Deviation of a lone path there.
        """
    @property
    def fit(self) -> float:
        """
        Residual per degree of freedom over the noise measured; 1 when the model holds.
        """
    @property
    def gains(self) -> numpy.typing.NDArray[numpy.complex128]:
        """
        Amplitude and phase at the carrier; shape (paths, ports), complex128.
        """
    @property
    def noise_variance(self) -> float:
        """
        Of one channel value, as used.
        """
    @property
    def powers_db(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Relative to the strongest path, mean over ports; shape (paths,).
        """
    @property
    def sigmas_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Deviations of delays_s; shape (paths,).
        """
    @property
    def single_path_s(self) -> float:
        """
        Maximum likelihood of one path.
        """
    @property
    def snr_db(self) -> float:
        """
        Of one channel value, mean over ports.
        """
    @property
    def subspace_delays_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        What the subspace gave for that order, before the polish; shape (paths,) or (0,).
        """
    @property
    def subspace_order(self) -> int:
        """
        Order by the covariance's eigenvalues.
        """
    @property
    def toa_s(self) -> float:
        """
        Delay of the first path.
        """
    @property
    def toa_sigma_s(self) -> float:
        """
        Its deviation, all other delays and amplitudes unknown.
        """

class Snapshot:
    """
    Ranges to the cells of one snapshot, in the order they were given. Read-only.
    """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    @property
    def cell_id(self) -> numpy.typing.NDArray[numpy.int32]:
        """
        Shape (cells,), int32.
        """
    @property
    def excess_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Strongest path after the first one.
        """
    @property
    def first_db(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Power of the first path over the strongest.
        """
    @property
    def first_peak_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Frame start by the first-peak rule.
        """
    @property
    def first_peak_sigma_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Deviation of a lone path there.
        """
    @property
    def paths(self) -> numpy.typing.NDArray[numpy.int32]:
        """
        Paths from the first one on.
        """
    @property
    def residual_cfo_hz(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Carrier offset left beside the one given.
        """
    @property
    def sigma_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Deviation of toa_s.
        """
    @property
    def snr_db(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Per reference element, over noise and what remains of other cells.
        """
    @property
    def status(self) -> numpy.typing.NDArray[numpy.uint8]:
        """
        Values of ResolveStatus, 0 is good; shape (cells,), uint8.
        """
    @property
    def toa_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Frame start by the first path, on the guess's time line; 0 where status is not good.
        """
    @property
    def undetected_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Deviation that a path too weak to be told apart could cause; not in sigma_s.
        """

class ResolverOptions:
    """
    How paths are told apart. Read-only.
    """
    def __init__(
        self,
        *,
        order: OrderRule = ...,
        max_paths: typing.SupportsInt | typing.SupportsIndex = 4,
        subspace: SubspaceMethod = ...,
        window_s: typing.SupportsFloat | typing.SupportsIndex = 2e-06,
        min_separation: typing.SupportsFloat | typing.SupportsIndex = 0.1,
        earliest_db: typing.SupportsFloat | typing.SupportsIndex = -20.0,
        peak_threshold: typing.SupportsFloat | typing.SupportsIndex = 0.35,
        peak_window: PeakWindow = ...,
        polish: bool = True,
        ignore_gap: bool = False,
    ) -> None: ...
    @property
    def max_paths(self) -> int: ...

class PathResolver:
    """
    Tells paths apart in a channel over frequency.
    """
    def __init__(self, options: ResolverOptions) -> None: ...
    def impulse_response(self, delays_s: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Magnitude of the last channel over delay, rectangular window.
        """
    def music(
        self, delays_s: numpy.typing.ArrayLike, *, order: typing.SupportsInt | typing.SupportsIndex = 0
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        MUSIC pseudo-spectrum of the last channel.
        """
    def resolve(
        self,
        channel: numpy.typing.NDArray[numpy.complex64],
        frequencies: numpy.typing.ArrayLike,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex,
    ) -> ResolvedPaths:
        """
        channel: rows of the ports one after the other; frequencies in units of 15 kHz.
        """
    @property
    def music_period_s(self) -> float:
        """
        Delays of `music` repeat after this.
        """

class SubframePathResolver:
    """
    Tells the paths of one cell apart, from samples.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        detection: Detection,
        options: ResolverOptions,
    ) -> None: ...
    def impulse_response(self, delays_s: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Magnitude of the last channel over delay, rectangular window.
        """
    def music(
        self, delays_s: numpy.typing.ArrayLike, *, order: typing.SupportsInt | typing.SupportsIndex = 0
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        MUSIC pseudo-spectrum of the last channel.
        """
    def resolve(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        *,
        subframe: typing.SupportsInt | typing.SupportsIndex,
        subframes: typing.SupportsInt | typing.SupportsIndex,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        cfo_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> ResolvedPaths:
        """
        Paths of the subframe that begins near start_s in iq.
        """
    @property
    def channel(self) -> numpy.typing.NDArray[numpy.complex64]:
        """
        Channel of the last call, shape (ports, elements), complex64.
        """
    @property
    def frequencies(self) -> numpy.typing.NDArray[numpy.int32]:
        """
        Of the elements, units of 15 kHz; shape (elements,), int32.
        """
    @property
    def residual_cfo_hz(self) -> float:
        """
        Carrier offset left beside the one given, in the last call.
        """

class SnapshotRanger:
    """
    Ranges to several known cells from a millisecond of samples.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        cells: collections.abc.Sequence[Detection],
        *,
        subframes: typing.SupportsInt | typing.SupportsIndex,
        passes: typing.SupportsInt | typing.SupportsIndex,
        cancel: bool,
        search_window_s: typing.SupportsFloat | typing.SupportsIndex,
        options: ResolverOptions,
    ) -> None: ...
    def __len__(self) -> int: ...
    def range(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        frame_start_s: numpy.typing.ArrayLike,
        cfo_hz: numpy.typing.ArrayLike,
    ) -> Snapshot:
        """
        Ranges of one snapshot.
        """

class LoopStatus(enum.IntEnum):
    """
    What a loop does.
    """

    COASTING = ...
    LOST = ...
    PULL_IN = ...
    TRACKING = ...
    def __format__(self, format_spec): ...

class CrsLoop:
    """
    Follows carrier phase and delay of one cell.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        detection: Detection,
        *,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        pll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex = 15.0,
        pll_order: typing.SupportsInt | typing.SupportsIndex = 3,
        dll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        lost_after_s: typing.SupportsFloat | typing.SupportsIndex = 0.05,
    ) -> None: ...
    def push(self, block: numpy.typing.NDArray[numpy.complex64]) -> numpy.ndarray[typing.Any, numpy.dtype[typing.Any]]:
        """
        Adds samples; a structured array with one row for each subframe read.
        """
    def skip(self, samples: typing.SupportsInt | typing.SupportsIndex) -> None:
        """
        Samples were lost before the next block.
        """
    @property
    def position(self) -> int:
        """
        Samples pushed and skipped.
        """
    @property
    def subframes(self) -> int:
        """
        Subframes that are read, bit s for subframe s.
        """

class MeasurementStream:
    """
    Measurements of several cells at a fixed rate.
    """
    def __init__(
        self,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        cells: collections.abc.Sequence[Detection],
        *,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex = 10.0,
        search: bool = True,
        search_interval_s: typing.SupportsFloat | typing.SupportsIndex = 2.0,
        search_window_s: typing.SupportsFloat | typing.SupportsIndex = 0.08,
        max_cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 20000.0,
        max_cells: typing.SupportsInt | typing.SupportsIndex = 8,
        drop_after_s: typing.SupportsFloat | typing.SupportsIndex = 2.0,
        resolve: bool = True,
        pll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex = 15.0,
        dll_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    ) -> None: ...
    def push(
        self, block: numpy.typing.NDArray[numpy.complex64]
    ) -> list[tuple[float, numpy.ndarray[typing.Any, numpy.dtype[typing.Any]]]]:
        """
        Adds samples; time and a structured array, a row per cell, for each epoch that they complete.
        """
    def skip(self, samples: typing.SupportsInt | typing.SupportsIndex) -> None:
        """
        Samples were lost before the next block.
        """
    @property
    def position(self) -> int:
        """
        Samples pushed and skipped.
        """

def crs(
    cell_id: typing.SupportsInt | typing.SupportsIndex,
    slot: typing.SupportsInt | typing.SupportsIndex,
    symbol: typing.SupportsInt | typing.SupportsIndex,
    *,
    port: typing.SupportsInt | typing.SupportsIndex = 0,
    n_rb: typing.SupportsInt | typing.SupportsIndex,
    cp: CyclicPrefix = ...,
) -> tuple[numpy.typing.NDArray[numpy.complex64], numpy.typing.NDArray[numpy.int64]]:
    """
    Cell-specific reference signals of one symbol: values, subcarriers.
    """

def noise_variance_for_snr(
    snr_db: typing.SupportsFloat | typing.SupportsIndex, *, power_db: typing.SupportsFloat | typing.SupportsIndex = 0.0
) -> float:
    """
    Noise variance per sample that gives a reference element of unit gain snr_db.
    """

def pss(n_id_2: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Primary synchronisation signal, lowest subcarrier first.
    """

def resource_grid(
    cell: CellParameters,
    sfn: typing.SupportsInt | typing.SupportsIndex,
    subframe: typing.SupportsInt | typing.SupportsIndex,
    *,
    seed: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Resource elements of a subframe: ports, symbols, subcarriers.
    """

def search(
    iq: numpy.typing.NDArray[numpy.complex64],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    max_cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 150000.0,
    decode_mib: bool = True,
    max_cells: typing.SupportsInt | typing.SupportsIndex = 16,
) -> list[Detection]:
    """
    Cells in a capture, strongest first.
    """

def sss(
    cell_id: typing.SupportsInt | typing.SupportsIndex, subframe: typing.SupportsInt | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.float32]:
    """
    Secondary synchronisation signal, lowest subcarrier first.
    """

def synthesize(
    cells: collections.abc.Sequence[CellParameters],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    n_samples: typing.SupportsInt | typing.SupportsIndex,
    *,
    noise_variance: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    seed: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Samples of several cells and noise.
    """

def time_of_arrival(
    iq: numpy.typing.NDArray[numpy.complex64],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    detection: Detection,
) -> TimeOfArrival:
    """
    Times of arrival of one cell from its reference signals.
    """
