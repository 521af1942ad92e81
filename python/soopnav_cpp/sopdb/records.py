"""What a characterisation may say: the body of ``POST /v1/characterizations``, each limit with its reason.

A characterisation is what a receiver learnt about one source: where it stands, how its clock stood at an epoch, and how
that clock wanders (pesyna section II-B). Units are in the names; positions are ECEF; a clock offset is positive when
the source's clock is ahead of system time.

`Characterization` refuses what cannot be a characterisation. What can be one and is hard to believe is accepted here
and quarantined by `soopnav_cpp.sopdb.fusion`.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pydantic

__all__ = [
    "KINDS",
    "MAX_SKEW_S",
    "METHODS",
    "STORED",
    "SYMMETRY",
    "AnsweredSource",
    "Characterization",
    "Clock",
    "Noise",
    "Position",
    "Provenance",
    "Quality",
    "Source",
    "utc",
]

Kind = Literal["cdma", "gps", "iridium", "lte", "ofdm", "fm", "other"]
Method = Literal["innovation_likelihood", "iteration", "multiple_model", "manual"]
KINDS: tuple[str, ...] = get_args(Kind)
METHODS: tuple[str, ...] = get_args(Method)
#: A covariance may differ from its transpose, and its correlation matrix have a negative eigenvalue, by this much.
SYMMETRY = 1e-9
#: How far an epoch may lie ahead of this computer's clock.
MAX_SKEW_S = 30.0
#: Validation context of what was taken in before: this computer's clock may have gone back since.
STORED: dict[str, Any] = {"stored": True}
_EARLIEST = datetime(1980, 1, 6, tzinfo=timezone.utc)  # GPS time's own beginning
_LEAST_RADIUS_M = 6.2e6  # below the deepest of the sea floor by a hundred kilometres
_MOST_RADIUS_M = 5e7  # past geostationary satellites
_MOST_CHARACTERS = 100


def utc(value: object) -> datetime:
    """A time of UTC, to the microsecond, from ISO 8601 text with its zone, or from an aware ``datetime``.

    Raises
    ------
    ValueError
        For anything else, and for text without a zone: it could mean any.
    """
    if isinstance(value, str):
        if len(value) > 40:
            raise ValueError("a time of ISO 8601 expected")
        text = value[:-1] + "+00:00" if value.endswith(("Z", "z")) else value
        try:
            value = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError("a time of ISO 8601 expected, such as 2026-03-01T12:00:00Z") from None
    if not isinstance(value, datetime):
        raise ValueError("a time of ISO 8601 expected, such as 2026-03-01T12:00:00Z")
    if value.tzinfo is None:
        raise ValueError("a time with its zone expected, such as 2026-03-01T12:00:00Z")
    try:
        return value.astimezone(timezone.utc)
    except (OverflowError, ValueError):
        raise ValueError("a time between the years 1 and 9999 expected") from None


def _text(value: str) -> str:
    value = unicodedata.normalize("NFC", value).strip()
    if not value:
        raise ValueError("text expected, not only blanks")
    if len(value) > _MOST_CHARACTERS:  # some characters are longer in this form
        raise ValueError(f"at most {_MOST_CHARACTERS} characters of normal form NFC expected, got {len(value)}")
    for character in value:
        if unicodedata.category(character).startswith("C"):
            raise ValueError(f"text without control characters expected, got U+{ord(character):04X}")
    return value


def _number(value: object) -> object:
    if isinstance(value, (bool, str, bytes)):
        raise ValueError("a number expected")
    return value


def _past(value: datetime, info: pydantic.ValidationInfo) -> datetime:
    if value < _EARLIEST:
        raise ValueError("a time after 1980-01-06 expected")
    if info.context is STORED:
        return value
    if value > datetime.now(timezone.utc) + timedelta(seconds=MAX_SKEW_S):
        raise ValueError(f"a time not more than {MAX_SKEW_S:g} s in the future expected")
    return value


def _covariance(matrix: Sequence[Sequence[float]], low: Sequence[float], high: Sequence[float]) -> None:
    """Refuse what is no covariance, or has variances outside what they may be."""
    P = np.array(matrix, dtype=float)
    variance = np.diag(P)
    for index, (value, least, most) in enumerate(zip(variance, low, high, strict=True)):
        if not least <= value <= most:
            raise ValueError(f"variance [{index}][{index}] = {value:g} must be in [{least:g}, {most:g}]")
    sigma = np.sqrt(variance)
    correlation = P / np.outer(sigma, sigma)
    if np.abs(correlation - correlation.T).max() > SYMMETRY:
        raise ValueError(f"must be symmetric to {SYMMETRY:g} of its variances")
    if np.abs(correlation).max() > 1.0 + SYMMETRY or np.linalg.eigvalsh(correlation)[0] < -SYMMETRY:
        raise ValueError("must be positive semi-definite")


Number = Annotated[float, pydantic.BeforeValidator(_number)]
Text = Annotated[str, pydantic.Field(min_length=1, max_length=_MOST_CHARACTERS), pydantic.AfterValidator(_text)]
Time = Annotated[datetime, pydantic.BeforeValidator(utc)]
_Pair = tuple[Number, Number]
_Triple = tuple[Number, Number, Number]
Matrix2 = tuple[_Pair, _Pair]
Matrix3 = tuple[_Triple, _Triple, _Triple]


class _Record(pydantic.BaseModel):
    """No unknown keys, no number that is not finite, immutable."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Source(_Record):
    """Which signal: kind, name and carrier together are its identity."""

    kind: Kind
    name: Text
    carrier_hz: Annotated[Number, pydantic.Field(ge=1e3, le=3e11)]


class Position(_Record):
    """Antenna, ECEF, within 5e7 m of the Earth's centre and not deep inside it."""

    p_e_m: _Triple
    covariance_m2: Matrix3

    @pydantic.field_validator("p_e_m")
    @classmethod
    def _near_the_earth(cls, value: _Triple) -> _Triple:
        radius = math.hypot(*value)
        if not _LEAST_RADIUS_M <= radius <= _MOST_RADIUS_M:
            raise ValueError(
                f"{radius:g} m from the Earth's centre; between {_LEAST_RADIUS_M:g} and {_MOST_RADIUS_M:g} expected"
            )
        return value

    @pydantic.field_validator("covariance_m2")
    @classmethod
    def _of_a_position(cls, value: Matrix3) -> Matrix3:
        _covariance(value, [1e-8] * 3, [1e14] * 3)
        return value


class Clock(_Record):
    """Offset and drift of the source's clock from system time at `epoch`."""

    epoch: Annotated[Time, pydantic.AfterValidator(_past)]
    bias_s: Annotated[Number, pydantic.Field(ge=-86400.0, le=86400.0)]
    drift: Annotated[Number, pydantic.Field(ge=-1e-2, le=1e-2)]
    covariance: Matrix2

    @pydantic.field_validator("covariance")
    @classmethod
    def _of_a_clock(cls, value: Matrix2) -> Matrix2:
        _covariance(value, [1e-36, 1e-40], [1e6, 1.0])
        return value


class Noise(_Record):
    """Coefficients of the clock's fractional-frequency noise h0 + h-2 / f², covariance of the errors of their logs."""

    h0_s: Annotated[Number, pydantic.Field(ge=1e-32, le=1e-10)]
    h_minus2_per_s: Annotated[Number, pydantic.Field(ge=1e-36, le=1e-8)]
    ln_covariance: Matrix2

    @pydantic.field_validator("ln_covariance")
    @classmethod
    def _of_logs(cls, value: Matrix2) -> Matrix2:
        _covariance(value, [1e-8] * 2, [64.0] * 2)
        return value


class Provenance(_Record):
    """How it was learnt. `independent`: from this receiver's own observations alone, nothing downloaded in it."""

    receiver: Text
    software: Text
    method: Method
    independent: Annotated[bool, pydantic.Field(strict=True)]


class Quality(_Record):
    """What it rests on. `nis` is the mean squared innovation over its variance, 1 for a filter that is right."""

    duration_s: Annotated[Number, pydantic.Field(gt=0.0, le=1e7)]
    cn0_dbhz: Annotated[Number, pydantic.Field(ge=0.0, le=120.0)] | None = None
    nis: Annotated[Number, pydantic.Field(ge=0.0, le=1e9)] | None = None


class Characterization(_Record):
    """A receiver's word about a source: at least one of `position`, `clock` and `noise`.

    Raises
    ------
    pydantic.ValidationError
        Naming the field, its value and the rule.
    """

    source: Source
    position: Position | None = None
    clock: Clock | None = None
    noise: Noise | None = None
    provenance: Provenance
    quality: Quality

    @pydantic.model_validator(mode="after")
    def _says_something(self) -> Characterization:
        if self.position is None and self.clock is None and self.noise is None:
            raise ValueError("at least one of position, clock and noise expected")
        return self

    def to_json(self) -> dict[str, Any]:
        """The body as plain JSON values; `Characterization.model_validate` of it gives the same back."""
        return self.model_dump(mode="json")


class _Answer(pydantic.BaseModel):
    """An answer may have keys that an older client does not know."""

    model_config = pydantic.ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class AnsweredPosition(_Answer):
    p_e_m: _Triple
    covariance_m2: Matrix3
    latitude_deg: float
    longitude_deg: float
    height_m: float
    sigma_m: float


class AnsweredClock(_Answer):
    epoch: Time
    bias_s: float
    drift: float
    covariance: Matrix2
    noise_assumed: bool = False


class AnsweredNoise(_Answer):
    h0_s: float
    h_minus2_per_s: float
    ln_covariance: Matrix2


class AnsweredQuality(_Answer):
    contributions: int
    newest: Time | None
    age_s: float | None
    grade: Literal["A", "B", "C", "D"]


class AnsweredSource(_Answer):
    """What the service answers about a source, brought to the asked time."""

    id: Annotated[str, pydantic.Field(min_length=1, max_length=40)]
    kind: Kind
    name: str
    carrier_hz: float
    position: AnsweredPosition | None
    clock: AnsweredClock | None
    noise: AnsweredNoise | None
    quality: AnsweredQuality
