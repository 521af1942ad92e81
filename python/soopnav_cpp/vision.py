"""Camera ego-motion: cameras, corners followed from frame to frame, motion over the ground (nielsen §4).

Camera frame: x right, y down the image, z along the optical axis. Pixels (u, v): whole numbers at the centres of pixels.
"""

from __future__ import annotations

from soopnav_cpp._core import vision as _vision
from soopnav_cpp._core.vision import Camera

__all__ = ["Camera", "available", "opencv_version"]


def available() -> bool:
    """Whether this build can follow corners: it was made with OpenCV. All else here works without."""
    return _vision.tracking_available()


def opencv_version() -> str:
    """Version of the OpenCV that this build uses, such as ``"4.6.0"``; empty without one."""
    return _vision.opencv_version()
