"""Depth beside a video: a folder with one file per frame, as points or as depth images."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from soopnav_cpp._extras import require
from soopnav_cpp._video import VideoError, _natural, names_as_times

__all__ = ["DepthFolder", "depth_to_points", "read_depth"]

Points = npt.NDArray[np.float32]
_ENDINGS = (".npy", ".npz", ".pcd", ".png")
_MOST_POINTS = 40_000  # of a depth image: beyond it a plane gets no better, only slower
_MILLIMETRE = 1e-3


class Intrinsics(Protocol):
    """A pinhole: focal lengths and centre [px] of the depth camera, and the size of its images."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...


def depth_to_points(
    depth_m: npt.ArrayLike, camera: Intrinsics, *, most_points: int = _MOST_POINTS, where: str = "depth_m"
) -> Points:
    """Points that a depth image shows.

    Parameters
    ----------
    depth_m : array_like, shape (h, w)
        Along the optical axis [m]; 0 and what is not finite: nothing came back.
    camera : has width, height, fx, fy, cx, cy
        A `vision.Camera`, whose lens counts, or any other pinhole.
    most_points : int
        Rows and columns are passed over evenly so that no more are left.
    where : str
        Named in errors.

    Returns
    -------
    ndarray, shape (n, 3), float32
        In the depth camera's frame: x right, y down, z along the optical axis.

    Raises
    ------
    ValueError
        For another size than the camera's.
    """
    depth = np.asarray(depth_m)
    if depth.shape != (camera.height, camera.width):
        got = "×".join(str(n) for n in depth.shape[::-1])
        raise ValueError(f"{where}: a depth image of {camera.width}×{camera.height} expected, got {got}")
    step = max(1, math.ceil(math.sqrt(depth.size / most_points)))
    part = depth[::step, ::step].astype(np.float32)
    rows, columns = np.nonzero(np.isfinite(part) & (part > 0.0))
    z = part[rows, columns]
    if getattr(camera, "lens", "pinhole") != "pinhole":
        rays = camera.unproject(np.column_stack([columns, rows]) * float(step))  # type: ignore[attr-defined]
        return np.ascontiguousarray(rays * z[:, None], dtype=np.float32)
    x = (columns * step - np.float32(camera.cx)) * z / np.float32(camera.fx)
    y = (rows * step - np.float32(camera.cy)) * z / np.float32(camera.fy)
    return np.ascontiguousarray(np.stack([x, y, z], axis=1), dtype=np.float32)


@dataclass(eq=False)
class DepthFolder:
    """Depth frames of a folder, read when they are asked for.

    Attributes
    ----------
    folder : Path
    files : tuple of Path
        In the order of their names, numbers as numbers.
    t_s : ndarray or None
        Seconds from the first one, where the names are times.
    first_s : float or None
        What the first name says, where the names are times.
    """

    folder: Path
    files: tuple[Path, ...]
    t_s: npt.NDArray[np.float64] | None
    camera: Any = None
    first_s: float | None = None
    _cloud: Callable[[Path], npt.NDArray[Any]] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.files)

    def index_of(self, k: int, t_s: float, *, within_s: float, first_s: float | None = None) -> int | None:
        """Which file belongs to frame `k`, taken at `t_s`: the nearest in time, or without times the k-th.

        `k` is the frame's own number (`Frame.number`). With `first_s`, that of the video, `t_s` counts from it on the
        clock of the names; without it from the first file.
        """
        if self.t_s is None:
            return k if k < len(self.files) else None
        if first_s is not None and self.first_s is not None:
            t_s += first_s - self.first_s
        i = int(np.argmin(np.abs(self.t_s - t_s)))
        return i if abs(float(self.t_s[i]) - t_s) <= within_s else None

    def points(self, i: int) -> Points:
        """Points of file `i`, shape (n, 3), float32, in the depth camera's frame [m].

        Raises
        ------
        VideoError
            For a file that does not hold points or a depth image of the camera's size.
        """
        path = self.files[i]
        ending = path.suffix.lower()
        if ending == ".pcd":
            assert self._cloud is not None  # read_depth saw to it
            return self._as_points(path, self._cloud(path))
        if ending == ".png":
            return self._as_points(path, _png(path))
        return self._as_points(path, _array(path))

    def _as_points(self, path: Path, array: npt.NDArray[Any]) -> Points:
        if array.dtype.kind not in "fiu":
            raise VideoError(f"{path}: numbers expected, got {array.dtype}")
        if array.ndim == 3 and array.shape[2] == 3:
            array = array.reshape(-1, 3)
        if array.ndim == 2 and array.shape[1] == 3:
            return np.ascontiguousarray(array, dtype=np.float32)
        if array.ndim != 2:
            raise VideoError(f"{path}: points (n, 3) or a depth image (h, w) expected, got shape {array.shape}")
        if self.camera is None:
            raise VideoError(f"{path}: a depth image needs fx, fy, cx, cy, width and height in [depth] of the camera")
        metres = array * _MILLIMETRE if array.dtype.kind == "u" else array
        try:
            return depth_to_points(metres, self.camera, where=str(path))
        except ValueError as error:
            raise VideoError(str(error)) from error


def _array(path: Path) -> npt.NDArray[Any]:
    """The array of an ``.npy``, or that of an ``.npz`` that is named points or depth."""
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if path.suffix.lower() == ".npy":
                return np.asarray(loaded)
            names = [name for name in ("points", "depth", "depth_m") if name in loaded.files]
            if not names:
                raise VideoError(f"{path}: an array named points or depth expected; it holds {loaded.files}")
            return np.asarray(loaded[names[0]])
    except VideoError:
        raise
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise VideoError(f"{path}: not an array that can be read: {str(error).lower()}") from error
    except Exception as error:  # a zip file that is broken inside
        raise VideoError(f"{path}: not an array that can be read: {type(error).__name__}") from error


def _png(path: Path) -> npt.NDArray[np.uint16]:
    """A depth image of 16 bits, in millimetres."""
    pillow = require("PIL.Image", "vision", "reading depth images")
    try:
        with pillow.open(path) as picture:
            mode = str(picture.mode)
            image = np.array(picture)
    except Exception as error:
        raise VideoError(f"{path}: cannot be decoded") from error
    if not mode.startswith("I") or image.ndim != 2:
        raise VideoError(f"{path}: a depth image of 16 bits, in millimetres, expected; its pixels are {mode}")
    return image.astype(np.uint16)


def read_depth(
    folder: str | Path,
    *,
    camera: Intrinsics | None = None,
    read_cloud: Callable[[Path], npt.NDArray[Any]] | None = None,
) -> DepthFolder:
    """Open a folder of depth frames.

    Parameters
    ----------
    folder : path
        Files ``.npy``, ``.npz`` (``points`` or ``depth``; metres when floating, millimetres when unsigned integers),
        ``.pcd``, or ``.png`` of 16 bits (millimetres), one per frame, all of one kind. Names that are times
        (``12.05.npy``) are matched to frames by time (on one clock with pictures whose names are times), others in
        their order.
    camera : optional
        Of the depth images: has width, height, fx, fy, cx, cy.
    read_cloud : callable, optional
        In place of the package's own reader of ``.pcd``.

    Returns
    -------
    DepthFolder

    Raises
    ------
    VideoError
        For a folder that is not there, is empty, or mixes kinds.
    """
    where = Path(folder)
    if not where.is_dir():
        raise VideoError(f"{where}: {'a file; a folder expected' if where.exists() else 'no such folder'}")
    files = sorted((p for p in where.iterdir() if p.suffix.lower() in _ENDINGS), key=_natural)
    if not files:
        raise VideoError(f"{where}: no depth in it; names that end in {', '.join(_ENDINGS)} expected")
    kinds = sorted({p.suffix.lower() for p in files})
    if len(kinds) > 1:
        raise VideoError(f"{where}: files of one kind expected, got {' and '.join(kinds)}")
    if kinds == [".pcd"] and read_cloud is None:
        read_cloud = importlib.import_module("soopnav_cpp._pcd").read_point_cloud  # loaded when it is needed
    times = names_as_times(files)
    if times is None:
        return DepthFolder(where, tuple(files), None, camera, None, read_cloud)
    return DepthFolder(where, tuple(files), np.array(times) - times[0], camera, times[0], read_cloud)
