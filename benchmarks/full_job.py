"""One photo with the full maps through the service, everything killed once on the way.

    python -m benchmarks.full_job PHOTO [--kill-at specular_normal]

Prints when each stage begins, and in the end the time and the most memory and disk that the job took.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx

from benchmarks.serving import Server
from service.jobs.process import resident_mb

LONGEST_S = 3600.0


class Watch:
    """What a job takes, looked at again and again."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._begin = time.monotonic()
        self._stage: str | None = None
        self.memory_mb = self.disk_mb = 0.0

    def look(self, state: dict[str, Any]) -> bool:
        """Take note; True where a new stage has begun."""
        worker = self._server.worker()
        others = [process for process in self._server.processes()[1:] if process != worker]
        self.memory_mb = max(self.memory_mb, sum(resident_mb(process) for process in others))
        self.disk_mb = max(self.disk_mb, _megabytes(self._server.data))
        if state["stage"] == self._stage:
            return False
        self._stage = state["stage"]
        _print({"at_s": self.seconds(), "stage": self._stage, "disk_mb": round(self.disk_mb)})
        return True

    def seconds(self) -> float:
        """Since the beginning."""
        return round(time.monotonic() - self._begin, 1)


def run(server: Server, photo: Path, kill_at: str) -> dict[str, Any]:
    """Post the photo to a server that runs, kill everything 2 s after a stage began, and wait for the end."""
    watch, killed = Watch(server), False
    with httpx.Client(base_url=server.url, timeout=60) as client:
        job = client.post("/v1/avatars", files={"image": (photo.name, photo.read_bytes())}).json()["id"]
        while True:
            state: dict[str, Any] = client.get(f"/v1/avatars/{job}").json()
            began = watch.look(state)
            if began and state["stage"] == kill_at and not killed:
                time.sleep(2.0)
                server.kill()
                server.start()
                killed = True
            if state["state"] not in ("queued", "running") or watch.seconds() > LONGEST_S:
                break
            time.sleep(0.5)
        time.sleep(1.0)
    return {
        "state": state["state"], "killed_at": kill_at if killed else None, "seconds": watch.seconds(),
        "job_memory_mb": round(watch.memory_mb), "disk_mb": round(watch.disk_mb),
        "disk_after_mb": round(_megabytes(server.data)),
    }  # fmt: skip


def _megabytes(folder: Path) -> float:
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size
        except OSError:
            continue  # erased meanwhile
    return total / 2**20


def _print(found: dict[str, Any]) -> None:
    print(json.dumps(found), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photo", type=Path)
    parser.add_argument("--kill-at", default="specular_normal", help="stage at which everything is killed; '' for none")
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="full-job-"))
    server = Server(folder / "data", {"program": "service.jobs.child", "reserve_mb": 2048, "niceness": 10})
    server.start()
    try:
        _print(run(server, asked.photo, asked.kill_at))
    finally:
        server.kill()
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
