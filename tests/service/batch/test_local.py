"""Batches on this machine; the photos are words that a small program in the pipeline's place obeys."""

from __future__ import annotations

import errno
import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from service.batch.local import LocalMaker
from service.client.download import check_archive
from service.errors import Crashed, OutputFault
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
        "short.jpg": "download-failed",
    }
    assert lines["corrupt.jpg"]["error"]["message"] == "the file is cut off"
    assert lines["corrupt.jpg"]["error"]["bytes"] == 12
    assert "SIGSEGV" in lines["crash.jpg"]["error"]["message"]
    assert "last words of a library" in lines["crash.jpg"]["error"]["log"]
    assert "status 7" in lines["leave.jpg"]["error"]["message"]
    assert lines["grey.jpg"]["warnings"] == ["no-colour"]
    assert folders.archives() == ["good.zip", "grey.zip"]
    assert sorted(path.name for path in folders.out.iterdir()) == [
        ".batch.lock",
        "good.zip",
        "grey.zip",
        "report.jsonl",
    ]


def test_a_line_says_all_that_resume_needs(folders: Folders) -> None:
    folders.options = {"size": [96, 64]}
    photo = folders.photo("sub/a.png", "good")
    folders.run()
    line = folders.lines()["sub/a.png"]
    archive = folders.out / line["archive"]
    check_archive(archive)
    assert line["archive"] == "sub/a.zip"
    assert line["sha256"] == hashlib.sha256(photo.read_bytes()).hexdigest()
    assert line["archive_sha256"] == hashlib.sha256(archive.read_bytes()).hexdigest()
    assert (line["outcome"], line["error"], line["options"], line["attempt"]) == (
        "succeeded",
        None,
        {"size": [96, 64]},
        1,
    )
    assert 0 < line["seconds"] < 20


def test_resume_makes_again_only_what_is_not_there_whole_and_unchanged(folders: Folders) -> None:
    names = ["gone", "cut", "changed", "same", "failed"]
    for name in names:
        folders.photo(f"{name}.jpg", "good" if name != "failed" else "corrupt")
    folders.run()
    before = {name: (folders.out / f"{name}.zip").stat().st_mtime_ns for name in ("same", "changed")}
    (folders.out / "gone.zip").unlink()
    os.truncate(folders.out / "cut.zip", 100)
    folders.photo("changed.jpg", "good one")
    folders.photo("failed.jpg", "good now")
    folders.photo("new.jpg", "good")
    tally = folders.run(resume=True)
    assert (tally.made, tally.failed, tally.skipped) == (5, 0, 1)
    assert (folders.out / "same.zip").stat().st_mtime_ns == before["same"]
    assert (folders.out / "changed.zip").stat().st_mtime_ns != before["changed"]
    assert {line["path"]: line["attempt"] for line in folders.lines().values() if line["attempt"] > 1} == {
        "failed.jpg": 2
    }
    assert folders.run(resume=True).skipped == 6


def test_other_options_make_other_archives(folders: Folders) -> None:
    folders.photo("a.jpg", "good")
    folders.run()
    folders.options = {"seed": 1}
    assert folders.run(resume=True).made == 1


@pytest.mark.parametrize("archive", ["../elsewhere.zip", "a.zip/../../elsewhere.zip"])
def test_a_report_from_elsewhere_does_not_lead_out_of_the_folder(folders: Folders, archive: str) -> None:
    folders.photo("a.jpg", "good")
    folders.run()
    (folders.out / "a.zip").rename(folders.out.parent / "elsewhere.zip")
    report = folders.out / "report.jsonl"
    report.write_text(report.read_text().replace('"archive": "a.zip"', f'"archive": "{archive}"'))
    assert folders.run(resume=True).made == 1
    assert folders.archives() == ["a.zip"]


def test_a_photo_that_never_ends_is_stopped(folders: Folders) -> None:
    patient = folders.maker
    folders.maker = lambda work: LocalMaker(work, head=None, timeout_s=1.5, program="tests.service.batch.program")
    folders.photo("hang.jpg", "hang")
    assert folders.run().failed == 1
    assert folders.lines()["hang.jpg"]["error"]["code"] == "out-of-time"
    folders.maker = patient
    folders.photo("hang.jpg", "good now")
    assert folders.run(resume=True).made == 1


def test_a_photo_that_cannot_be_read(folders: Folders, monkeypatch: pytest.MonkeyPatch) -> None:
    folders.photo("a.jpg", "good")
    secret = folders.photo("b.jpg", "good")
    opened = Path.open

    def refuse(path: Path, *rest: Any, **more: Any) -> Any:
        if path == secret:
            raise PermissionError(13, "Permission denied")
        return opened(path, *rest, **more)

    monkeypatch.setattr(Path, "open", refuse)
    tally = folders.run()
    assert (tally.made, tally.failed) == (1, 1)
    assert "Permission denied" in folders.lines()["b.jpg"]["error"]["message"]


def test_an_installation_that_cannot_start_ends_the_batch(folders: Folders) -> None:
    """It is no photo's fault, and a thousand photos would say the same."""
    folders.maker = lambda work: LocalMaker(
        work, head=None, timeout_s=20, program="tests.service.batch.no_such_program"
    )
    for number in range(6):
        folders.photo(f"{number}.jpg", "good")
    tally = folders.run()
    assert isinstance(tally.ended_by, Crashed)
    assert (tally.made, tally.failed, tally.left) == (0, 0, 6)
    assert folders.lines() == {}


@pytest.mark.parametrize("where", ["archive", "report"])
def test_a_disk_that_is_full_ends_the_batch(folders: Folders, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    """Every later photo would be computed for nothing."""
    for number in range(4):
        folders.photo(f"{number}.jpg", "full" if where == "archive" else "good")

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if where == "report":
        monkeypatch.setattr("service.batch.report.os.fsync", full)
        monkeypatch.setattr("service.batch.report.Report._compact", lambda self: self.path.touch())
    tally = folders.run(jobs=1)
    assert isinstance(tally.ended_by, OutputFault)
    assert "no space" in tally.ended_by.message
    assert (tally.made, tally.failed, tally.left) == (0, 0, 4)


def test_a_name_that_the_disk_does_not_take_costs_one_photo(folders: Folders) -> None:
    folders.photo(f"{'n' * 250}.jpeg", "good")
    folders.photo(f"{'n' * 250}.jpg", "good")  # so that both archives need the longer name, too long by a letter
    folders.photo("a.jpg", "good")
    tally = folders.run()
    assert (tally.made, tally.failed) == (1, 2)
    assert tally.ended_by is None


def test_memory_and_threads_are_bounded_by_jobs(folders: Folders) -> None:
    for number in range(5):
        folders.photo(f"{number}.jpg", "good")
    before = threading.active_count()
    assert folders.run(jobs=3).made == 5
    assert threading.active_count() <= before + 1


BATCH = """
import sys
from service.batch import local
from service.cli.app import main
original = local.LocalMaker.__init__
local.LocalMaker.__init__ = lambda *given, **named: original(*given, **named, program="tests.service.batch.program")
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
        deadline = time.monotonic() + 20
        while not (started.exists() and started.read_text()) and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(how)
        status = process.wait(20)
    assert status == (130 if how == signal.SIGINT else -signal.SIGKILL)
    assert folders.archives() == ["a.zip"]
    assert list(folders.lines()) == ["a.jpg"]
    child = int(started.read_text())
    deadline = time.monotonic() + 5
    while running(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not running(child), "its process works on for nobody"
    folders.photo("b.jpg", "good now")
    tally = folders.run(resume=True)
    assert (tally.made, tally.skipped) == (2, 1)
    assert not (folders.out / ".work").exists()


def running(process: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
