"""docs/ofdm_inertial.md: its Python runs as it stands, its C++ is of the example, its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/ofdm_inertial.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_blocks_run() -> None:
    pytest.importorskip("matplotlib")
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    scope: dict[str, object] = {}
    exec(compile("\n".join(blocks), "docs/ofdm_inertial.md", "exec"), scope)
    assert len(scope["figure"].axes) == 2  # type: ignore[attr-defined]


@pytest.mark.example
def test_the_user_needs_no_more_lines_than_promised() -> None:
    assert "run = sn.navigation.OfdmInertialNavigator(transmitters_m, start).run(imu=imu, tdoa=tdoa)\n" in PAGE
    assert "sn.plotting.errors(run, truth)\n" in PAGE


@pytest.mark.example
def test_the_cpp_block_is_of_the_example() -> None:
    (block,) = re.findall(r"^```cpp\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    example = re.sub(r"\s+", "", (ROOT / "examples/ofdm_inertial.cpp").read_text(encoding="utf-8"))
    for call in (
        "navigation::OfdmInertialNavigator navigator(",
        "{.imu = {.gyro_sigma_radps = 0.1, .accelerometer_sigma_mps2 = 0.1}, .ambiguity_m = numerology.ambiguity_m()}",
        "navigator.predict(0, imu[i].sample, 1.0 / kImuHz)",
        "navigator.update(epoch, reports)",
        "navigator.state()(kPlanarPosition)",
    ):
        assert re.sub(r"\s+", "", call) in example
        assert re.sub(r"\s+", "", call) in re.sub(r"\s+", "", block)


@pytest.mark.example
def test_links_and_commands() -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 7
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    scenarios = re.findall(r"soopnav run ([\w./]+\.toml)", PAGE)
    assert scenarios
    assert all((ROOT / scenario).exists() for scenario in scenarios)


@pytest.mark.example
def test_the_table_of_the_gallery_is_whole() -> None:
    """docs/scenarios.md names every scenario of the gallery, with its title."""
    page = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
    for path in sorted((ROOT / "examples/scenarios").glob("*.toml")):
        (title,) = re.findall(r'^title = "(.*)"', path.read_text(encoding="utf-8"), re.MULTILINE)
        assert f"[{path.stem}](../examples/scenarios/{path.name}) | {title} |" in page
