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

_REQUEST = struct.Struct(">4sBBdIIQIdIQ")
_REPLY = struct.Struct(">4sBBIId")
_MAGIC = b"AVG1"

REPLY_SIZE = _REPLY.size


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
        orientation: EXIF turn to undo, 1 to 8.
        gamma: exponent of the encoding, or 0 for sRGB.
        max_side, max_pixels: size limits, for formats whose size only the decoder can read.
        memory_bytes, cpu_seconds, wall_seconds: limits that the process sets itself.
        icc: colour profile, or empty.
        payload: the image file.
    """

    codec: int
    orientation: int
    gamma: float
    max_side: int
    max_pixels: int
    memory_bytes: int
    cpu_seconds: int
    wall_seconds: float
    icc: bytes
    payload: bytes

    def pack(self) -> bytes:
        """Header and profile; the payload is to follow."""
        numbers = self[:8]
        return _REQUEST.pack(_MAGIC, *numbers, len(self.icc), len(self.payload)) + self.icc

    @classmethod
    def parse(cls, message: bytes) -> Request:
        """Read a whole message.

        Raises:
            ValueError: the message is not one of ours or is cut off.
        """
        if len(message) < _REQUEST.size:
            raise ValueError("short request")
        magic, *numbers = _REQUEST.unpack_from(message)
        icc_length, length = numbers[-2:]
        start = _REQUEST.size + icc_length
        if magic != _MAGIC or len(message) != start + length:
            raise ValueError("not a request")
        codec, orientation, gamma, side, pixels, memory, cpu, wall, _, _ = numbers
        icc, payload = message[_REQUEST.size : start], message[start:]
        return cls(codec, orientation, gamma, side, pixels, memory, cpu, wall, icc, payload)


class Reply(NamedTuple):
    """How it went; ``width * height * 3`` bytes of RGB follow where ``status`` is DONE.

    Attributes:
        status: how decoding ended.
        notes: what was noticed.
        width, height: of the upright image, in pixels; for BAD_SIZE the size that was refused; for ANIMATED
            ``width`` is the number of frames.
        focal_35mm: for HEIC the 35 mm equivalent focal length in mm, or 0.
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
        if magic != _MAGIC or not 0 <= notes <= 15 or not 0 <= focal < 1e6:
            raise ValueError("not a reply")
        return cls(Status(status), Note(notes), width, height, focal)
