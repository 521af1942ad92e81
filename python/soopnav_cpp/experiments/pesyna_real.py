"""Stage 1 on a recording: real GPS carrier phase from RINEX files (pesyna section V, eq. 4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry, gnss
from soopnav_cpp.clock import TwoState, allan_deviation
from soopnav_cpp.experiments.registry import Claim, Lab, at_least, at_most, band, experiment, style
from soopnav_cpp.gnss import PhaseUse, StaticPhaseFix
from soopnav_cpp.navigation import OpportunisticNavigator

Array = npt.NDArray[np.float64]

LIGHT_MPS = 299_792_458.0
MASK_RAD = np.deg2rad(15.0)
CODE_SIGMA_M, PHASE_SIGMA_M = 1.0, 0.01
RANGE_ERROR_M, RANGE_ERROR_MPS = 1.0, 1.5e-4
# The receiver's oscillator as its record has it: about 1e-10 at 1 s, 2.4e-10 at 100 s.
RECEIVER = TwoState(2e-20, 8e-23)


def part(observed: gnss.Observations, rows: slice, names: tuple[str, ...] = ()) -> gnss.Observations:
    """Some epochs, without some satellites."""
    keep = [i for i, name in enumerate(observed.satellites) if name not in names]
    arrays: dict[str, Any] = {
        name: getattr(observed, name)[rows][:, keep]
        for name in ("code_m", "phase_cycles", "doppler_hz", "cn0_dbhz", "lli")
    }
    return dataclasses.replace(
        observed,
        week=observed.week[rows],
        time_of_week_s=observed.time_of_week_s[rows],
        satellites=tuple(observed.satellites[i] for i in keep),
        **arrays,
    )


def stage_1(fix: StaticPhaseFix, *, correlation_s: float = 100.0) -> tuple[Array, Array, Array, Array]:
    """The receiver's clock, its sigma [s], the position [m] and its covariance by the whole navigator and its smoother.

    Each satellite's broadcast error is its clock's in the state (pesyna eq. 2): a metre, and hardly moving. Errors of
    phase last: their noise counts as the batch has it, or, with `correlation_s` of 0, as white: right for the clock
    from one epoch to the next, overconfident for the position.
    """
    used = np.flatnonzero((fix.use == PhaseUse.USED).any(axis=0))
    take = fix.use[:, used] == PhaseUse.USED
    seen = np.isfinite(fix.clock_m) & take.any(axis=1)
    rows = np.flatnonzero(seen)
    take = take[rows]
    first = fix.clock_m[rows[0]] / LIGHT_MPS
    slope = np.polyfit(fix.t_s[rows], fix.clock_m[rows] / LIGHT_MPS, 1)[0]
    navigator = OpportunisticNavigator(
        np.round(fix.position_m, -1),
        clock=RECEIVER,
        position_sigma_m=100.0,
        clock_bias_s=float(first),
        clock_bias_sigma_s=1e-6,
        clock_drift=float(slope),
        clock_drift_sigma=1e-8,
        max_sources=len(used),
        time_tags="receiver",
        fault_probability=1e-9,
    )
    arcs = fix.arc[rows][:, used]
    columns: list[tuple[int, int]] = []
    for j in range(len(used)):
        columns += [(j, int(a)) for a in np.unique(arcs[take[:, j], j]) if a >= 0]
    if len(columns) != len(used):
        raise RuntimeError("a phase broke within the recording")
    for j, column in enumerate(used):
        at = int(np.flatnonzero(take[:, j])[0])
        guess = fix.phase_m[rows[at], column] - fix.code_m[rows[at], column]
        navigator.add_source(
            fix.satellites[column],
            "gps",
            carrier_hz=gnss.L1_HZ,
            clock=TwoState(1e-28, 1e-34),
            clock_bias_sigma_s=RANGE_ERROR_M / LIGHT_MPS,
            clock_drift_sigma=RANGE_ERROR_MPS / LIGHT_MPS,
            ambiguity_cycles=float(guess / gnss.L1_M),
            ambiguity_sigma_cycles=200.0,
        )
    elevation = np.where(take, fix.elevation_rad[rows][:, used], np.pi / 2.0)
    lasting = np.sqrt(1.0 + 2.0 * correlation_s / np.median(np.diff(fix.t_s)))

    def of(values: Array) -> Array:
        return np.where(take, values[rows][:, used], np.nan)

    clock = of(fix.satellite_clock_m)
    places = np.where(take[..., None], fix.satellite_e_m[rows][:, used], 0.0)
    navigator.run(
        fix.t_s[rows],
        of(fix.phase_m) / gnss.L1_M,
        lasting * PHASE_SIGMA_M / gnss.L1_M / np.sin(elevation),
        pseudorange_m=of(fix.code_m),
        pseudorange_sigma_m=CODE_SIGMA_M / np.sin(elevation),
        phase_correction_m=np.nan_to_num(of(fix.phase_correction_m) - clock),
        range_correction_m=np.nan_to_num(of(fix.code_correction_m) - clock),
        source_position_e_m=places,
        record=True,
    )
    smoothed = navigator.smooth()
    covariance = smoothed.position_covariance_m2
    return smoothed.clock_bias_s, smoothed.clock_bias_sigma_s, smoothed.position_e_m[-1], covariance[-1]


def _nees(position: Array, covariance: Array, reference: Array) -> float:
    error = position - reference
    return float(error @ np.linalg.solve(covariance, error))


@experiment(
    "pesyna-x3",
    title="Stage 1 on a recording: position, residuals and the receiver's clock from real GPS phase",
    source="pesyna section V, eq. (4); GPS L1 and L2 of a standing antenna, 900 s",
    needs="gnss_static",
)
def real_phase(lab: Lab) -> Iterator[Claim]:
    """Nothing is drawn: one recording, its halves and thirds, and each satellite left out."""
    folder = lab.recording()
    lab.step("reading the recording")
    observations = next(iter(sorted(folder.glob("*.[0-9][0-9]O"))))
    navigation = next(iter(sorted(folder.glob("*.[0-9][0-9]P"))))
    l1 = gnss.read_observations(observations)
    l2 = gnss.read_observations(observations, codes={"G": "2W"})
    orbits = gnss.read_navigation(navigation)
    reference = l1.approximate_position_ecef_m
    everything = slice(None)

    def solve(rows: slice = everything, names: tuple[str, ...] = ()) -> StaticPhaseFix:
        return gnss.static_phase(part(l1, rows, names), orbits, part(l2, rows, names), elevation_mask_rad=MASK_RAD)

    whole = solve()
    single = gnss.static_phase(l1, orbits, elevation_mask_rad=MASK_RAD)
    if not whole.ok:
        raise RuntimeError(whole.message())
    used = [n for n, count in zip(whole.satellites, (whole.use == PhaseUse.USED).sum(axis=0), strict=True) if count]
    lab.step("satellites left out, parts of the recording")
    dropped = [solve(names=(name,)) for name in used]
    parts = [solve(slice(k * 300, (k + 1) * 300)) for k in range(3)]
    others = [*dropped, *parts]
    nees = np.array([_nees(f.position_m, f.covariance_m2, reference) for f in others])
    errors = np.array([np.linalg.norm(f.position_m - reference) for f in others])
    formal = _nees(whole.position_m, whole.formal_m2, reference)
    error_m = float(np.linalg.norm(whole.position_m - reference))
    lab.step("the navigator")
    _, _, position, covariance = stage_1(whole)
    clock_s, clock_sigma_s, _, _ = stage_1(whole, correlation_s=0.0)
    navigator_error = float(np.linalg.norm(position - reference))
    dt = float(np.median(np.diff(whole.t_s)))
    deviation = allan_deviation(clock_s, dt, confidence=0.95)
    raw = allan_deviation(whole.clock_m / LIGHT_MPS, dt, confidence=0.95)

    with lab.figure(9.6, 6.4) as figure:
        (top, sky), (allan, scatter) = figure.subplots(2, 2)
        for j, name in enumerate(whole.satellites):
            if name in used:
                top.plot(whole.t_s, 100.0 * whole.phase_residual_m[:, j], lw=0.7, label=name)
        top.legend(fontsize=6, ncols=5, frameon=False, loc="upper center")
        top.set_ylim(-10.0, 13.0)
        style(top, f"Phase residuals, {100.0 * whole.phase_rms_m:.1f} cm rms", "time [s]", "residual [cm]")
        at = np.nanmean(np.where(whole.use == PhaseUse.USED, whole.elevation_rad, np.nan)[:, [
            whole.satellites.index(n) for n in used]], axis=0)  # fmt: skip
        worst = whole.satellite_phase_rms_m()[[whole.satellites.index(n) for n in used]]
        sky.plot(np.rad2deg(at), 100.0 * worst, "o", ms=4, color="tab:blue")
        for x, y, n in zip(np.rad2deg(at), 100.0 * worst, used, strict=True):
            sky.annotate(n, (x, y), textcoords="offset points", xytext=(4, -9 if n in used[1::3] else 3), fontsize=7)
        sky.axhline(3.0, color="tab:red", lw=0.8, ls="--")
        sky.set_ylim(0.0, 3.4)
        style(sky, "By satellite", "mean elevation [deg]", "residual, rms [cm]")
        tau = deviation.tau_s
        allan.fill_between(tau, deviation.lower, deviation.upper, color="tab:blue", alpha=0.2, lw=0.0)
        allan.plot(tau, deviation.deviation, "o-", ms=3, color="tab:blue", label="smoothed, 95 %")
        allan.plot(raw.tau_s, raw.deviation, "s", ms=3, mfc="none", color="0.4", label="each epoch by itself")
        allan.plot(tau, RECEIVER.allan_deviation(tau), "--", color="0.5", lw=0.9, label="model of the filter")
        allan.set_xscale("log")
        allan.set_yscale("log")
        allan.legend(fontsize=7, frameon=False)
        style(allan, "The receiver's clock", "averaging time [s]", "Allan deviation")
        frame = geometry.LocalFrame(*(float(x) for x in geometry.ecef_to_geodetic(reference)))
        for fixes, mark, colour, label in (
            (dropped, "o", "tab:blue", "one satellite left out"),
            (parts, "^", "tab:green", "300 s each"),
            ([single], "D", "0.5", "L1 alone"),
            ([whole], "*", "tab:red", "everything"),
        ):
            enu = np.array([frame.position_from_ecef(f.position_m) for f in fixes])
            scatter.plot(enu[:, 0], enu[:, 2], mark, ms=10 if mark == "*" else 5, color=colour, label=label)
        sigma = np.sqrt(np.diag(whole.covariance_enu_m2))
        centre = frame.position_from_ecef(whole.position_m)
        scatter.errorbar(centre[0], centre[2], sigma[2], sigma[0], color="tab:red", lw=0.8, capsize=2)
        scatter.plot(0.0, 0.0, "k+", ms=12)
        scatter.legend(fontsize=7, frameon=False)
        style(scatter, "Position less the header's", "east [m]", "up [m]")
    lab.save(
        t_s=whole.t_s,
        phase_residual_m=whole.phase_residual_m,
        position_m=whole.position_m,
        covariance_m2=whole.covariance_m2,
        clock_s=clock_s,
        clock_sigma_s=clock_sigma_s,
        tau_s=deviation.tau_s,
        allan=deviation.deviation,
    )
    yield Claim(f"iono-free phase residual of {len(used)} satellites above 15 degrees, rms [m]", whole.phase_rms_m,
                at_most(0.03))  # fmt: skip
    yield Claim("the worst satellite's [m]", float(np.nanmax(worst)), at_most(0.03))
    yield Claim("position less the header's, three dimensions [m]", error_m, at_most(2.5))
    yield Claim("the same through the opportunistic navigator [m]", navigator_error, at_most(2.5))
    # Three coordinates: chi-square of 3 is above 21.1 once in 1e4.
    yield Claim(
        "NEES of the position, by the batch and by the navigator (three degrees of freedom)",
        [_nees(whole.position_m, whole.covariance_m2, reference), _nees(position, covariance, reference)],
        band(0.0, 21.1),
    )
    yield Claim("its sigma, three dimensions [m]: the broadcast's error does not average out", whole.sigma_m,
                band(0.5, 2.0))  # fmt: skip
    yield Claim(
        f"largest NEES of {len(others)} solutions without one satellite or of 300 s; each within 2.5 m of the header",
        [float(nees.max()), 21.1 * float(errors.max()) / 2.5],
        at_most(21.1),
    )
    yield Claim("NEES of the formal covariance, as if the broadcast were exact", formal, at_least(1.5 * 3.0))
    ratio = deviation.deviation / raw.deviation
    yield Claim(
        "Allan deviation of the receiver's clock, 1 to 30 s, smoothed over each epoch's own",
        ratio[deviation.tau_s <= 33.0],
        band(0.8, 1.1),
    )
