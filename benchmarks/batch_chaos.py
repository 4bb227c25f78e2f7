"""A batch on three workers that are killed again and again, with photos and archives in S3 and the queue in Postgres.

    python -m benchmarks.batch_chaos --photos 2000 --kills 60           # toy photos
    python -m benchmarks.batch_chaos --photos 12 --kills 4 --real       # real drafts of the sample and of --from
    python -m benchmarks.batch_chaos --memory                           # the driver at 1,000 and at 100,000 photos

One worker is frozen in the middle third, and Postgres is stopped once as by a power cut. Every photo has to be in the
report once, with the bytes of an undisturbed run. The workers are processes of one machine with data folders of their
own. S3 is moto's server. Needs Debian's package postgresql.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from service.diagnosis import SAMPLE
from tests.support.postgres import Postgres
from tests.support.server import free_port
from tests.support.workers import Workers

WORKERS = ("w0", "w1", "w2")
DRAFT = ["--quality", "draft", "--seed", "1"]

_MEMORY = """
import json, resource, sys
from pathlib import Path
from service.places import Place
from service.batch.plan import Plan, manifest_name, read_lines, report_name, text_of
folder = Path(sys.argv[1])
(folder / "out").mkdir()
out = Place(folder / "out")
plan = Plan(Place(folder / "photos"), out)
photos = plan.look()
plan.ask({})
for number, _ in enumerate(plan.write_shards("1")):
    facts = {"sha256": "0" * 64, "archive_sha256": "0" * 64, "outcome": "succeeded", "error": None, "warnings": []}
    lines = ({**photo, **facts} for photo in read_lines(out, manifest_name("1", number)))
    out.write(report_name("1", number), b"".join(map(text_of, lines)))
plan.merge(folder)
assert plan.outcome() == (photos, 0, 0)
print(photos, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--pause", type=float, default=3.0, help="seconds between two kills, on average")
    parser.add_argument("--real", action="store_true", help="real drafts in place of toy photos")
    parser.add_argument("--from", dest="folder", type=Path, help="folder of photos for --real")
    parser.add_argument("--alone", type=Path, help="folder that keeps what is made alone, for the next run")
    parser.add_argument("--memory", action="store_true", help="measure the driver's memory instead")
    asked = parser.parse_args(arguments)
    if asked.memory:
        memory()
        return
    with tempfile.TemporaryDirectory(prefix="batch-chaos-") as folder:
        real, alone = _photos(asked) if asked.real else None, asked.alone or Path(folder)
        found = run(Path(folder), asked.photos, asked.kills, asked.pause, real, alone)
    print(json.dumps(found, indent=1))
    raise SystemExit(0 if found["well"] else 1)


def memory() -> None:
    """Print the driver's peak memory for a short and for a long list of photos."""
    for count in (1_000, 100_000):
        with tempfile.TemporaryDirectory() as folder:
            for number in range(count):
                photo = Path(folder) / "photos" / f"{number // 1000:04d}" / f"{number:07d}.jpg"
                if number % 1000 == 0:
                    photo.parent.mkdir(parents=True)
                photo.touch()
            begin = time.monotonic()
            done = subprocess.run([sys.executable, "-c", _MEMORY, folder], capture_output=True, text=True, check=True)
            photos, peak = done.stdout.split()
            print(f"{photos} photos: peak {peak} MiB, {time.monotonic() - begin:.1f} s to list, deal out and merge")


def _photos(asked: argparse.Namespace) -> list[Path]:
    found = [] if asked.folder is None else sorted(path for path in asked.folder.iterdir() if path.suffix == ".png")
    return [SAMPLE, *found][:4]


def run(folder: Path, count: int, kills: int, pause: float, real: list[Path] | None, alone: Path) -> dict[str, Any]:
    """One batch with its faults; what was found.

    Args:
        folder: for everything.
        count: photos.
        kills: how many workers to kill.
        pause: mean seconds between two.
        real: photos of which drafts are made, each several times; None for toy photos.
        alone: folder for the archives of an undisturbed run.
    """
    port = free_port()
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "x", "AWS_SECRET_ACCESS_KEY": "x",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    with (folder / "s3.log").open("wb") as log:
        store = subprocess.Popen([sys.executable, "-m", "moto.server", "-p", str(port)], stdout=log, stderr=log)
    postgres = Postgres(folder)
    postgres.start()
    settings: dict[str, object] = {"database": postgres.url, "batches": 1, "reserve_mb": 1, "niceness": 0}
    if real is None:
        settings |= {"batches": 2, "program": "tests.support.toy_photo"}
    workers, driver = None, None
    try:
        bucket = _bucket()
        contents = {f"{n % 7}/{n:06d}.png": _content(n, real) for n in range(count)}
        for name, content in contents.items():
            bucket.pipe_file(f"bucket/photos/{name}", content)
        command = [sys.executable, "-m", "service", "batch", "s3://bucket/photos", "s3://bucket/out", "--json"]
        begin = time.monotonic()
        with (folder / "driver").open("wb") as output:
            driver = subprocess.Popen([*command, "--database", postgres.url, *(DRAFT if real else [])], stdout=output)
        workers = Workers(folder, settings, WORKERS)
        time.sleep(5.0)
        done = _disturb(workers, postgres, kills, pause, driver)
        peak = _wait(driver, workers)
        seconds = time.monotonic() - begin
        found = _check(bucket, contents, None if real is None else _undisturbed(alone, real))
        told = json.loads((folder / "driver").read_text() or "{}")
        return {**found, "seconds": round(seconds), "faults": done, "driver": {"peak_mb": peak, **told}}
    finally:
        if workers is not None:
            workers.stop()
        for process in (driver, store):
            if process is not None:
                process.kill()
                process.wait()
        with contextlib.suppress(subprocess.CalledProcessError):
            postgres.stop()


def _content(number: int, real: list[Path] | None) -> bytes:
    return f"good {number}".encode() if real is None else real[number % len(real)].read_bytes()


def _bucket() -> Any:
    import fsspec

    for _ in range(100):
        with contextlib.suppress(Exception):
            made = fsspec.filesystem("s3", use_listings_cache=False)
            made.mkdir("bucket")
            return made
        time.sleep(0.2)
    raise RuntimeError("the S3 server did not start")


def _disturb(
    workers: Workers, postgres: Postgres, kills: int, pause: float, driver: subprocess.Popen[bytes]
) -> dict[str, int]:
    """Kill workers; freeze the last one in the middle third; restart Postgres in the middle."""
    done: Counter[str] = Counter()
    for number in range(kills):
        time.sleep(random.uniform(0.5, 1.5) * pause)  # noqa: S311 - no secret
        if driver.poll() is not None:
            break
        if number == kills // 3:
            workers.signal(WORKERS[-1], signal.SIGSTOP)
            done["frozen"] += 1
        if number == kills // 2:
            postgres.stop("immediate")
            time.sleep(8)
            postgres.start()
            done["restarts of Postgres"] += 1
        if number == kills * 2 // 3:
            workers.signal(WORKERS[-1], signal.SIGCONT)
        workers.signal(random.choice(WORKERS[:-1]), signal.SIGKILL)  # noqa: S311
        done["kills"] += 1
        workers.restart()
    workers.signal(WORKERS[-1], signal.SIGCONT)
    return dict(done)


def _wait(driver: subprocess.Popen[bytes], workers: Workers) -> int:
    """Wait for the driver's end; returns its peak memory in MiB."""
    peak = 0
    while driver.poll() is None:
        with contextlib.suppress(OSError, StopIteration):
            lines = Path(f"/proc/{driver.pid}/status").read_text().splitlines()
            peak = next(int(line.split()[1]) // 1024 for line in lines if line.startswith("VmHWM"))
        workers.restart()
        time.sleep(1.0)
    return peak


def _undisturbed(folder: Path, real: list[Path]) -> dict[bytes, bytes]:
    """Photo -> its archive, made alone; archives that are in the folder already are taken as they are."""
    made = {}
    for photo in real:
        target = folder / f"{hashlib.sha256(photo.read_bytes()).hexdigest()}.zip"
        command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(target), *DRAFT]
        if not target.exists():
            subprocess.run(command, check=True)
        made[photo.read_bytes()] = target.read_bytes()
    return made


def _check(bucket: Any, contents: dict[str, bytes], undisturbed: dict[bytes, bytes] | None) -> dict[str, Any]:
    """Every photo once in the report, succeeded, with the archive that an undisturbed run makes."""
    from tests.support.toy_photo import toy_archive

    lines = [json.loads(line) for line in bucket.cat_file("bucket/out/report.jsonl").splitlines()]
    times = Counter(line["path"] for line in lines)
    wrong = []
    for line in lines:
        archive = bucket.cat_file(f"bucket/out/{line['archive']}") if line["archive"] else b""
        content = contents.get(line["path"], b"")
        same = archive == (toy_archive(content, {}) if undisturbed is None else undisturbed[content])
        if not same or hashlib.sha256(archive).hexdigest() != line["archive_sha256"]:
            wrong.append(line["path"])
    missing, twice = sorted(contents.keys() - times.keys()), [name for name, count in times.items() if count > 1]
    left = [path for path in bucket.find("bucket/out/.batch") if not path.endswith("batch.json")]
    return {
        "well": not (missing or twice or wrong or left) and len(lines) == len(contents), "photos": len(lines),
        "missing": missing[:9], "twice": twice[:9], "other bytes": wrong[:9], "left over": left[:9],
    }  # fmt: skip


if __name__ == "__main__":
    main()
