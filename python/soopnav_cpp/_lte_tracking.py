"""Following LTE cells over time; public as `soopnav_cpp.lte`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import io
from soopnav_cpp._core import lte as _lte
from soopnav_cpp._core.lte import Detection, LoopStatus

__all__ = ["CrsLoop", "LoopStatus", "StreamEpoch", "measurement_stream"]

Complex = npt.NDArray[np.complex64]
Rows = npt.NDArray[np.void]

_BLOCK_S = 0.1


class CrsLoop:
    """Carrier phase by a PLL and delay by a DLL that it aids, from the reference signals of one cell.

    Updated once a subframe (FDD: 1 ms; TDD: the downlink ones, found as it goes). Discriminators are the
    maximum-likelihood phase and delay of all ports; the loops start with the gains of a growing memory and end with
    those of their bandwidths (C++ ``lte::CrsLoop``, cpp/doc/lte_tracking.md).

    Parameters
    ----------
    sample_rate_hz : float
        A multiple of 1.92e6, at most 100e6.
    detection : Detection
        Where the cell is in the samples that follow: ``frame_start_s`` within 2 µs, ``cfo_hz`` within 400 Hz.
    carrier_hz : float
        Aids the delay by the carrier; 0: not.
    pll_bandwidth_hz, dll_bandwidth_hz : float
        Noise bandwidths, 0.5 ... 100 and 0.05 ... 50.
    pll_order : int
        2 or 3.
    lost_after_s : float
        Of bad updates, 5e-3 ... 10.

    Raises
    ------
    ValueError
        For a parameter out of range, by name.
    """

    def __init__(
        self,
        sample_rate_hz: float,
        detection: Detection,
        *,
        carrier_hz: float = 0.0,
        pll_bandwidth_hz: float = 15.0,
        pll_order: int = 3,
        dll_bandwidth_hz: float = 1.0,
        lost_after_s: float = 0.05,
    ) -> None:
        self._loop = _lte.CrsLoop(
            sample_rate_hz,
            detection,
            carrier_hz=carrier_hz,
            pll_bandwidth_hz=pll_bandwidth_hz,
            pll_order=pll_order,
            dll_bandwidth_hz=dll_bandwidth_hz,
            lost_after_s=lost_after_s,
        )

    def push(self, block: Complex) -> Rows:
        """Add samples of any number.

        Parameters
        ----------
        block : ndarray, shape (n,), complex64

        Returns
        -------
        ndarray, shape (updates,), structured
            A row for each subframe read: ``time_s`` (from the first sample ever pushed), ``status`` (`LoopStatus`),
            ``toa_s`` (frame start minus whole frames, continuous), ``toa_sigma_s``, ``carrier_phase_cycles`` (grows
            with range: minus the phase received), ``phase_sigma_cycles``, ``cfo_hz``, ``cfo_rate_hz_per_s``,
            ``cn0_dbhz``, ``phase_error_cycles``, ``delay_error_s``, ``lock``, ``subframe``, ``arc`` (only phases of one
            arc continue each other), ``slip`` (the arc began here).
        """
        return self._loop.push(block)

    def skip(self, samples: int) -> None:
        """`samples` were lost before the next block; beyond 20 ms a new arc begins. At most 2^53 in all."""
        self._loop.skip(samples)

    @property
    def position(self) -> int:
        """Samples pushed and skipped."""
        return self._loop.position

    @property
    def subframes(self) -> frozenset[int]:
        """Subframes that are read, of 0 ... 9."""
        return frozenset(s for s in range(10) if self._loop.subframes >> s & 1)


@dataclass(frozen=True)
class StreamEpoch:
    """Cells at one epoch.

    Attributes
    ----------
    time_s : float
        From the first sample, lost ones counted.
    cells : ndarray, shape (cells,), structured
        ``cell_id``, ``status`` (`LoopStatus`), ``toa_s`` (frame start minus whole frames, at the epoch) and
        ``sigma_s``, ``first_path_s`` and ``first_path_sigma_s`` (the same by the first path told apart in the last
        subframe; as ``toa_s`` where ``paths`` is 0), ``excess_s``, ``paths``, ``carrier_phase_cycles`` and
        ``phase_sigma_cycles``, ``cfo_hz``, ``cn0_dbhz``, ``arc``, ``slip``. Every number is finite.
    """

    time_s: float
    cells: Rows


def _blocks(path: Path, sample_rate_hz: float | None) -> tuple[float, float, Iterator[tuple[int, Complex]]]:
    """Rate, carrier (0: unknown) and blocks of a recording with the samples that were lost before each."""
    meta = io._metadata_path(path)
    info: dict[str, Any] = {}
    captures: list[dict[str, Any]] = []
    if meta is not None and meta.is_file():
        document = io._load_metadata(meta)
        info, captures = document["global"], document.get("captures", [])
    plain = (
        bool(info)
        and meta is not None
        and not any(c.get("core:header_bytes") for c in captures)
        and "core:dataset" not in info
        and int(info.get("core:num_channels", 1)) == 1
        and "core:sample_rate" in info
        and meta.with_suffix(".sigmf-data").is_file()
    )
    if not plain or meta is None:
        iq, read = io.read_iq(path, sample_rate_hz=sample_rate_hz)
        step = max(1, int(_BLOCK_S * read.sample_rate_hz))
        whole = ((0, iq[at : at + step]) for at in range(0, len(iq), step))
        return read.sample_rate_hz, read.center_frequency_hz or 0.0, whole

    rate = io._checked_rate(info["core:sample_rate"] if sample_rate_hz is None else sample_rate_hz, str(meta))
    fmt = io._parse_format(str(info["core:datatype"]), f"{meta}: core:datatype")
    stored = np.memmap(meta.with_suffix(".sigmf-data"), dtype=fmt.dtype, mode="r")
    length = stored.size // 2
    # Where the recorder's own count jumps beyond the file's, samples were lost.
    lost: dict[int, int] = {}
    before = 0
    for capture in captures:
        if "core:global_index" in capture:
            at = int(capture["core:sample_start"])
            offset = int(capture["core:global_index"]) - at
            if capture is not captures[0] and offset > before:
                lost[at] = offset - before
            before = offset
    carrier = next((float(c["core:frequency"]) for c in captures if "core:frequency" in c), 0.0)

    def read_blocks() -> Iterator[tuple[int, Complex]]:
        step = max(1, int(_BLOCK_S * rate))
        edges = sorted({0, length, *range(0, length, step), *(at for at in lost if 0 < at < length)})
        for start, end in itertools.pairwise(edges):
            yield lost.get(start, 0), fmt.decode(np.ascontiguousarray(stored[2 * start : 2 * end]))

    return rate, carrier, read_blocks()


def measurement_stream(
    source: Complex | str | os.PathLike[str],
    sample_rate_hz: float | None = None,
    *,
    cells: Sequence[Detection] | None = None,
    rate_hz: float = 10.0,
    carrier_hz: float | None = None,
    search_interval_s: float = 2.0,
    search_window_s: float = 80e-3,
    max_cfo_hz: float = 20e3,
    max_cells: int = 8,
    drop_after_s: float = 2.0,
    resolve: bool = True,
    pll_bandwidth_hz: float = 15.0,
    dll_bandwidth_hz: float = 1.0,
) -> Iterator[StreamEpoch]:
    """Measurements of several cells at a fixed rate, from samples or from a recording read block by block.

    Each cell is followed by a loop as `CrsLoop`, and its paths are told apart at each epoch. Cells appear when a search
    finds them and vanish after `drop_after_s` of loss.

    Parameters
    ----------
    source : ndarray, shape (n,), complex64, or path
        A path names a SigMF recording (mapped, not read whole; ``core:global_index`` tells lost samples) or another
        file of `soopnav_cpp.io.read_iq`.
    sample_rate_hz : float
        A multiple of 1.92e6, at most 100e6; a SigMF recording says its own.
    cells : sequence of Detection, optional
        Known ones, times from the first sample; then nothing is searched. Otherwise cells are searched for.
    rate_hz : float
        Epochs per second, 0.1 ... 100: at 1 / rate_hz, 2 / rate_hz ... from the first sample.
    carrier_hz : float, optional
        Aids the delays; otherwise the recording's, if it says one; 0: not.
    search_interval_s, search_window_s, max_cfo_hz, max_cells, drop_after_s, resolve
        As C++ ``lte::StreamOptions``.
    pll_bandwidth_hz, dll_bandwidth_hz
        As `CrsLoop`.

    Yields
    ------
    StreamEpoch

    Raises
    ------
    ValueError
        For an option out of range, samples of another dtype, or a recording with a gap of more than an hour.
    """
    if isinstance(source, np.ndarray):
        if sample_rate_hz is None:
            raise ValueError("sample_rate_hz: needed with an array of samples")
        rate, carrier = float(sample_rate_hz), 0.0
        step = max(1, int(_BLOCK_S * rate))
        blocks: Iterator[tuple[int, Complex]] = ((0, source[at : at + step]) for at in range(0, len(source), step))
    else:
        rate, carrier, blocks = _blocks(Path(source), sample_rate_hz)
    stream = _lte.MeasurementStream(
        rate,
        list(cells or []),
        carrier_hz=carrier if carrier_hz is None else carrier_hz,
        rate_hz=rate_hz,
        search=cells is None,
        search_interval_s=search_interval_s,
        search_window_s=search_window_s,
        max_cfo_hz=max_cfo_hz,
        max_cells=max_cells,
        drop_after_s=drop_after_s,
        resolve=resolve,
        pll_bandwidth_hz=pll_bandwidth_hz,
        dll_bandwidth_hz=dll_bandwidth_hz,
    )

    def epochs() -> Iterator[StreamEpoch]:
        for lost, block in blocks:
            stream.skip(lost)
            for time_s, rows in stream.push(block):
                yield StreamEpoch(time_s, rows)

    return epochs()
