"""The OpenAPI document: shapes of the answers, and what FastAPI cannot find out by itself.

It has to be good enough for programs that write clients: every operation has a name of its own, every body a type, and
everything that is spoken of is there.
"""

from __future__ import annotations

import inspect
import re
from typing import Annotated, Any, Literal

from fastapi import FastAPI
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, create_model

from service.api.problem_responses import IMAGE_TYPES, MEDIA_TYPE
from service.jobs.admission import PRIORITIES
from service.jobs.view import EXPORT, RENDER, Kind
from service.kits.export import TOOLS
from service.photo.bundle import MOST

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]


class Problem(BaseModel):
    """RFC 9457 problem object; there may be more members, for example the boxes of several faces."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(description="Address that explains the code.")
    title: str
    status: int
    detail: str
    code: str = Field(description="Stable name of the kind of problem.")
    instance: str | None = None


class Links(BaseModel):
    """Addresses on this server; those of the result are null until there is one."""

    self: str
    events: str
    archive: str | None
    files: str | None
    photo: str | None = Field(description="Where the photo was to be kept.")


class AnyJob(BaseModel):
    """What every job has. Times are RFC 3339 in UTC."""

    id: str
    state: State
    created_at: str
    started_at: str | None
    finished_at: str | None
    expires_at: str | None = Field(description="When the result is erased.")
    error: Problem | None


class Job(AnyJob):
    """State of one avatar. Times are RFC 3339 in UTC."""

    stage: str | None = Field(description="What is being done now.")
    progress: float = Field(ge=0, le=1)
    links: Links
    warnings: list[str] = Field(description="Stable codes of what makes the avatar less certain.")
    warning_words: list[str] = Field(description="The same, each as a sentence.")
    options: dict[str, Any]
    priority: str
    metadata: dict[str, Any] = Field(description="Words of the owner's own, as they came.")


class JobPage(BaseModel):
    """Jobs, newest first; ``next`` is the cursor of the next page."""

    items: list[Job]
    next: str | None


def _derived(kind: Kind) -> type[AnyJob]:
    """The state of a job of a derived kind, called after it: ``RenderJob`` with its ``RenderLinks``."""
    name, what = kind.name.capitalize(), kind.artifact
    addresses: dict[str, Any] = {"self": (str, ...), "avatar": (str, ...), what: (str | None, ...)}
    words = f"Addresses on this server; that of the {what} is null until there is one."
    links = create_model(f"{name}Links", __doc__=words, **addresses)
    request = Annotated[dict[str, Any], Field(description="What was asked for.")]
    words = f"State of one {what}. Times are RFC 3339 in UTC."
    return create_model(f"{name}Job", __base__=AnyJob, __doc__=words, request=(request, ...), links=(links, ...))


RenderJob, ExportJob = _derived(RENDER), _derived(EXPORT)


class File(BaseModel):
    """One file of an archive."""

    path: str
    bytes: int
    media_type: str
    link: str


class FileList(BaseModel):
    """Files of an archive."""

    items: list[File]


class Model(BaseModel):
    """A data file that takes part in making avatars."""

    name: str
    sha256: str
    licence: str
    role: str


class ModelList(BaseModel):
    """Networks and the head model."""

    items: list[Model]


class Measured(BaseModel):
    """Times of finished jobs of one kind on this server, seconds."""

    quality: str
    size: list[int]
    jobs: int
    median_s: float
    p90_s: float
    peak_rss_mb: float | None


class LevelFacts(BaseModel):
    """One level of quality and the size (width, height) of its maps."""

    name: str
    size: list[int]


class QualityList(BaseModel):
    """What a choice of quality and size costs here."""

    levels: list[LevelFacts]
    items: list[Measured]
    formats: list[str] = Field(description="Of photos that are read here, without 'image/'.")
    choices: dict[str, list[str]] = Field(description="Names that options of hair, eyes and mouth can have.")


class Health(BaseModel):
    """Whether requests can be answered."""

    status: str


class Readiness(BaseModel):
    """Whether photos can be taken, and why not."""

    status: Literal["ready"]
    workers: int = Field(description="Workers that compute; where there are none, jobs wait.")


Json = dict[str, Any]

_REF = "#/components/schemas/{model}"

_PROBLEM = {"description": "A problem.", "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}

_PHOTO = {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP or HEIC."}

_NEW_AVATAR: Json = {
    "type": "object",
    "anyOf": [{"required": ["image"]}, {"required": ["video"]}],
    "additionalProperties": False,
    "properties": {
        "video": {"type": "string", "format": "binary", "description": "MP4, QuickTime or WebM of the same person."},
        "image": {
            "description": "A photo, or up to 24 of one person: a part of this name for each.",
            "anyOf": [_PHOTO, {"type": "array", "items": _PHOTO, "minItems": 1, "maxItems": MOST}],
        },
        "options": {"$ref": "#/components/schemas/Options"},
        "keep_photo": {
            "type": "boolean",
            "default": False,
            "description": "Keep the photo beside the result.",
        },
        "metadata": {
            "type": "object",
            "description": "Words of your own, at most 2048 bytes; given back with the job.",
        },
        "priority": {"type": "string", "enum": list(PRIORITIES), "default": "normal"},
        "webhook_url": {"type": "string", "description": "Told of the end, where the operator has listed its host."},
    },
}

_AVATAR = {"type": "string", "description": "Id of an avatar that has succeeded."}

_EXPORT: Json = {
    "type": "object",
    "required": ["avatar", "for"],
    "additionalProperties": False,
    "properties": {
        "avatar": _AVATAR,
        "for": {"type": "string", "enum": list(TOOLS), "description": "The tool that the kit is for."},
    },
}

_HEADERS = {
    "Idempotency-Key": ("A request that is sent again with the same key makes no second job.", 255),
    "Range": ("One range of bytes.", None),
    "If-Range": ("Strong ETag for which the range is wanted; else the whole is sent.", None),
    "Prefer": ("'respond-async' does not wait for the picture.", None),
    "Last-Event-ID": ("Number of the last event that arrived; those after it are sent.", None),
}
"""Headers that mean something in a request, with their greatest length."""

_TAKES = {"create_avatar": ["Idempotency-Key"], "follow_avatar": ["Last-Event-ID"], "render_avatar": ["Prefer"]}
"""Headers of an operation by its name; all downloads take ranges."""

_WANTED = {"render_avatar": "Render", "export_avatar": "Export"}
"""Schemas of JSON bodies, likewise."""


def described(app: FastAPI) -> Json:
    """The document of an application, made once."""
    if app.openapi_schema is not None:
        return app.openapi_schema
    from fastapi.openapi.utils import get_openapi

    found = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    components = found.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas["Problem"] = Problem.model_json_schema(ref_template=_REF)
    schemas |= {**_options(), **_render(), "NewAvatar": _NEW_AVATAR, "Export": _EXPORT}
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
    for path, operations in found["paths"].items():
        for operation in operations.values():
            _complete(path, operation)
    app.openapi_schema = found
    return found


def attributes(kind: type) -> dict[str, str]:
    """What the docstring of a class says under ``Attributes:``, by name, in one line each and without its markup."""
    text = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^    (\w+): (.*(?:\n        .*)*)", text, re.MULTILINE)
    return {name: re.sub(r"\s+", " ", words).replace("``", "'").replace("None", "null") for name, words in entries}


def _options() -> Json:
    """Schemas of the options of a job."""
    from service.map_registry import MAP_NAMES
    from service.options import Options

    schema = TypeAdapter(Options).json_schema(ref_template=_REF)
    definitions: Json = schema.pop("$defs", {})
    told = attributes(Options)
    for name, property_ in schema["properties"].items():
        property_["description"] = told[name]
    schema["properties"]["maps"] |= {
        "description": "Maps to make, each once; what none of them needs is not computed. Default: all.",
        "items": {"type": "string", "enum": list(MAP_NAMES)},
        "minItems": 1,
    }
    schema["properties"]["quality"]["description"] = "How fine; /v1/quality has what each level takes here."
    schema["description"] = "What to make, as on the command line."
    return {**definitions, "Options": {**schema, "additionalProperties": False}}


def _render() -> Json:
    """Schemas of a picture's request and of scenes."""
    from service.render.request import RenderRequest

    schema = TypeAdapter(RenderRequest).json_schema(ref_template=_REF)
    definitions: Json = schema.pop("$defs", {})
    schema["properties"] = {"avatar": _AVATAR, **schema["properties"]}
    return {**definitions, "Render": {**schema, "required": ["avatar"], "additionalProperties": False}}


def _complete(path: str, operation: Json) -> None:
    answers = operation["responses"]
    answers.pop("422", None)
    answers["4XX"] = _PROBLEM
    answers["5XX"] = _PROBLEM
    if path.startswith(("/v1/avatars", "/v1/renders", "/v1/exports")):
        operation["security"] = [{"key": []}, {}]
    name = operation["operationId"]
    for header in ["Range", "If-Range"] if name.startswith("download_") else _TAKES.get(name, ()):
        words, longest = _HEADERS[header]
        schema: Json = {"type": "string"} if longest is None else {"type": "string", "maxLength": longest}
        parameter = {"name": header, "in": "header", "required": False, "description": words, "schema": schema}
        operation.setdefault("parameters", []).append(parameter)
    if name in _WANTED:
        operation["requestBody"] = _body({"application/json": {"schema": {"$ref": _REF.format(model=_WANTED[name])}}})
    if name == "create_avatar":
        form = {
            "schema": {"$ref": "#/components/schemas/NewAvatar"},
            "encoding": {name: {"contentType": "application/json"} for name in ("options", "metadata")},
        }
        photos = {kind: {"schema": _PHOTO} for kind in IMAGE_TYPES}
        operation["requestBody"] = _body({"multipart/form-data": form, **photos})
        answers["202"]["headers"] = {"Location": {"schema": {"type": "string"}, "description": "Address of the job."}}


def _body(content: Json) -> Json:
    return {"required": True, "content": content}
