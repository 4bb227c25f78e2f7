"""Is an archive whole? Every file against the size and the sha256 that the manifest states."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

from service.client.errors import DownloadFailed

_BLOCK = 1 << 20
_LARGEST_MANIFEST = 16 << 20
_MANIFEST = "manifest.json"


def check_archive(path: Path) -> None:
    """Check an archive from end to end, in little memory.

    Raises:
        DownloadFailed: it is no zip, has no manifest, or a file in it is missing, surplus or changed.
        OSError: it cannot be read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _check(archive)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
        KeyError,
        TypeError,
    ) as error:
        raise DownloadFailed(f"the archive is damaged: {error}") from error


def file_sha256(path: Path) -> str:
    """Hex sha256 of a file, read in blocks.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _check(archive: zipfile.ZipFile) -> None:
    names = archive.namelist()
    files = _listed(archive)
    stated = [str(file["path"]) for file in files]
    if len(set(names)) != len(names) or sorted(names) != sorted([*stated, _MANIFEST]):
        odd = sorted(set(names) ^ {*stated, _MANIFEST}) or ["a name that is there twice"]
        raise DownloadFailed(f"the archive and its manifest do not list the same files: {', '.join(odd[:5])}")
    for file in files:
        with archive.open(file["path"]) as stream:
            size, digest = _measure(stream, int(file["size"]))
        if size != file["size"] or digest != file["sha256"]:
            raise DownloadFailed(f"{file['path']} in the archive is not the file of the manifest", path=file["path"])


def _listed(archive: zipfile.ZipFile) -> list[dict[str, Any]]:
    with archive.open(_MANIFEST) as stream:
        data = stream.read(_LARGEST_MANIFEST + 1)
    if len(data) > _LARGEST_MANIFEST:
        raise ValueError(f"its manifest has more than {_LARGEST_MANIFEST} bytes")
    manifest = json.loads(data)
    files = manifest.get("files") if isinstance(manifest, dict) else None
    if not isinstance(files, list) or not all(isinstance(file, dict) for file in files) or not files:
        raise ValueError("its manifest lists no files")
    return files


def _measure(stream: IO[bytes], expected: int) -> tuple[int, str]:
    """Size and sha256; stops soon after ``expected`` bytes, since a deflated file may unfold without end."""
    digest, size = hashlib.sha256(), 0
    while size <= expected and (block := stream.read(_BLOCK)):
        digest.update(block)
        size += len(block)
    return size, digest.hexdigest()
