"""The files of an archive in a folder, and what its manifest says."""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.archive.container import unknown_names
from service.errors import BadArchive, OutputFault, UsageError

MOST_BYTES = 2 << 30
"""Unpacked size of an archive that is accepted."""


@dataclass(frozen=True)
class Source:
    """An archive whose names and manifest were checked.

    Attributes:
        path: of the archive.
        names: of its members.
        manifest: as stored.
    """

    path: Path
    names: tuple[str, ...]
    manifest: dict[str, Any]

    @classmethod
    def open(cls, path: Path) -> Source:
        """Check an archive.

        Raises:
            UsageError: there is no such file.
            BadArchive: not an archive of this program, or of a version without materials and joints.
        """
        if not path.is_file():
            raise UsageError(f"there is no archive {path}; make one with avatarme make PHOTO")
        try:
            with zipfile.ZipFile(path) as archive:
                entries = archive.infolist()
                names = tuple(entry.filename for entry in entries)
                odd = unknown_names(names)
                if odd or len(set(names)) != len(names):
                    raise BadArchive(f"the zip contains {(odd or ['a name twice'])[0][:60]!r}; it is not of avatarme")
                if sum(entry.file_size for entry in entries) > MOST_BYTES:
                    raise BadArchive(f"the archive unpacks to more than {MOST_BYTES} bytes, which is the most accepted")
                manifest = json.loads(archive.read("manifest.json"))
        except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, NotImplementedError, OSError) as error:
            raise BadArchive(f"the archive cannot be read: {error}") from error
        needed = ("materials", "joints", "parts", "head")
        if not isinstance(manifest, dict) or any(name not in manifest for name in needed):
            raise BadArchive("the manifest has no materials and joints: made by an older version; make it anew")
        return cls(path, names, manifest)

    def read(self, name: str) -> bytes:
        """Content of a member; BadArchive where it is not there or damaged."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.read(name)
        except (zipfile.BadZipFile, zlib.error, KeyError, OSError) as error:
            raise BadArchive(f"{name} of the archive cannot be read: {error}") from error

    def unpack(self, folder: Path, prefixes: tuple[str, ...]) -> list[Path]:
        """Write the members under some prefixes into a folder, under their names.

        Raises:
            BadArchive: a member is damaged.
            OutputFault: a file could not be written.
        """
        written = []
        for name in self.names:
            if name.startswith(prefixes):
                target = folder / name
                write(target, self.read(name))
                written.append(target)
        return written


def write(path: Path, data: bytes) -> None:
    """Write a file, and the folders that it needs; OutputFault where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise OutputFault(f"cannot write {path}: {error.strerror or error}", path=str(path)) from error
