"""Recordings that stand in for simulated sensors: what is read, converted, refused and mended."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from soopnav_cpp.scenarios import files

pytestmark = pytest.mark.unit
C = 299_792_458.0

PLANAR = """\
# a recording
time_s,yaw_rate_radps,specific_force_x_mps2,specific_force_y_mps2
0.00,0.1,1.0,2.0

0.02, 0.2, 1.5, -2.5
0.04,0.3,1e0,0
"""


@pytest.fixture
def write(tmp_path):
    def make(text, name="imu.csv"):
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return make


def refusal(path, read=files.read_imu, **options):
    with pytest.raises(files.RecordingError) as caught:
        read(path, **options)
    return str(caught.value).replace(str(path), path.name).split("\n")


def test_a_planar_imu(write):
    data = files.read_imu(write(PLANAR))
    assert isinstance(data, files.PlanarImuData)
    np.testing.assert_array_equal(data.t_s, [0.0, 0.02, 0.04])
    np.testing.assert_array_equal(data.yaw_rate_radps, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(data.specific_force_mps2, [[1.0, 2.0], [1.5, -2.5], [1.0, 0.0]])
    assert data.dropped == ()
    assert data.gaps() == []


def test_units_are_converted_and_columns_stand_in_any_order(write):
    header = "accel_z_mg,gyro_x_dps,gyro_y_degps,gyro_z_radps,accel_x_g,accel_y_mps2,time_us"
    data = files.read_imu(write(f"\ufeff{header}\n500,90,-180,0.25,1,3,1000\n500,90,-180,0.25,1,3,3500\n"))
    assert isinstance(data, files.ImuData)
    np.testing.assert_allclose(data.t_s, [1e-3, 3.5e-3], rtol=1e-15)
    np.testing.assert_allclose(data.w_ib_b_radps[0], [math.pi / 2, -math.pi, 0.25], rtol=1e-15)
    np.testing.assert_allclose(data.f_ib_b_mps2[0], [9.80665, 3.0, 4.903325], rtol=1e-15)


def test_gaps_are_found(write):
    rows = "".join(f"{t:.2f},0,0,0\n" for t in (0.0, 0.02, 0.04, 1.24, 1.26))
    data = files.read_imu(write(PLANAR.split("0.00")[0] + rows))
    [(start, length)] = data.gaps()
    assert (start, length) == (0.04, pytest.approx(1.2))
    assert data.gaps(longer_than_s=2.0) == []


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("0.02, 0.2", "0.02, nan", "imu.csv:5: yaw_rate_radps: nan: a finite number expected"),
        ("0.04,0.3,1e0", "0.04,0.3,inf", "imu.csv:6: specific_force_x_mps2: inf: a finite number expected"),
        ("0.04,0.3,1e0", "0.04,0.3,", "imu.csv:6: specific_force_x_mps2: a number expected, got ''"),
        ("0.04,0.3", "0.04,fast", "imu.csv:6: yaw_rate_radps: a number expected, got 'fast'"),
        ("0.04,", "0.01,", "imu.csv:6: time_s: 0.01 after 0.02: time must rise"),
        ("0.04,", "0.02,", "imu.csv:6: time_s: 0.02 after 0.02: time must rise"),
        ("0.04,0.3,", "0.04,", "imu.csv:6: 4 cells expected, got 3"),
        (
            "yaw_rate_radps",
            "yaw_rat_radps",
            "imu.csv:2: yaw_rat_radps: unknown column; did you mean yaw_rate_radps?",
        ),
        ("specific_force_x_mps2", "yaw_rate_dps", "imu.csv:2: yaw_rate_dps: given as yaw_rate_radps already"),
        ("specific_force_x_mps2", "yaw_rate_radps", "imu.csv:2: yaw_rate_radps: given twice"),
        ("time_s", "time", "imu.csv:2: time: a unit expected: time_s, time_ms, time_us or time_ns"),
        ("time_s", "time_h", "imu.csv:2: time_h: unknown column; did you mean time_us?"),
    ],
)
def test_mistakes_are_named_with_their_line(write, old, new, sentence):
    found = refusal(write(PLANAR.replace(old, new, 1)))
    if "time_h" in sentence:  # any unit of time is near
        assert found[0].startswith("imu.csv:2: time_h: unknown column; did you mean time_")
    else:
        assert found[0] == sentence


def test_missing_columns_and_several_mistakes_at_once(write):
    assert refusal(write("time_s,yaw_rate_radps\n0,1\n")) == [
        "imu.csv:1: missing column specific_force_x_mps2, specific_force_x_g or specific_force_x_mg",
        "imu.csv:1: missing column specific_force_y_mps2, specific_force_y_g or specific_force_y_mg",
    ]
    rows = "".join(f"{k},nan,0,0\n" for k in range(20))
    found = refusal(write(PLANAR.split("0.00")[0] + rows))
    assert len(found) == 9
    assert found[-1] == "imu.csv: 12 more mistakes"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "imu.csv: empty; a line with the names of the columns expected"),
        (b"# only words\n", "imu.csv: empty; a line with the names of the columns expected"),
        (b"time_s,yaw_rate_radps\n", "imu.csv:1: no rows below the names of the columns"),
        (b"\xff\xfe\x00", "imu.csv: not a text file; CSV expected"),
    ],
)
def test_no_table(write, content, sentence):
    assert refusal(write(content)) == [sentence]


def test_a_missing_file(tmp_path):
    assert refusal(tmp_path / "none.csv") == ["none.csv: no such file or directory"]


def test_a_repair_leaves_rows_out_and_says_so(write):
    bad = PLANAR + "0.03,0,0,0\n0.06,nan,0,0\n0.08,0.5,0,0\n"
    data = files.read_imu(write(bad), repair=True)
    np.testing.assert_array_equal(data.t_s, [0.0, 0.02, 0.04, 0.08])
    assert data.dropped == (
        "imu.csv:7: time_s: 0.03 after 0.04: time must rise; left out",
        "imu.csv:8: yaw_rate_radps: nan: a finite number expected; left out",
    )
    assert data.gaps() == [(0.04, pytest.approx(0.04))]
    assert refusal(write(bad + "0.1,word,0,0\n"), repair=True) == [
        "imu.csv:10: yaw_rate_radps: a number expected, got 'word'"
    ]
    nothing = PLANAR.split("0.00")[0] + "0,nan,0,0\n"
    assert refusal(write(nothing), repair=True) == ["imu.csv: no row can be used"]


# ---- time differences


def test_wide_tdoas(write):
    text = "time_s,tdoa_north_ns,tdoa_north_west_m,sigma_north_ns\n1,100,-300,5\n2,,299.792458,\n"
    data = files.read_tdoa(write(text, "tdoa.csv"))
    assert data.transmitters == ("north", "north_west")
    np.testing.assert_allclose(data.tdoa_s, [[1e-7, -300.0 / C], [np.nan, 1e-6]], rtol=1e-14)
    assert data.sigma_s is not None
    np.testing.assert_allclose(data.sigma_s, [[5e-9, np.nan], [np.nan, np.nan]], rtol=1e-14)


def test_long_tdoas_are_the_wide_ones(write):
    long = "time_s,transmitter,tdoa_us,sigma_m\n1,A,0.1,1\n1,B,0.2,2\n2,B,0.3,3\n3,A,0.4,4\n"
    wide = "time_s,tdoa_A_us,tdoa_B_us,sigma_A_m,sigma_B_m\n1,0.1,0.2,1,2\n2,,0.3,,3\n3,0.4,,4,\n"
    one, two = (files.read_tdoa(write(text, "tdoa.csv")) for text in (long, wide))
    assert one.transmitters == two.transmitters == ("A", "B")
    np.testing.assert_array_equal(one.t_s, two.t_s)
    np.testing.assert_array_equal(one.tdoa_s, two.tdoa_s)
    assert one.sigma_s is not None
    np.testing.assert_array_equal(one.sigma_s, two.sigma_s)
    assert files.read_tdoa(write("time_s,transmitter,tdoa_s\n1,A,0\n", "tdoa.csv")).sigma_s is None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time_s,tdoa_A_s\n1,nan\n", "2: tdoa_A_s: nan: a finite number expected; leave the cell empty without one"),
        ("time_s,tdoa_A_s\n1,x\n", "2: tdoa_A_s: a number or nothing expected, got 'x'"),
        ("time_s,tdoa_A_s\n,1\n", "2: time_s: a number expected, got ''"),
        ("time_s,tdoa_A_s,sigma_A_s\n1,0,0\n", "2: sigma: more than 0 expected"),
        ("time_s,tdoa_A_s,sigma_B_s\n1,0,1\n", "1: missing column tdoa_B_s, tdoa_B_us, tdoa_B_ns or tdoa_B_m"),
        ("time_s,toa_A\n1,0\n", "1: no column tdoa_NAME_s, _us, _ns or _m, and none named transmitter"),
        ("time_s,transmitter,tdoa_s\n1,A,0\n1,A,1\n", "3: transmitter: A at this time already on line 2"),
        ("time_s,transmitter,tdoa_s\n1,,0\n", "2: transmitter: a name expected"),
        ("time_s,transmitter,tdoa_s\n2,A,0\n1,B,0\n", "3: time_s: 1 after 2: time must rise"),
        ("time_s,transmitter,tdoa_s,sigma_s\n1,A,0,-1\n", "2: sigma: more than 0 expected"),
        ("time_s,transmitter\n1,A\n", "1: missing column tdoa_s, tdoa_us, tdoa_ns or tdoa_m"),
    ],
)
def test_tdoas_that_do_not_fit(write, text, sentence):
    assert refusal(write(text, "tdoa.csv"), files.read_tdoa) == [f"tdoa.csv:{sentence}"]


# ---- truth


def test_a_truth(write):
    header = "time_ms,position_x_km,position_y_m,velocity_x_kmph,velocity_y_mps,heading_deg"
    text = f"{header}\n0,1,2,36,-1,90\n10,1,3,0,0,-45\n"
    data = files.read_truth(write(text, "truth.csv"))
    np.testing.assert_allclose(data.t_s, [0.0, 0.01])
    np.testing.assert_allclose(data.position_m, [[1000.0, 2.0], [1000.0, 3.0]])
    assert data.velocity_mps is not None
    assert data.heading_rad is not None
    np.testing.assert_allclose(data.velocity_mps[0], [10.0, -1.0])
    np.testing.assert_allclose(data.heading_rad, [math.pi / 2, -math.pi / 4])
    space = files.read_truth(write("time_s,position_x_m,position_y_m,position_z_m\n0,1,2,3\n", "truth.csv"))
    np.testing.assert_array_equal(space.position_m, [[1.0, 2.0, 3.0]])
    assert space.velocity_mps is None
    assert space.heading_rad is None
    half = "time_s,position_x_m,position_y_m,velocity_x_mps\n0,1,2,3\n"
    assert refusal(write(half, "truth.csv"), files.read_truth) == [
        "truth.csv:1: missing column velocity_y_mps or velocity_y_kmph"
    ]


def test_a_truth_between_its_times(write):
    text = "time_s,position_x_m,position_y_m,heading_deg\n0,0,10,170\n2,4,10,-170\n4,4,20,-160\n"
    data = files.read_truth(write(text, "truth.csv"))
    found = data.at([0.0, 1.0, 3.0, 4.0])
    np.testing.assert_allclose(found.position_m, [[0.0, 10.0], [2.0, 10.0], [4.0, 15.0], [4.0, 20.0]])
    turned = np.exp(1j * np.radians([170.0, 180.0, 195.0, 200.0]))
    np.testing.assert_allclose(np.exp(1j * found.heading_rad), turned, atol=1e-12)
    assert found.velocity_mps is None
    for times, sentence in (([1.0, 4.1], r"t_s\[1\] = 4.1: outside"), ([np.nan], r"t_s\[0\] = nan: outside")):
        with pytest.raises(ValueError, match=sentence):
            data.at(times)


# ---- any bytes


@pytest.mark.fuzz
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(
        st.binary(max_size=200),
        st.lists(
            st.lists(
                st.sampled_from(
                    ["time_s", "tdoa_A_s", "sigma_A_s", "transmitter", "tdoa_s", "yaw_rate_dps", "gyro_x_dps", "0", "1",
                     "2", "1e308", "nan", "-inf", "", '"', "position_x_m", "position_y_m", "#"]
                ),
                min_size=1,
                max_size=4,
            ),
            max_size=6,
        ).map(lambda rows: "\n".join(",".join(row) for row in rows).encode()),
    )
)  # fmt: skip
def test_anything_is_read_or_refused(tmp_path, content):
    path = tmp_path / "any.csv"
    path.write_bytes(content)
    for read in (files.read_imu, files.read_tdoa, files.read_truth):
        for repair in (False, True):
            try:
                data = read(path, repair=repair)
            except files.RecordingError as error:
                assert str(error).startswith(str(path))
            else:
                assert np.isfinite(data.t_s).all()
                assert np.all(np.diff(data.t_s) > 0.0)
