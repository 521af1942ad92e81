"""Delay and Doppler of a burst in two recordings: our side, held against the same search in NumPy and SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import dsp, iridium
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["AMBIGUITY_CASES"]


def _pair(rate_hz: float) -> Callable[[], Data]:
    def data() -> Data:
        burst = iridium.make_burst(iridium.BurstKind.LONG, seed=1, duration_s=0.09)
        rng = np.random.default_rng(1)
        n = round(0.09 * rate_hz)
        sigma = math.sqrt(0.05 * rate_hz / 25e3)  # 10 dB in 25 kHz
        sides = [
            burst.render(n, rate_hz, delay_s=delay, doppler_hz=doppler) + sigma * (noise[0] + 1j * noise[1])
            for delay, doppler, noise in (
                (7.3e-6, -1765.5, rng.normal(size=(2, n))),
                (0.0, -3e3, rng.normal(size=(2, n))),
            )
        ]
        return cast(
            Data,
            {
                "a": sides[0].astype(np.complex64),
                "b": sides[1].astype(np.complex64),
                "rate_hz": np.array(rate_hz),
                "bandwidth_hz": np.array(35e3),
            },
        )

    return data


def _ours(data: Data) -> tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]:
    a, b, rate_hz, bandwidth_hz = data["a"], data["b"], float(data["rate_hz"]), float(data["bandwidth_hz"])

    def run() -> Any:
        return dsp.cross_ambiguity(a, b, rate_hz, max_delay_s=20e-6, max_doppler_hz=40e3, bandwidth_hz=bandwidth_hz)

    return run, lambda found: [1e6 * found.tdoa_s, found.fdoa_hz]


AMBIGUITY_CASES = tuple(
    Case(
        name=f"dsp/cross-ambiguity-90ms-{label}",
        title=f"TDOA and FDOA of a 90 ms burst in two recordings of {label}, ±20 µs × ±40 kHz",
        data=_pair(rate_hz),
        ours=_ours,
        peers=(Peer("SciPy", "ambiguity_peers", "cross_ambiguity", ("scipy", "numpy")),),
        tolerance=0.05,
    )
    for label, rate_hz in (("250ksps", 250e3), ("2Msps", 2e6))
)
