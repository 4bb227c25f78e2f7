"""Whether the service grows: an hour of small jobs, with memory, files and threads of its processes written down.

    python -m benchmarks.soak --minutes 60

Photos are posted at a steady pace, followed by events or by asking, fetched, compared and, every other one, erased;
bad photos come between them. Results expire after a few minutes, so that what is kept reaches its level. After a third
of the time everything has to stay where it is: the line through the rest (Theil and Sen) must not rise by more than is
allowed within an hour. Jobs are those of ``tests.support.toy_job``.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import itertools
import json
import os
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import httpx

from service.jobs.process import resident_mb
from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import SECONDS, archive

PATIENCE = 600.0
"""Seconds that a job may take, on a machine that other work keeps busy."""

WARM = 1 / 3
"""Share of the run after which nothing may grow any more."""

ALLOWED = {"mb": 0.05, "fds": 0.02, "threads": 0.02, "files": 0.05, "disk_mb": 0.10}
"""What may be added within an hour, as a share of the median; and at least ``LEAST`` of each."""

LEAST = {"mb": 4.0, "fds": 2.0, "threads": 1.0, "files": 20.0, "disk_mb": 4.0}


@dataclass
class Soaked:
    """What a run found.

    Attributes:
        series: name of what was looked at -> (hours since the begin, value) of each look.
        jobs: number of jobs by what became of them.
        wrong: jobs whose archive is not that of an undisturbed run, or that did not end as they should.
        workers: process ids that the worker had; more than one means that it was started again.
    """

    series: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    jobs: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    workers: set[int] = field(default_factory=set)


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Median of the slopes between all pairs of points (Theil and Sen): a single outlier does not move it.

    Args:
        points: (hours, value); 0 for fewer than two moments.
    """
    slopes = [(second[1] - first[1]) / (second[0] - first[0]) for first, second in itertools.combinations(points, 2)
              if second[0] > first[0]]  # fmt: skip
    return median(slopes) if slopes else 0.0


def growth(series: Mapping[str, Sequence[tuple[float, float]]]) -> dict[str, dict[str, float | bool]]:
    """Level, range, rise within an hour and whether that is too much, of the settled part of each series."""
    found: dict[str, dict[str, float | bool]] = {}
    for name, points in series.items():
        end = max((moment for moment, _ in points), default=0.0)
        settled = [point for point in points if point[0] >= end * WARM]
        values = [value for _, value in settled]
        if not values:
            continue
        kind = name.rpartition(" ")[2]
        middle, rise = median(values), slope(settled)
        found[name] = {
            "first": round(points[0][1], 1), "median": round(middle, 1), "most": round(max(values), 1),
            "rise_per_hour": round(rise, 2), "grows": rise > max(LEAST[kind], ALLOWED[kind] * middle),
        }  # fmt: skip
    return found


def soak(folder: Path, minutes: float, every: float, look: float) -> Soaked:
    """Run it.

    Args:
        folder: for the data of the service.
        minutes: for how long.
        every: seconds between two photos.
        look: seconds between two looks at the processes.
    """
    hours = max(minutes / 600, 0.005)  # a tenth of the run
    server = Server(folder / "data", {"result_hours": hours, "tombstone_hours": hours, "jobs": 2}, {SECONDS: "0.05"})
    server.start()
    soaked, over = Soaked(), threading.Event()
    begin = time.monotonic()
    # Two at a time: a job that waits for the processor holds up only every other photo.
    posters = [threading.Thread(target=_post, args=(server, soaked, over, 2 * every, first)) for first in (1, 2)]
    for poster in posters:
        poster.start()
    try:
        while (passed := time.monotonic() - begin) < minutes * 60:
            _look(server, soaked, passed / 3600)
            time.sleep(min(look, minutes * 60 - passed))
    finally:
        over.set()
        for poster in posters:
            poster.join()
        server.stop()
    return soaked


def _look(server: Server, soaked: Soaked, hours: float) -> None:
    worker = server.worker()
    watched = {"server": server.processes()[0], **({"worker": worker} if worker is not None else {})}
    if worker is not None:
        soaked.workers.add(worker)
    for name, process in watched.items():
        with contextlib.suppress(OSError):
            facts = {
                "mb": resident_mb(process),
                "fds": float(len(os.listdir(f"/proc/{process}/fd"))),
                "threads": float(len(os.listdir(f"/proc/{process}/task"))),
            }
            for kind, value in facts.items():
                soaked.series.setdefault(f"{name} {kind}", []).append((hours, value))
    sizes = []
    for folder, _, names in os.walk(server.data):  # does not mind folders that go while it walks
        for name in names:
            with contextlib.suppress(OSError):
                sizes.append(os.path.getsize(os.path.join(folder, name)))
    soaked.series.setdefault("data files", []).append((hours, float(len(sizes))))
    soaked.series.setdefault("data disk_mb", []).append((hours, sum(sizes) / 2**20))


def _post(server: Server, soaked: Soaked, over: threading.Event, every: float, first: int) -> None:
    """Every other photo, one after the other, at a steady pace."""
    for count in itertools.count(first, 2):
        due = time.monotonic() + every
        # A client of its own for each photo: connections open and close as they do with many users.
        with httpx.Client(base_url=server.url, timeout=60) as client:
            try:
                _one(client, soaked, count)
            except (httpx.HTTPError, TimeoutError, KeyError) as error:
                soaked.wrong.append(f"photo {count}: {error!r}")
        if over.wait(max(0.0, due - time.monotonic())):
            return


def _one(client: httpx.Client, soaked: Soaked, count: int) -> None:
    photo = small_photo(count)
    if count % 5 == 0:
        status = post(client, photo[: len(photo) // 2], count).status_code
        soaked.jobs["refused" if status == 422 else f"refused with {status}"] += 1
    seed = 104 if count % 7 == 0 else count % 50  # 104: there is no face
    job = post(client, photo, seed, f"key-{count}").json()["id"]
    if count % 2:
        with client.stream("GET", f"/v1/avatars/{job}/events", timeout=60) as events:
            for _ in events.iter_lines():
                pass
    state = wait_for(client, job, within=PATIENCE)["state"]
    soaked.jobs[state] += 1
    if state != ("failed" if seed == 104 else "succeeded"):
        soaked.wrong.append(f"{job}: {state}")
    if state == "succeeded":
        content = client.get(f"/v1/avatars/{job}/archive.zip").content
        if content != archive(hashlib.sha256(photo).hexdigest(), seed):
            soaked.wrong.append(f"{job}: other bytes")
    if count % 4 < 2:
        client.delete(f"/v1/avatars/{job}")
        soaked.jobs["erased"] += 1


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--every", type=float, default=5, help="seconds between two photos")
    parser.add_argument("--look", type=float, default=15, help="seconds between two looks at the processes")
    parser.add_argument("--series", type=Path, help="file for all that was seen, as JSON")
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    soaked = soak(folder, asked.minutes, asked.every, asked.look)
    if asked.series is not None:
        asked.series.write_text(json.dumps(soaked.series), "utf-8")
    found = growth(soaked.series)
    for name, facts in found.items():
        print(json.dumps({name: facts}))
    again = len(soaked.workers) - 1
    grows = [name for name, facts in found.items() if facts["grows"]]
    print(f"{dict(soaked.jobs)} in {asked.minutes:g} minutes; worker started again {again} times")
    print(f"wrong: {len(soaked.wrong)}; grows: {', '.join(grows) or 'nothing'}")
    for line in soaked.wrong:
        print(line)
    if not (soaked.wrong or grows or again):
        shutil.rmtree(folder)
    raise SystemExit(1 if soaked.wrong or grows or again else 0)


if __name__ == "__main__":
    main()
