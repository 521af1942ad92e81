"""What one end has to say when it is done: a table, numbers for a program, a track as CSV, a figure."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp._drawing import _COLOURS, _INK, _PALE, _figure, _save, _style, ellipse_points
from soopnav_cpp.geometry import LocalFrame, ecef_to_geodetic
from soopnav_cpp.peer.roles import Anchor, Target
from soopnav_cpp.peer.session import Traffic
from soopnav_cpp.peer.sources import iso

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["estimate", "figure", "summary", "write"]

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0
_DOUBT_SIGMAS = 3.5
_ORDER = ("scanned", "announced", "proposed", "exchanged", "measured", "used", "waiting")
_COLUMNS = (
    "utc", "t_s", "beacon", "tdoa_s", "sigma_tdoa_s", "fdoa_hz", "sigma_fdoa_hz", "bits", "snr_db", "use",
    "latitude_deg", "longitude_deg", "height_m", "sigma_east_m", "sigma_north_m", "sigma_up_m",
    "clock_offset_s", "sigma_clock_offset_s", "clock_skew", "sigma_clock_skew",
)  # fmt: skip


def _frame(p_e: _Array) -> tuple[LocalFrame, _Array]:
    """The local axes at a place, and its latitude, longitude [rad] and height."""
    place = np.ravel(np.asarray(ecef_to_geodetic(p_e), np.float64))
    return LocalFrame(*(float(x) for x in place)), place


def _local(frame: LocalFrame, covariance: _Array) -> _Array:
    origin = np.asarray(frame.position_to_ecef(np.zeros(3)))
    axes = np.asarray(frame.position_to_ecef(np.eye(3))) - origin  # rows: east, north, up in ECEF
    return np.asarray(axes @ covariance[:3, :3] @ axes.T)


def estimate(target: Target) -> dict[str, Any] | None:
    """Where the target is at the end; None when it does not know."""
    tracker = target.track.tracker
    if not target.track.running:
        return None
    mean, covariance = tracker.mean, tracker.covariance
    frame, place = _frame(mean[:3])
    local = _local(frame, covariance)
    sigma = np.sqrt(np.diag(local))
    reference = target.beacons.reference_unix_s
    whole = math.floor(reference)
    return {
        "utc": iso(whole, tracker.t_s + (reference - whole)),
        "latitude_deg": math.degrees(place[0]),
        "longitude_deg": math.degrees(place[1]),
        "height_m": float(place[2]),
        "sigma_east_m": float(sigma[0]),
        "sigma_north_m": float(sigma[1]),
        "sigma_up_m": float(sigma[2]),
        "sigmas_off_guess": _off_guess(target),
        "position_e_m": mean[:3].tolist(),
        "velocity_e_mps": mean[3:6].tolist(),
        "position_covariance_m2": covariance[:3, :3].tolist(),
        "clock_offset_s": float(mean[6] / _LIGHT_MPS),
        "sigma_clock_offset_s": float(math.sqrt(covariance[6, 6]) / _LIGHT_MPS),
        "clock_skew": float(mean[7] / _LIGHT_MPS),
        "sigma_clock_skew": float(math.sqrt(covariance[7, 7]) / _LIGHT_MPS),
    }


def _off_guess(target: Target) -> float:
    """How far the end is from where the target was said to be, in standard deviations of the difference."""
    track = target.track
    off = track.tracker.mean[:3] - track.guess_e_m
    spread = track.tracker.covariance[:3, :3] + track.within_m**2 * np.eye(3)
    return float(math.sqrt(off @ np.linalg.solve(spread, off)))


def summary(end: Anchor | Target, traffic: Traffic) -> dict[str, Any]:
    """Counts, refusals, bytes, and at a target the estimate."""
    counts = {name: end.counts[name] for name in _ORDER if end.counts[name] or name in _ORDER[:4]}
    said = {name: n for name, n in sorted(end.counts.items()) if name not in _ORDER and n}
    numbers: dict[str, Any] = {
        "role": end.role,
        "source": end.source.name,
        "heard_to": iso(end.source.reference_unix_s, end.heard_to_s),
        "counts": counts,
        "reasons": said,
        "refused": {name: n for name, n in sorted(traffic.refused.items()) if n},
        "sessions": traffic.sessions,
        "sessions_lost": traffic.lost,
        "attempts_failed": traffic.attempts,
        "sent_bytes": traffic.sent_bytes,
        "received_bytes": traffic.received_bytes,
        "samples_not_finite": end.source.not_finite,
    }
    if isinstance(end, Target):
        numbers["estimate"] = found = estimate(end)
        if found is not None and found["sigmas_off_guess"] > _DOUBT_SIGMAS:
            said["doubtful: the end is far from --at, are the recordings swapped?"] = 1
    return numbers


def _rows(target: Target) -> list[list[str]]:
    h = target.track.history
    reference = target.beacons.reference_unix_s
    whole = math.floor(reference)
    rows = []
    for m, use, mean, covariance in zip(h.measured, h.use, h.mean, h.covariance, strict=True):
        sigma = np.sqrt(np.diag(m.covariance))
        row = [iso(whole, m.t_s + (reference - whole)), f"{m.t_s:.9f}", target.beacons.names[m.beacon]]
        row += [f"{m.tdoa_s:.12e}", f"{sigma[0]:.3e}", f"{m.fdoa_hz:.6f}", f"{sigma[1]:.6f}", str(m.bits)]
        row += [f"{m.snr_db:.2f}", use]
        if np.isfinite(mean).all():
            frame, place = _frame(mean[:3])
            spread = np.sqrt(np.diag(_local(frame, covariance)))
            clock = np.sqrt(np.diag(covariance)[6:8]) / _LIGHT_MPS
            row += [f"{math.degrees(place[0]):.9f}", f"{math.degrees(place[1]):.9f}", f"{place[2]:.3f}"]
            row += [f"{s:.4f}" for s in spread]
            row += [f"{mean[6] / _LIGHT_MPS:.12e}", f"{clock[0]:.3e}", f"{mean[7] / _LIGHT_MPS:.9e}", f"{clock[1]:.3e}"]
        else:
            row += [""] * 10
        rows.append(row)
    return rows


def figure(target: Target, *, path: Path | None = None) -> Figure:
    """Track with 95 % ellipses, its error ellipse over time, and how far each measurement was from what was expected.

    Parameters
    ----------
    target : Target
    path : Path, optional
        Written there as well.
    """
    h = target.track.history
    known = [i for i, mean in enumerate(h.mean) if np.isfinite(mean).all()]
    canvas = _figure(10.0, 6.4)
    grid = canvas.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    track, spread, steps = (
        canvas.add_subplot(grid[:, 0]),
        canvas.add_subplot(grid[0, 1]),
        canvas.add_subplot(grid[1, 1]),
    )
    _style(track, "Track of the target", "east [m]", "north [m]")
    _style(spread, "What it says of its error", "time [s]", "95 % ellipse, semi-axes [m]")
    _style(steps, "Measured less expected", "time [s]", "standard deviations")
    if not known:
        track.text(0.5, 0.5, "no estimate", transform=track.transAxes, ha="center", color=_INK)
        return _save(canvas, path)
    t = np.array([h.measured[i].t_s for i in known])
    t0 = target.source.start_s + target.source.reference_unix_s - target.beacons.reference_unix_s
    end = h.mean[known[-1]][:3]
    frame, place = _frame(end)
    where = np.asarray(frame.position_from_ecef(np.array([h.mean[i][:3] for i in known])))
    local = [_local(frame, h.covariance[i])[:2, :2] for i in known]
    ellipses = [estimation.error_ellipse(P, probability=0.95) for P in local]
    half = len(known) // 2
    track.plot(where[:, 0], where[:, 1], ".-", color=_COLOURS[0], linewidth=0.8, markersize=3, label="estimates")
    for number, label in ((half, "95 %, half way"), (-1, "95 %, at the end")):
        points = ellipse_points(ellipses[number]) + where[number, :2]
        track.plot(points[:, 0], points[:, 1], color=_COLOURS[4 if number == half else 1], linewidth=1.4, label=label)
    track.plot(0.0, 0.0, "o", color=_COLOURS[1], markersize=5)
    reach = 1.15 * max(ellipses[half].semi_major_m + float(np.hypot(*where[half, :2])), ellipses[-1].semi_major_m, 1e-3)
    track.set_xlim(-reach, reach)
    track.set_ylim(-reach, reach)
    track.set_aspect("equal")
    track.legend(fontsize=8, loc="upper right", frameon=False)
    track.set_title(
        f"Track of the target, about {math.degrees(place[0]):.5f}° {math.degrees(place[1]):.5f}°",
        loc="left", fontsize=10.5, fontweight="bold", color=_INK,
    )  # fmt: skip
    spread.semilogy(t - t0, [e.semi_major_m for e in ellipses], color=_COLOURS[0], label="major")
    spread.semilogy(t - t0, [e.semi_minor_m for e in ellipses], color=_COLOURS[2], label="minor")
    spread.legend(fontsize=8, frameon=False)
    all_t = np.array([m.t_s for m in h.measured]) - t0
    normal = np.array(h.innovation) / np.array(h.innovation_sigma)
    steps.axhspan(-3.0, 3.0, color=_PALE, alpha=0.35, linewidth=0)
    for column, (name, colour) in enumerate((("TDOA", _COLOURS[0]), ("FDOA", _COLOURS[4]))):
        steps.plot(all_t, np.clip(normal[:, column], -6.0, 6.0), ".", color=colour, markersize=4, label=name)
    steps.set_ylim(-6.2, 6.2)
    steps.legend(fontsize=8, frameon=False, ncols=2, loc="lower right")
    return _save(canvas, path)


def write(end: Anchor | Target, traffic: Traffic, folder: Path) -> dict[str, Any]:
    """Write metrics.json, and at a target track.csv and track.png; returns what is in metrics.json."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = summary(end, traffic)
    text = json.dumps(numbers, indent=2, allow_nan=False) + "\n"
    (folder / "metrics.json").write_text(text, encoding="utf-8")
    if isinstance(end, Target):
        with (folder / "track.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(_COLUMNS)
            writer.writerows(_rows(end))
        figure(end, path=folder / "track.png")
    return numbers
