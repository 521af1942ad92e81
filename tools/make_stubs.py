"""Writes the type stubs of the extension, as they are committed, to a folder: make_stubs.py FOLDER."""

import re
import subprocess
import sys
import sysconfig
from pathlib import Path

MODULE = "soopnav_cpp._core"

# Enumerations of Python's enum module: their members as the typing specification wants them in a stub.
MEMBER = re.compile(r"^(    [A-Z][A-Z0-9_]*): typing\.ClassVar\[\w+\].*$", re.MULTILINE)
NEW = re.compile(r"^    @(?:classmethod|staticmethod)\n    def __new__\(.*\n        \.\.\.\n", re.MULTILINE)


def tidy(stub: str) -> str:
    """The stub with enumerations that a type checker takes."""
    classes = re.split(r"(?m)^(?=class )", stub)
    return "".join(
        NEW.sub("", MEMBER.sub(r"\1 = ...", text)) if re.match(r"class \w+\(enum\.", text) else text for text in classes
    )


def make(folder: Path) -> Path:
    """Writes the stubs below `folder`; returns the package's folder there."""
    generate = ["--exit-code", "--output-dir", str(folder), "--numpy-array-use-type-var", MODULE]
    subprocess.run([sys.executable, "-m", "pybind11_stubgen", *generate], check=True, stdout=subprocess.DEVNULL)
    for path in folder.rglob("*.pyi"):
        path.write_text(tidy(path.read_text()))
    ruff = Path(sysconfig.get_path("scripts"), "ruff")
    subprocess.run([ruff, "format", "--quiet", "--isolated", "--line-length", "120", str(folder)], check=True)
    return folder.joinpath(*MODULE.split("."))


if __name__ == "__main__":
    make(Path(sys.argv[1]))
