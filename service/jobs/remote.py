"""What a remote store needs that a disk does not: its faults as one exception, and patience that has an end."""

from __future__ import annotations

import contextlib
import errno
import io
import os
from collections.abc import Iterator
from typing import Any

BLOCK = 4 << 20
"""Bytes that are asked of a remote store at a time; its own default may be ten times as many for each reader."""

S3 = {
    "config_kwargs": {
        "connect_timeout": 5, "read_timeout": 30, "retries": {"max_attempts": 2},
        "signature_version": "s3v4",  # of signed addresses too, which are of version 2 else, and few stores take that
    }
}  # fmt: skip
"""A store that does not answer shall not hold a request for minutes; whoever can wait tries again."""


class StoreFault(OSError):
    """A remote store cannot be reached, or refuses; what each library raises for it is something else."""


@contextlib.contextmanager
def translated(*, missing: bool = True) -> Iterator[None]:
    """Whatever a library raises for a store leaves as :class:`StoreFault`.

    Args:
        missing: what is not there is no fault, and leaves as FileNotFoundError.
    """
    try:
        yield
    except Exception as error:
        if missing and isinstance(error, FileNotFoundError):
            raise
        raise StoreFault(errno.EIO, f"the store of files fails: {type(error).__name__}: {error}") from error


class Stream(io.BufferedIOBase):
    """A file of a remote store, with its faults as :class:`StoreFault`."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self._file = file

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def read(self, size: int | None = -1, /) -> bytes:
        """So many bytes, or the rest."""
        with translated(missing=False):
            return bytes(self._file.read(-1 if size is None else size))

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """As of any file."""
        with translated(missing=False):
            return int(self._file.seek(offset, whence))

    def tell(self) -> int:
        """As of any file."""
        return int(self._file.tell())

    def close(self) -> None:
        """As of any file."""
        self._file.close()
        super().close()
