"""Calibration files of cameras: CAM.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core.vision import Camera
from soopnav_cpp._extras import require

if TYPE_CHECKING:
    from os import PathLike

__all__ = ["CameraFile", "DepthCamera", "load_camera", "save_camera"]

_LENSES = ("pinhole", "radial_tangential", "fisheye")
# Keys of [depth] that tell of the sensor and of where the ground may lie, and options of EgoMotion (degrees: radians).
_PLANE_KEYS = {
    "plane_sigma_m": "plane_sigma_m",
    "plane_sigma_per_m": "plane_sigma_per_m",
    "plane_band_m": "plane_band_m",
    "plane_noise_cluster": "plane_noise_cluster",
    "plane_max_tilt_deg": "max_tilt_rad",
}


@dataclass(frozen=True)
class DepthCamera:
    """The depth camera beside an image's camera.

    Attributes
    ----------
    offset_m : tuple of 3 floats
        Its origin in axes of the image's camera, which it shares: nielsen's [D_cam, 0, 0].
    camera : Camera, optional
        What turns a depth image into points; without it depth files must hold points.
    plane_options : mapping
        What `EgoMotion` is to be told of its noise and of the ground: `plane_sigma_m`, `plane_sigma_per_m`,
        `plane_band_m`, `plane_noise_cluster`, `max_tilt_rad`; empty where the defaults serve.
    """

    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera: Camera | None = None
    plane_options: Mapping[str, float] = field(default_factory=dict, hash=False)

    def points(self, depth_m: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Points, shape (n, 3), of a depth image: z [m] per pixel; 0 and NaN are left out.

        Raises
        ------
        ValueError
            Without `camera`, and for a depth image of another size than it.
        """
        depth = np.asarray(depth_m, np.float64)
        if self.camera is None:
            raise ValueError("depth: an image needs the depth camera's own width, height, fx, fy, cx and cy")
        if depth.shape != (self.camera.height, self.camera.width):
            size = " x ".join(str(n) for n in reversed(depth.shape))
            raise ValueError(
                f"depth: {size} pixels, but the depth camera is for {self.camera.width} x {self.camera.height}"
            )
        v, u = np.nonzero(np.isfinite(depth) & (depth > 0.0))
        rays = self.camera.unproject(np.column_stack([u, v]))
        return np.asarray(rays * depth[v, u, None], np.float32)


@dataclass(frozen=True)
class CameraFile:
    """What a calibration file says.

    Attributes
    ----------
    camera : Camera
    depth : DepthCamera, optional
    heading_rad : float
        Of the camera's x axis in the axes of what carries it, counterclockwise from above.
    """

    camera: Camera
    depth: DepthCamera | None = None
    heading_rad: float = 0.0

    @property
    def width(self) -> int:
        """Of the camera's images [px]."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Of the camera's images [px]."""
        return self.camera.height


def _models() -> Any:
    """The file's model; pydantic comes with the extra ``cli``."""
    pydantic = require("pydantic", "cli", "reading a camera file")
    from soopnav_cpp import config  # it needs pydantic

    model: Any = _model_of(pydantic, config)
    return config, model


_cache: list[Any] = []


def _model_of(pydantic: Any, config: Any) -> Any:
    if _cache:
        return _cache[0]
    count = {"pinhole": (0,), "radial_tangential": (0, 4, 5), "fisheye": (4,)}

    def fits(value: object, info: Any) -> object:
        lens = info.data.get("model", "pinhole")
        if isinstance(value, list) and len(value) not in count[lens]:
            wanted = {"pinhole": "no number", "radial_tangential": "four or five numbers", "fisheye": "four numbers"}
            raise ValueError(f"a {lens} lens has {wanted[lens]}, got {len(value)}")
        return value

    def known(value: object) -> object:
        if value not in _LENSES:
            raise ValueError(f"{value!r}; pinhole, radial_tangential or fisheye is needed")
        return value

    size = (int, pydantic.Field(ge=1, le=65535))
    focal = (float, pydantic.Field(gt=0.0))
    lens = {
        "model": (str, "pinhole"),
        "width": size,
        "height": size,
        "fx": focal,
        "fy": focal,
        "cx": (float, ...),
        "cy": (float, ...),
        "distortion": (list[float], pydantic.Field(default_factory=list)),
    }
    checks = {
        "known": pydantic.field_validator("model", mode="after")(known),
        "fits": pydantic.field_validator("distortion", mode="after")(fits),
    }
    optional = {name: (kind | None, None) for name, (kind, _) in lens.items() if name not in ("model", "distortion")}
    depth = pydantic.create_model(
        "DepthModel",
        __base__=config.Model,
        __validators__=checks,
        offset_m=(config.Vector3, (0.0, 0.0, 0.0)),
        model=lens["model"],
        **optional,
        distortion=lens["distortion"],
        plane_sigma_m=(float | None, pydantic.Field(None, gt=0.0)),
        plane_sigma_per_m=(float | None, pydantic.Field(None, ge=0.0)),
        plane_band_m=(float | None, pydantic.Field(None, ge=0.0)),
        plane_noise_cluster=(float | None, pydantic.Field(None, ge=1.0)),
        plane_max_tilt_deg=(float | None, pydantic.Field(None, gt=0.0, lt=90.0)),
    )
    _cache.append(
        pydantic.create_model(
            "CameraModel",
            __base__=config.Model,
            __validators__=checks,
            **lens,
            heading_deg=(float, 0.0),
            depth=(depth | None, None),
        )
    )
    return _cache[0]


def _camera_of(read: Any) -> Camera:
    return Camera(
        read.width, read.height, read.fx, read.fy, read.cx, read.cy, lens=read.model, distortion=read.distortion
    )


def _plane_options(read: Any) -> dict[str, float]:
    given = {option: getattr(read, key) for key, option in _PLANE_KEYS.items() if getattr(read, key) is not None}
    if "max_tilt_rad" in given:
        given["max_tilt_rad"] = float(np.deg2rad(given["max_tilt_rad"]))
    return given


def load_camera(path: str | PathLike[str], *, size: tuple[int, int] | None = None) -> CameraFile:
    """Read a calibration file.

    The file is TOML::

        model = "radial_tangential"      # or "pinhole", "fisheye"
        width = 640
        height = 480
        fx = 525.0
        fy = 525.0
        cx = 319.5
        cy = 239.5
        distortion = [0.01, -0.02, 0.0, 0.0, 0.0]
        heading_deg = 0.0                # of the camera's x axis on what carries it

        [depth]                          # where there is a depth camera
        offset_m = [0.025, 0.0, 0.0]     # its origin seen from this one
        width = 640                      # and, for depth images, its own lens
        plane_sigma_m = 0.0005           # of its noise, a + b z^2: a,
        plane_sigma_per_m = 0.0014       # and b [1/m]
        plane_band_m = 0.01              # points this near to the plane are on it, in place of three sigma; 0: those
        plane_noise_cluster = 1.0        # neighbouring points that share one error
        plane_max_tilt_deg = 45.0        # of the ground against the image plane; more is a wall

    Parameters
    ----------
    path : path
    size : (int, int), optional
        Width and height of the images it is meant for.

    Raises
    ------
    ConfigError
        A ``ValueError``: the file is missing, not TOML or does not fit; one line ``FILE:LINE: KEY: RULE`` per mistake.
        Also when `size` differs from the file's, naming both.
    """
    config, model = _models()
    where = Path(path)
    read = config.load_toml(where, model)
    try:
        camera = _camera_of(read)
        depth = None
        if read.depth is not None:
            given = [getattr(read.depth, name) is not None for name in ("width", "height", "fx", "fy", "cx", "cy")]
            if any(given) and not all(given):
                raise ValueError("depth: give all of width, height, fx, fy, cx and cy, or none")
            lens = _camera_of(read.depth) if all(given) else None
            depth = DepthCamera(tuple(read.depth.offset_m), lens, _plane_options(read.depth))
    except ValueError as error:
        raise config.ConfigError(f"{where}: {error}") from error
    if size is not None and size != (camera.width, camera.height):
        raise config.ConfigError(
            f"{where}: a camera of {camera.width} x {camera.height} pixels, but the images have {size[0]} x {size[1]}"
        )
    return CameraFile(camera, depth, float(np.deg2rad(read.heading_deg)))


def _lines(camera: Camera) -> list[str]:
    numbers = ", ".join(repr(float(k)) for k in camera.distortion)
    return [
        f'model = "{camera.lens}"',
        f"width = {camera.width}",
        f"height = {camera.height}",
        *(f"{name} = {float(getattr(camera, name))!r}" for name in ("fx", "fy", "cx", "cy")),
        f"distortion = [{numbers}]",
    ]


def _plane_lines(options: Mapping[str, float]) -> list[str]:
    keys = {option: key for key, option in _PLANE_KEYS.items()}
    unknown = sorted(set(options) - set(keys))
    if unknown:
        raise ValueError(f"plane_options: {unknown[0]}; {', '.join(keys)} are possible")
    degrees = {name: float(np.rad2deg(x)) if name == "max_tilt_rad" else float(x) for name, x in options.items()}
    return [f"{key} = {degrees[option]!r}" for option, key in keys.items() if option in degrees]


def save_camera(
    path: str | PathLike[str], camera: Camera, *, depth: DepthCamera | None = None, heading_rad: float = 0.0
) -> None:
    """Write a calibration file that `load_camera` reads back to the last digit (angles to rounding)."""
    lines = [*_lines(camera), f"heading_deg = {float(np.rad2deg(heading_rad))!r}"]
    if depth is not None:
        offset = ", ".join(repr(float(x)) for x in depth.offset_m)
        lines += ["", "[depth]", f"offset_m = [{offset}]", *(_lines(depth.camera) if depth.camera else [])]
        lines += _plane_lines(depth.plane_options)
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
