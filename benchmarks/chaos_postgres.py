"""Several workers on one Postgres: they are killed again and again, one is frozen for a while, the line of one is slow
and then dead for a while, and Postgres is restarted.

    python -m benchmarks.chaos_postgres --kills 200 --jobs 1000

The moments of the kills are spread evenly over ``tests.support.moments.POINTS``, and the worker that is killed is the
one that came to that point. Every accepted job has to succeed once, with the bytes of an undisturbed run. Needs
Debian's package postgresql.
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
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from service.jobs.process import descendants
from service.jobs.settings import PREFIX
from service.jobs.view import FINAL
from tests.support.moments import POINTS, reached
from tests.support.postgres import Postgres
from tests.support.server import Server, listed, post, small_photo, wait_for
from tests.support.slow_line import Line
from tests.support.toy_job import LOG, SECONDS, archive


class Workers:
    """Processes of ``avatarme worker`` that share a database and a folder of artifacts.

    Args:
        folder: for their data and logs.
        settings: of all of them.
        names: one for each.
        own: settings of single workers by name.
        log: that the toy job writes, if any.
        seconds: that each stage takes.
    """

    def __init__(
        self,
        folder: Path,
        settings: dict[str, object],
        names: Sequence[str],
        own: Mapping[str, Mapping[str, object]] | None = None,
        log: Path | None = None,
        seconds: float = 1.0,
    ) -> None:
        self._folder = folder
        self._settings = settings
        self._own = own or {}
        self._environment = {SECONDS: str(seconds)} | ({} if log is None else {LOG: str(log)})
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            self.start(name)

    def start(self, name: str) -> None:
        """Start the worker of a name."""
        values = {**self._settings, **self._own.get(name, {}), "data": self._folder / name, "worker": name}
        environment = os.environ | {PREFIX + key.upper(): str(value) for key, value in values.items()}
        environment |= self._environment
        with (self._folder / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(
                [sys.executable, "-m", "service", "worker"], env=environment, stdout=log, stderr=log
            )

    def restart(self) -> None:
        """Start those again that do not run."""
        for name, process in self.running.items():
            if process.poll() is not None:
                self.start(name)

    def owner(self, line: str) -> str | None:
        """The worker whose job wrote a line of the log, None where it has ended or is the frozen one's."""
        job = int(line.split()[-1])
        for name, process in self.running.items():
            if job in descendants(process.pid):
                return name
        return None

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


@dataclass
class Findings:
    """What a run found.

    Attributes:
        accepted: job -> (digest of the photo, seed).
        asked: number of requests that were begun.
        points: number of kills at each of ``POINTS``.
        states: number of jobs by their last state.
        lost: jobs that did not succeed.
        wrong: jobs whose archive is not that of an undisturbed run.
        twice: jobs whose end was told more than once, or that nobody was told of: made twice of one request.
        after: seconds from the last kill to the end of the last job.
        seconds: of the run.
    """

    accepted: dict[str, tuple[str, int]] = field(default_factory=dict)
    asked: int = 0
    points: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    twice: list[str] = field(default_factory=list)
    after: float = 0.0
    seconds: float = 0.0

    def well(self) -> bool:
        """Whether every promise was kept."""
        return bool(self.accepted) and not (self.lost or self.wrong or self.twice)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=0, help="post on until so many were accepted")
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--pause", type=float, default=1.0, help="seconds between two photos")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="kill no more after so many")
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="chaos-postgres-"))
    findings = run(folder, asked.kills, asked.jobs, asked.workers, asked.pause, asked.minutes)
    if findings.well():
        shutil.rmtree(folder)
    print(f"{findings.points.total()} workers killed in {findings.seconds:.0f} s")
    print("at " + ", ".join(f"{point}: {count}" for point, count in findings.points.items()))
    print("one frozen for a third of the time, Postgres stopped once as by a power cut")
    print("the line between w0 and Postgres was slow again and again, then dead for 20 to 40 s")
    print(f"{len(findings.accepted)} jobs accepted; {findings.after:.0f} s after the end {dict(findings.states)}")
    print(f"lost {len(findings.lost)}, made twice {len(findings.twice)}, other bytes {len(findings.wrong)}")
    for line in (*findings.lost, *findings.twice, *findings.wrong):
        print(line)
    raise SystemExit(0 if findings.well() else 1)


def run(
    folder: Path, kills: int, jobs: int, count: int, pause: float = 1.0, minutes: float = float("inf")
) -> Findings:
    """Run it.

    Args:
        folder: for database, artifacts and logs.
        kills: how many workers to kill.
        jobs: post on until so many were accepted.
        count: workers.
        pause: seconds between two photos.
        minutes: after which no more is killed.
    """
    start = time.monotonic()
    postgres = Postgres(folder)
    postgres.start()
    settings: dict[str, object] = {
        "database": postgres.url, "artifacts": f"file://{folder}/artifacts", "program": "tests.support.toy_job",
        "reserve_mb": 1, "niceness": 0,
    }  # fmt: skip
    server = Server(folder / "server", settings, with_worker=False)
    server.start(ready=False)
    line = Line(postgres.port)
    own = {"w0": {"database": postgres.url_by(line.port)}}
    log = folder / "stages.log"
    workers = Workers(folder, settings, [f"w{number}" for number in range(count)], own, log, 0.3)
    findings, over = Findings(), threading.Event()
    try:
        server.wait("readyz")
        threads = [
            threading.Thread(target=_post, args=(server, findings, over, pause)),
            threading.Thread(target=_disturb_line, args=(line, over)),
        ]
        for thread in threads:
            thread.start()
        try:
            _disturb(workers, postgres, kills, findings, log, start + minutes * 60)
            while len(findings.accepted) < jobs:
                time.sleep(0.2)
        finally:
            over.set()
            for thread in threads:
                thread.join()
        begin = time.monotonic()
        _look(server, findings)
        findings.after = time.monotonic() - begin
        findings.seconds = time.monotonic() - start
        return findings
    finally:
        workers.stop()
        server.kill()
        line.close()
        with contextlib.suppress(subprocess.CalledProcessError):
            postgres.stop()


def _disturb(
    workers: Workers, postgres: Postgres, kills: int, findings: Findings, log: Path, until: float
) -> None:
    """Kill workers at each point in turn; freeze the last one in the middle third; restart Postgres in the middle."""
    names = list(workers.running)
    for number in range(kills):
        if time.monotonic() > until:
            break
        if number == kills // 3:
            workers.signal(names[-1], signal.SIGSTOP)
        if number == kills // 2:
            postgres.stop("immediate")
            time.sleep(8)
            postgres.start()
        if number == kills * 2 // 3:
            workers.signal(names[-1], signal.SIGCONT)
        point = POINTS[number % len(POINTS)]
        met = reached(point, log, lambda: findings.asked)
        victim = workers.owner(met) if met else None
        findings.points[point if met is not None else "elsewhere"] += 1
        time.sleep(random.uniform(0.0, 2.5 if point == "starting" else 0.1))  # noqa: S311 - no secret
        victim = victim or random.choice(names[:-1])  # noqa: S311
        workers.signal(victim, signal.SIGKILL)
        workers.restart()
    workers.signal(names[-1], signal.SIGCONT)
    workers.restart()


def _disturb_line(line: Line, over: threading.Event, whole: float = 40.0) -> None:
    """Good for a while, late by 0.5 to 2 s as long, dead for 20 to 40 s; and again until it is ``over``."""
    while not over.wait(whole):
        line.delay = random.uniform(0.5, 2.0)  # noqa: S311 - no secret
        over.wait(whole)
        line.split()
        over.wait(random.uniform(20.0, 40.0))  # noqa: S311
        line.delay = 0.0
        line.mend(forget=random.random() < 0.5)  # noqa: S311
    line.delay = 0.0


def _post(server: Server, findings: Findings, over: threading.Event, pause: float) -> None:
    count = 0
    with httpx.Client(base_url=server.url, timeout=30) as client:
        while not over.is_set():
            count += 1
            photo = small_photo(count)
            for _ in range(600):  # also when it is over: what may have been stored has to be known
                findings.asked += 1
                with contextlib.suppress(httpx.HTTPError):
                    seed = count % 100  # above are the faults of the small job
                    answer = post(client, photo, seed, f"key-{count}")
                    if answer.status_code == 202:
                        findings.accepted[answer.json()["id"]] = (hashlib.sha256(photo).hexdigest(), seed)
                        break
                time.sleep(0.5)
            over.wait(pause)


def _look(server: Server, findings: Findings) -> None:
    """What became of the jobs, when all have ended."""
    with httpx.Client(base_url=server.url, timeout=30) as client:
        for job, (digest, seed) in findings.accepted.items():
            state = wait_for(client, job, within=600)
            findings.states[state["state"]] += 1
            if state["state"] != "succeeded":
                findings.lost.append(f"{job}: {state}")
            elif client.get(f"/v1/avatars/{job}/archive.zip").content != archive(digest, seed):
                findings.wrong.append(job)
            told = client.get(f"/v1/avatars/{job}/events").text
            if sum(told.count(f'"state": "{end}"') for end in FINAL) != 1:
                findings.twice.append(job)
        findings.twice += [job for job in listed(client) if job not in findings.accepted]


if __name__ == "__main__":
    main()
