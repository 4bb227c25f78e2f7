"""Numbers for Prometheus; no label says anything about a photo or a tenant."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric

from service.jobs import telemetry
from service.jobs.database import JOBS, now
from service.jobs.view import STATES

if TYPE_CHECKING:
    from service.api.context import Context

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
    oldest = context.store.where(JOBS.c.state == "queued", limit=1)
    waiting = Gauge("avatarme_queue_oldest_seconds", "Age of the job that waits longest", registry=registry)
    waiting.set(now() - oldest[0]["created_at"] if oldest else 0.0)
    stuck = Gauge("avatarme_jobs_stuck", f"Running jobs without progress for {STUCK_S:g} s", registry=registry)
    stuck.set(len(context.store.where(JOBS.c.state == "running", JOBS.c.updated_at < now() - STUCK_S)))
    workers = Gauge("avatarme_workers", "Workers that live", ["ready"], registry=registry)
    for ready in (True, False):
        workers.labels(str(ready).lower()).set(sum(worker["ready"] == ready for worker in context.workers()))
    Gauge("avatarme_listeners", "Open event streams", registry=registry).set(context.watcher.count)
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
