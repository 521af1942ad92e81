"""Point clouds in files: every kind of .pcd, damaged ones, NumPy's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp.vision import fit_plane

pytestmark = pytest.mark.unit

_TABLES = Path(__file__).resolve().parents[2].parent / "shared" / "captures" / "vision" / "kinect_planes"

_POINTS = np.array([[0.5, -1.25, 2.0], [np.nan, np.nan, np.nan], [1.0, 2.0, 3.5]], dtype=np.float32)
_LABELS = np.array([7, 0, 3], dtype=np.uint32)


def _header(data: str, points: int = 3, fields: str = "label x y z") -> bytes:
    n = len(fields.split())
    kinds = " ".join("U" if name == "label" else "F" for name in fields.split())
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {' '.join(['4'] * n)}\nTYPE {kinds}\n"
        f"COUNT {' '.join(['1'] * n)}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n"
    ).encode()


def _ascii() -> bytes:
    rows = "\n".join(f"{label} {x} {y} {z}" for label, (x, y, z) in zip(_LABELS, _POINTS, strict=True))
    return _header("ascii") + rows.encode() + b"\n"


def _binary() -> bytes:
    table = np.empty(3, dtype=[("label", "<u4"), ("p", "<f4", 3)])
    table["label"], table["p"] = _LABELS, _POINTS
    return _header("binary") + table.tobytes()


def _packed(plain: bytes) -> bytes:
    """Literals, and one reference back that overlaps itself: 5 bytes equal to the byte before."""
    out = bytearray()
    for start in range(0, len(plain), 32):
        piece = plain[start : start + 32]
        out += bytes([len(piece) - 1]) + piece
    return bytes(out)


def _compressed() -> bytes:
    plain = _LABELS.tobytes() + _POINTS.T.astype("<f4").tobytes()
    packed = _packed(plain)
    return _header("binary_compressed") + np.array([len(packed), len(plain)], dtype="<u4").tobytes() + packed


@pytest.mark.parametrize("content", [_ascii(), _binary(), _compressed()], ids=["ascii", "binary", "compressed"])
def test_each_kind_of_pcd_gives_the_same(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_bytes(content)
    points = sn.io.read_point_cloud(path)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, _POINTS)
    np.testing.assert_array_equal(sn.io.read_point_cloud(path, field="label"), [7, 0, 3])


def test_references_back_may_overlap_themselves(tmp_path: Path) -> None:
    # x is zeros: one literal zero, then runs that copy from one byte before.
    plain = bytes(4 * 20) + np.ones(40, dtype="<f4").tobytes()
    packed = bytes([0, 0]) + bytes([(7 << 5), 79 - 9, 0]) + _packed(plain[80:])
    path = tmp_path / "cloud.pcd"
    sizes = np.array([len(packed), len(plain)], dtype="<u4").tobytes()
    path.write_bytes(_header("binary_compressed", 20, "x y z") + sizes + packed)
    np.testing.assert_array_equal(sn.io.read_point_cloud(path), np.tile([0.0, 1.0, 1.0], (20, 1)))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "no DATA line"),
        (b"hello\n" * 10, "no DATA line"),
        (_header("ascii", fields="label x y"), "x, y and z are needed"),
        (_header("zip"), "DATA zip"),
        (_ascii()[:-12], "numbers; 3 points"),
        (_ascii().replace(b"-1.25", b"-l.25"), "-l.25"),
        (_binary()[:-1], "bytes of data"),
        (_compressed()[:-1], "of compressed data"),
        (_header("binary_compressed") + b"123", "sizes of the compressed data"),
        (_header("binary").replace(b"SIZE 4 4 4 4", b"SIZE 4 4 4"), "SIZE 4 4 4"),
        (_header("binary").replace(b"TYPE U F F F", b"TYPE U F F Q"), "TYPE Q"),
        (_header("binary").replace(b"COUNT 1 1 1 1", b"COUNT 1 1 1 0"), "COUNT 0"),
        (_header("binary").replace(b"POINTS 3", b"POINTS -3"), "POINTS -3"),
        (_header("binary").replace(b"POINTS 3", b"POINTS 99999999999"), "at most 4 GiB"),
    ],
)
def test_damaged_files_are_named_with_what_is_wrong(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"cloud\.pcd") as error:
        sn.io.read_point_cloud(path)
    assert expected in str(error.value)


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, len(_compressed()) - 1), byte=st.integers(0, 255))
@example(at=159, byte=129)  # a signalling NaN
def test_any_byte_may_be_wrong(tmp_path_factory: pytest.TempPathFactory, at: int, byte: int) -> None:
    content = bytearray(_compressed())
    content[at] = byte
    path = tmp_path_factory.mktemp("clouds") / "cloud.pcd"
    path.write_bytes(content)
    try:
        points = sn.io.read_point_cloud(path)
    except ValueError as error:
        assert "cloud.pcd" in str(error)
    else:
        assert points.ndim == 2
        assert points.shape[1] == 3


def test_numpy_files(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.stack([_POINTS, _POINTS]).astype(np.float64))
    np.savez(tmp_path / "b.npz", points=_POINTS, labels=_LABELS)
    np.savez(tmp_path / "c.npz", one=_POINTS, two=_POINTS)
    np.save(tmp_path / "d.npy", _LABELS)
    (tmp_path / "e.npy").write_bytes(b"no array")
    np.testing.assert_array_equal(sn.io.read_point_cloud(tmp_path / "a.npy"), np.concatenate([_POINTS, _POINTS]))
    np.testing.assert_array_equal(sn.io.read_point_cloud(tmp_path / "b.npz"), _POINTS)
    for name in ("c.npz", "d.npy", "e.npy"):
        with pytest.raises(ValueError, match=name):
            sn.io.read_point_cloud(tmp_path / name)
    with pytest.raises(ValueError, match="field"):
        sn.io.read_point_cloud(tmp_path / "b.npz", field="labels")
    with pytest.raises(ValueError, match=r"\.pcd, \.npy or \.npz"):
        sn.io.read_point_cloud(tmp_path / "cloud.ply")
    with pytest.raises(FileNotFoundError):
        sn.io.read_point_cloud(tmp_path / "none.npy")


@pytest.mark.parametrize("name", ["learn0", "test10"])
def test_kinect_tables_are_found_where_their_labels_are(name: str) -> None:
    path = _TABLES / f"{name}.pcd"
    if not path.exists():
        pytest.skip("the clouds in ../shared are not there")
    points = sn.io.read_point_cloud(path)
    labels = sn.io.read_point_cloud(path, field="label")
    table = points[(labels >= 1) & (labels <= 9) & np.isfinite(points).all(axis=1)].astype(np.float64)
    own = np.linalg.eigh(np.cov((table - table.mean(axis=0)).T))[1][:, 0]
    steep = 1.2  # the camera looks at the table from the side: 47 and 53 degrees
    robust = fit_plane(points, max_tilt_rad=steep, band_m=0.01)
    plain = fit_plane(points, method="svd", max_tilt_rad=steep)
    assert robust.ok
    assert plain.ok
    off = [float(np.degrees(np.arccos(min(1.0, abs(own @ plane.normal_c))))) for plane in (robust, plain)]
    assert off[0] < 0.02
    assert off[1] > 1.0
