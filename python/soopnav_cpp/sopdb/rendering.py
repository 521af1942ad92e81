"""Sources as JSON text, fast: what does not change with time is written once.

`Rendered.at` gives the text of ``SourceState.moved(at).answer()`` with identity and quality, for times after the
state's own. A page holds hundreds of sources, and each is asked for at another time; so nothing but the clock's motion,
which is the engine's, goes through arrays.
"""

from __future__ import annotations

import json
import math
from datetime import datetime

import numpy as np

from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp.sopdb.fusion import (
    ASSUMED_NOISE,
    LN_WALK_PER_S,
    POSITION_WALK_M2PS,
    Estimate,
    SourceState,
)
from soopnav_cpp.sopdb.grading import grade
from soopnav_cpp.sopdb.store import FusedRow

__all__ = ["Rendered", "zulu"]

_MOST_LN_VARIANCE = 25.0


def zulu(at: datetime) -> str:
    """A time of UTC in ISO 8601."""
    return at.isoformat().replace("+00:00", "Z")


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


class _Grown:
    """A covariance that grows along its diagonal, as text."""

    def __init__(self, estimate: Estimate, per_s: float) -> None:
        P = estimate.covariance + 0.0  # no negative zeros
        n = len(P)
        self.diagonal: list[float] = np.diag(P).tolist()
        self._per_s = per_s
        rows = [[_text(P[i, j].item()) if i != j else "%r" for j in range(n)] for i in range(n)]
        self._form = "[" + ",".join("[" + ",".join(row) + "]" for row in rows) + "]"

    def at(self, dt_s: float) -> tuple[list[float], str]:
        """The diagonal after a time, and the matrix."""
        diagonal = [variance + self._per_s * dt_s for variance in self.diagonal]
        return diagonal, self._form % tuple(diagonal)


class Rendered:
    """A source that is asked for again and again.

    Parameters
    ----------
    row : FusedRow
    state : SourceState
        At the time of its newest contribution.
    contributions, voices : int
        Accepted ones, and how many contributors sent them.
    """

    def __init__(self, row: FusedRow, state: SourceState, contributions: int, voices: int) -> None:
        self.row = row
        self.state = state
        self.contributions = contributions
        self.voices = voices
        said = state.answer()
        identity = {"id": str(row.id), "kind": row.kind, "name": row.name, "carrier_hz": row.carrier_hz}
        self._identity = _text(identity)[:-1] + ","
        self._newest = f'"quality":{{"contributions":{contributions},"newest":"{zulu(state.at)}","age_s":'
        self._position: tuple[str, str, _Grown] | None = None
        if state.position is not None:
            place = said["position"]
            where = {name: place[name] for name in ("latitude_deg", "longitude_deg", "height_m")}
            head = f'"position":{{"p_e_m":{_text(place["p_e_m"])},"covariance_m2":'
            self._position = head, "," + _text(where)[1:-1], _Grown(state.position, POSITION_WALK_M2PS)
        self._noise: tuple[str, _Grown] | None = None
        if state.noise is not None:
            h = {name: said["noise"][name] for name in ("h0_s", "h_minus2_per_s")}
            head = f'"noise":{_text(h)[:-1]},"ln_covariance":'
            self._noise = head, _Grown(state.noise, LN_WALK_PER_S)

    def quality(self, at: datetime) -> str:
        """The part about quality; its time may be before the state's."""
        age_s = max(0.0, (at - self.state.at).total_seconds())
        return f'{self._newest}{age_s!r},"grade":"{grade(self.voices, age_s)}"}}'

    def at(self, at: datetime, text: str) -> str:
        """The source at a time that is not before the state's; `text` is that time's."""
        dt_s = (at - self.state.at).total_seconds()
        position = '"position":null'
        if self._position is not None:
            head, where, covariance = self._position
            variances, matrix = covariance.at(dt_s)
            sigma_m = math.sqrt(sum(variances) / 3.0)
            position = f'{head}{matrix}{where},"sigma_m":{sigma_m!r}}}'
        noise, h0, h_minus_2 = '"noise":null', ASSUMED_NOISE.h0, ASSUMED_NOISE.h_minus_2
        if self._noise is not None and self.state.noise is not None:
            head, covariance = self._noise
            variances, matrix = covariance.at(dt_s)
            noise = f"{head}{matrix}}}"
            h0, h_minus_2 = (
                math.exp(min(ln_h + 0.5 * min(variance, _MOST_LN_VARIANCE), 0.0))
                for ln_h, variance in zip(self.state.noise.value.tolist(), variances, strict=True)
            )
        clock = '"clock":null'
        if self.state.clock is not None:
            value, P = _navigation.sop_move_clock(*self.state.clock, h0=h0, h_minus_2=h_minus_2, dt_s=dt_s)
            (bias, drift), ((a, b), (c, d)) = value.tolist(), P.tolist()
            assumed = "true" if self._noise is None else "false"
            clock = (
                f'"clock":{{"epoch":"{text}","bias_s":{bias!r},"drift":{drift!r},'
                f'"covariance":[[{a!r},{b!r}],[{c!r},{d!r}]],"noise_assumed":{assumed}}}'
            )
        return f"{self._identity}{position},{clock},{noise},{self.quality(at)}}}"

    def of(self, state: SourceState) -> str:
        """The source in a state of an earlier time."""
        parts = _text(state.answer())[1:-1]
        return f"{self._identity}{parts},{self.quality(state.at)}}}"
