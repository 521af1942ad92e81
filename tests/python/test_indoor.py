"""Rooms, sounders and their files, nodes found from walks: through Python, with bad input."""

import functools
import json

import numpy as np
import pytest

from soopnav_cpp import experiments, lte, navigation
from soopnav_cpp.experiments.registry import perform
from soopnav_cpp.navigation import NodeMapStatus, locate_nodes, start_node
from soopnav_cpp.simulation import (
    ChannelSounder,
    IndoorRoom,
    LinkStatus,
    RoomWall,
    SoundingRecord,
    excess_delays,
    slab_response,
    subcarrier_hz,
    turntable,
)

pytestmark = pytest.mark.unit

C = 299_792_458.0
NODES = [[45.0, 3.0], [-30.0, 20.0], [8.0, -40.0]]


def room(**options):
    return IndoorRoom.rectangle(20.0, 15.0, windows=[("south", 2, 8), ("west", 5, 9)], **options)


def test_links_have_taps_that_others_take():
    links = room(seed=3).links(NODES, [[5.0, 5.0], [15.0, 12.0]])
    assert links.distance_m.shape == (2, 3)
    taps = links.taps(1, 2, normalise=True)
    assert sum(abs(g) ** 2 for _, g in taps) == pytest.approx(1.0)
    assert [d for d, _ in taps] == sorted(d for d, _ in taps)
    f = np.array([-5e6, 0.0, 5e6])
    by_hand = sum(g * np.exp(-2j * np.pi * f * d) for d, g in links.taps(0, 1))
    np.testing.assert_allclose(links.response(f, 0, 1), by_hand, rtol=1e-10)
    np.testing.assert_allclose(
        links.power_db[0, 1], 10 * np.log10(sum(abs(g) ** 2 for _, g in links.taps(0, 1))), rtol=1e-12
    )
    cell = lte.CellParameters(cell_id=3, n_rb=6, taps=taps)
    assert np.isfinite(lte.synthesize(cell, 1.92e6, 1920)).all()
    assert "3 nodes" in repr(links)
    with pytest.raises(IndexError):
        links.taps(2, 0)


def test_windows_let_in_and_brick_does_not():
    r = room(tail_db=-np.inf)
    sight = r.links([[5.0, -40.0]], [[5.0, 5.0], [18.0, 5.0]])
    assert sight.line_of_sight[:, 0].tolist() == [True, False]
    np.testing.assert_allclose(r.wall_loss_db([[5.0, -40.0]], [[5.0, 5.0], [18.0, 5.0]]), sight.wall_loss_db)
    _, through, _ = slab_response("brick", 0.25, 45.0 / np.hypot(45.0, 13.0))
    assert sight.wall_loss_db[1, 0] == pytest.approx(-20 * np.log10(abs(through)), abs=0.05)


def test_places_without_a_channel_say_so():
    links = IndoorRoom.rectangle(9.0, 9.0, material="metal").links(
        [[4.0, 4.0], [40.0, 4.0]], [[np.nan, 1.0], [4.0, 4.0], [5.0, 5.0]]
    )
    assert links.status(0, 0) is LinkStatus.NOT_FINITE
    assert links.status(1, 0) is LinkStatus.TOO_CLOSE
    assert links.status(2, 1) is LinkStatus.DARK
    assert links.status(2, 0) is LinkStatus.OK
    assert links.taps(2, 1) == []


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"order": 4}, "order: 4; it must be 0 ... 3"),
        ({"material": "straw"}, "material: 'straw'; one of concrete"),
        ({"carrier_hz": 0.0}, "carrier_hz"),
        ({"windows": [("up", 1, 2)]}, "windows: side 'up'"),
        ({"windows": [("east", 14, 16)]}, "windows: east from 14 to 16"),
        ({"inner": [RoomWall((1, 1), (1, 1))]}, "walls: 4; this one has no length"),
        ({"tail_taps": 65}, "tail_taps"),
        ({"seed": -1}, "seed"),
    ],
)
def test_rooms_that_cannot_be(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        IndoorRoom.rectangle(20.0, 15.0, **options)


def test_polygons_and_shapes():
    triangle = IndoorRoom.polygon(
        [[0, 0], [10, 0], [0, 10]], material="metal", tail_db=-np.inf, floor_and_ceiling=False
    )
    assert triangle.links([[2.0, 2.0]], [[3.0, 1.0]]).paths[0, 0] >= 4
    with pytest.raises(ValueError, match="corners_m"):
        IndoorRoom.polygon([[0, 0], [1, 1]])
    with pytest.raises(ValueError, match="places_m: shape"):
        triangle.links([[2.0, 2.0]], [[1.0, 2.0, 3.0, 4.0]])


def test_excess_is_zero_in_sight():
    sight = np.array([[1, 1, 0, 0, 0, 1, 0]]).T.astype(bool)
    excess = excess_delays(sight, 0.1, seed=4)
    assert (excess[sight] == 0.0).all()
    assert ((excess[~sight] > 3.0) & (excess[~sight] < 21.0)).all()
    np.testing.assert_array_equal(excess, excess_delays(sight, 0.1, seed=4))
    with pytest.raises(ValueError, match="line_of_sight: booleans"):
        excess_delays(np.full((3, 2), 0.5), 0.1, seed=1)
    with pytest.raises(ValueError, match="high_m"):
        excess_delays(sight, 0.1, bias_m=(4.0, 3.0), seed=1)


# ---- Sounding


@functools.cache
def record():
    sounder = ChannelSounder(averages=100, calibration_averages=800, seed=2)
    channels = [[[(50e-9, 0.8), (190e-9, 0.3j)], [(90e-9, 0.5 - 0.2j)]] for _ in range(2)]
    return sounder.record(channels, places_m=turntable(0.1, 2))


def test_a_record_comes_back_from_its_file(tmp_path):
    one = record()
    path = tmp_path / "record.npz"
    one.save(path)
    again = SoundingRecord.load(path)
    for name in ("lines", "calibration", "line_hz", "time_s", "clipped", "places_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
    np.testing.assert_array_equal(again.emulate(4.5e6).gain, one.emulate(4.5e6).gain)
    assert again.carrier_hz == 2.45e9


def test_emulated_channels():
    made = record().emulate(9e6)
    f = subcarrier_hz(50)
    truth = 0.8 * np.exp(-2j * np.pi * f * 50e-9) + 0.3j * np.exp(-2j * np.pi * f * 190e-9)
    assert np.abs(made.response(f)[0, 0] - truth).max() < 0.01
    assert made.covered
    assert np.isclose(made.nulls_hz, 10e6).any()
    assert np.isclose(made.nulls_hz, -10e6).any()
    assert len(made.taps(1, 1)) == len(made.delays_s)
    plain = record().gain()
    assert np.isnan(plain[0, 0, np.isclose(np.abs(record().line_hz), 10e6)]).all()


def test_bad_channels_and_bands():
    one = ChannelSounder(averages=5, calibration_averages=5).record([[[(np.nan, 1.0)], [(0.0, 1.0)]]])
    assert np.isnan(one.lines[0, 0]).all()
    made = one.emulate(5e6)
    assert np.isnan(made.gain[0, 0]).any()
    assert np.isfinite(made.gain[0, 1]).all()
    with pytest.raises(ValueError, match="not finite"):
        made.taps(0, 0)
    with pytest.raises(ValueError, match="bandwidth_hz"):
        one.emulate(1e3)
    with pytest.raises(ValueError, match="delay_high_s"):
        one.emulate(5e6, delay_window_s=(0.0, 1e-3))
    for width in (np.nan, np.inf, -1.0, 0.0):
        with pytest.raises(ValueError, match=r"bandwidth_hz: .*a positive number expected"):
            one.emulate(width)
    with pytest.raises(ValueError, match="delay_window_s"):
        one.emulate(5e6, delay_window_s=(np.nan, 1e-6))
    with pytest.raises(ValueError, match="null_db"):
        one.emulate(5e6, null_db=np.nan)
    with pytest.raises(ValueError, match="at least one place"):
        ChannelSounder().record([])
    with pytest.raises(ValueError, match="period_s"):
        ChannelSounder(period_s=1.0003e-5)
    with pytest.raises(ValueError, match="n_rb"):
        subcarrier_hz(7)


def test_nodes_of_a_room_are_finite():
    room = IndoorRoom.rectangle(8.0, 6.0)
    with pytest.raises(ValueError, match="nodes_m: node 1 is not finite"):
        room.links([[1.0, 1.0], [np.nan, 2.0]], [[3.0, 3.0]])
    with pytest.raises(ValueError, match="places_m: real numbers"):
        room.links([[1.0, 1.0]], [[3.0j, 3.0]])


def rewritten(path, change):
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    with path.open("wb") as file:
        np.savez(file, **arrays)


def set_header(key, value):
    def change(arrays):
        head = json.loads(str(arrays["header"]))
        head[key] = value
        arrays["header"] = np.array(json.dumps(head))

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (set_header("version", 2), "header: version 2; 1 expected"),
        (set_header("format", "x"), "header: format 'x'"),
        (set_header("units", {}), "header: units"),
        (lambda a: a.pop("header"), "header: format, version, units and checksum expected"),
        (lambda a: a.pop("lines"), "lines: missing"),
        (lambda a: a.update(lines=a["lines"] * 1.0001), "checksum"),
        (lambda a: a.update(lines=a["lines"][..., :-1]), "checksum"),
    ],
)
def test_wrong_files_are_refused_by_field(tmp_path, change, sentence):
    path = tmp_path / "record.npz"
    record().save(path)
    rewritten(path, change)
    with pytest.raises(ValueError, match=sentence):
        SoundingRecord.load(path)


def test_files_that_are_no_records(tmp_path):
    (tmp_path / "text.npz").write_text("nothing of the kind")
    with pytest.raises(ValueError, match=r"text\.npz: an NPZ file of arrays expected"):
        SoundingRecord.load(tmp_path / "text.npz")
    record().save(tmp_path / "cut.npz")
    data = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"cut\.npz"):
        SoundingRecord.load(tmp_path / "cut.npz")


def test_sweeps_keep_magnitudes():
    taps = [[[(40e-9, 0.7), (300e-9, -0.4)]]] * 2
    f = np.linspace(-8e6, 8e6, 33)
    truth = 0.7 * np.exp(-2j * np.pi * f * 40e-9) - 0.4 * np.exp(-2j * np.pi * f * 300e-9)
    swept = ChannelSounder.sweep(taps, f, seed=1)
    assert not swept.phase_known
    assert np.abs(swept.magnitude[0, 0] - np.abs(truth)).max() < 0.01
    assert np.abs(np.angle(swept.gain[0, 0] / swept.gain[1, 0])).max() < 0.05
    held = ChannelSounder.sweep(taps, f, reference_channel=True, seed=1)
    assert np.abs(held.gain[0, 0] - truth).max() < 0.02
    assert np.abs(swept.gain[0, 0] - truth).max() > 0.3


# ---- Nodes


def scene(links=4, n=120, seed=1):
    rng = np.random.default_rng(seed)
    u = 2 * np.pi * np.arange(n) / n
    track = 12.0 * np.column_stack([np.sin(2 * u), np.sin(3 * u + 0.5)])
    azimuth = 2 * np.pi * np.arange(links) / links + 0.4
    nodes = 18.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    ranges = np.linalg.norm(track[:, None] - nodes, axis=2) + 77.0 + 100.0 * np.arange(links)
    return track, nodes, ranges + 0.3 * rng.normal(size=ranges.shape)


@pytest.mark.parametrize("clock", ["random_walk", "free"])
def test_nodes_are_found(clock):
    track, nodes, ranges = scene()
    ranges[10:20, 1] = np.nan
    found = locate_nodes(track, ranges, 0.3, clock=clock, clock_m_per_sqrt_s=0.01)
    assert found.status is NodeMapStatus.OK
    assert found.nees(nodes) < 35.0  # chi-square of 8: 3e-5
    assert np.abs(found.offset_m - 100.0 * np.arange(4)).max() < 3.0
    assert found.ambiguities[0].startswith("one time common")
    assert not found.mirrored.any()
    start = start_node(track, ranges[:, 2], 0.3)
    assert start.ok
    assert np.linalg.norm(start.position_m - nodes[2]) < 2.0


def test_heights_are_taken_in():
    track, nodes, _ = scene()
    up = 4.0
    ranges = np.sqrt(((track[:, None] - nodes) ** 2).sum(-1) + up**2)
    places = np.column_stack([track, np.full(len(track), 1.0)])
    found = locate_nodes(places, ranges, 0.01, heights_m=1.0 + up, clock_m_per_sqrt_s=0.01)
    assert np.abs(found.position_m - nodes).max() < 0.05


def test_what_is_not_told_is_named():
    track, nodes, _ = scene()
    straight = np.column_stack([np.linspace(-12, 12, 120), np.zeros(120)])
    ranges = np.linalg.norm(straight[:, None] - nodes, axis=2)
    found = locate_nodes(straight, ranges + 0.1 * np.random.default_rng(3).normal(size=ranges.shape), 0.1)
    assert found.mirrored.all()
    np.testing.assert_allclose(np.abs(found.mirror_m[:, 1]), np.abs(found.position_m[:, 1]), atol=1.0)
    assert any("side of the walk" in words for words in found.ambiguities)
    few = locate_nodes(track, scene()[2][:, :2], 0.3, clock="free")
    assert few.status is NodeMapStatus.TOO_FEW
    assert np.isnan(few.position_m).all()
    assert "everything" in few.ambiguities[-1]
    assert "TOO_FEW" in repr(few)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"sigma_m": -1.0}, "sigma_m: -1"),
        ({"sigma_m": [1.0, 2.0]}, "sigma_m: one number or shape"),
        ({"clock": "quartz"}, "clock: 'quartz'"),
        ({"t_s": np.zeros(120)}, "t_s"),
        ({"t_s": np.zeros(3)}, "t_s"),
        ({"heights_m": [1.0]}, "heights_m"),
        ({"ranges_m": np.zeros((7, 4))}, "ranges_m: 120 rows"),
        ({"track_m": np.full((120, 2), np.nan)}, "track_m: 0; this place is not finite"),
        ({"track_m": "here"}, "track_m: numbers expected"),
        ({"ranges_m": np.full((120, 4), 30.0 + 1.0j)}, "ranges_m: real numbers"),
        ({"sigma_m": 1.0j}, "sigma_m: real numbers"),
        ({"heights_m": "high"}, "heights_m: numbers expected"),
        ({"starts": 0}, "starts"),
    ],
)
def test_calls_that_cannot_be(change, sentence):
    track, _, ranges = scene()
    arguments = {"track_m": track, "ranges_m": ranges, "sigma_m": 0.3} | change
    with pytest.raises(ValueError, match=sentence):
        navigation.locate_nodes(**arguments)


def test_infinite_ranges_are_not_heard():
    track, nodes, ranges = scene()
    ranges[5, :] = np.inf
    found = locate_nodes(track, ranges, 0.3, clock_m_per_sqrt_s=0.01)
    assert found.observations == 119 * 4
    assert np.linalg.norm(found.position_m - nodes, axis=1).max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nielsen-62", "nielsen-x2"])
def test_claims_hold(name, tmp_path):
    (item,) = experiments.load().select([name])
    outcome = perform(item, seed=1, out=tmp_path)
    if outcome.error is not None:
        raise outcome.error
    assert [claim.as_row(item, 1) for claim in outcome.claims if not claim.holds] == []
