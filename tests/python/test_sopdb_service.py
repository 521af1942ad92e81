"""Routes of the signal database: what is answered, refused and kept, and that nothing sent makes it fail."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
import sqlalchemy
from sopdb_api import Api
from sopdb_bodies import characterization, clock, noise, position

from soopnav_cpp.sopdb import answers as answers_module
from soopnav_cpp.sopdb import store as store_module
from soopnav_cpp.sopdb.contributing import Contributor
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.fusion import Entry, SourceState, answer_quality
from soopnav_cpp.sopdb.records import AnsweredSource, Characterization
from soopnav_cpp.sopdb.rendering import Rendered, zulu
from soopnav_cpp.sopdb.store import Store

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("template") / "signals.db"
    Store(str(path)).close()
    return path


@pytest.fixture
def api(template: Path, tmp_path: Path) -> Iterator[Api]:
    with Store(str(shutil.copy(template, tmp_path / "signals.db"))) as store:
        yield Api(store)


def at(seconds: float) -> str:
    return (datetime.now(timezone.utc) + timedelta(seconds=seconds)).isoformat().replace("+00:00", "Z")


def without(body: dict[str, Any], *path: str, **given: Any) -> dict[str, Any]:
    copy = json.loads(json.dumps(body))
    inner = copy
    for key in path:
        inner = inner[key]
    inner.update(given)
    return copy


def test_a_source_is_brought_to_the_asked_time(api: Api) -> None:
    answer = api.contribute(characterization(clock=clock(60.0)))
    assert answer.status_code == 201
    assert answer.json() == {"id": "1", "status": "accepted", "reasons": [], "source_id": "1"}
    assert answer.headers["location"] == "/v1/sources/1"
    early = AnsweredSource.model_validate(api.get(f"/v1/sources/1?at={at(0)}").json())
    late = AnsweredSource.model_validate(api.get(f"/v1/sources/1?at={at(3600)}").json())
    assert early.clock is not None
    assert late.clock is not None
    apart_s = (late.clock.epoch - early.clock.epoch).total_seconds()
    assert late.clock.bias_s - early.clock.bias_s == pytest.approx(2e-11 * apart_s, rel=1e-6)
    assert late.clock.covariance[0][0] > early.clock.covariance[0][0] + 1e-22 * apart_s**2 * 0.99
    assert late.clock.covariance[1][1] > early.clock.covariance[1][1]
    past = AnsweredSource.model_validate(api.get(f"/v1/sources/1?at={at(-3600)}").json())
    assert past.clock is not None
    assert past.clock.bias_s < early.clock.bias_s
    assert past.clock.covariance[0][0] > early.clock.covariance[0][0]
    now = AnsweredSource.model_validate(api.get("/v1/sources/1").json())
    assert now.clock is not None
    assert abs((now.clock.epoch - datetime.now(timezone.utc)).total_seconds()) < 60.0
    assert now.quality.contributions == 1
    assert now.quality.grade == "C"
    assert now.quality.age_s == pytest.approx(60.0, abs=30.0)


def test_grades_count_voices(api: Api) -> None:
    for k, grade in enumerate("CBA"):
        token = api.store.create_token(f"t{k}", "contribute").text
        assert api.contribute(characterization(clock=clock(60.0 - k)), role=token).status_code == 201
        assert api.get("/v1/sources/1").json()["quality"] | {"newest": 0, "age_s": 0} == {
            "contributions": k + 1,
            "newest": 0,
            "age_s": 0,
            "grade": grade,
        }


def test_lists_page_and_search(api: Api) -> None:
    for k in range(7):
        api.contribute(characterization(f"s{k}", position=position(60.0 + 0.1 * k), clock=clock(60.0)))
    api.contribute(characterization("m", "fm", carrier_hz=98e6, position=position(10.0, 179.9)))
    api.contribute(characterization("w", "fm", carrier_hz=99e6, position=position(10.0, -179.9)))
    seen, cursor = [], None
    while True:
        page = api.get("/v1/sources", params={"limit": 2} | ({"cursor": cursor} if cursor else {})).json()
        seen += [source["name"] for source in page["sources"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == [f"s{k}" for k in range(7)] + ["m", "w"]

    def names(query: str) -> list[str]:
        return [source["name"] for source in api.get(f"/v1/sources?{query}").json()["sources"]]

    assert names("kind=fm") == ["m", "w"]
    assert names("near=60.31,24.94&radius_m=15000") == ["s3", "s4", "s2"]
    assert names("near=10,180&radius_m=30000") == ["m", "w"]
    assert names("bbox=179,0,-179,20") == ["m", "w"]
    assert names("bbox=20,60.15,30,60.35") == ["s2", "s3"]
    assert names("bbox=20,60.15,30,60.35&kind=fm") == []
    assert names("near=60.31,24.94&radius_m=15000&limit=1") == ["s3"]


def test_what_was_contributed(api: Api) -> None:
    api.contribute(characterization())
    api.contribute(characterization(position=position(60.3), clock=clock(50.0)))
    for role, shown in (("admin", False), ("read", False)):
        page = api.get("/v1/sources/1/contributions", role=role).json()
        assert [one["status"] for one in page["contributions"]] == ["quarantined", "accepted"]
        assert "position" in page["contributions"][0]["reasons"][0]
        assert ("contributor" in page["contributions"][0]) is shown
    page = api.get("/v1/characterizations?status=quarantined").json()
    assert [one["id"] for one in page["contributions"]] == ["2"]
    assert len(page["contributions"][0]["contributor"]) == 10
    assert api.post("/v1/characterizations/2/release").json()["status"] == "accepted"
    assert api.get("/v1/characterizations?status=quarantined").json()["contributions"] == []
    assert api.post("/v1/characterizations/2/reject").json()["status"] == "rejected"
    first = api.get("/v1/sources/1/contributions?limit=1").json()
    second = api.get("/v1/sources/1/contributions", params={"limit": 1, "cursor": first["next_cursor"]}).json()
    assert [first["contributions"][0]["id"], second["contributions"][0]["id"]] == ["2", "1"]
    assert second["next_cursor"] is None


def test_stability_has_a_band(api: Api) -> None:
    api.contribute(characterization())
    curve = api.get("/v1/sources/1/stability").json()
    table = list(zip(curve["tau_s"], curve["lower"], curve["deviation"], curve["upper"], strict=True))
    assert all(low < middle < high for _, low, middle, high in table)
    one = min(table, key=lambda row: abs(row[0] - 1.0))
    assert one[2] == pytest.approx((1e-23 / 2 + 2 * 3.14159**2 / 3 * 1e-25) ** 0.5, rel=1e-3)
    api.contribute(characterization("quiet", noise=None))
    assert api.get("/v1/sources/2/stability").status_code == 404


def test_a_snapshot_is_read_again(api: Api, tmp_path: Path) -> None:
    from soopnav_cpp.sopdb import snapshot

    for k in range(3):
        api.contribute(characterization(f"s{k}"))
    answer = api.get("/v1/snapshot")
    assert answer.headers["content-type"] == "application/octet-stream"
    (tmp_path / "signals.sopcat").write_bytes(answer.content)
    catalog = snapshot.read(tmp_path / "signals.sopcat")
    assert [source["name"] for source in catalog.sources(datetime.now(timezone.utc))] == ["s0", "s1", "s2"]
    again = api.get("/v1/snapshot", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_a_snapshot_made_again_has_the_same_etag_and_grades_of_its_day(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    from soopnav_cpp.sopdb import snapshot

    api.contribute(characterization())
    first = api.get("/v1/snapshot")
    assert snapshot.Catalog(first.content).source("1")["quality"]["grade"] == "C"

    class Later(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) + timedelta(days=40)

    monkeypatch.setattr(answers_module, "datetime", Later)
    second = answers_module.Answers(api.store).snapshot()
    assert second.body != first.content
    assert second.etag == first.headers["etag"]
    catalog = snapshot.Catalog(second.body)
    assert catalog.created - snapshot.Catalog(first.content).created > timedelta(days=39)
    assert catalog.source("1")["quality"]["grade"] == "D"
    assert catalog._core.source("1")["grade"] == "D"  # as C++ reads it
    api.contribute(characterization("another"))
    assert answers_module.Answers(api.store).snapshot().etag != second.etag


def test_etags(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers_module.time, "time_ns", lambda: 1_900_000_000_500_000_000)
    api.contribute(characterization())
    for path in ("/v1/sources", "/v1/sources/1", "/v1/sources/1/stability", "/v1/sources?near=60.17,24.94"):
        weak = api.get(path).headers["etag"]
        assert weak.startswith('W/"')
        asked = path + ("&" if "?" in path else "?") + f"at={at(600)}"
        strong = api.get(asked).headers["etag"]
        assert strong.startswith('"')
        for where, tag in ((path, weak), (asked, strong)):
            for said in (tag, f'"x", {tag}', "*", f"W/{tag}" if tag[0] == '"' else tag[2:]):
                again = api.get(where, headers={"If-None-Match": said})
                assert (again.status_code, again.content) == (304, b"")
                assert again.headers["etag"] == tag
            assert api.get(where, headers={"If-None-Match": '"x"'}).status_code == 200
        assert api.get(asked.replace("at=", "at=2026-01-01T00:00:00Z&x=")).headers["etag"] != strong
    source, other = api.get("/v1/sources/1").headers["etag"], api.get(asked).headers["etag"]
    api.contribute(characterization(clock=clock(10.0)))
    assert api.get("/v1/sources/1", headers={"If-None-Match": source}).status_code == 200
    assert api.get(asked, headers={"If-None-Match": other}).status_code == 200
    source = api.get("/v1/sources/1").headers["etag"]
    monkeypatch.setattr(answers_module.time, "time_ns", lambda: 1_900_000_061_000_000_000)
    assert api.get("/v1/sources/1").headers["etag"] != source


def test_what_is_kept_is_never_older_than_a_write(api: Api) -> None:
    api.contribute(characterization())
    with Store(str(api.store.engine.url.database)) as other:
        for k in range(3):
            before = api.get("/v1/sources").json()["sources"][0]["quality"]["contributions"]
            assert before == k + 1
            other.contribute(
                Characterization.model_validate(characterization(clock=clock(40.0 - k))), Contributor(f"other{k}")
            ).result(30.0)


def test_a_source_that_goes_is_not_answered_from_memory(api: Api) -> None:
    api.contribute(characterization())
    api.contribute(characterization("other"))
    assert api.get("/v1/sources/1").status_code == 200
    api.post("/v1/characterizations/1/reject")
    assert api.get("/v1/sources/1").status_code == 404
    assert [source["name"] for source in api.get("/v1/sources").json()["sources"]] == ["other"]
    api.post("/v1/characterizations/1/release")
    assert api.get("/v1/sources/1").status_code == 200


@pytest.mark.law
def test_text_is_that_of_the_state(api: Api) -> None:
    parts: dict[str, Any] = {"position": position(-33.9, 151.2), "clock": clock(4000.0), "noise": noise()}
    for k in range(1, 8):
        kept = {name: parts[name] if k >> bit & 1 else None for bit, name in enumerate(parts)}
        name = 'ÅÄÖ "quoted" \\ \u2028 <b>' if k == 7 else f"s{k}"
        assert api.contribute(characterization(name, **kept)).json()["status"] == "accepted"
        row = api.store.source_rows([k])[k]
        said = json.loads(row.state)
        state = SourceState.from_json(said["state"])
        for later in (0.0, 1.25, 86400.0, 86400.000001, 8 * 86400.0, 40 * 86400.0, 500 * 86400.0):
            when = state.at + timedelta(seconds=later)
            text = Rendered(row, state, 1, 1).at(when, zulu(when))
            entry = Entry("1", "t", state.at, Characterization.model_construct(clock=None))
            expected = {"id": str(k), "kind": "cdma", "name": name, "carrier_hz": row.carrier_hz}
            expected |= state.moved(when).answer() | {"quality": answer_quality([entry], when)}
            assert _rounded(json.loads(text)) == _rounded(expected)


def _rounded(value: Any) -> Any:
    """Numbers to twelve digits: sums in another order differ in the last."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.12g}") if isinstance(value, float) else value


def test_headers_for_browsers_and_caches(api: Api) -> None:
    api.contribute(characterization())
    for path in ("/", "/v1/sources", "/v1/nowhere", "/health", "/openapi.json"):
        headers = api.get(path).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers
        assert "strict-transport-security" not in headers
    assert api.get("/v1/sources").headers["cache-control"] == "private, no-cache"
    assert api.get("/v1/sources").headers["vary"] == "Authorization"
    public = Api(api.store, role=None, public_read=True, https=True)
    assert public.get("/v1/sources").headers["cache-control"] == "public, no-cache"
    assert "max-age" in public.get("/v1/sources").headers["strict-transport-security"]
    assert api.get("/v1/audit").headers["cache-control"] == "no-store"
    asked = api("OPTIONS", "/v1/sources", headers={"Origin": "http://evil", "Access-Control-Request-Method": "GET"})
    assert asked.status_code == 405
    assert "access-control-allow-origin" not in asked.headers


def test_the_page_is_files_of_the_package_only(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "web" / "sub").mkdir(parents=True)
    for name, text in (("index.html", "<p>page"), ("sub/a.js", "1"), ("notes.txt", "private")):
        (tmp_path / "web" / name).write_text(text)
    (tmp_path / "secret.html").write_text("secret")
    monkeypatch.setattr("soopnav_cpp.sopdb.page.FOLDER", tmp_path / "web")
    api = Api(api.store, role=None)
    page = api.get("/")
    assert (page.text, page.headers["content-type"]) == ("<p>page", "text/html; charset=utf-8")
    assert api.get("/", headers={"If-None-Match": page.headers["etag"]}).status_code == 304
    assert api.get("/static/sub/a.js").headers["content-type"].startswith("text/javascript")
    for path in (
        "notes.txt",
        "..%2fsecret.html",
        "%2e%2e/secret.html",
        "sub/../../secret.html",
        "/etc/passwd",
        "sub",
        "",
    ):
        assert api.get(f"/static/{path}").status_code == 404


BODY = characterization()


@pytest.mark.parametrize(
    ("body", "field"),
    [
        (without(BODY, "position", covariance_m2=[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), "position.covariance_m2"),
        (without(BODY, "position", covariance_m2=[[1, 2, 0], [2, 1, 0], [0, 0, 1]]), "position.covariance_m2"),
        (without(BODY, "clock", covariance=[[1e-16, 1e-17], [0, 1e-20]]), "clock.covariance"),
        (without(BODY, "clock", epoch=at(3600)), "clock.epoch"),
        (without(BODY, "clock", epoch="2026-03-01T00:00:00"), "clock.epoch"),
        (without(BODY, "clock", bias_s="1"), "clock.bias_s"),
        (without(BODY, "clock", bias_s=10**400), "clock.bias_s"),
        (without(BODY, "noise", h0_s=-1e-20), "noise.h0_s"),
        (without(BODY, "noise", h0_s=True), "noise.h0_s"),
        (without(BODY, "source", name="a\0b"), "source.name"),
        (without(BODY, "source", name="x" * 101), "source.name"),
        (without(BODY, "source", name=""), "source.name"),
        (without(BODY, "source", kind="wifi"), "source.kind"),
        (without(BODY, "source", carrier_hz=0), "source.carrier_hz"),
        (without(BODY, "position", p_e_m=[0, 0, 0]), "position.p_e_m"),
        (without(BODY, "position", p_e_m=[1e6, 1]), "position.p_e_m"),
        (without(BODY, surprise=1), "surprise"),
        (without(BODY, "quality", duration_s=0), "quality.duration_s"),
        (BODY | {"position": None, "clock": None, "noise": None}, ""),
        ([BODY], ""),
        (None, ""),
        ("text", ""),
    ],
)
def test_bodies_that_do_not_fit_are_told_which_field(shared: Api, body: Any, field: str) -> None:
    text = json.dumps(body)
    answer = shared.post("/v1/characterizations", content=text, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert field in [error["field"] for error in answer.json()["errors"]] or any(
        error["field"].startswith(field) for error in answer.json()["errors"]
    )
    assert field in answer.json()["detail"]


@pytest.fixture(scope="module")
def shared(template: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    path = tmp_path_factory.mktemp("shared") / "signals.db"
    with Store(str(shutil.copy(template, path))) as store:
        found = Api(store)
        found.contribute(characterization())
        yield found


TEXT = json.dumps(BODY)


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (TEXT.replace("1.02", "NaN"), "quality.nis"),
        (TEXT.replace("1.02", "Infinity"), "quality.nis"),
        (TEXT.replace("1.02", "1e999"), "quality.nis"),
        (TEXT.replace("1.02", "9" * 10_000), "quality.nis"),
        (TEXT.replace('"nis"', '"duration_s": 3, "nis"'), "duration_s: given twice"),
        (TEXT.replace("PN 12", "\\ud800"), "UTF-8"),
        (TEXT.replace('"nis"', '"\\udfff": 1, "nis"'), "UTF-8"),
        (TEXT.encode("utf-16"), "UTF-8"),
        (b"\xff\xfe", "UTF-8"),
        ("", "JSON"),
        ("{", "JSON"),
        ("[" * 20_000, "nested"),
        ("[" * 20 + "]" * 20, "nested"),
        ('{"a":' * 5_000 + "1" + "}" * 5_000, "nested"),
    ],
    ids=lambda value: str(value)[:20] if isinstance(value, str) else "bytes",
)
def test_texts_that_are_no_bodies(shared: Api, raw: str | bytes, said: str) -> None:
    answer = shared.post("/v1/characterizations", content=raw, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert said in answer.json()["detail"]


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("near=1", "near"),
        ("near=91,0", "near"),
        ("near=nan,0", "near"),
        ("near=1_0,0", "near"),
        ("near=0,181", "near"),
        ("near=0,0&radius_m=-1", "radius_m"),
        ("near=0,0&radius_m=inf", "radius_m"),
        ("near=0,0&radius_m=nan", "radius_m"),
        ("bbox=1,2,3", "bbox"),
        ("bbox=0,10,1,5", "bbox"),
        ("bbox=-190,0,0,1", "bbox"),
        ("at=yesterday", "at"),
        ("at=2026-01-01T00:00:00", "at"),
        ("at=9999-12-31T23:59:59Z", "at"),
        ("at=0001-01-01T00:00:00%2B14:00", "at"),
        ("at=1970-01-01T00:00:00Z", "at"),
        ("limit=0", "limit"),
        ("limit=501", "limit"),
        ("limit=1e2", "limit"),
        ("kind=radar", "kind"),
        ("name=a%00b", "name"),
        ("cursor=abc", "cursor"),
        ("cursor=%F0%9F%93%A1", "cursor"),
        ("cursor=WzEsMl0", "cursor"),
        ("cursor=W251bGwsbnVsbCxudWxsXQ", "cursor"),
    ],
)
def test_questions_that_do_not_fit(shared: Api, query: str, field: str) -> None:
    answer = shared.get(f"/v1/sources?{query}")
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["field"] == field
    assert answer.json()["detail"].startswith(f"{field}: ")


def test_a_cursor_is_its_searchs(api: Api) -> None:
    for k in range(3):
        api.contribute(characterization(f"s{k}"))
    cursor = api.get("/v1/sources?limit=1").json()["next_cursor"]
    assert api.get("/v1/sources", params={"cursor": cursor, "kind": "fm"}).status_code == 422
    assert len(api.get("/v1/sources", params={"cursor": cursor}).json()["sources"]) == 2


@pytest.mark.parametrize("id", ["0", "-1", "9" * 30, "1.5", "abc", "%00", "1%2F2", "' OR 1=1"])
def test_ids_that_cannot_be(shared: Api, id: str) -> None:
    for path in ("/v1/sources/{}", "/v1/sources/{}/stability", "/v1/sources/{}/contributions"):
        assert shared.get(path.format(id)).status_code in (404, 422)
    for word in ("release", "reject"):
        assert shared.post(f"/v1/characterizations/{id}/{word}").status_code in (404, 422)
    assert shared("DELETE", f"/v1/tokens/{id}").status_code in (404, 422)


def test_ids_are_digits_alone(shared: Api) -> None:
    for one in ("1.0", "01", "+1", "%201", "1_0", "%D9%A1"):
        assert shared.get(f"/v1/sources/{one}").status_code == 422
        assert shared.post(f"/v1/characterizations/{one}/reject").status_code == 422


def test_what_is_not_known(shared: Api) -> None:
    for path in ("/v1/sources/77", "/v1/sources/77/stability", "/v1/sources/77/contributions", "/v2"):
        answer = shared.get(path)
        assert answer.status_code == 404
        assert answer.json()["detail"].endswith(("known", "/v2"))
    assert shared.post("/v1/characterizations/77/release").status_code == 404
    assert shared("PUT", "/v1/sources").status_code == 405
    assert shared("DELETE", "/v1/tokens/aaaaaaaaaa").status_code == 404


def test_a_time_with_an_offset_in_an_address(shared: Api) -> None:
    answers = {shared.get(f"/v1/sources/1?at=2026-11-01T14:00:00{zone}").content for zone in ("%2B02:00", "+02:00")}
    assert len(answers) == 1
    assert b"2026-11-01T12:00:00Z" in answers.pop()


def test_keys_make_a_retry_one(api: Api) -> None:
    body = characterization()
    first = api.contribute(body, headers={"Idempotency-Key": "k"})
    again = api.contribute(body, headers={"Idempotency-Key": "k"})
    assert (first.status_code, again.status_code) == (201, 201)
    assert first.json() == again.json()
    assert again.headers["idempotency-replayed"] == "true"
    assert "idempotency-replayed" not in first.headers
    other = api.contribute(characterization("b"), headers={"Idempotency-Key": "k"})
    assert other.status_code == 409
    assert "Idempotency-Key" in other.json()["detail"]
    for key in ("", "x" * 201, "a b", b"\xff"):
        assert api.contribute(body, headers={"Idempotency-Key": key}).status_code == 422
    assert api.store.counts()["contributions"] == 1


def test_keys_are_kept_as_long_as_the_settings_say(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "_PRUNE_S", 0.0)
    said = {"headers": {"Idempotency-Key": "k"}}
    brief = Api(api.store, idempotency_s=1e-6)
    brief.store._prune_at_s = 0.0
    assert brief.contribute(characterization("a"), **said).status_code == 201
    assert brief.contribute(characterization("b"), **said).status_code == 201
    kept = Api(api.store)
    assert kept.contribute(characterization("c"), **said).status_code == 201
    assert kept.contribute(characterization("d"), **said).status_code == 409


def test_a_name_at_several_places_needs_a_position(api: Api) -> None:
    api.contribute(characterization())
    api.contribute(characterization(position=position(48.2, 16.4)))
    answer = api.contribute(characterization(position=None))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "position"


def test_bodies_come_as_they_are(shared: Api) -> None:
    for coding, status in (("gzip", 415), ("br", 415), ("identity", 422)):
        headers = {"Content-Type": "application/json", "Content-Encoding": coding}
        answer = shared.post("/v1/characterizations", content="{}", headers=headers)
        assert answer.status_code == status


def test_only_json_is_taken(shared: Api) -> None:
    for kind in ("text/plain", "application/x-www-form-urlencoded", ""):
        answer = shared.post("/v1/characterizations", content=TEXT, headers={"Content-Type": kind})
        assert answer.status_code == 415
    kind = "Application/JSON; charset=utf-8"
    assert shared.post("/v1/characterizations", content="{}", headers={"Content-Type": kind}).status_code == 422


def test_health(api: Api) -> None:
    assert api.get("/health", role=None).json() | {"version": 0} == {
        "status": "ok",
        "database": "sqlite",
        "version": 0,
        "sources": 0,
        "contributions": 0,
    }


def test_a_database_that_is_gone_is_said_so(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*given: object) -> Any:
        raise DatabaseUnavailableError("the database does not answer")

    monkeypatch.setattr(api.store, "_read", gone)
    answer = api.get("/health")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "2"
    monkeypatch.undo()
    with api.store.engine.execution_options(writes=True).begin() as connection:
        connection.execute(sqlalchemy.text("DROP TABLE verdicts"))
    answer = api.contribute(characterization())
    assert answer.status_code == 503
    assert answer.json()["detail"] == "the database did not take the write; try again in a moment"
    assert api.get("/v1/sources").status_code == 200


def test_the_description_is_honest(shared: Api) -> None:
    description = shared.get("/openapi.json", role=None).json()
    post = description["paths"]["/v1/characterizations"]["post"]
    assert post["requestBody"]["content"]["application/json"]["schema"]["$ref"].endswith("/Characterization")
    assert set(post["responses"]) == {"201", "400", "401", "403", "408", "409", "413", "415", "422", "429", "503"}
    for path, routes in description["paths"].items():
        for method, route in routes.items():
            assert "429" in route["responses"], (path, method)
            for status, response in route["responses"].items():
                if status[0] in "45":
                    assert response["content"]["application/json"]["schema"]["$ref"].endswith("/Refusal")


def test_kept_answers_are_bounded_by_their_bytes() -> None:
    bodies = answers_module.Bodies(most_bytes=10_000)
    for i in range(50):
        bodies.keep(i, answers_module.Answer(bytes(1500), str(i)))
        assert bodies.size <= 10_000
    assert [i for i in range(50) if bodies.get(i) is not None] == [46, 47, 48, 49]
    bodies.keep(49, answers_module.Answer(bytes(100), "again"))
    again = bodies.get(49)
    assert again is not None
    assert (again.etag, bodies.size) == ("again", 3 * 2500 + 1100)
    bodies.keep("long", answers_module.Answer(bytes(10_000), "long"))
    assert bodies.get("long") is None


def test_a_page_of_many_times_keeps_no_more_than_its_bytes(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[answers_module.Bodies] = []
    make = answers_module.Bodies

    def small() -> answers_module.Bodies:
        kept.append(make(20_000))
        return kept[-1]

    monkeypatch.setattr(answers_module, "Bodies", small)
    assert api.contribute(characterization()).status_code == 201
    start = datetime.now(timezone.utc) + timedelta(hours=1)
    for i in range(60):
        at = (start + timedelta(seconds=i)).isoformat()
        assert api.get("/v1/sources", params={"at": at}).status_code == 200
    assert 0 < kept[-1].size <= 20_000
