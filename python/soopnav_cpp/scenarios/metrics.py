"""How good runs were: errors against the truth, and whether the stated covariances deserve belief.

`evaluate` turns a run into a `Series`, which is small; `measure` makes the numbers of one series or of many together.
Bounds follow from the number of runs alone. The errors of one run at many times are not independent, so a mean over
time leaves them more rarely than a single epoch would: being outside always means something.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import estimation
from soopnav_cpp.scenarios.base import SystemRun, Updates

__all__ = ["BOUNDS_PROBABILITY", "COVERAGE", "Series", "evaluate", "heading_of", "measure", "series_over_runs"]

Array = npt.NDArray[np.float64]

#: Share of Gaussian errors within 1, 2 and 3 standard deviations.
COVERAGE = tuple(math.erf(k / math.sqrt(2.0)) for k in (1, 2, 3))

#: Probability that a consistent filter stays within the bounds that are reported.
BOUNDS_PROBABILITY = 0.99


@dataclass(frozen=True, eq=False)
class Series:
    """What is kept of every run of a Monte-Carlo. Errors are None without a truth.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
    sigma_m : ndarray, shape (n, d)
        Stated standard deviations of the position.
    error_m, velocity_error_mps : ndarray, shape (n, d), or None
    heading_error_rad : ndarray, shape (n,), or None
    nees, state_nees : ndarray, shape (n,), or None
        Of the position, and of the whole state of `state_dim` components; NaN where the covariance is singular.
    baseline_error_m : dict of str to ndarray, shape (n, d)
    updates : Updates or None
    start_s : float
        Metrics count from here.
    """

    t_s: Array
    sigma_m: Array
    error_m: Array | None
    velocity_error_mps: Array | None
    heading_error_rad: Array | None
    nees: Array | None
    state_nees: Array | None
    state_dim: int
    baseline_error_m: Mapping[str, Array]
    updates: Updates | None
    start_s: float

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Which epochs count."""
        return np.asarray(self.t_s >= self.start_s)


def wrapped(angle_rad: Array) -> Array:
    """The short way round, in [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def heading_of(item: Any) -> Array | None:
    """Heading of a run or a truth, from x towards y: given, or that of the body's x axis. None without either."""
    if item.heading_rad is not None:
        return np.asarray(item.heading_rad)
    if item.quaternion_wxyz is None:
        return None
    w, x, y, z = np.asarray(item.quaternion_wxyz).T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def evaluate(run: SystemRun, *, start_s: float = 0.0) -> Series:
    """Errors of a run at each epoch.

    Raises
    ------
    ValueError
        When no epoch counts.
    """
    if run.t_s[-1] < start_s:
        raise ValueError(f"metrics_start_s = {start_s:g}: the run ends before, at {run.t_s[-1]:g} s")
    truth = run.truth
    sigma = np.sqrt(np.maximum(np.diagonal(run.position_covariance_m2, axis1=1, axis2=2), 0.0))
    error = velocity = heading = nees = state_nees = None
    baselines: dict[str, Array] = {}
    if truth is not None:
        error = run.position_m - truth.position_m
        nees = estimation.nees(error, run.position_covariance_m2)
        if run.velocity_mps is not None and truth.velocity_mps is not None:
            velocity = run.velocity_mps - truth.velocity_mps
        ours, right = heading_of(run), heading_of(truth)
        if ours is not None and right is not None:
            heading = wrapped(ours - right)
        if run.state is not None and run.covariance is not None and truth.state is not None and run.state_names:
            difference = run.state - truth.state
            angles = [i for i, name in enumerate(run.state_names) if name.endswith("_rad")]
            difference[:, angles] = wrapped(difference[:, angles])
            state_nees = estimation.nees(difference, run.covariance)
        baselines = {name: position - truth.position_m for name, position in run.baselines.items()}
    return Series(
        run.t_s,
        sigma,
        error,
        velocity,
        heading,
        nees,
        state_nees,
        len(run.state_names),
        baselines,
        run.updates,
        start_s,
    )


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _stack(series: Sequence[Series], name: str) -> Array | None:
    """The epochs that count, of all runs; None unless every run has the quantity."""
    parts = [getattr(one, name) for one in series]
    if any(part is None for part in parts):
        return None
    return np.concatenate([part[one.counted] for one, part in zip(series, parts, strict=True)])


def _position(series: Sequence[Series], errors: Sequence[Array]) -> dict[str, Any]:
    """Accuracy of the errors of each run."""
    error = np.concatenate([mine[one.counted] for one, mine in zip(series, errors, strict=True)])
    distance = np.linalg.norm(error, axis=1)
    times = np.concatenate([one.t_s[one.counted] for one in series])
    worst = int(np.argmax(distance))
    ends = np.array([np.linalg.norm(mine[-1]) for mine in errors])
    return {
        "rmse_m": _rms(distance),
        "rmse_axes_m": [float(v) for v in estimation.rmse(error)],
        "horizontal_rmse_m": _rms(np.linalg.norm(error[:, :2], axis=1)),
        "cep50_m": estimation.sample_circular_error_m(error[:, :2], probability=0.5),
        "cep95_m": estimation.sample_circular_error_m(error[:, :2], probability=0.95),
        "max_m": float(distance[worst]),
        "max_at_s": float(times[worst]),
        "final_m": _rms(ends),
    }


def _nees(values: Array, dof: int, runs: int) -> dict[str, Any]:
    """Mean over runs and time, with the bounds of a mean over the runs at one time."""
    defined = values[np.isfinite(values)]
    low, high = estimation.mean_nees_bounds(dof, runs, failure_probability=1.0 - BOUNDS_PROBABILITY)
    mean = float(defined.mean()) if defined.size else math.nan
    return {
        "mean": _number(mean),
        "expected": dof,
        "bounds": [low, high],
        "inside": bool(low <= mean <= high),
        "undefined_epochs": int(values.size - defined.size),
    }


def _nis(updates: Sequence[Updates]) -> dict[str, Any]:
    accepted = np.concatenate([u.nis[u.accepted] for u in updates])
    offered = np.concatenate([u.nis[u.offered] for u in updates])
    accepted, offered = accepted[np.isfinite(accepted)], offered[np.isfinite(offered)]
    if not accepted.size:
        return {"mean": None, "expected": 1, "bounds": None, "inside": None, "count": 0, "mean_with_rejected": None}
    bounds = estimation.mean_nees_bounds(1, accepted.size, failure_probability=1.0 - BOUNDS_PROBABILITY)
    mean = float(accepted.mean())
    return {
        "mean": mean,
        "expected": 1,
        "bounds": list(bounds),
        "inside": bool(bounds[0] <= mean <= bounds[1]),
        "count": int(accepted.size),
        "mean_with_rejected": float(offered.mean()),
    }


def _coverage(error: Array, sigma: Array, runs: int) -> dict[str, Any]:
    """Share of errors, axes together, within 1, 2 and 3 stated standard deviations."""
    found = {}
    for k, right in enumerate(COVERAGE, start=1):
        low, high = estimation.coverage_bounds(
            right, runs * error.shape[1], failure_probability=1.0 - BOUNDS_PROBABILITY
        )
        share = float(np.mean(np.abs(error) <= k * sigma))
        found[f"{k}_sigma"] = {
            "share": share,
            "axes": [float(v) for v in np.mean(np.abs(error) <= k * sigma, axis=0)],
            "expected": right,
            "bounds": [low, high],
            "inside": bool(low <= share <= high),
        }
    return found


def _by_source(updates: Sequence[Updates]) -> dict[str, dict[str, Any]]:
    """How many measurements of each source had which status, and the NIS of those that went in."""
    names: dict[str, None] = {name: None for one in updates for name in one.source_names}
    rows: dict[str, dict[str, Any]] = {}
    for name in names:
        counts: dict[str, int] = {}
        nis = []
        for one in updates:
            if name not in one.source_names:
                continue
            mine = one.source == one.source_names.index(name)
            for word, count in zip(*np.unique(one.status[mine], return_counts=True), strict=True):
                counts[str(word)] = counts.get(str(word), 0) + int(count)
            nis.append(one.nis[mine & one.accepted])
        values = np.concatenate(nis)
        values = values[np.isfinite(values)]
        offered = sum(count for word, count in counts.items() if word != "absent")
        rows[name] = {
            "offered": offered,
            "accepted": counts.get("accepted", 0),
            "rejected": offered - counts.get("accepted", 0),
            "status": dict(sorted(counts.items())),
            "mean_nis": float(values.mean()) if values.size else None,
        }
    return rows


def measure(series: Sequence[Series]) -> dict[str, Any]:
    """Every metric of these runs together, ready for JSON; null where there is no truth or nothing was measured.

    Parameters
    ----------
    series : sequence of Series
        At least one.
    """
    if not series:
        raise ValueError("series: at least one expected")
    runs = len(series)
    error, velocity = _stack(series, "error_m"), _stack(series, "velocity_error_mps")
    heading, nees, state_nees = (_stack(series, name) for name in ("heading_error_rad", "nees", "state_nees"))
    sigma = np.concatenate([one.sigma_m[one.counted] for one in series])
    updates = [one.updates for one in series if one.updates is not None]
    sources = _by_source(updates)
    baselines = {}
    for name in series[0].baseline_error_m:
        mine = [one for one in series if name in one.baseline_error_m]
        baselines[name] = _position(mine, [one.baseline_error_m[name] for one in mine])
    return {
        "epochs": len(sigma),
        "position": None
        if error is None
        else _position(series, [one.error_m for one in series if one.error_m is not None]),
        "stated_sigma_m": {
            "rms": _rms(np.linalg.norm(sigma, axis=1)),
            "final": _rms(np.array([np.linalg.norm(one.sigma_m[-1]) for one in series])),
        },
        "velocity": None if velocity is None else {"rmse_mps": _rms(np.linalg.norm(velocity, axis=1))},
        "heading": None if heading is None else {"rmse_deg": math.degrees(_rms(heading))},
        "coverage": None if error is None else _coverage(error, sigma, runs),
        "nees": None if nees is None or error is None else _nees(nees, error.shape[1], runs),
        "state_nees": None if state_nees is None else _nees(state_nees, series[0].state_dim, runs),
        "nis": _nis(updates) if updates else None,
        "measurements": {
            "offered": sum(row["offered"] for row in sources.values()),
            "rejected": sum(row["rejected"] for row in sources.values()),
            "by_source": sources,
        },
        "baselines": baselines,
    }


def series_over_runs(series: Sequence[Series]) -> dict[str, Array] | None:
    """RMS position error, mean NEES and coverage at each time over the runs; None when they differ in their times.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        ``t_s``, ``rms_m``, ``sigma_m``, ``nees``, ``coverage``, and ``rms_m:NAME`` for each baseline.
    """
    first = series[0]
    if any(one.error_m is None or one.nees is None or not np.array_equal(one.t_s, first.t_s) for one in series):
        return None
    errors = np.stack([one.error_m for one in series if one.error_m is not None])
    sigmas = np.stack([one.sigma_m for one in series])
    curves = {
        "t_s": first.t_s,
        "rms_m": np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0)),
        "sigma_m": np.sqrt(np.mean(np.sum(np.square(sigmas), axis=2), axis=0)),
        "nees": np.mean([one.nees for one in series if one.nees is not None], axis=0),
        "coverage": np.mean(np.abs(errors) <= sigmas, axis=(0, 2)),
    }
    for name in first.baseline_error_m:
        if all(name in one.baseline_error_m for one in series):
            square = np.mean([np.sum(np.square(one.baseline_error_m[name]), axis=1) for one in series], axis=0)
            curves[f"rms_m:{name}"] = np.sqrt(square)
    return curves
