"""Atomic writing of one output file."""

from __future__ import annotations

import sys
from pathlib import Path

from service.archive.container import replace_file
from service.errors import OutputFault
from service.photo.source import PIPE


def write_bytes(target: str, data: bytes) -> None:
    """Write to a path, or to standard output for ``-``.

    Raises:
        OutputFault: it cannot be written; an existing file is unchanged.
    """
    if target != PIPE:
        replace_file(Path(target), lambda stream: stream.write(data))
        return
    try:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    except BrokenPipeError as error:
        raise OutputFault("the reader of the output closed it before it was complete") from error
