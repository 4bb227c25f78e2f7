"""The way into the queue: DBOS, seen from a process that runs no jobs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from typing import Any

import sqlalchemy as sa
from dbos import DBOSClient, EnqueueOptions, Serializer, WorkflowStatus

from service.jobs.view import KINDS

APPLICATION = "avatarme"

VERSION = "pipeline-5"
"""Version of the workflows, as DBOS has it, the same for all releases: each one goes on with what another one began.

Steps hand on names only, and stages of another release are computed again (``service.jobs.avatar_process``). What
changes the steps of a workflow so that it cannot go on gives it another name, and leaves the old one beside it.
"""

WORKFLOW, MESSAGE = "avatar", "message"
"""Names of the workflows: a job of any kind, and one attempt to tell of the end of a job."""

MESSAGES = "messages"
"""Name of the queue of messages; each kind of job has one of its own."""

PAUSES_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)
"""Between two attempts at a message; 16 hours in all."""

ATTEMPTS = len(PAUSES_S) + 1

MOST_LISTED = 1000
"""Workflows that one look brings; there are as many looks as it takes."""


class JsonSerializer(Serializer):
    """Workflow arguments and results as JSON: whoever can write the database must not get code to run."""

    def serialize(self, data: Any) -> str:
        """JSON text; exceptions become their class name and text."""
        return json.dumps(data, default=repr)

    def deserialize(self, serialized_data: str) -> Any:
        """The inverse."""
        return json.loads(serialized_data)

    def name(self) -> str:
        """Stored beside each value."""
        return "json"


class Queue:
    """Puts workflows into the queue, takes them out and looks at them, all by public calls of DBOS.

    What it lists is bounded by what runs or by what is asked for, never by what waits.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self.client = DBOSClient(
            system_database_engine=engine, serializer=JsonSerializer(), application_name=APPLICATION, lazy=True,
            retry_connection_errors=False,
        )  # fmt: skip

    def put(self, connection: sa.Connection, job: Mapping[str, Any] | sa.RowMapping) -> None:
        """Put the workflow of a job into the queue, as :meth:`enqueue`."""
        self.enqueue(connection, KINDS[job["kind"]].place, WORKFLOW, job["workflow"], job["turn"], job["id"])

    def put_message(self, connection: sa.Connection, job: Mapping[str, Any] | sa.RowMapping, attempt: int = 1) -> None:
        """Put an attempt to tell of the end of a job into the queue, inside the caller's transaction; twice is once.

        Messages of one tenant to one host are sent one after the other, those of others beside them. Attempts count
        from 1 to ``ATTEMPTS``; each one after the first is due after its pause.
        """
        host = job["webhook"].split("/")[2].lower()
        receiver = f"{job['tenant']}\n{host}"
        options: EnqueueOptions = {
            "queue_name": MESSAGES, "workflow_name": MESSAGE, "workflow_id": f"{job['id']}.told.{attempt}",
            "queue_partition_key": hashlib.sha256(receiver.encode()).hexdigest(),
        }  # fmt: skip
        if attempt > 1:
            options["delay_seconds"] = PAUSES_S[attempt - 2]
        self.client.enqueue_in_transaction(connection, options, job["id"], attempt)

    def enqueue(
        self, connection: sa.Connection, queue: str, workflow: str, workflow_id: str, turn: int, *arguments: Any
    ) -> None:
        """Put a workflow into a queue, inside the caller's transaction; twice is once."""
        options: EnqueueOptions = {
            "queue_name": queue, "workflow_name": workflow, "workflow_id": workflow_id, "priority": turn,
        }  # fmt: skip
        self.client.enqueue_in_transaction(connection, options, *arguments)

    def cancel(self, workflow: str) -> None:
        """A workflow that waits never starts; one that runs starts no further step."""
        self.client.cancel_workflow(workflow)

    def states(self, workflows: list[str]) -> dict[str, WorkflowStatus]:
        """What DBOS knows of each of these workflows that exists."""
        if not workflows:
            return {}
        found = self.client.list_workflows(workflow_ids=workflows, load_input=False, load_output=False)
        return {status.workflow_id: status for status in found}

    def take_from(self, workers: Collection[str]) -> int:
        """Put what these workers were at back into its queues; returns the number of workflows.

        It checks no owner, so nobody else may do it at the same time: see :meth:`Janitor.take_over`. DBOS counts the
        attempts at a workflow anew; what a job that takes its workers along is failed for is counted by
        ``service.jobs.runner``. Where a worker is not dead after all, the step that it is at runs twice and its
        result counts once.
        """
        held = self.client.list_workflows(
            status="PENDING", executor_id=sorted(workers), load_input=False, load_output=False, limit=MOST_LISTED
        )
        for name in {status.queue_name for status in held}:
            mine = [status.workflow_id for status in held if status.queue_name == name]
            self.client.resume_workflows(mine, queue_name=name)
        return len(held)

    def delete(self, workflows: list[str]) -> None:
        """Forget workflows."""
        if workflows:
            self.client.delete_workflows(workflows)
