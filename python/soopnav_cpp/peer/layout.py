"""Where the samples lie in a recording, for reading them a block at a time."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from soopnav_cpp.io import (
    RAW_FORMATS,
    CaptureError,
    _checked_rate,
    _Format,
    _load_metadata,
    _metadata_path,
    _parse_format,
)

__all__ = ["Layout", "Part", "raw_layout", "recording_layout"]


@dataclass(frozen=True)
class Part:
    """Samples that follow each other.

    Attributes
    ----------
    first, end : int
        Samples.
    offset : int
        Byte of the first sample.
    when : str or None
        ``core:datetime``.
    """

    first: int
    end: int
    offset: int
    when: str | None


@dataclass(frozen=True)
class Layout:
    """How samples are stored.

    Attributes
    ----------
    data : Path
    sample_rate_hz : float
    center_frequency_hz : float or None
    parts : tuple of Part
        At least one, none empty, in order.
    """

    data: Path
    sample_rate_hz: float
    center_frequency_hz: float | None
    parts: tuple[Part, ...]
    format: _Format

    @property
    def sample_bytes(self) -> int:
        """Of a complex sample."""
        return self.format.sample_bytes

    def decode(self, raw: npt.NDArray[np.uint8]) -> npt.NDArray[np.complex64]:
        """Bytes to samples with full scale at 1.0."""
        return self.format.decode(np.frombuffer(raw.tobytes(), self.format.dtype))


def raw_layout(name: str, *, sample_rate_hz: float | None, format: str | None) -> Layout:
    """Of samples without a header.

    Raises
    ------
    CaptureError
        Without a rate, or for a format that is not one of `io.RAW_FORMATS`.
    """
    if format not in RAW_FORMATS:
        raise CaptureError(f"{name}: format {format!r}; one of {', '.join(RAW_FORMATS)} expected (--format)")
    if sample_rate_hz is None:
        raise CaptureError(f"{name}: not SigMF, so the sample rate is needed (--rate)")
    return Layout(Path(name), _checked_rate(sample_rate_hz, name), None, (), _parse_format(format, name))


def _whole(size: int, sample_bytes: int, path: Path) -> int:
    if size <= 0:
        raise CaptureError(f"{path}: the file is empty; samples expected")
    if size % sample_bytes:
        raise CaptureError(f"{path}: {size} bytes are not a whole number of samples ({sample_bytes} bytes each)")
    return size // sample_bytes


def recording_layout(
    path: str | os.PathLike[str], *, sample_rate_hz: float | None = None, format: str | None = None
) -> Layout:
    """Of a SigMF recording of one channel, or of a raw file.

    The hash of a recording is not checked: that would read all of it before the first sample.

    Raises
    ------
    CaptureError
        For an empty or truncated file, several channels, and as `io.read_iq`.
    FileNotFoundError
    """
    given = Path(path)
    meta = _metadata_path(given)
    if meta is None:
        if not given.is_file():
            raise FileNotFoundError(f"{given}: no such file")
        name = format if format is not None else given.suffix.removeprefix(".")
        layout = raw_layout(str(given), sample_rate_hz=sample_rate_hz, format=name)
        count = _whole(given.stat().st_size, layout.sample_bytes, given)
        return Layout(given, layout.sample_rate_hz, None, (Part(0, count, 0, None),), layout.format)
    if not meta.is_file():
        raise FileNotFoundError(f"{meta}: no such file")
    if format is not None:
        raise CaptureError(f"{meta}: format={format!r} is for raw files; SigMF metadata says its own")
    metadata = _load_metadata(meta)
    info, captures = metadata["global"], metadata.get("captures", [])
    if int(info.get("core:num_channels", 1)) != 1:
        raise CaptureError(f"{meta}: core:num_channels is {info['core:num_channels']}; one channel expected")
    if sample_rate_hz is None and "core:sample_rate" not in info:
        raise CaptureError(f"{meta}: core:sample_rate is missing; give the sample rate (--rate)")
    rate = _checked_rate(info["core:sample_rate"] if sample_rate_hz is None else sample_rate_hz, str(meta))
    fmt = _parse_format(str(info["core:datatype"]), f"{meta}: core:datatype")
    data = meta.parent / info["core:dataset"] if "core:dataset" in info else meta.with_suffix(".sigmf-data")
    if not data.is_file():
        raise CaptureError(f"{meta}: its data file {data.name} is not there")
    tuned = sorted({float(c["core:frequency"]) for c in captures if "core:frequency" in c})
    if len(tuned) > 1:
        raise CaptureError(f"{meta}: captures are tuned to {len(tuned)} frequencies; one is needed")
    heads = [
        (int(c["core:sample_start"]), int(c.get("core:header_bytes", 0)), c.get("core:datetime")) for c in captures
    ]
    heads = heads or [(0, 0, None)]
    if [h[0] for h in heads] != sorted(h[0] for h in heads):
        raise CaptureError(f"{meta}: captures are not in order of core:sample_start")
    skipped = sum(h[1] for h in heads) + int(info.get("core:trailing_bytes", 0))
    total = _whole(data.stat().st_size - skipped, fmt.sample_bytes, data)
    if heads[-1][0] > total:
        raise CaptureError(f"{data}: holds {total} samples, but the metadata has a segment at sample {heads[-1][0]}")
    parts: list[Part] = []
    header = 0
    for number, (first, extra, when) in enumerate(heads):
        header += extra
        end = heads[number + 1][0] if number + 1 < len(heads) else total
        if end > first:
            parts.append(Part(first, end, first * fmt.sample_bytes + header, when))
    return Layout(data, rate, tuned[0] if tuned else None, tuple(parts), fmt)
