"""Who may ask: the Host and Origin headers and the token, before any handler runs.

A browser sends every page's requests to the address that a name leads to. A foreign page could
therefore reach a server on loopback directly (cross-site), or under a name of its own that it makes
lead here (DNS rebinding). Against the second the Host header must be an address or a known name;
against the first the Origin header must be this very server.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from rosplc.errors import RosplcError, WebError
from rosplc.web.settings import same_token

if TYPE_CHECKING:
    from rosplc.web.settings import Settings

__all__ = [
    "SECURITY_HEADERS",
    "access",
    "add_headers",
    "bearer",
    "is_loopback",
    "refusal",
    "require_token",
    "wrong_host",
    "wrong_origin",
]

SECURITY_HEADERS = {
    # Nothing but this server's own files, no inline script or style, and no text that becomes markup.
    "Content-Security-Policy": "; ".join(
        (
            "default-src 'none'",
            "script-src 'self'",
            "style-src 'self'",
            "img-src 'self'",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
            "require-trusted-types-for 'script'",
            "trusted-types 'none'",
        )
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
}
"""What stands in every answer."""


def is_loopback(address: str) -> bool:
    """Return whether an address reaches programs of this machine alone."""
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
    """Return whether an Origin header names another server than the Host header does."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return True
    # A proxy in front of this server may speak https; it is the same place.
    return parts.scheme not in ("http", "https") or parts.netloc.lower() != host.lower() or not host


def require_token(settings: Settings, given: str) -> None:
    """Let nobody pass without the token.

    Raises:
        WebError: WEB005.
    """
    if not same_token(settings.token, given):
        raise WebError("WEB005", "a token is needed" if not given else "the token is not the right one")


def bearer(request: web.Request) -> str:
    """Return the token that a request carries; empty if it carries none."""
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
            return refusal(error)
        except web.HTTPException as found:
            return web.json_response({"error": {"what": found.reason}}, status=found.status)

    return guard


async def add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    """Put the headers on every answer, an upgrade to a WebSocket and an error of the parser included."""
    response.headers.update(SECURITY_HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")
    response.headers["Server"] = "rosplc"


def _check(settings: Settings, request: web.Request) -> None:
    host = request.headers.get("Host", "")
    if wrong_host(host, settings.names):
        raise WebError("WEB003", f"the request names the host {host[:80]!r}")
    origin = request.headers.get("Origin")
    foreign = origin is not None and wrong_origin(origin, host)
    fetched_by = request.headers.get("Sec-Fetch-Site", "none")
    if foreign or (request.path.startswith("/api/") and fetched_by not in ("same-origin", "none")):
        raise WebError("WEB004", f"the request comes from the page of {(origin or 'another site')[:80]!r}")
    # The page itself says nothing; what it shows comes from /api/. A WebSocket brings its token as its
    # first message, since a page cannot give it a header.
    if settings.token_to_view and request.path.startswith("/api/") and request.path != "/api/live":
        require_token(settings, bearer(request))


_STATUS = {
    "WEB003": 421,
    "WEB004": 403,
    "WEB005": 401,
    "WEB006": 403,
    "WEB007": 503,
    "WEB008": 404,
    "WEB009": 400,
    "WEB010": 409,
    "SHM101": 404,
    "LAY006": 422,
}


def refusal(error: RosplcError) -> web.Response:
    """Return an error as an answer, in the form that ``--json`` gives everywhere."""
    return web.json_response({"error": error.to_dict()}, status=_STATUS.get(error.code, 409))
