"""``soopnav calibrate``: what the receivers of an array do to a tone, found and kept."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from soopnav_cpp import array, io
from soopnav_cpp.cli import text
from soopnav_cpp.cli.ending import sentences, stdout
from soopnav_cpp.cli.progress import Steps, progress

__all__ = ["Found", "as_json", "command", "find", "print_result"]

_FREQUENCY_SHARE = 1e-3  # by which a recording may be tuned beside the array's frequency
_IMAGE_DB = -50.0  # wanted
_PHASE_DEG = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """A calibration and how well it does.

    Attributes
    ----------
    iq : ndarray, shape (M, n), complex64
    calibration : Calibration
        Of the whole recording.
    image_after_db, phase_after_deg : ndarray, shape (M,)
        What is left of the second half by a calibration of the first.
    """

    iq: npt.NDArray[np.complex64]
    metadata: io.Metadata
    calibration: array.Calibration
    image_after_db: npt.NDArray[np.float64]
    phase_after_deg: npt.NDArray[np.float64]


def find(
    captures: Sequence[Path], array_path: Path, *, tone_hz: float, reference: int, tolerance_hz: float, step: Steps
) -> Found:
    """Read, fit, and check one half of the recording against the other."""
    manifold = array.load_array(array_path)
    geometry = manifold.geometry
    step(f"reading {captures[0].name}")
    iq, metadata = io.read_iq_channels(captures[0] if len(captures) == 1 else captures)
    name = metadata.path
    if iq.shape[0] != len(geometry.positions_m):
        raise ValueError(f"{name}: {iq.shape[0]} channels; the array of {array_path} has {len(geometry.positions_m)}")
    if not 0 <= reference < iq.shape[0]:
        raise ValueError(f"reference: {reference}; channels are 0 to {iq.shape[0] - 1}")
    tuned = metadata.center_frequency_hz
    if tuned is not None and abs(tuned / geometry.frequency_hz - 1.0) > _FREQUENCY_SHARE:
        raise ValueError(
            f"{name}: tuned to {text.megahertz(tuned)}; the array of {array_path} is for "
            f"{text.megahertz(geometry.frequency_hz)}"
        )

    def fit(samples: npt.NDArray[np.complex64], tone: float, tolerance: float) -> array.Calibration:
        return array.calibrate(
            samples,
            metadata.sample_rate_hz,
            tone,
            geometry,
            frequency_hz=geometry.frequency_hz if tuned is None else tuned,
            reference=reference,
            tolerance_hz=tolerance,
        )

    step("fitting")
    try:
        whole = fit(iq, tone_hz, tolerance_hz)
        halves = [np.ascontiguousarray(half) for half in np.array_split(iq, 2, axis=1)]
        first = fit(halves[0], whole.tone_hz, 0.0)
        left = fit(first.apply(halves[1]), whole.tone_hz, 0.0)
    except array.CalibrationError as error:
        message = str(error)
        raise ValueError(f"{name}: {message[4:] if message.startswith('iq: ') else message}") from error
    return Found(iq, metadata, whole, left.image_db, np.degrees(np.angle(left.channel)))


def as_json(found: Found) -> dict[str, Any]:
    """What ``--json`` prints."""
    made = found.calibration
    return {
        "capture": str(found.metadata.path),
        "array": made.array_name,
        "frequency_hz": made.frequency_hz,
        "sample_rate_hz": made.sample_rate_hz,
        "tone_hz": made.tone_hz,
        "channels": [
            {
                "image_before_db": float(made.image_db[m]),
                "image_after_db": float(found.image_after_db[m]),
                "iq_gain_db": float(20.0 * np.log10(made.iq_gain[m])),
                "iq_phase_deg": float(np.degrees(made.iq_phase_rad[m])),
                "gain_db": float(20.0 * np.log10(abs(made.channel[m]))),
                "phase_deg": float(np.degrees(np.angle(made.channel[m]))),
                "phase_sigma_deg": float(np.degrees(made.phase_sigma_rad[m])),
                "phase_after_deg": float(found.phase_after_deg[m]),
                "tone_snr_db": float(made.tone_snr_db[m]),
                "residual_rms": float(made.residual_rms[m]),
            }
            for m in range(made.n_channels)
        ],
    }


def print_result(found: Found, console: Console) -> None:
    """The table a person reads."""
    made = found.calibration
    console.print(
        f"{found.metadata.path.name}  {text.rate(made.sample_rate_hz)}  {text.megahertz(made.frequency_hz)}  "
        f"{text.duration(found.metadata.duration_s)}  tone at {made.tone_hz / 1e3:.4f} kHz",
        highlight=False,
        soft_wrap=True,
    )
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for name in ("channel", "I/Q gain", "I/Q phase", "image", "after", "gain", "phase", "after", "tone", "residual"):
        table.add_column(name, justify="right", no_wrap=True)
    for m, row in enumerate(as_json(found)["channels"]):
        table.add_row(
            str(m),
            f"{text.signed(row['iq_gain_db'], 2)} dB",
            f"{text.signed(row['iq_phase_deg'], 2)}°",
            f"{text.plain(row['image_before_db'], 1)} dB",
            f"{text.plain(row['image_after_db'], 1)} dB",
            f"{text.signed(row['gain_db'], 2)} dB",
            f"{text.signed(row['phase_deg'], 2)}°",
            f"{text.signed(row['phase_after_deg'], 3)}°",
            f"{text.plain(row['tone_snr_db'], 1)} dB",
            f"{row['residual_rms']:.2e}",
        )
    console.print(table, highlight=False)
    image, phase = float(found.image_after_db.max()), float(np.abs(found.phase_after_deg).max())
    worst = f"second half by the first: image {text.plain(image, 1)} dB, phases within {phase:.3f}°"
    if image > _IMAGE_DB or phase > _PHASE_DEG:
        worst += (
            f". Not as good as {text.plain(_IMAGE_DB, 0)} dB and {_PHASE_DEG}°: take 10 000 samples and 30 dB, "
            "and look whether something drifts"
        )
    console.print(worst, highlight=False, soft_wrap=True)


@click.command(name="calibrate", short_help="Calibrate the receivers of an array with a tone.")
@click.argument("captures", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="CAPTURE...")
@click.option("--tone", "tone_hz", type=float, required=True, metavar="HZ", help="Baseband frequency of the tone.")
@click.option(
    "--array", "array_path", type=click.Path(path_type=Path), required=True, metavar="TOML", help="The array."
)
@click.option("--out", type=click.Path(path_type=Path), metavar="JSON", help="The file.  [default: CAPTURE.json]")
@click.option("--reference", type=int, default=0, show_default=True, metavar="M", help="The channel that stays.")
@click.option(
    "--tolerance",
    "tolerance_hz",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="HZ",
    help="How far the tone may be off.  [default: 4 turns per capture]",
)
@click.option("--plot", type=click.Path(path_type=Path), metavar="PNG", help="Draw I, Q and the carriers.")
@click.option("--json", "print_json", is_flag=True, help="Print JSON and nothing else.")
@sentences
def command(
    captures: tuple[Path, ...],
    tone_hz: float,
    array_path: Path,
    out: Path | None,
    reference: int,
    tolerance_hz: float,
    plot: Path | None,
    print_json: bool,
) -> None:
    """Find what each receiver does to a tone that reaches all of them alike.

    CAPTURE is a SigMF recording with a channel for each antenna (core:num_channels), or one recording per channel in
    their order: of a tone by equal cables into every receiver. Prints a row per channel: gain and phase of Q against
    I, image before and after, gain and phase against the reference channel. "After" is measured on the second half of
    the recording, corrected by a calibration of the first.

    Writes the calibration, which soopnav df takes with --calibration; it belongs to this array and frequency and is
    refused for others.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ValueError(f"{plot}: a name that ends in .png expected")
    target = captures[0].with_suffix(".json") if out is None else out
    if target.suffix.lower() != ".json":
        raise ValueError(f"{target}: a name that ends in .json expected")
    with progress() as step:
        found = find(captures, array_path, tone_hz=tone_hz, reference=reference, tolerance_hz=tolerance_hz, step=step)
        found.calibration.save(target)
        if plot is not None:
            from soopnav_cpp import plotting

            step(f"drawing {plot.name}")
            plotting.calibration(found.iq, found.calibration, title=found.metadata.path.name, path=plot)
    if print_json:
        click.echo(json.dumps(as_json(found), indent=2))
        return
    console = stdout()
    print_result(found, console)
    console.print(f"calibration: {target}", highlight=False, soft_wrap=True)
    if plot is not None:
        console.print(f"plot: {plot}", highlight=False, soft_wrap=True)
