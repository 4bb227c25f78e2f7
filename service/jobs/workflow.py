"""A job as a workflow of DBOS: each step is recorded, and a worker that was killed goes on with the step it was at.

Steps hand on names and hashes, never bytes, and may run twice at the same time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

from dbos import DBOS, DBOSConfig

from service.jobs import webhooks
from service.jobs.database import LINE, patient
from service.jobs.queue import APPLICATION, MESSAGE, MESSAGES, VERSION, WORKFLOW, JsonSerializer
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from service.jobs.view import AVATAR, KINDS, from_error

log = logging.getLogger(__name__)

RECOVERIES = 200
"""How often a job may lose its worker.

It can be that many: what a photo can do to its process does not reach the worker, and is counted by itself.
"""

OFTEN = 0.1
"""Most seconds between two looks for photos into a database of this machine alone: one takes 1.5 ms."""

MADE_AGAIN = 3
"""How often an archive may be lost between being made and being published."""


@dataclass(frozen=True)
class Workflows:
    """What DBOS is to know of one kind of work.

    Attributes:
        register: declares workflows and their steps; called once, before any of them runs.
        queues: names of queues, and their limits as of ``DBOS.register_queue``.
    """

    register: Callable[[], None]
    queues: Mapping[str, Mapping[str, Any]]


def launch(settings: Settings, *kinds: Workflows) -> None:
    """Start to take work of these kinds from the queues, that first which this worker had when it ended.

    DBOS keeps the limits of a queue in the database, for all workers: those of the worker that started last hold.
    """
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.database_url,
        "application_version": VERSION,
        "executor_id": settings.worker,
        "serializer": JsonSerializer(),
        "enable_otlp": False,
        "log_level": "WARNING",
        "use_listen_notify": False,
    }
    if not settings.database_url.startswith("sqlite"):
        # A dead connection shows when it is used; DBOS tries again then, and asking it each time is a sixth of idling.
        config["db_engine_kwargs"] = {
            "connect_args": {"application_name": APPLICATION, **LINE}, "pool_pre_ping": False,
        }  # fmt: skip
    queues = {name: limits for kind in kinds for name, limits in kind.queues.items()}
    DBOS(config=config)
    try:
        for kind in kinds:
            kind.register()
        DBOS.listen_queues(list(queues))
        DBOS.launch()
        for name, limits in queues.items():
            DBOS.register_queue(name, on_conflict="always_update", **limits)
    except BaseException:
        DBOS.destroy(destroy_registry=True)  # else nothing else in this process could be launched
        raise


def of_jobs(runner: Runner) -> Workflows:
    """Jobs of all kinds, and messages of their ends."""
    settings = runner.settings
    pause = {AVATAR: OFTEN} if settings.database_url.startswith("sqlite") else {}
    queues: dict[str, dict[str, Any]] = {
        kind.place: {
            "worker_concurrency": kind.most(settings),
            "polling_interval_sec": min(kind.looks * settings.look_seconds, pause.get(kind, inf)),
        }
        for kind in KINDS.values()
        if kind.most(settings)
    }
    if settings.webhook_hosts:
        # One at a time to each receiver of a tenant, wherever it is sent from; DBOS takes receivers in random order.
        more = {"partition_concurrency": 1, "polling_interval_sec": settings.look_seconds}
        queues[MESSAGES] = {"worker_concurrency": webhooks.SENDERS, **more}
    return Workflows(lambda: _register(runner), queues)


def _register(runner: Runner) -> None:
    accept = DBOS.step(name="accept")(_guarded(runner.accept))
    make = DBOS.step(name="make")(_guarded(runner.make))
    publish = DBOS.step(name="publish")(_guarded(runner.publish))

    @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=RECOVERIES)
    def avatar(job: str) -> str:
        """``job`` is the one that was posted; one of higher priority may have taken over its turn."""
        accepted = accept(DBOS.workflow_id)
        if accepted["kind"] == "problem":
            return str(publish(job, accepted))
        if accepted["kind"] != "wanted":
            return "ended"
        job = accepted["job"]
        for _ in range(MADE_AGAIN):
            if publish(job, make(job)) != "lost":
                return "published"
        return str(publish(job, {"kind": "problem", "problem": from_error(FileNotFoundError())}))

    @DBOS.step(name="send")
    def send(job: str, attempt: int) -> str:
        return patient(lambda: webhooks.tell(runner.store, runner.settings, job, attempt))

    @DBOS.workflow(name=MESSAGE, max_recovery_attempts=RECOVERIES)
    def message(job: str, attempt: int) -> str:
        return send(job, attempt)


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
