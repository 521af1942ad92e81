"""README.md's Python snippet runs as it stands, and its commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


@pytest.mark.example
def test_python_snippet(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (snippet,) = blocks("python")
    assert len([line for line in snippet.splitlines() if line.strip()]) <= 12
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "README.md", "exec"), {})
    east, north = map(float, re.findall(r"-?\d+\.\d+", capsys.readouterr().out)[:2])
    assert abs(east - 180.0) < 3.0
    assert abs(north + 120.0) < 3.0


@pytest.mark.example
def test_cpp_snippet_is_short() -> None:
    (snippet,) = blocks("cpp")
    assert len([line for line in snippet.splitlines() if line.strip()]) <= 16


@pytest.mark.example
def test_commands_and_links_exist() -> None:
    tools = re.findall(r"tools/\w+", README)
    assert tools
    links = [link for link in re.findall(r"\]\(([^)#:]+)\)", README) if not link.endswith(".png")]
    assert links
    for path in tools + links:
        assert (ROOT / path).exists(), path
