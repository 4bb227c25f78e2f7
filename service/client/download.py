"""One download that survives broken connections, and leaves a whole, checked archive or none.

Bytes go to a hidden file beside the target, which this call or a later one goes on with. A job has one archive for
ever; what would be put together of two does not have the digest.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import os
import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import httpx

from service.client.errors import DownloadFailed, ServerUnreachable, UnexpectedAnswer
from service.client.transport import Transport, setback
from service.errors import OutputFault
from service.places import file_sha256


class Download:
    """One archive, by its path below the server's address; ``progress`` gets bytes so far and in all, if known."""

    def __init__(
        self, transport: Transport, path: str, target: Path, progress: Callable[[int, int | None], None]
    ) -> None:
        self._transport = transport
        self._path = path
        self._target = target
        self._progress = progress
        self._part = target.with_name(f".{target.name[:64]}.part")
        self._total: int | None = None
        self._stated: str | None = None

    def run(self) -> str:
        """Fetch, check, rename; returns the archive's sha256. See ``Client.download`` for what it raises."""
        try:
            try:
                return self._checked()
            except DownloadFailed:
                self._part.unlink(missing_ok=True)  # perhaps it was what an earlier call had left
                return self._checked()
        except DownloadFailed:
            self._part.unlink(missing_ok=True)
            raise
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise OutputFault(f"cannot write {self._target}: {reason}", path=str(self._target)) from error

    def _checked(self) -> str:
        self._fetch()
        digest = file_sha256(self._part)
        if self._stated is None:
            check_zip(self._part)
        elif digest != self._stated:
            raise DownloadFailed(f"the archive has sha256 {digest}, the server stated {self._stated}", sha256=digest)
        with self._part.open("rb") as stream:
            os.fsync(stream.fileno())
        self._part.replace(self._target)
        return digest

    def _fetch(self) -> None:
        """All bytes, over as many connections as that takes; every one that brings something renews the patience."""
        try:
            while not self._transport.retried(self._connection):
                continue
        except ServerUnreachable as error:
            if not self._size():
                raise
            words = f"{error.message}; {self._size()} of {self._total or 'unknown'} bytes are here"
            raise ServerUnreachable(words, **error.extra) from error

    def _connection(self) -> bool:
        """Whether the file is whole after one more connection.

        Setback, httpx.TransportError: it brought nothing. DownloadFailed: it brought something else than the rest of
        what is here.
        """
        have = self._size()
        headers = {"Range": f"bytes={have}-"} if have else {}
        url = self._transport.server + self._path
        try:
            # The store of a server may give its files out itself; httpx hands the key to the server only.
            with self._transport.http.stream("GET", url, headers=headers, follow_redirects=True) as response:
                if response.status_code == 200:
                    have = 0
                elif response.status_code not in (206, 416):
                    raise setback(response)
                self._begin(response, have)
                return self._receive(response, have)
        except httpx.TransportError:
            if self._size() <= have:
                raise
        return False

    def _begin(self, response: httpx.Response, have: int) -> None:
        """Take in the headers of an answer that brings the file from a byte on."""
        if "identity" not in response.headers.get("Content-Encoding", "identity"):
            raise UnexpectedAnswer("the server compressed the archive although it was asked not to")
        length = response.headers.get("Content-Length", "")
        self._total = int(length) if length.isascii() and length.isdigit() else None
        if response.status_code != 200:
            found = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
            if found is None or int(found[1]) != have:
                raise DownloadFailed(f"the server cannot go on from byte {have}")
            self._total = int(found[2])
        told = (_stated_sha256(answer.headers) for answer in (*response.history, response))
        self._stated = next((digest for digest in told if digest is not None), None)

    def _receive(self, response: httpx.Response, have: int) -> bool:
        """Whether all is here that the server has stated."""
        with self._part.open("ab" if have else "wb") as stream:
            for chunk in response.iter_raw():
                stream.write(chunk)
                have += len(chunk)
                self._progress(have, self._total)
                if self._total is not None and have > self._total:
                    raise DownloadFailed(f"the server sent {have} bytes and stated {self._total}")
        return self._total in (None, have)

    def _size(self) -> int:
        return self._part.stat().st_size if self._part.exists() else 0


def _stated_sha256(headers: httpx.Headers) -> str | None:
    """The digest that the server states: ``Repr-Digest`` (RFC 9530), or an ETag that is one."""
    found = re.search(r"sha-256=:([A-Za-z0-9+/=]+):", headers.get("Repr-Digest", ""))
    if found:
        with contextlib.suppress(binascii.Error):
            return base64.b64decode(found[1], validate=True).hex()
    found = re.fullmatch(r'"(?:sha256[:-])?([0-9a-f]{64})"', headers.get("ETag", ""))
    return found[1] if found else None


def check_zip(path: Path) -> None:
    """Read an archive whose digest nobody stated; DownloadFailed where it is no zip, or a file in it is damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError) as error:
        raise DownloadFailed(f"the archive is damaged: {error}") from error
    if damaged is not None:
        raise DownloadFailed(f"{damaged} in the archive is damaged", path=damaged)
