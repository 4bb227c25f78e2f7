"""``/v1/avatars``: post a photo, look at the job, list, cancel or erase."""

from __future__ import annotations

import base64
import hashlib
import json
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from service.api.admitting import bounds_of, erase, no_room, sweep
from service.api.context import Context
from service.api.decoding import cost
from service.api.keys import ANYBODY, LOOPBACK, Tenant
from service.api.middleware import host_name
from service.api.needs import Asking, Here
from service.api.options import parse_metadata
from service.api.problems import ProblemError
from service.api.schemas import Job, JobPage, State
from service.api.uploads import QUERY, Upload, received
from service.jobs.admission import Bounds, NoRoom
from service.jobs.artifacts import artifact_name
from service.jobs.store import KeyInUse, NewJob, Row
from service.jobs.traces import traceparent
from service.jobs.view import FINAL, job_json
from service.jobs.webhooks.address import target
from service.photo.gate import check_photo

FORWARDED = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")
_MAX_KEY = 255

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
    key = _idempotency_key(request)
    await run_in_threadpool(_admit, context, tenant, key)
    async with _slot(context), received(request, context.settings, context.limits.max_bytes) as upload:
        row = await _accept(context, tenant, key, upload, traceparent(request.headers))
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


async def _accept(context: Context, tenant: Tenant, key: str | None, upload: Upload, trace: str | None) -> Row:
    options = upload.chosen().to_json()
    metadata = parse_metadata(upload.metadata)
    if upload.webhook_url:
        target(upload.webhook_url, context.settings.webhook_hosts, private=context.settings.webhook_private)
    digest = _digest(upload, options, metadata)
    if key is not None:
        known = await run_in_threadpool(context.store.by_key, tenant.name, key)
        if known is not None:
            return _same(known, digest)
    share = await run_in_threadpool(_cost, context, upload.path)
    async with context.decoding.taken(share):
        await run_in_threadpool(_look_through, context, upload.path)
    job = secrets.token_hex(16)
    new = NewJob(
        id=job, tenant=tenant.name, options=options, photo=artifact_name(job, "photo", upload.sha256, "bin"),
        photo_sha256=upload.sha256, photo_bytes=upload.size, keep_photo=upload.keep_photo, key=key, digest=digest,
        priority=upload.priority, metadata=metadata, trace=trace,
        webhook=upload.webhook_url or None,
    )  # fmt: skip
    return await run_in_threadpool(_store, context, new, upload.path, bounds_of(context, tenant))


def _store(context: Context, new: NewJob, path: Path, bounds: Bounds) -> Row:
    """First the photo on the disk, then the job and its place in the queue in one transaction."""
    context.artifacts.put(path, new.photo)
    try:
        return context.store.add(new, context.queue.put, bounds, context.queue.move)
    except KeyInUse as used:
        sweep(context, new.id)
        return _same(used.row, new.digest)
    except NoRoom as full:
        sweep(context, new.id)
        raise no_room(full) from full
    except BaseException:
        sweep(context, new.id)
        raise


def _cost(context: Context, path: Path) -> int:
    return cost(path.read_bytes(), context.limits)


def _look_through(context: Context, path: Path) -> None:
    check_photo(path.read_bytes(), context.limits)


def _admit(context: Context, tenant: Tenant, key: str | None) -> None:
    """Refuse at the door what could not be done.

    Raises:
        ProblemError: the server is shutting down or full, or the tenant's quota is used up.
    """
    if context.draining.is_set():
        raise ProblemError("draining", 503, headers={"Retry-After": "10"})
    context.check_space()
    if key is not None and context.store.by_key(tenant.name, key) is not None:
        return  # it was let in before
    try:
        context.store.room(tenant.name, bounds_of(context, tenant))
    except NoRoom as full:
        raise no_room(full) from full


@asynccontextmanager
async def _slot(context: Context) -> AsyncIterator[None]:
    if context.uploads >= context.settings.uploads:
        raise ProblemError("busy", 503, headers={"Retry-After": "2"})
    context.uploads += 1
    try:
        yield
    finally:
        context.uploads -= 1


def _same(row: Row, digest: str) -> Row:
    if row["digest"] != digest:
        raise ProblemError("key-reuse", 422)
    if row["gone"] is not None:
        raise ProblemError("gone", 410, reason=row["gone"])
    return row


def _digest(upload: Upload, options: dict[str, Any], metadata: dict[str, Any]) -> str:
    content = [upload.sha256, upload.keep_photo, options]
    if metadata:
        content.append(metadata)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _idempotency_key(request: Request) -> str | None:
    key = request.headers.get("idempotency-key")
    if key is None:
        return None
    if not 1 <= len(key) <= _MAX_KEY or not key.isascii() or not key.isprintable():
        raise ProblemError("invalid-parameter", 400, f"Idempotency-Key has to be 1 to {_MAX_KEY} printable characters")
    return key


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
