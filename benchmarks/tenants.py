"""Two tenants at one worker: how long the small one waits beside one that has filled the queue.

    python -m benchmarks.tenants --jobs 20

The jobs are those of ``tests.support.toy_job`` and take the same time each. The small tenant posts one, waits for its
end, and posts the next: first alone, then while the large one has hundreds waiting. With fair turns it is behind one
other job at most, so its median is at most twice what it is alone; in one line for all it would wait for all of them.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import httpx

from service.api.keys import new_key
from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import SECONDS

STAGE_S = 0.7
"""Seconds of each of the three stages, so that a job is long beside what starts it."""


def waits(client: httpx.Client, count: int, first: int) -> list[float]:
    """Seconds from a post to its end, one after the other."""
    found = []
    for number in range(count):
        begin = time.monotonic()
        job = post(client, small_photo(first + number)).json()["id"]
        assert wait_for(client, job, within=600)["state"] == "succeeded"  # noqa: S101 - a benchmark's own check
        found.append(time.monotonic() - begin)
    return found


def run(folder: Path, jobs: int, crowd: int) -> tuple[list[float], list[float]]:
    """Waits of the small tenant alone, and beside a large one with ``crowd`` jobs."""
    small, large = new_key("small"), new_key("large")
    keys = folder / "keys.json"
    keys.write_text(json.dumps({"keys": [small[1], large[1]]}))
    server = Server(folder / "data", {"keys": keys, "max_unfinished": crowd + jobs}, {SECONDS: str(STAGE_S)})
    server.start()
    try:
        with (
            httpx.Client(base_url=server.url, timeout=60, headers={"X-API-Key": small[0]}) as one,
            httpx.Client(base_url=server.url, timeout=60, headers={"X-API-Key": large[0]}) as other,
        ):
            alone = waits(one, jobs, 0)
            for number in range(crowd):
                post(other, small_photo(10_000 + number)).raise_for_status()
            return alone, waits(one, jobs, 1000)
    finally:
        server.kill()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=20, help="of the small tenant, each time")
    parser.add_argument("--crowd", type=int, default=300, help="of the large one")
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="tenants-"))
    alone, beside = run(folder, asked.jobs, asked.crowd)
    shutil.rmtree(folder)
    ratio = statistics.median(beside) / statistics.median(alone)
    print(
        f"alone {statistics.median(alone):.2f} s, beside {asked.crowd} jobs {statistics.median(beside):.2f} s (medians)"
    )
    print(f"ratio {ratio:.2f}")
    raise SystemExit(0 if ratio <= 2 else 1)


if __name__ == "__main__":
    main()
