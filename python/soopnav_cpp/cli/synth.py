"""``soopnav synth lte``: a capture from a scenario."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from soopnav_cpp import io, lte
from soopnav_cpp.cli.progress import Steps
from soopnav_cpp.cli.text import SPEED_OF_LIGHT_MPS
from soopnav_cpp.scenarios import LteScenario, ScenarioCell, load_lte_scenario

__all__ = ["cell_parameters", "synthesize"]

_BLOCK = 1 << 18


def cell_parameters(scenario: LteScenario, cell: ScenarioCell) -> lte.CellParameters:
    """A scenario's cell as it reaches the receiver: its delay is range, its clock and the receiver's."""
    receiver = scenario.receiver
    range_m = math.dist(cell.position_m, receiver.position_m)
    crystal_hz = 1e-6 * receiver.clock_error_ppm * (scenario.capture.center_frequency_hz or 0.0)
    return lte.CellParameters(
        cell_id=cell.cell_id,
        n_rb=cell.n_rb,
        n_ports=cell.n_ports,
        cp=lte.CyclicPrefix[cell.cp.upper()],
        duplex=lte.Duplex[cell.duplex],
        tdd_configuration=cell.tdd_configuration,
        special_subframe_configuration=cell.special_subframe_configuration,
        start_sfn=cell.start_sfn,
        delay_s=range_m / SPEED_OF_LIGHT_MPS + cell.clock_offset_s + receiver.clock_bias_s,
        power_db=cell.power_db,
        cfo_hz=cell.cfo_hz + receiver.cfo_hz + crystal_hz,
        clock_error_ppm=receiver.clock_error_ppm,
        carrier_phase_rad=cell.phase_rad,
        taps=[(tap.delay_s, tap.gain) for tap in cell.taps] or [(0.0, 1.0 + 0.0j)],
    )


def synthesize(scenario_path: Path, out: Path, *, step: Steps) -> tuple[Path, int]:
    """Write the capture; returns its metadata file and number of samples."""
    scenario = load_lte_scenario(scenario_path)
    capture = scenario.capture
    noise = 0.0 if capture.snr_db is None else lte.noise_variance_for_snr(capture.snr_db)
    cells = [cell_parameters(scenario, cell) for cell in scenario.cells]
    source = lte.Synthesizer(cells, capture.sample_rate_hz, noise_variance=noise, seed=capture.seed)
    n_samples = max(1, round(capture.duration_s * capture.sample_rate_hz))
    iq = np.empty(n_samples, np.complex64)
    for start in range(0, n_samples, _BLOCK):
        step("synthesizing", done=start, total=n_samples)
        iq[start : start + _BLOCK] = source.generate(min(_BLOCK, n_samples - start))
    peak = float(np.abs(iq.view(np.float32)).max())
    if peak > 0.0:
        iq *= np.float32(capture.peak / peak)
    step(f"writing {out.name}")
    written = io.write_iq(
        out,
        iq,
        capture.sample_rate_hz,
        format=capture.format,
        center_frequency_hz=capture.center_frequency_hz,
        description=capture.description,
    )
    return written, n_samples
