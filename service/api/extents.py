"""A file, or a piece of one, as an answer: ranges, ``If-Range``, strong ``ETag``, ``HEAD``.

Members of the archive are stored and not deflated, so a member is a range of the archive and needs no copy.
"""

from __future__ import annotations

import zipfile
from collections.abc import AsyncIterator
from dataclasses import dataclass

from fastapi import Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from service.api.context import Context
from service.api.problems import not_found
from service.api.ranges import not_modified, wanted_range
from service.jobs.store import Row

PIECE = 256 << 10

_LOCAL_HEADER = 30

TYPES = {
    "zip": "application/zip",
    "json": "application/json",
    "png": "image/png",
    "jpg": "image/jpeg",
    "glb": "model/gltf-binary",
    "obj": "model/obj",
    "mtl": "model/mtl",
    "usda": "model/vnd.usda",
    "md": "text/markdown; charset=utf-8",
}

OTHER = "application/octet-stream"


@dataclass(frozen=True)
class Extent:
    """A piece of an artifact that is given out as a file."""

    artifact: str
    start: int
    size: int
    etag: str
    name: str


def members(context: Context, row: Row) -> list[zipfile.ZipInfo]:
    """Files of a job's archive."""
    with context.artifacts.open(row["archive"]) as stream, zipfile.ZipFile(stream) as archive:
        return archive.infolist()


def member(context: Context, row: Row, path: str) -> Extent:
    """Where a file lies in a job's archive.

    Raises:
        ProblemError: there is none of this name.
    """
    info = next((info for info in members(context, row) if info.filename == path), None)
    if info is None or info.compress_type != zipfile.ZIP_STORED:
        raise not_found()
    with context.artifacts.open(row["archive"]) as stream:
        stream.seek(info.header_offset)
        header = stream.read(_LOCAL_HEADER)
    start = info.header_offset + _LOCAL_HEADER + int.from_bytes(header[26:28], "little")
    start += int.from_bytes(header[28:30], "little")
    etag = f'"{row["archive_sha256"][:32]}-{info.CRC:08x}"'
    return Extent(row["archive"], start, info.file_size, etag, path)


def answer_with(request: Request, context: Context, extent: Extent, headers: dict[str, str]) -> Response:
    """The file that a request asks for, a range of it, or that it is as it was."""
    headers = {
        **headers,
        "Accept-Ranges": "bytes",
        "ETag": extent.etag,
        "Cache-Control": "private, max-age=3600",
        "Content-Type": media_type(extent.name),
    }
    if not_modified(request.headers, extent.etag):
        return Response(status_code=304, headers=headers)
    part = wanted_range(request.headers, extent.size, extent.etag)
    first, count = part or (0, extent.size)
    headers["Content-Length"] = str(count)
    if part is not None:
        headers["Content-Range"] = f"bytes {first}-{first + count - 1}/{extent.size}"
    status = 200 if part is None else 206
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers)
    pieces = _pieces(context, extent.artifact, extent.start + first, count)
    return StreamingResponse(pieces, status, headers)


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
    """Of a file by the end of its name."""
    return TYPES.get(name.rpartition(".")[2], OTHER)
