"""What an answer of the server says: JSON, a picture, or the exception for what it refuses."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import httpx

from service.client.errors import ServerUnreachable, UnexpectedAnswer, refusal
from service.client.problem import Problem
from service.errors import AvatarError

_LARGEST_ANSWER = 16 << 20
_LARGEST_PICTURE = 128 << 20


def refused(response: httpx.Response) -> AvatarError:
    """The exception for an answer that is no success; reads the problem object."""
    status = response.status_code
    if response.is_redirect:
        where = response.headers.get("Location", "another address")[:200]
        return UnexpectedAnswer(f"the server answered with a redirection to {where}; give that address instead")
    content = None
    with contextlib.suppress(UnexpectedAnswer):
        content = json_of(response)
    return refusal(Problem.parse(content, status))


def unreachable(server: str, error: httpx.TransportError | None) -> ServerUnreachable:
    """The exception for a connection that failed; None where it just ended too soon."""
    reason = "the answer ended too soon" if error is None else str(error) or type(error).__name__
    return ServerUnreachable(f"no answer from {server}: {reason}", server=server)


def picture(response: httpx.Response) -> bytes:
    """A PNG.

    Raises:
        UnexpectedAnswer: the answer is none, or longer than 128 MiB.
    """
    data = _content(response, _LARGEST_PICTURE)
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        raise UnexpectedAnswer("the server's answer is no PNG; is it this service?")
    return data


def picture_or_job(response: httpx.Response) -> Any:
    """A PNG, or where the answer is 202 the JSON of its job.

    Raises:
        UnexpectedAnswer: the answer is neither.
    """
    return json_of(response) if response.status_code == 202 else picture(response)


def _content(response: httpx.Response, most: int) -> bytes:
    data = bytearray()
    for chunk in response.iter_raw():
        data += chunk
        if len(data) > most:
            raise UnexpectedAnswer(f"the server's answer is longer than {most} bytes")
    return bytes(data)


def json_of(response: httpx.Response) -> Any:
    """JSON, None for an empty answer.

    Raises:
        UnexpectedAnswer: it is something else, or longer than 16 MiB.
    """
    data = _content(response, _LARGEST_ANSWER)
    if not data:
        return None
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        kind = response.headers.get("Content-Type", "no type")[:80]
        raise UnexpectedAnswer(
            f"the server answered with {kind} instead of JSON (status {response.status_code}); is it this service?"
        ) from error
