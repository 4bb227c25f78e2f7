"""Server-sent events (WHATWG HTML, section 9.2.6), read from the bytes of a stream.

Lines end with CR, LF or both and with nothing else: ready-made line splitters also cut at U+2028 and its like,
which may stand inside JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from service.client.errors import UnexpectedAnswer

_LARGEST_EVENT = 1 << 20


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes:
        name: ``progress``, ``state``, or what a newer server sends.
        data: its JSON object; empty where the data is none.
        id: what to send as ``Last-Event-ID`` to go on after it; empty where the stream has no ids.
    """

    name: str
    data: Mapping[str, Any]
    id: str = ""


class EventParser:
    """Turns chunks of bytes into events; an event that the end of the stream cut off is dropped.

    Attributes:
        last_id: id of the last complete event.
        reconnect_s: pause before reconnecting that the server asked for, or None.
    """

    def __init__(self, last_id: str = "") -> None:
        self.last_id = last_id
        self.reconnect_s: float | None = None
        self._id = last_id
        self._name = ""
        self._data: list[str] = []
        self._size = 0

    def feed(self, chunks: Iterable[bytes]) -> Iterator[Event]:
        """Parse a stream.

        Raises:
            UnexpectedAnswer: one event has more than a megabyte.
        """
        for line in _lines(chunks):
            if not line:
                event = self._dispatch()
                if event is not None:
                    yield event
            else:
                self._field(line.decode("utf-8", "replace"))

    def _field(self, line: str) -> None:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        self._size += len(value)
        if self._size > _LARGEST_EVENT:
            raise UnexpectedAnswer(f"an event of the server is larger than {_LARGEST_EVENT} bytes")
        if name == "event":
            self._name = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._id = value
        elif name == "retry" and value.isascii() and value.isdigit() and len(value) <= 9:
            self.reconnect_s = int(value) / 1000

    def _dispatch(self) -> Event | None:
        self.last_id = self._id
        name, data = self._name or "message", "\n".join(self._data)
        self._name, self._data, self._size = "", [], 0
        return Event(name, _object(data), self.last_id) if data else None


def _object(text: str) -> Mapping[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, Mapping) else {}


def _lines(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Lines without their ends; what follows the last end is dropped. A CR at the end of a chunk may miss its LF."""
    rest = b""
    after_cr, first = False, True
    for chunk in chunks:
        if not chunk:
            continue
        if after_cr and chunk.startswith(b"\n"):
            chunk = chunk[1:]
        after_cr = chunk.endswith(b"\r")
        parts = (rest + chunk).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        rest = parts.pop()
        if len(rest) > _LARGEST_EVENT:
            raise UnexpectedAnswer(f"a line of the server's events is longer than {_LARGEST_EVENT} bytes")
        for line in parts:
            yield line.removeprefix(b"\xef\xbb\xbf") if first else line
            first = False
