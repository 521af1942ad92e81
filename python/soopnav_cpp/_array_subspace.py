"""Covariances, subspaces, bounds and antennas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp._array_manifold import Manifold
from soopnav_cpp._core import array as _array
from soopnav_cpp._core.array import ArrayGeometry, ArrayStatus

Reals = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


def covariance(
    iq: npt.NDArray[np.complex64] | npt.NDArray[np.complex128], *, forward_backward: bool = False
) -> Complexes:
    """Sample covariance ``(1/N) sum x x^H``, carter (4.12).

    Parameters
    ----------
    iq : ndarray, shape (M, N), complex64 or complex128
        M channels. complex64 goes to the engine: products in single precision, sums over more than 256 snapshots in
        double. complex128 stays in double precision.
    forward_backward : bool
        Average with the array counted backwards, see `forward_backward`.

    Returns
    -------
    ndarray, shape (M, M), complex128
        Hermitian. Singular when N < M: what needs its inverse then refuses it.

    Raises
    ------
    ValueError
        For no snapshot, more than 32 channels, and, naming the channel, a sample that is not finite or a channel
        100 dB below the strongest.
    """
    if isinstance(iq, np.ndarray) and iq.dtype == np.complex128:
        matrix = _double_covariance(iq.astype(np.complex128, copy=False))
    else:
        status, channel, matrix = _array.covariance(iq)  # type: ignore[arg-type]
        if status == ArrayStatus.NON_FINITE:
            raise ValueError(f"iq: channel {channel} has NaN, infinity, or samples too large to be squared")
        if status == ArrayStatus.DEAD_CHANNEL:
            raise ValueError(f"iq: channel {channel} is dead: 100 dB below the strongest")
        if status == ArrayStatus.WRONG_SIZE:
            raise ValueError(f"iq: {iq.shape[0]} channels; 1 to 32 expected")
        if status == ArrayStatus.TOO_FEW_SNAPSHOTS and iq.shape[1] == 0:
            raise ValueError("iq: no snapshot; at least 1 expected")
    return _array.forward_backward(matrix) if forward_backward else matrix


def _double_covariance(iq: npt.NDArray[np.complex128]) -> Complexes:
    if iq.ndim != 2 or not 1 <= iq.shape[0] <= 32 or iq.shape[1] < 1:
        raise ValueError(f"iq: shape {iq.shape}; 1 to 32 channels of at least one snapshot expected")
    finite = np.isfinite(iq).all(axis=1)
    if not finite.all():
        raise ValueError(f"iq: channel {int(np.argmin(finite))} has NaN or infinity")
    matrix: Complexes = iq @ iq.conj().T / iq.shape[1]
    power = matrix.diagonal().real
    dead = ~(power > 1e-10 * power.max())
    if dead.any():
        raise ValueError(f"iq: channel {int(np.argmax(dead))} is dead: 100 dB below the strongest")
    return matrix


def forward_backward(R: npt.ArrayLike) -> Complexes:
    """Forward-backward average ``(R + J conj(R) J) / 2``; for arrays symmetric about their centre (ULA, planar).

    Doubles the snapshots, and parts two coherent sources.
    """
    return _array.forward_backward(np.asarray(R, dtype=np.complex128))


def spatial_smoothing(R: npt.ArrayLike, subarray_size: int, forward_backward: bool = False) -> Complexes:
    """Mean covariance of the ``M - subarray_size + 1`` subarrays of consecutive elements of a ULA.

    Parts as many coherent sources as there are subarrays; twice as many with forward-backward averaging.

    Returns
    -------
    ndarray, shape (subarray_size, subarray_size), complex128
    """
    return _array.spatial_smoothing(np.asarray(R, dtype=np.complex128), subarray_size, forward_backward)


def eigenvalues(R: npt.ArrayLike) -> Reals:
    """Eigenvalues of a Hermitian matrix, largest first, shape (M,)."""
    return _array.eigenvalues(np.asarray(R, dtype=np.complex128))


def root_music(R: npt.ArrayLike, n_sources: int, *, spacing_wavelengths: float = 0.5) -> Reals:
    """Angles of sources from the roots of a ULA's noise polynomial (Barabell 1983).

    Parameters
    ----------
    R : array_like, shape (M, M)
    n_sources : int
        1 ... M - 1.
    spacing_wavelengths : float

    Returns
    -------
    ndarray, shape (n_sources,)
        From broadside, ascending [rad].

    Raises
    ------
    ValueError
        For an R that is not finite or whose rank is below n_sources, or n_sources out of range.
    """
    return _array.root_music(np.asarray(R, dtype=np.complex128), n_sources, spacing_wavelengths=spacing_wavelengths)


def esprit(R: npt.ArrayLike, n_sources: int, *, spacing_wavelengths: float = 0.5, method: str = "tls") -> Reals:
    """Angles of sources from the shift invariance of a ULA (Roy and Kailath 1989), as `root_music`.

    `method` is "tls" (total least squares) or "ls".
    """
    if method not in ("tls", "ls"):
        raise ValueError(f"method: {method!r}; 'tls' or 'ls' expected")
    return _array.esprit(
        np.asarray(R, dtype=np.complex128),
        n_sources,
        spacing_wavelengths=spacing_wavelengths,
        total_least_squares=method == "tls",
    )


def source_count(R: npt.ArrayLike, n_snapshots: int, method: str = "mdl") -> int:
    """Count the sources in a covariance.

    Parameters
    ----------
    R : array_like, shape (M, M)
        Or its eigenvalues, shape (M,).
    n_snapshots : int
    method : {"mdl", "aic", "sorte"}
        Minimum description length (Wax and Kailath 1985) is consistent; Akaike's criterion over-counts in several per
        cent of the cases however many snapshots there are; SORTE (gaps of the eigenvalues) needs neither white noise
        nor the number of snapshots, at least 4 elements, and finds 1 ... M - 2.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        For an R that is not finite or has no positive eigenvalue.
    """
    values = np.asarray(R)
    if values.ndim == 2:
        values = _array.eigenvalues(values)
    count = _array.source_count(values.real, n_snapshots, method)
    if count < 0:
        raise ValueError("R: no positive eigenvalue, or one that is not finite; a covariance expected")
    return count


def crlb(
    positions_wavelengths: npt.ArrayLike | ArrayGeometry | Manifold,
    directions: npt.ArrayLike,
    powers: npt.ArrayLike,
    noise: float,
    n_snapshots: int,
    kind: str = "stochastic",
) -> Reals:
    """Cramer-Rao bound of directions in white noise, everything else unknown (Stoica and Nehorai 1989, 1990).

    Parameters
    ----------
    positions_wavelengths : array_like, shape (M,), (M, 1), (M, 2) or (M, 3), or ArrayGeometry or Manifold
        Elements in wavelengths; one column: a line along axis 1.
    directions : array_like, shape (K,) or (K, 2)
        ``[azimuth, elevation]`` of each source, or one angle: for a line along axis 1 from broadside, else azimuth at
        elevation 0, known to be there.
    powers : float or array_like, shape (K,) or (K, K)
        Of the sources at an ideal element, or their covariance.
    noise : float
        Variance per element.
    n_snapshots : int
    kind : {"stochastic", "deterministic"}
        Gaussian signals, or unknown ones. One source: the first is ``1 + 1 / (M SNR)`` times the second.

    Returns
    -------
    ndarray, shape (K, K) or (2 K, 2 K)
        [rad^2]; two angles: azimuth 1, elevation 1, azimuth 2, ...

    Raises
    ------
    ValueError
        For directions that the array does not determine, and numbers out of range.
    """
    if isinstance(positions_wavelengths, Manifold):
        manifold = positions_wavelengths
    elif isinstance(positions_wavelengths, ArrayGeometry):
        manifold = Manifold(positions_wavelengths)
    else:
        table = np.asarray(positions_wavelengths, dtype=np.float64)
        if table.ndim == 1:
            table = table[:, None]
        if table.ndim != 2 or table.shape[1] not in (1, 2, 3):
            raise ValueError(f"positions_wavelengths: shape {table.shape}; (M,) or (M, 1 ... 3) expected")
        points = np.zeros((len(table), 3))
        points[:, : table.shape[1]] = table
        manifold = Manifold(ArrayGeometry(points * (299_792_458.0 / 1e9), 1e9))
    angles = np.atleast_1d(np.asarray(directions, dtype=np.float64))
    if angles.ndim > 2 or (angles.ndim == 2 and angles.shape[1] != 2):
        raise ValueError(f"directions: shape {angles.shape}; (K,) or (K, 2) expected")
    one = angles.ndim == 1
    if one:
        offsets = manifold.geometry.positions_m - manifold.geometry.positions_m[0]
        broadside = bool(np.all(np.abs(offsets[:, 1:]) <= 1e-9 * manifold.geometry.aperture_m))
        angles = np.column_stack([np.pi / 2 - angles if broadside else angles, np.zeros(len(angles))])
    sources = np.asarray(powers, dtype=np.complex128)
    if sources.ndim == 0:
        sources = np.full(len(angles), sources)
    if sources.ndim == 1:
        sources = np.diag(sources)
    return _array.crlb(manifold._core, angles, sources, float(noise), float(n_snapshots), kind, one)


def polarization_factor(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Share of a wave's power that an antenna takes, p of carter (4.8): ``cos^2(gamma / 2)`` on the Poincare sphere.

    Parameters
    ----------
    a, b : (tilt, ellipticity)
        Of wave and antenna [rad]: tilt of the ellipse's major axis, ellipticity from -pi/4 (right circular) over 0
        (linear) to pi/4 (left circular). gamma is the angle between the two points at longitude 2 tilt, latitude 2
        ellipticity.

    Returns
    -------
    float
        1 for equal, 0 for opposite, 1/2 for linear against circular.
    """
    for name, (tilt, ellipticity) in (("a", a), ("b", b)):
        if not (np.isfinite(tilt) and abs(ellipticity) <= np.pi / 4 + 1e-12):
            raise ValueError(
                f"{name}: ({tilt}, {ellipticity}); a finite tilt and an ellipticity within +-pi/4 expected"
            )
    return _array.polarization_factor(a[0], a[1], b[0], b[1])


def impedance_factor(antenna_ohm: complex, load_ohm: complex) -> float:
    """Share of the power that passes from antenna to load, q of carter (4.8): 1 for conjugate impedances."""
    return _array.impedance_factor(antenna_ohm, load_ohm)


def received_power_dbm(
    transmit_power_dbm: float,
    *,
    distance_m: float,
    frequency_hz: float,
    transmit_gain_db: float = 0.0,
    receive_gain_db: float = 0.0,
    polarization: float = 1.0,
    impedance: float = 1.0,
) -> float:
    """Received power in free space, carter (4.8): ``p q P_T G_T G_R (c / (4 pi d f))^2`` [dBm]."""
    return _array.received_power_dbm(
        transmit_power_dbm, transmit_gain_db, receive_gain_db, distance_m, frequency_hz, polarization, impedance
    )


@dataclass(frozen=True)
class FarField:
    """Beyond which distance waves are plane for an array.

    Attributes
    ----------
    radiating_m : float
        carter (4.1): r >> 1.6 wavelengths.
    phase_m : float
        carter (4.2): r > 2 D^2 / wavelength.
    amplitude_m : float
        carter (4.3): r >> 5 D.
    region : {"", "near", "marginal", "far"}
        Of the distance asked for: "near" is below one of the limits, "far" beyond (4.2) and ten times beyond the
        others.
    """

    radiating_m: float
    phase_m: float
    amplitude_m: float
    region: str = ""

    @property
    def limit_m(self) -> float:
        """Greatest of the three."""
        return max(self.radiating_m, self.phase_m, self.amplitude_m)


def far_field(geometry: ArrayGeometry, distance_m: float | None = None) -> FarField:
    """Far-field limits of an array, and what they say of a distance."""
    size = (geometry.aperture_m, geometry.wavelength_m)
    region = "" if distance_m is None else _array.field_region(*size, float(distance_m))
    return FarField(*_array.far_field(*size), region)
