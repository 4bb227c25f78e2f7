"""Telling of the end of a job: signed, again until it arrives, and nowhere that the operator has not listed."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from service.errors import UsageError
from service.jobs import telemetry, webhooks
from service.jobs.database import now
from service.jobs.queue import ATTEMPTS, PAUSES_S
from service.jobs.settings import Settings
from service.jobs.store import checkpoint, let_go
from service.jobs.webhooks import Target, may_be_reached, target
from tests.service.jobs.conftest import Bench

NEVER = [
    "64:ff9b::a00:8", "64:ff9b::5db8:d80e", "2002:7f00:1::", "2002:5db8:d80e::1", "2001:0:1::1", "::10.0.0.8",
    "::93.184.215.14", "fec0::1", "ff02::1", "ff0e::1", "224.0.0.1", "239.1.2.3", "0.0.0.0", "::",  # noqa: S104
]  # fmt: skip
"""Translated, tunnelled, of old forms, or of no single machine: not even a network inside is reached like this."""

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
def settings(bench: Bench, receiver: Receiver, tmp_path: Path) -> Settings:
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET + b"\n")
    hosts = f"localhost:{receiver.server.server_port}"
    return replace(bench.settings, webhook_hosts=hosts, webhook_secret=str(secret), webhook_private=True)


def attempts(bench: Bench, job: str) -> list[str]:
    """States of the attempts to tell of a job that the queue knows of, in their order."""
    found = bench.queue.states([f"{job}.told.{number}" for number in range(1, ATTEMPTS + 2)])
    return [str(found[name].status) for name in sorted(found, key=lambda name: int(name.rpartition(".")[2]))]


def test_the_end_of_a_job_is_told_signed(bench: Bench, settings: Settings, receiver: Receiver) -> None:
    job = bench.add(1, webhook=receiver.url, metadata={"order": 7})
    assert attempts(bench, job) == []
    bench.run(job)
    assert attempts(bench, job) == ["ENQUEUED"]
    assert webhooks.tell(bench.store, settings, job, 1) == "status 200"
    ((headers, body),) = receiver.seen
    told = json.loads(body)
    assert (told["type"], told["job"]["id"], told["job"]["state"]) == ("job.ended", job, "succeeded")
    assert told["job"]["metadata"] == {"order": 7}
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    digest = base64.b64encode(hmac.new(SECRET, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{digest}"
    assert attempts(bench, job) == ["ENQUEUED"], "it arrived, and no other attempt follows"


def test_what_does_not_arrive_is_sent_again_until_it_is_given_up(
    bench: Bench, settings: Settings, receiver: Receiver
) -> None:
    """A redirection is no arrival, and is not followed."""
    receiver.answers = [302, *[500] * 100]
    job = bench.add(webhook=receiver.url)
    bench.store.fail(job, {"code": "no-face"}, now() + 100)
    for attempt in range(1, ATTEMPTS + 1):
        webhooks.tell(bench.store, settings, job, attempt)
    assert attempts(bench, job) == ["ENQUEUED", *["DELAYED"] * (ATTEMPTS - 1)]
    due = bench.queue.states([f"{job}.told.2", f"{job}.told.{ATTEMPTS}"])
    for attempt, pause in ((2, PAUSES_S[0]), (ATTEMPTS, PAUSES_S[-1])):
        moment = due[f"{job}.told.{attempt}"].delay_until_epoch_ms
        assert moment is not None and moment / 1000 == pytest.approx(now() + pause, abs=5)
    assert len({headers["webhook-id"] for headers, _ in receiver.seen}) == 1
    assert telemetry.counts(bench.engine, "webhooks") == {"given up": 1}


def test_a_secret_may_be_written_as_the_standard_has_it(bench: Bench, settings: Settings, receiver: Receiver) -> None:
    """Every receiver with a library of Standard Webhooks takes ``whsec_`` off and decodes the rest: none could check.

    What such a library (standardwebhooks 1.1.0, ``Webhook("whsec_...").sign``) makes of secret, name, moment and body.
    """
    Path(settings.webhook_secret).write_text("whsec_c2VjcmV0c2VjcmV0c2VjcmV0c2VjcmV0\n")
    job = bench.add(webhook=receiver.url)
    bench.store.fail(job, {"code": "no-face"}, now() + 100)
    assert webhooks.tell(bench.store, settings, job, 1) == "status 200"
    ((headers, body),) = receiver.seen
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    digest = base64.b64encode(hmac.new(b"secret" * 4, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{digest}"
    secret = webhooks.secret_of(b"whsec_c2VjcmV0c2VjcmV0c2VjcmV0c2VjcmV0")
    assert (
        webhooks.signature(secret, "msg_1", 1_700_000_000, b'{"a": 1}')
        == "v1,6J6fbuuhoCiEbiw/X375tnQnR+dX8iha8gj0tQoSPJI="
    )


def test_a_secret_that_is_no_base64_loses_no_message(bench: Bench, settings: Settings, receiver: Receiver) -> None:
    Path(settings.webhook_secret).write_text("whsec_c2V\u00e9jcmV0c")
    job = bench.add(webhook=receiver.url)
    bench.store.fail(job, {"code": "no-face"}, now() + 100)
    assert "Error" in webhooks.tell(bench.store, settings, job, 1)
    assert attempts(bench, job) == ["ENQUEUED", "DELAYED"]


def test_a_host_that_has_come_to_lead_inside_is_given_up_at_once(
    bench: Bench, settings: Settings, receiver: Receiver
) -> None:
    """It was tried for 16 hours, in vain each time."""
    settings = replace(settings, webhook_private=False)
    job = bench.add(webhook=receiver.url.replace("http:", "https:"))
    bench.store.fail(job, {"code": "no-face"}, now() + 100)
    assert "leads to localhost" in webhooks.tell(bench.store, settings, job, 1)
    assert attempts(bench, job) == ["ENQUEUED"]
    assert telemetry.counts(bench.engine, "webhooks") == {"given up": 1}


def test_of_a_job_that_was_cancelled_or_erased_nobody_is_told(
    bench: Bench, settings: Settings, receiver: Receiver
) -> None:
    """Who posts and deletes again and again must not have others called."""
    cancelled, erased = (bench.add(webhook=receiver.url) for _ in range(2))
    bench.store.cancel(cancelled, now() + 100)
    assert attempts(bench, cancelled) == []
    bench.store.fail(erased, {"code": "no-face"}, now() + 100)
    row = bench.row(erased)
    let_go(bench.store, row, "erased")
    assert attempts(bench, erased) == []
    for job in (cancelled, erased):
        assert webhooks.tell(bench.store, settings, job, 1) == "nobody is to be told"
    assert receiver.seen == []
    bench.engine.dispose()
    assert checkpoint(bench.engine)
    stored = b"".join(path.read_bytes() for path in bench.settings.data.glob("jobs.sqlite*"))
    assert b"/hook?x" not in stored


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


@pytest.mark.parametrize("address", NEVER)
def test_some_addresses_are_never_reached(address: str) -> None:
    assert not may_be_reached(address, private=True)
    assert not may_be_reached(address, private=False)


@pytest.mark.parametrize(
    ("address", "inside"),
    [("93.184.215.14", False), ("2606:2800:21f:cb07::1", False), ("10.0.0.8", True), ("fd00::1", True), ("::1", True)],
)
def test_others_are(address: str, inside: bool) -> None:
    assert may_be_reached(address, private=True)
    assert may_be_reached(address, private=False) is not inside


@pytest.mark.parametrize("hosts", ["https://hooks.example", '["hooks.example"]', "hooks.example/path", "a b"])
def test_hosts_that_no_address_could_match_are_refused(hosts: str, tmp_path: Path) -> None:
    """The server started, and refused every webhook as one that it does not list."""
    (tmp_path / "secret").write_bytes(bytes(32))
    with pytest.raises(UsageError, match=r"webhook_hosts is .*; it has to be names of hosts"):
        Settings(webhook_hosts=hosts, webhook_secret=str(tmp_path / "secret"))


@pytest.mark.parametrize("hosts", ["", "hooks.example", "10.0.0.8:8443, hooks.example,", "localhost:80"])
def test_hosts_are_names_with_or_without_a_port(hosts: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(32))
    assert Settings(webhook_hosts=hosts, webhook_secret=str(tmp_path / "secret")).webhook_hosts == hosts


def test_hosts_need_a_secret() -> None:
    with pytest.raises(UsageError, match="webhook_secret"):
        Settings(webhook_hosts="hooks.example")
