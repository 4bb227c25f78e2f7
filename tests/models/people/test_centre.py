"""Centring the embedding on real faces: a habit that the landmark network has on all of them moves the landmarks."""


import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from models.head.shoot import look_at
from models.people.centre import FEWEST_FACES, median_residual, moved, residual
from service.face.finder import Face
from service.face.fit.landmark_fit import LandmarkModel
from service.head.files import load_head
from service.head.model import HeadModel
from service.photo.photo import Photo

SIZE = 512
HABIT = np.zeros((468, 2))
HABIT[[1, 4, 5, 195, 197, 6, 168], 1] = 0.0025
"""Metres: the ridge of the nose is seen higher than it is."""


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def places(head: HeadModel, yaw: float = 0.0) -> np.ndarray:
    return LandmarkModel(head, 0).at_yaw(yaw).mean


def seen(head: HeadModel, yaw: float, seed: int = 0) -> tuple[Photo, Face, None]:
    """A grey photo and the landmarks that a network with the habit finds on somebody."""
    camera = look_at(yaw, 0.0, 0.0, 0.8, SIZE, 1400.0)
    model = LandmarkModel(head, 20)
    shape = np.concatenate([0.5 * np.random.default_rng(seed).normal(size=20), np.zeros(len(head.expression))])
    points = model.at_yaw(yaw).points(shape)
    points[:, :2] += HABIT
    depth = camera.to_camera(points)[:, 2]
    landmarks = np.c_[camera.project(points), (depth - depth.mean()) * camera.focal_px / camera.translation[2]]
    photo = Photo(np.full((SIZE, SIZE, 3), 128, np.uint8))
    box = np.array([0.0, 0.0, SIZE, SIZE])
    return photo, Face(box, 1.0, np.zeros((6, 2)), landmarks, 1.0), None


def test_a_habit_on_all_faces_moves_the_landmarks(head: HeadModel) -> None:
    """Without it every fit would bend noses to the habit."""
    found = [residual(head, *seen(head, 0.0, seed)) for seed in range(FEWEST_FACES)]
    shift = median_residual([one for one in found if one is not None])
    change = (places(moved(head, shift)) - places(head))[:, 1]
    habitual = HABIT[:, 1] > 0
    assert change[habitual].mean() > 0.0012
    assert abs(change[~habitual]).mean() < 0.0004
