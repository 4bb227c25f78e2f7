"""Photos of one person taken together: a place whose files are groups of those of another."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterator
from pathlib import PurePosixPath
from typing import IO

from service.batch.plan import SUFFIXES
from service.errors import UsageError
from service.photo.bundle import MOST, bundled
from service.places import Entry, Place, place

GROUPS = ("folder", "prefix")
"""How photos of one person are told: they lie in one folder, or their names have the same beginning before the last
``-`` or ``_``."""
GROUP = ".photos"
"""End of the name of a group, which gives way to that of its archive."""


def grouped(address: str, by: str | None) -> str:
    """The address of a place whose photos are taken together by person; itself where ``by`` is None."""
    return address if by is None else f"by-{by}:{address}"


def photos_at(address: str) -> Place:
    """The place of an address, in groups where it is one of :func:`grouped`.

    Raises:
        UsageError: as :func:`service.places.place`.
    """
    for by in GROUPS:
        if address.startswith(f"by-{by}:"):
            return Grouped(place(address.partition(":")[2]), by)
    return place(address)


class Grouped(Place):
    """Photos of another place, all of one person as one file (``service.photo.bundle``); it is only read.

    A group is called like its folder, or its beginning; a photo that lies in no folder is one by itself.
    """

    def __init__(self, inner: Place, by: str) -> None:
        self._inner, self._by = inner, by
        self.address, self.folder = grouped(inner.address, by), None
        self._groups: dict[str, list[Entry]] = {}

    @property
    def missing(self) -> bool:
        """Whether the photos should lie in a folder of this machine that is not there."""
        return self._inner.folder is not None and not self._inner.folder.is_dir()

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """See ``Place``; the suffixes are those of the photos."""
        self._groups = {}
        for entry in self._inner.entries(suffixes, leave_out):
            self._groups.setdefault(self._group(PurePosixPath(entry.name)), []).append(entry)
        for name, members in self._groups.items():
            yield Entry(name, max(entry.modified for entry in members))

    def _group(self, name: PurePosixPath) -> str:
        if self._by == "folder":
            return f"{name.parent}{GROUP}" if name.parent.parts else f"{name.stem}{GROUP}"
        stem = re.sub(r"[-_][^-_]*$", "", name.stem)
        return str(name.with_name((stem or name.stem) + GROUP))

    def open(self, name: str) -> IO[bytes]:
        """See ``Place``.

        Raises:
            UsageError: the group has more photos than are taken of one person.
        """
        if name not in self._groups:
            list(self.entries(SUFFIXES))
        members = sorted(entry.name for entry in self._groups.get(name, ()))
        if not members:
            raise FileNotFoundError(name)
        if len(members) > MOST:
            raise UsageError(f"{name.removesuffix(GROUP)} has {len(members)} photos; at most {MOST} of one person")
        return io.BytesIO(bundled([self._inner.read(one) for one in members]))

    def modified(self, name: str) -> float | None:
        """See ``Place``."""
        return max((entry.modified for entry in self._groups.get(name, ())), default=None)
