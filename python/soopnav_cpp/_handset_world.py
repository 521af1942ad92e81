"""Walks indoors as a handset sees them, and links that lose their line of sight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import simulation as _simulation

__all__ = ["HandsetWorld", "NlosSchedule"]

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NlosSchedule:
    """When which link has no line of sight, and how late it is then; n epochs of L links.

    Attributes
    ----------
    blocked : ndarray of bool, shape (n, L)
    excess_m : ndarray, shape (n, L)
        Zero with line of sight.
    attempts : int
        Schedules drawn until one kept the guard.
    guarded : bool
        False: none of them did; this is the nearest.
    clear_share : float
        Share of the time that the link that is worst off has line of sight.
    """

    blocked: npt.NDArray[np.bool_]
    excess_m: _Array
    attempts: int
    guarded: bool
    clear_share: float

    @classmethod
    def generate(cls, epochs: int, step_s: float, *, seed: int = 0, **options: float) -> NlosSchedule:
        """Two-state Markov chains, one for each link, with guards.

        A link that would be one too many stays clear, so ``max_blocked`` holds at every epoch; a schedule in which a
        link is clear for less than ``min_clear_share`` is drawn again, up to ``attempts`` times.

        Parameters
        ----------
        epochs : int
        step_s : float
        seed : int
        **options
            ``links`` (6), ``max_blocked`` (2), ``min_clear_share`` (0.4), ``mean_los_s`` (10), ``mean_nlos_s`` (5),
            ``excess_min_m`` (4), ``excess_max_m`` (20): the excess delay begins uniformly between them and is reflected
            at them, ``excess_walk_m2ps`` (0.025), ``attempts`` (200).

        Returns
        -------
        NlosSchedule

        Raises
        ------
        ValueError
            For an option that is unknown or out of range.
        """
        if epochs < 1 or seed < 0:
            raise ValueError(f"epochs, seed: at least 1 and 0 expected, got {epochs} and {seed}")
        return _schedule(_simulation.nlos_schedule(epochs, step_s, seed, **options))


def _schedule(numbers: tuple[Any, ...]) -> NlosSchedule:
    blocked, excess, attempts, guarded, share = numbers
    return NlosSchedule(blocked.astype(np.bool_), excess, attempts, guarded, share)


@dataclass(frozen=True)
class HandsetWorld:
    """One walk: f frames, n epochs, L links. Times count from its start; headings from x towards y.

    Attributes
    ----------
    nodes_m : ndarray, shape (L, 3)
    told_heading_rad : float
        What is said of the heading at the start.
    frame_s : ndarray, shape (f,)
    pose : ndarray, shape (f, 3)
        x, y, a_z at each frame.
    increments : ndarray, shape (f - 1, 3)
        The camera's steps with their errors, in the axes of the previous body.
    walked_m : ndarray, shape (f,)
        Length of the way up to each frame.
    epoch_s : ndarray, shape (n,)
    position_m : ndarray, shape (n, 2)
        At each epoch.
    ranges_m : ndarray, shape (n, L)
    clock_m : ndarray, shape (n,)
    nlos : NlosSchedule
    """

    nodes_m: _Array
    told_heading_rad: float
    frame_s: _Array
    pose: _Array
    increments: _Array
    walked_m: _Array
    epoch_s: _Array
    position_m: _Array
    ranges_m: _Array
    clock_m: _Array
    nlos: NlosSchedule

    @classmethod
    def generate(cls, seed: int = 0, **options: float) -> HandsetWorld:
        """A walk between random points of a square room, with nodes all round outside.

        Parameters
        ----------
        seed : int
        **options
            Those of `NlosSchedule.generate`, of which ``links`` is the number of nodes; ``duration_s`` (60), ``room_m``
            (20), ``min_node_m`` (25), ``max_node_m`` (60), ``min_speed_mps`` (0.4), ``max_speed_mps`` (1),
            ``range_rate_hz`` (10), ``range_sigma_m`` (1), ``clock_walk_m2ps`` (0.04), ``clock_sigma_m`` (50),
            ``frame_rate_hz`` (20), ``step_sigma_m`` (0.2e-3), ``turn_sigma_rad`` (0.02 degrees), ``foot_sigma_m`` (0),
            ``heading_error_rad`` (10 degrees), ``epoch_offset_s`` (0.02).

        Returns
        -------
        HandsetWorld

        Raises
        ------
        ValueError
            For an option that is unknown or out of range.
        """
        if seed < 0:
            raise ValueError(f"seed = {seed}: a number that is not negative expected")
        made: tuple[Any, ...] = _simulation.handset_world(seed, **options)
        nodes, heading, frames, pose, increments, walked, epochs, position, ranges, clock, schedule = made
        return cls(
            nodes, heading, frames, pose, increments, walked, epochs, position, ranges, clock, _schedule(schedule)
        )

    @property
    def start_m(self) -> _Array:
        """Where the walk begins, shape (2,)."""
        return self.pose[0, :2]

    def __repr__(self) -> str:
        return f"HandsetWorld({len(self.nodes_m)} nodes, {self.walked_m[-1]:.0f} m in {self.frame_s[-1]:g} s)"
