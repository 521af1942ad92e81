"""``soopnav egomotion``: from a video of the ground to a trajectory of the camera."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import estimation, io, plotting, vision
from soopnav_cpp._core.vision import GroundPlane
from soopnav_cpp._walk import Walk
from soopnav_cpp.cli import text
from soopnav_cpp.cli.page import page, table
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.scenarios.files import read_truth
from soopnav_cpp.scenarios.poses import read_poses, rotations
from soopnav_cpp.scenarios.writers import write_table

__all__ = ["Ground", "Result", "as_json", "follow", "print_result", "sentence", "write_report"]

Array = npt.NDArray[np.float64]
_MOST_PICTURES = 4
_MOST_ROWS = 8
_FEW = 100  # frames of a video that does not say how many it has
_TRACK_WIDTH = 640  # of the video of tracks: larger frames are drawn smaller
_GIF_WIDTH = 320  # which has no compression worth the name
_LEAP_S = 2.0  # between frames, beyond which a time stamp is doubted; of slow series as many
_LEAP_FRAMES = 20  # frames
_BELIEVED = 3  # doubted stamps in a row that rise among themselves


@dataclass(frozen=True)
class Ground:
    """Where the ground is: a folder of depth, or a plane that is held.

    Attributes
    ----------
    depth : Path or None
    height_m : float or None
        Of the camera above the ground.
    tilt_x_deg, tilt_y_deg : float
        Of the camera (nielsen's a_x, a_y).
    """

    depth: Path | None = None
    height_m: float | None = None
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0


class Picture(NamedTuple):
    """A frame with its tracks and its motion, kept for the report."""

    number: int  # the video's own
    t_s: float
    motion: Any
    image: npt.NDArray[np.uint8]
    tracks: plotting.FrameTracks


@dataclass(eq=False)
class Result:
    """Increments of all frames and the walk that they add up to.

    Attributes
    ----------
    video : Video
    camera : Camera
    ground : Ground
    motions : list of PlanarMotion
        One per frame.
    walk : Walk
    truth : ndarray, shape (n, 3), or None
        x, y, heading at the frames; NaN where the truth has nothing.
    errors : ndarray, shape (n, 3), or None
        Of the increments, where both are known.
    nees : ndarray, shape (n,), or None
    pictures : list of Picture
    warnings : list of str
    """

    video: io.Video
    camera: Any
    ground: Ground
    motions: list[Any]
    walk: Walk
    truth: Array | None = None
    errors: Array | None = None
    nees: Array | None = None
    pictures: list[Picture] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """Frames with an increment."""
        return np.array([motion.ok for motion in self.motions], dtype=np.bool_)

    @property
    def statuses(self) -> Counter[str]:
        """How often each status came."""
        return Counter(word(motion.status) for motion in self.motions)


def word(status: Any) -> str:
    """A status as a word: ``too_few_tracks``."""
    return str(getattr(status, "name", status)).lower()


def _truth_at(path: Path, t_s: Array) -> Array:
    """x, y and heading at the frames; NaN outside of the file."""
    if path.suffix.lower() == ".tum":
        poses = read_poses(path)
        time, place = poses.t_s, poses.position_m[:, :2]
        first = rotations(poses.quaternion_wxyz)[:, :, 0]
        heading = np.arctan2(first[:, 1], first[:, 0])
    else:
        _check_columns(path)
        given = read_truth(path)
        if given.heading_rad is None:
            raise ValueError(f"{path}: heading_rad: a column of headings expected, from x towards y")
        time, place, heading = given.t_s, given.position_m[:, :2], given.heading_rad
    inside = (t_s >= time[0] - 1e-6) & (t_s <= time[-1] + 1e-6)
    if not inside.any():
        raise ValueError(
            f"{path}: times {time[0]:g} … {time[-1]:g} s, but the video has {t_s[0]:g} … {t_s[-1]:g} s; times of the "
            "same clock expected (--start)"
        )
    turned = np.unwrap(heading)
    found = np.column_stack([np.interp(t_s, time, column) for column in (place[:, 0], place[:, 1], turned)])
    found[~inside] = np.nan
    return found


def _check_columns(path: Path) -> None:
    if path.is_dir():
        raise ValueError(f"{path}: a folder; a file expected")


def _relative(from_pose: Array, to_pose: Array) -> Array:
    """The increment between poses in axes of the first, shape (3,)."""
    c, s = math.cos(from_pose[2]), math.sin(from_pose[2])
    dx, dy = to_pose[:2] - from_pose[:2]
    turn = math.remainder(float(to_pose[2] - from_pose[2]), 2.0 * math.pi)
    return np.array([c * dx + s * dy, -s * dx + c * dy, turn])


def _compare(result: Result) -> None:
    """Errors and NEES of each increment against the truth's."""
    assert result.truth is not None
    n = len(result.motions)
    result.errors, result.nees = np.full((n, 3), np.nan), np.full(n, np.nan)
    for k, since in enumerate(result.walk.since):
        motion = result.motions[k]
        if since < 0 or not np.isfinite(result.truth[[since, k]]).all():
            continue
        error = np.asarray(motion.increment) - _relative(result.truth[since], result.truth[k])
        error[2] = math.remainder(float(error[2]), 2.0 * math.pi)
        result.errors[k] = error
        covariance = np.asarray(motion.covariance)
        if np.linalg.eigvalsh(covariance)[0] > 0.0:
            result.nees[k] = float(error @ np.linalg.solve(covariance, error))


class _Depth:
    """Plane of each frame: of its depth, or one that is held."""

    def __init__(self, ground: Ground, file: vision.CameraFile, rate_hz: float, first_s: float | None) -> None:
        self._folder = None
        self._first_s = first_s
        self._within_s = 0.6 / rate_hz
        self._missing = 0
        self._found = False
        self._asked_s = (math.inf, -math.inf)
        self.warnings: list[str] = []
        if ground.depth is not None:
            self._folder = io.read_depth(ground.depth, camera=None if file.depth is None else file.depth.camera)
        else:
            assert ground.height_m is not None  # the command saw to it
            self._plane = GroundPlane.from_tilt(
                math.radians(ground.tilt_x_deg), math.radians(ground.tilt_y_deg), ground.height_m
            )

    def of(self, number: int, t_s: float) -> dict[str, Any]:
        """What `EgoMotion.step` is to be told about the ground at a frame of that number and time."""
        if self._folder is None:
            return {"plane": self._plane}
        self._asked_s = min(self._asked_s[0], t_s), max(self._asked_s[1], t_s)
        i = self._folder.index_of(number, t_s, within_s=self._within_s, first_s=self._first_s)
        if i is None:
            self._missing += 1
            return {"points": np.empty((0, 3), np.float32)}
        self._found = True
        try:
            return {"points": self._folder.points(i)}
        except io.VideoError as error:
            if len(self.warnings) < _MOST_ROWS:
                self.warnings.append(str(error))
            return {"points": np.empty((0, 3), np.float32)}

    def close(self) -> None:
        """Say what was missing.

        Raises
        ------
        ValueError
            Where both have times and no frame had any depth.
        """
        folder, first_s = self._folder, self._first_s
        if folder is not None and folder.t_s is not None and folder.first_s is not None and first_s is not None:
            has = f"{folder.first_s:.6f} … {folder.first_s + folder.t_s[-1]:.6f} s"
            asked = f"{first_s + self._asked_s[0]:.6f} … {first_s + self._asked_s[1]:.6f} s"
            if not self._found:
                raise ValueError(
                    f"{folder.folder}: depth of {has}, but the frames are of {asked}; names that are times of one "
                    "clock expected"
                )
        if self._missing:
            self.warnings.append(f"{self._missing} frames without a depth frame")


class _Clock:
    """Which time stamps can be used: those that rise, without a leap that the next ones do not follow."""

    def __init__(self, rate_hz: float) -> None:
        self._leap_s = max(_LEAP_S, _LEAP_FRAMES / rate_hz)
        self._used = 0
        self._last_s = math.nan
        self._doubted_s = math.nan
        self._in_a_row = 0
        self.left_out = 0

    def _follows(self, t_s: float, last_s: float) -> bool:
        return last_s < t_s <= last_s + self._leap_s

    def take(self, t_s: float) -> bool:
        """Whether to use the frame; `anew` tells whether everything before it is to be forgotten."""
        self.anew = False
        if self._used and not self._follows(t_s, self._last_s):
            self._in_a_row = self._in_a_row + 1 if self._follows(t_s, self._doubted_s) else 1
            self._doubted_s = t_s
            self.anew = t_s < self._last_s and self._used == 1  # it was the first stamp that was wrong
            if self._in_a_row < _BELIEVED or not (t_s > self._last_s or self.anew):
                self.left_out += 1
                self.anew = False
                return False
        elif not math.isfinite(t_s):
            self.left_out += 1
            return False
        self._used = 1 if self.anew else self._used + 1
        self.left_out += self.anew
        self._last_s, self._doubted_s, self._in_a_row = t_s, math.nan, 0
        return True


def _spread(count: int) -> set[int]:
    """Numbers of frames to show, of so many."""
    return set(np.linspace(min(1, count - 1), count - 1, _MOST_PICTURES).round().astype(int).tolist())


def _frames(video: io.Video, every: int, most: int | None) -> Iterator[io.Frame]:
    taken = 0
    for frame in video:
        if frame.number % every:
            continue
        if most is not None and taken >= most:
            return
        taken += 1
        yield frame


def follow(
    path: Path,
    camera_path: Path,
    ground: Ground,
    *,
    truth: Path | None,
    rate_hz: float | None,
    start_s: float,
    every: int,
    most: int | None,
    features: int | None,
    seed: int,
    tracks_path: Path | None,
    step: Steps,
) -> Result:
    """Read a video frame by frame and follow the ground in it.

    Raises
    ------
    ValueError
        For files that cannot be read, a camera of another size, a truth without a time in common.
    """
    if not vision.available():
        raise ValueError("egomotion needs OpenCV, and this build of soopnav is without it (SOOPNAV_WITH_OPENCV)")
    file = vision.load_camera(camera_path)
    camera = file.camera
    video = io.read_video(path, rate_hz=rate_hz)
    if (video.width, video.height) != (camera.width, camera.height):
        raise ValueError(
            f"{camera_path}: a camera of {camera.width}×{camera.height}, but {path} has frames of "
            f"{video.width}×{video.height}"
        )
    depth = _Depth(ground, file, video.rate_hz / every, video.first_s)
    ego = vision.EgoMotion(file, features=features, seed=seed)  # with what the file says of the depth camera
    walk = Walk()
    motions: list[Any] = []
    pictures: list[Picture] = []
    warnings: list[str] = []
    total = math.ceil(video.frames / every) or None
    keep = _spread(min(total or _FEW, most or _FEW * every))
    width = _GIF_WIDTH if tracks_path is not None and tracks_path.suffix.lower() == ".gif" else _TRACK_WIDTH
    clock = _Clock(video.rate_hz / every)

    def drawn() -> Iterator[npt.NDArray[np.uint8]]:
        """Follow frame by frame, and give each with its tracks where a video of them is wanted."""
        nonlocal walk
        for k, frame in enumerate(_frames(video, every, most)):
            if k % 10 == 0:
                step(f"following {path.name}", done=k, total=total if most is None else min(total or most, most))
            if frame.image.shape != (camera.height, camera.width):
                warnings.append(f"frame {frame.number}: {frame.image.shape[1]}×{frame.image.shape[0]}, left out")
                continue
            t_s = frame.t_s + start_s
            if not clock.take(t_s):
                continue
            if clock.anew:
                ego.reset()
                walk = Walk()
                motions.clear()
                pictures.clear()
            motion = ego.step(frame.image, t_s=t_s, **depth.of(frame.number, frame.t_s))
            motions.append(motion)
            walk.add(motion, t_s)
            if k in keep or tracks_path is not None:
                tracks = plotting.FrameTracks.of(ego)
                if k in keep:
                    pictures.append(Picture(frame.number, t_s, motion, frame.image.copy(), tracks))
                if tracks_path is not None:
                    yield plotting.draw_tracks(frame.image, tracks, label=_label(t_s, motion), width=width)
        if not motions:
            raise ValueError(f"{path}: no frame in it that can be used")
        depth.close()

    if tracks_path is None:
        for _ in drawn():
            pass
    else:
        tracks_path.parent.mkdir(parents=True, exist_ok=True)
        try:
            io.write_video(tracks_path, drawn(), rate_hz=max(1.0, video.rate_hz / every))
        except ValueError:
            if tracks_path.is_file():
                tracks_path.unlink()  # what is begun is no video
            raise
    if clock.left_out:
        warnings.append(f"{clock.left_out} frames whose time does not follow that of the frame before: left out")
    if video.problem:
        warnings.append(video.problem)
    result = Result(video, camera, ground, motions, walk, pictures=pictures, warnings=[*warnings, *depth.warnings])
    walk.begin(0, [0.0, 0.0, file.heading_rad])
    if truth is not None:
        result.truth = _truth_at(truth, walk.t_s)
        known = np.flatnonzero(np.isfinite(result.truth).all(axis=1))
        walk.begin(known[0], result.truth[known[0]])
        _compare(result)
    return result


def _label(t_s: float, motion: Any) -> str:
    dx, dy, turn = np.asarray(motion.increment)
    if not motion.ok:
        return f"{t_s:.2f} s  {word(motion.status)}"
    return (
        f"{t_s:.2f} s  {1e3 * dx:+.1f} {1e3 * dy:+.1f} mm {math.degrees(turn):+.2f} deg  {motion.inliers}/{motion.used}"
    )


def sentence(result: Result) -> str:
    """The outcome in one."""
    good, walk = int(result.measured.sum()), result.walk
    said = (
        f"{good} of {max(1, len(result.motions) - 1)} increments measured; {text.metres(walk.length_m)} in "
        f"{text.duration(float(walk.t_s[-1] - walk.t_s[0]))}"
    )
    if result.errors is not None and result.truth is not None:
        end = result.walk.pose[-1, :2] - result.truth[-1, :2]
        if np.isfinite(end).all():
            said += f", {text.metres(float(np.hypot(*end)))} off at the end"
    return f"{said}."


def _numbers(result: Result) -> dict[str, Any]:
    """What is said of the increments as a whole."""
    good = result.measured
    increments = np.array([m.increment for m in result.motions])[good]
    sigma = np.sqrt(np.array([np.diagonal(m.covariance) for m in result.motions])[good]).reshape(-1, 3)
    numbers: dict[str, Any] = {
        "frames": len(result.motions),
        "measured": int(good.sum()),
        "statuses": dict(result.statuses),
        "length_m": result.walk.length_m,
        "duration_s": float(result.walk.t_s[-1] - result.walk.t_s[0]),
        "bridged_s": result.walk.bridged_s,
        "end_pose": result.walk.pose[-1].tolist(),
        "end_sigma": np.sqrt(np.diagonal(result.walk.covariance[-1])).tolist(),
    }
    if len(increments):
        numbers |= {
            "step_rms_m": float(np.sqrt(np.mean(np.sum(increments[:, :2] ** 2, axis=1)))),
            "stated_sigma": np.sqrt(np.mean(sigma**2, axis=0)).tolist(),
            "tracks_median": float(np.median([m.tracks for m in result.motions if m.ok])),
            "inlier_share_median": float(np.median([m.inliers / max(1, m.used) for m in result.motions if m.ok])),
            "height_median_m": float(np.median([m.height_m for m in result.motions if m.ok])),
        }
    if result.errors is not None and result.nees is not None and result.truth is not None:
        known, told = np.isfinite(result.errors[:, 0]), np.isfinite(result.nees)
        if known.any():
            numbers["error_rms"] = np.sqrt(np.mean(result.errors[known] ** 2, axis=0)).tolist()
        if told.any():
            low, high = estimation.mean_nees_bounds(3, int(told.sum()), failure_probability=0.01)
            numbers["nees"] = {"mean": float(np.mean(result.nees[told])), "n": int(told.sum()), "bounds": [low, high]}
        away = result.walk.pose - result.truth
        away[:, 2] = np.remainder(away[:, 2] + math.pi, 2.0 * math.pi) - math.pi
        seen = np.isfinite(away[:, 0])
        if seen.any():
            numbers["position_rms_m"] = float(np.sqrt(np.mean(np.sum(away[seen, :2] ** 2, axis=1))))
            numbers["end_error"] = away[np.flatnonzero(seen)[-1]].tolist()
    return numbers


def as_json(result: Result) -> dict[str, Any]:
    """Facts for a program."""
    return {"video": str(result.video.path), **_numbers(result), "warnings": result.warnings}


def _rows(result: Result) -> list[tuple[str, str]]:
    """Names and values, as they are printed and shown."""
    n = _numbers(result)
    rows = [
        ("frames", f"{n['frames']} of {result.video.width}×{result.video.height} at {result.video.rate_hz:g} Hz"),
        ("measured", f"{n['measured']} increments"),
    ]
    others = [
        f"{count} {name.replace('_', ' ')}" for name, count in result.statuses.most_common() if name != "measured"
    ]
    if others:
        rows.append(("others", ", ".join(others)))
    rows.append(("way", f"{n['length_m']:.3f} m in {n['duration_s']:.2f} s"))
    if n["bridged_s"]:
        rows.append(("bridged", f"{n['bridged_s']:.2f} s without an increment: moved on as before"))
    x, y, a = n["end_pose"]
    sx, sy, sa = n["end_sigma"]
    rows.append(("end", f"x {x:+.4f} ± {sx:.4f} m, y {y:+.4f} ± {sy:.4f} m, heading {math.degrees(a):+.3f}° ± "
                        f"{math.degrees(sa):.3f}°"))  # fmt: skip
    if "step_rms_m" in n:
        s = n["stated_sigma"]
        rows += [
            ("tracks", f"{n['tracks_median']:.0f} in the median frame, {100.0 * n['inlier_share_median']:.0f} % agree"),
            ("height", f"{n['height_median_m']:.4f} m"),
            ("step", f"{1e3 * n['step_rms_m']:.2f} mm RMS"),
            ("stated", f"σ {1e3 * s[0]:.3f} mm, {1e3 * s[1]:.3f} mm, {math.degrees(s[2]):.4f}° per increment"),
        ]
    if "error_rms" in n:
        e = n["error_rms"]
        rows.append(("error", f"RMS {1e3 * e[0]:.3f} mm, {1e3 * e[1]:.3f} mm, {math.degrees(e[2]):.4f}° per increment"))
    if "nees" in n:
        low, high = n["nees"]["bounds"]
        rows.append(("NEES", f"mean {n['nees']['mean']:.2f} over {n['nees']['n']} increments; 3 is right, "
                             f"{low:.2f} … {high:.2f} of 99 %"))  # fmt: skip
    if "position_rms_m" in n:
        e = n["end_error"]
        rows.append(("position", f"RMS {n['position_rms_m']:.4f} m from the truth; at the end {e[0]:+.4f} m, "
                                 f"{e[1]:+.4f} m, {math.degrees(e[2]):+.3f}°"))  # fmt: skip
    return rows


def print_result(result: Result, console: Console) -> None:
    """The table and what should be known."""
    console.print(sentence(result))
    grid = Table(box=None, show_header=False, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    for name, value in _rows(result):
        grid.add_row(name, value)
    console.print(grid)
    for warning in result.warnings:
        console.print(f"warning: {warning}", markup=False, highlight=False)


def _write_increments(result: Result, path: Path) -> None:
    names = ("xx", "xy", "xa", "yy", "ya", "aa")
    upper = np.triu_indices(3)
    columns = ["time_s", "status", "dx_m", "dy_m", "da_rad", *(f"covariance_{n}" for n in names), "tracks", "used",
               "inliers", "rms_px", "height_m", "height_ratio"]  # fmt: skip
    checked = result.errors is not None and result.nees is not None
    if checked:
        columns += ["error_dx_m", "error_dy_m", "error_da_rad", "nees"]
    rows = []
    for k, (t_s, motion) in enumerate(zip(result.walk.t_s, result.motions, strict=True)):
        row: list[object] = [f"{t_s:.6f}", word(motion.status)]
        if motion.ok:
            row += [f"{v:.9f}" for v in motion.increment]
            row += [f"{v:.6e}" for v in np.asarray(motion.covariance)[upper]]
        else:
            row += [""] * 9
        row += [motion.tracks, motion.used, motion.inliers, f"{motion.rms_px:.4f}", f"{motion.height_m:.6f}",
                f"{motion.height_ratio:.6f}"]  # fmt: skip
        if checked:
            assert result.errors is not None
            assert result.nees is not None
            values = [*result.errors[k], result.nees[k]]
            row += ["" if not math.isfinite(v) else f"{v:.9g}" for v in values]
        rows.append(row)
    write_table(path, columns, rows)


def _write_trajectory(result: Result, folder: Path) -> None:
    walk = result.walk
    half = 0.5 * walk.pose[:, 2]
    nothing = np.zeros(len(half))
    tum = np.column_stack([walk.t_s, walk.pose[:, :2], nothing, nothing, nothing, np.sin(half), np.cos(half)])
    np.savetxt(folder / "trajectory.tum", tum, fmt=["%.9f", "%.6f", "%.6f", "%.6f", "%.9f", "%.9f", "%.9f", "%.9f"])
    sigma = np.sqrt(np.maximum(np.diagonal(walk.covariance, axis1=1, axis2=2), 0.0))
    columns = ["time_s", "position_x_m", "position_y_m", "heading_rad", "sigma_x_m", "sigma_y_m", "sigma_heading_rad"]
    with (folder / "trajectory.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for t_s, pose, deviation in zip(walk.t_s, walk.pose, sigma, strict=True):
            writer.writerow([f"{t_s:.6f}", *(f"{v:.9f}" for v in pose), *(f"{v:.9f}" for v in deviation)])


def write_report(result: Result, folder: Path) -> Path:
    """Trajectory, increments, frames with their tracks, figures, metrics and the page that shows them."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_trajectory(result, folder)
    _write_increments(result, folder / "increments.csv")
    (folder / "metrics.json").write_text(json.dumps(as_json(result), indent=2, allow_nan=False) + "\n", "utf-8")
    pictures = []
    plotting.ground_track(result.walk, truth=result.truth, path=folder / "walk.png")
    pictures.append(("Where the camera went, with 95 % ellipses", folder / "walk.png"))
    plotting.increments(result.walk.t_s, result.motions, errors=result.errors, path=folder / "increments.png")
    pictures.append(("Increments over time, and how many tracks agree", folder / "increments.png"))
    for one in result.pictures:
        path = folder / f"frame_{one.number:05d}.png"
        plotting.save_picture(plotting.draw_tracks(one.image, one.tracks, label=_label(one.t_s, one.motion)), path)
        pictures.append((f"Frame {one.number} at {one.t_s:.2f} s: tracks that agree are green, others red", path))
    report = folder / "report.html"
    content = page(
        f"Ego-motion from {result.video.path.name}",
        under=f"{len(result.motions)} frames, {result.video.width}×{result.video.height}",
        lead=sentence(result),
        notes=result.warnings,
        tables=[("Numbers", table(["quantity", "value"], [("", [name, value]) for name, value in _rows(result)]))],
        pictures=pictures,
        foot="Increments are in axes of the previous body: image right, image up, turn counterclockwise from above.",
    )
    report.write_text(content, encoding="utf-8")
    return report
