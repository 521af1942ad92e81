"""Draws the figures of docs/two_receivers.md into docs/images; docs/make_figures.py calls it.

.venv/bin/python docs/two_receivers_figures.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

IMAGES = Path(__file__).resolve().parent / "images"
ANCHOR, TARGET, INK, PALE = "#1f6fb2", "#c8502d", "#22313f", "#8a97a3"


def arrow(axes: Any, start: tuple[float, float], end: tuple[float, float], colour: str, style: str = "->") -> None:
    axes.annotate(
        "",
        xy=end,
        xytext=start,
        arrowprops={"arrowstyle": style, "color": colour, "lw": 1.5, "shrinkA": 0, "shrinkB": 0},
    )


def geometry(axes: Any) -> None:
    """Anchor, target, satellite: who is farther, and what the satellite's motion does."""
    satellite, anchor, target = np.array([3.4, 6.0]), np.array([1.9, 0.8]), np.array([8.6, 0.8])
    x = np.linspace(-0.5, 10.5, 100)
    axes.fill_between(x, -0.3, 0.8 - 0.006 * (x - 5.0) ** 2, color="#e8edf1", lw=0)
    axes.plot(x, 0.8 - 0.006 * (x - 5.0) ** 2, color=PALE, lw=1.2)
    for place, colour, name in ((anchor, ANCHOR, "anchor  b"), (target, TARGET, "target  a")):
        axes.plot(*np.stack([satellite, place]).T, color=colour, lw=1.5, ls=(0, (5, 3)))
        axes.plot(*place, "^", ms=15, color=colour, mec="white")
        axes.text(place[0], 0.05, name, ha="center", va="center", fontsize=12, color=colour, fontweight="bold")
    axes.text(2.35, 3.2, r"$D_b$", fontsize=13, color=ANCHOR, ha="right")
    axes.text(
        6.1, 4.0, r"$D_a > D_b$", fontsize=13, color=TARGET, ha="left", bbox={"fc": "white", "ec": "none", "pad": 1.0}
    )
    reach = np.linalg.norm(anchor - satellite)
    angle = np.linspace(np.radians(-112), np.radians(-28), 60)
    for share, width in ((1.0, 1.8), (0.72, 0.9), (0.44, 0.9)):
        axes.plot(
            *(satellite[:, None] + share * reach * np.array([np.cos(angle), np.sin(angle)])), color=PALE, lw=width
        )
    axes.text(
        8.15, 2.75, "the wavefront is\nat the anchor; the\ntarget hears it later", fontsize=9.5, color=INK, va="top"
    )
    axes.plot(*satellite, "s", ms=13, color=INK)
    for side in (-1, 1):
        axes.add_patch(plt.Rectangle((satellite[0] + side * 0.62 - 0.32, 5.86), 0.64, 0.28, color=INK))
    arrow(axes, (4.5, 6.0), (6.3, 6.0), INK)
    axes.text(6.4, 6.0, "moves towards the target:\nthe target hears it higher", fontsize=9.5, color=INK, va="center")
    axes.set_title("Farther is later, coming nearer is higher", loc="left", fontsize=12, fontweight="bold", color=INK)
    axes.set_xlim(-0.3, 10.6)
    axes.set_ylim(-0.3, 6.9)
    axes.set_aspect("equal")
    axes.axis("off")


def frequencies(axes: Any) -> None:
    """What each receiver counts of one carrier, and what a fast clock does to it."""
    for height, colour, name, doppler, clock in (
        (2.0, ANCHOR, "anchor", -1.2, 0.0),
        (0.9, TARGET, "target", 1.6, -1.1),
    ):
        axes.axhline(height, color=PALE, lw=1.0)
        axes.plot([0.0, 0.0], [height - 0.08, height + 0.12], color=PALE, lw=1.2)
        axes.plot([doppler] * 2, [height, height + 0.42], color=colour, lw=1.4, ls=":" if clock else "-")
        axes.plot([doppler + clock] * 2, [height, height + 0.42], color=colour, lw=3.0)
        axes.text(-3.1, height + 0.12, name, color=colour, fontsize=12, fontweight="bold")
    arrow(axes, (0.0, 1.92), (-1.2, 1.92), ANCHOR)
    axes.text(-0.6, 1.68, "Doppler", color=ANCHOR, fontsize=9.5, ha="center")
    arrow(axes, (0.0, 0.82), (1.6, 0.82), TARGET)
    axes.text(0.8, 0.58, "Doppler", color=TARGET, fontsize=9.5, ha="center")
    arrow(axes, (1.6, 1.18), (0.5, 1.18), TARGET)
    axes.text(1.72, 1.12, "a fast clock\ncounts lower: $-f\\,d$", color=TARGET, fontsize=9.5, va="center")
    axes.plot([-1.2, -1.2], [2.42, 2.72], color=INK, lw=0.8, ls=":")
    axes.plot([0.5, 0.5], [1.32, 2.72], color=INK, lw=0.8, ls=":")
    arrow(axes, (-1.2, 2.68), (0.5, 2.68), INK)
    axes.text(-0.35, 2.76, "FDOA > 0: the target's is higher", color=INK, fontsize=10.5, ha="center")
    axes.text(0.0, 0.28, "frequency as sent", color=PALE, fontsize=9.5, ha="center")
    axes.plot([0.0, 0.0], [0.42, 2.1], color=PALE, lw=0.7, ls=":")
    axes.set_title("One carrier, two clocks that count it", loc="left", fontsize=12, fontweight="bold", color=INK)
    axes.set_xlim(-3.2, 3.6)
    axes.set_ylim(0.1, 3.1)
    axes.axis("off")


def timeline(axes: Any) -> None:
    """One wavefront on both clocks: TDOA is the difference of readings."""
    rows = {"system time": 2.0, "anchor's clock": 1.0, "target's clock": 0.0}
    colours = {"system time": INK, "anchor's clock": ANCHOR, "target's clock": TARGET}
    bias = {"system time": (0.0, 0.0), "anchor's clock": (0.3, 0.0), "target's clock": (1.4, 0.06)}
    at = {"anchor's clock": 4.0, "target's clock": 5.1}
    reading = {}
    for name, height in rows.items():
        b, d = bias[name]
        axes.plot([0.0, 10.0], [height] * 2, color=colours[name], lw=1.6)
        for tick in range(13):
            t = (tick - b) / (1.0 + d)
            if 0.0 <= t <= 10.0:
                axes.plot([t] * 2, [height, height + 0.12], color=colours[name], lw=1.4)
                axes.text(t, height + 0.16, str(tick), color=colours[name], fontsize=9, ha="center")
        axes.text(
            -0.2, height + 0.05, name, color=colours[name], fontsize=11, ha="right", va="center", fontweight="bold"
        )
        if name in at:
            t = at[name]
            reading[name] = t + b + d * t
            axes.plot([t] * 2, [height, 2.0], color=colours[name], lw=1.2, ls=(0, (4, 3)))
            axes.plot(t, height, "o", color=colours[name], ms=8, zorder=5)
    read_b, read_a = reading["anchor's clock"], reading["target's clock"]
    axes.annotate("wavefront at the anchor", (4.0, 2.0), (2.9, 2.62), fontsize=9.5, color=ANCHOR, ha="center",
                  arrowprops={"arrowstyle": "-", "color": ANCHOR, "lw": 0.8})  # fmt: skip
    axes.annotate("at the target", (5.1, 2.0), (5.9, 2.62), fontsize=9.5, color=TARGET, ha="center",
                  arrowprops={"arrowstyle": "-", "color": TARGET, "lw": 0.8})  # fmt: skip
    arrow(axes, (4.0, 1.76), (5.1, 1.76), INK, "<->")
    axes.text(5.25, 1.7, r"$D_a - D_b = 1.1$", fontsize=10, color=INK, va="center",
              bbox={"fc": "white", "ec": "none", "pad": 1.0})  # fmt: skip
    axes.text(3.9, 0.74, rf"reads $r_b = {read_b:.1f}$", fontsize=10,
              color=ANCHOR, va="center", ha="right")  # fmt: skip
    axes.text(5.2, -0.26, rf"reads $r_a = {read_a:.1f}$", fontsize=10, color=TARGET,
              va="center")  # fmt: skip
    axes.text(
        10.25,
        1.0,
        "TDOA $= r_a - r_b$\n$= (D_a - D_b) + (b_a - b_b)$\n$= 1.1 + (1.7 - 0.3) = 2.5 > 0$\n\n"
        "$b$: reading less system time;\n$d > 0$: ticks come too soon (fast)\n"
        r"$\theta = c\,(b_a - b_b)$,   $\alpha = c\,(d_a - d_b)$",
        fontsize=11,
        color=INK,
        va="center",
        linespacing=1.5,
    )
    axes.set_title("One wavefront, two clocks that stamp it", loc="left", fontsize=12, fontweight="bold", color=INK)
    axes.set_xlim(-2.0, 14.6)
    axes.set_ylim(-0.45, 2.9)
    axes.axis("off")


def signs() -> None:
    """The sign conventions in one picture."""
    figure = plt.figure(figsize=(12.0, 9.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[1.25, 1.0], width_ratios=[1.25, 1.0])
    geometry(figure.add_subplot(grid[0, 0]))
    frequencies(figure.add_subplot(grid[0, 1]))
    timeline(figure.add_subplot(grid[1, :]))
    figure.savefig(IMAGES / "two_receivers_signs.png", dpi=95)
    plt.close(figure)


def runs() -> None:
    """The first runs of the gallery's two scenarios: clock and place of one that stands, the map of one that drives."""
    from soopnav_cpp import plotting, scenarios
    from soopnav_cpp.scenarios import cooperative_figures as drawing
    from soopnav_cpp.scenarios.execution import seed_of_run

    for name in ("static", "drive"):
        system, scenario = scenarios.load(IMAGES.parents[1] / "examples" / "scenarios" / f"mei_{name}.toml")
        run: Any = system.run(scenario, seed_of_run(scenario, 1))
        if name == "static":
            drawing.clock_and_position(run).savefig(IMAGES / "two_receivers_static.png", dpi=90)
            drawing.measurement_errors(run).savefig(IMAGES / "two_receivers_measurements.png", dpi=90)
        else:
            plotting.trajectory(run).savefig(IMAGES / "two_receivers_drive.png", dpi=80)


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    signs()
    runs()


if __name__ == "__main__":
    main()
