"""Byte ranges of RFC 9110: one range, ``If-Range``, ``If-None-Match``."""

from __future__ import annotations

import re
from collections.abc import Mapping

from service.api.problems import ProblemError

_ONE = re.compile(r"bytes=\s*(\d{0,18})-(\d{0,18})\s*\Z", re.IGNORECASE)


def wanted_range(headers: Mapping[str, str], size: int, etag: str) -> tuple[int, int] | None:
    """First byte and number of bytes that a request asks for; None for the whole file.

    Args:
        headers: of the request, names in lower case.
        size: bytes of the file.
        etag: of the file; a range under another ``If-Range`` is not one any more.

    Raises:
        ProblemError: 416, there is no such range, or there are several of them.
    """
    text = headers.get("range")
    if text is None or not text.lower().startswith("bytes=") or headers.get("if-range", etag) != etag:
        return None
    match = _ONE.match(text)
    if match is None or match[1] == match[2] == "":
        raise _unsatisfiable(size)
    if match[1] == "":
        first, last = max(size - int(match[2]), 0), size - 1
    else:
        first, last = int(match[1]), min(int(match[2] or size - 1), size - 1)
    if first > last or first >= size:
        raise _unsatisfiable(size)
    return first, last - first + 1


def not_modified(headers: Mapping[str, str], etag: str) -> bool:
    """Whether the caller has this content already."""
    known = headers.get("if-none-match")
    return known is not None and (
        known.strip() == "*" or etag in [part.strip().removeprefix("W/") for part in known.split(",")]
    )


def _unsatisfiable(size: int) -> ProblemError:
    return ProblemError("range-not-satisfiable", 416, headers={"Content-Range": f"bytes */{size}"})
