"""One download that survives broken connections, and leaves a whole file or none.

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
from collections.abc import Callable
from pathlib import Path

import httpx

from service.client.answers import refused, unreachable
from service.client.errors import DownloadFailed, ServerBusy, ServerUnreachable, UnexpectedAnswer
from service.client.retry import AGAIN, retry_after_s
from service.client.transport import Transport, TransportFault
from service.client.whole import check_archive, file_sha256
from service.errors import AvatarError, OutputFault


class Download:
    """One archive.

    Args:
        transport: the server.
        path: of the archive below the address.
        target: the file to write.
        progress: told of bytes so far and in all (None: unknown).
    """

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
                return self._attempt()
            except DownloadFailed:
                self._forget()  # perhaps it was what an earlier call had left
                return self._attempt()
        except DownloadFailed:
            self._etag = ""  # nothing to go on from
            raise
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise OutputFault(f"cannot write {self._target}: {reason}", path=str(self._target)) from error
        finally:
            if not self._etag:
                self._forget()

    def _attempt(self) -> str:
        part = self._fetch()
        digest = file_sha256(part)
        if self._stated is not None and digest != self._stated:
            raise DownloadFailed(f"the archive has sha256 {digest}, the server stated {self._stated}", sha256=digest)
        check_archive(part)
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        part.replace(self._target)
        return digest

    def _fetch(self) -> Path:
        """All bytes, over as many connections as that takes; every one that brings something renews the patience."""
        pauses = self._transport.retry.start()
        while True:
            had, silent = self._size(), False
            try:
                done, fault, asked = self._connection()
            except TransportFault as error:
                done, fault, asked, silent = False, self._cut(error), None, True
            if done and self._part is not None:
                return self._part
            if self._size() > had:
                pauses = self._transport.retry.start()
            if not pauses.pause(asked, silent=silent):
                raise fault

    def _connection(self) -> tuple[bool, AvatarError, float | None]:
        """One connection -> (the file is complete, the fault if it is not, pause that the server asked for)."""
        have = self._size() if self._etag else 0
        headers: dict[str, str] = {}
        if have:
            headers = {"Range": f"bytes={have}-", "If-Range": self._etag}
        with self._transport.stream(self._path, headers, follow=True) as response:
            if response.status_code == 200:
                have = self._begin(response)
                if have:
                    return have == self._total, self._cut(), 0.0
            elif response.status_code == 206 and self._goes_on(response, have):
                pass
            elif response.status_code in (206, 416):
                self._forget()
                return False, DownloadFailed(f"the server cannot go on from byte {have}"), None
            elif response.status_code in AGAIN:
                fault = refused(response)
                asked = retry_after_s(response.headers.get("Retry-After"))
                if isinstance(fault, ServerBusy):
                    fault.retry_after = asked
                return False, fault, asked
            else:
                raise refused(response)
            self._receive(response, have)
        have = self._size()
        if self._total is not None and have > self._total:
            self._forget()
            return False, DownloadFailed(f"the server sent {have} bytes and stated {self._total}"), None
        return self._total in (None, have), self._cut(), None

    def _begin(self, response: httpx.Response) -> int:
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
            name = hashlib.sha256(self._etag.encode("utf-8", "replace")).hexdigest()[:16]
            self._part = self._hidden(name)
            if self._total is not None and 0 < self._size() <= self._total and not same:
                return self._size()
        elif self._part is None:
            self._part = self._hidden(secrets.token_hex(8))
        self._part.write_bytes(b"")
        return 0

    def _goes_on(self, response: httpx.Response, have: int) -> bool:
        found = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
        return bool(
            found
            and int(found[1]) == have
            and int(found[2]) == self._total
            and response.headers.get("ETag", self._etag) == self._etag
        )

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

    def _cut(self, error: TransportFault | None = None) -> AvatarError:
        fault = unreachable(self._transport.server, error)
        if not self._size():
            return fault
        total = "unknown" if self._total is None else self._total
        return ServerUnreachable(f"{fault.message}; {self._size()} of {total} bytes are here", **fault.extra)

    def _size(self) -> int:
        return self._part.stat().st_size if self._part is not None and self._part.exists() else 0

    def _hidden(self, mark: str) -> Path:
        return self._target.with_name(f".{self._target.name[:64]}.{mark}.part")

    def _forget(self) -> None:
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
