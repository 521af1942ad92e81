"""TOML files checked by pydantic: unknown keys are refused, and an error points at its line.

A file that does not fit is refused in one sentence per mistake::

    nodes.toml:14: nodes[2].position_m: three numbers expected, got two
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic
import tomlkit
import tomlkit.exceptions

__all__ = ["ConfigError", "InputFile", "Model", "Vector3", "load_toml"]

_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_Location = tuple[int | str, ...]


class ConfigError(ValueError):
    """A configuration file does not fit; the message has a line ``FILE:LINE: KEY: RULE`` for each mistake."""


class Model(pydantic.BaseModel):
    """Base of everything read from TOML: no unknown keys, no NaN, no values of another type, immutable."""

    model_config = pydantic.ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, hide_input_in_errors=True
    )


def _count(number: int) -> str:
    return _WORDS[number] if number < len(_WORDS) else str(number)


def _three_numbers(value: object) -> tuple[float, float, float]:
    if not isinstance(value, list):
        raise ValueError("a list of three numbers expected")
    if len(value) != 3:
        raise ValueError(f"three numbers expected, got {_count(len(value))}")
    for item in value:
        if isinstance(item, bool) or not isinstance(item, (int, float)):
            raise ValueError(f"three numbers expected, got {item!r} among them")
    return (float(value[0]), float(value[1]), float(value[2]))


#: Three finite numbers.
Vector3 = Annotated[tuple[float, float, float], pydantic.BeforeValidator(_three_numbers)]


def _input_file(value: object, info: pydantic.ValidationInfo) -> Path:
    """The path as seen from the file that names it."""
    if not isinstance(value, (str, Path)):
        raise ValueError("the name of a file expected")
    path = Path((info.context or {}).get("folder", "."), value)
    if not path.is_file():
        raise ValueError(f"{path}: {'a folder; a file expected' if path.is_dir() else 'no such file'}")
    return path


#: A file that exists; a relative name counts from the folder of the TOML file in which it stands.
InputFile = Annotated[Path, pydantic.BeforeValidator(_input_file)]

_ModelT = TypeVar("_ModelT", bound=pydantic.BaseModel)


def load_toml(path: Path, model: type[_ModelT]) -> _ModelT:
    """Read a TOML file into `model`.

    Raises
    ------
    ConfigError
        When the file is missing, not TOML, or does not fit the model: every mistake with file, line, key and rule.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a text file; TOML expected") from error
    except OSError as error:
        raise ConfigError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from error
    try:
        content = tomlkit.parse(text).unwrap()
    except tomlkit.exceptions.ParseError as error:
        reason = str(error).split(" at line ")[0]
        raise ConfigError(f"{path}:{error.line}: not TOML: {reason}") from error
    except (tomlkit.exceptions.TOMLKitError, RecursionError) as error:
        raise ConfigError(f"{path}:{_line_of_failure(text, type(error))}: not TOML: {error}") from error
    try:
        return model.model_validate(content, context={"folder": path.parent})
    except pydantic.ValidationError as error:
        lines = []
        for detail in error.errors(include_url=False):
            location = _in_file(detail["loc"], content)
            line = _line_of(text, location)
            lines.append((line, f"{path}:{line}: {_dotted(detail['loc'])}{_sentence(detail, model)}"))
        raise ConfigError("\n".join(text for _, text in sorted(lines))) from error


def _dotted(location: _Location) -> str:
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return f"{text}: " if text else ""


def _sentence(detail: Any, model: type[pydantic.BaseModel]) -> str:
    kind, message, context = detail["type"], str(detail["msg"]), detail.get("ctx", {})
    if kind == "missing":
        return "missing"
    if kind == "extra_forbidden":
        key = str(detail["loc"][-1])
        near = difflib.get_close_matches(key, [k for k in _keys(model) if k != key], n=1)
        return "unknown key" + (f"; did you mean {near[0]}?" if near else "")
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    if kind in ("too_short", "too_long"):
        bound = context.get("min_length", context.get("max_length"))
        return f"{'at least' if kind == 'too_short' else 'at most'} {bound} needed, got {context['actual_length']}"
    return message[0].lower() + message[1:]


def _keys(model: type[pydantic.BaseModel]) -> list[str]:
    """Every key that may stand anywhere in the file."""
    found: list[str] = []
    queue: list[Any] = [model]
    while queue:
        kind = queue.pop()
        if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel):
            for name, field in kind.model_fields.items():
                found.append(name)
                queue.append(field.annotation)
        else:
            queue.extend(getattr(kind, "__args__", ()))
    return found


def _holds(content: object, location: Sequence[int | str]) -> bool:
    for part in location:
        try:
            content = content[part]  # type: ignore[index]  # what cannot be indexed says so
        except (TypeError, KeyError, IndexError):
            return False
    return True


def _in_file(location: _Location, content: object) -> _Location:
    """The longest part of `location` that the file has: the place to point at when a key is missing."""
    end = len(location)
    while end and not _holds(content, location[:end]):
        end -= 1
    return location[:end]


def _line_of_failure(text: str, kind: type[Exception]) -> int:
    """Line (from 1) that makes the text so far fail with an exception of this kind."""
    lines = text.splitlines(keepends=True)
    for count in range(1, len(lines) + 1):
        try:
            tomlkit.parse("".join(lines[:count]))
        except kind:
            return count
        except tomlkit.exceptions.TOMLKitError:
            continue
    return max(1, len(lines))


def _line_of(text: str, location: _Location) -> int:
    """Line (from 1) where the key at `location` is set.

    A prefix of the file that ends between two statements is TOML itself, so the parser says where each statement ends:
    the key's line follows the longest prefix without it.
    """
    lines = text.splitlines(keepends=True)

    def prefix(count: int) -> tuple[int, object]:
        """The first statement border at or after `count` lines, and what the file says up to it."""
        for end in range(count, len(lines)):
            try:
                return end, tomlkit.parse("".join(lines[:end])).unwrap()
            except tomlkit.exceptions.TOMLKitError:
                continue
        return len(lines), tomlkit.parse(text).unwrap()

    if not location:
        return 1
    low, high = 0, len(lines)  # the key is absent up to the border `low`, present up to the border `high`
    while True:
        middle = (low + high) // 2
        if middle <= low:
            return low + 1
        end, content = prefix(middle)
        if _holds(content, location):
            high = middle
        else:
            low = end
