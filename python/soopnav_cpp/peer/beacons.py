"""Which beacon a burst came from: carriers on their channels, and the Doppler that each beacon in view should have."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import numpy.typing as npt

from soopnav_cpp import iridium, orbits
from soopnav_cpp.geometry import SampledOrbit, signal_path

__all__ = ["Beacons", "Candidate", "read_beacons"]

_LEO_SPEED_MPS = 7.6e3
_LEO_HEIGHT_M = 780e3
_LIVE_S = 6 * 3600.0  # of ephemeris for a source without an end
_MARGIN_S = 120.0
_LIGHT_MPS = 299_792_458.0


@dataclass(frozen=True)
class Candidate:
    """A beacon that a carrier may be of.

    Attributes
    ----------
    index : int
    name : str
    carrier_hz : float
        As sent.
    residual_hz : float
        What was heard less what was expected, by a perfect clock.
    """

    index: int
    name: str
    carrier_hz: float
    residual_hz: float


class Beacons:
    """Beacons by name, and where they are.

    Parameters
    ----------
    orbits : mapping of str to geometry.SampledOrbit
        A name that ends in ``@HZ`` is a transmitter on that carrier; the others are Iridium satellites.
    reference_unix_s : float
        What the orbits' time counts from.
    epochs_unix_s : mapping of str to float, optional
        Of the elements.
    mask_rad : float
        Least elevation.
    """

    def __init__(
        self,
        orbits: Mapping[str, SampledOrbit],
        reference_unix_s: float,
        *,
        epochs_unix_s: Mapping[str, float] | None = None,
        mask_rad: float = math.radians(5.0),
    ) -> None:
        if not orbits:
            raise ValueError("no beacons")
        self.names = list(orbits)
        self.orbits = list(orbits.values())
        self.reference_unix_s = reference_unix_s
        self.epoch_s: npt.NDArray[np.float64] | None = None
        if epochs_unix_s is not None:
            self.epoch_s = np.array([epochs_unix_s[name] - reference_unix_s for name in self.names])
        self._mask_rad = mask_rad
        self._carriers = [_carrier(name) for name in self.names]
        self._number = {name: index for index, name in enumerate(self.names)}

    def __len__(self) -> int:
        return len(self.names)

    def orbit_error(self) -> dict[str, float]:
        """How far beacons may be along their orbits, as options of `navigation.CooperativeTracker`.

        By `orbits.AlongTrackError` and the age of each one's elements: exact for the oldest and at the epoch, no less
        in between. The errors are estimated, 16 at a time. None where an ephemeris says where they are.
        """
        if self.epoch_s is None:
            return {}
        model = orbits.AlongTrackError()
        oldest_s = max(float(np.max(np.abs(self.epoch_s))), 1.0)
        growth = (float(model.sigma_m(oldest_s)) - model.at_epoch_m) / oldest_s
        return {"orbit_sigma_m": model.at_epoch_m, "orbit_sigma_mps": growth, "along_track_states": 16}

    def index(self, name: str) -> int | None:
        """Of a name; None for a stranger."""
        return self._number.get(name)

    def candidates(
        self,
        t_s: float,
        received_hz: float,
        p_e: npt.NDArray[np.float64],
        *,
        skew: float,
        sigma_hz: float,
        within_m: float,
    ) -> list[Candidate]:
        """Beacons above the mask whose carrier would be heard at `received_hz`, nearest first.

        Parameters
        ----------
        t_s : float
            By the orbits' reference.
        received_hz : float
        p_e : ndarray, shape (3,)
            Receiver, ECEF.
        skew : float
            Largest of the receiver's clock.
        sigma_hz : float
            Of `received_hz`.
        within_m : float
            The receiver is no further from `p_e` than this.
        """
        elevation = orbits.elevations(self.orbits, t_s, p_e)[1]
        lower = within_m / _LEO_HEIGHT_M  # of elevation, by where the receiver may be
        found = []
        for index in np.flatnonzero(elevation >= self._mask_rad - lower):
            orbit, fixed = self.orbits[index], self._carriers[index]
            path = signal_path(orbit, t_s, p_e)
            factor = 1.0 - float(path.delay_rate)
            if not math.isfinite(factor):
                continue
            if fixed is not None:
                carrier, reach_m = fixed, 0.0
            else:
                channel = round((received_hz / factor - 1616e6) / iridium.CHANNEL_SPACING_HZ + 0.5)
                if not 1 <= channel <= iridium.CHANNELS:
                    continue
                carrier, reach_m = iridium.channel_frequency_hz(channel), within_m
            moved_hz = carrier * _LEO_SPEED_MPS / _LIGHT_MPS * min(1.0, 1.5 * reach_m / float(path.range_m))
            tolerance = skew * carrier + moved_hz + 5.0 * sigma_hz + 50.0
            residual = received_hz - carrier * factor  # a fast clock hears lower
            if abs(residual) <= tolerance:
                found.append(Candidate(int(index), self.names[index], carrier, residual))
        return sorted(found, key=lambda candidate: abs(candidate.residual_hz))


def _carrier(name: str) -> float | None:
    _, at, text = name.rpartition("@")
    if not at:
        return None
    try:
        carrier = float(text)
    except ValueError:
        carrier = math.nan
    if not (math.isfinite(carrier) and carrier > 0.0):
        raise ValueError(f"beacon {name!r}: NAME@HZ with a carrier above zero expected")
    return carrier


def read_beacons(
    path: str | os.PathLike[str], start_unix_s: float, end_unix_s: float, *, mask_rad: float = math.radians(5.0)
) -> Beacons:
    """From an ephemeris file (``.npz``, ``.csv``), two-line elements (``.tle``, ``.txt``, ``.3le``) or OMM.

    Raises
    ------
    ValueError
        For a file that cannot be read, satellites that have decayed, an ephemeris that does not cover the recording.
    """
    file = Path(path)
    if file.suffix.lower() in (".npz", ".csv"):
        known = orbits.read_ephemeris(file)
        reference = known.reference.timestamp()
        moving = [orbit for orbit in known.orbits.values() if not orbit.is_fixed]
        first = max((orbit.start_s for orbit in moving), default=-math.inf) + reference
        last = min((orbit.end_s for orbit in moving), default=math.inf) + reference
        if first > start_unix_s or (last < end_unix_s and last < start_unix_s + 1.0):
            raise ValueError(f"{file}: its orbits do not cover the beginning of the recording")
        return Beacons(known.orbits, reference, mask_rad=mask_rad)
    begin = datetime.fromtimestamp(math.floor(start_unix_s - _MARGIN_S), timezone.utc)
    duration_s = min(end_unix_s - start_unix_s, _LIVE_S) + 2.0 * _MARGIN_S
    paths: dict[str, SampledOrbit] = {}
    epochs: dict[str, float] = {}
    for satellite in orbits.read_orbits(file):
        name = satellite.name if satellite.name not in paths else f"{satellite.name} {satellite.number}"
        paths[name] = satellite.sampled(begin, duration_s)
        epochs[name] = satellite.epoch.timestamp()
    if not paths:
        raise ValueError(f"{file}: no satellites")
    return Beacons(paths, begin.timestamp(), epochs_unix_s=epochs, mask_rad=mask_rad)
