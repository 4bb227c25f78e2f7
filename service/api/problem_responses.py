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

MEDIA_TYPE = "application/problem+json"

log = logging.getLogger(__name__)

IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp", "image/heic", "image/heif")
"""Media types of a photo that is the body of a request."""

_OBJECT = "It has to be a JSON object of finite numbers and Unicode text, without deep nesting; 'detail' says more."

EXPLANATIONS = {
    "missing-file": "Send the photo as the part 'image' of a multipart/form-data body, or as the body itself.",
    "malformed-multipart": "The body is not the multipart/form-data that its Content-Type announces.",
    "too-many-parts": "Parts 'image', and one each of the others at most: options, keep_photo, metadata and so on.",
    "part-too-large": "Parts other than the photo are limited to 16 KiB.",
    "too-many-files": "One request makes one avatar of at most 24 photos, each a part 'image'.",
    "unknown-field": "There is no such part or option. Photos are never fetched from an address.",
    "malformed-options": _OBJECT,
    "malformed-metadata": _OBJECT,
    "usage": "An option is out of its range; 'pointer' names it.",
    "malformed-render": _OBJECT,
    "render-timeout": "The picture took too long; a smaller one, or one with fewer samples, takes less.",
    "malformed-export": _OBJECT,
    "export-timeout": "The kit took too long; an avatar with smaller maps takes less.",
    "unsupported-media-type": f"Photos are multipart/form-data or {', '.join(IMAGE_TYPES)}; the rest is JSON.",
    "not-found": "There is nothing at this address, or it is not yours.",
    "method-not-allowed": "This address does not take this method; 'Allow' names those that it takes.",
    "bad-request": "The request breaks the rules of HTTP.",
    "invalid-parameter": "A parameter of the address or a header is not what it has to be.",
    "bad-host": "The Host header is none of the names of this server.",
    "cross-origin": "A web page of another origin made this request; only pages of this server may change anything.",
    "unauthorized": "Send a key: 'Authorization: Bearer KEY'.",
    "listing-needs-key": "A server without keys lists jobs to its own machine only.",
    "not-ready": "The result is there when the job has succeeded.",
    "no-result": "The job has ended without a result.",
    "gone": "The result has expired or was erased.",
    "key-reuse": "An Idempotency-Key belongs to one request; another photo or other options need another key.",
    "range-not-satisfiable": "One range within the file can be asked for.",
    "queue-full": "Too many jobs are waiting; try again later.",
    "quota": "Your key allows no more jobs now.",
    "needs-memory": "Decoding this photo takes more memory than this server has for it.",
    "busy": "Too many uploads are being received; try again shortly.",
    "draining": "The server is shutting down; try again shortly.",
    "starting": "The server is starting; try again shortly.",
    "no-space": "The server has no space for uploads.",
    "unavailable": "The database, or the store of photos and results, does not answer now; try again shortly.",
    "request-timeout": "The request did not arrive in time.",
}
"""What each code of this interface means, for ``/problems/{code}``."""

_FAULTS = (AvatarError, OSError, sa.exc.SQLAlchemyError)
_STATUS_CODES = {404: "not-found", 405: "method-not-allowed", 400: "bad-request"}


class HttpProblem(Exception):
    """Ends a request with a problem.

    Args:
        code: stable name of the kind of problem.
        status: HTTP status.
        detail: what is wrong with this request, for people.
        headers: of the answer.
        extra: members for machines.
    """

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
