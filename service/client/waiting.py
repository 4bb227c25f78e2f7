"""Following a job: by its events, and by asking where there are none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from service.client.answers import refused
from service.client.errors import UnexpectedAnswer, WaitTimedOut
from service.client.events import Event, EventParser
from service.client.retry import AGAIN
from service.client.state import Job
from service.client.transport import Transport, TransportFault

ENDED = ("succeeded", "failed", "cancelled", "expired")

_SILENCE_S = 45.0
"""The server sends a heartbeat every 15 s; three missed ones mean that the connection is dead."""

_CUTS = 4
"""Streams in a row that broke without a single event; from then on the client asks instead."""

_ASK_EVERY_S = (1.0, 5.0)
"""Pause between questions: first and longest."""


class Follower:
    """The events of one job, over as many connections as that takes.

    Args:
        transport: the server.
        path: of the job, ``/v1/avatars/{id}``.
        last_id: id of the last event that is known already.
        timeout_s: how long to follow, None for as long as the job goes on.
    """

    def __init__(self, transport: Transport, path: str, last_id: str, timeout_s: float | None) -> None:
        self._transport = transport
        self._path = path
        self._parser = EventParser(last_id)
        self._end = None if timeout_s is None else time.monotonic() + timeout_s

    def events(self) -> Iterator[Event]:
        """Events until the job has ended; the last one is a ``state`` that is final.

        Raises:
            WaitTimedOut: the time is over; the job goes on.
            AvatarError: the server refused, or cannot be reached after all retries.
        """
        cuts = 0
        while cuts < _CUTS:
            heard = False
            try:
                for event in self._connection():
                    heard = True
                    yield event
                    if final(event):
                        return
            except TransportFault:
                pass
            except _NoStream:
                break
            self._remaining()
            content = self._ask()
            if Job.parse(content).ended:
                yield Event("state", content, self._parser.last_id)
                return
            cuts = 0 if heard else cuts + 1
            self._pause(self._parser.reconnect_s or 0.5 * 2**cuts)
        yield from self._by_asking()

    def _connection(self) -> Iterator[Event]:
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        if self._parser.last_id:
            headers["Last-Event-ID"] = self._parser.last_id
        silence = min(_SILENCE_S, self._remaining())
        with self._transport.stream(self._path + "/events", headers, silence) as response:
            if response.is_success and "text/event-stream" in response.headers.get("Content-Type", ""):
                self._parser = EventParser(self._parser.last_id)
                for event in self._parser.feed(self._timed(response.iter_raw())):
                    yield event
                    self._remaining()
            elif response.is_success or response.status_code in (404, 405, 406, 501):
                raise _NoStream  # a proxy that lets no stream through; if there is no such job, asking will tell
            elif response.status_code not in AGAIN:
                raise refused(response)

    def _timed(self, chunks: Iterator[bytes]) -> Iterator[bytes]:
        for chunk in chunks:  # heartbeats come through here too, so a silent job cannot outlast the time
            yield chunk
            self._remaining()

    def _by_asking(self) -> Iterator[Event]:
        pause, longest = _ASK_EVERY_S
        before: tuple[str, str, float] | None = None
        while True:
            content = self._ask()
            job = Job.parse(content)
            if before != (job.state, job.stage, job.progress):
                before = job.state, job.stage, job.progress
                yield Event("state", content)
            if job.ended:
                return
            self._pause(pause)
            pause = min(1.5 * pause, longest)

    def _ask(self) -> dict[str, Any]:
        content = self._transport.json("GET", self._path)
        if not isinstance(content, dict):
            raise UnexpectedAnswer(f"the server sent {type(content).__name__} where the state of a job was expected")
        return content

    def _pause(self, seconds: float) -> None:
        jitter = 0.75 + 0.5 * self._transport.retry.draw()
        self._transport.retry.sleep(min(seconds * jitter, self._remaining()))
        self._remaining()

    def _remaining(self) -> float:
        if self._end is None:
            return float("inf")
        left = self._end - time.monotonic()
        if left <= 0:
            raise WaitTimedOut(f"job {self._path.rpartition('/')[2]} did not end in time; it goes on at the server")
        return left


class _NoStream(Exception):
    """There are no events to be had here; never leaves this module."""


def final(event: Event) -> bool:
    """Whether nothing comes after this event."""
    return event.name == "state" and event.data.get("state") in ENDED
