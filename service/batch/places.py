"""Where a batch reads and writes: a folder of this machine, or a store that fsspec knows (``s3://bucket/prefix``)."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import stat
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol, cast

from service.errors import OutputFault, UsageError
from service.jobs.artifacts import S3, Stream, translated

PAGE = 1000
"""Names that a store lists in one answer."""


@dataclass(frozen=True)
class Entry:
    """One file: its name below the place, with ``/`` between folders, and when it was written, seconds since 1970."""

    name: str
    modified: float


class Place(Protocol):
    """A folder, here or far away; each call may raise OSError, of a remote one StoreFault.

    Attributes:
        address: absolute path or URL, the same for every machine.
    """

    address: str

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """Files with these suffixes (lower case) here and below, in no order, hidden ones and a place left out."""
        ...

    def modified(self, name: str) -> float | None:
        """When a file was written; None where there is none."""
        ...

    def open(self, name: str) -> IO[bytes]:
        """Open for reading; FileNotFoundError where there is none."""
        ...

    def put(self, source: Path, name: str) -> None:
        """Move a local file here: whole under its name and on the disk when this returns, or not at all."""
        ...

    def write(self, name: str, data: bytes) -> None:
        """Write a small file, likewise."""
        ...

    def names(self, folder: str) -> list[str]:
        """Names of the files of one folder, hidden ones too; empty where there is no such folder."""
        ...

    def delete(self, name: str) -> None:
        """Remove a file; nothing happens where there is none."""
        ...


def place(address: str) -> Place:
    """The place of an address.

    Raises:
        UsageError: fsspec does not know this kind of store, or a package for it is missing.
    """
    if "://" not in address:
        return Folder(Path(address))
    try:
        return Store(address)
    except (ImportError, ValueError) as error:
        raise UsageError(f"{address} cannot be reached: {error}") from error


class Folder:
    """A folder on a disk of this machine, or on one that several machines share."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self.address = str(self.path)

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """See ``Place``."""
        own = leave_out.path.resolve() if isinstance(leave_out, Folder) else None
        waiting = [self.path] if self.path.is_dir() else []
        while waiting:
            here = waiting.pop()
            with os.scandir(here) as found:
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
                                name = Path(entry.path).relative_to(self.path).as_posix()
                                yield Entry(name, facts.st_mtime)

    def modified(self, name: str) -> float | None:
        """See ``Place``."""
        try:
            return (self.path / name).stat().st_mtime
        except (FileNotFoundError, NotADirectoryError):
            return None

    def open(self, name: str) -> IO[bytes]:
        """See ``Place``."""
        return (self.path / name).open("rb")

    def put(self, source: Path, name: str) -> None:
        """See ``Place``."""
        target = self.path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.stat().st_dev != target.parent.stat().st_dev:
            part = target.with_name(f".{secrets.token_hex(8)}.part")
            shutil.copyfile(source, part)
            source.unlink()
            source = part
        with source.open("rb") as stream:
            os.fsync(stream.fileno())
        source.replace(target)

    def write(self, name: str, data: bytes) -> None:
        """See ``Place``."""
        target = self.path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(f".{secrets.token_hex(8)}.part")
        try:
            with part.open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)

    def names(self, folder: str) -> list[str]:
        """See ``Place``."""
        try:
            return [f"{folder}/{name}" for name in os.listdir(self.path / folder) if not name.startswith(".")]
        except FileNotFoundError:
            return []

    def delete(self, name: str) -> None:
        """See ``Place``."""
        (self.path / name).unlink(missing_ok=True)


class Store:
    """A remote store; the variables of its library lead to it (``AWS_ENDPOINT_URL``, ``AWS_ACCESS_KEY_ID`` ...)."""

    def __init__(self, address: str) -> None:
        from fsspec.core import url_to_fs

        self.address = address.rstrip("/")
        more = S3 if address.startswith(("s3:", "s3a:")) else {}
        # No cache of listings: other machines write here, and what they wrote would not be there.
        self._fs, self._root = url_to_fs(self.address, use_listings_cache=False, **more)

    def entries(self, suffixes: Collection[str], leave_out: Place | None = None) -> Iterator[Entry]:
        """See ``Place``."""
        own = f"{leave_out.address}/" if isinstance(leave_out, Store) else None
        if own is not None and self.address.startswith(own):
            own = None  # what is asked for lies in it
        for name, modified in self._listed():
            parts = name.split("/")
            # Hidden, or leading out of a folder where the archives go to one.
            if any(part == "" or part.startswith(".") for part in parts) or "\0" in name:
                continue
            outside = own is None or not f"{self.address}/{name}".startswith(own)
            if outside and PurePosixPath(name).suffix.lower() in suffixes:
                yield Entry(name, modified)

    def _listed(self) -> Iterator[tuple[str, float]]:
        """Names and times of all files below, a page at a time where the store is S3."""
        if not hasattr(self._fs, "call_s3"):
            with translated():
                for path, facts in self._fs.find(self._root, detail=True).items():
                    yield str(path)[len(self._root) :].lstrip("/"), _seconds(facts)
            return
        bucket, _, prefix = self._root.partition("/")
        prefix = f"{prefix}/" if prefix else ""
        more: dict[str, str] = {}
        while True:
            with translated():
                page = self._fs.call_s3("list_objects_v2", Bucket=bucket, Prefix=prefix, MaxKeys=PAGE, **more)
            for item in page.get("Contents", ()):
                yield item["Key"][len(prefix) :], item["LastModified"].timestamp()
            if not page.get("IsTruncated"):
                return
            more = {"ContinuationToken": page["NextContinuationToken"]}

    def modified(self, name: str) -> float | None:
        """See ``Place``."""
        try:
            with translated():
                return _seconds(self._fs.info(self._path(name), refresh=True))
        except FileNotFoundError:
            return None

    def open(self, name: str) -> IO[bytes]:
        """See ``Place``."""
        with translated():
            return cast(IO[bytes], Stream(self._fs.open(self._path(name), "rb", block_size=4 << 20)))

    def put(self, source: Path, name: str) -> None:
        """See ``Place``."""
        with translated(missing=False):
            self._fs.put_file(str(source), self._path(name))
        source.unlink()

    def write(self, name: str, data: bytes) -> None:
        """See ``Place``."""
        with translated(missing=False):
            self._fs.pipe_file(self._path(name), data)

    def names(self, folder: str) -> list[str]:
        """See ``Place``."""
        try:
            with translated():
                found = self._fs.ls(self._path(folder), detail=False, refresh=True)
        except FileNotFoundError:
            return []
        return [f"{folder}/{str(path).rpartition('/')[2]}" for path in found]

    def delete(self, name: str) -> None:
        """See ``Place``."""
        with contextlib.suppress(FileNotFoundError), translated():
            self._fs.rm_file(self._path(name))

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"


def _seconds(facts: Any) -> float:
    when = facts.get("LastModified") or facts.get("mtime") or facts.get("last_modified") or 0.0
    return float(when.timestamp() if hasattr(when, "timestamp") else when)


def read(where: Place, name: str) -> bytes | None:
    """A small file, None where there is none."""
    try:
        with where.open(name) as stream:
            return stream.read()
    except FileNotFoundError:
        return None


@contextlib.contextmanager
def writable(where: Place) -> Iterator[None]:
    """Faults of writing to a place as OutputFault."""
    try:
        yield
    except OSError as error:
        raise OutputFault(f"cannot write {where.address}: {(error.strerror or str(error)).lower()}") from error
