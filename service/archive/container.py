"""Deterministic zip archives, written atomically, and untrusted ones, read within bounds.

Members are stored, not deflated (they are compressed already), in the order of ``MEMBERS``, dated 1980-01-01,
mode 0644. Names come from that list, or are ``PART_TEXTURE``, so no input can cause a path traversal at extraction.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

from service.errors import BadArchive, OutputFault, UsageError
from service.map_registry import MAPS
from service.places import sync

MEMBERS = {
    "manifest.json": "",
    "LICENSES.md": "licences",
    **{f"maps/{one.name}.png": one.name for one in MAPS},
    "mesh/head.obj": "mesh, photo's expression",
    "mesh/parts.obj": "hair, bust, lashes, finer eyes and teeth, photo's expression",
    "mesh/head.mtl": "materials of head.obj",
    "mesh/specular_normal.exr": "normals for head.mtl",
    "mesh/specular_albedo.exr": "specular level for head.mtl",
    "mesh/roughness.exr": "roughness for head.mtl",
    "mesh/head.glb": "mesh, neutral with blendshapes",
    "mesh/head.usda": "mesh, neutral with blendshapes and skeleton, weights of the photo's expression",
    "mesh/head.mtlx": "materials as MaterialX",
    "mesh/hair.usda": "strands of hair as curves, at rest",
    "mesh/beard.usda": "strands of the beard as curves, at rest",
    "mesh/head_fine.obj": "mesh, photo's expression, subdivided and displaced",
    "preview/overlay.jpg": "preview of the fit",
    "preview/sheet.jpg": "preview of the result",
}
"""Every name that an archive may contain, in the order of the file, and its role where that is not its stem; textures
of parts follow the maps."""

MEDIA_TYPES = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "obj": "model/obj",
    "mtl": "model/mtl",
    "glb": "model/gltf-binary",
    "usda": "model/vnd.usda",
    "mtlx": "model/mtlx+xml",
    "exr": "image/x-exr",
    "md": "text/markdown",
    "json": "application/json",
}
"""Media type by file name extension."""

PART_TEXTURE = re.compile(r"maps/parts/[A-Za-z][A-Za-z0-9_]{0,39}\.(png|exr)")
"""Name of a texture of a part's own."""


def unknown_names(names: Iterable[str]) -> list[str]:
    """Those that no archive contains, sorted."""
    return sorted(name for name in set(names) - MEMBERS.keys() if not PART_TEXTURE.fullmatch(name))


def in_order(names: Iterable[str]) -> list[str]:
    """Names of members in the order of the file; ValueError where one is not a name of the archive."""
    present = set(names)
    unknown = unknown_names(present)
    if unknown:
        raise ValueError(f"not a name of the archive: {', '.join(unknown)}")
    own = sorted(present - MEMBERS.keys())
    listed = [name for name in MEMBERS if name in present]
    after = sum(not name.startswith(("mesh/", "preview/")) for name in listed)
    return [*listed[:after], *own, *listed[after:]]


_DATE = (1980, 1, 1, 0, 0, 0)


def write_zip(stream: IO[bytes], members: Mapping[str, bytes]) -> None:
    """Write ``members`` (name -> content) as a zip to a seekable binary stream.

    ValueError: a name is not the archive's (a bug: names do not depend on input). OSError: as the stream raises it.
    """
    order = in_order(members)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name in order:
            archive.writestr(_entry(name), members[name])


def write_folder(path: Path, folder: Path, files: Iterable[Path]) -> None:
    """Write files of a folder as a zip, in the order of their names in it: the same files give the same bytes.

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
    OutputFault has the path and the system's reason (no space, no permission, no such folder).
    """
    replace_file(path, lambda stream: write_zip(stream, members))


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let ``write`` fill a new file that atomically replaces ``path``; raises as :func:`write_file`."""
    with file_beside(path) as (target, temporary):
        with temporary.open("r+b") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
        sync(target.parent)


def write_stream(stream: BinaryIO, members: Mapping[str, bytes]) -> None:
    """Write the same bytes as :func:`write_file` to a stream that cannot seek (standard output, a socket).

    The zip is assembled first, because a zip written without seeking has other headers. OutputFault: the reader closed
    the stream, or it failed.
    """
    try:
        with tempfile.SpooledTemporaryFile(max_size=64 << 20) as assembled:
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
    entry.create_system = 3  # Unix, whose file modes follow (zip specification, 4.4.2)
    entry.external_attr = (stat.S_IFREG | 0o644) << 16
    return entry


@contextlib.contextmanager
def file_beside(path: Path) -> Iterator[tuple[Path, Path]]:
    """Where ``path`` leads, and a new empty file beside that, deleted afterwards unless it was renamed.

    Its mode is set by the umask. What of it fails, and of what is done with it, is an OutputFault.
    """
    try:
        if path.exists() and not path.is_file():
            raise OutputFault(f"cannot write {path}: it is not a regular file", path=str(path))
        target = path.resolve()  # a symbolic link is kept, its target replaced
        temporary = target.with_name(f".{target.name[:64]}.{secrets.token_hex(4)}.part")
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        try:
            yield target, temporary
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise OutputFault(f"cannot write {path}: {_reason(error)}", path=str(path)) from error


def _reason(error: OSError) -> str:
    return (error.strerror or str(error) or type(error).__name__).lower()


MAX_MEMBER = 512 << 20
"""Bytes of one file of an archive; a noisy 16-bit map of 6144 x 4096 has 150 MB."""


@dataclass(frozen=True)
class ArchiveFile:
    """An untrusted archive whose names and manifest were checked; its files are read when they are wanted.

    Attributes:
        source: path of the archive, or a seekable stream of one.
        names: of its files, in its order.
        manifest: as stored, of schema 1.x with a list of maps; its other keys were not checked.
    """

    source: Path | IO[bytes]
    names: tuple[str, ...]
    manifest: dict[str, Any]

    @classmethod
    def open(cls, source: Path | IO[bytes]) -> ArchiveFile:
        """Check an archive; UsageError where there is no such file.

        BadArchive: not a zip, not an avatar's archive, damaged, or unpacks to more than is accepted.
        """
        if isinstance(source, Path) and not source.is_file():
            raise UsageError(f"there is no archive {source}; make one with avatarme make PHOTO")
        with _unzipped(source) as archive:
            names = archive.namelist()
            odd = unknown_names(names) or ["a name twice"] * (len(set(names)) != len(names))
            if odd:
                raise BadArchive(
                    f"the zip contains {odd[0][:60]!r}; an archive of avatarme has manifest.json, maps/ and mesh/ only"
                )
            for name in ("manifest.json", "mesh/head.obj"):
                if name not in names:
                    raise BadArchive(f"the archive has no {name}; it was not made by avatarme, or is incomplete")
            return cls(source, tuple(names), _manifest(_bounded(archive, "manifest.json", 16 << 20)))

    def read(self, name: str, limit: int = MAX_MEMBER) -> bytes:
        """Content of one file; at most ``limit`` + 1 bytes are unpacked, whatever its header claims.

        BadArchive: it is not there, damaged, or longer.
        """
        if name not in self.names:
            raise BadArchive(f"the archive has no {name}")
        with _unzipped(self.source) as archive:
            return _bounded(archive, name, limit)


@contextlib.contextmanager
def _unzipped(source: Path | IO[bytes]) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(source) as archive:
            yield archive
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise BadArchive(f"the archive cannot be read: {error}") from error


def _bounded(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    with archive.open(name) as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise BadArchive(f"{name} unpacks to more than {limit} bytes, which is the most that is accepted")
    return data


def _manifest(data: bytes) -> dict[str, Any]:
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise BadArchive(f"manifest.json of the archive is not JSON: {error}") from error
    version = content.get("schema_version") if isinstance(content, dict) else None
    if not isinstance(version, str) or version.partition(".")[0] != "1":
        raise BadArchive(f"the manifest has schema version {version!r}; this program reads versions 1.x")
    if not isinstance(content.get("maps"), list) or not all(isinstance(item, dict) for item in content["maps"]):
        raise BadArchive("the manifest's list of maps is missing or not a list of objects")
    return dict(content)
