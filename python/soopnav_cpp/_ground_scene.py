"""Textured ground below a camera, rendered with exact truth: images, depth clouds, planes, increments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation
from soopnav_cpp._core.vision import Camera, GroundPlane
from soopnav_cpp._ground import ground_pixels, ground_points

_Float = npt.NDArray[np.float64]
Pose = Sequence[float] | _Float


@dataclass(frozen=True)
class GroundObject:
    """A flat textured rectangle that is not part of the ground: a box's top, a sheet that slides, somebody's shoulders.

    Parameters
    ----------
    x_m, y_m, heading_rad
        Its centre and axes in the ground frame.
    length_m, width_m
        Along its first and its second axis.
    height_m
        Above the ground. 0 lies on it: images show it, depth clouds do not.
    brightness
        Factor on its texture.
    texture_shift_m
        Its texture is the ground's from so far off.
    """

    x_m: float
    y_m: float
    heading_rad: float = 0.0
    length_m: float = 0.5
    width_m: float = 0.5
    height_m: float = 0.0
    brightness: float = 1.0
    texture_shift_m: float = 0.37

    def moved(self, dx_m: float, dy_m: float) -> GroundObject:
        """The same object, ``dx_m``, ``dy_m`` farther along the ground's axes."""
        values = list(astuple(self))
        values[0] += dx_m
        values[1] += dy_m
        return GroundObject(*values)


def _view(pose: Pose, height_m: float, tilt_rad: Sequence[float]) -> list[float]:
    place = [float(value) for value in pose]
    tilt = [float(value) for value in tilt_rad]
    if len(place) != 3:
        raise ValueError(f"pose: {len(place)} numbers; three are needed: x_m, y_m, heading_rad")
    if len(tilt) != 2:
        raise ValueError(f"tilt_rad: {len(tilt)} numbers; two are needed: a_x, a_y")
    return [*place, float(height_m), *tilt]


def _rows(objects: Sequence[GroundObject]) -> _Float:
    return np.array([astuple(each) for each in objects], dtype=np.float64).reshape(-1, 8)


def foot_tracks(
    camera: Camera,
    previous_pose: Pose,
    pose: Pose,
    *,
    previous_height_m: float = 1.0,
    height_m: float = 1.0,
    previous_tilt_rad: Sequence[float] = (0.0, 0.0),
    tilt_rad: Sequence[float] = (0.0, 0.0),
    tracks: int = 300,
    sigma_px: float = 0.1,
    outlier_share: float = 0.0,
    outlier_px: float = 30.0,
    seed: int = 0,
) -> tuple[_Float, _Float]:
    """Feature tracks between two frames without images: pixels of ground points, and noise.

    Points are uniform over the present image and kept where the previous one shows them too.

    Parameters
    ----------
    camera
        Of both frames.
    previous_pose, pose
        ``(x_m, y_m, heading_rad)`` of the body at both frames.
    previous_height_m, height_m, previous_tilt_rad, tilt_rad
        Of the camera, as in `GroundScene.render`.
    tracks
        How many.
    sigma_px
        Noise of the present pixel, per axis: that of the displacement.
    outlier_share, outlier_px
        Of tracks that went astray, and how far: uniform within, per axis.
    seed
        The same one gives the same bits.

    Returns
    -------
    previous_px, present_px : ndarray, shape (tracks, 2)

    Raises
    ------
    ValueError
        For negative noise, a share outside [0, 1], and frames that have too little in common.
    """
    if tracks < 1:
        raise ValueError(f"tracks: {tracks}; at least 1 is needed")
    if not sigma_px >= 0.0:
        raise ValueError(f"sigma_px: {sigma_px}; it must be at least 0")
    if not 0.0 <= outlier_share <= 1.0:
        raise ValueError(f"outlier_share: {outlier_share}; it must be in [0, 1]")
    rng = np.random.default_rng(seed)
    before = GroundScene.true_plane(previous_height_m, previous_tilt_rad)
    now = GroundScene.true_plane(height_m, tilt_rad)
    step = GroundScene.increment(previous_pose, pose)
    c, s = np.cos(step[2]), np.sin(step[2])
    size = np.array([camera.width, camera.height], dtype=np.float64)
    kept: list[tuple[_Float, _Float]] = []
    count = 0
    for _ in range(20):
        present = rng.uniform(0.0, 1.0, (2 * tracks, 2)) * size - 0.5
        points = ground_points(now, camera, present)
        there = np.isfinite(points[:, 0])
        previous = ground_pixels(before, camera, points[there] @ np.array([[c, s], [-s, c]]) + step[:2])
        inside = ((previous >= -0.5) & (previous <= size - 0.5)).all(axis=1)  # NaN is not
        kept.append((previous[inside], present[there][inside]))
        count += int(inside.sum())
        if count >= tracks:
            break
    else:
        raise ValueError(f"pose: the frames share {count} of {tracks} points looked for; they must overlap")
    previous_px = np.concatenate([a for a, _ in kept])[:tracks]
    present_px = np.concatenate([b for _, b in kept])[:tracks] + sigma_px * rng.standard_normal((tracks, 2))
    astray = rng.uniform(size=tracks) < outlier_share
    present_px[astray] += rng.uniform(-outlier_px, outlier_px, (int(astray.sum()), 2))
    return previous_px, present_px


class GroundScene:
    """Ground to look down on, rendered so that the truth of every pixel is exact.

    The texture is a fixed, periodic, band-limited function of the ground's coordinates (octaves of B-spline noise, mip
    levels against aliasing); every pixel's ray meets ground, objects and wall in closed form.

    Frames: ground planar, z up; ``pose`` is ``(x_m, y_m, heading_rad)`` of the body, whose origin lies below the camera
    and whose first axis is the camera's x axis projected on the ground. ``tilt_rad`` are nielsen's ``(a_x, a_y)``
    (4.2.1): the normal into the ground is ``(sin a_y cos a_x, sin a_x, cos a_y cos a_x)`` in the camera's axes.

    Parameters
    ----------
    seed
        Names the texture and all noise: the same seed and frame give the same bits.
    texture_size
        Texels along a side, a power of two; the texture repeats after ``texture_size * texel_m``.
    texel_m
        One texel on the ground.
    finest_texels
        Spacing of the finest detail, a power of two; below 4 images alias.
    roughness
        Amplitude of each finer octave against the coarser one, (0, 2].
    contrast
        Standard deviation of the brightness about 0.5.

    One object serves one thread at a time. A frame of 640 x 480 takes about 3 ms, a cloud of 30 000 points 0.6 ms.
    """

    def __init__(
        self,
        *,
        seed: int = 0,
        texture_size: int = 2048,
        texel_m: float = 0.001,
        finest_texels: int = 4,
        roughness: float = 1.0,
        contrast: float = 0.22,
    ) -> None:
        self._scene = _simulation.GroundScene(
            seed,
            size=texture_size,
            texel_m=texel_m,
            finest_texels=finest_texels,
            roughness=roughness,
            contrast=contrast,
        )

    def render(
        self,
        camera: Camera,
        pose: Pose,
        height_m: float = 1.0,
        tilt_rad: Sequence[float] = (0.0, 0.0),
        *,
        to_pose: Pose | None = None,
        to_height_m: float | None = None,
        to_tilt_rad: Sequence[float] | None = None,
        blur_views: int = 8,
        gain: float = 1.0,
        offset: float = 0.0,
        gradient: tuple[float, float] = (0.0, 0.0),
        defocus_px: float = 0.0,
        noise: float = 0.0,
        objects: Sequence[GroundObject] = (),
        wall: tuple[float, float, float] | None = None,
        frame: int = 0,
    ) -> npt.NDArray[np.uint8]:
        """An image of the ground.

        Parameters
        ----------
        camera
            Size and lens of the image.
        pose, height_m, tilt_rad
            Where the camera is; with ``to_...`` at the start of the exposure.
        to_pose, to_height_m, to_tilt_rad
            Where it is at the end of the exposure (motion blur); the image is the mean of ``blur_views`` even steps.
        gain, offset
            Exposure and flicker of the whole image; added brightness, 1 is white.
        gradient
            Gain changes by so much from left to right and from top to bottom.
        defocus_px
            Standard deviation of a Gaussian blur.
        noise
            Standard deviation of each pixel in grey levels.
        objects, wall
            What covers the ground, in their order; a vertical wall through ``(x_m, y_m, heading_rad of its normal)``.
        frame
            Which noise.

        Returns
        -------
        numpy.ndarray
            uint8 (height, width). Pixels that see no ground are grey.
        """
        start = _view(pose, height_m, tilt_rad)
        views = np.array([start])
        if to_pose is not None or to_height_m is not None or to_tilt_rad is not None:
            if blur_views < 2:
                raise ValueError(f"blur_views: {blur_views}; at least 2 are needed")
            end = np.array(
                _view(
                    pose if to_pose is None else to_pose,
                    height_m if to_height_m is None else to_height_m,
                    tilt_rad if to_tilt_rad is None else to_tilt_rad,
                )
            )
            change = end - views[0]
            change[2] = np.remainder(change[2] + np.pi, 2 * np.pi) - np.pi
            views = views + np.linspace(0.0, 1.0, blur_views)[:, None] * change
        shot = [gain, offset, gradient[0], gradient[1], defocus_px, noise]
        return self._scene.render(camera, views, shot, _rows(objects), wall, frame)

    def depth_cloud(
        self,
        camera: Camera,
        pose: Pose,
        height_m: float = 1.0,
        tilt_rad: Sequence[float] = (0.0, 0.0),
        *,
        points: int = 30000,
        sigma_m: float = 0.0005,
        sigma_per_m: float = 0.0014,
        quantum_per_m: float = 0.0,
        hole_share: float = 0.0,
        outlier_share: float = 0.0,
        sensor_p_c: Sequence[float] = (0.0, 0.0, 0.0),
        objects: Sequence[GroundObject] = (),
        wall: tuple[float, float, float] | None = None,
        frame: int = 0,
    ) -> npt.NDArray[np.float32]:
        """What a depth sensor of structured light sees, on a jittered grid over the field of view of ``camera``.

        Parameters
        ----------
        camera
            Field of view of the depth sensor.
        pose, height_m, tilt_rad
            Where the RGB camera is, as in `render`.
        points
            How many.
        sigma_m, sigma_per_m
            Noise of the depth, ``sigma_m + sigma_per_m * z**2``.
        quantum_per_m
            Step of 1/z; 0: none.
        hole_share, outlier_share
            Of points that do not come back, and of those at a uniform 30 to 99 % of their depth.
        sensor_p_c
            The sensor in axes of the RGB camera [m]; it looks the same way.
        objects, wall, frame
            As in `render`.

        Returns
        -------
        numpy.ndarray
            float32 (points, 3) in the sensor's axes [m], NaN where nothing came back.
        """
        sensor = [sigma_m, sigma_per_m, quantum_per_m, hole_share, outlier_share]
        view = _view(pose, height_m, tilt_rad)
        return self._scene.depth_cloud(
            camera, view, points, sensor, np.asarray(sensor_p_c, dtype=np.float64), _rows(objects), wall, frame
        )

    def brightness(self, x_m: float, y_m: float) -> float:
        """Of the ground there, 0 black, 1 white: what an image samples without light, lens and noise."""
        return self._scene.brightness(x_m, y_m)

    @staticmethod
    def true_plane(height_m: float = 1.0, tilt_rad: Sequence[float] = (0.0, 0.0)) -> GroundPlane:
        """The ground as the camera sees it, known exactly."""
        return GroundPlane.from_tilt(float(tilt_rad[0]), float(tilt_rad[1]), height_m)

    @staticmethod
    def increment(previous_pose: Pose, pose: Pose) -> _Float:
        """The true ``{dx, dy, da_z}`` [m, m, rad] between two poses, in axes of the previous body."""
        return _simulation.increment_between(
            np.asarray(previous_pose, dtype=np.float64), np.asarray(pose, dtype=np.float64)
        )
