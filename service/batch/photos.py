"""The photos of a folder, and where their archives go."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from service.errors import UsageError

SUFFIXES = frozenset({".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".webp", ".heic", ".heif"})
"""Files that count as photos. What they really are, their first bytes decide later."""


@dataclass(frozen=True)
class Photo:
    """One photo.

    Attributes:
        path: the file.
        name: its path below the folder, with ``/`` between folders; this is its name in the report.
        archive: path of its archive below the output folder.
    """

    path: Path
    name: str
    archive: str


def find_photos(folder: Path, out: Path) -> list[Photo]:
    """Photos of a folder and the folders in it, in the order of their names; hidden ones and ``out`` are left out.

    An archive has the name of its photo with ``.zip`` for the suffix; where two photos of a folder differ in the suffix
    only, it goes behind the suffix (``a.jpg.zip``, ``a.png.zip``).

    Raises:
        UsageError: there is no such folder, or no photo in it.
    """
    if not folder.is_dir():
        raise UsageError(f"there is no folder {folder}; name one with photos in it", field="folder")
    own = out.resolve()
    names: list[str] = []
    for place, folders, files in os.walk(folder):
        here = Path(place)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and (here / name).resolve() != own)
        below = here.relative_to(folder)
        names += [
            (below / name).as_posix()
            for name in files
            if not name.startswith(".") and Path(name).suffix.lower() in SUFFIXES and (here / name).is_file()
        ]
    if not names:
        raise UsageError(f"there is no photo in {folder}; they end with {', '.join(sorted(SUFFIXES))}", field="folder")
    archives = _archives(sorted(names))
    return [Photo(folder / name, name, archive) for name, archive in archives.items()]


def _archives(names: list[str]) -> dict[str, str]:
    """Names of photos -> those of their archives, all different in the eyes of a file system without case, too."""
    archives = {name: str(PurePosixPath(name).with_suffix(".zip")) for name in names}
    while True:
        uses = Counter(archive.casefold() for archive in archives.values())
        crowded = [name for name in names if uses[archives[name].casefold()] > 1 and archives[name] != f"{name}.zip"]
        if not crowded:
            return archives
        archives |= {name: f"{name}.zip" for name in crowded}
