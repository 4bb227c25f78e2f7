"""The client against a server that answers as the contract says, late, wrongly or not at all."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from service import errors
from service.client.client import Client
from service.client.errors import (
    AccessDenied,
    JobCancelled,
    JobFailed,
    NoSuchJob,
    Refused,
    ServerBusy,
    ServerUnreachable,
    UnexpectedAnswer,
    WaitTimedOut,
)
from service.client.photos import canonical, idempotency_key, photo_sha256
from service.client.retry import Retry
from service.errors import UsageError
from tests.service.client.fake import Fake, answer, hang_up, problem

PHOTO = b"the bytes of a photo"


def test_from_the_photo_to_the_archive(client: Client, fake: Fake, tmp_path: Path) -> None:
    (tmp_path / "me.jpg").write_bytes(PHOTO)
    job = client.submit(tmp_path / "me.jpg", {"seed": 3})
    told: list[tuple[str, float]] = []
    done = client.wait(job.id, progress=lambda stage, share: told.append((stage, share)))
    digest = client.download(job.id, tmp_path / "me.zip")
    assert fake.photos[job.id] == PHOTO
    assert done.state == "succeeded"
    assert done.options == {"seed": 3}
    assert [stage for stage, _ in told[:3]] == fake.stages
    assert (tmp_path / "me.zip").read_bytes() == fake.archive
    assert fake.etag_header() == f'"{digest}"'
    assert sorted(path.name for path in tmp_path.iterdir()) == ["me.jpg", "me.zip"]
    client.delete(job.id)
    assert not fake.jobs


def test_every_request_carries_the_key_and_the_name_of_the_program(client: Client, fake: Fake) -> None:
    client.wait(client.submit(PHOTO).id)
    assert {seen.headers["Authorization"] for seen in fake.seen} == {"Bearer secret"}
    assert all(seen.headers["User-Agent"].startswith("avatarme/") for seen in fake.seen)


def test_the_name_of_the_photo_stays_at_home(client: Client, fake: Fake, tmp_path: Path) -> None:
    bodies: list[bytes] = []

    def note(request: Any) -> None:
        bodies.append(request.swallow())
        answer(202, {"id": "a", "state": "queued"})(request)

    fake.fail("POST", "avatars", note)
    (tmp_path / "Jane Doe.jpg").write_bytes(PHOTO)
    client.submit(tmp_path / "Jane Doe.jpg")
    assert PHOTO in bodies[0] and b"Jane" not in bodies[0]


def test_the_same_photo_and_options_are_the_same_job(client: Client, fake: Fake, tmp_path: Path) -> None:
    (tmp_path / "me.jpg").write_bytes(PHOTO)
    first = client.submit(PHOTO, {"seed": 1, "size": [96, 64]})
    assert client.submit(tmp_path / "me.jpg", {"size": [96, 64], "seed": 1}).id == first.id
    assert client.submit(PHOTO, {"seed": 2, "size": [96, 64]}).id != first.id
    assert client.submit(PHOTO + b".", {"seed": 1, "size": [96, 64]}).id != first.id
    assert client.submit(PHOTO, {"seed": 1, "size": [96, 64]}, key="mine").id != first.id
    assert idempotency_key(photo_sha256(PHOTO), "{}", 2) != idempotency_key(photo_sha256(PHOTO), "{}")


@pytest.mark.parametrize("options", [{"seed": float("nan")}, {"maps": {1, 2}}])
def test_options_that_json_does_not_have(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="JSON"):
        canonical(options)


def test_a_lost_answer_makes_no_second_job(client: Client, fake: Fake) -> None:
    """The server took the photo in and its answer was lost: the second attempt has the same key."""

    def take_and_hang_up(request: Any) -> None:
        request.reply = lambda *_: hang_up(request)
        request._submit()

    fake.fail("POST", "avatars", take_and_hang_up, answer(409, problem(409, "in-flight")))
    job = client.submit(PHOTO)
    assert list(fake.jobs) == [job.id]
    assert len(fake.requests("POST")) == 3
    assert fake.photos[job.id] == PHOTO, "the photo has to be read from its start for every attempt"


def test_busy_servers_are_asked_again_no_sooner_than_they_want(client: Client, fake: Fake, slept: list[float]) -> None:
    fake.fail(
        "POST",
        "avatars",
        answer(429, problem(429, "queue-full"), Retry_After="7"),
        answer(503, problem(503, "draining"), Retry_After="2"),
        answer(503),
        hang_up,
    )
    client.submit(PHOTO)
    assert 7 <= slept[0] < 9 and 2 <= slept[1] < 3
    assert len(slept) == 4


def test_a_server_that_stays_busy_is_given_up(client: Client, fake: Fake, slept: list[float]) -> None:
    fake.fail("POST", "avatars", *[answer(429, problem(429, "queue-full", "2000 jobs wait"), Retry_After="1")] * 8)
    with pytest.raises(ServerBusy, match="2000 jobs wait") as caught:
        client.submit(PHOTO)
    assert caught.value.retry_after == 1
    assert len(slept) == 7


def test_a_server_that_asks_for_an_hour_is_given_up_at_once(client: Client, fake: Fake, slept: list[float]) -> None:
    fake.fail("POST", "avatars", answer(429, problem(429, "quota"), Retry_After="3600"))
    with pytest.raises(ServerBusy) as caught:
        client.submit(PHOTO)
    assert caught.value.retry_after == 3600
    assert not slept


@pytest.mark.parametrize(
    ("status", "code", "kind"),
    [
        (413, "too-large", errors.TooManyBytes),
        (415, "unsupported-format", errors.UnsupportedFormat),
        (422, "corrupt-image", errors.CorruptImage),
        (422, "usage", errors.UsageError),
        (422, "key-reuse", Refused),
        (401, "no-key", AccessDenied),
        (500, "internal", Refused),
    ],
)
def test_what_will_not_get_better_is_not_asked_again(
    client: Client, fake: Fake, slept: list[float], status: int, code: str, kind: type[errors.AvatarError]
) -> None:
    fake.fail("POST", "avatars", answer(status, problem(status, code, "this was wrong")))
    with pytest.raises(kind, match="this was wrong"):
        client.submit(PHOTO)
    assert not slept


def test_a_refusal_in_the_middle_of_a_large_upload_is_read(client: Client, fake: Fake) -> None:
    """The server answers and hangs up while the photo is still on its way."""

    def refuse_early(request: Any) -> None:
        request.rfile.read(1 << 16)
        request.close_connection = True
        body = json.dumps(problem(413, "too-large", "at most 25 MB")).encode()
        request.reply(413, body, {"Content-Type": "application/problem+json", "Connection": "close"})
        request.connection.shutdown(socket.SHUT_WR)
        while request.rfile.read(1 << 20):
            pass

    fake.fail("POST", "avatars", refuse_early)
    with pytest.raises(errors.TooManyBytes, match="at most 25 MB"):
        client.submit(bytes(30_000_000))


def test_nobody_there(slept: list[float]) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
    with Client(address, retry=Retry(attempts=3, sleep=slept.append)) as client, pytest.raises(ServerUnreachable):
        client.ready()
    assert len(slept) == 2


def test_a_server_that_says_nothing(fake: Fake) -> None:
    fake.fail("GET", "readyz", lambda request: time.sleep(1))
    with Client(fake.url, retry=Retry(attempts=1), timeout_s=0.2) as client, pytest.raises(ServerUnreachable):
        client.ready()


@pytest.mark.parametrize(
    ("handler", "words"),
    [
        (lambda request: request.reply(200, b"<html>", {"Content-Type": "text/html"}), "text/html"),
        (lambda request: request.reply(200, b"[" * 50_000, {}), "JSON"),
        (lambda request: request.reply(302, b"", {"Location": "https://elsewhere.example"}), "elsewhere"),
        (answer(200, ["no", "object"]), "list"),
    ],
)
def test_another_kind_of_server(client: Client, fake: Fake, handler: Any, words: str) -> None:
    fake.fail("GET", "models", handler)
    with pytest.raises(UnexpectedAnswer, match=words):
        client.models()


def test_the_key_does_not_follow_a_redirection(client: Client, fake: Fake) -> None:
    fake.fail("GET", "quality", lambda request: request.reply(307, b"", {"Location": f"{fake.url}/v1/models"}))
    with pytest.raises(UnexpectedAnswer):
        client.quality()
    assert not fake.requests("GET", "models")


@pytest.mark.parametrize(
    "address",
    [
        "",
        "example.org",
        "ftp://example.org",
        "http://",
        "http://me:secret@example.org",
        "http://a.example/?x",
        "http://[::1",
        "http://a:99999",
    ],
)
def test_addresses_that_cannot_be_right(address: str) -> None:
    with pytest.raises(UsageError) as caught:
        Client(address)
    assert "secret" not in caught.value.message


@pytest.mark.parametrize("key", ["", "two words", "line\nfeed", "schlüssel"])
def test_keys_that_no_header_carries(key: str) -> None:
    with pytest.raises(UsageError) as caught:
        Client("http://a.example", api_key=key)
    assert not key or key not in caught.value.message


def test_an_address_with_a_path_before_v1(fake: Fake) -> None:
    fake.fail("GET", "^/heads/v1/models$", answer(200, {"models": []}))
    with Client(f"{fake.url}/heads/") as client:
        assert client.models() == {"models": []}


def test_facts_of_the_server(client: Client) -> None:
    assert client.models() == {"path": "/v1/models"}
    assert client.quality() == {"path": "/v1/quality"}
    client.ready()


def test_events_go_on_where_they_were_cut(client: Client, fake: Fake) -> None:
    fake.cut_events.extend([1, 2])
    job = client.submit(PHOTO)
    events = list(client.events(job.id))
    assert [event.id for event in events] == ["1", "2", "3", "4"], "each once, none lost"
    assert [seen.headers.get("Last-Event-ID") for seen in fake.requests("GET", "events$")] == [None, "1", "3"]
    assert events[-1].data["state"] == "succeeded"


def test_events_from_where_the_caller_was(client: Client) -> None:
    job = client.submit(PHOTO)
    assert [event.id for event in client.events(job.id, last_event_id="2")] == ["3", "4"]


def test_a_job_that_ended_while_nobody_listened(client: Client, fake: Fake) -> None:
    fake.stages = []
    fake.cut_events.extend([0])
    events = list(client.events(client.submit(PHOTO).id))
    assert [event.data["state"] for event in events] == ["succeeded"]


@pytest.mark.parametrize(
    "handler",
    [
        answer(404),
        answer(406),
        answer(200, {}),
        lambda request: request.reply(200, b"x", {"Content-Type": "text/html"}),
    ],
)
def test_where_no_stream_comes_through_the_client_asks(client: Client, fake: Fake, handler: Any) -> None:
    fake.fail("GET", "events", handler)
    told: list[str] = []
    done = client.wait(client.submit(PHOTO).id, progress=lambda stage, share: told.append(stage))
    assert done.state == "succeeded"
    assert told == [*fake.stages, ""]
    assert len(fake.requests("GET", "events")) == 1


def test_streams_that_always_break_are_given_up_and_the_client_asks(client: Client, fake: Fake) -> None:
    fake.stages = list("abcdefghij")
    fake.fail("GET", "events", *[hang_up] * 100)
    assert client.wait(client.submit(PHOTO).id).state == "succeeded"
    assert len(fake.requests("GET", "events")) == 4


def test_busy_with_events_is_not_the_end(client: Client, fake: Fake) -> None:
    fake.fail("GET", "events", answer(503, Retry_After="1"))
    assert client.wait(client.submit(PHOTO).id).state == "succeeded"


def test_a_silent_stream_is_left(fake: Fake, slept: list[float]) -> None:
    """A connection that is dead without a word would make the client wait for ever."""
    released = threading.Event()

    def silent(request: Any) -> None:
        request.send_response(200)
        request.send_header("Content-Type", "text/event-stream")
        request.end_headers()
        released.wait(5)
        request.close_connection = True

    fake.fail("GET", "events", silent)
    with Client(fake.url, retry=Retry(sleep=slept.append)) as client:
        job = client.submit(PHOTO)
        with pytest.raises(WaitTimedOut, match=job.id):
            client.wait(job.id, timeout_s=0.3)
    released.set()


def test_the_time_is_up_while_heartbeats_come(fake: Fake) -> None:
    def beating(request: Any) -> None:
        request.send_response(200)
        request.send_header("Content-Type", "text/event-stream")
        request.end_headers()
        for _ in range(500):
            request.wfile.write(b": heartbeat\n\n")
            time.sleep(0.02)
        request.close_connection = True

    fake.fail("GET", "events", beating)
    with Client(fake.url) as client:
        job = client.submit(PHOTO)
        begin = time.monotonic()
        with pytest.raises(WaitTimedOut):
            client.wait(job.id, timeout_s=0.2)
        assert time.monotonic() - begin < 5


@pytest.mark.parametrize(
    ("code", "kind"), [("no-face", errors.NoFace), ("crashed", JobFailed), ("something-new", JobFailed)]
)
def test_a_job_that_fails_says_why(client: Client, fake: Fake, code: str, kind: type[errors.AvatarError]) -> None:
    fake.error = problem(422, code, "this was wrong")
    with pytest.raises(kind, match="this was wrong"):
        client.wait(client.submit(PHOTO).id)


def test_a_job_that_was_cancelled(client: Client, fake: Fake) -> None:
    fake.end = "cancelled"
    with pytest.raises(JobCancelled):
        client.wait(client.submit(PHOTO).id)


def test_jobs_that_are_not_there(client: Client) -> None:
    with pytest.raises(NoSuchJob):
        client.state("f" * 32)
    with pytest.raises(NoSuchJob):
        client.wait("f" * 32)
    client.delete("f" * 32)
    with pytest.raises(UsageError):
        client.state("../../admin")


def test_a_photo_that_is_not_there(client: Client, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no-such"):
        client.submit(tmp_path / "no-such.jpg")
