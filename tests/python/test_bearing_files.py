"""Files of bearings and poses: what enters, what is refused, and maps that read back."""

from __future__ import annotations

import csv as _csv
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from soopnav_cpp.geometry import LocalFrame
from soopnav_cpp.scenarios.bearings import (
    BEARING_COLUMNS,
    BearingsData,
    Poses,
    attitude,
    read_bearings,
    read_poses,
    rotations,
    write_bearings,
)
from soopnav_cpp.scenarios.emitter_files import LINE_M, MapItem, geojson, write_emitter_geojson, write_emitter_kml
from soopnav_cpp.scenarios.files import RecordingError

pytestmark = pytest.mark.unit


def csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "b.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_hand_made_file(tmp_path: Path) -> None:
    """True bearings run clockwise from north; in memory they run from east towards north."""
    data = read_bearings(csv(tmp_path, "x_m,y_m,bearing_deg,sigma_deg\n# north-east of me\n0,0,45,2\n100,0,315,3\n"))
    np.testing.assert_allclose(data.bearing_rad, np.radians([45.0, 135.0]))
    np.testing.assert_allclose(data.compass_deg, [45.0, 315.0])
    np.testing.assert_allclose(data.sigma_rad, np.radians([2.0, 3.0]))
    np.testing.assert_array_equal(data.t_s, [0.0, 1.0])
    np.testing.assert_array_equal(data.position_m, [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    assert data.elevation_rad is None
    assert data.emitter is None


def test_an_azimuth_is_of_the_array(tmp_path: Path) -> None:
    """Heading east (90°), 30° to the left: 60° from north, 30° from east."""
    text = "x_m,y_m,azimuth_deg,heading_deg,elevation_deg,sigma_azimuth_deg\n0,0,30,90,5,1\n"
    data = read_bearings(csv(tmp_path, text))
    assert math.degrees(data.bearing_rad[0]) == pytest.approx(30.0)
    assert data.compass_deg[0] == pytest.approx(60.0)
    assert data.elevation_rad is not None
    assert data.sigma_elevation_rad is not None
    assert math.degrees(data.elevation_rad[0]) == pytest.approx(5.0)
    assert math.degrees(data.sigma_elevation_rad[0]) == pytest.approx(1.0)


def test_rows_of_any_order_and_status(tmp_path: Path) -> None:
    text = (
        "time_s,emitter,x_m,y_m,bearing_deg,sigma_deg,snr_db,status\n"
        "2,B,20,0,10,1,,ok\n1,A,10,0,20,1,3.5,ok\n1,B,10,0,,,,no_source\n3,A,30,0,30,1,2,\n"
    )
    data = read_bearings(csv(tmp_path, text))
    np.testing.assert_array_equal(data.t_s, [1.0, 2.0, 3.0])
    assert data.emitter is not None
    assert data.snr_db is not None
    assert data.emitter.tolist() == ["A", "B", "A"]
    assert data.dropped == ("1 row with status no source left out",)
    assert np.isnan(data.snr_db[1])
    assert len(data.of(data.emitter == "A")) == 2


def test_places_on_the_earth(tmp_path: Path) -> None:
    """Bearings are against the north of their own place: two of them, a degree of longitude apart, meet where they do
    on the Earth and not where they would on a plane."""
    target = (math.radians(60.3), math.radians(10.5), 0.0)
    rows = []
    for longitude in (10.0, 11.0):
        frame = LocalFrame(math.radians(60.0), math.radians(longitude), 0.0)
        east, north, _ = frame.position_from_geodetic(*target)
        rows.append(f"60,{longitude},{math.degrees(math.atan2(east, north)):.9f},0.1")
    text = "latitude_deg,longitude_deg,bearing_deg,sigma_deg\n" + "\n".join(rows) + "\n"
    data = read_bearings(csv(tmp_path, text))
    assert data.frame is not None
    wanted = data.frame.position_from_geodetic(*target)
    for place, bearing in zip(data.position_m, data.bearing_rad, strict=True):
        seen = math.atan2(wanted[1] - place[1], wanted[0] - place[0])
        assert bearing == pytest.approx(seen, abs=1e-4)
    unturned = math.radians(90.0 - float(rows[1].split(",")[2]))
    assert abs(math.remainder(data.bearing_rad[1] - unturned, 2.0 * math.pi)) > math.radians(0.5)
    here = data.degrees(data.position_m[1])
    assert here is not None
    assert here[:2] == pytest.approx((60.0, 11.0))


@pytest.mark.parametrize("on_earth", [False, True])
def test_what_is_written_reads_back(tmp_path: Path, on_earth: bool) -> None:
    rng = np.random.default_rng(3)
    frame = LocalFrame(math.radians(48.0), math.radians(11.0), 500.0) if on_earth else None
    n = 20
    places = np.column_stack([np.linspace(0.0, 3000.0, n), np.linspace(0.0, -900.0, n), np.zeros(n)])
    data = BearingsData(
        t_s=np.arange(n) * 0.5,
        position_m=places,
        bearing_rad=rng.uniform(-3.1, 3.1, n),
        sigma_rad=rng.uniform(0.01, 0.1, n),
        elevation_rad=rng.uniform(-0.1, 0.5, n),
        sigma_elevation_rad=rng.uniform(0.01, 0.1, n),
        emitter=np.array(["A", "B"] * 10),
        position_sigma_m=np.full(n, 0.5),
        heading_sigma_rad=np.full(n, 0.01),
        snr_db=rng.uniform(-10.0, 10.0, n),
        truth_m=np.tile([500.0, 300.0, 20.0], (n, 1)),
        frame=frame,
    )
    path = tmp_path / "out.csv"
    write_bearings(data, path)
    again = read_bearings(path)
    assert again.truth_m is not None
    shift = np.zeros(3) if frame is None else again.position_m[0] - data.position_m[0]
    np.testing.assert_allclose(again.position_m, data.position_m + shift, atol=1e-3)
    np.testing.assert_allclose(again.truth_m, data.truth_m + shift, atol=1e-3)
    off = np.angle(np.exp(1j * (again.bearing_rad - data.bearing_rad)))
    assert np.abs(off).max() < 1e-7
    for name in ("sigma_rad", "elevation_rad", "sigma_elevation_rad", "heading_sigma_rad", "position_sigma_m"):
        np.testing.assert_allclose(getattr(again, name), getattr(data, name), atol=2e-8)
    np.testing.assert_array_equal(again.emitter, data.emitter)
    header = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    known = {name.strip() for names in BEARING_COLUMNS for name in names.split(",")}
    documented = (
        known
        | {f"sigma_{k}" for k in ("bearing", "bearing_elevation")}
        | {f"truth_{k}" for k in ("latitude", "longitude", "height")}
    )
    assert all(any(cell == name or cell.startswith(f"{name}_") for name in documented) for cell in header)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "empty; a line with the names of the columns expected"),
        ("x_m,y_m,bearing_deg,sigma_deg\n", "no rows below the names of the columns"),
        ("x_m,bearing_deg,sigma_deg\n0,1,1\n", r":1: missing column y_m"),
        ("bearing_deg,sigma_deg\n0,1\n", "no position: x_m and y_m expected, or latitude_deg and longitude_deg"),
        ("x_m,y_m,sigma_deg\n0,0,1\n", "no bearing: bearing_deg"),
        ("x_m,y_m,azimuth_deg,sigma_deg\n0,0,1,1\n", "heading_deg .* expected with it"),
        ("x_m,y_m,bearing_deg\n0,0,1\n", "no standard deviation: sigma_deg expected"),
        ("x_m,y_m,baering_deg,sigma_deg\n0,0,1,1\n", "baering_deg: unknown column; did you mean bearing_deg"),
        ("x_m,y_m,bearing,sigma_deg\n0,0,1,1\n", "bearing: a unit expected: bearing_rad or bearing_deg"),
        ("x_m,y_m,bearing_deg,sigma_deg\n0,0,nan,1\n", ":2: bearing_deg: nan: a finite number expected"),
        ("x_m,y_m,bearing_deg,sigma_deg\n0,0,north,1\n", ":2: bearing_deg: a number expected, got 'north'"),
        ("x_m,y_m,bearing_deg,sigma_deg\n0,0,1,0\n", ":2: sigma: 0: more than 0 expected"),
        ("x_m,y_m,bearing_deg,sigma_deg\n0,0,1\n", ":2: 4 cells expected, got 3"),
        ("x_m,y_m,bearing_deg,elevation_deg,sigma_deg\n0,0,1,91,1\n", "elevation: 91: between −90° and 90°"),
        ("latitude_deg,longitude_deg,bearing_deg,sigma_deg\n91,0,1,1\n", "latitude: 91: at most 90"),
        ("latitude_deg,longitude_deg,height_m,bearing_deg,sigma_deg\n9,9,1e7,1,1\n", "height: 1e.07: at most 1000 km"),
        ("latitude_deg,x_m,y_m,bearing_deg,sigma_deg\n1,0,1,1,1\n", "one kind of position expected"),
        ("x_m,y_m,bearing_deg,sigma_deg,status\n0,0,1,1,no_source\n", "no row with status ok"),
        ("x_m,y_m,bearing_deg,bearing_rad,sigma_deg\n0,0,1,1,1\n", "bearing_rad: given as bearing_deg already"),
    ],
)
def test_what_does_not_fit(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(RecordingError, match=sentence):
        read_bearings(csv(tmp_path, text))


def test_rows_that_cannot_be_used_may_be_left_out(tmp_path: Path) -> None:
    text = "x_m,y_m,bearing_deg,sigma_deg\n0,0,1,1\n1,0,nan,1\n2,0,3,1\n"
    data = read_bearings(csv(tmp_path, text), repair=True)
    assert len(data) == 2
    assert "b.csv:3: bearing_deg: nan" in data.dropped[0]
    one = read_bearings(csv(tmp_path, "x_m,y_m,bearing_deg\n0,0,1\n"), sigma_rad=0.1)
    assert one.sigma_rad.tolist() == [0.1]


_CELLS = st.one_of(
    st.sampled_from(
        ["", "0", "-1", "12.5", "1e308", "-1e308", "nan", "inf", "north", "ok", "no_source", "#", '"', "90", "361"]
    ),
    st.floats().map(str),
    st.text(max_size=4),
)
_NAMES = st.sampled_from(
    [
        *("time_s", "z_m", "height_m", "bearing_deg", "azimuth_deg", "heading_deg", "elevation_deg", "sigma_deg"),
        *(
            "sigma_position_m",
            "sigma_heading_deg",
            "emitter",
            "status",
            "snr_db",
            "truth_x_m",
            "truth_y_m",
            "pitch_deg",
        ),
        *("x_m", "y_m", "latitude_deg", "longitude_deg", "bearing", "x"),
    ]
)
_NEEDED = st.sampled_from(
    [
        ["x_m", "y_m", "bearing_deg", "sigma_deg"],
        ["latitude_deg", "longitude_deg", "height_m", "bearing_deg", "sigma_deg"],
        ["time_s", "x_m", "y_m", "heading_deg"],
        ["time_s", "latitude_deg", "longitude_deg", "height_m", "heading_deg"],
        [],
    ]
)


@pytest.mark.fuzz
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    needed=_NEEDED,
    more=st.lists(_NAMES, max_size=4),
    rows=st.lists(st.lists(_CELLS, max_size=7), max_size=4),
    repair=st.booleans(),
)
def test_any_file_is_read_or_refused(
    tmp_path: Path, needed: list[str], more: list[str], rows: list[list[str]], repair: bool
) -> None:
    """Whatever a file holds: finite bearings, or a sentence."""
    path = tmp_path / "any.csv"
    names = needed + more
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = _csv.writer(file)
        writer.writerow(names)
        writer.writerows([*row, *["1"] * len(names)][: len(names)] for row in rows)
    for read in (lambda: read_bearings(path, repair=repair), lambda: read_poses(path)):
        try:
            data = read()
        except RecordingError as error:
            assert str(error).startswith(str(path))
            continue
        assert np.isfinite(data.position_m).all()
        assert len(data.t_s) >= 1
        assert np.all(np.diff(data.t_s) >= 0.0)
        if isinstance(data, BearingsData):
            assert np.isfinite(data.bearing_rad).all()
            assert (data.sigma_rad > 0.0).all()
        else:
            np.testing.assert_allclose(np.linalg.norm(data.quaternion_wxyz, axis=1), 1.0)


@pytest.mark.fuzz
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=60) | st.lists(_CELLS, max_size=16).map(lambda cells: " ".join(cells).encode()))
def test_any_tum_is_read_or_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "any.tum"
    path.write_bytes(content)
    try:
        poses = read_poses(path)
    except RecordingError as error:
        assert str(error).startswith(str(path))
        return
    assert np.isfinite(poses.position_m).all()


# ---- poses


def test_attitudes_have_their_signs() -> None:
    """Heading clockwise, pitch nose up, roll right side down; forward, left, up into east, north, up."""
    turn = rotations(attitude(np.radians([90.0, 0.0, 0.0]), np.radians([0.0, 10.0, 0.0]), np.radians([0.0, 0.0, 20.0])))
    np.testing.assert_allclose(turn[0, :, 0], [1.0, 0.0, 0.0], atol=1e-12)  # forward is east
    np.testing.assert_allclose(turn[0, :, 1], [0.0, 1.0, 0.0], atol=1e-12)  # left is north
    np.testing.assert_allclose(turn[1, :, 0], [0.0, math.cos(0.1745329), math.sin(0.1745329)], atol=1e-6)
    assert turn[2, 2, 1] == pytest.approx(math.sin(math.radians(20.0)))  # the left side goes up
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)


def test_poses_between_poses(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("time_s,x_m,y_m,heading_deg\n0,0,0,350\n10,100,50,10\n", encoding="utf-8")
    poses = read_poses(path)
    middle = poses.at([5.0])
    np.testing.assert_allclose(middle.position_m, [[50.0, 25.0, 0.0]])
    assert math.degrees(middle.heading_rad[0]) % 360.0 == pytest.approx(0.0, abs=1e-9)  # across north, not across south
    with pytest.raises(ValueError, match="no pose at 11 s: the poses cover 0 … 10 s"):
        poses.at([11.0])


def test_directions_of_a_tilted_array_become_level() -> None:
    turn = attitude(np.radians([90.0]), np.radians([15.0]), np.radians([0.0]))
    poses = Poses(np.zeros(1), np.zeros((1, 3)), turn)
    covariance = np.diag([0.01**2, 0.02**2])[None]
    bearing, elevation, spread = poses.to_level(np.zeros(1), np.zeros(1), covariance)
    assert math.degrees(bearing[0]) == pytest.approx(0.0, abs=1e-9)
    assert math.degrees(elevation[0]) == pytest.approx(15.0)
    assert math.sqrt(spread[0, 0, 0]) == pytest.approx(0.01 / math.cos(math.radians(15.0)))
    assert math.sqrt(spread[0, 1, 1]) == pytest.approx(0.02)


def test_tum_reads_what_runs_write(tmp_path: Path) -> None:
    path = tmp_path / "p.tum"
    path.write_text("# x\n0 1 2 3 0 0 0 1\n1 2 2 3 0 0 0.7071068 0.7071068\n", encoding="utf-8")
    poses = read_poses(path)
    np.testing.assert_allclose(poses.position_m[1], [2.0, 2.0, 3.0])
    np.testing.assert_allclose(np.cos(poses.heading_rad), [0.0, 1.0], atol=1e-4)  # forward east, then north
    np.testing.assert_allclose(np.sin(poses.heading_rad), [1.0, 0.0], atol=1e-4)
    for text, sentence in (
        ("0 1 2\n", ":1: eight finite numbers expected"),
        ("0 1 2 3 0 0 0 0.5\n", "a unit quaternion expected"),
        ("0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "time must rise"),
        ("", "empty"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(RecordingError, match=sentence):
            read_poses(path)


def test_poses_that_do_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("time_s,x_m,y_m\n0,0,0\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="missing column heading_rad or heading_deg"):
        read_poses(path)
    path.write_text("time_s,heading_deg\n0,0\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="no position"):
        read_poses(path)


# ---- maps


def data_at(frame: LocalFrame | None) -> BearingsData:
    places = np.array([[-500.0, -100.0, 0.0], [0.0, -100.0, 0.0], [500.0, -100.0, 0.0]])
    bearing = np.arctan2(100.0 - places[:, 1], 50.0 - places[:, 0])
    return BearingsData(np.arange(3.0), places, bearing, np.full(3, 0.02), frame=frame, truth_m=np.zeros((3, 3)))


def test_geojson_has_longitude_first() -> None:
    data = data_at(LocalFrame(math.radians(48.0), math.radians(11.0), 500.0))
    item = MapItem("A", "ml", data, position_m=[50.0, 100.0], covariance_m2=np.diag([16.0, 4.0]), cep_m=3.0)
    found = geojson([item], data)
    assert "coordinate_frame" not in found
    kinds = [feature["properties"]["kind"] for feature in found["features"]]
    assert kinds.count("bearing") == 3
    assert kinds.count("error ellipse") == 2
    point = next(f for f in found["features"] if f["properties"]["kind"] == "emitter")
    longitude, latitude, _ = point["geometry"]["coordinates"]
    assert (latitude, longitude) == pytest.approx((48.0 + 100.0 / 111_200, 11.0 + 50.0 / 74_600), abs=2e-5)
    ring = np.array(
        next(f for f in found["features"] if f["geometry"]["type"] == "Polygon")["geometry"]["coordinates"][0]
    )
    assert (ring[0] == ring[-1]).all()
    area = 0.5 * np.sum(ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1])
    assert area > 0.0  # counter-clockwise
    for feature in found["features"]:
        if feature["properties"]["kind"] == "bearing":  # it goes by the emitter
            start, end = np.array(feature["geometry"]["coordinates"])[:, :2]
            way, to = end - start, np.array([longitude, latitude]) - start
            scale = np.array([math.cos(math.radians(48.0)), 1.0])
            (a, b), (c, d) = way * scale, to * scale
            assert abs(a * d - b * c) < 1e-3 * np.linalg.norm(way) * np.linalg.norm(to)


def test_maps_of_local_metres_say_so(tmp_path: Path) -> None:
    data = data_at(None)
    item = MapItem("A", "ml", data, line=([0.0, -100.0], math.pi / 2))
    write_emitter_geojson([item], data, tmp_path / "x.geojson")
    found = json.loads((tmp_path / "x.geojson").read_text(encoding="utf-8"))
    assert "metres" in found["coordinate_frame"]
    line = next(f for f in found["features"] if f["properties"]["kind"] == "line")
    assert line["geometry"]["coordinates"][1][:2] == pytest.approx([0.0, LINE_M - 100.0])
    with pytest.raises(ValueError, match="KML needs a place on the Earth"):
        write_emitter_kml([item], data, tmp_path / "x.kml")


def test_kml_is_xml_with_longitude_first(tmp_path: Path) -> None:
    data = data_at(LocalFrame(math.radians(48.0), math.radians(11.0), 500.0))
    item = MapItem("A & B", "ml", data, position_m=[50.0, 100.0], covariance_m2=np.diag([16.0, 4.0]), cep_m=3.0)
    write_emitter_kml([item], data, tmp_path / "x.kml")
    root = ElementTree.parse(tmp_path / "x.kml").getroot()
    space = {"k": "http://www.opengis.net/kml/2.2"}
    names = [element.text for element in root.findall(".//k:Placemark/k:name", space)]
    assert names[0] == "A & B"
    assert names.count("bearing") == 3
    point = root.find(".//k:Point/k:coordinates", space)
    assert point is not None
    assert point.text is not None
    longitude, latitude = (float(v) for v in point.text.split(","))
    assert (latitude, longitude) == pytest.approx((48.0009, 11.00067), abs=1e-4)
