"""``soopnav locate-emitter``: positions from bearings in files, what it writes, and how it refuses."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result

from soopnav_cpp import _source_figures
from soopnav_cpp.scenarios import emitters
from soopnav_cpp.scenarios.bearings import BearingsData, read_bearings

pytest.importorskip("matplotlib")

from soopnav_cpp.cli import locate_emitter
from soopnav_cpp.cli.app import cli

EMITTER = np.array([40.0, 120.0])


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without figures, which take most of the time."""
    monkeypatch.setattr(locate_emitter, "figures", lambda _result, _folder: [])


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not their pixels."""

    def save(figure: object, path: Path | None) -> object:
        if path is not None:
            Path(path).write_bytes(b"\x89PNG")
        return figure

    monkeypatch.setattr(_source_figures, "_save", save)


def csv_of(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def drive(n: int = 24, *, seed: int = 1, sigma_deg: float = 1.0, emitter: np.ndarray = EMITTER) -> list[str]:
    """Bearings from a bent path, one second apart."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([np.linspace(-300.0, 300.0, n), 50.0 * np.sin(np.linspace(0.0, 3.0, n)) - 100.0])
    compass = np.degrees(np.arctan2(emitter[0] - places[:, 0], emitter[1] - places[:, 1]))
    compass += sigma_deg * rng.standard_normal(n)
    return [
        f"{k},{x:.3f},{y:.3f},{b % 360.0:.4f},{sigma_deg}"
        for k, ((x, y), b) in enumerate(zip(places, compass, strict=True))
    ]


HEAD = "time_s,x_m,y_m,bearing_deg,sigma_deg"


def fixes(folder: Path, emitter: int = 0) -> dict[str, dict]:
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    return metrics["emitters"][emitter]["methods"]


def nees(fix: dict, right: np.ndarray) -> float:
    off = np.array(fix["position_m"][:2]) - right
    return float(off @ np.linalg.solve(np.array(fix["covariance_m2"])[:2, :2], off))


def test_a_position_in_local_metres(tmp_path: Path) -> None:
    path = csv_of(tmp_path / "b.csv", [HEAD, *drive()])
    out = tmp_path / "out"
    shown = run("locate-emitter", path, "--method", "all", "--out", out).stdout
    fix = fixes(out)["ml"]
    assert fix["status"] == "converged"
    assert nees(fix, EMITTER) < 27.6  # chi-square of two, 1e-6
    assert 0.5 < fix["cep_m"] < 10.0
    assert "emitter: east" in shown
    assert "95 % within" in shown
    names = {p.name for p in out.iterdir()}
    assert names >= {
        "map.png",
        "likelihood.png",
        "errors.png",
        "emitter.geojson",
        "metrics.json",
        "bearings.csv",
        "report.html",
    }
    assert "emitter.kml" not in names  # nowhere on the Earth
    assert "metres" in json.loads((out / "emitter.geojson").read_text(encoding="utf-8"))["coordinate_frame"]
    again = read_bearings(out / "bearings.csv")
    np.testing.assert_allclose(again.bearing_rad, read_bearings(path).bearing_rad, atol=1e-7)


@pytest.mark.usefixtures("plain")
def test_every_method_in_a_table(tmp_path: Path) -> None:
    """All methods from one file, with the truth beside them: the good ones agree, all are listed."""
    lines = [f"{line},{EMITTER[0]},{EMITTER[1]}" for line in drive(40)]
    path = csv_of(tmp_path / "b.csv", [f"{HEAD},truth_x_m,truth_y_m", *lines])
    out = tmp_path / "out"
    shown = run("locate-emitter", path, "--method", "all", "--seed", 3, "--out", out).stdout
    found = fixes(out)
    assert set(found) == {
        "ml", "stansfield", "least_squares", "ekf_bank", "particle", "ekf", "centroid", "incenter", "linear",
    }  # fmt: skip
    for method in ("ml", "stansfield", "least_squares", "particle", "ekf_bank"):
        assert found[method]["status"] == "converged", method
        assert found[method]["error_m"] < 12.0, method
        assert method in shown
    assert "error" in shown.splitlines()[0]


@pytest.mark.usefixtures("plain")
def test_on_the_earth(tmp_path: Path) -> None:
    """KML and GeoJSON with longitude first; the same place by --origin and by latitudes in the file."""
    path = csv_of(tmp_path / "b.csv", [HEAD, *drive()])
    out = tmp_path / "out"
    shown = run("locate-emitter", path, "--origin", "32.6,-85.5,200", "--out", out).stdout
    fix = fixes(out)["ml"]
    metres = 111_200.0
    assert fix["latitude_deg"] == pytest.approx(32.6 + fix["position_m"][1] / metres, abs=1e-5)
    assert fix["longitude_deg"] == pytest.approx(
        -85.5 + fix["position_m"][0] / (metres * math.cos(math.radians(32.6))), abs=1e-5
    )
    assert " N  85." in shown
    assert "W" in shown
    root = ElementTree.parse(out / "emitter.kml").getroot()
    point = root.find(".//{http://www.opengis.net/kml/2.2}Point/{http://www.opengis.net/kml/2.2}coordinates")
    assert point is not None
    assert point.text is not None
    longitude, latitude = (float(v) for v in point.text.split(","))
    assert (latitude, longitude) == pytest.approx((fix["latitude_deg"], fix["longitude_deg"]), abs=1e-8)
    features = json.loads((out / "emitter.geojson").read_text(encoding="utf-8"))["features"]
    emitter = next(f for f in features if f["properties"]["kind"] == "emitter")
    assert emitter["geometry"]["coordinates"][:2] == pytest.approx([longitude, latitude], abs=1e-8)
    # bearings.csv is on the Earth now, and leads to the same place
    again = tmp_path / "again"
    run("locate-emitter", out / "bearings.csv", "--out", again)
    same = fixes(again)["ml"]
    assert same["latitude_deg"] == pytest.approx(fix["latitude_deg"], abs=2e-7)
    assert same["longitude_deg"] == pytest.approx(fix["longitude_deg"], abs=2e-7)
    result = run("locate-emitter", out / "bearings.csv", "--origin", "1,1", "--out", again, code=2)
    assert "--origin is for bearings in local metres" in result.stderr


@pytest.mark.usefixtures("plain")
def test_three_dimensions(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    n = 40
    emitter = np.array([40.0, 120.0, 60.0])
    places = np.column_stack(
        [np.linspace(-200.0, 200.0, n), -100.0 + 80.0 * np.sin(np.linspace(0.0, 3.0, n)), np.zeros(n)]
    )
    to = emitter - places
    compass = np.degrees(np.arctan2(to[:, 0], to[:, 1])) + rng.standard_normal(n)
    up = np.degrees(np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1]))) + rng.standard_normal(n)
    lines = [f"{k},{places[k, 0]},{places[k, 1]},0,{compass[k] % 360},{up[k]},1" for k in range(n)]
    path = csv_of(tmp_path / "b.csv", ["time_s,x_m,y_m,z_m,bearing_deg,elevation_deg,sigma_deg", *lines])
    run("locate-emitter", path, "--dimensions", 3, "--out", tmp_path / "out")
    fix = fixes(tmp_path / "out")["ml"]
    off = np.array(fix["position_m"]) - emitter
    assert len(off) == 3
    assert off @ np.linalg.solve(np.array(fix["covariance_m2"]), off) < 30.7  # chi-square of three, 1e-6
    flat = csv_of(tmp_path / "flat.csv", [HEAD, *drive()])
    result = run("locate-emitter", flat, "--dimensions", 3, "--out", tmp_path / "out", code=2)
    assert "no elevations; --dimensions 3 needs a column" in result.stderr


@pytest.mark.usefixtures("unrendered")
def test_several_emitters_by_name(tmp_path: Path) -> None:
    other = np.array([-120.0, -400.0])
    lines = [f"A,{line}" for line in drive(8, seed=1)] + [f"B,{line}" for line in drive(8, seed=2, emitter=other)]
    path = csv_of(tmp_path / "b.csv", [f"emitter,{HEAD}", *lines])
    out = tmp_path / "out"
    shown = run("locate-emitter", path, "--out", out).stdout
    assert "A: east" in shown
    assert "B: east" in shown
    assert nees(fixes(out, 0)["ml"], EMITTER) < 27.6
    assert nees(fixes(out, 1)["ml"], other) < 27.6
    assert {"likelihood_1_a.png", "likelihood_2_b.png", "map.png"} <= {p.name for p in out.iterdir()}


@pytest.mark.usefixtures("plain")
def test_several_emitters_without_names(tmp_path: Path) -> None:
    """Two bearings at each time and nothing that says whose they are."""
    other = np.array([-120.0, -500.0])
    both = [drive(60, seed=1), drive(60, seed=2, emitter=other)]
    lines = [line for pair in zip(*both, strict=True) for line in pair]
    path = csv_of(tmp_path / "b.csv", [HEAD, *lines])
    out = tmp_path / "out"
    run("locate-emitter", path, "--out", out)
    metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    places = [np.array(e["methods"]["ml"]["position_m"][:2]) for e in metrics["emitters"]]
    assert len(places) == 2
    for right in (EMITTER, other):
        assert min(np.linalg.norm(place - right) for place in places) < 25.0


def mixed(
    scale: float = 1.0,
    *,
    sigma_deg: float = 1.0,
    n: int = 120,
    velocity: tuple[float, float] = (0.0, 0.0),
    heading_sigma_deg: float = 0.0,
) -> BearingsData:
    """Bearings of two emitters by turns, two at each time; rows 0, 2, 4 ... are of the first."""
    rng = np.random.default_rng(1)
    along = np.linspace(0.0, 1.0, n)
    places = np.column_stack([600.0 * along - 300.0, 50.0 * np.sin(3.0 * along) - 100.0, np.zeros(n)])
    heading = math.radians(heading_sigma_deg) * rng.standard_normal(n)
    time, places, heading = (np.repeat(v, 2, axis=0) for v in (np.arange(float(n)), places, heading))
    right = np.tile([EMITTER, [-120.0, -500.0]], (n, 1)) + time[:, None] * np.array(velocity)
    way = right - places[:, :2]
    bearing = np.arctan2(way[:, 1], way[:, 0]) + math.radians(sigma_deg) * rng.standard_normal(2 * n) + heading
    return BearingsData(
        time,
        scale * places,
        np.angle(np.exp(1j * bearing)),
        np.full(2 * n, math.radians(sigma_deg)),
        heading_sigma_rad=np.full(2 * n, math.radians(heading_sigma_deg)) if heading_sigma_deg else None,
    )


@pytest.mark.parametrize(("scale", "sigma_deg"), [(0.001, 0.3), (1.0, 12.0), (100.0, 1.0), (100.0, 12.0)])
def test_emitters_are_told_apart_at_any_scale(scale: float, sigma_deg: float) -> None:
    """Indoors or forty kilometres away, and with bearings too coarse for what a bank starts with by default."""
    label = emitters.associate(mixed(scale, sigma_deg=sigma_deg))
    assert label.max() == 1
    for emitter in (0, 1):
        mine = label[emitter::2]
        assert np.mean(mine == np.bincount(mine[mine >= 0]).argmax()) > 0.95
    assert label[0] != label[1]


def test_emitters_are_told_apart_with_a_poor_compass() -> None:
    """A heading of 10° and bearings of 1°: two emitters, as long as the tracks know of the heading."""
    label = emitters.associate(mixed(heading_sigma_deg=10.0))
    assert np.mean(label[0::2] == label[0]) > 0.9
    assert np.mean(label[1::2] == label[1]) > 0.9
    assert label[0] != label[1]


def test_a_bank_starts_with_a_poor_compass() -> None:
    """It looks all round when no bearing with its heading is good enough to start along."""
    data = mixed(heading_sigma_deg=12.0)
    assert emitters.solve("one", data.of(np.arange(0, 240, 2)), ["ekf_bank"], history=False, extras=False).found


def test_emitters_that_move_are_told_apart() -> None:
    data = mixed(velocity=(-3.0, 3.0))
    label = emitters.associate(data, moving=True)
    assert sorted(np.unique(label[label >= 0]).tolist()) == [0, 1]
    for emitter in (0, 1):
        assert np.mean(label[emitter::2] == label[-2 + emitter]) > 0.9


@pytest.mark.usefixtures("plain")
def test_moving_reaches_the_sorting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def associate(data: BearingsData, *, moving: bool = False) -> np.ndarray:
        asked.append(moving)
        return np.zeros(len(data), np.int64)

    monkeypatch.setattr(emitters, "associate", associate)
    path = csv_of(tmp_path / "b.csv", [HEAD, *drive(8)])
    for more in ([], ["--moving"]):
        CliRunner().invoke(cli, ["locate-emitter", str(path), "--associate", "--out", str(tmp_path / "o"), *more])
    assert asked == [False, True]


def test_figures_of_emitters_have_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that differ in what no file name has, and one too long for any; bearings of nobody are nobody's."""
    names = ["A 1", "a_1", "x" * 300]
    lines = [f"{name},{line}" for k, name in enumerate(names) for line in drive(8, seed=k)]
    lines += [f",{line}" for line in drive(2, seed=9, emitter=np.array([500.0, -700.0]))]
    data = read_bearings(csv_of(tmp_path / "b.csv", [f"emitter,{HEAD}", *lines]))
    parts, nobody = emitters.separate(data)
    found = [emitters.solve(name, part, ["ml"], history=False) for name, part in parts.items()]
    shown: dict[str, object] = {}
    monkeypatch.setattr(locate_emitter.plotting, "bearings_map", lambda *_, **given: shown.update(given))
    monkeypatch.setattr(locate_emitter.plotting, "likelihood", lambda *_, **__: None)
    result = locate_emitter.Result(tmp_path / "b.csv", "", data, found, nobody, 2)
    files = [file.name for _, file in locate_emitter.figures(result, tmp_path)]
    assert len(set(files)) == len(files) == 4
    assert max(map(len, files)) < 100
    who = shown["source"]
    assert isinstance(who, np.ndarray)
    assert data.emitter is not None
    np.testing.assert_array_equal(who, [names.index(name) if name else -1 for name in data.emitter])
    assert list(shown["fixes"]) == names


@pytest.mark.usefixtures("plain")
def test_a_seed_of_nought_is_a_seed(tmp_path: Path) -> None:
    path = csv_of(tmp_path / "b.csv", [HEAD, *drive(8)])
    places = {}
    for seed in ("0", "1", None):
        more = [] if seed is None else ["--seed", seed]
        run("locate-emitter", path, "--method", "particle", *more, "--out", tmp_path / "out")
        places[seed] = fixes(tmp_path / "out")["particle"]["position_m"]
    assert places["1"] == places[None]
    assert places["0"] != places["1"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--dimensions", "2"], "--dimensions is for files of bearings, and x.toml is a scenario; locator.dimensions"),
        (["--moving"], "--moving is for files of bearings, and x.toml is a scenario; locator.moving in the scenario"),
        (["--associate"], "--associate is for files of bearings, and x.toml is a scenario\n"),
        (["--sigma", "3"], "--sigma is for files of bearings"),
        (["--origin", "1,1"], "--origin is for files of bearings, and x.toml is a scenario; origin in the scenario"),
        (["--repair"], "--repair is for files of bearings"),
    ],
)
def test_options_that_a_scenario_does_not_take(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    toml = csv_of(tmp_path / "x.toml", ['system = "source_localization"'])
    result = run("locate-emitter", toml, *arguments, "--out", tmp_path / "out", code=2)
    assert sentence in result.stderr


@pytest.mark.usefixtures("unrendered")
def test_all_from_one_place(tmp_path: Path) -> None:
    """A line, said and drawn, and exit code 2; every file is there all the same."""
    path = csv_of(tmp_path / "b.csv", ["x_m,y_m,bearing_deg,sigma_deg", *(f"0,0,{b},1" for b in (44, 46, 45, 45.5))])
    out = tmp_path / "out"
    shown = run("locate-emitter", path, "--out", out, code=2).stdout
    assert "no position: 4 bearings give a line alone, at 45." in shown
    assert "bearings from elsewhere are needed" in shown
    metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    emitter = metrics["emitters"][0]
    assert not emitter["found"]
    assert emitter["line"]["bearing_deg"] == pytest.approx(45.1, abs=1.0)
    assert emitter["methods"]["ml"]["position_m"] is None
    features = json.loads((out / "emitter.geojson").read_text(encoding="utf-8"))["features"]
    line = next(f for f in features if f["properties"]["kind"] == "line")
    (x0, y0, _), (x1, y1, _) = line["geometry"]["coordinates"]
    assert math.degrees(math.atan2(x1 - x0, y1 - y0)) == pytest.approx(45.1, abs=1.0)
    assert (out / "map.png").exists()


@pytest.mark.usefixtures("plain")
def test_parallel_bearings(tmp_path: Path) -> None:
    path = csv_of(tmp_path / "b.csv", ["x_m,y_m,bearing_deg,sigma_deg", *(f"0,{10 * k},0,1" for k in range(5))])
    shown = run("locate-emitter", path, "--out", tmp_path / "out", code=2).stdout
    assert "no position" in shown


@pytest.mark.usefixtures("unrendered")
def test_bearings_that_contradict_each_other(tmp_path: Path) -> None:
    """Opposite bearings along one line: no place between infinities is called a position; every file is written."""
    lines = ["0,0,90,1", "1,0,270,1", "2,0,90,1", "5,0,90,1"]
    path = csv_of(tmp_path / "b.csv", ["x_m,y_m,bearing_deg,sigma_deg", *lines])
    shown = run("locate-emitter", path, "--method", "all", "--out", tmp_path / "out", code=2).stdout
    assert "no position" in shown
    assert (tmp_path / "out" / "report.html").exists()
    # Bearings to a place and one that points elsewhere: a position, and a word of caution.
    lines = ["0,0,0,1", "0,100,180,1", "50,50,270,1", "20,10,10,1"]
    path = csv_of(tmp_path / "b.csv", ["x_m,y_m,bearing_deg,sigma_deg", *lines])
    assert "caution" in run("locate-emitter", path, "--out", tmp_path / "out").stdout


@pytest.mark.usefixtures("plain")
def test_one_bearing(tmp_path: Path) -> None:
    path = csv_of(tmp_path / "b.csv", ["x_m,y_m,bearing_deg,sigma_deg", "0,0,10,1"])
    shown = run("locate-emitter", path, "--out", tmp_path / "out", code=2).stdout
    assert "no position" in shown


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--method", "guess"], "--method guess: one of ml, stansfield"),
        (["--method", "centroid", "--moving"], "--method centroid finds emitters that stand still; with --moving: ml"),
        (["--origin", "91,0"], "--origin 91,0: a latitude and a longitude in degrees expected"),
        (["--origin", "here"], "LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,HEIGHT expected"),
        (["--origin", "1,1,nan"], "LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,HEIGHT expected"),
        (["--sigma", "nan"], "'--sigma': nan: a finite number expected"),
        (["--sigma", "inf"], "'--sigma': inf: a finite number expected"),
    ],
)
@pytest.mark.usefixtures("plain")
def test_options_that_do_not_fit(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    path = csv_of(tmp_path / "b.csv", [HEAD, *drive(5)])
    result = run("locate-emitter", path, *arguments, "--out", tmp_path / "out", code=2)
    assert sentence in result.stderr


@pytest.mark.usefixtures("plain")
def test_files_that_do_not_fit(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("locate-emitter", tmp_path / "none.csv", "--out", out, code=2)
    assert "no such file" in result.stderr
    for lines, sentence in (
        ([HEAD], "no rows below the names of the columns"),
        ([HEAD.replace("bearing_deg", "direction_deg"), *drive(3)], "direction_deg: unknown column"),
        ([HEAD, "0,0,0,nan,1"], "b.csv:2: bearing_deg: nan: a finite number expected"),
        ([HEAD.removesuffix(",sigma_deg"), "0,0,0,1"], "no standard deviation: sigma_deg expected (or --sigma"),
    ):
        result = run("locate-emitter", csv_of(tmp_path / "b.csv", lines), "--out", out, code=2)
        assert sentence in result.stderr
    assert not out.exists()
    toml = csv_of(tmp_path / "x.toml", ['system = "ofdm_inertial"'])
    result = run("locate-emitter", toml, "--out", out, code=2)
    assert "x.toml" in result.stderr
