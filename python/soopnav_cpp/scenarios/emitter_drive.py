"""A drive past a radio emitter: the poses, powers and directions of carter's simulation (5.3, figs. 5.9-5.13).

The path is deterministic; what an array hears along it is drawn by `soopnav_cpp.simulation.ArrayLink`. Directions come
twice: in the local frame (azimuth from x towards y, as `soopnav_cpp.navigation.locate_source` counts it) and in array
axes (axis 1 forward, 2 to the left, 3 up).
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from soopnav_cpp.array import Calibration, DirectionFinder
    from soopnav_cpp.simulation import ArrayLink, FrontEnd

__all__ = ["EXCESS_LOSS_DB", "DriveBearings", "EmitterDrive", "emitter_drive", "heading_rotation", "measure", "wrapped"]

_Floats = npt.NDArray[np.float64]

#: Polarisation, bodies and attenuator: what free space lacks to make bearings useless at 1.2 km, as the paper has them.
EXCESS_LOSS_DB = 26.6


@dataclasses.dataclass(frozen=True)
class EmitterDrive:
    """A path with the truth about one emitter. Local metres, columns east, north, up; n epochs.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    positions_m : ndarray, shape (n, 3)
        Of the array.
    heading_rad : ndarray, shape (n,)
        Of axis 1, from x (east) towards y (north).
    emitter_m : ndarray, shape (3,)
    azimuth_rad, elevation_rad, distance_m : ndarray, shape (n,)
        Of the emitter in the local frame.
    """

    t_s: _Floats
    positions_m: _Floats
    heading_rad: _Floats
    emitter_m: _Floats
    azimuth_rad: _Floats
    elevation_rad: _Floats
    distance_m: _Floats

    @property
    def array_azimuth_rad(self) -> _Floats:
        """Azimuth of the emitter in array axes, shape (n,), in (-π, π]."""
        return wrapped(self.azimuth_rad - self.heading_rad)

    @property
    def rotation(self) -> _Floats:
        """Array axes to local ones, shape (n, 3, 3): what `ArrayLink.observe` takes."""
        return heading_rotation(self.heading_rad)

    def local_azimuth(self, array_azimuth_rad: npt.ArrayLike) -> _Floats:
        """Azimuths measured in array axes, shape (n,), in the local frame."""
        return wrapped(np.asarray(array_azimuth_rad, float) + self.heading_rad)


def wrapped(angle_rad: npt.ArrayLike) -> _Floats:
    """The same angle in (-π, π]."""
    angle = np.asarray(angle_rad, float)
    return angle - 2.0 * math.pi * np.ceil((angle - math.pi) / (2.0 * math.pi))


def heading_rotation(heading_rad: npt.ArrayLike) -> _Floats:
    """Rotation of level axes (forward, left, up) into local ones (east, north, up), shape (..., 3, 3)."""
    heading = np.asarray(heading_rad, float)
    out = np.zeros((*heading.shape, 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(heading)
    out[..., 1, 0] = np.sin(heading)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out


def emitter_drive(
    *,
    epochs: int = 240,
    leg_m: float = 1200.0,
    distance_m: float = 150.0,
    height_m: float = 30.0,
    speed_mps: float = 11.0,
) -> EmitterDrive:
    """The drive: `leg_m` east, a quarter circle round the emitter to the left, `leg_m` north.

    Parameters
    ----------
    epochs : int
        Evenly spaced along the path, ends included.
    leg_m, distance_m : float
        Of the straight parts; from the path's nearest points to the emitter.
    height_m : float
        Of the emitter over the array.
    speed_mps : float

    Returns
    -------
    EmitterDrive
        The emitter stands at (0, 0, height_m), the drive begins at (-leg_m, -distance_m, 0).

    Raises
    ------
    ValueError
        For fewer than two epochs, or a length or speed that is not finite and positive (height: not finite).
    """
    if epochs < 2:
        raise ValueError(f"epochs: {epochs}; at least 2 are needed")
    for name, value in (("leg_m", leg_m), ("distance_m", distance_m), ("speed_mps", speed_mps)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: {value:g}; it must be finite and positive")
    if not math.isfinite(height_m):
        raise ValueError(f"height_m: {height_m:g}; it must be finite")
    arc = 0.5 * math.pi * distance_m
    along = np.linspace(0.0, 2.0 * leg_m + arc, epochs)
    turn = np.clip((along - leg_m) / distance_m, 0.0, 0.5 * math.pi)
    before = np.minimum(along - leg_m, 0.0)
    after = np.maximum(along - leg_m - arc, 0.0)
    positions = np.stack(
        [distance_m * np.sin(turn) + before, -distance_m * np.cos(turn) + after, np.zeros(epochs)], axis=1
    )
    emitter = np.array([0.0, 0.0, height_m])
    offset = emitter - positions
    distance = np.sqrt((offset**2).sum(axis=1))
    return EmitterDrive(
        t_s=along / speed_mps,
        positions_m=positions,
        heading_rad=turn,
        emitter_m=emitter,
        azimuth_rad=np.arctan2(offset[:, 1], offset[:, 0]),
        elevation_rad=np.arcsin(offset[:, 2] / distance),
        distance_m=distance,
    )


@dataclasses.dataclass(frozen=True)
class DriveBearings:
    """What an array found along an `EmitterDrive`, one bearing per epoch.

    Attributes
    ----------
    azimuth_rad, elevation_rad : ndarray, shape (n,)
        In the local frame; NaN where MUSIC found nothing.
    eigenvalues : ndarray, shape (n, M)
        Of the sample covariances, descending.
    """

    azimuth_rad: _Floats
    elevation_rad: _Floats
    eigenvalues: _Floats

    def errors(self, drive: EmitterDrive) -> tuple[_Floats, _Floats]:
        """Of azimuth and elevation, shape (n,) each, radians."""
        return wrapped(self.azimuth_rad - drive.azimuth_rad), self.elevation_rad - drive.elevation_rad


def measure(
    drive: EmitterDrive,
    link: ArrayLink,
    finder: DirectionFinder,
    *,
    n_samples: int = 2500,
    seed: int,
    generated_iq: bool = True,
    front_end: FrontEnd | None = None,
    calibration: Calibration | None = None,
) -> DriveBearings:
    """Bearings by MUSIC along a drive.

    Parameters
    ----------
    drive : EmitterDrive
    link : ArrayLink
        Of the array that `finder` was made for.
    finder : DirectionFinder
        For one source.
    n_samples : int
        Per epoch.
    seed : int
    generated_iq : bool
        From samples (some 30 ms for 240 epochs of 2500 on four elements), or from sample covariances of the same law
        without them (half as long).
    front_end : FrontEnd, optional
        Receivers that the samples pass (carter figs. 5.4 and 5.8); its noise takes the place of the link's.
    calibration : Calibration, optional
        Of these receivers: undone before MUSIC.

    Returns
    -------
    DriveBearings
    """
    azimuth, elevation, distance = drive.array_azimuth_rad, drive.elevation_rad, drive.distance_m
    if generated_iq:
        blocks = (
            link.blocks(azimuth, elevation, snr_db=link.snr_db(distance), n_samples=n_samples, seed=seed)
            if front_end is None
            else link.blocks(
                azimuth,
                elevation,
                power_dbm=link.received_power_dbm(distance),
                n_samples=n_samples,
                seed=seed,
                front_end=front_end,
            )
        )
        samples = np.ascontiguousarray(blocks.transpose(1, 0, 2)).reshape(blocks.shape[1], -1)
        found = finder.track(samples if calibration is None else calibration.apply(samples), n_samples)
    else:
        if front_end is not None or calibration is not None:
            raise ValueError("generated_iq: False; a front end and its calibration need samples")
        found = finder.run(link.covariances(link.snr_db(distance), azimuth, elevation, n_samples, seed), n_samples)
    return DriveBearings(
        azimuth_rad=drive.local_azimuth(found.azimuth_rad[:, 0]),
        elevation_rad=found.elevation_rad[:, 0],
        eigenvalues=found.eigenvalues,
    )
