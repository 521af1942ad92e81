"""Bearings of carter's drive, as MUSIC finds them in sample covariances: what the locators of section 5.5 are given."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from soopnav_cpp.array import ArrayGeometry, DirectionFinder, SigmaMap
from soopnav_cpp.scenarios.emitter_drive import EXCESS_LOSS_DB, EmitterDrive, emitter_drive
from soopnav_cpp.simulation import ArrayLink

__all__ = ["EPOCHS", "SNAPSHOTS", "build_map", "far_starts", "hear", "observed_sigma", "path"]

Array = npt.NDArray[np.float64]

EPOCHS = 240
SNAPSHOTS = 2500
SPACING_WAVELENGTHS = 0.2
STEP_DEG = 4.0  # of the scan; peaks are followed off the grid


@lru_cache(maxsize=1)
def path() -> EmitterDrive:
    """The drive: 1200 m east at 150 m distance, a quarter circle, 1200 m north; the emitter 30 m up."""
    return emitter_drive(epochs=EPOCHS)


@lru_cache(maxsize=1)
def _receiver() -> tuple[ArrayLink, DirectionFinder]:
    geometry = ArrayGeometry.planar(2, 2, spacing_wavelengths=SPACING_WAVELENGTHS)
    finder = DirectionFinder(geometry, azimuth_step_deg=STEP_DEG, elevation_step_deg=STEP_DEG)
    return ArrayLink(geometry, excess_loss_db=EXCESS_LOSS_DB), finder


def build_map(seed: int) -> SigmaMap:
    """Error against eigenvalue ratio of this array, for elevations as the drive has them."""
    geometry = ArrayGeometry.planar(2, 2, spacing_wavelengths=SPACING_WAVELENGTHS)
    return SigmaMap.build(geometry, SNAPSHOTS, trials=1000, elevation_rad=(0.02, 0.20), step_deg=STEP_DEG, seed=seed)


def hear(seed: int, sigma_map: SigmaMap, drives: int) -> tuple[Array, Array]:
    """Azimuths in the local frame and their predicted deviations: each (drives, epochs).

    The deviation is the map's, for eigenvalues averaged over eleven epochs (carter fig. 5.13).
    """
    drive = path()
    link, finder = _receiver()
    snr_db = np.tile(link.snr_db(drive.distance_m), drives)
    azimuth = np.tile(drive.array_azimuth_rad, drives)
    elevation = np.tile(drive.elevation_rad, drives)
    found = finder.run(link.covariances(snr_db, azimuth, elevation, SNAPSHOTS, seed=seed), SNAPSHOTS)
    measured = found.azimuth_rad[:, 0].reshape(drives, EPOCHS)
    eigenvalues = found.eigenvalues.reshape(drives, EPOCHS, -1)
    sigma = np.array([sigma_map.sigma(sigma_map.smooth(values)) for values in eigenvalues])
    return np.array([drive.local_azimuth(row) for row in measured]), sigma


def observed_sigma(azimuth_rad: Array) -> Array:
    """Rms error at each epoch over all runs, shape (epochs,)."""
    error = azimuth_rad - path().azimuth_rad
    error -= 2.0 * np.pi * np.round(error / (2.0 * np.pi))
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def far_starts(rng: np.random.Generator, count: int) -> Array:
    """First guesses 1000 m from the emitter in any direction, shape (count, 2)."""
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    return np.asarray(path().emitter_m[:2] + 1000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
