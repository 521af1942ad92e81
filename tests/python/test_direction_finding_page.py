"""docs/direction_finding.md: its Python runs as it stands, its C++ is of the example, its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/direction_finding.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_blocks_run() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert blocks
    scope: dict[str, object] = {}
    exec(compile("\n".join(blocks), "docs/direction_finding.md", "exec"), scope)
    sigma = np.asarray(scope["sigma_rad"])
    assert abs(float(scope["azimuth_rad"]) - np.deg2rad(30.0)) < 4.5 * sigma[0]  # type: ignore[arg-type]
    assert abs(float(scope["elevation_rad"]) - np.deg2rad(50.0)) < 4.5 * sigma[1]  # type: ignore[arg-type]
    assert sigma.max() < 0.02


@pytest.mark.example
def test_toml_block_is_read(tmp_path: Path) -> None:
    pytest.importorskip("tomlkit")
    import soopnav_cpp as sn

    (block,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (tmp_path / "roof.toml").write_text(block, encoding="utf-8")
    sn.array.Manifold(sn.array.ArrayGeometry.planar(2, 2, 0.2)).save(tmp_path / "roof.csv")
    manifold = sn.array.load_array(tmp_path / "roof.toml")
    assert manifold.geometry.name == "roof"
    assert not manifold.ideal


@pytest.mark.example
def test_the_cpp_block_is_of_the_example() -> None:
    (block,) = re.findall(r"^```cpp\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    example = re.sub(r"\s+", "", (ROOT / "examples/direction_finding.cpp").read_text(encoding="utf-8"))
    for call in (
        "std::make_shared<const array::SteeringTable>(array::Manifold(array::ArrayGeometry::planar(2, 2, 0.2)))",
        "array::DirectionFinder finder(table, {array::DirectionMethod::kMusic, 1})",
        "const array::Bearings found = finder.estimate({samples, 4, 2500, 2500})",
        "found.status",
        "found.sources[0]",
    ):
        assert re.sub(r"\s+", "", call) in example
        assert re.sub(r"\s+", "", call) in re.sub(r"\s+", "", block)


@pytest.mark.example
def test_links_and_names() -> None:
    import soopnav_cpp as sn

    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", PAGE)
    assert len(links) >= 3
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
    for name in re.findall(r"`(\w+)`(?:, `\w+`)* \|", PAGE):
        assert hasattr(sn.array, name), name
