"""Bearings from phases along a path: our side, held against NumPy and SciPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from soopnav_cpp import array, simulation
from soopnav_cpp.bench.harness import Case, Data, Peer

__all__ = ["APERTURE_CASES"]

Timed = tuple[Callable[[], Any], Callable[[Any], Sequence[float]]]
_WAVELENGTH_M = 0.15


def _loop() -> Data:
    """50 snapshots of four nodes around a loop of 5 wavelengths, the receiver's phase free, an offset per node."""
    at = 2.0 * np.pi * np.arange(50) / 50
    path = 5.0 * _WAVELENGTH_M / (2.0 * np.pi) * np.column_stack((np.cos(at), np.sin(at)))
    rng = np.random.default_rng(3)
    time_s = 0.04 * np.arange(50)
    seen = simulation.aperture_snapshots(
        path,
        [0.4, 1.9, -2.6, -0.9],
        _WAVELENGTH_M,
        frequency_hz=[0.0, 2.1, -1.3, 0.6],
        time_s=time_s,
        phase_rad=rng.uniform(-np.pi, np.pi, 50),
        seed=3,
    )
    wavelength = np.array(_WAVELENGTH_M)
    return cast(Data, {"phasors": seen.phasors, "path": path, "time": time_s, "wavelength": wavelength})


def _joint(data: Data) -> Timed:
    aperture = array.SyntheticAperture(coherence_threshold=0.0)
    wavelength = float(data["wavelength"])

    def run() -> Any:
        return aperture.bearings(data["phasors"], data["path"], wavelength, time_s=data["time"])

    def answer(found: Any) -> list[float]:
        return [float(v) for v in found.bearing_rad]

    return run, answer


APERTURE_CASES: tuple[Case, ...] = (
    Case(
        name="array/aperture-50x4",
        title="bearings of 4 nodes from 50 snapshots along a path, free phase: search and likelihood",
        data=_loop,
        ours=_joint,
        peers=(Peer("scipy", "aperture_peers", "joint", ("scipy>=1.10", "numpy")),),
        tolerance=1e-4,
    ),
)
