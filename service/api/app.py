"""The HTTP application: routes, problems, the page, the description."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from service import __version__
from service.api import avatars, events, files, info, problems, renders
from service.api.context import Context
from service.api.middleware import Front
from service.api.options import adapter
from service.api.quick import QuickState
from service.api.schemas import Problem
from service.jobs.settings import Settings

PAGE = Path(__file__).parents[1] / "web" / "static"
"""Folder of the page at ``/``."""

_PROBLEM = {
    "description": "A problem.",
    "content": {problems.MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
}


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
    problems.install(app)
    app.add_middleware(QuickState)
    app.add_middleware(Front, settings=settings)
    for module in (avatars, events, files, renders, info):
        app.include_router(module.router)
    _serve_page(app, page)
    app.openapi = lambda: _described(app)  # type: ignore[method-assign]
    return app


class _Page(StaticFiles):
    """Files that a browser may keep, and has to ask about each time: a new version is seen at once."""

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        """As it is, with ``Cache-Control``."""
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


def _described(app: FastAPI) -> dict[str, Any]:
    """OpenAPI with what FastAPI cannot know: the body of the upload, problems, keys."""
    if app.openapi_schema is not None:
        return app.openapi_schema
    from fastapi.openapi.utils import get_openapi

    described = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    components = described.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas["Problem"] = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    options = adapter().json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(options.pop("$defs", {}))
    schemas["Options"] = {**options, "additionalProperties": False}
    schemas |= _render_schemas()
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            _describe(path, method, operation)
    app.openapi_schema = described
    return described


def _render_schemas() -> dict[str, Any]:
    """Schemas of a picture's request and of scenes."""
    from pydantic import TypeAdapter

    from service.render.request import RenderRequest

    schema = TypeAdapter(RenderRequest).json_schema(ref_template="#/components/schemas/{model}")
    definitions: dict[str, Any] = schema.pop("$defs", {})
    avatar = {"type": "string", "description": "Id of an avatar that has succeeded."}
    schema["properties"] = {"avatar": avatar, **schema["properties"]}
    return {**definitions, "Render": {**schema, "required": ["avatar"], "additionalProperties": False}}


def _describe(path: str, method: str, operation: dict[str, Any]) -> None:
    answers = operation["responses"]
    answers.pop("422", None)
    answers["4XX"] = _PROBLEM
    answers["5XX"] = _PROBLEM
    if path.startswith(("/v1/avatars", "/v1/renders")):
        operation["security"] = [{"key": []}, {}]
    if (path, method) == ("/v1/renders", "post"):
        schema = {"$ref": "#/components/schemas/Render"}
        operation["requestBody"] = {"required": True, "content": {"application/json": {"schema": schema}}}
    if (path, method) != ("/v1/avatars", "post"):
        return
    photo = {"type": "string", "format": "binary", "description": "JPEG, PNG or WebP."}
    form = {
        "type": "object",
        "required": ["image"],
        "additionalProperties": False,
        "properties": {
            "image": photo,
            "options": {"$ref": "#/components/schemas/Options"},
            "keep_photo": {"type": "boolean", "default": False},
        },
    }
    content = {"multipart/form-data": {"schema": form, "encoding": {"options": {"contentType": "application/json"}}}}
    content |= {kind: {"schema": photo} for kind in ("image/jpeg", "image/png", "image/webp")}
    operation["requestBody"] = {"required": True, "content": content}
    key = {"name": "Idempotency-Key", "in": "header", "required": False, "schema": {"type": "string", "maxLength": 255}}
    operation.setdefault("parameters", []).append(key)
    answers["202"]["headers"] = {"Location": {"schema": {"type": "string"}, "description": "Address of the job."}}
