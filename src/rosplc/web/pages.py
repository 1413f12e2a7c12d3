"""The page's own files, as they lie in the package; read once, when the server starts."""

from __future__ import annotations

import hashlib
from importlib import resources

from aiohttp import web

__all__ = ["PageFiles"]

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


class PageFiles:
    """Every file under ``static``, by name, with a tag that changes with its contents."""

    def __init__(self) -> None:
        folder = resources.files("rosplc.web") / "static"
        self._files: dict[str, tuple[bytes, str, str]] = {}
        for file in folder.iterdir():
            kind = _TYPES.get(file.name.rpartition(".")[2])
            if kind is not None:
                content = file.read_bytes()
                self._files[file.name] = (content, kind, hashlib.sha256(content).hexdigest()[:20])

    async def index(self, request: web.Request) -> web.Response:
        """Answer with the page."""
        return self._answer(request, "index.html")

    async def file(self, request: web.Request) -> web.Response:
        """Answer with one of its files. Raises HTTPNotFound."""
        return self._answer(request, request.match_info["name"])

    def _answer(self, request: web.Request, name: str) -> web.Response:
        if name not in self._files:
            raise web.HTTPNotFound
        content, kind, tag = self._files[name]
        # Asked for each time, sent again only after an update: no browser shows an old page.
        headers = {"Cache-Control": "no-cache", "ETag": f'"{tag}"'}
        if f'"{tag}"' in request.headers.get("If-None-Match", ""):
            return web.Response(status=304, headers=headers)
        return web.Response(body=content, content_type=kind, charset="utf-8", headers=headers)
