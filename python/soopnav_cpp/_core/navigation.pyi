"""
Positions from observations.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import soopnav_cpp._core.estimation
import soopnav_cpp._core.geometry
import typing

__all__: list[str] = [
    "BearingUse",
    "BurstStatus",
    "ClockMotion",
    "CooperativeGroup",
    "CooperativeTracker",
    "DopplerStatus",
    "DopplerUse",
    "FixStatus",
    "GroupStatus",
    "HandsetClock",
    "HandsetEstimate",
    "HandsetFilter",
    "HandsetLocator",
    "HandsetReport",
    "HandsetStatus",
    "HandsetUse",
    "NodeMapStatus",
    "NodeUse",
    "ObservableUse",
    "OfdmInertialNavigator",
    "PairStart",
    "PairStartStatus",
    "PairUse",
    "PhaseStitcher",
    "PositionFix",
    "SopCatalog",
    "SourceFix",
    "SourceLine",
    "SourceLocator",
    "SourceMethod",
    "SourceMotion",
    "SourceStatus",
    "SourceTrack",
    "SourceTracks",
    "StrapdownNavigator",
    "StrapdownRun",
    "TrackState",
    "doppler_fix",
    "inertial_tracker",
    "likelihood_surface",
    "locate_nodes",
    "manoeuvring_tracker",
    "pair_geometry",
    "pair_noise_shares",
    "position_fix",
    "sop_disagreement",
    "sop_fuse_clocks",
    "sop_fuse_constants",
    "sop_intersect",
    "sop_least_variances",
    "sop_move_clock",
    "sop_write_snapshot",
    "source_crlb",
    "start_node",
    "start_pair",
    "strapdown_local",
    "strapdown_retract",
    "tracker_add_imu",
    "tracker_inertial",
    "tracker_inertial_smooth",
    "tracker_modes",
]

class FixStatus(enum.Enum):
    """
    How a fix ended.
    """

    AMBIGUOUS = ...
    CONVERGED = ...
    INCONSISTENT = ...
    NOT_CONVERGED = ...
    RANK_DEFICIENT = ...
    TOO_FEW_NODES = ...

class NodeUse(enum.Enum):
    """
    What a fix did with a node.
    """

    BAD_SIGMA = ...
    NOT_FINITE = ...
    REJECTED = ...
    USED = ...

class PositionFix:
    """
    A position, what it is worth, and what became of each node. Read-only; NaN where there is no value.
    """
    def __repr__(self) -> str: ...
    @property
    def alternative_clock_biases_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Their clock biases; shape (k,).
        """
    @property
    def alternatives_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Other positions that fit as well; shape (k, 3).
        """
    @property
    def chi_square(self) -> float:
        """
        Sum of squared residuals in standard deviations.
        """
    @property
    def chi_square_limit(self) -> float:
        """
        What chi_square exceeds with the false-alarm probability.
        """
    @property
    def clock_bias_s(self) -> float:
        """
        Receiver clock minus common time, modulo the period, within half of it.
        """
    @property
    def clock_sigma_s(self) -> float:
        """
        Standard deviation of clock_bias_s.
        """
    @property
    def covariance_m2(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of position_m; zero for a stated height; shape (3, 3).
        """
    @property
    def degrees_of_freedom(self) -> int:
        """
        Of chi_square.
        """
    @property
    def dimensions(self) -> int:
        """
        3, or 2 at a stated height.
        """
    @property
    def dop(self) -> soopnav_cpp._core.estimation.Dop:
        """
        Dilution of precision of the nodes used.
        """
    @property
    def fell_back(self) -> bool:
        """
        The stated height was used because three dimensions were not determined.
        """
    @property
    def gates_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        What each residual may reach; NaN where no other node controls it.
        """
    @property
    def message(self) -> str:
        """
        One sentence: what the fix is, or why there is none.
        """
    @property
    def nodes_in_line(self) -> bool:
        """
        Nodes lie in one line (2-D) or plane (3-D): the fix has a mirror image.
        """
    @property
    def position_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        East, north, up in the nodes' frame; shape (3,).
        """
    @property
    def residuals_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Measured minus predicted, of the fit for a node used, of the others' prediction for one rejected.
        """
    @property
    def status(self) -> FixStatus:
        """
        How the fix ended.
        """
    @property
    def unobservable(self) -> list[str]:
        """
        Directions that the nodes do not determine, in words; empty when all are.
        """
    @property
    def use(self) -> list[NodeUse]:
        """
        What was done with each node.
        """
    @property
    def used(self) -> numpy.typing.NDArray[numpy.bool]:
        """
        Whether each node took part; shape (nodes,).
        """

class DopplerStatus(enum.Enum):
    """
    How a fix from Dopplers ended.
    """

    AMBIGUOUS = ...
    CONVERGED = ...
    NOT_CONVERGED = ...
    RANK_DEFICIENT = ...
    TOO_FEW_ROWS = ...
    TOO_FEW_SATELLITES = ...
    TOO_MANY_SATELLITES = ...

class DopplerUse(enum.IntEnum):
    """
    What a fix did with a Doppler.
    """

    BAD_SIGMA = ...
    NOT_FINITE = ...
    STALE = ...
    USED = ...
    def __format__(self, format_spec): ...

class HandsetFilter(enum.Enum):
    """
    The two filters of nielsen 4.2.3.
    """

    CONTROL = ...
    MEASUREMENT = ...

class HandsetClock(enum.Enum):
    """
    Whose clock the ranges carry.
    """

    COMMON = ...
    SEPARATE = ...

class HandsetUse(enum.Enum):
    """
    What became of an observation.
    """

    CLOCKS_DISAGREE = ...
    COASTED = ...
    NOTHING_HEARD = ...
    NOT_FINITE = ...
    OUTLIERS = ...
    OUT_OF_ORDER = ...
    RECOVERED = ...
    TOO_FAST = ...
    USED = ...
    WALLS = ...

class HandsetStatus(enum.Enum):
    """
    What an estimate rests on.
    """

    CAMERA_ONLY = ...
    COASTING = ...
    DEAD_TIME = ...
    STARTING = ...
    TRACKING = ...

class HandsetReport:
    """
    What came of an observation. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def ess(self) -> float:
        """
        Effective number of particles.
        """
    @property
    def heard(self) -> int:
        """
        Links.
        """
    @property
    def log_evidence(self) -> float:
        """
        Of this observation given those before.
        """
    @property
    def outliers(self) -> float:
        """
        Share of particles and links that took it for an outlier.
        """
    @property
    def use(self) -> HandsetUse:
        """
        What became of it.
        """

class HandsetEstimate:
    """
    Where a handset is. Read-only; NaN where there is no value.
    """
    def __repr__(self) -> str: ...
    @property
    def clock_m(self) -> float:
        """
        Common clock, or the first node's.
        """
    @property
    def clock_sigma_m(self) -> float:
        """
        Of clock_m.
        """
    @property
    def covariance_m2(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the whole mixture; shape (2, 2).
        """
    @property
    def ess(self) -> float:
        """
        Effective number of particles.
        """
    @property
    def excess_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Excess delay where it has; shape (links,).
        """
    @property
    def heading_rad(self) -> float:
        """
        Circular mean.
        """
    @property
    def heading_sigma_rad(self) -> float:
        """
        Circular standard deviation.
        """
    @property
    def mode_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Mean of the heaviest group of particles; shape (2,).
        """
    @property
    def mode_share(self) -> float:
        """
        Weight of that group.
        """
    @property
    def multimodal(self) -> bool:
        """
        Whether that is less than 0.9.
        """
    @property
    def node_sigma_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of each coordinate of them; shape (links,).
        """
    @property
    def nodes_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Places of the nodes, estimated or given; shape (links, 2).
        """
    @property
    def offset_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Nodes' own times; shape (links,).
        """
    @property
    def p_los(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Probability that a link has no excess delay; shape (links,).
        """
    @property
    def position_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Mean; shape (2,).
        """
    @property
    def status(self) -> HandsetStatus:
        """
        What it rests on.
        """
    @property
    def t_s(self) -> float:
        """
        Time of the last observation.
        """
    @property
    def velocity_mps(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (2,).
        """

class HandsetLocator:
    """
    Ranges, bearings and camera steps in, a position out.
    """
    def __init__(
        self,
        nodes_m: numpy.typing.ArrayLike,
        filter: HandsetFilter,
        clock: HandsetClock,
        height_m: typing.SupportsFloat | typing.SupportsIndex,
        start_m: numpy.typing.ArrayLike,
        node_sigma_m: numpy.typing.ArrayLike,
        room_m: numpy.typing.ArrayLike,
        walls_m: numpy.typing.ArrayLike,
        alone: bool,
        **kwargs,
    ) -> None: ...
    def coast(self, t_s: typing.SupportsFloat | typing.SupportsIndex) -> HandsetReport:
        """
        No step known up to here.
        """
    def estimate(self) -> HandsetEstimate:
        """
        Where the handset is.
        """
    def move(
        self,
        t_s: typing.SupportsFloat | typing.SupportsIndex,
        increment: numpy.typing.ArrayLike,
        track_covariance: numpy.typing.ArrayLike,
        foot_covariance_previous: numpy.typing.ArrayLike,
        foot_covariance: numpy.typing.ArrayLike,
    ) -> HandsetReport:
        """
        One step of the camera.
        """
    def particles(self, draw: bool) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows x, y, heading, weight.
        """
    def reset(self, seed: typing.SupportsInt | typing.SupportsIndex) -> None:
        """
        As new.
        """
    def run(
        self,
        frame_s: numpy.typing.ArrayLike,
        increments: numpy.typing.ArrayLike,
        track_covariance: numpy.typing.ArrayLike,
        foot_covariance: numpy.typing.ArrayLike,
        epoch_s: numpy.typing.ArrayLike,
        ranges_m: numpy.typing.ArrayLike,
        sigma_m: numpy.typing.ArrayLike,
    ) -> tuple:
        """
        A whole run.
        """
    def update_bearings(
        self,
        bearings_rad: numpy.typing.ArrayLike,
        sigma_rad: numpy.typing.ArrayLike,
        t_s: typing.SupportsFloat | typing.SupportsIndex,
        of_body: bool,
        mirror_rad: numpy.typing.ArrayLike,
    ) -> HandsetReport:
        """
        Bearings to the nodes.
        """
    def update_ranges(
        self,
        ranges_m: numpy.typing.ArrayLike,
        sigma_m: numpy.typing.ArrayLike,
        t_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> HandsetReport:
        """
        Ranges to all nodes.
        """
    @property
    def dimension(self) -> int:
        """
        Numbers of each particle's Gaussian.
        """

class ClockMotion(enum.Enum):
    """
    How the receiver's clock goes from epoch to epoch.
    """

    FREE = ...
    RANDOM_WALK = ...

class NodeMapStatus(enum.Enum):
    """
    How a map of nodes came out.
    """

    NOT_CONVERGED = ...
    OK = ...
    POOR_FIT = ...
    TOO_FEW = ...
    UNDETERMINED = ...

class SourceMethod(enum.Enum):
    """
    How bearings become a position.
    """

    CENTROID = ...
    EKF = ...
    EKF_BANK = ...
    INCENTER = ...
    LEAST_SQUARES = ...
    LINEAR = ...
    ML = ...
    PARTICLE = ...
    STANSFIELD = ...

class SourceMotion(enum.Enum):
    """
    What a source does between bearings.
    """

    CONSTANT_VELOCITY = ...
    STATIC = ...

class SourceStatus(enum.Enum):
    """
    How a fix ended.
    """

    CONVERGED = ...
    DIVERGED = ...
    INCONSISTENT = ...
    NOT_CONVERGED = ...
    ON_PLATFORM = ...
    TOO_FEW_BEARINGS = ...
    UNOBSERVABLE = ...

class BearingUse(enum.Enum):
    """
    What became of a bearing.
    """

    BAD_SIGMA = ...
    NOT_FINITE = ...
    OUT_OF_ORDER = ...
    UNDEFINED = ...
    USED = ...
    WAITING = ...

class SourceLine:
    """
    A line on which a source lies. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def direction(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Unit vector towards the source; shape (3,).
        """
    @property
    def point_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        A place of the platform; shape (3,).
        """
    @property
    def sigma_rad(self) -> float:
        """
        Of the direction's azimuth.
        """

class SourceFix:
    """
    A source's position and what it is worth. Read-only; NaN where there is none.
    """
    def __repr__(self) -> str: ...
    @property
    def cep_m(self) -> float:
        """
        Radius that holds the horizontal error with probability one half.
        """
    @property
    def chi_square(self) -> float:
        """
        Of the residuals of bearings that are no outliers.
        """
    @property
    def covariance_m2(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of position_m; shape (d, d).
        """
    @property
    def degrees_of_freedom(self) -> int:
        """
        Of chi_square.
        """
    @property
    def dimensions(self) -> int:
        """
        2 or 3.
        """
    @property
    def heading_bias_rad(self) -> float:
        """
        Constant error of all azimuths, if estimated.
        """
    @property
    def heading_bias_sigma_rad(self) -> float:
        """
        Its standard deviation.
        """
    @property
    def last(self) -> BearingUse:
        """
        What became of the last bearing.
        """
    @property
    def line(self) -> SourceLine | None:
        """
        The line on which the source lies when its range is not determined, else None.
        """
    @property
    def message(self) -> str:
        """
        One sentence.
        """
    @property
    def outliers(self) -> int:
        """
        Of those used: more likely from anywhere than from the source.
        """
    @property
    def position_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        At the last bearing; shape (d,).
        """
    @property
    def rejected(self) -> int:
        """
        Number of bearings left out.
        """
    @property
    def status(self) -> SourceStatus:
        """
        How the fix ended.
        """
    @property
    def unobservable(self) -> list[str]:
        """
        What the bearings do not determine, in words; else empty.
        """
    @property
    def used(self) -> int:
        """
        Number of bearings used.
        """
    @property
    def velocity_covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of velocity_mps; shape (d, d).
        """
    @property
    def velocity_mps(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of a moving source; shape (d,).
        """

class SourceLocator:
    """
    Bearings in, a position out.
    """
    def __init__(
        self,
        method: SourceMethod,
        dimensions: typing.SupportsInt | typing.SupportsIndex,
        motion: SourceMotion,
        start_m: numpy.typing.ArrayLike | None,
        **kwargs,
    ) -> None: ...
    def members(self) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
        """
        Positions and weights of the bank's members.
        """
    def particles(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Places of the particles; shape (particles, d).
        """
    def reset(self, start_m: numpy.typing.ArrayLike | None, seed: typing.SupportsInt | typing.SupportsIndex) -> None:
        """
        As new.
        """
    def run(
        self,
        times_s: numpy.typing.ArrayLike,
        positions: numpy.typing.ArrayLike,
        bearings: numpy.typing.ArrayLike,
        sigmas: numpy.typing.ArrayLike,
        position_covariance: numpy.typing.ArrayLike,
        heading_sigma_rad: numpy.typing.ArrayLike,
    ) -> tuple:
        """
        A fix after every bearing.
        """
    def run_many(
        self,
        times_s: numpy.typing.ArrayLike,
        positions: numpy.typing.ArrayLike,
        bearings: numpy.typing.ArrayLike,
        sigmas: numpy.typing.ArrayLike,
        position_covariance: numpy.typing.ArrayLike,
        heading_sigma_rad: numpy.typing.ArrayLike,
        starts_m: numpy.typing.ArrayLike,
        seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        epochs: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    ) -> tuple:
        """
        Fixes at some epochs of many runs.
        """
    def step(
        self,
        times_s: numpy.typing.ArrayLike,
        positions: numpy.typing.ArrayLike,
        bearings: numpy.typing.ArrayLike,
        sigmas: numpy.typing.ArrayLike,
        position_covariance: numpy.typing.ArrayLike,
        heading_sigma_rad: numpy.typing.ArrayLike,
        solve: bool,
    ) -> SourceFix | None:
        """
        Takes bearings, then solves.
        """
    def weights(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Weights of the particles; shape (particles,).
        """

class TrackState(enum.Enum):
    """
    How far a track has come.
    """

    CONFIRMED = ...
    TENTATIVE = ...

class SourceTrack:
    """
    One source as it stands. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def bearing(self) -> int:
        """
        Index of this epoch's bearing; -1: none.
        """
    @property
    def fix(self) -> SourceFix:
        """
        Where it is.
        """
    @property
    def hits(self) -> int:
        """
        Bearings taken.
        """
    @property
    def id(self) -> int:
        """
        Never used twice.
        """
    @property
    def misses(self) -> int:
        """
        Epochs in a row without one.
        """
    @property
    def state(self) -> TrackState:
        """
        How far it has come.
        """

class SourceTracks:
    """
    Several sources at once.
    """
    def __init__(
        self,
        dimensions: typing.SupportsInt | typing.SupportsIndex,
        motion: SourceMotion,
        gate_probability: typing.SupportsFloat | typing.SupportsIndex,
        clutter_density_per_rad: typing.SupportsFloat | typing.SupportsIndex,
        confirm_hits: typing.SupportsInt | typing.SupportsIndex,
        confirm_epochs: typing.SupportsInt | typing.SupportsIndex,
        drop_misses: typing.SupportsInt | typing.SupportsIndex,
        **kwargs,
    ) -> None: ...
    def step(
        self,
        times_s: numpy.typing.ArrayLike,
        positions: numpy.typing.ArrayLike,
        bearings: numpy.typing.ArrayLike,
        sigmas: numpy.typing.ArrayLike,
        position_covariance: numpy.typing.ArrayLike,
        heading_sigma_rad: numpy.typing.ArrayLike,
    ) -> list[SourceTrack]:
        """
        One epoch.
        """

class OfdmInertialNavigator:
    """
    Planar inertial navigation aided by OFDM block boundaries; the engine of soopnav_cpp.navigation.OfdmInertialNavigator.
    """
    def __copy__(self) -> OfdmInertialNavigator: ...
    def __init__(
        self,
        transmitters_m: numpy.typing.ArrayLike,
        starts: numpy.typing.ArrayLike,
        *,
        gyro_sigma_radps: typing.SupportsFloat | typing.SupportsIndex,
        accelerometer_sigma_mps2: typing.SupportsFloat | typing.SupportsIndex,
        ambiguity_m: typing.SupportsFloat | typing.SupportsIndex,
        gate_m: typing.SupportsFloat | typing.SupportsIndex,
        gate_sigmas: typing.SupportsFloat | typing.SupportsIndex,
        gate_probability: typing.SupportsFloat | typing.SupportsIndex | None,
        clock_psd: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex]
        | None,
        clock_drift_sigma_mps: typing.SupportsFloat | typing.SupportsIndex,
        multipath: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex]
        | None,
        reference_receiver: bool,
        literal_transition: bool,
        unmodelled: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
        yaw_rate_range_radps: typing.SupportsFloat | typing.SupportsIndex,
        specific_force_range_mps2: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def clock_at(self, transmitter: typing.SupportsInt | typing.SupportsIndex) -> int:
        """
        State of its clock bias, or -1.
        """
    def coast(
        self, receiver: typing.SupportsInt | typing.SupportsIndex, dt_s: typing.SupportsFloat | typing.SupportsIndex
    ) -> int:
        """
        Carries a receiver without a sample.
        """
    def multipath_at(
        self,
        receiver: typing.SupportsInt | typing.SupportsIndex,
        transmitter: typing.SupportsInt | typing.SupportsIndex,
    ) -> int:
        """
        State of the link's bias, or -1.
        """
    def predict(
        self,
        receiver: typing.SupportsInt | typing.SupportsIndex,
        yaw_rate_radps: typing.SupportsFloat | typing.SupportsIndex,
        forward_mps2: typing.SupportsFloat | typing.SupportsIndex,
        left_mps2: typing.SupportsFloat | typing.SupportsIndex,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
    ) -> int:
        """
        Carries a receiver through one sample; an UpdateStatus' number.
        """
    def predict_links(self, dt_s: typing.SupportsFloat | typing.SupportsIndex) -> int:
        """
        Carries clocks and multipath biases.
        """
    def receiver_at(self, receiver: typing.SupportsInt | typing.SupportsIndex) -> int:
        """
        First state of a receiver, or -1.
        """
    def run(
        self,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        imu_t_s: numpy.typing.ArrayLike,
        yaw_rate_radps: numpy.typing.ArrayLike,
        specific_force_b_mps2: numpy.typing.ArrayLike,
        imu_period_s: typing.SupportsFloat | typing.SupportsIndex,
        epoch_t_s: numpy.typing.ArrayLike,
        range_change_m: numpy.typing.ArrayLike,
        range_sigma_m: numpy.typing.ArrayLike,
        reference_range_change_m: numpy.typing.ArrayLike,
        reference_sigma_m: numpy.typing.ArrayLike,
        record_every: typing.SupportsInt | typing.SupportsIndex,
        max_gap_s: typing.SupportsFloat | typing.SupportsIndex,
        timing: typing.Any,
    ) -> dict:
        """
        A whole run, on a copy.
        """
    def update(
        self,
        receiver: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        transmitter: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        range_change_m: numpy.typing.ArrayLike,
        range_sigma_m: numpy.typing.ArrayLike,
    ) -> dict:
        """
        Takes the boundaries of one epoch.
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the states; shape (n, n).
        """
    @property
    def dim(self) -> int:
        """
        Number of states.
        """
    @property
    def names(self) -> list[str]:
        """
        What each state is.
        """
    @property
    def state(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        The states; shape (n,).
        """

class StrapdownRun:
    """
    What came of a run of a StrapdownNavigator. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def accelerometer_bias_mps2(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (r, 3).
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64] | None:
        """
        Shape (r, 15, 15), or None where it was not asked for.
        """
    @property
    def gyro_bias_radps(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (r, 3).
        """
    @property
    def imu_status(self) -> numpy.typing.NDArray[numpy.uint8]:
        """
        ImuStatus of each sample, as numbers; shape (n,).
        """
    @property
    def innovation_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Measured minus predicted; NaN where there was none; shape (e, transmitters).
        """
    @property
    def innovation_sigma_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Its standard deviation; shape (e, transmitters).
        """
    @property
    def nis(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (e, transmitters).
        """
    @property
    def position_m(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        North, east, down of the origin; shape (r, 3).
        """
    @property
    def quaternion(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        w, x, y, z, body to north-east-down; shape (r, 4).
        """
    @property
    def sigma(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Standard deviations of the 15 error states; shape (r, 15).
        """
    @property
    def t_s(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Times of the records; shape (r,).
        """
    @property
    def update_status(self) -> numpy.typing.NDArray[numpy.uint8]:
        """
        UpdateStatus as numbers; shape (e, transmitters).
        """
    @property
    def velocity_mps(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (r, 3).
        """
    @property
    def zero_velocity_updates(self) -> int:
        """
        Zero-velocity updates taken in.
        """

class StrapdownNavigator:
    """
    Inertial navigation aided by range changes.
    """
    def __init__(
        self,
        transmitters_m: numpy.typing.ArrayLike,
        *,
        origin: numpy.typing.ArrayLike,
        reference_m: numpy.typing.ArrayLike,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        quaternion: numpy.typing.ArrayLike,
        velocity_mps: numpy.typing.ArrayLike,
        position_m: numpy.typing.ArrayLike,
        gyro_bias_radps: numpy.typing.ArrayLike,
        accelerometer_bias_mps2: numpy.typing.ArrayLike,
        covariance: numpy.typing.ArrayLike,
        noise: numpy.typing.ArrayLike,
        period_s: typing.SupportsFloat | typing.SupportsIndex,
        gap_periods: typing.SupportsFloat | typing.SupportsIndex,
        gyro_range_radps: typing.SupportsFloat | typing.SupportsIndex,
        accelerometer_range_mps2: typing.SupportsFloat | typing.SupportsIndex,
        gap_rate_sigma_radps: typing.SupportsFloat | typing.SupportsIndex,
        gap_acceleration_sigma_mps2: typing.SupportsFloat | typing.SupportsIndex,
        coning_samples: typing.SupportsInt | typing.SupportsIndex,
        range_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        ambiguity_m: typing.SupportsFloat | typing.SupportsIndex,
        gate_sigmas: typing.SupportsFloat | typing.SupportsIndex,
        gate_floor_m: typing.SupportsFloat | typing.SupportsIndex,
        zero_velocity: numpy.typing.ArrayLike | None,
        zero_velocity_sigma_mps: typing.SupportsFloat | typing.SupportsIndex,
        hold_heading: bool,
        zero_rate_sigma_radps: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def run(
        self,
        t_s: numpy.typing.ArrayLike,
        delta_theta_b: numpy.typing.ArrayLike,
        delta_velocity_b: numpy.typing.ArrayLike,
        *,
        epochs_s: numpy.typing.ArrayLike,
        range_changes_m: numpy.typing.ArrayLike,
        record_every: typing.SupportsInt | typing.SupportsIndex,
        covariance: bool,
    ) -> StrapdownRun:
        """
        A whole run; the navigator stays as it is.
        """

class PairUse(enum.Enum):
    """
    What became of a burst.
    """

    ACCEPTED = ...
    BAD_COVARIANCE = ...
    BAD_STATE = ...
    BELOW_HORIZON = ...
    CLOCK_JUMP = ...
    FREQUENCY_JUMP = ...
    GATED = ...
    NOT_ADVANCING = ...
    NOT_FINITE = ...
    NOT_STARTED = ...
    OUTSIDE_EPHEMERIS = ...
    UNKNOWN_BEACON = ...

class PairStartStatus(enum.Enum):
    """
    How a start from a batch of bursts ended.
    """

    AMBIGUOUS = ...
    FOUND = ...
    NOT_CONVERGED = ...
    NO_VIEW = ...
    POOR_FIT = ...
    TOO_FEW = ...
    VAGUE = ...

class PairStart:
    """
    What a start from a batch of bursts found. Read-only; NaN where nothing.
    """
    def __repr__(self) -> str: ...
    @property
    def alternatives(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Means of other places that fit as well, best first; shape (k, 8).
        """
    @property
    def cells(self) -> int:
        """
        Of the grid that see the beacons.
        """
    @property
    def chi_square(self) -> float:
        """
        Of the residuals.
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shape (8, 8).
        """
    @property
    def degrees_of_freedom(self) -> int:
        """
        Of it.
        """
    @property
    def iterations(self) -> int:
        """
        Linearisations of the best.
        """
    @property
    def mean(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        p, v (ECEF), theta, alpha [m, m/s]; shape (8,).
        """
    @property
    def ok(self) -> bool:
        """
        Found, and no other place fits.
        """
    @property
    def status(self) -> PairStartStatus:
        """
        How it ended.
        """
    @property
    def t_s(self) -> float:
        """
        Time of the last burst, which the solution is of.
        """
    @property
    def used(self) -> typing.Any:
        """
        Which measurements are in the solution; shape (n,).
        """

class CooperativeTracker:
    """
    A target's place and clock from bursts an anchor heard too.
    """
    def __init__(self, beacons: list, epoch_s: numpy.typing.ArrayLike, options: dict) -> None: ...
    def along_track(self, beacon: typing.SupportsInt | typing.SupportsIndex) -> typing.Any:
        """
        Along-track error of a beacon and its deviation [m]; None when not estimated.
        """
    def coast(self, t_s: typing.SupportsFloat | typing.SupportsIndex) -> bool:
        """
        To a time without a burst.
        """
    def estimate(self) -> tuple[float, numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64], float]:
        """
        Time, mean, covariance, seconds since a burst was accepted.
        """
    def run(self, bursts: numpy.typing.ArrayLike) -> tuple:
        """
        Each burst in turn.
        """
    def smooth(
        self,
    ) -> tuple[
        str,
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
    ]:
        """
        Fixed-interval smoothing.
        """
    def start(self, bursts: numpy.typing.ArrayLike, search: dict) -> PairStart:
        """
        From bursts alone.
        """
    def start_at(
        self,
        t_s: typing.SupportsFloat | typing.SupportsIndex,
        mean: numpy.typing.ArrayLike,
        covariance: numpy.typing.ArrayLike,
    ) -> None:
        """
        From a known mean and covariance.
        """
    @property
    def counts(self) -> list[int]:
        """
        How often each PairUse occurred.
        """
    @property
    def started(self) -> bool:
        """
        Whether there is an estimate.
        """

class GroupStatus(enum.Enum):
    """
    What became of a row of a burst.
    """

    ACCEPTED = ...
    BELOW_HORIZON = ...
    CLOCK_JUMP = ...
    GATED = ...
    NON_FINITE = ...
    OUTSIDE_ORBIT = ...
    REFUSED = ...
    TIME_NOT_ADVANCING = ...
    UNKNOWN_BEACON = ...
    UNKNOWN_TARGET = ...

class CooperativeGroup:
    """
    Several targets and one anchor.
    """
    def __init__(
        self,
        beacons: list,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        *,
        anchor_clock: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
        target_clock: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
        horizontal_psd_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
        vertical_psd_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
        gate_probability: typing.SupportsFloat | typing.SupportsIndex,
        max_targets: typing.SupportsInt | typing.SupportsIndex,
        shared_anchor_noise: bool,
        shared_anchor_clock: bool,
    ) -> None: ...
    def join(self, mean: numpy.typing.ArrayLike, covariance: numpy.typing.ArrayLike) -> int:
        """
        The target's name, or -1.
        """
    def leave(self, target: typing.SupportsInt | typing.SupportsIndex) -> bool:
        """
        False when it is not here.
        """
    def run(
        self,
        bursts: numpy.typing.ArrayLike,
        rows: numpy.typing.ArrayLike,
        pairs: collections.abc.Sequence[
            tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex]
        ],
        covariance: bool,
    ) -> tuple:
        """
        Each burst in turn: means, covariances, statuses.
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of all of them together.
        """
    @property
    def mean(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Eight numbers for each target.
        """
    @property
    def targets(self) -> list[int]:
        """
        Names, in the order of joining.
        """
    @property
    def time_s(self) -> float:
        """
        Of the state.
        """

class ObservableUse(enum.IntEnum):
    """
    What became of an observable.
    """

    ACCEPTED = ...
    GATED = ...
    MISSING = ...
    NON_FINITE = ...
    NOT_POSITIVE_DEFINITE = ...
    SLIP = ...
    SUSPENDED = ...
    TOO_MANY = ...
    UNDEFINED = ...
    UNKNOWN_SOURCE = ...
    def __format__(self, format_spec): ...

class _OpportunisticSmoother:
    """
    Arrays of a smoothed run.
    """
    def covariance(
        self, components: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> numpy.typing.NDArray[numpy.float64]: ...
    def lag_covariance(
        self, component: typing.SupportsInt | typing.SupportsIndex, max_lag: typing.SupportsInt | typing.SupportsIndex
    ) -> numpy.typing.NDArray[numpy.float64]: ...
    def mean(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def sigma(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def t_s(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def sources(self) -> list[int]: ...

class _OpportunisticNavigator:
    """
    The engine of `OpportunisticNavigator`.
    """
    def __init__(
        self,
        *,
        position: numpy.typing.ArrayLike,
        position_covariance: numpy.typing.ArrayLike,
        velocity: numpy.typing.ArrayLike,
        velocity_covariance: numpy.typing.ArrayLike,
        clock_bias_m: typing.SupportsFloat | typing.SupportsIndex,
        clock_drift_mps: typing.SupportsFloat | typing.SupportsIndex,
        clock_covariance: numpy.typing.ArrayLike,
        clock: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
        motion: typing.SupportsInt | typing.SupportsIndex,
        form: typing.SupportsInt | typing.SupportsIndex,
        time_tag: typing.SupportsInt | typing.SupportsIndex,
        position_walk_m2ps: typing.SupportsFloat | typing.SupportsIndex,
        acceleration_psd_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
        max_sources: typing.SupportsInt | typing.SupportsIndex,
        max_observables: typing.SupportsInt | typing.SupportsIndex,
        fault_probability: typing.SupportsFloat | typing.SupportsIndex,
        suspend_share: typing.SupportsFloat | typing.SupportsIndex,
        suspend_memory: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def add_source(
        self,
        *,
        name: str,
        carrier_hz: typing.SupportsFloat | typing.SupportsIndex,
        orbit: soopnav_cpp._core.geometry.SampledOrbit | None,
        position: typing.Any,
        position_covariance: typing.Any,
        clock: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex] | None,
        clock_bias_m: typing.SupportsFloat | typing.SupportsIndex,
        clock_drift_mps: typing.SupportsFloat | typing.SupportsIndex,
        clock_epoch_s: typing.SupportsFloat | typing.SupportsIndex,
        clock_covariance: numpy.typing.ArrayLike,
        ambiguity_estimated: bool,
        ambiguity_cycles: typing.SupportsFloat | typing.SupportsIndex,
        ambiguity_sigma_cycles: typing.SupportsFloat | typing.SupportsIndex,
        ambiguity_walk_cycles2ps: typing.SupportsFloat | typing.SupportsIndex,
        position_walk_m2ps: typing.SupportsFloat | typing.SupportsIndex,
    ) -> int: ...
    def clock_covariance(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def component_names(self) -> list[str]: ...
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def expected(
        self, t_s: typing.SupportsFloat | typing.SupportsIndex, observation: numpy.typing.ArrayLike
    ) -> typing.Any: ...
    def find_source(self, name: str) -> int: ...
    def mean(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def open_ambiguity(
        self,
        source: typing.SupportsInt | typing.SupportsIndex,
        sigma_cycles: typing.SupportsFloat | typing.SupportsIndex,
    ) -> bool: ...
    def open_clock(
        self,
        source: typing.SupportsInt | typing.SupportsIndex,
        bias_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
        drift_sigma_mps: typing.SupportsFloat | typing.SupportsIndex,
    ) -> bool: ...
    def position(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def position_covariance(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def readmit(self, source: typing.SupportsInt | typing.SupportsIndex) -> bool: ...
    def remove_source(self, source: typing.SupportsInt | typing.SupportsIndex) -> bool: ...
    def run(
        self,
        *,
        t_s: numpy.typing.ArrayLike,
        sources: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        phase: numpy.typing.ArrayLike,
        phase_sigma: numpy.typing.ArrayLike,
        pseudorange: numpy.typing.ArrayLike,
        pseudorange_sigma: numpy.typing.ArrayLike,
        phase_correction: numpy.typing.ArrayLike,
        range_correction: numpy.typing.ArrayLike,
        source_position: numpy.typing.ArrayLike,
        source_clock: numpy.typing.ArrayLike,
        record: bool,
        covariance: bool,
    ) -> dict: ...
    def set_clock_noise(
        self,
        source: typing.SupportsInt | typing.SupportsIndex,
        white_frequency_m2ps: typing.SupportsFloat | typing.SupportsIndex,
        frequency_walk_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
    ) -> bool: ...
    def smooth(self, gains: bool) -> _OpportunisticSmoother: ...
    def source(self, source: typing.SupportsInt | typing.SupportsIndex) -> typing.Any: ...
    def sources(self) -> list[int]: ...
    def start_recording(self, epochs: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def step(self, t_s: typing.SupportsFloat | typing.SupportsIndex, observations: numpy.typing.ArrayLike) -> dict: ...
    def unobservable(
        self, epochs: typing.SupportsInt | typing.SupportsIndex, tolerance: typing.SupportsFloat | typing.SupportsIndex
    ) -> list[str]: ...
    @property
    def clock_bias_m(self) -> float: ...
    @property
    def clock_drift_mps(self) -> float: ...
    @property
    def recorded(self) -> int: ...
    @property
    def t_s(self) -> float: ...

class BurstStatus(enum.IntEnum):
    """
    What became of a burst.
    """

    ACCEPTED = ...
    GAP_TOO_LONG = ...
    LOST = ...
    NOT_FINITE = ...
    NOT_LATER = ...
    OUTLIER = ...
    STARTED = ...
    def __format__(self, format_spec): ...

class PhaseStitcher:
    """
    One continuous phase of bursts with random fractions of a cycle.
    """
    def __init__(
        self,
        *,
        fractions: typing.SupportsInt | typing.SupportsIndex,
        wavelength_m: typing.SupportsFloat | typing.SupportsIndex,
        white_frequency_m2ps: typing.SupportsFloat | typing.SupportsIndex,
        frequency_walk_m2ps3: typing.SupportsFloat | typing.SupportsIndex,
        frequency_sigma_hz: typing.SupportsFloat | typing.SupportsIndex,
        rate_sigma_hzps: typing.SupportsFloat | typing.SupportsIndex,
        rate_walk_hz2ps3: typing.SupportsFloat | typing.SupportsIndex,
        decision_bursts: typing.SupportsInt | typing.SupportsIndex,
        posterior: typing.SupportsFloat | typing.SupportsIndex,
        hypotheses: typing.SupportsInt | typing.SupportsIndex,
        gate_sigma: typing.SupportsFloat | typing.SupportsIndex,
        outliers: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def finish(self, early: bool) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rows decided.
        """
    def push(self, bursts: numpy.typing.ArrayLike) -> tuple:
        """
        (statuses, rows decided).
        """
    @property
    def frequency_error_hz(self) -> float: ...
    @property
    def frequency_error_sigma_hz(self) -> float: ...
    @property
    def hypotheses(self) -> int: ...
    @property
    def posterior(self) -> float: ...
    @property
    def waiting(self) -> int: ...

class SopCatalog:
    """
    Sources of a snapshot.
    """
    def __init__(self, bytes: bytes) -> None: ...
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    def ids(self) -> list[str]: ...
    def near(
        self, p_e_m: numpy.typing.ArrayLike, radius_m: typing.SupportsFloat | typing.SupportsIndex
    ) -> list[str]: ...
    def prior(self, id: str, at_us: typing.SupportsInt | typing.SupportsIndex) -> dict: ...
    def source(self, id: str) -> dict: ...
    @property
    def created_us(self) -> int: ...

def doppler_fix(rows: numpy.typing.ArrayLike, **kwargs) -> dict:
    """
    Rows of t, satellite, Doppler, sigma, p (3), v (3), along-track sigma, age; see the face.
    """

def inertial_tracker(
    beacons: list,
    epoch_s: numpy.typing.ArrayLike,
    options: dict,
    *,
    noise: numpy.typing.ArrayLike,
    quaternion: numpy.typing.ArrayLike,
    start: numpy.typing.ArrayLike,
    limits: numpy.typing.ArrayLike,
    coning_samples: typing.SupportsInt | typing.SupportsIndex,
    waiting_samples: typing.SupportsInt | typing.SupportsIndex,
    smoother_steps: typing.SupportsInt | typing.SupportsIndex,
) -> CooperativeTracker:
    """
    A CooperativeTracker with an inertial unit.
    """

def likelihood_surface(
    times_s: numpy.typing.ArrayLike,
    positions: numpy.typing.ArrayLike,
    bearings: numpy.typing.ArrayLike,
    sigmas: numpy.typing.ArrayLike,
    position_covariance: numpy.typing.ArrayLike,
    heading_sigma_rad: numpy.typing.ArrayLike,
    x: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
    y: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex],
    columns: typing.SupportsInt | typing.SupportsIndex,
    rows: typing.SupportsInt | typing.SupportsIndex,
    outlier_probability: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Log-likelihood over a grid.
    """

def locate_nodes(
    t_s: numpy.typing.ArrayLike,
    track_m: numpy.typing.ArrayLike,
    ranges_m: numpy.typing.ArrayLike,
    sigma_m: numpy.typing.ArrayLike,
    heights_m: numpy.typing.ArrayLike,
    *,
    clock: ClockMotion,
    clock_m_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex,
    track_m_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex,
    heading_rad_per_sqrt_s: typing.SupportsFloat | typing.SupportsIndex,
    max_distance_m: typing.SupportsFloat | typing.SupportsIndex,
    starts: typing.SupportsInt | typing.SupportsIndex,
    max_iterations: typing.SupportsInt | typing.SupportsIndex,
    ambiguity_cost: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> tuple:
    """
    Nodes from ranges along a walk.
    """

def manoeuvring_tracker(
    beacons: list, epoch_s: numpy.typing.ArrayLike, options: dict, manoeuvres: numpy.typing.ArrayLike
) -> CooperativeTracker:
    """
    A CooperativeTracker over two modes of motion.
    """

def pair_geometry(
    beacon: soopnav_cpp._core.geometry.SampledOrbit,
    bursts: numpy.typing.ArrayLike,
    mean: numpy.typing.ArrayLike,
    along_track_m: numpy.typing.ArrayLike,
    anchor_drift_mps: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    TDOA [s] and FDOA [Hz] that the model expects.
    """

def pair_noise_shares(
    first_snr: typing.SupportsFloat | typing.SupportsIndex, second_snr: typing.SupportsFloat | typing.SupportsIndex
) -> tuple[float, float, float]:
    """
    Of the first recording, the second, and the product of both.
    """

def position_fix(
    nodes_enu_m: numpy.typing.ArrayLike,
    toas_s: numpy.typing.ArrayLike,
    sigmas_s: numpy.typing.ArrayLike,
    *,
    clock_offsets_s: numpy.typing.ArrayLike | None = None,
    node_sigmas_s: numpy.typing.ArrayLike | None = None,
    dimensions: typing.SupportsInt | typing.SupportsIndex | None = None,
    height_m: typing.SupportsFloat | typing.SupportsIndex | None = None,
    near_m: numpy.typing.ArrayLike | None = None,
    period_s: typing.SupportsFloat | typing.SupportsIndex = 0.01,
    reject_outliers: bool = True,
    false_alarm_probability: typing.SupportsFloat | typing.SupportsIndex = 0.001,
    max_iterations: typing.SupportsInt | typing.SupportsIndex = 50,
) -> PositionFix:
    """
    Position and receiver clock from times of arrival.
    """

def sop_disagreement(
    a: numpy.typing.ArrayLike,
    A: numpy.typing.ArrayLike,
    b: numpy.typing.ArrayLike,
    B: numpy.typing.ArrayLike,
    independent: bool = True,
) -> tuple[float, float]:
    """
    Squared Mahalanobis distance of two estimates, and the probability of as much or more.
    """

def sop_fuse_clocks(
    t_s: numpy.typing.ArrayLike,
    value: numpy.typing.ArrayLike,
    covariance: numpy.typing.ArrayLike,
    independent: collections.abc.Sequence[bool],
    *,
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    at_s: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Any:
    """
    Estimates of one clock, ordered by time, fused at `at_s`.
    """

def sop_fuse_constants(
    t_s: numpy.typing.ArrayLike,
    value: numpy.typing.ArrayLike,
    covariance: numpy.typing.ArrayLike,
    independent: collections.abc.Sequence[bool],
    *,
    variance_per_s: typing.SupportsFloat | typing.SupportsIndex,
    at_s: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Any:
    """
    Estimates of two or three constants, ordered by time, fused.
    """

def sop_intersect(
    a: numpy.typing.ArrayLike, A: numpy.typing.ArrayLike, b: numpy.typing.ArrayLike, B: numpy.typing.ArrayLike
) -> tuple:
    """
    Covariance intersection: value, covariance, weight of a.
    """

def sop_least_variances(
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    duration_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    Least variance of the drift and of ln h-2 that a record of this length allows.
    """

def sop_move_clock(
    value: numpy.typing.ArrayLike,
    covariance: numpy.typing.ArrayLike,
    *,
    h0: typing.SupportsFloat | typing.SupportsIndex,
    h_minus_2: typing.SupportsFloat | typing.SupportsIndex,
    dt_s: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple:
    """
    Offset [s] and drift of a clock dt_s later, and their covariance.
    """

def sop_write_snapshot(
    sources: collections.abc.Sequence[dict], created_us: typing.SupportsInt | typing.SupportsIndex
) -> bytes:
    """
    The bytes of a snapshot.
    """

def source_crlb(
    times_s: numpy.typing.ArrayLike,
    positions: numpy.typing.ArrayLike,
    sigmas: numpy.typing.ArrayLike,
    position_covariance: numpy.typing.ArrayLike,
    heading_sigma_rad: numpy.typing.ArrayLike,
    emitter: numpy.typing.ArrayLike,
    velocity: numpy.typing.ArrayLike,
    moving: bool,
    acceleration_psd: typing.SupportsFloat | typing.SupportsIndex,
    heading_bias_sigma_rad: typing.SupportsFloat | typing.SupportsIndex,
    start_sigma_m: typing.SupportsFloat | typing.SupportsIndex,
    start_speed_sigma_mps: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Cramér-Rao bound over time.
    """

def start_node(
    track_m: numpy.typing.ArrayLike,
    ranges_m: numpy.typing.ArrayLike,
    sigma_m: typing.SupportsFloat | typing.SupportsIndex,
    max_distance_m: typing.SupportsFloat | typing.SupportsIndex,
    height_m: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[bool, numpy.typing.NDArray[numpy.float64], float, float, float, float, numpy.typing.NDArray[numpy.float64]]:
    """
    Best start of one node from an exact walk.
    """

def start_pair(beacons: list, bursts: numpy.typing.ArrayLike, search: dict) -> PairStart:
    """
    A target's place and clock from bursts alone.
    """

def strapdown_local(
    estimates: numpy.typing.ArrayLike, truths: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Errors of 15 states, truth = estimate moved by the error; rows of 16 numbers each.
    """

def strapdown_retract(
    states: numpy.typing.ArrayLike, errors: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    States moved by errors of 15 states.
    """

def tracker_add_imu(
    tracker: CooperativeTracker,
    t_s: numpy.typing.ArrayLike,
    delta_theta_b: numpy.typing.ArrayLike,
    delta_velocity_b: numpy.typing.ArrayLike,
) -> numpy.typing.NDArray[numpy.uint8]:
    """
    Increments that end at the times; ImuStatus of each as numbers.
    """

def tracker_inertial(tracker: CooperativeTracker) -> tuple:
    """
    t_s, mean, quaternion, gyro and accelerometer biases, covariance; one row each.
    """

def tracker_inertial_smooth(tracker: CooperativeTracker) -> tuple:
    """
    The same of all steps, smoothed; no rows when there was no room for them.
    """

def tracker_modes(tracker: CooperativeTracker) -> tuple[float, float]:
    """
    Probabilities of being calm and of manoeuvring.
    """
