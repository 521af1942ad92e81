"""Scenarios of ``source_localization``: the chain from poses to positions, what is refused, the gallery."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp import scenarios
from soopnav_cpp.config import ConfigError
from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios import base, metrics, report
from soopnav_cpp.scenarios.bearings import rotations
from soopnav_cpp.scenarios.emitters import solve
from soopnav_cpp.scenarios.execution import execute, seed_of_run
from soopnav_cpp.scenarios.source_localization import EXAMPLE, SourceLocalization, SourceLocalizationScenario
from soopnav_cpp.scenarios.source_localization_figures import share_of_bins
from soopnav_cpp.scenarios.source_localization_pipeline import emitters_at, groups, hear, path_of, route

ROOT = Path(__file__).parents[2]
WAYPOINTS = [[-300.0, -120.0], [120.0, -120.0], [120.0, 300.0]]


def short(**changes: Any) -> SourceLocalizationScenario:
    """A drive of forty bearings past a strong emitter."""
    fields: dict[str, Any] = {
        "system": "source_localization",
        "duration_s": 40.0,
        "platform": {"waypoints_m": WAYPOINTS, "corner_radius_m": 60.0},
        "emitters": [{"position_m": [0.0, 0.0, 20.0]}],
        "link": {"samples": 500, "excess_loss_db": 10.0},
        "finder": {"sigma": "theory", "azimuth_step_deg": 5.0, "elevation_step_deg": 5.0},
        **changes,
    }
    return SourceLocalizationScenario.model_validate(fields)


# ---- the way


def test_a_route_has_arcs_of_one_speed() -> None:
    place, direction = route(
        np.array([[-1200.0, -150.0], [150.0, -150.0], [150.0, 1200.0]]), 150.0, np.linspace(0, 1, 500)
    )
    step = np.linalg.norm(np.diff(place, axis=0), axis=1)
    assert step.sum() == pytest.approx(2400.0 + 75.0 * math.pi, rel=1e-4)
    assert np.ptp(step) < 1e-3
    np.testing.assert_allclose(place[[0, -1]], [[-1200.0, -150.0], [150.0, 1200.0]], atol=1e-9)
    assert np.hypot(*place.T).min() == pytest.approx(150.0, abs=1e-6)  # the arc is round the origin
    np.testing.assert_allclose(np.degrees(direction[[0, -1]]), [0.0, 90.0])
    way = np.diff(place, axis=0)
    between = 0.5 * (direction[1:] + direction[:-1])
    assert np.abs(np.arctan2(way[:, 1], way[:, 0]) - between).max() < 0.02


def test_corners_that_are_too_tight_are_cut() -> None:
    place, _ = route(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]), 50.0, np.linspace(0, 1, 200))
    assert place.min() > -1e-9
    assert place.max() < 10.0 + 1e-9
    straight, _ = route(np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]), 5.0, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(straight, [[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]], atol=1e-9)


def test_a_recorded_drive(tmp_path: Path) -> None:
    """Poses from CSV are those that the bearings are taken from; a recording that is too short is refused."""
    rows = [f"{t},{10.0 * t - 200.0},-100,90" for t in range(0, 41, 2)]
    path = tmp_path / "drive.csv"
    path.write_text("time_s,x_m,y_m,heading_deg\n" + "\n".join(rows) + "\n", encoding="utf-8")
    toml = tmp_path / "s.toml"
    text = (
        'system = "source_localization"\nduration_s = 40.0\n[platform]\nposes = "drive.csv"\n'
        "[[emitters]]\nposition_m = [0.0, 0.0, 20.0]\n"
    )
    toml.write_text(text, encoding="utf-8")
    _, scenario = scenarios.load(toml)
    assert isinstance(scenario, SourceLocalizationScenario)
    poses = path_of(scenario)
    np.testing.assert_allclose(poses.position_m[3], [-170.0, -100.0, 0.0])
    np.testing.assert_allclose(rotations(poses.quaternion_wxyz)[3, :, 0], [1.0, 0.0, 0.0], atol=1e-12)
    toml.write_text(text.replace("40.0", "60.0"), encoding="utf-8")
    _, longer = scenarios.load(toml)
    with pytest.raises(ValueError, match=r"poses from 0 to 40 s; duration_s = 60 needs"):
        SourceLocalization().check(longer)  # type: ignore[arg-type]


def test_a_drive_recorded_on_the_earth(tmp_path: Path) -> None:
    """Latitudes become metres of the scenario's origin, headings turn with the meridians."""
    frame = LocalFrame(math.radians(60.0), math.radians(10.0), 100.0)
    rows = ["time_s,latitude_deg,longitude_deg,height_m,heading_deg"]
    wanted = np.column_stack([np.linspace(20_000.0, 20_400.0, 41), np.linspace(0.0, 100.0, 41), np.full(41, 5.0)])
    for t, place in enumerate(wanted):
        latitude, longitude, height = frame.position_to_geodetic(place)
        rows.append(f"{t},{math.degrees(latitude):.10f},{math.degrees(longitude):.10f},{height:.4f},90")
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    given = {"poses": path}
    origin = {"latitude_deg": 60.0, "longitude_deg": 10.0, "height_m": 100.0}
    poses = path_of(short(platform=given, origin=origin))
    np.testing.assert_allclose(poses.position_m, wanted, atol=1e-3)
    east = rotations(poses.quaternion_wxyz)[:, :, 0]
    # East, 20 km to the east of the origin, points to the left of the origin's east: by 20 km tan(60°) / N.
    turned = np.degrees(np.arctan2(east[:, 1], east[:, 0]))
    assert turned[0] == pytest.approx(math.degrees(20_000.0 * math.tan(math.radians(60.0)) / 6.394e6), rel=0.01)
    alone = path_of(short(platform=given))
    np.testing.assert_allclose(alone.position_m[0], 0.0, atol=1e-6)


def test_emitters_move() -> None:
    scenario = short(emitters=[{"position_m": [1.0, 2.0, 3.0], "velocity_mps": [1.0, 0.0, -1.0]}])
    np.testing.assert_allclose(emitters_at(scenario, np.array([0.0, 10.0]))[:, 0], [[1.0, 2.0, 3.0], [11.0, 2.0, -7.0]])


# ---- the chain


def test_bearings_are_as_good_as_they_say() -> None:
    """Over three runs: the normalised errors' mean square is 1 within five of its own deviations."""
    errors = []
    for seed in (1, 2, 3):
        heard = hear(short(), seed)
        errors.append(heard.error_rad / heard.data.sigma_rad)
        assert heard.data.truth_m is not None
    square = np.square(np.concatenate(errors))
    assert len(square) == 3 * 41
    assert square.mean() == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / len(square)))


def test_bearings_of_a_high_emitter_are_as_good_as_the_map_says() -> None:
    """The map of eigenvalue ratios is one of low emitters; at 45° up an azimuth is worse by 1 / cos: twice the square,
    were it left out."""
    scenario = short(emitters=[{"position_m": [0.0, 0.0, 200.0]}], finder={"sigma": "map", "smooth_epochs": 11})
    square = np.concatenate(
        [np.square(h.error_rad / h.data.sigma_rad) for h in (hear(scenario, k) for k in range(1, 7))]
    )
    assert square.mean() == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / len(square)))


def test_a_seed_names_a_run() -> None:
    a, b, c = (SourceLocalization().run(short(), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.position_m, b.position_m)
    assert np.abs(a.position_m[-1] - c.position_m[-1]).max() > 1e-3


def test_processes_change_nothing() -> None:
    scenario = short(origin={"latitude_deg": 32.6, "longitude_deg": -85.5}, runs=2)
    alone, shared = (execute(SourceLocalization(), scenario, jobs=jobs) for jobs in (1, 2))
    for a, b in zip(alone, shared, strict=True):
        assert not a.error
        assert not b.error, b.details
        assert a.series is not None
        assert b.series is not None
        np.testing.assert_array_equal(a.series.error_m, b.series.error_m)
    assert shared[0].run is not None
    assert shared[1].run is None


def test_positions_deserve_their_ellipses() -> None:
    """Runs of short drives: the mean NEES of the last position is inside what 12 runs of two dimensions leave."""
    values = []
    for seed in range(12):
        run = SourceLocalization().run(short(), 50 + seed)
        assert run.truth is not None
        off = run.position_m[-1] - run.truth.position_m[-1]
        values.append(off @ np.linalg.solve(run.position_covariance_m2[-1], off))
        assert np.linalg.norm(off) < 10.0
    low, high = metrics.estimation.mean_nees_bounds(2, 12, failure_probability=1e-5)
    assert low < np.mean(values) < high


def test_receivers_are_calibrated_or_not() -> None:
    """Phases of its own in each receiver: with a calibration bearings are as good as without faults, else wrong."""
    faults = {"random_phases": True, "iq_gain_db": 1.0, "iq_phase_deg": 5.0, "adc_bits": 12}
    good = hear(short(front_end=faults), 1)
    bad = hear(short(front_end={**faults, "calibrate": False}), 1)
    ideal = hear(short(), 1)

    def rms(heard: Any) -> float:
        return float(np.sqrt(np.mean(np.square(heard.error_rad))))

    assert rms(good) < 2.0 * rms(ideal)
    assert rms(bad) > 10.0 * rms(ideal)


def test_two_emitters_are_told_apart() -> None:
    scenario = short(
        array={"kind": "uca", "elements": 8, "radius_wavelengths": 0.5},
        emitters=[
            {"position_m": [0.0, 0.0, 20.0], "name": "near"},
            {"position_m": [300.0, -300.0, 20.0], "name": "far"},
        ],
        duration_s=60.0,
    )
    run = SourceLocalization().run(scenario, 2)
    assert [one.name for one in run.located] == ["near", "far"]
    for one in run.located:
        error = one.error_m("ml")
        assert error is not None
        assert error < 12.0
    assert list(run.sources) == ["far"]


def test_what_the_platform_states_is_told_to_the_locators() -> None:
    """A heading that is off by two degrees makes ellipses larger, as it makes errors."""
    exact = SourceLocalization().run(short(), 5)
    loose = SourceLocalization().run(short(platform={"waypoints_m": WAYPOINTS, "heading_sigma_deg": 4.0}), 5)
    assert np.trace(loose.position_covariance_m2[-1]) > 4.0 * np.trace(exact.position_covariance_m2[-1])


def test_an_emitter_that_is_never_heard() -> None:
    scenario = short(link={"samples": 500, "excess_loss_db": 120.0}, finder={"worst_sigma_deg": 0.5, "sigma": "theory"})
    with pytest.raises(ValueError, match=r"no bearing is better than finder\.worst_sigma_deg = 0\.5"):
        SourceLocalization().run(scenario, 1)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"platform": {}}, "poses or waypoints_m expected, and not both"),
        ({"platform": {"waypoints_m": [[0.0, 0.0]]}}, "waypoints_m: at least 2 needed, got 1"),
        ({"platform": {"waypoints_m": [[0.0, 0.0], [0.0, 0.0]]}}, r"waypoints_m\[1\]: the same as the one before"),
        ({"duration_s": 1.0}, "fewer than 3 bearings"),
        ({"emitters": [{"position_m": [0.0, 0.0, 1.0]}] * 4}, "4 elements cannot tell 4 emitters apart"),
        ({"locator": {"moving": True, "others": ["centroid"]}}, "moving: centroid finds emitters that stand still"),
        ({"front_end": {"adc_bits": 1}}, "adc_bits: 1: 0 or at least 2 expected"),
        ({"finder": {"smooth_epochs": 4}}, "smooth_epochs: 4: an odd number expected"),
        ({"link": {"samples": 2}}, "greater than or equal to 16"),
    ],
)
def test_scenarios_that_do_not_fit(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        short(**changes)


def test_arrays_that_cannot_be_are_refused_before_a_run(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="32"):
        SourceLocalization().check(short(array={"nx": 8, "ny": 8}))
    file = tmp_path / "two.toml"
    file.write_text('frequency_hz = 1e9\nkind = "ula"\nn = 2\n', encoding="utf-8")
    twice = [{"position_m": [0.0, 0.0, 1.0]}, {"position_m": [9.0, 0.0, 1.0]}]
    with pytest.raises(ValueError, match="array: 2 elements cannot tell 2 emitters apart"):
        SourceLocalization().check(short(array={"file": file}, emitters=twice))


def test_bins_of_distance() -> None:
    rows = share_of_bins(np.arange(100.0), np.full(100, 0.2), np.full(100, 0.1), bins=4)
    np.testing.assert_allclose(
        rows, [[12.0, 0.2, 0.1], [37.0, 0.2, 0.1], [62.0, 0.2, 0.1], [87.0, 0.2, 0.1]], atol=0.51
    )


# ---- reports and the gallery


def test_a_report_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that soopnav run leaves, and the figures of the system itself."""
    path = tmp_path / "s.toml"
    path.write_text(EXAMPLE.replace("240.0", "60.0").replace("120.0", "30.0"), encoding="utf-8")
    system, scenario = scenarios.load(path)
    assert isinstance(scenario, SourceLocalizationScenario)
    changed = scenario.model_copy(update={"link": scenario.link.model_copy(update={"excess_loss_db": 10.0})})
    results = report.results_of(path, system, changed, execute(system, changed))
    assert results is not None
    assert results.pooled["position"]["final_m"] < 10.0
    assert set(results.pooled["baselines"]) == {"particle", "stansfield"}
    drawn = base.figures_of(system, changed, results.run)
    assert [caption.split()[0] for caption in drawn] == [
        "Bearings", "Errors", "Distance", "Likelihood", "Particles", "Spatial",
    ]  # fmt: skip
    curves = {line.get_label() for line in drawn["Distance from the truth over time, by method"].axes[0].get_lines()}
    assert {"ml", "particle", "stansfield", "1σ stated", "Cramér–Rao bound"} <= curves
    monkeypatch.setattr(report, "_figures", lambda *_: [])
    text = report.write(results, tmp_path / "out").read_text(encoding="utf-8")
    assert "positions and ellipses over time are those of ml for emitter" in text
    assert {p.name for p in (tmp_path / "out").iterdir()} >= {"trajectory.tum", "trajectory.geojson", "metrics.json"}


@pytest.mark.parametrize("name", ["carter_drive", "carter_moving", "carter_two"])
def test_the_gallery_is_read(name: str) -> None:
    system, scenario = scenarios.load(ROOT / "examples" / "scenarios" / f"{name}.toml")
    assert isinstance(system, SourceLocalization)
    assert isinstance(scenario, SourceLocalizationScenario)
    assert len(path_of(scenario).t_s) > 100
    assert scenario.title
    heard = hear(scenario, 5)
    parts, _ = groups(scenario, heard)
    assert list(parts) == list(scenario.emitter_names)
    for emitter, part in parts.items():
        one = solve(
            emitter, part, [scenario.locator.method], moving=scenario.locator.moving, history=False, extras=False
        )
        assert one.truth_m is not None
        off = np.asarray(one.fix.position_m) - one.truth_m[:2]
        assert off @ np.linalg.solve(np.asarray(one.fix.covariance_m2), off) < 40.0  # chi-square of two: 2e-9


def test_the_same_through_the_other_door(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """locate-emitter takes a scenario too, and gives the position that the system gives."""
    from soopnav_cpp.cli import locate_emitter
    from soopnav_cpp.cli.app import cli

    monkeypatch.setattr(locate_emitter, "figures", lambda _result, _folder: [])
    path = tmp_path / "s.toml"
    path.write_text(EXAMPLE.replace("240.0", "60.0").replace("120.0", "30.0").replace("26.6", "10.0"), encoding="utf-8")
    result = CliRunner().invoke(
        cli, ["locate-emitter", str(path), "--out", str(tmp_path / "out")], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    metrics_ = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    fix = metrics_["emitters"][0]["methods"]["ml"]
    system, scenario = scenarios.load(path)
    run = system.run(scenario, seed_of_run(scenario, 1))
    np.testing.assert_allclose(fix["position_m"], run.position_m[-1], rtol=1e-9)
    other = tmp_path / "other.toml"
    other.write_text('system = "nothing"\n', encoding="utf-8")
    with pytest.raises(ConfigError):
        scenarios.load(other)
