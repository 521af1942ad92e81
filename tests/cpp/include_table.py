#!/usr/bin/env python3
"""Holds the modules' includes and link lines against the table of who may know whom.

    include_table.py CPP_DIRECTORY

Read are every `#include "soopnav/..."` below include/soopnav/<module> and src/<module>, and the USES of every
src/<module>/CMakeLists.txt. Each must be in `ALLOWED`, and an include must also be covered by the module's own USES
(links are transitive). What breaks the table is printed, one line each, and the exit code is then 1.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

# Module: floor, and the modules it may name in USES.
ALLOWED: dict[str, tuple[int, frozenset[str]]] = {
    "core": (1, frozenset()),
    "geometry": (2, frozenset({"core"})),
    "dsp": (2, frozenset({"core"})),
    "estimation": (2, frozenset({"core"})),
    "clock": (3, frozenset({"estimation"})),
    "process": (3, frozenset({"geometry"})),
    "waveform": (3, frozenset({"dsp"})),
    "array": (3, frozenset({"dsp", "geometry", "estimation"})),
    "measurement": (3, frozenset({"core", "geometry"})),
    "inertial": (3, frozenset({"geometry", "estimation"})),
    "vision": (3, frozenset({"geometry"})),
    "gnss": (4, frozenset({"geometry", "estimation", "measurement"})),
}
LOWER = frozenset(ALLOWED)
ALLOWED["simulation"] = (5, LOWER)
ALLOWED["navigation"] = (6, LOWER)

INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*[<"]soopnav/([^/">]+)[^">]*[">]', re.MULTILINE)
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
ADD_MODULE = re.compile(r"soopnav_add_module\(\s*(\w+)(.*?)\)", re.DOTALL)
KEYWORDS = ("SOURCES", "USES", "PUBLIC", "PRIVATE")


def closure(direct: dict[str, frozenset[str]], module: str) -> frozenset[str]:
    """Every module that `module` reaches over `direct`, itself left out unless there is a cycle."""
    reached: set[str] = set()
    todo = list(direct.get(module, ()))
    while todo:
        name = todo.pop()
        if name not in reached:
            reached.add(name)
            todo.extend(direct.get(name, ()))
    return frozenset(reached)


def declared_uses(text: str) -> dict[str, frozenset[str]]:
    """The USES of each soopnav_add_module() call in a CMakeLists.txt."""
    uses: dict[str, frozenset[str]] = {}
    for name, arguments in ADD_MODULE.findall(re.sub(r"#.*", "", text)):
        keyword, named = "", set()
        for word in arguments.split():
            if word in KEYWORDS:
                keyword = word
            elif keyword == "USES":
                named.add(word)
        uses[name] = frozenset(named)
    return uses


def violations(cpp: Path) -> list[str]:
    """What breaks the table in the tree `cpp`, as sentences; also when nothing is found to check."""
    problems: list[str] = []
    uses: dict[str, frozenset[str]] = {}
    for lists in sorted((cpp / "src").glob("*/CMakeLists.txt")):
        found = declared_uses(lists.read_text(encoding="utf-8"))
        where = lists.relative_to(cpp)
        if list(found) != [lists.parent.name]:
            problems.append(f"{where}: must add the module '{lists.parent.name}', adds {sorted(found)}")
        uses.update(found)
    if not uses:
        problems.append(f"{cpp}: no module found")

    allowed_direct = {name: row[1] for name, row in ALLOWED.items()}
    for module, named in sorted(uses.items()):
        if module not in ALLOWED:
            problems.append(f"{module}: not in the table of modules")
            continue
        floor = ALLOWED[module][0]
        permitted = closure(allowed_direct, module)
        for used in sorted(named):
            if used not in ALLOWED:
                problems.append(f"{module}: USES {used}, which is no module of the table")
            elif used not in permitted:
                problems.append(f"{module}: USES {used}, which the table does not permit")
            elif ALLOWED[used][0] >= floor:
                problems.append(f"{module}: USES {used}, which is not on a lower floor")

    files = 0
    for part in ("include/soopnav", "src"):
        for path in sorted((cpp / part).glob("*/**/*")):
            if path.suffix not in (".hpp", ".cpp") or not path.is_file():
                continue
            files += 1
            module = path.relative_to(cpp / part).parts[0]
            reachable = closure(uses, module) | {module}
            text = COMMENT.sub(lambda match: "\n" * match.group().count("\n"), path.read_text(encoding="utf-8"))
            for match in INCLUDE.finditer(text):
                if match.group(1) not in reachable:
                    line = text.count("\n", 0, match.start()) + 1
                    problems.append(
                        f"{path.relative_to(cpp)}:{line}: {module} includes {match.group(1)}, "
                        f"which its USES do not reach"
                    )
    if files == 0:
        problems.append(f"{cpp}: no source found")
    return problems


def main(arguments: list[str]) -> int:
    if len(arguments) != 1:
        print("usage: include_table.py CPP_DIRECTORY", file=sys.stderr)
        return 2
    problems = violations(Path(arguments[0]))
    print("\n".join(problems) if problems else "the includes keep to the table")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
