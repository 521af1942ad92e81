"""Cameras, their files, trackers: values, round trips, refusals; OpenCV's wheel beside the engine."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp import vision

needs_opencv = pytest.mark.skipif(not vision.available(), reason="built without OpenCV")

LENSES = {
    "pinhole": [],
    "radial_tangential": [-0.28, 0.09, 0.0008, -0.0005, -0.012],
    "fisheye": [-0.02, 0.006, -0.003, 0.0004],
}


def camera(lens: str = "pinhole") -> vision.Camera:
    return vision.Camera(640, 480, 420.0, 421.0, 318.0, 241.0, lens=lens, distortion=LENSES[lens])


@pytest.mark.crosscheck
@pytest.mark.parametrize("lens", list(LENSES))
def test_projects_as_opencv_does(lens: str) -> None:
    cv2 = pytest.importorskip("cv2")
    eye = camera(lens)
    points = np.random.default_rng(1).uniform([-0.6, -0.5, 0.9], [0.6, 0.5, 1.6], (200, 3))
    K, none = np.array([[420.0, 0.0, 318.0], [0.0, 421.0, 241.0], [0.0, 0.0, 1.0]]), np.zeros(3)
    k = np.array(LENSES[lens]) if LENSES[lens] else np.zeros(5)
    if lens == "fisheye":
        theirs, _ = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), none, none, K, k)
    else:
        theirs, _ = cv2.projectPoints(points, none, none, K, k)
    np.testing.assert_allclose(eye.project(points), theirs.reshape(-1, 2), atol=1e-9)


@pytest.mark.law
@pytest.mark.parametrize("lens", list(LENSES))
def test_rays_and_pixels(lens: str, tmp_path: Path) -> None:
    eye = camera(lens)
    pixels = np.random.default_rng(2).uniform([60, 60], [580, 420], (50, 2))
    np.testing.assert_allclose(eye.project(2.5 * eye.unproject(pixels)), pixels, atol=1e-9)
    assert np.isnan(eye.project([[0.0, 0.0, -1.0], [np.nan, 0.0, 1.0]])).all()
    assert np.isnan(eye.unproject([[np.inf, 0.0]])).all()
    path = tmp_path / "cam.toml"
    told = {"plane_band_m": 0.01, "plane_noise_cluster": 4.0, "max_tilt_rad": 1.0}
    depth = vision.DepthCamera((0.025, 0.0, 0.001), camera(), told)
    vision.save_camera(path, eye, depth=depth, heading_rad=0.3)
    back = vision.load_camera(path, size=(640, 480))
    again = pickle.loads(pickle.dumps(eye))
    for other in (back.camera, again):
        assert (other.width, other.fx, other.cy, other.lens) == (640, 420.0, 241.0, lens)
        assert list(other.distortion) == LENSES[lens]
    assert back.heading_rad == pytest.approx(0.3, abs=1e-15)
    assert back.depth is not None
    assert back.depth.plane_options == pytest.approx(told)
    with pytest.raises(ValueError, match="plane_options: band; plane_sigma_m, "):
        vision.save_camera(path, eye, depth=vision.DepthCamera(plane_options={"band": 1.0}))
    assert back.depth is not None
    assert back.depth.offset_m == (0.025, 0.0, 0.001)
    assert (back.width, back.height) == (640, 480)
    assert vision.depth_intrinsics(back).fx == 420.0


GOOD = """model = "pinhole"
width = 640
height = 480
fx = 525.0
fy = 525.0
cx = 319.5
cy = 239.5
"""


@pytest.mark.unit
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (GOOD.replace("525.0\nfy", "-1.0\nfy"), r"cam\.toml:4: fx: .*greater than 0"),
        (GOOD.replace("pinhole", "tele"), r"cam\.toml:1: model: 'tele'; pinhole, radial_tangential or fisheye"),
        (GOOD + "distortion = [0.1, 0.2]\n", r"cam\.toml:8: distortion: a pinhole lens has no number, got 2"),
        (GOOD.replace("cy = 239.5\n", ""), r"cam\.toml:1: cy: missing"),
        (GOOD + "focal = 3.0\n", r"cam\.toml:8: focal: unknown key"),
        (GOOD + "[depth]\noffset_m = [0.1]\n", r"cam\.toml:9: depth\.offset_m: three numbers expected, got one"),
        (GOOD + "[depth]\nplane_max_tilt_deg = 90.0\n", r"cam\.toml:9: depth\.plane_max_tilt_deg: .*less than 90"),
        (GOOD + "[depth]\nplane_noise_cluster = 0.5\n", r"cam\.toml:9: depth\.plane_noise_cluster: .*equal to 1"),
        (GOOD + "[depth]\nfx = 500.0\n", r"give all of width, height, fx, fy, cx and cy"),
        (GOOD.replace("pinhole", "fisheye") + "distortion = [-9.0, -9e9, 0.0, 0.0]\n", r"several rays share a pixel"),
        (GOOD.replace("=", "", 1), r"cam\.toml:1: not TOML"),
    ],
)
def test_a_camera_file_that_is_wrong_says_where(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "cam.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence):
        vision.load_camera(path)


@pytest.mark.unit
def test_a_camera_for_other_images(tmp_path: Path) -> None:
    path = tmp_path / "cam.toml"
    path.write_text(GOOD)
    with pytest.raises(ValueError, match="a camera of 640 x 480 pixels, but the images have 1280 x 720"):
        vision.load_camera(path, size=(1280, 720))
    with pytest.raises(ValueError, match="no such file"):
        vision.load_camera(tmp_path / "none.toml")


@pytest.mark.unit
def test_depth_images_become_points() -> None:
    small = vision.Camera(4, 3, 10.0, 10.0, 1.5, 1.0)
    depth = np.full((3, 4), np.nan)
    depth[1, 3], depth[0, 0] = 2.0, 0.0
    np.testing.assert_allclose(vision.DepthCamera(camera=small).points(depth), [[0.3, 0.0, 2.0]], rtol=1e-6)
    with pytest.raises(ValueError, match="depth: 5 x 3 pixels, but the depth camera is for 4 x 3"):
        vision.DepthCamera(camera=small).points(np.ones((3, 5)))
    with pytest.raises(ValueError, match="needs the depth camera's own"):
        vision.DepthCamera().points(depth)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: vision.Camera(0, 480, 1.0, 1.0, 0.0, 0.0), "width: 0"),
        (lambda: vision.Camera(640, 480, 1.0, np.nan, 0.0, 0.0), "fy: .*finite"),
        (lambda: vision.Camera(640, 480, 1.0, 1.0, 0.0, 0.0, lens="wide"), "lens: 'wide'"),
        (lambda: vision.Camera(640, 480, 1.0, 1.0, 0.0, 0.0, distortion=[1.0]), "distortion: 1 numbers"),
        (lambda: camera().project([[1.0, 2.0]]), "points_c: rows of three numbers"),
        (lambda: camera().unproject([[1.0, 2.0, 3.0]]), "pixels: rows of two numbers"),
    ],
)
def test_cameras_refuse(make, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()


@needs_opencv
@pytest.mark.unit
def test_trackers_refuse() -> None:
    with pytest.raises(ValueError, match="tracks: 0; 1 to 20000"):
        vision.FeatureTracker(64, 48, tracks=0)
    with pytest.raises(ValueError, match="speed: no such option of the tracker"):
        vision.FeatureTracker(64, 48, speed=3)
    with pytest.raises(ValueError, match="tracks: a whole number expected, got str"):
        vision.FeatureTracker(64, 48, tracks="many")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"tracks: a whole number expected, got 2\.5"):
        vision.FeatureTracker(64, 48, tracks=2.5)
    with pytest.raises(ValueError, match="quality: a number expected, got str"):
        vision.FeatureTracker(64, 48, quality="high")  # type: ignore[arg-type]
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=f"seed: a whole number from 0 on expected, got {seed}"):
            vision.EgoMotion(camera(), seed=seed)
    with pytest.raises(ValueError, match="max_gap_s: -1"):
        vision.EgoMotion(camera(), max_gap_s=-1.0)
    with pytest.raises(ValueError, match="depth_offset_m: three finite numbers"):
        vision.EgoMotion(camera(), depth_offset_m=[0.0, 1.0])
    tracker = vision.FeatureTracker(64, 48)
    good = np.random.default_rng(1).integers(0, 255, (48, 64), np.uint8)
    for wrong in (good.astype(np.float32), good[None], good[:, ::2], good.T[:, ::-1], [[1, 2]], None):
        with pytest.raises(ValueError, match="image: "):
            tracker.track(wrong)
    assert tracker.track(good).status is vision.FrameStatus.FIRST
    with pytest.raises(ValueError, match="predicted: one row per track"):
        tracker.track(good, predicted=np.zeros((1, 2)))
    with pytest.raises(ValueError, match="keep: one value per track"):
        tracker.prune([True])
    assert tracker.track(good[:40]).status is vision.FrameStatus.BAD_IMAGE
    # Rows that lie further apart than they are long are fine, and read where they lie.
    wide = np.zeros((48, 100), np.uint8)
    wide[:, :64] = good
    assert tracker.track(wide[:, :64]).status is vision.FrameStatus.REPEATED


@needs_opencv
@pytest.mark.law
def test_a_part_of_a_picture_moves_against_the_part() -> None:
    scene = sn.simulation.GroundScene(seed=3, texture_size=512)
    big = scene.render(vision.Camera(400, 300, 350.0, 350.0, 199.5, 149.5), (0.0, 0.0, 0.0))
    tracker = vision.FeatureTracker(320, 240, tracks=100)
    assert tracker.track(big[20:260, 30:350]).status is vision.FrameStatus.FIRST
    report = tracker.track(big[33:273, 23:343])  # moved 7 px to the left and 13 down: the picture goes the other way
    assert report.status is vision.FrameStatus.TRACKED
    tracks = tracker.tracks
    moved = tracks.age > 0
    assert moved.sum() > 60
    flow = (tracks.pixel - tracks.pixel_previous)[moved]
    np.testing.assert_allclose(np.median(flow, axis=0), [7.0, -13.0], atol=0.005)
    np.testing.assert_allclose(flow, [[7.0, -13.0]] * moved.sum(), atol=0.2)  # at the edges another mean is taken off
    kept = tracks.id[::2]
    tracker.prune(np.arange(len(tracks.id)) % 2 == 0)
    np.testing.assert_array_equal(tracker.tracks.id, kept)
    tracker.reset()
    assert len(tracker.tracks.id) == 0


PROGRAM = """
import {first}
import {second}
import numpy as np
import soopnav_cpp as sn
import cv2
image = np.random.default_rng(1).integers(0, 255, (120, 160), np.uint8)
image = cv2.GaussianBlur(image, (0, 0), 2.0)
tracker = sn.vision.FeatureTracker(160, 120, tracks=40)
tracker.track(image)
threads = cv2.getNumThreads()
report = tracker.track(np.roll(image, 3, axis=1))
corners = cv2.goodFeaturesToTrack(image, 40, 0.01, 5)
there, found, _ = cv2.calcOpticalFlowPyrLK(image, np.roll(image, 3, axis=1), corners, None)
flow = np.median((there - corners)[found.ravel() > 0].reshape(-1, 2), axis=0)
assert threads == cv2.getNumThreads()
print(report.followed > 20, bool(np.allclose(flow, [3, 0], atol=0.1)), round(report.median_flow_px, 1))
"""


@needs_opencv
@pytest.mark.install
@pytest.mark.parametrize("order", [("cv2", "soopnav_cpp"), ("soopnav_cpp", "cv2")])
def test_opencvs_wheel_in_the_same_process(order: tuple[str, str]) -> None:
    pytest.importorskip("cv2")
    program = PROGRAM.format(first=order[0], second=order[1])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "True", "3.0"]
