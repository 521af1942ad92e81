"""A target that stands still: found from bursts alone, and tracked (mei, Localizing static receiver 1 and 2)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry
from soopnav_cpp.experiments.mei_setup import (
    CANBERRA,
    SIGMAS_BOUND,
    SIGMAS_PAPER,
    TCXO,
    Campaign,
    Setup,
    campaign,
)
from soopnav_cpp.experiments.registry import (
    Claim,
    Lab,
    above,
    at_least,
    band,
    below,
    experiment,
    style,
)
from soopnav_cpp.navigation import CooperativeRun, CooperativeTracker, PairBursts, PairStart, expected_pair

__all__ = ["Found", "bursts_of", "locate", "tracker_of", "truth_of"]

Array = npt.NDArray[np.float64]
Mode = Literal["iq", "drawn"]

BATCH_S = 90.0
RUNS = 100
GUESS_M = 50e3
SEEN = [0, 1, 2, 6, 7]  # position, theta, alpha: the velocity is known, not estimated
BLUE, RED, GREY, GREEN = "#1b6ca8", "#d1495b", "#5c677d", "#2e933c"
LIGHT_MPS = 299_792_458.0
GRID_S = np.arange(BATCH_S + 5.0, 300.0, 5.0)


def bursts_of(found: Campaign) -> PairBursts:
    """A campaign's measurements as the tracker takes them."""
    return PairBursts(
        found.t_s,
        found.beacon,
        found.tdoa_s,
        found.fdoa_hz,
        found.covariance,
        np.array(found.world.carrier_hz),
        found.world.anchor_p_e,
    )


def truth_of(found: Campaign) -> Array:
    """Position, velocity, theta and alpha as they are at each measured burst, shape (n, 8)."""
    world, row = found.world, found.row
    clocks = np.column_stack([world.theta_m[row], world.alpha_mps[row]])
    return np.hstack([world.position_e_m[row], world.velocity_e_mps[row], clocks])


def tracker_of(found: Campaign, **options: Any) -> CooperativeTracker:
    """A tracker that knows the clocks' kind, the height as it was told, and that the target stands."""
    setup = found.world.setup
    return CooperativeTracker(
        found.world.beacons,
        target_clock=setup.clock,
        anchor_clock=setup.clock,
        height_m=found.world.height_m,
        height_sigma_m=setup.height_sigma_m,
        mask_rad=setup.mask_rad - math.radians(1.0),
        **options,
    )


def guess(found: Campaign, off_m: float, seed: int) -> Array:
    """A place on the ellipsoid `off_m` from the target, in a random direction."""
    azimuth = np.random.default_rng([seed, 0x6D65_6910]).uniform(0.0, 2.0 * math.pi)
    latitude, longitude, _ = geometry.ecef_to_geodetic(found.world.position_e_m[0])
    angle = off_m / 6.371e6
    end = math.asin(math.sin(latitude) * math.cos(angle) + math.cos(latitude) * math.sin(angle) * math.cos(azimuth))
    east = math.atan2(
        math.sin(azimuth) * math.sin(angle) * math.cos(latitude),
        math.cos(angle) - math.sin(latitude) * math.sin(end),
    )
    place: Array = geometry.geodetic_to_ecef(end, float(longitude) + east, found.world.height_m)
    return place


@dataclass(frozen=True)
class Found:
    """What became of one campaign.

    Attributes
    ----------
    ok : bool
        One place fits, and it is known within kilometres.
    start_error_m, start_nees : float
        After the batch; NEES of position, theta and alpha.
    error_m, sigma_m : ndarray
        Horizontal, over `GRID_S`, the last one at the end; NaN before the start.
    nees : float
        At the end, of position, theta and alpha.
    lost : float
        Share of bursts that were refused after the batch.
    plain_error_m, plain_nees : float
        Of an extended Kalman filter that starts at the guess, at the end; NaN when not run.
    scatter : ndarray, shape (n, 2)
        Errors of TDOA and FDOA in their stated sigmas.
    """

    ok: bool
    start_error_m: float
    start_nees: float
    error_m: Array
    sigma_m: Array
    nees: float
    lost: float
    plain_error_m: float
    plain_nees: float
    scatter: Array


def nees_of(mean: Array, covariance: Array, truth: Array) -> float:
    """Squared error of position, theta and alpha in their covariance."""
    error = (mean - truth)[SEEN]
    return float(error @ np.linalg.solve(covariance[np.ix_(SEEN, SEEN)], error))


def horizontal(mean: Array, covariance: Array, truth_e_m: Array) -> tuple[Array, Array]:
    """Error and stated sigma along the ground of one estimate, as arrays of one number."""
    latitude, longitude, _ = (float(x) for x in geometry.ecef_to_geodetic(truth_e_m))
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    up = np.array(
        [math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)]
    )
    axes = np.array([east, np.cross(up, east)])
    error = axes @ (mean[:3] - truth_e_m)
    return np.array([np.linalg.norm(error)]), np.array([math.sqrt(np.trace(axes @ covariance[:3, :3] @ axes.T))])


def begin(found: Campaign, seed: int, off_m: float | None) -> tuple[CooperativeTracker, PairStart, PairBursts]:
    """A batch start: from a guess so far off, searched to twice that, or from the grid without any.

    Bursts are gathered for 90 s, and on until one place fits: one satellite alone leaves its mirror across the track.
    """
    bursts, tracker = bursts_of(found), tracker_of(found)
    search: dict[str, object] = {}
    if off_m is not None:
        search = {
            "guess_e_m": guess(found, off_m, seed),
            "search_radius_m": 2.0 * off_m,
            "cell_m": min(off_m, 200e3),
        }
    until = BATCH_S
    while True:
        start = tracker.start(bursts[bursts.t_s < until], **search)
        if start.ok or until >= bursts.t_s[-1]:
            return tracker, start, bursts[bursts.t_s >= until]
        until += 30.0


def plain_filter(found: Campaign, seed: int, off_m: float) -> CooperativeRun:
    """An extended Kalman filter from a guess, which knows how far off that may be; clocks from the first burst."""
    bursts = bursts_of(found)
    tracker = tracker_of(found, gate_probability=0.0)
    mean = np.zeros(8)
    mean[:3] = guess(found, off_m, seed)
    tdoa, fdoa = expected_pair(found.world.beacons, bursts[:1], mean)
    mean[6] = LIGHT_MPS * (bursts.tdoa_s[0] - tdoa[0])
    mean[7] = -LIGHT_MPS / found.world.carrier_hz * (bursts.fdoa_hz[0] - fdoa[0])
    sigma = np.array([off_m] * 3 + [1e-3] * 3 + [off_m, 5e-3 * off_m])
    tracker.start_at(float(bursts.t_s[0]), mean, np.diag(sigma**2))
    return tracker.run(bursts[1:])


def locate(seed: int, setup: Setup, mode: Mode, sigmas: tuple[float, float], plain: bool = False) -> Found:
    """One campaign: batch from 50 km off, then burst by burst to the end."""
    found = campaign(setup, seed, mode=mode, sigmas=sigmas)
    truth = truth_of(found)
    tracker, start, rest = begin(found, seed, GUESS_M)
    last = len(found) - len(rest) - 1
    run = tracker.run(rest)
    # Bursts of the start are used up: where it took them all, its own mean and covariance are the end.
    mean = run.mean[-1] if len(rest) else start.mean
    covariance = run.covariance[-1] if len(rest) else start.covariance
    if len(rest):
        error = np.linalg.norm(run.error_enu_m(truth[0, :3])[:, :2], axis=1)
        sigma = run.horizontal_sigma_m
        at = np.searchsorted(run.t_s, np.append(GRID_S, np.inf)) - 1
        begun = np.where(at < 0, math.nan, 1.0)
    else:
        error, sigma = horizontal(mean, covariance, truth[0, :3])
        at = np.zeros(len(GRID_S) + 1, np.int64)
        begun = np.append(np.full(len(GRID_S), math.nan), 1.0)
    worst, wrong = math.nan, math.nan
    if plain:
        other = plain_filter(found, seed, GUESS_M)
        worst = float(np.linalg.norm(other.error_enu_m(truth[0, :3])[-1, :2]))
        wrong = nees_of(other.mean[-1], other.covariance[-1], truth[-1])
    stated = np.sqrt(np.stack([found.covariance[:, 0, 0], found.covariance[:, 1, 1]], axis=1))
    return Found(
        ok=start.ok,
        start_error_m=float(np.linalg.norm(start.mean[:3] - truth[0, :3])),
        start_nees=nees_of(start.mean, start.covariance, truth[last]),
        error_m=begun * error[at],
        sigma_m=begun * sigma[at],
        nees=nees_of(mean, covariance, truth[-1]),
        lost=1.0 - float(np.mean(run.accepted)) if len(rest) else 0.0,
        plain_error_m=worst,
        plain_nees=wrong,
        scatter=np.column_stack([found.tdoa_error_s, found.fdoa_error_hz]) / stated,
    )


def begun(seed: int, setup: Setup, sigmas: tuple[float, float], off_m: float | None) -> tuple[float, float]:
    """Error of a start [m], and its NEES of five states; infinite when nothing was found."""
    found = campaign(setup, seed, mode="drawn", sigmas=sigmas)
    tracker, start, rest = begin(found, seed, off_m)
    if not tracker.started:
        return math.inf, math.inf
    truth = truth_of(found)[len(found) - len(rest) - 1]
    return float(np.linalg.norm((start.mean - truth)[:3])), nees_of(start.mean, start.covariance, truth)


def rms(values: Sequence[float] | Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def example(seed: int) -> tuple[Campaign, CooperativeRun]:
    """The campaign that is drawn: tracked from the grid on."""
    found = campaign(Setup(), seed)
    tracker, _, rest = begin(found, seed, None)
    return found, tracker.run(rest)


def draw_example(lab: Lab, found: Campaign, run: CooperativeRun) -> None:
    """Clock parameters over time, and the way of the estimate."""
    truth = truth_of(found)[-len(run.t_s) :]
    sigma = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2))
    with lab.figure(9.6, 4.6, part="track") as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
        for row, (state, name, unit, scale) in enumerate(
            ((6, "clock offset θ", "µs", 1e6 / LIGHT_MPS), (7, "clock skew α", "ppb", 1e9 / LIGHT_MPS))
        ):
            axes = figure.add_subplot(grid[row, 0])
            error = scale * (run.mean[:, state] - truth[:, state])
            band_ = scale * sigma[:, state]
            axes.fill_between(run.t_s, -2.0 * band_, 2.0 * band_, color=BLUE, alpha=0.15, lw=0, label="±2σ")
            axes.plot(run.t_s, error, color=BLUE, lw=1.2, label="error")
            axes.axhline(0.0, color=GREY, lw=0.6)
            axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
            value = scale * truth[-1, state]
            style(axes, f"Error of the {name} (it ends at {value:.4g} {unit})", "time [s]" if row else "", f"[{unit}]")
        axes = figure.add_subplot(grid[:, 1])
        way = run.error_enu_m(truth[0, :3])[:, :2]
        axes.plot(way[:, 0], way[:, 1], color=BLUE, lw=1.0, label="estimate")
        axes.plot(*way[0], "o", ms=5, color=BLUE, mfc="white", label=f"after the batch, {BATCH_S:.0f} s")
        axes.plot(*way[-1], "o", ms=5, color=BLUE, label="at the end, 300 s")
        axes.plot(0.0, 0.0, "+", ms=12, mew=2, color=RED, label="truth")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.15)
        axes.legend(fontsize=8, frameon=False)
        style(axes, "The target's place", "east [m]", "north [m]")


def draw_runs(lab: Lab, runs: Sequence[Found]) -> None:
    """Error over time against its prediction, and what the bursts' errors look like."""
    t = np.append(GRID_S, 300.0)
    error, sigma = np.array([r.error_m for r in runs]), np.array([r.sigma_m for r in runs])
    with lab.figure(9.6, 4.2) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        left.plot(t, error.T, color=GREY, lw=0.4, alpha=0.35)
        left.plot([], [], color=GREY, lw=0.8, label="each run")
        left.plot(t, np.sqrt(np.nanmean(error**2, axis=0)), color=BLUE, lw=2.0, label=f"RMSE of {len(runs)} runs")
        left.plot(t, np.sqrt(np.nanmean(sigma**2, axis=0)), "--", color=RED, lw=1.5, label="as the filter predicts it")
        left.axhline(50.0, color=GREEN, lw=1.0, ls=":", label="50 m")
        left.set_yscale("log")
        left.set_ylim(1.0, 500.0)
        left.legend(fontsize=8, frameon=False, loc="lower left")
        style(left, "Horizontal error after the batch start", "time [s]", "[m]")
        scatter = np.concatenate([r.scatter for r in runs])
        edges = np.linspace(-5.0, 5.0, 51)
        for column, (name, colour) in enumerate((("TDOA", BLUE), ("FDOA", RED))):
            right.hist(scatter[:, column], edges, density=True, histtype="step", lw=1.4, color=colour, label=name)
        middle = np.linspace(-5.0, 5.0, 201)
        density = np.exp(-0.5 * middle**2) / math.sqrt(2.0 * math.pi)
        right.plot(middle, density, color=GREY, lw=1.0, ls="--", label="standard normal")
        right.legend(fontsize=8, frameon=False)
        style(right, "Errors of the bursts", "error / stated σ", "density")


@experiment("mei-static", title="A static target and its clock", source="mei, Localizing static receiver", runs=RUNS)
def static(lab: Lab) -> Iterator[Claim]:
    """From the bursts' samples: batch start 50 km off, then one burst a second."""
    setup = Setup()
    runs = lab.map(locate, setup, "iq", SIGMAS_PAPER, True)
    draw_runs(lab, runs)
    draw_example(lab, *example(lab.seeds[0]))
    end = np.array([r.error_m[-1] for r in runs])
    lab.save(
        t_s=np.append(GRID_S, 300.0),
        error_m=[r.error_m for r in runs],
        sigma_m=[r.sigma_m for r in runs],
        nees=[r.nees for r in runs],
        plain_error_m=[r.plain_error_m for r in runs],
        scatter=np.concatenate([r.scatter for r in runs]),
    )
    where = f"Helsinki, OCXO, 10 km apart, bursts of 32.5 ms at -5.4 dB made, sent and measured by CAF, {RUNS} runs"
    yield Claim(f"horizontal RMSE after 5 min; {where}", rms(end), below(50.0, "m"))
    yield Claim("share of runs that end within 200 m", float(np.mean(end < 200.0)), at_least(0.99))
    yield Claim(
        "mean NEES of position, theta and alpha at the end, over its dimension",
        float(np.mean([r.nees for r in runs])) / len(SEEN),
        band(0.7, 1.4),
    )
    yield Claim(
        "a plain extended filter from the same guess: its mean NEES over its dimension, for it looks converged",
        float(np.mean([r.plain_nees for r in runs])) / len(SEEN),
        above(3.0),
    )
    yield Claim(
        "and its RMSE over that of the batch start", rms([r.plain_error_m for r in runs]) / rms(end), above(1.5)
    )


@experiment("mei-static-bound", title="A static target with sigmas of the bound", source="mei, CRLB", runs=4 * RUNS)
def bound(lab: Lab) -> Iterator[Claim]:
    """Measurements drawn from the exact model with the bound's noise for 90 ms at 10 dB."""
    rows = {}
    for name, setup, limit in (
        ("OCXO", Setup(), 5.0),
        ("TCXO", Setup(clock=TCXO), 10.0),
    ):
        runs = lab.map(locate, setup, "drawn", SIGMAS_BOUND)
        rows[name] = runs
        end = [r.error_m[-1] for r in runs]
        yield Claim(f"{name}: horizontal RMSE after 5 min, drawn, {lab.runs} runs", rms(end), below(limit, "m"))
        yield Claim(
            f"{name}: mean NEES over its dimension",
            float(np.mean([r.nees for r in runs])) / len(SEEN),
            band(0.7, 1.4),
        )
    t = np.append(GRID_S, 300.0)
    with lab.figure(7.2, 4.2) as figure:
        axes = figure.subplots()
        for (name, runs), colour in zip(rows.items(), (BLUE, RED), strict=True):
            error, sigma = np.array([r.error_m for r in runs]), np.array([r.sigma_m for r in runs])
            axes.plot(t, np.sqrt(np.nanmean(error**2, axis=0)), color=colour, lw=1.8, label=f"{name}: RMSE")
            axes.plot(t, np.sqrt(np.nanmean(sigma**2, axis=0)), "--", color=colour, lw=1.2, label=f"{name}: predicted")
        axes.set_yscale("log")
        axes.legend(fontsize=8, frameon=False)
        style(axes, f"148 ns and 45 mHz: horizontal RMSE of {lab.runs} runs", "time [s]", "[m]")
    curves: dict[str, npt.ArrayLike] = {
        **{f"error_{name.lower()}_m": [r.error_m for r in runs] for name, runs in rows.items()},
        **{f"sigma_{name.lower()}_m": [r.sigma_m for r in runs] for name, runs in rows.items()},
    }
    lab.save(part="", t_s=t, **curves)


@experiment("mei-static-canberra", title="The paper's town", source="mei, Localizing static receiver", runs=4 * RUNS)
def canberra(lab: Lab) -> Iterator[Claim]:
    """At mid-latitude few satellites are up: a few starts are bound by geometry, and the filter says so."""
    runs = lab.map(locate, Setup(site=CANBERRA), "drawn", SIGMAS_PAPER)
    end = np.array([r.error_m[-1] for r in runs])
    sigma = np.array([r.sigma_m[-1] for r in runs])
    one = np.array([r.ok for r in runs])
    with lab.figure(6.0, 5.0) as figure:
        axes = figure.subplots()
        axes.plot(sigma[one], end[one], ".", ms=4, color=BLUE, alpha=0.6, label="one place fits")
        if not one.all():
            axes.plot(sigma[~one], end[~one], "x", ms=5, color=GREY, label="two places fit to the end, and it is said")
        span = np.array([sigma.min(), sigma.max()])
        axes.plot(span, span, color=RED, lw=1.2, label="error = predicted σ")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.legend(fontsize=8, frameon=False)
        style(axes, f"Canberra after 5 min, {len(end)} starts", "predicted σ, horizontal [m]", "error, horizontal [m]")
    lab.save(error_m=end, sigma_m=sigma, ok=one)
    yield Claim(f"median horizontal error after 5 min, drawn, {len(end)} runs", float(np.median(end)), below(50.0, "m"))
    yield Claim("share of them in which one place fits within 5 min", float(np.mean(one)), at_least(0.95))
    yield Claim(
        "RMS of their errors over their predicted sigmas, each run by its own", rms((end / sigma)[one]), band(0.8, 1.25)
    )


@experiment(
    "mei-static-start", title="Starts from far away", source="mei, initial guess matters (Summary)", runs=2 * RUNS
)
def starts(lab: Lab) -> Iterator[Claim]:
    """Batches of 90 s and more, about a guess and from the whole grid."""
    setup = Setup()
    cases: list[tuple[str, tuple[float, float], float | None, float]] = []
    for name, sigmas in (("paper's sigmas", SIGMAS_PAPER), ("sigmas of the bound", SIGMAS_BOUND)):
        cases += [
            (f"{name}: guess 200 km off", sigmas, 200e3, 1.0),
            (f"{name}: guess 500 km off", sigmas, 500e3, 0.95),
            (f"{name}: no guess, grid over 6000 km", sigmas, None, 1.0),
        ]
    ends = [np.array(lab.map(begun, setup, sigmas, off)) for _, sigmas, off, _ in cases]
    with lab.figure(7.2, 4.2) as figure:
        axes = figure.subplots()
        for row, ((name, _, _, _), end) in enumerate(zip(cases, ends, strict=True)):
            share = (np.arange(len(end)) + 1.0) / len(end)
            line = ("-", "--", ":")[row % 3]
            axes.step(np.sort(end[:, 0]), share, line, where="post", color=(BLUE, RED)[row // 3], lw=1.4, label=name)
        axes.set_xscale("log")
        figure.legend(fontsize=8, frameon=False, loc="outside lower center", ncols=2)
        style(axes, f"{2 * RUNS} starts: the same errors wherever they begin (curves coincide)", "error [m]", "share")
    lab.save(error_m=[end[:, 0] for end in ends], nees=[end[:, 1] for end in ends])
    # NEES of five states: chance passes 45 once in 1e8.
    for (name, _, _, least), end in zip(cases, ends, strict=True):
        converged = float(np.mean(end[:, 1] < 45.0))
        yield Claim(f"{name}: share of {2 * RUNS} starts that converge, drawn", converged, at_least(least))
