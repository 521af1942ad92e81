"""Nodes files and scenarios: what fits, and the line that a mistake is reported on."""

import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from soopnav_cpp import config, scenarios

pytestmark = pytest.mark.unit

NODES = """\
# three nodes
[receiver]
height_m = 1.5

[[nodes]]
cell_id = 1
position_m = [0, 0.5, 10]
[[nodes]]
cell_id = 2
position_m = [
  100.0,  # east
  0.0,
  10.0,
]
antenna_height_m = 3.0
[[nodes]]
cell_id = 3
position_m = [0.0, 100.0, 10.0]
sigma_s = 1e-9
"""


def refusal(tmp_path, content, load=scenarios.load_nodes):
    path = tmp_path / "nodes.toml"
    path.write_text(content)
    with pytest.raises(config.ConfigError) as caught:
        load(path)
    return str(caught.value).replace(f"{path}:", "nodes.toml:")


def test_nodes(tmp_path):
    path = tmp_path / "nodes.toml"
    path.write_text(NODES)
    nodes = scenarios.load_nodes(path)
    assert [n.cell_id for n in nodes.nodes] == [1, 2, 3]
    assert nodes.nodes[0].position_m == (0.0, 0.5, 10.0)
    assert nodes.nodes[1].antenna_height_m == 3.0
    assert nodes.nodes[2].sigma_s == 1e-9
    assert nodes.receiver.height_m == 1.5
    assert not nodes.nodes[0].geodetic


def test_two_numbers_where_three_are_expected(tmp_path):
    assert (
        refusal(tmp_path, NODES.replace("[0.0, 100.0, 10.0]", "[0.0, 100.0]"))
        == "nodes.toml:18: nodes[2].position_m: three numbers expected, got two"
    )


MISTAKES = {
    "unknown key": ("cell_id = 3", "cell_id = 3\npostion = 1", "18: nodes[2].postion: unknown key; did you mean"),
    "unknown table": ("[receiver]", "[reciever]", "2: reciever: unknown key; did you mean receiver?"),
    "missing key": ("cell_id = 2", "", "8: nodes[1].cell_id: missing"),
    "bad text": ("sigma_s = 1e-9", 'sigma_s = "small"', "19: nodes[2].sigma_s: input should be a valid number"),
    "bad whole number": ("cell_id = 1", "cell_id = 1.5", "6: nodes[0].cell_id: input should be a valid integer"),
    "true is no number": ("cell_id = 1", "cell_id = true", "6: nodes[0].cell_id: input should be a valid integer"),
    "out of range": ("cell_id = 1", "cell_id = 504", "6: nodes[0].cell_id: input should be less than or equal to 503"),
    "not a number": ("0.5", "nan", "7: nodes[0].position_m[1]: input should be a finite number"),
    "a word in a multi-line list": (
        "  0.0,\n",
        '  "x",\n',
        "10: nodes[1].position_m: three numbers expected, got 'x' among them",
    ),
    "not a list": ("[0, 0.5, 10]", "3", "7: nodes[0].position_m: a list of three numbers expected"),
    "twice": ("cell_id = 2", "cell_id = 1", "5: nodes: cell_id 1 is given twice (nodes[0], nodes[1])"),
    "no position": (
        "position_m = [0, 0.5, 10]",
        "",
        "5: nodes[0]: a position is needed: position_m = [east, north, up], or latitude_deg and longitude_deg",
    ),
    "two positions": (
        "cell_id = 1",
        "cell_id = 1\nheight_m = 3",
        "5: nodes[0]: position_m or latitude_deg, longitude_deg and height_m, not both",
    ),
    "mixed": (
        "position_m = [0, 0.5, 10]",
        "latitude_deg = 1.0\nlongitude_deg = 2.0",
        "5: nodes: all positions in local metres or all geodetic, not both",
    ),
    "half a position": ("position_m = [0, 0.5, 10]", "latitude_deg = 1.0", "5: nodes[0]: a position is needed"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes(tmp_path, case):
    old, new, sentence = MISTAKES[case]
    assert old in NODES
    assert refusal(tmp_path, NODES.replace(old, new, 1)).startswith(f"nodes.toml:{sentence}")


def test_every_mistake_is_reported_in_order(tmp_path):
    text = NODES.replace("cell_id = 3", "cell_id = 900").replace("cell_id = 1", "cell_id = -1")
    lines = refusal(tmp_path, text).splitlines()
    assert [line.split(": ")[0] for line in lines] == ["nodes.toml:6", "nodes.toml:17"]


def test_what_is_not_toml(tmp_path):
    assert re.match(r"nodes\.toml:2: not TOML: ", refusal(tmp_path, "a = 1\nb = \n"))
    assert refusal(tmp_path, "a = 1\n\na = 2\n").startswith("nodes.toml:3: not TOML: Key")
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(config.ConfigError, match="not a text file; TOML expected"):
        scenarios.load_nodes(path)
    with pytest.raises(config.ConfigError, match=r"y\.toml: no such file or directory"):
        scenarios.load_nodes(tmp_path / "y.toml")


def test_an_empty_file(tmp_path):
    assert refusal(tmp_path, "") == "nodes.toml:1: nodes: missing"
    assert refusal(tmp_path, "nodes = []") == "nodes.toml:1: nodes: at least 1 needed, got 0"


SCENARIO = """\
[capture]
sample_rate_hz = 1.92e6
duration_s = 0.02
[receiver]
position_m = [0.0, 0.0, 0.0]
[[cells]]
cell_id = 7
n_rb = 6
position_m = [300.0, 0.0, 0.0]
"""


def test_scenario(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO)
    scenario = scenarios.load_lte_scenario(path)
    assert scenario.cells[0].n_ports == 1
    assert scenario.capture.snr_db is None
    tap = scenarios.Tap(delay_s=0.0, power_db=-20.0, phase_rad=0.0)
    assert tap.gain == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("n_rb = 6", "n_rb = 7", "8: cells[0].n_rb: input should be 6, 15, 25, 50, 75 or 100"),
        ("1.92e6", "-1.0", "2: capture.sample_rate_hz: input should be greater than or equal to 1400000"),
        ("duration_s = 0.02", "duration_s = 0", "3: capture.duration_s: input should be greater than 0"),
        ("[capture]", "[capture]\nformat = 'wav'", "2: capture.format: input should be 'cf32', 'ci16', 'ci8' or 'cu8'"),
        ("cell_id = 7", "cell_id = 7\ntaps = [{delay_s = -1.0, power_db = 0.0}]", "8: cells[0].taps[0].delay_s: input"),
        (
            "[receiver]",
            "[receiver]\nclock_error_ppm = 1.0",
            "1: receiver.clock_error_ppm needs capture",
        ),
    ],
)
def test_scenario_mistakes(tmp_path, old, new, sentence):
    message = refusal(tmp_path, SCENARIO.replace(old, new), scenarios.load_lte_scenario)
    assert message.startswith(f"nodes.toml:{sentence}")


@pytest.mark.fuzz
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    cut=st.integers(0, len(NODES)),
    insert=st.text(st.sampled_from("[]{}=\"'\n,.#ab1 -"), max_size=12),
    drop=st.integers(0, 12),
)
def test_any_edit_reads_or_is_refused_with_its_line(tmp_path, cut, insert, drop):
    path = tmp_path / "n.toml"
    path.write_text(NODES[:cut] + insert + NODES[cut + drop :])
    try:
        scenarios.load_nodes(path)
    except config.ConfigError as error:
        count = path.read_text().count("\n") + 2
        for line in str(error).splitlines():
            match = re.match(r".*n\.toml:(\d+): ", line)
            assert match or "n.toml: not TOML" in line
            if match:
                assert 1 <= int(match[1]) <= count
