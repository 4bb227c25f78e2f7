"""Receiving a photo and what is said beside it: taken apart and counted as it streams to
the disk, with a deadline, and gone again if anything fails.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import secrets
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service.api.parameters import MAX_BYTES as MAX_OPTIONS
from service.api.parameters import NAMES, parse_options, query_options
from service.api.problem_responses import ProblemError
from service.errors import TooManyBytes
from service.jobs.admission import PRIORITIES
from service.jobs.settings import Settings
from service.options import Options

PARTS = ("options", "keep_photo", "metadata", "priority", "webhook_url")
"""Parts beside the photo."""

QUERY = frozenset(PARTS) - {"options"} | NAMES
"""Parameters of the address of a photo that is the body."""


@dataclass
class Upload:
    """A request that has arrived.

    Attributes:
        path: file of the photo, in the folder of uploads.
        sha256: hex digest of the photo.
        size: bytes of the photo.
        options: the part ``options``, empty without one.
        named: options by name as text, where the photo is the body.
        keep_photo: the part ``keep_photo``.
        metadata: the part ``metadata``, empty without one.
        priority: the part ``priority``.
        webhook_url: the part ``webhook_url``, empty without one.
    """

    path: Path
    sha256: str = ""
    size: int = 0
    options: bytes = b""
    named: dict[str, str] = field(default_factory=dict)
    keep_photo: bool = False
    metadata: bytes = b""
    priority: str = "normal"
    webhook_url: str = ""

    def chosen(self) -> Options:
        """The options.

        Raises:
            ProblemError, UsageError: as ``service.api.parameters.parse_options``.
        """
        return query_options(self.named) if self.named else parse_options(self.options)

    def set(self, name: str, value: bytes) -> None:
        """Take a part other than the photo.

        Raises:
            ProblemError: its value is not possible.
        """
        if name == "options":
            self.options = value
        elif name == "metadata":
            self.metadata = value
        elif name == "webhook_url":
            self.webhook_url = value.decode("utf-8", "replace").strip()
        elif name == "keep_photo":
            self.keep_photo = _one_of(name, value, ("true", "false")) == "true"
        elif name == "priority":
            self.priority = _one_of(name, value, PRIORITIES)


def _one_of(name: str, value: bytes, allowed: tuple[str, ...]) -> str:
    text = value.decode("utf-8", "replace").strip().lower()
    if text not in allowed:
        *most, last = (f"'{word}'" for word in allowed)
        raise ProblemError("usage", 422, f"{name} has to be {', '.join(most)} or {last}", pointer=f"/{name}")
    return text


MAX_PARTS = 8
_MAX_HEADER = 8 << 10


def too_large(max_bytes: int) -> TooManyBytes:
    """The fault of a photo that has more than so many bytes."""
    return TooManyBytes(
        f"the photo has more than {max_bytes} bytes, which is the most that is accepted", limit=max_bytes
    )


class Body:
    """Takes the photo, a piece at a time, in worker threads."""

    def __init__(self, upload: Upload, stream: IO[bytes], max_bytes: int) -> None:
        self.upload, self._stream, self._max_bytes = upload, stream, max_bytes
        self._hash = hashlib.sha256()

    def write(self, data: bytes) -> None:
        """A piece of the body."""
        raise NotImplementedError

    def finish(self, data: bytes) -> None:
        """The last piece; checks that the body is whole."""
        self.write(data)
        self.upload.sha256 = self._hash.hexdigest()

    def _photo(self, data: bytes) -> None:
        self.upload.size += len(data)
        if self.upload.size > self._max_bytes:
            raise too_large(self._max_bytes)
        self._hash.update(data)
        self._stream.write(data)


class Raw(Body):
    """The photo itself."""

    def write(self, data: bytes) -> None:
        """As :meth:`Body.write`."""
        self._photo(data)

    def finish(self, data: bytes) -> None:
        """As :meth:`Body.finish`."""
        super().finish(data)
        if not self.upload.size:
            raise ProblemError("missing-file", 400)


class Multipart(Body):
    """A form with the photo as one of its parts (RFC 7578).

    Args:
        upload: to be filled.
        stream: where the photo goes.
        max_bytes: of the photo.
        kind: header Content-Type, with the boundary.

    Raises:
        ProblemError: there is no usable boundary; so do :meth:`write` and :meth:`finish` for what breaks the form.
        TooManyBytes: the photo is larger.
    """

    def __init__(self, upload: Upload, stream: IO[bytes], max_bytes: int, kind: str) -> None:
        from python_multipart.multipart import MultipartParser, parse_options_header

        super().__init__(upload, stream, max_bytes)
        self._options_header = parse_options_header
        boundary = parse_options_header(kind)[1].get(b"boundary")
        if not boundary or len(boundary) > 70:
            raise ProblemError("malformed-multipart", 400, "the Content-Type has no usable boundary")
        callbacks: Any = {
            "on_part_begin": self._begin,
            "on_part_data": self._data,
            "on_part_end": self._end,
            "on_header_field": self._field,
            "on_header_value": self._value,
            "on_header_end": self._header_end,
            "on_headers_finished": self._headers_end,
            "on_end": self._close,
        }
        self._parser = MultipartParser(boundary, callbacks)
        self._names: list[str] = []
        self._name, self._text, self._closed = "", bytearray(), False
        self._is_file, self._files, self._dropped = False, 0, 0
        self._fault: ProblemError | None = None
        self._key, self._content, self._disposition = bytearray(), bytearray(), b""

    def write(self, data: bytes) -> None:
        """As :meth:`Body.write`."""
        from python_multipart.exceptions import MultipartParseError

        try:
            self._parser.write(data)
        except MultipartParseError as error:
            raise ProblemError("malformed-multipart", 400) from error

    def finish(self, data: bytes) -> None:
        """As :meth:`Body.finish`."""
        super().finish(data)
        if not self._names and not self._closed and not self._parser_started(data):
            raise ProblemError("missing-file", 400)
        if not self._closed:
            raise ProblemError("malformed-multipart", 400, "the body ends before its closing boundary")
        if self._fault is not None:
            raise self._fault
        if "image" not in self._names:
            raise ProblemError("missing-file", 400)

    def _parser_started(self, data: bytes) -> bool:
        return bool(data) or self.upload.size > 0

    def _begin(self) -> None:
        if len(self._names) >= MAX_PARTS:
            raise ProblemError("too-many-parts", 400)
        self._name, self._disposition = "", b""
        self._text.clear()

    def _field(self, data: bytes, start: int, end: int) -> None:
        self._grow(self._key, data[start:end])

    def _value(self, data: bytes, start: int, end: int) -> None:
        self._grow(self._content, data[start:end])

    def _grow(self, buffer: bytearray, data: bytes) -> None:
        buffer += data
        if len(buffer) > _MAX_HEADER:
            raise ProblemError("part-too-large", 400, f"a header of a part has more than {_MAX_HEADER} bytes")

    def _header_end(self) -> None:
        if bytes(self._key).lower() == b"content-disposition":
            self._disposition = bytes(self._content)
        self._key.clear()
        self._content.clear()

    def _headers_end(self) -> None:
        # The name of the file is never looked at, only whether there is one: names are made by this server.
        words = self._options_header(self._disposition)[1]
        self._name = words.get(b"name", b"").decode("utf-8", "replace")
        known = self._name == "image" or self._name in PARTS
        self._is_file = self._name == "image" or (not known and b"filename" in words)
        self._files += self._is_file
        if self._files > 1:
            raise ProblemError("one-file-only", 400)
        if known and self._name in self._names:
            raise ProblemError("too-many-parts", 400)
        if not known:
            name = self._name[:40]
            self._later(ProblemError("unknown-field", 422, f"there is no part {name!r}", pointer=f"/{name}"))
        self._names.append(self._name)

    def _later(self, fault: ProblemError) -> None:
        """Keep the first fault of a value for the end: one of the form, which the rest may show, comes before it."""
        self._fault = self._fault or fault

    def _data(self, data: bytes, start: int, end: int) -> None:
        if self._name == "image":
            self._photo(data[start:end])
        elif self._is_file:  # under a name that there is not
            self._dropped += end - start
            if self._dropped > self._max_bytes:
                raise too_large(self._max_bytes)
        else:
            self._text += data[start:end]
            if len(self._text) > MAX_OPTIONS:
                raise ProblemError("part-too-large", 400)

    def _end(self) -> None:
        if self._name in PARTS:
            try:
                self.upload.set(self._name, bytes(self._text))
            except ProblemError as fault:
                self._later(fault)

    def _close(self) -> None:
        self._closed = True


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
