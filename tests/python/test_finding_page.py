"""docs/finding_a_source.md: its Python runs as it stands, its files and commands exist, its table holds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from soopnav_cpp import scenarios
from soopnav_cpp.scenarios import emitters
from soopnav_cpp.scenarios.execution import seed_of_run

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/finding_a_source.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_blocks_run() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    scope: dict[str, object] = {}
    exec(compile("\n".join(blocks), "docs/finding_a_source.md", "exec"), scope)
    assert "fix" in scope


@pytest.mark.example
def test_links_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 5
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    assert all((ROOT / name).exists() for name in re.findall(r"examples/[\w./]+", PAGE))
    from soopnav_cpp.cli.app import cli

    for name in re.findall(r"^\$ soopnav ([\w-]+)", PAGE, re.MULTILINE):
        assert CliRunner().invoke(cli, [name, "--help"]).exit_code == 0


@pytest.mark.example
def test_bearings_written_by_hand_are_read(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```\n(x_m,.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (tmp_path / "walk.csv").write_text(text, encoding="utf-8")
    from soopnav_cpp.scenarios.bearings import read_bearings

    emitter = emitters.solve("walk", read_bearings(tmp_path / "walk.csv"), ["ml"])
    assert emitter.found
    assert emitter.fix.cep_m < 100.0


@pytest.mark.example
def test_the_table_of_methods() -> None:
    """The first four drives of the hundred: every method is as near as the table says of its worst, and the order of
    the good, the geometric and the unweighted is the table's."""
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|", PAGE, re.MULTILINE)
    assert {row[0] for row in rows} == set(emitters.METHODS)
    system, scenario = scenarios.load(ROOT / "examples/scenarios/carter_drive.toml")
    from soopnav_cpp.scenarios import source_localization_pipeline as pipeline

    errors: dict[str, list[float]] = {name: [] for name in emitters.METHODS}
    for number in range(1, 5):
        seed = seed_of_run(scenario, number)
        heard = pipeline.hear(scenario, seed)
        emitter = emitters.solve("jammer", heard.data, emitters.METHODS, seed=seed, history=False, extras=False)
        for name in emitters.METHODS:
            errors[name].append(emitter.error_m(name))
    assert system.name == "source_localization"
    for name, _, _, worst in rows:
        assert max(errors[name]) <= float(worst) + 0.5, name
    mean = {name: float(np.mean(value)) for name, value in errors.items()}
    assert max(mean[name] for name in ("ml", "stansfield", "particle", "ekf_bank")) < mean["incenter"] < mean["linear"]
