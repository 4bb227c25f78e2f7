"""The identity benchmark's bookkeeping on descriptors whose answers are known."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.identity import Likeness, pairs, person_of, photos_of, rank_one
from service.face.identity import distance


def at(person: str, photo: float, render: float) -> Likeness:
    """Descriptors on a line, so that a distance is a difference."""
    axis = np.eye(128, dtype=np.float32)[0]
    return Likeness(person, photo * axis, render * axis)


def test_pairs_are_sorted_by_who_is_in_them() -> None:
    found = pairs([at("a", 0, 1), at("a", 2, 4), at("b", 10, 13)], distance)
    assert found["render, own photo"] == [1, 2, 3]
    assert sorted(found["render, other photo of the person"]) == [1, 4]
    assert sorted(found["render, photo of another"]) == [6, 9, 11, 13]
    assert found["photo, other photo of the person"] == [2]
    assert sorted(found["photo, photo of another"]) == [8, 10]


def test_every_pair_is_counted_once() -> None:
    """A pair counted in two rows would put genuine pairs into the impostor distribution."""
    people = [at(p, k, k + 0.5) for k, p in enumerate("aabbbc")]
    found = pairs(people, distance)
    renders = [len(v) for k, v in found.items() if k.startswith("render")]
    photos = [len(v) for k, v in found.items() if k.startswith("photo")]
    assert sum(renders) == 36 and sum(photos) == 15


def test_a_render_nearer_to_someone_else_is_not_retrieved() -> None:
    samples = [at("a", 0, 0.1), at("b", 5, 0.2), at("c", 9, 9)]
    assert rank_one(samples, own=True) == (2, 3)


def test_without_its_own_photo_only_people_with_another_are_asked_about() -> None:
    samples = [at("a", 0, 0), at("a", 1, 4), at("b", 5, 5)]
    assert rank_one(samples, own=False) == (1, 2)
    assert rank_one(samples[1:], own=False) == (0, 0)


def test_photos_of_a_folder(tmp_path: Path) -> None:
    for name in ("x_0.png", "x_1.JPG", "x_0.npz", "y.webp"):
        (tmp_path / name).touch()
    assert [p.name for p in photos_of([tmp_path], "*")] == ["x_0.png", "x_1.JPG", "y.webp"]
    assert [p.name for p in photos_of([tmp_path], "x_*")] == ["x_0.png", "x_1.JPG"]
    with pytest.raises(SystemExit, match="no photos"):
        photos_of([tmp_path], "z*")


def test_people_are_named_by_file_or_by_prefix(tmp_path: Path) -> None:
    one, other = tmp_path / "x_0.png", tmp_path / "x_1.png"
    assert person_of(one, True) == person_of(other, True)
    assert person_of(one, False) != person_of(other, False)
    assert person_of(one, True) != person_of(tmp_path / "sub" / "x_0.png", True)
