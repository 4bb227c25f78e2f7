"""The bytes of a photo: of a file, or of standard input, never more than the gate takes."""

from __future__ import annotations

import sys
from pathlib import Path

from service.errors import EmptyFile, TooManyBytes, UnreadableInput, UsageError
from service.photo.limits import Limits

PIPE = "-"
"""Standard input or output in place of a path."""


def called(source: str) -> str:
    """Name of a source in messages."""
    return "standard input" if source == PIPE else source


def read_bounded(source: str, limit: int) -> bytes:
    """At most ``limit + 1`` bytes of a file, or of standard input for ``-``, which may be infinite.

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


def read_photo(source: str) -> bytes:
    """All bytes of a file, or of standard input for ``-``.

    Raises:
        UsageError: there is no such file, or it is a folder.
        UnreadableInput: the system refuses to read it.
        EmptyFile: zero bytes.
        TooManyBytes: more than the decode gate accepts; the rest is not read, since a pipe may be infinite.
    """
    limit = Limits().max_bytes
    name = called(source)
    try:
        data = read_bounded(source, limit)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise UsageError(f"there is no file {name}; name a JPEG, PNG or WebP file, or - for standard input") from error
    except IsADirectoryError as error:
        raise UsageError(f"{name} is a folder; name one photo in it") from error
    if not data:
        raise EmptyFile(f"{name} is empty (0 bytes); a JPEG, PNG or WebP photo is needed")
    if len(data) > limit:
        raise TooManyBytes(f"{name} has more than {limit} bytes, which is the most that is accepted", limit=limit)
    return data
