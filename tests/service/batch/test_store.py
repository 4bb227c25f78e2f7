"""A batch from S3 to S3, and from S3 to a folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service.batch.shards import _fetched
from service.errors import UnreadableInput, UsageError
from service.places import place
from tests.service.batch.conftest import Folders
from tests.service.jobs.s3 import serve


@pytest.fixture(scope="module")
def bucket() -> Iterator[Any]:
    import fsspec

    for _ in serve():
        yield fsspec.filesystem("s3", use_listings_cache=False)


def test_a_batch_in_a_store(folders: Folders, bucket: Any) -> None:
    for name, word in (("a.jpg", "good"), ("sub/b.png", "corrupt"), (".hidden.jpg", "good"), ("x/../y.jpg", "good")):
        bucket.pipe_file(f"bucket/photos/{name}", word.encode())
    places = {"source": "s3://bucket/photos", "out": "s3://bucket/photos/out"}
    tally = folders.run(**places)
    assert (tally.made, tally.failed) == (1, 1)
    bucket.pipe_file("bucket/photos/sub/b.png", b"good now")
    bucket.rm_file("bucket/photos/out/report.jsonl")
    tally = folders.run(**places, resume=True)
    assert (tally.made, tally.failed, tally.left) == (2, 0, 0), "the line of what is there comes back without its work"
    assert folders.run(**places, resume=True).skipped == 2
    found = sorted(path.removeprefix("bucket/photos/out/") for path in bucket.find("bucket/photos/out"))
    assert found == [".batch/batch.json", "a.zip", "report.jsonl", "sub/b.zip"]


def test_names_of_a_store_do_not_lead_out_of_a_folder(folders: Folders, bucket: Any) -> None:
    for name in ("../../evil.jpg", "a/../../../evil.jpg", "good.jpg"):
        bucket.pipe_file(f"bucket/in/{name}", b"good")
    assert folders.run(source="s3://bucket/in").made == 1
    assert folders.archives() == ["good.zip"]
    assert not list(folders.out.parent.rglob("evil*"))


def test_a_photo_that_goes_meanwhile_costs_its_own_line(bucket: Any, tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput, match="not there any more"):
        _fetched(place("s3://bucket/in"), "gone.jpg", tmp_path)


def test_a_store_that_nobody_knows() -> None:
    with pytest.raises(UsageError, match="nonsense"):
        place("nonsense://bucket")
