"""The client against a server that answers as the contract says, late, wrongly or not at all."""

from __future__ import annotations

import json
import socket
from typing import Any

import pytest

from service import errors
from service.client.client import Client, Job, checked_id
from service.client.errors import (
    AccessDenied,
    Conflict,
    JobFailed,
    Problem,
    Refused,
    ServerBusy,
    UnexpectedAnswer,
)
from service.client.transport import retry_after_s
from service.errors import UsageError
from tests.service.client.fake import Fake, answer, hang_up, problem

PHOTO = b"the bytes of a photo"
JOB = "0" * 32


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
    assert all(seconds <= 4.5 for seconds in slept[2:])
    assert len(slept) == 4


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
    fake.fail("GET", "avatars", handler)
    with pytest.raises(UnexpectedAnswer, match=words):
        client.state(JOB)


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


def test_a_job_is_followed_to_its_end(client: Client, fake: Fake) -> None:
    told: list[str] = []
    done = client.wait(client.submit(PHOTO).id, progress=lambda stage, share: told.append(stage))
    assert done.state == "succeeded"
    assert told == [*fake.stages, ""]


@pytest.mark.parametrize(
    ("code", "kind"), [("no-face", errors.NoFace), ("crashed", JobFailed), ("something-new", JobFailed)]
)
def test_a_job_that_fails_says_why(client: Client, fake: Fake, code: str, kind: type[errors.AvatarError]) -> None:
    fake.error = problem(422, code, "this was wrong")
    with pytest.raises(kind, match="this was wrong"):
        client.wait(client.submit(PHOTO).id)


def test_an_answer_without_end_does_not_fill_the_memory(client: Client, fake: Fake) -> None:
    def endless(request: Any) -> None:
        request.send_response(200)
        request.end_headers()
        request.close_connection = True
        for _ in range(400):
            request.wfile.write(bytes(1 << 16))

    fake.fail("GET", "avatars", endless)
    with pytest.raises(UnexpectedAnswer, match="longer"):
        client.state(JOB)


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        ("0", 0.0),
        (" 7 ", 7.0),
        ("Fri, 02 Jan 2026 11:00:00 GMT", 0.0),  # past: now, not minus an hour
        ("Fri, 02 Jan 2026 11:00:00 -0000", 0.0),
        ("-5", None),
        ("soon", None),
        ("1.5", None),
        ("9" * 400, None),  # would overflow a float, and sleep for ever
        ("٣", None),  # a digit to str.isdigit, not to HTTP
    ],
)
def test_retry_after(value: str, seconds: float | None) -> None:
    assert retry_after_s({"Retry-After": value}) == seconds
    assert retry_after_s({}) is None


@pytest.mark.parametrize(
    ("content", "code"),
    [
        ({"type": "/problems/no-face", "code": "other"}, "other"),
        ({"type": "/problems/no-face"}, "no-face"),
        ({"type": "https://example.org/problems#no-face"}, "no-face"),
        ({"type": "urn:problem:no-face/"}, "no-face"),
        ({"type": "about:blank"}, "http-418"),
        ({"type": 5, "title": ["x"], "detail": None, "code": 7}, "http-418"),
        ({}, "http-418"),
        (None, "http-418"),
        (["no-face"], "http-418"),
        ("<html>", "http-418"),
    ],
)
def test_the_code_of_a_problem(content: object, code: str) -> None:
    """Members of a wrong type are ignored (RFC 9457, section 3.1): a broken error must not hide the error."""
    parsed = Problem.parse(content, 418)
    assert parsed.code == code
    assert parsed.message


@pytest.mark.parametrize(
    "content", [None, [], {"id": "a", "state": "new"}, {"state": "queued"}, {"id": 5, "state": "queued"}]
)
def test_what_is_no_state_is_refused(content: object) -> None:
    with pytest.raises(UnexpectedAnswer):
        Job.parse(content)


@pytest.mark.parametrize("value", ["../x", "a/b", "", "a" * 129, "a?b", "a b", "-a", None, "ä"])
def test_an_id_cannot_lead_elsewhere(value: object) -> None:
    """It becomes a part of the address of the next request, which carries the API key."""
    with pytest.raises(UnexpectedAnswer):
        checked_id(value)


def test_refusals_are_exceptions(client: Client, fake: Fake) -> None:
    fake.fail(
        "GET", "avatars", answer(409, problem(409, "not-ready")),
        answer(422, problem(422, "usage", "size is too small", pointer="/size")),
    )  # fmt: skip
    with pytest.raises(Conflict):
        client.state(JOB)
    with pytest.raises(UsageError, match="too small") as refused:
        client.state(JOB)
    assert refused.value.extra["field"] == "size"
    with pytest.raises(UsageError):
        client.state("../x")
