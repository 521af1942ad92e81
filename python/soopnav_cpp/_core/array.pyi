"""
Antenna arrays: manifolds, covariances, directions.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "ApertureOptions",
    "ApertureStatus",
    "ArrayGeometry",
    "ArrayStatus",
    "CalibrationReport",
    "CalibrationStatus",
    "DirectionFinder",
    "Manifold",
    "SteeringTable",
    "SyntheticAperture",
    "aperture_crlb",
    "aperture_directions",
    "aperture_spectrum",
    "apply_correction",
    "calibrate",
    "check_bearings",
    "covariance",
    "crlb",
    "eigenvalues",
    "esprit",
    "far_field",
    "field_region",
    "forward_backward",
    "impedance_factor",
    "polarization_factor",
    "received_power_dbm",
    "root_music",
    "source_count",
    "spatial_smoothing",
    "spectrum",
]

class ArrayStatus(enum.IntEnum):
    """
    What became of a block of samples or a covariance.
    """

    DEAD_CHANNEL = ...
    NON_FINITE = ...
    NO_SOURCE = ...
    OK = ...
    SINGULAR = ...
    TOO_FEW_SNAPSHOTS = ...
    UNRESOLVED = ...
    WRONG_SIZE = ...
    def __format__(self, format_spec): ...

class ArrayGeometry:
    """
    Where the elements of an array are, and its frequency. Read-only.
    """
    @staticmethod
    def planar(
        nx: typing.SupportsInt | typing.SupportsIndex,
        ny: typing.SupportsInt | typing.SupportsIndex,
        spacing_wavelengths: typing.SupportsFloat | typing.SupportsIndex = 0.5,
        *,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 1575420000.0,
    ) -> ArrayGeometry:
        """
        nx by ny elements in plane 1-2, the first at the origin, axis 1 running faster.
        """
    @staticmethod
    def uca(
        n: typing.SupportsInt | typing.SupportsIndex,
        radius_wavelengths: typing.SupportsFloat | typing.SupportsIndex,
        *,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 1575420000.0,
    ) -> ArrayGeometry:
        """
        n elements on a circle round the origin in plane 1-2, the first on axis 1.
        """
    @staticmethod
    def ula(
        n: typing.SupportsInt | typing.SupportsIndex,
        spacing_wavelengths: typing.SupportsFloat | typing.SupportsIndex = 0.5,
        *,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 1575420000.0,
    ) -> ArrayGeometry:
        """
        n elements on axis 1, the first at the origin.
        """
    def __init__(
        self,
        positions_m: numpy.typing.ArrayLike,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
        name: str = "",
    ) -> None:
        """
        2 to 32 elements, shape (M, 3) or (M, 2), array axes [m]. Raises ValueError for two on one point, a number that is not finite, or a frequency that is not positive.
        """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    def ambiguous_directions(
        self,
        azimuth_rad: typing.SupportsFloat | typing.SupportsIndex,
        elevation_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Other directions with the same steering vector up to its phase, shape (n, 2) [rad]; the mirror image is left out.
        """
    @property
    def ambiguous(self) -> bool:
        """
        Whether regions of directions have doubles.
        """
    @property
    def aperture_m(self) -> float:
        """
        Greatest distance of two elements.
        """
    @property
    def frequency_hz(self) -> float:
        """
        Carrier.
        """
    @property
    def name(self) -> str:
        """
        For people.
        """
    @property
    def positions_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        (M, 3), array axes [m].
        """
    @property
    def rank(self) -> int:
        """
        1 line, 2 plane, 3 space.
        """
    @property
    def smallest_spacing_m(self) -> float:
        """
        Smallest distance of two.
        """
    @property
    def wavelength_m(self) -> float:
        """
        c / frequency_hz.
        """

class Manifold:
    """
    How the elements answer a plane wave. Read-only.
    """
    @staticmethod
    def measured(
        geometry: ArrayGeometry,
        frequency_hz: numpy.typing.ArrayLike,
        azimuth_rad: numpy.typing.ArrayLike,
        elevation_rad: numpy.typing.ArrayLike,
        correction: numpy.typing.ArrayLike,
    ) -> Manifold:
        """
        Factors over the geometry's own phase, shape (F E A, M).
        """
    def __init__(self, geometry: ArrayGeometry) -> None:
        """
        Isotropic elements.
        """
    def __len__(self) -> int: ...
    def steering(
        self,
        azimuth_rad: numpy.typing.ArrayLike,
        elevation_rad: numpy.typing.ArrayLike,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> numpy.typing.NDArray[numpy.complex128]:
        """
        Steering vectors, shape (M, n), complex128.
        """
    def with_coupling(self, coupling: numpy.typing.ArrayLike) -> Manifold:
        """
        The same array behind a coupling matrix.
        """
    def with_errors(self, gain_db: numpy.typing.ArrayLike, phase_rad: numpy.typing.ArrayLike) -> Manifold:
        """
        The same array with these errors besides.
        """
    @property
    def geometry(self) -> ArrayGeometry:
        """
        The elements.
        """
    @property
    def ideal(self) -> bool:
        """
        Isotropic elements without errors or coupling.
        """

class SteeringTable:
    """
    Steering vectors over a grid of directions. Read-only.
    """
    def __init__(
        self,
        manifold: Manifold,
        *,
        azimuth_step_rad: typing.SupportsFloat | typing.SupportsIndex,
        elevation_step_rad: typing.SupportsFloat | typing.SupportsIndex,
        elevation_min_rad: typing.SupportsFloat | typing.SupportsIndex,
        azimuth_start_rad: typing.SupportsFloat | typing.SupportsIndex,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None:
        """
        Made once.
        """
    @property
    def azimuth_rad(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Columns of the grid.
        """
    @property
    def elevation_rad(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows of the grid.
        """
    @property
    def frequency_hz(self) -> float:
        """
        Of the signal.
        """
    @property
    def manifold(self) -> Manifold:
        """
        The array.
        """

class DirectionFinder:
    """
    Directions from samples.
    """
    def __init__(
        self,
        table: SteeringTable,
        *,
        method: str,
        n_sources: typing.SupportsInt | typing.SupportsIndex,
        loading: typing.SupportsFloat | typing.SupportsIndex,
        forward_backward: bool,
    ) -> None:
        """
        Made once.
        """
    def estimate(self, iq: numpy.typing.NDArray[numpy.complex64]) -> tuple:
        """
        Status, channel, numbers (K, 4), covariance (K, 2, 2), eigenvalues, noise, mirror.
        """
    def estimate_covariance(
        self, R: numpy.typing.ArrayLike, n_snapshots: typing.SupportsFloat | typing.SupportsIndex
    ) -> tuple:
        """
        As estimate.
        """
    def run(self, R: numpy.typing.ArrayLike, n_snapshots: typing.SupportsFloat | typing.SupportsIndex) -> tuple:
        """
        As track, for covariances.
        """
    def track(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        block: typing.SupportsInt | typing.SupportsIndex,
        hop: typing.SupportsInt | typing.SupportsIndex,
    ) -> tuple:
        """
        Status, count, numbers (B, K, 4), covariance, eigenvalues.
        """

class CalibrationStatus(enum.IntEnum):
    """
    What became of a calibration.
    """

    DEAD_CHANNEL = ...
    NON_FINITE = ...
    NO_QUADRATURE = ...
    OK = ...
    SATURATED = ...
    TOO_FEW_SAMPLES = ...
    WEAK_TONE = ...
    def __format__(self, format_spec): ...

class CalibrationReport:
    """
    What a tone said about the channels; arrays of shape (M,).
    """
    def __repr__(self) -> str: ...
    @property
    def channel(self) -> int:
        """
        At fault, or -1.
        """
    @property
    def dc(self) -> numpy.typing.NDArray[numpy.complex128]: ...
    @property
    def gain(self) -> numpy.typing.NDArray[numpy.complex128]: ...
    @property
    def image_sigma(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def iq_gain(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def iq_phase_rad(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def phase_sigma_rad(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def residual_rms(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def status(self) -> CalibrationStatus: ...
    @property
    def tone_amplitude(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def tone_hz(self) -> float: ...
    @property
    def tone_sigma_hz(self) -> float: ...
    @property
    def tone_snr_db(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def value(self) -> float:
        """
        Of what was at fault.
        """

class ApertureStatus(enum.IntEnum):
    """
    What an aperture's data allowed.
    """

    NON_FINITE = ...
    NO_CONVERGENCE = ...
    NO_POWER = ...
    OK = ...
    PATH_TOO_SHORT = ...
    SINGULAR = ...
    STEP_TOO_LONG = ...
    TOO_FEW_COHERENT = ...
    TOO_FEW_NODES = ...
    TOO_FEW_SNAPSHOTS = ...
    TWO_ANSWERS = ...
    def __format__(self, format_spec): ...

class ApertureOptions:
    """
    What is unknown about an aperture.
    """
    def __init__(
        self,
        *,
        phase: str = "free",
        phase_sigma_rad_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        frequency_offsets: bool = True,
        max_frequency_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        path_sigma_m_per_sqrt_step: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        coherence_threshold: typing.SupportsFloat | typing.SupportsIndex = 0.7,
        max_sigma_rad: typing.SupportsFloat | typing.SupportsIndex = 0.6,
    ) -> None: ...

class SyntheticAperture:
    """
    Bearings from phases along a path.
    """
    def __init__(self, options: ApertureOptions) -> None: ...
    def bearings(
        self,
        phasors: numpy.typing.ArrayLike,
        path_m: numpy.typing.ArrayLike,
        time_s: numpy.typing.ArrayLike,
        wavelength_m: numpy.typing.ArrayLike,
        path_modes_m: numpy.typing.ArrayLike,
    ) -> dict:
        """
        What the links said, by name.
        """
    def blind(
        self, phasors: numpy.typing.ArrayLike, time_s: numpy.typing.ArrayLike, wavelength_m: numpy.typing.ArrayLike
    ) -> dict:
        """
        Angles between nodes without a path, by name.
        """

def aperture_crlb(
    path_m: numpy.typing.ArrayLike,
    time_s: numpy.typing.ArrayLike,
    wavelength_m: numpy.typing.ArrayLike,
    bearing_rad: numpy.typing.ArrayLike,
    snr: numpy.typing.ArrayLike,
    path_modes_m: numpy.typing.ArrayLike,
    options: ApertureOptions,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    Bound of the bearings' covariance.
    """

def aperture_directions(
    phasors: numpy.typing.ArrayLike,
    path_m: numpy.typing.ArrayLike,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
    method: str,
    n_sources: typing.SupportsInt | typing.SupportsIndex,
    subaperture: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Its highest maxima.
    """

def aperture_spectrum(
    phasors: numpy.typing.ArrayLike,
    path_m: numpy.typing.ArrayLike,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
    bearing_rad: numpy.typing.ArrayLike,
    method: str,
    n_sources: typing.SupportsInt | typing.SupportsIndex,
    subaperture: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Spectrum over bearings.
    """

def apply_correction(
    iq: numpy.typing.NDArray[numpy.complex64],
    iq_gain: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    iq_phase_rad: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    dc: collections.abc.Sequence[complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex],
    gain: collections.abc.Sequence[complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex],
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Undoes the faults of channels, whose rows lie one after the other.
    """

def calibrate(
    iq: numpy.typing.NDArray[numpy.complex64],
    channels: typing.SupportsInt | typing.SupportsIndex,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    tone_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    reference: typing.SupportsInt | typing.SupportsIndex = 0,
    tolerance_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> CalibrationReport:
    """
    Faults of channels from a tone that reaches them alike. iq: the channels' rows one after the other.
    """

def check_bearings(
    bearing_rad: numpy.typing.ArrayLike,
    covariance_rad2: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    nodes_m: numpy.typing.ArrayLike,
    position_m: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[2, 1]"],
    position_covariance_m2: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[2, 2]"],
    heading_rad: typing.SupportsFloat | typing.SupportsIndex,
    heading_sigma_rad: typing.SupportsFloat | typing.SupportsIndex,
    gate: typing.SupportsFloat | typing.SupportsIndex,
) -> dict:
    """
    Whether bearings point where nodes are.
    """

def covariance(
    iq: numpy.typing.NDArray[numpy.complex64],
) -> tuple[ArrayStatus, int, numpy.typing.NDArray[numpy.complex128]]:
    """
    Status, channel at fault, covariance.
    """

def crlb(
    manifold: Manifold,
    directions: numpy.typing.ArrayLike,
    powers: numpy.typing.ArrayLike,
    noise: typing.SupportsFloat | typing.SupportsIndex,
    n_snapshots: typing.SupportsFloat | typing.SupportsIndex,
    kind: str,
    azimuth_only: bool,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Covariance bound [rad^2].
    """

def eigenvalues(R: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Largest first.
    """

def esprit(
    R: numpy.typing.ArrayLike,
    n_sources: typing.SupportsInt | typing.SupportsIndex,
    *,
    spacing_wavelengths: typing.SupportsFloat | typing.SupportsIndex = 0.5,
    total_least_squares: bool = True,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Angles, ascending.
    """

def far_field(
    aperture_m: typing.SupportsFloat | typing.SupportsIndex, wavelength_m: typing.SupportsFloat | typing.SupportsIndex
) -> tuple[float, float, float]:
    """
    Limits of carter (4.1), (4.2), (4.3).
    """

def field_region(
    aperture_m: typing.SupportsFloat | typing.SupportsIndex,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
) -> str:
    """
    near, marginal or far.
    """

def forward_backward(R: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.complex128]:
    """
    (R + J conj(R) J) / 2.
    """

def impedance_factor(
    antenna_ohm: complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
    load_ohm: complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    q of carter (4.8).
    """

def polarization_factor(
    tilt_a_rad: typing.SupportsFloat | typing.SupportsIndex,
    ellipticity_a_rad: typing.SupportsFloat | typing.SupportsIndex,
    tilt_b_rad: typing.SupportsFloat | typing.SupportsIndex,
    ellipticity_b_rad: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    p of carter (4.8).
    """

def received_power_dbm(
    transmit_power_dbm: typing.SupportsFloat | typing.SupportsIndex,
    transmit_gain_db: typing.SupportsFloat | typing.SupportsIndex,
    receive_gain_db: typing.SupportsFloat | typing.SupportsIndex,
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
    frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
    polarization: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    impedance: typing.SupportsFloat | typing.SupportsIndex = 1.0,
) -> float:
    """
    carter (4.8).
    """

def root_music(
    R: numpy.typing.ArrayLike,
    n_sources: typing.SupportsInt | typing.SupportsIndex,
    *,
    spacing_wavelengths: typing.SupportsFloat | typing.SupportsIndex = 0.5,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Angles, ascending.
    """

def source_count(
    eigenvalues: numpy.typing.ArrayLike, n_snapshots: typing.SupportsFloat | typing.SupportsIndex, method: str = "mdl"
) -> int:
    """
    Number of sources, or -1.
    """

def spatial_smoothing(
    R: numpy.typing.ArrayLike, subarray_size: typing.SupportsInt | typing.SupportsIndex, forward_backward: bool = False
) -> numpy.typing.NDArray[numpy.complex128]:
    """
    Mean over subarrays of a ULA.
    """

def spectrum(
    kind: str,
    R: numpy.typing.ArrayLike,
    steering: numpy.typing.ArrayLike,
    n_sources: typing.SupportsInt | typing.SupportsIndex = 1,
    loading: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Bartlett, Capon or MUSIC spectrum, shape (G,).
    """
