"""Receiving a photo: counted as it streams to the disk, with a deadline, and gone again if anything fails."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service.api.bodies import Body, Multipart, Raw, too_large
from service.api.problems import ProblemError
from service.api.upload import PARTS, Upload
from service.jobs.settings import Settings

IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp")
_MOST_DIGITS = 18
"""Of a length that is worth reading; Python refuses to read thousands."""
_FRAME = 64 << 10
_BATCH = 256 << 10


@contextlib.asynccontextmanager
async def received(request: Request, settings: Settings, max_bytes: int) -> AsyncIterator[Upload]:
    """The upload of a request; its file is removed afterwards, unless it was moved elsewhere.

    Args:
        request: multipart/form-data with the part ``image``, or a body that is the image.
        settings: folder and deadlines.
        max_bytes: of the photo.

    Raises:
        ProblemError: the request is not of that form or does not arrive in time.
        TooManyBytes: the photo is larger.
    """
    kind = request.headers.get("content-type", "")
    _check_length(request, max_bytes)
    settings.incoming.mkdir(parents=True, exist_ok=True, mode=0o700)
    upload = Upload(settings.incoming / f"{secrets.token_hex(16)}.part")
    _take_parameters(request, upload, form=_is_form(kind))
    try:
        with upload.path.open("xb") as stream:
            sink: Body = (
                Multipart(upload, stream, max_bytes, kind) if _is_form(kind) else Raw(upload, stream, max_bytes)
            )
            if not _is_form(kind) and kind.partition(";")[0].strip().lower() not in IMAGE_TYPES:
                raise ProblemError("unsupported-media-type", 415, headers={"Accept": ", ".join(IMAGE_TYPES)})
            await _pump(request, sink, settings)
        yield upload
    finally:
        upload.path.unlink(missing_ok=True)


def _take_parameters(request: Request, upload: Upload, *, form: bool) -> None:
    """What the address says beside a photo that is the body; a form says it in parts."""
    for name, text in request.query_params.items():
        if form:
            words = f"a form has {name} as a part, an option in the part 'options'; not in its address"
            raise ProblemError("invalid-parameter", 422, words, pointer=f"/query/{name}")
        if name in PARTS:
            upload.set(name, text.encode())
        else:
            upload.named[name] = text


async def _pump(request: Request, sink: Body, settings: Settings) -> None:
    batch = bytearray()
    stream = request.stream().__aiter__()
    try:
        async with asyncio.timeout(settings.body_seconds):
            while True:
                try:
                    chunk = await asyncio.wait_for(stream.__anext__(), settings.idle_seconds)
                except StopAsyncIteration:
                    break
                batch += chunk
                if len(batch) >= _BATCH:
                    await run_in_threadpool(sink.write, bytes(batch))
                    batch.clear()
    except TimeoutError:
        raise ProblemError("request-timeout", 408, headers={"Connection": "close"}) from None
    except ClientDisconnect:
        raise ProblemError("malformed-multipart", 400, "the connection closed before the body was complete") from None
    await run_in_threadpool(sink.finish, bytes(batch))


def _check_length(request: Request, max_bytes: int) -> None:
    text = request.headers.get("content-length")
    if text is None or not (text.isascii() and text.isdigit()):
        return  # the server has refused what is no length
    if len(text) > _MOST_DIGITS or int(text) > max_bytes + _FRAME:
        raise too_large(max_bytes)


def _is_form(kind: str) -> bool:
    return kind.partition(";")[0].strip().lower() == "multipart/form-data"
