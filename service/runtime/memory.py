"""Memory that is given back when it is freed, with the C library of most Linux systems.

glibc keeps freed blocks of up to 32 MiB for later ones. The tensors of a network that takes a whole map are of about
that size and come and go by the dozen, and what is kept lies in pieces: measured, a body of zeta that needs 0.2 GB took
0.6 to 2.2 GB. Within :func:`prompt_release` larger blocks come from the system and go back to it at once. That costs
time for fresh pages, a second for zeta's body, so it is not for networks that run in many tiles; what those leave
behind goes back when they are done, by :func:`release`.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt(3)."""

SMALL, LARGE = 4 << 20, 32 << 20
"""Bytes from which on blocks go back at once: within :func:`prompt_release`, and afterwards, which is glibc's most."""


_NO_MEMORY = ("bad_alloc", "bad allocation", "Failed to allocate")
"""What onnxruntime and OpenVINO say, in exceptions of types that mean anything."""

_CV_NO_MEMORY = -4
"""Error::StsNoMem of OpenCV."""


@contextmanager
def prompt_release() -> Iterator[None]:
    """Give freed blocks of more than ``SMALL`` bytes back at once; other C libraries are left as they are."""
    libc = _glibc()
    if libc is None:
        yield
        return
    libc.mallopt(_MMAP_THRESHOLD, SMALL)
    try:
        yield
    finally:
        # A threshold that was set once no longer adapts, nor does the other: both go to what they adapt to.
        libc.mallopt(_MMAP_THRESHOLD, LARGE)
        libc.mallopt(_TRIM_THRESHOLD, 2 * LARGE)
        release()


def release() -> None:
    """Give what was freed and kept for later back to the system; other C libraries are left as they are."""
    libc = _glibc()
    if libc is not None:
        libc.malloc_trim(0)


def lacked_memory(error: BaseException) -> bool:
    """Whether a library's exception says that it got no memory: only Python and numpy have a type for that."""
    insufficient = type(error).__module__ == "cv2" and getattr(error, "code", 0) == _CV_NO_MEMORY
    return isinstance(error, MemoryError) or insufficient or any(words in str(error) for words in _NO_MEMORY)


@lru_cache(maxsize=1)
def _glibc() -> Any:
    """The C library where it is glibc, else None."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") and hasattr(library, "mallopt") else None
