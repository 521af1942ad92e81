"""A signal database and requests to it within the process, without a socket."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx

from soopnav_cpp.sopdb.service import create_app
from soopnav_cpp.sopdb.settings import Rate, ServiceSettings
from soopnav_cpp.sopdb.store import Store

__all__ = ["FREE", "Api"]

_PLENTY = Rate(1e6, 1e6)
#: No limit is reached.
FREE = {"reads": _PLENTY, "writes": _PLENTY, "addresses": _PLENTY, "failures": _PLENTY}


class Api:
    """Requests to an app over a store, as the holder of a role; with a token of each role."""

    def __init__(self, store: Store, role: str | None = "admin", **settings: Any) -> None:
        self.store = store
        self.app = create_app(store, ServiceSettings(**(FREE | settings)))
        self.tokens = {one: store.create_token(one, one).text for one in ("read", "contribute", "admin")}
        self.role = role

    def __call__(self, method: str, path: str, *, role: str | None = "same", **given: Any) -> httpx.Response:
        """One request; `role` None sends no token, and any text that is no role is sent as the token."""
        role = self.role if role == "same" else role
        headers = dict(given.pop("headers", {}))
        client = given.pop("client", ("192.0.2.1", 5000))
        if role is not None:
            headers.setdefault("Authorization", f"Bearer {self.tokens.get(role, role)}")

        async def run() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, client=client)
            async with httpx.AsyncClient(transport=transport, base_url="http://signals") as http:
                return await http.request(method, path, headers=headers, **given)

        return asyncio.run(run())

    def get(self, path: str, **given: Any) -> httpx.Response:
        """GET."""
        return self("GET", path, **given)

    def post(self, path: str, **given: Any) -> httpx.Response:
        """POST."""
        return self("POST", path, **given)

    def contribute(self, body: Any, **given: Any) -> httpx.Response:
        """POST of a characterisation."""
        return self.post("/v1/characterizations", json=body, **given)
