"""What a request asks for, from its query and headers: places, times, pages, what the asker has already."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from datetime import datetime, timedelta, timezone

from soopnav_cpp.sopdb.limits import RefusedError
from soopnav_cpp.sopdb.records import utc
from soopnav_cpp.sopdb.spatial import Box
from soopnav_cpp.sopdb.store import Search

__all__ = ["box", "cursor", "idempotency_key", "matches", "name", "near", "read_before", "read_cursor", "time"]

_EARLIEST = datetime(1980, 1, 6, tzinfo=timezone.utc)
_MOST_ID = 2**63 - 1
_TAG = re.compile(r'(?:W/)?"[\x21\x23-\x7e\x80-\xff]*"')
_KEY = re.compile(r"[\x21-\x7e]{1,200}")


def _refuse(field: str, message: str) -> RefusedError:
    return RefusedError.of_fields([(field, message)])


def _numbers(field: str, text: str, expected: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)) or "_" in text:
        raise _refuse(field, f"{expected} in degrees expected")
    return numbers


def near(text: str | None) -> tuple[float, float] | None:
    """``LAT,LON``."""
    if text is None:
        return None
    latitude, longitude = _numbers("near", text, "LAT,LON", 2)
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise _refuse("near", "a latitude in [-90, 90] and a longitude in [-180, 180] expected")
    return latitude, longitude


def box(text: str | None) -> Box | None:
    """``WEST,SOUTH,EAST,NORTH``, the order of GeoJSON."""
    if text is None:
        return None
    west, south, east, north = _numbers("bbox", text, "WEST,SOUTH,EAST,NORTH", 4)
    if max(abs(west), abs(east)) > 180.0 or not -90.0 <= south <= north <= 90.0:
        raise _refuse("bbox", "longitudes in [-180, 180] and -90 <= SOUTH <= NORTH <= 90 expected")
    return Box(south, north, west, east)


def name(text: str | None) -> str | None:
    """Part of a name."""
    if text is None or text.isprintable():
        return text
    raise _refuse("name", "text without control characters expected")


def time(text: str | None, max_ahead_s: float) -> datetime | None:
    """``at``: between the beginning of GPS time and `max_ahead_s` from now."""
    if text is None:
        return None
    try:
        at = utc(text.replace(" ", "+") if text.count(" ") == 1 and "T" in text else text)
    except ValueError as error:
        raise _refuse("at", str(error)) from None
    if at < _EARLIEST:
        raise _refuse("at", "a time after 1980-01-06 expected")
    if at > datetime.now(timezone.utc) + timedelta(seconds=max_ahead_s):
        raise _refuse("at", f"a time not more than {max_ahead_s / 86400.0:g} days ahead expected")
    return at


def idempotency_key(text: str | None) -> str | None:
    """1 to 200 visible characters of ASCII."""
    if text is None or _KEY.fullmatch(text):
        return text
    raise _refuse("Idempotency-Key", "1 to 200 visible ASCII characters expected")


def matches(said: str | None, etag: str) -> bool:
    """Whether ``If-None-Match`` names an ETag, compared weakly (RFC 9110, section 13.1.2)."""
    if said is None:
        return False
    if said.strip() == "*":
        return True
    return any(tag.removeprefix("W/") == etag.removeprefix("W/") for tag in _TAG.findall(said))


def _of(search: Search) -> str:
    return hashlib.sha256(repr(search).encode()).hexdigest()[:8]


def cursor(end: tuple[float, int], search: Search) -> str:
    """Where the next page of a search begins, as text that only this service reads."""
    text = json.dumps([*end, _of(search)], separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def _decoded(text: str) -> object:
    try:
        return json.loads(base64.urlsafe_b64decode(text.encode("ascii") + b"=" * (-len(text) % 4)))
    except (ValueError, RecursionError):
        return None


def _is_id(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _MOST_ID


def read_cursor(text: str | None, search: Search) -> tuple[float, int] | None:
    """What `cursor` wrote, for the same search."""
    if text is None:
        return None
    match _decoded(text):
        case [float(distance), int(last), str(of)] if math.isfinite(distance) and _is_id(last) and of == _of(search):
            return distance, last
    raise _refuse("cursor", "the next_cursor of a page of the same search expected")


def before_cursor(last: int) -> str:
    """Where the next page of a list that begins with the newest begins."""
    return base64.urlsafe_b64encode(json.dumps([last]).encode()).decode().rstrip("=")


def read_before(text: str | None) -> int:
    """What `before_cursor` wrote; past every id without one."""
    if text is None:
        return _MOST_ID
    match _decoded(text):
        case [int(last)] if _is_id(last):
            return last
    raise _refuse("cursor", "the next_cursor of the page before expected")
