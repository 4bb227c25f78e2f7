"""The bad line is as bad as it says, and no worse."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from tests.support.slow_line import Line


@pytest.fixture
def line() -> Iterator[Line]:
    """A line to somebody who says again what it is told."""
    listener = socket.create_server(("127.0.0.1", 0))

    def answer(end: socket.socket) -> None:
        with end:
            while data := end.recv(1024):
                end.sendall(data)

    def serve() -> None:
        while True:
            try:
                end = listener.accept()[0]
            except OSError:
                return
            threading.Thread(target=answer, args=(end,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    made = Line(listener.getsockname()[1])
    yield made
    made.close()
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()


def ask(end: socket.socket) -> float:
    """Seconds to the answer."""
    begin = time.monotonic()
    end.sendall(b"x")
    assert end.recv(1) == b"x"
    return time.monotonic() - begin


def test_what_passes_is_late(line: Line) -> None:
    with socket.create_connection(("127.0.0.1", line.port), timeout=20) as end:
        ask(end)
        line.delay = 0.2
        assert ask(end) >= 0.4, "there and back"


@pytest.mark.parametrize("forget", [True, False])
def test_nothing_passes_a_line_that_is_split_and_nobody_is_told(line: Line, forget: bool) -> None:
    with socket.create_connection(("127.0.0.1", line.port), timeout=20) as end:
        ask(end)
        line.split()
        end.sendall(b"y")
        late = socket.create_connection(("127.0.0.1", line.port), timeout=20)
        late.sendall(b"z")
        for waiting in (end, late):
            waiting.settimeout(0.3)
            with pytest.raises(TimeoutError):
                waiting.recv(1)
            waiting.settimeout(20)
        line.mend(forget=forget)
        assert late.recv(1) == b"z"
        late.close()
        if forget:
            assert end.recv(1) == b""
        else:
            assert end.recv(1) == b"y"
            ask(end)
