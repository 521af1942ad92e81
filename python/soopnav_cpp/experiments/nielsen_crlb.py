"""Bounds of nielsen 3.4.2 and 3.4.3: ranging with 10 MHz, information of one node and of several, BLUE of an angle."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp.experiments.registry import Claim, Lab, condition, experiment, near, style

__all__ = ["blue_angle_sigma_rad", "clock_walk_covariance_cm2", "mean_square_bandwidth", "tone_range_sigma_m"]

Array = npt.NDArray[np.float64]

SPEED_OF_LIGHT_MPS = 299_792_458.0
BANDWIDTH_HZ = 1e7
SPACING_CM = 10.0
POSITIONS = 30
VARIANCE_CM2 = 1000.0
CLOCK_CM = 20.0


def mean_square_bandwidth(low_hz: float, high_hz: float) -> float:
    """Mean of (2πf)² over a flat band [rad²/s²], by Gauss-Legendre quadrature: exact for this polynomial."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    f = 0.5 * (high_hz + low_hz) + 0.5 * (high_hz - low_hz) * nodes
    return float(0.5 * (weights * np.square(2.0 * math.pi * f)).sum())


def tone_range_sigma_m(snr: float, *, known_phase: bool, tones: int = 4001) -> float:
    """Bound of a range from tones of equal power across 0 … 10 MHz, whose common phase is known or not [m].

    ``snr`` is ρ = E / (N0/2): the energy of all tones over the noise variance of a real component. The Jacobian is of
    the tones' real and imaginary parts by the delay and the phase.
    """
    f = BANDWIDTH_HZ * (np.arange(tones) + 0.5) / tones
    amplitude = math.sqrt(snr / tones)  # the noise of each component has variance 1
    delay = -2j * math.pi * f * amplitude / SPEED_OF_LIGHT_MPS  # per metre, at delay zero
    phase = np.full(tones, 1j * amplitude)
    columns = [delay] if known_phase else [delay, phase]
    H = np.stack([np.concatenate([column.real, column.imag]) for column in columns], axis=1)
    return float(estimation.crlb(H, 1.0, names=["range", "phase"][: len(columns)]).sigma[0])


def clock_walk_covariance_cm2(*, as_printed: bool) -> Array:
    """Covariance of N ranges to one node while the oscillator walks 20 cm per step [cm²].

    As printed it is diagonal; a random walk has 20² min(i, j) beside the diagonal as well.
    """
    i = np.arange(POSITIONS)
    walk = np.diag(i) if as_printed else np.minimum.outer(i, i)
    return np.asarray(VARIANCE_CM2 * np.eye(POSITIONS) + CLOCK_CM**2 * walk)


def blue_angle_sigma_rad(C: Array) -> float:
    """σ of the angle of a straight walk, H = (0, d, 2d, ...), from ranges of covariance C [cm²]."""
    H = SPACING_CM * np.arange(len(C), dtype=np.float64)[:, None]
    return float(estimation.crlb(H, C, names=["angle"]).sigma[0])


def _one_node(node_m: tuple[float, float], at_m: tuple[float, float]) -> tuple[Array, tuple[str, ...]]:
    return estimation.track_jacobian("range", [node_m], [at_m], offset=["x", "y"], bias="separate")


@experiment("nielsen-crlb", title="Bounds of ranging, information and BLUE", source="nielsen sections 3.4.2 and 3.4.3")
def bounds(lab: Lab) -> Iterator[Claim]:
    """All numbers of the text that are bounds."""
    printed = SPEED_OF_LIGHT_MPS**2 / mean_square_bandwidth(0.0, BANDWIDTH_HZ)
    centred = SPEED_OF_LIGHT_MPS**2 / mean_square_bandwidth(-0.5 * BANDWIDTH_HZ, 0.5 * BANDWIDTH_HZ)
    closed = 3.0 * (SPEED_OF_LIGHT_MPS / (2.0 * math.pi * BANDWIDTH_HZ)) ** 2
    yield Claim(
        "c²/F of the printed integral, a one-sided band of 10 MHz: 68.30 m²/ρ with ρ = E/(N0/2), not 23",
        printed,
        near(68.30, within=0.005, unit="m²"),
    )
    yield Claim("the integral against its closed form 3 (c/2πB)²", printed / closed, near(1.0, within=1e-12))
    yield Claim("ρ for σ = 1 m: 18.3 dB, not 16", 10.0 * math.log10(printed), near(18.34, within=0.005, unit="dB"))
    yield Claim("c²/F of a centred band of 10 MHz", centred, near(273.2, within=0.05, unit="m²"))
    yield Claim(
        "Fisher information of tones over 0 … 10 MHz, phase known: σ² ρ",
        tone_range_sigma_m(1.0, known_phase=True) ** 2,
        near(68.30, within=0.01, unit="m²"),
    )
    yield Claim(
        "the same with an unknown phase, which leaves the centred band's: σ² ρ",
        tone_range_sigma_m(1.0, known_phase=False) ** 2,
        near(273.2, within=0.05, unit="m²"),
    )

    x, y, sigma = 3.0, 4.0, 2.0
    H, names = _one_node((0.0, 0.0), (x, y))
    one = estimation.crlb(H, sigma**2, names=names)
    r = math.hypot(x, y)
    column = np.array([x / r, y / r, 1.0])
    yield Claim("rank of one node's information about (x, y, b)", one.rank, condition("1", lambda m: m == (1.0,)))
    yield Claim(
        "its largest difference from the printed matrix with x²/r², xy/r², x/r, ... over σ²",
        np.abs(one.information - np.outer(column, column) / sigma**2).max(),
        near(0.0, within=1e-12),
    )
    nodes = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
    ranks: list[int] = []
    ranks_moved: list[int] = []
    for count in range(1, 5):
        for track, into in (([[x, y]], ranks), ([[x, y], [x + 2.0, y + 0.5], [x + 2.5, y - 2.0]], ranks_moved)):
            rows, labels = estimation.track_jacobian("range", nodes[:count], track, offset=["x", "y"], bias="separate")
            into.append(estimation.crlb(rows, sigma**2, names=labels).rank)
    yield Claim(
        "rank for L = 1 … 4 nodes with a bias each, at one place: L, for L + 2 unknowns",
        ranks,
        condition("1, 2, 3, 4", lambda m: m == (1.0, 2.0, 3.0, 4.0)),
    )
    yield Claim(
        "three places of a known walk make it L + 2",
        ranks_moved,
        condition("3, 4, 5, 6", lambda m: m == (3.0, 4.0, 5.0, 6.0)),
    )

    diagonal, walk = clock_walk_covariance_cm2(as_printed=True), clock_walk_covariance_cm2(as_printed=False)
    angle_printed, angle_walk = blue_angle_sigma_rad(diagonal), blue_angle_sigma_rad(walk)
    yield Claim(
        "BLUE of the angle with the printed diagonal covariance, in centimetres: 0.1 rad",
        angle_printed,
        near(0.103, within=0.0005, unit="rad"),
    )
    yield Claim(
        "with the covariance that a random walk has, 20² min(i, j)", angle_walk, near(0.379, within=0.0005, unit="rad")
    )

    decibel = np.linspace(0.0, 40.0, 81)
    snr = 10.0 ** (decibel / 10.0)
    counts = np.arange(2, POSITIONS + 1)
    angles = np.array(
        [[blue_angle_sigma_rad(C[:n, :n]) for n in counts] for C in (diagonal, walk)],
    )
    with lab.figure(10.4, 4.4) as figure:
        axes = figure.add_subplot(1, 2, 1)
        style(axes, "Bound of a range with 10 MHz", "ρ = E/(N$_0$/2) [dB]", "σ [m]")
        for value, label, colour in (
            (printed, "as printed: 0 … 10 MHz", "#1b6ca8"),
            (centred, "centred band, phase unknown", "#d1495b"),
            (23.0, "the text's 23 m²/ρ", "#8a949c"),
        ):
            axes.semilogy(decibel, np.sqrt(value / snr), color=colour, label=label, ls=":" if value == 23.0 else "-")
        axes.axhline(1.0, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        axes.legend(frameon=False, fontsize=8.5)
        axes = figure.add_subplot(1, 2, 2)
        style(axes, "BLUE of the angle of a walk", "ranges to one node, 10 cm apart", "σ [rad]")
        axes.semilogy(counts, angles[0], color="#1b6ca8", label="C as printed, diagonal")
        axes.semilogy(counts, angles[1], color="#d1495b", label="C of a random walk")
        axes.axhline(0.1, color="#22303c", linewidth=0.8, linestyle=(0, (4, 3)))
        axes.legend(frameon=False, fontsize=8.5)
    lab.save(
        snr_db=decibel,
        sigma_printed_m=np.sqrt(printed / snr),
        sigma_centred_m=np.sqrt(centred / snr),
        ranges=counts,
        angle_printed_rad=angles[0],
        angle_walk_rad=angles[1],
    )
