from __future__ import annotations

from pathlib import Path

import pytest

from service.batch.photos import find_photos
from service.errors import UsageError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


def found(folder: Path, out: Path | None = None) -> dict[str, str]:
    return {photo.name: photo.archive for photo in find_photos(folder, out or folder / "no-such")}


def test_photos_of_all_folders_in_the_order_of_their_names(tmp_path: Path) -> None:
    touch(
        tmp_path, "b.JPG", "a.jpeg", "sub/deep/c.webp", "sub/notes.txt", ".hidden.jpg", ".git/d.png", "a b.png", "noext"
    )
    assert list(found(tmp_path).items()) == [
        ("a b.png", "a b.zip"),
        ("a.jpeg", "a.zip"),
        ("b.JPG", "b.zip"),
        ("sub/deep/c.webp", "sub/deep/c.zip"),
    ]


def test_two_photos_never_share_an_archive(tmp_path: Path) -> None:
    """One would replace the other. Case counts too: A.zip and a.zip are one file on some systems."""
    touch(tmp_path, "a.jpg", "a.png", "A.webp", "sub/a.jpg", "b.jpg", "a.jpg.png")
    archives = found(tmp_path)
    assert len({name.casefold() for name in archives.values()}) == len(archives)
    assert archives["b.jpg"] == "b.zip"
    assert archives["sub/a.jpg"] == "sub/a.zip"


def test_photos_in_the_output_folder_are_none(tmp_path: Path) -> None:
    touch(tmp_path, "a.jpg", "out/preview.jpg")
    assert list(found(tmp_path, tmp_path / "out")) == ["a.jpg"]


def test_a_folder_that_is_a_pipe_or_a_dead_link_is_no_photo(tmp_path: Path) -> None:
    touch(tmp_path, "a.jpg", "folder.jpg/x.txt")
    (tmp_path / "dead.jpg").symlink_to("nowhere")
    (tmp_path / "alive.jpg").symlink_to("a.jpg")
    (tmp_path / "loop").symlink_to(tmp_path)
    assert list(found(tmp_path)) == ["a.jpg", "alive.jpg"]


@pytest.mark.parametrize("names", [[], ["notes.txt"]])
def test_no_photos(tmp_path: Path, names: list[str]) -> None:
    touch(tmp_path, *names)
    with pytest.raises(UsageError, match="no photo"):
        find_photos(tmp_path, tmp_path / "out")


def test_no_folder(tmp_path: Path) -> None:
    touch(tmp_path, "a.jpg")
    for folder in ("no-such", "a.jpg"):
        with pytest.raises(UsageError, match="no folder"):
            find_photos(tmp_path / folder, tmp_path / "out")
