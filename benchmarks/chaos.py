"""Nothing is lost: post photos, kill the service again and again, and look at what became of every accepted job.

    python -m benchmarks.chaos --kills 200 --jobs 1000

    python -m benchmarks.chaos --real --kills 50

Jobs are those of ``tests.support.toy_job``, with ``--real`` small drafts of the shipped pipeline, of four photos. Every
kill is SIGKILL to the whole process tree, to the server alone or to the worker alone. The moments are spread evenly
over ``Toys.points``: while a photo is taken in, in each stage, while the archive is packed and published, and soon
after a start. ``benchmarks.batch_chaos`` does the same to several workers on one Postgres.

Afterwards every job that was answered with 202 must have succeeded, or failed where its photo has to fail, and been
told so once; its archive must be that of an undisturbed run byte for byte, no stage whose result was on the disk may
have been computed again (which the toys tell), and there may be no job that nobody was told of.
"""

from __future__ import annotations

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
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import httpx
import typer

from service.diagnosis import SAMPLE
from service.jobs.view import FINAL
from tests.support.moments import POINTS, REAL_STAGES, reached, really_reached, redone
from tests.support.server import Server, listed, post, small_photo, wait_for
from tests.support.toy_job import LOG, SECONDS, archive

FAILING = {101: "crashed", 104: "no-face", 105: "internal"}
"""Seeds of jobs that have to fail, with the code that they have to fail with; see ``tests.support.toy_job.FAULTS``."""

_EVERY = 25
"""One photo of so many is one that has to fail."""

LOG_FILE = "stages.log"
"""That the toys write."""


@dataclass
class Findings:
    """What a run found.

    Attributes:
        accepted: job -> (digest of the photo, seed).
        asked: number of requests that were begun.
        kills: number of kills by kind.
        points: number of kills at each of ``POINTS``.
        states: number of jobs by their last state.
        failures: number of failed jobs by their code.
        wrong: jobs whose archive is not that of an undisturbed run.
        lost: jobs that did not succeed, or did not fail as they had to.
        twice: jobs whose end was told more than once, or that nobody was told of: made twice of one request.
        redone: stages that were computed again although their result was kept.
        leftovers: files of uploads and stages that nobody needs.
    """

    accepted: dict[str, tuple[str, int]] = field(default_factory=dict)
    asked: int = 0
    kills: Counter[str] = field(default_factory=Counter)
    points: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    twice: list[str] = field(default_factory=list)
    redone: list[str] = field(default_factory=list)
    leftovers: list[str] = field(default_factory=list)

    def well(self) -> bool:
        """Whether every promise was kept."""
        return bool(self.accepted) and not (self.wrong or self.lost or self.twice or self.redone or self.leftovers)


class Toys:
    """Jobs of ``tests.support.toy_job``, some of which have to fail: what the service is given to do.

    Attributes:
        settings: of the server.
        options: of each job, besides the seed.
        points: where to kill, in turn.
        failing: seeds of jobs that have to fail, with their codes.
        one_by_one: whether a poster waits for the end of its job before it posts the next.
    """

    settings: ClassVar[dict[str, Any]] = {}
    options: ClassVar[dict[str, Any]] = {}
    points: tuple[str, ...] = POINTS
    failing: ClassVar[dict[int, str]] = FAILING
    one_by_one = False

    def photo(self, poster: int, count: int) -> tuple[bytes, int]:
        """The photo that a poster posts next, and its seed: another one each time; one of so many has to fail."""
        fails = count % _EVERY == 0
        seed = list(FAILING)[count // _EVERY % len(FAILING)] if fails else count % 100
        return small_photo(1000 * poster + count), seed

    def wanted(self, digest: str, seed: int) -> bytes:
        """The archive of an undisturbed run."""
        return archive(digest, seed)

    def reached(self, point: str, folder: Path, asked: Callable[[], int]) -> str | None:
        """Wait for a point; None where it does not come."""
        return reached(point, folder / LOG_FILE, asked)


class Avatars(Toys):
    """Small drafts by the shipped networks, compared with what the command makes of the same photos.

    Args:
        folder: for what the command makes.
    """

    settings: ClassVar[dict[str, Any]] = {"program": "service.jobs.avatar_process"}
    options: ClassVar[dict[str, Any]] = {"quality": "draft", "size": [192, 128]}
    points = ("taking in", *REAL_STAGES, "starting")
    failing: ClassVar[dict[int, str]] = {}
    one_by_one = True

    def __init__(self, folder: Path) -> None:
        people = Path(__file__).parents[1] / "tests" / "data" / "people"
        self._photos = [SAMPLE, *(people / f"{name}.jpg" for name in ("closed", "full_beard", "mouth_open"))]
        self._wanted = {}
        for photo in self._photos:
            target = folder / f"{photo.stem}.zip"
            command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(target)]
            subprocess.run([*command, "--quality", "draft", "--size", "192x128"], check=True, capture_output=True)
            self._wanted[hashlib.sha256(photo.read_bytes()).hexdigest()] = target.read_bytes()

    def photo(self, poster: int, count: int) -> tuple[bytes, int]:
        """Each in turn."""
        return self._photos[(poster + count) % len(self._photos)].read_bytes(), 0

    def wanted(self, digest: str, seed: int) -> bytes:
        """Of the command."""
        return self._wanted[digest]

    def reached(self, point: str, folder: Path, asked: Callable[[], int]) -> str | None:
        """By the files of kept stages."""
        return really_reached(point, folder / "data", asked)


def kill(server: Server, chance: random.Random) -> str:
    """Kill the server, its worker or both, and start again what ended; returns which."""
    kind = chance.choices(("everything", "server", "worker"), (6, 2, 2))[0]
    if kind == "worker":
        worker = server.worker()
        if worker is not None:
            with contextlib.suppress(OSError):
                os.kill(worker, signal.SIGKILL)
        return kind
    if kind == "server" and server.process is not None:
        server.process.kill()
        server.process.wait()
        time.sleep(0.1)  # its worker ends with it
    else:
        server.kill()
    server.start(ready=False)
    return kind


def _post(number: int, server: Server, findings: Findings, over: threading.Event, pause: float, work: Toys) -> None:
    """Post one photo after the other; a request without an answer is sent again with the same key."""
    count = 0
    with httpx.Client(base_url=server.url, timeout=10) as client:
        while not over.is_set():
            count += 1
            (photo, seed), key = work.photo(number, count), f"{number}-{count}"
            digest = hashlib.sha256(photo).hexdigest()
            for _ in range(600):  # also when it is over: what may have been stored has to be known
                findings.asked += 1
                try:
                    answer = post(client, photo, seed, key, **work.options)
                except httpx.HTTPError:
                    time.sleep(0.2)
                    continue
                if answer.status_code == 202:
                    job = answer.json()["id"]
                    findings.accepted[job] = (digest, seed)
                    while work.one_by_one and not over.is_set() and not _ended(client, job):
                        time.sleep(0.2)
                    break
                time.sleep(0.2)
            time.sleep(pause)


def _ended(client: httpx.Client, job: str) -> bool:
    try:
        return client.get(f"/v1/avatars/{job}").json().get("state") in FINAL
    except (httpx.HTTPError, ValueError):
        return False


def _look(server: Server, findings: Findings, work: Toys) -> None:
    with httpx.Client(base_url=server.url, timeout=30) as client:
        for job, (digest, seed) in findings.accepted.items():
            state = wait_for(client, job, within=600)
            findings.states[state.get("state", "unknown")] += 1
            code = (state.get("error") or {}).get("code")
            if code is not None:
                findings.failures[code] += 1
            if seed in work.failing:
                if code != FAILING[seed]:
                    findings.lost.append(f"{job}: {state}")
            elif state.get("state") != "succeeded":
                findings.lost.append(f"{job}: {state}")
            elif client.get(f"/v1/avatars/{job}/archive.zip").content != work.wanted(digest, seed):
                findings.wrong.append(job)
            told = client.get(f"/v1/avatars/{job}/events").text
            if sum(told.count(f'"state": "{end}"') for end in FINAL) != 1:
                findings.twice.append(job)
        findings.twice += [job for job in listed(client) if job not in findings.accepted]


def _leftovers(data: Path, jobs: set[str]) -> list[str]:
    """Files of these jobs besides archives. An upload that was cut off belongs to no job and goes after an hour."""
    files = [
        path for job in jobs for path in (data / "artifacts" / job).glob("*") if not path.name.startswith("archive-")
    ]
    files += [path for path in (data / "scratch").rglob("*") if path.is_file()]
    return [str(path.relative_to(data)) for path in files]


def main(
    real: Annotated[bool, typer.Option("--real", help="Compute avatars rather than toys.")] = False,
    kills: int = 100,
    jobs: Annotated[int, typer.Option(help="Post on until so many were accepted.")] = 0,
    posters: Annotated[int, typer.Option(help="Threads that post photos.")] = 3,
    pause: Annotated[float, typer.Option(help="Seconds between two photos of one of them.")] = 1.5,
    seed: Annotated[int, typer.Option(help="Of the random choices.")] = 1,
    minutes: Annotated[float, typer.Option(help="Kill no more after so many.")] = float("inf"),
) -> None:
    """Run it, and print what was found."""
    begin, folder = time.monotonic(), Path(tempfile.mkdtemp(prefix="chaos-"))
    chance = random.Random(seed)  # noqa: S311 - when to kill is no secret
    work = Avatars(folder) if real else Toys()
    found, over = Findings(), threading.Event()
    server = Server(folder / "data", {"jobs": 2, **work.settings}, {LOG: str(folder / LOG_FILE), SECONDS: "0.15"})
    server.start(ready=False)
    arguments = (server, found, over, pause, work)
    threads = [threading.Thread(target=_post, args=(number, *arguments)) for number in range(posters)]
    for thread in threads:
        thread.start()
    try:
        try:
            for number in range(kills):
                if time.monotonic() - begin > minutes * 60:
                    break
                point = work.points[number % len(work.points)]
                met = work.reached(point, folder, lambda: found.asked)
                found.points[point if met is not None else "elsewhere"] += 1
                time.sleep(chance.uniform(0.0, 2.5 if point == "starting" else 0.1))
                found.kills[kill(server, chance)] += 1
            while len(found.accepted) < jobs:
                time.sleep(0.2)
        finally:
            over.set()
            for thread in threads:
                thread.join()
        if server.process is None or server.process.poll() is not None:
            server.start()
        server.wait("readyz")
        _look(server, found, work)
        time.sleep(7)  # leftovers are swept a few seconds after the end of a job
    finally:
        server.stop()
    found.redone = redone(folder / LOG_FILE)
    found.leftovers = _leftovers(server.data, set(found.accepted))
    if found.well():
        shutil.rmtree(folder)
    kinds = ", ".join(f"{count} of {kind}" for kind, count in found.kills.items())
    print(f"{found.kills.total()} kills ({kinds}) in {time.monotonic() - begin:.0f} s")
    print("at " + ", ".join(f"{point}: {count}" for point, count in found.points.items()))
    bound = sum(seed in FAILING for _, seed in found.accepted.values())
    print(f"{len(found.accepted)} jobs accepted; at the end {dict(found.states)}")
    print(f"failed {dict(found.failures)}; {bound} of the photos were made to fail so")
    print(f"lost {len(found.lost)}, made twice {len(found.twice)}, other bytes {len(found.wrong)}")
    print(f"stages redone {len(found.redone)}, files left over {len(found.leftovers)}")
    for line in (*found.lost, *found.twice, *found.wrong, *found.redone, *found.leftovers):
        print(line)
    raise SystemExit(0 if found.well() else 1)


if __name__ == "__main__":
    typer.run(main)
