"""Requests that are tried again, and what their answers say: JSON, or the exception for what is refused."""

from __future__ import annotations

import contextlib
import json
import logging
import random
import time
from collections.abc import Callable, Collection, Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, TypeVar
from urllib.parse import urlsplit

import httpx
import stamina

from service import __version__
from service.client.errors import Problem, ServerBusy, ServerUnreachable, UnexpectedAnswer, refusal
from service.errors import AvatarError, UsageError

AGAIN = frozenset({408, 425, 429, 502, 503, 504, 507})
"""Statuses that say: not now. Other 5xx are bugs, which asking again only repeats."""

SILENCE_S = 300.0
"""Seconds without any answer after which a server is taken for gone, however patient the caller is."""

_FIRST_S, _LONGEST_S = 0.5, 30.0
"""Pauses between attempts that the server said nothing about, in seconds: they double from the first to the longest."""

_LARGEST_ANSWER = 16 << 20
"""Bytes."""

Body = Callable[[], contextlib.AbstractContextManager[Mapping[str, Any] | None]]
"""Opens the body of one attempt: further arguments of the request (content, files)."""

T = TypeVar("T")

logging.getLogger("stamina").addHandler(logging.NullHandler())  # a pause is no news for standard error


class Setback(Exception):
    """One attempt that failed; leaves this package as ``fault``.

    ``again`` says whether another attempt may help, ``retry_after`` for how many seconds the server wants to be left
    alone, None where it did not say.
    """

    def __init__(self, fault: AvatarError, *, again: bool, retry_after: float | None = None) -> None:
        super().__init__(fault.message)
        self.fault = fault
        self.again = again
        self.retry_after = retry_after
        if isinstance(fault, ServerBusy):
            fault.retry_after = retry_after


class Transport:
    """One server. Threads may share it.

    Args:
        server: its address, for example ``https://avatars.example.org`` or one with a path before ``/v1``.
        api_key: sent as ``Authorization: Bearer``; None where the server wants none.
        attempts: requests in all, the first one counted.
        patience_s: how long one request is tried again; a server that asks for more is given up.
        timeout_s: for a connection, and for each wait for bytes in either direction.

    Raises:
        UsageError: the address is no http or https URL, carries a password or a query, or the key is not printable.
    """

    def __init__(self, server: str, api_key: str | None, attempts: int, patience_s: float, timeout_s: float) -> None:
        self.server = _checked_address(server)
        self._patience_s = patience_s
        self._caller = stamina.RetryingCaller(
            attempts=attempts, timeout=patience_s, wait_initial=_FIRST_S, wait_max=_LONGEST_S, wait_jitter=_FIRST_S
        )
        headers = {"User-Agent": f"avatarme/{__version__}", "Accept-Encoding": "identity"}
        if api_key is not None:
            if not api_key or not api_key.isascii() or not api_key.isprintable() or " " in api_key:
                raise UsageError("the API key is empty or has characters that no header can carry", field="api_key")
            headers["Authorization"] = f"Bearer {api_key}"
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=32)
        self.http = httpx.Client(headers=headers, timeout=timeout_s, limits=limits)

    def ask(
        self, method: str, path: str, *, body: Body = contextlib.nullcontext, again: Collection[int] = AGAIN,
        headers: Mapping[str, str] | None = None,
    ) -> Any:  # fmt: skip
        """The JSON of the answer to one request, None for an empty one.

        Args:
            method: of HTTP; the request may be sent several times, so it has to be idempotent.
            path: below the address, percent-encoded.
            body: opens the body, once for each attempt.
            again: statuses that are worth another attempt.
            headers: beside those of the client.

        Raises:
            UnexpectedAnswer: a redirection, or no JSON.
            ServerUnreachable, AvatarError: as :meth:`retried`; what a problem object stands for.
        """

        def once() -> Any:
            with (
                body() as content,
                self.http.stream(method, self.server + path, headers=headers, **(content or {})) as response,
            ):
                if not response.is_success:
                    raise setback(response, again)
                return read_json(response)

        return self.retried(once)

    def retried(self, attempt: Callable[[], T]) -> T:
        """The result of the first attempt that has one; an attempt raises httpx.TransportError or :class:`Setback`.

        ServerUnreachable: no answer after all retries. AvatarError: the fault of the last attempt.
        """
        try:
            return self._caller(_Pauses(self._patience_s), attempt)
        except httpx.TransportError as error:
            reason = str(error) or type(error).__name__
            raise ServerUnreachable(f"no answer from {self.server}: {reason}", server=self.server) from error
        except Setback as setback:
            raise setback.fault from setback.__cause__


class _Pauses:
    """The back-off hook of one request: whether to try again, and after how many seconds where the server said so."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._begun = self._heard = time.monotonic()

    def __call__(self, error: Exception) -> bool | float:
        now = time.monotonic()
        if isinstance(error, httpx.TransportError):
            return not _hopeless(error) and now - self._heard < SILENCE_S
        if not isinstance(error, Setback) or not error.again:
            return False
        self._heard = now
        asked = error.retry_after
        if asked is None:
            return True
        if now - self._begun + asked > self._patience_s:
            return False
        # Never sooner than asked for; on top a random part, or all that were told 10 come back at 10.
        return asked + random.uniform(0.0, 0.1 * asked + _FIRST_S)  # noqa: S311 - no secret


def setback(response: httpx.Response, again: Collection[int] = AGAIN) -> Setback:
    """What an answer that is no success means; reads the problem object."""
    if response.is_redirect:
        where = response.headers.get("Location", "another address")[:200]
        words = f"the server answered with a redirection to {where}; give that address instead"
        return Setback(UnexpectedAnswer(words), again=False)
    content = None
    with contextlib.suppress(UnexpectedAnswer):
        content = read_json(response)
    worth = response.status_code in again
    return Setback(
        refusal(Problem.parse(content, response.status_code)), again=worth, retry_after=retry_after_s(response.headers)
    )


def retry_after_s(headers: Mapping[str, str]) -> float | None:
    """Seconds of ``Retry-After`` (RFC 9110, section 10.2.3), a number or a date; None for anything else."""
    text = headers.get("Retry-After", "").strip()
    if text.isascii() and text.isdigit() and len(text) <= 9:
        return float(text)
    try:
        when = parsedate_to_datetime(text)
    except ValueError:
        return None
    if when.tzinfo is None:  # the obsolete "-0000": it is UTC all the same
        when = when.replace(tzinfo=UTC)
    return max(0.0, (when - datetime.now(UTC)).total_seconds())


def read_json(response: httpx.Response) -> Any:
    """JSON, None for an empty answer; UnexpectedAnswer where it is something else, or longer than 16 MiB."""
    data = bytearray()
    for chunk in response.iter_raw():
        data += chunk
        if len(data) > _LARGEST_ANSWER:
            raise UnexpectedAnswer(f"the server's answer is longer than {_LARGEST_ANSWER} bytes")
    if not data:
        return None
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        kind = response.headers.get("Content-Type", "no type")[:80]
        raise UnexpectedAnswer(
            f"the server answered with {kind} instead of JSON (status {response.status_code}); is it this service?"
        ) from error


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
