"""``soopnav scan --signal iridium``: the bursts of a capture."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import io, iridium
from soopnav_cpp.cli import text
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.cli.scan import header, named

__all__ = ["BurstScan", "as_json", "print_table", "scan"]

_KINDS = {
    iridium.SignalClass.BURST: "burst",
    iridium.SignalClass.TONE: "tone",
    iridium.SignalClass.CONTINUOUS: "continuous",
}


@dataclasses.dataclass(frozen=True)
class BurstScan:
    """Everything found in a capture, by time."""

    iq: npt.NDArray[np.complex64]
    metadata: io.Metadata
    signals: list[iridium.DetectedBurst]
    elapsed_s: float

    def channels(self, signal: iridium.DetectedBurst) -> list[iridium.ChannelCandidate]:
        """The channels a burst may belong to; none when the capture's radio frequency is not known."""
        if self.metadata.center_frequency_hz is None or signal.kind is not iridium.SignalClass.BURST:
            return []
        return iridium.channel_candidates(signal.frequency_hz)


def scan(capture: Path, *, rate_hz: float | None, sample_format: str | None, step: Steps) -> BurstScan:
    """Read and search."""
    step(f"reading {capture.name}")
    iq, metadata = io.read_iq(capture, sample_rate_hz=rate_hz, format=sample_format)
    start = time.perf_counter()
    step(f"searching {capture.name}")
    try:
        signals = iridium.detect_bursts(
            iq, metadata.sample_rate_hz, center_frequency_hz=metadata.center_frequency_hz or 0.0, all_signals=True
        )
    except ValueError as error:
        raise named(error, capture) from error
    return BurstScan(iq, metadata, signals, time.perf_counter() - start)


def as_json(result: BurstScan) -> dict[str, Any]:
    """What ``--json`` prints."""
    return {
        "capture": str(result.metadata.path),
        "sample_rate_hz": result.metadata.sample_rate_hz,
        "center_frequency_hz": result.metadata.center_frequency_hz,
        "signals": [
            {
                "kind": _KINDS[signal.kind],
                "start_s": signal.start_s,
                "duration_s": signal.duration_s,
                "frequency_hz": signal.frequency_hz,
                "frequency_sigma_hz": signal.frequency_sigma_hz,
                "bandwidth_hz": signal.bandwidth_hz,
                "snr_db": signal.snr_db,
                "cut_start": signal.cut_start,
                "cut_end": signal.cut_end,
                "channels": [
                    {"channel": c.channel, "frequency_hz": c.frequency_hz, "doppler_hz": c.doppler_hz}
                    for c in result.channels(signal)
                ],
            }
            for signal in result.signals
        ],
    }


def _what(result: BurstScan, signal: iridium.DetectedBurst) -> str:
    if signal.kind is not iridium.SignalClass.BURST:
        return _KINDS[signal.kind]
    return ", ".join(f"{c.channel} {text.signed(c.doppler_hz / 1e3, 1)}" for c in result.channels(signal))


def print_table(result: BurstScan, console: Console) -> None:
    """The table a person reads."""
    console.print(header(result.metadata), highlight=False, soft_wrap=True)
    known = result.metadata.center_frequency_hz is not None
    if result.signals:
        table = Table(box=None, padding=(0, 1), header_style="bold")
        for name, unit, justify in (
            ("start", "ms", "right"),
            ("length", "ms", "right"),
            ("carrier", "MHz" if known else "kHz", "right"),
            ("±", "Hz", "right"),
            ("width", "kHz", "right"),
            ("SNR", "dB", "right"),
            ("channel", "Doppler kHz", "left"),
        ):
            table.add_column(f"{name}\n{unit}", justify=justify, no_wrap=True)  # type: ignore[arg-type]
        for signal in result.signals:
            cut = signal.cut_start or signal.cut_end
            table.add_row(
                text.plain(signal.start_s * 1e3, 2),
                f"{'>' if cut else ''}{text.plain(signal.duration_s * 1e3, 2)}",
                text.plain(signal.frequency_hz / 1e6, 6) if known else text.signed(signal.frequency_hz / 1e3, 3),
                text.plain(signal.frequency_sigma_hz, 0 if signal.frequency_sigma_hz >= 10.0 else 1),
                text.plain(signal.bandwidth_hz / 1e3, 1),
                text.plain(signal.snr_db, 1),
                _what(result, signal),
            )
        console.print(table, highlight=False)
    bursts = sum(signal.kind is iridium.SignalClass.BURST for signal in result.signals)
    others = len(result.signals) - bursts
    words = "no bursts" if bursts == 0 else "1 burst" if bursts == 1 else f"{bursts} bursts"
    if others:
        words += f", {others} other signal{'s' if others > 1 else ''}"
    speed = result.metadata.duration_s / result.elapsed_s
    console.print(f"{words} in {result.elapsed_s:.2f} s ({speed:.1f}× real time)", highlight=False, soft_wrap=True)
