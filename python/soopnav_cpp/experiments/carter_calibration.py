"""Calibration of four receivers from a tone: carter figs. 5.5-5.7."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import array
from soopnav_cpp._calibration_figures import draw_calibration
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.simulation import FrontEnd

Array = npt.NDArray[np.float64]
Samples = npt.NDArray[np.complex64]

BLUE, RED = "#1b6ca8", "#d1495b"
RATE_HZ, TONE_HZ, OTHER_HZ = 20e6, 1.013e6, -3.317e6
SAMPLES = 10_000
SNR_DB = 30.0  # of the tone in one sample
IQ_GAIN_DB, IQ_PHASE_DEG = 2.0, 10.0


@dataclasses.dataclass(frozen=True)
class Trial:
    """One calibration, an element per channel; elevations of the zenith by MUSIC, before and after."""

    image_before_db: Array
    image_db: Array
    phase_deg: Array
    elevation_deg: tuple[float, float]
    sigma_deg: float


def geometry() -> array.ArrayGeometry:
    """The paper's four elements on a square of 0.2 wavelengths."""
    return array.ArrayGeometry.planar(2, 2, 0.2)


def tone(frequency_hz: float, amplitude: float) -> Samples:
    """The same for every receiver, as a cable and a splitter bring it."""
    phase = 2.0 * np.pi * np.mod(frequency_hz / RATE_HZ * np.arange(SAMPLES), 1.0)
    return np.tile((amplitude * np.exp(1j * phase)).astype(np.complex64), (4, 1))


def receivers(seed: int, *, quiet: bool = False) -> FrontEnd:
    """Any phases, amplitudes within 3 dB, offsets; each channel 2 dB and 10 degrees out of quadrature."""
    rng = np.random.default_rng([seed, 1])
    gain = 10.0 ** (rng.uniform(-1.5, 1.5, 4) / 20.0) * np.exp(2j * np.pi * rng.uniform(size=4))
    signs = rng.choice([-1.0, 1.0], (2, 4))
    return FrontEnd(
        4,
        gain=gain,
        iq_gain_db=IQ_GAIN_DB * signs[0],
        iq_phase_rad=np.radians(IQ_PHASE_DEG) * signs[1],
        dc=0.02 * (rng.standard_normal(4) + 1j * rng.standard_normal(4)),
        sample_rate_hz=RATE_HZ,
        full_scale_dbm=60.0 if quiet else None,  # without one 40 dB over the noise; 60 dBm: 155 dB over it
    )


def lines(samples: Samples, frequency_hz: float) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
    """Amplitude of each channel's tone and of its image, by least squares."""
    phase = 2.0 * np.pi * np.mod(frequency_hz / RATE_HZ * np.arange(samples.shape[1]), 1.0)
    design = np.stack([np.exp(1j * phase), np.exp(-1j * phase), np.ones(len(phase))], axis=1)
    found = np.linalg.lstsq(design, samples.T.astype(np.complex128), rcond=None)[0]
    return found[0], found[1]


def recorded(seed: int, frequency_hz: float, stream: int = 0) -> Samples:
    """The tone as the receivers record it, `SNR_DB` over the noise of a channel without gain; a stream is a capture."""
    front_end = receivers(seed)
    level_dbm = front_end.noise_floor_dbm + SNR_DB + 1.5  # the weakest gain is -1.5 dB
    return front_end.apply(tone(frequency_hz, 10.0 ** (level_dbm / 20.0)), seed, stream)


def calibrated(seed: int) -> array.Calibration:
    """From `SAMPLES` samples of the calibration's tone."""
    return array.calibrate(recorded(seed, TONE_HZ), RATE_HZ, TONE_HZ, geometry())


def trial(seed: int) -> Trial:
    """Calibrate with one tone; measure on another one, without noise; point at the zenith with noise."""
    found = calibrated(seed)
    other = receivers(seed, quiet=True).apply(tone(OTHER_HZ, 0.5 * 10.0 ** (60.0 / 20.0)), seed)
    before = lines(other, OTHER_HZ)
    after = lines(found.apply(other), OTHER_HZ)
    finder = array.DirectionFinder(geometry())
    overhead = recorded(seed, OTHER_HZ, stream=1)
    elevations = [
        float(np.degrees(finder.estimate(samples).elevation_rad[0])) for samples in (overhead, found.apply(overhead))
    ]
    return Trial(
        image_before_db=20.0 * np.log10(np.abs(before[1] / before[0])),
        image_db=20.0 * np.log10(np.abs(after[1] / after[0])),
        phase_deg=np.degrees(np.angle(after[0] / after[0][0])),
        elevation_deg=(elevations[0], elevations[1]),
        sigma_deg=float(np.degrees(found.phase_sigma_rad[1:].mean())),
    )


@experiment("carter-5.5", title="Calibration of the receivers", source="carter section 5.2, Figs. 5.5-5.7", runs=100)
def calibration(lab: Lab) -> Iterator[Claim]:
    """2 dB, 10 degrees and any phases; the paper's tone lies in the middle of the band, where there is no ellipse."""
    trials = lab.map(trial)
    before = np.array([t.image_before_db for t in trials])
    image = np.array([t.image_db for t in trials])
    phase = np.array([t.phase_deg for t in trials])[:, 1:]
    elevation = np.array([t.elevation_deg for t in trials])

    with lab.figure(10.4, 8.2) as figure:
        draw_calibration(figure, recorded(lab.seeds[0], TONE_HZ), calibrated(lab.seeds[0]))
    with lab.figure(10.4, 3.6, part="errors") as figure:
        axes = [figure.add_subplot(1, 3, k + 1) for k in range(3)]
        style(axes[0], "Image of another tone", "image over tone [dB]", "channels")
        axes[0].hist(image.ravel(), bins=30, color=BLUE, label="after")
        axes[0].axvline(before.mean(), color=RED, label="before")
        axes[0].axvline(-50.0, color="black", linewidth=0.8, linestyle="--", label="wanted")
        axes[0].legend(fontsize=8, frameon=False)
        style(axes[1], "Phases of another tone", "error [°]", "channels")
        axes[1].hist(phase.ravel(), bins=30, color=BLUE)
        style(axes[2], "Zenith by MUSIC", "elevation [°]", "runs")
        axes[2].hist(elevation[:, 0], bins=np.linspace(0.0, 90.0, 31).tolist(), color=RED, label="before")
        axes[2].hist(elevation[:, 1], bins=np.linspace(0.0, 90.0, 31).tolist(), color=BLUE, label="after")
        axes[2].legend(fontsize=8, frameon=False)
    lab.save(image_before_db=before, image_db=image, phase_deg=phase, elevation_deg=elevation)

    yield Claim(
        f"before: image of {IQ_GAIN_DB:g} dB and {IQ_PHASE_DEG:g}°", before.mean(), band(-17.2, -16.5, "dB"), "Fig. 5.5"
    )
    yield Claim("after: image of another tone, without noise, at worst", image.max(), at_most(-50.0, "dB"), "Fig. 5.5")
    yield Claim("after: phases of the channels, at worst", np.abs(phase).max(), at_most(0.2, "°"), "Fig. 5.6")
    yield Claim(
        "the calibrated array points to the zenith, at worst", elevation[:, 1].min(), at_least(89.0, "°"), "Section 5.2"
    )
    yield Claim(
        "share of runs that point above 80° without calibration",
        float(np.mean(elevation[:, 0] > 80.0)),
        at_most(0.2),
        "Section 5.2",
    )
