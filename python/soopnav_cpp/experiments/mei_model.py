"""One skew in both measurements? Alpha from the TDOA's slope and from the FDOA's offset (mei, model slide)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from soopnav_cpp.clock import TwoState
from soopnav_cpp.experiments.mei_setup import SIGMAS_BOUND, SIGMAS_PAPER, Campaign, Setup, campaign
from soopnav_cpp.experiments.mei_static import BLUE, GREY, LIGHT_MPS, RED, Mode, bursts_of, rms, truth_of
from soopnav_cpp.experiments.registry import Claim, Lab, at_most, band, below, experiment, style
from soopnav_cpp.navigation import expected_pair

Array = npt.NDArray[np.float64]

SKEW = 0.5e-6
RUNS = 24


@dataclass(frozen=True)
class Skews:
    """Alpha / c by two ways, and what may lie between them.

    Attributes
    ----------
    slope, offset : float
        From the TDOA's slope, and from the FDOA's offset.
    sigma : float
        Of their difference: noise of the bursts, and clocks that wander while both are averaged in their own way.
    """

    slope: float
    offset: float
    sigma: float

    @property
    def disagreement(self) -> float:
        """Relative to the skew."""
        return abs(self.slope - self.offset) / abs(self.offset)


def wander(clock: TwoState, t: Array) -> tuple[Array, Array, Array]:
    """Covariances of theta and theta, theta and alpha, alpha and alpha of two such clocks since time 0 (doc eq. 17)."""
    white, walk = (2.0 * density for density in clock.noise)
    first, last = np.minimum.outer(t, t), np.maximum.outer(t, t)
    theta = white * first + walk * first**2 * (last / 2.0 - first / 6.0)
    both = walk * (t[:, None] * first - first**2 / 2.0)
    return theta, both, walk * first


def residuals(found: Campaign) -> tuple[Array, Array, Array]:
    """Times, and what the geometry leaves of TDOA and FDOA: theta [m], alpha [m/s]. Places are known here."""
    bursts, truth = bursts_of(found), truth_of(found)
    mean = np.hstack([truth[:, :6], np.zeros((len(truth), 2))])
    # Alpha also multiplies the light time's difference and the Doppler shift, by parts in 1e5: once more with it.
    alpha = 0.0
    for _ in range(2):
        mean[:, 7] = alpha
        tdoa, fdoa = expected_pair(found.world.beacons, bursts, mean)
        rate = -LIGHT_MPS / found.world.carrier_hz * (bursts.fdoa_hz - fdoa) + alpha
        alpha = float(np.mean(rate))
    return bursts.t_s, LIGHT_MPS * (bursts.tdoa_s - tdoa), rate


def skews(seed: int, setup: Setup, mode: Mode, sigmas: tuple[float, float]) -> Skews:
    """One campaign whose receivers and satellites are where they are known to be."""
    found = campaign(setup, seed, mode=mode, sigmas=sigmas)
    t, theta, alpha = residuals(found)
    light = LIGHT_MPS
    of_tdoa = light * np.sqrt(found.covariance[:, 0, 0])
    of_fdoa = light / found.world.carrier_hz * np.sqrt(found.covariance[:, 1, 1])
    weight = 1.0 / of_tdoa**2
    middle = float(np.average(t, weights=weight))
    a = weight * (t - middle)
    a /= float(a @ (t - middle))
    b = 1.0 / of_fdoa**2
    b /= float(np.sum(b))
    tt, ta, aa = wander(setup.clock, t)
    variance = a @ tt @ a - 2.0 * a @ ta @ b + b @ aa @ b
    variance += float(np.sum((a * of_tdoa) ** 2) + np.sum((b * of_fdoa) ** 2))
    return Skews(float(a @ theta) / light, float(b @ alpha) / light, float(np.sqrt(variance)) / light)


def show(lab: Lab, setup: Setup) -> None:
    """One campaign's residuals against the two skews."""
    found = campaign(setup, lab.seeds[0])
    t, theta, alpha = residuals(found)
    both = skews(lab.seeds[0], setup, "iq", SIGMAS_PAPER)
    with lab.figure(9.6, 4.2) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(t, 1e6 * theta / LIGHT_MPS, ".", ms=2.5, color=BLUE, label="TDOA less geometry")
        line = both.slope * (t - np.mean(t)) + np.mean(theta) / LIGHT_MPS
        left.plot(t, 1e6 * line, color=RED, lw=1.2, label=f"slope {1e9 * both.slope:.2f} ppb")
        left.legend(fontsize=8, frameon=False)
        style(left, "Clock offset θ", "time [s]", "[µs]")
        right.plot(t, 1e9 * alpha / LIGHT_MPS, ".", ms=2.5, color=BLUE, label="FDOA less geometry")
        right.axhline(1e9 * both.offset, color=RED, lw=1.2, label=f"offset {1e9 * both.offset:.2f} ppb")
        right.axhline(1e9 * both.slope, color=GREY, lw=1.0, ls="--", label="slope of the left")
        right.legend(fontsize=8, frameon=False)
        style(right, "Clock skew α", "time [s]", "[ppb]")


@experiment("mei-model", title="One skew in both measurements", source="mei, Measurement model correctness", runs=RUNS)
def model(lab: Lab) -> Iterator[Claim]:
    """Half an hour of bursts from IQ with the paper's sigmas; five minutes with those of the bound."""
    paper, short = Setup(duration_s=1800.0, skew=SKEW), Setup(skew=SKEW)
    show(lab, paper)
    long = lab.map(skews, paper, "iq", SIGMAS_PAPER)
    fine = lab.map(skews, short, "drawn", SIGMAS_BOUND)
    lab.save(
        slope=[s.slope for s in long],
        offset=[s.offset for s in long],
        sigma=[s.sigma for s in long],
        slope_bound=[s.slope for s in fine],
        offset_bound=[s.offset for s in fine],
        sigma_bound=[s.sigma for s in fine],
    )
    for runs, name in (
        (long, "0.5 ppm, OCXO, 1800 s of bursts from IQ with the paper's sigmas"),
        (fine, "0.5 ppm, OCXO, 300 s, drawn with sigmas of the bound"),
    ):
        worst = max(s.disagreement for s in runs)
        yield Claim(f"{name}: worst relative disagreement of {RUNS} runs", worst, at_most(2e-3))
        yield Claim(
            f"{name}: RMS of slope less offset over its predicted sigma",
            rms([(s.slope - s.offset) / s.sigma for s in runs]),
            band(0.45, 1.65),
        )
        # Three sigma, widened so that one of 24 right differences lies outside once in 1e4.
        yield Claim(
            f"{name}: largest difference over its predicted sigma (3, and 4.6 allow for {RUNS} draws)",
            max(abs(s.slope - s.offset) / s.sigma for s in runs),
            below(4.6),
        )
