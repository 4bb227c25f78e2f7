"""Where files lie: a folder of this machine, or a store that fsspec knows (``s3://bucket/prefix``).

A file is there whole or not at all. What a store's library raises leaves as :class:`StoreFault`.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import secrets
import shutil
import stat
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from service.errors import OutputFault, UsageError

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

    With ``missing``, what is not there is no fault, and leaves as FileNotFoundError.
    """
    try:
        yield
    except Exception as error:
        if missing and isinstance(error, FileNotFoundError):
            raise
        raise StoreFault(errno.EIO, f"the store of files fails: {type(error).__name__}: {error}") from error


class _Stream(io.RawIOBase):
    """A file of a remote store, with its faults as :class:`StoreFault`."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self._file = file

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        with translated(missing=False):
            return int(self._file.readinto(buffer))

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        with translated(missing=False):
            return int(self._file.seek(offset, whence))

    def tell(self) -> int:
        return int(self._file.tell())

    def close(self) -> None:
        self._file.close()
        super().close()


@dataclass(frozen=True)
class Entry:
    """One file: its name below the place, with ``/`` between folders, and when it was written, seconds since 1970."""

    name: str
    modified: float


class Place:
    """A folder here or far away; names of files are below it. Each call may raise OSError, of a store StoreFault.

    The library of a store is led there by its own variables (``AWS_ENDPOINT_URL``, ``AWS_ACCESS_KEY_ID`` ...).
    ImportError, ValueError: fsspec needs a package for this kind of store, or does not know it.

    Attributes:
        address: absolute path or URL, the same for every machine.
        folder: the folder on this machine (or on a disk that several share), None for a store.
    """

    def __init__(self, address: str | Path) -> None:
        address = str(address)
        self.folder: Path | None = None
        if "://" in address:
            from fsspec.core import url_to_fs

            more = S3 if address.startswith(("s3:", "s3a:")) else {}
            # No cache of listings: other machines write here, and what they wrote would not be there.
            self._fs, self._root = url_to_fs(address, use_listings_cache=False, **more)
            if self.is_kept_by("file"):
                self.folder = Path(self._root)
        else:
            self.folder = Path(address).absolute()
        self.address = address.rstrip("/") if self.folder is None else str(self.folder)

    def is_kept_by(self, protocol: str) -> bool:
        """Whether fsspec reaches the store by this protocol."""
        found = self._fs.protocol
        return protocol in ((found,) if isinstance(found, str) else found)

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """Files with these suffixes (lower case) here and below, in no order, hidden ones and a place left out."""
        if self.folder is not None:
            yield from self._walked(self.folder, suffixes, None if leave_out is None else leave_out.folder)
            return
        own = f"{leave_out.address}/" if leave_out is not None else None
        if own is not None and self.address.startswith(own):
            own = None  # what is asked for lies in it
        with translated():
            found = self._fs.find(self._root, detail=True)
        for path, facts in found.items():
            name = str(path)[len(self._root) :].lstrip("/")
            parts = name.split("/")
            # Hidden, or leading out of a folder where the archives go to one.
            if any(part == "" or part.startswith(".") for part in parts) or "\0" in name:
                continue
            outside = own is None or not f"{self.address}/{name}".startswith(own)
            if outside and PurePosixPath(name).suffix.lower() in suffixes:
                yield Entry(name, _seconds(facts))

    def _walked(self, folder: Path, suffixes: Collection[str], leave_out: Path | None) -> Iterator[Entry]:
        own = None if leave_out is None else leave_out.resolve()
        waiting = [folder] if folder.is_dir() else []
        while waiting:
            with os.scandir(waiting.pop()) as found:
                for entry in found:
                    if entry.name.startswith("."):
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        path = Path(entry.path)
                        waiting += [] if own is not None and path.resolve() == own else [path]
                    elif PurePosixPath(entry.name).suffix.lower() in suffixes:
                        with contextlib.suppress(OSError):  # a link that leads nowhere
                            facts = entry.stat()
                            if stat.S_ISREG(facts.st_mode):
                                yield Entry(Path(entry.path).relative_to(folder).as_posix(), facts.st_mtime)

    def names(self, folder: str) -> list[str]:
        """Names of all files and folders in one folder, "" for the place itself; empty where there is none."""
        try:
            if self.folder is not None:
                found = os.listdir(self.folder / folder)
            else:
                with translated():
                    listed = self._fs.ls(f"{self._root}/{folder}".rstrip("/"), detail=False, refresh=True)
                found = [str(path).rpartition("/")[2] for path in listed]
        except FileNotFoundError:  # a store knows no empty folders
            return []
        return [f"{folder}/{name}" if folder else name for name in found]

    def modified(self, name: str) -> float | None:
        """When a file was written; None where there is none."""
        path = self._path(name)
        try:
            if self.folder is not None:
                return Path(path).stat().st_mtime
            with translated():
                return _seconds(self._fs.info(path, refresh=True))
        except (FileNotFoundError, NotADirectoryError):
            return None

    def exists(self, name: str) -> bool:
        """Whether the file is there."""
        return self.modified(name) is not None

    def open(self, name: str) -> IO[bytes]:
        """Open for reading; FileNotFoundError where there is none. Reading and seeking may raise StoreFault too."""
        path = self._path(name)
        if self.folder is not None:
            return Path(path).open("rb")
        with translated():
            return io.BufferedReader(_Stream(self._fs.open(path, "rb", block_size=BLOCK)))

    def read(self, name: str) -> bytes:
        """The whole content; as :meth:`open`."""
        with self.open(name) as stream:
            return stream.read()

    def local(self, name: str, folder: Path) -> Path:
        """Path of a file on this machine: its own, or that of a copy in a folder; raises as :meth:`open`."""
        with self.open(name) as stream:
            if self.folder is not None:
                return Path(self._path(name))
            path = folder / f"{secrets.token_hex(8)}{PurePosixPath(name).suffix}"
            with path.open("wb") as target:
                shutil.copyfileobj(stream, target, BLOCK)
            return path

    def put(self, source: Path, name: str, *, durable: bool = True) -> None:
        """Move a local file here; on the disk when this returns, unless it need not be ``durable``."""
        path = self._path(name)
        if self.folder is None:
            with translated(missing=False):
                self._fs.put_file(str(source), path)
            source.unlink()
            return
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.stat().st_dev != target.parent.stat().st_dev:
            part = target.with_name(f".{secrets.token_hex(8)}.part")
            shutil.copyfile(source, part)
            source.unlink()
            source = part
        if durable:
            with source.open("rb") as stream:
                os.fsync(stream.fileno())
        source.replace(target)
        if durable:
            for folder in (target.parent, target.parent.parent):
                sync(folder)

    def write(self, name: str, data: bytes) -> None:
        """Write a small file."""
        path = self._path(name)
        if self.folder is None:
            with translated(missing=False):
                self._fs.pipe_file(path, data)
            return
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(f".{secrets.token_hex(8)}.part")
        try:
            part.write_bytes(data)
            self.put(part, name)
        finally:
            part.unlink(missing_ok=True)

    def delete(self, name: str) -> None:
        """Remove a file; nothing happens where there is none."""
        self._remove(self._path(name))

    def _remove(self, path: str) -> None:
        if self.folder is not None:
            Path(path).unlink(missing_ok=True)
            return
        with contextlib.suppress(FileNotFoundError), translated():
            self._fs.rm_file(path)

    def _path(self, name: str) -> str:
        """Where the system or the store has a file."""
        return str(self.folder / name) if self.folder is not None else f"{self._root}/{name}"


def place(address: str) -> Place:
    """The place of an address; UsageError: fsspec does not know this kind of store, or a package for it is missing."""
    try:
        return Place(address)
    except (ImportError, ValueError) as error:
        raise UsageError(f"{address} cannot be reached: {error}") from error


@contextlib.contextmanager
def writable(where: Place) -> Iterator[None]:
    """Faults of writing to a place as OutputFault."""
    try:
        yield
    except OSError as error:
        raise OutputFault(f"cannot write {where.address}: {(error.strerror or str(error)).lower()}") from error


def sha256_of(stream: IO[bytes]) -> str:
    """Hex digest of the rest of a stream."""
    return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]  # it asks for less than it says


def file_sha256(path: Path) -> str:
    """Hex digest of a file; OSError where it cannot be read."""
    with path.open("rb") as stream:
        return sha256_of(stream)


def _seconds(facts: Any) -> float:
    when = facts.get("LastModified") or facts.get("mtime") or facts.get("last_modified") or facts.get("created") or 0.0
    return float(when.timestamp() if hasattr(when, "timestamp") else when)


def sync(folder: Path) -> None:
    """Make renames in a folder durable, where the file system can."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
