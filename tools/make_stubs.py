"""Writes the stubs of soopnav_cpp._core below a folder: pybind11-stubgen's, with enumerations as type checkers want them.

Run by tools/stubs.
"""

from __future__ import annotations

import enum
import re
import subprocess
import sys
import types
from pathlib import Path

from soopnav_cpp import _core


def enumerations() -> dict[str, type[enum.Enum]]:
    """Every enumeration of the extension's modules, by name."""
    return {
        name: thing
        for module in vars(_core).values()
        if isinstance(module, types.ModuleType)
        for name, thing in vars(module).items()
        if isinstance(thing, type) and issubclass(thing, enum.Enum)
    }


def with_members(stub: str, enums: dict[str, type[enum.Enum]]) -> str:
    """`stub` with the enumerations' members as assignments, and without the constructor that stubgen sees."""
    for name, enumeration in enums.items():
        for member in enumeration:
            stub = re.sub(
                rf"^(    {member.name}): typing\.ClassVar\[{name}\].*$",
                rf"\1 = {member.value!r}",
                stub,
                flags=re.MULTILINE,
            )
    return re.sub(r"^    @classmethod\n    def __new__\(cls, value\):\s+\.\.\.\n", "", stub, flags=re.MULTILINE)


def main(folder: Path) -> int:
    """Write the stubs below `folder`; the exit code is stubgen's."""
    enums = enumerations()
    locations = [f"--enum-class-locations={name}:{thing.__module__}" for name, thing in enums.items()]
    generator = Path(sys.executable).with_name("pybind11-stubgen")
    made = subprocess.run(
        [generator, "--exit-code", "--output-dir", folder, *locations, "soopnav_cpp._core"],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if made.returncode != 0:
        print(made.stderr, file=sys.stderr)
        return made.returncode
    for stub in folder.rglob("*.pyi"):
        stub.write_text(with_members(stub.read_text(encoding="utf-8"), enums), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
