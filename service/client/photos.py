"""A photo and its options as they are handed in, and the key that makes the same of both one job."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.errors import UsageError

_BLOCK = 1 << 20


def canonical(options: Mapping[str, Any]) -> str:
    """Options as JSON text, the same for the same options.

    Raises:
        UsageError: a value is none of JSON's.
    """
    try:
        return json.dumps(options, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise UsageError(f"options are no JSON: {error}", field="options") from error


def photo_sha256(photo: Path | bytes) -> str:
    """Hex sha256 of a photo, read in blocks.

    Raises:
        UsageError: there is no such file.
    """
    digest = hashlib.sha256()
    with opened(photo) as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def idempotency_key(photo_digest: str, options: str, *more: str | int) -> str:
    """A key for one photo and its options.

    Args:
        photo_digest: of :func:`photo_sha256`.
        options: of :func:`canonical`.
        more: whatever else makes a job another job, for example the number of an attempt.
    """
    return hashlib.sha256(json.dumps([photo_digest, options, *more]).encode()).hexdigest()


def opened(photo: Path | bytes) -> contextlib.AbstractContextManager[io.BufferedIOBase]:
    """A photo to be read.

    Raises:
        UsageError: there is no such file.
    """
    if isinstance(photo, bytes):
        return io.BytesIO(photo)
    try:
        return photo.open("rb")
    except OSError as error:
        raise UsageError(f"cannot read {photo}: {error.strerror}", field="photo") from error
