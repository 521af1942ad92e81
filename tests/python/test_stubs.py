"""The committed type stubs are those of the extension that is built."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def load_tool():
    spec = importlib.util.spec_from_file_location("make_stubs", ROOT / "tools" / "make_stubs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.unit
def test_stubs_are_not_stale(tmp_path):
    pytest.importorskip("pybind11_stubgen")
    made = load_tool().make(tmp_path)
    kept = ROOT / "python" / "soopnav_cpp" / "_core"
    assert sorted(p.name for p in made.iterdir()) == sorted(p.name for p in kept.iterdir())
    for path in made.iterdir():
        assert path.read_text() == (kept / path.name).read_text(), f"{path.name} is stale; run tools/stubs"


@pytest.mark.unit
def test_enumerations_are_written_as_a_type_checker_wants_them():
    stub = (
        "class A(enum.Enum):\n    ONE: typing.ClassVar[A]\n"
        "    @classmethod\n    def __new__(cls, value):\n        ...\n"
        "class B:\n    ONE: typing.ClassVar[A]\n"
    )
    assert load_tool().tidy(stub) == "class A(enum.Enum):\n    ONE = ...\nclass B:\n    ONE: typing.ClassVar[A]\n"
