"""Assemble and write the archive of an avatar.

The same photo, options and seed give the same bytes, so nothing here depends on the clock, and measured times and
memory are left out unless ``timings`` requests them.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

from service.archive.avatar import Avatar
from service.archive.container import write_file, write_stream
from service.archive.describe import describe
from service.archive.images import encode_jpeg
from service.archive.licences import licences_text
from service.archive.manifest import to_json
from service.archive.maps import MAPS, encode_map, map_wanted
from service.archive.meshes import meshes
from service.runtime.sessions import release


def write_archive(avatar: Avatar, target: Path | BinaryIO, *, timings: bool = False) -> None:
    """Write the archive of ``avatar`` to a file, atomically, or to a binary stream.

    Args:
        avatar: the results of one photo.
        target: a path, or a stream that may be a pipe.
        timings: also write times and memory into the manifest; the bytes then differ from run to run.

    Raises:
        OutputFault: the file or the stream could not be written.
        NumericFault: a result holds NaN or infinity.
    """
    members = archive_members(avatar, timings=timings)
    try:
        if isinstance(target, Path):
            write_file(target, members)
        else:
            write_stream(target, members)
    finally:
        release()  # else fragmented memory accumulates in a process that makes many avatars


def archive_members(avatar: Avatar, *, timings: bool = False) -> dict[str, bytes]:
    """Name -> content of every file of the archive; see :func:`write_archive`."""
    with ThreadPoolExecutor(2) as pool:
        previews = pool.submit(_previews, avatar)
        files = _maps(avatar) | meshes(avatar) | {"LICENSES.md": licences_text(avatar).encode()}
        files |= previews.result()
    files["manifest.json"] = to_json(describe(avatar, files, timings=timings))
    return files


def _maps(avatar: Avatar) -> dict[str, bytes]:
    """PNG bytes by path; on two threads, as compression takes most of the time and releases the GIL."""
    wanted = [spec for spec in MAPS if map_wanted(avatar, spec.role)]
    with ThreadPoolExecutor(2) as pool:
        packed = pool.map(lambda spec: encode_map(spec, avatar), wanted)
        return {spec.path: data for spec, data in zip(wanted, packed, strict=True) if data is not None}


def _previews(avatar: Avatar) -> Mapping[str, bytes]:
    from service.archive.preview.overlay import overlay
    from service.archive.preview.sheet import sheet

    pictures = {} if avatar.given else {"preview/overlay.jpg": encode_jpeg(overlay(avatar))}
    return {**pictures, "preview/sheet.jpg": encode_jpeg(sheet(avatar))}
