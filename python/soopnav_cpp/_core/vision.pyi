"""
Cameras, planes of ground, motion over it.
"""

from __future__ import annotations
import collections.abc
import enum
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Camera",
    "EgoMotion",
    "FeatureTracker",
    "FlowStart",
    "FrameStatus",
    "GroundPlane",
    "MotionStatus",
    "PlanarMotion",
    "PlaneFitter",
    "PlaneStatus",
    "RigidMotionEstimator",
    "TrackedFrame",
    "frames_round_trip",
    "ground_pixels",
    "ground_points",
    "opencv_version",
    "to_present_axes",
    "to_previous_axes",
    "tracking_available",
]

class PlaneStatus(enum.Enum):
    """
    What became of a plane fit.
    """

    DEGENERATE = ...
    FITTED = ...
    HEIGHT = ...
    NONE = ...
    NO_PLANE = ...
    TOO_FEW = ...
    WALL = ...

class GroundPlane:
    """
    The ground as a camera sees it, normal . p = distance. Frame: x right, y down the image, z along the optical axis; the normal points into the ground. Read-only.
    """
    @staticmethod
    def from_tilt(
        a_x_rad: typing.SupportsFloat | typing.SupportsIndex,
        a_y_rad: typing.SupportsFloat | typing.SupportsIndex,
        height_m: typing.SupportsFloat | typing.SupportsIndex,
    ) -> GroundPlane:
        """
        The plane below a camera with nielsen's tilt angles.
        """
    @staticmethod
    def known(
        normal_c: numpy.typing.ArrayLike,
        distance_m: typing.SupportsFloat | typing.SupportsIndex,
        *,
        covariance: numpy.typing.ArrayLike | None = None,
    ) -> GroundPlane:
        """
        A plane that is known, without uncertainty unless one is given.
        """
    def __getstate__(
        self,
    ) -> tuple[
        int, numpy.typing.NDArray[numpy.float64], float, numpy.typing.NDArray[numpy.float64], int, int, float
    ]: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def seen_from(
        self, camera_p_c: numpy.typing.ArrayLike, *, turn: numpy.typing.ArrayLike | None = None
    ) -> GroundPlane:
        """
        The same ground from another camera, at camera_p_c of this one [m]; the rows of turn are its axes.
        """
    @property
    def axes_c(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        float64 (3, 3): axes of the body on the ground as rows, in camera axes.
        """
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        float64 (3, 3) of [eta_1, eta_2, distance], [rad, rad, m]: the normal's turn along the body's two axes.
        """
    @property
    def distance_m(self) -> float:
        """
        Height of the camera above the ground [m].
        """
    @property
    def inliers(self) -> int:
        """
        Points that the numbers come from.
        """
    @property
    def nielsen_abcd(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        float64 (4,): [A, B, C, D] in nielsen's frame e, whose y runs up the image; C is positive.
        """
    @property
    def normal_c(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        float64 (3,), unit.
        """
    @property
    def ok(self) -> bool:
        """
        Whether the numbers are the ground's.
        """
    @property
    def points(self) -> int:
        """
        Finite points offered.
        """
    @property
    def rms_m(self) -> float:
        """
        Of the inliers' distances [m].
        """
    @property
    def status(self) -> PlaneStatus:
        """
        What became of the fit.
        """
    @property
    def tilt_rad(self) -> tuple[float, float]:
        """
        nielsen's (a_x, a_y) [rad].
        """

class PlaneFitter:
    """
    Planes of the ground from depth clouds, one after the other.
    """
    def __init__(
        self,
        *,
        method: str = "ransac",
        sigma_m: typing.SupportsFloat | typing.SupportsIndex = 0.0005,
        sigma_per_m: typing.SupportsFloat | typing.SupportsIndex = 0.0014,
        band_sigmas: typing.SupportsFloat | typing.SupportsIndex = 3.0,
        band_m: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        min_share: typing.SupportsFloat | typing.SupportsIndex = 0.2,
        min_points: typing.SupportsInt | typing.SupportsIndex = 50,
        max_tilt_rad: typing.SupportsFloat | typing.SupportsIndex = 0.7854,
        min_height_m: typing.SupportsFloat | typing.SupportsIndex = 0.05,
        max_height_m: typing.SupportsFloat | typing.SupportsIndex = 10.0,
        max_hypotheses: typing.SupportsInt | typing.SupportsIndex = 400,
        confidence: typing.SupportsFloat | typing.SupportsIndex = 0.9999,
        noise_cluster: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        seed: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> None: ...
    def fit(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32]) -> GroundPlane:
        """
        The plane of points, float32 (n, 3) in camera axes [m].
        """

class Camera:
    """
    A calibrated camera. Frame: x right, y down the image, z along the optical axis; whole pixels at their centres. Read-only.
    """
    def __getstate__(self) -> tuple[int, int, float, float, float, float, str, list[float]]: ...
    def __init__(
        self,
        width: typing.SupportsInt | typing.SupportsIndex,
        height: typing.SupportsInt | typing.SupportsIndex,
        fx: typing.SupportsFloat | typing.SupportsIndex,
        fy: typing.SupportsFloat | typing.SupportsIndex,
        cx: typing.SupportsFloat | typing.SupportsIndex,
        cy: typing.SupportsFloat | typing.SupportsIndex,
        *,
        lens: str = "pinhole",
        distortion: numpy.typing.ArrayLike = (),
    ) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def project(self, points_c: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Pixels (n, 2) of points (n, 3) of the camera frame; NaN where there is none.
        """
    def resized(
        self, width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex
    ) -> Camera:
        """
        The same camera whose images are brought to another size.
        """
    def unproject(self, pixels: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
        """
        Rays (n, 3), their z = 1, of pixels (n, 2); NaN where there is none.
        """
    @property
    def cx(self) -> float:
        """
        u of the optical axis [px].
        """
    @property
    def cy(self) -> float:
        """
        v of the optical axis [px].
        """
    @property
    def distortion(self) -> list[float]:
        """
        Coefficients of the lens, in OpenCV's order.
        """
    @property
    def fx(self) -> float:
        """
        Focal length along u [px].
        """
    @property
    def fy(self) -> float:
        """
        Focal length along v [px].
        """
    @property
    def height(self) -> int:
        """
        Pixels.
        """
    @property
    def lens(self) -> str:
        """
        'pinhole', 'radial_tangential' or 'fisheye'.
        """
    @property
    def max_angle_rad(self) -> float:
        """
        Largest angle from the optical axis that is mapped.
        """
    @property
    def width(self) -> int:
        """
        Pixels.
        """

class FrameStatus(enum.Enum):
    """
    What became of a frame.
    """

    BAD_IMAGE = ...
    BLURRED = ...
    DARK = ...
    FIRST = ...
    FLAT = ...
    LOST = ...
    REPEATED = ...
    SATURATED = ...
    TRACKED = ...

class FlowStart(enum.Enum):
    """
    Where the search for the tracks started.
    """

    NONE = ...
    OVERLAP = ...
    PHASE_CORRELATION = ...
    PREDICTION = ...

class TrackedFrame:
    """
    What a tracker says of a frame. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def born(self) -> int:
        """
        Corners found on this frame.
        """
    @property
    def followed(self) -> int:
        """
        Tracks that came over from the frame before.
        """
    @property
    def lost(self) -> int:
        """
        Tracks that did not.
        """
    @property
    def median_flow_px(self) -> float:
        """
        Of the tracks followed.
        """
    @property
    def sharpness(self) -> float:
        """
        Mean squared gradient over that of the frames before.
        """
    @property
    def shift_px(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Shift of the whole image, where it was asked.
        """
    @property
    def shift_response(self) -> float:
        """
        How clear the shift was, 0 to 1.
        """
    @property
    def skipped(self) -> int:
        """
        Useless frames since the one it was compared with.
        """
    @property
    def start(self) -> FlowStart:
        """
        Where the search started.
        """
    @property
    def status(self) -> FrameStatus:
        """
        What became of it.
        """

class FeatureTracker:
    def __init__(
        self,
        width: typing.SupportsInt | typing.SupportsIndex,
        height: typing.SupportsInt | typing.SupportsIndex,
        options: dict,
    ) -> None: ...
    def prune(self, keep: collections.abc.Sequence[bool]) -> None: ...
    def reset(self) -> None: ...
    def track(self, image: typing.Any, predicted: numpy.typing.ArrayLike | None = None) -> TrackedFrame: ...
    def tracks(self) -> tuple: ...

class MotionStatus(enum.Enum):
    """
    What became of an increment of motion.
    """

    BAD_IMAGE = ...
    BAD_TIME = ...
    COASTED = ...
    DEGENERATE = ...
    FIRST = ...
    HEIGHT_DISAGREEMENT = ...
    MEASURED = ...
    NO_CONSENSUS = ...
    NO_PLANE = ...
    REPEATED = ...
    TOO_FEW_TRACKS = ...

class PlanarMotion:
    """
    Motion of a camera over the ground between two frames, as it enters a filter. Read-only.
    """
    def __repr__(self) -> str: ...
    @property
    def covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of this increment alone, everything included.
        """
    @property
    def dt_s(self) -> float:
        """
        Interval that the increment covers; 0 where it covers none.
        """
    @property
    def foot_covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the point below the camera by this frame's plane, in axes of this body [m^2].
        """
    @property
    def foot_covariance_previous(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        Of the point below the camera by the previous frame's plane, in axes of the previous body [m^2].
        """
    @property
    def height_m(self) -> float:
        """
        Of the camera above the ground.
        """
    @property
    def height_ratio(self) -> float:
        """
        h_t / h_(t-1) by the tracks alone.
        """
    @property
    def height_ratio_plane(self) -> float:
        """
        The same by the planes.
        """
    @property
    def height_ratio_sigma(self) -> float:
        """
        Of the difference of the two.
        """
    @property
    def increment(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        {dx, dy, da_z} [m, m, rad]: displacement in axes of the previous body, turn counterclockwise from above.
        """
    @property
    def inliers(self) -> int:
        """
        Those that agree with the motion.
        """
    @property
    def ok(self) -> bool:
        """
        Whether the increment was measured.
        """
    @property
    def rival_share(self) -> float:
        """
        Of the tracks, those that agree with another motion.
        """
    @property
    def rms_px(self) -> float:
        """
        Of the residuals, per axis.
        """
    @property
    def sigma_px(self) -> float:
        """
        Noise of a track that the covariance stands for.
        """
    @property
    def skipped(self) -> int:
        """
        Frames within it that gave no increment.
        """
    @property
    def status(self) -> MotionStatus:
        """
        What became of it.
        """
    @property
    def t_s(self) -> float:
        """
        Time of this frame.
        """
    @property
    def track_covariance(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        The part that is independent from increment to increment.
        """
    @property
    def tracks(self) -> int:
        """
        Pairs of pixels offered.
        """
    @property
    def used(self) -> int:
        """
        Those whose rays meet the ground.
        """

class EgoMotion:
    def __init__(self, camera: Camera, tracker: dict, options: dict) -> None: ...
    def frame(self) -> TrackedFrame: ...
    def inliers(self) -> list[bool]: ...
    def plane(self) -> GroundPlane: ...
    def reset(self) -> None: ...
    def step_plane(
        self, image: typing.Any, t_s: typing.SupportsFloat | typing.SupportsIndex, plane: GroundPlane
    ) -> PlanarMotion: ...
    def step_points(
        self, image: typing.Any, t_s: typing.SupportsFloat | typing.SupportsIndex, points: typing.Any
    ) -> PlanarMotion: ...
    def tracks(self) -> tuple: ...

class RigidMotionEstimator:
    """
    Increments from feature tracks over the ground.
    """
    def __init__(
        self,
        *,
        min_sigma_px: typing.SupportsFloat | typing.SupportsIndex = 0.01,
        inlier_px: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        min_tracks: typing.SupportsInt | typing.SupportsIndex = 8,
        min_share: typing.SupportsFloat | typing.SupportsIndex = 0.25,
        max_hypotheses: typing.SupportsInt | typing.SupportsIndex = 200,
        height_sigmas: typing.SupportsFloat | typing.SupportsIndex = 6.0,
        height_tolerance: typing.SupportsFloat | typing.SupportsIndex = 0.01,
        track_inflation: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        seed: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> None: ...
    def estimate(
        self,
        camera: Camera,
        previous_px: numpy.typing.ArrayLike,
        present_px: numpy.typing.ArrayLike,
        previous: GroundPlane,
        present: GroundPlane,
    ) -> PlanarMotion:
        """
        The motion between two frames from pixels (n, 2) of the same features and the ground of both.
        """

def frames_round_trip(
    pose: numpy.typing.ArrayLike,
    tilt_rad: numpy.typing.ArrayLike,
    height_m: typing.SupportsFloat | typing.SupportsIndex,
    points_a: numpy.typing.ArrayLike,
) -> numpy.typing.NDArray[numpy.float64]:
    """
    nielsen's chain: float64 (n, 7, 3), each point in frames a, b, c, d, e, the camera's, and a again.
    """

def ground_pixels(
    plane: GroundPlane, camera: Camera, points_b: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Inverse of ground_points.
    """

def ground_points(
    plane: GroundPlane, camera: Camera, pixels: numpy.typing.ArrayLike
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Where rays of pixels (n, 2) meet the ground: float64 (n, 2) in axes of the body, from the foot below the camera; NaN where they do not.
    """

def opencv_version() -> str:
    """
    Version of the OpenCV in use; empty without one.
    """

def to_present_axes(increment: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    {dx, dy, da_z} in axes of the previous body -> nielsen's, in axes of the present one.
    """

def to_previous_axes(increment: numpy.typing.ArrayLike) -> numpy.typing.NDArray[numpy.float64]:
    """
    Inverse of to_present_axes.
    """

def tracking_available() -> bool:
    """
    Whether this build can track images.
    """
