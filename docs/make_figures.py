"""Draws the simulated figures of the pages into docs/images.

demo_scan.png and demo_map.png are those of tools/demo.

    .venv/bin/python docs/make_figures.py [--runs N]

Everything is simulated from fixed seeds; the default number of runs takes a few minutes.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import two_receivers_figures

import soopnav_cpp as sn
import soopnav_cpp.scenarios.metrics

SPEED_OF_LIGHT_MPS = 299_792_458.0
IMAGES = Path(__file__).resolve().parent / "images"


def detection_curve(runs: int) -> None:
    """Share of trials with the right cell and with the MIB over SNR."""
    levels_db = np.arange(-20.0, -7.0, 1.0)
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for sync_ports, colour, label in (
        (sn.lte.SyncPorts.ALL, "tab:blue", "PSS and SSS on both ports"),
        (sn.lte.SyncPorts.FIRST, "tab:orange", "on one port"),
    ):
        right, decoded = np.zeros(len(levels_db)), np.zeros(len(levels_db))
        for i, level_db in enumerate(levels_db):
            for run in range(runs):
                rng = np.random.Generator(np.random.Philox(key=[i, run]))
                cell = sn.lte.CellParameters(
                    cell_id=int(rng.integers(504)),
                    n_rb=6,
                    n_ports=2,
                    start_sfn=int(rng.integers(1024)),
                    delay_s=float(rng.uniform(0.0, 10e-3)),
                    cfo_hz=float(rng.uniform(-3e3, 3e3)),
                    port_gain=[1.0, np.exp(0.7j), 1.0, 1.0],
                    sync_ports=sync_ports,
                )
                iq = sn.lte.synthesize(cell, 1.92e6, 115_200, snr_db=float(level_db), seed=run)
                for found in sn.lte.search(iq, 1.92e6, max_cfo_hz=3e3):
                    right[i] += found.cell_id == cell.cell_id
                    decoded[i] += found.cell_id == cell.cell_id and found.n_rb == 6
        axes.plot(levels_db, right / runs, color=colour, marker="o", label=f"cell id, {label}")
        axes.plot(levels_db, decoded / runs, color=colour, marker="s", linestyle="--", label=f"MIB, {label}")
    axes.set(
        xlabel="SNR per reference element of one port [dB]",
        ylabel=f"share of {runs} trials",
        ylim=(-0.03, 1.03),
        title="Cell search: 6 resource blocks, 2 ports, 60 ms, static channel",
    )
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(IMAGES / "lte_detection.png", dpi=130)
    plt.close(figure)


def subframe_bound_m(snr_db: float) -> float:
    """Bound on the delay from one subframe of 100 blocks and two ports (two symbols per element), metres."""
    centred = 3 * np.arange(400) - 600
    omega = 2 * np.pi * 15e3 * np.where(centred < 0, centred, centred + 1)
    information = 2 * 2 * 2 * 10 ** (snr_db / 10) * np.sum((omega - omega.mean()) ** 2)
    return float(SPEED_OF_LIGHT_MPS / np.sqrt(information))


def timing_curve(runs: int) -> None:
    """RMSE of the delay of one 100-block subframe beside the Cramer-Rao bound."""
    levels_db = np.arange(-15.0, 31.0, 5.0)
    errors_m = np.zeros((len(levels_db), runs))
    for i, level_db in enumerate(levels_db):
        for run in range(runs):
            rng = np.random.Generator(np.random.Philox(key=[100 + i, run]))
            delay_s = 20e-6 + float(rng.uniform(-1e-6, 1e-6))
            cell = sn.lte.CellParameters(
                cell_id=int(rng.integers(504)),
                n_rb=100,
                n_ports=2,
                delay_s=delay_s,
                port_gain=[1.0, np.exp(2j * np.pi * rng.uniform()), 1.0, 1.0],
            )
            iq = sn.lte.synthesize(cell, 19.2e6, 21_000, snr_db=float(level_db), seed=run)
            detection = sn.lte.Detection(cell_id=cell.cell_id, frame_start_s=20e-6, n_rb=100, n_ports=2)
            toa = sn.lte.SubframeToaEstimator(19.2e6, detection).estimate(iq, 0, 20e-6)
            errors_m[i, run] = (toa.toa_s - delay_s) * SPEED_OF_LIGHT_MPS if toa else np.nan
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    axes.semilogy(levels_db, [subframe_bound_m(x) for x in levels_db], color="black", label="Cramer-Rao bound")
    rmse_m = np.sqrt(np.nanmean(errors_m**2, axis=1))
    axes.semilogy(levels_db, rmse_m, "o", color="tab:blue", label=f"RMSE of {runs} trials")
    axes.set(
        xlabel="SNR per reference element of one port [dB]",
        ylabel="delay error [m]",
        title="Time of arrival from one subframe: 100 resource blocks, 2 ports",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(IMAGES / "lte_toa_bound.png", dpi=130)
    plt.close(figure)


def first_path_figure() -> None:
    """Impulse response of a cell whose first path is weaker than the second, and the paths that the model finds."""
    cell = sn.lte.CellParameters(
        cell_id=335,
        n_rb=100,
        n_ports=2,
        delay_s=1.2345e-3,
        port_gain=[1.0, np.exp(0.7j), 1.0, 1.0],
        taps=[
            (0.0, 0.6),
            (120e-9, np.exp(1.1j)),
            (300e-9, 0.5 * np.exp(-2.0j)),
        ],
    )
    iq = sn.lte.synthesize(cell, 30.72e6, 1_228_800, snr_db=20.0, seed=3)
    (found,) = sn.lte.search(iq, 30.72e6, max_cfo_hz=5e3)
    toa = sn.lte.time_of_arrival(iq, 30.72e6, found)
    lags = np.arange(len(toa.impulse_response))
    delays_ns = 1e9 * (toa.impulse_response_start_s + toa.impulse_response_step_s * lags)
    power_db = 20 * np.log10(toa.impulse_response / toa.impulse_response.max())
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    axes.plot(delays_ns, power_db, color="tab:blue", label="impulse response from both shifts of the comb")
    axes.stem(
        [1e9 * p.delay_s for p in toa.paths],
        [p.power_db for p in toa.paths],
        bottom=-50.0,
        linefmt="tab:orange",
        markerfmt="o",
        basefmt=" ",
        label="paths of the model",
    )
    axes.set(
        xlim=(-300, 900),
        ylim=(-45, 5),
        xlabel="delay after the first path [ns]",
        ylabel="power [dB]",
        title="First path 4.4 dB below the strongest",
    )
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(IMAGES / "lte_first_path.png", dpi=130)
    plt.close(figure)


def boundary_curve(runs: int) -> None:
    """RMS range error of blind symbol boundaries over SNR, of each estimator, beside the information of the delay."""
    levels_db = np.arange(-15.0, 31.0, 3.0)
    grid = sn.ofdm.Numerology()
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for number, (method, oversampling, label) in enumerate(
        (
            ("nearest_sample", 1, "nearest sample, 20 MHz"),
            ("maximum_likelihood", 1, "maximum likelihood of whole samples, 20 MHz"),
            ("nearest_sample", 15, "nearest sample, 300 MHz"),
            ("interpolated", 1, "between samples, 20 MHz"),
        )
    ):
        link = sn.simulation.OfdmLink(grid, oversampling=oversampling, movement="fractional_delay")
        delay_m = np.random.default_rng(number).uniform(0.0, grid.ambiguity_m, 5 * runs)
        rms_m = []
        for level_db in levels_db:
            heard = link.measure(delay_m, method=method, seed=number, snr_db=float(level_db))
            error_m = heard.range_m - delay_m
            error_m -= grid.ambiguity_m * np.round(error_m / grid.ambiguity_m)
            rms_m.append(np.sqrt(np.mean(error_m**2)))
        axes.semilogy(levels_db, rms_m, "os^D"[number] + "-", color=f"C{number}", linewidth=1.0, label=label)
    bound = [sn.ofdm.delay_crlb_m(float(level_db), 250, grid) for level_db in levels_db]
    axes.semilogy(levels_db, bound, color="black", label="information of the delay, 20 MHz")
    axes.set(
        xlabel="SNR per sample of the receiver [dB]",
        ylabel="RMS range error [m]",
        ylim=(5e-2, 6e2),
        title="Block boundaries of 250 symbols, delays anywhere",
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(IMAGES / "ofdm_boundary.png", dpi=130)
    plt.close(figure)


def planar_figure() -> None:
    """The errors of the run of docs/ofdm_inertial.md."""
    page = (IMAGES.parent / "ofdm_inertial.md").read_text(encoding="utf-8")
    scope: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[:2]:
        exec(compile(block, "docs/ofdm_inertial.md", "exec"), scope)
    scope["figure"].savefig(IMAGES / "ofdm_inertial_errors.png", dpi=130)


def outage_figure(runs: int) -> None:
    """Three dimensions: all transmitters lost for a minute, over runs of the gallery's scenario."""
    system, scenario = sn.scenarios.load(IMAGES.parents[1] / "examples" / "scenarios" / "crosby_x3.toml")
    ranging = scenario.ranging.model_copy(update={"outages_s": [(180.0, 240.0)]})
    scenario = scenario.model_copy(update={"duration_s": 360.0, "ranging": ranging})
    series = [sn.scenarios.metrics.evaluate(system.run(scenario, seed)) for seed in range(runs)]
    error_m, sigma_m = (np.array([getattr(one, name) for one in series]) for name in ("error_m", "sigma_m"))
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    for axis, colour, label in ((slice(0, 2), "tab:blue", "horizontal"), (slice(2, 3), "tab:green", "vertical")):
        rms_m, stated_m = (
            np.sqrt(np.mean(np.sum(part[:, :, axis] ** 2, axis=2), axis=0)) for part in (error_m, sigma_m)
        )
        axes.semilogy(series[0].t_s, rms_m, color=colour, linewidth=1.1, label=f"{label}: RMS of {runs} runs")
        axes.semilogy(series[0].t_s, stated_m, color=colour, linestyle="--", linewidth=1.3, label=f"{label}: stated")
    axes.axvspan(180.0, 240.0, color="0.5", alpha=0.15, linewidth=0, label="no transmitter")
    axes.set(xlabel="time [s]", ylabel="position error [m]", title="Four transmitters, all lost for a minute")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper right")
    figure.savefig(IMAGES / "ofdm_outage.png", dpi=130)
    plt.close(figure)


def source_figures() -> None:
    """The drive of docs/finding_a_source.md: the map, its bearings over the distance, positions by method."""
    from soopnav_cpp.scenarios import source_localization_figures as drawing

    system, scenario = sn.scenarios.load(IMAGES.parents[1] / "examples" / "scenarios" / "carter_drive.toml")
    run = system.run(scenario, sn.scenarios.execution.seed_of_run(scenario, 1))
    drawn = drawing.figures(scenario, run)
    for name, start in (("map", "Bearings on"), ("bearings", "Errors of bearings"), ("errors", "Distance")):
        figure = next(figure for caption, figure in drawn.items() if caption.startswith(start))
        figure.savefig(IMAGES / f"finding_{name}.png", dpi=110)


def calibration_figure() -> None:
    """The recording of docs/calibration.md: a tone into four receivers, 12 bits, before and after."""
    degrees = np.pi / 180.0
    front_end = sn.simulation.FrontEnd(
        4,
        gain=np.array([1.0, 0.85, 1.1, 0.95]) * np.exp(1j * np.array([0.0, 2.1, -0.8, 3.0])),
        iq_gain_db=[2.0, -1.2, 0.8, -2.0],
        iq_phase_rad=[10.0 * degrees, -6.0 * degrees, -9.0 * degrees, 4.0 * degrees],
        dc=[0.02, -0.01j, 0.015 + 0.01j, 0.0],
        adc_bits=12,
    )
    level = 10.0 ** ((front_end.noise_floor_dbm + 33.0) / 20.0)
    tone = level * np.exp(2j * np.pi * 1.013e6 / 20e6 * np.arange(20_000)) * np.ones((4, 1))
    iq = front_end.apply(tone.astype(np.complex64), seed=1)
    found = sn.array.calibrate(iq, 20e6, 1.013e6, sn.array.ArrayGeometry.planar(2, 2, 0.2))
    figure = sn.plotting.calibration(iq, found, title="tone.sigmf-meta")
    figure.savefig(IMAGES / "calibration.png", dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=60)
    runs = parser.parse_args().runs
    IMAGES.mkdir(exist_ok=True)
    two_receivers_figures.main()
    source_figures()
    calibration_figure()
    boundary_curve(runs)
    planar_figure()
    outage_figure(runs)
    first_path_figure()
    timing_curve(runs)
    detection_curve(runs)


if __name__ == "__main__":
    main()
