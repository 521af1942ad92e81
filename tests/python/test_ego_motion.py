"""Increments of a camera over rendered ground: the bars, bad input of every kind, real frames."""

from __future__ import annotations

import importlib
import math
from pathlib import Path

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp import vision
from soopnav_cpp.experiments import nielsen_egomotion as walks
from soopnav_cpp.vision import FrameStatus, MotionStatus

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "captures" / "vision"

pytestmark = pytest.mark.skipif(not vision.available(), reason="built without OpenCV")

EYE = vision.Camera(320, 240, 262.0, 262.0, 159.5, 119.5)
PLANE = vision.GroundPlane.from_tilt(0.05, -0.03, 1.0)
STEP = (0.02, 0.005, 0.004)


def pose_after(k: float) -> tuple[float, float, float]:
    return (STEP[0] * k, STEP[1] * k, STEP[2] * k)


class Floor:
    """Frames of a camera that goes on steadily; each is drawn once."""

    def __init__(self) -> None:
        self.scene = sn.simulation.GroundScene(seed=5, texture_size=512, texel_m=0.004)
        self._frames: dict[float, np.ndarray] = {}

    def frame(self, k: float) -> np.ndarray:
        if k not in self._frames:
            self._frames[k] = self.draw(k)
        return self._frames[k]

    def draw(self, k: float, **options) -> np.ndarray:
        options = {"noise": 1.0, "frame": int(k)} | options
        return self.scene.render(EYE, pose_after(k), 1.0, (0.05, -0.03), **options)

    def points(self, k: int, **options) -> np.ndarray:
        return self.scene.depth_cloud(EYE, pose_after(k), 1.0, (0.05, -0.03), points=3000, frame=k, **options)

    def truth(self, a: float, b: float) -> np.ndarray:
        return self.scene.increment(pose_after(a), pose_after(b))


@pytest.fixture(scope="module")
def floor() -> Floor:
    return Floor()


def ego(**options) -> vision.EgoMotion:
    return vision.EgoMotion(EYE, features=120, **options)


def started(floor: Floor, frames: int = 4) -> vision.EgoMotion:
    camera = ego()
    for k in range(frames):
        motion = camera.step(floor.frame(k), plane=PLANE, t_s=0.05 * k)
    assert motion.ok
    return camera


def close(motion, truth: np.ndarray, mm: float = 0.2) -> None:
    assert motion.ok, motion
    assert np.hypot(*(motion.increment - truth)[:2]) < 1e-3 * mm, motion
    assert abs(motion.increment[2] - truth[2]) < 1e-3


@pytest.mark.consistency
@pytest.mark.parametrize(
    ("setup", "bar_mm"), [(walks.TRUE_PLANE, 0.02), (walks.FITTED_PLANE, 0.25), (walks.FAST, 0.25)]
)
def test_increments_hold_their_bars(setup: walks.Setup, bar_mm: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walks, "FRAMES", 9)
    walk = walks.walk(11, setup)
    assert set(walk.statuses) == {"measured"}
    assert walks.rms_mm([walk]) < bar_mm
    assert 0.2 < walks.mean_nees([walk]) < 3.0  # eight increments; pooled it is 0.7 to 1.5


@pytest.mark.unit
def test_increments_follow_one_another(floor: Floor) -> None:
    camera = ego()
    first = camera.step(floor.frame(0), plane=PLANE)
    assert first.status is MotionStatus.FIRST
    assert first.dt_s == 0.0
    second = camera.step(floor.frame(1), plane=PLANE)
    close(second, floor.truth(0, 1))
    assert second.dt_s == pytest.approx(0.05)
    assert second.height_m == pytest.approx(1.0)
    assert second.height_ratio == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_array_equal(second.covariance, second.track_covariance)  # the plane is known
    third = camera.step(floor.frame(2), points=floor.points(2))
    close(third, floor.truth(1, 2), 2.0)
    assert np.linalg.eigvalsh(third.covariance - third.track_covariance)[-1] > 1e-10
    assert camera.frame.start is vision.FlowStart.PREDICTION
    assert len(camera.inliers) == len(camera.tracks.id)
    assert camera.inliers.sum() == third.inliers
    assert "measured" in repr(third)


@pytest.mark.law
def test_the_same_frames_give_the_same_bits(floor: Floor) -> None:
    runs = []
    for _ in range(2):
        camera = ego(seed=3)
        runs.append([camera.step(floor.frame(k), points=floor.points(k), t_s=0.05 * k).increment for k in range(4)])
    np.testing.assert_array_equal(*runs)


@pytest.mark.unit
def test_repeated_and_dropped_frames_and_bad_times(floor: Floor) -> None:
    camera = started(floor)
    for motion in (
        camera.step(floor.frame(3), plane=PLANE, t_s=0.2),  # the same picture, later
        camera.step(floor.frame(4), plane=PLANE, t_s=0.2),  # another picture at the same time
    ):
        assert motion.status is MotionStatus.REPEATED
        assert motion.dt_s == 0.0
        assert not motion.increment.any()
    for t_s in (0.1, math.nan):
        assert camera.step(floor.frame(4), plane=PLANE, t_s=t_s).status is MotionStatus.BAD_TIME
    late = camera.step(floor.frame(7), plane=PLANE, t_s=0.35)
    close(late, floor.truth(3, 7))
    assert late.dt_s == pytest.approx(0.2)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("spoil", "status"),
    [
        (lambda image: np.zeros_like(image), FrameStatus.DARK),
        (lambda image: np.full_like(image, 255), FrameStatus.SATURATED),
        (lambda image: np.full_like(image, 128), FrameStatus.FLAT),
        (lambda image: np.tile(image.mean(0).astype(np.uint8), (len(image), 1)), None),
    ],
)
def test_frames_without_corners_are_stepped_over(floor: Floor, spoil, status) -> None:
    camera = started(floor)
    for k in (4, 5):
        motion = camera.step(np.ascontiguousarray(spoil(floor.frame(k)) + np.uint8(k % 2)), plane=PLANE, t_s=0.05 * k)
        assert not motion.ok
        assert motion.dt_s == 0.0
        if status is not None and k == 4:
            assert camera.frame.status is status
            assert motion.status is MotionStatus.BAD_IMAGE
    motion = camera.step(floor.frame(6), plane=PLANE, t_s=0.3)
    close(motion, floor.truth(3, 6))
    assert motion.dt_s == pytest.approx(0.15)
    assert motion.skipped == 2


@pytest.mark.unit
def test_blur_is_told_or_followed(floor: Floor) -> None:
    camera = started(floor)
    image = floor.draw(4, to_pose=pose_after(8), blur_views=12)  # 20 pixels long
    motion = camera.step(image, plane=PLANE, t_s=0.2)
    assert camera.frame.sharpness < 0.6
    if motion.ok:  # the middle of the exposure
        error = motion.increment - floor.truth(3, 6)
        assert np.sqrt(error @ np.linalg.solve(motion.covariance, error)) < 30.0
        return
    close(camera.step(floor.frame(8), plane=PLANE, t_s=0.4), floor.truth(3, 8))


@pytest.mark.unit
def test_nothing_seen_for_seconds_coasts(floor: Floor) -> None:
    camera = started(floor)
    sum_s, at, variances = 0.0, np.zeros(2), 0.0
    rng = np.random.default_rng(1)
    for k in range(4, 64):
        dark = rng.integers(0, 3, floor.frame(0).shape, np.uint8)
        motion = camera.step(dark, plane=PLANE, t_s=0.05 * k)
        assert motion.status is (MotionStatus.BAD_IMAGE if motion.dt_s == 0.0 else MotionStatus.COASTED)
        assert np.isfinite(motion.increment).all()
        assert np.linalg.eigvalsh(motion.covariance)[0] >= 0.0
        sum_s += motion.dt_s
        at += motion.increment[:2]
        variances += motion.covariance[0, 0]
    assert sum_s == pytest.approx(3.0)
    velocity = np.array(STEP[:2]) / 0.05
    assert np.hypot(*at) == pytest.approx(np.hypot(*velocity) * (1.0 - math.exp(-3.0)), rel=0.03)
    assert math.sqrt(variances) == pytest.approx(1.5 * 3.0, rel=1e-6)
    again = camera.step(floor.frame(64), plane=PLANE, t_s=3.2)
    assert again.status is MotionStatus.COASTED
    motion = camera.step(floor.frame(65), plane=PLANE, t_s=3.25)
    close(motion, floor.truth(64, 65))
    assert motion.dt_s == pytest.approx(0.05)


@pytest.mark.unit
@pytest.mark.parametrize("bad", [2, 3, 4])
def test_what_a_coast_covers_is_not_measured_again(floor: Floor, bad: int) -> None:
    # Frames 0.2 s apart: it coasts before the tracker gives the last good frame up.
    camera, at = ego(), 0.0
    for k in range(8 + bad):
        dark = 4 <= k < 4 + bad
        image = np.full_like(floor.frame(0), k % 2) if dark else floor.frame(k)
        motion = camera.step(image, plane=PLANE, t_s=0.2 * k)
        at += motion.dt_s
        if motion.ok:  # from where the last one ended
            close(motion, floor.truth(round((at - motion.dt_s) / 0.2), k))
    assert motion.ok
    assert motion.dt_s == pytest.approx(0.2)
    assert at == pytest.approx(0.2 * (7 + bad))


@pytest.mark.unit
def test_one_time_far_away_is_forgotten(floor: Floor) -> None:
    camera = started(floor)
    for t_s in (1e6, -1e6, 2e6, 1e6):
        motion = camera.step(floor.frame(4), plane=PLANE, t_s=t_s)
        assert motion.status is MotionStatus.BAD_TIME
        assert motion.dt_s == 0.0
    for k in (5, 6):
        motion = camera.step(floor.frame(k), plane=PLANE, t_s=0.05 * k)
        close(motion, floor.truth(3 if k == 5 else 5, k))
    assert motion.dt_s == pytest.approx(0.05)


@pytest.mark.unit
def test_a_clock_that_was_set_is_believed_at_the_third_frame(floor: Floor) -> None:
    camera = started(floor)
    for start_s, status in ((1000.0, MotionStatus.COASTED), (-500.0, MotionStatus.FIRST)):
        motions = [camera.step(floor.frame(k), plane=PLANE, t_s=start_s + 0.05 * k) for k in range(4, 8)]
        assert [m.status for m in motions] == [MotionStatus.BAD_TIME] * 2 + [status, MotionStatus.MEASURED]
        close(motions[-1], floor.truth(6, 7))
        assert motions[-1].dt_s == pytest.approx(0.05)
        if status is MotionStatus.COASTED:
            assert motions[2].dt_s == pytest.approx(1000.0 + 0.3 - 0.15)
            assert motions[2].covariance[0, 0] > 1000.0**2


@pytest.mark.unit
def test_a_sensor_of_ones_own_is_described_by_plane_options(floor: Floor) -> None:
    def plane(points: np.ndarray, **options: float) -> vision.GroundPlane:
        camera = ego(**options)
        camera.step(floor.frame(0), points=points, t_s=0.0)
        return camera.plane

    leaning = vision.GroundPlane.from_tilt(1.0, 0.0, 1.0)
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.4, 0.4, 40))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    steep = rays * (leaning.distance_m / (rays @ leaning.normal_c))[:, None]
    assert plane(steep).status is vision.PlaneStatus.WALL
    assert plane(steep, plane_max_tilt_rad=1.2).ok
    cloud = floor.points(0)
    usual = plane(cloud)
    alike = plane(cloud, plane_noise_cluster=4.0)
    np.testing.assert_allclose(alike.covariance, 4.0 * usual.covariance)
    assert plane(cloud, plane_band_m=0.001).inliers < 0.7 * usual.inliers
    assert plane(cloud, plane_band_sigmas=1.0).inliers < 0.8 * usual.inliers
    assert plane(cloud, plane_min_points=3001).status is vision.PlaneStatus.TOO_FEW


@pytest.mark.unit
def test_depth_without_ground_only_lengthens_the_interval(floor: Floor) -> None:
    camera = started(floor)
    nothing = np.full((2000, 3), np.nan, np.float32)
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(0.5, 2.0, 50))
    wall = np.column_stack([np.full(y.size, 0.4), y.ravel(), z.ravel()]).astype(np.float32)
    for k, points in ((4, nothing), (5, wall), (6, np.empty((0, 3), np.float32))):
        motion = camera.step(floor.frame(k), points=points, t_s=0.05 * k)
        assert motion.status is MotionStatus.NO_PLANE, camera.plane
        assert motion.dt_s == 0.0
    motion = camera.step(floor.frame(7), plane=PLANE, t_s=0.35)
    close(motion, floor.truth(3, 7))
    assert motion.skipped == 3


@pytest.mark.unit
def test_heights_that_disagree_are_told(floor: Floor) -> None:
    camera = started(floor)
    wrong = vision.GroundPlane.from_tilt(0.05, -0.03, 1.1)
    motion = camera.step(floor.frame(4), plane=wrong, t_s=0.2)
    assert motion.status in (MotionStatus.HEIGHT_DISAGREEMENT, MotionStatus.NO_CONSENSUS)
    close(camera.step(floor.frame(5), plane=PLANE, t_s=0.25), floor.truth(3, 5))


def _with_sheet(floor: Floor, k: int, share: float, moved: int) -> np.ndarray:
    """A sheet on the floor over `share` of the picture that slides by three steps per frame in the other direction."""
    here, there = floor.frame(k), floor.draw(k - 4 * moved, frame=900 + k)
    width = int(share * here.shape[1])
    return np.ascontiguousarray(np.concatenate([there[:, :width], here[:, width:]], axis=1))


@pytest.mark.unit
def test_a_floor_that_starts_to_move(floor: Floor) -> None:
    camera = started(floor, 5)
    # Two thirds of the picture slide: the majority tells another motion, the rest moves on as before.
    motions = [camera.step(_with_sheet(floor, k, 0.65, k - 4), plane=PLANE, t_s=0.05 * k) for k in (5, 6)]
    assert any(motion.rival_share > 0.3 for motion in motions), motions
    for k, motion in zip((5, 6), motions, strict=True):
        if motion.ok:
            close(motion, floor.truth(k - 1, k) if motion.dt_s < 0.06 else floor.truth(k - 2, k), 1.0)
    # A minority that moves changes nothing.
    camera = started(floor, 5)
    close(camera.step(_with_sheet(floor, 5, 0.3, 1), plane=PLANE, t_s=0.25), floor.truth(4, 5), 0.5)


@pytest.mark.unit
def test_what_a_step_refuses(floor: Floor) -> None:
    camera = ego()
    image = floor.frame(0)
    with pytest.raises(ValueError, match="plane, points: give one of them"):
        camera.step(image)
    with pytest.raises(ValueError, match="plane, points: give one of them"):
        camera.step(image, plane=PLANE, points=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="image: 640 x 480 pixels, but the camera is for 320 x 240"):
        camera.step(np.zeros((480, 640), np.uint8), plane=PLANE)
    for wrong in (image.astype(np.float64), np.stack([image] * 3, -1), image[:, ::-1]):
        with pytest.raises(ValueError, match="image: "):
            camera.step(wrong, plane=PLANE)
    with pytest.raises(ValueError, match="points: rows of three numbers"):
        camera.step(image, points=np.zeros((5, 2)))
    assert camera.step(image, plane=PLANE).status is MotionStatus.FIRST
    camera.reset()
    assert camera.step(image, plane=PLANE).status is MotionStatus.FIRST


@pytest.mark.offair
@pytest.mark.slow
@pytest.mark.crosscheck
@pytest.mark.skipif(not (FOLDER / "static_camera").exists(), reason="the recording in ../shared is not there")
def test_a_resting_camera_rests() -> None:
    av = pytest.importorskip("av")
    eye = vision.Camera(768, 576, 768.0, 768.0, 383.5, 287.5)
    camera, plane = vision.EgoMotion(eye), vision.GroundPlane.known([0.0, 0.0, 1.0], 1.0)
    pose, steps = np.zeros(3), []
    with av.open(str(FOLDER / "static_camera" / "vtest.avi")) as video:
        for k, frame in enumerate(video.decode(video=0)):
            motion = camera.step(frame.to_ndarray(format="gray"), plane=plane, t_s=0.1 * k)
            assert k == 0 or motion.ok
            steps.append(768.0 * motion.increment[:2])
            c, s = math.cos(pose[2]), math.sin(pose[2])
            dx, dy, turn = motion.increment
            pose += [c * dx - s * dy, s * dx + c * dy, turn]
    assert len(steps) == 795
    assert np.sqrt(np.mean(np.sum(np.square(steps), axis=1))) < 0.02
    assert 768.0 * np.hypot(*pose[:2]) < 1.0


def _photo(path: Path) -> tuple[np.ndarray, float, float, np.ndarray]:
    """The strip of ground in it at a fifth of the size, gimbal yaw, height, east and north."""
    image = importlib.import_module("PIL.Image")
    with image.open(path) as photo:
        gps = photo.getexif().get_ifd(0x8825)
        grey = photo.convert("L").resize((800, 450), image.Resampling.BOX)
    data = path.read_bytes()

    def tag(name: bytes) -> float:
        return float(data.split(b"drone-dji:" + name + b'="', 1)[1].split(b'"', 1)[0])

    degrees = [float(v[0]) + float(v[1]) / 60.0 + float(v[2]) / 3600.0 for v in (gps[2], gps[4])]
    place = 6.371e6 * np.radians([-degrees[1] * math.cos(math.radians(46.84)), degrees[0]])  # here, west longitude
    return np.ascontiguousarray(np.asarray(grey)[:, 590:]), tag(b"GimbalYawDegree"), tag(b"RelativeAltitude"), place


@pytest.mark.offair
@pytest.mark.crosscheck
@pytest.mark.skipif(not (FOLDER / "drone_nadir").exists(), reason="the photographs in ../shared are not there")
def test_photographs_of_a_drone() -> None:
    pytest.importorskip("PIL")
    photos = [_photo(FOLDER / "drone_nadir" / f"DJI_00{n}.JPG") for n in (18, 19, 20)]
    # The lens sees 94 degrees across the diagonal of 5000 pixels. Only the strip beside the wood is ground.
    f = 2500.0 / math.tan(math.radians(47.0)) / 5.0
    eye = vision.Camera(210, 450, f, f, 399.5 - 590.0, 224.5)
    camera = vision.EgoMotion(eye, max_height_m=100.0, height_tolerance=0.05)
    for k, (image, _, height, place) in enumerate(photos):
        plane = vision.GroundPlane.known([0.0, 0.0, 1.0], photos[0][2])
        motion = camera.step(image, plane=plane, t_s=7.0 * k)
        assert height == pytest.approx(photos[0][2], abs=0.5)
        if k == 0:
            continue
        assert motion.ok, motion
        moved = place - photos[k - 1][3]
        assert 0.9 < np.hypot(*motion.increment[:2]) / np.hypot(*moved) < 1.1
        # The body's first axis is the picture's right: the yaw is the picture's up, clockwise from north.
        right, up = motion.increment[:2]
        bearing = photos[k - 1][1] + math.degrees(math.atan2(right, up))
        gps = math.degrees(math.atan2(moved[0], moved[1]))
        assert abs(math.remainder(bearing - gps, 360.0)) < 3.0
