"""A job as a workflow of DBOS: each step is recorded, and a worker that was killed goes on with the step it was at.

Steps hand on names and hashes, never bytes, and may run twice at the same time.
"""

from __future__ import annotations

import logging
import secrets
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from dbos import DBOS, DBOSConfig

from service.errors import ModelFault
from service.jobs import webhooks
from service.jobs.artifacts import Artifacts
from service.jobs.attempts import Attempts
from service.jobs.database import LINE, now, patient
from service.jobs.kinds import KINDS
from service.jobs.queue import APPLICATION, MESSAGE, MESSAGES, WORKFLOW, JsonSerializer
from service.jobs.settings import PIPELINE_VERSION, Settings
from service.jobs.store import Store
from service.jobs.view import FINAL, from_error


class Runner(Attempts):
    """Runs jobs on this machine.

    Args:
        settings: of this worker.
        store: the jobs.
        artifacts: their files.
    """

    def __init__(self, settings: Settings, store: Store, artifacts: Artifacts) -> None:
        super().__init__(settings, store, artifacts)
        self.doubt = threading.Event()
        """Set when a job found a data file damaged."""

    def accept(self, workflow: str) -> dict[str, Any]:
        """First step: the job whose turn this is runs, if there is one."""
        job = patient(lambda: self.store.begin(workflow))
        return {"kind": "ended"} if job is None else {"kind": "wanted", "job": job}

    def make(self, job: str) -> dict[str, Any]:
        """Second step: compute the archive in a process of its own.

        Returns:
            ``kind`` "done" with the facts of the archive, "problem" with a problem object, or "ended" where the job
            has ended meanwhile.
        """
        row = self._row(job)
        if row is None or row["state"] in FINAL:
            return {"kind": "ended"}
        scratch = self.scratch / f"{job}-{secrets.token_hex(4)}"
        scratch.mkdir(parents=True, mode=0o700)
        self.active[job] = None
        try:
            return self.outcome(row, scratch)
        finally:
            self.active.pop(job, None)
            shutil.rmtree(scratch, ignore_errors=True)

    def publish(self, job: str, outcome: dict[str, Any]) -> str:
        """Last step: the owner sees the outcome, and what is no longer needed is erased.

        Returns:
            "published", or "lost" where the archive is not on the disk any more.
        """
        expires = now() + self.settings.result_hours * 3600
        if outcome["kind"] == "done":
            if not patient(lambda: self.artifacts.exists(outcome["archive"])):
                row = self._row(job)
                return "published" if row is None or row["state"] in FINAL else "lost"
            patient(lambda: self.store.succeed(job, outcome, expires))
        elif outcome["kind"] == "problem":
            patient(lambda: self.store.fail(job, outcome["problem"], expires))
            if outcome["problem"]["code"] == ModelFault.code:
                self.doubt.set()
        self.tidy(job)
        return "published"

    def tidy(self, job: str) -> None:
        """Erase what a job that has ended does not need: its stages, and its photo unless it is to be kept."""
        row = self._row(job)
        if row is None or row["state"] not in FINAL:
            return
        keep = {row["archive"]} if row["archive"] and row["gone"] is None else set()
        if row["keep_photo"] and row["photo"] and row["gone"] is None:
            keep.add(row["photo"])
        patient(lambda: self.artifacts.sweep(job, keep))
        patient(lambda: self.store.set(job, swept=True))


T = TypeVar("T")

log = logging.getLogger(__name__)

RECOVERIES = 200
"""How often a job may lose its worker.

It can be that many: what a photo can do to its process does not reach the worker, and is counted by itself.
"""

POLL = 1.0
"""Seconds between two looks into a queue; those of three queues are most of what a worker does beside its jobs."""

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
    """Start to take work from the queues, that first which this worker had when it ended.

    Args:
        settings: of this worker.
        kinds: what it can do.
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
    queues: dict[str, dict[str, Any]] = {
        kind.place: {"worker_concurrency": kind.most(settings), "polling_interval_sec": POLL}
        for kind in KINDS.values()
        if kind.most(settings)
    }
    if settings.webhook_hosts:
        # One at a time to each receiver of a tenant, wherever it is sent from; DBOS takes receivers in random order.
        more = {"partition_concurrency": 1, "polling_interval_sec": webhooks.LOOK_S}
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

    send = DBOS.step(name="send")(_sender(runner))

    @DBOS.workflow(name=MESSAGE, max_recovery_attempts=RECOVERIES)
    def message(job: str, attempt: int) -> str:
        return str(send(job, attempt))


def _sender(runner: Runner) -> Callable[[str, int], str]:
    def send(job: str, attempt: int) -> str:
        return patient(lambda: webhooks.tell(runner.store, runner.settings, job, attempt))

    return send


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
