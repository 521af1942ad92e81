"""allantools: deviations of frequency standards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import allantools
import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]


def overlapping(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """`oadev` of phases, the averaging times given."""
    phase_s, dt_s, taus = data["phase_s"], float(data["dt_s"]), data["taus"]

    def run() -> Any:
        return allantools.oadev(phase_s, rate=1.0 / dt_s, data_type="phase", taus=taus)

    def answer(result: Any) -> list[float]:
        return [float(value) for value in np.asarray(result[1])]

    return run, answer
