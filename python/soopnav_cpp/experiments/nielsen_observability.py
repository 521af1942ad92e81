"""Observability of a walk among unsynchronised nodes: nielsen 3.4.2, Figs. 40 … 43.

A walk along x, N positions, ranges of variance 1 m²; the walk's shape is known but for one length. Two lengths are
shown. As the matrix is printed (its last column has the factor i), it is the error of every step; the paper's own
numbers are those of the other, one displacement of the whole walk. The matrices come from
`soopnav_cpp.estimation.track_jacobian`, which `soopnav observe` uses as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    above,
    at_least,
    at_most,
    band,
    condition,
    experiment,
    matching,
    near,
    style,
)

__all__ = ["corner_walk_sigma", "straight_line_sigma"]

Array = npt.NDArray[np.float64]
Biases = Literal["known", "common", "separate"]
Length = Literal["offset", "step"]

TWO_NODES_M = np.array([[0.0, 1.0], [4.0, 1.0]])
CORNERS_M = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
POSITIONS = 20
STEP_M = 0.1
_LINES = (("#1b6ca8", "-"), ("#2e933c", "--"), ("#d1495b", "-"))


def straight_line_sigma(x0_m: npt.ArrayLike, positions: int) -> Array:
    """Listing g1.m: σ of (b1, b2, Δx) at each start (x0, 0), shape (starts, 3) [m].

    Two nodes at (0, 1) and (4, 1). The listing takes the direction of the start for all positions, so here the walk's
    nominal step is zero and its error is not.
    """
    starts = np.atleast_1d(np.asarray(x0_m, dtype=np.float64))
    tracks = np.zeros((len(starts), positions, 2))
    tracks[..., 0] = starts[:, None]
    H, names = estimation.track_jacobian("range", TWO_NODES_M, tracks, step=["x"], bias="separate")
    sigma, _ = estimation.crlb_map(H, 1.0)
    order = [names.index(name) for name in ("bias 1", "bias 2", "step x")]
    return sigma[:, order]


def corner_walk_sigma(
    x0_m: npt.ArrayLike, y0_m: npt.ArrayLike, length: Length, bias: Biases, *, step_m: float = STEP_M
) -> Array:
    """σ of the unknown length of a walk of twenty steps among four corners, for each start; as the starts' shape [m].

    NaN for a start from which the walk leads over a node.
    """
    x0, y0 = np.broadcast_arrays(np.asarray(x0_m, dtype=np.float64), np.asarray(y0_m, dtype=np.float64))
    tracks = np.empty((*x0.shape, POSITIONS, 2))
    tracks[..., 0] = x0[..., None] + step_m * np.arange(1, POSITIONS + 1)
    tracks[..., 1] = y0[..., None]
    offset: list[Literal["x", "y", "z"]] = ["x"] if length == "offset" else []
    step: list[Literal["x", "y", "z"]] = ["x"] if length == "step" else []
    H, _ = estimation.track_jacobian("range", CORNERS_M, tracks, offset=offset, step=step, bias=bias)
    sigma, _ = estimation.crlb_map(H, 1.0)
    return np.asarray(sigma[..., 0])


def _line_figure(lab: Lab, positions: int) -> tuple[Array, Array]:
    x0 = np.linspace(0.0, 4.0, 200)
    sigma = straight_line_sigma(x0, positions)
    with lab.figure() as figure:
        axes = figure.add_subplot()
        style(axes, f"σ for ranges of σ = 1 m, N = {positions}", "x$_o$ [m]", "normalized σ")
        for values, name, (colour, dashes) in zip(sigma.T, ("b$_1$", "b$_2$", "Δx"), _LINES, strict=True):
            axes.plot(x0, values, color=colour, linestyle=dashes, label=name)
        axes.set_xlim(0.0, 4.0)
        axes.set_ylim(0.0, None)
        axes.legend(frameon=False)
    lab.save(x0_m=x0, sigma_b1=sigma[:, 0], sigma_b2=sigma[:, 1], sigma_dx=sigma[:, 2])
    return x0, sigma


def _ends(values: Array) -> list[float]:
    return [float(values.min()), float(values.max())]


@experiment("nielsen-40", title="Two nodes, separate biases, N = 30", source="nielsen section 3.4.2, Fig. 40, g1.m")
def figure_40(lab: Lab) -> Iterator[Claim]:
    """Golden values of the listing to six digits."""
    _, sigma = _line_figure(lab, 30)
    yield Claim(
        "least and greatest σ of the biases over x0", _ends(sigma[:, :2]), matching((0.182574, 0.374473), decimals=6)
    )
    yield Claim("least and greatest σ of Δx over x0", _ends(sigma[:, 2]), matching((0.016676, 0.021745), decimals=6))
    yield Claim("σ of b1, b2 and Δx at x0 = 0", sigma[0], matching((0.182574, 0.374473, 0.021743), decimals=6))
    # Straight line through i = 1 ... N with slopes u1, u2: at x0 = 0 node 1 tells b1 alone, so σ = 1/√N.
    yield Claim("σ of b1 at x0 = 0 times √N", sigma[0, 0] * math.sqrt(30.0), near(1.0, within=1e-9))
    yield Claim("a bias to about 0.3 m: mean σ of b1 and b2 over x0", sigma[:, :2].mean(), band(0.2, 0.4, "m"))
    yield Claim("thirty steps of σ 0.02 m: mean of 30 σ of Δx", 30.0 * sigma[:, 2].mean(), band(0.5, 0.66, "m"))


@experiment("nielsen-41", title="Two nodes, separate biases, N = 2", source="nielsen section 3.4.2, Fig. 41, g1.m")
def figure_41(lab: Lab) -> Iterator[Claim]:
    """The least number of positions that determines all three unknowns, against thirty."""
    x0, sigma = _line_figure(lab, 2)
    yield Claim(
        "least and greatest σ of the biases over x0", _ends(sigma[:, :2]), matching((0.707107, 2.236068), decimals=6)
    )
    yield Claim("least and greatest σ of Δx over x0", _ends(sigma[:, 2]), matching((1.118040, 1.457859), decimals=6))
    yield Claim(
        "more positions, smaller σ: least ratio of N = 2 to N = 30, any unknown and x0",
        (sigma / straight_line_sigma(x0, 30)).min(),
        above(3.0),
    )
    alone = estimation.crlb(*_one_position())
    yield Claim("rank of one position, for three unknowns", alone.rank, condition("2", lambda m: m == (2.0,)))


def _one_position() -> tuple[Array, float]:
    H, _ = estimation.track_jacobian("range", TWO_NODES_M, [[1.0, 0.0]], step=["x"], bias="separate")
    return H, 1.0


def _room() -> tuple[Array, Array]:
    """Starts from which the walk stays in the room and off the nodes: x0 from 0 to 1.95 m, y0 from 0 to 4 m."""
    x0, y0 = np.meshgrid(np.linspace(0.0, 1.95, 40), np.linspace(0.0, 4.0, 41))
    return x0, y0


def _decibel(numerator: Array, denominator: Array) -> Array:
    return np.asarray(20.0 * np.log10(numerator / denominator))


def _surfaces(lab: Lab, bias: Biases) -> dict[str, Array]:
    x0, y0 = _room()
    sigma: dict[str, Array] = {name: corner_walk_sigma(x0, y0, name, bias) for name in _LENGTHS}
    with lab.figure(10.4, 4.8) as figure:
        for place, name in enumerate(_LENGTHS):
            axes = figure.add_subplot(1, 2, place + 1, projection="3d")
            axes.plot_surface(
                x0, y0, sigma[name], cmap="viridis", edgecolor="#22303c", linewidth=0.25, rstride=2, cstride=2
            )
            axes.set_title(_LENGTHS[name], fontsize=10)
            axes.set_xlabel("x$_o$ [m]", fontsize=9)
            axes.set_ylabel("y$_o$ [m]", fontsize=9)
            axes.set_zlabel("σ [m]", fontsize=9, labelpad=8)
            axes.tick_params(labelsize=8)
            axes.set_xticks([0.0, 1.0, 2.0])
            axes.set_yticks([0.0, 1.0, 2.0, 3.0, 4.0])
            axes.set_box_aspect((1.0, 1.4, 0.8), zoom=0.82)
        figure.suptitle(f"σ of the unknown length, N = 20, Δx = 0.1 m, biases {bias}", fontsize=11)
    lab.save(x0_m=x0[0], y0_m=y0[:, 0], sigma_step_m=sigma["step"], sigma_offset_m=sigma["offset"])
    return sigma


_LENGTHS: dict[Length, str] = {
    "step": "Δx of every step (as printed)",
    "offset": "one displacement of the walk",
}


@experiment("nielsen-42", title="Four corners, separate biases", source="nielsen section 3.4.2, Fig. 42")
def figure_42(lab: Lab) -> Iterator[Claim]:
    """What separate biases cost, for both readings of Δx."""
    x0, y0 = _room()
    sigma = _surfaces(lab, "separate")
    known: dict[str, Array] = {name: corner_walk_sigma(x0, y0, name, "known") for name in _LENGTHS}
    cost: dict[str, Array] = {name: _decibel(sigma[name], known[name]) for name in _LENGTHS}
    # Directions that do not change along the walk: the step's column is i u_n, and the cost is that of a straight
    # line's slope when its height is unknown as well, whatever the directions are.
    still: dict[str, Array] = {b: corner_walk_sigma(1.3, 2.1, "step", b, step_m=0.0) for b in ("known", "separate")}
    limit = 10.0 * math.log10(2.0 * (2.0 * POSITIONS + 1.0) / (POSITIONS - 1.0))
    yield Claim(
        "as printed, a constant direction: separate biases cost 10 lg(2(2N+1)/(N−1)) = 6.35 dB, not about 20 dB",
        float(_decibel(still["separate"], still["known"])),
        near(round(limit, 6), within=1e-6, unit="dB"),
    )
    yield Claim("as printed: least and greatest cost in the room", _ends(cost["step"]), band(5.5, 6.6, "dB"))
    yield Claim(
        "as printed, σ of Δx stays below Δx = 0.1 m (the text says that it exceeds it): greatest σ",
        sigma["step"].max(),
        at_most(0.03, "m"),
    )
    yield Claim(
        "one displacement of the walk: least and greatest cost in the room (the text: about 20 dB)",
        _ends(cost["offset"]),
        band(12.0, 21.0, "dB"),
    )
    yield Claim("one displacement: median cost", np.median(cost["offset"]), near(16.0, within=2.0, unit="dB"))
    yield Claim("one displacement: σ exceeds 0.1 m: least σ", sigma["offset"].min(), above(0.1, "m"))
    yield Claim(
        "as printed, not very sensitive to the place: greatest over least σ",
        sigma["step"].max() / sigma["step"].min(),
        at_most(1.5),
    )


@experiment("nielsen-43", title="Four corners, known or common biases", source="nielsen section 3.4.2, Fig. 43")
def figure_43(lab: Lab) -> Iterator[Claim]:
    """Known biases, and what one common to all nodes adds."""
    x0, y0 = _room()
    known = _surfaces(lab, "known")
    for name, label in _LENGTHS.items():
        common = corner_walk_sigma(x0, y0, name, "common")
        more = 100.0 * (common / known[name] - 1.0)
        yield Claim(
            f"a common bias adds little to σ of {label} while the walk stays in the room: greatest",
            more.max(),
            at_most(9.0, "%"),
        )
        yield Claim(f"the same, median over the room ({label})", np.median(more), band(0.0, 1.0, "%"))
    beyond = corner_walk_sigma(np.linspace(2.5, 4.0, 31)[:, None], np.linspace(0.05, 3.95, 40), "step", "common")
    free = corner_walk_sigma(np.linspace(2.5, 4.0, 31)[:, None], np.linspace(0.05, 3.95, 40), "step", "known")
    yield Claim(
        "not once it leaves the room (x0 from 2.5 to 4 m): greatest increase",
        100.0 * (beyond / free - 1.0).max(),
        at_least(50.0, "%"),
    )
    yield Claim(
        "σ of one displacement with known biases, least and greatest",
        _ends(known["offset"]),
        band(0.14, 0.17, "m"),
    )
