"""Directions from samples: the finder, its results, and the classical spectra."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._array_manifold import Manifold
from soopnav_cpp._core import array as _array
from soopnav_cpp._core.array import ArrayGeometry, ArrayStatus

Reals = npt.NDArray[np.float64]


class AmbiguityWarning(UserWarning):
    """An array has directions that it cannot tell apart."""


@dataclass(frozen=True)
class Bearings:
    """Directions of the sources in one block of samples, strongest first.

    Attributes
    ----------
    azimuth_rad, elevation_rad : ndarray, shape (K,)
        Array axes; a horizontal line of elements reports the half plane at elevation 0 on its left.
    covariance_rad2 : ndarray, shape (K, 2, 2)
        Of azimuth and elevation: the asymptotic law of the estimator; what the array does not tell is infinite.
    power : ndarray, shape (K,)
        Of the source at an ideal element, noise taken out, in the samples' units squared.
    eigenvalues : ndarray, shape (M,)
        Of the covariance, largest first.
    status : ArrayStatus
        With anything but OK and UNRESOLVED there are no bearings.
    noise : float
        Mean of the noise eigenvalues.
    channel : int
        At fault, or -1.
    mirror : bool
        Each source may as well be its image behind the array: of a line, and of a plane unless its measured responses
        tell the sides apart and the grid has both.
    height : ndarray, shape (K,)
        Of the normalised spectrum ``a^H W a / a^H a``; 1 is all that MUSIC can reach.
    spectrum : ndarray, shape (E, A), or None
        Unnormalised spectrum over the finder's grid, where it was asked for.
    """

    azimuth_rad: Reals
    elevation_rad: Reals
    covariance_rad2: Reals
    power: Reals
    eigenvalues: Reals
    status: ArrayStatus
    noise: float = 0.0
    channel: int = -1
    mirror: bool = False
    height: Reals | None = None
    spectrum: Reals | None = None

    @property
    def sigma_rad(self) -> Reals:
        """Standard deviations of azimuth and elevation, shape (K, 2)."""
        return np.sqrt(np.diagonal(self.covariance_rad2, axis1=1, axis2=2))

    @property
    def eigenvalue_ratio(self) -> float:
        """Largest eigenvalue over the mean of all others: 1 + M SNR for one source. 0 without eigenvalues."""
        if len(self.eigenvalues) < 2 or not self.eigenvalues[1:].mean() > 0.0:
            return 0.0
        return float(self.eigenvalues[0] / self.eigenvalues[1:].mean())

    def __len__(self) -> int:
        return len(self.azimuth_rad)

    def __repr__(self) -> str:
        sources = [
            f"az {math.degrees(az):.3f} el {math.degrees(el):.3f} deg (sigma {math.degrees(s[0]):.2g}, "
            f"{math.degrees(s[1]):.2g})"
            for az, el, s in zip(self.azimuth_rad, self.elevation_rad, self.sigma_rad, strict=True)
        ]
        return f"Bearings({self.status.name}: {'; '.join(sources) or 'none'}{', or mirrored' if self.mirror else ''})"


@dataclass(frozen=True)
class BearingRun:
    """Directions in many blocks: arrays over blocks B and sources K, NaN where there is none.

    Attributes
    ----------
    block : ndarray, shape (B,)
        Number of the block.
    first_sample : ndarray, shape (B,)
    azimuth_rad, elevation_rad, power, height : ndarray, shape (B, K)
    covariance_rad2 : ndarray, shape (B, K, 2, 2)
    eigenvalues : ndarray, shape (B, M)
        Largest first.
    noise : ndarray, shape (B,)
    count : ndarray, shape (B,)
        Sources found.
    status : ndarray, shape (B,), uint8
        Values of `ArrayStatus`.
    """

    block: npt.NDArray[np.int64]
    first_sample: npt.NDArray[np.int64]
    azimuth_rad: Reals
    elevation_rad: Reals
    power: Reals
    height: Reals
    covariance_rad2: Reals
    eigenvalues: Reals
    noise: Reals
    count: npt.NDArray[np.int64]
    status: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.status)


class SteeringTable:
    """Steering vectors over a grid of directions, made once for any number of finders.

    A planar array reports the side of axis 3 (of a tilted plane: its upper side), unless measured responses tell its
    sides apart and `elevation_min_deg` lets both be searched; a horizontal line half a turn at elevation 0, a vertical
    one elevations. What a measured manifold does not reach is left out.

    Parameters
    ----------
    manifold : Manifold or ArrayGeometry
    azimuth_step_deg, elevation_step_deg : float
        At most; a turn and the elevations are divided evenly.
    elevation_min_deg : float
        Lowest elevation searched: -90 for arrays of rank 3 that look all round.
    azimuth_start_deg : float
        Of the grid's first column.
    frequency_hz : float, optional
        Of the signal; without one the geometry's.

    Warns
    -----
    AmbiguityWarning
        When regions of directions have doubles at `frequency_hz`; the message lists those of one direction.
    """

    def __init__(
        self,
        manifold: Manifold | ArrayGeometry,
        *,
        azimuth_step_deg: float = 1.0,
        elevation_step_deg: float = 1.0,
        elevation_min_deg: float = 0.0,
        azimuth_start_deg: float = 0.0,
        frequency_hz: float | None = None,
        _inside: int = 0,
    ) -> None:
        self.manifold = manifold if isinstance(manifold, Manifold) else Manifold(manifold)
        self._core = _array.SteeringTable(
            self.manifold._core,
            azimuth_step_rad=math.radians(azimuth_step_deg),
            elevation_step_rad=math.radians(elevation_step_deg),
            elevation_min_rad=math.radians(elevation_min_deg),
            azimuth_start_rad=math.radians(azimuth_start_deg),
            frequency_hz=0.0 if frequency_hz is None else frequency_hz,
        )
        geometry = self.manifold.geometry
        if self.frequency_hz != geometry.frequency_hz:  # doubles are the signal's wavelength's
            geometry = ArrayGeometry(geometry.positions_m, self.frequency_hz, geometry.name)
        if geometry.ambiguous:
            warnings.warn(_ambiguity(geometry), AmbiguityWarning, stacklevel=2 + _inside)

    @property
    def azimuth_rad(self) -> Reals:
        """Columns of the grid, shape (A,)."""
        return self._core.azimuth_rad

    @property
    def elevation_rad(self) -> Reals:
        """Rows of the grid, shape (E,)."""
        return self._core.elevation_rad

    @property
    def frequency_hz(self) -> float:
        """Of the signal."""
        return self._core.frequency_hz

    def steering(self) -> npt.NDArray[np.complex128]:
        """Double-precision steering vectors of the grid, shape (M, E A), elevation by elevation."""
        return self.manifold.steering(self.azimuth_rad[None, :], self.elevation_rad[:, None], self.frequency_hz)


def _ambiguity(geometry: ArrayGeometry) -> str:
    apart = geometry.smallest_spacing_m / geometry.wavelength_m
    for azimuth_deg, elevation_deg in ((90.0, 45.0), (0.0, 45.0), (0.0, 0.0), (90.0, 0.0), (45.0, 0.0)):
        doubles = geometry.ambiguous_directions(math.radians(azimuth_deg), math.radians(elevation_deg))
        if len(doubles):
            shown = ", ".join(f"({math.degrees(a):.1f}, {math.degrees(e):.1f})" for a, e in doubles[:6])
            more = f" and {len(doubles) - 6} more" if len(doubles) > 6 else ""
            example = f"azimuth {azimuth_deg:g}, elevation {elevation_deg:g} degrees has the doubles {shown}{more}"
            break
    else:
        example = "geometry.ambiguous_directions() lists the doubles of a direction"
    return f"elements {apart:.3g} wavelengths apart leave directions ambiguous: {example}"


class DirectionFinder:
    """Directions from samples: covariance, eigenvectors, scan of a grid, refinement off the grid; made once.

    The scan is in single precision; each peak is then followed in double precision on the continuous spectrum, so the
    grid leaves no bias. `estimate` and its kin allocate nothing but their result. Threads may share an object: calls
    wait for each other.

    Parameters
    ----------
    manifold : Manifold, ArrayGeometry or SteeringTable
    n_sources : int or None
        1 ... M - 1; None: by MDL in each block.
    method : {"music", "capon", "bartlett", "subspace_fitting", "maximum_likelihood"}
        The last two fit all sources at once, coherent ones too.
    loading : float
        Capon: of the diagonal, times the mean power.
    forward_backward : bool
        Average the covariance with the array counted backwards; for arrays that look the same so: each element and
        its counterpart from the end symmetric about one centre (`ula`, `planar`).
    azimuth_step_deg, elevation_step_deg, elevation_min_deg, azimuth_start_deg, frequency_hz
        As `SteeringTable`, unless one is given.

    Raises
    ------
    ValueError
        For more sources than M - 1, options out of range, and `forward_backward` with an array without that symmetry,
        whose directions it would bias.
    """

    def __init__(
        self,
        manifold: Manifold | ArrayGeometry | SteeringTable,
        *,
        n_sources: int | None = 1,
        method: str = "music",
        loading: float = 0.0,
        forward_backward: bool = False,
        azimuth_step_deg: float = 1.0,
        elevation_step_deg: float = 1.0,
        elevation_min_deg: float = 0.0,
        azimuth_start_deg: float = 0.0,
        frequency_hz: float | None = None,
    ) -> None:
        if n_sources is not None and n_sources < 1:
            raise ValueError(f"n_sources: {n_sources}; at least 1, or None to count them, expected")
        if isinstance(manifold, SteeringTable):
            self.table = manifold
        else:
            self.table = SteeringTable(
                manifold,
                azimuth_step_deg=azimuth_step_deg,
                elevation_step_deg=elevation_step_deg,
                elevation_min_deg=elevation_min_deg,
                azimuth_start_deg=azimuth_start_deg,
                frequency_hz=frequency_hz,
                _inside=1,
            )
        if forward_backward:
            _require_symmetry(self.manifold.geometry)
        self.method = method
        self.n_sources = n_sources
        self._loading = loading
        self._forward_backward = forward_backward
        self._core = _array.DirectionFinder(
            self.table._core,
            method=method,
            n_sources=n_sources or 0,
            loading=loading,
            forward_backward=forward_backward,
        )

    @property
    def manifold(self) -> Manifold:
        """The array."""
        return self.table.manifold

    def estimate(self, iq: npt.NDArray[np.complex64]) -> Bearings:
        """Directions in a block of samples, shape (M, N), complex64, C-contiguous.

        What is wrong with the data is in `Bearings.status`; a wrong dtype or layout raises ValueError.
        """
        return _bearings(self._core.estimate(iq))

    def estimate_covariance(self, R: npt.ArrayLike, n_snapshots: float, *, spectrum: bool = False) -> Bearings:
        """Directions from a covariance (M, M) of so many snapshots; with `spectrum`, also that over the grid."""
        matrix = np.asarray(R, dtype=np.complex128)
        found = _bearings(self._core.estimate_covariance(matrix, float(n_snapshots)))
        if not spectrum or found.status not in (ArrayStatus.OK, ArrayStatus.UNRESOLVED):
            return found
        return Bearings(**{**vars(found), "spectrum": self.spectrum(matrix, max(1, len(found)))})

    def spectrum(self, R: npt.ArrayLike, n_sources: int | None = None) -> Reals:
        """Unnormalised spectrum over the grid in double precision, shape (E, A); the fits show MUSIC's.

        0 where a measured manifold does not reach.
        """
        matrix = np.asarray(R, dtype=np.complex128)
        if self._forward_backward:
            matrix = _array.forward_backward(matrix)
        kind = self.method if self.method in ("capon", "bartlett") else "music"
        elevation, azimuth = np.meshgrid(self.table.elevation_rad, self.table.azimuth_rad, indexing="ij")
        reached = self.manifold.reaches(azimuth, elevation)
        steering = self.manifold.steering(azimuth[reached], elevation[reached], self.table.frequency_hz)
        values = np.zeros(azimuth.shape)
        values[reached] = _array.spectrum(kind, matrix, steering, n_sources or self.n_sources or 1, self._loading)
        return values

    def track(self, iq: npt.NDArray[np.complex64], block: int, hop: int | None = None) -> BearingRun:
        """Directions in successive blocks of `block` snapshots, `hop` apart (`block` without one)."""
        hop = block if hop is None else hop
        return _run(self._core.track(iq, block, hop), hop)

    def run(self, R: npt.ArrayLike, n_snapshots: float) -> BearingRun:
        """Directions from many covariances, shape (E, M, M), each of `n_snapshots`."""
        matrices = np.ascontiguousarray(R, dtype=np.complex128)
        if matrices.ndim != 3:
            raise ValueError(f"R: shape {matrices.shape}; (E, M, M) expected")
        if matrices.size and matrices.shape[1] == matrices.shape[2]:
            with np.errstate(invalid="ignore"):  # what is not finite has a status
                apart = np.abs(matrices - matrices.conj().transpose(0, 2, 1)).max(axis=(1, 2))
                wrong = apart > 1e-4 * np.abs(matrices).max(axis=(1, 2))
            if wrong.any():
                raise ValueError(f"R: matrix {int(np.argmax(wrong))} is not Hermitian; covariances expected")
        parts = matrices.view(np.float64).reshape(*matrices.shape, 2)
        return _run(self._core.run(parts, float(n_snapshots)), 0)

    def __repr__(self) -> str:
        count = "MDL" if self.n_sources is None else self.n_sources
        grid = f"{len(self.table.azimuth_rad)} x {len(self.table.elevation_rad)}"
        return f"DirectionFinder({self.method}, sources {count}, grid {grid}, {self.manifold!r})"


def _require_symmetry(geometry: ArrayGeometry) -> None:
    twice_centre = geometry.positions_m + geometry.positions_m[::-1]
    off = np.linalg.norm(twice_centre - twice_centre[0], axis=1) / geometry.wavelength_m
    if off.max() > 1e-6:
        m = int(np.argmax(off))
        raise ValueError(
            f"forward_backward: True; elements {m} and {len(geometry) - 1 - m} are not symmetric about the centre of "
            f"elements 0 and {len(geometry) - 1}: averaging would bias directions"
        )


def _bearings(result: tuple[ArrayStatus, int, Reals, Reals, Reals, float, bool]) -> Bearings:
    status, channel, numbers, covariance, eigenvalues, noise, mirror = result
    azimuth, elevation, power, height = numbers.T
    return Bearings(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        covariance_rad2=covariance,
        power=power,
        eigenvalues=eigenvalues,
        status=status,
        noise=noise,
        channel=channel,
        mirror=mirror,
        height=height,
    )


def _run(
    result: tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], Reals, Reals, Reals, Reals], hop: int
) -> BearingRun:
    status, count, numbers, covariance, eigenvalues, noise = result
    block = np.arange(len(status), dtype=np.int64)
    return BearingRun(
        block=block,
        first_sample=block * hop,
        azimuth_rad=numbers[:, :, 0],
        elevation_rad=numbers[:, :, 1],
        power=numbers[:, :, 2],
        height=numbers[:, :, 3],
        covariance_rad2=covariance,
        eigenvalues=eigenvalues,
        noise=noise,
        count=count,
        status=status,
    )


Steering = npt.ArrayLike | ArrayGeometry | Manifold | SteeringTable


def _spectrum_or_bearings(
    kind: str, R: npt.ArrayLike, steering: Steering, n_sources: int, loading: float, n_snapshots: float | None
) -> Reals | Bearings:
    matrix = np.asarray(R, dtype=np.complex128)
    if not isinstance(steering, ArrayGeometry | Manifold | SteeringTable):
        vectors = np.asarray(steering, dtype=np.complex128)
        if vectors.ndim == 1:
            vectors = vectors[:, None]
        return _array.spectrum(kind, matrix, vectors, n_sources, loading)
    finder = DirectionFinder(steering, n_sources=n_sources, method=kind, loading=loading)
    found = finder.estimate_covariance(matrix, len(finder.manifold) if n_snapshots is None else n_snapshots)
    if n_snapshots is None:
        unknown = np.full_like(found.covariance_rad2, np.inf)
        found = Bearings(**{**vars(found), "covariance_rad2": unknown})
    return found


def bartlett(
    R: npt.ArrayLike, steering: Steering, *, n_sources: int = 1, n_snapshots: float | None = None
) -> Reals | Bearings:
    """Bartlett's spectrum ``a^H R a``, or its peaks.

    carter (4.13), (4.15), which the paper calls MUSIC, has it over ``a^H a``; so have the peaks.

    Parameters
    ----------
    R : array_like, shape (M, M)
    steering : array_like, shape (M, G), or ArrayGeometry, Manifold or SteeringTable
        Steering vectors, for a spectrum; or an array, for directions over its half sphere: 1 degree grid, refined. A
        table is made in each call: many calls are for a `SteeringTable` or a `DirectionFinder`.
    n_sources : int
        Peaks to find.
    n_snapshots : float, optional
        For the bearings' covariance, which is infinite without.

    Returns
    -------
    ndarray, shape (G,), or Bearings
    """
    return _spectrum_or_bearings("bartlett", R, steering, n_sources, 0.0, n_snapshots)


def capon(
    R: npt.ArrayLike,
    steering: Steering,
    loading: float = 0.0,
    *,
    n_sources: int = 1,
    n_snapshots: float | None = None,
) -> Reals | Bearings:
    """Capon's spectrum ``1 / (a^H R^-1 a)``, unnormalised, or its peaks; as `bartlett`.

    `loading` times the mean power is added to the diagonal of R. A singular R raises ValueError (spectrum) or gives
    the status SINGULAR.
    """
    return _spectrum_or_bearings("capon", R, steering, n_sources, loading, n_snapshots)


def music(
    R: npt.ArrayLike, steering: Steering, n_sources: int, *, n_snapshots: float | None = None
) -> Reals | Bearings:
    """MUSIC spectrum ``1 / (a^H En En^H a)`` (Schmidt 1986), unnormalised, or its peaks; as `bartlett`."""
    return _spectrum_or_bearings("music", R, steering, n_sources, 0.0, n_snapshots)


def weighted_subspace_fitting(
    R: npt.ArrayLike,
    steering: ArrayGeometry | Manifold | SteeringTable,
    n_sources: int,
    *,
    n_snapshots: float,
) -> Bearings:
    """Directions by weighted subspace fitting (Viberg and Ottersten 1991): all sources at once.

    Reaches the stochastic bound. Sources may be coherent. Starts from MUSIC's peaks, or from alternating projections
    when they are too few.
    """
    finder = DirectionFinder(steering, n_sources=n_sources, method="subspace_fitting")
    return finder.estimate_covariance(R, n_snapshots)


def maximum_likelihood(
    R: npt.ArrayLike,
    steering: ArrayGeometry | Manifold | SteeringTable,
    n_sources: int,
    *,
    n_snapshots: float,
) -> Bearings:
    """Directions by deterministic maximum likelihood, all sources at once; as `weighted_subspace_fitting`."""
    finder = DirectionFinder(steering, n_sources=n_sources, method="maximum_likelihood")
    return finder.estimate_covariance(R, n_snapshots)
