"""The client: what it sends, what it retries, and what it does without a network."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

httpx = pytest.importorskip("httpx")

sys.path.insert(0, str(Path(__file__).parent / "support"))
from sopdb_bodies import tower  # noqa: E402

from soopnav_cpp.sopdb import snapshot  # noqa: E402
from soopnav_cpp.sopdb.client import Client, ServiceError, UnreachableError  # noqa: E402
from soopnav_cpp.sopdb.fusion import Entry, answer_quality, fuse  # noqa: E402
from soopnav_cpp.sopdb.records import Characterization  # noqa: E402

NOON = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
BODY = tower("2026-03-01T12:00:00Z")
ENTRY = Entry("7", "a", NOON, Characterization.model_validate(BODY))
SOURCE = {
    "id": "7", "kind": "cdma", "name": "PN 168", "carrier_hz": 881.52e6,
    **fuse([ENTRY], NOON).answer(), "quality": answer_quality([ENTRY], NOON),
}  # fmt: skip
RECEIPT = {"id": "3", "status": "accepted", "reasons": [], "source_id": "7"}


class World:
    """A service of canned answers that notes what it was asked, and a clock that only sleeps."""

    def __init__(self, *answers: Any) -> None:
        self.answers = list(answers)
        self.asked: list[Any] = []
        self.slept: list[float] = []

    def __call__(self, request: Any) -> Any:
        self.asked.append(request)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer(request) if callable(answer) else answer

    def client(self, url: str = "https://sop.example.org", **options: Any) -> Client:
        http = httpx.Client(transport=httpx.MockTransport(self))
        return Client(url, http=http, sleep=self.slept.append, **options)


def answer(status: int, value: Any = None, **headers: str) -> Callable[[Any], Any]:
    headers = {name.replace("_", "-"): text for name, text in headers.items()}
    return lambda request: httpx.Response(status, json=value, headers=headers)


def test_a_contribution_is_checked_here_and_carries_the_key_of_its_content() -> None:
    world = World(answer(201, RECEIPT))
    client = world.client(token="sop_abc_def")
    receipt = client.push(BODY)
    assert (receipt.id, receipt.source_id, receipt.status, receipt.reasons) == ("3", "7", "accepted", ())
    client.push(dict(reversed(BODY.items())))
    first, second = world.asked
    assert first.headers["Idempotency-Key"] == second.headers["Idempotency-Key"]
    assert first.headers["Authorization"] == "Bearer sop_abc_def"
    assert Characterization.model_validate(json.loads(first.content)) == ENTRY.body
    client.push(BODY | {"quality": {"duration_s": 241}})
    assert world.asked[-1].headers["Idempotency-Key"] != first.headers["Idempotency-Key"]
    with pytest.raises(ValueError, match="duration_s"):
        client.push(BODY | {"quality": {"duration_s": -1}})
    assert len(world.asked) == 3


def test_lost_answers_are_asked_for_again_with_the_same_key() -> None:
    world = World(
        httpx.ReadTimeout("late"), answer(503, None, Retry_After="2"), answer(429, None, Retry_After="1.5"),
        answer(201, RECEIPT | {"status": "quarantined", "reasons": ["clock: 9 standard deviations"]}),
    )  # fmt: skip
    receipt = world.client().push(BODY)
    assert receipt.status == "quarantined"
    assert receipt.reasons == ("clock: 9 standard deviations",)
    assert world.slept == [0.25, 2.0, 1.5]
    assert len({request.headers["Idempotency-Key"] for request in world.asked}) == 1


@pytest.mark.parametrize(
    ("answers", "sentence", "status"),
    [
        ([answer(401, {"detail": "the token has expired"})], "the token was refused: the token has expired", 401),
        ([answer(403, {"detail": "role read"})], "the token does not allow this: role read", 403),
        ([answer(422, {"detail": "clock.drift: too much"})], r"refused \(status 422\): clock.drift: too much", 422),
        ([answer(422, {"detail": [{"loc": ["body", "clock"], "msg": "bad"}]})], "422.: clock: bad", 422),
        ([answer(409, {"detail": "the key came before"})], "the key came before", 409),
        ([answer(500, ["?"])], r"refused \(status 500\)$", 500),
        ([answer(307, None, Location="https://elsewhere")], "sends elsewhere", 307),
        ([answer(429, None, Retry_After="3600")], "too many requests: try again in 3600 s", 429),
        ([answer(503)], "cannot answer now", 503),
        ([httpx.ConnectError("refused")], "does not answer: refused", 0),
        ([httpx.ReadTimeout("")], "does not answer: no answer in time", 0),
        ([answer(201, ["no receipt"])], "an answer to a contribution that cannot be read", 0),
        ([lambda request: httpx.Response(201, content=b"<html>")], "cannot be read", 0),
    ],
)
def test_refusals_are_sentences(answers: list[Any], sentence: str, status: int) -> None:
    world = World(*answers)
    with pytest.raises(ServiceError, match=sentence) as refusal:
        world.client(token="sop_secret_text").push(BODY)
    assert refusal.value.status == status
    assert "secret" not in str(refusal.value)
    assert len(world.slept) <= 4


def test_without_a_token_the_refusal_says_where_one_goes() -> None:
    with pytest.raises(ServiceError, match="SOOPNAV_SOPDB_TOKEN"):
        World(answer(401, {})).client().push(BODY)


def test_pages_follow_the_cursor_and_etags_save_the_way() -> None:
    def page(request: Any) -> Any:
        if request.headers.get("If-None-Match") in ('"1"', '"2"'):
            return httpx.Response(304)
        second = request.url.params.get("cursor") == "next"
        value = {"sources": [SOURCE | {"id": "8" if second else "7"}], "next_cursor": None if second else "next"}
        return httpx.Response(200, json=value, headers={"ETag": '"2"' if second else '"1"'})

    world = World(page)
    client = world.client()
    for _ in range(2):
        found = list(client.sources(kind="cdma", near=(30.0, -97.0), radius_m=1e4, at=NOON))
        assert [source["id"] for source in found] == ["7", "8"]
    assert len(world.asked) == 4
    assert world.asked[3].headers["If-None-Match"] == '"2"'
    params = world.asked[0].url.params
    assert (params["kind"], params["near"], params["radius_m"]) == ("cdma", "30.0,-97.0", "10000.0")
    assert found[0]["clock"]["bias_s"] == SOURCE["clock"]["bias_s"]


@pytest.mark.parametrize(
    "value", [{"sources": 5}, ["page"], {"sources": [{"id": "7"}]}, {"sources": [SOURCE | {"kind": "tv"}]}]
)
def test_answers_that_cannot_be_read_are_refused(value: Any) -> None:
    with pytest.raises(ServiceError, match="cannot be read"):
        list(World(answer(200, value)).client().sources())


def test_ids_stay_within_their_place_in_the_address() -> None:
    client = World(answer(200, SOURCE)).client()
    assert client.source("7")["id"] == "7"
    for bad in ("", "../tokens", "7/8", "x" * 41, "7?at=1"):
        with pytest.raises(ValueError, match="letters, digits"):
            client.source(bad)


def test_a_snapshot_answers_for_a_service_that_does_not(tmp_path: Path) -> None:
    path = tmp_path / "signals.sopcat"
    data = snapshot.encode([SOURCE], NOON)
    world = World(
        lambda request: httpx.Response(200, content=data, headers={"ETag": '"a"'}),
        lambda request: httpx.Response(304 if request.headers["If-None-Match"] == '"a"' else 500),
        httpx.ConnectError("no route"),
    )
    client = world.client(snapshot=path, retries=0)
    catalog, changed = client.pull()
    assert (len(catalog), changed) == (1, True)
    assert client.pull()[1] is False
    later = NOON + timedelta(hours=1)
    assert client.source("7", at=later) == catalog.source("7", later)
    assert client.offline is not None
    assert [s["id"] for s in client.sources(at=later)] == ["7"]
    assert [s["id"] for s in client.sources(near=(0.0, 0.0), radius_m=1e3)] == ["7"]
    assert list(client.sources(near=(10.0, 0.0), radius_m=1e3)) == []
    assert list(client.sources(kind="lte")) == []
    with pytest.raises(ServiceError, match="no source 9"):
        client.source("9")
    with pytest.raises(UnreachableError):
        client.push(BODY)
    path.write_bytes(b"damaged")
    with pytest.raises(ValueError, match="snapshot"):
        World(httpx.ConnectError("x")).client(snapshot=path, retries=0).source("7")


def test_a_bad_download_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "signals.sopcat"
    snapshot.write(path, snapshot.encode([SOURCE], NOON))
    before = path.read_bytes()
    with pytest.raises(ServiceError, match="/v1/snapshot: snapshot: "):
        World(lambda request: httpx.Response(200, content=before[:-1])).client().pull(path)
    assert path.read_bytes() == before
    # Another server's ETag is not believed.
    path.with_name("signals.sopcat.etag").write_text('https://other.example.org "a"\n')
    world = World(lambda request: httpx.Response(200, content=before))
    assert world.client().pull(path)[1] is True
    assert "If-None-Match" not in world.asked[0].headers


@pytest.mark.parametrize(
    ("url", "options", "sentence"),
    [
        ("ftp://x", {}, "must be https"),
        ("sop.example.org", {}, "must be https"),
        ("https://", {}, "must be https"),
        ("https://user:pass@x", {}, "must be https"),
        ("http://sop.example.org", {"token": "sop_a_b"}, "anybody on the way can read the token"),
        ("https://x", {"token": "two words"}, "without blanks"),
        ("https://x", {"token": "line\nbreak"}, "without blanks"),
        ("https://x", {"timeout_s": 0.0}, "timeout_s = 0.0"),
        ("https://x", {"retries": -1}, "retries = -1"),
    ],
)
def test_set_up_is_refused_in_a_sentence(url: str, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Client(url, **options)


def test_a_token_may_go_over_loopback_and_where_it_is_said() -> None:
    Client("http://127.0.0.1:8008", token="sop_a_b").close()
    Client("http://sop.example.org", token="sop_a_b", insecure=True).close()
    assert "sop_a_b" not in repr(Client("http://localhost", token="sop_a_b"))
