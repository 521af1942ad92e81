"""docs/two_receivers.md: its Python runs as it stands, its numbers of bounds are right, files and commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from soopnav_cpp import dsp
from soopnav_cpp.cli.app import cli

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/two_receivers.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_block_runs() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    scope: dict[str, object] = {}
    exec(compile(block, "docs/two_receivers.md", "exec"), scope)
    assert float(scope["error_m"]) < 60.0  # type: ignore[arg-type]
    assert abs(float(scope["offset_s"])) < 1e-6  # type: ignore[arg-type]


@pytest.mark.example
def test_bounds_of_the_table() -> None:
    (row,) = re.findall(r"Stein's bound is (\d+), (\d+), (\d+), (\d+) and (\d+) ns", PAGE)
    bounds = [1e9 * dsp.tdoa_fdoa_crlb(25e3, 0.09, snr_db).sigma_tdoa_s for snr_db in (0.0, 5.0, 10.0, 15.0, 20.0)]
    assert [float(x) for x in row] == pytest.approx(bounds, abs=0.6)


@pytest.mark.example
def test_links_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 6
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    files = re.findall(r"examples/[\w./]+\.(?:toml|py)", PAGE)
    assert files
    assert all((ROOT / name).exists() for name in files)
    for name in sorted(set(re.findall(r"soopnav (run|peer|passes|reproduce|caf|scan|synth pair)", PAGE))):
        assert CliRunner().invoke(cli, [*name.split(), "--help"]).exit_code == 0, name
