"""``/v1/renders``: what is refused at the door, pictures as jobs, and one from a real child process."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.renders_and_exports import MAX_BODY
from service.archive.pack import write_archive
from service.jobs.database import JOBS
from service.jobs.settings import Settings
from tests.service.api.conftest import TOY, TOY_PICTURE, Api, is_problem, open_api
from tests.service.archive.toys import toy_avatar
from tests.support.server import Server, in_threads, post, small_photo, wait_for
from tests.support.toy_picture import picture

RENDERS = "/v1/renders"
LAMP = "/scene/lights/0/intensity/1"


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    data = tmp_path_factory.mktemp("renders") / "data"
    with open_api(Settings(data=data, program=TOY, reserve_mb=1, render_seconds=240.0, niceness=0)) as client:
        yield Api(client)


def toy_archive() -> bytes:
    stream = io.BytesIO()
    write_archive(toy_avatar(), stream)
    return stream.getvalue()


@pytest.fixture(scope="module")
def finished(api: Api) -> str:
    return api.finished(toy_archive())


def test_a_picture_is_a_job_and_made_once(api: Api, finished: str) -> None:
    """Cached by content: whoever asks for the same again gets the same, and no worker hears of it."""
    content = {"avatar": finished, "size": [64, 64], "view": "front"}
    first, again = api.ask(RENDERS, content, Prefer="respond-async"), api.ask(RENDERS, content, Prefer="respond-async")
    assert first.status_code == again.status_code == 202
    assert first.json()["id"] == again.json()["id"]
    place = first.headers["location"]
    assert api.client.get(place).json()["state"] == "queued"
    is_problem(api.client.get(f"{place}/picture.png"), 409, "not-ready")
    api.work("render", archive_program=TOY_PICTURE)
    answer = api.ask(RENDERS, dict(reversed(content.items())))
    assert (answer.status_code, answer.headers["content-location"]) == (200, place)
    assert json.loads(answer.headers["render-facts"])["exposure"] == 0.5
    job = api.client.get(place).json()
    assert job["state"] == "succeeded"
    assert job["links"]["avatar"] == f"/v1/avatars/{finished}"
    picture = api.client.get(job["links"]["picture"])
    assert picture.content == answer.content
    assert (
        api.client.get(job["links"]["picture"], headers={"If-None-Match": picture.headers["etag"]}).status_code == 304
    )
    other = api.ask(RENDERS, {**content, "view": "back"}, Prefer="respond-async")
    assert other.json()["id"] != first.json()["id"]
    api.client.delete(other.headers["location"])


def test_a_picture_is_no_avatar_and_no_avatar_a_picture(api: Api, finished: str) -> None:
    job = api.ask(RENDERS, {"avatar": finished, "size": [65, 64]}, Prefer="respond-async").json()["id"]
    is_problem(api.client.get(f"/v1/avatars/{job}"), 404, "not-found")
    is_problem(api.client.get(f"/v1/renders/{finished}"), 404, "not-found")
    is_problem(api.client.delete(f"/v1/renders/{finished}"), 404, "not-found")
    assert job not in api.client.get("/v1/avatars?limit=100").text
    assert api.client.delete(f"/v1/renders/{job}").status_code == 204
    assert api.client.get(f"/v1/renders/{job}").json()["state"] == "cancelled"


def test_a_request_waits_for_its_picture(server: Server, client: httpx.Client, tmp_path: Path) -> None:
    job = post(client, small_photo(77)).json()["id"]
    wait_for(client, job)
    answer = client.post("/v1/renders", json={"avatar": job, "view": "front"})
    assert answer.status_code == 200, answer.text
    assert answer.content == picture({"view": "front"})
    is_problem(client.post("/v1/renders", json={"avatar": job, "view": "back"}), 500, "internal")
    begin = time.monotonic()
    answers = in_threads(3, lambda n: client.post("/v1/renders", json={"avatar": job, "size": [64, 64 + n]}))
    assert [one.status_code for one in answers] == [200] * 3, "they wait for each other, and none is turned away"
    assert time.monotonic() - begin < 60


def test_erasing_an_avatar_erases_its_pictures(server: Server, client: httpx.Client) -> None:
    job = post(client, small_photo(78)).json()["id"]
    wait_for(client, job)
    place = client.post("/v1/renders", json={"avatar": job}).headers["content-location"]
    assert client.delete(f"/v1/avatars/{job}").status_code == 204
    is_problem(client.get(place), 410, "gone")
    assert not any((server.data / "artifacts" / place.rpartition("/")[2]).glob("*"))


def test_a_picture_counts_in_the_quota(tmp_path: Path) -> None:
    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, max_unfinished=2)) as client:
        api = Api(client)
        job = api.finished(toy_archive())
        for view in ("front", "left"):
            assert api.ask(RENDERS, {"avatar": job, "view": view}, Prefer="respond-async").status_code == 202
        is_problem(api.ask(RENDERS, {"avatar": job, "view": "right"}), 429, "quota")
        is_problem(api.post(), 429, "quota")
        there = api.ask(RENDERS, {"avatar": job, "view": "front"}, Prefer="respond-async")
        assert there.status_code == 202, "it was asked for before"


def test_a_slow_picture_is_ended_at_its_deadline(api: Api, finished: str) -> None:
    api.ask(RENDERS, {"avatar": finished, "view": "left"}, Prefer="respond-async")
    api.work("render", archive_program=TOY_PICTURE, render_seconds=0.5)
    row = api.context.store.where(JOBS.c.kind == "render", JOBS.c.state == "failed")[-1]
    assert json.loads(row["error"])["code"] == "render-timeout"


def test_a_fault_of_the_renderer_is_a_problem(api: Api, finished: str) -> None:
    """Found by the child only: it knows where the head is."""
    content = {"avatar": finished, "scene": {"environment": {"name": "studio"}, "viewpoints": [[0, 0, 0.01]]}}
    job = api.ask(RENDERS, content, Prefer="respond-async").json()["id"]
    api.work("render", archive_program="service.jobs.archive_process")
    error = api.client.get(f"/v1/renders/{job}").json()["error"]
    assert (error["code"], error["status"]) == ("usage", 422)
    assert "viewpoint" in error["detail"]


def scene(**parts: Any) -> dict[str, Any]:
    return {"avatar": "x" * 32, "scene": parts}


@pytest.mark.parametrize(
    ("content", "status", "code", "pointer"),
    [
        ("[", 422, "malformed-render", ""),
        ("[]", 422, "malformed-render", ""),
        ('{"avatar": "x", "tolerance": NaN}', 422, "malformed-render", ""),
        ("[" * 100_000, 422, "malformed-render", ""),
        ({}, 422, "usage", "/avatar"),
        ({"avatar": 3}, 422, "usage", "/avatar"),
        ({"avatar": "x" * 32, "colour": "red"}, 422, "usage", "/colour"),
        ({"avatar": "x" * 32, "size": [4, 4]}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "size": "big"}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "size": [4096, 4096]}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "size": [1]}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "samples": True}, 422, "usage", "/samples"),
        ({"avatar": "x" * 32, "view": []}, 422, "usage", "/view"),
        ({"avatar": "x" * 32, "view": "../../etc/passwd"}, 422, "usage", "/view"),
        ({"avatar": "x" * 32, "view": 10**400}, 422, "malformed-render", ""),
        (scene(environment={"name": "../../etc/passwd"}), 422, "usage", "/scene/environment/name"),
        (scene(environment={"softboxes": [{}]}), 422, "usage", "/scene/environment/softboxes/0/direction"),
        (scene(lights=[{"position_m": [0, 0, 1], "intensity": [1, "x", 1]}]), 422, "usage", LAMP),
        (scene(lights=[{"position_m": [0, 0], "intensity": [1, 1, 1]}]), 422, "usage", None),
        (scene(lamps=[]), 422, "usage", None),
        ({"avatar": "x" * 32}, 404, "not-found", None),
        ({"avatar": "../../etc"}, 404, "not-found", None),
    ],
)
def test_what_is_wrong_is_said(api: Api, content: Any, status: int, code: str, pointer: str | None) -> None:
    body = is_problem(api.ask(RENDERS, content), status, code)
    if pointer is not None:
        assert body.get("pointer", "") == pointer
    assert not any(word in body["detail"] for word in ("True", "None", ",)", "__init__", "Traceback")), body


def test_other_kinds_of_body_and_large_ones_are_refused(api: Api) -> None:
    is_problem(api.ask(RENDERS, "{}", **{"Content-Type": "text/plain"}), 415, "unsupported-media-type")
    is_problem(api.ask(RENDERS, b" " * (MAX_BODY + 1)), 413, "too-large")
