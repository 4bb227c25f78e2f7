"""Reading one bounded file, or standard input."""

from __future__ import annotations

import sys
from pathlib import Path

from service.errors import TooManyBytes, UnreadableInput, UsageError

PIPE = "-"
"""Standard input or output in place of a path."""


def called(source: str) -> str:
    """What messages call a source."""
    return "standard input" if source == PIPE else source


def read_bounded(source: str, limit: int) -> bytes:
    """At most ``limit + 1`` bytes of a file, or of standard input for ``-``, which may be endless.

    Raises:
        FileNotFoundError, NotADirectoryError, IsADirectoryError: there is no such file.
        UnreadableInput: the system refuses to read it.
    """
    try:
        if source == PIPE:
            return sys.stdin.buffer.read(limit + 1)
        with Path(source).open("rb") as stream:
            return stream.read(limit + 1)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise UnreadableInput(f"cannot read {called(source)}: {reason}") from error


def read_file(source: str, limit: int, what: str) -> bytes:
    """All bytes of a file, or of standard input for ``-``, at most ``limit``.

    Raises:
        UsageError: there is no such file.
        UnreadableInput: the system refuses to read it.
        TooManyBytes: it has more; the rest is not read.
    """
    name = called(source)
    try:
        data = read_bounded(source, limit)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise UsageError(f"there is no {what} file {name}", field=what) from error
    if len(data) > limit:
        raise TooManyBytes(f"{name} has more than {limit} bytes, which is the most that a {what} may have", limit=limit)
    return data
