"""Photos of one person taken together."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.batch.plan import SUFFIXES, Grouped, grouped
from service.batch.plan import photos_at as place
from service.errors import UsageError
from service.photo.bundle import MOST, unbundled


def filled(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    return folder


def contents(folder: Path, by: str) -> dict[str, list[bytes]]:
    source = place(grouped(str(folder), by))
    found = {}
    for entry in source.entries(SUFFIXES):
        with source.open(entry.name) as stream:
            found[entry.name] = unbundled(stream.read())
    return found


def test_a_folder_is_a_person(tmp_path: Path) -> None:
    folder = filled(tmp_path, "ada/1.jpg", "ada/2.png", "ada/notes.txt", "eva.l/x.jpg", "alone.jpg")
    assert contents(folder, "folder") == {
        "ada.photos": [b"ada/1.jpg", b"ada/2.png"], "eva.l.photos": [b"eva.l/x.jpg"], "alone.photos": [b"alone.jpg"],
    }  # fmt: skip


def test_a_beginning_is_a_person(tmp_path: Path) -> None:
    folder = filled(tmp_path, "ada-1.jpg", "ada-left.jpg", "eva_l_2.jpg", "b/ada-3.jpg", "alone.jpg")
    assert contents(folder, "prefix") == {
        "ada.photos": [b"ada-1.jpg", b"ada-left.jpg"], "eva_l.photos": [b"eva_l_2.jpg"],
        "b/ada.photos": [b"b/ada-3.jpg"], "alone.photos": [b"alone.jpg"],
    }  # fmt: skip


def test_another_process_opens_a_group_by_its_name(tmp_path: Path) -> None:
    """Workers get names from a manifest and have never listed the place."""
    filled(tmp_path, "ada/1.jpg", "ada/2.jpg")
    source = place(grouped(str(tmp_path), "folder"))
    assert isinstance(source, Grouped)
    with source.open("ada.photos") as stream:
        assert len(unbundled(stream.read())) == 2
    with pytest.raises(FileNotFoundError):
        source.open("nobody.photos")


def test_too_many_photos_are_refused_by_the_name_of_the_group(tmp_path: Path) -> None:
    filled(tmp_path, *(f"ada/{number}.jpg" for number in range(MOST + 1)))
    with pytest.raises(UsageError, match=r"ada has 25 photos"):
        place(grouped(str(tmp_path), "folder")).open("ada.photos")
