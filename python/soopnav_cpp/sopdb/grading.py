"""The grade of a source by its age: the service's own, for its fast answers and for snapshots."""

from __future__ import annotations

import functools
import math
from datetime import datetime, timedelta, timezone

from soopnav_cpp.sopdb.fusion import Entry, answer_quality
from soopnav_cpp.sopdb.records import Characterization

__all__ = ["aged", "grade"]

_DAY_S = 86400.0
_MOST_DAYS = 400
_MOST_VOICES = 3  # more do not make it better
#: A contribution that holds when it came: a voice of `answer_quality`, of which only the time matters.
_SILENT = Characterization.model_construct(clock=None)
_ORIGIN = datetime(2000, 1, 1, tzinfo=timezone.utc)


@functools.cache
def _of_days(voices: int, days: int) -> str:
    entries = [Entry("", str(voice), _ORIGIN, _SILENT) for voice in range(voices)]
    return str(answer_quality(entries, _ORIGIN + timedelta(days=days))["grade"])


def grade(voices: int, age_s: float) -> str:
    """The grade of contributors whose newest word is so old."""
    return _of_days(min(voices, _MOST_VOICES), min(math.ceil(age_s / _DAY_S), _MOST_DAYS))


def aged(before: str, age_s: float) -> str:
    """A grade given earlier, once the newest word is so old: it can only fall."""
    return max(before, grade(_MOST_VOICES, age_s))
