"""Point clouds in files: .pcd (ascii, binary, compressed), .npy and .npz."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_KINDS = {"F": "f", "I": "i", "U": "u"}
_MOST_BYTES = 1 << 32  # of the numbers of one cloud


def _double(column: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """As double precision; a signalling NaN is a NaN, not a warning."""
    with np.errstate(invalid="ignore"):
        return column.astype(np.float64)


class _Header:
    """Fields and sizes of a .pcd file; `start` is where its data begins."""

    def __init__(self, path: Path, content: bytes) -> None:
        self.path = path
        entries: dict[str, list[str]] = {}
        at = 0
        while "DATA" not in entries:
            end = content.find(b"\n", at)
            if end < 0 or end - at > 4096:
                raise ValueError(f"{path}: no DATA line; a .pcd file is expected")
            words = content[at:end].decode("ascii", errors="replace").split()
            at = end + 1
            if words and not words[0].startswith("#"):
                entries[words[0].upper()] = words[1:]
        self.start = at
        self.names = entries.get("FIELDS", entries.get("COLUMNS", []))
        if not {"x", "y", "z"} <= set(self.names):
            raise ValueError(f"{path}: fields {' '.join(self.names) or '(none)'}; x, y and z are needed")
        count = self._numbers(entries, "COUNT", ["1"] * len(self.names))
        size = self._numbers(entries, "SIZE", None)
        kinds = entries.get("TYPE", [])
        if len(kinds) != len(self.names):
            raise ValueError(f"{path}: TYPE has {len(kinds)} entries for {len(self.names)} fields")
        self.types: list[np.dtype[np.void | np.number]] = []
        for name, kind, each in zip(self.names, kinds, size, strict=True):
            if kind not in _KINDS or each not in (1, 2, 4, 8) or (kind == "F" and each < 4):
                raise ValueError(f"{path}: field {name} has TYPE {kind} SIZE {each}; F, I or U of 1, 2, 4 or 8 bytes")
            self.types.append(np.dtype(f"<{_KINDS[kind]}{each}"))
        if min(count) < 1:
            raise ValueError(f"{path}: COUNT {min(count)}; it must be at least 1")
        self.counts = count
        points = entries.get("POINTS")
        if points is None:
            points = [
                str(int(np.prod(self._numbers(entries, "WIDTH", None, 1) + self._numbers(entries, "HEIGHT", None, 1))))
            ]
        if len(points) != 1 or not points[0].isdigit():
            raise ValueError(f"{path}: POINTS {' '.join(points)}; a whole number is needed")
        self.points = int(points[0])
        if self.points * self.row_bytes > _MOST_BYTES:
            raise ValueError(f"{path}: {self.points} points of {self.row_bytes} bytes; at most 4 GiB are read")
        self.data = " ".join(entries["DATA"]).lower()

    def _numbers(
        self, entries: dict[str, list[str]], key: str, default: list[str] | None, expected: int | None = None
    ) -> list[int]:
        words = entries.get(key, default)
        wanted = len(self.names) if expected is None else expected
        if words is None or len(words) != wanted or not all(word.isdigit() for word in words):
            raise ValueError(
                f"{self.path}: {key} {' '.join(words or ['(missing)'])}; {wanted} whole numbers are needed"
            )
        return [int(word) for word in words]

    @property
    def row_bytes(self) -> int:
        return sum(kind.itemsize * count for kind, count in zip(self.types, self.counts, strict=True))


def _unpacked(packed: bytes, size: int, path: Path) -> bytes:
    """LZF: runs of literals and references back."""
    out = bytearray(size)
    at = done = 0
    try:
        while at < len(packed):
            control = packed[at]
            at += 1
            if control < 32:
                length = control + 1
                piece = packed[at : at + length]
                at += length
            else:
                length = control >> 5
                if length == 7:
                    length += packed[at]
                    at += 1
                length += 2
                start = done - ((control & 31) << 8) - packed[at] - 1
                at += 1
                if start < 0:
                    raise IndexError
                piece = bytes(out[start : min(start + length, done)])
                if len(piece) < length:  # overlaps what it writes: repeats
                    piece = (piece * (length // len(piece) + 1))[:length]
            if len(piece) != length or done + length > size:
                raise IndexError
            out[done : done + length] = piece
            done += length
    except IndexError:
        raise ValueError(f"{path}: the compressed data is damaged at byte {at}") from None
    if done != size:
        raise ValueError(f"{path}: {done} bytes after unpacking; the file announces {size}")
    return bytes(out)


def _columns(header: _Header, content: bytes, wanted: Sequence[str]) -> list[npt.NDArray[np.float64]]:
    body = content[header.start :]
    rows = header.points
    positions = [header.names.index(name) for name in wanted]
    if header.data == "ascii":
        width = sum(header.counts)
        words = body.split()
        if len(words) < rows * width:
            raise ValueError(f"{header.path}: {len(words)} numbers; {rows} points of {width} are announced")
        offsets = np.concatenate([[0], np.cumsum(header.counts)])
        try:
            return [np.array(words[offsets[i] : rows * width : width], dtype=np.float64) for i in positions]
        except ValueError as error:
            raise ValueError(f"{header.path}: {error}") from None
    if header.data == "binary":
        if len(body) < rows * header.row_bytes:
            raise ValueError(f"{header.path}: {len(body)} bytes of data; {rows * header.row_bytes} are announced")
        fields = [(f"{i}", kind, (n,)) for i, (kind, n) in enumerate(zip(header.types, header.counts, strict=True))]
        table = np.frombuffer(body, dtype=np.dtype(fields), count=rows)
        return [_double(table[f"{i}"][:, 0]) for i in positions]
    if header.data == "binary_compressed":
        if len(body) < 8:
            raise ValueError(f"{header.path}: the sizes of the compressed data are missing")
        packed, size = (int(value) for value in np.frombuffer(body, dtype="<u4", count=2))
        if len(body) < 8 + packed:
            raise ValueError(f"{header.path}: {len(body) - 8} bytes of compressed data; {packed} are announced")
        if size != rows * header.row_bytes:
            raise ValueError(f"{header.path}: {size} bytes announced; {rows} points need {rows * header.row_bytes}")
        plain = _unpacked(body[8 : 8 + packed], size, header.path)
        ends = np.cumsum([kind.itemsize * n * rows for kind, n in zip(header.types, header.counts, strict=True)])
        columns = []
        for i in positions:  # field after field
            whole = header.types[i].itemsize * header.counts[i] * rows
            column = np.frombuffer(
                plain, dtype=header.types[i], count=rows * header.counts[i], offset=int(ends[i]) - whole
            )
            columns.append(_double(column[:: header.counts[i]]))
        return columns
    raise ValueError(f"{header.path}: DATA {header.data}; ascii, binary or binary_compressed is needed")


def read_point_cloud(path: str | Path, *, field: str | None = None) -> npt.NDArray[np.float32]:
    """Read a point cloud.

    Parameters
    ----------
    path
        ``.pcd`` (ascii, binary or binary_compressed), ``.npy`` of shape (n, 3) or (rows, columns, 3), or ``.npz`` with
        an array ``points`` of that shape (or with a single array).
    field
        Of a ``.pcd`` file: this field in place of x, y, z, such as ``"label"``; shape (n,) comes back.

    Returns
    -------
    numpy.ndarray
        float32 (n, 3), in the file's order and units (metres); NaN where the sensor saw nothing.

    Raises
    ------
    ValueError
        For a file that is damaged or of another kind; says which and what was expected.
    """
    file = Path(path)
    kind = file.suffix.lower()
    if kind in (".npy", ".npz"):
        if field is not None:
            raise ValueError(f"field: {field!r}; only .pcd files have fields")
        return _from_numpy(file)
    if kind != ".pcd":
        raise ValueError(f"{file}: .pcd, .npy or .npz is needed")
    content = file.read_bytes()
    header = _Header(file, content)
    if field is not None:
        if field not in header.names:
            raise ValueError(f"field: {field!r}; {file} has {', '.join(header.names)}")
        return _columns(header, content, [field])[0].astype(np.float32)
    return np.stack(_columns(header, content, ["x", "y", "z"]), axis=1).astype(np.float32)


def _from_numpy(file: Path) -> npt.NDArray[np.float32]:
    try:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            points = loaded
        else:
            with loaded:
                names = list(loaded)
                if "points" in names:
                    points = loaded["points"]
                elif len(names) == 1:
                    points = loaded[names[0]]
                else:
                    raise ValueError(f"arrays {', '.join(names) or '(none)'}; one named points is needed")
    except (OSError, EOFError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{file}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    if points.ndim < 2 or points.shape[-1] != 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"{file}: {points.dtype} {points.shape}; real numbers of shape (n, 3) are needed")
    return np.ascontiguousarray(points.reshape(-1, 3), dtype=np.float32)
