"""Photos, stages and archives as files named by their hash, on a local disk or any store that fsspec knows.

Names are ``<job>/<kind>-<sha256><suffix>``; they are made here and never come from a request. A file is there whole or
not at all. Erasing a job is erasing its folder.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

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

    Args:
        missing: what is not there is no fault, and leaves as FileNotFoundError.
    """
    try:
        yield
    except Exception as error:
        if missing and isinstance(error, FileNotFoundError):
            raise
        raise StoreFault(errno.EIO, f"the store of files fails: {type(error).__name__}: {error}") from error


class Stream(io.BufferedIOBase):
    """A file of a remote store, with its faults as :class:`StoreFault`."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self._file = file

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def read(self, size: int | None = -1, /) -> bytes:
        """So many bytes, or the rest."""
        with translated(missing=False):
            return bytes(self._file.read(-1 if size is None else size))

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """As of any file."""
        with translated(missing=False):
            return int(self._file.seek(offset, whence))

    def tell(self) -> int:
        """As of any file."""
        return int(self._file.tell())

    def close(self) -> None:
        """As of any file."""
        self._file.close()
        super().close()


_NAME = re.compile(r"[0-9a-f]{32}/[a-z][a-z0-9_]{0,40}-[0-9a-f]{64}\.[a-z]{1,5}\Z")
_JOB = re.compile(r"[0-9a-f]{32}\Z")

class Artifacts:
    """Files of all jobs.

    Args:
        url: of the folder, for fsspec. Several machines need one that they share.

    Raises:
        ImportError: fsspec needs a package for this kind of store; the message names it.
    """

    def __init__(self, url: str) -> None:
        from fsspec.core import url_to_fs

        # No cache of listings: other processes write here, and what they wrote would not be there.
        more = S3 if url.startswith(("s3:", "s3a:")) else {}
        self._fs, self._root = url_to_fs(url, use_listings_cache=False, **more)
        self._local = Path(self._root) if "file" in _protocols(self._fs) else None
        if self._local is not None:
            self._local.mkdir(parents=True, exist_ok=True, mode=0o700)

    @property
    def folder(self) -> Path | None:
        """The folder on this machine, None for a remote store."""
        return self._local

    def put(self, source: Path, name: str, *, durable: bool = True) -> None:
        """Move a local file to ``name``; on the disk when this returns, unless it need not be ``durable``.

        Raises:
            OSError: as the disk raises it.
            StoreFault: the store is remote, and does not take it.
        """
        target = self._address(name)
        if self._local is None:
            with self._asking(missing=False):
                self._fs.put_file(str(source), target)
            source.unlink()
            return
        path = Path(target)
        path.parent.mkdir(exist_ok=True, mode=0o700)
        if source.stat().st_dev != path.parent.stat().st_dev:
            part = path.with_name(f".{secrets.token_hex(8)}.part")
            shutil.copyfile(source, part)
            source.unlink()
            source = part
        if durable:
            with source.open("rb") as stream:
                os.fsync(stream.fileno())
        source.replace(path)
        if durable:
            _sync(path.parent)
            _sync(path.parent.parent)

    def open(self, name: str) -> IO[bytes]:
        """Open for reading.

        Raises:
            FileNotFoundError: there is no such file.
            StoreFault: the store is remote and does not answer; reading and seeking may raise it too.
        """
        address = self._address(name)
        if self._local is not None:
            return Path(address).open("rb")
        with self._asking():
            return cast(IO[bytes], Stream(self._fs.open(address, "rb", block_size=BLOCK)))

    def signed(self, name: str, seconds: int, disposition: str, head: bool = False) -> str | None:
        """An address at the store that gives out a file for so long; None where the store cannot sign.

        Args:
            name: of the file.
            seconds: for which the address holds.
            disposition: header ``Content-Disposition`` of the answer.
            head: the address is for HEAD, and not for GET; one does not hold for the other.
        """
        address = self._address(name)
        if self._local is not None or "s3" not in _protocols(self._fs):
            return None
        with self._asking():
            # A parameter of GetObject; whoever changes it breaks the signature.
            more = {"client_method": "head_object"} if head else {"ResponseContentDisposition": disposition}
            return str(self._fs.sign(address, expiration=seconds, **more))

    def read(self, name: str) -> bytes:
        """The whole content; as :meth:`open`."""
        with self.open(name) as stream:
            return stream.read()

    def exists(self, name: str) -> bool:
        """Whether the file is there."""
        address = self._address(name)
        with self._asking():
            return bool(self._fs.exists(address))

    def names(self, job: str) -> list[str]:
        """Names of all files of a job."""
        return [f"{job}/{name}" for name in self._listed(self._folder(job))]

    def delete(self, name: str) -> None:
        """Remove a file; nothing happens where there is none."""
        self._remove(self._address(name))

    def sweep(self, job: str, keep: set[str]) -> None:
        """Remove all files of a job but those of ``keep``, unfinished ones too."""
        for name in self.names(job):
            if name not in keep:
                self._remove(f"{self._root}/{name}")
        if not keep and self._local is not None:
            with contextlib.suppress(OSError):
                (self._local / job).rmdir()

    def jobs(self) -> list[str]:
        """Jobs that have files."""
        return [name for name in self._listed(self._root) if _JOB.match(name)]

    def _listed(self, folder: str) -> list[str]:
        try:
            with self._asking():
                return [str(path).rpartition("/")[2] for path in self._fs.ls(folder, detail=False, refresh=True)]
        except FileNotFoundError:  # a remote store knows no empty folders
            return []

    def _remove(self, address: str) -> None:
        with contextlib.suppress(FileNotFoundError), self._asking():
            self._fs.rm_file(address)

    def _asking(self, *, missing: bool = True) -> contextlib.AbstractContextManager[None]:
        """Faults of a remote store leave as :class:`StoreFault`; a disk's are what they are."""
        return contextlib.nullcontext() if self._local is not None else translated(missing=missing)

    def _address(self, name: str) -> str:
        if not _NAME.match(name):
            raise ValueError(f"not a name of an artifact: {name!r}")
        return f"{self._root}/{name}"

    def _folder(self, job: str) -> str:
        if not _JOB.match(job):
            raise ValueError(f"not a job: {job!r}")
        return f"{self._root}/{job}"


def artifact_name(job: str, kind: str, digest: str, suffix: str) -> str:
    """``<job>/<kind>-<digest>.<suffix>``."""
    return f"{job}/{kind}-{digest}.{suffix}"


def sha256_of(stream: IO[bytes]) -> str:
    """Hex digest of the rest of a stream."""
    digest = hashlib.sha256()
    while block := stream.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _protocols(fs: Any) -> tuple[str, ...]:
    protocol = fs.protocol
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)


def _sync(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some file systems cannot sync a folder
            os.fsync(handle)
    finally:
        os.close(handle)
