"""``soopnav caf``: delay and Doppler between two recordings."""

from __future__ import annotations

import dataclasses
import datetime
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import dsp, io, simulation
from soopnav_cpp.cli import text
from soopnav_cpp.cli.progress import Steps

__all__ = ["Answer", "Recording", "answer", "as_json", "draw", "sentences"]

_FRACTION = re.compile(r"[.,](\d+)")


@dataclasses.dataclass(frozen=True)
class Recording:
    """A recording cut to what both cover.

    Attributes
    ----------
    name : str
    iq : ndarray of complex64
    sample_rate_hz : float
    center_hz : float or None
    start_s : float or None
        Of its first sample, from the whole second before the first of the two recordings.
    """

    name: str
    iq: npt.NDArray[np.complex64]
    sample_rate_hz: float
    center_hz: float | None
    start_s: float | None

    @property
    def duration_s(self) -> float:
        """Its length."""
        return len(self.iq) / self.sample_rate_hz


@dataclasses.dataclass(frozen=True)
class Answer:
    """What is printed.

    Attributes
    ----------
    names : tuple of str
        Of a and b.
    tdoa_s, fdoa_hz : float
        Of the signal on the air: starts and centre frequencies of the recordings are accounted for.
    result : dsp.CrossAmbiguityResult
        Of the samples of `a` and `b` below.
    notes : list of str
        What was done to the recordings before.
    a, b : Recording
        As they were measured, at one rate, about one centre frequency and equally long.
    options : dict
        Of the search.
    """

    names: tuple[str, str]
    tdoa_s: float
    fdoa_hz: float
    result: dsp.CrossAmbiguityResult
    notes: list[str]
    a: Recording
    b: Recording
    options: dict[str, float]


def _instant(value: str, path: Path) -> tuple[datetime.datetime, float]:
    """Whole second and fraction: a `datetime` alone would round to microseconds, 300 m of light."""
    found = _FRACTION.search(value)
    whole = value if found is None else value[: found.start()] + value[found.end() :]
    try:
        instant = datetime.datetime.fromisoformat(whole.replace("Z", "+00:00"))
    except ValueError as error:
        raise ValueError(f"{path}: core:datetime is {value!r}; an ISO 8601 time was expected") from error
    if instant.tzinfo is None:
        instant = instant.replace(tzinfo=datetime.timezone.utc)
    return instant, 0.0 if found is None else float(f"0.{found.group(1)}")


def _read(paths: tuple[Path, Path]) -> tuple[Recording, Recording]:
    read = []
    for path in paths:
        iq, metadata = io.read_iq(path)
        if len(iq) == 0:
            raise ValueError(f"{path}: no samples")
        read.append((iq, metadata))
    instants = [None if m.datetime_utc is None else _instant(m.datetime_utc, m.path) for _, m in read]
    known = [instant for instant in instants if instant is not None]
    zero = min(instant[0] for instant in known) if len(known) == 2 else None
    recordings = []
    for (iq, metadata), instant in zip(read, instants, strict=True):
        start = None if zero is None or instant is None else (instant[0] - zero).total_seconds() + instant[1]
        recordings.append(
            Recording(metadata.path.name, iq, metadata.sample_rate_hz, metadata.center_frequency_hz, start)
        )
    return recordings[0], recordings[1]


def _one_rate(a: Recording, b: Recording, notes: list[str]) -> tuple[Recording, Recording]:
    rate = min(a.sample_rate_hz, b.sample_rate_hz)
    both = []
    for r in (a, b):
        if r.sample_rate_hz != rate:
            iq = dsp.resample(r.iq, r.sample_rate_hz, rate)
            notes.append(f"{r.name} was resampled from {text.rate(r.sample_rate_hz)} to {text.rate(rate)}")
            r = dataclasses.replace(r, iq=iq, sample_rate_hz=rate)
        both.append(r)
    return both[0], both[1]


def _one_center(a: Recording, b: Recording, notes: list[str]) -> tuple[Recording, Recording]:
    """Both about one centre frequency: the one with the higher rate is moved, so that no more is lost than must be.

    What is left between them is then Doppler alone, and the search takes no other stretch out (-Doppler / carrier).
    """
    if a.center_hz is None or b.center_hz is None:
        notes.append("a centre frequency is missing: both recordings are taken to have the same")
        return a, b
    apart_hz = a.center_hz - b.center_hz
    if abs(apart_hz) >= 0.5 * (a.sample_rate_hz + b.sample_rate_hz):
        raise ValueError(
            f"{a.name} is centred on {text.megahertz(a.center_hz)} and {b.name} on {text.megahertz(b.center_hz)}: "
            "their bands do not overlap"
        )
    if apart_hz == 0.0 or np.array_equal(a.iq, b.iq):  # what is identical stays so, and is told
        return a, b
    moved, kept, by_hz = (a, b, apart_hz) if a.sample_rate_hz >= b.sample_rate_hz else (b, a, -apart_hz)
    notes.append(f"{moved.name} was moved by {text.frequency_offset(-by_hz)} to the centre frequency of {kept.name}")
    iq = simulation.apply_cfo(moved.iq, by_hz, moved.sample_rate_hz)
    moved = dataclasses.replace(moved, iq=iq, center_hz=kept.center_hz)
    return (moved, kept) if by_hz == apart_hz else (kept, moved)


def _cut(
    a: Recording, b: Recording, start_s: float, duration_s: float | None, notes: list[str]
) -> tuple[Recording, Recording]:
    """The samples that both have, `start_s` after the first common instant."""
    starts = [0.0, 0.0]
    if a.start_s is None or b.start_s is None:
        notes.append("a start time is missing: both recordings are taken to start together")
    else:
        starts = [a.start_s, b.start_s]
    begin = max(starts)
    end = min(s + r.duration_s for s, r in zip(starts, (a, b), strict=True))
    if end <= begin:
        early, late = (a, b) if starts[0] < starts[1] else (b, a)
        gap = text.duration(begin - end)
        raise ValueError(f"{early.name} ends {gap} before {late.name} starts: the recordings do not overlap in time")
    begin += start_s
    if begin >= end:
        raise ValueError(
            f"--start {start_s:g}: the recordings have {text.duration(end - begin + start_s)} in common; "
            "a start inside it expected"
        )
    if duration_s is not None:
        end = min(end, begin + duration_s)
    rate = a.sample_rate_hz
    first = [round((begin - s) * rate) for s in starts]
    count = min(int((end - begin) * rate), *(len(r.iq) - i for r, i in zip((a, b), first, strict=True)))
    if count < 1:
        raise ValueError(f"{a.name} and {b.name}: less than one sample, {text.duration(1.0 / rate)}, to compare")
    both = []
    for r, s, i in zip((a, b), starts, first, strict=True):
        iq = np.ascontiguousarray(r.iq[i : i + count])
        both.append(dataclasses.replace(r, iq=iq, start_s=s + i / rate))
    return both[0], both[1]


def answer(
    paths: tuple[Path, Path],
    *,
    max_delay_s: float,
    max_doppler_hz: float,
    bandwidth_hz: float,
    start_s: float,
    duration_s: float | None,
    step: Steps,
) -> Answer:
    """Read both, bring them together and measure."""
    if not (math.isfinite(start_s) and start_s >= 0.0):
        raise ValueError(f"--start {start_s:g}: a number of seconds of at least 0 expected")
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0.0):
        raise ValueError(f"--duration {duration_s:g}: a number of seconds above 0 expected")
    for name, value in (("--max-delay", max_delay_s), ("--max-doppler", max_doppler_hz), ("--bandwidth", bandwidth_hz)):
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name} {value:g}: a finite number of at least 0 expected")
    notes: list[str] = []
    step(f"reading {paths[0].name} and {paths[1].name}")
    a, b = _read(paths)
    a, b = _one_center(a, b, notes)
    a, b = _one_rate(a, b, notes)
    rate = a.sample_rate_hz
    a, b = _cut(a, b, start_s, duration_s, notes)
    common_s = len(a.iq) / rate
    if max_delay_s > 0.4 * common_s:
        max_delay_s = 0.4 * common_s
        notes.append(f"delays were searched to ±{text.nanoseconds(max_delay_s)} only, 0.4 of the common time")
    options = {
        "max_delay_s": max_delay_s,
        "max_doppler_hz": min(max_doppler_hz, rate),
        "bandwidth_hz": bandwidth_hz,
        "carrier_hz": b.center_hz or 0.0,
    }
    # Of identical samples alone: others are about one centre by now.
    apart_hz = 0.0 if a.center_hz is None or b.center_hz is None else a.center_hz - b.center_hz
    step("searching")
    result = dsp.cross_ambiguity(a.iq, b.iq, rate, **options)  # type: ignore[arg-type]
    return Answer(
        (a.name, b.name),
        result.tdoa_s + ((a.start_s or 0.0) - (b.start_s or 0.0)),
        result.fdoa_hz + apart_hz,
        result,
        notes,
        a,
        b,
        options,
    )


def _decimals(sigma: float) -> int:
    """Decimals that show two figures of a standard deviation; at least 3, at most 12."""
    return min(max(3, 1 - math.floor(math.log10(sigma))), 12) if 0.0 < sigma < math.inf else 3


def sentences(found: Answer) -> list[str]:
    """What a person reads: the notes, then the answer."""
    a, b = found.names
    result = found.result
    lines = list(found.notes)
    if result.identical:
        return [*lines, f"{a} and {b} hold the same samples: the delay is zero and says nothing"]
    if result.status == dsp.AmbiguityStatus.TONE:
        return [*lines, f"{a} and {b} share a tone, whose delay cannot be seen"]
    if not result.detected:
        reason = result.status.text
        if result.status == dsp.AmbiguityStatus.NOT_DETECTED:
            reason = (
                f"no common signal: {text.plain(result.snr_db, 1)} dB where {text.plain(result.threshold_db, 1)} dB "
                "would be one"
            )
        return [*lines, f"{a} and {b}: {reason}"]
    later, earlier = (a, b) if found.tdoa_s >= 0.0 else (b, a)
    higher, lower = (a, b) if found.fdoa_hz >= 0.0 else (b, a)
    lines.append(
        f"{later} is later than {earlier} by {text.nanoseconds(abs(found.tdoa_s))} "
        f"± {text.nanoseconds(result.sigma_tdoa_s)}"
    )
    digits = _decimals(result.sigma_fdoa_hz)
    lines.append(
        f"{higher} is higher than {lower} by {abs(found.fdoa_hz):.{digits}f} Hz ± {result.sigma_fdoa_hz:.{digits}f} Hz"
    )
    lines.append(
        f"peak {text.plain(result.snr_db, 1)} dB above the noise (threshold {text.plain(result.threshold_db, 1)} dB); "
        f"signal {text.plain(result.snr_a_db, 1)} and {text.plain(result.snr_b_db, 1)} dB, "
        f"{text.duration(result.duration_s)} long, {result.bandwidth_hz / 1e3:.3g} kHz wide"
    )
    if result.tones:
        lines.append("1 steady tone was subtracted" if result.tones == 1 else f"{result.tones} steady tones subtracted")
    return lines


def as_json(found: Answer) -> dict[str, Any]:
    """What ``--json`` prints; what is not known is null."""
    result = found.result

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "a": found.names[0],
        "b": found.names[1],
        "status": result.status.name.lower(),
        "tdoa_s": found.tdoa_s if result.detected or result.identical else None,
        "fdoa_hz": found.fdoa_hz if result.detected or result.identical else None,
        "sigma_tdoa_s": number(result.sigma_tdoa_s),
        "sigma_fdoa_hz": number(result.sigma_fdoa_hz),
        "covariance": result.covariance.tolist() if result.detected else None,
        "epoch_s": result.epoch_s,
        "snr_db": number(result.snr_db),
        "threshold_db": number(result.threshold_db),
        "snr_a_db": number(result.snr_a_db),
        "snr_b_db": number(result.snr_b_db),
        "bandwidth_hz": result.bandwidth_hz,
        "start_s": result.start_s,
        "duration_s": result.duration_s,
        "tones": result.tones,
        "identical": result.identical,
        "notes": found.notes,
    }


def draw(found: Answer, path: Path) -> None:
    """The surface about the peak with a cut through it each way."""
    from soopnav_cpp import plotting

    surface = dsp.ambiguity_surface(found.a.iq, found.b.iq, found.a.sample_rate_hz, **found.options)
    shifted = dataclasses.replace(
        surface,
        delays_s=surface.delays_s + (found.tdoa_s - found.result.tdoa_s),
        doppler_hz=surface.doppler_hz + (found.fdoa_hz - found.result.fdoa_hz),
    )
    plotting.ambiguity(
        shifted,
        tdoa_s=found.tdoa_s,
        fdoa_hz=found.fdoa_hz,
        title=f"{found.names[0]} against {found.names[1]}",
        path=path,
    )
