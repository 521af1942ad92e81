"""
Satellite navigation: orbits, positions, attitude.
"""

from __future__ import annotations
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "AttitudeModel",
    "AttitudeStatus",
    "BaselineOptions",
    "BaselineStatus",
    "EphemerisTable",
    "PhaseUse",
    "PointOptions",
    "PointStatus",
    "SatelliteUse",
    "StaticPhaseOptions",
    "StaticPhaseStatus",
    "arrival_angle",
    "arrival_angle_sigma",
    "attitude_fixes",
    "attitude_run",
    "baselines",
    "heading_error",
    "heading_error_density",
    "lambda_ils",
    "phase_wind_up",
    "receiver_differences",
    "resolve_cycles",
    "satellite_states",
    "sights",
    "single_points",
    "static_phase",
    "success_rate",
    "walker_constellation",
]

class EphemerisTable:
    """
    Broadcast orbits, ready to be looked up.
    """
    def __init__(self, ephemerides: numpy.typing.ArrayLike) -> None: ...
    def __len__(self) -> int: ...
    def prns(self) -> list[int]:
        """
        The satellites' numbers, ascending.
        """
    def rows(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        All numbers, sorted.
        """

class PointStatus(enum.IntEnum):
    """
    How a fix ended.
    """

    CONVERGED = ...
    INCONSISTENT = ...
    NOT_CONVERGED = ...
    RANK_DEFICIENT = ...
    TOO_FEW_SATELLITES = ...
    def __format__(self, format_spec): ...

class SatelliteUse(enum.IntEnum):
    """
    What a fix did with a satellite.
    """

    LOW = ...
    NOT_FINITE = ...
    NO_EPHEMERIS = ...
    REJECTED = ...
    STALE = ...
    UNHEALTHY = ...
    USED = ...
    def __format__(self, format_spec): ...

class PointOptions:
    """
    What a fix assumes.
    """
    def __init__(
        self,
        *,
        elevation_mask_rad: typing.SupportsFloat | typing.SupportsIndex,
        sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        sigma_rate_mps: typing.SupportsFloat | typing.SupportsIndex,
        weight_by_elevation: bool,
        ionosphere: bool,
        troposphere: bool,
        relative_humidity: typing.SupportsFloat | typing.SupportsIndex,
        reject_outliers: bool,
        false_alarm_probability: typing.SupportsFloat | typing.SupportsIndex,
        max_age_s: typing.SupportsFloat | typing.SupportsIndex,
        max_iterations: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...

class BaselineStatus(enum.IntEnum):
    """
    What became of an epoch.
    """

    DEGENERATE = ...
    FIXED = ...
    FLOAT = ...
    TOO_FEW_SATELLITES = ...
    TRACKED = ...
    def __format__(self, format_spec): ...

class BaselineOptions:
    """
    What a baseline may assume.
    """
    def __init__(
        self,
        *,
        wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
        phase_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        code_phase_ratio: typing.SupportsFloat | typing.SupportsIndex,
        mask_rad: typing.SupportsFloat | typing.SupportsIndex,
        ratio: typing.SupportsFloat | typing.SupportsIndex,
        length_m: typing.SupportsFloat | typing.SupportsIndex | None,
        search: str,
        candidates: typing.SupportsInt | typing.SupportsIndex,
        max_pitch_rad: typing.SupportsFloat | typing.SupportsIndex,
        max_satellites: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...

class AttitudeStatus(enum.IntEnum):
    """
    How an attitude ended.
    """

    AMBIGUOUS = ...
    GATED = ...
    GIMBAL_LOCK = ...
    NON_FINITE = ...
    NOT_CONVERGED = ...
    SATELLITES_IN_PLANE = ...
    SOLVED = ...
    TOO_FEW_SATELLITES = ...
    UNOBSERVABLE = ...
    def __format__(self, format_spec): ...

class AttitudeModel:
    """
    Antennas on a body and the noise of their path differences.
    """
    def __init__(
        self,
        baselines_m: numpy.typing.ArrayLike,
        sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        common_clock: bool,
        shared_reference: bool,
    ) -> None: ...

class PhaseUse(enum.IntEnum):
    """
    What became of a satellite's phase.
    """

    LOW = ...
    MISSING = ...
    NO_CLOCK = ...
    NO_EPHEMERIS = ...
    PARTIAL = ...
    REJECTED = ...
    SHORT_ARC = ...
    UNHEALTHY = ...
    USED = ...
    def __format__(self, format_spec): ...

class StaticPhaseStatus(enum.IntEnum):
    """
    How a solution ended.
    """

    RANK_DEFICIENT = ...
    SOLVED = ...
    TOO_FEW_SATELLITES = ...
    TOO_MANY_ARCS = ...
    TOO_SHORT = ...
    def __format__(self, format_spec): ...

class StaticPhaseOptions:
    """
    What a standing antenna's solution assumes.
    """
    def __init__(
        self,
        *,
        dual: bool,
        elevation_mask_rad: typing.SupportsFloat | typing.SupportsIndex,
        code_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        phase_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        phase_correlation_s: typing.SupportsFloat | typing.SupportsIndex,
        range_error_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        range_error_rate_mps: typing.SupportsFloat | typing.SupportsIndex,
        zenith_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        relative_humidity: typing.SupportsFloat | typing.SupportsIndex,
        max_gap_s: typing.SupportsFloat | typing.SupportsIndex,
        slip_m: typing.SupportsFloat | typing.SupportsIndex,
        min_arc_epochs: typing.SupportsInt | typing.SupportsIndex,
        wind_up: bool,
        max_age_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

def arrival_angle(
    path_m: numpy.typing.ArrayLike, baseline_m: typing.SupportsFloat | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Angles between a baseline and sources.
    """

def arrival_angle_sigma(
    angle_rad: numpy.typing.ArrayLike,
    baseline_m: typing.SupportsFloat | typing.SupportsIndex,
    path_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Their first-order deviations.
    """

def attitude_fixes(
    model: AttitudeModel,
    directions: numpy.typing.ArrayLike,
    path_differences_m: numpy.typing.ArrayLike,
    start: numpy.typing.ArrayLike | None,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
    min_ratio: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    Attitudes epoch by epoch, column by column.
    """

def attitude_run(
    model: AttitudeModel,
    euler: bool,
    rate_noise_rad_rts: typing.SupportsFloat | typing.SupportsIndex,
    false_alarm_probability: typing.SupportsFloat | typing.SupportsIndex,
    start: numpy.typing.ArrayLike,
    covariance_rad2: numpy.typing.ArrayLike,
    steps_s: numpy.typing.ArrayLike,
    directions: numpy.typing.ArrayLike,
    path_differences_m: numpy.typing.ArrayLike,
    rates_radps: numpy.typing.ArrayLike | None,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    The attitude filter over many epochs, column by column.
    """

def baselines(
    options: BaselineOptions,
    track: bool,
    directions: numpy.typing.ArrayLike,
    code_m: numpy.typing.ArrayLike,
    phase_cycles: numpy.typing.ArrayLike,
    lost_lock: numpy.typing.ArrayLike,
) -> tuple:
    """
    Baselines epoch by epoch, column by column.
    """

def heading_error(
    baseline_m: typing.SupportsFloat | typing.SupportsIndex,
    position_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float, float]:
    """
    (linear sigma, rms, probability of inversion).
    """

def heading_error_density(
    error_rad: numpy.typing.ArrayLike, kappa: typing.SupportsFloat | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Probability density of a heading error.
    """

def lambda_ils(
    a: numpy.typing.ArrayLike, Q: numpy.typing.ArrayLike, n_candidates: typing.SupportsInt | typing.SupportsIndex
) -> tuple:
    """
    (integers (k, n), squared norms (k,)), the nearest first.
    """

def phase_wind_up(
    satellite_m: numpy.typing.ArrayLike,
    receiver_m: numpy.typing.ArrayLike,
    week: typing.SupportsFloat | typing.SupportsIndex,
    time_of_week_s: typing.SupportsFloat | typing.SupportsIndex,
    before: typing.SupportsFloat | typing.SupportsIndex,
) -> float | None:
    """
    Cycles, or None.
    """

def receiver_differences(
    table: EphemerisTable,
    base_position_m: numpy.typing.ArrayLike,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    code_m: numpy.typing.ArrayLike,
    phase_cycles: numpy.typing.ArrayLike,
) -> tuple:
    """
    (directions, code_m, phase_cycles), rover minus base.
    """

def resolve_cycles(
    model: AttitudeModel,
    quaternion: numpy.typing.ArrayLike,
    directions: numpy.typing.ArrayLike,
    phase_cycles: numpy.typing.ArrayLike,
    wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (path differences, greatest distance in cycles).
    """

def satellite_states(
    table: EphemerisTable,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    max_age_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (position, velocity, clock_s, clock_rate).
    """

def sights(
    table: EphemerisTable,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    receiver_position_m: numpy.typing.ArrayLike,
    receiver_velocity_mps: numpy.typing.ArrayLike,
    max_age_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    (position, velocity, direction, range, range rate, azimuth, elevation, clock_s, clock_rate).
    """

def single_points(
    table: EphemerisTable,
    klobuchar: numpy.typing.ArrayLike | None,
    options: PointOptions,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    code_m: numpy.typing.ArrayLike,
    range_rate_mps: numpy.typing.ArrayLike,
    sigmas_m: numpy.typing.ArrayLike,
) -> tuple:
    """
    The fixes of many epochs, column by column.
    """

def static_phase(
    table: EphemerisTable,
    klobuchar: numpy.typing.ArrayLike | None,
    options: StaticPhaseOptions,
    prn: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    code1_m: numpy.typing.ArrayLike,
    code2_m: numpy.typing.ArrayLike,
    phase1_cycles: numpy.typing.ArrayLike,
    phase2_cycles: numpy.typing.ArrayLike,
    lost_lock: numpy.typing.ArrayLike,
) -> dict:
    """
    The solution by name.
    """

def success_rate(Q: numpy.typing.ArrayLike) -> float:
    """
    Probability that integer bootstrapping is right.
    """

def walker_constellation(
    satellites: typing.SupportsInt | typing.SupportsIndex,
    planes: typing.SupportsInt | typing.SupportsIndex,
    phasing: typing.SupportsInt | typing.SupportsIndex,
    inclination_rad: typing.SupportsFloat | typing.SupportsIndex,
    radius_m: typing.SupportsFloat | typing.SupportsIndex,
    week: typing.SupportsInt | typing.SupportsIndex,
    toe_s: typing.SupportsFloat | typing.SupportsIndex,
    first_node_rad: typing.SupportsFloat | typing.SupportsIndex,
    fit_interval_s: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Ephemerides of a Walker constellation.
    """
