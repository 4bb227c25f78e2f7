"""Batches on this machine; the photos are words that a small program in the pipeline's place obeys."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.batch.driver import _work
from service.errors import Crashed, OutputFault, UsageError
from service.places import Place
from tests.service.batch.conftest import Folders

ROOT = Path(__file__).parents[3]


def test_one_bad_photo_never_stops_the_rest(folders: Folders) -> None:
    words = ["good", "corrupt", "crash", "leave", "bug", "short", "grey"]
    for word in words:
        folders.photo(f"{word}.jpg", word)
    tally = folders.run()
    lines = folders.lines()
    assert (tally.made, tally.failed, tally.skipped, tally.left) == (2, 5, 0, 0)
    assert {name: line["error"]["code"] for name, line in lines.items() if line["error"]} == {
        "bug.jpg": "internal",
        "corrupt.jpg": "corrupt-image",
        "crash.jpg": "crashed",
        "leave.jpg": "crashed",
        "short.jpg": "crashed",
    }
    assert lines["corrupt.jpg"]["error"]["message"] == "the file is cut off"
    assert lines["corrupt.jpg"]["error"]["bytes"] == 12
    assert "SIGSEGV" in lines["crash.jpg"]["error"]["message"]
    assert "last words of a library" in lines["crash.jpg"]["error"]["log"]
    assert "status 7" in lines["leave.jpg"]["error"]["message"]
    assert lines["grey.jpg"]["warnings"] == ["no-colour"]
    assert folders.archives() == ["good.zip", "grey.zip"]
    assert lines["bug.jpg"]["error"]["message"] == "ZeroDivisionError: depth was 0"
    assert {line["path"] for line in tally.failures} == lines.keys() - {"good.jpg", "grey.jpg"}
    assert sorted(path.name for path in folders.out.iterdir()) == [".batch", "good.zip", "grey.zip", "report.jsonl"]
    left = sorted(path.name for path in (folders.out / ".batch").rglob("*") if path.is_file())
    assert left == ["batch.json", "batch.lock"]
    assert folders.shown[-1] == (2, 5, 7)


def test_resume_makes_again_only_what_is_not_there_and_newer(folders: Folders) -> None:
    """As ``make`` does: an archive that is there and not older than its photo counts; nothing is hashed."""
    names = ["gone", "changed", "same", "failed"]
    for name in names:
        folders.photo(f"{name}.jpg", "good" if name != "failed" else "corrupt")
    folders.run()
    before = {name: (folders.out / f"{name}.zip").stat().st_mtime_ns for name in ("same", "changed")}
    (folders.out / "gone.zip").unlink()
    folders.photo("changed.jpg", "good one")
    folders.photo("failed.jpg", "good now")
    folders.photo("new.jpg", "good")
    tally = folders.run(resume=True)
    assert (tally.made, tally.failed, tally.skipped) == (4, 0, 1)
    assert (folders.out / "same.zip").stat().st_mtime_ns == before["same"]
    assert (folders.out / "changed.zip").stat().st_mtime_ns != before["changed"]
    assert {line["path"]: line["attempt"] for line in folders.lines().values() if line["attempt"] > 1} == {
        "failed.jpg": 2
    }
    assert folders.run(resume=True).skipped == 5


def test_an_archive_that_lost_its_line_gets_one_without_being_made_again(folders: Folders) -> None:
    """A worker may be lost between the two."""
    folders.photo("a.jpg", "good")
    folders.run()
    before, line = (folders.out / "a.zip").stat().st_mtime_ns, folders.lines()["a.jpg"]
    (folders.out / "report.jsonl").unlink()
    folders.run(resume=True)
    assert (folders.out / "a.zip").stat().st_mtime_ns == before
    again = folders.lines()["a.jpg"]
    assert {**again, "seconds": 0} == {**line, "seconds": 0}


def test_a_photo_that_never_ends_is_stopped(folders: Folders) -> None:
    folders.photo("hang.jpg", "hang")
    assert folders.run(timeout_s=1.5).failed == 1
    assert folders.lines()["hang.jpg"]["error"]["code"] == "out-of-time"
    folders.photo("hang.jpg", "good now")
    assert folders.run(resume=True).made == 1


def test_an_installation_that_cannot_start_ends_the_batch(folders: Folders) -> None:
    """It is no photo's fault, and a thousand photos would say the same."""
    for number in range(6):
        folders.photo(f"{number}.jpg", "good")
    tally = folders.run(program="tests.service.batch.no_such_program")
    assert isinstance(tally.ended_by, Crashed)
    assert (tally.made, tally.failed, tally.left) == (0, 0, 6)
    assert folders.lines() == {}


@pytest.mark.parametrize("where", ["archive", "put"])
def test_a_disk_that_is_full_ends_the_batch(folders: Folders, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    """Every later photo would be computed for nothing."""
    for number in range(4):
        folders.photo(f"{number}.jpg", "full" if where == "archive" else "good")
    put = Place.put

    def full(place: Place, source: Path, name: str) -> None:
        if name.endswith(".zip"):
            raise OSError(errno.ENOSPC, "No space left on device")
        put(place, source, name)

    if where == "put":
        monkeypatch.setattr(Place, "put", full)
    tally = folders.run(jobs=1)
    assert isinstance(tally.ended_by, OutputFault)
    assert "no space" in tally.ended_by.message
    assert (tally.made, tally.failed, tally.left) == (0, 0, 4)


BATCH = """
import dataclasses, sys
from service.batch import driver
from service.cli.app import main

@dataclasses.dataclass(frozen=True, kw_only=True)
class Wanted(driver.Wanted):
    program: str = "tests.support.toy_photo"

driver.Wanted = Wanted
sys.argv = ["avatarme", "batch", *sys.argv[1:]]
main()
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_the_state_after_an_interruption_is_sound(folders: Folders, how: signal.Signals) -> None:
    """Whether it was asked to end or killed: finished photos stay, no half archive, no process, and resume goes on."""
    folders.photo("a.jpg", "good")
    hanging = folders.photo("b.jpg", "hang")
    folders.photo("c.jpg", "good")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        command = [sys.executable, "-c", BATCH, str(folders.photos), str(folders.out), "--jobs", "1"]
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE)
    finally:
        signal.signal(signal.SIGINT, before)
    started = hanging.with_suffix(".started")
    with process:
        deadline = time.monotonic() + 120
        while not (started.exists() and started.read_text()) and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(how)
        status = process.wait(60)
    assert status == (130 if how == signal.SIGINT else -signal.SIGKILL)
    assert folders.archives() == ["a.zip"]
    assert how == signal.SIGKILL or list(folders.lines()) == ["a.jpg"]
    child = int(started.read_text())
    deadline = time.monotonic() + 5
    while running(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not running(child), "its process works on for nobody"
    folders.photo("b.jpg", "good now")
    tally = folders.run(resume=True)
    assert (tally.made, tally.skipped) == (2, 1) and sorted(folders.lines()) == ["a.jpg", "b.jpg", "c.jpg"]
    assert not list((folders.out / ".batch").glob("work*"))


def running(process: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def test_an_earlier_report_and_an_archive_are_not_thrown_away_by_a_slip(folders: Folders) -> None:
    folders.photo("a.jpg", "good")
    folders.run()
    with pytest.raises(UsageError, match="--resume"):
        folders.run()
    (folders.out / "report.jsonl").unlink()
    (folders.out / ".batch" / "batch.json").unlink()
    with pytest.raises(UsageError, match=r"a\.zip"):
        folders.run()
    assert folders.archives() == ["a.zip"]


def test_two_programs_do_not_share_a_folder(folders: Folders) -> None:
    folders.photo("a.jpg", "good")
    with _work(Place(folders.out), alone=True), pytest.raises(UsageError, match="another batch"):
        folders.run()
    assert folders.run().made == 1


def test_parts_of_an_array_job_and_their_report(folders: Folders) -> None:
    """Each part takes its photos by their names, may run again, and needs no plan and no database."""
    for number in range(6):
        folders.photo(f"{number}.jpg", "good" if number else "corrupt")
    parts = [folders.run(shard=(part, 2)) for part in (1, 2)]
    assert sum(part.made for part in parts) == 5 and all(part.made for part in parts)
    assert len(folders.archives()) == 5
    again = folders.run(shard=(2, 2))
    assert again.made == 0 and again.skipped + again.failed > 0
    folders.photo("0.jpg", "good")
    tally = folders.run(resume=True)
    assert (tally.made, tally.failed, tally.skipped) == (1, 0, 5)
    assert len(folders.lines()) == 6


def test_a_watched_folder(folders: Folders, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.batch.driver.SETTLED_S", 0.0)
    folders.photo("a.jpg", "good")
    folders.photo("bad.jpg", "corrupt")
    rounds: list[list[str]] = []

    def wait(seconds: float) -> None:
        rounds.append(sorted(folders.lines()))
        if len(rounds) == 3:
            raise KeyboardInterrupt
        folders.photo(f"new{len(rounds)}.jpg", "good")

    monkeypatch.setattr("service.batch.driver.WATCH_S", -1.0)
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: wait(seconds) if seconds < 0 else sleep(seconds))
    with pytest.raises(KeyboardInterrupt):
        folders.run(watch=True)
    first = ["a.jpg", "bad.jpg"]
    assert rounds == [first, [*first, "new1.jpg"], [*first, "new1.jpg", "new2.jpg"]]
    assert folders.lines()["bad.jpg"]["attempt"] == 1, "what failed is not tried again and again"
