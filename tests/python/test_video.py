"""Videos, photographs and folders of depth: what comes out, what is refused, what a broken file still gives."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from soopnav_cpp import io

pytest.importorskip("av")
Image = pytest.importorskip("PIL.Image")

SHARED = Path(__file__).parents[3] / "shared" / "captures" / "vision"
PINHOLE = SimpleNamespace(width=8, height=6, fx=4.0, fy=5.0, cx=3.0, cy=2.0)


def moving(n: int = 12, *, height: int = 48, width: int = 64, seed: int = 1) -> list[npt.NDArray[np.uint8]]:
    """A random floor that moves by one pixel per frame."""
    floor = np.random.default_rng(seed).integers(0, 256, (height, width + n), dtype=np.uint8)
    return [np.ascontiguousarray(floor[:, k : k + width]) for k in range(n)]


# ---- videos


@pytest.mark.parametrize("name", ["a.mkv", "a.avi"])
def test_lossless_videos_come_back_bit_by_bit(tmp_path: Path, name: str) -> None:
    frames = moving()
    assert io.write_video(tmp_path / name, frames, rate_hz=20.0, lossless=True) == 12
    video = io.read_video(tmp_path / name)
    assert (video.width, video.height, video.rate_hz) == (64, 48, 20.0)
    for _ in range(2):  # a video can be gone through again
        read = list(video)
        np.testing.assert_array_equal([frame.image for frame in read], frames)
        np.testing.assert_allclose([frame.t_s for frame in read], np.arange(12) / 20.0, atol=2e-3)
        assert video.problem == ""
    assert read[0].image.flags.c_contiguous
    assert read[0].image.dtype == np.uint8


@pytest.mark.parametrize("name", ["a.mp4", "a.gif"])
def test_pictures_in_colour_are_written_nearly(tmp_path: Path, name: str) -> None:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    frames = [np.stack([2 * x + k, 3 * y, 0 * x + 90], axis=2).astype(np.uint8) for k in range(5)]
    assert io.write_video(tmp_path / name, frames, rate_hz=10.0) == 5
    read = list(io.read_video(tmp_path / name))
    assert len(read) == 5
    grey = frames[2] @ np.array([0.299, 0.587, 0.114])
    assert np.abs(read[2].image - grey).mean() < 8.0


def test_a_truncated_video_gives_its_good_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    io.write_video(path, moving(40), lossless=True)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    video = io.read_video(path)
    read = list(video)
    assert 10 < len(read) < 30
    np.testing.assert_array_equal(read[7].image, moving(40)[7])
    assert f"{path}: {len(read)} frames could be decoded" in video.problem


def test_a_video_damaged_inside_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    io.write_video(path, moving(40, height=96, width=128), lossless=True)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = bytes(2000)
    path.write_bytes(bytes(content))
    video = io.read_video(path)
    read = [frame.image for frame in video]
    assert 20 < len(read) <= 40
    np.testing.assert_array_equal(read[-1], moving(40, height=96, width=128)[-1])


def test_frames_that_cannot_be_decoded_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    io.write_video(path, moving(20))
    content = bytearray(path.read_bytes())
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        places = [(p.pos, p.size) for p in container.demux(video=0) if p.size]
    start, size = places[7]
    content[start : start + size] = b"\xff" * size
    path.write_bytes(bytes(content))
    frames = list(io.read_video(path))
    assert len(frames) == 19
    assert [frame.number for frame in frames] == [k for k in range(20) if k != 7]


@pytest.mark.parametrize("content", [b"", b"not a video" * 50, b"RIFF\x00\x10\x00\x00AVI LIST" + bytes(200)])
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.avi"
    path.write_bytes(content)
    with pytest.raises(io.VideoError, match=r"a\.avi: .*(not a video that can be decoded|no video in it)"):
        io.read_video(path)


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(io.VideoError, match=r"none\.mp4: no such file"):
        io.read_video(tmp_path / "none.mp4")
    with pytest.raises(io.VideoError, match="no pictures in it"):
        io.read_video(tmp_path)
    with pytest.raises(io.VideoError, match="at least one picture"):
        io.read_video([])
    with pytest.raises(ValueError, match="rate_hz"):
        io.read_video(tmp_path, rate_hz=0.0)
    with pytest.raises(io.VideoError, match="no frames to write"):
        io.write_video(tmp_path / "a.mkv", [])
    with pytest.raises(io.VideoError, match="no frames to write"):
        io.write_video(tmp_path / "a.gif", [])
    with pytest.raises(io.VideoError, match="frame 1: shape"):
        io.write_video(tmp_path / "a.mkv", [moving(1)[0], moving(1, width=62)[0]])
    with pytest.raises(io.VideoError, match="uint8 expected, got float64"):
        io.write_video(tmp_path / "a.mkv", [np.zeros((8, 8))])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="rate_hz"):
        io.write_video(tmp_path / "a.mkv", moving(1), rate_hz=float("nan"))


# ---- pictures


def test_a_folder_of_pictures(tmp_path: Path) -> None:
    frames = moving()
    for k, image in enumerate(frames):
        Image.fromarray(image).save(tmp_path / f"frame_{k}.png")
    (tmp_path / "notes.txt").write_text("not a picture")
    read = list(io.read_video(tmp_path, rate_hz=10.0))
    np.testing.assert_array_equal([frame.image for frame in read], frames)  # 10 comes after 9
    assert [frame.t_s for frame in read] == pytest.approx([0.1 * k for k in range(12)])
    (tmp_path / "frame_3.png").write_bytes(b"broken")
    video = io.read_video(tmp_path)
    assert [frame.number for frame in video] == [0, 1, 2, *range(4, 12)]  # what is broken counts as well
    assert "frame_3.png: cannot be decoded: not a picture" in video.problem
    (tmp_path / "frame_0.png").write_bytes(b"broken")
    video = io.read_video(tmp_path)
    assert (video.width, video.height, len(list(video))) == (64, 48, 10)
    assert "and 1 more" in video.problem
    one = list(io.read_video(tmp_path / "frame_5.png"))
    np.testing.assert_array_equal(one[0].image, frames[5])


def test_names_that_are_times(tmp_path: Path) -> None:
    for k, image in enumerate(moving(3)):
        Image.fromarray(image).save(tmp_path / f"{100.25 + 0.5 * k:.6f}.png")
    video = io.read_video(tmp_path)
    assert [frame.t_s for frame in video] == pytest.approx([0.0, 0.5, 1.0])
    assert video.rate_hz == pytest.approx(2.0)
    assert video.first_s == 100.25
    assert io.read_video(tmp_path, rate_hz=2.0).first_s is None  # the names do not count


def test_deep_pictures_are_no_frames(tmp_path: Path) -> None:
    Image.fromarray(np.full((6, 8), 1000, np.uint16)).save(tmp_path / "0.png")
    video = io.read_video(tmp_path)
    assert list(video) == []
    assert "8 bits each expected" in video.problem


def test_what_a_photograph_says(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x8769] = {0x9003: "2024:05:06 07:08:09", 0x920A: 3.61, 0xA405: 20}
    exif[0x8825] = {1: "S", 2: (46.0, 30.0, 36.0), 3: "W", 4: (91.0, 0.0, 0.0), 5: b"\x01", 6: 12.5}
    path = tmp_path / "a.jpg"
    Image.fromarray(moving(1)[0]).save(path, exif=exif)
    photo = io.photo_data(path)
    assert photo.time is not None
    assert photo.time.isoformat() == "2024-05-06T07:08:09"
    assert (photo.latitude_deg, photo.longitude_deg) == pytest.approx((-46.51, -91.0))
    assert photo.height_m == -12.5
    assert (photo.focal_length_mm, photo.focal_length_35mm) == pytest.approx((3.61, 20.0))
    assert photo.yaw_deg is None
    plain = tmp_path / "b.png"
    Image.fromarray(moving(1)[0]).save(plain)
    assert io.photo_data(plain) == io.Photo()
    with pytest.raises(io.VideoError, match="no such file"):
        io.photo_data(tmp_path / "c.jpg")


@pytest.mark.offair
def test_photographs_of_a_drone() -> None:
    folder = SHARED / "drone_nadir"
    if not folder.is_dir():
        pytest.skip("no ../shared/captures/vision/drone_nadir")
    photos = [io.photo_data(path) for path in sorted(folder.glob("*.JPG"))]
    assert [photo.yaw_deg for photo in photos] == [45.0, 42.8, 44.2]
    assert [photo.above_start_m for photo in photos] == [39.8, 40.1, 40.1]
    assert photos[0].latitude_deg == pytest.approx(46.8426071, abs=1e-6)
    assert io.read_video(folder).rate_hz == pytest.approx(1.0 / 7.0)


@pytest.mark.offair
def test_a_real_video_and_half_of_it(tmp_path: Path) -> None:
    whole = SHARED / "static_camera" / "vtest.avi"
    if not whole.is_file():
        pytest.skip("no ../shared/captures/vision/static_camera")
    content = whole.read_bytes()
    path = tmp_path / "half.avi"
    path.write_bytes(content[: len(content) // 20])
    video = io.read_video(path)
    read = list(video)
    assert (video.width, video.height, video.rate_hz) == (768, 576, 10.0)
    assert 20 < len(read) < 100
    assert f"{len(read)} of 795 frames" in video.problem


# ---- depth


def test_depth_becomes_points() -> None:
    depth = np.full((6, 8), 2.0)
    depth[0, 0], depth[5, 7], depth[1, 1] = np.nan, 0.0, np.inf
    points = io.depth_to_points(depth, PINHOLE)
    assert points.shape == (45, 3)
    assert points.dtype == np.float32
    np.testing.assert_allclose(points[0], [2.0 * (1 - 3.0) / 4.0, 2.0 * (0 - 2.0) / 5.0, 2.0])  # row 0, column 1
    assert len(io.depth_to_points(depth, PINHOLE, most_points=12)) < 12
    with pytest.raises(ValueError, match="8×6 expected, got 6×8"):
        io.depth_to_points(depth.T, PINHOLE)


def write_pcd(path: Path, points: npt.NDArray[np.float32]) -> None:
    head = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    path.write_bytes(head.encode() + b"".join(struct.pack("<3f", *p) for p in points))


@pytest.mark.parametrize("kind", ["npy points", "npz points", "npy depth", "npz depth", "npy millimetres", "png"])
def test_kinds_of_depth(tmp_path: Path, kind: str) -> None:
    depth = np.linspace(0.5, 2.0, 48).reshape(6, 8).round(3)
    wanted = io.depth_to_points(depth, PINHOLE)
    millimetres = np.rint(depth * 1000.0).astype(np.uint16)
    for k in (10, 9):
        path = tmp_path / f"{k}.{kind.split()[0]}"
        arrays: dict[str, Any] = {"points": wanted, "depth": depth, "millimetres": millimetres}
        if kind == "png":
            Image.fromarray(millimetres + np.uint16(10 - k)).save(path)
        elif kind.startswith("npz"):
            np.savez(path, **{kind.split()[1]: arrays[kind.split()[1]]})
        else:
            np.save(path, arrays[kind.split()[1]])
    frames = io.read_depth(tmp_path, camera=PINHOLE)
    assert len(frames) == 2
    assert frames.files[0].stem == "9"
    np.testing.assert_allclose(frames.points(1), wanted, atol=1e-6)
    assert frames.index_of(1, 0.0, within_s=0.1) == 1
    assert frames.index_of(2, 0.0, within_s=0.1) is None


def test_depth_by_time(tmp_path: Path) -> None:
    for time in (5.0, 5.1, 5.4):
        np.save(tmp_path / f"{time:.3f}.npy", np.zeros((4, 3), np.float32))
    frames = io.read_depth(tmp_path)
    assert [frames.index_of(0, t, within_s=0.03) for t in (0.0, 0.09, 0.2, 0.41)] == [0, 1, None, 2]
    assert frames.first_s == 5.0
    on_clock = [frames.index_of(0, t, within_s=0.03, first_s=4.8) for t in (0.0, 0.2, 0.3, 0.6)]
    assert on_clock == [None, 0, 1, 2]


def test_depth_refusals(tmp_path: Path) -> None:
    with pytest.raises(io.VideoError, match="no such folder"):
        io.read_depth(tmp_path / "none")
    with pytest.raises(io.VideoError, match="no depth in it"):
        io.read_depth(tmp_path)
    np.save(tmp_path / "0.npy", np.zeros((6, 8)))
    with pytest.raises(io.VideoError, match=r"needs fx, fy, cx, cy, width and height in \[depth\]"):
        io.read_depth(tmp_path).points(0)
    np.save(tmp_path / "0.npy", np.zeros((6, 9)))
    with pytest.raises(io.VideoError, match=r"0\.npy: a depth image of 8×6 expected, got 9×6"):
        io.read_depth(tmp_path, camera=PINHOLE).points(0)
    np.save(tmp_path / "0.npy", np.zeros(9))
    with pytest.raises(io.VideoError, match=r"points .* or a depth image"):
        io.read_depth(tmp_path).points(0)
    np.save(tmp_path / "0.npy", np.array(["a"]))
    with pytest.raises(io.VideoError, match="numbers expected"):
        io.read_depth(tmp_path).points(0)
    for content in (b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04broken"):
        (tmp_path / "0.npy").write_bytes(content)
        with pytest.raises(io.VideoError, match=r"0\.npy: not an array"):
            io.read_depth(tmp_path).points(0)
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(tmp_path / "0.png")
    with pytest.raises(io.VideoError, match=r"one kind expected, got \.npy and \.png"):
        io.read_depth(tmp_path)
    (tmp_path / "0.npy").unlink()
    with pytest.raises(io.VideoError, match="16 bits, in millimetres, expected; its pixels are L"):
        io.read_depth(tmp_path, camera=PINHOLE).points(0)
    (tmp_path / "0.png").unlink()
    np.savez(tmp_path / "0.npz", other=np.zeros(3))
    with pytest.raises(io.VideoError, match=r"named points or depth expected; it holds \['other'\]"):
        io.read_depth(tmp_path).points(0)
