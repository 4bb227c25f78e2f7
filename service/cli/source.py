"""Output path of ``make``."""

from __future__ import annotations

from pathlib import Path

from service.cli.files import check_paths
from service.photo.source import PIPE


def destination(source: str, output: str | None, *, as_json: bool) -> str:
    """Path of the archive, or ``-``: as given, else beside the photo, or standard output for a photo from a pipe.

    Raises:
        UsageError: the archive would overwrite the photo, share standard output with the JSON, or fill a terminal.
    """
    if output is None:
        output = PIPE if source == PIPE else str(Path(source).with_suffix(".zip"))
    check_paths(output, {"photo": source}, what="archive", example="OUT.zip", as_json=as_json)
    return output
