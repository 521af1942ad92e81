"""How steady a clock is: Allan deviations of a record, a fitted two-state clock, and a figure.

python examples/allan.py                                 a simulated TCXO read with a noisy counter
python examples/allan.py FILE DT_S                       phase [s], one number a line, DT_S seconds apart
python examples/allan.py FILE DT_S NOMINAL_HZ            frequency [Hz] of an oscillator of NOMINAL_HZ
python examples/allan.py FILE DT_S 1                     fractional frequency plus one

Lines that begin with # are comments, nan is a gap. Prints a table, and draws allan.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import soopnav_cpp as sn


def read(path: Path) -> np.ndarray:
    """The numbers of a file, one a line."""
    numbers = []
    for row, line in enumerate(path.read_text().splitlines(), 1):
        text = line.split("#")[0].strip()
        if not text:
            continue
        try:
            numbers.append(float(text))
        except ValueError:
            raise ValueError(f"{path}:{row}: a number expected, got {text!r}") from None
    return np.array(numbers)


def phase_of(frequency: np.ndarray, dt_s: float) -> np.ndarray:
    """Phase of fractional frequencies, less a line; unknown from the first gap on."""
    return np.concatenate([[0.0], np.cumsum(frequency - np.nanmean(frequency)) * dt_s])


def report(record: np.ndarray, dt_s: float, *, frequency: bool, title: str, figure: Path):
    """Deviations and a fit of a record, printed and drawn."""
    overlapping = sn.clock.allan_deviation(record, dt_s, frequency=frequency)
    others = {
        "modified": sn.clock.allan_deviation(record, dt_s, kind="modified", frequency=frequency),
        "Hadamard": sn.clock.allan_deviation(record, dt_s, kind="overlapping_hadamard", frequency=frequency),
    }
    phase_s = phase_of(record, dt_s) if frequency else record
    clock = sn.clock.fit(phase_s, dt_s, phase_noise=True)
    print(f"{title}: {len(record)} values, {dt_s:g} s apart")
    print(f"{'tau [s]':>10s}{'deviation':>12s}{'68 % interval':>24s}{'terms':>9s}{'alpha':>7s}")
    columns = (getattr(overlapping, name) for name in ("tau_s", "deviation", "lower", "upper", "count", "alpha"))
    for tau, deviation, lower, upper, count, alpha in zip(*columns, strict=True):
        print(f"{tau:10g}{deviation:12.3e}{lower:13.2e} …{upper:9.2e}{count:9d}{alpha:7d}")
    print(clock)
    floor = overlapping.deviation.min()
    if np.any(clock.allan_deviation(overlapping.tau_s) > 2.0 * overlapping.upper):
        print(f"flat at {floor:.2g}: flicker, h-1 = {floor**2 / (2.0 * np.log(2.0)):.2g}, which two states do not have")
    draw(overlapping, others, clock, title, figure)
    return overlapping, clock


def draw(overlapping, others, clock, title: str, path: Path) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("no figure: matplotlib is not installed")
        return
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    axes = figure.add_subplot()
    off = np.vstack([overlapping.deviation - overlapping.lower, overlapping.upper - overlapping.deviation])
    axes.errorbar(
        overlapping.tau_s, overlapping.deviation, off, fmt="o", ms=4, capsize=2, color="#22303c", label="Allan"
    )
    for (name, deviations), colour in zip(others.items(), ("#1b6ca8", "#2e933c"), strict=True):
        axes.plot(deviations.tau_s, deviations.deviation, ".-", lw=0.8, ms=4, color=colour, label=name)
    tau = np.geomspace(overlapping.tau_s[0], overlapping.tau_s[-1], 200)
    model = np.sqrt(clock.allan_deviation(tau) ** 2 + 3.0 * (clock.phase_noise_s / tau) ** 2)
    axes.plot(tau, model, color="#d1495b", lw=1.2, label="fit: two states and phase noise")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("averaging time [s]")
    axes.set_ylabel("deviation of fractional frequency")
    axes.set_title(title, loc="left", fontsize=10.5, fontweight="bold")
    axes.grid(True, which="both", linewidth=0.3, alpha=0.6)
    axes.legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=120)


def analyse(path: Path, dt_s: float, *, nominal_hz: float | None = None, figure: Path = Path("allan.png")):
    """Deviations and a fit of a file: phases, or frequencies of an oscillator of `nominal_hz`."""
    record = read(path)
    if nominal_hz is not None:
        record = record / nominal_hz - 1.0
    return report(record, dt_s, frequency=nominal_hz is not None, title=path.name, figure=figure)


def main() -> None:
    if len(sys.argv) > 1:
        if len(sys.argv) not in (3, 4):
            raise SystemExit(__doc__)
        nominal_hz = float(sys.argv[3]) if len(sys.argv) == 4 else None
        analyse(Path(sys.argv[1]), float(sys.argv[2]), nominal_hz=nominal_hz)
        return
    truth, noise_s = sn.clock.TwoState.tcxo(), 1e-10
    phase_s = truth.simulate(0.5, 20_000, seed=1).bias_s + noise_s * np.random.default_rng(1).standard_normal(20_000)
    title = "a simulated TCXO, counter noise 0.1 ns"
    _, clock = report(phase_s, 0.5, frequency=False, title=title, figure=Path("allan.png"))
    print(f"truth: h0 = {truth.h0:g} s, h-2 = {truth.h_minus_2:g} Hz, phase noise {noise_s:g} s")
    assert abs(clock.h0 - truth.h0) < 5.0 * clock.sigma_h0
    assert abs(clock.h_minus_2 - truth.h_minus_2) < 5.0 * clock.sigma_h_minus_2
    assert abs(clock.phase_noise_s / noise_s - 1.0) < 0.1


if __name__ == "__main__":
    main()
