"""The keys of a scenario, written out as a commented TOML file from its pydantic model."""

from __future__ import annotations

import inspect
import json
import re
import textwrap
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
import pydantic
from pydantic_core import PydanticUndefined

__all__ = ["describe"]

_WIDTH = 110


def _documented(model: type[pydantic.BaseModel]) -> dict[str, str]:
    """What docstrings say about the keys, those of base classes included."""
    found: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        text = cls.__dict__.get("__doc__")
        if not (isinstance(cls, type) and issubclass(cls, pydantic.BaseModel)) or not text:
            continue
        _, _, section = inspect.cleandoc(text).partition("Attributes\n----------\n")
        names: list[str] = []
        for line in section.splitlines():
            head = re.match(r"([A-Za-z0-9_, ]+?) : ", line)
            if head:
                names = [name.strip() for name in head[1].split(",")]
            elif line.startswith("    "):
                for name in names:
                    found[name] = f"{found.get(name, '')} {line.strip()}".strip()
    return found


def _models(annotation: Any) -> Iterator[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        yield annotation
    else:
        for part in get_args(annotation):
            yield from _models(part)


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) in (list, tuple) or any(_is_list(part) for part in get_args(annotation))


def _bounds(metadata: Any) -> list[str]:
    words = []
    for item in metadata:
        for kind, sign in ((annotated_types.Gt, ">"), (annotated_types.Ge, "≥"), (annotated_types.Lt, "<"),
                           (annotated_types.Le, "≤")):  # fmt: skip
            if isinstance(item, kind):
                bound = getattr(item, kind.__name__.lower())
                words.append(f"{sign} {bound if isinstance(bound, int) and bound <= 1_000_000 else f'{bound:.6g}'}")
        words += _bounds(getattr(item, "metadata", ()))
    return words


def _kind(annotation: Any) -> str:
    """``number > 0``, ``"a" or "b"``, ``list of three numbers``."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return " ".join([_kind(parts[0]), ", ".join(_bounds(parts[1:]))]).strip()
    if origin is Literal:
        return " or ".join(json.dumps(value) for value in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(_kind(part) for part in parts if part is not type(None))
    if origin is list:
        return f"list of {_kind(parts[0])}"
    if origin is tuple:
        return f"list of {len(parts)}: {', '.join(_kind(part) for part in parts)}"
    words = {float: "number", int: "whole number", str: "text", bool: "true or false", dict: "table"}
    if annotation in words:
        return words[annotation]
    names = {"Path": "file name", "datetime": "date and time"}
    name = getattr(annotation, "__name__", str(annotation))
    return names.get(name, name)


def _value(default: Any) -> str:
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, (list, tuple)):
        return f"[{', '.join(_value(item) for item in default)}]"
    if isinstance(default, (int, float)):
        return repr(default)
    return json.dumps(str(default), ensure_ascii=False)


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(text.replace("``", ""), _WIDTH - 2)]


def _lines(model: type[pydantic.BaseModel], prefix: str, system: str) -> Iterator[str]:
    documented = _documented(model)
    tables = []
    for key, field in model.model_fields.items():
        inner = list(_models(field.annotation))
        words = field.description or documented.get(key, "")
        if inner:
            tables.append((key, field, inner, words))
            continue
        kind = _kind(field.annotation)
        bounds = ", ".join(_bounds(field.metadata))
        yield from _comment(f"{words} [{kind}{' ' if bounds else ''}{bounds}]".strip())
        if key == "system" and system and not prefix:
            yield f'system = "{system}"'
        elif field.is_required():
            yield f"{key} =              # needed"
        else:
            default = field.get_default(call_default_factory=True)
            yield f"#{key} =" if default is None or default is PydanticUndefined else f"#{key} = {_value(default)}"
    for key, field, inner, words in tables:
        name = f"{prefix}{key}"
        many = _is_list(field.annotation)
        for index, one in enumerate(inner):
            yield ""
            summary = inspect.cleandoc(one.__doc__ or "").split("\n")[0]
            need = "needed" if field.is_required() else "may be left out"
            other = "or: " if index else ""
            yield from _comment(f"{other}{words or summary} ({need}{', any number' if many else ''})")
            lines = [f"[[{name}]]" if many else f"[{name}]", *_lines(one, f"{name}.", "")]
            needed = field.is_required() and not index
            yield from lines if needed else (line if line[:1] in ("", "#") else f"#{line}" for line in lines)


def describe(model: type[pydantic.BaseModel], system: str = "") -> str:
    """Every key with its meaning, kind, bounds and default, in the form of the file itself.

    What may be left out is commented out without a space, keys with their default; tables come after plain keys, as
    TOML wants it.
    """
    head = "# What may be left out is commented out without a space, as #runs = 1; remove the # to set it."
    return "\n".join([head, "", *_lines(model, "", system)]) + "\n"
