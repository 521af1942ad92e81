"""docs/estimation.md: its Python runs as it stands, one block after the other, and its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/estimation.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_blocks_run(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 5
    exec(compile("\n".join(blocks), "docs/estimation.md", "exec"), {})
    assert capsys.readouterr().out.startswith("P0: not positive semi-definite")


@pytest.mark.example
def test_links_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", PAGE)
    assert len(links) >= 7
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    for scenario in re.findall(r"soopnav observe ([\w./]+)", PAGE):
        assert scenario == "SCENARIO.toml" or (ROOT / scenario).exists()
