"""``/v1/renders`` and ``/v1/exports``: a picture or a kit of a finished avatar (:mod:`service.jobs.view`).

Each is a job like others: it counts in the quotas of its tenant, and a worker makes it. The same thing of the same
result is made once: who asks for it again gets it from the store, for as long as it is kept.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import secrets
import time
from collections.abc import Callable
from typing import Any

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import Response

from service import GENERATOR
from service.api.avatars import bounds_of, erase, no_room
from service.api.context import LOOK_S, Asking, Context, Here, Json
from service.api.downloads import Extent, answer_with, download, finished, media_type
from service.api.keys import Tenant
from service.api.openapi import ExportJob, RenderJob
from service.api.problem_responses import HttpProblem
from service.api.uploads import parse_object
from service.errors import TooManyBytes, UsageError
from service.jobs.admission import KeyInUse, NewJob, NoRoom
from service.jobs.store import Row
from service.jobs.view import EXPORT, FINAL, RENDER, Kind, job_json
from service.kits.export import TOOLS, known_tool
from service.render.request import parse_request

MAX_BODY = 1 << 20


async def asked(request: Request, context: Context, kind: Kind) -> tuple[str, dict[str, Any]]:
    """The request for something: the id of the avatar, and what is wanted of it.

    HttpProblem: it is no JSON object with the id of an avatar, or does not arrive in time. TooManyBytes: it is too
    long.
    """
    values = parse_object(await _body(request, context, kind), f"malformed-{kind.name}")
    avatar = values.pop("avatar", None)
    if not isinstance(avatar, str):
        raise HttpProblem("usage", 422, "avatar has to be the id of a finished avatar", pointer="/avatar")
    return avatar, values


async def made(
    request: Request, context: Context, tenant: Tenant, kind: Kind, avatar: str, values: dict[str, Any], seconds: float
) -> Row | Response:
    """The row of the job that made something, or an answer that it is not ready after so many seconds.

    With ``Prefer: respond-async`` nothing is waited for. HttpProblem: there is no such result, the tenant may have no
    more, or it failed.
    """
    if context.draining.is_set():
        raise HttpProblem("draining", 503, headers={"Retry-After": "10"})
    source = await run_in_threadpool(finished, context, avatar, tenant)
    row = await run_in_threadpool(_job, context, tenant, kind, source, values)
    if "respond-async" not in request.headers.get("prefer", "").lower():
        row = await _ended(request, context, row, seconds)
    if row["state"] not in FINAL:
        place = f"/v1/{kind.place}/{row['id']}"
        return Json(job_json(row), 202, {"Location": place, "Retry-After": "2"})
    if row["state"] == "failed":
        raise _failure(row)
    if row["state"] == "cancelled":
        raise HttpProblem("no-result", 409, state="cancelled")
    return row


def waiting(what: str, schema: type[BaseModel]) -> dict[str, Any]:
    """What the description of the API says of the answer 202."""
    content = {"application/json": {"schema": {"$ref": f"#/components/schemas/{schema.__name__}"}}}
    return {"description": f"The {what} is not ready yet: its job.", "content": content}


def _job(context: Context, tenant: Tenant, kind: Kind, source: Row, values: dict[str, Any]) -> Row:
    """The job of this: the one that there is, or a new one; HttpProblem where the tenant may have no more."""
    wanted = json.dumps([source["archive_sha256"], GENERATOR, values], sort_keys=True)
    digest = hashlib.sha256(wanted.encode()).hexdigest()
    job = NewJob(
        id=secrets.token_hex(16), tenant=tenant.name, options={"request": values}, photo="", photo_sha256="",
        photo_bytes=0, keep_photo=False, kind=kind.name, source=source["id"], digest=digest,
        key=f"\t{kind.name} {digest}",  # no header can have a tab in it, so nobody's own key is like it
    )  # fmt: skip
    try:
        return context.store.add(job, bounds_of(context, tenant))
    except KeyInUse as used:
        return used.row
    except NoRoom as full:
        raise no_room(full) from full


async def _ended(request: Request, context: Context, row: Row, seconds: float) -> Row:
    """The row as soon as the job has ended, or when the caller has waited long enough or is gone."""
    deadline = time.monotonic() + seconds
    while row["state"] not in FINAL and time.monotonic() < deadline and not context.draining.is_set():
        found: Row | None = await run_in_threadpool(context.store.get, row["id"])
        row = found or row
        if row["state"] in FINAL or await request.is_disconnected():
            break
        await asyncio.sleep(LOOK_S)
    return row


def _failure(row: Row) -> HttpProblem:
    facts = json.loads(row["error"])
    code, status, detail = str(facts.pop("code")), int(facts.pop("status")), str(facts.pop("detail"))
    facts = {name: value for name, value in facts.items() if name not in ("type", "title")}
    return HttpProblem(code, status, detail, **facts)


async def _body(request: Request, context: Context, kind: Kind) -> bytes:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json":
        words = f"a {kind.name} is asked for with application/json"
        raise HttpProblem("unsupported-media-type", 415, words)
    data = bytearray()
    try:
        async with asyncio.timeout(context.settings.idle_seconds):
            async for chunk in request.stream():
                data += chunk
                if len(data) > MAX_BODY:
                    raise TooManyBytes(f"the request has more than {MAX_BODY} bytes", limit=MAX_BODY)
    except TimeoutError:
        raise HttpProblem("request-timeout", 408, headers={"Connection": "close"}) from None
    except ClientDisconnect:
        raise HttpProblem("bad-request", 400, "the connection closed before the body was complete") from None
    return bytes(data)


FACTS = "Render-Facts"
"""Header of the answer: JSON with exposure, effects, what leaving out the others costs at most, and fallbacks."""

_SHOWN = ("exposure", "effects", "left_out_costs_at_most", "fallbacks")


def routes(kind: Kind, schema: type[BaseModel], what: str, headers: Callable[[Row], dict[str, str]]) -> APIRouter:
    """The addresses of a derived kind, but for the one where it is asked for: state, file, deletion.

    ``what`` they make is one word; ``headers`` are those of the file.
    """
    router = APIRouter(prefix=f"/v1/{kind.place}", tags=[kind.place])
    address = f"/{{{kind.name}}}"
    job_id = Path(alias=kind.name)

    @router.get(address, response_model=schema, operation_id=f"get_{kind.name}", summary=f"State of a {what}'s job.")
    def state(tenant: Asking, context: Here, job: str = job_id) -> Response:
        """Whether it is there, and where."""
        return Json(job_json(context.job(job, tenant, kind.name)))

    @router.get(
        f"{address}/{kind.file}", response_class=Response, operation_id=f"download_{kind.name}",
        responses=download(media_type(kind.file)), summary=f"The {what}.",
    )  # fmt: skip
    async def file(request: Request, tenant: Asking, context: Here, job: str = job_id) -> Response:
        """With ranges and ``ETag``, as an archive."""
        row = await run_in_threadpool(finished, context, job, tenant, kind.name)
        extent = Extent(row["archive"], 0, row["archive_bytes"], f'"{row["archive_sha256"]}"', kind.file)
        return answer_with(request, context, extent, headers(row))

    @router.delete(address, status_code=204, operation_id=f"delete_{kind.name}", summary=f"Cancel or erase a {what}.")
    def delete(tenant: Asking, context: Here, job: str = job_id) -> Response:
        """Cancel the job or erase its result, as for an avatar."""
        erase(context, job, tenant, kind.name)
        return Response(status_code=204)

    return router


def _render_headers(row: Row) -> dict[str, str]:
    facts = json.loads(row["metadata"])
    return {FACTS: json.dumps({name: facts.get(name) for name in _SHOWN})}


renders = routes(RENDER, RenderJob, "picture", _render_headers)

_PICTURE = {
    "description": "The picture.",
    "content": {"image/png": {"schema": {"type": "string", "format": "binary"}}},
    "headers": {FACTS: {"schema": {"type": "string"}, "description": "JSON: what was computed and left out."}},
}


@renders.post(
    "", response_class=Response, operation_id="render_avatar",
    responses={200: _PICTURE, 202: waiting("picture", RenderJob)}, summary="Render a finished avatar under a scene.",
)  # fmt: skip
async def render_avatar(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes a JSON object: ``avatar``, the id of a job that has succeeded; ``scene``, see docs/render.md; ``size``,
    ``view``, ``background``, ``samples``, ``tolerance``. Answers with the picture as soon as it is made; with 202 and
    its job where that takes too long, or at once with ``Prefer: respond-async``.
    """
    avatar, values = await asked(request, context, RENDER)
    parse_request(values)
    row = await made(request, context, tenant, RENDER, avatar, values, context.settings.render_wait_seconds)
    if isinstance(row, Response):
        return row
    content = await run_in_threadpool(context.artifacts.read, row["archive"])
    place = {"Content-Location": f"/v1/{RENDER.place}/{row['id']}", "Cache-Control": "no-store"}
    return Response(content, 200, {**_render_headers(row), **place}, "image/png")


def _kit_headers(row: Row) -> dict[str, str]:
    tool = json.loads(row["options"])["request"]["for"]
    return {"Content-Disposition": f'attachment; filename="avatar-{row["source"][:8]}-{tool}.zip"'}


exports = routes(EXPORT, ExportJob, "kit", _kit_headers)

_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "The kit is there: its job, whose links lead to it."},
    202: waiting("kit", ExportJob),
}


@exports.post(
    "", response_model=ExportJob, operation_id="export_avatar", responses=_ANSWERS,
    summary="Have a kit for a tool made of a finished avatar.",
)  # fmt: skip
async def export_avatar(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes a JSON object: ``avatar``, the id of a job that has succeeded, and ``for``, the tool. Answers at once with
    the job: 202 while the kit is not there, 200 when it is.
    """
    avatar, values = await asked(request, context, EXPORT)
    unknown = sorted(set(values) - {"for"})
    if unknown:
        raise UsageError(f"there is no field {unknown[0][:40]!r}; there are avatar and for", field=unknown[0][:40])
    if "for" not in values:
        raise UsageError(f"for is missing; it is one of {', '.join(TOOLS)}", field="for")
    row = await made(request, context, tenant, EXPORT, avatar, {"for": known_tool(values["for"])}, 0.0)
    if isinstance(row, Response):
        return row
    return Json(job_json(row), 200, {"Content-Location": f"/v1/{EXPORT.place}/{row['id']}"})
