"""The demo of examples/city.toml: five cells, one of them round a corner, and the receiver's position."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from soopnav_cpp.cli.app import cli

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.example
def test_city(tmp_path: Path) -> None:
    capture = tmp_path / "city.sigmf-meta"
    run("synth", "lte", EXAMPLES / "city.toml", capture)
    cells = json.loads(run("scan", capture, "--json"))["cells"]
    assert {(cell["cell_id"], cell["n_rb"], cell["n_ports"]) for cell in cells} == {
        (cell_id, 100, 2) for cell_id in (301, 45, 182, 412, 209)
    }
    # The receiver's crystal is 1.4 ppm slow, and its mixer runs on it.
    assert all(abs(cell["cfo_hz"] - 1.4e-6 * 1815.3e6) < 20.0 for cell in cells)

    out = tmp_path / "report"
    fix = json.loads(run("locate", capture, "--nodes", EXAMPLES / "city_nodes.toml", "--json", "--out", out))
    east_m, north_m, _ = fix["position_m"]
    assert math.hypot(east_m - 180.0, north_m + 120.0) < 3.0
    assert {cell["cell_id"]: cell["use"] for cell in fix["cells"]} == {
        301: "used",
        45: "used",
        182: "used",
        412: "used",
        209: "rejected",
    }
    assert (out / "report.html").stat().st_size > 10_000
