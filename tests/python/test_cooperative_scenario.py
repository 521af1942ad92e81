"""Scenarios of ``cooperative``: from bursts to the target's place, what is refused, the gallery."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp import navigation, scenarios
from soopnav_cpp.cli.app import cli
from soopnav_cpp.config import ConfigError
from soopnav_cpp.experiments import mei_setup
from soopnav_cpp.scenarios.cooperative import EXAMPLE, Cooperative, CooperativeScenario

ROOT = Path(__file__).parents[2]


def short(**changes: Any) -> CooperativeScenario:
    fields: dict[str, Any] = {"system": "cooperative", "duration_s": 150.0, "stage": "drawn", **changes}
    return CooperativeScenario.model_validate(fields)


def horizontal_m(run: Any) -> Any:
    return np.linalg.norm((run.position_m - run.truth.position_m)[:, :2], axis=1)


def test_a_static_target_is_found() -> None:
    """Sigmas of the bound and an OCXO: metres, stated as such."""
    scenario = short(bursts={"sigma_tdoa_s": 148e-9, "sigma_fdoa_hz": 45e-3})
    run: Any = Cooperative().run(scenario, 1)
    again: Any = Cooperative().run(scenario, 1)
    assert np.array_equal(run.state, again.state)
    stated = np.sqrt(np.trace(run.position_covariance_m2[:, :2, :2], axis1=1, axis2=2))
    assert horizontal_m(run)[-1] < 5.0 * stated[-1] < 200.0
    assert run.start_error_m < 2000.0
    # 5 unknowns: a chi-square of 5 is below 26 but for 1e-4
    assert run.nees[-1] < 26.0
    assert run.dimension == 5
    assert len(run.t_s) == len(run.campaign) - 90
    assert np.linalg.norm(run.truth.position_m[0]) == pytest.approx(10e3, rel=1e-2)
    assert set(Cooperative().figures(scenario, run)) == {"clock_and_position", "measurements"}
    numbers = Cooperative().numbers(scenario, run)
    assert numbers["measured"] == numbers["bursts"] == 150


def test_how_the_start_ended_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that fits nothing is no run; one of several places is, and the notes say so."""
    bursts = {"sigma_tdoa_s": 148e-9, "sigma_fdoa_hz": 45e-3}
    run: Any = Cooperative().run(short(bursts=bursts), 1)
    assert Cooperative().numbers(short(), run)["start_status"] == run.start_status == "found"
    assert run.notes == ()
    begin = navigation.CooperativeTracker.start

    def two_places(self: Any, batch: Any, **search: Any) -> Any:
        start = begin(self, batch, **search)
        other = start.mean[None] + 1e3
        status = navigation.PairStartStatus.AMBIGUOUS
        return SimpleNamespace(mean=start.mean, status=status, ok=False, alternatives=other)

    monkeypatch.setattr(navigation.CooperativeTracker, "start", two_places)
    two: Any = Cooperative().run(short(bursts=bursts), 1)
    assert two.start_status == "ambiguous"
    assert two.notes == ("the batch start is ambiguous: other places that fit as well: 1",)
    monkeypatch.setattr(navigation.CooperativeTracker, "start", begin)
    made = mei_setup.campaign

    def overconfident(*arguments: Any, **options: Any) -> Any:
        campaign = made(*arguments, **options)
        return replace(campaign, covariance=1e-3 * campaign.covariance)

    monkeypatch.setattr(mei_setup, "campaign", overconfident)
    with pytest.raises(ValueError, match=r"gave no start: .*POOR_FIT"):
        Cooperative().run(short(bursts=bursts), 1)


def test_a_driving_target_is_followed_by_velocity_states() -> None:
    scenario = short(
        pair={"motion": "drive"},
        tracker={"motion": "nearly_constant_velocity"},
        bursts={"sigma_tdoa_s": 148e-9, "sigma_fdoa_hz": 45e-3},
    )
    run: Any = Cooperative().run(scenario, 2)
    assert run.dimension == 8
    assert np.ptp(run.truth.position_m, axis=0).max() > 200.0
    assert np.median(horizontal_m(run)[-30:]) < 1000.0


def test_a_drive_is_held_by_two_motions_and_lost_by_one_that_stands() -> None:
    system, scenario = scenarios.load(ROOT / "examples" / "scenarios" / "mei_drive.toml")
    scenario = scenario.model_copy(update={"stage": "drawn", "duration_s": 200.0})
    run: Any = system.run(scenario, 4)
    error = horizontal_m(run)
    lost = np.linalg.norm((run.baselines["taken to stand still"] - run.truth.position_m)[:, :2], axis=1)
    assert len(run.t_s) == len(run.campaign) == 200
    assert np.sqrt(np.mean(error[60:] ** 2)) < 300.0
    assert np.sqrt(np.mean(lost[60:] ** 2)) > 3.0 * np.sqrt(np.mean(error[60:] ** 2))


def test_from_iq() -> None:
    """The whole chain, shortened: 110 bursts, a start from 90."""
    scenario = short(stage="iq", duration_s=110.0)
    run: Any = Cooperative().run(scenario, 1)
    numbers = Cooperative().numbers(scenario, run)
    assert numbers["measured"] >= 106
    # 110 draws: sigma to 7 %, five times that
    assert numbers["tdoa_rms_s"] == pytest.approx(2.7e-6, rel=0.35)
    assert numbers["tdoa_sigma_s"] == pytest.approx(2.5e-6, rel=0.2)
    stated = np.sqrt(np.trace(run.position_covariance_m2[:, :2, :2], axis1=1, axis2=2))
    assert horizontal_m(run)[-1] < 5.0 * stated[-1]


@pytest.mark.slow
def test_the_command_writes_report_and_figures(tmp_path: Path) -> None:
    text = EXAMPLE.replace("duration_s = 300.0", "duration_s = 110.0").replace("= 240.0", "= 100.0")
    (tmp_path / "pair.toml").write_text(text)
    result = CliRunner().invoke(cli, ["run", str(tmp_path / "pair.toml"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["cooperative"]["measured"] >= 106
    assert (tmp_path / "out" / "measurements.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration_s": 60.0}, "60 bursts; more than tracker.start_bursts = 90"),
        ({"bursts": {"snr_db": -30.0}}, "bursts.snr_db"),
        ({"pair": {"motion": "flight"}}, "pair.motion"),
        ({"stage": "real"}, "stage"),
    ],
)
def test_refuses(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    lines = {"system": '"cooperative"', "duration_s": "150.0"}
    tables = ""
    for key, value in changes.items():
        if isinstance(value, dict):
            tables += f"[{key}]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in value.items())
        else:
            lines[key] = json.dumps(value)
    path = tmp_path / "pair.toml"
    path.write_text("".join(f"{k} = {v}\n" for k, v in lines.items()) + tables)
    with pytest.raises(ConfigError) as refused:
        scenarios.load(path)
    assert message in str(refused.value)


@pytest.mark.parametrize("name", ["mei_static", "mei_drive"])
def test_gallery_loads(name: str) -> None:
    system, scenario = scenarios.load(ROOT / "examples" / "scenarios" / f"{name}.toml")
    assert system.name == "cooperative"
    assert scenario.runs == 20
