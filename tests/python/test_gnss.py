"""GNSS from Python: RINEX files whole and broken, cycle slips, single-point positions, simulated observables."""

import dataclasses
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import soopnav_cpp as sn
from soopnav_cpp import gnss
from soopnav_cpp._extras import MissingExtraError
from soopnav_cpp.simulation import simulate_gnss

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = ROOT.parent / "shared" / "captures"
STATIC = CAPTURES / "gnss_static"
BASELINE = CAPTURES / "gnss_baseline_1m"
WEEK, TOE_S = 2200, 302_400.0
HERE = sn.geometry.geodetic_to_ecef(0.6, 2.4, 100.0)

offair = pytest.mark.skipif(not STATIC.exists(), reason="the recordings ../shared/captures/gnss_* are not here")
rinex = pytest.mark.skipif(find_spec("georinex") is None, reason="georinex is not installed: the extra gnss brings it")


@pytest.fixture(scope="module")
def sky():
    return gnss.walker_constellation(30, 6, 1, week=WEEK, toe_s=TOE_S)


@pytest.fixture(scope="module")
def static():
    """Every tenth epoch of the static antenna, and its orbits."""
    return (
        gnss.read_observations(STATIC / "SEPT078M.21O", interval_s=10.0),
        gnss.read_navigation(STATIC / "SEPT078M.21P"),
    )


def changed_in(observed, **arrays):
    """The same observations with other arrays."""
    return dataclasses.replace(observed, **arrays)


# Files made here: two epochs of three satellites, one message.
HEADER = """\
     3.04           OBSERVATION DATA    M                   RINEX VERSION / TYPE
 -3962108.4557  3381308.8777  3668678.1749                  APPROX POSITION XYZ
G    5 X1  C1C L1C D1C S1C                                  SYS / # / OBS TYPES
E    2 C1C L1C                                              SYS / # / OBS TYPES
  2021     3    19    12     0    0.0000000     GPS         TIME OF FIRST OBS
                                                            END OF HEADER
"""


def measurement(name, channel, code, phase, lli=" "):
    return f"{name}{channel:14.3f}  {code:14.3f} 6{phase:14.3f}{lli}6{-105.344:14.3f}  {44.25:14.3f}\n"


def observation_file(path, text):
    path.write_text(HEADER + text)
    return path


EPOCHS = (
    "> 2021 03 19 12 00  0.0000000  0  3\n"
    + measurement("G05", 1, 23730000.123, 124704000.25)
    + "E11  27530612.397 5 144674111.111 5\n"
    + measurement("G 7", 2, 24000000.5, 126000000.0, "1")
    + "> 2021 03 19 12 00  1.0000000  0  1\n"
    + measurement("G05", 1, 23730100.123, 124704525.25)
)


@rinex
def test_measurements_land_where_they_belong(tmp_path):
    """The first observable is a channel number: the code is the second."""
    got = gnss.read_observations(observation_file(tmp_path / "a.obs", EPOCHS))
    assert got.satellites == ("G05", "G07")
    assert got.prn.tolist() == [5, 7]
    np.testing.assert_array_equal(got.code_m, [[23730000.123, 24000000.5], [23730100.123, np.nan]])
    np.testing.assert_array_equal(got.phase_cycles, [[124704000.25, 126000000.0], [124704525.25, np.nan]])
    np.testing.assert_array_equal(got.doppler_hz[:, 0], [-105.344, -105.344])
    np.testing.assert_array_equal(got.cn0_dbhz[0], [44.25, 44.25])
    np.testing.assert_array_equal(got.lli, [[0, 1], [0, 0]])
    assert got.week.tolist() == [2149, 2149]
    np.testing.assert_array_equal(got.time_of_week_s, [475200.0, 475201.0])
    np.testing.assert_array_equal(got.approximate_position_ecef_m, [-3962108.4557, 3381308.8777, 3668678.1749])
    assert got.problems == ()
    both = gnss.read_observations(tmp_path / "a.obs", "GE")
    assert both.satellites == ("E11", "G05", "G07")
    assert both.prn.tolist() == [0, 5, 7]
    assert both.code_m[0, 0] == 27530612.397
    assert np.isnan(both.code_m[1, 0])
    assert not got.code_m.flags.writeable
    assert "2 epochs of 2 satellites" in repr(got)


@rinex
@pytest.mark.parametrize("cut", range(0, len(EPOCHS), 23))
def test_a_file_cut_anywhere_is_read_as_far_as_it_goes(tmp_path, cut):
    got = gnss.read_observations(observation_file(tmp_path / "a.obs", EPOCHS[:cut]))
    whole = 1 if cut >= EPOCHS.index("> 2021 03 19 12 00  1") else 0
    assert len(got) == whole
    assert bool(got.problems) == (cut == 0 or cut != EPOCHS.index("> 2021 03 19 12 00  1"))
    if got.problems and cut > 0 and not whole:
        assert any("cut short" in p or "cannot be read" in p for p in got.problems)
    assert np.isfinite(got.code_m).sum() == 2 * whole


@rinex
def test_damage_within_is_left_out_and_said(tmp_path):
    lines = EPOCHS.splitlines(keepends=True)
    lost = "".join(lines[:2] + lines[3:])  # a satellite's line is missing
    got = gnss.read_observations(observation_file(tmp_path / "a.obs", lost))
    assert len(got) == 1
    assert "a.obs:7: epoch cut short (3 satellites stated, 2 lines)" in got.problems[0]
    event = "> 2021 03 19 12 00  0.5000000  4  1\n" + " " * 60 + "COMMENT\n"
    got = gnss.read_observations(observation_file(tmp_path / "b.obs", event + "junk\n" + EPOCHS))
    assert len(got) == 2
    assert "event flag 4" in got.problems[0]
    assert "an epoch ('>') expected" in got.problems[1]


@rinex
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "RINEX VERSION / TYPE"),
        ("nothing of the kind\n", "RINEX VERSION / TYPE"),
        (HEADER.replace("3.04 ", "2.11 "), "version 3 expected, got '2.11'"),
        (HEADER.replace("OBSERVATION DATA", "NAVIGATION DATA "), "a file of observations"),
        (HEADER[: HEADER.index("  2021")], "ends within the header"),
    ],
)
def test_what_is_no_observation_file(tmp_path, text, says):
    (tmp_path / "a.obs").write_text(text)
    with pytest.raises(ValueError, match=says):
        gnss.read_observations(tmp_path / "a.obs")


@rinex
def test_observation_refusals(tmp_path):
    path = observation_file(tmp_path / "a.obs", EPOCHS)
    with pytest.raises(ValueError, match="systems = 'X'"):
        gnss.read_observations(path, "X")
    with pytest.raises(ValueError, match=r"systems: 'R' is not in .* which has 'EG'"):
        gnss.read_observations(path, "R")
    with pytest.raises(ValueError, match="interval_s = 0"):
        gnss.read_observations(path, interval_s=0.0)
    with pytest.raises(ValueError, match="no code measurement C5Q"):
        gnss.read_observations(path, codes={"G": "5Q"})


def test_without_georinex_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "georinex", None)
    with pytest.raises(MissingExtraError, match=r"reading RINEX needs georinex: pip install soopnav\[gnss\]"):
        gnss.read_observations(observation_file(tmp_path / "a.obs", EPOCHS))


@rinex
def test_times_and_names_that_are_none(tmp_path):
    bad = EPOCHS.replace("19 12 00  0.0", "19 25 00  0.0")
    got = gnss.read_observations(observation_file(tmp_path / "a.obs", bad))
    assert len(got) == 1
    assert "a.obs:7: the epoch line cannot be read" in got.problems[0]
    twice = EPOCHS.replace("G 7", "G05")
    got = gnss.read_observations(observation_file(tmp_path / "b.obs", twice))
    assert len(got) == 1
    assert "come twice" in got.problems[0]


def navigation_file(path, text):
    header = (
        "     3.04           N: GNSS NAV DATA    M: Mixed            RINEX VERSION / TYPE\n"
        "GPSA    .1118D-07   .7451D-08  -.5960D-07  -.5960D-07       IONOSPHERIC CORR    \n"
        "GPSB    .9011D+05   .0000D+00  -.1966D+06  -.6554D+05       IONOSPHERIC CORR    \n"
        "                                                            END OF HEADER       \n"
    )
    path.write_text(header + text)
    return path


def message(values):
    """A GPS message, its 29 numbers after the epoch in the order of RINEX 3."""
    lines = ["G12 2021 03 19 12 00 00" + "".join(f"{v:19.12E}" for v in values[:3])]
    for i in range(3, len(values), 4):
        lines.append("    " + "".join(f"{v:19.12E}" for v in values[i : i + 4]))
    return "\n".join(lines).replace("E", "D") + "\n"


NUMBERS = [
    1e-4, -2e-11, 0.0, 63.0, -36.8, 3.8e-9, -2.187, -1.96e-6, 0.0106, 9.2e-6, 5153.69, 475200.0, -2.2e-7, 0.83, -2.6e-8,
    0.98, 215.0, 0.82, -7.8e-9, 1.9e-10, 1.0, 2149.0, 0.0, 2.0, 0.0, 4.7e-9, 63.0, 468018.0, 4.0,
]  # fmt: skip


@rinex
def test_a_message_is_read_field_by_field(tmp_path):
    nav = gnss.read_navigation(navigation_file(tmp_path / "a.nav", message(NUMBERS)))
    assert nav.prns == (12,)
    assert nav.problems == ()
    np.testing.assert_allclose(
        nav.klobuchar, [1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8, 9.011e4, 0.0, -1.966e5, -6.554e4]
    )
    one = nav.records[0]
    expected = {
        "af0_s": 1e-4, "af1": -2e-11, "iode": 63, "crs_m": -36.8, "delta_n_radps": 3.8e-9, "m0_rad": -2.187,
        "cuc_rad": -1.96e-6, "eccentricity": 0.0106, "cus_rad": 9.2e-6, "sqrt_a": 5153.69, "toe_s": 475200.0,
        "cic_rad": -2.2e-7, "omega0_rad": 0.83, "cis_rad": -2.6e-8, "i0_rad": 0.98, "crc_m": 215.0, "omega_rad": 0.82,
        "omega_dot_radps": -7.8e-9, "i_dot_radps": 1.9e-10, "week": 2149, "health": 0, "tgd_s": 4.7e-9,
        "toc_s": 475200.0, "fit_interval_s": 14400.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert one[name] == pytest.approx(value, rel=1e-12), name
    again = gnss.Ephemerides(nav.records)
    np.testing.assert_array_equal(again.records, nav.records)


@rinex
@pytest.mark.parametrize("cut", [0, 40, 100, 300, 500, 560])
def test_a_message_cut_short_is_left_out_and_said(tmp_path, cut):
    text = message(NUMBERS)
    nav = gnss.read_navigation(navigation_file(tmp_path / "a.nav", text + text[:cut].replace("G12", "G13")))
    assert nav.prns == (12,)
    assert len(nav.problems) == (1 if cut else 0)
    if cut:
        assert "message of G13 cut short" in nav.problems[0]


@rinex
def test_messages_that_are_none_are_left_out(tmp_path):
    other = message(NUMBERS).replace("G12", "G13")
    for bad, says in (
        (other.replace("G13", "G1x"), "no satellite and time"),
        (other.replace("2021 03 19 12", "2021 03 19 25"), "no satellite and time"),
        (other.replace("5.153690000000D+03", "5.153690000000D+09"), "satellite 13: sqrt_a"),
        (other.replace("1.060000000000D-02", "1.06000?000000D-02"), "cannot be read"),
    ):
        assert bad != other
        nav = gnss.read_navigation(navigation_file(tmp_path / "a.nav", message(NUMBERS) + bad))
        assert nav.prns == (12,)
        assert len(nav.problems) == 1
        assert says in nav.problems[0]


@rinex
@pytest.mark.fuzz
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path, data):
    """Bytes changed anywhere: arrays of the right shape, or a ValueError that names the file."""
    whole = HEADER + EPOCHS if data.draw(st.booleans()) else None
    text = bytearray((whole or navigation_file(tmp_path / "n.nav", message(NUMBERS) * 2).read_text()).encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    path = tmp_path / "damaged"
    path.write_bytes(bytes(text))
    try:
        if whole:
            got = gnss.read_observations(path)
            assert got.code_m.shape == (len(got), len(got.satellites))
            gnss.single_point(got, gnss.Ephemerides([]))
        else:
            nav = gnss.read_navigation(path)
            gnss.satellite_state(nav, nav.prns, 475200.0)
    except ValueError as error:
        assert "damaged" in str(error) or "systems" in str(error)


def test_ephemerides_refuse_nonsense():
    with pytest.raises(ValueError, match=r"messages\[0\]: unknown field 'sqrta'"):
        gnss.Ephemerides([{"prn": 1, "sqrta": 5153.0}])
    with pytest.raises(ValueError, match="satellite 3: sqrt_a"):
        gnss.Ephemerides([{"prn": 3}])
    with pytest.raises(ValueError, match="klobuchar: eight finite numbers"):
        gnss.Ephemerides([], klobuchar=[1.0])
    with pytest.raises(ValueError, match="satellites = 25"):
        gnss.walker_constellation(25, 6)


@pytest.mark.law
def test_states_and_sights_agree(sky):
    times = TOE_S + np.array([0.0, 600.0])
    seen = gnss.sights(sky, sky.prns, times, WEEK, HERE)
    flight = seen.range_m / 299_792_458.0
    then = gnss.satellite_state(sky, np.array(sky.prns)[np.newaxis, :], times[:, np.newaxis] - flight, WEEK)
    turn = 7.2921151467e-5 * flight
    x = np.cos(turn) * then.position_m[..., 0] + np.sin(turn) * then.position_m[..., 1]
    np.testing.assert_allclose(x, seen.position_m[..., 0], atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(then.position_m, axis=-1), 26_559_710.0, rtol=1e-12)
    azimuth, elevation, distance = sn.geometry.LocalFrame(0.6, 2.4, 100.0).direction_to(seen.position_m)
    np.testing.assert_allclose(seen.azimuth_rad, azimuth, atol=1e-9)
    np.testing.assert_allclose(seen.elevation_rad, elevation, atol=1e-9)
    np.testing.assert_allclose(seen.range_m, distance, rtol=1e-13)
    assert np.isnan(gnss.satellite_state(sky, 63, TOE_S).clock_s)
    assert np.isnan(gnss.satellite_state(sky, 1, TOE_S + 50_000.0).clock_s)
    with pytest.raises(ValueError, match="receiver_position_m"):
        gnss.sights(sky, sky.prns, times, WEEK, [0.0, 0.0, 0.0])


def test_simulated_pseudoranges_give_the_place_back(sky):
    times = TOE_S + np.arange(0.0, 3600.0, 300.0)
    v = np.array([12.0, -3.0, 4.0])
    path = HERE + v * (times - times[0])[:, np.newaxis]
    bias = 1e5 + 30.0 * (times - times[0])
    seen = simulate_gnss(
        sky, path, times, WEEK, seed=1, noise=False, velocities_mps=v, clock_bias_m=bias, clock_drift_mps=30.0,
        troposphere=True, ionosphere=[1e-8, 7e-9, -6e-8, -6e-8, 9e4, 0.0, -2e5, -6e4],
    )  # fmt: skip
    observed = seen.antennas[0]
    knowing = gnss.Ephemerides(sky.records, klobuchar=[1e-8, 7e-9, -6e-8, -6e-8, 9e4, 0.0, -2e5, -6e4])
    fixes = gnss.single_point(observed, knowing)
    assert fixes.converged.all()
    np.testing.assert_allclose(fixes.position_m, path, atol=1e-4)
    np.testing.assert_allclose(fixes.clock_bias_m, bias, atol=1e-4)
    np.testing.assert_allclose(fixes.velocity_mps, np.broadcast_to(v, path.shape), atol=1e-4)
    assert "12 converged" in repr(fixes)
    assert "satellites used" in fixes.message()
    # Phase minus code: integers, and twice the ionosphere.
    cycles = observed.phase_cycles - observed.code_m / gnss.L1_M
    offset = cycles - seen.integers
    seen_some = np.isfinite(offset)
    assert (offset[seen_some] < 0.0).all()
    assert (offset[seen_some] > -400.0).all()
    assert (seen.integers == np.round(seen.integers)).all()
    without = gnss.single_point(observed, sky)
    assert np.abs(without.position_m - path).max() > 1.0


def test_antennas_share_a_clock_and_not_their_noise(sky):
    places = np.stack([np.tile(HERE, (5, 1)), np.tile(HERE + np.array([0.5, 0.0, 0.0]), (5, 1))])
    seen = simulate_gnss(sky, places, TOE_S + np.arange(5.0), WEEK, seed=3, clock_bias_m=77.0)
    one, two = seen.antennas
    assert one.satellites == two.satellites
    np.testing.assert_array_equal(seen.clock_bias_m, 77.0)
    # Differenced phases without their integers: the baseline along the line of sight, and millimetres.
    difference = (two.phase_cycles - one.phase_cycles - seen.integers[1] + seen.integers[0]) * gnss.L1_M
    truth = seen.range_m[1] - seen.range_m[0]
    visible = np.isfinite(truth)
    assert visible.sum() > 20
    assert np.abs(difference - truth)[visible].max() < 0.02
    assert np.abs(difference - truth)[visible].max() > 1e-5
    again = simulate_gnss(sky, places, TOE_S + np.arange(5.0), WEEK, seed=3, clock_bias_m=77.0)
    np.testing.assert_array_equal(one.code_m, again.antennas[0].code_m)
    other = simulate_gnss(sky, places, TOE_S + np.arange(5.0), WEEK, seed=4, clock_bias_m=77.0)
    assert (one.code_m != other.antennas[0].code_m)[visible].all()
    assert "2 antennas" in repr(seen)


@pytest.mark.consistency
def test_noise_is_that_of_the_loops(sky):
    """Sample variances over many epochs; the bounds are 5 standard deviations of a variance."""
    times = TOE_S + np.arange(400.0)
    options = {"integers": False, "doppler_sigma_hz": 0.1, "elevation_mask_rad": 0.2}
    noisy = simulate_gnss(sky, HERE, times, WEEK, seed=11, **options)
    clean = simulate_gnss(sky, HERE, times, WEEK, seed=11, noise=False, **options)
    a, b = noisy.antennas[0], clean.antennas[0]
    columns = np.isfinite(a.code_m).all(axis=0)
    cn0 = a.cn0_dbhz[:, columns]
    n = cn0.size
    code = ((a.code_m - b.code_m)[:, columns] / sn.gps.code_sigma_m(cn0)) ** 2
    phase = ((a.phase_cycles - b.phase_cycles)[:, columns] * gnss.L1_M / sn.gps.phase_sigma_m(cn0)) ** 2
    doppler = ((a.doppler_hz - b.doppler_hz)[:, columns] / 0.1) ** 2
    for squares in (code, phase, doppler):
        assert abs(squares.mean() - 1.0) < 5.0 * np.sqrt(2.0 / n)
    assert (np.diff(cn0, axis=0) != 0.0).any()
    elevation = noisy.elevation_rad[0][:, columns]
    np.testing.assert_allclose(cn0, 47.0 - 8.0 * (1.0 - np.sin(elevation)), atol=1e-12)


@pytest.mark.consistency
def test_multipath_is_first_order_gauss_markov(sky):
    times = TOE_S + np.arange(3000.0)
    options = {"integers": False, "noise": False, "elevation_mask_rad": 0.2}
    bent = simulate_gnss(sky, HERE, times, WEEK, seed=5, multipath_sigma_m=2.0, multipath_time_s=3.0, **options)
    clean = simulate_gnss(sky, HERE, times, WEEK, seed=5, **options)
    columns = np.isfinite(bent.range_m[0]).all(axis=0)
    m = (bent.antennas[0].code_m - clean.antennas[0].code_m)[:, columns] / (
        2.0 * np.cos(bent.elevation_rad[0][:, columns])
    )
    keep = np.exp(-1.0 / 3.0)
    # As many free samples as (1 - keep²) / (1 + keep²) of all for a variance.
    free = m.size * (1.0 - keep**2) / (1.0 + keep**2)
    assert abs((m**2).mean() - 1.0) < 5.0 * np.sqrt(2.0 / free)
    assert abs((m[1:] * m[:-1]).mean() / (m**2).mean() - keep) < 5.0 * np.sqrt((1.0 - keep**2) / m.size)
    phase = (bent.antennas[0].phase_cycles - clean.antennas[0].phase_cycles)[:, columns] * gnss.L1_M
    np.testing.assert_allclose(phase, 0.02 * np.cos(bent.elevation_rad[0][:, columns]) * m, atol=1e-6)


@pytest.mark.consistency
def test_false_alarms_come_as_often_as_stated_and_faults_are_found(sky):
    """Share of contradictions among good epochs, within 5 standard deviations; a fault of 15 σ is named."""
    times = TOE_S + 10.0 * np.arange(-1500.0, 1500.0)
    options = {"code_sigma_m": 2.0, "elevation_mask_rad": 0.2, "clock_bias_m": 500.0}
    observed = simulate_gnss(sky, HERE, times, WEEK, seed=9, **options).antennas[0]
    solve = {"sigma_m": 2.0, "weight_by_elevation": False, "troposphere": False, "false_alarm_probability": 0.05}
    fixes = gnss.single_point(observed, sky, **solve)
    alarm = (fixes.status == gnss.PointStatus.INCONSISTENT) | (fixes.use == gnss.SatelliteUse.REJECTED).any(axis=1)
    assert (fixes.degrees_of_freedom > 0).all()
    assert abs(alarm.mean() - 0.05) < 5.0 * np.sqrt(0.05 * 0.95 / len(times))
    solve["false_alarm_probability"] = 1e-4
    code = observed.code_m.copy()
    seen = np.isfinite(code)
    at = np.array([np.flatnonzero(row)[k % row.sum()] for k, row in enumerate(seen)])
    code[np.arange(len(times)), at] += 30.0
    faulty = gnss.single_point(changed_in(observed, code_m=code), sky, **solve)
    rejected = faulty.use == gnss.SatelliteUse.REJECTED
    right = rejected[np.arange(len(times)), at]
    enough = seen.sum(axis=1) >= 8
    assert enough.sum() > 1000
    assert right[enough].mean() > 0.9
    assert faulty.converged[enough].mean() > 0.9


def test_simulation_refusals(sky):
    times = TOE_S + np.arange(3.0)
    with pytest.raises(ValueError, match="positions_m: shape"):
        simulate_gnss(sky, np.zeros((2, 3)), times, WEEK, seed=1)
    with pytest.raises(ValueError, match="clock_bias_m: shape"):
        simulate_gnss(sky, HERE, times, WEEK, seed=1, clock_bias_m=[1.0, 2.0])
    with pytest.raises(ValueError, match="ionosphere = True"):
        simulate_gnss(sky, HERE, times, WEEK, seed=1, ionosphere=True)
    with pytest.raises(ValueError, match="ionosphere: 8 numbers"):
        simulate_gnss(sky, HERE, times, WEEK, seed=1, ionosphere=[1.0])
    with pytest.raises(ValueError, match="code_sigma_m"):
        simulate_gnss(sky, HERE, times, WEEK, seed=1, code_sigma_m=-1.0)


def test_point_statuses(sky):
    observed = simulate_gnss(sky, HERE, TOE_S + np.arange(2.0), WEEK, seed=1).antennas[0]
    some = changed_in(observed, code_m=np.where(np.arange(len(observed.satellites)) < 3, observed.code_m, np.nan))
    fixes = gnss.single_point(some, sky)
    assert (fixes.status == gnss.PointStatus.TOO_FEW_SATELLITES).all()
    assert np.isnan(fixes.position_m).all()
    assert "too few satellites" in repr(fixes)
    stale = gnss.single_point(observed, sky, max_age_s=0.5)
    assert (stale.use[1] != gnss.SatelliteUse.USED).all()
    assert "stale" in stale.message(1)
    with pytest.raises(ValueError, match="sigma_m = 0"):
        gnss.single_point(observed, sky, sigma_m=0.0)
    with pytest.raises(ValueError, match="sigmas_m: shape"):
        gnss.single_point(observed, sky, sigmas_m=np.ones(2))
    with pytest.raises(ValueError, match=r"code_m: shape \(2, 30\) expected, got \(2,\)"):
        changed_in(observed, code_m=np.ones(2))
    with pytest.raises(ValueError, match="reference_position_m"):
        fixes.errors_enu_m([1.0, 2.0])


@pytest.mark.fuzz
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_numbers_give_a_status(sky, data):
    """Whatever is measured: a position is finite where it is said to be one, and NaN where not."""
    clean = simulate_gnss(sky, HERE, [TOE_S], WEEK, seed=1, noise=False).antennas[0]
    number = st.one_of(st.floats(width=64), st.floats(1e7, 4e7), st.just(np.nan))
    code, doppler = clean.code_m.copy(), clean.doppler_hz.copy()
    for column in data.draw(st.lists(st.integers(0, len(clean.satellites) - 1), max_size=30)):
        code[0, column] = data.draw(number)
        doppler[0, column] = data.draw(number)
    sigma = data.draw(st.one_of(st.none(), st.floats(width=64)))
    week = data.draw(st.one_of(st.just(WEEK), st.integers(-(2**40), 2**40)))
    changed = {"code_m": code, "doppler_hz": doppler, "week": np.array([week])}
    fixes = gnss.single_point(changed_in(clean, **changed), sky, sigmas_m=sigma)
    has = fixes.status[0] in (gnss.PointStatus.CONVERGED, gnss.PointStatus.INCONSISTENT)
    for values in (fixes.position_m, fixes.covariance_m2, fixes.clock_bias_m, fixes.chi_square, fixes.pdop):
        assert np.isfinite(values).all() == has
    assert np.isfinite(fixes.velocity_mps).all() or np.isnan(fixes.velocity_mps).all()
    assert fixes.message()


@pytest.mark.example
def test_the_page_runs_and_its_links_lead_somewhere():
    page = (ROOT / "docs" / "gnss.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    made_up = {}
    exec(compile(blocks[1], "docs/gnss.md", "exec"), made_up)
    assert made_up["fixes"].converged.all()
    links = re.findall(r"\]\(([^)#:]+)\)", page)
    assert links
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]


@rinex
@offair
@pytest.mark.offair
@pytest.mark.crosscheck
def test_static_antenna_is_where_its_header_says(static):
    observed, orbits = static
    fixes = gnss.single_point(observed, orbits)
    assert fixes.converged.all()
    errors = fixes.errors_enu_m(observed.approximate_position_ecef_m)
    rms = np.sqrt((errors**2).sum(axis=1).mean())
    assert rms <= 1.0
    assert fixes.iterations.max() <= 8
    # Each model earns its keep: without it the height is off.
    for off in ({"ionosphere": False}, {"troposphere": False}):
        worse = gnss.single_point(observed, orbits, **off).errors_enu_m(observed.approximate_position_ecef_m)
        assert np.sqrt((worse**2).sum(axis=1).mean()) > 2.0 * rms


@rinex
@offair
@pytest.mark.offair
@pytest.mark.slow
def test_every_epoch_of_the_static_antenna():
    observed = gnss.read_observations(STATIC / "SEPT078M.21O")
    assert len(observed) == 900
    fixes = gnss.single_point(observed, gnss.read_navigation(STATIC / "SEPT078M.21P"))
    errors = fixes.errors_enu_m(observed.approximate_position_ecef_m)
    assert np.sqrt((errors**2).sum(axis=1).mean()) <= 1.5


@rinex
@offair
@pytest.mark.offair
def test_dopplers_of_an_antenna_at_rest():
    observed = gnss.read_observations(BASELINE / "base.obs", interval_s=10.0)
    fixes = gnss.single_point(observed, gnss.read_navigation(BASELINE / "base.nav"))
    assert fixes.converged.all()
    assert np.sqrt((fixes.velocity_mps**2).mean(axis=0)).max() < 0.03
    # The clock's drift is the slope of its bias.
    slope = np.polyfit(observed.elapsed_s, fixes.clock_bias_m, 1)[0]
    assert abs(slope - fixes.clock_drift_mps.mean()) < 0.05


@rinex
@offair
@pytest.mark.offair
def test_slips_are_found_in_a_recording():
    observed = gnss.read_observations(BASELINE / "base.obs", interval_s=2.0)
    quiet = gnss.cycle_slips(observed)
    high = ~quiet.any(axis=0) & np.isfinite(observed.phase_cycles).all(axis=0)
    assert high.sum() >= 8
    phase = observed.phase_cycles.copy()
    columns = np.flatnonzero(high)
    epochs = 20 + 12 * np.arange(len(columns))
    for column, epoch in zip(columns, epochs, strict=True):
        phase[epoch:, column] += 1.0
    slipped = gnss.cycle_slips(changed_in(observed, phase_cycles=phase))
    for column, epoch in zip(columns, epochs, strict=True):
        assert np.flatnonzero(slipped[:, column]).tolist() == [epoch]


def test_slips_by_every_sign(sky):
    times = TOE_S + np.arange(60.0)
    observed = simulate_gnss(sky, HERE, times, WEEK, seed=2, code_sigma_m=0.3, elevation_mask_rad=0.3).antennas[0]
    columns = np.flatnonzero(np.isfinite(observed.phase_cycles).all(axis=0))[:5]
    assert len(columns) == 5
    assert not gnss.cycle_slips(observed)[:, columns].any()
    phase, lli = observed.phase_cycles.copy(), observed.lli.copy()
    phase[10:, columns[0]] += 1.0
    lli[20, columns[1]] = 1
    phase[30:38, columns[2]] = np.nan
    phase[2:, columns[3]] += 400.0  # too early for a parabola: code minus carrier shows it
    phase[40:] += 1e4  # the receiver's clock jumps: all alike, with the code
    code = observed.code_m.copy()
    code[40:] += 1e4 * gnss.L1_M
    slips = gnss.cycle_slips(changed_in(observed, phase_cycles=phase, code_m=code, lli=lli))
    assert np.flatnonzero(slips[:, columns[0]]).tolist() == [10]
    assert np.flatnonzero(slips[:, columns[1]]).tolist() == [20]
    assert np.flatnonzero(slips[:, columns[2]]).tolist() == [38]
    assert np.flatnonzero(slips[:, columns[3]]).tolist() == [2]
    assert not slips[:, columns[4]].any()
    with pytest.raises(ValueError, match="threshold_cycles"):
        gnss.cycle_slips(observed, threshold_cycles=0.0)
