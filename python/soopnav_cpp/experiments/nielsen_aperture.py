"""The handset as a synthetic array: nielsen's phase II."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import array, estimation, simulation
from soopnav_cpp.clock import TwoState
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    at_least,
    at_most,
    band,
    derive_seed,
    experiment,
    style,
)

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


def loops(seed: int, nodes: int, turn: float, path_sigma_m: float, batch: int) -> Floats:
    """Joint estimates under a TCXO.

    Returns
    -------
    ndarray, shape (batch, 2 nodes + 2)
        Errors and their bound [rad], NEES, and whether there was one answer.
    """
    rng = np.random.default_rng(seed)
    path = arc(turn)
    time_s = STEP_S * np.arange(SNAPSHOTS)
    aperture = array.SyntheticAperture(path_sigma_m_per_sqrt_step=path_sigma_m)
    out = np.full((batch, 2 * nodes + 2), np.nan)
    for trial in range(batch):
        bearing = around(rng, nodes)
        seen = simulation.aperture_snapshots(
            path, bearing, WAVELENGTH_M, snr_db=SNR_DB, frequency_hz=rng.uniform(-3.0, 3.0, nodes), time_s=time_s,
            clock=TCXO, path_sigma_m_per_sqrt_step=path_sigma_m, seed=derive_seed(seed, trial),
        )  # fmt: skip
        found = aperture.bearings(seen.phasors, seen.path_m, WAVELENGTH_M, time_s=time_s)
        bound = array.synthetic_aperture_crlb(
            path, WAVELENGTH_M, bearing, SNR_DB, time_s=time_s, path_sigma_m_per_sqrt_step=path_sigma_m
        )
        error = wrapped(found.bearing_rad - bearing)
        out[trial, nodes:-2] = np.sqrt(np.diag(bound))
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
        right = found.ok and not found.los[lost] and int(found.los.sum()) == 3
        out[trial] = (right, float(np.nanmax(error)) if right else np.nan)
    return out


def one_node(seed: int, batch: int) -> Floats:
    """One node under a TCXO and under a quiet clock, the phase taken as constant: errors [rad], shape (batch, 2).

    No answer counts as half a turn.
    """
    rng = np.random.default_rng(seed)
    path = arc(2.0 * np.pi)
    time_s = STEP_S * np.arange(SNAPSHOTS)
    aperture = array.SyntheticAperture(
        phase="known", coherence_threshold=0.0, max_sigma_rad=np.pi, max_frequency_hz=2.0
    )
    quiet = TwoState(h0=2e-22, h_minus_2=1e-26)  # 1e-11 at 1 s
    out = np.empty((batch, 2))
    for trial in range(batch):
        bearing = rng.uniform(-np.pi, np.pi, 1)
        for column, clock in enumerate((TCXO, quiet)):
            seen = simulation.aperture_snapshots(
                path, bearing, WAVELENGTH_M, snr_db=SNR_DB, time_s=time_s, clock=clock, seed=derive_seed(seed, trial)
            )
            found = aperture.bearings(seen.phasors, path, WAVELENGTH_M, time_s=time_s)
            out[trial, column] = wrapped(found.bearing_rad - bearing)[0] if found.ok else np.pi
            out[trial, column] = np.pi if np.isnan(out[trial, column]) else out[trial, column]
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


def rms_deg(error_rad: npt.ArrayLike) -> float:
    """Root mean square in degrees, of what there is."""
    return float(np.rad2deg(np.sqrt(np.nanmean(np.square(error_rad)))))


def draw_patterns(lab: Lab) -> None:
    """One loop, its beams, and what a straight path makes of the same node."""
    shapes = (("closed loop", arc(2.0 * np.pi)), ("semicircle", arc(np.pi)), ("straight", line()))
    bearing = np.array([0.7])
    grid = np.linspace(-np.pi, np.pi, 721)
    with lab.figure(10.0, 4.6, part="patterns") as figure:
        paths = figure.add_subplot(1, 2, 1)
        beams: Any = figure.add_subplot(1, 2, 2, projection="polar")
        style(paths, "Paths of 5 wavelengths", "x [wavelengths]", "y [wavelengths]")
        beams.set_title("Beam towards a node at 40°, amplitude", fontsize=10)
        for (name, path), colour in zip(shapes, COLOURS, strict=False):
            centred = (path - path.mean(axis=0)) / WAVELENGTH_M
            paths.plot(centred[:, 0], centred[:, 1], marker="o", ms=2.5, lw=0.8, color=colour, label=name)
            seen = simulation.aperture_snapshots(path, bearing, WAVELENGTH_M, snr_db=40.0, seed=1)
            spectrum = array.aperture_spectrum(seen.phasors[:, 0], path, WAVELENGTH_M, grid)
            beams.plot(grid, np.sqrt(spectrum), color=colour, lw=1.2)
        paths.set_aspect("equal")
        paths.legend(frameon=False, fontsize=8, loc="upper right")
        beams.plot([bearing[0], bearing[0]], [0.0, 1.0], color="#22303c", lw=0.9, linestyle=(0, (4, 3)))
        beams.set_rticks([0.5, 1.0])
        beams.set_rlabel_position(200.0)


@experiment(
    "nielsen-x1",
    title="The handset as a synthetic array",
    source="nielsen section 3.3.1 (the phase II it announces)",
    runs=8,
)
def synthetic_array(lab: Lab) -> Iterator[Claim]:
    """Bearings from phases along 5 wavelengths, 50 snapshots of 10 dB, a TCXO's phase and an offset per node."""
    turn = 2.0 * np.pi
    cases = {
        "3 nodes": (3, turn, PATH_SIGMA_M, 80),
        "4 nodes": (4, turn, PATH_SIGMA_M, 50),
        "3, exact path": (3, turn, 0.0, 100),
        "4, semicircle": (4, np.pi, PATH_SIGMA_M, 20),
    }
    errors, bounds, ratios, nees, single = {}, {}, [], [], []
    for name, (nodes, angle, sigma, batch) in cases.items():
        rows = np.concatenate(lab.map(loops, nodes, angle, sigma, batch))
        errors[name], bounds[name] = rows[:, :nodes], rows[:, nodes:-2]
        ratios.append(rms_deg(errors[name]) / rms_deg(bounds[name]))
        nees.append(float(np.nanmean(rows[:, -2]) / nodes))
        single.append(float(np.mean(rows[:, -1] * np.isfinite(rows).all(axis=1))))
    lines = np.concatenate(lab.map(straight, 40))
    coherence = np.concatenate(lab.map(coherences, 300))
    mixtures = np.concatenate(lab.map(mixed, 10))
    alone = np.concatenate(lab.map(one_node, 50))
    angles = np.concatenate(lab.map(blind, 40))

    draw_patterns(lab)
    with lab.figure(11.0, 7.6) as figure:
        axes = figure.subplots(2, 2)
        style(axes[0, 0], "Bearing error and its bound, receiver's phase free", "", "rms [deg]")
        at = np.arange(len(cases))
        axes[0, 0].bar(at - 0.18, [rms_deg(e) for e in errors.values()], 0.34, color=COLOURS[0], label="estimated")
        axes[0, 0].bar(at + 0.18, [rms_deg(b) for b in bounds.values()], 0.34, color="#9fb0bd", label="bound")
        axes[0, 0].set_xticks(at, list(cases), fontsize=8)
        axes[0, 0].set_ylim(0.0, 2.3)
        axes[0, 0].legend(frameon=False, fontsize=8, loc="upper left")
        style(axes[0, 1], "Errors over their bound, closed loop", "error / bound", "density")
        pooled = np.concatenate([(errors[name] / bounds[name]).ravel() for name in list(cases)[:3]])
        pooled = pooled[np.isfinite(pooled)]
        axes[0, 1].hist(pooled, bins=np.linspace(-4.5, 4.5, 46), density=True, color="#9fb0bd")
        x = np.linspace(-4.5, 4.5, 200)
        axes[0, 1].plot(x, np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), color="#22303c", lw=1.2, label="standard normal")
        axes[0, 1].legend(frameon=False, fontsize=8)
        style(axes[1, 0], "Coherence along the loop, 10 dB", "coherence", "density")
        for column, ((name, _), colour) in enumerate(zip(KINDS, COLOURS, strict=True)):
            axes[1, 0].hist(
                coherence[:, column], bins=np.linspace(0.0, 1.0, 61), density=True, histtype="step", lw=1.3,
                color=colour, label=name,
            )  # fmt: skip
        axes[1, 0].axvline(THRESHOLD, color="#22303c", lw=0.9, linestyle=(0, (4, 3)))
        axes[1, 0].set_xlim(0.0, 1.0)
        axes[1, 0].legend(frameon=False, fontsize=8, loc="upper left")
        style(axes[1, 1], "One node, its phase taken as constant", "error [deg]", "share of runs below")
        for column, (name, colour) in enumerate((("TCXO, 6e-10", COLOURS[1]), ("1e-11", COLOURS[2]))):
            size = np.sort(np.abs(np.rad2deg(alone[:, column])))
            axes[1, 1].plot(size, (np.arange(len(size)) + 1) / len(size), color=colour, lw=1.4, label=name)
        axes[1, 1].plot([0.0, 180.0], [0.0, 1.0], color="#22303c", lw=0.9, linestyle=(0, (4, 3)), label="uniform")
        axes[1, 1].set_xlim(0.0, 180.0)
        axes[1, 1].set_xticks(np.arange(0.0, 181.0, 30.0))
        axes[1, 1].legend(frameon=False, fontsize=8, loc="center right")
    lab.table(
        ("case", "rms_deg", "bound_deg", "ratio", "nees_per_bearing"),
        [
            (name, rms_deg(errors[name]), rms_deg(bounds[name]), ratio, value)
            for name, ratio, value in zip(cases, ratios, nees, strict=True)
        ],
    )
    lab.save(coherence=coherence, one_node_rad=alone, blind_rad=angles, mixed=mixtures)
    for i, name in enumerate(cases):
        lab.save(part=f"errors_{i}", error_rad=errors[name], bound_rad=bounds[name])

    yield Claim(
        "closed loop, free TCXO phase, an offset per node: rms over the bound (3 and 4 nodes, 0.5 mm per root step; 3 "
        "with an exact path)",
        ratios[:3], at_most(1.1),
    )  # fmt: skip
    yield Claim("the bound itself, 3 nodes and an exact path", rms_deg(bounds["3, exact path"]), band(0.8, 0.95, "deg"))
    yield Claim(
        "and with the path's error of 0.5 mm per root step", rms_deg(bounds["3 nodes"]), band(0.98, 1.18, "deg")
    )
    yield Claim("semicircle, 4 nodes: rms over the bound", ratios[3], band(0.8, 1.25))
    yield Claim("reported covariance: NEES per bearing, closed loops", nees[:3], band(0.82, 1.22))
    yield Claim("loops with one answer, all nodes in it", single, at_least(0.97))
    yield Claim("straight path, quiet clock: runs with both mirror answers", float(lines[:, 0].mean()), at_least(1.0))
    yield Claim(
        "straight path: the nearer of the two answers, worst over its sigma", float(lines[:, 1].max()), at_most(6.0)
    )
    yield Claim("straight path: share of first answers on the wrong side", float(lines[:, 2].mean()), band(0.35, 0.65))
    yield Claim("straight path, free phase: runs refused", float(lines[:, 3].mean()), at_least(1.0))
    low = np.mean(coherence < THRESHOLD, axis=0)
    yield Claim("coherence below 0.7: Rayleigh links", float(low[3]), at_least(0.95))
    yield Claim("coherence below 0.7: line of sight, K = 10 dB", low[:2], at_most(0.02))
    yield Claim(
        "one Rayleigh link among four under a TCXO is the one left out", float(np.mean(mixtures[:, 0])), at_least(0.85)
    )
    far = np.mean(np.abs(alone) > np.deg2rad(10.0), axis=0)
    yield Claim("one node and a TCXO: errors beyond 10 degrees", float(far[0]), at_least(0.75))
    yield Claim("one node and an oscillator of 1e-11", rms_deg(alone[:, 1]), at_most(1.2, "deg"))
    solved = np.isfinite(angles[:, 0]).all(axis=1)
    yield Claim(f"blind, {BLIND_NODES} nodes at 20 dB: angles found", float(solved.mean()), at_least(0.95))
    yield Claim(
        "blind: rms of the angles between nodes, up to a mirror, over the reported sigma",
        float(np.sqrt(np.mean((angles[solved, 0] / angles[solved, 1]) ** 2))), band(0.85, 1.2),
    )  # fmt: skip
    yield Claim("blind: rms of the angles", rms_deg(angles[solved, 0]), at_most(1.0, "deg"))
