"""Blink, smile and pucker of the head in the box: no dark lines, no hook in the cheek, lips that gather."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from models.head.crossing import crossing_pairs
from models.head.piercing import count, groups
from service.geometry.mesh import face_normals, vertex_normals
from service.geometry.raster import rasterise
from service.head.files import load_head
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

AMBIENT = 0.25
"""Light that reaches skin which the lamp does not."""


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def posed(head: HeadModel, identity: Float, **units: float) -> Float:
    activation = np.array([units.get(name, 0.0) for name in head.expression_names])
    return head.shape(identity, activation).astype(np.float64)


def identities(head: HeadModel, number: int) -> list[Float]:
    random = np.random.default_rng(11)
    return [np.zeros(0), *(random.normal(size=len(head.identity)) for _ in range(number))]


def lit_from_the_front(head: HeadModel, vertices: Float, part: Float) -> Float:
    """Brightness of the pixels, a fifth of a millimetre each, that show a region of the skin around the left eye."""
    own = head.triangle_part != head.part_names.index("lashes")  # avatars wear others
    triangles, size = head.triangles[own], 300
    ball = vertices[np.unique(head.triangles[head.triangle_part == head.part_names.index("eye_left")])].mean(0)
    place = (vertices - ball) * 5000
    raster = rasterise(
        np.stack([place[:, 0], -place[:, 1]], 1) + size / 2, 1 - place[:, 2] / 1e4, triangles, size, size
    )
    corners, weights = triangles[raster.triangle[raster.mask]], raster.barycentric[raster.mask][..., None]
    normal = (vertex_normals(vertices, head.triangles.astype(np.int64))[corners] * weights).sum(1)
    facing = np.maximum(normal[:, 2] / np.linalg.norm(normal, axis=1), 0)
    return np.asarray((AMBIENT + (1 - AMBIENT) * facing)[(part[corners] * weights[..., 0]).sum(1) > 0.5])


def test_a_shut_lid_has_no_dark_lines(head: HeadModel) -> None:
    lids = np.maximum(head.region("eyelid_upper_left"), head.region("eyelid_lower_left"))
    for identity in identities(head, 3):
        bright = lit_from_the_front(head, posed(head, identity, eyeBlinkLeft=1.0), lids)
        assert (bright < 0.7 * np.median(bright)).mean() < 0.01  # where the lids meet; it was 0.02 to 0.06


def test_a_smile_does_not_fold_the_cheek(head: HeadModel) -> None:
    outer = np.maximum(np.maximum(head.region("mouth_inner"), head.region("lips")), head.region("nose")) < 0.05
    skin = head.triangles[head.triangle_part == 0].astype(np.int64)
    cheek = skin[
        outer[skin].all(1) & (head.mean[skin, 2] > 0).all(1) & (np.abs(head.mean[skin, 1] + 0.06) < 0.03).all(1)
    ]
    for identity in identities(head, 3):
        before, after = (
            face_normals(posed(head, identity, mouthSmileLeft=smile, mouthSmileRight=smile), cheek)
            for smile in (0.0, 1.0)
        )
        cosine = (before * after).sum(1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
        assert np.degrees(np.arccos(cosine.min())) < 55  # the hook turned some by 87 to 114


def test_a_pucker_gathers_the_lips(head: HeadModel) -> None:
    def corners(vertices: Float) -> float:
        places = (vertices[head.triangles[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
        return 1e3 * float(np.linalg.norm(places[61] - places[291]))

    apart, together = (corners(posed(head, np.zeros(0), mouthPucker=pucker)) for pucker in (0.0, 1.0))
    assert together < 40
    assert together / apart < 38.5 / 52.7  # a mouth 52.7 mm wide ends at 38.5 mm


@pytest.mark.parametrize("units", [{"eyeBlinkLeft": 1.0}, {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0},
                                   {"mouthPucker": 1.0}, {"mouthPucker": 1.0, "jawOpen": 0.4}])  # fmt: skip
def test_nothing_crosses(head: HeadModel, units: dict[str, float]) -> None:
    surfaces, random = groups(head), np.random.default_rng(1)
    for identity in (np.zeros(0), random.normal(size=len(head.identity)), random.normal(size=len(head.identity))):
        assert count(posed(head, identity, **units), surfaces) == {}
    lips = (surfaces["lip_upper"], surfaces["lip_lower"])
    assert not len(crossing_pairs(posed(head, np.zeros(0), **units), *lips))
