"""Which source a characterisation is about: one that is known, or a new one.

The same kind and the same carrier within `CARRIER_TOLERANCE` (no transmitter's oscillator is further off) are needed.
Then the name decides, folded to what reads alike, unless the two places are more than `FAR_M` apart: pseudo-noise
offset 12 exists in every city. Signals that share place and carrier and differ by code (CDMA, LTE), or that move
(satellites), are told apart by name alone. Others are the same source also by place: within `NEAR_M` and within what
the two covariances allow.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["BY_PLACE", "CARRIER_TOLERANCE", "FAR_M", "NEAR_M", "AmbiguousError", "Known", "match", "name_key"]

CARRIER_TOLERANCE = 5e-6
FAR_M = 100e3
NEAR_M = 200.0
_GATE = 21.108  # chi-square of three degrees of freedom, 1e-4 above
BY_PLACE = frozenset({"ofdm", "fm", "other"})

_Array = npt.NDArray[np.float64]


class AmbiguousError(ValueError):
    """A name that sources at several places go by, and no position to choose by."""


@dataclass(frozen=True)
class Known:
    """A candidate: a source of the same kind and carrier, and whether it goes by the name."""

    source_id: int
    same_name: bool
    p_e_m: _Array | None
    covariance_m2: _Array | None


def name_key(name: str) -> str:
    """A name folded to what reads alike: NFKC, without case, blanks as one."""
    return " ".join(unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold()).split())[:400]


def match(kind: str, p_e_m: _Array | None, covariance_m2: _Array | None, known: list[Known]) -> int | None:
    """The source that is meant, or None for one that is not there yet.

    Parameters
    ----------
    kind : str
    p_e_m, covariance_m2 : ndarray, shapes (3,) and (3, 3), or None
        Where the characterisation has it.
    known : list of Known
        Sources of that kind and carrier, in the order they came.

    Raises
    ------
    AmbiguousError
        Without a position, for a name that is at several places.
    """

    def distance_m(candidate: Known) -> float:
        if p_e_m is None or candidate.p_e_m is None:
            return 0.0
        return float(np.linalg.norm(p_e_m - candidate.p_e_m))

    named = [c for c in known if c.same_name and distance_m(c) <= FAR_M]
    if p_e_m is None and sum(c.p_e_m is not None for c in named) > 1:
        raise AmbiguousError("position needed: several sources have this name")
    if named:
        return min(named, key=lambda c: (c.p_e_m is None, distance_m(c))).source_id
    if kind not in BY_PLACE or p_e_m is None or covariance_m2 is None:
        return None
    nearest: tuple[float, int] | None = None
    for candidate in known:
        if candidate.p_e_m is None or candidate.covariance_m2 is None or distance_m(candidate) > NEAR_M:
            continue
        apart = p_e_m - candidate.p_e_m
        d2 = float(apart @ np.linalg.solve(covariance_m2 + candidate.covariance_m2, apart))
        if d2 <= _GATE and (nearest is None or d2 < nearest[0]):
            nearest = d2, candidate.source_id
    return None if nearest is None else nearest[1]
