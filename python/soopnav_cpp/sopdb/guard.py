"""Who may do what, and how often: the check in front of every route. Also the headers that every answer carries."""

from __future__ import annotations

import contextlib
from typing import Any

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from soopnav_cpp.sopdb.answers import Answers
from soopnav_cpp.sopdb.auth import allows, parse_token, secret_matches
from soopnav_cpp.sopdb.contributing import Contributor
from soopnav_cpp.sopdb.limits import Buckets, RefusedError, address_of, too_many
from soopnav_cpp.sopdb.schema import now_us
from soopnav_cpp.sopdb.settings import ServiceSettings
from soopnav_cpp.sopdb.store import Store
from soopnav_cpp.sopdb.writer import BusyError

__all__ = ["ANYBODY", "Guard", "Headers"]

ANYBODY = "<anybody>"
_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="signal database"'}
_REFUSED = {"WWW-Authenticate": 'Bearer realm="signal database", error="invalid_token"'}


class Guard:
    """Checks tokens, roles and rates.

    Parameters
    ----------
    store : Store
    answers : Answers
    settings : ServiceSettings
    """

    def __init__(self, store: Store, answers: Answers, settings: ServiceSettings) -> None:
        self._store = store
        self._answers = answers
        self._public_read = settings.public_read
        self._addresses = Buckets(settings.addresses, settings.limited_keys)
        self._failures = Buckets(settings.failures, settings.limited_keys)
        self._reads = Buckets(settings.reads, settings.limited_keys)
        self._writes = Buckets(settings.writes, settings.limited_keys)

    def address(self, request: Request) -> str:
        """The address of a request, one request of which is paid.

        Raises
        ------
        RefusedError
            429.
        """
        address = address_of(request)
        wait_s = self._addresses.take(address)
        if wait_s > 0.0:
            raise too_many(wait_s, "address")
        return address

    def check(self, request: Request, address: str, needed: str, *, writes: bool) -> Contributor:
        """Who sends a request that `needed` may send. The database is looked at, so not in the event loop unless it is
        a file.

        Raises
        ------
        RefusedError
            401 without a token that holds, 403 without the role, 429.
        """
        said = request.headers.get("authorization")
        if said is None:
            if not (needed == "read" and self._public_read):
                raise RefusedError(401, "a token is needed: Authorization: Bearer TOKEN", headers=_CHALLENGE)
            who, role = Contributor(ANYBODY, address), "read"
        else:
            wait_s = self._failures.wait_s(address)
            if wait_s > 0.0:
                raise too_many(wait_s, "address with tokens that were refused")
            who, role = self._holder(request, said, address)
        wait_s = (self._writes if writes else self._reads).take(who.token_id if said is not None else f"@{address}")
        if wait_s > 0.0:
            raise too_many(wait_s, "token" if said is not None else "address")
        if not allows(role, needed):
            self._note(who, request, f"403: role {role}")
            raise RefusedError(403, f"this token may {role}; {needed} is needed")
        return who

    def _holder(self, request: Request, said: str, address: str) -> tuple[Contributor, str]:
        scheme, _, text = said.partition(" ")
        parsed = parse_token(text.strip()) if scheme.lower() == "bearer" else None
        grant = self._answers.grant(parsed[0]) if parsed is not None else None
        # An id that is not there costs a comparison as well.
        right = secret_matches("" if parsed is None else parsed[1], bytes(32) if grant is None else grant.secret_hash)
        if grant is None or not right or (grant.expires_us is not None and grant.expires_us <= now_us()):
            self._failures.take(address)
            ended = grant is not None and right
            known = grant.token_id if grant is not None and ended else ANYBODY
            self._note(Contributor(known, address), request, "401: expired" if ended else "401: no such token")
            sentence = "the token has expired" if ended else "the token is wrong or was revoked"
            raise RefusedError(401, sentence, headers=_REFUSED)
        return Contributor(grant.token_id, address), grant.role

    def _note(self, who: Contributor, request: Request, outcome: str) -> None:
        """Refused attempts to change something go into the audit trail, unless the writer has more to do."""
        if request.method in ("POST", "DELETE"):
            with contextlib.suppress(BusyError):
                self._store.note(who, "refused", f"{request.method} {request.url.path}", outcome)


class Headers:
    """Adds the headers that keep browsers from doing what the page does not need.

    Parameters
    ----------
    app : ASGI application
    https : bool
        Tell browsers to insist on HTTPS.
    """

    def __init__(self, app: ASGIApp, https: bool) -> None:
        self._app = app
        policy = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        policy += "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        headers = {
            "content-security-policy": policy,
            "x-content-type-options": "nosniff",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
            "permissions-policy": "camera=(), geolocation=(), microphone=()",
        }
        if https:
            headers["strict-transport-security"] = "max-age=31536000"
        self._added = [(name.encode(), value.encode()) for name, value in headers.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers: Any = message.setdefault("headers", [])
                message["headers"] = [*headers, *self._added]
            await send(message)

        await self._app(scope, receive, with_headers)
