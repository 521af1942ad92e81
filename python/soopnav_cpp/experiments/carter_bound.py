"""MUSIC at the Cramer-Rao bound, and without a trace of the grid: carter-x1, beyond the paper's 5 degree steps."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from soopnav_cpp.array import ArrayGeometry, DirectionFinder, SteeringTable, crlb
from soopnav_cpp.experiments.carter_arrays import (
    SNAPSHOTS,
    Array,
    model_covariance,
    paper_array,
    sample_covariances,
    wrapped,
)
from soopnav_cpp.experiments.registry import Claim, Lab, band, below, experiment, style

SNR_DB = (0.0, 3.0, 5.0, 10.0)
SHOWN_DB = (-10.0, -5.0, 0.0, 3.0, 5.0, 10.0)
DIRECTIONS_DEG = ((25.0, 30.0), (-100.0, 50.0), (160.0, 70.0))  # azimuth, elevation
LINE_DEG = ((40.0, 0.0), (75.0, 0.0), (110.0, 0.0))
STARTS_DEG = (0.0, 0.25, 0.5, 0.75)
NAMES = ("2 x 2, 0.2 wavelengths", "circle of 6, 0.4 wavelengths", "line of 8, half a wavelength")
COLOURS = ("#2b5f9e", "#b5442e", "#3a7d44")


def arrays() -> tuple[ArrayGeometry, ...]:
    """A square, a circle, a line."""
    return paper_array(), ArrayGeometry.uca(6, 0.4), ArrayGeometry.ula(8, 0.5)


@lru_cache(maxsize=8)
def finder(index: int, start_deg: float = 0.0) -> DirectionFinder:
    """Once per process; a start makes the grid begin there, in elevation too."""
    table = SteeringTable(
        arrays()[index],
        azimuth_start_deg=start_deg,
        elevation_step_deg=1.0 if start_deg == 0.0 else 1.0 + 0.1 * start_deg,
    )
    return DirectionFinder(table)


def directions(index: int) -> Array:
    """Of an array: what it can tell."""
    return np.deg2rad(LINE_DEG if arrays()[index].rank == 1 else DIRECTIONS_DEG)


def trials(seed: int, count: int) -> Array:
    """Errors on the sphere [rad] and over the reported sigma: (arrays, SNRs, directions, count, 4)."""
    rng = np.random.default_rng(seed)
    out = np.zeros((3, len(SHOWN_DB), 3, count, 4))
    for index, geometry in enumerate(arrays()):
        search = finder(index)
        for s, snr_db in enumerate(SHOWN_DB):
            for d, at in enumerate(directions(index)):
                R = model_covariance(search.manifold, at[None], 10.0 ** (snr_db / 10.0))
                run = search.run(sample_covariances(rng, R, SNAPSHOTS, count), SNAPSHOTS)
                errors = np.stack(
                    [wrapped(run.azimuth_rad[:, 0] - at[0]) * np.cos(at[1]), run.elevation_rad[:, 0] - at[1]], axis=1
                )
                variance = np.diagonal(run.covariance_rad2[:, 0], axis1=1, axis2=2).copy()
                variance[:, 0] *= np.cos(run.elevation_rad[:, 0]) ** 2
                if geometry.rank == 1:
                    errors[:, 1], variance[:, 1] = 0.0, 1.0
                out[index, s, d] = np.hstack([errors, errors / np.sqrt(variance)])
    return out


def phases(seed: int, count: int) -> Array:
    """Largest difference on the sphere that the start of the grid makes, and each start's errors [rad], 0 dB."""
    rng = np.random.default_rng(seed)
    at = np.array([rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(30.0, 70.0))])
    R = model_covariance(finder(0).manifold, at[None], 1.0)
    drawn = sample_covariances(rng, R, SNAPSHOTS, count)
    runs = [finder(0, start).run(drawn, SNAPSHOTS) for start in STARTS_DEG]
    azimuth = np.stack([run.azimuth_rad[:, 0] for run in runs])
    elevation = np.stack([run.elevation_rad[:, 0] for run in runs])
    return np.array([np.abs(wrapped(azimuth - azimuth[0])).max(), np.abs(elevation - elevation[0]).max()])


def one_angle(index: int, kind: str, snr_db: float) -> Array:
    """Bound of the error on the sphere, rms [rad], for each direction."""
    geometry = arrays()[index]
    out = []
    for azimuth, elevation in directions(index):
        snr = 10.0 ** (snr_db / 10.0)
        if geometry.rank == 1:
            out.append(crlb(geometry, [np.pi / 2 - azimuth], snr, 1.0, SNAPSHOTS, kind)[0, 0])
        else:
            bound = crlb(geometry, [[azimuth, elevation]], snr, 1.0, SNAPSHOTS, kind)
            out.append(bound[0, 0] * np.cos(elevation) ** 2 + bound[1, 1])
    return np.sqrt(out)


@experiment("carter-x1", title="MUSIC at the bound", source="beyond carter section 4.3 (5 degree steps)", runs=20)
def at_the_bound(lab: Lab) -> Iterator[Claim]:
    """4000 trials each at fixed directions, covariances of 2500 snapshots drawn from their exact law."""
    results = np.concatenate(lab.map(trials, 200), axis=3)
    rms = np.sqrt(np.mean(np.sum(results[..., :2] ** 2, axis=-1), axis=-1))  # array, SNR, direction
    bounds = {
        kind: np.array([[one_angle(index, kind, snr) for snr in SHOWN_DB] for index in range(3)])
        for kind in ("stochastic", "deterministic")
    }
    scaled = np.sqrt(np.mean(results[..., 2:] ** 2, axis=-2))  # array, SNR, direction, axis

    with lab.figure(11.0, 4.6) as figure:
        axes = figure.subplots(1, 2)
        style(
            axes[0],
            "Middle direction: rms (dots) and stochastic bound (lines)",
            "SNR [dB]",
            "error on the sphere [deg]",
        )
        style(axes[1], "rms error over its bound, every direction", "SNR [dB]", "ratio")
        for index, (name, colour) in enumerate(zip(NAMES, COLOURS, strict=True)):
            axes[0].semilogy(SHOWN_DB, np.rad2deg(bounds["stochastic"][index, :, 1]), color=colour, label=name)
            axes[0].semilogy(SHOWN_DB, np.rad2deg(rms[index, :, 1]), color=colour, marker="o", ms=5.0, linestyle="none")
            for d in range(3):
                axes[1].plot(
                    SHOWN_DB, rms[index, :, d] / bounds["stochastic"][index, :, d],
                    color=colour, marker="o", ms=3.0, linewidth=1.0,
                    label="over the stochastic bound" if index + d == 0 else None,
                )  # fmt: skip
                axes[1].plot(
                    SHOWN_DB, rms[index, :, d] / bounds["deterministic"][index, :, d],
                    color=colour, marker="s", ms=2.5, linewidth=0.8, linestyle=(0, (2, 2)),
                    label="over the deterministic one" if index + d == 0 else None,
                )  # fmt: skip
        axes[1].axhline(1.1, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        axes[1].set_ylim(0.9, 2.0)
        for part in axes:
            part.legend(frameon=False, fontsize=8)
    lab.save(
        snr_db=SHOWN_DB, rms_rad=rms, scaled=scaled,
        stochastic_rad=bounds["stochastic"], deterministic_rad=bounds["deterministic"],
    )  # fmt: skip
    use = [SHOWN_DB.index(snr) for snr in SNR_DB]
    strong = [SHOWN_DB.index(snr) for snr in SNR_DB if snr >= 5.0]
    for index, name in enumerate(NAMES):
        yield Claim(
            f"{name}: rms over the stochastic bound, 0 to 10 dB, three directions, 4000 trials each",
            (rms / bounds["stochastic"])[index, use].ravel(), band(0.9, 1.1),
        )  # fmt: skip
        yield Claim(
            f"{name}: rms over the deterministic bound from 5 dB",
            (rms / bounds["deterministic"])[index, strong].ravel(), band(0.9, 1.1),
        )  # fmt: skip
        told = 1 if arrays()[index].rank == 1 else 2
        yield Claim(
            f"{name}: rms of error over reported sigma, 0 to 10 dB",
            scaled[index, use, :, :told].ravel(), band(1.0 / 1.5, 1.5),
        )  # fmt: skip
    moved = np.max(lab.map(phases, 100), axis=0)
    yield Claim("other phases of the grid change no estimate", moved, below(1e-7, "rad"))
