"""Tokens, roles and limits of the signal database."""

from __future__ import annotations

import asyncio
import json
import logging
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
from sopdb_api import FREE, Api
from sopdb_bodies import characterization, clock
from starlette.requests import Request

from soopnav_cpp.sopdb import auth, guard, limits
from soopnav_cpp.sopdb.limits import Buckets, RefusedError
from soopnav_cpp.sopdb.service import create_app
from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
from soopnav_cpp.sopdb.store import Store

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("template") / "signals.db"
    Store(str(path)).close()
    return path


@pytest.fixture
def store(template: Path, tmp_path: Path) -> Iterator[Store]:
    with Store(str(shutil.copy(template, tmp_path / "signals.db"))) as found:
        yield found


@pytest.fixture
def api(store: Store) -> Api:
    return Api(store)


ROUTES = [
    ("GET", "/v1/sources", "read"),
    ("GET", "/v1/sources/1", "read"),
    ("GET", "/v1/sources/1/stability", "read"),
    ("GET", "/v1/sources/1/contributions", "read"),
    ("GET", "/v1/snapshot", "read"),
    ("POST", "/v1/characterizations", "contribute"),
    ("GET", "/v1/characterizations", "admin"),
    ("POST", "/v1/characterizations/1/release", "admin"),
    ("POST", "/v1/characterizations/1/reject", "admin"),
    ("GET", "/v1/audit", "admin"),
    ("GET", "/v1/tokens", "admin"),
    ("POST", "/v1/tokens", "admin"),
    ("DELETE", "/v1/tokens/aaaaaaaaaa", "admin"),
]


def test_no_route_was_forgotten(api: Api) -> None:
    found = {
        (method.upper(), path.replace("{id}", "aaaaaaaaaa" if "tokens" in path else "1"))
        for path, routes in api.get("/openapi.json").json()["paths"].items()
        for method in routes
    }
    assert found - {("GET", "/health")} == {(method, path) for method, path, _ in ROUTES}


def test_roles(api: Api) -> None:
    for method, path, needed in ROUTES:
        given: dict[str, Any] = {"content": "{}", "headers": {"Content-Type": "application/json"}}
        for role in (None, *auth.ROLES):
            status = api(method, path, role=role, **given).status_code
            if role is None:
                assert status == 401, (method, path)
            elif auth.ROLES.index(role) < auth.ROLES.index(needed):
                assert status == 403, (method, path, role)
            else:
                assert status not in (401, 403), (method, path, role)
    assert api.store.counts()["contributions"] == 0


def test_reading_may_be_free(store: Store) -> None:
    api = Api(store, role=None, public_read=True)
    for method, path, needed in ROUTES:
        assert (api(method, path).status_code == 401) is (needed != "read"), path
    assert api.get("/v1/sources", role="sop_aaaaaaaaaa_" + "a" * 43).status_code == 401  # a wrong token is told so


def test_tokens_that_do_not_hold(api: Api) -> None:
    held = api.tokens["read"]
    flipped = held[:-1] + ("A" if held[-1] != "A" else "B")
    other = api.tokens["admin"]
    for text in (
        flipped,
        held[:-1],
        held + "A",
        held.upper(),
        held[:15] + other[15:],  # one's id with another's secret
        "sop__",
        "",
        "x" * 5000,
        "sop_aaaaaaaaaa_" + "a" * 43,
    ):
        answer = api.get("/v1/sources", role=None, headers={"Authorization": f"Bearer {text}"})
        assert answer.status_code == 401, text
        assert 'error="invalid_token"' in answer.headers["www-authenticate"]
        assert text not in answer.text or not text
    for header in (held, f"Basic {held}", f"Bearer  {held} x", "Bearer", f"Token {held}"):
        assert api.get("/v1/sources", role=None, headers={"Authorization": header}).status_code == 401
    assert api.get("/v1/sources", role=None, headers={"Authorization": f"bearer {held}"}).status_code == 200
    assert api.get(f"/v1/sources?token={held}", role=None).status_code == 401
    assert api.get("/v1/sources", role=None).headers["www-authenticate"] == 'Bearer realm="signal database"'


def test_a_token_ends(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    soon = int(time.time() * 1e6) + 60_000_000
    token = api.store.create_token("t", "contribute", expires_us=soon).text
    assert api.get("/v1/sources", role=token).status_code == 200
    monkeypatch.setattr(guard, "now_us", lambda: soon)
    answer = api.contribute(characterization(), role=token)
    assert (answer.status_code, answer.json()["detail"]) == (401, "the token has expired")
    api.store.note(guard.Contributor("x"), "y", "z", "done").result(30.0)  # what was noted before is written
    audit = api.store.audit(limit=2)[1]
    assert (audit["action"], audit["outcome"], audit["actor"]) == ("refused", "401: expired", token[4:14])


def test_revoking_takes_effect_at_once(api: Api) -> None:
    token = api.store.create_token("t", "read")
    assert api.get("/v1/sources", role=token.text).status_code == 200
    assert api("DELETE", f"/v1/tokens/{token.id}").status_code == 204
    assert api.get("/v1/sources", role=token.text).status_code == 401
    again = api.store.create_token("t", "read")
    assert api.get("/v1/sources", role=again.text).status_code == 200
    with Store(str(api.store.engine.url.database)) as other:  # the operator's command, beside the service
        other.revoke_token(again.id)
    assert api.get("/v1/sources", role=again.text).status_code == 401


def test_tokens_are_made_and_listed(api: Api) -> None:
    expires = "2100-01-01T00:00:00Z"
    made = api.post("/v1/tokens", json={"name": "roof", "role": "contribute", "expires": expires})
    assert made.status_code == 201
    assert made.headers["cache-control"] == "no-store"
    answer = made.json()
    assert answer["expires"] == expires
    assert api.contribute(characterization(), role=answer["token"]).status_code == 201
    listed = api.get("/v1/tokens")
    assert answer["token"][15:] not in listed.text
    row = next(one for one in listed.json()["tokens"] if one["id"] == answer["id"])
    assert row | {"created": 0} == {
        "id": answer["id"],
        "name": "roof",
        "role": "contribute",
        "created_by": api.tokens["admin"][4:14],
        "created": 0,
        "expires": expires,
        "revoked": None,
    }
    for body, field in (
        ({"name": "a", "role": "root"}, "role"),
        ({"name": "", "role": "read"}, "name"),
        ({"name": "a\nb", "role": "read"}, "name"),
        ({"name": "a", "role": "read", "expires": "2020-01-01T00:00:00Z"}, "expires"),
        ({"name": "a", "role": "read", "expires": 5}, "expires"),
        ({"name": "a", "role": "read", "id": "b"}, "id"),
    ):
        answer = api.post("/v1/tokens", json=body)
        assert answer.status_code == 422, body
        assert answer.json()["errors"][0]["field"] == field


def test_what_was_done_is_in_the_audit(api: Api) -> None:
    api.contribute(characterization(), role="contribute", client=("198.51.100.7", 1))
    api.contribute(characterization(), role="read", client=("198.51.100.8", 1))
    api.post("/v1/characterizations/1/reject", role="sop_aaaaaaaaaa_" + "a" * 43)
    api.post("/v1/characterizations/1/reject")
    api.store.note(guard.Contributor("x"), "y", "z", "done").result(30.0)  # what was noted before is written
    entries = api.get("/v1/audit").json()["entries"]
    told = [(e["actor"], e["address"], e["action"], e["target"], e["outcome"]) for e in entries[:5]]
    ids = {role: text[4:14] for role, text in api.tokens.items()}
    assert told[1:] == [
        (ids["admin"], "192.0.2.1", "reject", "contribution 1", "rejected"),
        ("<anybody>", "192.0.2.1", "refused", "POST /v1/characterizations/1/reject", "401: no such token"),
        (ids["read"], "198.51.100.8", "refused", "POST /v1/characterizations", "403: role read"),
        (ids["contribute"], "198.51.100.7", "contribute", "contribution 1", "accepted, source 1"),
    ]
    first = api.get("/v1/audit?limit=2").json()
    second = api.get("/v1/audit", params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [e["id"] for e in first["entries"] + second["entries"]] == [e["id"] for e in entries[:4]]


def test_rates_of_a_token_and_of_an_address(store: Store) -> None:
    api = Api(store, reads=Rate(0.001, 3), writes=Rate(0.001, 2))
    other = store.create_token("other", "contribute").text
    assert [api.get("/v1/sources").status_code for _ in range(5)] == [200, 200, 200, 429, 429]
    assert api.get("/v1/sources", role=other).status_code == 200
    assert [api.contribute(characterization(clock=clock(k + 1.0))).status_code for k in range(3)] == [201, 201, 429]
    answer = api.get("/v1/sources")
    assert 900 <= int(answer.headers["retry-after"]) <= 1000
    assert answer.json()["detail"].startswith("too many requests of this token; wait ")
    crowd = Api(store, addresses=Rate(0.001, 4))
    assert [crowd.get("/health").status_code for _ in range(5)] == [200] * 4 + [429]
    assert crowd.get("/health", client=("192.0.2.2", 1)).status_code == 200
    free = Api(store, role=None, public_read=True, reads=Rate(0.001, 1))
    assert [free.get("/v1/sources").status_code for _ in range(2)] == [200, 429]
    assert free.get("/v1/sources", client=("192.0.2.2", 1)).status_code == 200


def test_guessing_tokens_is_slowed(store: Store) -> None:
    api = Api(store, failures=Rate(0.001, 3))
    wrong = "sop_aaaaaaaaaa_" + "a" * 43
    assert [api.get("/v1/sources", role=wrong).status_code for _ in range(5)] == [401, 401, 401, 429, 429]
    assert api.get("/v1/sources", client=("192.0.2.2", 1)).status_code == 200


def test_buckets_fill_and_forget() -> None:
    now = [0.0]
    buckets = Buckets(Rate(2.0, 3.0), 2, clock=lambda: now[0])
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert buckets.wait_s("a") == 0.5
    now[0] = 0.5
    assert buckets.wait_s("a") == 0.0
    assert [buckets.take("a") for _ in range(2)] == [0.0, 0.5]
    now[0] = 100.0
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    buckets.take("b")
    buckets.take("c")
    assert len(buckets) == 2
    assert buckets.take("a") == 0.0  # forgotten: the one not used for longest
    for bad in ((0.0, 1.0), (float("nan"), 1.0), (1.0, 0.5)):
        with pytest.raises(ValueError, match="must be"):
            Rate(*bad)


def test_addresses() -> None:
    def of(host: str | None) -> str:
        return limits.address_of(
            Request({"type": "http", "headers": [], "client": None if host is None else (host, 1)})
        )

    assert of("192.0.2.7") == "192.0.2.7"
    assert of("::ffff:192.0.2.7") == "192.0.2.7"
    assert of("2001:db8:1:2:3::4") == of("2001:db8:1:2:ffff::") == "2001:db8:1:2::/64"
    assert of("2001:db8:1:3::") != of("2001:db8:1:2::")
    assert of(None) == of("") == "local"


@pytest.mark.parametrize(
    "given",
    [
        {"page_size": 600},
        {"max_body_bytes": 0},
        {"body_timeout_s": 0.0},
        {"body_timeout_s": float("inf")},
        {"fresh_s": -1.0},
        {"max_ahead_s": float("nan")},
        {"limited_keys": 0},
    ],
)
def test_settings_that_cannot_be(given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(given))):
        ServiceSettings(**given)


def test_long_and_slow_bodies_are_refused_while_they_are_read(store: Store) -> None:
    token = store.create_token("t", "contribute").text
    app = create_app(store, ServiceSettings(max_body_bytes=1000, body_timeout_s=0.05, **FREE))
    taken: list[int] = []

    def send(chunks: list[bytes], headers: dict[str, str], *, ends: bool = True) -> tuple[int, dict[str, Any]]:
        waiting = list(chunks)
        taken.clear()

        async def receive() -> dict[str, Any]:
            if not waiting:
                if not ends:
                    await asyncio.sleep(60.0)
                return {"type": "http.disconnect"}
            chunk = waiting.pop(0)
            taken.append(len(chunk))
            return {"type": "http.request", "body": chunk, "more_body": bool(waiting) or not ends}

        sent: list[Any] = []

        async def collect(message: Any) -> None:
            sent.append(message)

        given = {"authorization": f"Bearer {token}", "content-type": "application/json"} | headers
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "POST",
            "scheme": "http",
            "path": "/v1/characterizations",
            "raw_path": b"/v1/characterizations",
            "query_string": b"",
            "root_path": "",
            "headers": [(k.encode(), v.encode()) for k, v in given.items()],
            "client": ("192.0.2.1", 1),
            "server": ("signals", 80),
        }
        asyncio.run(app(scope, receive, collect))
        return sent[0]["status"], json.loads(b"".join(message.get("body", b"") for message in sent[1:]))

    status, answer = send([b"x" * 100] * 50, {})
    assert (status, answer["detail"]) == (413, "the body must not have more than 1000 bytes")
    assert sum(taken) == 1100  # and no more was read
    assert send([b"x"], {"content-length": "9" * 40})[0] == 413
    assert taken == []
    assert send([b"{"], {"content-length": "-1"})[0] == 422
    assert send([b"{"], {}, ends=False)[0] == 408
    big = json.dumps(characterization()).encode()
    assert send([big[:700], big[700:]], {"content-length": "10"})[0] in (201, 413)
    assert send([b"{", b"}"], {})[0] == 422


def test_depth_is_counted() -> None:
    assert limits.strict_json(b"[[[1]]]", 3) == [[[1]]]
    with pytest.raises(RefusedError, match="nested deeper than 2"):
        limits.strict_json(b"[[[1]]]", 2)


def test_log_lines_have_no_secrets(api: Api) -> None:
    token = api.tokens["admin"]
    lines: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines.append(self.format(record))

    handler = Keep()
    handler.addFilter(auth.HideTokens())
    log = logging.getLogger("test.tokens")
    log.propagate = False
    log.addHandler(handler)
    log.error("GET /v1/sources?token=%s %d", token, 200)
    log.error("Authorization: Bearer %s", token)
    log.error(f"said {token}, and Bearer abc.def")
    log.error("%(x)s", {"x": 1})
    log.removeHandler(handler)
    assert lines[0] == f"GET /v1/sources?token={token[:14]}_*** 200"
    assert all(token[15:] not in line for line in lines)
    assert "abc.def" not in lines[2]
    assert lines[3] == "1"


def test_a_secret_is_compared_whole() -> None:
    made = auth.new_token()
    parsed = auth.parse_token(made.text)
    assert parsed is not None
    assert parsed[0] == made.id
    assert auth.secret_matches(parsed[1], made.secret_hash)
    assert not auth.secret_matches(parsed[1][:-1] + "_", made.secret_hash) or parsed[1].endswith("_")
    assert len({auth.new_token().text for _ in range(100)}) == 100
    assert all(auth.parse_token(auth.new_token().text) for _ in range(300))


def test_two_threads_ask_at_once(api: Api) -> None:
    api.contribute(characterization())
    results: list[int] = []
    threads = [
        threading.Thread(target=lambda: results.extend(api.get("/v1/sources").status_code for _ in range(5)))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [200] * 20
