"""``soopnav scan``: the cells of a capture and when they arrive."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import io, lte
from soopnav_cpp.cli import text
from soopnav_cpp.cli.progress import Steps

__all__ = ["Cell", "Scan", "as_json", "print_table", "scan"]


@dataclasses.dataclass(frozen=True)
class Cell:
    """A detection with its time of arrival, when its reference signals could be timed."""

    detection: lte.Detection
    arrival: lte.TimeOfArrival | None

    @property
    def _refined(self) -> lte.Detection | lte.TimeOfArrival:
        """What knows the carrier and the clock better: many frames' arrivals, or else the search."""
        return self.arrival if self.arrival is not None and len(self.arrival) > 3 else self.detection

    @property
    def cfo_hz(self) -> float:
        """Carrier-frequency offset."""
        return self._refined.cfo_hz

    @property
    def clock_error_ppm(self) -> float:
        """How much faster the cell's clock runs than the receiver's."""
        return self._refined.clock_error_ppm

    @property
    def toa(self) -> tuple[float, float] | None:
        """First path's arrival at the capture's start and its standard deviation, seconds."""
        return None if self.arrival is None else lte.arrival_at(self.arrival)


@dataclasses.dataclass(frozen=True)
class Scan:
    """Everything found in a capture."""

    iq: npt.NDArray[np.complex64]
    metadata: io.Metadata
    cells: list[Cell]
    elapsed_s: float


def scan(capture: Path, *, rate_hz: float | None, sample_format: str | None, max_cfo_hz: float, step: Steps) -> Scan:
    """Read, search and time."""
    step(f"reading {capture.name}")
    iq, metadata = io.read_iq(capture, sample_rate_hz=rate_hz, format=sample_format)
    rate = metadata.sample_rate_hz
    start = time.perf_counter()
    step(f"searching {capture.name}")
    try:
        found = lte.search(iq, rate, max_cfo_hz=max_cfo_hz)
    except ValueError as error:
        raise named(error, capture) from error
    cells = []
    for index, detection in enumerate(found):
        step(f"timing cell {detection.cell_id}", done=index, total=len(found))
        try:
            arrival = lte.time_of_arrival(iq, rate, detection)
        except lte.CellLostError:
            arrival = None
        cells.append(Cell(detection, arrival))
    return Scan(iq, metadata, cells, time.perf_counter() - start)


def named(error: ValueError, capture: Path) -> ValueError:
    """The same refusal, about the file instead of the array."""
    message = str(error)
    return ValueError(f"{capture}: {message[4:]}" if message.startswith("iq: ") else message)


def as_json(result: Scan) -> dict[str, Any]:
    """What ``--json`` prints."""
    cells = []
    for cell in result.cells:
        detection, toa = cell.detection, cell.toa
        cells.append(
            {
                "cell_id": detection.cell_id,
                "n_rb": detection.n_rb,
                "n_ports": detection.n_ports,
                "cp": detection.cp.name.lower(),
                "duplex": detection.duplex.name,
                "sfn": detection.sfn,
                "frame_start_s": detection.frame_start_s,
                "cfo_hz": cell.cfo_hz,
                "clock_error_ppm": cell.clock_error_ppm,
                "snr_db": detection.snr_db,
                "toa_s": toa[0] if toa else None,
                "toa_sigma_s": toa[1] if toa else None,
            }
        )
    return {
        "capture": str(result.metadata.path),
        "sample_rate_hz": result.metadata.sample_rate_hz,
        "cells": cells,
    }


def header(metadata: io.Metadata) -> str:
    """``city.sigmf-meta  19.2 Msps  1815.3 MHz  80 ms``."""
    parts = [metadata.path.name, text.rate(metadata.sample_rate_hz)]
    if metadata.center_frequency_hz is not None:
        parts.append(text.megahertz(metadata.center_frequency_hz))
    parts.append(text.duration(metadata.duration_s))
    return "  ".join(parts)


def print_table(result: Scan, console: Console) -> None:
    """The table a person reads."""
    console.print(header(result.metadata), highlight=False, soft_wrap=True)
    if result.cells:
        table = Table(box=None, padding=(0, 1), header_style="bold")
        for name, justify in (
            ("cell", "right"),
            ("duplex", "left"),
            ("CP", "left"),
            ("RB", "right"),
            ("ports", "right"),
            ("SFN", "right"),
            ("CFO", "right"),
            ("clock", "right"),
            ("SNR", "right"),
            ("first path", "left"),
        ):
            table.add_column(name, justify=justify, no_wrap=True)  # type: ignore[arg-type]
        for cell in result.cells:
            detection, toa = cell.detection, cell.toa
            table.add_row(
                str(detection.cell_id),
                detection.duplex.name,
                detection.cp.name.lower(),
                *("?" if v is None else str(v) for v in (detection.n_rb, detection.n_ports, detection.sfn)),
                text.frequency_offset(cell.cfo_hz),
                f"{text.signed(cell.clock_error_ppm, 2)} ppm",
                f"{text.plain(detection.snr_db, 1)} dB",
                f"{text.milliseconds(toa[0])} ± {text.metres(toa[1] * text.SPEED_OF_LIGHT_MPS)}"
                if toa
                else "not resolved",
            )
        console.print(table, highlight=False)
    count = len(result.cells)
    cells = "no cells" if count == 0 else "1 cell" if count == 1 else f"{count} cells"
    speed = result.metadata.duration_s / result.elapsed_s
    console.print(f"{cells} in {result.elapsed_s:.2f} s ({speed:.1f}× real time)", highlight=False, soft_wrap=True)
