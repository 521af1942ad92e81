"""Satellites: elements from files, orbits as samples, ways of signals, passes."""

from __future__ import annotations

import dataclasses
import json
import pickle
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp import geometry, orbits

pytest.importorskip("sgp4")

SHARED = Path(__file__).parents[2].parent / "shared"
TLE = SHARED / "captures" / "tle" / "iridium_2014-08-27.tle"
VECTORS = SHARED / "vectors" / "nav" / "sgp4_iridium66_20140827.npz"
there = pytest.mark.skipif(not TLE.exists(), reason="the elements in ../shared are not there")
C = 299_792_458.0
HELSINKI = geometry.geodetic_to_ecef(np.radians(60.2), np.radians(25.0), 20.0)
START = datetime(2014, 8, 27, 6, tzinfo=timezone.utc)


def checked(line: str) -> str:
    """68 characters of an element line, with its checksum."""
    assert len(line) == 68
    return line + str(sum(int(c) if c.isdigit() else c == "-" for c in line) % 10)


# A made-up satellite: circular, 86.4 degrees, 14.34 turns a day, epoch 2014-08-27 00:00.
LINE_1 = checked("1 90001U 14001A   14239.00000000  .00000100  00000-0  30000-4 0  999")
LINE_2 = checked("2 90001  86.4000  40.0000 0002000  90.0000 270.0000 14.34218000 1000")
OMM = {
    "OBJECT_NAME": "MADE UP",
    "OBJECT_ID": "2014-001A",
    "EPOCH": "2014-08-27T00:00:00.000000",
    "MEAN_MOTION": "14.34218",
    "ECCENTRICITY": ".0002",
    "INCLINATION": "86.4",
    "RA_OF_ASC_NODE": "40.0",
    "ARG_OF_PERICENTER": "90.0",
    "MEAN_ANOMALY": "270.0",
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "NORAD_CAT_ID": "90001",
    "ELEMENT_SET_NO": "999",
    "REV_AT_EPOCH": "1000",
    "BSTAR": ".3e-4",
    "MEAN_MOTION_DOT": ".1e-5",
    "MEAN_MOTION_DDOT": "0",
}


@pytest.fixture
def made(tmp_path: Path) -> Path:
    path = tmp_path / "made.tle"
    path.write_text(f"0 MADE UP\n{LINE_1}\n{LINE_2}\n", encoding="utf-8")
    return path


# ---- elements


@there
@pytest.mark.offair
@pytest.mark.crosscheck
@pytest.mark.skipif(not VECTORS.exists(), reason="the vectors in ../shared are not there")
def test_the_66_are_read_and_are_where_the_vectors_say() -> None:
    satellites = orbits.read_tle(TLE)
    assert len(satellites) == 66
    with np.load(VECTORS) as data:
        day, fraction = float(data["jd"]), data["fr"]
        for i, satellite in enumerate(satellites):
            assert satellite.source == (str(data["line1"][i]), str(data["line2"][i]))
            p, v = satellite.teme(day, fraction)
            np.testing.assert_allclose(p, 1e3 * data["r_teme_km"][i], rtol=0, atol=1e-5)
            np.testing.assert_allclose(v, 1e3 * data["v_teme_kms"][i], rtol=0, atol=1e-8)
            assert abs(satellite.age_s(START)) < 10 * 86400.0


@there
@pytest.mark.offair
def test_iridium_of_2014_is_seen_as_its_constellation_is() -> None:
    """Satellites above 8 degrees over a day: the real ones as mei's notes count them, the made-up ones as the real."""
    times = np.arange(0.0, 86400.0, 120.0)
    real = [s.sampled(START, 86400.0, 60.0) for s in orbits.read_tle(TLE)]
    walker = orbits.iridium_walker(86400.0, step_s=60.0, gmst_rad=orbits.gmst(START))

    def count(sky: list[geometry.SampledOrbit], latitude_deg: float) -> float:
        place = geometry.geodetic_to_ecef(np.radians(latitude_deg), np.radians(25.0), 20.0)
        return float(np.mean(np.sum(orbits.elevations(sky, times, place)[1] > np.radians(8.0), axis=0)))

    for latitude_deg, notes in ((1.3, 1.4), (-35.3, 1.7), (47.4, 2.0), (60.2, 2.6), (67.9, 4.6)):
        seen = count(real, latitude_deg)
        assert seen == pytest.approx(notes, rel=0.1), latitude_deg
        assert count(walker, latitude_deg) == pytest.approx(seen, rel=0.05), latitude_deg


@pytest.mark.unit
def test_two_line_elements_with_and_without_names(made: Path, tmp_path: Path) -> None:
    (satellite,) = orbits.read_tle(made)
    assert satellite.name == "MADE UP"
    assert satellite.number == 90001
    assert satellite.epoch == datetime(2014, 8, 27, tzinfo=timezone.utc)
    assert satellite.age_s("2014-08-28T00:00:00Z") == 86400.0
    assert not satellite.is_stale("2014-08-28")
    assert satellite.is_stale("2014-09-08")
    assert satellite.is_stale("2014-08-18T00:00:00+02:00")
    plain = tmp_path / "plain.tle"
    plain.write_text(f"\n{LINE_1}\r\n{LINE_2}\r\n{LINE_1}\n{LINE_2}\n", encoding="utf-8")
    assert [s.name for s in orbits.read_tle(plain)] == ["90001", "90001"]
    assert pickle.loads(pickle.dumps(satellite)) == satellite


@pytest.mark.unit
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "no two-line elements"),
        ("only a name\n", "no two-line elements"),
        (f"{LINE_1}\n", ":1: line 2 of the last satellite is missing"),
        (f"{LINE_2}\n", ":1: line 1 before it expected"),
        (f"{LINE_1}\n{LINE_1}\n", ":2: line 2 of the satellite before expected"),
        (f"{LINE_1}\nname\n{LINE_2}\n", ":2: line 2 of the satellite before expected"),
        (f"{LINE_1[:-1]}\n{LINE_2}\n", ":1: 69 characters of an element line expected, got 68"),
        (f"{LINE_1[:-1]}{(int(LINE_1[-1]) + 1) % 10}\n{LINE_2}\n", ":1: checksum"),
        (f"{LINE_1}\n{LINE_2[:20]}9{LINE_2[21:]}\n", ":2: checksum"),
        (
            f"{LINE_1}\n{checked(LINE_2[:68].replace('90001', '90002'))}\n",
            ":2: satellite 90002, but line 1 is of 90001",
        ),
        (f"{LINE_1}\n{checked(LINE_2[:68].replace('86.4000', '8x.y000'))}\n", ":2: "),
    ],
)
def test_bad_two_line_elements_name_file_and_line(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "bad.tle"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"bad\.tle") as refusal:
        orbits.read_tle(path)
    assert sentence in str(refusal.value)


@pytest.mark.unit
def test_messages_of_every_kind_are_the_lines(made: Path, tmp_path: Path) -> None:
    (by_lines,) = orbits.read_tle(made)
    inner = {k: v for k, v in OMM.items() if k not in ("OBJECT_NAME", "OBJECT_ID")}
    xml = (
        '<?xml version="1.0"?><ndm><omm><body><segment><metadata><OBJECT_NAME>MADE UP</OBJECT_NAME>'
        "<OBJECT_ID>2014-001A</OBJECT_ID></metadata><data><meanElements>"
        + "".join(f"<{k}>{v}</{k}>" for k, v in inner.items())
        + "</meanElements><tleParameters></tleParameters></data></segment></body></omm></ndm>"
    )
    files = {
        "a.json": json.dumps([OMM]),
        "b.json": json.dumps({**OMM, "NORAD_CAT_ID": 90001, "MEAN_MOTION": 14.34218}),
        "c.csv": ",".join(OMM) + "\n" + ",".join(OMM.values()) + "\n",
        "d.kvn": "CCSDS_OMM_VERS = 2.0\nCOMMENT made = up\n" + "".join(f"{k} = {v}\n" for k, v in OMM.items()),
        "e.xml": xml,
    }
    p, v = by_lines.teme(2456896.5, np.array([0.1, 0.9]))
    for name, text in files.items():
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        (satellite,) = orbits.read_omm(path)
        assert (satellite.name, satellite.number, satellite.epoch) == ("MADE UP", 90001, by_lines.epoch), name
        q, w = satellite.teme(2456896.5, np.array([0.1, 0.9]))
        np.testing.assert_allclose(q, p, rtol=0, atol=0.05)  # the epoch as days since 1949 resolves 0.6 us
        np.testing.assert_allclose(w, v, rtol=0, atol=5e-5)
        assert orbits.read_orbits(path) == [satellite]
        assert pickle.loads(pickle.dumps(satellite)) == satellite
    assert orbits.read_orbits(made) == [by_lines]


@pytest.mark.unit
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "no orbit mean-elements message"),
        ("[]", "no orbit mean-elements message"),
        ("[1, 2]", "message 1: fields with names expected"),
        ("{", "no orbit mean-elements message can be read"),
        ("<ndm><omm>", "no orbit mean-elements message can be read"),
        ("<a><segment/></a>", "no orbit mean-elements message can be read"),
        (json.dumps({k: v for k, v in OMM.items() if k != "BSTAR"}), "message 1: BSTAR is missing"),
        (json.dumps({**OMM, "ECCENTRICITY": "x"}), "message 1: ECCENTRICITY is 'x', a number expected"),
        (json.dumps({**OMM, "INCLINATION": "NaN"}), "INCLINATION is 'NaN', a number expected"),
        (json.dumps({**OMM, "EPOCH": "yesterday"}), "a time such as"),
        (json.dumps({**OMM, "ECCENTRICITY": "1.5"}), "message 1: "),
    ],
)
def test_bad_messages_are_refused(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "bad.omm"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"bad\.omm") as refusal:
        orbits.read_omm(path)
    assert sentence in str(refusal.value)


@pytest.mark.fuzz
@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 137), st.integers(32, 126))
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, noise: bytes, at: int, to: int
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "x.tle"
    lines = f"{LINE_1}\n{LINE_2}\n"
    for content in (noise, (lines[:at] + chr(to) + lines[at + 1 :]).encode()):
        path.write_bytes(content)
        for read in (orbits.read_tle, orbits.read_omm):
            try:
                found = read(path)
            except ValueError as refusal:
                assert "x.tle" in str(refusal)
            else:
                assert found


# ---- orbits


@pytest.mark.crosscheck
def test_samples_are_sgp4_turned_by_sidereal_time(made: Path) -> None:
    """By the formula of the Astronomical Almanac, days since J2000, in place of the engine's."""
    (satellite,) = orbits.read_tle(made)
    orbit = satellite.sampled("2014-08-27T06:00:00.25", 120.0, 20.0)
    assert (orbit.start_s, orbit.step_s, len(orbit)) == (-20.0, 20.0, 9)
    assert orbit.end_s >= 120.0
    seconds = 6 * 3600.0 + 0.25 + np.arange(-20.0, 141.0, 20.0)
    p, v = satellite.teme(2456896.5, seconds / 86400.0)
    days = 2456896.5 - 2451545.0 + seconds / 86400.0
    gmst = np.radians(280.46061837 + 360.98564736629 * days + 0.000387933 * (days / 36525.0) ** 2)
    x = np.cos(gmst) * p[:, 0] + np.sin(gmst) * p[:, 1]
    y = -np.sin(gmst) * p[:, 0] + np.cos(gmst) * p[:, 1]
    np.testing.assert_allclose(orbit.position_e_m, np.stack([x, y, p[:, 2]], axis=1), rtol=0, atol=0.1)
    # Derivatives of the samples, and between them SGP4 again.
    middle = np.arange(-10.0, 131.0, 20.0)
    got = orbit.at(middle)[0]
    q, _ = satellite.teme(2456896.5, (6 * 3600.0 + 0.25 + middle) / 86400.0)
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), np.linalg.norm(q, axis=1), rtol=0, atol=0.02)
    np.testing.assert_allclose((orbit.at(50.1)[0] - orbit.at(49.9)[0]) / 0.2, orbit.at(50.0)[1], rtol=0, atol=1e-3)
    assert np.isfinite(v).all()


@pytest.mark.law
def test_references_and_ut1_move_time_and_longitude(made: Path) -> None:
    (satellite,) = orbits.read_tle(made)
    a = satellite.sampled(START, 60.0)
    b = satellite.sampled(START, 60.0, reference=START - timedelta(hours=1))
    np.testing.assert_array_equal(a.position_e_m, b.position_e_m)
    assert b.start_s == 3590.0
    c = satellite.sampled(START, 60.0, ut1_minus_utc_s=0.5)
    east = geometry.ecef_to_geodetic(c.position_e_m)[1] - geometry.ecef_to_geodetic(a.position_e_m)[1]
    np.testing.assert_allclose(east, -0.5 * 7.2921159e-5, rtol=1e-6)


@pytest.mark.unit
def test_what_no_orbit_can_be_made_of(made: Path, tmp_path: Path) -> None:
    (satellite,) = orbits.read_tle(made)
    with pytest.raises(ValueError, match=r"MADE UP \(90001\): elements of 2014-08-27 are 40\.0 days off"):
        satellite.sampled("2014-10-05T23:59:00Z", 60.0)
    assert len(satellite.sampled("2014-10-05T23:59:00Z", 60.0, max_age_days=50.0)) > 2
    with pytest.raises(ValueError, match="duration_s: 0, a positive"):
        satellite.sampled(START, 0)
    with pytest.raises(ValueError, match="step_s"):
        satellite.sampled(START, 60.0, -1.0)
    with pytest.raises(ValueError, match="ut1_minus_utc_s"):
        satellite.sampled(START, 60.0, ut1_minus_utc_s=2.0)
    with pytest.raises(ValueError, match="'soon': a time such as"):
        satellite.sampled("soon", 60.0)
    with pytest.raises(ValueError, match="julian_day, fraction"):
        satellite.teme(2456896.5, [np.nan])
    # Heavy drag on a low orbit: SGP4 says it has decayed, and so do we.
    falling = tmp_path / "falling.tle"
    line_1 = checked("1 90001U 14001A   14239.00000000  .10000000  00000-0  90000-1 0  999")
    line_2 = checked("2 90001  51.6000  40.0000 0010000  90.0000 270.0000 16.40000000 1000")
    falling.write_text(f"{line_1}\n{line_2}\n", encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"90001 \(90001\): no position at 2014-\d\d-\d\dT.*: (the satellite has|the )"
    ):
        orbits.read_tle(falling)[0].sampled("2014-09-10", 86400.0, 600.0)


@pytest.mark.unit
def test_along_track_error_grows_with_age() -> None:
    model = orbits.AlongTrackError()
    assert float(model.sigma_m(86400.0)) == pytest.approx(1000.0, rel=0.05)
    np.testing.assert_allclose(model.sigma_m([-86400.0, 86400.0]), model.sigma_m(86400.0))
    ages = model.sigma_m(np.array([0.0, 1.0, 3.0, 7.0, 30.0]) * 86400.0)
    assert (np.diff(ages) > 0).all()
    assert ages[0] == 500.0
    assert ages[-1] == pytest.approx(300.0 * 900.0, rel=0.02)
    assert float(model.ahead_sigma_s(0.0)) == pytest.approx(0.067, rel=0.01)
    with pytest.raises(ValueError, match="rate_m_per_day: -1"):
        orbits.AlongTrackError(rate_m_per_day=-1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.at_epoch_m = 1.0  # type: ignore[misc]


# ---- ways of signals


@pytest.mark.crosscheck
def test_signal_path_is_a_straight_line_in_space() -> None:
    orbit = orbits.iridium_walker(900.0)[3]
    t = np.linspace(1.0, 899.0, 40)
    path = geometry.signal_path(orbit, t, HELSINKI)
    omega = 7.292115e-5

    def space(p: np.ndarray, when: np.ndarray) -> np.ndarray:
        c, s = np.cos(omega * when), np.sin(omega * when)
        return np.stack([c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1], p[..., 2] + 0 * when], axis=-1)

    sent, _ = orbit.at(t - path.delay_s)
    way = np.linalg.norm(space(sent, t - path.delay_s) - space(HELSINKI, t), axis=1)
    np.testing.assert_allclose(C * path.delay_s, way, rtol=0, atol=1e-6)
    before, after = (geometry.signal_path(orbit, t + h, HELSINKI).delay_s for h in (-0.01, 0.01))
    np.testing.assert_allclose(path.delay_rate, (after - before) / 0.02, rtol=0, atol=2e-13)
    np.testing.assert_allclose(np.linalg.norm(path.direction_e, axis=1), 1.0)
    np.testing.assert_allclose(path.source_position_e_m - HELSINKI, path.range_m[:, None] * path.direction_e, atol=1e-6)


@pytest.mark.jacobian
def test_gradients_are_the_differences() -> None:
    orbit = orbits.iridium_walker(900.0)[40]
    v = np.array([20.0, -30.0, 5.0])
    g = geometry.signal_path(orbit, 400.0, HELSINKI, v, gradient=True).gradient
    assert g is not None
    for k, unit in enumerate(np.eye(3)):
        a, b = (geometry.signal_path(orbit, 400.0, HELSINKI + h * unit, v) for h in (-100.0, 100.0))
        assert g.delay_p[k] == pytest.approx((b.delay_s - a.delay_s) / 200.0, abs=1e-16)
        assert g.rate_p[k] == pytest.approx((b.delay_rate - a.delay_rate) / 200.0, abs=1e-19)
    a, b = (geometry.signal_path(orbit, 400.0, HELSINKI, v, ahead_s=h) for h in (-0.05, 0.05))
    assert g.delay_ahead == pytest.approx((b.delay_s - a.delay_s) / 0.1, abs=1e-12)
    assert g.rate_ahead == pytest.approx((b.delay_rate - a.delay_rate) / 0.1, abs=1e-12)


@pytest.mark.unit
def test_shapes_of_signal_paths_and_refusals() -> None:
    orbit = orbits.iridium_walker(900.0)[3]
    t = np.array([[0.0, 10.0], [20.0, 2000.0]])
    path = geometry.signal_path(orbit, t, HELSINKI)
    assert path.delay_s.shape == (2, 2)
    assert path.direction_e.shape == (2, 2, 3)
    assert np.isfinite(path.delay_s).tolist() == [[True, True], [True, False]]
    assert repr(path) == "SignalPaths((2, 2), 3 known)"
    assert geometry.signal_path(orbit, 5.0, HELSINKI).delay_s.shape == ()
    assert geometry.signal_path(orbit, [], HELSINKI, gradient=True).delay_s.shape == (0,)
    assert np.isnan(geometry.signal_path(orbit, 5.0, [np.nan, 0, 0]).delay_s)
    moving = HELSINKI + np.zeros((2, 2, 3))
    np.testing.assert_array_equal(geometry.signal_path(orbit, t, moving).delay_s, path.delay_s)
    with pytest.raises(ValueError, match=r"position_e_m: shape \(3,\) or \(2, 2, 3\) expected, got \(4, 3\)"):
        geometry.signal_path(orbit, t, np.zeros((4, 3)))
    with pytest.raises(ValueError, match="ahead_s"):
        geometry.signal_path(orbit, t, HELSINKI, ahead_s=[1.0])


@pytest.mark.unit
def test_sampled_orbits_are_checked_copied_and_kept() -> None:
    p, v = np.array([[7e6, 0, 0], [7e6, 1e5, 0]]), np.array([[0, 1e4, 0], [0, 1e4, 0]])
    orbit = geometry.SampledOrbit(5.0, 10.0, p, v)
    assert repr(orbit) == "SampledOrbit(5.000 s to 15.000 s, 2 samples of 10.000 s)"
    again = pickle.loads(pickle.dumps(orbit))
    np.testing.assert_array_equal(again.at(7.5)[0], orbit.at(7.5)[0])
    assert np.isnan(orbit.at([4.9, 15.1])[0]).all()
    mast = pickle.loads(pickle.dumps(geometry.SampledOrbit.fixed(HELSINKI)))
    assert mast.is_fixed
    np.testing.assert_array_equal(mast.at(1e9)[0], HELSINKI)
    for wrong in (
        lambda: geometry.SampledOrbit(0.0, 0.0, p, v),
        lambda: geometry.SampledOrbit(0.0, 1.0, p[:1], v[:1]),
        lambda: geometry.SampledOrbit(0.0, 1.0, p, v[:1]),
        lambda: geometry.SampledOrbit(0.0, 1.0, p[:, :2], v[:, :2]),
        lambda: geometry.SampledOrbit(0.0, 1.0, p * np.nan, v),
        lambda: geometry.SampledOrbit(np.inf, 1.0, p, v),
        lambda: geometry.SampledOrbit.fixed([1.0, 2.0]),
    ):
        with pytest.raises(ValueError, match=r"step_s|p_e|v_e|position_e_m|velocity_e_mps|start_s"):
            wrong()


# ---- constellations and passes


@pytest.mark.unit
def test_walker_constellations() -> None:
    made = orbits.walker(24, 3, 1, inclination_rad=0.96, altitude_m=2.02e7, duration_s=100.0, gmst_rad=0.3)
    assert len(made) == 24
    assert all(o.start_s == -10.0 and o.end_s >= 110.0 for o in made)
    first = np.array([o.at(0.0)[0] for o in made])
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 6378137.0 + 2.02e7, rtol=1e-12)
    # A later sidereal time turns the same constellation westwards.
    turned = orbits.walker(24, 3, 1, inclination_rad=0.96, altitude_m=2.02e7, duration_s=100.0, gmst_rad=0.8)
    angle = np.angle((turned[5].at(0.0)[0][:2] @ [1, 1j]) / (first[5][:2] @ [1, 1j]))
    assert angle == pytest.approx(-0.5)
    star = orbits.walker(66, 6, 2, inclination_rad=1.508, altitude_m=780e3, star=True, duration_s=60.0)
    assert len(star) == 66
    with pytest.raises(ValueError, match="total, planes: 10 satellites do not fill 3 planes"):
        orbits.walker(10, 3, 0, inclination_rad=1.0, altitude_m=1e6, duration_s=10.0)
    with pytest.raises(ValueError, match="duration_s"):
        orbits.iridium_walker(-5.0)


@pytest.mark.unit
def test_visible_are_those_above_the_mask_highest_first() -> None:
    orbit = orbits.iridium_walker(600.0)
    azimuth, elevation, distance = orbits.elevations(orbit, [0.0, 300.0], HELSINKI)
    assert azimuth.shape == elevation.shape == distance.shape == (66, 2)
    index, height = orbits.visible(orbit, 300.0, HELSINKI, np.radians(5.0))
    assert set(index) == set(np.flatnonzero(elevation[:, 1] >= np.radians(5.0)))
    assert (np.diff(height) <= 0).all()
    assert len(index) >= 1
    assert np.count_nonzero(elevation[:, 1] < 0) > 50  # those below the horizon are said to be there
    assert orbits.visible(orbit, 9999.0, HELSINKI)[0].size == 0
    with pytest.raises(ValueError, match="p_e"):
        orbits.visible(orbit, 0.0, [0.0, 0.0, 1.0])


@pytest.mark.unit
def test_passes_agree_with_the_elevations() -> None:
    orbit = orbits.iridium_walker(3600.0)
    mask = np.radians(8.0)
    found = orbits.passes(orbit, HELSINKI, 0.0, 3600.0, mask_rad=mask)
    t = np.arange(0.0, 3600.5, 1.0)
    up = orbits.elevations(orbit, t, HELSINKI)[1] >= mask
    starts = [
        (i, k) for i in range(66) for k in np.flatnonzero(np.diff(np.concatenate([[False], up[i]]).astype(int)) > 0)
    ]
    assert len(found) == len(starts)
    assert [one.rise_s for one in found] == sorted(one.rise_s for one in found)
    for one in found:
        assert any(one.index == i and abs(one.rise_s - k) <= 1.05 for i, k in starts)
        assert one.rise_s <= one.highest_s <= one.set_s
        if one.complete:
            edge = orbits.elevations([orbit[one.index]], [one.rise_s, one.set_s], HELSINKI)[1][0]
            np.testing.assert_allclose(edge, mask, atol=2e-4)
            assert one.doppler_hz[0] > 0 > one.doppler_hz[2]
            assert abs(one.doppler_hz[1]) < 400.0  # at the highest it turns
    assert not found[0].complete or found[0].rise_s > 0.0
    for arguments, sentence in (
        ((HELSINKI, 5.0, 5.0), "no span"),
        ((HELSINKI, 0.0, 9e3), r"orbits\[0\]: known from"),
        ((HELSINKI, np.nan, 1.0), "no span"),
    ):
        with pytest.raises(ValueError, match=sentence):
            orbits.passes(orbit, *arguments)
    with pytest.raises(ValueError, match="mask_rad"):
        orbits.passes(orbit, HELSINKI, 0.0, 60.0, mask_rad=2.0)


@pytest.mark.unit
def test_excerpts_cover_what_was_asked() -> None:
    orbit = orbits.iridium_walker(600.0)[7]
    part = orbits.excerpt(orbit, 101.0, 119.0)
    assert (part.start_s, part.end_s, len(part)) == (100.0, 120.0, 3)
    np.testing.assert_allclose(part.at(117.3)[0], orbit.at(117.3)[0], rtol=0, atol=1e-8)
    assert len(orbits.excerpt(orbit, 610.0, 610.0)) == 2
    mast = geometry.SampledOrbit.fixed(HELSINKI)
    assert orbits.excerpt(mast, 0.0, 1.0) is mast
    with pytest.raises(ValueError, match="is not within"):
        orbits.excerpt(orbit, 0.0, 1e4)


@pytest.mark.law
@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_files_of_orbits_come_back_bit_for_bit(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"orbits{suffix}"
    sent = {
        "a": orbits.iridium_walker(60.0)[0],
        "B, with a comma": orbits.iridium_walker(30.0, start_s=7.0, step_s=2.5)[9],
        "mast": geometry.SampledOrbit.fixed(HELSINKI),
    }
    orbits.write_ephemeris(path, sent, START)
    got = orbits.read_ephemeris(path)
    assert got.reference == START
    assert list(got.orbits) == list(sent)
    for name, orbit in sent.items():
        np.testing.assert_array_equal(got.orbits[name].position_e_m, orbit.position_e_m)
        np.testing.assert_array_equal(got.orbits[name].velocity_e_mps, orbit.velocity_e_mps)
        assert got.orbits[name].start_s == orbit.start_s
        assert got.orbits[name].step_s == pytest.approx(orbit.step_s, rel=1e-12)
    with pytest.raises(ValueError, match=r"\.npz or \.csv"):
        orbits.write_ephemeris(tmp_path / "x.txt", sent, START)
    with pytest.raises(ValueError, match="at least one"):
        orbits.write_ephemeris(path, {}, START)
    with pytest.raises(ValueError, match="is no name"):
        orbits.write_ephemeris(path, {" a": sent["a"]}, START)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", ":1: # reference: TIME expected"),
        ("# reference: never\n", ":1: 'never': a time"),
        ("# reference: 2014-08-27\na,b\n", ":2: the columns"),
        ("HEAD", "no samples"),
        ("HEADa,0,1,2,3,4,5\n", ":3: a name and seven finite numbers"),
        ("HEADa,0,1,2,nan,4,5,6\n", ":3: a name and seven finite numbers"),
        ("HEADa,0,1e7,0,0,0,0,0\na,1,1e7,0,0,0,0,0\na,3,1e7,0,0,0,0,0\n", "a: times at even steps"),
    ],
)
def test_bad_tables_of_orbits_are_refused(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "bad.csv"
    head = "# reference: 2014-08-27\nname,time_s,x_m,y_m,z_m,vx_mps,vy_mps,vz_mps\n"
    path.write_text(text.replace("HEAD", head), encoding="utf-8")
    with pytest.raises(ValueError, match=r"bad\.csv") as refusal:
        orbits.read_ephemeris(path)
    assert sentence in str(refusal.value)
    archive = tmp_path / "bad.npz"
    archive.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ValueError, match=r"bad\.npz: no ephemeris"):
        orbits.read_ephemeris(archive)


# ---- figure and command


@pytest.mark.unit
def test_figure_of_passes_shows_them(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    orbit = orbits.iridium_walker(1800.0)
    mask = np.radians(8.0)
    found = orbits.passes(orbit, HELSINKI, 0.0, 1800.0, mask_rad=mask)
    figure = sn.plotting.passes(
        orbit, HELSINKI, 0.0, 1800.0, mask_rad=mask, reference=START, title="made up", path=tmp_path / "sky.png"
    )
    sky, heights, dopplers = figure.axes
    assert len(heights.get_lines()) == len(found)
    assert len(sky.get_lines()) == len(found) + 1  # and the mask
    assert (tmp_path / "sky.png").read_bytes()[:4] == b"\x89PNG"
    top = max(line.get_ydata().max() for line in heights.get_lines())
    assert top == pytest.approx(np.degrees(max(one.highest_elevation_rad for one in found)), abs=0.3)
    assert dopplers.get_ylabel() == "Doppler [kHz]"
    plain = sn.plotting.passes(orbit[:1], HELSINKI, 0.0, 60.0, mask_rad=1.5)
    assert "no pass" in [t.get_text() for t in plain.axes[1].texts]
    with pytest.raises(ValueError, match="names: 66 expected"):
        sn.plotting.passes(orbit, HELSINKI, 0.0, 60.0, names=["a"])


@pytest.mark.unit
def test_command_passes(made: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from click.testing import CliRunner

    from soopnav_cpp.cli.app import cli

    def run(*arguments: object, code: int = 0) -> str:
        result = CliRunner().invoke(cli, ["passes", *(str(a) for a in arguments)], catch_exceptions=False)
        assert result.exit_code == code, result.output
        return result.output

    common = (made, "--at", "60.2,25.0,20", "--start", "2014-08-27T06:00:00Z", "--duration", "720")
    rows = json.loads(run(*common, "--json"))["passes"]
    assert rows
    orbit = orbits.read_tle(made)[0].sampled(START, 720 * 60.0)
    expected = orbits.passes([orbit], HELSINKI, 0.0, 720 * 60.0, mask_rad=np.radians(8.0))
    assert [r["highest_elevation_deg"] for r in rows] == pytest.approx(
        [np.degrees(one.highest_elevation_rad) for one in expected]
    )
    assert rows[0]["doppler_hz"] == pytest.approx(expected[0].doppler_hz)
    output = run(*common, "--plot", tmp_path / "sky.png")
    assert "MADE UP" in output
    assert "Doppler [kHz]" in output
    assert (tmp_path / "sky.png").exists()
    assert "no pass of 1 satellites" in run(*common[:-1], "1", "--mask", "80")
    assert "30 allowed" in run(made, "--at", "60,25", "--start", "2015-08-27", code=2)
    assert "expected" in run(made, "--at", "95,25", "--start", "2014-08-27", code=2)
    assert "expected" in run(made, "--at", "here", "--start", "2014-08-27", code=2)
    assert "a time such as" in run(made, "--at", "60,25", "--start", "noon", code=2)
    assert "no such file" in run(tmp_path / "none.tle", "--at", "60,25", "--start", "2014-08-27", code=2)
    assert ".png expected" in run(*common, "--plot", "sky.gif", code=2)
