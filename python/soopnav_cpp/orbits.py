"""Satellites as beacons: elements from files, constellations made up, who is above the horizon.

Elements (TLE, OMM) go through the package ``sgp4`` (extra ``orbits``) and leave as `geometry.SampledOrbit`: ECEF
positions and velocities at even steps. Derivations and errors: ``cpp/doc/orbits.md``. UT1 is taken to be UTC unless its
difference is given, and polar motion is left out: both move all satellites alike, by some hundred metres and 17 m.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import numpy.typing as npt

from soopnav_cpp._core import geometry as _geometry
from soopnav_cpp._core.geometry import SampledOrbit
from soopnav_cpp._ephemeris_file import Ephemeris, read_ephemeris, write_ephemeris
from soopnav_cpp._orbit_elements import Satellite, read_omm, read_tle, utc
from soopnav_cpp._orbit_paths import signal_path

__all__ = [
    "AlongTrackError",
    "Ephemeris",
    "Pass",
    "Satellite",
    "elevations",
    "excerpt",
    "gmst",
    "iridium_walker",
    "passes",
    "read_ephemeris",
    "read_omm",
    "read_orbits",
    "read_tle",
    "time_text",
    "utc",
    "visible",
    "walker",
    "write_ephemeris",
]

_Array = npt.NDArray[np.float64]
_DAY_S = 86400.0
_J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)


def gmst(when: datetime | str) -> float:
    """Greenwich mean sidereal time (IAU 1982) at an instant of UTC, taken for UT1 [rad], 0 ... 2 pi."""
    since = utc(when) - _J2000
    return float(_geometry.gmst82(2451545.0 + since.days, since.seconds / _DAY_S + since.microseconds / _DAY_S / 1e6))


@dataclass(frozen=True)
class AlongTrackError:
    """How far along its orbit a satellite may be from where old elements put it.

    ``sigma = sqrt(at_epoch_m² + (rate_m_per_day age)² + (growth_m_per_day2 age²)²)``: about 1 km after a day and 1 to
    3 km for each day after, as comparisons of two-line elements with precise orbits find for low orbits (Kelso,
    "Validation of SGP4 and IS-GPS-200D against GPS precision ephemerides", 2007; Flohrer, Krag and Klinkrad, 2008;
    Levit and Marshall, "Improved orbit predictions using two-line elements", 2011); drag makes it grow as age².
    Across the orbit and in height it is several times smaller and does not grow. The numbers are set for 780 km.

    Parameters
    ----------
    at_epoch_m, rate_m_per_day, growth_m_per_day2 : float
        Not negative.
    """

    at_epoch_m: float = 500.0
    rate_m_per_day: float = 800.0
    growth_m_per_day2: float = 300.0

    def __post_init__(self) -> None:
        for name in ("at_epoch_m", "rate_m_per_day", "growth_m_per_day2"):
            value = getattr(self, name)
            if not (0.0 <= value < np.inf):
                raise ValueError(f"{name}: {value}, a finite number that is not negative expected")

    def sigma_m(self, age_s: npt.ArrayLike) -> _Array:
        """Standard deviation along the orbit [m] at an age of elements, before or after their epoch."""
        days = np.abs(np.asarray(age_s, dtype=np.float64)) / _DAY_S
        return np.asarray(
            np.sqrt(self.at_epoch_m**2 + (self.rate_m_per_day * days) ** 2 + (self.growth_m_per_day2 * days**2) ** 2)
        )

    def ahead_sigma_s(self, age_s: npt.ArrayLike, speed_mps: float = 7461.0) -> _Array:
        """The same as time [s], for ``ahead_s`` of `geometry.signal_path`; the speed is that of a LEO at 780 km."""
        return np.asarray(self.sigma_m(age_s) / speed_mps)


def walker(
    total: int,
    planes: int,
    phasing: int,
    *,
    inclination_rad: float,
    altitude_m: float,
    star: bool = False,
    duration_s: float,
    start_s: float = 0.0,
    step_s: float = 10.0,
    gmst_rad: float = 0.0,
    first_node_rad: float = 0.0,
    first_phase_rad: float = 0.0,
) -> list[SampledOrbit]:
    """Circular orbits of a Walker constellation i: total/planes/phasing, drifting with J2.

    Parameters
    ----------
    total, planes, phasing : int
    inclination_rad, altitude_m : float
        Altitude above the equator's radius.
    star : bool
        Nodes over 180 degrees, in place of 360.
    duration_s, start_s, step_s : float
        Samples from one step before `start_s` to one step after its end, so that light time stays inside.
    gmst_rad : float
        Greenwich sidereal time at time 0 (`gmst`).
    first_node_rad, first_phase_rad : float
        Right ascension of plane 0 and argument of latitude of its satellite 0 at time 0.

    Returns
    -------
    list of SampledOrbit
        Satellite s of plane p at index ``p * (total // planes) + s``.

    Raises
    ------
    ValueError
        For numbers out of range.
    """
    shape = _geometry.WalkerConstellation.star if star else _geometry.WalkerConstellation.delta
    made = shape(total, planes, phasing, inclination_rad, altitude_m)
    return made.sampled(start_s, duration_s, step_s, gmst_rad, first_node_rad, first_phase_rad)


def iridium_walker(
    duration_s: float,
    *,
    start_s: float = 0.0,
    step_s: float = 10.0,
    gmst_rad: float = 0.0,
    first_node_rad: float = 0.0,
    first_phase_rad: float = 0.0,
) -> list[SampledOrbit]:
    """The 66 of Iridium, made up: six planes of eleven at 86.4 degrees and 780 km.

    31.6 degrees between planes that go the same way, 22 at the seam, and 15.1 degrees of phase from plane to plane, as
    the elements of August 2014 have it. Parameters and result as for `walker`.
    """
    made = _geometry.WalkerConstellation.iridium()
    return made.sampled(start_s, duration_s, step_s, gmst_rad, first_node_rad, first_phase_rad)


def elevations(orbits: Sequence[SampledOrbit], t_s: npt.ArrayLike, p_e: npt.ArrayLike) -> tuple[_Array, _Array, _Array]:
    """Where a place sees transmitters, light time solved.

    Parameters
    ----------
    orbits : sequence of SampledOrbit
    t_s : array_like, shape (...)
    p_e : array_like, shape (3,)
        ECEF [m].

    Returns
    -------
    azimuth_rad, elevation_rad, range_m : ndarray, shape (orbits, ...)
        Azimuth from north towards east; elevation negative below the horizon. NaN outside an orbit's samples.
    """
    times = np.asarray(t_s, dtype=np.float64)
    seen = _geometry.look_at(list(orbits), times.reshape(-1), p_e)
    shape = (len(seen), *times.shape)
    return seen[..., 0].reshape(shape), seen[..., 1].reshape(shape), seen[..., 2].reshape(shape)


def visible(
    orbits: Sequence[SampledOrbit], t_s: float, p_e: npt.ArrayLike, mask_rad: float = 0.0
) -> tuple[npt.NDArray[np.int64], _Array]:
    """Which transmitters stand above a mask at one time, highest first.

    Returns
    -------
    indices : ndarray of int64, shape (k,)
        Into `orbits`.
    elevation_rad : ndarray, shape (k,)
        Of these.
    """
    elevation = elevations(orbits, float(t_s), p_e)[1]
    up = np.flatnonzero(elevation >= mask_rad)
    order = up[np.argsort(-elevation[up], kind="stable")]
    return order.astype(np.int64), elevation[order]


def excerpt(orbit: SampledOrbit, start_s: float, end_s: float) -> SampledOrbit:
    """The samples that cover a span of time, at least two: what one receiver hands to another.

    Raises
    ------
    ValueError
        When the orbit does not cover it.
    """
    if orbit.is_fixed:
        return orbit
    if not (orbit.start_s <= start_s <= end_s <= orbit.end_s):
        raise ValueError(
            f"start_s, end_s: {start_s} ... {end_s} is not within the orbit's {orbit.start_s} ... {orbit.end_s}"
        )
    first = min(int((start_s - orbit.start_s) // orbit.step_s), len(orbit) - 2)
    last = max(int(np.ceil((end_s - orbit.start_s) / orbit.step_s - 1e-9)), first + 1)
    rows = slice(first, last + 1)
    return SampledOrbit(
        orbit.start_s + first * orbit.step_s, orbit.step_s, orbit.position_e_m[rows], orbit.velocity_e_mps[rows]
    )


@dataclass(frozen=True)
class Pass:
    """A satellite above a mask.

    Attributes
    ----------
    index : int
        Of the orbit.
    rise_s, set_s, highest_s : float
        When it crosses the mask and stands highest. A pass cut by the span begins or ends with it.
    rise_azimuth_rad, set_azimuth_rad, highest_azimuth_rad, highest_elevation_rad, range_m : float
        Where it is then; the range is the one at its highest.
    doppler_hz : tuple of float
        Of the carrier as heard at rest at rise, highest and set.
    complete : bool
        It rises and sets within the span.
    """

    index: int
    rise_s: float
    highest_s: float
    set_s: float
    rise_azimuth_rad: float
    highest_azimuth_rad: float
    set_azimuth_rad: float
    highest_elevation_rad: float
    range_m: float
    doppler_hz: tuple[float, float, float]
    complete: bool


def passes(
    orbits: Sequence[SampledOrbit],
    p_e: npt.ArrayLike,
    start_s: float,
    end_s: float,
    *,
    mask_rad: float = 0.0,
    carrier_hz: float = 1626.270833e6,
) -> list[Pass]:
    """The passes of satellites over a place between two times, by time of rising; within 0.1 s.

    Parameters
    ----------
    orbits : sequence of SampledOrbit
        Each must cover the span, and the light time before it.
    p_e : array_like, shape (3,)
        ECEF [m].
    start_s, end_s : float
    mask_rad : float
    carrier_hz : float
        Of the Dopplers; the default is Iridium's ring alert.

    Raises
    ------
    ValueError
        For an empty span, or an orbit that does not cover it.
    """
    if not (np.isfinite(start_s) and np.isfinite(end_s) and start_s < end_s):
        raise ValueError(f"start_s, end_s: {start_s} ... {end_s} is no span of time")
    if not (-np.pi / 2 <= mask_rad < np.pi / 2):
        raise ValueError(f"mask_rad: {mask_rad}, an angle from -pi/2 to below pi/2 expected")
    times = np.linspace(start_s, end_s, max(3, int(np.ceil((end_s - start_s) / 15.0)) + 1))
    elevation = elevations(orbits, times, p_e)[1]
    if np.isnan(elevation).any():
        index = int(np.flatnonzero(np.isnan(elevation).any(axis=1))[0])
        raise ValueError(
            f"orbits[{index}]: known from {orbits[index].start_s} to {orbits[index].end_s} s, not from {start_s} "
            f"(less the light time) to {end_s} s"
        )
    found: list[Pass] = []
    for index, orbit in enumerate(orbits):
        up = elevation[index] >= mask_rad
        # A pass may hide between two samples below the mask: refine every local maximum.
        for low, high in _spans(elevation[index], up, mask_rad):
            fine = times[low] + 0.1 * np.arange(int((times[high] - times[low]) / 0.1) + 2)
            fine = fine[fine <= times[high]]
            azimuth, height, distance = (row[0] for row in elevations([orbit], fine, p_e))
            above = np.flatnonzero(height >= mask_rad)
            if not above.size:
                continue
            first, last = int(above[0]), int(above[-1])
            top = first + int(np.argmax(height[first : last + 1]))
            instants = fine[[first, top, last]]
            rate = signal_path(orbit, instants, p_e).delay_rate
            doppler = [float(x) for x in -carrier_hz * rate]
            found.append(
                Pass(
                    index=index,
                    rise_s=float(fine[first]),
                    highest_s=float(fine[top]),
                    set_s=float(fine[last]),
                    rise_azimuth_rad=float(azimuth[first]),
                    highest_azimuth_rad=float(azimuth[top]),
                    set_azimuth_rad=float(azimuth[last]),
                    highest_elevation_rad=float(height[top]),
                    range_m=float(distance[top]),
                    doppler_hz=(doppler[0], doppler[1], doppler[2]),
                    complete=first > 0 and last < len(fine) - 1,
                )
            )
    return sorted(found, key=lambda one: (one.rise_s, one.index))


def _spans(elevation: _Array, up: npt.NDArray[np.bool_], mask_rad: float) -> list[tuple[int, int]]:
    """Index ranges of a coarse series that may hold a pass, each with a sample more on either side."""
    last = len(up) - 1
    edges = np.flatnonzero(np.diff(np.concatenate([[False], up, [False]]).astype(np.int8)))
    spans = [(max(0, int(a) - 1), min(last, int(b))) for a, b in edges.reshape(-1, 2)]
    # Within 15 s an elevation near the mask changes by less than two degrees for a low orbit.
    for k in range(1, last):
        near = mask_rad - 0.035 <= elevation[k] < mask_rad
        if near and elevation[k] >= elevation[k - 1] and elevation[k] >= elevation[k + 1]:
            spans.append((k - 1, k + 1))
    return spans


def _shifted(reference: datetime, seconds: float) -> datetime:
    return reference + timedelta(seconds=seconds)


def time_text(reference: datetime | str, t_s: float) -> str:
    """A time as ISO UTC to the second, of seconds after a reference."""
    return f"{_shifted(utc(reference), round(t_s)):%Y-%m-%dT%H:%M:%SZ}"


def read_orbits(path: str | os.PathLike[str]) -> list[Satellite]:
    """Elements from a file of either kind: TLE by the suffixes .tle, .txt and .3le, OMM otherwise."""
    suffix = Path(path).suffix.lower()
    return read_tle(path) if suffix in (".tle", ".txt", ".3le") else read_omm(path)
