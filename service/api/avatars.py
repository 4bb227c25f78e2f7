"""``/v1/avatars``: post a photo, look at the job or follow it, list, cancel or erase."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from service.api.accepting import accept, admit, erase, sent_key, upload_place
from service.api.context import JOB_ID, Asking, Context, Here, Json
from service.api.front import host_name, is_head
from service.api.keys import ANYBODY, LOOPBACK, Tenant
from service.api.openapi import Job, JobPage, State
from service.api.problem_responses import HttpProblem
from service.api.uploads import QUERY, received
from service.jobs.store import Row
from service.jobs.view import FINAL, job_json

FORWARDED = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")

router = APIRouter(prefix="/v1/avatars", tags=["avatars"])


@router.post(
    "", status_code=202, operation_id="create_avatar", response_model=Job, summary="Make an avatar of a photo."
)
async def post(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes multipart/form-data with the photo as ``image``, several parts of that name for several photos of one
    person, or the photo itself as the body.

    With the photo as the body the other parts are parameters of the address, each option by its name and as on the
    command line: ``?quality=draft&size=576x384``.

    The answer comes as soon as the photo is stored and the job is in the queue. With an ``Idempotency-Key`` the same
    request can be sent again and makes one job only.

    400: more than eight parts (`too-many-parts`), more than 24 files (`too-many-files`), a part other than a photo of
    more than 16 KiB (`part-too-large`), or a form that is none. 422: a part, an option or a value that there is not, or
    a photo that cannot be used. 413: more bytes than a photo, or all together, may have. 415: no photo, by its first
    bytes.
    """
    key = sent_key(request)
    await run_in_threadpool(admit, context, tenant, key)
    with upload_place(context, tenant):
        async with received(request, context.settings, context.limits.max_bytes) as upload:
            row = await accept(context, tenant, key, upload)
    body = job_json(row)
    return Json(body, 202, {"Location": body["links"]["self"], "Retry-After": "1"})


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
        raise HttpProblem("listing-needs-key", 403)
    rows = context.store.page(tenant.name, limit + 1, _last(context, tenant, cursor), state)
    following = rows[limit - 1]["id"] if len(rows) > limit else None
    more = f"&state={state}" if state else ""
    link = {"Link": f'</v1/avatars?limit={limit}&cursor={following}{more}>; rel="next"'} if following else {}
    return Json({"items": [job_json(row) for row in rows[:limit]], "next": following}, 200, link)


@router.get("/{job}", response_model=Job, operation_id="get_avatar", summary="State of a job.")
def state(job: str, tenant: Asking, context: Here) -> Response:
    """State of a job, the same JSON as in its events."""
    row = context.job(job, tenant)
    return Json(job_json(row), 200, {} if row["state"] in FINAL else {"Retry-After": "1"})


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


def _last(context: Context, tenant: Tenant, cursor: str | None) -> Row | None:
    """The last job of the page before, whose id the cursor is; its row outlives its result by days."""
    if cursor is None:
        return None
    row = context.store.get(cursor) if JOB_ID.match(cursor) else None
    if row is None or row["tenant"] != tenant.name:
        raise HttpProblem("invalid-parameter", 422, "cursor is none of this server's", pointer="/query/cursor")
    return row


HEARTBEAT = 15.0
"""Seconds of silence after which an event stream says that it is still there."""

_EVENT_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


@router.get(
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
    if is_head(request):
        return Response(None, 200, _EVENT_HEADERS, "text/event-stream")
    stream = _stream(context, job, last, lambda: context.keys.tenant(request.headers) == tenant)
    return StreamingResponse(stream, 200, _EVENT_HEADERS, "text/event-stream")


async def _stream(context: Context, job: str, last: int, allowed: Callable[[], bool]) -> AsyncIterator[bytes]:
    yield b"retry: 2000\n\n"
    with context.watcher.listening(job) as changed:
        while not context.draining.is_set() and allowed():
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
