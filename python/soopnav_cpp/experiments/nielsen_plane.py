"""Planes of the ground from a depth camera (nielsen 4.1, 4.2.1): tilt, height, the RGB camera, frames a … f."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.vision import Camera, GroundPlane
from soopnav_cpp._ground import fit_plane, ground_points, nielsen_frames
from soopnav_cpp._ground_scene import GroundObject, GroundScene
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_most, band, experiment, style

__all__ = ["DEPTH_CAMERA", "OFFSET_M", "one_cloud"]

Array = npt.NDArray[np.float64]

DEPTH_CAMERA = Camera(640, 480, 575.0, 575.0, 319.5, 239.5)
RGB_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
OFFSET_M = 0.025  # nielsen's D_cam: the RGB camera along x of the infrared one
SHARES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
PIXELS = np.stack(np.meshgrid([60.0, 320.0, 580.0], [60.0, 240.0, 420.0]), axis=-1).reshape(-1, 2)


def _angle_deg(a: Array, b: Array) -> float:
    return math.degrees(math.asin(min(1.0, float(np.linalg.norm(np.cross(a, b))))))


def _errors(plane: GroundPlane, truth: GroundPlane) -> tuple[float, float, float]:
    """Of the tilt [deg], of the height [m], and the NEES of three."""
    if not plane.ok:
        return math.nan, math.nan, math.nan
    error = np.append(plane.axes_c[:2] @ (plane.normal_c - truth.normal_c), plane.distance_m - truth.distance_m)
    nees = float(error @ np.linalg.solve(plane.covariance, error))
    return _angle_deg(plane.normal_c, truth.normal_c), float(error[2]), nees


def one_cloud(seed: int) -> dict[str, Array]:
    """One pose: 30 000 clean points, and clouds of which a share is not the ground; both methods on each."""
    rng = np.random.default_rng(seed)
    tilt = (float(rng.uniform(-0.17, 0.17)), float(rng.uniform(-0.17, 0.17)))
    height = float(rng.uniform(0.7, 1.5))
    pose = (float(rng.uniform(-5, 5)), float(rng.uniform(-5, 5)), float(rng.uniform(-np.pi, np.pi)))
    truth = GroundScene.true_plane(height, tilt)  # of the RGB camera
    infrared = truth.seen_from([-OFFSET_M, 0.0, 0.0])
    scene = GroundScene(seed=seed % (1 << 63), texture_size=64)
    rows = []
    planes: dict[str, GroundPlane] = {}
    for k, share in enumerate(SHARES):
        box = GroundObject(pose[0] + 0.2, pose[1], 0.0, 0.2, 0.25, height_m=0.25)
        cloud = scene.depth_cloud(
            DEPTH_CAMERA,
            pose,
            height,
            tilt,
            sensor_p_c=(-OFFSET_M, 0.0, 0.0),
            outlier_share=share,
            objects=[box] if share > 0.0 else [],
            frame=k,
        )
        for method in ("svd", "ransac"):
            plane = fit_plane(cloud, method=method, max_tilt_rad=1.4, seed=k)
            rows.append(_errors(plane, infrared))
            planes[f"{method}-{share}"] = plane
    best = planes["ransac-0.3"]
    rgb = best.seen_from([OFFSET_M, 0.0, 0.0])
    feature = ground_points(rgb, RGB_CAMERA, PIXELS) - ground_points(truth, RGB_CAMERA, PIXELS)
    points = np.column_stack([rng.uniform(-9, 9, (20, 2)), np.zeros(20)])
    chain = nielsen_frames(pose, tilt, height, points)
    A, B, C, _ = truth.nielsen_abcd
    a_x, a_y = tilt
    printed = np.array([-math.sin(a_y) * math.cos(a_x), math.sin(a_x), -math.cos(a_y) * math.cos(a_x)])
    return {
        "errors": np.array(rows).reshape(len(SHARES), 2, 3),
        "offset": np.array(
            [
                rgb.distance_m - truth.distance_m,
                best.distance_m - truth.distance_m,
                infrared.normal_c[0] * OFFSET_M,
                planes["ransac-0.0"].covariance[2, 2] ** 0.5,
            ]
        ),
        "feature": feature,
        "chain": np.array(
            [
                np.abs(chain["back"] - chain["a"]).max(),
                np.abs(chain["camera"] @ truth.normal_c - truth.distance_m).max(),
                np.abs(chain["d"][:, 2] - height).max(),
                np.abs(np.array([A, B, C]) + printed).max(),
            ]
        ),
    }


def _draw(lab: Lab, errors: Array) -> None:
    scene = GroundScene(seed=7, texture_size=64)
    tilt = (0.06, -0.12)
    box = GroundObject(0.25, 0.0, 0.0, 0.25, 0.3, height_m=0.25)
    cloud = scene.depth_cloud(DEPTH_CAMERA, (0, 0, 0), 1.0, tilt, outlier_share=0.05, objects=[box])
    strip = cloud[np.abs(cloud[:, 1]) < 0.02]
    with lab.figure(11.4, 4.2) as figure:
        axes = figure.add_subplot(1, 3, 1)
        axes.plot(strip[:, 0], strip[:, 2], ".", ms=2.0, color="0.6", label="points, |y| < 2 cm")
        x = np.array([-0.62, 0.62])
        for method, color, label in (("svd", "#d1495b", "SVD"), ("ransac", "#1b6ca8", "RANSAC")):
            plane = fit_plane(cloud, method=method, max_tilt_rad=1.4)
            n = plane.normal_c
            axes.plot(x, (plane.distance_m - n[0] * x) / n[2], color=color, lw=1.4, label=label)
        axes.invert_yaxis()
        axes.legend(frameon=False, fontsize=8.5, loc="upper right")
        style(axes, "Cut through a cloud with a box", "x [m]", "depth z [m]")
        axes = figure.add_subplot(1, 3, 2)
        for column, color, label in ((0, "#d1495b", "SVD"), (1, "#1b6ca8", "RANSAC")):
            middle = np.median(errors[:, :, column, 0], axis=0)
            low, high = np.quantile(errors[:, :, column, 0], [0.05, 0.95], axis=0)
            axes.fill_between(SHARES, low, high, color=color, alpha=0.2, lw=0)
            axes.semilogy(SHARES, middle, "o-", color=color, ms=3.5, lw=1.2, label=f"{label}, median and 90 %")
        axes.set_ylim(5e-4, 60)
        axes.legend(frameon=False, fontsize=8.5, loc="center right")
        style(axes, "Tilt, 30 000 points", "share of outliers (and a box)", "error [deg]")
        axes = figure.add_subplot(1, 3, 3)
        for column, color, label in ((0, "#d1495b", "SVD, clean"), (1, "#1b6ca8", "RANSAC, clean")):
            axes.plot(
                np.sort(1e3 * np.abs(errors[:, 0, column, 1])),
                (np.arange(len(errors)) + 0.5) / len(errors),
                color=color,
                lw=1.4,
                label=label,
            )
        axes.plot(
            np.sort(1e3 * np.abs(errors[:, 5, 1, 1])),
            (np.arange(len(errors)) + 0.5) / len(errors),
            color="#1b6ca8",
            lw=1.2,
            ls="--",
            label="RANSAC, 30 % outliers",
        )
        axes.set_xlim(left=0)
        axes.set_ylim(0, 1)
        axes.legend(frameon=False, fontsize=8.5, loc="lower right")
        style(axes, "Height", "error [mm]", "share of clouds")


@experiment(
    "nielsen-plane",
    title="Plane of the ground from 30 000 points",
    source="nielsen sections 4.1 and 4.2.1",
    runs=200,
)
def plane(lab: Lab) -> Iterator[Claim]:
    """SVD and RANSAC against truth, the step to the RGB camera, and the chain of frames."""
    results = lab.map(one_cloud)
    errors = np.array([result["errors"] for result in results])  # run, share, method, [deg, m, NEES]
    offset = np.array([result["offset"] for result in results])
    chain = np.array([result["chain"] for result in results]).max(axis=0)
    feature = np.array([result["feature"] for result in results])
    _draw(lab, errors)
    lab.save(outlier_share=SHARES, errors=errors, offset=offset, feature_error_m=feature, chain=chain)
    rms = np.sqrt(np.mean(errors[..., :2] ** 2, axis=0))
    yield Claim("tilt by SVD from clean points, rms", rms[0, 0, 0], at_most(0.01, "deg"))
    yield Claim("height by SVD from clean points, rms", 1e3 * rms[0, 0, 1], at_most(0.05, "mm"))
    yield Claim("tilt by RANSAC from clean points, rms", rms[0, 1, 0], at_most(0.01, "deg"))
    yield Claim("tilt by RANSAC, 2 … 50 % outliers and a box: greatest rms", rms[1:, 1, 0].max(), at_most(0.02, "deg"))
    yield Claim("height by RANSAC, 30 % outliers and a box, rms", 1e3 * rms[5, 1, 1], at_most(0.1, "mm"))
    yield Claim(
        "SVD with 5 % outliers and a box: median tilt",
        np.median(errors[:, 2, 0, 0]),
        above(1.0, "deg"),
    )
    yield Claim(
        "NEES of tilt and height by RANSAC from clean points, mean (3)", errors[:, 0, 1, 2].mean(), band(2.3, 4.1)
    )
    yield Claim(
        "height of the RGB camera after D + A D_cam, rms",
        1e3 * math.sqrt(float(np.mean(offset[:, 0] ** 2))),
        at_most(0.1, "mm"),
    )
    slope = float((offset[:, 1] * offset[:, 2]).sum() / (offset[:, 2] ** 2).sum())
    yield Claim("without that step the height is off by A D_cam: slope", slope, band(0.98, 1.02))
    yield Claim(
        "feature points on the ground, 30 % outliers in the cloud, rms per axis",
        1e3 * math.sqrt(float(np.mean(feature**2))),
        at_most(0.3, "mm"),
    )
    yield Claim("frames a … f and back, greatest difference", chain[0], at_most(1e-11, "m"))
    yield Claim(
        "ground points through the chain lie on n · p = d, and on z_d = h", chain[1:3].max(), at_most(1e-11, "m")
    )
    yield Claim("[A B C] with C positive is the negative of the printed n_e", chain[3], at_most(1e-12))
