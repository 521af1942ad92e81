"""Super-resolution of closely spaced paths (nielsen's phase II): first arrivals nearer than the bandwidth resolves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from soopnav_cpp import lte
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style

Array = npt.NDArray[np.float64]

SPEED_OF_LIGHT_MPS = 299_792_458.0
BANDWIDTH_HZ = 18e6
N_RB, PORTS = 100, 2
RATE_HZ = 30.72e6
BATCH = 25  # channels, or captures, in a run
IQ_BATCH = 4


def comb(cell_id: int) -> npt.NDArray[np.int64]:
    """Frequencies of the reference elements of a cell, both shifts, units of 15 kHz."""
    centred = 3 * np.arange(4 * N_RB) + cell_id % 3 - 6 * N_RB
    return np.asarray(np.where(centred < 0, centred, centred + 1))


def draw(rng: np.random.Generator, two: bool) -> tuple[Array, npt.NDArray[np.complex128]]:
    """Delays [s] and gains (paths, ports): spacing U(0.3, 1)/B, second path -6 ... +6 dB, phases free per port."""
    first = rng.uniform(0.0, 1.5e-6)
    delays = np.array([first, first + rng.uniform(0.3, 1.0) / BANDWIDTH_HZ])
    size = np.array([1.0, 10.0 ** (rng.uniform(-6.0, 6.0) / 20.0)])
    gains = size[:, None] * np.exp(2j * np.pi * rng.uniform(size=(2, PORTS)))
    count = 2 if two else 1
    return delays[:count], gains[:count]


def single_crlb_m(frequencies: npt.NDArray[np.int64], gains: npt.NDArray[np.complex128], variance: float) -> float:
    """Bound of one path's delay, phase free per port [m]."""
    omega = 2 * np.pi * 15e3 * frequencies
    information = 2.0 / variance * np.sum(np.abs(gains) ** 2) * np.sum((omega - omega.mean()) ** 2)
    return float(SPEED_OF_LIGHT_MPS / np.sqrt(information))


def _errors_m(resolver: dict[str, lte.PathResolver], channel: npt.NDArray[np.complex64], f: Array, v: float) -> Array:
    """Delays of the first path by six estimators [m]: ML, first peak, ESPRIT, pencil, ESPRIT over the gap, one path."""
    best = resolver["ml"].resolve(channel, f, v)
    others = [resolver[name].resolve(channel, f, v).delays_s[0] for name in ("esprit", "pencil", "gap")]
    values = [best.toa_s, best.first_peak_s, *others, best.single_path_s]
    return np.array([*values, best.toa_sigma_s, len(best), best.subspace_order])


def channels_run(seed: int, snr_db: float, two: bool) -> Array:
    """`BATCH` channels of one subframe: errors [m], deviation [m], order, order by eigenvalues, bound [m]."""
    rng = np.random.default_rng([seed, round(10.0 * snr_db), int(two)])  # no draw serves two SNRs or two kinds
    order = 2 if two else 1
    resolvers = {
        "ml": lte.PathResolver(),
        "esprit": lte.PathResolver(order=order, polish=False),
        "pencil": lte.PathResolver(order=order, polish=False, subspace="matrix_pencil"),
        "gap": lte.PathResolver(order=order, polish=False, ignore_gap=True),
    }
    variance = 0.5 * 10.0 ** (-snr_db / 10.0)  # two symbols of each element in a subframe
    rows = []
    for _ in range(BATCH):
        f = comb(int(rng.integers(504)))
        delays, gains = draw(rng, two)
        clean = np.einsum("lp,lf->pf", gains, np.exp(-2j * np.pi * 15e3 * np.outer(delays, f)))
        noise = rng.normal(scale=np.sqrt(variance / 2.0), size=(2, PORTS, f.size))
        channel = (clean + noise[0] + 1j * noise[1]).astype(np.complex64)
        out = _errors_m(resolvers, channel, f.astype(np.float64), variance)
        out[:6] = (out[:6] - delays[0]) * SPEED_OF_LIGHT_MPS
        out[6] *= SPEED_OF_LIGHT_MPS
        rows.append([*out, single_crlb_m(f, gains, variance)])
    return np.array(rows)


def samples_run(seed: int, snr_db: float) -> Array:
    """`IQ_BATCH` captures with two taps through synthesis and receiver: errors of ML and first peak [m], deviation."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(IQ_BATCH):
        delays, gains = draw(rng, True)
        base = 20e-6
        # A path with phases of its own on each port is the cell once more: its data are the identity's and the seed's.
        cell_id, cfo_hz = int(rng.integers(504)), float(rng.uniform(-30.0, 30.0))
        cell = [
            lte.CellParameters(
                cell_id=cell_id,
                n_rb=N_RB,
                n_ports=PORTS,
                delay_s=base + float(delay),
                port_gain=[complex(g) for g in gain],
                cfo_hz=cfo_hz,
            )
            for delay, gain in zip(delays, gains, strict=True)
        ]
        iq = lte.synthesize(cell, RATE_HZ, int(1.1e-3 * RATE_HZ), snr_db=snr_db, seed=int(rng.integers(1 << 31)))
        known = lte.Detection(cell_id=cell_id, n_rb=N_RB, n_ports=PORTS, frame_start_s=base)
        paths = lte.resolve_paths(iq, RATE_HZ, known)
        truth = base + delays[0]
        rows.append(
            [paths.toa_s - truth, paths.first_peak_s - truth, paths.toa_sigma_s, len(paths) / SPEED_OF_LIGHT_MPS]
        )
    return np.array(rows) * SPEED_OF_LIGHT_MPS


def rms(x: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


@experiment(
    "nielsen-x3",
    title="Paths closer than the bandwidth resolves",
    source="nielsen, after section 5 (phase II)",
    runs=40,
)
def super_resolution(lab: Lab) -> Iterator[Claim]:
    """Two paths within a resolution cell, one alone, and the same through samples."""
    snrs = (10.0, 20.0)
    two = {snr: np.concatenate(lab.map(channels_run, snr, True)) for snr in snrs}
    one = {snr: np.concatenate(lab.map(channels_run, snr, False)) for snr in snrs}
    samples = np.concatenate(lab.map(samples_run, 15.0))
    pooled = np.concatenate(list(two.values()))
    single = np.concatenate(list(one.values()))
    ratio = rms(pooled[:, 0]) / rms(pooled[:, 1])
    yield Claim(
        "first path of two, spacing U(0.3, 1)/B, one 100-RB subframe at 10 and 20 dB: RMS over that of the first peak",
        ratio,
        at_most(1.0 / 3.0),
    )
    yield Claim(
        "the same at 10 dB and at 20 dB alone",
        [rms(two[snr][:, 0]) / rms(two[snr][:, 1]) for snr in snrs],
        at_most(1.0 / 3.0),
    )
    yield Claim(
        "its squared error over the bound's variance (other delays and all amplitudes unknown), mean",
        np.mean(np.square(pooled[:, 0] / pooled[:, 6])),
        band(0.8, 1.25),
    )
    yield Claim("share of two-path channels resolved as two", np.mean(pooled[:, 7] == 2), at_least(0.99))
    yield Claim("share of single paths taken for two", np.mean(single[:, 7] != 1), at_most(0.01))
    decibel = 20.0 * np.log10(rms(single[:, 0] / single[:, 9]))
    yield Claim("single path: RMS over the Cramér-Rao bound, 2000 runs", decibel, band(-1.0, 1.0, unit="dB"))
    half = [float(np.median(np.abs(pooled[:, column]))) for column in range(6)]
    yield Claim(
        "ESPRIT that takes the comb for uniform across the carrier, over ESPRIT with the gap: median error",
        half[4] / half[2],
        at_least(1.5),
    )
    yield Claim(
        "ESPRIT and matrix pencil with the gap, unpolished, over the first peak: median error",
        [half[2] / half[1], half[3] / half[1]],
        at_most(0.5),
    )
    yield Claim("polished over ESPRIT with the gap: median error", half[0] / half[2], at_most(0.9))
    yield Claim(
        "through samples with two taps (15 dB): RMS over that of the first peak",
        rms(samples[:, 0]) / rms(samples[:, 1]),
        at_most(1.0 / 3.0),
    )

    # One channel to look at: two paths half a cell apart.
    rng = lab.rng("example")
    f = comb(1)
    delays = np.array([0.0, 0.5 / BANDWIDTH_HZ]) + 1.2e-6
    gains = np.exp(2j * np.pi * rng.uniform(size=(2, PORTS))) * np.array([[0.7], [1.0]])
    gains[1] = gains[0] / 0.7 * np.exp(1j * np.array([0.6, 1.9]))
    clean = np.einsum("lp,lf->pf", gains, np.exp(-2j * np.pi * 15e3 * np.outer(delays, f)))
    noise = rng.normal(scale=np.sqrt(0.5 * 10**-1.5 / 2.0), size=(2, PORTS, f.size))
    channel = (clean + noise[0] + 1j * noise[1]).astype(np.complex64)
    at = delays[0] + np.linspace(-0.12e-6, 0.18e-6, 601)
    resolver = lte.PathResolver(order=2)
    found = resolver.resolve(channel, f, 0.5 * 10**-1.5)
    gap = lte.PathResolver(order=2, ignore_gap=True, polish=False)
    biased = gap.resolve(channel, f, 0.5 * 10**-1.5)
    response, music = resolver.impulse_response(at), resolver.music(at)

    with lab.figure(10.6, 4.4) as figure:
        left = figure.add_subplot(1, 2, 1)
        style(left, "Two paths half a cell apart, 15 dB", "delay after the first path [m]", "relative [dB]")
        metres = (at - delays[0]) * SPEED_OF_LIGHT_MPS
        left.plot(metres, 20 * np.log10(response / response.max()), color="#8a949c", label="impulse response")
        left.plot(metres, 10 * np.log10(music / music.max()), color="#1b6ca8", label="MUSIC")
        for i, delay in enumerate(delays):
            left.axvline(
                (delay - delays[0]) * SPEED_OF_LIGHT_MPS,
                color="#22303c",
                lw=0.8,
                ls=(0, (4, 3)),
                label="truth" if i == 0 else None,
            )
        left.plot(
            (found.delays_s - delays[0]) * SPEED_OF_LIGHT_MPS,
            [2.0] * len(found),
            "v",
            color="#2a9d5c",
            label="polished",
        )
        left.plot(
            (biased.delays_s - delays[0]) * SPEED_OF_LIGHT_MPS,
            [5.0] * len(biased),
            "x",
            color="#d1495b",
            label="ESPRIT, gap ignored",
        )
        left.set_ylim(-45, 8)
        left.legend(frameon=False, fontsize=8.5, loc="lower right")
        right = figure.add_subplot(1, 2, 2)
        style(right, "Error of the first path, 10 and 20 dB together", "|error| [m]", "share of runs below")
        names = ("polished (ML)", "first peak", "ESPRIT", "matrix pencil", "ESPRIT, gap ignored", "one path assumed")
        colours = ("#2a9d5c", "#8a949c", "#1b6ca8", "#e3a018", "#d1495b", "#6f4e9c")
        share = (np.arange(len(pooled)) + 0.5) / len(pooled)
        for column, (name, colour) in enumerate(zip(names, colours, strict=True)):
            right.semilogx(
                np.sort(np.abs(pooled[:, column])), share, color=colour, label=f"{name}: {half[column]:.2f} m"
            )
        right.set_xlim(2e-5, 30.0)
        right.legend(frameon=False, fontsize=8.5, loc="upper left", title="median", title_fontsize=8.5)
    lab.save(
        two_10=two[10.0], two_20=two[20.0], one_10=one[10.0], one_20=one[20.0], samples=samples, music=music, at=at
    )
