"""Frames of a camera: videos through PyAV, photographs and folders of them through Pillow."""

from __future__ import annotations

import datetime
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp._extras import require

__all__ = ["Frame", "Photo", "Video", "VideoError", "names_as_times", "photo_data", "read_video", "write_video"]

Image = npt.NDArray[np.uint8]
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
_PHOTO_RATE_HZ = 30.0  # of pictures that do not say when they were taken
_WORST_IN_A_ROW = 100  # packets that cannot be decoded, after which the rest is given up
_MOST_ASKED = 1000  # pictures whose clocks are read before their frames are
_TIME = re.compile(r"\d+\.\d+")


class VideoError(ValueError):
    """A video, picture or depth frame cannot be read; the message names the file and the reason."""


@dataclass(frozen=True)
class Photo:
    """What a photograph says of itself (EXIF, and XMP of drones).

    Attributes
    ----------
    time : datetime or None
        When it was taken, by the camera's clock; no time zone.
    latitude_deg, longitude_deg, height_m : float or None
        WGS-84, north and east positive; the height is what the camera states (mostly above the sea).
    above_start_m : float or None
        Height above where the drone took off.
    yaw_deg, pitch_deg, roll_deg : float or None
        Of the camera: yaw clockwise from north, pitch -90 straight down.
    focal_length_mm, focal_length_35mm : float or None
        True, and as if the film were 36 mm wide.
    """

    time: datetime.datetime | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    height_m: float | None = None
    above_start_m: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None


class Frame(NamedTuple):
    """A frame: its time [s] and its grey image, shape (h, w), uint8; of a photograph also what that says.

    `number` counts from 0 and counts frames that could not be decoded as well.
    """

    t_s: float
    image: Image
    photo: Photo | None = None
    number: int = 0


@dataclass(eq=False)
class Video:
    """Frames in turn; iterate over it as often as needed, each time it is read from its beginning.

    Attributes
    ----------
    path : Path
    width, height : int
        Of the first frame [px].
    rate_hz : float
        Frames per second, nominal.
    expected : int
        Frames that the file says it has; 0: it does not say.
    problem : str
        Empty, or after the frames have been read: why there were fewer than there should be.
    first_s : float or None
        Of pictures whose names are their times: what the first name says. Times of frames count from it.
    """

    path: Path
    width: int
    height: int
    rate_hz: float
    expected: int = 0
    problem: str = ""
    first_s: float | None = None
    _duration_s: float = field(default=0.0, repr=False)
    _pictures: tuple[Path, ...] = field(default=(), repr=False)
    _times_s: tuple[float, ...] = field(default=(), repr=False)

    @property
    def frames(self) -> int:
        """Frames that there should be: as the file says, or by how long it lasts; 0 where neither is known."""
        return self.expected or round(self._duration_s * self.rate_hz)

    def __iter__(self) -> Iterator[Frame]:
        self.problem = ""
        return self._photos() if self._pictures else self._decode()

    def _photos(self) -> Iterator[Frame]:
        bad = 0
        for number, (path, time_s) in enumerate(zip(self._pictures, self._times_s, strict=True)):
            try:
                image, photo = _open_photo(path)
            except VideoError as error:
                bad += 1
                more = f" and {bad - 1} more" if bad > 1 else ""
                self.problem = str(error) if bad == 1 else f"{path}{more} cannot be read"
                continue
            yield Frame(time_s, image, photo, number)

    def _decode(self) -> Iterator[Frame]:
        av = require("av", "vision", "reading a video")
        good, bad, row = 0, 0, 0
        reason, last_s = "", 0.0
        bad_pts: list[int | None] = []  # frames come in the order of their times, packets need not
        with _opened(av, self.path) as container:
            stream = container.streams.video[0]
            packets = iter(container.demux(stream))
            while row < _WORST_IN_A_ROW:
                try:
                    packet = next(packets)
                except StopIteration:
                    break
                except av.error.FFmpegError as error:
                    reason = _reason(error)
                    break
                try:
                    frames = packet.decode()
                except av.error.FFmpegError as error:
                    bad, row, reason = bad + 1, row + 1, _reason(error)
                    bad_pts.append(packet.pts)
                    continue
                row = 0
                for frame in frames:
                    time_s = frame.time if frame.time is not None else good / self.rate_hz
                    number = good + sum(pts is None or frame.pts is None or pts < frame.pts for pts in bad_pts)
                    good, last_s = good + 1, float(time_s)
                    yield Frame(float(time_s), np.ascontiguousarray(frame.to_ndarray(format="gray")), None, number)
        short = last_s + 3.0 / self.rate_hz < self._duration_s if not self.expected else good < self.expected
        if short and not self.expected:
            reason = reason or f"it ends at {last_s:.1f} s of {self._duration_s:.1f} s"
        if short or bad or reason:
            of = f" of {self.expected}" if self.expected else ""
            self.problem = f"{self.path}: {good}{of} frames could be decoded" + (f": {reason}" if reason else "")


def _reason(error: Exception) -> str:
    """What the decoder says, without numbers and file names."""
    text = getattr(error, "strerror", None) or str(error)
    return str(text).split(":")[0].strip().lower()


def _opened(av: Any, path: Path) -> Any:
    try:
        return av.open(str(path))
    except FileNotFoundError as error:
        raise VideoError(f"{path}: no such file") from error
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise VideoError(f"{path}: not a video that can be decoded: {_reason(error)}") from error


def _rational(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _angle(parts: Any, side: Any) -> float | None:
    """Degrees from degrees, minutes, seconds and N, S, E or W."""
    try:
        numbers = [_rational(part) for part in parts]
    except TypeError:
        return None
    if len(numbers) != 3 or any(number is None for number in numbers):
        return None
    degrees, minutes, seconds = (float(number or 0.0) for number in numbers)
    return (-1.0 if str(side).upper() in ("S", "W") else 1.0) * (degrees + minutes / 60.0 + seconds / 3600.0)


def _drone(xmp: str, name: str) -> float | None:
    """A number of the drone's own: as an attribute or as an element."""
    found = re.search(rf'drone-dji:{name}(?:="|>)\s*([-+0-9.]+)', xmp)
    return None if found is None else _rational(found[1])


def _said(picture: Any) -> Photo:
    """EXIF and XMP of an opened picture; what is missing or broken is None."""
    exif = picture.getexif()
    inner, place = exif.get_ifd(0x8769), exif.get_ifd(0x8825)
    xmp = picture.info.get("xmp", b"")
    text = xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else str(xmp)
    try:
        time = datetime.datetime.strptime(str(inner.get(0x9003, "")).strip("\0 "), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        time = None
    height = _rational(place.get(6))
    if height is not None and place.get(5) in (1, b"\x01"):
        height = -height
    return Photo(
        time=time,
        latitude_deg=_angle(place.get(2), place.get(1, "N")),
        longitude_deg=_angle(place.get(4), place.get(3, "E")),
        height_m=height,
        above_start_m=_drone(text, "RelativeAltitude"),
        yaw_deg=_drone(text, "GimbalYawDegree"),
        pitch_deg=_drone(text, "GimbalPitchDegree"),
        roll_deg=_drone(text, "GimbalRollDegree"),
        focal_length_mm=_rational(inner.get(0x920A)),
        focal_length_35mm=_rational(inner.get(0xA405)) or None,
    )


def _open_photo(path: Path, *, pixels: bool = True) -> tuple[Image, Photo]:
    """The grey image as it is stored (never turned as EXIF asks), and what the photograph says."""
    pillow = require("PIL.Image", "vision", "reading pictures")
    try:
        with pillow.open(path) as picture:
            photo = _said(picture)
            if not pixels:
                return np.empty((picture.height, picture.width), np.uint8), photo
            if picture.mode in ("I;16", "I", "F"):
                raise VideoError(f"{path}: {picture.mode} pixels; 8 bits each expected of a frame")
            return np.array(picture.convert("L"), dtype=np.uint8), photo
    except FileNotFoundError as error:
        raise VideoError(f"{path}: no such file") from error
    except VideoError:
        raise
    except Exception as error:  # decoders of many formats, each with exceptions of its own
        reason = str(error).split(": ")[-1] or type(error).__name__
        reason = "not a picture" if "cannot identify" in str(error) else reason.lower()
        raise VideoError(f"{path}: cannot be decoded: {reason}") from error


def photo_data(path: str | Path) -> Photo:
    """What a photograph says of itself: time, place, angles of a drone's camera, focal lengths.

    Parameters
    ----------
    path : path

    Returns
    -------
    Photo
        None where the file does not say.

    Raises
    ------
    VideoError
        For what is not a picture.
    """
    return _open_photo(Path(path), pixels=False)[1]


def names_as_times(paths: Sequence[Path]) -> list[float] | None:
    """Seconds that the names of files are (``1305031102.175304.png``); None if they are not, or do not rise."""
    if not paths or not all(_TIME.fullmatch(path.stem) for path in paths):
        return None
    times = [float(path.stem) for path in paths]
    return None if any(b <= a for a, b in itertools.pairwise(times)) else times


def _taken(path: Path) -> datetime.datetime | None:
    try:
        return _open_photo(path, pixels=False)[1].time
    except VideoError:  # told of when its turn comes
        return None


def _when(paths: Sequence[Path], rate_hz: float | None) -> tuple[list[float], float | None]:
    """Times of pictures [s]: at a rate, by their names, by their clocks, or at 30 Hz; and what the first name says."""
    if rate_hz is None:
        times = names_as_times(paths)
        if times is not None:
            return [time - times[0] for time in times], times[0]
        taken = [stamp for stamp in map(_taken, paths) if stamp is not None] if len(paths) <= _MOST_ASKED else []
        if len(taken) == len(paths) and all(b > a for a, b in itertools.pairwise(taken)):
            return [(stamp - taken[0]).total_seconds() for stamp in taken], None
    return [k / (rate_hz or _PHOTO_RATE_HZ) for k in range(len(paths))], None


def _size(paths: Sequence[Path]) -> tuple[int, int]:
    """Height and width of the first picture that can be read; refused as the first one is if none can."""
    refused: VideoError | None = None
    for path in paths:
        try:
            image, _ = _open_photo(path, pixels=False)
        except VideoError as error:
            refused = refused or error
        else:
            return image.shape
    raise refused or VideoError("path: at least one picture expected, got none")


def _natural(path: Path) -> list[tuple[bool, int, str]]:
    """For sorting names: frame_9 before frame_10."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", path.name)]


def read_video(path: str | Path | Sequence[str | Path], *, rate_hz: float | None = None) -> Video:
    """Open the frames of a camera: a video, a folder of pictures, one picture, or several.

    Parameters
    ----------
    path : path or sequence of paths
        A video file (whatever PyAV decodes), a folder of pictures (in the order of their names, numbers as numbers), or
        pictures.
    rate_hz : float, optional
        Of pictures. Without it their times are those that their names are (``12.05.png``), those of their clocks (EXIF)
        where these rise, or 30 a second. Of a video its own times count.

    Returns
    -------
    Video
        Iterates over `Frame`: ``t_s`` [s], ``image`` (h, w) uint8, C-contiguous, ``photo`` and ``number``. Decoded one
        by one. What cannot be decoded is left out, and ``problem`` then says so: a truncated video gives its good
        frames. ``number`` goes on counting over what is left out.

    Raises
    ------
    VideoError
        For a file that is not there, not a video, without any frame; for a folder without pictures.
    MissingExtraError
        Without PyAV or Pillow (extra ``vision``).
    """
    if rate_hz is not None and not (math.isfinite(rate_hz) and rate_hz > 0.0):
        raise ValueError(f"rate_hz: {rate_hz:g}: a positive number expected")
    if not isinstance(path, (str, Path)):
        pictures = [Path(one) for one in path]
        where = pictures[0].parent if pictures else Path()
        if not pictures:
            raise VideoError("path: at least one picture expected, got none")
    else:
        where = Path(path)
        if where.is_dir():
            pictures = sorted((p for p in where.iterdir() if p.suffix.lower() in _PICTURES), key=_natural)
            if not pictures:
                raise VideoError(f"{where}: no pictures in it; names that end in {', '.join(_PICTURES[:4])} expected")
        else:
            pictures = [where] if where.suffix.lower() in _PICTURES else []
    if pictures:
        first = _size(pictures)
        times, first_s = _when(pictures, rate_hz)
        steps = np.diff(times)
        rate = rate_hz or (float(1.0 / np.median(steps)) if steps.size else _PHOTO_RATE_HZ)
        count, (height, width) = len(pictures), first
        return Video(
            where, width, height, rate, count, first_s=first_s, _pictures=tuple(pictures), _times_s=tuple(times)
        )
    av = require("av", "vision", "reading a video")
    if not where.exists():
        raise VideoError(f"{where}: no such file")
    with _opened(av, where) as container:
        if not container.streams.video:
            raise VideoError(f"{where}: no video in it")
        stream = container.streams.video[0]
        rate = float(stream.average_rate or stream.base_rate or _PHOTO_RATE_HZ)
        video = Video(where, stream.width, stream.height, rate, int(stream.frames or 0))
        video._duration_s = 1e-6 * float(container.duration or 0)
        try:
            one = next(container.decode(stream), None)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise VideoError(f"{where}: not a video that can be decoded: {_reason(error)}") from error
        if one is None:
            raise VideoError(f"{where}: no frame in it that can be decoded")
        video.width, video.height = one.width, one.height
    return video


def write_video(
    path: str | Path, frames: Iterable[npt.NDArray[np.uint8]], *, rate_hz: float = 20.0, lossless: bool = False
) -> int:
    """Write frames as a video.

    Parameters
    ----------
    path : path
        Its ending says the container: ``.mp4``, ``.mkv``, ``.avi``, ...; ``.gif`` goes through Pillow.
    frames : iterable of ndarray, shape (h, w) grey or (h, w, 3) RGB, uint8
        All alike. They are taken one by one.
    rate_hz : float
        Frames per second.
    lossless : bool
        FFV1 (in ``.mkv`` or ``.avi``): every pixel comes back. Otherwise MPEG-4 of high quality.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    VideoError
        For no frames, frames that differ in size, and a container that cannot be written.
    MissingExtraError
        Without PyAV or Pillow (extra ``vision``).
    """
    where = Path(path)
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        raise ValueError(f"rate_hz: {rate_hz:g}: a positive number expected")
    if where.suffix.lower() == ".gif":
        return _write_gif(where, frames, rate_hz)
    av = require("av", "vision", "writing a video")
    written, shape = 0, None
    try:
        with av.open(str(where), "w") as container:
            stream: Any = None
            for image in frames:
                if stream is None:
                    shape = _checked_shape(image)
                    stream = container.add_stream(
                        "ffv1" if lossless else "mpeg4", rate=Fraction(rate_hz).limit_denominator(1000)
                    )
                    stream.height, stream.width = shape[:2]
                    grey = lossless and len(shape) == 2
                    stream.pix_fmt = "gray" if grey else ("bgr0" if lossless else "yuv420p")
                    if not lossless:
                        stream.codec_context.qmin, stream.codec_context.qmax = 2, 4
                elif image.shape != shape:
                    raise VideoError(f"{where}: frame {written}: shape {image.shape} after {shape}")
                kind = "gray" if image.ndim == 2 else "rgb24"
                for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=kind)):
                    container.mux(packet)
                written += 1
            if stream is None:
                raise VideoError(f"{where}: no frames to write")
            for packet in stream.encode():
                container.mux(packet)
    except av.error.FFmpegError as error:
        raise VideoError(f"{where}: cannot be written: {_reason(error)}") from error
    return written


def _checked_shape(image: npt.NDArray[Any]) -> tuple[int, ...]:
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise VideoError(f"frames: shape (h, w) or (h, w, 3) of uint8 expected, got {image.dtype} of {image.shape}")
    return image.shape


def _write_gif(path: Path, frames: Iterable[npt.NDArray[np.uint8]], rate_hz: float) -> int:
    pillow = require("PIL.Image", "vision", "writing a GIF")
    pictures = []
    for image in frames:
        _checked_shape(image)
        pictures.append(pillow.fromarray(np.ascontiguousarray(image)).quantize(64))
    if not pictures:
        raise VideoError(f"{path}: no frames to write")
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=max(20, round(1000.0 / rate_hz)),
        loop=0,
        optimize=True,
    )
    return len(pictures)
