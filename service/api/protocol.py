"""HTTP/1.1 of uvicorn with what a server on the open internet needs: a deadline for the head of a request, and problems
instead of plain text for what is no HTTP.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import STATUS_PHRASES, H11Protocol

from service.api.problems import EXPLANATIONS, MEDIA_TYPE
from service.jobs.view import problem


def protocol_class(header_seconds: float, connections: int, stalled_seconds: float = 60.0) -> type[H11Protocol]:
    """The protocol with deadlines.

    Args:
        header_seconds: from the connection, or the first byte of a further request, to the end of its head.
        connections: that one address may have open at a time, 0 for any number.
        stalled_seconds: that a reader may leave what was written to it unread, before its connection is closed. What
            is kept for it is at most the transport's buffer, so this also is a least speed.
    """

    class GuardedProtocol(H11Protocol):
        """One connection."""

        _deadline: asyncio.TimerHandle | None = None
        _stall: asyncio.TimerHandle | None = None

        def pause_writing(self) -> None:
            super().pause_writing()
            self._stall = self.loop.call_later(stalled_seconds, self.transport.abort)

        def resume_writing(self) -> None:
            self._reading_goes_on()
            super().resume_writing()

        def _reading_goes_on(self) -> None:
            if self._stall is not None:
                self._stall.cancel()
                self._stall = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            address = self.client[0] if self.client else ""
            same = sum(1 for other in self.connections if _address(other) == address)
            if connections and same > connections:
                transport.abort()
                return
            self._wait()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop_waiting()
            self._reading_goes_on()
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            if self._deadline is None and self.conn.their_state is h11.IDLE:
                self._wait()
            super().data_received(data)
            if self.conn.their_state is not h11.IDLE:
                self._stop_waiting()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            if self.conn.their_state is not h11.IDLE:
                self._stop_waiting()

        def send_400_response(self, msg: str) -> None:
            self._refuse(400, "bad-request")

        def _wait(self) -> None:
            self._deadline = self.loop.call_later(header_seconds, self._too_slow)

        def _stop_waiting(self) -> None:
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

        def _too_slow(self) -> None:
            self._deadline = None
            if self.transport.is_closing() or self.conn.their_state is not h11.IDLE:
                return
            if self.cycle is not None and not self.cycle.response_complete:
                return
            self._refuse(408, "request-timeout")

        def _refuse(self, status: int, code: str) -> None:
            if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
                self.transport.close()
                return
            body = json.dumps(problem(code, status, EXPLANATIONS[code])).encode()
            headers = [
                (b"content-type", MEDIA_TYPE.encode()),
                (b"content-length", str(len(body)).encode()),
                (b"x-content-type-options", b"nosniff"),
                (b"connection", b"close"),
            ]
            answer = h11.Response(status_code=status, headers=headers, reason=STATUS_PHRASES[status])
            for event in (answer, h11.Data(data=body), h11.EndOfMessage()):
                self.transport.write(cast(bytes, self.conn.send(cast(Any, event))))
            self.transport.close()

    return GuardedProtocol


def _address(connection: Any) -> str:
    client = getattr(connection, "client", None)
    return client[0] if client else ""
