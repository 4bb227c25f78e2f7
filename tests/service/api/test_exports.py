"""``/v1/exports``: what is refused at the door, kits as jobs, and one from a real child process."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.archive.pack import write_archive
from service.jobs.artifacts import artifact_name
from service.jobs.database import JOBS
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from service.kits.export import export_kit
from service.places import sha256_of
from tests.service.api.conftest import TOY, Api, is_problem, open_api
from tests.service.archive.toys import whole_avatar


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("archive") / "toy.zip"
    write_archive(whole_avatar(), path)
    return path


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    settings = Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, max_unfinished=2, niceness=0)
    with open_api(settings) as client:
        yield Api(client)


def finished(api: Api, archive: Path, folder: Path, **headers: str) -> str:
    """A job whose archive is this one."""
    job: str = api.post(**headers).json()["id"]
    copy = folder / "copy.zip"
    copy.write_bytes(archive.read_bytes())
    size = copy.stat().st_size
    with copy.open("rb") as stream:
        digest = sha256_of(stream)
    name = artifact_name(job, "archive", digest, "zip")
    api.context.artifacts.put(copy, name)
    api.context.store.begin(f"{job}.1")
    facts = {"archive": name, "sha256": digest, "bytes": size, "warnings": [], "timings": {}, "peak_rss_mb": 1.0}
    assert api.context.store.succeed(job, facts, 1e10)
    return job


def ask(api: Api, content: Any, **headers: str) -> httpx2.Response:
    text = content if isinstance(content, str) else json.dumps(content)
    return api.client.post("/v1/exports", content=text, headers={"Content-Type": "application/json", **headers})


def worked(api: Api, **settings: Any) -> None:
    """What a worker does with all kits that wait, here."""
    runner = Runner(dataclasses.replace(api.context.settings, **settings), api.context.store, api.context.artifacts)
    for row in api.context.store.where(JOBS.c.kind == "export", JOBS.c.state == "queued"):
        assert runner.accept(row["workflow"])["kind"] == "wanted"
        runner.publish(row["id"], runner.make(row["id"]))
    runner.stop()


def test_a_kit_is_that_of_the_command_line_and_made_once(api: Api, archive: Path, tmp_path: Path) -> None:
    """By a process of its own, as a worker does it."""
    avatar = finished(api, archive, tmp_path)
    wanted = {"avatar": avatar, "for": "blender"}
    waiting = ask(api, wanted)
    assert waiting.status_code == 202
    place = waiting.headers["location"]
    assert place == f"/v1/exports/{waiting.json()['id']}"
    assert ask(api, wanted).json()["id"] == waiting.json()["id"], "cached by content"
    is_problem(api.client.get(f"{place}/kit.zip"), 409, "not-ready")
    worked(api)
    ready = ask(api, wanted)
    assert (ready.status_code, ready.headers["content-location"]) == (200, place), ready.text
    job = ready.json()
    assert (job["state"], job["request"]) == ("succeeded", {"for": "blender"})
    assert job["links"] == {"self": place, "avatar": f"/v1/avatars/{avatar}", "kit": f"{place}/kit.zip"}

    answer = api.client.get(job["links"]["kit"])
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/zip")
    assert f"avatar-{avatar[:8]}-blender.zip" in answer.headers["content-disposition"]
    local = export_kit(archive, "blender", tmp_path / "kit")
    with zipfile.ZipFile(io.BytesIO(answer.content)) as kit:
        assert {name: kit.read(name) for name in kit.namelist()} == {
            path.relative_to(local.folder).as_posix(): path.read_bytes() for path in local.files
        }
    etag = {"If-None-Match": answer.headers["etag"]}
    assert api.client.get(job["links"]["kit"], headers=etag).status_code == 304
    part = api.client.get(job["links"]["kit"], headers={"Range": "bytes=2-5"})
    assert (part.status_code, part.content) == (206, answer.content[2:6])
    assert api.client.head(job["links"]["kit"]).headers["content-length"] == str(len(answer.content))

    assert api.client.delete(place).status_code == 204
    again = ask(api, wanted).headers["location"]
    assert again != place, "what was erased is made anew"
    worked(api)
    assert api.client.get(f"{again}/kit.zip").headers["etag"] == answer.headers["etag"], "of the same bytes"


@pytest.mark.parametrize(
    ("content", "status", "code", "pointer"),
    [
        ("[", 422, "malformed-export", ""),
        ({"for": "maya"}, 422, "usage", "/avatar"),
        ({"avatar": "x" * 32}, 422, "usage", "/for"),
        ({"avatar": "x" * 32, "for": "paint"}, 422, "usage", "/for"),
        ({"avatar": "x" * 32, "for": ["maya"]}, 422, "usage", "/for"),
        ({"avatar": "x" * 32, "for": "maya", "size": 3}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "for": "maya"}, 404, "not-found", None),
    ],
)
def test_what_is_wrong_is_said(api: Api, content: Any, status: int, code: str, pointer: str | None) -> None:
    body = is_problem(ask(api, content), status, code)
    if pointer is not None:
        assert body.get("pointer", "") == pointer
