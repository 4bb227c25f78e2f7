"""Photos, stages and results on a store that speaks S3, over the loopback."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.jobs import database
from service.jobs.artifacts import Artifacts, artifact_name
from service.jobs.runner import Runner
from service.places import StoreFault
from tests.service.api.conftest import GOOD, Api, is_problem, open_api
from tests.service.jobs.conftest import Bench
from tests.service.jobs.s3 import S3, serve
from tests.support.toy_job import archive

JOB = "a" * 32


@pytest.fixture(scope="module")
def s3() -> Iterator[S3]:
    yield from serve()


@pytest.fixture
def url(s3: S3, tmp_path: Path) -> str:
    return f"s3://bucket/{tmp_path.name}"


@pytest.fixture
def bench(url: str, tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "data", url)
    yield made
    made.close()


def put(artifacts: Artifacts, folder: Path, kind: str = "photo", content: bytes = b"0123456789") -> str:
    name = artifact_name(JOB, kind, "0" * 64, "bin")
    (folder / "source").write_bytes(content)
    artifacts.put(folder / "source", name)
    assert not (folder / "source").exists()
    return name


def test_files_on_a_store_are_like_files_on_a_disk(url: str, tmp_path: Path) -> None:
    artifacts = Artifacts(url)
    assert artifacts.folder is None
    assert artifacts.jobs() == artifacts.names(JOB) == []
    name = put(artifacts, tmp_path, content=bytes(range(256)) * 30_000)  # more than one block
    with artifacts.open(name) as stream:
        stream.seek(5_000_001)
        assert stream.read(3) == bytes([0x41, 0x42, 0x43])
    assert len(artifacts.read(name)) == 256 * 30_000
    assert (artifacts.jobs(), artifacts.names(JOB)) == ([JOB], [name])
    other = put(artifacts, tmp_path, "archive")
    artifacts.sweep(JOB, {other})
    assert [artifacts.exists(one) for one in (name, other)] == [False, True]
    artifacts.delete(other)
    artifacts.delete(other)
    with pytest.raises(FileNotFoundError):
        artifacts.open(other)


def run(api: Api, job: str) -> Runner:
    runner = Runner(api.context.settings, api.context.store, api.context.artifacts)
    assert runner.accept(f"{job}.1")["kind"] == "wanted"
    assert runner.publish(job, runner.make(job)) == "published"
    return runner


def test_a_whole_job_from_the_photo_to_its_end(bench: Bench) -> None:
    with open_api(bench.settings) as client:
        api = Api(client)
        answer = api.post(GOOD, {"seed": 5})
        assert answer.status_code == 202, answer.text
        job, where = answer.json()["id"], answer.headers["location"]
        assert api.stored() == [], "the photo is on the store, not here"
        runner = run(api, job)
        assert [name.split("/")[1].split("-")[0] for name in bench.artifacts.names(job)] == ["archive"]
        row = bench.row(job)
        expected = archive(row["photo_sha256"], 5)
        whole = client.get(f"{where}/archive.zip")
        assert (whole.status_code, whole.content) == (200, expected)
        etag = whole.headers["etag"]
        head = client.head(f"{where}/archive.zip")
        assert (head.headers["etag"], int(head.headers["content-length"])) == (etag, len(expected))
        rest = client.get(f"{where}/archive.zip", headers={"Range": "bytes=100-", "If-Range": etag})
        assert (rest.status_code, rest.content) == (206, expected[100:])
        again = client.get(f"{where}/archive.zip", headers={"Range": "bytes=100-", "If-Range": '"x"'})
        assert (again.status_code, again.content) == (200, expected)
        assert client.get(f"{where}/archive.zip", headers={"If-None-Match": etag}).status_code == 304
        member = client.get(f"{where}/files/maps/texture.png", headers={"Range": "bytes=8-15"})
        assert (member.status_code, len(member.content)) == (206, 8)
        assert client.delete(where).status_code == 204
        assert bench.artifacts.names(job) == []
        is_problem(client.get(f"{where}/archive.zip"), 410, "gone")
        runner.stop()


def test_a_store_that_is_gone_is_a_clear_answer_and_no_loss(s3: S3, bench: Bench) -> None:
    with open_api(bench.settings) as client:
        api = Api(client)
        job = api.post(GOOD, {"seed": 6}).json()["id"]
        where = f"/v1/avatars/{job}"
        run(api, job).stop()
        s3.stop()
        try:
            refused = api.post(GOOD, {"seed": 7}, Idempotency_Key="later")
            assert is_problem(refused, 503, "unavailable")
            assert refused.headers["retry-after"]
            is_problem(client.get(f"{where}/archive.zip"), 503, "unavailable")
            assert client.get(where).json()["state"] == "succeeded"
            assert api.stored() == [], "nothing of a refused request stays"
        finally:
            s3.start()
        assert api.post(GOOD, {"seed": 7}, Idempotency_Key="later").status_code == 202
        assert client.get(f"{where}/archive.zip").status_code == 200
        s3.stop()
        try:
            assert client.delete(where).status_code == 204
        finally:
            s3.start()
        assert bench.artifacts.names(job), "could not be erased then"
        bench.runner.tidy(job)
        assert bench.artifacts.names(job) == []


@pytest.mark.slow
def test_a_store_that_fails_in_the_middle_of_a_job_costs_time_only(
    s3: S3, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes as the second stage begins, and is back after the computation has ended."""
    job, whole, gone = bench.add(seed=8), bench.store.progress, threading.Event()

    def progress(name: str, stage: str, share: float, known: str | None = None) -> bool:
        if stage == "two" and not gone.is_set():
            s3.stop()
            gone.set()
        return whole(name, stage, share, known)

    put_of_store, failures = bench.artifacts.put, list[Exception]()

    def noted(*arguments: Any, **named: Any) -> None:
        try:
            put_of_store(*arguments, **named)
        except StoreFault as error:
            failures.append(error)
            s3.start()
            raise

    monkeypatch.setattr(bench.store, "progress", progress)
    monkeypatch.setattr(bench.artifacts, "put", noted)
    assert bench.run(job) == "published"
    assert len(failures) == 1
    row = bench.row(job)
    assert row["state"] == "succeeded"
    assert bench.artifacts.read(row["archive"]) == archive(row["photo_sha256"], 8)


@pytest.mark.slow
def test_a_store_that_stays_away_ends_the_worker_not_the_job(
    s3: S3, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Ended(BaseException):
        pass

    def end(status: int) -> None:
        raise Ended(status)

    job = bench.add()
    monkeypatch.setattr(database, "PATIENCE", 0.0)
    monkeypatch.setattr(os, "_exit", end)
    s3.stop()
    try:
        with pytest.raises(Ended, match=str(database.TEMPORARY_FAILURE)):
            bench.run(job)
    finally:
        s3.start()
    row = bench.row(job)
    assert row["state"] == "running"


def test_a_bucket_that_is_not_there_is_no_missing_photo(s3: S3, tmp_path: Path) -> None:
    with pytest.raises(StoreFault, match="FileNotFoundError"):
        put(Artifacts("s3://no-such-bucket/x"), tmp_path)


def archive_of(api: Api, job: str) -> str:
    row = api.context.store.get(job)
    assert row is not None
    return str(row["archive"])


def test_the_store_gives_an_archive_out_itself(bench: Bench, s3: S3, tmp_path: Path) -> None:
    """By an address that is signed, for a while; the client follows it and does not hand it the key."""
    with open_api(dataclasses.replace(bench.settings, signed_downloads=True)) as client:
        api = Api(client)
        job = api.post().json()["id"]
        run(api, job)
        answer = client.get(f"/v1/avatars/{job}/archive.zip", follow_redirects=False)
        assert answer.status_code == 307
        place = answer.headers["location"]
        assert "X-Amz-Signature" in place, "version 4; MinIO, Garage and the newer regions of Amazon take no other"
        assert answer.headers["cache-control"] == "no-store"
        made = api.context.artifacts.read(archive_of(api, job))
        given = httpx.get(place)
        assert given.content == made
        assert given.headers["content-disposition"].startswith("attachment")
        assert httpx.get(place, headers={"Range": "bytes=5-9"}).content == made[5:10]
        head = client.head(f"/v1/avatars/{job}/archive.zip", follow_redirects=False)
        assert (head.status_code, httpx.head(head.headers["location"]).status_code) == (307, 200)
        assert client.get(f"/v1/avatars/{job}/files/manifest.json").status_code == 200, "a part of an archive"
