"""docs/indoors_with_lte.md: its Python runs as it stands, its files, links and commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from soopnav_cpp.cli.app import cli

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/indoors_with_lte.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_block_runs() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    scope: dict[str, object] = {}
    exec(compile(block, "docs/indoors_with_lte.md", "exec"), scope)
    assert float(scope["error_m"]) < 1.5  # type: ignore[arg-type]


@pytest.mark.example
def test_links_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 6
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    files = re.findall(r"examples/[\w./]+\.(?:toml|py)", PAGE)
    assert files
    assert all((ROOT / name).exists() for name in files)
    for name in re.findall(r"soopnav (run|egomotion)", PAGE):
        assert CliRunner().invoke(cli, [name, "--help"]).exit_code == 0
