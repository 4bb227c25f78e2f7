"""Input photo and output path of ``make``."""

from __future__ import annotations

from pathlib import Path

from service.cli.files import PIPE, called, check_paths, read_bounded
from service.errors import EmptyFile, TooManyBytes, UsageError
from service.photo.limits import Limits


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


def destination(source: str, output: str | None, *, as_json: bool) -> str:
    """Path of the archive, or ``-``: as given, else beside the photo, or standard output for a photo from a pipe.

    Raises:
        UsageError: the archive would overwrite the photo, share standard output with the JSON, or fill a terminal.
    """
    if output is None:
        output = PIPE if source == PIPE else str(Path(source).with_suffix(".zip"))
    check_paths(output, {"photo": source}, what="archive", example="OUT.zip", as_json=as_json)
    return output
