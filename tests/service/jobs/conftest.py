from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dbos import WorkflowStatus

from service.jobs import runner
from service.jobs.admission import Bounds, NewJob
from service.jobs.artifacts import Artifacts
from service.jobs.database import connect, create_tables
from service.jobs.queue import WORKFLOW, Queue
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from service.jobs.store import Store
from tests.service.databases import lay_out

TOY = "tests.support.toy_job"


def unfinished(queue: Queue) -> list[WorkflowStatus]:
    """All workflows of jobs that wait or run, oldest first; the program never asks for so much."""
    return queue.client.list_workflows(status=["PENDING", "ENQUEUED"], name=WORKFLOW)


class Bench:
    """The parts of the service on a database of their own, without any process."""

    def __init__(self, data: Path, artifacts: str = "", database: str = "") -> None:
        self.settings = Settings(
            data=data, artifacts=artifacts, database=database, program=TOY, memory_mb=512, job_seconds=200, niceness=0
        )  # fmt: skip
        lay_out(data)
        self.engine = connect(self.settings.database_url)
        create_tables(self.engine, self.settings)
        self.store = Store(self.engine)
        self.queue = self.store.queue
        self.artifacts = Artifacts(self.settings.artifacts_url)
        self.runner = Runner(self.settings, self.store, self.artifacts)
        self._count = itertools.count(1)

    def add(
        self, seed: int = 0, *, tenant: str = "t", key: str | None = None, keep_photo: bool = False,
        bounds: Bounds | None = None, **more: Any,
    ) -> str:  # fmt: skip
        """Store a job with a photo, as the interface does; returns its id."""
        number = next(self._count)
        job = f"{number:032x}"
        content = f"photo {number}".encode()
        digest = hashlib.sha256(content).hexdigest()
        upload = self.settings.data / f"upload-{number}"
        upload.write_bytes(content)
        name = f"{job}/photo-{digest}.bin"
        self.artifacts.put(upload, name)
        new = NewJob(
            id=job, tenant=tenant, options={"seed": seed}, photo=name, photo_sha256=digest, photo_bytes=len(content),
            keep_photo=keep_photo, key=key, digest=digest, **more,
        )  # fmt: skip
        self.store.add(new, bounds)
        return job

    def row(self, job: str) -> Any:
        """What the database knows of a job, which has to be there."""
        found = self.store.get(job)
        assert found is not None
        return found

    def close(self) -> None:
        self.runner.stop()
        self.queue.client.destroy()
        self.engine.dispose()

    def run(self, job: str) -> str:
        """All steps of a job, one after the other, here."""
        accepted = self.runner.accept(f"{job}.1")
        if accepted["kind"] != "wanted":
            return str(accepted["kind"])
        return self.runner.publish(job, self.runner.make(job))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(runner, "AFTERMATH", 0.05)  # the end of everything does not come
    made = Bench(tmp_path / "data")
    yield made
    made.close()
