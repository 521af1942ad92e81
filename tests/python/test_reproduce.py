"""``soopnav reproduce``: registry, seeds, claims and how a failure shows."""

import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from click.testing import CliRunner

from soopnav_cpp import experiments
from soopnav_cpp.cli.app import cli
from soopnav_cpp.experiments import nielsen_references, nielsen_setups
from soopnav_cpp.experiments.registry import (
    Claim,
    Registry,
    Workers,
    above,
    at_least,
    at_most,
    band,
    below,
    condition,
    derive_seed,
    falling,
    matching,
    near,
    perform,
    rising,
    write_claims,
)

KEYS = ["id", "claim", "source", "measured", "required", "holds", "seed", "runs"]
NAN, INF = math.nan, math.inf


@pytest.fixture
def registry(monkeypatch):
    """An empty registry, which the command uses as well."""
    mine = Registry()
    monkeypatch.setattr(experiments, "load", lambda: mine)
    return mine


@pytest.fixture
def draws(tmp_path, monkeypatch):
    """A module that other processes can import, with one run of an experiment."""
    (tmp_path / "drawn_elsewhere.py").write_text(
        "import numpy as np\n\ndef draw(seed, sigma):\n    return np.random.default_rng(seed).normal(0.0, sigma)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import drawn_elsewhere

    yield drawn_elsewhere
    del sys.modules["drawn_elsewhere"]


def register(registry, id, claims, *, runs=1, values=None):
    """An experiment that yields `claims`, with a figure and data."""

    @registry.experiment(id, title=f"title of {id}", source=f"paper, {id}", runs=runs)
    def body(lab):
        with lab.figure(2.0, 1.5) as figure:
            figure.add_subplot().plot([0.0, 1.0])
        lab.save(values=[1.0] if values is None else values(lab))
        yield from claims

    return body


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, ["reproduce", *(str(a) for a in arguments)], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


# ---- conditions


@pytest.mark.unit
@pytest.mark.parametrize(
    ("required", "numbers", "holds"),
    [
        (band(1.0, 2.0), (1.0, 2.0), True),
        (band(1.0, 2.0), (1.5, 2.0001), False),
        (at_most(3.0), (3.0, -7.0), True),
        (at_most(3.0), (3.0, 3.1), False),
        (at_least(3.0), (3.0, 9.0), True),
        (at_least(3.0), (2.9,), False),
        (below(3.0), (2.9,), True),
        (below(3.0), (3.0,), False),
        (above(3.0), (3.1,), True),
        (above(3.0), (3.0,), False),
        (near(10.0, within=0.5), (9.5, 10.5), True),
        (near(10.0, within=0.5), (9.49,), False),
        (matching([0.182574, 0.374473], decimals=6), (0.1825741, 0.3744725001), True),
        (matching([0.182574, 0.374473], decimals=6), (0.1825746, 0.374473), False),
        (matching([1.0, 2.0], decimals=1), (1.0,), False),
        (rising(), (1.0, 2.0, 3.0), True),
        (rising(), (1.0, 1.0), False),
        (rising(), (1.0,), False),
        (rising(by=2.0), (1.0, 2.0, 4.0), True),
        (rising(by=2.0), (1.0, 1.9), False),
        (rising(by=2.0), (-1.0, 5.0), False),
        (falling(), (3.0, 1.0, -1.0), True),
        (falling(), (1.0, 2.0), False),
        (falling(by=3.0), (9.0, 3.0, 1.0), True),
        (falling(by=3.0), (9.0, 3.1), False),
        (falling(by=3.0), (9.0, -1.0), False),
        (condition("even", lambda m: all(v % 2 == 0 for v in m)), (2.0, 4.0), True),
        (condition("even", lambda m: all(v % 2 == 0 for v in m)), (2.0, 3.0), False),
    ],
)
def test_conditions(required, numbers, holds):
    assert required.holds(numbers) is holds
    assert Claim("it is so", numbers, required).holds is holds


@pytest.mark.unit
@pytest.mark.parametrize("required", [at_most(1e9), at_least(-1e9), above(-INF), below(INF), condition("any", bool)])
@pytest.mark.parametrize("numbers", [(), (NAN,), (1.0, NAN), (INF,), (-INF, 2.0)])
def test_no_number_and_no_finite_number_never_hold(required, numbers):
    assert not required.holds(numbers)


@pytest.mark.unit
def test_conditions_say_what_they_ask():
    assert band(0.55, 0.7, "m").words == "0.55 … 0.7 m"
    assert at_most(1e-4).words == "≤ 0.0001"
    assert at_least(12, "dB").words == "≥ 12 dB"
    assert near(6.35, within=0.01, unit="dB").words == "6.35 ± 0.01 dB"
    assert matching([0.18257, 1.0], decimals=3).words == "0.183, 1.000 to 3 decimals"
    assert rising(by=3.0).words == "rising, each at least 3 times"
    for refused in (
        lambda: band(2.0, 1.0),
        lambda: band(NAN, 1.0),
        lambda: near(0.0, within=0.0),
        lambda: matching([], decimals=3),
        lambda: rising(by=0.5),
        lambda: falling(by=NAN),
    ):
        with pytest.raises(ValueError, match="expected"):
            refused()


# ---- registry and seeds


@pytest.mark.unit
def test_ids_are_ordered_and_matched(registry):
    for name in ("paper-10", "paper-9", "paper-4.10", "paper-4.2", "other-x1", "paper-crlb"):
        register(registry, name, [])
    ids = [item.id for item in registry.all()]
    assert ids == ["other-x1", "paper-4.2", "paper-4.10", "paper-9", "paper-10", "paper-crlb"]
    assert [item.id for item in registry.select()] == ids
    assert [item.id for item in registry.select(["paper-4.*", "other-x1"])] == ["other-x1", "paper-4.2", "paper-4.10"]
    assert [item.id for item in registry.select(["paper-9", "paper-9"])] == ["paper-9"]
    assert [item.id for item in registry.select(["paper-1?"])] == ["paper-10"]
    with pytest.raises(ValueError, match="no experiment 'paper-1'"):
        registry.select(["paper-9", "paper-1"])


@pytest.mark.unit
@pytest.mark.parametrize("id", ["", "paper", "Paper-1", "paper_1", "paper-", "paper-1/2", "-1"])
def test_bad_ids_are_refused(registry, id):
    with pytest.raises(ValueError, match="paper-figure in lower case expected"):
        registry.experiment(id, title="t", source="s")


@pytest.mark.unit
def test_bad_registrations_are_refused(registry):
    register(registry, "paper-1", [])
    with pytest.raises(ValueError, match="already registered"):
        register(registry, "paper-1", [])
    with pytest.raises(ValueError, match="runs = 0: at least 1"):
        registry.experiment("paper-2", title="t", source="s", runs=0)
    with pytest.raises(ValueError, match="a title and a source"):
        registry.experiment("paper-2", title="", source="s")
    with pytest.raises(ValueError, match="jobs = 0: at least 1"):
        Workers(0)


@pytest.mark.law
def test_seeds_are_named_by_user_experiment_and_run():
    seeds = {derive_seed(s, name, r) for s in range(5) for name in ("a-1", "a-2", "a-11") for r in range(40)}
    assert len(seeds) == 5 * 3 * 40
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert derive_seed(1, "a-1", 1) != derive_seed(1, "a-11")
    assert derive_seed(1, "a-1", "1") != derive_seed(1, "a-1", 1)
    assert max(seeds) > 2**62


@pytest.mark.golden
def test_seeds_stay_what_they_are():
    assert derive_seed(1, "nielsen-18", 0) == 5587213670090613940


@pytest.mark.law
def test_results_depend_neither_on_jobs_nor_on_order(registry, draws, tmp_path):
    for name in ("paper-1", "paper-2", "paper-3"):

        def values(lab):
            return [*lab.map(draws.draw, 2.0), lab.rng("offset").normal(), *lab.map(draws.draw, 1.0, runs=2)]

        register(registry, name, [Claim("drawn", 0.25, above(0.0))], runs=9, values=values)
    run("--seed", 7, "--out", tmp_path / "all", "--jobs", 1)
    run("--seed", 7, "--out", tmp_path / "two", "--jobs", 2, "paper-3", "paper-2")
    run("--seed", 8, "--out", tmp_path / "other", "--jobs", 1, "paper-2")
    arrays = {
        (folder, name): np.load(tmp_path / folder / f"{name}.npz")["values"]
        for folder, name in (("all", "paper-2"), ("all", "paper-3"), ("two", "paper-2"), ("two", "paper-3"))
    }
    for name in ("paper-2", "paper-3"):
        np.testing.assert_array_equal(arrays["all", name], arrays["two", name])
    assert np.unique([arrays["all", "paper-2"], arrays["all", "paper-3"]]).size == 24
    np.testing.assert_allclose(arrays["all", "paper-2"][:2], 2.0 * arrays["all", "paper-2"][-2:])
    other = np.load(tmp_path / "other" / "paper-2.npz")["values"]
    assert not np.intersect1d(other, arrays["all", "paper-2"]).size
    rows = {folder: json.loads((tmp_path / folder / "claims.json").read_text()) for folder in ("all", "two")}
    assert [row["id"] for row in rows["all"]] == ["paper-1", "paper-2", "paper-3"]
    assert rows["two"] == rows["all"][1:]


@pytest.mark.unit
def test_runs_of_a_map_are_at_most_the_experiments(registry, tmp_path):
    register(registry, "paper-1", [Claim("c", 1.0, above(0.0))], runs=3, values=lambda lab: lab.map(float, runs=4))
    outcome = perform(registry.all()[0], seed=1, out=tmp_path)
    assert not outcome.holds
    assert "runs = 4: 1 ... 3 expected" in str(outcome.error)


# ---- what is written


@pytest.mark.unit
def test_claims_json(registry, tmp_path):
    claims = [
        Claim("a number", np.float64(0.5), band(0.0, 1.0)),
        Claim("numbers", np.array([1, 2, 3]), rising(), source="elsewhere"),
        Claim("not a number", (1.0, NAN, INF), at_most(1e300)),
    ]
    register(registry, "paper-1", claims, runs=4)
    run("--seed", 3, "--out", tmp_path / "out", code=1)
    text = (tmp_path / "out" / "claims.json").read_text(encoding="utf-8")
    rows = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in claims.json"))
    assert [list(row) for row in rows] == [KEYS] * 3
    assert [row["measured"] for row in rows] == [0.5, [1.0, 2.0, 3.0], [1.0, None, None]]
    assert [row["holds"] for row in rows] == [True, True, False]
    assert [row["source"] for row in rows] == ["paper, paper-1", "elsewhere", "paper, paper-1"]
    assert {(row["id"], row["seed"], row["runs"]) for row in rows} == {("paper-1", 3, 4)}
    assert rows[0]["required"] == "0 … 1"
    assert (tmp_path / "out" / "paper-1.png").read_bytes().startswith(b"\x89PNG")
    assert np.load(tmp_path / "out" / "paper-1.npz")["values"].tolist() == [1.0]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["claims.json", "paper-1.npz", "paper-1.png"]


@pytest.mark.unit
def test_parts_and_tables(registry, tmp_path):
    @registry.experiment("paper-1.5", title="t", source="s")
    def body(lab):
        with lab.figure(2.0, 1.5, part="left") as figure:
            figure.add_subplot()
        lab.table(["x [m]", "name"], [(0.25, "a"), (1.0, "b")])
        lab.table(["x [m]"], [(0.1,)], part="right")
        return [Claim("c", 1.0, above(0.0))]

    assert perform(registry.all()[0], seed=1, out=tmp_path).holds
    assert {path.name for path in tmp_path.iterdir()} == {"paper-1.5_left.png", "paper-1.5.csv", "paper-1.5_right.csv"}
    assert (tmp_path / "paper-1.5.csv").read_text() == "x [m],name\n0.25,a\n1.0,b\n"


@pytest.mark.unit
def test_a_later_run_replaces_claims_json(registry, tmp_path):
    register(registry, "paper-1", [Claim("c", 1.0, above(0.0))])
    register(registry, "paper-2", [Claim("c", 1.0, above(0.0))])
    run("--out", tmp_path)
    run("paper-2", "--out", tmp_path)
    assert [row["id"] for row in json.loads((tmp_path / "claims.json").read_text())] == ["paper-2"]
    assert write_claims([], seed=1, out=tmp_path).read_text() == "[]\n"


# ---- how it ends


@pytest.mark.unit
def test_a_table_and_exit_code_0_when_all_hold(registry, tmp_path):
    register(registry, "paper-1", [Claim("state [x v] settles", -1.5, below(0.0))])
    output = run("--out", tmp_path).stdout.splitlines()
    assert output[0].split() == ["id", "claim", "measured", "required", "holds"]
    assert output[1].split() == ["paper-1", "state", "[x", "v]", "settles", "−1.5", "<", "0", "yes"]
    assert output[2] == "1 of 1 claims hold"


@pytest.mark.unit
def test_a_claim_that_fails_ends_with_exit_code_1(registry, tmp_path):
    register(registry, "paper-1", [Claim("it is small", 2.0, at_most(1.0)), Claim("it is", 2.0, above(0.0))])
    output = run("--out", tmp_path, code=1).stdout
    assert output.splitlines()[1].split()[-1] == "NO"
    assert "1 of 2 claims hold" in output
    assert [row["holds"] for row in json.loads((tmp_path / "claims.json").read_text())] == [False, True]


@pytest.mark.unit
def test_an_exception_fails_its_experiment_alone(registry, tmp_path):
    @registry.experiment("paper-1", title="t", source="s")
    def body(lab):
        yield Claim("before", 1.0, above(0.0))
        raise ZeroDivisionError("by nought")

    register(registry, "paper-2", [Claim("after", 1.0, above(0.0))])
    result = run("--out", tmp_path, code=1)
    rows = json.loads((tmp_path / "claims.json").read_text())
    assert [(row["id"], row["holds"], row["measured"]) for row in rows] == [
        ("paper-1", True, 1.0),
        ("paper-1", False, []),
        ("paper-2", True, 1.0),
    ]
    assert "ZeroDivisionError: by nought" in rows[1]["claim"]
    assert "Traceback" in result.stderr
    assert "2 of 3 claims hold" in result.stdout


@pytest.mark.unit
@pytest.mark.parametrize("missing", ["claim", "figure", "data file"])
def test_an_experiment_leaves_claims_a_figure_and_data(registry, tmp_path, missing):
    @registry.experiment("paper-1", title="t", source="s")
    def body(lab):
        if missing != "figure":
            with lab.figure(2.0, 1.5) as figure:
                figure.add_subplot()
        if missing != "data file":
            lab.save(x=[1.0])
        return [] if missing == "claim" else [Claim("c", 1.0, above(0.0))]

    outcome = perform(registry.all()[0], seed=1, out=tmp_path)
    assert not outcome.holds
    assert f"left no {missing}" in str(outcome.error)


@pytest.mark.unit
def test_list_names_and_runs_nothing(registry, tmp_path):
    register(registry, "paper-2", [], runs=40)
    register(registry, "paper-1", [])
    lines = run("--list", "--out", tmp_path / "out").stdout.splitlines()
    assert lines[0].split() == ["id", "runs", "title", "source"]
    assert [line.split()[:2] for line in lines[1:]] == [["paper-1", "1"], ["paper-2", "40"]]
    assert "title of paper-2" in lines[2]
    assert [line.split()[0] for line in run("--list", "paper-2").stdout.splitlines()[1:]] == ["paper-2"]
    assert not (tmp_path / "out").exists()


@pytest.mark.unit
def test_refusals(registry, tmp_path):
    register(registry, "paper-1", [Claim("c", 1.0, above(0.0))])
    assert "no experiment 'nowhere-*'" in run("nowhere-*", "--out", tmp_path, code=2).stderr
    run("--jobs", 0, code=2)
    run("--seed", -1, code=2)
    (tmp_path / "file").write_text("")
    assert "file: file exists" in run("--out", tmp_path / "file", code=2).stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@pytest.mark.example
def test_the_guides_experiment_runs(registry, monkeypatch, tmp_path):
    monkeypatch.setattr("soopnav_cpp.experiments.registry.experiment", registry.experiment)
    guide = (Path(__file__).parents[2] / "docs" / "reproduce.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    exec(compile(snippet, "docs/reproduce.md", "exec"), {})
    assert "1 of 1 claims hold" in run("--out", tmp_path, "--jobs", 1).stdout
    assert {path.name for path in tmp_path.iterdir()} == {"claims.json", "paper-7.npz", "paper-7.png"}


@pytest.mark.unit
def test_the_papers_experiments_are_found():
    names = {item.id.split("-")[0] for item in experiments.load().all()}
    assert names <= {"crosby", "pesyna", "carter", "mei", "nielsen", "fusion", "clock"}


# ---- references of the particle filters


def kalman(F, Q, H, R, z, x, P):
    """Textbook recursion; H per step. Means and standard deviations after each update."""
    means, sigmas = [], []
    for row, measured in zip(H, z, strict=True):
        x, P = F @ x, F @ P @ F.T + Q
        gain = P @ row.T @ np.linalg.inv(row @ P @ row.T + R)
        x, P = x + gain @ (measured - row @ x), P - gain @ row @ P
        means.append(x)
        sigmas.append(np.sqrt(np.diag(P)))
    return np.array(means), np.array(sigmas)


def slopes(nodes, states, bias):
    """Jacobians of ranges plus `bias` (its column) by central differences; shape (steps, nodes, n)."""

    def predict(x):
        return np.linalg.norm(nodes - x[:2], axis=1) + x[bias]

    step = 1e-5 * np.eye(states.shape[1])
    return np.array([[(predict(x + d) - predict(x - d)) / 2e-5 for d in step] for x in states]).transpose(0, 2, 1)


@pytest.mark.crosscheck
def test_posterior_of_the_still_receiver_by_integration():
    setup = nielsen_setups.STILL
    z = setup.measurements(np.random.default_rng(3)) + 3.5  # near the end of the prior, where its edge counts
    moments = nielsen_references.still(setup, z)
    for k in (1, 2, 20):
        x = np.linspace(*setup.prior_m, 20_001)
        logs = -0.5 * np.sum((z[:k, None] - x) ** 2, axis=0)
        density = np.exp(logs - logs.max())
        total = scipy.integrate.simpson(density, x=x)
        mean = scipy.integrate.simpson(x * density, x=x) / total
        variance = scipy.integrate.simpson((x - mean) ** 2 * density, x=x) / total
        assert moments.mean[k - 1, 0] == pytest.approx(mean, abs=1e-8)
        assert moments.sigma[k - 1, 0] == pytest.approx(math.sqrt(variance), rel=1e-7)
    inside = nielsen_references.still(setup, setup.measurements(np.random.default_rng(4)))
    assert inside.sigma[-1, 0] == pytest.approx(1.0 / math.sqrt(20), rel=1e-6)


@pytest.mark.crosscheck
def test_kalman_references():
    rng = np.random.default_rng(5)
    step, smooth, room, crossing = (
        nielsen_setups.STEP,
        nielsen_setups.SMOOTH,
        nielsen_setups.ROOM_BIAS,
        nielsen_setups.CROSSING,
    )

    z = step.measurements(rng)
    got = nielsen_references.step_response(step, 0.02, z)
    one = np.eye(1)
    want = kalman(one, 4e-4 * one, np.ones((2500, 1, 1)), one, z[:, None], np.ones(1), 0.2**2 / 12 * one)
    np.testing.assert_allclose(got.mean, want[0], atol=1e-10)
    np.testing.assert_allclose(got.sigma, want[1], rtol=1e-9)

    z = smooth.measurements(rng)
    got = nielsen_references.smooth(smooth, z)
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 0.01 * np.ones((2, 2))
    want = kalman(F, Q, np.tile([[[1.0, 0.0]]], (1400, 1, 1)), one, z[:, None], np.zeros(2), np.zeros((2, 2)))
    np.testing.assert_allclose(got.mean, want[0], atol=1e-9)
    np.testing.assert_allclose(got.sigma, want[1], rtol=1e-7)

    z = room.measurements(rng)
    got = nielsen_references.room_bias(room, z)
    truth = np.array([3.0, 6.0, 1.0])
    H = slopes(room.nodes_m, np.tile(truth, (100, 1)), 2)
    ranges = np.linalg.norm(room.nodes_m - truth[:2], axis=1) + 1.0
    want = kalman(np.eye(3), 0.01 * np.eye(3), H, np.eye(4), z - ranges, 5.0 - truth, 100 / 12 * np.eye(3))
    np.testing.assert_allclose(got.mean - truth, want[0], atol=1e-6)
    np.testing.assert_allclose(got.sigma, want[1], rtol=1e-6)

    z = crossing.measurements(rng)
    got = nielsen_references.crossing(crossing, z)
    truth = crossing.truth()
    H = slopes(crossing.nodes_m, truth, 4)
    ranges = np.linalg.norm(crossing.nodes_m - truth[:, None, :2], axis=2)
    F = np.eye(5)
    F[0, 2] = F[1, 3] = 1.0
    start = np.array([1.5, 0.0, 0.011 - 0.02, 0.0, 0.0])
    P0, Q = np.diag([9 / 12, 2.25, 0.04, 0.04, 0.0]), np.diag([0.0, 0.0, 1e-4, 1e-4, 1e-3])
    want = kalman(F, Q, H, 0.36 * np.eye(4), z - ranges, start, P0)
    np.testing.assert_allclose(got.mean - truth, want[0], atol=1e-6)
    np.testing.assert_allclose(got.sigma, want[1], rtol=1e-6)


@pytest.mark.unit
def test_setups_are_the_papers():
    assert nielsen_setups.STEP.truth()[[0, 1249, 2499]] == pytest.approx([0.0, 1.0, 2.0], abs=1e-9)
    np.testing.assert_allclose(nielsen_setups.CROSSING.truth()[-1], [2.0, 2.5, 0.02, 0.0, 0.0])
    assert nielsen_setups.ROOM.four_nodes_m.tolist() == [[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 0.0]]
    assert nielsen_setups.ROOM_BIAS.measurements(np.random.default_rng(1)).shape == (100, 4)
    assert nielsen_setups.CROSSING.measurements(np.random.default_rng(1)).shape == (100, 4)
