from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.face.detection import MIRROR, Detection, Mesh, MeshNetwork, locate
from service.face.finder import CONSISTENT, Face, FaceFinder
from tests.service.face.conftest import Pixels
from tests.service.face.geometry import rms


@pytest.fixture(scope="module")
def network() -> MeshNetwork:
    return MeshNetwork()


@pytest.fixture(scope="module")
def seen(face: Face) -> Detection:
    return Detection((face.box[:2] + face.box[2:]) / 2, float(face.box[2] - face.box[0]), face.score, face.keypoints)


def test_mirror_partners_are_mutual() -> None:
    assert sorted(MIRROR) == list(range(468))
    assert all(MIRROR[MIRROR[i]] == i for i in range(468))
    assert sum(MIRROR[i] == i for i in range(468)) == 28
    assert (MIRROR[33], MIRROR[133], MIRROR[61], MIRROR[4]) == (263, 362, 291, 4)  # eye corners, mouth corner, nose tip


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


def test_a_mirrored_photo_has_the_mirrored_mesh(finder: FaceFinder, portrait: Pixels, face: Face) -> None:
    (other,) = finder.find(np.ascontiguousarray(portrait[:, ::-1]))
    back = other.landmarks[list(MIRROR)] * [-1, 1, 1] + [portrait.shape[1], 0, 0]
    assert rms(back, face.landmarks) < 0.012


def test_disagreement_with_an_empty_box_is_finite(face: Face, seen: Detection) -> None:
    assert np.isfinite(Mesh(face.landmarks, 0.0).disagreement(replace(seen, size=0.0)))
