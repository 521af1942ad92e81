"""A moving antenna as an array: bearings from the phase of signals along a known path (nielsen's synthetic array)."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import array as _array
from soopnav_cpp._core.array import ApertureStatus

__all__ = [
    "ApertureBearings",
    "ApertureStatus",
    "BearingCheck",
    "BlindAperture",
    "SyntheticAperture",
    "aperture_directions",
    "aperture_spectrum",
    "check_bearings",
    "synthetic_aperture_crlb",
]

_Floats = npt.NDArray[np.float64]
_Bools = npt.NDArray[np.bool_]
_Phase = Literal["free", "random_walk", "known"]
_Method = Literal["beamforming", "music"]
_MODE_SHARE = 1e-6  # of the variance along a path that the modes of a covariance may leave out
_MAX_MODES = 16

_SENTENCES = {
    ApertureStatus.OK: "one set of bearings fits",
    ApertureStatus.TWO_ANSWERS: "two sets of bearings fit equally well: mirror_rad holds the other",
    ApertureStatus.SINGULAR: "the path's shape does not determine the bearings: walk a closed loop",
    ApertureStatus.TOO_FEW_NODES: "a free receiver phase needs three nodes, a blind aperture five",
    ApertureStatus.TOO_FEW_COHERENT: "too few links are coherent along the path: no line of sight",
    ApertureStatus.TOO_FEW_SNAPSHOTS: "at least eight snapshots are needed",
    ApertureStatus.STEP_TOO_LONG: "a step of the path is longer than half a wavelength: phases are ambiguous",
    ApertureStatus.PATH_TOO_SHORT: "the path spans less than a quarter of a wavelength",
    ApertureStatus.NON_FINITE: "phasors, path or times are not finite, or times do not rise",
    ApertureStatus.NO_POWER: "a node's phasors are all zero",
    ApertureStatus.NO_CONVERGENCE: "the likelihood's maximum was not reached",
}


def _sentence(status: ApertureStatus, index: int, straight: bool = False) -> str:
    text = _SENTENCES[status]
    if status is ApertureStatus.SINGULAR and straight:
        text = "a straight path and a free receiver phase tell differences of cosines only: walk a closed loop"
    if status is ApertureStatus.OK or index < 0:
        return text
    return f"{text} ({'snapshot' if status in _OF_SNAPSHOT else 'node'} {index})"


_OF_SNAPSHOT = (ApertureStatus.STEP_TOO_LONG,)


@dataclasses.dataclass(frozen=True)
class ApertureBearings:
    """What the links of one aperture said.

    Attributes
    ----------
    status : ApertureStatus
        Bearings are there with ``OK`` and ``TWO_ANSWERS``; all NaN otherwise.
    message : str
        The same in words.
    bearing_rad : ndarray, shape (L,)
        In the path's frame, from its axis 1 towards axis 2, [-pi, pi). NaN for links left out and undetermined ones.
    mirror_rad : ndarray, shape (L,)
        The other answer; NaN where there is none.
    covariance_rad2 : ndarray, shape (L, L)
        The bound at the estimate, path error included.
    coherence : ndarray, shape (L,)
        ``|sum y s*|^2 / (n sum |y|^2)``, the receiver's phase as the other links have it.
    los : ndarray of bool, shape (L,)
        Coherence reaches the threshold. One specular reflection is coherent too: see `check_bearings`.
    frequency_offset_hz : ndarray, shape (L,)
        With a free receiver phase relative to the first link in use.
    amplitude : ndarray, shape (L,)
    phase_rad : ndarray, shape (n,)
        The receiver's.
    noise_variance, gap : float
        E|noise|^2; log likelihood of the answer over the other one's.
    straight : bool
        The path is a line as phases see it.
    """

    status: ApertureStatus
    message: str
    bearing_rad: _Floats
    mirror_rad: _Floats
    covariance_rad2: _Floats
    coherence: _Floats
    los: _Bools
    frequency_offset_hz: _Floats
    amplitude: _Floats
    phase_rad: _Floats
    noise_variance: float
    gap: float
    straight: bool

    @property
    def ok(self) -> bool:
        """Whether there are bearings; look at `mirror_rad` too."""
        return self.status in (ApertureStatus.OK, ApertureStatus.TWO_ANSWERS)

    @property
    def sigma_rad(self) -> _Floats:
        """Standard deviations, shape (L,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2)), dtype=np.float64)

    def __repr__(self) -> str:
        degrees = ", ".join(
            "-" if np.isnan(b) else f"{np.rad2deg(b):.2f}±{np.rad2deg(s):.2f}"
            for b, s in zip(self.bearing_rad, self.sigma_rad, strict=True)
        )
        return f"ApertureBearings({self.status.name.lower()}, [{degrees}] deg)"


@dataclasses.dataclass(frozen=True)
class BlindAperture:
    """Angles between nodes from phases alone.

    Attributes
    ----------
    status, message
        As of `ApertureBearings`.
    bearing_rad : ndarray, shape (L,)
        Relative to the first node, which has 0; all signs may be the other way round.
    covariance_rad2 : ndarray, shape (L, L)
        Row and column of the first node are zero.
    path_m : ndarray, shape (n, 2)
        From its first point, axis 1 towards the first node; with frequency offsets up to a constant velocity.
    noise_variance : float
    """

    status: ApertureStatus
    message: str
    bearing_rad: _Floats
    covariance_rad2: _Floats
    path_m: _Floats
    noise_variance: float

    @property
    def ok(self) -> bool:
        """Whether there are angles."""
        return self.status is ApertureStatus.OK


def _wavelengths(wavelength_m: npt.ArrayLike, nodes: int) -> _Floats:
    given = np.asarray(wavelength_m, dtype=np.float64)
    return np.full(nodes, float(given)) if given.ndim == 0 else given


def _times(time_s: npt.ArrayLike | None, snapshots: int) -> _Floats:
    return np.arange(snapshots, dtype=np.float64) if time_s is None else np.asarray(time_s, dtype=np.float64)


def _modes(covariance_m2: npt.ArrayLike | None, modes_m: npt.ArrayLike | None, snapshots: int) -> _Floats:
    """Modes of a path's error, shape (m, n, 2), from themselves or from a covariance of [x0, y0, x1, y1, ...]."""
    parts = []
    if modes_m is not None:
        modes = np.asarray(modes_m, dtype=np.float64)
        if modes.ndim != 3 or modes.shape[1:] != (snapshots, 2):
            raise ValueError(f"path_modes_m: shape {modes.shape}; (m, {snapshots}, 2) is expected")
        parts.append(modes)
    if covariance_m2 is not None:
        covariance = np.asarray(covariance_m2, dtype=np.float64)
        if covariance.shape != (2 * snapshots, 2 * snapshots):
            raise ValueError(
                f"path_covariance_m2: shape {covariance.shape}; ({2 * snapshots}, {2 * snapshots}), of x and y of one "
                "snapshot after the other, is expected"
            )
        if not np.isfinite(covariance).all():
            raise ValueError("path_covariance_m2: not finite")
        values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
        if values[0] < -1e-9 * max(values[-1], 0.0):
            raise ValueError(f"path_covariance_m2: smallest eigenvalue {values[0]:.3g}; it must not be negative")
        keep = np.flatnonzero(np.cumsum(np.maximum(values, 0.0)) > _MODE_SHARE * np.maximum(values, 0.0).sum())
        keep = keep[::-1][:_MAX_MODES]
        parts.append((vectors[:, keep] * np.sqrt(values[keep])).T.reshape(-1, snapshots, 2))
    return np.concatenate(parts) if parts else np.zeros((0, snapshots, 2))


def _options(phase: _Phase, phase_sigma: float, offsets: bool, path_sigma: float, **more: float) -> Any:
    return _array.ApertureOptions(
        phase=phase,
        phase_sigma_rad_per_sqrt_s=phase_sigma,
        frequency_offsets=offsets,
        path_sigma_m_per_sqrt_step=path_sigma,
        **more,
    )


class SyntheticAperture:
    """Bearings of nodes from their signals' phases along a path that a camera or an IMU measured.

    ``y_ki = A_i exp(j (psi_k + phi_i + w_i t_k + 2 pi / lambda_i u(theta_i) . p_k)) + noise``: moving towards a node
    advances its phase. Maximum likelihood of all nodes at once; see ``cpp/doc/synthetic_aperture.md``.

    Parameters
    ----------
    phase : {"free", "random_walk", "known"}
        The receiver's, common to all nodes: unknown at each snapshot (a TCXO; three nodes at least), a random walk, or
        constant (an oscillator of 1e-11, or removed).
    phase_sigma_rad_per_sqrt_s : float
        Of the random walk: ``2 pi f sigma_y(1 s)`` of white frequency noise. Steps over 0.6 rad count as free.
    frequency_offsets : bool
        Whether each node has an unknown constant one.
    max_frequency_hz : float
        Searched on both sides; 0: all that the snapshots tell apart.
    path_sigma_m_per_sqrt_step : float
        Error of each step of the path, per axis.
    noise_variance : float
        E|noise|^2 of every phasor; 0: found from the residuals.
    coherence_threshold : float
        Links below are left out.
    max_sigma_rad : float
        Bearings less certain count as undetermined.

    Raises
    ------
    ValueError
        For numbers that are negative or not finite, an unknown word.
    """

    def __init__(
        self,
        *,
        phase: _Phase = "free",
        phase_sigma_rad_per_sqrt_s: float = 0.0,
        frequency_offsets: bool = True,
        max_frequency_hz: float = 0.0,
        path_sigma_m_per_sqrt_step: float = 0.0,
        noise_variance: float = 0.0,
        coherence_threshold: float = 0.7,
        max_sigma_rad: float = 0.6,
    ) -> None:
        self._options = _options(
            phase,
            phase_sigma_rad_per_sqrt_s,
            frequency_offsets,
            path_sigma_m_per_sqrt_step,
            max_frequency_hz=max_frequency_hz,
            noise_variance=noise_variance,
            coherence_threshold=coherence_threshold,
            max_sigma_rad=max_sigma_rad,
        )
        self._engine = _array.SyntheticAperture(self._options)

    def bearings(
        self,
        phasors: npt.ArrayLike,
        path_m: npt.ArrayLike,
        wavelength_m: npt.ArrayLike,
        *,
        time_s: npt.ArrayLike | None = None,
        path_covariance_m2: npt.ArrayLike | None = None,
        path_modes_m: npt.ArrayLike | None = None,
    ) -> ApertureBearings:
        """Bearings of all nodes.

        Parameters
        ----------
        phasors : array_like, shape (n, L), complex
            One complex channel gain per snapshot and node, of equal noise.
        path_m : array_like, shape (n, 2)
        wavelength_m : float or array_like, shape (L,)
        time_s : array_like, shape (n,), optional
            Rising; without them snapshots are one second apart.
        path_covariance_m2 : array_like, shape (2n, 2n), optional
            Of the path's error beyond `path_sigma_m_per_sqrt_step`, as an IMU's dead reckoning gives it: its 16
            largest modes are used.
        path_modes_m : array_like, shape (m, n, 2), optional
            The same as shapes that independent unit normals scale.

        Returns
        -------
        ApertureBearings
            Bad data gives a status, never an exception.
        """
        y = np.asarray(phasors, dtype=np.complex128)
        if y.ndim != 2:
            raise ValueError(f"phasors: shape {y.shape}; (n, L), a row per snapshot, is expected")
        n, nodes = y.shape
        found = self._engine.bearings(
            y,
            np.asarray(path_m, dtype=np.float64),
            _times(time_s, n),
            _wavelengths(wavelength_m, nodes),
            _modes(path_covariance_m2, path_modes_m, n),
        )
        status = ApertureStatus(found["status"])
        ok = status in (ApertureStatus.OK, ApertureStatus.TWO_ANSWERS)

        def of_nodes(name: str) -> _Floats:
            return np.asarray(found[name] if len(found[name]) else np.full(nodes, np.nan), dtype=np.float64)

        return ApertureBearings(
            status=status,
            message=_sentence(status, found["index"], found["straight"]),
            bearing_rad=of_nodes("bearing_rad"),
            mirror_rad=of_nodes("alternative_rad"),
            covariance_rad2=found["covariance_rad2"] if ok else np.full((nodes, nodes), np.nan),
            coherence=of_nodes("coherence"),
            los=np.asarray(found["los"] if len(found["los"]) else np.zeros(nodes), dtype=np.bool_),
            frequency_offset_hz=of_nodes("frequency_hz"),
            amplitude=of_nodes("amplitude"),
            phase_rad=found["phase_rad"] if ok else np.full(n, np.nan),
            noise_variance=float(found["noise_variance"]),
            gap=float(found["gap"]),
            straight=bool(found["straight"]),
        )

    def blind(
        self, phasors: npt.ArrayLike, wavelength_m: npt.ArrayLike, *, time_s: npt.ArrayLike | None = None
    ) -> BlindAperture:
        """Angles between five or more nodes when the path is unknown too.

        Steps must be small: the phase between two nodes turns by less than half a turn from snapshot to snapshot.

        Parameters
        ----------
        phasors, wavelength_m, time_s
            As of `bearings`.

        Returns
        -------
        BlindAperture
            ``TOO_FEW_COHERENT`` where a link's coherence with the answer is below the threshold; the message names the
            worst one, and the others may answer without it while five remain.
        """
        y = np.asarray(phasors, dtype=np.complex128)
        if y.ndim != 2:
            raise ValueError(f"phasors: shape {y.shape}; (n, L), a row per snapshot, is expected")
        n, nodes = y.shape
        found = self._engine.blind(y, _times(time_s, n), _wavelengths(wavelength_m, nodes))
        status = ApertureStatus(found["status"])
        ok = status is ApertureStatus.OK
        return BlindAperture(
            status=status,
            message=_sentence(status, found["index"]),
            bearing_rad=found["bearing_rad"] if ok else np.full(nodes, np.nan),
            covariance_rad2=found["covariance_rad2"] if ok else np.full((nodes, nodes), np.nan),
            path_m=found["path_m"] if ok else np.full((n, 2), np.nan),
            noise_variance=float(found["noise_variance"]),
        )


def synthetic_aperture_crlb(
    path_m: npt.ArrayLike,
    wavelength_m: npt.ArrayLike,
    bearing_rad: npt.ArrayLike,
    snr_db: npt.ArrayLike,
    *,
    time_s: npt.ArrayLike | None = None,
    phase: _Phase = "free",
    phase_sigma_rad_per_sqrt_s: float = 0.0,
    frequency_offsets: bool = True,
    path_sigma_m_per_sqrt_step: float = 0.0,
    path_covariance_m2: npt.ArrayLike | None = None,
    path_modes_m: npt.ArrayLike | None = None,
) -> _Floats:
    """Cramer-Rao bound of the bearings, everything else of the model unknown; shape (L, L) [rad^2].

    The path's error has its prior (the hybrid bound). Parameters are as of `SyntheticAperture`.

    Parameters
    ----------
    path_m : array_like, shape (n, 2)
    wavelength_m, snr_db : float or array_like, shape (L,)
        SNR of one phasor.
    bearing_rad : array_like, shape (L,)
    time_s, path_covariance_m2, path_modes_m : optional
        As of `SyntheticAperture.bearings`.

    Raises
    ------
    ValueError
        Where the path and the nodes do not determine the bearings.
    """
    path = np.asarray(path_m, dtype=np.float64)
    bearing = np.atleast_1d(np.asarray(bearing_rad, dtype=np.float64))
    snr = np.broadcast_to(10.0 ** (np.asarray(snr_db, dtype=np.float64) / 10.0), bearing.shape)
    return np.asarray(
        _array.aperture_crlb(
            path,
            _times(time_s, len(path)),
            _wavelengths(wavelength_m, len(bearing)),
            bearing,
            np.ascontiguousarray(snr),
            _modes(path_covariance_m2, path_modes_m, len(path)),
            _options(phase, phase_sigma_rad_per_sqrt_s, frequency_offsets, path_sigma_m_per_sqrt_step),
        ),
        dtype=np.float64,
    )


def _looks(phasors: npt.ArrayLike) -> npt.NDArray[np.complex128]:
    y = np.asarray(phasors, dtype=np.complex128)
    return y[:, None] if y.ndim == 1 else y


def aperture_spectrum(
    phasors: npt.ArrayLike,
    path_m: npt.ArrayLike,
    wavelength_m: float,
    bearing_rad: npt.ArrayLike,
    *,
    method: _Method = "beamforming",
    n_sources: int = 1,
    subaperture: int = 0,
) -> _Floats:
    """One node's spectrum along a path whose clock is known or quiet; 0 to 1.

    Parameters
    ----------
    phasors : array_like, shape (n,) or (n, looks), complex
        Looks: subcarriers far apart, or loops. MUSIC needs as many as sources.
    path_m : array_like, shape (n, 2)
    wavelength_m : float
    bearing_rad : array_like, shape (b,)
    method : {"beamforming", "music"}
        The maximum of beamforming is the link's coherence.
    n_sources : int
    subaperture : int
        Snapshots of the pieces that a straight path of even steps is cut into, for MUSIC on coherent paths.
    """
    return _array.aperture_spectrum(_looks(phasors), path_m, wavelength_m, bearing_rad, method, n_sources, subaperture)


def aperture_directions(
    phasors: npt.ArrayLike,
    path_m: npt.ArrayLike,
    wavelength_m: float,
    *,
    method: _Method = "beamforming",
    n_sources: int = 1,
    subaperture: int = 0,
) -> _Floats:
    """The highest separate maxima of `aperture_spectrum`, at most `n_sources`, highest first [rad].

    Both sides of a straight path count: ask for twice as many there.
    """
    return _array.aperture_directions(_looks(phasors), path_m, wavelength_m, method, n_sources, subaperture)


@dataclasses.dataclass(frozen=True)
class BearingCheck:
    """What bearings say about a position; NaN where there was no bearing.

    Attributes
    ----------
    residual_rad : ndarray, shape (L,)
        Bearing less the expected one.
    statistic : ndarray, shape (L,)
        Chi-square of one degree of freedom, against the position and all other bearings.
    consistent : ndarray of bool, shape (L,)
        Below the gate after the worst were left out one by one.
    heading_rad, total : float
        The heading used or found; chi-square of the consistent ones together.
    degrees_of_freedom : int
        Of `total`.
    """

    residual_rad: _Floats
    statistic: _Floats
    consistent: _Bools
    heading_rad: float
    total: float
    degrees_of_freedom: int


def check_bearings(
    bearing_rad: npt.ArrayLike,
    covariance_rad2: npt.ArrayLike,
    nodes_m: npt.ArrayLike,
    position_m: npt.ArrayLike,
    position_covariance_m2: npt.ArrayLike,
    *,
    heading_rad: float = 0.0,
    heading_sigma_rad: float = np.inf,
    gate: float = 10.8,
) -> BearingCheck:
    """Whether bearings point where nodes are: what alone tells a specular reflection, for it is coherent.

    Parameters
    ----------
    bearing_rad, covariance_rad2 : array_like, shapes (L,) and (L, L)
        Of `ApertureBearings`, in the handset's frame; NaN: left out.
    nodes_m : array_like, shape (L, 2)
    position_m, position_covariance_m2 : array_like, shapes (2,) and (2, 2)
        A fix that does not come from these bearings.
    heading_rad, heading_sigma_rad : float
        Of the handset's axis 1; infinity: unknown, found from the bearings.
    gate : float
        Of the statistic.
    """
    found = _array.check_bearings(
        bearing_rad,
        np.asarray(covariance_rad2, dtype=np.float64),
        nodes_m,
        np.asarray(position_m, dtype=np.float64),
        np.asarray(position_covariance_m2, dtype=np.float64),
        heading_rad,
        heading_sigma_rad,
        gate,
    )
    return BearingCheck(
        found["residual_rad"],
        found["statistic"],
        np.asarray(found["consistent"], dtype=np.bool_),
        found["heading_rad"],
        found["total"],
        found["degrees_of_freedom"],
    )
