"""Traces of jobs for OpenTelemetry: one span for a job, with one for its wait and one for its computation below it.

They are sent where ``OTEL_EXPORTER_OTLP_ENDPOINT`` says, by the packages of the extra ``otel``; without the variable or
without the packages nothing happens. A request's ``traceparent`` (W3C Trace Context) is the parent, so a job appears in
the trace of whoever asked for it. The spans are made when the job has ended, from the times in the database: a job
outlives the processes that work on it, and a span does not.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import sqlalchemy as sa

ENDPOINT = "OTEL_EXPORTER_OTLP_ENDPOINT"

_PARENT = re.compile(r"00-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}\Z")

log = logging.getLogger(__name__)


def traceparent(headers: Mapping[str, str]) -> str | None:
    """The trace that a request belongs to; None for none, or for what is not of the form."""
    value = headers.get("traceparent", "").strip()
    return value if _PARENT.match(value) else None


def ended(row: sa.RowMapping) -> None:
    """Tell of a job that is in its last state."""
    found = tracer()
    if found is not None:
        spans(found, row)


def spans(made_by: Any, row: sa.RowMapping) -> None:
    """Make the spans of a job.

    Args:
        made_by: a tracer of OpenTelemetry.
        row: of the job.
    """
    from opentelemetry import trace
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier = {"traceparent": row["trace"]} if row["trace"] else {}
    problem = json.loads(row["error"]) if row["error"] else {}
    attributes = {
        "avatarme.job": row["id"], "avatarme.kind": row["kind"], "avatarme.tenant": row["tenant"],
        "avatarme.state": row["state"], "avatarme.code": problem.get("code", ""), "avatarme.crashes": row["crashes"],
    }  # fmt: skip
    end = row["finished_at"] or row["updated_at"]
    whole = made_by.start_span(
        "job",
        TraceContextTextMapPropagator().extract(carrier),
        start_time=_ns(row["created_at"]),
        attributes=attributes,
    )
    below = trace.set_span_in_context(whole)
    started = row["started_at"]
    made_by.start_span("wait", below, start_time=_ns(row["created_at"])).end(_ns(started or end))
    if started is not None:
        stages = {f"avatarme.stage.{name}_s": seconds for name, seconds in json.loads(row["timings"]).items()}
        made_by.start_span("compute", below, start_time=_ns(started), attributes=stages).end(_ns(end))
    if int(problem.get("status", 0)) >= 500:
        whole.set_status(trace.Status(trace.StatusCode.ERROR, problem["code"]))
    whole.end(_ns(end))


@lru_cache(maxsize=1)
def tracer() -> Any:
    """The tracer of this process, None where traces are not wanted or their packages are not there."""
    if not os.environ.get(ENDPOINT):
        return None
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError as error:
        log.error("%s is set, and the extra 'otel' is not installed: %s", ENDPOINT, error)
        return None
    provider = TracerProvider(resource=Resource.create({"service.name": "avatarme"}))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider.get_tracer("service.jobs")


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
