"""What a characterisation may say, and snapshots in Python."""

from __future__ import annotations

import copy
import json
import struct
import sys
import zlib
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pydantic
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent / "support"))
from sopdb_bodies import tower

from soopnav_cpp import navigation
from soopnav_cpp.clock import TwoState
from soopnav_cpp.sopdb import records, snapshot
from soopnav_cpp.sopdb.fusion import Entry, answer_quality, fuse
from soopnav_cpp.sopdb.records import Characterization

NOON = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
BODY = tower("2026-03-01T12:00:00Z")


def changed(path: str, value: Any) -> dict[str, Any]:
    out = copy.deepcopy(BODY)
    at: Any = out
    *keys, last = path.split(".")
    for key in keys:
        at = at[key]
    at[last] = value
    return out


def test_a_body_reads_and_comes_back() -> None:
    body = Characterization.model_validate_json(json.dumps(BODY))
    assert Characterization.model_validate(body.to_json()) == body
    assert body.clock is not None
    assert body.clock.epoch == NOON
    offset = changed("clock.epoch", "2026-03-01T13:30:00.25+01:30")
    assert Characterization.model_validate(offset).to_json()["clock"]["epoch"] == "2026-03-01T12:00:00.250000Z"
    assert Characterization.model_validate(changed("source.name", " e\u0301a ")).source.name == "éa"
    semi = changed("position.covariance_m2", [[1, 1, 0], [1, 1, 0], [0, 0, 1]])  # rank two
    entry = Entry("a", "a", NOON, Characterization.model_validate(semi))
    assert fuse([entry, entry], NOON).position is not None


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        ("source.kind", "tv", "Input should be"),
        ("source.name", "", "at least 1 character"),
        ("source.name", "   ", "not only blanks"),
        ("source.name", "x" * 101, "at most 100 characters"),
        ("source.name", "\U0001d160" * 34, "at most 100 characters of normal form NFC expected, got 102"),
        ("source.name", "a\x00b", "U+0000"),
        ("source.name", "a\u202eb", "U+202E"),
        ("source.name", 5, "valid string"),
        ("source.carrier_hz", 0, "greater than or equal to 1000"),
        ("source.carrier_hz", "881e6", "a number expected"),
        ("source.carrier_hz", True, "a number expected"),
        ("source.carrier_hz", float("inf"), "finite number"),
        ("source.extra", 1, "not permitted"),
        ("position.p_e_m", [0, 0, 0], "0 m from the Earth's centre"),
        ("position.p_e_m", [6e7, 0, 0], "6e+07 m from"),
        ("position.p_e_m", [6.4e6, 0], "Field required"),
        ("position.p_e_m", [6.4e6, 0, float("nan")], "finite number"),
        ("position.covariance_m2", [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "variance [1][1] = -1 must be in"),
        ("position.covariance_m2", [[1, 2, 0], [2, 1, 0], [0, 0, 1]], "positive semi-definite"),
        ("position.covariance_m2", [[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]], "symmetric"),
        ("position.covariance_m2", [[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]], "positive semi-definite"),
        ("position.covariance_m2", [["4", 1, 0], [1, 9, 0], [0, 0, 1]], "a number expected"),
        ("position.covariance_m2", [[True, 0, 0], [0, 9, 0], [0, 0, 1]], "a number expected"),
        ("clock.covariance", [[True, 0], [0, 1e-22]], "a number expected"),
        ("noise.ln_covariance", [[1, "0"], [0, 1]], "a number expected"),
        ("clock.epoch", "2026-03-01T12:00:00", "with its zone"),
        ("clock.epoch", "yesterday", "a time of ISO 8601"),
        ("clock.epoch", 1772366400, "a time of ISO 8601"),
        ("clock.epoch", "1970-01-01T00:00:00Z", "after 1980-01-06"),
        ("clock.epoch", "9999-12-31T23:59:59-10:00", "between the years"),
        ("clock.bias_s", 1e6, "less than or equal to 86400"),
        ("clock.covariance", [[0, 0], [0, 1e-22]], "variance [0][0] = 0 must be in"),
        ("clock.covariance", [[1e-18, 1e-18], [1e-18, 1e-22]], "positive semi-definite"),
        ("noise.h0_s", -1e-23, "greater than or equal to"),
        ("noise.ln_covariance", [[65, 0], [0, 1]], "variance [0][0] = 65 must be in"),
        ("provenance.method", "guess", "Input should be"),
        ("provenance.independent", "yes", "valid boolean"),
        ("quality.duration_s", 0, "greater than 0"),
        ("quality.nis", -1, "greater than or equal to 0"),
    ],
)
def test_what_cannot_be_is_refused(path: str, value: Any, sentence: str) -> None:
    with pytest.raises(pydantic.ValidationError) as refusal:
        Characterization.model_validate(changed(path, value))
    assert sentence in str(refusal.value)
    assert path.split(".")[0] in str(refusal.value)


def test_times_in_the_future_are_refused_beyond_the_skew() -> None:
    now = datetime.now(timezone.utc)
    Characterization.model_validate(changed("clock.epoch", (now + timedelta(seconds=10)).isoformat()))
    with pytest.raises(pydantic.ValidationError, match="not more than 30 s in the future"):
        Characterization.model_validate(changed("clock.epoch", (now + timedelta(seconds=60)).isoformat()))


def test_something_must_be_said() -> None:
    nothing = {k: v for k, v in BODY.items() if k not in ("position", "clock", "noise")}
    with pytest.raises(pydantic.ValidationError, match="at least one of position, clock and noise"):
        Characterization.model_validate(nothing)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([f"{a}.{b}" for a, part in BODY.items() for b in part] + list(BODY)), JSON)
def test_anything_anywhere_is_read_or_refused(path: str, value: Any) -> None:
    try:
        body = Characterization.model_validate(changed(path, value))
    except pydantic.ValidationError:
        return
    fuse([Entry("a", "a", NOON, body)], NOON).answer()  # whatever is read can be fused


@given(JSON)
def test_any_body_is_refused_with_its_own_error(value: Any) -> None:
    with pytest.raises(pydantic.ValidationError):
        Characterization.model_validate(value)


def answered(name: str, *, part: str | None = None) -> dict[str, Any]:
    body = BODY if part is None else {k: v for k, v in BODY.items() if k != part}
    entry = Entry(name, name, NOON, Characterization.model_validate(body))
    return {
        "id": name,
        "kind": "cdma",
        "name": f"naïve {name}",
        "carrier_hz": 881.52e6,
        **fuse([entry], NOON).answer(),
        "quality": answer_quality([entry], NOON),
    }


def test_a_snapshot_answers_as_the_service_does() -> None:
    sources = [answered("b"), answered("a", part="position"), answered("c", part="clock"), answered("d", part="noise")]
    catalog = snapshot.Catalog(snapshot.encode(sources, NOON))
    assert list(catalog) == ["a", "b", "c", "d"]
    assert catalog.created == NOON
    assert "b" in catalog
    assert "e" not in catalog
    later = NOON + timedelta(hours=2, microseconds=5)
    for source in sources:
        got = catalog.source(source["id"])
        assert {k: got[k] for k in ("name", "kind", "carrier_hz")} == {
            k: source[k] for k in ("name", "kind", "carrier_hz")
        }
        assert got["quality"] == source["quality"]
        for part in ("position", "clock"):
            assert got[part] == source[part]
        records.AnsweredSource.model_validate(catalog.source(source["id"], later))
    assert catalog.near([6378137.0, 10.0, 20.0], 1.0) == ["b", "c", "d"]
    assert catalog.sources(later, kind="lte") == []
    with pytest.raises(ValueError, match="id = e must be one"):
        catalog.source("e")


def test_grades_of_a_snapshot_fall_with_age() -> None:
    source = answered("a")
    for kept, expected in (("A", "ABBCD"), ("B", "BBBCD"), ("C", "CCCCD"), ("D", "DDDDD")):
        source["quality"] = source["quality"] | {"grade": kept}
        catalog = snapshot.Catalog(snapshot.encode([source], NOON))
        days = (1.0, 1.1, 7.0, 30.0, 30.1)
        found = [catalog.source("a", NOON + timedelta(days=d))["quality"]["grade"] for d in days]
        assert "".join(found) == expected
    late = snapshot.Catalog(snapshot.encode([source | {"quality": source["quality"] | {"grade": "A"}}], NOON))
    assert late.source("a", NOON - timedelta(days=40))["quality"]["grade"] == "A"


def test_a_time_before_the_snapshot_is_answered_as_cpp_does() -> None:
    catalog = snapshot.Catalog(snapshot.encode([answered("a"), answered("b", part="noise")], NOON))
    before = NOON - timedelta(days=3, microseconds=7)
    for name in catalog:
        prior, source = catalog.prior(name, before), catalog.source(name, before)
        assert prior.clock is not None
        assert prior.position is not None
        clock = source["clock"]
        assert clock["epoch"] == before.isoformat().replace("+00:00", "Z")
        assert np.allclose(prior.clock.value / 299_792_458.0, [clock["bias_s"], clock["drift"]], rtol=1e-9, atol=0)
        scaled = prior.clock.covariance / 299_792_458.0**2
        assert np.allclose(scaled, clock["covariance"], rtol=1e-9, atol=0)
        assert clock["covariance"][0][1] < 0.0
        assert np.allclose(prior.position.covariance, source["position"]["covariance_m2"], rtol=1e-9, atol=0)
    assert [source["id"] for source in catalog.sources(before)] == ["a", "b"]
    clock = answered("a")["clock"] | {"epoch": NOON.replace(year=9000).isoformat()}
    ahead = snapshot.Catalog(snapshot.encode([answered("a") | {"clock": clock}], NOON))
    with pytest.raises(ValueError, match="a time nearer to"):
        ahead.source("a", NOON)


@pytest.mark.parametrize(
    ("at", "value", "sentence"),
    [
        (24, (2**62).to_bytes(8, "little"), "a time of its making between the years 1 and 9999"),
        (40 + 456, (2**62).to_bytes(8, "little"), "record 0: a newest contribution between"),
        (40 + 464, (-(2**62)).to_bytes(8, "little", signed=True), "record 0: a state between"),
        (40 + 584, struct.pack("<d", 1e6), "record 0: logarithms of noise below 200"),
        (40, b"\xff", "record 0: an id and a name of UTF-8 without control characters"),
        (80, b"\x1b[2J", "record 0: an id and a name of UTF-8 without control characters"),
    ],
)
def test_a_snapshot_that_cannot_be_shown_is_refused(at: int, value: bytes, sentence: str) -> None:
    data = bytearray(snapshot.encode([answered("a")], NOON))
    data[at : at + len(value)] = value
    data[36:40] = zlib.crc32(data[:36] + data[40:]).to_bytes(4, "little")
    with pytest.raises(ValueError, match=sentence):
        snapshot.Catalog(bytes(data))


def test_python_and_cpp_bring_a_clock_to_the_same_time() -> None:
    catalog = snapshot.Catalog(snapshot.encode([answered("a"), answered("b", part="noise")], NOON))
    later = NOON + timedelta(days=3)
    light = 299_792_458.0
    for name in catalog:
        prior, source = catalog.prior(name, later), catalog.source(name, later)
        assert prior.clock is not None
        assert prior.position is not None
        np.testing.assert_allclose(prior.clock.value, [light * source["clock"][k] for k in ("bias_s", "drift")])
        np.testing.assert_allclose(
            prior.clock.covariance, light**2 * np.array(source["clock"]["covariance"]), rtol=1e-9
        )
        np.testing.assert_allclose(prior.position.covariance, source["position"]["covariance_m2"], rtol=1e-9)
    assert catalog.prior("a", later).noise_known
    assert catalog.prior("b", later).noise == pytest.approx(TwoState.tcxo().noise)


def test_a_navigator_starts_a_source_from_the_catalogue() -> None:
    later = NOON + timedelta(hours=1)
    catalog = snapshot.Catalog(snapshot.encode([answered("a"), answered("b", part="clock")], NOON))
    navigator = navigation.OpportunisticNavigator([6378137.0, 0.0, 0.0], position_sigma_m=100.0, clock=TwoState.tcxo())
    for name in catalog:
        navigator.add_source(name, "cdma", **catalog.prior(name, later).as_source())
    start = catalog.prior("a", later).as_source()
    source = catalog.source("a", later)
    assert start["clock_bias_s"] == pytest.approx(source["clock"]["bias_s"], rel=1e-12)
    np.testing.assert_allclose(start["clock_covariance"], source["clock"]["covariance"], rtol=1e-9)
    assert "clock_bias_s" not in catalog.prior("b", later).as_source()


def test_files_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "signals.sopcat"
    data = snapshot.encode([answered("a")], NOON)
    assert len(snapshot.write(path, data)) == 1
    with pytest.raises(ValueError, match="snapshot: "):
        snapshot.write(path, data[:-1])
    assert path.read_bytes() == data
    assert list(tmp_path.iterdir()) == [path]
    assert len(snapshot.read(path)) == 1
    path.write_bytes(data[:100])
    with pytest.raises(ValueError, match=r"signals.sopcat: snapshot: 1 records of 624 bytes expected, got 60"):
        snapshot.read(path)
    with pytest.raises(FileNotFoundError):
        snapshot.read(tmp_path / "none")
    version = bytearray(data)
    version[8:10] = struct.pack("<H", 7)
    with pytest.raises(ValueError, match="version 7; this program reads version 1"):
        snapshot.Catalog(bytes(version))


@given(st.binary(max_size=200), st.integers(0, 663))
def test_damage_is_noticed(data: bytes, at: int) -> None:
    with pytest.raises(ValueError, match="snapshot: "):
        snapshot.Catalog(data)
    good = snapshot.encode([answered("a")], NOON)
    damaged = good[:at] + bytes([good[at] ^ 0x40]) + good[at + 1 :]
    with pytest.raises(ValueError, match="snapshot: "):
        snapshot.Catalog(damaged)


def test_what_is_no_source_is_not_encoded() -> None:
    with pytest.raises(ValueError, match="an id of its own"):
        snapshot.encode([answered("a"), answered("a")], NOON)
    with pytest.raises(ValueError, match="kind"):
        snapshot.encode([answered("a") | {"kind": "tv"}], NOON)
