"""
What an estimate is worth: dilution of precision, ellipses.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import soopnav_cpp._core.measurement
import soopnav_cpp._core.process
import typing

__all__: list[str] = [
    "AdaptiveCount",
    "AdaptiveProcessNoise",
    "Dop",
    "ErrorEllipse",
    "FixedLagFilter",
    "InteractingMultipleModel",
    "KalmanFilter",
    "KalmanReport",
    "ParticleCloud",
    "ParticlePrior",
    "ParticleReport",
    "ParticleStatus",
    "RANK_TOLERANCE",
    "Resampling",
    "StepStatus",
    "UpdateStatus",
    "circular_error_m",
    "coverage",
    "coverage_bounds",
    "crlb",
    "crlb_series",
    "error_ellipse",
    "gaussian_prior",
    "joined_report",
    "linear_filter",
    "marginal_information",
    "mean_nees_bounds",
    "nees_series",
    "observability_matrix",
    "position_jacobian",
    "posterior_crlb",
    "rmse",
    "rts_smooth",
    "sample_circular_error_m",
    "sample_prior",
    "uniform_prior",
]

class Dop:
    """
    Dilution of precision, from geometry alone; NaN where one does not apply. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def gdop(self) -> float:
        """
        Position and clock bias.
        """
    @property
    def hdop(self) -> float:
        """
        Horizontal position.
        """
    @property
    def pdop(self) -> float:
        """
        Position.
        """
    @property
    def tdop(self) -> float:
        """
        Speed of light times clock bias.
        """
    @property
    def vdop(self) -> float:
        """
        Vertical position.
        """

class ErrorEllipse:
    """
    Curve of constant density of a two-dimensional error. Read-only.
    """
    def __getstate__(self) -> tuple[float, float, float]: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def angle_rad(self) -> float:
        """
        Of the long axis, from the first axis towards the second.
        """
    @property
    def semi_major_m(self) -> float:
        """
        Half the long axis.
        """
    @property
    def semi_minor_m(self) -> float:
        """
        Half the short axis.
        """

class StepStatus(enum.IntEnum):
    """
    How a step of a linear filter ended.
    """

    NON_FINITE = ...
    NOT_POSITIVE_DEFINITE = ...
    NO_OBSERVATION = ...
    UPDATED = ...
    def __format__(self, format_spec): ...

class UpdateStatus(enum.IntEnum):
    """
    What became of an observation or a step. All but ACCEPTED left the filter as it was.
    """

    ABSENT = ...
    ACCEPTED = ...
    GATED = ...
    NON_FINITE = ...
    NOT_POSITIVE_DEFINITE = ...
    STALE_HANDLE = ...
    TIME_NOT_ADVANCING = ...
    TOO_LATE = ...
    TOO_MANY_ROWS = ...
    UNDEFINED = ...
    WRONG_TIME_SCALE = ...
    def __format__(self, format_spec): ...

class KalmanReport:
    """
    What became of an update. Read-only.
    """
    def __getstate__(
        self,
    ) -> tuple[
        int,
        int,
        typing.Annotated[list[float], "FixedSize(16)"],
        typing.Annotated[list[float], "FixedSize(256)"],
        float,
        float,
    ]: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def accepted(self) -> bool:
        """
        Whether the state was updated.
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the innovation, H P Hᵀ + R; shape (m, m).
        """
    @property
    def innovation(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        z - h(x), angles the short way round; shape (m,). NaN where refused before it was known.
        """
    @property
    def log_likelihood(self) -> float:
        """
        Logarithm of the innovation's density.
        """
    @property
    def nis(self) -> float:
        """
        Normalised innovation squared.
        """
    @property
    def status(self) -> UpdateStatus:
        """
        An `UpdateStatus`.
        """

class AdaptiveProcessNoise:
    """
    A multiplier on the process noise: see soopnav_cpp.estimation.
    """
    def __getstate__(self) -> tuple: ...
    def __init__(
        self,
        *,
        initial: typing.SupportsFloat | typing.SupportsIndex,
        lower: typing.SupportsFloat | typing.SupportsIndex,
        upper: typing.SupportsFloat | typing.SupportsIndex,
        memory: typing.SupportsFloat | typing.SupportsIndex,
        prior_information: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def clone(self) -> AdaptiveProcessNoise: ...
    def observe(self, report: KalmanReport, R: numpy.typing.ArrayLike) -> bool: ...
    def scaled(self, process: soopnav_cpp._core.process.Process) -> soopnav_cpp._core.process.Process: ...
    @property
    def information(self) -> float: ...
    @property
    def multiplier(self) -> float: ...
    @property
    def options(self) -> tuple[float, float, float, float, float]: ...

class KalmanFilter:
    """
    A Kalman filter of any kind: see soopnav_cpp.estimation.
    """
    def __getstate__(self) -> tuple: ...
    def __init__(
        self,
        kind: str,
        state: str,
        x0: numpy.typing.ArrayLike,
        P0: numpy.typing.ArrayLike,
        options: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [],
        information: bool = False,
    ) -> None: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def clone(self) -> KalmanFilter: ...
    def predict(
        self,
        process: typing.Any,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
        input: numpy.typing.ArrayLike | None = None,
        Q: numpy.typing.ArrayLike | None = None,
    ) -> UpdateStatus: ...
    def run(
        self,
        time_s: numpy.typing.ArrayLike,
        process: soopnav_cpp._core.process.Process,
        measurements: collections.abc.Sequence[
            tuple[
                typing.Any,
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike,
                typing.Annotated[numpy.typing.ArrayLike, numpy.uint8] | None,
            ]
        ],
        *,
        inputs: numpy.typing.ArrayLike | None = None,
        start_s: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
        smooth: bool = False,
        history: bool = True,
        adaptive_noise: AdaptiveProcessNoise | None = None,
    ) -> dict: ...
    def set_covariance_floor(self, variance: numpy.typing.ArrayLike) -> None: ...
    def update(
        self,
        model: typing.Any,
        z: numpy.typing.ArrayLike,
        R: numpy.typing.ArrayLike,
        *,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
        angle_rows: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [],
    ) -> KalmanReport: ...
    @property
    def P(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def component_names(self) -> tuple: ...
    @property
    def covariance_floor_counts(self) -> tuple: ...
    @property
    def state(self) -> str: ...
    @property
    def x(self) -> numpy.typing.NDArray[numpy.float64]: ...

class FixedLagFilter:
    """
    A Kalman filter with late measurements: see soopnav_cpp.estimation.
    """
    def __getstate__(self) -> tuple: ...
    def __init__(
        self,
        filter: KalmanFilter,
        process: soopnav_cpp._core.process.Process,
        start_s: typing.SupportsFloat | typing.SupportsIndex,
        capacity: typing.SupportsInt | typing.SupportsIndex,
        input: numpy.typing.ArrayLike | None = None,
    ) -> None: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def advance(
        self, time_s: typing.SupportsFloat | typing.SupportsIndex, input: numpy.typing.ArrayLike | None = None
    ) -> UpdateStatus: ...
    def clone(self) -> FixedLagFilter: ...
    def run(
        self,
        measurements: collections.abc.Sequence[
            tuple[
                typing.Any,
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike,
            ]
        ],
        *,
        inputs: numpy.typing.ArrayLike | None = None,
        input_time_s: numpy.typing.ArrayLike | None = None,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
        history: bool = True,
    ) -> dict: ...
    def smooth(self) -> tuple: ...
    def update(
        self,
        model: typing.Any,
        z: numpy.typing.ArrayLike,
        R: numpy.typing.ArrayLike,
        time_s: typing.SupportsFloat | typing.SupportsIndex,
        *,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
    ) -> KalmanReport: ...
    @property
    def P(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def capacity(self) -> int: ...
    @property
    def filter(self) -> KalmanFilter: ...
    @property
    def kind(self) -> str: ...
    @property
    def oldest_time_s(self) -> float: ...
    @property
    def process(self) -> soopnav_cpp._core.process.Process: ...
    @property
    def size(self) -> int: ...
    @property
    def time_s(self) -> float: ...
    @property
    def x(self) -> numpy.typing.NDArray[numpy.float64]: ...

class InteractingMultipleModel:
    """
    A Kalman filter for each process model: see soopnav_cpp.estimation.
    """
    def __getstate__(self) -> tuple: ...
    def __init__(
        self,
        state: str,
        x0: numpy.typing.ArrayLike,
        P0: numpy.typing.ArrayLike,
        processes: collections.abc.Sequence[soopnav_cpp._core.process.Process],
        transition: numpy.typing.ArrayLike,
        probabilities: numpy.typing.ArrayLike,
    ) -> None: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def clone(self) -> InteractingMultipleModel: ...
    def predict(
        self, dt_s: typing.SupportsFloat | typing.SupportsIndex, input: numpy.typing.ArrayLike | None = None
    ) -> UpdateStatus: ...
    def run(
        self,
        time_s: numpy.typing.ArrayLike,
        measurements: collections.abc.Sequence[
            tuple[
                typing.Any,
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike,
                typing.Annotated[numpy.typing.ArrayLike, numpy.uint8] | None,
            ]
        ],
        *,
        inputs: numpy.typing.ArrayLike | None = None,
        start_s: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
        history: bool = True,
    ) -> dict: ...
    def set_covariance_floor(self, variance: numpy.typing.ArrayLike) -> None: ...
    def update(
        self,
        model: typing.Any,
        z: numpy.typing.ArrayLike,
        R: numpy.typing.ArrayLike,
        *,
        gate_nis: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual: typing.SupportsFloat | typing.SupportsIndex | None = None,
        gate_residual_sigmas: typing.SupportsFloat | typing.SupportsIndex | None = None,
        angle_rows: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [],
    ) -> KalmanReport: ...
    @property
    def P(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def component_names(self) -> tuple: ...
    @property
    def covariance_floor_counts(self) -> tuple: ...
    @property
    def mode_P(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def mode_x(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def probabilities(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def processes(self) -> tuple: ...
    @property
    def state(self) -> str: ...
    @property
    def transition(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def x(self) -> numpy.typing.NDArray[numpy.float64]: ...

class ParticleStatus(enum.IntEnum):
    """
    What became of a call to a particle filter.
    """

    ACCEPTED = ...
    DEGENERATE = ...
    NON_FINITE = ...
    NOT_POSITIVE_DEFINITE = ...
    TIME_NOT_ADVANCING = ...
    TOO_MANY_ROWS = ...
    def __format__(self, format_spec): ...

class Resampling(enum.Enum):
    """
    How offspring are drawn from weights.
    """

    MULTINOMIAL = ...
    NEAREST = ...
    RESIDUAL = ...
    STRATIFIED = ...
    SYSTEMATIC = ...

class ParticleReport:
    """
    What a prediction, update or step of a particle filter reports.
    """
    def __getstate__(self) -> tuple[int, float, float, bool]: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def accepted(self) -> bool: ...
    @property
    def ess(self) -> float:
        """
        Effective sample size after the call, 1 ... count.
        """
    @property
    def log_likelihood(self) -> float:
        """
        Of the measurement given those before; 0 for a prediction, -inf when degenerate, NaN when refused.
        """
    @property
    def resampled(self) -> bool:
        """
        Whether the call began by resampling.
        """
    @property
    def status(self) -> ParticleStatus:
        """
        ParticleStatus
        """

class AdaptiveCount:
    """
    A number of particles that follows the spread of the cloud.
    """
    def __init__(
        self,
        bin_sizes: numpy.typing.ArrayLike,
        least: typing.SupportsInt | typing.SupportsIndex,
        divergence: typing.SupportsFloat | typing.SupportsIndex,
        probability: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class ParticlePrior:
    """
    Where particles are drawn from.
    """

class ParticleCloud:
    """
    A particle filter of a state chosen at run time.
    """
    def __init__(
        self,
        prior: ParticlePrior,
        *,
        state: str,
        size: typing.SupportsInt | typing.SupportsIndex,
        names: collections.abc.Sequence[str] | None,
        count: typing.SupportsInt | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
        threads: typing.SupportsInt | typing.SupportsIndex,
        resampling: Resampling,
        ess_threshold: typing.SupportsFloat | typing.SupportsIndex,
        single: bool,
        restart: bool,
        portable: bool,
        auxiliary: bool,
        regularisation: typing.SupportsFloat | typing.SupportsIndex,
        adaptive: AdaptiveCount,
        marginalized_clock: bool,
    ) -> None: ...
    def constrain(
        self, walls: numpy.typing.ArrayLike | None, inside: numpy.typing.ArrayLike | None
    ) -> ParticleReport: ...
    def histogram(
        self,
        component: typing.SupportsInt | typing.SupportsIndex,
        low: typing.SupportsFloat | typing.SupportsIndex,
        high: typing.SupportsFloat | typing.SupportsIndex,
        bins: typing.SupportsInt | typing.SupportsIndex,
    ) -> numpy.typing.NDArray[numpy.float64]: ...
    def next_noise(self, numbers: typing.SupportsInt | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.float64]: ...
    def next_particles(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def resample(self) -> None: ...
    def restore(
        self,
        particles: numpy.typing.ArrayLike,
        log_weights: numpy.typing.ArrayLike,
        log_likelihood: typing.SupportsFloat | typing.SupportsIndex,
        steps: typing.SupportsInt | typing.SupportsIndex,
        restarts: typing.SupportsInt | typing.SupportsIndex,
        clock_covariance: numpy.typing.ArrayLike,
    ) -> None: ...
    def reweight(self, log_likelihood: numpy.typing.ArrayLike, may_resample: bool) -> ParticleReport: ...
    def run(
        self,
        time_s: numpy.typing.ArrayLike,
        start_s: typing.SupportsFloat | typing.SupportsIndex | None,
        process: soopnav_cpp._core.process.Process | None,
        inputs: numpy.typing.ArrayLike | None,
        measurements: collections.abc.Sequence[
            tuple[
                collections.abc.Sequence[soopnav_cpp._core.measurement.Measurement],
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike | None,
                numpy.typing.ArrayLike | None,
                bool,
                typing.Annotated[numpy.typing.ArrayLike, numpy.uint8] | None,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
            ]
        ],
        covariance: bool,
    ) -> tuple: ...
    def save(
        self,
    ) -> tuple[
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.float64],
        float,
        int,
        int,
        numpy.typing.NDArray[numpy.float64],
    ]: ...
    def step(
        self,
        process: soopnav_cpp._core.process.Process | None,
        input: numpy.typing.ArrayLike | None,
        dt_s: typing.SupportsFloat | typing.SupportsIndex,
        observations: collections.abc.Sequence[
            tuple[
                collections.abc.Sequence[soopnav_cpp._core.measurement.Measurement],
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike | None,
                numpy.typing.ArrayLike | None,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
            ]
        ],
    ) -> ParticleReport: ...
    def step_to(
        self,
        x_next: numpy.typing.ArrayLike,
        observations: collections.abc.Sequence[
            tuple[
                collections.abc.Sequence[soopnav_cpp._core.measurement.Measurement],
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike | None,
                numpy.typing.ArrayLike | None,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
            ]
        ],
    ) -> ParticleReport: ...
    def update(
        self,
        observations: collections.abc.Sequence[
            tuple[
                collections.abc.Sequence[soopnav_cpp._core.measurement.Measurement],
                numpy.typing.ArrayLike,
                numpy.typing.ArrayLike | None,
                numpy.typing.ArrayLike | None,
                typing.SupportsFloat | typing.SupportsIndex,
                typing.SupportsFloat | typing.SupportsIndex,
            ]
        ],
    ) -> ParticleReport: ...
    @property
    def component_names(self) -> list[str]: ...
    @property
    def count(self) -> int: ...
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def ess(self) -> float: ...
    @property
    def log_likelihood(self) -> float: ...
    @property
    def mean(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def particles(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def state(self) -> str: ...
    @property
    def storage_bytes(self) -> int: ...
    @property
    def weights(self) -> numpy.typing.NDArray[numpy.float64]: ...

def circular_error_m(
    covariance_m2: numpy.typing.ArrayLike, *, probability: typing.SupportsFloat | typing.SupportsIndex = 0.5
) -> float:
    """
    Radius of the circle that holds the error with a probability.
    """

def coverage(
    errors: numpy.typing.ArrayLike, P: numpy.typing.ArrayLike, probability: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Share of the errors inside their region.
    """

def coverage_bounds(
    probability: typing.SupportsFloat | typing.SupportsIndex,
    runs: typing.SupportsInt | typing.SupportsIndex,
    failure_probability: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    Lower and upper bound of a share.
    """

def crlb(
    H: numpy.typing.ArrayLike,
    R: numpy.typing.ArrayLike,
    prior_information: numpy.typing.ArrayLike | None,
    names: collections.abc.Sequence[str],
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[
    int,
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    numpy.typing.NDArray[numpy.float64],
    list[str],
]:
    """
    Rank, information, covariance, sigma, singular values, unobservable basis and its directions in words.
    """

def crlb_series(
    H: numpy.typing.ArrayLike,
    count: typing.SupportsInt | typing.SupportsIndex,
    R: numpy.typing.ArrayLike,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.int64]]:
    """
    Sigma (count, n) and rank (count,) of as many Jacobians one below the other; NaN where one is not finite.
    """

def error_ellipse(
    covariance_m2: numpy.typing.ArrayLike, *, probability: typing.SupportsFloat | typing.SupportsIndex | None = None
) -> ErrorEllipse:
    """
    Ellipse that holds the error with a probability; without one the 1-sigma ellipse.
    """

def gaussian_prior(x0: numpy.typing.ArrayLike, P0: numpy.typing.ArrayLike) -> ParticlePrior: ...
def joined_report(report: ParticleReport, resampled: bool) -> ParticleReport:
    """
    The report of a weighing that followed a prediction.
    """

def linear_filter(
    F: numpy.typing.ArrayLike,
    Q: numpy.typing.ArrayLike,
    H: numpy.typing.ArrayLike,
    R: numpy.typing.ArrayLike,
    z: numpy.typing.ArrayLike,
    x0: numpy.typing.ArrayLike,
    P0: numpy.typing.ArrayLike,
    *,
    B: numpy.typing.ArrayLike | None = None,
    u: numpy.typing.ArrayLike | None = None,
    mask: typing.Annotated[numpy.typing.ArrayLike, numpy.uint8] | None = None,
) -> tuple:
    """
    Kalman filter over a whole run: x_pred, P_pred, x, P, innovation, S, nis, step_log_likelihood, status, log_likelihood.
    """

def marginal_information(
    information: numpy.typing.ArrayLike, kept: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Schur complement: information when the other parameters are unknown.
    """

def mean_nees_bounds(
    dof: typing.SupportsFloat | typing.SupportsIndex,
    runs: typing.SupportsInt | typing.SupportsIndex,
    failure_probability: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]:
    """
    Lower and upper bound of a mean of NEES.
    """

def nees_series(errors: numpy.typing.ArrayLike, P: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    NEES of each row, NaN where it has none.
    """

def observability_matrix(
    F: numpy.typing.ArrayLike,
    H: numpy.typing.ArrayLike,
    rows: typing.SupportsInt | typing.SupportsIndex,
    steps: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    [H_0; H_1 F_0; H_2 F_1 F_0; ...].
    """

def position_jacobian(
    kind: str, nodes_m: numpy.typing.ArrayLike, positions_m: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Derivative of every node's measurement by every position, (positions, nodes, 3).
    """

def posterior_crlb(
    F: numpy.typing.ArrayLike,
    Q: numpy.typing.ArrayLike,
    H: numpy.typing.ArrayLike,
    R: numpy.typing.ArrayLike,
    P0: numpy.typing.ArrayLike,
    steps: typing.SupportsInt | typing.SupportsIndex,
    samples: typing.SupportsInt | typing.SupportsIndex,
    rows: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
    """
    P and P_pred, (steps, n, n) each.
    """

def rmse(errors: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Root mean square of each component.
    """

def rts_smooth(
    F: numpy.typing.ArrayLike,
    x_pred: numpy.typing.ArrayLike,
    P_pred: numpy.typing.ArrayLike,
    x: numpy.typing.ArrayLike,
    P: numpy.typing.ArrayLike,
) -> tuple:
    """
    Rauch-Tung-Striebel smoother over a whole run: x, P.
    """

def sample_circular_error_m(
    errors_m: numpy.typing.ArrayLike, probability: typing.SupportsFloat | typing.SupportsIndex
) -> float:
    """
    Radius that so many of the errors do not exceed.
    """

def sample_prior(particles: numpy.typing.ArrayLike) -> ParticlePrior: ...
def uniform_prior(low: numpy.typing.ArrayLike, high: numpy.typing.ArrayLike) -> ParticlePrior: ...

RANK_TOLERANCE: float = 1e-07
