"""``/v1/renders``: a finished avatar under the light of a scene. A picture is a job like others, made by a worker.

It counts in the quotas of its tenant. The same picture of the same result is made once: who asks for it again gets it
from the store, for as long as it is kept.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import secrets
import time
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from service.api.admitting import bounds_of, erase, no_room
from service.api.context import Context
from service.api.files import Extent, answer_with, finished
from service.api.keys import Tenant
from service.api.needs import Asking, Here
from service.api.options import parse_object
from service.api.problems import ProblemError
from service.api.schemas import RenderJob
from service.archive.version import GENERATOR
from service.errors import TooManyBytes
from service.jobs.admission import NoRoom
from service.jobs.store import KeyInUse, NewJob, Row
from service.jobs.view import FINAL, job_json
from service.render.wire import parse

MAX_BODY = 1 << 20
FACTS = "Render-Facts"
"""Header of the answer: JSON with exposure, effects, what leaving out the others costs at most, and fallbacks."""

_LOOK_S = 1.0
_SHOWN = ("exposure", "effects", "left_out_costs_at_most", "fallbacks")

router = APIRouter(prefix="/v1/renders", tags=["renders"])

_CONTENT = {"image/png": {"schema": {"type": "string", "format": "binary"}}}
_FACTS_HEADER = {FACTS: {"schema": {"type": "string"}, "description": "JSON: what was computed and left out."}}
_PNG: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture.", "content": _CONTENT, "headers": _FACTS_HEADER},
    202: {
        "description": "The picture is not ready yet: its job.",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/RenderJob"}}},
    },
}


@router.post(
    "", response_class=Response, operation_id="render_avatar", responses=_PNG,
    summary="Render a finished avatar under a scene.",
)  # fmt: skip
async def post(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes a JSON object: ``avatar``, the id of a job that has succeeded; ``scene``, see docs/render.md; ``size``,
    ``view``, ``background``, ``samples``, ``tolerance``. Answers with the picture as soon as it is made; with 202 and
    its job where that takes too long, or at once with ``Prefer: respond-async``.
    """
    values = parse_object(await _body(request, context), "malformed-render")
    avatar = values.pop("avatar", None)
    if not isinstance(avatar, str):
        raise ProblemError("usage", 422, "avatar has to be the id of a finished avatar", pointer="/avatar")
    parse(values)
    if context.draining.is_set():
        raise ProblemError("draining", 503, headers={"Retry-After": "10"})
    source = await run_in_threadpool(finished, context, avatar, tenant)
    row = await run_in_threadpool(_job, context, tenant, source, values)
    if "respond-async" not in request.headers.get("prefer", "").lower():
        row = await _ended(request, context, row)
    if row["state"] not in FINAL:
        headers = {"Location": f"/v1/renders/{row['id']}", "Retry-After": "2", "Cache-Control": "no-store"}
        return JSONResponse(job_json(row), 202, headers)
    return await run_in_threadpool(_picture, context, row)


@router.get("/{render}", response_model=RenderJob, operation_id="get_render", summary="State of a picture's job.")
def state(render: str, tenant: Asking, context: Here) -> Response:
    """Whether the picture is there, and where."""
    row = context.job(render, tenant, "render")
    return JSONResponse(job_json(row), 200, {"Cache-Control": "no-store"})


@router.head("/{render}/picture.png", include_in_schema=False)
@router.get(
    "/{render}/picture.png", response_class=Response, operation_id="download_render",
    responses={
        200: _PNG[200],
        206: {"description": "A range of it.", "content": _CONTENT},
        304: {"description": "As it was."},
    },
    summary="The picture.",
)  # fmt: skip
async def picture(render: str, request: Request, tenant: Asking, context: Here) -> Response:
    """With ranges and ``ETag``, as an archive."""
    row = await run_in_threadpool(finished, context, render, tenant, "render")
    whole = Extent(row["archive"], 0, row["archive_bytes"], f'"{row["archive_sha256"]}"', "picture.png")
    return answer_with(request, context, whole, {FACTS: _facts(row)})


@router.delete("/{render}", status_code=204, operation_id="delete_render", summary="Cancel or erase a picture.")
def delete(render: str, tenant: Asking, context: Here) -> Response:
    """As for an avatar."""
    erase(context, render, tenant, "render")
    return Response(status_code=204)


def _job(context: Context, tenant: Tenant, source: Row, values: dict[str, Any]) -> Row:
    """The job of this picture: the one that there is, or a new one.

    Raises:
        ProblemError: there is none, and the tenant may have no more.
    """
    wanted = json.dumps([source["archive_sha256"], GENERATOR, values], sort_keys=True)
    digest = hashlib.sha256(wanted.encode()).hexdigest()
    job = NewJob(
        id=secrets.token_hex(16), tenant=tenant.name, options={"request": values}, photo="", photo_sha256="",
        photo_bytes=0, keep_photo=False, kind="render", source=source["id"], digest=digest,
        key=f"\trender {digest}",  # no header can have a tab in it, so nobody's own key is like it
    )  # fmt: skip
    try:
        return context.store.add(job, context.queue.put, bounds_of(context, tenant))
    except KeyInUse as used:
        return used.row
    except NoRoom as full:
        raise no_room(full) from full


async def _ended(request: Request, context: Context, row: Row) -> Row:
    """The row as soon as the job has ended, or when the caller has waited long enough or is gone."""
    deadline = time.monotonic() + context.settings.render_wait_seconds
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


def _picture(context: Context, row: Row) -> Response:
    if row["state"] == "failed":
        facts = json.loads(row["error"])
        code, status, detail = str(facts.pop("code")), int(facts.pop("status")), str(facts.pop("detail"))
        facts = {name: value for name, value in facts.items() if name not in ("type", "title")}
        raise ProblemError(code, status, detail, **facts)
    if row["state"] == "cancelled":
        raise ProblemError("no-result", 409, state="cancelled")
    with context.artifacts.open(row["archive"]) as stream:
        png = stream.read()
    place = f"/v1/renders/{row['id']}"
    return Response(png, 200, {FACTS: _facts(row), "Content-Location": place, "Cache-Control": "no-store"}, "image/png")


def _facts(row: Row) -> str:
    facts = json.loads(row["metadata"])
    return json.dumps({name: facts.get(name) for name in _SHOWN})


async def _body(request: Request, context: Context) -> bytes:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise ProblemError("unsupported-media-type", 415, "a render is asked for with application/json")
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
