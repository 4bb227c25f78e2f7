"""Taking a photo in: refused at the door, looked through, on the disk, and only then a job; and letting jobs go."""

from __future__ import annotations

import contextlib
import hashlib
import json
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from fastapi import Request
from starlette.concurrency import run_in_threadpool

from service.api.context import Context
from service.api.decoding import FIXED, cost
from service.api.keys import Tenant
from service.api.problem_responses import HttpProblem
from service.api.uploads import Upload
from service.errors import UnreadableInput
from service.face.several import of_photo
from service.jobs.admission import Bounds, KeyInUse, NewJob, NoRoom, count_refusal
from service.jobs.artifacts import artifact_name, kept_folder
from service.jobs.database import now
from service.jobs.store import Row, checkpoint, let_go
from service.jobs.webhooks import expect_reachable, target
from service.photo.bundle import unbundled
from service.photo.gate import check_photo, expect_photo
from service.photo.video import expect_video

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
