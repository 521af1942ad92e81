"""Scenarios of ``ofdm_strapdown``: what enters, what is refused, and how honest the filter stays when things fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soopnav_cpp import scenarios
from soopnav_cpp.config import ConfigError
from soopnav_cpp.estimation import mean_nees_bounds, nees
from soopnav_cpp.inertial import ImuNoise
from soopnav_cpp.scenarios import metrics
from soopnav_cpp.scenarios.base import SystemRun
from soopnav_cpp.scenarios.ofdm_strapdown import EXAMPLE, OfdmStrapdown, OfdmStrapdownScenario, StrapdownImuSettings
from soopnav_cpp.scenarios.ofdm_strapdown_pipeline import navigate, sense

ORIGIN = {"latitude_deg": 48.1, "longitude_deg": 11.6, "height_m": 520.0}
PLACES = [[2900.0, 600.0, -30.0], [-700.0, 2950.0, -300.0], [-2800.0, -900.0, -120.0], [600.0, -3000.0, -210.0]]


def short(**changes: Any) -> OfdmStrapdownScenario:
    fields: dict[str, Any] = {
        "system": "ofdm_strapdown",
        "duration_s": 60.0,
        "origin": ORIGIN,
        "transmitters": [{"position_ned_m": place} for place in PLACES],
        **changes,
    }
    fields["imu"] = {"rate_hz": 50.0, **fields.get("imu", {})}
    return OfdmStrapdownScenario.model_validate(fields)


def position_nees(run: SystemRun, at_s: float) -> float:
    assert run.truth is not None
    k = int(np.argmin(np.abs(run.t_s - at_s)))
    error = run.position_m[k] - run.truth.position_m[k]
    return float(nees(error[None], run.position_covariance_m2[k][None])[0])


def off_m(run: SystemRun, at_s: float) -> float:
    assert run.truth is not None
    k = int(np.argmin(np.abs(run.t_s - at_s)))
    return float(np.linalg.norm(run.position_m[k] - run.truth.position_m[k]))


def sigma_m(run: SystemRun, at_s: float) -> float:
    k = int(np.argmin(np.abs(run.t_s - at_s)))
    return float(np.sqrt(np.trace(run.position_covariance_m2[k])))


def assert_consistent(values: list[float], dof: int) -> None:
    low, high = mean_nees_bounds(dof, len(values), failure_probability=1e-5)
    assert low < np.mean(values) < high


def test_the_example_is_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(EXAMPLE, encoding="utf-8")
    system, scenario = scenarios.load(path)
    assert isinstance(system, OfdmStrapdown)
    assert len(scenario.transmitters) == 4  # type: ignore[attr-defined]


def test_a_seed_names_a_run() -> None:
    a, b, c = (OfdmStrapdown().run(short(), seed) for seed in (3, 3, 4))
    assert a.state is not None
    assert b.state is not None
    np.testing.assert_array_equal(a.position_m, b.position_m)
    np.testing.assert_array_equal(a.state, b.state)
    assert np.abs(a.position_m - c.position_m).max() > 1.0


def test_a_scenario_that_differs_in_the_ranging_has_the_same_way_and_sensors() -> None:
    a, b = sense(short(), 5), sense(short(ranging={"sigma_m": 2.0}), 5)
    np.testing.assert_array_equal(a.delta_theta_b, b.delta_theta_b)
    np.testing.assert_array_equal(a.start.position_m, b.start.position_m)  # type: ignore[arg-type]
    assert not np.array_equal(a.range_changes_m, b.range_changes_m)


def test_range_changes_are_those_of_the_path_modulo_a_symbol() -> None:
    scenario = short(ranging={"sigma_m": 1e-6})
    assert scenario.ranging.ambiguity_m == pytest.approx(80 * 299_792_458.0 / 20e6, rel=1e-15)
    sensed = sense(scenario, 2)
    far = np.linalg.norm(sensed.path.at(sensed.epochs_s).position_m[:, None] - np.array(PLACES), axis=2)
    far -= np.linalg.norm(sensed.path.at(0.0).position_m - np.array(PLACES), axis=1)
    assert far.min() < -50.0  # some came nearer
    wrapped = np.mod(sensed.range_changes_m - far + 500.0, scenario.ranging.ambiguity_m) - 500.0
    assert np.abs(wrapped).max() < 1e-4
    assert sensed.range_changes_m.min() >= 0.0


def test_the_state_of_the_report_is_the_error_of_15_states() -> None:
    """Its mean NEES is 15 over runs, biases that walk included, and its position is estimate minus truth."""
    values, runs = [], []
    walking = {"gyro_bias_walk_radps_per_rts": 4e-6, "accelerometer_bias_walk_mps2_per_rts": 1e-3}
    for seed in range(12):
        run = OfdmStrapdown().run(short(imu=walking), 100 + seed)
        assert run.truth is not None
        assert run.state is not None
        assert run.covariance is not None
        np.testing.assert_allclose(run.state[:, 6:9], run.position_m - run.truth.position_m, atol=1e-9)
        assert run.truth.velocity_mps is not None
        assert run.velocity_mps is not None
        np.testing.assert_allclose(run.state[:, 3:6], run.velocity_mps - run.truth.velocity_mps, atol=1e-9)
        values.append(float(nees(run.state[-1:], run.covariance[-1:])[0]))
        runs.append(metrics.evaluate(run, start_s=10.0))
    assert_consistent(values, 15)
    found = metrics.measure(runs)
    assert found["position"]["horizontal_rmse_m"] < 0.6
    assert found["heading"]["rmse_deg"] < 0.5
    assert found["measurements"]["rejected"] == 0


def test_a_minute_without_transmitters() -> None:
    """The spread grows as the error does, and a second after the transmitters are back both are small again."""
    scenario = short(duration_s=130.0, ranging={"outages_s": [[40.0, 100.0]]})
    lost, back = [], []
    for seed in range(10):
        run = OfdmStrapdown().run(scenario, 200 + seed)
        assert run.updates is not None
        outside = (run.updates.t_s <= 40.0) | (run.updates.t_s > 100.0)
        assert (run.updates.status[~outside] == "absent").all()
        assert np.mean(run.updates.accepted[outside]) > 0.99
        assert sigma_m(run, 100.0) > 5.0 * sigma_m(run, 40.0)
        assert sigma_m(run, 120.0) < 0.3 * sigma_m(run, 100.0)
        assert off_m(run, 120.0) < 6.0 * sigma_m(run, 120.0)
        assert run.notes == ("no transmitter heard from 40 to 100 s",)
        lost.append(position_nees(run, 100.0))
        back.append(position_nees(run, 120.0))
    assert_consistent(lost, 3)
    assert_consistent(back, 3)


def test_a_gap_of_the_inertial_unit() -> None:
    """Coasted over with more doubt, named in a note, and over soon."""
    run = OfdmStrapdown().run(short(duration_s=90.0, imu={"gaps_s": [[40.0, 41.5]]}), 7)
    assert run.notes == ("IMU: a gap, coasted over",)
    assert len(run.t_s) == 88
    before, after = (sigma_m(run, at) for at in (39.0, 42.0))
    assert after > 1.2 * before
    assert off_m(run, 42.0) < 6.0 * after
    assert off_m(run, 88.0) < 6.0 * sigma_m(run, 88.0) < 15.0


def test_alone_it_drifts_and_aided_it_does_not() -> None:
    scenario = short(duration_s=120.0)
    sensed = sense(scenario, 4)
    truth = sensed.path.at(np.array([120.0])).position_m[0]
    aided, alone = (navigate(scenario, sensed, aided=yes).position_m[-1] - truth for yes in (True, False))
    assert np.linalg.norm(alone) > 10.0 * np.linalg.norm(aided)


def test_a_transmitter_at_the_start() -> None:
    at_start = [{"position_ned_m": [0.0, 0.0, 0.0]}, *({"position_ned_m": place} for place in PLACES)]
    run = OfdmStrapdown().run(short(duration_s=20.0, transmitters=at_start), 3)
    assert np.isfinite(run.position_m).all()
    assert off_m(run, 20.0) < 6.0 * sigma_m(run, 20.0)


def test_presets_are_those_of_the_inertial_unit_and_keys_replace_them() -> None:
    assert StrapdownImuSettings().noise == ImuNoise.industrial_mems()
    grades = [StrapdownImuSettings(preset=name).noise for name in ("tactical", "industrial", "consumer")]
    assert [grade.gyro_density for grade in grades] == sorted(grade.gyro_density for grade in grades)
    own = StrapdownImuSettings(preset="consumer", gyro_bias_sigma_radps=0.0).noise
    assert own.gyro_bias_sigma_radps == 0.0
    assert own.gyro_density == grades[2].gyro_density


def test_a_way_through_waypoints() -> None:
    way = {"kind": "waypoints", "speed_mps": 10.0}
    scenario = short(
        duration_s=40.0,
        trajectory={**way, "waypoints_ned_m": [[5.0, 6.0, -1.0], [305.0, 6.0, -1.0], [305.0, 400.0, -9.0]]},
    )
    sensed = sense(scenario, 1)
    np.testing.assert_allclose(sensed.path.at(0.0).position_m[0], [5.0, 6.0, -1.0], atol=1.0)
    assert np.isfinite(navigate(scenario, sensed).position_m).all()
    with pytest.raises(ValueError, match=r"trajectory: the way takes .* s, and duration_s is 40; add waypoints"):
        sense(short(duration_s=40.0, trajectory={**way, "waypoints_ned_m": [[0.0] * 3, [100.0, 0.0, 0.0]]}), 1)


HEAD = 'system = "ofdm_strapdown"\n'
TAIL = "[origin]\nlatitude_deg = 48.1\nlongitude_deg = 11.6\n[[transmitters]]\nposition_ned_m = [900.0, 0.0, -30.0]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "duration_s = 0.5\n" + TAIL, r"duration_s: shorter than ranging.update_interval_s = 1"),
        (
            HEAD + "duration_s = 9.0\ntransmitters = []\n" + TAIL.split("[[")[0],
            "transmitters: at least 1 needed, got 0",
        ),
        (HEAD + "duration_s = 9.0\n" + TAIL[TAIL.index("[[") :], "origin: missing"),
        (HEAD + "duration_s = 9.0\noutput_rate_hz = 200.0\n" + TAIL, "output_rate_hz: more than imu.rate_hz = 100"),
        (HEAD + "duration_s = 9.0\n" + TAIL.replace("-30.0]", "-30.0, 1.0]"), "three numbers expected, got four"),
        (HEAD + "duration_s = 9.0\n" + TAIL.replace("= 48.1", "= 98.1"), "origin.latitude_deg: input should be less"),
        (
            HEAD + "duration_s = 9.0\n" + TAIL + '[imu]\npreset = "navigation"',
            "imu.preset: input should be 'consumer', 'industrial' or 'tactical'",
        ),
        (
            HEAD + "duration_s = 9.0\n" + TAIL + "[imu]\ngaps_s = [[4.0, 2.0]]",
            r"imu.gaps_s\[0\]: \[4, 2\] does not rise",
        ),
        (HEAD + "duration_s = 9.0\n" + TAIL + "[ranging]\nsigma_m = 0.0", "ranging.sigma_m: input should be greater"),
        (HEAD + "duration_s = 9.0\n" + TAIL + "[ranging]\nprefix = 64", "prefix: 64: fewer than the 64 samples"),
        (
            HEAD + "duration_s = 9.0\n" + TAIL + "[ranging]\noutages_s = [[1.0]]",
            r"ranging.outages_s\[0\]: a list of two numbers expected",
        ),
        (HEAD + "duration_s = 9.0\n" + TAIL + "[start]\ntilt_deg = 1.0", "start.tilt_deg: unknown key; did you mean"),
        (
            HEAD + "duration_s = 9.0\n" + TAIL + "[trajectory]\nspeed_mps = 30.0",
            "leg_m: legs of 150 m leave no room for corners; at least .* = 600 m expected",
        ),
        (HEAD + "duration_s = 9.0\n" + TAIL + "[trajectory]\nradius_m = 700.0", "leg_m: 400: at most half of radius_m"),
        (HEAD + "duration_s = 9.0\n" + TAIL + '[trajectory]\nkind = "waypoints"', "waypoints_ned_m go together"),
        (HEAD + "duration_s = 9.0\n" + TAIL + "[filter]\ngate_m = -1.0", "filter.gate_m: input should be greater"),
    ],
)
def test_scenarios_that_do_not_fit(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        scenarios.load(path)
