"""Slow, broken and hostile HTTP, byte by byte on a socket."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Iterator

import httpx
import pytest

from tests.support.server import Server, in_threads, small_photo


def talk(server: Server, *pieces: bytes | float, seconds: float = 8.0) -> bytes:
    """Send pieces, wait where a number says so, and read until the server closes."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=seconds) as line:
        for piece in pieces:
            if isinstance(piece, bytes):
                line.sendall(piece)
            else:
                time.sleep(piece)
        received = b""
        while True:
            try:
                block = line.recv(65536)
            except (ConnectionResetError, BrokenPipeError):
                return received
            if not block:
                return received
            received += block


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


HOST = b"Host: localhost\r\n"
POST = b"POST /v1/avatars HTTP/1.1\r\n" + HOST + b"Content-Type: image/jpeg\r\n"


def test_a_head_that_never_ends_is_given_up(server: Server) -> None:
    begin = time.monotonic()
    answer = talk(server, b"GET /livez HTTP/1.1\r\nX: ")
    assert status_of(answer) == 408
    assert time.monotonic() - begin < 4
    assert json.loads(answer.split(b"\r\n\r\n", 1)[1])["code"] == "request-timeout"


def test_a_connection_that_says_nothing_is_closed(server: Server) -> None:
    begin = time.monotonic()
    talk(server)
    assert time.monotonic() - begin < 4


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Few connections, and readers that stand still are given up soon."""
    settings = {"connections": 3, "header_seconds": 30.0, "stalled_seconds": 0.5}
    made = Server(tmp_path_factory.mktemp("few") / "data", settings, with_worker=False)
    made.start(ready=False)
    yield made
    made.kill()


def test_one_address_may_have_so_many_connections(few: Server) -> None:
    lines = [socket.create_connection(("127.0.0.1", few.port), timeout=5) for _ in range(3)]
    try:
        time.sleep(0.3)
        with pytest.raises(httpx.TransportError):
            httpx.get(f"{few.url}/livez", timeout=10)
        lines.pop().close()
        time.sleep(0.3)
        assert httpx.get(f"{few.url}/livez", timeout=10).status_code == 200
    finally:
        for line in lines:
            line.close()


def test_a_second_request_on_the_line_has_a_deadline_too(server: Server) -> None:
    begin = time.monotonic()
    answer = talk(server, b"GET /livez HTTP/1.1\r\n" + HOST + b"\r\n", 0.3, b"GET /li")
    assert answer.startswith(b"HTTP/1.1 200")
    assert b"HTTP/1.1 408" in answer
    assert time.monotonic() - begin < 5


def test_a_body_that_stops_is_given_up(server: Server) -> None:
    begin = time.monotonic()
    answer = talk(server, POST + b"Content-Length: 5000\r\n\r\n" + b"x" * 100)
    assert status_of(answer) == 408
    assert time.monotonic() - begin < 5


@pytest.mark.slow
def test_a_body_that_trickles_is_given_up(server: Server) -> None:
    begin = time.monotonic()
    drops: list[bytes | float] = []
    for _ in range(12):
        drops += [b"x", 0.5]
    try:
        answer = talk(server, POST + b"Content-Length: 5000\r\n\r\n", *drops)
        assert answer == b"" or status_of(answer) == 408
    except (BrokenPipeError, ConnectionResetError):
        pass  # closed while it was still sending
    assert time.monotonic() - begin < 12


def test_a_body_over_the_limit_is_refused_before_it_is_read(server: Server) -> None:
    answer = talk(server, POST + b"Content-Length: 900000000\r\nConnection: close\r\n\r\n")
    assert status_of(answer) == 413
    assert b"application/problem+json" in answer


def test_a_chunked_body_over_the_limit_is_cut_off(server: Server) -> None:
    def endless() -> object:
        yield b"\xff\xd8\xff"
        for _ in range(60):
            yield bytes(1 << 20)

    with httpx.Client(base_url=server.url, timeout=30) as client:
        try:
            answer = client.post("/v1/avatars", content=endless(), headers={"Content-Type": "image/jpeg"})  # type: ignore[arg-type]
            assert answer.status_code == 413
        except httpx.TransportError:
            pass  # the server closed while the rest was still being sent
    deadline = time.monotonic() + 5
    while list((server.data / "incoming").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert list((server.data / "incoming").iterdir()) == []


@pytest.mark.parametrize(
    "head",
    [
        b"Content-Length: -1\r\n",
        b"Content-Length: 10\r\nContent-Length: 20\r\n",
        b"Content-Length: 3\r\nTransfer-Encoding: chunked\r\n",
        b"Content-Length: x\r\n",
        b"Transfer-Encoding: gzip\r\n",
        b"no colon\r\n",
        b"X\0: 1\r\n",
        HOST,
    ],
)
def test_two_meanings_are_no_meaning(server: Server, head: bytes) -> None:
    """What a proxy in front could read in another way must not be read at all."""
    answer = talk(server, POST + head + b"Connection: close\r\n\r\nabc\r\n0\r\n\r\n")
    assert status_of(answer) in (400, 501)
    assert b"application/problem+json" in answer
    assert b"connection: close" in answer.lower()


@pytest.mark.parametrize(
    "line", [b"", b"\x16\x03\x01\x02\0", b"GET\r\n", b"GET / HTTP/9.9\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n"]
)
def test_what_is_no_http_is_refused(server: Server, line: bytes) -> None:
    answer = talk(server, line + b"\r\n\r\n\r\n")
    assert answer == b"" or status_of(answer) in (400, 408, 505)


def test_a_long_address_or_head_is_refused(server: Server) -> None:
    for head in (b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nX: " + b"a" * 100_000 + b"\r\n"):
        try:
            answer = talk(server, head + HOST + b"Connection: close\r\n\r\n")
            assert answer == b"" or status_of(answer) in (400, 404, 431)
        except (BrokenPipeError, ConnectionResetError):
            pass


def test_a_client_that_leaves_leaves_nothing_behind(server: Server) -> None:
    before = httpx.get(f"{server.url}/v1/avatars?limit=100").json()["items"]
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(POST + b"Content-Length: 5000\r\n\r\n" + small_photo(3)[:1000])
        time.sleep(0.2)
    deadline = time.monotonic() + 5
    while list((server.data / "incoming").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert list((server.data / "incoming").iterdir()) == []
    assert len(httpx.get(f"{server.url}/v1/avatars?limit=100").json()["items"]) == len(before)


def test_slow_clients_do_not_hold_up_others(server: Server) -> None:
    lines = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(100)]
    try:
        for line in lines:
            line.sendall(b"GET /livez HTTP/1.1\r\nX: ")
        answers = in_threads(8, lambda number: httpx.get(f"{server.url}/livez", timeout=5).status_code)
        assert answers == [200] * 8
    finally:
        for line in lines:
            line.close()


def test_a_reader_that_stands_still_is_given_up(few: Server) -> None:
    """A download that nobody reads would hold its connection, and what was written to it, for ever."""
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", few.port))
        line.settimeout(20)
        for _ in range(200):  # answers that together are more than all buffers on the way
            line.sendall(b"GET /openapi.json HTTP/1.1\r\n" + HOST + b"\r\n")
        time.sleep(2.5)
        received = 0
        with contextlib.suppress(ConnectionResetError):
            while block := line.recv(1 << 16):
                received += len(block)
    whole = len(httpx.get(f"{few.url}/openapi.json").content)
    assert 0 < received < 150 * whole, "the rest was never written"
    assert httpx.get(f"{few.url}/livez").status_code == 200
