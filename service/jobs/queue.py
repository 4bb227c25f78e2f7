"""The way into the queue: DBOS, seen from a process that runs no jobs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

import sqlalchemy as sa
from dbos import DBOSClient, Serializer

from service.jobs.kinds import KINDS

APPLICATION = "avatarme"
WORKFLOW = "avatar"


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
    """Puts workflows into the queue, takes them out and looks at them.

    Args:
        engine: of the database that the jobs are in.
        migrate: make the tables of DBOS where they are missing.
    """

    def __init__(self, engine: sa.Engine, *, migrate: bool = False) -> None:
        self.client = DBOSClient(
            system_database_engine=engine, serializer=JsonSerializer(), application_name=APPLICATION, lazy=True,
            retry_connection_errors=False,
        )  # fmt: skip
        if migrate:
            self.client._sys_db.run_migrations()

    def put(
        self, connection: sa.Connection, job: Mapping[str, Any] | sa.RowMapping, version: str | None = None
    ) -> None:
        """Put the workflow of a job into the queue, inside the caller's transaction; twice is once.

        Args:
            connection: of the transaction.
            job: ``id``, ``workflow``, ``kind`` and ``turn`` of the job.
            version: of the program that is to take it; None for any.
        """
        options: Any = {
            "queue_name": KINDS[job["kind"]].place, "workflow_name": WORKFLOW, "workflow_id": job["workflow"],
            "priority": job["turn"],
        }  # fmt: skip
        if version is not None:
            options["app_version"] = version
        self.client.enqueue_in_transaction(connection, options, job["id"])

    def move(self, connection: sa.Connection, workflow: str, turn: int) -> None:
        """Give a workflow that waits another turn, inside the caller's transaction."""
        status = self.client._sys_db.tables.workflow_status
        query = sa.update(status).where(status.c.workflow_uuid == workflow, status.c.status == "ENQUEUED")
        connection.execute(query.values(priority=turn))

    def cancel(self, workflow: str) -> None:
        """A workflow that waits never starts; one that runs starts no further step."""
        self.client.cancel_workflow(workflow)

    def unfinished(self) -> list[Any]:
        """``dbos.WorkflowStatus`` of all workflows that wait or run."""
        return self.client.list_workflows(
            status=["PENDING", "ENQUEUED"], name=WORKFLOW, load_input=False, load_output=False
        )

    def states(self, workflows: list[str]) -> dict[str, Any]:
        """``dbos.WorkflowStatus`` of each of these workflows that exists."""
        if not workflows:
            return {}
        found = self.client.list_workflows(workflow_ids=workflows, load_input=False, load_output=False)
        return {status.workflow_id: status for status in found}

    def lead(self, version: str, alive: Collection[str]) -> bool:
        """Make a version of the steps the one that takes new jobs, where the one that should is not there any more.

        DBOS gives what waits to the version that was introduced last. After the way back to an older one that would be
        nobody, and all jobs would wait for ever.

        Args:
            version: of a worker that has been launched.
            alive: versions of the workers that live.

        Returns:
            Whether anything was changed.
        """
        latest = self.client.get_latest_application_version()["version_name"]
        if latest == version or latest in alive:
            return False
        self.client.set_latest_application_version(version)
        return True

    def delete(self, workflows: list[str]) -> None:
        """Forget workflows."""
        if workflows:
            self.client.delete_workflows(workflows)
