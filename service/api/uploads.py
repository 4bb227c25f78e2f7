"""Receiving a photo and what is said beside it: taken apart and counted as it streams to the disk, with a deadline and
a least speed, and gone again if anything fails.

The form is taken apart by ``multipart`` and not by the framework's parser: that one keeps photos in a temporary file of
its own, takes text of any name, and does not see that the end is missing.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import secrets
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import IO, Any

import orjson
from multipart import MultipartError, MultipartSegment, PushMultipartParser, parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service.api.problem_responses import IMAGE_TYPES, HttpProblem
from service.errors import AvatarError, TooManyBytes
from service.jobs.admission import PRIORITIES
from service.jobs.settings import Settings
from service.options import Options
from service.photo.bundle import MOST, index_of

MAX_BYTES = 16 << 10
MAX_METADATA = 2 << 10
"""Bytes of the part ``metadata``."""

_MAX_LEVELS = 8

NAMES = frozenset(field.name for field in fields(Options))


def checked_options(values: Mapping[str, Any]) -> Options:
    """JSON values -> options.

    HttpProblem: there is no such option. UsageError: a value is of the wrong kind or out of range; in the words of the
    command line.
    """
    for name in values:
        if name not in NAMES:
            detail = f"there is no option {name[:40]!r}; there are {', '.join(sorted(NAMES))}"
            place = name[:40].replace("~", "~0").replace("/", "~1")  # a part of a JSON pointer (RFC 6901)
            raise HttpProblem("unknown-field", 422, detail, pointer=f"/{place}")
    return Options(**values)


def _from_text(text: str) -> Any:
    """The value of a parameter of an address, written as on the command line."""
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return value if isinstance(value, int | float) and not isinstance(value, bool) else text


def parse_object(text: bytes, code: str = "malformed-options") -> dict[str, Any]:
    """A JSON object that can be stored and given back: numbers are finite, text is Unicode, nesting is not deep.

    HttpProblem, of ``code``, "malformed-" and what the object is: says what is wrong, and where in the text.
    """
    what = code.removeprefix("malformed-")
    try:
        orjson.loads(text)  # strict, unlike the other, which takes NaN and halves of characters
        values = json.loads(text)  # keeps whole numbers of any size
    except (ValueError, RecursionError) as error:
        raise HttpProblem(code, 422, f"{what} is no JSON of finite numbers and Unicode: {error}", pointer="") from error
    if not isinstance(values, dict):
        raise HttpProblem(code, 422, f"{what} has to be a JSON object", pointer="")
    if _levels(values) > _MAX_LEVELS:
        raise HttpProblem(code, 422, f"{what} is nested more than {_MAX_LEVELS} levels deep", pointer="")
    return values


def _levels(value: Any) -> int:
    """How many objects and lists lie in one another."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return 0 if items is None else 1 + max(map(_levels, items), default=0)


FILES = ("image", "video")
"""Parts that are files: photos, and one video of the same person."""
PARTS = ("options", "keep_photo", "metadata", "priority", "webhook_url")
"""Parts beside the photo."""

QUERY = frozenset(PARTS) - {"options"} | NAMES
"""Parameters of the address of a photo that is the body."""

MAX_PARTS = 8
"""Parts of different names, and a few more for mistakes."""
MOST_TOGETHER = 4
"""Bytes of all photos of one request over those that one may have."""

LEAST_SPEED = 4096
"""Bytes a second that a body has to bring after its first seconds, or its place is given to somebody else."""

_FRAME = 64 << 10
_BATCH = 256 << 10


@dataclass
class Upload:
    """A request that has arrived.

    Attributes:
        path: file of the photo, or of several as ``service.photo.bundle`` has them, in the folder of uploads.
        max_bytes: that a photo may have.
        sha256: hex digest of the file.
        size: bytes of the file.
        sizes: of each photo.
        video: which of them came as the part ``video``; -1 for none.
        options: what to make.
        keep_photo, metadata, priority, webhook_url: the parts of these names; without one, what is here.
    """

    path: Path
    max_bytes: int
    sha256: str = ""
    size: int = 0
    sizes: list[int] = field(default_factory=list)
    video: int = -1
    options: Options = field(default_factory=Options)
    keep_photo: bool = False
    metadata: dict[str, Any] = field(default_factory=dict)
    priority: str = "normal"
    webhook_url: str = ""

    def set(self, name: str, value: bytes) -> None:
        """Take a part other than the photo; HttpProblem or UsageError where its value is not possible."""
        if name == "options":
            self.options = checked_options(parse_object(value) if value.strip() else {})
        elif name == "metadata":  # given back with the job and never looked into
            if len(value) > MAX_METADATA:
                words = f"metadata has {len(value)} bytes; at most {MAX_METADATA} are kept"
                raise HttpProblem("usage", 422, words, pointer="/metadata")
            self.metadata = parse_object(value, "malformed-metadata") if value.strip() else {}
        elif name == "webhook_url":
            self.webhook_url = value.decode("utf-8", "replace").strip()
        elif name == "keep_photo":
            self.keep_photo = _one_of(name, value, ("true", "false")) == "true"
        elif name == "priority":
            self.priority = _one_of(name, value, PRIORITIES)

    def too_large(self) -> TooManyBytes:
        """The fault of a photo that has too many bytes."""
        which = "the photo has" if len(self.sizes) < 2 else f"photo {len(self.sizes)} has"
        words = f"{which} more than {self.max_bytes} bytes, which is the most that is accepted"
        return TooManyBytes(words, limit=self.max_bytes)

    def too_large_together(self) -> TooManyBytes:
        """The fault of photos that have too many bytes together."""
        limit = MOST_TOGETHER * self.max_bytes
        return TooManyBytes(f"the photos have more than {limit} bytes together, which is the most", limit=limit)


def _one_of(name: str, value: bytes, allowed: tuple[str, ...]) -> str:
    text = value.decode("utf-8", "replace").strip().lower()
    if text not in allowed:
        raise HttpProblem("usage", 422, f"{name} has to be one of {', '.join(allowed)}", pointer=f"/{name}")
    return text


class UploadBody:
    """A body that is the photo itself, taken a piece at a time, in worker threads."""

    def __init__(self, upload: Upload, stream: IO[bytes]) -> None:
        self.upload, self._stream, self._hash = upload, stream, hashlib.sha256()
        self.most = upload.max_bytes

    def finish(self) -> None:
        """Check that the body is whole; HttpProblem where it is not."""
        if not self.upload.size:
            raise HttpProblem("missing-file", 400)
        self.upload.sha256 = self._hash.hexdigest()

    def write(self, data: bytes) -> None:
        """A piece of the photo; TooManyBytes where it is larger than it may be."""
        if not self.upload.sizes:
            self.upload.sizes.append(0)
        self.upload.sizes[-1] += len(data)
        if self.upload.sizes[-1] > self.most:
            raise self.upload.too_large()
        if self.upload.size + len(data) > MOST_TOGETHER * self.upload.max_bytes:
            raise self.upload.too_large_together()
        self._write(data)

    def _write(self, data: bytes) -> None:
        self.upload.size += len(data)
        self._hash.update(data)
        self._stream.write(data)


class Multipart(UploadBody):
    """A form with the photo, or several of one person, as its parts ``image`` (RFC 7578).

    HttpProblem: there is no usable boundary, or, of :meth:`write` and :meth:`finish`, the form is broken. TooManyBytes:
    the photo is larger than it may be.
    """

    def __init__(self, upload: Upload, stream: IO[bytes], kind: str) -> None:
        super().__init__(upload, stream)
        boundary = parse_options_header(kind)[1].get("boundary", "")
        if not 0 < len(boundary) <= 70:
            raise HttpProblem("malformed-multipart", 400, "the Content-Type has no usable boundary")
        self._parser = PushMultipartParser(boundary, header_charset="latin-1")  # in which all bytes are some text
        self._names: list[str] = []
        self._text, self._empty, self._is_file = bytearray(), True, False
        self._files, self._strange, self._dropped = 0, 0, 0
        self._fault: HttpProblem | AvatarError | None = None

    def write(self, data: bytes) -> None:
        """A piece of the form."""
        self._empty = self._empty and not data
        try:
            for event in self._parser.parse(data) if data else ():
                if isinstance(event, MultipartSegment):
                    self._begin(event)
                elif event:
                    self._data(event)
                else:
                    self._end()
        except MultipartError as error:
            raise HttpProblem("malformed-multipart", 400) from error

    def finish(self) -> None:
        """As :meth:`UploadBody.finish`."""
        if self._empty:
            raise HttpProblem("missing-file", 400)
        try:
            self._parser.close()
        except MultipartError as error:
            words = "the body ends before its closing boundary"
            raise HttpProblem("malformed-multipart", 400, words) from error
        if self._fault is not None:
            raise self._fault
        if not set(FILES) & set(self._names):
            raise HttpProblem("missing-file", 400)
        self._write(index_of(self.upload.sizes))
        self.upload.sha256 = self._hash.hexdigest()

    def _begin(self, part: MultipartSegment) -> None:
        if len(self._names) - max(self._names.count("image") - 1, 0) >= MAX_PARTS:
            raise HttpProblem("too-many-parts", 400)
        # The name of the file is never looked at, only whether there is one: names are made by this server.
        name = part.name.encode("latin-1").decode("utf-8", "replace")
        if not name:
            raise HttpProblem("malformed-multipart", 400, "a part has no name in its Content-Disposition")
        known = name in FILES or name in PARTS
        self._is_file = name in FILES or (not known and part.filename is not None)
        self._strange += self._is_file and not known
        self._files += self._is_file
        if self._files > MOST or (self._strange and self._files > 1):
            raise HttpProblem("too-many-files", 400)
        if known and name in self._names and name != "image":
            raise HttpProblem("too-many-parts", 400)
        if name in FILES:
            if name == "video":
                self.upload.video = len(self.upload.sizes)
            self.upload.sizes.append(0)
            self.most = self.upload.max_bytes * (MOST_TOGETHER if name == "video" else 1)
        if not known:
            words = f"there is no part {name[:40]!r}; there are {', '.join(FILES + PARTS)}"
            words += f"; put {name} into the JSON object 'options'" if name in NAMES else ""
            self._later(HttpProblem("unknown-field", 422, words, pointer=f"/{name[:40]}"))
        self._names.append(name)
        self._text.clear()

    def _later(self, fault: HttpProblem | AvatarError) -> None:
        """Keep the first fault of a value for the end: one of the form, which the rest may show, comes before it."""
        self._fault = self._fault or fault

    def _data(self, data: bytes) -> None:
        if self._names[-1] in FILES:
            super().write(data)
        elif self._is_file:  # under a name that there is not
            self._dropped += len(data)
            if self._dropped > self.upload.max_bytes:
                raise self.upload.too_large()
        else:
            self._text += data
            if len(self._text) > MAX_BYTES:
                raise HttpProblem("part-too-large", 400)

    def _end(self) -> None:
        if self._names[-1] in PARTS:
            try:
                self.upload.set(self._names[-1], bytes(self._text))
            except (HttpProblem, AvatarError) as fault:
                self._later(fault)


@contextlib.asynccontextmanager
async def received(request: Request, settings: Settings, max_bytes: int) -> AsyncIterator[Upload]:
    """The upload of a request: multipart/form-data with the part ``image``, or a body that is the image.

    Its file is removed afterwards, unless it was moved elsewhere. HttpProblem: the request is not of that form or does
    not arrive in time. UsageError: a value beside the photo is not possible. TooManyBytes: the photo is larger.
    """
    header = request.headers.get("content-type", "")
    kind = header.partition(";")[0].strip().lower()
    form = kind == "multipart/form-data"
    upload = Upload(settings.incoming / f"{secrets.token_hex(16)}.part", max_bytes)
    length = request.headers.get("content-length", "")  # the server has refused what is no length
    most = MOST_TOGETHER * max_bytes if form else max_bytes
    if length.isdigit() and (len(length) > len(str(most)) + 9 or int(length) > most + _FRAME):
        raise upload.too_large_together() if form else upload.too_large()
    _take_parameters(request, upload, form=form)
    if not form and kind not in IMAGE_TYPES:
        raise HttpProblem("unsupported-media-type", 415, headers={"Accept": ", ".join(IMAGE_TYPES)})
    settings.incoming.mkdir(parents=True, exist_ok=True, mode=0o700)
    try:
        with upload.path.open("xb") as stream:
            await _pump(request, Multipart(upload, stream, header) if form else UploadBody(upload, stream), settings)
        yield upload
    finally:
        upload.path.unlink(missing_ok=True)


def _take_parameters(request: Request, upload: Upload, *, form: bool) -> None:
    """What the address says beside a photo that is the body; a form says it in parts."""
    named = {}
    for name, text in request.query_params.items():
        if form:
            words = f"a form has {name} as a part, an option in the part 'options'; not in its address"
            raise HttpProblem("invalid-parameter", 422, words, pointer=f"/query/{name}")
        if name in PARTS:
            upload.set(name, text.encode())
        else:
            named[name] = text
    if named:
        upload.options = checked_options({name: _from_text(text) for name, text in named.items()})


async def _pump(request: Request, body: UploadBody, settings: Settings) -> None:
    loop = asyncio.get_running_loop()
    begin, count, batch = loop.time(), 0, bytearray()
    try:
        async with asyncio.timeout(settings.idle_seconds) as limit:
            async for chunk in request.stream():
                count += len(chunk)
                slowest = begin + settings.idle_seconds + count / LEAST_SPEED
                limit.reschedule(min(slowest, loop.time() + settings.idle_seconds, begin + settings.body_seconds))
                batch += chunk
                if len(batch) >= _BATCH:
                    await run_in_threadpool(body.write, bytes(batch))
                    batch.clear()
    except TimeoutError:
        raise HttpProblem("request-timeout", 408, headers={"Connection": "close"}) from None
    except ClientDisconnect:
        raise HttpProblem("malformed-multipart", 400, "the connection closed before the body was complete") from None
    await run_in_threadpool(body.write, bytes(batch))
    await run_in_threadpool(body.finish)
