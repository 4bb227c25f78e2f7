from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

import pytest

from service.client.errors import DownloadFailed
from service.client.whole import check_archive, file_sha256
from tests.service.client.archives import archive

FILES = {"a": b"content of a" * 100, "b": b"content of b" * 100}


def deflated(files: dict[str, bytes], manifest: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as target:
        target.writestr("manifest.json", manifest)
        for name, data in files.items():
            target.writestr(name, data)
    return stream.getvalue()


BOMB = deflated({"a": bytes(64 << 20)}, b'{"files": [{"path": "a", "size": 5, "sha256": "00"}]}')


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.zip"


def test_a_whole_archive(path: Path) -> None:
    path.write_bytes(archive(FILES))
    check_archive(path)
    assert file_sha256(path) == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_one_that_was_cut_off(path: Path, share: float) -> None:
    data = archive(FILES)
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DownloadFailed):
        check_archive(path)


def test_every_changed_bit_of_the_content_is_seen(path: Path) -> None:
    data = bytearray(archive(FILES))
    for place in (data.index(b"content of a") + 3, data.index(b"content of b") + 500):
        data[place] ^= 1
        path.write_bytes(data)
        with pytest.raises(DownloadFailed):
            check_archive(path)
        data[place] ^= 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (archive(FILES, {"a": FILES["a"]}), "b"),
        (archive({"a": FILES["a"]}, FILES), "b"),
        (archive(FILES, {**FILES, "b": b"content of B" * 100}), "b in the archive"),
        (archive(FILES, {**FILES, "b": FILES["b"][:-1]}), "b in the archive"),
        (archive({}), "lists no files"),
        (deflated({}, b"[]"), "lists no files"),
        (deflated({}, b'{"files": [{"path": "a"}]}'), "same files"),
        (deflated({"a": b"x"}, b'{"files": [{"path": "a"}]}'), "damaged"),
        (deflated({"a": b"x"}, b'{"files": [{"path": "a", "size": "1", "sha256": ""}]}'), "a in the archive"),
        (deflated({"a": b"x"}, b"{"), "damaged"),
        (deflated({}, b" " * (17 << 20)), "manifest has more"),
        (BOMB, "a in the archive"),
        (b"", "damaged"),
        (b"PK\x05\x06" + bytes(18), "damaged"),
    ],
)
def test_what_does_not_agree_with_its_manifest(path: Path, content: bytes, words: str) -> None:
    path.write_bytes(content)
    with pytest.raises(DownloadFailed, match=words):
        check_archive(path)
