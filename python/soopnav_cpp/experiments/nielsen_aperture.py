"""The handset as a synthetic array: nielsen's phase II."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import array, estimation, simulation
from soopnav_cpp.clock import TwoState
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, condition, derive_seed, experiment, style

Floats = npt.NDArray[np.float64]

WAVELENGTH_M = 0.15
SNAPSHOTS = 50
STEP_S = 0.04
LENGTHS = 5.0  # of the path, in wavelengths
SNR_DB = 10.0
PATH_SIGMA_M = 5e-4  # per root step and axis
TCXO = TwoState(h0=7.2e-19, h_minus_2=1e-22)  # Allan deviation 6e-10 at 1 s: 7.5 rad per root second at 2 GHz
COLOURS = ("#2b5f9e", "#b5442e", "#3a7d44", "#c98a1b")
THRESHOLD = 0.7


def arc(turn: float, snapshots: int = SNAPSHOTS, lengths: float = LENGTHS) -> Floats:
    """Path of `lengths` wavelengths along an arc of `turn` radians; a whole turn closes it. Shape (n, 2), metres."""
    radius = lengths * WAVELENGTH_M / turn
    at = turn * np.arange(snapshots) / (snapshots if turn > 6.0 else snapshots - 1)
    return radius * np.column_stack((np.cos(at), np.sin(at)))


def line(snapshots: int = SNAPSHOTS, lengths: float = LENGTHS) -> Floats:
    """The same length straight along axis 1."""
    return np.column_stack((np.linspace(0.0, lengths * WAVELENGTH_M, snapshots), np.zeros(snapshots)))


def around(rng: np.random.Generator, nodes: int) -> Floats:
    """Bearings of nodes all around, each up to a fifth of the spacing off its even place."""
    spacing = 2.0 * np.pi / nodes
    return spacing * (np.arange(nodes) + rng.uniform(-0.2, 0.2, nodes)) + rng.uniform(-np.pi, np.pi)


def wrapped(angle_rad: npt.ArrayLike) -> Floats:
    """Into (-pi, pi]."""
    return np.asarray(np.angle(np.exp(1j * np.asarray(angle_rad))), dtype=np.float64)


def loops(seed: int, nodes: int, turn: float, batch: int) -> Floats:
    """Joint estimates under a TCXO.

    Returns
    -------
    ndarray, shape (batch, 3 nodes + 2)
        Errors and their bound [rad], the bound of an exact path, NEES, and whether there was one answer.
    """
    rng = np.random.default_rng(seed)
    path = arc(turn)
    time_s = STEP_S * np.arange(SNAPSHOTS)
    aperture = array.SyntheticAperture(path_sigma_m_per_sqrt_step=PATH_SIGMA_M)
    out = np.full((batch, 3 * nodes + 2), np.nan)
    for trial in range(batch):
        bearing = around(rng, nodes)
        seen = simulation.aperture_snapshots(
            path, bearing, WAVELENGTH_M, snr_db=SNR_DB, frequency_hz=rng.uniform(-3.0, 3.0, nodes), time_s=time_s,
            clock=TCXO, path_sigma_m_per_sqrt_step=PATH_SIGMA_M, seed=derive_seed(seed, trial),
        )  # fmt: skip
        found = aperture.bearings(seen.phasors, seen.path_m, WAVELENGTH_M, time_s=time_s)
        bounds = [
            np.sqrt(np.diag(array.synthetic_aperture_crlb(
                path, WAVELENGTH_M, bearing, SNR_DB, time_s=time_s, path_sigma_m_per_sqrt_step=sigma
            )))
            for sigma in (PATH_SIGMA_M, 0.0)
        ]  # fmt: skip
        error = wrapped(found.bearing_rad - bearing)
        out[trial, nodes:-2] = np.concatenate(bounds)
        if found.ok and np.isfinite(error).all():
            out[trial, :nodes] = error
            out[trial, -2] = estimation.nees(error[None], found.covariance_rad2[None])[0]
        out[trial, -1] = found.status is array.ApertureStatus.OK
    return out


def straight(seed: int, batch: int) -> Floats:
    """A straight path: status under a known and a free phase, and the nearer of two answers over its sigma."""
    rng = np.random.default_rng(seed)
    path = line()
    quiet = array.SyntheticAperture(phase="known", frequency_offsets=False)
    free = array.SyntheticAperture()
    out = np.empty((batch, 4))
    for trial in range(batch):
        bearing = rng.uniform(0.3, np.pi - 0.3, 3) * rng.choice((-1.0, 1.0), 3)
        seen = simulation.aperture_snapshots(path, bearing, WAVELENGTH_M, snr_db=SNR_DB, seed=derive_seed(seed, trial))
        found = quiet.bearings(seen.phasors, path, WAVELENGTH_M)
        both = np.stack((wrapped(found.bearing_rad - bearing), wrapped(found.mirror_rad - bearing)))
        sigma = found.sigma_rad
        noisy = simulation.aperture_snapshots(
            path, bearing, WAVELENGTH_M, snr_db=SNR_DB, clock=TCXO, seed=derive_seed(seed, trial)
        )
        refused = free.bearings(noisy.phasors, path, WAVELENGTH_M)
        out[trial] = (
            found.status is array.ApertureStatus.TWO_ANSWERS and bool(np.isfinite(both).all()),
            float(np.max(np.min(np.abs(both), axis=0) / sigma)),
            float(np.mean(np.abs(both[0]) > np.abs(both[1]))),
            refused.status is array.ApertureStatus.SINGULAR and not refused.ok,
        )
    return out


KINDS = (("line of sight", np.inf), ("K = 10 dB", 10.0), ("K = 3 dB", 3.0), ("Rayleigh", -np.inf))


def coherences(seed: int, batch: int) -> Floats:
    """Coherence of single links whose clock is removed, shape (batch, kinds); then one of four under a TCXO."""
    time_s = STEP_S * np.arange(SNAPSHOTS)
    rng = np.random.default_rng(seed)
    path = arc(2.0 * np.pi)
    alone = array.SyntheticAperture(phase="known", frequency_offsets=False, coherence_threshold=0.0)
    out = np.empty((batch, len(KINDS)))
    for trial in range(batch):
        seen = simulation.aperture_snapshots(
            path, rng.uniform(-np.pi, np.pi, len(KINDS)), WAVELENGTH_M, snr_db=SNR_DB, time_s=time_s,
            k_factor_db=[k for _, k in KINDS], seed=derive_seed(seed, trial),
        )  # fmt: skip
        out[trial] = alone.bearings(seen.phasors, path, WAVELENGTH_M, time_s=time_s).coherence
    return out


def mixed(seed: int, batch: int) -> Floats:
    """Four links under a TCXO, one of them Rayleigh: whether it alone was left out, and the others' worst error."""
    time_s = STEP_S * np.arange(SNAPSHOTS)
    rng = np.random.default_rng(seed)
    path = arc(2.0 * np.pi)
    aperture = array.SyntheticAperture(max_frequency_hz=4.0)
    out = np.empty((batch, 2))
    for trial in range(batch):
        bearing = around(rng, 4)
        lost = int(rng.integers(4))
        k_factor = np.full(4, np.inf)
        k_factor[lost] = -np.inf
        seen = simulation.aperture_snapshots(
            path, bearing, WAVELENGTH_M, snr_db=SNR_DB, time_s=time_s, k_factor_db=k_factor, clock=TCXO,
            frequency_hz=rng.uniform(-2.0, 2.0, 4), seed=derive_seed(seed, trial),
        )  # fmt: skip
        found = aperture.bearings(seen.phasors, path, WAVELENGTH_M, time_s=time_s)
        error = np.abs(wrapped(found.bearing_rad - bearing))
        right = bool(found.ok and (found.los == np.isfinite(k_factor + 0.0)).all()) if found.ok else False
        right = found.ok and not found.los[lost] and int(found.los.sum()) == 3
        out[trial] = (right, float(np.nanmax(error)) if right else np.nan)
    return out


def one_node(seed: int, batch: int) -> Floats:
    """One node under a TCXO and under a quiet clock, the phase taken as constant: errors [rad], shape (batch, 2)."""
    rng = np.random.default_rng(seed)
    path = arc(2.0 * np.pi)
    time_s = STEP_S * np.arange(SNAPSHOTS)
    aperture = array.SyntheticAperture(phase="known", coherence_threshold=0.0, max_sigma_rad=np.pi, max_frequency_hz=2.0)
    quiet = TwoState(h0=2e-22 / 1.0, h_minus_2=1e-26)  # 1e-11 at 1 s
    out = np.empty((batch, 2))
    for trial in range(batch):
        bearing = rng.uniform(-np.pi, np.pi, 1)
        for column, clock in enumerate((TCXO, quiet)):
            seen = simulation.aperture_snapshots(
                path, bearing, WAVELENGTH_M, snr_db=SNR_DB, time_s=time_s, clock=clock, seed=derive_seed(seed, trial)
            )
            found = aperture.bearings(seen.phasors, path, WAVELENGTH_M, time_s=time_s)
            out[trial, column] = wrapped(found.bearing_rad - bearing)[0]
    return out


BLIND_NODES = 6
BLIND_SNAPSHOTS = 150
BLIND_SNR_DB = 20.0


def blind(seed: int, batch: int) -> Floats:
    """Angles to the first node without a path: errors and reported sigmas [rad], shape (batch, 2, nodes - 1)."""
    rng = np.random.default_rng(seed)
    path = arc(2.0 * np.pi, BLIND_SNAPSHOTS)
    time_s = 0.02 * np.arange(BLIND_SNAPSHOTS)
    aperture = array.SyntheticAperture()
    out = np.full((batch, 2, BLIND_NODES - 1), np.nan)
    for trial in range(batch):
        bearing = around(rng, BLIND_NODES)
        seen = simulation.aperture_snapshots(
            path, bearing, WAVELENGTH_M, snr_db=BLIND_SNR_DB, time_s=time_s, clock=TCXO,
            frequency_hz=rng.uniform(-3.0, 3.0, BLIND_NODES), seed=derive_seed(seed, trial),
        )  # fmt: skip
        found = aperture.blind(seen.phasors, WAVELENGTH_M, time_s=time_s)
        truth = wrapped(bearing - bearing[0])
        if found.ok:
            errors = [wrapped(sign * found.bearing_rad - truth)[1:] for sign in (1.0, -1.0)]
            out[trial, 0] = min(errors, key=lambda e: float(np.sum(e**2)))
            out[trial, 1] = np.sqrt(np.diag(found.covariance_rad2))[1:]
    return out
