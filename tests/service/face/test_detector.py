from __future__ import annotations

import numpy as np
import pytest

from service.face.detection import Detection, anchors, decode_boxes, merge


def detection(x: float, y: float, size: float, score: float) -> Detection:
    keys = np.array([[-0.2, -0.2], [0.2, -0.2], [0, 0], [0, 0.2], [-0.5, -0.1], [0.5, -0.1]]) * size + [x, y]
    return Detection(np.array([x, y]), size, score, keys)


def test_anchors() -> None:
    """16 x 16 cells with 2 anchors (stride 16), then 8 x 8 cells with 6 (three layers of stride 32)."""
    grid = anchors()
    assert grid.shape == (16 * 16 * 2 + 8 * 8 * 6, 2)
    assert np.array_equal(grid[:2], [[8, 8], [8, 8]])
    assert np.array_equal(grid[2], [24, 8])  # x runs fastest
    assert np.array_equal(grid[512:518], np.full((6, 2), 16.0))
    assert np.array_equal(grid[-1], [240, 240])


def test_decode_adds_anchors_and_sorts() -> None:
    grid = np.array([[8.0, 8.0], [100.0, 50.0], [10.0, 10.0]])
    raw = np.zeros((3, 16))
    raw[:, 2:4] = 30.0
    raw[1, 0], raw[1, 4] = 5.0, -7.0
    points, scores = decode_boxes(raw, np.array([1.0, 3.0, -4.0]), grid, 0.5)
    assert np.allclose(points[0, 0], [105, 50])
    assert np.allclose(points[0, 1], [30, 30])
    assert np.allclose(points[0, 2], [93, 50])
    assert scores == pytest.approx([1 / (1 + np.exp(-3)), 1 / (1 + np.exp(-1))])


def test_decode_survives_huge_logits_and_empty_boxes() -> None:
    """Raw scores reach tens of thousands on flat pictures; exp would overflow. Boxes of no size are no faces."""
    raw = np.zeros((2, 16))
    raw[0, 2:4] = 10.0
    points, scores = decode_boxes(raw, np.array([3e4, 3e4]), np.zeros((2, 2)), 0.5)
    assert len(points) == 1
    assert scores[0] == pytest.approx(1.0)
    assert len(decode_boxes(raw, np.array([-3e4, -3e4]), np.zeros((2, 2)), 0.5)[0]) == 0


def test_two_half_off_boxes_become_one_between_them() -> None:
    """Greedy suppression would keep one of the two, half off the face."""
    (face,) = merge([detection(90, 50, 60, 0.6), detection(110, 50, 60, 0.6)])
    assert face.centre == pytest.approx([100, 50])
    assert face.keypoints[2] == pytest.approx([100, 50])
    assert face.score == 0.6


def test_merging_weighs_by_score_and_keeps_distant_faces() -> None:
    faces = merge([detection(300, 50, 60, 0.7), detection(100, 50, 60, 0.9), detection(108, 50, 60, 0.3)])
    assert [f.score for f in faces] == [0.9, 0.7]
    assert faces[0].centre[0] == pytest.approx(102)
