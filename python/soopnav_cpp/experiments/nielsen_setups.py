"""The particle-filter experiments of nielsen 3.3.2 … 3.3.6 as data: what the text and the listings PF1 … PF5 set.

Where text and listing differ, the listing is followed and the text's number stands beside it. Two habits of the
listings are not part of the set-ups: `normpdf` is given the variance where it wants the standard deviation (the same
number for a variance of 1), and resampling takes the nearest entry of the cumulative sum instead of the next one.

Lengths are metres, and a step is a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = [
    "CROSSING",
    "ROOM",
    "ROOM_BIAS",
    "SMOOTH",
    "STEP",
    "STILL",
    "Crossing",
    "Room",
    "RoomBias",
    "Smooth",
    "Step",
    "Still",
    "corners",
]

Array = npt.NDArray[np.float64]


def corners(width_m: float, depth_m: float) -> Array:
    """The corners of a room, counted as PF4 counts its nodes: (0, 0), (0, depth), (width, depth), (width, 0)."""
    return np.array([[0.0, 0.0], [0.0, depth_m], [width_m, depth_m], [width_m, 0.0]])


@dataclass(frozen=True)
class Still:
    """Listing PF1, section 3.3.2, Figs. 18 … 21: a place on a line that does not move, a range to it at each step.

    The text moves it by a known 1 m per step, which shifts every figure and changes nothing else.
    """

    particles: int = 1000
    steps: int = 20
    x_m: float = 0.0
    prior_m: tuple[float, float] = (-5.0, 5.0)
    """Uniform between these."""
    sigma_z_m: float = 1.0
    figures: tuple[int, ...] = (1, 2, 20)
    """The steps of Figs. 18, 19 and 20."""

    def measurements(self, rng: np.random.Generator) -> Array:
        """One range per step, shape (steps,)."""
        return self.x_m + self.sigma_z_m * rng.standard_normal(self.steps)


@dataclass(frozen=True)
class Step:
    """Listing PF2, section 3.3.2, Figs. 22 … 24: a smooth step from 0 to 2 m, followed by a random walk.

    Particles start 1 m off.
    """

    particles: int = 200
    steps: int = 2500
    sigmas_m: tuple[float, ...] = (0.005, 0.02, 0.06)
    """Standard deviation of the walk per step, of Figs. 22, 23 and 24; the listing has the second."""
    prior_m: tuple[float, float] = (0.9, 1.1)
    sigma_z_m: float = 1.0
    height_m: float = 2.0
    rise: float = 100.0
    """Steps in which the hyperbolic tangent's argument grows by 1."""
    transition: tuple[int, int] = (900, 1600)
    """Steps over which the response is judged (ours)."""

    def truth(self) -> Array:
        """Places at steps 1 … `steps`, shape (steps,)."""
        k = np.arange(1, self.steps + 1)
        return np.asarray(0.5 * self.height_m * (1.0 + np.tanh((k - self.steps / 2) / self.rise)), np.float64)

    def measurements(self, rng: np.random.Generator) -> Array:
        """One range per step, shape (steps,)."""
        return self.truth() + self.sigma_z_m * rng.standard_normal(self.steps)


@dataclass(frozen=True)
class Room:
    """Listing PF3, section 3.3.3, Figs. 26 … 31: a receiver stands in a room, ranges to nodes in its corners.

    The listings of two and four nodes (pt_7, pt_8) are not printed: the text takes all else as before, and puts the
    receiver of Fig. 31 at (3, 6).
    """

    size_m: float = 10.0
    particles: int = 500
    steps: int = 800
    receiver_m: tuple[float, float] = (5.0, 6.0)
    receiver_four_nodes_m: tuple[float, float] = (3.0, 6.0)
    one_node_m: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    two_nodes_m: tuple[tuple[float, float], ...] = ((0.0, 0.0), (10.0, 0.0))
    """As the equations have it; the text also says (0, 10)."""
    two_nodes_steps: int = 10
    sigma_step_m: float = 0.5
    """Of each coordinate, per step. The prior is uniform in the room."""
    sigma_z_m: float = 1.0

    @property
    def four_nodes_m(self) -> Array:
        """One in each corner, shape (4, 2)."""
        return corners(self.size_m, self.size_m)


@dataclass(frozen=True)
class RoomBias:
    """Listing PF4, section 3.3.4, Figs. 32 and 33: that room, four nodes and a clock bias; state [x y b]."""

    size_m: float = 10.0
    particles: int = 400
    steps: int = 100
    receiver_m: tuple[float, float] = (3.0, 6.0)
    bias_m: float = 1.0
    sigma_step_m: tuple[float, float, float] = (0.1, 0.1, 0.1)
    prior_m: tuple[float, float] = (0.0, 10.0)
    """Uniform, each of x, y and b."""
    sigma_z_m: float = 1.0
    settled: tuple[int, int] = (51, 100)
    """Steps over which errors are judged (ours)."""

    @property
    def nodes_m(self) -> Array:
        """Shape (4, 2)."""
        return corners(self.size_m, self.size_m)

    def measurements(self, rng: np.random.Generator) -> Array:
        """Four ranges per step, each with the bias; shape (steps, 4)."""
        ranges = np.linalg.norm(self.nodes_m - np.array(self.receiver_m), axis=1)
        noise = rng.standard_normal((self.steps, len(ranges)))
        return np.asarray(ranges + self.bias_m + self.sigma_z_m * noise, np.float64)


@dataclass(frozen=True)
class Smooth:
    """Section 3.3.5, Fig. 34: a receiver that stands at the origin, seen through the state [x v].

    The velocity walks first, the place then moves by the new velocity.
    """

    particles: int = 400
    steps: int = 1400
    sigma_v_mps: float = 0.1
    sigma_z_m: float = 1.0
    x0: tuple[float, float] = (0.0, 0.0)
    """Of every particle."""

    def measurements(self, rng: np.random.Generator) -> Array:
        """One range per step, shape (steps,)."""
        return self.sigma_z_m * rng.standard_normal(self.steps)


@dataclass(frozen=True)
class Crossing:
    """Listing PF5, section 3.3.6, Figs. 35 … 38: a straight way through a room of four nodes; state [x y vx vy b].

    The place moves by the old velocity, then velocity and bias walk. The listing subtracts the bias from the particle's
    ranges; it is to be added, which only turns the sign of b. The text's variances (acceleration 0.01, range 1) and
    velocity (0.1) are the listing's no more.
    """

    width_m: float = 6.0
    depth_m: float = 5.0
    particles: int = 1000
    steps: int = 100
    velocity_mps: tuple[float, float] = (0.02, 0.0)
    bias_m: float = 0.0
    variance_v: float = 1e-4
    """(m/s)² per step, each of vx and vy."""
    variance_b: float = 1e-3
    """m² per step."""
    sigma_z_m: float = 0.2
    """Of the ranges."""
    sigma_weight_m: float = 0.6
    """That the weights assume."""
    x_prior_m: tuple[float, float] = (0.0, 3.0)
    """Uniform."""
    sigma_y0_m: float = 1.5
    """About the middle of the room."""
    mean_v0_mps: tuple[float, float] = (0.011, 0.0)
    sigma_v0_mps: float = 0.2
    settled: tuple[int, int] = (51, 100)
    """Steps over which errors are judged (ours)."""

    @property
    def nodes_m(self) -> Array:
        """Shape (4, 2)."""
        return corners(self.width_m, self.depth_m)

    def truth(self) -> Array:
        """States at steps 1 … `steps`, shape (steps, 5)."""
        k = np.arange(1.0, self.steps + 1)
        vx, vy = self.velocity_mps
        fixed = np.ones_like(k)
        return np.stack([vx * k, 0.5 * self.depth_m + vy * k, vx * fixed, vy * fixed, self.bias_m * fixed], axis=1)

    def measurements(self, rng: np.random.Generator) -> Array:
        """Four ranges per step, each with the bias; shape (steps, 4)."""
        truth = self.truth()
        ranges = np.linalg.norm(truth[:, None, :2] - self.nodes_m, axis=2)
        noise = rng.standard_normal(ranges.shape)
        return np.asarray(ranges + truth[:, 4:] + self.sigma_z_m * noise, np.float64)


STILL, STEP, ROOM, ROOM_BIAS, SMOOTH, CROSSING = Still(), Step(), Room(), RoomBias(), Smooth(), Crossing()
