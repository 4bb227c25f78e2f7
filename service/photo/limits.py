"""What the decode gate accepts, how much it may spend on it, and reading no more than that from a file or a pipe."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from service.errors import (
    BadAspect,
    CorruptImage,
    TooManyBytes,
    TooManyPixels,
    TooSmallImage,
    UnreadableInput,
    UsageError,
)


@dataclass(frozen=True)
class Limits:
    """Bounds on one input image and on the process that decodes it.

    Attributes:
        max_bytes: largest file, in bytes.
        min_side: shortest side, in pixels. Below it no face could be fitted; whether the face in a larger photo
            is large enough is decided later, by the face detector.
        max_side: longest side, in pixels.
        max_pixels: width times height.
        max_aspect: longest side over shortest side.
        max_scans: scans of one JPEG. A decoder runs over the whole image once per scan, so a small file with
            hundreds of them costs many seconds.
        memory_bytes: address space of the decoding process.
        cpu_seconds: processor time of the decoding process, whole seconds.
        wall_seconds: time from its start to its last byte; many times the processor time, as a busy machine gives a
            process a small share of a processor, which is no fault of the photo.
    """

    max_bytes: int = 25_000_000
    min_side: int = 64
    max_side: int = 12_000
    max_pixels: int = 64_000_000
    max_aspect: float = 6.0
    max_scans: int = 100
    memory_bytes: int = 2 * 1024**3
    cpu_seconds: int = 10
    wall_seconds: float = 60.0


def check_size(width: int, height: int, limits: Limits) -> None:
    """Refuse an image by the size in pixels that its header states, before anything is decoded.

    CorruptImage: a side is zero or negative. BadAspect, TooSmallImage, TooManyPixels: it is beyond a bound.
    """
    facts = {"width": width, "height": height}
    if width <= 0 or height <= 0:
        raise CorruptImage(f"the header states a size of {width} x {height} pixels", **facts)
    short, long = sorted((width, height))
    if long > limits.max_aspect * short:
        raise BadAspect(
            f"the image is {width} x {height} pixels; the longer side may be at most "
            f"{limits.max_aspect:g} times the shorter",
            **facts,
        )
    if short < limits.min_side:
        raise TooSmallImage(
            f"the image is {width} x {height} pixels; each side must have at least {limits.min_side}", **facts
        )
    if long > limits.max_side or width * height > limits.max_pixels:
        raise TooManyPixels(
            f"the image is {width} x {height} pixels; at most {limits.max_side} a side "
            f"and {limits.max_pixels} in all are accepted",
            **facts,
        )


PIPE = "-"
"""Standard input or output in place of a path."""


def called(source: str) -> str:
    """Name of a source in messages."""
    return "standard input" if source == PIPE else source


def read_file(source: str, what: str = "photo", limit: int = Limits().max_bytes) -> bytes:
    """All bytes of a file, or of standard input for ``-``.

    UsageError: there is no such file, or it is a folder. UnreadableInput: the system refuses to read it. TooManyBytes:
    more than ``limit``; the rest is not read, since a pipe may be infinite.
    """
    name = called(source)
    try:
        if source == PIPE:
            data = sys.stdin.buffer.read(limit + 1)
        else:
            with Path(source).open("rb") as stream:
                data = stream.read(limit + 1)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise UsageError(f"there is no {what} {name}; name a file, or - for standard input", field=what) from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise UnreadableInput(f"cannot read {name}: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > limit:
        raise TooManyBytes(f"{name} has more than {limit} bytes, which is the most that a {what} may have", limit=limit)
    return data
