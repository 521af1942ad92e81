"""Requests made up from the service's own description: nothing makes it fail, and every answer is a described one."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
import postgresql
from sopdb_api import Api
from sopdb_bodies import characterization

from soopnav_cpp.sopdb.store import Store

schemathesis = pytest.importorskip("schemathesis")
hypothesis = pytest.importorskip("hypothesis")


def _check(case: Any, headers: dict[str, str]) -> int:
    """Send a case: the answer is one that is described, of its type and shape. Its status."""
    from schemathesis import checks
    from schemathesis.specs.openapi import checks as openapi

    response = case.call(headers=headers)
    case.validate_response(
        response,
        checks=[
            checks.not_a_server_error,
            openapi.status_code_conformance,
            openapi.content_type_conformance,
            openapi.response_schema_conformance,
        ],
    )
    return int(response.status_code)


def _filled(url: str) -> Iterator[Api]:
    with Store(url) as store:
        found = Api(store)
        for k in range(3):
            found.contribute(characterization(f"s{k}"))
        yield found


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    yield from _filled(str(tmp_path / "signals.db"))


@pytest.fixture
def postgresql_api() -> Iterator[Api]:
    yield from _filled(postgresql.shared().new_database())


def _run(api: Api, examples: int) -> Counter[int]:
    schema = schemathesis.openapi.from_asgi("/openapi.json", api.app)
    statuses: Counter[int] = Counter()
    settings = hypothesis.settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=examples < 50,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    for result in schema.get_all_operations():
        operation = result.ok()
        # What fits the description, and what does not.
        cases = operation.as_strategy() | operation.as_strategy(generation_mode=schemathesis.GenerationMode.NEGATIVE)
        for role in ("admin", "read"):
            headers = {"Authorization": f"Bearer {api.tokens[role]}"}

            @settings
            @hypothesis.given(case=cases)
            def send(case: Any) -> None:
                statuses[_check(case, headers)] += 1  # noqa: B023

            send()
    return statuses


def _judge(api: Api, examples: int) -> None:
    statuses = _run(api, examples)
    assert max(statuses) < 500
    assert {200, 403, 404, 422} <= set(statuses)  # it got past the doors, and was refused at them
    assert api.get("/health").json()["status"] == "ok"


@pytest.mark.fuzz
@pytest.mark.parametrize("examples", [3, pytest.param(150, marks=pytest.mark.slow)])
def test_nothing_sent_makes_it_fail(api: Api, examples: int) -> None:
    _judge(api, examples)


@pytest.mark.slow
@pytest.mark.fuzz
def test_nothing_sent_makes_it_fail_on_postgresql(postgresql_api: Api) -> None:
    _judge(postgresql_api, 100)
