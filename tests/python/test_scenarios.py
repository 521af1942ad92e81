"""Scenarios: how they are loaded, refused, run and measured."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
import tomlkit

from soopnav_cpp import estimation, scenarios
from soopnav_cpp.config import ConfigError
from soopnav_cpp.scenarios import Scenario, SystemRun, Truth, Updates, execution, metrics, registry, report, schema

pytestmark = pytest.mark.unit

SCENARIO = """\
system = "cart"
title = "A cart"
duration_s = 5.0
sigma_m = 2.0
runs = 6

[[anchors]]
name = "A"
position_m = [120.0, 0.0, 0.0]
[[anchors]]
name = "B"
position_m = [-80.0, 150.0, 0.0]
[[anchors]]
name = "C"
position_m = [0.0, -140.0, 0.0]
"""


@pytest.fixture
def cart(monkeypatch):
    """The system ``cart``, of a module that other processes can import too."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "support")
    import cart_system

    system = cart_system.Cart()
    monkeypatch.setitem(scenarios.SYSTEMS._systems, "cart", system)
    return system


@pytest.fixture
def path(tmp_path, cart):
    file = tmp_path / "cart.toml"
    file.write_text(SCENARIO)
    return file


def refusal(path, text, **options):
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        scenarios.load(path, **options)
    return str(caught.value).replace(str(path.parent) + "/", "")


# ---- loading


def test_a_scenario_with_its_system(path, cart):
    system, scenario = scenarios.load(path)
    assert system is cart
    assert isinstance(scenario, cart.scenario)
    assert (scenario.title, scenario.duration_s, scenario.runs, scenario.seed) == ("A cart", 5.0, 6, 1)
    assert [anchor.name for anchor in scenario.anchors] == ["A", "B", "C"]
    _, other = scenarios.load(path, seed=9, runs=2)
    assert (other.seed, other.runs) == (9, 2)
    assert other.anchors == scenario.anchors


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("runs = 6", "run = 6", "cart.toml:5: run: unknown key; did you mean runs?"),
        ("sigma_m = 2.0", "rate_hz = 1.0", "cart.toml:1: sigma_m: missing"),
        ("duration_s = 5.0", 'duration_s = "5"', "cart.toml:3: duration_s: input should be a valid number"),
        ("duration_s = 5.0", "duration_s = 0", "cart.toml:3: duration_s: input should be greater than 0"),
        ("runs = 6", "runs = 0", "cart.toml:5: runs: input should be greater than or equal to 1"),
        ("runs = 6", "runs = 2.5", "cart.toml:5: runs: input should be a valid integer"),
        ("runs = 6", 'recording = "imu.csv"', "cart.toml:5: recording: imu.csv: no such file"),
        ("runs = 6", "recording = 3", "cart.toml:5: recording: the name of a file expected"),
        ("runs = 6", 'recording = "."', "cart.toml:5: recording: FOLDER: a folder; a file expected"),
        ("runs = 6", "origin = {latitude_deg = 91, longitude_deg = 0}",
         "cart.toml:5: origin.latitude_deg: input should be less than or equal to 90"),
        ("[-80.0, 150.0, 0.0]", "[-80.0, 150.0]",
         "cart.toml:12: anchors[1].position_m: three numbers expected, got two"),
        ('system = "cart"', 'system = "card"', "cart.toml:1: system: unknown system 'card'; did you mean cart?"),
        ('system = "cart"', "system = 3", "cart.toml:1: system: input should be a valid string"),
        ('system = "cart"', "", "cart.toml:1: system: missing"),
        ("sigma_m = 2.0", "sigma_m 2.0", "cart.toml:4: not TOML:"),
    ],
)  # fmt: skip
def test_mistakes_point_at_their_line(path, old, new, sentence):
    found = refusal(path, SCENARIO.replace(old, new, 1)).replace(str(path.parent), "FOLDER")
    assert found.startswith(sentence), found
    assert len(found.splitlines()) == 1


def test_a_system_that_is_nowhere_near_names_those_there_are(path):
    found = refusal(path, SCENARIO.replace('"cart"', '"zzzzzz"', 1))
    assert found.startswith("cart.toml:1: system: unknown system 'zzzzzz'; there are ")
    assert "cart" in found.split("there are ")[1]


def test_a_missing_scenario(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml: no such file or directory"):
        scenarios.load(tmp_path / "none.toml")


@pytest.mark.parametrize(("name", "value"), [("runs", 0), ("seed", -1), ("seed", 2**63)])
def test_overrides_out_of_range(path, name, value):
    with pytest.raises(ValueError, match=f"{name} = {value}: "):
        scenarios.load(path, **{name: value})


def test_files_count_from_the_folder_of_the_scenario(path, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    (path.parent / "data").mkdir()
    (path.parent / "data" / "imu.csv").write_text("time_s\n")
    path.write_text(SCENARIO.replace("runs = 6", 'recording = "data/imu.csv"'))
    _, scenario = scenarios.load(path)
    assert scenario.recording == path.parent / "data" / "imu.csv"


# ---- systems


class Still:
    name = "still"
    scenario = Scenario

    def run(self, scenario, seed):
        return made()


def test_what_can_be_registered():
    systems = registry.Systems()
    still = Still()
    assert systems.add(still) is still
    assert systems.get("still") is still
    assert systems.all() == [still]
    systems.add(Still())  # the same class again, as when a module is loaded anew
    for name, model, sentence in (
        ("Still", Scenario, "a name in lower case"),
        (None, Scenario, "a name in lower case"),
        ("moving", dict, "a subclass of Scenario expected"),
        ("still", Scenario, "still: already registered"),
    ):
        wrong = type("Wrong", (), {"name": name, "scenario": model})()
        with pytest.raises(ValueError, match=sentence):
            systems.add(wrong)
    with pytest.raises(ValueError, match="unknown system 'stil'; did you mean still"):
        systems.get("stil")
    with pytest.raises(ValueError, match="there are none"):
        registry.Systems().get("still")


def test_register_takes_classes_and_instances(monkeypatch):
    mine = registry.Systems()
    monkeypatch.setattr(registry, "SYSTEMS", mine)
    assert registry.register(Still) is Still
    assert isinstance(mine.get("still"), Still)


def test_systems_of_other_packages_are_found_by_their_entry_point(tmp_path, monkeypatch):
    (tmp_path / "buoy_package.py").write_text(
        "from soopnav_cpp.scenarios import Scenario, register\n\n"
        "@register\nclass Buoy:\n    name = 'buoy'\n    scenario = Scenario\n    def run(self, scenario, seed): ...\n"
    )
    info = tmp_path / "buoy_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: buoy-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[soopnav.systems]\nbuoy = buoy_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    mine = registry.Systems(discover=True)
    monkeypatch.setattr(registry, "SYSTEMS", mine)
    assert mine.get("buoy").name == "buoy"
    monkeypatch.delitem(sys.modules, "buoy_package")
    (info / "entry_points.txt").write_text("[soopnav.systems]\nbuoy = buoy_pack\n")
    with pytest.raises(ValueError, match=r"system buoy \(buoy_pack\) cannot be imported: No module named 'buoy_pack'"):
        registry.Systems(discover=True).all()


def test_the_example_of_a_system_is_a_scenario(cart, tmp_path):
    file = tmp_path / "example.toml"
    file.write_text(cart.example)
    assert scenarios.load(file)[1].title == "A cart among three anchors"


def test_the_schema_is_a_scenario_when_its_needed_keys_are_filled_in(cart, tmp_path):
    text = schema.describe(cart.scenario, cart.name)
    needed = {"duration_s": "5.0", "sigma_m": "2.0", "name": '"A"', "position_m": "[1.0, 2.0, 3.0]"}
    for key, value in needed.items():
        assert f"\n{key} =              # needed" in text
        text = text.replace(f"\n{key} =              # needed", f"\n{key} = {value}")
    content = tomlkit.parse(text).unwrap()
    content["anchors"] = content["anchors"] * 2
    assert cart.scenario.model_validate(content).rate_hz == 4.0
    assert "\n#rate_hz = 4.0\n" in text
    assert "\n# Standard deviation of a range. [number > 0]\n" in text
    assert "\n#[origin]\n" in text
    with_origin = re.sub(
        r"\n#(?=\[origin\]|l[a-z]+itude_deg)", "\n", text.replace("deg =              # needed", "deg = 7.5")
    )
    content["origin"] = tomlkit.parse(with_origin).unwrap()["origin"]
    assert cart.scenario.model_validate(content).origin.longitude_deg == 7.5
    assert "# A place that ranges. (needed, any number)\n[[anchors]]" in text


# ---- what a system hands back


def made(n=4, **changes):
    given = {
        "t_s": np.arange(1.0, n + 1.0),
        "position_m": np.zeros((n, 2)),
        "position_covariance_m2": np.tile(np.eye(2), (n, 1, 1)),
    }
    return SystemRun(**(given | changes))


def updates(m=4, **changes):
    given = {
        "t_s": np.arange(m, dtype=float),
        "source": np.zeros(m, int),
        "innovation": np.ones(m),
        "variance": np.ones(m),
        "status": ["accepted"] * m,
    }
    return Updates(**(given | changes))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"t_s": [1.0, 2.0, 2.0, 3.0]}, r"t_s\[2\] = 2 after 2: time must rise"),
        ({"t_s": [], "position_m": np.zeros((0, 2))}, "t_s: at least one time"),
        ({"position_m": np.zeros((3, 2))}, r"position_m: expected shape \(4, n\), got \(3, 2\)"),
        ({"position_m": np.zeros((4, 4))}, "position_m: two or three components expected, got 4"),
        ({"position_m": np.full((4, 2), np.nan)}, r"position_m\[0, 0\]: a finite number expected"),
        ({"position_covariance_m2": np.eye(2)}, "position_covariance_m2: expected shape"),
        ({"velocity_mps": np.zeros((4, 3))}, r"velocity_mps: expected shape \(4, 2\)"),
        ({"state": np.zeros((4, 1))}, r"state: expected shape \(4, 0\)"),
        ({"truth": Truth(position_m=np.zeros((3, 2)))}, r"truth.position_m: expected shape \(4, 2\)"),
        ({"truth": Truth(position_m=np.zeros((4, 2)), state=np.zeros((4, 1)))}, "truth.state: expected shape"),
        ({"baselines": {"INS": np.zeros((3, 2))}}, r"baselines\['INS'\]: expected shape"),
        ({"sources": {"A": [1.0, 2.0, 3.0]}}, r"sources\['A'\]: expected shape"),
        ({"axes": "xyz"}, "axes: 'xyz': enu or ned expected"),
    ],
)
def test_runs_that_do_not_fit(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        made(**changes)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"innovation": [1.0]}, r"innovation: expected shape \(4\)"),
        ({"source": [0.5] * 4}, "source: expected 4 integers"),
        ({"source": [-1, 0, 0, 0]}, "source: -1: no negative index"),
        ({"source": [0, 1, 2, 0], "source_names": ("A", "B")}, "source: 2 among 2 source_names"),
        ({"status": ["accepted"]}, "status: expected 4, got 1"),
        ({"status": [1.5] * 4}, "status: 1.5: an UpdateStatus or a word expected"),
    ],
)
def test_updates_that_do_not_fit(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        updates(**changes)


def test_the_status_of_a_filter_becomes_words():
    S = estimation.UpdateStatus
    found = updates(status=[S.ACCEPTED, int(S.GATED), "REJECTED", np.uint8(int(S.ABSENT))], source=[0, 1, 1, 0])
    assert found.status.tolist() == ["accepted", "gated", "rejected", "absent"]
    assert found.source_names == ("source 1", "source 2")
    assert found.accepted.tolist() == [True, False, False, False]
    assert found.offered.tolist() == [True, True, True, False]
    strange = updates(innovation=[2.0, np.nan, 1.0, 1.0], variance=[2.0, 1.0, 0.0, -1.0])
    np.testing.assert_array_equal(strange.nis, [2.0, np.nan, np.nan, np.nan])


# ---- metrics


def noisy(seed, n=400, scale=1.0, dim=2):
    """Independent errors of a random covariance, stated as it is; `scale` of the errors."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(dim, dim)) + 2.0 * np.eye(dim)
    truth = rng.normal(size=(n, dim)) * 50.0
    error = scale * rng.normal(size=(n, dim)) @ root.T
    heading = rng.uniform(-math.pi, math.pi, n)
    turn = rng.normal(0.0, 0.1, n)
    state = np.column_stack([truth + error, heading + turn])
    P = np.zeros((n, dim + 1, dim + 1))
    P[:, :dim, :dim], P[:, dim, dim] = root @ root.T, 0.01
    names = (*(f"{a}_m" for a in "xyz"[:dim]), "heading_rad")
    return SystemRun(
        t_s=np.arange(n) * 0.5,
        position_m=truth + error,
        position_covariance_m2=P[:, :dim, :dim],
        velocity_mps=error,
        heading_rad=heading + turn + 2.0 * math.pi,
        state_names=names,
        state=state,
        covariance=P,
        truth=Truth(
            position_m=truth,
            velocity_mps=np.zeros((n, dim)),
            heading_rad=heading,
            state=np.column_stack([truth, heading - 4.0 * math.pi]),
        ),
        baselines={"INS alone": truth + 3.0 * error},
    ), error, turn, root @ root.T  # fmt: skip


@pytest.mark.parametrize("dim", [2, 3])
def test_metrics_are_what_numpy_makes_of_the_errors(dim):
    run, error, turn, P = noisy(3, dim=dim)
    found = metrics.measure([metrics.evaluate(run, start_s=10.0)])
    kept, n = error[20:], 380
    distance = np.linalg.norm(kept, axis=1)
    flat = np.linalg.norm(kept[:, :2], axis=1)
    assert found["epochs"] == n
    position = found["position"]
    assert position["rmse_m"] == pytest.approx(np.sqrt(np.mean(distance**2)))
    assert position["rmse_axes_m"] == pytest.approx(np.sqrt(np.mean(kept**2, axis=0)).tolist())
    assert position["horizontal_rmse_m"] == pytest.approx(np.sqrt(np.mean(flat**2)))
    assert position["max_m"] == pytest.approx(distance.max())
    assert position["max_at_s"] == pytest.approx(run.t_s[20 + distance.argmax()])
    assert position["final_m"] == pytest.approx(distance[-1])
    assert np.mean(flat <= position["cep50_m"] * (1 + 1e-12)) == pytest.approx(0.5, abs=1.5 / n)
    assert np.mean(flat <= position["cep95_m"] * (1 + 1e-12)) == pytest.approx(0.95, abs=1.5 / n)
    assert found["velocity"]["rmse_mps"] == pytest.approx(position["rmse_m"])
    assert found["heading"]["rmse_deg"] == pytest.approx(math.degrees(np.sqrt(np.mean(turn[20:] ** 2))))
    square = np.einsum("ni,ij,nj->n", kept, np.linalg.inv(P), kept)
    assert found["nees"]["mean"] == pytest.approx(square.mean())
    assert found["state_nees"]["mean"] == pytest.approx((square + turn[20:] ** 2 / 0.01).mean())
    assert (found["nees"]["expected"], found["state_nees"]["expected"]) == (dim, dim + 1)
    assert found["nees"]["bounds"] == pytest.approx(scipy.stats.chi2.ppf([0.005, 0.995], dim).tolist(), rel=1e-6)
    sigma = np.sqrt(np.diag(P))
    for k in (1, 2, 3):
        row = found["coverage"][f"{k}_sigma"]
        assert row["share"] == pytest.approx(np.mean(np.abs(kept) <= k * sigma))
        assert row["expected"] == pytest.approx(scipy.stats.chi2.cdf(k * k, 1))
    assert found["stated_sigma_m"]["rms"] == pytest.approx(np.sqrt(np.trace(P)))
    assert found["baselines"]["INS alone"]["rmse_m"] == pytest.approx(3.0 * position["rmse_m"])
    assert found["baselines"]["INS alone"]["cep50_m"] == pytest.approx(3.0 * position["cep50_m"])
    assert found["baselines"]["INS alone"]["final_m"] == pytest.approx(3.0 * position["final_m"])


def test_pooled_metrics_are_those_of_all_errors_together():
    runs = [noisy(seed) for seed in range(5)]
    series = [metrics.evaluate(run) for run, *_ in runs]
    found = metrics.measure(series)
    everything = np.linalg.norm(np.vstack([error for _, error, *_ in runs]), axis=1)
    assert found["position"]["rmse_m"] == pytest.approx(np.sqrt(np.mean(everything**2)))
    assert found["position"]["max_m"] == pytest.approx(everything.max())
    assert found["nees"]["bounds"] == pytest.approx((scipy.stats.chi2.ppf([0.005, 0.995], 10) / 5).tolist(), rel=1e-6)
    curves = metrics.series_over_runs(series)
    at_7 = [np.sum(error[7] ** 2) for _, error, *_ in runs]
    assert curves["rms_m"][7] == pytest.approx(np.sqrt(np.mean(at_7)))
    assert curves["rms_m:INS alone"][7] == pytest.approx(3.0 * np.sqrt(np.mean(at_7)))
    assert curves["nees"].mean() == pytest.approx(found["nees"]["mean"])
    assert metrics.series_over_runs([series[0], metrics.evaluate(noisy(1, n=30)[0])]) is None


@pytest.mark.consistency
def test_a_right_covariance_is_inside_its_bounds_and_a_wrong_one_is_not():
    right = metrics.measure([metrics.evaluate(noisy(seed)[0]) for seed in range(30)])
    assert right["nees"]["inside"]
    assert right["state_nees"]["inside"]
    assert all(row["inside"] for row in right["coverage"].values())
    wrong = metrics.measure([metrics.evaluate(noisy(seed, scale=2.0)[0]) for seed in range(30)])
    assert not wrong["nees"]["inside"]
    assert wrong["nees"]["mean"] == pytest.approx(8.0, rel=0.1)
    assert not wrong["coverage"]["1_sigma"]["inside"]


def test_measurements_are_counted_by_source_and_status():
    run, *_ = noisy(1)
    given = updates(
        6,
        source=[0, 0, 1, 1, 1, 2],
        innovation=[1.0, 2.0, 3.0, 30.0, np.nan, 1.0],
        variance=np.full(6, 4.0),
        status=["accepted", "accepted", "accepted", "gated", "non_finite", "absent"],
        source_names=("A", "B", "C"),
    )
    run = SystemRun(**{f: getattr(run, f) for f in run.__dataclass_fields__} | {"updates": given})
    found = metrics.measure([metrics.evaluate(run), metrics.evaluate(run)])
    counts = found["measurements"]
    assert (counts["offered"], counts["rejected"]) == (10, 4)
    assert counts["by_source"]["A"] == {
        "offered": 4, "accepted": 4, "rejected": 0, "status": {"accepted": 4}, "mean_nis": pytest.approx(0.625),
    }  # fmt: skip
    assert counts["by_source"]["B"]["status"] == {"accepted": 2, "gated": 2, "non_finite": 2}
    assert counts["by_source"]["C"]["offered"] == 0
    assert counts["by_source"]["C"]["mean_nis"] is None
    assert found["nis"]["count"] == 6
    assert found["nis"]["mean"] == pytest.approx((0.25 + 1.0 + 2.25) / 3.0)
    assert found["nis"]["mean_with_rejected"] == pytest.approx((0.25 + 1.0 + 2.25 + 225.0) / 4.0)


def test_without_a_truth_there_are_no_errors():
    found = metrics.measure([metrics.evaluate(made(updates=updates()))])
    assert [found[key] for key in ("position", "velocity", "heading", "coverage", "nees", "state_nees")] == [None] * 6
    assert found["stated_sigma_m"]["final"] == pytest.approx(math.sqrt(2.0))
    assert found["nis"]["mean"] == 1.0


def test_a_covariance_without_inverse_is_counted_and_not_judged():
    run = made(truth=Truth(position_m=np.zeros((4, 2))), position_covariance_m2=np.zeros((4, 2, 2)))
    found = metrics.measure([metrics.evaluate(run)])
    assert found["nees"]["mean"] is None
    assert found["nees"]["undefined_epochs"] == 4
    assert not found["nees"]["inside"]


def test_metrics_that_start_after_the_end():
    with pytest.raises(ValueError, match="metrics_start_s = 9: the run ends before, at 4 s"):
        metrics.evaluate(made(), start_s=9.0)


def test_a_quaternion_gives_a_heading():
    half = np.array([0.1, 1.0, -1.4, 1.6])
    turn = np.column_stack([np.cos(half), np.zeros(4), np.zeros(4), np.sin(half)])
    np.testing.assert_allclose(
        np.exp(1j * metrics.heading_of(made(quaternion_wxyz=turn))), np.exp(2j * half), rtol=1e-14
    )


# ---- many runs


def test_runs_depend_on_their_number_alone(path):
    system, scenario = scenarios.load(path)
    outcomes = execution.execute(system, scenario)
    assert [outcome.number for outcome in outcomes] == [1, 2, 3, 4, 5, 6]
    assert len({outcome.seed for outcome in outcomes}) == 6
    assert outcomes[0].run is not None
    assert all(outcome.run is None for outcome in outcomes[1:])
    [alone] = execution.execute(system, scenario, only=4)
    assert alone.seed == outcomes[3].seed
    np.testing.assert_array_equal(alone.series.error_m, outcomes[3].series.error_m)
    np.testing.assert_array_equal(alone.run.position_m - alone.run.truth.position_m, alone.series.error_m)
    other = execution.execute(system, scenario.model_copy(update={"seed": 2, "runs": 1}))
    assert other[0].seed != outcomes[0].seed
    with pytest.raises(ValueError, match="only = 0"):
        execution.execute(system, scenario, only=0)


def test_any_number_of_processes_gives_the_same_results(path):
    system, scenario = scenarios.load(path)
    told = []

    def step(description, *, done=None, total=None):
        told.append((description, done, total))

    one = execution.execute(system, scenario)
    two = execution.execute(system, scenario, jobs=2, step=step)
    first, second = (report.as_json(report.results_of(path, system, scenario, x)) for x in (one, two))
    assert first == second
    assert told == [("run 1 of 6", 0, 6), *((f"run {k} of 6", k, 6) for k in range(1, 7))]
    np.testing.assert_array_equal(one[0].run.state, two[0].run.state)


def test_a_run_that_fails_does_not_take_the_others_with_it(path):
    system, scenario = scenarios.load(path)
    seeds = [execution.seed_of_run(scenario, number) for number in (1, 3)]
    failing = scenario.model_copy(update={"fail_run_seeds": seeds})
    said = []
    outcomes = execution.execute(system, failing, failed=said.append)
    assert [outcome.number for outcome in said] == [1, 3]
    assert str(said[0]) == f"run 1 (seed {seeds[0]}): RuntimeError: the cart broke down"
    assert "cart_system.py" in said[0].details
    assert [bool(outcome.error) for outcome in outcomes] == [True, False, True, False, False, False]
    assert outcomes[1].run is not None  # the first good one is kept in place of run 1
    results = report.results_of(path, system, failing, outcomes)
    assert results.number == 2
    assert len(results.each) == 4
    assert "too sure of itself" not in report.verdict(results)
    doubting = failing.model_copy(update={"stated_sigma_m": 0.5})
    verdict = report.verdict(report.results_of(path, system, doubting, execution.execute(system, doubting)))
    assert re.search(r"the filter is too sure of itself \(NEES \d+\.\d\d, 2 expected\)", verdict)
    assert "2 of 6 runs failed" in report.verdict(results)
    everything = failing.model_copy(update={"runs": 1})
    assert report.results_of(path, system, everything, execution.execute(system, everything)) is None


def test_a_process_that_dies_is_named(path):
    system, scenario = scenarios.load(path)
    dying = scenario.model_copy(update={"die_run_seeds": [execution.seed_of_run(scenario, 2)]})
    outcomes = execution.execute(system, dying, jobs=2)
    assert len(outcomes) == 6
    assert [outcome.number for outcome in outcomes] == [1, 2, 3, 4, 5, 6]
    assert "its process died" in outcomes[1].error


def test_an_origin_of_the_scenario_places_the_run(path):
    path.write_text(SCENARIO.replace("runs = 6", "origin = {latitude_deg = 52.0, longitude_deg = 13.0}"))
    system, scenario = scenarios.load(path)
    [outcome] = execution.execute(system, scenario)
    assert outcome.run.origin_lla_deg == (52.0, 13.0, 0.0)
