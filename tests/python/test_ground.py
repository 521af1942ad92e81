"""Planes of the ground and its rendering, seen from Python: truth against what comes out."""

from __future__ import annotations

import math

import numpy as np
import pytest

import soopnav_cpp as sn
from soopnav_cpp.simulation import GroundObject, GroundScene
from soopnav_cpp.vision import fit_plane, ground_pixels, ground_points, to_present_axes, to_previous_axes

pytestmark = pytest.mark.unit

SMALL = sn.vision.Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
BENT = sn.vision.Camera(
    160, 120, 131.0, 131.0, 80.0, 58.0, lens="radial_tangential", distortion=[-0.2, 0.05, 1e-3, -5e-4, 0.0]
)
FISHEYE = sn.vision.Camera(160, 120, 72.0, 72.0, 79.0, 60.0, lens="fisheye", distortion=[-0.02, 0.005, 0.0, 0.0])


@pytest.fixture(scope="module")
def scene() -> GroundScene:
    return GroundScene(seed=3, texture_size=512, texel_m=0.002, finest_texels=8)


@pytest.mark.parametrize("camera", [SMALL, BENT, FISHEYE], ids=["pinhole", "bent", "fisheye"])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.12, -0.2)])
def test_each_pixel_shows_the_ground_that_its_ray_meets(scene, camera, tilt):
    # Near enough that a pixel is finer than the texture's detail: no mip level is blended in.
    pose, height = (1.3, -0.7, 2.4), 0.9 if camera.fx > 100 else 0.4
    image = scene.render(camera, pose, height, tilt)
    pixels = np.array([[10, 12], [150, 8], [80, 60], [33, 101], [120, 95]])
    points = ground_points(scene.true_plane(height, tilt), camera, pixels)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ground = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    expected = [255 * scene.brightness(x, y) for x, y in ground]
    np.testing.assert_allclose(image[pixels[:, 1], pixels[:, 0]], expected, atol=0.6)
    assert image.std() > 15


def test_the_camera_may_stand_anywhere_and_turn(scene):
    # A quarter turn of a square image is the image turned: the sign of the heading.
    square = sn.vision.Camera(101, 101, 110.0, 110.0, 50.0, 50.0)
    still = scene.render(square, (0.4, 0.2, 0.0))
    turned = scene.render(square, (0.4, 0.2, math.pi / 2))
    # Counterclockwise from above the image's content turns clockwise.
    assert np.abs(turned.astype(int) - np.rot90(still, -1)).max() <= 1
    period = 512 * 0.002
    far = scene.render(square, (0.4 + 1000 * period, 0.2, 0.0))
    assert np.abs(far.astype(int) - still).max() <= 1


def test_points_and_pixels_go_round():
    plane = GroundScene.true_plane(1.2, (0.1, -0.15))
    pixels = np.array([[0.0, 0.0], [100.0, 50.0], [159.0, 119.0]])
    np.testing.assert_allclose(ground_pixels(plane, BENT, ground_points(plane, BENT, pixels)), pixels, atol=1e-6)
    assert (
        np.isnan(ground_points(GroundScene.true_plane(1.0, (1.3, 0.0)), SMALL, [[80.0, 0.0], [80.0, 119.0]])).sum() == 2
    )
    step = np.array([0.02, -0.03, 0.4])
    np.testing.assert_allclose(to_previous_axes(to_present_axes(step)), step, atol=1e-15)


def test_increments_are_in_axes_of_the_previous_body():
    # Heading along ground y, a step along ground y is a step ahead.
    step = GroundScene.increment((1.0, 1.0, math.pi / 2), (1.0, 1.5, math.pi))
    np.testing.assert_allclose(step, [0.5, 0.0, math.pi / 2], atol=1e-12)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.14, -0.1)])
def test_a_cloud_gives_the_true_plane_back(scene, tilt):
    truth = scene.true_plane(1.1, tilt)
    cloud = scene.depth_cloud(SMALL, (0.2, 0.1, 0.3), 1.1, tilt, hole_share=0.1, outlier_share=0.15, frame=5)
    assert cloud.dtype == np.float32
    assert cloud.shape == (30000, 3)
    assert 0.08 < np.isnan(cloud[:, 0]).mean() < 0.12
    plane = fit_plane(cloud)
    assert plane.ok
    error = np.append(plane.axes_c[:2] @ (plane.normal_c - truth.normal_c), plane.distance_m - truth.distance_m)
    nees = error @ np.linalg.solve(plane.covariance, error)
    assert nees < 25  # chi-square of three: 1e-5
    assert np.sqrt(plane.covariance[0, 0]) < 1e-4
    # Nothing of the noise: every point lies on the plane.
    exact = scene.depth_cloud(SMALL, (0.2, 0.1, 0.3), 1.1, tilt, points=500, sigma_m=0, sigma_per_m=0)
    np.testing.assert_allclose(exact @ truth.normal_c, truth.distance_m, atol=1e-6)


def test_the_sensor_beside_the_camera_sees_its_own_plane(scene):
    # nielsen's D -> D + A D_cam: the RGB camera sits at +D_cam of the infrared one.
    offset = np.array([0.025, 0.0, 0.0])
    tilt = (0.05, 0.2)
    cloud = scene.depth_cloud(SMALL, (0, 0, 0), 1.0, tilt, sensor_p_c=-offset, sigma_m=1e-5, sigma_per_m=0.0)
    infrared = fit_plane(cloud)
    assert abs(infrared.distance_m - 1.0) > 4e-3
    rgb = infrared.seen_from(offset)
    assert abs(rgb.distance_m - 1.0) < 2e-6
    a, _, _, d = infrared.nielsen_abcd
    assert rgb.nielsen_abcd[3] == pytest.approx(d + a * 0.025, abs=1e-15)


def test_boxes_walls_and_sheets_are_seen_by_the_right_sensor(scene):
    box = GroundObject(0.0, 0.0, 0.3, 0.4, 0.3, height_m=0.25, brightness=0.0)
    sheet = GroundObject(0.0, 0.0, 0.0, 0.5, 0.5, height_m=0.0, brightness=0.0)
    empty = scene.depth_cloud(SMALL, (0, 0, 0), sigma_m=0, sigma_per_m=0)
    with_box = scene.depth_cloud(SMALL, (0, 0, 0), sigma_m=0, sigma_per_m=0, objects=[box])
    assert set(np.round(with_box[:, 2], 5)) == {np.float32(0.75), np.float32(1.0)}
    # A box of 0.4 x 0.3 m at 0.75 m, seen by rays of a known solid grid.
    share = np.mean(with_box[:, 2] < 0.9)
    assert share == pytest.approx(0.12 / 0.75**2 / (160 * 120 / 131**2), rel=0.05)
    same = scene.depth_cloud(SMALL, (0, 0, 0), sigma_m=0, sigma_per_m=0, objects=[sheet])
    np.testing.assert_array_equal(same, empty)
    picture = scene.render(SMALL, (0, 0, 0), objects=[sheet])
    assert np.mean(picture == 0) == pytest.approx(0.25 / (160 * 120 / 131**2), rel=0.02)
    assert scene.render(SMALL, (0, 0, 0), objects=[sheet.moved(9.0, 0.0)]).min() > 0
    wall = (0.3, 0.0, 0.0)
    walled = scene.depth_cloud(SMALL, (0, 0, 0), sigma_m=0, sigma_per_m=0, wall=wall)
    hit = walled[:, 2] < 0.999
    np.testing.assert_allclose(walled[hit, 0], 0.3, atol=1e-6)
    assert 0.2 < hit.mean() < 0.35
    facing = fit_plane(scene.depth_cloud(SMALL, (0, 0, 0), 1.0, (0.0, 0.5), wall=(-0.1, 0.0, 0.0)))
    assert facing.status.name == "WALL"
    assert not facing.ok
    assert (scene.render(SMALL, (0, 0, 0), wall=wall) != scene.render(SMALL, (0, 0, 0))).mean() > 0.15


def test_light_lens_and_sensor(scene):
    plain = scene.render(SMALL, (0, 0, 0)).astype(float)
    brighter = scene.render(SMALL, (0, 0, 0), gain=1.1, offset=0.05).astype(float)
    inside = (plain > 5) & (brighter < 250)
    np.testing.assert_allclose(brighter[inside], 1.1 * plain[inside] + 12.75, atol=1.2)
    slope = scene.render(SMALL, (0, 0, 0), gradient=(0.4, -0.2)).astype(float)
    assert slope[60, 0] == pytest.approx(0.8 * plain[60, 0], abs=1.5)
    assert slope[0, 80] == pytest.approx(1.1 * plain[0, 80], abs=1.5)
    noisy = [scene.render(SMALL, (0, 0, 0), noise=3.0, frame=k).astype(float) for k in (1, 1, 2)]
    np.testing.assert_array_equal(noisy[0], noisy[1])
    middle = (plain > 15) & (plain < 240)
    assert (noisy[0] - plain)[middle].std() == pytest.approx(3.0, rel=0.06)
    assert (noisy[0] - noisy[2])[middle].std() == pytest.approx(3.0 * math.sqrt(2), rel=0.06)
    soft = scene.render(SMALL, (0, 0, 0), defocus_px=2.0).astype(float)
    assert np.diff(soft, axis=1).std() < 0.5 * np.diff(plain, axis=1).std()
    assert soft.mean() == pytest.approx(plain.mean(), abs=1.5)
    moving = scene.render(SMALL, (0, 0, 0), to_pose=(0.04, 0.0, 0.0), blur_views=9).astype(float)
    assert np.diff(moving, axis=1).std() < 0.6 * np.diff(plain, axis=1).std()
    assert np.diff(moving, axis=0).std() > 0.6 * np.diff(plain, axis=0).std()
    views = [scene.render(SMALL, (0.04 * k / 8, 0, 0)).astype(float) for k in range(9)]
    np.testing.assert_allclose(moving, np.mean(views, axis=0), atol=1.0)


def test_same_seed_same_bits_and_another_seed_other_ground(scene):
    again = GroundScene(seed=3, texture_size=512, texel_m=0.002, finest_texels=8)
    other = GroundScene(seed=4, texture_size=512, texel_m=0.002, finest_texels=8)
    first = scene.render(SMALL, (0, 0, 0), noise=1.0)
    np.testing.assert_array_equal(first, again.render(SMALL, (0, 0, 0), noise=1.0))
    assert (first != other.render(SMALL, (0, 0, 0), noise=1.0)).mean() > 0.9


def test_high_above_the_ground_nothing_aliases(scene):
    # Neighbouring heights show nearly the same picture although pixels pass by texels: mip levels.
    fine = GroundScene(seed=5, texture_size=1024, texel_m=0.001)
    low, high = (fine.render(SMALL, (0, 0, 0), h).astype(float) for h in (6.0, 6.06))
    assert np.corrcoef(low[40:80, 60:100].ravel(), high[40:80, 60:100].ravel())[0, 1] > 0.9


@pytest.mark.consistency
def test_tracks_without_images_give_increments_that_their_covariance_covers():
    estimator = sn.vision.RigidMotionEstimator()
    camera = sn.vision.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    rng = np.random.default_rng(8)
    nees = []
    for k in range(80):
        before, now = rng.uniform(-0.14, 0.14, (2, 2))
        pose = (1.0, 2.0, 0.7)
        to = (1.0 + 0.02 * rng.normal(), 2.0 + 0.02 * rng.normal(), 0.7 + 0.02 * rng.normal())
        pixels = sn.simulation.foot_tracks(
            camera, pose, to, previous_tilt_rad=before, tilt_rad=now, tracks=150, outlier_share=0.2, seed=k
        )
        planes = GroundScene.true_plane(1.0, before), GroundScene.true_plane(1.0, now)
        motion = estimator.estimate(camera, *pixels, *planes)
        assert motion.ok
        assert 95 <= motion.inliers <= 145
        error = motion.increment - GroundScene.increment(pose, to)
        assert np.abs(error[:2]).max() < 1e-4
        nees.append(error @ np.linalg.solve(motion.covariance, error))
    assert 1.95 < np.mean(nees) < 4.4  # chi-square of 240: 1e-5


def test_frames_without_common_ground_have_no_tracks():
    with pytest.raises(ValueError, match="overlap"):
        sn.simulation.foot_tracks(SMALL, (0, 0, 0), (50, 0, 0))
    with pytest.raises(ValueError, match="outlier_share"):
        sn.simulation.foot_tracks(SMALL, (0, 0, 0), (0, 0, 0), outlier_share=2.0)
    a, b = sn.simulation.foot_tracks(SMALL, (0, 0, 0), (0, 0, 0), tracks=40, sigma_px=0.0)
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert a.shape == (40, 2)


def test_refusals_name_what_is_wrong(scene):
    plane = scene.true_plane(1.0, (0.0, 0.0))
    for call, words in [
        (lambda: GroundScene(texture_size=100), "size"),
        (lambda: GroundScene(texel_m=0.0), "texel_m"),
        (lambda: GroundScene(finest_texels=3), "finest_texels"),
        (lambda: GroundScene(contrast=2.0), "contrast"),
        (lambda: GroundScene(roughness=0.0), "roughness"),
        (lambda: scene.render(SMALL, (0, 0)), "pose"),
        (lambda: scene.render(SMALL, (0, 0, 0), -1.0), "height_m"),
        (lambda: scene.render(SMALL, (0, math.nan, 0)), "y_m"),
        (lambda: scene.render(SMALL, (0, 0, 0), 1.0, (2.0, 0.0)), "a_x_rad"),
        (lambda: scene.render(SMALL, (0, 0, 0), noise=-1.0), "noise"),
        (lambda: scene.render(SMALL, (0, 0, 0), defocus_px=99.0), "defocus_px"),
        (lambda: scene.render(SMALL, (0, 0, 0), to_pose=(0, 0, 1), blur_views=1), "blur_views"),
        (lambda: scene.render(SMALL, (0, 0, 0), objects=[GroundObject(math.inf, 0)]), "objects"),
        (lambda: scene.depth_cloud(SMALL, (0, 0, 0), hole_share=2.0), "hole_share"),
        (lambda: scene.depth_cloud(SMALL, (0, 0, 0), outlier_share=-1.0), "outlier_share"),
        (lambda: scene.depth_cloud(SMALL, (0, 0, 0), sigma_m=-1.0), "sigma_m"),
        (lambda: scene.depth_cloud(SMALL, (0, 0, 0), sensor_p_c=(0, 0, 5)), "sensor_p_c"),
        (lambda: fit_plane(np.zeros((5, 2))), "points"),
        (lambda: fit_plane(np.zeros((5, 3)), method="lsq"), "method"),
        (lambda: fit_plane(np.zeros((5, 3)), min_share=0.0), "min_share"),
        (lambda: sn.vision.GroundPlane.known([0, 0, -1], 1.0), "normal_c"),
        (lambda: ground_points(plane, SMALL, np.zeros((2, 3))), r"pixels: numbers of shape \(n, 2\)"),
        (lambda: ground_points(plane, SMALL, np.zeros(4)), "pixels"),
        (lambda: ground_pixels(plane, SMALL, np.zeros((2, 3))), r"points_b: numbers of shape \(n, 2\)"),
        (lambda: ground_pixels(plane, SMALL, np.zeros((2, 2, 2))), "points_b"),
        (lambda: sn.vision.nielsen_frames((0, 0, 0), (0, 0), 1.0, np.zeros((3, 2))), r"points_a.*\(n, 3\)"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()
    assert ground_points(plane, SMALL, []).shape == (0, 2)
    assert ground_points(plane, SMALL, [80.0, 60.0]).shape == (1, 2)
    lost = fit_plane(np.full((100, 3), np.nan))
    assert lost.status.name == "TOO_FEW"
    assert "TOO_FEW" in repr(lost.status)
    assert "too few" in repr(lost)
