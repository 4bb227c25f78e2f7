"""The decoding process: one photo in on standard input, raw pixels out on standard output, then it ends.

Before it looks at the photo it limits what it may spend and gives up opening files, so whoever takes over a native
decoder finds a process that can neither open nor write a file nor load a program. Errors go back as
numbers, never as text of a library.
"""

from __future__ import annotations

import math
import signal
import sys
from typing import BinaryIO

from service.photo import codec
from service.photo.wire import READY, Reply, Request, Status

_STRIP_ROWS = 256


def main() -> int:
    """Decode one photo; returns the exit status of the process."""
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    request = Request.parse(sys.stdin.buffer.read())
    _limit_spending(request)
    open_image = codec.prepare(request.codec, colour=bool(request.icc or request.gamma), exif=bool(request.exif))
    _give_up_files()
    answer(request, open_image, sys.stdout.buffer)
    return 0


def answer(request: Request, open_image: codec.Opener, out: BinaryIO) -> None:
    """Decode and write the reply, with the pixels in row order, 3 bytes each."""
    try:
        decoded = codec.decode(
            open_image,
            request.payload,
            request.icc,
            request.gamma,
            request.exif,
            request.max_side,
            request.max_pixels,
            request.alpha,
        )
    except codec.BadSize as fault:
        out.write(Reply(Status.BAD_SIZE, width=fault.args[0], height=fault.args[1]).pack())
    except codec.Animated as fault:
        out.write(Reply(Status.ANIMATED, width=fault.args[0]).pack())
    except codec.DecoderFault:
        out.write(Reply(Status.CORRUPT).pack())
    except MemoryError:
        out.write(Reply(Status.TOO_COMPLEX).pack())
    else:
        _write_pixels(decoded, out)
    out.flush()


def _write_pixels(decoded: codec.Decoded, out: BinaryIO) -> None:
    image = decoded.image
    out.write(Reply(Status.DONE, decoded.notes, image.width, image.height, decoded.focal_35mm).pack())
    for top in range(0, image.height, _STRIP_ROWS):
        bottom = min(top + _STRIP_ROWS, image.height)
        out.write(image.crop((0, top, image.width, bottom)).tobytes())


def _limit_spending(request: Request) -> None:
    """Memory, processor time and an own alarm clock, in case that nobody is left to kill this process."""
    if sys.platform == "win32":
        return
    import resource

    signal.alarm(math.ceil(request.wall_seconds) + 1)
    _lower(resource.RLIMIT_CPU, request.cpu_seconds)
    _lower(resource.RLIMIT_CORE, 0)
    if sys.platform == "linux":
        _lower(resource.RLIMIT_AS, request.memory_bytes)


def _give_up_files() -> None:
    """No new descriptor, no byte written to a file, no program loaded."""
    if sys.platform != "linux":
        return
    import resource

    # A descriptor limit below the next free number refuses open, socket and pipe, and with them the loader of any
    # program that would be started.
    _lower(resource.RLIMIT_NOFILE, 0)
    _lower(resource.RLIMIT_FSIZE, 0)
    _lower(resource.RLIMIT_NPROC, 0)


if sys.platform != "win32":

    def _lower(kind: int, value: int) -> None:
        import resource

        hard = resource.getrlimit(kind)[1]
        if hard != resource.RLIM_INFINITY:
            value = min(value, hard)
        resource.setrlimit(kind, (value, value))
