"""Captures in and out: SigMF recordings and raw interleaved samples.

Samples come back as ``complex64`` with full scale at 1.0: signed integers are divided by half their range, unsigned
ones (``cu8``) are centred at 127.5 first. Floating-point samples are left as they are. Recordings of several channels,
as an array of antennas makes them, are one row per channel.

`read_kiwi` reads recordings of KiwiSDR receivers, whose GNSS time tags give rate and start.

Cameras: `read_video` gives the frames of a video, of a folder of pictures or of photographs, `read_depth` the points
that a depth camera saw beside them (extra ``vision``).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._depth import DepthFolder, depth_to_points, read_depth
from soopnav_cpp._extras import require
from soopnav_cpp._kiwi import KiwiRecording, read_kiwi, write_kiwi
from soopnav_cpp._pcd import read_point_cloud
from soopnav_cpp._video import Frame, Photo, Video, VideoError, photo_data, read_video, write_video

__all__ = [
    "RAW_FORMATS",
    "CaptureError",
    "DepthFolder",
    "Frame",
    "KiwiRecording",
    "Metadata",
    "Photo",
    "Video",
    "VideoError",
    "depth_to_points",
    "photo_data",
    "read_depth",
    "read_iq",
    "read_iq_channels",
    "read_kiwi",
    "read_point_cloud",
    "read_video",
    "write_iq",
    "write_iq_channels",
    "write_kiwi",
    "write_video",
]

#: Formats of raw files: complex, interleaved I then Q, little-endian.
RAW_FORMATS = ("cu8", "ci8", "ci16", "cf32")

_DATATYPE = re.compile(r"^(?P<kind>[cr])(?P<number>f32|f64|i8|i16|i32|u8|u16|u32)(?:_(?P<order>le|be))?$")
_HASH_BLOCK = 1 << 20


class CaptureError(ValueError):
    """A capture cannot be read or written; the message names the file and what was expected of it."""


@dataclasses.dataclass(frozen=True)
class Metadata:
    """What is known about a capture besides its samples.

    Attributes
    ----------
    path : Path
        The file that was named: a ``.sigmf-meta`` file or the raw file.
    sample_rate_hz : float
        Complex samples per second.
    format : str
        Format of the stored samples, such as ``"ci8"`` or ``"cf32_le"``.
    n_samples : int
        Number of complex samples, of each channel.
    center_frequency_hz : float or None
        Radio frequency that lies at 0 Hz of the baseband, when known.
    datetime_utc : str or None
        Time of the first sample (ISO 8601), when known.
    description : str or None
    n_channels : int
        Channels that were sampled together.
    """

    path: Path
    sample_rate_hz: float
    format: str
    n_samples: int
    center_frequency_hz: float | None = None
    datetime_utc: str | None = None
    description: str | None = None
    n_channels: int = 1

    @property
    def duration_s(self) -> float:
        """Length of the capture in seconds."""
        return self.n_samples / self.sample_rate_hz


@dataclasses.dataclass(frozen=True)
class _Format:
    """How a complex sample is stored."""

    dtype: np.dtype[Any]  # of one component
    offset: float
    scale: float

    @property
    def sample_bytes(self) -> int:
        return 2 * self.dtype.itemsize

    def decode(self, raw: npt.NDArray[Any]) -> npt.NDArray[np.complex64]:
        """Components as stored, I and Q in turn, to samples."""
        if self.dtype == np.dtype("<f4"):
            return raw.view(np.complex64)
        iq = raw.astype(np.float32)
        if self.offset:
            iq -= np.float32(self.offset)
        if self.scale != 1.0:
            iq *= np.float32(1.0 / self.scale)
        return iq.view(np.complex64)

    def encode(self, iq: npt.NDArray[np.complex64]) -> npt.NDArray[Any]:
        """Samples to components as stored; integers are rounded and clipped to their range."""
        parts = np.ascontiguousarray(iq).view(np.float32)
        if self.dtype.kind == "f":
            return parts.astype(self.dtype)
        limits = np.iinfo(self.dtype)
        levels = np.rint(parts.astype(np.float64) * self.scale + self.offset)
        return np.clip(levels, limits.min, limits.max).astype(self.dtype)


def _parse_format(name: str, where: str) -> _Format:
    match = _DATATYPE.match(name)
    if match is None:
        raise CaptureError(f"{where}: format {name!r} is unknown; expected one of {', '.join(RAW_FORMATS)}")
    if match["kind"] == "r":
        raise CaptureError(f"{where}: format {name!r} holds real samples; complex ones (c...) are needed")
    order = ">" if match["order"] == "be" else "<"
    kind, bits = match["number"][0], int(match["number"][1:])
    half = 2.0 ** (bits - 1)
    dtype = np.dtype(f"{order}{kind}{bits // 8}")
    if kind == "f":
        return _Format(dtype, offset=0.0, scale=1.0)
    if kind == "u":
        return _Format(dtype, offset=half - 0.5, scale=half - 0.5)
    return _Format(dtype, offset=0.0, scale=half)


def _checked_rate(rate_hz: object, where: str) -> float:
    if isinstance(rate_hz, bool) or not isinstance(rate_hz, (int, float, np.integer, np.floating)):
        raise CaptureError(f"{where}: sample rate is {rate_hz!r}; a number of samples per second is needed")
    rate = float(rate_hz)
    if not (math.isfinite(rate) and rate > 0.0):
        raise CaptureError(f"{where}: sample rate is {rate:g} Hz; it must be above zero")
    return rate


def _read_components(
    path: Path, fmt: _Format, name: str, skip: list[tuple[int, int]], trailing_bytes: int, channels: int = 1
) -> npt.NDArray[Any]:
    """Components of `path` without the headers that `skip` lists as (first sample after it, its bytes).

    With several channels a sample of each follows in turn, and samples are counted per channel.
    """
    frame_bytes = channels * fmt.sample_bytes
    size = path.stat().st_size
    if size == 0:
        raise CaptureError(f"{path}: the file is empty; {name} samples expected")
    other = sum(n for _, n in skip) + trailing_bytes
    if size <= other:
        raise CaptureError(f"{path}: {size} bytes, but the metadata skips {other} of them; truncated?")
    if (size - other) % frame_bytes:
        of_channels = f" of {channels} channels" if channels > 1 else ""
        raise CaptureError(
            f"{path}: {size - other} bytes of samples are not a whole number of {name} samples{of_channels} "
            f"({frame_bytes} bytes each); truncated, or another format?"
        )
    n_samples = (size - other) // frame_bytes
    parts = []
    position, done = 0, 0
    for start, header in [*skip, (n_samples, 0)]:
        if start > n_samples:
            raise CaptureError(
                f"{path}: holds {n_samples} samples, but the metadata has a segment at sample {start}; truncated?"
            )
        if start > done:
            parts.append(np.fromfile(path, dtype=fmt.dtype, count=2 * channels * (start - done), offset=position))
            position += (start - done) * frame_bytes
            done = start
        position += header
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _sha512(path: Path) -> str:
    digest = hashlib.sha512()
    with path.open("rb") as file:
        while block := file.read(_HASH_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _load_metadata(path: Path) -> dict[str, Any]:
    sigmf_validate = require("sigmf.validate", "io", "reading SigMF")
    jsonschema = require("jsonschema", "io", "reading SigMF")
    try:
        metadata = json.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not a text file; SigMF metadata (JSON) expected") from error
    except json.JSONDecodeError as error:
        raise CaptureError(f"{path}:{error.lineno}: not JSON ({error.msg}); SigMF metadata expected") from error
    except RecursionError as error:
        raise CaptureError(f"{path}: JSON nested too deeply; SigMF metadata expected") from error
    if not isinstance(metadata, dict) or not isinstance(metadata.get("global"), dict):
        raise CaptureError(f"{path}: no 'global' object; SigMF metadata expected")
    # These two are checked here first, for a plainer sentence than the schema's.
    if "core:datatype" not in metadata["global"]:
        raise CaptureError(f"{path}: core:datatype is missing; the format of the samples is needed")
    if "core:sample_rate" in metadata["global"]:
        _checked_rate(metadata["global"]["core:sample_rate"], str(path))
    try:
        sigmf_validate.validate(metadata)
    except jsonschema.ValidationError as error:
        place = ".".join(str(part) for part in error.absolute_path) or "metadata"
        raise CaptureError(f"{path}: {place}: {error.message.splitlines()[0]}") from error
    return metadata


def _read_sigmf(
    path: Path, sample_rate_hz: float | None, *, one_channel: bool
) -> tuple[npt.NDArray[np.complex64], Metadata]:
    metadata = _load_metadata(path)
    info, captures = metadata["global"], metadata.get("captures", [])
    if sample_rate_hz is None and "core:sample_rate" not in info:
        raise CaptureError(f"{path}: core:sample_rate is missing; give the sample rate (sample_rate_hz, --rate)")
    rate = _checked_rate(info["core:sample_rate"] if sample_rate_hz is None else sample_rate_hz, str(path))
    name = str(info["core:datatype"])
    fmt = _parse_format(name, f"{path}: core:datatype")
    channels = int(info.get("core:num_channels", 1))
    if one_channel and channels != 1:
        raise CaptureError(f"{path}: core:num_channels is {channels}; recordings of one channel are read")
    if channels < 1:
        raise CaptureError(f"{path}: core:num_channels is {channels}; it must be at least 1")
    if info.get("core:metadata_only"):
        raise CaptureError(f"{path}: core:metadata_only is set, so there are no samples to read")
    tuned = sorted({c["core:frequency"] for c in captures if "core:frequency" in c})
    if len(tuned) > 1:
        raise CaptureError(f"{path}: captures are tuned to {len(tuned)} frequencies; one is needed")

    data = path.parent / info["core:dataset"] if "core:dataset" in info else path.with_suffix(".sigmf-data")
    if not data.is_file():
        raise CaptureError(f"{path}: its data file {data.name} is not there")
    skip = [(int(c["core:sample_start"]), int(c.get("core:header_bytes", 0))) for c in captures]
    if skip != sorted(skip):
        raise CaptureError(f"{path}: captures are not in order of core:sample_start")
    raw = _read_components(data, fmt, name, skip, int(info.get("core:trailing_bytes", 0)), channels)
    n_samples = raw.size // (2 * channels)
    for index, note in enumerate(metadata.get("annotations", [])):
        end = int(note["core:sample_start"]) + int(note.get("core:sample_count", 0))
        if end > n_samples:
            raise CaptureError(
                f"{data}: holds {n_samples} samples, but annotations[{index}] of {path.name} reaches sample {end}; "
                "truncated?"
            )
    if "core:sha512" in info and _sha512(data) != str(info["core:sha512"]).lower():
        raise CaptureError(f"{data}: SHA-512 differs from core:sha512 of {path.name}; truncated or changed")
    first = captures[0] if captures else {}
    return fmt.decode(raw), Metadata(
        path=path,
        sample_rate_hz=rate,
        format=name,
        n_samples=n_samples,
        center_frequency_hz=float(tuned[0]) if tuned else None,
        datetime_utc=first.get("core:datetime"),
        description=info.get("core:description"),
        n_channels=channels,
    )


def _metadata_path(path: Path) -> Path | None:
    """The metadata file that `path` stands for, or None for a raw file."""
    if path.suffix in (".sigmf-meta", ".sigmf-data"):
        return path.with_suffix(".sigmf-meta")
    if not path.exists():
        beside = path.with_name(path.name + ".sigmf-meta")
        if beside.exists():
            return beside
    return None


def read_iq(
    path: str | os.PathLike[str], *, sample_rate_hz: float | None = None, format: str | None = None
) -> tuple[npt.NDArray[np.complex64], Metadata]:
    """Read a capture.

    Parameters
    ----------
    path : path
        A SigMF recording (its ``.sigmf-meta`` or ``.sigmf-data`` file, or their common stem) or a raw file of
        interleaved I and Q. ``core:header_bytes``, ``core:trailing_bytes`` and ``core:dataset`` are honoured.
    sample_rate_hz : float, optional
        Needed for a raw file; goes before ``core:sample_rate`` of a SigMF recording.
    format : {"cu8", "ci8", "ci16", "cf32"}, optional
        For a raw file; the suffix (``.cu8`` ...) says it too. Refused for SigMF, which names its own.

    Returns
    -------
    iq : ndarray, shape (n,), complex64
        Samples with full scale at 1.0. NaN in the file stays NaN.
    metadata : Metadata

    Raises
    ------
    CaptureError
        (a ``ValueError``) for an empty or truncated file, a byte count that is not whole, an unknown format, a rate
        that is not above zero, metadata that does not fit its data.
    FileNotFoundError
        When `path` is not there.

    Examples
    --------
    >>> iq, meta = read_iq("city.sigmf-meta")  # doctest: +SKIP
    """
    given = Path(path)
    meta = _metadata_path(given)
    if meta is not None:
        if not meta.is_file():
            raise FileNotFoundError(f"{meta}: no such file")
        if format is not None:
            raise CaptureError(f"{meta}: format={format!r} is for raw files; SigMF metadata says its own")
        return _read_sigmf(meta, sample_rate_hz, one_channel=True)

    if given.is_dir():
        raise CaptureError(f"{given}: a folder; a SigMF recording or a raw file expected")
    if not given.exists():
        raise FileNotFoundError(f"{given}: no such file")
    if given.suffix in (".sigmf", ".gz", ".xz", ".zip", ".tar"):
        raise CaptureError(f"{given}: an archive; unpack it and name the .sigmf-meta file")
    name = format if format is not None else given.suffix.removeprefix(".")
    if format is None and name not in RAW_FORMATS:
        raise CaptureError(
            f"{given}: not SigMF, so the format of its samples is needed (format, --format): "
            f"one of {', '.join(RAW_FORMATS)}"
        )
    fmt = _parse_format(name, str(given))
    if sample_rate_hz is None:
        raise CaptureError(f"{given}: not SigMF, so the sample rate is needed (sample_rate_hz, --rate)")
    rate = _checked_rate(sample_rate_hz, str(given))
    raw = _read_components(given, fmt, name, [], 0)
    return fmt.decode(raw), Metadata(path=given, sample_rate_hz=rate, format=name, n_samples=raw.size // 2)


def read_iq_channels(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], *, sample_rate_hz: float | None = None
) -> tuple[npt.NDArray[np.complex64], Metadata]:
    """Read channels that were sampled together, as an array of antennas gives them.

    Parameters
    ----------
    path : path, or sequence of paths
        One SigMF recording with ``core:num_channels``, whose samples lie in turn: the first of every channel, the
        second of every channel. Or one recording of a single channel per antenna, in the order of the antennas; they
        must agree in rate, frequency and length.
    sample_rate_hz : float, optional
        Goes before ``core:sample_rate``.

    Returns
    -------
    iq : ndarray, shape (channels, n), complex64
        C-contiguous, full scale at 1.0. A recording of one channel is one row.
    metadata : Metadata
        Of the recording, or of the first of several.

    Raises
    ------
    CaptureError
        As `read_iq`; for a raw file, which does not say its channels; for recordings that do not fit together.
    FileNotFoundError
        When a recording is not there.
    """
    if not isinstance(path, (str, os.PathLike)):
        return _read_side_by_side([Path(part) for part in path], sample_rate_hz)
    given = Path(path)
    meta = _metadata_path(given)
    if meta is None:
        if not given.exists():
            raise FileNotFoundError(f"{given}: no such file")
        raise CaptureError(f"{given}: not SigMF; a recording with core:num_channels is needed to know its channels")
    if not meta.is_file():
        raise FileNotFoundError(f"{meta}: no such file")
    iq, metadata = _read_sigmf(meta, sample_rate_hz, one_channel=False)
    return np.ascontiguousarray(iq.reshape(metadata.n_samples, metadata.n_channels).T), metadata


def _read_side_by_side(paths: list[Path], sample_rate_hz: float | None) -> tuple[npt.NDArray[np.complex64], Metadata]:
    if not paths:
        raise CaptureError("path: no recording given; one per channel is needed")
    rows: list[npt.NDArray[np.complex64]] = []
    first: Metadata | None = None
    for path in paths:
        iq, metadata = read_iq(path, sample_rate_hz=sample_rate_hz)
        first = metadata if first is None else first
        for name in ("sample_rate_hz", "center_frequency_hz", "n_samples"):
            if getattr(metadata, name) != getattr(first, name):
                raise CaptureError(
                    f"{metadata.path}: {name} is {getattr(metadata, name)}, that of {first.path} is "
                    f"{getattr(first, name)}; channels of one array agree"
                )
        rows.append(iq)
    assert first is not None
    return np.stack(rows), dataclasses.replace(first, n_channels=len(rows))


def write_iq(
    path: str | os.PathLike[str],
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    *,
    format: str = "cf32",
    center_frequency_hz: float | None = None,
    datetime_utc: str | None = None,
    description: str | None = None,
) -> Path:
    """Write a SigMF recording: ``NAME.sigmf-data`` and ``NAME.sigmf-meta`` with its SHA-512.

    Parameters
    ----------
    path : path
        ``NAME``, with or without ``.sigmf-meta``. Existing files are replaced.
    iq : array_like, shape (n,), complex
        Full scale is 1.0. Integer formats round to the nearest level and clip beyond it; NaN and infinity are refused.
    sample_rate_hz : float
    format : {"cf32", "ci16", "ci8", "cu8"}
    center_frequency_hz, datetime_utc, description : optional
        ``core:frequency``, ``core:datetime`` and ``core:description``.

    Returns
    -------
    Path
        The ``.sigmf-meta`` file.

    Raises
    ------
    CaptureError
        For an empty or two-dimensional array, NaN in an integer format, an unknown format, a rate that is not above
        zero.
    """
    meta = _written_path(path)
    samples = np.asarray(iq, dtype=np.complex64)
    if samples.ndim != 1 or samples.size == 0:
        raise CaptureError(f"{meta}: iq has shape {samples.shape}; one dimension and at least one sample needed")
    return _write_sigmf(meta, samples, 1, sample_rate_hz, format, center_frequency_hz, datetime_utc, description)


def write_iq_channels(
    path: str | os.PathLike[str],
    iq: npt.NDArray[np.complex64],
    sample_rate_hz: float,
    *,
    format: str = "cf32",
    center_frequency_hz: float | None = None,
    datetime_utc: str | None = None,
    description: str | None = None,
) -> Path:
    """Write channels that were sampled together as one SigMF recording with ``core:num_channels``.

    Parameters
    ----------
    path : path
        As for `write_iq`.
    iq : array_like, shape (channels, n), complex
        Full scale is 1.0. Stored in turn: the first sample of every channel, then the second of every channel.
    sample_rate_hz, format, center_frequency_hz, datetime_utc, description
        As for `write_iq`.

    Returns
    -------
    Path
        The ``.sigmf-meta`` file, for `read_iq_channels`.

    Raises
    ------
    CaptureError
        For anything but two dimensions with at least one channel and one sample; otherwise as `write_iq`.
    """
    meta = _written_path(path)
    samples = np.asarray(iq, dtype=np.complex64)
    if samples.ndim != 2 or samples.size == 0:
        raise CaptureError(
            f"{meta}: iq has shape {samples.shape}; two dimensions, channels and samples, and one of each at least"
        )
    flat = np.ascontiguousarray(samples.T).reshape(-1)
    return _write_sigmf(
        meta, flat, samples.shape[0], sample_rate_hz, format, center_frequency_hz, datetime_utc, description
    )


def _written_path(path: str | os.PathLike[str]) -> Path:
    given = Path(path)
    named = given.suffix in (".sigmf-meta", ".sigmf-data")
    return given.with_suffix(".sigmf-meta") if named else given.with_name(given.name + ".sigmf-meta")


def _write_sigmf(
    meta: Path,
    samples: npt.NDArray[np.complex64],
    channels: int,
    sample_rate_hz: float,
    format: str,
    center_frequency_hz: float | None,
    datetime_utc: str | None,
    description: str | None,
) -> Path:
    sigmf = require("sigmf", "io", "writing SigMF")
    sigmf_validate = require("sigmf.validate", "io", "writing SigMF")
    data = meta.with_suffix(".sigmf-data")
    fmt = _parse_format(format, str(meta))
    rate = _checked_rate(sample_rate_hz, str(meta))
    if fmt.dtype.kind != "f" and not np.isfinite(samples.view(np.float32)).all():
        raise CaptureError(f"{meta}: iq has samples that are not finite; {format} cannot hold them")

    datatype = format if fmt.dtype.itemsize == 1 or "_" in format else format + "_le"
    fmt.encode(samples).tofile(data)
    capture: dict[str, Any] = {"core:sample_start": 0}
    if center_frequency_hz is not None:
        capture["core:frequency"] = float(center_frequency_hz)
    if datetime_utc is not None:
        capture["core:datetime"] = datetime_utc
    info: dict[str, Any] = {
        "core:datatype": datatype,
        "core:sample_rate": rate,
        "core:version": sigmf.__specification__,
        "core:recorder": "soopnav",
        "core:sha512": _sha512(data),
    }
    if channels > 1:
        info["core:num_channels"] = channels
    if description is not None:
        info["core:description"] = description
    metadata = {"global": info, "captures": [capture], "annotations": []}
    sigmf_validate.validate(metadata)
    meta.write_text(json.dumps(metadata, indent=2) + "\n", encoding="utf-8")
    return meta
