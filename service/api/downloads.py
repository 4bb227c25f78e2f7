"""``archive.zip``, the files in it and the photo, in pieces if wanted: ranges, ``If-Range``, strong ``ETag``, ``HEAD``.

Members of the archive are stored and not deflated, so a member is a range of the archive and needs no copy.
"""

from __future__ import annotations

import base64
import re
import zipfile
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from service.api.context import Asking, Context, Here, Json
from service.api.front import is_head
from service.api.keys import Tenant
from service.api.openapi import FileList
from service.api.problem_responses import HttpProblem, not_found
from service.archive.container import MEDIA_TYPES
from service.jobs.store import Row

_ONE = re.compile(r"bytes=\s*(\d{0,18})-(\d{0,18})\s*\Z", re.IGNORECASE)


def wanted_range(headers: Mapping[str, str], size: int, etag: str) -> tuple[int, int] | None:
    """First byte and number of bytes that a request asks for; None for the whole file.

    A range under another ``If-Range`` than the file's etag is not one any more. 416: there is no such range, or there
    are several of them.
    """
    text = headers.get("range")
    if text is None or not text.lower().startswith("bytes=") or headers.get("if-range", etag) != etag:
        return None
    match = _ONE.match(text)
    if match is None or match[1] == match[2] == "":
        raise _unsatisfiable(size)
    if match[1] == "":
        first, last = max(size - int(match[2]), 0), size - 1
    else:
        first, last = int(match[1]), min(int(match[2] or size - 1), size - 1)
    if first > last or first >= size:
        raise _unsatisfiable(size)
    return first, last - first + 1


def not_modified(headers: Mapping[str, str], etag: str) -> bool:
    """Whether the caller has this content already."""
    known = headers.get("if-none-match")
    return known is not None and (
        known.strip() == "*" or etag in [part.strip().removeprefix("W/") for part in known.split(",")]
    )


def _unsatisfiable(size: int) -> HttpProblem:
    return HttpProblem("range-not-satisfiable", 416, headers={"Content-Range": f"bytes */{size}"})


PIECE = 256 << 10

_LOCAL_HEADER = 30

TYPES = {**MEDIA_TYPES, "zip": "application/zip", "md": "text/markdown; charset=utf-8"}

OTHER = "application/octet-stream"


@dataclass(frozen=True)
class Extent:
    """A piece of an artifact that is given out as a file."""

    artifact: str
    start: int
    size: int
    etag: str
    name: str


def member(context: Context, row: Row, path: str) -> Extent:
    """Where a file lies in a job's archive; HttpProblem where there is none of this name."""
    with context.artifacts.open(row["archive"]) as stream, zipfile.ZipFile(stream) as archive:
        info = archive.NameToInfo.get(path)
        if info is None or info.compress_type != zipfile.ZIP_STORED:
            raise not_found()
        stream.seek(info.header_offset)
        header = stream.read(_LOCAL_HEADER)
    start = info.header_offset + _LOCAL_HEADER + int.from_bytes(header[26:28], "little")
    start += int.from_bytes(header[28:30], "little")
    etag = f'"{row["archive_sha256"][:32]}-{info.CRC:08x}"'
    return Extent(row["archive"], start, info.file_size, etag, path)


def answer_with(request: Request, context: Context, extent: Extent, headers: dict[str, str]) -> Response:
    """The file that a request asks for, a range of it, or that it is as it was."""
    headers = {
        "Accept-Ranges": "bytes",
        "ETag": extent.etag,
        "Cache-Control": "private, no-cache",  # asked for again each time, so that what is erased is gone
        "Content-Type": media_type(extent.name),
        **headers,
    }
    if not_modified(request.headers, extent.etag):
        return Response(status_code=304, headers=headers)
    # A range of nothing is none: for HEAD the header has no meaning (RFC 9110, section 14.2).
    part = None if is_head(request) else wanted_range(request.headers, extent.size, extent.etag)
    first, count = part or (0, extent.size)
    headers["Content-Length"] = str(count)
    if part is not None:
        headers["Content-Range"] = f"bytes {first}-{first + count - 1}/{extent.size}"
    if is_head(request):
        return Response(headers=headers)
    pieces = _pieces(context, extent.artifact, extent.start + first, count)
    return StreamingResponse(pieces, 200 if part is None else 206, headers)


async def _pieces(context: Context, artifact: str, start: int, count: int) -> AsyncIterator[bytes]:
    stream = await run_in_threadpool(context.artifacts.open, artifact)
    try:
        await run_in_threadpool(stream.seek, start)
        while count > 0:
            piece = await run_in_threadpool(stream.read, min(PIECE, count))
            if not piece:
                return
            count -= len(piece)
            yield piece
    finally:
        stream.close()


def media_type(name: str) -> str:
    """Media type of a file by the end of its name."""
    return TYPES.get(name.rpartition(".")[2], OTHER)


SIGNED_S = 300
"""Seconds for which an address at the store can be used; a download that has begun goes on."""

router = APIRouter(prefix="/v1/avatars", tags=["results"])

_BINARY = {"type": "string", "format": "binary"}
_SCHEMAS: dict[str, dict[str, Any]] = {TYPES["json"]: {}, "text/markdown": {"type": "string"}}
"""What a whole file of a media type is, other than bytes."""


def download(*kinds: str) -> dict[int | str, dict[str, Any]]:
    """For the description: what a download of one of these media types is answered with."""
    names = [kind.partition(";")[0] for kind in kinds]
    whole = {name: {"schema": _SCHEMAS.get(name, _BINARY)} for name in names}
    return {
        200: {"description": "The file.", "content": whole},
        206: {"description": "A range of the file.", "content": {name: {"schema": _BINARY} for name in names}},
        304: {"description": "As it was."},
    }


@router.get(
    "/{job}/archive.zip",
    response_class=Response,
    operation_id="download_archive",
    responses={**download(TYPES["zip"]), 307: {"description": "At the store, for five minutes."}},
    summary="The whole result as a zip.",
)
async def download_archive(job: str, request: Request, tenant: Asking, context: Here) -> Response:
    """With ``Range``, ``If-Range`` and a strong ``ETag``, so that a download can go on where it was cut off.

    307 where the operator lets the store give files out: its address is in ``Location`` and holds for five minutes.
    """
    row = await run_in_threadpool(finished, context, job, tenant)
    digest = row["archive_sha256"]
    whole = Extent(row["archive"], 0, row["archive_bytes"], f'"{digest}"', "archive.zip")
    disposition = {"Content-Disposition": f'attachment; filename="avatar-{job[:8]}.zip"'}
    if context.settings.signed_downloads:
        words = disposition["Content-Disposition"]
        place = await run_in_threadpool(context.artifacts.signed, row["archive"], SIGNED_S, words, is_head(request))
        if place is not None:
            coded = base64.b64encode(bytes.fromhex(digest)).decode()  # as RFC 9530 has it
            headers = {"Location": place, "Cache-Control": "no-store", "Repr-Digest": f"sha-256=:{coded}:"}
            return Response(status_code=307, headers=headers)
    return answer_with(request, context, whole, disposition)


@router.get(
    "/{job}/files",
    response_model=FileList,
    operation_id="list_files",
    summary="Names and sizes of the files of the result.",
)
def list_files(job: str, tenant: Asking, context: Here) -> Response:
    """Each file can be had by itself under its ``link``."""
    row = finished(context, job, tenant)
    with context.artifacts.open(row["archive"]) as stream, zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
    items = [
        {
            "path": info.filename,
            "bytes": info.file_size,
            "media_type": media_type(info.filename),
            "link": f"/v1/avatars/{job}/files/{info.filename}",
        }
        for info in members
    ]
    return Json({"items": items})


@router.get(
    "/{job}/files/{path:path}",
    response_class=Response,
    operation_id="download_file",
    responses=download(OTHER, *(kind for name, kind in TYPES.items() if name != "zip")),
    summary="One file of the result.",
)
async def download_file(job: str, path: str, request: Request, tenant: Asking, context: Here) -> Response:
    """As the whole archive, with ranges."""
    row = await run_in_threadpool(finished, context, job, tenant)
    return answer_with(request, context, await run_in_threadpool(member, context, row, path), {})


@router.get(
    "/{job}/photo",
    response_class=Response,
    operation_id="download_photo",
    responses=download(OTHER),
    summary="The photo as it was sent, where it was to be kept.",
)
async def download_photo(job: str, request: Request, tenant: Asking, context: Here) -> Response:
    """As bytes to be stored, never as something that a browser shows: it may be more things than a picture."""
    row = await run_in_threadpool(context.job, job, tenant)
    if not row["keep_photo"] or not row["photo"] or not await run_in_threadpool(context.artifacts.exists, row["photo"]):
        raise not_found()
    whole = Extent(row["photo"], 0, row["photo_bytes"], f'"{row["photo_sha256"]}"', "photo.bin")
    words = f'attachment; filename="photo-{job[:8]}.bin"'
    return answer_with(request, context, whole, {"Content-Disposition": words, "Cache-Control": "no-store"})


def finished(context: Context, job: str, tenant: Tenant, kind: str = "avatar") -> Row:
    """The row of a tenant's job that has a result.

    HttpProblem: there is no such job, it has not succeeded, or its result is gone.
    """
    row = context.job(job, tenant, kind)
    if row["state"] in ("queued", "running"):
        raise HttpProblem("not-ready", 409, headers={"Retry-After": "2"}, state=row["state"])
    if row["state"] != "succeeded":
        raise HttpProblem("no-result", 409, state=row["state"])
    if not context.artifacts.exists(row["archive"]):
        raise HttpProblem("gone", 410, reason="lost")
    return row
