"""``POST /v1/renders``: a finished avatar under the light of a scene, as a PNG in the answer."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import secrets
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import Response

from service.api.avatars import Asking, Here
from service.api.context import Context
from service.api.files import finished
from service.api.options import parse_object
from service.api.problems import ProblemError
from service.errors import Crashed, OutOfMemory, TooManyBytes
from service.jobs.process import Ending, JobProcess
from service.jobs.wire import Task
from service.render.wire import parse

MAX_BODY = 1 << 20
FACTS = "Render-Facts"
"""Header of the answer: JSON with exposure, effects, what leaving out the others costs at most, and fallbacks."""

_LOOK_S = 0.25
_SHOWN = ("exposure", "effects", "left_out_costs_at_most", "fallbacks")

router = APIRouter(prefix="/v1/renders", tags=["renders"])

_PNG: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture.",
        "content": {"image/png": {"schema": {"type": "string", "format": "binary"}}},
        "headers": {FACTS: {"schema": {"type": "string"}, "description": "JSON: what was computed and left out."}},
    }
}


@router.post(
    "",
    response_class=Response,
    operation_id="render_avatar",
    responses=_PNG,
    summary="Render a finished avatar under a scene.",
)
async def post(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes a JSON object: ``avatar``, the id of a job that has succeeded; ``scene``, see docs/render.md; ``size``,
    ``view``, ``background``, ``samples``, ``tolerance``. Nothing is stored; a caller that goes away ends the work.
    """
    values = parse_object(await _body(request, context), "malformed-render")
    avatar = values.pop("avatar", None)
    if not isinstance(avatar, str):
        raise ProblemError("usage", 422, "avatar has to be the id of a finished avatar", pointer="/avatar")
    parse(values)
    row = await run_in_threadpool(finished, context, avatar, tenant)
    async with _slot(context):
        png, facts = await _rendered(request, context, row["archive"], values)
    shown = json.dumps({name: facts[name] for name in _SHOWN})
    return Response(png, 200, {FACTS: shown, "Cache-Control": "no-store"}, "image/png")


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


@contextlib.asynccontextmanager
async def _slot(context: Context) -> AsyncIterator[None]:
    if context.draining.is_set():
        raise ProblemError("draining", 503, headers={"Retry-After": "10"})
    if context.renders >= context.settings.renders:
        raise ProblemError("busy", 503, "too many pictures are being rendered", headers={"Retry-After": "5"})
    context.renders += 1
    try:
        yield
    finally:
        context.renders -= 1


async def _rendered(
    request: Request, context: Context, archive: str, values: dict[str, Any]
) -> tuple[bytes, dict[str, Any]]:
    """PNG and facts from a process of its own, which ends when the caller goes away."""
    output = context.settings.incoming / f"{secrets.token_hex(16)}.png"
    task = Task(
        job="render", photo="", photo_sha256="", options={"archive": archive, "request": values},
        artifacts=context.settings.artifacts_url, output=str(output), scratch=str(context.settings.incoming),
    )  # fmt: skip
    stop = threading.Event()
    work = asyncio.ensure_future(run_in_threadpool(_run, context, task, stop))
    try:
        while not (await asyncio.wait({work}, timeout=_LOOK_S))[0]:
            if await request.is_disconnected():
                stop.set()
        ending = await work
        return await run_in_threadpool(_result, ending, output, context.settings.render_seconds)
    finally:
        stop.set()
        output.unlink(missing_ok=True)


def _run(context: Context, task: Task, stop: threading.Event) -> Ending:
    settings = context.settings
    limits = dataclasses.replace(settings, program="service.render.child", job_seconds=settings.render_seconds)
    return JobProcess(limits).run(task, lambda message: None, lambda: stop.is_set() or context.draining.is_set())


def _result(ending: Ending, output: Path, seconds: float) -> tuple[bytes, dict[str, Any]]:
    if ending.kind == "done":
        return output.read_bytes(), ending.facts
    if ending.kind == "problem":
        facts = dict(ending.facts)
        code, status, detail = str(facts.pop("code")), int(facts.pop("status")), str(facts.pop("detail"))
        facts.pop("type", None)
        facts.pop("title", None)
        raise ProblemError(code, status, detail, **facts)
    if ending.kind == "time":
        raise ProblemError("render-timeout", 504, f"rendering took more than {seconds:g} s; ask for a smaller picture")
    if ending.kind == "memory":
        raise OutOfMemory("rendering needs more memory than this server allows; ask for a smaller picture")
    if ending.kind == "stopped":
        raise ProblemError("draining", 503, headers={"Retry-After": "10"})
    raise Crashed("the process that renders ended without an answer")
