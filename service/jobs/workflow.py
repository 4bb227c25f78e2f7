"""A job as a workflow of DBOS: each step is recorded, and a worker that was killed goes on with the step it was at."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeVar

from dbos import DBOS, DBOSConfig

from service.jobs.database import LINE
from service.jobs.kinds import KINDS
from service.jobs.problems import from_error
from service.jobs.queue import APPLICATION, WORKFLOW, JsonSerializer
from service.jobs.runner import Runner
from service.jobs.settings import PIPELINE_VERSION, Settings

T = TypeVar("T")

log = logging.getLogger(__name__)

RECOVERIES = 200
"""How often a job may lose its worker.

It can be that many: what a photo can do to its process does not reach the worker, and is counted by itself.
"""

POLL = 0.5
"""Seconds between two looks into the queue."""

MADE_AGAIN = 3
"""How often an archive may be lost between being made and being published."""


def launch(settings: Settings, runner: Runner) -> None:
    """Start to take jobs from the queue, those first that this worker had when it ended.

    Args:
        settings: of this worker.
        runner: the steps.
    """
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.database_url,
        "application_version": PIPELINE_VERSION,
        "executor_id": settings.worker,
        "serializer": JsonSerializer(),
        "enable_otlp": False,
        "log_level": "WARNING",
        "use_listen_notify": False,
    }
    if not settings.database_url.startswith("sqlite"):
        config["db_engine_kwargs"] = {"connect_args": {"application_name": APPLICATION, **LINE}}
    DBOS(config=config)
    _register(runner)
    DBOS.launch()
    for kind in KINDS.values():
        if kind.most(settings):
            DBOS.register_queue(
                kind.place, worker_concurrency=kind.most(settings), polling_interval_sec=POLL,
                on_conflict="always_update",
            )  # fmt: skip


def take_over(worker: str) -> int:
    """Put the jobs of a worker that is dead back into the queue; returns their number.

    A private method of DBOS, hence the pinned version; where the worker is not dead after all, the step that it is at
    runs twice and its result counts once.
    """
    return len(DBOS._recover_pending_workflows([worker]))


def _register(runner: Runner) -> None:
    accept = DBOS.step(name="accept")(_guarded(runner.accept))
    make = DBOS.step(name="make")(_guarded(runner.make))
    publish = DBOS.step(name="publish")(_guarded(runner.publish))

    @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=RECOVERIES)
    def avatar(job: str) -> str:
        accepted = accept(job, DBOS.workflow_id)
        if accepted["kind"] == "problem":
            return str(publish(job, accepted))
        if accepted["kind"] != "wanted":
            return "ended"
        for _ in range(MADE_AGAIN):
            if publish(job, make(job)) != "lost":
                return "published"
        return str(publish(job, {"kind": "problem", "problem": from_error(FileNotFoundError())}))


def _guarded(step: Callable[..., Any]) -> Callable[..., Any]:
    """A mistake of ours ends the job, not the workflow: an unexpected exception becomes a problem."""

    def run(*arguments: Any) -> Any:
        try:
            return step(*arguments)
        except Exception as error:  # whatever it is, the job has to end with an answer
            log.error("a step failed", exc_info=error)
            return {"kind": "problem", "problem": from_error(error)}

    run.__name__ = run.__qualname__ = step.__name__
    return run
