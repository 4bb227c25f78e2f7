"""Boxes of the detector and the mesh of the landmark network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.face.detection import Detection, Mesh, MeshNetwork, decode_boxes, locate, merge
from service.face.finder import CONSISTENT, Face
from tests.service.face.conftest import Pixels
from tests.service.face.geometry import rms


def detection(x: float, y: float, size: float, score: float) -> Detection:
    keys = np.array([[-0.2, -0.2], [0.2, -0.2], [0, 0], [0, 0.2], [-0.5, -0.1], [0.5, -0.1]]) * size + [x, y]
    return Detection(np.array([x, y]), size, score, keys)


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


@pytest.fixture(scope="module")
def network() -> MeshNetwork:
    return MeshNetwork()


@pytest.fixture(scope="module")
def seen(face: Face) -> Detection:
    return Detection((face.box[:2] + face.box[2:]) / 2, float(face.box[2] - face.box[0]), face.score, face.keypoints)


@pytest.mark.parametrize("across", [-0.45, 0.45])
def test_a_box_beside_the_face_is_mended(
    network: MeshNetwork, portrait: Pixels, face: Face, seen: Detection, across: float
) -> None:
    """With the box nearly half off, the network's first answer lies beside the face; iteration has to bring it back."""
    shift = np.array([across * seen.size, 0.0])
    off = replace(seen, centre=seen.centre + shift, keypoints=seen.keypoints + shift)
    first = network(portrait, off.region(1.5))
    assert rms(first.landmarks, face.landmarks) > 0.03
    assert rms(locate(network, portrait, off).landmarks, face.landmarks) < 0.02


def test_a_mesh_beside_the_face_is_noticed(face: Face, seen: Detection) -> None:
    """Neither score nor presence tells; the distance to the detector's own keypoints does."""
    good = Mesh(face.landmarks, 40.0)
    assert good.disagreement(seen) < 0.04
    beside = Mesh(face.landmarks + np.array([0.4 * seen.size, 0.0, 0.0]), 40.0)
    assert beside.disagreement(seen) > CONSISTENT


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_the_logit_tells_the_way_up(network: MeshNetwork, portrait: Pixels, seen: Detection, quarter: int) -> None:
    upright = seen.region(1.5)
    turned = replace(upright, angle=upright.angle + quarter * np.pi / 2)
    assert network(portrait, upright).logit > 30
    assert network(portrait, turned).logit < 15


def test_disagreement_with_an_empty_box_is_finite(face: Face, seen: Detection) -> None:
    assert np.isfinite(Mesh(face.landmarks, 0.0).disagreement(replace(seen, size=0.0)))
