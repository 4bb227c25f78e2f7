"""``POST /v1/renders``: what is refused at the door, and a picture from a real child process."""

from __future__ import annotations

import io
import json
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.api import renders
from service.api.context import Context
from service.api.keys import new_key
from service.archive.pack import archive_members
from service.archive.reading import open_avatar
from service.jobs.artifacts import artifact_name, sha256_of
from service.jobs.process import Ending
from service.jobs.settings import Settings
from service.jobs.wire import Task
from service.render import child
from service.render.render import Picture, render_head
from service.render.request import RenderRequest
from service.render.surface import ROLES
from tests.service.api.conftest import TOY, Api, is_problem, open_api
from tests.service.archive.toys import toy_avatar
from tests.service.render.toys import ROUGH


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    data = tmp_path_factory.mktemp("renders") / "data"
    with open_api(Settings(data=data, program=TOY, reserve_mb=1, render_seconds=240.0, niceness=0)) as client:
        yield Api(client)


@pytest.fixture(scope="module")
def finished(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A job whose archive is that of a toy head."""
    job: str = api.post(options={"seed": 1}).json()["id"]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in archive_members(toy_avatar()).items():
            archive.writestr(name, data)
    stream.seek(0)
    digest = sha256_of(stream)
    path = tmp_path_factory.mktemp("archive") / "avatar.zip"
    path.write_bytes(stream.getvalue())
    name = artifact_name(job, "archive", digest, "zip")
    api.context.artifacts.put(path, name)
    api.context.store.begin(job)
    facts = {
        "archive": name, "sha256": digest, "bytes": len(stream.getvalue()), "warnings": [], "timings": {},
        "peak_rss_mb": 1.0,
    }  # fmt: skip
    assert api.context.store.succeed(job, facts, 1e10)
    return job


def ask(api: Api, content: Any = None, **headers: str) -> httpx2.Response:
    text = content if isinstance(content, str | bytes) else json.dumps(content)
    return api.client.post("/v1/renders", content=text, headers={"Content-Type": "application/json", **headers})


WANTED = {
    "scene": {
        "environment": {"zenith": [1, 1, 1], "horizon": [1, 1, 1], "ground": [1, 1, 1]},
        "response": {"exposure": 0.5},
    },
    "size": [32, 40], "view": 30, "samples": 1, "background": "transparent",
}  # fmt: skip


def is_picture(api: Api, answer: httpx2.Response) -> None:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/png"
    assert answer.headers["cache-control"] == "no-store"
    assert answer.content[:8] == b"\x89PNG\r\n\x1a\n"
    assert (answer.content[16:24], answer.content[25]) == (b"\0\0\0\x20\0\0\0\x28", 6)
    facts = json.loads(answer.headers["render-facts"])
    assert facts["exposure"] == 0.5
    assert "diffuse_albedo-from-texture" in facts["fallbacks"]
    assert not list((api.context.settings.data / "incoming").iterdir())


def test_a_finished_avatar_is_rendered(api: Api, finished: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The child's program, here: what it is told, what it writes, what it says."""

    class Said:
        facts: dict[str, Any]

        def done(self, facts: dict[str, Any]) -> None:
            self.facts = facts

    def run(context: Context, task: Task, stop: threading.Event) -> Ending:
        said = Said()
        child.run(Task(**json.loads(task.line())), said)  # type: ignore[arg-type]
        return Ending("done", said.facts, 0)

    def rough(source: Any, request: RenderRequest) -> Picture:
        avatar = open_avatar(source, ROLES)
        head = avatar.mesh.as_head("toy", "CC0-1.0")
        return render_head(head, avatar.mesh.vertices, avatar.maps, request, threads=1, detail=ROUGH)

    monkeypatch.setattr(renders, "_run", run)
    monkeypatch.setattr("service.render.render.render_archive", rough)
    is_picture(api, ask(api, {"avatar": finished, **WANTED}))


@pytest.mark.slow
def test_a_picture_from_a_process_of_its_own(api: Api, finished: str) -> None:
    is_picture(api, ask(api, {"avatar": finished, **WANTED}))


def test_a_fault_of_the_renderer_is_a_problem(api: Api, finished: str) -> None:
    """Found by the child only: it knows the names of environments."""
    body = is_problem(ask(api, {"avatar": finished, "scene": {"environment": {"name": "nowhere"}}}), 422, "usage")
    assert "apartment" in body["detail"]
    assert body["instance"] == "/v1/renders"


@pytest.mark.parametrize(
    ("content", "status", "code", "pointer"),
    [
        ("[", 422, "malformed-render", ""),
        ("[]", 422, "malformed-render", ""),
        ('{"avatar": "x", "tolerance": NaN}', 422, "malformed-render", "/tolerance"),
        ("[" * 100_000, 422, "malformed-render", ""),
        ({}, 422, "usage", "/avatar"),
        ({"avatar": 3}, 422, "usage", "/avatar"),
        ({"avatar": "x" * 32, "colour": "red"}, 422, "usage", "/colour"),
        ({"avatar": "x" * 32, "size": [4, 4]}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "size": "big"}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "size": [4096, 4096]}, 422, "usage", "/size"),
        ({"avatar": "x" * 32, "samples": True}, 422, "usage", "/samples"),
        ({"avatar": "x" * 32, "view": []}, 422, "usage", "/view"),
        ({"avatar": "x" * 32, "scene": {"lamps": []}}, 422, "usage", None),
        (
            {"avatar": "x" * 32, "scene": {"lights": [{"position_m": [0, 0], "intensity": [1, 1, 1]}]}},
            422,
            "usage",
            None,
        ),
        ({"avatar": "x" * 32}, 404, "not-found", None),
        ({"avatar": "../../etc"}, 404, "not-found", None),
    ],
)
def test_what_is_wrong_is_said(api: Api, content: Any, status: int, code: str, pointer: str | None) -> None:
    body = is_problem(ask(api, content), status, code)
    if pointer is not None:
        assert body.get("pointer", "") == pointer


def test_other_kinds_of_body_and_large_ones_are_refused(api: Api) -> None:
    is_problem(ask(api, "{}", **{"Content-Type": "text/plain"}), 415, "unsupported-media-type")
    is_problem(ask(api, b" " * (renders.MAX_BODY + 1)), 413, "too-large")


def test_an_unfinished_avatar_is_not_rendered(api: Api) -> None:
    job = api.post(options={"seed": 2}).json()["id"]
    is_problem(ask(api, {"avatar": job}), 409, "not-ready")


def test_only_so_many_at_a_time(api: Api, finished: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api.context, "renders", api.context.settings.renders)
    answer = ask(api, {"avatar": finished})
    is_problem(answer, 503, "busy")
    assert answer.headers["retry-after"] == "5"


@pytest.mark.parametrize(
    ("kind", "status", "code"),
    [("time", 504, "render-timeout"), ("memory", 500, "out-of-memory"), ("crash", 500, "crashed")],
)
def test_a_process_that_ends_without_a_picture(
    api: Api, finished: str, monkeypatch: pytest.MonkeyPatch, kind: str, status: int, code: str
) -> None:
    monkeypatch.setattr(renders, "_run", lambda context, task, stop: Ending(kind, {}, -9))
    is_problem(ask(api, {"avatar": finished}), status, code)
    assert api.context.renders == 0


def test_a_slow_picture_is_ended_at_its_deadline(api: Api, finished: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The child is killed while it still loads."""
    import dataclasses

    monkeypatch.setattr(api.context, "settings", dataclasses.replace(api.context.settings, render_seconds=0.05))
    is_problem(ask(api, {"avatar": finished, "size": [64, 64]}), 504, "render-timeout")


def test_a_caller_that_goes_away_ends_the_work(api: Api, finished: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from starlette.requests import Request

    stopped = threading.Event()

    def run(context: object, task: object, stop: threading.Event) -> Ending:
        assert stop.wait(20)
        stopped.set()
        return Ending("stopped", {}, 0)

    async def gone(self: Request) -> bool:
        return True

    monkeypatch.setattr(renders, "_run", run)
    monkeypatch.setattr(Request, "is_disconnected", gone)
    ask(api, {"avatar": finished})
    assert stopped.is_set()


def test_avatars_of_others_are_not_there(tmp_path: Path) -> None:
    keys = [new_key(name) for name in ("one", "two")]
    file = tmp_path / "keys.json"
    file.write_text(json.dumps({"keys": [entry for _, entry in keys]}))
    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, keys=str(file))) as client:
        api = Api(client)
        job = api.post(Authorization=f"Bearer {keys[0][0]}").json()["id"]
        is_problem(ask(api, {"avatar": job}), 401, "unauthorized")
        is_problem(ask(api, {"avatar": job}, Authorization=f"Bearer {keys[1][0]}"), 404, "not-found")
        is_problem(ask(api, {"avatar": job}, Authorization=f"Bearer {keys[0][0]}"), 409, "not-ready")


def test_it_is_in_the_description(api: Api) -> None:
    described = api.client.get("/openapi.json").json()
    operation = described["paths"]["/v1/renders"]["post"]
    schema = described["components"]["schemas"]["Render"]
    assert operation["requestBody"]["content"]["application/json"]["schema"]["$ref"].endswith("/Render")
    assert {"avatar", "scene", "size", "view", "background", "samples", "tolerance"} == set(schema["properties"])
    assert "image/png" in operation["responses"]["200"]["content"]
    assert {"Scene", "PointLight", "Environment"} <= set(described["components"]["schemas"])
