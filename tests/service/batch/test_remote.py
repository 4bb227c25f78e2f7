"""Batches at a server, with its faults."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.batch.makers import Order, RemoteMaker, Stopped
from service.client.errors import AccessDenied, ServerUnreachable
from tests.service.batch.conftest import Folders
from tests.service.client.fake import Fake, answer, hang_up, problem

STATE = r"avatars/\w+$"


@pytest.fixture(autouse=True)
def _fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pauses a hundred times shorter than they would be."""
    clock = SimpleNamespace(sleep=lambda seconds: time.sleep(seconds / 100), monotonic=time.monotonic)
    monkeypatch.setattr("tenacity.nap.time", clock)
    monkeypatch.setattr("service.client.client.time", clock)


@pytest.fixture
def batch(folders: Folders, fake: Fake) -> Folders:
    folders.wanted = {"server": fake.url, "api_key": "secret"}
    return folders


def photos(batch: Folders, count: int) -> None:
    for number in range(count):
        batch.photo(f"{number}.jpg", f"photo {number}")


def test_copies_of_a_photo_do_not_erase_each_others_job(batch: Folders, fake: Fake) -> None:
    for number in range(6):
        batch.photo(f"{number}.jpg", "the same photo")
    assert batch.run(jobs=6).made == 6
    assert len(fake.requests("POST")) == 6


@pytest.mark.parametrize("end", ["cancelled", "expired"])
def test_jobs_that_others_cancelled_are_asked_for_anew(batch: Folders, fake: Fake, end: str) -> None:
    photos(batch, 1)
    fake.end = end

    def better(request: Any) -> None:
        fake.end = ""
        request._submit()

    fake.fail("POST", "avatars", lambda request: request._submit(), better)
    assert batch.run().made == 1


def test_a_job_that_was_left_running_is_found_again(batch: Folders, fake: Fake) -> None:
    """A batch that was killed had handed the photo in: the next one must not have it computed twice."""
    photo = batch.photo("a.jpg", "photo")
    work = batch.out / ".work"
    work.mkdir(parents=True)
    killed = RemoteMaker(fake.url, None, work, timeout_s=20, keep=False)
    order = Order(photo, "a.jpg", "00" * 32, {}, 1, batch.out / "a.zip")
    first = killed.submit(order, 0)
    again = RemoteMaker(fake.url, None, work, timeout_s=20, keep=False)
    assert again.submit(order, 0).id == first.id
    assert again.submit(Order(photo, "a.jpg", "00" * 32, {}, 2, batch.out / "a.zip"), 0).id != first.id
    killed.close()
    again.close()


def test_a_photo_whose_time_is_over_is_cancelled_at_the_server(batch: Folders, fake: Fake) -> None:
    photos(batch, 1)
    fake.stages *= 1000
    assert batch.run(timeout_s=0.5).failed == 1
    assert batch.lines()["0.jpg"]["error"]["code"] == "wait-timed-out"
    assert len(fake.requests("DELETE")) == 1


def test_a_wrong_key_ends_the_batch_at_once(batch: Folders, fake: Fake) -> None:
    photos(batch, 5)
    fake.fail("POST", "avatars", *[answer(401, problem(401, "unauthorised", "this key is unknown"))] * 5)
    tally = batch.run(jobs=1)
    assert isinstance(tally.ended_by, AccessDenied)
    assert (tally.failed, tally.left) == (0, 5)
    assert len(fake.requests("POST")) == 1


def test_a_server_that_is_not_there_leaves_no_batch(batch: Folders, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next run, at the right address, was refused for the report of an earlier one, which had made nothing."""
    photos(batch, 2)
    monkeypatch.setattr("service.client.transport.SILENCE_S", 0.1)
    with pytest.raises(ServerUnreachable):
        batch.run(server="http://127.0.0.1:1")
    assert not (batch.out / "report.jsonl").exists()
    assert batch.run().made == 2


def test_a_server_that_goes_away_ends_the_batch(batch: Folders, fake: Fake, monkeypatch: pytest.MonkeyPatch) -> None:
    """All photos that are left would fail; the next run goes on where this one stopped."""
    photos(batch, 4)
    monkeypatch.setattr("service.client.transport.SILENCE_S", 0.1)
    fake.fail("POST", "avatars", lambda request: request._submit(), *[hang_up] * 1000)
    tally = batch.run(jobs=1)
    assert isinstance(tally.ended_by, ServerUnreachable)
    assert (tally.made, tally.failed, tally.left) == (1, 0, 3)
    fake.faults.clear()
    tally = batch.run(resume=True)
    assert (tally.made, tally.skipped) == (3, 1)


def test_stopping_leaves_the_job_to_the_next_run(batch: Folders, fake: Fake, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    maker = RemoteMaker(fake.url, None, work, timeout_s=20, keep=False)
    photo = batch.photo("a.jpg", "photo")

    with pytest.raises(Stopped):
        order = Order(photo, "a.jpg", "00" * 32, {}, 1, tmp_path / "a.zip")
        maker.make(order, lambda: bool(fake.requests("GET", STATE)))
    maker.close()
    assert len(fake.jobs) == 1
    assert not fake.requests("DELETE")
    assert not (tmp_path / "a.zip").exists()


def test_half_an_archive_is_gone_on_from_by_the_next_run(batch: Folders, fake: Fake) -> None:
    photos(batch, 1)
    fake.cut_archive.append(3000)

    def wrong_key(request: Any) -> None:
        answer(401, problem(401, "unauthorised"))(request)

    fake.fail("GET", "archive", lambda request: request._archive(), wrong_key)
    work = batch.out / ".batch" / "downloads"
    assert batch.run().left == 1
    assert [path.stat().st_size for path in work.iterdir()] == [3000]
    assert batch.run(resume=True).made == 1
    assert "bytes=3000-" in [seen.headers.get("Range") for seen in fake.requests("GET", "archive")]
