"""Which of several photos are used, and what is told of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from service.errors import FitFailed, NoFace, Strangers, UnreadableInput, UsageError
from service.face import several
from service.face.finder import Face
from service.face.fit.fit import FitSettings
from service.face.reading.reader import View
from service.face.several import Gathered, apart_from_most, check_count, decoded, fitted, of_one_person, smaller
from service.photo.photo import Photo


def png(seed: int, side: int = 80) -> bytes:
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3), np.uint8)
    return bytes(cv2.imencode(".png", cv2.GaussianBlur(pixels, (0, 0), 4))[1].tobytes())


def face(turned: float = 0.5) -> Face:
    """A face whose nose stands so far from one ear to the other."""
    landmarks = np.zeros((468, 3))
    landmarks[[234, 454, 1], 0] = [0.0, 1.0, turned]
    return Face(np.zeros(4), 0.9, np.zeros((6, 2)), landmarks, 1.0)


def test_order_changes_nothing_and_the_same_photo_counts_once() -> None:
    files = [png(1), png(2), png(3)]
    one, other = decoded(files), decoded([files[2], files[0], files[1], files[0]])
    assert [p.sha256 for p in one.photos] == [p.sha256 for p in other.photos]
    assert [left.code for left in other.left_out] == ["same-photo"] and not one.left_out
    assert other.numbers != one.numbers, "messages name the photo as it was given"


def test_what_is_no_photo_is_left_out_with_its_reason() -> None:
    found = decoded([png(1), b"no photo", png(2)])
    assert len(found.photos) == 2
    assert [(left.code, "JPEG" in left.message) for left in found.left_out] == [("unsupported-format", True)]


def test_no_photo_at_all_is_the_error_of_the_first() -> None:
    with pytest.raises(UnreadableInput, match="photo 1 of 2") as raised:
        decoded([b"no photo", b"neither"])
    assert raised.value.extra["photo"] == 0
    with pytest.raises(UnreadableInput) as alone:
        decoded([b"no photo"])
    assert "photo 1" not in alone.value.message, "one photo is told as ever"


@pytest.mark.parametrize("count", [0, 25])
def test_too_few_and_too_many_are_refused(count: int) -> None:
    with pytest.raises(UsageError, match=str(count)):
        check_count(count)


def codes(*people: int) -> list[Any]:
    """Descriptors of photos of people, each 0.3 from the others of the same, 1.5 from those of another."""
    rng = np.random.default_rng(0)
    found = []
    for person in people:
        middle = np.zeros(128)
        middle[person] = 1.0
        step = rng.normal(size=128)
        found.append(middle + 0.15 * step / np.linalg.norm(step))
    return found


def test_strangers_are_those_beside_the_largest_group() -> None:
    assert apart_from_most(codes(0, 0, 1, 0, 0), 0.6) == [2]
    assert apart_from_most(codes(0, 0, 0), 0.6) == []
    assert apart_from_most(codes(0, 1), 0.6) == [1]
    chain = [np.eye(128)[0] * 0.5 * k for k in range(5)]
    assert apart_from_most(chain, 0.6) == [], "each is close to the next, the ends are not"


class FakeRecogniser:
    def __init__(self, answers: Sequence[Any]) -> None:
        self._answers = iter(answers)

    def embed(self, pixels: object, landmarks: object) -> Any:
        return next(self._answers)


def gathered() -> Gathered:
    return decoded([png(seed) for seed in range(5)])


def test_a_stranger_is_refused_by_number_or_left_out() -> None:
    answers = codes(0, 0, 1, 0, 0)
    place = gathered()
    with pytest.raises(Strangers) as raised:
        of_one_person(place, lambda photo: face(), lambda: FakeRecogniser(answers), None)  # type: ignore[arg-type,return-value]
    assert raised.value.extra["photos"] == [place.numbers[2]]
    assert f"photo {place.numbers[2] + 1} of 5" in raised.value.message
    kept = of_one_person(place, lambda photo: face(), lambda: FakeRecogniser(answers), "strangers")  # type: ignore[arg-type,return-value]
    assert len(kept.views) == 4 and [left.code for left in kept.left_out] == ["strangers"]


def test_of_a_profile_it_cannot_be_told() -> None:
    """Profiles of one person are as far from each other as strangers."""
    place = gathered()
    profile = place.photos[2]
    answers = codes(0, 0, 0, 0)
    kept = of_one_person(
        place, lambda photo: face(1.2 if photo is profile else 0.5), lambda: FakeRecogniser(answers), None  # type: ignore[arg-type,return-value]
    )
    assert len(kept.views) == 5


def test_photos_without_a_face_are_left_out_unless_all_are() -> None:
    place = gathered()
    first = place.photos[0]

    def find(photo: Photo) -> Face:
        if photo is first:
            raise NoFace("no face was found")
        return face()

    kept = of_one_person(place, find, lambda: FakeRecogniser(codes(0, 0, 0, 0)), None)  # type: ignore[arg-type,return-value]
    assert len(kept.views) == 4 and kept.left_out[0].code == "no-face"
    with pytest.raises(NoFace, match="of 5"):
        of_one_person(place, lambda photo: find(first), lambda: FakeRecogniser([]), None)  # type: ignore[arg-type,return-value]


def test_a_photo_that_cannot_be_fitted_is_left_out_and_the_best_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    place = gathered()
    place = replace(place, views=tuple(View(photo, face()) for photo in place.photos))
    bad, best = place.views[1], place.views[3]

    def fit(views: Sequence[View], head: object, settings: object) -> list[Any]:
        for place, view in enumerate(views):
            if view is bad:
                raise FitFailed("the head does not fit", view=place)
        turned = np.diag([1.0, -1.0, -1.0])
        return [
            SimpleNamespace(
                camera=SimpleNamespace(rotation=turned), inter_ocular_px=200.0 if view is best else 60.0, warnings=()
            )
            for view in views
        ]

    monkeypatch.setattr(several, "fit_views", fit)
    found = fitted(place, None, FitSettings())  # type: ignore[arg-type]
    assert found.views[0] is best and len(found.views) == 4
    assert [left.code for left in found.left_out] == ["fit-failed"]


def test_large_photos_are_made_smaller_and_say_so() -> None:
    photo = Photo(np.zeros((600, 900, 3), np.uint8))
    assert smaller(photo, 540_000) is photo
    less = smaller(photo, 135_000)
    assert less.size == (450, 300) and "photo-made-smaller" in less.warnings
