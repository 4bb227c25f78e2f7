"""What is to be made: names of photos and archives, and what reports say."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from service.batch.plan import REPORT, REPORTS, Plan
from service.places import Place


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


def found(folder: Path, out: Path | None = None) -> dict[str, str]:
    """Photos and their archives, as a plan has them."""
    out = out or folder / ".out"
    out.mkdir(exist_ok=True)
    plan = Plan(Place(folder), Place(out))
    plan.look()
    plan.ask({})
    photos = {photo["path"]: photo["archive"] for photo in plan.todo()}
    return photos


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
    assert len({name.casefold() for name in archives.values()}) == len(archives) == 6
    assert archives["b.jpg"] == "b.zip"
    assert archives["sub/a.jpg"] == "sub/a.zip"


def test_a_folder_that_is_a_pipe_or_a_dead_link_is_no_photo(tmp_path: Path) -> None:
    touch(tmp_path, "a.jpg", "folder.jpg/x.txt")
    (tmp_path / "dead.jpg").symlink_to("nowhere")
    (tmp_path / "alive.jpg").symlink_to("a.jpg")
    (tmp_path / "loop").symlink_to(tmp_path)
    os.mkfifo(tmp_path / "pipe.jpg")
    assert list(found(tmp_path)) == ["a.jpg", "alive.jpg"]


def line(path: str, outcome: str = "succeeded", **more: object) -> str:
    return json.dumps({"path": path, "outcome": outcome, "attempt": 1, **more}) + "\n"


@pytest.mark.parametrize("torn", ['{"path": "c", "sha', "\0\0\0", "[]\n", '{"path": 7}\n', "[" * 5000])
def test_the_last_line_of_a_photo_counts_and_torn_ones_do_no_harm(tmp_path: Path, torn: str) -> None:
    touch(tmp_path, "a.jpg", "b.jpg")
    (tmp_path / REPORTS).mkdir(parents=True)
    (tmp_path / REPORT).write_text(line("z") + line("a.jpg", "failed") + torn)
    (tmp_path / REPORTS / "2-000000.jsonl").write_text(line("a.jpg", n=2) + torn)
    (tmp_path / REPORTS / "1-000000.jsonl").write_text(line("a.jpg", n=1) + line("b.jpg", "failed", new=1))
    plan = Plan(Place(tmp_path), Place(tmp_path))
    plan.look()
    assert plan.outcome() == (1, 1, 0)
    plan.merge(tmp_path / ".batch")
    lines = [json.loads(text) for text in (tmp_path / REPORT).read_text().splitlines()]
    assert [(line["path"], line["outcome"], line.get("n")) for line in lines] == [
        ("a.jpg", "succeeded", 2), ("b.jpg", "failed", None), ("z", "succeeded", None),
    ]  # fmt: skip
    assert not list((tmp_path / REPORTS).iterdir())
