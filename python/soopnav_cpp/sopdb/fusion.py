"""Many characterisations of a source made one, at any time; who is believed, and until when.

The mathematics is the engine's (``soopnav/navigation/sop_fusion.hpp``; cpp/doc/signal_database.md); here is what it is
applied to. `fuse` makes one state of what is accepted, `SourceState.moved` brings it up to date, `judge` says whether a
new characterisation is believed.

Times are aware ``datetime``; within the engine seconds from the asked time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from soopnav_cpp import geometry
from soopnav_cpp._core import navigation as _navigation
from soopnav_cpp.clock import TwoState
from soopnav_cpp.sopdb.records import Characterization, utc

__all__ = [
    "ASSUMED_NOISE",
    "GATE",
    "LN_WALK_PER_S",
    "MOST_FUSED",
    "MOST_OF_ONE",
    "POSITION_WALK_M2PS",
    "VOTE_DAYS",
    "Entry",
    "Estimate",
    "Judgement",
    "SourceState",
    "answer_quality",
    "counting",
    "fuse",
    "impossible",
    "judge",
    "stability",
]

_Array = npt.NDArray[np.float64]

#: A characterisation is quarantined when honest ones would disagree as much with this probability, all parts together.
GATE = 1e-4
#: The gate takes the clock's noise this many standard deviations above what is stated.
GATE_SIGMAS = 3.0
#: Characterisations of a source that are fused; others have nothing to add.
MOST_FUSED = 64
#: The newest of each contributor among them, so that nobody pushes the others out by sending much.
MOST_OF_ONE = 8
#: An accepted characterisation this much older than a new one no longer speaks against it: transmitters are rebuilt.
VOTE_DAYS = 30.0
_YEAR_S = 365.25 * 86400.0
#: Ageing of a position: 1 m after a year.
POSITION_WALK_M2PS = 1.0 / _YEAR_S
#: Ageing of ln h0 and ln h-2: a factor e after a year.
LN_WALK_PER_S = 1.0 / _YEAR_S
_MOST_LN_VARIANCE = 25.0
#: Clocks of unknown noise are brought up to date as if they were a TCXO's, the worst that transmitters have.
ASSUMED_NOISE = TwoState.tcxo()
_SLACK = 4.0  # variances may be this much below the least that theory allows: both ends of a record, readings of h
_SATELLITES = ("gps", "iridium")
_MOST_READINGS_HZ = 1000.0


class Estimate(NamedTuple):
    """Numbers and the covariance of their errors.

    Attributes
    ----------
    value : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    """

    value: _Array
    covariance: _Array

    def to_json(self) -> dict[str, Any]:
        return {"value": self.value.tolist(), "covariance": self.covariance.tolist()}


@dataclass(frozen=True)
class Entry:
    """A characterisation as the store keeps it.

    Attributes
    ----------
    id : str
    contributor : str
        Who sent it (whose token): votes are counted by it, so that one voice is one voice.
    received : datetime
    body : Characterization
    """

    id: str
    contributor: str
    received: datetime
    body: Characterization

    @property
    def time(self) -> datetime:
        """When it holds: the clock's epoch, otherwise when it came."""
        return self.received if self.body.clock is None else self.body.clock.epoch


@dataclass(frozen=True)
class SourceState:
    """What is known of a source at one time.

    Attributes
    ----------
    at : datetime
    position : Estimate or None
        ECEF [m].
    clock : Estimate or None
        Offset [s] and drift [s/s].
    noise : Estimate or None
        ln(h0 / s), ln(h-2 / Hz).
    """

    at: datetime
    position: Estimate | None = None
    clock: Estimate | None = None
    noise: Estimate | None = None

    def moved(self, at: datetime) -> SourceState:
        """The state at a later time: the clock run on, every covariance grown.

        Raises
        ------
        ValueError
            For a time before the state's: `fuse` the contributions at that time instead.
        """
        dt_s = (at - self.at).total_seconds()
        if dt_s < 0.0:
            raise ValueError(f"at = {at.isoformat()} must not be before {self.at.isoformat()}")
        noise = None if self.noise is None else _aged(self.noise, LN_WALK_PER_S * dt_s)
        position = None if self.position is None else _aged(self.position, POSITION_WALK_M2PS * dt_s)
        clock = self.clock
        if clock is not None:
            h0, h_minus_2 = _coefficients(noise)
            clock = Estimate(*_navigation.sop_move_clock(*clock, h0=h0, h_minus_2=h_minus_2, dt_s=dt_s))
        return SourceState(at, position, clock, noise)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values, for a store to keep; `from_json` reads them."""
        parts = {"position": self.position, "clock": self.clock, "noise": self.noise}
        return {"at": self.at.isoformat()} | {k: None if v is None else v.to_json() for k, v in parts.items()}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> SourceState:
        """Of what `to_json` gave."""

        def part(name: str) -> Estimate | None:
            found = value[name]
            return None if found is None else Estimate(np.array(found["value"]), np.array(found["covariance"]))

        return cls(utc(value["at"]), part("position"), part("clock"), part("noise"))

    def answer(self) -> dict[str, Any]:
        """``position``, ``clock`` and ``noise`` of an answered source; None where nothing is known."""
        out: dict[str, Any] = {"position": None, "clock": None, "noise": None}
        if self.position is not None:
            latitude, longitude, height = geometry.ecef_to_geodetic(self.position.value)
            out["position"] = {
                "p_e_m": self.position.value.tolist(),
                "covariance_m2": self.position.covariance.tolist(),
                "latitude_deg": math.degrees(float(latitude)),
                "longitude_deg": math.degrees(float(longitude)),
                "height_m": float(height),
                "sigma_m": math.sqrt(float(np.trace(self.position.covariance)) / 3.0),
            }
        if self.clock is not None:
            out["clock"] = {
                "epoch": _zulu(self.at),
                "bias_s": float(self.clock.value[0]),
                "drift": float(self.clock.value[1]),
                "covariance": self.clock.covariance.tolist(),
                "noise_assumed": self.noise is None,
            }
        if self.noise is not None:
            h0, h_minus_2 = np.exp(self.noise.value).tolist()
            out["noise"] = {
                "h0_s": h0,
                "h_minus2_per_s": h_minus_2,
                "ln_covariance": self.noise.covariance.tolist(),
            }
        return out


@dataclass(frozen=True)
class Judgement:
    """What becomes of a new characterisation, and of older ones because of it.

    Attributes
    ----------
    status : str
        ``"accepted"`` or ``"quarantined"``.
    reasons : tuple of str
        Sentences; empty when accepted.
    quarantined : dict of str to tuple of str
        Accepted ones, by id, that a majority has now turned against, with reasons.
    reinstated : tuple of str
        Quarantined ones, by id, that are accepted now.
    """

    status: str
    reasons: tuple[str, ...] = ()
    quarantined: dict[str, tuple[str, ...]] = field(default_factory=dict)
    reinstated: tuple[str, ...] = ()


def _zulu(at: datetime) -> str:
    return at.astimezone(timezone.utc).isoformat().replace("+00:00", "Z")


def _aged(estimate: Estimate, variance: float) -> Estimate:
    return Estimate(estimate.value, estimate.covariance + variance * np.eye(len(estimate.value)))


def _coefficients(noise: Estimate | None, sigmas: float | None = None) -> tuple[float, float]:
    """E[h] of a noise with uncertainty, or h some standard deviations up."""
    if noise is None:
        return ASSUMED_NOISE.h0, ASSUMED_NOISE.h_minus_2
    variance = np.minimum(np.diag(noise.covariance), _MOST_LN_VARIANCE)
    up = 0.5 * variance if sigmas is None else sigmas * np.sqrt(variance)
    h0, h_minus_2 = np.exp(np.minimum(noise.value + up, 0.0)).tolist()
    return h0, h_minus_2


def _noise_of(body: Characterization) -> Estimate | None:
    if body.noise is None:
        return None
    value = np.log([body.noise.h0_s, body.noise.h_minus2_per_s])
    return Estimate(value, np.array(body.noise.ln_covariance))


def _clock_of(body: Characterization) -> Estimate | None:
    if body.clock is None:
        return None
    return Estimate(np.array([body.clock.bias_s, body.clock.drift]), np.array(body.clock.covariance))


def _position_of(body: Characterization) -> Estimate | None:
    if body.position is None:
        return None
    return Estimate(np.array(body.position.p_e_m), np.array(body.position.covariance_m2))


def counting(entries: Iterable[Entry]) -> list[Entry]:
    """Those that are fused and voted with, oldest first: of each contributor the newest, `MOST_OF_ONE` at most.

    Of more than `MOST_FUSED` everybody's newest come before anybody's second newest.
    """
    ranks: Counter[str] = Counter()
    ranked = []
    for entry in sorted(entries, key=lambda entry: (entry.time, entry.id), reverse=True):
        if ranks[entry.contributor] < MOST_OF_ONE:
            ranked.append((ranks[entry.contributor], entry))
        ranks[entry.contributor] += 1
    ranked.sort(key=lambda pair: pair[0])  # stable: the newest first within a rank
    return sorted((entry for _, entry in ranked[:MOST_FUSED]), key=lambda entry: (entry.time, entry.id))


def _columns(
    rows: Sequence[tuple[float, Estimate | None, bool]],
) -> tuple[list[float], _Array, _Array, list[bool]] | None:
    kept = [(t, e, free) for t, e, free in rows if e is not None]
    if not kept:
        return None
    return (
        [t for t, _, _ in kept],
        np.array([e.value for _, e, _ in kept]),
        np.array([e.covariance for _, e, _ in kept]),
        [free for _, _, free in kept],
    )


def fuse(
    entries: Iterable[Entry], at: datetime, *, noise: Estimate | None = None, sigmas: float | None = None
) -> SourceState:
    """One state of a source's accepted characterisations, at any time.

    Independent ones by Kalman filters over their epochs, forwards and backwards to `at`; those that may have used
    other's answers by covariance intersection (cpp/doc/signal_database.md). Only those `counting`.

    Parameters
    ----------
    entries : iterable of Entry
    at : datetime
    noise : Estimate, optional
        Of the clock, in place of what the entries say (and given back).
    sigmas : float, optional
        The clock's noise this many standard deviations above the fused; without it its mean.

    Returns
    -------
    SourceState
        Parts about which no entry says anything are None.
    """
    kept = counting(entries)
    times = [(entry.time - at).total_seconds() for entry in kept]
    free = [entry.body.provenance.independent for entry in kept]

    def constants(parts: Sequence[Estimate | None], walk: float) -> Estimate | None:
        columns = _columns(list(zip(times, parts, free, strict=True)))
        if columns is None:
            return None
        return Estimate(*_navigation.sop_fuse_constants(*columns, variance_per_s=walk, at_s=0.0))

    if noise is None:
        noise = constants([_noise_of(entry.body) for entry in kept], LN_WALK_PER_S)
    position = constants([_position_of(entry.body) for entry in kept], POSITION_WALK_M2PS)
    columns = _columns(list(zip(times, [_clock_of(entry.body) for entry in kept], free, strict=True)))
    clock = None
    if columns is not None:
        h0, h_minus_2 = _coefficients(noise, sigmas)
        clock = Estimate(*_navigation.sop_fuse_clocks(*columns, h0=h0, h_minus_2=h_minus_2, at_s=0.0))
    return SourceState(at, position, clock, noise)


def impossible(body: Characterization) -> tuple[str, ...]:
    """Why a characterisation cannot be true whatever others say: a sentence for each mistake, none for a possible one.

    Offsets above 1 s, drifts above 1e-4 (no oscillator is worse), noise no oscillator has, antennas in the Earth or in
    the air, variances below what the record's length allows (cpp/doc/signal_database.md eqs. 10 to 12), a filter whose
    own innovations contradict it.
    """
    out = []
    clock, noise, quality = body.clock, body.noise, body.quality
    if clock is not None:
        if abs(clock.bias_s) > 1.0:
            out.append(f"clock: an offset of {clock.bias_s:g} s; within 1 s expected")
        if abs(clock.drift) > 1e-4:
            out.append(f"clock: a drift of {clock.drift:g}; within 1e-4 expected")
        power_hz = 10.0 ** (0.1 * (60.0 if quality.cn0_dbhz is None else quality.cn0_dbhz))
        least = 1.0 / ((2.0 * math.pi * body.source.carrier_hz) ** 2 * 2.0 * power_hz * quality.duration_s)
        if clock.covariance[0][0] * _SLACK < least:
            out.append(f"clock: an offset to {math.sqrt(clock.covariance[0][0]):.2g} s; noise allows {least**0.5:.2g}")
    if noise is not None:
        if not 1e-28 <= noise.h0_s <= 1e-16:
            out.append(f"noise: h0 of {noise.h0_s:g} s; between 1e-28 and 1e-16 expected")
        if not 1e-32 <= noise.h_minus2_per_s <= 1e-16:
            out.append(f"noise: h-2 of {noise.h_minus2_per_s:g} Hz; between 1e-32 and 1e-16 expected")
        if body.provenance.independent:
            least_walk = _navigation.sop_least_variances(noise.h0_s, noise.h_minus2_per_s, quality.duration_s)[1]
            least_ln = (2.0 / (_MOST_READINGS_HZ * quality.duration_s), least_walk)
            for name, k in (("h0", 0), ("h-2", 1)):
                if noise.ln_covariance[k][k] * _SLACK < least_ln[k]:
                    out.append(
                        f"noise: ln {name} to {math.sqrt(noise.ln_covariance[k][k]):.2g}; "
                        f"{quality.duration_s:g} s allow {math.sqrt(least_ln[k]):.2g}"
                    )
        if clock is not None:
            h0, h_minus_2 = _coefficients(_noise_of(body), -GATE_SIGMAS)
            duration_s = quality.duration_s if body.provenance.independent else math.inf
            least = _navigation.sop_least_variances(h0, h_minus_2, duration_s)[0]
            if clock.covariance[1][1] * _SLACK < least:
                out.append(
                    f"clock: a drift to {math.sqrt(clock.covariance[1][1]):.2g}; its noise allows {least**0.5:.2g}"
                )
    if body.position is not None:
        height_m = float(geometry.ecef_to_geodetic(np.array(body.position.p_e_m))[2])
        if body.source.kind in _SATELLITES:
            out.append("position: a satellite has an orbit and no position")
        elif height_m < -500.0:
            out.append(f"position: {-height_m:.0f} m inside the Earth")
        elif height_m > 2e4 and body.source.kind != "other":
            out.append(f"position: {height_m:.0f} m above the Earth")
    if quality.nis is not None and not 0.25 <= quality.nis <= 4.0:
        out.append(f"quality: its filter's innovations are {quality.nis:.2g} of their variance; 1 expected")
    return tuple(out)


def _differences(one: Entry, others: Sequence[Entry], *, independent: bool, gate: float = GATE) -> tuple[str, ...]:
    """In which parts an entry disagrees with what others together say."""
    body = one.body
    own = _noise_of(body)
    rest = fuse(others, one.time)
    known = rest.noise if rest.noise is not None else own
    rest = fuse(others, one.time, noise=known, sigmas=GATE_SIGMAS)
    pairs = [
        ("position", _position_of(body), rest.position),
        ("clock", _clock_of(body), rest.clock),
        ("noise", own, None if all(other.body.noise is None for other in others) else rest.noise),
    ]
    shared = [(name, a, b) for name, a, b in pairs if a is not None and b is not None]
    out = []
    for name, a, b in shared:
        d2, probability = _navigation.sop_disagreement(*a, *b, independent=independent)
        if probability < gate / len(shared):
            out.append(f"{name}: {math.sqrt(d2):.1f} standard deviations from what others say")
    return tuple(out)


def _agree(a: Entry, b: Entry) -> bool:
    first, second = sorted((a, b), key=lambda entry: (entry.time, entry.id))
    free = first.body.provenance.independent and second.body.provenance.independent
    return not _differences(second, [first], independent=free)


def _doubts(new: Entry, accepted: Sequence[Entry]) -> tuple[str, ...]:
    """In which parts a new entry disagrees with the accepted, or with those of other contributors alone: by many small
    steps, each in agreement with the one before, nobody carries a source away."""
    free = new.body.provenance.independent
    others = [entry for entry in accepted if entry.contributor != new.contributor]
    if not others or len(others) == len(accepted):
        return _differences(new, accepted, independent=free)
    doubts = _differences(new, others, independent=free, gate=0.5 * GATE)
    return doubts or _differences(new, accepted, independent=free, gate=0.5 * GATE)


def _votes(entries: Iterable[Entry]) -> set[str]:
    return {entry.contributor for entry in entries if entry.body.provenance.independent}


def judge(new: Entry, accepted: Sequence[Entry], quarantined: Sequence[Entry] = ()) -> Judgement:
    """Whether a new characterisation is believed.

    It is quarantined when it is `impossible`, or when its position, its clock at its own epoch or its noise disagree
    with the fused rest, or with that of other contributors, at a probability below `GATE` in all. A majority can
    overturn: when more contributors (each one voice, and only with independent characterisations) say what the new one
    says than say otherwise, theirs are accepted and the others quarantined. So a first liar does not lock out the
    honest, nor does a single later liar displace them.

    Parameters
    ----------
    new : Entry
    accepted, quarantined : sequence of Entry
        The source's other ones.
    """
    reasons = impossible(new.body)
    if reasons:
        return Judgement("quarantined", reasons)
    heard = counting(accepted)
    if not heard:
        return Judgement("accepted")
    reasons = _doubts(new, heard)
    if not reasons:
        return Judgement("accepted")
    like = [entry for entry in counting(quarantined) if not impossible(entry.body) and _agree(new, entry)]
    camp = [new, *like]
    limit = new.time - timedelta(days=VOTE_DAYS)
    against = [entry for entry in heard if not all(_agree(entry, member) for member in camp)]
    behind = _votes(camp)
    rest = [entry for entry in heard if entry not in against and entry.contributor not in behind]
    if rest and _differences(new, rest, independent=new.body.provenance.independent):
        against += rest  # nobody alone says otherwise, but all together do
    opposed = _votes(entry for entry in against if entry.time >= limit)
    if len(behind - opposed) > len(opposed - behind):
        why = f"{len(behind)} later contributor{'s' if len(behind) > 1 else ''} agree on something else"
        return Judgement(
            "accepted",
            quarantined={entry.id: (why,) for entry in against},
            reinstated=tuple(entry.id for entry in like),
        )
    return Judgement("quarantined", reasons)


def answer_quality(entries: Sequence[Entry], at: datetime) -> dict[str, Any]:
    """``contributions``, ``newest``, ``age_s`` and ``grade`` of accepted characterisations.

    A: three contributors or more and the newest at most a day old; B: two, a week; C: thirty days; D: older.
    """
    newest = max((entry.time for entry in entries), default=None)
    age_s = None if newest is None else max(0.0, (at - newest).total_seconds())
    voices = len({entry.contributor for entry in entries})
    days = math.inf if age_s is None else age_s / 86400.0
    grade = "A" if voices >= 3 and days <= 1.0 else "B" if voices >= 2 and days <= 7.0 else "C" if days <= 30.0 else "D"
    return {
        "contributions": len(entries),
        "newest": None if newest is None else _zulu(newest),
        "age_s": age_s,
        "grade": grade,
    }


def stability(noise: Estimate, tau_s: npt.ArrayLike, *, sigmas: float = 1.96) -> dict[str, list[float]]:
    """Allan deviation of a clock of uncertain noise, with its band.

    ADEV² = h0 / (2 tau) + (2 pi² / 3) h-2 tau; the band by the errors of ln h to first order in ln ADEV
    (cpp/doc/signal_database.md eq. 13).

    Parameters
    ----------
    noise : Estimate
        Of ln h0, ln h-2.
    tau_s : array_like, shape (n,)
        Positive.
    sigmas : float
        Half width of the band in standard deviations of ln ADEV.

    Returns
    -------
    dict
        ``tau_s``, ``deviation``, ``lower``, ``upper``: lists of n numbers.
    """
    tau = np.asarray(tau_s, dtype=float)
    h0, h_minus_2 = np.exp(noise.value).tolist()
    deviation = TwoState(h0, h_minus_2).allan_deviation(tau)
    white = TwoState(h0, 0.0).allan_deviation(tau) ** 2
    share = np.stack([white, deviation**2 - white], axis=-1) / deviation[:, None] ** 2
    spread = np.sqrt(np.einsum("ni,ij,nj->n", share, noise.covariance, share))
    factor = np.exp(0.5 * sigmas * spread)
    return {
        "tau_s": tau.tolist(),
        "deviation": deviation.tolist(),
        "lower": (deviation / factor).tolist(),
        "upper": (deviation * factor).tolist(),
    }
