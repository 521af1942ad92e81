"""What a scenario's runs leave in a folder: trajectories, states, metrics, figures, and a report that stands alone."""

from __future__ import annotations

import base64
import html
import json
import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from soopnav_cpp import __version__, plotting
from soopnav_cpp.scenarios import writers
from soopnav_cpp.scenarios.base import Scenario, System, SystemRun, figures_of, files_of, numbers_of
from soopnav_cpp.scenarios.execution import Outcome
from soopnav_cpp.scenarios.metrics import Series, measure, series_over_runs

__all__ = ["Results", "results_of", "verdict", "write"]

_MOST_ROWS = 20  # of the table of runs
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True, eq=False)
class Results:
    """Runs of a scenario with their metrics.

    Attributes
    ----------
    path : pathlib.Path
        The scenario.
    system, scenario
    outcomes : list of Outcome
    run : SystemRun
        The one whose files are full.
    number : int
        Its number.
    pooled : dict
        Metrics of all good runs together.
    each : list of dict
        Those of each good run, with its number and seed.
    """

    path: Path
    system: System
    scenario: Scenario
    outcomes: Sequence[Outcome]
    run: SystemRun
    number: int
    pooled: dict[str, Any]
    each: list[dict[str, Any]]

    @property
    def series(self) -> list[Series]:
        """Of the good runs."""
        return [outcome.series for outcome in self.outcomes if outcome.series is not None]

    @property
    def failed(self) -> list[Outcome]:
        """Runs that ended with an exception."""
        return [outcome for outcome in self.outcomes if outcome.error]

    @property
    def title(self) -> str:
        """Of the scenario, or the name of its file."""
        return self.scenario.title or self.path.name


def results_of(path: Path, system: System, scenario: Scenario, outcomes: Sequence[Outcome]) -> Results | None:
    """Metrics of what ran; None when every run failed."""
    good = [outcome for outcome in outcomes if outcome.series is not None]
    full = next((outcome for outcome in good if outcome.run is not None), None)
    if full is None or full.run is None:
        return None
    each = [{"run": o.number, "seed": o.seed, **measure([o.series])} for o in good if o.series is not None]
    pooled = measure([outcome.series for outcome in good if outcome.series is not None])
    return Results(path, system, scenario, list(outcomes), full.run, full.number, pooled, each)


# ---- words


def _length(value: float | None) -> str:
    """Three figures: ``1.93 m``, ``12.4 m``, ``0.31 m``, ``4.2 mm``."""
    if value is None:
        return "–"
    if abs(value) < 0.01:
        return f"{1e3 * value:.2g} mm".replace("-", _MINUS)
    return f"{value:.{2 if abs(value) < 10.0 else 1 if abs(value) < 100.0 else 0}f} m".replace("-", _MINUS)


def _share(value: float) -> str:
    return f"{100.0 * value:.1f} %"


def verdict(results: Results) -> str:
    """The outcome in one sentence, with its numbers."""
    pooled, runs = results.pooled, len(results.each)
    over = f" over {runs} runs" if runs > 1 else ""
    parts = []
    position = pooled["position"]
    if position is not None:
        parts.append(f"position RMS {_length(position['rmse_m'])}{over}, worst {_length(position['max_m'])}")
        one = pooled["coverage"]["1_sigma"]
        parts.append(f"{_share(one['share'])} of errors within 1σ ({_share(one['expected'])} expected)")
    else:
        parts.append(
            f"no truth to compare with{over}; stated σ of the position {_length(pooled['stated_sigma_m']['rms'])}"
        )
        nis = pooled["nis"]
        if nis is not None and nis["mean"] is not None:
            parts.append(f"mean NIS {nis['mean']:.2f} (1 expected)")
    nees = pooled["nees"]
    if nees is not None and nees["mean"] is not None and not nees["inside"]:
        how = "too sure of itself" if nees["mean"] > nees["bounds"][1] else "too careful"
        parts.append(f"the filter is {how} (NEES {nees['mean']:.2f}, {nees['expected']} expected)")
    counts = pooled["measurements"]
    if counts["offered"]:
        parts.append(f"{counts['rejected']} of {counts['offered']} measurements rejected")
    if results.failed:
        parts.append(f"{len(results.failed)} of {len(results.outcomes)} runs failed")
    return "; ".join(parts) + "."


# ---- metrics.json and runs.csv


def as_json(results: Results) -> dict[str, Any]:
    """Every number of the results: metrics.json."""
    own = numbers_of(results.system, results.scenario, results.run)
    return {
        "scenario": results.path.name,
        "title": results.scenario.title,
        "system": results.system.name,
        "seed": results.scenario.seed,
        "runs": len(results.outcomes),
        "failed": [{"run": o.number, "seed": o.seed, "error": o.error} for o in results.failed],
        "metrics_start_s": results.scenario.metrics_start_s,
        "versions": _versions(),
        "pooled": results.pooled,
        "each": results.each,
        **({results.system.name: own} if own else {}),
    }


def _versions() -> dict[str, str]:
    return {"soopnav": __version__, "python": platform.python_version(), "numpy": np.__version__}


_COLUMNS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("rmse_m", ("position", "rmse_m")),
    ("cep50_m", ("position", "cep50_m")),
    ("max_m", ("position", "max_m")),
    ("final_m", ("position", "final_m")),
    ("velocity_rmse_mps", ("velocity", "rmse_mps")),
    ("heading_rmse_deg", ("heading", "rmse_deg")),
    ("coverage_1_sigma", ("coverage", "1_sigma", "share")),
    ("nees", ("nees", "mean")),
    ("state_nees", ("state_nees", "mean")),
    ("nis", ("nis", "mean")),
    ("offered", ("measurements", "offered")),
    ("rejected", ("measurements", "rejected")),
)


def _at(metrics: Any, place: Sequence[str]) -> Any:
    for key in place:
        if metrics is None:
            return None
        metrics = metrics[key]
    return metrics


def _run_rows(results: Results) -> list[list[Any]]:
    """A row per run: number, seed, metrics, and why it failed."""
    metrics = {row["run"]: row for row in results.each}
    rows = []
    for outcome in results.outcomes:
        mine = metrics.get(outcome.number)
        rows.append([outcome.number, outcome.seed, *(_at(mine, place) for _, place in _COLUMNS), outcome.error])
    return rows


# ---- figures


def _figures(results: Results, folder: Path) -> list[tuple[str, str]]:
    """Write the figures; their file names and captions, in the order of the report."""
    run, runs = results.run, len(results.each)
    which = f"run {results.number}" if len(results.outcomes) > 1 else "the run"
    drawn: list[tuple[str, str]] = []

    def keep(name: str, caption: str, draw: Callable[[Path], object]) -> None:
        draw(folder / f"{name}.png")
        drawn.append((f"{name}.png", caption))

    keep(
        "trajectory",
        f"Track of {which}: estimate, truth and baselines where there are any, 95 % error ellipses, and the sources.",
        lambda path: plotting.trajectory(run, path=path),
    )
    if run.truth is not None:
        keep(
            "errors",
            f"Position errors of {which} (estimate minus truth) in the ±1σ band that the filter states. A right filter "
            "has about 68 % of its errors inside.",
            lambda path: plotting.errors(run, path=path),
        )
        if run.truth.state is not None and len(run.state_names) > run.position_m.shape[1]:
            keep(
                "state_errors",
                f"Errors of the whole state of {which} in the ±1σ bands that the filter states.",
                lambda path: plotting.state_errors(run, path=path),
            )
    curves = series_over_runs(results.series)
    if curves is not None:
        named = {results.system.name: curves["rms_m"]}
        named |= {name.removeprefix("rms_m:"): value for name, value in curves.items() if name.startswith("rms_m:")}
        keep(
            "rms",
            f"RMS position error over {runs} runs at each time." if runs > 1 else f"Position error of {which}.",
            lambda path: plotting.rms(curves["t_s"], named, sigma_m=curves["sigma_m"], runs=runs, path=path),
        )
    updates = [one.updates for one in results.series if one.updates is not None]
    nees = None if curves is None else (curves["t_s"], curves["nees"], run.position_m.shape[1])
    nis = None
    if updates:
        taken = [(u.t_s[u.accepted], u.nis[u.accepted]) for u in updates]
        time, value = (np.concatenate(column) for column in zip(*taken, strict=True))
        nis = (time[np.isfinite(value)], value[np.isfinite(value)])
    if nees is not None or nis is not None:
        keep(
            "consistency",
            "Whether the stated covariances deserve belief: above the bounds the filter is too sure of itself, below "
            "them too careful. Errors of one run hang together over time, so NEES stays outside for a while at a time.",
            lambda path: plotting.consistency(nees, nis, runs=runs, path=path),
        )
    if run.updates is not None:
        keep(
            "innovations",
            f"Innovations of {which} (measured minus predicted), with what the filter expected and its gates.",
            lambda path: plotting.innovations(run.updates, path=path),
        )
    for name, figure in figures_of(results.system, results.scenario, run).items():
        file = re.sub(r"[^a-z0-9_.-]+", "_", name.lower()) or "figure"
        keep(file, f"{name}.", lambda path, figure=figure: figure.savefig(path, dpi=150))  # type: ignore[misc]
    return drawn


# ---- report.html

_STYLE = """
body{font:15px/1.55 system-ui,sans-serif;color:#22303c;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin-top:2.2rem}
.under{color:#5c677d;margin-top:0} .lead{font-size:1.12rem;border-left:4px solid #1b6ca8;padding-left:.8rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.6rem 0} .wide{overflow-x:auto}
td,th{padding:.22rem .8rem;text-align:right;white-space:nowrap} th{border-bottom:1px solid #22303c}
td:first-child,th:first-child{text-align:left} tr:nth-child(even) td{background:#f3f6f8}
.bad td{color:#b3263d} figure{margin:1.4rem 0} img{max-width:100%}
figcaption{color:#4a5a68;font-size:.9rem} pre{background:#f3f6f8;padding:.8rem;overflow-x:auto;font-size:.85rem}
footer{margin-top:2.5rem;color:#5c677d;font-size:.85rem}
"""


def _table(columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
    body = "".join(
        f'<tr class="{kind}">' + "".join(f"<td>{html.escape(c)}</td>" for c in cells) + "</tr>" for kind, cells in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _accuracy(results: Results) -> str:
    pooled = results.pooled
    position = pooled["position"]
    stated = pooled["stated_sigma_m"]
    if position is None:
        rows = [("stated σ of the position, RMS", stated["rms"]), ("stated σ at the end", stated["final"])]
        return _table(["quantity", "value"], [("", [name, _length(value)]) for name, value in rows])
    names = ["RMS", "horizontal RMS", "CEP (50 %)", "95 % circle", "worst", "at the end"]
    keys = ["rmse_m", "horizontal_rmse_m", "cep50_m", "cep95_m", "max_m", "final_m"]
    lines: list[tuple[str, list[str]]] = [("", [results.system.name, *(_length(position[key]) for key in keys)])]
    for name, row in pooled["baselines"].items():
        cells = [_length(row[key]) for key in keys]
        lines.append(("", [name, *cells]))
    text = _table(["position error", *names], lines)
    more = [f"RMS by axis {', '.join(_length(v) for v in position['rmse_axes_m'])}"]
    more.append(f"worst at {position['max_at_s']:.2f} s")
    more.append(f"stated by the filter {_length(stated['rms'])}")
    if pooled["velocity"] is not None:
        more.append(f"velocity RMS {pooled['velocity']['rmse_mps']:.3g} m/s")
    if pooled["heading"] is not None:
        more.append(f"heading RMS {pooled['heading']['rmse_deg']:.3g}°")
    return text + f"<p>{html.escape('; '.join(more))}.</p>"


def _judged(
    name: str, value: str, expected: str, bounds: Sequence[float] | None, inside: bool | None
) -> tuple[str, list[str]]:
    within = "–" if bounds is None else f"{bounds[0]:.3f} … {bounds[1]:.3f}"
    word = "–" if inside is None else "yes" if inside else "NO"
    return ("bad" if inside is False else "", [name, value, expected, within, word])


def _consistency(results: Results) -> str:
    pooled = results.pooled
    rows = []
    if pooled["coverage"] is not None:
        for k in (1, 2, 3):
            row = pooled["coverage"][f"{k}_sigma"]
            share, right = f"{row['share']:.4f}", f"{row['expected']:.4f}"
            rows.append(_judged(f"errors within {k}σ", share, right, row["bounds"], row["inside"]))
    names = {"nees": "NEES of the position", "state_nees": "NEES of the state", "nis": "NIS of accepted measurements"}
    for key, name in names.items():
        row = pooled[key]
        if row is not None and row["mean"] is not None:
            rows.append(_judged(name, f"{row['mean']:.3f}", str(row["expected"]), row["bounds"], row["inside"]))
    if not rows:
        return "<p>Nothing to judge it by: neither a truth nor measurements.</p>"
    runs = len(results.each)
    return (
        _table(["quantity", "found", "expected", "99 % bounds", "inside"], rows)
        + f"<p>Bounds of coverage and NEES are those of {runs} independent epoch{'s' * (runs != 1)}, one per run: the "
        "epochs of a run hang together. Being outside them means something; being inside a wide bound means little.</p>"
    )


def _sources(results: Results) -> str:
    rows = []
    for name, row in results.pooled["measurements"]["by_source"].items():
        why = ", ".join(
            f"{count} {word.replace('_', ' ')}" for word, count in row["status"].items() if word != "accepted"
        )
        share = row["rejected"] / row["offered"] if row["offered"] else 0.0
        nis = "–" if row["mean_nis"] is None else f"{row['mean_nis']:.3f}"
        counts = [str(row["offered"]), str(row["accepted"]), str(row["rejected"]), _share(share)]
        rows.append(("", [name, *counts, nis, why or "–"]))
    return _table(["source", "measured", "accepted", "rejected", "share", "mean NIS", "not accepted"], rows)


def _runs(results: Results) -> str:
    columns = ["run", "seed", "RMS", "CEP", "worst", "at the end", "within 1σ", "NEES", "NIS", "rejected"]
    rows: list[tuple[str, list[str]]] = []
    failed = {outcome.number: outcome for outcome in results.failed}
    metrics = {row["run"]: row for row in results.each}
    for outcome in results.outcomes[:_MOST_ROWS]:
        if outcome.number in failed:
            rows.append(("bad", [str(outcome.number), str(outcome.seed), outcome.error]))
            continue
        row = metrics[outcome.number]
        lengths = [_length(_at(row, ("position", key))) for key in ("rmse_m", "cep50_m", "max_m", "final_m")]
        share = _at(row, ("coverage", "1_sigma", "share"))
        means = [_at(row, (key, "mean")) for key in ("nees", "nis")]
        rows.append(
            (
                "",
                [
                    str(outcome.number),
                    str(outcome.seed),
                    *lengths,
                    "–" if share is None else _share(share),
                    *("–" if mean is None else f"{mean:.2f}" for mean in means),
                    str(row["measurements"]["rejected"]),
                ],
            )
        )
    more = len(results.outcomes) - len(rows)
    return _table(columns, rows) + (f"<p>{more} more in runs.csv.</p>" if more > 0 else "")


def _notes(results: Results) -> list[str]:
    """Sentences of the runs, each once, with how many runs said it; then the failures."""
    said: dict[str, list[int]] = {}
    for outcome in results.outcomes:
        for note in outcome.notes:
            said.setdefault(note, []).append(outcome.number)
    many = len(results.outcomes) > 1
    notes = [f"{note} ({_numbers(numbers)})" if many else note for note, numbers in said.items()]
    return notes[:_MOST_ROWS] + [f"Failed: {outcome}" for outcome in results.failed]


def _numbers(numbers: Sequence[int]) -> str:
    return f"run {numbers[0]}" if len(numbers) == 1 else f"{len(numbers)} runs, first run {numbers[0]}"


def _report(results: Results, pictures: Sequence[tuple[str, bytes]]) -> str:
    scenario, runs = results.scenario, len(results.outcomes)
    e = html.escape
    under = (
        f"{results.path.name}: system {results.system.name}, {scenario.duration_s:g} s, {runs} run{'s' * (runs != 1)}, "
        f"seed {scenario.seed}"
    )
    figures = "".join(
        f'<figure><img alt="{e(caption)}" src="data:image/{"gif" if data.startswith(b"GIF8") else "png"};base64,'
        f'{base64.b64encode(data).decode("ascii")}">'
        f"<figcaption>{e(caption)}</figcaption></figure>"
        for caption, data in pictures
    )
    notes = "".join(f"<li>{e(note)}</li>" for note in _notes(results))
    versions = ", ".join(f"{name} {version}" for name, version in _versions().items())
    start = f" Metrics count from {scenario.metrics_start_s:g} s." if scenario.metrics_start_s else ""
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{e(results.title)}</title><style>{_STYLE}</style></head><body>"
        f'<h1>{e(results.title)}</h1><p class="under">{e(under)}</p><p class="lead">{e(_capital(verdict(results)))}</p>'
        + (f"<h2>Notes</h2><ul>{notes}</ul>" if notes else "")
        + f"<h2>Accuracy</h2>{_accuracy(results)}<h2>Figures</h2>{figures}"
        + f"<h2>Consistency</h2>{_consistency(results)}"
        + (f"<h2>Measurements</h2>{_sources(results)}" if results.pooled["measurements"]["by_source"] else "")
        + (f"<h2>Runs</h2>{_runs(results)}" if runs > 1 else "")
        + f"<h2>Scenario</h2><pre>{e(results.path.read_text(encoding='utf-8'))}</pre>"
        + f"<footer>Errors are estimate minus truth, in the local frame.{e(start)} Made by {e(versions)}. The same "
        f"scenario with <code>--seed {scenario.seed} --runs {scenario.runs}</code> gives the same numbers for any "
        "<code>--jobs</code>.</footer></body></html>\n"
    )


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def write(results: Results, folder: Path) -> Path:
    """Write every file into `folder`, which is made when it is not there; returns report.html.

    An NMEA file of an earlier run is taken away when this one has no place on the Earth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = results.run
    writers.write_tum(run, folder / "trajectory.tum")
    writers.write_csv(run, folder / "trajectory.csv")
    writers.write_geojson(run, folder / "trajectory.geojson")
    if run.origin_lla_deg is None:
        (folder / "trajectory.nmea").unlink(missing_ok=True)
    else:
        writers.write_nmea(run, folder / "trajectory.nmea", start_utc=results.scenario.start_utc)
    writers.write_states(run, folder / "states.npz")
    columns = ["run", "seed", *(name for name, _ in _COLUMNS), "error"]
    writers.write_table(folder / "runs.csv", columns, _run_rows(results))
    content = json.dumps(as_json(results), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "metrics.json").write_text(content + "\n", encoding="utf-8")
    pictures = [(caption, (folder / name).read_bytes()) for name, caption in _figures(results, folder)]
    more = files_of(results.system, results.scenario, run, folder)
    pictures += [(f"{caption}.", path.read_bytes()) for caption, path in more.items()]
    report = folder / "report.html"
    report.write_text(_report(results, pictures), encoding="utf-8")
    return report
