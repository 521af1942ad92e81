"""``soopnav observe``: what it prints, writes and refuses."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from soopnav_cpp.cli import observe as work
from soopnav_cpp.cli.app import cli

pytestmark = pytest.mark.unit

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "observe_room.toml"
PLAIN = """\
[measurement]
kind = "range"
sigma_m = 2.0
[[nodes]]
position_m = [0.0, 0.0]
[[nodes]]
position_m = [100.0, 0.0]
[track]
positions_m = [[0.0, 50.0]]
[unknown]
offset = ["x", "y"]
[map]
low_m = [10.0, 10.0]
high_m = [90.0, 60.0]
points = [5, 4]
"""


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, ["observe", *(str(a) for a in arguments)], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


def scenario(tmp_path, *changes, base=PLAIN):
    content = base
    for old, new in changes:
        assert old in content
        content = content.replace(old, new)
    path = tmp_path / "here.toml"
    path.write_text(content)
    return path


def test_prints_rank_deviations_and_the_map(tmp_path):
    picture = tmp_path / "room.png"
    lines = run(EXAMPLE, "--out", picture).stdout.splitlines()
    assert lines[0] == "observe_room.toml  4 nodes, 20 positions, 80 pseudoranges of σ 1 m"
    assert lines[1] == "rank 5 of 5"
    assert lines[2].split() == ["offset", "x", "σ", "1.067", "m"]
    assert lines[-2].startswith("map of offset x: σ 0.6895 … 1.529 m over 3321 starts")
    assert lines[-1] == f"map: {picture}"
    with Image.open(picture) as image:
        assert image.size[0] > 500
        assert len(np.unique(np.asarray(image.convert("L")))) > 50  # not blank


def test_by_hand(tmp_path):
    # Two ranges at right angles to each other, σ 2 m: from (50, 50) the nodes stand at ±45°.
    path = scenario(tmp_path, ("[[0.0, 50.0]]", "[[50.0, 50.0]]"))
    result = work.observe(path)
    np.testing.assert_allclose(result.bound.sigma, [2.0, 2.0], rtol=1e-12)
    assert result.sigma.shape == (4, 5)
    assert result.state == ("offset x", "offset y")
    # The map says at each start what the scenario would say there.
    there = work.observe(scenario(tmp_path, ("[[0.0, 50.0]]", f"[[{result.x_m[3]}, {result.y_m[1]}]]")))
    assert result.sigma[1, 3] == pytest.approx(math.hypot(*there.bound.sigma))


def test_json_and_default_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = json.loads(
        run(scenario(tmp_path, ("positions_m = [[0.0, 50.0]]", "positions_m = [[50.0, 0.0]]")), "--json").stdout
    )
    assert (tmp_path / "here.png").stat().st_size > 1000
    # On the line between the nodes the other axis cannot be seen.
    assert content["rank"] == 1
    assert content["unobservable"] == ["offset y"]
    assert content["sigma"] == {"offset x": pytest.approx(math.sqrt(2.0)), "offset y": None}
    assert content["units"] == {"offset x": "m", "offset y": "m"}
    assert content["map"]["x_m"] == [10.0, 30.0, 50.0, 70.0, 90.0]
    assert content["map"]["blank"] == 0


def test_names_what_cannot_be_seen(tmp_path):
    path = scenario(
        tmp_path, ('"range"', '"pseudorange"'), ('offset = ["x", "y"]', 'offset = ["x", "y"]\nbias = "separate"')
    )
    output = run(path, "--out", tmp_path / "a.png").stdout
    assert "rank 2 of 4" in output
    assert "offset x  cannot be told" in output
    assert "cannot be seen: " in output
    assert "cannot be told from any start" in output


def test_three_dimensions_heading_drift_and_angles(tmp_path):
    third = '[[nodes]]\nposition_m = [20.0, 90.0, 6.0]\nname = "north"\n[track]'
    track = "start_m = [30.0, 20.0, 1.0]\nstep_m = 3.0\ndirection_deg = 40.0\nclimb_deg = 5.0\ncount = 12"
    unknown = 'offset = ["x", "z"]\nstep = ["y"]\nheading = true\nbias = "common"\ndrift = "separate"'
    path = scenario(
        tmp_path,
        ("[0.0, 0.0]", "[0.0, 0.0, 9.0]"),
        ("[100.0, 0.0]", "[100.0, 0.0, 4.0]"),
        ("[track]", third),
        ("positions_m = [[0.0, 50.0]]", f"{track}\ninterval_s = 0.5"),
        ('"range"', '"pseudorange"'),
        ('offset = ["x", "y"]', unknown),
    )
    result = work.observe(path)
    names = ("offset x", "offset z", "step y", "heading", "bias", "drift 1", "drift 2", "drift north")
    assert result.bound.names == names
    assert result.bound.rank == 8
    assert result.positions_m[-1] == pytest.approx(
        [30 + 36 * math.cos(math.radians(40)) * math.cos(math.radians(5)),
         20 + 36 * math.sin(math.radians(40)) * math.cos(math.radians(5)), 1 + 36 * math.sin(math.radians(5))]
    )  # fmt: skip
    content = work.as_json(result)
    assert content["units"]["heading"] == "deg"
    assert content["units"]["drift 1"] == "m/s"
    assert content["sigma"]["heading"] == pytest.approx(math.degrees(result.bound.sigma[3]))


def test_range_differences_say_what_ranges_with_a_free_common_bias_at_each_place_say(tmp_path):
    # Differences to the first node with their full covariance lose nothing but the bias of each position.
    third = ("[track]", "[[nodes]]\nposition_m = [30.0, 80.0]\n[track]")
    differences = work.observe(scenario(tmp_path, third, ('"range"', '"range_difference"')))
    common = ('offset = ["x", "y"]', 'offset = ["x", "y"]\nbias = "common"')
    biased = work.observe(scenario(tmp_path, third, ('"range"', '"pseudorange"'), common))
    np.testing.assert_allclose(differences.bound.sigma, biased.bound.sigma[:2], rtol=1e-9)
    np.testing.assert_allclose(differences.sigma, biased.sigma, rtol=1e-9)


def test_bearings_have_degrees(tmp_path):
    path = scenario(
        tmp_path, ('"range"', '"bearing"'), ("sigma_m = 2.0", "sigma_deg = 2.0"), ("[[0.0, 50.0]]", "[[50.0, 50.0]]")
    )
    # Each bearing of σ 2° to a node at distance 50√2 m.
    sigma = math.radians(2.0) * 50.0 * math.sqrt(2.0)
    np.testing.assert_allclose(work.observe(path).bound.sigma, [sigma, sigma], rtol=1e-12)
    assert "2 bearings of σ 2°" in run(path, "--out", tmp_path / "a.png").stdout


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("sigma_m = 2.0", "sigma_m = 0.0", "measurement.sigma_m"),
        ("sigma_m = 2.0", "sigma_deg = 2.0", "a range has sigma_m, and not sigma_deg"),
        ("sigma_m = 2.0", "sigma_m = 2.0\nsigma = 1.0", "unknown key"),
        ('"range"', '"phase"', "measurement.kind"),
        ("[0.0, 0.0]", "[0.0]", "nodes[0].position_m: a list of two or three numbers expected"),
        ("[0.0, 0.0]", "[0.0, nan]", "nodes[0].position_m"),
        ("[0.0, 0.0]", "[0.0, 0.0, 0.0]", "all points have two coordinates, or all have three"),
        ("[100.0, 0.0]", '[100.0, 0.0]\nname = "1"', "nodes: each name once"),
        ("[[0.0, 50.0]]", "[]", "track.positions_m: at least 1 needed, got 0"),
        ("[[0.0, 50.0]]", "[[0.0, 50.0]]\ncount = 3", "either positions_m, or start_m"),
        ("positions_m = [[0.0, 50.0]]", "count = 3", "start_m, step_m and count needed"),
        ("[[0.0, 50.0]]", "[[0.0, 0.0]]", "the track leads over a node"),
        ('["x", "y"]', '["x", "z"]', "z and climb_deg need points of three coordinates"),
        ('["x", "y"]', '["x", "x"]', "offset: each axis once"),
        ('["x", "y"]', "[]", "nothing is unknown"),
        ('["x", "y"]', '["x"]\nbias = "common"', "a range has no bias"),
        ("[10.0, 10.0]", "[95.0, 10.0]", "low_m below high_m"),
        ("low_m = [10.0, 10.0]", "", "low_m and high_m together"),
        ("[5, 4]", "[1, 4]", "points: at least 2"),
        ("[5, 4]", "[5.0, 4]", "map.points: a list of two whole numbers expected"),
        ("[5, 4]", '[5, 4]\nstate = ["bias"]', "map.state: no unknown 'bias'; there are offset x, offset y"),
    ],
)
def test_refuses_in_a_sentence(tmp_path, old, new, sentence):
    error = run(scenario(tmp_path, (old, new)), "--out", tmp_path / "a.png", code=2).stderr
    assert sentence in error
    assert "Traceback" not in error
    assert not (tmp_path / "a.png").exists()


def test_refuses_other_files_and_pictures(tmp_path):
    assert "no such file" in run(tmp_path / "none.toml", code=2).stderr
    assert "a name that ends in .png expected" in run(EXAMPLE, "--out", tmp_path / "a.jpg", code=2).stderr
    mixed = scenario(
        tmp_path, ('["x", "y"]', '["x"]\nheading = true'), ("[5, 4]", '[5, 4]\nstate = ["offset x", "heading"]')
    )
    assert "have different units" in run(mixed, code=2).stderr
