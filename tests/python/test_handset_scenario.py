"""Scenarios of ``handset``: the chain on observables and from IQ and frames, what is refused, the gallery."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp import lte, scenarios, vision
from soopnav_cpp.config import ConfigError
from soopnav_cpp.scenarios import base, report
from soopnav_cpp.scenarios import handset_frames as frames
from soopnav_cpp.scenarios import handset_pipeline as pipeline
from soopnav_cpp.scenarios.execution import execute, seed_of_run
from soopnav_cpp.scenarios.handset import EXAMPLE, Handset, HandsetScenario

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "examples" / "scenarios"
needs_opencv = pytest.mark.skipif(not vision.available(), reason="this build is without OpenCV")


def short(**changes: Any) -> HandsetScenario:
    """Twelve seconds with few particles."""
    fields: dict[str, Any] = {
        "system": "handset",
        "duration_s": 12.0,
        "filter": {"particles": 300, "start_sigma_m": 1.0},
        "clock": {"start_sigma_m": 20.0},
        **changes,
    }
    return HandsetScenario.model_validate(fields)


def small_frames(**changes: Any) -> HandsetScenario:
    """Two seconds of IQ and frames, six blocks wide."""
    return short(
        stage="iq_and_frames",
        duration_s=2.0,
        lte={"n_rb": 15, "n_ports": 1, "rate_hz": 5.0, "multipath": "none", "spread_db": 1.0},
        camera={"depth_points": 2000, "rate_hz": 10.0},
        room={"speed_mps": [0.3, 0.4]},
        **changes,
    )


# ---- the chain


def test_the_world_is_what_the_scenario_says() -> None:
    scenario = short(duration_s=40.0, nlos={"most": 1, "excess_m": [6.0, 9.0]}, nodes={"distance_m": [30.0, 31.0]})
    world = pipeline.walk(scenario, 3)
    assert world.pose.shape == (len(world.frame_s), 3)
    assert np.abs(world.pose[:, :2]).max() < 10.0
    assert (~world.los).sum(axis=1).max() == 1
    shut = world.excess_m[~world.los]
    assert 6.0 - 1e-9 <= shut.min() <= shut.max() <= 9.0 + 1e-9
    assert np.all(world.excess_m[world.los] == 0.0)
    away = np.linalg.norm(world.nodes_m[:, :2], axis=1)
    assert 30.0 - 1e-6 <= away.min() <= away.max() <= 31.0 + 1e-6
    # What is left of the ranges is noise of 1 m.
    left = world.range_m - world.excess_m - world.clock_m[:, None]
    left -= np.linalg.norm(np.pad(world.position_m, ((0, 0), (0, 1)))[:, None] - world.nodes_m, axis=2)
    assert abs(left.mean()) < 0.1  # 2400 of them: 5 sigma
    assert left.std() == pytest.approx(1.0, abs=0.08)
    # Another run is another walk; the same seed is the same.
    assert np.abs(pipeline.walk(scenario, 4).position_m - world.position_m).max() > 1.0
    np.testing.assert_array_equal(pipeline.walk(scenario, 3).range_m, world.range_m)


def test_nodes_that_are_given_keep_the_noise() -> None:
    places = [[40.0, 0.0], [0.0, 40.0], [-40.0, 0.0], [0.0, -40.0], [30.0, 30.0], [-30.0, -30.0]]
    drawn, given = pipeline.walk(short(), 2), pipeline.walk(short(nodes={"positions_m": places}), 2)
    np.testing.assert_array_equal(given.nodes_m[:, :2], places)

    def noise(world: pipeline.Walk) -> Any:
        flat = np.pad(world.position_m, ((0, 0), (0, 1)))
        return world.range_m - np.linalg.norm(flat[:, None] - world.nodes_m, axis=2)

    np.testing.assert_allclose(noise(given), noise(drawn), atol=1e-9)


def test_steps_over_dropped_frames_are_joined() -> None:
    scenario = short(camera={"dropped_share": 0.5, "sigma_mm": 1e-6, "turn_sigma_deg": 1e-9})
    world = pipeline.walk(scenario, 1)
    observed = pipeline.observe(scenario, world, 1)
    assert 0.3 < len(observed.steps) / len(world.frame_s) < 0.7
    pose = world.pose[0].copy()
    for step in observed.steps:
        assert step.increment is not None
        c, s = math.cos(pose[2]), math.sin(pose[2])
        pose += np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ step.increment
    last = int(np.argmin(np.abs(world.frame_s - observed.steps[-1].t_s)))
    np.testing.assert_allclose(pose[:2], world.pose[last, :2], atol=1e-6)


@pytest.mark.parametrize("kind", ["control", "measurement"])
def test_a_run_on_observables(kind: str) -> None:
    scenario = short(filter={"type": kind, "particles": 300, "start_sigma_m": 1.0}, nlos={"most": 1})
    run = Handset().run(scenario, seed_of_run(scenario, 1))
    assert run.position_m.shape == (len(run.t_s), 2)
    assert run.p_los.shape == run.los.shape == (len(run.t_s), 6)
    assert np.all((run.p_los >= 0.0) & (run.p_los <= 1.0))
    assert run.truth is not None
    error = np.linalg.norm(run.position_m - run.truth.position_m, axis=1)
    assert np.sqrt(np.mean(error**2)) < 6.0
    assert len(run.clouds) > 10
    again = Handset().run(scenario, seed_of_run(scenario, 1))
    np.testing.assert_array_equal(again.position_m, run.position_m)


def test_clocks_that_disagree_are_refused() -> None:
    scenario = short(lte={"time_offset_s": -500.0})
    outcome = execute(Handset(), scenario)[0]
    assert "times that disagree: the radio's are -499.98 … -488.0" in outcome.error
    assert "lte.time_offset_s" in outcome.error


@needs_opencv
def test_a_run_from_iq_and_frames() -> None:
    """Ranges from samples, steps from frames: against what was so."""
    scenario = small_frames(nlos={"most": 0})
    seed = seed_of_run(scenario, 1)
    world = pipeline.walk(scenario, seed)
    observed = pipeline.observe(scenario, world, seed)
    away = np.linalg.norm(np.pad(world.position_m, ((0, 0), (0, 1)))[:, None] - world.nodes_m, axis=2)
    error = observed.range_m - away - world.clock_m[:, None]
    assert np.isfinite(error).mean() > 0.8
    assert np.nanmedian(np.abs(error)) < 10.0  # 15 resource blocks are 2.7 MHz; the others' data are noise
    pose = world.pose[0].copy()
    for step in observed.steps:
        assert step.increment is not None
        c, s = math.cos(pose[2]), math.sin(pose[2])
        pose += np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ step.increment
    assert np.abs(pose[:2] - world.pose[-1, :2]).max() < 0.03
    assert observed.frame is not None
    assert observed.frame.tracks.agree.sum() > 50
    assert set(observed.timings_s) == {"search", "iq synthesis", "ranging", "rendering", "ego-motion", "wall"}
    again = pipeline.observe(scenario, world, seed)  # whatever the threads do
    np.testing.assert_array_equal(again.range_m, observed.range_m)
    np.testing.assert_array_equal(again.steps[-1].increment, observed.steps[-1].increment)


def test_cells_that_the_search_misses_come_from_the_list_of_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = small_frames(nlos={"most": 0})
    heard = lte.search
    monkeypatch.setattr(lte, "search", lambda *a, **k: [one for one in heard(*a, **k) if one.cell_id != 37])
    world = pipeline.walk(scenario, 5)
    assert frames.tell_cells(frames._Air(scenario, world, 5))[1] is None
    helped = scenario.model_copy(update={"lte": scenario.lte.model_copy(update={"neighbours": True})})
    air = frames._Air(helped, world, 5)
    told = frames.tell_cells(air)
    assert [one.cell_id for one in told] == air.ids
    assert (told[1].n_rb, told[1].n_ports) == (15, 1)
    assert told[1].cfo_hz == pytest.approx(air.cfo_hz, abs=50.0)
    ranger = lte.SnapshotRanger(air.rate_hz, told)
    guess = [math.remainder(one.frame_start_s, 10e-3) for one in told]
    seen = ranger.range(air.hear(2, 1.15e-3), guess, [one.cfo_hz for one in told])
    assert int(seen.status[1]) == 0
    away = float(np.linalg.norm(np.append(world.position_m[2], 0.0) - world.nodes_m[1]))
    assert 299_792_458.0 * (seen.toa_s[1] - 25e-6) - away - world.clock_m[2] == pytest.approx(0.0, abs=30.0)
    # Nothing found: there is nobody to be a neighbour of.
    monkeypatch.setattr(lte, "search", lambda *a, **k: [])
    assert frames.tell_cells(air) == [None] * 6


def test_the_filter_is_told_of_multipath_that_stays() -> None:
    def told(stage: str = "iq_and_frames", **radio: Any) -> dict[str, Any]:
        scenario = short(stage=stage, lte=radio)
        locator = pipeline._locators(scenario, pipeline.walk(scenario, 1), 1)[0]
        assert locator.dimension == 12 + (6 if pipeline.multipath_of(scenario).get("multipath_sigma_m") else 0)
        return pipeline.multipath_of(scenario)

    assert told("observables") == {}
    assert told() == {"multipath_sigma_m": pytest.approx(0.333, abs=1e-3), "multipath_length_m": 10.0}
    assert told(n_rb=50)["multipath_sigma_m"] == pytest.approx(0.666, abs=1e-3)
    assert told(multipath="none")["multipath_sigma_m"] == 0.0
    assert told(multipath_sigma_m=0.5, multipath_length_m=3.0) == {
        "multipath_sigma_m": 0.5,
        "multipath_length_m": 3.0,
    }


# ---- many runs


def test_results_do_not_depend_on_processes() -> None:
    scenario = short(duration_s=2.0, runs=2)
    one, many = execute(Handset(), scenario), execute(Handset(), scenario, jobs=2)
    for a, b in zip(one, many, strict=True):
        assert a.series is not None
        assert b.series is not None
        assert a.series.error_m is not None
        np.testing.assert_array_equal(a.series.error_m, b.series.error_m)


@pytest.mark.slow
def test_the_gallery_holds_what_it_promises() -> None:
    """Twenty walks: after 20 s the pooled RMS is at most 0.6 m, a fifth of that of LTE alone (nielsen-sgl)."""
    system, scenario = scenarios.load(GALLERY / "nielsen_room_walk.toml")
    outcomes = execute(system, scenario, jobs=2)
    results = report.results_of(GALLERY / "nielsen_room_walk.toml", system, scenario, outcomes)
    assert results is not None
    rms = results.pooled["position"]["rmse_m"]
    assert rms <= 0.6
    assert results.pooled["baselines"][pipeline.ALONE]["rmse_m"] >= 5.0 * rms


@pytest.mark.slow
@needs_opencv
def test_the_gallery_from_iq_and_frames_holds_too() -> None:
    system, scenario = scenarios.load(GALLERY / "nielsen_room_walk_iq.toml", runs=4)
    outcomes = execute(system, scenario, jobs=2)
    results = report.results_of(GALLERY / "nielsen_room_walk_iq.toml", system, scenario, outcomes)
    assert results is not None
    assert not results.failed
    assert results.pooled["position"]["rmse_m"] <= 0.6
    assert results.pooled["baselines"][pipeline.ALONE]["rmse_m"] >= 5.0 * results.pooled["position"]["rmse_m"]
    assert 0.5 <= results.pooled["nees"]["mean"] / 2.0 <= 2.0  # of two degrees of freedom


# ---- files, and what is refused


@pytest.mark.parametrize("name", ["nielsen_room_walk", "nielsen_room_walk_iq"])
def test_the_gallery_is_read(name: str) -> None:
    system, scenario = scenarios.load(GALLERY / f"{name}.toml")
    assert isinstance(system, Handset)
    assert isinstance(scenario, HandsetScenario)
    assert scenario.filter.particles == 2000
    assert scenario.title


def test_a_report_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "s.toml"
    path.write_text(EXAMPLE.replace("60.0", "3.0").replace("20.0", "1.0").replace("2000", "200"), encoding="utf-8")
    system, scenario = scenarios.load(path)
    results = report.results_of(path, system, scenario, execute(system, scenario))
    assert results is not None
    drawn = base.figures_of(system, scenario, results.run)
    assert [caption.split()[0] for caption in drawn] == ["The", "Error", "P(LOS)"]
    links = drawn["P(LOS) of each link against the truth"].axes
    assert len(links) == 6
    monkeypatch.setattr(report, "_figures", lambda *_: [])
    text = report.write(results, tmp_path / "out").read_text(encoding="utf-8")
    assert "data:image/gif;base64," in text
    assert (tmp_path / "out" / "particles.gif").stat().st_size < 2_000_000
    numbers = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert numbers["handset"]["stage"] == "observables"
    assert 0.0 <= numbers["handset"]["sight_judged_right"] <= 1.0
    assert set(numbers["handset"]["seconds_taken"]) == {"filter"}
    assert numbers["pooled"]["baselines"][pipeline.ALONE]["rmse_m"] > 0.0


def test_the_command_runs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from soopnav_cpp.cli.app import cli

    monkeypatch.setattr(report, "_figures", lambda *_: [])
    monkeypatch.setattr(Handset, "files", lambda *_: {})
    path = tmp_path / "s.toml"
    text = EXAMPLE.replace("60.0", "3.0").replace("20.0", "1.0").replace("particles = 2000", "particles = 100")
    path.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(cli, ["run", str(path), "--runs", "2", "--jobs", "1", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "position RMS" in result.output
    for words in (["--list"], ["--schema", "handset"], ["--example", "handset"]):
        assert "handset" in CliRunner().invoke(cli, ["run", *words]).output


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"nlos": {"most": 4}}, "nlos.most: 4: at least 3 of the 6 links have to stay open"),
        ({"nlos": {"excess_m": [20.0, 4.0]}}, "excess_m: [20, 4]: two lengths, the shorter one first"),
        ({"room": {"speed_mps": [1.0, 0.5]}}, "speed_mps: [1, 0.5]: two speeds above 0"),
        ({"nodes": {"distance_m": [60.0, 25.0]}}, "distance_m: [60, 25]"),
        ({"nodes": {"positions_m": [[1.0, 2.0]]}}, "positions_m: 3 … 12 nodes expected, got 1"),
        ({"lte": {"rate_hz": 40.0}}, "lte.rate_hz: 40: at most camera.rate_hz = 20"),
        ({"duration_s": 0.1}, "duration_s: fewer than 2 epochs"),
        ({"duration_s": 20000.0}, "camera.rate_hz: more than 200000 frames"),
    ],
)
def test_scenarios_that_do_not_fit(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError) as caught:
        short(**change)
    assert sentence in str(caught.value)


def test_a_camera_that_is_not_there_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('system = "handset"\nduration_s = 10.0\n[camera]\nfile = "none.toml"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"s\.toml:4: camera\.file: .*none\.toml: no such file"):
        scenarios.load(path)
