"""Several image files of one person as one file: one after the other, then where each ends.

::

    file | file | ... | 8 bytes length of each file | 4 bytes number of files | 8 bytes of mark

One file alone is itself. What reads images stops at the end of the first one.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

MARK = b"\x00AVPH\x001\n"
_COUNT = struct.Struct(">I8s")
MOST = 24
"""Files of one bundle."""


def index_of(sizes: Sequence[int]) -> bytes:
    """What comes behind files of these sizes, nothing behind one alone."""
    if len(sizes) == 1:
        return b""
    return struct.pack(f">{len(sizes)}Q", *sizes) + _COUNT.pack(len(sizes), MARK)


def bundled(files: Sequence[bytes]) -> bytes:
    """Files as one."""
    return b"".join(files) + index_of([len(one) for one in files])


def unbundled(data: bytes) -> list[bytes]:
    """The files in a bundle; what is none, or has an index that cannot be right, is one file."""
    if len(data) < _COUNT.size or data[-len(MARK) :] != MARK:
        return [data]
    count, _ = _COUNT.unpack(data[-_COUNT.size :])
    end = len(data) - _COUNT.size - 8 * count
    if not 2 <= count <= MOST or end < 0:
        return [data]
    sizes = struct.unpack_from(f">{count}Q", data, end)
    if sum(sizes) != end:
        return [data]
    files, at = [], 0
    for size in sizes:
        files.append(data[at : at + size])
        at += size
    return files
