from __future__ import annotations

import io
import os
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.cli.source import destination
from service.errors import EmptyFile, TooManyBytes, UnreadableInput, UsageError
from service.photo.limits import Limits
from service.photo.source import read_photo


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "a photo.jpg").write_bytes(b"\xff\xd8 bytes")
    assert read_photo(str(tmp_path / "a photo.jpg")) == b"\xff\xd8 bytes"


def test_a_pipe_is_read_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"bytes")))
    assert read_photo("-") == b"bytes"


def test_a_named_pipe_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(b"bytes",))
    writer.start()
    assert read_photo(str(tmp_path / "pipe")) == b"bytes"
    writer.join()


def test_what_is_not_there_is_a_usage_error(tmp_path: Path) -> None:
    for name in (tmp_path / "no.jpg", tmp_path, tmp_path / "no" / "no.jpg"):
        with pytest.raises(UsageError, match=str(name)):
            read_photo(str(name))


@pytest.mark.parametrize("name", ["a\0b.jpg", "a" * 5000 + ".jpg"])
def test_a_name_that_no_file_can_have_is_refused_in_words(name: str) -> None:
    with pytest.raises(UnreadableInput):
        read_photo(name)


def test_an_empty_file_says_so(tmp_path: Path) -> None:
    (tmp_path / "empty.jpg").touch()
    with pytest.raises(EmptyFile, match="0 bytes"):
        read_photo(str(tmp_path / "empty.jpg"))


def test_an_endless_pipe_ends_at_the_limit_of_the_gate() -> None:
    """Without the cap this test would fill the memory and never return."""
    with pytest.raises(TooManyBytes, match=str(Limits().max_bytes)):
        read_photo("/dev/zero")


def test_the_archive_goes_beside_the_photo() -> None:
    assert destination("a/b/me.jpg", None, as_json=False) == "a/b/me.zip"
    assert destination("me", None, as_json=False) == "me.zip"
    assert destination("me.jpg", "other.zip", as_json=True) == "other.zip"


def test_a_pipe_answers_into_the_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", SimpleNamespace(isatty=lambda: False))
    assert destination("-", None, as_json=False) == "-"


def test_a_zip_is_not_poured_over_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", SimpleNamespace(isatty=lambda: True))
    with pytest.raises(UsageError, match="terminal"):
        destination("me.jpg", "-", as_json=False)


def test_json_and_archive_do_not_mix() -> None:
    with pytest.raises(UsageError, match="--json"):
        destination("-", None, as_json=True)


def test_the_photo_is_not_overwritten(tmp_path: Path) -> None:
    photo = tmp_path / "me.zip"  # a JPEG by content, whatever its name says
    photo.write_bytes(b"\xff\xd8")
    (tmp_path / "link").symlink_to(photo)
    for output in (None, str(photo), str(tmp_path / "link"), f"{tmp_path}/./me.zip"):
        with pytest.raises(UsageError, match="would be overwritten"):
            destination(str(photo), output, as_json=False)
