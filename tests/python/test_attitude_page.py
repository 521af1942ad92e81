"""docs/attitude.md: its Python runs as it stands, its numbers come out, its links lead somewhere."""

from __future__ import annotations

import re
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
CAPTURE = ROOT.parent / "shared" / "captures" / "gnss_baseline_1m"
PAGE = (ROOT / "docs/attitude.md").read_text(encoding="utf-8")


@pytest.mark.example
def test_python_blocks_run() -> None:
    blocks = re.findall(r"(<!-- files -->\n)?^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 5
    names: dict[str, object] = {}
    exec(compile("\n".join(block for files, block in blocks if not files), "docs/attitude.md", "exec"), names)
    np.testing.assert_array_equal(names["fixed"], [[5, 3, 4], [6, 4, 4]])
    np.testing.assert_allclose(names["squared_norms"], [0.218, 0.307], atol=1e-3)  # type: ignore[arg-type]
    run = names["run"]
    assert 0.7 < run.nis.mean() / run.rows.mean() < 1.3  # type: ignore[attr-defined]
    assert np.abs(run.euler_rad[-1]).max() < 0.02  # type: ignore[attr-defined]


@pytest.mark.example
@pytest.mark.offair
@pytest.mark.skipif(not CAPTURE.exists(), reason="the recording ../shared/captures/gnss_baseline_1m is not here")
@pytest.mark.skipif(find_spec("georinex") is None, reason="georinex is not installed: the extra gnss brings it")
def test_the_example_reads_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = spec_from_file_location("gnss_compass", ROOT / "examples/gnss_compass.py")
    assert spec is not None
    assert spec.loader is not None
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    short = []  # the first 40 epochs
    for name in ("rover.obs", "base.obs"):
        text = (CAPTURE / name).read_text()
        short.append(tmp_path / name)
        short[-1].write_text("\n>".join(text.split("\n>")[:41]) + "\n")
    run = example.analyse(*short, CAPTURE / "base.nav", 0.990, tmp_path / "compass.png")
    assert run.fixed.mean() > 0.95
    assert np.rad2deg(np.median(run.heading_rad[run.fixed])) == pytest.approx(193.03, abs=0.3)
    assert "fixed" in capsys.readouterr().out
    assert (tmp_path / "compass.png").stat().st_size > 10_000


@pytest.mark.example
def test_links() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", PAGE)
    assert links
    assert not [link for link in links if not (ROOT / "docs" / link).exists()]
