"""``/v1/avatars/{id}/events``: server-sent events, numbered, with replay."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from service.api.context import Context
from service.api.needs import Asking, Here
from service.jobs.view import FINAL

HEARTBEAT = 15.0
_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}

router = APIRouter(prefix="/v1/avatars", tags=["avatars"])


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
    return StreamingResponse(_stream(context, job, last), 200, _HEADERS, "text/event-stream")


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
