"""Planes of the ground from depth clouds, and what pixels see of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import vision as _vision
from soopnav_cpp._core.vision import Camera, GroundPlane

_Float = npt.NDArray[np.float64]


def _rows(values: npt.ArrayLike, name: str, columns: int) -> _Float:
    """`values` as float64 (n, columns); one alone is a row."""
    table = np.asarray(values, dtype=np.float64)
    if table.shape == (columns,):
        table = table.reshape(1, columns)
    if table.size == 0 and table.ndim == 1:
        table = table.reshape(0, columns)
    if table.ndim != 2 or table.shape[1] != columns:
        raise ValueError(f"{name}: numbers of shape (n, {columns}) expected, got shape {table.shape}")
    return table


def fit_plane(
    points: npt.ArrayLike,
    *,
    method: str = "ransac",
    sigma_m: float = 0.0005,
    sigma_per_m: float = 0.0014,
    band_sigmas: float = 3.0,
    band_m: float = 0.0,
    min_share: float = 0.2,
    min_points: int = 50,
    max_tilt_rad: float = 0.7854,
    min_height_m: float = 0.05,
    max_height_m: float = 10.0,
    max_hypotheses: int = 400,
    confidence: float = 0.9999,
    noise_cluster: float = 1.0,
    seed: int = 0,
) -> GroundPlane:
    """The plane of the ground in a depth cloud.

    Parameters
    ----------
    points
        (n, 3) in camera axes [m]: x right, y down the image, z along the optical axis. Computed with in single
        precision. Points that are not finite or not in front are skipped.
    method
        ``"ransac"``: robust; seeded three-point hypotheses, then weighted refits to all points inside the band.
        ``"svd"``: nielsen 4.1, the smallest right singular vector of [x y z 1] over all points; one outlier pulls it.
    sigma_m, sigma_per_m
        Noise of the sensor's depth, ``sigma_m + sigma_per_m * z**2``.
    band_sigmas
        Points nearer to the plane than this many sigma are on it.
    band_m
        Positive: a fixed band in place of ``band_sigmas``. A recorded surface bends by a few millimetres that the
        sensor's noise does not explain; 0.01 suits a Kinect near a metre.
    min_share, min_points
        Share of the finite points that must be on the ground, and how many there must be.
    max_tilt_rad, min_height_m, max_height_m
        What leans more is a wall; what is nearer or farther is not the ground.
    max_hypotheses, confidence
        Of the search.
    noise_cluster
        Neighbouring points that share one error (quantised depth): the covariance grows by this factor.
    seed
        Names the hypotheses: the same seed gives the same bits.

    Returns
    -------
    GroundPlane
        Look at ``ok`` or ``status`` first. Below 1.5 ms for 30 000 points.
    """
    cloud = np.ascontiguousarray(points, dtype=np.float32)
    fitter = _vision.PlaneFitter(
        method=method,
        sigma_m=sigma_m,
        sigma_per_m=sigma_per_m,
        band_sigmas=band_sigmas,
        band_m=band_m,
        min_share=min_share,
        min_points=min_points,
        max_tilt_rad=max_tilt_rad,
        min_height_m=min_height_m,
        max_height_m=max_height_m,
        max_hypotheses=max_hypotheses,
        confidence=confidence,
        noise_cluster=noise_cluster,
        seed=seed,
    )
    return fitter.fit(cloud)


def ground_points(plane: GroundPlane, camera: Camera, pixels: npt.ArrayLike) -> _Float:
    """Where the rays of ``pixels`` (n, 2) meet the ground (nielsen 4.1, steps 4 to 6).

    Returns float64 (n, 2) in axes of the body, from the foot below the camera [m]; NaN where a ray does not meet the
    ground in front of the camera.
    """
    return _vision.ground_points(plane, camera, _rows(pixels, "pixels", 2))


def ground_pixels(plane: GroundPlane, camera: Camera, points_b: npt.ArrayLike) -> _Float:
    """Pixels (n, 2) of ground points (n, 2) in axes of the body: inverse of `ground_points`."""
    return _vision.ground_pixels(plane, camera, _rows(points_b, "points_b", 2))


def to_present_axes(increment: npt.ArrayLike) -> _Float:
    """``{dx, dy, da_z}`` in axes of the previous body as nielsen's, which are in axes of the present one (4.2.2)."""
    return _vision.to_present_axes(np.asarray(increment, dtype=np.float64))


def to_previous_axes(increment: npt.ArrayLike) -> _Float:
    """Inverse of `to_present_axes`."""
    return _vision.to_previous_axes(np.asarray(increment, dtype=np.float64))


def nielsen_frames(
    pose: npt.ArrayLike, tilt_rad: npt.ArrayLike, height_m: float, points_a: npt.ArrayLike
) -> dict[str, _Float]:
    """nielsen's chain of frames a to e (4.1, 4.2.1), and our camera frame.

    Parameters
    ----------
    pose
        ``(x_m, y_m, heading_rad)`` of the body on the ground.
    tilt_rad
        ``(a_x, a_y)``.
    height_m
        Of the camera above the ground.
    points_a
        (n, 3) in the ground frame.

    Returns
    -------
    dict
        The same points, float64 (n, 3) each: ``"a"`` ground, ``"b"`` from the foot, ``"c"`` turned, ``"d"`` at the
        camera (left-handed, z down), ``"e"`` tilted (the text's f), ``"camera"`` ours, ``"back"`` in the ground frame
        again.
    """
    chain = _vision.frames_round_trip(
        np.asarray(pose, dtype=np.float64),
        np.asarray(tilt_rad, dtype=np.float64),
        height_m,
        _rows(points_a, "points_a", 3),
    )
    return dict(zip(("a", "b", "c", "d", "e", "camera", "back"), np.moveaxis(chain, 1, 0), strict=True))
