"""What happens to every request: id, host, origin and parameters checked, headers, one log line, numbers."""

from __future__ import annotations

import ipaddress
import logging
import re
import secrets
import socket
import time

from fastapi import Request
from starlette.datastructures import URL, Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.info import DURATION, REQUESTS, UPLOAD_BYTES
from service.api.problem_responses import HttpProblem, response
from service.jobs.settings import Settings

SAFE = ("GET", "HEAD", "OPTIONS", "TRACE")
"""Methods that change nothing (RFC 9110, section 9.2.1); that no page reads their answers is up to CORS."""

_OWN = ("same-origin", "none")
_PORTS = {"http": 80, "https": 443}


def is_foreign(method: str, site: str, origin: str, host: str) -> bool:
    """Whether a request that changes something was made by a page of another origin, by its headers, "" without one."""
    if method in SAFE:
        return False
    if site:
        return site.strip().lower() not in _OWN
    return bool(origin) and not _same_origin(origin, host)


def _same_origin(origin: str, host: str) -> bool:
    """Whether an origin names the host that was asked; the scheme is the proxy's affair."""
    try:
        theirs = URL(origin.strip().lower())
        ours = URL(f"{theirs.scheme}://{host.strip().lower()}")
        port = _PORTS.get(theirs.scheme)
        if theirs.hostname is None or port is None:
            return False
        return theirs.hostname == ours.hostname and (theirs.port or port) == (ours.port or port)
    except ValueError:
        return False


async def no_strange_parameters(request: Request) -> None:
    """Refuse parameters of the address that the route does not take, or that are there twice: a misspelt one would be
    passed over in silence.
    """
    route = request.scope.get("route")
    dependant = getattr(route, "dependant", None)
    extra: frozenset[str] = getattr(getattr(route, "endpoint", None), "more_parameters", frozenset())
    known = {field.alias for field in getattr(dependant, "query_params", ())} | set(extra)
    for name in request.query_params:
        if name not in known:
            words = f"there is no parameter {name[:40]!r} here"
            words += f"; there are {', '.join(sorted(known))}" if known else ", nor any other"
        elif len(request.query_params.getlist(name)) > 1:
            words = f"the parameter {name!r} is there more than once; one value is right"
        else:
            continue
        raise HttpProblem("invalid-parameter", 422, words, pointer=f"/query/{name[:40]}")


def is_head(request: Request) -> bool:
    """Whether only the head of the answer is wanted, so that its body need not be made."""
    return bool(request.scope.get("asked_for_head"))


class Heads:
    """Answers HEAD wherever GET is answered (RFC 9110, section 9.3.2)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, as GET where HEAD is asked for, and its answer back without the body."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        async def bodiless(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        scope["method"], scope["asked_for_head"] = "GET", True
        await self._app(scope, receive, bodiless)


def in_origin_form(scope: Scope) -> Scope:
    """A request whose target has scheme and host (RFC 9112, section 3.2.2) as one without; its host comes from there.

    Every server has to take such a target, and to ignore the Host header then.
    """
    path = scope["path"]
    if not path.lower().startswith(("http://", "https://")):
        return scope
    target = URL(path)
    raw = scope.get("raw_path", b"")
    _, _, rest = raw.partition(b"://")
    raw = b"/" + rest.partition(b"/")[2]
    others = [(name, value) for name, value in scope["headers"] if name != b"host"]
    headers = [(b"host", target.netloc.encode("latin-1", "replace")), *others]
    return {**scope, "path": target.path or "/", "raw_path": raw, "headers": headers}


log = logging.getLogger("service.api.access")

_ID = re.compile(r"[A-Za-z0-9._-]{1,64}\Z")
_PORT = re.compile(r":\d{1,5}\Z")

MAX_HEAD = 32 << 10
"""Bytes of the address and the headers of a request."""

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), geolocation=(), microphone=()",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self' blob:; font-src 'self'; worker-src 'self' blob:; manifest-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
}

PROBES = ("/livez", "/readyz", "/metrics")
"""Addresses that are asked for by whoever watches over the server, which may know it by its address only."""


def host_name(header: str) -> str:
    """Name or address in a Host header, without the port, in lower case."""
    return _PORT.sub("", header.strip().lower())


class Hosts:
    """Names that the Host header may have.

    Without a list: any literal address, localhost and the name of this machine. A web page that points a name of its
    own at this server (DNS rebinding) is none of these. With a list only its names; and literal addresses for probes.
    """

    def __init__(self, settings: Settings) -> None:
        self._listed = {name.strip().lower() for name in settings.allowed_hosts.split(",") if name.strip()}
        self._own = {"localhost", socket.gethostname().lower(), settings.host.lower()}

    def allow(self, header: str, path: str = "") -> bool:
        """Whether a Host header is one of this server, for a request of ``path``."""
        name = host_name(header)
        if self._listed:
            if name in self._listed or "*" in self._listed:
                return True
            if path not in PROBES:
                return False
        elif name in self._own:
            return True
        try:
            ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
        except ValueError:
            return False
        return True


class Front:
    """The outermost layer of the application."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._hosts = Hosts(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope = in_origin_form(scope)
        headers = Headers(scope=scope)
        given = headers.get("x-request-id", "")
        exchange = _Exchange(scope, receive, send, given if _ID.match(given) else secrets.token_hex(8))
        try:
            refusal = self._refusal(scope, headers)
            if refusal is not None:
                await response(refusal.body, refusal.headers, scope["path"])(scope, receive, exchange.send)
            else:
                await self._app(scope, exchange.receive, exchange.send)
        finally:
            exchange.log()

    def _refusal(self, scope: Scope, headers: Headers) -> HttpProblem | None:
        host, site, origin = (headers.get(name, "") for name in ("host", "sec-fetch-site", "origin"))
        if len(headers.getlist("host")) > 1 or not self._hosts.allow(host, scope["path"]):
            return HttpProblem("bad-host", 400)
        if is_foreign(scope["method"], site, origin, host):
            return HttpProblem("cross-origin", 403, headers={"Connection": "close"})
        if "content-length" in headers and "transfer-encoding" in headers:
            detail = "Content-Length and Transfer-Encoding exclude each other"
            return HttpProblem("bad-request", 400, detail, {"Connection": "close"})
        if headers.get("content-encoding", "").strip().lower() not in ("", "identity"):
            words, more = "a body is taken as it is, without Content-Encoding", {"Accept-Encoding": "identity"}
            return HttpProblem("unsupported-media-type", 415, words, more | {"Connection": "close"})
        address = len(scope.get("raw_path", b"")) + len(scope["query_string"])
        if address + sum(len(name) + len(value) for name, value in headers.raw) > MAX_HEAD:
            detail = f"address and headers may have {MAX_HEAD} bytes"
            return HttpProblem("bad-request", 431, detail, {"Connection": "close"})
        return None


class _Exchange:
    """One request and its answer, for the log."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, request_id: str) -> None:
        self._scope, self._receive, self._send, self._id = scope, receive, send, request_id
        self._method = scope["method"] if scope["method"] in _METHODS else "other"
        self._begin = time.perf_counter()
        self._status, self._bytes_in, self._bytes_out, self._head = 0, 0, 0, 0.0

    async def receive(self) -> Message:
        message = await self._receive()
        self._bytes_in += len(message.get("body", b""))
        return message

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._status = message["status"]
            self._head = time.perf_counter() - self._begin
            headers = MutableHeaders(raw=list(message.get("headers", ())))
            headers["X-Request-Id"] = self._id
            for name, value in SECURITY_HEADERS.items():
                headers.setdefault(name, value)
            message = {**message, "headers": headers.raw}
        self._bytes_out += len(message.get("body", b""))
        await self._send(message)

    def log(self) -> None:
        route = getattr(self._scope.get("route"), "path", None) or "none"
        REQUESTS.labels(self._method, route, str(self._status)).inc()
        DURATION.labels(route).observe(self._head)
        UPLOAD_BYTES.inc(self._bytes_in)
        facts = {
            "request": self._id, "method": self._method, "route": route, "status": self._status,
            "seconds": round(time.perf_counter() - self._begin, 4), "bytes_in": self._bytes_in,
            "bytes_out": self._bytes_out,
        }  # fmt: skip
        level = logging.DEBUG if route in PROBES else logging.INFO
        log.log(level, "%s %s %d", self._method, route, self._status, extra=facts)


_METHODS = ("GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH")
