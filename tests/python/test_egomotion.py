"""``soopnav egomotion``: a rendered video followed, its report, what is refused; the walk that increments add up to."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from soopnav_cpp import io, plotting, simulation, vision
from soopnav_cpp._walk import Walk

pytest.importorskip("matplotlib")
pytest.importorskip("av")
pytest.importorskip("PIL")

from soopnav_cpp.cli import egomotion
from soopnav_cpp.cli.app import cli

CAMERA = """\
model = "pinhole"
width = 160
height = 120
fx = 140.0
fy = 140.0
cx = 79.5
cy = 59.5
"""
HEIGHT_M = 0.5
TILT_DEG = (5.0, -3.0)
needs_opencv = pytest.mark.skipif(not vision.available(), reason="this build is without OpenCV")


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


# ---- the walk


def motion(step: Any, **more: Any) -> Any:
    fields: dict[str, Any] = {
        "ok": True,
        "dt_s": 0.1,
        "increment": np.array(step, dtype=float),
        "track_covariance": np.zeros((3, 3)),
        "foot_covariance_previous": np.zeros((2, 2)),
        "foot_covariance": np.zeros((2, 2)),
    }
    return SimpleNamespace(**{**fields, **more})


def first() -> Any:
    return motion([0.0, 0.0, 0.0], ok=False, dt_s=0.0)


def test_a_square_closes() -> None:
    walk = Walk()
    walk.add(first(), 0.0)
    for k in range(8):
        walk.add(motion([1.0, 0.0, 0.0] if k % 2 == 0 else [0.0, 0.0, math.pi / 2]), 0.1 * (k + 1))
    np.testing.assert_allclose(walk.pose[-1], [0.0, 0.0, 2.0 * math.pi], atol=1e-12)
    np.testing.assert_allclose(walk.pose[3], [1.0, 1.0, math.pi / 2], atol=1e-12)
    assert walk.length_m == pytest.approx(4.0)
    walk.begin(2, [5.0, 6.0, math.pi])
    np.testing.assert_allclose(walk.pose[[2, 3]], [[5.0, 6.0, math.pi], [4.0, 6.0, math.pi]], atol=1e-12)
    assert walk.length_m == pytest.approx(4.0)


def test_feet_cancel_and_tracks_add_up() -> None:
    walk = Walk()
    walk.add(first(), 0.0)
    feet = np.diag([4e-6, 1e-6])
    for k in range(100):
        walk.add(
            motion([0.02, 0.0, 0.0], track_covariance=np.diag([1e-8, 1e-8, 1e-10]), foot_covariance=feet,
                   foot_covariance_previous=feet), 0.1 * (k + 1),
        )  # fmt: skip
    # Two feet, however long the walk; tracks n σ²; the heading's error swings the way: Σ (0.02 j)² σ_a².
    along = 2.0 * 4e-6 + 100 * 1e-8
    across = 2.0 * 1e-6 + 100 * 1e-8 + 1e-10 * 0.02**2 * sum(j * j for j in range(100))
    np.testing.assert_allclose(walk.covariance[-1].diagonal(), [along, across, 1e-8], rtol=1e-6)


def test_frames_without_an_increment_go_on_as_before() -> None:
    walk = Walk()
    walk.add(first(), 0.0)
    walk.add(motion([0.1, 0.0, 0.0]), 0.1)
    walk.add(first(), 0.2)  # nothing measured: the speed of before is taken on
    np.testing.assert_allclose(walk.pose[2], [0.2, 0.0, 0.0], atol=1e-12)
    assert walk.bridged_s == pytest.approx(0.1)
    assert walk.covariance[2, 0, 0] > 1e-4
    walk.add(motion([0.3, 0.1, 0.0], dt_s=0.2), 0.3)  # counts from the last frame that had one
    np.testing.assert_allclose(walk.pose[3], [0.4, 0.1, 0.0], atol=1e-12)
    assert walk.since == [-1, 0, -1, 1]
    assert walk.bridged_s == pytest.approx(0.0)
    np.testing.assert_allclose(walk.covariance[3], 0.0, atol=1e-15)


# ---- the command


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a video of 30 frames, depth, a camera and the truth."""
    folder = tmp_path_factory.mktemp("rendered")
    (folder / "cam.toml").write_text(CAMERA)
    camera = vision.load_camera(folder / "cam.toml").camera
    scene = simulation.GroundScene(seed=5)
    images, truth = [], []
    (folder / "depth").mkdir()
    tilt = tuple(math.radians(angle) for angle in TILT_DEG)
    for k in range(30):
        pose = np.array([0.3 * math.sin(0.05 * k), 0.008 * k, 0.01 * k])
        images.append(scene.render(camera, pose, height_m=HEIGHT_M, tilt_rad=tilt, noise=1.5, frame=k))
        points = scene.depth_cloud(camera, pose, height_m=HEIGHT_M, tilt_rad=tilt, points=2000, frame=k)
        np.save(folder / "depth" / f"{k}.npy", points)
        truth.append([0.05 * k, *pose])
    io.write_video(folder / "walk.mkv", images, rate_hz=20.0, lossless=True)
    with (folder / "truth.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "position_x_m", "position_y_m", "heading_rad"])
        writer.writerows(truth)
    return folder


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without figures, which take most of the time."""
    for name in ("ground_track", "increments"):
        monkeypatch.setattr(plotting, name, lambda *_, path, **__: Path(path).write_bytes(b"\x89PNG"))


def follow(rendered: Path, out: Path, *more: object, code: int = 0) -> Result:
    return run("egomotion", rendered / "walk.mkv", "--camera", rendered / "cam.toml", "--out", out, *more, code=code)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@needs_opencv
def test_a_rendered_walk(rendered: Path, tmp_path: Path) -> None:
    plane = f"{HEIGHT_M},{TILT_DEG[0]},{TILT_DEG[1]}"
    text = follow(rendered, tmp_path, "--plane", plane, "--truth", rendered / "truth.csv").output
    assert "29 of 29 increments measured" in text
    assert "NEES" in text
    table = rows(tmp_path / "increments.csv")
    assert [row["status"] for row in table] == ["first"] + ["measured"] * 29
    errors = np.array([[float(row[f"error_{name}"]) for name in ("dx_m", "dy_m", "da_rad")] for row in table[1:]])
    assert np.abs(errors[:, :2]).max() < 1e-3
    assert np.abs(errors[:, 2]).max() < 5e-3
    pose = np.loadtxt(tmp_path / "trajectory.tum")
    assert pose.shape == (30, 8)
    truth = np.array([[float(v) for v in row.values()] for row in rows(rendered / "truth.csv")])
    assert np.abs(pose[:, 1:3] - truth[:, 1:3]).max() < 5e-3
    np.testing.assert_allclose(np.linalg.norm(pose[:, 4:], axis=1), 1.0, atol=1e-6)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["measured"] == 29
    assert metrics["length_m"] == pytest.approx(0.39, abs=0.03)
    report = (tmp_path / "report.html").read_text()
    assert report.count("data:image/png;base64,") == 6  # the walk, the increments, four frames
    assert len(list(tmp_path.glob("frame_*.png"))) == 4


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_depth_tells_the_plane(rendered: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    video = tmp_path / "tracks.mp4"
    depth = rendered / "depth"
    text = follow(
        rendered, out, "--depth", depth, "--truth", rendered / "truth.csv", "--tracks", video, "--json"
    ).output
    found = json.loads(text)
    assert found["measured"] == 29
    assert found["height_median_m"] == pytest.approx(HEIGHT_M, rel=0.01)
    assert found["position_rms_m"] < 0.02
    assert 0.3 < found["nees"]["mean"] < 12.0
    assert len(list(io.read_video(video))) == 30


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_the_same_seed_gives_the_same_bytes(rendered: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        follow(rendered, tmp_path / name, "--depth", rendered / "depth", "--frames", 8)
    for file in ("trajectory.tum", "trajectory.csv", "increments.csv", "metrics.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_missing_depth_is_bridged(rendered: Path, tmp_path: Path) -> None:
    depth = tmp_path / "depth"
    depth.mkdir()
    for k in range(30):
        content = (rendered / "depth" / f"{k}.npy").read_bytes()
        (depth / f"{k}.npy").write_bytes(content[:50] if k in (9, 10) else content)
    text = follow(rendered, tmp_path / "out", "--depth", depth, "--truth", rendered / "truth.csv").output
    assert "2 no plane" in text
    assert "9.npy: not an array" in text
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["position_rms_m"] < 0.02


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_a_floor_that_shows_nothing(rendered: Path, tmp_path: Path) -> None:
    io.write_video(tmp_path / "dark.mkv", [np.zeros((120, 160), np.uint8)] * 5, lossless=True)
    result = run("egomotion", tmp_path / "dark.mkv", "--camera", rendered / "cam.toml", "--height", 1.0, "--out",
                 tmp_path / "out", code=2)  # fmt: skip
    assert "0 of 4 increments measured" in result.output


def pictures(rendered: Path, folder: Path, names: list[str]) -> Path:
    """Its first frames as pictures of these names."""
    pillow = pytest.importorskip("PIL.Image")
    folder.mkdir()
    for name, frame in zip(names, io.read_video(rendered / "walk.mkv"), strict=False):
        pillow.fromarray(frame.image).save(folder / name)
    return folder


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Which depth files were read."""
    read, numbers = io.DepthFolder.points, []

    def points(self: io.DepthFolder, i: int) -> Any:
        numbers.append(i)
        return read(self, i)

    monkeypatch.setattr(io.DepthFolder, "points", points)
    return numbers


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_pictures_of_another_size_are_left_out(rendered: Path, tmp_path: Path) -> None:
    shots = pictures(rendered, tmp_path / "shots", [f"{k}.png" for k in range(8)])
    for k in (1, 2):
        pytest.importorskip("PIL.Image").fromarray(np.zeros((60, 80), np.uint8)).save(shots / f"{k}.png")
    text = run("egomotion", shots, "--rate", 20, "--camera", rendered / "cam.toml", "--plane", "0.5,5,-3", "--out",
               tmp_path / "out").output  # fmt: skip
    assert "frame 1: 80×60, left out" in text
    assert "5 of 5 increments measured" in text
    # Frame 7 is the sixth that was used: it is shown under its own number, with its own increment.
    assert [path.stem for path in sorted((tmp_path / "out").glob("frame_*.png"))] == [
        "frame_00003", "frame_00005", "frame_00007"
    ]  # fmt: skip


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_depth_belongs_to_the_frames_own_number(rendered: Path, tmp_path: Path, asked: list[int]) -> None:
    follow(rendered, tmp_path / "out", "--depth", rendered / "depth", "--every", 3, "--frames", 4)
    assert asked == [0, 3, 6, 9]
    asked.clear()
    shots = pictures(rendered, tmp_path / "shots", [f"{k}.png" for k in range(8)])
    (shots / "2.png").write_bytes(b"broken")
    run("egomotion", shots, "--rate", 20, "--camera", rendered / "cam.toml", "--depth", rendered / "depth", "--out",
        tmp_path / "out")  # fmt: skip
    assert asked == [0, 1, 3, 4, 5, 6, 7]


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_names_that_are_times_are_of_one_clock(rendered: Path, tmp_path: Path, asked: list[int]) -> None:
    shots = pictures(rendered, tmp_path / "shots", [f"{1305031100 + 0.05 * k:.6f}.png" for k in range(8)])
    for name, start in (("late", 1305031100.2), ("other", 7.0)):
        (tmp_path / name).mkdir()
        for k in range(4):  # depth begins at the fifth picture
            content = (rendered / "depth" / f"{k + 4}.npy").read_bytes()
            (tmp_path / name / f"{start + 0.05 * k:.6f}.npy").write_bytes(content)
    command = ("egomotion", shots, "--camera", rendered / "cam.toml", "--out", tmp_path / "out", "--depth")
    text = run(*command, tmp_path / "late").output
    assert asked == [0, 1, 2, 3]
    assert "4 frames without a depth frame" in text
    tracks = tmp_path / "tracks.mp4"
    text = run(*command, tmp_path / "other", "--tracks", tracks, code=2).output
    assert "depth of 7.000000 … 7.150000 s, but the frames are of 1305031100.000000 … 1305031100.350000 s" in text
    assert not tracks.exists()  # a begun one is not left behind
    tracks.mkdir()
    assert "cannot be written" in run(*command, tmp_path / "late", "--tracks", tracks, code=2).output


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_drawn_frames_are_not_kept(rendered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw, drawn, ahead = plotting.draw_tracks, [0], []

    def counted(*more: Any, **options: Any) -> Any:
        drawn[0] += 1
        return draw(*more, **options)

    def write(_path: Path, frames: Any, **_: Any) -> int:
        written = 0
        for _image in frames:
            written += 1
            ahead.append(drawn[0] - written)
        return written

    monkeypatch.setattr(plotting, "draw_tracks", counted)
    monkeypatch.setattr(io, "write_video", write)
    follow(rendered, tmp_path / "out", "--height", 0.5, "--frames", 6, "--tracks", tmp_path / "t.mp4")
    assert ahead == [0] * 6


@needs_opencv
@pytest.mark.usefixtures("plain")
def test_a_sensor_that_looks_ahead(rendered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tilted = tmp_path / "tilted"
    tilted.mkdir()
    c, s = math.cos(0.9), math.sin(0.9)  # with the 5 degrees of the scene beyond 45: a wall by default
    for k in range(3):
        points = np.load(rendered / "depth" / f"{k}.npy")
        np.save(tilted / f"{k}.npy", (points @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])).astype(np.float32))
    for limit, count in ((45.0, 0), (70.0, 1)):
        text = CAMERA + f"[depth]\nplane_max_tilt_deg = {limit}\n"
        (tmp_path / "cam.toml").write_text(text)
        run("egomotion", rendered / "walk.mkv", "--camera", tmp_path / "cam.toml", "--depth", tilted, "--frames", 3,
            "--out", tmp_path / "out", code=2 * (count == 0))  # fmt: skip
    told: dict[str, Any] = {}

    def made(_camera: Any, _tracker: Any, options: dict[str, Any]) -> Any:
        told.update(options)
        raise ValueError("that is all")

    monkeypatch.setattr(vision._vision, "EgoMotion", made)
    (tmp_path / "cam.toml").write_text(CAMERA + "[depth]\nplane_band_m = 0.01\nplane_noise_cluster = 4.0\n")
    run("egomotion", rendered / "walk.mkv", "--camera", tmp_path / "cam.toml", "--height", 1, code=2)
    assert (told["plane_band_m"], told["plane_noise_cluster"]) == (0.01, 4.0)


# ---- stamps


@pytest.mark.parametrize(
    ("stamps", "used", "anew"),
    [
        ([0.0, 0.05, 0.10, 1e6, 0.20, 0.25], [0, 1, 2, 4, 5], []),  # one ahead of all
        ([0.0, 0.05, -1e6, 0.15, 0.15, 0.20], [0, 1, 3, 5], []),  # one behind, one twice
        ([0.0, 0.05, math.nan, math.inf, 0.20], [0, 1, 4], []),
        ([math.nan, 0.05, 0.10], [1, 2], []),
        ([0.0, 0.05, 60.0, 60.05, 60.1, 60.15], [0, 1, 4, 5], []),  # a pause: believed when the next ones follow
        ([1e6, 0.05, 0.10, 0.15, 0.20], [0, 3, 4], [3]),  # the first was the wrong one
        ([0.0, 0.05, 1e6, 2e6, 3e6, 0.30], [0, 1, 5], []),
        ([5.0, 5.05, 1.0, 1.05, 1.1, 5.1], [0, 1, 5], []),  # back in time for good is never taken
    ],
)
def test_stamps_that_can_be_used(stamps: list[float], used: list[int], anew: list[int]) -> None:
    clock = egomotion._Clock(20.0)
    taken, forgotten = [], []
    for k, t_s in enumerate(stamps):
        if clock.take(t_s):
            taken.append(k)
            forgotten += [k] if clock.anew else []
    assert (taken, forgotten) == (used, anew)
    assert clock.left_out == len(stamps) - len(used) + len(anew)


@needs_opencv
@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(("wild", "measured"), [(3, "6 of 6"), (0, "4 of 4")])
def test_one_wild_stamp_is_left_out(
    rendered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wild: int, measured: str
) -> None:
    decode = io.Video._decode

    def stamped(self: io.Video) -> Any:
        for frame in decode(self):
            yield frame._replace(t_s=1e6) if frame.number == wild else frame

    monkeypatch.setattr(io.Video, "_decode", stamped)
    plane = f"{HEIGHT_M},{TILT_DEG[0]},{TILT_DEG[1]}"
    text = follow(rendered, tmp_path, "--plane", plane, "--truth", rendered / "truth.csv", "--frames", 8).output
    assert f"{measured} increments measured" in text
    assert "whose time does not follow that of the frame before: left out" in text
    assert json.loads((tmp_path / "metrics.json").read_text())["position_rms_m"] < 5e-3


def test_refusals(rendered: Path, tmp_path: Path) -> None:
    video, camera = rendered / "walk.mkv", rendered / "cam.toml"

    def refused(*arguments: object) -> str:
        return run("egomotion", *arguments, "--out", tmp_path / "out", code=2).output

    assert "no ground: one of --depth, --plane and --height expected" in refused(video, "--camera", camera)
    both = refused(video, "--camera", camera, "--height", 1, "--depth", rendered / "depth")
    assert "--depth and --height: one of" in both
    for bad, why in (("1,2", "HEIGHT or"), ("-1", "above zero"), ("1,80,0", "tilts up to"), ("x", "HEIGHT or")):
        assert why in refused(video, "--camera", camera, f"--plane={bad}")
    assert "a name that ends in .mp4" in refused(video, "--camera", camera, "--height", 1, "--tracks", "a.txt")
    if not vision.available():
        assert "needs OpenCV" in refused(video, "--camera", camera, "--height", 1)
        return
    other = tmp_path / "cam.toml"
    other.write_text(CAMERA.replace("160", "320"))
    assert "320×120, but" in refused(video, "--camera", other, "--height", 1)
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"not a video")
    assert "broken.mp4: not a video that can be decoded" in refused(broken, "--camera", camera, "--height", 1)
    assert "no such file" in refused(tmp_path / "none.mp4", "--camera", camera, "--height", 1)
    late = refused(video, "--camera", camera, "--height", 0.5, "--truth", rendered / "truth.csv", "--start", 1000)
    assert "times of the same clock expected (--start)" in late
    assert "no depth in it" in refused(video, "--camera", camera, "--depth", tmp_path)
