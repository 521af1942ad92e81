"""Conditions on measured numbers, each with its words.

A condition on several numbers asks it of every one of them, unless it says otherwise. None of them holds for no number
or for one that is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

__all__ = [
    "Condition",
    "above",
    "at_least",
    "at_most",
    "band",
    "below",
    "condition",
    "falling",
    "matching",
    "near",
    "rising",
]

Test = Callable[[tuple[float, ...]], bool]


@dataclass(frozen=True)
class Condition:
    """What measured numbers have to meet.

    Attributes
    ----------
    words : str
        In words and numbers, as ``claims.json`` gives it.
    test : callable
        Of the numbers, which are finite and at least one.
    """

    words: str
    test: Test

    def holds(self, numbers: Sequence[float]) -> bool:
        """Whether `numbers` meet it."""
        values = tuple(float(value) for value in numbers)
        return bool(values) and all(math.isfinite(value) for value in values) and bool(self.test(values))


def _text(value: float, unit: str = "") -> str:
    return f"{value:.10g}{' ' if unit else ''}{unit}"


def band(low: float, high: float, unit: str = "") -> Condition:
    """Inside ``low … high``, the ends included."""
    if not low <= high:
        raise ValueError(f"band: low = {low} and high = {high}: low <= high expected")
    return Condition(f"{_text(low)} … {_text(high, unit)}", lambda m: all(low <= value <= high for value in m))


def at_most(limit: float, unit: str = "") -> Condition:
    """Not above `limit`."""
    return Condition(f"≤ {_text(limit, unit)}", lambda m: all(value <= limit for value in m))


def at_least(limit: float, unit: str = "") -> Condition:
    """Not below `limit`."""
    return Condition(f"≥ {_text(limit, unit)}", lambda m: all(value >= limit for value in m))


def below(limit: float, unit: str = "") -> Condition:
    """Below `limit`."""
    return Condition(f"< {_text(limit, unit)}", lambda m: all(value < limit for value in m))


def above(limit: float, unit: str = "") -> Condition:
    """Above `limit`."""
    return Condition(f"> {_text(limit, unit)}", lambda m: all(value > limit for value in m))


def near(expected: float, *, within: float, unit: str = "") -> Condition:
    """No further from `expected` than `within`."""
    if not within > 0.0:
        raise ValueError(f"near: within = {within}: a positive number expected")
    return Condition(
        f"{_text(expected)} ± {_text(within, unit)}", lambda m: all(abs(value - expected) <= within for value in m)
    )


def matching(expected: Sequence[float], *, decimals: int, unit: str = "") -> Condition:
    """One number for each of `expected`, the same when rounded to `decimals`."""
    wanted = tuple(float(value) for value in expected)
    if not wanted:
        raise ValueError("matching: at least one expected number")
    listed = ", ".join(f"{value:.{decimals}f}" for value in wanted)
    half = 0.5 * 10.0**-decimals * (1.0 + 1e-9)

    def test(m: tuple[float, ...]) -> bool:
        return len(m) == len(wanted) and all(abs(a - b) <= half for a, b in zip(m, wanted, strict=True))

    return Condition(f"{listed}{' ' if unit else ''}{unit} to {decimals} decimals", test)


def _ordered(name: str, words: str, by: float, factor: Callable[[float, float], bool]) -> Condition:
    if not by >= 1.0:
        raise ValueError(f"{name}: by = {by}: at least 1 expected")
    steps = f", each at least {_text(by)} times" if by > 1.0 else ""
    return Condition(words + steps, lambda m: len(m) > 1 and all(factor(a, b) for a, b in pairwise(m)))


def rising(by: float = 1.0) -> Condition:
    """Each number greater than the one before it, and at least `by` times as great; positive ones for `by` > 1."""
    return _ordered("rising", "rising", by, lambda a, b: b > a and (by == 1.0 or b >= by * a > 0.0))


def falling(by: float = 1.0) -> Condition:
    """Each number less than the one before it, which is at least `by` times as great; positive ones for `by` > 1."""
    return _ordered("falling", "falling", by, lambda a, b: b < a and (by == 1.0 or a >= by * b > 0.0))


def condition(words: str, test: Test) -> Condition:
    """Any other condition: `test` gets the tuple of all numbers, finite ones and at least one."""
    return Condition(words, test)
