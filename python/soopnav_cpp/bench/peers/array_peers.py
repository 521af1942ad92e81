"""NumPy alone: MUSIC over a grid of azimuths and elevations as DOA toolboxes write it, everything in one product."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Data = dict[str, npt.NDArray[Any]]


def music(data: Data) -> tuple[Callable[[], Any], Callable[[Any], list[float]]]:
    """Covariance, eigenvectors, the noise subspace against every steering vector, the highest point of the grid.

    The steering vectors are made beforehand. No refinement off the grid.
    """
    iq, azimuth, elevation = data["iq"], data["azimuth"], data["elevation"]
    steering = data["steering"].astype(np.complex128)

    block = int(data["block"])

    def direction(samples: npt.NDArray[Any]) -> tuple[float, float]:
        R = samples @ samples.conj().T / samples.shape[1]
        _, vectors = np.linalg.eigh(R)
        noise = vectors[:, :-1]
        product = noise.conj().T @ steering
        spectrum = 1.0 / np.sum(product.real**2 + product.imag**2, axis=0)
        row, column = divmod(int(np.argmax(spectrum)), len(azimuth))
        return float(azimuth[column]), float(elevation[row])

    def run() -> list[tuple[float, float]]:
        return [direction(iq[:, first : first + block]) for first in range(0, iq.shape[1], block)]

    return run, lambda result: [*(found[0] for found in result), *(found[1] for found in result)]
