"""How old a peer's elements are reaches its tracker: as deviations along the orbits, which are estimated."""

import numpy as np
import pytest

from soopnav_cpp import orbits
from soopnav_cpp.geometry import SampledOrbit
from soopnav_cpp.navigation import CooperativeTracker
from soopnav_cpp.peer import track
from soopnav_cpp.peer.beacons import Beacons

PLACE = np.array([2_885_000.0, 1_345_000.0, 5_509_000.0])
DAY_S = 86_400.0


def beacons(*ages_s: float) -> Beacons:
    known = {f"IRIDIUM {k}": SampledOrbit.fixed(PLACE + 7e5) for k in range(len(ages_s) or 2)}
    epochs = {name: 1e9 - age for name, age in zip(known, ages_s, strict=True)} if ages_s else None
    return Beacons(known, 1e9, epochs_unix_s=epochs)


def test_errors_grow_with_age_and_are_never_too_small() -> None:
    model = orbits.AlongTrackError()
    options = beacons(0.5 * DAY_S, 4.0 * DAY_S).orbit_error()
    at = np.array([0.0, 0.5, 1.0, 2.0, 4.0]) * DAY_S
    given = options["orbit_sigma_m"] + options["orbit_sigma_mps"] * at
    assert np.all(given >= model.sigma_m(at) - 1e-6)
    assert given[[0, -1]] == pytest.approx(model.sigma_m(at[[0, -1]]))
    assert options["along_track_states"] > 0
    assert beacons().orbit_error() == {}


def test_the_tracker_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told = []

    class Listening(CooperativeTracker):
        def __init__(self, *arguments, **options) -> None:
            told.append(options)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(track, "CooperativeTracker", Listening)
    track.Track(beacons(DAY_S, DAY_S), PLACE)
    track.Track(beacons(DAY_S, DAY_S), PLACE, orbit_sigma_m=7.0)
    track.Track(beacons(), PLACE)
    assert told[0]["orbit_sigma_m"] + DAY_S * told[0]["orbit_sigma_mps"] == pytest.approx(
        float(orbits.AlongTrackError().sigma_m(DAY_S))
    )
    assert told[0]["along_track_states"] == 16
    assert told[1]["orbit_sigma_m"] == 7.0
    assert "orbit_sigma_m" not in told[2]
