"""``/v1/exports``: a finished avatar as a kit for a tool. :mod:`service.api.derived` has it made and kept."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from service.api.admitting import erase
from service.api.derived import asked, made, waiting
from service.api.extents import Extent, answer_with
from service.api.files import finished
from service.api.needs import Asking, Here
from service.api.schemas import ExportJob
from service.errors import UsageError
from service.jobs.kinds import EXPORT
from service.jobs.view import job_json
from service.kits.tools import TOOLS, known

router = APIRouter(prefix="/v1/exports", tags=["exports"])

_CONTENT = {"application/zip": {"schema": {"type": "string", "format": "binary"}}}
_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "The kit is there: its job, whose links lead to it."},
    202: waiting("kit", ExportJob),
}


@router.post(
    "", response_model=ExportJob, operation_id="export_avatar", responses=_ANSWERS,
    summary="Have a kit for a tool made of a finished avatar.",
)  # fmt: skip
async def post(request: Request, tenant: Asking, context: Here) -> Response:
    """Takes a JSON object: ``avatar``, the id of a job that has succeeded, and ``for``, the tool. Answers at once with
    the job: 202 while the kit is not there, 200 when it is.
    """
    avatar, values = await asked(request, context, EXPORT)
    unknown = sorted(set(values) - {"for"})
    if unknown:
        raise UsageError(f"there is no field {unknown[0][:40]!r}; there are avatar and for", field=unknown[0][:40])
    if "for" not in values:
        raise UsageError(f"for is missing; it is one of {', '.join(TOOLS)}", field="for")
    row = await made(request, context, tenant, EXPORT, avatar, {"for": known(values["for"])}, 0.0)
    if isinstance(row, Response):
        return row
    place = f"/v1/{EXPORT.place}/{row['id']}"
    return JSONResponse(job_json(row), 200, {"Content-Location": place, "Cache-Control": "no-store"})


@router.get("/{export}", response_model=ExportJob, operation_id="get_export", summary="State of a kit's job.")
def state(export: str, tenant: Asking, context: Here) -> Response:
    """Whether the kit is there, and where."""
    row = context.job(export, tenant, EXPORT.name)
    return JSONResponse(job_json(row), 200, {"Cache-Control": "no-store"})


@router.head("/{export}/kit.zip", include_in_schema=False)
@router.get(
    "/{export}/kit.zip", response_class=Response, operation_id="download_export",
    responses={
        200: {"description": "The kit.", "content": _CONTENT},
        206: {"description": "A range of it.", "content": _CONTENT},
        304: {"description": "As it was."},
    },
    summary="The kit as a zip.",
)  # fmt: skip
async def kit(export: str, request: Request, tenant: Asking, context: Here) -> Response:
    """With ranges and ``ETag``, as an archive."""
    row = await run_in_threadpool(finished, context, export, tenant, EXPORT.name)
    extent = Extent(row["archive"], 0, row["archive_bytes"], f'"{row["archive_sha256"]}"', EXPORT.file)
    name = f"avatar-{row['source'][:8]}-kit.zip"
    return answer_with(request, context, extent, {"Content-Disposition": f'attachment; filename="{name}"'})


@router.delete("/{export}", status_code=204, operation_id="delete_export", summary="Cancel or erase a kit.")
def delete(export: str, tenant: Asking, context: Here) -> Response:
    """As for an avatar."""
    erase(context, export, tenant, EXPORT.name)
    return Response(status_code=204)
