"""``soopnav bench``: turns, ratios, peers that are missing or apart, and what is printed. Nothing here is timed."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp.bench import cases, environments, harness, systems
from soopnav_cpp.bench.harness import Case, InProcess, Peer, UnavailableError, measure, select
from soopnav_cpp.bench.peers import numpy_peers
from soopnav_cpp.cli import bench as command
from soopnav_cpp.cli.app import cli

pytestmark = pytest.mark.unit

VECTORS = Path(__file__).resolve().parents[3] / "shared" / "vectors" / "filters"
KEYS = ["name", "ours_s", "peer", "peer_s", "ratio", "n"]


class Clock:
    """Time that passes only when someone works."""

    def __init__(self):
        self.now = 0.0
        self.log = []

    def perf_counter(self):
        return self.now

    def worker(self, who, *durations, answer=1.0):
        """A `Prepare` whose runs take these durations, the last one from then on."""

        def prepare(data):
            left = list(durations)

            def run():
                self.log.append(who)
                self.now += left.pop(0) if len(left) > 1 else left[0]
                return answer * float(data["x"].sum())

            return run, lambda result: [result]

        return prepare


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(harness, "time", clock)
    monkeypatch.setattr(harness.gc, "collect", lambda: 0)  # it takes its time over all that pytest has loaded
    return clock


@pytest.fixture
def peers(monkeypatch, tmp_path):
    """A package of peers; a function that puts modules into it."""
    folder = tmp_path / "peers_of_a_test"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(harness, "_PEERS", folder.name)

    def put(name, **attributes):
        module = SimpleNamespace(**attributes)
        monkeypatch.setitem(sys.modules, f"{folder.name}.{name}", module)

    put.folder = folder
    yield put
    monkeypatch.undo()
    for name in [name for name in sys.modules if name.split(".")[0] == folder.name]:
        del sys.modules[name]


def case(ours, *peers, name="sum/3", tolerance=1e-9):
    return Case(name, "a sum", lambda: {"x": np.array([1.0, 2.0, 3.0])}, ours, tuple(peers), tolerance)


# ---- turns and rows


def test_sides_take_turns_and_medians_are_compared(clock, peers):
    peers("slow", go=clock.worker("peer", 9.0, *[2.0, 8.0, 4.0] * 2, 40.0))
    (row,) = measure(case(clock.worker("ours", 5.0, *[0.5, 0.25] * 3, 100.0), Peer("slow one", "slow", "go")))
    assert clock.log == ["ours", "peer"] + ["ours", "peer"] * 7
    assert (row.ours_s, row.peer_s, row.ratio, row.n) == (0.5, 4.0, 8.0, 7)
    assert row.agrees
    assert row.difference == 0.0
    assert list(row.as_json()) == KEYS
    assert row.as_json() == {"name": "sum/3", "ours_s": 0.5, "peer": "slow one", "peer_s": 4.0, "ratio": 8.0, "n": 7}


def test_each_peer_has_turns_of_its_own(clock, peers):
    peers("both", one=clock.worker("one", 1.0), two=clock.worker("two", 2.0))
    rows = list(measure(case(clock.worker("ours", 0.5), Peer("1", "both", "one"), Peer("2", "both", "two")), runs=9))
    assert [(row.peer, row.ratio, row.n) for row in rows] == [("1", 2.0, 9), ("2", 4.0, 9)]
    assert clock.log == ["ours", "one"] + ["ours", "one"] * 9 + ["two"] + ["ours", "two"] * 9


def test_fewer_than_seven_turns_are_refused(clock):
    with pytest.raises(ValueError, match="runs = 6: at least 7"):
        list(measure(case(clock.worker("ours", 1.0)), runs=6))


@pytest.mark.parametrize(("answer", "tolerance", "agrees"), [(1.001, 1e-2, True), (1.001, 1e-4, False)])
def test_answers_are_compared(clock, peers, answer, tolerance, agrees):
    peers("other", go=clock.worker("peer", 1.0, answer=answer))
    (row,) = measure(case(clock.worker("ours", 1.0), Peer("p", "other", "go"), tolerance=tolerance))
    assert row.difference == pytest.approx(1e-3)
    assert row.agrees is agrees


@pytest.mark.parametrize("answer", [float("nan"), float("inf")])
def test_an_answer_that_is_no_number_disagrees(clock, peers, answer):
    peers("other", go=clock.worker("peer", 1.0, answer=answer))
    (row,) = measure(case(clock.worker("ours", 1.0), Peer("p", "other", "go"), tolerance=1e9))
    assert not row.agrees


def test_answers_of_other_lengths_disagree(clock, peers):
    peers("other", go=lambda data: (lambda: None, lambda _: [6.0, 0.0]))
    (row,) = measure(case(clock.worker("ours", 1.0), Peer("p", "other", "go")))
    assert not row.agrees


def test_the_collector_is_left_as_it_was():
    import gc

    contender = InProcess(lambda data: (lambda: gc.isenabled(), lambda r: [float(r)]), {})
    assert contender.answer() == [1.0]
    seen = []
    InProcess(lambda data: (lambda: seen.append(gc.isenabled()), lambda r: []), {}).time()
    assert seen == [False]
    assert gc.isenabled()


# ---- peers that cannot run


def test_peers_that_cannot_run_are_named_and_ours_is_timed(clock, peers):
    (peers.folder / "absent.py").write_text("import a_package_that_is_nowhere.part\n")
    peers("broken", go=lambda data: (_ for _ in ()).throw(AttributeError("np.float is gone")))
    peers("late", go=lambda data: (lambda: 1 / 0, lambda r: [r]))
    ours = clock.worker("ours", 0.5)
    rows = list(measure(case(ours, *(Peer(name, name, "go") for name in ("absent", "broken", "late")))))
    assert [row.peer for row in rows] == ["absent", "broken", "late"]
    assert [row.as_json()["peer_s"] for row in rows] == [None] * 3
    assert [row.ratio for row in rows] == [None] * 3
    assert [(row.ours_s, row.n) for row in rows] == [(0.5, 7)] * 3
    assert clock.log == ["ours"] * (1 + 3 * 7)
    assert rows[0].reason == "a_package_that_is_nowhere is not installed: pip install soopnav[bench]"
    assert rows[1].reason == "AttributeError: np.float is gone"
    assert rows[2].reason == "ZeroDivisionError: division by zero"


def test_our_own_failure_passes(clock):
    with pytest.raises(ZeroDivisionError):
        list(measure(case(lambda data: (lambda: 1 / 0, lambda r: [r]))))


# ---- peers apart

APART = """\
import os
import numpy as np

def total(data):
    print("a package that talks")
    os.write(1, b"and one that does it in C")
    return (lambda: data["x"].sum(), lambda result: [result])

def fails(data):
    raise RuntimeError("does not work here")

def fails_later(data):
    return (lambda: 1 / 0, lambda result: [result])

def dies(data):
    os._exit(3)
"""


@pytest.fixture
def apart(peers, monkeypatch):
    (peers.folder / "apart.py").write_text(APART)
    asked = []
    monkeypatch.setattr(environments, "environment", lambda wants: (asked.append(wants), Path(sys.executable))[1])
    return asked


def test_a_peer_in_its_own_interpreter(apart):
    ours = case(lambda data: (lambda: data["x"].sum(), lambda r: [r]), Peer("p", "apart", "total", ("pack", "numpy<2")))
    (row,) = measure(ours)
    assert apart == [("pack", "numpy<2")]
    assert (row.reason, row.difference, row.agrees) == ("", 0.0, True)
    assert row.peer_s > 0.0
    assert row.ratio == row.peer_s / row.ours_s


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("fails", "RuntimeError: does not work here"),
        ("fails_later", "ZeroDivisionError: division by zero"),
        ("missing", "AttributeError"),
        ("dies", "its process ended with code 3"),
    ],
)
def test_a_peer_that_fails_in_its_own_interpreter(apart, function, reason):
    (row,) = measure(case(lambda data: (lambda: 6.0, lambda r: [r]), Peer("p", "apart", function, ("pack",))))
    assert row.peer_s is None
    assert reason in row.reason


def test_peers_need_nothing_of_soopnav():
    modules = sorted(Path(numpy_peers.__file__).parent.glob("*_peers.py"))
    assert len(modules) >= 4
    for path in (*modules, Path(harness.worker.__file__)):
        assert "import soopnav" not in path.read_text()
        assert "from soopnav" not in path.read_text()


# ---- environments


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(environments, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def test_an_environment_is_made_once(cache, monkeypatch):
    commands = []

    def pretend(command, **options):
        commands.append(command)
        if command[1:3] == ["-m", "venv"]:
            interpreter = environments._interpreter(Path(command[3]))
            interpreter.parent.mkdir()
            interpreter.write_text("")
        return SimpleNamespace(returncode=0, stdout="")

    monkeypatch.setattr(subprocess, "run", pretend)
    python = environments.environment(("pack==1.2", "numpy<2"))
    assert python.exists()
    assert python.is_relative_to(cache)
    assert [command[1:3] for command in commands] == [["-m", "venv"], ["-m", "pip"]]
    assert commands[1][-2:] == ["pack==1.2", "numpy<2"]
    assert environments.environment(("pack==1.2", "numpy<2")) == python
    assert len(commands) == 2
    assert environments.environment(("pack==1.3", "numpy<2")) != python
    assert len(list(cache.iterdir())) == 2


def test_an_environment_that_cannot_be_made_leaves_nothing(cache, monkeypatch):
    output = "Looking in indexes\nERROR: No matching distribution found for pack\n[notice] more\n"
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: SimpleNamespace(returncode="pip" in command, stdout=output)
    )
    with pytest.raises(UnavailableError, match=r"^no environment for pack: ERROR: No matching distribution found"):
        environments.environment(("pack>=1",))
    assert list(cache.iterdir()) == []

    def late(command, **_):
        raise subprocess.TimeoutExpired(command, 1.0)

    monkeypatch.setattr(subprocess, "run", late)
    with pytest.raises(UnavailableError, match="timed out"):
        environments.environment(("pack>=1",))
    assert list(cache.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="where other platforms keep caches is theirs")
def test_the_cache_is_where_the_platform_says(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert environments.cache_folder() == tmp_path / "soopnav" / "bench"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert environments.cache_folder() == tmp_path / ".cache" / "soopnav" / "bench"


# ---- names and the command


def test_names_are_beginnings_or_globs(clock):
    known = [case(clock.worker("ours", 1.0), name=name) for name in ("ekf/planar", "particle/1e5", "particle/1e6")]
    assert [c.name for c in select(known)] == ["ekf/planar", "particle/1e5", "particle/1e6"]
    assert [c.name for c in select(known, ["particle"])] == ["particle/1e5", "particle/1e6"]
    assert [c.name for c in select(known, ["*/1e5", "ekf", "ekf/planar"])] == ["ekf/planar", "particle/1e5"]
    with pytest.raises(ValueError, match="no case 'ukf'; there are ekf/planar, particle/1e5, particle/1e6"):
        select(known, ["ekf", "ukf"])


@pytest.fixture
def fake(clock, peers, monkeypatch):
    """The command with two cases: one peer that runs, one that is missing, one that answers something else."""
    peers("there", right=clock.worker("peer", 3.0), wrong=clock.worker("peer", 3.0, answer=2.0))
    ours = clock.worker("ours", 0.5)
    monkeypatch.setattr(
        command,
        "CASES",
        (
            case(ours, Peer("fine", "there", "right"), Peer("nowhere", "not_there", "go"), name="good/1"),
            case(ours, Peer("liar", "there", "wrong"), name="bad/1"),
        ),
    )
    for name, value in command.ONE_THREAD.items():
        monkeypatch.setenv(name, value)


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, ["bench", *(str(a) for a in arguments)], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.mark.usefixtures("fake")
def test_json_is_a_line_for_each_row_and_nothing_else():
    result = run("good", "--json")
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [list(row) for row in rows] == [KEYS, KEYS]
    assert rows[0] == {"name": "good/1", "ours_s": 0.5, "peer": "fine", "peer_s": 3.0, "ratio": 6.0, "n": 7}
    assert rows[1] == {"name": "good/1", "ours_s": 0.5, "peer": "nowhere", "peer_s": None, "ratio": None, "n": 7}
    assert "good/1: nowhere could not run: " in result.stderr


@pytest.mark.usefixtures("fake")
def test_the_table_names_a_missing_peer():
    lines = run("good*", "--runs", 8).stdout.splitlines()
    assert lines[0].split() == ["case", "soopnav", "peer", "its", "time", "ratio", "runs"]
    assert lines[1].split() == ["good/1", "500", "ms", "fine", "3", "s", "6", "8"]
    assert lines[2].split()[:6] == ["good/1", "500", "ms", "nowhere", "–", "–"]
    assert "is not installed: pip install soopnav[bench]" in lines[2]


@pytest.mark.usefixtures("fake")
def test_another_answer_ends_with_exit_code_1():
    result = run(code=1)
    assert "bad/1: liar answers 1 off, 1e-09 is allowed" in result.stderr
    assert "another answer" in result.stdout


@pytest.mark.usefixtures("fake")
def test_list_and_refusals(clock):
    assert run("--list").stdout.splitlines() == ["good/1  a sum; beside fine, nowhere", "bad/1  a sum; beside liar"]
    assert "no case 'ugly'; there are good/1, bad/1" in run("ugly", code=2).stderr
    assert "--runs 6: at least 7" in run("--runs", 6, code=2).stderr
    assert clock.log == []


@pytest.mark.usefixtures("fake")
def test_without_one_thread_it_starts_again_with_it(monkeypatch, clock):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    calls = []

    def pretend(arguments, *, env, check):
        calls.append((arguments, env))
        return SimpleNamespace(returncode=5)

    monkeypatch.setattr(command.subprocess, "run", pretend)
    run("--json", "good", "--runs", 9, code=5)
    ((arguments, env),) = calls
    assert arguments[0] == sys.executable
    assert arguments[3:] == ["bench", "--json", "--runs", "9", "--", "good"]
    assert env.items() >= command.ONE_THREAD.items()
    assert clock.log == []


def test_started_again_it_is_the_same_command():
    program = (
        f"import sys; from soopnav_cpp.cli.bench import again_with_one_thread as again; sys.exit(again({['--list']}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert [line.split()[0] for line in done.stdout.splitlines()] == [c.name for c in cases.CASES]


def test_nothing_of_the_extra_is_needed_to_import():
    program = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("filterpy", "stonesoup", "particles", "pfilter", "scipy", "allantools"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
from soopnav_cpp.bench import cases, environments, harness, systems, worker
from soopnav_cpp.bench.peers import numpy_peers
for case in (cases.RTS,):
    try:
        case.peers[0].start({})
    except harness.UnavailableError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "filterpy is not installed: pip install soopnav[bench]\n"


# ---- systems and the peers that need no package


def vectors(name):
    path = VECTORS / name
    if not path.exists():
        pytest.skip(f"the reference vectors ../shared/vectors/filters/{name} are not here")
    return np.load(path)


@pytest.mark.crosscheck
def test_fourteen_states_are_those_of_the_vectors():
    known, system = vectors("joseph_14state.npz"), systems.fourteen_states()
    for name in ("F", "Q", "H", "R", "x0", "P0"):
        np.testing.assert_array_equal(system[name], known[name])
    filtered = systems.run_kalman(system, known["z"])
    np.testing.assert_allclose(filtered["x"], known["x_filt"], atol=1e-9)
    np.testing.assert_allclose(filtered["P_pred"], known["P_pred"], atol=1e-9)


@pytest.mark.crosscheck
def test_filterpy_side_of_the_planar_ins_is_that_of_the_vectors():
    pytest.importorskip("filterpy", reason="filterpy is not installed: pip install soopnav[bench]")
    from soopnav_cpp.bench.peers import filterpy_peers

    known, made = vectors("ekf_range_difference.npz"), systems.planar_ins()
    for name in ("Q", "R", "x0", "P0", "dt", "p0"):
        np.testing.assert_allclose(made[name], known[name], rtol=1e-15)
    np.testing.assert_array_equal(made["transmitters"], known["TX"])
    assert made["u"].shape == known["U"].shape
    assert made["z"].shape == known["Z"].shape
    run, answer = filterpy_peers.ekf_planar_ins(made | {"u": known["U"], "z": known["Z"]})
    np.testing.assert_allclose(answer(run()), [*known["x_numpy"], *np.diagonal(known["P_numpy"])], atol=1e-9)


@pytest.mark.consistency
@pytest.mark.parametrize("prepare", [numpy_peers.bootstrap, numpy_peers.bootstrap_float])
def test_numpy_cloud_follows_the_kalman_filter(prepare):
    """Ranges of 50 m and errors of half a metre: the linearised filter is right to a few millimetres."""
    data = systems.range_cloud(20_000, 10)
    run, answer = prepare(data)
    dt = float(data["dt"])
    F = np.eye(5)
    F[0, 2] = F[1, 3] = dt
    G = np.array([[dt * dt / 2, 0, 0], [0, dt * dt / 2, 0], [dt, 0, 0], [0, dt, 0], [0, 0, 1]]) * [0.5, 0.5, 0.3]
    x, P = data["x0"], np.diag(data["sigma0"] ** 2)
    for z in data["z"]:
        x, P = F @ x, F @ P @ F.T + G @ G.T
        away = x[:2] - data["nodes"]
        ranges = np.linalg.norm(away, axis=1)
        H = np.column_stack([away / ranges[:, None], np.zeros((4, 2)), np.ones(4)])
        K = np.linalg.solve(H @ P @ H.T + np.eye(4), H @ P).T
        x, P = x + K @ (z - ranges - x[4]), P - K @ H @ P
    assert np.all(np.abs(answer(run()) - x) < 0.15 * np.sqrt(np.diag(P)))
