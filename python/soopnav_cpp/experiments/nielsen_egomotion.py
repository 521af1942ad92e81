"""A camera over the ground, from images to increments: nielsen 4.2 and Annex A, on rendered frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import erf

import numpy as np
import numpy.typing as npt

from soopnav_cpp import simulation, vision
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, below, experiment, style

Array = npt.NDArray[np.float64]

BLUE, RED, GREY = "tab:blue", "tab:red", "0.55"
RATE_HZ = 20.0
FRAMES = 41


@dataclass(frozen=True)
class Setup:
    """How a camera is carried, and what it sees.

    Attributes
    ----------
    step_m : float
        Between frames.
    fitted : bool
        The plane of each frame from a depth cloud of 30 000 points; otherwise the true one.
    disturbed : bool
        Motion blur over 30 % of each interval, boxes that move through the picture, points that are not the ground.
    """

    step_m: float
    fitted: bool
    disturbed: bool


TRUE_PLANE = Setup(0.020, False, False)
FITTED_PLANE = Setup(0.020, True, True)
FAST = Setup(0.080, True, True)  # 42 px between frames


@dataclass(frozen=True)
class Walk:
    """A walk of `FRAMES` frames: one row per increment, NaN where none was measured."""

    truth: Array  # poses, (FRAMES, 3)
    increments: Array
    errors: Array
    nees: Array
    height_error: Array  # height ratio by the tracks, less the true one, over its sigma
    inliers: Array
    statuses: list[str]


def camera() -> vision.Camera:
    """VGA, 63 degrees wide."""
    return vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


def _compose(pose: Array, increment: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy, turn = increment
    return np.array([pose[0] + c * dx - s * dy, pose[1] + s * dx + c * dy, pose[2] + turn])


def way(rng: np.random.Generator, step_m: float) -> tuple[Array, Array, Array]:
    """Poses, heights and tilts of a camera in a hand: 8 degrees of tilt, wobbling by a degree; it turns and bobs."""
    pose = np.zeros((FRAMES, 3))
    tilt = np.zeros((FRAMES, 2))
    height = np.ones(FRAMES)
    mean = np.deg2rad(8.0) * np.array([np.cos(a := rng.uniform(0.0, 2.0 * np.pi)), np.sin(a)])
    tilt[0], course, turn = mean, rng.uniform(-np.pi, np.pi), 0.0
    for k in range(1, FRAMES):
        course += 0.05 * rng.standard_normal()
        turn = 0.9 * turn + 0.003 * rng.standard_normal()
        pose[k] = _compose(pose[k - 1], np.array([step_m * np.cos(course), step_m * np.sin(course), turn]))
        tilt[k] = mean + 0.9 * (tilt[k - 1] - mean) + np.deg2rad(0.4) * rng.standard_normal(2)
        height[k] = 1.0 + 0.95 * (height[k - 1] - 1.0) + 0.002 * rng.standard_normal()
    return pose, height, tilt


def _boxes(pose: Array, number: int) -> list[simulation.GroundObject]:
    """Two boxes that move through the picture."""
    return [
        simulation.GroundObject(
            x_m=pose[0] + 0.35 * np.cos(2.5 * i + 0.1 * number),
            y_m=pose[1] + 0.25 * np.sin(2.5 * i + 0.1 * number),
            heading_rad=0.05 * number,
            length_m=0.25,
            width_m=0.2,
            height_m=0.03,
        )
        for i in range(2)
    ]


def walk(seed: int, setup: Setup) -> Walk:
    """Render a walk and follow it."""
    return picture(seed, setup)[0]


def picture(seed: int, setup: Setup) -> tuple[Walk, npt.NDArray[np.uint8], vision.Tracks, npt.NDArray[np.bool_]]:
    """A walk, its last image, the tracks on it and which of them agree."""
    rng = np.random.default_rng(seed)
    scene = simulation.GroundScene(seed=int(rng.integers(1 << 30)), texture_size=1024, texel_m=0.002)
    eye = camera()
    ego = vision.EgoMotion(eye, seed=int(rng.integers(1 << 30)))
    pose, height, tilt = way(rng, setup.step_m)
    rows = {name: np.full((FRAMES - 1, n), np.nan) for name, n in (("increments", 3), ("errors", 3))}
    nees, height_error, inliers = (np.full(FRAMES - 1, np.nan) for _ in range(3))
    statuses = []
    image = np.zeros((eye.height, eye.width), np.uint8)
    for k in range(FRAMES):
        boxes = _boxes(pose[k], k) if setup.disturbed else []
        towards = pose[min(k + 1, FRAMES - 1)] - pose[max(k - 1, 0)]
        blur = 0.075 * towards  # half of 30 % of the mean of two intervals
        image = scene.render(
            eye,
            tuple(pose[k] - blur) if setup.disturbed else tuple(pose[k]),
            height[k],
            tuple(tilt[k]),
            to_pose=tuple(pose[k] + blur) if setup.disturbed else None,
            blur_views=5,
            gain=1.0 + 0.02 * rng.standard_normal(),
            gradient=(0.2, -0.1),
            noise=2.0,
            objects=boxes,
            frame=k,
        )
        if setup.fitted:
            points = scene.depth_cloud(
                eye,
                tuple(pose[k]),
                height[k],
                tuple(tilt[k]),
                objects=boxes,
                hole_share=0.02,
                outlier_share=0.02,
                frame=k,
            )
            motion = ego.step(image, points=points, t_s=k / RATE_HZ)
        else:
            motion = ego.step(image, plane=scene.true_plane(height[k], tuple(tilt[k])), t_s=k / RATE_HZ)
        if k == 0:
            continue
        statuses.append(motion.status.name.lower())
        if not motion.ok:
            continue
        error = motion.increment - scene.increment(tuple(pose[k - 1]), tuple(pose[k]))
        rows["increments"][k - 1], rows["errors"][k - 1] = motion.increment, error
        nees[k - 1] = error @ np.linalg.solve(motion.covariance, error)
        ratio = height[k] / height[k - 1]
        height_error[k - 1] = (motion.height_ratio - motion.height_ratio_plane) / motion.height_ratio_sigma
        if not setup.fitted:
            height_error[k - 1] = (motion.height_ratio - ratio) / motion.height_ratio_sigma
        inliers[k - 1] = motion.inliers
    result = Walk(pose, rows["increments"], rows["errors"], nees, height_error, inliers, statuses)
    return result, image, ego.tracks, ego.inliers


def rms_mm(walks: list[Walk]) -> float:
    """RMS of the displacement's error, pooled [mm]."""
    errors = np.concatenate([w.errors[:, :2] for w in walks])
    return float(1e3 * np.sqrt(np.nanmean(np.sum(errors**2, axis=1))))


def mean_nees(walks: list[Walk]) -> float:
    """Mean NEES per number, pooled: 1 for a covariance that is right."""
    return float(np.nanmean(np.concatenate([w.nees for w in walks])) / 3.0)


def measured_share(walks: list[Walk]) -> float:
    """Share of the increments that were measured."""
    return float(np.mean([status == "measured" for w in walks for status in w.statuses]))


def _draw(lab: Lab, kinds: dict[str, list[Walk]], seed: int) -> None:
    shown, image, tracks, agree = picture(seed, FITTED_PLANE)
    with lab.figure(11.0, 4.2) as figure:
        left, middle, right = figure.subplots(1, 3, width_ratios=(1.35, 1.0, 1.0))
        left.imshow(image, cmap="gray", vmin=0, vmax=255)
        lived = tracks.age > 0
        for chosen, colour, label in (
            (lived & agree, "tab:green", "agree"),
            (lived & ~agree, RED, "do not"),
        ):
            start, end = tracks.pixel_previous[chosen], tracks.pixel[chosen]
            left.plot(*np.stack([start, end, np.full_like(end, np.nan)], 1).reshape(-1, 2).T, color=colour, lw=1.2)
            left.plot(*end.T, ".", color=colour, ms=3, label=label)
        left.set_xlim(-0.5, image.shape[1] - 0.5)
        left.set_ylim(image.shape[0] - 0.5, -0.5)
        left.legend(loc="lower left", fontsize=7, framealpha=0.9)
        style(left, "Tracks, picture blurred, boxes moving", "u [px]", "v [px]")
        left.grid(False)
        pose = shown.truth[0]
        path = [pose]
        for increment in shown.increments:
            path.append(_compose(path[-1], np.nan_to_num(increment)))
        middle.plot(*shown.truth[:, :2].T, color=RED, lw=3.0, alpha=0.5, label="truth")
        middle.plot(*np.array(path)[:, :2].T, color=BLUE, lw=1.0, label="increments, summed")
        middle.set_aspect("equal", adjustable="datalim")
        middle.legend(fontsize=7)
        off = 1e3 * float(np.hypot(*(path[-1] - shown.truth[-1])[:2]))
        style(middle, f"Sum of {FRAMES - 1}: {off:.2f} mm off", "x [m]", "y [m]")
        for (name, walks), colour in zip(kinds.items(), (BLUE, "tab:orange", "tab:purple"), strict=True):
            values = np.sort(np.concatenate([w.nees for w in walks]))
            values = values[np.isfinite(values)]
            right.plot(values, np.arange(1, len(values) + 1) / len(values), color=colour, label=name)
        x = np.linspace(0.0, 14.0, 200)
        # Distribution of chi squared with three degrees of freedom.
        law = [erf(np.sqrt(v / 2.0)) - np.sqrt(2.0 * v / np.pi) * np.exp(-v / 2.0) for v in x]
        right.plot(x, law, "--", color=GREY, label="χ², 3 degrees")
        right.set_xlim(0.0, 14.0)
        right.legend(fontsize=7, loc="lower right")
        style(right, "NEES of increments", "NEES", "share below")


@experiment(
    "nielsen-egomotion",
    title="Motion of a camera over the ground, from images",
    runs=8,
    source="nielsen section 4.2, Annex A",
)
def ego_motion(lab: Lab) -> Iterator[Claim]:
    kinds: dict[str, list[Walk]] = {
        "true plane, 20 mm": lab.map(walk, TRUE_PLANE),
        "fitted, 20 mm": lab.map(walk, FITTED_PLANE),
        "fitted, 80 mm": lab.map(walk, FAST, runs=4),
    }
    true, fitted, fast = kinds.values()
    _draw(lab, kinds, int(lab.rng("picture").integers(1 << 30)))
    data: dict[str, Array] = {
        f"{name}_{field}": np.concatenate([getattr(w, field) for w in walks])
        for name, walks in zip(("true", "fitted", "fast"), kinds.values(), strict=True)
        for field in ("errors", "nees", "height_error", "inliers")
    }
    lab.save(part="", **data)
    yield Claim("increments measured: 20 mm steps, tilt 8°", measured_share(true), at_least(1.0))
    yield Claim("RMS of an increment with the true plane [mm]", rms_mm(true), below(0.02))
    yield Claim("NEES per number with the true plane", mean_nees(true), band(0.7, 1.5))
    yield Claim(
        "increments measured with blur, boxes moving and the plane fitted", measured_share(fitted), at_least(1.0)
    )
    yield Claim("RMS of an increment with the fitted plane [mm]", rms_mm(fitted), below(0.25))
    yield Claim("NEES per number with the fitted plane", mean_nees(fitted), band(0.7, 1.5))
    yield Claim("increments measured at 42 px between frames, blurred", measured_share(fast), at_least(1.0))
    yield Claim("RMS of those [mm]", rms_mm(fast), at_most(0.25))
    turns = np.concatenate([w.errors[:, 2] for w in fitted])
    yield Claim("RMS of the turn, fitted plane [°]", float(np.rad2deg(np.sqrt(np.nanmean(turns**2)))), below(0.01))
    for name, walks in (("true", true), ("fitted", fitted)):
        checks = np.concatenate([w.height_error for w in walks])
        yield Claim(
            f"height check 1/√(C² + S²) with the {name} plane: RMS over its sigma",
            float(np.sqrt(np.nanmean(checks**2))),
            band(0.6, 1.5),
        )
    drift = [float(np.hypot(*np.nansum(w.errors[:, :2], axis=0))) for w in fitted]
    alone = np.mean([np.sqrt(np.nansum(w.errors[:, :2] ** 2)) for w in fitted])
    yield Claim(
        "foot errors of neighbouring increments cancel: sum over a walk against independent ones",
        float(np.sqrt(np.mean(np.square(drift))) / alone),
        below(0.4),
    )
