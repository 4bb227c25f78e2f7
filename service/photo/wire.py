"""The messages between the gate and its decoding process: fixed binary layouts, no pickle, nothing to interpret.

Both sides import this module and it imports next to nothing, since the decoding process starts anew for each photo.
The gate trusts nothing that comes back: ``Reply.parse`` and the gate's own limits check every number.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

READY = b"R"
"""First byte of the decoding process: its interpreter and Pillow are there. Faults before it are not the photo's."""

_REQUEST = struct.Struct(">4sBdIIQIdBIIQ")
_REPLY = struct.Struct(">4sBBIId")
_MAGIC = b"AVG2"

REPLY_SIZE = _REPLY.size

FOCAL_RANGE_MM = (8.0, 1200.0)
"""35 mm equivalents that exist as lenses; others, and the 0 that stands for unknown, are not believed."""


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


class Request(NamedTuple):
    """What to decode.

    Attributes:
        codec: value of ``container.Codec``.
        gamma: exponent of the encoding, or 0 for sRGB.
        max_side, max_pixels: size limits, for formats whose size only the decoder can read.
        memory_bytes, cpu_seconds, wall_seconds: limits that the process sets itself.
        exif: TIFF-structured EXIF bytes, or empty.
        icc: colour profile, or empty.
        payload: the image file.
        alpha: give the image's opacity as grey in place of its colours; 255 where it has none.
    """

    codec: int
    gamma: float
    max_side: int
    max_pixels: int
    memory_bytes: int
    cpu_seconds: int
    wall_seconds: float
    exif: bytes
    icc: bytes
    payload: bytes
    alpha: bool = False

    def pack(self) -> bytes:
        """Header, EXIF and profile; the payload is to follow."""
        numbers = self[:7]
        lengths = len(self.exif), len(self.icc), len(self.payload)
        return _REQUEST.pack(_MAGIC, *numbers, self.alpha, *lengths) + self.exif + self.icc

    @classmethod
    def parse(cls, message: bytes) -> Request:
        """Read a whole message.

        Raises:
            ValueError: the message is not one of ours or is cut off.
        """
        if len(message) < _REQUEST.size:
            raise ValueError("short request")
        magic, codec, gamma, side, pixels, memory, cpu, wall, alpha, *lengths = _REQUEST.unpack_from(message)
        if magic != _MAGIC or len(message) != _REQUEST.size + sum(lengths):
            raise ValueError("not a request")
        icc_at, payload_at = _REQUEST.size + lengths[0], _REQUEST.size + lengths[0] + lengths[1]
        exif, icc, payload = message[_REQUEST.size : icc_at], message[icc_at:payload_at], message[payload_at:]
        return cls(codec, gamma, side, pixels, memory, cpu, wall, exif, icc, payload, bool(alpha))


class Reply(NamedTuple):
    """How it went; ``width * height * 3`` bytes of RGB follow where ``status`` is DONE.

    Attributes:
        status: how decoding ended.
        notes: what was noticed.
        width, height: of the upright image, in pixels; for BAD_SIZE the size that was refused; for ANIMATED
            ``width`` is the number of frames.
        focal_35mm: 35 mm equivalent focal length in mm within ``FOCAL_RANGE_MM``, or 0 where unknown.
    """

    status: Status
    notes: Note = Note(0)
    width: int = 0
    height: int = 0
    focal_35mm: float = 0.0

    def pack(self) -> bytes:
        """The fixed-size message."""
        return _REPLY.pack(_MAGIC, *self)

    @classmethod
    def parse(cls, message: bytes) -> Reply:
        """Read a fixed-size message from the untrusted side.

        Raises:
            ValueError: not a reply, or a value outside its range.
        """
        if len(message) != _REPLY.size:
            raise ValueError("short reply")
        magic, status, notes, width, height, focal = _REPLY.unpack(message)
        believed = focal == 0 or FOCAL_RANGE_MM[0] <= focal <= FOCAL_RANGE_MM[1]
        if magic != _MAGIC or not 0 <= notes <= 15 or not believed:
            raise ValueError("not a reply")
        return cls(Status(status), Note(notes), width, height, focal)
