"""Reading one bounded file, or standard input."""

from __future__ import annotations

import sys
from pathlib import Path

from service.cli.source import PIPE
from service.errors import TooManyBytes, UnreadableInput, UsageError


def read_file(source: str, limit: int, what: str) -> bytes:
    """All bytes of a file, or of standard input for ``-``, at most ``limit``.

    Raises:
        UsageError: there is no such file.
        UnreadableInput: the system refuses to read it.
        TooManyBytes: it has more; the rest is not read.
    """
    name = "standard input" if source == PIPE else source
    try:
        if source == PIPE:
            data = sys.stdin.buffer.read(limit + 1)
        else:
            with Path(source).open("rb") as stream:
                data = stream.read(limit + 1)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise UsageError(f"there is no {what} file {name}", field=what) from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise UnreadableInput(f"cannot read {name}: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > limit:
        raise TooManyBytes(f"{name} has more than {limit} bytes, which is the most that a {what} may have", limit=limit)
    return data
