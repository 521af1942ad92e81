"""The web page: files of the package, given as they are."""

from __future__ import annotations

import hashlib
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import Response

from soopnav_cpp.sopdb.limits import RefusedError
from soopnav_cpp.sopdb.questions import matches

__all__ = ["FOLDER", "add_page"]

FOLDER = Path(__file__).parent / "web"
_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".webmanifest": "application/manifest+json",
}


def add_page(app: FastAPI) -> None:
    """Give ``index.html`` at ``/`` and every file of `FOLDER` below ``/static/``.

    The files are read once and found by their name among these, so no path leads anywhere else. They hold no data, so
    they need no token.

    Parameters
    ----------
    app : FastAPI
    """
    folder = FOLDER
    files: dict[str, tuple[bytes, str, str]] = {}
    for path in sorted(folder.rglob("*")) if folder.is_dir() else []:
        if path.is_file() and path.suffix in _TYPES:
            content = path.read_bytes()
            tag = f'"{hashlib.blake2b(content, digest_size=12).hexdigest()}"'
            files[path.relative_to(folder).as_posix()] = content, _TYPES[path.suffix], tag

    def send(request: Request, name: str) -> Response:
        if name not in files:
            raise RefusedError(404, f"nothing is at {request.url.path[:200]}")
        content, kind, tag = files[name]
        headers = {"ETag": tag, "Cache-Control": "no-cache"}
        if matches(request.headers.get("if-none-match"), tag):
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=kind, headers=headers)

    async def index(request: Request) -> Response:
        return send(request, "index.html")

    async def static(request: Request) -> Response:
        return send(request, request.path_params["name"])

    app.add_route("/", index, methods=["GET"], include_in_schema=False)
    app.add_route("/static/{name:path}", static, methods=["GET"], include_in_schema=False)
