"""Telling of the end of a job: signed, again until it arrives, and nowhere that the operator has not listed."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from service.errors import UsageError
from service.jobs import webhooks as delivering
from service.jobs.database import MESSAGES, now
from service.jobs.erasure import depart
from service.jobs.settings import Settings
from service.jobs.webhooks import Target, deliver, resolved, target
from tests.service.jobs.conftest import Bench, bench  # noqa: F401 - a fixture

SECRET = b"a secret of the operator and the receiver"


class Receiver:
    """An address that keeps what it is told, and answers with the statuses of ``answers`` in turn."""

    def __init__(self) -> None:
        self.seen: list[tuple[dict[str, str], bytes]] = []
        self.answers: list[int] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.seen.append(({name.lower(): value for name, value in self.headers.items()}, body))
                self.send_response(outer.answers.pop(0) if outer.answers else 200)
                self.send_header("Location", "http://127.0.0.1:1/")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()
        self.url = f"http://localhost:{self.server.server_port}/hook?x=1"


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.server.shutdown()
    made.server.server_close()


@pytest.fixture
def settings(bench: Bench, receiver: Receiver, tmp_path: Path) -> Settings:  # noqa: F811
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET + b"\n")
    hosts = f"localhost:{receiver.server.server_port}"
    return replace(bench.settings, webhook_hosts=hosts, webhook_secret=str(secret), webhook_private=True)


def waiting(bench: Bench) -> list[Any]:  # noqa: F811
    with bench.engine.connect() as connection:
        return list(connection.execute(MESSAGES.select()).mappings())


def test_the_end_of_a_job_is_told_once_and_signed(bench: Bench, settings: Settings, receiver: Receiver) -> None:  # noqa: F811
    job = bench.add(1, webhook=receiver.url, metadata={"order": 7})
    assert deliver(bench.engine, settings) == 0
    bench.run(job)
    assert deliver(bench.engine, settings) == 1
    assert deliver(bench.engine, settings) == 0
    ((headers, body),) = receiver.seen
    told = json.loads(body)
    assert (told["type"], told["job"]["id"], told["job"]["state"]) == ("job.ended", job, "succeeded")
    assert told["job"]["metadata"] == {"order": 7}
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    digest = base64.b64encode(hmac.new(SECRET, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{digest}"


def test_what_does_not_arrive_is_sent_again(
    bench: Bench,  # noqa: F811
    settings: Settings,
    receiver: Receiver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A redirection is no arrival, and is not followed."""
    receiver.answers = [500, 302, 204]
    bench.store.cancel(bench.add(webhook=receiver.url), now() + 100)
    assert deliver(bench.engine, settings) == 0
    (message,) = waiting(bench)
    assert message["tries"] == 1 and message["next_at"] > now() + 3
    monkeypatch.setattr(delivering, "now", lambda: now() + 10_000)
    assert [deliver(bench.engine, settings) for _ in range(1)] == [0]
    monkeypatch.setattr(delivering, "now", lambda: now() + 30_000)
    assert deliver(bench.engine, settings) == 1
    assert waiting(bench) == []
    assert len({headers["webhook-id"] for headers, _ in receiver.seen}) == 1


def test_after_all_attempts_it_is_given_up(
    bench: Bench,  # noqa: F811
    settings: Settings,
    receiver: Receiver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    receiver.answers = [500] * 100
    bench.store.cancel(bench.add(webhook=receiver.url), now() + 100)
    for number in range(1, 30):
        monkeypatch.setattr(delivering, "now", lambda number=number: now() + number * 100_000)
        deliver(bench.engine, settings)
    assert len(receiver.seen) == len(delivering.PAUSES_S) + 1
    assert waiting(bench) == []


def test_an_erased_job_is_told_of_no_more(bench: Bench, receiver: Receiver) -> None:  # noqa: F811
    job = bench.add(webhook=receiver.url)
    bench.store.cancel(job, now() + 100)
    assert waiting(bench)
    depart(bench.engine, job, "erased")
    assert waiting(bench) == []


@pytest.mark.parametrize(
    "url",
    [
        "http://hooks.example/x", "https://other.example/x", "https://hooks.example:8443/", "ftp://hooks.example/",
        "https://user@hooks.example/", "https://hooks.example@evil.example/", "https://hooks.example.evil.example/",
        "https://127.0.0.1/", "https://[::1]/", "https://hooks.example/#x", "https://hooks.example\\@evil.example/",
        "https://hooks.example/\r\nX: y", "https://hooks.example/" + "x" * 3000, "hooks.example", "",
    ],
)  # fmt: skip
def test_only_listed_hosts_are_told(url: str) -> None:
    with pytest.raises(UsageError):
        target(url, "hooks.example", private=False)


def test_a_listed_host_is_told() -> None:
    assert target("https://Hooks.example/a?b=c", "x, hooks.example", private=False) == Target(
        "https", "hooks.example", 443, "/a?b=c"
    )
    assert target("https://hooks.example:8443", "hooks.example:8443", private=False).port == 8443
    with pytest.raises(UsageError, match="tells nobody"):
        target("https://hooks.example/", "", private=False)


@pytest.mark.parametrize(
    "address",
    ["127.0.0.1", "10.0.0.8", "169.254.169.254", "192.168.1.1", "0.0.0.0", "::1", "fe80::1", "::ffff:10.0.0.1"],  # noqa: S104
)
def test_a_name_that_leads_inside_is_not_followed(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever owns the zone of a listed host, or answers for it, must not reach what stands beside the worker."""
    answers = [(0, 0, 0, "", ("93.184.215.14", 443)), (0, 0, 0, "", (address, 443))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *a, **b: answers)
    with pytest.raises(OSError, match="open internet"):
        resolved(Target("https", "hooks.example", 443, "/"), private=False)


def test_a_server_without_hosts_takes_no_address(tmp_path: Path) -> None:
    from tests.service.api.conftest import GOOD, TOY, is_problem, open_api

    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1)) as client:
        files: dict[str, Any] = {"image": ("x.jpg", GOOD), "webhook_url": (None, "https://hooks.example/")}
        is_problem(client.post("/v1/avatars", files=files), 422, "usage")


def test_hosts_need_a_secret() -> None:
    with pytest.raises(UsageError, match="webhook_secret"):
        Settings(webhook_hosts="hooks.example")
