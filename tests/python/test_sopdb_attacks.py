"""The signal database from outside, on a real socket: what no client sends, and what must not come of it."""

# ruff: noqa: E402

from __future__ import annotations

import json
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))

for _module in ("sqlalchemy", "alembic", "fastapi", "uvicorn", "httpx"):
    pytest.importorskip(_module)

import httpx
from sopdb_server import Running, body, database

pytestmark = pytest.mark.fuzz

HTTP = httpx.Client(verify=False)  # certificates are read once, not for each request


@pytest.fixture(scope="module", autouse=True)
def _closed() -> Iterator[None]:
    yield
    HTTP.close()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with database(tmp_path_factory.mktemp("attacks"), body_timeout_s=0.5) as running:
        yield running


def status(service: Running, data: bytes) -> int:
    """The status of what answers raw bytes; 0 when the connection is closed without an answer."""
    host, port = service.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10.0) as connection:
        connection.sendall(data)
        answer = b""
        while b"\r\n" not in answer:
            try:
                part = connection.recv(65536)
            except ConnectionResetError:
                break
            if not part:
                break
            answer += part
    return int(answer.split(b" ")[1]) if answer else 0


def head(service: Running, line: str, *headers: str, role: str | None = None) -> bytes:
    told = [] if role is None else [f"Authorization: Bearer {service.tokens[role]}"]
    return "\r\n".join([f"{line} HTTP/1.1", "Host: x", "Connection: close", *told, *headers, "", ""]).encode()


def test_no_spelling_of_an_address_goes_around_a_role(service: Running) -> None:
    for path in ("/v1/audit", "/v1/%61udit", "//v1/audit", "/v1/audit/", "/v1/./audit", "/v1/x/../audit", "/V1/AUDIT",
                 "/v1/audit%00", "/v1/audit;x", "/v1/audit?role=admin", "/static/../v1/audit"):  # fmt: skip
        for role in ("read", "contribute", None):
            assert status(service, head(service, f"GET {path}", role=role)) in (401, 403, 404), path
    for path in (
        "/static/../service.py",
        "/static/%2e%2e/service.py",
        "/static/..%2fservice.py",
        "/static/",
        "/static",
    ):
        assert status(service, head(service, f"GET {path}")) == 404
    for word in ("X-HTTP-Method-Override: DELETE", "X-Original-URL: /v1/audit", "X-Rewrite-URL: /v1/audit"):
        assert status(service, head(service, "GET /v1/audit", word, role="read")) == 403
    both = f"Authorization: Bearer {service.tokens['admin']}"
    assert status(service, head(service, "GET /v1/audit", both, role="read")) in (400, 401, 403)


def test_requests_that_are_none(service: Running) -> None:
    post = "POST /v1/characterizations"
    kind = "Content-Type: application/json"
    for data in (
        head(service, post, kind, "Content-Length: -4", role="contribute"),
        head(service, post, kind, "Content-Length: 4, 5", role="contribute") + b"nullx",
        head(service, post, kind, "Content-Length: 999999999999999999999", role="contribute"),
        head(service, post, kind, "Transfer-Encoding: chunked", role="contribute")
        + 7 * (b"4000\r\n" + 16384 * b"x" + b"\r\n"),
        head(service, post, kind, "Transfer-Encoding: chunked", role="contribute") + b"zz\r\n",
        head(service, post, kind, "Content-Length: 4", "Transfer-Encoding: chunked", role="contribute") + b"0\r\n\r\n",
        head(service, post, kind, "Content-Length: 100", role="contribute") + b'{"source',  # and no more
        head(service, "GET /v1/sources", 'If-None-Match: "\xff', role="read"),
        head(service, "GET /v1/sources", "Authorization: Bearer \xff\xfe"),
        head(service, "GET /v1/sources", "Authorization: " + 20000 * "B"),
        b"GET /v1/sources\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",  # TLS knocks
        b"\r\n" * 100 + b"\0" * 100,
    ):  # fmt: skip
        assert status(service, data) < 500, data[:200]
    for method in ("OPTIONS", "PUT", "PATCH", "TRACE", "DELETE", "FOO"):
        assert status(service, head(service, f"{method} /v1/sources", role="admin")) == 405


def test_one_key_at_once_makes_one_record(service: Running) -> None:
    one, answers = body("K", carrier_hz=7e8), []
    headers = {"Authorization": f"Bearer {service.tokens['contribute']}", "Idempotency-Key": "at-once"}
    barrier = threading.Barrier(16)

    def send() -> None:
        barrier.wait()
        answers.append(HTTP.post(f"{service.url}/v1/characterizations", json=one, headers=headers))

    threads = [threading.Thread(target=send) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} == {201}
    (receipt,) = {json.dumps(answer.json()) for answer in answers}
    assert sum("idempotency-replayed" not in answer.headers for answer in answers) == 1
    source = json.loads(receipt)["source_id"]
    kept = HTTP.get(f"{service.url}/v1/sources/{source}/contributions", headers=headers).json()["contributions"]
    assert len(kept) == 1
    other = HTTP.post(
        f"{service.url}/v1/characterizations", json=body("K", carrier_hz=7e8, bias_s=2e-6), headers=headers
    )
    assert other.status_code == 409


def test_bodies_that_say_two_things(service: Running) -> None:
    """A key twice, another encoding, what only some readers of JSON take: refused, not read one way or the other."""
    text = json.dumps(body("B", carrier_hz=6e8))
    headers = {"Authorization": f"Bearer {service.tokens['contribute']}", "Content-Type": "application/json"}
    for data in (
        text[:-1] + ', "clock": null}',
        "\ufeff" + text,
        text.encode("utf-16"),
        text.replace('"B"', '"é"').encode("latin-1"),
        text.replace("240.0", "NaN"),
        text.replace("240.0", "-Infinity"),
        text.replace("240.0", "1e999"),
        text.replace("240.0", "9" * 5000),
        text.replace("240.0", "true"),
        text.replace("240.0", '"240"'),
        text.replace('"B"', '"\\ud800"'),
        text.replace('"roof"', '"\\u0000"'),
        text + text,
        "",
    ):
        answer = HTTP.post(f"{service.url}/v1/characterizations", content=data, headers=headers)
        assert answer.status_code == 422, data[:300]
        assert answer.json()["detail"]
    deep = HTTP.post(f"{service.url}/v1/characterizations", content=30_000 * "[", headers=headers)
    assert deep.status_code in (413, 422)
