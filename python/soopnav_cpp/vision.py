"""Camera ego-motion: cameras, corners followed from frame to frame, motion over the ground (nielsen §4).

Camera frame: x right, y down the image, z along the optical axis. Pixels (u, v): whole numbers at their centres.
The body on the ground: first axis the camera's x axis projected on the ground, second up the image, heading
counterclockwise from above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._camera_file import CameraFile, DepthCamera, load_camera, save_camera
from soopnav_cpp._core import vision as _vision
from soopnav_cpp._core.vision import (
    Camera,
    FlowStart,
    FrameStatus,
    GroundPlane,
    MotionStatus,
    PlanarMotion,
    PlaneFitter,
    PlaneStatus,
    RigidMotionEstimator,
    TrackedFrame,
)
from soopnav_cpp._ground import (
    fit_plane,
    ground_pixels,
    ground_points,
    nielsen_frames,
    to_present_axes,
    to_previous_axes,
)

__all__ = [
    "Camera",
    "CameraFile",
    "DepthCamera",
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
    "Tracks",
    "available",
    "depth_intrinsics",
    "fit_plane",
    "ground_pixels",
    "ground_points",
    "load_camera",
    "nielsen_frames",
    "opencv_version",
    "save_camera",
    "to_present_axes",
    "to_previous_axes",
]

_Floats = npt.NDArray[np.float64]
_Image = npt.NDArray[np.uint8]


def available() -> bool:
    """Whether this build can follow corners: it was made with OpenCV. All else here works without."""
    return _vision.tracking_available()


def depth_intrinsics(camera: CameraFile) -> Camera | None:
    """The lens of the depth camera beside an image's camera, where its file has one."""
    return None if camera.depth is None else camera.depth.camera


def opencv_version() -> str:
    """Version of the OpenCV that this build uses, such as ``"4.6.0"``; empty without one."""
    return _vision.opencv_version()


@dataclass(frozen=True)
class Tracks:
    """Corners on a frame, oldest first.

    Attributes
    ----------
    id : ndarray, shape (n,), uint64
        Names, never used twice by a tracker.
    age : ndarray, shape (n,), int32
        Frames over which each was followed; 0 for one found on this frame.
    pixel, pixel_previous : ndarray, shape (n, 2), float64
        Where it is, and where it was on the frame compared with [px].
    """

    id: npt.NDArray[np.uint64]
    age: npt.NDArray[np.int32]
    pixel: _Floats
    pixel_previous: _Floats


class FeatureTracker:
    """Follows corners: Shi-Tomasi spread over cells, pyramidal Lucas-Kanade forwards and backwards.

    The search starts where the caller predicts, else at the shift of the whole image (phase correlation at a quarter of
    its size). The flow is the mean of the forward one and the backward one reversed. Dark, saturated, flat and blurred
    frames are stepped over. The same frames give the same bits. About 8 ms for 640 × 480 and 300 tracks on one core.

    Parameters
    ----------
    width, height : int
        Of the images [px], 32 to 16384.
    **options
        By name, defaults in brackets: ``tracks`` [300] wanted at a time; ``cell_px`` [40] side of the cells;
        ``quality`` [0.02] and ``least_eigenvalue`` [2e-5] of a corner; ``min_distance_px`` [8] between corners;
        ``border_px`` [12] kept free; ``redetect_share`` [0.8] of `tracks` below which corners are looked for;
        ``window_px`` [21], ``levels`` [3], ``iterations`` [30], ``epsilon_px`` [0.003] of Lucas-Kanade;
        ``round_trip_px`` [0.5] gate forwards-backwards; ``most_flow_px`` [200]; ``patience`` [5] useless frames in
        a row; ``smoothing_px`` [0.8] of the Gaussian over each image.

    Raises
    ------
    ValueError
        For an unknown option or one out of its range, naming it.
    RuntimeError
        Where the build has no OpenCV, saying how to get it.
    """

    def __init__(self, width: int, height: int, **options: float) -> None:
        self._core = _vision.FeatureTracker(width, height, options)

    def track(self, image: _Image, *, predicted: npt.ArrayLike | None = None) -> TrackedFrame:
        """Take the next frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8
            Grey; the pixels of a row side by side. An image of another size is reported as ``BAD_IMAGE``.
        predicted : array_like, shape (n, 2), optional
            Where each of the tracks is expected, NaN where nothing is; as many rows as `tracks` has.
        """
        return self._core.track(image, predicted)

    @property
    def tracks(self) -> Tracks:
        """Tracks on the last frame."""
        return Tracks(*self._core.tracks())

    def prune(self, keep: npt.ArrayLike) -> None:
        """Give tracks up where `keep`, one value per track, is false."""
        self._core.prune([bool(value) for value in np.asarray(keep)])

    def reset(self) -> None:
        """Forget every frame."""
        self._core.reset()


class EgoMotion:
    """Motion of a camera over the ground from its images and the ground plane (nielsen §4.1-4.2).

    Corners are followed, their rays met with the tilted ground of both frames, and {dx, dy, da_z} is fitted to those
    that agree, with a covariance. A frame without increment says why and has ``dt_s = 0``; the next increment then
    covers the whole interval. After `max_gap_s` it coasts on the last velocity, with a covariance that grows. The
    increments of all steps with ``dt_s > 0`` follow one another without gap.

    Parameters
    ----------
    camera : Camera or CameraFile
    depth_offset_m : array_like, shape (3,), optional
        Origin of the depth camera in axes of `camera`, used with ``points``; by default what the camera's file says,
        which is also asked for options of the plane that are not given.
    features : int, optional
        Corners wanted at a time, 300 by default.
    seed : int
        Of the random choices; the same seed and frames give the same bits.
    tracker : dict, optional
        Options of `FeatureTracker`.
    **options
        By name, defaults in brackets: ``min_age`` [2] frames a track must have lived; ``outlier_frames`` [3];
        ``max_gap_s`` [0.5]; ``acceleration_mps2`` [2], ``speed_mps`` [1.5], ``turn_rate_radps`` [1], ``coast_s`` [1] of
        coasting; ``surprise_mps`` [0.5] and ``rival_share`` [0.2] of a second motion in the image;
        ``plane_sigma_m`` [0.0005], ``plane_sigma_per_m`` [0.0014], ``plane_band_sigmas`` [3], ``plane_band_m`` [0],
        ``plane_noise_cluster`` [1], ``plane_min_share`` [0.2], ``plane_min_points`` [50], ``plane_max_tilt_rad``
        [0.785, also ``max_tilt_rad``], ``min_height_m`` [0.05], ``max_height_m`` [10] of the plane, as in `fit_plane`;
        ``inlier_px`` [1], ``min_sigma_px`` [0.01], ``min_tracks`` [8], ``min_share`` [0.25], ``track_inflation`` [1.3],
        ``height_sigmas`` [6] and ``height_tolerance`` [0.01] of the motion.

    Raises
    ------
    ValueError
        For an unknown option or one out of its range, naming it.
    RuntimeError
        Where the build has no OpenCV, saying how to get it.
    """

    def __init__(
        self,
        camera: Camera | CameraFile,
        *,
        depth_offset_m: npt.ArrayLike | None = None,
        features: int | None = None,
        seed: int = 0,
        tracker: dict[str, float] | None = None,
        **options: float,
    ) -> None:
        if isinstance(camera, CameraFile):
            if depth_offset_m is None and camera.depth is not None:
                depth_offset_m = camera.depth.offset_m
            if camera.depth is not None:
                options = {**camera.depth.plane_options, **options}
            camera = camera.camera
        offset: _Floats = np.asarray((0.0, 0.0, 0.0) if depth_offset_m is None else depth_offset_m, np.float64)
        if offset.shape != (3,) or not np.isfinite(offset).all():
            raise ValueError(f"depth_offset_m: three finite numbers expected, got {depth_offset_m!r}")
        every: dict[str, Any] = {"depth_offset_m": tuple(offset.tolist()), "seed": seed, **options}
        corners = dict(tracker or {})
        if features is not None:
            corners["tracks"] = features
        self._core = _vision.EgoMotion(camera, corners, every)
        self._camera = camera
        self._frames = 0

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self._camera

    def step(
        self,
        image: _Image,
        *,
        plane: GroundPlane | None = None,
        points: npt.ArrayLike | None = None,
        t_s: float | None = None,
    ) -> PlanarMotion:
        """Take the next frame.

        Parameters
        ----------
        image : ndarray, shape (height, width), uint8
            Grey, of the camera's size.
        plane : GroundPlane
            The ground in axes of this camera; or
        points : array_like, shape (n, 3)
            points of the depth camera [m], in its axes; NaN points are left out. float32 is not copied.
        t_s : float, optional
            Time of the frame; without it frames count 1/20 s each.

        Returns
        -------
        PlanarMotion

        Raises
        ------
        ValueError
            For an image or points of another kind, an image of another size than the camera's, and unless just one of
            `plane` and `points` is given.
        """
        if (plane is None) == (points is None):
            raise ValueError("plane, points: give one of them")
        if (
            isinstance(image, np.ndarray)
            and image.ndim == 2
            and image.shape != (self._camera.height, self._camera.width)
        ):
            raise ValueError(
                f"image: {image.shape[1]} x {image.shape[0]} pixels, but the camera is for "
                f"{self._camera.width} x {self._camera.height}"
            )
        t = 0.05 * self._frames if t_s is None else float(t_s)
        self._frames += 1
        if plane is not None:
            return self._core.step_plane(image, t, plane)
        return self._core.step_points(image, t, points)

    @property
    def frame(self) -> TrackedFrame:
        """What the tracker said of the last frame."""
        return self._core.frame()

    @property
    def plane(self) -> GroundPlane:
        """Ground of the last frame, in axes of the camera."""
        return self._core.plane()

    @property
    def tracks(self) -> Tracks:
        """Tracks on the last frame."""
        return Tracks(*self._core.tracks())

    @property
    def inliers(self) -> npt.NDArray[np.bool_]:
        """Which of `tracks` the last increment was fitted to, shape (n,)."""
        return np.asarray(self._core.inliers(), np.bool_)

    def reset(self) -> None:
        """Forget every frame."""
        self._core.reset()
        self._frames = 0
