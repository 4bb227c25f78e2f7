"""One job of the product, killed in each of its stages.

In a file and at a server of its own, so that it runs beside the other doors.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import httpx

from service.jobs.process import descendants
from tests.end_to_end.command import avatarme
from tests.product.conftest import FLAGS, PEOPLE, Service, running
from tests.support.moments import REAL_STAGES, kept_stages


def kept(service: Service, job: str) -> set[str]:
    """Stages of a job whose results are on the disk."""
    return {stage for owner, stage in kept_stages(service.server.data) if owner == job}


def moments(service: Service, job: str) -> Iterator[str]:
    """Waits for each stage of a job in turn, and says which it is in."""
    for done, stage in zip(("", *REAL_STAGES), (*REAL_STAGES, "pack"), strict=True):
        deadline = time.monotonic() + 120
        while done and done not in kept(service, job):
            assert time.monotonic() < deadline, f"{job} does not come to {stage}"
            time.sleep(0.002)
        while done and told_stage(service, job) in ("", *REAL_STAGES[: REAL_STAGES.index(done) + 1]):
            assert time.monotonic() < deadline, f"nobody is told that {job} has come to {stage}"
            time.sleep(0.01)
        yield stage


def told_stage(service: Service, job: str) -> str:
    """The stage that the service says the job is in: what came before it is then known to have been of use."""
    try:
        return str(service.client.get(f"/v1/avatars/{job}").json().get("stage") or "")
    except httpx.HTTPError:  # it starts
        return ""


def worker_and_below(service: Service) -> list[int]:
    worker = service.server.worker()
    return [] if worker is None else [worker, *descendants(worker)]


def test_killed_in_every_stage_a_job_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """SIGKILL in turns to everything, and to the worker and what it started; what was kept stays kept.

    A worker that ends again and again is started after longer and longer pauses, which end with the server.
    """
    photo = PEOPLE / "closed.jpg"
    run = avatarme("make", photo, "-o", tmp_path / "closed.zip", *FLAGS)
    assert run.status == 0, run.stderr
    with running(tmp_path / "data") as service:
        killed_in_every_stage(service, photo.read_bytes(), (tmp_path / "closed.zip").read_bytes())


def killed_in_every_stage(service: Service, photo: bytes, wanted: bytes) -> None:
    job = service.post(photo)
    killed: list[str] = []
    for stage in moments(service, job):
        before = kept(service, job)
        if len(killed) % 2 == 0:
            service.server.kill()
            service.server.start(ready=False)
        else:
            for process in worker_and_below(service):
                with contextlib.suppress(OSError):
                    os.kill(process, signal.SIGKILL)
        assert before <= kept(service, job)
        killed.append(stage)
    assert killed == [*REAL_STAGES, "pack"]
    assert service.archive(job) == wanted
    assert kept(service, job) == set(), "what was kept for a restart is erased at the end"
