"""Downloads over connections that break, from servers that change their mind."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest

from service.client.client import Client
from service.client.download import check_zip
from service.client.errors import DownloadFailed, ServerUnreachable
from tests.service.client.fake import Fake
from tests.support.archives import archive


@pytest.fixture
def job(client: Client) -> str:
    return client.submit(b"photo").id


@pytest.fixture
def target(tmp_path: Path) -> Path:
    return tmp_path / "out" / "me.zip"


@pytest.fixture(autouse=True)
def _folder(target: Path) -> None:
    target.parent.mkdir()


def ranges(fake: Fake) -> list[str | None]:
    return [seen.headers.get("Range") for seen in fake.requests("GET", "archive")]


def only(target: Path) -> list[str]:
    return [path.name for path in target.parent.iterdir()]


def test_every_break_goes_on_at_the_byte_where_it_was(client: Client, fake: Fake, job: str, target: Path) -> None:
    fake.cut_archive.extend([1000, 1, 5000])
    told: list[tuple[int, int | None]] = []
    digest = client.download(job, target, progress=lambda done, total: told.append((done, total)))
    assert target.read_bytes() == fake.archive
    assert digest == hashlib.sha256(fake.archive).hexdigest()
    assert ranges(fake) == [None, "bytes=1000-", "bytes=1001-", "bytes=6001-"]
    assert told[-1] == (len(fake.archive), len(fake.archive))
    assert only(target) == ["me.zip"]


def test_a_line_that_brings_nothing_is_given_up_and_a_later_call_goes_on(
    client: Client, fake: Fake, job: str, target: Path, slept: list[float]
) -> None:
    fake.cut_archive.extend([3000] + [0] * 8)
    with pytest.raises(ServerUnreachable, match=f"3000 of {len(fake.archive)} bytes"):
        client.download(job, target)
    assert not target.exists()
    client.download(job, target)
    assert target.read_bytes() == fake.archive
    assert ranges(fake)[-1] == "bytes=3000-"
    assert only(target) == ["me.zip"]


def test_an_archive_that_changed_in_between_begins_anew(client: Client, fake: Fake, job: str, target: Path) -> None:
    """Bytes of two versions in one file would be worse than no file; the digest tells."""
    fake.cut_archive.append(4000)
    second = archive({"a": bytes(9000)})

    def change(request: Any) -> None:
        fake.archive = second
        request._archive()

    fake.fail("GET", "archive", lambda request: request._archive(), change)
    client.download(job, target)
    assert target.read_bytes() == second


@pytest.mark.parametrize("etag", ["", 'W/"weak"'])
def test_without_a_strong_etag_it_goes_on_as_well(
    client: Client, fake: Fake, job: str, target: Path, etag: str
) -> None:
    fake.etag = etag
    fake.cut_archive.append(4000)
    client.download(job, target)
    assert target.read_bytes() == fake.archive
    assert ranges(fake) == [None, "bytes=4000-"]
    assert only(target) == ["me.zip"]


def test_a_part_from_another_place_is_thrown_away(client: Client, fake: Fake, job: str, target: Path) -> None:
    fake.cut_archive.append(4000)

    def shifted(request: Any) -> None:
        data = fake.archive[4001:]
        headers = {
            "Content-Range": f"bytes 4001-{len(fake.archive) - 1}/{len(fake.archive)}",
            "ETag": fake.etag_header(),
        }
        request.reply(206, data, headers)

    fake.fail("GET", "archive", lambda request: request._archive(), shifted)
    client.download(job, target)
    assert target.read_bytes() == fake.archive


def test_another_content_than_the_stated_one(client: Client, fake: Fake, job: str, target: Path) -> None:
    fake.etag = f'"{"0" * 64}"'
    target.write_bytes(b"what was there before")
    with pytest.raises(DownloadFailed, match="0000"):
        client.download(job, target)
    assert target.read_bytes() == b"what was there before"
    assert only(target) == ["me.zip"], "damaged bytes must not be gone on from"


def test_damage_on_the_way_is_mended_by_a_second_try(client: Client, fake: Fake, job: str, target: Path) -> None:
    damaged = bytearray(fake.archive)
    damaged[2000] ^= 255
    fake.fail("GET", "archive", lambda request: request.reply(200, bytes(damaged), {"ETag": fake.etag_header()}))
    client.download(job, target)
    assert target.read_bytes() == fake.archive


def test_more_bytes_than_stated(fake: Fake, job: str, target: Path, slept: list[float]) -> None:
    """Chunked, so that the connection does not end at the stated length: the disk would fill."""
    size = len(fake.archive)

    def endless(request: Any) -> None:
        request.send_response(206)
        request.send_header("Content-Range", f"bytes 100-{size - 1}/{size}")
        request.send_header("ETag", fake.etag_header())
        request.send_header("Transfer-Encoding", "chunked")
        request.end_headers()
        for _ in range(1000):
            request.wfile.write(b"1000\r\n" + bytes(0x1000) + b"\r\n")

    for _ in range(10):
        fake.cut_archive.append(100)
        fake.fail("GET", "archive", lambda request: request._archive(), endless)
    impatient = Client(fake.url, attempts=2)
    with impatient, pytest.raises(DownloadFailed, match="stated"):
        impatient.download(job, target)
    assert only(target) == []


@pytest.mark.parametrize("damaged", [False, True])
def test_without_a_stated_digest_the_zip_tells(
    client: Client, fake: Fake, job: str, target: Path, damaged: bool
) -> None:
    fake.etag = '"version 3"'
    data = bytearray(fake.archive)
    data[2000] ^= damaged
    fake.archive = bytes(data)
    if not damaged:
        client.download(job, target)
        assert target.read_bytes() == fake.archive
        return
    with pytest.raises(DownloadFailed, match="damaged"):
        client.download(job, target)
    assert only(target) == []
    target.write_bytes(b"no zip")
    with pytest.raises(DownloadFailed, match="damaged"):
        check_zip(target)
