"""Time differences of arrival of a time transmitter from KiwiSDR recordings (WAV with GNSS time tags).

    python hf_tdoa.py [a_iq.wav b_iq.wav ...]

Without files, three receivers of a made-up transmitter are simulated: a 77.5 kHz carrier with second marks and phase
noise modulation, at known distances. Prints every pair's TDOA and how well the three close.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from pathlib import Path

import numpy as np

import soopnav_cpp as sn

RATE_HZ = 12_001.05
GROUND_WAVE_MPS = 299_792_458.0 / 1.000338
DISTANCE_M = {"near": 264_317.0, "south": 391_263.0, "west": 415_868.0}


def simulated(folder: Path) -> list[Path]:
    """Three recordings of 12 s; each receiver has its own start, sampling rate, carrier phase and noise."""
    rng = np.random.default_rng(1)
    chips = rng.choice([-1.0, 1.0], 12_000)  # phase modulation: 645 chips a second
    paths = []
    for i, (name, distance_m) in enumerate(DISTANCE_M.items()):
        rate_hz, start_s = RATE_HZ * (1.0 + 2e-6 * i), 370_000.0 + 0.31 * i
        sent = start_s + np.arange(int(12.0 * rate_hz)) / rate_hz - distance_m / GROUND_WAVE_MPS - 370_000.0
        marks = np.interp(sent % 1.0, [0.0, 0.003, 0.1, 0.103, 1.0], [1.0, 0.15, 0.15, 1.0, 1.0])
        place = (sent + 1.0) * 645.0
        phase = 0.2 * np.interp(place, np.arange(chips.size), chips)
        noise = rng.standard_normal((2, sent.size))
        iq = 0.3 * marks * np.exp(1j * (phase + i)) + 0.003 * (noise[0] + 1j * noise[1])
        path = folder / f"{name}_iq.wav"
        sn.io.write_kiwi(
            path,
            iq.astype(np.complex64),
            sample_rate_hz=rate_hz,
            start_s=start_s,
            tag_errors_s=6e-8 * rng.standard_normal(sent.size // 512),
        )
        paths.append(path)
    return paths


def main(arguments: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(argument) for argument in arguments] or simulated(Path(folder))
        recordings = [sn.io.read_kiwi(path) for path in paths]
    for recording in recordings:
        print(recording)
    tdoa_s: dict[tuple[int, int], float] = {}
    for i, j in itertools.combinations(range(len(recordings)), 2):
        result = sn.hf.envelope_tdoa(recordings[i], recordings[j])
        tdoa_s[i, j] = result.tdoa_s
        print(f"{paths[i].stem} - {paths[j].stem}: {result}")
        if not arguments:
            distances = list(DISTANCE_M.values())
            truth_s = (distances[i] - distances[j]) / GROUND_WAVE_MPS
            error_s = result.tdoa_s - truth_s
            print(f"  truth {truth_s * 1e6:.1f} µs, error {error_s * 1e6:+.2f} µs")
            assert abs(error_s) < 6.0 * result.sigma_s + 0.3e-6
    for i, j, k in itertools.combinations(range(len(recordings)), 3):
        print(f"closure: {(tdoa_s[i, j] + tdoa_s[j, k] - tdoa_s[i, k]) * 1e6:+.2f} µs")


if __name__ == "__main__":
    main(sys.argv[1:])
