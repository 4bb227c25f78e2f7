"""``/v1/avatars``: post a photo, look at the job or follow it, list, cancel or erase.

A photo is refused at the door, looked through, on the disk, and only then a job.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import sqlalchemy as sa
from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from service.api.context import JOB_ID, LOOK_S, Asking, Context, Here, Json
from service.api.decoding import FIXED, cost
from service.api.front import host_name, is_head
from service.api.keys import ANYBODY, LOOPBACK, Tenant
from service.api.openapi import Job, JobPage, State
from service.api.problem_responses import HttpProblem
from service.api.uploads import QUERY, Upload, received
from service.errors import UnreadableInput
from service.face.several import of_photo
from service.jobs.admission import Bounds, KeyInUse, NewJob, NoRoom, count_refusal
from service.jobs.artifacts import artifact_name, kept_folder
from service.jobs.database import now
from service.jobs.store import Row, checkpoint, let_go
from service.jobs.view import FINAL, job_json
from service.jobs.webhooks import expect_reachable, target
from service.photo.bundle import unbundled
from service.photo.gate import check_photo, expect_photo
from service.photo.video import expect_video

log = logging.getLogger(__name__)

T = TypeVar("T")


def bounds_of(context: Context, tenant: Tenant) -> Bounds:
    """How much of a tenant is let in."""
    most = tenant.max_unfinished or context.settings.max_unfinished
    return Bounds(queued=context.settings.max_queued, unfinished=most, per_day=tenant.per_day)


def no_room(full: NoRoom) -> HttpProblem:
    """The problem of a job that was not let in."""
    pause = "30" if full.kind == "queue-full" else "3600" if "per_day" in full.facts else "10"
    facts: dict[str, Any] = dict(full.facts)
    return HttpProblem(full.kind, 429, headers={"Retry-After": pause}, **facts)


def erase(context: Context, job: str, tenant: Tenant, kind: str) -> None:
    """Cancel a tenant's job that is unfinished, erase one that has ended; with the pictures made from it.

    HttpProblem: there is no such job, or it belongs to somebody else.
    """
    row = context.job(job, tenant, kind, gone=True)
    expires = now() + context.settings.result_hours * 3600
    stages = [kept_folder(row["tenant"], row["photo_sha256"])] if row["keep_photo"] and row["photo_sha256"] else []
    for one in [*let_go(context.store, row, "erased", expires), *stages]:
        sweep(context, one)
    checkpoint(context.engine)


def sweep(context: Context, job: str) -> None:
    """Remove the files of a job as far as the store lets; a worker erases the rest, also of one that still writes."""
    with contextlib.suppress(OSError):
        context.artifacts.sweep(job, set())


_MAX_KEY = 255


async def accept(context: Context, tenant: Tenant, key: str | None, upload: Upload) -> Row:
    """The job of a photo that has arrived: a new one, or the one that its ``key`` (:func:`sent_key`) belongs to.

    HttpProblem, AvatarError: the photo cannot be used, a value is not possible, or the tenant may have no more.
    """
    options = upload.options.to_json()
    private = context.settings.webhook_private
    told = target(upload.webhook_url, context.settings.webhook_hosts, private=private) if upload.webhook_url else None
    digest = _digest(upload, options)
    if key is not None:
        known = await run_in_threadpool(context.store.by_key, tenant.name, key)
        if known is not None:
            return _same(known, digest)
    if told is not None:
        await expect_reachable(told, private=private)
    try:
        share = await run_in_threadpool(_of_each, upload, lambda photo: cost(photo, context.limits))
        async with context.decoding.taken(max(share, default=FIXED), tenant.name):
            await run_in_threadpool(_of_each, upload, lambda photo: check_photo(photo, context.limits))
            await run_in_threadpool(expect_photo)
    except UnreadableInput:
        if tenant.per_day is not None:
            await run_in_threadpool(count_refusal, context.engine, tenant.name)
        raise
    job = secrets.token_hex(16)
    new = NewJob(
        id=job, tenant=tenant.name, options=options, photo=artifact_name(job, "photo", upload.sha256, "bin"),
        photo_sha256=upload.sha256, photo_bytes=upload.size, keep_photo=upload.keep_photo, key=key, digest=digest,
        priority=upload.priority, metadata=upload.metadata, webhook=upload.webhook_url or None,
    )  # fmt: skip
    return await run_in_threadpool(_store, context, new, upload.path, bounds_of(context, tenant))


def _of_each(upload: Upload, work: Callable[[bytes], T]) -> list[T]:
    """What comes of each photo of an upload, one after the other; a video is looked at by the job.

    What one of several is refused for (UnreadableInput) has its number, from 0, in ``extra["photo"]``.
    """
    photos, results = unbundled(upload.path.read_bytes()), []
    for number, photo in enumerate(photos):
        if number == upload.video:
            expect_video(photo, "the part 'video'")
            continue
        try:
            results.append(work(photo))
        except UnreadableInput as error:
            raise of_photo(error, number, len(photos)) from error
    return results


def _store(context: Context, new: NewJob, path: Path, bounds: Bounds) -> Row:
    """First the photo on the disk, then the job and its place in the queue in one transaction."""
    context.artifacts.put(path, new.photo)
    try:
        return context.store.add(new, bounds)
    except KeyInUse as used:
        sweep(context, new.id)
        return _same(used.row, new.digest)
    except NoRoom as full:
        sweep(context, new.id)
        raise no_room(full) from full
    except BaseException:
        sweep(context, new.id)
        raise


def admit(context: Context, tenant: Tenant, key: str | None) -> None:
    """Refuse at the door what could not be done: HttpProblem where the server is shutting down, it or its disk is full,
    or the tenant's quota is used up.
    """
    if context.draining.is_set():
        raise HttpProblem("draining", 503, headers={"Retry-After": "10"})
    if context.free_mb() < context.settings.reserve_mb:
        raise HttpProblem("no-space", 507, headers={"Retry-After": "120"})
    if key is not None and context.store.by_key(tenant.name, key) is not None:
        return  # it was let in before
    try:
        context.store.room(tenant.name, bounds_of(context, tenant))
    except NoRoom as full:
        raise no_room(full) from full


@contextlib.contextmanager
def upload_place(context: Context, tenant: Tenant) -> Iterator[None]:
    """One of the uploads that are received at the same time; HttpProblem where there are as many as there may be.

    Where there are keys, a tenant gets at most half of the places that the others leave, so that there is always one
    for somebody else.
    """
    own, left = context.uploads[tenant.name], context.settings.uploads - context.uploads.total()
    if left < 1 or (context.keys and own >= left):
        raise HttpProblem("busy", 503, headers={"Retry-After": "2"})
    context.uploads[tenant.name] += 1
    try:
        yield
    finally:
        context.uploads[tenant.name] -= 1


def _same(row: Row, digest: str) -> Row:
    if row["digest"] != digest:
        raise HttpProblem("key-reuse", 422)
    if row["gone"] is not None:
        raise HttpProblem("gone", 410, reason=row["gone"])
    return row


def _digest(upload: Upload, options: dict[str, Any]) -> str:
    content: list[Any] = [upload.sha256, upload.keep_photo, options]
    if upload.metadata:
        content.append(upload.metadata)
    if upload.webhook_url or upload.priority != "normal":
        content.append([upload.priority, upload.webhook_url])
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def sent_key(request: Request) -> str | None:
    """The header of that name, None without one; HttpProblem where it is none that can be kept."""
    key = request.headers.get("idempotency-key")
    if key is None:
        return None
    if not 1 <= len(key) <= _MAX_KEY or not key.isascii() or not key.isprintable():
        raise HttpProblem("invalid-parameter", 400, f"Idempotency-Key has to be 1 to {_MAX_KEY} printable characters")
    return key


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
    context.listeners += 1
    heard = time.monotonic()
    try:
        while not context.draining.is_set() and allowed():
            try:
                row, events = await run_in_threadpool(_news, context, job, last)
            except sa.exc.SQLAlchemyError as error:
                log.warning("events cannot be read: %s", error)
                await asyncio.sleep(LOOK_S)
                continue
            for event in events:
                last, heard = event["n"], time.monotonic()
                yield f"id: {last}\nevent: {event['name']}\ndata: {event['body']}\n\n".encode()
            if row is None or row["gone"] is not None or (row["state"] in FINAL and last >= row["events"]):
                return
            if row["events"] > last:
                continue
            if time.monotonic() - heard > HEARTBEAT:
                heard = time.monotonic()
                yield b": still here\n\n"
            await asyncio.sleep(LOOK_S)
    finally:
        context.listeners -= 1


def _news(context: Context, job: str, last: int) -> tuple[Row | None, list[Row]]:
    """The row of a job, and its events after the last that arrived."""
    row = context.store.get(job)
    return row, context.store.events(job, last) if row is not None and row["events"] > last else []
