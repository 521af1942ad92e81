"""What a request may cost: how many of them, how long a body, how deep its JSON; and how a refusal reads."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import math
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import pydantic
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse

from soopnav_cpp.sopdb.settings import Rate

__all__ = ["Buckets", "RefusedError", "address_of", "read_json", "strict_json", "too_many", "validated"]

_M = TypeVar("_M", bound=pydantic.BaseModel)
_MOST_DIGITS = 400  # of a whole number: no more than a double holds


class RefusedError(Exception):
    """An answer other than the one asked for.

    Parameters
    ----------
    status : int
    detail : str
        A sentence.
    errors : list of (field, message), optional
    headers : dict, optional
    """

    def __init__(
        self,
        status: int,
        detail: str,
        errors: list[tuple[str, str]] | None = None,
        headers: dict[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.errors = errors or []
        self.headers = headers or {}

    def response(self) -> JSONResponse:
        """The answer: ``detail``, and ``errors`` by field."""
        body: dict[str, Any] = {"detail": self.detail}
        if self.errors:
            body["errors"] = [{"field": field, "message": message} for field, message in self.errors]
        return JSONResponse(body, self.status, {"Cache-Control": "no-store", **self.headers})

    @classmethod
    def of_fields(cls, errors: list[tuple[str, str]]) -> RefusedError:
        """422, naming the fields."""
        errors = errors[:20]
        field, message = errors[0]
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        return cls(422, f"{field}: {message}{more}" if field else f"{message}{more}", errors)


class Buckets:
    """Token buckets by key, in bounded memory.

    Parameters
    ----------
    rate : Rate
    most : int
        Keys remembered. The one not used for longest is forgotten first, and then has a full bucket again.
    clock : callable
        Seconds, never going back.
    """

    def __init__(self, rate: Rate, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._most = most
        self._clock = clock
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._left)

    def _level(self, key: str, now: float) -> float:
        level, at = self._left.get(key, (self._rate.burst, now))
        return min(self._rate.burst, level + (now - at) * self._rate.per_s)

    def take(self, key: str) -> float:
        """Zero, and one request is paid for; otherwise the seconds to wait, and nothing is."""
        now = self._clock()
        level = self._level(key, now)
        if level < 1.0:
            return (1.0 - level) / self._rate.per_s
        self._left[key] = level - 1.0, now
        self._left.move_to_end(key)
        if len(self._left) > self._most:
            self._left.popitem(last=False)
        return 0.0

    def wait_s(self, key: str) -> float:
        """The seconds until `take` would give zero; nothing is paid."""
        level = self._level(key, self._clock())
        return max(0.0, (1.0 - level) / self._rate.per_s)


def too_many(wait_s: float, whose: str) -> RefusedError:
    """429 with how long to wait."""
    wait = max(1, math.ceil(wait_s))
    return RefusedError(429, f"too many requests of this {whose}; wait {wait} s", headers={"Retry-After": str(wait)})


def address_of(request: Request) -> str:
    """The network address of a request; of IPv6 the /64, all of which one customer has."""
    host = "" if request.client is None else request.client.host
    try:
        found = ipaddress.ip_address(host)
    except ValueError:
        return host[:64] or "local"
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ipaddress.IPv6Network((int(found) >> 64 << 64, 64)))
    return str(found)


def _pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise RefusedError.of_fields([(twice[:100], "given twice")])
    return out


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MOST_DIGITS else math.copysign(math.inf, -1.0 if digits[0] == "-" else 1.0)


def _depth(value: Any) -> int:
    deepest = 0
    stack = [(value, 1)]
    while stack:
        one, depth = stack.pop()
        if isinstance(one, (dict, list)):
            deepest = max(deepest, depth)
            stack.extend((child, depth + 1) for child in (one.values() if isinstance(one, dict) else one))
    return deepest


def strict_json(raw: bytes, max_depth: int) -> Any:
    """The value of a JSON text.

    NaN and Infinity, numbers past a double's range among them, are let through for the field's own check to name.

    Raises
    ------
    RefusedError
        422 for text that is not UTF-8 or not JSON, names given twice, half characters, more nesting than `max_depth`.
    """
    try:
        value = json.loads(raw.decode("utf-8"), object_pairs_hook=_pairs, parse_int=_whole)
        deep = _depth(value) > max_depth
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    except RecursionError:
        deep = True
    except UnicodeError:
        raise RefusedError.of_fields([("", "the body must be text of whole UTF-8 characters")]) from None
    except ValueError as error:
        raise RefusedError.of_fields([("", f"the body must be JSON: {error}")]) from None
    if deep:
        raise RefusedError.of_fields([("", f"the body is nested deeper than {max_depth}")])
    return value


async def read_json(request: Request, *, max_bytes: int, max_depth: int, timeout_s: float) -> Any:
    """The JSON value of a request's body, refused while it is read when it is too long or too slow.

    Raises
    ------
    RefusedError
        408, 413, 415, and 422 as `strict_json`.
    """
    if request.headers.get("content-encoding", "").strip().lower() not in ("", "identity"):
        raise RefusedError(415, "Content-Encoding must be left out: bodies come as they are")
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise RefusedError(415, "Content-Type must be application/json")
    too_long = RefusedError(413, f"the body must not have more than {max_bytes} bytes", headers={"Connection": "close"})
    told = request.headers.get("content-length", "")
    if told.isascii() and told.isdigit() and (len(told) > 15 or int(told) > max_bytes):
        raise too_long
    chunks = bytearray()

    async def read() -> None:
        async for chunk in request.stream():
            chunks.extend(chunk)
            if len(chunks) > max_bytes:
                raise too_long

    try:
        await asyncio.wait_for(read(), timeout_s)
    except asyncio.TimeoutError:
        refusal = RefusedError(408, f"the body must arrive within {timeout_s:g} s", headers={"Connection": "close"})
        raise refusal from None
    except ClientDisconnect:
        raise RefusedError(400, "the body ended early") from None
    return strict_json(bytes(chunks), max_depth)


def _message(error: Any) -> str:
    text = str(error["msg"])
    return text.removeprefix("Value error, ")


def validated(model: type[_M], value: Any) -> _M:
    """`value` as a model.

    Raises
    ------
    RefusedError
        422 with each field that does not fit.
    """
    try:
        return model.model_validate(value)
    except pydantic.ValidationError as error:
        found = error.errors(include_url=False, include_context=False, include_input=False)
        raise RefusedError.of_fields(
            [(".".join(str(part) for part in one["loc"])[:100], _message(one)[:300]) for one in found]
        ) from None
