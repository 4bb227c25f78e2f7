"""What the framework passes and this interface does not: strange parameters, HEAD without an answer."""

from __future__ import annotations

import re

from fastapi import Request
from starlette.datastructures import URL
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import ProblemError

_OWN_HEAD = re.compile(
    r"/v1/(avatars/[^/]+/(archive\.zip|files/.+|photo|events)|renders/[^/]+/picture\.png|exports/[^/]+/kit\.zip)\Z"
)
"""Addresses whose HEAD is not a GET without its body: downloads answer it themselves, a stream of events has none."""


async def no_strange_parameters(request: Request) -> None:
    """Refuse parameters of the address that the route does not take: a misspelt one would be passed over in silence.

    Raises:
        ProblemError: there is one.
    """
    route = request.scope.get("route")
    dependant = getattr(route, "dependant", None)
    extra: frozenset[str] = getattr(getattr(route, "endpoint", None), "more_parameters", frozenset())
    known = {field.alias for field in getattr(dependant, "query_params", ())} | set(extra)
    for name in request.query_params:
        if name not in known:
            words = f"there is no parameter {name[:40]!r} here"
            words += f"; there are {', '.join(sorted(known))}" if known else ", nor any other"
            raise ProblemError("invalid-parameter", 422, words, pointer=f"/query/{name[:40]}")


class Heads:
    """Answers HEAD wherever GET is answered (RFC 9110, section 9.3.2), and takes addresses with scheme and host."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, as GET where HEAD is asked for, and its answer back without the body."""
        if scope["type"] != "http" or scope["method"] != "HEAD" or _OWN_HEAD.match(scope["path"]):
            await self._app(scope, receive, send)
            return

        async def bodiless(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self._app({**scope, "method": "GET"}, receive, bodiless)


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
