"""Every answer that is not a success is an RFC 9457 problem: one exception, one place that renders it."""

from __future__ import annotations

import errno
import json
import logging
from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match
from starlette.types import Scope

from service.errors import AvatarError
from service.jobs.view import from_error, problem
from service.places import StoreFault
from service.words import WORDS

MEDIA_TYPE = "application/problem+json"

log = logging.getLogger(__name__)

IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp", "image/heic", "image/heif")
"""Media types of a photo that is the body of a request."""

EXPLANATIONS = {
    **WORDS["explanations"],
    "unsupported-media-type": f"Photos are multipart/form-data or {', '.join(IMAGE_TYPES)}; the rest is JSON.",
}
"""What each code of this interface means, for ``/problems/{code}``."""

_FAULTS = (AvatarError, OSError, sa.exc.SQLAlchemyError)
_STATUS_CODES = {404: "not-found", 405: "method-not-allowed", 400: "bad-request"}


class HttpProblem(Exception):
    """Ends a request with a problem: ``code`` is stable, ``detail`` for people, ``extra`` members for machines."""

    def __init__(
        self, code: str, status: int, detail: str = "", headers: Mapping[str, str] | None = None, **extra: Any
    ) -> None:
        super().__init__(code)
        self.headers = dict(headers or {})
        self.status = status
        self.body = problem(code, status, detail or EXPLANATIONS[code], **extra)


def response(body: Mapping[str, Any], headers: Mapping[str, str] | None = None, instance: str = "") -> Response:
    """A problem object as an answer."""
    content = {**body, "instance": instance} if instance else body
    status = int(body["status"])
    return Response(json.dumps(content), status, {**(headers or {}), "Cache-Control": "no-store"}, MEDIA_TYPE)


def not_found() -> HttpProblem:
    """The one answer for what is not there and for what belongs to somebody else."""
    return HttpProblem("not-found", 404)


def install(app: FastAPI) -> None:
    """Let every exception of ``app`` leave as a problem."""
    for kind in (HttpProblem, HTTPException, RequestValidationError, *_FAULTS, Exception):
        app.add_exception_handler(kind, _answer)


def allowed_methods(scope: Scope) -> list[str]:
    """Methods that an address takes, over all routes: the framework lists those of the first route that fits."""
    routes: list[Any] = scope["app"].router.routes
    asked = ({**scope, "method": method} for method in ("GET", "POST", "DELETE"))
    taken = [one["method"] for one in asked if any(route.matches(one)[0] == Match.FULL for route in routes)]
    return [name for method in taken for name in ((method, "HEAD") if method == "GET" else (method,))]


def _answer(request: Request, error: Exception) -> Response:
    body, headers = _problem_of(request, error)
    if body["status"] >= 500 and isinstance(error, _FAULTS):  # what else is a fault is logged by the server
        log.error("a request failed", exc_info=error)
    return response(body, headers, request.url.path)


def _problem_of(request: Request, error: Exception) -> tuple[dict[str, Any], dict[str, str]]:
    """The problem that an exception leaves as, and further headers of the answer."""
    if isinstance(error, HttpProblem):
        return error.body, error.headers
    if isinstance(error, HTTPException):
        code = _STATUS_CODES.get(error.status_code, "bad-request" if error.status_code < 500 else "internal")
        headers = dict(error.headers or {})
        if error.status_code == 405:
            headers["Allow"] = ", ".join(allowed_methods(request.scope))
        return problem(code, error.status_code, EXPLANATIONS.get(code, "The request could not be answered.")), headers
    if isinstance(error, RequestValidationError):
        first = error.errors()[0]
        place = "/".join(str(part) for part in first["loc"])
        return problem("invalid-parameter", 422, f"{place}: {first['msg']}", pointer=f"/{place}"), {}
    if isinstance(error, StoreFault | sa.exc.SQLAlchemyError):
        return problem("unavailable", 503, EXPLANATIONS["unavailable"]), {"Retry-After": "5"}
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        # In the middle of an upload, whatever the reserve said at its beginning.
        return problem("no-space", 507, EXPLANATIONS["no-space"]), {"Retry-After": "120"}
    # After an unexpected exception the connection is closed; a client that is not told so sends its next request into
    # the void.
    return from_error(error), {} if isinstance(error, _FAULTS) else {"Connection": "close"}
