"""The HTTP application: routes, problems, the page."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import Depends, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from service import __version__
from service.api import avatars, downloads, info, problem_responses, renders_and_exports
from service.api.context import Context
from service.api.front import Front, Heads, no_strange_parameters
from service.api.openapi import described
from service.jobs.settings import Settings
from service.photo.gate import expect_photo

PAGE = Path(__file__).parents[1] / "web" / "static"
"""Folder of the page at ``/``."""


def create_app(settings: Settings, page: Path = PAGE) -> FastAPI:
    """The application.

    Args:
        settings: of the server.
        page: folder of static files for ``/``.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        context = await run_in_threadpool(Context, settings)
        app.state.context = context
        await run_in_threadpool(expect_photo)
        try:
            yield
        finally:
            context.draining.set()
            context.watcher.wake_all()
            await run_in_threadpool(context.close)

    app = FastAPI(
        title="avatarme", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None,
        description="One photo of a face in, a renderable head out.", redirect_slashes=False,
    )  # fmt: skip
    problem_responses.install(app)
    app.add_middleware(Heads)
    app.add_middleware(Front, settings=settings)
    derived = (renders_and_exports.renders, renders_and_exports.exports)
    for router in (avatars.router, downloads.router, *derived, info.router):
        app.include_router(router, dependencies=[Depends(no_strange_parameters)])
    _serve_page(app, page)
    app.openapi = lambda: described(app)  # type: ignore[method-assign]
    return app


class _Page(StaticFiles):
    """Files that a browser may keep, and has to ask about each time: a new version is seen at once."""

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        """The answer with a static file, with ``Cache-Control``."""
        answer = super().file_response(*arguments, **named)
        answer.headers["Cache-Control"] = "no-cache"
        return answer


def _serve_page(app: FastAPI, page: Path) -> None:
    if (page / "index.html").is_file():
        files = _Page(directory=page, html=True)
        # Not one mount for all: it would take every address of the interface that is asked for with a wrong method.
        for path in ("", *sorted(file.relative_to(page).as_posix() for file in page.rglob("*") if file.is_file())):
            app.router.routes.append(Route(f"/{path}", files, methods=["GET", "HEAD"], include_in_schema=False))
        return

    @app.get("/", include_in_schema=False)
    async def no_page() -> Response:
        links = {"openapi": "/openapi.json", "avatars": "/v1/avatars", "ready": "/readyz"}
        return JSONResponse({"name": "avatarme", "version": __version__, "page": "not installed", "links": links})
