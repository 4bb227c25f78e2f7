"""Shapes of the answers, for the OpenAPI description; the answers themselves are checked against them in the tests."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

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


class Job(BaseModel):
    """State of one avatar. Times are RFC 3339 in UTC."""

    id: str
    state: State
    stage: str | None = Field(description="What is being done now.")
    progress: float = Field(ge=0, le=1)
    created_at: str
    started_at: str | None
    finished_at: str | None
    expires_at: str | None = Field(description="When the result is erased.")
    links: Links
    error: Problem | None
    warnings: list[str]
    options: dict[str, Any]
    priority: str
    metadata: dict[str, Any] = Field(description="Words of the owner's own, as they came.")


class JobPage(BaseModel):
    """Jobs, newest first; ``next`` is the cursor of the next page."""

    items: list[Job]
    next: str | None


class DerivedJob(BaseModel):
    """State of what is made of an avatar. Times are RFC 3339 in UTC."""

    id: str
    state: State
    created_at: str
    started_at: str | None
    finished_at: str | None
    expires_at: str | None
    error: Problem | None
    request: dict[str, Any] = Field(description="What was asked for.")


class RenderLinks(BaseModel):
    """Addresses on this server; that of the picture is null until there is one."""

    self: str
    avatar: str
    picture: str | None


class RenderJob(DerivedJob):
    """State of one picture. Times are RFC 3339 in UTC."""

    links: RenderLinks


class ExportLinks(BaseModel):
    """Addresses on this server; that of the kit is null until there is one."""

    self: str
    avatar: str
    kit: str | None


class ExportJob(DerivedJob):
    """State of one kit. Times are RFC 3339 in UTC."""

    links: ExportLinks


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


class Health(BaseModel):
    """Whether requests can be answered."""

    status: str


class Readiness(BaseModel):
    """Whether photos can be taken, and why not."""

    status: Literal["ready"]
    workers: int = Field(description="Workers that compute; where there are none, jobs wait.")
