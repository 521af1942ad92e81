"""Where a signal database lies: URLs, places, distances, names."""

from __future__ import annotations

import functools
import json
import sqlite3
import sys
import types
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
from sopdb_bodies import characterization

from soopnav_cpp import geometry
from soopnav_cpp.sopdb import matching, spatial
from soopnav_cpp.sopdb.contributing import Entries
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.store import Store


@pytest.mark.unit
def test_names_that_read_alike_are_one() -> None:
    assert matching.name_key("ＰＮ　12") == matching.name_key(" pn 12") == "pn 12"
    assert matching.name_key("Straße") == matching.name_key("STRASSE")
    assert len(matching.name_key("ﷺ" * 100)) <= 400


@pytest.mark.law
def test_a_box_around_holds_all_within() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        latitude = float(np.degrees(np.arcsin(rng.uniform(-1, 1)))) if rng.random() < 0.7 else rng.choice([-90.0, 90.0])
        longitude, radius = float(rng.uniform(-180, 180)), float(10 ** rng.uniform(1, 7))
        box = spatial.around(latitude, longitude, radius)
        # Places on a circle of that distance and inside it, by directions from the middle on the sphere.
        angle, heading = rng.uniform(0, 1, 40) * min(radius / 6.36e6, np.pi), rng.uniform(0, 2 * np.pi, 40)
        up = np.array([np.cos(np.radians(latitude)), 0.0, np.sin(np.radians(latitude))])
        north, east = np.array([-up[2], 0.0, up[0]]), np.array([0.0, 1.0, 0.0])
        there = (
            np.cos(angle)[:, None] * up
            + (np.sin(angle) * np.cos(heading))[:, None] * north
            + (np.sin(angle) * np.sin(heading))[:, None] * east
        )
        at = np.degrees(np.arcsin(np.clip(there[:, 2], -1, 1)))
        lon = (longitude + np.degrees(np.arctan2(there[:, 1], there[:, 0])) + 180.0) % 360.0 - 180.0
        near = spatial.distances_m(latitude, longitude, at, lon) <= radius
        in_longitude = (
            (lon >= box.west_deg) & (lon <= box.east_deg)
            if box.west_deg <= box.east_deg
            else (lon >= box.west_deg) | (lon <= box.east_deg)
        )
        inside = (at >= box.south_deg) & (at <= box.north_deg) & in_longitude
        assert near.sum() > 5
        assert np.all(inside[near]), (latitude, longitude, radius)


@pytest.mark.crosscheck
def test_distances_are_straight_lines() -> None:
    found = spatial.distances_m(0.0, 0.0, np.array([0.0, 90.0, 0.0]), np.array([180.0, 0.0, 90.0]))
    assert found == pytest.approx([2 * 6378137.0, np.hypot(6378137.0, 6356752.314245), np.sqrt(2) * 6378137.0])


@pytest.mark.unit
def test_parsed_contributions_are_of_their_row() -> None:
    entries = Entries()
    of = functools.partial(types.SimpleNamespace, id=1, token_id="ann", received_us=5)
    one, other = (json.dumps(characterization(name)) for name in ("one", "other"))
    first = entries.of(of(body=one, body_hash=b"1"))
    assert entries.of(of(body=one, body_hash=b"1")) is first
    assert entries.of(of(body=other, body_hash=b"2")).body.source.name == "other"
    assert entries.of(of(body=other, body_hash=b"2", token_id="bob")).contributor == "bob"


@pytest.mark.unit
@pytest.mark.parametrize(
    "given", ["sqlite://", "sqlite:///:memory:", "mysql://a@b/c", "postgres", "://", "sqlite:///a?mode=ro"]
)
def test_urls(given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if given == "postgres":  # a path
        Store(given).close()
        assert sqlite3.connect("postgres").execute("SELECT count(*) FROM sources").fetchone() == (0,)
        return
    with pytest.raises(ValueError, match="url"):
        Store(given)


@pytest.mark.unit
def test_a_database_that_does_not_answer(tmp_path: Path) -> None:
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        Store(f"sqlite:///{tmp_path / 'no' / 'folder.db'}")
    (tmp_path / "text.db").write_text("no database, only text of some length" * 100)
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        Store(str(tmp_path / "text.db"))
    pytest.importorskip("psycopg")
    with pytest.raises(DatabaseUnavailableError, match="does not answer"):
        Store(f"postgresql://nobody:secret@/x?host={tmp_path}")


@pytest.mark.unit
def test_passwords_are_not_shown(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    with pytest.raises(DatabaseUnavailableError) as caught:
        Store(f"postgresql://nobody:secret@/x?host={tmp_path}")
    assert "secret" not in str(caught.value)


@pytest.mark.unit
def test_a_place_is_that_of_the_engine() -> None:
    latitude, longitude = spatial.place(geometry.geodetic_to_ecef(0.3, -1.2, 50.0).tolist())
    assert (latitude, longitude) == pytest.approx((np.degrees(0.3), np.degrees(-1.2)))
