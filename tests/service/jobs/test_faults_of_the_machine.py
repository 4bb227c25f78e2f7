"""Faults of the machine that are made for real: the kernel's limit of memory, a file system that turns read-only, a
clock that is set. They need root, or a library, and are skipped elsewhere with the reason.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.service.cgroups import Group, group
from tests.service.jobs.processes import WITHIN
from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import SECONDS, archive

pytestmark = pytest.mark.slow

HOUR = 3600


@pytest.fixture
def cgroup() -> Iterator[Group]:
    yield from group(600 << 20)


def test_the_kernel_takes_the_job_and_not_the_server(cgroup: Group, tmp_path: Path) -> None:
    """As in a container with a limit below that of a job; none of ours comes first."""
    server = Server(tmp_path / "data", {"memory_mb": 0}, within=cgroup.command)
    server.start()
    before = (server.processes()[0], server.worker())
    photo = small_photo(1)
    try:
        with httpx.Client(base_url=server.url, timeout=60) as client:
            jobs = [post(client, photo, seed).json()["id"] for seed in (108, 102, 5)]
            tight, endless, good = (wait_for(client, job, within=WITHIN) for job in jobs)
            assert (tight["state"], tight["warnings"]) == ("succeeded", ["toy", "small-tiles"])
            assert client.get(f"/v1/avatars/{jobs[0]}/archive.zip").content == archive(
                hashlib.sha256(photo).hexdigest(), 108
            )
            assert (endless["state"], endless["error"]["code"]) == ("failed", "out-of-memory")
            assert "the system ended the computation" in endless["error"]["detail"]
            assert good["state"] == "succeeded"
            assert good["warnings"] == ["toy"]
        assert cgroup.kills() == 3, "one of the first job, two of the second"
        assert (server.processes()[0], server.worker()) == before, "neither server nor worker was started again"
        assert server.stop() == 0
    finally:
        server.kill()


class Disk:
    """A file system of its own in a file, mounted so that an error makes it read-only, as most are."""

    def __init__(self, folder: Path) -> None:
        self.image, self.place = folder / "image", folder / "disk"
        self.place.mkdir()
        with self.image.open("wb") as stream:
            stream.truncate(64 << 20)
        self._run("mkfs.ext4", "-q", str(self.image))
        self.mount()

    def mount(self) -> None:
        self._run("mount", "-o", "loop,errors=remount-ro", str(self.image), str(self.place))

    def unmount(self) -> None:
        self._run("umount", str(self.place))

    def break_(self) -> None:
        """What the kernel does when it finds a fault in the file system."""
        device = subprocess.check_output(["findmnt", "-no", "SOURCE", str(self.place)], text=True).strip()
        Path(f"/sys/fs/ext4/{Path(device).name}/trigger_fs_error").write_text("1")

    def repair(self) -> None:
        self.unmount()
        assert subprocess.run(["e2fsck", "-fp", str(self.image)], capture_output=True, check=False).returncode <= 1
        self.mount()

    def _run(self, *command: str) -> None:
        subprocess.run(command, check=True, capture_output=True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    if any(shutil.which(program) is None for program in ("mkfs.ext4", "e2fsck", "findmnt")):
        pytest.skip("the programs of ext4 are missing: apt-get install e2fsprogs util-linux")
    try:
        made = Disk(tmp_path)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no file system can be mounted here: run as root, with loop devices: {error}")
    yield made
    subprocess.run(["umount", "-l", str(made.place)], check=False, capture_output=True)


def test_a_file_system_that_turns_read_only_costs_nothing_that_was_accepted(disk: Disk, tmp_path: Path) -> None:
    """In the middle of a job, under the open database: no 202 any more, the rest goes on after the repair."""
    server = Server(disk.place / "data", {"reserve_mb": 0}, {SECONDS: "1.5"})
    server.log = tmp_path / "log"
    server.start()
    photo = small_photo(1)
    try:
        with httpx.Client(base_url=server.url, timeout=90) as client:
            done = post(client, photo, 1).json()["id"]
            assert wait_for(client, done, within=WITHIN)["state"] == "succeeded"
            running, waiting = (post(client, photo, seed).json()["id"] for seed in (2, 3))
            while client.get(f"/v1/avatars/{running}").json()["stage"] != "two":
                time.sleep(0.05)
            disk.break_()
            refused = post(client, small_photo(2), 4, "later")
            assert refused.status_code in (500, 503, 507), refused.text
            assert client.get("/livez").status_code == 200
            content = client.get(f"/v1/avatars/{done}/archive.zip").content
            assert content == archive(hashlib.sha256(photo).hexdigest(), 1), "what is there can still be had"
            time.sleep(10)
            assert client.get("/livez").status_code == 200
        server.kill()
        disk.repair()
        server.start()
        with httpx.Client(base_url=server.url, timeout=90) as client:
            for job, seed in ((done, 1), (running, 2), (waiting, 3)):
                state = wait_for(client, job, within=WITHIN)
                assert state["state"] == "succeeded", state
                content = client.get(f"/v1/avatars/{job}/archive.zip").content
                assert content == archive(hashlib.sha256(photo).hexdigest(), seed)
            assert len(client.get("/v1/avatars").json()["items"]) == 3, "the refused one left no job"
            again = post(client, small_photo(2), 4, "later")
            assert again.status_code == 202
            assert wait_for(client, again.json()["id"], within=WITHIN)["state"] == "succeeded"
        assert server.stop() == 0
        with contextlib.closing(sqlite3.connect(server.data / "jobs.sqlite")) as database:
            assert database.execute("pragma integrity_check").fetchone() == ("ok",)
    finally:
        server.kill()


CLOCK = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long shift(void) {
    char text[32] = {0};
    int file = open(getenv("CLOCK_SHIFT"), O_RDONLY | O_CLOEXEC);
    if (file < 0) return 0;
    if (read(file, text, sizeof text - 1) < 0) text[0] = 0;
    close(file);
    return atol(text);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int status = syscall(SYS_clock_gettime, clock, now);
    if (status == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) now->tv_sec += shift();
    return status;
}

int gettimeofday(struct timeval *now, void *zone) {
    int status = syscall(SYS_gettimeofday, now, zone);
    if (status == 0) now->tv_sec += shift();
    return status;
}

time_t time(time_t *into) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (into) *into = now.tv_sec;
    return now.tv_sec;
}
"""
"""A clock on the wall that is off by the seconds in a file; that of durations is let alone, as where a clock is set."""


class Clock:
    """The clock of processes that are started with ``environment``."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "shift"
        self.set(0)
        source, library = folder / "clock.c", folder / "clock.so"
        source.write_text(CLOCK)
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(source)], check=True)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_SHIFT": str(self._file)}

    def set(self, seconds: int) -> None:
        part = self._file.with_suffix(".part")
        part.write_text(str(seconds))
        part.replace(self._file)

    def day(self) -> str:
        """By Python and by SQLite in such a process."""
        program = "import sqlite3, time; print(time.strftime('%F', time.gmtime()), "
        program += "sqlite3.connect(':memory:').execute(\"select date('now')\").fetchone()[0])"
        return subprocess.check_output([sys.executable, "-c", program], env=os.environ | self.environment, text=True)


@pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None,
    reason="needs Linux and a C compiler: apt-get install gcc",
)
def test_a_clock_that_is_set_by_a_day_under_a_running_server_costs_nothing(tmp_path: Path) -> None:
    """A day and an hour forward, then two days back, for all processes of the server at once and for SQLite in them."""
    clock = Clock(tmp_path)
    today = clock.day()
    clock.set(25 * HOUR)
    assert set(clock.day().split()).isdisjoint(today.split()), "the clock is the one that was meant to be"
    clock.set(0)
    keys = tmp_path / "keys.json"
    digest = hashlib.sha256(b"k").hexdigest()
    keys.write_text(f'{{"keys": [{{"name": "studio", "sha256": "{digest}", "per_day": 4}}]}}')
    server = Server(tmp_path / "data", {"keys": keys, "result_hours": 24}, clock.environment | {SECONDS: "2.0"})
    server.start()
    photo = small_photo(1)
    try:
        headers = {"Authorization": "Bearer k"}
        with httpx.Client(base_url=server.url, timeout=90, headers=headers) as client:
            jobs = [post(client, photo, 1).json()["id"]]
            assert wait_for(client, jobs[0], within=WITHIN)["state"] == "succeeded"
            for number, jump in ((2, 25 * HOUR), (3, -24 * HOUR)):
                jobs.append(post(client, photo, number).json()["id"])
                while client.get(f"/v1/avatars/{jobs[-1]}").json()["state"] == "queued":
                    time.sleep(0.05)
                clock.set(jump)
                followed = client.get(f"/v1/avatars/{jobs[-1]}/events").text  # to its end
                assert '"state": "succeeded"' in followed, followed[-500:]
                assert followed.count("event: state") == 3, "queued, running, succeeded: not run a second time"
                server.wait("readyz")
                time.sleep(35)  # results are looked through for expired ones every 30 s
                for job, seed in zip(jobs, range(1, 4), strict=False):
                    content = client.get(f"/v1/avatars/{job}/archive.zip").content
                    assert content == archive(hashlib.sha256(photo).hexdigest(), seed), "erased before its time"
            answers = [post(client, photo, seed) for seed in (4, 5)]
            assert [answer.status_code for answer in answers] == [202, 429], "four a day, whatever the clock says"
            assert wait_for(client, answers[0].json()["id"], within=WITHIN)["state"] == "succeeded"
        assert server.stop() == 0
    finally:
        server.kill()
