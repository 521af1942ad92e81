"""The command line: what it prints and writes, and how it refuses."""

import io
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import soopnav_cpp as sn
from soopnav_cpp.cli.app import cli
from soopnav_cpp.cli.progress import progress

pytestmark = pytest.mark.unit

C = 299_792_458.0
HERE = (180.0, -120.0, 1.5)
CELLS = {301: (150.0, 620.0, 35.0), 115: (900.0, 240.0, 42.0), 42: (520.0, -780.0, 28.0), 277: (-640.0, -510.0, 31.0)}
SCENARIO = """\
[capture]
sample_rate_hz = 3.84e6
center_frequency_hz = 806e6
duration_s = 0.04
snr_db = 25.0
seed = 5
format = "ci8"
[receiver]
position_m = [180.0, -120.0, 1.5]
clock_bias_s = 3.2e-3
clock_error_ppm = 1.7
""" + "".join(
    f"[[cells]]\ncell_id = {cell_id}\nn_rb = 15\nn_ports = 2\nstart_sfn = 412\nposition_m = {list(place)}\n"
    for cell_id, place in CELLS.items()
)
NODES = "[receiver]\nheight_m = 1.5\n" + "".join(
    f"[[nodes]]\ncell_id = {cell_id}\nposition_m = [{e}, {n}, 0.0]\nantenna_height_m = {u}\nsigma_s = 3e-9\n"
    for cell_id, (e, n, u) in CELLS.items()
)
ORIGIN = "[origin]\nlatitude_deg = 52.2053\nlongitude_deg = 0.1218\nheight_m = 55.0\n"


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A capture of four cells around a known place."""
    folder = tmp_path_factory.mktemp("city")
    (folder / "city.toml").write_text(SCENARIO)
    output = run("synth", "lte", folder / "city.toml", folder / "city.sigmf-meta").stdout
    assert output == f"{folder / 'city.sigmf-meta'}: 153600 samples\n"
    return folder / "city.sigmf-meta"


@pytest.fixture
def nodes(tmp_path):
    path = tmp_path / "nodes.toml"
    path.write_text(NODES)
    return path


def test_synth_writes_what_the_scenario_says(city):
    iq, meta = sn.io.read_iq(city)
    assert (meta.sample_rate_hz, meta.center_frequency_hz, meta.format) == (3.84e6, 806e6, "ci8")
    assert meta.duration_s == pytest.approx(0.04)
    assert np.abs(iq.view(np.float32)).max() == pytest.approx(0.9, abs=0.01)


def test_scan_prints_a_table(city):
    lines = run("scan", city).stdout.splitlines()
    assert lines[0] == "city.sigmf-meta  3.84 Msps  806 MHz  40 ms"
    assert lines[1].split() == ["cell", "duplex", "CP", "RB", "ports", "SFN", "CFO", "clock", "SNR", "first", "path"]
    rows = {int(line.split()[0]): line for line in lines[2:-1]}
    assert rows.keys() == CELLS.keys()
    for row in rows.values():
        assert re.fullmatch(
            r" *\d+ +FDD +normal +15 +2 +412 +\+1\.37 kHz +\+[12]\.\d\d ppm +−?\d+\.\d dB "
            r"+3\.20\d \d{3} ms ± [\d.]+ m?m *",
            row,
        ), row
    assert re.fullmatch(r"4 cells in \d+\.\d\d s \(\d+\.\d× real time\)", lines[-1])


def test_scan_as_json(city):
    result = run("scan", city, "--json")
    found = json.loads(result.stdout)
    assert result.stderr == ""
    assert list(found) == ["capture", "sample_rate_hz", "cells"]
    assert (found["capture"], found["sample_rate_hz"]) == (str(city), 3.84e6)
    assert len(found["cells"]) == 4
    for cell in found["cells"]:
        assert list(cell) == [
            "cell_id", "n_rb", "n_ports", "cp", "duplex", "sfn", "frame_start_s", "cfo_hz", "clock_error_ppm", "snr_db",
            "toa_s", "toa_sigma_s",
        ]  # fmt: skip
        assert (cell["n_rb"], cell["n_ports"], cell["cp"], cell["duplex"], cell["sfn"]) == (15, 2, "normal", "FDD", 412)
        delay = math.dist(CELLS[cell["cell_id"]], HERE) / C + 3.2e-3
        assert cell["toa_s"] == pytest.approx(delay, abs=5 * cell["toa_sigma_s"])
        assert cell["toa_sigma_s"] < 20 / C
        assert cell["cfo_hz"] == pytest.approx(1.7e-6 * 806e6, abs=50)


def test_scan_draws(city, tmp_path):
    picture = tmp_path / "scan.png"
    assert run("scan", city, "--plot", picture).stdout.endswith(f"plot: {picture}\n")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 50_000


def test_scan_of_raw_samples(city, tmp_path):
    raw = tmp_path / "x.raw"
    shutil.copy(city.with_suffix(".sigmf-data"), raw)
    found = json.loads(run("scan", raw, "--rate", "3.84e6", "--format", "ci8", "--max-cfo", "5e3", "--json").stdout)
    assert {cell["cell_id"] for cell in found["cells"]} == CELLS.keys()
    assert run("scan", raw, code=2).stderr == (
        f"{raw}: not SigMF, so the format of its samples is needed (format, --format): one of cu8, ci8, ci16, cf32\n"
    )


def test_scan_of_noise(tmp_path):
    noise = sn.simulation.add_awgn(np.zeros(38_400, np.complex64), 0.01, seed=1)
    path = sn.io.write_iq(tmp_path / "noise", noise, 1.92e6)
    lines = run("scan", path, "--max-cfo", 2000, "--plot", tmp_path / "noise.png").stdout.splitlines()
    assert lines[0] == "noise.sigmf-meta  1.92 Msps  20 ms"
    assert re.match(r"no cells in ", lines[1])
    assert json.loads(run("scan", path, "--max-cfo", 2000, "--json").stdout)["cells"] == []


SCAN_MISTAKES = {
    "too short": (
        lambda: np.ones(4800),
        "{path}: 4 800 samples (2.5 ms) are too few; one half-frame and a symbol (5.2 ms) are needed",
    ),
    "one sample": (
        lambda: np.ones(1),
        "{path}: 1 sample (0.000521 ms) is too few; one half-frame and a symbol (5.2 ms) are needed",
    ),
    "not finite": (lambda: np.where(np.arange(38_400) == 17, math.nan, 0.0), "{path}: sample 17 is not finite"),
}


@pytest.mark.parametrize("case", SCAN_MISTAKES)
@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_scan_refuses_samples(tmp_path, case, flags):
    make, sentence = SCAN_MISTAKES[case]
    path = sn.io.write_iq(tmp_path / "x", make(), 1.92e6)
    result = run("scan", path, *flags, code=2)
    assert result.stdout == ""
    assert result.stderr == sentence.format(path=path) + "\n"


def test_scan_refuses_files(tmp_path):
    missing = tmp_path / "no.sigmf-meta"
    assert run("scan", missing, code=2).stderr == f"{missing}: no such file\n"
    empty = tmp_path / "empty.ci8"
    empty.write_bytes(b"")
    assert run("scan", empty, "--rate", "1e6", code=2).stderr == f"{empty}: the file is empty; ci8 samples expected\n"
    odd = tmp_path / "odd.cu8"
    odd.write_bytes(bytes(19_999))
    assert (
        "19999 bytes of samples are not a whole number of cu8 samples"
        in run("scan", odd, "--rate", 1.92e6, code=2).stderr
    )
    even = tmp_path / "even.cu8"
    even.write_bytes(bytes(40_000))
    for rate in ("0", "-1.92e6", "nan"):
        assert "sample rate is" in run("scan", even, "--rate", rate, code=2).stderr
    assert run("scan", even, "--rate", "1000", code=2).stderr.startswith("sample_rate_hz")
    assert run("scan", even, "--rate", 1.92e6, "--max-cfo", "1e9", code=2).stderr.startswith("max_cfo_hz")
    assert "format 'wav' is unknown" in run("scan", even, "--rate", 1.92e6, "--format", "wav", code=2).stderr
    unwritable = tmp_path / "no" / "folder.png"
    assert str(unwritable) in run("scan", even, "--rate", 1.92e6, "--plot", unwritable, code=2).stderr


def test_locate_in_local_metres(city, nodes, tmp_path):
    out = tmp_path / "out"
    lines = run("locate", city, "--nodes", nodes, "--out", out).stdout.splitlines()
    match = re.fullmatch(
        r"east ([\d.]+) m  north (−[\d.]+) m  ± ([\d.]+) m \(1σ, 2-D\)   "
        r"clock 3\.(?:199|200) \d{3} ms ± [\d.]+ ns   4 of 4 nodes used",
        lines[0],
    )
    assert match, lines[0]
    east, north = float(match[1]), float(match[2].replace("−", "-"))
    assert math.hypot(east - HERE[0], north - HERE[1]) < 5 * float(match[3])
    assert lines[1:] == [f"report: {out / 'report.html'}"]

    assert sorted(p.name for p in out.iterdir()) == ["fix.geojson", "map.png", "metrics.json", "report.html"]
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["status"] == "converged"
    assert metrics["position_m"][:2] == pytest.approx([east, north], abs=0.051)  # printed to 0.1 m at this deviation
    assert metrics["latitude_deg"] is None
    assert [cell["use"] for cell in metrics["cells"]] == ["used"] * 4
    assert metrics["sigma_m"] == pytest.approx(float(match[3]), abs=0.06)
    report = (out / "report.html").read_text()
    assert report.startswith("<!DOCTYPE html>")
    assert "data:image/png;base64," in report
    assert not re.search(r'(src|href)="(?!data:)', report)  # stands alone
    shapes = json.loads((out / "fix.geojson").read_text())
    assert shapes["coordinate_frame"].startswith("east, north, up")


def test_locate_on_the_earth(city, tmp_path):
    path = tmp_path / "nodes.toml"
    path.write_text(NODES + ORIGIN)
    lines = run("locate", city, "--nodes", path, "--out", tmp_path / "out").stdout.splitlines()
    assert re.match(r"52\.20[\d]+ N  0\.124[\d]+ E  ± ", lines[0])
    shapes = json.loads((tmp_path / "out" / "fix.geojson").read_text())
    assert "coordinate_frame" not in shapes
    point = shapes["features"][0]["geometry"]["coordinates"]
    assert point[:2] == pytest.approx([0.1218, 52.2053], abs=0.01)
    for shape in shapes["features"]:
        if shape["geometry"]["type"] == "Polygon":
            ring = shape["geometry"]["coordinates"][0]
            assert ring[0] == ring[-1]


def geodetic_nodes():
    frame = sn.geometry.LocalFrame(math.radians(-33.9), math.radians(-179.9999), 20.0)
    text = "[receiver]\nheight_m = {height}\n"
    for cell_id, place in CELLS.items():
        latitude, longitude, height = (float(v) for v in frame.position_to_geodetic(place))
        text += (
            f"[[nodes]]\ncell_id = {cell_id}\nlatitude_deg = {math.degrees(latitude)!r}\n"
            f"longitude_deg = {math.degrees(longitude)!r}\nheight_m = {height!r}\nsigma_s = 3e-9\n"
        )
    here = [float(v) for v in frame.position_to_geodetic(HERE)]
    return text.format(height=here[2]), here


@pytest.mark.law
def test_locate_with_geodetic_nodes_equals_local_ones(city, nodes, tmp_path):
    content, here = geodetic_nodes()
    path = tmp_path / "geodetic.toml"
    path.write_text(content)
    found = json.loads(run("locate", city, "--nodes", path, "--json", "--out", tmp_path / "a").stdout)
    local = json.loads(run("locate", city, "--nodes", nodes, "--json", "--out", tmp_path / "b").stdout)
    truth = sn.geometry.geodetic_to_ecef(*here)
    place = [math.radians(found["latitude_deg"]), math.radians(found["longitude_deg"]), found["height_m"]]
    error = np.linalg.norm(sn.geometry.geodetic_to_ecef(*place) - truth)
    assert error == pytest.approx(math.dist(local["position_m"], HERE), abs=1e-3)
    assert found["sigma_m"] == pytest.approx(local["sigma_m"], rel=1e-3)
    assert found["height_m"] == pytest.approx(here[2], abs=1e-4)


def test_locate_rejects_a_false_node(city, tmp_path):
    five = NODES.replace("[-640.0, -510.0, 0.0]", "[-700.0, -510.0, 0.0]")
    path = tmp_path / "nodes.toml"
    path.write_text(five)
    result = run("locate", city, "--nodes", path, "--out", tmp_path / "out").stdout
    # Four nodes show that one is wrong; five would show which.
    assert "caution: the arrivals contradict each other" in result or "rejected: cell 277" in result


def test_locate_names_what_it_does_not_use(city, tmp_path):
    lines = NODES.replace("cell_id = 42\n", "cell_id = 43\n")
    path = tmp_path / "nodes.toml"
    path.write_text(lines)
    output = run("locate", city, "--nodes", path, "--out", tmp_path / "out").stdout
    assert "3 of 4 nodes used" in output
    assert "not found in the capture: cell 43\n" in output
    assert "not in the nodes file: cell 42\n" in output


NODES_3D = NODES.replace("[receiver]\nheight_m = 1.5\n", "")
LOCATE_MISTAKES = {
    "too few nodes": (
        NODES.split("[[nodes]]\ncell_id = 42")[0],
        "2 usable nodes (cell 301 and 115), fewer than the 3 unknowns of a position in two dimensions and the "
        "receiver's clock; found but not in the nodes file: 42 and 277",
    ),
    "too few in three dimensions": (
        NODES.replace("[receiver]\nheight_m = 1.5\n", "").split("[[nodes]]\ncell_id = 277")[0],
        "3 usable nodes (cell 301, 115 and 42), fewer than the 4 unknowns of a position in three dimensions and the "
        "receiver's clock; with [receiver] height_m three nodes are enough; found but not in the nodes file: 277",
    ),
    "collinear": (
        re.sub(r"position_m = \[(\S+), \S+, 0.0\]", r"position_m = [\1, 50.0, 0.0]", NODES),
        "the nodes (cells 301, 115, 42 and 277) stand in one line, so that a position and its mirror image fit "
        "equally; a node off that line is needed",
    ),
    "collinear in three dimensions": (
        re.sub(r"position_m = \[(\S+), \S+, 0.0\]\nantenna_height_m = \S+", r"position_m = [\1, 50.0, 20.0]", NODES_3D),
        "the nodes (cells 301, 115, 42 and 277) stand in one line, around which every position fits equally; nodes off "
        "that line are needed",
    ),
    "all in one place": (
        re.sub(r"position_m = \[.*\]\nantenna_height_m = \S+", "position_m = [5.0, 50.0, 20.0]", NODES_3D),
        "the nodes (cells 301, 115, 42 and 277) stand in one place; nodes around the receiver are needed",
    ),
}


@pytest.mark.parametrize("case", LOCATE_MISTAKES)
def test_locate_refuses(city, tmp_path, case):
    content, sentence = LOCATE_MISTAKES[case]
    path = tmp_path / "nodes.toml"
    path.write_text(content)
    result = run("locate", city, "--nodes", path, "--out", tmp_path / "out", code=2)
    assert result.stderr == f"{path}: {sentence}\n"
    assert result.stdout == ""
    assert not (tmp_path / "out").exists()


def test_locate_without_any_known_cell(city, tmp_path):
    path = tmp_path / "nodes.toml"
    path.write_text("[receiver]\nheight_m = 0.0\n[[nodes]]\ncell_id = 9\nposition_m = [0.0, 0.0, 0.0]\n")
    message = run("locate", city, "--nodes", path, code=2).stderr
    assert message == f"{city}: no cell of {path} was found in it; cells found: 42, 115, 277 and 301\n"


def test_locate_refuses_a_nodes_file(city, tmp_path):
    path = tmp_path / "nodes.toml"
    path.write_text(NODES.replace("[520.0, -780.0, 0.0]", "[520.0, -780.0]"))
    line = NODES.splitlines().index("position_m = [520.0, -780.0, 0.0]") + 1
    assert run("locate", city, "--nodes", path, code=2).stderr == (
        f"{path}:{line}: nodes[2].position_m: three numbers expected, got two\n"
    )
    assert run("locate", city, "--nodes", tmp_path / "no.toml", code=2).stderr.endswith("no such file or directory\n")


def test_locate_writes_beside_where_it_runs(city, nodes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("locate", city, "--nodes", nodes).stdout.splitlines()[-1] == "report: city.locate/report.html"
    assert (tmp_path / "city.locate" / "report.html").exists()


def test_synth_refuses(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO.replace("n_rb = 15", "n_rb = 14", 1))
    line = SCENARIO.splitlines().index("n_rb = 15") + 1
    assert run("synth", "lte", path, tmp_path / "x", code=2).stderr == (
        f"{path}:{line}: cells[0].n_rb: input should be 6, 15, 25, 50, 75 or 100\n"
    )
    assert not list(tmp_path.glob("x*"))


def test_help_reads_well():
    text = run("--help").stdout
    for command in ("scan", "locate", "synth"):
        assert re.search(rf"^  {command} +[A-Z].*\.$", text, re.MULTILINE)
    for command in (["scan"], ["locate"], ["synth"], ["synth", "lte"]):
        page = run(*command, "--help").stdout
        assert max(len(line) for line in page.splitlines()) <= 100
    assert "--max-cfo HZ" in run("scan", "--help").stdout
    assert run("--version").stdout == f"soopnav, version {sn.__version__}\n"
    assert run("scan", code=2).stderr.endswith("Missing argument 'CAPTURE'.\n")


def test_progress_shows_what_is_done_once_it_takes_long():
    from rich.console import Console

    terminal = Console(force_terminal=True, width=80, record=True, file=io.StringIO())
    with progress(after_s=0.0, console=terminal) as step:
        step("searching city")
        step("timing cell 3", done=1, total=4)
        # The bar starts in a thread of its own; its last frame is drawn when it ends.
        while not terminal._live_stack:
            pass
    assert "timing cell 3" in terminal.export_text()
    pipe = Console(force_terminal=False, width=80, record=True, file=io.StringIO())
    with progress(after_s=0.0, console=pipe) as step:
        step("searching city")
    assert pipe.export_text().strip() == ""


def test_the_installed_command(city, tmp_path):
    command = [sys.executable, "-c", "from soopnav_cpp.cli import main; main()"]
    installed = Path(sys.executable).with_name("soopnav")
    if installed.exists():
        command = [str(installed)]
    done = subprocess.run([*command, "scan", str(city), "--json"], capture_output=True, text=True, check=True)
    assert len(json.loads(done.stdout)["cells"]) == 4
    assert done.stderr == ""
    done = subprocess.run([*command, "scan", str(tmp_path / "no.ci8")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"{tmp_path / 'no.ci8'}: no such file\n"


def test_missing_extras_are_named(tmp_path):
    block = "import sys; sys.modules[{name!r}] = None; "
    for name, statement, sentence in (
        ("click", "from soopnav_cpp.cli import main; main()", "the soopnav command needs click: {pip}[cli]"),
        ("sigmf", "import soopnav_cpp as s; s.io.read_iq({path!r})", "reading SigMF needs sigmf: {pip}[io]"),
        (
            "matplotlib",
            "import soopnav_cpp as s; s.plotting.scan(None, 1.0, [], [])",
            "drawing needs matplotlib: {pip}[plot]",
        ),
    ):
        path = tmp_path / "x.sigmf-meta"
        path.write_text("{}")
        program = block.format(name=name) + statement.format(path=str(path))
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert done.stderr.strip().endswith(sentence.format(pip="pip install soopnav"))


def test_numpy_is_all_that_importing_needs():
    program = (
        "import sys\n"
        "for name in ('click', 'rich', 'pydantic', 'tomlkit', 'sigmf', 'jsonschema', 'matplotlib', 'scipy'):\n"
        "    sys.modules[name] = None\n"
        "import soopnav_cpp as sn\n"
        "print(sn.lte.pss(0).shape)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "(62,)\n"


def test_scan_draws_only_into_png(city):
    assert run("scan", city, "--plot", "city.svg", code=2).stderr == "city.svg: a name that ends in .png expected\n"
