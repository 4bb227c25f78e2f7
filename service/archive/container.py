"""Deterministic zip archives, written atomically.

Members are stored, not deflated (they are compressed already), in the order of ``MEMBER_NAMES``, dated 1980-01-01,
mode 0644. Names come from that list, or are ``PART_TEXTURE``, so no input can cause a path traversal at extraction.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, BinaryIO

from service.errors import OutputFault
from service.map_registry import MAPS

MEMBER_NAMES = (
    "manifest.json",
    "LICENSES.md",
    *(f"maps/{one.name}.png" for one in MAPS),
    "mesh/head.obj",
    "mesh/parts.obj",
    "mesh/head.mtl",
    "mesh/specular_normal.exr",
    "mesh/specular_albedo.exr",
    "mesh/roughness.exr",
    "mesh/head.glb",
    "mesh/head.usda",
    "mesh/head.mtlx",
    "mesh/head_fine.obj",
    "preview/overlay.jpg",
    "preview/sheet.jpg",
)
"""Every name that an archive may contain, in the order of the file; textures of parts follow the maps."""

PART_TEXTURE = re.compile(r"maps/parts/[A-Za-z][A-Za-z0-9_]{0,39}\.(png|exr)")
"""Name of a texture of a part's own."""


def unknown_names(names: Iterable[str]) -> list[str]:
    """Those that no archive contains, sorted."""
    return sorted(name for name in set(names) - set(MEMBER_NAMES) if not PART_TEXTURE.fullmatch(name))


def in_order(names: Iterable[str]) -> list[str]:
    """Names of members in the order of the file.

    Raises:
        ValueError: one is not a name of the archive.
    """
    present = set(names)
    unknown = unknown_names(present)
    if unknown:
        raise ValueError(f"not a name of the archive: {', '.join(unknown)}")
    own = sorted(present - set(MEMBER_NAMES))
    listed = [name for name in MEMBER_NAMES if name in present]
    after = sum(not name.startswith(("mesh/", "preview/")) for name in listed)
    return [*listed[:after], *own, *listed[after:]]

_DATE = (1980, 1, 1, 0, 0, 0)
_UNIX = 3
"""Code of the system that the file modes are for (zip specification, 4.4.2)."""
_IN_MEMORY = 64 << 20
"""Bytes of an archive assembled in memory; larger ones go to a temporary file."""


def write_zip(stream: IO[bytes], members: Mapping[str, bytes]) -> None:
    """Write ``members`` (name -> content) as a zip to a seekable binary stream.

    Raises:
        ValueError: a name is not the archive's (a bug: names do not depend on input).
        OSError: as the stream raises it.
    """
    order = in_order(members)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name in order:
            archive.writestr(_entry(name), members[name])


def write_folder(path: Path, folder: Path, files: Iterable[Path]) -> None:
    """Write files of a folder as a zip, in the order of their names in it: the same files give the same bytes.

    Args:
        path: of the zip, replaced atomically.
        folder: to whose paths the names of the members are relative.
        files: in the folder, or below.

    Raises:
        OutputFault: a file could not be read, or the zip not written.
    """

    def write(stream: IO[bytes]) -> None:
        named = sorted((file.relative_to(folder).as_posix(), file) for file in files)
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, file in named:
                entry = _entry(name)
                entry.file_size = file.stat().st_size
                with file.open("rb") as source, archive.open(entry, "w") as member:
                    shutil.copyfileobj(source, member, 1 << 20)

    replace_file(path, write)


def write_file(path: Path, members: Mapping[str, bytes]) -> None:
    """Write the zip to ``path`` atomically; an existing file is replaced only by a complete one.

    The content goes to a hidden temporary file in the same folder, is flushed to the disk, and is then renamed.

    Raises:
        OutputFault: with the path and the system's reason (no space, no permission, no such folder).
    """
    replace_file(path, lambda stream: write_zip(stream, members))


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let ``write`` fill a new file that atomically replaces ``path``; raises as :func:`write_file`."""
    try:
        if path.exists() and not path.is_file():
            raise OutputFault(f"cannot write {path}: it is not a regular file", path=str(path))
        target = path.resolve()  # a symbolic link is kept, its target replaced
        with _temporary(target) as temporary:
            with temporary.open("r+b") as stream:
                write(stream)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        raise OutputFault(f"cannot write {path}: {_reason(error)}", path=str(path)) from error


def write_stream(stream: BinaryIO, members: Mapping[str, bytes]) -> None:
    """Write the same bytes as :func:`write_file` to a stream that cannot seek (standard output, a socket).

    The zip is assembled first, because a zip written without seeking has other headers.

    Raises:
        OutputFault: the reader closed the stream, or it failed.
    """
    try:
        with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as assembled:
            write_zip(assembled, members)
            assembled.seek(0)
            shutil.copyfileobj(assembled, stream, 1 << 20)
        stream.flush()
    except BrokenPipeError as error:
        raise OutputFault("the reader of the output closed it before the archive was complete") from error
    except OSError as error:
        raise OutputFault(f"cannot write the output stream: {_reason(error)}") from error


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _DATE)
    entry.compress_type = zipfile.ZIP_STORED
    entry.create_system = _UNIX
    entry.external_attr = (stat.S_IFREG | 0o644) << 16
    return entry


@contextlib.contextmanager
def _temporary(target: Path) -> Iterator[Path]:
    """A new empty file beside ``target``, deleted afterwards unless it was renamed; its mode is set by the umask."""
    temporary = target.with_name(f".{target.name[:64]}.{secrets.token_hex(4)}.part")
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make the rename durable, where the file system can sync a folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error) or type(error).__name__).lower()
