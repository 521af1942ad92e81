"""What ``soopnav synth pair`` reads: two receivers, their clocks, and the satellites that both hear."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated, Literal

import pydantic
from pydantic import Field

from soopnav_cpp.config import InputFile, Model, Vector3, load_toml
from soopnav_cpp.scenarios.base import Latitude, Longitude

__all__ = ["PairCapture", "PairClock", "PairSatellites", "PairScenario", "PairSite", "PairTone", "load_pair_scenario"]

_MOST_SAMPLES = 50_000_000


class PairCapture(Model):
    """``[capture]``: what both receivers record.

    Attributes
    ----------
    start : date and time
        UTC; time 0 of everything here. A receiver begins when its own clock shows it.
    duration_s, sample_rate_hz, center_frequency_hz : float
        At most 50 million samples.
    format : {"cf32", "ci16", "ci8"}
    peak : float
        The largest I or Q of the files, 1.0 being full scale.
    seed : int
        Of payloads, schedule, noise and clocks.
    """

    start: datetime.datetime
    duration_s: Annotated[float, Field(ge=0.01, le=3600.0)]
    sample_rate_hz: Annotated[float, Field(ge=100e3, le=25e6)]
    center_frequency_hz: Annotated[float, Field(ge=1610e6, le=1630e6)] = 1626.1e6
    format: Literal["cf32", "ci16", "ci8"] = "ci8"
    peak: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1

    @pydantic.model_validator(mode="after")
    def _fits_in_memory(self) -> PairCapture:
        if self.duration_s * self.sample_rate_hz > _MOST_SAMPLES:
            raise ValueError(
                f"{self.duration_s * self.sample_rate_hz:.3g} samples; at most {_MOST_SAMPLES:.3g}: shorten duration_s "
                "or lower sample_rate_hz"
            )
        return self


class PairClock(Model):
    """A receiver's oscillator.

    Attributes
    ----------
    bias_s : float
        Reading minus system time at time 0.
    drift_ppm : float
        Its rate there; positive is fast.
    h0, h_minus_2 : float
        White frequency noise [s] and random walk of frequency [Hz].
    """

    bias_s: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.0
    drift_ppm: Annotated[float, Field(gt=-100.0, lt=100.0)] = 0.0
    h0: Annotated[float, Field(ge=0.0, le=1e-15)] = 0.0
    h_minus_2: Annotated[float, Field(ge=0.0, le=1e-15)] = 0.0


class PairSite(Model):
    """``[target]`` and ``[anchor]``.

    Attributes
    ----------
    latitude_deg, longitude_deg, height_m : float
        At time 0, height above the ellipsoid.
    velocity_mps : three floats
        East, north, up; kept.
    clock : table
    """

    latitude_deg: Latitude
    longitude_deg: Longitude
    height_m: float = 0.0
    velocity_mps: Vector3 = (0.0, 0.0, 0.0)
    clock: PairClock = PairClock()


class PairSatellites(Model):
    """``[satellites]``: who sends, how often and how strong.

    Attributes
    ----------
    tle : path, optional
        Elements; without them the 66 satellites are made up.
    mask_deg : float
        Heard are those above it at both receivers.
    snr_db : float
        In 25 kHz, of a satellite overhead; 20 log10 of the range's ratio lower elsewhere.
    ring_alerts_per_s, duplex_per_s : float
        Bursts of each satellite in a second, on average. At most one ring alert and four duplex bursts in a frame of
        90 ms; on the air ring alerts come every few seconds.
    """

    tle: InputFile | None = None
    mask_deg: Annotated[float, Field(ge=0.0, lt=90.0)] = 8.0
    snr_db: Annotated[float, Field(ge=-40.0, le=80.0)] = 20.0
    ring_alerts_per_s: Annotated[float, Field(ge=0.0, le=11.0)] = 2.0
    duplex_per_s: Annotated[float, Field(ge=0.0, le=44.0)] = 2.0


class PairTone(Model):
    """One of ``[[tones]]``: a carrier near a receiver that has nothing to do with satellites.

    Attributes
    ----------
    frequency_hz : float
    snr_db : float
        Over the noise in 25 kHz.
    heard_by : {"target", "anchor", "both"}
    """

    frequency_hz: Annotated[float, Field(ge=1600e6, le=1640e6)]
    snr_db: Annotated[float, Field(ge=-40.0, le=120.0)] = 10.0
    heard_by: Literal["target", "anchor", "both"] = "both"


class PairScenario(Model):
    """``[capture]``, ``[target]``, ``[anchor]``, ``[satellites]`` and ``[[tones]]``: two captures to be made."""

    capture: PairCapture
    target: PairSite
    anchor: PairSite
    satellites: PairSatellites = PairSatellites()
    tones: list[PairTone] = Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def _tones_in_band(self) -> PairScenario:
        half = 0.5 * self.capture.sample_rate_hz
        for index, tone in enumerate(self.tones):
            if abs(tone.frequency_hz - self.capture.center_frequency_hz) > 0.95 * half:
                raise ValueError(f"tones[{index}].frequency_hz: {tone.frequency_hz:.0f} lies outside the recorded band")
        return self


def load_pair_scenario(path: Path) -> PairScenario:
    """Read a scenario of ``soopnav synth pair``; `ConfigError` says what does not fit, and on which line."""
    return load_toml(path, PairScenario)
