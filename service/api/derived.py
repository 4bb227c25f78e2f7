"""Making something of a finished avatar, for the routes of every derived kind (:mod:`service.jobs.kinds`).

It is a job like others: it counts in the quotas of its tenant, and a worker makes it. The same thing of the same
result is made once: who asks for it again gets it from the store, for as long as it is kept.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import secrets
import time
from typing import Any

from fastapi import Request
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from service.api.admitting import bounds_of, no_room
from service.api.context import Context
from service.api.files import finished
from service.api.keys import Tenant
from service.api.options import parse_object
from service.api.problems import ProblemError
from service.archive.version import GENERATOR
from service.errors import TooManyBytes
from service.jobs.admission import KeyInUse, NewJob, NoRoom
from service.jobs.kinds import KINDS, Kind
from service.jobs.store import Row
from service.jobs.view import FINAL, job_json

MAX_BODY = 1 << 20

_LOOK_S = 1.0


async def asked(request: Request, context: Context, kind: Kind) -> tuple[str, dict[str, Any]]:
    """The request for something: the id of the avatar, and what is wanted of it.

    Raises:
        ProblemError: it is no JSON object with the id of an avatar, or does not arrive in time.
        TooManyBytes: it is too long.
    """
    values = parse_object(await _body(request, context, kind), f"malformed-{kind.name}")
    avatar = values.pop("avatar", None)
    if not isinstance(avatar, str):
        raise ProblemError("usage", 422, "avatar has to be the id of a finished avatar", pointer="/avatar")
    return avatar, values


async def made(
    request: Request, context: Context, tenant: Tenant, kind: Kind, avatar: str, values: dict[str, Any], seconds: float
) -> Row | Response:
    """The row of the job that made something, or an answer that it is not ready.

    Args:
        request: that asks for it; with ``Prefer: respond-async`` nothing is waited for.
        context: of the application.
        tenant: who asks.
        kind: of what.
        avatar: id of the job of whose result it is made.
        values: what is wanted, checked.
        seconds: how long to wait for it.

    Raises:
        ProblemError: there is no such result, the tenant may have no more, or it failed.
    """
    if context.draining.is_set():
        raise ProblemError("draining", 503, headers={"Retry-After": "10"})
    source = await run_in_threadpool(finished, context, avatar, tenant)
    row = await run_in_threadpool(_job, context, tenant, kind, source, values)
    if "respond-async" not in request.headers.get("prefer", "").lower():
        row = await _ended(request, context, row, seconds)
    if row["state"] not in FINAL:
        place = f"/v1/{kind.place}/{row['id']}"
        return JSONResponse(job_json(row), 202, {"Location": place, "Retry-After": "2", "Cache-Control": "no-store"})
    if row["state"] == "failed":
        raise _failure(row)
    if row["state"] == "cancelled":
        raise ProblemError("no-result", 409, state="cancelled")
    return row


def waiting(what: str, schema: type[BaseModel]) -> dict[str, Any]:
    """What the description of the API says of the answer 202."""
    content = {"application/json": {"schema": {"$ref": f"#/components/schemas/{schema.__name__}"}}}
    return {"description": f"The {what} is not ready yet: its job.", "content": content}


def whole(context: Context, row: Row, media_type: str, headers: dict[str, str]) -> Response:
    """The result of a job as an answer to the request that asked for it."""
    with context.artifacts.open(row["archive"]) as stream:
        content = stream.read()
    place = f"/v1/{KINDS[row['kind']].place}/{row['id']}"
    return Response(content, 200, {**headers, "Content-Location": place, "Cache-Control": "no-store"}, media_type)


def _job(context: Context, tenant: Tenant, kind: Kind, source: Row, values: dict[str, Any]) -> Row:
    """The job of this: the one that there is, or a new one.

    Raises:
        ProblemError: there is none, and the tenant may have no more.
    """
    wanted = json.dumps([source["archive_sha256"], GENERATOR, values], sort_keys=True)
    digest = hashlib.sha256(wanted.encode()).hexdigest()
    job = NewJob(
        id=secrets.token_hex(16), tenant=tenant.name, options={"request": values}, photo="", photo_sha256="",
        photo_bytes=0, keep_photo=False, kind=kind.name, source=source["id"], digest=digest,
        key=f"\t{kind.name} {digest}",  # no header can have a tab in it, so nobody's own key is like it
    )  # fmt: skip
    try:
        return context.store.add(job, context.queue.put, bounds_of(context, tenant))
    except KeyInUse as used:
        return used.row
    except NoRoom as full:
        raise no_room(full) from full


async def _ended(request: Request, context: Context, row: Row, seconds: float) -> Row:
    """The row as soon as the job has ended, or when the caller has waited long enough or is gone."""
    deadline = time.monotonic() + seconds
    with context.watcher.listening(row["id"]) as changed:
        while row["state"] not in FINAL and time.monotonic() < deadline and not context.draining.is_set():
            changed.clear()
            found: Row | None = await run_in_threadpool(context.store.get, row["id"])
            row = found or row
            if row["state"] in FINAL or await request.is_disconnected():
                break
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(changed.wait(), _LOOK_S)
    return row


def _failure(row: Row) -> ProblemError:
    facts = json.loads(row["error"])
    code, status, detail = str(facts.pop("code")), int(facts.pop("status")), str(facts.pop("detail"))
    facts = {name: value for name, value in facts.items() if name not in ("type", "title")}
    return ProblemError(code, status, detail, **facts)


async def _body(request: Request, context: Context, kind: Kind) -> bytes:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json":
        words = f"a {kind.name} is asked for with application/json"
        raise ProblemError("unsupported-media-type", 415, words)
    data = bytearray()
    try:
        async with asyncio.timeout(context.settings.idle_seconds):
            async for chunk in request.stream():
                data += chunk
                if len(data) > MAX_BODY:
                    raise TooManyBytes(f"the request has more than {MAX_BODY} bytes", limit=MAX_BODY)
    except TimeoutError:
        raise ProblemError("request-timeout", 408, headers={"Connection": "close"}) from None
    except ClientDisconnect:
        raise ProblemError("bad-request", 400, "the connection closed before the body was complete") from None
    return bytes(data)
