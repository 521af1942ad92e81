"""Scenarios of ``ofdm_inertial``: the gallery, recordings, refusals, and what the pipeline makes of them."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soopnav_cpp import scenarios
from soopnav_cpp.config import ConfigError
from soopnav_cpp.estimation import UpdateStatus
from soopnav_cpp.experiments.crosby_setup import boundary_errors
from soopnav_cpp.scenarios.ofdm_inertial import EXAMPLE, OfdmInertial, OfdmInertialScenario
from soopnav_cpp.scenarios.ofdm_inertial_pipeline import navigate, sense

ROOT = Path(__file__).resolve().parents[2]
GALLERY = sorted((ROOT / "examples" / "scenarios").glob("crosby_*.toml"))
C_MPS = 299_792_458.0


def read(tmp_path: Path, text: str) -> OfdmInertialScenario:
    path = tmp_path / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    scenario = scenarios.load(path)[1]
    assert isinstance(scenario, OfdmInertialScenario)
    return scenario


def short(**changes: Any) -> OfdmInertialScenario:
    fields: dict[str, Any] = {
        "system": "ofdm_inertial",
        "duration_s": 20.0,
        "transmitters": [{"position_m": [1000.0, 1500.0]}, {"position_m": [-2000.0, 1000.0]}],
        **changes,
    }
    return OfdmInertialScenario.model_validate(fields)


@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.stem)
def test_the_gallery_runs(path: Path) -> None:
    """Every scenario loads, says what it shows, and its first seconds run."""
    system, scenario = scenarios.load(path)
    assert scenario.title
    assert path.read_text(encoding="utf-8").startswith("# ")
    run = system.run(scenario.model_copy(update={"duration_s": 4.0}), 5)
    assert run.truth is not None
    assert run.updates is not None
    assert np.linalg.norm(run.position_m - run.truth.position_m, axis=1).max() < 40.0
    assert run.updates.accepted.any()


def test_every_experiment_has_its_scenario() -> None:
    stems = {path.stem for path in GALLERY}
    shown = {f"crosby_4_{i}" for i in range(1, 16)} - {"crosby_4_10", "crosby_4_11"}  # zooms of 4.8 and 4.9
    assert shown | {"crosby_x1", "crosby_x2", "crosby_x3", "crosby_x4"} <= stems


def test_the_example_is_a_scenario(tmp_path: Path) -> None:
    scenario = read(tmp_path, EXAMPLE)
    assert len(scenario.transmitters) == 3
    assert scenario.ofdm.boundary == "nearest_sample"


def test_a_seed_names_a_run() -> None:
    scenario, system = short(), OfdmInertial()
    a, b, c = (system.run(scenario, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.position_m, b.position_m)
    assert np.abs(a.position_m - c.position_m).max() > 1e-3


def test_boundaries_follow_the_path() -> None:
    """Nearest samples lie within half a sample of the range changes, those between samples within a metre."""
    for ofdm, limit in (({}, 9.0), ({"boundary": "interpolated", "movement": "fractional_delay"}, 1.5)):
        scenario = short(ofdm=ofdm)
        error = boundary_errors(scenario, sense(scenario, 2))
        assert np.abs(error).max() < limit
        assert np.abs(error).max() > 0.0


def test_reflections_and_clocks_enter() -> None:
    scenario = short(
        reflector={"position_m": [0.0, 1000.0], "strength": [1.3, 1.5], "blocks_s": [[5.0, 10.0]]},
        transmitter_clocks={},
    )
    sensed = sense(scenario, 3)
    assert sensed.reflection_gain is not None
    assert sensed.clock_bias_m is not None
    inside = (sensed.tdoa[0].t_s > 5.0) & (sensed.tdoa[0].t_s <= 10.0)
    assert np.all(np.abs(sensed.reflection_gain[0])[~inside] == 0.0)
    assert np.abs(sensed.reflection_gain[0])[inside].min() >= 1.3
    off = boundary_errors(scenario, sensed) + sensed.clock_bias_m
    assert np.abs(off[~inside]).max() < 9.0
    assert np.abs(off[inside]).max() > 45.0


def test_two_ray_steps_are_the_run() -> None:
    """The stepwise loop with timing in it stays on the line of sight, where gated boundaries do not."""
    tower = {"position_m": [0.0, 1000.0], "strength": [1.1, 1.5], "blocks_s": [[5.0, 20.0]]}
    three = [{"position_m": [1000.0, 1500.0]}, {"position_m": [-2000.0, 1000.0]}, {"position_m": [500.0, -2000.0]}]
    errors = {}
    for boundary in ("two_ray", "nearest_sample"):
        scenario = short(
            ofdm={"boundary": boundary, "movement": "fractional_delay"},
            reflector=tower, transmitters=three, filter={"gate_m": 15.0} if boundary == "two_ray" else {},
        )  # fmt: skip
        run = OfdmInertial().run(scenario, 6)
        assert run.truth is not None
        errors[boundary] = np.linalg.norm(run.position_m - run.truth.position_m, axis=1).max()
    assert errors["two_ray"] < 8.0
    assert errors["nearest_sample"] > 2.0 * errors["two_ray"]


def write_csv(path: Path, header: list[str], rows: Any) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def recordings(folder: Path, drop: slice | None = None) -> tuple[OfdmInertialScenario, Any]:
    """A simulated drive as files."""
    scenario = short()
    sensed = sense(scenario, 8)
    imu, tdoa = sensed.imu[0], sensed.tdoa[0]
    keep = np.ones(len(imu.t_s), dtype=bool)
    if drop is not None:
        keep[drop] = False
    write_csv(
        folder / "imu.csv",
        ["time_s", "yaw_rate_radps", "specific_force_x_mps2", "specific_force_y_mps2"],
        np.column_stack([imu.t_s, imu.yaw_rate_radps, imu.specific_force_b_mps2])[keep].tolist(),
    )
    truth = sensed.truth_at(tdoa.t_s)
    assert truth is not None
    sources = scenario.transmitters_m
    near = np.linalg.norm(sources, axis=1)
    change = np.linalg.norm(truth[0][:, None, 3:5] - sources, axis=2) - near + boundary_errors(scenario, sensed)
    write_csv(folder / "tdoa.csv", ["time_s", "tdoa_1_m", "tdoa_2_m"], np.column_stack([tdoa.t_s, change]).tolist())
    grid = sensed.truth_at(np.linspace(0.0, 20.0, 201))
    assert grid is not None
    write_csv(
        folder / "truth.csv",
        ["time_s", "position_x_m", "position_y_m"],
        np.column_stack([np.linspace(0.0, 20.0, 201), grid[0][:, 3:5]]).tolist(),
    )
    return scenario, sensed


def test_two_rays_with_a_reference_or_clock_states() -> None:
    """Their expectation holds what the clocks have done."""
    for extra in ({"reference_receiver": {}}, {"filter": {"clock_states": True, "gate_m": 15.0}}):
        scenario = short(
            ofdm={"boundary": "two_ray", "movement": "fractional_delay"},
            transmitters=[{"position_m": [x, y]} for x, y in ((1000.0, 1500.0), (-2000.0, 1000.0), (500.0, -2000.0))],
            transmitter_clocks={"white_frequency_m2ps": 0.036, "frequency_walk_m2ps3": 0.141}, **extra,
        )  # fmt: skip
        run = OfdmInertial().run(scenario, 3)
        assert run.updates is not None
        assert run.truth is not None
        assert run.updates.accepted.mean() > 0.95
        error = run.state[-1] - run.truth.state[-1] if run.state is not None and run.truth.state is not None else None
        assert error is not None
        assert run.covariance is not None
        assert error @ np.linalg.solve(run.covariance[-1], error) < 40.0


RECORDED = """
system = "ofdm_inertial"
title = "Recorded"
duration_s = 20.0
[[transmitters]]
position_m = [1000.0, 1500.0]
[[transmitters]]
position_m = [-2000.0, 1000.0]
[recorded]
imu = "imu.csv"
tdoa = "tdoa.csv"
truth = "truth.csv"
[ofdm]
range_sigma_m = 4.33
"""


def test_recordings_stand_in_for_simulated_sensors(tmp_path: Path) -> None:
    scenario, sensed = recordings(tmp_path)
    run = OfdmInertial().run(read(tmp_path, RECORDED), 1)
    same = navigate(
        scenario.model_copy(update={"ofdm": scenario.ofdm.model_copy(update={"range_sigma_m": 4.33})}), sensed
    )
    assert run.truth is not None
    assert run.truth.state is None  # the track says nothing of heading and velocity
    np.testing.assert_allclose(run.position_m[-1], same.position_m[-1], atol=0.3)  # sigma was the estimator's there
    assert np.linalg.norm(run.position_m - run.truth.position_m, axis=1).max() < 40.0


def test_a_gap_of_the_recording_is_bridged_and_named(tmp_path: Path) -> None:
    recordings(tmp_path, slice(500, 560))
    run = OfdmInertial().run(read(tmp_path, RECORDED), 1)
    assert any("IMU: a gap of 1.2 s" in note for note in run.notes)
    assert run.truth is not None
    assert np.linalg.norm(run.position_m - run.truth.position_m, axis=1).max() < 60.0


def test_a_transmitter_at_the_receiver(tmp_path: Path) -> None:
    """Its direction is undefined at the start: those boundaries are refused, the others go on."""
    scenario = short(
        transmitters=[{"position_m": [0.0, 0.0]}, {"position_m": [-2000.0, 1000.0]}],
        ofdm={"update_interval_s": 0.5},
        receiver={"trajectory": {"ramp_s": 20.0}},
    )
    run = navigate(scenario, sense(scenario, 1))
    assert np.isfinite(run.state).all()
    assert (run.links.status[:, 0, 1] == UpdateStatus.ACCEPTED).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('system = "ofdm_inertial"', ""),
        ("duration_s = 0.5", "duration_s: shorter than ofdm.update_interval_s = 1"),
        ("[ofdm]\nsnr_db = 400.0", r"ofdm.snr_db: input should be less than or equal to 100"),
        ("[ofdm]\nsymbols = 0", r"ofdm.symbols: input should be greater than or equal to 1"),
        ("[ofdm]\nbandwith_hz = 20e6", r"ofdm.bandwith_hz: unknown key; did you mean bandwidth_hz\?"),
        ('[ofdm]\nboundary = "two_ray"\noversampling = 15', 'boundary = "two_ray" works at oversampling = 1'),
        ('[ofdm]\nboundary = "interpolated"', 'boundary = "interpolated" expects true delays'),
        ("[ofdm]\nprefix = 64", "prefix: 64 must be shorter than the 64 samples"),
        ("[ofdm]\nupdate_interval_s = 1e-6", "more than 100000 epochs"),
        ("metrics_start_s = 30.0", "metrics_start_s: 30 leaves nothing of 20 s"),
        (
            "[[receivers]]\n[[receivers]]\nimu = { gyro_sigma_radps = 0.2 }",
            "receivers: all have the same imu; the filter has one set",
        ),
        ("[filter]\nclock_states = true", "filter.clock_states: needs transmitter_clocks"),
        ("[receiver]\nposition_m = [1.0]", "receiver.position_m: a list of two numbers expected"),
        ('[recorded]\nimu = "nowhere.csv"', "no such file"),
        ("[reflector]\nposition_m = [0.0, 0.0]\nblocks_s = [[5.0, 2.0]]", r"blocks_s: \[5, 2\] does not rise"),
        ("[receiver.imu]\nrate_hz = 0.0", "receiver.imu.rate_hz: input should be greater than 0"),
        ('[receiver.trajectory]\nkind = "waypoints"', "waypoints_m go together"),
    ],
)
def test_scenarios_that_do_not_fit(tmp_path: Path, change: str, message: str) -> None:
    head = 'system = "ofdm_inertial"\n' if not change.startswith("system") else ""
    head += "" if "duration_s" in change else "duration_s = 20.0\n"
    text = head + ("" if change.startswith("[") else change + "\n") + "transmitters = [{ position_m = [1.0, 2.0] }]\n"
    text += change if change.startswith("[") else ""
    if not message:
        assert read(tmp_path, text).duration_s == 20.0
        return
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, text)


def test_a_way_that_is_too_short_is_named() -> None:
    scenario = short(receiver={"trajectory": {"kind": "waypoints", "waypoints_m": [[30.0, 0.0], [60.0, 10.0]]}})
    with pytest.raises(ValueError, match=r"the way through waypoints_m takes .* s, and duration_s is 20"):
        sense(scenario, 1)
    long = short(receiver={"trajectory": {"kind": "waypoints", "waypoints_m": [[100.0, 0.0], [260.0, 40.0]]}})
    run = OfdmInertial().run(long, 1)
    assert run.heading_rad is not None
    assert abs(run.heading_rad[0]) < math.radians(30.0)
