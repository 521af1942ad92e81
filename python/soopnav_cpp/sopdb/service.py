"""The service: characterisations in, sources out, over HTTP.

``create_app(store, settings)`` is an ASGI application; `soopnav_cpp.sopdb.server` runs it. What each route takes and
gives is in ``/openapi.json``. Every refusal is JSON with a sentence in ``detail``, and ``errors`` that name the fields.
"""

import asyncio
import logging
from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

from fastapi import Depends, FastAPI, Path, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse, Response
from pydantic import BeforeValidator
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException

from soopnav_cpp.sopdb import models, questions
from soopnav_cpp.sopdb.answers import Answer, Answers
from soopnav_cpp.sopdb.contributing import ConflictError, Contributor, Outcome
from soopnav_cpp.sopdb.database import DatabaseUnavailableError
from soopnav_cpp.sopdb.guard import Guard, Headers
from soopnav_cpp.sopdb.limits import RefusedError, read_json, validated
from soopnav_cpp.sopdb.matching import AmbiguousError
from soopnav_cpp.sopdb.page import add_page
from soopnav_cpp.sopdb.records import AnsweredSource, Characterization, Kind
from soopnav_cpp.sopdb.schema import from_us, to_us
from soopnav_cpp.sopdb.settings import ServiceSettings
from soopnav_cpp.sopdb.store import Search, Store
from soopnav_cpp.sopdb.writer import BusyError

__all__ = ["create_app"]

_T = TypeVar("_T")
_SNAPSHOT = "application/octet-stream"
_LOG = logging.getLogger("soopnav.sopdb")


def _whole(value: object) -> object:
    if isinstance(value, str) and not (value.isascii() and value.isdigit() and value[0] != "0"):
        raise ValueError("a whole number from 1 on expected, digits alone")
    return value


_Id = Annotated[int, BeforeValidator(_whole), Path(ge=1, le=2**63 - 1)]
_At = Annotated[str | None, Query(max_length=40, description="A time of UTC in ISO 8601; without it, now.")]
_Cursor = Annotated[str | None, Query(max_length=200, description="`next_cursor` of the page before.")]


class _Service:
    """What the routes share."""

    def __init__(self, store: Store, settings: ServiceSettings) -> None:
        self.store = store
        store.keep_keys(settings.idempotency_s)
        self.settings = settings
        self.answers = Answers(store, settings.fresh_s)
        self.guard = Guard(store, self.answers, settings)
        self.caching = "public, no-cache" if settings.public_read else "private, no-cache"

    async def read(self, function: Callable[..., _T], *arguments: Any, slow: bool = False) -> _T:
        """Look something up: in a file at once, elsewhere (or where it may take long) in a thread."""
        if self.store.sqlite and not slow:
            return function(*arguments)
        return await run_in_threadpool(function, *arguments)

    def allow(self, needed: str, *, writes: bool = False) -> Any:
        """A dependency that gives who asks, and refuses those who may not."""

        def check(request: Request, address: str) -> Contributor:
            self.answers.refresh()
            return self.guard.check(request, address, needed, writes=writes)

        async def dependency(request: Request) -> Contributor:
            return await self.read(check, request, self.guard.address(request))

        return Depends(dependency)

    def send(
        self, request: Request, answer: Answer | None, missing: str, media_type: str = "application/json"
    ) -> Response:
        """An answer, or 304 when the asker has it, or 404."""
        if answer is None:
            raise RefusedError(404, missing)
        headers = {"ETag": answer.etag, "Cache-Control": self.caching}
        if not self.settings.public_read:
            headers["Vary"] = "Authorization"
        if questions.matches(request.headers.get("if-none-match"), answer.etag):
            return Response(status_code=304, headers=headers)
        return Response(answer.body, media_type=media_type, headers=headers)

    async def body(self, request: Request) -> Any:
        """The JSON of a body, within its limits."""
        settings = self.settings
        return await read_json(
            request,
            max_bytes=settings.max_body_bytes,
            max_depth=settings.max_depth,
            timeout_s=settings.body_timeout_s,
        )


def create_app(store: Store, settings: ServiceSettings | None = None) -> FastAPI:
    """The service on an open store.

    Parameters
    ----------
    store : Store
        Stays the caller's to close.
    settings : ServiceSettings, optional

    Returns
    -------
    FastAPI
        An ASGI application.
    """
    settings = settings or ServiceSettings()
    service = _Service(store, settings)
    app = FastAPI(title="Signal database", version="1", docs_url=None, redoc_url=None, redirect_slashes=False)
    app.add_middleware(Headers, https=settings.https)
    _add_refusals(app)
    _add_reads(app, service)
    _add_writes(app, service)
    _add_administration(app, service)
    add_page(app)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


def _add_refusals(app: FastAPI) -> None:
    async def refused(_: Request, error: Exception) -> Response:
        assert isinstance(error, RefusedError)
        return error.response()

    async def http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        sentences = {404: f"nothing is at {request.url.path[:200]}", 405: f"{request.method} is not for this address"}
        sentence = sentences.get(error.status_code, str(error.detail))
        return RefusedError(error.status_code, sentence, headers=dict(error.headers or {})).response()

    async def invalid(_: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        return RefusedError.of_fields(
            [(".".join(map(str, one["loc"][1:]))[:100], str(one["msg"])[:300]) for one in error.errors()]
        ).response()

    async def conflict(_: Request, error: Exception) -> Response:
        return RefusedError(409, str(error), [("Idempotency-Key", "came with another body before")]).response()

    async def ambiguous(_: Request, error: Exception) -> Response:
        return RefusedError.of_fields([("position", str(error))]).response()

    async def unavailable(request: Request, error: Exception) -> Response:
        _LOG.error("%s %s: %s (%s)", request.method, request.url.path, error, error.__cause__)
        return RefusedError(503, f"{error}; try again in a moment", headers={"Retry-After": "2"}).response()

    app.add_exception_handler(RefusedError, refused)
    app.add_exception_handler(HTTPException, http)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(AmbiguousError, ambiguous)
    app.add_exception_handler(ConflictError, conflict)
    app.add_exception_handler(DatabaseUnavailableError, unavailable)
    app.add_exception_handler(BusyError, unavailable)


def _add_reads(app: FastAPI, service: _Service) -> None:
    answers, settings, store = service.answers, service.settings, service.store
    reader = [service.allow("read")]

    @app.get(
        "/v1/sources",
        response_model=models.SourcePage,
        dependencies=reader,
        responses=models.refusals(304, 401, 403, 422, 429, 503),
        summary="Sources, by id or by distance",
    )
    async def sources(
        request: Request,
        kind: Kind | None = None,
        near: Annotated[
            str | None, Query(max_length=80, description="LAT,LON in degrees; the nearest come first.")
        ] = None,
        radius_m: Annotated[
            float, Query(gt=0.0, le=2e7, allow_inf_nan=False, description="Straight-line distance for `near`.")
        ] = 50e3,
        bbox: Annotated[
            str | None,
            Query(max_length=160, description="WEST,SOUTH,EAST,NORTH in degrees; over the date line when WEST > EAST."),
        ] = None,
        name: Annotated[str | None, Query(max_length=100, description="Part of a name, whatever its case.")] = None,
        at: _At = None,
        limit: Annotated[int, Query(ge=1, le=settings.max_page_size)] = settings.page_size,
        cursor: _Cursor = None,
    ) -> Response:
        radius_m = radius_m if near is not None else 0.0
        search = Search(kind, questions.near(near), radius_m, questions.box(bbox), questions.name(name))
        when = questions.time(at, settings.max_ahead_s)
        after = questions.read_cursor(cursor, search)
        answer = await service.read(
            answers.page, search, after, limit, when, lambda end: questions.cursor(end, search), slow=when is not None
        )
        return service.send(request, answer, "")

    @app.get(
        "/v1/sources/{id}",
        response_model=AnsweredSource,
        dependencies=reader,
        responses=models.refusals(304, 401, 403, 404, 422, 429, 503),
        summary="One source, brought to a time",
    )
    async def source(request: Request, id: _Id, at: _At = None) -> Response:
        when = questions.time(at, settings.max_ahead_s)
        return service.send(request, await service.read(answers.source, id, when), f"source {id} is not known")

    @app.get(
        "/v1/sources/{id}/stability",
        response_model=models.Stability,
        dependencies=reader,
        responses=models.refusals(304, 401, 403, 404, 422, 429, 503),
        summary="Allan deviation of a source's clock with its 95 % band",
    )
    async def stability(request: Request, id: _Id, at: _At = None) -> Response:
        when = questions.time(at, settings.max_ahead_s)
        answer = await service.read(answers.stability, id, when)
        return service.send(request, answer, f"the noise of source {id} is not known")

    @app.get(
        "/v1/sources/{id}/contributions",
        response_model=models.ContributionPage,
        dependencies=reader,
        responses=models.refusals(401, 403, 404, 422, 429, 503),
        summary="What was contributed about a source, the newest first",
    )
    async def contributions(
        id: _Id,
        limit: Annotated[int, Query(ge=1, le=settings.max_page_size)] = settings.page_size,
        cursor: _Cursor = None,
    ) -> Response:
        before = questions.read_before(cursor)

        def look() -> list[dict[str, Any]]:
            if not store.source_exists(id):
                raise RefusedError(404, f"source {id} is not known")
            return store.contributions(source_id=id, before=before, limit=limit + 1)

        rows = await service.read(look)
        return models.contribution_page(rows, limit, administrator=False)

    @app.get(
        "/v1/snapshot",
        response_class=Response,
        dependencies=reader,
        responses=models.refusals(304, 401, 403, 429, 503) | {200: {"content": {_SNAPSHOT: {}}}},
        summary="Everything in one file, to work from without a network",
    )
    async def snapshot(request: Request) -> Response:
        answer = await service.read(answers.snapshot, slow=True)
        return service.send(request, answer, "", media_type=_SNAPSHOT)

    @app.get("/health", response_model=models.Health, responses=models.refusals(429, 503), summary="Whether it works")
    async def health(request: Request) -> Response:
        service.guard.address(request)

        def look() -> dict[str, Any]:
            version = answers.refresh()
            database = "sqlite" if store.sqlite else "postgresql"
            return {"status": "ok", "database": database, "version": version, **store.counts()}

        return JSONResponse(await service.read(look), headers={"Cache-Control": "no-store"})


def _add_writes(app: FastAPI, service: _Service) -> None:
    store = service.store

    @app.post(
        "/v1/characterizations",
        status_code=201,
        response_model=models.Receipt,
        responses=models.refusals(400, 401, 403, 408, 409, 413, 415, 422, 429, 503),
        openapi_extra=models.body_of("Characterization", idempotent=True),
        summary="Contribute a characterisation",
    )
    async def contribute(
        request: Request, who: Annotated[Contributor, service.allow("contribute", writes=True)]
    ) -> Response:
        key = questions.idempotency_key(request.headers.get("idempotency-key"))
        body = validated(Characterization, await service.body(request))
        outcome: Outcome = await asyncio.wrap_future(store.contribute(body, who, key=key))
        headers = {"Location": f"/v1/sources/{outcome.answer['source_id']}", "Cache-Control": "no-store"}
        if outcome.repeated:
            headers["Idempotency-Replayed"] = "true"
        return JSONResponse(outcome.answer, 201, headers)


def _add_administration(app: FastAPI, service: _Service) -> None:
    settings, store = service.settings, service.store
    administrator = [service.allow("admin")]
    of_lists = models.refusals(401, 403, 422, 429, 503)
    of_acts = models.refusals(401, 403, 404, 422, 429, 503)
    limit_type = Annotated[int, Query(ge=1, le=settings.max_page_size)]

    @app.get(
        "/v1/characterizations",
        response_model=models.ContributionPage,
        dependencies=administrator,
        responses=of_lists,
        summary="All contributions, the newest first",
    )
    async def every(
        status: Literal["accepted", "quarantined", "rejected"] | None = None,
        limit: limit_type = settings.page_size,
        cursor: _Cursor = None,
    ) -> Response:
        before = questions.read_before(cursor)
        rows = await service.read(lambda: store.contributions(status=status, before=before, limit=limit + 1))
        return models.contribution_page(rows, limit, administrator=True)

    def deciding(word: str, status: str) -> None:
        @app.post(
            f"/v1/characterizations/{{id}}/{word}",
            response_model=models.Receipt,
            responses=of_acts,
            operation_id=word,
            summary=f"{word.capitalize()} a contribution, whatever the rules said",
        )
        async def act(id: _Id, who: Annotated[Contributor, service.allow("admin", writes=True)]) -> Response:
            outcome = await asyncio.wrap_future(store.decide(id, status, who))
            if outcome is None:
                raise RefusedError(404, f"contribution {id} is not known")
            return JSONResponse(outcome.answer, headers={"Cache-Control": "no-store"})

    deciding("release", "accepted")
    deciding("reject", "rejected")

    @app.get(
        "/v1/audit",
        response_model=models.AuditPage,
        dependencies=administrator,
        responses=of_lists,
        summary="The audit trail, the newest first",
    )
    async def audit(
        limit: limit_type = settings.page_size,
        cursor: _Cursor = None,
    ) -> Response:
        before = questions.read_before(cursor)
        rows = await service.read(lambda: store.audit(before=before, limit=limit + 1))
        return models.audit_page(rows, limit)

    @app.get(
        "/v1/tokens",
        response_model=models.TokenList,
        dependencies=administrator,
        responses=models.refusals(401, 403, 429, 503),
        summary="Tokens, without their texts",
    )
    async def tokens() -> Response:
        return models.token_list(await service.read(store.tokens))

    @app.post(
        "/v1/tokens",
        status_code=201,
        response_model=models.MadeToken,
        responses=models.refusals(400, 401, 403, 408, 413, 415, 422, 429, 503),
        openapi_extra=models.body_of("AskedToken"),
        summary="Make a token; its text is shown this once",
    )
    async def make_token(
        request: Request, who: Annotated[Contributor, service.allow("admin", writes=True)]
    ) -> Response:
        asked = validated(models.AskedToken, await service.body(request))
        expires_us = None if asked.expires is None else to_us(asked.expires)
        try:
            made = await run_in_threadpool(
                lambda: store.create_token(asked.name, asked.role, expires_us=expires_us, who=who)
            )
        except ValueError as error:
            field = str(error).split(" ", 1)[0]
            raise RefusedError.of_fields([(field, str(error))]) from None
        answer = {
            "id": made.id,
            "token": made.text,
            "name": asked.name,
            "role": asked.role,
            "expires": None if expires_us is None else models.zulu(from_us(expires_us)),
        }
        return JSONResponse(answer, 201, {"Cache-Control": "no-store"})

    @app.delete(
        "/v1/tokens/{id}", status_code=204, responses=of_acts, summary="Revoke a token", response_class=Response
    )
    async def revoke(
        id: Annotated[str, Path(pattern="^[a-z2-7]{10}$")],
        who: Annotated[Contributor, service.allow("admin", writes=True)],
    ) -> Response:
        if not await run_in_threadpool(store.revoke_token, id, who):
            raise RefusedError(404, f"token {id} is not known or has been revoked before")
        return Response(status_code=204)


def _openapi(app: FastAPI) -> dict[str, Any]:
    if app.openapi_schema is None:
        found = get_openapi(title=app.title, version=app.version, routes=app.routes)
        app.openapi_schema = models.completed(found)
    return app.openapi_schema
