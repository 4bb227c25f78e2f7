"""The body of a request with a photo, taken apart as it comes."""

from __future__ import annotations

import hashlib
from typing import IO, Any

from service.api.options import MAX_BYTES as MAX_OPTIONS
from service.api.problems import ProblemError
from service.api.upload import PARTS, Upload
from service.errors import TooManyBytes

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
