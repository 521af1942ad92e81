"""Measurements and orbits: as arrays, from RINEX files, and synthetic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from soopnav_cpp import _rinex
from soopnav_cpp._core import gnss as _gnss

_Array = npt.NDArray[np.float64]
_LIGHT_MPS = 299_792_458.0

L1_HZ = 1575.42e6
"""Carrier of L1 [Hz]."""
L1_M = _LIGHT_MPS / L1_HZ
"""Its wavelength [m]."""

# The signal that is read of each system: the open one on or next to L1.
_CODES = {"G": "1C", "E": "1C", "J": "1C", "R": "1C", "S": "1C", "C": "2I", "I": "5A"}

_COLUMNS = (
    ("prn", np.int64),
    ("week", np.int64),
    ("health", np.int64),
    ("iode", np.int64),
    ("toe_s", np.float64),
    ("toc_s", np.float64),
    ("af0_s", np.float64),
    ("af1", np.float64),
    ("af2_ps", np.float64),
    ("tgd_s", np.float64),
    ("sqrt_a", np.float64),
    ("eccentricity", np.float64),
    ("m0_rad", np.float64),
    ("delta_n_radps", np.float64),
    ("omega_rad", np.float64),
    ("omega0_rad", np.float64),
    ("omega_dot_radps", np.float64),
    ("i0_rad", np.float64),
    ("i_dot_radps", np.float64),
    ("cuc_rad", np.float64),
    ("cus_rad", np.float64),
    ("crc_m", np.float64),
    ("crs_m", np.float64),
    ("cic_rad", np.float64),
    ("cis_rad", np.float64),
    ("fit_interval_s", np.float64),
)


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Observations:
    """What a receiver measured, one row for each epoch and one column for each satellite; NaN where there is nothing.

    Arrays are read-only.

    Attributes
    ----------
    week : ndarray of int64, shape (n,)
        GPS week of each epoch on the receiver's clock.
    time_of_week_s : ndarray, shape (n,)
        Second of that week (to 1 µs).
    satellites : tuple of str, length s
        Names, ascending: ``"G05"``.
    code_m : ndarray, shape (n, s)
        Pseudoranges.
    phase_cycles : ndarray, shape (n, s)
        Carrier phases; they grow with the range.
    doppler_hz : ndarray, shape (n, s)
        Positive when approaching.
    cn0_dbhz : ndarray, shape (n, s)
        Carrier to noise density as the receiver states it.
    lli : ndarray of uint8, shape (n, s)
        RINEX loss-of-lock indicator: bit 0 the count of cycles was lost, bit 1 half a cycle is open.
    approximate_position_ecef_m : ndarray, shape (3,)
        The file's APPROX POSITION XYZ; NaN when it has none.
    problems : tuple of str
        What was left out of the file, with the line.

    Raises
    ------
    ValueError
        For shapes that do not fit.
    """

    week: npt.NDArray[np.int64]
    time_of_week_s: _Array
    satellites: tuple[str, ...]
    code_m: _Array
    phase_cycles: _Array
    doppler_hz: _Array
    cn0_dbhz: _Array
    lli: npt.NDArray[np.uint8]
    approximate_position_ecef_m: _Array
    problems: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, s = len(self.time_of_week_s), len(self.satellites)
        shapes: dict[str, tuple[int, ...]] = {"week": (n,), "time_of_week_s": (n,), "approximate_position_ecef_m": (3,)}
        shapes.update(dict.fromkeys(("code_m", "phase_cycles", "doppler_hz", "cn0_dbhz", "lli"), (n, s)))
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name}: shape {shape} expected, got {np.shape(getattr(self, name))}")

    def __len__(self) -> int:
        return len(self.time_of_week_s)

    def __repr__(self) -> str:
        if not len(self):
            return f"Observations(no epoch, {len(self.problems)} problems)"
        return (
            f"Observations({len(self)} epochs of {len(self.satellites)} satellites, week {self.week[0]} "
            f"from {self.time_of_week_s[0]:g} s, {len(self.problems)} problems)"
        )

    @property
    def elapsed_s(self) -> _Array:
        """Seconds since the first epoch, shape (n,)."""
        if not len(self):
            return np.empty(0)
        elapsed: _Array = (self.week - self.week[0]) * 604_800.0 + (self.time_of_week_s - self.time_of_week_s[0])
        return elapsed

    @property
    def prn(self) -> npt.NDArray[np.int64]:
        """GPS numbers of the satellites, shape (s,); 0 for another system's."""
        return np.array([int(name[1:]) if name.startswith("G") else 0 for name in self.satellites], dtype=np.int64)


class Ephemerides:
    """Broadcast orbits and clocks of GPS satellites, in the Keplerian set of IS-GPS-200.

    Parameters
    ----------
    messages : sequence of mapping, or structured array
        The fields of `records`, by name; those left out are 0 (``fit_interval_s``: four hours).
    klobuchar : array_like, shape (8,), optional
        Coefficients α0 … α3, β0 … β3 of the broadcast ionosphere.
    problems : sequence of str, optional

    Raises
    ------
    ValueError
        For a field that breaks its rule.
    """

    def __init__(
        self,
        messages: Sequence[Mapping[str, float]] | npt.NDArray[Any],
        klobuchar: npt.ArrayLike | None = None,
        problems: Sequence[str] = (),
    ) -> None:
        names = [name for name, _ in _COLUMNS]
        rows = np.zeros((len(messages), len(names)))
        for i, message in enumerate(messages):
            keys = message.dtype.names if isinstance(message, np.void) else tuple(message)
            unknown = set(keys or ()) - set(names)
            if unknown:
                raise ValueError(f"messages[{i}]: unknown field {sorted(unknown)[0]!r}; known are {', '.join(names)}")
            for j, name in enumerate(names):
                rows[i, j] = message[name] if name in (keys or ()) else 14_400.0 if name == "fit_interval_s" else 0.0
        self._table = _gnss.EphemerisTable(rows)
        self._klobuchar: _Array | None = None
        if klobuchar is not None:
            self._klobuchar = _read_only(np.array(klobuchar, dtype=np.float64))
            if self._klobuchar.shape != (8,) or not np.isfinite(self._klobuchar).all():
                raise ValueError(f"klobuchar: eight finite numbers expected, got shape {self._klobuchar.shape}")
        self._problems = tuple(problems)

    @property
    def records(self) -> npt.NDArray[Any]:
        """All messages as a structured array, sorted by satellite and reference time. Angles in radians."""
        rows = self._table.rows()
        out = np.zeros(len(rows), dtype=list(_COLUMNS))
        for j, (name, _) in enumerate(_COLUMNS):
            out[name] = rows[:, j]
        return _read_only(out)

    @property
    def prns(self) -> tuple[int, ...]:
        """The satellites' numbers, ascending."""
        return tuple(self._table.prns())

    @property
    def klobuchar(self) -> _Array | None:
        """Coefficients α0 … α3, β0 … β3 of the broadcast ionosphere, or None."""
        return self._klobuchar

    @property
    def problems(self) -> tuple[str, ...]:
        """What was left out of the file they were read from, with the line."""
        return self._problems

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        return f"Ephemerides({len(self)} messages of {len(self.prns)} satellites, {len(self.problems)} problems)"


def read_observations(
    path: str | Path, systems: str = "G", *, codes: Mapping[str, str] | None = None, interval_s: float | None = None
) -> Observations:
    """Measurements of a RINEX 3 observation file, through georinex.

    Of each system one signal is read: the open one at or next to L1 (``C1C``, ``L1C``, ``D1C``, ``S1C`` of GPS). Epochs
    that are cut short, cannot be read or are events are left out and named in ``problems``. About 7 ms for an epoch.

    Parameters
    ----------
    path : str or Path
    systems : str
        Letters of the systems: ``"GE"`` reads GPS and Galileo.
    codes : mapping of str to str, optional
        The signal to read of a system, such as ``{"G": "2W"}``.
    interval_s : float, optional
        Only epochs this far apart.

    Returns
    -------
    Observations

    Raises
    ------
    ValueError
        For a file that is no RINEX 3 observation file or ends in its header, and a system that is not in it.
    MissingExtraError
        Without the extra ``gnss``.
    """
    if not systems or any(system not in _CODES for system in systems) or len(set(systems)) != len(systems):
        raise ValueError(f"systems = {systems!r}: letters of {''.join(_CODES)!r} expected, each once")
    if interval_s is not None and not interval_s > 0.0:
        raise ValueError(f"interval_s = {interval_s} must be positive")
    found = _rinex.read_observations(path, systems, {**_CODES, **(codes or {})}, interval_s)
    columns = {key: _read_only(values) for key, values in found.columns.items() if key != "lli"}
    return Observations(
        week=_read_only(found.week),
        time_of_week_s=_read_only(found.time_of_week_s),
        satellites=found.satellites,
        code_m=columns["C"],
        phase_cycles=columns["L"],
        doppler_hz=columns["D"],
        cn0_dbhz=columns["S"],
        lli=_read_only(np.nan_to_num(found.columns["lli"]).astype(np.uint8)),
        approximate_position_ecef_m=_read_only(found.position),
        problems=found.problems,
    )


def read_navigation(path: str | Path) -> Ephemerides:
    """GPS orbits and clocks of a RINEX 3 navigation file (also a mixed one), through georinex.

    Messages that are cut short or cannot be read are left out and named in ``problems``.

    Raises
    ------
    ValueError
        For a file that is no RINEX 3 navigation file or ends in its header.
    MissingExtraError
        Without the extra ``gnss``.
    """
    messages, klobuchar, problems = _rinex.read_navigation(path)
    sound, unsound = [], []
    for message in messages:
        try:
            Ephemerides([message])
            sound.append(message)
        except ValueError as error:
            unsound.append(f"{path}: {error}; message left out")
    return Ephemerides(sound, klobuchar, (*problems, *unsound))


def walker_constellation(
    satellites: int = 24,
    planes: int = 6,
    phasing: int = 1,
    *,
    inclination_rad: float = np.deg2rad(55.0),
    radius_m: float = 26_559_710.0,
    week: int = 2200,
    toe_s: float = 0.0,
    first_node_rad: float = 0.0,
    fit_interval_s: float = 86_400.0,
) -> Ephemerides:
    """A synthetic constellation: circular orbits satellites/planes/phasing after Walker, with perfect clocks.

    Parameters
    ----------
    satellites : int
        In all, a multiple of `planes`, at most 64; numbered from 1, plane by plane.
    planes, phasing : int
        Phasing shifts neighbouring planes by multiples of 2π/satellites.
    inclination_rad, radius_m : float
    week, toe_s : int, float
        Reference time of all orbits.
    first_node_rad : float
        Longitude of the first plane's ascending node at that time.
    fit_interval_s : float
        How long they may be used, centred on the reference time.

    Raises
    ------
    ValueError
        For a number out of range.
    """
    rows = _gnss.walker_constellation(
        satellites, planes, phasing, inclination_rad, radius_m, week, toe_s, first_node_rad, fit_interval_s
    )
    return Ephemerides([dict(zip((name for name, _ in _COLUMNS), row, strict=True)) for row in rows])
