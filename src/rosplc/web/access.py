"""Access control: the server's settings and token, and the Host and Origin headers, before any handler runs.

A browser sends every page's requests to the address that a name resolves to. A foreign page could therefore
reach a server on loopback directly (cross-site), or through its own name that it resolves to this server
(DNS rebinding). Against DNS rebinding, the Host header must be an address or a known name; against cross-site
requests, the Origin header must be this server.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import secrets
import stat
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from rosplc.errors import RosplcError, WebError
from rosplc.shm.files import describe_status


@dataclass(frozen=True)
class Settings:
    """The settings of one server.

    ``prefix`` None shows all; ``names`` are accepted host names of the server, besides ``localhost`` and
    addresses; ``token`` is required to write, or to view (``token_to_view``); an empty token means that none
    is needed; ``viewers`` is the maximum number of connected pages.
    """

    prefix: str | None = None
    directory: str = "/dev/shm"
    names: tuple[str, ...] = ()
    allow_write: bool = False
    token: str = ""
    token_to_view: bool = False
    viewers: int = 32

    def __post_init__(self) -> None:
        if (self.allow_write or self.token_to_view) and not self.token:
            raise ValueError("allow_write and token_to_view need a token")


_FEWEST = 16
_MOST = 256
_CHARACTERS = re.compile(rf"[!-~]{{{_FEWEST},{_MOST}}}")


def new_token() -> str:
    """Return a token that cannot be guessed: 144 random bits, as text that is valid in a URL."""
    return secrets.token_urlsafe(18)


def read_token(path: Path) -> str:
    """Return the token in a file, without surrounding whitespace.

    Raises WebError WEB002 if the file cannot be read, is accessible to other users, or contains no token: 16
    to 256 printable characters without spaces.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            text = file.read(_MOST + 64).decode("ascii", "replace").strip()
    except OSError as error:
        raise WebError("WEB002", f"cannot read the file: {error.strerror}", where=str(path)) from error
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        what = f"users other than the owner have access to the file: {describe_status(status)}"
        raise WebError("WEB002", what, where=str(path), remedy=f"Run `chmod 600 {path}`.")
    if not _CHARACTERS.fullmatch(text):
        what = f"the file has no token of {_FEWEST} to {_MOST} printable characters without spaces"
        raise WebError("WEB002", what, where=str(path))
    return text


def same_token(expected: str, given: str) -> bool:
    """Return whether two tokens are equal, in a time that does not depend on the matching part."""
    return bool(expected) and hmac.compare_digest(expected.encode(), given.encode("utf-8", "replace"))


SECURITY_HEADERS = {
    # Nothing but this server's own files, no inline script or style, and no text that becomes markup.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
}
"""Headers of every response."""


def is_loopback(address: str) -> bool:
    """Return whether an address is reachable only from this machine."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def wrong_host(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header is neither an address, nor ``localhost``, nor one of ``names``."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return True
    if name == "localhost" or name in {known.lower() for known in names}:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return True
    return False


def wrong_origin(origin: str, host: str) -> bool:
    """Return whether the Origin header refers to another server than the Host header."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return True
    # A proxy in front of this server may speak https; it is the same place.
    return parts.scheme not in ("http", "https") or parts.netloc.lower() != host.lower() or not host


def require_token(settings: Settings, given: str) -> None:
    """Raise WebError WEB005 unless the token is correct."""
    if not same_token(settings.token, given):
        raise WebError("WEB005", "a token is needed" if not given else "the token is wrong")


def bearer(request: web.Request) -> str:
    """Return the token in a request, or an empty text."""
    kind, _, token = request.headers.get("Authorization", "").partition(" ")
    return token.strip() if kind.lower() == "bearer" else ""


def access(settings: Settings) -> Middleware:
    """Return the middleware that refuses foreign requests and adds :data:`SECURITY_HEADERS`."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            _check(settings, request)
            return await handler(request)
        except RosplcError as error:
            # In the form that --json gives everywhere.
            return web.json_response({"error": error.to_dict()}, status=_STATUS.get(error.code, 409))
        except web.HTTPException as found:
            return web.json_response({"error": {"what": found.reason}}, status=found.status)

    return guard


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """Add the headers to every response, including WebSocket upgrades and errors of the parser."""
    response.headers.update(SECURITY_HEADERS)
    # A file is asked for each time, and sent again only after an update: no browser shows an old page.
    response.headers["Cache-Control"] = "no-store" if request.path.startswith("/api/") else "no-cache"
    response.headers["Server"] = "rosplc"


def _check(settings: Settings, request: web.Request) -> None:
    host = request.headers.get("Host", "")
    if wrong_host(host, settings.names):
        raise WebError("WEB003", f"the request is for the host {host[:80]!r}, not for this server")
    origin = request.headers.get("Origin")
    foreign = origin is not None and wrong_origin(origin, host)
    fetched_by = request.headers.get("Sec-Fetch-Site", "none")
    if foreign or (request.path.startswith("/api/") and fetched_by not in ("same-origin", "none")):
        raise WebError("WEB004", f"the request is from another site's page: {(origin or 'unknown')[:80]!r}")
    # The page itself says nothing; what it shows comes from /api/. A WebSocket brings its token as its
    # first message, since a page cannot give it a header.
    if settings.token_to_view and request.path.startswith("/api/") and request.path != "/api/live":
        require_token(settings, bearer(request))


_STATUS = {
    "WEB003": 421, "WEB004": 403, "WEB005": 401, "WEB006": 403, "WEB007": 503, "WEB008": 404, "WEB009": 400,
    "WEB010": 409, "SHM101": 404, "LAY006": 422,
}  # fmt: skip
