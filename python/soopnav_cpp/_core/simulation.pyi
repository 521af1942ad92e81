"""
Channels: noise, carrier offset, clock error, path loss.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import soopnav_cpp._core.array
import soopnav_cpp._core.geometry
import soopnav_cpp._core.gnss
import soopnav_cpp._core.iridium
import soopnav_cpp._core.ofdm
import soopnav_cpp._core.vision
import typing

__all__: list[str] = [
    "BoundarySeries",
    "ChannelEmulator",
    "ChannelSounder",
    "ClockTrack",
    "FrontEnd",
    "GnssObservableOptions",
    "GroundScene",
    "ImuErrorModel",
    "IndoorRoom",
    "LinkBudget",
    "LinkStatus",
    "Material",
    "OfdmLink",
    "OpportunityLink",
    "OpportunitySource",
    "PairLink",
    "PairReceiver",
    "PlanarTrajectory",
    "SampledEnvelope",
    "SensorErrorModel",
    "SpatialTrajectory",
    "add_awgn",
    "apply_cfo",
    "apply_clock_error",
    "apply_taps",
    "array_samples",
    "down_convert",
    "drift_path",
    "eigenvalue_map",
    "excess_delays",
    "far_field_limit_m",
    "free_space_path_loss_db",
    "friis_received_power_dbm",
    "handset_world",
    "increment_between",
    "log_distance_path_loss_db",
    "mean_power",
    "nlos_schedule",
    "noise_variance_for_element_snr",
    "noise_variance_for_snr",
    "render_aperture",
    "ricean_reflections",
    "sample_covariances",
    "simulate_gnss",
    "slab_response",
    "step_sweep",
    "thermal_noise_dbm",
    "with_opening",
]

class Material(enum.Enum):
    """
    What a wall is made of (ITU-R P.2040-2, table 3).
    """

    BRICK = ...
    CONCRETE = ...
    GLASS = ...
    METAL = ...
    PLASTER = ...
    WOOD = ...

class LinkStatus(enum.Enum):
    """
    How a link of an indoor room came out.
    """

    DARK = ...
    NOT_FINITE = ...
    OK = ...
    TOO_CLOSE = ...

class IndoorRoom:
    """
    Propagation in and into a room by the image method.
    """
    def __init__(
        self,
        walls: collections.abc.Sequence[
            tuple[
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
                Material,
                typing.SupportsFloat | typing.SupportsIndex,
            ]
        ],
        *,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        order: typing.SupportsInt | typing.SupportsIndex,
        height_m: typing.SupportsFloat | typing.SupportsIndex,
        floor_and_ceiling: bool,
        floor_material: Material,
        floor_thickness_m: typing.SupportsFloat | typing.SupportsIndex,
        path_range_db: typing.SupportsFloat | typing.SupportsIndex,
        detect_range_db: typing.SupportsFloat | typing.SupportsIndex,
        los_loss_db: typing.SupportsFloat | typing.SupportsIndex,
        tail_db: typing.SupportsFloat | typing.SupportsIndex,
        tail_decay_s: typing.SupportsFloat | typing.SupportsIndex,
        tail_spacing_s: typing.SupportsFloat | typing.SupportsIndex,
        tail_taps: typing.SupportsInt | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def links(self, nodes_m: numpy.typing.ArrayLike, places_m: numpy.typing.ArrayLike) -> tuple:
        """
        Status, sight, distance, wall loss, power, excess delay, paths, start, delay and gain of the taps.
        """
    def wall_loss_db(
        self, nodes_m: numpy.typing.ArrayLike, places_m: numpy.typing.ArrayLike
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        What walls take from the straight paths [dB].
        """

class ChannelSounder:
    """
    Pulse transmitter with switched ports, and its receiver.
    """
    def __init__(
        self,
        *,
        pulse_s: typing.SupportsFloat | typing.SupportsIndex,
        rise_s: typing.SupportsFloat | typing.SupportsIndex,
        period_s: typing.SupportsFloat | typing.SupportsIndex,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        if_hz: typing.SupportsFloat | typing.SupportsIndex,
        filter_hz: typing.SupportsFloat | typing.SupportsIndex,
        averages: typing.SupportsInt | typing.SupportsIndex,
        calibration_averages: typing.SupportsInt | typing.SupportsIndex,
        snr_db: typing.SupportsFloat | typing.SupportsIndex,
        reference_gain: typing.SupportsFloat | typing.SupportsIndex,
        adc_bits: typing.SupportsInt | typing.SupportsIndex,
        headroom: typing.SupportsFloat | typing.SupportsIndex,
        guard_s: typing.SupportsFloat | typing.SupportsIndex,
        switch_time_s: typing.SupportsFloat | typing.SupportsIndex,
        isolation_db: typing.SupportsFloat | typing.SupportsIndex,
        phase_noise_rad: typing.SupportsFloat | typing.SupportsIndex,
        shared_reference: bool,
        clock_rad_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def calibrate(self) -> tuple[numpy.typing.NDArray[numpy.complex128], int]:
        """
        Lines over a cable, and clipped samples.
        """
    def line_noise_variance(self, averages: typing.SupportsInt | typing.SupportsIndex) -> float:
        """
        Of a recorded line.
        """
    def record(
        self,
        channels: collections.abc.Sequence[
            collections.abc.Sequence[
                collections.abc.Sequence[
                    tuple[
                        typing.SupportsFloat | typing.SupportsIndex,
                        complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
                    ]
                ]
            ]
        ],
        first_slot: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> tuple:
        """
        Lines, times, clipped samples and whether finite, of each place and port.
        """
    @property
    def line_hz(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Frequencies of the lines.
        """
    @property
    def lines(self) -> numpy.typing.NDArray[numpy.complex128]:
        """
        Pulse and filter at each line.
        """
    @property
    def slot_s(self) -> float:
        """
        Guard and averages.
        """

class ChannelEmulator:
    """
    Channels of any bandwidth from recorded lines.
    """
    def __init__(
        self,
        line_hz: numpy.typing.ArrayLike,
        reference: typing.Annotated[numpy.typing.ArrayLike, numpy.complex128],
        *,
        bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        delay_low_s: typing.SupportsFloat | typing.SupportsIndex,
        delay_high_s: typing.SupportsFloat | typing.SupportsIndex,
        null_db: typing.SupportsFloat | typing.SupportsIndex,
        noise_to_signal: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def sigma(self, frequencies_hz: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Relative 1-sigma of the channel.
        """
    def taps(
        self, lines: typing.Annotated[numpy.typing.ArrayLike, numpy.complex128]
    ) -> numpy.typing.NDArray[numpy.complex128]:
        """
        Gains of the taps; NaN where lines are not finite.
        """
    @property
    def covered(self) -> bool:
        """
        The usable lines reach both ends of the band.
        """
    @property
    def delays_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the taps.
        """
    @property
    def lines_used(self) -> int:
        """
        Lines that the taps are fitted to.
        """
    @property
    def nulls_hz(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Lines that are not divided by.
        """

class GnssObservableOptions:
    """
    What a simulated GNSS receiver is like.
    """
    def __init__(
        self,
        *,
        elevation_mask_rad: typing.SupportsFloat | typing.SupportsIndex,
        cn0_zenith_dbhz: typing.SupportsFloat | typing.SupportsIndex,
        cn0_drop_db: typing.SupportsFloat | typing.SupportsIndex,
        noise: bool,
        phase_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        code_bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
        early_late_chips: typing.SupportsFloat | typing.SupportsIndex,
        integration_s: typing.SupportsFloat | typing.SupportsIndex,
        code_sigma_m: typing.SupportsFloat | typing.SupportsIndex | None,
        phase_sigma_m: typing.SupportsFloat | typing.SupportsIndex | None,
        doppler_sigma_hz: typing.SupportsFloat | typing.SupportsIndex,
        multipath_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        multipath_time_s: typing.SupportsFloat | typing.SupportsIndex,
        multipath_phase_ratio: typing.SupportsFloat | typing.SupportsIndex,
        ionosphere: numpy.typing.ArrayLike | None,
        troposphere: bool,
        relative_humidity: typing.SupportsFloat | typing.SupportsIndex,
        integers: bool,
        max_age_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class SensorErrorModel:
    """
    Errors of a sensor's equal axes; all zero by default. Unit: rad/s or m/s².
    """
    def __eq__(self, arg0: SensorErrorModel) -> bool: ...
    def __getstate__(self) -> tuple: ...
    def __hash__(self) -> int: ...
    def __init__(
        self,
        *,
        sample_sigma: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        white_density: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        turn_on_sigma: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        bias_walk_density: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        markov_sigma: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        markov_time_s: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        scale_sigma: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        misalignment_sigma: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        saturation: typing.SupportsFloat | typing.SupportsIndex = ...,
        quantum: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> None:
        """
        White noise of each sample and by density [unit/√Hz], bias at start, its walk [unit/√s], a Gauss-Markov bias, relative scale, small angles [rad], largest reading and converter step.
        """
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def bias_walk_density(self) -> float: ...
    @property
    def markov_sigma(self) -> float: ...
    @property
    def markov_time_s(self) -> float: ...
    @property
    def misalignment_sigma(self) -> float: ...
    @property
    def quantum(self) -> float: ...
    @property
    def sample_sigma(self) -> float: ...
    @property
    def saturation(self) -> float: ...
    @property
    def scale_sigma(self) -> float: ...
    @property
    def turn_on_sigma(self) -> float: ...
    @property
    def white_density(self) -> float: ...

class ImuErrorModel:
    """
    Errors of a unit's gyros [rad/s] and accelerometers [m/s²].
    """
    @staticmethod
    def consumer() -> ImuErrorModel:
        """
        200 µg/√Hz, 0.01 °/s/√Hz; biases 5 mg, 50 °/h.
        """
    @staticmethod
    def crosby() -> ImuErrorModel:
        """
        White, 0.1 rad/s and 0.1 m/s² per sample (crosby section 4.1).
        """
    @staticmethod
    def industrial() -> ImuErrorModel:
        """
        60 µg/√Hz, 0.15 °/√h; biases 0.5 mg, 5 °/h.
        """
    @staticmethod
    def tactical() -> ImuErrorModel:
        """
        30 µg/√Hz, 0.05 °/√h; biases 0.3 mg, 1 °/h.
        """
    def __eq__(self, arg0: ImuErrorModel) -> bool: ...
    def __getstate__(self) -> tuple[tuple, tuple]: ...
    def __hash__(self) -> int: ...
    def __init__(self, gyro: SensorErrorModel = ..., accelerometer: SensorErrorModel = ...) -> None:
        """
        Perfect by default.
        """
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def apply(
        self,
        rate_radps: numpy.typing.ArrayLike,
        force_mps2: numpy.typing.ArrayLike,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> tuple:
        """
        What a unit with these errors says of true rows: (rates, forces, whether saturated). Shapes (n, 3) and (n, 3) in space, (n, 1) and (n, 2) in the plane.
        """
    @property
    def accelerometer(self) -> SensorErrorModel: ...
    @property
    def gyro(self) -> SensorErrorModel: ...

class PlanarTrajectory:
    """
    A planar trajectory; made by the functions of soopnav_cpp.simulation.
    """
    @staticmethod
    def continuous_turn(
        *,
        duration_s: typing.SupportsFloat | typing.SupportsIndex,
        speed_mps: typing.SupportsFloat | typing.SupportsIndex,
        ramp_s: typing.SupportsFloat | typing.SupportsIndex,
        turn_rate_radps: typing.SupportsFloat | typing.SupportsIndex,
        turn_amplitude_radps: typing.SupportsFloat | typing.SupportsIndex,
        turn_period_s: typing.SupportsFloat | typing.SupportsIndex,
        heading_rad: typing.SupportsFloat | typing.SupportsIndex,
        position_m: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(2)"
        ],
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> PlanarTrajectory:
        """
        From rest into a turn that never settles.
        """
    @staticmethod
    def from_profiles(
        yaw_rate_radps: numpy.typing.ArrayLike,
        specific_force_b_mps2: numpy.typing.ArrayLike,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        heading_rad: typing.SupportsFloat | typing.SupportsIndex,
        velocity_mps: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(2)"
        ],
        position_m: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(2)"
        ],
    ) -> PlanarTrajectory:
        """
        Profiles integrated by trapezoids.
        """
    @staticmethod
    def through(
        waypoints_m: numpy.typing.ArrayLike,
        *,
        speed_mps: typing.SupportsFloat | typing.SupportsIndex,
        acceleration_mps2: typing.SupportsFloat | typing.SupportsIndex,
        lateral_acceleration_mps2: typing.SupportsFloat | typing.SupportsIndex,
        smoothing_s: typing.SupportsFloat | typing.SupportsIndex,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> PlanarTrajectory:
        """
        From rest to rest along a smooth way.
        """
    def at(self, t_s: numpy.typing.ArrayLike) -> tuple:
        """
        (heading, velocity, position, yaw rate, specific force) at times.
        """
    def imu(
        self,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        *,
        errors: ImuErrorModel,
        sampling: str,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex,
    ) -> tuple:
        """
        (t_s, yaw rate, specific force, whether saturated) of a simulated unit.
        """
    @property
    def duration_s(self) -> float: ...
    @property
    def heading_rad(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def position_m(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def specific_force_b_mps2(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def t_s(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def velocity_mps(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def yaw_rate_radps(self) -> numpy.typing.NDArray[numpy.float64]: ...

class SpatialTrajectory:
    """
    A smooth path in three dimensions. Immutable.
    """
    @staticmethod
    def through(
        frame: soopnav_cpp._core.geometry.LocalFrame,
        waypoints_m: numpy.typing.ArrayLike,
        *,
        speed_mps: typing.SupportsFloat | typing.SupportsIndex,
        max_acceleration_mps2: typing.SupportsFloat | typing.SupportsIndex,
        rest_s: typing.SupportsFloat | typing.SupportsIndex | None,
        roll: numpy.typing.ArrayLike,
        pitch: numpy.typing.ArrayLike,
    ) -> SpatialTrajectory: ...
    def __init__(
        self,
        frame: soopnav_cpp._core.geometry.LocalFrame,
        control_points_m: numpy.typing.ArrayLike,
        knot_s: typing.SupportsFloat | typing.SupportsIndex,
        *,
        roll: numpy.typing.ArrayLike,
        pitch: numpy.typing.ArrayLike,
    ) -> None: ...
    def at(self, t_s: numpy.typing.ArrayLike) -> tuple:
        """
        Position, velocity, acceleration, quaternion, rate at times.
        """
    def imu_increments(
        self,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        end_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> tuple:
        """
        Exact increments of rate and specific force.
        """
    def navigation_states(self, t_s: numpy.typing.ArrayLike) -> tuple:
        """
        Latitude, longitude, height; velocity and quaternion in the moving north-east-down frame.
        """
    @property
    def duration_s(self) -> float: ...
    @property
    def greatest_acceleration_mps2(self) -> float: ...
    @property
    def knot_s(self) -> float: ...

class BoundarySeries:
    """
    What the measured epochs of an OfdmLink gave, a row per epoch. Read-only.
    """
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    @property
    def folded(self) -> numpy.typing.NDArray[numpy.float64] | None:
        """
        Folded differences, shape (epochs, M), or None.
        """
    @property
    def metric(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        |gamma| / Phi at the boundary, shape (epochs,).
        """
    @property
    def range_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        In 0 ... ambiguity, shape (epochs,).
        """
    @property
    def sigma_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Standard deviation of each, reflections not counted; shape (epochs,).
        """
    @property
    def status(self) -> numpy.typing.NDArray[numpy.uint8]:
        """
        Values of ofdm.BoundaryStatus, shape (epochs,), uint8.
        """

class OfdmLink:
    """
    One OFDM transmitter as a receiver hears it: fresh symbols each epoch, moved by the path's length, with a
    reflection, white noise and a carrier offset. The longer the path, the larger the boundary.
    """
    def __init__(
        self,
        numerology: soopnav_cpp._core.ofdm.Numerology = ...,
        symbols: typing.SupportsInt | typing.SupportsIndex = 250,
        *,
        oversampling: typing.SupportsInt | typing.SupportsIndex = 1,
        movement: str = "interpolate_and_shift",
        constellation: str = "qpsk",
        cfo_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        band_limited_noise: bool = False,
    ) -> None:
        """
        oversampling: 1, or 15 for a receiver that takes all fine samples. movement: "interpolate_and_shift" by
        floor(delay / fine sample) fine samples of c / (15 f_s), or "fractional_delay", exact for any real delay.
        constellation: "qpsk", "16qam" or "64qam". band_limited_noise: made at the critical rate and
        interpolated. Raises ValueError for what cannot be.
        """
    def __repr__(self) -> str: ...
    def iq(
        self,
        delay_m: typing.SupportsFloat | typing.SupportsIndex,
        *,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex = 0,
        snr_db: typing.SupportsFloat | typing.SupportsIndex | None = None,
        reflection: tuple[
            typing.SupportsFloat | typing.SupportsIndex,
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
        ]
        | None = None,
    ) -> numpy.typing.NDArray[numpy.complex64]:
        """
        The samples of one epoch, complex64, shape (symbols + 1) M oversampling. snr_db: per sample of the receiver;
        None for no noise. reflection: extra path [m] and complex gain over the line of sight.
        """
    def measure(
        self,
        delay_m: numpy.typing.ArrayLike,
        *,
        method: str = "nearest_sample",
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex = 0,
        snr_db: typing.SupportsFloat | typing.SupportsIndex | None = None,
        reflection_extra_m: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] | None = None,
        reflection_gain: collections.abc.Sequence[
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex
        ]
        | None = None,
        folded: bool = False,
        threads: typing.SupportsInt | typing.SupportsIndex = 1,
    ) -> BoundarySeries:
        """
        Simulates and measures an epoch per element of delay_m, shape (epochs,): the same bits for any number of
        threads. method as of ofdm.BoundaryEstimator. reflection_extra_m and reflection_gain: shape (epochs,), a gain
        of 0 is no reflection. folded: keep the folded differences, which ofdm.TwoRayTiming takes.
        """
    @property
    def numerology(self) -> soopnav_cpp._core.ofdm.Numerology: ...
    @property
    def oversampling(self) -> int: ...
    @property
    def symbols(self) -> int: ...

class FrontEnd:
    """
    Receivers in a row, with the faults that a calibration has to find.
    """
    def __init__(
        self,
        channels: typing.SupportsInt | typing.SupportsIndex,
        *,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        noise_figure_db: typing.SupportsFloat | typing.SupportsIndex,
        gain: collections.abc.Sequence[complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex],
        phase_delay_rad: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        iq_gain_db: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        iq_phase_rad: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        dc: collections.abc.Sequence[complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex],
        attenuation_db: typing.SupportsFloat | typing.SupportsIndex,
        attenuator_step_db: typing.SupportsFloat | typing.SupportsIndex,
        phase_step_rad: typing.SupportsFloat | typing.SupportsIndex,
        adc_bits: typing.SupportsInt | typing.SupportsIndex,
        full_scale_dbm: typing.SupportsFloat | typing.SupportsIndex | None,
    ) -> None: ...
    def apply(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        *,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> tuple[numpy.typing.NDArray[numpy.complex64], int]:
        """
        iq: the channels' rows one after the other. Returns the samples and how many parts were clipped.
        """
    def apply_blocks(
        self,
        iq: numpy.typing.NDArray[numpy.complex64],
        blocks: typing.SupportsInt | typing.SupportsIndex,
        *,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> numpy.typing.NDArray[numpy.complex64]:
        """
        Blocks one after the other, each as `apply` has it, with noise of its own. Returns the samples.
        """
    def phase_delay_rad(self, channel: typing.SupportsInt | typing.SupportsIndex) -> float: ...
    @property
    def channels(self) -> int: ...
    @property
    def full_scale_dbm(self) -> float: ...
    @property
    def noise_floor_dbm(self) -> float: ...
    @property
    def rest_attenuation_db(self) -> float: ...
    @property
    def stepped_attenuation_db(self) -> float: ...

class LinkBudget:
    """
    Power of one emitter from its transmitter to the array's receivers.
    """
    def __init__(
        self,
        *,
        frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        noise_figure_db: typing.SupportsFloat | typing.SupportsIndex,
        transmit_power_dbm: typing.SupportsFloat | typing.SupportsIndex,
        transmit_gain_dbi: typing.SupportsFloat | typing.SupportsIndex,
        receive_gain_dbi: typing.SupportsFloat | typing.SupportsIndex,
        splitter_loss_db: typing.SupportsFloat | typing.SupportsIndex,
        delay_system_loss_db: typing.SupportsFloat | typing.SupportsIndex,
        excess_loss_db: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def received_power_dbm(self, distance_m: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def noise_floor_dbm(self) -> float: ...

class ClockTrack:
    """
    A receiver's clock over system time.
    """
    @staticmethod
    def steady(
        bias_s: typing.SupportsFloat | typing.SupportsIndex,
        drift: typing.SupportsFloat | typing.SupportsIndex,
        epoch_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> ClockTrack: ...
    def __init__(
        self, t_s: numpy.typing.ArrayLike, bias_s: numpy.typing.ArrayLike, drift: numpy.typing.ArrayLike
    ) -> None: ...
    def at(
        self, t_s: numpy.typing.ArrayLike
    ) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]: ...
    def time_of(self, reading_s: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def t_s(self) -> numpy.typing.NDArray[numpy.float64]: ...

class SampledEnvelope:
    """
    Samples of any waveform as a continuous envelope.
    """
    def __init__(
        self,
        samples: numpy.typing.NDArray[numpy.complex64],
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    @property
    def begin_s(self) -> float: ...
    @property
    def end_s(self) -> float: ...

class PairReceiver:
    """
    Antenna, clock and echoes of one receiver.
    """
    def __init__(
        self,
        antenna: soopnav_cpp._core.geometry.SampledOrbit,
        clock: ClockTrack,
        tap_delay_s: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        tap_gain: collections.abc.Sequence[
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    def receive(
        self,
        waveform: soopnav_cpp._core.iridium.Burst | SampledEnvelope,
        beacon: soopnav_cpp._core.geometry.SampledOrbit,
        *,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        amplitude: typing.SupportsFloat | typing.SupportsIndex,
        phase_rad: typing.SupportsFloat | typing.SupportsIndex,
        grid_start_s: typing.SupportsFloat | typing.SupportsIndex,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        center_hz: typing.SupportsFloat | typing.SupportsIndex,
        first_sample: typing.SupportsInt | typing.SupportsIndex,
        samples: numpy.typing.NDArray[numpy.complex64],
    ) -> None:
        """
        Adds what it hears of a transmission to `samples`.
        """

class PairLink:
    """
    Two receivers of one transmission after the other.
    """
    def __init__(
        self,
        target: PairReceiver,
        anchor: PairReceiver,
        sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        center_hz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def bursts(
        self,
        duration_s: typing.SupportsFloat | typing.SupportsIndex,
        beacons: collections.abc.Sequence[soopnav_cpp._core.geometry.SampledOrbit],
        *,
        beacon: numpy.typing.ArrayLike,
        start_s: numpy.typing.ArrayLike,
        carrier_hz: numpy.typing.ArrayLike,
        target_start_s: numpy.typing.ArrayLike,
        anchor_start_s: numpy.typing.ArrayLike,
        samples: typing.SupportsInt | typing.SupportsIndex,
        center_hz: numpy.typing.ArrayLike,
        target_amplitude: numpy.typing.ArrayLike,
        anchor_amplitude: numpy.typing.ArrayLike,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex,
    ) -> tuple: ...
    def render(
        self,
        waveform: soopnav_cpp._core.iridium.Burst | SampledEnvelope,
        beacon: soopnav_cpp._core.geometry.SampledOrbit,
        *,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        phase_rad: typing.SupportsFloat | typing.SupportsIndex,
        target_amplitude: typing.SupportsFloat | typing.SupportsIndex,
        anchor_amplitude: typing.SupportsFloat | typing.SupportsIndex,
        target_start_s: typing.SupportsFloat | typing.SupportsIndex,
        target_samples: typing.SupportsInt | typing.SupportsIndex,
        anchor_start_s: typing.SupportsFloat | typing.SupportsIndex,
        anchor_samples: typing.SupportsInt | typing.SupportsIndex,
        center_hz: typing.SupportsFloat | typing.SupportsIndex,
        noise_variance: typing.SupportsFloat | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex,
    ) -> tuple: ...
    def sent_s(
        self,
        beacons: collections.abc.Sequence[soopnav_cpp._core.geometry.SampledOrbit],
        beacon: numpy.typing.ArrayLike,
        anchor_reading_s: numpy.typing.ArrayLike,
    ) -> numpy.typing.NDArray[numpy.float64]: ...
    def truth(
        self,
        beacons: collections.abc.Sequence[soopnav_cpp._core.geometry.SampledOrbit],
        beacon: numpy.typing.ArrayLike,
        sent_s: numpy.typing.ArrayLike,
        carrier_hz: numpy.typing.ArrayLike,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows of tdoa_s, fdoa_hz and, of target and anchor, t_s, reading_s, frequency_hz, delay_s, delay_rate, bias_s, drift.
        """

class GroundScene:
    """
    Textured ground below a camera, rendered with exact truth.
    """
    def __init__(
        self,
        seed: typing.SupportsInt | typing.SupportsIndex,
        *,
        size: typing.SupportsInt | typing.SupportsIndex = 2048,
        texel_m: typing.SupportsFloat | typing.SupportsIndex = 0.001,
        finest_texels: typing.SupportsInt | typing.SupportsIndex = 4,
        roughness: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        contrast: typing.SupportsFloat | typing.SupportsIndex = 0.22,
    ) -> None: ...
    def brightness(
        self, x_m: typing.SupportsFloat | typing.SupportsIndex, y_m: typing.SupportsFloat | typing.SupportsIndex
    ) -> float:
        """
        Of the ground there, 0 black, 1 white.
        """
    def depth_cloud(
        self,
        camera: soopnav_cpp._core.vision.Camera,
        view: numpy.typing.ArrayLike,
        points: typing.SupportsInt | typing.SupportsIndex,
        sensor: numpy.typing.ArrayLike,
        sensor_p_c: numpy.typing.ArrayLike,
        objects: numpy.typing.ArrayLike,
        wall: numpy.typing.ArrayLike | None,
        frame: typing.SupportsInt | typing.SupportsIndex,
    ) -> numpy.typing.NDArray[numpy.float32]: ...
    def render(
        self,
        camera: soopnav_cpp._core.vision.Camera,
        views: numpy.typing.ArrayLike,
        shot: numpy.typing.ArrayLike,
        objects: numpy.typing.ArrayLike,
        wall: numpy.typing.ArrayLike | None,
        frame: typing.SupportsInt | typing.SupportsIndex,
    ) -> numpy.typing.NDArray[numpy.uint8]: ...

class OpportunitySource:
    """
    A transmitter of a spread signal.
    """
    def __init__(
        self,
        *,
        band: typing.SupportsInt | typing.SupportsIndex,
        chips: numpy.typing.NDArray[numpy.complex64],
        chip_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
        bits: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        symbol_s: typing.SupportsFloat | typing.SupportsIndex,
        orbit: soopnav_cpp._core.geometry.SampledOrbit,
        h0: typing.SupportsFloat | typing.SupportsIndex,
        h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
        bias_s: typing.SupportsFloat | typing.SupportsIndex,
        drift: typing.SupportsFloat | typing.SupportsIndex,
        cn0_dbhz: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class OpportunityLink:
    """
    Samples of every band of a receiver with one oscillator.
    """
    def __init__(
        self,
        bands: numpy.typing.ArrayLike,
        sources: collections.abc.Sequence[OpportunitySource],
        *,
        position_e_m: numpy.typing.ArrayLike,
        velocity_e_mps: numpy.typing.ArrayLike,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        duration_s: typing.SupportsFloat | typing.SupportsIndex,
        step_s: typing.SupportsFloat | typing.SupportsIndex,
        h0: typing.SupportsFloat | typing.SupportsIndex,
        h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
        bias_s: typing.SupportsFloat | typing.SupportsIndex,
        drift: typing.SupportsFloat | typing.SupportsIndex,
        clock_bias_s: numpy.typing.ArrayLike,
        seed: typing.SupportsInt | typing.SupportsIndex,
        stream: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def delay_s(self, source: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        What a source's signal is behind at the nodes, clocks included.
        """
    def receiver_bias_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        The receiver's clock at the nodes.
        """
    def render(
        self,
        band: typing.SupportsInt | typing.SupportsIndex,
        first: typing.SupportsInt | typing.SupportsIndex,
        count: typing.SupportsInt | typing.SupportsIndex,
        *,
        noise: bool,
    ) -> numpy.typing.NDArray[numpy.complex64]:
        """
        Samples of a band.
        """
    def samples(self, band: typing.SupportsInt | typing.SupportsIndex) -> int:
        """
        Samples of a band.
        """
    def source_bias_s(self, source: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.float64]:
        """
        A source's clock at the nodes.
        """

def add_awgn(
    iq: numpy.typing.NDArray[numpy.complex64],
    variance: typing.SupportsFloat | typing.SupportsIndex,
    *,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq plus circular white Gaussian noise.
    """

def apply_cfo(
    iq: numpy.typing.NDArray[numpy.complex64],
    cfo_hz: typing.SupportsFloat | typing.SupportsIndex,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    phase_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq with its carrier moved.
    """

def apply_clock_error(
    iq: numpy.typing.NDArray[numpy.complex64], clock_error_ppm: typing.SupportsFloat | typing.SupportsIndex
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq as sampled from a transmitter whose clock is off.
    """

def apply_taps(
    iq: numpy.typing.NDArray[numpy.complex64],
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    taps: collections.abc.Sequence[
        tuple[
            typing.SupportsFloat | typing.SupportsIndex,
            complex | typing.SupportsComplex | typing.SupportsFloat | typing.SupportsIndex,
        ]
    ],
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    iq over several paths.
    """

def array_samples(
    steering: numpy.typing.ArrayLike,
    amplitude: numpy.typing.ArrayLike,
    *,
    samples: typing.SupportsInt | typing.SupportsIndex,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    waveform: str = "noise",
    bandwidth_ratio: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    tone_hz: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    noise_variance: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    delay_s: numpy.typing.ArrayLike | None = None,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    Blocks of array samples, shape (epochs, elements, samples). steering: (epochs, waves, elements, 2), amplitude:
    (epochs, waves), delay_s: (epochs, waves, elements).
    """

def down_convert(
    radio: numpy.typing.ArrayLike,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
    lo_hz: typing.SupportsFloat | typing.SupportsIndex,
    *,
    decimation: typing.SupportsInt | typing.SupportsIndex,
    lo_phase_rad: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> numpy.typing.NDArray[numpy.complex64]:
    """
    A real radio-frequency signal mixed to baseband and decimated.
    """

def drift_path(
    path_m: numpy.typing.ArrayLike,
    sigma_m_per_sqrt_step: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    A path as dead reckoning reports it.
    """

def eigenvalue_map(
    manifold: soopnav_cpp._core.array.Manifold,
    snr_db: numpy.typing.ArrayLike,
    *,
    snapshots: typing.SupportsInt | typing.SupportsIndex,
    trials: typing.SupportsInt | typing.SupportsIndex,
    elevation_low_rad: typing.SupportsFloat | typing.SupportsIndex,
    elevation_high_rad: typing.SupportsFloat | typing.SupportsIndex,
    step_rad: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
]:
    """
    SNR, mean eigenvalue ratio, rms errors of azimuth, elevation and direction, shape (k,) each.
    """

def excess_delays(
    line_of_sight: typing.Annotated[numpy.typing.ArrayLike, numpy.uint8],
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
    *,
    low_m: typing.SupportsFloat | typing.SupportsIndex,
    high_m: typing.SupportsFloat | typing.SupportsIndex,
    wander_m_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex,
    floor_m: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Excess delays of links out of sight.
    """

def far_field_limit_m(
    aperture_m: typing.SupportsFloat | typing.SupportsIndex, frequency_hz: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    The distance beyond which waves are flat across an aperture.
    """

def free_space_path_loss_db(
    distance_m: typing.SupportsFloat | typing.SupportsIndex, frequency_hz: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Free-space path loss.
    """

def friis_received_power_dbm(
    *,
    transmit_power_dbm: typing.SupportsFloat | typing.SupportsIndex,
    transmit_gain_dbi: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    receive_gain_dbi: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
    frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Power received over free space.
    """

def handset_world(
    seed: typing.SupportsInt | typing.SupportsIndex, **kwargs
) -> tuple[
    numpy.typing.NDArray[numpy.float64],
    float,
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    tuple,
]:
    """
    A walk indoors.
    """

def increment_between(
    previous: numpy.typing.ArrayLike, present: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]: ...
def log_distance_path_loss_db(
    distance_m: typing.SupportsFloat | typing.SupportsIndex,
    *,
    exponent: typing.SupportsFloat | typing.SupportsIndex,
    reference_distance_m: typing.SupportsFloat | typing.SupportsIndex,
    reference_loss_db: typing.SupportsFloat | typing.SupportsIndex,
) -> float:
    """
    Log-distance path loss.
    """

def mean_power(iq: numpy.typing.NDArray[numpy.complex64]) -> float:
    """
    Mean of |x|^2.
    """

def nlos_schedule(
    epochs: typing.SupportsInt | typing.SupportsIndex,
    step_s: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    **kwargs,
) -> tuple:
    """
    Which links are blocked when.
    """

def noise_variance_for_element_snr(
    snr_db: typing.SupportsFloat | typing.SupportsIndex,
    *,
    element_power: typing.SupportsFloat | typing.SupportsIndex = 1.0,
    transform_gain: typing.SupportsFloat | typing.SupportsIndex = 1.0,
) -> float:
    """
    Noise variance per sample for an SNR per resource element.
    """

def noise_variance_for_snr(
    signal_power: typing.SupportsFloat | typing.SupportsIndex, snr_db: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Noise variance per sample that stands snr_db below the signal.
    """

def render_aperture(
    bearing_rad: numpy.typing.ArrayLike,
    wavelength_m: numpy.typing.ArrayLike,
    snr: numpy.typing.ArrayLike,
    k_factor: numpy.typing.ArrayLike,
    frequency_hz: numpy.typing.ArrayLike,
    path_m: numpy.typing.ArrayLike,
    time_s: numpy.typing.ArrayLike,
    phase_rad: numpy.typing.ArrayLike,
    waves: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.complex128]:
    """
    Phasors of nodes along a path.
    """

def ricean_reflections(
    receivers_m: numpy.typing.ArrayLike,
    transmitter_m: numpy.typing.ArrayLike,
    reflector_m: numpy.typing.ArrayLike,
    *,
    mean: typing.SupportsFloat | typing.SupportsIndex = 0.33,
    variance: typing.SupportsFloat | typing.SupportsIndex = 0.0625,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.complex128]]:
    """
    Extra path [m] and complex gain over the line of sight of a Ricean reflection at each place.
    """

def sample_covariances(
    steering: numpy.typing.ArrayLike,
    amplitude: numpy.typing.ArrayLike,
    *,
    snapshots: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.complex128]:
    """
    Sample covariances of waves in unit noise from their exact law, shape (epochs, elements, elements).
    """

def simulate_gnss(
    table: soopnav_cpp._core.gnss.EphemerisTable,
    options: GnssObservableOptions,
    positions_m: numpy.typing.ArrayLike,
    velocities_mps: numpy.typing.ArrayLike,
    week: numpy.typing.ArrayLike,
    time_of_week_s: numpy.typing.ArrayLike,
    clock_bias_m: numpy.typing.ArrayLike,
    clock_drift_mps: numpy.typing.ArrayLike,
    seed: typing.SupportsInt | typing.SupportsIndex,
    stream: typing.SupportsInt | typing.SupportsIndex,
) -> tuple:
    """
    ([code, phase, Doppler, C/N0, range, range rate, azimuth, elevation], prns, integers).
    """

def slab_response(
    material: Material,
    thickness_m: typing.SupportsFloat | typing.SupportsIndex,
    cos_incidence: typing.SupportsFloat | typing.SupportsIndex,
    frequency_hz: typing.SupportsFloat | typing.SupportsIndex,
    parallel: bool = False,
) -> tuple[complex, complex, float]:
    """
    Reflection, transmission and delay of a slab.
    """

def step_sweep(
    channel: typing.Annotated[numpy.typing.ArrayLike, numpy.complex128],
    *,
    averages: typing.SupportsInt | typing.SupportsIndex,
    snr_db: typing.SupportsFloat | typing.SupportsIndex,
    reference_gain: typing.SupportsFloat | typing.SupportsIndex,
    adc_bits: typing.SupportsInt | typing.SupportsIndex,
    headroom: typing.SupportsFloat | typing.SupportsIndex,
    reference_channel: bool,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.complex128]:
    """
    Gains that a stepped tone measures.
    """

def thermal_noise_dbm(
    bandwidth_hz: typing.SupportsFloat | typing.SupportsIndex,
    noise_figure_db: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> float:
    """
    Thermal noise of a receiver.
    """

def with_opening(
    wall: tuple[
        typing.SupportsFloat | typing.SupportsIndex,
        typing.SupportsFloat | typing.SupportsIndex,
        typing.SupportsFloat | typing.SupportsIndex,
        typing.SupportsFloat | typing.SupportsIndex,
        Material,
        typing.SupportsFloat | typing.SupportsIndex,
    ],
    start_m: typing.SupportsFloat | typing.SupportsIndex,
    stop_m: typing.SupportsFloat | typing.SupportsIndex,
    material: Material,
    thickness_m: typing.SupportsFloat | typing.SupportsIndex,
) -> list[tuple[float, float, float, float, Material, float]]:
    """
    A wall with a piece of another material.
    """
