"""``/v1/avatars``: post a photo, look at the job or follow it, list, cancel or erase."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.accepting import accept, admit, erase, idempotency_key, slot
from service.api.context import Asking, Context, Here
from service.api.front import host_name
from service.api.keys import ANYBODY, LOOPBACK
from service.api.openapi import Job, JobPage, State
from service.api.problem_responses import ProblemError
from service.api.uploads import QUERY, received
from service.jobs.store import Row
from service.jobs.telemetry import traceparent
from service.jobs.view import FINAL, job_json

FORWARDED = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")

router = APIRouter(prefix="/v1/avatars", tags=["avatars"])


@router.post(
    "", status_code=202, operation_id="create_avatar", response_model=Job, summary="Make an avatar of a photo."
)
async def post(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes multipart/form-data with the photo as ``image``, or the photo itself as the body.

    With the photo as the body the other parts are parameters of the address, each option by its name and as on the
    command line: ``?quality=draft&size=576x384``.

    The answer comes as soon as the photo is stored and the job is in the queue. With an ``Idempotency-Key`` the same
    request can be sent again and makes one job only.

    400: more than eight parts (`too-many-parts`), more than one file (`one-file-only`), a part other than the photo of
    more than 16 KiB (`part-too-large`), or a form that is none. 422: a part, an option or a value that there is not, or
    a photo that cannot be used. 413: more bytes than a photo may have. 415: no photo, by its first bytes.
    """
    key = idempotency_key(request)
    await run_in_threadpool(admit, context, tenant, key)
    async with slot(context), received(request, context.settings, context.limits.max_bytes) as upload:
        row = await accept(context, tenant, key, upload, traceparent(request.headers))
    body = job_json(row)
    return JSONResponse(body, 202, {"Location": body["links"]["self"], "Retry-After": "1", "Cache-Control": "no-store"})


post.more_parameters = QUERY  # type: ignore[attr-defined]  # of a photo that is the body


@router.get("", response_model=JobPage, operation_id="list_avatars", summary="List the jobs of this key, newest first.")
def listing(
    request: Request,
    tenant: Asking,
    context: Here,
    limit: Annotated[int, Query(ge=1, le=100)] = 50,
    cursor: Annotated[str | None, Query(max_length=100)] = None,
    state: Annotated[State | None, Query()] = None,
) -> Response:
    """One page; ``next`` of the answer is the ``cursor`` of the next one."""
    if tenant.name == ANYBODY and not _of_this_machine(request, context.settings.host):
        raise ProblemError("listing-needs-key", 403)
    rows = context.store.page(tenant.name, limit + 1, _place(cursor), state)
    following = _cursor(rows[limit - 1]) if len(rows) > limit else None
    headers = {"Cache-Control": "no-store"}
    if following is not None:
        more = f"&state={state}" if state else ""
        headers["Link"] = f'</v1/avatars?limit={limit}&cursor={following}{more}>; rel="next"'
    return JSONResponse({"items": [job_json(row) for row in rows[:limit]], "next": following}, 200, headers)


@router.get("/{job}", response_model=Job, operation_id="get_avatar", summary="State of a job.")
def state(job: str, tenant: Asking, context: Here) -> Response:
    """The same JSON as in events."""
    row = context.job(job, tenant)
    headers = {"Cache-Control": "no-store"}
    if row["state"] not in FINAL:
        headers["Retry-After"] = "1"
    return JSONResponse(job_json(row), 200, headers)


@router.delete("/{job}", status_code=204, operation_id="delete_avatar", summary="Cancel a job, or erase its result.")
def delete(job: str, tenant: Asking, context: Here) -> Response:
    """A job that is unfinished is cancelled and its photo erased; of one that has ended everything is erased."""
    erase(context, job, tenant, "avatar")
    return Response(status_code=204)


def _of_this_machine(request: Request, listening: str) -> bool:
    """Whether a request was made here, and did not come through a proxy that stands here."""
    name = host_name(request.headers.get("host", ""))
    forwarded = any(header in request.headers for header in FORWARDED)
    return listening in LOOPBACK and name.strip("[]") in LOOPBACK and not forwarded


def _cursor(row: Row) -> str:
    return base64.urlsafe_b64encode(json.dumps([row["created_at"], row["id"]]).encode()).decode().rstrip("=")


def _place(cursor: str | None) -> tuple[float, str] | None:
    if cursor is None:
        return None
    try:
        moment, job = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        if not isinstance(moment, float) or not isinstance(job, str):
            raise ValueError
    except (ValueError, TypeError) as error:
        raise ProblemError(
            "invalid-parameter", 422, "cursor is none of this server's", pointer="/query/cursor"
        ) from error
    return moment, job


HEARTBEAT = 15.0
_EVENT_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}

events_router = APIRouter(prefix="/v1/avatars", tags=["avatars"])


@events_router.get(
    "/{job}/events",
    operation_id="follow_avatar",
    response_class=StreamingResponse,
    summary="Follow a job.",
    responses={
        200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}},
        204: {"description": "No more."},
    },
)
async def events(job: str, request: Request, tenant: Asking, context: Here) -> Response:
    """Events ``progress`` and ``state``, each with the JSON of the job, from the first one or after ``Last-Event-ID``.

    The stream ends after the event with a final state; whoever asks again after that one gets 204.
    """
    row = await run_in_threadpool(context.job, job, tenant)
    text = request.headers.get("last-event-id", "").strip()
    last = int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0
    if row["state"] in FINAL and last >= row["events"]:
        return Response(status_code=204)
    return StreamingResponse(_stream(context, job, last), 200, _EVENT_HEADERS, "text/event-stream")


async def _stream(context: Context, job: str, last: int) -> AsyncIterator[bytes]:
    yield b"retry: 2000\n\n"
    with context.watcher.listening(job) as changed:
        while not context.draining.is_set():
            changed.clear()
            for event in await run_in_threadpool(context.store.events, job, last):
                last = event["n"]
                yield f"id: {last}\nevent: {event['name']}\ndata: {event['body']}\n\n".encode()
            row = await run_in_threadpool(context.store.get, job)
            if row is None or row["gone"] is not None or (row["state"] in FINAL and last >= row["events"]):
                return
            if row["events"] > last:
                continue
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(changed.wait(), HEARTBEAT)
                continue
            yield b": still here\n\n"


_ADDRESS = re.compile(r"/v1/avatars/([0-9a-f]{32})\Z")


@dataclass(frozen=True)
class _Route:
    """What the log and the numbers call these requests."""

    path: str


_ROUTE = _Route("/v1/avatars/{job}")


class QuickState:
    """The layer that answers such requests, around the application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        plain = scope["type"] == "http" and scope["method"] == "GET" and not scope["query_string"]
        match = _ADDRESS.match(scope["path"]) if plain else None
        found = _look(scope, match[1]) if match is not None else None
        if found is None:
            await self._app(scope, receive, send)
            return
        body, final = found
        headers = [
            (b"content-type", b"application/json"),
            (b"content-length", str(len(body)).encode()),
            (b"cache-control", b"no-store"),
        ]
        if not final:
            headers.append((b"retry-after", b"1"))
        scope["route"] = _ROUTE
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def _look(scope: Scope, job: str) -> tuple[bytes, bool] | None:
    context: Context = scope["app"].state.context
    tenant = context.keys.tenant(Headers(scope=scope))
    return None if tenant is None else context.glance.state(job, tenant.name)
