"""Bursts found in half a second of 2 Msps: our side, held against a spectrogram of SciPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import iridium
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["IRIDIUM_CASES"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]
_RATE_HZ = 2e6


def _sky() -> Data:
    """0.5 s of noise of power 1, with a ring alert and twelve duplex bursts of 10 dB in 25 kHz."""
    rng = np.random.default_rng(1)
    parts = rng.standard_normal((2, 1_000_000)) * np.sqrt(0.5)
    iq = np.asarray(parts[0] + 1j * parts[1], dtype=np.complex64)
    amplitude = float(np.sqrt(10.0 * 25e3 / _RATE_HZ))
    for i in range(13):
        kind = iridium.BurstKind.RING_ALERT if i == 0 else iridium.BurstKind.DUPLEX
        iq += iridium.make_burst(kind, seed=i).render(
            iq.size, _RATE_HZ, delay_s=0.08 + 0.031 * i, doppler_hz=(-0.9 + 0.14 * i) * 1e6, amplitude=amplitude
        )
    return cast(Data, {"iq": iq, "rate_hz": np.array(_RATE_HZ)})


def _detect(data: Data) -> Timed:
    rate_hz = float(data["rate_hz"])
    # As on a stream: the plans are made once.
    detector = iridium.BurstDetector(rate_hz)

    def run() -> Any:
        return detector.push(data["iq"]) + detector.flush()

    def answer(found: Any) -> list[float]:
        rows = sorted((b.start_s, b.frequency_hz / 1e6) for b in found)
        return [float(len(rows)), *(value for row in rows for value in row)]

    return run, answer


IRIDIUM_CASES: tuple[Case, ...] = (
    Case(
        name="iridium/scan-2msps",
        title="bursts in 0.5 s of 2 Msps; ours cut to 0.1 ms and 2 Hz, the peer to its spectra",
        data=_sky,
        ours=_detect,
        peers=(Peer("scipy", "iridium_peers", "scan"),),
        # Starts within 20 ms, carriers within 20 kHz, and as many bursts.
        tolerance=0.02,
    ),
)
