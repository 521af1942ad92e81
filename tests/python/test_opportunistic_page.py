"""docs/opportunistic_navigation.md: its Python runs as it stands, its files, links and commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp import experiments
from soopnav_cpp.cli.app import cli

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/opportunistic_navigation.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_block_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    scope: dict[str, object] = {}
    exec(compile(block, "docs/opportunistic_navigation.md", "exec"), scope)
    error_s = np.asarray(scope["error_s"])
    assert np.std(error_s[:600]) < 1e-9
    assert np.abs(np.asarray(scope["cycles"])).max() < 0.5
    assert "tower clock bias" in capsys.readouterr().out


@pytest.mark.example
def test_links_files_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 10
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    assert all((ROOT / name).exists() for name in re.findall(r"examples/[\w./]+\.(?:toml|py)", PAGE))
    for name in sorted(set(re.findall(r"soopnav (run|gnss|reproduce|sopdb|bench)", PAGE))):
        assert CliRunner().invoke(cli, [name, "--help"]).exit_code == 0, name
    named = set(re.findall(r"pesyna-[a-z0-9]+", PAGE))
    assert named <= {item.id for item in experiments.load().all()}
