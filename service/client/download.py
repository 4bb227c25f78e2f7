"""One download that survives broken connections, and leaves a whole, checked archive or none.

Bytes go to a hidden file beside the target whose name holds the ETag, so what is there goes on only as the same version
of the same archive (RFC 9110, sections 13.1.5 and 14), in this call or a later one.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import hashlib
import os
import re
import secrets
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
        self._etag = ""
        self._part: Path | None = None
        self._total: int | None = None
        self._stated: str | None = None

    def run(self) -> str:
        """Fetch, check, rename; returns the archive's sha256. See ``Client.download`` for what it raises."""
        try:
            try:
                return self._checked()
            except DownloadFailed:
                self._discard()  # perhaps it was what an earlier call had left
                return self._checked()
        except DownloadFailed:
            self._etag = ""  # nothing to go on from
            raise
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise OutputFault(f"cannot write {self._target}: {reason}", path=str(self._target)) from error
        finally:
            if not self._etag:
                self._discard()

    def _checked(self) -> str:
        part = self._fetched()
        digest = file_sha256(part)
        if self._stated is None:
            check_zip(part)
        elif digest != self._stated:
            raise DownloadFailed(f"the archive has sha256 {digest}, the server stated {self._stated}", sha256=digest)
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        part.replace(self._target)
        return digest

    def _fetched(self) -> Path:
        """All bytes, over as many connections as that takes; every one that brings something renews the patience."""
        try:
            while (part := self._transport.retried(self._connection)) is None:
                continue
        except ServerUnreachable as error:
            if not self._size():
                raise
            words = f"{error.message}; {self._size()} of {self._total or 'unknown'} bytes are here"
            raise ServerUnreachable(words, **error.extra) from error
        return part

    def _connection(self) -> Path | None:
        """The whole file after one connection; None where it brought a part of it.

        Setback, httpx.TransportError: it brought nothing. DownloadFailed: it brought something else than the rest of
        what is here.
        """
        had = have = self._size() if self._etag else 0
        headers = {"Range": f"bytes={have}-", "If-Range": self._etag} if have else {}
        url = self._transport.server + self._path
        try:
            # The store of a server may give its files out itself; httpx hands the key to the server only.
            with self._transport.http.stream("GET", url, headers=headers, follow_redirects=True) as response:
                if response.status_code == 200:
                    had = have = self._begun(response)
                elif response.status_code in (206, 416) and not self._goes_on(response, have):
                    raise DownloadFailed(f"the server cannot go on from byte {have}")
                elif response.status_code != 206:
                    raise setback(response)
                if not have or response.status_code == 206:
                    self._receive(response, have)
        except httpx.TransportError:
            if self._size() <= had:
                raise
        have = self._size()
        if self._part is not None and self._total in (None, have):
            return self._part
        if self._total is not None and have > self._total:
            raise DownloadFailed(f"the server sent {have} bytes and stated {self._total}")
        return None

    def _begun(self, response: httpx.Response) -> int:
        """Take in the headers of the whole file; returns how many bytes of it are here already."""
        if "identity" not in response.headers.get("Content-Encoding", "identity"):
            raise UnexpectedAnswer("the server compressed the archive although it was asked not to")
        length = response.headers.get("Content-Length", "")
        self._total = int(length) if length.isascii() and length.isdigit() else None
        etag = response.headers.get("ETag", "")
        same, self._etag = etag == self._etag, "" if etag.startswith("W/") else etag
        told = (_stated_sha256(answer.headers) for answer in (*response.history, response))
        self._stated = next((digest for digest in told if digest is not None), None)
        if self._etag:
            self._part = self._hidden(hashlib.sha256(self._etag.encode("utf-8", "replace")).hexdigest()[:16])
            if self._total is not None and 0 < self._size() <= self._total and not same:
                return self._size()
        elif self._part is None:
            self._part = self._hidden(secrets.token_hex(8))
        self._part.write_bytes(b"")
        return 0

    def _goes_on(self, response: httpx.Response, have: int) -> bool:
        found = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
        same = response.headers.get("ETag", self._etag) == self._etag
        return bool(found and int(found[1]) == have and int(found[2]) == self._total and same)

    def _receive(self, response: httpx.Response, have: int) -> None:
        if self._part is None:
            raise UnexpectedAnswer("the server sent a part of an archive that nobody asked for")
        with self._part.open("ab") as stream:
            for chunk in response.iter_raw():
                stream.write(chunk)
                have += len(chunk)
                self._progress(have, self._total)
                if self._total is not None and have > self._total:
                    return

    def _size(self) -> int:
        return self._part.stat().st_size if self._part is not None and self._part.exists() else 0

    def _hidden(self, mark: str) -> Path:
        return self._target.with_name(f".{self._target.name[:64]}.{mark}.part")

    def _discard(self) -> None:
        if self._part is not None:
            with contextlib.suppress(OSError):
                self._part.unlink()
        self._part, self._etag = None, ""


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
