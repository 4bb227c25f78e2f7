"""``archive.zip`` and the files in it, in pieces if wanted."""

from __future__ import annotations

import base64
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from service.api.context import Context
from service.api.extents import OTHER, TYPES, Extent, answer_with, media_type, member, members
from service.api.keys import Tenant
from service.api.needs import Asking, Here
from service.api.problems import ProblemError, not_found
from service.api.schemas import FileList
from service.jobs.store import Row

SIGNED_S = 300
"""Seconds for which an address at the store can be used; a download that has begun goes on."""

router = APIRouter(prefix="/v1/avatars", tags=["results"])

_BINARY = {"schema": {"type": "string", "format": "binary"}}


def _answers(*kinds: str) -> dict[int | str, dict[str, Any]]:
    """For the description: what a download of one of these media types is answered with."""
    content = {kind.partition(";")[0]: _BINARY for kind in kinds}
    return {
        200: {"description": "The file.", "content": content},
        206: {"description": "A range of the file.", "content": content},
        304: {"description": "As it was."},
    }


@router.head("/{job}/archive.zip", include_in_schema=False)
@router.get(
    "/{job}/archive.zip",
    response_class=Response,
    operation_id="download_archive",
    responses=_answers(TYPES["zip"]),
    summary="The whole result as a zip.",
)
async def archive(job: str, request: Request, tenant: Asking, context: Here) -> Response:
    """With ``Range``, ``If-Range`` and a strong ``ETag``, so that a download can go on where it was cut off.

    307 where the operator lets the store give files out: its address is in ``Location`` and holds for five minutes.
    """
    row = await run_in_threadpool(finished, context, job, tenant)
    digest = row["archive_sha256"]
    whole = Extent(row["archive"], 0, row["archive_bytes"], f'"{digest}"', "archive.zip")
    disposition = {"Content-Disposition": f'attachment; filename="avatar-{job[:8]}.zip"'}
    if context.settings.signed_downloads and request.method == "GET":
        words = disposition["Content-Disposition"]
        place = await run_in_threadpool(context.artifacts.signed, row["archive"], SIGNED_S, words)
        if place is not None:
            headers = {"Location": place, "Cache-Control": "no-store", "Repr-Digest": _digest(digest)}
            return Response(status_code=307, headers=headers)
    return answer_with(request, context, whole, disposition)


@router.get(
    "/{job}/files",
    response_model=FileList,
    operation_id="list_files",
    summary="Names and sizes of the files of the result.",
)
def listing(job: str, tenant: Asking, context: Here) -> Response:
    """Each file can be had by itself under its ``link``."""
    row = finished(context, job, tenant)
    items = [
        {
            "path": info.filename,
            "bytes": info.file_size,
            "media_type": media_type(info.filename),
            "link": f"/v1/avatars/{job}/files/{info.filename}",
        }
        for info in members(context, row)
    ]
    return JSONResponse({"items": items}, headers={"Cache-Control": "no-store"})


@router.head("/{job}/files/{path:path}", include_in_schema=False)
@router.get(
    "/{job}/files/{path:path}",
    response_class=Response,
    operation_id="download_file",
    responses=_answers(OTHER, *(kind for name, kind in TYPES.items() if name != "zip")),
    summary="One file of the result.",
)
async def file(job: str, path: str, request: Request, tenant: Asking, context: Here) -> Response:
    """As the whole archive, with ranges."""
    row = await run_in_threadpool(finished, context, job, tenant)
    return answer_with(request, context, await run_in_threadpool(member, context, row, path), {})


@router.head("/{job}/photo", include_in_schema=False)
@router.get(
    "/{job}/photo",
    response_class=Response,
    operation_id="download_photo",
    responses=_answers(OTHER),
    summary="The photo as it was sent, where it was to be kept.",
)
async def photo(job: str, request: Request, tenant: Asking, context: Here) -> Response:
    """As bytes to be stored, never as something that a browser shows: it may be more things than a picture."""
    row = await run_in_threadpool(context.job, job, tenant)
    if not row["keep_photo"] or not row["photo"] or not await run_in_threadpool(context.artifacts.exists, row["photo"]):
        raise not_found()
    whole = Extent(row["photo"], 0, row["photo_bytes"], f'"{row["photo_sha256"]}"', "photo.bin")
    return answer_with(request, context, whole, {"Content-Disposition": f'attachment; filename="photo-{job[:8]}.bin"'})


def finished(context: Context, job: str, tenant: Tenant, kind: str = "avatar") -> Row:
    """The row of a tenant's job that has a result.

    Raises:
        ProblemError: there is no such job, it has not succeeded, or its result is gone.
    """
    row = context.job(job, tenant, kind)
    if row["state"] in ("queued", "running"):
        raise ProblemError("not-ready", 409, headers={"Retry-After": "2"}, state=row["state"])
    if row["state"] != "succeeded":
        raise ProblemError("no-result", 409, state=row["state"])
    if not context.artifacts.exists(row["archive"]):
        raise ProblemError("gone", 410, reason="lost")
    return row


def _digest(sha256: str) -> str:
    """The hash of a file as a header of RFC 9530."""
    return f"sha-256=:{base64.b64encode(bytes.fromhex(sha256)).decode()}:"
