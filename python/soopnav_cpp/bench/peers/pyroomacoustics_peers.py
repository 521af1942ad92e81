"""pyroomacoustics: direction of arrival in rooms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyroomacoustics

Data = dict[str, npt.NDArray[Any]]


def music(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Its MUSIC on one frequency bin, on the same grid, the object and its steering vectors made beforehand."""
    speed, rate, size, bin_number = 343.0, 16000.0, 256, 32
    wavelength_m = speed / (bin_number * rate / size)
    azimuth, elevation = np.meshgrid(data["azimuth"], data["elevation"])
    finder = pyroomacoustics.doa.algorithms["MUSIC"](
        data["positions_wavelengths"].T * wavelength_m,
        rate,
        size,
        c=speed,
        num_src=1,
        dim=3,
        azimuth=azimuth.ravel(),
        colatitude=np.pi / 2 - elevation.ravel(),
    )
    bins = np.zeros((len(data["iq"]), size // 2 + 1, data["iq"].shape[1]), dtype=np.complex128)
    bins[:, bin_number] = data["iq"]
    block = int(data["block"])

    def run() -> list[tuple[float, float]]:
        out = []
        for first in range(0, bins.shape[2], block):
            finder.locate_sources(bins[:, :, first : first + block], num_src=1, freq_bins=np.array([bin_number]))
            out.append((float(finder.azimuth_recon[0]), float(finder.colatitude_recon[0])))
        return out

    def answer(result: list[tuple[float, float]]) -> list[float]:
        azimuths = [(azimuth + np.pi) % (2.0 * np.pi) - np.pi for azimuth, _ in result]
        return [*azimuths, *(np.pi / 2 - colatitude for _, colatitude in result)]

    return run, answer
