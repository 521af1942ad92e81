"""A wheel built from the checkout works in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    result = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=os.environ | environment, capture_output=True, text=True
    )
    assert result.returncode == 0, f"{command}:\n{result.stdout}\n{result.stderr}"
    return result.stdout


@pytest.mark.install
@pytest.mark.slow
def test_wheel(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    run(*pip, "wheel", "--no-build-isolation", "--no-deps", "--no-index", "-w", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert sum(name.startswith("soopnav_cpp/_core.") and name.endswith(".so") for name in names) == 1
    assert "soopnav_cpp/py.typed" in names
    assert any(name.startswith("soopnav_cpp/_core") and name.endswith(".pyi") for name in names)
    assert not [name for name in names if not name.startswith(("soopnav_cpp/", "soopnav-"))]

    run(sys.executable, "-m", "venv", tmp_path / "env", cwd=tmp_path)
    python = tmp_path / "env" / "bin" / "python"
    run(python, "-m", "pip", "--quiet", "install", "--no-deps", "--no-index", wheel, cwd=tmp_path)
    # The dependencies come from this environment; its editable soopnav does not, for a path reads no .pth files.
    dependencies = sysconfig.get_paths()["purelib"]
    program = "import soopnav_cpp as sn; print(sn._core.__file__, sn.lte.pss(0).shape, sn.__version__)"
    printed = run(python, "-c", program, cwd=tmp_path, PYTHONPATH=dependencies)
    assert str(tmp_path / "env") in printed
    assert "(62,)" in printed
    assert "locate" in run(tmp_path / "env" / "bin" / "soopnav", "--help", cwd=tmp_path, PYTHONPATH=dependencies)
