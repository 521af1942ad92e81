"""The JSON of the service's other answers, for its OpenAPI description; and how they are made from rows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import pydantic
from fastapi.responses import JSONResponse, Response

from soopnav_cpp.sopdb.questions import before_cursor
from soopnav_cpp.sopdb.records import AnsweredSource, Characterization, Text, Time
from soopnav_cpp.sopdb.rendering import zulu
from soopnav_cpp.sopdb.schema import from_us

__all__ = [
    "AskedToken",
    "AuditPage",
    "ContributionPage",
    "Health",
    "MadeToken",
    "Receipt",
    "SourcePage",
    "Stability",
    "TokenList",
    "audit_page",
    "body_of",
    "completed",
    "contribution_page",
    "refusals",
    "token_list",
    "zulu",
]

Status = Literal["accepted", "quarantined", "rejected"]
Role = Literal["read", "contribute", "admin"]


class SourcePage(pydantic.BaseModel):
    """A page of sources, all at one time."""

    at: Time
    sources: list[AnsweredSource]
    next_cursor: str | None


class Stability(pydantic.BaseModel):
    """Allan deviation over averaging times, and the band it lies in with that confidence."""

    id: str
    at: Time
    confidence: float
    tau_s: list[float]
    deviation: list[float]
    lower: list[float]
    upper: list[float]


class Receipt(pydantic.BaseModel):
    """What became of a contribution."""

    id: str
    status: Status
    reasons: list[str]
    source_id: str


class KeptContribution(pydantic.BaseModel):
    """A contribution as it came, and what became of it; who sent it is told to administrators only."""

    id: str
    source_id: str
    received: Time
    status: Status
    reasons: list[str]
    decided_by: str
    contributor: str | None = None
    characterization: dict[str, Any]


class ContributionPage(pydantic.BaseModel):
    """A page of contributions, the newest first."""

    contributions: list[KeptContribution]
    next_cursor: str | None


class AuditEntry(pydantic.BaseModel):
    """Who did what, when, and what came of it."""

    id: str
    at: Time
    actor: str
    address: str
    action: str
    target: str
    outcome: str


class AuditPage(pydantic.BaseModel):
    """A page of the audit trail, the newest first."""

    entries: list[AuditEntry]
    next_cursor: str | None


class AskedToken(pydantic.BaseModel):
    """A token to be made."""

    model_config = pydantic.ConfigDict(extra="forbid")
    name: Text
    role: Role
    expires: Time | None = None


class MadeToken(pydantic.BaseModel):
    """A new token, with its text."""

    id: str
    token: str
    name: str
    role: Role
    expires: Time | None


class KeptToken(pydantic.BaseModel):
    """A token, without its text."""

    id: str
    name: str
    role: Role
    created: Time
    created_by: str
    expires: Time | None
    revoked: Time | None


class TokenList(pydantic.BaseModel):
    """Every token."""

    tokens: list[KeptToken]


class Health(pydantic.BaseModel):
    """That the service works, and on what."""

    status: Literal["ok"]
    database: Literal["sqlite", "postgresql"]
    version: int
    sources: int
    contributions: int


class FieldError(pydantic.BaseModel):
    """A field that does not fit."""

    field: str
    message: str


class Refusal(pydantic.BaseModel):
    """Why not, in a sentence."""

    detail: str
    errors: Annotated[list[FieldError], pydantic.Field(default_factory=list)]


_SENTENCES = {
    304: "Not changed since the answer with that ETag",
    400: "The body ended early",
    401: "No token, or one that is wrong, expired or revoked",
    403: "The token's role does not allow it",
    404: "Not known",
    408: "The body took too long",
    409: "The idempotency key came with another body before",
    413: "The body is too long",
    415: "The body is not application/json",
    422: "A parameter or field does not fit; errors name it",
    429: "Too many requests; Retry-After says how long to wait",
    503: "The database does not answer or has too much to do; Retry-After says how long to wait",
}


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Descriptions of the other answers of a route."""
    return {
        status: {"description": _SENTENCES[status]} | ({} if status == 304 else {"model": Refusal})
        for status in statuses
    }


def body_of(name: str, *, idempotent: bool = False) -> dict[str, Any]:
    """Description of a body that the route reads itself."""
    reference = {"$ref": f"#/components/schemas/{name}"}
    out: dict[str, Any] = {"requestBody": {"required": True, "content": {"application/json": {"schema": reference}}}}
    if idempotent:
        out["parameters"] = [
            {
                "name": "Idempotency-Key",
                "in": "header",
                "required": False,
                "description": "The same for every try of one contribution, so that it is made once.",
                "schema": {"type": "string", "minLength": 1, "maxLength": 200, "pattern": "^[!-~]+$"},
            }
        ]
    return out


def completed(description: dict[str, Any]) -> dict[str, Any]:
    """An OpenAPI description with the bodies that routes read themselves, and how to say who one is."""
    components = description.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for model in (Characterization, AskedToken):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas.update(schema.pop("$defs", {}))
        schemas[model.__name__] = schema
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    description["security"] = [{"token": []}, {}]
    return description


def _page(name: str, rows: Sequence[dict[str, Any]], limit: int, entries: list[dict[str, Any]]) -> Response:
    more = before_cursor(rows[limit - 1]["id"]) if len(rows) > limit else None
    return JSONResponse({name: entries, "next_cursor": more}, headers={"Cache-Control": "no-store"})


def contribution_page(rows: Sequence[dict[str, Any]], limit: int, *, administrator: bool) -> Response:
    """The answer of `ContributionPage` for rows of the store, one more than `limit` when there is a next page."""
    entries = [
        {
            "id": str(row["id"]),
            "source_id": str(row["source_id"]),
            "received": zulu(from_us(row["received_us"])),
            "status": row["status"],
            "reasons": json.loads(row["reasons"]),
            "decided_by": row["decided_by"] if row["decided_by"] in ("rule", "twin") else "administrator",
            **({"contributor": row["token_id"]} if administrator else {}),
            "characterization": json.loads(row["body"]),
        }
        for row in rows[:limit]
    ]
    return _page("contributions", rows, limit, entries)


def audit_page(rows: Sequence[dict[str, Any]], limit: int) -> Response:
    """The answer of `AuditPage` for rows of the store."""
    entries = [
        {**{k: v for k, v in row.items() if k != "at_us"}, "id": str(row["id"]), "at": zulu(from_us(row["at_us"]))}
        for row in rows[:limit]
    ]
    return _page("entries", rows, limit, entries)


def token_list(rows: Sequence[dict[str, Any]]) -> Response:
    """The answer of `TokenList` for rows of the store."""

    def time(value: int | None) -> str | None:
        return None if value is None else zulu(from_us(value))

    tokens = [
        {
            **{name: row[name] for name in ("id", "name", "role", "created_by")},
            **{name: time(row[f"{name}_us"]) for name in ("created", "expires", "revoked")},
        }
        for row in rows
    ]
    return JSONResponse({"tokens": tokens}, headers={"Cache-Control": "no-store"})
