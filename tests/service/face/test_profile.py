"""Faces that only the reader sees; portraits of such are in ``fit/test_cases.py``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.detection import Detection
from service.face.finder import Face
from service.face.fit.landmark_fit import LandmarkModel
from service.face.profile import CROP, faces_by_reading, look, turned_further
from service.face.reading.reader import ReaderNetwork, Reading, crop_of
from service.face.region import Region
from service.head.model import HeadModel
from tests.service.face.conftest import Pixels
from tests.service.face.geometry import inter_ocular


@pytest.fixture(scope="module")
def network() -> ReaderNetwork:
    return ReaderNetwork()


class Spoilt(ReaderNetwork):
    """The reader with one field of what it says replaced by a constant."""

    def __init__(self, inner: ReaderNetwork, field: str, value: float) -> None:
        self.inner, self.field, self.value = inner, field, value

    def __call__(self, pixels: Pixels, region: Region) -> Reading:
        reading = self.inner(pixels, region)
        return replace(reading, **{self.field: np.full_like(getattr(reading, self.field), self.value)})


class Broken(ReaderNetwork):
    """A reader that gives no numbers."""

    def __init__(self) -> None:
        pass

    def __call__(self, pixels: Pixels, region: Region) -> Reading:
        raise NumericFault("no numbers")


def around(face: Face) -> Detection:
    return Detection((face.box[:2] + face.box[2:]) / 2, float(face.box[2] - face.box[0]), face.score, face.keypoints)


def test_on_a_face_that_both_see_they_agree(
    head: HeadModel, network: ReaderNetwork, portrait: Pixels, face: Face
) -> None:
    (seen,) = faces_by_reading(portrait, [around(face)], head, network)
    apart = np.linalg.norm(seen.landmarks[:, :2] - face.landmarks[:, :2], axis=1)
    assert apart.mean() < 0.10 * inter_ocular(face.landmarks)
    assert seen.landmarks[4, 2] < seen.landmarks[[234, 454], 2].min(), "the nose is nearer than the ears"
    assert seen.warnings[0] == "landmarks-read"


@pytest.mark.parametrize("middle", [(0.0, 0.0), (400.0, 300.0), (220.0, 360.0), (9e3, 9e3)])
def test_where_there_is_no_face_none_is_read(
    head: HeadModel, network: ReaderNetwork, portrait: Pixels, face: Face, middle: tuple[float, float]
) -> None:
    """A corner of the photo, a rocket, a suit, and a box beside the photo."""
    shift = np.array(middle) - around(face).centre
    elsewhere = replace(around(face), centre=np.array(middle), keypoints=face.keypoints + shift)
    assert faces_by_reading(portrait, [elsewhere], head, network) == []
    assert faces_by_reading(portrait, [], head, network) == []


@pytest.mark.parametrize(
    ("field", "value"),
    [("chart_mm", 0.0), ("chart_mm", np.inf), ("chart", np.nan), ("chart", 0.5), ("parts", 0.0), ("normal", np.nan)],
)
def test_nonsense_gives_finite_landmarks_or_none(
    head: HeadModel, network: ReaderNetwork, portrait: Pixels, face: Face, field: str, value: float
) -> None:
    """No uncertainty, no end of it, no numbers, every pixel the same place, nothing of the head."""
    found = faces_by_reading(portrait, [around(face)], head, Spoilt(network, field, value))
    assert all(np.isfinite(one.landmarks).all() for one in found)
    if field != "chart_mm":
        assert found == []


def test_a_reader_without_numbers_sees_nothing(head: HeadModel, portrait: Pixels, face: Face) -> None:
    region = around(face).region(CROP)
    assert look(portrait, region, head, LandmarkModel(head, 0), Broken()) is None


def test_a_face_from_the_front_keeps_its_landmarks(
    head: HeadModel, network: ReaderNetwork, portrait: Pixels, face: Face
) -> None:
    region = crop_of(face.landmarks)
    assert region is not None
    assert turned_further(face, network(portrait, region), head) is face
