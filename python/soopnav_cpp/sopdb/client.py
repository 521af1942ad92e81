"""Asks a service of the signal database, contributes to it, and works on from a snapshot when it cannot be reached.

>>> with Client("https://sop.example.org", token=token, snapshot="signals.sopcat") as client:   # doctest: +SKIP
...     receipt = client.push(body)
...     for source in client.sources(kind="cdma", near=(30.28, -97.73), radius_m=20e3): ...
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pydantic

from soopnav_cpp._extras import require
from soopnav_cpp.sopdb import snapshot as _snapshot
from soopnav_cpp.sopdb.records import AnsweredSource, Characterization
from soopnav_cpp.sopdb.snapshot import Catalog

__all__ = ["Client", "Receipt", "ServiceError", "UnreachableError"]

_MOST_JSON = 32 << 20
_MOST_SNAPSHOT = 1 << 30
_MOST_KEPT = 256  # answers with their ETag
_AGAIN = (502, 503, 504)
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class ServiceError(ValueError):
    """The service refused, or answered what cannot be used; the text is a sentence.

    Attributes
    ----------
    status : int
        Of HTTP; 0 when there was no answer.
    """

    def __init__(self, sentence: str, status: int = 0) -> None:
        super().__init__(sentence)
        self.status = status


class UnreachableError(ServiceError):
    """No answer, after every retry."""


@dataclass(frozen=True)
class Receipt:
    """What became of a contribution.

    Attributes
    ----------
    id, source_id : str
    status : str
        ``"accepted"`` or ``"quarantined"``.
    reasons : tuple of str
        Why it is in quarantine.
    """

    id: str
    source_id: str
    status: str
    reasons: tuple[str, ...]


def _key_of(body: Mapping[str, Any]) -> str:
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _sentence(answer: Any, what: str) -> str:
    """What the service says was wrong."""
    detail = answer.get("detail") if isinstance(answer, dict) else None
    if isinstance(detail, list) and detail and isinstance(detail[0], dict):
        first = detail[0]
        detail = f"{'.'.join(str(part) for part in first.get('loc', ())[1:])}: {first.get('msg', '')}"
    return f"{what}: {detail}" if isinstance(detail, str) and detail else what


class Client:
    """A service, and a snapshot for when it does not answer.

    Parameters
    ----------
    url : str
        ``https://HOST`` or ``http://HOST:PORT``.
    token : str, optional
        What `soopnav sopdb token create` printed.
    timeout_s : float
        For a connection, and for each read.
    retries : int
        After a failed connection, a time-out, or an answer that says "not now". A contribution carries a key, so that a
        retry makes no second record.
    patience_s : float
        Longest that the service may ask to wait between two tries.
    snapshot : path, optional
        Read when the service does not answer; written by `pull`.
    insecure : bool
        Send a token over plain HTTP to another machine all the same.
    http : httpx.Client, optional
        To send requests with, such as a test's.
    sleep : callable, optional
        Waits so many seconds, in place of ``time.sleep``.

    Raises
    ------
    ValueError
        For a URL that is none, or a token that anybody on the way could read.
    """

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeout_s: float = 10.0,
        retries: int = 4,
        patience_s: float = 30.0,
        snapshot: str | os.PathLike[str] | None = None,
        insecure: bool = False,
        http: Any = None,
        sleep: Callable[[float], None] | None = None,
    ) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.username:
            raise ValueError(f"url = {url} must be https://HOST or http://HOST:PORT")
        if not (timeout_s > 0.0 and math.isfinite(timeout_s)):
            raise ValueError(f"timeout_s = {timeout_s} must be positive and finite")
        if retries < 0:
            raise ValueError(f"retries = {retries} must not be negative")
        if token is not None and not (token.isascii() and token.isprintable() and " " not in token and token):
            raise ValueError("token: printable characters without blanks expected")
        if token and parts.scheme == "http" and parts.hostname not in _LOOPBACK and not insecure:
            raise ValueError(f"url = {url}: without https anybody on the way can read the token")
        self._httpx = require("httpx", "sopdb", "the signal database")
        self._http = http if http is not None else self._httpx.Client(timeout=timeout_s, follow_redirects=False)
        self._own = http is None
        self._url = url.rstrip("/")
        self._token = token
        self._retries = retries
        self._patience_s = patience_s
        self._path = None if snapshot is None else Path(snapshot)
        self._sleep = sleep if sleep is not None else time.sleep
        self._kept: dict[str, tuple[str, Any]] = {}
        #: The catalogue that answered in the service's place; None when the service did.
        self.offline: Catalog | None = None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Client({self._url!r})"

    def close(self) -> None:
        """Close the connections."""
        if self._own:
            self._http.close()

    # Requests

    def _once(self, method: str, path: str, most: int, options: Mapping[str, Any]) -> tuple[int, Any, bytes]:
        headers = dict(options.get("headers", {}))
        if self._token:
            headers["Authorization"] = f"Bearer {self._token}"
        more = {name: options[name] for name in ("params", "json") if options.get(name) is not None}
        with self._http.stream(method, self._url + path, headers=headers, **more) as response:
            body = bytearray()
            for chunk in response.iter_bytes():
                body += chunk
                if len(body) > most:
                    raise ServiceError(f"{self._url}{path}: an answer above {most >> 20} MiB", response.status_code)
            return response.status_code, response.headers, bytes(body)

    def _wait_s(self, headers: Mapping[str, str], attempt: int) -> float:
        try:
            asked = float(headers.get("Retry-After", ""))
        except ValueError:
            asked = math.nan
        return asked if asked >= 0.0 else 0.25 * 2.0**attempt

    def _request(
        self, method: str, path: str, *, most: int = _MOST_JSON, may: tuple[int, ...] = (), **options: Any
    ) -> tuple[int, Any, bytes]:
        """An answer below 300 or one in `may`; retries what may pass."""
        for attempt in range(self._retries + 1):
            last = attempt == self._retries
            try:
                status, headers, body = self._once(method, path, most, options)
            except (self._httpx.TransportError, OSError) as error:
                if not last:
                    self._sleep(self._wait_s({}, attempt))
                    continue
                why = "no answer in time" if isinstance(error, self._httpx.TimeoutException) else str(error)
                raise UnreachableError(f"{self._url} does not answer: {why or type(error).__name__}") from error
            if status < 300 or status in may:
                return status, headers, body
            if status == 429 or status in _AGAIN:
                wait_s = self._wait_s(headers, attempt)
                if not last and wait_s <= self._patience_s:
                    self._sleep(wait_s)
                    continue
                if status == 429:
                    raise ServiceError(f"too many requests: try again in {wait_s:.0f} s", status)
                raise UnreachableError(f"{self._url} cannot answer now (status {status})", status)
            raise self._refusal(status, body)
        raise AssertionError("unreachable")

    def _refusal(self, status: int, body: bytes) -> ServiceError:
        try:
            answer = json.loads(body)
        except ValueError:
            answer = None
        if status == 401:
            if self._token is None:
                return ServiceError(f"{self._url} asks for a token: --token, or SOOPNAV_SOPDB_TOKEN", status)
            return ServiceError(_sentence(answer, "the token was refused"), status)
        if status == 403:
            return ServiceError(_sentence(answer, "the token does not allow this"), status)
        if status == 404:
            return ServiceError(_sentence(answer, f"{self._url} does not have that"), status)
        if 300 <= status < 400:
            return ServiceError(f"{self._url} sends elsewhere (status {status}): give the address it now has", status)
        return ServiceError(_sentence(answer, f"refused (status {status})"), status)

    def _get(self, path: str, **params: Any) -> Any:
        params = {name: value for name, value in params.items() if value is not None}
        key = json.dumps([path, params], sort_keys=True)
        kept = self._kept.get(key)
        headers = {} if kept is None else {"If-None-Match": kept[0]}
        status, found, body = self._request("GET", path, params=params, headers=headers, may=(304,))
        if status == 304:
            if kept is None:
                raise ServiceError(f"{self._url}{path}: an answer without content", status)
            return kept[1]
        try:
            value = json.loads(body)
        except ValueError:
            raise ServiceError(f"{self._url}{path}: the answer is not JSON", status) from None
        if etag := found.get("ETag"):
            if len(self._kept) >= _MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = (etag, value)
        return value

    def _source_of(self, value: Any) -> dict[str, Any]:
        try:
            return AnsweredSource.model_validate(value).model_dump(mode="json")
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ServiceError(f"{self._url} answered a source that cannot be read: {where}: {first['msg']}") from error

    def _fall_back(self, error: UnreachableError) -> Catalog:
        if self._path is None or not self._path.exists():
            raise error
        if self.offline is None:
            self.offline = _snapshot.read(self._path)
        return self.offline

    # Questions

    def health(self) -> dict[str, Any]:
        """What the service says of itself.

        Raises
        ------
        ServiceError
        """
        found = self._get("/health")
        return found if isinstance(found, dict) else {}

    def sources(
        self,
        *,
        at: datetime | None = None,
        kind: str | None = None,
        near: tuple[float, float] | None = None,
        radius_m: float | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Sources as answered (`soopnav_cpp.sopdb.records.AnsweredSource`), page after page.

        Parameters
        ----------
        at : datetime, optional
            The time they are brought to; without it now.
        kind : str, optional
        near : (latitude, longitude) in degrees, optional
            Together with `radius_m`.
        radius_m : float, optional

        Raises
        ------
        ServiceError
            When the service refuses, or does not answer and there is no snapshot.
        """
        if (near is None) != (radius_m is None):
            raise ValueError("near and radius_m: both or neither expected")
        params: dict[str, Any] = {"kind": kind, "radius_m": radius_m}
        if at is not None:
            params["at"] = at.isoformat()
        if near is not None:
            params["near"] = f"{near[0]!r},{near[1]!r}"
        cursor = None
        seen: set[str] = set()
        while True:
            try:
                page = self._get("/v1/sources", **params, cursor=cursor)
                self.offline = None
            except UnreachableError as error:
                catalog = self._fall_back(error)
                for source in catalog.sources(at, kind=kind, near=near, radius_m=radius_m):
                    if source["id"] not in seen:
                        yield source
                return
            if not isinstance(page, dict) or not isinstance(page.get("sources"), list):
                raise ServiceError(f"{self._url} answered a page that cannot be read")
            for value in page["sources"]:
                source = self._source_of(value)
                seen.add(source["id"])
                yield source
            following = page.get("next_cursor")
            if following is None or following == cursor:
                return
            cursor = following

    def source(self, source_id: str, *, at: datetime | None = None) -> dict[str, Any]:
        """A source, brought to a time.

        Raises
        ------
        ServiceError
            As `sources`; with status 404 for one that is not known.
        """
        try:
            value = self._get(f"/v1/sources/{_segment(source_id)}", at=None if at is None else at.isoformat())
            self.offline = None
        except UnreachableError as error:
            catalog = self._fall_back(error)
            if source_id not in catalog:
                raise ServiceError(f"the snapshot has no source {source_id}", 404) from error
            return catalog.source(source_id, at)
        return self._source_of(value)

    def stability(self, source_id: str) -> dict[str, list[float]]:
        """Allan deviation of a source's clock with its band: ``tau_s``, ``deviation``, ``lower``, ``upper``."""
        found: dict[str, list[float]] = self._get(f"/v1/sources/{_segment(source_id)}/stability")
        return found

    # Contributions

    def push(self, body: Characterization | Mapping[str, Any], *, key: str | None = None) -> Receipt:
        """Contribute a characterisation. It is checked here first, and sent with a key of its content: sent twice, for
        whatever reason, it is one record.

        Raises
        ------
        ValueError
            For a body that is no characterisation (``pydantic.ValidationError``).
        ServiceError
            When the service refuses or does not answer.
        """
        if not isinstance(body, Characterization):
            body = Characterization.model_validate(body)
        value = body.to_json()
        headers = {"Idempotency-Key": key or _key_of(value)}
        _, _, answer = self._request("POST", "/v1/characterizations", json=value, headers=headers)
        try:
            found = json.loads(answer)
            reasons = tuple(str(reason) for reason in found.get("reasons", ()))
            return Receipt(str(found["id"]), str(found["source_id"]), str(found["status"]), reasons)
        except (ValueError, KeyError, AttributeError, TypeError):
            raise ServiceError(f"{self._url}: an answer to a contribution that cannot be read") from None

    def pull(self, path: str | os.PathLike[str] | None = None) -> tuple[Catalog, bool]:
        """Download the snapshot; nothing is sent again when it has not changed.

        Parameters
        ----------
        path : path, optional
            Where to keep it, in place of the client's own. Its ETag is kept beside it.

        Returns
        -------
        catalog : Catalog
        changed : bool
            Whether it was downloaded.

        Raises
        ------
        ServiceError, OSError
            The file is then as it was.
        """
        target = Path(path) if path is not None else self._path
        if target is None:
            raise ValueError("path: where to keep the snapshot")
        beside = target.with_name(f"{target.name}.etag")
        kept: Catalog | None = None
        headers = {}
        if target.exists() and beside.exists():
            try:
                kept = _snapshot.read(target)
                origin, _, etag = beside.read_text(encoding="utf-8").strip().partition(" ")
                if origin == self._url and etag.isascii() and etag.isprintable():
                    headers["If-None-Match"] = etag
            except (ValueError, OSError):
                kept = None
        status, found, body = self._request("GET", "/v1/snapshot", most=_MOST_SNAPSHOT, headers=headers, may=(304,))
        if status == 304 and kept is not None and headers:
            return kept, False
        try:
            beside.unlink(missing_ok=True)  # an old ETag beside a new file would be a lie
            catalog = _snapshot.write(target, body)
        except ValueError as error:
            raise ServiceError(f"{self._url}/v1/snapshot: {error}", status) from error
        if etag := found.get("ETag"):
            beside.write_text(f"{self._url} {etag}\n", encoding="utf-8")
        return catalog, True


def _segment(source_id: str) -> str:
    if not source_id or len(source_id) > 40 or not all(c.isascii() and (c.isalnum() or c in "-_") for c in source_id):
        raise ValueError(f"source = {source_id!r}: letters, digits, - and _ expected, 40 at most")
    return source_id
