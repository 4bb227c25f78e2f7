"""What the server is: probes, models, qualities with their measured times, metrics, explanations of problems."""

from __future__ import annotations

import json
import statistics
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, cast, get_args

import sqlalchemy as sa
from fastapi import APIRouter
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from starlette.responses import JSONResponse, PlainTextResponse, Response

from service.api.context import Context, Here
from service.api.openapi import Health, ModelList, QualityList, Readiness
from service.api.problem_responses import EXPLANATIONS, HttpProblem, not_found, response
from service.jobs import telemetry
from service.jobs.database import JOBS, now
from service.jobs.store import Row
from service.jobs.view import STATES, TITLES, problem

router = APIRouter(tags=["server"])


@router.get("/livez", response_model=Health, operation_id="get_liveness", summary="The process answers.")
async def livez() -> Response:
    """Says nothing about the database or the workers: restarting this process would not help them."""
    return JSONResponse({"status": "alive"}, headers={"Cache-Control": "no-store"})


@router.get("/readyz", response_model=Readiness, operation_id="get_readiness", summary="Photos are taken.")
def readyz(context: Here) -> Response:
    """Ready means: the database answers and there is space, so photos are stored and results given out.

    Workers may be away: jobs wait for them, and whoever starts workers when jobs wait has to be able to post some.
    Where workers live and none can work, because data files are damaged, nobody is ready.
    """
    reason = None
    workers: list[dict[str, object]] = []
    try:
        workers = context.workers()
    except sa.exc.SQLAlchemyError:
        reason = "the database does not answer"
    ready = [worker for worker in workers if worker["ready"]]
    if context.draining.is_set():
        reason = "the server is shutting down"
    elif reason is None and not ready and any(worker["fault"] for worker in workers):
        reason = "a data file is missing or changed"
    elif context.free_mb() < context.settings.reserve_mb:
        reason = "there is too little space for uploads"
    if reason is not None:
        return response(problem("starting", 503, reason), {"Retry-After": "5"}, "/readyz")
    return JSONResponse({"status": "ready", "workers": len(ready)}, headers={"Cache-Control": "no-store"})


@router.get(
    "/v1/models",
    response_model=ModelList,
    operation_id="list_models",
    summary="Data files that make avatars, with hashes and licences.",
)
def models() -> Response:
    """The networks and the head model."""
    from service.head.files import DEFAULT_HEAD
    from service.places import file_sha256
    from service.runtime.network_registry import ROLES
    from service.runtime.sessions import model_table

    items = [
        {
            "name": name,
            "sha256": entry["sha256"],
            "licence": entry["licence"],
            "role": ROLES.get(name, "not used yet"),
        }
        for name, entry in model_table().items()
    ]
    licence = str(json.loads(DEFAULT_HEAD.with_suffix(".json").read_text("utf-8")).get("licence", "CC0-1.0"))
    items.append({"name": "head", "sha256": file_sha256(DEFAULT_HEAD), "licence": licence, "role": "head model"})
    return JSONResponse({"items": items})


@router.get(
    "/v1/quality",
    response_model=QualityList,
    operation_id="list_quality",
    summary="What quality and size cost on this server.",
)
def quality(context: Here) -> Response:
    """The levels, and median and 90th percentile of the times of the last jobs by level and size of the maps.

    There are no times before the first job of a kind has ended. Jobs that left maps out are not counted.
    """
    from service.hair.asked import AUTO, COLOURS, NONE, STYLES
    from service.levels import LEVELS
    from service.options import EyeColour, Mouth, Wrinkles, default_maps
    from service.photo.container import readable_formats

    groups: dict[tuple[str, tuple[int, int]], list[Row]] = defaultdict(list)
    whole = set(default_maps())
    for row in context.store.measured():
        options = json.loads(row["options"])
        if options.get("quality") in LEVELS and whole <= set(options.get("maps") or ()):
            width, height = options.get("size") or LEVELS[options["quality"]].size
            groups[options["quality"], (width, height)].append(row)
    items = [_measured(name, size, rows) for (name, size), rows in sorted(groups.items())]
    levels = [{"name": name, "size": list(level.size)} for name, level in LEVELS.items()]
    choices = {
        "hair": (AUTO, NONE, *STYLES), "hair_colour": COLOURS, "eye_colour": get_args(EyeColour),
        "mouth": get_args(Mouth), "wrinkles": get_args(Wrinkles),
    }  # fmt: skip
    formats = [name.lower() for name in readable_formats()]
    return JSONResponse({"levels": levels, "items": items, "formats": formats, "choices": choices})


def _measured(name: str, size: tuple[int, int], rows: list[Row]) -> dict[str, Any]:
    times = sorted(row["finished_at"] - row["started_at"] for row in rows)
    memory = [row["peak_rss_mb"] for row in rows if row["peak_rss_mb"] is not None]
    return {
        "quality": name,
        "size": list(size),
        "jobs": len(rows),
        "median_s": round(statistics.median(times), 3),
        "p90_s": round(times[min(len(times) - 1, int(len(times) * 0.9))], 3),
        "peak_rss_mb": max(memory, default=None),
    }


@router.get(
    "/problems/{code}",
    response_class=PlainTextResponse,
    operation_id="explain_problem",
    summary="What a problem code means.",
)
async def explanation(code: str) -> Response:
    """The address in ``type`` of a problem."""
    if code not in EXPLANATIONS and code not in TITLES:
        raise not_found()
    words = EXPLANATIONS.get(code, "See 'detail' of the problem for what was found and what would be right.")
    return PlainTextResponse(f"{problem(code, 0, '')['title']}\n\n{words}\n")


@router.get("/metrics", response_class=PlainTextResponse, include_in_schema=False)
def metrics(context: Here) -> Response:
    """Prometheus text format."""
    try:
        return Response(exposition(context), media_type="text/plain; version=0.0.4; charset=utf-8")
    except sa.exc.SQLAlchemyError as error:
        raise HttpProblem("starting", 503, "the database does not answer") from error


STUCK_S = 300.0
"""A running job without progress for so long counts as stuck."""

REGISTRY = CollectorRegistry()
REQUESTS = Counter("avatarme_requests", "Answered requests", ["method", "route", "status"], registry=REGISTRY)
DURATION = Histogram(
    "avatarme_request_seconds", "Time until the head of the answer", ["route"], registry=REGISTRY,
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30),
)  # fmt: skip
UPLOAD_BYTES = Counter("avatarme_upload_bytes", "Bytes of request bodies", registry=REGISTRY)


def exposition(context: Context) -> bytes:
    """All numbers, those of the jobs read from the database now."""
    registry = CollectorRegistry()
    jobs = Gauge("avatarme_jobs", "Jobs that are kept, by state", ["state"], registry=registry)
    counts = context.store.counts()
    for state in STATES:
        jobs.labels(state).set(counts.get(state, 0))
    oldest = context.store.oldest()
    waiting = Gauge("avatarme_queue_oldest_seconds", "Age of the job that waits longest", registry=registry)
    waiting.set(0.0 if oldest is None else now() - oldest["created_at"])
    stuck = Gauge("avatarme_jobs_stuck", f"Running jobs without progress for {STUCK_S:g} s", registry=registry)
    stuck.set(len(context.store.where(JOBS.c.state == "running", JOBS.c.updated_at < now() - STUCK_S)))
    workers = Gauge("avatarme_workers", "Workers that live", ["ready"], registry=registry)
    for ready in (True, False):
        workers.labels(str(ready).lower()).set(sum(worker["ready"] == ready for worker in context.workers()))
    Gauge("avatarme_listeners", "Open event streams", registry=registry).set(context.listeners)
    Gauge("avatarme_free_megabytes", "Free space for uploads", registry=registry).set(context.free_mb())
    registry.register(cast(Any, _Tallies(context)))
    return generate_latest(REGISTRY) + generate_latest(registry)


class _Tallies:
    """Counts of the database for the exposition: jobs that ended, and times of stages."""

    def __init__(self, context: Context) -> None:
        self._engine = context.engine

    def collect(self) -> Iterator[Metric]:
        """The families; called by the library."""
        ended = CounterMetricFamily("avatarme_jobs_ended", "Jobs that ended", labels=["kind", "state", "code"])
        for label, value in sorted(telemetry.counts(self._engine, telemetry.ENDED).items()):
            ended.add_metric(label.split("/"), value)
        yield ended
        stages = HistogramMetricFamily("avatarme_stage_seconds", "Time of a stage of a job", labels=["stage"])
        for stage, buckets, total in telemetry.histograms(self._engine):
            stages.add_metric([stage], buckets, total)
        yield stages
