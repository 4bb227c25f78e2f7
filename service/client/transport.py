"""Requests with retries."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar
from urllib.parse import urlsplit

import httpx

from service import __version__
from service.client.answers import json_of, refused, unreachable
from service.client.errors import ServerBusy
from service.client.retry import AGAIN, Retry, retry_after_s
from service.errors import UsageError

Sender = Callable[[], contextlib.AbstractContextManager[Mapping[str, Any]]]
"""Opens the body of one attempt: further arguments of the request (content, files)."""

TransportFault = httpx.TransportError
"""The connection failed, now or in the middle of a stream."""

Answer = TypeVar("Answer")


class Transport:
    """One server.

    Args:
        server: its address, for example ``https://avatars.example.org`` or one with a path before ``/v1``.
        api_key: sent as ``Authorization: Bearer``; None where the server wants none.
        retry: when to ask again.
        timeout_s: for a connection, and for each wait for bytes in either direction.

    Raises:
        UsageError: the address is no http or https URL, carries a password or a query, or the key is not printable.
    """

    def __init__(self, server: str, api_key: str | None, retry: Retry, timeout_s: float) -> None:
        self.retry = retry
        self.server = _checked_address(server)
        self._timeout_s = timeout_s
        headers = {"User-Agent": f"avatarme/{__version__}", "Accept-Encoding": "identity"}
        if api_key is not None:
            headers["Authorization"] = f"Bearer {_checked_key(api_key)}"
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=32)
        self._http = httpx.Client(headers=headers, timeout=timeout_s, limits=limits, follow_redirects=False)

    def close(self) -> None:
        """Give the connections back."""
        self._http.close()

    def json(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        body: Sender | None = None,
        again: Iterable[int] = AGAIN,
    ) -> Any:
        """One request that answers with JSON; None where the answer has no body; see :meth:`answer`."""
        return self.answer(json_of, method, path, headers=headers, body=body, again=again)

    def answer(
        self,
        read: Callable[[httpx.Response], Answer],
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        body: Sender | None = None,
        again: Iterable[int] = AGAIN,
    ) -> Answer:
        """What ``read`` makes of the answer to one request.

        Args:
            read: reads an answer that is a success.
            method: of HTTP; the request may be sent several times, so it has to be idempotent.
            path: below the address, percent-encoded.
            headers: further headers.
            body: opens the body, once for each attempt.
            again: statuses that are worth another attempt.

        Raises:
            ServerUnreachable: no answer after all retries.
            UnexpectedAnswer: not JSON, a redirection, or longer than 16 MiB.
            AvatarError: what a problem object stands for; see ``service.client.errors``.
        """
        statuses = frozenset(again)
        pauses = self.retry.start()
        while True:
            try:
                with self._send(method, path, headers, body) as response:
                    if response.is_success:
                        return read(response)
                    fault = refused(response)
                    worth, silent = response.status_code in statuses, False
                    asked = retry_after_s(response.headers.get("Retry-After"))
            except httpx.TransportError as error:
                fault = unreachable(self.server, error)
                worth, silent, asked = not _hopeless(error), True, None
            if not worth or not pauses.pause(asked, silent=silent):
                if isinstance(fault, ServerBusy):
                    fault.retry_after = asked
                raise fault

    @contextlib.contextmanager
    def stream(
        self,
        path: str,
        headers: Mapping[str, str] | None = None,
        timeout_s: float | None = None,
        *,
        follow: bool = False,
    ) -> Iterator[httpx.Response]:
        """One GET, without retries, whose body is read as it comes.

        Args:
            path: below the address.
            headers: further headers.
            timeout_s: bound of each wait for bytes, None for that of all requests.
            follow: go where a redirection leads, without the key where that is another server.

        Raises:
            TransportFault: there is no connection, or it broke.
        """
        timeout = self._timeout_s if timeout_s is None else timeout_s
        # The store of a server may give its files out itself; the key goes to the server only, which httpx sees to.
        named: dict[str, Any] = {"headers": dict(headers or {}), "timeout": timeout, "follow_redirects": follow}
        with self._http.stream("GET", self.server + path, **named) as response:
            yield response

    @contextlib.contextmanager
    def _send(
        self, method: str, path: str, headers: Mapping[str, str] | None, body: Sender | None
    ) -> Iterator[httpx.Response]:
        with (
            (body or _nothing)() as arguments,
            self._http.stream(method, self.server + path, headers=dict(headers or {}), **arguments) as response,
        ):
            yield response


def _nothing() -> contextlib.nullcontext[Mapping[str, Any]]:
    return contextlib.nullcontext({})


def _hopeless(error: httpx.TransportError) -> bool:
    """A certificate that is wrong stays wrong; a request that cannot be written is our fault."""
    return isinstance(error, httpx.LocalProtocolError | httpx.UnsupportedProtocol) or "CERTIFICATE" in str(error)


def _checked_address(server: str) -> str:
    try:
        parts = urlsplit(server)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable:
        raise UsageError(f"server is {server!r}; write an address such as https://avatars.example.org", field="server")
    if parts.username is not None or parts.query or parts.fragment:
        raise UsageError(
            "the address of the server may have no user name, query or fragment; keys go into AVATARME_API_KEY",
            field="server",
        )
    return server.rstrip("/")


def _checked_key(key: str) -> str:
    if not key or not key.isascii() or not key.isprintable() or " " in key:
        raise UsageError("the API key is empty or has characters that no header can carry", field="api_key")
    return key
