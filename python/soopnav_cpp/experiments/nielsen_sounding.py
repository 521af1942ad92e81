"""nielsen section 5: channels recorded with a pulse and with a stepped tone, and LTE channels made of the record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from soopnav_cpp import lte, simulation
from soopnav_cpp.experiments.registry import Claim, Lab, above, at_least, at_most, condition, experiment, near, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Floats = npt.NDArray[np.float64]
_Complex = npt.NDArray[np.complex128]

RESOURCE_BLOCKS = (6, 15, 25, 50, 75, 100)
MARKS_HZ = (2.5e6, 4.5e6, 9.0e6, 9.9e6)
TONES_HZ = np.arange(-9e6, 9.01e6, 0.25e6)
NODES_M = np.array([[2.0, 2.0, 2.2], [18.0, 1.5, 2.2], [19.0, 13.0, 2.2], [1.5, 13.5, 2.2]])


def laboratory(seed: int) -> simulation.IndoorRoom:
    """A room like that of figure 60: concrete, a row of windows, two plaster walls."""
    return simulation.IndoorRoom.rectangle(
        20.0,
        15.0,
        material="concrete",
        windows=[("south", 3.0, 17.0)],
        inner=[simulation.RoomWall((7.0, 9.0), (7.0, 15.0), "plaster", 0.1)],
        carrier_hz=2.45e9,
        seed=seed,
    )


def channels_of(seed: int, places: int) -> tuple[list[list[list[tuple[float, complex]]]], float]:
    """Taps of all ports at places of a turntable, and their mean amplitude."""
    rng = np.random.default_rng(seed)
    rim = simulation.turntable(0.15, places, centre_m=rng.uniform([6.0, 4.0], [14.0, 8.0]), start_rad=rng.uniform(0, 6))
    links = laboratory(seed % 2**32).links(NODES_M, rim)
    taps = [[links.taps(i, j) for j in range(len(NODES_M))] for i in range(places)]
    return taps, float(np.sqrt(np.mean(10.0 ** (links.power_db / 10.0))))


def response(taps: list[tuple[float, complex]], frequencies_hz: _Floats) -> _Complex:
    """The true channel."""
    delay, gain = np.array([d for d, _ in taps]), np.array([g for _, g in taps])
    return np.asarray(np.exp(-2j * np.pi * np.outer(frequencies_hz, delay)) @ gain)


def one_session(seed: int) -> dict[str, _Floats]:
    """Two places of a turntable and four ports, recorded and emulated."""
    channels, gain = channels_of(seed, 2)
    sounder = simulation.ChannelSounder(reference_gain=gain, seed=seed % 2**32)
    record = sounder.record(channels)
    error, stated = [], []
    for n_rb in RESOURCE_BLOCKS:
        f = simulation.subcarrier_hz(n_rb)
        truth = np.array([[response(taps, f) for taps in row] for row in channels])
        made = record.emulate(0.18e6 * n_rb)
        # The square error over all ports, against their mean power: what a receiver's noise floor would be.
        scale = np.mean(np.abs(truth) ** 2)
        error.append(np.sqrt(np.mean(np.abs(made.response(f) - truth) ** 2) / scale))
        stated.append(np.sqrt(np.mean(made.sigma(f) ** 2)))
    wide = record.emulate(20e6)
    middle, edge = wide.sigma([0.0, 10e6])
    named = all(np.any(np.abs(wide.nulls_hz - f) < 1.0) for f in (-10e6, 10e6))
    swept = sounder.sweep(channels, TONES_HZ, reference_gain=gain, seed=seed % 2**32)
    held = sounder.sweep(channels, TONES_HZ, reference_gain=gain, reference_channel=True, seed=seed % 2**32)
    truth = np.array([[response(taps, TONES_HZ) for taps in row] for row in channels])
    turned = np.exp(1j * np.angle(swept.gain / truth))
    drift = simulation.ChannelSounder(reference_gain=gain, shared_reference=False, averages=20000, seed=seed % 2**32)
    lost = np.abs(drift.record([[channels[0][0]]]).lines).sum() / np.abs(record.lines[0, 0]).sum()
    return {
        "error": np.array(error),
        "stated": np.array(stated),
        "edge": np.array([edge / middle, float(named), float(wide.covered)]),
        "magnitude": np.array(np.sqrt(np.mean((swept.magnitude - np.abs(truth)) ** 2) / np.mean(np.abs(truth) ** 2))),
        "across_tones": np.array(np.abs(turned.mean(axis=-1)).mean()),
        "across_places": np.array(np.abs((turned * turned[:1, :1].conj()).mean(axis=(0, 1))).mean()),
        "with_reference": np.array(np.sqrt(np.mean(np.abs(held.gain - truth) ** 2) / np.mean(np.abs(truth) ** 2))),
        "lost": np.array(lost),
    }


def replay(seed: int, lab: Lab) -> tuple[float, float]:
    """Relative error, in their band, of LTE samples over a loaded record; whether the file gave the record back."""
    channels, gain = channels_of(seed, 1)
    record = simulation.ChannelSounder(reference_gain=gain, seed=seed % 2**32).record(channels)
    path = lab.out / f"{lab.experiment.id}_record.npz"
    record.save(path)
    lab.data.append(path)
    again = simulation.SoundingRecord.load(path)
    same = bool((again.lines == record.lines).all() and (again.calibration == record.calibration).all())
    made = again.emulate(4.5e6)
    rate_hz = 15.36e6
    sent = lte.synthesize(lte.CellParameters(cell_id=17, n_rb=25, delay_s=0.0), rate_hz, 15360)
    offset = 1e-6  # taps before time zero would cut the first samples
    spectra = []
    for taps in (channels[0][0], made.taps(0, 0)):
        received = simulation.apply_taps(sent, rate_hz, [(d + offset, g / gain) for d, g in taps])
        spectra.append(np.fft.fft(received)[np.abs(np.fft.fftfreq(len(sent), 1.0 / rate_hz)) <= 2.25e6])
    difference = np.linalg.norm(spectra[1] - spectra[0]) / np.linalg.norm(spectra[0])
    return float(difference), float(same)


def _draw(figure: Figure, sounder: simulation.ChannelSounder, seed: int, error: _Floats, stated: _Floats) -> None:
    blue, red, grey = "#1b6ca8", "#d1495b", "#8a949c"
    axes = figure.add_subplot(2, 2, 1)
    style(axes, "The pulse: 100 ns every 10 µs", "time [µs]", "amplitude")
    t = np.linspace(-1.0, 21.0, 4401)
    axes.plot(t, (np.abs((t + 5.0) % 10.0 - 5.0) <= 0.05).astype(float), color=blue, linewidth=1.0)
    axes = figure.add_subplot(2, 2, 2)
    style(axes, "Its lines, 100 kHz apart", "frequency from the carrier [MHz]", "power [dB]")
    f = sounder.line_hz / 1e6
    level = 20.0 * np.log10(np.maximum(np.abs(sounder.lines), 1e-12) / np.abs(sounder.lines).max())
    axes.vlines(f, -70.0, np.maximum(level, -70.0), color=blue, linewidth=0.8)
    axes.axvspan(-9.0, 9.0, color=grey, alpha=0.15, linewidth=0, label="occupied by 100 RB")
    axes.plot([-10, 10], [-68, -68], "v", color=red, markersize=6, label="nulls, not divided by")
    axes.set_xlim(-20, 20)
    axes.set_ylim(-70, 14)
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center")
    channels, gain = channels_of(seed, 1)
    record = simulation.ChannelSounder(reference_gain=gain, seed=seed % 2**32).record(channels)
    axes = figure.add_subplot(2, 2, 3)
    style(axes, "One port's channel, made of the record", "frequency from the carrier [MHz]", "|H| [dB]")
    grid = np.linspace(-9e6, 9e6, 721)
    axes.plot(grid / 1e6, 20 * np.log10(np.abs(response(channels[0][0], grid))), color="#22303c", lw=3.2, alpha=0.25)
    for n_rb, colour in ((100, blue), (25, "#2e9e6b"), (6, red)):
        inside = simulation.subcarrier_hz(n_rb)
        H = record.emulate(0.18e6 * n_rb).response(inside)[0, 0]
        axes.plot(inside / 1e6, 20 * np.log10(np.abs(H)), color=colour, lw=1.2, label=f"{n_rb} RB")
    axes.plot([], [], color="#22303c", lw=3.2, alpha=0.25, label="true")
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="upper center")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.18 * (high - low))
    axes = figure.add_subplot(2, 2, 4)
    style(axes, "Error of the emulated channel", "resource blocks", "relative RMS")
    at = np.arange(len(RESOURCE_BLOCKS))
    axes.semilogy(at, error, "o-", color=blue, label="measured")
    axes.semilogy(at, stated, "s:", color=grey, label="stated: noise of the lines")
    axes.axhline(1e-3, color=red, linewidth=0.9, linestyle=(0, (4, 3)), label="bar")
    axes.set_xticks(at, [str(n) for n in RESOURCE_BLOCKS])
    axes.set_ylim(5e-5, 4e-3)
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper center")


@experiment("nielsen-62", title="Recording and replaying channels", source="nielsen section 5, Fig. 62", runs=12)
def sounding(lab: Lab) -> Iterator[Claim]:
    """A 100 ns pulse, 40 dB at its strongest line in one period, 1000 averages, 14 bits, four ports."""
    pulse = simulation.ChannelSounder(filter_hz=1e12)
    level = [
        20.0 * np.log10(np.abs(pulse.lines[np.argmin(np.abs(pulse.line_hz - f))]) / np.abs(pulse.lines).max())
        for f in MARKS_HZ
    ]
    for f, measured, stated in zip(MARKS_HZ, level, (-0.91, -3.12, -19.2, -39.9), strict=True):
        yield Claim(f"line at {f / 1e6:g} MHz under the strongest", measured, near(stated, within=0.1, unit="dB"))
    sessions = lab.map(one_session)
    error = np.sqrt(np.mean([s["error"] ** 2 for s in sessions], axis=0))
    stated_error = np.sqrt(np.mean([s["stated"] ** 2 for s in sessions], axis=0))
    yield Claim("relative error of emulated LTE channels of 6 … 100 RB (18 MHz)", error, at_most(1e-3))
    edge = np.array([s["edge"] for s in sessions])
    yield Claim("nulls at ±10 MHz are named", edge[:, 1].min(), condition("always", lambda m: m == (1.0,)))
    yield Claim("a full 20 MHz is said not to be covered", edge[:, 2].max(), condition("always", lambda m: m == (0.0,)))
    yield Claim("its stated sigma at 10 MHz over the middle's", edge[:, 0].min(), above(10.0))
    pooled = {name: float(np.mean([s[name] for s in sessions])) for name in sessions[0] if sessions[0][name].ndim == 0}
    yield Claim("stepped tone: relative error of magnitudes", pooled["magnitude"], at_most(5e-3))
    yield Claim("stepped tone: phases agree between places under one lock", pooled["across_places"], at_least(0.99))
    yield Claim("stepped tone: phases agree from tone to tone", pooled["across_tones"], at_most(0.3))
    yield Claim("with a reference channel: relative error of complex gains", pooled["with_reference"], at_most(6e-3))
    yield Claim(
        "two oscillators instead of one: what 0.2 s of averages leave of the lines", pooled["lost"], at_most(0.8)
    )
    difference, same = replay(lab.seeds[0], lab)
    yield Claim("LTE samples replayed over the saved record: relative error in their band", difference, at_most(3e-3))
    yield Claim("the file gives the record back bit by bit", same, condition("always", lambda m: m == (1.0,)))
    with lab.figure(10.4, 7.4) as figure:
        _draw(figure, simulation.ChannelSounder(), lab.seeds[0], error, stated_error)
    lab.save(
        n_rb=RESOURCE_BLOCKS,
        error=error,
        stated=stated_error,
        line_hz=pulse.line_hz,
        line_db=20.0 * np.log10(np.maximum(np.abs(pulse.lines), 1e-18) / np.abs(pulse.lines).max()),
        sessions=np.array([s["error"] for s in sessions]),
    )
