"""The messages between the gate and its decoding process: fixed binary layouts, no pickle, nothing to interpret.

Both sides import this module and it imports next to nothing, since the decoding process starts anew for each photo.
The gate trusts nothing that comes back: ``Reply.parse`` and the gate's own limits check every number.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

READY = b"R"
"""First byte of the decoding process: its interpreter and Pillow are there. Faults before it are not the photo's."""

_REQUEST = struct.Struct(">4sBBIIIIQIdQ")
_REPLY = struct.Struct(">4sBBIId64H")
_MAGIC = b"AVG3"

REPLY_SIZE = _REPLY.size

FOCAL_RANGE_MM = (8.0, 1200.0)
"""35 mm equivalents that exist as lenses; others, and the 0 that stands for unknown, are not believed."""


class Codec(IntEnum):
    """The formats that are decoded; an allow-list."""

    JPEG = 1
    PNG = 2
    WebP = 3
    HEIC = 4


class Status(IntEnum):
    """How decoding ended."""

    DONE = 0
    CORRUPT = 1
    TOO_COMPLEX = 2
    ANIMATED = 3
    BAD_SIZE = 4


class Note(IntFlag):
    """What was noticed while decoding; the gate turns these into warnings of the photo."""

    TRANSPARENT = 1
    ICC_IGNORED = 2
    EXTRA_IMAGES = 4
    FOCAL_IGNORED = 8


class Output(IntEnum):
    """What the pixels of a reply are."""

    PHOTO = 0
    """Upright sRGB over a grey ground, 3 bytes each."""
    CODES = 1
    """The values as they are stored, 3 bytes each: no turn, no profile, no gamma."""
    CODES_AND_ALPHA = 2
    """The same with the opacity, 255 where the file has none, 4 bytes each."""

    @property
    def channels(self) -> int:
        """Bytes of a pixel."""
        return 4 if self == Output.CODES_AND_ALPHA else 3


class Request(NamedTuple):
    """What to decode.

    Attributes:
        codec: the format.
        output: what to make of it.
        width, height: of the image as its header states it; 0 where only the decoder can tell.
        max_side, max_pixels: size limits.
        memory_bytes, cpu_seconds, wall_seconds: limits that the process sets itself.
        payload: the image file.
    """

    codec: Codec
    output: Output
    width: int
    height: int
    max_side: int
    max_pixels: int
    memory_bytes: int
    cpu_seconds: int
    wall_seconds: float
    payload: bytes

    def pack(self) -> bytes:
        """The header; the payload is to follow."""
        return _REQUEST.pack(_MAGIC, *self[:-1], len(self.payload))

    @classmethod
    def parse(cls, message: bytes) -> Request:
        """Read a whole message; ValueError where it is not one of ours or is cut off."""
        if len(message) < _REQUEST.size:
            raise ValueError("short request")
        magic, codec, output, *numbers, length = _REQUEST.unpack_from(message)
        if magic != _MAGIC or len(message) != _REQUEST.size + length:
            raise ValueError("not a request")
        values: list[Any] = [Codec(codec), Output(output), *numbers, message[_REQUEST.size :]]
        return cls(*values)


class Reply(NamedTuple):
    """How it went; the pixels follow where ``status`` is DONE.

    Attributes:
        status: how decoding ended.
        notes: what was noticed.
        width, height: of the upright image, in pixels; for BAD_SIZE the size that was refused; for ANIMATED
            ``width`` is the number of frames.
        focal_35mm: 35 mm equivalent focal length in mm within ``FOCAL_RANGE_MM``, or 0 where unknown.
        steps: 64 quantisation steps of a JPEG file's luma, row by row; zeros where unknown.
    """

    status: Status
    notes: Note = Note(0)
    width: int = 0
    height: int = 0
    focal_35mm: float = 0.0
    steps: tuple[int, ...] = (0,) * 64

    def pack(self) -> bytes:
        """The fixed-size message."""
        return _REPLY.pack(_MAGIC, *self[:-1], *self.steps)

    @classmethod
    def parse(cls, message: bytes) -> Reply:
        """Read a fixed-size message from the untrusted side; ValueError: it is no reply, or a value is out of range."""
        if len(message) != _REPLY.size:
            raise ValueError("short reply")
        magic, status, notes, width, height, focal, *steps = _REPLY.unpack(message)
        believed = focal == 0 or FOCAL_RANGE_MM[0] <= focal <= FOCAL_RANGE_MM[1]
        if magic != _MAGIC or not 0 <= notes <= 15 or not believed:
            raise ValueError("not a reply")
        return cls(Status(status), Note(notes), width, height, focal, tuple(steps))


def lower_limits(**limits: int) -> None:
    """Set limits of this process (``CPU`` for ``RLIMIT_CPU``), as far as they are not lower already."""
    import resource

    for name, value in limits.items():
        kind = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard),) * 2)
