"""Two emitters, and a manifold read from a file: carter's future work (carter-x3)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from soopnav_cpp.array import ArrayGeometry, Bearings, DirectionFinder, Manifold, covariance, music
from soopnav_cpp.experiments.carter_arrays import (
    ELEVATIONS_RAD,
    SNAPSHOTS,
    Array,
    Complexes,
    angle_between,
    normals,
    paper_array,
    unit_vectors,
    wrapped,
)
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, band, below, experiment, style

RESOLVED_RAD = np.deg2rad(5.0)
LEAST_APART_DEG = 60.0
PAIR_SNR_DB = 5.0
GAIN_SIGMA_DB, PHASE_SIGMA_RAD = 1.0, np.deg2rad(15.0)
FILE_SNR_DB = 5.0
CASES = ("circle of 6, both angles", "paper's square, azimuth at known elevation", "paper's square, both angles")
COLOURS = ("#3a7d44", "#2b5f9e", "#b5442e")


@lru_cache(maxsize=2)
def pair_finder(square: bool) -> DirectionFinder:
    """Two sources; once per process."""
    return DirectionFinder(paper_array() if square else ArrayGeometry.uca(6, 0.4), n_sources=2)


def worst_of_pair(found: Array, truth: Array) -> float:
    """The larger azimuth error of two found against two true, in the better of the two orders; pi without two."""
    if len(found) < 2:
        return float(np.pi)
    errors = np.abs(wrapped(found[:, None] - truth[None, :]))
    return float(min(max(errors[0, 0], errors[1, 1]), max(errors[0, 1], errors[1, 0])))


def azimuth_peaks(R: Complexes, manifold: Manifold, elevation: float) -> Array:
    """The two highest peaks of MUSIC over azimuth at an elevation, between grid points by a parabola [rad]."""
    step = np.deg2rad(0.5)
    grid = np.arange(-np.pi, np.pi - 0.5 * step, step)
    values = music(R, manifold.steering(grid, elevation), 2)
    assert not isinstance(values, Bearings)
    cost = -1.0 / values
    before, after = np.roll(cost, 1), np.roll(cost, -1)
    peaks = np.flatnonzero((cost > before) & (cost >= after))
    peaks = peaks[np.argsort(-cost[peaks])[:2]]
    bend = before[peaks] - 2.0 * cost[peaks] + after[peaks]
    return np.asarray(grid[peaks] + 0.5 * step * (before[peaks] - after[peaks]) / bend)


def pairs(seed: int, count: int) -> Array:
    """Two emitters of equal power at one elevation: apart [deg], and the worse azimuth error [rad] in each case."""
    rng = np.random.default_rng(seed)
    out = np.empty((count, 1 + len(CASES)))
    for trial in range(count):
        elevation, apart = np.deg2rad(rng.uniform(20.0, 60.0)), np.deg2rad(rng.uniform(LEAST_APART_DEG, 180.0))
        first = rng.uniform(-np.pi, np.pi)
        truth = np.array([first, float(wrapped(first + apart))])
        out[trial, 0] = np.rad2deg(apart)
        for square in (False, True):
            search = pair_finder(square)
            a = search.manifold.steering(truth, elevation)
            waves = 10.0 ** (PAIR_SNR_DB / 20.0) * normals(rng, 2, SNAPSHOTS)
            iq = (a @ waves + normals(rng, len(a), SNAPSHOTS)).astype(np.complex64)
            error = worst_of_pair(search.estimate(iq).azimuth_rad, truth)
            if square:
                known = azimuth_peaks(covariance(iq), search.manifold, float(elevation))
                out[trial, 2:] = worst_of_pair(known, truth), error
            else:
                out[trial, 1] = error
    return out


@experiment("carter-x3.2", title="Two emitters", source="beyond carter: its future work (chapter 6)", runs=20)
def two_emitters(lab: Lab) -> Iterator[Claim]:
    """Equal powers at 5 dB, elevation 20 to 60 degrees, azimuths 60 to 180 degrees apart, 2500 samples."""
    results = np.concatenate(lab.map(pairs, 50))
    apart, errors = results[:, 0], results[:, 1:]
    edges = np.linspace(LEAST_APART_DEG, 180.0, 7)
    bins = np.clip(np.digitize(apart, edges) - 1, 0, len(edges) - 2)
    with lab.figure(11.0, 4.4) as figure:
        axes = figure.subplots(1, 2)
        style(axes[0], "Worse azimuth error of the two", "error [deg]", "share of pairs below")
        style(axes[1], "Resolved: both within 5 degrees", "azimuths apart [deg]", "share of pairs")
        for case, (name, colour) in enumerate(zip(CASES, COLOURS, strict=True)):
            axes[0].semilogx(
                np.sort(np.rad2deg(errors[:, case])),
                np.arange(1, len(errors) + 1) / len(errors),
                color=colour,
                label=name,
            )
            share = [np.mean(errors[bins == i, case] < RESOLVED_RAD) for i in range(len(edges) - 1)]
            axes[1].plot(0.5 * (edges[1:] + edges[:-1]), share, color=colour, marker="o", ms=8.0 - 2.0 * case)
        axes[0].axvline(5.0, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        axes[1].axhline(0.95, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        axes[1].set_ylim(0.0, 1.03)
        axes[1].legend(axes[0].get_lines()[: len(CASES)], CASES, frameon=False, fontsize=9, loc="lower right")
    lab.save(apart_deg=apart, errors_rad=errors)
    share = np.mean(errors < RESOLVED_RAD, axis=0)
    for case in (0, 1):
        yield Claim(f"{CASES[case]}: pairs with both azimuths within 5 degrees", share[case], at_least(0.95))
    yield Claim(
        "the square cannot tell pairs that share a coordinate along one of its sides: fewer, but most, in both angles",
        share[2], band(0.75, 0.95),
    )  # fmt: skip


def drawn_manifold(seed: int) -> Manifold:
    """The paper's array with errors of gain and phase."""
    return Manifold(paper_array()).with_random_errors(GAIN_SIGMA_DB, PHASE_SIGMA_RAD, seed)


def write(manifold: Manifold, path: Path) -> Path:
    """Its responses every 5 by 10 degrees."""
    return manifold.save(path, elevation_rad=np.deg2rad(np.arange(0.0, 91.0, 10.0)))


def file_trials(seed: int, count: int) -> Array:
    """Angle errors [rad] and signed errors of azimuth, elevation: (count, ideal / corrected / uncorrected, 3).

    A manifold of its own for each seed, through a file.
    """
    rng = np.random.default_rng([seed, 1])  # the manifold has the seed itself
    geometry = paper_array()
    ideal = Manifold(geometry)
    with tempfile.TemporaryDirectory() as folder:
        read = Manifold.load(write(drawn_manifold(seed), Path(folder) / "manifold.csv"), geometry)
    plain, corrected = DirectionFinder(ideal), DirectionFinder(read)
    out = np.empty((count, 3, 3))
    for trial in range(count):
        at = np.array([rng.uniform(-np.pi, np.pi), rng.uniform(*ELEVATIONS_RAD)])
        wave = 10.0 ** (FILE_SNR_DB / 20.0) * normals(rng, 1, SNAPSHOTS)
        noise = normals(rng, len(geometry), SNAPSHOTS)
        clean = (ideal.steering(*at) @ wave + noise).astype(np.complex64)
        bent = (read.steering(*at) @ wave + noise).astype(np.complex64)
        for case, found in enumerate((plain.estimate(clean), corrected.estimate(bent), plain.estimate(bent))):
            there = np.array([found.azimuth_rad[0], found.elevation_rad[0]])
            out[trial, case, 0] = angle_between(unit_vectors(*there), unit_vectors(*at))
            out[trial, case, 1:] = wrapped(there[0] - at[0]) * np.cos(at[1]), there[1] - at[1]
    return out


@experiment("carter-x3.4", title="A manifold from a file", source="beyond carter: its future work (chapter 6)", runs=20)
def manifold_from_file(lab: Lab) -> Iterator[Claim]:
    """20 draws of gain and phase errors (1 dB, 15 degrees rms), each through a CSV file, injected and corrected."""
    lab.data.append(write(drawn_manifold(lab.seeds[0]), lab.out / f"{lab.experiment.id}_manifold.csv"))
    results = np.concatenate(lab.map(file_trials, 100))
    rms = np.sqrt(np.mean(results[:, :, 0] ** 2, axis=0))
    names = ("ideal elements", "errors in, corrected by the file", "errors in, not corrected")
    with lab.figure(7.2, 4.4) as figure:
        axes = figure.add_subplot()
        style(axes, "Angle error with a manifold read from a file", "angle error [deg]", "share of trials below")
        for case, name in enumerate(names):
            errors = np.sort(np.rad2deg(results[:, case, 0]))
            axes.semilogx(
                errors, np.arange(1, len(errors) + 1) / len(errors), color=COLOURS[case],
                label=f"{name}: rms {np.rad2deg(rms[case]):.2f} deg",
            )  # fmt: skip
        axes.legend(frameon=False, fontsize=9, loc="upper left")
    lab.save(errors_rad=results)
    yield Claim(
        "errors injected and corrected from one file: rms over that of ideal elements", rms[1] / rms[0], band(0.9, 1.1)
    )
    yield Claim("not corrected: rms over that of ideal elements", rms[2] / rms[0], above(2.0))
    share = float(np.mean(results[:, 2, 0] > 4.0 * rms[0]))
    yield Claim("not corrected is a bias: trials beyond four times the ideal rms", share, at_least(0.1))
    yield Claim(
        "corrected: mean error over its rms", np.abs(results[:, 1, 1:].mean(axis=0)).max() / rms[1], at_most(0.12)
    )
    yield Claim("corrected: rms", np.rad2deg(rms[1]), below(2.0, "deg"))
