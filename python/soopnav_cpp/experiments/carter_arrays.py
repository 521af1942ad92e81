"""What carter's array experiments share: arrays, samples, covariances by their law, errors as angles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from soopnav_cpp.array import ArrayGeometry, DirectionFinder, Manifold

Array = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

SNAPSHOTS = 2500
ELEVATIONS_RAD = (np.deg2rad(20.0), np.deg2rad(70.0))


def paper_array() -> ArrayGeometry:
    """Four elements in a square, 0.2 wavelengths apart, at L1: carter table 4.2."""
    return ArrayGeometry.planar(2, 2, 0.2)


@lru_cache(maxsize=1)
def paper_finder() -> DirectionFinder:
    """MUSIC for the paper's array; once per process."""
    return DirectionFinder(paper_array())


def normals(rng: np.random.Generator, *shape: int) -> Complexes:
    """Circular complex normals of variance 1."""
    return np.asarray(rng.standard_normal((*shape, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0))


def band_limited(rng: np.random.Generator, ratio: float, count: int) -> npt.NDArray[np.complex64]:
    """White Gaussian noise in `ratio` of the band, round its middle, of mean power 1."""
    bins = np.fft.fftfreq(count)
    inside = np.abs(bins) <= 0.5 * ratio
    spectrum = np.where(inside, normals(rng, count), 0.0) * np.sqrt(count / inside.sum())
    return np.asarray(np.fft.ifft(spectrum, norm="ortho"), dtype=np.complex64)


def sample_covariances(rng: np.random.Generator, R: Complexes, snapshots: int, count: int) -> Complexes:
    """Sample covariances, shape (count, M, M), of Gaussian snapshots with covariance R.

    Exact law (complex Wishart) by Bartlett's decomposition.
    """
    m = len(R)
    T = np.zeros((count, m, m), dtype=np.complex128)
    low = np.tril_indices(m, -1)
    T[:, low[0], low[1]] = normals(rng, count, len(low[0]))
    for i in range(m):
        T[:, i, i] = np.sqrt(rng.gamma(snapshots - i, 1.0, count))
    half = np.linalg.cholesky(R) @ T
    return np.asarray(half @ half.conj().transpose(0, 2, 1) / snapshots)


def unit_vectors(azimuth: npt.ArrayLike, elevation: npt.ArrayLike) -> Array:
    """Towards directions, last axis 3."""
    flat = np.cos(elevation)
    return np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)


def angle_between(a: Array, b: Array) -> Array:
    """Between unit vectors, well conditioned at 0."""
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


def wrapped(angle: npt.ArrayLike) -> Array:
    """In -pi ... pi."""
    return np.asarray((np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi)


def model_covariance(manifold: Manifold, directions: npt.ArrayLike, snr: float) -> Complexes:
    """Covariance of uncorrelated sources of power `snr` in noise of variance 1."""
    at = np.asarray(directions, dtype=np.float64)
    a = manifold.steering(at[:, 0], at[:, 1])
    return np.asarray(snr * a @ a.conj().T + np.eye(len(manifold)))
