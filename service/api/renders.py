"""``/v1/renders``: a finished avatar under the light of a scene. :mod:`service.api.derived` has it made and kept."""

from __future__ import annotations

import json
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from service.api.admitting import erase
from service.api.derived import asked, made, waiting, whole
from service.api.extents import Extent, answer_with
from service.api.files import finished
from service.api.needs import Asking, Here
from service.api.schemas import RenderJob
from service.jobs.kinds import RENDER
from service.jobs.store import Row
from service.jobs.view import job_json
from service.render.wire import parse

FACTS = "Render-Facts"
"""Header of the answer: JSON with exposure, effects, what leaving out the others costs at most, and fallbacks."""

_SHOWN = ("exposure", "effects", "left_out_costs_at_most", "fallbacks")

router = APIRouter(prefix="/v1/renders", tags=["renders"])

_CONTENT = {"image/png": {"schema": {"type": "string", "format": "binary"}}}
_FACTS_HEADER = {FACTS: {"schema": {"type": "string"}, "description": "JSON: what was computed and left out."}}
_PNG: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture.", "content": _CONTENT, "headers": _FACTS_HEADER},
    202: waiting("picture", RenderJob),
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
    avatar, values = await asked(request, context, RENDER)
    parse(values)
    wait = context.settings.render_wait_seconds
    row = await made(request, context, tenant, RENDER, avatar, values, wait)
    if isinstance(row, Response):
        return row
    return await run_in_threadpool(whole, context, row, "image/png", {FACTS: _facts(row)})


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
    extent = Extent(row["archive"], 0, row["archive_bytes"], f'"{row["archive_sha256"]}"', RENDER.file)
    return answer_with(request, context, extent, {FACTS: _facts(row)})


@router.delete("/{render}", status_code=204, operation_id="delete_render", summary="Cancel or erase a picture.")
def delete(render: str, tenant: Asking, context: Here) -> Response:
    """As for an avatar."""
    erase(context, render, tenant, "render")
    return Response(status_code=204)


def _facts(row: Row) -> str:
    facts = json.loads(row["metadata"])
    return json.dumps({name: facts.get(name) for name in _SHOWN})
