"""``Client.render`` against a small server."""

from __future__ import annotations

import json
from typing import Any

import pytest

from service.client.client import Client
from service.client.errors import Conflict, UnexpectedAnswer
from service.errors import UsageError
from tests.service.client.fake import Fake, _Handler, answer, problem

JOB = "0" * 32
PNG = b"\x89PNG\r\n\x1a\n" + bytes(100)


def gives(body: bytes, asked: list[dict[str, object]]) -> object:
    def handle(request: _Handler) -> None:
        length = int(request.headers["Content-Length"])
        asked.append(json.loads(request.rfile.read(length)))
        request.reply(200, body, {"Content-Type": "image/png"})

    return handle


def test_a_picture_comes_back_after_a_busy_server(client: Client, fake: Fake, slept: list[float]) -> None:
    asked: list[dict[str, object]] = []
    fake.fail("POST", "/v1/renders", answer(503, problem(503, "busy"), Retry_After="5"), gives(PNG, asked))  # type: ignore[arg-type]
    scene = {"environment": {"name": "studio"}}
    assert client.render(JOB, scene, size=[64, 64], view="left") == PNG
    assert asked == [{"avatar": JOB, "scene": scene, "size": [64, 64], "view": "left"}]
    assert slept and slept[0] >= 5
    assert fake.requests("POST", "/v1/renders")[0].headers["Content-Type"] == "application/json"


def test_a_picture_that_takes_long_is_waited_for(client: Client, fake: Fake) -> None:
    job: dict[str, Any] = {"id": "1" * 32, "state": "queued", "links": {}, "error": None}
    fake.fail("POST", "/v1/renders", answer(202, job))
    fake.fail(
        "GET", "/v1/renders/1+$", answer(200, {**job, "state": "running"}), answer(200, {**job, "state": "succeeded"})
    )

    def gives_picture(request: _Handler) -> None:
        request.reply(200, PNG, {"Content-Type": "image/png"})

    fake.fail("GET", "picture.png", gives_picture)
    assert client.render(JOB) == PNG


def test_what_is_no_picture_is_noticed(client: Client, fake: Fake) -> None:
    fake.fail("POST", "/v1/renders", gives(b"<html>", []))  # type: ignore[arg-type]
    with pytest.raises(UnexpectedAnswer, match="PNG"):
        client.render(JOB)


def test_refusals_are_exceptions(client: Client, fake: Fake) -> None:
    fake.fail(
        "POST", "/v1/renders", answer(409, problem(409, "not-ready")),
        answer(422, problem(422, "usage", "size is too small", pointer="/size")),
    )  # fmt: skip
    with pytest.raises(Conflict):
        client.render(JOB)
    with pytest.raises(UsageError, match="too small") as refused:
        client.render(JOB, size=[1, 1])
    assert refused.value.extra["field"] == "size"
    with pytest.raises(UsageError):
        client.render("../x")
