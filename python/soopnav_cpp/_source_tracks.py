"""Several sources at once, from bearings of whom nobody says whose they are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp._core.navigation import SourceTrack, TrackState
from soopnav_cpp._source import SourceLocator
from soopnav_cpp._source_inputs import MOTIONS, floats, named, observed

__all__ = ["SourceTrack", "SourceTracks", "TrackState"]

_Array = npt.NDArray[np.float64]


class SourceTracks:
    """Several sources at once: the bearings of each epoch are shared out among banks of filters.

    Association is by global nearest neighbour, with a gate and false bearings; free bearings start tentative tracks,
    hits confirm them, misses end them.

    Parameters
    ----------
    dimensions : {2, 3}
    motion : {"static", "constant_velocity"}
    gate_probability : float
        Of leaving out a source's own bearing.
    clutter_density_per_rad : float
        False bearings in an epoch, per radian (in three dimensions per square radian).
    confirm_hits, confirm_epochs : int
        Bearings that confirm a track, and the epochs it has for them.
    drop_misses : int
        Epochs in a row without a bearing that end a confirmed track.
    **options
        Of the banks, see `SourceLocator`.
    """

    def __init__(
        self,
        *,
        dimensions: int = 2,
        motion: str = "static",
        gate_probability: float = 1e-4,
        clutter_density_per_rad: float = 0.01,
        confirm_hits: int = 5,
        confirm_epochs: int = 8,
        drop_misses: int = 30,
        **options: float,
    ) -> None:
        unknown = sorted(set(options) - SourceLocator._OPTIONS)
        if unknown:
            raise ValueError(f"{unknown[0]}: no such option; known are {', '.join(sorted(SourceLocator._OPTIONS))}")
        self.dimensions = dimensions
        self.tracks: list[SourceTrack] = []
        kind = named("motion", motion, MOTIONS)
        try:
            self._core = _navigation.SourceTracks(
                dimensions,
                kind,
                gate_probability,
                clutter_density_per_rad,
                confirm_hits,
                confirm_epochs,
                drop_misses,
                **options,
            )
        except (RuntimeError, TypeError):
            counts = {"confirm_hits": confirm_hits, "confirm_epochs": confirm_epochs, "drop_misses": drop_misses}
            raise ValueError(f"options: a number of the wrong kind among {options | counts}") from None

    def step(
        self,
        t_s: float,
        position: npt.ArrayLike,
        bearings: npt.ArrayLike,
        sigmas: npt.ArrayLike,
        *,
        position_covariance: npt.ArrayLike | None = None,
        heading_sigma_rad: float = 0.0,
    ) -> list[SourceTrack]:
        """One epoch.

        Parameters
        ----------
        t_s : float
        position : array_like, shape (d,)
        bearings : array_like, shape (k,) or (k, 2)
            Of all sources heard; may be none.
        sigmas : float or array_like, shape (k,) or (k, 2)

        Returns
        -------
        list of SourceTrack
            Oldest first; also `tracks`.
        """
        z = floats("bearings", bearings)
        k = len(z) if z.ndim else 1
        z = z.reshape(k, self.dimensions - 1) if z.size else np.empty((0, self.dimensions - 1))
        at = floats("position", position).reshape(1, -1)
        seen = observed(
            np.repeat(at, len(z), axis=0),
            z,
            sigmas if len(z) else 1.0,
            times=np.full(len(z), t_s),
            position_covariance=position_covariance,
            heading_sigma_rad=heading_sigma_rad,
            dimensions=self.dimensions,
        )
        self.tracks = self._core.step(*seen.arguments)
        return self.tracks

    def __iter__(self) -> Iterator[SourceTrack]:
        return iter(self.tracks)

    @property
    def confirmed(self) -> list[SourceTrack]:
        """The tracks that are confirmed."""
        return [track for track in self.tracks if track.state is TrackState.CONFIRMED]
