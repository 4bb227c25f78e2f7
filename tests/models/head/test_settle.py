"""Eyes, teeth and tongue of the head in the box: sizes of a person's, and a smile that shows teeth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from models.head.eyes import SEGMENTS
from models.head.settle import EYE_RADIUS_M, LIMBUS_DEG, SETTLED_RINGS_DEG
from service.head.files import load_head
from service.head.model import HeadModel


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def part(head: HeadModel, name: str) -> npt.NDArray[np.int64]:
    return np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])


def test_eyeballs_and_irises_have_a_persons_size(head: HeadModel) -> None:
    for name in ("eye_left", "eye_right"):
        ball = head.mean[part(head, name)].astype(float)
        centre = 0.5 * (ball.min(0) + ball.max(0))
        np.testing.assert_allclose(np.linalg.norm(ball - centre, axis=1), EYE_RADIUS_M, atol=4e-4)
        limbus = ball[1 + 6 * SEGMENTS : 1 + 7 * SEGMENTS]
        assert 2 * np.linalg.norm((limbus - centre)[:, :2], axis=1).mean() == pytest.approx(0.0117, abs=4e-4)
    assert SETTLED_RINGS_DEG[6] == LIMBUS_DEG


def test_upper_teeth_bite_before_the_lower_ones(head: HeadModel) -> None:
    random = np.random.default_rng(0)
    for _ in range(12):
        v = head.shape(random.normal(size=len(head.identity)))
        upper, lower = ({tuple(np.round(p, 6)): p for p in v[part(head, f"teeth_{r}")]} for r in ("upper", "lower"))
        front = [np.array([p for p in row.values() if abs(p[0]) < 0.004]) for row in (upper, lower)]
        edge_upper = front[0][np.argmin(front[0][:, 1])]
        edge_lower = front[1][np.argmax(front[1][:, 1])]
        assert -0.001 < edge_lower[1] - edge_upper[1] < 0.005
        assert edge_upper[2] > edge_lower[2] - 0.0005
