"""Several workers on one Postgres: one is killed again and again, one is frozen for a while, the line of one is slow
and then dead for a while, and Postgres is restarted.

    python -m benchmarks.chaos_postgres --seconds 240

Every accepted job has to succeed with the bytes of an undisturbed run. Needs Debian's package postgresql.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import httpx

from benchmarks.line import Line
from benchmarks.postgres import Postgres
from benchmarks.serving import Server, post, small_photo, wait_for
from benchmarks.toy_job import SECONDS, archive
from service.jobs.process import descendants
from service.jobs.settings import PREFIX


class Workers:
    """Processes of ``avatarme worker`` that share a database and a folder of artifacts.

    Args:
        folder: for their data and logs.
        settings: of all of them.
        names: one for each.
        own: settings of single workers by name.
    """

    def __init__(
        self,
        folder: Path,
        settings: dict[str, object],
        names: Sequence[str],
        own: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        self._folder = folder
        self._settings = settings
        self._own = own or {}
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            self.start(name)

    def start(self, name: str) -> None:
        """Start the worker of a name."""
        values = {**self._settings, **self._own.get(name, {}), "data": self._folder / name, "worker": name}
        environment = os.environ | {PREFIX + key.upper(): str(value) for key, value in values.items()}
        environment[SECONDS] = "1.0"
        with (self._folder / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(
                [sys.executable, "-m", "service", "worker"], env=environment, stdout=log, stderr=log
            )

    def signal(self, name: str, number: signal.Signals, *, jobs: bool = True) -> None:
        """Send a signal to a worker, and to the processes of its jobs unless ``jobs`` is False."""
        process = self.running[name].pid
        for other in [process, *descendants(process)]:
            with contextlib.suppress(OSError):
                if jobs or b"toy_job" not in Path(f"/proc/{other}/cmdline").read_bytes():
                    os.kill(other, number)

    def stop(self) -> None:
        """Kill all."""
        for name, process in self.running.items():
            self.signal(name, signal.SIGCONT)
            self.signal(name, signal.SIGKILL)
            process.wait()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=240)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--every", type=float, default=20, help="seconds between two kills")
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="chaos-postgres-"))
    lost = run(folder, asked.seconds, asked.workers, asked.every)
    if not lost:
        shutil.rmtree(folder)
    raise SystemExit(1 if lost else 0)


def run(folder: Path, seconds: float, count: int, every: float) -> list[str]:
    """Run it; returns a line for each job that was lost or has other bytes."""
    postgres = Postgres(folder)
    postgres.start()
    settings: dict[str, object] = {
        "database": postgres.url, "artifacts": f"file://{folder}/artifacts", "program": "benchmarks.toy_job",
        "reserve_mb": 1, "niceness": 0,
    }  # fmt: skip
    server = Server(folder / "server", settings, with_worker=False)
    server.start(ready=False)
    line = Line(postgres.port)
    own = {"w0": {"database": postgres.url_by(line.port)}}
    workers = Workers(folder, settings, [f"w{number}" for number in range(count)], own)
    accepted: dict[str, tuple[str, int]] = {}
    try:
        server.wait("readyz")
        over = threading.Event()
        poster = threading.Thread(target=_post, args=(server, accepted, over))
        poster.start()
        lines = threading.Thread(target=_disturb_line, args=(line, over, seconds / 6))
        lines.start()
        kills = _disturb(workers, postgres, seconds, every)
        over.set()
        poster.join()
        lines.join()
        begin = time.monotonic()
        states, lost = _look(server, accepted)
        print(f"{kills} workers killed, one frozen for a third of the time, Postgres stopped once like by a power cut")
        print("the line between w0 and Postgres was slow again and again, then dead for 20 to 40 s")
        print(f"{len(accepted)} jobs accepted; at the end {dict(states)}, {time.monotonic() - begin:.0f} s afterwards")
        print(f"lost or other bytes: {len(lost)}")
        for lost_job in lost:
            print(lost_job)
        return lost
    finally:
        workers.stop()
        server.kill()
        line.close()
        with contextlib.suppress(subprocess.CalledProcessError):
            postgres.stop()


def _disturb(workers: Workers, postgres: Postgres, seconds: float, every: float) -> int:
    """Kill a worker ``every`` seconds, freeze the last one in the middle third, restart Postgres in the middle."""
    names = list(workers.running)
    begin, kills, frozen, restarted = time.monotonic(), 0, False, False
    while (passed := time.monotonic() - begin) < seconds:
        if not frozen and passed > seconds / 3:
            workers.signal(names[-1], signal.SIGSTOP)
            frozen = True
        if not restarted and passed > seconds / 2:
            postgres.stop("immediate")
            time.sleep(8)
            postgres.start()
            restarted = True
        if frozen and passed > seconds * 2 / 3:
            workers.signal(names[-1], signal.SIGCONT)
        time.sleep(every / 2)
        victim = random.choice(names[:-1])  # noqa: S311 - whom to kill is no secret
        workers.signal(victim, signal.SIGKILL)
        kills += 1
        time.sleep(every / 2)
        for name in names[:-1]:
            if workers.running[name].poll() is not None:
                workers.start(name)
    workers.signal(names[-1], signal.SIGCONT)
    for name in names:
        if workers.running[name].poll() is not None:
            workers.start(name)
    return kills


def _disturb_line(line: Line, over: threading.Event, whole: float) -> None:
    """Good for a while, late by 0.5 to 2 s as long, dead for 20 to 40 s; and again until it is ``over``."""
    while not over.wait(whole):
        line.delay = random.uniform(0.5, 2.0)  # noqa: S311 - no secret
        over.wait(whole)
        line.split()
        over.wait(random.uniform(20.0, 40.0))  # noqa: S311
        line.delay = 0.0
        line.mend(forget=random.random() < 0.5)  # noqa: S311
    line.delay = 0.0


def _post(server: Server, accepted: dict[str, tuple[str, int]], over: threading.Event) -> None:
    count = 0
    with httpx.Client(base_url=server.url, timeout=30) as client:
        while not over.is_set():
            count += 1
            photo = small_photo(count)
            while not over.is_set():
                with contextlib.suppress(httpx.HTTPError):
                    seed = count % 100  # above are the faults of the small job
                    answer = post(client, photo, seed, f"key-{count}")
                    if answer.status_code == 202:
                        accepted[answer.json()["id"]] = (hashlib.sha256(photo).hexdigest(), seed)
                        break
                time.sleep(0.5)
            over.wait(3.0)


def _look(server: Server, accepted: dict[str, tuple[str, int]]) -> tuple[Counter[str], list[str]]:
    states: Counter[str] = Counter()
    lost = []
    with httpx.Client(base_url=server.url, timeout=30) as client:
        for job, (digest, seed) in accepted.items():
            state = wait_for(client, job, within=600)
            states[state["state"]] += 1
            content = client.get(f"/v1/avatars/{job}/archive.zip").content
            if state["state"] != "succeeded" or content != archive(digest, seed):
                lost.append(f"{job}: {state}")
    return states, lost


if __name__ == "__main__":
    main()
