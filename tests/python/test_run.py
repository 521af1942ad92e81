"""``soopnav run``: every file it writes reads back, the report stands alone, and what it says is right."""

import base64
import csv
import datetime
import html
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.progress import Progress

import soopnav_cpp as sn
from soopnav_cpp import scenarios
from soopnav_cpp.cli.app import cli
from soopnav_cpp.cli.progress import _TimeLeft
from soopnav_cpp.scenarios import SystemRun, execution, registry, report, writers

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.unit

RUNS = 4
SCENARIO = """\
system = "cart"
title = "A cart <among> anchors"
duration_s = 20.0
sigma_m = 2.0
outlier_share = 0.05
runs = 4
metrics_start_s = 2.0
start_utc = 2026-11-22T23:59:55+00:00

[origin]
latitude_deg = -33.5
longitude_deg = 151.25
height_m = 40.0

[[anchors]]
name = "A"
position_m = [120.0, 0.0, 0.0]
[[anchors]]
name = "B"
position_m = [-80.0, 150.0, 0.0]
[[anchors]]
name = "C & D"
position_m = [0.0, -140.0, 0.0]
"""
WITHOUT_ORIGIN = re.sub(r"\[origin\].*?\n\n", "", SCENARIO, flags=re.DOTALL)


def install(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent / "support")
    import cart_system

    monkeypatch.setitem(scenarios.SYSTEMS._systems, "cart", cart_system.Cart())


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, ["run", *(str(a) for a in arguments)], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(autouse=True)
def _cart(monkeypatch):
    install(monkeypatch)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A Monte-Carlo of four runs: what it printed, and its folder."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "cart.toml").write_text(SCENARIO)
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        patch.chdir(folder)
        result = run("cart.toml", "--jobs", 1)
    return result, folder / "cart.run"


def table(path):
    """Rows of a CSV file by the names of its columns."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def states(done):
    with np.load(done[1] / "states.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def metrics(done):
    return json.loads((done[1] / "metrics.json").read_text())


# ---- the command


def test_it_ends_with_a_sentence_and_the_report(done, metrics):
    result, folder = done
    sentence, report = result.stdout.splitlines()
    pooled = metrics["pooled"]
    share = 100.0 * pooled["coverage"]["1_sigma"]["share"]
    assert sentence == (
        f"A cart <among> anchors: position RMS {pooled['position']['rmse_m']:.2f} m over 4 runs, "
        f"worst {pooled['position']['max_m']:.2f} m; {share:.1f} % of errors within 1σ (68.3 % expected); "
        f"{pooled['measurements']['rejected']} of 960 measurements rejected."
    )
    assert report == "report: cart.run/report.html"
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        ["consistency.png", "errors.png", "innovations.png", "metrics.json", "report.html", "rms.png", "runs.csv",
         "state_errors.png", "states.npz",
         "trajectory.csv", "trajectory.geojson", "trajectory.nmea", "trajectory.png", "trajectory.tum"]
    )  # fmt: skip


@pytest.fixture
def undrawn(monkeypatch):
    """For tests that look at no figure: drawing them takes most of the time."""
    monkeypatch.setattr(report, "_figures", lambda results, folder: [])


@pytest.mark.usefixtures("undrawn")
def test_seed_runs_only_and_out(tmp_path, metrics):
    path = tmp_path / "cart.toml"
    path.write_text(SCENARIO)
    run(path, "--runs", 2, "--only", 2, "--out", tmp_path / "other")
    found = json.loads((tmp_path / "other" / "metrics.json").read_text())
    assert [row["run"] for row in found["each"]] == [2]
    assert found["each"][0] == metrics["each"][1]
    assert run(path, "--runs", 2, "--only", 3, code=2).stderr == "--only 3: the scenario has 2 runs\n"


def test_mistakes_are_sentences_with_exit_code_2(tmp_path):
    path = tmp_path / "cart.toml"
    path.write_text(SCENARIO.replace("sigma_m = 2.0", "sigma_m = 2.0\nrates_hz = 4"))
    assert run(path, code=2).stderr == f"{path}:5: rates_hz: unknown key; did you mean rate_hz?\n"
    assert run(tmp_path / "none.toml", code=2).stderr == f"{tmp_path / 'none.toml'}: no such file or directory\n"
    assert "Missing argument 'SCENARIO'" in run(code=2).stderr
    assert not list(tmp_path.glob("*.run"))


@pytest.mark.usefixtures("undrawn")
def test_a_failing_run_is_named_with_its_seed(tmp_path):
    path = tmp_path / "cart.toml"
    path.write_text(SCENARIO)
    _, scenario = scenarios.load(path)
    seed = execution.seed_of_run(scenario, 2)
    path.write_text(SCENARIO.replace("runs = 4", f"runs = 3\nfail_run_seeds = [{seed}]"))
    result = run(path, "--out", tmp_path / "out", "--jobs", 1, code=1)
    assert f"run 2 (seed {seed}): RuntimeError: the cart broke down" in result.stderr
    assert "over 2 runs" in result.stdout
    assert "1 of 3 runs failed." in result.stdout
    content = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert content["failed"] == [{"run": 2, "seed": seed, "error": "RuntimeError: the cart broke down"}]
    assert "the cart broke down" in (tmp_path / "out" / "report.html").read_text()
    rows = table(tmp_path / "out" / "runs.csv")
    assert [row["error"] for row in rows] == ["", "RuntimeError: the cart broke down", ""]
    path.write_text(SCENARIO.replace("runs = 4", f"runs = 2\nfail_run_seeds = [{seed}]"))
    result = run(path, "--only", 2, "--out", tmp_path / "nothing", code=1)
    assert result.stdout == ""
    assert not (tmp_path / "nothing").exists()


def test_what_there_is_to_run():
    assert re.search(r"^cart +a cart ranged from known places", run("--list").stdout, re.MULTILINE)
    assert run("--example", "cart").stdout.startswith('system = "cart"\n')
    assert "sigma_m =              # needed" in run("--schema", "cart").stdout
    assert "unknown system 'card'; did you mean cart" in run("--schema", "card", code=2).stderr


@pytest.mark.parametrize(
    ("completed", "total", "elapsed_s", "words"),
    [
        (1, 3, 10.0, "0:20 left"),
        (1, 1001, 7.5, "2:05:00 left"),
        (0, 3, 10.0, ""),
        (0, None, 10.0, ""),
        (3, 3, 9.0, "0:00 left"),
    ],
)
def test_the_bar_says_how_long_is_left(completed, total, elapsed_s, words):
    clock_s = [0.0]
    bar = Progress(get_time=lambda: clock_s[0])
    task = bar.add_task("runs", total=total, completed=completed)
    clock_s[0] = elapsed_s
    assert _TimeLeft().render(bar.tasks[task]).plain == words


# ---- files


def test_tum(done, states):
    rows = np.loadtxt(done[1] / "trajectory.tum")
    assert rows.shape == (80, 8)
    np.testing.assert_allclose(rows[:, 0], states["t_s"], atol=1e-9)
    np.testing.assert_allclose(rows[:, 1:3], states["position_m"], atol=1e-6)
    np.testing.assert_array_equal(rows[:, 3:], np.tile([0.0, 0.0, 0.0, 0.0, 1.0], (80, 1)))


def test_csv(done, states):
    rows = table(done[1] / "trajectory.csv")
    columns = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    np.testing.assert_allclose(columns["position_y_m"], states["position_m"][:, 1], atol=1e-9)
    np.testing.assert_allclose(columns["truth_x_m"], states["truth_position_m"][:, 0], atol=1e-9)
    np.testing.assert_allclose(columns["velocity_x_mps"], states["velocity_mps"][:, 0], atol=1e-9)
    sigma = np.sqrt(states["position_covariance_m2"][:, 1, 1])
    np.testing.assert_allclose(columns["sigma_y_m"], sigma, atol=1e-9)
    p_e = sn.geometry.geodetic_to_ecef(
        np.radians(columns["latitude_deg"]), np.radians(columns["longitude_deg"]), columns["height_m"]
    )
    frame = sn.geometry.LocalFrame(math.radians(-33.5), math.radians(151.25), 40.0)
    np.testing.assert_allclose(frame.position_from_ecef(p_e)[:, :2], states["position_m"], atol=1e-4)


def area(ring):
    x, y = np.asarray(ring)[:, :2].T - np.asarray(ring)[0, :2, None]
    return 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])


def test_geojson_on_the_earth(done, states):
    content = json.loads((done[1] / "trajectory.geojson").read_text())
    kinds = [feature["properties"]["kind"] for feature in content["features"]]
    assert kinds[:3] == ["estimate", "truth", "baseline"]
    assert kinds[-3:] == ["source"] * 3
    assert "coordinate_frame" not in content
    line = np.array(content["features"][0]["geometry"]["coordinates"])
    frame = sn.geometry.LocalFrame(math.radians(-33.5), math.radians(151.25), 40.0)
    back = frame.position_from_geodetic(np.radians(line[:, 1]), np.radians(line[:, 0]), line[:, 2])
    np.testing.assert_allclose(back[:, :2], states["position_m"], atol=1e-3)
    ellipses = [f for f in content["features"] if f["properties"]["kind"] == "error ellipse"]
    assert len(ellipses) == 60
    for ellipse in ellipses:
        [ring] = ellipse["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        assert area(ring) > 0.0


def checked(path):
    """Sentences as fields, their checksums verified by hand."""
    found = []
    raw = path.read_bytes()
    assert raw.endswith(b"\r\n")
    for line in raw.decode("ascii").split("\r\n")[:-1]:
        assert len(line) <= 80
        body, _, checksum = line.removeprefix("$").partition("*")
        total = 0
        for letter in body:
            total ^= ord(letter)
        assert checksum == f"{total:02X}"
        found.append(body.split(","))
    return found


def degrees(value, side):
    whole, minutes = divmod(float(value), 100.0)
    return (whole + minutes / 60.0) * (-1.0 if side in "SW" else 1.0)


def test_nmea(done, states):
    sentences = checked(done[1] / "trajectory.nmea")
    assert [fields[0] for fields in sentences[:3]] == ["INGGA", "INRMC", "INGST"]
    gga = [fields for fields in sentences if fields[0] == "INGGA"]
    rmc = [fields for fields in sentences if fields[0] == "INRMC"]
    gst = [fields for fields in sentences if fields[0] == "INGST"]
    assert len(gga) == len(rmc) == len(gst) == 21
    first = [0, *range(3, 80, 4)]  # 0.25 s, then each whole second
    frame = sn.geometry.LocalFrame(math.radians(-33.5), math.radians(151.25), 40.0)
    for k, a, b, c in zip(first, gga, rmc, gst, strict=True):
        place = degrees(a[2], a[3]), degrees(a[4], a[5])
        assert (a[2:6], a[1]) == (b[3:7], b[1])
        back = frame.position_from_geodetic(math.radians(place[0]), math.radians(place[1]), float(a[9]))
        np.testing.assert_allclose(back[:2], states["position_m"][k], atol=2e-3)
        assert (a[6], a[7], a[11], b[2], b[12]) == ("8", "03", "0.0", "A", "S")
        east, north = states["velocity_mps"][k]
        assert float(b[7]) * 1852.0 / 3600.0 == pytest.approx(math.hypot(east, north), abs=1e-3)
        assert math.sin(math.radians(float(b[8])) - math.atan2(east, north)) == pytest.approx(0.0, abs=2e-4)
        P = states["position_covariance_m2"][k]
        assert float(c[6]) == pytest.approx(math.sqrt(P[1, 1]), abs=6e-4)
        assert float(c[7]) == pytest.approx(math.sqrt(P[0, 0]), abs=6e-4)
        major, minor = np.sqrt(np.linalg.eigvalsh(P))[::-1]
        assert [float(c[3]), float(c[4])] == pytest.approx([major, minor], abs=6e-4)
        axis = np.array([math.sin(math.radians(float(c[5]))), math.cos(math.radians(float(c[5])))])
        assert axis @ P @ axis == pytest.approx(major**2, rel=1e-4)
    assert (rmc[0][1], rmc[0][9]) == ("235955.25", "221126")
    assert (rmc[-1][1], rmc[-1][9]) == ("000015.00", "231126")  # past midnight


def test_states(states, metrics):
    assert states["state_names"].tolist() == ["x_m", "y_m", "vx_mps", "vy_mps"]
    assert states["covariance"].shape == (80, 4, 4)
    assert states["update_status"].shape == (240,)
    assert set(states["update_status"]) == {"accepted", "gated"}
    assert states["update_source_names"].tolist() == ["A", "B", "C & D"]
    assert states["baseline_dead_reckoning_m"].shape == (80, 2)
    assert states["source_position_m"].tolist() == [[120.0, 0.0], [-80.0, 150.0], [0.0, -140.0]]
    counts = metrics["each"][0]["measurements"]
    assert counts["rejected"] == int(np.sum(states["update_status"] != "accepted")) > 0


def test_metrics_are_those_of_the_states(states, metrics):
    """By hand, from the file that a user has."""
    kept = states["t_s"] >= 2.0
    error = (states["position_m"] - states["truth_position_m"])[kept]
    P = states["position_covariance_m2"][kept]
    one = metrics["each"][0]
    assert one["position"]["rmse_m"] == pytest.approx(np.sqrt(np.mean(np.sum(error**2, axis=1))), rel=1e-12)
    inside = np.abs(error) <= np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    assert one["coverage"]["1_sigma"]["share"] == pytest.approx(inside.mean())
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)
    assert one["nees"]["mean"] == pytest.approx(square.mean(), rel=1e-9)
    difference = (states["state"] - states["truth_state"])[kept]
    square = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(states["covariance"][kept]), difference)
    assert one["state_nees"]["mean"] == pytest.approx(square.mean(), rel=1e-9)
    good = states["update_status"] == "accepted"
    nis = states["update_innovation"] ** 2 / states["update_variance"]
    assert one["nis"]["mean"] == pytest.approx(nis[good].mean(), rel=1e-12)
    pooled = np.sqrt(np.mean([row["position"]["rmse_m"] ** 2 for row in metrics["each"]]))
    assert metrics["pooled"]["position"]["rmse_m"] == pytest.approx(pooled, rel=1e-12)
    assert (metrics["runs"], metrics["seed"], metrics["failed"]) == (4, 1, [])


def test_runs(done, metrics):
    rows = table(done[1] / "runs.csv")
    assert [int(row["seed"]) for row in rows] == [row["seed"] for row in metrics["each"]]
    assert [float(row["rmse_m"]) for row in rows] == [row["position"]["rmse_m"] for row in metrics["each"]]
    assert [row["error"] for row in rows] == [""] * RUNS


# ---- the report


class Page(HTMLParser):
    """Tags that are open, what others refer to, and the text."""

    def __init__(self):
        super().__init__()
        self.open, self.references, self.text, self.tags = [], [], "", []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.references += [value for name, value in attributes if name in ("src", "href", "data", "action")]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_report_stands_alone(done, metrics):
    text = (done[1] / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    bare = re.sub(r'"data:image/png;base64,[^"]*"', "", text)  # in which any four letters may stand
    assert "http" not in bare
    assert "url(" not in bare
    assert len(page.references) == 6
    for reference in page.references:
        kind, _, data = reference.partition(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data, validate=True).startswith(b"\x89PNG")
    pooled = metrics["pooled"]
    words = " ".join(page.text.split())
    assert done[0].stdout.split(": ", 1)[1].splitlines()[0][1:] in words  # the verdict, but for its capital
    for value in (
        f"{pooled['position']['cep50_m']:.2f} m",
        f"{pooled['nees']['mean']:.3f}",
        f"{pooled['nees']['bounds'][0]:.3f} … {pooled['nees']['bounds'][1]:.3f}",
        str(metrics["each"][3]["seed"]),
        "Ranges are made up (4 runs, first run 1)",
        "C & D",
        f"soopnav {sn.__version__}",
    ):
        assert value in words
    assert html.escape(SCENARIO) in text
    assert "<among>" not in text  # escaped


def test_without_an_origin_there_is_no_place_on_the_earth(tmp_path, done):
    path = tmp_path / "cart.toml"
    path.write_text(WITHOUT_ORIGIN.replace("runs = 4", "truth = false"))
    out = tmp_path / "out"
    out.mkdir()
    (out / "trajectory.nmea").write_text("of an earlier run")
    result = run(path, "--out", out)
    assert re.search(
        r"anchors: no truth to compare with; stated σ of the position \d\.\d\d m; mean NIS [01]\.\d\d \(1 expected\); "
        r"\d+ of 240 measurements rejected\.\n",
        result.stdout,
    )
    assert not (out / "trajectory.nmea").exists()
    content = json.loads((out / "trajectory.geojson").read_text())
    assert content["coordinate_frame"].startswith("local, metres")
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["pooled"]["position"] is None
    assert not (out / "errors.png").exists()
    assert "latitude_deg" not in (out / "trajectory.csv").read_text()
    text = (out / "report.html").read_text()
    assert "No truth to compare with" in text
    assert "NIS of accepted measurements" in text


# ---- the guide


def test_the_guide_adds_a_system(tmp_path, monkeypatch):
    mine = registry.Systems()
    monkeypatch.setattr(registry, "SYSTEMS", mine)
    guide = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    [snippet] = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    [toml] = re.findall(r"```toml\n(.*?)```", guide, re.DOTALL)
    exec(compile(snippet, "docs/scenarios.md", "exec"), {"__name__": "walker"})
    (tmp_path / "walk.toml").write_text(toml)
    system, scenario = scenarios.load(tmp_path / "walk.toml", runs=30)
    results = report.results_of(tmp_path / "walk.toml", system, scenario, execution.execute(system, scenario))
    pooled = results.pooled
    assert pooled["nees"]["inside"]
    assert pooled["coverage"]["1_sigma"]["inside"]
    assert pooled["position"]["rmse_m"] < 0.75 * pooled["baselines"]["fixes alone"]["rmse_m"]
    for name in scenarios.Scenario.model_fields:
        assert f"`{name}`" in guide


# ---- other shapes of runs


def spatial(n=5, **changes):
    """A climbing turn in space, north-east-down."""
    t = np.arange(n) * 0.5
    yaw = 0.3 * t
    given = {
        "t_s": t,
        "position_m": np.column_stack([100.0 * t, 10.0 * t, -5.0 * t]),
        "position_covariance_m2": np.tile(np.diag([4.0, 1.0, 9.0]), (n, 1, 1)),
        "velocity_mps": np.tile([3.0, 4.0, -1.0], (n, 1)),
        "quaternion_wxyz": np.column_stack([np.cos(yaw / 2), np.zeros(n), np.zeros(n), np.sin(yaw / 2)]),
        "axes": "ned",
        "origin_lla_deg": (0.0, -0.0001, 100.0),
        "sources": {"A": np.array([1e3, 0.0, 0.0])},
    }
    return SystemRun(**(given | changes))


def test_north_east_down(tmp_path):
    run_ = spatial()
    writers.write_nmea(run_, tmp_path / "x.nmea")
    gga, rmc, gst = checked(tmp_path / "x.nmea")[-3:]
    assert (gga[1], gga[6]) == ("000002.00", "6")
    assert degrees(gga[2], gga[3]) * 110_574.3 == pytest.approx(200.0, abs=0.05)
    assert (degrees(gga[4], gga[5]) + 0.0001) * 111_319.49 == pytest.approx(20.0, abs=0.05)
    assert float(gga[9]) == pytest.approx(110.0, abs=0.01)
    assert (rmc[9], rmc[12]) == ("010100", "E")
    assert float(rmc[8]) == pytest.approx(math.degrees(math.atan2(4.0, 3.0)), abs=0.01)
    assert gst[2:] == ["", "2.000", "1.000", "0.0", "2.000", "1.000", "3.000"]
    writers.write_tum(run_, tmp_path / "x.tum")
    np.testing.assert_allclose(np.loadtxt(tmp_path / "x.tum")[:, 4:], run_.quaternion_wxyz[:, [1, 2, 3, 0]], atol=1e-9)
    writers.write_geojson(run_, tmp_path / "x.geojson")
    content = json.loads((tmp_path / "x.geojson").read_text())
    assert all(
        area(f["geometry"]["coordinates"][0]) > 0.0 for f in content["features"] if f["geometry"]["type"] == "Polygon"
    )
    line = content["features"][0]["geometry"]["coordinates"]
    assert line[-1][2] == pytest.approx(110.0, abs=0.01)


def test_a_heading_turns_the_tum_attitude_about_the_third_axis(tmp_path):
    heading = np.array([0.5, -2.0])
    run_ = SystemRun(
        t_s=[0.0, 1.0], position_m=np.zeros((2, 2)), position_covariance_m2=np.zeros((2, 2, 2)), heading_rad=heading
    )
    writers.write_tum(run_, tmp_path / "x.tum")
    _, _, z, w = np.loadtxt(tmp_path / "x.tum")[:, 4:].T
    np.testing.assert_allclose(np.exp(2j * np.arctan2(z, w)), np.exp(1j * heading), atol=1e-8)
    writers.write_geojson(run_, tmp_path / "x.geojson")  # no ellipse where nothing is uncertain
    assert "Polygon" not in (tmp_path / "x.geojson").read_text()
    with pytest.raises(ValueError, match=r"add \[origin\] with latitude_deg and longitude_deg"):
        writers.write_nmea(run_, tmp_path / "x.nmea")


@pytest.mark.parametrize(
    ("value", "digits", "sides", "expected"),
    [
        (52.20511, 2, "NS", ("5212.306600", "N")),
        (-0.12184, 3, "EW", ("00007.310400", "W")),
        (9.9999999999, 2, "NS", ("1000.000000", "N")),
        (179.99999999999, 3, "EW", ("18000.000000", "E")),
        (0.0, 2, "NS", ("0000.000000", "N")),
    ],
)
def test_minutes_never_reach_sixty(value, digits, sides, expected):
    assert writers._angle(value, digits, sides) == expected


def test_the_checksum_of_a_known_sentence():
    """From the NMEA 0183 literature."""
    body = "GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    assert writers.nmea_checksum(body) == "47"


def test_a_start_with_another_time_zone_is_utc(tmp_path):
    start = datetime.datetime(2026, 1, 1, 1, 0, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    writers.write_nmea(spatial(), tmp_path / "x.nmea", start_utc=start)
    rmc = checked(tmp_path / "x.nmea")[1]
    assert (rmc[1], rmc[9]) == ("230000.00", "311225")
