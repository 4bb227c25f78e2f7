"""A kind of job more: an entry in the table of kinds, a program and two routes are all that it takes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI, Request
from starlette.responses import JSONResponse, Response
from starlette.testclient import TestClient

from service.api.app import create_app
from service.api.context import Asking, Here
from service.api.renders_and_exports import asked, made, whole
from service.jobs.database import JOBS
from service.jobs.kinds import KINDS, Kind
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from service.jobs.view import job_json
from tests.service.api.conftest import TOY, TOY_PICTURE, Api, is_problem
from tests.service.api.test_renders import with_result
from tests.service.databases import lay_out
from tests.support.toy_picture import picture

FILM = Kind(
    name="turntable", place="turntables", artifact="film", file="film.gif", program="render_program",
    seconds="render_seconds", at_a_time="renders", slow="the film took more than {seconds:g} s; ask for fewer frames",
)  # fmt: skip


def add_routes(app: FastAPI) -> None:
    @app.post("/v1/turntables")
    async def post(request: Request, tenant: Asking, context: Here) -> Response:
        avatar, values = await asked(request, context, FILM)
        row = await made(request, context, tenant, FILM, avatar, values, 0.1)
        return row if isinstance(row, Response) else whole(context, row, "image/gif", {})

    @app.get("/v1/turntables/{film}")
    def state(film: str, tenant: Asking, context: Here) -> Response:
        return JSONResponse(job_json(context.job(film, tenant, FILM.name)))


def worked(api: Api, seconds: float = 200.0) -> list[str]:
    """What a worker does with all that waits, here; returns the ids."""
    settings = dataclasses.replace(api.context.settings, render_program=TOY_PICTURE, render_seconds=seconds)
    runner = Runner(settings, api.context.store, api.context.artifacts)
    rows = api.context.store.where(JOBS.c.kind == FILM.name, JOBS.c.state == "queued")
    for row in rows:
        assert runner.accept(row["workflow"])["kind"] == "wanted"
        runner.publish(row["id"], runner.make(row["id"]))
    runner.stop()
    return [row["id"] for row in rows]


def test_a_film_is_a_job_like_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, FILM.name, FILM)
    settings = Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, max_unfinished=2)
    lay_out(settings.data)
    app = create_app(settings)
    add_routes(app)
    with TestClient(app, base_url="http://localhost", raise_server_exceptions=False) as client:
        api = Api(client)
        avatar = with_result(api, tmp_path)

        def ask(**wanted: Any) -> Any:
            return client.post("/v1/turntables", json={"avatar": avatar, **wanted})

        waiting = ask(target="short")
        assert waiting.status_code == 202
        assert waiting.headers["location"].startswith("/v1/turntables/")
        assert ask(target="short").json()["id"] == waiting.json()["id"], "the same film is made once"
        assert ask(target="long").status_code == 202
        is_problem(ask(target="third"), 429, "quota")
        assert worked(api)[0] == waiting.json()["id"]
        film = ask(target="short")
        assert (film.status_code, film.headers["content-type"]) == (200, "image/gif")
        assert film.content == picture({"target": "short"})
        assert film.headers["content-location"] == waiting.headers["location"]
        links = client.get(waiting.headers["location"]).json()["links"]
        assert links["film"] == waiting.headers["location"] + "/film.gif"
        assert links["avatar"] == f"/v1/avatars/{avatar}"
        assert ask(view="left").status_code == 202
        worked(api, 1.0)
        late = client.get(f"/v1/turntables/{api.context.store.where(JOBS.c.kind == FILM.name)[-1]['id']}").json()
        assert (late["state"], late["error"]["code"]) == ("failed", "turntable-timeout")
        assert "fewer frames" in late["error"]["detail"]
        assert ask(view="left").status_code == 202, "what failed may be asked for again"
        assert client.delete(f"/v1/avatars/{avatar}").status_code == 204
        assert client.get(waiting.headers["location"]).status_code == 410, "it goes with its avatar"
