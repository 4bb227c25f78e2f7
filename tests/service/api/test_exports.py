"""``/v1/exports``: what is refused at the door, kits as jobs, and one from a real child process."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.archive.pack import write_archive
from service.jobs.settings import Settings
from service.kits.export import export_kit
from tests.service.api.conftest import TOY, Api, is_problem, open_api
from tests.service.archive.toys import whole_avatar

EXPORTS = "/v1/exports"


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


def test_a_kit_is_that_of_the_command_line_and_made_once(api: Api, archive: Path, tmp_path: Path) -> None:
    """By a process of its own, as a worker does it."""
    avatar = api.finished(archive.read_bytes())
    wanted = {"avatar": avatar, "for": "blender"}
    waiting = api.ask(EXPORTS, wanted)
    assert waiting.status_code == 202
    place = waiting.headers["location"]
    assert place == f"/v1/exports/{waiting.json()['id']}"
    assert api.ask(EXPORTS, wanted).json()["id"] == waiting.json()["id"], "cached by content"
    is_problem(api.client.get(f"{place}/kit.zip"), 409, "not-ready")
    api.work("export")
    ready = api.ask(EXPORTS, wanted)
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
    again = api.ask(EXPORTS, wanted).headers["location"]
    assert again != place, "what was erased is made anew"
    api.work("export")
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
    body = is_problem(api.ask(EXPORTS, content), status, code)
    if pointer is not None:
        assert body.get("pointer", "") == pointer
