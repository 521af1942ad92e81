"""MUSIC against SNR and bandwidth: carter figs. 4.7 to 4.11."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from soopnav_cpp.experiments.carter_arrays import (
    ELEVATIONS_RAD,
    SNAPSHOTS,
    Array,
    angle_between,
    band_limited,
    normals,
    paper_finder,
    unit_vectors,
    wrapped,
)
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, below, experiment, style

SNR_DB = tuple(float(snr) for snr in range(-25, 11, 5))
RATIOS = (0.05, 0.15, 0.4, 1.0)
COLOURS = ("#b5442e", "#c98a1b", "#3a7d44", "#2b5f9e")
EIGEN_FROM_DB = -5.0


def trials(seed: int, batch: int) -> Array:
    """Random directions: errors of azimuth, elevation and angle [rad], and eigenvalues, on generated samples.

    Returns
    -------
    ndarray, shape (batch, 2, ratios, SNRs, 3 + 4)
        First with the SNR as power over the whole front end's band, then as the ratio of the densities in the
        signal's band; each signal and noise serves all of them.
    """
    rng = np.random.default_rng(seed)
    finder = paper_finder()
    out = np.empty((batch, 2, len(RATIOS), len(SNR_DB), 7))
    for trial in range(batch):
        azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(*ELEVATIONS_RAD)
        u = unit_vectors(azimuth, elevation)
        a = finder.manifold.steering(azimuth, elevation).astype(np.complex64)
        noise = normals(rng, 4, SNAPSHOTS).astype(np.complex64)
        for r, ratio in enumerate(RATIOS):
            waves = a * band_limited(rng, ratio, SNAPSHOTS)
            for kind in range(2):
                for s, snr_db in enumerate(SNR_DB):
                    power = 10.0 ** (snr_db / 10.0) * (ratio if kind else 1.0)
                    found = finder.estimate(noise + np.float32(np.sqrt(power)) * waves)
                    errors = (
                        float(wrapped(found.azimuth_rad[0] - azimuth)),
                        found.elevation_rad[0] - elevation,
                        float(angle_between(unit_vectors(found.azimuth_rad[0], found.elevation_rad[0]), u)),
                    )
                    out[trial, kind, r, s] = (*errors, *found.eigenvalues)
    return out


@experiment(
    "carter-4.7",
    title="MUSIC against SNR and bandwidth",
    source="carter section 4.3, table 4.2, Figs. 4.7 to 4.11",
    runs=16,
)
def figure_4_7(lab: Lab) -> Iterator[Claim]:
    """Four elements 0.2 wavelengths apart, 2500 samples, elevation 20 to 70 degrees, any azimuth."""
    results = np.concatenate(lab.map(trials, 50))
    rms_deg = np.rad2deg(np.sqrt(np.mean(results[..., :3] ** 2, axis=0)))  # kind, ratio, SNR, error
    eigen = results[..., 3:].mean(axis=0)
    ratios = eigen[..., 0] / eigen[..., 1:].mean(axis=-1)
    db = {snr: SNR_DB.index(snr) for snr in SNR_DB}

    with lab.figure(11.0, 7.4) as figure:
        axes = figure.subplots(2, 3)
        titles = ("Azimuth (4.8)", "Elevation (4.9)", "Angle (4.7, 4.10)")
        for part, title in enumerate(titles):
            style(axes[0, part], title, "SNR in the front end's band [dB]", "rms error [deg]")
            for r, (ratio, colour) in enumerate(zip(RATIOS, COLOURS, strict=True)):
                axes[0, part].semilogy(
                    SNR_DB, rms_deg[0, r, :, part], color=colour, marker="o", ms=3.0, label=f"{ratio:g} of the band"
                )
        axes[0, 2].legend(frameon=False, fontsize=8)
        style(axes[1, 0], "SNR as ratio of densities", "SNR in the signal's band [dB]", "rms angle [deg]")
        style(axes[1, 1], "Over SNR + 10 log bw", "SNR + 10 log bw [dB]", "rms angle [deg]")
        for r, (ratio, colour) in enumerate(zip(RATIOS, COLOURS, strict=True)):
            for column, shift in ((0, 0.0), (1, 10.0 * np.log10(ratio))):
                axes[1, column].semilogy(
                    np.array(SNR_DB) + shift, rms_deg[1, r, :, 2], color=colour, marker="o", ms=3.0
                )
        style(
            axes[1, 2],
            "The four mean eigenvalues (4.11)",
            "SNR in the front end's band [dB]",
            "eigenvalue over noise [dB]",
        )
        for order in range(4):
            axes[1, 2].plot(
                SNR_DB, 10.0 * np.log10(eigen[0, :, :, order].mean(axis=0)), color=COLOURS[order], marker="o", ms=3.0
            )
        axes[1, 2].plot(
            SNR_DB,
            10.0 * np.log10(1.0 + 4.0 * 10.0 ** (np.array(SNR_DB) / 10.0)),
            color="#22303c", linewidth=0.9, linestyle=(0, (4, 3)), label="1 + 4 SNR",
        )  # fmt: skip
        axes[1, 2].legend(frameon=False, fontsize=8)
    lab.save(snr_db=SNR_DB, bandwidth_ratio=RATIOS, rms_deg=rms_deg, eigenvalues=eigen)

    angle = rms_deg[..., 2]
    count = len(results)
    yield Claim(
        f"rms angle at 0 dB, any bandwidth, {count} trials on generated samples",
        angle[0, :, db[0.0]], below(3.0, "deg"),
    )  # fmt: skip
    yield Claim("rms angle at 10 dB, any bandwidth", angle[0, :, db[10.0]], below(1.0, "deg"))
    yield Claim(
        "rms angle at -15 dB over that at 0 dB: the threshold", angle[0, :, db[-15.0]] / angle[0, :, db[0.0]],
        at_least(8.0),
    )  # fmt: skip
    above = angle[0][:, [db[0.0], db[5.0], db[10.0]]]
    yield Claim(
        "bandwidth changes little at equal SNR over the front end's band: largest over smallest rms at 0, 5, 10 dB",
        above.max(axis=0) / above.min(axis=0),
        at_most(1.25),
    )
    # Ratio of densities: where SNR + 10 log bw is 0 to 10 dB, the curves against that of the full band.
    reference_db, reference = np.array(SNR_DB), np.log(angle[0, -1])
    offsets = []
    for r, ratio in enumerate(RATIOS):
        effective = np.array(SNR_DB) + 10.0 * np.log10(ratio)
        use = effective >= -5.0
        if ratio < 1.0 and use.any():
            offsets.extend(np.exp(np.log(angle[1, r, use]) - np.interp(effective[use], reference_db, reference)))
    yield Claim(
        "SNR as ratio of densities: over SNR + 10 log bw (from -5 dB) the curves fall on one",
        offsets, band(0.75, 1.25),
    )  # fmt: skip
    from_db = [db[snr] for snr in SNR_DB if snr >= EIGEN_FROM_DB]
    expected = 1.0 + 4.0 * 10.0 ** (np.array(SNR_DB)[from_db] / 10.0)
    yield Claim(
        "largest eigenvalue over the mean of the others is 1 + 4 SNR from -5 dB",
        (ratios[0][:, from_db] / expected).ravel(), band(0.9, 1.1),
    )  # fmt: skip
